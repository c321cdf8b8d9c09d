"""Scenario files: what is simulated, in which variants, and which published figures stand beside the result.

Keys are declared below (`ScenarioKeys`), with an example in docs/reference/formats/scenario.md; scenarios/groove.toml is a whole one.
How a program is read: docs/how_to/gcode.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from robomill.cell.binding import convert
from robomill.cell.equipment_keys import EquippedKeys
from robomill.models.model.declaration import FloatArray
from robomill.models.planning.gcode import DIALECTS, Setup, Vector
from robomill.models.planning.point_path import INTERPOLATIONS, Interpolation
from robomill.models.planning.trajectory import Placement
from robomill.models.process.cutting import MAX_TEETH, EndMill
from robomill.orchestration import html
from robomill.orchestration.errors import not_there
from robomill.orchestration.system import keys
from robomill.orchestration.system.definition import EQUIPMENT
from robomill.orchestration.system.entries import Entry
from robomill.orchestration.system.keys import Keys, default, optional, required

__all__ = ["ComponentParameters", "Scenario", "ScenarioError", "Variant", "Workpiece", "load_scenario"]

ComponentParameters = Mapping[str, Mapping[str, Any]]
"""component -> parameter -> value as written; checked and converted against the component's ports when the system is assembled."""
KINDS = ("milling", "static_loads")
PLAIN_OFFSETS: Mapping[float, Vector] = {54: (0.0, 0.0, 0.0)}
"""Work offsets where a scenario names none."""
OFFSETS = {f"G{n:g}": float(n) for n in (54, 55, 56, 57, 58, 59, 59.1, 59.2, 59.3)}
"""Names of the work offsets, and the numbers that the reader of programs knows them by."""
_FACES: Mapping[str, tuple[tuple[int, float], ...]] = {
    "left": ((0, -0.5),),
    "right": ((0, 0.5),),
    "front": ((1, -0.5),),
    "back": ((1, 0.5),),
    "top": ((2, 0.0),),
    "bottom": ((2, -1.0),),
    "corner": ((0, -0.5), (1, -0.5)),
    "centre": (),
}
"""Words of a place in the block: axis and share of the size from the centre of the top."""
ROUNDING = 1e-9
"""Part of a length by which the conversion of units may be off."""
_FOLDERS = ("plan", "offline")
"""Folders beside those of the variants."""
_PLACE = keys.anything("three quantities, or a place of the block", "m", _FACES)
"""A point of P."""
_PAPER_UNITS = {"_m": "m", "_n": "N", "_s": "s", "_percent": "%", "_hz": "Hz", "_m_s": "m/s"}


class ScenarioError(ValueError):
    """A scenario file that cannot be used; the text names file, line, key, what was found and what is expected."""


