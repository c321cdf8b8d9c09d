"""Campaigns: conditions of two systems that share components, diagnosed together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robomill.diagnosis.engine import diagnose, diagnose_campaign
from robomill.diagnosis.experiment.campaign import Campaign, Part, load_campaign
from robomill.diagnosis.experiment.measured import DataError
from robomill.diagnosis.experiment.preparation import Prepared, prepared
from robomill.diagnosis.experiment.simulation import Simulator, setting
from robomill.orchestration.assembly import run
from robomill.orchestration.runs.run import Run
from robomill.orchestration.system.definition import System
from robomill.orchestration.system.parameters import same_unit_only
from tests.diagnosis.demo import HUNG, NOISE, STEP, SYSTEM, catalogue, measure, resolve
from tests.tolerances import ROUNDOFF

STIFF = {"masses": {"stiffness_error[2]": -0.08}}
COARSE = replace(HUNG, step=2.0 * STEP)
"""The masses under a weight, at another communication step."""


def hang(
    truth: Mapping[str, Mapping[str, float]] | None = None,
    *,
    system: System = HUNG,
    columns: Sequence[str] = ("sensors.y[1]", "sensors.y[2]"),
    weight: float = 1.0,
    repeats: int = 4,
    seconds: float = 6.0,
    seed: int = 5,
    **labels: Any,
) -> list[Run]:
    """Noisy runs of the masses under a weight."""
    made, known = [], {"weight": {"weight": weight}}
    for component, values in {**known, **(truth or {})}.items():
        system = system.with_parameters(component, values)
    clean = run(system, None, stop=seconds, resolver=resolve)
    rng = np.random.default_rng(seed)
    for repeat in range(repeats):
        shown = {c: clean[c] + NOISE * rng.normal(size=len(clean.t)) for c in columns}
        info = {"parameters": known, "labels": {"condition": f"weight {weight}", "repeat": repeat, **labels}}
        made.append(Run(Path(f"hung{repeat}"), clean.t, shown, {c: clean.ports[c] for c in columns}, info))
    return made


def both(truth: Mapping[str, Mapping[str, float]] | None = None, other: System = HUNG, **more: Any) -> Campaign:
    """A chirp at the masses, and a weight."""
    return Campaign("both", (Part("chirp", SYSTEM, tuple(measure(truth))), Part("weight", other, tuple(hang(truth, system=other, **more)))))


def start(folder: Path, campaign: Campaign) -> Prepared:
    return prepared(campaign, catalogue(folder), resolve, same_unit_only)


class TestDiagnosis:
    @pytest.mark.parametrize("other", [HUNG, COARSE], ids=["one step", "two steps"])
    def test_an_effect_of_a_shared_component_is_found_in_all_systems(self, tmp_path: Path, other: System) -> None:
        found = diagnose_campaign(both(STIFF, other), catalogue(tmp_path), resolver=resolve)
        first = found.result["which"][0]
        assert found.result["verdict"] == "identified"
        assert (first["effect"], first["location"]) == ("stiffness", "spring 2")
        low, high = first["parameters"]["stiffness_error[2]"]["interval"]
        assert low - 0.5 * (high - low) < -0.08 < high + 0.5 * (high - low)
        assert set(found.curves) == {"chirp", "weight"}

    def test_two_systems_that_are_as_simulated_give_none(self, tmp_path: Path) -> None:
        assert diagnose_campaign(both(), catalogue(tmp_path), resolver=resolve).result["verdict"] == "none"

    def test_a_campaign_of_one_system_is_a_plain_diagnosis(self, tmp_path: Path) -> None:
        one = diagnose_campaign(Campaign.of(SYSTEM, measure(STIFF)), catalogue(tmp_path), resolver=resolve).result
        plain = diagnose(SYSTEM, measure(STIFF), catalogue(tmp_path), resolver=resolve).result
        for r in (one, plain):
            r["effort"] = None
        assert one == plain

    def test_a_weight_tells_what_one_sensor_of_a_chirp_does_not(self, tmp_path: Path) -> None:
        """The conditions have different channels: of the chirp only the first sensor is there, of the weight both."""
        truth = {"sensors": {"gain_error[2]": 0.03}}
        chirp = [replace(r, columns={"sensors.y[1]": r.columns["sensors.y[1]"]}) for r in measure(truth)]
        campaign = Campaign("both", (Part("chirp", SYSTEM, tuple(chirp)), Part("weight", HUNG, tuple(hang(truth)))))
        found = diagnose_campaign(campaign, catalogue(tmp_path), resolver=resolve).result
        assert found["verdict"] == "identified"
        assert (found["which"][0]["effect"], found["which"][0]["location"]) == ("gain", "sensor 2")

    def test_a_held_out_system_confirms_the_answer(self, tmp_path: Path) -> None:
        parts = (Part("chirp", SYSTEM, tuple(measure(STIFF))), Part("weight", HUNG, (), tuple(hang(STIFF))))
        found = diagnose_campaign(Campaign("both", parts), catalogue(tmp_path), resolver=resolve).result
        assert found["transfer"]["worth"] > 0.0
        (new,) = (h for h in found["how_far"] if h["on"] == "held-out condition" and h["channel"] == "sensors.y")
        assert new["closure"] > 0.99


class TestPreparation:
    def test_a_component_that_a_system_lacks_has_no_effect_there(self, tmp_path: Path) -> None:
        laboratory = start(tmp_path, both()).laboratory
        driven = setting({("force", "gain_error"): 0.1})
        assert laboratory.effective(0, driven) == driven
        assert laboratory.effective(1, driven) == ()
        with Simulator(laboratory) as simulator:
            nominal, same = simulator.many([(1, ()), (1, driven)])
            assert nominal is same
            assert simulator.count == 1

    def test_what_no_system_has_is_skipped_and_told(self, tmp_path: Path) -> None:
        more = catalogue(tmp_path).file.read_text() + (
            '\n[[effect]]\nname = "tilt"\ncomponent = "table"\ndescription = "d"\nsource = "made up"\nunit = "1"\nminimum = 0.1\n'
            'maximum = 1.0\nsign = "both"\nprior = {kind = "normal", scale = 0.5}\nlocations = [{name = "table", parameters = ["tilt"]}]\n'
        )
        (tmp_path / "more").mkdir()
        (tmp_path / "more" / "catalogue.toml").write_text(more)
        file = type(catalogue(tmp_path)).load(tmp_path / "more" / "catalogue.toml")
        assert prepared(both(), file, resolve, same_unit_only).skipped == (
            "catalogue.toml: there is no component 'table' for effects tilt: skipped",
        )

    def test_channels_are_the_union_and_what_a_condition_lacks_is_zero_on_both_sides(self, tmp_path: Path) -> None:
        laboratory = start(tmp_path, both(columns=("sensors.y[1]", "masses.x[2]"))).laboratory
        assert set(laboratory.channels) == {"sensors.y[1]", "sensors.y[2]", "masses.x[2]"}
        of = laboratory.channels.index
        lacks = {0: "masses.x[2]", 1: "sensors.y[2]"}
        offset = setting({("logging", "offset sensors.*"): 1e-3, ("masses", "stiffness_error[2]"): 0.1})
        for i, group in enumerate(laboratory.measured()):
            simulated = laboratory.simulate(i, offset)
            assert simulated is not None
            for x in (*group, simulated):
                assert np.all(x[:, of(lacks[i])] == 0.0)
                assert np.any(x[:, of("sensors.y[1]")] != 0.0)

    def test_samples_of_all_systems_are_as_long(self, tmp_path: Path) -> None:
        laboratory = start(tmp_path, both(other=COARSE)).laboratory
        lengths = [c.step * laboratory.factor(i) for i, c in enumerate(laboratory.conditions)]
        assert lengths == pytest.approx([2.0 * STEP] * 2, rel=1e3 * ROUNDOFF)
        simulated = [laboratory.simulate(i, ()) for i in (0, 1)]
        assert [x.shape for x in simulated if x is not None] == [g[0].shape for g in laboratory.measured()]

    def test_tolerances_are_about_the_values_of_each_system(self, tmp_path: Path) -> None:
        """The nominal value is that of the first system; a change is one against what the system itself has."""
        damped = HUNG.with_parameters("masses", {"damping": 3.0})
        begun = start(tmp_path, both(other=damped))
        (nuisance,) = begun.nuisances
        assert (nuisance.address, nuisance.nominal, nuisance.scale) == (("masses", "damping"), 2.0, 0.02)
        assert [begun.laboratory.nominal_of(i)["masses", "damping"] for i in (0, 1)] == [2.0, 3.0]

    def test_a_part_of_several_conditions_names_each(self, tmp_path: Path) -> None:
        runs = (*hang(), *hang(weight=2.0, seed=6), *hang(weight=3.0, seed=7, held_out=True))
        campaign = Campaign("c", (Part("chirp", SYSTEM, tuple(measure())), Part("weights", HUNG, runs[:8], runs[8:])))
        found = [(c.name, c.held_out, c.system is HUNG) for c in campaign.conditions()]
        assert found == [
            ("chirp", False, False),
            ("weights: weight 1.0", False, True),
            ("weights: weight 2.0", False, True),
            ("weights: weight 3.0", True, True),
        ]

    def test_a_condition_without_a_channel_is_named(self, tmp_path: Path) -> None:
        parts = both().parts
        blind = tuple(replace(r, columns={"table.x": r.columns["sensors.y[1]"]}) for r in parts[1].runs)
        with pytest.raises(DataError, match=r"weight: no measured column is an output of the system; measured: table.x; outputs: weight.f"):
            start(tmp_path, Campaign("c", (parts[0], replace(parts[1], runs=blind))))
        held = replace(parts[1], runs=(), held_out=tuple(hang(columns=("masses.x[1]",))))
        with pytest.raises(DataError, match=r"weight: is held out, and no diagnosed run has a channel that it has: masses.x\[1\]"):
            start(tmp_path, Campaign("c", (parts[0], held)))


FILE = """
[campaign]
name = "both"

