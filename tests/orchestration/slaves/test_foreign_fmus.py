"""What FMUs of other tools need to be told, and what they say: each FMU here is one in C with a habit that a vendor's has."""

from __future__ import annotations

import subprocess
from pathlib import Path

import fmpy
import pytest

from robomill.conformance import check_fmu
from robomill.orchestration.assembly import assemble, run
from robomill.orchestration.errors import RunError, SystemFileError
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.fmu import FmuSlave
from robomill.orchestration.system.definition import Component, Connection, System
from tests.orchestration import c_fmu, c_fmu3
from tests.tolerances import ROUNDOFF

pytestmark = [pytest.mark.skipif(c_fmu.compiler() is None, reason="no C compiler here"), pytest.mark.usefixtures("temporary")]

H, STEPS = 0.004, 5
LIMITED = ' declaredType="Length"'


def changed(text: str, *changes: tuple[str, str]) -> str:
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new, 1)
    return text


@pytest.fixture(scope="module")
def counting(tmp_path_factory) -> dict[int, Path]:
    """By FMI version: y counts the steps that it hears are final."""
    two = changed(c_fmu.SOURCE, ("m->v.y += h * m->v.gain * m->v.u;", "m->v.y += nsp;"))
    three = changed(c_fmu3.SOURCE, ("m->v.y[i] += h * m->v.gain[i] * m->v.u[i];", "m->v.y[i] += no;"))
    unitless = c_fmu.DESCRIPTION.replace(LIMITED, "")
    return {
        2: c_fmu.build(tmp_path_factory.mktemp("two"), two, unitless),
        3: c_fmu3.build(tmp_path_factory.mktemp("three"), c_fmu3.PLAIN, three),
    }


class TestNoSetPrior:
    """Some FMUs stand still when they hear that they may be set back (noSetFMUStatePriorToCurrentPoint = false)."""

    @pytest.mark.parametrize("fmi", [2, 3])
    @pytest.mark.parametrize("loop", ["python", "compiled"])
    @pytest.mark.parametrize("x", [{}, {"rate": 2}, {"isolate": True}], ids=["plain", "rate", "isolated"])
    def test_nothing_goes_back(self, counting, fmi, loop, x):
        file = str(counting[fmi])
        parts = (Component("x", file, **x), Component("z", file))
        r = run(System("t", H, parts, stop=STEPS * H, loop=loop))
        assert r["x.y"].reshape(STEPS + 1, -1)[-1, 0] == STEPS * x.get("rate", 1)

    @pytest.mark.parametrize("loop", ["python", "compiled"])
    @pytest.mark.parametrize(("x", "said"), [({}, STEPS), ({"rate": 2}, 0), ({"rate": 2, "isolate": True}, 0)])
    def test_iterated(self, counting, loop, x, said):
        """A step of the system is made again from its beginning: only where it is made in parts, a part lies behind that."""
        parts = (Component("x", str(counting[2]), **x), Component("z", str(counting[2])))
        links = (Connection("x.twice", "z.u"), Connection("z.y", "x.u"))
        r = run(System("t", H, parts, links, "iterated", stop=STEPS * H, loop=loop))
        assert r["x.y"][-1] == said
        assert r["z.y"][-1] == STEPS


BOOLEAN, REAL = "fmi2Boolean *x) { return fmi2Discard; }", "fmi2Real *x) { return fmi2Discard; }"
AT = "fmi2Real *x) { *x = k == fmi2LastSuccessfulTime ? 0.0095 : -1; return fmi2OK; }"
ENDED = "fmi2Boolean *x) { *x = k == fmi2Terminated; return fmi2OK; }"
WENT_ON = "fmi2Boolean *x) { *x = 0; return fmi2OK; }"


