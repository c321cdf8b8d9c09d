"""Inputs of the golden results: a short piece of the work of each component, written out without the help of the others."""

from __future__ import annotations

from typing import Any

import numpy as np

from robomill.fmus.interface import Interface
from robomill.models.model.declaration import FloatArray
from robomill.models.planning import gcode
from robomill.models.planning.segment_table import BLOCK, TOOL
from robomill.models.planning.trajectory import Placement, plan
from tests.fmus.golden import H

STEPS = 100
T = H * np.arange(STEPS)[:, None]
Q = np.array([0.05, -1.6, 2.05, 0.1, -0.4, -0.08])
"""Axis angles [rad] well inside of the limits, wrist away from its singularity."""
FORCE = np.array([-120.0, 380.0, 60.0])
MOMENT = np.array([4.0, -2.5, 9.0])
GROOVE = 13000.0 * 2.0 * np.pi / 60.0


def _rise(start: float, duration: float) -> FloatArray:
    """0 before `start` [s], 1 after `start + duration`, straight in between."""
    return np.clip((T - start) / duration, 0.0, 1.0)


def _axes() -> FloatArray:
    return Q + np.array([0.02, -0.015, 0.01, 0.03, -0.02, 0.025]) * np.sin(2.0 * np.pi * T * np.array([1.0, 1.5, 2.0, 2.5, 3.0, 0.5]))


def _force() -> FloatArray:
    return FORCE * _rise(0.06, 0.08) * (1.0 - 0.8 * _rise(0.3, 0.02)) * (1.0 + 0.1 * np.sin(2.0 * np.pi * 9.0 * T))


def _moment() -> FloatArray:
    return MOMENT * _rise(0.06, 0.08)


def _turning(load: FloatArray) -> FloatArray:
    """What an offset cutter adds within a turn of the spindle."""
    return 0.2 * load * np.sin(2.0 * np.pi * 83.0 * T)


def _mill_pose() -> FloatArray:
    """Into the block from -x, 4 mm deep, bent aside by up to 0.4 mm."""
    tip = np.hstack([-0.062 + 0.06 * T, 4e-4 * _rise(0.1, 0.2) * np.sin(2.0 * np.pi * 9.0 * T), np.full_like(T, -0.004)])
    return tip + np.array([1.595, -0.018, 1.099])


