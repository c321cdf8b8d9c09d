"""What becomes of a run whose process ends in the middle of it.

A component in process can end the process: it crashes, or calls exit(). Two things stand against that being silent.
`Watch` is a small process of its own that waits for this one. If this one ends before the run does, it completes the run on disk (the
rows that were still in memory, too: `flight`), and says on standard error which component was being called.
`leaving` is called back by the C library when a component calls exit(), which would otherwise be the end with any status it likes.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import sys
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from robomill.orchestration.runs import flight
from robomill.orchestration.runs.files import RUN
from robomill.orchestration.runs.lock import FolderLock
from robomill.orchestration.runs.run import Run, read_info
from robomill.orchestration.system.toml_text import dump

EXIT_STATUS = 70
"""Exit status of the process, when a component has called exit(): EX_SOFTWARE of sysexits.h."""
_BOOT = (
    "import os, sys\n"
    "if not os.read(0, 1):\n"
    "    import json\n"
    "    sys.path[:] = json.loads(sys.argv[1])\n"
    "    from robomill.orchestration.runs.watch import conclude\n"
    "    sys.stderr.write(conclude(sys.argv[2]))\n"
)


class Watch:
    """Waits, in a process of its own, for this one to end before `done`. It needs `sys.executable`."""

    def __init__(self, folder: Path) -> None:
        import subprocess  # only runs with foreign code are watched

        options: dict[str, Any] = {"start_new_session": True}  # what ends this process from the terminal must not end the other
        if sys.platform == "win32":
            options = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
        command = [sys.executable, "-S", "-c", _BOOT, json.dumps(sys.path), str(folder.absolute())]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, **options)

    def done(self) -> None:
        """The run has ended: the other process goes."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):
            self._process.stdin.write(b".")
            self._process.stdin.close()
        self._process.wait()


def conclude(place: str) -> str:
    """Complete the run in the folder `place`, whose process is gone; returns what is to be said about it, "" if it had ended before."""
    folder = Path(place)
    from robomill.orchestration.runs.signals import finalise  # with Arrow

    text = flight.ended(flight.called(folder))
    with FolderLock(folder):
        info = read_info(folder)
        if info.get("outcome") != "running":
            return ""
        finalise(folder)
        head = {"schema": info["schema"], "outcome": "failed", "message": text}
        part = folder / (RUN + ".part")
        part.write_text(dump({**head, **{k: v for k, v in info.items() if k not in head}}), encoding="utf-8")
        part.replace(folder / RUN)
    t = Run.load(folder).t
    kept = f"results up to t = {t[-1]:.9g} s are" if len(t) else "there are no results"
    return f"run {folder.name}: {text}; {kept} in {folder}\n"


@contextlib.contextmanager
def leaving(when: Callable[[], object]) -> Iterator[None]:
    """While it is entered, the C function exit() calls `when` (which may clean up and say something), and the status is EXIT_STATUS.

    Not on Windows, where there is nothing to register with.
    """
    library = None if sys.platform == "win32" else ctypes.CDLL(None)
    if library is None or not hasattr(library, "__cxa_atexit"):
        yield
        return
    entered = True

    def called(_: object) -> None:
        if not entered:
            return
        try:
            when()
        except BaseException:  # the process ends whatever happens here, and not with a status of zero
            traceback.print_exc()
        finally:
            os._exit(EXIT_STATUS)

    key = ctypes.create_string_buffer(1)  # its address is what the C library knows this registration by
    function = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(called)
    library["__cxa_atexit"](function, None, key)
    try:
        yield
    finally:
        entered = False
        finish = library["__cxa_finalize"]
        finish.restype, finish.argtypes = None, [ctypes.c_void_p]
        finish(ctypes.addressof(key))
