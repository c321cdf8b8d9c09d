"""From a system to a run: open the components, set their parameters, wire them, step them, record them."""

from __future__ import annotations

import math
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from robomill.collector import put_off
from robomill.orchestration.errors import OrchestrationError, PlacedError, SlaveError, SystemFileError, describe
from robomill.orchestration.loop.master import Manipulator, Master, Observer, Progress, Saver
from robomill.orchestration.runs import checkpoint
from robomill.orchestration.runs.lock import FolderLock
from robomill.orchestration.runs.memory import Memory
from robomill.orchestration.runs.recorder import Recorder
from robomill.orchestration.runs.run import Run, check_vacant
from robomill.orchestration.runs.watch import Watch
from robomill.orchestration.slaves.corrected import Corrected
from robomill.orchestration.slaves.multirate import MultiRate
from robomill.orchestration.slaves.playback import Playback
from robomill.orchestration.slaves.protocol import Port, PortData, Scalar, Slave, arrays, outputs, plain
from robomill.orchestration.system.definition import Component, System
from robomill.orchestration.system.own_units import by_definition
from robomill.orchestration.system.parameters import Convert, prepare, same_unit_only
from robomill.orchestration.system.wiring import Wiring, wire

Resolver = Callable[[str, str], Slave]
"""(source, instance name) -> an in-process slave; LookupError with a text that lists the sources there are."""

REPLAY = "replay:"
MEASURED = "measured"
"""Source of a component that plays what was measured in the run that is looked at: the diagnosis puts `measured:FOLDER` there."""