def stimulus(name: str) -> tuple[dict[str, FloatArray], dict[str, Any]]:
    """Inputs by declared variable, each (STEPS, elements), those not named at their starts; parameters by name, tables as arrays."""
    feed = np.array([0.02, 0.015, 0.0]) * _rise(0.0, 0.03)
    segments, pilot = _program()
    return {
        "path_interpolator": (
            {"speed_ratio": 1.0 + 0.5 * _rise(0.1, 0.05) - 0.1 * _rise(0.2, 0.05)},
            {"segments": segments, "pilot": pilot, "override_error": 0.02},
        ),
        "robot_drive": (
            {
                "q_ref": _axes(),
                "correction_B": np.array([2e-4, -6e-4, 1e-4]) * _rise(0.1, 0.1),
                "correction_q": np.array([0.0, 1e-4, -2e-4, 0.0, 3e-4, 0.0]) * _rise(0.2, 0.05),
                "f_T_B": _force(),
                "m_T_B": _moment(),
            },
            {
                "backlash": [1e-4, 5e-5, 5e-5, 1e-4, 1e-4, 2e-4],
                "tracking_lag": 0.01,
                "friction_coulomb": [100.0, 120.0, 90.0, 20.0, 20.0, 10.0],
            },
        ),
        "robot_compliance": (
            {"q_link": _axes(), "f_T_B": _force(), "m_T_B": _moment(), "f_turn_T_B": _turning(_force()), "m_turn_T_B": _turning(_moment())},
            {
                "gear_hysteresis": [1e-4] * 6,
                "gear_friction": [70.0] * 6,
                "tool_compliance": 2e-7,
                "mode_compliance": 1e-6,
                "payload_error": 5.0,
            },
        ),
        "robot_compliance_dynamic": (
            {"q_link": _axes(), "f_T_B": _force(), "m_T_B": _moment(), "f_turn_T_B": _turning(_force()), "m_turn_T_B": _turning(_moment())},
            {
                "gear_hysteresis": [1e-4] * 6,
                "tilt_stiffness_error": [-0.3, 0.25, 0.15, -0.12, 0.4, -0.25],
                "damping_error": 0.7,
                "mode_frequency_error": -0.07,
                "gravity_sag": 0.5,
            },
        ),
        "milling_force": (
            {
                "p_BT_B": _mill_pose(),
                "v_BT_B": np.array([0.06, 0.0, 0.0]) * np.ones_like(T),
                "spindle_speed": np.full_like(T, GROOVE),
            },
            {"runout": 1e-5, "tool_wear": 0.1, "block_size": [0.1, 0.03, 0.03]},
        ),
        "sensor_chain": (
            {"f_T_B": _force(), "m_T_B": _moment(), "q": _axes()},
            {"cross_talk": 0.01, "extra_lag": 0.008, "misalignment": [0.01, -0.02, 0.015], "weight_error": 1.0},
        ),
        "compensation_controller": (
            {
                "f_T_T": np.array([-0.1, -0.9, 0.3]) * np.linalg.norm(_force(), axis=1, keepdims=True),
                "m_T_T": _moment(),
                "f_pilot_B": 1.05 * FORCE * _rise(0.03, 0.06) * (1.0 - _rise(0.27, 0.02)),
                "q_motor": _axes(),
                "v_BT_B": feed,
            },
            {"mode": 2, "pilot": True, "ki": [0.5, 0.5, 0.5], "dead_band": 5.0},
        ),
        "inverse_dynamics": (
            {"q": _axes(), "f_T_B": _force(), "m_T_B": _moment()},
            {
                "differentiate": True,
                "payload_mass_error": 30.0,
                "friction_coulomb": [100.0, 120.0, 90.0, 20.0, 20.0, 10.0],
                "friction_load": [0.05, 0.0, 0.02, 0.0, 0.01, 0.0],
                "torque_ripple_cos": [0.6, -0.5, 0.4, 0.05, 0.04, 0.03],
                "joint_compliance": [2e-7, 1.4e-7, 2.5e-7, 1e-6, 1e-6, 2e-6],
                "backlash": [3e-5, 0.0, 3e-5, 0.0, 3e-5, 0.0],
                "torque_lag": 0.009,
                "encoder_lag": 0.003,
            },
        ),
        "speed_loop": (
            {"speed_ratio": 1.0 - 0.7 * _rise(0.05, 0.0041) + 0.4 * _rise(0.2, 0.05)},
            {"candidate": 3, "dead_time": 0.00983, "feed_rate": 2.0, "extra_lag": 0.001},
        ),
        "power_law_force": (
            {
                "feed": 0.03 - 0.02 * _rise(0.1, 0.1),
                "v_BT_B": np.array([0.02, 0.02, 0.0]) * np.ones_like(T),
                "dexel_depth": 5e-4 * _rise(0.2, 0.05),
                "dexel_removal_rate": 1e-6 * _rise(0.3, 0.02),
            },
            {
                "profile": np.array([[0.0, 0.0, 0.05], [0.002, 0.0, 0.05], [0.004, 0.002, 0.04], [0.006, 0.001, 0.05]]),
                "width_exponent": 0.3,
                "shares": [1.0, 0.5, -0.1],
                "torque_arm": 0.0375,
                "skin_noise": 1e-4,
                "force_noise": 3.0,
                "force_filter": 0.01,
                "depth_exponent_error": 0.04,
            },
        ),
        "rate_controller": (
            # into the part, a step of its depth, out of it; the feed follows the force
            {
                "force": 126.0 * _rise(0.06, 0.02)
                + 150.0 * _rise(0.12, 0.02) * (1.0 + 0.1 * np.sin(2.0 * np.pi * 15.0 * T))
                - 276.0 * _rise(0.36, 0.01),
                "feed": 0.03 * _rise(0.0, 0.03) - 0.01 * _rise(0.16, 0.04) * (1.0 + 0.2 * np.sin(2.0 * np.pi * 15.0 * T)),
            },
            {"start_time": 0.02},
        ),
        "deformation_compensation": (
            {
                "f_T_T": np.array([-0.1, -0.9, 0.3]) * np.linalg.norm(_force(), axis=1, keepdims=True),
                "m_T_T": _moment(),
                "q_motor": _axes(),
                "v_BT_B": feed,
            },
            {"filter_time": 0.02, "stiffness_table_error": [0.1, -0.1, 0.05, 0.0, 0.2, 0.0]},
        ),
        "face_milling_force": (
            {
                "p_BT_B": _mill_pose() + np.array([-0.02, 0.0, 0.0]),
                "v_BT_B": np.array([0.06, 0.0, 0.0]) * np.ones_like(T),
                "spindle_speed": np.full_like(T, 377.0),
            },
            {"block_size": [0.1, 0.05, 0.03], "spacing": 1e-3, "opening_diameter": 0.02, "opening_pitch": [0.05, 0.05], "force_error": 0.1},
        ),
        "tridexel_milling_force": (
            # a tilted bull nose that meets a corner of the block in the last steps: plain Python takes a second for each
            {
                "p_BT_B": np.hstack([-0.035 + 0.06 * T, np.full_like(T, 0.002), np.full_like(T, -0.0012)])
                + np.array([1.595, -0.018, 1.099]),
                "quat_BT": np.array([0.66, 0.08, 0.74, 0.05]) / np.linalg.norm([0.66, 0.08, 0.74, 0.05]) * np.ones_like(T),
                "v_BT_B": np.array([0.06, 0.0, 0.0]) * np.ones_like(T),
                "spindle_speed": np.full_like(T, GROOVE),
            },
            {
                "block_size": [0.016, 0.012, 0.006],
                "spacing": 1e-3,
                "diameter": 0.006,
                "corner_radius": 0.001,
                "substeps": 4,
                "tool_wear": 0.1,
            },
        ),
        "spindle_current": (
            {"spindle_torque": 11.0 * _rise(0.05, 0.1), "spindle_speed": 377.0 - 5.0 * _rise(0.2, 0.1)},
            {"current_gain_error": 0.05, "current_offset": 0.1, "friction_error": 0.5},
        ),
        "surface_contact": (
            {"p_BT_B": _stylus_path()},
            {"contour": EDGE, "damping": 50.0, "friction": 0.3, "p_BP_B": [1.3, 0.0, 0.5], "quat_BP": [0.6, 0.0, 0.0, 0.8]},
        ),
        "path_learning": (
            {
                "f_T_T": np.array([1.0, -15.0, 4.0]) * _rise(0.06, 0.08) * (1.0 + 0.3 * np.sin(2.0 * np.pi * 9.0 * T)),
                "q_motor": _axes(),
                "v_BT_B": np.array([0.005, 0.001, 0.0]) * _rise(0.0, 0.03),
            },
            {"force_limit": 12.0, "wait_for_contact": True},
        ),
        "lead_through": (
            {"f_T_B": np.array([0.0, -15.0, 0.0]) * _rise(0.2, 0.05) * (1.0 - _rise(0.3, 0.02)), "f_hand_B": 0.02 * _force()},
            {"operator": OPERATOR, "released": [1.0, 1.0, 0.0, 1.0, 1.0, 1.0]},
        ),
        "regenerative_milling": (
            {
                "p_BT_B": _mill_pose() + np.array([0.0, 0.0, 0.0025]),
                "v_BT_B": np.array([0.06, 0.0, 0.0]) * np.ones_like(T),
                "spindle_speed": GROOVE - 100.0 * _rise(0.2, 0.1),
            },
            {
                "block_size": [0.1, 0.03, 0.03],
                "mode_frequency": [350.0, 420.0, 200.0] + [0.0] * 9,
                "mode_damping": [0.04, 0.05, 0.2] + [0.0] * 9,
                "mode_stiffness": [2e6, 2.5e6, 4e6] + [0.0] * 9,
                "mode_direction": [0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.96, 0.28, 0.0] + [0.0] * 27,
                "resolution": 4,
                "runout": 1e-5,
                "regenerative_gain_error": 0.1,
            },
        ),
        "spindle_holder": (
            {"f_T_B": _force(), "m_T_B": _moment(), "q": _axes()},
            # a bridge fails when the force has come up, and is found
            {
                "bridge_gain_error": [0.02, 0.0, -0.01, 0.0, 0.015, 0.0],
                "temperature_zero": [3e-7, 0.0, -2e-7, 0.0, 0.0, 4e-7],
                "noise_error": 0.5,
                "cross_talk": 0.01,
                "dead_channel": [0.0, 0.0, 0.45, 0.0, 0.0, 0.0],
                "attack_point": [0.008, 0.001, 0.0],
                "force_range": [1000.0, 300.0, 1000.0],
            },
        ),
    }[name]


