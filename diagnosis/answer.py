"""The answer as data: what diagnosis.json holds, and what the report draws."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from diagnosis import gate, next_run
from diagnosis.catalogue import Address
from diagnosis.estimation import Fit
from diagnosis.localise import Projection
from diagnosis.simulation import Laboratory, Simulator, decimate
from orchestration.slave import FloatArray

SCHEMA = "robomill-diagnosis/1"


@dataclass(frozen=True)
class Menu:
    """What the engine is told about the domain: names for groups of channels, and runs that could be made next."""

    titles: Mapping[str, str] = field(default_factory=dict)
    """array or column -> what people call it."""
    projections: Mapping[str, Projection] = field(default_factory=dict)
    """output -> the coordinates (joints) that its residual is projected on."""
    offers: Callable[[], Mapping[str, next_run.Offer]] = dict
    """Kinds of runs that could be made next; called when they are needed."""


@dataclass(frozen=True)
class Diagnosis:
    """The result as data, and what the report draws."""

    result: dict[str, Any]
    adopted: dict[Address, float]
    fits: tuple[Fit, ...] = ()
    channels: tuple[str, ...] = ()
    curves: Mapping[str, dict[str, FloatArray]] = field(default_factory=dict)
    """condition -> t [samples]; measured (mean of the repeats), nominal, adopted [samples, channels]; spread (standard
    deviation) of the repeats [channels], 0 for a single one. Without `adopted` where nothing was fitted."""


def result_of(verdict: str, findings: Sequence[gate.Finding]) -> dict[str, Any]:
    """diagnosis.json as far as it is the same for all verdicts, without `effort_of` it."""
    return {
        "schema": SCHEMA,
        "verdict": verdict,
        "gate": {"usable": verdict != "bad_log", "findings": [asdict(f) for f in findings]},
        "where": [],
        "which": [],
        "how_far": [],
        "next_run": None,
    }


def effort_of(began: float, simulator: Simulator) -> dict[str, Any]:
    """What it took so far; `began`: when, by the monotonic clock [s]."""
    return {"seconds": round(time.monotonic() - began, 1), "simulations": simulator.count, "taken_over": simulator.found}


def curves_of(
    laboratory: Laboratory,
    groups: Sequence[Sequence[FloatArray]],
    nominal: Sequence[Sequence[FloatArray] | None],
    adopted: Sequence[Sequence[FloatArray] | None] = (),
) -> dict[str, dict[str, FloatArray]]:
    """See `Diagnosis.curves`; for as many conditions as were simulated, without those that cannot run."""
    curves = {}
    for i, before in enumerate(nominal):
        after = adopted[i] if adopted else ()
        if before is None or after is None:
            continue
        c, repeats = laboratory.conditions[i], np.stack(groups[i])
        found = curves[f"{c.name}{' (held out)' if c.held_out else ''}"] = {
            "t": decimate(c.grid[:, None], laboratory.decimation)[:, 0],
            "measured": repeats.mean(axis=0),
            "spread": np.sqrt(repeats.var(axis=0, ddof=min(1, len(repeats) - 1)).mean(axis=0)),
            "nominal": np.mean(before, axis=0),
        }
        if after:
            found["adopted"] = np.mean(after, axis=0)
    return curves
