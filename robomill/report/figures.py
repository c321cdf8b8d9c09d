"""The figures of the report: drawn with named colours, saved as SVG and PNG; in the page they take its theme, wide and narrow."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib.style
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from robomill.diagnosis.candidates import LOGGING
from robomill.diagnosis.localisation.where import WHOLE, Where
from robomill.diagnosis.outcome.answer import Visible
from robomill.orchestration.slaves.protocol import FloatArray, base_name
from robomill.report import form, robot, waterfall
from robomill.report.sheet import Sheet
from robomill.report.style import AFTER, BEFORE, COLOURS, INK, MUTED, NARROW, NOISE, PAPER, SHADE, STYLE, WIDTH
from robomill.report.subject import ALL, HELD_OUT, KINDS, Subject, together
from robomill.report.units import percent, percent_interval, scale

ROWS = 4
"""Panels with signals, at most."""
FILLED = 3
"""Panels that there are even if fewer signals have a cause: the loudest ones fill them; of what no cause explains, so many are shown."""
BAR = 0.005
"""Share of the gap from beyond which the tolerances of calibration have a bar: less is shown as 0 %."""
COLUMN = 12
"""Effects in one column of the figure; more are put in two."""
SHADED = "shaded: "
ALWAYS = 0.95
"""Part of a run from which it is all of it."""


def draw_all(s: Subject, folder: Path) -> dict[str, str]:
    """Name -> what the page shows, of all figures that the answer has; each is written to `folder` as .svg and .png too."""
    functions: tuple[tuple[str, Callable[[Subject, Sheet], Figure | None]], ...] = (
        ("log", log),
        ("steps", waterfall.draw),
        ("shares", shares),
        ("robot", robot.draw),
        ("signals", signals),
        ("overlay", overlay),
        ("closure", closure),
        ("form", form.draw),
        ("visible", visible),
    )
    made = {}
    with matplotlib.style.context(["default", STYLE]):
        for name, function in functions:
            wide, narrow = (function(s, Sheet(width)) for width in (WIDTH, NARROW))
            if wide is not None and narrow is not None:
                both = {"wide": _inline(_save(wide, name, folder), name), "narrow": _inline(_svg(narrow), f"{name}-narrow")}
                made[name] = "\n".join(f'<div class="{kind}">{svg}</div>' for kind, svg in both.items())
    return made


def _svg(figure: Figure) -> str:
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata=dict.fromkeys(("Date", "Creator", "Format", "Type")))
    return "\n".join(line.rstrip() for line in buffer.getvalue().splitlines()) + "\n"


def _save(figure: Figure, name: str, folder: Path) -> str:
    """The figure in `folder`; the text of its SVG."""
    folder.mkdir(parents=True, exist_ok=True)
    text = _svg(figure)
    figure.set_layout_engine("none")  # it stays as it is
    figure.savefig(folder / f"{name}.png", dpi=150, metadata={"Software": None})
    (folder / f"{name}.svg").write_text(text, encoding="utf-8")
    return text


def _inline(svg: str, name: str) -> str:
    """The SVG element alone: identifiers made its own, colours and letters those of the page, as wide as drawn or as there is room."""
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<defs>\s*<style.*?</style>\s*</defs>", "", svg, count=1, flags=re.DOTALL)  # would hold for the whole page
    svg = re.sub(r'\bid="([^"]+)"', rf'id="{name}-\1"', svg)
    svg = re.sub(r'(href="#|url\(#)', rf"\g<1>{name}-", svg)
    svg = re.sub(r'width="([\d.]+)pt" height="[\d.]+pt"', r'style="max-width: \1pt" role="img" aria-hidden="true"', svg, count=1)
    for key, colour in COLOURS.items():
        svg = svg.replace(colour, f"var(--{key})")
    return svg.replace("'DejaVu Sans'", "var(--sans)").strip()


def _shade(ax: Axes, regime: Sequence[Sequence[float]], t: FloatArray) -> str:
    """Shade the times; the text that says so in the title. What acts all the time is not shaded."""
    if not regime:
        return ""
    if sum(end - start for start, end in regime) > ALWAYS * float(t[-1] - t[0]):
        return "acts all the time: "
    for start, end in regime:
        ax.axvspan(start, end, fc=SHADE, ec="none", zorder=0)
    return SHADED


def _gap(ax: Axes, s: Subject, condition: str, channel: str, *, before: bool = True, after: bool, beside: Sequence[str] = ()) -> None:
    """Measured minus simulated over time, over a band of what repeats differ by (two deviations).

    In the unit that suits the largest gap in this condition and those that are drawn `beside` it on the same axis.
    """
    curves = s.found.curves[condition]
    lines = [("nominal", BEFORE)] if before else []
    lines += [("adopted", AFTER)] if after else []
    gaps = {kind: s.gap(condition, channel, kind) for kind, _ in lines}
    size = max(float(np.abs(s.gap(c, channel, kind)).max()) for c in {condition, *beside} for kind, _ in lines)
    factor, symbol = scale(s.unit(channel), max(size, 1e-300))
    noise = 2.0 * factor * float(curves["spread"][s.index(channel)])
    if noise > 0.0:
        ax.axhspan(-noise, noise, fc=NOISE, ec="none", zorder=0.5)
    ax.axhline(0.0, color=MUTED, lw=0.5)
    for kind, colour in lines:
        ax.plot(curves["t"], factor * gaps[kind], color=colour, lw=1.0)
    ax.set_ylabel(symbol or "(no unit)")
    ax.set_xlim(curves["t"][0], curves["t"][-1])


def component_name(w: Where) -> str:
    """`drive (joint 3)`; the log is not a component."""
    place = f" ({together(sorted(w.location.split(', ')))})" if w.location else ""
    return f"{'log' if w.component == LOGGING else w.component}{place}"


def shares(s: Subject, sheet: Sheet) -> Figure | None:
    """Each component's part in the gap, with its interval; and what no component explains."""
    entries = s.answer.where
    if not entries:
        return None
    rows = [(component_name(w), w.share, w.interval, True) for w in entries]
    if not s.blamed:  # shares of a replay are no parts of the model that leaves this
        tolerated = 1.0 - s.left - sum(w.share for w in entries)
        if tolerated > BAR:
            rows.append(("tolerances of calibration", tolerated, None, False))
        rows.append(("not explained", s.left, None, False))
    figure = sheet.figure(0.62 + 0.36 * len(rows))
    ax = figure.subplots()
    for i, (_, share, interval, known) in enumerate(rows):
        ax.barh(i, 100.0 * share, height=0.56, color=AFTER if known else NOISE, ec=AFTER if known else MUTED, lw=0.6)
        end = share
        if interval is not None:
            ax.plot([100.0 * x for x in interval], [i, i], color=INK, lw=1.2, marker="|", ms=7)
            end = max(share, interval[1])
        text = percent(share) + (f"  ({percent_interval(interval)})" if interval is not None else "")
        ax.text(100.0 * max(end, 0.0) + 1.5, i, text, va="center", fontsize=8.5)
    ax.set_yticks(range(len(rows)), [sheet.label(r[0]) for r in rows])
    ax.invert_yaxis()
    low = min(0.0, *(100.0 * (r[2][0] if r[2] else r[1]) for r in rows))
    high = max(100.0, *(100.0 * (r[2][1] if r[2] else r[1]) for r in rows))
    ax.set_xlim(max(low, -100.0), min(high, 200.0) + (90.0 if sheet.narrow else 30.0))
    ticks = range(0, 101, 50 if sheet.narrow else 20)
    ax.set_xticks(ticks, [f"{x} %" for x in ticks])
    ax.tick_params(axis="y", length=0)
    ax.spines["left"].set_visible(False)
    ax.axvline(0.0, color=MUTED, lw=0.6)
    ax.set_xlabel("share of the gap", loc="left")
    return figure


