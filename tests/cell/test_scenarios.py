"""Scenario files, the test part, the static loads, and the same numbers whatever the components are made of."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from robomill.cell import milling
from robomill.cell.scenario import Scenario, ScenarioError, load_scenario
from robomill.cell.static_loads import run_static_loads
from robomill.fmus.components import COMPONENTS
from robomill.fmus.python.builder import build
from robomill.models.calibration.validation_loads import validation_loads
from robomill.models.components.recording import replay_model
from robomill.models.metrology.height_map import cut_height_map
from robomill.models.planning import gcode
from robomill.orchestration.runs.run import Run
from tests import SCENARIOS
from tests.cell.conftest import Runs
from tests.tolerances import EXACT, ROUNDOFF, physics


def short(scenario: Scenario, folder: Path) -> Scenario:
    """The groove, cut short: entry, 10 mm of slot, exit."""
    program = folder / "short.ngc"
    program.write_text("G21 G90 G17 G54\nT1 M6\nS13000 M3\nG0 X-20. Y0. Z2.\nG1 Z-11.7 F1500.\nX20.\nM30\n")
    assert scenario.workpiece is not None
    return replace(scenario, program=program, workpiece=replace(scenario.workpiece, size=(0.01, 0.06, 0.03)))


@pytest.fixture(scope="module")
def job(tmp_path_factory):
    folder = tmp_path_factory.mktemp("short")
    return milling.prepare(short(load_scenario(SCENARIOS / "groove.toml"), folder), folder / "results", overwrite=True)


def assert_equal(a: Run, b: Run) -> None:
    assert len(a) == len(b)
    for name, values in a.columns.items():
        rows = np.flatnonzero(values != b.columns[name])
        assert len(rows) == EXACT, f"{name} differs from t = {a.t[rows[0]]} s on: {values[rows[0]]!r} and {b.columns[name][rows[0]]!r}"


class TestSwapping:
    """One line of the system file; the numbers stay (EXACT)."""

    @pytest.mark.parametrize("component", ["path", "drive", "compliance", "milling", "sensor", "controller"])
    def test_a_recording_in_place_of_a_component(self, job, component, tmp_path):
        variant = job.scenario.variants[3]
        usual, _ = milling.mill(job, variant)
        system = job.system.with_source(component, f"replay:{job.folder / variant.name}")
        swapped, _ = milling.mill(replace(job, system=system, folder=tmp_path), variant)
        assert_equal(usual, swapped)

    @pytest.mark.parametrize("component", ["path", "milling"])
    def test_a_replay_fmu_has_no_program_and_no_workpiece(self, job, component, tmp_path):
        """From the preparation on: the scenario's own parameters go to what can take them."""
        variant = job.scenario.variants[1]
        usual, _ = milling.mill(job, variant)
        model = COMPONENTS[job.system.component(component).source]
        outputs = {v.name: usual[f"{component}.{v.name}"] for v in model.variables if v.causality == "output"}
        fmu = build(replay_model(model, usual.t, outputs), tmp_path)
        system = (SCENARIOS / "milling_cell.toml").read_text().replace(f'source = "{model.name}"', f'source = "{fmu}"')
        (tmp_path / "cell.toml").write_text(system)
        scenario = replace(job.scenario, system=tmp_path / "cell.toml", parameters={})
        swapped, _ = milling.mill(milling.prepare(scenario, tmp_path / "results"), variant)
        assert np.array_equal(swapped["compliance.p_BT_B"], usual["compliance.p_BT_B"])

    @pytest.mark.slow
    @pytest.mark.parametrize("component", ["path", "drive", "compliance", "milling", "sensor", "controller"])
    def test_a_python_fmu_in_place_of_a_component(self, job, component, tmp_path):
        variant = job.scenario.variants[3]
        usual, _ = milling.mill(job, variant)
        fmu = build(COMPONENTS[job.system.component(component).source], tmp_path)
        swapped, _ = milling.mill(replace(job, system=job.system.with_source(component, str(fmu)), folder=tmp_path), variant)
        assert_equal(usual, swapped)

    @pytest.mark.slow
    def test_all_fmus_mill_the_whole_groove(self, runs: Runs, tmp_path):
        for model in COMPONENTS.values():
            build(model, tmp_path)
        fmus = runs.results("groove", tmp_path)
        for name, result in runs.results("groove").items():
            assert_equal(result.run, fmus[name].run)

    def test_the_run_says_with_which_tool_what_was_cut(self, job):
        large = replace(job, system=job.system.with_parameters("milling", {"diameter": 0.02, "teeth": 3}))
        result, _ = milling.mill(large, job.scenario.variants[1])
        assert (result.info["tool"], result.info["workpiece"]) == ("end mill D20 z3", "block 10 x 60 x 30 mm")

    def test_the_same_scenario_again_gives_the_same_bits(self, job):
        first, _ = milling.mill(job, job.scenario.variants[1])
        again, _ = milling.mill(job, job.scenario.variants[1])
        assert_equal(first, again)


