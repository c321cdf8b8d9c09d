"""robomill.models.model.cache: compiled code is kept under the hash of the sources that it was made from."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import ModuleType

import pytest

from robomill.models.model.cache import _key, compiled_before, compiled_code, source_files
from robomill.models.model.calls import check_kernels
from robomill.user_cache import IN_USE, prune, user_folder

MODEL = """
from robomill.models.model.declaration import Model, Variable
from helpers import gain

def init(s):
    return 0

def step(s, t, h):
    s.y = gain()
    return 0

MODEL = Model("edited", "A model with a helper elsewhere", (Variable("y", "output", "Out"),), init, step)
"""
RUN = """
import edited
from robomill.models.model.declaration import record
_, step = edited.MODEL.compiled()
data = edited.MODEL.new()
step(record(data), 0.0, 1.0)
print(float(data["y"][0]), sum(step.stats.cache_hits.values()))
"""


def test_an_edit_in_a_function_called_from_another_file_is_noticed(tmp_path: Path) -> None:
    """Numba's own cache would go on with the old function."""
    (tmp_path / "edited.py").write_text(MODEL, encoding="utf-8")
    (tmp_path / "run.py").write_text(RUN, encoding="utf-8")
    helper = "from robomill.models.model.declaration import kernel\n\n@kernel\ndef gain():\n    return {}\n"

    def run(value: float) -> str:
        (tmp_path / "helpers.py").write_text(helper.format(value), encoding="utf-8")
        environment = {**os.environ, "ROBOMILL_CACHE_DIR": str(tmp_path / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
        done = subprocess.run([sys.executable, "run.py"], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()

    assert run(1.0) == "1.0 0"
    assert run(1.0) == "1.0 1"
    assert run(2.0) == "2.0 0"


def test_numbas_folder_is_set_for_our_functions_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import numba

    monkeypatch.setenv("ROBOMILL_CACHE_DIR", str(tmp_path))
    before = numba.config.CACHE_DIR
    with compiled_code(prune):
        assert Path(numba.config.CACHE_DIR).parent == tmp_path / "numba"
        assert Path(numba.config.CACHE_DIR).is_dir()
    assert before == numba.config.CACHE_DIR


def test_a_folder_that_cannot_be_made_leaves_numba_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import numba

    (tmp_path / "file").write_text("", encoding="utf-8")
    monkeypatch.setenv("ROBOMILL_CACHE_DIR", str(tmp_path / "file"))
    before = numba.config.CACHE_DIR
    with compiled_code(prune):
        assert before == numba.config.CACHE_DIR


def test_folders_used_longest_ago_are_removed(tmp_path: Path) -> None:
    for i, name in enumerate("abcde"):
        (tmp_path / name).mkdir()
        os.utime(tmp_path / name, (i, i))
    prune(tmp_path, "a", kept=2)
    assert sorted(f.name for f in tmp_path.iterdir()) == ["a", "d", "e"]
    prune(tmp_path / "missing", "a")


def test_a_folder_that_another_process_may_run_from_stays_however_many_there_are(tmp_path: Path) -> None:
    for name, age in (("a", 0.0), ("b", 0.9 * IN_USE), ("c", 1.1 * IN_USE)):
        (tmp_path / name).mkdir()
        os.utime(tmp_path / name, (time.time() - age,) * 2)
    prune(tmp_path, "a", kept=0)
    assert sorted(f.name for f in tmp_path.iterdir()) == ["a", "b"]


def test_sources_are_those_imported_directly_through_others_and_inside_functions() -> None:
    files = source_files("robomill.models.components.milling_force")
    assert {
        "robomill.models.components.milling_force",
        "robomill.models.process.dexels",
        "robomill.models.maths.elementary",
        "robomill.models.model.declaration",
        "robomill.models.model.cache",
    } <= set(files)
    assert "robomill.models" not in files  # only passed through
    assert "robomill.models.components.sensor_chain" not in files
    assert not [name for name in files if name.startswith(("numba", "numpy", "tests"))]
    with pytest.raises(ModuleNotFoundError, match=r"no source file of module 'robomill\.models\.nothing'"):
        source_files("robomill.models.nothing")


def test_relative_imports_and_packages_that_hold_something_are_followed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "followed_package"
    (package / "inner").mkdir(parents=True)
    (package / "__init__.py").write_text("VALUE = 1\n")
    (package / "model.py").write_text("from .inner.part import x\nfrom . import VALUE, other\n")
    (package / "other.py").write_text("")
    (package / "inner" / "__init__.py").write_text("")
    (package / "inner" / "part.py").write_text("from ..other import y\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert sorted(source_files("followed_package.model")) == [
        "followed_package",
        "followed_package.inner.part",
        "followed_package.model",
        "followed_package.other",
    ]


def test_a_file_under_the_name_of_another_one_before_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Components of users are files: two of them may have one name."""
    for folder in ("one", "other"):
        file = tmp_path / folder / "twin.py"
        file.parent.mkdir()
        file.write_text("")
        module = ModuleType("twin")
        module.__file__ = str(file)
        monkeypatch.setitem(sys.modules, "twin", module)
        assert source_files("twin") == {"twin": file}


def test_the_key_depends_on_functions_and_compiler() -> None:
    assert _key((prune,), "1") == _key((prune,), "1")
    assert _key((prune,), "1") != _key((prune,), "2")


@pytest.mark.parametrize(
    ("platform", "variables", "expected"),
    [
        ("linux", {"XDG_CACHE_HOME": "/x"}, "/x/robomill"),
        ("win32", {"LOCALAPPDATA": "/local"}, "/local/robomill"),
        ("darwin", {"HOME": "/home/u"}, "/home/u/Library/Caches/robomill"),
        ("linux", {"ROBOMILL_CACHE_DIR": "/own"}, "/own"),
    ],
)
def test_the_users_cache_folder_is_where_the_platform_has_it(
    monkeypatch: pytest.MonkeyPatch, platform: str, variables: dict[str, str], expected: str
) -> None:
    monkeypatch.setattr(sys, "platform", platform)
    monkeypatch.delenv("ROBOMILL_CACHE_DIR", raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert user_folder() == Path(expected)


def test_threads_may_look_for_sources_side_by_side() -> None:
    """CPython 3.11 mixes up the depths of trees that are parsed while the garbage collector changes threads."""
    before, interval = gc.get_threshold(), sys.getswitchinterval()
    change_threads = lambda *_: sum(range(50))  # noqa: E731
    gc.callbacks.append(change_threads)
    gc.set_threshold(50, 2, 2)
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(4) as pool:
            found = list(pool.map(lambda _: source_files("robomill.models.components.robot_drive"), range(8)))
    finally:
        gc.callbacks.remove(change_threads)
        gc.set_threshold(*before)
        sys.setswitchinterval(interval)
    assert all(f == found[0] for f in found)


def test_sources_that_have_not_changed_are_not_read_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROBOMILL_CACHE_DIR", str(tmp_path))
    first = _key((prune,), "1")
    monkeypatch.setattr("robomill.models.model.cache.source_files", lambda module: pytest.fail("followed imports again"))
    assert _key((prune,), "1") == first
    (stamps,) = (tmp_path / "sources").rglob("stamps.json")
    stamps.write_text("{", encoding="utf-8")  # cut off: as if it were not there
    monkeypatch.undo()
    monkeypatch.setenv("ROBOMILL_CACHE_DIR", str(tmp_path))
    assert _key((prune,), "1") == first


def test_a_source_that_has_changed_has_another_key_and_one_that_is_touched_has_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROBOMILL_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.syspath_prepend(tmp_path)
    source = tmp_path / "stamped_module.py"
    source.write_text("def f():\n    return 1\n", encoding="utf-8")
    function = __import__("stamped_module").f
    first = _key((function,), "1")
    os.utime(source, (1, 1))
    assert _key((function,), "1") == first
    source.write_text("def f():\n    return 2\n", encoding="utf-8")
    assert _key((function,), "1") != first


def test_whether_sources_were_compiled_before_is_known_by_their_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROBOMILL_CACHE_DIR", str(tmp_path))
    assert not compiled_before(prune)
    with compiled_code(prune):
        pass
    assert compiled_before(prune)
    assert not compiled_before(check_kernels)
