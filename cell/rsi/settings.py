"""The file of a link: which system is cut where, which element of the telegram is which port, limits and watchdog.

A link file is TOML, read by both sides::

    [link]
    name = "groove_rsi"
    scenario = "../groove.toml"         # what is milled, and its system; or system = "cell.toml" alone
    variant = "cartesian_pilot"
    partner = ["controller"]            # components that answer; all others are the robot's side
    ethernet = "ethernet.xml"           # KUKA's configuration of the RSI object ETHERNET
    decimals = 4                        # that both sides write

    [robot]                             # what the simulator of the robot sends of its own: AIPos and RIst, ASPos and RSol
    actual = "drive.q_motor"
    planned = "path.q_ref"

    [watchdog]
    silence = "20 ms"                   # without a packet: the robot controller has failed
    ramp = "200 ms"                     # the correction goes to zero within
    end = "400 ms"                      # without a packet: the session is over
    gap = 10                            # cycles that may be lost at once
    unusable = 5                        # malformed or old packets in a row that are passed over
    ipoc = 4                            # what IPOC grows by per cycle, ms

    [[send]]                            # robot -> partner: element(s) of the telegram -> output of a component of the robot's side
    element = "AIPos"                   # all its attributes; or elements = ["RIst.X", "RIst.Y", "RIst.Z"]
    port = "drive.q_motor"
    unit = "deg"                        # on the wire
    most = "3 kN"                       # optional: a larger magnitude is a failed sensor
    frozen = "100 ms"                   # optional: so long the same, and not zero: a failed sensor

    [[receive]]                         # partner -> robot: output of a component of the partner -> element(s)
    elements = ["RKorr.X", "RKorr.Y", "RKorr.Z"]
    port = "controller.correction_B"
    unit = "mm"
    limit = "5 mm"                      # of each value
    rate = "100 mm/s"                   # of its change
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from robomill.cell.binding import convert
from robomill.cell.equipment import load_system, ports_of
from robomill.cell.rsi import ethernet
from robomill.cell.rsi.ethernet import Ethernet
from robomill.cell.scenario import Scenario, Variant, load_scenario
from robomill.models.model.units import compatible
from robomill.orchestration.errors import unknown
from robomill.orchestration.slaves.protocol import PortData, arrays, outputs, plain
from robomill.orchestration.system.definition import System
from robomill.orchestration.system.entries import Entry

MOST_DECIMALS = 12
_TIMES = {"silence": "20 ms", "ramp": "200 ms", "end": "400 ms"}
_COUNTS = {"gap": 10, "unusable": 5, "ipoc": 4}


class LinkError(ValueError):
    """A link file that cannot be used; the text names file, line, key, what was found and what is expected."""


@dataclass(frozen=True)
class Signal:
    """One array of a component that goes over the wire."""

    component: str
    ports: tuple[PortData, ...]
    """Its elements."""
    names: tuple[str, ...]
    """Places of the telegram, one per element."""
    factor: float
    """Value of the port = factor * value on the wire."""
    limit: float = math.inf
    """Largest magnitude of a value that is sent to the robot, on the wire."""
    rate: float = math.inf
    """Largest change of it per second."""
    most: float = math.inf
    """Magnitude of the vector beyond which a sensor has failed, on the wire."""
    frozen: int = 0
    """Cycles after which an unchanged vector that is not zero is one of a failed sensor; 0: never."""

    @property
    def array(self) -> str:
        """`drive.q_motor`."""
        return f"{self.component}.{self.ports[0].name.partition('[')[0]}"


@dataclass(frozen=True)
class WatchSettings:
    """What the watchdog tolerates; times in s."""

    silence: float
    ramp: float
    end: float
    gap: int
    unusable: int
    ipoc: int


@dataclass(frozen=True)
class Link:
    """A link file."""

    name: str
    system: System
    """The whole cell, with the parameters of scenario and variant, without tables of a plan."""
    scenario: Scenario | None
    variant: Variant | None
    partner: tuple[str, ...]
    config: Ethernet
    decimals: int
    send: tuple[Signal, ...]
    receive: tuple[Signal, ...]
    watch: WatchSettings
    actual: str
    planned: str


def load_link(path: str | Path) -> Link:
    """Read and check a link file. LinkError, EthernetError or FileNotFoundError says what is wrong and what is possible."""
    file = Path(path)
    if not file.is_file():
        raise FileNotFoundError(f"no link file {file}; scenarios/rsi/link.toml is one")
    top = Entry.load(file, LinkError, convert).keys({"link", "send", "receive"}, {"robot", "watchdog"})
    head = top["link"].keys({"name", "partner", "ethernet"}, {"scenario", "variant", "system", "decimals"})
    system, scenario, variant = _system(head)
    partner = head["partner"].texts()
    for name in partner:
        if name not in (names := [c.name for c in system.components]):
            raise head["partner"].fail(unknown("component", name, names))
    if not 0 < len(partner) < len(system.components):
        raise head["partner"].fail("some components are the partner's and some the robot's: neither all nor none")
    decimals = head.get("decimals", 4).count(0)
    if decimals > MOST_DECIMALS:
        raise head["decimals"].expected(f"0 to {MOST_DECIMALS}")
    config = ethernet.read(head["ethernet"].file())
    if config.only_send:
        raise head["ethernet"].fail("ONLYSEND is TRUE: the robot takes no answers; set it to FALSE")
    places = {side: [*names] for side, names in (("send", config.sent()), ("receive", config.received()))}
    signals = {side: tuple(_signal(e, side, system, partner, places[side]) for e in top[side].each()) for side in ("send", "receive")}
    for side, found in signals.items():
        names = [n for s in found for n in s.names]
        if twice := sorted({n for n in names if names.count(n) > 1}):
            raise top[side].fail(f"{', '.join(twice)} stands for two ports; an element is one value")
    robot = top.get("robot", {}).keys((), {"actual", "planned"})
    return Link(
        head["name"].folder_name(), system, scenario, variant, partner, config, decimals, signals["send"], signals["receive"],
        _watch(top.get("watchdog", {})), robot.get("actual", "drive.q_motor").text(), robot.get("planned", "path.q_ref").text(),
    )  # fmt: skip


def _system(head: Entry) -> tuple[System, Scenario | None, Variant | None]:
    if ("scenario" in head) == ("system" in head):
        raise head.fail("one of scenario (with variant) and system is needed, and not both")
    if "system" in head:
        if "variant" in head:
            raise head["variant"].fail("goes with a scenario")
        return load_system(head["system"].file()), None, None
    scenario = load_scenario(head["scenario"].file())
    if scenario.kind != "milling":
        raise head["scenario"].fail(f"is of kind {scenario.kind}; expected milling")
    names = {v.name: v for v in scenario.variants}
    variant = names[head.get("variant", next(iter(names))).choice(names)]
    system = load_system(scenario.system, scenario.equipment, variant.sources)
    for given in (scenario.parameters, variant.parameters):
        for component, values in given.items():
            system = system.with_parameters(component, values)
    return system, scenario, variant


def _signal(entry: Entry, side: str, system: System, partner: Sequence[str], places: Sequence[str]) -> Signal:
    """An entry of [[send]] or [[receive]]; its factor and limits are those of the wire."""
    sends = side == "send"
    entry.keys({"port", "unit"}, {"element", "elements", *(("most", "frozen") if sends else ("limit", "rate"))})
    component, _, port = entry["port"].text().partition(".")
    theirs = [c.name for c in system.components if (c.name not in partner) == sends]
    if component not in theirs:
        raise entry["port"].fail(unknown(f"component of the {'robot' if sends else 'partner'}'s side", component, theirs))
    found = arrays(outputs(ports_of(system, component)))
    if port not in found:
        raise entry["port"].fail(unknown(f"output of {component!r}:", port, found))
    ports = tuple(plain(p) for p in found[port])
    names = _names(entry, places)
    if len(names) != len(ports):
        raise entry.fail(f"{len(names)} elements of the telegram ({', '.join(names)}), but {component}.{port} has {len(ports)}")
    unit, wanted = entry["unit"].text(), ports[0].unit or "1"
    if not compatible(unit, wanted) or convert(0.0, unit, wanted) != 0.0:
        raise entry["unit"].fail(f"{unit!r} does not measure what {component}.{port} is in: {wanted}")
    optional: Mapping[str, float] = {
        key: _positive(entry[key], u) for key, u in (("limit", unit), ("rate", f"{unit}/s"), ("most", unit)) if key in entry
    }
    frozen = max(1, round(_positive(entry["frozen"], "s") / system.step)) if "frozen" in entry else 0
    return Signal(component, ports, names, convert(1.0, unit, wanted), frozen=frozen, **optional)


def _positive(entry: Entry, unit: str) -> float:
    value = entry.si(unit)
    if not value > 0.0:
        raise entry.expected(f"a positive value in {unit}")
    return value


def _names(entry: Entry, places: Sequence[str]) -> tuple[str, ...]:
    if ("element" in entry) == ("elements" in entry):
        raise entry.fail("one of element (a whole tag) and elements (a list) is needed, and not both")
    if "element" in entry:
        tag = entry["element"].text()
        names = tuple(p for p in places if p.partition(".")[0] == tag)
        if not names:
            raise entry["element"].fail(unknown("element", tag, dict.fromkeys(p.partition(".")[0] for p in places)))
        return names
    names = entry["elements"].texts()
    for name in names:
        if name not in places:
            raise entry["elements"].fail(unknown("element", name, places))
    return names


def _watch(entry: Entry) -> WatchSettings:
    entry.keys((), {*_TIMES, *_COUNTS})
    times = {key: _positive(entry.get(key, default), "s") for key, default in _TIMES.items()}
    if times["end"] <= times["silence"]:
        raise entry.fail(f"end ({times['end']:g} s) must be longer than silence ({times['silence']:g} s)")
    counts = {key: entry.get(key, default).count(1) for key, default in _COUNTS.items()}
    return WatchSettings(times["silence"], times["ramp"], times["end"], counts["gap"], counts["unusable"], counts["ipoc"])
