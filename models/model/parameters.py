"""Parameters are cited data: frozen dataclasses loaded from TOML, in SI, checked on loading.

A parameter file has one table per field::

    [stiffness]
    value = 5.4e9
    unit = "N.mm/rad"
    source = "Haehn & Weigold 2020, Table 1"
    validity = "quasi-static, up to 750 N at the tool tip"
"""

from __future__ import annotations

import tomllib
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from robomill.models.model.units import compatible, fitting, unit_of

DATA = Path(__file__).parents[1] / "data"
_KEYS = {"value", "unit", "source", "validity"}
Parameters = TypeVar("Parameters")
_SHIPPED: dict[tuple[type[Any], Path, int, int], Any] = {}
"""Contents of the files of this project, which do not change: a component starts with some that its system names, too."""


def quantity(unit: str, minimum: float | None = None, maximum: float | None = None) -> dict[str, Any]:
    """Metadata of a dataclass field: its SI unit and bounds; use as `field(metadata=quantity("m", 0.0))`."""
    return {"unit": unit, "minimum": minimum, "maximum": maximum}


def load(cls: type[Parameters], path: str | Path) -> Parameters:
    """Load a parameter file into the frozen dataclass `cls`, converted to SI.

    `path` is a file, or a name below ``models/data`` without suffix (``robots/kr300_r2500_ultra``).
    A field with a default may be missing. Numbers become float, lists become read-only float arrays, strings stay.
    Errors (ValueError, FileNotFoundError) name file, field, what was found, what is expected.
    """
    file = Path(path)
    if file.suffix != ".toml":
        file = DATA / f"{path}.toml"
    if not file.is_file():
        available = ", ".join(sorted(str(f.relative_to(DATA).with_suffix("")) for f in DATA.rglob("*.toml")))
        raise FileNotFoundError(f"no parameter file {file}; available: {available}")
    if DATA not in file.parents:
        return _read(cls, file)
    status = file.stat()
    key = (cls, file, status.st_mtime_ns, status.st_size)
    if key not in _SHIPPED:
        _SHIPPED[key] = _read(cls, file)
    return _SHIPPED[key]  # type: ignore[no-any-return]  # what `cls` made


def _read(cls: type[Parameters], file: Path) -> Parameters:
    try:
        table = tomllib.loads(file.read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{file.name}: not valid TOML: {error}") from None
    wanted = {f.name: f for f in fields(cls)}  # type: ignore[arg-type]  # cls is a dataclass by contract
    needed = {name for name, f in wanted.items() if f.default is MISSING and f.default_factory is MISSING}
    unknown, missing = sorted(set(table) - set(wanted)), sorted(needed - set(table))
    if unknown or missing:
        raise ValueError(f"{file.name}: unknown fields {unknown}, missing fields {missing}; {cls.__name__} has {', '.join(sorted(wanted))}")
    values = {name: _value(f"{file.name}: {name}", table[name], dict(f.metadata)) for name, f in wanted.items() if name in table}
    return cls(**values)


def _value(where: str, entry: Any, expected: dict[str, Any]) -> Any:
    if not isinstance(entry, dict) or set(entry) != _KEYS:
        got = sorted(entry) if isinstance(entry, dict) else entry
        raise ValueError(f"{where}: expected a table with {', '.join(sorted(_KEYS))}; found {got}")
    if not entry["source"]:
        raise ValueError(f"{where}: the source is missing; every parameter is cited")
    value, unit = entry["value"], entry["unit"]
    if isinstance(value, str):
        if "unit" in expected:
            raise ValueError(f"{where}: {value!r} is text, expected a number in {expected['unit']!r} or a compatible unit")
        return value
    want = expected.get("unit", "1")
    if not compatible(unit, want):
        raise ValueError(f"{where}: unit {unit!r} does not measure {want!r}; units that fit: {', '.join(fitting(want))}")
    array = np.asarray(value, dtype=np.float64) * unit_of(unit).factor + unit_of(unit).offset
    if not np.all(np.isfinite(array)):
        raise ValueError(f"{where}: {value} is not finite")
    low, high = expected.get("minimum"), expected.get("maximum")
    if (low is not None and np.any(array < low)) or (high is not None and np.any(array > high)):
        raise ValueError(f"{where}: {value} {unit} is outside [{low}, {high}] {want}")
    if array.ndim == 0:
        return float(array)
    array.flags.writeable = False
    return array
