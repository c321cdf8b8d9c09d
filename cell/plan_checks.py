"""What a plan shows to be wrong before anything is run: nothing cut, rapids through material, another tool than the program's.

Only geometry of program, block and tool (`models/planning/dry_run.py`); docs/how_to/gcode.md says what each text means.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from robomill.cell.plausibility import unusual_cuts
from robomill.models.planning.dry_run import DryRun, dry_run
from robomill.models.planning.gcode import Move, Program, Vector
from robomill.models.planning.point_path import PointPath
from robomill.models.process.cutting import EndMill

_SAME_TOOL = 0.005
"""Share of its diameter within which a tool is the one that a comment names: comments round."""


class Findings(NamedTuple):
    """What is wrong with a plan."""

    texts: tuple[str, ...] = ()
    """One each."""
    cuts: bool = True
    """Whether any material is removed; without, a run has no figures."""


def check_plan(program: Program | PointPath, size: Vector, tools: Mapping[int, EndMill]) -> Findings:
    """Take the program through a fresh block of `size` [m] and say what is wrong.

    `tools`: T number -> tool; 0 is the tool of programs that name none, and of numbers that are not there.
    """
    moves = _moves(program)
    used = {m.tool for m in moves}
    mills = {number: tools.get(number, tools[0]) if 0 in tools else tools[number] for number in used}
    result = dry_run(moves, size, {number: 0.5 * mill.diameter for number, mill in mills.items()})
    cuts = bool(np.any(result.removed > 0.0))
    texts = [] if cuts else [_missed(result, size)]
    if cuts and result.beside > 0.5 * result.below:
        share = 100.0 * result.beside / result.below
        texts.append(f"{share:.0f} % of the path below the top of the block runs beside the block; check zero and work offsets")
    rapids = [i for i, m in enumerate(moves) if m.feed is None and result.depth[i] > 0.0]
    if rapids:
        worst = max(rapids, key=lambda i: float(result.depth[i]))
        texts.append(
            f"rapid moves through material: {len(rapids)}, first at line {moves[rapids[0]].line}, deepest by "
            f"{1e3 * result.depth[worst]:.2f} mm at line {moves[worst].line}"
        )
    cutting = [i for i, m in enumerate(moves) if m.feed is not None and result.depth[i] > 0.0]
    still = [i for i in cutting if moves[i].spindle_speed == 0.0]
    if still:
        texts.append(
            f"moves that cut while the spindle stands: {len(still)}, first at line {moves[still[0]].line}; name the speed in the program "
            '(S13000 M3) or beside it (spindle_speed = "13000 rpm")'
        )
    for number, mill in sorted(mills.items()):
        deep = [i for i in cutting if moves[i].tool == number and result.depth[i] > mill.cutting_length > 0.0]
        if deep:
            worst = max(deep, key=lambda i: float(result.depth[i]))
            texts.append(
                f"{_name(number)} cuts {1e3 * result.depth[worst]:.1f} mm deep at line {moves[worst].line}, "
                f"its edges are {1e3 * mill.cutting_length:g} mm long"
            )
    texts += unusual_cuts([moves[i] for i in cutting], [float(result.depth[i]) for i in cutting], mills)
    return Findings((*texts, *_other_tools(program, mills)), cuts)


def _other_tools(program: Program | PointPath, mills: Mapping[int, EndMill]) -> list[str]:
    """Tools whose diameter is not the one that the program's comments name."""
    if not isinstance(program, Program):
        return []
    texts = []
    for number, mill in sorted(mills.items()):
        named = program.named_diameters.get(number, program.named_diameters.get(0))
        if named is not None and abs(named - mill.diameter) > _SAME_TOOL * mill.diameter:
            texts.append(
                f"{_name(number)} is {1e3 * mill.diameter:g} mm wide here, {1e3 * named:g} mm in a comment of the program; "
                f"the path was made for that one: give it as [tools.{number or 1}] or milling.diameter"
            )
    return texts


def _moves(program: Program | PointPath) -> list[Move]:
    """The moves of a program; of a point path the straight ways between its points, the tool upright."""
    if isinstance(program, Program):
        return [a for a in program.actions if isinstance(a, Move)]
    points = program.points
    return [
        Move(b.line or i + 1, b.line or i + 1, a.position, b.position, None if b.rapid else b.feed, b.spindle_speed, 0.0, tool=b.tool)
        for i, (a, b) in enumerate(itertools.pairwise(points), start=1)
    ]


def _name(number: int) -> str:
    return f"tool T{number}" if number else "the tool"


def _missed(result: DryRun, size: Vector) -> str:
    """Where the path is and where the block."""
    ends = np.array([p for m in result.moves if m.feed is not None for p in (m.start, m.end)] or [m.end for m in result.moves]) * 1e3
    low, high = ends.min(axis=0), ends.max(axis=0)
    path = ", ".join(f"{a} {lo:.1f} .. {hi:.1f}" for a, lo, hi in zip("XYZ", low, high, strict=True))
    x, y, z = (1e3 * c for c in size)
    return (
        f"nothing is cut: the feed moves run over {path} mm of the workpiece frame, the block fills X {-x / 2:g} .. {x / 2:g}, "
        f"Y {-y / 2:g} .. {y / 2:g}, Z {-z:g} .. 0; check zero, work offsets, start and units"
    )