class TestTestPart:
    """The main job: everything is cut, and the variants come in the order of the paper."""

    @pytest.mark.paper
    @pytest.mark.slow
    def test_variants_rank_as_in_the_paper(self, runs: Runs):
        largest = {name: r.figures.max_deviation_m for name, r in runs.results("test_part").items()}
        assert largest["uncompensated"] > largest["cartesian"] > largest["cartesian_pilot"]
        assert largest["uncompensated"] == pytest.approx(1.4e-3, abs=physics(1.4e-3, relative=0.15))
        assert largest["cartesian_pilot"] <= 0.22 * largest["uncompensated"]

    @pytest.mark.slow
    def test_as_much_material_goes_as_the_nominal_tool_would_take(self, runs: Runs):
        """Deflection moves the cut but hardly changes its volume: the bound is the rms deviation over the area of the walls and floors."""
        r = runs.results("test_part")["cartesian_pilot"]
        removed = float(np.sum(r.run["milling.removal_rate"]) * 0.004)
        nominal = cut_height_map(r.nominal, (0.16, 0.10, 0.03), 2.5e-4)
        cell = (nominal.x[1] - nominal.x[0]) * (nominal.y[1] - nominal.y[0])
        volume = float(-nominal.height.sum() * cell)
        assert removed == pytest.approx(volume, abs=physics(volume, relative=0.02))


class TestStaticLoads:
    """Paper 000, sec. 3.1: mean calculated displacement 1.72 mm (0.11 mm are 6 % of the measured mean)."""

    @pytest.mark.paper
    def test_mean_of_the_sixty_cases(self):
        first, cell = run_static_loads(load_scenario(SCENARIOS / "static_loads.toml")).values()
        assert first.mean_displacement_m == pytest.approx(1.72e-3, abs=physics(0.0, absolute=0.005e-3))
        assert len(first.cases) == 60
        assert cell.mean_displacement_m == pytest.approx(1.83e-3, abs=physics(0.0, absolute=0.14e-3))

    def test_the_component_gives_what_the_model_gives(self):
        found = run_static_loads(load_scenario(SCENARIOS / "static_loads.toml"))
        assert found["calculated"].magnitudes == pytest.approx(validation_loads().magnitude, rel=ROUNDOFF)


class TestWorkOffsets:
    """G54 is the origin of the workpiece; the scenario says where the others are."""

    def test_a_program_in_g55_is_moved_by_its_origin(self, tmp_path):
        for name in ("milling_cell.toml", "groove.ngc"):
            (tmp_path / name).write_text((SCENARIOS / name).read_text().replace("G54", "G55"))
        text = (
            (SCENARIOS / "groove.toml")
            .read_text()
            .replace("[workpiece]", '[workpiece]\nwork_offsets = { G55 = ["1 mm", 0, "-0.002 m"] }', 1)
        )
        (tmp_path / "moved.toml").write_text(text)
        scenario = load_scenario(tmp_path / "moved.toml")
        assert scenario.workpiece is not None
        assert scenario.workpiece.work_offsets == {54: (0.0, 0.0, 0.0), 55: (1e-3, 0.0, -2e-3)}
        moved = gcode.read(tmp_path / "groove.ngc", gcode.Setup(work_offsets=scenario.workpiece.work_offsets)).actions[0]
        plain = gcode.read(SCENARIOS / "groove.ngc").actions[0]
        assert isinstance(moved, gcode.Move)
        assert isinstance(plain, gcode.Move)
        assert moved.start == pytest.approx(np.add(plain.start, (1e-3, 0.0, -2e-3)), rel=ROUNDOFF)

    def test_an_unknown_name_is_refused(self, tmp_path):
        for name in ("milling_cell.toml", "groove.ngc"):
            (tmp_path / name).write_text((SCENARIOS / name).read_text())
        text = (SCENARIOS / "groove.toml").read_text().replace("[workpiece]", "[workpiece]\nwork_offsets = { G60 = [0, 0, 0] }", 1)
        (tmp_path / "bad.toml").write_text(text)
        with pytest.raises(
            ScenarioError, match=r"bad.toml:9: \[workpiece\] work_offsets.G60: unknown key 'G60'; did you mean .* available: G54, G55"
        ):
            load_scenario(tmp_path / "bad.toml")


