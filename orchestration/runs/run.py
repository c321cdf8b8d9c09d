"""Runs on disk, simulated or measured: a folder with `run.toml` and `signals.parquet` (or .csv).

The one place that reads them (`signals` does so for the numbers). A run that is still being written is read from its stream as far
as that goes; one whose process was killed, to the last row that it had (`flight`).
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from robomill.orchestration import html
from robomill.orchestration.errors import ResultsError, unknown
from robomill.orchestration.optional import optional
from robomill.orchestration.runs import flight
from robomill.orchestration.runs.files import LIVE, RUN, SIGNALS
from robomill.orchestration.runs.lock import is_locked
from robomill.orchestration.slaves.protocol import FloatArray, PortData, base_name
from robomill.orchestration.system.toml_text import parse

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

MOST_PANELS = 8
"""Arrays that are drawn where none is named: as many as can be read on one page."""


@dataclass(frozen=True)
class Run:
    """A run in memory: time, one float64 array per column, and what is known about them."""

    folder: Path
    t: FloatArray
    """Time [s], increasing."""
    columns: Mapping[str, FloatArray] = field(repr=False)
    """Values by `component.port` element; booleans are 0.0 and 1.0."""
    ports: Mapping[str, PortData] = field(repr=False)
    """The port of each column; `PortData.name` is without the component."""
    info: Mapping[str, Any] = field(repr=False)
    """run.toml as it is."""

    @property
    def outcome(self) -> str:
        """`finished`, `interrupted`, `failed`, or `running`: still being written, or its process was killed (`info["message"]`)."""
        return str(self.info.get("outcome", "finished"))

    @property
    def components(self) -> tuple[str, ...]:
        """Names of the components that have columns."""
        return tuple(dict.fromkeys(name.partition(".")[0] for name in self.columns))

    def __len__(self) -> int:
        return len(self.t)

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and bool(self._members(name))

    def __getitem__(self, name: str) -> FloatArray:
        """A column, float64[n], or a whole array, float64[n, elements] or [n, rows, columns].

        KeyError says which names come close and what there is.
        """
        members = self._members(name)
        if not members:
            raise KeyError(unknown("column", name, dict.fromkeys(base_name(n) for n in self.columns)))
        if members == [name]:
            return self.columns[name]
        shape = [int(i) for i in members[-1][len(name) + 1 : -1].split(",")]
        stacked = np.stack([self.columns[m] for m in members], axis=1)
        # an array of which only some elements were recorded has no shape: its elements stay in one row
        complete = [f"{name}[{','.join(str(i + 1) for i in index)}]" for index in np.ndindex(*shape)]
        return stacked.reshape(-1, *shape) if complete == members else stacked

    def unit(self, name: str) -> str:
        """Unit of a column or array; "" where it is not known."""
        members = self._members(name)
        if not members:
            raise KeyError(unknown("column", name, dict.fromkeys(base_name(n) for n in self.columns)))
        return self.ports[members[0]].unit or ""

    def _members(self, name: str) -> list[str]:
        return [name] if name in self.columns else [n for n in self.columns if base_name(n) == name]

    def arrays(self, *names: str) -> list[str]:
        """Names of all arrays and scalars, or those in `names`. KeyError says which there is not, and what comes close."""
        known = list(dict.fromkeys(base_name(n) for n in self.columns))
        for name in names:
            if name not in self:
                raise KeyError(unknown("column", name, known))
        return list(names) or known

    def to_pandas(self, *names: str) -> pd.DataFrame:
        """All columns, or those of the arrays in `names`, as float64 over time t [s], which is the index; units are in `attrs["units"]`.

        MissingPackageError without pandas (`pip install robomill[pandas]`); KeyError for an unknown name.
        """
        pandas = optional("pandas", "Run.to_pandas")
        columns = [n for name in self.arrays(*names) for n in self._members(name)]
        frame: pd.DataFrame = pandas.DataFrame({n: self.columns[n] for n in columns}, index=pandas.Index(self.t, name="t"))
        frame.attrs["units"] = {"t": "s", **{n: self.unit(n) for n in columns}}
        return frame

    def to_xarray(self, *names: str) -> xr.Dataset:
        """All arrays, or those in `names`, each over t [s] and one axis per index: a vector of three has the axes (t, i3).

        Variables have the attributes `units` and `description`. MissingPackageError without xarray (`pip install robomill[xarray]`);
        KeyError for an unknown name.
        """
        xarray = optional("xarray", "Run.to_xarray")
        data = {}
        for name in self.arrays(*names):
            values = self[name]
            axes = ("t", *(f"{letter}{size}" for letter, size in zip("ijk", values.shape[1:], strict=False)))
            data[name] = (axes, values, {"units": self.unit(name), "description": self._port(name).description})
        made: xr.Dataset = xarray.Dataset(data, coords={"t": ("t", self.t, {"units": "s"})}, attrs={"outcome": self.outcome})
        return made

    def to_csv(self, file: str | Path, *names: str, overwrite: bool = False) -> Path:
        """Write t [s] and all columns, or those of the arrays in `names`, with all digits; returns the file.

        ResultsError where the file is there and `overwrite` is not given; KeyError for an unknown name.
        """
        place = Path(file)
        columns = {n: self.columns[n] for name in self.arrays(*names) for n in self._members(name)}
        if place.exists() and not overwrite:
            raise ResultsError(f"{place} is there already; choose another name, or allow overwriting (overwrite = True)")
        import pyarrow
        import pyarrow.csv

        pyarrow.csv.write_csv(pyarrow.table({"t": self.t, **columns}), place)
        return place

    def plot(self, *names: str) -> Figure:
        """Draw each of the arrays in `names` over time in a panel of its own; without names the first MOST_PANELS that change.

        The figure has `savefig`; a notebook shows it. KeyError for an unknown name.
        """
        from robomill.orchestration.runs import picture  # matplotlib takes a second to load

        found = self.arrays(*names)
        shown = found if names else [n for n in found if np.ptp(self[n], axis=0).max(initial=0.0) > 0.0][:MOST_PANELS]
        left_out = "" if len(shown) == len(found) else f": {len(shown)} of {len(found)} arrays; plot(name, ...) draws others"
        panels = []
        for name in shown:
            members = self._members(name)
            values = np.stack([self.columns[m] for m in members], axis=1)
            panels.append(picture.Panel(name, self.unit(name), values, [m[len(name) :] for m in members]))
        return picture.draw(self.t, panels, f"{self._title}{left_out}")

    @property
    def _title(self) -> str:
        return str(self.info.get("system") or self.folder.name)

    def _port(self, name: str) -> PortData:
        return self.ports[self._members(name)[0]]

    def _repr_html_(self) -> str:
        rows = []
        for name in self.arrays():
            values = self[name]
            span = (f"{values.min():.4g}", f"{values.max():.4g}") if values.size else ("-", "-")
            shape = " x ".join(map(str, values.shape[1:])) or "1"
            rows.append((name, shape, self.unit(name) or "-", *span, self._port(name).description))
        end = f"to t = {self.t[-1]:.6g} s" if len(self) else "no rows"
        caption = f"Run {self._title}: {self.outcome}, {len(self)} rows, {end}"
        return html.table(caption, ("array", "elements", "unit", "least", "largest", "description"), rows)

    @staticmethod
    def load(folder: str | Path) -> Run:
        """Read a run folder. ResultsError says what is missing or wrong."""
        return load(Path(folder))


def load(folder: Path) -> Run:
    """See `Run.load`."""
    if not folder.is_dir():
        raise ResultsError(f"no run folder {folder}; give a folder that `robomill run` or `robomill import` has written")
    info = read_info(folder)
    if info.get("outcome") == "running" and not is_locked(folder):
        info["message"] = flight.ended(flight.called(folder))
    from robomill.orchestration.runs import signals  # with Arrow

    table = signals.read_table(folder)
    if table.num_columns == 0 or "t" not in table.column_names:
        raise ResultsError(
            f"{folder}: the signals have no column 't' (time in s); they have {', '.join(table.column_names[:20])}; "
            "import a log with `robomill import`, which writes one"
        )
    described = info.get("columns", {})
    columns: dict[str, FloatArray] = {}
    ports: dict[str, PortData] = {}
    for f in table.schema:
        if f.name == "t":
            continue
        said = {**{k.decode(): v.decode() for k, v in (f.metadata or {}).items()}, **described.get(f.name, {})}
        name = described.get(f.name, {}).get("port", f.name)
        columns[name] = signals.values_of(table, f.name, folder)
        ports[name] = _port(name, said)
    t = signals.values_of(table, "t", folder)
    if not np.isfinite(t).all():
        row = int(np.argmin(np.isfinite(t)))
        raise ResultsError(
            f"{folder}: time is {t[row]} in row {row} (counted from zero) of {len(t)}; expected finite numbers that increase [s]; "
            "import the log anew, without that row"
        )
    if not np.all(np.diff(t) > 0.0):
        raise ResultsError(
            f"{folder}: time does not increase after t = {t[:-1][np.diff(t) <= 0.0][0]:.9g} s; import the log anew, cut at that place"
        )
    return Run(folder, t, columns, ports, info)


def check_vacant(folders: Iterable[Path]) -> None:
    """ResultsError that names all of these folders that hold a run: nobody has asked for overwriting.

    One that failed before its first step was done counts as none: there is nothing that could be lost.
    """
    held = {folder: [n for n in (RUN, SIGNALS, LIVE) if (folder / n).exists()] for folder in folders if not _came_to_nothing(folder)}
    found = [f"{folder} already holds a run ({', '.join(names)})" for folder, names in held.items() if names]
    if found:
        raise ResultsError(
            "\n".join(found) + "; choose another folder, or allow overwriting (overwrite = True; --overwrite), "
            "or resume (resume = True; --resume), which keeps what is finished"
        )


def _came_to_nothing(folder: Path) -> bool:
    if not ((folder / RUN).is_file() and (folder / SIGNALS).is_file() and read_info(folder).get("outcome") == "failed"):
        return False
    from robomill.orchestration.runs import signals

    return signals.count(folder / SIGNALS) <= 1  # the first row is that of the start


def read_info(folder: Path) -> dict[str, Any]:
    """run.toml as it is. ResultsError if there is none or it is not valid."""
    file = folder / RUN
    if not file.is_file():
        held = ", ".join(sorted(f.name for f in folder.iterdir())[:20])
        raise ResultsError(
            f"{folder} is not a run: there is no {RUN} in it; it holds {held or 'nothing'}; "
            "name a folder that `robomill run` or `robomill import` has written"
        )
    try:
        return parse(file.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ResultsError(f"{file}: not valid TOML: {error}; correct that line, or run or import it anew") from None


def _port(name: str, said: Mapping[str, Any]) -> PortData:
    dependencies = str(said.get("dependencies", ""))  # "*" = unknown; a measured signal has none
    return PortData(
        name=name.partition(".")[2],
        causality="output",
        type=str(said.get("type", "real")),
        unit=said.get("unit") or None,
        minimum=float(said["minimum"]) if "minimum" in said else None,
        maximum=float(said["maximum"]) if "maximum" in said else None,
        description=str(said.get("description", "")),
        dependencies=None if dependencies == "*" else tuple(dependencies.split()),
    )
