"""From a record to a program: thresholds, F/k, deviation height, orientations, RAPID and G-code."""

from __future__ import annotations

import itertools
import math
import re

import numpy as np
import pygcode
import pytest
from scipy.spatial.transform import Rotation, Slerp

from robomill.models.planning import gcode
from robomill.models.planning.learnt_path import (
    DEVIATION_HEIGHT,
    LearntPath,
    LearntPathError,
    guiding_orientations,
    learn,
    point_path,
    points_needed,
    rapid,
    reduce,
    reduced,
    smoothed,
)
from robomill.models.planning.learnt_path import gcode as to_gcode
from tests.tolerances import ROUNDOFF, chance, of_mean, physics

UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
FIVE_PERCENT = physics(1.0, relative=0.05)
"""FACTS10 10.4: the greedy algorithm keeps that to the integral."""
ENDS = 2
"""Points: those at the ends, which are kept whatever the curve does."""
DIGIT = physics(0.0, absolute=0.51e-7)
"""m: half a unit of the last digit that programs are written with (1e-4 mm)."""
TURN = physics(0.0, absolute=1e-8)
"""Half a unit of the last digit of a quaternion, with what normalisation adds."""


def path(points: np.ndarray, quaternion: np.ndarray = UPRIGHT) -> LearntPath:
    return LearntPath(points, np.broadcast_to(quaternion, (len(points), 4)))


def circle(radius: float, step: float = 1e-4) -> np.ndarray:
    """A circle as the robot records it: points every `step` [m]."""
    t = np.arange(0.0, 2.0 * math.pi, step / radius)
    return radius * np.column_stack([np.cos(t), np.sin(t), 0.0 * t])


@pytest.mark.paper
@pytest.mark.parametrize(("radius", "published"), [(3e-3, 10), (10e-3, 17), (40e-3, 33)])
def test_circles_need_as_many_points_as_published(radius: float, published: int) -> None:
    """FACTS10 10.4, counted by another program; one point is the one that closes the circle or not."""
    assert abs(len(reduce(circle(radius), DEVIATION_HEIGHT)) - published) <= 1


@pytest.mark.paper
@pytest.mark.parametrize(("radius", "length"), [(5e-3, 0.849), (20e-3, 1.697)])
def test_the_path_of_300_points_is_as_long_as_published(radius: float, length: float) -> None:
    """FACTS10 10.4: .85 and 1.7 m, 42 000 and 85 000 samples at 5 mm/s and 4 ms; N is that of the smooth curve."""
    per_metre = points_needed(circle(radius)[:, :2]) / (2.0 * math.pi * radius)
    assert 300.0 / per_metre == pytest.approx(length, abs=length * physics(1.0, relative=0.05))


@pytest.mark.parametrize("seed", range(5))
def test_the_greedy_method_needs_what_the_integral_says(seed: int) -> None:
    """N = integral sqrt(|kappa| / (8 h)) ds within 5 % (FACTS10 10.4), and one point for each end."""
    rng = np.random.default_rng(seed)
    x = np.arange(0.0, 1.0, 5e-5)
    y = sum(
        a * np.sin(2.0 * math.pi * x / w + p)
        for a, w, p in zip([8e-3, 2e-3], rng.uniform(0.03, 0.08, 2), rng.uniform(0, 6, 2), strict=True)
    )
    points = np.column_stack([x, y])
    needed = points_needed(points)
    assert needed > 100
    assert len(reduce(points, DEVIATION_HEIGHT)) == pytest.approx(needed, abs=needed * FIVE_PERCENT + ENDS)


@pytest.mark.parametrize("height", [2e-5, 2e-4])
def test_no_point_is_further_from_its_chord_than_the_height_and_the_next_would_be(height: float) -> None:
    rng = np.random.default_rng(3)
    points = np.cumsum(rng.normal(size=(800, 3)) * [1e-4, 1e-4, 2e-5] + [1e-4, 0, 0], axis=0)

    def deviation(i: int, j: int) -> float:
        chord = (points[j] - points[i]) / np.linalg.norm(points[j] - points[i])
        return float(np.linalg.norm(np.cross(points[i + 1 : j] - points[i], chord), axis=1).max(initial=0.0))

    kept = reduce(points, height)
    assert (kept[0], kept[-1]) == (0, len(points) - 1)
    for i, j in itertools.pairwise(kept[:-1]):
        assert deviation(i, j) <= height < deviation(i, j + 1)