def signals(s: Subject, sheet: Sheet) -> Figure | None:
    """The gap on the diagnosed run where it shows most, with the times of each cause shaded."""
    if not s.conditions or (s.verdict in ("bad_log", "none") and not s.answer.where):
        return None
    condition = s.conditions[0]
    rows: dict[str, tuple[str, list[Any]]] = {}
    for w in s.answer.where:
        if w.channel in s.found.channels:
            title, regime = rows.get(w.channel, ("", []))
            rows[w.channel] = (f"{title}, {component_name(w)}" if title else component_name(w), regime + w.regime)
    if unknown := s.answer.unknown:  # what is left is of more interest than the parts of a model that is not adequate
        rows = dict.fromkeys(list(unknown.channels)[:FILLED], ("what is left", unknown.regime))
    for channel in s.loudest(condition):
        if len(rows) < FILLED and base_name(channel) not in map(base_name, rows):
            rows[channel] = ("", [])
    if not rows:
        return None
    shown = list(rows.items())[:ROWS]
    figure = sheet.figure(0.75 + 1.25 * len(shown), 4)
    axes = np.atleast_1d(figure.subplots(len(shown), 1, sharex=True))
    shaded = False
    for ax, (channel, (cause, regime)) in zip(axes, shown, strict=True):
        how = _shade(ax, regime, s.found.curves[condition]["t"])
        _gap(ax, s, condition, channel, after=bool(s.found.adopted))
        ax.set_title(sheet.title(s.label(channel) + (f" — {how or 'strongest for '}{cause}" if cause else "")))
        shaded |= how == SHADED
    axes[-1].set_xlabel(f"time in s ({condition})")
    handles: list[Any] = [Line2D([], [], color=BEFORE, label="measured − nominal simulation")]
    handles += [Line2D([], [], color=AFTER, label="measured − best model")] if s.found.adopted else []
    handles += _repeats(s, condition) + ([Patch(color=SHADE, label="when it acts")] if shaded else [])
    sheet.legend(figure, handles)
    return figure


