"""Published examples of stability (FACTS 4.1, 4.2; FACTS10 10.5) and independent oracles for them."""

from __future__ import annotations

import math

import control
import numpy as np
import pytest

from robomill.models.process.cutting import CuttingCoefficients
from robomill.models.process.stability import coupling
from robomill.models.process.stability.modes import Modes, from_stiffness, receptance
from robomill.models.process.stability.semi_discretisation import (
    INTERVALS,
    depth_limit,
    enough_intervals,
    periodic_matrices,
    spectral_radius,
)
from robomill.models.process.stability.zero_order import Engagement, eigenvalues, limit_curve, lobes, mean_matrix, turning_limit
from tests.tolerances import ROUNDOFF, physics

RPM = math.pi / 30.0
MM = 1e-3
PRINTED = 1e-3
"""Relative: FACTS 4.1 prints its own calculations to three or four digits; the last one may be off by a half."""
BENCHMARK = from_stiffness([922.0], [0.011], [1340049.648], [[1, 0, 0]])
"""Insperger & Stepan 2004: one direction, along the feed."""
BENCHMARK_CUT = CuttingCoefficients(6e8, 2e8, 0.0, 0.0, 0.0, 0.0)
SLOT, SHALLOW = Engagement.between(0.0, math.pi), Engagement.between(math.acos(2 * 0.05 - 1), math.pi)


@pytest.mark.paper
def test_shaping_with_two_inclined_modes():
    """Altintas' book: 7.185 mm at 252.98 Hz."""
    f = np.arange(100.0, 300.0, 0.01)
    modes = from_stiffness([250.0, 150.0], [0.012, 0.010], [2.26e8, 2.13e8], [[math.cos(a), math.sin(a), 0] for a in np.deg2rad([30, -45])])
    oriented = receptance(modes, f)[:, 0, 0]
    width, frequency = turning_limit(f, oriented, 1e9)
    assert oriented.real.min() == pytest.approx(-6.95896e-8, rel=physics(1.0, relative=1e-5))
    assert width == pytest.approx(7.185 * MM, rel=physics(1.0, relative=PRINTED))
    assert frequency == pytest.approx(252.98, abs=physics(0.0, absolute=0.02))


def test_what_never_chatters_in_turning_is_refused():
    with pytest.raises(ValueError, match="nowhere negative: no width of cut chatters"):
        turning_limit(np.array([1.0, 2.0]), np.array([1e-8 + 0j, 2e-8 + 0j]), 1e9)


@pytest.mark.paper
@pytest.mark.parametrize(
    ("engagement", "mean", "limit"),
    [(SLOT, -1.0e8, 2 * 1340049.648 * 0.011 * 1.011 / 1.0e8), (SHALLOW, 1.6274e7, 1.7916 * MM)],
)
def test_zero_order_minimum_of_the_milling_benchmark(engagement: Engagement, mean: float, limit: float):
    """The mean coefficient h and 2 k zeta(1 +- zeta)/|h| of Insperger & Stepan 2004: 0.2981 and 1.7916 mm."""
    A = mean_matrix(BENCHMARK_CUT, 2, engagement)
    assert A[0, 0] == pytest.approx(mean, rel=physics(1.0, relative=1e-4))
    f = np.linspace(880.0, 960.0, 8001)
    found = limit_curve(receptance(BENCHMARK, f), A).min()
    # a grid of 0.01 Hz sees a minimum 10 Hz wide to 1e-6 of it
    assert found == pytest.approx(limit, rel=physics(1.0, relative=PRINTED))


SEMI_DISCRETE = [
    (SLOT, dict(zip((5000, 10000, 15000, 20000, 25000), (0.480, 0.335, 0.393, 1.428, 3.938), strict=True))),
    (SHALLOW, dict(zip((5000, 10000, 15000, 20000, 25000), (2.328, 4.138, 8.171, 2.312, 2.945), strict=True))),
]


