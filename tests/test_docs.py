"""The pages lead where they say: links between them, their anchors, and the files and modules that they name."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PAGES = sorted(p for p in (*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").rglob("*.md")) if not p.is_symlink())
LINK = re.compile(r"\]\(([^)\s]+)\)")
FENCE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
NAMED = re.compile(
    r"(?<![\w./-])((?:blind|cell|conformance|data|diagnosis|docs|examples|fmus|models|orchestration|robomill|scenarios|tests)/[\w./-]+\.(?:py|md|toml|json|ngc|c|csv|svg|png))\b"
)
HISTORY = ("CHANGELOG.md", "docs/decisions")
"""Pages that name what was there when they were written."""


def name(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def anchors(page: Path) -> set[str]:
    """Anchors of the headings, as the usual renderers make them: lower case, no punctuation, hyphens for blanks."""
    headings = re.findall(r"^#+ +(.+)$", FENCE.sub("", page.read_text(encoding="utf-8")), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in headings}


def broken_links(page: Path) -> Iterator[str]:
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    for target in LINK.findall(text):
        if re.match(r"[a-z]+:", target):
            continue
        place, _, anchor = target.partition("#")
        there = (page.parent / place).resolve() if place else page
        if not there.exists():
            yield f"link to {target}: there is no such file"
        elif anchor and anchor not in anchors(there):
            yield f"link to {target}: no such heading; there are {', '.join(sorted(anchors(there)))}"


def missing_files(page: Path) -> Iterator[str]:
    if not name(page).startswith(HISTORY):
        for path in NAMED.findall(page.read_text(encoding="utf-8")):
            if not (ROOT / path).exists():
                yield f"{path} is named: there is no such file"


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_what_a_page_names_is_there(page: Path) -> None:
    assert not (found := [*broken_links(page), *missing_files(page)]), f"{name(page)}: " + "; ".join(found)


def test_a_broken_link_is_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# One two\n[a](page.md#one-two) [b](page.md#three) [c](nowhere.md)\n```\n[d](nothing.md)\n```\n")
    broken_ones = [t.partition(":")[0] for t in broken_links(page)]
    assert broken_ones == ["link to page.md#three", "link to nowhere.md"]


def test_every_page_is_reached_from_the_readme() -> None:
    reached, new = set(), {ROOT / "README.md"}
    while new:
        reached |= new
        targets = {
            (p.parent / t.partition("#")[0]).resolve()
            for p in new
            if p.suffix == ".md"
            for t in LINK.findall(p.read_text(encoding="utf-8"))
        }
        folders = {q for t in targets if t.is_dir() for q in t.glob("*.md")}
        new = {t for t in targets | folders if t.is_file()} - reached
    assert not (lost := sorted(name(p) for p in set(PAGES) - reached)), f"no way from the README to {', '.join(lost)}"
