"""Runs in the forms that other tools take: pandas, xarray, CSV, a table in a notebook. The methods of `Run` lead here."""

from __future__ import annotations

import importlib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa
import pyarrow.csv

from robomill.orchestration import html
from robomill.orchestration.errors import MissingPackageError, ResultsError, unknown
from robomill.orchestration.slaves.protocol import base_name

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from robomill.orchestration.runs.run import Run

_AXES = "ijk"


def arrays_of(run: Run, names: Iterable[str] = ()) -> list[str]:
    """Arrays and columns of a run, in its order, or those in `names`. KeyError says which name there is not, and what comes close."""
    known = list(dict.fromkeys(base_name(n) for n in run.columns))
    chosen = list(names)
    for name in chosen:
        if name not in run:
            raise KeyError(unknown("column", name, known))
    return chosen or known


def to_pandas(run: Run, names: Sequence[str] = ()) -> pd.DataFrame:
    """See `Run.to_pandas`."""
    pandas = optional("pandas", "Run.to_pandas")
    columns = _columns(run, names)
    frame: pd.DataFrame = pandas.DataFrame({n: run.columns[n] for n in columns}, index=pandas.Index(run.t, name="t"))
    frame.attrs["units"] = {"t": "s", **{n: run.ports[n].unit or "" for n in columns}}
    return frame


def to_xarray(run: Run, names: Sequence[str] = ()) -> xr.Dataset:
    """See `Run.to_xarray`."""
    xarray = optional("xarray", "Run.to_xarray")
    data = {}
    for name in arrays_of(run, names):
        values = run[name]
        axes = ("t", *(f"{letter}{size}" for letter, size in zip(_AXES, values.shape[1:], strict=False)))
        port = run.ports[next(n for n in run.columns if name in (n, base_name(n)))]
        data[name] = (axes, values, {"units": port.unit or "", "description": port.description})
    made: xr.Dataset = xarray.Dataset(data, coords={"t": ("t", run.t, {"units": "s"})}, attrs={"outcome": run.outcome})
    return made


def to_csv(run: Run, file: str | Path, names: Sequence[str] = (), overwrite: bool = False) -> Path:
    """See `Run.to_csv`."""
    place = Path(file)
    if place.exists() and not overwrite:
        raise ResultsError(f"{place} is there already; choose another name, or allow overwriting (overwrite = True)")
    columns = _columns(run, names)
    pyarrow.csv.write_csv(pa.table({"t": run.t, **{n: run.columns[n] for n in columns}}), place)
    return place


def to_html(run: Run) -> str:
    """A table of the arrays of a run: shape, unit, range, description."""
    rows = []
    for name in arrays_of(run):
        values = run[name]
        span = (f"{values.min():.4g}", f"{values.max():.4g}") if values.size else ("-", "-")
        first = run.ports[next(n for n in run.columns if name in (n, base_name(n)))]
        shape = " x ".join(map(str, values.shape[1:])) or "1"
        rows.append((name, shape, first.unit or "-", *span, first.description))
    end = f"to t = {run.t[-1]:.6g} s" if len(run) else "no rows"
    name = run.info.get("system") or run.folder.name
    caption = f"Run {name}: {run.outcome}, {len(run)} rows, {end}"
    return html.table(caption, ("array", "elements", "unit", "least", "largest", "description"), rows)


def optional(package: str, what: str) -> Any:
    """A package that need not be installed. MissingPackageError says how it is installed."""
    try:
        return importlib.import_module(package)
    except ImportError:
        raise MissingPackageError(
            f"{what} needs the package {package!r}, which is not installed; install it with: pip install robomill[{package}]"
        ) from None


def _columns(run: Run, names: Sequence[str]) -> list[str]:
    """Names of the columns of all arrays, or of those in `names`."""
    wanted = arrays_of(run, names)
    return [n for name in wanted for n in run.columns if name in (n, base_name(n))]
