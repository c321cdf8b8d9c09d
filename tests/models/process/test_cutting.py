"""Milling forces: published means, exact integration of the helix, the chip that runout hands on."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from robomill.models.model.parameters import load
from robomill.models.process.cutting import (
    LEAST_LAG,
    MAX_TEETH,
    CuttingCoefficients,
    EndMill,
    chip_law,
    coefficients_from_slots,
    edge_length,
    immersion,
    mean_force,
    mean_torque,
    passed,
    slot_force,
    tooth_radii,
)
from tests.models.process.ideal_engagement import ideal_force
from tests.tolerances import ROUNDOFF, discretisation, physics

AL7075 = load(CuttingCoefficients, "materials/al7075_t6")
AW2017 = load(CuttingCoefficients, "materials/aw2017")
MILL = load(EndMill, "tools/endmill_d16_z3")
TURN = 2 * math.pi
FOUR_TEETH = replace(MILL, teeth=4.0, diameter=0.012)
PRINTED = physics(0.0, absolute=5e-5)
"""The test vectors of FACTS 3.3 are printed to 1e-4 N: 1e-6 of their size."""


# ---------------------------------------------------------------- published numbers
def test_slot_in_al_7075_gives_the_published_mean() -> None:
    """FACTS 3.3: N = 4, a = 2 mm, c = 0.1 mm."""
    expected = (-101.4963, 223.9395, 59.3318)
    assert mean_force(AL7075, 4, 2e-3, 1e-4, 0.0, math.pi) == pytest.approx(expected, abs=PRINTED)
    assert slot_force(AL7075, 4, 2e-3, 1e-4) == pytest.approx(expected, abs=PRINTED)


def test_down_milling_in_al_7075_gives_the_published_mean() -> None:
    """FACTS 3.3, the cut of paper 001: D 12, ae 1, N 3, a 10, c 0.083333 mm."""
    entry, exit_ = immersion(0.012, 0.001, "down")
    assert (entry, exit_) == pytest.approx((2.555907, 3.141593), abs=physics(0.0, absolute=5e-7))
    assert mean_force(AL7075, 3, 0.010, 1e-4 / 1.2, entry, exit_) == pytest.approx((94.3667, 121.5896, 16.6793), abs=PRINTED)


@pytest.mark.parametrize("helix", [0.0, 10.0, 30.0, 45.0])
@pytest.mark.parametrize("diameter", [0.012, 0.020])
def test_helical_edges_over_a_revolution_give_the_published_means(helix: float, diameter: float) -> None:
    """FACTS 3.3, through the kernels of the component, for any helix, diameter, start angle and number of bins."""
    mill = EndMill(diameter, 4.0, math.radians(helix), 0.04)
    slot = ideal_force(AL7075, mill, 2e-3, 1e-4, 0.0, math.pi, 1.234, 1.234 + TURN, bins=5)
    assert slot[:3] == pytest.approx((-101.4963, 223.9395, 59.3318), abs=PRINTED)
    entry, exit_ = immersion(0.012, 0.001, "down")
    down = ideal_force(AL7075, replace(mill, teeth=3.0), 0.010, 1e-4 / 1.2, entry, exit_, -4.0, -4.0 + TURN, bins=3)
    assert down[:3] == pytest.approx((94.3667, 121.5896, 16.6793), abs=PRINTED)


def test_single_straight_tooth_at_ninety_degrees() -> None:
    """FACTS 3.3: a = 1 mm, c = 0.1 mm, Ktc 1000, Krc 300 N/mm2, no edge forces: (-30, 100) N.

    Bins of width w hold the mean of sin^2 about 90 degrees: 1 - w^2/12, so the error is at most |F| w^2/12.
    """
    coefficients = CuttingCoefficients(1e9, 3e8, 0.0, 0.0, 0.0, 0.0)
    bins = 361
    tooth = EndMill(0.010, 1.0, 0.0, 0.04)
    force = ideal_force(coefficients, tooth, 1e-3, 1e-4, 0.0, math.pi, math.pi / 2 - 1e-5, math.pi / 2 + 1e-5, bins)
    assert force[:2] == pytest.approx((-30.0, 100.0), abs=discretisation(105.0 / 12, math.pi / bins, 2))


def test_forces_of_the_groove_of_the_paper() -> None:
    """FACTS 3.4: AW-2017 default set, D16 z3, fz 0.03846 mm: mean |Fxy|/ap = 46.1 N/mm; mean 546 N at 11.8 mm, peak at 10.3 mm."""
    fx, fy, _ = slot_force(AW2017, 3, 1e-3, 0.025 / 650)
    per_depth = math.hypot(fx, fy) / 1e-3
    assert per_depth == pytest.approx(46.1e3, abs=physics(0.0, absolute=50.0))
    assert 546.0 / per_depth == pytest.approx(11.8e-3, abs=physics(0.0, absolute=5e-5))
    angles = np.linspace(0.0, TURN / 3, 121)
    peak = max(float(np.hypot(*ideal_force(AW2017, MILL, 10.3e-3, 0.025 / 650, 0.0, math.pi, a, a + 1e-6)[:2])) for a in angles)
    assert peak == pytest.approx(546.0, abs=physics(546.0, relative=0.1 / 10.3))  # one unit of the printed depth


# ---------------------------------------------------------------- invariants
def test_slot_is_the_limit_of_the_general_mean() -> None:
    assert slot_force(AW2017, 3, 0.01, 4e-5) == pytest.approx(mean_force(AW2017, 3, 0.01, 4e-5, 0.0, math.pi), rel=ROUNDOFF)


def test_no_arc_no_force() -> None:
    assert mean_force(AW2017, 3, 0.01, 4e-5, 1.0, 1.0) == (0.0, 0.0, 0.0)
    assert not ideal_force(AW2017, MILL, 0.0, 4e-5, 0.0, math.pi, 0.0, 1.0).any()


def test_torque_over_a_revolution_is_the_tangential_mean() -> None:
    entry, exit_ = immersion(0.016, 0.004, "up")
    force = ideal_force(AW2017, MILL, 0.01, 4e-5, entry, exit_, 0.2, 0.2 + TURN, bins=11)
    assert force[3] == pytest.approx(mean_torque(AW2017, MILL.diameter, 3, 0.01, 4e-5, entry, exit_), rel=ROUNDOFF)


def test_lever_arm_over_a_revolution_is_half_the_depth() -> None:
    """In an arc of constant depth every height sees the same force over a turn."""
    force = ideal_force(AW2017, MILL, 0.01, 4e-5, 0.3, 2.0, 0.2, 0.2 + TURN, bins=11)
    assert force[4:] == pytest.approx(0.005 * force[:2], rel=ROUNDOFF)


@pytest.mark.parametrize("seed", range(10))
def test_force_repeats_with_the_tooth_period_and_adds_up(seed: int) -> None:
    rng = np.random.default_rng(seed)
    start, length = rng.uniform(-10, 10), rng.uniform(0.1, 3.0)
    arc = sorted(rng.uniform(0.0, math.pi, 2))

    def force(a: float, b: float) -> np.ndarray:
        return ideal_force(AW2017, MILL, 0.012, 4e-5, arc[0], arc[1], a, b, bins=20)

    whole = force(start, start + length)
    scale = float(np.abs(mean_force(AW2017, 3, 0.012, 4e-5, 0.0, math.pi)).max())
    assert force(start + TURN / 3, start + TURN / 3 + length) == pytest.approx(whole, abs=ROUNDOFF * scale)
    middle = start + 0.37 * length
    parts = 0.37 * force(start, middle) + 0.63 * force(middle, start + length)
    assert parts == pytest.approx(whole, abs=10 * ROUNDOFF * scale)  # differences of squares of angles up to 10 rad


@pytest.mark.parametrize("seed", range(20))
def test_against_axial_layers_and_time_samples(seed: int) -> None:
    """Independent: 400 layers, 400 instants, force laws written out; both sums have an error of order 1/400 of the arc's force."""
    rng = np.random.default_rng(seed)
    n, depth, chip = int(rng.integers(1, 7)), rng.uniform(1e-3, 0.02), rng.uniform(1e-5, 1e-4)
    mill = EndMill(rng.uniform(0.006, 0.02), float(n), rng.uniform(0.0, 0.8), 0.04)
    entry, exit_ = sorted(rng.uniform(0.0, math.pi, 2))
    start, turned = rng.uniform(-7, 7), rng.uniform(0.3, 6.0)
    layers = 400
    z = (np.arange(layers) + 0.5) / layers * depth
    theta = start + (np.arange(layers) + 0.5) / layers * turned
    phi = np.mod(theta[:, None, None] - TURN * np.arange(n)[None, :, None] / n - 2 * np.tan(mill.helix) / mill.diameter * z, TURN)
    h = chip * np.sin(phi)
    cuts = (phi >= entry) & (phi <= exit_)
    k = AW2017
    ft, fr, fa = cuts * (k.Ktc * h + k.Kte), cuts * (k.Krc * h + k.Kre), cuts * (k.Kac * h + k.Kae)
    x, y = -ft * np.cos(phi) - fr * np.sin(phi), ft * np.sin(phi) - fr * np.cos(phi)
    radius = 0.5 * mill.diameter
    samples = (x, y, fa, radius * ft, z * x, z * y)
    expected = np.array([s.mean(axis=(0, 2)).sum() * depth for s in samples])
    result = ideal_force(k, mill, depth, chip, entry, exit_, start, start + turned, bins=400)
    largest = n * depth * (k.Ktc * chip + k.Kte + k.Krc * chip + k.Kre)
    scale = np.array([1, 1, 1, radius, depth, depth]) * largest
    assert np.all(np.abs(result - expected) < discretisation(2.0, 1 / layers, 1) * scale)


