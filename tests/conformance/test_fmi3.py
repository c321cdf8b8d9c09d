"""robomill.conformance with FMI 3.0: one FMU of another tool, in C, and what is found when it is broken in one place."""

from __future__ import annotations

import csv
import io
import re
import subprocess
import sys
import zipfile
from collections.abc import Mapping
from pathlib import Path

import pytest

from robomill import conformance
from robomill.conformance import CHECKS, Result, check_fmu
from robomill.conformance.fmi3 import Fmi3
from tests.orchestration import c_fmu, c_fmu3

pytestmark = pytest.mark.skipif(c_fmu.compiler() is None, reason="no C compiler here")


def changed(text: str, *changes: tuple[str, str]) -> str:
    for old, new in changes:
        assert text.count(old) == 1, f"{text.count(old)} times: {old}"
        text = text.replace(old, new)
    return text


STARTS = """
static double shared[6], spoilt;
static int runs;
static void start(Model *m) {
    memset(&m->v, 0, sizeof m->v);
    m->v.limit = 1e9, m->v.y[0] = m->env != NULL;
    for (int i = 0; i < 6; i++) m->v.u[i] = 0.5, m->v.gain[i] = i + 1;
    m->v.i32[0] = 1, m->v.i32[1] = 2, m->v.flag[0] = m->v.flag[2] = true;
}
"""
RESET = "fmi3Status fmi3Reset(fmi3Instance c) { start(c); return fmi3OK; }\n"
LAST = "GIVE(102, m->v.y + 5, 1,)"
SOURCE = changed(
    c_fmu3.SOURCE,
    ("fmi3Functions.h", "fmi3FunctionTypes.h"),  # no prototypes: what is missing is defined below without arguments
    ("enum { NEW, INIT, STEP };\n", "enum { NEW, INIT, STEP };\n" + STARTS),
    (
        "m->env = env, m->log = log, m->v.limit = 1e9;\n    for (int i = 0; i < 6; i++) m->v.gain[i] = 1;",
        "m->env = env, m->log = log; start(m); m->v.y[0] = spoilt;",
    ),
    ("GIVE(101, m->v.y, 6,)", f"GIVE(101, m->v.y, 6,) {LAST} GIVE(1, m->v.u, 6,) GIVE(2, m->v.gain, 6,)"),
    ("GIVE(109, m->v.i32, 2, + 1)", "GIVE(109, m->v.i32, 2, + 1) GIVE(9, m->v.i32, 2,)"),
    ("GIVE(113, m->v.flag, 3, == false)", "GIVE(113, m->v.flag, 3, == false) GIVE(13, m->v.flag, 3,)"),
)
HAS = {
    *re.findall(r"^(?:const char \*|fmi3\w+ |void )(fmi3\w+)\(", SOURCE, re.MULTILINE),
    *(f"fmi3{way}{name}" for way in ("Get", "Set") for name in re.findall(r"^ACCESS\((\w+),", SOURCE, re.MULTILINE)),
}
SOURCE += RESET + "".join(f"int {name}(void) {{ return 3; }}\n" for name in Fmi3.functions if name not in {*HAS, "fmi3Reset"})
DESCRIPTION = changed(
    c_fmu3.DESCRIPTION,
    (
        '  <Binary name="blob" valueReference="15" causality="input"/>\n',
        '  <Float64 name="last" valueReference="102" causality="output"/>\n',
    ),
    ('start="1 1 1 1 1 1"', 'start="1 2 3 4 5 6"'),
    (
        '<Output valueReference="109"/>',
        '<Output valueReference="102" dependencies=""/><Output valueReference="109" dependencies="9"/>',
    ),
    (
        " </ModelStructure>",
        "".join(f'<InitialUnknown valueReference="{n}"/>' for n in (101, 102, *range(104, 114))) + " </ModelStructure>",
    ),
)


def outcomes(folder: Path, *changes: tuple[str, str], description: str = DESCRIPTION) -> dict[str, Result]:
    return {r.check: r for r in check_fmu(c_fmu3.build(folder, description, changed(SOURCE, *changes)), 60.0)}


