"""`robomill identify cubes`: springs of joints, linked arm and arm from cubes on the robot (paper 000, section 2.5).

A measured set is a TOML file beside a table of readings::

    robot = "kr300_r2500_ultra"
    q = ["0 deg", "-60 deg", "60 deg", "0 deg", "0 deg", "0 deg"]
    readings = "readings.csv"       # NAME_1, NAME_2 ... of each cube and spot, one row per load, loaded minus unloaded
    unit = "um"
    [sensors]
    noise = "5 um"                  # of one reading
    averages = 250
    systematic = "0.5 um"
    [given]                         # what is not identified
    compliance = "kr300_r2500_ultra"
    joints = ["sensor"]
    [[cube]]                        # from the base to the flange; the loads act at the centre of the last one
    name = "carousel"
    behind = "axis 1"               # last virtual joint before it
    position = ["300 mm", "-400 mm", "675 mm"]      # centre in B, from the laser tracker
    abc = ["0 deg", "0 deg", "0 deg"]
    [[load]]
    force = ["750 N", 0, 0]         # in B; also moment
"""

from __future__ import annotations

import csv
import json
from argparse import Namespace
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

from robomill.cell.palette import BLUE, GREEN, RED
from robomill.identify_report import columns, finite, keep
from robomill.logs.reading import SUFFIXES, read_log
from robomill.measured_set import MeasuredSetError
from robomill.models.calibration.cubes import (
    CHAIN,
    LEVER,
    MEMBERS,
    ROTATION,
    WAYS,
    Cube,
    CubeFit,
    CubeLoads,
    Setup,
    Spots,
    Triangulation,
    identify_cubes,
    simulate,
    three_two_one,
)
from robomill.models.calibration.stiffness import JOINT_NAMES
from robomill.models.model.declaration import FloatArray
from robomill.models.model.parameters import load
from robomill.models.model.units import convert
from robomill.models.robot.kinematics import load_robot
from robomill.models.robot.virtual_joints import Compliance, load_compliance
from robomill.orchestration.system import keys
from robomill.orchestration.system.entries import Entry
from robomill.orchestration.system.keys import Keys, default, optional, required

DONE, UNSURE = 0, 1
VAGUE = 0.2
"""Relative standard deviation from which on a spring is only roughly known (FACTS10 10.7: not better than 20 to 30 %)."""
UNKNOWN = 1.0
"""From which on nothing is known of it."""
SUSPICIOUS = 2.0
"""Scatter over that of the sensors from which on something else moves, too."""
MICRO = 1e6
AXES = 6


@dataclass(frozen=True)
class MeasuredCubes:
    """A measured set: where everything stands, which loads, and the file of the readings."""

    setup: Setup
    force: FloatArray
    moment: FloatArray
    readings: Path
    unit: str
    known: Compliance | None
    given: tuple[int, ...]

    @property
    def names(self) -> list[str]:
        """Columns of the readings."""
        return [f"{c.name}_{i + 1}" for c in self.setup.cubes for i in range(len(self.setup.spots.points))]


def add_arguments(kinds: Any) -> None:
    """`cubes` below `robomill identify`."""
    kind = kinds.add_parser(
        "cubes",
        help="springs of joints, linked arm and arm from laser triangulation on cubes",
        description="Identify the springs between cubes on the robot from laser triangulation readings, loaded and unloaded.",
        epilog="Example: robomill identify cubes scenarios/cubes/kr300.toml --compare kr300_r2500_ultra",
    )
    kind.add_argument("measured", type=Path, metavar="SET.toml", help="cubes, loads and table of readings (docs/how_to/identify.md)")
    kind.add_argument("--compare", metavar="NAME", help="springs to compare with: name of models/data/compliance or a .toml file")
    kind.add_argument("--simulate", metavar="NAME", help="first write the readings that a robot with these springs gives")
    kind.add_argument("--seed", type=int, default=1, metavar="N", help="of the simulated noise (default: 1)")
    kind.add_argument("--out", type=Path, metavar="DIR", help="write report.json, report.txt and cubes.png")


