"""Rigid bodies on virtual joints and their motion, against Pinocchio, closed forms and the laws of mechanics."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from robomill.models.model.declaration import FloatArray, Record
from robomill.models.robot.dynamics import inertia_matrix
from robomill.models.robot.elastic_bodies import FIRST_BODY, couple_forces, inertia_force, mass_matrix, place_bodies
from robomill.models.robot.elastic_modes import ElasticMachine, elastic_robot, load_machine
from robomill.models.robot.virtual_joints import DRIVES, JOINTS, joint_frame, virtual_joints
from tests.tolerances import ROUNDOFF

PINOCCHIO = 1e-9
"""Relative to the largest element: required of M, C and G; both sides sum some hundred products."""


def coupled_machine() -> ElasticMachine:
    """The KR 300, 30 elastic coordinates, whose axes 2, 4 and 5 also turn joints behind them, with a tool in no symmetric place."""
    whole = load_machine("kr300_r2500_ultra", "spindle_across")
    coupling = np.zeros((6, 6))
    coupling[2, 1], coupling[4, 3], coupling[5, 3], coupling[5, 4] = -1.0, 0.3, -0.2, 0.7
    robot = replace(whole.robot, axis_coupling=coupling)
    return replace(whole, robot=robot, tool=replace(whole.tool, p_FG_F=np.array([0.06, -0.03, 0.2])))


def pose(s: Record, q: FloatArray) -> None:
    virtual_joints(s, q)
    place_bodies(s)


def pinocchio_chain(s: Record, q: FloatArray) -> tuple[Any, Any, dict[tuple[int, int], int]]:
    """The robot with all virtual joints as joints of their own, from frames and bodies only; model, data, (joint, axis) -> index.

    The elastic angles are zero in this pose: axis angles and elastic turns are those of the joints from here on.
    """
    model = pin.Model()
    model.gravity.linear = np.array(s.gravity_B)
    place = pin.SE3.Identity()
    parent = 0
    index = {}
    frames = [joint_frame(j) for j in range(JOINTS)]
    for j in range(JOINTS):
        here = pin.SE3(np.array(s.frame_R[frames[j]]), np.array(s.frame_p[frames[j]]))
        step = place.actInv(here)
        for c, joint in ((2, pin.JointModelRZ()), (1, pin.JointModelRY()), (0, pin.JointModelRX())):
            parent = model.addJoint(parent, joint, step, f"{j}{c}")
            index[j, c] = model.joints[parent].idx_v
            step = pin.SE3.Identity()
        place = here
        for b in range(7):
            last = max(k for k in range(JOINTS) if FIRST_BODY[k] <= b)
            if last != j:
                continue
            r = min(b, 5)
            link = pin.SE3(np.array(s.link_R[r]), np.array(s.link_p[r]))
            if b < 6:
                inertia = pin.Inertia(float(s.body_mass[b]), np.array(s.body_com[b]), inertia_matrix(s.body_inertia[b]))
            else:
                inertia = pin.Inertia(float(s.payload_mass), np.array(s.payload_com_F), inertia_matrix(s.payload_inertia))
            model.appendBodyToJoint(parent, inertia, here.actInv(link))
    return model, model.createData(), index


def turns(s: Record, qd: FloatArray, rate: FloatArray, index: dict[tuple[int, int], int]) -> FloatArray:
    """Rates of all joints of the chain from those of the axes and of the elastic coordinates; written out with the coupling."""
    total = np.zeros(3 * JOINTS)
    n = s.elastic_count
    for k in range(n):
        total[index[s.elastic_joint[k], s.elastic_axis[k]]] += rate[k]
    own = np.array([rate[s.elastic_drive[i]] for i in range(6)])
    motor = np.asarray(qd) + s.axis_sign * own
    for i in range(6):
        total[index[DRIVES[i], 2]] = s.axis_sign[i] * motor[i] + s.axis_coupling[i] @ motor
    return total


@pytest.mark.parametrize(("name", "states"), [("kr210", 5), pytest.param("kr300 coupled", 100, marks=pytest.mark.slow)])
def test_mass_matrix_coriolis_and_weight_are_those_of_pinocchio(name: str, states: int) -> None:
    machine = load_machine("kr210_2", "spindle_in_line") if name == "kr210" else coupled_machine()
    s = elastic_robot(machine)
    n = int(s.elastic_count)
    assert n == (24 if name == "kr210" else 30)
    rng = np.random.default_rng(20)
    for _ in range(states):
        q = rng.uniform(machine.robot.q_min, machine.robot.q_max)
        qd, qdd = rng.uniform(-2.0, 2.0, 6), rng.uniform(-8.0, 8.0, 6)
        rate = rng.uniform(-1.0, 1.0, 33)
        pose(s, q)
        model, data, index = pinocchio_chain(s, q)
        # columns of what an elastic coordinate turns
        T = np.stack([turns(s, np.zeros(6), np.eye(33)[k], index) for k in range(n)], axis=1)
        M = T.T @ pin.crba(model, data, np.zeros(33)) @ T
        v = turns(s, qd, rate, index)
        a = turns(s, qdd, np.zeros(33), index)
        for gravity in (0.0, 1.0):
            inertia_force(s, qd, qdd, rate, gravity)
            model.gravity.linear = gravity * np.array(s.gravity_B)
            expected = T.T @ pin.rnea(model, data, np.zeros(33), v, a)
            np.testing.assert_allclose(s.elastic_force[:n], expected, rtol=0.0, atol=PINOCCHIO * np.abs(expected).max())
        mass_matrix(s)
        np.testing.assert_allclose(s.elastic_M[:n, :n], M, rtol=0.0, atol=PINOCCHIO * np.abs(M).max())


def test_coriolis_forces_do_no_work() -> None:
    """d/dt (1/2 v^T M v) = v^T (f - C v): with the bodies in free fall without weight, power of C equals that of the change of M."""
    s = elastic_robot(coupled_machine())
    n = int(s.elastic_count)
    rng = np.random.default_rng(3)
    q, qd = rng.uniform(s.q_min, s.q_max), rng.uniform(-2.0, 2.0, 6)
    # axes alone, carried by rates of their drives: kinetic energy of the moving robot, and its change along q
    rate = np.zeros(33)
    for i in range(6):
        rate[s.elastic_drive[i]] = s.axis_sign[i] * qd[i]

    def energy(t: float) -> float:
        pose(s, q + t * qd)
        mass_matrix(s)
        return 0.5 * float(rate[:n] @ s.elastic_M[:n, :n] @ rate[:n])

    pose(s, q)
    inertia_force(s, qd, np.zeros(6), np.zeros(33), 0.0)
    power = float(s.elastic_force[:n] @ rate[:n])
    e = 1e-4
    change = (8.0 * (energy(e) - energy(-e)) - (energy(2 * e) - energy(-2 * e))) / (12.0 * e)
    assert power == pytest.approx(change, rel=DIFFERENCE)


DIFFERENCE = 1e-7
"""A central difference of order 4 over 1e-4 s: roundoff of an energy of some 100 J over 1e-4 s."""


def test_forces_of_coupled_axes_do_the_work_of_their_joints() -> None:
    s = elastic_robot(coupled_machine())
    n = int(s.elastic_count)
    rng = np.random.default_rng(4)
    moment, rate = np.zeros(33), np.zeros(33)
    moment[:n], rate[:n] = rng.uniform(-1.0, 1.0, n), rng.uniform(-1.0, 1.0, n)
    index = {(int(s.elastic_joint[k]), int(s.elastic_axis[k])): k for k in range(n)}
    on_drives = np.array(moment)
    couple_forces(s, on_drives)
    joints = turns(s, np.zeros(6), rate, index)
    assert float(on_drives @ rate) == pytest.approx(float(moment @ joints), rel=10.0 * ROUNDOFF)
