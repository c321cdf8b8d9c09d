"""robot_compliance_dynamic: the tool tip of a robot with inertia. Read as its specification.

Its bodies are checked against Pinocchio in tests/models/robot/test_elastic_bodies.py, its modes against published figures in
tests/models/robot/test_elastic_modes.py; what a load at rest does is robot_compliance, tests/models/components/test_robot_compliance.py.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.linalg import eig, expm
from scipy.optimize import brentq

from robomill.fmus.in_process import InProcessSlave
from robomill.models.components.robot_compliance import MODEL as STATIC
from robomill.models.components.robot_compliance_dynamic import MODEL, VARIABLES
from robomill.models.model.declaration import FloatArray, Model, Record, record
from robomill.models.model.model_code import model_code
from robomill.models.robot.elastic_modes import ElasticMachine, elastic_modes, load_machine, machine_values, system_matrices
from robomill.orchestration.assembly import run
from robomill.orchestration.loop.acceleration import Iteration
from robomill.orchestration.slaves.protocol import PortData
from tests.orchestration.mocks import Mock, resolver, system
from tests.tolerances import EXACT, ROUNDOFF, discretisation, physics

H = 0.004
MILLING = np.deg2rad((0.0, -60.0, 100.0, 0.0, 50.0, 0.0))
KR210 = load_machine("kr210_2", "spindle_in_line")
FORCE, MOMENT = np.array([300.0, -200.0, 100.0]), np.array([5.0, 3.0, -9.0])
STATIC_LIMIT = 1e-9
"""Required: relative difference to robot_compliance at rest."""
RIGID = 1e96


def eighteen_springs() -> ElasticMachine:
    """Drives and both tilts of the thesis, no springs in the end effector: modes of FACTS10 10.5 up to 707 Hz."""
    stiffness = np.array(KR210.compliance.stiffness)
    stiffness[8:] = RIGID
    return replace(KR210, compliance=replace(KR210.compliance, stiffness=stiffness))


class Robot:
    """A record of a model with a machine, at a pose, initialised; further values by name."""

    def __init__(self, machine: ElasticMachine = KR210, model: Model = MODEL, **values: Any) -> None:
        self.data = model.new()
        for name, value in {**machine_values(machine), "q_link": MILLING, **values}.items():
            if name in self.data.dtype.names:
                self.data[name] = value
        self.s: Record = record(self.data)
        self.t = 0.0
        code = model_code(model)
        self._step = code.step
        assert code.init(self.data.ctypes.data) == 0

    def step(self, h: float = H) -> FloatArray:
        assert self._step(self.data.ctypes.data, self.t, h) == 0
        self.t += h
        return np.array(self.s.d_T_B)

    @property
    def tip(self) -> FloatArray:
        return np.concatenate([self.s.d_T_B, self.s.theta_T_B])

    def energy(self, M: FloatArray, K: FloatArray) -> float:
        n = len(K)
        x, v = self.s.elastic_angle[:n], self.s.elastic_rate[:n]
        return 0.5 * float(x @ K @ x + v @ M @ v)


def at_rest(**values: Any) -> tuple[Robot, Robot]:
    """The dynamic and the static robot under the same load."""
    return tuple(Robot(model=m, f_T_B=FORCE, m_T_B=MOMENT, **values) for m in (MODEL, STATIC))  # type: ignore[return-value]  # two


# ---------------------------------------------------------------------------------------- at rest


@pytest.mark.parametrize("seed", range(20))
def test_at_rest_it_is_robot_compliance(seed: int) -> None:
    rng = np.random.default_rng(seed)
    machine = replace(KR210, robot=replace(KR210.robot, axis_coupling=np.tril(rng.uniform(-0.5, 0.5, (6, 6)), -1)))
    values = {"q_link": rng.uniform(KR210.robot.q_min, KR210.robot.q_max), "f_T_B": rng.uniform(-750, 750, 3), "m_T_B": MOMENT}
    dynamic, static = (Robot(machine, m, **values) for m in (MODEL, STATIC))
    assert np.abs(dynamic.tip - static.tip).max() <= STATIC_LIMIT * np.abs(static.tip).max()
    for name in ("p_BT_B", "quat_BT"):
        np.testing.assert_allclose(getattr(dynamic.s, name), getattr(static.s, name), rtol=0.0, atol=10.0 * STATIC_LIMIT * 1e-3)


@pytest.mark.parametrize("v", [v for v in STATIC.variables if v.effect], ids=lambda v: v.name)
def test_at_rest_every_effect_of_robot_compliance_is_the_same(v: Any) -> None:
    dynamic, static = at_rest(**{v.name: 0.2 * v.maximum})
    assert np.abs(dynamic.tip - static.tip).max() <= STATIC_LIMIT * np.abs(static.tip).max()
    assert np.any(dynamic.tip != Robot(f_T_B=FORCE, m_T_B=MOMENT).tip) or v.name in ("thermal_growth",)


def test_after_the_vibration_it_is_robot_compliance() -> None:
    """Damped forty times as usual, so that 4 s are enough: exp(-0.4 pi 9.4 4)."""
    robot, static = Robot(damping_time=16e-3), at_rest()[1]
    robot.s.f_T_B[:], robot.s.m_T_B[:] = FORCE, MOMENT
    first = robot.step()
    for _ in range(1000):
        robot.step()
    assert np.abs(first - static.s.d_T_B).max() > 0.1 * np.abs(static.s.d_T_B).max()  # not there at once
    assert np.abs(robot.tip - static.tip).max() <= STATIC_LIMIT * np.abs(static.tip).max()


def test_weight_bends_nothing_unless_it_is_asked_for() -> None:
    """As in robot_compliance, the robot is calibrated under its own weight."""
    assert np.abs(Robot().tip).max() == EXACT
    sag = Robot(gravity_sag=1.0)
    assert -6e-3 < sag.s.d_T_B[2] < -1e-3
    # a payload that weighs 10 kg more: once as an error, whose weight always counts, once as payload of the sagging robot
    more = replace(KR210, tool=replace(KR210.tool, mass=KR210.tool.mass + 10.0))
    stiffness = np.array(KR210.compliance.stiffness)
    stiffness[8:] = RIGID  # robot_compliance does not bend the springs of the end effector by payload_error
    first, second = (replace(m, compliance=replace(m.compliance, stiffness=stiffness)) for m in (KR210, more))
    added = Robot(second, gravity_sag=1.0).s.d_T_B - Robot(first, gravity_sag=1.0).s.d_T_B
    error = Robot(first, payload_error=10.0).s.d_T_B
    # finite turns: the sum of deflections of 5 mm against their difference, angles of 3 mrad
    np.testing.assert_allclose(error, added, rtol=0.0, atol=physics(float(np.abs(error).max()), 0.01))


# ---------------------------------------------------------------------------------------- vibration


def released(machine: ElasticMachine, mode: int, h: float, steps: int, **values: Any) -> tuple[FloatArray, float]:
    """Modal coordinate of a mode that is let go from 1 at t = 0, at each step, and its frequency [Hz]."""
    modes = elastic_modes(machine, MILLING)
    M = system_matrices(machine, MILLING)[0]
    V = modes.coordinate_shape
    robot = Robot(machine, **values)
    n = len(V)
    robot.s.elastic_angle[:n] = LET_GO * V[:, mode]
    found = [1.0]
    for _ in range(steps):
        robot.step(h)
        found.append(float(V[:, mode] @ M @ robot.s.elastic_angle[:n]) / LET_GO)
    return np.array(found), float(modes.frequency[mode])


LET_GO = 1e-5
"""Modal coordinate at the beginning [m.sqrt(kg)]: some um at the tool."""


def exact(frequency: float, damping: float, t: FloatArray) -> FloatArray:
    w = 2.0 * np.pi * frequency
    wd = w * np.sqrt(1.0 - damping**2)
    return np.asarray(np.exp(-damping * w * t) * (np.cos(wd * t) + damping * w / wd * np.sin(wd * t)))


@pytest.mark.parametrize(("mode", "frequency"), [(0, 9.4), (2, 17.8), (5, 43.0)])
def test_43_hz_stay_43_hz_at_a_step_of_4_ms(mode: int, frequency: float) -> None:
    machine = eighteen_springs()
    steps = 100
    found, f = released(machine, mode, H, steps)
    assert f == pytest.approx(frequency, abs=physics(frequency, absolute=0.06))
    zeta = np.pi * f * float(machine.compliance.damping_time)
    t = H * np.arange(steps + 1)

    # frequency and damping that fit best, from the phase and decay of what came out
    def miss(p: FloatArray) -> float:
        return float(np.sum((found - exact(p[0], p[1], t)) ** 2))

    from scipy.optimize import minimize

    best = minimize(miss, [f, zeta], method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-16}).x
    assert best[0] == pytest.approx(f, abs=physics(f, 5e-4))
    # L-stable of order 3: 0.0259 (w t)^3 on top of the damping, t = 1 ms
    assert best[1] == pytest.approx(zeta, abs=1.5 * 0.0259 * (2.0 * np.pi * f * 1e-3) ** 3)


def test_order_of_convergence_is_three_in_the_substep() -> None:
    machine = eighteen_springs()
    steps = 25
    t = H * np.arange(steps + 1)
    errors = []
    for substep in (1e-3, 0.5e-3, 0.25e-3):
        found, f = released(machine, 5, H, steps, substep=substep)
        errors.append(np.abs(found - exact(f, np.pi * f * float(machine.compliance.damping_time), t)).max())
    assert np.all(np.abs(np.log2(np.array(errors[:-1]) / errors[1:]) - 3.0) <= ORDER)


ORDER = 0.3
"""What the next order leaves of a measured one."""


def test_what_swings_too_fast_follows_the_load_without_ringing() -> None:
    """The mode of 707 Hz, without damping: implicit midpoint would ring for ever; here it is gone after two steps."""
    found, f = released(eighteen_springs(), 17, H, 3, damping_time=0.0)
    assert f > 700.0
    assert np.all(np.abs(found[2:]) < 1e-2 * found[0])


def test_damping_that_is_not_proportional_is_exact() -> None:
    """Englert's D is diagonal, not diagonal in the modes: drives damped ten times as much as tilts, against the matrix exponential."""
    table = np.full((11, 3), 2e-4)
    table[:, 2] = 2e-3
    machine = eighteen_springs()
    machine = replace(machine, compliance=replace(machine.compliance, damping_time=table))
    M, D, K, J = system_matrices(machine, MILLING)
    n = len(K)
    inverse = np.linalg.inv(M)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ K, -inverse @ D]])
    over = expm(A * H)
    rest = np.linalg.solve(K, J.T @ np.r_[FORCE, MOMENT])
    robot, y = Robot(machine, substep=1.25e-4), np.r_[-rest, np.zeros(n)]
    robot.s.f_T_B[:], robot.s.m_T_B[:] = FORCE, MOMENT
    worst = 0.0
    for _ in range(50):
        robot.step()
        y = over @ y
        worst = max(worst, float(np.abs(J[:3] @ robot.s.elastic_angle[:n] - J[:3] @ (rest + y[:n])).max()))
    # stiff modes ring for some ms after the load falls on, which substeps of 0.125 ms see to 1e-3
    assert worst < 2e-3 * np.abs(J[:3] @ rest).max()


