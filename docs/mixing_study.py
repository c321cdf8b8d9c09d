"""Table of docs/explanation/mixing.md: ``python -m docs.mixing_study`` mills the short slot with every combination and writes it.

Robots, sensors, controllers and ways of programming of four papers, in one cell: ``scenarios/mixing_cell.toml``.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from robomill.cell import milling
from robomill.cell.compensation import compensate
from robomill.cell.evaluation import evaluate
from robomill.cell.scenario import ComponentParameters, Scenario, Variant, load_scenario
from robomill.orchestration.errors import SystemFileError
from robomill.orchestration.system.definition import Connection

ROOT = Path(__file__).parents[1]
PAGE = Path(__file__).parent / "explanation" / "mixing.md"
SCENARIOS = ROOT / "scenarios"
ROBOTS = {"KR 300": "kr300_r2500_ultra", "KR 500": "kr500_r2830", "KR 210": "kr210_2", "IRB 6400": "irb6400r_25_150"}
"""By title: the file in scenarios/robots, with the place of the part."""
SENSORS: Mapping[str, str | None] = {"none": None, "ATI": "sensor_chain", "holder": "spindle_holder", "current": "spindle_current"}
"""By title: the component that stands for `sensor`; none: nothing is connected to the controller."""
COMMON: ComponentParameters = {"path": {"lead_time": "68 ms"}}
"""Lead time as in the cell of paper 000."""
SET_FORCE = {"current": "150 N"}
OTHER_SET_FORCE = "92 N"
"""What rate control holds: 57 % of what there is at the programmed feed, 265 N at the edges; the sensors show 163 N against the feed."""
FEED_ELEMENT = 2
"""Element of f_T_T against the feed of this slot: rate control takes one force, so a sensor of six components gives one of them."""
REASONS = {
    "a": "no force vector",
    "b": "nothing is connected to controller.f_T_T",
    "c": "nothing is connected to rate.force",
}
"""Letter in the table -> words by which the message of `check_combination` is known; the page has the messages."""
MM = 1e3


@dataclass(frozen=True)
class Way:
    """One way to compensate or to program."""

    parameters: ComponentParameters
    controller: str = "compensation_controller"
    offline: bool = False
    needs_force: bool = True


_OFF: Mapping[str, object] = {"mode": 0}
WAYS: Mapping[str, Way] = {
    "uncompensated": Way({"controller": _OFF}, needs_force=False),
    "Cartesian": Way({"controller": {"mode": 1}}),
    "axis": Way({"controller": {"mode": 2}}),
    "pilot": Way({"controller": {"mode": 1, "pilot": True}}),
    "paper 003": Way({"controller": {"mode": 2}}, controller="deformation_compensation"),
    "rate": Way({"controller": _OFF}),
    "offline": Way({"controller": _OFF}, offline=True, needs_force=False),
    "offline + online": Way({"controller": {"mode": 1}}, offline=True),
}
"""By title, which is the column of the table."""


@dataclass(frozen=True)
class Outcome:
    """What a combination comes to."""

    deviation: float | None = None
    """Largest deviation of the surface [m]; None if it is refused."""
    refusal: str = ""

    @property
    def text(self) -> str:
        """Its cell of the table: millimetres, or the letter of the reason."""
        if self.deviation is not None:
            return f"{MM * self.deviation:.2f}"
        return next(letter for letter, words in REASONS.items() if words in self.refusal)


def scenario(robot: str, sensor: str, way: str) -> Scenario:
    """The slot with one combination as its only variant."""
    chosen, source = WAYS[way], SENSORS[sensor]
    sources = {"controller": chosen.controller}
    if source is not None and not (way == "rate" and sensor == "current"):  # there the current leads the rate, and the sensor is idle
        sources["sensor"] = source
    parameters = (
        chosen.parameters if way != "rate" else {**chosen.parameters, "rate": {"variant": 2, "F_r": SET_FORCE.get(sensor, OTHER_SET_FORCE)}}
    )
    variant = Variant("only", f"{robot}, {sensor}, {way}", parameters, sources)
    read = load_scenario(SCENARIOS / "robots" / f"{ROBOTS[robot]}.toml")
    return replace(read, system=SCENARIOS / "mixing_cell.toml", variants=(variant,), parameters=COMMON)


def rewired(connections: Sequence[Connection], sensor: str) -> tuple[Connection, ...]:
    """The connections of the cell with the force of that sensor."""
    if sensor == "none":
        return tuple(c for c in connections if not c.source.startswith("sensor.") and c.target != "rate.force")
    if sensor == "current":
        return tuple(connections)
    force = f"sensor.f_T_T[{FEED_ELEMENT}]"
    return tuple(replace(c, source=force) if c.target == "rate.force" else c for c in connections)


@dataclass
class Matrix:
    """Combinations, each run once; the plan of a robot is made once."""

    folder: Path
    jobs: dict[str, milling.Job] = field(default_factory=dict)
    done: dict[tuple[str, str, str], Outcome] = field(default_factory=dict)

    def outcome(self, robot: str, sensor: str, way: str) -> Outcome:
        """What milling the slot with a combination comes to, or why the program refuses it."""
        key = (robot, sensor, way)
        if key not in self.done:
            self.done[key] = self._outcome(*key)
        return self.done[key]

    def _outcome(self, robot: str, sensor: str, way: str) -> Outcome:
        chosen = scenario(robot, sensor, way)
        folder = self.folder / f"{robot}_{sensor}_{way}".replace(" ", "_")
        if robot not in self.jobs:
            self.jobs[robot] = milling.prepare(scenario(robot, "none", "uncompensated"), self.folder / robot.replace(" ", "_"))
        planned = self.jobs[robot]
        system = replace(planned.system, connections=rewired(planned.system.connections, sensor))
        job = replace(planned, scenario=chosen, folder=folder, system=system)
        (variant,) = chosen.variants
        try:
            milling.of_variant(job, variant)
        except SystemFileError as error:
            return Outcome(refusal=str(error))
        if WAYS[way].offline:
            return Outcome(compensate(chosen, None, folder, perturbed=()).results[1].figures.max_deviation_m)
        run, factor = milling.mill(job, variant)
        return Outcome(evaluate(variant.name, variant.title, run, job.workpiece, factor).figures.max_deviation_m)


def rows(outcomes: Mapping[tuple[str, str, str], Outcome]) -> list[str]:
    """Lines of the table."""
    lines = [f"| robot | force from | {' | '.join(WAYS)} |", "|" + "---|" * (2 + len(WAYS))]
    for robot in ROBOTS:
        for sensor in SENSORS:
            cells = [outcomes[robot, sensor if WAYS[way].needs_force else "none", way].text for way in WAYS]
            lines.append(f"| {robot} | {sensor} | {' | '.join(cells)} |")
    return lines


def asked() -> list[tuple[str, str, str]]:
    """Combinations that differ: what needs no force is milled once for each robot."""
    return [(r, s, w) for r in ROBOTS for s in SENSORS for w in WAYS if WAYS[w].needs_force or s == "none"]


def main() -> None:
    """Mill everything and put the table into the page."""
    with tempfile.TemporaryDirectory(prefix="robomill_") as folder:
        matrix = Matrix(Path(folder))
        outcomes = {key: matrix.outcome(*key) for key in asked()}
    head, table, rest = PAGE.read_text(encoding="utf-8").split("<!-- table -->\n")
    del table
    PAGE.write_text("<!-- table -->\n".join([head, "\n".join(rows(outcomes)) + "\n", rest]), encoding="utf-8")
    for text in sorted({o.refusal for o in outcomes.values() if o.refusal}):
        print(text)


if __name__ == "__main__":
    main()
