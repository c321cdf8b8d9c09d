"""Corrected programs: nodes, points on a curve, ways along the planned path."""

from __future__ import annotations

import math

import numpy as np
import pytest

from robomill.models.model.declaration import FloatArray
from robomill.models.planning import gcode
from robomill.models.planning.languages import Frames
from robomill.models.planning.languages.convert import path_of
from robomill.models.planning.path_correction import (
    LONGEST,
    PlannedPath,
    at_nodes,
    corrected,
    planned_path,
    points_along,
    way_along,
)
from robomill.models.planning.point_path import PathPoint, PointPath
from robomill.models.planning.segment_table import LINE
from robomill.models.planning.trajectory import Placement, Plan, plan
from robomill.models.robot.kinematics import SPINDLE_ACROSS
from tests.tolerances import ROUNDOFF

PLACE = Placement((1.3, 0.0, 1.2), (math.pi, 0.0, 0.0))
FRAMES = Frames.at(PLACE, SPINDLE_ACROSS)
ROUND = "G21 G90 G17\nG64 P0.5\nS13000 M3\nG0 X30 Y0 Z2\nG3 X30 Y0 I-30 J0 F1500\nG1 X60\nG0 Z20\nM30\n"
STOPS = "G21 G90 G17\nG61\nT1 M6\nS13000 M3\nG0 X0 Y0 Z2\nG1 Z-1 F600\nG4 P0.5\nG1 X20 F1500\nG1 Y20\nG0 Z5\nM30\n"
TOLERANCE = 1e-5
BLENDED = 2e-5
"""m: a chord is off by TOLERANCE at most, and its blends by as much again."""
CLOCK = 1e-9
"""s: the difference of two path times of some seconds."""
RIPPLE = 1e-5
"""Relative: blends are polynomials in the way, whose speed is even up to this."""
PER_CHORD = 1.3
"""More moves than a curve needs, L = sqrt(8 tolerance R): where it meets a straight line their lengths change evenly."""


def path(text: str) -> tuple[PlannedPath, Plan]:
    program = gcode.parse(text)
    planned = plan(program, PLACE)
    return planned_path(planned, program), planned


def played(one: PlannedPath, offset: FloatArray) -> tuple[Plan, FloatArray, FloatArray, FloatArray]:
    """The plan of a corrected path; its times, ways along the planned path, and positions in P."""
    program = corrected(one, offset, TOLERANCE, FRAMES)
    points = path_of(program.poses)
    planned = plan(PointPath(points.name, tuple(_numbered(p, i) for i, p in enumerate(points.points, 1)), "path", ()), PLACE)
    tau = np.arange(0.0, planned.duration, 0.002)
    position = (planned.position(tau) - np.asarray(PLACE.p_BP_B)) @ PLACE.R_BP
    pose = planned.rows(tau)[0][:, LINE].astype(np.int64) - 1
    return planned, tau, way_along(program, pose, position), position


def _numbered(p: PathPoint, number: int) -> PathPoint:
    return PathPoint(p.position, p.abc, p.blend, p.feed, p.spindle_speed, p.quat, number, p.tool, p.dwell, p.rapid)


def at(one: PlannedPath, way: FloatArray, values: FloatArray) -> FloatArray:
    return np.column_stack([np.interp(way, one.along, v) for v in values.T])


def test_nodes_are_on_the_plan_and_know_their_line() -> None:
    one, planned = path(ROUND)
    on_plan = (planned.position(one.time) - np.asarray(PLACE.p_BP_B)) @ PLACE.R_BP
    assert np.abs(one.position - on_plan).max() < ROUNDOFF
    assert np.all(np.diff(one.along) > 0.0)
    assert set(one.lines.tolist()) == {5, 6, 7}
    assert [one.said[int(np.argmax(one.lines == n))].rapid for n in (5, 6, 7)] == [False, False, True]
    assert abs(one.along[-1] - planned.length) < 1e-3 * planned.length  # chords of 0.1 mm against arcs


def test_rests_and_dwells_are_kept() -> None:
    one, planned = path(STOPS)
    dwells = [t for t in one.rests.values() if t > 0.0]
    assert dwells == pytest.approx([0.5], abs=CLOCK, rel=0.0)
    again, _, _, _ = played(one, np.zeros_like(one.position))
    assert abs(again.duration - planned.duration) < 0.02 * planned.duration  # a rest more or less would take 0.2 s, 7 %


