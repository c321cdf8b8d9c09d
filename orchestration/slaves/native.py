"""What a slave shows of itself so that compiled code can step it: addresses of C functions and buffers.

A slave that can be stepped this way has a method `native()` that returns a `Native` (by structure; nothing
needs to be imported). It is asked for after the first step of a run and valid until the slave is initialised again or closed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol


class Block(Protocol):
    """Inputs, or outputs, of one type that are moved by one call."""

    @property
    def kind(self) -> str:
        """Type of an element of the buffer: `float64`, `int32` or `int64`."""
        ...

    @property
    def function(self) -> int:
        """Address of `int f(void *instance, const unsigned references[], size_t n, T buffer[])`; 0 = the buffer is the variable itself."""
        ...

    @property
    def references(self) -> int:
        """Address of the value references; 0 = the function knows its own buffer, whatever it is given."""
        ...

    @property
    def buffer(self) -> int:
        """Address of the buffer."""
        ...

    @property
    def places(self) -> Sequence[int]:
        """Positions of the elements among the inputs (outputs) of the slave."""
        ...


class Native(Protocol):
    """Addresses of a slave. Statuses above `limit`, or below zero, are errors."""

    @property
    def instance(self) -> int:
        """First argument of every call."""
        ...

    @property
    def step(self) -> int:
        """Address of `int f(void *instance, double t, double h, int final)`, t and h in s."""
        ...

    @property
    def final(self) -> int:
        """Last argument of a step: 1 if no state of before its beginning will be set any more, else 0."""
        ...

    @property
    def inputs(self) -> Sequence[Block]:
        """All inputs."""
        ...

    @property
    def outputs(self) -> Sequence[Block]:
        """All outputs."""
        ...

    @property
    def limit(self) -> int:
        """Largest status that is no error."""
        ...

    def failed(self, what: str, block: int, status: int, t: float, h: float) -> Exception:
        """The error for a call that returned `status`: `inputs` or `outputs` with the number of the block, or `step`."""
        ...


class Rollback(Protocol):
    """A state that is kept aside and put back again and again, without serialising it: by two functions, or as memory.

    A slave that can has a method `rollback()`. It is asked for when the slave has left initialisation; valid as `Native` is.
    """

    @property
    def instance(self) -> int:
        """First argument of both functions; without functions the address of the memory that is the state."""
        ...

    @property
    def get(self) -> int:
        """Address of `int f(void *instance, void **kept)`; 0 = the state is memory."""
        ...

    @property
    def set(self) -> int:
        """Address of `int f(void *instance, void *kept)`; 0 = the state is memory."""
        ...

    @property
    def kept(self) -> int:
        """Address of the pointer to what is kept; without functions of the memory for the copy."""
        ...

    @property
    def size(self) -> int:
        """Bytes of the memory that is the state."""
        ...

    @property
    def limit(self) -> int:
        """Largest status of the functions that is no error."""
        ...

    def failed(self, what: str, status: int) -> Exception:
        """The error for a call of a function (`save` or `back`) that returned `status`."""
        ...

    def save(self) -> None:
        """Keep the present state, from Python."""
        ...

    def back(self) -> None:
        """Go back to what is kept, from Python."""
        ...


class BlockData(NamedTuple):
    """A `Block` as plain data."""

    kind: str
    function: int
    references: int
    buffer: int
    places: tuple[int, ...]


def native_of(slave: Any) -> Native | None:
    """The native face of a slave, None if it has none."""
    method = getattr(slave, "native", None)
    found: Native | None = method() if method is not None else None
    return found


def obstacle(slaves: Mapping[str, Any]) -> str | None:
    """Why compiled code is of no use for these slaves: all can only be called from Python; None if one of them has a native face."""
    if any(native_of(slave) is not None for slave in slaves.values()):
        return None
    return ", ".join(f"component {name!r} ({type(slave).__name__})" for name, slave in slaves.items()) + " can only be called from Python"
