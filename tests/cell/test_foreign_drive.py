"""The milling cell with the drive of another tool: an FMU in C whose description lists its ports in an order of its own."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from robomill.cell.binding import convert, resolve
from robomill.cell.equipment import load_system
from robomill.orchestration.assembly import run
from robomill.orchestration.errors import Interrupted, WiringError
from robomill.orchestration.system.definition import Component, Connection, Recording, System
from tests import ROOT
from tests.orchestration import c_fmu

pytestmark = pytest.mark.skipif(c_fmu.compiler() is None, reason="no C compiler here")

STEPS, H = 60, 0.004
MODES = '<Item name="off" value="-3"/><Item name="eager" value="2000000000"/>'
ARRAYS = {"q_ref": (6, "rad"), "correction_B": (3, "m"), "correction_q": (6, "rad"), "f_T_B": (3, "N"), "m_T_B": (3, "N.m"),
          "q_motor": (6, "rad"), "q_link": (6, "rad"), "torque_motor": (6, "N.m"), "gain": (6, "1")}  # fmt: skip
FIRST = {name: 10 * i for i, name in enumerate(ARRAYS)}
"""Value reference of the first element."""
CODE = f"""
    for (int i = 0; i < 6; i++) {{
        R[{FIRST["q_motor"]} + i] += R[{FIRST["gain"]} + i] * (R[{FIRST["q_ref"]} + i] + R[{FIRST["correction_q"]} + i] - R[{FIRST["q_motor"]} + i]);
        R[{FIRST["q_link"]} + i] = R[{FIRST["q_motor"]} + i] + (m->v.n == 2000000000 ? 1e-9 * R[{FIRST["f_T_B"]}] : 0.0);
        R[{FIRST["torque_motor"]} + i] = R[{FIRST["m_T_B"]}];
    }}
"""  # noqa: E501  # C


def source() -> str:
    """From the small FMU of the other tests: values in an array by reference, the mode an enumeration, outputs when initialisation ends."""
    text = c_fmu.SOURCE
    changes = {
        "typedef struct { fmi2Real u, y, gain;": "\n#define R m->v.r\ntypedef struct { fmi2Real r[100]; fmi2Real u, y, gain;",
        "if (vr[i] == 0) x[i] = m->v.u;": "if (vr[i] < 100) x[i] = m->v.r[vr[i]];",
        "if (vr[i] == 0) m->v.u = x[i];": "if (vr[i] < 100) m->v.r[vr[i]] = x[i];",
        "((Model *)c)->v.offset = x[i];": "((Model *)c)->v.n = x[i];",
        "{ ((Model *)c)->mode = 2; return fmi2OK; }": f"""{{
            Model *m = c;
            for (int i = 0; i < 6; i++)
                R[{FIRST["q_motor"]} + i] = R[{FIRST["q_link"]} + i] = R[{FIRST["q_ref"]} + i] + R[{FIRST["correction_q"]} + i];
            m->mode = 2;
            return fmi2OK;
        }}""",
        "m->v.y += h * m->v.gain * m->v.u;": CODE,
        "m->v.n = m->v.n ? m->v.n + 1 : m->v.offset + 1;": "",
    }  # fmt: skip
    for old, new in changes.items():
        assert old in text, old
        text = text.replace(old, new, 1)
    return text


def description() -> str:
    """Outputs first, the last axis before the first, the elements of two arrays by turns."""

    def variables() -> Iterator[str]:
        backwards = list(reversed(range(1, 7)))
        order = [(name, i) for i in backwards for name in ("torque_motor", "q_link", "q_motor", "gain", "q_ref", "correction_q")]
        order += [(name, i) for i in (2, 3, 1) for name in ("m_T_B", "correction_B", "f_T_B")]
        for name, i in order:
            causality = "parameter" if name == "gain" else "output" if "motor" in name or "link" in name else "input"
            start = "" if causality == "output" else f' start="{0.5 if name == "gain" else 0.0}"'
            more = ' variability="fixed"' if name == "gain" else ""
            yield (
                f'<ScalarVariable name="{name}[{i}]" valueReference="{FIRST[name] + i - 1}" causality="{causality}"{more}>'
                f'<Real unit="{ARRAYS[name][1]}"{start}/></ScalarVariable>'
            )
        yield (
            '<ScalarVariable name="mode" valueReference="0" causality="parameter" variability="fixed">'
            '<Enumeration declaredType="Mode" start="-3"/></ScalarVariable>'
        )

    listed = list(variables())
    outputs = [i for i, text in enumerate(listed, 1) if 'causality="output"' in text]
    unknowns = "".join(f'<Unknown index="{i}"/>' for i in outputs)
    units = "".join(f'<Unit name="{u}"><BaseUnit/></Unit>' for u in sorted({u for _, u in ARRAYS.values()}))
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="Drive" guid="c-fmu" generationTool="cc">
  <CoSimulation modelIdentifier="euler" canGetAndSetFMUstate="true" canSerializeFMUstate="true"/>
  <UnitDefinitions>{units}</UnitDefinitions>
  <TypeDefinitions><SimpleType name="Mode"><Enumeration>{MODES}</Enumeration></SimpleType></TypeDefinitions>
  <ModelVariables>{"".join(listed)}</ModelVariables>
  <ModelStructure><Outputs>{unknowns}</Outputs><InitialUnknowns>{unknowns}</InitialUnknowns></ModelStructure>
</fmiModelDescription>"""


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return c_fmu.build(tmp_path_factory.mktemp("drive"), source(), description())


