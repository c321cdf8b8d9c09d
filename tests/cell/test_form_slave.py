"""A form in two coats: the slave that begins at once, and the model that FMUs are made of, give the same numbers."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from robomill.cell.binding import resolve
from robomill.cell.form_slave import FormSlave
from robomill.fmus.in_process import InProcessSlave
from robomill.fmus.python.builder import build
from robomill.models.components.correction import FACTORS, KINDS, correction_model, factor, factors, kind_of
from tests.tolerances import ROUNDOFF, discretisation

ALONE = """
import sys
sys.modules["robomill"] = None  # nobody has it there
import fmpy, numpy as np
given = np.load("in.npz")["rows"]
outputs = [v.name for v in fmpy.read_model_description("adopt_form.fmu").modelVariables if v.causality == "output"]
h = 0.01
stop = h * (len(given) - 1)
made = fmpy.simulate_fmu("adopt_form.fmu", step_size=h, output_interval=h, stop_time=stop, input=given, output=outputs)
np.savez("out.npz", made=made)
"""
"""What another tool does with the FMU of a form: FMPy, in a folder of its own."""

TIMES = discretisation(1e3, np.spacing(0.07) / 0.01, 1)
"""FMPy steps by the difference of two times, which is off by their rounding; 1e3: rates, and what cancels beside them."""


def part(kind: str, variable: str, rate: bool = False, shape: float = 0.7, since_start: bool = False) -> dict[str, object]:
    return {"kind": kind, "variable": variable, "rate": rate, "since_start": since_start, "shape": shape}


def specification(**more: object) -> dict[str, object]:
    """Every kind once, a rate, what changed since the start, the time, what passes itself, and a product."""
    variables = ["q[1]", "q[2]", "load", "torque[2]", "t"]
    terms = [[part(kind, variables[k % len(variables)])] for k, kind in enumerate(KINDS) if kind != "one"]
    terms += [[], [part("sign", "q[2]", True, 0.3), part("size", "load")], [part("value", "torque[1]", True)]]
    terms += [[part("value", "q[1]", since_start=True)], [part("cube", "torque[2]", since_start=True), part("value", "t")]]
    return {
        "name": "form_of_axis",
        "stands_for": "axis",
        "signals": [{"name": "q", "unit": "rad", "count": 2}, {"name": "load", "unit": "N", "count": 0}],
        "corrected": [{"name": "torque", "unit": "N.m", "count": 2}, {"name": "way", "unit": "m", "count": 0}],
        "terms": [
            {"element": ("torque[1]", "torque[2]", "way")[k % 3], "coefficient": 0.5 + k, "unit": "1", "text": "x", "factors": f}
            for k, f in enumerate(terms)
        ],
        **more,
    }


def stepped(slave: FormSlave | InProcessSlave, rows: np.ndarray, names: list[str]) -> np.ndarray:
    own = [p.name for p in slave.ports if p.causality == "input"]
    order, made = [names.index(n) for n in own], []
    out = np.zeros(sum(p.causality == "output" for p in slave.ports))
    slave.initialise(0.0, 1.0, 0.01)
    for k, row in enumerate(rows):
        slave.set_inputs(row[order])
        if k:
            slave.step(0.01 * (k - 1), 0.01)
        slave.get_outputs(out)
        made.append(out.copy())
    return np.array(made)


def test_slave_and_model_give_the_same_numbers() -> None:
    given = specification()
    slave, model = FormSlave("form", given), InProcessSlave(correction_model(given), "form", plain=True)
    names = [p.name for p in slave.ports if p.causality == "input"]
    assert {"q[1]", "load", "torque_in[2]", "way_in"} <= set(names)
    rows = np.random.default_rng(1).normal(size=(12, len(names)))
    one, other = stepped(slave, rows, names), stepped(model, rows, names)
    assert [p.name for p in slave.ports if p.causality == "output"] == [p.name for p in model.ports if p.causality == "output"]
    assert np.ptp(one, axis=0).min() > 1.0
    np.testing.assert_allclose(one, other, rtol=ROUNDOFF)


@pytest.mark.skipif(sys.platform != "linux", reason="runs linux64 libraries")
def test_its_fmu_runs_in_fmpy_where_there_is_no_robomill(tmp_path: Path) -> None:
    """The file that a diagnosis writes beside its answer. FMPy gives a step the inputs of its beginning."""
    given = specification()
    build(correction_model(given), tmp_path / "adopt_form.fmu", page="", reference={})
    slave = FormSlave("form", given)
    names = [p.name for p in slave.ports if p.causality == "input"]
    t = 0.01 * np.arange(8)
    rows = np.random.default_rng(3).normal(size=(len(t), len(names)))
    made = stepped(slave, rows[[0, *range(len(t) - 1)]], names)
    table = np.zeros(len(t), dtype=[("time", float), *((n, float) for n in names)])
    for n, x in zip(("time", *names), (t, *rows.T), strict=True):
        table[n] = x
    np.savez(tmp_path / "in.npz", rows=table)
    there = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    subprocess.run([sys.executable, "-c", ALONE], cwd=tmp_path, env=there, check=True, capture_output=True)
    found = np.load(tmp_path / "out.npz")["made"]
    for k, p in enumerate(p for p in slave.ports if p.causality == "output"):
        np.testing.assert_allclose(found[p.name], made[:, k], rtol=TIMES)


@pytest.mark.parametrize("kind", range(len(KINDS)))
def test_a_series_of_factors_is_each_factor(kind: int) -> None:
    x = np.linspace(-2.0, 2.0, 41)
    np.testing.assert_allclose(factors(kind, x, 0.7), [factor(kind, float(v), 0.7) for v in x], rtol=ROUNDOFF, atol=ROUNDOFF)


def test_what_changed_since_the_start_begins_anew_with_each_run() -> None:
    given = specification(
        terms=[{"element": "way", "coefficient": 2.0, "unit": "1", "text": "x", "factors": [part("value", "q[2]", since_start=True)]}]
    )
    slave = FormSlave("form", given)
    names, out = [p.name for p in slave.ports if p.causality == "input"], np.zeros(3)
    for begin in (0.5, -4.0):
        slave.initialise(0.0, 1.0, 0.01)
        for k, turned in enumerate((0.0, 0.0, 0.25, 1.0)):
            slave.set_inputs(np.array([begin + turned if n == "q[2]" else 0.0 for n in names]))
            if k:
                slave.step(0.01 * (k - 1), 0.01)
            slave.get_outputs(out)
            assert out.tolist() == [0.0, 0.0, 2.0 * turned]


def test_a_state_is_gone_back_to() -> None:
    slave = FormSlave("form", specification())
    rows = np.random.default_rng(2).normal(size=(3, 6))
    out, again = np.zeros(3), np.zeros(3)
    slave.initialise(0.0, 1.0, 0.01)
    slave.set_inputs(rows[0])
    slave.get_outputs(out)
    slave.step(0.0, 0.01)
    state = slave.get_state()
    slave.set_inputs(rows[1])
    slave.step(0.01, 0.01)
    slave.get_outputs(out)
    slave.set_state(state)
    slave.set_inputs(rows[1])
    slave.step(0.01, 0.01)
    slave.get_outputs(again)
    assert out.tolist() == again.tolist()


def test_what_is_wrong_with_a_form_is_said(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"unknown kind 'tangent' of a factor; kinds: one, value"):
        kind_of({"kind": "tangent"})
    with pytest.raises(ValueError, match=r"a form has no 'q\[3\]'; it has load, way_in, q"):
        correction_model(
            specification(terms=[{"element": "way", "coefficient": 1.0, "unit": "1", "text": "x", "factors": [part("value", "q[3]")]}])
        )
    with pytest.raises(LookupError, match=r"no form .*missing\.form\.json; `robomill diagnose --form` writes one"):
        resolve(str(tmp_path / "missing.form.json"), "form")
    file = tmp_path / "other.form.json"
    file.write_text(json.dumps({"name": "x"}))
    with pytest.raises(LookupError, match="is no form that a diagnosis has written: KeyError"):
        resolve(str(file), "form")
    assert max(len(t["factors"]) for t in specification()["terms"]) == FACTORS  # type: ignore[attr-defined]
