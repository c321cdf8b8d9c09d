"""The limit that a simulation finds must be that of the machine: how force and displacement are exchanged (FACTS10 10.5)."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from robomill.fmus.in_process import InProcessSlave
from robomill.models.components.robot_compliance import MODEL as COMPLIANCE
from robomill.models.process.stability import coupling
from robomill.models.process.stability.coupling import EXPLICIT, ITERATED, LINEAR, simulated_gain
from robomill.models.process.stability.modes import Modes, from_stiffness
from robomill.orchestration.assembly import run
from robomill.orchestration.loop.acceleration import Iteration
from robomill.orchestration.slaves.protocol import PortData
from tests.orchestration.mocks import Mock, resolver, system
from tests.tolerances import ROUNDOFF, physics

STEPS = (0.004, 0.002, 0.001, 0.0005)
ONE = from_stiffness([9.4], [0.02], [1e6], [[0, 1, 0]])
RESTORING = -np.diag([0.0, 1.0, 0.0])


def _pair() -> tuple[Modes, np.ndarray]:
    """FACTS 4.2: two robot modes that couple at 170.1 N/mm, and the direction of that force."""
    mass, k, a, g = 150.0, np.array([0.5e6, 0.8e6]), math.radians(60), math.radians(-35)
    modes = from_stiffness(np.sqrt(k / mass) / (2 * math.pi), [0.02] * 2, k, [[1, 0, 0], [0, 0, 1]])
    return modes, -np.outer([math.cos(g), 0, math.sin(g)], [math.cos(a), 0, math.sin(a)])


def test_an_iterated_force_that_moves_over_the_step_finds_the_limit_of_the_machine():
    """Second order: 0.6 % of the flutter gain at 4 ms, a quarter of that at half the step."""
    modes, G = _pair()
    exact, _ = coupling.critical_gain(modes, G, 5e6)
    errors = [abs(simulated_gain(modes, G, h, LINEAR, 1e6) / exact - 1.0) for h in STEPS]
    assert errors[0] < 0.01
    # C of the first two; 60 rad/s times 4 ms is 0.25, so the next order leaves a tenth
    assert math.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=physics(2.0, relative=0.1))


def test_a_force_held_over_the_step_moves_the_limit():
    """Explicit: 14 % less than there is at 4 ms, of first order; iterated but held: 8 %."""
    modes, G = _pair()
    exact, _ = coupling.critical_gain(modes, G, 5e6)
    explicit = [1.0 - simulated_gain(modes, G, h, EXPLICIT, 1e6) / exact for h in STEPS]
    assert explicit[0] > 0.1
    assert all(1.5 < a / b < 3.0 for a, b in pairwise(explicit))
    held = 1.0 - simulated_gain(modes, G, STEPS[0], ITERATED, 1e6) / exact
    assert 0.05 < held < explicit[0]


def test_a_spring_that_pushes_back_never_chatters_but_explicitly():
    """FACTS10 10.5: 0.34 at 9.4 Hz, 2 %, 4 ms; the machine itself has no limit."""
    assert simulated_gain(ONE, RESTORING, 0.004, EXPLICIT, 2e6) / 1e6 == pytest.approx(
        coupling.explicit_limit(9.4, 0.02, 0.004), rel=1e6 * ROUNDOFF
    )
    for scheme in (ITERATED, LINEAR):
        assert simulated_gain(ONE, RESTORING, 0.004, scheme, 2e6) == math.inf
    assert coupling.critical_gain(ONE, RESTORING, 2e6)[0] == math.inf
    with pytest.raises(ValueError, match="there are 'explicit', 'iterated', 'linear'"):
        coupling.exchange_transition(ONE, RESTORING, 0.004, "guess")


def _swing(ratio: float, algorithm: str, h: float = 0.004) -> float:
    """Largest deflection in the last second over that in the first of 6 s: robot_compliance with one mode, the master, a spring."""
    ports = [PortData(f"q[{i}]", "output", unit="rad", dependencies=()) for i in range(1, 7)]
    q = [0.0, -1.0, 1.7, 0.0, 0.87, 0.0]
    path = Mock("path", ports, lambda u, t: q)
    robot = InProcessSlave(COMPLIANCE, "robot")
    robot.configure({"mode_compliance": 1e-6, "mode_frequency": 9.4, "mode_damping": 0.02, "stiffness": np.full((11, 3), 1e15)})
    spring = Mock(
        "spring",
        [PortData("d", "input", unit="m"), PortData("f", "output", unit="N", dependencies=("d",))],
        lambda u, t: [-ratio * 1e6 * u[0] + (100.0 if t < 0.01 else 0.0)],
    )
    back = "=>" if algorithm != "iterated" else "->"
    connections = ("path.q -> robot.q_link", "robot.d_T_B[2] -> spring.d", f"spring.f {back} robot.f_T_B[2]")
    slaves = [path, robot, spring]
    s = system(slaves, *connections, step=h, algorithm=algorithm, iteration=Iteration(method="anderson", tolerance=1e-10))
    d = np.abs(run(s, stop=6.0, resolver=resolver(slaves))["robot.d_T_B"][:, 1])
    second = round(1.0 / h)
    return float(d[-second:].max() / d[second : 2 * second].max())


@pytest.mark.paper
def test_the_master_shows_the_false_limit_with_a_delay_and_none_iterated():
    """FACTS10 10.5: .34 at 9.4 Hz, 2 %, n = 0: calm at .32, chatter at .36; iterated, calm at three times that."""
    assert _swing(0.32, "gauss-seidel") < 1.0
    assert _swing(0.36, "gauss-seidel") > 1.0
    for ratio in (0.36, 1.0):
        assert _swing(ratio, "iterated") < 1.0
        assert _swing(ratio, "iterated", 0.002) < 1.0


def test_a_shorter_step_moves_the_false_limit_up():
    """4 zeta/(w h): 0.68 at 2 ms, so 0.36 is calm there."""
    assert _swing(0.36, "gauss-seidel", 0.002) < 1.0
