"""A law at the input of a component: found by what the component makes of it, beside what calibrated numbers may do."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robomill.cell.binding import resolve as with_forms
from robomill.diagnosis.experiment.campaign import Campaign
from robomill.diagnosis.experiment.component_replay import ComponentReplay
from robomill.diagnosis.experiment.preparation import prepared
from robomill.diagnosis.experiment.simulation import Simulator
from robomill.diagnosis.forms.discovery import discovered
from robomill.diagnosis.forms.doubts import likeliest
from robomill.diagnosis.forms.layout import Form
from robomill.diagnosis.forms.loop import specification
from robomill.diagnosis.forms.places import best_of
from robomill.diagnosis.forms.signals import restored
from robomill.diagnosis.inference.search import Search
from robomill.models.components.file_names import FORM
from robomill.models.model.units import convert
from robomill.orchestration.runs.run import Run
from tests.diagnosis import demo
from tests.tolerances import ROUNDOFF

LOST, HARDER = -0.1, -2e3
"""1/N2: part of the force that is lost, over its square; and N/m3: force of a spring at the second mass, over the cube of its way."""


def resolve(source: str, name: str) -> Any:
    return with_forms(source, name) if source.endswith(FORM) else demo.resolve(source, name)


def looked_for(folder: Path, runs: Sequence[Run], held_out: Sequence[Run], components: Sequence[str]) -> Form | None:
    start = prepared(Campaign.of(demo.SYSTEM, runs, held_out), demo.catalogue(folder), resolve, convert)
    groups = start.laboratory.measured()
    search = Search(start.catalogue, Simulator(start.laboratory), groups[: start.n], start.nuisances)
    return discovered(search, groups, components, {})


def runs_of(folder: Path, monkeypatch: pytest.MonkeyPatch, variable: str, coefficient: float, unit: str) -> tuple[list[Run], list[Run]]:
    """Runs of masses with a force more, which goes with the cube of a variable, and held-out runs of a larger force."""
    factor = {"kind": "cube", "variable": variable, "rate": False, "since_start": False, "shape": 1.0}
    term = {"element": "f", "coefficient": coefficient, "unit": unit, "text": f"{variable}^3", "factors": [factor]}
    read = [("f", "N", 0)] if variable == "f" else [("x", "m", 2), ("f", "N", 0)]
    file = folder / f"more{FORM}"
    file.write_text(json.dumps(specification("masses", read, ["f"], [term])))
    with monkeypatch.context() as patch:
        patch.setattr(demo, "SYSTEM", demo.SYSTEM.with_correction("masses", str(file)))
        patch.setattr(demo, "resolve", opening_forms(demo.resolve))
        return demo.measure(repeats=3), demo.measure(amplitude=1.3, repeats=3)


def opening_forms(plain: Any) -> Any:
    return lambda source, name: with_forms(source, name) if source.endswith(FORM) else plain(source, name)


@pytest.mark.parametrize(("variable", "coefficient", "unit"), [("f", LOST, "1/N2"), ("x[2]", HARDER, "N/m3")])
def test_a_law_at_an_input_is_found_by_what_the_component_makes_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, variable: str, coefficient: float, unit: str
) -> None:
    """The way of the mass is not measured: it is what the sensor behind it has shown."""
    form = looked_for(tmp_path, *runs_of(tmp_path, monkeypatch, variable, coefficient, unit), ["masses", "sensors"])
    assert form is not None
    (port,) = form.ports
    assert (form.component, form.side, port.port) == ("masses", "input", "masses.f")
    (term,) = port.terms
    assert term.term == f"{variable}^3"
    assert term.unit == unit
    assert abs(term.coefficient - coefficient) < demo.WELL * abs(coefficient)
    assert form.step_late == (0.0 if variable == "f" else demo.STEP)  # what comes out is read a step late
    closures = {(h.on, h.channel): h.closure for h in form.how_far}
    assert (closures["held-out condition", "sensors.y"] or 0.0) > 0.9
    assert form.specification


def test_an_output_that_was_not_measured_is_what_a_sensor_behind_it_has_shown(tmp_path: Path) -> None:
    runs = demo.measure({"masses": {"cubic": 2e4}}, repeats=3)
    start = prepared(Campaign.of(demo.SYSTEM, runs, []), demo.catalogue(tmp_path), resolve, convert)
    replay = ComponentReplay.of(start.laboratory, 0)
    found = restored(replay, "masses", in_loop=False)
    assert set(found) == {"x[1]", "x[2]"}
    for i in (1, 2):
        shown = np.mean([r.columns[f"sensors.y[{i}]"] for r in runs], axis=0)
        np.testing.assert_allclose(found[f"x[{i}]"][1:], shown[1:], rtol=0.0, atol=1e3 * ROUNDOFF)  # at the start nothing shows yet
        assert np.abs(replay.in_the_loop(f"masses.x[{i}]") - shown).max() > 20.0 * demo.NOISE
    assert restored(replay, "sensors", in_loop=False) == {}


@pytest.mark.parametrize(("deviations", "said"), [(1.5, False), (6.0, True)])
def test_no_form_is_about_what_a_calibrated_number_may_do(tmp_path: Path, deviations: float, said: bool) -> None:
    """The damping is known to 1 %, and shows in these runs from a tenth of that on."""
    damping = demo.Masses("masses").p["damping"] * (1.0 + 0.01 * deviations)
    runs = demo.measure({"masses": {"damping": damping}}, repeats=4)
    assert (looked_for(tmp_path, runs, [], ["masses", "sensors"]) is not None) is said


class TestLikeliest:
    """How far off calibrated numbers are taken to be."""

    t = np.linspace(0.0, 1.0, 400)
    doubt = np.stack([100.0 * np.sin(5.0 * t), 100.0 * np.cos(7.0 * t)], axis=1)
    none = np.zeros((400, 0))

    def test_what_they_did_is_found(self) -> None:
        z = likeliest(self.doubt @ [0.7, -1.2], self.none, self.doubt)
        np.testing.assert_allclose(z, [0.7, -1.2], rtol=demo.WELL)

    def test_none_is_farther_off_than_its_calibration_allows(self) -> None:
        z = likeliest(self.doubt @ [7.0, 0.1], self.none, self.doubt)
        assert z[0] == pytest.approx(1.645, rel=1e3 * ROUNDOFF)
        assert abs(z[1]) < 1.645

    def test_beside_a_term_that_does_the_same_they_stay(self) -> None:
        z = likeliest(self.doubt @ [7.0, 0.0], self.doubt[:, :1], self.doubt)
        assert np.all(np.abs(z) < demo.WELL)

    def test_where_terms_leave_more_than_noise_the_data_say_less(self) -> None:
        """Something that is as large as what the number does, and that nothing explains."""
        small = self.doubt / 1e3
        other = 0.2 * np.sign(np.sin(90.0 * self.t))
        sure = likeliest(small[:, 0], self.none, small)[0]
        unsure = likeliest(small[:, 0] + 30.0 * other, self.none, small)[0]
        assert abs(unsure) < 0.5 * sure


class TestBest:
    """Which of several forms is the best: what each leaves in blocks, of a gap of 1000."""

    blocks = np.array([9.0, 11.0, 10.0, 10.0])

    @pytest.mark.parametrize(
        ("second", "terms", "best"),
        [
            (0.5, (2, 2), 1),  # less by more than chance
            (1.02, (2, 1), 1),  # not more, and simpler
            (2.0, (2, 1), 0),  # simpler, and more
            (1.0, (2, 2), 0),  # the earlier of two that are alike
        ],
    )
    def test_the_simpler_one_unless_it_leaves_more(self, second: float, terms: tuple[int, int], best: int) -> None:
        assert best_of([self.blocks, second * self.blocks], terms, 1000.0) == best

    def test_each_is_compared_with_the_one_that_leaves_least_and_not_with_the_one_before(self) -> None:
        lefts = [self.blocks, self.blocks + np.array([9.0, 0.0, 0.0, 0.0]), self.blocks + np.array([9.0, 0.0, 9.0, 9.0])]
        assert best_of(lefts, (3, 2, 1), 1000.0) == 1  # the third is not more than the second, but more than the first

    def test_what_is_little_of_the_gap_is_not_more(self) -> None:
        assert best_of([self.blocks, 2.0 * self.blocks], (2, 1), 1e5) == 1
