"""What is in a native FMU: libraries that need nothing but the C library, complete exports, valid descriptions, equal bytes."""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import struct
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal

import fmpy
import pytest
from fmpy.validation import validate_fmu

from robomill.fmus.components import NAMES
from robomill.fmus.interface import Interface
from robomill.fmus.native.lower import NativeBuildError
from robomill.fmus.native.targets import PLATFORMS
from robomill.fmus.terminals import terminals
from tests.fmus import demo, native_runs

ALL = ("demo", *NAMES)
C_LIBRARY = re.compile(
    r"(mem|str)(chr|cmp|cpy|move|set|len|ncmp|str|tod|tol|toull)|(c|m|re)alloc|free|v?snprintf|f(open|read|close)|__cxa_finalize|__stack_chk_fail"
)
needs_zig = pytest.mark.skipif(importlib.util.find_spec("ziglang") is None, reason="cross linking needs the package ziglang")
needs_linux = pytest.mark.skipif(not native_runs.ON_LINUX or not shutil.which("nm"), reason="needs Linux with nm and ldd")


def extract(file: Path, member: str, folder: Path) -> Path:
    with zipfile.ZipFile(file) as archive:
        return Path(archive.extract(member, folder))


def standard_functions() -> set[str]:
    """The functions of FMI 2.0 co-simulation and of FMI 3.0, from the headers that FMPy carries."""
    headers = Path(fmpy.__file__).parent / "c-code"
    found: set[str] = set()
    for header in ("fmi2Functions.h", "fmi3Functions.h"):
        found |= set(re.findall(r"(fmi[23]\w+)TYPE\s+\w+", (headers / header).read_text()))
    parts = (
        "EventMode",
        "NewDiscreteStates",
        "ContinuousTimeMode",
        "IntegratorStep",
        "SetTime",
        "ContinuousStates",
        "Derivatives",
        "Indicators",
    )
    model_exchange = {f for f in found if f.startswith("fmi2") and f.endswith(parts) and "Real" not in f}
    return found - model_exchange


@needs_linux
@pytest.mark.parametrize("name", ALL)
def test_the_linux_library_needs_the_c_library_only(name: str, built_native: Callable[..., Path], tmp_path: Path) -> None:
    library = extract(built_native(name), f"binaries/linux64/{name}.so", tmp_path)
    undefined = subprocess.run(["nm", "-D", "--undefined-only", str(library)], capture_output=True, text=True, check=True).stdout
    names = {line.split()[-1].partition("@")[0] for line in undefined.splitlines()}
    assert not [n for n in names if not C_LIBRARY.fullmatch(n)]
    needed = subprocess.run(["ldd", str(library)], capture_output=True, text=True, check=True).stdout
    files = {line.split()[0].rpartition("/")[2] for line in needed.splitlines() if line.strip()}
    assert files <= {"linux-vdso.so.1", "libc.so.6", "libm.so.6", "ld-linux-x86-64.so.2"}


@needs_linux
def test_it_exports_both_standards_completely_and_nothing_else(built_native: Callable[..., Path], tmp_path: Path) -> None:
    library = extract(built_native("demo"), "binaries/linux64/demo.so", tmp_path)
    defined = subprocess.run(["nm", "-D", "--defined-only", str(library)], capture_output=True, text=True, check=True).stdout
    assert {line.split()[-1] for line in defined.splitlines()} == standard_functions()
    assert len(standard_functions()) > 100


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", ALL)
def test_fmpy_finds_no_problem(name: str, fmi: Literal[2, 3], built_native: Callable[..., Path]) -> None:
    assert validate_fmu(str(built_native(name, fmi))) == []


