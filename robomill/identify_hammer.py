"""`robomill identify hammer|modes`: damping and modes of a robot from an impact test, measured or simulated."""

from __future__ import annotations

import json
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from robomill.identify_pictures import SHOWN, draw_responses, draw_shapes
from robomill.identify_report import columns, finite, keep
from robomill.measured_set import MeasuredSetError, Quantity, labelled, read_signals
from robomill.models.calibration.hammer import Response, frequency_response, simulated_blows
from robomill.models.calibration.modal_fit import ModalFit, fit_modes
from robomill.models.calibration.mode_shapes import mode_shapes, share
from robomill.models.calibration.tied_damping import GROUPS, DampingFit, fit_damping, pair
from robomill.models.model.declaration import FloatArray
from robomill.models.model.parameters import load
from robomill.models.robot.elastic_modes import ElasticMachine, TipModes, elastic_modes, load_machine
from robomill.models.robot.virtual_joints import Compliance
from robomill.orchestration.runs.importing import write_run
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import PortData

BLOWS = (
    Quantity("time", "s", 1, ("time",), needed=False),
    Quantity("force", "N", 3, ("f_T_B",)),
    Quantity("acceleration", "m/s2", 3, ("a_T_B",)),
    Quantity("q", "rad", 6, ("q_link", "q", "q_motor"), needed=False),
)
BAND = (3.0, 60.0)
"""Lines that the fit uses [Hz]: peaks from 0 to 50 Hz, and room for what leans in from above."""
COLUMN_TILT = (28.0, 46.0)
"""Band [Hz] in which a KR 500 has the mode that its column tilts in (FACTS10 10.6)."""
TOP = 3
"""Springs that are named of a mode."""
DONE, UNSURE = 0, 1


@dataclass(frozen=True)
class ImpactTest:
    """An impact test and the machine that it was made on."""

    responses: tuple[Response, ...]
    fit: ModalFit
    machine: ElasticMachine
    modes: TipModes
    q: FloatArray


def add_arguments(kinds: Any) -> None:
    """`hammer` and `modes` below `robomill identify`."""
    hammer = kinds.add_parser(
        "hammer",
        help="damping of the springs from blows with an impact hammer",
        description="Identify modes and the damping of groups of springs from blows with an impact hammer along x, y and z.",
        epilog="Example: robomill identify hammer --simulate runs/hammer --robot kr210_2 --tool spindle_in_line_300 "
        "--compliance scenarios/kr210/table_3_1.toml --angles 0 -60 100 0 50 0 --out results/hammer",
    )
    hammer.add_argument(
        "--groups", type=int, default=3, choices=sorted(GROUPS), help="groups of springs with one damping each (default: 3)"
    )
    modes = kinds.add_parser(
        "modes",
        help="modes of a robot from an impact test, drawn on the robot",
        description="Identify the modes of a robot from an impact test and draw those of its elastic model that they belong to.",
        epilog="Example: robomill identify modes --simulate runs/stretched --robot kr500_r2830 --tool end_effector_100_kg "
        "--angles 0 0 0 0 0 0 --out results/modes",
    )
    for kind in (hammer, modes):
        kind.add_argument(
            "measured", type=Path, nargs="*", metavar="RUN", help="run folders, or TOML files over columns, one per direction"
        )
        kind.add_argument("--simulate", type=Path, metavar="DIR", help="simulate blows on the elastic robot as runs in DIR, and use them")
        kind.add_argument("--peak", type=float, default=1500.0, metavar="N", help="force of the simulated blows (default: 1500 N)")
        kind.add_argument("--duration", type=float, default=8.0, metavar="S", help="record of each blow (default: 8 s)")
        kind.add_argument("--angles", type=float, nargs=6, metavar="DEG", help="axis angles A1..A6 (default: those of the runs)")
        kind.add_argument("--robot", metavar="NAME", help="name of models/data/robots (default: what the run says)")
        kind.add_argument("--tool", metavar="NAME", help="name of models/data/tools or a .toml file (default: what the run says)")
        kind.add_argument("--compliance", metavar="NAME", help="springs: models/data/compliance or a .toml file (default: of the robot)")
        kind.add_argument("--out", type=Path, metavar="DIR", help="write report.json, report.txt and pictures")


def run_hammer(options: Namespace) -> int:
    """`robomill identify hammer`: modes and dampings; status 1 where one is not determined."""
    test = _test(options)
    try:
        damping = fit_damping(test.fit.modes, test.modes, options.groups)
    except ValueError as error:
        raise MeasuredSetError(str(error)) from error
    result = {**_modes(test), "damping": _damping(damping)}
    lines = [*_say_modes(test), *_say_damping(damping)]
    _show(options, result, lines, {"responses": draw_responses(test.responses, test.fit)})
    return DONE if all(damping.finding(g) == "determined" for g in range(len(damping.groups))) else UNSURE


