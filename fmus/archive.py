"""Zip archives that come out the same, byte for byte, whenever and wherever they are written (with the same zlib)."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path
from uuid import uuid4

_EPOCH = (1980, 1, 1, 0, 0, 0)
_REGULAR_FILE = 0o100644 << 16


def write(file: Path, content: Mapping[str, bytes]) -> None:
    """Write the archive: sorted, modelDescription.xml first, fixed dates and modes; `file` is replaced when it is complete."""
    file.parent.mkdir(parents=True, exist_ok=True)
    partial = file.with_name(f".{file.name}.{uuid4().hex}")
    try:
        with zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
            for name in sorted(content, key=lambda n: (n != "modelDescription.xml", n)):
                entry = zipfile.ZipInfo(name, _EPOCH)
                entry.create_system = 3
                entry.external_attr = _REGULAR_FILE
                entry.compress_type = zipfile.ZIP_DEFLATED
                archive.writestr(entry, content[name])
        partial.replace(file)
    finally:
        partial.unlink(missing_ok=True)
