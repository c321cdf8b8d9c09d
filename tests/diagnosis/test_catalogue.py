"""The catalogue: what it says, and what it refuses."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from scipy.integrate import quad

from robomill.cell.equipment import load_system
from robomill.diagnosis.candidates import AT, LOGGING, Candidate, CatalogueError, Prior, Tolerance, physical
from robomill.diagnosis.catalogue import Catalogue
from robomill.fmus.components import COMPONENTS
from robomill.models.model.units import convert
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
        cell = load_system(SCENARIOS / "milling_cell.toml")
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

    def test_shape_parameters_are_of_the_models_with_their_units_and_within_their_bounds(self) -> None:
        cell = load_system(SCENARIOS / "milling_cell.toml")
        shaped = [c for c in Catalogue.load(SCENARIOS / "catalogue.toml").candidates if c.shapes]
        assert {c.effect for c in shaped} >= {"structural_mode", "sensor_lag", "extra_delay", "tracking_lag", "friction_stribeck"}
        for candidate in shaped:
            assert candidate.variants
            for shape in candidate.shapes:
                variable = COMPONENTS[cell.component(candidate.component).source].variable(shape.parameter.partition("[")[0])
                assert shape.unit == variable.unit
                low, high = (-math.inf if variable.minimum is None else variable.minimum), (variable.maximum or math.inf)
                assert low <= shape.values[0] < shape.values[-1] <= high

    def test_tolerances_are_of_parameters_that_there_are(self) -> None:
        catalogue = Catalogue.load(SCENARIOS / "catalogue.toml")
        cell = load_system(SCENARIOS / "milling_cell.toml")
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
    with pytest.raises(CatalogueError, match=r"nuisance a\.c: there is no such parameter; available:"):
        Tolerance(("a", "c"), 0.1, relative=False).nuisances(nominal)


SHAPED = (
    ENTRY
    + """
