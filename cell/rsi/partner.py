"""The partner of a robot controller: a packet in, an answer out. Sockets and clocks are elsewhere (`link.py`)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from robomill.cell.rsi import limits
from robomill.cell.rsi.session import Session
from robomill.cell.rsi.settings import Link, Signal
from robomill.cell.rsi.sides import HORIZON, Arriving, Leaving, master_of, open_side, warm_up
from robomill.cell.rsi.telegram import Place, Telegram
from robomill.cell.rsi.telegram_kernels import WHOLE
from robomill.cell.rsi.watchdog import NANO, STATES, WAITING, Watchdog
from robomill.models.model.compiled import compiled
from robomill.orchestration.errors import OrchestrationError
from robomill.orchestration.system.definition import System

DELAY = "Delay.D"


def rob_telegram(link: Link) -> Telegram:
    """`<Rob>`: what the robot controller sends."""
    return Telegram("Rob", 'TYPE="KUKA"', [Place(name, _decimals(kind, link)) for name, kind in link.config.sent().items()])


def sen_telegram(link: Link) -> Telegram:
    """`<Sen>`: what it receives."""
    return Telegram(
        "Sen", f'Type="{link.config.sentype}"', [Place(name, _decimals(e.type, link)) for name, e in link.config.received().items()]
    )


def _decimals(kind: str, link: Link) -> int:
    return link.decimals if kind == "DOUBLE" else WHOLE


class Partner:
    """The components of the partner behind the telegrams.

    `rob.buffer` takes a packet, `answer` works on it, `sen.buffer` holds the answer. Corrections are bounded and watched whatever the
    components say; an error of a component, or an output out of its range, is a fault like the others.
    """

    def __init__(self, link: Link, system: System, rows: int) -> None:
        """`system`: the whole cell, ready to run; `rows`: steps that the session keeps. Raises what `assemble` raises."""
        self.link = link
        self.rob, self.sen = rob_telegram(link), sen_telegram(link)
        self.watchdog = Watchdog(link.watch)
        warm_up(system, link, partner=True)
        self.side = open_side(system, link, partner=True)
        wiring = self.side.assembly.wiring
        self._master = master_of(self.side, system)
        self._outputs = self._master.outputs
        self._arriving = Arriving(link.send, self.rob.index, self.side.remotes)
        self._leaving = Leaving(link.receive, self.sen.index, wiring.column_names())
        self._sent = np.zeros(len(self._leaving.places))
        self._held = np.zeros_like(self._sent)
        self._limit = np.array([s.limit for s in link.receive for _ in s.names])
        self._change = np.array([s.rate * system.step for s in link.receive for _ in s.names])
        self._to_ports = np.array([s.factor for s in link.receive for _ in s.names])
        self._in_ports = np.zeros_like(self._sent)
        self._delay = self.rob.index.get(DELAY, -1)
        self._force = _Force(link, self.rob)
        self._bound = compiled(limits.bound)
        self._bound(self._sent, self._held, False, 1.0, self._limit, self._change, self._sent)
        self._cycle = round(NANO * system.step)
        self._before = 0
        self._steps = True
        self.session = Session(wiring.outputs, [p for s in link.receive for p in s.ports], rows)
        self.system = system

    def close(self) -> None:
        """Close the components."""
        self.side.close()

    def answer(self, length: int, now: int) -> int:
        """Work on the packet in `rob.buffer` that came at `now` [ns]; the length of the answer in `sen.buffer`, 0 if there is none."""
        w = self.watchdog
        w.counts["received"] += 1
        status = self.rob.read(length)
        if status:
            w.malformed(self.rob.explain(status), now)
            return 0
        waiting = w.state == WAITING
        cycles = w.arrived(self.rob.ipoc, now)
        if not cycles:
            return 0
        why = self._force.check(self.rob.values)
        if why:
            w.fail(why, now)
        self._step(waiting, cycles, now)
        self._leaving.take(self._outputs)
        if not w.failed:
            self._held[:] = self._sent
        share = w.share(now)
        w.counts["clipped"] += self._bound(self._leaving.values, self._held, w.failed, share, self._limit, self._change, self._sent)
        self.sen.values[self._leaving.places] = self._sent
        self.sen.ipoc = self.rob.ipoc
        n = self.sen.write()
        w.counts["answered"] += 1
        self._now, self._share = now, share
        return n

    def _step(self, waiting: bool, cycles: int, now: int) -> None:
        """Step the components over these cycles: with the values held over those that were lost, with the new ones in the last."""
        if not self._steps:
            return
        try:
            for made in range(cycles):
                if made == cycles - 1:
                    self._arriving.take(self.rob.values)
                if waiting:
                    self._master.initialise(0.0, HORIZON, observed=False)
                else:
                    self._master.step()
                if self.session.full:
                    self.watchdog.counts["unrecorded"] += 1
                else:
                    self.session.keep(self._master.time, self._outputs)
        except OrchestrationError as error:
            self._steps = False
            self.watchdog.fail(f"the partner's components: {error}", now)

    def sent(self, now: int) -> None:
        """The answer has gone at `now` [ns]: count it if it is late, and note it in the session."""
        turnaround = now - self._now
        if turnaround > self._cycle:
            self.watchdog.counts["late"] += 1
        interval = (self._now - self._before) / NANO if self._before else 0.0
        self._before = self._now
        if self.session.full or not self._steps or not self.session.count:
            return
        np.multiply(self._sent, self._to_ports, out=self._in_ports)
        w = self.watchdog
        delay = self.rob.values[self._delay] if self._delay >= 0 else 0.0
        self.session.say((w.state, self._share, w.counts["lost"], interval, turnaround / NANO, delay), self._in_ports)

    def summary(self) -> dict[str, Any]:
        """Counts, state and fault of the session so far."""
        w = self.watchdog
        state, fault = ("over", "") if w.only_silent else (STATES[w.state], w.fault)
        return {"state": state, "fault": fault, "ipoc": w.ipoc, "cycles": self.session.count, **w.counts}

    def write(self, folder: Path, info: Mapping[str, Any], ended: str, overwrite: bool = False) -> None:
        """Write the session as a run folder; `ended`: why it is over. The outcome is `failed` after a fault.

        That the robot controller stopped sending is the end of a session and no fault of it.
        """
        w = self.watchdog
        failed = w.failed and not w.only_silent
        parameters = {**info.get("parameters", {}), **{n: dict(v) for n, v in self.side.assembly.parameters.items() if v}}
        about = {
            **info,
            "outcome": "failed" if failed else "finished",
            "message": w.fault if failed else ended,
            "system": self.system.name,
            "sources": {c.name: c.source for c in self.system.components if c.name in self.link.partner},
            "parameters": parameters,
            "link": {**self.summary(), "notes": list(self.side.notes)},
        }
        self.session.write(folder, about, overwrite)


class _Force:
    """The sensors among the values that come."""

    def __init__(self, link: Link, rob: Telegram) -> None:
        self._signals = [s for s in link.send if math.isfinite(s.most) or s.frozen]
        self._places = np.array([rob.index[n] for s in self._signals for n in s.names], np.intp)
        self._values = np.zeros(len(self._places))
        self._last = np.zeros(len(self._places))
        self._first = np.cumsum([0, *(len(s.names) for s in self._signals)])
        self._most = np.array([s.most for s in self._signals])
        self._frozen = np.array([s.frozen for s in self._signals], np.int64)
        self._still = np.zeros(len(self._signals), np.int64)
        self._watch = compiled(limits.watch)
        self.check(rob.values)

    def check(self, values: Any) -> str:
        """What is wrong with a sensor, "" if nothing is."""
        if not self._signals:
            return ""
        values.take(self._places, out=self._values, mode="clip")
        found = self._watch(self._values, self._first, self._most, self._frozen, self._still, self._last)
        if not found:
            return ""
        s: Signal = self._signals[(found - 1) // 2]
        names = ", ".join(s.names)
        if (found - 1) % 2 + 1 == limits.TOO_LARGE:
            return f"the sensor {s.array} ({names}) shows more than {s.most:g} on the wire; expected at most that"
        return f"the sensor {s.array} ({names}) has shown the same value for {s.frozen} cycles"
