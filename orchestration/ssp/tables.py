"""FMUs of this project that carry the tables of a run: no importer has to hand over the path of a file for them.

SSP knows texts as parameters, but not that one names a file of the package; OMSimulator 2 does not hand over texts at all. A path
component without its table mills the built-in program, and nobody is told. So the FMU in a package holds the rows itself: in
`resources/tables/NAME.npy`, where the built-in ones stand, and its GUID ends in `+NAME`. The native library is given the GUID by
the importer and then reads that file or refuses; the Python backend always reads it.
"""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Mapping

MODEL = "modelDescription.xml"
_GUID = re.compile(rb'\b(guid|instantiationToken)="([^"]*)"')


def carrying(fmu: bytes, tables: Mapping[str, bytes]) -> bytes:
    """The FMU with these tables (.npy files by parameter) as its built-in rows; the same ones give the same bytes."""
    places = {f"resources/tables/{name}.npy": data for name, data in tables.items()}
    made = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(fmu)) as source, zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as target:
        date = source.getinfo(MODEL).date_time
        for entry in source.infolist():
            if entry.filename not in places:
                data = source.read(entry)
                target.writestr(entry, _renamed(data, tables) if entry.filename == MODEL else data)
        for place, data in sorted(places.items()):
            added = zipfile.ZipInfo(place, date)
            added.create_system, added.external_attr, added.compress_type = 3, 0o100644 << 16, zipfile.ZIP_DEFLATED
            target.writestr(added, data)
    return made.getvalue()


def _renamed(description: bytes, tables: Mapping[str, bytes]) -> bytes:
    suffix = "".join(f"+{name}" for name in sorted(tables)).encode()
    return _GUID.sub(rb'\1="\2' + suffix + b'"', description, count=1)
