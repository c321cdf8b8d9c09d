"""The tree that the page moves is the robot of the models, and bends as the tool says."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from robomill.models.robot.kinematics import SPINDLE_ACROSS, forward, load_robot
from robomill.models.robot.numeric_inverse import kinematics
from robomill.viewer.chain import AXES, TIP, deflections, from_dh
from tests.tolerances import ROUNDOFF, discretisation

Q = np.radians([[0.65, -96.07, 122.56, 0.0, -26.49, 0.0], [10.0, -80.0, 100.0, 20.0, 50.0, -30.0], [-20.0, -95.0, 110.0, 5.0, 40.0, 60.0]])
FEW = 100 * ROUNDOFF
"""m: seven products of matrices in another order, of lengths of metres."""
BENT = 1e-3
"""rad and m: as much as an arm bends; J = 10/m is the curvature of 2 m of arm in six joints."""


@pytest.mark.parametrize("name", ["kr300_r2500_ultra", "kr210_2", "irb6400r_25_150", "fanuc_r2000ic", "ur10"])
def test_frames_are_those_of_the_kinematics(name: str) -> None:
    s = kinematics(load_robot(name), SPINDLE_ACROSS)
    found = from_dh(s, Q[0], 8e-3).poses(Q)
    for n, q in enumerate(Q):
        forward(s, q)
        assert found[n, :, :3, 3] == pytest.approx(np.array(s.link_p), rel=ROUNDOFF, abs=FEW)
        assert found[n, :, :3, :3] == pytest.approx(np.array(s.link_R), rel=ROUNDOFF, abs=FEW)


@pytest.mark.parametrize("name", ["kr300_r2500_ultra", "irb6400r_25_150"])
def test_turns_of_the_axes_move_the_tool_to_where_it_is(name: str) -> None:
    tree = from_dh(kinematics(load_robot(name), SPINDLE_ACROSS), Q[0], 8e-3)
    turn = BENT * np.array([[1.0, -0.5, 0.3, 0.8, -1.0, 0.4]])
    for q in Q:
        bent = tree.poses(q + turn)[:, TIP]
        found = deflections(tree, q[None], bent[:, :3, 3], bent[:, :3, :3])
        after = tree.poses(q + found)[0, TIP, :3, 3]
        assert after == pytest.approx(bent[0, :3, 3], rel=ROUNDOFF, abs=discretisation(10.0, BENT, 2))


def test_bodies_hold_together() -> None:
    tree = from_dh(kinematics(load_robot("kr300_r2500_ultra"), SPINDLE_ACROSS), Q[0], 8e-3)
    T = tree.poses(Q)
    ends = [(T[:, b.frame] @ np.r_[b.start, 1.0], T[:, b.frame] @ np.r_[b.end, 1.0]) for b in tree.bodies if b.frame >= 0]
    arm = ends[1:9]  # from the shoulder to the flange each begins where the one before it ends, in every pose
    for (_, end), (start, _) in pairwise(arm):
        assert start == pytest.approx(end, rel=ROUNDOFF, abs=FEW)
    assert ends[-1][1] == pytest.approx(T[:, TIP, :, 3], rel=ROUNDOFF, abs=FEW)
    assert tree.bodies[-1].radius == 8e-3
    assert len(tree.frames) == AXES + 1