@dataclass(frozen=True)
class Workpiece:
    """Where the block is and how large: frame P at the centre of its top surface."""

    position: tuple[float, float, float]
    """p_BP_B [m]."""
    size: tuple[float, float, float]
    """Extent along x, y, z of P [m]."""
    abc: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Orientation of P in B: A, B, C [rad]."""
    work_offsets: Mapping[float, Vector] = field(default_factory=lambda: dict(PLAIN_OFFSETS))
    """Origins of G54 (54) .. G59.3 (59.3) in P [m]; G54 is the origin of P unless it is named."""
    stock: FloatArray | None = field(default=None, compare=False)
    """Triangles (n, 3, 3) [m] in P of a stock that is no block; `size` is then that of its box."""
    tool_angle: float = 0.0
    """Angle [rad] of the spindle about the tool axis, from where the z axis of T points away from the robot."""

    @property
    def placement(self) -> Placement:
        """Where the block and the upright tool stand in the robot base."""
        return Placement(self.position, self.abc, self.tool_angle)


@dataclass(frozen=True)
class Variant:
    """One way to run a scenario: its parameters come on top of those of the scenario."""

    name: str
    title: str
    parameters: ComponentParameters
    sources: Mapping[str, str] = field(default_factory=dict)
    """component -> what stands there instead of the source that the system names."""


@dataclass(frozen=True)
class Scan:
    """How a faced block is scanned."""

    depth: float
    """How far the programmed plane lies below the top [m]."""
    margin: float
    """What is left out at both ends in x of P [m]."""


@dataclass(frozen=True)
class Scenario:
    """A scenario file, with paths made absolute."""

    file: Path
    name: str
    kind: str
    title: str
    system: Path
    program: Path | None
    workpiece: Workpiece | None
    parameters: ComponentParameters
    variants: tuple[Variant, ...]
    paper: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """variant -> figure -> published value (SI)."""
    reading: Setup = field(default_factory=Setup)
    """How the program is read."""
    orientation: Interpolation | None = None
    """How the orientation runs between points, where it is another than the path of points says."""
    tools: Mapping[int, EndMill] = field(default_factory=dict)
    """The tools by T number; empty: the milling component's own does all."""
    tool_titles: Mapping[int, str] = field(default_factory=dict)
    """What those that have a title are called."""
    tool_corners: Mapping[int, float] = field(default_factory=dict)
    """Corner radii [m] of those that are not flat, by T number."""
    equipment: Mapping[str, Entry] = field(default_factory=dict)
    """Robot, tool, material and sensor, where they are others than those of the system."""
    scan: Scan | None = None
    """How the surface is scanned, if it is."""

    def _repr_html_(self) -> str:
        program = "" if self.program is None else f", program {self.program.name}"
        caption = f"{self.title}: scenario {self.name} of the kind {self.kind}, system {self.system.name}{program}"
        rows = []
        for v in self.variants:
            own = [f"{c}.{name} = {value}" for c, values in v.parameters.items() for name, value in values.items()]
            rows.append((v.name, v.title, ", ".join([*own, *(f"{c} = {source}" for c, source in v.sources.items())])))
        return html.table(caption, ("variant", "title", "parameters and sources"), rows)


class VariantKeys(Keys):
    """One way to run the scenario: its values go before those of the scenario."""

    title = optional(keys.text(), "what the variant is called in tables and pictures (default: its name)")
    parameters = default({}, keys.parameters(), "parameters of this variant alone, with units")
    sources = default(
        {}, keys.named(keys.text(), "component"), "what stands in place of the source that the system names: one component exchanged"
    )


class WorkOffsetKeys(Keys):
    """Origins of the work offsets that the program uses: a place such as `front-left-top`, or three lengths from the centre of the top."""

    G54 = optional(_PLACE, "origin of G54 (default: the centre of the top); the same as `zero`")
    G55 = optional(_PLACE, "origin of G55")
    G56 = optional(_PLACE, "origin of G56")
    G57 = optional(_PLACE, "origin of G57")
    G58 = optional(_PLACE, "origin of G58")
    G59 = optional(_PLACE, "origin of G59")
    G59_1 = optional(_PLACE, "origin of G59.1", name="G59.1")
    G59_2 = optional(_PLACE, "origin of G59.2", name="G59.2")
    G59_3 = optional(_PLACE, "origin of G59.3", name="G59.3")


class WorkpieceKeys(Keys):
    """Where the block is and how large; frame P lies at the centre of its top surface. Give either `size` or `stock`."""

    position = required(keys.vector("m"), "centre of the top surface in the robot base")
    abc = default([0, 0, 0], keys.vector("rad"), "orientation in the robot base: Euler angles A about z, B about y', C about x''")
    size = optional(keys.vector("m"), "length, width and height of a block")
    stock = optional(keys.file(), "instead of `size`: an STL file with a closed solid; the middle of the top of its box is the origin of P")
    stock_unit = default("1 mm", keys.quantity("m"), "length that a coordinate of 1 in the STL file stands for")
    tool_angle = default(0, keys.quantity("rad"), "angle of the spindle about the tool axis; 0: away from the robot")
    zero = default("centre-top", _PLACE, "where G54 lies in the block")
    work_offsets = default({}, keys.table(WorkOffsetKeys), "where the other work offsets lie")


class ToolKeys(Keys):
    """A cutter of the program, by its T number."""

    diameter = required(keys.quantity("m"), "diameter, above 0")
    teeth = required(keys.count(1), f"number of teeth, at most {MAX_TEETH}")
    helix = required(keys.quantity("rad"), "helix angle")
    cutting_length = required(keys.quantity("m"), "length of the cutting edges, above 0")
    corner_radius = default(0, keys.quantity("m"), "0: flat; half of the diameter: ball nose; for components with tri-dexels")
    title = optional(keys.text(), "what the tool is called in run.toml")


