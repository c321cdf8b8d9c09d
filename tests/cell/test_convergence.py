"""Time step: the two algorithms differ by one step of delay in the loop force <-> deflection, so their difference is of first order."""

from __future__ import annotations

import numpy as np
import pytest

from docs.studies import deflection, smooth_loop
from tests.tolerances import discretisation


@pytest.mark.slow
def test_jacobi_and_gauss_seidel_converge_to_each_other_with_first_order(tmp_path):
    loop = smooth_loop(tmp_path)
    steps = (4e-3, 2e-3, 1e-3)
    gap = [float(np.max(np.abs(deflection(loop, "jacobi", h) - deflection(loop, "gauss-seidel", h)))) for h in steps]
    # one step of delay times the fastest change of the deflection, at the cutter exit: about 0.6 mm in 40 ms, twice over the two hops
    rate = 2 * 0.6e-3 / 40e-3
    for difference, h in zip(gap, steps, strict=True):
        assert difference <= discretisation(rate, h, 1)
    orders = np.log2(np.array(gap[:-1]) / np.array(gap[1:]))
    assert np.all(orders > 0.75)
