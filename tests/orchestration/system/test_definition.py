"""System files: what is read, and the one clear error for each thing that is not allowed."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import pytest

from robomill.cli import main
from robomill.orchestration.assembly import run
from robomill.orchestration.errors import SystemFileError
from robomill.orchestration.system.definition import Connection, Recording, System
from robomill.orchestration.system.entries import Entry
from robomill.orchestration.system.parameters import same_unit_only
from robomill.orchestration.system.toml_lines import key_lines
from robomill.orchestration.system.toml_text import dump
from tests.orchestration.mocks import gain
from tests.tolerances import EXACT

GOOD = """\
name = "groove"
step = "4 ms"
stop = "2 s"
algorithm = "jacobi"

[labels]
robot = "KR 300"
repeat = 1

[components.drive]
source = "robot_drive"
parameters = {backlash = "20 urad", "stiffness[2]" = 0.9}

[components.compliance]
source = "dist/compliance.fmu"
[components.compliance.parameters]
scale = [1, 2, 3]

[[connections]]
from = "drive.q"
to = "compliance.q"

[[connections]]
from = "compliance.d"
to = "drive.d"
delayed = true

[recording]
columns = ["drive", "compliance.d[1]"]
every = 2
"""


HARD = """\
a = 1
b.c = "x # = ["
"d e".'f' = [1, [2, # c ]
  3], "]", \'\'\'m
 = x\'\'\'\'
]
g = {h = {i = 1, j = [1,2]}, "k" = 'x'}
[[p]]
x = 1979-05-27 07:32:00
[p.q]
y = true
[[p.r]]
z = 1
[[p.r]]
z = 2
[[p]]
[[p.r]]
z = 3
[ l . "m" ]
n = \'\'\'
a
\'\'\'
o = 2
"""


def keys(value, key=()):
    """All keys and indices of parsed TOML."""
    if key:
        yield key
    for k, v in value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ():
        yield from keys(v, (*key, k))


def convert(value, unit, wanted):
    if not unit:
        return same_unit_only(value, unit, wanted)
    factors = {("ms", "s"): 1e-3, ("urad", "rad"): 1e-6, ("mm", "m"): 1e-3}
    if (unit, wanted) not in factors:
        raise ValueError(f"unit {unit!r} does not measure {wanted!r}")
    return value * factors[unit, wanted]


def load(tmp_path, text):
    file = tmp_path / "system.toml"
    file.write_text(text)
    return System.load(file, convert)


def test_a_system_file(tmp_path):
    s = load(tmp_path, GOOD)
    assert (s.name, s.algorithm, s.stop, s.require_connected, s.check_ranges) == ("groove", "jacobi", 2.0, False, True)
    assert abs(s.step - 0.004) <= EXACT
    assert [c.name for c in s.components] == ["drive", "compliance"]
    assert dict(s.component("drive").parameters) == {"backlash": "20 urad", "stiffness[2]": 0.9}
    assert dict(s.component("compliance").parameters) == {"scale": [1, 2, 3]}
    assert s.connections == (Connection("drive.q", "compliance.q", False, 19), Connection("compliance.d", "drive.d", True, 23))
    assert s.recording == Recording(("drive", "compliance.d[1]"), every=2)
    assert dict(s.labels) == {"robot": "KR 300", "repeat": 1}
    assert s.folder == tmp_path


def test_a_component_is_exchanged_by_one_line(tmp_path):
    s = load(tmp_path, GOOD)
    other = load(tmp_path, GOOD.replace('source = "robot_drive"', 'source = "replay:runs/1"'))
    assert s.with_source("drive", "replay:runs/1") == other


def test_parameters_are_exchanged(tmp_path):
    s = load(tmp_path, GOOD).with_parameters("drive", {"backlash": 0.0})
    assert dict(s.component("drive").parameters) == {"backlash": 0.0, "stiffness[2]": 0.9}


ERRORS = [
    (
        "name =",
        "nam =",
        "system.toml:1: nam: unknown key 'nam'; did you mean 'name'? available: algorithm, check_ranges, components,",
    ),
    ('name = "groove"\n', "", "system.toml: missing: name; known keys: algorithm, check_ranges, components, connections, description,"),
    ('"4 ms"', '"4 mm"', "system.toml:2: step: unit 'mm' does not measure 's'"),
    ('"4 ms"', '"soon"', "system.toml:2: step: 'soon' is not a number with a unit, such as '4 s'"),
    ('"4 ms"', "true", "system.toml:2: step: True is neither a number nor a text with a unit; expected a quantity in s"),
    ('"4 ms"', '"-1 s"', "system.toml: step = -1.0 s is not a positive whole number of nanoseconds"),
    (
        '"jacobi"',
        '"jakobi"',
        "system.toml:4: algorithm: unknown algorithm 'jakobi'; did you mean 'jacobi'? available: jacobi, gauss-seidel",
    ),
    (
        'source = "robot_drive"',
        "sauce = 1",
        "system.toml:11: [components] drive.sauce: unknown key 'sauce'; did you mean 'source'? available: correction, every, inputs, isolate,",  # noqa: E501
    ),
    ('source = "robot_drive"\n', "", "system.toml:10: [components] drive: missing: source; known keys: correction, every, inputs,"),
    (
        "[components.drive]",
        "[components.1drive]",
        "system.toml:10: [components] 1drive: the name of a component: letters, digits and underscores only, no digit first",
    ),
    ("delayed = true", 'delayed = "yes"', "system.toml:26: connections 2: delayed: expected true or false; found 'yes'"),
    (
        "delayed = true",
        "delay = true",
        "system.toml:26: connections 2: delay: unknown key 'delay'; did you mean 'delayed'? available: delayed, from, to",
    ),
    ('to = "drive.d"', 'to = "drive"', "system.toml:25: connections 2: to: expected component.port; found 'drive'"),
    ('to = "drive.d"\n', "", "system.toml:23: connections 2: missing: to; known keys: delayed, from, to"),
    ("every = 2", "every = 0", "system.toml:28: [recording]: the recording's every and chunk: expected 1 or more, found 0 and 250"),
    (
        "every = 2",
        "rows = 2",
        "system.toml:30: [recording] rows: unknown key 'rows'; available: checkpoint_every, chunk, columns, csv, every",
    ),
    ('["drive", "compliance.d[1]"]', "[1]", "system.toml:29: [recording] columns.0: expected a text; found 1"),
    ("[labels]", "[labels", "system.toml: not valid TOML: "),
]


@pytest.mark.parametrize(("old", "new", "text"), ERRORS)
def test_errors(tmp_path, old, new, text):
    assert old in GOOD
    with pytest.raises(SystemFileError) as caught:
        load(tmp_path, GOOD.replace(old, new, 1))
    assert str(caught.value).startswith(text)


def test_no_such_file(tmp_path):
    (tmp_path / "other.toml").write_text("")
    with pytest.raises(SystemFileError, match=r"no system file .*x.toml; TOML files in that folder: other.toml"):
        System.load(tmp_path / "x.toml")


def test_no_components(tmp_path):
    with pytest.raises(SystemFileError, match="the system has no components"):
        load(tmp_path, 'name = "x"\nstep = "1 s"\n[components]\n')


def test_unknown_component(tmp_path):
    with pytest.raises(SystemFileError, match="unknown component 'drove'; did you mean 'drive'"):
        load(tmp_path, GOOD).with_source("drove", "x")


class TestTomlText:
    """Reading line numbers, writing."""

    @pytest.mark.parametrize(
        ("path", "line"),
        [
            (("step",), 2),
            (("components", "drive", "source"), 11),
            (("components", "drive", "parameters", "backlash"), 12),
            (("components", "compliance", "parameters", "scale"), 17),
            (("connections", 1, "to"), 25),
            (("connections", 1, "nothing"), 23),
            (("nothing",), None),
        ],
    )
    def test_a_key_is_found_or_the_table_above_it(self, tmp_path, path, line):
        (tmp_path / "x.toml").write_text(GOOD)
        assert replace(Entry.load(tmp_path / "x.toml", ValueError), key=path).line == line

    def test_every_key_of_every_shipped_file_has_its_line(self):
        """Against the parser: the same keys and elements; and on the line that is said, a table is opened or the key is written."""
        files = [f for folder in ("scenarios", "models", "docs", "data") for f in sorted(Path(folder).rglob("*.toml"))]
        assert len(files) > 30
        for text in (*(f.read_text(encoding="utf-8") for f in files), HARD):
            lines = key_lines(text)
            assert set(lines) == set(keys(tomllib.loads(text)))
            for key, line in lines.items():
                if isinstance(key[-1], str) and text is not HARD:
                    assert key[-1] in text.splitlines()[line - 1]

    def test_lines_of_what_is_hard_to_read(self):
        lines = key_lines(HARD)
        assert [
            lines[k] for k in (("d e", "f", 1, 1), ("g", "h", "j", 1), ("p", 0, "r", 1, "z"), ("p", 1, "r", 0, "z"), ("l", "m", "o"))
        ] == [*(4, 7, 15, 18, 23)]

    def test_a_key_that_is_there_twice_is_refused_with_its_line(self, tmp_path):
        with pytest.raises(SystemFileError, match=r"system.toml: not valid TOML: Cannot overwrite a value \(at line 2, column"):
            load(tmp_path, GOOD.replace('step = "4 ms"', 'name = "x"', 1))

    def test_what_is_written_is_read_back(self):
        table = {
            "text": 'quo"te \\ \n tab\t \x7f é',
            "numbers": [1, -2.5, 1e-300, 0.1 + 0.2],
            "yes": True,
            "nested": {"a b": {"deep": 1}, "x[1,2]": {"v": 2.0}, "empty": {}},
            "tables": [{"a": 1}, {"b": "c"}],
        }
        assert tomllib.loads(dump(table)) == table

    @pytest.mark.parametrize("deep", ["a = " + "[" * 5000 + "]" * 5000, "a = " + "{a = " * 5000 + "1" + "}" * 5000, f"[{'a.' * 5000}a]"])
    def test_nested_too_deep_is_one_error(self, tmp_path, deep, capsys):
        """Read by recursion, or (headers) turned into texts by recursion later."""
        (tmp_path / "s.toml").write_text(deep)
        with pytest.raises(SystemFileError, match=r"^s.toml: not valid TOML: tables and arrays are nested more than 50 deep$"):
            System.load(tmp_path / "s.toml")
        assert main(["run", str(tmp_path / "s.toml")]) == 2
        assert "s.toml: not valid TOML: tables and arrays are nested more than 50 deep" in capsys.readouterr().err

    def test_what_the_parser_itself_cannot_read_is_refused_with_the_file(self, tmp_path):
        """An integer of thousands of digits; bytes that are no UTF-8."""
        for content, text in ((b"a = " + b"9" * 5000, "Exceeds the limit"), (b"a = '\xff'", "not UTF-8: ")):
            (tmp_path / "s.toml").write_bytes(content)
            with pytest.raises(SystemFileError, match=f"^s.toml: not valid TOML: {text}"):
                System.load(tmp_path / "s.toml")

    def test_none_is_left_out_and_other_things_are_refused(self):
        assert dump({"a": None, "b": 1}) == "b = 1\n"
        with pytest.raises(TypeError, match="object cannot be written as TOML"):
            dump({"a": object()})


class TestInputs:
    """Start values of inputs."""

    def load(self, tmp_path, inputs):
        (tmp_path / "s.toml").write_text(
            f'name = "s"\nstep = "0.1 s"\nstop = "0.3 s"\n[components.g]\nsource = "mock"\ninputs = {inputs}\n'
        )
        return System.load(tmp_path / "s.toml")

    def test_open_inputs_keep_them(self, tmp_path):
        made = self.load(tmp_path, '{u = "2500 mm"}')
        result = run(made, tmp_path / "r", resolver=lambda source, name: gain(name, 2.0), convert=lambda v, u, w: v / 1000)
        assert result["g.y"].tolist() == [5.0, 5.0, 5.0, 5.0]
        assert result.info["inputs"] == {"g": {"u": 2.5}}
        assert result.info["warnings"] == ["input g.u is not connected: it keeps its start value 2.5"]

    def test_refused(self, tmp_path):
        for inputs, text in (
            ("{v = 1}", r"s.toml:6: component 'g': unknown input 'v'.*available: u"),
            ("{y = 1}", "'y' is an output, not an input"),
        ):
            with pytest.raises(SystemFileError, match=text):
                run(self.load(tmp_path, inputs), resolver=lambda source, name: gain(name))