def overlay(s: Subject, sheet: Sheet) -> Figure | None:
    """Before and after in each condition, where the gap is largest."""
    if not s.found.adopted or s.verdict == "bad_log":
        return None
    first, *others = s.conditions
    new = [c for c in others if c.endswith(HELD_OUT) and c.removesuffix(HELD_OUT) not in s.conditions]
    columns = list(dict.fromkeys([first, *new, *others]))[:3]
    if sheet.narrow:  # the hardest test
        columns = [*new, *others, first][:1]
    figures = [h.channel for h in s.figures(s.hardest)]
    loud = s.loudest(s.conditions[0])
    rows = sorted((c for c in loud if base_name(c) in figures), key=lambda c: list(s.titles or figures).index(base_name(c)))[:3] or loud[:3]
    figure = sheet.figure(0.75 + 1.35 * len(rows), 3)
    axes = figure.subplots(len(rows), len(columns), squeeze=False, sharex="col", sharey="row")
    for k, channel in enumerate(rows):
        # a row has one axis
        for j, condition in enumerate(columns):
            ax = axes[k][j]
            _gap(ax, s, condition, channel, after=True, beside=columns)
            if j:
                ax.set_ylabel("")
            else:
                ax.set_title(sheet.title(s.label(channel)))
    for j, condition in enumerate(columns):
        axes[-1][j].set_xlabel(f"time in s, {condition}")
    handles = [Line2D([], [], color=BEFORE, label="before"), Line2D([], [], color=AFTER, label="after")]
    sheet.legend(figure, [*handles, *_repeats(s, columns[0])])
    return figure


def _repeats(s: Subject, condition: str) -> list[Any]:
    """The entry of the legend for the band of the repeats, where there are any."""
    return [Patch(color=NOISE, label="±2σ of a repeat")] if np.any(s.found.curves[condition]["spread"] > 0.0) else []


