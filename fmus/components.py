"""The components of this project by name. Their modules are imported when asked for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib import import_module
from importlib.util import find_spec

from robomill.models.model.declaration import Model

PACKAGE = "robomill.models.components"
NAMES = (
    "path_interpolator",
    "robot_drive",
    "robot_compliance",
    "milling_force",
    "sensor_chain",
    "compensation_controller",
    "inverse_dynamics",
)
"""In the order of the signal flow, then what stands beside it; each is `MODEL` in `models/components/<name>.py`."""


class _Components(Mapping[str, Model]):
    """Component name -> its model."""

    def __getitem__(self, name: str) -> Model:
        if name not in NAMES or find_spec(f"{PACKAGE}.{name}") is None:
            raise KeyError(f"unknown component {name!r}; available: {', '.join(self)}")
        model: Model = import_module(f"{PACKAGE}.{name}").MODEL
        return model

    def __iter__(self) -> Iterator[str]:
        return (name for name in NAMES if find_spec(f"{PACKAGE}.{name}") is not None)

    def __len__(self) -> int:
        return sum(1 for _ in self)


COMPONENTS: Mapping[str, Model] = _Components()


def component(name: str) -> Model:
    """The model of a component; ValueError lists the available ones. Recordings: see `models.components.recording`."""
    try:
        return COMPONENTS[name]
    except KeyError as error:
        raise ValueError(error.args[0]) from None
