"""What the partner makes of the packets that come, and of those that do not: states, counts, the way of the correction to zero.

A fault is latched: the correction goes to zero along a straight line in time and stays there until a new session.
It knows no clock: every call brings the time.
"""

from __future__ import annotations

from robomill.cell.rsi.settings import WatchSettings

WAITING, RUNNING, RAMPING, SAFE = range(4)
STATES = ("waiting", "running", "ramping", "safe")
"""No packet yet; the correction is sent; it goes to zero; it is zero."""
NANO = 1e9
COUNTS = ("received", "answered", "malformed", "old", "lost", "clock", "late", "clipped", "unrecorded")
"""Packets that came, that were answered, that could not be read, whose IPOC had been before; cycles whose packet never came; jumps of
IPOC; answers later than a cycle; values cut by a limit; steps for which the memory of the session was full."""


class Watchdog:
    """State of a session."""

    def __init__(self, settings: WatchSettings) -> None:
        self.settings = settings
        self.state = WAITING
        self.fault = ""
        """Why the correction is taken back; "" while it is not."""
        self.counts = dict.fromkeys(COUNTS, 0)
        self.only_silent = False
        """Whether the fault is that nothing came, and nothing has come since: the end of a session."""
        self.ipoc = 0
        """The counter of the last packet that was in order."""
        self._arrived = 0
        self._failed_at = 0
        self._unusable = 0
        self._silence, self._end, self._ramp = (round(NANO * t) for t in (settings.silence, settings.end, settings.ramp))

    @property
    def failed(self) -> bool:
        """Whether there is a fault."""
        return self.state > RUNNING

    def fail(self, why: str, now: int) -> None:
        """Take the correction back from now [ns] on; the first reason stays."""
        if not self.failed:
            self.state, self.fault, self._failed_at = RAMPING, why, now

    def share(self, now: int) -> float:
        """Share of the correction at the fault that is still sent at `now` [ns]: 1 without a fault."""
        if not self.failed:
            return 1.0
        share = 1.0 - (now - self._failed_at) / self._ramp
        if share > 0.0:
            return share
        self.state = SAFE
        return 0.0

    def malformed(self, why: str, now: int) -> None:
        """A packet that cannot be read: there is nothing to answer."""
        self.counts["malformed"] += 1
        self._pass_over(f"unreadable packets: {why}", now)

    def _pass_over(self, why: str, now: int) -> None:
        self._unusable += 1
        if self._unusable >= self.settings.unusable and self.state != WAITING:
            self.fail(f"{self._unusable} packets in a row cannot be used; the last: {why}", now)

    def arrived(self, ipoc: int, now: int) -> int:
        """How many cycles a packet with this IPOC stands for, at `now` [ns]; 0: an old one, which gets no answer.

        More than one: packets between were lost. A packet with an impossible IPOC is a fault and stands for one cycle.
        """
        s = self.settings
        if self.state == WAITING:
            self.state, self.ipoc, self._arrived = RUNNING, ipoc, now
            return 1
        step = ipoc - self.ipoc
        widest = s.gap * s.ipoc
        if -widest <= step <= 0:
            self.counts["old"] += 1
            self._pass_over(f"IPOC {ipoc} is not after {self.ipoc}", now)
            return 0
        if now - self._arrived > self._silence:
            self.fail(f"no packet for {(now - self._arrived) / NANO:.3f} s", now)
        self._arrived = now
        self.only_silent = False
        self._unusable = 0
        last, self.ipoc = self.ipoc, ipoc
        if step < 0 or step > widest or step % s.ipoc:
            self.counts["clock"] += 1
            self.fail(f"the clock of the robot jumped: IPOC {ipoc} after {last}; expected {last + s.ipoc}", now)
            return 1
        cycles = step // s.ipoc
        self.counts["lost"] += cycles - 1
        return cycles

    def silent(self, now: int) -> bool:
        """Nothing has come up to `now` [ns]: take the correction back when that lasts too long. Returns whether the session is over."""
        if self.state == WAITING:
            return False
        if now - self._arrived > self._silence:
            self.only_silent |= not self.failed
            self.fail(f"no packet for more than {self.settings.silence:g} s", now)
        return now - self._arrived >= self._end
