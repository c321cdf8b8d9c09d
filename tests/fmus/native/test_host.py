"""Native FMUs in a C program without Python: on this machine, and the win64 libraries under Wine."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal

import fmpy
import numpy as np
import pytest

from robomill.fmus.components import NAMES
from robomill.fmus.in_process import InProcessSlave
from robomill.fmus.interface import Interface
from robomill.fmus.native.builder import c_sources
from robomill.fmus.native.lower import Lowering
from robomill.fmus.native.targets import PLATFORMS, Slice, link
from robomill.models.model.declaration import FloatArray
from tests.fmus import native_runs as runs

SOURCE = Path(__file__).parent / "host.c"
WINE = shutil.which("wine64") or next((str(p) for p in [Path("/usr/lib/wine/wine64")] if p.is_file()), None)
QEMU, ARM = shutil.which("qemu-aarch64"), Path("/usr/aarch64-linux-gnu")
ZIG = importlib.util.find_spec("ziglang") is not None
Host = Callable[[str, Path, int, str], "subprocess.CompletedProcess[str]"]


def script(interface: Interface, rows: FloatArray, values: dict[str, Any]) -> str:
    """The commands of host.c for a run as `native_runs.drive` does it. Outputs that are booleans are left out."""
    lines = []
    kinds = {"real": "R", "integer": "I", "boolean": "B"}
    groups = {name: [p for p in interface.ports if p.variable == name] for name in dict.fromkeys(p.variable for p in interface.ports)}
    for name, ports in groups.items():
        given = {p.name: values[p.name] for p in ports if p.name in values}
        if given and ports[0].type == "string":
            lines.append(f"S {ports[0].reference} {given[name]}")
        elif given:
            lines.append(command(kinds[ports[0].type], ports, [given.get(p.name, p.start) for p in ports]))
    outputs = [
        f"{'O' if ports[0].type == 'real' else 'N'} {ports[0].reference} {len(ports)}"
        for ports in groups.values()
        if ports[0].causality == "output" and ports[0].type != "boolean"
    ]
    lines.append("E")
    for k, row in enumerate([rows[0], *rows]):
        for name, part in interface.arrays.items():
            ports = interface.inputs[part]
            if ports and ports[0].variable == name:
                lines.append(command(kinds[ports[0].type], list(ports), row[part].tolist()))
        if k == 1:
            lines.append("X")
        if k > 0:
            lines.append(f"D {bits((k - 1) * runs.H)} {bits(runs.H)}")
        lines += outputs
    return "\n".join(lines) + "\n"


def command(kind: str, ports: list[Any], values: list[Any]) -> str:
    """A command that sets the elements of a variable."""
    shown = [bits(v) if kind == "R" else str(int(v)) for v in values]
    return f"{kind} {ports[0].reference} {len(ports)} {' '.join(shown)}"


def bits(value: float) -> str:
    """The bits of a float64."""
    return f"{int(np.float64(value).view(np.uint64)):016x}"


def expected_lines(interface: Interface, out: FloatArray) -> list[str]:
    """What the host prints for these outputs."""
    shown = [(i, p) for i, p in enumerate(interface.outputs) if p.type != "boolean"]
    return [bits(row[i]) if p.type == "real" else str(int(row[i])) for row in out for i, p in shown]


def compare(name: str, variant: str, library: Path, fmi: int, token: str, host: Host) -> None:
    """Run a library in the host and the model in this process: the printed bits must be the same."""
    model = runs.model(name)
    interface = Interface(model)
    rows, values = runs.inputs(name, interface), runs.parameters(name, variant, model)
    out = runs.drive(InProcessSlave(model), len(interface.outputs), rows, values)
    done = host(script(interface, rows, values), library, fmi, token)
    assert done.returncode == 0, done.stderr
    expected, found = expected_lines(interface, out), done.stdout.split()
    assert len(found) == len(expected)
    names = [p.name for p in interface.outputs if p.type != "boolean"]
    for k, (a, b) in enumerate(zip(expected, found, strict=True)):
        assert a == b, f"{library.name}: {names[k % len(names)]} differs first in step {k // len(names)}: {a} here, {b} in the host"


def extract(file: Path, member: str, folder: Path) -> tuple[Path, str]:
    """A library of an FMU, and its GUID."""
    with zipfile.ZipFile(file) as archive:
        return Path(archive.extract(member, folder)), fmpy.read_model_description(str(file)).guid


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Host:
    """The host on this machine, in an empty environment: there is no Python to be found."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None or not runs.ON_LINUX:
        pytest.skip("needs Linux and a C compiler")
    program = tmp_path_factory.mktemp("host") / "host"
    subprocess.run([compiler, "-O1", "-Wall", "-Werror", str(SOURCE), "-o", str(program), "-ldl"], check=True)

    def run(commands: str, library: Path, fmi: int, token: str) -> subprocess.CompletedProcess[str]:
        arguments = [str(program), str(library), str(fmi), token, "host"]
        return subprocess.run(arguments, input=commands, capture_output=True, text=True, env={"PATH": ""}, check=False)

    return run


