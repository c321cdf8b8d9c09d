"""The robot's side of the link: drive, compliance, milling and sensor of a cell behind the protocol of a KUKA controller.

The robot controller is the client and the clock: one packet per cycle, IPOC grows by `ipoc`, an answer counts if it brings back the IPOC
of this cycle before the next one begins. Without one, elements with HOLDON = 1 keep their values, the others are 0, and `Delay` grows.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from robomill.cell.equipment import robot_of, tool_of
from robomill.cell.rsi.ethernet import AXES, POSE
from robomill.cell.rsi.network import Direction, Faults
from robomill.cell.rsi.partner import DELAY, Partner, rob_telegram, sen_telegram
from robomill.cell.rsi.pose import Pose
from robomill.cell.rsi.settings import Link, LinkError
from robomill.cell.rsi.sides import HORIZON, Arriving, Leaving, master_of, open_side, warm_up
from robomill.cell.rsi.watchdog import NANO
from robomill.orchestration.errors import unknown
from robomill.orchestration.runs.memory import Memory
from robomill.orchestration.runs.run import Run
from robomill.orchestration.system.definition import System

TIMEOUT = 100
"""Late packets in a row that end a session (FACTS of KUKA's package: its default)."""
FIRST_IPOC = 4_208_000
"""IPOC of the first packet; any whole number would do."""


class Krc:
    """The simulator: `advance`, `packet`, then `take` for each answer that comes, then `end_cycle`; and so on."""

    def __init__(self, link: Link, system: System, timeout: int = TIMEOUT) -> None:
        """`system`: the whole cell, ready to run. Raises what `assemble` raises; LinkError for a system that has no end."""
        if system.stop_when is None and system.stop is None:
            raise LinkError(f"system {system.name!r} has no end: give it stop or stop_when")
        self.link, self.system, self._timeout = link, system, timeout
        self.rob, self.sen = rob_telegram(link), sen_telegram(link)
        warm_up(system, link, partner=False)
        self.side = open_side(system, link, partner=False)
        self._memory = Memory(self.side.assembly.about())
        self._master = master_of(self.side, system, [self._memory])
        wiring = self.side.assembly.wiring
        names = wiring.column_names()
        self._leaving = Leaving(link.send, self.rob.index, names)
        self._arriving = Arriving(link.receive, self.sen.index, self.side.remotes)
        self._axes = [_columns(names, port, "robot") for port in (link.actual, link.planned)]
        self._poses = Pose(robot_of(system), tool_of(system))
        watched = self.side.assembly.system.stop_when
        self._stop = names.index(watched) if watched else None
        holdon = {name: e.holdon for name, e in link.config.received().items()}
        self._dropped = np.array([i for i, p in enumerate(self.sen.places) if not holdon.get(p.name, True)], np.intp)
        self._values = np.zeros_like(self.sen.values)
        self._memory.begin(wiring, system.step)
        self._begun = False
        self.ipoc = FIRST_IPOC - link.watch.ipoc
        self.answered = False
        """Whether an answer of this cycle has come."""
        self.late = self.foreign = self._in_a_row = 0
        """Cycles without their answer; answers that are none, or of another cycle."""
        self.ended = ""
        """Why the session is over; "" while it is not."""

    def close(self) -> None:
        """Close the components."""
        self.side.close()

    def advance(self) -> None:
        """The next cycle of the robot, with the corrections that came in the last one."""
        if self._begun:
            self._master.step()
        else:
            self._master.initialise(0.0, HORIZON)
            self._begun = True
        self.ipoc += self.link.watch.ipoc
        self.answered = False

    def packet(self) -> bytes:
        """The packet of this cycle."""
        values, outputs = self.rob.values, self._master.outputs
        for columns, axes, pose in zip(self._axes, ("AIPos", "ASPos"), ("RIst", "RSol"), strict=True):
            q = outputs[columns]
            for tag, names, numbers in ((axes, AXES, np.rad2deg(q)), (pose, POSE, self._poses.of(q))):
                for name, number in zip(names, numbers, strict=True):
                    if (place := self.rob.index.get(f"{tag}.{name}")) is not None:
                        values[place] = number
        if (place := self.rob.index.get(DELAY)) is not None:
            values[place] = self.rob.wholes[place] = self.late
        self._leaving.take(outputs)
        values[self._leaving.places] = self._leaving.values
        self.rob.ipoc = self.ipoc
        return bytes(self.rob.view(self.rob.write()))

    def take(self, answer: bytes) -> bool:
        """An answer has come; whether it is the one of this cycle."""
        if self.sen.read(self.sen.put(answer)) or self.sen.ipoc != self.ipoc or self.answered:
            self.foreign += 1
            return False
        self._values[:] = self.sen.values
        self.answered = True
        return True

    def end_cycle(self) -> None:
        """The cycle is over: corrections for the next one, the count of late answers, the end of the session."""
        self._in_a_row = 0 if self.answered else self._in_a_row + 1
        if not self.answered:
            self.late += 1
            self._values[self._dropped] = 0.0
        self._arriving.take(self._values)
        t = self._master.time
        if self._in_a_row >= self._timeout:
            self.ended = f"{self._in_a_row} answers in a row were late: RSI ends with a timeout at t = {t:.3f} s"
        elif self._stop is not None and self._master.outputs[self._stop] != 0.0:
            self.ended = f"the program is finished at t = {t:.3f} s"
        elif self.system.stop is not None and t >= self.system.stop - 0.5 * self.system.step:
            self.ended = f"stopped at t = {t:.3f} s"

    def run(self) -> Run:
        """What the robot did so far."""
        self._memory.end("finished" if self._in_a_row < self._timeout else "failed", self.ended)
        return self._memory.run()


def _columns(names: list[str], port: str, what: str) -> Any:
    found = np.array([i for i, n in enumerate(names) if n.partition("[")[0] == port], np.intp)
    if len(found) != len(AXES):
        raise LinkError(
            f"[robot]: {unknown(f'output of the {what} with six elements:', port, dict.fromkeys(n.partition('[')[0] for n in names))}"
        )
    return found


def lockstep(krc: Krc, partner: Partner, faults: Faults | None = None, most: int | None = None) -> None:
    """Run both sides by turns on a virtual clock, without sockets, until the robot's program is finished or `most` cycles are done."""
    there, back = Direction(faults or Faults(), 0), Direction(faults or Faults(), 1)
    cycle = round(NANO * krc.system.step)
    now = 0
    while not krc.ended and (most is None or now < most * cycle):
        krc.advance()
        for packet in there.carry(krc.packet()):
            length = partner.answer(partner.rob.put(packet), now)
            if length:
                answer = bytes(partner.sen.view(length))
                partner.sent(now)
                for came in back.carry(answer):
                    krc.take(came)
        krc.end_cycle()
        now += cycle
