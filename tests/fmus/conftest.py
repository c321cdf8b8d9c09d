"""FMUs for the tests, built once per session."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Literal

import pytest

from robomill.fmus.components import COMPONENTS
from robomill.fmus.native.builder import build as build_native
from robomill.fmus.python.builder import build
from tests.fmus import demo


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Path of the Python FMU of a component, or of the demo model."""
    folder = tmp_path_factory.mktemp("fmus")

    def path(name: str) -> Path:
        file = folder / f"{name}.fmu"
        return file if file.is_file() else build(demo.MODEL if name == "demo" else COMPONENTS[name], file)

    return path


@pytest.fixture(scope="session")
def built_native(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Path of the native FMU (name, FMI version, platforms) of a component, or of the demo model."""
    folder = tmp_path_factory.mktemp("native")

    def path(name: str, fmi: Literal[2, 3] = 2, platforms: tuple[str, ...] = ("linux64",)) -> Path:
        file = folder / f"fmi{fmi}_{'_'.join(platforms)}" / f"{name}.fmu"
        model = demo.MODEL if name == "demo" else COMPONENTS[name]
        return file if file.is_file() else build_native(model, file, fmi=fmi, platforms=platforms)

    return path