def test_energy_only_leaves() -> None:
    """E(t + h) - E(t) <= f (d(t + h) - d(t)): an L-stable method is contractive in the energy norm, with damping and without."""
    M, _, K, J = system_matrices(KR210, MILLING)
    n = len(K)
    for damping in (0.0, 4e-4):
        robot = Robot(damping_time=damping)
        rng = np.random.default_rng(8)
        before, lost = 0.0, 0.0
        x = np.zeros(n)
        for _ in range(200):
            robot.s.f_T_B[:], robot.s.m_T_B[:] = rng.uniform(-500, 500, 3), rng.uniform(-50, 50, 3)
            robot.step()
            moved = np.array(robot.s.elastic_angle[:n]) - x
            x += moved
            work = float(np.r_[robot.s.f_T_B, robot.s.m_T_B] @ J @ moved)
            after = robot.energy(M, K)
            assert after - before <= work + 1e3 * ROUNDOFF * max(after, before)
            lost += work - (after - before)
            before = after
        assert lost > 0.0


# ---------------------------------------------------------------------------------------- motion of the axes


def ride(h: float, substep: float, share: float = 1.0) -> FloatArray:
    """Displacement of T [m] at 0.2 s while axes 1 and 2 swing by 1e-4 rad: so little that the pose stays the same."""
    robot = Robot(eighteen_springs(), substep=substep, motion_excitation=share)
    d = np.zeros(3)
    for k in range(1, round(0.2 / h) + 1):
        robot.s.q_link[:2] = MILLING[:2] + 1e-4 * swing(k * h)
        d = robot.step(h)
    return d