def closure(s: Subject, sheet: Sheet) -> Figure | None:
    """How much of each figure's gap is closed on each kind of runs, with interval and ceiling."""
    listed = [h for h in s.answer.how_far if h.measurable]
    order = list(s.titles)
    names = sorted(dict.fromkeys(h.channel for h in listed), key=lambda n: order.index(n) if n in order else -1)
    if not names:
        return None
    marks = {kind: (marker, dodge) for kind, marker, dodge in zip(KINDS, "os^", (-0.24, 0.0, 0.24), strict=True)}
    figure = sheet.figure(0.85 + 0.42 * len(names), 4)
    ax = figure.subplots()
    for h in listed:
        assert h.closure is not None
        assert h.interval is not None
        marker, dodge = marks[h.on]
        y = names.index(h.channel) + dodge
        low, high = (float(np.clip(100.0 * x, -20.0, 104.0)) for x in h.interval)
        ax.plot([low, high], [y, y], color=AFTER, lw=1.2)
        x = float(np.clip(100.0 * h.closure, -20.0, 104.0))
        first = h.on == next(iter(KINDS))
        ax.plot(x, y, marker, color=AFTER, mfc=AFTER if first else PAPER, ms=6 if first else 5, clip_on=False, zorder=3)
        if h.ceiling is not None:
            ax.plot(float(np.clip(100.0 * h.ceiling, -20.0, 104.0)), y, "|", color=INK, ms=9, mew=1.8, zorder=4)
    labels = [sheet.label(ALL if n == WHOLE else s.titles.get(n, n)) for n in names]
    ax.set_yticks(range(len(names)), labels)
    ax.set_ylim(len(names) - 0.45, -0.55)
    ax.set_xlim(-22.0, 106.0)
    ticks = range(0, 101, 50) if sheet.narrow else range(-20, 101, 20)
    ax.set_xticks(ticks, [f"{x} %".replace("-", "−") for x in ticks])
    ax.axvline(0.0, color=MUTED, lw=0.6)
    ax.grid(axis="x")
    ax.tick_params(axis="y", length=0)
    ax.spines["left"].set_visible(False)
    ax.set_xlabel("closed share of the gap", loc="left")
    kinds = [k for k in KINDS if any(h.on == k for h in listed)]
    handles = [
        Line2D([], [], color=AFTER, marker=marks[k][0], mfc=PAPER if i else AFTER, ms=6, lw=1.2, label=KINDS[k])
        for i, k in enumerate(kinds)
    ]
    sheet.legend(figure, [*handles, Line2D([], [], color=INK, marker="|", mew=1.8, ms=9, lw=0, label="the best that any model could do")])
    return figure


def smallest(s: Subject) -> list[tuple[str, list[tuple[float, Visible]]]]:
    """Effect -> (smallest visible value in units of the usual size, it), best place first; most visible effects first.

    Of the numbers and variants that an effect has at a place, the one that shows best.
    """
    typical = {(c.effect, c.location): c.prior.scale for c in s.catalogue.candidates}
    found: dict[str, dict[str, tuple[float, Visible]]] = {}
    for v in s.answer.smallest_visible or ():
        size = typical.get((v.effect, v.location))
        if size and np.isfinite(v.value):
            here, shows = found.setdefault(v.effect, {}), (abs(v.value) / size, v)
            here[v.location] = min(here.get(v.location, shows), shows, key=lambda p: p[0])
    ordered = {effect: sorted(places.values(), key=lambda p: p[0]) for effect, places in found.items()}
    return sorted(ordered.items(), key=lambda item: item[1][0][0])


