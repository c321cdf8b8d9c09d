"""What a figure is drawn on: the width of the page, or that of a phone."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from matplotlib.figure import Figure

from robomill.report.style import WIDTH

LINE = 0.19
"""Inches that a line of text takes."""
LETTERS = 11.5, 12.0
"""Letters of a title per inch of the sheet, and of a label that stands before the axes and may take half of it."""


@dataclass(frozen=True)
class Sheet:
    """Paper of a width [inches]."""

    width: float

    @property
    def narrow(self) -> bool:
        """Whether things must stand below each other."""
        return self.width < WIDTH

    def figure(self, height: float, entries: int = 1) -> Figure:
        """An empty figure of this height [inches] and a legend of so many entries."""
        return Figure(figsize=(self.width, height + (LINE * (entries - 1) if self.narrow else 0.0)), layout="constrained")

    def legend(self, figure: Figure, handles: Sequence[Any]) -> None:
        """Put the legend above the axes: in a line, or in a column where that would be too long."""
        columns = 1 if self.narrow else len(handles)
        figure.legend(handles=list(handles), loc="outside upper right", ncols=columns, borderaxespad=0.0, handlelength=1.8)

    def title(self, text: str) -> str:
        """A title in as many lines as it needs."""
        return textwrap.fill(text, round(LETTERS[0] * self.width))

    def label(self, text: str) -> str:
        """A label before the axes, broken where it would take more than half of them."""
        return textwrap.fill(text, round(0.5 * LETTERS[1] * self.width))
