"""Checkpoints: everything that a run goes on from, in one file of its folder; and whether a run may go on.

`checkpoint.zip` is replaced as a whole, so there is always a complete one. It holds `checkpoint.json`
(the master's time, the structure of the slaves' states) and the bytes that occur in the states as
files of their own. Nothing in it is executed when it is read. A slave whose state is more than
numbers, texts, bytes, arrays and tuples, lists and dictionaries of these cannot be saved.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import tomllib
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from robomill.orchestration.errors import OrchestrationError, ResultsError, SlaveError, describe
from robomill.orchestration.runs.files import CHECKPOINT, RUN
from robomill.orchestration.runs.run import Run, read_info
from robomill.orchestration.slaves.protocol import FloatArray
from robomill.orchestration.system.definition import TICK, System
from robomill.orchestration.system.toml_text import dump

SCHEMA = "robomill-checkpoint/1"
_COMPARED = ("algorithm", "sources", "rates", "connections", "files", "parameters", "inputs", "clock", "columns")
_REMEDY = "run it anew without resuming, or into another folder"


class Snapshot(NamedTuple):
    """A run between two steps."""

    done: int
    """Steps done."""
    start_ticks: int
    step_ticks: int
    bus: FloatArray
    gather: Mapping[str, Any]
    """Positions of the inputs on the bus by component: they differ from the wiring's where inputs are overridden."""
    states: Mapping[str, Any]
    """States of the slaves, from `Slave.get_state`."""

    @property
    def time(self) -> float:
        """Time reached [s]."""
        return (self.start_ticks + self.done * self.step_ticks) / TICK


def write(folder: Path, snapshot: Snapshot) -> None:
    """Replace the checkpoint in `folder` by one of `snapshot`. SlaveError names a component whose state cannot be written.

    ResultsError if the disk refuses; the checkpoint before stays then.
    """
    blobs: list[bytes] = []
    states = {}
    for name, state in snapshot.states.items():
        try:
            states[name] = _encode(state, blobs)
        except TypeError as error:
            raise SlaveError(
                f"component {name!r} cannot save its state beyond this process: {error} (an FMU must declare canSerializeFMUstate); "
                "leave out checkpoint_every"
            ) from None
    content = {
        "schema": SCHEMA,
        "done": snapshot.done,
        "start_ticks": snapshot.start_ticks,
        "step_ticks": snapshot.step_ticks,
        "bus": _encode(snapshot.bus, blobs),
        "gather": _encode(dict(snapshot.gather), blobs),
        "states": states,
    }
    part = folder / (CHECKPOINT + ".part")
    try:
        with part.open("wb") as stream:
            with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
                archive.writestr("checkpoint.json", json.dumps(content))
                for i, blob in enumerate(blobs):
                    archive.writestr(f"{i}.bin", blob)
            stream.flush()
            os.fsync(stream.fileno())  # else the rename may reach the disk before the content
        part.replace(folder / CHECKPOINT)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise ResultsError(
            f"{folder / CHECKPOINT}: the checkpoint at t = {snapshot.time:.9g} s cannot be written: {error}"
            "; make room, or choose another folder"
        ) from None


def read(folder: Path) -> Snapshot:
    """The checkpoint in `folder`; ResultsError if it cannot be read."""
    file = folder / CHECKPOINT
    try:
        with zipfile.ZipFile(file) as archive:
            content = json.loads(archive.read("checkpoint.json"))
            if content["schema"] != SCHEMA:
                raise ValueError(f"its schema is {content['schema']!r}; this version reads {SCHEMA!r}")

            def blob(number: int) -> bytes:
                return archive.read(f"{number}.bin")

            return Snapshot(
                int(content["done"]),
                int(content["start_ticks"]),
                int(content["step_ticks"]),
                np.array(_decode(content["bus"], blob), dtype=np.float64),
                _decode(content["gather"], blob),
                {name: _decode(state, blob) for name, state in content["states"].items()},
            )
    except (OSError, zipfile.BadZipFile, ValueError, KeyError, TypeError, AttributeError, EOFError, NotImplementedError) as error:
        raise ResultsError(f"{file}: the checkpoint cannot be read: {error}; {_REMEDY}") from None


def check_savable(slaves: Mapping[str, Any]) -> None:
    """SlaveError that names the first slave that cannot save its state: at the beginning of a run rather than at its first checkpoint."""
    for name, slave in slaves.items():
        try:
            _encode(slave.get_state(), [])
        except TypeError as error:
            raise SlaveError(
                f"component {name!r} cannot save its state beyond this process, which checkpoint_every needs: {error} "
                "(an FMU must declare canSerializeFMUstate); leave out checkpoint_every"
            ) from None
        except Exception as error:
            raise SlaveError(
                f"component {name!r} cannot save its state, which checkpoint_every needs: {describe(error)}; leave out checkpoint_every"
            ) from error