def test_edge_lengths_of_all_bins_add_up_to_the_depth() -> None:
    bounds = np.linspace(-2.0, 3.0, 51)
    lengths = [edge_length((2.5 - a) / 70.0, (2.5 - b) / 70.0, 0.001, 0.013) for a, b in itertools.pairwise(bounds)]
    assert sum(lengths) == pytest.approx(0.012, rel=ROUNDOFF)
    assert min(lengths) >= 0.0


def test_what_passes_two_bounds_against_quadrature() -> None:
    theta = np.linspace(0.1, 1.7, 20001)
    low, high, lag = 0.002, 0.011, 72.0
    at = [passed((theta[0] - phi) / lag, (theta[-1] - phi) / lag, low, high) for phi in (0.5, 0.6)]
    mean, moment = ((first - last) * lag / 1.6 for first, last in zip(*at, strict=True))
    top = np.clip((theta - 0.5) / lag, low, high)
    bottom = np.clip((theta - 0.6) / lag, low, high)
    bound = discretisation(1.0, theta[1] - theta[0], 2)
    assert mean == pytest.approx(np.trapezoid(top - bottom, theta) / 1.6, abs=bound)
    assert moment == pytest.approx(np.trapezoid(0.5 * (top**2 - bottom**2), theta) / 1.6, abs=bound * high)
    assert edge_length(0.5 / lag, 0.4 / lag, low, high) == pytest.approx(np.interp(1.0, theta, top - bottom), abs=bound)


