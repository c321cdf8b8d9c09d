"""The report of a diagnosis: what each verdict says, and a page that is sound, alone and the same each time."""

from __future__ import annotations

import functools
import re
import shutil
import subprocess
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.image import imread

from robomill import report
from robomill.cell.equipment import load_system
from robomill.diagnose_command import lines
from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.experiment.design import Kind, Offer, Quantity
from robomill.diagnosis.forms.layout import Curve, Form, PortForm, Range, TermFound, Worse
from robomill.diagnosis.gate.checks import Finding
from robomill.diagnosis.inference.intervals import MATERIAL
from robomill.diagnosis.inference.machines import MACHINES
from robomill.diagnosis.localisation.where import Where
from robomill.diagnosis.outcome.answer import Answer, Diagnosis, Estimate, Gap, Menu, Number, Which
from robomill.diagnosis.outcome.calibration import Pulled
from robomill.diagnosis.outcome.closure import HowFar
from robomill.diagnosis.outcome.families import Family
from robomill.diagnosis.outcome.verdict import Tests as VerdictTests
from robomill.diagnosis.outcome.verdict import Verdict
from robomill.models.robot.kinematics import forward
from robomill.orchestration.runs.run import Run
from robomill.report import robot, units
from robomill.report.figures import draw_all, overlay
from robomill.report.page import page as html
from robomill.report.rests import sure
from robomill.report.sheet import Sheet
from robomill.report.style import COLOURS, MARK, WIDTH
from robomill.report.subject import Subject, of_number, size, verdict_sentence
from robomill.report.where import times
from robomill.report.which import section
from tests.diagnosis.demo import CATALOGUE, SYSTEM, changed, measure, resolve
from tests.tolerances import EXACT, ROUNDOFF

SCENARIOS = Path("scenarios")
STIFF = {"masses": {"stiffness_error[2]": -0.08}}
VERDICTS = ("none", "identified", "ambiguous", "unknown", "bad_log", "late")


def _catalogue(folder: Path, twin: bool = False) -> Catalogue:
    """The demo's; with an effect that does exactly what another does."""
    text = (
        CATALOGUE
        + '\n[titles]\n"sensors.y" = "displacement error"\n'
        + ("\n[[effect]]" + CATALOGUE.split("[[effect]]")[3].replace('"gain"', '"scale"') if twin else "")
    )
    (folder / "catalogue.toml").write_text(text)
    return Catalogue.load(folder / "catalogue.toml")


def _kinds() -> list[Kind]:
    """A push that is as hard as one likes."""

    def make(values: Mapping[str, float]) -> Offer:
        return Offer(SYSTEM, {"force": {"amplitude": values["amplitude"]}}, 6.0)

    return [Kind("harder push", (Quantity("amplitude", "N", 1.5, 2.5, 2.0),), 5.0, 3, make)]


def _subject(folder: Path, runs: list[Run], twin: bool = False, **more: Any) -> Subject:
    found = _catalogue(folder, twin)
    held = more.pop("held_out", [])
    result = diagnose(SYSTEM, runs, found, held_out=held, resolver=resolve, menu=Menu(kinds=_kinds), **more)
    return Subject(result, SYSTEM, [*runs, *held], found)


@pytest.fixture(scope="module")
def subject(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Subject]:
    """Verdict -> a real diagnosis of the two masses that ends so."""

    @functools.cache
    def made(verdict: str) -> Subject:
        folder = tmp_path_factory.mktemp(verdict)
        if verdict == "none":
            return _subject(folder, measure(seed=100))
        if verdict == "identified":
            held = measure(STIFF, repeats=2, seed=8) + measure(STIFF, amplitude=1.5, repeats=2, seed=9)
            return _subject(folder, measure(STIFF) + measure(STIFF, amplitude=0.6, seed=2), held_out=held)
        if verdict == "ambiguous":
            gain = {"sensors": {"gain_error[1]": 0.04}}
            return _subject(folder, measure(gain) + measure(gain, amplitude=0.6, seed=2), twin=True)
        if verdict == "growing":
            return _subject(folder, changed(measure(), "sensors.y[1]", lambda t, y: y * (1.001 + 0.001 * t)))
        if verdict == "unknown":
            return _subject(folder, changed(measure(), "sensors.y[1]", lambda t, y: y + 2e-3 * np.sin(9.0 * t) * (t > 5.0)))
        if verdict == "unknown elsewhere":
            rubbing = measure({"masses": {"friction[1]": 0.03}})
            return _subject(folder, rubbing, held_out=measure(amplitude=0.6, repeats=2, seed=2))
        if verdict == "bad_log":
            return _subject(folder, changed(measure(STIFF), "sensors.y[2]", lambda t, y: -y))
        return _subject(folder, changed(measure(), "sensors.y[2]", lambda t, y: np.interp(t - 0.02, t, y)))

    return made


