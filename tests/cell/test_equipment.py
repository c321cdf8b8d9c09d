"""Robot, tool, material and sensor named once: every component gets them, and what contradicts them is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from robomill.cell.binding import convert, resolve
from robomill.cell.equipment import load_system, robot_of, tool_of
from robomill.cell.milling import mill, prepare
from robomill.cell.scenario import ScenarioError, equipment, load_scenario
from robomill.joints import arm, geometry, projections
from robomill.models.model.parameters import load
from robomill.models.process.cutting import CuttingCoefficients
from robomill.models.robot.kinematics import SPINDLE_ACROSS, load_robot, tool_pose
from robomill.models.robot.numeric_inverse import kinematics
from robomill.models.robot.virtual_joints import load_compliance
from robomill.orchestration.assembly import assemble
from robomill.orchestration.errors import SystemFileError
from robomill.orchestration.runs.run import Run
from robomill.orchestration.system.definition import System
from robomill.orchestration.system.entries import Entry
from robomill.orchestration.system.toml_text import dump
from tests.models.robot.test_robots import chain, joints, oracle
from tests.tolerances import physics

SCENARIOS = Path(__file__).parents[2] / "scenarios"
SLOTS = sorted((SCENARIOS / "robots").glob("*.toml"))
CELL = (SCENARIOS / "milling_cell.toml").read_text()
X, Y, Z = np.eye(3)


def cell(tmp_path: Path, old: str = "", new: str = "") -> Path:
    assert old in CELL
    file = tmp_path / "cell.toml"
    file.write_text(CELL.replace(old, new, 1) if old else CELL)
    return file


def tables(folder: Path, **named: dict[str, object]) -> dict[str, Entry]:
    """Equipment as a scenario names it."""
    (folder / "scenario.toml").write_text(dump(named))
    return equipment(Entry.load(folder / "scenario.toml", ScenarioError))


def springs(name: str, sensor_scale: float) -> list[tuple[int, np.ndarray, np.ndarray, float]]:
    """(joint that carries it, place, axis at zero angles, stiffness) of every spring, from drawings: no DH table, no kernel.

    Joint 0 is the base; a drive turns with the joint before it. Rows of the file: k_C, k_B, k_A; where two of a row are tilts, they are
    about any two directions across the axis if equal, else about those of the source: along the link, up, across.
    """
    rows, arms = load_compliance(name).stiffness.copy(), chain(name)
    rows[8] *= sensor_scale
    found = []
    for axis, row in enumerate((0, 1, 3, 5, 6, 7)):
        place, z = arms[axis]
        if axis == 0:  # the springs of axis 1 sit at the height of axis 2 (paper 000, Fig. 1)
            place = place + arms[1][0] * Z
        across = np.cross(z, X if abs(z @ X) < 0.5 else Y)
        found += [(axis + 1, place, d, k) for d, k in zip((across, np.cross(z, across), z), rows[row], strict=True)]
    if np.all(rows[8] < 1e20):  # KUKA with an end effector: stretched forward at zero angles, tool axis down
        shoulder, elbow, wrist, flange = arms[1][0], arms[2][0], arms[3][0], arms[6][0]
        found += [(2, 0.5 * (shoulder + elbow), d, k) for d, k in zip((X, Z, Y), rows[2], strict=True)]
        found += [(3, 0.5 * (elbow + wrist), d, k) for d, k in zip((Z, Y, X), rows[4], strict=True)]
        for row, ahead in ((8, 0.028), (9, 0.1)):
            found += [(6, flange + ahead * X, d, k) for d, k in zip((Z, Y, X), rows[row], strict=True)]
    return found


def deflection(name: str, q: np.ndarray, f: np.ndarray, m: np.ndarray, sensor_scale: float) -> np.ndarray:
    """Displacement of the tool tip [m] to first order: sum over the springs of g (g . load) / k, in the pose that Pinocchio gives."""
    model, data = oracle(name)
    pin.forwardKinematics(model, data, joints(name, q))
    places = chain(name)
    home_tip, _ = np.zeros(3), np.zeros((3, 3))
    tool_pose(kinematics(load_robot(name), SPINDLE_ACROSS), np.zeros(6), home_tip, _)  # checked in test_robots

    def at(joint: int, point: np.ndarray) -> np.ndarray:
        """A point that stands at `point` when all angles are zero and moves with the joint."""
        return data.oMi[joint].act(point - places[joint - 1][0])

    tip = at(6, home_tip)
    load = np.r_[f, m]
    total = np.zeros(3)
    coupled = np.array([joints(name, e) - joints(name, np.zeros(6)) for e in np.eye(6)]).T
    screws = []
    for joint, place, axis, k in springs(name, sensor_scale):
        direction = data.oMi[joint].rotation @ axis
        screws.append((joint, np.r_[np.cross(direction, tip - at(joint, place)), direction], k, axis))
    drives = [g for joint, g, _, axis in screws if np.array_equal(axis, places[joint - 1][1])][:6]
    for joint, g, k, axis in screws:
        if np.array_equal(axis, places[joint - 1][1]) and any(g is d for d in drives):
            whole = sum((coupled[i, joint - 1] * drives[i] for i in range(6)), np.zeros(6))
        else:
            whole = g
        total += whole[:3] * float(whole @ load) / k
    return total + shift(name, q, f)


def shift(name: str, q: np.ndarray, f: np.ndarray) -> np.ndarray:
    """What the springs along the axes yield [m]: alike in all directions at the axes, and along those of the tool at its frame."""
    along = load_compliance(name).translation_compliance
    drives = along[[0, 1, 3, 5, 6, 7]]
    assert np.array_equal(drives, np.full_like(drives, drives[0, 0]))
    place, R = np.zeros(3), np.zeros((3, 3))
    tool_pose(kinematics(load_robot(name), SPINDLE_ACROSS), q, place, R)
    return np.asarray(drives[:, 0].sum() * f + R @ (along[10] * (R.T @ f)))


@pytest.mark.slow
@pytest.mark.parametrize("file", SLOTS, ids=lambda f: f.stem)
def test_a_slot_with_each_robot_bends_as_calculated_independently(file: Path, tmp_path: Path) -> None:
    """First order against the full chain: less than 2 um at 2 mm (FACTS 1.7), so 1e-6 of a metre at half of that."""
    scenario = load_scenario(file)
    job = prepare(scenario, tmp_path)
    run, _ = mill(job, scenario.variants[0])
    assert run.info["robot"] == load_robot(file.stem).name
    q, d = run["compliance.q_link"] if "compliance.q_link[1]" in run.columns else run["drive.q_link"], run["compliance.d_T_B"]
    f, m = run["milling.f_T_B"], run["milling.m_T_B"]
    bent = np.linalg.norm(d, axis=1)
    assert bent.max() > 1e-4
    for k in np.linspace(1, len(bent) - 1, 40).astype(int):
        # the load reaches the robot one step later (scenarios/milling_cell.toml: delayed)
        expected = deflection(file.stem, q[k], f[k - 1], m[k - 1], 0.1)
        assert np.abs(d[k] - expected).max() < physics(bent[k], relative=2e-3, absolute=2e-7), k


class TestEverybodyGetsIt:
    def test_all_components_have_the_geometry_of_the_robot(self, tmp_path: Path) -> None:
        system = load_system(cell(tmp_path, 'name = "kr300_r2500_ultra"', 'name = "kr210_2"'))
        robot = load_robot("kr210_2")
        with assemble(system, resolve, convert) as assembly:
            for name in ("path", "drive", "compliance", "sensor", "controller"):
                values = assembly.parameters[name]
                assert [values[f"dh_d[{i}]"] for i in range(1, 7)] == robot.dh_d.tolist(), name
            assert [assembly.parameters["path"][f"q_start[{i}]"] for i in range(1, 7)] == robot.q_home.tolist()
        assert robot_of(system).name == system.labels["robot"] == "KUKA KR 210-2"
        assert tool_of(system).name == "spindle across the flange"

    def test_tool_material_and_sensor(self, tmp_path: Path) -> None:
        named = tables(tmp_path, tool={"name": "spindle_across"}, material={"name": "al7075_t6"}, sensor={"name": "ati_omega160_si1000"})
        system = load_system(cell(tmp_path), named)
        with assemble(system, resolve, convert) as assembly:
            assert assembly.parameters["milling"]["Ktc"] == load(CuttingCoefficients, "materials/al7075_t6").Ktc
            assert assembly.parameters["sensor"]["range_f[1]"] == 1000.0
        assert system.labels["material"] == "al7075_t6"

    def test_what_the_components_start_with_is_not_set_again(self, tmp_path: Path) -> None:
        system = load_system(cell(tmp_path))
        assert {c.name: dict(c.parameters) for c in system.components}["controller"] == {}

    def test_an_own_robot_and_its_springs_in_files(self, tmp_path: Path) -> None:
        data = Path(__file__).parents[2] / "models" / "data"
        (tmp_path / "mine.toml").write_text((data / "robots/kr300_r2500_ultra.toml").read_text().replace("1150.0", "1200.0"))
        (tmp_path / "soft.toml").write_text((data / "compliance/kr300_r2500_ultra.toml").read_text().replace("5.4e9]", "2.7e9]"))
        file = cell(tmp_path, 'name = "kr300_r2500_ultra"', 'file = "mine.toml"\ncompliance = "soft.toml"')
        with assemble(load_system(file), resolve, convert) as assembly:
            assert assembly.parameters["controller"]["dh_a[3]"] == 1.2
            assert assembly.parameters["compliance"]["stiffness[2,3]"] == 2.7e6
            assert any("motor torques are those of tool and process alone" in text for text in assembly.wiring.warnings)

    def test_joints_and_drawing_are_those_of_the_system(self, tmp_path: Path) -> None:
        system = load_system(cell(tmp_path, 'name = "kr300_r2500_ultra"', 'name = "kr500_r2830"'))
        component = arm(system)
        assert component is not None
        assert np.array_equal(geometry(component).dh_a, load_robot("kr500_r2830").dh_a)
        columns = {f"drive.q_motor[{i}]": np.full(3, v) for i, v in enumerate((0.0, -1.5, 1.6, 0.0, 0.3, 0.0), 1)}
        J = projections(system)["compliance.p_BT_B"].jacobian(columns)
        default = projections(load_system(SCENARIOS / "milling_cell.toml"))["compliance.p_BT_B"].jacobian(columns)
        # axis 1 turns the tip about the base: the KR 500 reaches further
        assert np.linalg.norm(J[0, :, 0]) > np.linalg.norm(default[0, :, 0]) + physics(0.3, absolute=0.0)


class TestErrors:
    def refused(self, file: Path, named: dict[str, Entry] | None = None) -> str:
        with pytest.raises(SystemFileError if named is None else ScenarioError) as caught:
            load_system(file, named)
        return str(caught.value)

    def test_other_geometry_in_one_component_names_both(self, tmp_path: Path) -> None:
        file = cell(tmp_path, 'source = "milling_force"', 'source = "milling_force"')
        file.write_text(
            CELL.replace('source = "sensor_chain"\nparameters = {', 'source = "sensor_chain"\nparameters = { "p_FT_F[3]" = "260 mm",')
        )
        line = next(i for i, text in enumerate(file.read_text().splitlines(), 1) if "260 mm" in text)
        assert self.refused(file) == (
            f"cell.toml:{line}: component 'sensor': p_FT_F[3] is 0.26 m, but [tool] name = \"spindle_across\" (spindle across the flange) "
            "has 0.25 m: one machine has one. Take it out here, or name another part for all components"
        )

    def test_equal_geometry_and_other_stiffness_are_allowed(self, tmp_path: Path) -> None:
        text = CELL.replace('source = "sensor_chain"\nparameters = {', 'source = "sensor_chain"\nparameters = { "p_FT_F[3]" = "250 mm",')
        (tmp_path / "cell.toml").write_text(text)
        load_system(tmp_path / "cell.toml")  # sensor_stiffness_scale of the compliance is 0.1 there, too

    def test_unknown_robot(self, tmp_path: Path) -> None:
        text = self.refused(cell(tmp_path, "kr300_r2500_ultra", "kr210_22"))
        assert text.startswith("cell.toml:12: [robot] name: unknown robot 'kr210_22'")
        assert "kr210_2" in text
        assert "irb6400r_25_150" in text

    def test_robot_without_springs_or_closed_form(self, tmp_path: Path) -> None:
        assert (
            "component 'path' needs q_start; choose another robot: robot 'UR10' has no inverse kinematics in closed form"
            in self.refused(cell(tmp_path, "kr300_r2500_ultra", "ur10"))
        )
        (tmp_path / "static.toml").write_text(
            'name = "s"\nstep = "4 ms"\n[robot]\nname = "ur10"\n[components.compliance]\nsource = "robot_compliance"\n'
        )
        text = self.refused(tmp_path / "static.toml")
        assert text.startswith(
            "static.toml:4: [robot] name: component 'compliance' needs stiffness; choose another robot: robot 'UR10' has no virtual "
            "joints; there are those of "
        )
        assert text.endswith('or give [robot] compliance = "my_springs.toml"')

    def test_wrong_tables(self, tmp_path: Path) -> None:
        for text, table in (
            ("scenario.toml:1: [robot]: expected either name", {"robot": {"compliance": "kr210_2"}}),
            ("scenario.toml:2: [tool] nmae: unknown key 'nmae'; did you mean 'name'", {"tool": {"nmae": "x"}}),
            ("scenario.toml:2: [sensor] name: expected a text; found 5", {"sensor": {"name": 5}}),
        ):
            assert text in self.refused(cell(tmp_path), tables(tmp_path, **table))
        (tmp_path / "none.toml").write_text(
            'name = "s"\nstep = "4 ms"\n[sensor]\nname = "ati_omega160_si2500"\n[components.compliance]\nsource = "robot_compliance"\n'
        )
        (warning,) = load_system(tmp_path / "none.toml").warnings
        assert warning.endswith("no component has parameters of a sensor; components: compliance (robot_compliance)")

    def test_a_system_that_was_loaded_without_looking_them_up_does_not_run(self, tmp_path: Path) -> None:
        with pytest.raises(SystemFileError, match=r"cell\.toml: the system has \[robot\], .* load it with robomill\.System\.load"):
            assemble(System.load(cell(tmp_path), convert), resolve, convert)


@pytest.mark.slow
def test_fmus_get_it_too(tmp_path: Path) -> None:
    """A slot with native FMUs has the bits of the slot in process."""
    from robomill.fmus.components import COMPONENTS
    from robomill.fmus.native.builder import build

    scenario = load_scenario(SCENARIOS / "robots" / "irb6400r_25_150.toml")
    for name in ("path_interpolator", "robot_drive", "robot_compliance", "milling_force", "sensor_chain", "compensation_controller"):
        build(COMPONENTS[name], tmp_path / "fmus")
    runs: list[Run] = []
    for fmus in (None, tmp_path / "fmus"):
        job = prepare(scenario, tmp_path / f"out{fmus is None}", fmus)
        runs.append(mill(job, scenario.variants[1])[0])
    for name in runs[0].columns:
        assert np.array_equal(runs[0][name], runs[1][name]), name
