"""The page: what it shows as numbers, packed, and the HTML around them."""

from __future__ import annotations

import base64
import json
import math
import os
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.colors import to_hex
from scipy.spatial.transform import Rotation

from robomill.models.model.declaration import FloatArray
from robomill.viewer.chain import AXES, Tree, deflections, from_dh
from robomill.viewer.recorded import Recorded, recordings
from robomill.viewer.stock import cut_stock, patches
from robomill.viewer.urdf import read_urdf

MAP = "RdBu_r"
"""Colours of the deviation, as in the pictures of a run; told apart with any colour vision."""
COLOURS = 33
"""Colours of the map that the page interpolates between."""
CUTTER = 8e-3
"""Radius [m] at which the cutter is drawn where the run does not say it."""
SAME_MOTION = 1e-3
"""Shift [m] between the sixth link of a URDF and the flange of the run from which on the two are different robots."""
SAME_TURN = 1e-3
"""Turn [rad] between them, likewise: a shift of SAME_MOTION at 1 m."""
_ALIGNED = 8
"""Bytes: arrays of the page begin at multiples of it."""


@dataclass
class Packed:
    """Arrays, one behind the other; `add` says where."""

    data: bytearray = field(default_factory=bytearray)

    def add(self, values: npt.ArrayLike, dtype: str) -> dict[str, Any]:
        """Type, place [bytes] and number of the values, for the page."""
        array = np.ascontiguousarray(values, dtype=np.dtype(dtype).newbyteorder("<"))
        self.data.extend(b"\0" * (-len(self.data) % _ALIGNED))
        place = len(self.data)
        self.data.extend(array.tobytes())
        return {"type": dtype, "at": place, "n": array.size}

    def text(self) -> str:
        """All of it, compressed (zlib), as Base64."""
        return base64.b64encode(zlib.compress(bytes(self.data), 9)).decode()


@dataclass(frozen=True)
class View:
    """What was written: the file, the names of the runs in it, and what is to be said about it."""

    file: Path
    runs: tuple[str, ...]
    notes: tuple[str, ...]


def view(folder: Path, file: Path, names: Sequence[str] | None = None, urdf: Path | None = None) -> View:
    """Write the page of the runs in `folder` to `file`. `names`: only these runs; `urdf`: what the robot looks like.

    Raises what `recordings` and `read_urdf` raise.
    """
    chosen, notes = recordings(folder, names)
    packed = Packed()
    looks = read_urdf(urdf) if urdf else None
    shown = []
    for r in chosen:
        variant, said = _variant(r, packed, looks)
        shown.append(variant)
        notes += [f"{r.name}: {text}" for text in said]
    scene = {
        "title": folder.resolve().name,
        "variants": shown,
        "map": [to_hex(mpl.colormaps[MAP](x)) for x in np.linspace(0.0, 1.0, COLOURS)],
        "urdf": None if looks is None else _tree(looks[0], packed),
        "notes": notes,
        "report": report_beside(folder, file),
    }
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(_html(scene, packed), encoding="utf-8")
    return View(file, tuple(r.name for r in chosen), tuple(notes))


def report_beside(folder: Path, file: Path) -> str | None:
    """Way from the page to the report of a diagnosis beside it, in the folder of the runs, in its `diagnosis`, or in that beside it."""
    places = (
        file.parent / "report.html",
        folder / "report.html",
        folder / "diagnosis" / "report.html",
        folder.parent / "diagnosis" / "report.html",
    )
    found = next((p for p in places if p.is_file()), None)
    return None if found is None else Path(os.path.relpath(found, file.parent)).as_posix()


