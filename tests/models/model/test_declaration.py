"""How models are declared: what a variable may be, the record made from it, tables, messages, compiled and plain."""

from __future__ import annotations

import gc
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from robomill.models.model.declaration import Model, Record, Variable, kernel, record
from robomill.models.model.model_code import model_code
from robomill.models.model.table_access import cell
from tests.tolerances import EXACT


@kernel
def decay(x: float, rate: float, h: float) -> float:
    """One explicit Euler step of x' = -rate x."""
    return x - h * rate * x


def init(s: Record) -> int:
    if s.rate < 0.0:
        return 1
    for i in range(2):
        s.level[i] = s.start_level[i]
    s.count = 0
    return 0


def step(s: Record, t: float, h: float) -> int:
    for i in range(2):
        s.level[i] = decay(s.level[i], s.rate, h) + h * s.inflow
    s.count += 1
    return 2 if s.level[0] > 100.0 else 0


INFLOW = Variable("inflow", "input", "Inflow", "m/s")
LEVEL = Variable("level", "output", "Levels", "m", (2,), display_unit="mm", depends_on=("inflow",))
COUNT = Variable("count", "output", "Steps so far", kind="integer", depends_on=())
RATE = Variable("rate", "parameter", "Decay rate", "1/s", (), 2.0, 0.0, 10.0)
START = Variable("start_level", "parameter", "Levels at t = 0", "m", (2,), (1.0, 3.0))
CURVE = Variable("curve", "parameter", "A table", shape=(2,), kind="table")
TANK = Model(
    "tank",
    "Two leaking tanks",
    (RATE, CURVE, COUNT, START, LEVEL, INFLOW),
    init,
    step,
    ("", "rate is {rate} 1/s, expected at least 0", "level 1 is {level[0]:.1f} m at t = {t} s, expected at most 100 m"),
    {"curve": np.array([[0.0, 1.0], [2.0, 5.0]])},
)


def test_a_list_of_whole_numbers_in_a_message_ends_before_its_zeros() -> None:
    numbers = Variable("numbers", "state", "Numbers", shape=(5,), kind="integer", start=(3, 0, 12, 0, 0))
    model = Model("m", "Numbers", (numbers,), init, step, ("", "has {numbers}, first {numbers[0]}"))
    assert model.message(1, record(model.new()), 0.0) == "m: has [3 0 12], first 3"


class TestVariable:
    """One declared variable."""

    def test_elements_are_counted_from_one(self) -> None:
        assert INFLOW.element_names == ("inflow",)
        assert LEVEL.element_names == ("level[1]", "level[2]")
        assert Variable("m", "state", "Matrix", shape=(2, 2)).element_names == ("m[1,1]", "m[1,2]", "m[2,1]", "m[2,2]")

    def test_a_scalar_start_fills_the_array(self) -> None:
        assert replace(LEVEL, start=7.0).start_values.tolist() == [7.0, 7.0]
        assert START.start_values.tolist() == [1.0, 3.0]

    @pytest.mark.parametrize(
        ("change", "text"),
        [
            ({"name": "two words"}, r"variable 'two words': not usable as a record field; choose an identifier"),
            ({"name": "T"}, r"variable 'T': not usable as a record field; choose an identifier that numpy\.record does not own"),
            ({"name": "size"}, r"variable 'size': not usable as a record field"),
            (
                {"unit": "furlong"},
                r"variable 'rate': unknown unit 'furlong'; expected a product of powers of SI units, such as N\.m\.s/rad",
            ),
            ({"display_unit": "furlong"}, r"variable 'rate': unknown unit 'furlong'"),
            ({"unit": "mm"}, r"variable 'rate': unit 'mm' is not SI; use it as display_unit"),
            ({"unit": "degC"}, r"variable 'rate': unit 'degC' is not SI"),
            ({"description": ""}, r"variable 'rate': a description is missing"),
            ({"start": -1.0}, r"variable 'rate': start -1\.0 violates the bound 0\.0 1/s"),
            ({"start": 11.0}, r"variable 'rate': start 11\.0 violates the bound 10\.0 1/s"),
            ({"start": (1.0, 2.0)}, r"variable 'rate': start has shape \(2,\), declared is \(\)"),
            ({"effect": True}, r"variable 'rate': an effect is off, that is zero, by default"),
            ({"kind": "table"}, r"variable 'rate': a table is a parameter of shape \(columns,\)"),
        ],
    )
    def test_a_bad_declaration_is_refused_at_once(self, change: dict[str, Any], text: str) -> None:
        with pytest.raises(ValueError, match=text):
            replace(RATE, **change)

    def test_a_table_cannot_be_an_input(self) -> None:
        with pytest.raises(ValueError, match="a table is a parameter"):
            replace(CURVE, causality="input")


