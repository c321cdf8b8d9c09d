"""Opening archives that others made: nothing is written outside the target folder, nothing explodes."""

from __future__ import annotations

import lzma
import stat
import xml.parsers.expat
import zipfile
import zlib
from pathlib import Path, PurePosixPath

from robomill.orchestration.errors import SlaveError, shortened

MAX_TOTAL = 2 * 1024**3
"""Largest sum of the unpacked sizes of an archive [bytes]."""
MAX_FILES = 20_000
MAX_XML = 256 * 1024**2
MAX_NAME, MAX_DEPTH = 1000, 50
"""Limits of the path of an entry: characters, levels of folders."""
MAX_XML_DEPTH = 100
"""Levels of elements within each other: readers of XML follow them by recursion."""
_CHUNK = 1024**2
_SHOWN = 120
"""Characters of the name of an entry that a message shows."""


def unpack(file: Path, target: Path, max_total: int = MAX_TOTAL, max_files: int = MAX_FILES, kind: str = "FMU") -> list[str]:
    """Unpack the zip archive `file` into the folder `target` and return the names of its files. `kind` of archive, for messages.

    SlaveError for: no such file, not a zip archive, damaged or encrypted, an entry that would leave
    the folder (absolute, drive letter, backslash, `..`), a symbolic link or other special file, more
    than `max_files` entries, more than `max_total` bytes unpacked, a file twice with different contents
    (twice the same is fine: some tools write it so).
    """
    if not file.exists():
        raise SlaveError(f"{file}: no such file{_siblings(file, kind)}")
    if not zipfile.is_zipfile(file):
        raise SlaveError(f"{file}: not a zip archive, so not an {kind} ({_kind(file)}); get the file anew from whoever made it")
    try:
        with zipfile.ZipFile(file) as archive:
            entries = archive.infolist()
            if len(entries) > max_files:
                raise SlaveError(f"{file}: refused: {len(entries)} entries, at most {max_files} are allowed")
            total = sum(e.file_size for e in entries)
            if total > max_total:
                raise SlaveError(f"{file}: refused: unpacks to {total} bytes, at most {max_total} are allowed")
            seen: dict[str, zipfile.ZipInfo] = {}
            for entry in entries:
                _check_entry(file, entry)
                place = str(PurePosixPath(entry.filename))  # where it is unpacked to: "a//b" and "a/./b" are "a/b"
                first = seen.setdefault(place, entry)
                if not (first is entry or (entry.is_dir() and first.is_dir())) and not _same_bytes(archive, first, entry):
                    raise SlaveError(
                        f"{file}: refused: entry {_short(entry.filename)} is there twice with different contents "
                        f"({first.file_size} and {entry.file_size} bytes): which one is meant cannot be told; pack it anew"
                    )
            archive.extractall(target, list(seen.values()))
    except (zipfile.BadZipFile, zlib.error, lzma.LZMAError, NotImplementedError, EOFError, OSError, ValueError) as error:
        raise SlaveError(f"{file}: cannot be unpacked: {error}; get the file anew from whoever made it") from None
    return [e.filename for e in seen.values() if not e.is_dir()]


def _same_bytes(archive: zipfile.ZipFile, one: zipfile.ZipInfo, other: zipfile.ZipInfo) -> bool:
    """Whether two entries are files that hold the same; compared piece by piece, as they may be large."""
    if one.is_dir() or other.is_dir() or (one.file_size, one.CRC) != (other.file_size, other.CRC):
        return False
    with archive.open(one) as a, archive.open(other) as b:
        while chunk := a.read(_CHUNK):
            if chunk != b.read(len(chunk)):
                return False
    return True


def _check_entry(file: Path, entry: zipfile.ZipInfo) -> None:
    # orig_filename: zipfile itself cuts at a NUL byte and, on Windows, turns separators around
    name = entry.orig_filename
    path = PurePosixPath(name)
    if "\\" in name and ".." not in name and ":" not in name:
        raise SlaveError(
            f"{file}: refused: entry {_short(name)} has a backslash, which parts folders on Windows only: pack it with / instead"
        )
    if path.is_absolute() or ".." in path.parts or "\\" in name or ":" in name or "\0" in name:
        raise SlaveError(
            f"{file}: refused: entry {_short(name)} would be written outside the folder it is unpacked to"
            "; get the file anew from whoever made it"
        )
    if len(name) > MAX_NAME or len(path.parts) > MAX_DEPTH:
        raise SlaveError(
            f"{file}: refused: entry {_short(name)} has {len(name)} characters in {len(path.parts)} levels; "
            f"at most {MAX_NAME} in {MAX_DEPTH} are allowed"
        )
    mode = entry.external_attr >> 16
    if stat.S_IFMT(mode) not in (0, stat.S_IFREG, stat.S_IFDIR):
        raise SlaveError(f"{file}: refused: entry {_short(name)} is a symbolic link or a special file; pack it anew with plain files")
    if entry.flag_bits & 0x1:
        raise SlaveError(f"{file}: refused: entry {_short(name)} is encrypted; pack it anew without encryption")


def check_xml(file: Path, source: Path) -> dict[str, str]:
    """Refuse XML with a document type or entities (they can explode or read other files), or nested too deep; return its root's attributes.

    `source` is the archive that errors name.
    """
    if file.stat().st_size > MAX_XML:
        raise SlaveError(f"{source}: refused: {file.name} has {file.stat().st_size} bytes, at most {MAX_XML} are allowed")

    attributes: dict[str, str] = {}
    depth = 0

    def refuse(*_: object) -> None:
        raise SlaveError(
            f"{source}: refused: {file.name} has a document type declaration or entities (line {parser.CurrentLineNumber}); remove it"
        )

    def begin(_: str, found: dict[str, str]) -> None:
        nonlocal depth
        if depth == 0:
            attributes.update(found)
        depth += 1
        if depth > MAX_XML_DEPTH:
            raise SlaveError(
                f"{source}: refused: {file.name} is nested more than {MAX_XML_DEPTH} deep (line {parser.CurrentLineNumber})"
                "; get the file anew from whoever made it"
            )

    def end(_: str) -> None:
        nonlocal depth
        depth -= 1

    parser = xml.parsers.expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = begin, end
    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    try:
        parser.Parse(file.read_bytes(), True)
    except (xml.parsers.expat.ExpatError, ValueError, LookupError) as error:  # the last two: its encoding
        raise SlaveError(f"{source}: {file.name} is not valid XML: {error}; get the file anew from whoever made it") from None
    return attributes


def _short(name: str) -> str:
    return repr(shortened(name, _SHOWN))


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
