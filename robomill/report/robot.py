"""The robot in the pose of the run, from the side and from above, with the place of the finding marked."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle

from robomill.joints import arm, geometry
from robomill.models.model.declaration import FloatArray
from robomill.models.robot.kinematics import SPINDLE_ACROSS, forward
from robomill.report.sheet import LINE, Sheet
from robomill.report.style import BODY, INK, MARK, MUTED, PAPER, TINT
from robomill.report.subject import Subject, effect_name
from robomill.report.units import percent

ANGLES = ("drive.q_motor", "drive.q_link", "path.q_ref", "motion.q_motor", "robot.q_link")
"""Axis angles A1..A6 [rad], the first of these that is in the log."""
POINTS = 200
"""Poses along a run that its path is drawn through."""
LIKELY = 0.05
"""Probability from which a cause is marked at its place on the arm."""
APART = 0.1
"""Distance [m] in the picture below which one joint hides another: only one of them has its number."""


@dataclass(frozen=True)
class Pose:
    """Where the parts of the arm are in B [m]."""

    joints: FloatArray
    """Points on the axes of joints 1..6 where they are drawn, [6, 3]."""
    elbow: FloatArray
    """Foot of the forearm's axis, [3]."""
    flange: FloatArray
    nose: FloatArray
    """Lower end of the spindle, [3]."""
    spindle: FloatArray
    """Foot of the flange on the axis of the tool, [3]."""
    tip: FloatArray

    @property
    def points(self) -> FloatArray:
        """All of them, [n, 3]."""
        return np.vstack([np.zeros(3), self.joints, self.elbow, self.flange, self.nose, self.spindle, self.tip])


def pose(s: Any, q: FloatArray) -> Pose:
    """The arm at the axis angles q [rad, 6]."""
    forward(s, q)
    p, R = np.array(s.link_p), np.array(s.link_R)
    elbow = p[3] - s.dh_d[3] * R[3][:, 2]
    axis = R[6][:, 0]
    spindle = p[6] + axis * float((p[5] - p[6]) @ axis)
    room = max(float((p[6] - spindle) @ axis), 0.0)
    nose = p[6] - axis * min(SPINDLE_ACROSS.length or 0.1, 0.6 * room)
    joints = np.stack([0.55 * p[0], p[1], p[2], elbow + 0.45 * (p[3] - elbow), p[3], p[5]])
    return Pose(joints, elbow, p[5], nose, spindle, p[6])


def angles(s: Subject) -> FloatArray | None:
    """Axis angles along the first diagnosed run, [samples, 6]; None where nobody logged them."""
    if not s.conditions:
        return None
    for name in ANGLES:
        members = [f"{name}[{i}]" for i in range(1, 7)]
        if all(m in s.found.channels for m in members):
            columns: FloatArray = s.found.curves[s.conditions[0]]["measured"][:, [s.index(m) for m in members]]
            return columns if np.isfinite(columns).all() else None
    return None


def marks(s: Subject) -> dict[str, str]:
    """Part of the arm -> what is to be said there."""
    found: dict[str, list[str]] = {}
    if s.verdict in ("identified", "ambiguous"):
        for w in s.answer.which:
            if w.probability >= LIKELY:
                text = effect_name(w) + (f" ({percent(w.probability)})" if s.verdict == "ambiguous" else "")
                for part in parts(w.component, w.location, w.effect):
                    found.setdefault(part, []).append(text)
    elif known := s.answer.unknown:
        places = [(b.component, b.location, b.nearest or "") for b in s.blamed]
        for component, location, nearest in places or [(known.component, s.label(known.direction), known.nearest)]:
            for part in parts(component, location, nearest.partition(" @ ")[0]):
                found.setdefault(part, []).append("not in the catalogue")
    return {part: ", ".join(dict.fromkeys(texts)) for part, texts in found.items()}


