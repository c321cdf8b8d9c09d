"""Robots in URDF files: the links that are seen, with meshes (STL) and simple shapes, and the joints that move them.

Read is what a picture needs: `visual` of the links, `origin`, `axis` and `parent`/`child` of the joints. The six axes are the first
six moving joints on the way to the link that most of them move; the others stay at zero. Angles are those of the controller.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from urllib.parse import urlsplit
from urllib.request import url2pathname

import numpy as np
from scipy.spatial.transform import Rotation

from robomill.models.metrology.stl import StlError, read_triangles
from robomill.models.model.declaration import FloatArray
from robomill.viewer.chain import AXES, BASE, Body, Frame, Tree

_MOVING = ("revolute", "continuous", "prismatic")


class UrdfError(ValueError):
    """A robot file that cannot be shown; the text names file, element, what was found and what is expected."""


def read_urdf(file: Path) -> tuple[Tree, int]:
    """The tree of a URDF file, and the number of the frame that its sixth axis moves.

    Meshes are STL, binary or ASCII, in m times their `scale`; `package://NAME/...` is looked for in the folders above the file.
    UrdfError says what is wrong; FileNotFoundError names a file that is not there.
    """
    if not file.is_file():
        raise FileNotFoundError(f"no robot file {file}")
    try:
        robot = ET.parse(file).getroot()
    except ET.ParseError as error:
        raise UrdfError(f"{file}: is no XML: {error}; expected a URDF file (xacro files are expanded with `xacro` first)") from None
    if robot.tag != "robot":
        raise UrdfError(f"{file}: its root element is <{robot.tag}>; expected <robot>, as URDF files have it")
    links = {_attribute(file, link, "name"): link for link in robot.findall("link")}
    joints = robot.findall("joint")
    above = {_end(file, j, "child", links): j for j in joints}
    roots = [name for name in links if name not in above]
    if len(roots) != 1:
        raise UrdfError(f"{file}: {len(roots)} links have no parent ({', '.join(roots[:5]) or 'the joints form a ring'}); expected one")
    ways = {name: _way(file, name, above, links) for name in links}
    moving = max(([j for j in way if j.get("type") in _MOVING] for way in ways.values()), key=len)
    if len(moving) < AXES:
        found = ", ".join(str(j.get("name")) for j in moving) or "none"
        raise UrdfError(
            f"{file}: at most {len(moving)} moving joints lie behind each other ({found}); expected {AXES} of the types "
            f"{', '.join(_MOVING)}"
        )
    axes = moving[:AXES]
    frames: list[Frame] = []
    number = {roots[0]: BASE}
    for name in sorted(links, key=lambda n: len(ways[n])):
        if name in above:
            joint = above[name]
            row = np.zeros(AXES)
            if joint in axes:
                row[axes.index(joint)] = 1.0
            turns = joint.get("type") in _MOVING
            axis = _axis(file, joint) if turns else None
            number[name] = len(frames)
            frames.append(
                Frame(number[_end(file, joint, "parent", links)], _origin(file, joint), axis, joint.get("type") == "prismatic", row)
            )
    bodies = [body for name, link in links.items() for body in _bodies(file, link, number[name])]
    if not bodies:
        raise UrdfError(f"{file}: no link has a <visual>; there is nothing to be seen; give each link a <visual>")
    return Tree(tuple(frames), tuple(bodies)), number[_end(file, axes[-1], "child", links)]


def _attribute(file: Path, element: ET.Element, name: str) -> str:
    value = element.get(name)
    if value is None:
        raise UrdfError(f"{file}: <{element.tag}> has no attribute {name!r}; add it")
    return value


def _end(file: Path, joint: ET.Element, which: str, links: dict[str, ET.Element]) -> str:
    end = joint.find(which)
    name = "" if end is None else end.get("link", "")
    if name not in links:
        raise UrdfError(f"{file}: joint {joint.get('name')!r} has the {which} {name!r}; links: {', '.join(links)}; name one of them")
    return name


def _way(file: Path, name: str, above: dict[str, ET.Element], links: dict[str, ET.Element]) -> list[ET.Element]:
    """Joints from the root to a link."""
    way: list[ET.Element] = []
    while name in above:
        way.insert(0, above[name])
        if len(way) > len(above):
            raise UrdfError(f"{file}: the joints form a ring at link {name!r}; give each link one parent")
        name = _end(file, way[0], "parent", links)
    return way


def _numbers(file: Path, text: str, count: int, what: str) -> FloatArray:
    try:
        values = np.array([float(v) for v in text.split()])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count or not np.all(np.isfinite(values)):
        raise UrdfError(f"{file}: {what} is {text!r}; expected {count} numbers")
    return values


def _axis(file: Path, joint: ET.Element) -> FloatArray:
    element = joint.find("axis")
    axis = _numbers(file, "1 0 0" if element is None else element.get("xyz", "1 0 0"), 3, f"axis of joint {joint.get('name')!r}")
    length = float(np.linalg.norm(axis))
    if length == 0.0:
        raise UrdfError(f"{file}: axis of joint {joint.get('name')!r} is '0 0 0'; expected a direction")
    return np.asarray(axis / length)


def _origin(file: Path, element: ET.Element) -> FloatArray:
    """The pose [4, 4] that a joint or visual has in its parent."""
    T = np.eye(4)
    origin = element.find("origin")
    if origin is not None:
        T[:3, 3] = _numbers(file, origin.get("xyz", "0 0 0"), 3, f"xyz of an origin in <{element.tag}>")
        rpy = _numbers(file, origin.get("rpy", "0 0 0"), 3, f"rpy of an origin in <{element.tag}>")
        T[:3, :3] = Rotation.from_euler("xyz", rpy).as_matrix()
    return T


def _bodies(file: Path, link: ET.Element, frame: int) -> list[Body]:
    found = []
    for visual in link.findall("visual"):
        T = _origin(file, visual)
        for shape in visual.findall("geometry/*"):
            found.append(_body(file, link, shape, frame, T))
    return found


def _body(file: Path, link: ET.Element, shape: ET.Element, frame: int, T: FloatArray) -> Body:
    of = f"{shape.tag} of link {link.get('name')!r}"
    if shape.tag == "mesh":
        scale = _numbers(file, shape.get("scale", "1 1 1"), 3, f"scale of the {of}")
        name = _mesh_file(file, _attribute(file, shape, "filename"))
        if name.suffix.lower() != ".stl":
            raise UrdfError(f"{file}: {of} is {name.name}; expected STL: convert it, for instance with Blender or MeshLab")
        try:
            triangles = read_triangles(name) * scale
        except StlError as error:
            raise UrdfError(f"{file}: {of}: {error}") from None
        return Body(frame, "mesh", mesh=triangles @ T[:3, :3].T + T[:3, 3])
    if shape.tag == "box":
        half = 0.5 * _numbers(file, shape.get("size", ""), 3, f"size of the {of}")
        return Body(frame, "mesh", mesh=(_BOX * half) @ T[:3, :3].T + T[:3, 3])
    if shape.tag in ("cylinder", "sphere"):
        radius = float(_numbers(file, shape.get("radius", ""), 1, f"radius of the {of}")[0])
        length = float(_numbers(file, shape.get("length", ""), 1, f"length of the {of}")[0]) if shape.tag == "cylinder" else 0.0
        half = 0.5 * length * T[:3, 2]
        return Body(frame, "arm", T[:3, 3] - half, T[:3, 3] + half, radius, round=shape.tag == "sphere")
    raise UrdfError(f"{file}: link {link.get('name')!r} has the shape <{shape.tag}>; expected mesh, box, cylinder or sphere")


def _mesh_file(file: Path, name: str) -> Path:
    """Where a mesh is: beside the robot file, or in the folder of a package above it."""
    if name.startswith("file://"):
        place = urlsplit(name)  # file://meshes/arm.stl, which many write, has no host either
        name = url2pathname(place.path if place.netloc in ("", "localhost") else place.netloc + place.path)
    if not name.startswith("package://"):
        return file.parent / name
    inside = Path(name.removeprefix("package://"))
    places = [folder / part for folder in file.resolve().parents for part in (inside, Path(*inside.parts[1:]))]
    there = next((place for place in places if place.is_file()), None)
    if there is None:
        raise FileNotFoundError(f"{file}: no file for {name}; looked for {inside} and its part below the package in the folders above")
    return there


_CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
_SIDES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
_BOX = _CORNERS[np.array([[s[i], s[j], s[k]] for s in _SIDES for i, j, k in ((0, 1, 2), (0, 2, 3))])]
"""Triangles [12, 3, 3] of a cube of edge 2, facing outwards."""
