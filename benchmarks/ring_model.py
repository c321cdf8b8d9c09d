"""The FMU of the ring (`ring.c`) as a model of ours, for in-process components and pythonfmu: the same equation, the same bits."""

from __future__ import annotations

from robomill.models.model.declaration import Model, Record, Variable

N = 12


def init(s: Record) -> int:
    """Outputs at their start values."""
    for i in range(N):
        s.y[i] = i + 1.0
    return 0


def step(s: Record, t: float, h: float) -> int:
    """y[i]' = 2 (u[i + 1] - y[i]), explicit Euler."""
    for i in range(N):
        s.y[i] += 2.0 * h * (s.u[(i + 1) % N] - s.y[i])
    return 0


MODEL = Model(
    "ring",
    "Generic component of a ring",
    (
        Variable("u", "input", "Input", shape=(N,)),
        Variable("y", "output", "Output", shape=(N,), start=[i + 1.0 for i in range(N)], depends_on=()),
    ),
    init,
    step,
)
