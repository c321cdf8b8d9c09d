"""MDF4 logs, through asammdf."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from robomill.logs.log import FloatArray, Log, LogError, missing_package


def read_mdf(file: Path) -> Log:
    """Channels by name, each with the clock of its group."""
    try:
        from asammdf import MDF
    except ImportError:
        raise missing_package(file, "MDF files", "asammdf", "mdf", "export the log as CSV") from None
    try:
        mdf = MDF(file)
    except Exception as error:  # asammdf raises many kinds for a damaged file
        raise LogError(f"{file}: not an MDF file: {error}; export the log anew as MDF 4") from None
    places: dict[str, tuple[int, int]] = {}
    masters: dict[str, str] = {}
    clocks: dict[int, str] = {}
    for name, occurrences in mdf.channels_db.items():
        for group, index in occurrences:
            full = name if len(occurrences) == 1 else f"{group}/{name}"
            if index == mdf.masters_db.get(group):
                full = name if len(occurrences) == 1 else f"{group}/{name}"
                clocks[group] = full
            places[full] = (group, index)
    masters = {n: clocks[g] for n, (g, _) in places.items() if g in clocks}
    units = {}
    for name, (group, index) in places.items():
        if text := str(mdf.get_channel_unit(group=group, index=index) or "").strip():
            units[name] = text

    def fetch(name: str) -> FloatArray:
        group, index = places[name]
        if clocks.get(group) == name:
            return np.asarray(mdf.get_master(group), dtype=np.float64)
        samples = mdf.get(group=group, index=index, raw=False).samples
        if samples.ndim != 1 or samples.dtype.kind not in "fiub":
            raise LogError(
                f"{file}: column {name!r} holds no numbers but {samples.dtype} of shape {samples.shape}"
                "; leave the signal out, or export it as numbers"
            )
        return np.asarray(samples, dtype=np.float64)

    return Log(file, tuple(places), fetch, units, masters)
