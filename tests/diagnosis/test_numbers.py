"""Numbers of the model that no effect is about: which they are, and what one of them does in an answer."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from robomill.diagnose_command import lines, write
from robomill.diagnosis import numbers
from robomill.diagnosis.candidates import Nuisance
from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.numbers import lacking
from robomill.diagnosis.outcome.answer import Diagnosis
from robomill.diagnosis.outcome.reasons import WHY
from tests.diagnosis.demo import SYSTEM, WELL, Force, catalogue, measure, real, resolve

UNITS = {
    ("masses", "damping"): "N.s/m",
    ("masses", "stiffness_error[1]"): "1",
    ("masses", "stiffness_error[3]"): "1",
    ("masses", "length[1]"): "m",
    ("masses", "length[2]"): "m",
    ("masses", "play"): "m",
}
VALUES = {
    ("masses", "damping"): 2.0,
    ("masses", "stiffness_error[1]"): 0.1,
    ("masses", "stiffness_error[3]"): 0.1,
    ("masses", "length[1]"): -0.5,
    ("masses", "length[2]"): 0.25,
    ("masses", "play"): 0.0,
}


def test_a_number_is_in_waiting_if_it_is_not_zero_and_no_effect_is_about_its_array(tmp_path: Path) -> None:
    found = lacking(catalogue(tmp_path), [Nuisance(("masses", "damping"), 0.02, 2.0)], VALUES, UNITS)
    assert [c.addresses[0][1] for c in found] == ["damping", "length[1]", "length[2]"]
    assert [c.locations for c in found] == [1, 2, 2]
    assert [c.unit for c in found] == ["N.s/m", "m", "m"]
    for c in found:
        size = abs(VALUES[c.addresses[0]])
        assert c.both_signs
        assert (c.minimum, c.prior.scale, c.maximum) == (numbers.OFF**2 * size, numbers.OFF * size, size / numbers.OFF)
        assert sorted(map(abs, c.bounds)) == [size, size / numbers.OFF]
        assert max(c.bounds, key=abs) * VALUES[c.addresses[0]] > 0.0


@pytest.mark.parametrize(("tolerance", "there"), [(0.19, True), (0.21, False)])
def test_a_number_whose_tolerance_is_as_wide_is_not_asked(tmp_path: Path, tolerance: float, there: bool) -> None:
    """A tolerance of 0.19 N.s/m is less than OFF of 2 N.s/m; were OFF twice as large, so would be 0.21."""
    found = lacking(catalogue(tmp_path), [Nuisance(("masses", "damping"), tolerance, 2.0)], VALUES, UNITS)
    assert (("masses", "damping") in {c.addresses[0] for c in found}) == there


class Actuator(Force):
    """Pushes in proportion to a constant that is a number of the model; the amplitude is one of the program."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.ports = (*self.ports, real("constant", "parameter", "N/A", 4.0))
        self.p["constant"] = 4.0

    def advance(self, t: float, h: float) -> None:
        super().advance(t, h)
        self.y[0] *= self.p["constant"] / 4.0


def answered(folder: Path, truth: Mapping[str, Mapping[str, float]], more: str = "") -> Diagnosis:
    """Two conditions are diagnosed, and one is held out."""
    runs = [*measure(truth), *measure(truth, amplitude=0.5, seed=2)]
    held_out = measure(truth, amplitude=1.5, seed=3)

    def resolver(source: str, name: str) -> Any:
        return Actuator(name) if source == "force" else resolve(source, name)

    return diagnose(SYSTEM, runs, catalogue(folder, more), held_out=held_out, resolver=resolver)


