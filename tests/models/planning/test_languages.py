"""Programs for controllers: KRL, RAPID and G-code from one internal form, and back."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robomill.cell.points import parse_points, read_points
from robomill.models.planning.blend import bezier_control, bezier_derivatives
from robomill.models.planning.gcode import parse, read
from robomill.models.planning.languages import (
    Frames,
    LanguageError,
    PoseProgram,
    pose_program,
    read_krl,
    read_rapid,
    write_gcode,
    write_krl,
    write_rapid,
)
from robomill.models.planning.languages.convert import CHORD, path_of, placement_of, poses_of
from robomill.models.planning.languages.gcode_text import deviations
from robomill.models.planning.languages.poses import abc_degrees, quaternions
from robomill.models.planning.path_geometry import line
from robomill.models.planning.trajectory import Placement, plan
from robomill.models.robot.kinematics import KR300, SPINDLE_ACROSS
from tests import SCENARIOS
from tests.tolerances import EXACT, ROUNDOFF, discretisation

HERE = Placement((1.595, -0.018, 1.099), (0.3, 0.1, -0.2))
LENGTH = 0.5e-7 * 1.001
"""m: half of the fourth decimal of a mm, and roundoff."""
TURN = 3 * math.radians(0.5e-5) * 1.001
"""rad: half of the fifth decimal of a degree in each of three angles; eight decimals of a quaternion are finer (4e-8)."""
FEED = 0.5e-6 * 1.001
"""m/s: half of the sixth decimal of $VEL.CP; RAPID has a seventh."""
SPEED = 0.5e-3 * math.pi / 30.0 * 1.001
"""rad/s: half of the third decimal of a rev/min."""
DURATION = 1e-4
"""s: what the printed digits do to 0.3 m of path at 25 mm/s, where corners are slowed by the rotation in them."""
PLACE = 1e-6
"""m: the tool at the same time, DURATION times 10 mm/s, as slowly as it goes through those corners."""
SHORTER = 0.02
"""Relative: the planner measures deviations on 64 chords, to 1e-3 of them; blends of chords are slower by as much in their radius."""
STOPPED = 1e-3
"""s: deviations to 1e-3 of blends of 2 mm at 25 mm/s."""
CUT = 1e-5
"""m: deviations to 1e-3 of blends of 2 mm."""
WRITE_READ = [(write_krl, read_krl), (write_rapid, read_rapid)]
Writer, Reader = Callable[[PoseProgram], str], Callable[[str], PoseProgram]


def part() -> PoseProgram:
    """The test part of the thesis: squares and circles, rapids, a tool, a spindle."""
    return poses_of(read(SCENARIOS / "parts/squares_circle.ngc"), HERE, SPINDLE_ACROSS, KR300.q_home, header=["from a test", "as planned"])


def tilted() -> PoseProgram:
    return poses_of(read_points(SCENARIOS / "parts/tilted_square.toml"), HERE, SPINDLE_ACROSS)


def random_program() -> PoseProgram:
    """Everything at once: any orientation, upright and inverted tools among them, changes of tool and spindle, dwells, comments."""
    rng = np.random.default_rng(4)
    n = 60
    quat = np.roll(Rotation.random(n, random_state=4).as_quat(canonical=True), 1, axis=1)
    quat[10:20] = quaternions(np.column_stack([rng.uniform(-180, 180, 10), np.full(10, 90.0), np.zeros(10)]))
    quat[20:25] = quaternions(np.column_stack([rng.uniform(-180, 180, 5), np.full(5, -90.0), np.zeros(5)]))
    quat[25:30] = quaternions(np.array([[180.0, 0, 180], [0, 180, 0], [-180, 0, 0], [0, 0, -180], [90, 89.99999, 0]]))
    return pose_program(
        "all_of_it",
        Frames.at(HERE, SPINDLE_ACROSS, KR300.q_home),
        rng.uniform(-1, 1, (n, 3)),
        quat,
        rng.choice([0.01, 0.025, 0.1], n),
        rng.choice([0.0, 1e-3, 5e-3], n),
        np.repeat([0.0, 1300.0, -700.0], 20),
        np.repeat([0, 1, 1, 4], 15),
        np.where(np.arange(n) == 33, 0.5, 0.0),
        np.arange(n) % 7 == 0,
        comments={0: "begins here", 40: "still (going)"},
        header=["from nothing", "by a test"],
    )


PROGRAMS = pytest.mark.parametrize("made", [part, tilted, random_program])


class TestRoundTrip:
    """What is written is read as the same, to the printed digits."""

    @PROGRAMS
    @pytest.mark.parametrize(("write", "back"), WRITE_READ)
    def test_program_read_back_is_the_program(self, made: Callable[[], PoseProgram], write: Writer, back: Reader) -> None:
        program = made()
        found = back(write(program))
        np.testing.assert_allclose(found.p, program.p, rtol=0.0, atol=LENGTH)
        turned = Rotation.from_quat(np.roll(found.quat, -1, axis=1)).inv() * Rotation.from_quat(np.roll(program.quat, -1, axis=1))
        assert np.max(turned.magnitude()) <= TURN
        np.testing.assert_allclose(found.feed, program.feed, rtol=0.0, atol=FEED)
        np.testing.assert_allclose(found.blend, program.blend, rtol=0.0, atol=LENGTH)
        np.testing.assert_allclose(found.spindle_speed, program.spindle_speed, rtol=0.0, atol=SPEED)
        for name in ("tool", "dwell", "rapid"):
            np.testing.assert_array_equal(getattr(found, name), getattr(program, name))
        assert (dict(found.comments), found.header) == (dict(program.comments), program.header)
        frames, told = found.frames, program.frames
        np.testing.assert_allclose(frames.p_BP_B, told.p_BP_B, rtol=0.0, atol=LENGTH)
        np.testing.assert_allclose(frames.p_FG_F, told.p_FG_F, rtol=0.0, atol=LENGTH)
        np.testing.assert_allclose(frames.quat_BP, told.quat_BP, rtol=0.0, atol=TURN)
        assert frames.mass == told.mass
        assert (frames.q_start is None) == (told.q_start is None)

    @PROGRAMS
    @pytest.mark.parametrize(("write", "back"), WRITE_READ)
    def test_written_again_it_is_the_same_text(self, made: Callable[[], PoseProgram], write: Writer, back: Reader) -> None:
        text = write(made())
        assert write(back(text)) == text

    def test_splines(self) -> None:
        program = dataclasses.replace(random_program(), motion="spline", blend=np.zeros(60))
        text = write_krl(program)
        assert text.count("SPLINE WITH") == text.count("ENDSPLINE") > 3
        found = read_krl(text)
        assert found.motion == "spline"
        np.testing.assert_allclose(found.feed, program.feed, rtol=0.0, atol=FEED)
        np.testing.assert_array_equal(found.rapid, program.rapid)
        assert write_krl(found) == text
        assert plan(path_of(found), HERE).duration > 0.0

    def test_angles_of_an_upright_tool_have_c_zero(self) -> None:
        """At B = 90 deg only A - C is determined: any quaternion there is written with C = 0, and means the same rotation."""
        quat = quaternions(np.array([[30.0, 90.0, 70.0], [10.0, -90.0, 50.0]]))
        abc = abc_degrees(quat)
        np.testing.assert_allclose(abc, [[-40.0, 90.0, 0.0], [60.0, -90.0, 0.0]], rtol=0.0, atol=1e3 * ROUNDOFF)
        np.testing.assert_allclose(np.abs(np.sum(quaternions(abc) * quat, axis=1)), 1.0, rtol=10 * ROUNDOFF)


class TestSamePath:
    """The path that is planned from the text is the path of the program."""

    @pytest.mark.parametrize(("write", "back"), WRITE_READ)
    def test_tilted_square(self, write: Writer, back: Reader) -> None:
        """Orientation over the whole way, from a robot program as from the path of points: the same pose at the same time."""
        nominal = plan(read_points(SCENARIOS / "parts/tilted_square.toml"), HERE)
        found = back(write(tilted()))
        again = plan(path_of(found), placement_of(found.frames))
        tau = np.linspace(0.0, nominal.duration, 501)
        assert again.duration == pytest.approx(nominal.duration, abs=DURATION)
        np.testing.assert_allclose(again.position(tau), nominal.position(tau), rtol=0.0, atol=PLACE)
        assert np.max((again.rotation(tau).inv() * nominal.rotation(tau)).magnitude()) < 10.0 * TURN

    def test_arcs_are_chords(self) -> None:
        """Every pose on the contour of the circle is on it, and no chord is farther off than promised."""
        program = poses_of(parse("G21 G90 G0 X30 Y0 Z0\nF1500 G3 X30 Y0 I-30 J0\n"), HERE, SPINDLE_ACROSS)
        np.testing.assert_allclose(np.linalg.norm(program.p[:, :2], axis=1), 0.03, rtol=ROUNDOFF)
        middle = 0.5 * (program.p[1:] + program.p[:-1])
        assert np.min(np.linalg.norm(middle[1:, :2], axis=1)) >= 0.03 - CHORD * (1.0 + 1e-9)

    def test_gcode_gives_the_blends_of_the_poses(self) -> None:
        """Read and planned, the corners are blended over the same distance: duration and length are those of the poses."""
        program = part()
        poses, text = plan(path_of(program), HERE), plan(parse(write_gcode(program)), HERE)
        assert text.length == pytest.approx(poses.length, abs=len(program.p) * 1e-7)  # four decimals of a mm at each end
        assert text.duration == pytest.approx(poses.duration, rel=SHORTER)
        assert "G64 P0.5000" in write_gcode(program, 0.5e-3)

    def test_exact_stops_between_blends(self) -> None:
        """A corner without blend between blended ones is a stop in G-code, too: there the path rests."""
        p = np.array([[0, 0, 0], [20, 0, 0], [20, 20, 0], [0, 20, 0], [0, 40, 0], [20, 40, 0]]) * 1e-3
        quat = quaternions(np.array([[0.0, 90.0, 0.0]]))[0]
        program = pose_program(
            "stops", Frames.at(HERE, SPINDLE_ACROSS), p, quat, 0.025, [0, 1e-3, 0, 2e-3, 1e-3, 0], rapid=[True] + 5 * [False]
        )
        poses, text = plan(path_of(program), HERE), plan(parse(write_gcode(program)), HERE)
        assert write_gcode(program).count("G4 P0.000") == 1
        assert text.duration == pytest.approx(poses.duration, abs=STOPPED)
        assert text.length == pytest.approx(poses.length, abs=CUT)

    def test_deviation_of_a_blend_in_closed_form(self) -> None:
        """Against the middle of the Bezier curve: the nearest point to the corner, by symmetry."""
        for degrees in (5.0, 45.0, 90.0, 135.0):
            angle, d = math.radians(degrees), 2e-3
            p = np.array([[-0.01, 0.0, 0.0], [0.0, 0.0, 0.0], [0.01 * math.cos(angle), 0.01 * math.sin(angle), 0.0]])
            control = bezier_control(line(p[0], p[1]), line(p[1], p[2]), d)
            expected = np.linalg.norm(bezier_derivatives(control, 0.5)[0])
            assert deviations(p, np.array([0.0, d, 0.0]))[1] == pytest.approx(expected, rel=10 * ROUNDOFF)

    def test_pose_times_are_kept(self) -> None:
        """Spindle, tool and rapid of each pose stand in the plan; blends end where the robot has to stand."""
        found = path_of(random_program())
        assert [p.tool for p in found.points][::15] == [0, 1, 1, 4]
        assert found.points[19].blend == found.points[33].blend == found.points[59].blend == EXACT


KRL = write_krl(tilted()).splitlines()
RAPID = write_rapid(tilted()).splitlines()


def with_line(lines: list[str], beginning: str, text: str | None) -> tuple[str, int]:
    """The program with the first line that begins so replaced, or taken out; and the number of that line."""
    number = next(i for i, line in enumerate(lines) if line.strip().startswith(beginning))
    changed = [*lines[:number], *([] if text is None else [text]), *lines[number + 1 :]]
    return "\n".join(changed), number + 1


class TestRefusals:
    """Other programs are refused with line, reason and remedy."""

    @pytest.mark.parametrize(
        ("beginning", "text", "found"),
        [
            ("LIN {X 40", "CIRC {X 1,Y 2,Z 3},{X 4,Y 5,Z 6}", "a statement that is not read back in 'CIRC {X 1"),
            ("LIN {X 40", "LIN_REL {X 1}", "a statement that is not read back in 'LIN_REL"),
            ("LIN {X 40", "LIN XP5 C_DIS", "a statement that is not read back in 'LIN XP5"),
            ("LIN {X 40", "FOR I=1 TO 5", "a statement that is not read back in 'FOR I=1"),
            ("LIN {X 40", "$BASE={X 0,Y 0,Z 0,A 0,B 0,C 0}", "a frame, load or PTP after the first LIN"),
            ("LIN {X 40", "SPL {X 0,Y 0,Z 0,A 0,B 0,C 0}", "a statement that is not read back in 'SPL"),
            ("LIN {X 40", "TOOL_CHANGE (1.5 )", "a tool that is no whole number"),
            ("$APO", "$APO.CDIS=0", "a distance that is not positive"),
            ("$APO", None, "C_DIS before $APO.CDIS"),
            ("$VEL", None, "LIN before $VEL.CP"),
            ("$VEL", "$VEL.CP=0.0", "a speed that is not positive"),
            ("$VEL", "WAIT SEC 1.0", "WAIT before the first LIN"),
            ("$VEL", "SPLINE WITH $VEL.CP=0.1", "SPLINE before the first LIN"),
            ("DEF", "DEFDAT PART", "a statement before DEF name ( )"),
            ("END", None, "the end of the file without END"),
            ("$BASE", None, "no $BASE"),
            ("$TOOL", None, "no $TOOL"),
        ],
    )
    def test_krl(self, beginning: str, text: str | None, found: str) -> None:
        program, number = with_line(KRL, beginning, text)
        with pytest.raises(LanguageError, match=re.escape(found)) as caught:
            read_krl(program, "other.src")
        assert str(caught.value).startswith(f"other.src line {caught.value.line}: ")
        if text is not None and "SPLINE" not in text:
            assert caught.value.line == number

    def test_remedy_of_krl(self) -> None:
        program, number = with_line(KRL, "LIN {X 40", "PTP XHOME")
        with pytest.raises(LanguageError) as caught:
            read_krl(program, "other.src")
        assert str(caught.value) == (
            f"other.src line {number}: a statement that is not read back in 'PTP XHOME'; only the KRL that robomill writes is read back: "
            "$BASE, $TOOL, $LOAD, $VEL.CP, $APO.CDIS, LIN, SPLINE with SPL, WAIT SEC, SPINDLE, TOOL_CHANGE; program the part in G-code, "
            "or as a path of points (TOML)"
        )

    @pytest.mark.parametrize(
        ("beginning", "text", "found"),
        [
            ("MoveL [[40", "MoveC p1,p2,v100,z10,tool0;", "an instruction that is not read back in 'MoveC"),
            ("MoveL [[40", "MoveL Offs(p1,0,0,5),feed1,fine,spindle_tool;", "an instruction that is not read back in 'MoveL Offs"),
            ("MoveL [[40", "WHILE TRUE DO", "an instruction that is not read back in 'WHILE"),
            ("MoveL [[40", "ToolChange 1.5;", "a tool that is no whole number"),
            ("CONST zonedata", None, "zone1, which is not declared above,"),
            ("CONST speeddata", None, "feed1, which is not declared above,"),
            ("CONST speeddata", "CONST robtarget p10:=[];", "a declaration that is not read back"),
            ("CONST speeddata", "CONST speeddata feed1:=[0,500,5000,1000];", "a speed or zone that is not positive"),
            ("PERS tooldata", None, "no tooldata spindle_tool"),
            ("PERS wobjdata", None, "no wobjdata workpiece"),
            ("MODULE", "%%%", "a statement before MODULE name"),
            ("SpindleSpeed", "WaitTime 1.0;", "WaitTime before the first MoveL"),
            ("ENDMODULE", None, "the end of the file without ENDMODULE"),
            ("ENDMODULE", "PROC other()", "a statement behind ENDPROC"),
        ],
    )
    def test_rapid(self, beginning: str, text: str | None, found: str) -> None:
        program, number = with_line(RAPID, beginning, text)
        with pytest.raises(LanguageError, match=re.escape(found)) as caught:
            read_rapid(program, "other.mod")
        assert str(caught.value).startswith(f"other.mod line {caught.value.line}: ")
        if text is not None:
            assert caught.value.line == number

    def test_quaternion_of_another_length(self) -> None:
        move = next(line for line in RAPID if "MoveL [[40" in line)
        program, number = with_line(RAPID, "MoveL [[40", move.replace("[0.7", "[0.8"))
        with pytest.raises(LanguageError, match="a quaternion that is not of unit length") as caught:
            read_rapid(program)
        assert caught.value.line == number

    @pytest.mark.parametrize(("back", "text"), [(read_krl, "DEF A ( )\n"), (read_rapid, "MODULE A\n"), (read_krl, ""), (read_rapid, "")])
    def test_cut_off(self, back: Reader, text: str) -> None:
        with pytest.raises(LanguageError, match="the file is cut off; write it anew"):
            back(text)

    def test_one_pose(self) -> None:
        moves = [i for i, line in enumerate(KRL) if line.startswith("LIN")]
        with pytest.raises(LanguageError, match="1 moves in 'END'; a path needs at least two poses"):
            read_krl("\n".join(line for i, line in enumerate(KRL) if i not in moves[1:]))

    def test_what_languages_do_not_have(self) -> None:
        spline = dataclasses.replace(tilted(), motion="spline", blend=np.zeros(5))
        with pytest.raises(ValueError, match="RAPID has no splines through poses; write KRL"):
            write_rapid(spline)
        with pytest.raises(ValueError, match="G-code has no splines"):
            write_gcode(spline)
        with pytest.raises(
            ValueError, match=r"at pose \d the tool leans by 1\d(\.\d+)? deg; G-code of three axes has no orientation; write KRL"
        ):
            write_gcode(tilted())
        with pytest.raises(ValueError, match="tooldata need the mass of the end effector, found 0 kg"):
            write_rapid(dataclasses.replace(part(), frames=dataclasses.replace(part().frames, mass=0.0)))
        corner = parse_points(
            'orientation = "corner"\n[[point]]\nposition = [0, 0, 0]\nfeed = 25\n[[point]]\nposition = [9, 0, 0]\norientation = [0, 5, 0]'
        )
        with pytest.raises(ValueError, match="a controller turns it on the way from pose to pose"):
            poses_of(corner, HERE, SPINDLE_ACROSS)

    @pytest.mark.parametrize(
        ("change", "text"),
        [
            ({"p": np.zeros((1, 3))}, r"positions have shape \(1, 3\); expected \(n, 3\) with n >= 2"),
            ({"feed": np.ones(3)}, "expected one value or one for each of the 2 poses"),
            ({"feed": 0.0}, "feed of pose 0 is 0; it must be positive"),
            ({"blend": -1.0}, "blend of pose 0 is -1; it must be not negative"),
            ({"dwell": math.nan}, "dwell of pose 0 is not finite"),
            ({"quat": np.array([1.0, 0.0, 0.0, 0.1])}, "of pose 0 is not of unit length; divide it by 1.00"),
            ({"blend": 1e-3, "motion": "spline"}, "a spline goes through its poses and has no blends"),
            ({"comments": {0: "a\nb"}}, "has more than one line"),
        ],
    )
    def test_programs_that_are_none(self, change: dict[str, object], text: str) -> None:
        values: dict[str, object] = {"p": np.eye(3)[:2], "quat": np.array([1.0, 0.0, 0.0, 0.0]), "feed": 0.1}
        with pytest.raises(ValueError, match=text):
            pose_program("bad", tilted().frames, **(values | change))  # type: ignore[arg-type]


def test_names_that_languages_take() -> None:
    program = dataclasses.replace(tilted(), name="1st part: a name that is too long for a controller")
    assert write_krl(program).startswith("DEF P_1st_part__a_name_that_ ( )\n")
    assert write_rapid(program).startswith("MODULE P_1st_part__a_name_that_is_too_l\n")


def test_twenty_thousand_poses_are_read_in_linear_work() -> None:
    """No limit on length: rows and lines only grow with the poses, which are all there."""
    n = 20_000
    p = np.column_stack([np.linspace(0.0, 1.0, n), 0.01 * np.sin(np.arange(n)), np.zeros(n)])
    program = pose_program("long", tilted().frames, p, np.array([1.0, 0.0, 0.0, 0.0]), 0.025, 1e-4)
    found = read_krl(write_krl(program))
    assert len(found.p) == n
    assert np.max(np.abs(found.p - p)) <= discretisation(0.5e-7, 1.001, 1)
