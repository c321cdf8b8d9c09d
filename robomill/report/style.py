"""Colours and letters of the figures; `style.css` has the same names for light and dark pages."""

from __future__ import annotations

from typing import Any

INK, MUTED, GRID, PAPER = "#1d2733", "#5a6673", "#dde2e8", "#ffffff"
BODY, NOISE, TINT, SHADE = "#cfd6de", "#e6ebf0", "#f2c4ca", "#fbe9bd"
BEFORE, AFTER, MARK = "#b4500f", "#1460aa", "#c2142d"
COLOURS = {
    "ink": INK,
    "muted": MUTED,
    "grid": GRID,
    "paper": PAPER,
    "body": BODY,
    "noise": NOISE,
    "tint": TINT,
    "shade": SHADE,
    "before": BEFORE,
    "after": AFTER,
    "mark": MARK,
}
"""Name in the style sheet -> colour in the files."""
WIDTH, NARROW = 9.6, 4.4
"""Inches: as wide as the page, and as that of a phone."""
STYLE: dict[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.labelsize": 8.5,
    "axes.edgecolor": MUTED,
    "axes.linewidth": 0.6,
    "axes.titlesize": 9.0,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "axes.titlepad": 4.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.facecolor": PAPER,
    "axes.axisbelow": True,
    "figure.facecolor": PAPER,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "path.simplify_threshold": 0.25,
    "svg.fonttype": "none",
    "svg.hashsalt": "robomill",
}