def curve(data: Any) -> list[list[float]]:
    """The rows that a record points to."""
    at, rows = data["curve_at"][0], data["curve_rows"][0]
    return [[float(cell(at, rows, 2, row, column)) for column in range(2)] for row in range(rows)]


class TestRecord:
    """The record that holds an instance."""

    def test_order_is_inputs_outputs_parameters_states_tables(self) -> None:
        """Reals before integers in each, so that inputs and outputs are flat images; tables last, as number and address of their rows."""
        assert TANK.dtype.names == ("inflow", "level", "count", "rate", "start_level", "curve_rows", "curve_at")
        assert TANK.dtype.isalignedstruct
        assert TANK.dtype.itemsize == 8 * (1 + 2 + 1 + 1 + 2 + 2)

    def test_types_follow_the_kind(self) -> None:
        assert TANK.dtype["level"].base == np.float64
        assert TANK.dtype["count"] == np.int64
        assert TANK.dtype["curve_rows"] == np.int64

    def test_a_new_instance_holds_the_starts_and_the_default_table(self) -> None:
        data = TANK.new()
        assert data["rate"][0] == 2.0
        assert data["start_level"][0].tolist() == [1.0, 3.0]
        assert data["curve_rows"][0] == 2
        assert curve(data) == [[0.0, 1.0], [2.0, 5.0]]

    def test_starts_are_set_wherever_they_stand_in_a_large_record(self) -> None:
        """Pages of zeros are not copied."""
        large = (
            Variable("first", "parameter", "Before", start=1.0),
            Variable("x", "state", "Many", shape=(5000,), start=np.where(np.arange(5000) == 4321, -0.0, 0.0)),
            Variable("y", "state", "After", shape=(700,), start=np.where(np.arange(700) == 650, 2.0, 0.0)),
        )
        s = record(Model("large", "", large, lambda s: 0, lambda s, t, h: 0).new())
        assert s.first == 1.0
        assert np.flatnonzero(np.signbit(s.x)).tolist() == [4321]
        assert np.flatnonzero(s.y).tolist() == [650]
        assert s.y[650] == 2.0

    def test_the_record_is_a_view(self) -> None:
        data = TANK.new()
        s = record(data)
        s.rate = 5.0
        s.start_level[1] = 8.0
        assert data["rate"][0] == 5.0
        assert data["start_level"][0, 1] == 8.0

    def test_two_instances_share_nothing(self) -> None:
        one, two = TANK.new(), TANK.new()
        record(one).start_level[0] = 9.0
        assert two["start_level"][0, 0] == 1.0

    def test_loading_a_table_replaces_all_of_it(self) -> None:
        data = TANK.new()
        TANK.load_table(data, "curve", np.array([[7.0, 8.0]]))
        assert data["curve_rows"][0] == 1
        assert curve(data) == [[7.0, 8.0]]

    def test_there_is_no_limit_on_the_rows_of_a_table_and_the_record_stays_as_small(self) -> None:
        data = TANK.new()
        TANK.load_table(data, "curve", np.arange(2e6).reshape(-1, 2))
        assert data["curve_rows"][0] == 1_000_000
        assert cell(data["curve_at"][0], 1_000_000, 2, 999_999, 1) == 2e6 - 1.0
        assert data.nbytes == TANK.new().nbytes

    def test_loaded_rows_stay_as_long_as_the_record_and_cannot_be_changed_behind_it(self) -> None:
        """The record alone is kept, as `init` and `step` have it."""
        data, rows = TANK.new(), np.array([[7.0, 8.0]])
        TANK.load_table(data, "curve", rows)
        rows[:] = 0.0
        s = record(data)
        del data, rows
        gc.collect()
        assert cell(s.curve_at, s.curve_rows, 2, 0, 1) == 8.0

    @pytest.mark.parametrize(
        ("rows", "text"),
        [
            (np.zeros((2, 3)), r"table 'curve' of 'tank': has shape \(2, 3\), expected rows of 2 columns"),
            (np.zeros(2), r"table 'curve' of 'tank': has shape \(2,\), expected"),
            (np.array([[0.0, np.nan]]), r"table 'curve' of 'tank': holds values that are not finite"),
        ],
    )
    def test_a_table_that_does_not_fit_is_refused(self, rows: np.ndarray, text: str) -> None:
        with pytest.raises(ValueError, match=text):
            TANK.load_table(TANK.new(), "curve", rows)


