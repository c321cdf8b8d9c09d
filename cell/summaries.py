"""What a run comes to as a few numbers: statistics of any signal, and the figures of a milled part.

A summary is a text, or a function of the run:

- ``peak(sensor.f_T_T)``: a statistic (`STATISTICS`) of a signal, `component.port` or one element of it. Of an array it is that of the
  magnitude of the vector.
- a name of `MILLING`: a figure of a milling run.
- a function that takes a `Run` and returns a number.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from robomill.cell.evaluation import Figures, cutting, evaluate
from robomill.cell.scenario import Workpiece
from robomill.models.model.declaration import FloatArray
from robomill.orchestration.errors import unknown
from robomill.orchestration.runs.run import Run

Function = Callable[[Run], float]
"""A summary of one's own: run -> number. With several processes it must be importable, so no lambda."""

STATISTICS: Mapping[str, Callable[[FloatArray], float]] = {
    "max": lambda x: float(np.max(x)),
    "min": lambda x: float(np.min(x)),
    "mean": lambda x: float(np.mean(x)),
    "std": lambda x: float(np.std(x)),
    "rms": lambda x: float(np.sqrt(np.mean(np.square(x)))),
    "peak": lambda x: float(np.max(np.abs(x))),
    "first": lambda x: float(x[0]),
    "last": lambda x: float(x[-1]),
}
"""Statistics over the samples of a run; `peak` is the largest size, whatever the sign."""

_TOOL = ("path.p_BT_B", "compliance.p_BT_B", "milling.depth", "milling.removal_rate")
_SURFACE = ("max_deviation_m", "rms_deviation_m", "p95_deviation_m", "floor_rms_deviation_m", "floor_max_deviation_m", "reaction_t50_s")
_STATISTIC = re.compile(r"\s*(\w+)\s*\(\s*([^()\s]+)\s*\)\s*")


@dataclass(frozen=True)
class Summary:
    """One number of a run."""

    name: str
    """Column of the table."""
    needs: tuple[str, ...] | None
    """Outputs (`component.port`) that it is worked out of; None: any."""
    function: Function


def tool_deviation(run: Run) -> FloatArray:
    """Distance [m] (n,) of the tool tip from where the program wants it at that time, at the samples in which material is cut.

    ValueError if nothing is cut.
    """
    cut = cutting(run)
    if not np.any(cut):
        raise ValueError(
            "nothing is cut: the tool never met the block; correct the place of the block or the program, or leave this figure out"
        )
    return np.asarray(np.linalg.norm(run["compliance.p_BT_B"] - run["path.p_BT_B"], axis=1)[cut])


def _max_tool_deviation(run: Run) -> float:
    return float(np.max(tool_deviation(run)))


def _rms_tool_deviation(run: Run) -> float:
    return float(np.sqrt(np.mean(np.square(tool_deviation(run)))))


def _peak_force(run: Run) -> float:
    return float(np.max(np.linalg.norm(run["sensor.f_T_T"], axis=1)))


MILLING: Mapping[str, tuple[tuple[str, ...], Function]] = {
    "max_tool_deviation_m": (_TOOL, _max_tool_deviation),
    "rms_tool_deviation_m": (_TOOL, _rms_tool_deviation),
    "peak_force_n": (("sensor.f_T_T",), _peak_force),
}
"""Figures of a milling run that need no scan of the machined surface: outputs that each needs, and its function."""


def summary(asked: str | Function, name: str = "", workpiece: Workpiece | None = None) -> Summary:
    """The summary that is asked for, under its own name or `name`.

    `workpiece`: of a milling scenario, whose runs have the figures of `MILLING` and of the scanned surface (as in summary.json: some
    40 ms each run). ValueError says what there is.
    """
    if callable(asked):
        return Summary(name or getattr(asked, "__name__", type(asked).__name__), None, asked)
    if not isinstance(asked, str):
        raise ValueError(f"summary {asked!r}: expected a text such as 'peak(sensor.f_T_T)', or a function of the run")
    if workpiece is not None and asked in MILLING:
        return Summary(name or asked, *MILLING[asked])
    if workpiece is not None and asked in _SURFACE:
        return Summary(name or asked, None, OfSurface(asked, workpiece))
    found = _STATISTIC.fullmatch(asked)
    if found is None or "." not in found[2]:
        there = (*MILLING, *_SURFACE) if workpiece is not None else ()
        raise ValueError(
            f"{unknown('summary', asked, there) if there else f'unknown summary {asked!r}'}; or a statistic of a signal, "
            f"such as 'peak(sensor.f_T_T)', with {', '.join(STATISTICS)}"
        )
    if found[1] not in STATISTICS:
        raise ValueError(f"summary {asked!r}: {unknown('statistic', found[1], STATISTICS)}")
    return Summary(name or asked.strip(), (found[2],), OfSignal(found[1], found[2]))


@dataclass(frozen=True)
class OfSignal:
    """A statistic of a signal."""

    statistic: str
    signal: str

    def __call__(self, run: Run) -> float:
        """Work it out. KeyError names signals that come close."""
        values = run[self.signal]
        sizes = values if values.ndim == 1 else np.linalg.norm(values.reshape(len(values), -1), axis=1)
        return STATISTICS[self.statistic](sizes)


_LAST: list[tuple[Run, Figures]] = []
"""The run that was scanned last, and what came of it: several figures of a run take one scan."""


@dataclass(frozen=True)
class OfSurface:
    """A figure of the machined surface."""

    figure: str
    workpiece: Workpiece

    def __call__(self, run: Run) -> float:
        """Scan the surface. ValueError where there is none, or it has no such figure."""
        if not _LAST or _LAST[0][0] is not run:
            _LAST[:] = [(run, evaluate("", "", run, self.workpiece, float("nan")).figures)]
        figures = _LAST[0][1]
        value = getattr(figures, self.figure)
        if value is None:
            raise ValueError(f"{self.figure} cannot be told: {figures.note or 'no reaction of the controller'}")
        return float(value)


def columns(summaries: Sequence[Summary]) -> frozenset[str] | None:
    """Outputs that these summaries need; None: all."""
    needs = [s.needs for s in summaries]
    return None if None in needs else frozenset(n for need in needs if need is not None for n in need)
