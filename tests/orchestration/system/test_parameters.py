"""Parameter values as people write them."""

from __future__ import annotations

import math

import pytest

from robomill.models.model import units
from robomill.orchestration.errors import OrchestrationError, PlacedError, SlaveError
from robomill.orchestration.slaves.protocol import PortData
from robomill.orchestration.system.entries import Entry
from robomill.orchestration.system.parameters import prepare, quantity
from robomill.orchestration.system.written import Written, merged, place_of
from tests.orchestration.system.test_definition import convert

PORTS = [
    PortData("u", "input", unit="m"),
    PortData("length", "parameter", unit="m", minimum=0.0, maximum=1.0),
    *(PortData(f"K[{i},{j}]", "parameter", unit="1") for i in (1, 2) for j in (1, 2, 3)),
    *(PortData(f"gap[{i}]", "parameter", unit="rad") for i in (1, 2)),
    PortData("mode", "parameter", type="integer", minimum=0, maximum=2),
    PortData("pilot", "parameter", type="boolean"),
    PortData("program", "parameter", type="string"),
]


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"length": 0.5}, {"length": 0.5}),
        ({"length": 1}, {"length": 1.0}),
        ({"length": "200 mm"}, {"length": 0.2}),
        ({"length": ".5 m"}, {"length": 0.5}),
        ({"length": {"value": 200, "unit": "mm"}}, {"length": 0.2}),
        ({"gap": ["2 urad", 1.0]}, {"gap[1]": 2e-6, "gap[2]": 1.0}),
        ({"gap": {"value": [1, 2], "unit": "urad"}}, {"gap[1]": 1e-6, "gap[2]": 2e-6}),
        ({"gap[2]": 3.0}, {"gap[2]": 3.0}),
        ({"K": [[1, 2, 3], [4, 5, 6]]}, {f"K[{i},{j}]": 3.0 * (i - 1) + j for i in (1, 2) for j in (1, 2, 3)}),
        ({"K": [1, 2, 3, 4, 5, 6]}, {f"K[{i},{j}]": 3.0 * (i - 1) + j for i in (1, 2) for j in (1, 2, 3)}),
        ({"mode": 2, "pilot": True, "program": "part.ngc"}, {"mode": 2, "pilot": True, "program": "part.ngc"}),
        ({"mode": 1.0, "pilot": 0}, {"mode": 1, "pilot": False}),
    ],
)
def test_values(given, expected):
    found = prepare("c", PORTS, given, convert)
    assert found == expected
    assert [type(v) for v in found.values()] == [type(v) for v in expected.values()]


@pytest.mark.parametrize(
    ("given", "text"),
    [
        (
            {"lenght": 1.0},
            "component 'c': unknown parameter 'lenght'; did you mean 'length'? available: length, K, gap, mode, pilot, program",
        ),
        ({"u": 1.0}, "component 'c': 'u' is an input, not a parameter"),
        ({"length": 2.0}, "component 'c': parameter 'length': 2 m is above its maximum 1 m"),
        ({"length": "-1 mm"}, "component 'c': parameter 'length': -0.001 m is below its minimum 0 m"),
        ({"length": "1 urad"}, "component 'c': parameter 'length': unit 'urad' does not measure 'm'"),
        ({"length": "long"}, "component 'c': parameter 'length': 'long' is not a number with a unit, such as '4 m'"),
        ({"length": True}, "component 'c': parameter 'length': expected a number in 'm'; found True"),
        ({"length": math.nan}, "component 'c': parameter 'length': expected a finite number in 'm'; found nan"),
        ({"length": [1.0]}, "component 'c': parameter 'length': expected a number in 'm'; found [1.0]"),
        (
            {"length": {"metres": 1}},
            "component 'c': parameter 'length': expected a value or {value = ..., unit = ...}; found a table with metres",
        ),
        ({"gap": 1.0}, "component 'c': parameter 'gap' is an array of 2 elements; found the single value 1.0"),
        ({"gap": [1, 2, 3]}, "component 'c': parameter 'gap' has shape [2]; found values of shape [3]"),
        ({"K": [[1, 2], [3, 4], [5, 6]]}, "component 'c': parameter 'K' has shape [2, 3]; found values of shape [3, 2]"),
        ({"gap": [1, 2], "gap[1]": 1}, "component 'c': parameter 'gap[1]' is given twice: by element and within its array"),
        ({"gap[3]": 1}, "component 'c': unknown parameter 'gap[3]'; did you mean 'gap'?"),
        ({"mode": 1.5}, "component 'c': parameter 'mode': expected a whole number; found 1.5"),
        ({"mode": 3}, "component 'c': parameter 'mode': 3 1 is above its maximum 2 1"),
        ({"pilot": "on"}, "component 'c': parameter 'pilot': expected true or false; found 'on'"),
        ({"program": 1}, "component 'c': parameter 'program': expected a text; found 1"),
        ({"program": {"file": "none.npy"}}, "component 'c': parameter 'program': no such file "),
        ({"program": {"path": "x"}}, "component 'c': parameter 'program': expected a text or {file = ...}; found a table with path"),
    ],
)
def test_errors(given, text):
    with pytest.raises(SlaveError) as caught:
        prepare("c", PORTS, given, convert)
    assert str(caught.value).startswith(text)