@pytest.fixture(scope="module")
def under_wine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Host]:
    """The host as a Windows program under Wine."""
    if WINE is None or not ZIG:
        pytest.skip(f"needs {'Wine (Debian: apt-get install wine64)' if WINE is None else 'the package ziglang'}")
    folder = tmp_path_factory.mktemp("wine")
    program = folder / "host.exe"
    command = [sys.executable, "-m", "ziglang", "cc", "-target", "x86_64-windows-gnu", "-O1", "-s", str(SOURCE), "-o", str(program)]
    subprocess.run(command, check=True)
    environment = {
        **os.environ,
        "WINEPREFIX": str(folder / "prefix"),
        "WINEDEBUG": "-all",
        "DISPLAY": "",
        "WINEDLLOVERRIDES": "mscoree,mshtml=",
    }
    try:
        subprocess.run([str(WINE), "wineboot", "-i"], env=environment, capture_output=True, timeout=300, check=False)

        def run(commands: str, library: Path, fmi: int, token: str) -> subprocess.CompletedProcess[str]:
            arguments = [str(WINE), str(program), f"Z:{library}".replace("/", "\\"), str(fmi), token, "host"]
            return subprocess.run(arguments, input=commands, capture_output=True, text=True, env=environment, timeout=300, check=False)

        yield run
    finally:
        subprocess.run([str(WINE), "wineboot", "-k"], env=environment, capture_output=True, timeout=60, check=False)


@pytest.fixture(scope="module")
def on_arm(tmp_path_factory: pytest.TempPathFactory) -> Host:
    """The host as a program for 64-bit ARM under QEMU. Apple's processors cannot be had here: Linux with their instructions stands in."""
    if QEMU is None or not ARM.is_dir() or not ZIG:
        pytest.skip("needs QEMU (Debian: apt-get install qemu-user libc6-arm64-cross) and the package ziglang")
    program = tmp_path_factory.mktemp("arm") / "host"
    command = [
        sys.executable,
        "-m",
        "ziglang",
        "cc",
        "-target",
        "aarch64-linux-gnu.2.31",
        "-O1",
        "-s",
        str(SOURCE),
        "-o",
        str(program),
        "-ldl",
    ]
    subprocess.run(command, check=True)

    def run(commands: str, library: Path, fmi: int, token: str) -> subprocess.CompletedProcess[str]:
        arguments = [str(QEMU), "-L", str(ARM), str(program), str(library), str(fmi), token, "host"]
        return subprocess.run(arguments, input=commands, capture_output=True, text=True, timeout=300, check=False)

    return run


@pytest.mark.slow
@pytest.mark.parametrize("name", ["demo", *NAMES])
def test_arm_gives_the_same_bits_under_qemu(name: str, on_arm: Host, tmp_path: Path) -> None:
    interface = Interface(runs.model(name))
    with Lowering() as lowering:
        lowered = lowering.lower(interface.model)
    token, sources = c_sources(interface, lowered)
    target = Slice("aarch64-unknown-linux-gnu", "apple-m1", "aarch64-linux-gnu.2.31")
    library = link(lowered.code, sources, name, PLATFORMS["linux64"], target, tmp_path / "work", True)
    file = tmp_path / f"{name}.so"
    file.write_bytes(library)
    for variant in runs.VARIANTS:
        compare(name, variant, file, 2, token, on_arm)


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_c_program_without_python_gets_the_numbers_of_the_model(
    fmi: Literal[2, 3], built_native: Callable[..., Path], here: Host, tmp_path: Path
) -> None:
    folder = {2: "linux64", 3: "x86_64-linux"}[fmi]
    library, token = extract(built_native("sensor_chain", fmi), f"binaries/{folder}/sensor_chain.so", tmp_path)
    compare("sensor_chain", "golden", library, fmi, token, here)


@pytest.mark.slow
@pytest.mark.parametrize("variant", runs.VARIANTS)
@pytest.mark.parametrize("fmi", [2, 3])
# from the last to the first: test_parity, which often runs at the same time, goes the other way, and what is lowered once is kept
@pytest.mark.parametrize("name", ["demo", *reversed(NAMES)])
def test_every_component_in_a_c_program(
    name: str, fmi: Literal[2, 3], variant: str, built_native: Callable[..., Path], here: Host, tmp_path: Path
) -> None:
    folder = {2: "linux64", 3: "x86_64-linux"}[fmi]
    library, token = extract(built_native(name, fmi), f"binaries/{folder}/{name}.so", tmp_path)
    compare(name, variant, library, fmi, token, here)


def test_the_c_program_sees_errors(built_native: Callable[..., Path], here: Host, tmp_path: Path) -> None:
    library, token = extract(built_native("demo"), "binaries/linux64/demo.so", tmp_path)
    interface = Interface(runs.model("demo"))
    x = interface.by_name["x[1]"].reference
    commands = f"E X R {x} 1 {bits(1.5)} D {bits(0.0)} {bits(0.004)}\n"
    done = here(commands, library, 2, token)
    assert done.returncode == 1
    assert "host 3 logStatusError: host (demo): x[1] = 1.5 m is too far at t = 0.0 s; at most 1 m" in done.stderr
    done = here("E X\n", library, 2, "{another}")
    assert done.returncode == 1
    assert "the instantiation token (GUID) is '{another}', expected '{" in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("name", ["demo", *NAMES])
def test_win64_gives_the_same_bits_under_wine(name: str, built_native: Callable[..., Path], under_wine: Host, tmp_path: Path) -> None:
    library, token = extract(built_native(name, 2, ("win64",)), f"binaries/win64/{name}.dll", tmp_path)
    for variant in runs.VARIANTS:
        compare(name, variant, library, 2, token, under_wine)
