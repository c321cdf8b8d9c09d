"""Components by name, entry point, module and file; what is wrong with one is said in one sentence."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from robomill.cell.binding import convert, resolve
from robomill.cell.equipment import load_system
from robomill.fmus import components
from robomill.fmus.components import COMPONENTS, NAMES, component, home, is_component
from robomill.models.model.calls import check_fields, check_kernels
from robomill.orchestration.assembly import run
from robomill.orchestration.errors import SystemFileError
from tests.fmus import demo

PAGE = Path(__file__).parents[2] / "docs" / "tutorials" / "write_a_component.md"


@pytest.fixture
def smoother(tmp_path: Path) -> Iterator[Path]:
    """The model of docs/tutorials/write_a_component.md in a file."""
    before = list(sys.path), set(sys.modules)
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    file = tmp_path / "smoother.py"
    file.write_text(code, encoding="utf-8")
    yield file
    sys.path[:] = before[0]
    for name in set(sys.modules) - before[1]:
        if getattr(sys.modules[name], "__file__", None) == str(file):
            del sys.modules[name]


def offered(monkeypatch: pytest.MonkeyPatch, *entries: tuple[str, str]) -> None:
    found = tuple(EntryPoint(name, value, components.GROUP) for name, value in entries)
    monkeypatch.setattr(components, "_offered", lambda: found)


def test_the_page_of_the_documentation_runs_from_a_file_beside_the_system(smoother: Path) -> None:
    system = smoother.with_name("system.toml")
    system.write_text(
        'name = "s"\nstep = "4 ms"\n[components.a]\nsource = "python:smoother.py:MODEL"\n'
        'parameters = { share = 0.5 }\ninputs = { x = "8 N" }\n'
    )
    made = run(load_system(system), stop=0.008, resolver=resolve, convert=convert)
    assert made["a.y"].tolist() == [8.0, 8.0, 8.0]
    assert home(component(f"{smoother}:MODEL")) == ("smoother", "MODEL")
    system.write_text(system.read_text().replace("0.5", "2"))
    with pytest.raises(Exception, match=r"share is 2 at t = 0 s; expected 0 to 1"):
        run(load_system(system), stop=0.008, resolver=resolve, convert=convert)


def test_what_packages_offer_stands_after_the_shipped_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    offered(monkeypatch, ("demo", "tests.fmus.demo:MODEL"))
    assert list(COMPONENTS) == [*NAMES, "demo"]
    assert COMPONENTS["demo"] is component("demo") is demo.MODEL
    assert is_component("demo")
    assert is_component("python:x:Y")
    assert not is_component("replay:runs/1")


@pytest.mark.parametrize(
    ("entries", "name", "text"),
    [
        ([], "demo", "unknown component 'demo'; available: path_interpolator, robot_drive"),
        ([("sensor_chain", "a:B")], "sensor_chain", "component 'sensor_chain' is offered by a:B and by robomill; rename one, or uninstall"),
        ([("x", "a:B"), ("x", "c:D")], "x", "component 'x' is offered by a:B and by c:D; rename one, or uninstall"),
        ([("x", "no.such:B")], "x", "component 'x', offered by no.such:B: No module named 'no'; install the package that has it"),
        (
            [("x", "tests.fmus.demo:MODEL")],
            "x",
            "component 'x', offered by tests.fmus.demo:MODEL: the model is called 'demo'; give both one",
        ),
        ([("x", "tests.fmus.demo:np")], "x", "np is a module; expected a robomill.models.model.declaration.Model"),
        ([("x", "tests.fmus.demo:MODLE")], "x", "module tests.fmus.demo has no 'MODLE'; models in it: MODEL"),
    ],
)
def test_offers_that_cannot_be_used(monkeypatch: pytest.MonkeyPatch, entries: list[tuple[str, str]], name: str, text: str) -> None:
    offered(monkeypatch, *entries)
    with pytest.raises(ValueError, match=re.escape(text)):
        component(name)


def test_files_that_cannot_be_used(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"component 'python:gone\.py:MODEL': no file gone\.py"):
        component("python:gone.py:MODEL")
    with pytest.raises(ValueError, match=r"component 'python:gone\.py': expected python:package\.module:MODEL or python:file\.py:MODEL"):
        component("python:gone.py")
    (tmp_path / "numpy.py").write_text("")
    with pytest.raises(ValueError, match=r"the module name 'numpy' is taken by .*; rename the file"):
        component(f"python:{tmp_path / 'numpy.py'}:MODEL")
    broken = tmp_path / "broken_component.py"
    broken.write_text("1 / 0\n")
    with pytest.raises(ValueError, match=r"ZeroDivisionError while broken_component is imported: division by zero"):
        component(f"python:{broken}:MODEL")
    sys.path.remove(str(tmp_path))


def test_a_system_says_where_the_source_stands(tmp_path: Path) -> None:
    file = tmp_path / "s.toml"
    file.write_text('name = "s"\nstep = "4 ms"\n[components.a]\nsource = "python:no.such:MODEL"\n')
    with pytest.raises(
        SystemFileError, match=r"s\.toml:3: component 'a': source 'python:no\.such:MODEL': .*No module named 'no'; install the package"
    ):
        run(load_system(file), stop=0.004, resolver=resolve, convert=convert)


def test_a_helper_without_kernel_is_named_with_its_caller(smoother: Path) -> None:
    smoother.write_text(smoother.read_text().replace("@kernel\ndef", "def"))
    model = component(f"{smoother}:MODEL")
    text = r"smoother\.step calls smoother\.smoothed \(.*smoother\.py:4\), which lacks @kernel, .*write @kernel of robomill"
    with pytest.raises(ValueError, match=text):
        check_kernels(model.init, model.step)
    with pytest.raises(ValueError, match=text):
        model.compiled()
    assert model.plain()[0] is model.init  # in plain Python it runs


def test_a_name_that_is_no_variable_is_named_with_its_line(smoother: Path) -> None:
    smoother.write_text(smoother.read_text().replace("s.y = smoothed", "s.yy = smoothed"))
    model = component(f"{smoother}:MODEL")
    with pytest.raises(ValueError, match=r"smoother\.py:\d+: s\.yy is no variable of the model; declare it, or use one of these: .*y"):
        check_fields(model.dtype.names or (), model.init, model.step)
    for name in NAMES:
        found = COMPONENTS[name]
        check_fields(found.dtype.names or (), found.init, found.step)


def test_helpers_are_followed_through_modules_closures_and_each_other() -> None:
    def helper() -> int:
        return 1

    def inner() -> int:
        return helper()

    inner.is_kernel = True  # type: ignore[attr-defined]  # as @kernel does

    def outer() -> int:
        return inner()

    with pytest.raises(ValueError, match=r"inner calls .*helper .*lacks @kernel"):
        check_kernels(outer)
    with pytest.raises(ValueError, match=r"through calls robomill\.fmus\.components\.component "):
        check_kernels(through)
    for name in NAMES:
        check_kernels(COMPONENTS[name].init, COMPONENTS[name].step)


def through() -> object:
    return components.component("x")