class TestBadFiles:
    """One clear error each."""

    @pytest.mark.parametrize(
        ("change", "text"),
        [
            (
                ('kind = "milling"', 'kind = "drilling"'),
                "bad.toml:3: [scenario] kind: unknown kind 'drilling'; did you mean 'milling'? available: milling, static_loads",
            ),
            (('system = "milling_cell.toml"', 'system = "cell.toml"'), "'cell.toml': no such file; beside it are"),
            (("[variants.axis]", "[variantes.axis]"), "bad.toml:25: [variantes]: unknown key 'variantes'; did you mean 'variants'"),
            (('"100 mm", "60 mm"', '"100 N", "60 mm"'), "bad.toml:12: [workpiece] size.0: 100 N cannot be expressed in m"),
            (('size = ["100 mm", ', "size = ["), "expected three quantities in m"),
            (
                ('"100 mm", "60 mm"', '100, "60 mm"'),
                'bad.toml:12: [workpiece] size.0: 100 has no unit; expected a text with one, such as "100 mm"',
            ),
            (('"100 mm", "60 mm"', 'inf, "60 mm"'), "bad.toml:12: [workpiece] size.0: expected a finite number"),
            (('"100 mm", "60 mm"', 'true, "60 mm"'), "bad.toml:12: [workpiece] size.0: True is neither a number nor a text with a unit"),
            (('"100 mm", "60 mm"', '"-2 1", "60 mm"'), "bad.toml:12: [workpiece] size.0: '-2 1' is not a number with a unit"),
            (('"0.7 mm"', "0.7"), 'max_deviation_m: 0.7 has no unit; expected a text with one, such as "0.7 mm"'),
            (
                ("max_deviation_m =", "max_deviation ="),
                "max_deviation: the name of a figure ends in its unit, as in summary.json: _m, _n, _s",
            ),
            (('name = "groove"', 'name = ""'), "bad.toml:2: [scenario] name: expected a text; found ''"),
            (('name = "groove"', 'name = "../groove"'), "bad.toml:2: [scenario] name: '../groove' cannot be the name of a folder"),
            (
                ("[variants.axis]", "[variants.plan]"),
                "bad.toml:25: [variants] plan: a variant cannot be called 'plan': the results have a folder",
            ),
            (
                ("controller.mode = 0", "controller = 0"),
                "bad.toml:19: [variants] uncompensated.parameters.controller: expected a table; found 0",
            ),
            (("[scenario]", "[scenario"), "not valid TOML"),
            (('program = "groove.ngc"', ""), "a milling scenario needs a program"),
        ],
    )
    def test_scenario_errors_name_file_and_remedy(self, change, text, tmp_path):
        for name in ("milling_cell.toml", "groove.ngc"):
            (tmp_path / name).write_text((SCENARIOS / name).read_text())
        file = tmp_path / "bad.toml"
        old, new = change
        assert old in (SCENARIOS / "groove.toml").read_text()
        file.write_text((SCENARIOS / "groove.toml").read_text().replace(old, new, 1))
        with pytest.raises((ScenarioError, FileNotFoundError)) as caught:
            load_scenario(file)
        assert "bad.toml" in str(caught.value)
        assert text in str(caught.value)
