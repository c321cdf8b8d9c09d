"""Units against their definitions, and what parameter files may and may not hold."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from robomill.models.model.declaration import FloatArray
from robomill.models.model.parameters import DATA, load, quantity
from robomill.models.model.units import UNITS, compatible, convert, from_si, to_si
from tests.tolerances import ROUNDOFF

ATOMS: dict[str, tuple[float, dict[str, int]]] = {
    "1": (1.0, {}),
    "%": (0.01, {}),
    "m": (1.0, {"m": 1}),
    "mm": (1e-3, {"m": 1}),
    "cm": (1e-2, {"m": 1}),
    "um": (1e-6, {"m": 1}),
    "s": (1.0, {"s": 1}),
    "ms": (1e-3, {"s": 1}),
    "min": (60.0, {"s": 1}),
    "h": (3600.0, {"s": 1}),
    "Hz": (1.0, {"s": -1}),
    "kg": (1.0, {"kg": 1}),
    "K": (1.0, {"K": 1}),
    "degC": (1.0, {"K": 1}),
    "A": (1.0, {"A": 1}),
    "rad": (1.0, {"rad": 1}),
    "deg": (np.pi / 180.0, {"rad": 1}),
    "rpm": (2.0 * np.pi / 60.0, {"rad": 1, "s": -1}),
    "N": (1.0, {"kg": 1, "m": 1, "s": -2}),
    "kN": (1e3, {"kg": 1, "m": 1, "s": -2}),
    "Pa": (1.0, {"kg": 1, "m": -1, "s": -2}),
    "MPa": (1e6, {"kg": 1, "m": -1, "s": -2}),
    "W": (1.0, {"kg": 1, "m": 2, "s": -3}),
    "kW": (1e3, {"kg": 1, "m": 2, "s": -3}),
    "permille": (1e-3, {}),
    "ppm": (1e-6, {}),
    "us": (1e-6, {"s": 1}),
    "ns": (1e-9, {"s": 1}),
    "kHz": (1e3, {"s": -1}),
    "nm": (1e-9, {"m": 1}),
    "mrad": (1e-3, {"rad": 1}),
    "urad": (1e-6, {"rad": 1}),
    "g": (1e-3, {"kg": 1}),
    "mN": (1e-3, {"kg": 1, "m": 1, "s": -2}),
    "kPa": (1e3, {"kg": 1, "m": -1, "s": -2}),
    "GPa": (1e9, {"kg": 1, "m": -1, "s": -2}),
    "bar": (1e5, {"kg": 1, "m": -1, "s": -2}),
    "mA": (1e-3, {"A": 1}),
    "V": (1.0, {"kg": 1, "m": 2, "s": -3, "A": -1}),
    "mV": (1e-3, {"kg": 1, "m": 2, "s": -3, "A": -1}),
    "uV": (1e-6, {"kg": 1, "m": 2, "s": -3, "A": -1}),
    "J": (1.0, {"kg": 1, "m": 2, "s": -2}),
}
"""Definitions of the SI and of the units beside it; everything else is a product of these."""


def parsed(name: str) -> tuple[float, dict[str, int]]:
    """Factor and exponents of a name such as ``N.m/rad``, ``cm3/min`` or ``rad/(N.m)`` from `ATOMS`."""
    factor, exponents = 1.0, dict[str, int]()
    numerator, _, denominator = name.partition("/")
    for part, sense in ((numerator, 1), (denominator.strip("()"), -1)):
        for word in filter(None, part.split(".")):
            match = re.fullmatch(r"([A-Za-z%]+|1)(\d?)", word)
            assert match, f"{name}: {word} is no unit"
            power = sense * int(match[2] or 1)
            atom_factor, atom = ATOMS[match[1]]
            factor *= atom_factor**power
            for base, exponent in atom.items():
                exponents[base] = exponents.get(base, 0) + power * exponent
    return factor, {base: exponent for base, exponent in exponents.items() if exponent}


class TestUnits:
    """The table of units."""

    @pytest.mark.parametrize("name", UNITS)
    def test_every_unit_is_the_product_of_its_parts(self, name: str) -> None:
        factor, exponents = parsed(name)
        assert abs(UNITS[name].factor - factor) <= ROUNDOFF * factor
        assert {base: e for base, e in UNITS[name].exponents.items() if e} == exponents

    @pytest.mark.parametrize(
        ("value", "unit", "si"),
        [(180.0, "deg", np.pi), (13000.0, "rpm", 13000.0 / 60.0 * 2.0 * np.pi), (1.9e8, "N.mm/rad", 1.9e5), (20.0, "degC", 293.15)],
    )
    def test_conversion_there_and_back(self, value: float, unit: str, si: float) -> None:
        assert abs(to_si(value, unit) - si) <= ROUNDOFF * abs(si)
        assert abs(from_si(si, unit) - value) <= 10 * ROUNDOFF * abs(value)

    def test_compatible_units_measure_the_same(self) -> None:
        assert compatible("N.mm/rad", "N.m/rad")
        assert compatible("rpm", "deg/s")
        assert not compatible("N.m", "N.m/rad")
        assert not compatible("Hz", "rad/s"), "a revolution is 2 pi rad: mixing them up must not pass"
        assert not compatible("furlong", "m")

    @pytest.mark.parametrize(
        ("value", "unit", "wanted", "expected"),
        [
            (70.0, "GPa", "Pa", 7e10),
            (600.0, "N/mm^2", "Pa", 6e8),
            (600.0, "N/mm\u00b2", "Pa", 6e8),
            (2.5, "kN/mm", "N/m", 2.5e6),
            (40.0, "N/um", "N/m", 4e7),
            (40.0, "N/\u00b5m", "N/m", 4e7),
            (0.5, "um/N", "m/N", 5e-7),
            (13000.0, "rpm", "rad/s", 13000.0 * 2.0 * np.pi / 60.0),
            (13000.0, "1/min", "rad/s", 13000.0 * 2.0 * np.pi / 60.0),
            (13000.0, "rev/min", "rad/s", 13000.0 * 2.0 * np.pi / 60.0),
            (6.5, "Hz", "rad/s", 13.0 * np.pi),
            (600.0, "1/min", "Hz", 10.0),
            (1500.0, "mm/min", "m/s", 0.025),
            (1.5, "m/min", "m/s", 0.025),
            (3.0, "Nm/deg", "N.m/rad", 540.0 / np.pi),
            (3.0, "Nm/rad", "N.m/rad", 3.0),
            (3.0, "kN*m", "N.m", 3000.0),
            (3.0, "Nmm", "N.m", 3e-3),
            (90.0, "\u00b0", "rad", np.pi / 2.0),
            (20.0, "\u00b0C", "K", 293.15),
            (5.0, "\u2030", "1", 5e-3),
            (5.0, "%", "1", 0.05),
            (250.0, "g", "kg", 0.25),
            (7.0, "V", "V", 7.0),
        ],
    )
    def test_units_as_people_spell_them(self, value: float, unit: str, wanted: str, expected: float) -> None:
        assert abs(convert(value, unit, wanted) - expected) <= 2 * ROUNDOFF * abs(expected)

    @pytest.mark.parametrize(
        ("value", "unit", "wanted", "text"),
        [
            (16.0, "", "m", '16 has no unit; expected a text with one, such as "16 mm" or "16 m"; units that fit: mm, m, cm, um, nm'),
            (16.0, "MM", "m", "unknown unit 'MM'; units that fit: mm, m, cm, um, nm"),
            (16.0, "Mm", "m", "unknown unit 'Mm'"),
            (3.0, "mPa", "Pa", "unknown unit 'mPa'; units that fit: N/mm2, Pa, kPa, MPa, GPa, bar, N/m2, kN/mm2"),
            (3.0, "N", "m", "3 N cannot be expressed in m: it measures something else; units that fit: mm, m"),
            (
                13000.0,
                "1/s",
                "rad/s",
                "13000 1/s cannot be expressed in rad/s: it measures something else; units that fit: rpm, rad/s, deg/s, Hz",
            ),
            (2.0, "g", "m/s2", "2 g cannot be expressed in m/s2: it measures something else; units that fit: m/s2, mm/s2"),
            (0.0, "", "K", '0 has no unit; expected a text with one, such as "0 K"'),
            (5.0, "", "V", '5 has no unit; expected a text with one, such as "5 V"; units that fit: V'),
        ],
    )
    def test_what_does_not_fit_is_refused_with_what_does(self, value: float, unit: str, wanted: str, text: str) -> None:
        with pytest.raises(ValueError, match="^" + re.escape(text)):
            convert(value, unit, wanted)

    def test_zero_needs_no_unit_where_it_is_the_same_in_all(self) -> None:
        assert [convert(0.0, "", unit) for unit in ("m", "rad/s", "N.m/rad", "V")] == [0.0] * 4
        assert convert(5.0, "", "1") == 5.0

    @pytest.mark.parametrize("convert", [to_si, from_si])
    def test_an_unknown_unit_is_refused_with_the_known_ones(self, convert: object) -> None:
        with pytest.raises(ValueError, match=r"unknown unit 'furlong'; known units: %, 1, 1/K, 1/N, 1/min, 1/s, A, .*um/N"):
            convert(1.0, "furlong")  # type: ignore[operator]  # parametrised over two functions of one signature


@dataclass(frozen=True)
class Spring:
    """A small parameter set for these tests."""

    name: str
    stiffness: FloatArray = field(metadata=quantity("N.m/rad", 0.0))
    length: float = field(metadata=quantity("m", 0.0, 2.0))
    ratio: float = 0.0


GOOD = """
[name]
value = "test spring"
unit = "1"
source = "made up"
validity = "tests"
[stiffness]
value = [1.0e3, 2.0e3]
unit = "N.mm/rad"
source = "made up"
validity = "tests"
[length]
value = 150
unit = "mm"
source = "made up"
validity = "tests"
[ratio]
value = 25
unit = "%"
source = "made up"
validity = "tests"
"""


class TestParameterFiles:
    """TOML files of cited values."""

    @staticmethod
    def loaded(folder: Path, text: str) -> Spring:
        file = folder / "spring.toml"
        file.write_text(text, encoding="utf-8")
        return load(Spring, file)

    def test_values_arrive_in_si(self, tmp_path: Path) -> None:
        spring = self.loaded(tmp_path, GOOD)
        assert spring.name == "test spring"
        assert np.abs(spring.stiffness - [1.0, 2.0]).max() < ROUNDOFF
        assert abs(spring.length - 0.15) < ROUNDOFF
        assert abs(spring.ratio - 0.25) < ROUNDOFF

    def test_arrays_cannot_be_changed(self, tmp_path: Path) -> None:
        spring = self.loaded(tmp_path, GOOD)
        with pytest.raises(ValueError, match="read-only"):
            spring.stiffness[0] = 5.0

    @pytest.mark.parametrize(
        ("old", "new", "text"),
        [
            ("[ratio]", "[rtaio]", r"spring\.toml: unknown fields \['rtaio'\], missing fields \[\]; Spring has length, name, ratio"),
            (
                "[length]",
                "[lenght]",
                r"spring\.toml: unknown fields \['lenght'\], missing fields \['length'\]; Spring has",
            ),
            ('unit = "mm"', 'unit = "kg"', r"spring\.toml: length: unit 'kg' does not measure 'm'; known units: "),
            ('unit = "mm"', 'unit = "parsec"', r"spring\.toml: length: unit 'parsec' does not measure 'm'"),
            ("value = 150", "value = -150", r"spring\.toml: length: -150 mm is outside \[0\.0, 2\.0\] m"),
            ("value = 150", "value = 2500", r"spring\.toml: length: 2500 mm is outside \[0\.0, 2\.0\] m"),
            ("value = 150", "value = nan", r"spring\.toml: length: nan is not finite"),
            ("value = 150", 'value = "long"', r"spring\.toml: length: 'long' is text, expected a number in 'm'"),
            ("[1.0e3, 2.0e3]", "[1.0e3, -2.0e3]", r"spring\.toml: stiffness: .*-2000.* is outside \[0\.0, None\] N\.m/rad"),
            (
                "[length]\n",
                "[length]\nremark = 1\n",
                r"spring\.toml: length: expected a table with source, unit, validity, value; found .*remark",
            ),
            ('value = 25\nunit = "%"\n', "", r"spring\.toml: ratio: expected a table with .*; found \['source', 'validity'\]"),
            (
                '[ratio]\nvalue = 25\nunit = "%"\nsource = "made up"',
                '[ratio]\nvalue = 25\nunit = "%"\nsource = ""',
                "ratio: the source is missing",
            ),
            ("[ratio]", "[ratio", r"spring\.toml: not valid TOML: "),
        ],
    )
    def test_a_bad_file_is_refused_with_file_field_and_reason(self, tmp_path: Path, old: str, new: str, text: str) -> None:
        assert old in GOOD
        with pytest.raises(ValueError, match=text):
            self.loaded(tmp_path, GOOD.replace(old, new, 1))

    def test_a_missing_file_lists_the_shipped_ones(self) -> None:
        with pytest.raises(
            FileNotFoundError, match=r"no parameter file .*springs/none\.toml; available: .*compliance/kr300_r2500_ultra.*robots/"
        ):
            load(Spring, "springs/none")

    @pytest.mark.parametrize("file", sorted(DATA.rglob("*.toml")), ids=lambda p: p.stem)
    def test_shipped_files_cite_every_value(self, file: Path) -> None:
        """Every table of every file has value, unit, source and validity, and a known unit."""
        import tomllib

        for name, entry in tomllib.loads(file.read_text(encoding="utf-8")).items():
            assert set(entry) == {"value", "unit", "source", "validity"}, name
            assert entry["source"], name
            assert entry["unit"] in UNITS, name
