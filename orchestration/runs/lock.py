"""One writer per folder: a lock of the operating system, which goes with the process that holds it, however that ends.

A file `run.lock` in the folder is locked and says who did it. What counts is the lock, not the file: one that a killed process has
left behind is in nobody's way. On Linux and macOS it is flock(2), on Windows a locked byte. On NFS flock is a lock of the server, so
other hosts see it, unless the share is mounted with local_lock. Where a file system has no locks there is a warning, and no protection.
"""

from __future__ import annotations

import contextlib
import datetime
import errno
import os
import platform
import sys
import warnings
from pathlib import Path
from types import TracebackType

from robomill.orchestration.errors import ResultsError

LOCK = "run.lock"
_TAKEN = (errno.EWOULDBLOCK, errno.EAGAIN, errno.EACCES, errno.EDEADLK)
_BYTE = 2**30  # the place that Windows locks: no process can read what another has locked, and who holds it is to be read


class FolderLock:
    """The lock of a folder that exists, taken at once. ResultsError names who holds it. Release it, or use it in `with`."""

    def __init__(self, folder: Path) -> None:
        self._file = folder / LOCK
        while True:
            self._descriptor = os.open(self._file, os.O_RDWR | os.O_CREAT, 0o666)
            try:
                _lock(self._descriptor)
            except OSError as error:
                if error.errno in _TAKEN:
                    holder = _said(self._descriptor)
                    os.close(self._descriptor)
                    raise ResultsError(
                        f"{folder}: another run is being written there, by {holder}: "
                        "wait until it has ended, end it, or choose another folder"
                    ) from None
                warnings.warn(f"{self._file} cannot be locked ({error}): nothing keeps another run out of this folder", stacklevel=3)
            if self._is_there():
                break
            os.close(self._descriptor)  # who held it has removed it meanwhile
        os.ftruncate(self._descriptor, 0)
        since = datetime.datetime.now().astimezone().isoformat(timespec="seconds")
        os.write(self._descriptor, f"process {os.getpid()} on {platform.node()} since {since}\n".encode())

    def _is_there(self) -> bool:
        try:
            return os.path.samestat(os.fstat(self._descriptor), self._file.stat())
        except FileNotFoundError:
            return False

    def release(self) -> None:
        """Give it back; may be repeated."""
        if self._descriptor >= 0:
            with contextlib.suppress(OSError):  # Windows removes no open file: an empty lock is no lock
                self._file.unlink()
            os.close(self._descriptor)
            self._descriptor = -1

    def __enter__(self) -> FolderLock:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.release()


def is_locked(folder: Path) -> bool:
    """Whether a process is writing into `folder`."""
    try:
        descriptor = os.open(folder / LOCK, os.O_RDONLY)
    except OSError:
        return False
    try:
        _lock(descriptor, shared=True)
    except OSError as error:
        return error.errno in _TAKEN
    finally:
        os.close(descriptor)
    return False


def _said(descriptor: int) -> str:
    return (
        os.pread(descriptor, 1000, 0).decode("utf-8", "replace").strip() or "another process" if hasattr(os, "pread") else "another process"
    )


if sys.platform == "win32":
    import msvcrt

    def _lock(descriptor: int, shared: bool = False) -> None:
        os.lseek(descriptor, _BYTE, os.SEEK_SET)
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        os.lseek(descriptor, 0, os.SEEK_SET)

else:
    import fcntl

    def _lock(descriptor: int, shared: bool = False) -> None:
        fcntl.flock(descriptor, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
