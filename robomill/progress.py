"""What shows how far a command is: a bar on a terminal, elsewhere a line from time to time."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import TaskID

    from robomill.cell import milling

INTERVAL = 10.0
"""Seconds between two lines, where standard error is no terminal: a log of an hour has 360 of them."""
PREPARING = "preparing; a first run compiles models"
"""What is said until the first report: nothing can be counted there, and on a new machine it takes a minute."""


@contextmanager
def progress_bar(quiet: bool) -> Iterator[milling.Progress]:
    """Show progress on standard error: a bar where it is a terminal, elsewhere a line each INTERVAL; nothing if `quiet`."""
    if quiet:
        yield lambda what, done, total: None
    elif not sys.stderr.isatty():
        lines = _Lines()
        try:
            yield lines.report
        finally:
            lines.close()
    else:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        columns = (TextColumn("{task.description:40}"), BarColumn(), TextColumn("{task.percentage:3.0f} %"), TimeRemainingColumn())
        with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
            tasks: dict[str, TaskID] = {}
            waiting = bar.add_task(PREPARING, total=None)

            def report(what: str, done: int, total: int) -> None:
                if what not in tasks:
                    bar.update(waiting, visible=False)
                    tasks[what] = bar.add_task(what, total=None)
                bar.update(tasks[what], completed=done, total=total or None)  # what is expected may grow

            yield report


class _Lines:
    """Progress as lines; the first when INTERVAL has passed, so that what is short says nothing."""

    def __init__(self) -> None:
        self._last = time.monotonic()
        self._waiting = threading.Timer(INTERVAL, print, (PREPARING,), {"file": sys.stderr, "flush": True})
        self._waiting.daemon = True
        self._waiting.start()

    def close(self) -> None:
        """Say nothing any more."""
        self._waiting.cancel()

    def report(self, what: str, done: int, total: int) -> None:
        """Print what is being done and how far it is, if the last line is INTERVAL ago."""
        self._waiting.cancel()
        now = time.monotonic()
        if now - self._last < INTERVAL:
            return
        self._last = now
        share = f"{100 * done / total:.0f} %, {done} of {total}" if total else f"{done} done"
        print(f"{what}: {share}", file=sys.stderr, flush=True)
