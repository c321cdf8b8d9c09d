"""Tests of the component as its authors would write them: `pip install . && pytest`."""

import json
from pathlib import Path

import numpy as np
import pytest
from kalman_sensor.kalman import gains
from kalman_sensor.model import MODEL
from scipy.linalg import solve_discrete_are

from robomill import System, run
from robomill.cli import main
from robomill.fmus.components import COMPONENTS
from robomill.fmus.in_process import InProcessSlave
from robomill.fmus.native.builder import build as build_native
from robomill.fmus.python.builder import build as build_python

HERE = Path(__file__).parent
H = 0.004
ROUNDOFF = 1e-12
"""Relative: after 2000 steps the covariance has settled to the last bits; what stays is that of two ways of writing it."""
FOLLOWED = 1e-7
"""Relative: the noise of 1e-6 N beside 100 N."""


def test_it_is_offered_under_its_name() -> None:
    assert COMPONENTS["kalman_sensor"] is MODEL


def test_the_gain_settles_at_the_solution_of_the_riccati_equation() -> None:
    wander, noise = 150.0, 1.0
    covariance, gain = np.zeros(3), np.zeros(2)
    for _ in range(2000):
        gains(covariance, H, wander, noise, gain)
    F, C, Q = np.array([[1.0, H], [0.0, 1.0]]), np.array([[1.0, 0.0]]), np.diag([0.0, wander**2])
    P = solve_discrete_are(F.T, C.T, Q, np.array([[noise**2]]))
    np.testing.assert_allclose(gain, P[:, 0] / (P[0, 0] + noise**2), rtol=ROUNDOFF)


def test_a_ramp_is_followed_without_lag_and_noise_is_smoothed() -> None:
    slave = InProcessSlave(MODEL, "sensor")
    slave.configure({"noise_f": 1e-6})
    shown = np.zeros(12)
    for k in range(500):
        slave.set_inputs(np.r_[100.0 * k * H, np.zeros(5), MODEL.variable("q").start_values])
        slave.initialise(0.0, 2.0, H) if k == 0 else slave.step((k - 1) * H, H)
    slave.get_outputs(shown)
    force = np.linalg.norm(shown[6:9])
    assert force == pytest.approx(100.0 * 499 * H, rel=FOLLOWED)


def test_both_fmus_give_the_same_bits_as_the_model(tmp_path: Path) -> None:
    made = {}
    for kind, source in (
        ("model", "kalman_sensor"),
        ("python", str(build_python(MODEL, tmp_path / "python" / "kalman_sensor.fmu"))),
        ("native", str(build_native(MODEL, tmp_path / "native" / "kalman_sensor.fmu"))),
    ):
        system = tmp_path / f"{kind}.toml"
        system.write_text(
            f'name = "{kind}"\nstep = "4 ms"\n[components.sensor]\nsource = "{source}"\n'
            'inputs = { f_T_B = ["10 N", "-20 N", "30 N"], m_T_B = ["1 Nm", "2 Nm", "3 Nm"] }\n'
        )
        made[kind] = run(System.load(system), stop=0.4)
    for kind in ("python", "native"):
        for column, values in made["model"].columns.items():
            assert np.array_equal(values, made[kind].columns[column]), (kind, column)
    assert np.ptp(made["model"].columns["sensor.f_T_T[1]"]) > 0.1  # the noise is there


def test_a_load_that_stays_creeps_with_the_time_constant() -> None:
    slave = InProcessSlave(MODEL, "sensor")
    slave.configure({"noise_f": 1e-6, "noise_m": 1e-6, "creep": 0.1, "creep_time": 0.2})
    slave.set_inputs(np.r_[100.0, np.zeros(5), MODEL.variable("q").start_values])
    slave.initialise(0.0, 2.0, H)
    shown = np.zeros(12)
    for k in range(50):
        slave.step(k * H, H)
    slave.get_outputs(shown)
    assert np.linalg.norm(shown[:3]) == pytest.approx(100.0 * (1.0 + 0.1 * (1.0 - np.exp(-1.0))), rel=FOLLOWED)


def test_what_is_wrong_with_a_machine_is_found_with_the_catalogue_of_the_package(tmp_path: Path) -> None:
    assert main(["run", str(HERE / "machine.toml"), "--out", str(tmp_path / "runs")]) == 0
    runs = [str(tmp_path / "runs" / f"slot-{i}") for i in (1, 2, 3)]
    assert main(["diagnose", str(HERE / "cell.toml"), *runs, "--out", str(tmp_path / "answer"), "--jobs", "1"]) == 0
    found = json.loads((tmp_path / "answer" / "diagnosis.json").read_text())
    assert found["verdict"] == "identified"
    (which, *_) = found["which"]
    assert which["effect"] == "creep"
    low, high = which["parameters"]["creep"]["interval"]
    assert low < 0.08 < high
    assert [w["component"] for w in found["where"]] == ["sensor"]
    assert any("component 'sensor' has no parameters for effects sensor_gain" in text for text in found["skipped"])
