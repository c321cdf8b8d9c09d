"""An unknown law, from runs to a form in the loop; onset of an effect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from robomill.cell.binding import resolve as with_forms
from robomill.diagnosis.experiment.campaign import Campaign
from robomill.diagnosis.experiment.preparation import prepared
from robomill.diagnosis.experiment.simulation import Simulator
from robomill.diagnosis.forms import onset
from robomill.diagnosis.forms.discovery import discovered, like_delays, suspects
from robomill.diagnosis.forms.layout import Form
from robomill.diagnosis.forms.onset import onset_of
from robomill.diagnosis.inference.search import Search
from robomill.diagnosis.localisation.where import WHOLE, Where
from robomill.diagnosis.outcome import adopt
from robomill.diagnosis.outcome.answer import Answer
from robomill.diagnosis.outcome.how_far import DIAGNOSED
from robomill.models.components.file_names import FORM
from robomill.models.model.units import convert
from robomill.orchestration.assembly import run
from robomill.orchestration.runs.run import Run
from tests.diagnosis import demo
from tests.tolerances import ROUNDOFF

CUBE = 40.0
"""1/m2: what the sensor shows too much, over the cube of what it shows."""
AS_FITTED = 10.0 * demo.NOISE
"""m: noise of ten samples. The form may be of what the sensor gets, or of what it shows, which are the same but for roundoff."""
LAG = 0.02
"""s"""


def resolve(source: str, name: str) -> Any:
    return with_forms(source, name) if source.endswith(FORM) else demo.resolve(source, name)


def looked_at(folder: Path, runs: Sequence[Run], held_out: Sequence[Run] = ()) -> tuple[Search, list[Any], Simulator]:
    start = prepared(Campaign.of(demo.SYSTEM, runs, held_out), demo.catalogue(folder), resolve, convert)
    simulator = Simulator(start.laboratory)
    groups = start.laboratory.measured()
    return Search(start.catalogue, simulator, groups[: start.n], start.nuisances), groups, simulator


@pytest.fixture(scope="module")
def cubic(tmp_path_factory: pytest.TempPathFactory) -> Form:
    def bent(t: Any, y: Any) -> Any:
        return y + CUBE * y**3

    runs, held = (demo.changed(demo.measure(amplitude=a, repeats=3), "sensors.y[2]", bent) for a in (1.0, 1.4))
    search, groups, _ = looked_at(tmp_path_factory.mktemp("cubic"), runs, held)
    form = discovered(search, groups, ["sensors"], {})
    assert form is not None
    return form


def test_a_cubic_sensor_is_found_as_a_cube(cubic: Form) -> None:
    (port,) = cubic.ports
    assert (cubic.component, cubic.side, port.port) == ("sensors", "output", "sensors.y[2]")
    first = port.terms[0]
    assert first.term in ("y[2]^3", "x[2]^3")
    assert first.unit == "1/m2"
    assert first.interval[0] <= CUBE <= first.interval[1]
    assert port.closure > 0.95
    assert port.curve is not None
    assert len(port.curve.x) == len(port.curve.form)


def test_it_closes_the_gap_of_runs_that_were_held_out(cubic: Form) -> None:
    closures = {(h.on, h.channel): h.closure for h in cubic.how_far}
    assert (closures["held-out condition", "sensors.y"] or 0.0) > 0.9
    assert not cubic.worse
    assert not cubic.refuted
    (seen,) = {r.variable: r for r in cubic.ranges}.values()
    assert seen.held_out is not None
    assert seen.held_out[1] > seen.seen[1]  # a larger force


def test_it_is_adopted_from_its_file(cubic: Form, tmp_path: Path) -> None:
    import json

    file = tmp_path / f"adopt{FORM}"
    file.write_text(json.dumps(cubic.specification))
    plain = run(demo.SYSTEM, stop=2.0, resolver=resolve)
    found = run(adopt.adopted(demo.SYSTEM, file), stop=2.0, resolver=resolve)
    shown = plain["sensors.y[2]"]
    np.testing.assert_allclose(found["sensors.y[2]"], shown + cubic.ports[0].terms[0].coefficient * shown**3, rtol=ROUNDOFF, atol=AS_FITTED)
    with pytest.raises(Exception, match="a form of 'sensors': unknown component 'sensors'"):
        adopt.adopted(demo.System("one", demo.STEP, demo.SYSTEM.components[:1]), file)


def test_a_form_that_other_runs_refute_is_said_and_not_adopted(tmp_path: Path) -> None:
    """What was found as a cube is another machine's in the runs that were held out: there it bends the other way."""
    runs, held = (
        demo.changed(demo.measure(amplitude=a, repeats=3), "sensors.y[2]", lambda t, y, c=c: y + c * y**3)
        for a, c in ((1.0, CUBE), (1.4, -CUBE))
    )
    search, groups, _ = looked_at(tmp_path, runs, held)
    form = discovered(search, groups, ["sensors"], {})
    assert form is not None
    assert form.ports[0].terms[0].term in ("y[2]^3", "x[2]^3")
    assert form.specification == {}
    assert form.refuted
    assert form.note == (
        "in the loop the whole gap on held-out condition is larger with the form than without it: it is of no use, and not adopted"
    )
    whole = [w for w in form.worse if w.on == "held-out condition" and w.channel == "all channels, whitened rms"]
    assert whole
    assert whole[0].after > whole[0].before


