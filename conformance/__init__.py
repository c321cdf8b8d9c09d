"""Does an FMU do what FMI 2.0 or 3.0 and its own model description promise? For the FMUs of this project and for those of others.

    for result in check_fmu("component.fmu"):
        print(result.outcome, result.check, result.detail)

It is opened as for a run, so what cannot be run is refused with the same text. Everything that runs the FMU does so
in a new process, outside of this repository, which may crash or hang without harm. This package runs on its own there
(see `__main__`): standard library and FMPy only, imports of its own files relative, nothing else of the project.

The checks (`battery`) are the same for both versions of FMI; `fmi2` and `fmi3` know how the calls look.

Inputs are the start values, moved a little; or those of the FMU's reference results, if it carries
documentation/reference/in.csv and out.csv (first column the time, then one per variable or element of an array, or an array in one;
row k of in.csv holds from t_k on, row k of out.csv are the outputs at t_k) and parameters.json (texts in it
are names of files beside it).
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from .battery import CHECKS, Result
from .calls import CallFailed
from .instance import Fmu, Instance, some

__all__ = ["CHECKS", "CallFailed", "Fmu", "Instance", "Result", "check_fmu"]

TIMEOUT = 300.0
"""Time for one FMU, all checks together [s]."""
_RUNNABLE = "units and descriptions"
"""The first check of an FMU that can be run: of the right kind, with a description that can be read."""
_SHOWN_PROBLEMS = 3
_SIGNALS = ("input", "output")
_REALS = ("Real", "Float64", "Float32")


def check_fmu(file: str | Path, timeout: float = TIMEOUT) -> list[Result]:
    """All checks of one FMU, in order. Never raises for anything that is wrong with the FMU.

    `timeout` [s] is for the whole process that runs it. FileNotFoundError if there is no such file.
    """
    path = Path(file).resolve()
    if not path.is_file():
        raise FileNotFoundError(f"{file}: no such file")
    with tempfile.TemporaryDirectory(prefix="robomill_check_", ignore_cleanup_errors=True) as folder:
        results = list(_static_checks(path, Path(folder).resolve() / "opened"))
        if any(r.check == _RUNNABLE for r in results):
            results += _dynamic_checks(path, Path(folder), timeout, _only_once(Path(folder) / "opened"))
    return results


# Checks that only read


def _static_checks(path: Path, folder: Path) -> Iterator[Result]:
    import fmpy
    from fmpy.validation import validate_fmu

    from robomill.orchestration.errors import SlaveError
    from robomill.orchestration.slaves.archive import unpack  # here, as the other process has nothing of the project
    from robomill.orchestration.slaves.description import describe
    from robomill.orchestration.slaves.protocol import CARRIED

    check = "archive"
    try:
        names = unpack(path, folder)
        yield Result(check, "passed", f"{len(names)} files, {path.stat().st_size} bytes")
        check = "model description"
        ports = describe(path, folder, names).ports
    except SlaveError as error:
        yield Result(check, "failed", str(error).removeprefix(f"{path}: "))
        return
    problems = validate_fmu(str(path))
    md = fmpy.read_model_description(str(folder), validate=False)
    if problems:
        # what follows does not need a description without fault, and says more about the FMU
        shown = "; ".join(problems[:_SHOWN_PROBLEMS]) + ("; ..." if len(problems) > _SHOWN_PROBLEMS else "")
        yield Result("model description", "failed", f"{len(problems)} problem{'s' * (len(problems) > 1)}: {shown}")
    else:
        yield Result("model description", "passed", f"FMI {md.fmiVersion}, {len(md.modelVariables)} variables, no problem found by FMPy")
    yield _documented(md, [f"{p.type} {p.causality} {p.name}" for p in ports if p.causality in _SIGNALS and p.type not in CARRIED])
    icon = "model.png" if md.fmiVersion == "2.0" else "terminalsAndIcons/icon.png"
    parts = {"documentation/index.html": "documentation", icon: "icon", "documentation/licenses/": "licence"}
    missing = [what for part, what in parts.items() if not any(n.startswith(part) for n in names)]
    yield Result(
        "contents", "finding" if missing else "passed", f"without {', '.join(missing)}" if missing else "documentation, icon, licence"
    )


def _only_once(folder: Path) -> bool:
    import fmpy

    return bool(fmpy.read_model_description(str(folder), validate=False).coSimulation.canBeInstantiatedOnlyOncePerProcess)


def _documented(md: Any, apart: Sequence[str]) -> Result:
    """`apart`: inputs and outputs that the master cannot connect."""
    shown = [v for v in md.modelVariables if v.causality in ("input", "output", "parameter")]
    bare = [v.name for v in shown if not v.description]
    unitless = [v.name for v in shown if v.type in _REALS and not (v.unit or (v.declaredType and v.declaredType.unit))]
    lacks = [f"no {what} for {some(names)}" for what, names in (("description", bare), ("unit", unitless)) if names]
    if apart:
        lacks.append(f"cannot be connected here: {some(apart)}")
    return Result(
        "units and descriptions", "finding" if lacks else "passed", "; ".join(lacks) or f"all {len(shown)} inputs, outputs, parameters"
    )


# Checks that run it: this side


def _dynamic_checks(path: Path, folder: Path, timeout: float, only_once: bool) -> list[Result]:
    """All checks that run the FMU: in one process, or, if a process can have one instance only, each in one of its own.

    Those behind one that ended the process are made in another.
    """
    deadline = time.monotonic() + timeout
    found: list[Result] = []
    rest = list(CHECKS)
    while rest:
        made = _process(path, folder, max(deadline - time.monotonic(), 0.0), rest[:1] if only_once else rest)
        found += made
        last = max((rest.index(r.check) for r in made if r.check in rest), default=-1)
        if last < 0:  # what keeps it from the first of them keeps it from the others
            break
        rest = rest[last + 1 :]
        if time.monotonic() > deadline:
            return [*found, *(Result(check, "skipped", f"no time left: {timeout:.0f} s are for all checks") for check in rest)]
    return found


def _process(path: Path, folder: Path, timeout: float, checks: Sequence[str]) -> list[Result]:
    """Run `battery.run` in a process of its own and collect what it wrote, also if it did not come to its end."""
    report = folder / "report.jsonl"
    report.write_text("", encoding="utf-8")
    work = Path(tempfile.mkdtemp(prefix="work", dir=folder))
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    output = folder / "output.txt"
    with output.open("wb") as stream:
        command = [sys.executable, "-P", str(Path(__file__).with_name("__main__.py").resolve()), str(path), str(report), *checks]
        process = subprocess.Popen(command, cwd=work, env=environment, stdout=stream, stderr=subprocess.STDOUT)
        try:
            code = process.wait(timeout)
            end = f"the process ended with {code}" if code >= 0 else f"the process was killed by signal {-code}"
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            code, end = 1, f"no answer within {timeout:.0f} s"
    results: list[Result] = []
    begun = "start of the process"
    for line in report.read_text(encoding="utf-8").splitlines():
        entry = json.loads(line)
        if "begun" in entry:
            begun = entry["begun"]
        else:
            results.append(Result(**entry))
    if code != 0:
        last = output.read_text(encoding="utf-8", errors="replace").strip().splitlines()[-3:]
        results.append(Result(begun, "failed", "; ".join([end, *last])))
    return results
