"""From LLVM code and C sources to shared libraries, for this and other platforms.

Only additions, multiplications and the like as they stand in the code: LLVM fuses none of them
unless it is told to, and nothing here tells it to. The C compiler sees no model arithmetic.
"""

from __future__ import annotations

import importlib.util
import shutil
import struct
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from robomill.fmus.native.lower import NativeBuildError


@dataclass(frozen=True)
class Slice:
    """One processor of a platform."""

    triple: str
    """Target triple of LLVM."""
    processor: str
    zig: str
    """Target of `zig cc`, with the oldest system that the library is to run on."""
    fat_type: tuple[int, int] = (0, 0)
    """Processor type and subtype in a fat Mach-O header."""
    fmi3: str = ""
    """FMI 3.0 platform tuple."""


@dataclass(frozen=True)
class Platform:
    """A platform of FMI 2.0: its folder name below binaries/ is the key in `PLATFORMS`."""

    suffix: str
    slices: tuple[Slice, ...]
    flags: tuple[str, ...] = ()


PLATFORMS: Mapping[str, Platform] = {
    "linux64": Platform(
        ".so",
        (Slice("x86_64-unknown-linux-gnu", "x86-64-v2", "x86_64-linux-gnu.2.17", fmi3="x86_64-linux"),),
        ("-fPIC", "-Wl,-z,noexecstack", "-Wl,-Bsymbolic"),
    ),
    "win64": Platform(".dll", (Slice("x86_64-pc-windows-gnu", "x86-64-v2", "x86_64-windows-gnu", fmi3="x86_64-windows"),)),
    "darwin64": Platform(
        ".dylib",
        (
            Slice("arm64-apple-macosx11.0.0", "apple-m1", "aarch64-macos.11.0", (0x0100000C, 0), "aarch64-darwin"),
            Slice("x86_64-apple-macosx11.0.0", "x86-64-v2", "x86_64-macos.11.0", (0x01000007, 3), "x86_64-darwin"),
        ),
        ("-fPIC",),
    ),
}
_COMMON = (
    "-std=c11",
    "-O2",
    "-g0",
    "-shared",
    "-fvisibility=hidden",
    "-fno-sanitize=undefined",
    "-ffp-contract=off",
    "-Wall",
    "-Wextra",
    "-Werror",
)
_FAT_MAGIC, _FAT_ALIGNMENT = 0xCAFEBABE, 14


def object_code(code: str, target: Slice) -> bytes:
    """The object file of the LLVM assembly for a processor, optimised."""
    machine, module = optimised(code, target)
    emitted: bytes = machine.emit_object(module)
    return emitted


def optimised(code: str, target: Slice) -> tuple[Any, Any]:
    """LLVM's machine for a processor, and the LLVM assembly as an optimised module for it."""
    import llvmlite.binding as llvm

    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    machine = llvm.Target.from_triple(target.triple).create_target_machine(
        cpu=target.processor, features="", opt=3, reloc="pic", codemodel="default"
    )
    module = llvm.parse_assembly(f'target triple = "{target.triple}"\ntarget datalayout = "{machine.target_data}"\n{code}')
    module.name = "model"
    builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=3))
    builder.getModulePassManager().run(module, builder)
    return machine, module


def uses_zig(platforms: Sequence[str]) -> bool:
    """Whether `zig cc` links these platforms: it does unless only the Linux this runs on is asked for."""
    return not (tuple(platforms) == ("linux64",) and sys.platform == "linux" and shutil.which("gcc"))


def compiler(zig: bool) -> str:
    """Name and version of what links, for the record. NativeBuildError if it is not there."""
    if zig:
        if importlib.util.find_spec("ziglang") is None:
            raise NativeBuildError(
                "cross linking needs the package ziglang, which is not installed: pip install ziglang; "
                "linux64 alone is linked by gcc on Linux"
            )
        return f"zig {version('ziglang')}"
    done = subprocess.run(["gcc", "-dumpfullversion"], capture_output=True, text=True, check=True)
    return f"gcc {done.stdout.strip()}"


def libraries(code: str, sources: Mapping[str, bytes], name: str, platforms: Sequence[str], folder: Path) -> dict[str, dict[str, bytes]]:
    """Shared libraries: platform -> FMI 3.0 platform tuple -> content. `sources` are C files and headers, `folder` is for the work."""
    zig = uses_zig(platforms)
    return {
        platform: {s.fmi3: link(code, sources, name, PLATFORMS[platform], s, folder / s.fmi3, zig) for s in PLATFORMS[platform].slices}
        for platform in platforms
    }


def link(code: str, sources: Mapping[str, bytes], name: str, platform: Platform, target: Slice, folder: Path, zig: bool) -> bytes:
    """The shared library for one processor, made in the new folder `folder`. NativeBuildError with what the compiler says."""
    folder.mkdir(parents=True)
    for file, content in {**sources, "model.o": object_code(code, target)}.items():
        (folder / file).write_bytes(content)
    library = name + platform.suffix
    command = [sys.executable, "-m", "ziglang", "cc", "-target", target.zig] if zig else ["gcc", "-nostartfiles"]
    command += [*_COMMON, *platform.flags, "-s", "-o", library, *sorted(f for f in sources if f.endswith(".c")), "model.o"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, errors="replace", check=False)
    if done.returncode != 0:
        raise NativeBuildError(f"linking {library} for {target.triple} failed: {' '.join(command)}\n{(done.stderr or done.stdout).strip()}")
    return (folder / library).read_bytes()


def fat(slices: Mapping[str, bytes]) -> bytes:
    """A fat Mach-O file of the darwin64 slices (FMI 3.0 platform tuple -> library)."""
    types = {s.fmi3: s.fat_type for s in PLATFORMS["darwin64"].slices}
    align = 1 << _FAT_ALIGNMENT
    header = struct.pack(">II", _FAT_MAGIC, len(slices))
    body = b""
    for name, content in slices.items():
        body += bytes(-len(body) % align)
        header += struct.pack(">iiIII", *types[name], align + len(body), len(content), _FAT_ALIGNMENT)
        body += content
    return header + bytes(align - len(header)) + body