@pytest.mark.parametrize(("noise", "low", "high"), [(2e-5, 1.0, 1.2), (3e-5, 1.1, 1.4), (8e-5, 3.0, 8.0)])
def test_noise_needs_more_points(noise: float, low: float, high: float) -> None:
    """Noise of 50 ms (13 samples of 20 um) normal to the path. FACTS10 10.4 has 5-25 % for .03-.08 mm rms; that holds at .03 mm only:
    at .08 mm the band of +-0.2 mm is left by chance every few samples, and the program has several times as many points.
    """
    points = circle(0.02, 2e-5)
    rough = noise * math.sqrt(13) * smoothed(np.random.default_rng(5).normal(size=(len(points), 1)), 13)
    share = len(reduce(points * (1.0 + rough / 0.02), DEVIATION_HEIGHT)) / len(reduce(points, DEVIATION_HEIGHT))
    assert low <= share < high


def test_points_out_of_the_force_threshold_go_and_the_rest_is_freed_of_the_bending() -> None:
    f = np.array([0.0, 5.9, 6.1, 20.0, 49.9, 50.1])
    position = np.column_stack([np.arange(6.0), np.zeros((6, 2))])
    force = np.column_stack([np.zeros(6), -f, np.zeros(6)])
    found = learn(position, np.tile(UPRIGHT, (6, 1)), force, f, 20.0, 1e5)
    assert found.position == pytest.approx(np.column_stack([[2.0, 3.0, 4.0], -f[2:5] / 1e5, np.zeros(3)]), rel=ROUNDOFF)


def test_averaging_stops_at_gaps() -> None:
    f = np.array([20.0] * 5 + [0.0] + [20.0] * 5)
    position = np.column_stack([np.where(np.arange(11) < 5, 0.0, 1.0), np.zeros((11, 2))])
    found = learn(position, np.tile(UPRIGHT, (11, 1)), np.zeros((11, 3)), f, 20.0, samples=5)
    assert set(found.position[:, 0]) == {0.0, 1.0}


def test_a_contact_that_flickers_is_left_out() -> None:
    f = np.array([20.0] * 9 + [0.0] + [20.0] * 3 + [0.0])
    position = np.column_stack([np.arange(14.0), np.zeros((14, 2))])
    force = np.zeros((14, 3))
    found = learn(position, np.tile(UPRIGHT, (14, 1)), force, f, 20.0, samples=5)
    assert found.position[:, 0] == pytest.approx(np.arange(1.0, 8.0), rel=10 * ROUNDOFF)
    with pytest.raises(LearntPathError) as error:
        learn(position, np.tile(UPRIGHT, (14, 1)), force, f, 20.0, samples=11)
    assert str(error.value) == (
        "the longest stretch of the record with a contact force between 6 and 50 N has 9 points, expected at least 11, over which they are "
        "averaged: contact was lost again and again"
    )


def test_a_moving_average_takes_its_share_of_the_noise() -> None:
    rng = np.random.default_rng(6)
    found = smoothed(rng.normal(size=(20001, 3)), 25)
    independent = 3 * 20001 / 25
    assert found.std() == pytest.approx(0.2, abs=0.2 * chance(of_mean(2.0 * independent)))
    assert smoothed(np.arange(30.0)[:, None] * np.ones(3), 9) == pytest.approx(np.arange(30.0)[:, None] * np.ones(3), rel=30 * ROUNDOFF)


def test_a_record_without_contact_is_refused() -> None:
    with pytest.raises(LearntPathError) as error:
        learn(np.zeros((4, 3)), np.tile(UPRIGHT, (4, 1)), np.zeros((4, 3)), np.array([0.0, 1.0, 2.0, 90.0]), 20.0)
    assert str(error.value) == (
        "the record has 0 points with a contact force between 6 and 50 N, expected at least 2 of 4; largest force 90 N: the part was not "
        "touched, or far too hard"
    )


