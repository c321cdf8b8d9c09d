"""Runs that native FMUs are compared in: inputs, variants, and the ways to drive an FMU."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any, Protocol

import fmpy
import numpy as np
from fmpy.fmi3 import FMU3Slave, fmi3LogMessageCallback

from robomill.fmus.interface import Interface, Port
from robomill.models.model.declaration import FloatArray, Model
from tests.fmus import demo, golden

H = golden.H
VARIANTS = ("golden", "effects", "default")
ON_LINUX = sys.platform == "linux"


class Slave(Protocol):
    """What this file needs of the master's slave protocol."""

    def configure(self, parameters: dict[str, Any]) -> None: ...
    def initialise(self, start: float, stop: float, step: float) -> None: ...
    def set_inputs(self, values: FloatArray) -> None: ...
    def step(self, t: float, h: float) -> None: ...
    def get_outputs(self, out: FloatArray) -> None: ...
    def close(self) -> None: ...


def inputs(name: str, interface: Interface) -> FloatArray:
    """300 rows: those of the golden result, back again, and once more; of the demo model, swings."""
    if name == "demo":
        t = np.arange(300) * H
        columns = [0.4 * np.sin(5 * t), 0.3 * np.cos(7 * t), np.floor(3 * t) % 2, 50 * t, np.floor(5 * t)]
        return np.column_stack(columns)
    rows = golden.read(golden.FOLDER / name / "in.csv", interface.inputs)
    return np.vstack([rows, rows[::-1], rows])


def parameters(name: str, variant: str, model: Model) -> dict[str, Any]:
    """Parameters by element: none, those of the golden result, or these and every effect at a tenth of its bound."""
    if variant == "default":
        return {}
    folder = golden.FOLDER / name
    values: dict[str, Any] = {"stiffness[1,1]": 321.0} if name == "demo" else golden.parameters(folder)
    if variant == "effects":
        for v in model.variables:
            if v.effect:
                size = 0.1 * (v.maximum or -(v.minimum or -0.01))
                values |= dict.fromkeys(v.element_names, size if v.kind == "real" else round(size))
    return values


def model(name: str) -> Model:
    """A component's model, or the demo model."""
    from robomill.fmus.components import COMPONENTS

    return demo.MODEL if name == "demo" else COMPONENTS[name]


def drive(slave: Slave, outputs: int, rows: FloatArray, values: dict[str, Any]) -> FloatArray:
    """Outputs (n + 1, n_outputs): after initialisation with the first inputs, then after each step."""
    try:
        slave.configure(values)
        slave.initialise(0.0, len(rows) * H, H)
        slave.set_inputs(rows[0])
        out = np.zeros((len(rows) + 1, outputs))
        slave.get_outputs(out[0])
        for k, row in enumerate(rows):
            slave.set_inputs(row)
            slave.step(k * H, H)
            slave.get_outputs(out[k + 1])
        return out
    finally:
        slave.close()


def difference(file: Path, ports: tuple[Port, ...], expected: FloatArray, found: FloatArray) -> str:
    """Empty if bitwise equal; else which variable parts first, in which step of which file."""
    where = np.argwhere(expected.view(np.uint64) != found.view(np.uint64))
    if not len(where):
        return ""
    k, i = where[0]
    return f"{file.name}: {ports[i].name} differs first in step {k}: {expected[k, i]!r} in process, {found[k, i]!r} in the FMU"


class Fmi3Slave:
    """An FMI 3.0 FMU through FMPy, variable by variable with whole arrays."""

    def __init__(self, file: Path, folder: Path, interface: Interface) -> None:
        fmpy.extract(str(file), str(folder))
        description = fmpy.read_model_description(str(file))
        self.interface = interface
        self.messages: list[str] = []
        self._log = fmi3LogMessageCallback(lambda _e, _s, _c, text: self.messages.append(text.decode()))
        self._fmu = FMU3Slave(
            instanceName=interface.model.name,
            guid=description.guid,
            unzipDirectory=str(folder),
            modelIdentifier=description.coSimulation.modelIdentifier,
        )
        self.variables = {v.name: v for v in description.modelVariables}
        self._fmu.instantiate(logMessage=self._log)
        self._closed = False

    @property
    def fmu(self) -> Any:
        """FMPy's object."""
        return self._fmu

    def configure(self, parameters: dict[str, Any]) -> None:
        """Set parameters given by element: the array is read, changed and written."""
        for name, value in parameters.items():
            port = self.interface.by_name[name]
            group = [p for p in self.interface.ports if p.variable == port.variable]
            reference = group[0].reference
            if port.type == "string":
                self._fmu.setString([reference], [value])
                continue
            values = self._get(port.type, reference, len(group))
            values[group.index(port)] = value
            self._set(port.type, reference, values)

    def initialise(self, start: float, stop: float, step: float) -> None:
        """Enter initialisation mode; the first step leaves it."""
        self._fmu.enterInitializationMode(startTime=start, stopTime=stop)
        self._initialising = True

    def set_inputs(self, values: FloatArray) -> None:
        """All inputs, array by array."""
        for name, part in self.interface.arrays.items():
            ports = self.interface.inputs[part]
            if ports and ports[0].variable == name:
                self._set(ports[0].type, ports[0].reference, [float(x) if ports[0].type == "real" else int(x) for x in values[part]])

    def step(self, t: float, h: float) -> None:
        """One step."""
        if self._initialising:
            self._fmu.exitInitializationMode()
            self._initialising = False
        event, terminate, early, reached = self._fmu.doStep(t, h)
        assert (event, terminate, early, reached) == (False, False, False, t + h)

    def get_outputs(self, out: FloatArray) -> None:
        """All outputs, array by array."""
        for name, part in self.interface.arrays.items():
            ports = self.interface.outputs[part]
            if ports and ports[0].variable == name:
                out[part] = self._get(ports[0].type, ports[0].reference, len(ports))

    def _get(self, kind: str, reference: int, count: int) -> list[Any]:
        function = {"real": self._fmu.getFloat64, "integer": self._fmu.getInt64, "boolean": self._fmu.getBoolean}[kind]
        values: list[Any] = function([reference], nValues=count)
        return values

    def _set(self, kind: str, reference: int, values: list[Any]) -> None:
        {"real": self._fmu.setFloat64, "integer": self._fmu.setInt64, "boolean": self._fmu.setBoolean}[kind]([reference], values)

    def close(self) -> None:
        """Free everything; may be repeated."""
        if not self._closed:
            self._closed = True
            self._fmu.terminate()
            self._fmu.freeInstance()
