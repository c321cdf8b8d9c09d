"""Units: what the grammar takes and refuses, against definitions and by properties of random products."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from scipy import constants

from robomill.models.model.units import BASE, PREFIXED, Unit, compatible, convert, fitting, from_si, to_si, unit_of
from tests.tolerances import EXACT, ROUNDOFF

N = {"kg": 1, "m": 1, "s": -2}
PA = {"kg": 1, "m": -1, "s": -2}
J = {"kg": 1, "m": 2, "s": -2}
V = {"kg": 1, "m": 2, "s": -3, "A": -1}
OHM = {"kg": 1, "m": 2, "s": -3, "A": -2}
W = {"kg": 1, "m": 2, "s": -3}

DEFINITIONS: dict[str, tuple[float, dict[str, int]]] = {
    **{base: (1.0, {base: 1}) for base in BASE},
    "g": (1e-3, {"kg": 1}),
    "t": (1e3, {"kg": 1}),
    "lb": (constants.lb, {"kg": 1}),
    "1": (1.0, {}),
    "-": (1.0, {}),
    "%": (1e-2, {}),
    "permille": (1e-3, {}),
    "ppm": (1e-6, {}),
    "ppb": (1e-9, {}),
    "min": (constants.minute, {"s": 1}),
    "h": (constants.hour, {"s": 1}),
    "d": (constants.day, {"s": 1}),
    "in": (constants.inch, {"m": 1}),
    "ft": (constants.foot, {"m": 1}),
    "l": (constants.liter, {"m": 3}),
    "gn": (constants.g, {"m": 1, "s": -2}),
    "deg": (constants.degree, {"rad": 1}),
    "arcmin": (constants.arcmin, {"rad": 1}),
    "arcsec": (constants.arcsec, {"rad": 1}),
    "rev": (2.0 * math.pi, {"rad": 1}),
    "rpm": (2.0 * math.pi / 60.0, {"rad": 1, "s": -1}),
    "degC": (1.0, {"K": 1}),
    "degF": (constants.degree_Fahrenheit, {"K": 1}),
    "Hz": (1.0, {"s": -1}),
    "N": (1.0, N),
    "kgf": (constants.kgf, N),
    "kp": (constants.kgf, N),
    "lbf": (constants.lbf, N),
    "Pa": (1.0, PA),
    "bar": (constants.bar, PA),
    "atm": (constants.atm, PA),
    "psi": (constants.psi, PA),
    "J": (1.0, J),
    "Nm": (1.0, J),
    "Nmm": (1e-3, J),
    "Wh": (constants.hour, J),
    "eV": (constants.eV, J),
    "W": (1.0, W),
    "VA": (1.0, W),
    "C": (1.0, {"s": 1, "A": 1}),
    "Ah": (constants.hour, {"s": 1, "A": 1}),
    "V": (1.0, V),
    "Ohm": (1.0, OHM),
    "S": (1.0, {base: -e for base, e in OHM.items()}),
    "F": (1.0, {"kg": -1, "m": -2, "s": 4, "A": 2}),
    "H": (1.0, {"kg": 1, "m": 2, "s": -2, "A": -2}),
    "Wb": (1.0, {"kg": 1, "m": 2, "s": -2, "A": -1}),
    "T": (1.0, {"kg": 1, "s": -2, "A": -1}),
    "sr": (1.0, {"rad": 2}),
    "lm": (1.0, {"cd": 1, "rad": 2}),
    "lx": (1.0, {"m": -2, "cd": 1, "rad": 2}),
    "Bq": (1.0, {"s": -1}),
    "Gy": (1.0, {"m": 2, "s": -2}),
    "Sv": (1.0, {"m": 2, "s": -2}),
    "kat": (1.0, {"s": -1, "mol": 1}),
}
"""Factor (scipy.constants: CODATA, NIST SP 811) and SI base exponents (SI brochure, table 4)."""
PREFIXES = {"f": 1e-15, "p": 1e-12, "n": 1e-9, "u": 1e-6, "m": 1e-3, "c": 1e-2, "d": 0.1, "h": 1e2, "k": 1e3, "M": 1e6, "G": 1e9, "T": 1e12}
FEW = 8.0 * ROUNDOFF
"""A product of up to four factors to powers up to three is rounded a few times."""


def random_terms(random: np.random.Generator) -> list[tuple[str, int]]:
    """Up to four names with prefixes, each with a power."""
    names = [s for s in DEFINITIONS if s not in ("1", "-")] + [p + s for s in PREFIXED for p in PREFIXED[s]]
    return [(str(random.choice(names)), int(random.choice([-3, -2, -1, 1, 2, 3]))) for _ in range(random.integers(1, 5))]


def spelt(terms: list[tuple[str, int]]) -> str:
    return ".".join(name + (str(power) if power != 1 else "") for name, power in terms)


def close(a: Unit, b: Unit) -> bool:
    return a.exponents == b.exponents and abs(a.factor - b.factor) <= FEW * b.factor


class TestGrammar:
    """What a text means."""

    @pytest.mark.parametrize("name", DEFINITIONS)
    def test_symbols_are_what_their_definitions_say(self, name: str) -> None:
        factor, exponents = DEFINITIONS[name]
        assert abs(unit_of(name).factor - factor) <= ROUNDOFF * factor
        assert unit_of(name).exponents == exponents

    def test_a_name_with_a_prefix_has_one_meaning(self) -> None:
        """`min`, `Pa`, `cd`, `mol`, `ft`, `T`, `h` and their like are no prefix with something else, and no prefixed name is another's."""
        seen = dict.fromkeys(DEFINITIONS, "")
        for symbol, prefixes in PREFIXED.items():
            for prefix in prefixes:
                name = prefix + symbol
                if name == "kg":
                    continue  # the base unit itself: 10^3 g
                assert name not in seen, f"{name} is {seen.get(name)} and {prefix}-{symbol}"
                seen[name] = f"{prefix}-{symbol}"
                factor = unit_of(f"({name})").factor  # in brackets mPa is no slip
                assert abs(factor - PREFIXES[prefix] * unit_of(symbol).factor) <= 2.0 * ROUNDOFF * factor
        assert unit_of("kg") == unit_of("kg.g/g")

    @pytest.mark.parametrize("seed", range(30))
    def test_products_multiply_factors_and_add_exponents(self, seed: int) -> None:
        terms = random_terms(np.random.default_rng(seed))
        factor, total = 1.0, dict.fromkeys(BASE, 0)
        for name, power in terms:
            part = unit_of(f"({name})")
            factor *= part.factor**power
            for base, exponent in part.exponents.items():
                total[base] += power * exponent
        found = unit_of(spelt(terms))
        assert abs(found.factor - factor) <= FEW * factor
        assert found.exponents == {base: e for base, e in total.items() if e}
        assert list(found.exponents) == [base for base in BASE if total[base]]

    @pytest.mark.parametrize("seed", range(30))
    def test_a_unit_times_its_inverse_is_one_and_its_si_name_reads_back(self, seed: int) -> None:
        text = spelt(random_terms(np.random.default_rng(seed)))
        assert unit_of(f"({text})/({text})") == Unit(1.0, {}, 0.0, "1")
        si = unit_of(unit_of(text).si)
        assert (si.factor, si.exponents, si.si) == (1.0, unit_of(text).exponents, unit_of(text).si)

    @pytest.mark.parametrize("seed", range(30))
    def test_all_spellings_of_a_product_mean_the_same(self, seed: int) -> None:
        terms = random_terms(np.random.default_rng(seed))
        expected = unit_of(spelt(terms))
        for times, power in (("*", "^{}"), ("\u00b7", "**{}"), (" ", "{}"), (" . ", " ^ {}")):
            assert unit_of(times.join(name + (power.format(p) if p != 1 else "") for name, p in terms)) == expected
        raised = str.maketrans("-123", "\u207b\u00b9\u00b2\u00b3")
        assert unit_of(" ".join(name + str(p).translate(raised) for name, p in terms)) == expected
        above, below = ([f"{n}{abs(p)}" for n, p in terms if p * sense > 0] for sense in (1, -1))
        if below:
            assert close(unit_of(f"{'.'.join(above) or '1'}/({'.'.join(below)})"), expected)
            assert close(unit_of("/".join([".".join(above) or "1", *below])), expected)

    @pytest.mark.parametrize(
        ("text", "same", "si"),
        [
            ("N.m.s/rad", "kg.m2.s-1.rad-1", "N.m.s/rad"),
            ("N*s^2/m", "kg", "N.s2/m"),
            ("N\u00b7s\u00b2/m", "kg", "N.s2/m"),
            ("N s\u00b2 / m", "kg", "N.s2/m"),
            ("m/s/s", "m/s2", "m/s2"),
            ("m s\u207b\u00b9", "m/s", "m/s"),
            ("Nm/deg", "N.m/deg", "N.m/rad"),
            ("kNmm", "N.m", "N.m"),
            ("\u00b5m/\u00b0C", "um/K", "m/K"),
            ("\u03bcm", "um", "m"),
            ("\u2126", "Ohm", "Ohm"),
            ("k\u03a9", "kOhm", "Ohm"),
            ("\u2103", "degC", "K"),
            ("rev/min", "rpm", "rad/s"),
            ("deg/sec", "deg/s", "rad/s"),
            ("min-1", "1/min", "1/s"),
            ("l/min", "dm3/min", "m3/s"),
            ("N.V/mV", "kN", "N"),
            ("mV/V", "permille", "1"),
            ("(m/s)^2", "m2/s2", "m2/s2"),
            ("1/(N.m)", "s2/(kg.m2)", "1/(N.m)"),
            ("mPa.s", "g/(m.s)", "Pa.s"),
            ("J/(kg.K)", "m2/(s2.K)", "J/(kg.K)"),
            ("V.s/rad", "Wb/rad", "V.s/rad"),
        ],
    )
    def test_units_as_people_spell_them(self, text: str, same: str, si: str) -> None:
        assert close(unit_of(text), unit_of(same))
        assert unit_of(text).si == si

    @pytest.mark.parametrize(
        ("text", "why"),
        [
            ("furlong", ""),
            ("MM", ""),
            ("Mm", ""),
            ("ks", ""),
            ("kmin", ""),
            ("n", ""),
            ("mPa", ": alone, it is mostly a slip of MPa; write 0.001 Pa if it is none"),
            ("N.furlong/rad", ": 'furlong' is no unit"),
            ("J/kg.K", ": what is divided by has two readings; put it into brackets, as in J/(kg.K)"),
            (
                "N/mm^1.5",
                ": its power 1.5 is not whole, as those in FMI are; give the value at a nominal input, such as m3/s at a nominal Pa",
            ),
            ("V/\u221aHz", ": '\u221a' is no part of a unit"),
            ("10 N", ": expected a unit before '10'"),
            ("N..m", ": expected a unit before '.'"),
            ("N/", ": a unit is missing at its end"),
            ("", ": a unit is missing at its end"),
            ("(N.m", ": a ')' is missing"),
            ("m2)", ": there is a ')' too many"),
            ("m^^2", ": '^' is no part of a unit"),
        ],
    )
    def test_what_is_no_unit_is_refused_with_the_part_that_is_none(self, text: str, why: str) -> None:
        with pytest.raises(ValueError, match=f"^{re.escape(f'unknown unit {text!r}{why}')}$"):
            unit_of(text)

    def test_units_of_one_quantity_are_compatible_and_rad_is_a_unit(self) -> None:
        assert compatible("N.mm/rad", "N.m/rad")
        assert compatible("rpm", "deg/s")
        assert compatible("N.s2/m", "kg")
        assert not compatible("N.m", "N.m/rad")
        assert not compatible("Hz", "rad/s"), "a revolution is 2 pi rad: mixing them up must not pass"
        assert not compatible("furlong", "m")