def test_an_fmu_of_another_tool_is_judged_by_what_it_declares(tmp_path: Path) -> None:
    results = outcomes(tmp_path)
    assert [r for r in results.values() if not r.passed] == []
    assert list(results)[4:] == list(CHECKS)
    assert {r.check for r in results.values() if r.outcome == "skipped"} == {"reference results"}
    findings = {name: r.detail for name, r in results.items() if r.outcome == "finding"}
    assert (
        findings.pop("units and descriptions")
        == "no description for y, gain, limit, in_Int32, ... (25 in all); no unit for gain, limit, last, in_Float32, ... (5 in all)"
    )
    assert findings == {
        "contents": "without documentation, icon, licence",
        "dependencies": "output y[1,1] follows input u[1,1] within the step, it declares none: right for an integrator; "
        "a master that sorts by dependencies may pass the value one step late",
        "input that is NaN": "NaN for input u[1,1] passes without an error",
        "parameter out of range": "parameter gain[1,1] = -1 is outside of [0, inf] and passes without an error",
    }
    assert results["exports"].detail == "75 functions of FMI 3.0"
    assert results["arrays"].detail == "7 arrays: start values in order; bitwise the same alone and together"
    assert results["wrong calls"].detail.endswith("that does not exist, too little room for an array")


STEP = "    m->v.time = t + h;\n"
RETURN = "    return m->v.u[0] > 50"
TOO_FEW = 'if (k + N > nv) return say(m, fmi3Error, "too few values"); for (int j = 0; j < N; j++) x[k++]'
BROKEN = {
    "a function is missing": ("int fmi3GetBinary(void) { return 3; }\n", "", "exports", "the library does not export fmi3GetBinary"),
    "another version": ('return "3.0"', 'return "3.1"', "exports", "fmi3GetVersion says '3.1', the model description '3.0'"),
    "it wants to end": (
        *(RETURN, f"*end = t > 0.03;\n{RETURN}"),
        *("runs in a fresh process", "fmi3DoStep asks for the end of the simulation at t = 0.032 s (terminateSimulation)"),
    ),
    "it returns early": (
        *(RETURN, f"*early = true;\n{RETURN}"),
        *("runs in a fresh process", "fmi3DoStep returned early from t = 0 s, though it was told not to (earlyReturnAllowed = false)"),
    ),
    "it wants event mode": (
        *(RETURN, f"*event = true;\n{RETURN}"),
        *("runs in a fresh process", "fmi3DoStep from t = 0 s wants event mode, which it was told not to (eventModeUsed = false)"),
    ),
    "an output is not finite": (
        *(STEP, f"{STEP}    if (t > 0.03) m->v.y[3] = 1e300 * 1e300;\n"),
        *("runs in a fresh process", "output y[2,1] is inf after step 9"),
    ),
    "memory of the run before": (
        *("m->v.y[i] += h", "m->v.y[i] += (t == 0) * 1e-9 * runs++ + h"),
        *("repeated run", "first and second run: y[1,1] differs first at step 1: 0.002 and"),
    ),
    "instances that share data": (
        *("m->v.y[i] += h * m->v.gain[i] * m->v.u[i]", "shared[i] = (t > 0) * shared[i] + h * m->v.u[i], m->v.y[i] = shared[i]"),
        *("two instances", "alone and beside another instance with other inputs: y[1,1] differs first at step 3"),
    ),
    "a reset that does nothing": (
        *(RESET, RESET.replace("start(c); ", "((Model *)c)->v.mode = NEW; ")),
        *("reset", "fresh and after fmi3Reset: y[1,1] differs first at step 0: 0.0 and"),
    ),
    "a state that is not all": (
        "fmi3SetFMUState(fmi3Instance c, fmi3FMUState s) { memcpy(&((Model *)c)->v, s, sizeof(Values));",
        "fmi3SetFMUState(fmi3Instance c, fmi3FMUState s) { memcpy(&((Model *)c)->v, s, 48);",
        "state",
        "steps before and after the second return to a state: y[1,1] differs first at step 7",
    ),
    "bytes that are not the whole state": (
        *("memcpy(b, s, n)", "memcpy(b, s, n), ((Values *)b)->y[1] = 0"),
        *("serialised state", "the same instance and another one from its serialised state: y[1,2] differs first at step 11"),
    ),
    "an array in another order": (
        *("m->v.gain[i] = i + 1", "m->v.gain[i] = 1 + i / 2 + i % 2 * 3"),
        *("arrays", "gain[1,2] is 4.0 in a new instance, its start value is 2.0"),
    ),
    "a call with two arrays": (
        *(LAST, "if (vr[i] == 102) { x[k++] = i ? 0 : m->v.y[5]; continue; }"),
        *("arrays", "all variables of a type in one call and each in a call of its own: last differs first at step 1: 0.0 and"),
    ),
    "more is written than there is room for": (
        *(TOO_FEW, TOO_FEW.replace("if (k + N > nv)", "if (k > nv)")),
        *("wrong calls", "6 values of y are written where there is room for 5"),
    ),
    "a wrong call spoils the others": (
        *('return say(m, fmi3Error, "no such " #NAME " to get")', 'spoilt = 1; return say(m, fmi3Error, "no such " #NAME " to get")'),
        *("wrong calls", "before and after wrong calls in other instances: y[1,1] differs first at step 0: 0.0 and 1.0"),
    ),
    "an error that a reset does not mend": (
        *('return say(m, fmi3Error, "no such " #NAME " to get")', 'm->env = m; return say(m, fmi3Error, "no such " #NAME " to get")'),
        *("wrong calls", "that does not exist, an error and a reset: y[1,1] differs first at step 0: 0.0 and 1.0"),
    ),
    "an error without a text": (
        *("    if (m->v.u[0] > 1000)", "    if (m->v.u[0] != m->v.u[0]) return fmi3Error;\n    if (m->v.u[0] > 1000)"),
        *("input that is NaN", "an error, but no text: fmi3DoStep returned error: (nothing logged)"),
    ),
    "a step size that is declared": (
        *("    if (m->v.u[0] > 1000)", '    if (h != 0.004) return say(m, fmi3Error, "not 4 ms");\n    if (m->v.u[0] > 1000)'),
        *("other step size", "true, but a step of 0.003 s fails: fmi3DoStep returned error: not 4 ms"),
    ),
    "a crash": ("if (!*s) *s = malloc(sizeof(Values));", "abort();", "state", "the process was killed by signal 6"),
}