shape = [
    {name = "speed", parameter = "s[*]", unit = "m/s", values = [0.1, 0.4]},
    {name = "order", parameter = "n", values = [0.0, 2.0, 4.0]},
]
"""
)


def shaped(folder: Path) -> tuple[Candidate, ...]:
    (folder / "c.toml").write_text(SHAPED)
    return Catalogue.load(folder / "c.toml").candidates


def test_each_combination_of_shapes_is_a_variant_of_the_same_name(tmp_path: Path) -> None:
    x, y = shaped(tmp_path)
    assert [[v for _, v in variant.fixed] for variant in x.variants] == [[a, b] for a in (0.1, 0.4) for b in (0.0, 2.0, 4.0)]
    assert {variant.name for variant in x.variants} == {x.name}
    assert [a for a, _ in y.variants[0].fixed] == [("a", "s[2]"), ("a", "n")]
    assert y.variants[0].named == ("p[2]",)


def test_a_variant_is_simulated_with_its_values(tmp_path: Path) -> None:
    variant = shaped(tmp_path)[0].variants[4]
    assert physical({variant.addresses[0]: 0.3}) == {("a", "p[1]"): 0.3, ("a", "s[1]"): 0.4, ("a", "n"): 2.0}


def test_variants_exclude_each_other_and_those_of_other_places_with_other_values_of_what_they_share(tmp_path: Path) -> None:
    x, y = shaped(tmp_path)
    assert x.variants[0].excludes(x.variants[1])
    assert x.excludes(x.variants[0])
    assert not x.excludes(y)
    assert not x.variants[1].excludes(y.variants[4])  # n = 2 at both, s[1] and s[2] are two numbers
    assert x.variants[1].excludes(y.variants[2])
    assert x.variants[1].excludes(y)  # n is that of the nominal system there


def test_a_system_without_the_shape_keeps_the_effect(tmp_path: Path) -> None:
    shaped(tmp_path)
    fitting, notes = Catalogue.load(tmp_path / "c.toml").within({"a": ["p[1]", "p[2]", "s[1]", "s[2]"]}, ())
    assert [c.variants for c in fitting.candidates] == [(), ()]
    assert notes == ("c.toml: component 'a' has no parameters for shapes of lag: skipped",)
    whole, notes = Catalogue.load(tmp_path / "c.toml").within({"a": ["p[1]", "p[2]", "s[1]", "s[2]", "n"]}, ())
    assert [len(c.variants) for c in whole.candidates] == [6, 6]
    assert notes == ()


def test_variants_go_with_their_component(tmp_path: Path) -> None:
    shaped(tmp_path)
    x, _ = Catalogue.load(tmp_path / "c.toml").about("a", "b").candidates
    assert [a for a, _ in x.variants[0].fixed] == [("b", "s[1]"), ("b", "n")]
    assert x.variants[0].addresses[0][0] == "b"
    assert x.variants[0].addresses[0][1].startswith("p[1]" + AT)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("[0.1, 0.4]", "[0.4, 0.1]", "effect 1 'lag': shape.0.values: expected two numbers or more, growing; found [0.4, 0.1]"),
        ("[0.1, 0.4]", "[0.1]", "effect 1 'lag': shape.0.values: expected two numbers or more, growing; found [0.1]"),
        ('unit = "m/s"', 'units = "m/s"', "effect 1 'lag': shape.0.units: unknown key 'units'; did you mean 'unit'?"),
        ('unit = "m/s"', 'per = "day"', "shape.0.per: unknown per 'day'; available: machine"),
        ('"p[1]"', '"p"', "'s[*]': 'p' has no element; expected an element, such as [1]"),
        ('component = "a"', 'component = "logging"', "expected 'KIND PATTERN' of the log"),
    ],
)
def test_what_is_wrong_with_a_shape_is_said(tmp_path: Path, old: str, new: str, text: str) -> None:
    (tmp_path / "c.toml").write_text(SHAPED.replace(old, new, 1))
    with pytest.raises(CatalogueError) as error:
        Catalogue.load(tmp_path / "c.toml")
    assert text in str(error.value)


def test_the_log_has_no_shapes(tmp_path: Path) -> None:
    text = SHAPED.replace('component = "a"', 'component = "logging"').replace('"p[1]"', '"lag x.*"').replace('"p[2]"', '"lag y.*"')
    (tmp_path / "c.toml").write_text(text)
    with pytest.raises(CatalogueError, match=r"effect 1 'lag': shape\.0: is for parameters of a component; the log has none"):
        Catalogue.load(tmp_path / "c.toml")


def test_the_unit_of_a_shape_is_that_of_its_parameter(tmp_path: Path) -> None:
    shaped(tmp_path)
    catalogue = Catalogue.load(tmp_path / "c.toml")
    catalogue.check_units({("a", "s[1]"): "m/s"})
    with pytest.raises(CatalogueError, match=r"effect 'lag': shape 'speed': its unit is 'm/s', that of a\.s\[1\] is 'mm/s'"):
        catalogue.check_units({("a", "s[1]"): "mm/s"})
    catalogue.check_units({("a", "s[1]"): "m*s^-1"}, convert)
    with pytest.raises(CatalogueError, match=r"its unit is 'm/s', that of a\.s\[1\] is 'mm/s'"):
        catalogue.check_units({("a", "s[1]"): "mm/s"}, convert)


def test_locations_become_candidates(tmp_path: Path) -> None:
    (tmp_path / "c.toml").write_text(ENTRY)
    x, y = Catalogue.load(tmp_path / "c.toml").candidates
    assert (x.name, y.addresses, x.bounds, x.locations) == ("lag @ x", (("a", "p[2]"),), (0.0, 1.0), 2)


@pytest.mark.parametrize(
    ("sign", "least", "most", "bounds", "maximum"),
    [
        ("both", -0.9, 100.0, (-0.9, 1.0), 1.0),
        ("both", -0.25, 0.5, (-0.25, 0.5), 0.5),
        ("both", -math.inf, math.inf, (-1.0, 1.0), 1.0),
        ("positive", -0.9, 0.5, (0.0, 0.5), 0.5),
        ("positive", -0.9, 0.0, (0.0, 1.0), 1.0),  # it is as large as it can be: that it cannot run is found by simulation
    ],
)
def test_no_effect_is_larger_than_its_parameter_can_be(
    tmp_path: Path, sign: str, least: float, most: float, bounds: tuple[float, float], maximum: float
) -> None:
    (tmp_path / "c.toml").write_text(ENTRY.replace('"positive"', f'"{sign}"'))
    x, y = Catalogue.load(tmp_path / "c.toml").limited({("a", "p[1]"): (least, most)}).candidates
    assert (x.bounds, x.maximum) == (bounds, maximum)
    assert y.maximum == 1.0
    for value, there in ((bounds[0], bounds[0] < 0.0), (0.5 * bounds[1], False), (bounds[1], True)):
        assert x.at_bound({("a", "p[1]"): value}) is there


@pytest.mark.parametrize("prior", [Prior("normal", 0.3), Prior("log-normal", 0.3, 0.7)])
def test_priors_are_densities(prior: Prior) -> None:
    total, error = quad(
        lambda v: math.exp(prior.log_density(v)), -5.0 if prior.kind == "normal" else 0.0, 50.0, points=[0.1, 1.0], limit=200
    )
    assert total == pytest.approx(1.0, abs=physics(1.0, absolute=10 * error + 1e-6))


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        (
            "maximum",
            "maximun",
            "c.toml:9: effect 1 'lag': maximun: unknown key 'maximun'; did you mean 'maximum'? available: component, description,",
        ),
        ('unit = "s"\n', "", "effect 1 'lag': missing: unit; known keys: component, description,"),
        ('"positive"', '"negative"', "c.toml:10: effect 1 'lag': sign: unknown sign 'negative'; available: positive, both"),
        ("0.1", "2.0", "c.toml:8: effect 1 'lag': minimum: 2.0 is not below maximum = 1.0"),
        ("scale = 0.3", "scale = -1", "c.toml:11: effect 1 'lag': prior.scale: expected a positive number; found -1"),
        (
            '"log-normal"',
            '"uniform"',
            "c.toml:11: effect 1 'lag': prior.kind: unknown kind 'uniform'; did you mean 'normal'? available: normal, log-normal",
        ),
        ('name = "y"', 'name = "x"', "c.toml:12: effect 1 'lag': locations.1.name: location 'x' is there twice"),
        (
            '["p[1]"]',
            "[]",
            "c.toml:12: effect 1 'lag': locations.0.parameters: expected a list of names, such as ['backlash[2]']; found []",
        ),
        (
            'component = "a"',
            'component = "logging"',
            "expected 'KIND PATTERN' of the log, with KIND one of lag, smooth, gain, offset, swap, sign, unit, rotate_1, rotate_2, "
            "rotate_3; found 'p[1]'",
        ),
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
    with pytest.raises(CatalogueError, match=r"c\.toml:15: effect 2 'lag': name: is there twice"):
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
        ("minimum = 0.1", "minimum = inf", "c.toml:8: effect 1 'lag': minimum: expected a positive number; found inf"),
        ("minimum", "minimun", "c.toml:8: effect 1 'lag': minimun: unknown key 'minimun'; did you mean 'minimum'"),
        ("absolute = 0.4", "absolute = true", "c.toml:16: nuisance 1: absolute: expected a positive number; found True"),
    ],
)
def test_the_line_is_named(tmp_path: Path, old: str, new: str, line: str) -> None:
    (tmp_path / "c.toml").write_text((ENTRY + TOLERANCE).replace(old, new, 1))
    with pytest.raises(CatalogueError) as error:
        Catalogue.load(tmp_path / "c.toml")
    assert line in str(error.value)


OUTPUTS = ("drive.q[1]", "drive.q[2]", "sensor.f")


class TestWithin:
    CATALOGUE = """
