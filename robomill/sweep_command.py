"""`robomill sweep`: a scenario or a system over a grid of parameters, from the command line."""

from __future__ import annotations

import json
import math
import tomllib
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from robomill.option_types import in_unit
from robomill.tables import Heading, say, show

SHOWN = 20
"""Rows on the screen; table.csv has all."""


def add_arguments(parser: Any) -> None:
    """What is varied, what is kept, and where it runs."""
    parser.add_argument("file", type=Path, metavar="FILE.toml", help="milling scenario or system file")
    parser.add_argument(
        "--set",
        dest="sets",
        action="append",
        required=True,
        metavar="NAME=V1,V2",
        help="a parameter (component.parameter) and its values, numbers or with a unit, such as "
        '"milling.tool_wear=0,0.2,0.4"; vectors in brackets; may be repeated: all combinations are run',
    )
    parser.add_argument("--variant", action="append", metavar="NAME", help="only this variant of a scenario; may be repeated")
    parser.add_argument(
        "--summary",
        action="append",
        metavar="NAME",
        help="what is kept of a run: a figure such as max_deviation_m, or a statistic of a signal such as "
        '"peak(sensor.f_T_T)"; may be repeated (default, for a scenario: largest and rms deviation of the tool, peak force)',
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for the rows and table.csv (default: results/NAME_sweep)")
    parser.add_argument("--fmus", type=Path, nargs="?", const=Path("dist"), metavar="FOLDER", help="run the FMUs in FOLDER (dist)")
    parser.add_argument("--stop", type=in_unit("s"), metavar="S", help="stop time of a system, s or with a unit")
    parser.add_argument("--jobs", type=int, metavar="N", help="processes (default: one per core)")
    parser.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="run on the workers of this Dask cluster instead")
    parser.add_argument("--overwrite", action="store_true", help="replace a sweep of something else that is in the folder")


def run(options: Namespace) -> int:
    """Make the sweep; status 1 if a run failed."""
    from robomill.progress import progress_bar
    from robomill.run_command import RESULTS
    from robomill.sweeping import ERROR, TABLE, VARIANT, sweep

    grid = dict(_values(text) for text in options.sets)
    if options.variant:
        grid = {VARIANT: options.variant, **grid}
    folder = options.out or RESULTS / f"{options.file.stem}_sweep"
    with progress_bar(options.json) as report:
        table = sweep(
            options.file,
            grid,
            options.summary,
            folder,
            jobs=options.jobs,
            scheduler=options.scheduler,
            stop=options.stop,
            fmus=options.fmus,
            overwrite=options.overwrite,
            progress=report,
        )
    if options.json:
        rows = [{k: None if isinstance(v, float) and math.isnan(v) else v for k, v in r.items()} for r in table.rows]
        print(json.dumps({"folder": str(folder), "rows": rows, "warnings": list(table.warnings)}, indent=1))
        return 1 if table.failed else 0
    columns = (*table.parameters, *table.figures)
    for text in table.warnings:
        say(f"warning: {text}")
    cells = [[_text(r.get(name, "")) for name in columns] for r in table.rows[:SHOWN]]
    show(f"sweep of {options.file}", [Heading(name, folds=True) for name in columns], cells)
    for r in table.failed[:SHOWN]:
        say(f"failed: {r[ERROR]}")
    more = f" ({len(table) - SHOWN} more)" if len(table) > SHOWN else ""
    failed = f", {len(table.failed)} failed" if table.failed else ""
    say(f"{len(table)} runs{failed}{more}: {folder / TABLE}")
    return 1 if table.failed else 0


def _values(text: str) -> tuple[str, Sequence[Any]]:
    """`name=v1,v2`: numbers, lists in brackets, texts with a unit. ValueError for a text without `=` or values."""
    name, sign, values = text.partition("=")
    if not sign or not name.strip() or not values.strip():
        raise ValueError(f"--set {text!r}: expected NAME=V1,V2, such as milling.tool_wear=0,0.2")
    try:
        found: list[Any] = tomllib.loads(f"values = [{values}]")["values"]
    except tomllib.TOMLDecodeError:  # texts without quotes: "20 urad"
        found = [_value(v.strip()) for v in values.split(",")]
    return name.strip(), found


def _value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def _text(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
