"""Cost, memory and accuracy of tri-dexels by the distance of their lines: ``python -m benchmarks.tridexels`` (docs/how_to/workpiece.md).

A block of 200 x 150 x 30 mm is milled in rows 12 mm apart, 2 mm deep, with a cutter of 16 mm, 0.4 mm per step of 4 ms (0.1 m/s): 30 000
steps are two minutes. Times are of the processor, of one core.
"""

from __future__ import annotations

import argparse
import math
import time

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from robomill.models.components.tridexel_milling_force import MODEL
from robomill.models.metrology.stl import solid_volume
from robomill.models.metrology.tridexel_part import Part
from robomill.models.model.declaration import FloatArray

SIZE = (0.2, 0.15, 0.03)
DEPTH, RADIUS, WAY, STEP = 0.002, 0.008, 4e-4, 0.004
STEPS = 30000
SPACINGS = (5e-4, 2.5e-4, 2e-4, 1e-4)
CUTTERS = (
    ("flat, upright", 0.0, (0.0, 0.0)),
    ("ball, upright", RADIUS, (0.0, 0.0)),
    ("bull 3 mm, upright", 0.003, (0.0, 0.0)),
    ("flat, tilted 20 deg", 0.0, (0.0, 20.0)),
    ("ball, tilted 20 deg", RADIUS, (0.0, 20.0)),
    ("bull 3 mm, tilted 20 deg", 0.003, (0.0, 20.0)),
)


def rows(steps: int) -> FloatArray:
    """Tips (n, 3) [m] in rows along x over the whole block, again and again."""
    length, count = SIZE[0] + 4.0 * RADIUS, round(SIZE[1] / 0.012)
    way = WAY * np.arange(steps)
    row = np.floor(way / length)
    x = way - row * length
    x = np.where(row % 2 == 0, x, length - x) - 0.5 * length
    y = (row % count + 0.5) * 0.012 - 0.5 * SIZE[1]
    level = -DEPTH * (1.0 + row // count)
    return np.column_stack([x, y, level])


def cutting(spacing: float, steps: int) -> tuple[float, float, float, float]:
    """Seconds for cutting `steps` steps, MB of lines, error of the volume of a slot by the lines along the tool and by the surface."""
    low, high = (-0.5 * SIZE[0], -0.5 * SIZE[1], -SIZE[2]), (0.5 * SIZE[0], 0.5 * SIZE[1], 0.0)
    part = Part.block(low, high, spacing)
    up = np.array([0.0, 0.0, 1.0])
    Part.block((0, 0, 0), (0.01, 0.01, 0.01), 1e-3).cut(np.zeros((2, 3)), np.tile(up, (2, 1)), RADIUS, 0.0, 0.032)  # compile
    tips = rows(steps)
    start = time.process_time()
    part.cut(tips, np.tile(up, (steps, 1)), RADIUS, 0.0, 0.032)
    seconds = time.process_time() - start
    slot = Part.block((-0.02, -0.02, -0.01), (0.02, 0.02, 0.0), spacing)
    x = np.arange(-0.04, 0.04, WAY)
    slot.cut(
        np.column_stack([x, np.full_like(x, 1.234e-3), np.full_like(x, -DEPTH - 3.1e-5)]), np.tile(up, (len(x), 1)), RADIUS, 0.0, 0.032
    )
    removed = 2.0 * RADIUS * (DEPTH + 3.1e-5) * 0.04
    block = 0.04 * 0.04 * 0.01
    by_lines = (block - slot.volumes()[2]) / removed - 1.0
    by_surface = (block - solid_volume(slot.surface())) / removed - 1.0
    return seconds, 8e-6 * float(part.pool[0]), by_lines, by_surface


def component(spacing: float, corner: float, tilt: tuple[float, float], steps: int) -> float:
    """Seconds of the whole component, force and cut, for `steps` steps."""
    data: npt.NDArray[np.void] = MODEL.new()
    data["block_size"], data["spacing"], data["corner_radius"] = SIZE, spacing, corner
    data["spindle_speed"] = 13000.0 * math.pi / 30.0
    turn = Rotation.from_euler("xy", tilt, degrees=True) * Rotation.from_matrix([[0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    data["quat_BT"] = turn.as_quat(scalar_first=True)
    init, step = MODEL.compiled_for_data()
    origin = data["p_BP_B"][0].copy()
    tips = rows(steps) + origin
    velocity = np.gradient(tips, axis=0) / STEP
    velocity[np.linalg.norm(velocity, axis=1) > 2.0 * WAY / STEP] = 0.0
    data["p_BT_B"] = tips[0]
    status = init(data)
    seconds = 0.0
    for k in range(1, steps):
        data["p_BT_B"], data["v_BT_B"] = tips[k], velocity[k]
        start = time.process_time()
        status = status or step(data, 0.0, STEP)
        if k > 1:  # the first loads the code
            seconds += time.process_time() - start
    if status:
        raise RuntimeError(MODEL.message(status, data.view(np.recarray)[0], 0.0))
    return seconds


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=STEPS, help="steps that are measured; times are given for 30 000")
    steps = parser.parse_args().steps
    scale = STEPS / steps
    print("| lines, mm | cut, s | MB | slot volume by lines along the tool, % | by surface, % |\n|---|---|---|---|---|")
    for spacing in SPACINGS:
        seconds, megabytes, lines, surface = cutting(spacing, steps)
        print(f"| {1e3 * spacing:g} | {scale * seconds:.1f} | {megabytes:.0f} | {100 * lines:+.2f} | {100 * surface:+.2f} |")
    print("\n| cutter, lines of 0.25 mm | force and cut, s | times real time |\n|---|---|---|")
    for title, corner, tilt in CUTTERS:
        seconds = scale * component(SPACINGS[1], corner, tilt, steps)
        print(f"| {title} | {seconds:.1f} | {STEPS * STEP / seconds:.1f} |")


if __name__ == "__main__":
    main()
