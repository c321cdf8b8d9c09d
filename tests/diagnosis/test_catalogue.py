"""The catalogue: what it says, and what it refuses."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from scipy.integrate import quad

from robomill.cell.binding import convert
from robomill.diagnosis.catalogue import LOGGING, Catalogue, CatalogueError, Prior, Tolerance, physical
from robomill.fmus.components import COMPONENTS
from robomill.orchestration.system.definition import System
from tests import SCENARIOS
from tests.tolerances import physics

ENTRY = """
[[effect]]
name = "lag"
component = "a"
description = "d"
source = "s"
unit = "s"
minimum = 0.1
maximum = 1.0
sign = "positive"
prior = {kind = "log-normal", scale = 0.3}
locations = [{name = "x", parameters = ["p[1]"]}, {name = "y", parameters = ["p[2]"]}]
"""


class TestShipped:
    def test_every_effect_of_the_models_is_in_it_with_its_unit_and_within_its_bounds(self) -> None:
        catalogue = Catalogue.load(SCENARIOS / "catalogue.toml")
        cell = System.load(SCENARIOS / "milling_cell.toml", convert)
        listed = {}
        for candidate in catalogue.candidates:
            listed[candidate.component, candidate.named[0].partition("[")[0]] = candidate
            assert set(candidate.named) == {p for _, p in physical(dict.fromkeys(candidate.addresses, 1.0))}
        for part in cell.components:
            for variable in COMPONENTS[part.source].variables:
                if variable.effect:
                    candidate = listed[part.name, variable.name]
                    assert candidate.unit == variable.unit
                    low = 0.0 if candidate.has_phase else candidate.bounds[0]
                    assert variable.minimum <= low < candidate.bounds[1] <= variable.maximum
                    if candidate.has_phase:
                        assert COMPONENTS[part.source].variable(candidate.named[1].partition("[")[0]).unit == "rad"

    def test_tolerances_are_of_parameters_that_there_are(self) -> None:
        catalogue = Catalogue.load(SCENARIOS / "catalogue.toml")
        cell = System.load(SCENARIOS / "milling_cell.toml", convert)
        for tolerance in catalogue.tolerances:
            component, name = tolerance.address
            if component == LOGGING:
                continue
            variable = COMPONENTS[cell.component(component).source].variable(name)
            assert variable.causality == "parameter"


def test_tolerances_are_resolved_for_each_element() -> None:
    nominal = {"k[1]": 200.0, "k[2]": -50.0, "k[3]": 0.0, "m": 3.0}
    relative = Tolerance(("a", "k"), 0.01, relative=True).nuisances(nominal)
    assert [(n.address[1], n.scale, n.nominal) for n in relative] == [("k[1]", 2.0, 200.0), ("k[2]", 0.5, -50.0)]
    assert Tolerance(("a", "m"), 0.1, relative=False).nuisances(nominal)[0].scale == 0.1
    with pytest.raises(CatalogueError, match=r"nuisance a\.c: there is no such parameter; there are"):
        Tolerance(("a", "c"), 0.1, relative=False).nuisances(nominal)


def test_locations_become_candidates(tmp_path: Path) -> None:
    (tmp_path / "c.toml").write_text(ENTRY)
    x, y = Catalogue.load(tmp_path / "c.toml").candidates
    assert (x.name, y.addresses, x.bounds, x.locations) == ("lag @ x", (("a", "p[2]"),), (0.0, 1.0), 2)


@pytest.mark.parametrize("prior", [Prior("normal", 0.3), Prior("log-normal", 0.3, 0.7)])
def test_priors_are_densities(prior: Prior) -> None:
    total, error = quad(
        lambda v: math.exp(prior.log_density(v)), -5.0 if prior.kind == "normal" else 0.0, 50.0, points=[0.1, 1.0], limit=200
    )
    assert total == pytest.approx(1.0, abs=physics(1.0, absolute=10 * error + 1e-6))


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("maximum", "maximun", "effect 'lag': unknown key 'maximun', did you mean 'maximum'"),
        ('unit = "s"\n', "", "effect 'lag': missing: unit"),
        ('"positive"', '"negative"', "effect 'lag': sign = 'negative'; expected 'positive' or 'both'"),
        ("0.1", "2.0", "minimum = 2.0 is not below maximum = 1.0"),
        ("scale = 0.3", "scale = -1", "prior scale = -1; expected a positive number"),
        ('"log-normal"', '"uniform"', "prior kind 'uniform'; expected 'normal' or 'log-normal'"),
        ('name = "y"', 'name = "x"', "location 'x' is there twice"),
        ('["p[1]"]', "[]", "location 'x': parameters = []; expected a list of names"),
        ('component = "a"', 'component = "logging"', "expected 'KIND PATTERN' with KIND one of lag, smooth, gain, offset"),
        ("[[effect]]", "[[effect", "not valid TOML"),
    ],
)
def test_what_is_wrong_is_said(tmp_path: Path, old: str, new: str, text: str) -> None:
    (tmp_path / "c.toml").write_text(ENTRY.replace(old, new, 1))
    with pytest.raises(CatalogueError) as error:
        Catalogue.load(tmp_path / "c.toml")
    assert text in str(error.value)


def test_an_effect_is_there_once(tmp_path: Path) -> None:
    (tmp_path / "c.toml").write_text(ENTRY + ENTRY)
    with pytest.raises(CatalogueError, match="effect 'lag': is there twice"):
        Catalogue.load(tmp_path / "c.toml")


TOLERANCE = '[[nuisance]]\ncomponent = "a"\nparameters = ["r"]\nabsolute = 0.4\nunit = "m"\nsource = "s"\n'


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("", "", ""),
        ('unit = "s"', 'unit = "ms"', "c.toml:7: effect 'lag': its unit is 'ms', that of a.p[1] is 's': give the sizes in that unit"),
        ('unit = "m"\n', "", "c.toml:16: nuisance: its unit is '1', that of a.r is 'm'"),
        ('unit = "m"', 'unit = "mm"', "c.toml:16: nuisance: its unit is 'mm', that of a.r is 'm'"),
    ],
)
def test_sizes_are_in_the_unit_of_the_parameter(tmp_path: Path, old: str, new: str, text: str) -> None:
    """Whole arrays are known by their first element."""
    (tmp_path / "c.toml").write_text((ENTRY + TOLERANCE).replace(old, new, 1))
    catalogue = Catalogue.load(tmp_path / "c.toml")
    units = {("a", "p[1]"): "s", ("a", "p[2]"): "s", ("a", "r[1]"): "m"}
    if not text:
        catalogue.check_units(units)
        return
    with pytest.raises(CatalogueError) as error:
        catalogue.check_units(units)
    assert text in str(error.value)


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("minimum = 0.1", "minimum = inf", "c.toml:8: effect 'lag': minimum = inf; expected a positive number in the unit that is stated"),
        ("minimum", "minimun", "c.toml:8: effect 'lag': unknown key 'minimun', did you mean 'minimum'"),
        ("absolute = 0.4", "absolute = true", "c.toml:16: [[nuisance]] 1: absolute = True; expected a positive number"),
    ],
)
def test_the_line_is_named(tmp_path: Path, old: str, new: str, line: str) -> None:
    (tmp_path / "c.toml").write_text((ENTRY + TOLERANCE).replace(old, new, 1))
    with pytest.raises(CatalogueError) as error:
        Catalogue.load(tmp_path / "c.toml")
    assert line in str(error.value)
