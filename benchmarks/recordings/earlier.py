"""What the first edition answered on the same recordings: first_edition.toml, beside this file."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

FILE = Path(__file__).with_name("first_edition.toml")


@dataclass(frozen=True)
class Earlier:
    """Figures of the first edition on one recording [SI]."""

    study: str
    """What it was, in words."""
    commit: str
    """Where it is: the last commit that has it."""
    effects: Mapping[str, tuple[float, float, float]]
    """`effect @ location` that it adopted -> value, least and largest of its 90 % interval."""
    after: Mapping[str, float]
    """Channel -> rms that it left in the held-out runs."""


def earlier(name: str) -> Earlier | None:
    """What the first edition answered on a recording; None where it did not look at it."""
    with FILE.open("rb") as file:
        found = tomllib.load(file).get(name)
    if found is None:
        return None
    effects = {effect: (float(v), float(low), float(high)) for effect, (v, low, high) in found["effects"].items()}
    return Earlier(found["study"], found["commit"], effects, found["after"])
