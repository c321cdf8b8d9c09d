"""Opening archives that others made: nothing is written outside the target folder, nothing explodes."""

from __future__ import annotations

import lzma
import stat
import xml.parsers.expat
import zipfile
import zlib
from pathlib import Path, PurePosixPath

from orchestration.errors import SlaveError

MAX_TOTAL = 2 * 1024**3
"""Largest sum of the unpacked sizes of an archive [bytes]."""
MAX_FILES = 20_000
MAX_XML = 256 * 1024**2
MAX_NAME, MAX_DEPTH = 1000, 50
"""Of the path of an entry: characters, levels of folders."""


def unpack(file: Path, target: Path, max_total: int = MAX_TOTAL, max_files: int = MAX_FILES, kind: str = "FMU") -> list[str]:
    """Unpack the zip archive `file` into the folder `target` and return the names of its files. `kind` of archive, for messages.

    SlaveError for: no such file, not a zip archive, damaged or encrypted, an entry that would leave
    the folder (absolute, drive letter, backslash, `..`), a symbolic link or other special file, more
    than `max_files` entries, more than `max_total` bytes unpacked.
    """
    if not file.exists():
        raise SlaveError(f"{file}: no such file{_siblings(file, kind)}")
    if not zipfile.is_zipfile(file):
        raise SlaveError(f"{file}: not a zip archive, so not an {kind} ({_kind(file)})")
    try:
        with zipfile.ZipFile(file) as archive:
            entries = archive.infolist()
            if len(entries) > max_files:
                raise SlaveError(f"{file}: refused: {len(entries)} entries, at most {max_files} are allowed")
            total = sum(e.file_size for e in entries)
            if total > max_total:
                raise SlaveError(f"{file}: refused: unpacks to {total} bytes, at most {max_total} are allowed")
            seen: set[str] = set()
            for entry in entries:
                _check_entry(file, entry)
                if entry.filename in seen:
                    raise SlaveError(f"{file}: refused: entry {_short(entry.filename)} is there twice")
                seen.add(entry.filename)
            archive.extractall(target)
    except (zipfile.BadZipFile, zlib.error, lzma.LZMAError, NotImplementedError, EOFError, OSError, ValueError) as error:
        raise SlaveError(f"{file}: cannot be unpacked: {error}") from None
    return [e.filename for e in entries if not e.is_dir()]


def _check_entry(file: Path, entry: zipfile.ZipInfo) -> None:
    # orig_filename: zipfile itself cuts at a NUL byte and, on Windows, turns separators around
    name = entry.orig_filename
    path = PurePosixPath(name)
    if path.is_absolute() or ".." in path.parts or "\\" in name or ":" in name or "\0" in name:
        raise SlaveError(f"{file}: refused: entry {_short(name)} would be written outside the folder it is unpacked to")
    if len(name) > MAX_NAME or len(path.parts) > MAX_DEPTH:
        raise SlaveError(
            f"{file}: refused: entry {_short(name)} has {len(name)} characters in {len(path.parts)} levels; "
            f"at most {MAX_NAME} in {MAX_DEPTH} are allowed"
        )
    mode = entry.external_attr >> 16
    if stat.S_IFMT(mode) not in (0, stat.S_IFREG, stat.S_IFDIR):
        raise SlaveError(f"{file}: refused: entry {_short(name)} is a symbolic link or a special file")
    if entry.flag_bits & 0x1:
        raise SlaveError(f"{file}: refused: entry {_short(name)} is encrypted")


def check_xml(file: Path, source: Path) -> dict[str, str]:
    """Refuse XML with a document type or entities (they can explode or read other files); return the attributes of its root.

    `source` is the archive that errors name.
    """
    if file.stat().st_size > MAX_XML:
        raise SlaveError(f"{source}: refused: {file.name} has {file.stat().st_size} bytes, at most {MAX_XML} are allowed")

    def refuse(*_: object) -> None:
        raise SlaveError(f"{source}: refused: {file.name} has a document type declaration or entities (line {parser.CurrentLineNumber})")

    def root(_: str, found: dict[str, str]) -> None:
        attributes.update(found)
        parser.StartElementHandler = None

    attributes: dict[str, str] = {}
    parser = xml.parsers.expat.ParserCreate()
    parser.StartElementHandler = root
    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    try:
        parser.Parse(file.read_bytes(), True)
    except (xml.parsers.expat.ExpatError, ValueError, LookupError) as error:  # the last two: its encoding
        raise SlaveError(f"{source}: {file.name} is not valid XML: {error}") from None
    return attributes


def _short(name: str) -> str:
    return repr(name if len(name) <= 120 else name[:120] + "...")


def _kind(file: Path) -> str:
    if file.is_dir():
        return "it is a folder"
    size = file.stat().st_size
    if size == 0:
        return "it is empty"
    with file.open("rb") as stream:
        return f"{size} bytes, begins with {stream.read(8)!r}"


def _siblings(file: Path, kind: str) -> str:
    if not file.parent.is_dir():
        return f"; the folder {file.parent} does not exist either"
    names = sorted(p.name for p in file.parent.glob(f"*.{kind.lower()}"))
    return f"; {kind}s in that folder: {', '.join(names) or 'none'}"
