"""`robomill example`: lists the examples that come with robomill, and copies one out with every file it refers to."""

from __future__ import annotations

import json
import shutil
import sys
import tomllib
from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from robomill.files import FILES
from robomill.orchestration.errors import unknown

SCENARIOS = Path("scenarios")
CATALOGUE = "catalogue.toml"
"""What `robomill diagnose` looks for beside a system file."""
LONGEST_NAME = 200
"""Characters from which a text in a file is prose, and not the name of another file."""
FOLDERS = {
    "heated_rod": (
        Path("examples") / "heated_rod",
        "A heated rod with its controller: minutes to hours, for docs/tutorials/bring_your_own_system.md",
    ),
    "kalman_sensor": (
        Path("examples") / "kalman_sensor",
        "A component of your own: package, model, effect, tests, for docs/tutorials/write_a_component.md",
    ),
    "recordings": (Path("data") / "kuka_kr300_recordings", "Two recordings of a KUKA KR 300 with their mapping: robomill import"),
    "servo_axis": (
        Path("examples") / "servo_axis",
        "A servo axis: model, mapping, catalogue, answer, for docs/tutorials/bring_your_own_system.md",
    ),
    "tutorial": (
        SCENARIOS / "tutorial",
        "A raw log with its mapping, for docs/tutorials/diagnose_a_log.md: from the log to an adopted effect",
    ),
}
"""Examples that are a whole folder, with the folders in it; one of the scenarios comes with the files that it refers to."""


def examples() -> dict[str, str]:
    """Name -> title of everything that can be copied."""
    found = {name: title for name, (_, title) in FOLDERS.items()}
    whole = [FILES / home for home, _ in FOLDERS.values()]
    for file in sorted(f for f in (FILES / SCENARIOS).rglob("*.toml") if not set(whole) & set(f.parents)):
        head = tomllib.loads(file.read_text(encoding="utf-8")).get("scenario")
        if isinstance(head, dict):
            name = file.relative_to(FILES / SCENARIOS).with_suffix("").as_posix()
            found[name] = str(head.get("title", head.get("name", name)))
    return dict(sorted(found.items(), key=lambda item: (item[0].count("/"), item[0])))


def run(options: Namespace) -> int:
    """Print the examples, or copy the one that is named into a folder."""
    if options.name is None:
        known = examples()
        if options.json:
            print(json.dumps({"examples": known}))
            return 0
        width = max(map(len, known))
        for name, title in known.items():
            print(f"{name:{width}}  {title}")
        return 0
    written = copy(options.name, options.folder)
    if options.json:
        print(json.dumps({"files": [f.as_posix() for f in written]}))
        return 0
    for file in written:
        print(file)
    if options.name not in FOLDERS:
        print(f"Run it: robomill run {written[0]}", file=sys.stderr)
    return 0


def copy(name: str, folder: Path | None = None) -> list[Path]:
    """Copy an example and all files that it refers to; returns them, the named one first.

    They stand to each other as in robomill: below `folder`, or `scenarios` (its own folder for an example elsewhere).
    ValueError lists the examples. FileExistsError names what is there with another content, before anything is written; equal files stay.
    """
    known = examples()
    if name not in known:
        raise ValueError(f"{unknown('example', name, known)}; `robomill example` says what they are")
    if name in FOLDERS:
        home = FOLDERS[name][0]
        sources = [f for f in sorted((FILES / home).rglob("*")) if f.is_file() and "__pycache__" not in f.parts]
    else:
        home = SCENARIOS
        sources = [FILES / SCENARIOS / f"{name}.toml"]
    if SCENARIOS in (home, *home.parents):
        home = SCENARIOS
        sources = list(dict.fromkeys(f for source in sources for f in _with_references(source)))
    target = home if folder is None else folder
    pairs = [(source, target / source.relative_to(FILES / home)) for source in sources]
    taken = [t for s, t in pairs if t.exists() and (not t.is_file() or t.read_bytes() != s.read_bytes())]
    if taken:
        raise FileExistsError(
            f"{', '.join(map(str, taken))}: there already, with another content; name another folder: robomill example {name} DIR"
        )
    for source, file in pairs:
        file.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, file)
    return [file for _, file in pairs]


def _with_references(file: Path) -> Iterator[Path]:
    """A TOML file, the files that its texts name, and theirs; the catalogue beside a system comes with it."""
    yield file
    if file.suffix != ".toml":
        return
    content = tomllib.loads(file.read_text(encoding="utf-8"))
    if "components" in content and (file.parent / CATALOGUE).is_file():
        yield file.parent / CATALOGUE
    for text in _texts(content):
        named = (file.parent / text).resolve()
        if named.is_file() and FILES in named.parents:
            yield from _with_references(named)


def _texts(value: Any) -> Iterator[str]:
    """All texts in a TOML value that can be the name of a file."""
    if isinstance(value, dict):
        for inner in value.values():
            yield from _texts(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from _texts(inner)
    elif isinstance(value, str) and "." in value and "\n" not in value and len(value) < LONGEST_NAME:
        yield value
