"""The studies behind docs/explanation/validation.md: `make figures` runs them, prints their tables and draws their pictures anew."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.ndimage import uniform_filter1d

from robomill import run
from robomill.cell import milling
from robomill.cell.evaluation import Result, evaluate
from robomill.cell.palette import BLUE, GREEN, ORANGE, RED
from robomill.cell.scenario import Scenario, load_scenario
from robomill.models.model.declaration import FloatArray
from robomill.orchestration.errors import OrchestrationError
from robomill.orchestration.system.definition import Connection, System

HERE = Path(__file__).parent
GROOVE = load_scenario(HERE.parent / "scenarios" / "groove.toml")
FIGURES = HERE / "figures"
PLACES = 24
"""Random places of the workpiece that are milled at; those out of reach do not count."""


def results(changes: dict[str, dict[str, Any]], variants: Iterable[str], folder: Path) -> dict[str, Result]:
    """The groove with some parameters changed (None: back to the component's default)."""
    job = milling.prepare(with_changes(GROOVE, changes), folder, overwrite=True)
    for component, values in changes.items():
        for name in (n for n, v in values.items() if v is None):
            old = job.system.component(component)
            kept = {k: v for k, v in old.parameters.items() if k != name}
            parts = tuple(replace(c, parameters=kept) if c is old else c for c in job.system.components)
            job = replace(job, system=replace(job.system, components=parts))
    assert job.scenario.workpiece is not None
    found = {}
    for v in GROOVE.variants:
        if v.name in variants:
            found[v.name] = evaluate(v.name, v.title, milling.mill(job, v)[0], job.scenario.workpiece, 1.0)
    return found


def with_changes(scenario: Scenario, changes: dict[str, dict[str, Any]]) -> Scenario:
    """The scenario with parameters on top of its own."""
    merged = {c: dict(v) for c, v in scenario.parameters.items()}
    for component, values in changes.items():
        merged.setdefault(component, {}).update({k: v for k, v in values.items() if v is not None})
    return replace(scenario, parameters=merged)


def positions(folder: Path) -> None:
    """How much of the uncompensated deviation is left with Cartesian compensation, at random places of the work space."""
    assert GROOVE.workpiece is not None
    rng = np.random.default_rng(0)
    left: list[float] = []
    while len(left) < PLACES:
        place = rng.uniform([1.1, -0.6, 0.9], [1.9, 0.6, 1.7])
        turn = float(rng.choice([0.0, 0.5, 1.0, 1.5])) * math.pi
        workpiece = replace(GROOVE.workpiece, position=tuple(place), abc=(turn, 0.0, 0.0))
        try:
            job = milling.prepare(replace(GROOVE, workpiece=workpiece), folder, overwrite=True)
        except OrchestrationError:
            continue  # out of reach
        pair = [evaluate(v.name, v.title, milling.mill(job, v)[0], workpiece, 1.0).figures.max_deviation_m for v in GROOVE.variants[:2]]
        left.append(pair[1] / pair[0])
    print(f"share left at {len(left)} places: {min(left):.2f} .. {max(left):.2f}, median {np.median(left):.2f}")


def lead_time(folder: Path) -> None:
    """Largest deviation and reaction over the lead time of the pilot force."""
    leads = np.arange(0.0, 0.121, 0.008)
    rows = []
    for lead in leads:
        r = results({"path": {"lead_time": float(lead)}}, ["cartesian_pilot"], folder)["cartesian_pilot"].figures
        rows.append((1e3 * lead, 1e3 * r.max_deviation_m, 1e3 * r.reaction_t50_s))
    table = np.array(rows)
    print("lead ms | max deviation mm | reaction ms")
    for row in rows:
        print("{:7.0f} | {:16.2f} | {:11.0f}".format(*row))
    figure = Figure(figsize=(8, 4), layout="constrained")
    ax = figure.subplots()
    ax.plot(table[:, 0], table[:, 1], "o-", color=BLUE, label="largest deviation")
    ax.set(xlabel="lead time of the pilot force in ms", ylabel="largest deviation in mm", ylim=(0, None))
    ax.axhline(0.3, color=BLUE, ls=":", label="paper: 0.3 mm")
    other = ax.twinx()
    other.plot(table[:, 0], table[:, 2], "s-", color=RED, label="reaction (right axis)")
    other.axhspan(-12, 12, color=RED, alpha=0.12, label="three cycles about none (right axis)")
    other.set_ylabel("reaction (t50) in ms", color=RED)
    handles, labels = (a + b for a, b in zip(ax.get_legend_handles_labels(), other.get_legend_handles_labels(), strict=True))
    figure.legend(handles, labels, fontsize=8, loc="outside lower center", ncols=4)
    figure.savefig(FIGURES / "lead_time.png", dpi=120)


def calibration(folder: Path) -> None:
    """What each parameter that departs from its default does to the figures of the groove."""
    cases: dict[str, dict[str, dict[str, Any]]] = {
        "cell as it ships": {},
        "drive 4.5 Hz (default) instead of 6.5 Hz": {"drive": {"loop_frequency": None}},
        "filter 10 Hz (default) instead of 14 Hz": {"sensor": {"filter_cutoff": None}},
        "sensor stiffness as printed, robot and controller alike": {"compliance": {"sensor_stiffness_scale": None}},
        "all three at their defaults": {
            "drive": {"loop_frequency": None},
            "sensor": {"filter_cutoff": None},
            "compliance": {"sensor_stiffness_scale": None},
        },
    }
    print("case | uncompensated mm | Cartesian mm | axis mm | pilot mm | reaction ms | with pilot ms")
    for name, changes in cases.items():
        r = {k: v.figures for k, v in results(changes, [v.name for v in GROOVE.variants], folder).items()}
        deviations = " | ".join(f"{1e3 * r[v.name].max_deviation_m:.2f}" for v in GROOVE.variants)
        print(f"{name} | {deviations} | {1e3 * r['cartesian'].reaction_t50_s:.0f} | {1e3 * r['cartesian_pilot'].reaction_t50_s:.0f}")


def smooth_loop(folder: Path) -> System:
    """The loop force <-> deflection alone, path -> robot_compliance <-> milling_force, with a cutter whose force has no ripple.

    The robot of this loop has no inertia: it would follow the ripple of the teeth, which only steps below the tooth period
    (1.5 ms) show, so that finer steps would be another system, not the same one better solved. The study therefore takes a
    cutter without ripple: 12 teeth, as deep as their axial pitch, edge coefficients a quarter (same force per depth).
    """
    assert GROOVE.program is not None
    pitch = math.pi * 16.0 / (12 * math.tan(math.radians(30.0)))
    program = folder / "smooth.ngc"
    program.write_text(GROOVE.program.read_text().replace("Z-11.7", f"Z-{pitch:.4f}"))
    edge = {"Kte": "4.5 N/mm", "Kre": "5 N/mm", "Kae": "0.25 N/mm"}
    job = milling.prepare(replace(with_changes(GROOVE, {"milling": {"teeth": 12, **edge}}), program=program), folder, overwrite=True)
    ports = [
        ("path.q_ref", "compliance.q_link", False),
        ("compliance.p_BT_B", "milling.p_BT_B", False),
        ("compliance.quat_BT", "milling.quat_BT", False),
        ("path.v_BT_B", "milling.v_BT_B", False),
        ("path.spindle_speed", "milling.spindle_speed", False),
        ("milling.f_T_B", "compliance.f_T_B", True),
        ("milling.m_T_B", "compliance.m_T_B", True),
    ]
    parts = tuple(c for c in job.system.components if c.name in ("path", "compliance", "milling"))
    return replace(job.system, components=parts, connections=tuple(Connection(*p) for p in ports))


def convergence(folder: Path) -> None:
    """Gauss-Seidel and Jacobi on the loop force <-> deflection as the step shrinks."""
    loop = smooth_loop(folder)
    steps = [4e-3, 2e-3, 1e-3, 5e-4, 2.5e-4]
    signal = {(algorithm, h): deflection(loop, algorithm, h) for algorithm in ("jacobi", "gauss-seidel") for h in steps}
    finest = signal["gauss-seidel", steps[-1]]
    rows = [
        (
            1e3 * h,
            *(1e6 * np.max(np.abs(signal[algorithm, h] - finest)) for algorithm in ("jacobi", "gauss-seidel")),
            1e6 * np.max(np.abs(signal["jacobi", h] - signal["gauss-seidel", h])),
        )
        for h in steps
    ]
    print(
        "step ms | Jacobi um | Gauss-Seidel um | Jacobi - Gauss-Seidel um   (largest difference of the deflection; first two to the finest)"
    )
    for row in rows:
        print("{:7.2f} | {:9.2f} | {:15.2f} | {:10.2f}".format(*row))
    table = np.array(rows)
    figure = Figure(figsize=(7, 4.5), layout="constrained")
    ax = figure.subplots()
    ax.loglog(table[:, 0], table[:, 3], "o-", color=BLUE, label="Jacobi - Gauss-Seidel")
    ax.loglog(table[:, 0], table[:, 1], "s--", color=ORANGE, label="Jacobi - finest")
    ax.loglog(table[:-1, 0], table[:-1, 2], "^--", color=GREEN, label="Gauss-Seidel - finest")
    ax.loglog(table[:, 0], table[0, 3] * table[:, 0] / table[0, 0], "k:", label="first order")
    ax.set(
        xlabel="communication step in ms", ylabel="largest difference of the deflection in um", title="Force <-> deflection in the groove"
    )
    ax.set_xticks(table[:, 0], [f"{h:g}" for h in table[:, 0]])
    ax.set_xticks([], minor=True)
    ax.legend()
    ax.grid(which="both", alpha=0.3)
    figure.savefig(FIGURES / "convergence.png", dpi=120)


def deflection(loop: System, algorithm: str, step: float) -> FloatArray:
    """Deflection every 4 ms [m], [n, 3], of the loop run with an algorithm and a communication step [s].

    Averaged over 24 ms (0.6 mm of feed), so that single dexels (0.2 mm) do not show.
    """
    recorded = run(replace(loop, step=step, algorithm=algorithm), None, stop=6.4)
    every = round(4e-3 / step)
    smooth: FloatArray = uniform_filter1d(recorded["compliance.d_T_B"], 6 * every + 1, axis=0)
    return smooth[::every][20:-20]


if __name__ == "__main__":
    FIGURES.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        for study in (calibration, positions, lead_time, convergence):
            print(f"\n## {study.__doc__}")
            study(Path(scratch))