@pytest.mark.parametrize("text", [ROUND, STOPS])
def test_without_offsets_it_is_the_path(text: str) -> None:
    one, _ = path(text)
    _, _, way, position = played(one, np.zeros_like(one.position))
    assert np.linalg.norm(position - at(one, way, one.position), axis=1).max() < BLENDED


def test_offsets_are_added_at_the_same_way() -> None:
    """A smooth offset in all directions, along the path, too."""
    one, _ = path(ROUND)
    phase = 2.0 * np.pi * one.along / 0.04
    offset = 3e-4 * np.column_stack([np.sin(phase), np.cos(phase) - 1.0, np.sin(0.5 * phase)])
    _, _, way, position = played(one, offset)
    assert np.linalg.norm(position - at(one, way, one.position + offset), axis=1).max() < BLENDED
    back = at_nodes(one, way, position) - one.position
    assert np.linalg.norm(back - offset, axis=1).max() < BLENDED


def test_the_feed_holds_on_a_circle() -> None:
    one, _ = path(ROUND)
    planned, tau, way, _ = played(one, np.zeros_like(one.position))
    speed = np.linalg.norm(planned.velocity(tau), axis=1)
    on_circle = (way > 0.02) & (way < 0.17)
    assert np.abs(speed[on_circle] - 0.025).max() < RIPPLE * 0.025
    assert planned.reduced == ()


def test_points_of_a_circle() -> None:
    """As many as chords of the tolerance need; each value within it."""
    radius = 0.03
    along = np.linspace(0.0, 2.0 * np.pi * radius, 2001)
    values = radius * np.column_stack([np.cos(along / radius), np.sin(along / radius), 0.0 * along])
    way, points = points_along(along, values, TOLERANCE)
    needed = along[-1] / math.sqrt(8.0 * TOLERANCE * radius)
    assert needed <= len(way) <= PER_CHORD * needed
    missed = np.column_stack([np.interp(along, way, p) for p in points.T]) - values
    assert np.linalg.norm(missed, axis=1).max() <= TOLERANCE


def test_points_of_a_line_and_of_a_kink() -> None:
    along = np.linspace(0.0, 0.1, 501)
    straight = np.column_stack([along, 0.0 * along, 0.0 * along])
    assert len(points_along(along, straight, TOLERANCE)[0]) == math.ceil(0.1 / LONGEST) + 1
    kinked = straight + np.outer(np.maximum(along - 0.05, 0.0), [0.0, 0.5, 0.0])
    way, points = points_along(along, kinked, TOLERANCE)
    missed = np.column_stack([np.interp(along, way, p) for p in points.T]) - kinked
    assert np.linalg.norm(missed, axis=1).max() <= 2.0 * TOLERANCE  # the kink lies between two points
    assert len(way) < 60


def test_orientations_are_kept() -> None:
    points = tuple(PathPoint((x, 0.0, 0.0), (0.0, b, 0.0), 0.0, 0.025, 1000.0) for x, b in ((-0.02, 0.0), (0.02, 0.2)))
    program = PointPath("tilt", points, "path", ())
    planned = plan(program, PLACE)
    one = planned_path(planned, program)
    poses = corrected(one, np.zeros_like(one.position), TOLERANCE, FRAMES).poses
    again = plan(path_of(poses), PLACE)
    turned = (planned.rotation(np.array([planned.duration])).inv() * again.rotation(np.array([again.duration]))).magnitude()
    assert turned[0] < 1e-9  # quaternions and angles of the planner, to and fro
    assert one.said[0].line == 2


def test_bad_input_is_refused() -> None:
    one, _ = path(ROUND)
    with pytest.raises(ValueError, match=r"offsets have the shape \(3, 3\), expected \(\d+, 3\): one per node of program"):
        corrected(one, np.zeros((3, 3)), TOLERANCE, FRAMES)
    with pytest.raises(ValueError, match="tolerance 0 m; expected more than 0: a curve has no finite number of points on it"):
        corrected(one, np.zeros_like(one.position), 0.0, FRAMES)
