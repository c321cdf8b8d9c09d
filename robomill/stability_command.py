"""`robomill stability`: whether the cuts of a program chatter, how far they are from it, and what limits them."""

from __future__ import annotations

import json
import math
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.text import Text

from robomill.cell.scenario import load_scenario
from robomill.cell.stability import Cell, LineStability, judge, lobes_at, map_of, prepare
from robomill.cell.stability_pictures import RPM, SPEEDS, chosen, draw_lobes, draw_map
from robomill.files import vacant
from robomill.tables import Content, Heading, notes, say, show

ANSWER = "stability.json"
STABLE, UNSTABLE = 0, 1
LOWEST, HIGHEST = 0.4, 1.6
"""Spindle speeds shown, over the slowest and the fastest of the program."""
SHOWN = 20
"""Lines in the table: those nearest to their limit."""
MAP_SIDE = 0.6
"""The map reaches so far [m] from the planned place."""
MAP_CELLS = (13, 13)


def run(options: Namespace) -> int:
    """Judge every line that cuts; status 1 if one is unstable. Pictures and stability.json go to the folder."""
    scenario = load_scenario(options.scenario)
    folder: Path = options.out or Path("results") / scenario.name
    if not options.overwrite:
        vacant(folder / ANSWER)
    cell = prepare(scenario, options.modes, options.rigid)
    lines = judge(cell)
    worst = min(lines, key=lambda x: x.margin)
    speeds = _speeds(options.speeds, lines)
    folder.mkdir(parents=True, exist_ok=True)
    result = _figures(scenario.name, cell, lines, speeds)
    files = []
    if not options.no_pictures:
        files.append(draw_lobes(cell, lines, speeds, folder / "stability_lobes.png"))
    if options.map:
        p = cell.planned.placement.to_base(worst.position)
        x, y = (np.linspace(c - MAP_SIDE, c + MAP_SIDE, n) for c, n in zip(p[:2], MAP_CELLS, strict=True))
        margin = map_of(cell, worst, x, y)
        result["map"] = {"line": worst.line, "x_m": x.tolist(), "y_m": y.tolist(), "margin": [[_number(v) for v in row] for row in margin]}
        if not options.no_pictures:
            files.append(draw_map(x, y, margin, worst, (float(p[0]), float(p[1])), folder / "stability_map.png"))
    (folder / ANSWER).write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    files.append(folder / ANSWER)
    if options.json:
        print(json.dumps(result, indent=1))
    else:
        _show(cell, lines, files)
    return STABLE if all(x.stable for x in lines) else UNSTABLE


def _speeds(given: Sequence[float] | None, lines: Sequence[LineStability]) -> tuple[float, float]:
    if given is None:
        planned = [x.spindle_speed for x in lines]
        return LOWEST * min(planned), HIGHEST * max(planned)
    low, high = given
    if not 0.0 < low < high:
        raise ValueError(f"--speeds {low:g} {high:g}: expected two speeds in rev/min, the lower one first and more than 0")
    return low / RPM, high / RPM


def _number(value: float | None) -> float | None:
    """JSON has no infinity."""
    return None if value is None or not math.isfinite(value) else float(value)


def _figures(name: str, cell: Cell, lines: Sequence[LineStability], speeds: tuple[float, float]) -> dict[str, Any]:
    n = np.linspace(*speeds, SPEEDS)
    return {
        "scenario": name,
        "program": cell.planned.name,
        "stable": all(x.stable for x in lines),
        "least_margin": _number(min(x.margin for x in lines)),
        "notes": list(cell.notes),
        "lines": [
            {
                "line": x.line,
                "position_mm": [1e3 * v for v in x.position],
                "spindle_rpm": x.spindle_speed * RPM,
                "depth_mm": 1e3 * x.depth,
                "engaged_deg": [math.degrees(v) for v in x.engaged],
                "stable": x.stable,
                "margin": _number(x.margin),
                "limit_mm": _number(1e3 * x.depth * x.margin),
                "chatter_hz": _number(x.chatter),
                "growth_per_tooth": _number(x.growth),
                "mode_coupling_margin": _number(x.coupling),
                "mode_coupling_hz": _number(x.coupling_frequency),
            }
            for x in lines
        ],
        "lobes": [
            {
                "line": x.line,
                "spindle_rpm": (n * RPM).tolist(),
                "limit_mm": [_number(1e3 * v) for v in lobes_at(cell, x.cut, x.q, n).depth],
            }
            for x in chosen(lines)
        ],
    }


def _show(cell: Cell, lines: Sequence[LineStability], files: Sequence[Path]) -> None:
    numbers = (
        "line",
        "rev/min",
        "depth\nmm",
        "engaged\ndeg",
        "margin",
        "limit\nmm",
        "chatter\nHz",
        "growth\nper tooth",
        "mode\ncoupling",
        "verdict",
    )
    rows: list[list[Content]] = []
    for x in sorted(lines, key=lambda x: x.margin)[:SHOWN]:
        rows.append(
            [
                str(x.line),
                f"{x.spindle_speed * RPM:.0f}",
                f"{1e3 * x.depth:.2f}",
                f"{math.degrees(x.engaged[0]):.0f}..{math.degrees(x.engaged[1]):.0f}",
                f"{x.margin:.2f}" if math.isfinite(x.margin) else "none",
                f"{1e3 * x.depth * x.margin:.2f}" if math.isfinite(x.margin) else "none",
                f"{x.chatter:.1f}" if math.isfinite(x.chatter) else "-",
                "-" if x.growth is None else f"{x.growth:.4f}",
                f"{x.coupling:.2f}" if math.isfinite(x.coupling) else "none",
                "stable" if x.stable else Text("unstable", style="red"),
            ]
        )
    show(f"{cell.planned.name}: margin = limit of the depth over the planned one", list(map(Heading, numbers)), rows)
    if len(lines) > SHOWN:
        say(f"{len(lines) - SHOWN} lines of larger margin are in {ANSWER}")
    notes(cell.notes, ANSWER)
    for file in files:
        print(f"wrote {file}")
