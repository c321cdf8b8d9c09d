"""Plays the machine of this example: writes the logs of an axis that is not quite as servo_axis.py has it.

    python machine.py logs                      # an axis with something wrong, drawn by the seed; logs/truth.json says what
    python machine.py logs --effect coulomb=0.2 # or one that is named; --effect none for an axis that is as it should be

It is another formulation, on purpose: the friction is that of LuGre (Canudas de Wit et al. 1995), which gives way before it slides; the
equations are integrated in steps of 5 us; and inertias, stiffness, damping, lags and phases are those of this one axis, drawn by the seed.
robomill reads nothing of this file.
"""

import argparse
import json
import math
from pathlib import Path

import numba
import numpy as np

CYCLE, FINE = 1e-3, 5e-6
"""Cycle of the controller and of the log, and step of the integration [s]."""
NOTHING = 1e-9
"""Friction [N.m] that is none."""
TARGETS, TIMES, PAUSE = np.array([1.0, 0.2, 0.3, 0.28, 0.7, 0.0]), np.array([0.5, 0.6, 0.5, 0.4, 0.3, 0.7]), 0.1
CONDITIONS = {"work": (6.0, 1.0, 0.0), "heavy": (4.0, 1.3, 0.004)}
"""Name -> stroke [rad], pace, inertia of what is clamped on the table [kg.m2]."""
USUAL = {
    "coulomb": 0.2,
    "viscous": 0.01,
    "stribeck": 0.15,
    "table_friction": 0.2,
    "inertia_error": 0.2,
    "stiffness_error": -0.3,
    "torque_constant_error": -0.08,
    "backlash": 3e-3,
    "cogging": 0.1,
    "speed_gain_error": -0.3,
    "scale_error": 1e-3,
    "offset": 3e-3,
    "eccentricity": 5e-4,
    "lag": 4e-3,
}
"""What may be wrong with the axis, and how much of it is usual [SI]."""
NAMES = (
    *USUAL,
    "motor_inertia",
    "table_inertia",
    "stiffness",
    "damping",
    "bristle",
    "current_lag",
    "slide_speed",
    "cogging_phase",
    "wobble_phase",
)


def draw(seed: int, effects: dict[str, float]) -> np.ndarray:
    """The numbers of one axis, in the order of NAMES: its effects, and what no two axes share."""
    rng = np.random.default_rng(seed)
    own = {
        "motor_inertia": 5e-3 * (1.0 + 0.01 * rng.normal()),
        "table_inertia": 8e-3 * (1.0 + 0.01 * rng.normal()),
        "stiffness": 600.0 * (1.0 + 0.02 * rng.normal()),
        "damping": 0.15 * math.exp(0.2 * rng.normal()),
        "bristle": 1e4 * math.exp(0.3 * rng.normal()),
        "current_lag": 2e-4 * math.exp(0.2 * rng.normal()),
        "slide_speed": 0.5 * math.exp(0.4 * rng.normal()),
        "cogging_phase": rng.uniform(0.0, 2.0 * math.pi),
        "wobble_phase": rng.uniform(0.0, 2.0 * math.pi),
    }
    return np.array([effects.get(n, 0.0) if n in USUAL else own[n] for n in NAMES])


def plan(stroke: float, pace: float) -> tuple[np.ndarray, np.ndarray]:
    """Angle [rad] and speed [rad/s] of the program at the ticks of the controller."""
    ends = np.concatenate([[0.0], TARGETS]) * stroke
    begins = np.concatenate([[0.0], np.cumsum(TIMES / pace + PAUSE)])
    t = CYCLE * np.arange(round(begins[-1] / CYCLE) + 1)
    q, w = np.zeros_like(t), np.zeros_like(t)
    for i, duration in enumerate(TIMES / pace):
        x = np.clip((t - begins[i]) / duration, 0.0, 1.0)
        q += (ends[i + 1] - ends[i]) * (10.0 * x**3 - 15.0 * x**4 + 6.0 * x**5)
        w += (ends[i + 1] - ends[i]) / duration * 30.0 * x**2 * (1.0 - x) ** 2
    return q, w


@numba.njit(cache=False)
def _bristles(z, w, level, bristle):  # type: ignore[no-untyped-def]  # compiled
    """Deflection [rad] of the bristles after FINE for a speed w that is held, and their torque: dz/dt = w - bristle |w| / level z."""
    if level < NOTHING:
        return 0.0, 0.0
    if w != 0.0:
        settled = math.copysign(level / bristle, w)
        z = settled + (z - settled) * math.exp(-bristle * abs(w) / level * FINE)
    damping = 0.3 * math.exp(-((w / 0.1) ** 2)) * (w - bristle * abs(w) / level * z)
    return z, bristle * z + damping