def swing(t: float) -> FloatArray:
    """From rest with no jump in speed or acceleration: sin^3, about 5 and 4 Hz."""
    return np.array([np.sin(31.0 * t) ** 3, -(np.sin(25.0 * t) ** 3)])


def test_moving_axes_excite_the_modes_in_second_order() -> None:
    """Against M x.. + D x. + K x = -M_xq q.. with exact accelerations, by scipy: the motion of a drive is a turn of its spring."""
    from scipy.integrate import solve_ivp

    machine = eighteen_springs()
    M, D, K, J = system_matrices(machine, MILLING)
    n = len(K)
    drives = [elastic_modes(machine, MILLING).coordinates.index(f"A{i} drive") for i in (1, 2)]
    B = M[:, drives] * machine.robot.axis_sign[:2]
    inverse = np.linalg.inv(M)

    def rates(t: float, y: FloatArray) -> FloatArray:
        s, c = np.sin([31.0 * t, 25.0 * t]), np.cos([31.0 * t, 25.0 * t])
        w = np.array([31.0, 25.0])
        push = 1e-4 * np.array([1.0, -1.0]) * w**2 * (6.0 * s * c**2 - 3.0 * s**3)
        return np.r_[y[n:], inverse @ (-B @ push - D @ y[n:] - K @ y[:n])]

    expected = J[:3] @ solve_ivp(rates, (0.0, 0.2), np.zeros(2 * n), method="Radau", rtol=1e-8, atol=1e-12).y[:n, -1]
    errors = [np.abs(ride(h, 0.25e-3) - expected).max() for h in (4e-3, 2e-3, 1e-3)]
    assert np.abs(expected).max() > 1e-5
    assert errors[0] < discretisation(3e4 * np.abs(expected).max(), H, 2)  # C: (2 pi 31)^2, third harmonic of the swing
    assert np.all(np.abs(np.log2(np.array(errors[:-1]) / errors[1:]) - 2.0) <= 2.0 * ORDER)
    assert np.abs(ride(H, 1e-3, 0.0)).max() < 1e-2 * np.abs(expected).max()  # what is left are centrifugal forces