@pytest.fixture(scope="module")
def page(subject: Callable[[str], Subject], tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Verdict -> its report.html."""

    @functools.cache
    def made(verdict: str) -> Path:
        return report.write(subject(verdict), tmp_path_factory.mktemp("report"))

    return made


def _saying(s: Subject, **more: Any) -> Subject:
    """The subject with another answer."""
    return replace(s, found=replace(s.found, answer=replace(s.answer, **more)))


def _text(page: Path | str) -> str:
    """What one reads, in one line; spaces as spaces."""
    body = (page if isinstance(page, str) else page.read_text(encoding="utf-8")).split("</style>", 1)[1]
    return re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", body)).replace("\u00a0", " ")


def _figures(page: Path) -> set[str]:
    return {f.name for f in (page.parent / "figures").iterdir()}


class TestContent:
    def test_identified_says_what_where_and_how_far_in_human_units(
        self, page: Callable[[str], Path], subject: Callable[[str], Subject]
    ) -> None:
        text = _text(page("identified"))
        value = subject("identified").answer.which[0].parameters["stiffness_error[2]"].value
        assert f"The gap is caused by stiffness, spring 2 (−{-100.0 * value:.2f} %)" in text
        assert re.search(
            r"with it in the model, in new conditions: displacement error from [\d.]+ [µm]+ to (within the noise of )?[\d.]+ [µm]+ \(rms\)",
            text,
        )
        assert "a spring is not as stiff as it should be" in text
        assert "robomill run SCENARIO.toml --adopt adopt.ssv" in text
        assert "New conditions" in text
        assert {
            f"{n}.{kind}" for n in ("steps", "shares", "signals", "overlay", "closure", "visible") for kind in ("svg", "png")
        } == _figures(page("identified"))

    def test_none_says_what_would_have_been_seen(self, page: Callable[[str], Path], subject: Callable[[str], Subject]) -> None:
        text = _text(page("none"))
        assert "No effect is needed to explain these runs" in text
        gain = min(v.value for v in subject("none").answer.smallest_visible if v.effect == "gain")
        assert units.quantity(gain, "%").replace("\u00a0", " ") in text
        assert "--adopt" not in text
        assert _figures(page("none")) == {"visible.svg", "visible.png"}

    def test_ambiguous_names_the_set_and_the_next_run(self, page: Callable[[str], Path]) -> None:
        text = _text(page("ambiguous"))
        assert re.search(r"causes that these runs cannot tell apart: \w+, sensor 1 \([\d.]+ %\) at \d\d(?:\.\d)? % or \w+, sensor 1", text)
        assert re.search(r"(gain|scale), sensor 1 against (gain|scale), sensor 1 0\.0 cannot be told apart", text)
        assert "No run that was looked at would tell apart gain, sensor 1 and scale, sensor 1" in text
        assert "harder push" in text
        assert re.search(r"amplitude = [12]\.\d+ N", text)

    def test_unknown_is_described(self, page: Callable[[str], Path]) -> None:
        text = _text(page("unknown"))
        assert "Something real that is not in the catalogue, in masses or sensors" in text  # the masses' positions are not measured
        assert "it shows most in sensors.y[1]" not in text  # by its title
        assert "it shows most in displacement error, element 1." in text
        assert "values should not be believed" in text
        assert "By the connections alone, what was measured cannot tell apart force, masses and sensors" in text
        assert "--adopt" not in text

    def test_what_does_not_hold_in_new_conditions_is_said_so(self, page: Callable[[str], Path], subject: Callable[[str], Subject]) -> None:
        text = _text(page("unknown elsewhere"))
        says = "the best model does not act equally strongly in all conditions"
        assert f"Something real that is not in the catalogue, in masses: {says}" in text
        assert "What speaks against it? It does not act equally strongly in all conditions" in text
        assert f"unknown: {says}" in lines(subject("unknown elsewhere").answer)
        assert re.search(r"p_fit = \S+, made of left \S+, worse \S+, elsewhere \S+, alike [−-]\S+, calibrated \S+ and lag \S+ nats\.", text)
        assert re.search(r"which were not fitted, the nearest candidate acts \S+ ± \S+ times as strongly as it should", text)
        assert re.search(r"Gain in log score in new conditions \S+ nats, \S+ nats expected", text)
        assert "--adopt" not in text

    def test_what_leaves_much_says_how_much(self, subject: Callable[[str], Subject]) -> None:
        s = subject("unknown elsewhere")
        assert s.answer.unknown is not None
        left = _saying(s, unknown=replace(s.answer.unknown, why=("left", "calibrated")))
        assert re.search(
            r"the best model leaves [\d.]+\s% of the gap, in that signal of the diagnosed runs where it explains least;",
            verdict_sentence(left),
        )

    def test_what_changes_with_time_is_described_by_what_it_is_like(self, page: Callable[[str], Path]) -> None:
        text = _text(page("growing"))
        assert "the best model does not change with time as the gap does" in text
        assert "it is like what gain, sensor 1 would do if that grows steadily during a run. That is a description, not a cause." in text

    def test_the_answer_in_sentences_says_what_it_is_worth_in_new_conditions(self, subject: Callable[[str], Subject]) -> None:
        said = [line for line in lines(subject("identified").answer) if line.startswith("new conditions")]
        assert len(said) == 1
        assert re.fullmatch(
            r"new conditions: gains \S+ nats of \S+ expected, leaves [\d.]+ times the chi2 of noise and discrepancy, nominal [\d.]+",
            said[0],
        )
        assert not [line for line in lines(subject("ambiguous").answer) if line.startswith("new conditions")]  # nothing was held out

    def test_where_there_is_no_effect_sentences_say_how_much_of_the_gap_tolerances_take(self, subject: Callable[[str], Subject]) -> None:
        answer = subject("none").answer
        assert answer.gap is not None

        def said(**gap: float) -> list[str]:
            return [line for line in lines(replace(answer, gap=replace(answer.gap, farthest=far, **gap))) if line.startswith("gap")]

        assert answer.gap.farthest is not None
        far = None

        known = "gap: 94\N{NO-BREAK SPACE}% of it lies within the tolerances of calibrated numbers"
        assert said(before=50.0, within_calibration=47.0, noise=3.0, noise_is_a_guess=False) == [known]
        guessed = f"{known}; whether the rest is noise is a guess"
        assert said(before=50.0, within_calibration=47.0, noise=3.0, noise_is_a_guess=True) == [guessed]
        far = Pulled("masses", "damping", 2.0, 2.04, 2.0, "N.s/m")
        text = "masses.damping is 2.0 times its tolerance above what is given: about 2.04 N.s/m, not 2 N.s/m"
        assert said(before=50.0, within_calibration=47.0, noise=3.0, noise_is_a_guess=False) == [f"{known}; the farthest off: {text}"]
        assert not said(before=2.0, within_calibration=1.0, noise=3.0)  # there is none
        assert not [line for line in lines(subject("identified").answer) if line.startswith("gap")]

    def test_what_closes_next_to_nothing_is_listed_as_no_cause(self, subject: Callable[[str], Subject]) -> None:
        answer = subject("identified").answer
        (first, *_) = answer.which
        for closes, ends in (
            (0.004, "; closes next to nothing: listed, no cause"),
            (0.006, first.parameters[next(iter(first.parameters))].unit),
        ):
            said = lines(replace(answer, which=(replace(first, closes=closes),)))
            assert next(line for line in said if line.startswith("which")).endswith(ends)

    def test_a_bad_log_is_shown_with_the_reason(self, page: Callable[[str], Path]) -> None:
        text = _text(page("bad_log"))
        assert "This log cannot be diagnosed: sensors.y[2] has the wrong sign" in text
        assert "stops the diagnosis" in text
        assert "robomill import" in text
        assert _figures(page("bad_log")) == {"log.svg", "log.png"}

    def test_a_late_clock_comes_with_its_remedy(self, page: Callable[[str], Path]) -> None:
        text = _text(page("late"))
        assert "This log cannot be diagnosed: the clock of the second channel is late by 20" in text
        assert "--repair" in text

    def test_findings_that_do_not_stop_are_notes(self, subject: Callable[[str], Subject]) -> None:
        s = subject("identified")
        finding = Finding("t", "time", 0.06, "s", "no samples", fatal=False)
        text = _text(html(_saying(s, findings=(finding, replace(finding, text="late", repaired=True))), {}))
        assert "no samples 60.0 ms noted" in text
        assert "late 60.0 ms corrected" in text

    def test_a_guess_of_the_noise_is_called_one(self, subject: Callable[[str], Subject]) -> None:
        s = subject("identified")
        guess = replace(s.answer.gap, noise_is_a_guess=True)
        assert "the noise is a guess" in _text(html(_saying(s, gap=guess), {}))
        assert "the noise is a guess" not in _text(html(s, {}))

    def test_effect_by_effect_ends_at_what_remains(self, page: Callable[[str], Path], subject: Callable[[str], Subject]) -> None:
        text = _text(page("identified"))
        far = next(h for h in subject("identified").answer.how_far if h.on == "held-out condition" and h.channel == "sensors.y")
        assert f"stiffness, spring 2 {size(far, far.after)}".replace("\u00a0", " ") in text
        assert f"noise {size(far, far.floor)} –".replace("\u00a0", " ") in text

    def test_no_jargon_outside_of_a_fold(self, page: Callable[[str], Path]) -> None:
        for verdict in (*VERDICTS, "unknown elsewhere", "growing"):
            body = page(verdict).read_text(encoding="utf-8").split("</style>", 1)[1]
            shown = re.sub(r"<details.*?</details>", "", body, flags=re.DOTALL)
            assert [word for word in ("nats", "whiten", "chi2", "posterior", "nan %", "126 %") if word in shown] == []

    def test_tests_are_told_in_words(self, page: Callable[[str], Path], subject: Callable[[str], Subject]) -> None:
        text = _text(page("identified"))
        assert f"have none, fewer than 1 in {MACHINES} speak as strongly for one as these runs do" in text
        assert "That the best model is right is practically certain" in text
        s = subject("none")
        tests = s.answer.tests
        assert tests is not None
        assert "so no effect is believed" in _text(html(_saying(s, tests=replace(tests, p_none=0.4)), {}))
        doubtful = replace(tests, p_none=1e-3, nothing=0.4)
        assert "but that nothing is wrong has a probability of 40 %, more than that limit" in _text(html(_saying(s, tests=doubtful), {}))
        refuted = _text(html(_saying(s, tests=replace(doubtful, nothing=1e-3, p_fit=0.05)), {}))
        assert "That the nearest one is right is very unlikely (5 %)" in refuted
        assert "Probability that nothing is wrong" not in refuted

    def test_what_remains_is_never_nothing(self, subject: Callable[[str], Subject]) -> None:
        s = subject("identified")
        far = tuple(replace(h, after=0.0, closure=1.0, interval=[0.93, 1.0], within_noise=True) for h in s.answer.how_far)
        text = _text(html(_saying(s, how_far=far, steps=None), {}))
        assert "to within the noise of" in verdict_sentence(_saying(s, how_far=far))
        assert "to within the noise at least 93 %" in text
        assert not re.search(r"\b0 µ?m\b|closed 100 %", text)

    def test_a_form_of_the_unknown_is_shown(self, subject: Callable[[str], Subject], tmp_path: Path) -> None:
        s = subject("unknown")
        assert 'id="form"' not in html(s, {})
        term = TermFound("sgn(v)", 0.3, [0.28, 0.33], "N", 0.7)
        curve = Curve("v", "m/s", [-1.0, 1.0], [-0.31, 0.29], [-0.3, 0.3])
        port = PortForm("masses.force", "N", "0.3 sgn(v)", (term,), 0.97, curve)
        far = HowFar("x rms", "all channels, whitened", "1", "held-out condition", 9.0, 2.0, 1.0, 0.95, [0.9, 0.97], 1.0, "repeats", 0.95)
        bad = (Worse("sensors.y[2]", "held-out condition", 1e-6, 2e-6, "m"),)
        form = Form(
            "masses", "input", 0.0, (port,), ("like friction",), (far,), (Range("v", "m/s", [-1.0, 2.0], None),), bad, "", {"name": "x"}
        )
        formed = _saying(s, form=form)
        text = _text(report.write(formed, tmp_path))
        for said in ("masses.force += 0.3 sgn(v) [N]", "0.300 N 0.280 to 0.330 70 %", "It is like friction.", "v −1.00 to 2.00 m/s –"):
            assert said in text
        assert "It makes worse: sensors.y[2] (new conditions: from 1.00 µm to 2.00 µm)" in text
        assert "a form that was found for it closes 95 % of the gap in new conditions" in text
        assert {"form.svg", "form.png"} <= _figures(tmp_path / "report.html")
        assert "form: masses.force lacks 0.3 sgn(v) (N), which closes 97 %" in lines(formed.answer)

    @pytest.mark.parametrize(("closure", "said"), [(0.97, True), (0.9, False)])
    def test_where_the_nearest_effects_close_more_than_the_form_that_is_said(
        self, subject: Callable[[str], Subject], closure: float, said: bool
    ) -> None:
        s = subject("unknown")
        port = PortForm("masses.force", "N", "0.3 sgn(v)", (), 0.97, None)
        far = HowFar("x rms", "all channels, whitened", "1", "held-out condition", 9.0, 2.0, 1.0, 0.95, [0.9, 0.97], 1.0, "repeats", 0.95)
        form = Form("masses", "input", 0.0, (port,), (), (far,), specification={"name": "x"})
        both = _saying(s, form=form, how_far=(replace(far, closure=closure),))
        assert ("in new conditions, the effects that are nearest 97\u00a0%" in verdict_sentence(both)) is said
        line = "form: the effects that are nearest close more of the whole gap (all signals, each over its noise), 97 %, held-out condition"
        assert (line in lines(both.answer)) is said

    def test_a_form_that_makes_a_signal_larger_says_so_on_the_console(self, subject: Callable[[str], Subject]) -> None:
        port = PortForm("masses.force", "N", "0.3 sgn(v)", (), 0.97, None)
        near = HowFar("y rms", "sensors.y[2]", "m", "diagnosed runs", 1e-3, 2e-3, 2e-3, -3.0, [-3.5, -2.5], 1.0, "repeats", -3.0)
        form = Form("masses", "input", 0.0, (port,), (), (near, replace(near, closure=0.9, metric="x rms")), specification={"name": "x"})
        line = "form: in the loop it makes larger: y rms; look at that before it is adopted"
        assert line in lines(_saying(subject("unknown"), form=form).answer)
        better = replace(form, how_far=form.how_far[1:])
        assert not any("makes larger" in said for said in lines(_saying(subject("unknown"), form=better).answer))

    def test_a_form_that_the_loop_refutes_is_said_to_be_of_no_use(self, subject: Callable[[str], Subject], tmp_path: Path) -> None:
        """What it closes outside of the loop is no merit: no closure is printed."""
        curve = Curve("v", "m/s", [-1.0, 1.0], [-0.31, 0.29], [-0.3, 0.3])
        port = PortForm("masses.force", "N", "0.3 sgn(v)", (TermFound("sgn(v)", 0.3, [0.28, 0.33], "N", 0.7),), 0.97, curve)
        far = HowFar("y rms", "sensors.y[2]", "m", "diagnosed runs", 1e-3, 2e-3, 2e-3, -3.0, [-3.5, -2.5], 1.0, "repeats", -3.0)
        note = "in the loop the whole gap on diagnosed runs is larger with the form than without it: it is of no use, and not adopted"
        form = Form("masses", "input", 0.0, (port,), (), (far,), (), (), note)
        assert form.refuted
        assert not replace(form, how_far=()).refuted
        refuted = _saying(subject("unknown"), form=form)
        said = [line for line in lines(refuted.answer) if line.startswith("form")]
        assert said == [
            "form: masses.force lacks 0.3 sgn(v) (N): of no use",
            f"form: {note}",
            "form in the loop: y rms, diagnosed runs: 0.001 -> 0.002 m",
        ]
        text = _text(report.write(refuted, tmp_path))
        assert "no form was found for it that is of use. This one is a sum of terms, added to what goes into masses" in text
        assert note in text
        for merit in ("but it has a form", "97 %", "a form that was found for it closes"):
            assert merit not in text
        assert not {"form.svg", "form.png"} & _figures(tmp_path / "report.html")

    def test_runs_date_and_version_are_said(self, subject: Callable[[str], Subject]) -> None:
        s = subject("identified")
        run = replace(s.runs[0], info={"imported": {"date": "2026-11-20T08:15:30+00:00"}, "labels": {"condition": "slot"}})
        clock = replace(run, info={"imported": {"date": "1970-01-01T00:00:13+00:00"}})
        text = _text(html(replace(s, runs=[run, clock], made="diagnosed on 2026-11-24 by robomill 0.1.0"), {}))
        assert "slot 2026-11-20 08:15" in text
        assert "1970" not in text
        assert "Diagnosed on 2026-11-24 by robomill 0.1.0." in text

    def test_a_page_of_the_runs_in_space_is_linked_where_it_is(self, subject: Callable[[str], Subject], tmp_path: Path) -> None:
        s = subject("none")
        assert "view.html" not in report.write(s, tmp_path).read_text()
        (tmp_path / "view.html").write_text("<html></html>")
        assert '<a href="view.html">' in report.write(s, tmp_path).read_text()

    def test_clocks_that_were_not_looked_for_are_said(self, subject: Callable[[str], Subject]) -> None:
        s = subject("none")
        assert "units, axes and clocks were looked at; nothing was found." in _text(html(s, {}))
        without = replace(s.catalogue, candidates=tuple(c for c in s.catalogue.candidates if c.component != "logging"))
        said = _text(html(replace(s, catalogue=without), {}))
        assert "units and axes were looked at; nothing was found. Clocks that are late were not looked for" in said

    def test_names_are_escaped(self, subject: Callable[[str], Subject]) -> None:
        text = html(replace(subject("none"), system=replace(SYSTEM, name="a <b> & c")), {})
        assert "a &lt;b&gt; &amp; c" in text
        assert "<b>" not in text


@pytest.mark.parametrize("verdict", VERDICTS)
class TestPage:
    def test_is_well_formed_and_its_links_lead_somewhere(self, page: Callable[[str], Path], verdict: str) -> None:
        text = page(verdict).read_text(encoding="utf-8")
        root = ElementTree.fromstring(text.removeprefix("<!DOCTYPE html>"))
        counted = Counter(e.get("id") for e in root.iter() if e.get("id"))
        assert {i: n for i, n in counted.items() if n > 1} == {}
        links = re.findall(r'href="#([^"]+)"|url\(#([^)]+)\)', text)
        assert {a or b for a, b in links} <= set(counted)

    def test_needs_nothing_but_itself(self, page: Callable[[str], Path], verdict: str) -> None:
        text = page(verdict).read_text(encoding="utf-8")
        addresses = set(re.findall(r'https?://[^"\s]+', text))
        assert addresses <= {"http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"}  # names of XML, nobody opens them
        for outside in (r'(?:src|href)="(?!#)', r"url\((?!#)", "@import", "<script", "<link", "<img", "<iframe"):
            assert not re.search(outside, text)

    def test_its_colours_are_those_of_the_style_sheet(self, page: Callable[[str], Path], verdict: str) -> None:
        style, body = page(verdict).read_text(encoding="utf-8").split("</style>", 1)
        assert [c for c in COLOURS.values() if c in body] == []
        for name in re.findall(r"var\(--([a-z]+)\)", body):
            assert style.count(f"--{name}:") in (1, 3)  # letters once; colours in light, dark and print


def test_it_is_the_same_each_time(subject: Callable[[str], Subject], page: Callable[[str], Path], tmp_path: Path) -> None:
    first, second = page("identified").parent, report.write(subject("identified"), tmp_path).parent
    files = sorted(f.relative_to(first) for f in first.rglob("*") if f.is_file())
    assert files == sorted(f.relative_to(second) for f in second.rglob("*") if f.is_file())
    assert [f for f in files if (first / f).read_bytes() != (second / f).read_bytes()] == []


def test_figures_of_an_earlier_answer_go(subject: Callable[[str], Subject], tmp_path: Path) -> None:
    report.write(subject("bad_log"), tmp_path)
    assert _figures(report.write(subject("none"), tmp_path)) == {"visible.svg", "visible.png"}


class TestUnits:
    @pytest.mark.parametrize(
        ("value", "interval", "unit", "expected"),
        [
            (80.2e-6, (79.1e-6, 81.3e-6), "rad", ("80.2 µrad", "79.1 to 81.3")),
            (0.0349, (0.03, 0.04), "rad", ("2.00°", "1.72 to 2.29")),
            (0.0501, (0.0498, 0.0504), "s", ("50.10 ms", "49.80 to 50.40")),
            (-0.122, (-0.142, -0.102), "%", ("−12.2 %", "−14.2 to −10.2")),
            (2.1e-8, (2.0e-8, 2.2e-8), "m/N", ("0.0210 µm/N", "0.0200 to 0.0220")),
            (123456.0, (120000.0, 126912.0), "N.m/rad", ("123\u202f456 N m/rad", "120\u202f000 to 126\u202f912")),
        ],
    )
    def test_values_have_the_digits_of_their_interval(
        self, value: float, interval: tuple[float, float], unit: str, expected: tuple[str, str]
    ) -> None:
        assert tuple(t.replace("\u00a0", " ") for t in units.with_interval(value, interval, unit)) == expected

    @pytest.mark.parametrize(
        ("share", "text"),
        [(0.937, "94 %"), (0.996, "99.6 %"), (1.0, "100 %"), (1.001, "100 %"), (0.003, "0.3 %"), (-0.05, "−5 %"), (-1e-5, "0 %")],
    )
    def test_percentages_do_not_say_all_or_nothing_of_less(self, share: float, text: str) -> None:
        assert units.percent(share).replace("\u00a0", " ") == text

    def test_percentages_of_many_times_are_large(self) -> None:
        texts = [units.percent(share).replace("\u00a0", " ") for share in (9.0, 15.0, -15.0)]
        assert texts == ["900 %", "over 1000 %", "below −1000 %"]  # MANIFOLD

    def test_intervals_go_from_low_to_high(self) -> None:
        assert units.with_interval(-2.0, (-1.5, -2.5), "N")[1] == "−2.50 to −1.50"
        assert units.percent_interval([0.98, 0.9]).replace("\u00a0", " ") == "90 % to 98 %"
        assert units.percent_interval([0.97301, 0.97302]).replace("\u00a0", " ") == "within 0.1 %"
        assert units.percent_interval([-43.0, -12.0]).replace("\u00a0", " ") == "below −1000 %"

    def test_a_number_with_many_decimals_has_an_exponent(self) -> None:
        assert [units.number(x) for x in (1.234e-3, 1.234e-5, -3e-14)] == ["0.00123", "1.23e−05", "−3e−14"]  # DECIMALS

    def test_an_exponent_is_no_percentage(self) -> None:
        assert units.relative("size_effect_exponent", "1") == "1"
        assert units.relative("stiffness_error[2]", "1") == "%"

    def test_what_is_more_than_all_is_no_percentage(self) -> None:
        """FMUs often state no unit: a viscous friction of 287 is not one of 28 700 %."""
        assert units.quantity(0.2, "%") == "20.0\u00a0%"
        assert units.quantity(287.0, "%") == "287"
        assert units.with_interval(2.68, (1.96, 3.4), "%") == ("2.68", "1.96 to 3.40")

    def test_numbers_that_are_none(self) -> None:
        assert [units.number(x) for x in (float("nan"), float("inf"), -0.0)] == ["–", "∞", "0"]


ANGLES = np.deg2rad([[10.0, -70.0, 100.0, 5.0, -30.0, 20.0], [12.0, -68.0, 99.0, 4.0, -31.0, 21.0]])


def _cell(*which: Which, verdict: Verdict = "identified") -> Subject:
    """A diagnosis of the milling cell with these entries in `which`, at ANGLES."""
    channels = tuple(f"drive.q_motor[{i}]" for i in range(1, 7))
    curves = {"t": np.array([0.0, 1.0]), "measured": ANGLES, "nominal": ANGLES, "spread": np.full(6, 1e-6)}
    answer = Answer(verdict, which=which, gap=Gap(1.0, 0.0, 0.0, 0.1, 0.02, noise_is_a_guess=False))
    found = Diagnosis(answer, {}, channels=channels, curves={"slot": curves})
    return Subject(found, load_system(SCENARIOS / "milling_cell.toml"), [], Catalogue.load(SCENARIOS / "catalogue.toml"))


class TestRobot:
    def test_the_drawn_tool_tip_is_that_of_the_kinematics(self) -> None:
        body = robot.geometry(robot.arm(load_system(SCENARIOS / "milling_cell.toml")))
        drawn = robot.pose(body, ANGLES[0])
        forward(body, ANGLES[0])
        assert np.abs(drawn.tip - body.link_p[6]).max() == EXACT
        # the spindle stands on the axis of the tool, and the elbow on that of the forearm
        assert np.linalg.norm(np.cross(drawn.spindle - drawn.tip, body.link_R[6][:, 0])) < 1e-9
        assert np.linalg.norm(np.cross(drawn.elbow - drawn.joints[4], body.link_R[3][:, 2])) < 1e-9

    def test_lengths_given_in_the_system_are_used(self) -> None:
        arm = robot.arm(load_system(SCENARIOS / "milling_cell.toml"))
        assert arm is not None
        longer = replace(arm, parameters={"dh_a[3]": 1.3, "p_FT_F": [0.1, 0.0, 0.2]})
        body = robot.geometry(longer)
        assert body.dh_a[2] == 1.3
        assert list(body.p_FT_F) == [0.1, 0.0, 0.2]

    def test_the_named_joint_is_marked(self, tmp_path: Path) -> None:
        svg = draw_all(_cell(Which("backlash", "drive", "joint 3", 0.97, {}, [])), tmp_path)["robot"]
        assert "backlash, joint 3" in svg
        circle = (tmp_path / "robot.svg").read_text().split(MARK)
        assert len(circle) > 3  # both views and the line to the name

    @pytest.mark.parametrize("component", ["compliance", "drive", "sensor", "milling"])
    def test_every_place_of_the_catalogue_is_on_the_arm(self, component: str) -> None:
        candidates = [
            c for c in Catalogue.load(SCENARIOS / "catalogue.toml").candidates if c.component == component and c.location != "path"
        ]
        body = robot.geometry(robot.arm(load_system(SCENARIOS / "milling_cell.toml")))
        drawn = robot.pose(body, ANGLES[0])
        for c in candidates:
            places = robot.parts(c.component, c.location, c.effect)
            assert places, c.name
            assert all(np.isfinite(robot.place_of(p, drawn, drawn.tip[None, :])).all() for p in places)

    @pytest.mark.parametrize("component", ["controller", "logging"])
    def test_what_is_not_on_the_arm_is_not_drawn(self, component: str, tmp_path: Path) -> None:
        assert "robot" not in draw_all(_cell(Which("extra_delay", component, "corrections", 0.97, {}, [])), tmp_path)

    @pytest.mark.parametrize(("probability", "marked"), [(0.03, set()), (0.07, {"joint 3"})])
    def test_what_is_hardly_likely_is_not_marked(self, probability: float, marked: set[str]) -> None:
        entry = Which("backlash", "drive", "joint 3", probability, {}, [])
        assert set(robot.marks(_cell(entry, verdict="ambiguous"))) == marked  # LIKELY

    def test_a_system_without_a_robot_has_no_drawing(self, subject: Callable[[str], Subject]) -> None:
        assert robot.draw(subject("identified"), Sheet(WIDTH)) is None


def test_labels_are_those_that_people_use() -> None:
    titles = {
        "drive.q_motor": "motor angle error",
        "compliance.p_BT_B": "tool-tip path error",
        "milling.spindle_torque": "spindle torque error",
    }
    s = _cell()
    s = replace(s, found=replace(s.found, titles=titles))
    channels = ("drive.q_motor[3]", "compliance.p_BT_B[2]", "milling.spindle_torque", "sensor.f_T_T[1]")
    assert [s.label(c) for c in channels] == [
        "motor angle error, joint 3",
        "tool-tip path error, y",
        "spindle torque error",
        "sensor.f_T_T, x",
    ]


def test_two_causes_are_both_in_the_sentence() -> None:
    one = Which("backlash", "drive", "joint 3", 0.97, {"backlash[3]": Estimate(8e-5, [7e-5, 9e-5], "rad")}, [])
    other = Which("tool_wear", "milling", "cutter", 0.9, {"tool_wear": Estimate(0.2, [0.1, 0.3], "1")}, [])
    sentence = verdict_sentence(_cell(one, other)).replace("\u00a0", " ")
    assert sentence == "The gap is caused by backlash, joint 3 (80.0 µrad) and tool wear, cutter (20.0 %)."


def test_what_closes_hardly_anything_is_listed_and_no_cause() -> None:
    one = Which("backlash", "drive", "joint 3", 0.97, {"backlash[3]": Estimate(8e-5, [7e-5, 9e-5], "rad")}, [], closes=0.9)
    small = Which("tool_wear", "milling", "cutter", 0.95, {"tool_wear": Estimate(0.2, [0.1, 0.3], "1")}, [], closes=0.9 * MATERIAL)
    sentence = verdict_sentence(_cell(one, small)).replace("\u00a0", " ")
    assert sentence == "The gap is caused by backlash, joint 3 (80.0 µrad)."
    assert "listed, no cause" in section(_cell(one, small))
    assert "listed, no cause" not in section(_cell(one, replace(small, closes=MATERIAL)))


def test_a_number_that_an_answer_needs_far_off_is_on_the_page_and_on_the_lines(subject: Callable[[str], Subject]) -> None:
    off = Pulled("masses", "damping", 2.0, 2.11, 5.5, "N.s/m")
    said = "masses.damping is 5.5 times its tolerance above what is given: about 2.11 N.s/m, not 2 N.s/m"
    s = subject("identified")
    assert f"{said}. Measure these numbers anew." in sure(_saying(s, calibrated=(off,)))
    assert "Measure these numbers anew" not in sure(s)
    assert f"calibrated: {said}" in lines(replace(s.answer, calibrated=(off,)))
    assert not [line for line in lines(s.answer) if line.startswith("calibrated")]


def test_what_comes_on_top_of_what_the_system_has_says_so() -> None:
    one = Which("backlash", "drive", "joint 3", 0.97, {"backlash[3]": Estimate(8e-5, [7e-5, 9e-5], "rad", 2e-5)}, [])
    assert "on top of 20.0" in section(_cell(one))
    bare = replace(one, parameters={"backlash[3]": Estimate(8e-5, [7e-5, 9e-5], "rad")})
    assert "on top of" not in section(_cell(bare))


@pytest.mark.parametrize(("probability", "said"), [(0.73, False), (0.76, True)])
def test_a_set_is_shown_where_it_is_likelier_than_its_likeliest_member(probability: float, said: bool) -> None:
    """Where effects are all there, none is in the place of another."""
    family = Family("friction", probability, {"coulomb @ joint 1": 0.73, "coulomb @ joint 2": 0.7})
    one = Which("coulomb", "drive", "joint 1", 0.73, {"coulomb[1]": Estimate(0.3, [0.2, 0.4], "N.m")}, [])
    s = _cell(one, verdict="ambiguous")
    assert ("Sets that hold the cause" in section(_saying(s, families=(family,)))) is said


@pytest.mark.parametrize(
    ("count", "said"), [(1, "This one remains, or something without a name"), (2, "These remain, and the runs cannot choose")]
)
def test_what_an_ambiguous_answer_leaves_is_said_by_number(count: int, said: str) -> None:
    entries = [Which("coulomb", "drive", f"joint {i}", 0.55, {f"coulomb[{i}]": Estimate(0.3, [0.2, 0.4], "N.m")}, []) for i in (1, 2)]
    assert said in section(_cell(*entries[:count], verdict="ambiguous"))


def test_effects_that_are_not_printed_are_counted() -> None:
    size = {"backlash[3]": Estimate(8e-5, [7e-5, 9e-5], "rad")}

    def printed(likely: int, others: int) -> list[str]:
        each = [*[0.7] * likely, *[0.2] * others]
        entries = [Which("backlash", "drive", f"joint {i}", p, size, []) for i, p in enumerate(each)]
        return [line for line in lines(_cell(*entries, verdict="ambiguous").answer) if line.startswith("which:")]

    assert len(printed(2, 4)) == 6
    assert printed(2, 5)[6:] == ["which: 1 more, with probabilities up to 0.20, in the report"]
    assert len(printed(8, 0)) == 8
    assert printed(8, 2)[8:] == ["which: 2 more, with probabilities up to 0.20, in the report"]


def test_of_an_answer_that_is_unknown_the_console_says_which_is_likeliest_if_the_catalogue_has_it() -> None:
    """What is wrong is where something of the gap is: a share that closes next to nothing is not printed."""
    size = {"backlash[3]": Estimate(8e-5, [7e-5, 9e-5], "rad")}
    near, far = (Which("backlash", "drive", f"joint {i}", p, size, []) for i, p in ((3, 0.009), (4, 0.001)))
    where = tuple(Where("drive", share, None, "joint 3", "q", "q", []) for share in (0.9, 0.004))
    tests = VerdictTests(0.02, 0.0, 0.01, 0.0)
    answer = replace(_cell(near, far, verdict="unknown").answer, tests=tests, where=where)
    said = lines(answer)
    assert [line.partition(", backlash")[0] for line in said if line.startswith("which")] == [
        "which: backlash at joint 3, probability 0.01 (0.90 if the cause is in the catalogue)",
        "which: backlash at joint 4, probability 0.00 (0.10 if the cause is in the catalogue)",
    ]
    assert sum(line.startswith("where") for line in said) == 1
    none = "form: none was found that predicts parts of the runs that were left out"
    assert none in said
    sure = lines(replace(answer, verdict="ambiguous"))
    assert not any("if the cause is in the catalogue" in line for line in sure)
    assert none not in sure


def test_many_causes_are_counted() -> None:
    """CAUSES are named."""
    size = {"backlash[3]": Estimate(8e-5, [7e-5, 9e-5], "rad")}
    entries = [Which("backlash", "drive", f"joint {i}", 0.15, size, []) for i in range(1, 7)]
    sentence = verdict_sentence(_cell(*entries, verdict="ambiguous"))
    assert re.findall(r"joint (\d)", sentence) == ["1", "2", "3", "4"]
    assert sentence.endswith(" or one of 2 others.")


@pytest.mark.parametrize(
    ("each", "said"),
    [
        ([0.74], "The likeliest answer is not sure: backlash, joint 1 (80.0 µrad) at 74 %."),
        ([0.97, 0.6], "The gap is caused by backlash, joint 1 (80.0 µrad). What is beside it is not sure: backlash, joint 2"),
        ([0.97, 0.9, 0.6, 0.7], "What is beside them is not sure: backlash, joint 3 (80.0 µrad) at 60 % and backlash, joint 4"),
        ([0.97, 0.6, 0.3], "together with one of several causes that these runs cannot tell apart: backlash, joint 2"),
        ([0.7] * 6, "at 70 %; backlash, joint 4 (80.0 µrad) at 70 % and 2 others."),
    ],
)
def test_what_is_doubtful_is_said_as_what_it_is(each: list[float], said: str) -> None:
    """A set of which one member is there, or effects that may all be there: their probabilities add up to more than 1."""
    size = {"backlash[3]": Estimate(8e-5, [7e-5, 9e-5], "rad")}
    entries = [Which("backlash", "drive", f"joint {i}", p, size, []) for i, p in enumerate(each, 1)]
    assert said in verdict_sentence(_cell(*entries, verdict="ambiguous")).replace("\u00a0", " ")


def test_what_may_be_slow_noise_is_said_where_nothing_is_named(subject: Callable[[str], Subject]) -> None:
    late = Which("clock", "logging", "log", 0.86, {"lag sensors.y": Estimate(0.029, [0.025, 0.033], "s")}, [])
    tests = VerdictTests(0.02, 0.0005, 0.9, 0.001)
    s = subject("none")
    assert s.answer.gap is not None
    s = _saying(s, which=(late,), tests=tests, gap=replace(s.answer.gap, noise_is_a_guess=True))
    assert "It may be noise that is slow, or clock, log (29.0 ms); repeats say which." in verdict_sentence(s).replace("\u00a0", " ")
    assert "suspected: noise that is slow, or clock at log; repeats say which" in lines(s.answer)
    unsure = _saying(s, tests=replace(tests, nothing=0.03))
    said = "that nothing is wrong has a probability of 3 %, and the limit is 2 %"
    assert f"It may be clock, log (29.0 ms); but {said}." in verdict_sentence(unsure).replace("\u00a0", " ")
    assert f"suspected: clock at log; but {said}" in [line.replace("\u00a0", " ") for line in lines(unsure.answer)]
    assert not _saying(s, tests=replace(tests, nothing=0.6)).answer.suspected
    for known in (
        _saying(s, tests=replace(tests, p_none=0.5)),
        _saying(s, gap=replace(s.answer.gap, noise_is_a_guess=False)),
        _saying(s, which=(replace(late, probability=0.4),)),
    ):
        assert "slow" not in verdict_sentence(known)
        assert not [line for line in lines(known.answer) if line.startswith("suspected")]


def test_many_intervals_are_not_all_named() -> None:
    """INTERVALS are."""
    regime = [[0.1 * i, 0.1 * i + 0.05] for i in range(6)]
    text = times(_cell(), regime)
    assert text.count(" to ") == 4
    assert text.endswith(" … s")
    assert "…" not in times(_cell(), regime[:4])


@pytest.mark.slow
@pytest.mark.parametrize("verdict", VERDICTS)
def test_a_browser_shows_it(page: Callable[[str], Path], verdict: str, tmp_path: Path) -> None:
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if browser is None:
        pytest.skip("no Chromium on this machine: apt-get install chromium")
    picture = tmp_path / "page.png"
    command = [browser, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", f"--user-data-dir={tmp_path / 'profile'}"]
    # no address resolves: what is shown comes from the file
    command += ["--host-resolver-rules=MAP * ~NOTFOUND", "--enable-logging=stderr", "--window-size=1100,1600", f"--screenshot={picture}"]
    done = subprocess.run([*command, page(verdict).as_uri()], capture_output=True, text=True, timeout=120, check=True)
    assert "CONSOLE" not in done.stderr
    shown = imread(picture)[:, :, :3]
    assert shown.shape[:2] == (1600, 1100)
    # letters and lines, from the head of the page on and over most of its height
    inked = np.abs(shown - shown[0, 0]).max(axis=2) > 0.3
    assert inked[:400].sum() > 2000
    assert inked.any(axis=1).mean() > 0.2


def test_gaps_of_all_conditions_in_a_row_are_in_one_unit(tmp_path: Path) -> None:
    """They share an axis: a gap in um beside one in mm would be a thousand times too large or too small."""
    s = _subject(tmp_path, measure(STIFF), held_out=measure(STIFF, amplitude=0.05, repeats=2, seed=9))
    figure = overlay(s, Sheet(WIDTH))
    assert figure is not None
    channel = s.loudest(s.conditions[0])[0]
    drawn = [max(np.abs(line.get_ydata()).max() for line in ax.lines[1:]) for ax in figure.axes[:2]]
    there = [max(np.abs(s.gap(c, channel, kind)).max() for kind in ("nominal", "adopted")) for c in s.conditions[:2]]
    assert drawn[1] / drawn[0] == pytest.approx(there[1] / there[0], rel=ROUNDOFF)


def test_a_number_is_spoken_of_with_the_effects_beside_it() -> None:
    estimate = Estimate(0.1, [0.09, 0.12], "1", 1.0)
    said = of_number(Number("crane", "drive_gain", estimate, 0.99, ("load @ crane",), ("dry_friction @ crane",)))
    assert said == ("crane.drive_gain is 1.1 [1.09 .. 1.12] instead of 1, beside dry friction, crane, which does as much as load, crane")
