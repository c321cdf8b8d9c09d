"""Parity: Python FMU = compiled in process = plain Python, bit for bit, with the inputs of the golden results."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from robomill.conformance import Fmu, Instance
from robomill.fmus.components import COMPONENTS, NAMES
from robomill.fmus.interface import Interface
from tests.fmus import golden


@pytest.mark.parametrize("name", NAMES)
def test_python_fmu_equals_compiled_equals_plain(
    built: Callable[[str], Path], name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model, folder = COMPONENTS[name], golden.FOLDER / name
    interface = Interface(model)
    rows, parameters = golden.read(folder / "in.csv", interface.inputs), golden.parameters(folder)
    plain = golden.run(model, rows, parameters, plain=True)
    compiled = golden.run(model, rows, parameters, plain=False)
    monkeypatch.chdir(tmp_path)
    instance = Instance(Fmu(built(name)))
    trajectory = np.array(instance.run())
    instance.free()
    for face, found in (("compiled", compiled), ("Python FMU", trajectory)):
        assert not golden.first_difference(folder / "in.csv", interface.outputs, plain, found), face
