"""robomill.conformance: what it finds in FMUs that are not as they should be, here in C and from another tool."""

from __future__ import annotations

import zipfile
from pathlib import Path

import pytest

from robomill.conformance import CHECKS, Result, check_fmu
from robomill.fmus.python.builder import build as build_python_fmu
from robomill.orchestration.errors import SlaveError
from robomill.orchestration.slaves.fmu import FmuSlave
from tests.fmus import demo
from tests.orchestration import c_fmu

needs_compiler = pytest.mark.skipif(c_fmu.compiler() is None, reason="no C compiler here")
NO_RESET = "fmi2Status fmi2Reset(fmi2Component c) { return fmi2OK; }"
RESET = (
    "fmi2Status fmi2Reset(fmi2Component c) { Model *m = c; memset(&m->v, 0, sizeof m->v); m->v.gain = 1.0; m->mode = 0; return fmi2OK; }"
)


def outcomes(folder: Path, *changes: tuple[str, str], timeout: float = 60.0, description: str = c_fmu.DESCRIPTION) -> dict[str, Result]:
    source = c_fmu.SOURCE.replace(NO_RESET, RESET)
    for old, new in changes:
        assert old in source
        source = source.replace(old, new)
    return {r.check: r for r in check_fmu(c_fmu.build(folder, source, description), timeout)}


def test_a_good_fmu_of_this_project_passes(tmp_path: Path) -> None:
    results = check_fmu(build_python_fmu(demo.MODEL, tmp_path))
    assert [r.check for r in results][4:] == list(CHECKS)
    assert {r.check: r.outcome for r in results if r.outcome != "passed"} == {"arrays": "skipped", "reference results": "skipped"}


@needs_compiler
def test_an_fmu_of_another_tool_is_judged_by_what_it_declares(tmp_path: Path) -> None:
    results = outcomes(tmp_path)
    assert [r.check for r in results.values() if not r.passed] == []
    findings = {name: r.detail for name, r in results.items() if r.outcome == "finding"}
    assert findings["contents"] == "without documentation, icon, licence"
    assert findings["units and descriptions"].startswith("no description for y, n, on, twice")
    assert findings["input that is NaN"] == "NaN for input u passes without an error"
    assert findings["parameter out of range"] == "parameter gain = -1 is outside of [0, inf] and passes without an error"
    assert findings["dependencies"].startswith("output y follows input u within the step, it declares none: right for an integrator")
    assert findings["wrong calls"] == "an error without a text: a value reference that does not exist"
    assert results["repeated run"].outcome == "passed"
    assert results["serialised state"].outcome == "passed"


@needs_compiler
def test_a_description_with_a_fault_does_not_hide_how_the_fmu_behaves(tmp_path: Path) -> None:
    initial = "<InitialUnknowns>"
    assert initial in c_fmu.DESCRIPTION
    results = outcomes(tmp_path, description=c_fmu.DESCRIPTION.replace(f'{initial}<Unknown index="2"/>', initial))
    assert results["model description"].outcome == "failed"
    assert results["model description"].detail.startswith("1 problem: ModelStructure/InitialUnknowns")
    assert results["repeated run"].outcome == "passed"
    assert [r.check for r in results.values()][4:] == list(CHECKS)


@needs_compiler
def test_a_function_that_is_missing(tmp_path: Path) -> None:
    results = outcomes(tmp_path, ("fmi2Status fmi2CancelStep(fmi2Component c) {", "fmi2Status cancel(fmi2Component c) {"))
    assert [r for r in results.values() if not r.passed] == [Result("exports", "failed", "the library does not export fmi2CancelStep")]


@needs_compiler
def test_wrong_calls_that_pass(tmp_path: Path) -> None:
    result = outcomes(
        tmp_path,
        ("if (m->mode != 2) {", "if (m->mode > 2) {"),
        (
            "        else return fmi2Error;\n    }\n    return fmi2OK;\n}\nfmi2Status fmi2SetReal",
            "    }\n    return fmi2OK;\n}\nfmi2Status fmi2SetReal",
        ),
    )["wrong calls"]
    assert result == Result(
        "wrong calls", "finding", "no error: a step before the end of initialisation, a value reference that does not exist"
    )


