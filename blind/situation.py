"""How a case was measured, as its folder says: the nominal system and what the experimenter set, whoever made the case."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

from robomill.blind.world import nominal_system, run_nominal
from robomill.orchestration.runs.run import Run, read_info


@dataclass(frozen=True)
class Situation:
    """A condition of a case. Equal to another one that was measured in the same way, whatever it is called."""

    key: str
    """Hash of the system and of what was set."""
    name: str = field(compare=False)
    system: Path = field(compare=False)
    parameters: Mapping[str, Mapping[str, Any]] = field(compare=False)
    """What the experimenter set, files by absolute paths."""
    held_out: bool = field(compare=False)

    def simulate(self, adopted: Mapping[str, Mapping[str, Any]], form: tuple[str, str] | None = None) -> Run:
        """The nominal system with parameters adopted: component -> element -> value; no noise.

        `form`: a component and the file of a form that corrects it.
        """
        system = nominal_system(self.system)
        if form is not None and any(c.name == form[0] for c in system.components):
            system = system.with_correction(*form)
        return run_nominal(system, self.parameters, adopted)


@lru_cache(maxsize=64)
def nominal_run(s: Situation) -> Run:
    """The nominal simulation of a situation."""
    return s.simulate({})


def situations(case: Path) -> list[Situation]:
    """All conditions of a case, those to be diagnosed first; held-out repeats of a condition belong to it."""
    found: dict[str, Situation] = {}
    for folder in sorted(f for f in (case / "runs").iterdir() if f.is_dir()):
        info = read_info(folder)
        name, held = str(info["labels"]["condition"]), bool(info["labels"]["held_out"])
        if name not in found or (found[name].held_out and not held):
            found[name] = _situation(case, folder, info, name, held)
    return sorted(found.values(), key=lambda s: s.held_out)


def _situation(case: Path, folder: Path, info: Mapping[str, Any], name: str, held_out: bool) -> Situation:
    own = case / f"{info['system']}.toml"
    system = own if own.is_file() else case / "system.toml"
    parameters = {c: {k: _absolute(v, folder) for k, v in values.items()} for c, values in info["parameters"].items()}
    content = {c: {k: _content(v) for k, v in values.items()} for c, values in parameters.items()}
    text = hashlib.sha256(system.read_bytes()).hexdigest() + json.dumps(content, sort_keys=True)
    return Situation(hashlib.sha256(text.encode()).hexdigest()[:16], name, system, parameters, held_out)


def _absolute(value: Any, folder: Path) -> Any:
    return str(folder / value) if isinstance(value, str) and (folder / value).is_file() else value


def _content(value: Any) -> Any:
    """A file by its bytes: each run brings its own copy of a table."""
    return hashlib.sha256(Path(value).read_bytes()).hexdigest() if isinstance(value, str) and Path(value).is_file() else value
