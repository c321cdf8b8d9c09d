"""The report of a diagnosis: one HTML file that opens offline, and its figures as SVG and PNG."""

from __future__ import annotations

from pathlib import Path

from robomill.report.figures import draw_all
from robomill.report.page import VIEWER, page
from robomill.report.subject import Subject

__all__ = ["Subject", "write"]


def write(subject: Subject, folder: Path) -> Path:
    """Write report.html and figures/*.svg, *.png into `folder`; returns the page. The same subject gives the same bytes.

    A page VIEWER that lies in `folder` is linked.
    """
    file = folder / "report.html"
    figures = folder / "figures"
    for old in (*figures.glob("*.svg"), *figures.glob("*.png")):  # of an earlier answer
        old.unlink()
    text = page(subject, draw_all(subject, figures), viewer=(folder / VIEWER).is_file())
    file.write_text(text, encoding="utf-8")
    return file
