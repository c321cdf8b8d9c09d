"""Numba knows the kernels that tests compile calls of, in whatever order tests are run."""

from __future__ import annotations

import pytest

from robomill.models.model.kernels import tell_numba


@pytest.fixture(scope="package", autouse=True)
def told() -> None:
    """Kernels may have been declared before Numba was there."""
    tell_numba()
