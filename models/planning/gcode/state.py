"""What a control remembers from block to block: modal codes, coordinate systems, position; and how a reading is set up."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, get_args

from robomill.models.planning.gcode.actions import Dwell, Move, Vector
from robomill.models.planning.gcode.codes import CYCLES
from robomill.models.planning.gcode.notes import Notes
from robomill.models.planning.gcode.words import Block

AXES = "XYZ"
RPM = math.pi / 30.0
CLEARANCE = 0.010
"""Height [m] over the top of the block at which a path starts that does not say where."""
HOME = (0.0, 0.0, 0.100)
"""Where G28, G30 and G53 lead [m in P] unless the scenario says: 100 mm over the middle of the block's top. A robot has no machine zero."""

Dialect = Literal["linuxcnc", "fanuc", "haas", "marlin"]
DIALECTS: tuple[Dialect, ...] = get_args(Dialect)
"""Whose reading of G4 and of P in cycles holds; see `State.seconds`."""


@dataclass(frozen=True)
class Setup:
    """How a program is read where it does not say itself. Lengths in m, in the workpiece frame P."""

    tolerance: float = 1e-4
    """Blend tolerance [m] until G61 or G64 P says otherwise, and of a G64 without P."""
    work_offsets: Mapping[float, Vector] = field(default_factory=lambda: {54: (0.0, 0.0, 0.0)})
    """Origins of G54 (54) .. G59.3 (59.3) in P."""
    start: Vector | None = None
    """Where the tool stands before the first block; None: over the first point, clear of the block."""
    home: Vector = HOME
    """Where G28, G30 and G53 lead."""
    dialect: Dialect = "linuxcnc"
    block_delete: bool = True
    """Lines that begin with ``/`` are skipped (the switch of LinuxCNC is on at the start, too)."""
    feed: float | None = None
    """Feed [m/s] until the program names one."""
    spindle_speed: float | None = None
    """Spindle speed [rad/s], clockwise, until the program names one: routers are often switched by hand."""
    wear: bool = False
    """G41 and G42 correct wear only: the program has the centre path, and D holds nothing here."""


@dataclass
class Cycle:
    """What a canned cycle keeps from block to block (lengths in m, P)."""

    initial: float
    """Height before the first cycle of the series: where G98 retracts to."""
    retract: float | None = None
    depth: float | None = None
    peck: float | None = None
    dwell: float = 0.0


@dataclass
class State:
    """Modal state; SI, positions in P."""

    setup: Setup
    notes: Notes
    position: list[float | None]
    origins: dict[float, Vector]
    home: list[float]
    actions: list[Move | Dwell] = field(default_factory=list)
    motion: float | None = None
    before_cycle: float | None = None
    """What G80 leads back to."""
    cycle: Cycle | None = None
    plane: int = 17
    unit: float = 1e-3
    absolute: bool = True
    absolute_centre: bool = False
    centre_named: bool = False
    """The program has said G90.1 or G91.1."""
    system: float = 54
    used: set[float] = field(default_factory=set)
    """Work offsets that coordinates were given in."""
    shift: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    """G92 [m]."""
    shift_kept: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    local: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    """G52 [m]."""
    feed_mode: int = 94
    feed: float | None = None
    """m/s (G94) or m per revolution (G95)."""
    speed: float | None = None
    direction: int = 0
    tolerance: float = 0.0
    retract_to_r: bool = False
    selected_tool: int = 0
    tool: int = 0
    ended: bool = False

    @property
    def spindle_speed(self) -> float:
        """rad/s, signed."""
        return self.direction * (self.speed or 0.0)

    def offset(self, axis: int) -> float:
        """Program zero of an axis in P [m]."""
        return self.origins[self.system][axis] + self.shift[axis] + self.local[axis]

    def target(self, block: Block, words: dict[str, float]) -> list[float | None]:
        """The point that a block's axis words lead to; they are taken out of `words`."""
        end = list(self.position)
        for i, axis in enumerate(AXES):
            if axis in words:
                value = words.pop(axis) * self.unit
                if self.absolute:
                    end[i] = value + self.offset(i)
                else:
                    known = end[i]
                    end[i] = value + (self.begin(i) if known is None else known)
        self.used.add(self.system)
        return end

    def begin(self, axis: int, first: float | None = None) -> float:
        """The coordinate at which the tool stands in an axis that the program has not named yet; it is noted.

        Across: over `first`, the first coordinate that is programmed, else over program zero. Up: clear of the block.
        """
        if axis == 2:
            value = max(CLEARANCE, CLEARANCE if first is None else first)
        else:
            value = self.offset(axis) if first is None else first
        self.position[axis] = value
        self.notes.say(
            f"the program does not say where it comes from: it starts over its first point, {1e3 * CLEARANCE:g} mm over the block's top; "
            "give the place with --start X Y Z or start = [..]"
        )
        return value

    def seconds(self, value: float, point: bool) -> float:
        """A dwell P in seconds: linuxcnc as it stands, fanuc and marlin in ms, haas in ms unless it has a decimal `point`."""
        milliseconds = self.setup.dialect in ("fanuc", "marlin") or (self.setup.dialect == "haas" and not point)
        return value * (1e-3 if milliseconds else 1.0)

    def rest(self, block: Block, duration: float = 0.0) -> None:
        """A standstill, once the path has begun."""
        if self.actions or all(c is not None for c in self.position):
            self.actions.append(Dwell(block.line, block.number, duration, self.spindle_speed, self.tool))

    def begin_motion(self, code: int) -> None:
        """G0..G3 or a cycle is in force from here on."""
        if code in CYCLES:
            if self.motion not in CYCLES:
                self.before_cycle = self.motion
        else:
            self.cycle = None
        self.motion = code

    def cancel_cycle(self) -> None:
        """G80: the cycle is over, and what held before it holds again."""
        if self.motion in CYCLES:
            self.motion = self.before_cycle
        self.cycle = None
