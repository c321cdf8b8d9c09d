"""The G-code reader: what CAM systems write is understood; everything else is refused with one clear error."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robomill.models.planning.gcode import Arc, Dwell, GCodeError, Move, Setup, parse, read
from tests import SCENARIOS
from tests.tolerances import EXACT, ROUNDOFF, physics

START = "G21 G90 G17\nG0 X0 Y0 Z0\nF600\n"
"""Three lines: a known point and a feed of 10 mm/s."""

CAM = """%
O1001 (BRACKET)
(T1 D=16 Z=3)
N10 G90 G94 G17 G40 G49 G80
N15 G21
N20 G54 ; zero on top
N25 T1 M6
N30 S13000 M3
N35 G00 X-75. Y0
N40 G43 Z15. H01
N45 M8
N50 g1 z-1.5 f300.
N55 X75. (SLOT) F1500.
N60 G0 Z15.
N65 M9
N70 M5
N75 M30
%
N80 G1 X0
"""


def moves(text: str, **setup: Any) -> list[Move]:
    """Moves that follow START."""
    return [a for a in parse(START + text, setup=Setup(**setup)).actions if isinstance(a, Move)]


class TestCamProgram:
    """A program as a CAM system writes it."""

    def test_moves_in_metres(self) -> None:
        program = parse(CAM)
        first, second, third = program.actions
        assert isinstance(first, Move)
        assert isinstance(second, Move)
        assert isinstance(third, Move)
        np.testing.assert_allclose(first.start, (-0.075, 0.0, 0.015), rtol=ROUNDOFF)
        np.testing.assert_allclose(first.end, (-0.075, 0.0, -0.0015), rtol=ROUNDOFF)
        np.testing.assert_allclose(second.end, (0.075, 0.0, -0.0015), rtol=ROUNDOFF)
        assert third.feed is None

    def test_feed_speed_and_block_numbers(self) -> None:
        first, second, _ = parse(CAM).actions
        assert isinstance(first, Move)
        assert isinstance(second, Move)
        assert first.feed == pytest.approx(0.005, rel=ROUNDOFF)
        assert second.feed == pytest.approx(0.025, rel=ROUNDOFF)
        assert (first.block, first.line, second.block, second.line) == (50, 12, 55, 13)
        assert second.spindle_speed == pytest.approx(13000 * 2 * math.pi / 60, rel=ROUNDOFF)

    def test_tool_source_and_end(self) -> None:
        program = parse(CAM, "bracket.ngc")
        assert (program.name, program.tool, program.final_spindle_speed) == ("bracket.ngc", 1, 0.0)
        assert program.source[12].startswith("N55")
        assert len(program.actions) == 3  # nothing after M30 and the second %

    def test_begins_at_the_first_point_that_is_known(self) -> None:
        assert parse("G0 X1 Y2\nG0 Z3\nG0 X9\nM30").actions[0].start == pytest.approx((1e-3, 2e-3, 3e-3), rel=ROUNDOFF)

    def test_begins_at_a_given_point(self) -> None:
        (move,) = parse("G0 X10", setup=Setup(start=(0.0, 0.0, 0.1))).actions
        assert isinstance(move, Move)
        assert (move.start, move.end) == ((0.0, 0.0, 0.1), (0.01, 0.0, 0.1))


class TestModalState:
    """What stays until it is changed."""

    def test_motion_code_and_coordinates_are_modal(self) -> None:
        a, b = moves("G1 X10\nY5")
        assert b.start == a.end
        assert b.end == pytest.approx((0.010, 0.005, 0.0), rel=ROUNDOFF)

    def test_incremental(self) -> None:
        assert [m.end[0] for m in moves("G91 G1 X10\nX10\nG90 X5")] == pytest.approx([0.010, 0.020, 0.005], rel=ROUNDOFF)

    def test_inches(self) -> None:
        (move,) = moves("G20 G1 X1 F60")
        assert move.end[0] == pytest.approx(0.0254, rel=ROUNDOFF)
        assert move.feed == pytest.approx(0.0254, rel=ROUNDOFF)

    def test_work_offsets(self) -> None:
        a, b = moves("G55 G1 X1 Y1 Z1\nG54 X0 Y0 Z0", work_offsets={54: (0.0, 0.0, 0.0), 55: (0.1, 0.2, 0.3)})
        assert a.end == pytest.approx((0.101, 0.201, 0.301), rel=ROUNDOFF)
        assert b.end == (0.0, 0.0, 0.0)

    def test_path_control(self) -> None:
        given = [m.tolerance for m in moves("G1 X1\nG64 P0.5\nX2\nG61 X3\nG64 X4", tolerance=3e-4)]
        assert given == pytest.approx([3e-4, 5e-4, 0.0, 3e-4], rel=ROUNDOFF)

    def test_dwell_in_seconds(self) -> None:
        dwell = parse(START + "G1 X1\nG4 P0.5\nX2").actions[1]
        assert isinstance(dwell, Dwell)
        assert (dwell.duration, dwell.line) == (0.5, 5)

    def test_spindle_left_and_off(self) -> None:
        speeds = [m.spindle_speed for m in moves("S1000 M3 G1 X1\nM4 X2\nM5 X3")]
        assert speeds == pytest.approx([1000 * math.pi / 30, -1000 * math.pi / 30, 0.0], rel=ROUNDOFF)

    def test_blanks_case_and_leading_zeros_mean_nothing(self) -> None:
        assert moves("g 01 x 1 0 . y-.5")[0].end == moves("G1X10Y-0.5")[0].end

    def test_a_move_to_the_same_point_is_none(self) -> None:
        assert moves("G1 X0 Y0 Z0\nX1") == moves("\nG1 X1")


class TestArcs:
    """G2 and G3 in three planes, by centre and by radius."""

    def test_random_arcs_end_where_the_rotation_about_the_centre_leads(self) -> None:
        """100 seeded arcs and helices: rotating the start about the axis through the centre and climbing gives the end."""
        rng = np.random.default_rng(5)
        planes = {17: ("XYZ", "IJ"), 18: ("ZXY", "KI"), 19: ("YZX", "JK")}
        for _ in range(100):
            plane = int(rng.choice([17, 18, 19]))
            (u, v, w), (cu, cv) = planes[plane]
            angle = float(rng.uniform(0.05, 2 * math.pi - 0.05))
            centre = rng.uniform(-50, 50, 2)
            code = int(rng.choice([2, 3]))
            turn = angle if code == 3 else -angle
            rel = -centre  # the start is the origin
            end = centre + np.array([rel[0] * math.cos(turn) - rel[1] * math.sin(turn), rel[0] * math.sin(turn) + rel[1] * math.cos(turn)])
            climb = float(rng.uniform(-5, 5))
            text = f"G{plane} G{code} {u}{end[0]:.17f} {v}{end[1]:.17f} {w}{climb:.17f} {cu}{centre[0]:.17f} {cv}{centre[1]:.17f}"
            (arc,) = moves(text)
            assert isinstance(arc, Arc)
            assert arc.angle == pytest.approx(turn, rel=1e3 * ROUNDOFF)  # 17 decimals in mm, radius down to 1 mm
            assert arc.axis["XYZ".index(w)] == 1.0
            start, c, axis = np.array(arc.start), np.array(arc.centre), np.array(arc.axis)
            reached = c + Rotation.from_rotvec(arc.angle * axis).apply(start - c) + axis * climb * 1e-3
            np.testing.assert_allclose(reached, arc.end, rtol=0.0, atol=ROUNDOFF)

    @pytest.mark.parametrize(
        ("text", "degrees"), [("G3 X10 Y10 R10", 90), ("G3 X10 Y10 R-10", 270), ("G2 X10 Y10 R10", -90), ("G2 X10 Y10 R-10", -270)]
    )
    def test_positive_radius_is_the_short_arc_and_negative_the_long_one(self, text: str, degrees: float) -> None:
        (arc,) = moves(text)
        assert isinstance(arc, Arc)
        assert math.degrees(arc.angle) == pytest.approx(degrees, rel=ROUNDOFF)
        assert math.dist(arc.start, arc.centre) == pytest.approx(0.010, rel=ROUNDOFF)

    @pytest.mark.parametrize(("text", "turn"), [("G3 I5", 2 * math.pi), ("G2 X0 Y0 J-3", -2 * math.pi), ("G3 I5 Z-2", 2 * math.pi)])
    def test_equal_end_points_are_a_full_circle(self, text: str, turn: float) -> None:
        (arc,) = moves(text)
        assert isinstance(arc, Arc)
        assert arc.angle == turn

    def test_absolute_centre(self) -> None:
        arc = moves("G1 X10\nG90.1 G3 X0 Y10 I0 J0")[1]
        assert isinstance(arc, Arc)
        assert arc.centre == pytest.approx((0.0, 0.0, 0.0), abs=ROUNDOFF * 0.010)
        assert arc.angle == pytest.approx(math.pi / 2, rel=ROUNDOFF)

    def test_rounding_of_the_cam_system_is_taken_out_of_the_centre(self) -> None:
        """Three decimals: radii at start and end differ by up to 1 um; afterwards both points lie on one circle, the centre within 1 um."""
        (arc,) = moves("G3 X7.071 Y2.929 I0 J10")
        assert isinstance(arc, Arc)
        assert math.dist(arc.start, arc.centre) == pytest.approx(math.dist(arc.end, arc.centre), rel=ROUNDOFF)
        assert math.dist(arc.centre, (0.0, 0.010, 0.0)) < physics(1e-6, relative=1.0)


ERRORS = [
    ("G41 D1 X5", 4, "G41", "cutter radius compensation"),
    ("G42.1 D3 X5", 4, "G42.1", "cutter radius compensation"),
    ("G1 X#3", 4, "#3", "variables"),
    ("#1=5", 4, "#1", "variables"),
    ("G1 X[1+2]", 4, "[1+2]", "expressions"),
    ("G1 X#<depth>", 4, "#<DEPTH>", "variables"),
    ("o100 sub", 4, "O100SUB", "subroutines"),
    ("o<hole> call [1]", 4, "O<HOLE>CALL", "subroutines"),
    ("o100 while [#1 lt 3]", 4, "O100WHILE", "branches and loops"),
    ("WHILE [#1 LT 3] DO1", 4, "WHILE", "macros"),
    ("N10 GOTO 20", 4, "GOTO20", "macros"),
    ("M98 P1000", 4, "M98", "subroutines"),
    ("G65 P9000", 4, "G65", "macros"),
    ("G1 A30", 4, "A30", "rotary axis A"),
    ("G1 X1 U2", 4, "U2", "secondary axis U"),
    ("G16", 4, "G16", "polar coordinates"),
    ("G68 X0 Y0 R30", 4, "G68", "rotated coordinates"),
    ("G51 X0 Y0 P2", 4, "G51", "scaling"),
    ("G38.2 Z-5", 4, "G38.2", "probing"),
    ("G5.2 X1 Y1 P1", 4, "G5.2", "splines"),
    ("G33 Z-1 K1", 4, "G33", "threads"),
    ("G54.1 P3", 4, "G54.1", "work offsets"),
    ("G123", 4, "G123", "supported: G0 G1"),
    ("0 BEGIN PGM PART MM", 4, "BEGINPGM", "Heidenhain"),
    ("MSG", 4, "MSG", "one letter and one number"),
    ("R1=5", 4, "R1=5", "Sinumerik"),
    ("G1 X5,R2", 4, ",R2", "corner rounding"),
    ("G1 X1 X2", 4, "two X words", "once"),
    ("G0 G1 X1", 4, "G0 and G1", "one code of a group"),
    ("M3 M4 S1", 4, "M3 and M4", "one code of a group"),
    ("G1 X1.2.3", 4, ".3", "one letter and one number"),
    ("G1 X", 4, "'X'", "one letter and one number"),
    ("G1 X1 (open", 4, "comment", "one line"),
    ("X5 N10", 4, "N10", "beginning of the line"),
    ("F0\nG1 X1", 5, "G1 without a feed", "F1500"),
    ("G1 X1 F-5", 4, "F-5", "positive"),
    ("S-5", 4, "S-5", "M4"),
    ("T1.5 M6", 4, "T1.5", "whole number"),
    ("G55", 4, "G55", "given: G54"),
    ("G64 P-1", 4, "P-1", "G61"),
    ("G4", 4, "G4", "seconds"),
    ("G4 P1 X5", 4, "G4", "alone"),
    ("G1 X5 R3", 4, "R3", "belong to G2/G3"),
    ("G2 X5", 4, "neither a centre nor R", "I J K"),
    ("G2 X5 I2.5 R2.5", 4, "both a centre and R", "I J K"),
    ("G2 X10 I4", 4, "radius 4.0000 mm at its start and 6.0000 mm at its end, 2.0000 mm apart", "G90.1/G91.1"),
    ("G2 X10 K4", 4, "K4 with G17", "I and J"),
    ("G2 X10 R4", 4, "R4", "at least 5"),
    ("G3 R4", 4, "full circle", "I J K"),
    ("G3 I5 P0.5", 4, "P0.5", "turns"),
    ("G93\nG1 X5", 5, "without F", "G93"),
    ("G95 F0.1\nG1 X5", 5, "spindle stands", "S13000 M3"),
    ("G10 L7 P1 X1", 4, "L7", "L20"),
    ("G81 X1 Y1 R2 Z5", 4, "over its retract height", "R must be over"),
    ("G83 X1 Y1 R2 Z-5", 4, "G83 without Q", "peck"),
    ("G82 X1 Y1 R2", 4, "G82 without Z", "depth"),
]


class TestRefusals:
    """One error with line, finding and what is supported."""

    @pytest.mark.parametrize(("text", "line", "found", "supported"), ERRORS)
    def test_refused(self, text: str, line: int, found: str, supported: str) -> None:
        with pytest.raises(GCodeError) as caught:
            parse(START + text, "part.ngc")
        message = str(caught.value)
        assert message.startswith(f"part.ngc line {line}: ")
        assert caught.value.line == line
        assert found in message
        assert supported in message

    def test_missing_feed(self) -> None:
        with pytest.raises(GCodeError, match=r"line 2: G1 without a feed .* F1500"):
            parse("G0 X0 Y0 Z0\nG1 X5")

    def test_program_without_a_move(self) -> None:
        with pytest.raises(GCodeError, match="no move"):
            parse("G21\nM30")
        with pytest.raises(GCodeError, match="no move"):
            parse("G0 X0 Y0 Z0\nG4 P1\nM30")

    def test_missing_file(self) -> None:
        with pytest.raises(FileNotFoundError, match=r"no program file nowhere\.ngc"):
            read("nowhere.ngc")


class TestScenarioPrograms:
    """The two programs that the experiments run."""

    def test_groove_enters_and_leaves_outside_the_block(self) -> None:
        """Block 100 mm, cutter 16 mm: the cutter starts and ends at least 15 mm clear of the block."""
        program = read(SCENARIOS / "groove.ngc")
        (cut,) = [a for a in program.actions if isinstance(a, Move) and a.feed and a.start[0] != a.end[0]]
        assert cut.start[0] <= -0.050 - 0.008 - 0.015
        assert cut.end[0] >= 0.050 + 0.008 + 0.015
        assert cut.feed == pytest.approx(0.025, rel=ROUNDOFF)
        assert cut.start[2] == cut.end[2]
        assert -0.0125 < cut.end[2] < -0.0110  # S000: forces up to 546 N mean about 11.8 mm
        assert cut.spindle_speed == pytest.approx(13000 * math.pi / 30, rel=ROUNDOFF)

    def test_test_part_has_grooves_ramps_and_a_helical_pocket(self) -> None:
        program = read(SCENARIOS / "test_part.ngc")
        cuts = [a for a in program.actions if isinstance(a, Move) and a.feed is not None]
        below = [c for c in cuts if min(c.start[2], c.end[2]) < 0.0 and not isinstance(c, Arc)]
        along_x = [c for c in below if c.start[0] != c.end[0] and c.start[2] == c.end[2]]
        along_y = [c for c in below if c.start[1] != c.end[1] and c.start[2] == c.end[2]]
        slopes = [math.copysign(1.0, c.end[2] - c.start[2]) for c in below if c.start[0] != c.end[0] and c.start[2] != c.end[2]]
        helices = [c for c in cuts if isinstance(c, Arc) and c.start[2] != c.end[2]]
        circles = [c for c in cuts if isinstance(c, Arc) and c.start == c.end]
        assert along_x
        assert along_y
        assert sorted(slopes) == [-1.0, 1.0]
        assert len(helices) == 3
        assert circles
        assert all(c.feed == pytest.approx(0.025, rel=ROUNDOFF) for c in cuts)
        assert -0.0125 < min(c.end[2] for c in cuts) < -0.0110
        assert all(c.spindle_speed == cuts[0].spindle_speed > EXACT for c in cuts)
