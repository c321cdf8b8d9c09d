"""The file of a link: which system is cut where, which element of the telegram is which port, limits and watchdog.

Both sides read it. Its keys are declared below (`LinkKeys`), with an example in docs/reference/formats/link.md.
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
from robomill.orchestration.system import keys
from robomill.orchestration.system.definition import System
from robomill.orchestration.system.entries import Entry
from robomill.orchestration.system.keys import Keys, Kind, default, optional, required

MOST_DECIMALS = 12


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


def _positive(entry: Entry, unit: str) -> float:
    value = entry.si(unit)
    if not value > 0.0:
        raise entry.expected(f"a positive value in {unit}")
    return value


def _time() -> Kind[float]:
    return Kind(lambda e: _positive(e, "s"), "quantity above 0", "s")


class LinkHeadKeys(Keys):
    """What is linked. Give either `scenario` or `system`."""

    name = required(keys.folder_name(), "name of the link; recordings stand in a folder of that name")
    scenario = optional(keys.file(), "milling scenario whose program is run, with its system")
    variant = optional(keys.text(), "variant of the scenario (default: the first)")
    system = optional(keys.file(), "system file, without a program")
    partner = required(keys.texts(), "components that answer; all others are on the robot's side")
    ethernet = required(keys.file(), "KUKA's configuration of the RSI object ETHERNET (XML)")
    decimals = default(4, keys.count(0), f"decimals that both sides write, at most {MOST_DECIMALS}")


class RobotSideKeys(Keys):
    """What the simulated controller sends of its own: AIPos and RIst, ASPos and RSol."""

    actual = default("drive.q_motor", keys.text(), "port with the actual axis angles")
    planned = default("path.q_ref", keys.text(), "port with the planned axis angles")


class WatchdogKeys(Keys):
    """What is tolerated before the correction is taken back."""

    silence = default("20 ms", _time(), "time without a packet after which the robot controller has failed")
    ramp = default("200 ms", _time(), "time in which the correction goes to zero")
    end = default("400 ms", _time(), "time without a packet after which the session is over; longer than `silence`")
    gap = default(10, keys.count(1), "cycles that may be lost at once")
    unusable = default(5, keys.count(1), "malformed or old packets in a row that are passed over")
    ipoc = default(4, keys.count(1), "what IPOC grows by per cycle, in ms")


class ElementKeys(Keys):
    """A port and its place in the telegram. Give either `element` or `elements`."""

    port = required(keys.text(), "output of a component, `component.port`")
    unit = required(keys.text(), "unit on the wire")
    element = optional(keys.text(), "a tag of the telegram with all its attributes, such as `AIPos`")
    elements = optional(keys.texts(), "attributes one by one, such as `RIst.X`")


class SendKeys(ElementKeys):
    """Robot to partner: an output of the robot's side. Give either `element` or `elements`."""

    most = optional(keys.anything("quantity above 0"), "larger magnitudes mean that a sensor has failed")
    frozen = optional(_time(), "a sensor that shows the same value for so long, and not zero, has failed")


class ReceiveKeys(ElementKeys):
    """Partner to robot: an output of the partner. Give either `element` or `elements`."""

    limit = optional(keys.anything("quantity above 0"), "largest magnitude of each value that is sent")
    rate = optional(keys.anything("quantity above 0"), "largest change of each value per second")


class LinkKeys(Keys):
    """A link between a robot controller and a partner over KUKA RSI; both sides read it."""

    link = required(keys.table(LinkHeadKeys), "what is linked")
    robot = default({}, keys.table(RobotSideKeys), "what the simulated controller sends of its own")
    watchdog = default({}, keys.table(WatchdogKeys), "what is tolerated")
    send = required(keys.each(SendKeys), "robot to partner")
    receive = required(keys.each(ReceiveKeys), "partner to robot")


def load_link(path: str | Path) -> Link:
    """Read and check a link file. LinkError, EthernetError or FileNotFoundError says what is wrong and what is possible."""
    file = Path(path)
    if not file.is_file():
        raise FileNotFoundError(f"no link file {file}; scenarios/rsi/link.toml is one")
    top, k = LinkKeys.of(Entry.load(file, LinkError, convert)), LinkHeadKeys
    head = LinkKeys.link.of(top)
    system, scenario, variant = _system(head)
    partner = k.partner.of(head)
    for name in partner:
        if name not in (names := [c.name for c in system.components]):
            raise head["partner"].fail(unknown("component", name, names))
    if not 0 < len(partner) < len(system.components):
        raise head["partner"].fail(
            "some components are the partner's and some the robot's: neither all nor none; name those that answer in partner"
        )
    decimals = k.decimals.of(head)
    if decimals > MOST_DECIMALS:
        raise head["decimals"].expected(f"0 to {MOST_DECIMALS}")
    config = ethernet.read(k.ethernet.of(head))
    if config.only_send:
        raise head["ethernet"].fail("ONLYSEND is TRUE: the robot takes no answers; set it to FALSE")
    places = {side: [*names] for side, names in (("send", config.sent()), ("receive", config.received()))}
    signals = {side: tuple(_signal(e, side, system, partner, places[side]) for e in top[side].each()) for side in ("send", "receive")}
    for side, found in signals.items():
        names = [n for s in found for n in s.names]
        if twice := sorted({n for n in names if names.count(n) > 1}):
            raise top[side].fail(f"{', '.join(twice)} stands for two ports; an element is one value; leave one of them out")
    robot = LinkKeys.robot.of(top)
    return Link(
        k.name.of(head), system, scenario, variant, partner, config, decimals, signals["send"], signals["receive"],
        _watch(LinkKeys.watchdog.of(top)), RobotSideKeys.actual.of(robot), RobotSideKeys.planned.of(robot),
    )  # fmt: skip


def _system(head: Entry) -> tuple[System, Scenario | None, Variant | None]:
    if ("scenario" in head) == ("system" in head):
        raise head.fail("one of scenario (with variant) and system is needed, and not both")
    if "system" in head:
        if "variant" in head:
            raise head["variant"].fail("goes with a scenario; give scenario in place of system, or leave variant out")
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
    (SendKeys if sends else ReceiveKeys).of(entry)
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
        raise entry.fail(
            f"{len(names)} elements of the telegram ({', '.join(names)}), but {component}.{port} has {len(ports)}"
            "; give as many elements as the port has"
        )
    unit, wanted = entry["unit"].text(), ports[0].unit or "1"
    if not compatible(unit, wanted) or convert(0.0, unit, wanted) != 0.0:
        raise entry["unit"].fail(f"{unit!r} does not measure what {component}.{port} is in: {wanted}; give a unit of the same dimension")
    limits: Mapping[str, float] = {
        key: _positive(entry[key], u) for key, u in (("limit", unit), ("rate", f"{unit}/s"), ("most", unit)) if key in entry
    }
    unchanged = SendKeys.frozen.of(entry) if sends else None
    frozen = 0 if unchanged is None else max(1, round(unchanged / system.step))
    return Signal(component, ports, names, convert(1.0, unit, wanted), frozen=frozen, **limits)


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
    k = WatchdogKeys
    silence, end = k.silence.of(entry), k.end.of(entry)
    if end <= silence:
        raise entry.fail(f"end ({end:g} s) must be longer than silence ({silence:g} s); increase end, or lower silence")
    return WatchSettings(silence, k.ramp.of(entry), end, k.gap.of(entry), k.unusable.of(entry), k.ipoc.of(entry))
