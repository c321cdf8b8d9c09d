"""The workers of a Dask cluster. Dask is an extra: without it, `connect` says how to get it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

SECONDS = 10
"""Time that a scheduler has to answer [s]."""


def connect(scheduler: str) -> Any:
    """A client of the Dask cluster at `scheduler` (tcp://host:port), to be used in `with`. ValueError where none answers."""
    try:
        import distributed
    except ImportError:
        raise ValueError(f"--scheduler {scheduler}: needs Dask; install it with: pip install robomill[cluster]") from None
    dask: Any = distributed  # it has no types
    try:
        return dask.Client(scheduler, timeout=SECONDS)
    except (OSError, ValueError) as error:
        raise ValueError(
            f"--scheduler {scheduler}: no Dask scheduler there ({error}); expected an address such as tcp://host:8786, "
            "that of a running `dask scheduler`"
        ) from None


def as_they_finish(futures: Sequence[Any]) -> Iterator[Any]:
    """Futures of a client, each when it is done."""
    import distributed

    dask: Any = distributed
    yield from dask.as_completed(futures)
