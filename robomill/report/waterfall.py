"""Effect by effect: the gap before, what each one takes away, and what remains beside the noise."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from robomill.diagnosis.localisation.where import WHOLE
from robomill.diagnosis.outcome.closure import HowFar
from robomill.report.sheet import Sheet
from robomill.report.style import AFTER, BEFORE, BODY, INK, MARK, MUTED, NOISE
from robomill.report.subject import ALL, Subject, left, spoken
from robomill.report.units import number, percent, scale

PANELS = 2
"""Figures that are drawn beside the whole gap, at most. The table has all of them."""


def draw(s: Subject, sheet: Sheet) -> Figure | None:
    """Bars that fall from the gap of the nominal system to what remains, for each figure [unit]; the closed part of all, which grows."""
    steps, shown = s.answer.steps, s.clearest(PANELS)
    whole = s.far(steps.on, WHOLE) if steps is not None else None
    if steps is None or not shown:
        return None
    names = [spoken(step.effect) for step in steps.added]
    count = len(shown) + (whole is not None and whole.closure is not None)
    labels = ["before", *(sheet.label(n) for n in names), "what remains"]
    lines = max(label.count("\n") + 1 for label in labels)
    rows, height = (count, 1) if sheet.narrow else (1, count), 0.9 + (0.06 + 0.15 * lines) * len(labels)
    figure = sheet.figure(height * rows[0], 4)
    axes = figure.subplots(*rows, squeeze=False).ravel()
    worse = False
    for ax, h in zip(axes, shown, strict=False):
        worse |= _falling(ax, h, [step.left[h.channel].after for step in steps.added])
        ax.set_title(
            sheet.title(s.titles.get(h.channel, h.channel)) if sheet.narrow else _broken(s.titles.get(h.channel, h.channel), count)
        )
    if count > len(shown):
        assert whole is not None
        _growing(axes[-1], whole, [step.left[WHOLE].closure or 0.0 for step in steps.added])
        axes[-1].set_title(ALL)
    for k, ax in enumerate(axes):
        ax.set_yticks(range(len(labels)), labels if sheet.narrow or k == 0 else [""] * len(labels))
        ax.set_ylim(len(labels) - 0.4, -0.6)
        ax.tick_params(axis="y", length=0)
        ax.spines["left"].set_visible(False)
    handles = [Patch(color=BEFORE, label="before"), Patch(color=AFTER, label="taken away by the effect")]
    handles += [Patch(color=MARK, label="made larger by it")] if worse else []
    sheet.legend(figure, [*handles, Patch(color=NOISE, label="noise")])
    return figure


def _broken(text: str, columns: int) -> str:
    """A title over one of several panels beside each other."""
    return Sheet(7.0 / columns).title(text)


def _falling(ax: Axes, h: HowFar, after: Sequence[float]) -> bool:
    """One figure; whether an effect made its gap larger."""
    factor, symbol = scale(h.unit, max(h.before, h.floor, *after))
    heights = [factor * x for x in (h.before, *after)]
    ax.axvspan(0.0, factor * h.floor, fc=NOISE, ec="none", zorder=0)
    ax.barh(0, heights[0], height=0.62, color=BEFORE)
    for k in range(1, len(heights)):
        start, end = heights[k - 1], heights[k]
        ax.plot([start, start], [k - 1, k], color=MUTED, lw=0.6, zorder=1)
        ax.barh(k, end - start, left=start, height=0.62, color=MARK if end > start else AFTER)
    last = len(heights)
    ax.plot([heights[-1]] * 2, [last - 1, last], color=MUTED, lw=0.6, zorder=1)
    ax.barh(last, heights[-1], height=0.62, color=BODY, ec=INK, lw=0.6)
    right = max(heights)
    for k, x in enumerate(heights):
        ax.text(max(x, heights[k - 1] if k else x) + 0.02 * right, k, number(x), va="center", fontsize=8)
    ax.text(heights[-1] + 0.02 * right, last, left(h), va="center", fontsize=8)
    ax.set_xlim(0.0, 1.2 * right)
    ax.set_xlabel(f"rms{f' in {symbol}' if symbol else ''}", loc="left")
    return any(b > a and number(b) != number(a) for a, b in itertools.pairwise(heights))


def _growing(ax: Axes, h: HowFar, closures: Sequence[float]) -> None:
    """The closed part of the whole gap."""
    at = [0.0, *(100.0 * min(max(c, 0.0), 1.0) for c in closures)]
    for k in range(1, len(at)):
        ax.plot([at[k - 1]] * 2, [k - 1, k], color=MUTED, lw=0.6, zorder=1)
        ax.barh(k, at[k] - at[k - 1], left=at[k - 1], height=0.62, color=AFTER if at[k] >= at[k - 1] else MARK)
        ax.text(max(at[k], at[k - 1]) + 2.0, k, percent(0.01 * at[k]), va="center", fontsize=8)
    ax.barh(len(at), 100.0 - at[-1], left=at[-1], height=0.62, color=BODY, ec=INK, lw=0.6)
    ends = "closed share of the gap"
    if h.ceiling is not None and not h.within_noise:
        ax.plot(100.0 * h.ceiling, len(at), "|", color=INK, ms=14, mew=1.8, zorder=4)
        ends += " (mark: at best)"
    ax.set_xlim(0.0, 122.0)
    ax.set_xticks(range(0, 101, 50), [f"{x} %" for x in range(0, 101, 50)])
    ax.set_xlabel(ends, loc="left")