@pytest.mark.parametrize("loop", ["python", "compiled"])
@pytest.mark.parametrize(
    ("status", "changes", "text"),
    [
        ("fmi2Discard", [(BOOLEAN, ENDED), (REAL, AT)],
         "asks for the end of the simulation (fmi2Terminated at t = 0.0095 s (fmi2LastSuccessfulTime)); if that is meant, give the run an "
         "end before it: stop, or an output that says so as stop_when"),
        ("fmi2Discard", [(BOOLEAN, WENT_ON), (REAL, AT)],
         "did not make the whole step (fmi2Discard) and stopped at t = 0.0095 s (fmi2LastSuccessfulTime): a smaller step may help, "
         "or rate = 2 in [components.x]"),
        ("fmi2Discard", [], "did not make the whole step (fmi2Discard) and stopped, it does not say when: a smaller step may help"),
        ("fmi2Discard", [("2Status fmi2GetBooleanStatus(", "2Status other("), ("2Status fmi2GetRealStatus(", "2Status another(")],
         "did not make the whole step (fmi2Discard) and stopped, it does not say when"),
        ("fmi2Pending", [], "goes on in the background (fmi2Pending), which is not supported: export the FMU without "
         "canRunAsynchronuously"),
    ],
    ids=["terminated", "discarded", "silent", "without the functions", "pending"],
)  # fmt: skip
def test_a_step_that_is_not_made(tmp_path, loop, status, changes, text):
    source = changed(c_fmu.SOURCE, ("return m->v.u > 50 ? fmi2Warning : fmi2OK;", f"return t > 0.007 ? {status} : fmi2OK;"), *changes)
    file = c_fmu.build(tmp_path, source)
    with pytest.raises(RunError) as caught:
        run(System("t", H, (Component("x", str(file)),), stop=1.0, loop=loop), tmp_path / "run")
    assert "fmi2DoStep(t = 0.008, h = 0.004) " + text in str(caught.value)
    assert list(Run.load(tmp_path / "run").t) == [0.0, 0.004, 0.008]  # nothing already computed is lost


def test_a_value_that_is_discarded_is_no_step(tmp_path):
    source = changed(c_fmu.SOURCE, ("if (vr[i] == 0) m->v.u = x[i];", "if (vr[i] == 0) return fmi2Discard;"))
    with pytest.raises(RunError, match=r"fmi2SetReal returned 2 \(discard\)"):
        run(System("t", H, (Component("x", str(c_fmu.build(tmp_path, source))),), stop=1.0))


@pytest.mark.parametrize("loop", ["python", "compiled"])
def test_a_step_that_is_not_made_in_fmi3(tmp_path, loop):
    source = changed(c_fmu3.SOURCE, ("*last = t + h;", "*last = t + h; if (t > 0.007) { *last = 0.0095; return fmi3Discard; }"))
    with pytest.raises(RunError) as caught:
        run(System("t", H, (Component("x", str(c_fmu3.build(tmp_path, c_fmu3.PLAIN, source))),), stop=1.0, loop=loop))
    assert "did not make the whole step (fmi3Discard) and stopped at t = 0.0095 s (lastSuccessfulTime): a smaller step" in str(caught.value)


CLOCKS = """<Clock name="tick" valueReference="90" causality="input" intervalVariability="triggered"/>
  <Clock name="tock" valueReference="91" causality="output" intervalVariability="triggered"/>
 </ModelVariables>"""


class TestWarnings:
    """What a run with an FMU goes on without is said before it, and stands in run.toml."""

    @pytest.mark.parametrize("isolate", [False, True])
    def test_fmi2(self, tmp_path, isolate):
        text = changed(
            c_fmu.DESCRIPTION,
            ('modelIdentifier="euler"', 'modelIdentifier="euler" needsExecutionTool="true"'),
            ('generationTool="cc"', 'generationTool="Tool 7"'),
            ('min="-1e6" max="1e6"', 'min="5" max="-1"'),
        )
        system = System("t", H, (Component("x", str(c_fmu.build(tmp_path, description=text)), isolate=isolate),), stop=STEPS * H)
        r = run(system, tmp_path / "run")
        assert r["x.y"][-1] == pytest.approx(0.5 * STEPS * H, rel=ROUNDOFF)  # below the minimum, above the maximum
        assert r.info["warnings"][:2] == [
            "component 'x': the FMU does not run by itself (needsExecutionTool): it needs Tool 7 on this machine",
            "component 'x': minimum 5 of variable 'y' is above its maximum -1: neither is checked",
        ]

    def test_clocks(self, tmp_path):
        file = c_fmu3.build(tmp_path, changed(c_fmu3.PLAIN, (" </ModelVariables>", CLOCKS)))
        with assemble(System("t", H, (Component("x", str(file)),))) as made:
            assert made.wiring.warnings[:2] == (
                "component 'x': input clock 'tick' never ticks, as event mode is not supported: what it would start stays as it is",
                "component 'x': output clock 'tock' is not listened to, as event mode is not supported",
            )