def test_several_effects_give_way_to_one_number_that_does_as_much(tmp_path: Path) -> None:
    """A force that is 8 % too large moves both masses by 8 % more, as two sensors do that show 8 % too much."""
    found = answered(tmp_path, {"force": {"gain_error": 0.08}})
    answer, one = found.answer, found.answer.number
    assert answer.verdict == "unknown"
    assert one is not None
    assert one.name == "force.constant"
    assert set(one.instead_of) == {"gain @ sensor 1", "gain @ sensor 2"}
    low, high = one.estimate.interval
    assert low < 0.32 < high
    assert one.estimate.value == pytest.approx(0.32, rel=WELL)
    assert one.estimate.given == 4.0
    assert one.becomes == [4.0 + x for x in (one.estimate.value, low, high)]
    assert one.probability > 0.9
    assert max(w.probability for w in answer.which) < 0.1
    assert answer.unknown is not None
    assert answer.unknown.why == ("number",)
    assert answer.form is None
    assert found.adopted == {("force", "constant"): one.becomes[0]}
    assert min(h.closure for h in answer.how_far if h.closure is not None) > 0.99
    said = lines(answer)
    assert f"unknown: the best model {WHY['number']}" in said
    (text,) = (line for line in said if line.startswith("number: "))
    assert text.startswith("number: force.constant is 4.3")
    assert "] N/A instead of 4, which does as much as gain @ sensor 2 + gain @ sensor 1; no effect of the catalogue is about it" in text
    assert not any(line.startswith("form: ") for line in said)
    page = write(found, SYSTEM, measure(repeats=1), catalogue(tmp_path), tmp_path / "answer").read_text(encoding="utf-8")
    assert "one number of the model does that no effect of the catalogue is about: force.constant is 4.3" in page
    assert "It is the number force.constant alone that closes this." in page
    assert 'name="force.constant"' in (tmp_path / "answer" / "adopt.ssv").read_text(encoding="utf-8").replace("'", '"')


SCALE = """
[[effect]]
name = "force gain"
component = "force"
description = "the actuator pushes too much"
source = "made up"
unit = "1"
minimum = 0.002
maximum = 0.5
sign = "both"
prior = {kind = "normal", scale = 0.05}
locations = [{name = "actuator", parameters = ["gain_error"]}]
"""


def test_an_effect_of_the_catalogue_that_does_it_alone_is_named_as_before(tmp_path: Path) -> None:
    found = answered(tmp_path, {"force": {"gain_error": 0.08}}, SCALE).answer
    assert (found.verdict, found.number, [w.effect for w in found.which]) == ("identified", None, ["force gain"])


def test_several_effects_that_are_there_stay(tmp_path: Path) -> None:
    found = answered(tmp_path, {"sensors": {"gain_error[1]": 0.08, "gain_error[2]": -0.05}}).answer
    assert (found.verdict, found.number) == ("identified", None)


def test_a_calibrated_number_that_is_far_beyond_its_tolerance_is_said_where_nothing_else_explains_the_gap(tmp_path: Path) -> None:
    """A damping of 2.6 in place of 2 N.s/m, known to 1 %."""
    found = answered(tmp_path, {"masses": {"damping": 2.6}}).answer
    assert found.verdict == "unknown"
    assert found.number is not None
    assert found.number.name == "masses.damping"
    assert found.number.instead_of == ()
    value, low, high = found.number.becomes
    assert low < 2.6 < high
    assert value == pytest.approx(2.6, rel=WELL)


def test_a_calibrated_number_that_is_far_off_stands_beside_an_effect_of_the_catalogue(tmp_path: Path) -> None:
    """A damping of 2.6 in place of 2 N.s/m, known to 1 %, and a sensor that shows 8 % too much."""
    found = answered(tmp_path, {"masses": {"damping": 2.6}, "sensors": {"gain_error[1]": 0.08}})
    answer, one = found.answer, found.answer.number
    assert answer.verdict == "unknown"
    assert one is not None
    assert (one.name, one.beside) == ("masses.damping", ("gain @ sensor 1",))
    assert "instead of 2, beside gain @ sensor 1" in one.text
    assert one.becomes[1] < 2.6 < one.becomes[2]
    first = answer.which[0]
    assert (first.effect, first.location) == ("gain", "sensor 1")
    assert first.probability > 0.5
    low, high = first.parameters["gain_error[1]"].interval
    assert low < 0.08 < high
    assert set(found.adopted) == {("masses", "damping"), ("sensors", "gain_error[1]")}