def parts(component: str, location: str, effect: str) -> list[str]:
    """`joint 3`, or the body that a location of scenarios/catalogue.toml is on; nothing for the controller and the log."""
    joints = [f"joint {n}" for n in re.findall(r"joint (\d)", location)]
    if joints:
        return joints
    named = {"tool": "tool", "cutter": "tool", "flange": "flange", "end effector": "tool", "link arm": "link arm", "forearm": "forearm"}
    if location in named:
        return [named[location]]
    if location == "arm":
        return ["link arm", "forearm"]
    if effect == "base_compliance":
        return ["base"]
    return {"sensor": ["flange"], "milling": ["workpiece"]}.get(component, [])


def draw(s: Subject, sheet: Sheet) -> Figure | None:
    """Side view in the plane of the arm, and top view (not on a narrow sheet); None where nothing is to be marked, there is no arm, or nobody knows its pose."""
    component, q, said = arm(s.system), angles(s), marks(s)
    if component is None or q is None or not said:
        return None
    body = geometry(component)
    t = s.found.curves[s.conditions[0]]["t"]
    regime = next((w.regime for w in (*s.answer.where, s.answer.unknown) if w is not None and w.regime), None)
    at = int(np.searchsorted(t, 0.5 * sum(regime[0]))) if regime else len(t) // 2
    now = pose(body, q[min(at, len(q) - 1)])
    path = np.array([pose(body, row).tip for row in q[:: max(1, len(q) // POINTS)]])
    heading = np.arctan2(now.joints[4][1], now.joints[4][0])
    across = np.array([np.cos(heading), np.sin(heading), 0.0])
    views = {
        "from the side, in the plane of the arm": np.stack([across, [0.0, 0.0, 1.0]], axis=1),
        "from above": np.eye(3)[:, :2],
    }
    if sheet.narrow:
        del views["from above"]
    boxes = []
    for k, view in enumerate(views.values()):
        flat = np.vstack([now.points, path]) @ view
        low, high = np.minimum(flat.min(axis=0), -0.45) - 0.1, np.maximum(flat.max(axis=0), 0.45) + 0.2
        if k == 0:
            low[1] = -0.06
        boxes.append((low, high))
    width = sum(high[0] - low[0] for low, high in boxes)
    inches = min((sheet.width - 0.9) / width, 3.6 / max(high[1] - low[1] for low, high in boxes))
    height = inches * max(high[1] - low[1] for low, high in boxes)
    room = 0.3 + LINE * len(said)
    total = height + room + 0.1
    figure = Figure(figsize=(sheet.width, total))
    left = 0.5 * (sheet.width - inches * width - 0.5)
    for k, ((title, view), (low, high)) in enumerate(zip(views.items(), boxes, strict=True)):
        size = inches * (high - low)
        bottom = 0.05 + (0.5 * (height - size[1]) if k else 0.0)
        ax = figure.add_axes((left / sheet.width, bottom / total, size[0] / sheet.width, size[1] / total))
        ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
        ax.axis("off")
        _arm(ax, now, path, view, said, 72.0 * inches, upright=k == 0)
        figure.text(left / sheet.width, 1.0 - 0.17 / total, title[0].upper() + title[1:], fontsize=9, fontweight="bold")
        if k == 0:
            _labels(figure, ax, now, path, view, said, total)
        left += size[0] + 0.5
    return figure


def place_of(part: str, now: Pose, path: FloatArray) -> FloatArray:
    """Where a mark points to [3]."""
    if part.startswith("joint "):
        point: FloatArray = now.joints[int(part[6:]) - 1]
        return point
    places = {
        "base": np.array([0.0, 0.0, 0.15]),
        "link arm": 0.5 * (now.joints[1] + now.joints[2]),
        "forearm": 0.3 * now.elbow + 0.7 * now.joints[4],
        "flange": now.flange,
        "tool": 0.5 * (now.spindle + now.nose),
        "workpiece": path[path[:, 2].argmin()] - np.array([0.0, 0.0, 0.04]),
    }
    return np.asarray(places[part])


def _labels(figure: Figure, ax: Axes, now: Pose, path: FloatArray, view: FloatArray, said: Mapping[str, str], total: float) -> None:
    """One line of text above the side view for each mark, with a line to its place."""
    places = sorted((tuple(place_of(part, now, path) @ view), text) for part, text in said.items())
    for i, (place, text) in enumerate(places):  # from left to right and downwards: no line crosses a text
        across = figure.transFigure.inverted().transform(ax.transData.transform(place))[0]
        x, y = min(across + 0.02, 0.4), 1.0 - (0.36 + LINE * i) / total
        ax.annotate(
            text,
            xy=place,
            xycoords="data",
            xytext=(x, y),
            textcoords="figure fraction",
            color=MARK,
            fontsize=9,
            va="center",
            annotation_clip=False,
            arrowprops={"arrowstyle": "-", "color": MARK, "lw": 0.9, "shrinkA": 1, "shrinkB": 5, "relpos": (0.0, 0.5)},
        )


def _arm(ax: Axes, now: Pose, path: FloatArray, view: FloatArray, said: Mapping[str, str], scale: float, *, upright: bool) -> None:
    """Bodies as outlined capsules, from the base to the tool; `scale` points per metre."""

    def capsule(points: Sequence[FloatArray], diameter: float, part: str = "") -> None:
        flat = np.array(points) @ view
        for width, colour in ((diameter * scale, INK), (diameter * scale - 1.5, TINT if part in said else BODY)):
            ax.plot(*flat.T, color=colour, lw=max(width, 0.6), solid_capstyle="round", solid_joinstyle="round")

    base = TINT if "base" in said else BODY
    if not upright:
        ax.add_patch(Circle((0.0, 0.0), 0.42, fc=base, ec=INK, lw=0.8, zorder=2))
    lowest = float(path[:, 2].min())
    cut = path[path[:, 2] < lowest + 0.01]
    flat = cut @ view
    (x0, y0), (x1, y1) = flat.min(axis=0) - 0.04, flat.max(axis=0) + 0.04
    if upright:
        y0, y1 = lowest - 0.09, lowest
    ax.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, fc=TINT if "workpiece" in said else PAPER, ec=INK, lw=0.8, zorder=1))
    shoulder, elbow, wrist = now.joints[1], now.joints[2], now.joints[4]
    capsule([np.array([0.0, 0.0, 0.45]), np.array([0.0, 0.0, shoulder[2]])], 0.42)
    capsule([np.array([0.0, 0.0, shoulder[2]]), shoulder], 0.34)
    if upright:
        ax.axhline(0.0, color=MUTED, lw=0.8)
        ax.add_patch(Polygon([(-0.42, 0.0), (0.42, 0.0), (0.3, 0.36), (-0.3, 0.36)], fc=base, ec=INK, lw=0.8, zorder=2))
    capsule([shoulder, elbow], 0.26, "link arm")
    capsule([elbow, now.elbow, now.elbow + 0.5 * (wrist - now.elbow)], 0.24, "forearm")
    capsule([now.elbow + 0.5 * (wrist - now.elbow), wrist], 0.19, "forearm")
    capsule([wrist, now.flange], 0.15, "flange")
    capsule([now.flange, now.spindle], 0.13, "tool")
    down = (now.nose - now.spindle) / max(float(np.linalg.norm(now.nose - now.spindle)), 1e-9)
    capsule([now.spindle, now.nose - 0.055 * down], 0.11, "tool")
    ax.plot(*(np.array([now.nose, now.tip]) @ view).T, color=INK, lw=2.0, solid_capstyle="butt")
    ax.plot(*(path @ view).T, color=MUTED, lw=0.8)
    drawn: list[FloatArray] = []
    for i in sorted(range(6), key=lambda i: (f"joint {i + 1}" not in said, -i)):  # what is marked, then from the tool to the base
        on = f"joint {i + 1}" in said
        place = now.joints[i] @ view
        if any(np.linalg.norm(place - other) < APART for other in drawn):
            continue  # behind another
        drawn.append(place)
        x, y = place
        ax.plot(x, y, "o", ms=13 if on else 10, mfc=MARK if on else PAPER, mec=MARK if on else INK, mew=0.8, zorder=5)
        ax.text(x, y, str(i + 1), color=PAPER if on else INK, fontsize=7, ha="center", va="center_baseline", zorder=6)
