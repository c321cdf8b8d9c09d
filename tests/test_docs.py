"""The pages lead where they say: links between them, their anchors, and the files and modules that they name."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.sources import CODE, ROOT, sources

PAGES = sorted(p for p in (*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").rglob("*.md")) if not p.is_symlink())
LINK = re.compile(r"\]\(([^)\s]+)\)")
FENCE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
NAMED = re.compile(
    r"(?<![\w./-])((?:blind|cell|conformance|data|diagnosis|docs|examples|fmus|models|orchestration|robomill|scenarios|tests)/[\w./-]+\.(?:py|md|toml|json|ngc|c|csv|svg|png))\b"
)
TOCTREE = re.compile(r"^```\{toctree\}\n(.*?)^```", re.MULTILINE | re.DOTALL)
PAGE_NAME = re.compile(r"(?<![\w./-])docs/[\w/-]+\.md\b")
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


@pytest.mark.parametrize("page", [p for p in PAGES if not name(p).startswith(HISTORY)], ids=name)
def test_no_page_cites_a_file_that_is_not_here(page: Path) -> None:
    """The specification of the project is no part of the repository; a page says what stands in it, or names the paper."""
    assert not (found := re.findall(r".*\b(?:FACTS\d*|DIAGNOSIS2?|DESIGN|ANCHORS)\b.*", page.read_text(encoding="utf-8"))), found


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


def in_contents(page: Path, root: Path = ROOT) -> set[Path]:
    """Pages that the tables of contents of a page name (directive toctree of Sphinx), patterns among them."""
    lines = [line.strip() for body in TOCTREE.findall(page.read_text(encoding="utf-8")) for line in body.splitlines()]
    found: set[Path] = set()
    for entry in (re.sub(r"^.*<(.+)>$", r"\1", line) for line in lines if line and not line.startswith(":")):
        place = Path(os.path.normpath((root if entry.startswith("/") else page.parent) / entry.lstrip("/")))
        found |= {p for suffix in (".md", ".ipynb") for p in place.parent.glob(place.name + suffix)}
    return found


def test_every_page_is_reached_from_the_contents_of_the_site() -> None:
    """What Sphinx says in seconds, in milliseconds; links and anchors of the built site are checked by `make docs`."""
    reached, new = set(), {ROOT / "docs" / "index.md"}
    while new:
        reached |= new
        new = {t for p in new if p.suffix == ".md" for t in in_contents(p)} - reached
    pages = {p for s in ("md", "ipynb") for p in (ROOT / "docs").rglob(f"*.{s}") if "/." not in p.as_posix()}
    assert not (lost := sorted(name(p) for p in pages - reached)), f"in no table of contents: {', '.join(lost)}"


def test_a_page_in_no_contents_is_found(tmp_path: Path) -> None:
    (tmp_path / "index.md").write_text("# A\n```{toctree}\n:glob:\n\none\nTwo </b/two>\nb/t*\n```\n")
    (tmp_path / "b").mkdir()
    for page in ("one.md", "lost.md", "b/two.md", "b/three.ipynb"):
        (tmp_path / page).write_text("# A page\n")
    named = in_contents(tmp_path / "index.md", tmp_path)
    assert {p.relative_to(tmp_path).as_posix() for p in named} == {"one.md", "b/two.md", "b/three.ipynb"}


def test_pages_that_code_and_data_name_are_there() -> None:
    files = [p for f in (*CODE, "scenarios") for p in sources(ROOT / f, ".py", ".toml")]
    named = {(name(p), page) for p in [*files, ROOT / "Makefile"] for page in PAGE_NAME.findall(p.read_text(encoding="utf-8"))}
    assert not (lost := sorted(f"{place} names {page}" for place, page in named if not (ROOT / page).exists())), "; ".join(lost)