@pytest.mark.paper
@pytest.mark.parametrize(("engagement", "limits"), SEMI_DISCRETE, ids=["a/D=1", "a/D=0.05"])
def test_semi_discrete_limits_of_the_milling_benchmark(engagement: Engagement, limits: dict[int, float]):
    """The limit lies within the last printed digit: stable half a digit below (and 0.1 %), unstable above."""
    matrices = periodic_matrices(BENCHMARK_CUT, 2, engagement)
    for rpm, limit in limits.items():
        margin = 0.5e-6 + PRINTED * limit * MM
        period = 30.0 / rpm
        assert spectral_radius(BENCHMARK, matrices, limit * MM - margin, period) < 1.0
        assert spectral_radius(BENCHMARK, matrices, limit * MM + margin, period) > 1.0


def _simulated_growth(depth: float, rpm: float, per_tooth: int = 200, teeth: int = 160) -> float:
    """Ratio of the vibration in the last 40 tooth periods to that in periods 40 to 80, by direct integration.

    m x'' + c x' + k x = -a h(t) [x(t) - x(t - tau)], Stoermer's rule with the delay as a whole number of steps: nothing of ours.
    """
    w, zeta, k = 2 * math.pi * 922.0, 0.011, 1340049.648
    tau = 60.0 / rpm / 2
    dt = tau / per_tooth
    phi = (np.arange(per_tooth) + 0.5) / per_tooth * math.pi
    h = (6e8 * np.cos(phi) + 2e8 * np.sin(phi)) * np.sin(phi)  # one of two teeth is always in a full slot
    x = [1e-6] * (per_tooth + 1)
    for i in range(teeth * per_tooth):
        now, before = x[-1], x[-2]
        push = -depth * h[i % per_tooth] * (now - x[-1 - per_tooth]) * w * w / k
        x.append(now + ((now - before) * (1 - zeta * w * dt) + dt * dt * (push - w * w * now)) / (1 + zeta * w * dt))
    vibration = np.abs(np.array(x[per_tooth + 1 :])).reshape(teeth, per_tooth).max(axis=1)
    return float(vibration[-40:].max() / vibration[40:80].max())


@pytest.mark.parametrize("rpm", [5000, 10000, 20000])
def test_direct_integration_grows_above_the_limit_and_decays_below(rpm: int):
    """10 % either side: close enough to fail for a wrong lobe, far enough to show within 160 tooth periods."""
    period = 30.0 / rpm
    matrices = periodic_matrices(BENCHMARK_CUT, 2, SLOT, enough_intervals(BENCHMARK, period))
    limit = depth_limit(BENCHMARK, matrices, period, 4 * MM)
    assert _simulated_growth(0.9 * limit, rpm) < 1.0
    assert _simulated_growth(1.1 * limit, rpm) > 1.0


def test_forty_intervals_are_too_few_where_a_tooth_period_has_many_vibrations():
    """At 5000 rpm, 5.5 vibrations per tooth: 0.480 mm of the published resolution is unstable by direct integration."""
    assert _simulated_growth(0.95 * 0.480 * MM, 5000) > 1.0
    period = 30.0 / 5000
    coarse, fine = (
        depth_limit(BENCHMARK, periodic_matrices(BENCHMARK_CUT, 2, SLOT, m), period, 1.5 * MM)
        for m in (INTERVALS, enough_intervals(BENCHMARK, period))
    )
    assert coarse > 1.1 * fine
    finest = depth_limit(BENCHMARK, periodic_matrices(BENCHMARK_CUT, 2, SLOT, 260), period, 1.5 * MM)
    # what 30 per vibration leaves: an error of second order, 0.16^2 of that of 40 intervals
    assert fine == pytest.approx(finest, rel=physics(1.0, relative=0.015))