def run(options: Namespace) -> int:
    """`robomill identify cubes`; status 1 where a spring is negative or known to no better than `VAGUE`."""
    measured = read_set(options.measured)
    if options.simulate is not None:
        write_readings(measured, _compliance(options.simulate), options.seed, options.overwrite)
    try:
        loads = CubeLoads(measured.force, measured.moment, read_readings(measured))
        fit = identify_cubes(measured.setup, loads, measured.known, measured.given)
    except ValueError as error:
        raise MeasuredSetError(f"{measured.readings}: {error}") from error
    compare = _compliance(options.compare) if options.compare else None
    result = result_of(measured, fit, compare)
    lines = say(result)
    if options.out is not None:
        keep(options.out, result, lines, {"cubes": draw(result)})
    if getattr(options, "json", False):
        print(json.dumps(result))
    else:
        print("\n".join(lines))
        if options.out is not None:
            print(f"{options.out}: report.json, report.txt, cubes.png")
    return DONE if all(s["finding"] == "determined" for s in result["springs"]) else UNSURE


def _compliance(name: str) -> Compliance:
    return load(Compliance, name) if name.endswith(".toml") else load_compliance(name)


_STANDARD = Triangulation()


class SensorsKeys(Keys):
    """The laser triangulation sensors."""

    noise = default(f"{_STANDARD.noise} m", keys.quantity("m"), "standard deviation of one reading")
    averages = default(_STANDARD.averages, keys.count(1), "readings that are averaged")
    systematic = default(f"{_STANDARD.systematic} m", keys.quantity("m"), "standard deviation that averaging does not take away")


class SpotsKeys(Keys):
    """Where the sensors look at each cube (default: three, two and one on three faces)."""

    points = required(keys.anything("list of three quantities", "m"), "spots on the cube, from its centre")
    directions = required(keys.anything("list of three numbers"), "directions in which the sensors measure")


class GivenKeys(Keys):
    """Springs that are not identified."""

    compliance = optional(keys.text(), "where they are taken from: a name of models/data/compliance or a .toml file")
    joints = default([], keys.anything("list of texts", allowed=JOINT_NAMES), "which ones; needs `compliance`")


class CubeKeys(Keys):
    """A cube on the robot, from the base to the flange; the loads act at the centre of the last one."""

    name = required(keys.text(), "name of the cube, used once; its columns in the readings are `NAME_1`, `NAME_2` and so on")
    behind = required(keys.choice(MEMBERS), "last virtual joint before it")
    position = required(keys.vector("m"), "its centre in the robot base")
    abc = default([0, 0, 0], keys.vector("rad"), "its orientation in the robot base: Euler angles A about z, B about y', C about x''")


class LoadKeys(Keys):
    """A load on the last cube."""

    force = default([0, 0, 0], keys.vector("N"), "in the robot base")
    moment = default([0, 0, 0], keys.vector("N.m"), "in the robot base")


class CubesKeys(Keys):
    """A measurement of joint springs with cubes on the robot: where everything stands, which loads, and the table of readings."""

    robot = required(keys.text(), "name in models/data/robots, or a .toml file")
    q = required(keys.anything("six quantities", "rad"), "axis angles")
    readings = required(keys.text(), "table beside this file: a column per cube and spot, a row per load, loaded minus unloaded")
    unit = required(keys.text(), "unit of the readings")
    cube = required(keys.each(CubeKeys), "the cubes")
    load = required(keys.each(LoadKeys), "the loads, a row of the readings each")
    sensors = default({}, keys.table(SensorsKeys), "the sensors")
    spots = optional(keys.table(SpotsKeys), "where they look")
    given = default({}, keys.table(GivenKeys), "what is not identified")


def read_set(file: Path) -> MeasuredCubes:
    """The measured set of a TOML file. MeasuredSetError says what is wrong and what is expected."""
    if not file.is_file():
        raise MeasuredSetError(f"no measured set {file}; expected a TOML file of cubes and loads, see docs/how_to/identify.md")
    top = Entry.load(file, MeasuredSetError, convert, name=str(file))
    k, s, c, w = CubesKeys, SensorsKeys, CubeKeys, LoadKeys
    k.of(top)
    sensors = k.sensors.of(top)
    q = k.q.of(top).each()
    if len(q) != AXES:
        raise top["q"].expected("six axis angles")
    cubes, loads, given = k.cube.of(top), k.load.of(top), k.given.of(top)
    with top["cube"].blamed_for(ValueError):
        setup = Setup(
            load_robot(k.robot.of(top)),
            np.array([a.si("rad") for a in q]),
            tuple(
                Cube(
                    c.name.of(cube),
                    MEMBERS.index(c.behind.of(cube)),
                    np.array(c.position.of(cube)),
                    Rotation.from_euler("ZYX", c.abc.of(cube)).as_matrix(),
                )
                for cube in cubes
            ),
            _spots(top),
            Triangulation(s.noise.of(sensors), s.averages.of(sensors), s.systematic.of(sensors)),
        )
    names = [cube.name for cube in setup.cubes]
    if doubles := sorted({n for n in names if names.count(n) > 1}):
        raise top["cube"].fail(f"two cubes are called {doubles[0]!r}; expected a name of its own for each")
    joints = tuple(JOINT_NAMES.index(j.choice(JOINT_NAMES)) for j in GivenKeys.joints.of(given).each())
    if joints and "compliance" not in given:
        raise given.fail("joints without compliance; expected the springs that they are taken from, a name of models/data/compliance")
    return MeasuredCubes(
        setup,
        np.array([w.force.of(load) for load in loads]).reshape(-1, 3),
        np.array([w.moment.of(load) for load in loads]).reshape(-1, 3),
        file.parent / k.readings.of(top),
        k.unit.of(top),
        _compliance(given["compliance"].text()) if "compliance" in given else None,
        joints,
    )


