"""Iterated coupling on the real loop: the robot gives way to the cutting force, which depends on where it is."""

from __future__ import annotations

import math

import numpy as np
import pytest

from robomill.fmus.in_process import InProcessSlave
from robomill.models.components.milling_force import MODEL as MILLING
from robomill.models.components.robot_compliance import MODEL as COMPLIANCE
from robomill.orchestration.assembly import run
from robomill.orchestration.loop.acceleration import Iteration
from robomill.orchestration.slaves.protocol import PortData
from tests.orchestration.mocks import Mock, resolver, system
from tests.tolerances import ROUNDOFF, discretisation

STOP = 0.3
FEED = (-0.025, 0.0, 0.0)
FROM = np.array([0.0, -1.95515755, 2.23519434, 0.0, -0.280036790, 0.0])  # tool at (1.3585, 0, 1.1883) m, 0.5 mm before the block
TO = np.array([0.0, -1.97697834, 2.24685805, 0.0, -0.269879710, 0.0])  # 20 mm further along -x; a full slot 3.3 mm deep
BLOCK = {"p_BP_B": [1.3, 0.0, 1.2], "quat_BP": [0.0, 0.0, 0.0, 1.0], "block_size": [0.1, 0.06, 0.03]}
TOOTH_PER_MILLISECOND = 2.0 * math.pi * 1000.0 / 3.0
"""Spindle speed [rad/s] at which a step of 1, 2 or 4 ms holds whole tooth periods: the mean force is smooth in time."""


def mill(h, algorithm, delayed=False, loop="auto", stop=STOP, runout=0.0, spindle=TOOTH_PER_MILLISECOND, turns=True, **settings):
    """The tool goes into the block on a straight line, the robot gives way; without `turns` to each turn of the spindle, too."""
    ports = [PortData(f"q[{i}]", "output", unit="rad", dependencies=()) for i in range(1, 7)]
    ports += [PortData(f"v[{i}]", "output", unit="m/s", dependencies=()) for i in range(1, 4)]
    ports += [PortData("n", "output", unit="rad/s", dependencies=())]
    path = Mock("path", ports, lambda u, t: [*(FROM + (TO - FROM) * t / 0.8), *FEED, spindle])
    compliance, milling = InProcessSlave(COMPLIANCE, "compliance"), InProcessSlave(MILLING, "milling")
    milling.configure(BLOCK | {"runout": runout})
    back = "=>" if delayed else "->"
    connections = (
        "path.q -> compliance.q_link",
        "path.v -> milling.v_BT_B",
        "path.n -> milling.spindle_speed",
        "compliance.p_BT_B -> milling.p_BT_B",
        "compliance.quat_BT -> milling.quat_BT",
        f"milling.f_T_B {back} compliance.f_T_B",
        f"milling.m_T_B {back} compliance.m_T_B",
    )
    if turns:
        connections += tuple(f"milling.{part} {back} compliance.{part}" for part in ("f_turn_T_B", "m_turn_T_B"))
    slaves = [path, compliance, milling]
    s = system(slaves, *connections, step=h, algorithm=algorithm, iteration=Iteration(**settings))
    return run(s, stop=stop, resolver=resolver(slaves), loop=loop)


def at_4_ms(r, h):
    return r["compliance.d_T_B"][:: round(0.004 / h)]


class TestMillingLoop:
    """compliance <-> milling."""

    def test_delay_costs_a_step_and_iteration_saves_it(self):
        """The force is the mean over the step and belongs to its middle: iterated, the robot is half a step late, delayed 1.5."""
        steps = (0.004, 0.002, 0.001)
        iterated = {h: at_4_ms(mill(h, "iterated", method="anderson", tolerance=1e-10), h) for h in steps}
        delayed = {h: at_4_ms(mill(h, "gauss-seidel", delayed=True), h) for h in steps}
        assert np.max(np.abs(iterated[0.001])) > 3e-4  # the robot does give way
        limit = 2.0 * iterated[0.001] - iterated[0.002]
        half, more = (np.array([np.sqrt(np.mean((found[h] - limit) ** 2)) for h in steps]) for found in (iterated, delayed))
        assert half[-1] > 1e-7
        for errors in (half, more):
            assert np.all(np.abs(np.log2(errors[:-1] / errors[1:]) - 1.0) <= 0.15)
        assert more / half == pytest.approx(3.0, abs=discretisation(10.0, 0.004, 1))  # C: the force turns within some 0.1 s

    @pytest.mark.parametrize("method", ["aitken", "anderson"])
    def test_both_methods_find_the_same_solution_in_few_rounds(self, method):
        r = mill(0.004, "iterated", method=method, tolerance=1e-10)
        reference = mill(0.004, "iterated", method="fixed-point", relaxation=0.5, tolerance=1e-12, max_iterations=200)
        scale = np.max(np.abs(reference["milling.f_T_B"]))
        assert np.max(np.abs(r["milling.f_T_B"] - reference["milling.f_T_B"])) <= 1e-8 * scale
        assert r["master.iterations"].max() <= 12
        assert r["master.iterations"].mean() < 0.5 * reference["master.iterations"].mean()

    @pytest.mark.parametrize("method", ["aitken", "anderson"])
    def test_compiled_loop_gives_the_same_bits(self, method):
        """The path is called back in Python, the others are stepped by compiled code from copies of their records."""
        a, b = (mill(0.004, "iterated", method=method, tolerance=1e-10, stop=0.16, loop=kind) for kind in ("python", "compiled"))
        assert a["master.iterations"].max() > 2
        assert a.t.tobytes() == b.t.tobytes()
        assert all(a[name].tobytes() == b[name].tobytes() for name in a.columns)

    def test_displacement_and_force_belong_together_at_every_recorded_time(self):
        r = mill(0.004, "iterated", tolerance=1e-12)
        alone = InProcessSlave(COMPLIANCE, "alone")
        alone.initialise(0.0, 1.0, 0.004)
        d = np.zeros(len(alone.interface.outputs))
        q = FROM + (TO - FROM) * r.t[:, None] / 0.8
        for k in range(1, len(r.t)):
            alone.set_inputs(np.concatenate([q[k], r["milling.f_T_B"][k], r["milling.m_T_B"][k], np.zeros(6)]))
            alone.step(r.t[k - 1], 0.004)
            alone.get_outputs(d)
            found = r["compliance.d_T_B"][k]
            assert np.max(np.abs(d[:3] - found)) <= 10 * ROUNDOFF * np.max(np.abs(r["compliance.d_T_B"])), k

    def test_what_a_runout_does_to_the_mean_does_not_depend_on_the_step(self):
        """A robot that followed the spindle (10 000 rev/min, two turns in 12 ms) would follow another part of it at each step."""

        def mean(h, turns):
            """What a runout adds to the mean over two turns [m], the robot's along the feed."""
            spindle = 10_000 * 2.0 * math.pi / 60.0
            off, true = (
                mill(h, "gauss-seidel", delayed=True, runout=runout, spindle=spindle, turns=turns)["compliance.d_T_B"]
                for runout in (4e-5, 0.0)
            )
            return (off - true)[1:].reshape(25, -1, 3).mean(axis=1)[12:]

        coarse, fine = mean(0.004, turns=True), mean(0.002, turns=True)
        assert np.abs(coarse - fine).max() < 0.05 * np.abs(fine).max()
        coarse, fine = mean(0.004, turns=False), mean(0.002, turns=False)
        assert np.abs(coarse - fine).max() > 0.2 * np.abs(fine).max()
