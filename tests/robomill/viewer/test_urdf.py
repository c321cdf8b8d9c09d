"""Robots of users: links, joints and meshes of a URDF file, and one clear error for each that cannot be shown."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from robomill.models.metrology.stl import StlError, solid_volume
from robomill.models.robot.kinematics import KR300, SPINDLE_ACROSS
from robomill.models.robot.numeric_inverse import kinematics
from robomill.viewer.chain import AXES, from_dh
from robomill.viewer.urdf import UrdfError, read_urdf
from tests.tolerances import ROUNDOFF

Q = np.radians([[10.0, -80.0, 100.0, 20.0, 50.0, -30.0], [-20.0, -95.0, 110.0, 5.0, 40.0, 60.0]])
WRITTEN = 1e-9
"""m: numbers of a file with twelve digits, in metres."""
SINGLE = 1e-6
"""Relative: STL holds single precision."""
VISUAL = '<visual><origin xyz="0 0 0.1"/><geometry><box size="0.1 0.2 0.3"/></geometry></visual>'


def urdf(visual: str = VISUAL) -> str:
    """The KR 300 as others would write it: the axis angle zero is that of the controller, the sense is in the axis."""
    tree = from_dh(kinematics(KR300, SPINDLE_ACROSS), Q[0], 8e-3)
    links = ["<link name='base'/>", *(f"<link name='link_{i + 1}'>{visual}</link>" for i in range(AXES)), "<link name='flange'/>"]
    joints = []
    for i, f in enumerate(tree.frames[:AXES]):
        at_zero = f.fixed.copy()
        at_zero[:3, :3] = f.fixed[:3, :3] @ Rotation.from_rotvec([0.0, 0.0, f.offset]).as_matrix()
        rpy = Rotation.from_matrix(at_zero[:3, :3]).as_euler("xyz")
        place = f"<origin xyz='{' '.join(f'{v:.12f}' for v in at_zero[:3, 3])}' rpy='{' '.join(f'{v:.12f}' for v in rpy)}'/>"
        parent = "base" if i == 0 else f"link_{i}"
        joints.append(
            f"<joint name='joint_{i + 1}' type='revolute'>{place}<parent link='{parent}'/><child link='link_{i + 1}'/>"
            f"<axis xyz='0 0 {f.row[i]:g}'/></joint>"
        )
    joints.append("<joint name='fixed' type='fixed'><parent link='link_6'/><child link='flange'/></joint>")
    return f"<robot name='kr'>{''.join(links)}{''.join(joints)}</robot>"


def test_it_moves_as_the_robot_that_it_is(tmp_path: Path) -> None:
    file = tmp_path / "kr.urdf"
    file.write_text(urdf())
    tree, last = read_urdf(file)
    want = from_dh(kinematics(KR300, SPINDLE_ACROSS), Q[0], 8e-3).poses(Q)[:, AXES - 1]
    assert tree.poses(Q)[:, last] == pytest.approx(want, rel=ROUNDOFF, abs=WRITTEN)
    assert len(tree.bodies) == AXES
    box = tree.bodies[0].mesh
    assert box is not None
    assert solid_volume(box) == pytest.approx(0.1 * 0.2 * 0.3, rel=ROUNDOFF)  # positive: its triangles face outwards
    assert box.reshape(-1, 3)[:, 2].min() == pytest.approx(0.1 - 0.15, rel=ROUNDOFF)


@pytest.mark.parametrize("kind", ["stl", "stl_ascii"])
@pytest.mark.parametrize("name", ["meshes/link.stl", "package://my_robot/meshes/link.stl"])
def test_meshes_are_found_beside_and_in_the_package(tmp_path: Path, kind: str, name: str) -> None:
    folder = tmp_path / "my_robot"
    (folder / "meshes").mkdir(parents=True)
    mesh = trimesh.creation.cylinder(100.0, 300.0, sections=12)
    mesh.export(folder / "meshes" / "link.stl", file_type=kind)
    file = folder / "kr.urdf"
    file.write_text(urdf(f"<visual><geometry><mesh filename='{name}' scale='0.001 0.001 0.001'/></geometry></visual>"))
    body = read_urdf(file)[0].bodies[0]
    assert body.mesh is not None
    assert solid_volume(body.mesh) == pytest.approx(1e-9 * mesh.volume, rel=10 * SINGLE)


@pytest.mark.parametrize(
    "name", ["{folder}/a b/arm.stl", "file://{uri}/a%20b/arm.stl", "file://localhost{uri}/a%20b/arm.stl", "file://a%20b/arm.stl"]
)
def test_meshes_are_found_by_uri(tmp_path: Path, name: str) -> None:
    (tmp_path / "a b").mkdir()
    trimesh.creation.box((1.0, 1.0, 1.0)).export(tmp_path / "a b" / "arm.stl")
    file = tmp_path / "kr.urdf"
    place = name.format(folder=tmp_path, uri=tmp_path.as_uri().removeprefix("file://"))
    file.write_text(urdf(f"<visual><geometry><mesh filename='{place}'/></geometry></visual>"))
    assert len(read_urdf(file)[0].bodies) == AXES


def test_round_shapes(tmp_path: Path) -> None:
    file = tmp_path / "kr.urdf"
    shapes = (
        "<visual><origin rpy='1.5707963267948966 0 0'/><geometry><cylinder radius='0.1' length='0.4'/></geometry></visual>"
        "<visual><geometry><sphere radius='0.2'/></geometry></visual>"
    )
    file.write_text(urdf(shapes))
    cylinder, sphere = read_urdf(file)[0].bodies[:2]
    assert cylinder.start == pytest.approx([0.0, 0.2, 0.0], rel=ROUNDOFF, abs=ROUNDOFF)
    assert (cylinder.radius, cylinder.round, sphere.radius, sphere.round) == (0.1, False, 0.2, True)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("<robot name='kr'>", "<robot name='kr'", "is no XML: .*; expected a URDF file .xacro files are expanded"),
        ("robot", "sdf", "its root element is <sdf>; expected <robot>"),
        ("type='revolute'", "type='fixed'", "at most 0 moving joints lie behind each other .none.; expected 6 of the types revolute"),
        ("child link='link_3'", "child link='arm'", "joint 'joint_3' has the child 'arm'; links: base, link_1"),
        ("<axis xyz='0 0 -1'/>", "<axis xyz='0 0 0'/>", "axis of joint 'joint_1' is '0 0 0'; expected a direction"),
        ("<axis xyz='0 0 -1'/>", "<axis xyz='0 0 nan'/>", "axis of joint 'joint_1' is '0 0 nan'; expected 3 numbers"),
        ('box size="0.1 0.2 0.3"', "box size='0.1'", "size of the box of link 'link_1' is '0.1'; expected 3 numbers"),
        ('<box size="0.1 0.2 0.3"/>', "<capsule/>", "has the shape <capsule>; expected mesh, box, cylinder or sphere"),
        (VISUAL, "", "no link has a <visual>; there is nothing to be seen"),
        ("<link name='base'/>", "<link name='base'/><link name='loose'/>", "2 links have no parent .base, loose.; expected one"),
        ("<link name='base'/>", "<link/>", "<link> has no attribute 'name'"),
        ('<box size="0.1 0.2 0.3"/>', "<mesh filename='arm.dae'/>", "mesh of link 'link_1' is arm.dae; expected STL: convert it"),
    ],
)
def test_what_cannot_be_shown_is_refused(tmp_path: Path, old: str, new: str, text: str) -> None:
    file = tmp_path / "kr.urdf"
    right = urdf()
    assert old in right
    file.write_text(right.replace(old, new))
    with pytest.raises(UrdfError, match=text) as error:
        read_urdf(file)
    assert str(file) in str(error.value)


def test_missing_and_broken_files_are_named(tmp_path: Path) -> None:
    file = tmp_path / "kr.urdf"
    with pytest.raises(FileNotFoundError, match=r"no robot file .*kr.urdf"):
        read_urdf(file)
    file.write_text(urdf("<visual><geometry><mesh filename='package://other/arm.stl'/></geometry></visual>"))
    with pytest.raises(FileNotFoundError, match=r"no file for package://other/arm.stl; looked for other/arm.stl"):
        read_urdf(file)
    file.write_text(urdf("<visual><geometry><mesh filename='arm.stl'/></geometry></visual>"))
    with pytest.raises(FileNotFoundError, match=r"no STL file .*arm.stl"):
        read_urdf(file)
    (tmp_path / "arm.stl").write_bytes(b"\0" * 100)
    with pytest.raises(UrdfError, match=r"mesh of link 'link_1': .*is no STL file, or a binary one that ends early"):
        read_urdf(file)
    assert issubclass(StlError, ValueError)