@needs_compiler
def test_a_reset_that_does_nothing(tmp_path: Path) -> None:
    result = outcomes(tmp_path, (RESET, NO_RESET))["reset"]
    assert result.outcome == "failed"
    assert result.detail.startswith("fresh and after fmi2Reset: y differs first at step 0: 0.0 and 0.0")


@needs_compiler
def test_instances_that_share_data(tmp_path: Path) -> None:
    results = outcomes(tmp_path, ("m->v.y += h", "static double y; m->v.y = y += h"))
    assert results["two instances"].outcome == "failed"
    assert results["repeated run"].detail.startswith("first and second run: y differs first at step 1")


@needs_compiler
def test_a_state_that_is_not_all(tmp_path: Path) -> None:
    part = "memcpy(&((Model *)c)->v, s, sizeof(Values)); return"
    result = outcomes(tmp_path, (part, "((Model *)c)->v.u = ((Values *)s)->u; return"))["state"]
    assert result.outcome == "failed"
    assert result.detail.startswith("steps before and after the second return to a state: y differs first at step 7")


@needs_compiler
def test_a_state_that_cannot_be_saved_is_skipped(tmp_path: Path) -> None:
    description = c_fmu.DESCRIPTION.replace('canGetAndSetFMUstate="true" canSerializeFMUstate="true"', "")
    results = outcomes(tmp_path, description=description)
    assert results["state"] == Result("state", "skipped", "canGetAndSetFMUstate is false")
    assert results["serialised state"].outcome == results["dependencies"].outcome == "skipped"


@needs_compiler
def test_an_output_that_follows_an_input_it_does_not_declare(tmp_path: Path) -> None:
    description = c_fmu.DESCRIPTION.replace('<Unknown index="5" dependencies="1"/>\n', '<Unknown index="5" dependencies=""/>\n', 1)
    result = outcomes(tmp_path, description=description)["dependencies"]
    assert result.outcome == "failed"
    assert result.detail == "output twice follows input u at once, without a step; it declares none"


@needs_compiler
def test_a_refusal_without_a_text_is_a_failure(tmp_path: Path) -> None:
    result = outcomes(tmp_path, ("if (m->v.u > 1000)", "if (m->v.u != m->v.u) return fmi2Error;\n if (m->v.u > 1000)"))["input that is NaN"]
    assert result.outcome == "failed"
    assert result.detail.startswith("an error, but no text: fmi2DoStep returned error")


@needs_compiler
def test_a_step_size_that_is_declared_but_fails(tmp_path: Path) -> None:
    fixed = 'if (h != 0.004) { say(m, fmi2Error, "logStatusError", "h is %g, not %g", h, 0.004); return fmi2Error; }\n'
    change = ("    m->v.y += h", f"    {fixed}    m->v.y += h")
    result = outcomes(tmp_path, change)["other step size"]
    assert result.outcome == "failed"
    assert "but a step of 0.003 s fails: fmi2DoStep returned error: h is 0.003, not 0.004" in result.detail
    description = c_fmu.DESCRIPTION.replace('VariableCommunicationStepSize="true"', 'VariableCommunicationStepSize="false"')
    assert outcomes(tmp_path, change, description=description)["other step size"].outcome == "passed"
    assert outcomes(tmp_path, description=description)["other step size"].outcome == "finding"


@needs_compiler
def test_a_crash_costs_its_check_and_no_more(tmp_path: Path) -> None:
    results = outcomes(tmp_path, ("if (!*s) *s = malloc(sizeof(Values));", "abort();"))
    assert list(results)[4:] == list(CHECKS)
    crashed = ["state", "serialised state", "dependencies"]
    for name in crashed:
        assert results[name].outcome == "failed"
        assert "the process was killed by signal 6" in results[name].detail
    assert [r.check for r in results.values() if r.outcome == "failed"] == crashed
    assert results["other step size"].outcome == "passed"


@needs_compiler
def test_outputs_that_are_computed_when_initialisation_is_left(tmp_path: Path) -> None:
    """Before that they may be anything, as in a run: here what was there before the reset."""
    late = "fmi2ExitInitializationMode(fmi2Component c) {"
    stale = RESET.replace("memset", "fmi2Real y = m->v.y; memset").replace("return", "m->v.y = y; return")
    results = outcomes(tmp_path, (late, f"{late} ((Model *)c)->v.y = 29.75;"), (RESET, stale))
    assert results["reset"].detail == "bitwise as fresh"