class TestTwoLibraries:
    """A library that needs another beside it, which it does not say a path of."""

    def make(self, folder: Path, *options: str, beside: bool = True) -> Path:
        (folder / "helper.c").write_text("double helper(void) { return 7.0; }\n")
        helper = folder / f"libhelper{c_fmu.SUFFIX}"
        cc, headers = str(c_fmu.compiler()), f"-I{Path(fmpy.__file__).parent / 'c-code'}"
        subprocess.run([cc, "-shared", "-fPIC", *options, str(folder / "helper.c"), "-o", str(helper)], check=True)
        source = changed(
            c_fmu.SOURCE, ("m->v.y += h * m->v.gain * m->v.u;", "m->v.y = helper();"), ("typedef", "double helper(void);\ntypedef")
        )
        (folder / "euler.c").write_text(source)
        library = folder / f"euler{c_fmu.SUFFIX}"
        subprocess.run(
            [cc, "-shared", "-fPIC", "-w", headers, str(folder / "euler.c"), f"-L{folder}", "-lhelper", "-o", str(library)], check=True
        )
        place = f"binaries/{fmpy.platform}"
        files = {f"{place}/{library.name}": library.read_bytes()}
        if beside:
            files[f"{place}/{helper.name}"] = helper.read_bytes()
        return c_fmu.pack(folder / "euler.fmu", c_fmu.DESCRIPTION, files)

    @pytest.mark.parametrize("isolate", [False, True])
    def test_runs_and_leaves_nothing(self, tmp_path, isolate):
        file = self.make(tmp_path, "-Wl,-soname,libhelper.so")
        for _ in range(2):
            r = run(System("t", H, (Component("x", str(file), isolate=isolate),), stop=STEPS * H))
            assert r["x.y"][-1] == 7.0
        maps = Path("/proc/self/maps")
        assert not maps.is_file() or "libhelper" not in maps.read_text()

    def test_check_runs_it_too(self, tmp_path):
        results = {r.check: r for r in check_fmu(self.make(tmp_path, "-Wl,-soname,libhelper.so"))}
        assert results["runs in a fresh process"].outcome == "passed", results["runs in a fresh process"]

    def test_one_that_is_not_there(self, tmp_path):
        with pytest.raises(SystemFileError, match=r"its binary cannot be loaded: libhelper.so: cannot open shared object file"):
            assemble(System("t", H, (Component("x", str(self.make(tmp_path, beside=False))),)))

    def test_one_without_a_name(self, tmp_path):
        with pytest.raises(SystemFileError, match=r"it stands beside it, but does not say its own name \(SONAME\)"):
            assemble(System("t", H, (Component("x", str(self.make(tmp_path))),)))


def test_a_step_that_is_no_whole_number_of_nanoseconds():
    with pytest.raises(
        SystemFileError,
        match=r"step = 0.0333\d* s is not a positive whole .* is counted; the nearest is 0.033333333 s; choose such a number$",
    ):
        run(System("t", 1 / 30, (), stop=1.0))


def test_an_fmu_that_says_nothing_has_no_warnings(tmp_path):
    slave = FmuSlave(c_fmu.build(tmp_path))
    assert slave.warnings == ()
    slave.close()
