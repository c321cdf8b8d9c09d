"""Docstrings say what a thing is or does by themselves: none begins in the middle of a sentence that another one has begun."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parent.parent
FOLDERS = (
    "benchmarks",
    "blind",
    "cell",
    "conformance",
    "diagnosis",
    "docs",
    "examples",
    "fmus",
    "models",
    "orchestration",
    "reference",
    "robomill",
    "tests",
)
BEGINNING = re.compile(r"(Of|The same|Whether that)\b")


def sources(folder: Path) -> Iterator[Path]:
    """Python files below a folder, but for what is linked to: robomill/ has links to the folders beside it."""
    for path in sorted(folder.iterdir()):
        if path.is_dir() and not path.is_symlink():
            yield from sources(path)
        elif path.suffix == ".py":
            yield path


def docstrings(text: str) -> Iterator[tuple[int, str]]:
    """Line and text of every string that stands by itself: docstrings, and those of attributes and constants."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.lineno, node.value.value


def test_no_docstring_begins_in_the_middle_of_a_sentence() -> None:
    found = []
    files = [path for folder in FOLDERS for path in sources(ROOT / folder)]
    assert ROOT / "diagnosis" / "engine.py" in files
    for path in files:
        for line, text in docstrings(path.read_text(encoding="utf-8")):
            if BEGINNING.match(text.strip()):
                found.append(f"{path.relative_to(ROOT)}:{line}: {text.strip()}")
    assert not found, "docstrings that begin with 'Of', 'The same' or 'Whether that':\n" + "\n".join(found)


def test_a_docstring_that_does_is_found() -> None:
    made = 'A = 1\n"""Of a thing."""\n\n\ndef f():\n    """ The same again."""\n\n\nclass C:\n    """Often."""\n'
    assert [line for line, text in docstrings(made) if BEGINNING.match(text.strip())] == [2, 6]