# ---------------------------------------------------------------------------------------- effects


def frequency_of(machine: ElasticMachine, **values: Any) -> tuple[float, float]:
    """Frequency [Hz] and damping ratio of the lowest mode from zeros and peaks of a free vibration in y of 2 s, in steps of 1 ms."""
    robot = Robot(machine, f_T_B=[0.0, 200.0, 0.0], **values)
    robot.s.f_T_B[:] = 0.0
    y = np.array([robot.step(1e-3)[1] for _ in range(2000)])[500:]
    crossings = np.flatnonzero((y[:-1] < 0.0) & (y[1:] >= 0.0))
    at = crossings - y[crossings] / (y[crossings + 1] - y[crossings])
    period = float((at[-1] - at[0]) / (len(at) - 1)) * 1e-3
    peaks = np.array([y[a : b + 1].max() for a, b in pairwise(crossings)])
    decrement = float(np.log(peaks[0] / peaks[-1]) / (len(peaks) - 1))
    return 1.0 / period, decrement / (2.0 * np.pi)


FIT = 0.01
"""Relative, of a frequency; 4 % of a damping ratio: the other modes of the same direction die out in the half second before."""


def only_axis_1() -> ElasticMachine:
    """Axis 1 alone is elastic: one mode."""
    stiffness = np.full((11, 3), RIGID)
    stiffness[0, 2] = KR210.compliance.stiffness[0, 2]
    return replace(KR210, compliance=replace(KR210.compliance, stiffness=stiffness))


def test_damping_error_scales_the_damping_and_nothing_else() -> None:
    (f0, zeta0), (f1, zeta1) = (frequency_of(only_axis_1(), damping_error=e) for e in (0.0, 0.5))
    assert f1 == pytest.approx(f0, rel=physics(1.0, 1e-3))
    assert zeta1 / zeta0 == pytest.approx(1.5, rel=4.0 * FIT)
    np.testing.assert_array_equal(at_rest(damping_error=0.5)[0].tip, at_rest()[0].tip)


def test_mode_frequency_error_moves_all_modes_and_no_stiffness() -> None:
    f0, f1 = (frequency_of(KR210, mode_frequency_error=e)[0] for e in (0.0, 0.1))
    assert f1 / f0 == pytest.approx(1.1, rel=FIT)
    np.testing.assert_array_equal(at_rest(mode_frequency_error=0.1)[0].tip, at_rest()[0].tip)


