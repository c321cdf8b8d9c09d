"""The recommended run: it separates what the given runs do not, on data that it was not told."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.inference.estimation import Fit
from robomill.diagnosis.inference.isolability import CONFUSABLE
from robomill.diagnosis.outcome.answer import Menu
from robomill.diagnosis.outcome.next_run import Offer, rivals
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


def offers() -> dict[str, Offer]:
    return {
        "stronger": Offer(SYSTEM, {"force": {"amplitude": 2.0}}, 8.0, 1.0, 3, {}),
        "hung, long": Offer(HUNG, {"weight": {"weight": 1.0}}, 8.0, 20.0, 3, {}),
        "hung": Offer(HUNG, {"weight": {"weight": 1.0}}, 5.0, 4.0, 3, {"weight": {"weight": 1.0}}),
    }


def twins(folder: Path, runs: list[Run], **more: Any) -> dict[str, Any]:
    (folder / "catalogue.toml").write_text(CATALOGUE + TWINS)
    return diagnose(SYSTEM, runs, Catalogue.load(folder / "catalogue.toml"), resolver=resolve, **more).result


@pytest.mark.parametrize("truth", [{"force": {"gain_error": 0.03}}, {"sensors": {"scale_error": 0.03}}], ids=["actuator", "scale"])
def test_the_recommended_run_separates_what_the_given_runs_do_not(tmp_path: Path, truth: Any) -> None:
    result = twins(tmp_path, measure(truth), menu=Menu(offers=offers))
    assert result["verdict"] == "ambiguous"
    closest = result["isolability"][0]
    assert (closest["pair"], closest["confusable"]) == (["actuator @ actuator", "scale @ sensors"], True)
    found = result["next_run"]
    assert found["kind"] == "hung"  # the longer one says as much, but takes more minutes; the stronger one says nothing
    assert found["now"] < 0.1
    assert found["separated"]
    assert found["distance"] > CONFUSABLE
    assert found["parameters"] == {"weight": {"weight": 1.0}}
    assert found["per_minute"] == found["distance"] / found["minutes"]
    # the run is made with the truth: the model that is right is nearest to it, whatever the noise
    models = found["models"]
    assert set(models) == set(found["separates"]) == {"actuator @ actuator", "scale @ sensors"}
    simulated = {name: simulate(found["kind"], values) for name, values in models.items()}
    real, right = simulate(found["kind"], truth), "actuator @ actuator" if "force" in truth else "scale @ sensors"
    random = np.random.default_rng(5)
    nearest = []
    for _ in range(20):
        measured = real + NOISE * random.standard_normal(real.shape)
        nearest.append(min(simulated, key=lambda name: float(((measured - simulated[name]) ** 2).sum())))
    assert nearest == [right] * 20


def simulate(kind: str, truth: Any) -> Any:
    """The measured channels of a run on the menu with `truth`, as far as its system has the component."""
    offer = offers()[kind]
    system = offer.system
    for component, values in [*offer.parameters.items(), *truth.items()]:
        if any(c.name == component for c in system.components):
            system = system.with_parameters(component, values)
    return run(system, None, stop=offer.seconds, resolver=resolve)["sensors.y"]


def test_where_no_run_would_separate_them_it_says_so(tmp_path: Path) -> None:
    def useless() -> dict[str, Offer]:
        return {"stronger": offers()["stronger"]}

    found = twins(tmp_path, measure({"sensors": {"scale_error": 0.03}}), menu=Menu(offers=useless))["next_run"]
    assert found["kind"] == "stronger"
    assert not found["separated"]
    assert found["distance"] < CONFUSABLE


def test_a_clear_answer_needs_no_next_run(tmp_path: Path) -> None:
    def never() -> dict[str, Offer]:
        raise AssertionError("the menu was asked for")

    result = twins(tmp_path, measure({"masses": {"stiffness_error[2]": -0.08}}), menu=Menu(offers=never))
    assert result["verdict"] == "identified"
    assert result["next_run"] is None
    assert all(not p["confusable"] for p in result["isolability"] if any("spring 2" in name for name in p["pair"]))


def test_what_is_unknown_is_tried_where_the_nearest_model_would_show_most(tmp_path: Path) -> None:
    def disturbed(run_: Run) -> Run:
        y = run_.columns["sensors.y[1]"]
        columns = {**run_.columns, "sensors.y[1]": y + 2e-3 * np.sin(9.0 * run_.t) * (run_.t > 5.0)}
        return Run(run_.folder, run_.t, columns, run_.ports, run_.info)

    result = twins(tmp_path, [disturbed(r) for r in measure()], menu=Menu(offers=offers))
    assert result["verdict"] == "unknown"
    assert result["next_run"]["separates"][1] == "something else"


def test_where_no_candidate_is_left_there_is_nothing_to_tell_apart() -> None:
    only_nominal = [Fit((), {}, {}, 0.0, 1.0)]
    assert rivals(only_nominal, np.ones(1), None, known=False) == []  # type: ignore[arg-type]