class TestOrientation:
    GUIDING = LearntPath(
        np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.1, 0.1, 0.0]]),
        np.roll(Rotation.from_euler("z", [[0.0], [40.0], [100.0]], degrees=True).as_quat(canonical=True), 1, axis=1),
    )

    BESIDE = np.array([1e-3, -2e-3, 0.0])

    def test_that_of_the_guiding_points_is_kept(self) -> None:
        at = guiding_orientations(path(self.GUIDING.position + self.BESIDE), self.GUIDING)
        assert at.quaternion[[0, 2]] == pytest.approx(self.GUIDING.quaternion[[0, 2]], abs=physics(0.0, absolute=0.012))
        assert np.array_equal(at.position, self.GUIDING.position + self.BESIDE)

    def test_between_them_it_turns_evenly(self) -> None:
        """Against scipy: the way along the chords is the time of a spherical interpolation."""
        points = np.array([[0.025, 0.002, 0.0], [0.08, -0.001, 0.0], [0.101, 0.03, 0.0]])
        turns = Rotation.from_quat(np.roll(self.GUIDING.quaternion, -1, axis=1))
        expected = Slerp([0.0, 0.1, 0.2], turns)([0.025, 0.08, 0.13])
        found = guiding_orientations(path(points), self.GUIDING)
        assert np.roll(found.quaternion, -1, axis=1) == pytest.approx(expected.as_quat(canonical=True), abs=100 * ROUNDOFF)

    def test_a_path_of_points_has_it(self) -> None:
        upright = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
        there = Rotation.from_quat(np.roll(self.GUIDING.quaternion, -1, axis=1)) * Rotation.from_matrix(upright)
        made = point_path(LearntPath(self.GUIDING.position, np.roll(there.as_quat(), 1, axis=1)), "p", 0.01, upright)
        back = Rotation.from_matrix(upright) * Rotation.from_euler("ZYX", [p.abc for p in made.points])
        assert (back.inv() * there).magnitude() == pytest.approx(np.zeros(3), abs=physics(0.0, absolute=1e-7))


def wavy() -> LearntPath:
    x = np.arange(0.0, 0.2, 2e-5)
    return reduced(path(np.column_stack([x, 2e-3 * np.sin(2.0 * math.pi * x / 0.06), 0.001 + 0.0 * x])))


class TestPrograms:
    def test_g_code_reads_back(self) -> None:
        learnt = wavy()
        moves = [a for a in gcode.parse(to_gcode(learnt, 0.01)).actions if isinstance(a, gcode.Move)]
        ends = np.array([m.end for m in moves])
        assert ends[-len(learnt) + 1 :] == pytest.approx(learnt.position[1:], abs=DIGIT)
        assert all(m.feed == pytest.approx(0.01, rel=ROUNDOFF) for m in moves[1:])

    def test_pygcode_reads_the_same(self) -> None:
        learnt, machine, ends = wavy(), pygcode.Machine(), []
        for line in to_gcode(learnt, 0.01).splitlines():
            block = pygcode.Line(line).block
            machine.process_block(block)
            if any(isinstance(code, pygcode.GCodeLinearMove | pygcode.GCodeRapidMove) for code in block.gcodes):
                ends.append([machine.pos.X, machine.pos.Y, machine.pos.Z])
        assert 1e-3 * np.array(ends) == pytest.approx(learnt.position, abs=DIGIT)

    def test_g_code_says_its_tolerance(self) -> None:
        assert "G64 P0.2000" in to_gcode(wavy(), 0.01, 2e-4)

    def test_g_code_cannot_turn_the_tool(self) -> None:
        with pytest.raises(LearntPathError) as error:
            to_gcode(TestOrientation.GUIDING, 0.01)
        assert str(error.value) == ("the orientation turns by 100 deg along the path; G-code of three axes cannot say that: write RAPID")

    def test_rapid_reads_back(self) -> None:
        learnt = guiding_orientations(wavy(), TestOrientation.GUIDING)
        text = rapid(learnt, "pump", 0.01)
        number = r"\s*(-?[\d.]+)\s*"
        rows = re.findall(rf"MoveL \[\[{','.join([number] * 3)}\], \[{','.join([number] * 4)}\],", text)
        found = np.array(rows, dtype=float)
        assert 1e-3 * found[:, :3] == pytest.approx(learnt.position, abs=DIGIT)
        assert found[:, 3:] == pytest.approx(learnt.quaternion, abs=TURN)
        assert text.startswith("MODULE pump\n")
        assert text.endswith("  ENDPROC\nENDMODULE\n")
        assert "speeddata feed := [10, 500, 5000, 1000]" in text

    def test_a_name_that_rapid_does_not_take_is_refused(self) -> None:
        with pytest.raises(
            LearntPathError, match=r"name of the program: '2 pumps'; expected letters, digits and underscores, no digit first"
        ):
            rapid(wavy(), "2 pumps", 0.01)
