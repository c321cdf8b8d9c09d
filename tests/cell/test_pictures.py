"""Pictures: what must be seen in them can be seen, also in special cases."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from robomill.cell import palette, pictures
from robomill.cell.evaluation import Cut, Result


class _Run(dict[str, Any]):
    """A straight cut along -x of the base, as the groove has it, with a correction across."""

    def __init__(self, pilot: bool) -> None:
        n = 50
        self.t = np.arange(n) * 0.004
        x = np.linspace(1.35, 1.25, n)
        column = np.ones(n)
        super().__init__(
            {
                "path.p_BT_B": np.column_stack([x, 0 * x, 0 * x]),
                "path.v_BT_B": np.column_stack([-0.025 * column, 0 * x, 0 * x]),
                "path.f_pilot_B": np.zeros((n, 3)),
                "milling.depth": 0.01 * column,
                "milling.removal_rate": 1e-6 * column,
                "milling.f_T_B": np.column_stack([300 * column, -450 * column, 0 * x]),
                "sensor.f_T_T": np.zeros((n, 3)),
                "controller.f_used_B": np.zeros((n, 3)),
                "controller.r_B": np.column_stack([-2e-4 * column, 1e-3 * column, 0 * x]),
                "controller.r_v_B": np.column_stack([0 * x, 1e-3 * column, 0 * x]),
                "controller.pilot_blend": 0.5 * column if pilot else 0 * x,
            }
        )


class _Result:
    title = "a case"
    cuts = (Cut(0.0, 0.196),)

    def __init__(self, pilot: bool = False) -> None:
        self.run = _Run(pilot)


@pytest.mark.parametrize(("way", "across"), [(0.7e-9, 0.0), (1.5e-9, 1e-4)])
def test_a_tool_that_stands_has_no_side(way: float, across: float) -> None:
    """Deviation to the left of a motion along x; NO_WAY is round-off."""
    nominal = np.column_stack([way * np.arange(5.0), np.zeros(5), np.zeros(5)])
    actual = nominal + np.array([0.0, 1e-4, 0.0])
    result = cast(Result, SimpleNamespace(nominal=SimpleNamespace(position=nominal), actual=SimpleNamespace(position=actual)))
    assert np.array_equal(pictures._across(result)[0], np.full(5, across))


def test_arrows_of_a_path_along_an_axis_are_inside_the_picture() -> None:
    figure = pictures.projection(cast(Result, _Result()))
    figure.canvas.draw()  # the aspect ratio may change the limits
    ax = next(a for a in figure.axes if a.get_title() == "from above")
    assert ax.get_ylim()[0] < 0.0
    assert ax.get_ylim()[1] > 10.0  # 1 mm, ten times as long
    assert ax.get_xlim()[0] < 1250.0 - 0.25 * 25.0
    assert ax.get_window_extent().height > 40.0


@pytest.mark.parametrize("pilot", [True, False])
def test_the_pilot_blend_is_in_the_legend_where_there_is_one(pilot: bool) -> None:
    figure = pictures.forces(cast(Result, _Result(pilot)))
    labels = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
    assert ("pilot blend (right axis)" in labels) is pilot
    assert all(ax.get_legend() is None for ax in figure.axes)  # it would hide entry or exit


@pytest.mark.parametrize("pilot", [True, False])
def test_there_is_no_axis_that_nothing_is_drawn_on(pilot: bool) -> None:
    for figure in (pictures.forces(cast(Result, _Result(pilot))), pictures.projection(cast(Result, _Result(pilot)))):
        assert all(ax.has_data() for ax in figure.axes if ax.axison)
    assert len(pictures.forces(cast(Result, _Result(pilot))).axes) == 1 + pilot  # the right axis is that of the blend


def test_what_the_legend_names_is_drawn_and_hides_nothing() -> None:
    figure = pictures.projection(cast(Result, _Result()))
    figure.canvas.draw()
    (legend,) = [ax.get_legend() for ax in figure.axes if ax.get_legend() is not None]
    named = {text.get_text() for text in legend.get_texts()}
    assert named == {"engaged", "before", "after", "feed", "correction x 10", "projected x 10"}
    box = legend.get_window_extent()
    assert not any(ax.get_window_extent().overlaps(box) for ax in figure.axes if ax.axison)


def test_curves_of_all_variants_differ_in_colour_and_in_style() -> None:
    names = ("uncompensated", "cartesian", "axis", "cartesian_pilot")
    colours = [pictures.COLOURS[name] for name in names]
    assert len(set(colours)) == len(names)
    assert len(set(palette.STYLES)) == len(names)
    # to eyes whose red and green are one signal, weighted as in luminance, the four still differ by a tenth of the range
    seen = np.array([to_rgb(c) for c in colours])
    seen[:, :2] = seen[:, :2] @ [[0.3, 0.3], [0.7, 0.7]]
    apart = np.linalg.norm(seen[:, None] - seen[None], axis=2)[np.triu_indices(len(names), 1)]
    assert apart.min() > 0.1