EDGE = np.column_stack([np.linspace(-0.02, 0.02, 41), 1e-3 * np.sin(np.linspace(-6.0, 6.0, 41))])
"""A wavy edge [m]."""
OPERATOR = np.array(
    [
        [0.04, 5.0, 10.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.12, 0.0, 0.0, 0.0, 0.0, 0.0, 0.3, 1.0],
        [0.20, -8.0, 12.0, 5.0, 0.0, 0.1, 0.0, 0.0],
        [0.36, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
    ]
)
"""A hand that pushes, turns and teaches two points."""


def _stylus_path() -> FloatArray:
    """Along the edge, in and out of it by up to a millimetre."""
    along = -0.015 + 0.075 * T
    beside = -1.2e-3 + 1e-3 * np.sin(2.0 * np.pi * 3.0 * T)
    turned = np.hstack([-0.28 * along - 0.96 * beside, 0.96 * along - 0.28 * beside, 0.002 * T])
    return turned + np.array([1.3, 0.0, 0.5])


def _program() -> tuple[FloatArray, FloatArray]:
    """Segment table and pilot forces of a short program with a blend, an arc and a descent."""
    text = "G21 G90 G17 S13000 M3\nN10 G0 X0 Y0 Z0\nN20 G1 X4 F6000\nN30 Y3\nN40 G3 X2 Y5 I-2 J0\nN50 G1 X1 Z-0.5\nM30\n"
    planned = plan(gcode.parse(text), Placement((1.595, -0.018, 1.1)))
    tau = np.linspace(0.0, planned.duration, 9)
    table = planned.table.copy()
    table[:, TOOL] = np.where(table[:, BLOCK] > 20, 2, 1)
    return table, np.column_stack([tau, np.outer(np.sin(7.0 * tau), FORCE)])


def input_rows(interface: Interface, columns: dict[str, FloatArray]) -> FloatArray:
    """The columns as one array (STEPS, n_inputs)."""
    rows = np.tile([float(p.start) for p in interface.inputs], (STEPS, 1))
    for name, values in columns.items():
        rows[:, interface.arrays[name]] = values
    return rows