GAIN = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]


def cell(drive: Path, isolate: bool) -> System:
    system = load_system(ROOT / "scenarios" / "milling_cell.toml")
    other = Component(
        "drive", str(drive), {"gain": GAIN, "mode": "eager"}, isolate=isolate, inputs={"correction_q": ["1 mrad", 0, 0, 0, 0, "2 mrad"]}
    )
    parts = tuple(other if c.name == "drive" else c for c in system.components)
    return replace(system, components=parts, stop_when=None, stop=STEPS * H, recording=Recording(checkpoint_every=25))


@pytest.mark.parametrize("isolate", [False, True])
@pytest.mark.parametrize("loop", ["python", "compiled"])
def test_it_mills_and_goes_on_from_a_checkpoint(drive: Path, tmp_path: Path, loop: str, isolate: bool) -> None:
    system = cell(drive, isolate)
    whole = run(system, tmp_path / "whole", resolver=resolve, convert=convert, loop=loop)
    q, wanted, sent, f = (whole[n] for n in ("drive.q_motor", "path.q_ref", "controller.correction_q", "milling.f_T_B"))
    assert q.shape == (STEPS + 1, 6)
    assert np.ptp(wanted, axis=0).max() > 0.0
    expected = np.zeros_like(q)
    expected[0] = wanted[0] + np.array([1e-3, 0, 0, 0, 0, 2e-3])  # the start values
    for k in range(STEPS):  # the equations of the C code; the correction is that of the step before
        expected[k + 1] = expected[k] + np.array(GAIN) * (wanted[k + 1] + sent[k] - expected[k])
    np.testing.assert_array_equal(q, expected)
    np.testing.assert_array_equal(whole["drive.q_link"][1:], q[1:] + 1e-9 * f[:-1, :1])

    def stop(done: int, total: int) -> None:
        if done >= 40:
            raise KeyboardInterrupt

    with pytest.raises(Interrupted):
        run(system, tmp_path / "parts", resolver=resolve, convert=convert, loop="python", progress=stop)
    again = run(system, tmp_path / "parts", resolver=resolve, convert=convert, loop=loop, resume=True)
    assert again.info["resumed"]
    assert all(again.columns[name].tobytes() == column.tobytes() for name, column in whole.columns.items())


def test_elements_counted_from_zero_are_named(tmp_path: Path) -> None:
    text = description()
    for i in range(6):
        text = text.replace(f'name="q_ref[{i + 1}]"', f'name="q_ref[{i}]"')
    file = c_fmu.build(tmp_path, source(), text)
    system = System(
        "t", H, (Component("path", "path_interpolator"), Component("drive", str(file))), (Connection("path.q_ref", "drive.q_ref"),)
    )
    with pytest.raises(WiringError) as caught:
        run(system, stop=1.0, resolver=resolve, convert=convert)
    assert (
        "connection path.q_ref -> drive.q_ref: the elements have other indices, q_ref[1] to q_ref[6] and q_ref[0] to q_ref[5]: "
        "connect them one by one" in str(caught.value)
    )
