"""What must not change the answer, and what must not be taken for an effect."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robomill.cell.binding import convert
from robomill.diagnosis.candidates import Candidate
from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.experiment.measured import DataError, sort_by_condition
from robomill.diagnosis.experiment.simulation import Laboratory, Simulator
from robomill.diagnosis.inference.estimation import Fit
from robomill.diagnosis.inference.priors import probabilities
from robomill.diagnosis.inference.search import Search
from robomill.orchestration.runs.run import Run
from tests.diagnosis.demo import SYSTEM, WELL, catalogue, changed, measure, resolve
from tests.tolerances import ROUNDOFF

TRUTH = {"masses": {"stiffness_error[2]": -0.08}}


def answer(folder: Path, runs: list[Run], **more: Any) -> dict[str, Any]:
    return diagnose(SYSTEM, runs, catalogue(folder), resolver=resolve, convert=convert, **more).result


def said(result: dict[str, Any]) -> tuple[str, str, str]:
    return result["verdict"], result["which"][0]["effect"], result["which"][0]["location"]


def value(result: dict[str, Any]) -> float:
    return float(result["which"][0]["parameters"]["stiffness_error[2]"]["value"])


def test_another_seed_of_the_noise_changes_only_what_lies_within_the_interval(tmp_path: Path) -> None:
    results = [answer(tmp_path, measure(TRUTH, seed=seed)) for seed in (11, 12)]
    assert said(results[0]) == said(results[1]) == ("identified", "stiffness", "spring 2")
    low, high = results[0]["which"][0]["parameters"]["stiffness_error[2]"]["interval"]
    assert abs(value(results[0]) - value(results[1])) < 2.0 * (high - low)


def test_channels_under_other_names_and_in_other_units_give_the_same_answer(tmp_path: Path) -> None:
    runs = measure(TRUTH)
    foreign = []
    for i, r in enumerate(runs):
        folder = tmp_path / f"log{i}"
        folder.mkdir()
        rows = np.column_stack([r.t, 1e3 * r.columns["sensors.y[2]"], r.columns["sensors.y[1]"]])
        np.savetxt(folder / "signals.csv", rows, delimiter=",", header="t,probe B,probe A", comments="", fmt="%.17g")
        (folder / "run.toml").write_text(
            '[columns]\n"probe B" = {port = "sensors.y[2]", unit = "mm"}\n"probe A" = {port = "sensors.y[1]", unit = "m"}\n'
            '[labels]\ncondition = "a"\n[parameters.force]\namplitude = 1.0\n'
        )
        foreign.append(Run.load(folder))
    own, other = answer(tmp_path, runs), answer(tmp_path, foreign)
    assert said(other) == said(own)
    assert value(other) == pytest.approx(value(own), rel=1e3 * ROUNDOFF)  # the units are converted, and a fit is made of that


def test_a_unit_that_measures_something_else_is_refused(tmp_path: Path) -> None:
    runs = [replace(r, ports={c: replace(p, unit="N") for c, p in r.ports.items()}) for r in measure(repeats=1)]
    with pytest.raises(DataError, match=r"column sensors\.y\[\d\] is in N, the system has it in m: .* cannot be expressed"):
        answer(tmp_path, runs)


@pytest.mark.parametrize("samples", [1, 2, 3])
@pytest.mark.parametrize("channels", [("sensors.y[1]", "sensors.y[2]"), ("sensors.y[2]",)], ids=["all", "one"])
def test_a_late_clock_is_a_clock_and_no_physics(tmp_path: Path, samples: int, channels: tuple[str, ...]) -> None:
    runs = measure()
    for channel in channels:
        runs = changed(runs, channel, lambda t, y: np.interp(t - 0.01 * samples, t, y))
    result = answer(tmp_path, runs)
    assert result["verdict"] == "bad_log"
    assert result["which"][0]["component"] == "logging"
    (finding,) = (f for f in result["gate"]["findings"] if f["kind"] == "lag")
    assert finding["value"] == pytest.approx(0.01 * samples, rel=WELL)


def searched(folder: Path, runs: list[Run]) -> Search:
    """A search whose sensitivities are there, and nothing else."""
    conditions = sort_by_condition(runs, SYSTEM)
    laboratory = Laboratory(SYSTEM, conditions, ["sensors.y[1]", "sensors.y[2]"], resolve)
    groups = [[c.matrix(r, laboratory.channels) for r in c.runs] for c in conditions]
    return Search(catalogue(folder), Simulator(laboratory), groups, [])


def alone(search: Search, candidate: Candidate) -> Fit:
    """The fit of one candidate with the sensitivities as they are now."""
    vars(search).pop("alone", None)  # what a search begins with
    return next(f for f in search.linear_fits([search.nominal()]) if f.model == (candidate,))


@pytest.mark.parametrize("truth", [TRUTH, {"masses": {"friction[1]": 0.08}}], ids=["stiffness", "friction"])
def test_a_placebo_ranks_far_below_the_truth_and_at_its_prior_where_nothing_is(tmp_path: Path, truth: Any) -> None:
    ((component, values),) = truth.items()
    address = (component, *values)
    for runs, there in ((measure(truth), True), (measure(), False)):
        search = searched(tmp_path, runs)
        candidate = next(c for c in search.candidates if address in c.addresses)
        real = alone(search, candidate)
        # the same change of the measured channels, but backwards in time
        search.evidence.sensitivities[address] = search.evidence.sensitivities[address].reshape(-1, 2)[::-1].ravel()
        placebo = alone(search, candidate)
        if there:
            assert real.log_evidence > placebo.log_evidence + 1000.0
        else:
            indifferent = replace(search.nominal(), model=(candidate,))  # the data say nothing about it
            after, before = (probabilities([search.nominal(), f], search.candidates)[1] for f in (placebo, indifferent))
            assert after < 2.0 * before


def test_the_same_effect_at_a_wrong_place_is_not_even_listed(tmp_path: Path) -> None:
    result = answer(tmp_path, measure(TRUTH))
    assert [(w["effect"], w["location"]) for w in result["which"]] == [("stiffness", "spring 2")]