def run_modes(options: Namespace) -> int:
    """`robomill identify modes`: modes with the springs that they are in, and their shapes."""
    test = _test(options)
    shapes = mode_shapes(test.machine, test.q, test.modes)
    pairs = pair(test.fit.modes, test.modes)
    drawn = [(i, j) for i, j in pairs if test.fit.modes[i].frequency < SHOWN]
    titles = [f"{test.fit.modes[i].frequency:.1f} Hz: {_springs(test.modes, j, 2)}" for i, j in drawn]
    tilt = share(test.modes, "A1 tilt")
    band = (test.modes.frequency > COLUMN_TILT[0]) & (test.modes.frequency < COLUMN_TILT[1])
    column = int(np.argmax(np.where(band, tilt, -1.0))) if band.any() else None
    result = {**_modes(test), "column_tilt": None}
    lines = _say_modes(test)
    if column is not None:
        result["column_tilt"] = {"frequency_hz": float(test.modes.frequency[column]), "share": float(tilt[column])}
        lines.append(
            f"of the model's modes between {COLUMN_TILT[0]:.0f} and {COLUMN_TILT[1]:.0f} Hz that at {test.modes.frequency[column]:.1f} Hz "
            f"has the most tilt of A1, {100 * tilt[column]:.0f} % of its energy"
        )
    _show(
        options,
        result,
        lines,
        {"responses": draw_responses(test.responses, test.fit), "shapes": draw_shapes(shapes, [j for _, j in drawn], titles)},
    )
    return DONE


def _test(options: Namespace) -> ImpactTest:
    """Responses, fit and model of what was measured or is to be simulated."""
    if bool(options.measured) == bool(options.simulate):
        raise MeasuredSetError("expected either RUN folders of blows, or --simulate DIR")
    sources = _simulate(options) if options.simulate else options.measured
    signals = [read_signals(source, BLOWS) for source in sources]
    responses: list[Response] = []
    for source, found in zip(sources, signals, strict=True):
        if "time" not in found:
            raise MeasuredSetError(f"{source}: no time: expected a table [time] with file, columns and unit")
        try:
            response = frequency_response(found["time"][:, 0], found["force"], found["acceleration"], options.duration)
        except ValueError as error:
            raise MeasuredSetError(f"{source}: {error}") from error
        if any(r.direction == response.direction for r in responses):
            raise MeasuredSetError(f"{source}: a second record of blows along {'xyz'[response.direction]}; expected one per direction")
        responses.append(response.within(*BAND))
    try:
        fit = fit_modes(responses)
    except ValueError as error:
        raise MeasuredSetError(f"{', '.join(map(str, sources))}: {error}") from error
    first = Run.load(sources[0]) if sources[0].is_dir() else None
    machine = _machine(options, first)
    if options.angles is not None:
        q = np.deg2rad(options.angles)
    elif "q" in signals[0]:
        q = signals[0]["q"].mean(axis=0)
    else:
        raise MeasuredSetError(f"{sources[0]}: no axis angles: give --angles")
    return ImpactTest(tuple(responses), fit, machine, elastic_modes(machine, q), q)


def _machine(options: Namespace, run: Run | None) -> ElasticMachine:
    """The elastic robot by the options, or by the labels of the run."""
    names = {role: getattr(options, role) or (labelled(run, role) if run is not None else None) for role in ("robot", "tool")}
    for role, name in names.items():
        if name is None:
            raise MeasuredSetError(f"no {role}: give --{role}")
    springs = options.compliance
    if springs is None or not springs.endswith(".toml"):
        return load_machine(str(names["robot"]), str(names["tool"]), springs)
    return replace(load_machine(str(names["robot"]), str(names["tool"])), compliance=load(Compliance, springs))


def _simulate(options: Namespace) -> list[Path]:
    """Runs of blows along x, y and z on the elastic robot."""
    if options.angles is None:
        raise MeasuredSetError("--simulate needs --robot, --tool and --angles; add --angles A1 A2 A3 A4 A5 A6")
    machine = _machine(options, None)
    q = np.deg2rad(options.angles)
    modes = elastic_modes(machine, q)
    folders = []
    for direction, name in enumerate("xyz"):
        time, force, acceleration = simulated_blows(modes, direction, peak=options.peak, duration=options.duration, seed=direction)
        values = {"robot.q_link": np.tile(q, (len(time), 1)), "hammer.f_T_B": force, "sensor.a_T_B": acceleration}
        units = {"robot.q_link": "rad", "hammer.f_T_B": "N", "sensor.a_T_B": "m/s2"}
        flat = {f"{port}[{i + 1}]": v[:, i] for port, v in values.items() for i in range(v.shape[1])}
        ports = {c: PortData(name=c.partition(".")[2], causality="output", unit=units[c.partition("[")[0]]) for c in flat}
        about = {"robot": machine.robot.name, "tool": machine.tool.name, "labels": {"condition": name, "simulated": True}}
        write_run(options.simulate / name, time, flat, ports, about, overwrite=options.overwrite)
        folders.append(options.simulate / name)
    return folders


