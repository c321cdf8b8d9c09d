"""Measurement matrix from a calibration: exact data, noise, the shrinkage of Eq. (8), what cannot be calibrated."""

from __future__ import annotations

import numpy as np
import pytest

from robomill.models.calibration.measurement_matrix import CalibrationError, felt, identify_matrix
from robomill.models.components.spindle_holder import HOLDER
from tests.tolerances import ROUNDOFF, chance, of_mean, physics

NOISE = 2e-6
"""V/V: 10 uV at 5 V."""
S = HOLDER.bridge_force


def staircases(axial: bool = True, rest: int = 400) -> np.ndarray:
    """Loads of paper 001: +x, -x, +y, -y and -z of the holder up to 300 N, 500 rows each way, with rows at rest between them."""
    up = np.concatenate([np.linspace(0.0, 300.0, 250), np.linspace(300.0, 0.0, 250), np.zeros(rest)])
    ways = [(0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0), *([(2, -1.0)] if axial else [])]
    return np.concatenate([np.outer(up, sign * np.eye(3)[axis]) for axis, sign in ways])


def readings(forces: np.ndarray, noise: float = NOISE, seed: int = 0) -> np.ndarray:
    """Bridges with zeros of their own [V/V]."""
    zero = 1e-5 * np.array([1.0, -2.0, 0.5, 3.0, -1.0, 2.0])
    return np.asarray(forces @ S.T + zero + noise * np.random.default_rng(seed).standard_normal((len(forces), 6)))


class TestLeastSquares:
    @pytest.mark.parametrize("way", ["strains", "forces"])
    def test_exact_data(self, way: str) -> None:
        """The pseudo-inverse comes back; readings of a rank of three leave Eq. (8) a choice, of which the shortest is taken."""
        forces = staircases()
        fit = identify_matrix(readings(forces, 0.0), forces, way)
        # the weights have a floor of 1e-6 of the signal, and so a condition of 1e12 of its square
        assert np.abs(fit.matrix @ S - np.eye(3)).max() < physics(1.0, absolute=1e-6)
        assert np.abs(fit.zero - 1e-5 * np.array([1.0, -2.0, 0.5, 3.0, -1.0, 2.0])).max() < ROUNDOFF
        assert fit.residual.max() < physics(300.0, relative=1e-6)

    def test_condition_number(self) -> None:
        """That of the sensitivity, from numpy's singular values: 4.48; it is felt 4.5 times worse where it is worst."""
        forces = staircases()
        fit = identify_matrix(readings(forces), forces)
        assert abs(fit.condition / np.linalg.cond(S) - 1.0) < physics(1.0, relative=0.01)

    @pytest.mark.paper
    def test_uncertainty_of_a_force(self) -> None:
        """FACTS10 10.6: 2 uV/V rms give +-6.2, 9.2, 27.3 N (2 sigma); paper 001: +-10, 10, 50 N with all other causes."""
        forces = staircases()
        fit = identify_matrix(readings(forces), forces)
        assert np.abs(2.0 * fit.force_noise / [6.2, 9.2, 27.3] - 1.0).max() < physics(1.0, relative=0.05)
        assert np.all(2.0 * fit.deviation(np.array([0.0, 0.0, -300.0])) < [10.0, 10.0, 50.0])

    def test_deviation_is_what_other_calibrations_give(self) -> None:
        """Scatter of the mean force over 200 calibrations with other noise, at 300 N axial, against the closed form."""
        forces, load, trials = staircases(), np.array([0.0, 0.0, -300.0]), 200
        fits = [identify_matrix(readings(forces, seed=k), forces) for k in range(trials)]
        true = 1e-5 * np.array([1.0, -2.0, 0.5, 3.0, -1.0, 2.0]) + S @ load
        found = np.std([f.matrix @ (true - f.zero) for f in fits], axis=0)
        assert np.abs(found / fits[0].deviation(load, np.inf) - 1.0).max() < chance(of_mean(2.0 * trials))

    def test_eq_8_reads_axial_forces_too_small(self) -> None:
        """Errors in the readings: scale = signal / (signal + noise), as a Wiener filter; by hand for the axial force.

        Variance of the axial load over all rows against 13.6 N of noise; the strains inverted have the scale 1.
        """
        forces = staircases()
        direct, inverted = (identify_matrix(readings(forces), forces, way) for way in ("forces", "strains"))
        signal = np.var(forces, axis=0)
        expected = np.linalg.inv(np.eye(3) + np.linalg.inv(S.T @ S) * NOISE**2 @ np.linalg.inv(np.cov(forces.T)))
        assert np.abs(direct.scale - np.diag(expected)).max() < physics(1.0, absolute=5e-3)
        assert direct.scale[2] < 0.97
        assert signal[2] < signal[:2].min()
        assert np.abs(inverted.scale - 1.0).max() < ROUNDOFF


