"""Docstrings say what a thing is or does by themselves: none begins in the middle of a sentence that another one has begun."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

from tests.sources import CODE, ROOT, sources

BEGINNING = re.compile(r"(Of|The same|Whether that)\b")


def docstrings(text: str) -> Iterator[tuple[int, str]]:
    """Line and text of every string that stands by itself: docstrings, and those of attributes and constants."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.lineno, node.value.value


def test_no_docstring_begins_in_the_middle_of_a_sentence() -> None:
    found = []
    files = [path for folder in CODE for path in sources(ROOT / folder, ".py")]
    assert ROOT / "diagnosis" / "engine.py" in files
    for path in files:
        for line, text in docstrings(path.read_text(encoding="utf-8")):
            if BEGINNING.match(text.strip()):
                found.append(f"{path.relative_to(ROOT)}:{line}: {text.strip()}")
    assert not found, "docstrings that begin with 'Of', 'The same' or 'Whether that':\n" + "\n".join(found)


def test_a_docstring_that_does_is_found() -> None:
    made = 'A = 1\n"""Of a thing."""\n\n\ndef f():\n    """ The same again."""\n\n\nclass C:\n    """Often."""\n'
    assert [line for line, text in docstrings(made) if BEGINNING.match(text.strip())] == [2, 6]
