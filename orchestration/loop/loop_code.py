"""The compiled loop without Numba: its machine code, kept on disk."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from robomill import machine_code
from robomill.orchestration.loop import operations
from robomill.user_cache import use, user_folder

_LOADED: dict[tuple[str, ...], Callable[..., int]] = {}


def advance(*arguments: Any) -> int:
    """See `compiled.advance`. By the types of the arguments: made once per process."""
    kinds = tuple(map(machine_code.kind_of, arguments))
    if kinds not in _LOADED:
        code = machine_code.machine_code(_file(kinds), lambda: _make(kinds))
        _LOADED[kinds] = code.function("advance", *machine_code.c_types(kinds))
    return _LOADED[kinds](*machine_code.flat(arguments))


def _make(kinds: tuple[str, ...]) -> tuple[bytes, bool]:
    from robomill.orchestration.loop import compiled  # it needs Numba, which takes half a second to import

    return machine_code.object_code({"advance": (compiled.advance, machine_code.numba_types(kinds))}, compiled.OPTIONS)


def _file(kinds: tuple[str, ...]) -> Path:
    """Named after what the code is made from."""
    sources = [Path(str(m.__file__)) for m in (operations, machine_code)] + [Path(__file__).with_name("compiled.py")]
    digest = hashlib.sha256(b"".join(f.read_bytes() for f in sources) + repr(kinds).encode())
    folder = user_folder() / "numba" / digest.hexdigest()[:20]
    use(folder)
    return folder / "advance"
