"""Many runs of one scenario or system with other parameters: a row of summaries each.

    >>> table = sweep("scenarios/groove.toml", {"compliance.stiffness_error[2]": [-0.1, 0.0, 0.1], "variant": ["cartesian"]})
    >>> table["peak_force_n"]                    # float64[3], in the order of the grid
    >>> table.to_csv("sweep.csv")

Each process opens a variant once and puts it back before each run (`orchestration.rig`): the numbers are those of a run by itself, bit for
bit, whatever the number of processes. Signals stay in the process that made them; what is kept of a run is its row.
"""

from __future__ import annotations

import csv
import hashlib
import itertools
import json
import math
import pickle
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from robomill.blind.workers import cores, work
from robomill.cell import milling, summaries
from robomill.cell.binding import convert, resolve, with_fmus
from robomill.cell.scenario import Scenario
from robomill.cell.summaries import Function, Summary
from robomill.loading import load
from robomill.orchestration.assembly import Assembly, assemble
from robomill.orchestration.errors import describe, unknown
from robomill.orchestration.rig import Rig
from robomill.orchestration.runs import checkpoint
from robomill.orchestration.runs.lock import FolderLock
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import base_name
from robomill.orchestration.system.definition import System
from robomill.orchestration.system.parameters import prepare

if TYPE_CHECKING:
    import pandas as pd

VARIANT = "variant"
"""Name of the parameter that chooses a variant of a scenario."""
ERROR = "error"
"""Column with the message of a run that failed."""
ROWS, SETUP, SHARED, TABLE = "rows.jsonl", "sweep.json", "setup.pickle", "table.csv"
_CHUNKS_PER_WORKER, _LARGEST_CHUNK = 8, 100
"""Runs go to the processes in parcels: several each, so that all end together, and none so large that a broken sweep loses much."""

Parameters = Mapping[str, Any]
"""One run: `component.parameter` (or an element of it) -> value, a number in the unit of the port or a text with a unit."""
Progress = Callable[[str, int, int], object]
"""Called with (what is being done, runs done, runs in all)."""


class SweepError(ValueError):
    """A sweep that cannot be made; the text says what is wrong, what there is, and what to do."""


@dataclass(frozen=True)
class SweepTable:
    """A row per run, in the order in which they were asked for."""

    parameters: tuple[str, ...]
    """Columns that were varied."""
    figures: tuple[str, ...]
    """Columns of the summaries."""
    rows: tuple[Mapping[str, Any], ...]
    """Column -> value: parameters as they were given, summaries as float (NaN: the run failed), `error` as text ("": it did not)."""
    warnings: tuple[str, ...] = ()
    """What is unusual about the scenario or system, before anything is varied."""

    @property
    def columns(self) -> tuple[str, ...]:
        """Parameters, summaries, and `error`."""
        return (*self.parameters, *self.figures, ERROR)

    @property
    def failed(self) -> tuple[Mapping[str, Any], ...]:
        """The rows of runs that failed."""
        return tuple(r for r in self.rows if r[ERROR])

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, column: str) -> np.ndarray[Any, Any]:
        """A column (n,): float64 where all of it are numbers, else objects. KeyError says what there is."""
        if column not in self.columns:
            raise KeyError(unknown("column", column, self.columns))
        values = [r.get(column) for r in self.rows]
        if all(isinstance(v, int | float) and not isinstance(v, bool) for v in values):
            return np.array(values, dtype=np.float64)
        found = np.empty(len(values), dtype=object)
        found[:] = values
        return found

    def to_csv(self, file: str | Path) -> Path:
        """Write the table with all digits; values that are lists as JSON. Returns the file."""
        file = Path(file)
        with file.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.writer(stream, lineterminator="\n")
            writer.writerow(self.columns)
            for r in self.rows:
                values = [r.get(c, "") for c in self.columns]
                writer.writerow([json.dumps(v) if isinstance(v, list | tuple) else v for v in values])
        return file

    def to_pandas(self) -> pd.DataFrame:
        """The table as a pandas DataFrame. ImportError says how to get pandas."""
        try:
            import pandas as pd
        except ImportError:
            raise ImportError("to_pandas needs pandas; install it with: pip install pandas") from None
        return pd.DataFrame({c: self[c] for c in self.columns})