def test_tilt_stiffness_error_is_that_of_the_table() -> None:
    stiffness = np.array(KR210.compliance.stiffness)
    stiffness[3, :2] *= 0.7
    table = replace(KR210, compliance=replace(KR210.compliance, stiffness=stiffness))
    error = [0.0, 0.0, -0.3, 0.0, 0.0, 0.0]
    a, b = Robot(tilt_stiffness_error=error, f_T_B=FORCE), Robot(table, f_T_B=FORCE)
    np.testing.assert_allclose(a.tip, b.tip, rtol=1e3 * ROUNDOFF)
    assert np.abs(a.tip - Robot(f_T_B=FORCE).tip).max() > 0.01 * np.abs(a.tip).max()
    assert frequency_of(KR210, tilt_stiffness_error=error)[0] < frequency_of(KR210)[0]


def test_a_softer_drive_and_a_heavier_payload_swing_slower() -> None:
    f0 = frequency_of(only_axis_1())[0]
    soft = frequency_of(only_axis_1(), stiffness_error=[-0.19, 0.0, 0.0, 0.0, 0.0, 0.0])[0]
    assert soft / f0 == pytest.approx(0.9, rel=FIT)
    heavier = replace(only_axis_1(), tool=replace(KR210.tool, mass=KR210.tool.mass + 30.0))
    expected = elastic_modes(heavier, MILLING).frequency[0]
    assert frequency_of(only_axis_1(), payload_error=30.0)[0] == pytest.approx(expected, rel=FIT)


# ---------------------------------------------------------------------------------------- coupling with the process


class Cut(Mock):
    """A cut whose force is a gradient [N/m] times the displacement of the tool, in the mean over the step (milling_force) or at its end.

    A push of 1 N along y and z in the first 20 ms begins the vibration.
    """

    def __init__(self, gradient: FloatArray, mean: bool) -> None:
        ports = [PortData(f"d[{i}]", "input", unit="m", start=0.0) for i in (1, 2, 3)]
        ports += [PortData(f"f[{i}]", "output", unit="N", dependencies=("d[1]", "d[2]", "d[3]")) for i in (1, 2, 3)]
        self.before, share = np.zeros(3), 0.5 if mean else 0.0
        push = np.array([0.0, 1.0, 1.0])
        super().__init__("cut", ports, lambda u, t: list(gradient @ (share * self.before + (1.0 - share) * u) + (t < 0.02) * push))

    def step(self, t: float, h: float) -> None:
        super().step(t, h)
        self.before = self.u.copy()

    def get_state(self) -> Any:
        return super().get_state(), self.before.copy()

    def set_state(self, state: Any) -> None:
        super().set_state(state[0])
        self.before = state[1].copy()


def growth(machine: ElasticMachine, gradient: FloatArray, h: float, iterated: bool, seconds: float = 3.0) -> float:
    """Rate [1/s] at which the vibration of the robot in its cut grows; negative: it dies out."""
    robot = InProcessSlave(MODEL, "robot")
    robot.configure({k: np.asarray(v).tolist() for k, v in machine_values(machine).items()})
    slaves = [robot, Cut(gradient, mean=iterated)]
    connections = ("robot.d_T_B -> cut.d", f"cut.f {'->' if iterated else '=>'} robot.f_T_B")
    settings = Iteration(method="anderson", tolerance=1e-9)
    s = system(slaves, *connections, step=h, algorithm="iterated" if iterated else "gauss-seidel", iteration=settings)
    starts = {f"q_link[{i + 1}]": float(q) for i, q in enumerate(MILLING)}
    s = replace(s, components=tuple(replace(c, inputs=starts) if c.name == "robot" else c for c in s.components))
    size = np.linalg.norm(run(s, stop=seconds, resolver=resolver(slaves))["robot.d_T_B"], axis=1)
    third = len(size) // 3
    return float(np.log(size[-third:].max() / size[third : 2 * third].max()) / (seconds / 3.0))


def continuous(machine: ElasticMachine, gradient: FloatArray) -> tuple[float, float]:
    """Growth [1/s] and frequency [Hz] of the least stable mode of M x.. + D x. + (K - J^T P J) x = 0, without sampling."""
    M, D, K, J = system_matrices(machine, MILLING)
    n = len(K)
    one, none = np.eye(n), np.zeros((n, n))
    w = eig(np.block([[none, one], [J[:3].T @ gradient @ J[:3] - K, -D]]), np.block([[one, none], [none, M]]), right=False)
    w = w[np.abs(w) < 1e4]  # springs without mass have none
    worst = w[w.real.argmax()]
    return float(worst.real), float(abs(worst.imag) / (2.0 * np.pi))


