"""A model as LLVM code that is the same on every machine, made in a process of its own.

Numba lowers `init` and `step`. Of its two modules only the two functions and what they call stay,
under names that hold no counters; what would need Python or Numba at run time is refused. The
process compiles for a generic processor, so the code says nothing about the machine that made it.
It also tries the model (`fmus.probe`), as it has it compiled anyway.
"""

from __future__ import annotations

import gc
import hashlib
import json
import os
import re
import subprocess
import sys
import tempfile
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from robomill.fmus.components import home
from robomill.machine_code import linked, missing, without_target
from robomill.models.components.recording import ReplayModel, from_specification
from robomill.models.model.cache import PACKAGE, source_files
from robomill.models.model.calls import check_kernels
from robomill.models.model.declaration import Model
from robomill.models.model.kernels import COMPILER_OPTIONS, tell_numba
from robomill.user_cache import prune, user_folder

INEXACT = re.compile(r"\b(?:fast|contract|reassoc|arcp|afn|nnan|ninf|nsz) |llvm\.fmuladd|llvm\.fma\.")
"""Marks of arithmetic that may come out differently on another processor."""
_STATUS_BITS = 64
"""Bits of the integer that `init` and `step` return: the shim takes it for an int64_t."""
_GARBAGE = 200_000
"""Objects made between two collections: Numba makes millions that live, and looking at them again and again takes a tenth of the time."""


class NativeBuildError(RuntimeError):
    """A model that cannot become a native FMU, or a tool that failed; the text says which and why.

    Remedy: write the model as docs/how_to/native.md says, or build it with `--backend python`.
    """


@dataclass(frozen=True)
class Lowered:
    """What the process found out about a model."""

    code: str
    """LLVM assembly with the functions `model_init` and `model_step` in Numba's calling convention:
    ``i32 f(i64 *status, i8 **exception, record *s[, double t, double h])``, zero unless an exception was raised."""
    variable_step: bool
    initial_dependencies: dict[str, tuple[str, ...]]


class Lowering:
    """Processes that lower models, as many as ask at a time, in a `with` block.

    Each lowers one model after the other: what models have in common is imported and compiled once. The code of a model does
    not depend on those before it, as names that count are replaced.
    """

    def __init__(self) -> None:
        self._idle: list[_Process] = []

    def __enter__(self) -> Lowering:
        return self

    def __exit__(self, *_: object) -> None:
        while self._idle:
            self._idle.pop().end()

    def lower(self, model: Model) -> Lowered:
        """Lower a model, or take what was kept of an earlier time with the same sources. NativeBuildError says what is in the way."""
        with tempfile.TemporaryDirectory(prefix="robomill_lower_") as temporary:
            folder = Path(temporary)
            arguments = _reference(model, folder)
            kept = _cache_file(model, folder)
            if kept is not None and kept.is_file():
                with suppress(OSError, ValueError, KeyError):
                    os.utime(kept.parent)
                    return _read(kept)
            result = folder / "lowered.json"
            try:
                process = self._idle.pop()
            except IndexError:
                process = _Process()
            if not process.ask([str(result), *arguments]):
                lines = [line for line in process.end().splitlines() if line.strip()]
                refusal = [line.partition("NativeBuildError: ")[2] for line in lines if "NativeBuildError: " in line]
                raise NativeBuildError(f"model {model.name!r}: cannot be lowered: " + (refusal[-1] if refusal else "\n".join(lines[-15:])))
            self._idle.append(process)
            lowered = _read(result)
            if kept is not None:
                _keep(result, kept)
            return lowered