def sweep(
    what: str | Path | Scenario | System,
    parameters: Mapping[str, Sequence[Any]] | Sequence[Parameters],
    summaries: Sequence[str | Function] | Mapping[str, str | Function] | None = None,
    folder: str | Path | None = None,
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    stop: float | None = None,
    fmus: str | Path | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> SweepTable:
    """Run a milling scenario or a system once for each set of parameters, and keep the summaries of each run.

    `parameters`: a grid, parameter -> its values, all combinations of which are run (the last varies fastest); or a list of sets. Of a
    scenario all variants are run, unless the parameter `variant` chooses. Plan and pilot force are those of the scenario as it is.
    `summaries`: see `cell.summaries`; a mapping names the columns; default, for a scenario: the figures of `MILLING`.
    `folder` keeps the rows: the same sweep asked for again, or one with more sets, makes only runs that are not in it, and those that
    failed. A folder with a sweep of another system is refused, unless `overwrite`. `jobs`: processes (default: one per core);
    `scheduler`: address of a Dask scheduler whose workers run instead, and see the same files. `stop` [s]: of a system that has none.
    A run that fails is a row with its `error`. Raises SweepError, and what loading and assembling the system raise, before the first run.
    """
    if jobs is not None and jobs < 1:
        raise SweepError(f"jobs = {jobs}: expected at least 1")
    with ExitStack() as stack:
        if folder is None:
            place = Path(stack.enter_context(TemporaryDirectory(prefix="robomill_sweep_")))
        else:
            place = Path(folder)
            place.mkdir(parents=True, exist_ok=True)
            stack.enter_context(FolderLock(place))
        subject = _subject(what, place, None if fmus is None else Path(fmus), stop, progress)
        sets = _sets(parameters, subject)
        setup = _setup(subject, sets, summaries)
        store = _Store(place, setup, overwrite)
        for row in _made(setup, store, [s for s in sets if not store.has(s)], jobs, scheduler, len(sets), progress):
            store.add(row)
        store.tidy()
        names = tuple(dict.fromkeys(n for s in sets for n in s))
        figures = tuple(s.name for s in setup.summaries)
        table = SweepTable(names, figures, tuple(store.row(s, figures) for s in sets), subject.warnings)
        if folder is not None:
            table.to_csv(place / TABLE)
        return table


# What is run


@dataclass(frozen=True)
class _Subject:
    """A scenario or system made ready."""

    name: str
    systems: Mapping[str, System]
    """By variant; "" where there are none."""
    stop: Mapping[str, float]
    scenario: Scenario | None = None
    warnings: tuple[str, ...] = ()


def _subject(
    what: str | Path | Scenario | System, folder: Path, fmus: Path | None, stop: float | None, progress: Progress | None
) -> _Subject:
    if isinstance(what, str | Path):
        found = load(what)
        if isinstance(found, Run):
            raise SweepError(f"{what} is the folder of a run that has been made; expected a scenario or a system file")
        what = found
    if isinstance(what, System):
        system = what if fmus is None else with_fmus(what, fmus)
        end = system.stop if stop is None else stop
        if end is None and system.stop_when is None:
            raise SweepError(f"system {system.name!r} has no end: give stop, or set stop or stop_when in the system file")
        return _Subject(system.name, {"": system}, {"": math.inf if end is None else end})
    if what.kind != "milling":
        raise SweepError(f"{what.file}: a scenario of kind {what.kind!r} cannot be swept; expected kind 'milling', or a system file")
    if stop is not None:
        raise SweepError("stop goes with systems; a milling scenario lasts as long as its program; leave stop out")
    job = milling.prepare(what, folder, fmus, progress, overwrite=True)
    unusual = milling.check_variants(job, what.variants)
    systems = {v.name: milling.of_variant(job, v) for v in what.variants}
    stops = {name: max(job.steps * s.step, s.stop or 0.0) for name, s in systems.items()}
    return _Subject(what.name, systems, stops, what, (*job.warnings, *unusual))


def _sets(parameters: Mapping[str, Sequence[Any]] | Sequence[Parameters], subject: _Subject) -> list[dict[str, Any]]:
    """The runs in their order. SweepError for what cannot be a set of parameters."""
    if isinstance(parameters, Mapping):
        for name, values in parameters.items():
            if isinstance(values, str) or not isinstance(values, Sequence | np.ndarray) or len(values) == 0:
                raise SweepError(f"parameter {name!r}: {values!r}; expected a list of at least one value")
        sets = [dict(zip(parameters, chosen, strict=True)) for chosen in itertools.product(*parameters.values())]
    else:
        sets = [dict(s) for s in parameters]
    if not sets:
        raise SweepError("no runs: give a grid {parameter: [values]}, or a list of sets {parameter: value}")
    sets = [{name: _plain(value) for name, value in s.items()} for s in sets]
    if subject.scenario is not None:
        variants = list(subject.systems)
        sets = [{VARIANT: v, **s} for s in sets for v in (variants if VARIANT not in s else [s[VARIANT]])]
        bad = next((s[VARIANT] for s in sets if s[VARIANT] not in subject.systems), None)
        if bad is not None:
            raise SweepError(f"{subject.scenario.file}: {unknown('variant', str(bad), variants)}")
    elif any(VARIANT in s for s in sets):
        raise SweepError("the parameter 'variant' goes with scenarios; a system has none: leave it out")
    for name in dict.fromkeys(n for s in sets for n in s if n != VARIANT):
        if not all(name.partition(".")):
            raise SweepError(f"parameter {name!r}: expected component.parameter, such as 'controller.mode'")
    return sets


def _plain(value: Any) -> Any:
    """A value as JSON has it, too: NumPy's numbers and arrays as those of Python."""
    return value.tolist() if isinstance(value, np.generic | np.ndarray) else list(value) if isinstance(value, tuple) else value


@dataclass(frozen=True)
class _Setup:
    """What a process needs to make runs."""

    systems: Mapping[str, System]
    stop: Mapping[str, float]
    summaries: tuple[Summary, ...]
    columns: frozenset[str] | None
    identity: str
    """Hash of all that a row depends on, but its parameters."""


def _setup(subject: _Subject, sets: Sequence[Parameters], asked: Sequence[str | Function] | Mapping[str, str | Function] | None) -> _Setup:
    """Everything checked: summaries, the signals that they need, each value of each parameter."""
    scenario = subject.scenario
    if asked is None:
        if scenario is None:
            raise SweepError("no summaries: say what is kept of a run of this system, such as ['peak(drive.q_link[1])']")
        asked = tuple(summaries.MILLING)
    named = asked.items() if isinstance(asked, Mapping) else (("", a) for a in ([asked] if isinstance(asked, str) else asked))
    try:
        chosen = tuple(summaries.summary(a, name, scenario.workpiece if scenario else None) for name, a in named)
    except ValueError as error:
        raise SweepError(str(error)) from None
    taken = [s.name for s in chosen]
    doubled = {n for n in taken if taken.count(n) > 1} | ({ERROR} & set(taken)) | ({n for s in sets for n in s} & set(taken))
    if doubled or not chosen:
        raise SweepError(f"summaries {', '.join(taken) or '(none)'}: each column needs a name of its own; give a mapping name -> summary")
    needed, about = summaries.columns(chosen), {}
    kept: set[str] = set()
    for variant, system in subject.systems.items():
        own = [s for s in sets if s.get(VARIANT, "") == variant]
        if not own:
            continue
        with assemble(system, resolve, convert) as assembly:
            names = assembly.wiring.column_names()
            for signal in sorted(needed or ()):
                if signal not in names and signal not in map(base_name, names):
                    raise SweepError(f"{subject.name}: {unknown('signal', signal, dict.fromkeys(map(base_name, names)))}")
            kept |= {n for n in names if needed is None or n in needed or base_name(n) in needed}
            _check_values(assembly, own)
            about[variant] = _about(assembly, subject.stop[variant])
    described = [(s.name, s.needs, _described(s.function)) for s in chosen]
    identity = hashlib.sha256(json.dumps([about, described], sort_keys=True, default=str).encode()).hexdigest()
    return _Setup(subject.systems, subject.stop, chosen, None if needed is None else frozenset(kept), identity)


def _described(function: Function) -> str:
    """What a summary is known by: statistics and figures by their settings, functions by their module and name."""
    return f"{function.__module__}.{function.__qualname__}" if hasattr(function, "__qualname__") else repr(function)


def _check_values(assembly: Assembly, sets: Sequence[Parameters]) -> None:
    """Each value once against the ports of its component, so that no run fails for a wrong name or unit. Raises what `prepare` does."""
    seen: set[str] = set()
    for s in sets:
        for name, value in s.items():
            key = json.dumps([name, value], default=str)
            if name == VARIANT or key in seen:
                continue
            seen.add(key)
            component, _, parameter = name.partition(".")
            assembly.system.component(component)
            prepare(component, assembly.slaves[component].ports, {parameter: value}, convert, assembly.system.folder)


def _about(assembly: Assembly, stop: float) -> dict[str, Any]:
    """What the numbers of a run depend on; of files their content, wherever they are."""
    system, identity = assembly.system, checkpoint.identity(assembly.system, assembly.parameters)
    parameters = {
        f"{name}.{key}": v
        for name, values in assembly.parameters.items()
        for key, v in values.items()
        if f"{name}.{key}" not in identity["files"]
    }
    sources = {c.name: (c.source if c.name not in identity["files"] else "", c.rate, c.every) for c in system.components}
    rules = (system.step, stop, system.stop_when, system.algorithm, system.iteration, system.check_ranges)
    return {**identity, "parameters": parameters, "inputs": assembly.inputs, "sources": sources, "rules": rules}


# Running

Row = tuple[dict[str, Any], dict[str, float], str]
"""Parameters, figures, error."""


def _made(
    setup: _Setup, store: _Store, sets: list[dict[str, Any]], jobs: int | None, scheduler: str | None, total: int, progress: Progress | None
) -> Iterator[Row]:
    """The rows of these sets, as they are made."""
    done = total - len(sets)
    report = progress or (lambda what, done, total: None)
    report("sweep", done, total)
    count = min(jobs or cores(), max(len(sets), 1))
    size = max(1, min(_LARGEST_CHUNK, len(sets) // (_CHUNKS_PER_WORKER * count)))
    # runs of one variant together: a process has one rig open
    parcels = [
        group[i : i + size]
        for variant in setup.systems
        for group in [[s for s in sets if s.get(VARIANT, "") == variant]]
        for i in range(0, len(group), size)
    ]
    if count == 1 and scheduler is None:
        rigs = _Rigs(setup)
        parts: Iterator[list[Row]] = ([rigs.row(s) for s in parcel] for parcel in parcels)
    else:
        file = store.share(setup)
        work_ = work(_rows, [(str(file), setup.identity, parcel) for parcel in parcels], count, scheduler)
        parts = (rows for _, rows in work_)
    for rows in parts:
        yield from rows
        done += len(rows)
        report("sweep", done, total)


class _Rigs:
    """The open systems of a setup: the variant that is being run."""

    def __init__(self, setup: _Setup) -> None:
        self.setup = setup
        self._open: tuple[str, Rig] | None = None

    def row(self, parameters: dict[str, Any]) -> Row:
        """Make a run and work out its summaries."""
        try:
            variant = parameters.get(VARIANT, "")
            if self._open is None or self._open[0] != variant:
                self._open = variant, Rig(self.setup.systems[variant], resolve, convert, self.setup.columns)
            changes: dict[str, dict[str, Any]] = {}
            for name, value in parameters.items():
                if name != VARIANT:
                    component, _, parameter = name.partition(".")
                    changes.setdefault(component, {})[parameter] = value
            run = self._open[1].run(changes, self.setup.stop[variant])
            return parameters, {s.name: float(s.function(run)) for s in self.setup.summaries}, ""
        except Exception as error:  # one run of many: its row says what happened
            return parameters, {}, describe(error)


_HERE = threading.local()


def _rows(file: str, identity: str, parcel: list[dict[str, Any]]) -> list[Row]:
    """Rows in a process of a pool or of a cluster, each thread of which has a rig of its own."""
    if getattr(_HERE, "identity", "") != identity:
        _HERE.rigs, _HERE.identity = _Rigs(pickle.loads(Path(file).read_bytes())), identity
    rigs: _Rigs = _HERE.rigs
    return [rigs.row(s) for s in parcel]


# What is kept


class _Store:
    """The rows of a folder, a line of JSON each: what is written stays, however the sweep ends."""

    def __init__(self, folder: Path, setup: _Setup, overwrite: bool) -> None:
        self._folder, self._file = folder, folder / ROWS
        known = folder / SETUP
        self._rows: dict[str, Row] = {}
        if known.is_file() and not overwrite:
            if json.loads(known.read_text(encoding="utf-8")).get("identity") != setup.identity:
                raise SweepError(
                    f"{folder} holds a sweep of another system, of other parameters that are not varied, or with other summaries; "
                    "choose another folder, or allow overwriting (overwrite = True; --overwrite)"
                )
            self._read()
        else:
            self._file.unlink(missing_ok=True)
            content = {"identity": setup.identity, "summaries": [s.name for s in setup.summaries]}
            known.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")

    def _read(self) -> None:
        """Take the complete lines; the last one may have been cut off."""
        if not self._file.is_file():
            return
        text = self._file.read_text(encoding="utf-8")
        whole = text[: text.rfind("\n") + 1]
        if whole != text:
            self._file.write_text(whole, encoding="utf-8")
        for line in whole.splitlines():
            parameters, figures, error = json.loads(line)
            self._rows[_key(parameters)] = parameters, figures, error

    def has(self, parameters: Parameters) -> bool:
        """Whether there is a run with these parameters that did not fail."""
        row = self._rows.get(_key(parameters))
        return row is not None and not row[2]

    def add(self, row: Row) -> None:
        """Keep a row."""
        self._rows[_key(row[0])] = row
        with self._file.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(row) + "\n")

    def row(self, parameters: Parameters, figures: Sequence[str]) -> dict[str, Any]:
        """A row of the table."""
        _, found, error = self._rows[_key(parameters)]
        return {**parameters, **{name: found.get(name, math.nan) for name in figures}, ERROR: error}

    def share(self, setup: _Setup) -> Path:
        """A file that other processes read the setup from. SweepError for a function that cannot be sent."""
        for s in setup.summaries:
            try:
                pickle.dumps(s)
            except (pickle.PicklingError, AttributeError, TypeError) as error:
                raise SweepError(
                    f"summary {s.name!r} cannot be sent to other processes ({error}); define the function in a module, or give jobs = 1"
                ) from None
        file = (self._folder / SHARED).resolve()
        file.write_bytes(pickle.dumps(setup))
        return file

    def tidy(self) -> None:
        """Remove what only the processes needed."""
        (self._folder / SHARED).unlink(missing_ok=True)


def _key(parameters: Parameters) -> str:
    return json.dumps(parameters, sort_keys=True)