[[effect]]
name = "a"
component = "drive"
description = "d"
source = "s"
unit = "1"
minimum = 0.1
maximum = 1.0
sign = "positive"
prior = {kind = "log-normal", scale = 0.3}
locations = [{name = "x", parameters = ["p[1]"]}, {name = "y", parameters = ["p[2]"]}]
[[effect]]
name = "late"
component = "logging"
description = "d"
source = "s"
unit = "s"
minimum = 0.1
maximum = 1.0
sign = "positive"
prior = {kind = "log-normal", scale = 0.3}
locations = [{name = "x", parameters = ["lag drive.q"]}]
[[nuisance]]
component = "sensor"
parameters = ["k", "m"]
relative = 0.1
source = "s"
[[seed]]
component = "sensor"
parameter = "seed"
[[quiet]]
component = "sensor"
parameters = {k = 0, resolution = 0}
[refinement]
divide = 4
sampled = ["sensor", "controller"]
"""

    def catalogue(self, folder: Path, text: str = CATALOGUE, name: str = "c.toml") -> Catalogue:
        (folder / name).write_text(text)
        return Catalogue.load(folder / name)

    def test_what_the_system_has_stays_as_it_is(self, tmp_path: Path) -> None:
        catalogue = self.catalogue(tmp_path)
        whole = {"drive": ["p[1]", "p[2]"], "sensor": ["k[1]", "k[2]", "m", "seed", "resolution"], "controller": []}
        found, notes = catalogue.within(whole, OUTPUTS)
        assert (found.candidates, found.tolerances, found.seeds, found.quiet) == (
            catalogue.candidates,
            catalogue.tolerances,
            catalogue.seeds,
            catalogue.quiet,
        )
        assert found.refinement == catalogue.refinement
        assert notes == ()

    def test_entries_without_a_component_or_its_parameters_are_left_out_and_listed(self, tmp_path: Path) -> None:
        found, notes = self.catalogue(tmp_path).within({"sensor": ["k"]}, OUTPUTS)
        assert [c.effect for c in found.candidates] == ["late"]
        assert [t.address for t in found.tolerances] == [("sensor", "k")]
        assert found.seeds == ()
        assert found.quiet == {"sensor": {"k": 0}}
        assert found.refinement is not None
        assert found.refinement.sampled == ("sensor",)
        assert notes == (
            "c.toml: there is no component 'drive' for effects a: skipped",
            "c.toml: component 'sensor' has no parameters for tolerances of m; quiet resolution; seeds seed: skipped",
            "c.toml: there is no component 'controller' for refinement controller: skipped",
        )

    def test_one_element_of_an_array_that_there_is_not(self, tmp_path: Path) -> None:
        found, notes = self.catalogue(tmp_path).within(
            {"drive": ["p[1]"], "sensor": ["k", "m", "seed", "resolution"], "controller": []}, OUTPUTS
        )
        assert [(c.effect, c.location) for c in found.candidates] == [("a", "x"), ("late", "x")]
        assert notes == ("c.toml: component 'drive' has no parameters for effects a: skipped",)

    def test_a_parameter_that_no_other_effect_names_may_be_meant(self, tmp_path: Path) -> None:
        full = {"sensor": ["k", "m", "seed", "resolution"], "controller": []}
        _, notes = self.catalogue(tmp_path).within({"drive": ["p_[1]", "p[2]"], **full}, OUTPUTS)
        assert notes == ("c.toml: component 'drive' has no parameters for effects a (no 'p[1]'; did you mean 'p_[1]'?): skipped",)

    def test_an_output_or_a_component_may_be_meant(self, tmp_path: Path) -> None:
        full = {"sensor": ["k", "m", "seed", "resolution"], "controller": []}
        found, notes = self.catalogue(tmp_path).within({"drives": ["p[1]", "p[2]"], **full}, ["drives.q[1]", "sensor.f"])
        assert found.candidates == ()
        assert notes == (
            "c.toml: there is no component 'drive' for effects a (no 'drive'; did you mean 'drives'?): skipped",
            "c.toml: there is no output for effects late (no 'drive.q'; did you mean 'drives.q'?): skipped",
        )
        _, notes = self.catalogue(tmp_path).within({"axis": [], **full}, ["sensor.f"])
        assert notes[1] == "c.toml: there is no output for effects late: skipped"

    def test_a_seed_names_the_effects_that_it_draws(self, tmp_path: Path) -> None:
        plain = 'parameter = "seed"'
        assert self.catalogue(tmp_path).drawn == frozenset()
        assert self.catalogue(tmp_path, self.CATALOGUE.replace(plain, f'{plain}\neffects = ["a"]')).drawn == {"a"}
        with pytest.raises(CatalogueError, match=r"there is no effect 'b'; available: a, late"):
            self.catalogue(tmp_path, self.CATALOGUE.replace(plain, f'{plain}\neffects = ["b"]'))

    def test_two_catalogues_become_one(self, tmp_path: Path) -> None:
        first = self.catalogue(tmp_path)
        other = self.catalogue(
            tmp_path, self.CATALOGUE.replace('"a"', '"b"').replace('"late"', '"later"').replace('"sensor"', '"kalman"'), "o.toml"
        )
        both = first.joined(other.about("kalman", "sensor"))
        assert both.effects == ("a", "late", "b", "later")
        assert both.seeds == (("sensor", "seed"),)
        assert {t.address[0] for t in both.tolerances} == {"sensor"}
        assert both.refinement is not None
        assert both.refinement.sampled == ("sensor", "controller", "sensor", "controller")
        assert set(both.descriptions) == {"a", "late", "b", "later"}
        with pytest.raises(CatalogueError, match=r"c\.toml: effect 'a' is in .*c\.toml, too; give one of them another name"):
            first.joined(first)


CALIBRATED = '[[nuisance]]\ncomponent = "a"\nparameters = ["r"]\nabsolute = 0.1\nunit = "m"\nsource = "laser tracker"\n'


def test_a_calibration_takes_the_place_of_the_tolerances_of_the_same_numbers(tmp_path: Path) -> None:
    file, calibration = tmp_path / "c.toml", tmp_path / "calibration.toml"
    file.write_text(ENTRY + TOLERANCE + TOLERANCE.replace('"r"', '"other"'))
    calibration.write_text(CALIBRATED)
    known = Catalogue.load(file)
    better = known.calibrated(calibration)
    assert {t.address[1]: t.size for t in better.tolerances} == {"r": 0.1, "other": 0.4}
    assert better.candidates == known.candidates


def test_what_is_wrong_with_a_calibration_is_said(tmp_path: Path) -> None:
    file, calibration = tmp_path / "c.toml", tmp_path / "calibration.toml"
    file.write_text(ENTRY)
    with pytest.raises(FileNotFoundError, match=r"no calibration .*calibration\.toml; expected a file with \[\[nuisance\]\] tables"):
        Catalogue.load(file).calibrated(calibration)
    calibration.write_text(CALIBRATED.replace("absolute", "abslute"))
    with pytest.raises(CatalogueError, match=r"calibration\.toml:4: .*abslute"):
        Catalogue.load(file).calibrated(calibration)


def test_an_effect_with_a_phase_is_not_there_already() -> None:
    catalogue = Catalogue.load(SCENARIOS / "catalogue.toml")
    runout = next(c for c in catalogue.candidates if c.has_phase)
    address = runout.component, runout.named[0]
    catalogue.check_phases({address: 0.0})
    with pytest.raises(CatalogueError) as refused:
        catalogue.check_phases({address: 2e-5})
    told = f"effect {runout.effect!r}: {'.'.join(address)} is 2e-05 {runout.unit} in the system; expected 0 for an effect with a phase"
    assert told in str(refused.value)