def _spots(top: Entry) -> Spots:
    if "spots" not in top:
        return three_two_one()
    spots = SpotsKeys.of(top["spots"])
    with spots.blamed_for(ValueError):
        return Spots(
            np.array([p.vector("m") for p in spots["points"].each()]), np.array([d.vector("1") for d in spots["directions"].each()])
        )


def read_readings(measured: MeasuredCubes) -> FloatArray:
    """Changes [loads, cubes, spots] m; NaN for empty fields. MeasuredSetError, or LogError, for a table that does not fit."""
    if measured.readings.suffix not in SUFFIXES:
        raise MeasuredSetError(f"{measured.readings}: suffix {measured.readings.suffix!r}; expected one of {', '.join(SUFFIXES)}")
    if not measured.readings.is_file():
        raise MeasuredSetError(
            f"no readings {measured.readings}; expected a table with the columns {measured.names[0]} ... {measured.names[-1]}, one row "
            "per load; --simulate NAME writes what a robot with the springs NAME would give"
        )
    log = read_log(measured.readings, SUFFIXES[measured.readings.suffix])
    table = np.stack([log[name] for name in measured.names], axis=1) * convert(1.0, measured.unit, "m")
    if len(table) != len(measured.force):
        raise MeasuredSetError(f"{measured.readings}: {len(table)} rows, {len(measured.force)} loads; expected one row per [[load]]")
    return table.reshape(len(table), len(measured.setup.cubes), -1)


def write_readings(measured: MeasuredCubes, springs: Compliance, seed: int, overwrite: bool) -> None:
    """Write simulated readings, with the noise of the sensors. MeasuredSetError if there are some already."""
    if measured.readings.exists() and not overwrite:
        raise MeasuredSetError(
            f"{measured.readings} is there already, maybe measured; give --overwrite to replace it by simulated readings"
        )
    change = simulate(measured.setup, springs, measured.force, measured.moment, seed).change
    factor = convert(1.0, "m", measured.unit)
    with measured.readings.open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(measured.names)
        table.writerows([f"{factor * v:.3f}" for v in row.ravel()] for row in change)


def result_of(measured: MeasuredCubes, fit: CubeFit, compare: Compliance | None) -> dict[str, Any]:
    """Everything that is reported, as JSON has it. The value of a spring is that of rotation or lever, whichever is known better."""
    relative, springs = fit.relative_deviation, []
    for i, spring in enumerate(fit.springs):
        way = int(np.argmin(relative[[ROTATION, LEVER], i]))
        c = float(fit.compliance[way, i])
        printed = None if compare is None else float(compare.stiffness[spring.row, spring.column])
        springs.append(
            {
                "name": spring.name,
                "stiffness_nm_per_rad": finite(1.0 / c) if c else None,
                "way": WAYS[way],
                "relative_deviation": finite(relative[way, i]),
                "finding": _finding(c, float(relative[way, i])),
                "chain_nm_per_rad": finite(1.0 / fit.compliance[CHAIN, i]),
                "relative_deviations": {w: finite(relative[n, i]) for n, w in enumerate(WAYS)},
                "turn_rad": finite(fit.turn[i]),
                "compared_nm_per_rad": printed,
            }
        )
    return {
        "robot": measured.setup.robot.name,
        "q_rad": measured.setup.q.tolist(),
        "loads": len(measured.force),
        "cubes": [c.name for c in measured.setup.cubes],
        "given": [JOINT_NAMES[r] for r in measured.given],
        "change_deviation_m": fit.expected,
        "scatter_m": fit.scatter,
        "worst": {"load": fit.worst[0] + 1, "cube": measured.setup.cubes[fit.worst[1]].name, "residual_m": fit.worst[2]},
        "springs": springs,
    }


