"""The gate on a milling run: each axis with the wrong sign, each interchanged pair, each transposed rotation is stopped."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robomill.cell.binding import convert, resolve
from robomill.cell.equipment import load_system
from robomill.cell.milling import with_parameters
from robomill.cell.next_runs import prepare
from robomill.diagnosis.gate.gate import beside
from robomill.orchestration.assembly import run
from tests import ROOT

SPREAD = {"compliance.p_BT_B": 7e-6, "sensor.f_S_raw": 0.5, "sensor.f_T_T": 0.5, "drive.q_motor": 1e-6, "drive.torque_motor": 0.07}
"""Arrays that are measured, and the noise of their instruments."""


@pytest.fixture(scope="module")
def milled(tmp_path_factory):
    """The run, and simulated and measured channels: another machine (softer by 5 %) with noise."""
    cell = load_system(ROOT / "scenarios" / "milling_cell.toml")
    r = prepare(cell, "cut", tmp_path_factory.mktemp("run"), {"x": 1500.0, "y": 300.0, "z": 1050.0})
    quiet = with_parameters(with_parameters(r.system, r.parameters), {"sensor": {"noise_f": 0.0, "noise_m": 0.0}})
    soft = quiet.with_parameters("compliance", {"stiffness_error": [-0.05] * 6})
    nominal, real = (run(s, None, stop=r.seconds, resolver=resolve, convert=convert) for s in (quiet, soft))
    channels = [c for c in real.columns if c.partition("[")[0] in SPREAD]
    noise = np.array([SPREAD[c.partition("[")[0]] for c in channels])
    simulated, measured = (np.stack([x.columns[c] for c in channels], axis=1) for x in (nominal, real))
    return real, channels, simulated, measured + noise * np.random.default_rng(1).standard_normal(measured.shape), noise


def stopped(milled, changed):
    """Kinds of the fatal findings."""
    real, channels, simulated, _, noise = milled
    return {f.kind for f in beside(real, changed, simulated, channels, 0.004, noise) if f.fatal}


def members(milled, array):
    """Channels of an array, less those that drown in noise: they have no sign."""
    _, channels, _, measured, noise = milled
    return [
        i
        for i, c in enumerate(channels)
        if c.partition("[")[0] == array and np.std(measured[:, i]) + abs(np.mean(measured[:, i])) > 10.0 * noise[i]
    ]


def test_what_is_right_passes(milled):
    assert stopped(milled, milled[3]) == set()


@pytest.mark.parametrize("array", SPREAD)
def test_every_wrong_sign_and_every_interchange_is_stopped(milled, array):
    measured = milled[3]
    assert len(members(milled, array)) >= 3
    for i in members(milled, array):
        flipped = measured.copy()
        flipped[:, i] *= -1.0
        assert "sign" in stopped(milled, flipped), milled[1][i]
    for i, j in itertools.combinations(members(milled, array), 2):
        crossed = measured.copy()
        crossed[:, [i, j]] = measured[:, [j, i]]
        # where one is nearly minus the other, two wrong signs are the same thing
        assert stopped(milled, crossed) & {"axes", "sign"}, (milled[1][i], milled[1][j])


@pytest.mark.parametrize("array", [a for a in SPREAD if "drive" not in a])
@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)])
def test_a_transposed_rotation_is_stopped(milled, array, axis):
    # R' for R: what is logged is turned by R' R', here by 90 degrees for a sensor that is mounted at 45
    turn = Rotation.from_rotvec(np.deg2rad(90.0) * np.array(axis) / np.linalg.norm(axis))
    turned = milled[3].copy()
    turned[:, members(milled, array)] = turn.apply(milled[3][:, members(milled, array)])
    assert stopped(milled, turned)