class ScanKeys(Keys):
    """A faced block whose surface is scanned: the error of the surface is measured."""

    depth = required(keys.quantity("m"), "how far the programmed plane lies below the top, above 0")
    margin = default(0, keys.quantity("m"), "what is left out at both ends in x, where the cutter comes in and leaves")


class ScenarioHeadKeys(Keys):
    """What is simulated, and how the program is read where it does not say itself."""

    name = required(keys.folder_name(), "name of the scenario; results stand in a folder of that name")
    kind = required(
        keys.choice((*KINDS, "experiment", "removal_rate")),
        "`milling`: a program is milled; `static_loads`: the robot is loaded. Each other kind has a page of its own",
    )
    system = required(keys.file(), "system file: components and connections")
    title = optional(keys.text(), "heading of the results (default: the name)")
    program = optional(keys.file(), "G-code, or a path of points (TOML); needed for `milling`")
    orientation = optional(keys.choice(INTERPOLATIONS), "how the orientation runs between points of a path (default: as the path says)")
    start = optional(keys.vector("m"), "where the tool stands before the first block, from program zero (default: over the first point)")
    home = optional(keys.vector("m"), "where G28, G30 and G53 lead, from program zero (default: 100 mm over the block)")
    dialect = default(Setup().dialect, keys.choice(DIALECTS), "control whose unit of dwells the program uses")
    block_delete = default(Setup().block_delete, keys.flag(), "skip lines that begin with `/`; false: execute them")
    wear = default(Setup().wear, keys.flag(), "G41 and G42 correct wear only: the program has the path of the centre of the tool")
    feed = optional(keys.quantity("m/s"), "feed until the program names one, above 0")
    spindle_speed = optional(keys.quantity("rad/s"), "spindle speed until the program names one, above 0")


class ScenarioKeys(EquippedKeys):
    """A milling cell in its variants: program, workpiece, tools, parameters, published figures."""

    scenario = required(keys.table(ScenarioHeadKeys), "what is simulated")
    workpiece = optional(keys.table(WorkpieceKeys), "the block; needed for `milling`")
    tools = default({}, keys.tables(ToolKeys, "1"), "cutters by T number; without, the one of the milling component does all")
    parameters = default({}, keys.parameters(), "parameters of all variants, with units")
    variants = default({}, keys.tables(VariantKeys), "ways to run the scenario, by name; `milling` needs at least one")
    scan = optional(keys.table(ScanKeys), "how the surface of a faced block is scanned")
    paper = default(
        {},
        keys.anything("table of `VARIANT.FIGURE = value`"),
        f"published figures, printed beside ours; the name of a figure ends in its unit: {', '.join(f'`{u}`' for u in _PAPER_UNITS)}",
    )


def load_scenario(path: str | Path) -> Scenario:
    """Read and check a scenario file. ScenarioError or FileNotFoundError says what is wrong and what is possible."""
    file = Path(path)
    if not file.is_file():
        raise FileNotFoundError(not_there("scenario", file))
    top, k = ScenarioKeys.of(Entry.load(file, ScenarioError, convert)), ScenarioHeadKeys
    head = ScenarioKeys.scenario.of(top)
    kind = k.kind.of(head)
    if kind not in KINDS:
        raise head["kind"].fail(f"{kind!r} cannot be used here; expected {' or '.join(KINDS)}")
    milling = kind == "milling"
    for key, there in (
        ("program", "program" in head),
        ("workpiece", "workpiece" in top),
        ("variants", bool(top.get("variants", {}).value)),
    ):
        if milling and not there:
            raise top.fail(f"a milling scenario needs a {key}; see cell/scenario.py or scenarios/groove.toml")
    workpiece = _workpiece(top["workpiece"]) if "workpiece" in top else None
    listed = dict(ScenarioKeys.tools.entry(top).items())
    tools = dict(_tool(name, entry) for name, entry in listed.items())
    titles = {int(name): ToolKeys.title.of(entry) for name, entry in listed.items()}
    return Scenario(
        file=file.resolve(),
        name=k.name.of(head),
        kind=kind,
        title=k.title.of(head) or k.name.of(head),
        system=k.system.of(head),
        program=k.program.of(head),
        workpiece=workpiece,
        parameters=ScenarioKeys.parameters.of(top),
        variants=tuple(variant(name, entry) for name, entry in ScenarioKeys.variants.entry(top).items()),
        paper={name: published_figures(entry) for name, entry in ScenarioKeys.paper.of(top).items()},
        reading=_reading(head, workpiece.work_offsets if workpiece else PLAIN_OFFSETS),
        orientation=k.orientation.of(head),
        tools=tools,
        tool_titles={number: title for number, title in titles.items() if title is not None},
        tool_corners=_corners(listed),
        equipment=equipment(top),
        scan=_scan(top["scan"], workpiece) if "scan" in top else None,
    )


