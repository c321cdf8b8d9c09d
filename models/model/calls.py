"""What the functions of a model call and read: what compiled code cannot do is named before anything is compiled."""

from __future__ import annotations

import ast
import dis
import inspect
import textwrap
from collections.abc import Callable, Collection, Iterator
from types import FunctionType, ModuleType
from typing import Any

LIBRARIES = frozenset({"builtins", "cmath", "math", "numba", "numpy", "operator"})
"""Packages whose functions Numba knows, or says itself that it does not."""


def check_kernels(*functions: Callable[..., Any]) -> None:
    """ValueError names a Python function that one of these calls, directly or through others, and that lacks `@kernel`.

    A function that compiled code replaces by another one (`numba.extending.overload`) says so by an attribute `is_kernel = True`.
    """
    waiting, seen = [f for f in functions if isinstance(f, FunctionType)], set()
    while waiting:
        caller = waiting.pop()
        if caller.__code__ in seen:
            continue
        seen.add(caller.__code__)
        for called in _called(caller):
            if called.__module__.partition(".")[0] in LIBRARIES:
                continue
            if not getattr(called, "is_kernel", False):
                raise ValueError(
                    f"{caller.__module__}.{caller.__qualname__} calls {called.__module__}.{called.__qualname__} "
                    f"({called.__code__.co_filename}:{called.__code__.co_firstlineno}), which lacks @kernel, so that compiled code cannot "
                    "call it; write @kernel of robomill.models.model.declaration above it"
                )
            waiting.append(called)


def check_fields(fields: Collection[str], *functions: Callable[..., Any]) -> None:
    """ValueError names a field of the record (the first argument of each function) that is read or set there, and is not declared."""
    for function in functions:
        try:
            lines, first = inspect.getsourcelines(function)
        except OSError:  # made from text
            continue
        tree = ast.parse(textwrap.dedent("".join(lines)))
        record = next(iter(inspect.signature(function).parameters))
        for node in ast.walk(tree):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == record and node.attr not in fields:
                raise ValueError(
                    f"{inspect.getsourcefile(function)}:{first + node.lineno - 1}: {record}.{node.attr} is no variable of the model; "
                    f"declare it, or use one of these: {', '.join(fields)}"
                )


def _called(function: FunctionType) -> Iterator[FunctionType]:
    """Python functions that a function reads by name: `helper`, `module.helper`, or one from around it."""
    around = dict(zip(function.__code__.co_freevars, (c.cell_contents for c in function.__closure__ or ()), strict=True))
    value: Any = None
    for instruction in dis.get_instructions(function):
        if instruction.opname == "LOAD_GLOBAL":
            value = function.__globals__.get(instruction.argval)
        elif instruction.opname == "LOAD_DEREF":
            value = around.get(instruction.argval)
        elif instruction.opname in ("LOAD_ATTR", "LOAD_METHOD"):
            value = getattr(value, instruction.argval, None) if isinstance(value, ModuleType) else None
        else:
            value = None
        if isinstance(value, FunctionType):
            yield value