[[condition]]
name = "chirp"
system = "{system}"
runs = ["runs/a-*"]
role = "diagnose"

[[condition]]
name = "{second}"
system = "hung.toml"
runs = ["{runs}"]
role = "{role}"
"""


class TestFile:
    @pytest.fixture
    def folder(self, tmp_path: Path) -> Path:
        """Runs on disk, and files that stand for the systems."""
        for name, system, runs in (("a", SYSTEM, 2), ("b", HUNG, 1)):
            (tmp_path / ("springs.toml" if system is SYSTEM else "hung.toml")).write_text("")
            for k in range(runs):
                run(system, tmp_path / "runs" / f"{name}-{k}", stop=0.5, resolver=resolve)
        return tmp_path

    @staticmethod
    def system(file: Path) -> System:
        return SYSTEM if file.name == "springs.toml" else HUNG

    def load(self, folder: Path, **changed: str) -> Campaign:
        said = {"system": "springs.toml", "second": "weight", "runs": "runs/b-*", "role": "held_out", **changed}
        (folder / "campaign.toml").write_text(FILE.format(**said))
        return load_campaign(folder / "campaign.toml", self.system)

    def test_it_names_systems_runs_and_roles(self, folder: Path) -> None:
        found = self.load(folder)
        assert found.name == "both"
        assert [(p.name, p.system.name, len(p.runs), len(p.held_out)) for p in found.parts] == [
            ("chirp", "springs", 2, 0),
            ("weight", "hung", 0, 1),
        ]
        assert found.system is SYSTEM
        absolute = self.load(folder, runs=str(folder / "runs" / "b-*"))
        assert [r.folder for r in absolute.held_out] == [folder / "runs" / "b-0"]

    @pytest.mark.parametrize(
        ("changed", "error", "text"),
        [
            ({"role": "fitted"}, DataError, r"campaign.toml:15: condition 2 'weight': role.*'fitted'.*diagnose, held_out"),
            ({"runs": "runs/c-*"}, DataError, r"campaign.toml:14: .*'runs/c-\*' matches no folder below .*; expected folders of runs"),
            ({"second": "chirp"}, DataError, r"campaign.toml:12: .*'chirp' is there twice; give every condition a name of its own"),
            ({"system": "springs.tml"}, FileNotFoundError, r"'springs.tml': no such file; beside it are campaign.toml, hung.toml, springs"),
            (
                {"runs": "runs/a-*"},
                DataError,
                "a-0 was recorded by another system, 'springs' with force, masses, sensors; 'hung' has weight, masses, sensors: "
                "weight not in the run; name the system that made it",
            ),
        ],
    )
    def test_what_is_wrong_is_said_with_its_place(
        self, folder: Path, changed: Mapping[str, str], error: type[Exception], text: str
    ) -> None:
        with pytest.raises(error, match=text):
            self.load(folder, **changed)

    def test_without_a_condition_to_diagnose_there_is_no_campaign(self, folder: Path) -> None:
        self.load(folder)
        file = folder / "campaign.toml"
        file.write_text(file.read_text().replace('"diagnose"', '"held_out"'))
        with pytest.raises(DataError, match='no condition to diagnose: all of them are held out; give one of them role = "diagnose"'):
            load_campaign(file, self.system)
        with pytest.raises(FileNotFoundError, match=r"no campaign .*nothing.toml"):
            load_campaign(folder / "nothing.toml", self.system)
