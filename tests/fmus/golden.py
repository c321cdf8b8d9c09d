"""Golden results in tests/golden: per component a short in.csv, the out.csv that belongs to it, its parameters and its interface.

Row k of in.csv holds from t_k on; row k of out.csv are the outputs at t_k (row 0 after
initialisation with the first inputs). Numbers are written so that they read back bit by bit. FMUs
carry these files in documentation/reference, where `robomill check` compares with them.
They change only by ``python -m tests.fmus.regenerate``, and the diff is reviewed.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from robomill.fmus.in_process import InProcessSlave
from robomill.fmus.interface import Interface, Port
from robomill.models.model.declaration import FloatArray, Model
from tests import ROOT

FOLDER = ROOT / "tests" / "golden"
H = 0.004


def run(model: Model, inputs: FloatArray, parameters: dict[str, Any], plain: bool) -> FloatArray:
    """Outputs (n + 1, n_outputs) for inputs (n, n_inputs) in steps of 4 ms."""
    slave = InProcessSlave(model, plain=plain)
    slave.configure(parameters)
    slave.set_inputs(inputs[0])
    slave.initialise(0.0, len(inputs) * H, H)
    out = np.zeros((len(inputs) + 1, len(slave.interface.outputs)))
    slave.get_outputs(out[0])
    for k, row in enumerate(inputs):
        slave.set_inputs(row)
        slave.step(k * H, H)
        slave.get_outputs(out[k + 1])
    slave.close()
    return out


def interface_text(interface: Interface) -> str:
    """One line per port: what others rely on."""
    return "".join(_line(p) + "\n" for p in interface.ports)


def _line(p: Port) -> str:
    bounds = "" if p.minimum is None and p.maximum is None else f" [{_bound(p.minimum)}, {_bound(p.maximum)}]"
    unit = p.unit or ("" if p.type != "real" else "1")
    start = "" if p.causality == "output" else f" = {p.start!r}"
    arrays = [] if p.dependencies is None else list(dict.fromkeys(d.partition("[")[0] for d in p.dependencies))
    follows = "" if p.causality != "output" else f" <- {', '.join(arrays) or 'nothing'}"
    return " ".join(f"{p.causality} {p.type} {p.variability} {p.name} {unit}{start}{bounds}{follows}".split())


def _bound(value: float | None) -> str:
    return "" if value is None else repr(value)


def write(file: Path, ports: Sequence[Port], rows: FloatArray) -> None:
    """Write a table with column t."""
    with file.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["t", *(p.name for p in ports)])
        for k, row in enumerate(rows):
            values = (repr(float(x)) if p.type == "real" else str(int(x)) for p, x in zip(ports, row, strict=True))
            writer.writerow([repr(round(k * H, 9)), *values])


def read(file: Path, ports: Sequence[Port]) -> FloatArray:
    """Read a table in the order of `ports`; ValueError if its columns are others."""
    with file.open(encoding="utf-8", newline="") as stream:
        head, *rows = csv.reader(stream)
    if sorted(head[1:]) != sorted(p.name for p in ports):
        raise ValueError(
            f"{file}: columns {sorted(set(head[1:]) ^ {p.name for p in ports})} are there or missing; regenerate the inputs, too"
        )
    return np.array([[float(row[head.index(p.name)]) for p in ports] for row in rows])


def parameters(folder: Path) -> dict[str, Any]:
    """The parameters of a golden result; texts in the file are names of files beside it."""
    values = json.loads((folder / "parameters.json").read_text(encoding="utf-8"))
    return {name: str(folder / value) if isinstance(value, str) else value for name, value in values.items()}


def first_difference(file: Path, ports: Sequence[Port], expected: FloatArray, found: FloatArray) -> str:
    """Empty if bitwise equal; else where they part: file, step, time, variable and both values."""
    different = np.argwhere(expected != found)
    if not len(different):
        return ""
    k, i = (int(x) for x in different[0])
    names = sorted({ports[int(j)].name for j in different[:, 1]})
    return (
        f"{file.relative_to(ROOT)}: {ports[i].name} differs first in step {k} (t = {k * H:.3f} s): "
        f"{expected[k, i]!r} there, {found[k, i]!r} now (difference {found[k, i] - expected[k, i]:.3g}); "
        f"{len(different)} values of {len(names)} variables differ. "
        "If that is intended: python -m tests.fmus.regenerate, then review the diff"
    )
