"""The whole cell in one loop at a step of 1 ms: motion, flexure, cut at every step; sensor, controller and log every 4 ms."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from robomill.blind.second.arm import tip
from robomill.blind.second.control import Control, ControlState, control, waiting
from robomill.blind.second.cutting import Cut, CutState, cut, fresh
from robomill.blind.second.flexure import Flexure, FlexureState, at_rest, yielding
from robomill.blind.second.kernel import FloatArray, compiled
from robomill.blind.second.motion import Drive, DriveState, driven, longer, standing
from robomill.blind.second.path import Played
from robomill.blind.second.sensing import CYCLE, Sensor, SensorState, cleaned, felt, shown, unread
from robomill.blind.second.torque import Dynamics, torques

STEP = 0.001
PER = 4
"""Fine steps in a cycle."""
TRANSPORT = 3
"""Cycles between a correction and the drives (FACTS 7)."""


class Cell(NamedTuple):
    """All that a machine is."""

    flexure: Flexure
    drive: Drive
    cut: Cut
    sensor: Sensor
    control: Control
    dynamics: Dynamics
    inertia_steps: int
    """Fine steps over which the arm takes the mean of the force: it is too heavy for the teeth."""


class Log(NamedTuple):
    """What happened, every 4 ms, [n, ...]; the force is the mean over the cycle."""

    tip: FloatArray
    q_motor: FloatArray
    q: FloatArray
    wrench: FloatArray
    raw: FloatArray
    cleaned: FloatArray
    correction: FloatArray
    spindle_torque: FloatArray


@compiled
def _run(
    c: Cell,
    states: tuple[FlexureState, DriveState, CutState, SensorState, ControlState],
    raw_height: float,
    q: FloatArray,
    v: FloatArray,
    spindle: FloatArray,
    load: FloatArray,
    noise: FloatArray,
    chance: FloatArray,
    late_plan: FloatArray,
) -> tuple[FloatArray, ...]:
    flexure, drive, workpiece, sensor, controller = states
    n = (len(q) - 1) // PER + 1
    places, motors, plans = np.zeros((n, 3)), np.zeros((n, 6)), np.zeros((n, 6))
    wrenches, raws, clean, sent, spin = np.zeros((n, 6)), np.zeros((n, 6)), np.zeros((n, 6)), np.zeros((n, 3)), np.zeros(n)
    recent = np.zeros((c.inertia_steps, 6))
    wanted, total, torque = np.zeros(9), np.zeros(6), 0.0
    for k in range(len(q)):
        t = k * STEP
        cycle = (k - 1) // PER - TRANSPORT
        if k > 0 and cycle >= 0:
            wanted[:3] = sent[cycle]
        q_motor, link, plain = driven(c.drive, drive, t, STEP, late_plan[k], wanted)
        mean = np.zeros(6)
        for i in range(c.inertia_steps):
            mean += recent[i] / c.inertia_steps
        d, _, _ = yielding(c.flexure, flexure, t, STEP, link, mean[:3].copy(), mean[3:].copy())
        p, _ = tip(link, c.flexure.p_FT)
        p = p + d + longer(link, c.drive.p_FT, c.drive.geometry)
        f, m, spun = np.zeros(3), np.zeros(3), 0.0
        if k > 0:
            f, m, spun = cut(c.cut, workpiece, STEP, raw_height, p, v[k], spindle[k])
        for i in range(c.inertia_steps - 1):
            recent[i] = recent[i + 1]
        recent[c.inertia_steps - 1, :3], recent[c.inertia_steps - 1, 3:] = f, m
        total += recent[c.inertia_steps - 1]
        recent[c.inertia_steps - 1] += load[k]
        torque += spun
        if k % PER == 0:
            j, share = k // PER, 1.0 / PER if k > 0 else 1.0
            wrenches[j] = total * share + load[k]  # the teeth are averaged, what is applied on purpose is slow
            now, R = felt(c.sensor, sensor, q_motor, wrenches[j, :3] + noise[j, 6:9], wrenches[j, 3:] + noise[j, 9:])
            raws[j] = shown(c.sensor, sensor, t, now, noise[j, :6])
            clean[j] = cleaned(c.sensor, sensor, raws[j], R)
            sent[j] = control(c.control, controller, q_motor, clean[j], v[k], chance[j])
            places[j], motors[j], plans[j], spin[j] = p, q_motor, plain, torque * share
            total[:], torque = 0.0, 0.0
    return places, motors, plans, wrenches, raws, clean, sent, spin


def simulate(
    c: Cell, path: Played, late_plan: FloatArray, raw_height: float, noise: FloatArray, chance: FloatArray, load: FloatArray
) -> Log:
    """A run of the cell.

    `late_plan` [n,6] are the axes as the drives follow them, `raw_height` [m] that of the uncut block, `noise` [cycles,12] reading of the
    sensor and wrench before it, `chance` [cycles,2] uniform numbers, `load` [n,6] wrench on the tool [N, N m] besides the cut.
    """
    workpiece = fresh(c.cut.size)
    workpiece.top[:] = raw_height
    states = (at_rest(), standing(late_plan[0], c.drive.half_gap), workpiece, unread(), waiting())
    places, motors, plans, wrenches, raws, clean, sent, spin = _run(
        c, states, raw_height, path.q, path.v, path.spindle, load, noise, chance, late_plan
    )
    return Log(places, motors, plans, wrenches, raws, clean, sent, spin)


def shaft_torques(c: Cell, log: Log) -> FloatArray:
    """Motor torques [n,6] N m; the wrench is that of the cycle before."""
    before = np.vstack([np.zeros((1, 6)), log.wrench[:-1]])
    found: FloatArray = torques(c.dynamics, log.q, log.q_motor, before, CYCLE)
    return found