def _springs(modes: TipModes, j: int, most: int = TOP) -> str:
    """The springs with the largest shares of the energy of a mode."""
    order = np.argsort(-modes.energy_share[:, j])[:most]
    return ", ".join(f"{modes.coordinates[i]} {100 * modes.energy_share[i, j]:.0f} %" for i in order)


def _modes(test: ImpactTest) -> dict[str, Any]:
    of_model = dict(pair(test.fit.modes, test.modes))
    found = []
    for i, m in enumerate(test.fit.modes):
        j = of_model.get(i)
        found.append(
            {
                "frequency_hz": m.frequency,
                "frequency_error_hz": m.frequency_error,
                "damping": m.damping,
                "damping_error": m.damping_error,
                "half_power_damping": finite(m.half_power),
                "peak_inertance": m.peak.tolist(),
                "model_frequency_hz": None if j is None else float(test.modes.frequency[j]),
                "energy": {} if j is None else dict(zip(test.modes.coordinates, test.modes.energy_share[:, j].tolist(), strict=True)),
            }
        )
    return {
        "robot": test.machine.robot.name,
        "tool": test.machine.tool.name,
        "q_rad": test.q.tolist(),
        "blows": {"xyz"[r.direction]: {"number": r.blows, "peak_n": r.peak, "coherence": _coherence(r)} for r in test.responses},
        "modes": found,
        "dropped": list(test.fit.dropped),
        "residual_over_noise": test.fit.residual,
        "model_frequencies_hz": test.modes.frequency.tolist(),
    }


def _coherence(r: Response) -> float:
    """Median coherence of the answer along the blow."""
    return float(np.median(r.coherence[:, r.direction]))


def _say_modes(test: ImpactTest) -> list[str]:
    blows = ", ".join(f"{'xyz'[r.direction]} {r.blows} of {r.peak:.0f} N, coherence {_coherence(r):.3f}" for r in test.responses)
    rows = [["mode", "Hz", "damping", "+-", "half power", "model Hz", "springs of the model"]]
    of_model = dict(pair(test.fit.modes, test.modes))
    for i, m in enumerate(test.fit.modes):
        j = of_model.get(i)
        rows.append(
            [
                str(i + 1),
                f"{m.frequency:.2f}",
                f"{m.damping:.4f}",
                f"{m.damping_error:.4f}",
                "-" if np.isnan(m.half_power) else f"{m.half_power:.3f}",
                "-" if j is None else f"{test.modes.frequency[j]:.2f}",
                "-" if j is None else _springs(test.modes, j),
            ]
        )
    return [f"{test.machine.robot.name}: blows along {blows}", *columns(rows), *(f"left out: {d}" for d in test.fit.dropped)]


def _damping(fit: DampingFit) -> dict[str, Any]:
    return {
        "heuristic_s": fit.heuristic,
        "condition": finite(fit.condition),
        "groups": [
            {"name": name, "beta_s": finite(fit.beta[g]), "relative_error": finite(fit.relative_error[g]), "finding": fit.finding(g)}
            for g, name in enumerate(fit.groups)
        ],
        "model_damping": fit.model_damping.tolist(),
        "heuristic_damping": fit.heuristic_damping.tolist(),
    }


def _say_damping(fit: DampingFit) -> list[str]:
    def listed(values: Sequence[float] | FloatArray) -> str:
        return ", ".join(f"{v:.4f}" for v in values)

    return [
        f"one damping time for all springs (start): {1e3 * fit.heuristic:.3f} ms, damping ratios {listed(fit.heuristic_damping)}",
        f"in {len(fit.groups)} groups, D = time x K: damping ratios {listed(fit.model_damping)}; condition number {fit.condition:.3g}",
        *(
            f"  {name}: {1e3 * fit.beta[g]:.3f} ms +- {100 * fit.relative_error[g]:.0f} %, {fit.finding(g)}"
            for g, name in enumerate(fit.groups)
        ),
    ]


def _show(options: Namespace, result: dict[str, Any], lines: list[str], pictures: dict[str, Any]) -> None:
    if options.out is not None:
        keep(options.out, result, lines, pictures)
    if getattr(options, "json", False):
        print(json.dumps(result))
        return
    print("\n".join(lines))
    if options.out is not None:
        print(f"{options.out}: report.json, report.txt, {', '.join(f'{name}.png' for name in pictures)}")