@needs_compiler
def test_an_fmu_is_told_that_it_may_be_set_back_only_then(tmp_path: Path) -> None:
    """One that cannot go on when it is told so fails only where states are kept."""
    results = outcomes(tmp_path, ("if (m->mode != 2) {", "if (!nsp) return fmi2Error; if (m->mode != 2) {"))
    failed = [r.check for r in results.values() if r.outcome == "failed"]
    assert failed == ["state", "serialised state", "dependencies"]


@needs_compiler
@pytest.mark.slow
def test_an_fmu_that_hangs_is_stopped(tmp_path: Path) -> None:
    results = outcomes(tmp_path, ("m->v.y += h", "if (m->v.n == 5) for (;;) ; m->v.y += h"), timeout=5.0)
    assert results["runs in a fresh process"] == Result("runs in a fresh process", "failed", "no answer within 5 s")


@needs_compiler
def test_reference_results_that_do_not_fit(tmp_path: Path) -> None:
    file = c_fmu.build(tmp_path, c_fmu.SOURCE.replace(NO_RESET, RESET))
    with zipfile.ZipFile(file, "a") as archive:
        archive.writestr("documentation/reference/in.csv", "t,u,offset,invert\n0,1,0,0\n0.004,2,0,0\n")
        archive.writestr("documentation/reference/out.csv", "t,y,n,on,twice\n0,0,0,0,2\n0.004,0.004,1,1,2\n0.008,0.012,3,1,4\n")
    result = {r.check: r for r in check_fmu(file)}["reference results"]
    assert result.outcome == "failed"
    assert (
        result.detail
        == "reference results (documentation/reference/out.csv) and this run: n differs first at step 2: 3.0 and 2.0 (difference -1)"
    )


@pytest.mark.parametrize(
    ("content", "check", "text"),
    [
        (None, "archive", "not a zip archive, so not an FMU"),
        ({"x": b""}, "model description", "no modelDescription.xml in it, so not an FMU; it holds x"),
        ({"modelDescription.xml": b"<a", "../x": b""}, "archive", "refused: entry '../x' would be written outside"),
        ({"modelDescription.xml": b"<a"}, "model description", "is not valid XML"),
        (
            {"modelDescription.xml": c_fmu.DESCRIPTION.replace('fmiVersion="2.0"', 'fmiVersion="1.0"').encode()},
            "model description",
            "",
        ),
    ],
)
def test_what_is_no_fmu(tmp_path: Path, content: dict[str, bytes] | None, check: str, text: str) -> None:
    file = tmp_path / "x.fmu"
    file.write_bytes(b"no")
    if content is not None:
        with zipfile.ZipFile(file, "w") as archive:
            for name, data in content.items():
                archive.writestr(name, data)
    last = check_fmu(file)[-1]
    assert (last.check, last.outcome) == (check, "failed")
    assert text in last.detail
    with pytest.raises(SlaveError) as refused:  # a run says the same
        FmuSlave(file)
    assert str(refused.value) == f"{file}: {last.detail}"


@needs_compiler
def test_an_fmu_that_a_process_can_have_one_instance_of(tmp_path: Path) -> None:
    """Each check has a process of its own; a second instance in one would be refused by this FMU."""
    once = ("    m = calloc(1, sizeof *m);\n", "    static int made;\n    if (made++) return NULL;\n    m = calloc(1, sizeof *m);\n")
    description = c_fmu.DESCRIPTION.replace("<CoSimulation ", '<CoSimulation canBeInstantiatedOnlyOncePerProcess="true" ')
    results = outcomes(tmp_path, once, description=description)
    assert [r for r in results.values() if not r.passed] == []
    assert list(results)[4:] == list(CHECKS)
    text = "canBeInstantiatedOnlyOncePerProcess is true, and this check needs a second instance"
    assert results["two instances"] == Result("two instances", "skipped", text)
    assert results["serialised state"] == Result("serialised state", "skipped", text)
    assert {results[c].outcome for c in ("repeated run", "reset", "state")} == {"passed"}


def test_a_file_that_does_not_exist() -> None:
    with pytest.raises(FileNotFoundError, match=r"/no/such\.fmu: no such file"):
        check_fmu("/no/such.fmu")
