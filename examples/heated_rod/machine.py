"""Plays the rod of this example: writes the logs of one that is not quite as heated_rod.py has it.

    python machine.py logs                         # a rod with something wrong, drawn by the seed; logs/truth.json says what
    python machine.py logs --effect loss_error=0.4 # or one that is named; --effect none for a rod that is as it should be

It is another formulation, on purpose: forty cells, a part of the loss is radiation, the heater is switched on and off in pulses,
the thermocouples are of second order, the room is not always as warm, and capacities, conductance and loss are those of this one rod,
drawn by the seed. robomill reads nothing of this file.
"""

import argparse
import json
import math
from pathlib import Path

import numba
import numpy as np

CYCLE, PULSE, FINE = 5.0, 2.5, 0.02
"""Cycle of the controller and of the log, that of the pulses of the heater, step of the integration [s]."""
CONDITIONS = {"bake": (60.0, 80.0, 65.0, 40.0), "anneal": (80.0, 50.0, 90.0, 60.0)}
"""Name -> levels [degC]."""
HOLD, RATE = 900.0, 0.1
"""Time at each level [s], rate of the ramps [K/s]."""
USUAL = {
    "power_error": -0.1,
    "loss_error": 0.3,
    "capacity_error": 0.1,
    "conductance_error": -0.1,
    "extra_resistance": 0.3,
    "slower": 20.0,
    "gain_error": 0.03,
    "offset": 2.0,
    "drift": 4e-4,
    "control_gain_error": 0.3,
    "lag": 15.0,
}
"""What may be wrong with the rod, and how much of it is usual [SI]. What is about a thermocouple is about that at the end; `lag` is that of
its log."""
NAMES = (*USUAL, "block_capacity", "block_loss", "rod_capacity", "rod_loss", "conductivity", "contact", "radiated", "split")


def draw(seed: int, effects: dict[str, float]) -> np.ndarray:
    """The numbers of one rod, in the order of NAMES: its effects, and what no two rods share."""
    rng = np.random.default_rng(seed)
    own = {
        "block_capacity": 100.0 * (1.0 + 0.02 * rng.normal()),
        "block_loss": 0.05 * (1.0 + 0.1 * rng.normal()),
        "rod_capacity": 305.0 * (1.0 + 0.01 * rng.normal()),
        "rod_loss": 0.25 * (1.0 + 0.03 * rng.normal()),
        "conductivity": 0.157 * (1.0 + 0.01 * rng.normal()),
        "contact": 0.4 * (1.0 + 0.03 * rng.normal()),
        "radiated": rng.uniform(0.02, 0.1),
        "split": rng.uniform(0.5, 0.8),
    }
    return np.array([effects.get(n, 0.0) if n in USUAL else own[n] for n in NAMES])


def plan(levels: tuple[float, ...]) -> np.ndarray:
    """Set temperature [degC] at the ticks of the controller, for 75 min."""
    times, values = [0.0], [20.0]
    for level in levels:
        times += [times[-1] + abs(level - values[-1]) / RATE]
        times += [times[-1] + HOLD]
        values += [level, level]
    return np.interp(CYCLE * np.arange(int(4500.0 / CYCLE) + 1), times, values)


@numba.njit(cache=False)
def _run(p, setpoint, room):  # type: ignore[no-untyped-def]  # compiled
    power_error, loss_error, capacity_error, conductance_error, extra, slower, gain, offset, drift, control_error = p[:10]
    block_capacity, block_loss, rod_capacity, rod_loss, conductivity, contact, radiated, split = p[11:]
    cells, n, m, pulse = 40, len(setpoint), round(CYCLE / FINE), round(PULSE / FINE)
    capacity = rod_capacity * (1.0 + capacity_error) / cells
    between = conductivity * (1.0 + conductance_error) * cells  # the rod as a whole has conductivity, W/K
    loss = rod_loss * (1.0 + loss_error) / cells
    # the contact was measured to the middle of the first tenth of the rod, not of the first cell
    head = 1.0 / (contact + extra - 0.5 / (10.0 * conductivity) + 0.5 / (cells * conductivity))
    out = np.zeros((n, 4))
    block, rod = room, np.full(cells, room)
    first, second = np.full(3, room), np.full(3, room)
    flow, seen, integral, power = np.zeros(cells + 1), np.zeros(3), 0.0, 0.0
    for k in range(n):
        t = k * CYCLE
        for i in range(3):
            out[k, 1 + i] = second[i]
        out[k, 3] += gain * second[2] + offset + drift * t
        out[k, 0] = power
        error = setpoint[k] - out[k, 2]
        wanted = (1.0 + control_error) * error + integral
        power = min(max(wanted, 0.0), 60.0)
        if power == wanted:
            integral += (1.0 + control_error) * error * CYCLE / 600.0
        for j in range(m):
            on = (j % pulse) + 0.5 < power / 60.0 * pulse
            flow[0] = head * (block - rod[0])
            for i in range(1, cells):
                flow[i] = between * (rod[i - 1] - rod[i])
            flow[cells] = 0.0
            block += FINE / block_capacity * (on * 60.0 * (1.0 + power_error) - flow[0] - block_loss * (block - room))
            for i in range(cells):
                a, r = rod[i] + 273.15, room + 273.15
                lost = loss * ((1.0 - radiated) * (a - r) + radiated * (a**4 - r**4) / (4.0 * 314.0**3))  # calibrated at 60 degC
                rod[i] += FINE / capacity * (flow[i] - flow[i + 1] - lost)
            seen[0], seen[1], seen[2] = block, 0.5 * (rod[cells // 2 - 1] + rod[cells // 2]), 0.5 * (rod[cells - 3] + rod[cells - 2])
            for i in range(3):
                whole = 8.0 + slower * (i // 2)  # the last one
                first[i] += FINE / (split * whole) * (seen[i] - first[i])
                second[i] += FINE / ((1.0 - split) * whole) * (first[i] - second[i])
    return out


def measure(effects: dict[str, float], seed: int, condition: str, repeat: int, noise: float = 1.0) -> dict[str, np.ndarray]:
    """One log: column -> values, in the units of its header. Each repeat has its own noise, and a room that is not always as warm."""
    rng = np.random.default_rng([seed, repeat, sorted(CONDITIONS).index(condition)])
    setpoint = plan(CONDITIONS[condition])
    power, block, middle, end = _run(draw(seed, effects), setpoint, 20.0 + 0.15 * noise * rng.normal()).T
    t = CYCLE * np.arange(len(setpoint))
    end = np.interp(t - effects.get("lag", 0.0), t, end)
    shown = {n: np.round(x + 0.08 * noise * rng.normal(size=len(t)), 2) for n, x in (("block", block), ("middle", middle), ("end", end))}
    return {
        "time_min": t / 60.0,
        "set_degC": setpoint,
        "power_percent": power / 0.6 + 0.2 * noise * rng.normal(size=len(t)),
        **{f"{n}_degC": x for n, x in shown.items()},
    }


def write(file: Path, columns: dict[str, np.ndarray]) -> None:
    """A log as this controller writes it."""
    rows = [",".join(f"{x:.10g}" for x in row) for row in zip(*columns.values(), strict=True)]
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(",".join(columns) + "\n" + "\n".join(rows) + "\n", encoding="utf-8")


def main() -> None:
    """Write `repeats` logs of each condition, and what was wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--effect", action="append", metavar="NAME=VALUE", help=f"what is wrong [SI]: {', '.join(USUAL)}; or none")
    parser.add_argument("--seed", type=int, default=5)
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
