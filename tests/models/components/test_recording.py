"""robomill.models.components.recording: recorded outputs in place of a component."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from robomill.models.components.recording import HOLD, LINEAR, ReplayModel, from_specification, replay_model
from robomill.models.model.declaration import FloatArray, Model, Variable, record
from tests.tolerances import EXACT, ROUNDOFF

ORIGINAL = Model(
    "axis",
    "What is recorded",
    (
        Variable("u", "input", "In", "m", (2,)),
        Variable("switch", "input", "Switch", kind="boolean"),
        Variable("block", "output", "Line", kind="integer"),
        Variable("q", "output", "Angles", "rad", (2,), display_unit="deg"),
        Variable("on", "output", "Switched on", kind="boolean", depends_on=("switch",)),
        Variable("power", "output", "Power", "W", minimum=0.0),
        Variable("codes", "output", "Codes", kind="integer", shape=(2,)),
    ),
    lambda s: 0,
    lambda s, t, h: 0,
)
N, H = 26, 0.004
TIMES = H * np.arange(N)
COLUMNS: dict[str, FloatArray] = {
    "q": np.column_stack([np.sin(9.0 * TIMES), 3.0 - TIMES**2]),
    "power": 100.0 * TIMES,
    "block": np.arange(N) // 5 * 10.0,
    "on": (np.arange(N) % 2).astype(float),
    "codes": np.column_stack([np.arange(N), -np.arange(N)]).astype(float),
}


class Replay:
    """One instance."""

    def __init__(self, compiled: bool = True, model: ReplayModel | None = None, **parameters: Any) -> None:
        self.model = model or replay_model(ORIGINAL, TIMES, COLUMNS)
        self.data = self.model.new()
        for name, value in parameters.items():
            self.data[name] = value
        self.s = record(self.data)
        self.init, self.step = self.model.compiled() if compiled else self.model.plain()

    def outputs(self) -> list[float]:
        return np.concatenate([np.ravel(self.data[n][0]).astype(float) for n in ("q", "power", "block", "on", "codes")]).tolist()

    def at(self, time: float) -> list[float]:
        assert self.step(self.s, time - H, H) == 0, self.model.message(1, self.s, time)
        return self.outputs()


def recorded(row: int) -> list[float]:
    return np.concatenate([np.ravel(COLUMNS[n][row]) for n in ("q", "power", "block", "on", "codes")]).tolist()


def test_it_has_the_ports_of_what_it_stands_for_and_follows_no_input() -> None:
    replay = replay_model(ORIGINAL, TIMES, COLUMNS)
    for v in ORIGINAL.variables:
        w = replay.variable(v.name)
        assert (w.causality, w.unit, w.shape, w.kind, w.minimum, w.display_unit) == (
            v.causality,
            v.unit,
            v.shape,
            v.kind,
            v.minimum,
            v.display_unit,
        )
        assert w.depends_on == (() if v.causality == "output" else None)
    assert replay.name == "replay_of_axis"
    assert replay.columns == ("t", "power", "q[1]", "q[2]", "block", "on", "codes[1]", "codes[2]")


@pytest.mark.parametrize("compiled", [True, False])
def test_recorded_times_give_the_recorded_values_bit_by_bit(compiled: bool) -> None:
    replay = Replay(compiled)
    assert replay.init(replay.s) == 0
    assert replay.outputs() == recorded(0)
    for k in range(1, N):
        assert replay.step(replay.s, (k - 1) * H, H) == 0
        assert np.abs(np.array(replay.outputs()) - recorded(k)).max() == EXACT


def test_between_recorded_times_reals_go_straight_and_whole_numbers_hold() -> None:
    replay = Replay()
    between = 0.25 * np.array(recorded(11)[:3]) + 0.75 * np.array(recorded(12)[:3])
    found = np.array(replay.at(11.75 * H))
    assert np.abs(found[:3] / between - 1.0).max() < ROUNDOFF
    assert found[3:].tolist() == recorded(11)[3:]
    assert Replay(interpolation=HOLD).at(11.75 * H) == recorded(11)
    assert Replay(model=replay_model(ORIGINAL, TIMES, COLUMNS, interpolation=HOLD)).at(11.75 * H) == recorded(11)
    assert Replay(interpolation=LINEAR).at(11.75 * H) == found.tolist()


def test_times_may_be_visited_in_any_order() -> None:
    replay = Replay()
    for k in (20, 3, 25, 0, 24, 1):
        assert replay.at(k * H) == recorded(k)


def test_an_offset_shifts_the_recording() -> None:
    replay = Replay(time_offset=5 * H)
    assert replay.init(replay.s) == 0
    assert replay.outputs() == recorded(5)
    assert replay.at(2 * H) == recorded(7)


def test_plain_and_compiled_agree_everywhere() -> None:
    plain, compiled = Replay(False), Replay(True)
    for time in np.random.default_rng(4).uniform(0.0, TIMES[-1], 200):
        assert plain.at(float(time)) == compiled.at(float(time))


@pytest.mark.parametrize("time", [-0.001, TIMES[-1] + 0.001])
def test_outside_of_the_recording_it_stops_with_a_message(time: float) -> None:
    replay = Replay()
    status = replay.step(replay.s, time - H, H)
    text = replay.model.message(status, replay.s, time)
    assert text.startswith(f"replay_of_axis: time {time} s lies outside the recording, which goes from 0.0 s to 0.1 s; shift it with")


def test_roundoff_at_the_end_is_not_outside() -> None:
    assert Replay().at(float(np.nextafter(TIMES[-1], 1.0))) == recorded(N - 1)


def test_an_empty_or_disordered_table_is_refused() -> None:
    replay = Replay()
    replay.model.load_table(replay.data, "recording", np.zeros((0, 8)))
    assert (
        replay.model.message(replay.init(replay.s), replay.s, 0.0)
        == "replay_of_axis: the recording is empty; name a file in the parameter recording"
    )
    rows = np.zeros((3, 8))
    rows[:, 0] = 0.0, 1.0, 1.0
    replay.model.load_table(replay.data, "recording", rows)
    text = replay.model.message(replay.init(replay.s), replay.s, 0.0)
    assert text == "replay_of_axis: the times of the recording do not increase from row 1 (counted from zero) to the next"


def test_its_specification_makes_it_again() -> None:
    replay = replay_model(ORIGINAL, TIMES, COLUMNS, name="again")
    remade = from_specification(json.loads(json.dumps(replay.specification)), replay.default_tables["recording"])
    assert remade.name == "again"
    assert remade.dtype == replay.dtype
    assert Replay(model=remade).at(7 * H) == recorded(7)


@pytest.mark.parametrize(
    ("times", "columns", "text"),
    [
        (
            TIMES,
            {k: v for k, v in COLUMNS.items() if k != "q"},
            "recording of 'axis': missing columns q; outputs are block, q, on, power, codes",
        ),
        (TIMES, {**COLUMNS, "w": TIMES}, "recording of 'axis': unknown columns w"),
        (TIMES, {**COLUMNS, "q": TIMES}, r"recording of 'axis': q has shape \(26,\), expected \(26, 2\)"),
        (TIMES[::-1], COLUMNS, "times must be one increasing array"),
        (TIMES[:0], COLUMNS, "times must be one increasing array of at least one instant"),
    ],
)
def test_a_recording_that_does_not_fit_is_refused(times: FloatArray, columns: dict[str, FloatArray], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        replay_model(ORIGINAL, times, columns)


def test_matrices_cannot_be_recorded() -> None:
    model = Model("m", "d", (Variable("R", "output", "Matrix", shape=(3, 3)),), lambda s: 0, lambda s, t, h: 0)
    with pytest.raises(ValueError, match=r"output 'R' has shape \(3, 3\); a recording holds scalars and vectors"):
        replay_model(model, TIMES, {"R": np.zeros((N, 3, 3))})
