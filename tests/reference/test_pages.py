"""The pages are those that the program makes now, every row says something, and no sentence is long."""

from __future__ import annotations

import re

import pytest

from reference.markdown import table
from reference.pages import FOLDER, pages

LONGEST = 40
"""Words of a sentence (the rule for all pages)."""
ROW = re.compile(r"^\| (.*) \|$", re.MULTILINE)
BLOCK = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
BY_TYPE_CHECKER = ("python.md", "errors.md", "formats/measured_set.md")
"""Pages whose last column may be empty: attributes that their name and type explain; remedies and quantities have tests of their own."""


@pytest.fixture(scope="module")
def made() -> dict[str, str]:
    return pages()


def test_the_pages_are_those_that_are_made_now(made: dict[str, str]) -> None:
    kept = {f.relative_to(FOLDER).as_posix(): f.read_text(encoding="utf-8") for f in FOLDER.rglob("*.md")}
    assert kept.keys() == made.keys(), "run `make reference`"
    stale = [name for name, text in made.items() if kept[name] != text]
    assert not stale, f"run `make reference`; other than what the program says now: {', '.join(stale)}"


def test_every_row_has_a_meaning(made: dict[str, str]) -> None:
    empty = [
        f"{name}: {row}"
        for name, text in made.items()
        if name not in BY_TYPE_CHECKER
        for row in ROW.findall(text)
        if not row.split(" | ")[-1]
    ]
    assert not empty


def test_a_table_has_no_column_that_is_empty_but_its_last() -> None:
    rows = [("`a`", "", "", "1", ""), ("`b`", "m", "", "", "")]
    assert table(("key", "unit", "allowed", "default", "meaning"), rows).splitlines() == [
        "| key | unit | default | meaning |",
        "|---|---|---|---|",
        "| `a` |  | 1 |  |",
        "| `b` | m |  |  |",
    ]
    assert table(("key", "meaning"), []) == ""


def test_no_sentence_is_long(made: dict[str, str]) -> None:
    long = [s for name, text in made.items() if name != "errors.md" for s in sentences(text) if len(s.split()) > LONGEST]
    assert not long


def test_a_long_sentence_is_found() -> None:
    text = f"# T\n\n| a | {'word ' * 41}. |\n\nShort one. {'other ' * 41}."
    assert [len(s.split()) > LONGEST for s in sentences(text)] == [False, False, True, False, True]


def sentences(text: str) -> list[str]:
    """Sentences of headings, paragraphs and cells, without code."""
    blocks = BLOCK.sub("", text).split("\n\n")
    texts = [t for b in blocks for t in (re.split(r"(?<!\\) \| |\n", b) if b.startswith("|") else [b])]
    return [s.strip("| ") for t in texts for s in re.split(r"(?<=[.!?;]) ", t.replace("\n", " ")) if s.strip("| ")]
