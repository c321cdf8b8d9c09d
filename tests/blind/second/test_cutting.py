"""The second generator's cut against closed forms: mean force of a slot, runout, exit, end face; sensor and controller at rest."""

from __future__ import annotations

import math

import numpy as np
import pytest

from robomill.blind.second import cutting, machine, motion
from robomill.blind.second.cutting import RADIUS, TEETH
from tests.tolerances import ROUNDOFF, discretisation, physics

PLACE = machine.Place((0.0, 0.0, 0.0), 0.0, (0.08, 0.06, 0.03), 0, 5400.0)
SLICED = 0.01
"""Relative: the midpoint rule over slices of 7.5 degrees and bins of 3 degrees, and cells of half a millimetre at the walls."""
MISSED = 0.03
"""Relative: a short tooth that misses its chip has no edge force either."""
OMEGA = 10_000.0 * 2.0 * math.pi / 60.0


def slot(c, depth, feed, steps=400, start=(-0.02, 0.0)):
    """Mean force over whole turns amid a slot along x, float64[3], and the state of the workpiece."""
    state = cutting.fresh(c.size)
    forces = []
    for k in range(steps):
        p = np.array([start[0] + feed * k * 1e-3, start[1], -depth])
        f, _, _ = cutting.cut(c, state, 1e-3, 0.0, p, np.array([feed, 0.0, 0.0]), OMEGA)
        forces.append(f)
    turns = steps // 6 * 6
    return np.mean(forces[-turns // 2 // 6 * 6 :], axis=0), state


def heights(c, state):
    """The map with all that is cut."""
    top = state.top.copy()
    for x, y, z in state.trail[np.isfinite(state.trail[:, 2])]:
        cutting.remove(top, c.size, x, y, z, 0.0)
    return top


def along(c, state, start, stop, depth, feed):
    """Ways of the tip [m] straight from start to stop [2] m, and the size of the force [N] there."""
    way = np.subtract(stop, start)
    length = float(np.hypot(*way))
    unit = np.array([*way, 0.0]) / length
    x = np.arange(round(length / (feed * 1e-3))) * feed * 1e-3
    force = [cutting.cut(c, state, 1e-3, 0.0, np.array([*start, -depth]) + s * unit, feed * unit, OMEGA)[0] for s in x]
    return x, np.linalg.norm(force, axis=1)


def closed(c, depth, feed):
    """Altintas: mean force of a slot (FACTS 3.2) on the tool, feed along x, axial force into the work."""
    chip, a = 2.0 * math.pi * feed / (TEETH * OMEGA), TEETH * depth
    fx = -a / 4.0 * c.chip[1] * chip - a / math.pi * c.edge[1]
    fy = a / 4.0 * c.chip[0] * chip + a / math.pi * c.edge[0]
    return np.array([fx, fy, -(a / math.pi * c.chip[2] * chip + a / 2.0 * c.edge[2])])


@pytest.mark.parametrize(("depth", "feed"), [(3e-3, 0.03), (5e-3, 0.04), (9e-3, 0.02)])
def test_mean_force_of_a_slot_is_the_closed_form(depth, feed):
    c = machine.nominal(PLACE).cut
    mean, _ = slot(c, depth, feed)
    assert mean == pytest.approx(closed(c, depth, feed), rel=SLICED)


def test_runout_changes_the_mean_little_and_beats_once_per_turn():
    c = machine.nominal(PLACE).cut._replace(runout=15e-6, runout_angle=0.7)
    mean, _ = slot(c, 4e-3, 0.04)
    assert mean == pytest.approx(closed(c, 4e-3, 0.04), rel=MISSED)
    state, sizes = cutting.fresh(c.size), []
    for k in range(60):
        f, _, _ = cutting.cut(c, state, 1e-3, 0.0, np.array([k * 4e-5, 0.0, -4e-3]), np.array([0.04, 0.0, 0.0]), OMEGA)
        sizes.append(np.linalg.norm(f))
    spectrum = np.abs(np.fft.rfft(np.array(sizes[-48:]) - np.mean(sizes[-48:])))
    assert spectrum[8] > 2.0 * np.delete(spectrum, [8, 16, 24]).max()  # 6 ms a turn: the 8th line of 48 ms


def test_a_tooth_meets_a_wall_at_the_same_angle_of_the_spindle_whatever_the_feed():
    """Where the path turns, the spindle does not."""
    c = machine.nominal(PLACE).cut
    met = []
    for turn in (-0.8, 0.0, 0.8):
        force = []
        for start in np.linspace(0.0, 2.0 * math.pi / 3.0, 40, endpoint=False):
            state = cutting.fresh(c.size)
            dx, dy = c.size[0] / state.top.shape[0], c.size[1] / state.top.shape[1]
            state.top[:] = -0.1
            i, j = int((RADIUS + 0.5 * c.size[0]) / dx), int(0.5 * c.size[1] / dy)
            state.top[i - 2 : i + 3, j - 2 : j + 3] = 0.0  # nothing stands but this, at the side of +x
            ahead = np.array([0.04 * math.cos(turn), 0.04 * math.sin(turn), 0.0])
            f, _, _ = cutting.cut(c._replace(start_angle=start), state, 1e-4, 0.0, np.array([0.0, 0.0, -1e-3]), ahead, OMEGA)
            force.append(float(np.linalg.norm(f)))
        assert max(force) > 5.0 * np.median(force)
        met.append(int(np.argmax(force)))
    assert np.ptp(met) <= 1  # a chip is thicker before the feed: within a step


def test_what_is_removed_is_the_volume_of_the_slot():
    c = machine.nominal(PLACE).cut
    _, state = slot(c, 4e-3, 0.04)
    length = 0.04 * 0.399
    expected = 4e-3 * (2.0 * RADIUS * length + math.pi * RADIUS**2)
    top = heights(c, state)
    cell = c.size[0] / top.shape[0] * c.size[1] / top.shape[1]
    assert -top.sum() * cell == pytest.approx(expected, rel=SLICED)


def test_there_is_no_force_in_the_air_nor_in_a_slot_that_is_cut():
    c = machine.nominal(PLACE).cut
    _, state = slot(c, 4e-3, 0.04)
    still = np.zeros(3)
    assert np.array_equal(cutting.cut(c, state, 1e-3, 0.0, np.array([0.0, 0.0, 1e-3]), np.array([0.04, 0.0, 0.0]), OMEGA)[0], still)
    again, _, _ = cutting.cut(c, state, 1e-3, 0.0, np.array([-0.016, 0.0, -4e-3]), np.array([0.04, 0.0, 0.0]), OMEGA)
    assert np.linalg.norm(again) < 0.03 * np.linalg.norm(closed(c, 4e-3, 0.04))


FEED, DEPTH = 0.04, 4e-3
STEP = FEED * 1e-3
"""Feed in a fine step [m]."""


def test_a_block_is_entered_where_it_begins():
    c = machine.nominal(PLACE).cut
    side = -0.5 * c.size[0]
    x, force = along(c, cutting.fresh(c.size), (side - 0.012, 0.0), (side, 0.0), DEPTH, FEED)
    met = x[np.flatnonzero(force > 0.0)[0]] - 0.012 + RADIUS
    assert met == pytest.approx(0.0, abs=discretisation(2.0, STEP, 1))


def test_a_wall_before_a_finished_slot_is_met_where_it_stands():
    c = machine.nominal(PLACE).cut
    state = cutting.fresh(c.size)
    end = along(c, state, (-0.052, 0.0), (0.0, 0.0), DEPTH, FEED)[0][-1] - 0.052
    along(c, state, (-0.01, 0.02), (-0.03, 0.02), DEPTH, FEED)  # elsewhere, so that the slot is no fresh one
    x, force = along(c, state, (-0.01, 0.0), (0.004, 0.0), DEPTH, FEED)
    met = x[np.flatnonzero(force > 0.5 * force[-60:].mean())[0]] - 0.01
    # the wall is known to half a cell
    assert met == pytest.approx(end, abs=discretisation(0.5, cutting.CELL, 1))


def test_a_wall_beside_the_path_is_engaged_by_its_width():
    c = machine.nominal(PLACE).cut
    for width in (0.003, 0.0071, 0.012):
        state = cutting.fresh(c.size)
        along(c, state, (-0.052, 0.0), (0.052, 0.0), DEPTH, FEED)
        for k in range(500):
            at = np.array([-0.02 + k * STEP, width, -DEPTH])
            depth = cutting.engagement(state, c.size, at, np.array([1.0, 0.0]))
            cutting.move(state, c.size, at, 0.0)
        cosines = np.cos(np.arange(cutting.BINS + 1) * math.pi / cutting.BINS)
        engaged = (depth * RADIUS * -np.diff(cosines)).sum() / DEPTH
        # a bin is 0.42 mm wide in the middle, and the wall is known to a part of a cell
        assert engaged == pytest.approx(width, abs=discretisation(0.5, cutting.CELL, 1))


def test_a_tool_that_turns_back_is_in_its_own_slot_at_once():
    c = machine.nominal(PLACE).cut
    state = cutting.fresh(c.size)
    along(c, state, (-0.052, 0.0), (0.0, 0.0), DEPTH, FEED)
    _, force = along(c, state, (0.0, 0.0), (-0.02, 0.0), DEPTH, FEED)
    assert force.max() < 0.05 * np.linalg.norm(closed(c, DEPTH, FEED))


def test_a_tool_that_goes_down_on_the_spot_cuts_by_its_depth():
    c = machine.nominal(PLACE).cut
    state = cutting.fresh(c.size)
    for k in range(200):
        cutting.cut(c, state, 1e-3, 0.0, np.array([0.0, 0.0, -2e-5 * k]), np.array([0.0, 0.0, -0.02]), OMEGA)
    assert cutting.standing(state, c.size, 0.0, 0.0, cutting.TRAIL) == -2e-5 * 199
    assert cutting.standing(state, c.size, 1.01 * RADIUS, 0.0, cutting.TRAIL) == 0.0


DIFFERENCE = 1e4 * ROUNDOFF
"""A gap of 1e-4 rad is the difference of angles of 1 rad."""


def test_gradual_backlash_is_lost_on_the_way_back():
    d = machine.nominal(PLACE).drive._replace(half_gap=np.zeros(6), backlash=np.full(6, 100e-6))
    q0 = np.radians([10.0, -95.0, 110.0, 20.0, -30.0, 15.0])
    s = motion.standing(q0, d.half_gap)
    way = np.concatenate([np.linspace(0.0, 1e-3, 200), np.linspace(1e-3, 0.0, 200)])
    lost = []
    for k, x in enumerate(way):
        q_motor, link, _ = motion.driven(d, s, k * 1e-3, 1e-3, q0 + x, np.zeros(9))
        lost.append((q_motor - link)[0])
    assert lost[199] == pytest.approx(100e-6, rel=DIFFERENCE)
    assert lost[-1] == pytest.approx(-100e-6, rel=DIFFERENCE)


@pytest.mark.parametrize("order", [0, 1, 2])
def test_a_late_path_is_late_by_as_much_whatever_its_order(order):
    d = machine.nominal(PLACE).drive._replace(lag=0.012, lag_order=order)
    t = 1e-3 * np.arange(1000)
    q = np.repeat(0.1 * t[:, None], 6, axis=1)
    behind = (q - motion.followed(d, q, 1e-3))[-1, 0]
    # a sampled lag is up to half a step per order short of its time constant
    assert behind == pytest.approx(0.1 * 0.012, abs=discretisation(0.05 * max(order, 1), 1e-3, 1) + ROUNDOFF)


def test_step_response_of_transport_and_drive():
    d = machine.nominal(PLACE).drive._replace(omega=2.0 * math.pi * 4.5)
    q0 = np.radians([10.0, -95.0, 110.0, 20.0, -30.0, 15.0])
    s, wanted, x = motion.standing(q0, d.half_gap), np.zeros(9), []
    wanted[0] = 1e-3
    for k in range(400):
        motion.driven(d, s, k * 1e-3, 1e-3, q0, wanted)
        x.append(s.correction[0, 0])
    # FACTS 7: t50 = 68 ms and t90 = 132 ms with the 12 ms of transport that are not in here
    assert np.searchsorted(x, 0.5e-3) == pytest.approx(68 - 12, abs=physics(68, absolute=2.0))
    assert np.searchsorted(x, 0.9e-3) == pytest.approx(132 - 12, abs=physics(132, absolute=2.0))
