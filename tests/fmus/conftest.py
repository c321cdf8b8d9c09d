"""FMUs for the tests, built once per session."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from fmus.components import COMPONENTS
from fmus.python.builder import build
from tests.fmus import demo


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Path of the Python FMU of a component, or of the demo model."""
    folder = tmp_path_factory.mktemp("fmus")

    def path(name: str) -> Path:
        file = folder / f"{name}.fmu"
        return file if file.is_file() else build(demo.MODEL if name == "demo" else COMPONENTS[name], file)

    return path