def _residues(f: np.ndarray, frequency: list[float], damping: list[float], residue: list[complex]) -> np.ndarray:
    """Receptance of complex residues: sum (alpha + j beta w)/(wn^2 - w^2 + 2 j zeta wn w) (FACTS 4.1)."""
    w, total = 2 * math.pi * f, np.zeros(len(f), complex)
    for fn, z, r in zip(frequency, damping, residue, strict=True):
        wn = 2 * math.pi * fn
        alpha, beta = 2 * (z * wn * r.real - wn * math.sqrt(1 - z * z) * r.imag), 2 * r.real
        total += (alpha + 1j * beta * w) / (wn**2 - w**2 + 2j * z * wn * w)
    return total


@pytest.mark.paper
def test_lobes_of_the_cutter_of_altintas_book():
    """1.0147 mm at 1440.8 Hz at least; 1.167, 1.207, 1.017, 5.048 mm at 4000, 8000, 12000, 14000 rpm."""
    f = np.arange(200.0, 3000.0, 0.1)
    H = np.zeros((len(f), 3, 3), complex)
    H[:, 0, 0] = _residues(f, [452.77, 1448.53], [0.123718, 0.01651], [9.202966e-5 - 1.862195e-4j, -4.181562e-5 - 3.043618e-4j])
    H[:, 1, 1] = _residues(f, [516.17, 1407.64], [0.0243, 0.0324], [-2.3929e-6 - 1.721539e-4j, 4.055052e-5 - 3.618808e-4j])
    A = mean_matrix(CuttingCoefficients(1319.4e6, 788.8e6, 0, 0, 0, 0), 2, Engagement.between(math.pi / 2, math.pi))
    curve = limit_curve(H, A).min(axis=0)
    assert curve.min() == pytest.approx(1.0147 * MM, rel=physics(1.0, relative=PRINTED))
    assert f[np.argmin(curve)] == pytest.approx(1440.8, abs=physics(0.0, absolute=0.5))
    found = lobes(f, H, A, 2, np.array([4000, 8000, 12000, 14000]) * RPM)
    # FACTS interpolates between frequencies 0.25 Hz apart
    assert found.depth == pytest.approx(np.array([1.167, 1.207, 1.017, 5.048]) * MM, rel=physics(1.0, relative=2 * PRINTED))


def test_eigenvalues_are_those_of_the_whole_product():
    """Oracle: numpy on A H, 3 x 3, modes in all directions."""
    modes = Modes(np.array([9.0, 30.0, 800.0]), np.array([0.02, 0.03, 0.01]), np.random.default_rng(5).normal(size=(3, 3)))
    H = receptance(modes, np.linspace(5.0, 1000.0, 50))
    A = mean_matrix(CuttingCoefficients(7e8, 2e8, 3e8, 0, 0, 0), 3, Engagement.between(0.4, 2.0))
    ours = eigenvalues(H, A)
    for i in range(50):
        theirs = np.linalg.eigvals(A @ H[i])
        for value in ours[:, i]:
            assert np.abs(theirs - value).min() <= 1e4 * ROUNDOFF * np.abs(theirs).max()


MASS, K1, K2 = 150.0, 0.5e6, 0.8e6
ALPHA, GAMMA = math.radians(60), math.radians(-35)
DIRECTION = -np.outer([math.cos(GAMMA), 0, math.sin(GAMMA)], [math.cos(ALPHA), 0, math.sin(ALPHA)])


def _pair(damping: float) -> Modes:
    return from_stiffness(np.sqrt([K1 / MASS, K2 / MASS]) / (2 * math.pi), [damping] * 2, [K1, K2], [[1, 0, 0], [0, 0, 1]])


@pytest.mark.paper
def test_mode_coupling_of_two_robot_modes():
    """FACTS 4.2: 165.9 N/mm without damping, 170.1 N/mm with 2 %, flutter at 10.35 Hz."""
    assert coupling.undamped_flutter_gain(K1, K2, ALPHA, GAMMA) == pytest.approx(165.9e3, rel=physics(1.0, relative=PRINTED))
    assert coupling.critical_gain(_pair(0.0), DIRECTION, 5e6)[0] == pytest.approx(165.9e3, rel=physics(1.0, relative=PRINTED))
    gain, frequency = coupling.critical_gain(_pair(0.02), DIRECTION, 5e6)
    assert gain == pytest.approx(170.1e3, rel=physics(1.0, relative=PRINTED))
    assert frequency == pytest.approx(10.35, abs=physics(0.0, absolute=5e-3))


