"""Every row of docs/explanation/papers.md names a test that there is and that carries the mark `paper`."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from tests import ROOT

PAGE = ROOT / "docs" / "explanation" / "papers.md"
HEAD = ["what", "paper", "reference", "ours", "ratio", "assumption", "test"]
NODE = re.compile(r"`(tests/[\w/]+\.py)((?:::\w+)+)`")
SECTION_7 = {
    "000": ("1.72 mm", "1.4 mm", "0.7 mm", "78 %", "100-150 ms", "axis-specific"),
    "001": ("0.6, 0.2 mm", "0.02 mm", "+-10, 10, 50 N", "1.8, 0.5, 1.1 um/N", "5.5, 36 Hz", "2 ms"),
    "003": ("fine, vibrates, unstable", "250 N", "below 300 N", "0.4 mm overcut", "< 0.1 mm", "0.9, 0.4 mm", "< 0.04 mm", "about 300"),
    "004": ("about a third", "3.14e5", "damping", "limits kept", "three squares and a circle"),
}
"""Paper -> words of the results that the project set out to reproduce."""


def sections() -> dict[str, list[list[str]]]:
    """Rows of the table of each paper."""
    found = {}
    for text in re.split(r"^## Paper ", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]:
        lines = text.split("\n## ")[0].splitlines()  # the sources stand behind the papers
        rows = [[c.strip() for c in line.strip().strip("|").split("|")] for line in lines if line.startswith("|")]
        assert rows[0] == HEAD
        found[text[:3]] = rows[2:]
    return found


def marks(file: Path, names: list[str]) -> set[str] | None:
    """Marks of a test with those of its classes and its file; None if there is no such test."""
    body = ast.parse(file.read_text(encoding="utf-8")).body
    found = {
        m for node in body if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "pytestmark" for m in _named(node.value)
    }
    for name in names:
        node = next((n for n in body if isinstance(n, ast.FunctionDef | ast.ClassDef) and n.name == name), None)
        if node is None:
            return None
        found |= {m for decorator in node.decorator_list for m in _named(decorator)}
        body = node.body
    return found


def _named(node: ast.expr) -> list[str]:
    return re.findall(r"pytest\.mark\.(\w+)", ast.unparse(node))


ROWS = [(paper, *row) for paper, rows in sections().items() for row in rows]


@pytest.mark.parametrize("row", ROWS, ids=lambda r: f"{r[0]} {r[1]}")
def test_a_row_is_complete_and_its_test_is_there_and_marked(row: tuple[str, ...]) -> None:
    assert len(row) == 1 + len(HEAD)
    assert all(row), "a cell is empty; - says that there is nothing"
    match = NODE.fullmatch(row[-1])
    assert match, row[-1]
    file = ROOT / match[1]
    assert file.is_file(), match[1]
    found = marks(file, match[2].removeprefix("::").split("::"))
    assert found is not None, f"there is no {row[-1]}"
    assert "paper" in found, f"{row[-1]} lacks @pytest.mark.paper"


def test_every_result_of_the_papers_has_a_row() -> None:
    found = sections()
    assert set(found) == set(SECTION_7)
    for paper, words in SECTION_7.items():
        text = "\n".join(" ".join(row) for row in found[paper])
        assert not [w for w in words if w not in text], paper


def test_marks_are_found_where_they_stand(tmp_path: Path) -> None:
    file = tmp_path / "t.py"
    file.write_text(
        "pytestmark = [pytest.mark.slow]\n@pytest.mark.paper\nclass A:\n    @pytest.mark.parametrize('x', [1])\n    def f(self, x): ...\n"
        "def g(): ...\n"
    )
    assert marks(file, ["A", "f"]) == {"slow", "paper", "parametrize"}
    assert marks(file, ["g"]) == {"slow"}
    assert marks(file, ["A", "h"]) is None
