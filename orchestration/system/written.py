"""Values that a person wrote into a file: they carry the place where they stand, and need units.

What code sets are plain numbers in the unit of the port; what a person writes says its unit, or it is refused with its place.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from robomill.orchestration.errors import OrchestrationError

Key = tuple[str | int, ...]
"""(name,) of a value, (name, 0, 2) of an element of it."""


class Written(Mapping[str, Any]):
    """Values by name, some of them (those that have a place) written by a person; equal to a dict of the same values."""

    def __init__(self, values: Mapping[str, Any], places: Mapping[Key, str] | None = None) -> None:
        self._values = dict(values)
        self.places = dict(places or {})
        """Where values and elements stand: `file.toml:12`."""

    def __getitem__(self, name: str) -> Any:
        return self._values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __repr__(self) -> str:
        return repr(self._values)


def place_of(values: Mapping[str, Any], *key: str | int) -> str | None:
    """Where a value, or an element of it, was written; None if code set it."""
    if not isinstance(values, Written):
        return None
    return next((values.places[key[:n]] for n in range(len(key), 0, -1) if key[:n] in values.places), None)


def merged(old: Mapping[str, Any], new: Mapping[str, Any]) -> Written:
    """The values of both, those of `new` in place of those of `old`; each keeps where it was written.

    An element (`lag[2]`) replaces that of an array which is given as a whole, and the other way round.
    """
    values, places = dict(old), dict(old.places) if isinstance(old, Written) else {}

    def drop(name: str) -> None:
        values.pop(name, None)
        for key in [k for k in places if k[0] == name]:
            del places[key]

    for name, value in new.items():
        base, _, index = name.partition("[")
        if index and base in values:
            whole, depth = values[base], index.count(",") + 1
            where = {k: place_of(old, *k) for k in _indices(base, whole, depth)}
            drop(base)
            for key, place in where.items():
                element = f"{base}[{','.join(str(int(i) + 1) for i in key[1:])}]"
                values[element] = _element(whole, key[1:])
                if place is not None:
                    places[(element,)] = place
        for other in [name] if index else [k for k in values if k.partition("[")[0] == name]:
            drop(other)
        values[name] = value
        if isinstance(new, Written):
            places |= {k: p for k, p in new.places.items() if k[0] == name}
    return Written(values, places)


def _indices(name: str, whole: Any, depth: int) -> list[Key]:
    listed = whole["value"] if isinstance(whole, Mapping) and "value" in whole else whole
    shape = np.asarray(listed, dtype=object).shape if isinstance(listed, list | tuple | np.ndarray) else ()
    if len(shape) != depth:
        raise OrchestrationError(
            f"an element of {name!r} with {depth} {'index' if depth == 1 else 'indices'} is set, but {name} is given as {whole!r}"
            "; set the whole array"
        )
    return [(name, *index) for index in np.ndindex(*shape)]


def _element(whole: Any, index: Key) -> Any:
    if isinstance(whole, Mapping):
        return {**whole, "value": _element(whole["value"], index)}
    for i in index:
        whole = whole[i]
    return whole