def _variant(r: Recorded, packed: Packed, looks: tuple[Tree, int] | None) -> tuple[dict[str, Any], list[str]]:
    """A run for the page, and what is not shown of it."""
    notes = []
    run, workpiece, s, q = r.run, r.workpiece(), r.robot(), r.q
    radius = CUTTER
    variant: dict[str, Any] = {
        "name": r.name.replace("_", " "),
        "t": packed.add(run.t[r.kept], "f4"),
        "tip": packed.add(r.p, "f4"),
        "quat": packed.add(r.quat, "f4"),
        "samples": len(run),
        "lost": r.lost,
    }
    if r.target is not None and r.across is not None:
        variant |= {"target": packed.add(r.target, "f4"), "across": packed.add(r.across, "f4")}
    else:
        notes.append("no planned path is recorded (path.p_BT_B); deviations are not shown")
    if r.f is not None:
        variant["force"] = packed.add(r.f, "f4")
    else:
        notes.append("no force on the tool is recorded (milling.f_T_B); none is shown")
    if workpiece is not None:
        stock, points = cut_stock(r, workpiece), patches(r, workpiece)
        radius = stock.cutter
        variant["part"] = {
            "position": workpiece.position,
            "turn": Rotation.from_euler("ZYX", workpiece.abc).as_quat().tolist(),  # x, y, z, w
            "shape": stock.shape,
            "low": stock.low.tolist(),
            "high": stock.high.tolist(),
            "start": packed.add(stock.start, "u2"),
            "frame": packed.add(stock.frame, "u2"),
            "cell": packed.add(stock.cell, "u4"),
            "level": packed.add(stock.level, "u2"),
        }
        if points is not None:
            variant["patches"] = {
                "size": points.size,
                "point": packed.add(points.point, "f4"),
                "normal": packed.add(np.rint(127.0 * points.normal), "i1"),
                "deviation": packed.add(points.deviation, "f4"),
                "time": packed.add(points.time, "f4"),
            }
    else:
        notes.append("the run has no block (milling.block_size); no part is shown")
    variant["cutter"] = radius
    if s is not None and q is None:
        q = r.solved(s)
        notes.append(
            "no axis angles are recorded (drive.q_motor); "
            + ("the arm is drawn rigid, as it holds the tool" if q is not None else "only the tool is shown")
        )
    if s is None or q is None:
        if s is None:
            notes.append("the run has no robot (robot_drive, robot_compliance); only the tool is shown")
    else:
        tree = from_dh(s, q[0], radius)
        R = Rotation.from_quat(r.quat, scalar_first=True).as_matrix()
        variant |= {"robot": _tree(tree, packed), "q": packed.add(q, "f4"), "bend": packed.add(deflections(tree, q, r.p, R), "f4")}
        if looks is not None:
            notes += _other_robot(looks, tree, q)
    return variant, notes


def _other_robot(looks: tuple[Tree, int], tree: Tree, q: FloatArray) -> list[str]:
    """A note if the sixth link of the URDF does not move as the flange of the run does."""
    link, flange = looks[0].poses(q)[:, looks[1]], tree.poses(q)[:, AXES - 1]
    between = np.linalg.inv(link) @ flange
    shift = float(np.max(np.linalg.norm(between[:, :3, 3] - between[0, :3, 3], axis=1)))
    turn = float(np.max(Rotation.from_matrix(between[0, :3, :3].T @ between[:, :3, :3]).magnitude()))
    if shift <= SAME_MOTION and turn <= SAME_TURN:
        return []
    return [
        f"the sixth link of the URDF shifts by {1e3 * shift:.0f} mm and turns by {math.degrees(turn):.1f} deg against the flange of the "
        "run: it is another robot, or its joints have other zeros or senses of rotation than axes A1..A6 of the controller"
    ]


def _tree(tree: Tree, packed: Packed) -> dict[str, Any]:
    frames = [
        {
            "parent": f.parent,
            "fixed": f.fixed.ravel().tolist(),
            "axis": None if f.axis is None else f.axis.tolist(),
            "slides": f.slides,
            "row": f.row.tolist(),
            "offset": f.offset,
        }
        for f in tree.frames
    ]
    bodies = []
    for b in tree.bodies:
        body: dict[str, Any] = {"frame": b.frame, "part": b.part}
        if b.mesh is None:
            body |= {"start": b.start.tolist(), "end": b.end.tolist(), "radius": b.radius, "round": b.round}
        else:
            corners, index = np.unique(b.mesh.reshape(-1, 3).astype(np.float32), axis=0, return_inverse=True)
            body |= {"corners": packed.add(corners, "f4"), "triangles": packed.add(index.ravel(), "u4")}
        bodies.append(body)
    return {"frames": frames, "bodies": bodies}


def _html(scene: dict[str, Any], packed: Packed) -> str:
    here = files("robomill.viewer")
    text = {name: here.joinpath(name).read_text(encoding="utf-8") for name in ("view.html", "view.css", "view.js", "three/three.min.js")}
    page = text["view.html"]
    parts = {
        "TITLE": escape(str(scene["title"])),
        "STYLE": text["view.css"],
        "SCENE": json.dumps(scene, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"),
        "DATA": packed.text(),
        "THREE": text["three/three.min.js"],
        "SCRIPT": text["view.js"],
    }
    head, *rest = page.split("{{")
    return head + "".join(parts[name] + tail for name, _, tail in (piece.partition("}}") for piece in rest))
