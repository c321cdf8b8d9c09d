"""Lowering: what is refused, and that the machine code is exact and needs nothing."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from robomill.fmus.components import NAMES
from robomill.fmus.interface import Interface
from robomill.fmus.native.data import data_c
from robomill.fmus.native.lower import Lowered, Lowering, NativeBuildError, portable
from robomill.fmus.native.targets import PLATFORMS, Slice, fat, object_code, optimised
from robomill.models.components.recording import replay_model
from robomill.models.model.declaration import Model, Record, Variable
from tests.fmus import native_runs

SLICES = [s for p in PLATFORMS.values() for s in p.slices]


def _model(errors: tuple[str, ...] = ("",)) -> Model:
    variables = (
        Variable("u", "input", "In", "m", (2,)),
        Variable("y", "output", "Out", "m"),
        Variable("n", "state", "Count", kind="integer"),
    )
    return Model("small", "Small", variables, _init, _step, errors)


def _init(s: Record) -> int:
    return 0


def _step(s: Record, t: float, h: float) -> int:
    return 0


def _lower(model: Model) -> Lowered:
    with Lowering() as lowering:
        return lowering.lower(model)


@pytest.fixture(scope="module")
def lowered() -> dict[str, Lowered]:
    with Lowering() as lowering:
        return {name: lowering.lower(native_runs.model(name)) for name in ("demo", *NAMES)}


def test_nothing_but_two_functions_is_seen_and_nothing_outside_is_called(lowered: dict[str, Lowered]) -> None:
    for code in (x.code for x in lowered.values()):
        defined = re.findall(r"^define (?!internal)[^@]*@([\w.]+)", code, re.MULTILINE)
        assert sorted(defined) == ["model_init", "model_step"]
        assert all(name.startswith("llvm.") for name in re.findall(r"^declare [^@]*@([\w.]+)", code, re.MULTILINE))
        assert not re.search(r"_ZN|target triple|target datalayout", code), "names of the order of compilation or of this machine"


@pytest.mark.parametrize("target", SLICES, ids=[s.fmi3 for s in SLICES])
def test_no_processor_fuses_multiplication_and_addition(target: Slice, lowered: dict[str, Lowered]) -> None:
    """apple-m1 has fused instructions, which round once instead of twice; nothing may use them."""
    for name in ("demo", *NAMES):
        machine, module = optimised(lowered[name].code, target)
        assembly = str(machine.emit_assembly(module))
        fused = re.findall(r"\bv?fn?m(?:add|sub|la|ls)\w*", assembly)
        assert not fused, f"{name} for {target.triple}: {fused[:3]}"
        called = set(re.findall(r"^\s+(?:callq?|bl|jmp|b)\s+(?!_?function_)([a-z_]\w+)", assembly, re.MULTILINE))
        assert called <= {"memset", "memcpy", "_memset", "_memcpy", "_bzero", "___bzero", "___chkstk_ms"}, f"{name} for {target.triple}"


def test_objects_are_the_same_each_time(lowered: dict[str, Lowered]) -> None:
    for s in SLICES:
        assert object_code(lowered["demo"].code, s) == object_code(lowered["demo"].code, s)


def test_a_kept_result_is_the_one_that_a_new_process_gives(
    lowered: dict[str, Lowered], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("ROBOMILL_CACHE_DIR", str(tmp_path))
    model = native_runs.model("demo")
    with Lowering() as lowering:
        assert lowering.lower(model) == lowered["demo"]
        (kept,) = (tmp_path / "native").glob("*/demo.json")
        written = kept.stat().st_mtime_ns
        assert lowering.lower(model) == lowered["demo"]
        assert kept.stat().st_mtime_ns == written
        kept.write_text("damaged", encoding="utf-8")
        assert lowering.lower(model) == lowered["demo"]


def test_the_code_does_not_depend_on_the_models_lowered_before(
    lowered: dict[str, Lowered], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A process takes one model after another; here the last is the first."""
    monkeypatch.setenv("ROBOMILL_CACHE_DIR", str(tmp_path))
    with Lowering() as lowering:
        for name in ("inverse_dynamics", "demo"):
            assert lowering.lower(native_runs.model(name)) == lowered[name]


def test_what_was_found_by_trying_is_what_python_finds(lowered: dict[str, Lowered]) -> None:
    from robomill.fmus import probe

    interface = Interface(native_runs.model("demo"))
    assert lowered["demo"].variable_step == probe.accepts_other_steps(interface)
    assert lowered["demo"].initial_dependencies == probe.initial_dependencies(interface)