class TestRefused:
    def refuse(self, bridges: np.ndarray, forces: np.ndarray, text: str) -> None:
        with pytest.raises(CalibrationError) as error:
            identify_matrix(bridges, forces)
        assert text in str(error.value)

    def test_no_axial_load(self) -> None:
        forces = staircases(axial=False)
        self.refuse(
            readings(forces),
            forces,
            "the loads do not span three directions: their spread along (0.00, 0.00, 1.00) of the holder is 0 N, along the strongest "
            "direction 91.4 N, so the matrix is singular; expected more than 2 %: load the tool along +-x, +-y and -z as well",
        )

    def test_a_dead_bridge(self) -> None:
        forces = staircases()
        bridges = readings(forces)
        bridges[:, 3] = 1e-5 + NOISE * np.random.default_rng(5).standard_normal(len(forces))
        self.refuse(bridges, forces, "bridge 4 does not follow the load: the force explains 0 % of its reading, expected more than 50 %")

    def test_a_bridge_that_stands_still(self) -> None:
        forces = staircases()
        bridges = readings(forces)
        bridges[:, 0] = 0.0
        self.refuse(bridges, forces, "bridge 1 does not follow the load: the force explains 0 % of its reading")

    def test_bridges_that_say_the_same(self) -> None:
        forces = staircases()
        one = readings(forces, 0.0)[:, :1] @ np.ones((1, 6))
        self.refuse(one, forces, "the bridges do not tell three forces apart: condition number")

    def test_numbers_that_are_none(self) -> None:
        forces = staircases()
        bridges = readings(forces)
        bridges[7, 2] = np.nan
        self.refuse(bridges, forces, "row 8: reading of a bridge 3 is nan, expected a finite number; leave it out")

    def test_too_few_rows(self) -> None:
        forces = staircases()[:10]
        self.refuse(readings(forces), forces, "10 rows; expected at least 20: loads in several directions")

    def test_shapes(self) -> None:
        self.refuse(np.zeros((30, 5)), np.zeros((30, 3)), "readings (30, 5) and forces (30, 3); expected (n, 6) and (n, 3)")

    def test_way(self) -> None:
        with pytest.raises(CalibrationError, match="way 'best' is unknown; available: strains, forces"):
            identify_matrix(readings(staircases()), staircases(), "best")


def test_felt_by_hand() -> None:
    """100 N along x at twice the lever bends like 200 N; along z it is itself, and beside the axis it bends."""
    force = np.array([[100.0, 0.0, 0.0], [0.0, 0.0, 50.0]])
    assert np.abs(felt(force, np.array([0.0, 0.0, 0.24]), 0.12) - [[200.0, 0.0, 0.0], [0.0, 0.0, 50.0]]).max() < ROUNDOFF * 200.0
    assert np.abs(felt(force[1:], np.array([0.06, 0.0, 0.12]), 0.12) - [[-25.0, 0.0, 50.0]]).max() < ROUNDOFF * 200.0
