"""Pages of file formats: tables from the declarations that readers check files by, each with an example that a test reads."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from reference.key_tables import has_units, sections
from reference.markdown import code, page, prose, sentence, table
from reference.records import data_section, json_sections
from reference.run_folder import FILES, RunKeys
from robomill import measured_set
from robomill.blind.make import Request
from robomill.blind.results import Score
from robomill.blind.sealing import Benchmark
from robomill.blind.truth import Truth
from robomill.cell import equipment_keys, experiments, next_runs, path_learning, points, removal_rate, scenario
from robomill.cell.equipment import load_system
from robomill.cell.evaluation import Figures
from robomill.cell.rsi import settings
from robomill.cell.static_loads import StaticLoads
from robomill.diagnosis import catalogue, check
from robomill.diagnosis.experiment import campaign
from robomill.diagnosis.inference.time_varying import Changing
from robomill.diagnosis.outcome import answer
from robomill.identify_command import PAYLOAD, STIFFNESS
from robomill.identify_cubes import CubesKeys, read_set
from robomill.identify_cycle import AXIS, LOADED
from robomill.identify_hammer import BLOWS
from robomill.identify_sensor import QUANTITIES
from robomill.identify_stations import PUSHES
from robomill.logs import mapping
from robomill.logs.reading import READERS, SUFFIXES
from robomill.models.components.sensor_chain import ForceSensor
from robomill.models.components.spindle_holder import SpindleHolder
from robomill.models.planning.gcode import codes
from robomill.models.process.cutting import CuttingCoefficients, EndMill
from robomill.models.process.stability.modes import ModeFile
from robomill.models.robot.dynamics import RobotDynamics
from robomill.models.robot.kinematics import Robot, Tool
from robomill.models.robot.virtual_joints import Compliance
from robomill.orchestration.system.definition import SystemKeys
from robomill.orchestration.system.keys import Keys

EXAMPLES = Path(__file__).parent / "examples"
UNITS = 'Quantities carry a unit, such as `"4 ms"`; the column *unit* names the SI unit that they are converted to. Only 0 needs none.'


@dataclass(frozen=True)
class Format:
    """A format of files that people write (TOML)."""

    name: str
    """Page, and example."""
    title: str
    keys: type[Keys]
    read: Callable[[Path], object]
    """The reader."""
    used: str
    """Commands that take such a file."""

    @property
    def example(self) -> Path:
        """A minimal file."""
        return EXAMPLES / f"{self.name}.toml"

    def page(self) -> str:
        """Its page."""
        shown = code(self.example.read_text(encoding="utf-8"), "toml")
        lead = f"{sentence(self.used)} {UNITS if has_units(self.keys) else ''}"
        return page(self.title, prose(self.keys.__doc__), lead, f"A small file of this kind:\n\n{shown}", *sections(self.keys))


FORMATS = (
    Format("system", "System files", SystemKeys, load_system, "`robomill run` and `robomill diagnose` take a system file"),
    Format(
        "equipment", "Equipment", equipment_keys.EquippedKeys, load_system,
        "system, scenario and experiment files name robot, tool, material and sensor in these tables",
    ),
    Format(
        "scenario", "Scenario files of milling cells", scenario.ScenarioKeys, scenario.load_scenario,
        "`robomill run`, `plan`, `compensate`, `place` and `stability` take a scenario file",
    ),
    Format("experiment", "Experiment files", experiments.ExperimentKeys, experiments.load_experiment, "`robomill run` takes it"),
    Format(
        "removal_rate", "Scenario files of removal rate control", removal_rate.RateKeys, removal_rate.load_removal_rate,
        "`robomill run` takes such a scenario file",
    ),
    Format(
        "path_learning", "Scenario files of path learning", path_learning.LearningScenarioKeys, path_learning.load_learning,
        "`robomill run` takes such a scenario file",
    ),
    Format("points", "Paths of points", points.PathKeys, points.read_points, "a scenario and `robomill plan` take it as the program"),
    Format(
        "catalogue", "Catalogues of effects", catalogue.CatalogueKeys, catalogue.Catalogue.load,
        "`robomill diagnose --catalogue` takes it",
    ),
    Format(
        "calibration", "Calibration files", catalogue.CalibrationKeys, catalogue.Catalogue(Path(), ()).calibrated,
        "`robomill diagnose --calibration` takes it",
    ),
    Format(
        "campaign", "Campaign files", campaign.CampaignKeys, lambda file: campaign.load_campaign(file, load_system),
        "`robomill diagnose --campaign` takes it",
    ),
    Format("next_runs", "Kinds of next runs", next_runs.KindsKeys, next_runs.load_kinds, "`robomill diagnose --next-runs` takes it"),
    Format("mapping", "Mapping files of logs", mapping.MappingKeys, mapping.load_mapping, "`robomill import` takes it"),
    Format("cubes", "Measured cubes", CubesKeys, read_set, "`robomill identify cubes` takes it"),
    Format("link", "RSI link files", settings.LinkKeys, settings.load_link, "`robomill rsi` and `robomill krc` take it"),
)  # fmt: skip
DATA = (
    (Robot, "models/data/robots"),
    (Compliance, "models/data/compliance"),
    (RobotDynamics, "models/data/dynamics"),
    (Tool, "models/data/tools"),
    (EndMill, "models/data/tools"),
    (CuttingCoefficients, "models/data/materials"),
    (ForceSensor, "models/data/sensors"),
    (SpindleHolder, "models/data/sensors"),
    (ModeFile, "models/data/modes"),
)
MEASURED = {
    "stiffness": STIFFNESS, "payload": PAYLOAD, "stations": PUSHES, "cycle": LOADED, "cycle, axis alone": AXIS, "hammer": BLOWS,
    "sensor": QUANTITIES,
}  # fmt: skip
"""`robomill identify KIND` -> the quantities that it reads."""


def pages() -> Iterator[tuple[str, str, str]]:
    """File name below formats/, title and text of every page."""
    for made in FORMATS:
        yield made.name, made.title, made.page()
    yield "data", "Data files with sources", _data()
    yield "measured_set", "Measured sets", _measured()
    yield "programs", "Part programs", _programs()
    yield "logs", "Logs of other programs", _logs()
    yield "run_folder", "Run folders", _run_folder()
    yield "summary", "Figures of a scenario", _summary()
    yield "diagnosis", "Files of a diagnosis", _diagnosis()
    yield "blind", "Files of the blind benchmark", _blind()


def _data() -> str:
    """Robots, tools, materials, sensors and modes of spindles."""
    form = (
        "One TOML table per field, each with the same four keys: `value`, `unit`, `source` and `validity`. A field with a default may be "
        'left out. The unit may be any of the same dimension. A file of your own goes into a system or scenario by `file = "my.toml"`.'
    )
    example = f"A material:\n\n{code((EXAMPLES / 'material.toml').read_text(encoding='utf-8'), 'toml')}"
    return page("Data files with sources", form, example, *(data_section(cls, where) for cls, where in DATA))


def _measured() -> str:
    """Sets of poses, loads and answers for `robomill identify`."""
    lead = (
        "`robomill identify` takes TOML files over tables of measured poses, or run folders. "
        "Of a run folder the columns are those of the ports."
    )
    example = code((EXAMPLES / "measured_set.toml").read_text(encoding="utf-8"), "toml")
    rows = [
        (f"`{kind}`", f"`[{q.name}]`", str(q.width), q.unit, "required" if q.needed else "", ", ".join(f"`*.{p}`" for p in q.ports))
        for kind, quantities in MEASURED.items()
        for q in quantities
    ]
    needs = table(("identify", "table", "columns", "unit", "", "ports of a run folder"), rows)
    return page(
        "Measured sets", lead, example, "## Quantities\n\nA table for each quantity, by its name:\n\n" + needs,
        *sections(measured_set.ColumnsKeys, "[QUANTITY]"), *sections(measured_set.MeasuredRobotKeys, "[robot]"),
        *sections(measured_set.MeasuredToolKeys, "[tool]"),
    )  # fmt: skip


def _programs() -> str:
    """G-code as it is read."""
    lead = (
        "G-code after NIST RS274/NGC, LinuxCNC and Fanuc. A code that changes the path is carried out, or the program is refused with its "
        "line and the reason. A code that does not is skipped and noted. [Part programs](../../how_to/gcode.md) explains the rules."
    )
    groups = table(("modal group", "codes"), ((name, _g(listed)) for name, listed in codes.GROUPS.items()))
    skipped = table(("code", "why it has no effect"), [(f"`G{n:g}`", why) for n, why in codes.SKIPPED_G.items()])
    refused = table(("code", "what it asks for"), [(f"`G{n:g}`", why) for n, why in codes.REFUSED_G.items()])
    stops = [(f"`M{n:g}`", why) for n, why in codes.STOPS.items()]
    others = [(f"`M{n:g}`", "spindle on" if sense else "spindle off") for n, sense in codes.SPINDLE.items()]
    others += [(f"`M{n:g}`", "end of the program") for n in codes.ENDS] + [(f"`M{codes.TOOL_CHANGE}`", "tool change")]
    m = table(("code", "meaning"), stops + others + [(f"`M{n:g}`", f"skipped: {why}") for n, why in codes.SKIPPED_M.items()]
              + [(f"`M{n:g}`", f"refused: {why}") for n, why in codes.REFUSED_M.items()])  # fmt: skip
    example = code((EXAMPLES / "slot.ngc").read_text(encoding="utf-8"), "text")
    return page(
        "Part programs", lead, f"A small program:\n\n{example}", f"## G codes that are carried out\n\n{groups}",
        f"## G codes that are skipped\n\n{skipped}", f"## G codes that are refused\n\n{refused}", f"## M codes\n\n{m}",
    )  # fmt: skip


def _g(listed: tuple[float, ...]) -> str:
    return " ".join(f"`G{n:g}`" for n in listed)


def _logs() -> str:
    """Formats of logs that `robomill import` reads."""
    rows = []
    for name, reader in READERS.items():
        suffixes = ", ".join(f"`{s}`" for s, kind in SUFFIXES.items() if kind == name)
        rows.append((f"`{name}`", suffixes, prose(reader.__doc__).replace("\n", " ")))
    lead = "`robomill import` reads logs in these formats, by their suffix or by `format` of the [mapping file](mapping.md)."
    return page("Logs of other programs", lead, table(("format", "suffix", "what is read"), rows))


def _run_folder() -> str:
    """A run on disk."""
    lead = "Every run, simulated or imported, is a folder of its own. `robomill.Run.load(FOLDER)` reads it."
    files = table(("file", "content"), ((f"`{name}`", text) for name, text in FILES.items()))
    meta = (
        "Each column of signals.parquet carries the description of its port as text: component, port, type, unit, minimum, maximum, "
        "description, frame, dependencies (`*`: unknown). The schema carries run.toml under the key `robomill`."
    )
    return page("Run folders", lead, files, meta, *sections(RunKeys))


def _summary() -> str:
    """summary.json of a scenario."""
    lead = (
        "`robomill run` writes summary.json beside the run folders. Each variant of a milling scenario has these figures, each load of a "
        "scenario of static loads those below. The name of a figure ends in its unit."
    )
    return page("Figures of a scenario", lead, *json_sections(Figures, "Milling"), *json_sections(StaticLoads, "Static loads"))


def _diagnosis() -> str:
    """diagnosis.json, adopt.ssv, and what --check prints."""
    lead = (
        "`robomill diagnose` writes report.html, diagnosis.json and, where there is something to adopt, adopt.ssv. "
        "Numbers that nothing determines are null. Intervals are those of 90 %."
    )
    adopt = (
        "## adopt.ssv\n\nAn SSP 1.0 parameter set with one parameter `component.parameter` per adopted effect, in the unit of "
        "the parameter. `robomill run --adopt` takes it. Faults of the log are left out."
    )
    return page(
        "Files of a diagnosis", lead, f"## diagnosis.json\n\n{prose(answer.to_json.__doc__)}",
        *json_sections(answer.Answer, "Answer", {Changing: "`like`, `how` and `gain`"}), adopt,
        *json_sections(check.Checked, f"Output of --check --json ({check.CHECK_SCHEMA})"),
    )  # fmt: skip


def _blind() -> str:
    """Files of `robomill blind`."""
    lead = (
        "`robomill blind` makes a benchmark, runs a diagnosis on it and scores it. "
        "[The blind benchmark](../../maintainers/blind.md) explains it."
    )
    named = ((Request, "request.json"), (Benchmark, "benchmark.json"), (Truth, "sealed/NNNN.json"), (Score, "score.json"))
    return page("Files of the blind benchmark", lead, *(s for cls, name in named for s in json_sections(cls, name)))
