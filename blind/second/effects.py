"""Every effect of the benchmark as the second generator makes it. Sizes mean what the pages of the components say; the laws are other ones.

What no two machines share (phases, frequencies, damping, orders of filters, powers, points of attack) is drawn once for a machine.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from robomill.blind.second.cell import Cell
from robomill.blind.second.kernel import FloatArray
from robomill.blind.truth import TrueEffect

Switch = Callable[[Cell, float, int], Cell]
"""(cell, value in SI, element from 0) -> the cell with the effect."""

FORMS: Mapping[str, str] = {
    "compliance.stiffness_hardening": "power law",
    "compliance.stiffness_asymmetry": "smooth in the torque",
    "compliance.gear_hysteresis": "Bouc-Wen play",
    "compliance.gear_friction": "Dahl",
    "compliance.tilt_compliance": "two unequal axes",
    "compliance.base_compliance": "spring and damper",
    "compliance.counterbalance_error": "polytropic gas",
    "compliance.thermal_growth": "two nodes",
    "compliance.payload_error": "attack point drawn",
    "compliance.mode_compliance": "frequency, damping, direction drawn",
    "drive.backlash": "gap that closes gradually",
    "drive.transmission_error": "phase and order drawn",
    "drive.geometry_error": "exact kinematics",
    "drive.tracking_lag": "dead time or lag, order drawn",
    "drive.reversal_friction": "width and power drawn",
    "drive.friction_coulomb": "Dahl bristle",
    "drive.friction_stribeck": "LuGre",
    "sensor.cross_talk": "uneven matrix",
    "sensor.zero_drift": "still settling",
    "sensor.extra_lag": "dead time or lag, order drawn",
    "sensor.weight_error": "attack point drawn",
    "sensor.inertia": "filtered acceleration",
    "sensor.hose_force": "elastic hose, anchor drawn",
    "sensor.cutoff_error": "other damping",
    "controller.extra_delay": "dead time or lag, order drawn",
    "controller.dead_band": "soft edge",
    "controller.lost_packets": "bursts",
    "milling.size_effect_exponent": "shifted power law",
    "milling.runout": "leaning, phase drawn at every start",
    "milling.tool_wear": "uneven over the edge forces",
    "milling.workpiece_compliance": "spring and damper, uneven",
}
"""Effects with another law than that of the component, and which; the others are definitions and have no second form."""

PATTERN = np.array(
    [[0, 1, 1, 1, 1, 1], [1, 0, 1, -1, -1, 1], [1, 1, 0, 1, -1, -1], [1, -1, 1, 0, 1, -1], [1, -1, -1, 1, 0, 1], [1, 1, -1, -1, 1, 0]],
    dtype=np.float64,
)
"""Conference matrix of order 6 (docs/components/sensor_chain.md)."""


def _between(random: np.random.Generator, low: float, high: float) -> float:
    return float(low * (high / low) ** random.random())


def constants(c: Cell, random: np.random.Generator) -> tuple[Cell, dict[str, dict[str, Any]]]:
    """The cell with the hidden constants of one machine, which do nothing while the effects are off.

    Also returned: those for which the models have a parameter, component -> parameter -> values.
    """
    direction = random.standard_normal(3)
    direction /= np.linalg.norm(direction)
    f = c.flexure._replace(
        hardening_power=float(random.uniform(0.7, 1.5)),
        asymmetry_torque=_between(random, 0.01, 0.05),
        hysteresis_torque=c.flexure.hysteresis_torque * np.exp(random.uniform(-0.6, 0.6, 6)),
        hysteresis_power=float(random.uniform(1.0, 4.0)),
        friction_stiffness=_between(random, 0.35, 1.0),
        tilt_skew=float(random.uniform(-0.2, 0.2)),
        base_time=_between(random, 0.003, 0.03),
        payload_at=c.flexure.payload_at + random.uniform(-0.05, 0.05, 3),
        gas_power=float(random.uniform(1.0, 1.35)),
        growth_share=float(random.uniform(0.3, 0.7)),
        growth_times=np.array([_between(random, 1500.0, 4000.0), _between(random, 5000.0, 12000.0)]),
        mode_omega=2.0 * math.pi * _between(random, 5.0, 20.0),
        mode_damping=_between(random, 0.01, 0.06),
        mode_direction=direction,
        lobes=float(random.uniform(100.0, 300.0)),
        lobe_phase=float(random.uniform(0.0, 2.0 * math.pi)),
        creep_times=np.array([_between(random, 0.1, 0.5), _between(random, 1.0, 5.0)]),
        floor_omega=2.0 * math.pi * _between(random, 2.0, 11.0),
        floor_phase=float(random.uniform(0.0, 2.0 * math.pi)),
        floor_direction=-direction[[1, 2, 0]],
    )
    d = c.drive._replace(
        backlash_spread=float(random.uniform(0.1, 0.6)),
        gear_order=random.integers(1, 3, 6).astype(np.float64),
        gear_phase=random.uniform(-math.pi, math.pi, 6),
        reversal_time=_between(random, 0.01, 0.04),
        reversal_power=_between(random, 0.6, 1.8),
        ringing_omega=2.0 * math.pi * _between(random, 5.0, 14.0),
        ringing_time=_between(random, 0.1, 0.4),
        lag_order=int(random.integers(0, 3)),
    )
    w = c.cut._replace(
        size_shift=_between(random, 0.5e-6, 3e-6),
        runout_tilt=float(random.uniform(-30.0, 30.0)),
        yielding_time=_between(random, 0.003, 0.02),
        grain_angle=float(random.uniform(0.0, math.pi)),
    )
    s = c.sensor._replace(
        lag_order=int(random.integers(0, 3)),
        extra_cog=c.sensor.cog + random.uniform(-0.03, 0.03, 3),
        inertia_filter=float(random.uniform(0.3, 1.0)),
        hose_anchor=c.sensor.hose_anchor + random.uniform(-0.3, 0.3, 3),
        hose_rate=float(random.uniform(0.0, 0.6)),
        zero_share=float(random.uniform(0.0, 0.1)),
        zero_time=_between(random, 300.0, 1200.0),
        warming_time=_between(random, 1.5, 6.0),
    )
    k = c.control._replace(late_order=int(random.integers(0, 3)), knee=_between(random, 0.5, 4.0), burst=_between(random, 1.2, 4.0))
    t = c.dynamics._replace(
        presliding=_between(random, 1e-5, 1e-4),
        stribeck_speed=_between(random, 0.01, 0.04),
        stribeck_power=float(random.uniform(0.8, 2.0)),
        cogging_order=float(random.choice([6.0, 8.0, 12.0])),
        cogging_phase=float(random.uniform(0.0, 2.0 * math.pi)),
    )
    told: dict[str, dict[str, Any]] = {
        "compliance": {
            "mode_frequency": f.mode_omega / (2.0 * math.pi),
            "mode_damping": f.mode_damping,
            "mode_direction": f.mode_direction.tolist(),
            "hysteresis_torque": f.hysteresis_torque.tolist(),
            "friction_stiffness": f.friction_stiffness,
            "p_FG_F": f.payload_at.tolist(),
        },
        "drive": {
            "transmission_phase": d.gear_phase.tolist(),
            "transmission_harmonic": d.gear_order.tolist(),
            "stribeck_speed": t.stribeck_speed,
            "reversal_time": d.reversal_time,
        },
        "sensor": {"zero_drift_time": s.zero_time},
    }
    return Cell(f, d, w, s, k, t, c.inertia_steps), told


def _element(values: FloatArray, i: int, value: float) -> FloatArray:
    out = values.copy()
    out[i] += value
    return out


def _vector(part: str, field: str) -> Switch:
    """A number of a vector of the cell."""

    def switch(c: Cell, value: float, i: int) -> Cell:
        group = getattr(c, part)
        changed = group._replace(**{field: _element(getattr(group, field), i, value)})
        return c._replace(**{part: changed})

    return switch


def _number(part: str, field: str) -> Switch:
    """A number of the cell."""

    def switch(c: Cell, value: float, i: int) -> Cell:
        return c._replace(**{part: getattr(c, part)._replace(**{field: value})})

    return switch


def _gain(c: Cell, value: float, i: int) -> Cell:
    gain = c.sensor.gain.copy()
    gain += value * gain
    return c._replace(sensor=c.sensor._replace(gain=gain))


def _gain_axis(c: Cell, value: float, i: int) -> Cell:
    gain = c.sensor.gain.copy()
    gain[i] *= 1.0 + value
    return c._replace(sensor=c.sensor._replace(gain=gain))


def _cross_talk(c: Cell, value: float, i: int) -> Cell:
    # uneven by a third, from constants of the machine that have nothing to do with the sensor: the same for every size
    uneven = 1.0 + np.sin(c.drive.gear_phase[:, None] * 7.0 + 3.0 * np.arange(6)[None, :]) / 3.0
    talk = value * PATTERN * uneven * c.sensor.span[:, None] / c.sensor.span[None, :]
    return c._replace(sensor=c.sensor._replace(gain=c.sensor.gain + talk))


def _cutoff(c: Cell, value: float, i: int) -> Cell:
    damping = math.sqrt(0.5) * (1.0 + 0.1 * math.sin(c.drive.gear_phase[1]))
    return c._replace(sensor=c.sensor._replace(cutoff=c.sensor.cutoff * (1.0 + value), damping=damping))


def _limit(c: Cell, value: float, i: int) -> Cell:
    return c._replace(control=c.control._replace(limit=c.control.limit * (1.0 - value)))


def _chip(c: Cell, value: float, i: int) -> Cell:
    return c._replace(cut=c.cut._replace(chip=c.cut.chip * (1.0 + value)))


def _wear(c: Cell, value: float, i: int) -> Cell:
    # flank wear presses more than it rubs, or the other way round: 20 % at most, with the same mean of both
    skew = 0.2 * math.sin(c.drive.gear_phase[2])
    return c._replace(cut=c.cut._replace(edge=c.cut.edge * (1.0 + value * np.array([1.0 + skew, 1.0 - skew, 1.0]))))


def _sides(c: Cell, value: float, i: int) -> Cell:
    return c._replace(cut=c.cut._replace(size=c.cut.size + np.array([2.0 * value, 2.0 * value, 0.0])))


def _stock(c: Cell, value: float, i: int) -> Cell:
    return c._replace(cut=c.cut._replace(size=c.cut.size + np.array([0.0, 0.0, value])))


def _workpiece(c: Cell, value: float, i: int) -> Cell:
    uneven = 1.0 + 0.25 * np.sin(c.drive.gear_phase[3:])
    return c._replace(cut=c.cut._replace(yielding=value * uneven / uneven.mean()))


SWITCHES: Mapping[str, Switch] = {
    "compliance.stiffness_error": _vector("flexure", "error"),
    "compliance.stiffness_hardening": _vector("flexure", "hardening"),
    "compliance.stiffness_asymmetry": _vector("flexure", "asymmetry"),
    "compliance.gear_hysteresis": _vector("flexure", "hysteresis"),
    "compliance.gear_friction": _vector("flexure", "friction"),
    "compliance.tilt_compliance": _vector("flexure", "tilt"),
    "compliance.base_compliance": _vector("flexure", "base"),
    "compliance.tool_compliance": _number("flexure", "tool"),
    "compliance.payload_error": _number("flexure", "payload"),
    "compliance.counterbalance_error": _number("flexure", "counterbalance"),
    "compliance.thermal_growth": _number("flexure", "growth"),
    "compliance.mode_compliance": _number("flexure", "mode"),
    "drive.backlash": _vector("drive", "backlash"),
    "drive.transmission_error": _vector("drive", "gear_error"),
    "drive.joint_offset": _vector("drive", "offset"),
    "drive.geometry_error": _vector("drive", "geometry"),
    "drive.tracking_lag": _number("drive", "lag"),
    "drive.reversal_friction": _vector("drive", "reversal"),
    "drive.friction_viscous": _vector("dynamics", "viscous"),
    "drive.friction_coulomb": _vector("dynamics", "coulomb"),
    "drive.friction_stribeck": _vector("dynamics", "stribeck"),
    "sensor.sensor_gain_error": _gain,
    "sensor.sensor_gain_error_axis": _gain_axis,
    "sensor.cross_talk": _cross_talk,
    "sensor.zero_drift": _vector("sensor", "zero"),
    "sensor.misalignment": _vector("sensor", "turned"),
    "sensor.extra_lag": _number("sensor", "lag"),
    "sensor.weight_error": _number("sensor", "extra_mass"),
    "sensor.inertia": _number("sensor", "inertia"),
    "sensor.hose_force": _number("sensor", "hose_force"),
    "sensor.clipping": _number("sensor", "clip"),
    "sensor.cutoff_error": _cutoff,
    "controller.extra_delay": _number("control", "late"),
    "controller.dead_band": _number("control", "dead"),
    "controller.correction_limit": _limit,
    "controller.stiffness_table_error": _vector("control", "table_error"),
    "controller.frame_error": _vector("control", "frame"),
    "controller.lost_packets": _number("control", "lost"),
    "milling.cutting_coefficient_error": _chip,
    "milling.tool_wear": _wear,
    "milling.size_effect_exponent": _number("cut", "size_effect"),
    "milling.runout": _number("cut", "runout"),
    "milling.stock_error": _stock,
    "milling.engagement_error": _sides,
    "milling.workpiece_compliance": _workpiece,
}
"""By `component.effect`."""


def switched_on(c: Cell, effects: Sequence[TrueEffect]) -> Cell:
    """The cell with effects of the components; late clocks are no matter of the cell. LookupError: an effect that is not made here."""
    for e in effects:
        if not e.physical:
            continue
        key = f"{e.component}.{e.effect}"
        if key not in SWITCHES:
            raise LookupError(f"effect {key!r}: the second generator makes {', '.join(sorted(SWITCHES))}")
        c = SWITCHES[key](c, e.value, max(e.index - 1, 0))
    return c