class _Process:
    """One of the other processes: a line of JSON is a model to lower, a line comes back when it is done."""

    def __init__(self) -> None:
        environment = {
            **os.environ,
            "NUMBA_CPU_NAME": "generic",
            "NUMBA_CPU_FEATURES": "",
            "NUMBA_OPT": "3",
            "NUMBA_LOOP_VECTORIZE": "1",
            "NUMBA_SLP_VECTORIZE": "0",
            "NUMBA_DEBUGINFO": "0",
            "NUMBA_FULL_TRACEBACKS": "0",
            "NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING": "1",  # colours that nobody sees, of errors that Numba itself catches
            "PYTHONHASHSEED": "0",
            "PYTHONPATH": os.pathsep.join(p for p in sys.path if p),
        }
        for name in ("NUMBA_ENABLE_AVX", "NUMBA_BOUNDSCHECK", "NUMBA_DISABLE_JIT", "NUMBA_DEVELOPER_MODE", "NUMBA_COVERAGE"):
            environment.pop(name, None)
        # a file, as a pipe that nobody reads would fill up; `end` closes it
        self._errors = tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace")  # noqa: SIM115 (until `end`)
        command = [sys.executable, "-m", "robomill.fmus.native.lower"]
        self._process = subprocess.Popen(
            command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._errors, encoding="utf-8"
        )

    def ask(self, arguments: list[str]) -> bool:
        """Whether the process did it; if not, it has ended and `end` says why."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with suppress(OSError):  # ended before it was asked
            self._process.stdin.write(json.dumps(arguments) + "\n")
            self._process.stdin.flush()
        return bool(self._process.stdout.readline())

    def end(self) -> str:
        """What the process wrote as errors, when it has ended."""
        with suppress(OSError):
            self._process.communicate()
        self._errors.seek(0)
        with self._errors:
            return self._errors.read()


def _reference(model: Model, folder: Path) -> list[str]:
    """How the other process finds the model: its module, or the files of a recording put into `folder`."""
    if isinstance(model, ReplayModel):
        (folder / "replay.json").write_text(json.dumps(model.specification, sort_keys=True), encoding="utf-8")
        np.save(folder / "recording.npy", model.default_tables["recording"])
        return ["replay", str(folder)]
    try:
        check_kernels(model.init, model.step)
        return ["module", *home(model)]
    except ValueError as error:
        raise NativeBuildError(f"model {model.name!r}: {error}") from None


def _cache_file(model: Model, folder: Path) -> Path | None:
    """Where the result of these sources is kept, None if its sources cannot be told."""
    import llvmlite
    import numba

    digest = hashlib.sha256(f"{numba.__version__} {llvmlite.__version__} {sys.version_info[:3]} {np.__version__}".encode())
    try:
        module = "robomill.models.components.recording" if isinstance(model, ReplayModel) else home(model)[0]
        files = {*source_files(module).values(), *source_files(__name__).values(), *PACKAGE.rglob("*.toml")}
        for name, content in sorted((f.name, hashlib.sha256(f.read_bytes()).digest()) for f in (*files, *folder.iterdir())):
            digest.update(name.encode() + content)
    except (OSError, ModuleNotFoundError):
        return None
    return user_folder() / "native" / digest.hexdigest()[:20] / f"{model.name}.json"


def _keep(result: Path, kept: Path) -> None:
    """Copy to the cache; a folder that cannot be written to only costs the next build its time."""
    with suppress(OSError):
        kept.parent.mkdir(parents=True, exist_ok=True)
        partial = kept.with_name(f".{kept.name}.{os.getpid()}")
        partial.write_bytes(result.read_bytes())
        partial.replace(kept)
        prune(kept.parent.parent, kept.parent.name)


def _read(file: Path) -> Lowered:
    found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return Lowered(found["code"], found["variable_step"], {k: tuple(v) for k, v in found["initial_dependencies"].items()})


# In the other process


def main() -> None:
    """Lower the models named on standard input, a line each.

    A line is ``["RESULT", "module", NAME, ATTRIBUTE]`` or ``["RESULT", "replay", FOLDER]``.
    """
    gc.set_threshold(_GARBAGE)
    replies, sys.stdout = sys.stdout, sys.stderr
    for line in sys.stdin:
        result, kind, where, *attribute = json.loads(line)
        if kind == "replay":
            model: Model = from_specification(json.loads(Path(where, "replay.json").read_text()), np.load(Path(where, "recording.npy")))
        else:
            model = getattr(import_module(where), attribute[0])
        code, functions = _lower(model)
        variable_step, dependencies = _probe(model, functions)
        content = {"code": code, "variable_step": variable_step, "initial_dependencies": dependencies}
        Path(result).write_text(json.dumps(content, sort_keys=True), encoding="utf-8")
        print("done", file=replies, flush=True)
    os._exit(0)  # nothing is open, and to take Numba's objects apart takes 0.6 s


def _lower(model: Model) -> tuple[str, tuple[Any, Any]]:
    """The module as text, and the two functions compiled here."""
    import numba

    tell_numba()
    record = numba.from_dtype(model.dtype)
    texts, functions = [], []
    for name, function, signature in (
        ("model_init", model.init, (record,)),
        ("model_step", model.step, (record, numba.float64, numba.float64)),
    ):
        dispatcher: Any = numba.njit(**COMPILER_OPTIONS)(function)
        dispatcher.compile(signature)
        compiled = dispatcher.overloads[dispatcher.signatures[0]]
        returned: Any = compiled.signature.return_type
        if getattr(returned, "bitwidth", 0) != _STATUS_BITS or not isinstance(returned, numba.types.Integer):
            raise NativeBuildError(f"{function.__name__} returns {returned}; expected a status, an integer")
        texts.append((name, compiled.fndesc.llvm_func_name, dispatcher.inspect_llvm(dispatcher.signatures[0])))
        functions.append(dispatcher)
    return portable(texts), (functions[0], functions[1])


def portable(modules: list[tuple[str, str, str]]) -> str:
    """One module out of several given as (new name, name, LLVM assembly of the module that defines it).

    Everything but these functions becomes private or goes. NativeBuildError names a function that would
    be missing at run time, or arithmetic that is not exact.
    """
    whole = linked(modules)
    unavailable = missing(whole)
    if unavailable:
        raise NativeBuildError(
            f"the code calls {', '.join(unavailable)}, which only exist inside Python; write it in terms of models/maths/elementary.py"
        )
    public = [new for new, _, _ in modules]
    for name in public:  # seen by the C sources beside it, not by other FMUs in the same process
        whole.get_function(name).visibility = "hidden"
    counts = {"function": 0, "global": 0}
    for value in (*whole.functions, *whole.global_variables):
        if not value.is_declaration and value.name not in public:
            kind = "function" if value.is_function else "global"
            value.name = f"{kind}_{counts[kind]}"
            counts[kind] += 1
    whole.verify()
    text = _square_roots(without_target(str(whole)))
    inexact = INEXACT.search(text)
    if inexact:
        raise NativeBuildError(
            f"the code holds arithmetic marked {inexact.group().strip()!r}, which processors round differently"
            "; write it as plain sums and products"
        )
    return text


def _square_roots(text: str) -> str:
    """With the square root as an instruction. LLVM has made some into calls of the C library for its errno, which nobody reads."""
    if "@sqrt(" not in text:
        return text
    text = re.sub(r"(?m)^declare double @sqrt\(.*\n", "", text)
    text = text.replace("@sqrt(", "@llvm.sqrt.f64(")
    return text if "declare double @llvm.sqrt.f64(" in text else text + "\ndeclare double @llvm.sqrt.f64(double)\n"


def _probe(model: Model, functions: tuple[Any, Any]) -> tuple[bool, dict[str, list[str]]]:
    """Whether the model takes other steps, and what its initial outputs depend on."""
    from dataclasses import replace

    from robomill.fmus import probe
    from robomill.fmus.interface import Interface

    interface = Interface(replace(model, init=functions[0], step=functions[1]))
    dependencies = probe.initial_dependencies(interface, plain=True)
    return probe.accepts_other_steps(interface, plain=True), {name: list(found) for name, found in dependencies.items()}


if __name__ == "__main__":
    main()
