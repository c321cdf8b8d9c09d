"""A component in process as addresses: the compiled master calls its step without passing through Python.

The structures are those that `orchestration.slaves.native` describes; nothing is imported from there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from robomill.fmus.instance import ComponentError, Instance
from robomill.fmus.interface import Port
from robomill.models.model.model_code import model_code

RAISED = -1
"""Status for an exception inside compiled code: an index out of bounds."""


@dataclass(frozen=True)
class Block:
    """Inputs or outputs of one type; they stand in the record, so there is no function to call."""

    kind: str
    buffer: int
    places: tuple[int, ...]
    function: int = 0
    references: int = 0


class Addresses:
    """Where the record of an instance and its step function stand. Every status but 0 is an error."""

    limit, final = 0, 1

    def __init__(self, instance: Instance) -> None:
        self._instance = instance
        self._code = model_code(instance.model)  # kept: its code goes with it
        self.instance: int = instance.data.ctypes.data
        self.step: int = self._code.step_address
        self.inputs = _blocks(instance.interface.inputs, self.instance)
        self.outputs = _blocks(instance.interface.outputs, self.instance)

    def failed(self, what: str, block: int, status: int, t: float, h: float) -> ComponentError:
        """The error for a status of the step from `t` of `h` [s], worded as `Instance.step` words it."""
        if status == RAISED:
            name = self._instance.name
            return ComponentError(f"{name}: exception in the step from t = {t:.9g} s: an index out of bounds; loop = 'python' says more")
        return ComponentError(self._instance.status_text(status, t, h))


class Rollback:
    """The words of a record that steps change, and as much memory for a copy of them: no functions are needed, none can fail."""

    get = set = limit = 0

    def __init__(self, instance: Instance) -> None:
        self._words = instance.data.view(np.uint8)[: instance.interface.tables_at]
        self._copy = self._words.copy()
        self.instance: int = self._words.ctypes.data
        self.kept: int = self._copy.ctypes.data
        self.size = self._words.nbytes

    def save(self) -> None:
        """Copy the state."""
        self._copy[:] = self._words

    def back(self) -> None:
        """Go back to the copy."""
        self._words[:] = self._copy


def _blocks(ports: Sequence[Port], record: int) -> list[Block]:
    """Runs of ports of one type that stand next to each other in the record, as long as possible."""
    found: list[list[Any]] = []
    for i, p in enumerate(ports):
        kind = "float64" if p.type == "real" else "int64"
        if found and found[-1][0] == kind and found[-1][3] == p.reference:
            found[-1][2].append(i)
            found[-1][3] += 1
        else:
            found.append([kind, record + p.offset, [i], p.reference + 1])
    return [Block(kind, buffer, tuple(places)) for kind, buffer, places, _ in found]
