"""States, counts and the way of the correction to zero; a virtual clock in ns."""

from __future__ import annotations

import numpy as np
import pytest

from robomill.cell.rsi.limits import FROZEN, TOO_LARGE, bound, watch
from robomill.cell.rsi.settings import WatchSettings
from robomill.cell.rsi.watchdog import RAMPING, RUNNING, SAFE, WAITING, Watchdog
from robomill.models.model.compiled import compiled
from tests.tolerances import EXACT, ROUNDOFF

MS = 1_000_000
SETTINGS = WatchSettings(silence=0.02, ramp=0.2, end=0.4, gap=10, unusable=5, ipoc=4)


def running(cycles: int = 3) -> tuple[Watchdog, int, int]:
    """A watchdog after some cycles, its IPOC and its time [ns]."""
    w = Watchdog(SETTINGS)
    assert w.state == WAITING
    for k in range(cycles):
        assert w.arrived(1000 + 4 * k, 4 * MS * k) == 1
    assert w.state == RUNNING
    return w, 1000 + 4 * (cycles - 1), 4 * MS * (cycles - 1)


def test_packets_in_order_are_one_cycle_each() -> None:
    w, _, now = running(100)
    assert not w.failed
    assert w.share(now) == 1.0
    assert sum(w.counts.values()) == 0


def test_lost_packets_are_counted_and_made_up_for() -> None:
    w, ipoc, now = running()
    assert w.arrived(ipoc + 12, now + 12 * MS) == 3
    assert w.counts["lost"] == 2
    assert w.state == RUNNING


def test_old_packets_are_passed_over_and_too_many_are_a_fault() -> None:
    w, ipoc, now = running()
    for k in range(5):
        assert w.state == RUNNING
        assert w.arrived(ipoc - 4 * (k % 2), now + k * MS) == 0
    assert w.counts["old"] == 5
    assert w.state == RAMPING
    assert w.fault == f"5 packets in a row cannot be used; the last: IPOC {ipoc} is not after {ipoc}"


def test_a_good_packet_ends_the_row_of_unusable_ones() -> None:
    w, ipoc, now = running()
    for k in range(20):
        for _ in range(4):
            w.malformed("x", now)
        ipoc, now = ipoc + 4, now + 4 * MS
        assert w.arrived(ipoc, now) == 1
        assert w.counts["malformed"] == 4 * (k + 1)
    assert w.state == RUNNING


@pytest.mark.parametrize("jump", [44, 4_000_000, 5, -44, -1000])
def test_a_jumping_clock_is_a_fault_and_the_next_packet_is_understood(jump: int) -> None:
    w, ipoc, now = running()
    assert w.arrived(ipoc + jump, now + 4 * MS) == 1
    assert (w.state, w.counts["clock"]) == (RAMPING, 1)
    assert w.fault == f"the clock of the robot jumped: IPOC {ipoc + jump} after {ipoc}; expected {ipoc + 4}"
    assert w.arrived(ipoc + jump + 4, now + 8 * MS) == 1
    assert w.counts["clock"] == 1


def test_silence_is_a_fault_and_then_the_end() -> None:
    w, _, now = running()
    assert not w.silent(now + 20 * MS)
    assert w.state == RUNNING
    assert not w.silent(now + 21 * MS)
    assert (w.state, w.only_silent) == (RAMPING, True)
    assert w.fault == "no packet for more than 0.02 s"
    assert w.silent(now + 400 * MS)


def test_a_robot_that_comes_back_finds_the_correction_taken_back() -> None:
    w, ipoc, now = running()
    w.silent(now + 25 * MS)
    assert w.arrived(ipoc + 32, now + 32 * MS) == 8
    assert not w.only_silent
    assert w.failed
    other, ipoc, now = running()  # nobody looked at the clock meanwhile
    other.arrived(ipoc + 32, now + 32 * MS)
    assert other.fault == "no packet for 0.032 s"


def test_the_correction_goes_to_zero_along_a_straight_line_and_stays_there() -> None:
    w, ipoc, now = running()
    w.fail("first", now)
    w.fail("second", now + 50 * MS)
    assert w.fault == "first"
    assert [w.share(now + t * MS) for t in (0, 50, 100, 150, 200, 5000)] == pytest.approx(
        [1.0, 0.75, 0.5, 0.25, 0.0, 0.0], rel=ROUNDOFF, abs=EXACT
    )
    assert w.state == SAFE
    for k in range(1, 5):
        w.arrived(ipoc + 4 * k, now + 5000 * MS + 4 * k * MS)  # latched: good packets change nothing
        assert w.share(now + 5000 * MS + 4 * k * MS) == 0.0
    assert w.state == SAFE


def test_what_is_sent_is_bounded_in_size_and_change() -> None:
    limit, change, sent = np.array([1.0, 1.0]), np.array([0.4, 5.0]), np.zeros(2)
    for f in (bound, compiled(bound)):
        sent[:] = 0.0
        assert f(np.array([0.3, -0.5]), sent.copy(), False, 1.0, limit, change, sent) == 0
        np.testing.assert_array_equal(sent, [0.3, -0.5])
        assert f(np.array([3.0, -3.0]), sent.copy(), False, 1.0, limit, change, sent) == 2
        np.testing.assert_allclose(sent, [0.7, -1.0], rtol=ROUNDOFF)
        assert f(np.array([np.nan, np.inf]), sent.copy(), False, 1.0, limit, change, sent) == 2
        np.testing.assert_allclose(sent, [0.7, -1.0], rtol=ROUNDOFF)
        f(np.array([9.0, 9.0]), np.array([0.8, -1.0]), True, 0.5, limit, change, sent)
        np.testing.assert_allclose(sent, [0.4, -0.5], rtol=ROUNDOFF)


def test_a_sensor_that_shows_too_much_or_stands_still_is_found() -> None:
    first, most, frozen = np.array([0, 3, 4]), np.array([5.0, np.inf]), np.array([0, 3])
    for f in (watch, compiled(watch)):
        still, last = np.zeros(2, np.int64), np.zeros(4)
        assert f(np.array([3.0, 4.0, 0.0, 1.0]), first, most, frozen, still, last) == 0
        assert f(np.array([3.0, 4.1, 0.0, 2.0]), first, most, frozen, still, last) == TOO_LARGE
        assert f(np.array([np.nan, 0.0, 0.0, 2.0]), first, most, frozen, still, last) == TOO_LARGE
        quiet = np.array([0.0, 0.0, 0.0, 0.0])
        assert [f(quiet, first, most, frozen, still, last) for _ in range(10)] == [0] * 10  # at rest is not dead
        stuck = np.array([0.0, 0.0, 0.0, 2.0])
        assert [f(stuck, first, most, frozen, still, last) for _ in range(4)] == [0, 0, 0, 2 + FROZEN]