@dataclass(frozen=True)
class Assembly:
    """The opened and configured components of a system, wired. Close it (or use it in `with`)."""

    system: System
    slaves: Mapping[str, Slave]
    wiring: Wiring
    parameters: Mapping[str, Mapping[str, Scalar]]
    """Values per element as they were set, in the unit of the port."""
    inputs: Mapping[str, Mapping[str, Scalar]] = field(default_factory=dict)
    """Start values of inputs that were set, by component and element."""

    def __enter__(self) -> Assembly:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close all components."""
        _close(self.slaves.values())

    def about(self) -> dict[str, Any]:
        """What run.toml says about the system."""
        s = self.system
        return {
            "system": s.name,
            "description": s.description,
            "algorithm": s.algorithm,
            "warnings": list(self.wiring.warnings),
            "rates": {c.name: c.rate if c.every == 1 else 1.0 / c.every for c in s.components if (c.rate, c.every) != (1, 1)},
            "sources": {c.name: c.source for c in s.components},
            **({"corrections": found} if (found := {c.name: c.correction for c in s.components if c.correction is not None}) else {}),
            "parameters": {name: dict(values) for name, values in self.parameters.items()},
            "inputs": {name: dict(values) for name, values in self.inputs.items()},
        }


@put_off()  # ports live on: to look through tens of thousands of them again and again takes a third of the time
def assemble(system: System, resolver: Resolver | None = None, convert: Convert = same_unit_only) -> Assembly:
    """Open all components, check and set their parameters, check the wiring.

    `convert` turns values with units into those of the ports. Raises SlaveError, SystemFileError or
    WiringError, with file and line where they are known; nothing stays open then.
    """
    if system.equipment and not system.equipped:
        named = ", ".join(f"[{key}]" for key in system.equipment)
        raise SystemFileError(
            f"{system.where(None)}the system has {named}, which nobody has looked up for its components; load it with robomill.System.load"
        )
    slaves: dict[str, Slave] = {}
    warnings: list[str] = list(system.warnings)
    try:
        for c in system.components:
            with attributed(system, c):
                slaves[c.name] = _open(system, c, resolver)
                if c.correction is not None:
                    about = Component(f"correction of {c.name}", c.correction)
                    slaves[c.name] = Corrected(slaves[c.name], _open(system, about, resolver))
            warnings += [f"component {c.name!r}: {text}" for text in getattr(slaves[c.name], "warnings", ())]
        for c in system.components:
            old = slaves[c.name]
            if isinstance(old, Playback):  # its inputs are whatever is connected to it
                slaves[c.name] = old.with_inputs(_connected_inputs(system, c.name, {n: s.ports for n, s in slaves.items()}))
        parameters: dict[str, dict[str, Scalar]] = {}
        starts: dict[str, dict[str, Scalar]] = {}
        for c in system.components:
            own = by_definition(convert, getattr(getattr(slaves[c.name], "description", None), "units", {}))
            with attributed(system, c):
                parameters[c.name] = _configure(system, c, slaves[c.name], own)
                if c.inputs:
                    starts[c.name] = prepare(c.name, slaves[c.name].ports, c.inputs, own, causality="input")
                    slaves[c.name].configure(starts[c.name])  # initialisation sees them, too
            if (c.rate, c.every) != (1, 1):
                slaves[c.name] = MultiRate(slaves[c.name], c.rate, c.every)
        ports = {name: _started(s.ports, starts.get(name, {})) for name, s in slaves.items()}
        wiring = wire(system, ports, convert)
        return Assembly(system, slaves, replace(wiring, warnings=(*warnings, *wiring.warnings)), parameters, starts)
    except BaseException:
        _close(slaves.values())
        raise


def run(
    system: System,
    folder: str | Path | None = None,
    *,
    stop: float | None = None,
    start: float = 0.0,
    resolver: Resolver | None = None,
    convert: Convert = same_unit_only,
    progress: Progress | None = None,
    labels: Mapping[str, Any] | None = None,
    overwrite: bool = False,
    observers: Sequence[Observer] = (),
    manipulators: Sequence[Manipulator] = (),
    resume: bool = False,
    loop: str | None = None,
) -> Run:
    """Run `system` from `start` to `stop` [s] (default: the system's own) and return what was recorded.

    With a `folder` the results stream to disk (refused if it holds a run, unless `overwrite`), without one they stay in memory.
    With `resume` the run in the folder goes on from its checkpoint: a finished one is returned as it is, one without a checkpoint
    begins anew, one of a system that has changed since is refused; observers see only what comes after the checkpoint. `loop`
    replaces that of the system (auto, compiled, python). `labels` are added to those of the system. Raises what `assemble` raises,
    and RunError or Interrupted from the run itself; the folder is complete and readable by then.
    """
    return computed(
        system, folder, stop=stop, start=start, resolver=resolver, convert=convert, progress=progress, labels=labels,
        overwrite=overwrite, observers=observers, manipulators=manipulators, resume=resume, loop=loop,
    )()  # fmt: skip


def computed(
    system: System,
    folder: str | Path | None = None,
    *,
    stop: float | None = None,
    start: float = 0.0,
    resolver: Resolver | None = None,
    convert: Convert = same_unit_only,
    progress: Progress | None = None,
    labels: Mapping[str, Any] | None = None,
    overwrite: bool = False,
    observers: Sequence[Observer] = (),
    manipulators: Sequence[Manipulator] = (),
    resume: bool = False,
    loop: str | None = None,
) -> Callable[[], Run]:
    """Run `system` as `run` does, and return what completes its folder and loads the run: to be called once, in any thread (`Behind`).

    Until then the folder is locked, and what a killed process leaves of it is completed as that of a run. A run that fails, or has
    foreign code in this process, is complete when this returns or raises.
    """
    if loop is not None:
        system = replace(system, loop=loop)
    end = system.stop if stop is None else stop
    if end is None:
        if system.stop_when is None:
            raise OrchestrationError(f"system {system.name!r} has no end: give stop, or set stop or stop_when in the system file")
        end = math.inf
    if math.isnan(end):
        raise OrchestrationError("stop is not a number (NaN); give a time in s")
    if folder is None:
        if resume:
            raise OrchestrationError("resume needs the folder of the run; pass folder")
        with assemble(system, resolver, convert) as assembly:
            memory = Memory(assembly.about())
            master_of(assembly, (memory, *observers), manipulators).run(end, start, progress, system.stop_when)
        return memory.run
    r, place = system.recording, Path(folder)
    with ExitStack() as held:
        lock = held.enter_context(_claimed(place))
        if not (overwrite or resume):
            check_vacant([place])
        with assemble(system, resolver, convert) as assembly:
            about = {**assembly.about(), **checkpoint.identity(system, assembly.parameters)}
            names = {**system.labels, **(labels or {})}
            later = not _has_foreign_code(system)
            recorder = Recorder(place, r.columns, r.every, r.chunk, r.csv, about, names, overwrite or resume, lock=lock, later=later)
            saved = checkpoint.continuation(place, recorder.info(assembly.wiring, system.step), end, system.stop_when) if resume else None
            if isinstance(saved, Run):
                finished = saved
                return lambda: finished
            recorder.resume_after = saved.done if saved is not None else None
            save = (r.checkpoint_every, _saver(assembly, recorder)) if r.checkpoint_every else None
            master = master_of(assembly, (recorder, *observers), manipulators, place)
            with _watched(system, place):
                master.run(end, start, progress, system.stop_when, saved, save)
        claim = held.pop_all()

    def complete() -> Run:
        with claim:
            recorder.complete()
        return Run.load(place)

    return complete


@contextmanager
def _claimed(folder: Path) -> Iterator[FolderLock]:
    """The lock of a folder, which is made if it is not there; one that was made and holds nothing in the end goes again."""
    made = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with FolderLock(folder) as lock:
            yield lock
    finally:
        if made and not any(folder.iterdir()):
            folder.rmdir()


def _has_foreign_code(system: System) -> bool:
    """Whether code runs in this process that may end it."""
    return any(c.source.endswith(".fmu") and not c.isolate for c in system.components)


@contextmanager
def _watched(system: System, folder: Path) -> Iterator[None]:
    """With another process that completes the run if this one ends: where foreign code runs in it."""
    if not _has_foreign_code(system):
        yield
        return
    watch = Watch(folder)
    try:
        yield
    finally:
        watch.done()


def master_of(
    assembly: Assembly, observers: Sequence[Observer], manipulators: Sequence[Manipulator] = (), folder: Path | None = None
) -> Master:
    """The master that runs the assembled system as the system says; `folder` is only named in messages."""
    s = assembly.system
    return Master(
        assembly.slaves, assembly.wiring, s.step, s.algorithm, observers, manipulators, s.check_ranges, folder, s.iteration, s.loop
    )


def _saver(assembly: Assembly, recorder: Recorder) -> Saver:
    """Writes checkpoints. At the start it only finds out whether that will be possible."""

    def save(master: Master) -> None:
        if master.time == master.start:
            checkpoint.check_savable(assembly.slaves)
            return
        recorder.flush()  # the checkpoint must not be ahead of the signals on disk
        checkpoint.write(recorder.folder, master.snapshot())

    return save


def _open(system: System, c: Component, resolver: Resolver | None) -> Slave:
    if c.isolate and not c.source.endswith(".fmu"):
        raise SlaveError(f"isolate = true is for FMUs; source {c.source!r} runs in this process; leave isolate out, or give an FMU")
    if c.source.startswith(REPLAY):
        folder, _, component = c.source[len(REPLAY) :].partition("#")
        return Playback.of_run(c.name, Run.load(system.folder / folder), component or None)
    if c.source == MEASURED:
        raise SlaveError(
            f"source {MEASURED!r} stands for what was measured in a run, which only a diagnosis knows; give {REPLAY}FOLDER to run it"
        )
    if c.source.startswith(f"{MEASURED}:"):
        return Playback.of_run(c.name, Run.load(c.source.partition(":")[2]), clamps=True)
    if c.source.endswith(".fmu"):
        # iterated coupling goes back to the beginning of a step of the system, at most
        goes_back = system.algorithm == "iterated" and c.rate > 1
        if c.isolate:
            from robomill.orchestration.slaves.isolation import IsolatedSlave

            return IsolatedSlave(system.folder / c.source, c.name, c.time_limit, goes_back)
        from robomill.orchestration.slaves.fmu import FmuSlave  # only systems with FMUs need FMPy

        return FmuSlave(system.folder / c.source, c.name, goes_back)
    if resolver is None:
        raise SlaveError(
            f"source {c.source!r} is neither an .fmu file nor {REPLAY}FOLDER, and no in-process components were given; correct the source"
        )
    try:
        return resolver(c.source, c.name)
    except LookupError as error:
        raise SlaveError(f"source {c.source!r}: {error.args[0] if error.args else error}") from None


def _started(ports: Sequence[Port], starts: Mapping[str, Scalar]) -> Sequence[Port]:
    """The ports, inputs with the start values that were set for them."""
    return [replace(plain(p), start=starts[p.name]) if p.causality == "input" and p.name in starts else p for p in ports]


def _configure(system: System, c: Component, slave: Slave, convert: Convert) -> dict[str, Scalar]:
    if isinstance(slave, Playback):
        return {}
    values = prepare(c.name, slave.ports, c.parameters, convert, system.folder)
    slave.configure(values)
    return values


@contextmanager
def attributed(system: System, c: Component) -> Iterator[None]:
    """What is raised inside gets the file, the line and the component's name."""
    try:
        yield
    except Exception as error:
        text = describe(error)
        named = text if f"component {c.name!r}" in text else f"component {c.name!r}: {text}"
        where = f"{error.place}: " if isinstance(error, PlacedError) and error.place else system.where(c.line)
        raise SystemFileError(where + named) from error


def _connected_inputs(system: System, name: str, ports: Mapping[str, Sequence[Port]]) -> list[Port]:
    """Inputs for a replayed component: as many elements as what is connected to them has."""
    found: dict[str, Port] = {}
    for c in system.connections:
        target, _, port = c.target.partition(".")
        source, _, output = c.source.partition(".")
        if target == name:
            members = arrays(outputs(ports.get(source, ()))).get(output, ())
            suffixes = [p.name[len(output) :] for p in members] or [""]
            kind = members[0].type if members else "real"
            for suffix in suffixes:
                found.setdefault(port + suffix, PortData(port + suffix, "input", kind, start=0.0))
    return list(found.values())


def _close(slaves: Iterable[Slave]) -> None:
    for slave in slaves:
        try:
            slave.close()
        except Exception:  # the others must be closed too, and what matters has been said by then
            traceback.print_exc()
