"""Path learning as a scenario: guiding points, passes along the unknown part, the program that comes out, and how true it is.

Keys of the file are declared below (`LearningScenarioKeys`), with an example in docs/reference/formats/path_learning.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from robomill.cell.binding import convert, resolve, with_fmus
from robomill.cell.equipment import load_system, robot_of, tool_of
from robomill.cell.experiments import PATH
from robomill.cell.milling import Progress, with_parameters
from robomill.cell.scenario import ComponentParameters, ScenarioError
from robomill.models.calibration.force_loop import ForceLoop
from robomill.models.components.lead_through import COLUMNS as LEAD_COLUMNS
from robomill.models.components.path_learning import FOLLOWING
from robomill.models.components.surface_contact import signed_distances
from robomill.models.model.declaration import FloatArray
from robomill.models.planning.learnt_path import (
    THRESHOLDS,
    LearntPath,
    LearntPathError,
    gcode,
    guiding_orientations,
    learn,
    point_path,
    points_needed,
    rapid,
    reduced,
    smoothed,
)
from robomill.models.planning.trajectory import Placement, plan
from robomill.models.robot.numeric_inverse import solve
from robomill.models.robot.virtual_joints import JOINTS
from robomill.orchestration.assembly import run
from robomill.orchestration.runs.run import Run, check_vacant
from robomill.orchestration.system import keys
from robomill.orchestration.system.definition import System
from robomill.orchestration.system.entries import Entry
from robomill.orchestration.system.keys import Keys, default, optional, required

KIND = "path_learning"
CONTOUR = "contour.npy"
"""Table in the folder of a variant: the real edge."""
OPERATOR = "operator.npy"
"""Table in the folder of the run that is led by hand."""
SMOOTHING = 25
"""Samples (0.1 s, 0.5 mm at 5 mm/s) over which a learnt path is averaged: noise of the force over k, 1 N / (100 N/mm), falls to a fifth."""
NEXT_HEIGHT = 2e-5
"""Deviation height [m] of the program of the next pass: far below what is learnt from it."""
SETTLING = 2.0
"""Seconds after the first contact that are not judged: approach and first transient of the force loop."""
LINE_STEP = 1e-4
"""Step [m] at which the straight lines of a program are judged."""
FORCE_LIMIT = 10.0
"""Filtered force above which the feed stands, over the desired force."""
RIGID = 9.9e96
"""N m/rad: what the files of models/data/compliance write for a joint that does not give way."""


@dataclass(frozen=True)
class Settings:
    """How a path is learnt; SI."""

    force: float
    feed: float
    stiffness: float
    tip_radius: float
    passes: int
    rigid: bool
    name: str


@dataclass(frozen=True)
class LearningVariant:
    """One way to learn the path."""

    name: str
    title: str
    settings: Settings
    parameters: ComponentParameters


@dataclass(frozen=True)
class LearningScenario:
    """A scenario of path learning, paths made absolute; SI."""

    file: Path
    name: str
    title: str
    system: Path
    placement: Placement
    nominal: FloatArray
    """(n, 2) m in P: the edge as drawn."""
    real: FloatArray
    """(n, 2) m in P: the edge as it is."""
    guiding: Mapping[str, Any]
    variants: tuple[LearningVariant, ...]


@dataclass(frozen=True)
class Pass:
    """One motion along the part, in the part frame."""

    run: Run
    position: FloatArray
    """(n, 3) m, of the encoders."""
    learnt: LearntPath
    """Points in contact, with F/k, smoothed."""
    followed: LearntPath
    """All points since the first contact, likewise: the program of the next pass. In the air it is nearer to the part than a bridge."""
    figures: Mapping[str, float]


@dataclass(frozen=True)
class Learnt:
    """What one variant came to."""

    variant: LearningVariant
    guiding: LearntPath
    passes: tuple[Pass, ...]
    program: LearntPath
    figures: Mapping[str, Any]


def is_learning(file: Path) -> bool:
    """Whether a TOML file is a scenario of path learning."""
    try:
        return bool(Entry.load(file, ScenarioError, convert)["scenario"]["kind"].value == KIND)
    except (OSError, KeyError, TypeError, ScenarioError):
        return False


class LearningHeadKeys(Keys):
    """What the scenario is called, and its system."""

    name = required(keys.folder_name(), "name of the scenario; results stand in a folder of that name")
    kind = required(keys.text(), "`path_learning`")
    title = optional(keys.text(), "heading of the results (default: the name)")
    system = required(keys.file(), "system file with path, drive, compliance, contact, sensor and learning")


class PartKeys(Keys):
    """The part: its edge as drawn, and how the real one differs from that."""

    edge = required(keys.file(), "CSV file with a heading: x, y in mm of the nominal edge, material on the left of its direction")
    position = required(keys.vector("m"), "of the part frame in the robot base")
    abc = default([0, 0, 0], keys.vector("rad"), "orientation of the part frame: Euler angles A about z, B about y', C about x''")
    shift = default([0, 0], keys.anything("two quantities", "m"), "how far the real part is moved in x and y; nobody knows it")
    turn = default(0, keys.quantity("rad"), "how far it is turned about its middle, likewise")
    bend = default(0, keys.quantity("m"), "how far it is bent, likewise: y + bend (2 x / length)^2")


class GuidingKeys(Keys):
    """The first path: points taught by hand beside the nominal edge, or led by hand where `lead_through` is given."""

    spacing = default("40 mm", keys.quantity("m"), "distance between taught points, above 0")
    distance = default("1.5 mm", keys.quantity("m"), "from the surface of the tip to the nominal edge")
    scatter = default("0 mm", keys.quantity("m"), "of the hand, one standard deviation in x and y")
    blend = default("1 mm", keys.quantity("m"), "radius in which corners are blended")
    seed = default(1, keys.count(0), "of the scatter")
    lead_through = optional(keys.file(), "system file: the robot is led by hand instead, with lead, drive, compliance and contact")
    operator = optional(keys.file(), "CSV file with a heading, rows of the component lead_through: s, N, N, N, deg/s, deg/s, deg/s, teach")
    start = optional(keys.vector("m"), "where leading begins: tip of the upright tool in the part frame; needed with `lead_through`")


class LearningKeys(Keys):
    """How the path is learnt."""

    force = default("10 N", keys.quantity("N"), "contact force, above 0")
    feed = default("5 mm/s", keys.quantity("m/s"), "feed along the part, above 0")
    stiffness = default("100 N/mm", keys.quantity("N/m"), "of the stylus, above 0; the gain is chosen for it, and its deflection corrected")
    tip_radius = default("1 mm", keys.quantity("m"), "radius of the tip")
    passes = default(1, keys.count(1), "passes along the part")
    rigid = default(False, keys.flag(), "the robot does not give way")
    name = default("learnt", keys.text(), "name of the RAPID module")


class LearningVariantKeys(Keys):
    """One way to learn the path."""

    title = optional(keys.text(), "what the variant is called (default: its name)")
    learning = default({}, keys.table(LearningKeys), "what differs from [learning]")
    parameters = default({}, keys.parameters(), "parameters of this variant alone, with units")


class LearningScenarioKeys(Keys):
    """Path learning: guiding points, passes along an unknown part, and the program that comes out. A scenario of kind `path_learning`."""

    scenario = required(keys.table(LearningHeadKeys), "what the scenario is called, and its system")
    part = required(keys.table(PartKeys), "the part")
    guiding = default({}, keys.table(GuidingKeys), "the first path")
    learning = required(keys.table(LearningKeys), "how the path is learnt")
    parameters = default({}, keys.parameters(), "parameters of all variants, with units")
    variants = required(keys.tables(LearningVariantKeys), "ways to learn the path, by name")


def load_learning(path: str | Path) -> LearningScenario:
    """Read and check a scenario of path learning. ScenarioError says what is wrong and what is possible."""
    file = Path(path).resolve()
    top, k = LearningScenarioKeys.of(Entry.load(file, ScenarioError, convert)), LearningScenarioKeys
    head, part = k.scenario.of(top), k.part.of(top)
    nominal = 1e-3 * _columns(part["edge"], 2)
    common = k.parameters.of(top)
    variants = []
    for name, entry in k.variants.of(top).items():
        own = LearningVariantKeys.parameters.of(entry)
        both = {c: {**common.get(c, {}), **own.get(c, {})} for c in {**common, **own}}
        title = LearningVariantKeys.title.of(entry) or name
        variants.append(LearningVariant(name, title, _settings(k.learning.of(top), LearningVariantKeys.learning.of(entry)), both))
    x, y, z = PartKeys.position.of(part)
    a, b, c = PartKeys.abc.of(part)
    return LearningScenario(
        file,
        LearningHeadKeys.name.of(head),
        LearningHeadKeys.title.of(head) or LearningHeadKeys.name.of(head),
        LearningHeadKeys.system.of(head),
        Placement((x, y, z), (a, b, c)),
        nominal,
        _real(nominal, part),
        _guiding(k.guiding.of(top)),
        tuple(variants),
    )


def _columns(entry: Entry, columns: int) -> FloatArray:
    """Numbers of a CSV file with a heading."""
    file = entry.file()
    try:
        rows = np.loadtxt(file, delimiter=",", skiprows=1, ndmin=2)
    except ValueError as error:
        raise entry.fail(f"{file.name}: {error}; expected a heading and rows of {columns} numbers with commas") from None
    if rows.shape[1] != columns or not len(rows[1:]):
        raise entry.fail(f"{file.name}: {rows.shape[0]} rows of {rows.shape[1]} numbers; expected at least 2 rows of {columns}")
    return rows


def _settings(common: Entry, own: Entry) -> Settings:
    """The keys of a variant go before the common ones."""
    values: dict[str, Any] = {}
    for name, key in LearningKeys.all().items():
        table = own if name in own else common
        values[name] = key.of(table)
        if name in ("force", "feed", "stiffness") and values[name] <= 0.0:
            raise key.entry(table).fail(f"{values[name]:g} is not positive; expected a value above 0")
    return Settings(**values)


def _guiding(entry: Entry) -> dict[str, Any]:
    k = GuidingKeys
    found: dict[str, Any] = {key.name: key.of(entry) for key in (k.spacing, k.distance, k.scatter, k.blend)}
    found["seed"] = k.seed.of(entry)
    if "lead_through" in entry:
        for key in ("operator", "start"):
            if key not in entry:
                raise entry.fail(f"lead_through needs {key}; add {key} = ..., or remove lead_through")
        found["system"], found["start"] = entry["lead_through"].file(), entry["start"].vector("m")
        found["operator"] = _columns(entry["operator"], LEAD_COLUMNS)
        found["operator"][:, 4:7] = np.deg2rad(found["operator"][:, 4:7])
    elif found["spacing"] <= 0.0:
        raise entry["spacing"].fail("is not positive; expected a value above 0")
    return found


def _real(nominal: FloatArray, part: Entry) -> FloatArray:
    """The nominal edge moved, turned and bent."""
    x, y = (PartKeys.shift.of(part)[i].si("m") for i in range(2))
    middle = 0.5 * (nominal.min(axis=0) + nominal.max(axis=0))
    half = 0.5 * float(np.ptp(nominal[:, 0]))
    turn = PartKeys.turn.of(part)
    bent = nominal - middle
    bent[:, 1] += PartKeys.bend.of(part) * (bent[:, 0] / half) ** 2
    s, c = math.sin(turn), math.cos(turn)
    turned = np.column_stack([c * bent[:, 0] - s * bent[:, 1], s * bent[:, 0] + c * bent[:, 1]])
    real: FloatArray = turned + middle + np.array([x, y])
    return real


def guiding_path(scenario: LearningScenario, settings: Settings) -> LearntPath:
    """Guiding points in P as a hand teaches them that keeps its distance from the nominal edge."""
    g = scenario.guiding
    upright = Rotation.from_matrix(scenario.placement.R_BP.T @ scenario.placement.R_BT)
    edge = scenario.nominal
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(edge, axis=0), axis=1))])
    count = max(2, round(along[-1] / g["spacing"]) + 1)
    at = np.linspace(0.0, along[-1], count)
    tangent = np.gradient(edge, along, axis=0)
    place = np.column_stack([np.interp(at, along, edge[:, i]) for i in range(2)])
    normal = np.column_stack([np.interp(at, along, tangent[:, 1]), -np.interp(at, along, tangent[:, 0])])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    hand = g["scatter"] * np.random.default_rng(g["seed"]).standard_normal(place.shape)
    place = place + (settings.tip_radius + g["distance"]) * normal + hand
    if np.array_equal(edge[0], edge[-1]):
        place[-1] = place[0]
        place = np.vstack([place, place[1:2]])  # once around and one chord more: the search at the start is gone over again
    position = np.column_stack([place, np.zeros(len(place))])
    return LearntPath(position, np.tile(_scalar_first(upright), (len(position), 1)))


def led_path(scenario: LearningScenario, contact: Mapping[str, Any], folder: Path, fmus: Path | None, overwrite: bool) -> LearntPath:
    """Guiding points in P that are taught by leading the robot by hand; the run is kept in `folder`.

    `contact`: parameters of the stylus and the part. ScenarioError if fewer than two points are taught.
    """
    g = scenario.guiding
    system = load_system(g["system"])
    robot = robot_of(system)
    q_start = solve(robot, tool_of(system), scenario.placement.to_base(g["start"]), scenario.placement.R_BT, robot.q_home)
    folder.mkdir(parents=True, exist_ok=True)
    np.save(folder / OPERATOR, g["operator"])
    lead = {"operator": str((folder / OPERATOR).resolve()), "q_start": q_start.tolist(), "seed": g["seed"]}
    stop = float(g["operator"][-1, 0]) + system.step
    stop = system.step * math.ceil(stop / system.step)
    ready = with_parameters(system, {"contact": contact, "lead": lead})
    if fmus is not None:
        ready = with_fmus(ready, fmus)
    recorded = run(ready, folder, stop=stop, resolver=resolve, convert=convert, overwrite=overwrite)
    taught = np.flatnonzero(np.diff(recorded["lead.taught"]) > 0) + 1
    if not len(taught[1:]):
        raise ScenarioError(f"{scenario.file}: [guiding] operator teaches {len(taught)} points, expected at least 2 rows with teach = 1")
    position = in_part(scenario, recorded["lead.p_BT_B"][taught], True)
    turned = Rotation.from_matrix(scenario.placement.R_BP.T) * Rotation.from_quat(np.roll(recorded["lead.quat_BT"][taught], -1, axis=1))
    return LearntPath(position, _scalar_first(turned))


def _scalar_first(rotation: Rotation) -> FloatArray:
    """(w, x, y, z)."""
    return np.roll(rotation.as_quat(canonical=True), 1, axis=-1)


def learn_variant(
    scenario: LearningScenario, variant: LearningVariant, folder: Path, fmus: Path | None = None, overwrite: bool = False
) -> Learnt:
    """All passes of one variant into `folder`, and the program: path.mod (RAPID), path.ngc and path.csv there.

    Raises what planner and master raise, and LearntPathError.
    """
    settings = variant.settings
    if not overwrite:
        check_vacant(folder / f"pass_{n + 1}" for n in range(settings.passes))
    folder.mkdir(parents=True, exist_ok=True)
    np.save(folder / CONTOUR, scenario.real)
    upright = scenario.placement.R_BP.T @ scenario.placement.R_BT
    system = _configured(scenario, variant, folder)
    if "system" in scenario.guiding:
        guiding = led_path(scenario, system.component("contact").parameters, folder / "lead_through", fmus, overwrite)
    else:
        guiding = guiding_path(scenario, settings)
    program = point_path(guiding, "guiding points", settings.feed, upright, scenario.guiding["blend"])
    if fmus is not None:
        system = with_fmus(system, fmus)
    passes: list[Pass] = []
    for n in range(settings.passes):
        place = folder / f"pass_{n + 1}"
        place.mkdir(exist_ok=True)
        np.save(place / PATH, plan(program, scenario.placement).table)
        one = with_parameters(system, {"path": {"segments": str(place / PATH)}, "sensor": {"seed": n + 1}})
        labels = {"program": program.name, "condition": variant.name, "pass": n + 1}
        recorded = run(one, place, resolver=resolve, convert=convert, labels=labels, overwrite=overwrite)
        passes.append(_judged(scenario, settings, recorded))
        if n + 1 < settings.passes:
            path = guiding_orientations(reduced(passes[-1].followed, NEXT_HEIGHT), guiding)
            program = point_path(path, f"pass {n + 1}", settings.feed, upright, 0.5 * scenario.guiding["blend"])
    final = guiding_orientations(reduced(passes[-1].learnt), guiding)
    (folder / "path.mod").write_text(rapid(final, settings.name, settings.feed), encoding="utf-8")
    with suppress(LearntPathError):  # an orientation that turns along the path is in the RAPID module only
        (folder / "path.ngc").write_text(gcode(final, settings.feed), encoding="utf-8")
    np.savetxt(folder / "path.csv", 1e3 * final.position, fmt="%.4f", delimiter=",", header="x_mm,y_mm,z_mm", comments="")
    error = program_error(scenario.real, settings.tip_radius, final)
    figures = {
        "samples": len(passes[-1].run),
        "points": len(final),
        "points_needed": points_needed(beside(scenario.real, settings.tip_radius)),
        "program_rms_m": _rms(error),
        "program_worst_m": float(np.abs(error).max()),
        "length_m": float(np.linalg.norm(np.diff(final.position, axis=0), axis=1).sum()),
        "passes": [dict(p.figures) for p in passes],
    }
    return Learnt(variant, guiding, tuple(passes), final, figures)


def _configured(scenario: LearningScenario, variant: LearningVariant, folder: Path) -> System:
    """The system of the scenario with all that its tables say."""
    settings = variant.settings
    system = load_system(scenario.system)
    known: dict[str, dict[str, Any]] = {
        "contact": {
            "contour": str((folder / CONTOUR).resolve()),
            "p_BP_B": list(scenario.placement.p_BP_B),
            "quat_BP": [float(v) for v in _scalar_first(Rotation.from_matrix(scenario.placement.R_BP))],
            "stiffness": settings.stiffness,
            "tip_radius": settings.tip_radius,
        },
        "learning": {
            "gain": ForceLoop().gain(settings.stiffness),
            "desired_force": settings.force,
            "contact_force": THRESHOLDS[0] * settings.force,
            "force_limit": FORCE_LIMIT * settings.force,
        },
    }
    if settings.rigid:
        known["compliance"] = {"stiffness": [RIGID] * (3 * JOINTS)}
    return replace(with_parameters(with_parameters(system, known), variant.parameters), name=f"{scenario.name}/{variant.name}")


def in_part(scenario: LearningScenario, vectors: FloatArray, place: bool) -> FloatArray:
    """Vectors (n, 3) of B in P; with `place` positions [m], else directions."""
    moved = vectors - np.asarray(scenario.placement.p_BP_B) if place else vectors
    result: FloatArray = moved @ scenario.placement.R_BP
    return result


def _judged(scenario: LearningScenario, settings: Settings, recorded: Run) -> Pass:
    """A pass and its figures: how far from the true part the record is, after the constant offset F_d/k, and the points with F/k."""
    position = in_part(scenario, recorded["learning.p_BT_B"], True)
    force = in_part(scenario, recorded["learning.f_T_B"], False)
    quaternion = _scalar_first(
        Rotation.from_matrix(scenario.placement.R_BP.T) * Rotation.from_quat(np.roll(recorded["learning.quat_BT"], -1, axis=1))
    )
    first = int(np.argmax(recorded["learning.phase"] == FOLLOWING)) if np.any(recorded["learning.phase"] == FOLLOWING) else len(recorded)
    settled = np.arange(len(recorded)) >= first + round(SETTLING / (recorded.t[1] - recorded.t[0]))
    touching = (recorded["learning.filtered_force"] > THRESHOLDS[0] * settings.force) & (np.arange(len(recorded)) >= first)
    normal_force = np.where(touching, recorded["learning.normal_force"], 0.0)  # at 10 N the threshold is only 3 sigma of the noise
    learnt, path = (
        learn(position, quaternion, force, normal_force, settings.force, settings.stiffness, samples) for samples in (1, SMOOTHING)
    )
    offset = settings.force / settings.stiffness - settings.tip_radius
    raw = signed_distances(scenario.real, position[settled, :2]) + offset
    error, clean = (signed_distances(scenario.real, p.position[:, :2]) - settings.tip_radius for p in (learnt, path))
    figures = {
        "rms_m": _rms(raw),
        "worst_m": float(np.abs(raw).max()),
        "no_contact": float(np.mean(recorded["contact.distance"][settled] >= 0.0)),
        "kept": len(learnt) / (len(recorded) - first),
        "corrected_rms_m": _rms(error),
        "corrected_worst_m": float(np.abs(error).max()),
        "smoothed_rms_m": _rms(clean),
        "smoothed_worst_m": float(np.abs(clean).max()),
        "largest_force_n": float(recorded["learning.normal_force"].max()),
        "duration_s": float(recorded.t[-1]),
    }
    corrected = smoothed((position + force / settings.stiffness)[first:], SMOOTHING)
    return Pass(recorded, position, path, LearntPath(corrected, quaternion[first:]), figures)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def program_error(real: FloatArray, tip_radius: float, program: LearntPath) -> FloatArray:
    """Distance [m] of the program's straight lines from the true path of the tip, at steps of `LINE_STEP`; > 0: too far out."""
    return signed_distances(real, _along(program.position[:, :2])) - tip_radius