def alike(example: Any, state: Any) -> Any:
    """`state` as read from a file, with the named tuples of `example`, a state of the same slave."""
    if isinstance(state, tuple) and isinstance(example, tuple) and len(state) == len(example):
        values = [alike(e, s) for e, s in zip(example, state, strict=True)]
        return type(example)(*values) if hasattr(example, "_fields") else tuple(values)
    return state


def _encode(value: Any, blobs: list[bytes]) -> Any:
    """JSON for a state; bytes and arrays go to `blobs`. TypeError for anything else than plain data."""
    if value is None or (isinstance(value, bool | int | float | str) and not isinstance(value, np.generic)):
        return value
    if isinstance(value, bytes | bytearray):
        blobs.append(bytes(value))
        return {"bytes": len(blobs) - 1}
    if isinstance(value, np.ndarray | np.generic):
        stream = io.BytesIO()
        np.save(stream, np.asarray(value), allow_pickle=False)
        blobs.append(stream.getvalue())
        return {"array": len(blobs) - 1}
    if isinstance(value, tuple | list):
        return {"tuple" if isinstance(value, tuple) else "list": [_encode(v, blobs) for v in value]}
    if isinstance(value, dict):
        return {"dict": [[_encode(k, blobs), _encode(v, blobs)] for k, v in value.items()]}
    raise TypeError(f"it holds a {type(value).__name__}")


def _decode(value: Any, blob: Any) -> Any:
    if not isinstance(value, dict):
        return value
    ((kind, content),) = value.items()
    if kind == "bytes":
        return blob(content)
    if kind == "array":
        array = np.load(io.BytesIO(blob(content)), allow_pickle=False)
        return array if array.ndim else array[()]
    if kind == "dict":
        return {_decode(k, blob): _decode(v, blob) for k, v in content}
    made = [_decode(v, blob) for v in content]
    return tuple(made) if kind == "tuple" else made


def identity(system: System, parameters: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """What makes a run what it is, beyond its parameters: connections, and SHA-256 of the files that components are or read."""
    files = {c.name: system.folder / c.source for c in system.components if c.source.endswith(".fmu")}
    files |= {f"correction of {c.name}": system.folder / c.correction for c in system.components if c.correction is not None}
    files |= {f"{name}.{key}": Path(v) for name, values in parameters.items() for key, v in values.items() if isinstance(v, str) and v}
    hashes = {name: hashlib.sha256(f.read_bytes()).hexdigest() for name, f in files.items() if f.is_file()}
    return {"connections": [f"{c}{' (delayed)' if c.delayed else ''}" for c in system.connections], "files": hashes}


def continuation(folder: Path, now: Mapping[str, Any], stop: float, stop_when: str | None) -> Run | Snapshot | None:
    """How a run in `folder` goes on: the run itself if it is complete, its checkpoint, or None if it has to begin anew.

    `now` is its run.toml as it would be today; `stop` [s] and `stop_when` say where it is to end. OrchestrationError says what has
    changed since it was begun.
    """
    if not (folder / RUN).is_file():
        return None
    stored = read_info(folder)
    _check_same(folder, stored, now)
    if stored.get("outcome") == "finished":
        run = Run.load(folder)
        reached = len(run) and run.t[-1] >= stop - 0.5 * float(now["clock"]["step"])
        if reached or (stop_when is not None and (stop_when not in run.columns or (len(run) and run[stop_when][-1] != 0.0))):
            return run
    return read(folder) if (folder / CHECKPOINT).is_file() else None


def _check_same(folder: Path, stored: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    """OrchestrationError that says what has changed since the run in `folder` was begun: run.toml as it is and as it would be."""
    stored, now = _by_content(stored), _by_content(tomllib.loads(dump(now)))
    for key in _COMPARED:
        difference = _difference(key, stored.get(key), now.get(key))
        if difference:
            raise OrchestrationError(f"{folder} holds a run of another system: {difference}; {_REMEDY}")


def _by_content(info: Mapping[str, Any]) -> dict[str, Any]:
    """run.toml without the paths of files whose content it knows: the same file may stand elsewhere now."""
    known = info.get("files", {})
    parameters = {
        name: {k: v for k, v in values.items() if f"{name}.{k}" not in known} for name, values in info.get("parameters", {}).items()
    }
    return {**info, "parameters": parameters}


def _difference(path: str, old: Any, new: Any) -> str:
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        for key in dict.fromkeys((*old, *new)):
            if text := _difference(f"{path}: {key}" if path in _COMPARED else f"{path}.{key}", old.get(key), new.get(key)):
                return text
        return ""
    if isinstance(old, Mapping) != isinstance(new, Mapping):
        return f"{path}: only {'before' if isinstance(old, Mapping) else 'now'}"
    if isinstance(old, Sequence) and isinstance(new, Sequence) and not isinstance(old, str) and old != new:
        gone, come = [x for x in old if x not in new], [x for x in new if x not in old]
        return (
            f"{path}: " + (f"without {', '.join(map(str, gone))} " if gone else "") + (f"with {', '.join(map(str, come))}" if come else "")
        )
    return "" if old == new else f"{path} was {old!r}, is {new!r}"