def test_a_delayed_force_chatters_falsely_where_the_rule_says() -> None:
    """FACTS10 10.5: explicit coupling is unstable above k_process/k_robot = 4 zeta/(w h); 0.34 at 9.4 Hz, 2 %, 4 ms. It moves with h."""
    machine = only_axis_1()
    f = elastic_modes(machine, MILLING).frequency[0]
    machine = replace(machine, compliance=replace(machine.compliance, damping_time=0.02 / (np.pi * f)))
    _, _, K, J = system_matrices(machine, MILLING)
    along = J[:3, 0] / np.linalg.norm(J[:3, 0])
    k_robot = K[0, 0] / np.linalg.norm(J[:3, 0]) ** 2
    for h in (4e-3, 2e-3):
        limit = 4.0 * 0.02 / (2.0 * np.pi * f * h)
        # what the rule, of first order in w h, leaves
        below, above = (-r * limit * k_robot * np.outer(along, along) for r in (0.85, 1.15))
        assert growth(machine, below, h, iterated=False) < 0.0 < growth(machine, above, h, iterated=False)
    much = -3.0 * k_robot * np.outer(along, along)
    assert growth(machine, much, H, iterated=True) < 0.0


@pytest.mark.slow
def test_the_limit_of_mode_coupling_does_not_move_with_the_step() -> None:
    """A cut that turns its force by 70 deg from the displacement flutters from 145 N/mm on: iterated, at 4 and at 2 ms alike."""
    a, g = np.deg2rad((30.0, -40.0))
    direction = np.outer([0.0, np.cos(g), np.sin(g)], [0.0, np.cos(a), np.sin(a)])
    critical = brentq(lambda k: continuous(KR210, -k * direction)[0], 1.2e5, 1.7e5)
    assert critical == pytest.approx(1.45e5, abs=physics(1.45e5, absolute=500.0))
    for h in (4e-3, 2e-3):
        for share in (0.9, 1.1):
            expected = continuous(KR210, -share * critical * direction)[0]
            found = growth(KR210, -share * critical * direction, h, iterated=True, seconds=6.0)
            assert np.sign(found) == np.sign(expected)
            # modal growth is 0.6 and 0.9 1/s; h^2 of the trapezoidal rule at 10.9 Hz is 0.02 of 68 rad/s times the detuning
            assert found == pytest.approx(expected, abs=physics(1.0, absolute=0.15))
    assert growth(KR210, -0.9 * critical * direction, 4e-3, iterated=False, seconds=6.0) > 0.3  # false chatter


# ---------------------------------------------------------------------------------------- errors


def failure(step: bool = False, h: float = H, **values: Any) -> str:
    data = MODEL.new()
    for name, value in {**machine_values(KR210), "q_link": MILLING, **values}.items():
        if name in MODEL.dtype.names:
            data[name] = value
    s, code = record(data), model_code(MODEL)
    status = code.init(data.ctypes.data)
    if step and status == 0:
        if "jump" in values:
            s.q_link[0] += values["jump"]
        status = code.step(data.ctypes.data, 0.0, h)
    assert status != 0
    return MODEL.message(status, s, 0.0)


def test_robot_without_masses_is_refused() -> None:
    assert "the bodies of the robot weigh body_mass = [0. 0. 0. 0. 0. 0.] kg" in failure(body_mass=np.zeros(6))
    assert "name a robot with a file in models/data/dynamics" in failure(payload_error=-70.0)


def test_impossible_inertia_is_refused() -> None:
    assert "is not positive definite at elastic coordinate" in failure(step=True, body_inertia=np.full((6, 6), -500.0))


def test_axes_that_jump_are_refused_and_errors_of_the_static_robot_stay() -> None:
    assert "turns elastically by" in failure(step=True, jump=0.1)
    assert "the step size is 0.0 s, expected a positive one" in failure(step=True, h=0.0)
    assert "input 2 of (1: q_link, 2: f_T_B, 3: m_T_B, 4: f_turn_T_B, 5: m_turn_T_B)" in failure(f_T_B=np.full(3, np.nan))
    assert "stiffness in row 1 is -1.0 N.m/rad" in failure(stiffness=np.full((11, 3), -1.0))


def test_all_variables_of_the_static_robot_are_there() -> None:
    """The exchange by one line: the same ports, parameters and effects."""
    mine = {v.name: v for v in VARIABLES}
    assert all(mine[v.name] == v for v in STATIC.variables)