@numba.njit(cache=False)
def _run(p, load, q_ref, w_ref, start):  # type: ignore[no-untyped-def]  # compiled
    (coulomb, viscous, stribeck, table_friction, inertia_error, stiffness_error, constant_error, backlash, cogging, gain_error) = p[:10]
    motor, table, stiffness, damping, bristle, current_lag, slide, cogging_phase = p[14:22]
    table = table * (1.0 + inertia_error) + load
    stiffness *= 1.0 + stiffness_error
    n, m = len(q_ref), round(CYCLE / FINE)
    out = np.zeros((n, 4))
    q, w, qt, wt, z, zt, integral, flowing, current = start, 0.0, start, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(n):
        error = w_ref[k] + 25.0 * (q_ref[k] - q) - w
        integral += error * CYCLE / 0.03
        out[k, 0], out[k, 1], out[k, 2], out[k, 3] = current, q, w, qt  # logged before the new current is set
        current = min(max(1.3 * (1.0 + gain_error) * (error + integral) / 0.8, -12.0), 12.0)
        for _ in range(m):
            flowing += FINE / current_lag * (current - flowing)
            drive = 0.8 * (1.0 + constant_error) * flowing + cogging * math.sin(12.0 * q + cogging_phase)
            twist = q - qt
            pressed = math.copysign(max(abs(twist) - 0.5 * backlash, 0.0), twist)
            between = stiffness * pressed
            if pressed != 0.0:
                between += damping * (w - wt)
            z, rub = _bristles(z, w, coulomb + stribeck * math.exp(-((w / slide) ** 2)), bristle)
            zt, rub_table = _bristles(zt, wt, table_friction, bristle)
            w += FINE / motor * (drive - between - rub - viscous * w)
            wt += FINE / table * (between - rub_table)
            q += FINE * w
            qt += FINE * wt
    return out


def measure(effects: dict[str, float], seed: int, condition: str, repeat: int, noise: float = 1.0) -> dict[str, np.ndarray]:
    """One log: column -> values, in the units of its header. Each repeat has its own noise, and a table that stood a little off."""
    stroke, pace, load = CONDITIONS[condition]
    p = draw(seed, effects)
    rng = np.random.default_rng([seed, repeat, sorted(CONDITIONS).index(condition)])
    q_ref, w_ref = plan(stroke, pace)
    current, q, w, table = _run(p, load, q_ref, w_ref, 5e-5 * rng.normal()).T
    shown = table * (1.0 + effects.get("scale_error", 0.0)) + effects.get("offset", 0.0)
    shown = shown + effects.get("eccentricity", 0.0) * np.sin(table + p[NAMES.index("wobble_phase")])
    t = CYCLE * np.arange(len(q_ref))
    shown = np.interp(t - effects.get("lag", 0.0), t, shown)
    resolution = 2.0 * math.pi / 2**17
    return {
        "time_ms": 1e3 * t,
        "set_deg": np.degrees(q_ref),
        "set_rpm": w_ref * 30.0 / math.pi,
        "motor_deg": np.degrees(np.round(q / resolution) * resolution),
        "motor_rpm": (w + 0.02 * noise * rng.normal(size=len(t))) * 30.0 / math.pi,
        "iq_mA": 1e3 * (current + 0.03 * noise * rng.normal(size=len(t))),
        "table_deg": np.degrees(shown + 3e-5 * noise * rng.normal(size=len(t))),
    }


def write(file: Path, columns: dict[str, np.ndarray]) -> None:
    """A log as this controller writes it: semicolons, decimal commas."""
    rows = [
        ";".join(f"{x:.6g}" if n == "time_ms" else f"{x:.5f}" for n, x in zip(columns, row, strict=True))
        for row in zip(*columns.values(), strict=True)
    ]
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text("axis logger 3.2\n" + ";".join(columns) + "\n" + "\n".join(rows).replace(".", ",") + "\n", encoding="utf-8")


def main() -> None:
    """Write `repeats` logs of each condition, and what was wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--effect", action="append", metavar="NAME=VALUE", help=f"what is wrong [SI]: {', '.join(USUAL)}; or none")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--noise", type=float, default=1.0, help="how many times as noisy as usual")
    options = parser.parse_args()
    if options.effect is None:
        rng = np.random.default_rng([options.seed, 1])
        name = str(rng.choice([*USUAL]))
        effects = {name: USUAL[name] * math.exp(0.3 * rng.normal())}
    else:
        effects = {name: float(value) for name, _, value in (e.partition("=") for e in options.effect) if name != "none"}
    if strange := [name for name in effects if name not in USUAL]:
        parser.error(f"--effect {strange[0]}: there is no such effect; there are {', '.join(USUAL)}")
    for condition in CONDITIONS:
        for repeat in range(1, options.repeats + 1):
            write(options.folder / f"{condition}-{repeat}.csv", measure(effects, options.seed, condition, repeat, options.noise))
    (options.folder / "truth.json").write_text(json.dumps(effects) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
