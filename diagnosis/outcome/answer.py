"""The answer as data: what diagnosis.json holds, and what the report draws."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from robomill.diagnosis.catalogue import Address
from robomill.diagnosis.experiment.simulation import Laboratory, Simulator, decimate
from robomill.diagnosis.gate import checks as gate
from robomill.diagnosis.inference.estimation import Fit
from robomill.diagnosis.localisation.localise import Projection
from robomill.diagnosis.outcome import next_run
from robomill.orchestration.slaves.protocol import FloatArray, PortData, base_name

SCHEMA = "robomill-diagnosis/1"


@dataclass(frozen=True)
class Menu:
    """What the engine is told about the domain: coordinates to project on, and runs that could be made next."""

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
    ports: Mapping[str, PortData] = field(default_factory=dict)
    """channel -> the port of the system that it was measured at."""
    titles: Mapping[str, str] = field(default_factory=dict)
    """array -> what the difference there is called; those that count as figures of their own."""


def titles_of(named: Mapping[str, str], ports: Mapping[str, PortData]) -> dict[str, str]:
    """The measured arrays that the catalogue has a name for; all with the description of their port (or its name), if there is none."""
    arrays: dict[str, list[PortData]] = {}
    for channel, port in ports.items():
        arrays.setdefault(base_name(channel), []).append(port)
    known = {array: title for array, title in named.items() if array in arrays}
    return known or {array: _described(array, members) for array, members in arrays.items()}


def _described(array: str, members: Sequence[PortData]) -> str:
    """Elements that are described one by one have no description in common."""
    common = {p.description for p in members}
    text = common.pop() if len(common) == 1 else ""
    return f"{text} ({array})" if text else array


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


def as_json(result: Mapping[str, Any]) -> str:
    """The text of diagnosis.json. Numbers that are none (a value that nothing determines) are null: JSON has no other word for them."""
    return json.dumps(_finite(result), indent=1, allow_nan=False)


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


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
