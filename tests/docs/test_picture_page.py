"""docs/pictures.md has every picture that is drawn anywhere."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

from docs.picture_page import GROUPS, PAGE, page
from tests import ROOT

FOLDERS = ("cell", "robomill", "docs", "benchmarks", "blind", "diagnosis", "models", "orchestration")
PICTURES = [p for group in GROUPS for p in group.pictures]
ELSEWHERE = ("docs/tutorials", "docs/recordings", "docs/pictures/site")
"""Pages whose pictures are of the report or of the site, in other folders."""


def drawing(file: Path) -> Iterator[str]:
    """`file:function` of the functions of a module that make a figure of matplotlib; the module itself, if it does outside of any."""
    text = file.read_text(encoding="utf-8")
    if "matplotlib" not in text:
        return
    module, name = ast.parse(text), file.relative_to(ROOT).as_posix()
    inside = [node for node in module.body if isinstance(node, ast.FunctionDef)]
    for node in module.body:
        for call in ast.walk(node):
            made = isinstance(call, ast.Call) and ast.unparse(call.func) in ("Figure", "Picture", "plt.subplots", "plt.figure")
            if made:
                yield f"{name}:{node.name}" if isinstance(node, ast.FunctionDef) and node in inside else name


def test_every_function_that_draws_is_on_the_page() -> None:
    real = [ROOT / f for f in FOLDERS]
    files = [f for folder in real for f in sorted(folder.rglob("*.py")) if not any(p.is_symlink() for p in f.parents)]
    found = {name for f in files for name in drawing(f)}
    assert "cell/pictures.py:forces" in found
    assert "docs/rsi_study.py" in found
    said = [f for p in PICTURES for f in p.functions]
    missing = sorted(name for name in found if not any(name == s or name.startswith(f"{s}/") for s in said))
    assert not missing, f"not in docs/picture_page.py: {', '.join(missing)}"
    # what only passes the figure of another on has an entry as well, if it is a picture of its own
    gone = sorted(
        s for s in said if not (ROOT / s.partition(":")[0]).exists() or (":" in s and f"def {s.partition(':')[2]}(" not in _text(s))
    )
    assert not gone, f"in docs/picture_page.py, and nowhere else: {', '.join(gone)}"


def _text(said: str) -> str:
    return (ROOT / said.partition(":")[0]).read_text(encoding="utf-8")


def test_every_picture_of_the_docs_is_on_the_page() -> None:
    docs = ROOT / "docs"
    shown = {e for p in PICTURES for e in p.examples}
    there = {f.relative_to(docs).as_posix() for f in docs.rglob("*.png") if not f.relative_to(ROOT).as_posix().startswith(ELSEWHERE)}
    assert there == shown


def test_the_page_is_as_the_table_says() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "run `python -m docs.picture_page`"
