"""The menu of next runs: every entry can be made, with any milling cell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from robomill.cell.binding import convert, resolve
from robomill.cell.equipment import load_system
from robomill.cell.milling import with_parameters
from robomill.cell.next_runs import kinds, prepare, with_load
from robomill.diagnose_command import menu
from robomill.orchestration.assembly import run
from tests import SCENARIOS

CELL = load_system(SCENARIOS / "milling_cell.toml")


def test_a_cell_with_a_load_is_the_loaded_cell_of_the_experiments():
    made, shipped = with_load(CELL), load_system(SCENARIOS / "experiments" / "loaded_cell.toml")
    assert {(c.source, c.target, c.delayed) for c in made.connections} == {(c.source, c.target, c.delayed) for c in shipped.connections}
    parts = [[(c.name, c.source, dict(c.parameters)) for c in system.components] for system in (made, shipped)]
    assert parts[0] == parts[1]


def test_every_run_can_be_made_and_what_is_wrong_with_the_machine_shows_in_it(tmp_path):
    weak = CELL.with_parameters("compliance", {"stiffness_error": [0.0, -0.2, 0.0, 0.0, 0.0, 0.0]})
    changed = {}
    for kind in kinds():
        tips = []
        for cell in (CELL, weak):
            r = prepare(cell, kind, tmp_path / kind)
            assert r.minutes > 0.0
            assert r.repeats > 1
            result = run(with_parameters(r.system, r.parameters), None, stop=r.seconds, resolver=resolve, convert=convert)
            tips.append(result["compliance.p_BT_B"])
        changed[kind] = float(np.abs(tips[1] - tips[0]).max())
    assert changed["static push along z"] > 10e-6
    assert changed["static push along z"] > 3.0 * changed["static push along y"], changed  # joint 2 turns about y
    assert 0.0 < changed["second depth"] < changed["static push along z"]


def test_what_is_not_on_the_menu_is_refused_with_what_there_is(tmp_path):
    with pytest.raises(LookupError, match=r"no run 'dancing' on the menu; there are: .*tap test"):
        prepare(CELL, "dancing", tmp_path)


def test_the_menu_is_for_milling_cells_and_for_those_with_a_load_what_needs_no_cut(tmp_path):
    assert kinds(CELL) == kinds()
    other = replace(CELL, components=tuple(c for c in CELL.components if c.name != "milling"))
    assert kinds(other) == ()
    assert menu(other, tmp_path).offers() == {}
    loaded = menu(with_load(CELL), tmp_path).offers()
    assert "hanging weight" in loaded
    assert set(kinds()) - set(loaded) == {k for k in kinds() if k.startswith("second")}
    offers = menu(CELL, tmp_path).offers()
    assert tuple(offers) == kinds()
    # people are shown what they set, not the tables
    assert offers["air cut"].shown == {"controller": {"mode": 1}}