def equipment(top: Entry) -> dict[str, Entry]:
    """The tables of a scenario or experiment file that name robot, tool, material and sensor, as `load_system` takes them."""
    return {key: top[key].table() for key in EQUIPMENT if key in top}


def _workpiece(entry: Entry) -> Workpiece:
    k = WorkpieceKeys
    k.of(entry)
    if ("size" in entry) == ("stock" in entry):
        raise entry.fail("give either size, of a block, or stock, an STL file")
    stock = _stock(entry) if "stock" in entry else None
    if stock is None:
        size = entry["size"].vector("m")
        if min(size) <= 0.0:
            raise entry["size"].fail(f"{entry['size'].value!r}; expected three positive lengths")
    else:
        x, y, z = np.ptp(stock.reshape(-1, 3), axis=0).tolist()
        size = (x, y, z)
    return Workpiece(k.position.of(entry), size, k.abc.of(entry), _work_offsets(entry, size), stock, k.tool_angle.of(entry))


def _stock(entry: Entry) -> FloatArray:
    """Triangles (n, 3, 3) [m] of `stock`, moved so that the middle of the top of their box is the origin of P."""
    from robomill.models.metrology.stl import StlError, read_stl

    unit = WorkpieceKeys.stock_unit.of(entry)
    if not unit > 0.0:
        raise entry["stock_unit"].fail(f"{entry['stock_unit'].value!r}; expected a positive length")
    try:
        triangles = read_stl(entry["stock"].file(), unit)
    except StlError as error:
        raise entry["stock"].fail(str(error)) from None
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    return np.asarray(triangles - [0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), high[2]], dtype=np.float64)


def _corners(tools: Mapping[str, Entry]) -> dict[int, float]:
    """Corner radii [m] by T number, of the tools that have one."""
    found = {}
    for name, entry in tools.items():
        corner = ToolKeys.corner_radius.of(entry)
        if not 0.0 <= corner <= 0.5 * ToolKeys.diameter.of(entry) * (1.0 + ROUNDING):
            raise entry["corner_radius"].fail(f"{entry['corner_radius'].value!r}; expected 0 (flat) to half of the diameter (ball nose)")
        if corner > 0.0:
            found[int(name)] = corner
    return found


def _scan(entry: Entry, workpiece: Workpiece | None) -> Scan:
    k = ScanKeys
    k.of(entry)
    scan = Scan(k.depth.of(entry), k.margin.of(entry))
    if not scan.depth > 0.0:
        raise entry["depth"].fail(f"{entry['depth'].value!r}; expected a positive length: the plane lies below the top")
    if workpiece is None or not 0.0 <= 2.0 * scan.margin < workpiece.size[0]:
        raise k.margin.entry(entry).fail(f"{scan.margin:g} m at both ends; expected less than half of the length of the block")
    return scan


def _work_offsets(entry: Entry, size: Vector) -> dict[float, Vector]:
    """`zero` and `work_offsets` as the reader of programs takes them."""
    given = WorkpieceKeys.work_offsets.of(entry)
    if "zero" in entry and "G54" in given:
        raise entry["zero"].fail("is the same as work_offsets.G54, which is there, too; give one of them")
    origins = {OFFSETS[name]: _place(value, size) for name, value in given.items()}
    if "zero" in entry:
        origins[54.0] = _place(WorkpieceKeys.zero.of(entry), size)
    return {**PLAIN_OFFSETS, **origins}