MODULE = """
from robomill.models.model.declaration import Model, Variable

def init(s):
    {init}
    return 0

def step(s, t, h):
    {step}

MODEL = Model("odd", "Odd", (Variable("u", "input", "In"), Variable("y", "output", "Out")), init, step)
"""


@pytest.mark.parametrize(
    ("init", "step", "expected"),
    [
        ("pass", "return 0.5", "step returns float64; expected a status, an integer"),
        ("print(s.u)", "return 0", r"the code calls .*Py\w+.*, which only exist inside Python"),
        ("s.y = undefined", "return 0", "undefined"),
    ],
)
def test_what_needs_python_is_refused(init: str, step: str, expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from importlib import import_module

    name = f"odd_{abs(hash((init, step)))}"
    (tmp_path / f"{name}.py").write_text(MODULE.format(init=init, step=step), encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(NativeBuildError, match=rf"(?s)model 'odd': cannot be lowered: .*{expected}"):
        _lower(import_module(name).MODEL)


def test_a_model_that_no_module_holds_is_refused() -> None:
    with pytest.raises(NativeBuildError, match=r"its step stands in module '[\w.]+', and no module of the package '\w+' holds"):
        _lower(_model())


@pytest.mark.parametrize("mark", ["fast", "contract", "reassoc"])
def test_arithmetic_that_may_be_contracted_is_refused(mark: str) -> None:
    code = f"define double @f(double %x) {{\n  %y = fmul {mark} double %x, %x\n  ret double %y\n}}\n"
    with pytest.raises(NativeBuildError, match=f"arithmetic marked '{mark}', which processors round differently"):
        portable([("g", "f", code)])


def test_a_square_root_becomes_an_instruction() -> None:
    code = "declare double @sqrt(double)\ndefine double @f(double %x) {\n  %y = call double @sqrt(double %x)\n  ret double %y\n}\n"
    found = portable([("g", "f", code)])
    assert "call double @llvm.sqrt.f64(double %0)" in found
    assert "@sqrt(" not in found


@pytest.mark.parametrize(
    ("message", "expected"),
    [
        ("{z}", "no such field: 'z'"),
        ("{u[2]}", r"'u\[2\]' is out of range"),
        ("{y[0]}", r"no such field: 'y\[0\]'"),
        ("{y:>8}", "'y' has a format that C does not know: '>8'"),
        ("{y!r}", "'y' has a format that C does not know"),
    ],
)
def test_a_message_that_c_cannot_show_is_refused(message: str, expected: str) -> None:
    with pytest.raises(NativeBuildError, match=expected):
        data_c(Interface(_model(("", message))), "{}")


@pytest.mark.parametrize("dimensions", [4, 5])
def test_a_variable_has_four_dimensions_at_most(dimensions: int) -> None:
    """The places of `shape` in shim/component.h."""
    variables = (Variable("u", "input", "In", "m", (2,) * dimensions), Variable("y", "output", "Out", "m"))
    interface = Interface(Model("many", "Many", variables, _init, _step))
    if dimensions == 4:
        assert "{2, 2, 2, 2}" in data_c(interface, "token")
    else:
        with pytest.raises(NativeBuildError, match="has 5 dimensions; at most 4 are possible"):
            data_c(interface, "token")


def test_messages_become_tables() -> None:
    text = data_c(Interface(_model(("", 'a "{u}" of {u[1]:.3f} m? {n} or {n:g} at {t:g} s'))), "{}")
    assert '{"a \\042", \'r\', "", 0, 2},' in text
    assert '{"\\042 of ", \'r\', "%.3f", 1, 0},' in text
    assert '{" m\\077 ", \'i\', "", 3, 0},' in text
    assert '{" or ", \'n\', "%g", 3, 0},' in text
    assert '{" at ", \'t\', "%g", 0, 0},' in text


def test_a_recording_is_lowered_too() -> None:
    model = native_runs.model("robot_compliance")
    times = np.arange(50) * 0.004
    outputs = [v for v in model.variables if v.causality == "output"]
    recorded = replay_model(model, times, {v.name: np.outer(np.sin(times), np.ones(v.shape or 1)).reshape(50, *v.shape) for v in outputs})
    assert "@model_step" in _lower(recorded).code
    assert "static const double ROWS_0[]" in data_c(Interface(recorded), "{}")


def test_a_fat_file_is_aligned() -> None:
    data = fat({"aarch64-darwin": b"a" * 100, "x86_64-darwin": b"b" * 10})
    assert data.index(b"a") == 1 << 14
    assert data.index(b"b" * 10) == 2 << 14