class TestModel:
    """A component's model."""

    def test_a_name_declared_twice_is_refused(self) -> None:
        with pytest.raises(ValueError, match="model 'tank': declared twice: level, rate"):
            replace(TANK, variables=(*TANK.variables, RATE, LEVEL))

    def test_a_dependency_on_no_input_is_refused(self) -> None:
        with pytest.raises(ValueError, match="model 'tank': output 'level' depends on rate; inputs are inflow"):
            replace(TANK, variables=(INFLOW, RATE, replace(LEVEL, depends_on=("inflow", "rate"))))

    def test_a_variable_is_found_by_name(self) -> None:
        assert TANK.variable("rate") is RATE
        with pytest.raises(KeyError, match=r"model 'tank' has no variable 'depth'; it has rate, curve, count, start_level, level, inflow"):
            TANK.variable("depth")

    def test_a_message_carries_the_values(self) -> None:
        s = record(TANK.new())
        s.rate, s.level[0] = -3.0, 123.45
        assert TANK.message(1, s, 0.0) == "tank: rate is -3.0 1/s, expected at least 0"
        assert TANK.message(2, s, 1.5) == "tank: level 1 is 123.5 m at t = 1.5 s, expected at most 100 m"

    @pytest.mark.parametrize("status", [-1, 0, 3])
    def test_a_status_without_message_says_so(self, status: int) -> None:
        assert TANK.message(status, record(TANK.new()), 0.0) == f"tank: status {status} without a message"


class TestRunning:
    """One source, plain and compiled."""

    @staticmethod
    def run(first: Any, second: Any, argument: Any, data: Any) -> list[int]:
        statuses = [first(argument)]
        for k in range(300):
            data["inflow"] = np.sin(0.1 * k)
            statuses.append(second(argument, 0.01 * k, 0.01))
        return statuses

    def test_plain_record_and_compiled_array_agree_to_the_bit(self) -> None:
        plain, compiled, for_data = TANK.new(), TANK.new(), TANK.new()
        expected = self.run(*TANK.plain(), record(plain), plain)
        assert self.run(*TANK.compiled(cache=False), record(compiled), compiled) == expected
        code = model_code(TANK)
        assert self.run(code.init, code.step, for_data.ctypes.data, for_data) == expected
        assert plain.tobytes() == compiled.tobytes() == for_data.tobytes()
        assert plain["count"][0] == 300

    def test_the_step_is_the_euler_step_written_by_hand(self) -> None:
        s = record(TANK.new())
        assert init(s) == 0
        assert step(s, 0.0, 0.25) == 0
        assert np.abs(s.level - [0.5, 1.5]).max() == EXACT

    def test_statuses_come_through(self) -> None:
        data = TANK.new()
        data["rate"] = -1.0
        compiled_init, compiled_step = TANK.compiled(cache=False)
        assert init(record(data)) == compiled_init(record(data)) == 1
        data["rate"], data["level"] = 0.0, 200.0
        assert compiled_step(record(data), 0.0, 0.01) == 2

    def test_compiled_functions_are_made_once(self) -> None:
        assert TANK.compiled(cache=False) is TANK.compiled(cache=False)
        assert model_code(TANK) is model_code(TANK)

    def test_an_array_temporary_is_a_compile_error(self) -> None:
        """Without the Numba runtime nothing can be allocated: a model that needs no heap cannot leak in a native FMU."""

        def allocate(s: Record) -> int:
            total = 0
            for value in s.start_level * 2.0:
                total += int(value)
            return total

        broken = replace(TANK, init=allocate)
        compiled_init, _ = broken.compiled(cache=False)
        with pytest.raises(Exception, match=r"NRT|nrt|Numba runtime"):
            compiled_init(record(broken.new()))

    def test_an_index_out_of_bounds_is_an_error(self) -> None:
        def beyond(s: Record) -> int:
            s.level[int(s.rate)] = 1.0
            return 0

        broken = replace(TANK, init=beyond)
        compiled_init, _ = broken.compiled(cache=False)
        data = broken.new()
        data["rate"] = 7.0
        with pytest.raises(IndexError):
            compiled_init(record(data))