def test_files_are_relative_to_the_system_file(tmp_path):
    (tmp_path / "part.npy").write_bytes(b"")
    assert prepare("c", PORTS, {"program": {"file": "part.npy"}}, folder=tmp_path) == {"program": str(tmp_path / "part.npy")}


def test_without_a_unit_table_units_must_be_equal():
    assert prepare("c", PORTS, {"length": "0.5 m"}) == {"length": 0.5}
    with pytest.raises(SlaveError, match="unit 'mm' cannot be converted to 'm': no unit table was given"):
        prepare("c", PORTS, {"length": "5 mm"})


class TestWrittenByHand:
    """What stands in a file needs units, and is refused with its place."""

    def prepared(self, tmp_path, text):
        (tmp_path / "cell.toml").write_text(text)
        entry = Entry.load(tmp_path / "cell.toml", ValueError, name="cell.toml")
        return prepare("c", PORTS, entry.written(), convert)

    def test_what_has_no_unit_needs_none_and_zero_needs_none(self, tmp_path):
        found = self.prepared(tmp_path, 'length = 0\ngap = ["2 urad", 0.0]\nK = [1, 2, 3, 4, 5, "6"]\nmode = 2\npilot = true')
        assert (found["length"], found["gap[1]"], found["K[2,3]"], found["mode"], found["pilot"]) == (0.0, 2e-6, 6.0, 2, True)

    @pytest.mark.parametrize("text", ["4 kN m", "4kN*m", "4e3 N \u00b7 m", " 4 kN.m "])
    def test_a_unit_may_have_blanks(self, text):
        assert quantity(text, "N.m", units.convert) == 4000.0

    def test_one_unit_for_a_whole_array(self, tmp_path):
        assert self.prepared(tmp_path, 'gap = {value = [1, 2], unit = "urad"}') == {"gap[1]": 1e-6, "gap[2]": 2e-6}

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("length = 0.5", "cell.toml:1: component 'c': parameter 'length': 0.5 has no unit; expected a text with one, such as '0.5 m'"),
            ('length = "0.5"', "cell.toml:1: component 'c': parameter 'length': 0.5 has no unit"),
            (
                'mode = 1\nlength = "-2 1"',
                "cell.toml:2: component 'c': parameter 'length': '-2 1' is not a number with a unit, such as '4 m'",
            ),
            ("length = 0.5\n[x]", "cell.toml:2: component 'c': unknown parameter 'x'"),
            ('gap = [\n "1 urad",\n 2]', "cell.toml:3: component 'c': parameter 'gap[2]': 2 has no unit"),
            (
                'gap = {value = ["1 urad", 2], unit = "urad"}',
                "cell.toml:1: component 'c': parameter 'gap[1]': expected {value = <number>, unit = <text>}",
            ),
            ("gap = [1, 2, 3]", "cell.toml:1: component 'c': parameter 'gap' has shape [2]; found values of shape [3]"),
            ('gap = ["1 urad", 0]\n"gap[1]" = 0', "cell.toml:2: component 'c': parameter 'gap[1]' is given twice"),
            ("length = inf", "cell.toml:1: component 'c': parameter 'length': expected a finite number in 'm'; found inf"),
            ('length = "1e999 mm"', "cell.toml:1: component 'c': parameter 'length': expected a finite number in 'm'; found"),
            (
                f"length = 1{400 * '0'}",
                "cell.toml:1: component 'c': parameter 'length': expected a finite number in 'm'; found one that is too large",
            ),
            (f"mode = 1{400 * '0'}", "cell.toml:1: component 'c': parameter 'mode': expected a finite number"),
            ("mode = true", "cell.toml:1: component 'c': parameter 'mode': expected a number in '1'; found True"),
            ('mode = "-2 1"', "cell.toml:1: component 'c': parameter 'mode': '-2 1' is not a number, such as '4'"),
            ('length = ""', "cell.toml:1: component 'c': parameter 'length': '' is not a number with a unit"),
            ('length = "1,5 mm"', "cell.toml:1: component 'c': parameter 'length': '1,5 mm' is not a number with a unit"),
        ],
    )
    def test_refused(self, tmp_path, text, message):
        with pytest.raises(PlacedError) as caught:
            self.prepared(tmp_path, text)
        assert f"{caught.value.place}: {caught.value}".startswith(message)


def test_merging_keeps_the_place_of_each_value_and_what_code_sets_needs_no_unit():
    old = Written(
        {"gap": ["1 urad", 2.0], "length": 0.5, "K[1,1]": 1}, {("gap",): "a:1", ("gap", 1): "a:2", ("length",): "a:3", ("K[1,1]",): "a:4"}
    )
    both = merged(old, Written({"gap[1]": 3e-6, "K": [[1, 2, 3], [4, 5, 6]]}))
    assert both == {"gap[1]": 3e-6, "gap[2]": 2.0, "length": 0.5, "K": [[1, 2, 3], [4, 5, 6]]}
    assert [place_of(both, k) for k in ("gap[1]", "gap[2]", "length", "K")] == [None, "a:2", "a:3", None]
    assert old == {"gap": ["1 urad", 2.0], "length": 0.5, "K[1,1]": 1}, "what is merged stays as it is"
    with pytest.raises(OrchestrationError, match=r"an element of 'length' with 1 index is set, but length is given as 0.5"):
        merged(old, {"length[1]": 1.0})
