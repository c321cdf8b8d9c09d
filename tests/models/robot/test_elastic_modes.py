"""Natural modes of elastic robots: published and computed figures, and what every undamped or damped structure obeys."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from robomill.models.model.declaration import FloatArray
from robomill.models.robot.elastic_modes import (
    ElasticMachine,
    elastic_modes,
    frequency_response,
    load_machine,
    system_matrices,
)
from robomill.models.robot.virtual_joints import load_compliance
from tests.tolerances import ROUNDOFF, physics

MILLING = np.deg2rad((0.0, -60.0, 100.0, 0.0, 50.0, 0.0))
END_EFFECTOR = (8, 9, 10)
"""Rows of sensor, holder and tool in the table of stiffness."""
RIGID = 1e96


def machine(robot: str, tool: str = "spindle_in_line", rigid_rows: tuple[int, ...] = END_EFFECTOR, tilts: bool = True) -> ElasticMachine:
    """The machine of data files with some rows of the stiffness made rigid, and all tilts if told so."""
    whole = load_machine(robot, tool)
    stiffness = np.array(whole.compliance.stiffness)
    stiffness[list(rigid_rows)] = RIGID
    if not tilts:
        stiffness[:, :2] = RIGID
    return replace(whole, compliance=replace(whole.compliance, stiffness=stiffness))


def near(found: FloatArray, published: tuple[float, ...], half_width: float) -> None:
    """Figures printed to 0.1 Hz, or to 1 Hz where `half_width` says so."""
    np.testing.assert_allclose(found[: len(published)], published, rtol=0.0, atol=physics(1.0, absolute=half_width))


@pytest.mark.parametrize(
    ("degrees", "published", "half_width"),
    [
        ((0, -60, 100, 0, 50, 0), (9.4, 11.5, 17.8, 18.2, 37.7, 43.0), 0.051),
        ((0, -60, 100, 0, 50, 0), (9.4, 11.5, 17.8, 18.2, 37.7, 43.0, 54.0, 68.0), 0.5),
        ((0, 0, 0, 0, 0, 0), (6.9, 8.1, 20.0, 25.7), 0.051),
        ((0, -90, 90, 0, 0, 0), (9.3, 10.4, 20.1, 21.8), 0.051),
    ],
)
@pytest.mark.paper
def test_eighteen_springs_of_the_kr_210(degrees: tuple[float, ...], published: tuple[float, ...], half_width: float) -> None:
    # FACTS10 10.5: springs of the thesis, both tilts, 60 kg 200 mm in front of the flange
    near(elastic_modes(machine("kr210_2"), np.deg2rad(degrees)).frequency, published, half_width)


def test_drives_alone_and_the_highest_mode_of_the_kr_210() -> None:
    # FACTS10 10.5
    near(elastic_modes(machine("kr210_2", tilts=False), MILLING).frequency, (13.3, 14.8, 20.4, 48.8), 0.051)
    modes = elastic_modes(machine("kr210_2"), MILLING)
    assert len(modes.frequency) == len(modes.coordinates) == 18
    assert modes.frequency[-1] == pytest.approx(707.0, abs=physics(707.0, absolute=0.5))
    assert np.count_nonzero(modes.frequency < 50.0) == 6


@pytest.mark.parametrize(
    ("degrees", "published"),
    [
        ((0, -45, 90, 0, -45, 0), (8.8, 9.2, 19.6, 20.7, 31.5)),
        ((0, -10, 10, 0, 0, 0), (6.6, 7.5, 21.6, 24.2)),
        ((2.66, -77.64, 77.44, 0, 0.2, 0), (8.9, 9.1, 19.1, 19.6)),
    ],
)
@pytest.mark.paper
def test_all_springs_of_the_kr_300(degrees: tuple[float, ...], published: tuple[float, ...]) -> None:
    # FACTS 4.3: all springs of Table 1 of Haehn & Weigold 2020, 60 kg with the centre of gravity at (60, 0, 200) mm; 31.55 printed 31.5
    whole = machine("kr300_r2500_ultra", "spindle_across", ())
    whole = replace(whole, tool=replace(whole.tool, p_FG_F=np.array([0.06, 0.0, 0.2])))
    near(elastic_modes(whole, np.deg2rad(degrees)).frequency, published, 0.051)


@pytest.mark.paper
def test_low_modes_of_the_kr_500_stretched() -> None:
    # FACTS10 10.6: 5.50 (A1 62 %), 6.65 Hz (column tilt 48 %), 36.05 Hz, with 100 kg and 3 kg.m2 200 mm in front of the flange
    whole = machine("kr500_r2830")
    dynamics = replace(whole.dynamics, payload_inertia=np.array([3.0, 3.0, 3.0, 0.0, 0.0, 0.0]))
    modes = elastic_modes(replace(whole, tool=replace(whole.tool, mass=100.0), dynamics=dynamics), np.zeros(6))
    near(modes.frequency, (5.50, 6.65, 20.7, 26.4, 36.05), 0.051)
    share = dict(zip(modes.coordinates, modes.energy_share[:, 0], strict=True))
    assert share["A1 drive"] == pytest.approx(0.62, abs=physics(0.62, absolute=0.01))
    column = dict(zip(modes.coordinates, modes.energy_share[:, 1], strict=True))
    assert column["A1 tilt y"] + column["A1 tilt x"] == pytest.approx(0.48, abs=physics(0.48, absolute=0.01))


def test_shapes_are_orthogonal_and_mass_normalised() -> None:
    whole = machine("kr210_2")
    M, D, K, J = system_matrices(whole, MILLING)
    modes = elastic_modes(whole, MILLING)
    V, w = modes.coordinate_shape, 2.0 * np.pi * modes.frequency
    n = len(w)
    np.testing.assert_allclose(V.T @ M @ V, np.eye(n), rtol=0.0, atol=1e3 * ROUNDOFF)
    np.testing.assert_allclose((V.T @ K @ V) / np.outer(w, w), np.eye(n), rtol=0.0, atol=1e3 * ROUNDOFF)
    np.testing.assert_allclose(modes.shape, J @ V, rtol=0.0, atol=EXACT_SUM * np.abs(modes.shape).max())
    # D = t K: the damping ratio is w t / 2
    np.testing.assert_allclose(modes.damping, 0.5 * w * load_compliance("kr210_2").damping_time, rtol=1e2 * ROUNDOFF)
    assert np.all(np.linalg.eigvalsh(M) > 0.0)
    assert np.array_equal(D, load_compliance("kr210_2").damping_time * K)


EXACT_SUM = 10.0 * ROUNDOFF
"""The product of the same two matrices, summed in another order."""


def test_frequency_response_is_that_of_the_matrices() -> None:
    # D = t K is diagonal in the modes, so the sum of modes is exact
    whole = machine("kr210_2", rigid_rows=())
    M, D, K, J = system_matrices(whole, MILLING)
    frequencies = np.array([0.0, 5.0, 9.4, 43.0, 300.0])
    H = frequency_response(elastic_modes(whole, MILLING), frequencies)
    for f, found in zip(frequencies, H, strict=True):
        w = 2.0 * np.pi * f
        expected = J @ np.linalg.solve(K - w * w * M + 1j * w * D, J.T)
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e4 * ROUNDOFF * np.abs(expected).max())


def test_bad_pose_and_robot_without_masses_are_refused() -> None:
    whole = machine("kr210_2")
    with pytest.raises(ValueError, match=r"elastic modes: q is \[0\.0, 0\.0\], expected six finite axis angles in rad"):
        elastic_modes(whole, [0.0, 0.0])
    nothing = replace(whole.dynamics, body_mass=np.zeros(6), body_inertia=np.zeros((6, 6)), payload_inertia=np.zeros(6))
    with pytest.raises(ValueError, match="the bodies of robot 'KUKA KR 210-2' weigh 0 kg; expected masses"):
        elastic_modes(replace(whole, dynamics=nothing, tool=replace(whole.tool, mass=0.0)), MILLING)
    with pytest.raises(FileNotFoundError, match=r"no parameter file .*dynamics/irb6400r_25_150\.toml; available"):
        load_machine("irb6400r_25_150", "spindle_in_line")
