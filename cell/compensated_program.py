"""Write what a compensation came to: the program in the languages of controllers, with a header that says from what and how."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from robomill.cell.compensation import Compensation, CompensationError, write_json
from robomill.models.planning.languages import PoseProgram, write_gcode, write_krl, write_rapid
from robomill.models.planning.languages.krl import krl_name
from robomill.models.planning.languages.rapid import rapid_name

_SHOWN_HASH = 12
"""Digits of the hash in the header."""


def _spline(program: PoseProgram) -> str:
    return write_krl(replace(program, motion="spline", blend=np.zeros_like(program.blend)))


FORMATS: Mapping[str, tuple[Callable[[PoseProgram], str], Callable[[str], str], str]] = {
    "gcode": (write_gcode, lambda name: f"{name}.ngc", "G-code, G1 with G64 P"),
    "krl": (write_krl, lambda name: f"{krl_name(name)}.src", "KUKA KRL, LIN with C_DIS"),
    "krl-spline": (_spline, lambda name: f"{krl_name(name + '_spl')}.src", "KUKA KRL, SPLINE"),
    "rapid": (write_rapid, lambda name: f"{rapid_name(name)}.mod", "ABB RAPID, MoveL"),
}
"""Format -> writer, name of the file, what it is."""
DEFAULT_FORMATS = ("gcode", "krl", "rapid")


def check_formats(names: Sequence[str]) -> None:
    """CompensationError for a format that cannot be written."""
    for name in names:
        if name not in FORMATS:
            raise CompensationError(f"format {name!r} is not known; available: {', '.join(f'{k} ({v[2]})' for k, v in FORMATS.items())}")


def write_programs(result: Compensation, folder: Path, formats: Sequence[str] = DEFAULT_FORMATS) -> list[Path]:
    """Write the compensated program into `folder`; returns the files.

    G-code has the zero (G54) of the scenario, KRL and RAPID the workpiece frame as base. CompensationError for an unknown format.
    """
    check_formats(formats)
    poses = replace(result.program.poses, name=f"{result.program.poses.name}_compensated", header=tuple(header(result)))
    files = []
    for name in formats:
        write, file_name, _ = FORMATS[name]
        zero = np.array(result.scenario.reading.work_offsets[54]) if name == "gcode" else np.zeros(3)
        text = write(_named(replace(poses, p=poses.p - zero), write))
        files.append(folder / file_name(poses.name))
        files[-1].write_text(text, encoding="utf-8")
    return files


def _named(program: PoseProgram, write: Callable[[PoseProgram], str]) -> PoseProgram:
    """With the name that the file gets, where it has to be the same."""
    return replace(program, name=f"{program.name}_spl") if write is _spline else program


def header(result: Compensation) -> list[str]:
    """From what and how the program was made; the same for the same input."""
    assert result.scenario.program is not None
    first, last = result.before.figures, result.after.figures
    digest = hashlib.sha256(result.scenario.program.read_bytes()).hexdigest()[:_SHOWN_HASH]
    said = result.labels
    lines = [
        f"compensated offline by robomill from {result.scenario.program.name} (sha256 {digest})",
        f"cell {result.scenario.file.name}, variant {result.variant.name}; robot {said.get('robot', '?')}, tool {said.get('tool', '?')}",
        f"workpiece at {', '.join(f'{1e3 * v:g}' for v in result.placement.p_BP_B)} mm, "
        f"A B C {', '.join(f'{v:g}' for v in np.rad2deg(result.placement.abc_BP))} deg in the base",
        f"{sum(i.factor > 0 for i in result.iterations)} iterations, {result.ending}; tool tip off the path in the cut, rms: "
        f"{1e3 * first.rms_m:.3f} mm before, {1e3 * last.rms_m:.3f} mm after, in the simulation",
        f"{len(result.program.poses.p)} poses, chords within {1e3 * result.settings.tolerance:g} mm, largest correction "
        f"{1e3 * float(np.linalg.norm(result.offset, axis=1).max()):.3f} mm",
    ]
    return [*lines, *(f"of the original: {note}" for note in result.notes)]


def summary(result: Compensation) -> dict[str, Any]:
    """What compensation.json has; lengths in m, times in s."""
    assert result.scenario.program is not None
    return {
        "scenario": result.scenario.name,
        "program": result.scenario.program.name,
        "variant": result.variant.name,
        "ending": result.ending,
        "iterations": [asdict(i) for i in result.iterations],
        "poses": len(result.program.poses.p),
        "uncompensated": {"path": asdict(result.before.figures), "surface": asdict(result.results[0].figures)},
        "compensated": {"path": asdict(result.after.figures), "surface": asdict(result.results[1].figures)},
        "time_s": {"uncompensated": result.before.plan.duration, "compensated": result.after.plan.duration},
        "perturbed": [t.figures for t in result.trials],
        "lines": result.lines,
        "notes": result.remarks,
    }


def write_summary(result: Compensation, folder: Path) -> dict[str, Any]:
    """Write compensation.json."""
    figures = summary(result)
    write_json(folder / "compensation.json", figures)
    return figures