@pytest.mark.parametrize("fault", BROKEN)
def test_every_check_finds_the_fmu_that_breaks_it(tmp_path: Path, fault: str) -> None:
    old, new, check, text = BROKEN[fault]
    result = outcomes(tmp_path, (old, new))[check]
    assert (result.outcome, text) == ("failed", text if text in result.detail else result.detail)


def test_the_process_that_runs_it_knows_nothing_of_this_project() -> None:
    alone = f"import runpy; runpy.run_path({str(Path(conformance.__file__).with_name('__main__.py'))!r})['_alone']()"
    found = "[n for n in ('models', 'fmus', 'orchestration', 'robomill') if importlib.util.find_spec(n)]"
    script = f"{alone}; import importlib.util, sys; print({found}, sys.modules['robomill_conformance'].CHECKS.keys() != set())"
    done = subprocess.run([sys.executable, "-P", "-c", script], capture_output=True, text=True, check=False)
    assert done.stdout == "[] True\n", done.stderr


def test_a_fault_does_not_hide_how_the_fmu_behaves(tmp_path: Path) -> None:
    description = DESCRIPTION.replace('<InitialUnknown valueReference="101"/>', "")
    results = outcomes(tmp_path, ("int fmi3GetBinary(void) { return 3; }\n", ""), description=description)
    assert [r.check for r in results.values() if not r.passed] == ["model description", "exports"]
    assert results["model description"].detail.startswith("1 problem: ModelStructure/InitialUnknowns")
    assert list(results)[4:] == list(CHECKS)


def test_a_step_that_ends_elsewhere_is_worth_knowing(tmp_path: Path) -> None:
    result = outcomes(tmp_path, (STEP, f"{STEP}    *last = t + h / 2;\n"))["runs in a fresh process"]
    assert result.outcome == "finding"
    assert result.detail == "fmi3DoStep from t = 0 s of 0.004 s gives 0.002 s as lastSuccessfulTime"


def test_an_array_with_too_few_starts(tmp_path: Path) -> None:
    last = list(outcomes(tmp_path, description=changed(DESCRIPTION, ('start="1 2 3 4 5 6"', 'start="1 2"'))).values())[-1]
    assert last == Result("model description", "failed", "array 'gain' has 6 elements and 2 start values; expected 1 or 6")