def test_where_the_replay_leaves_something_the_form_may_be(tmp_path: Path) -> None:
    """Blamed is another component; but what is left shows at the sensors, and they have outputs of their own."""
    start = prepared(Campaign.of(demo.SYSTEM, demo.measure(repeats=3), ()), demo.catalogue(tmp_path), resolve, convert)
    blamed = Where("masses", 1.0, None, "", "", "", [], log_odds=10.0, alternatives=(), outputs=("sensors.y",))
    assert suspects(Answer("unknown", (), where=(blamed,)), start.laboratory) == ["masses", "sensors"]


def test_a_late_sensor_is_like_a_delay_with_one_size(tmp_path: Path) -> None:
    runs = demo.measure(repeats=3)
    for column in ("sensors.y[1]", "sensors.y[2]"):
        runs = demo.changed(runs, column, lambda t, y: np.interp(t - LAG, t, y))
    search, groups, _ = looked_at(tmp_path, runs)
    form = discovered(search, groups, ["sensors"], {})
    assert form is not None
    assert any("like a delay of" in text and "sensors.y[1], sensors.y[2]" in text for text in form.like)


def test_nothing_is_found_where_nothing_is(tmp_path: Path) -> None:
    search, groups, _ = looked_at(tmp_path, demo.measure(repeats=3))
    assert discovered(search, groups, ["sensors"], {}) is None