def beside(edge: FloatArray, distance: float) -> FloatArray:
    """The smooth curve (n, 2) m at a `distance` [m] outside of an edge: where the middle of a tip of that radius goes."""
    tangent = np.gradient(edge, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    return edge + distance * np.column_stack([tangent[:, 1], -tangent[:, 0]])


def _along(corners: FloatArray) -> FloatArray:
    """Points on the straight lines between corners."""
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    at = np.arange(0.0, way[-1], LINE_STEP)
    return np.column_stack([np.interp(at, way, corners[:, i]) for i in range(2)])


def run_learning(
    scenario: LearningScenario,
    folder: Path,
    names: Sequence[str] | None = None,
    fmus: Path | None = None,
    progress: Progress | None = None,
    overwrite: bool = False,
) -> tuple[dict[str, Any], list[Learnt]]:
    """All variants (or those in `names`) below `folder`; returns what summary.json holds, and the results."""
    known = {v.name: v for v in scenario.variants}
    if unknown := [n for n in names or () if n not in known]:
        raise ScenarioError(f"{scenario.file}: no variant {', '.join(unknown)}; variants: {', '.join(known)}")
    chosen = [v for v in scenario.variants if not names or v.name in names]
    results = []
    for i, variant in enumerate(chosen):
        if progress is not None:
            progress(scenario.name, i, len(chosen))
        results.append(learn_variant(scenario, variant, folder / variant.name, fmus, overwrite))
    return {"scenario": scenario.name, "kind": KIND, "variants": {r.variant.name: dict(r.figures) for r in results}}, results
