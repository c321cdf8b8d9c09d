"""The project's own error classes and the messages raised with them, found in the source."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parent.parent
PACKAGES = ("blind", "cell", "conformance", "diagnosis", "fmus", "models", "orchestration", "robomill")
_ENTRY_METHODS = {"fail", "expected"}
"""Methods that make the error of a file: `Entry` and `Files`."""
_NAMED = {
    "unknown": "unknown {what} {name}; did you mean {close}? available: {names}",
    "available": "{names}",
    "not_there": "no {what} {file}; TOML files in that folder: {names}",
}
"""Functions of orchestration.errors that make a part of a text."""


@dataclass(frozen=True)
class ErrorClass:
    """A class of errors."""

    name: str
    module: str
    bases: tuple[str, ...]
    docstring: str


@dataclass(frozen=True)
class Message:
    """A text that an error is raised with; `{...}` stands for what differs."""

    error: str
    """Name of the class."""
    text: str
    file: str
    line: int
    passed_on: bool
    """It is the text of another error, with a place before it at most."""


@cache
def _trees() -> dict[str, ast.Module]:
    files = (f for package in PACKAGES for f in sorted((ROOT / package).rglob("*.py")) if not _linked(f))
    return {f.relative_to(ROOT).as_posix(): ast.parse(f.read_text(encoding="utf-8")) for f in files}


def _linked(file: Path) -> bool:
    """Whether it lies below one of the links of robomill/ to the folders beside it."""
    return any(p.is_symlink() for p in file.relative_to(ROOT).parents and [ROOT / q for q in file.relative_to(ROOT).parents])


@cache
def error_classes() -> dict[str, ErrorClass]:
    """Own classes by name, bases before those that are derived from them."""
    found: dict[str, ErrorClass] = {}
    classes = [(file, n) for file, tree in _trees().items() for n in ast.walk(tree) if isinstance(n, ast.ClassDef)]
    known = {"Exception", "ValueError", "RuntimeError", "LookupError", "OSError", "ArithmeticError", "KeyError", "TypeError"}
    while new := [(f, n) for f, n in classes if n.name not in found and any(_name(b) in known | found.keys() for b in n.bases)]:
        for file, node in new:
            module = file.removesuffix(".py").replace("/__init__", "").replace("/", ".")
            bases = tuple(_name(b) for b in node.bases)
            found[node.name] = ErrorClass(node.name, module, bases, ast.get_docstring(node) or "")
    return found


@cache
def messages() -> tuple[Message, ...]:
    """The texts of all own errors, in the order of the source."""
    return tuple(m for file, tree in _trees().items() for m in _Finder(file, tree).found())


class _Finder:
    """Looks for errors in a file."""

    def __init__(self, file: str, tree: ast.Module) -> None:
        self.file, self.tree = file, tree
        self.own = _error_of_entries(tree)
        self.constants = {
            node.targets[0].id: node.value.value
            for node in tree.body
            if isinstance(node, ast.Assign)
            and isinstance(node.targets[0], ast.Name)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.value.value, str)
        }
        """Texts that the module gives a name."""

    def found(self) -> Iterator[Message]:
        for node in ast.walk(self.tree):
            if not isinstance(node, ast.Raise) or not isinstance(node.exc, ast.Call):
                continue
            call = node.exc
            name = _name(call.func)
            if name in error_classes():
                error = name
            elif isinstance(call.func, ast.Attribute) and name in _ENTRY_METHODS:
                error = self.own
            else:
                continue
            if not call.args:
                continue
            text = _template(call.args[0])
            for constant, value in self.constants.items():
                text = text.replace(f"{{{constant}}}", value)
            if name == "expected":
                text = f"expected {text}; found {{value}}"
            yield Message(error, text, self.file, node.lineno, not re.search(r"\w{3}", re.sub(r"\{[^{}]*\}", "", text)))


def _error_of_entries(tree: ast.Module) -> str:
    """The class that entries of a file raise: the one that is passed to Entry.load or Entry.read there; else that of whoever reads it."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and _name(node.func.value) == "Entry":
            for argument in (*node.args, *(k.value for k in node.keywords)):
                if _name(argument) in error_classes():
                    return _name(argument)
    return "the error of the file that is read"


def _name(node: ast.expr) -> str:
    return node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else ""


def _template(node: ast.expr) -> str:
    """An expression as a text with `{...}` for what differs."""
    match node:
        case ast.Constant(value=str(text)):
            return text
        case ast.JoinedStr(values=values):
            return "".join(_template(v) for v in values)
        case ast.FormattedValue(value=value):
            return _template(value)
        case ast.BinOp(left=left, op=ast.Add(), right=right):
            return _template(left) + _template(right)
        case ast.IfExp(body=body, orelse=orelse):
            one, other = _template(body), _template(orelse)
            return f"[{one or other}]" if not (one and other) else f"[{one} | {other}]"
        case ast.Call(func=func) if _name(func) in _NAMED:
            return _NAMED[_name(func)]
        case ast.Call(func=ast.Attribute(attr="join", value=ast.Constant())):
            return "{list}"
    return f"{{{_short(node)}}}"


def _short(node: ast.expr) -> str:
    """A name for what stands in a text."""
    match node:
        case ast.Name(id=name):
            return name
        case ast.Attribute(attr=name):
            return name
        case ast.Call(func=func) if _name(func):
            return _name(func)
        case ast.Subscript(value=value, slice=ast.Constant(value=str(key))):
            return key if isinstance(value, ast.Name | ast.Attribute) else "value"
        case ast.Subscript(value=value):
            return _short(value)
    return "value"


_ALLOWED = re.compile(
    r"\b((expected|available|known keys|one of|instead|ends in its unit|minimum|maximum|must (be|increase)|"
    r"at most [^;]* (are|is) (allowed|possible))\b|(variants|conditions|items|files in that folder):)"
)
"""Words before what is allowed or what there is; a list of what was found is none of it."""
_VERBS = (
    "add|allow|ask|break|build|call|check|choose|close|compensate|connect|convert|copy|correct|cut|delete|describe|divide|exchange|export|"
    "fill|free|get|give|identify|import|increase|install|keep|leave|let|load|look|lower|make|map|mark|mend|move|name|open|output|pack|pass|place|"
    "program|put|raise|record|reduce|remove|rename|repair|replace|reset|run|save|say|score|search|see|set|split|start|state|take|try|"
    "turn|unpack|use|wait|widen|write"
)
_ORDER = re.compile(rf"(?:^|[;:,.(] (?:or |and |then )?|\bor |\[|`)(?:{_VERBS})(?![\w.])")
"""An imperative at the beginning of a clause."""
_QUESTION = re.compile(r"; is the .*\?$")


def remedy(text: str) -> str:
    """The part of a message that says what to do: what is expected or available, an order, or a question; empty where none does.

    A message has one if a clause of it names what is allowed (`_ALLOWED`), or begins with an imperative (`_VERBS`).
    """
    if question := _QUESTION.search(text):
        return question[0].lstrip("; ")
    clauses = re.split(r"(?<=[;:]) ", text)
    for i, clause in enumerate(clauses):
        if _ALLOWED.search(clause) or _ORDER.search(("; " if i else "") + clause):
            return " ".join(clauses[i:]).rstrip(";")
    return ""
