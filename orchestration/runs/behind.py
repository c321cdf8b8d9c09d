"""Completing a run on disk behind the next one."""

from __future__ import annotations

import threading
from collections.abc import Callable

from robomill.orchestration.runs.run import Run


class Behind:
    """A thread in which a run is completed on disk, while this one computes the next. The process does not end before it has."""

    def __init__(self, complete: Callable[[], Run]) -> None:
        """`complete`: what `orchestration.assembly.computed` returns."""
        self._complete = complete
        self._found: Run | None = None
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._work)
        self._thread.start()

    def _work(self) -> None:
        try:
            self._found = self._complete()
        except BaseException as error:  # raised where the run is asked for
            self._error = error

    def run(self) -> Run:
        """The run, once it is complete on disk. Raises what completing it raised."""
        self._thread.join()
        if self._error is not None:
            raise self._error
        assert self._found is not None
        return self._found
