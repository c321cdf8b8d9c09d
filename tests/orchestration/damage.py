"""Seeded damage of FMUs, SSP packages and system files; and what a session with a damaged one ends with.

Case `number` of a kind is the same on every machine. `session` is run in a process of its own by `test_fuzz`.
"""

from __future__ import annotations

import os
import random
import re
import stat
import tempfile
import traceback
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path

import fmpy

KINDS = {"fmu": "euler.fmu", "fmu3": "types.fmu", "ssp": "ring.ssp", "nested": "theirs.ssp", "system": "ring.toml"}
"""Undamaged file by kind: FMI 2.0, FMI 3.0, a package of ours, one with nested systems and a mapping, a system file."""
NASTY = (
    "",
    "0",
    "-1",
    "NaN",
    "inf",
    "-INF",
    "1e999",
    "1e-320",
    "99999999999999999999999",
    "-2147483649",
    "true",
    "2.0",
    "1.0",
    "3.0",
    "x" * 5000,
    "ä€\U0001f600",
    "../../../../etc/passwd",
    "/etc/passwd",
    "a b",
    "%s%n%x",
    "${x}",
    "[1]",
    "u",
    "y",
    "gain",
    "input",
    "output",
    "fixed",
    "0x10",
    "1,5",
)
NASTY_TOML = (
    '""',
    "0",
    "-1",
    "nan",
    "inf",
    "-inf",
    "1e999",
    "1e-320",
    "99999999999999999999999",
    "true",
    "[]",
    "{}",
    "[[]]",
    "{x = 1}",
    '"1 parsec"',
    '"NaN m"',
    "1979-05-27",
    '"../x"',
    '"a.b.c"',
    '"."',
    '"*"',
    '"\\u0000"',
    '"x"',
    "[1, 2]",
    '["a"]',
    '{file = "../x"}',
    '{value = "x", unit = 3}',
    "07",
    "'''",
    '"replay:."',
    '"replay:nothing#x"',
    '"none.fmu"',
    '"gauss-seidel"',
)
HEAD = '<?xml version="1.0" encoding="UTF-8"?>'
ENTITIES = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]>'


def of_bytes(data: bytes, r: random.Random) -> bytes:
    """Damage that knows no format: bytes changed, cut off, cut out, put in, repeated."""
    a = r.randrange(len(data))
    b = min(len(data), a + r.choice((1, 4, 30, 400)))
    how = r.randrange(5)
    if how == 0:
        changed = bytearray(data)
        for _ in range(r.choice((1, 3, 30))):
            changed[r.randrange(len(data))] ^= 1 << r.randrange(8)
        return bytes(changed)
    return (data[:a], data[:a] + data[b:], data[:a] + r.randbytes(b - a) + data[a:], data[:b] + data[a:b] * 3 + data[b:])[how - 1]


def of_xml(text: str, r: random.Random) -> str:
    """Damage that keeps XML mostly well formed: attributes, elements, document type, encoding, depth."""
    how = r.randrange(9)
    attributes = list(re.finditer(r' ([\w:]+)="([^"]*)"', text))
    chosen = r.choice(attributes)
    if how in (0, 1, 2):
        return text[: chosen.start(2)] + r.choice(NASTY) + text[chosen.end(2) :]
    if how == 3:
        return text[: chosen.start()] + text[chosen.end() :]
    if how == 4:
        other = r.choice(attributes)
        return text[: chosen.start(2)] + other[2] + text[chosen.end(2) :]
    elements = list(re.finditer(r"<[\w:]+[^<>]*/>|<([\w:]+)[^<>]*>[^<]*</\1>", text))
    e = r.choice(elements)
    if how == 5:
        return text[: e.start()] + text[e.end() :]
    if how == 6:
        return text[: e.end()] + e[0] * r.choice((1, 3)) + text[e.end() :]
    if how == 7:
        return r.choice(
            (text.replace(HEAD, HEAD + ENTITIES, 1), text.replace("UTF-8", r.choice(("UTF-16", "none", "ascii")), 1), text + "<x/>")
        )
    return text[: e.start()] + "<a>" * r.choice((3, 300, 30_000)) + text[e.end() :]


def of_toml(text: str, r: random.Random) -> str:
    """Damage of values, keys, lines."""
    how = r.randrange(7)
    lines = text.splitlines()
    i = r.randrange(len(lines))
    key, equals, value = lines[i].partition(" = ")
    if how in (0, 1, 2) and equals:
        lines[i] = f"{key} = {r.choice(NASTY_TOML)}"
    elif how == 3 and equals:
        lines[i] = f"{key}x = {value}"
    elif how == 4:
        del lines[i]
    elif how == 5:
        lines.insert(r.randrange(len(lines)), lines[i])
    else:
        j = r.randrange(len(lines))
        lines[i], lines[j] = lines[j], lines[i]
    return "\n".join(lines) + "\n"