def _finding(compliance: float, deviation: float) -> str:
    if not deviation < UNKNOWN:
        return "not determined"
    if compliance < 0.0:
        return "negative: something else is missing"
    return f"no better than {100 * VAGUE:.0f} %" if deviation > VAGUE else "determined"


def say(result: dict[str, Any]) -> list[str]:
    """Lines of the report, stiffness in 1e6 N.m/rad."""
    compared = result["springs"][0]["compared_nm_per_rad"] is not None
    rows = [["spring", "turn urad", "stiffness", "+- %", "way", *(f"{w} +- %" for w in WAYS), "chain", *["given", "ratio"][: 2 * compared]]]
    for s in result["springs"]:
        k, printed = s["stiffness_nm_per_rad"], s["compared_nm_per_rad"]
        rows.append(
            [
                s["name"], _number(s["turn_rad"], MICRO, ".0f"), _number(k, 1 / MICRO), _percent(s["relative_deviation"]), s["way"],
                *(_percent(s["relative_deviations"][w]) for w in WAYS), _number(s["chain_nm_per_rad"], 1 / MICRO),
                *([_number(printed, 1 / MICRO), _number(k / printed if k else None, 1.0, ".2f")] if compared else []),
            ]
        )  # fmt: skip
    vague = [f"{s['name']} ({s['finding']})" for s in result["springs"] if s["finding"] != "determined"]
    expected, scatter, worst = result["change_deviation_m"], result["scatter_m"], result["worst"]
    lines = [
        f"{result['robot']}: {result['loads']} loads, cubes {', '.join(result['cubes'])}; stiffness in 1e6 N.m/rad",
        *columns(rows),
        f"a change of a reading: {MICRO * expected:.2f} um from the sensors, {MICRO * scatter:.2f} um scatter about the chain; most at "
        f"load {worst['load']}, {worst['cube']}, {MICRO * worst['residual_m']:.2f} um",
        f"not well known: {', '.join(vague) or 'none'}",
    ]
    if scatter > SUSPICIOUS * expected:
        lines.append(
            "the readings scatter more than the sensors do: a cube has slipped, its place or the pose is wrong, a spring sits elsewhere "
            "than assumed, or something else yields; look at that cube. Rotation depends on no place"
        )
    return lines


def _number(value: float | None, factor: float, form: str = ".3g") -> str:
    return "-" if value is None else f"{factor * value:{form}}"


def _percent(value: float | None) -> str:
    return "-" if value is None or value > UNKNOWN else f"{100 * value:.1f}"


def draw(result: dict[str, Any]) -> Figure:
    """Relative standard deviation of each spring in the three ways; where springs are compared, the ratio with twice it below."""
    springs = result["springs"]
    compared = springs[0]["compared_nm_per_rad"] is not None
    figure = Figure(figsize=(9.5, 5.4 if compared else 3.4), layout="constrained")
    panels = np.atleast_1d(figure.subplots(1 + compared, 1, sharex=True))
    at = np.arange(len(springs))
    for n, (way, color) in enumerate(zip(WAYS, ("0.55", BLUE, GREEN), strict=True)):
        spread = [s["relative_deviations"][way] for s in springs]
        panels[0].bar(
            at + 0.27 * (n - 1), [100 * v if v is not None and v < UNKNOWN else 0.0 for v in spread], 0.27, color=color, label=way
        )
    panels[0].axhline(100 * VAGUE, color=RED, lw=0.8, ls="--", label=f"{100 * VAGUE:.0f} %")
    panels[0].set(ylabel="standard deviation in %", title=f"{result['robot']}: {result['loads']} loads")
    panels[0].legend(fontsize=8, ncols=4)
    if compared:
        known = [(i, s) for i, s in enumerate(springs) if s["stiffness_nm_per_rad"] and s["finding"] != "not determined"]
        ratio = [s["stiffness_nm_per_rad"] / s["compared_nm_per_rad"] for _, s in known]
        bars = [2.0 * s["relative_deviation"] * r for (_, s), r in zip(known, ratio, strict=True)]
        panels[1].errorbar([i for i, _ in known], ratio, bars, fmt="o", ms=4, capsize=3, color=BLUE)
        panels[1].axhline(1.0, color="0.5", lw=0.8)
        panels[1].set_ylabel("identified / given,\n+- two standard deviations")
    panels[-1].set_xticks(at, [s["name"] for s in springs], rotation=60, ha="right", fontsize=8)
    return figure