class TestOnset:
    """A gain of the second sensor that is not there from the beginning."""

    def gained(self, since: float, size: float = 0.1) -> list[Run]:
        return demo.changed(demo.measure(repeats=4), "sensors.y[2]", lambda t, y: y * (1.0 + size * (t >= since)))

    def test_is_found_within_a_run(self, tmp_path: Path) -> None:
        search, _, _ = looked_at(tmp_path, self.gained(4.5))
        found = onset_of(search)
        assert found is not None
        assert (found.effect, found.location, found.how, found.run) == ("gain", "sensor 2", "switches on", None)
        assert found.interval is not None
        assert found.interval[0] <= 4.5 <= found.interval[1]
        assert found.text.startswith("something like gain at sensor 2 switches on at t = ")
        assert replace(found, named=True).text.startswith("gain at sensor 2 switches on at t = ")

    def test_is_found_between_runs(self, tmp_path: Path) -> None:
        runs = [*demo.measure(repeats=4)[:2], *self.gained(-1.0)[2:]]
        search, _, _ = looked_at(tmp_path, runs)
        found = onset_of(search)
        assert found is not None
        assert (found.effect, found.location, found.run) == ("gain", "sensor 2", 3)
        assert abs(found.value - 0.1) < demo.WELL
        assert found.text == f"something like gain at sensor 2 is there from run 3 of {found.condition} on, with {found.value:.4g} 1"

    def test_a_growing_effect_has_a_rate(self, tmp_path: Path) -> None:
        runs = demo.changed(demo.measure(repeats=4), "sensors.y[2]", lambda t, y: y * (1.0 + 0.05 * np.maximum(t - 3.0, 0.0)))
        search, _, _ = looked_at(tmp_path, runs)
        found = onset_of(search)
        assert found is not None
        assert found.how == "grows"
        assert found.rate is not None
        assert abs(found.rate - 0.05) < 0.05 * 0.1  # a tenth: an onset and a rate are known together
        assert "grows from t = " in found.text

    @pytest.mark.parametrize("sign", ["negative", "positive"])
    def test_an_effect_has_no_size_there_that_the_catalogue_does_not_let_it_have(self, tmp_path: Path, sign: str) -> None:
        search, _, _ = looked_at(tmp_path, self.gained(4.5, size=0.1 if sign == "positive" else -0.1))
        search.candidates = [replace(c, both_signs=False) if c.effect == "gain" else c for c in search.candidates]
        found = onset_of(search)
        assert (found is not None and (found.effect, found.location) == ("gain", "sensor 2")) is (sign == "positive")

    def test_an_effect_that_would_not_count_as_a_finding_begins_nowhere(self, tmp_path: Path) -> None:
        search, _, _ = looked_at(tmp_path, self.gained(4.5))
        found = onset_of(search)
        assert found is not None
        larger = 2.0 * abs(found.value)
        search.candidates = [replace(c, minimum=larger) if c.effect == "gain" else c for c in search.candidates]
        assert (other := onset_of(search)) is None or other.effect != "gain"

    @pytest.mark.parametrize("since", [-1.0, 4.5])
    def test_of_a_believed_model_only_an_effect_of_its_own_begins_beside_what_the_others_do(self, tmp_path: Path, since: float) -> None:
        """One gain is there all the time, and is much larger than the other one."""
        runs = demo.changed(self.gained(since), "sensors.y[1]", lambda t, y: 1.5 * y)
        search, _, _ = looked_at(tmp_path, runs)
        both = tuple(c for c in search.candidates if c.effect == "gain" and c.location in ("sensor 1", "sensor 2"))
        values = {a: x for c, x in zip(both, (0.5, 0.1), strict=True) for a in c.addresses}
        right = search.fitted(both, values, dict.fromkeys(values, 0.01))
        assert right is not None
        found = onset_of(search, right)
        assert (None if found is None else found.location) == (None if since < 0.0 else "sensor 2")

    @pytest.mark.parametrize(
        ("closed", "variable", "named", "stands"),
        [(0.99, "y", False, False), (0.5, "y", False, True), (0.99, "t", False, True), (0.99, "y", True, True)],
    )
    def test_a_law_that_is_there_all_the_time_and_closes_as_much_is_in_its_place(
        self, tmp_path: Path, closed: float, variable: str, named: bool, stands: bool
    ) -> None:
        search, _, _ = looked_at(tmp_path, self.gained(4.5))
        found = onset_of(search)
        assert found is not None
        assert 0.9 < found.closes < 0.99
        how_far: Any = (SimpleNamespace(channel=WHOLE, on=DIAGNOSED, closure=closed),)
        form = Form("sensors", "output", 0.0, (), how_far=how_far, specification={"terms": [{"factors": [{"variable": variable}]}]})
        assert onset.stands(replace(found, named=named), form) is stands
        assert onset.stands(found, replace(form, specification={}))  # refuted
        assert onset.stands(found, None)

    def test_an_effect_that_is_always_there_has_none(self, tmp_path: Path) -> None:
        search, _, _ = looked_at(tmp_path, self.gained(-1.0))
        assert onset_of(search) is None


def late_by(*seconds: float) -> Any:
    """A form of one port: rates of what it shows, with these coefficients."""
    host = SimpleNamespace(name="probe", ports={"shown": SimpleNamespace(unit="rad")})
    variable = SimpleNamespace(rate=True, name="shown", index="")
    term = SimpleNamespace(factors=[SimpleNamespace(kind="value", variable=variable)], unit=lambda port: "s")
    intervals = [[x * (3.12 / 3.05), x * (2.98 / 3.05)] for x in seconds]
    found = SimpleNamespace(values=list(seconds), intervals=intervals)
    terms = [("shown", term) for _ in seconds]
    return SimpleNamespace(terms=terms, found=found, problem=SimpleNamespace(seen=SimpleNamespace(host=host)))


@pytest.mark.parametrize(("seconds", "said"), [(-3.05e-3, "3.05 ms (2.98 to 3.12)"), (-32.4, "32.4 s (31.7 to 33.1)")])
def test_a_delay_is_in_a_unit_that_one_reads(seconds: float, said: str) -> None:
    assert like_delays([late_by(seconds)]) == (f"like a delay of {said} in probe.shown",)


def test_two_rates_of_one_port_are_not_said_to_be_a_delay() -> None:
    assert like_delays([late_by(-12.2e-3, 7.9e-3)]) == ()
