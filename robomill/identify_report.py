"""What `robomill identify` keeps of a result: report.json, report.txt and pictures in one folder."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

DPI = 110
REPORT = "report.json"


def keep(folder: Path, result: Mapping[str, Any], lines: Sequence[str], pictures: Mapping[str, Figure]) -> None:
    """Write report.json, report.txt and NAME.png of each picture to the folder, which is made."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / REPORT).write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    (folder / "report.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    for name, figure in pictures.items():
        figure.savefig(folder / f"{name}.png", dpi=DPI, metadata={"Software": None})


def finite(value: float) -> float | None:
    """A number that JSON has, or None."""
    return float(value) if np.isfinite(value) else None


def columns(rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table, the first row its head: numbers to the right, texts to the left."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    text = [any(c.isalpha() for row in rows[1:] for c in row[i]) for i in range(len(widths))]
    return ["  ".join(c.ljust(w) if t else c.rjust(w) for c, w, t in zip(row, widths, text, strict=True)).rstrip() for row in rows]