def visible(s: Subject, sheet: Sheet) -> Figure | None:
    """From which size each effect would have been seen, against its usual size."""
    effects = smallest(s)
    if s.verdict == "bad_log" or not effects:
        return None
    half = -(-len(effects) // 2) if len(effects) > COLUMN and not sheet.narrow else len(effects)
    blocks = [effects[:half], effects[half:]] if len(effects) > half else [effects]
    figure = sheet.figure(0.8 + 0.19 * half, 2)
    sizes = [size for _, places in effects for size, _ in places]
    low, high = 10.0 ** np.floor(np.log10(max(min(sizes), 1e-4))), 10.0 ** np.ceil(np.log10(min(max(sizes), 1e3)))
    axes = figure.subplots(1, len(blocks), squeeze=False)[0]
    for ax, block in zip(axes, blocks, strict=True):
        ax.axvspan(1.0, max(high, 10.0), fc=NOISE, ec="none", zorder=0)
        for i, (_, places) in enumerate(block):
            ends = np.clip([places[0][0], places[-1][0]], low, high)
            ax.plot(ends, [i, i], color=AFTER, lw=2.0, solid_capstyle="butt", alpha=0.45)
            ax.plot([np.clip(size, low, high) for size, _ in places], [i] * len(places), "o", color=AFTER, ms=3.2)
        ax.set(xscale="log", xlim=(low, max(high, 10.0)), ylim=(half - 0.4, -0.6))
        ax.set_yticks(range(len(block)), [effect.replace("_", " ") for effect, _ in block])
        ax.axvline(1.0, color=INK, lw=0.8)
        ax.tick_params(axis="y", length=0)
        ax.minorticks_off()
        decades = np.arange(np.log10(low), np.log10(max(high, 10.0)) + 0.5, 2 if sheet.narrow else 1)
        ax.set_xticks(10.0**decades)
        ax.xaxis.set_major_formatter(lambda x, _: f"{x:g}")
        ax.grid(axis="x")
        ax.set_xlabel("smallest visible / usual size", loc="left")
    sheet.legend(
        figure,
        [
            Line2D([], [], color=AFTER, marker="o", ms=3.2, lw=2.0, label="one dot per place"),
            Patch(color=NOISE, label="would be missed at its usual size"),
        ],
    )
    return figure


def log(s: Subject, sheet: Sheet) -> Figure | None:
    """With a log that is refused: the channels that it is refused for, beside their simulation."""
    if s.verdict != "bad_log" or not s.conditions:
        return None
    condition = s.conditions[0]
    curves = s.found.curves[condition]
    rows: dict[str, tuple[str, bool]] = {}
    for f in s.answer.findings:
        pattern = re.compile(re.escape(f.channel).replace(r"\*", ".*"))
        members = [c for c in s.found.channels if pattern.fullmatch(c) or pattern.fullmatch(base_name(c))]
        if f.fatal and members:
            loud = s.loudness(condition)
            channel = max(members, key=lambda c: loud[c])
            rows.setdefault(channel, (f.text, f.kind == "lag"))
    if not rows:
        return None
    shown = list(rows.items())[:ROWS]
    figure = sheet.figure(0.75 + 1.45 * len(shown), 3)
    axes = np.atleast_1d(figure.subplots(len(shown), 1, sharex=True))
    for ax, (channel, (text, late)) in zip(axes, shown, strict=True):
        i = s.index(channel)
        if late:  # two curves a few milliseconds apart look like one
            _gap(ax, s, condition, channel, after=False)
            ax.set_title(sheet.title(f"{channel}, log − simulation: {text}"))
            continue
        both = curves["measured"][:, i], curves["nominal"][:, i]
        factor, symbol = scale(s.unit(channel), max(float(np.abs(b).max()) for b in both) or 1.0)
        ax.plot(curves["t"], factor * both[1], color=AFTER, lw=1.0)
        ax.plot(curves["t"], factor * both[0], color=BEFORE, lw=1.2)
        ax.set_title(sheet.title(f"{channel} {text}"))
        ax.set_ylabel(symbol or "(no unit)")
        ax.set_xlim(curves["t"][0], curves["t"][-1])
    axes[-1].set_xlabel(f"time in s ({condition})")
    handles: list[Any] = [Line2D([], [], color=BEFORE, label="log (mean of repeats)")]
    handles += [Line2D([], [], color=AFTER, label="simulation")] if not all(late for _, (_, late) in shown) else []
    handles += [Patch(color=NOISE, label="±2σ of a repeat")] if any(late for _, (_, late) in shown) else []
    sheet.legend(figure, handles)
    return figure