def test_contents(built_native: Callable[..., Path]) -> None:
    common = {"modelDescription.xml", "documentation/index.html", "documentation/licenses/license.txt", "resources/tables/curve.npy"}
    common |= {f"terminalsAndIcons/{name}" for name in ("terminalsAndIcons.xml", "icon.png", "icon.svg")}
    common |= {f"extra/com.github.robomill/{name}" for name in ("provenance.json", "sbom.cdx.json")}
    common |= {"extra/org.fmi-standard.fmi-ls-ref/fmi-ls-manifest.xml"}
    with zipfile.ZipFile(built_native("demo")) as archive:
        assert set(archive.namelist()) == common | {"model.png", "binaries/linux64/demo.so"}
        assert b"FMI 2.0 co-simulation FMU (native backend)" in archive.read("documentation/index.html")
    with zipfile.ZipFile(built_native("demo", 3)) as archive:
        assert set(archive.namelist()) == common | {"binaries/x86_64-linux/demo.so"}
        assert b"FMI 3.0 co-simulation FMU (native backend)" in archive.read("documentation/index.html")


@pytest.mark.parametrize("name", NAMES)
def test_fmi3_has_whole_arrays(name: str, built_native: Callable[..., Path]) -> None:
    interface = Interface(native_runs.model(name))
    found = {v.name: v for v in fmpy.read_model_description(str(built_native(name, 3))).modelVariables}
    for v in interface.model.variables:
        if v.causality == "state":
            assert v.name not in found
        elif v.kind != "table":
            assert tuple(int(d.start) for d in found[v.name].dimensions) == v.shape
            first = next(p for p in interface.ports if p.variable == v.name)
            assert found[v.name].valueReference == first.reference
    assert found["time"].causality == "independent"


def test_fmi3_dependencies_are_those_declared(built_native: Callable[..., Path]) -> None:
    description = fmpy.read_model_description(str(built_native("demo", 3)))
    found = {u.variable.name: sorted(d.name for d in u.dependencies) for u in description.outputs}
    assert found == {"force": ["x"], "count": [], "on": ["enable", "number"], "delayed": ["x"], "curve_value": []}


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("path_interpolator", {"pose_BT": ("p_BT_B", "quat_BT"), "force_pilot_B": ("f_pilot_B",)}),
        ("robot_drive", {"wrench_T_B": ("f_T_B", "m_T_B")}),
        (
            "robot_compliance",
            {
                "wrench_T_B": ("f_T_B", "m_T_B"),
                "wrench_turn_T_B": ("f_turn_T_B", "m_turn_T_B"),
                "pose_BT": ("p_BT_B", "quat_BT"),
                "displacement_T_B": ("d_T_B", "theta_T_B"),
            },
        ),
        (
            "milling_force",
            {"pose_BT": ("p_BT_B", "quat_BT"), "wrench_T_B": ("f_T_B", "m_T_B"), "wrench_turn_T_B": ("f_turn_T_B", "m_turn_T_B")},
        ),
        (
            "sensor_chain",
            {"wrench_T_B": ("f_T_B", "m_T_B"), "wrench_S_raw": ("f_S_raw", "m_S_raw"), "wrench_T_T": ("f_T_T", "m_T_T")},
        ),
        ("compensation_controller", {"wrench_T_T": ("f_T_T", "m_T_T"), "force_pilot_B": ("f_pilot_B",), "force_used_B": ("f_used_B",)}),
    ],
)
def test_terminals_bundle_poses_wrenches_and_forces(
    name: str, expected: dict[str, tuple[str, ...]], built_native: Callable[..., Path]
) -> None:
    found = {t.name: tuple(variable for _, variable in t.members) for t in terminals(Interface(native_runs.model(name)))}
    assert found == expected
    from lxml import etree

    schema = etree.XMLSchema(etree.parse(str(Path(fmpy.__file__).parent / "schema" / "fmi3" / "fmi3TerminalsAndIcons.xsd")))
    with zipfile.ZipFile(built_native(name, 3)) as archive:
        document = etree.fromstring(archive.read("terminalsAndIcons/terminalsAndIcons.xml"))
    schema.assertValid(document)
    assert sorted(t.get("name") for t in document.iter("Terminal")) == sorted(expected)


def test_both_standards_have_the_same_library(built_native: Callable[..., Path]) -> None:
    with zipfile.ZipFile(built_native("demo")) as two, zipfile.ZipFile(built_native("demo", 3)) as three:
        assert two.read("binaries/linux64/demo.so") == three.read("binaries/x86_64-linux/demo.so")