# ---------------------------------------------------------------- runout
@pytest.mark.parametrize("seed", range(20))
def test_runout_moves_chip_between_teeth_but_loses_none(seed: int) -> None:
    """What a short tooth leaves the next one takes: the chips of a revolution add up to N c sin(phi)."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, MAX_TEETH + 1))
    radii = np.zeros(MAX_TEETH)
    tooth_radii(n, rng.uniform(0.0, 1e-4), rng.uniform(-4, 4), radii)
    chip, sine = rng.uniform(1e-5, 1e-4), rng.uniform(0.01, 1.0)
    chips = [a + b * sine for a, b in (chip_law(j, n, chip, sine, radii) for j in range(n))]
    assert sum(max(h, 0.0) for h in chips) == pytest.approx(n * chip * sine, rel=ROUNDOFF)


def test_runout_of_ten_micrometres_by_hand() -> None:
    """Three teeth, offset towards tooth 0: r = (10, -5, -5) um; chips 40 sin + r_j - r_(j-1) = 55, 25, 40 um at 90 degrees."""
    radii = np.zeros(MAX_TEETH)
    tooth_radii(3, 1e-5, 0.0, radii)
    assert radii[:3] == pytest.approx([1e-5, -0.5e-5, -0.5e-5], rel=ROUNDOFF)
    chips = [sum(chip_law(j, 3, 4e-5, 1.0, radii)) for j in range(3)]
    assert chips == pytest.approx([5.5e-5, 2.5e-5, 4.0e-5], rel=ROUNDOFF)


def test_without_runout_every_tooth_has_the_same_chip() -> None:
    radii = np.zeros(MAX_TEETH)
    assert [chip_law(j, 3, 4e-5, 0.7, radii) for j in range(3)] == [(0.0, 4e-5)] * 3


# ---------------------------------------------------------------- identification, data, errors
def test_coefficients_come_back_from_slots() -> None:
    chips = [2e-5, 4e-5, 6e-5, 8e-5]
    forces = np.array([slot_force(AL7075, 4, 2e-3, c) for c in chips])
    found = coefficients_from_slots(chips, forces, 4, 2e-3)
    for name in ("Ktc", "Krc", "Kac", "Kte", "Kre", "Kae"):
        scale = AL7075.Ktc if name.endswith("c") else AL7075.Kte
        assert getattr(found, name) == pytest.approx(getattr(AL7075, name), abs=100 * ROUNDOFF * scale)  # a fit extrapolates to c = 0


def test_identification_says_what_is_wrong() -> None:
    with pytest.raises(ValueError, match="expected \\(n,\\) with two different feeds or more"):
        coefficients_from_slots([1e-5, 1e-5], np.zeros((2, 3)), 3, 1e-3)
    forces = -np.array([slot_force(AL7075, 4, 2e-3, c) for c in (2e-5, 4e-5)])
    with pytest.raises(ValueError, match="Kac, Kae, Krc, Kre, Ktc, Kte came out negative; check the signs"):
        coefficients_from_slots([2e-5, 4e-5], forces, 4, 2e-3)


def test_immersion_angles() -> None:
    assert immersion(0.016, 0.016, "up") == (0.0, pytest.approx(math.pi, rel=ROUNDOFF))
    assert immersion(0.016, 0.008, "down") == (pytest.approx(math.pi / 2, rel=ROUNDOFF), math.pi)
    assert immersion(0.016, 0.0, "slot") == (0.0, math.pi)
    with pytest.raises(ValueError, match="there are 'slot', 'up', 'down'"):
        immersion(0.016, 0.001, "climb")
    with pytest.raises(ValueError, match=r"radial width 0\.02 m is outside"):
        immersion(0.016, 0.02, "up")


@pytest.mark.parametrize("material", ["aw2017", "al6082_t6", "al7075_t6", "al6061_t6"])
def test_material_files_load(material: str) -> None:
    """Aluminium: specific cutting force between 200 and 1500 N/mm2 (FACTS 3.1), the edge terms of the order of 10 N/mm."""
    k = load(CuttingCoefficients, f"materials/{material}")
    assert 2e8 < k.Ktc < 1.5e9
    assert 5e3 < k.Kte < 5e4


def test_default_mill() -> None:
    """Haehn & Weigold 2020, sec. 3.2: 16 mm, three edges; 30 degrees of helix lag 4.14 degrees per mm."""
    assert (MILL.diameter, MILL.teeth) == (0.016, 3.0)
    assert math.degrees(MILL.lag * 1e-3) == pytest.approx(4.135, abs=physics(0.0, absolute=5e-4))
    assert replace(MILL, helix=0.0).lag == LEAST_LAG
