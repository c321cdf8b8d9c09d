"""What the strings below the attributes of a class say: Python keeps the docstring of a class, but not those."""

from __future__ import annotations

import ast
import inspect
import textwrap
from functools import cache


@cache
def attribute_docs(cls: type) -> dict[str, str]:
    """Attribute -> the string below it; one that stands below several attributes in a row is that of the last one."""
    found: dict[str, str] = {}
    for base in reversed(cls.__mro__):
        if base is not object and base.__module__ not in ("typing", "builtins"):
            found |= _own(base)
    return found


def _own(cls: type) -> dict[str, str]:
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(cls))).body[0]
    except (OSError, TypeError):
        return {}
    found, last = {}, None
    for node in getattr(tree, "body", []):
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            last = node.target.id
        elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str) and last:
            found[last] = inspect.cleandoc(node.value.value)
            last = None
        else:
            last = None
    return found