def repacked(source: Path, target: Path, r: random.Random) -> bool:
    """The archive with one damaged, missing or added entry, its checksums all right; whether only a process of its own may open it."""
    with zipfile.ZipFile(source) as z:
        files: dict[str, bytes] = {n: z.read(n) for n in z.namelist()}
    texts = [n for n in files if n.endswith((".xml", ".ssd", ".ssv", ".ssm"))]
    binaries = [n for n in files if n.startswith("binaries/")]
    how = r.randrange(12)
    extra: list[tuple[zipfile.ZipInfo | str, bytes]] = []
    isolated = False
    if how < 6:
        name = r.choice(texts)
        files[name] = of_xml(files[name].decode(), r).encode()
    elif how == 6:
        name = r.choice(texts)
        files[name] = of_bytes(files[name], r)
    elif how == 7:
        del files[r.choice(list(files))]
    elif how == 8:
        place = r.choice(("../evil", "/tmp/evil", "a/../../evil", "C:\\evil", "..\\evil", "resources/../../../evil"))
        extra.append((place, b"evil"))
    elif how == 9:
        link = zipfile.ZipInfo(r.choice(("resources/link", "binaries/linux64", "modelDescription.xml")))
        link.external_attr = (r.choice((stat.S_IFLNK, stat.S_IFIFO, stat.S_IFCHR)) | 0o777) << 16
        extra.append((link, b"/etc"))
    elif how == 10:
        extra.append((r.choice((*files, "x/" * 2000, "n" * 300)), b"again"))
    elif binaries:
        name = r.choice(binaries)
        data = files.pop(name)
        other = {"cut": data[: r.randrange(len(data))], "text": b"not a library", "empty": b""}
        wanted = r.choice((*other, "moved", "flipped"))
        isolated = wanted == "flipped"
        if wanted in other:
            files[name] = other[wanted]
        elif wanted == "moved":
            place = r.choice(("win64", "darwin64", "linux32"))
            files[re.sub(f"{fmpy.platform}|{fmpy.platform_tuple}", place, name)] = data
        else:
            changed = bytearray(data)
            for _ in range(r.choice((10, 1000))):
                changed[r.randrange(len(data))] = r.randrange(256)
            files[name] = bytes(changed)
    with zipfile.ZipFile(target, "w") as z, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # names that are there twice are wanted
        for name, data in (*files.items(), *extra):
            z.writestr(name, data)
    return isolated


def damaged(kind: str, number: int, originals: Path, folder: Path) -> tuple[Path, bool]:
    """Damage number `number` of a kind: the file, and whether it may only be opened in a process of its own."""
    r = random.Random(f"{kind} {number}")
    source = originals / KINDS[kind]
    target = folder / source.name
    if kind == "system":
        text = source.read_text()
        if r.random() < 0.15:
            target.write_bytes(of_bytes(text.encode(), r))
        else:
            for _ in range(r.choice((1, 1, 2))):
                text = of_toml(text, r)
            target.write_text(text)
        (folder / "euler.fmu").write_bytes((originals / "euler.fmu").read_bytes())
        return target, False
    if r.random() < 0.25:
        target.write_bytes(of_bytes(source.read_bytes(), r))
        return target, False
    return target, repacked(source, target, r)


def attempt(kind: str, number: int, originals: Path, folder: Path) -> None:
    """Use a damaged file as a user would."""
    from robomill.orchestration.assembly import run
    from robomill.orchestration.ssp.importing import open_ssp
    from robomill.orchestration.system.definition import Component, System

    file, isolated = damaged(kind, number, originals, folder)
    if kind in ("fmu", "fmu3"):
        parameters = {"gain": 2.0} if kind == "fmu" else {"gain[1,2]": 2.0, "label": "x"}
        run(System("s", 0.1, (Component("x", str(file), parameters, isolate=isolated, time_limit=5.0),)), folder / "run", stop=1.0)
    elif kind in ("ssp", "nested"):
        with open_ssp(file) as package:
            run(package.system, folder / "run", start=package.start, stop=package.start + 1.0)
    else:
        system = System.load(file)
        run(system, folder / "run", stop=min(system.stop or 1.0, 1.0) if (system.stop or 1.0) > 0 else system.stop)


def session(kind: str, number: int, originals: str, place: str) -> tuple[str, str]:
    """(class of the error, its text) that the attempt ends with; "" if it ran. Everything in a folder `place` of its own."""
    from robomill.orchestration.errors import OrchestrationError

    folder = Path(place) / "work"
    (Path(place) / "temporary").mkdir(parents=True)
    folder.mkdir()
    tempfile.tempdir = str(Path(place) / "temporary")
    os.chdir(place)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            attempt(kind, number, Path(originals), folder)
    except OrchestrationError as error:
        return type(error).__name__, str(error)
    except BaseException:
        return "", traceback.format_exc()
    return "ran", ""


Session = Callable[[str, int, str, str], tuple[str, str]]