def _build_elsewhere(folder: Path, module: str, fmi: int, platforms: tuple[str, ...]) -> bytes:
    """Build in a process of its own, from the beginning: nothing is taken from a cache but the linker's own."""
    code = (
        f"from {module} import MODEL; from robomill.fmus.native.builder import build; "
        f"build(MODEL, r'{folder / 'a.fmu'}', fmi={fmi}, platforms={platforms!r})"
    )
    environment = {**os.environ, "ROBOMILL_CACHE_DIR": str(folder / "cache"), "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    subprocess.run([sys.executable, "-c", code], env=environment, cwd=folder, check=True)
    return (folder / "a.fmu").read_bytes()


@pytest.mark.parametrize("fmi", [2, 3])
def test_two_builds_in_two_processes_give_the_same_bytes(fmi: Literal[2, 3], built_native: Callable[..., Path], tmp_path: Path) -> None:
    assert _build_elsewhere(tmp_path, "tests.fmus.demo", fmi, ("linux64",)) == built_native("demo", fmi).read_bytes()


@needs_zig
@pytest.mark.slow
def test_two_builds_for_all_platforms_give_the_same_bytes(built_native: Callable[..., Path], tmp_path: Path) -> None:
    here = built_native("demo", 2, tuple(PLATFORMS)).read_bytes()  # it has tables, as the shipped components
    assert _build_elsewhere(tmp_path, "tests.fmus.demo", 2, tuple(PLATFORMS)) == here


@needs_zig
def test_the_guid_does_not_depend_on_the_platforms(built_native: Callable[..., Path]) -> None:
    one, all_ = (fmpy.read_model_description(str(built_native("demo", 2, p))).guid for p in (("linux64",), tuple(PLATFORMS)))
    assert one == all_


@needs_zig
def test_the_win64_library(built_native: Callable[..., Path], tmp_path: Path) -> None:
    data = extract(built_native("demo", 2, tuple(PLATFORMS)), "binaries/win64/demo.dll", tmp_path).read_bytes()
    assert data[:2] == b"MZ"
    header = struct.unpack_from("<I", data, 0x3C)[0]
    assert data[header : header + 4] == b"PE\0\0"
    machine, _, _, _, _, _, characteristics = struct.unpack_from("<HHIIIHH", data, header + 4)
    assert machine == 0x8664
    assert characteristics & 0x2000, "not a DLL"
    assert _pe_exports(data, header) == standard_functions()
    assert all(d == "KERNEL32.dll" or d.startswith("api-ms-win-crt-") for d in _pe_imports(data, header))


def _pe_sections(data: bytes, header: int) -> Callable[[int], int]:
    """Relative virtual address -> position in the file."""
    count, optional = struct.unpack_from("<H", data, header + 6)[0], struct.unpack_from("<H", data, header + 20)[0]
    sections = [struct.unpack_from("<IIII", data, header + 24 + optional + 40 * i + 8) for i in range(count)]

    def position(address: int) -> int:
        for size, virtual, raw_size, raw in sections:
            if virtual <= address < virtual + max(size, raw_size):
                return int(address - virtual + raw)
        raise AssertionError(f"address {address:x} lies in no section")

    return position


def _text(data: bytes, start: int) -> str:
    return data[start : data.index(b"\0", start)].decode()


def _pe_exports(data: bytes, header: int) -> set[str]:
    position = _pe_sections(data, header)
    table = position(struct.unpack_from("<I", data, header + 24 + 112)[0])
    count, names = struct.unpack_from("<I", data, table + 24)[0], struct.unpack_from("<I", data, table + 32)[0]
    return {_text(data, position(a)) for a in struct.unpack_from(f"<{count}I", data, position(names))}


def _pe_imports(data: bytes, header: int) -> set[str]:
    position = _pe_sections(data, header)
    at = position(struct.unpack_from("<I", data, header + 24 + 120)[0])
    found = set()
    while (name := struct.unpack_from("<I", data, at + 12)[0]) != 0:
        found.add(_text(data, position(name)))
        at += 20
    return found


@needs_zig
@pytest.mark.parametrize("name", ["demo", "milling_force"])
def test_the_darwin64_library(name: str, built_native: Callable[..., Path], tmp_path: Path) -> None:
    data = extract(built_native(name, 2, tuple(PLATFORMS)), f"binaries/darwin64/{name}.dylib", tmp_path).read_bytes()
    magic, count = struct.unpack_from(">II", data, 0)
    assert (magic, count) == (0xCAFEBABE, 2)
    processors = []
    for i in range(count):
        processor, _, offset, size, align = struct.unpack_from(">iiIII", data, 8 + 20 * i)
        assert offset % (1 << align) == 0
        part = data[offset : offset + size]
        kind, libraries, exports, signed = _mach_o(part)
        assert kind == processor
        assert libraries == {"/usr/lib/libSystem.B.dylib"}
        assert exports - {"___dso_handle", "__mh_dylib_header"} == {f"_{f}" for f in standard_functions()}  # zig's linker adds these two
        assert signed or processor != 0x0100000C, "Apple's processors only run signed code"
        processors.append(processor)
    assert processors == [0x0100000C, 0x01000007]


def _mach_o(data: bytes) -> tuple[int, set[str], set[str], bool]:
    """Processor, needed libraries, exported symbols, and whether there is a signature, of a dylib."""
    magic, processor, _, kind, commands = struct.unpack_from("<IiiII", data, 0)
    assert (magic, kind) == (0xFEEDFACF, 6)
    libraries, exports, signed, at = set(), set(), False, 32
    for _ in range(commands):
        command, size = struct.unpack_from("<II", data, at)
        if command in (0xC, 0x80000018, 0x8000001F):  # LC_LOAD_DYLIB, _WEAK_, _REEXPORT_
            libraries.add(_text(data, at + struct.unpack_from("<I", data, at + 8)[0]))
        elif command == 0x1D:
            signed = True
        elif command in (0x80000022, 0x80000033):  # LC_DYLD_INFO_ONLY, LC_DYLD_EXPORTS_TRIE: what dlsym finds
            start, length = struct.unpack_from("<II", data, at + (40 if command == 0x80000022 else 8))
            exports |= set(_trie(data[start : start + length], 0, ""))
        at += size
    return processor, libraries, exports, signed


def _trie(data: bytes, at: int, prefix: str) -> Iterator[str]:
    """Names in the export trie of a dylib: sizes and positions are LEB128 numbers."""

    def number(at: int) -> tuple[int, int]:
        value = shift = 0
        while True:
            value |= (data[at] & 0x7F) << shift
            shift, at = shift + 7, at + 1
            if not data[at - 1] & 0x80:
                return value, at

    size, at = number(at)
    if size:
        yield prefix
    at += size
    children, at = data[at], at + 1
    for _ in range(children):
        part = _text(data, at)
        child, at = number(at + len(part) + 1)
        yield from _trie(data, child, prefix + part)


@needs_zig
def test_fmi3_has_a_folder_per_processor(built_native: Callable[..., Path]) -> None:
    with zipfile.ZipFile(built_native("demo", 3, tuple(PLATFORMS))) as archive:
        found = {n for n in archive.namelist() if n.startswith("binaries/")}
    assert found == {
        "binaries/x86_64-linux/demo.so",
        "binaries/x86_64-windows/demo.dll",
        "binaries/aarch64-darwin/demo.dylib",
        "binaries/x86_64-darwin/demo.dylib",
    }


def test_what_cannot_be_built_is_said() -> None:
    from robomill.fmus.native.builder import build

    with pytest.raises(NativeBuildError, match=r"unknown platform win32; available: linux64, win64, darwin64"):
        build(demo.MODEL, "x.fmu", platforms=("win32",))
    with pytest.raises(NativeBuildError, match=r"unknown platform \(none\)"):
        build(demo.MODEL, "x.fmu", platforms=())
    with pytest.raises(NativeBuildError, match="FMI version 1: expected 2 or 3"):
        build(demo.MODEL, "x.fmu", fmi=1)  # type: ignore[arg-type]  # what a caller without types may do
