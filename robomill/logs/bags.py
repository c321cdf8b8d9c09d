"""ROS bags, through rosbags: rosbag2 (folders, .db3), MCAP and rosbag1."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from robomill.logs.log import FloatArray, Log, LogError, missing_package

_NS = 1e-9
_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
TIME = "time"
"""Column of each topic with its clock."""
Step = str | int
"""Field of a message, or index within a list of messages."""


@dataclass(frozen=True)
class _Leaf:
    """A number, text or array of them within the messages of a topic."""

    topic: str
    steps: tuple[Step, ...]
    index: tuple[int, ...] | None = None
    """Element of the array (counted from zero)."""
    called: str | None = None
    """Instead: element that the field `name` of the message calls so, wherever it stands (sensor_msgs/JointState)."""


def read_bag(file: Path, stamps: str = "header") -> Log:
    """Columns `/topic/field.field[1]` of all topics, each topic with its clock `/topic/time` [s since the first message of the bag].

    `stamps`: "header" takes the time from the header of messages that have one, "received" that at which they were recorded.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise missing_package(file, "ROS bags and MCAP files", "rosbags", "ros", "export the log as CSV") from None

    @contextmanager
    def opened() -> Iterator[Any]:
        try:
            with AnyReader([file], default_typestore=get_typestore(Stores.LATEST)) as reader:
                yield reader
        except LogError:
            raise
        except Exception as error:  # rosbags raises many kinds for a damaged file
            raise LogError(f"{file}: not a ROS bag, or damaged: {error}; copy it anew, or repair it with the tools of ROS") from None

    with opened() as reader:
        leaves: dict[str, _Leaf] = {}
        for topic, info in reader.topics.items():
            first = next((reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages(info.connections)), None)
            if first is not None:
                leaves |= {f"{topic}/{name}": leaf for name, leaf in _leaves(topic, first, (), list(getattr(first, "name", ())))}
        epoch = int(reader.start_time)
    topics = dict.fromkeys(leaf.topic for leaf in leaves.values())

    @cache
    def messages(topic: str) -> tuple[FloatArray, list[Any]]:
        """Times [s] and messages of a topic."""
        with opened() as reader:
            found = [(at, reader.deserialize(raw, c.msgtype)) for c, at, raw in reader.messages(reader.topics[topic].connections)]
        own = [_header_stamp(message) for _, message in found] if stamps == "header" else []
        times = own if own and all(own) else [at for at, _ in found]
        return np.array([_NS * (t - epoch) for t in times]), [message for _, message in found]

    def values(name: str) -> list[Any]:
        leaf = leaves[name]
        found = []
        for k, message in enumerate(messages(leaf.topic)[1], 1):
            try:
                found.append(_value(message, leaf))
            except (LookupError, ValueError):
                raise LogError(
                    f"{file}: message {k} of {leaf.topic} has no {name!r}, which the first one has"
                    "; record the topic anew, or leave the field out"
                ) from None
        return found

    def fetch(name: str) -> FloatArray:
        if name not in leaves:
            return messages(name.removesuffix(f"/{TIME}"))[0]
        found = values(name)
        if isinstance(found[0], str):
            raise LogError(f"{file}: column {name!r} holds texts, such as {found[0]!r}; expected numbers")
        return np.array(found, dtype=np.float64)

    def texts(name: str) -> npt.NDArray[np.str_]:
        return np.array(values(name))

    clocks = {name: f"{leaf.topic}/{TIME}" for name, leaf in leaves.items()}
    return Log(file, (*leaves, *(f"{t}/{TIME}" for t in topics)), fetch, clocks=clocks, texts=texts, epoch=epoch)


def _leaves(topic: str, value: Any, steps: tuple[Step, ...], called: list[str]) -> Iterator[tuple[str, _Leaf]]:
    """Name and place of what a message holds. Bytes (images, point clouds) are no signals; a header is the clock."""
    name = "".join(f"[{s + 1}]" if isinstance(s, int) else f".{s}" for s in steps).lstrip(".")
    if isinstance(value, bool | int | float | str) or getattr(value, "__msgtype__", "") in _TIMES:
        yield name, _Leaf(topic, steps)
    elif isinstance(value, np.ndarray) and value.dtype != np.uint8:
        if called and value.shape == (len(called),):
            for text in called:
                yield f"{name}[{text}]", _Leaf(topic, steps, called=text)
        else:
            for index in np.ndindex(*value.shape):
                yield f"{name}[{','.join(str(i + 1) for i in index)}]", _Leaf(topic, steps, index)
    elif isinstance(value, list):
        for i, member in enumerate(value):
            yield from _leaves(topic, member, (*steps, i), [])
    elif is_dataclass(value):
        for f in fields(value):
            if f.name not in ("header", "__msgtype__") and not (f.name == "name" and called):
                yield from _leaves(topic, getattr(value, f.name), (*steps, f.name), called)


def _value(message: Any, leaf: _Leaf) -> float | str:
    value = message
    for step in leaf.steps:
        value = value[step] if isinstance(step, int) else getattr(value, step)
    if leaf.called is not None:
        return float(value[message.name.index(leaf.called)])
    if leaf.index is not None:
        return float(value[leaf.index])
    return value if isinstance(value, str) else _NS * _nanoseconds(value) if is_dataclass(value) else float(value)


def _nanoseconds(stamp: Any) -> int:
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def _header_stamp(message: Any) -> int:
    """Stamp of the header [ns]; 0 where there is none, or it was not set."""
    header = getattr(message, "header", None)
    return 0 if header is None else _nanoseconds(header.stamp)
