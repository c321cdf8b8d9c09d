"""Logs as text: a row of names, maybe a row of units, rows of values."""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from robomill.logs.log import FloatArray, Log, LogError, no_doubles

_TRUTH = {"true": 1.0, "false": 0.0}
_BRACKETS = re.compile(r"\[([^][]*)\]|\(([^()]*)\)")


@dataclass(frozen=True)
class CsvForm:
    """How a text is to be read; the keys of `[log]`."""

    delimiter: str = ","
    decimal: str = "."
    skip_rows: int = 0
    unit_row: bool = False
    encoding: str = "utf-8-sig"


def read_csv(file: Path, form: CsvForm = CsvForm()) -> Log:
    """Columns by the names of the first row. LogError says row, column and what stands there."""
    try:
        with file.open(newline="", encoding=form.encoding) as stream:
            reader = csv.reader(stream, delimiter=form.delimiter, skipinitialspace=form.delimiter == " ")
            numbered = [(number, row) for number, row in enumerate(reader, 1) if number > form.skip_rows and row]
    except (csv.Error, UnicodeDecodeError) as error:
        said = "UTF-8; set log.encoding, such as cp1252" if form.encoding == CsvForm.encoding else form.encoding
        raise LogError(f"{file}: not a CSV file in {said}: {error}; say its encoding in [log]") from None
    except LookupError:
        raise LogError(f"{file}: unknown log.encoding {form.encoding!r}; expected utf-8, utf-16, cp1252, latin-1, ...") from None
    above = 1 + form.unit_row
    if len(numbered) <= above:
        wanted = "a row of names, one of units" if form.unit_row else "a row of names"
        raise LogError(f"{file}: expected {wanted} and rows of numbers after {form.skip_rows} skipped rows; found {len(numbered)} rows")
    names = tuple(n.strip() for n in numbered[0][1])
    if len(names) == 1 and (other := re.search(r"[;,\t]", names[0])):
        raise LogError(f"{file}: the row of names is one field, {names[0]!r}; is log.delimiter {other[0]!r} instead of {form.delimiter!r}?")
    no_doubles(file, names)
    for number, row in numbered[1:]:
        if len(row) != len(names):
            raise LogError(
                f"{file}: row {number} has {len(row)} fields, the row of names has {len(names)}; is the delimiter {form.delimiter!r}, "
                f"and are the names in the row after log.skip_rows = {form.skip_rows}?"
            )
    units = {n: u for n, cell in zip(names, numbered[1][1], strict=True) if (u := _unit(cell))} if form.unit_row else {}
    body = numbered[above:]

    def texts(name: str) -> npt.NDArray[np.str_]:
        column = names.index(name)
        return np.array([row[column].strip() for _, row in body])

    def fetch(name: str) -> FloatArray:
        values = np.empty(len(body))
        for k, text in enumerate(texts(name).tolist()):
            try:
                values[k] = _number(text, form.decimal)
            except ValueError as error:
                hint = "" if form.unit_row else ", or is there a row of units (log.unit_row = true)"
                raise LogError(
                    f"{file}: row {body[k][0]}, column {name!r}: {text!r} is no number{error}; is the decimal sign {form.decimal!r}{hint}?"
                ) from None
        return values

    return Log(file, names, fetch, units, texts=texts)


def _unit(cell: str) -> str:
    """A cell of a row of units, without the brackets that many write around it."""
    match = _BRACKETS.fullmatch(cell.strip())
    return ((match[1] or match[2] or "") if match else cell).strip()


def _number(text: str, decimal: str) -> float:
    """The number that a cell holds; nan of an empty one. The text of a ValueError says what else is known."""
    if not text:
        return np.nan
    if decimal != ".":
        if "." in text:
            raise ValueError(": it has a point")
        text = text.replace(decimal, ".")
    if text.lower() in _TRUTH:
        return _TRUTH[text.lower()]
    try:
        return float(text)
    except ValueError:
        raise ValueError from None
