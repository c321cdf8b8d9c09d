"""Kinds of next runs: every kind can be made, with any milling cell; files of kinds are read, or refused in words."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from robomill.cell.binding import convert, resolve
from robomill.cell.equipment import load_system
from robomill.cell.milling import with_parameters
from robomill.cell.next_runs import KINDS, kinds_for, load_kinds, prepare, with_load
from robomill.cell.scenario import ScenarioError
from robomill.diagnose_command import menu
from robomill.orchestration.assembly import run
from robomill.orchestration.system.definition import System
from tests import SCENARIOS

CELL = load_system(SCENARIOS / "milling_cell.toml")
COMPLIANT = 2e-4
"""m: what gravity bends the robot differently by at another place."""
NEARLY_LINEAR = 0.05
"""Relative: gear hysteresis and the path of the load make a push nearly, not quite, proportional."""
PLAIN = """
[[kind]]
name = "chirp"
minutes = 2
seconds = 6
range.amplitude = {low = "100 mN", high = "2 N", start = "1 N"}
parameters.force.amplitude = "${amplitude} mN"
"""


def tip(cell: System, kind: str, folder: Path, **values: float) -> np.ndarray:
    r = prepare(cell, kind, folder, values)
    assert r.minutes > 0.0
    assert r.repeats > 1
    result = run(with_parameters(r.system, r.parameters), None, stop=r.seconds, resolver=resolve, convert=convert)
    return result["compliance.p_BT_B"]


def test_a_cell_with_a_load_is_the_loaded_cell_of_the_experiments():
    made, shipped = with_load(CELL), load_system(SCENARIOS / "experiments" / "loaded_cell.toml")
    assert {(c.source, c.target, c.delayed) for c in made.connections} == {(c.source, c.target, c.delayed) for c in shipped.connections}
    parts = [[(c.name, c.source, dict(c.parameters)) for c in system.components] for system in (made, shipped)]
    assert parts[0] == parts[1]
    assert with_load(made) is made


def test_every_kind_can_be_made_and_what_is_wrong_with_the_machine_shows_in_it(tmp_path):
    weak = CELL.with_parameters("compliance", {"stiffness_error": [0.0, -0.2, 0.0, 0.0, 0.0, 0.0]})
    changed = {k.name: float(np.abs(tip(weak, k.name, tmp_path) - tip(CELL, k.name, tmp_path)).max()) for k in kinds_for(CELL)}
    assert min(changed.values()) >= 0.0
    up, aside = (
        float(np.abs(np.subtract(*(tip(cell, "static push", tmp_path, azimuth=90.0, elevation=e) for cell in (weak, CELL)))).max())
        for e in (90.0, 0.0)
    )
    assert up > 10e-6
    assert up > 3.0 * aside  # joint 2 turns about y, and the push is along y
    assert changed["cut"] > 0.0


def test_values_change_the_run(tmp_path):
    at_rest = tip(CELL, "static push", tmp_path / "a")[0]
    assert tip(CELL, "static push", tmp_path / "b", x=1500.0)[0] - at_rest == pytest.approx([0.2, 0.0, 0.0], abs=COMPLIANT)
    pushed = [np.ptp(tip(CELL, "static push", tmp_path / str(load), load=load)[200:, 1]) for load in (200.0, 400.0)]
    assert pushed[1] == pytest.approx(2.0 * pushed[0], rel=NEARLY_LINEAR)


@pytest.mark.parametrize(
    ("kind", "values", "text"),
    [
        ("dancing", {}, r"no kind of run 'dancing'; there are: reversals, .*tap test"),
        ("tap test", {"lode": 1.0}, r"run 'tap test': .*lode.*load"),
        ("tap test", {"load": 5000.0}, r"run 'tap test': load = 5000 N is out of its range, 200 \.\. 800 N"),
    ],
)
def test_what_cannot_be_made_is_refused_with_what_can(tmp_path, kind, values, text):
    with pytest.raises(LookupError, match=text):
        prepare(CELL, kind, tmp_path, values)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ('low = "100 mN"', 'low = "3 N"', r"next_runs.toml:6: .*low = 3 N is not below high = 2 N; exchange them"),
        ('high = "2 N"', 'high = "2 mm"', r"next_runs.toml:6: .*'?2 mm'?.*expected a quantity in mN"),
        ('start = "1 N"', 'start = "9 N"', r"next_runs.toml:6: .*9000 mN is out of the range, 100 \.\. 2000 mN"),
        ("${amplitude}", "${amplitud}", r"next_runs.toml:2: .*\$\{amplitud\}: .*amplitud.*amplitude"),
        ("${amplitude}", "${amplitude ** 2}", r"is no arithmetic; expected \+ - \* /"),
        ("seconds = 6", "", r"expected either program or seconds: how long is a run\?"),
        ("minutes = 2", "minutes = 0", r"next_runs.toml:4: .*expected a positive number; found 0"),
        ("seconds = 6", 'seconds = 6\nsystem = "none.toml"', r"none.toml.*no such file"),
    ],
)
def test_a_file_of_kinds_is_refused_in_words(tmp_path, old, new, text):
    file = tmp_path / "next_runs.toml"
    file.write_text(PLAIN.replace(old, new))
    with pytest.raises((ScenarioError, FileNotFoundError), match=text):
        load_kinds(file)


def test_a_file_that_is_not_there_is_said(tmp_path):
    with pytest.raises(
        FileNotFoundError, match=r"no kinds of runs .*mine.toml; without --next-runs they are next_runs.toml beside the system"
    ):
        load_kinds(tmp_path / "mine.toml")


def test_kinds_are_for_milling_cells_and_for_those_with_a_load_what_needs_no_cut(tmp_path):
    every = [k.name for k in load_kinds(KINDS)]
    assert [k.name for k in kinds_for(CELL)] == every
    other = replace(CELL, components=tuple(c for c in CELL.components if c.name != "milling"))
    assert kinds_for(other) == ()
    loaded = [k.name for k in menu(with_load(CELL), tmp_path).kinds()]
    assert set(every) - set(loaded) == {"cut", "cut, compensation off"}
    own = tmp_path / "next_runs.toml"
    own.write_text(PLAIN)
    (chirp,) = menu(other, tmp_path, own).kinds()
    assert [(q.name, q.unit, q.low, q.high, q.start) for q in chirp.quantities] == [("amplitude", "mN", 100.0, 2000.0, 1000.0)]
