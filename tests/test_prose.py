"""Plain English in the pages: no sentence above 40 words, no misspelling."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PAGES = sorted(
    p
    for p in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").rglob("*.md"))
    if not p.is_symlink() and "decisions" not in p.parts
)
TYPOS = Path(sys.executable).with_name("typos")
LONGEST = 40
"""Words of a sentence, by the project's rule for pages. A formula, a name or a link counts as one."""

SKIPPED = re.compile(r"^(```|~~~).*?^\1|^<!--.*?-->|^(?: {4}|\t).*?$", re.MULTILINE | re.DOTALL)
ONE_WORD = re.compile(r"`[^`]*`|!?\[([^\]]*)\]\([^)]*\)")
ABBREVIATED = re.compile(r"\b((?:e\.g|i\.e|sec|Sec|Fig|Figs|Eq|Eqs|No|p|pp|vs|cf)\.) ")
END = re.compile(r"(?<=[.!?])[)\"*_]*\s+|\n\s*\n|\n(?=\s*(?:[-*|#]|\d+\. ))|\|")
"""Where a sentence ends: full stop, a paragraph, an item of a list, a cell of a table. A colon or a semicolon goes on with it."""


def long_sentences(text: str) -> Iterator[str]:
    """Sentences of a page above LONGEST words, without code and tables of numbers."""
    prose = ONE_WORD.sub(lambda m: m[1] or "code", SKIPPED.sub("", text))
    for sentence in END.split(ABBREVIATED.sub(r"\1", prose)):
        words = [w for w in sentence.split() if re.search(r"[A-Za-z]", w)]
        if len(words) > LONGEST:
            yield f"{len(words)} words: {' '.join(words)}"


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_no_sentence_is_too_long(page: Path) -> None:
    assert not (long := list(long_sentences(page.read_text(encoding="utf-8")))), f"split at one idea each: {'; '.join(long)}"


def test_a_long_sentence_is_found() -> None:
    long = "word " * (LONGEST + 1)
    short = "word " * LONGEST
    text = f"# Title\n\n{long}end.\n\n```\n{long}\n```\n- {short}\n- {short}\n\n| {short} | {short} |\n"
    assert [s.partition(" ")[0] for s in long_sentences(text)] == [str(LONGEST + 2)]


@pytest.mark.parametrize(("between", "found"), [(". ", 0), ("? ", 0), ("; ", 1), (": ", 1), (" (sec. ", 1), ("\n\n", 0)])
def test_only_a_full_stop_ends_a_sentence(between: str, found: int) -> None:
    half = "word " * (LONGEST - 1) + "word"
    assert len(list(long_sentences(f"{half}{between}{half}.\n"))) == found


def test_words_are_spelled_as_in_the_dictionary() -> None:
    """By typos, which knows common misspellings; words of this project that look like one are in pyproject.toml."""
    places = ["README.md", "CONTRIBUTING.md", "CHANGELOG.md", "CITATION.cff", "docs", "examples", "robomill"]
    command = [TYPOS, "--format", "brief", "--no-check-filenames", *places]
    found = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stdout + found.stderr
