"""Baselines and oracle on a made-up library, where the right answer is known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from robomill.blind.baselines import BASELINES
from robomill.blind.effects import BY_KEY, Instance
from robomill.blind.signatures import FLOOR, STRIDE, Change, Library, clocks, confusable, features, floor
from robomill.blind.world import STEP
from robomill.orchestration.runs.run import Run
from tests.tolerances import ROUNDOFF

ROWS = 100
COLUMNS = ("drive.q_motor[1]", "sensor.f_T_T[1]", "compliance.p_BT_B[1]")


@pytest.fixture
def library():
    """Three effects: one in each column, the third one half like the second."""
    t = np.linspace(0.0, 1.0, ROWS)
    shapes = np.zeros((3, len(COLUMNS), ROWS))
    shapes[0, 0] = np.sin(6 * t)
    shapes[1, 1] = t
    shapes[2, 1], shapes[2, 2] = t, 1.0 - t
    names = ("drive.backlash", "sensor.sensor_gain_error", "compliance.tool_compliance")
    candidates = tuple(Instance(BY_KEY[n], 1 if BY_KEY[n].size else 0, 1.0) for n in names)
    return Library(candidates, 10.0 * shapes.reshape(3, -1), COLUMNS)


@pytest.mark.parametrize("name", ["fit_all_parameters", "aic", "bic", "lasso"])
@pytest.mark.parametrize("true", [0, 1, 2])
def test_those_that_fit_name_the_effect_where_it_is_exactly_one(library, name, true):
    noise = 0.05 * np.random.default_rng(true).standard_normal(library.matrix.shape[1])
    guess = BASELINES[name](library, 1.5 * library.matrix[true] + noise)
    assert guess.key == library.candidates[true].key


def test_the_largest_residual_names_a_component(library):
    assert BASELINES["largest_residual"](library, library.matrix[1]).component == "sensor"
    assert BASELINES["largest_residual"](library, library.matrix[0]).component == "drive"


@pytest.mark.parametrize("name", BASELINES)
def test_none_names_an_effect_where_there_is_nothing_but_a_flat_offset_as_small_as_noise(library, name):
    r = 0.3 * np.random.default_rng(3).standard_normal(library.matrix.shape[1])
    guess = BASELINES[name](library, r)
    # information criteria alone take chance for an effect: AIC with odds that are known not to be small
    assert guess.key is None or name == "aic"


def change(library, whitened, reference=None):
    return Change(library, reference, whitened)


def test_signatures_of_one_direction_are_confusable_and_others_are_not(library):
    gain, tool = library.candidates[1], library.candidates[2]
    assert confusable([change(library, library.matrix[1])], gain, limit=1.0) == []
    weak = 0.05 * library.matrix[2]  # what the other column shows of it is below the limit
    assert confusable([change(library, weak)], tool, limit=1.0) == ["drive.backlash[1]", "sensor.sensor_gain_error"]


def test_a_second_situation_tells_apart_what_looks_alike_in_one(library):
    gain, tool = library.candidates[1], library.candidates[2]
    alike = replace(library, matrix=np.stack([library.matrix[0], library.matrix[1], library.matrix[1]]))
    both = [change(alike, alike.matrix[1]), change(library, library.matrix[1])]
    assert confusable(both[:1], gain, limit=1.0) == ["compliance.tool_compliance"]
    assert confusable(both, gain, limit=1.0) == []
    assert confusable([change(alike, alike.matrix[2])] * 2, tool, limit=1.0) == ["sensor.sensor_gain_error"]


def test_a_clock_explains_what_looks_like_a_late_device_and_nothing_that_others_show(library):
    t = np.arange(ROWS * STRIDE) * STEP
    reference = Run(Path(), t, {name: 0.2 * np.cos(3.0 * t) for name in COLUMNS}, {}, {})

    def late(delay):
        shifted = {**reference.columns, "drive.q_motor[1]": 0.2 * np.cos(3.0 * np.maximum(t - delay, 0.0))}
        return change(library, features(shifted, reference.columns, COLUMNS, ROWS), reference)

    assert clocks([late(0.021)], 3.0) == ["logging.lag drive"]
    assert clocks([late(0.021), late(0.021)], 3.0) == ["logging.lag drive"]
    assert clocks([late(0.021), late(-0.04)], 3.0) == []
    both = late(0.021).whitened + 100.0 * (np.arange(len(COLUMNS) * ROWS) >= 2 * ROWS)
    assert clocks([change(library, both, reference)], 3.0) == []


def test_tier_t0_has_no_tracker(library):
    less = library.for_tier("T0")
    assert less.columns == COLUMNS[:2]
    np.testing.assert_array_equal(less.matrix, library.matrix[:, : 2 * ROWS])
    assert library.for_tier("T1") is library


def test_features_are_in_units_of_the_floor_which_grows_with_the_speed_of_the_signal():
    still, moving = np.zeros(ROWS * STRIDE), 0.5 * STEP * np.arange(ROWS * STRIDE)  # 0.5 rad/s
    assert floor("drive.q_motor[1]", still)[7] == FLOOR["drive.q_motor"]
    assert floor("drive.q_motor[1]", moving)[7] == pytest.approx(np.hypot(FLOOR["drive.q_motor"], 0.5 * 5e-5), rel=ROUNDOFF)
    columns = {"drive.q_motor[1]": still + FLOOR["drive.q_motor"]}
    np.testing.assert_allclose(features(columns, {"drive.q_motor[1]": still}, ("drive.q_motor[1]",), ROWS), 1.0, rtol=ROUNDOFF)


@pytest.mark.parametrize(("name", "length"), [("aic", 1e-6), ("bic", 1e-6), ("lasso", 1e-9)])
@pytest.mark.parametrize(("part", "key"), [(0.8, None), (1.2, "drive.backlash")])
def test_a_signature_that_is_round_off_explains_nothing(library, name, length, part, key):
    """NO_ENERGY, and its root for the information criteria; NO_LENGTH for the other."""
    direction = library.matrix[0] / np.linalg.norm(library.matrix[0])
    faint = np.zeros_like(library.matrix)
    faint[0] = part * length * direction
    guess = BASELINES[name](Library(library.candidates, faint, COLUMNS), 100.0 * direction)
    assert guess.key == key