def test_no_flutter_where_the_angles_do_not_couple():
    assert coupling.undamped_flutter_gain(K1, K2, ALPHA, -GAMMA) == math.inf
    assert coupling.critical_gain(_pair(0.02), -np.outer([1.0, 0, 0], [1.0, 0, 0]), 5e6)[0] == math.inf


def test_poles_of_mode_coupling_are_those_of_python_control():
    """The loop is closed by python-control: modes as a state space, the process as a static gain."""
    modes = _pair(0.02)
    w = modes.circular
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.diag(w**2), -2 * np.diag(0.02 * w)]])
    B = np.vstack([np.zeros((2, 3)), modes.shape.T])
    C = np.hstack([modes.shape, np.zeros((3, 2))])
    G = 150e3 * DIRECTION
    theirs = np.sort_complex(control.feedback(control.ss(A, B, C, np.zeros((3, 3))), control.ss([], [], [], G), sign=1).poles())
    ours = np.sort_complex(coupling.coupled_eigenvalues(modes, G))
    assert np.abs(ours - theirs).max() <= 1e3 * ROUNDOFF * w.max()


@pytest.mark.paper
@pytest.mark.parametrize(("frequency", "extra", "limit"), [(9.4, 0, 0.341), (9.4, 1, 0.116), (18.0, 0, 0.18), (18.0, 1, 0.065)])
def test_explicit_coupling_chatters_falsely(frequency: float, extra: int, limit: float):
    """FACTS10 10.5: .34, .116, .18, .065 for 2 % at 4 ms, and the rule 4 zeta/(w h (1 + 2 n)) to first order in the step."""
    found = coupling.explicit_limit(frequency, 0.02, 0.004, extra)
    assert found == pytest.approx(limit, abs=physics(0.0, absolute=1e-3 if extra == 0 else 5e-4))
    rule = [4 * 0.02 / (2 * math.pi * frequency * h * (1 + 2 * extra)) for h in (0.004, 0.0005)]
    errors = [abs(coupling.explicit_limit(frequency, 0.02, h, extra) / r - 1.0) for h, r in zip((0.004, 0.0005), rule, strict=True)]
    # what the rule leaves out is of first order in the step: an eighth of the step, less than half the error
    assert errors[1] < 0.5 * errors[0]


def test_directions_and_stiffnesses_of_modes_are_checked():
    with pytest.raises(ValueError, match="lengths of directions"):
        from_stiffness([10.0], [0.02], [1e6], [[0, 0, 0]])
    with pytest.raises(ValueError, match=r"expected \(n,\), \(n,\) and \(3, n\)"):
        Modes(np.ones(2), np.ones(1), np.ones((3, 2)))
    with pytest.raises(ValueError, match="must be positive"):
        Modes(np.zeros(1), np.ones(1), np.ones((3, 1)))
    with pytest.raises(ValueError, match="expected 0 <= entry < exit <= pi"):
        Engagement.between(1.0, 0.5)


def test_the_static_compliance_is_the_receptance_at_zero():
    modes = BENCHMARK + from_stiffness([9.4], [0.02], [1e6], [[0, 1, 1]])
    assert modes.compliance == pytest.approx(receptance(modes, np.zeros(1))[0].real, rel=ROUNDOFF, abs=ROUNDOFF * 1e-6)
    assert modes.compliance[0, 0] == pytest.approx(1 / 1340049.648, rel=10 * ROUNDOFF)
    R = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])
    assert modes.turned(R).compliance == pytest.approx(R @ modes.compliance @ R.T, abs=10 * ROUNDOFF * 1e-6)
