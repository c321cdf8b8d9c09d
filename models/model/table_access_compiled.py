"""How compiled code reads a number at an address: a load instruction. Numba knows it when this module is imported."""

from __future__ import annotations

from typing import Any

from numba import types
from numba.extending import intrinsic, overload

from robomill.models.model.declaration import COMPILER_OPTIONS
from robomill.models.model.table_access import number_at

OPTIONS: Any = COMPILER_OPTIONS


@intrinsic
def _load(typing_context: Any, address: Any) -> Any:
    """A load instruction."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.load(builder.inttoptr(arguments[0], context.get_value_type(signature.return_type).as_pointer()))

    return types.float64(types.int64), code


@overload(number_at, jit_options=OPTIONS)
def _number_at(address: int) -> Any:
    def compiled(address: int) -> Any:
        return _load(address)  # type: ignore[call-arg]  # Numba gives the context

    return compiled