def test_an_output_that_follows_an_array_it_does_not_declare(tmp_path: Path) -> None:
    description = changed(
        DESCRIPTION, ('<Output valueReference="109" dependencies="9"/>', '<Output valueReference="109" dependencies="1"/>')
    )
    result = outcomes(tmp_path, description=description)["dependencies"]
    assert result.outcome == "failed"
    assert result.detail == "output out_Int32[1] follows input in_Int32[1] at once, without a step; it declares u"


def test_reference_results_name_elements(tmp_path: Path) -> None:
    file = c_fmu3.build(tmp_path, DESCRIPTION, SOURCE)
    inputs = {**{f"u[{i},{j}]": 1.0 for i in (1, 2) for j in (1, 2, 3)}, "in_Int32[1]": 1, "in_Int32[2]": 2, "in_Int64": 0}
    inputs |= {f"in_Boolean[{i}]": 1 for i in (1, 2, 3)} | {f"in_{kind}": 2 for kind in c_fmu3.NARROW}
    outputs = {f"y[{i},{j}]": 0.004 * (3 * i + j - 3) for i in (1, 2) for j in (1, 2, 3)} | {"last": 0.024}
    outputs |= {"out_Int32[1]": 2, "out_Int32[2]": 3, "out_Int64": 1} | {f"out_Boolean[{i}]": 0 for i in (1, 2, 3)}
    outputs |= {f"out_{kind}": 4 if kind == "Float32" else 3 for kind in c_fmu3.NARROW}
    start = {name: 0.0 if name[0] in "yl" else x for name, x in outputs.items()}

    def table(*rows: Mapping[str, float | str]) -> str:
        stream = io.StringIO()
        csv.writer(stream).writerows([["t", *rows[0]], *(["0", *row.values()] for row in rows)])
        return stream.getvalue()

    def in_one_column(values: dict[str, float]) -> dict[str, str]:
        """Arrays as FMPy and fmusim read them: the elements in one column, separated by blanks."""
        found: dict[str, str] = {}
        for name, value in values.items():
            array = name.partition("[")[0]
            found[array] = f"{found[array]} {value}" if array in found else str(value)
        return found

    def reference(last: float) -> Result:
        carrying = tmp_path / f"{last}.fmu"
        carrying.write_bytes(file.read_bytes())
        with zipfile.ZipFile(carrying, "a") as archive:
            archive.writestr("documentation/reference/in.csv", table(inputs))
            archive.writestr("documentation/reference/out.csv", table(start, outputs | {"y[2,3]": last}))
        return {r.check: r for r in check_fmu(carrying)}["reference results"]

    assert reference(0.024).outcome == "passed"
    assert reference(0.025).outcome == "failed"
    assert "y[2,3] differs first at step 1: 0.025 and 0.024" in reference(0.025).detail

    whole = [in_one_column(values) for values in (inputs, start, outputs)]

    def of_arrays(rows: list[dict[str, str]]) -> list[Result]:
        carrying = tmp_path / "arrays.fmu"
        carrying.write_bytes(file.read_bytes())
        with zipfile.ZipFile(carrying, "a") as archive:
            archive.writestr("documentation/reference/in.csv", table(*rows[:1]))
            archive.writestr("documentation/reference/out.csv", table(*rows[1:]))
        return check_fmu(carrying)

    assert {r.check: r for r in of_arrays(whole)}["reference results"].outcome == "passed"
    short = [whole[0], whole[1] | {"y": "0.0 0.0"}, whole[2]]
    assert "out.csv, row 2: y has 2 values; expected 6, separated by blanks" in of_arrays(short)[-1].detail


def test_an_fmu_for_another_platform(tmp_path: Path) -> None:
    file = c_fmu.pack(tmp_path / "x.fmu", DESCRIPTION, {"binaries/z80-cpm/types.com": b""})
    last = check_fmu(file)[-1]
    assert (last.check, last.outcome) == ("model description", "failed")
    assert last.detail.startswith("no binary for this platform (binaries/")
    assert last.detail.endswith("; it has binaries for z80-cpm; export it for this platform")


def test_an_fmu_for_model_exchange_only(tmp_path: Path) -> None:
    file = c_fmu.pack(tmp_path / "x.fmu", re.sub(r"<CoSimulation [^>]*>", '<ModelExchange modelIdentifier="types"/>', DESCRIPTION))
    last = check_fmu(file)[-1]
    expected = "is an FMU for model exchange only; a co-simulation FMU is needed: export it with a solver"
    assert last == Result("model description", "failed", expected)
