"""The recommended run: it separates what the given runs do not, on data that it was not told."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.experiment.design import Design, Kind, Offer, Quantity, searched
from robomill.diagnosis.inference.estimation import Fit
from robomill.diagnosis.inference.isolability import CONFUSABLE
from robomill.diagnosis.outcome.answer import Menu
from robomill.diagnosis.outcome.next_run import ENOUGH, rivals
from robomill.orchestration.assembly import run
from robomill.orchestration.runs.run import Run
from tests.diagnosis.demo import CATALOGUE, HUNG, NOISE, SYSTEM, measure, resolve

TWINS = """
[[effect]]
name = "actuator"
component = "force"
description = "the actuator is too strong"
source = "made up"
unit = "1"
minimum = 0.002
maximum = 0.5
sign = "both"
prior = {kind = "normal", scale = 0.05}
locations = [{name = "actuator", parameters = ["gain_error"]}]

[[effect]]
name = "scale"
component = "sensors"
description = "both sensors show too much"
source = "made up"
unit = "1"
minimum = 0.002
maximum = 0.5
sign = "both"
prior = {kind = "normal", scale = 0.05}
locations = [{name = "sensors", parameters = ["scale_error"]}]
"""
"""In a linear system whose force is not measured these two are the same."""


def chirp(values: Mapping[str, float]) -> Offer:
    return Offer(SYSTEM, {"force": {"amplitude": values["amplitude"]}}, 8.0)


def hanging(values: Mapping[str, float]) -> Offer:
    return Offer(HUNG, {"weight": {"weight": values["weight"]}}, values["seconds"])


STRONGER = Kind("stronger", (Quantity("amplitude", "N", 1.5, 3.0, 2.0),), 1.0, 3, chirp)
HANG = (Quantity("weight", "N", 0.001, 1.0, 0.005), Quantity("seconds", "s", 4.0, 8.0, 5.0))


def kinds() -> list[Kind]:
    return [STRONGER, Kind("hung, long", HANG, 20.0, 3, hanging), Kind("hung", HANG, 4.0, 3, hanging)]


def twins(folder: Path, runs: list[Run], **more: Any) -> dict[str, Any]:
    (folder / "catalogue.toml").write_text(CATALOGUE + TWINS)
    return diagnose(SYSTEM, runs, Catalogue.load(folder / "catalogue.toml"), resolver=resolve, **more).result


@pytest.mark.parametrize("truth", [{"force": {"gain_error": 0.03}}, {"sensors": {"scale_error": 0.03}}], ids=["actuator", "scale"])
def test_the_recommended_run_separates_what_the_given_runs_do_not(tmp_path: Path, truth: Any) -> None:
    result = twins(tmp_path, measure(truth), menu=Menu(kinds=kinds))
    assert result["verdict"] == "ambiguous"
    closest = result["isolability"][0]
    assert (closest["pair"], closest["confusable"]) == (["actuator @ actuator", "scale @ sensors"], True)
    found = result["next_run"]
    assert found["kind"] == "hung"  # the longer one says as much, but takes more minutes; the stronger one says nothing
    assert found["now"] < 0.1
    assert found["separated"]
    assert found["distance"] > CONFUSABLE
    weight = found["parameters"]["weight"]
    assert weight["unit"] == "N"
    assert 0.005 < weight["value"] <= 1.0  # where the search begins they are closer
    assert found["per_minute"] == found["separation"] / found["minutes"] <= ENOUGH**2 / 8.0 / found["minutes"]
    assert found["text"].startswith(f"hung (weight {weight['value']:.4g} N, seconds ")
    values = {name: v["value"] for name, v in found["parameters"].items()}
    # the run is made with the truth: the model that is right is nearest to it, whatever the noise
    models = found["models"]
    assert set(models) == set(found["separates"]) == {"actuator @ actuator", "scale @ sensors"}
    simulated = {name: simulate(values, model) for name, model in models.items()}
    real, right = simulate(values, truth), "actuator @ actuator" if "force" in truth else "scale @ sensors"
    random = np.random.default_rng(5)
    nearest = []
    for _ in range(20):
        measured = real + NOISE * random.standard_normal(real.shape)
        nearest.append(min(simulated, key=lambda name: float(((measured - simulated[name]) ** 2).sum())))
    assert nearest == [right] * 20


def simulate(values: Mapping[str, float], truth: Any) -> Any:
    """The measured channels of a hanging weight with `truth`, as far as its system has the component."""
    offer = hanging(values)
    system = offer.system
    for component, parameters in [*offer.parameters.items(), *truth.items()]:
        if any(c.name == component for c in system.components):
            system = system.with_parameters(component, parameters)
    return run(system, None, stop=offer.seconds, resolver=resolve)["sensors.y"]


def test_where_no_run_would_separate_them_it_says_so(tmp_path: Path) -> None:
    found = twins(tmp_path, measure({"sensors": {"scale_error": 0.03}}), menu=Menu(kinds=lambda: [STRONGER]))["next_run"]
    assert found["kind"] == "stronger"
    assert not found["separated"]
    assert found["distance"] < CONFUSABLE
    assert found["text"].startswith("none that was looked at separates ")


def test_the_search_stays_within_its_simulations_and_looks_at_no_kind_that_cannot_win() -> None:
    looked: list[Design] = []

    def worth(designs: Sequence[Design]) -> list[float]:
        looked.extend(designs)
        return [1.0 - (d.values[0] - 0.8) ** 2 if d.kind.name == "quick" else 0.1 for d in designs]

    quick = Kind("quick", (Quantity("amplitude", "N", 0.0, 2.0, 1.5),), 1.0, 1, chirp)
    slow = Kind("slow", (Quantity("amplitude", "N", 0.0, 2.0, 1.0),), 60.0, 1, chirp)
    found = searched([slow, quick], worth, lambda k: 4.5 / k.minutes, 10)
    assert len(looked) == len(set(looked)) <= 10
    best = max(found, key=lambda d: found[d])
    assert best.values[0] == 1.0  # half of the range down, a quarter up
    assert not any(d.kind is slow for d in looked)
    assert searched([slow, quick], worth, lambda k: 4.5 / k.minutes, 10) == found


def test_a_run_that_cannot_be_made_is_left_out(tmp_path: Path) -> None:
    def refused(_: Mapping[str, float]) -> Offer:
        raise ValueError("out of reach")

    both = [Kind("out of reach", HANG, 1.0, 3, refused), Kind("hung", HANG, 4.0, 3, hanging)]
    found = twins(tmp_path, measure({"sensors": {"scale_error": 0.03}}), menu=Menu(kinds=lambda: both))["next_run"]
    assert found["kind"] == "hung"
    assert twins(tmp_path, measure({"sensors": {"scale_error": 0.03}}), menu=Menu(kinds=lambda: both[:1]))["next_run"] is None


def test_a_clear_answer_needs_no_next_run(tmp_path: Path) -> None:
    def never() -> list[Kind]:
        raise AssertionError("the kinds were asked for")

    result = twins(tmp_path, measure({"masses": {"stiffness_error[2]": -0.08}}), menu=Menu(kinds=never))
    assert result["verdict"] == "identified"
    assert result["next_run"] is None
    assert all(not p["confusable"] for p in result["isolability"] if any("spring 2" in name for name in p["pair"]))


def test_what_is_unknown_is_tried_where_the_nearest_model_would_show_most(tmp_path: Path) -> None:
    def disturbed(run_: Run) -> Run:
        y = run_.columns["sensors.y[1]"]
        columns = {**run_.columns, "sensors.y[1]": y + 2e-3 * np.sin(9.0 * run_.t) * (run_.t > 5.0)}
        return Run(run_.folder, run_.t, columns, run_.ports, run_.info)

    result = twins(tmp_path, [disturbed(r) for r in measure()], menu=Menu(kinds=kinds))
    assert result["verdict"] == "unknown"
    assert result["next_run"]["separates"][1] == "something else"


def test_where_no_candidate_is_left_there_is_nothing_to_tell_apart() -> None:
    only_nominal = [Fit((), {}, {}, 0.0, 1.0)]
    assert rivals(only_nominal, np.ones(1), None, known=False) == []  # type: ignore[arg-type]
