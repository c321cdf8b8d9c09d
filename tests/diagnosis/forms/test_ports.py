"""What there is to explain at a port."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from robomill.diagnosis.forms.ports import _rms
from tests.tolerances import ROUNDOFF


@pytest.mark.parametrize(("size", "there"), [(1e-9, False), (1e-7, True)])
def test_a_gap_that_is_roundoff_of_what_was_measured_is_none(size: float, there: bool) -> None:
    replay: Any = SimpleNamespace(mean=np.stack([np.ones(100), np.full(100, 1e6)], axis=1))
    gap = [np.full((100, 1), size)]
    assert _rms([replay], gap, [0]) == pytest.approx(size if there else 0.0, rel=ROUNDOFF)
    assert _rms([replay], gap, [1]) == 0.0
