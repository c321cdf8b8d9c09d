"""A look into a shared library before it is loaded: the loader of the system crashes the process on some broken ones."""

from __future__ import annotations

import platform
import struct
import sys
from pathlib import Path

_MACHINES = {"x86_64": 62, "amd64": 62, "aarch64": 183, "arm64": 183, "i386": 3, "i686": 3, "riscv64": 243, "ppc64le": 21}
_NAMES = {3: "x86", 40: "ARM", 62: "x86-64", 183: "ARM64", 21: "PowerPC", 243: "RISC-V", 8: "MIPS"}
_HEADER = struct.Struct("<16sHHIQQQIHHHHHH")
_SEGMENT = struct.Struct("<IIQQQQQQ")
_WIDTH_AND_ORDER = b"\x02\x01"
"""Bytes 4 and 5 of an ELF header that are expected: 64 bits, least significant byte first."""
_SHARED, _LOAD, _DYNAMIC = 3, 1, 2
_OTHERS = {b"MZ": "Windows", b"\xcf\xfa\xed\xfe": "macOS", b"\xca\xfe\xba\xbe": "macOS", b"!<ar": "static library"}


def problem(library: Path) -> str:
    """What keeps a library from being loaded on this Linux, "" if nothing does; on other systems always "".

    Seen: not a library, one of another system or processor, cut off, segments outside the file. Not seen: damage inside
    its code; FMUs that are not trusted run in a process of their own (`isolation`).
    """
    if sys.platform != "linux":
        return ""
    data = library.read_bytes()
    if data[:4] != b"\x7fELF":
        other = next((name for magic, name in _OTHERS.items() if data.startswith(magic)), "")
        return f"is no Linux library{f' but one for {other}' if other else ''} ({len(data)} bytes, begins with {data[:8]!r})"
    if len(data) < _HEADER.size or data[4:6] != _WIDTH_AND_ORDER:
        return "is no 64 bit library, or cut off in its header"
    _, kind, machine, _, _, at, _, _, _, size, count, *_ = _HEADER.unpack_from(data)
    expected = _MACHINES.get(platform.machine().lower(), machine)
    if machine != expected:
        return f"is for another processor: {_NAMES.get(machine, machine)}; this one is {platform.machine()}"
    if kind != _SHARED:
        return "is not a shared library"
    if size != _SEGMENT.size or not count or at + size * count > len(data):
        return f"is damaged or cut off ({len(data)} bytes): its table of segments is not in it"
    kinds = set()
    for i in range(count):
        segment, _, begin, address, _, in_file, in_memory, _ = _SEGMENT.unpack_from(data, at + i * size)
        kinds.add(segment)
        if segment in (_LOAD, _DYNAMIC) and (begin + in_file > len(data) or in_file > in_memory or address + in_memory >= 1 << 47):
            return f"is damaged or cut off: it has {len(data)} bytes, and a segment that ends at {begin + in_file}"
    return "" if {_LOAD, _DYNAMIC} <= kinds else "is damaged: it has nothing to load"
