"""What a variable changed since the start: an axis that another one drags along has one law, wherever its programs start."""

from __future__ import annotations

import numpy as np

from robomill.diagnosis.forms.library import library
from robomill.diagnosis.forms.selection import Rows, choose
from robomill.diagnosis.forms.signals import Variable, value
from robomill.orchestration.slaves.protocol import FloatArray

N, STEP = 600, 0.01
T = np.linspace(0.0, STEP * (N - 1), N)
DRAGGED = 4e-4
"""rad/rad: how much of the motion of the other axis."""
NOISE = 1e-5
"""rad"""


def variables() -> list[Variable]:
    plain = [Variable(f"q[{i}]", False, "rad", 2) for i in (1, 2)]
    moved = [Variable(v.name, False, "rad", 2, since_start=True) for v in plain]
    return [*plain, *moved, Variable("t", False, "s", 0)]


def angles(rng: np.random.Generator, start: float) -> dict[str, FloatArray]:
    phase = rng.uniform(0.0, 6.0, 2)
    return {f"q[{i + 1}]": start * (i + 1) + 0.3 * np.sin((1.3 + i) * T + phase[i]) for i in range(2)}


def test_it_is_zero_at_the_start() -> None:
    known = angles(np.random.default_rng(0), 1.2)
    found = value(variables()[3], known, T)
    assert found is not None
    assert found.tolist() == (known["q[2]"] - known["q[2]"][0]).tolist()
    assert variables()[3].text == "(q[2] - q[2] at t = 0)"


def test_programs_that_start_elsewhere_share_the_law_of_a_dragged_axis() -> None:
    rng = np.random.default_rng(5)
    ports = [angles(rng, start) for start in (0.4, 1.5, -0.9)]
    known = [{v: x for v in variables() if (x := value(v, p, T)) is not None} for p in ports]
    terms = library(known, "1", float(T[-1]), ("value",), "rad")
    X = np.concatenate([np.stack([t.values(k, N) for t in terms], axis=1) for k in known])
    y = np.concatenate([DRAGGED * (p["q[2]"] - p["q[2]"][0]) + NOISE * rng.normal(size=N) for p in ports])
    condition = np.repeat(np.arange(3), N)
    rows = Rows(y, X, condition, condition, np.tile((np.arange(N) + 0.5) / N, 3), STEP)
    offsets = [i for i, t in enumerate(terms) if not t.factors]
    assert [terms[i].text for i in choose(rows, offsets).terms] == ["(q[2] - q[2] at t = 0)"]
