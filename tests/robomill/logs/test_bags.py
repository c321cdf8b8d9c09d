"""Specification of ROS bags as logs: rosbag2 and MCAP, elements by name, clocks, and what is refused."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robomill.logs.bags import read_bag
from robomill.logs.log import LogError
from tests.robomill.logs.foreign import bring, refused
from tests.tolerances import ROUNDOFF

rosbags = pytest.importorskip("rosbags")
BEGIN = 1_700_000_000_000_000_000
"""Nanoseconds: a date, so that a clock in floating seconds since 1970 would be 240 ns coarse."""
LATE = 2_000_000
"""Nanoseconds between stamp and recording."""
COUNT = 50


def written(folder: Path, plugin: str, lacking: int | None = None) -> Path:
    """A bag with joints at 100 Hz, in turn in another order, a force at 50 Hz, texts and an image; message `lacking` has one joint."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    t: Any = store.types
    header, time = t["std_msgs/msg/Header"], t["builtin_interfaces/msg/Time"]

    def head(at: int) -> Any:
        return header(stamp=time(sec=at // 1_000_000_000, nanosec=at % 1_000_000_000), frame_id="base")

    bag = folder / "bag"
    with Writer(bag, version=9, storage_plugin=StoragePlugin[plugin]) as writer:
        names = {
            "/joint_states": "sensor_msgs/msg/JointState",
            "/ft": "geometry_msgs/msg/WrenchStamped",
            "/phase": "std_msgs/msg/String",
            "/camera": "sensor_msgs/msg/CompressedImage",
        }
        topics = {name: writer.add_connection(name, kind, typestore=store) for name, kind in names.items()}

        def write(topic: str, at: int, message: Any) -> None:
            writer.write(topics[topic], at + LATE, store.serialize_cdr(message, names[topic]))

        vector = t["geometry_msgs/msg/Vector3"]
        for k in range(COUNT):
            at = BEGIN + 10_000_000 * k
            joints = ["shoulder", "elbow"] if k % 2 == 0 else ["elbow", "shoulder"]
            q = [0.01 * k, 2.0] if k % 2 == 0 else [2.0, 0.01 * k]
            few = 1 if k == lacking else 2
            empty = np.array([])
            state = t["sensor_msgs/msg/JointState"](head(at), joints[:few], np.array(q[:few]), empty, empty)
            write("/joint_states", at, state)
            if k % 2 == 0:
                wrench = t["geometry_msgs/msg/Wrench"](vector(1.0 * k, 2.0, 3.0), vector(0.0, 0.0, 0.5))
                write("/ft", at, t["geometry_msgs/msg/WrenchStamped"](head(at), wrench))
                write("/phase", at, t["std_msgs/msg/String"]("air" if k < COUNT // 2 else "cut"))
                write("/camera", at, t["sensor_msgs/msg/CompressedImage"](head(at), "jpeg", np.zeros(9, dtype=np.uint8)))
    return bag


def one_file(bag: Path, plugin: str) -> Path:
    return next(bag.glob("*.mcap" if plugin == "MCAP" else "*.db3"))


@pytest.mark.parametrize("plugin", ["SQLITE3", "MCAP"])
def test_topics_are_columns_with_their_clocks(tmp_path: Path, plugin: str) -> None:
    bag = written(tmp_path, plugin)
    for file in (bag, one_file(bag, plugin)):
        log = read_bag(file)
        assert {"/joint_states/position[shoulder]", "/joint_states/position[elbow]", "/ft/wrench.force.x", "/ft/time"} <= set(log.names)
        assert not [n for n in log.names if "camera/data" in n or "header" in n]
        np.testing.assert_allclose(log["/joint_states/position[shoulder]"], 0.01 * np.arange(COUNT), rtol=ROUNDOFF)
        np.testing.assert_allclose(log["/joint_states/position[elbow]"], np.full(COUNT, 2.0), rtol=ROUNDOFF)
        np.testing.assert_allclose(log["/ft/wrench.force.x"], np.arange(0.0, COUNT, 2.0), rtol=ROUNDOFF)
        np.testing.assert_allclose(log["/joint_states/time"], 0.01 * np.arange(COUNT) - 0.002, rtol=0.0, atol=ROUNDOFF)
        np.testing.assert_allclose(read_bag(file, "received")["/ft/time"], 0.02 * np.arange(COUNT // 2), rtol=0.0, atol=ROUNDOFF)
        np.testing.assert_allclose(log["/phase/time"], 0.02 * np.arange(COUNT // 2), rtol=0.0, atol=ROUNDOFF)
        assert log.states("/phase/data").tolist() == ["air"] * 13 + ["cut"] * 12
        assert log.epoch == BEGIN + LATE


MAP = """
[clock]
column = "/joint_states/time"
unit = "s"
[[signal]]
port = "robot.q"
columns = ["/joint_states/position[shoulder]", "/joint_states/position[elbow]"]
unit = "rad"
[[signal]]
port = "sensor.f"
column = "/ft/wrench.force.x"
unit = "N"
"""


def test_topics_of_other_rates_come_onto_one_clock_and_are_cut_where_another_topic_says(tmp_path: Path) -> None:
    bag = written(tmp_path, "MCAP")
    run = bring(tmp_path, MAP, bag)
    np.testing.assert_allclose(run["sensor.f"], 100.0 * (run.t + 0.002), rtol=0.0, atol=1e3 * ROUNDOFF)
    assert run.info["imported"]["resampled"] is True, "the force has a clock of its own"
    assert run.info["imported"]["date"] == "2023-11-14T22:13:20+00:00"
    whole = bring(tmp_path, MAP + '[cut]\nmarker = "/phase/data"\nwhile = "cut"\n', bag, "run/repeat_1")
    assert abs(whole["robot.q"][0, 0] - 0.27) < ROUNDOFF, "the first sample at or after 0.26 s of the bag, 2 ms behind the stamps"
    dated = bring(tmp_path, MAP + "[cut]\nfrom = 2023-11-14T22:13:20.2Z\n", bag)
    assert abs(dated["robot.q"][0, 0] - 0.20) < ROUNDOFF


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("[elbow]", "[knee]", "available: /joint_states/position[shoulder], /joint_states/position[elbow]"),
        ("/ft/wrench.force.x", "/ft/force.x", "unknown column '/ft/force.x'; did you mean"),
        ('"/ft/wrench.force.x"', '"/phase/data"', "column '/phase/data' holds texts, such as 'air'; expected numbers"),
        ("[clock]", '[log]\nstamps = "sent"\n[clock]', "unknown stamps 'sent'; available: header, received"),
    ],
)
def test_what_is_not_there_is_refused(tmp_path: Path, old: str, new: str, expected: str) -> None:
    assert expected in refused(tmp_path, MAP.replace(old, new, 1), written(tmp_path, "MCAP"))


def test_a_message_without_a_joint_says_which(tmp_path: Path) -> None:
    text = refused(tmp_path, MAP, written(tmp_path, "MCAP", lacking=4))
    assert "message 5 of /joint_states has no '/joint_states/position[elbow]', which the first one has" in text


def test_bags_without_their_package_name_the_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "log.mcap").write_bytes(b"")
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    text = refused(tmp_path, MAP, tmp_path / "log.mcap")
    assert "needs the package 'rosbags', which is not installed; install it with `pip install rosbags` (or robomill[ros])" in text


@pytest.mark.parametrize("suffix", ["mcap", "db3", "bag"])
def test_a_file_that_is_no_bag_is_refused(tmp_path: Path, suffix: str) -> None:
    (tmp_path / f"log.{suffix}").write_bytes(b"something else altogether, and rather more than a header")
    with pytest.raises(LogError, match="not a ROS bag, or damaged"):
        read_bag(tmp_path / f"log.{suffix}")
