"""Specification of logs as text: rows of units, decimal commas, other encodings, and what is refused with row and column."""

from __future__ import annotations

from pathlib import Path

import pytest

from robomill.logs.csv_text import CsvForm, read_csv
from robomill.logs.log import LogError
from tests.robomill.logs.foreign import CLOCK, MAP, bring, refused

GERMAN = "Anlage 3\n\ntime;fx;v;on;phase;\nms;[kN];(\u00b0/s);-;;\n0;0,5;1,0;true;Start;\n10;-,5;2,0;FALSE;cut;\n20;1e-1;3,0;1;cut;\n"
FORM = CsvForm(delimiter=";", decimal=",", skip_rows=2, unit_row=True, encoding="cp1252")
LOG = '[log]\ndelimiter = ";"\ndecimal = ","\nskip_rows = 2\nunit_row = true\nencoding = "cp1252"\n'


def written(folder: Path, text: str, encoding: str = "utf-8") -> Path:
    (folder / "log.csv").write_text(text, encoding=encoding)
    return folder / "log.csv"


def test_a_row_of_units_commas_and_an_old_encoding(tmp_path: Path) -> None:
    log = read_csv(written(tmp_path, GERMAN, "cp1252"), FORM)
    assert log.units == {"time": "ms", "fx": "kN", "v": "\u00b0/s", "on": "-"}
    assert log["fx"].tolist() == [0.5, -0.5, 0.1]
    assert log["on"].tolist() == [1.0, 0.0, 1.0]
    assert log.states("phase").tolist() == ["Start", "cut", "cut"]


def test_units_of_the_row_are_those_of_the_signals(tmp_path: Path) -> None:
    log = written(tmp_path, GERMAN, "cp1252")
    clock = CLOCK.replace('"s"', '"ms"')
    run = bring(tmp_path, LOG + clock + '[[signal]]\nport = "a.f"\ncolumn = "fx"\n[[signal]]\nport = "a.v"\ncolumn = "v"\n', log)
    assert run["a.f"].tolist() == [500.0, -500.0, 100.0]
    assert (run.unit("a.f"), run.unit("a.v")) == ("N", "rad/s")


def test_a_unit_other_than_that_of_the_row_is_refused(tmp_path: Path) -> None:
    log = written(tmp_path, GERMAN, "cp1252")
    signal = '[[signal]]\nport = "a.f"\ncolumn = "fx"\nunit = "N"\n'
    assert "wrong unit: the mapping says 'N', the log states 'kN'" in refused(tmp_path, LOG + CLOCK + signal, log)


def test_blanks_and_tabulators_part_columns(tmp_path: Path) -> None:
    assert read_csv(written(tmp_path, "t   x\n0   1\n1     2\n"), CsvForm(delimiter=" "))["x"].tolist() == [1.0, 2.0]
    assert read_csv(written(tmp_path, "t\tx\n0\t1\n1\t2\n"), CsvForm(delimiter="\t"))["x"].tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("text", "form", "expected"),
    [
        (
            "t,x\ns,mm\n0,1\n",
            CsvForm(),
            r"row 2, column 'x': 'mm' is no number; is the decimal sign '\.', or is there a row of units \(log\.unit_row",
        ),
        ("t;x\n0;1\n", CsvForm(), r"the row of names is one field, 't;x'; is log\.delimiter ';' instead of ','\?"),
        ("t;x\n0;1.234\n1;5,5\n", CsvForm(";", ","), r"row 2, column 'x': '1\.234' is no number: it has a point; is the decimal sign ','"),
        ("t;x\n0;1,5\n", CsvForm(";"), r"row 2, column 'x': '1,5' is no number; is the decimal sign '\.'"),
        (
            "t,x\ns,mm\n",
            CsvForm(unit_row=True),
            "expected a row of names, one of units and rows of numbers after 0 skipped rows; found 2 rows",
        ),
        ("t,\u00b0\n0,1\n", CsvForm(), "not a CSV file in UTF-8; set log.encoding, such as cp1252"),
        ("t,x\n0,1\n", CsvForm(encoding="klingon"), r"unknown log\.encoding 'klingon'; expected utf-8, utf-16, cp1252"),
    ],
)
def test_what_cannot_be_read_says_row_column_and_key(tmp_path: Path, text: str, form: CsvForm, expected: str) -> None:
    with pytest.raises(LogError, match=expected):
        read_csv(written(tmp_path, text, "cp1252"), form)["x"]


def test_delimiter_and_decimal_sign_differ(tmp_path: Path) -> None:
    assert "[log]: delimiter and decimal are both ','" in refused(tmp_path, '[log]\ndecimal = ","\n' + MAP)