def _place(entry: Entry, size: Vector) -> Vector:
    """A point of P [m]: three lengths, or a place of the block by name."""
    if isinstance(entry.value, str):
        try:
            return place_in_block(entry.value, size)
        except ValueError as error:
            raise entry.fail(f"{entry.value!r}: {error}; or three lengths from the centre of the top; give one of these") from None
    return entry.vector("m")


def place_in_block(name: str, size: Vector) -> Vector:
    """A place such as "front-left-top" in P [m], for a block of `size` [m]; front is -y, left -x, "corner" front-left-top.

    ValueError lists the words.
    """
    point: list[float | None] = [None, None, None]
    for word in name.split("-"):
        if word not in _FACES:
            raise ValueError(f"{word!r} is no place of a block; words, joined by '-': {', '.join(_FACES)}")
        for axis, share in _FACES[word]:
            if point[axis] is not None:
                raise ValueError(f"two words for {'xyz'[axis]}; one of left, right, one of front, back, one of top, bottom")
            point[axis] = share * size[axis]
    x, y, z = (0.0 if c is None else c for c in point)
    return x, y, z


def _reading(head: Entry, offsets: Mapping[float, Vector]) -> Setup:
    """The keys of [scenario] that say how the program is read."""
    setup = Setup(work_offsets=offsets)
    zero = offsets[54]
    k = ScenarioHeadKeys
    for key in (k.start, k.home):
        if (point := key.of(head)) is not None:
            x, y, z = (c + o for c, o in zip(point, zero, strict=True))
            setup = replace(setup, start=(x, y, z)) if key is k.start else replace(setup, home=(x, y, z))
    feed, speed = k.feed.of(head), k.spindle_speed.of(head)
    for name, value in (("feed", feed), ("spindle_speed", speed)):
        if value is not None and value <= 0.0:
            raise head[name].fail(f"{head[name].value!r} is not positive; expected a value above 0")
    return replace(
        setup, dialect=k.dialect.of(head), block_delete=k.block_delete.of(head), wear=k.wear.of(head), feed=feed, spindle_speed=speed
    )


def _tool(name: str, entry: Entry) -> tuple[int, EndMill]:
    """`[tools.1]`: T number and end mill."""
    if not name.isdecimal() or int(name) < 1:
        raise entry.fail("a tool is called by its T number; expected 1 or more, such as [tools.1]")
    k = ToolKeys
    k.of(entry)
    for key in (k.diameter, k.cutting_length):
        if key.of(entry) <= 0.0:
            raise key.entry(entry).fail(f"{key.entry(entry).value!r}; expected a positive length")
    teeth = k.teeth.of(entry)
    if teeth > MAX_TEETH:
        raise entry["teeth"].fail(f"expected a whole number from 1 to {MAX_TEETH}; found {teeth}")
    return int(name), EndMill(k.diameter.of(entry), teeth, k.helix.of(entry), k.cutting_length.of(entry))


def variant(name: str, entry: Entry) -> Variant:
    """`[variants.cartesian]`."""
    k = VariantKeys
    k.of(entry)
    if Entry(entry.content, name, entry.key).folder_name() in _FOLDERS:
        raise entry.fail(
            f"a variant cannot be called {name!r}: the results have a folder of that name; taken: {', '.join(_FOLDERS)}"
            "; choose another name"
        )
    return Variant(name, k.title.of(entry) or name, k.parameters.of(entry), k.sources.of(entry))


def published_figures(entry: Entry) -> dict[str, float]:
    """Published figures; the name ends in the unit they are kept in, as in summary.json."""
    units = {key: next((u for suffix, u in reversed(_PAPER_UNITS.items()) if key.endswith(suffix)), None) for key in entry.table().value}
    for key in (k for k, unit in units.items() if unit is None):
        raise entry[key].fail(f"the name of a figure ends in its unit, as in summary.json: {', '.join(_PAPER_UNITS)}")
    return {key: entry[key].si(unit) for key, unit in units.items() if unit is not None}
