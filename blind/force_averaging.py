"""What reaches the sensor in the generator's world: the mean force over its cycle, plus noise. A model, so that it runs compiled."""

from __future__ import annotations

from collections.abc import Callable

from robomill.fmus.in_process import InProcessSlave
from robomill.models.model.declaration import FloatArray, Model, Record, Variable
from robomill.models.model.table_access import cell
from robomill.orchestration.slaves.protocol import Slave

FINE = 2
"""Communication steps of the generator in one of the recording."""
CHANNELS = 6
"""Force and moment."""


def init(s: Record) -> int:
    """Outputs are the inputs; noise begins with the first step."""
    for i in range(3):
        s.past[0, i] = s.f[i]
        s.past[0, 3 + i] = s.m[i]
        s.past[1, i] = s.f[i]
        s.past[1, 3 + i] = s.m[i]
        s.f_out[i] = s.f[i]
        s.m_out[i] = s.m[i]
    s.row = 0
    return 0


def step(s: Record, t: float, h: float) -> int:
    """Mean of this step and the last one, plus the next row of the noise."""
    rows = int(s.noise_rows)
    row = int(s.row)
    if 0 < rows <= row:
        return 1
    for i in range(3):
        for k in range(2):
            j = 3 * k + i
            s.past[0, j] = s.past[1, j]
            s.past[1, j] = s.f[i] if k == 0 else s.m[i]
            y = (s.past[0, j] + s.past[1, j]) / 2.0
            if rows > 0:
                y = y + cell(s.noise_at, rows, CHANNELS, row, j)
            if k == 0:
                s.f_out[i] = y
            else:
                s.m_out[i] = y
    s.row = row + 1
    return 0


MODEL = Model(
    "felt",
    "Mean force over the cycle of the sensor, plus noise",
    (
        Variable("f", "input", "Force", "N", (3,)),
        Variable("m", "input", "Moment", "N.m", (3,)),
        Variable("f_out", "output", "Mean force plus noise", "N", (3,)),
        Variable("m_out", "output", "Mean moment plus noise", "N.m", (3,)),
        Variable("noise", "parameter", "Noise of each step: force [N], moment [N m]; empty: none", "1", (CHANNELS,), kind="table"),
        Variable("past", "state", "Force and moment of the last two steps", "1", (FINE, 6)),
        Variable("row", "state", "Steps made", "1", kind="integer"),
    ),
    init,
    step,
    ("", "the run is longer than its noise ({noise_rows} steps)"),
)


def felt(noise: FloatArray | None) -> Callable[[], Slave]:
    """A factory of the slave; `noise` is float64[steps, 6] in N and N m, None for none."""

    def make() -> Slave:
        slave = InProcessSlave(MODEL, "felt")
        if noise is not None:
            slave.instance.load_table("noise", noise)
        return slave

    return make
