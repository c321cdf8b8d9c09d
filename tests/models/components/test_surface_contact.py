"""surface_contact: distance, stiffness, damping and friction against closed forms."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robomill.models.components.surface_contact import MODEL, signed_distances
from robomill.models.model.declaration import record
from tests.tolerances import EXACT, ROUNDOFF, discretisation

H = 0.004
SQUARE = np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1], [0.0, 0.0]])
"""A boss, anticlockwise: material on the left."""
LENGTH = 0.1
"""m: size of the numbers that are added and cancelled; ROUNDOFF is relative to it."""


class Stylus:
    """One instance, plain or compiled."""

    def __init__(self, contour: Any = SQUARE, compiled: bool = False, at: Any = (0.0, 0.0, 0.0), **parameters: Any) -> None:
        self.data = MODEL.new()
        MODEL.load_table(self.data, "contour", np.asarray(contour, dtype=float))
        self.s = record(self.data)
        for name, value in {"tip_radius": 0.0, **parameters}.items():
            self.data[name] = value
        self.init, self.step = MODEL.compiled() if compiled else MODEL.plain()
        self.data["p_BT_B"] = at
        self.status = self.init(self.s)

    def to(self, x: float, y: float, z: float = 0.0) -> np.ndarray:
        """Force on the tool after a step to this place."""
        self.data["p_BT_B"] = x, y, z
        assert self.step(self.s, 0.0, H) == 0
        return np.array(self.s.f_T_B)

    @property
    def message(self) -> str:
        return MODEL.message(self.status, self.s, 0.0)


@pytest.mark.parametrize(
    ("place", "distance", "normal"),
    [
        ((0.05, -0.003), 0.003, (0.0, -1.0)),
        ((0.05, 0.002), -0.002, (0.0, -1.0)),
        ((0.103, -0.004), 0.005, (0.6, -0.8)),
        ((-0.003, 0.104), 0.005, (-0.6, 0.8)),
        ((0.0, 0.05), 0.0, (-1.0, 0.0)),
        ((-0.004, -0.003), 0.005, (-0.8, -0.6)),
    ],
    ids=["beside", "inside", "corner", "other corner", "on the edge", "where it closes"],
)
def test_distance_and_normal_of_a_square(place: tuple[float, float], distance: float, normal: tuple[float, float]) -> None:
    stylus = Stylus()
    stylus.to(*place)
    assert stylus.s.distance == pytest.approx(distance, abs=LENGTH * ROUNDOFF)
    assert stylus.s.normal_P[:2] == pytest.approx(normal, abs=10.0 * LENGTH * ROUNDOFF / 0.005)


def test_distances_of_many_points_are_those_of_the_component() -> None:
    rng = np.random.default_rng(1)
    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    star = (0.08 + 0.02 * np.cos(5.0 * angle))[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    star[-1] = star[0]
    stylus = Stylus(star)
    points = rng.uniform(-0.12, 0.12, (300, 2))
    alone = []
    for p in points:
        stylus.to(*p)
        alone.append(float(stylus.s.distance))
    assert signed_distances(star, points) == pytest.approx(alone, abs=LENGTH * ROUNDOFF)


@pytest.mark.parametrize("tip", [0.0, 1e-3])
def test_a_circle_of_many_corners_is_a_circle(tip: float) -> None:
    """A chord of 2 pi/n is R (1 - cos(pi/n)) = R/2 (pi/n)^2 from its arc."""
    n, radius = 720, 0.04
    angle = np.linspace(0.0, 2.0 * np.pi, n + 1)
    stylus = Stylus(radius * np.column_stack([np.cos(angle), np.sin(angle)]), tip_radius=tip)
    for r, a in ((0.039, 0.3), (0.041, 2.0), (0.0395, 4.4)):
        stylus.to(r * math.cos(a), r * math.sin(a))
        assert stylus.s.distance == pytest.approx(r - radius - tip, abs=discretisation(radius / 2.0 * math.pi**2, 1.0 / n, 2))


def test_the_force_is_stiffness_times_depth_wherever_the_part_stands() -> None:
    turn = Rotation.from_euler("ZYX", [0.7, 0.2, -0.3])
    quat = np.roll(turn.as_quat(canonical=True), 1)
    stylus = Stylus(stiffness=2e5, tip_radius=1e-3, p_BP_B=[1.2, 0.3, 0.5], quat_BP=quat)
    force = stylus.to(*(np.array([1.2, 0.3, 0.5]) + turn.apply([0.05, -0.0008, 0.01])))
    assert force == pytest.approx(turn.apply([0.0, -2e5 * 0.0002, 0.0]), abs=2e5 * ROUNDOFF)
    assert np.array_equal(stylus.to(*(np.array([1.2, 0.3, 0.5]) + turn.apply([0.05, -0.002, 0.01]))), np.zeros(3))


def test_damping_acts_on_the_velocity_and_never_pulls() -> None:
    stylus = Stylus(stiffness=1e5, damping=50.0, at=(0.05, 0.001, 0.0))
    assert stylus.to(0.05, 0.0012)[1] == pytest.approx(-(1e5 * 0.0012 + 50.0 * 0.0002 / H), rel=ROUNDOFF * LENGTH / 2e-4)
    assert np.array_equal(Stylus(stiffness=1e5, damping=5e4, at=(0.05, 0.002, 0.0)).to(0.05, 0.0005), np.zeros(3))


class TestFriction:
    def test_it_is_off_by_default(self) -> None:
        assert MODEL.variable("friction").effect
        assert MODEL.variable("friction").start == EXACT
        assert Stylus(at=(0.05, 0.001, 0.0)).to(0.0501, 0.001)[0] == pytest.approx(0.0, abs=100.0 * ROUNDOFF)

    @pytest.mark.parametrize("way", [1e-4, -1e-4])
    def test_it_is_coulombs_against_the_motion_along_the_surface(self, way: float) -> None:
        stylus = Stylus(stiffness=1e5, friction=0.3, at=(0.05, 0.001, 0.0))
        force = stylus.to(0.05 + 3.0 * way, 0.001, 4.0 * way)
        assert force == pytest.approx(
            [-0.3 * 100.0 * math.copysign(0.6, way), -100.0, -0.3 * 100.0 * math.copysign(0.8, way)], rel=ROUNDOFF * LENGTH / 1e-4
        )

    def test_below_its_speed_it_goes_straight_through_zero(self) -> None:
        stylus = Stylus(stiffness=1e5, friction=0.3, friction_speed=1e-3, at=(0.05, 0.001, 0.0))
        assert stylus.to(0.05 + 1e-6, 0.001)[0] == pytest.approx(-0.3 * 100.0 * (1e-6 / H) / 1e-3, rel=ROUNDOFF * LENGTH / 1e-6)

    def test_it_changes_nothing_normal_to_the_surface(self) -> None:
        with_it, without = (Stylus(friction=mu, at=(0.05, 0.001, 0.0)).to(0.0503, 0.0012) for mu in (0.3, 0.0))
        assert with_it[1] == pytest.approx(without[1], rel=LENGTH / 1e-3 * ROUNDOFF)


@pytest.mark.parametrize(
    ("contour", "text"),
    [
        (np.zeros((0, 2)), "the contour has 0 points, expected at least 2: name a table of rows x, y [m] as parameter 'contour'"),
        ([[0, 0], [1, 0], [1, 0]], "the contour has the same point in row 1 (counted from zero) and in the next; expected different ones"),
    ],
)
def test_a_contour_that_is_none_is_refused(contour: Any, text: str) -> None:
    assert text in Stylus(contour).message


def test_compiled_is_plain_bit_by_bit() -> None:
    way = np.random.default_rng(2).uniform(-0.01, 0.11, (50, 3))
    plain, fast = (Stylus(compiled=c, damping=30.0, friction=0.2, tip_radius=2e-3) for c in (False, True))
    for p in way:
        assert np.array_equal(plain.to(*p), fast.to(*p))
        assert plain.s.distance == fast.s.distance
