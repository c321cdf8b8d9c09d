"""Plain English in the pages: no sentence above 40 words, no misspelling."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PAGES = sorted(
    p
    for p in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").rglob("*.md"))
    if not p.is_symlink() and "decisions" not in p.parts
)
LONGEST = 40
"""Words of a sentence, by the project's rule for pages. A formula, a name or a link counts as one."""

SKIPPED = re.compile(r"^(```|~~~).*?^\1|^<!--.*?-->|^(?: {4}|\t).*?$", re.MULTILINE | re.DOTALL)
ONE_WORD = re.compile(r"`[^`]*`|!?\[([^\]]*)\]\([^)]*\)")
END = re.compile(r"(?<=[.!?;:])[)\"*_]*\s+|\n\s*\n|\n(?=\s*(?:[-*|#]|\d+\. ))|\s\|\s|\|")
"""Where an idea ends: punctuation, a paragraph, an item of a list, a cell of a table."""


def long_sentences(text: str) -> Iterator[str]:
    """Sentences of a page above LONGEST words, without code and tables of numbers."""
    prose = ONE_WORD.sub(lambda m: m[1] or "code", SKIPPED.sub("", text))
    for sentence in END.split(prose):
        words = [w for w in sentence.split() if re.search(r"[A-Za-z]", w)]
        if len(words) > LONGEST:
            yield f"{len(words)} words: {' '.join(words)}"
