"""A form in the closed loop: the system with it, coefficients fitted there once more, and what it is worth in runs that were held out."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from robomill.diagnosis.experiment.simulation import Laboratory, Simulator
from robomill.diagnosis.inference.fitting import BETTER, SHARPER
from robomill.models.components.file_names import FORM
from robomill.orchestration.slaves.protocol import FloatArray
from robomill.orchestration.system.definition import System

Groups = Sequence[list[FloatArray] | None]


def specification(
    component: str, arrays: Sequence[tuple[str, str, int]], corrected: Sequence[str], terms: Sequence[dict[str, Any]]
) -> dict[str, Any]:
    """The form as plain data (`models.components.correction`).

    `arrays`: (name, unit, elements) of the ports that are read or corrected; `corrected`: names of those that are corrected.
    """
    plain = [{"name": name, "unit": unit, "count": count} for name, unit, count in arrays]
    return {
        "name": f"form_of_{component}",
        "stands_for": component,
        "signals": [a for a in plain if a["name"] not in corrected],
        "corrected": [a for a in plain if a["name"] in corrected],
        "terms": list(terms),
    }


def written(found: dict[str, Any], folder: Path) -> Path:
    """Write a form to a file that is called by its content."""
    text = json.dumps(found, indent=1)
    file = folder / f"{hashlib.sha256(text.encode()).hexdigest()[:16]}{FORM}"
    file.write_text(text + "\n", encoding="utf-8")
    return file


def with_form(laboratory: Laboratory, component: str, file: Path) -> Laboratory:
    """The laboratory, in every condition whose system has the component, with the form in `file`."""

    def corrected(system: System) -> System:
        there = any(c.name == component for c in system.components)
        return system.with_correction(component, str(file)) if there else system

    conditions = [replace(c, system=None if c.system is None else corrected(c.system)) for c in laboratory.conditions]
    return replace(laboratory, system=corrected(laboratory.system), conditions=conditions)


class Loop:
    """Simulations of the conditions with forms of one component in the loop."""

    def __init__(self, simulator: Simulator, folder: Path, scale: FloatArray, groups: Sequence[Sequence[FloatArray]], n: int) -> None:
        """`scale`: weight of each channel; `groups`: measured repeats by condition, of which the first `n` are diagnosed."""
        self.simulator, self.folder, self.scale, self.groups, self.n = simulator, folder, scale, groups, n

    def simulated(self, found: dict[str, Any], conditions: Sequence[int], count: int) -> Groups:
        """`count` repeats of each of these conditions with the form in the loop; None for one that cannot run.

        OrchestrationError where nobody can open the form.
        """
        laboratory = with_form(self.simulator.laboratory, found["stands_for"], written(found, self.folder))
        with self.simulator.beside(laboratory) as beside:
            made = beside.repeated(conditions, (), count, "form")
            self.simulator.count += beside.count
        return made

    def left(self, groups: Groups) -> list[FloatArray] | None:
        """What the simulated `groups` leave of the diagnosed conditions, weighted, [rows, channels]; None where one cannot run."""
        found = []
        for i, group in enumerate(groups):
            if group is None:
                return None
            measured, model = np.mean(self.groups[i], axis=0), np.mean(group, axis=0)
            rows = min(len(measured), len(model))
            on = self.simulator.laboratory.there(self.simulator.laboratory.conditions[i].name)
            found.append((measured[:rows] - model[:rows]) * self.scale * on)
        return found

    def refitted(self, found: dict[str, Any], doubts: FloatArray) -> dict[str, Any] | None:
        """The form with coefficients that leave least in the closed loop; None where the diagnosed conditions cannot run with it.

        Gauss-Newton steps, of half the size where a whole one is too far, as long as they help (`search`). `doubts`: part of each
        coefficient by which it is changed to see what it does.
        """
        every = range(self.n)
        left = self.left(self.simulated(found, every, 1))
        if left is None:
            return None
        for _ in range(SHARPER):
            columns = []
            for k in range(len(found["terms"])):
                other = self.left(self.simulated(_scaled(found, k, 1.0 + float(doubts[k])), every, 1))
                columns.append(np.zeros(sum(x.size for x in left)) if other is None else _flat(left) - _flat(other))
            X, before = np.stack(columns, axis=1) / doubts, _squares(left)
            change = np.linalg.lstsq(X, _flat(left), rcond=1e-8)[0]
            for part in (1.0, 0.5):
                trial = found
                for k, x in enumerate(change):
                    trial = _scaled(trial, k, 1.0 + part * float(x))
                after = self.left(self.simulated(trial, every, 1))
                if after is not None and _squares(after) < before:
                    found, left = trial, after
                    break
            if _squares(left) > BETTER * before:
                break
        return found


def _scaled(found: dict[str, Any], k: int, by: float) -> dict[str, Any]:
    terms = [{**t, "coefficient": t["coefficient"] * by} if i == k else t for i, t in enumerate(found["terms"])]
    return {**found, "terms": terms}


def _flat(left: Sequence[FloatArray]) -> FloatArray:
    return np.concatenate([x.ravel() for x in left])


def _squares(left: Sequence[FloatArray]) -> float:
    return float(sum((x**2).sum() for x in left))