class TestConversion:
    """Values in units."""

    @pytest.mark.parametrize(
        ("value", "unit", "si"),
        [(180.0, "deg", np.pi), (13000.0, "rpm", 13000.0 / 60.0 * 2.0 * np.pi), (1.9e8, "N.mm/rad", 1.9e5), (20.0, "degC", 293.15)],
    )
    def test_conversion_there_and_back(self, value: float, unit: str, si: float) -> None:
        assert abs(to_si(value, unit) - si) <= ROUNDOFF * abs(si)
        assert abs(from_si(si, unit) - value) <= 10 * ROUNDOFF * abs(value)

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
            (2.0, "kN.s/mm", "N.s/m", 2e6),
            (2.0, "N*s^2/mm", "N.s2/m", 2e3),
            (46.0, "mPa.s", "Pa.s", 0.046),
            (3.0, "l/min", "m3/s", 5e-5),
            (2.0, "kgf", "N", 19.6133),
            (2.0, "kHz", "rad/s", 4e3 * np.pi),
            (68.0, "degF", "degC", 20.0),
            (5.0, "um/degC", "m/K", 5e-6),
        ],
    )
    def test_values_in_units_as_people_spell_them(self, value: float, unit: str, wanted: str, expected: float) -> None:
        assert abs(convert(value, unit, wanted) - expected) <= 2 * ROUNDOFF * abs(expected)

    @pytest.mark.parametrize(
        ("value", "unit", "wanted", "text"),
        [
            (16.0, "", "m", '16 has no unit; expected a text with one, such as "16 mm" or "16 m"; units that fit: mm, m, cm, um, nm'),
            (16.0, "MM", "m", "unknown unit 'MM'; units that fit: mm, m, cm, um, nm"),
            (16.0, "Mm", "m", "unknown unit 'Mm'"),
            (
                3.0,
                "mPa",
                "Pa",
                "unknown unit 'mPa': alone, it is mostly a slip of MPa; write 0.001 Pa if it is none; units that fit: N/mm2, Pa, kPa",
            ),
            (3.0, "N", "m", "3 N cannot be expressed in m: it measures something else; units that fit: mm, m"),
            (
                13000.0,
                "1/s",
                "rad/s",
                "13000 1/s cannot be expressed in rad/s: they differ by rad, which is a unit of its own; units that fit: rpm, rad/s, "
                "deg/s, Hz, kHz, 1/min",
            ),
            (2.0, "g", "m/s2", "2 g cannot be expressed in m/s2: it measures something else; units that fit: m/s2, mm/s2, gn"),
            (0.0, "", "K", '0 has no unit; expected a text with one, such as "0 K"'),
            (5.0, "", "V", '5 has no unit; expected a text with one, such as "5 V"; units that fit: V'),
            (5.0, "N.foo", "N.m", "unknown unit 'N.foo': 'foo' is no unit; units that fit: N.m, N.mm, kN.m"),
            (
                5.0,
                "N.s2/m3",
                "N.s2/m",
                "5 N.s2/m3 cannot be expressed in N.s2/m: it measures something else; units that fit: N.s2/m, kg, g",
            ),
            (5.0, "m", "blob", "5 m cannot be expressed in 'blob', which is no unit that is known here; write it in that unit"),
            (0.0, "", "degC", '0 has no unit; expected a text with one, such as "0 degC"'),
        ],
    )
    def test_what_does_not_fit_is_refused_with_what_does(self, value: float, unit: str, wanted: str, text: str) -> None:
        with pytest.raises(ValueError, match="^" + re.escape(text)):
            convert(value, unit, wanted)

    def test_zero_needs_no_unit_where_it_is_the_same_in_all(self) -> None:
        assert [convert(0.0, "", unit) for unit in ("m", "rad/s", "N.m/rad", "V")] == [0.0] * 4
        assert convert(5.0, "", "1") == 5.0

    @pytest.mark.parametrize("seed", range(30))
    def test_any_product_converts_to_its_si_unit_and_back(self, seed: int) -> None:
        text = spelt(random_terms(np.random.default_rng(seed)))
        u = unit_of(text)
        if not u.offset:
            assert abs(convert(3.0, text, u.si) - 3.0 * u.factor) <= FEW * 3.0 * u.factor
        assert abs(convert(convert(3.0, text, u.si), u.si, text) - 3.0) <= FEW * 3.0
        assert convert(3.0, text, text) - 3.0 == EXACT

    def test_what_is_suggested_fits(self) -> None:
        for wanted in ("m", "N.s/m", "K", "Pa", "1", "N.m.s/rad"):
            assert fitting(wanted)
            assert all(compatible(u, wanted) for u in fitting(wanted))

    @pytest.mark.parametrize("convert", [to_si, from_si])
    def test_an_unknown_unit_is_refused(self, convert: object) -> None:
        with pytest.raises(ValueError, match=r"^unknown unit 'furlong'$"):
            convert(1.0, "furlong")  # type: ignore[operator]  # parametrised over two functions of one signature
