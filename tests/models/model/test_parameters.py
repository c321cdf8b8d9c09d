"""What parameter files may and may not hold."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from robomill.models.model.declaration import FloatArray
from robomill.models.model.parameters import DATA, load, quantity
from robomill.models.model.units import unit_of
from robomill.models.robot.kinematics import Robot
from tests.tolerances import ROUNDOFF


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
            ('unit = "mm"', 'unit = "kg"', r"spring\.toml: length: unit 'kg' does not measure 'm'; units that fit: mm, m, "),
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
            assert unit_of(entry["unit"]), name


def test_a_file_that_comes_with_robomill_is_read_once_and_one_of_a_user_each_time(tmp_path: Path) -> None:
    shipped = DATA / "robots" / "kr210_2.toml"
    own = tmp_path / "own.toml"
    own.write_text(shipped.read_text(encoding="utf-8"), encoding="utf-8")
    assert load(Robot, shipped) is load(Robot, "robots/kr210_2")
    assert load(Robot, own) is not load(Robot, own)
