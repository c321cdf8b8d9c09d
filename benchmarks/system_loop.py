"""A plain C loop for any system of FMI 2.0 FMUs, generated from its wiring and compiled on the spot: what nobody's master can beat by much.

Same calls in the same order as Gauss-Seidel (or Jacobi) in the master, on static buffers; statuses are checked, nothing else.
"""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.ring import HEADERS, compiler
from robomill.orchestration.assembly import Assembly
from robomill.orchestration.slaves.protocol import Port, inputs, outputs

_NAMES = {"real": ("Real", "double"), "integer": ("Integer", "int"), "boolean": ("Boolean", "int")}

HEAD = r"""
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include "fmi2Functions.h"
#define CHECK(call) do { if ((call) > fmi2Warning) { fprintf(stderr, "failed: %s\n", #call); return 2; } } while (0)
static void logger(void *e, fmi2String i, fmi2Status s, fmi2String c, fmi2String m, ...) { fprintf(stderr, "%s\n", m); }
static fmi2CallbackFunctions callbacks = {logger, calloc, free, NULL, NULL};
"""


def _array(kind: str, name: str, values: Sequence[Any]) -> str:
    return f"static {kind} {name}[] = {{{', '.join(map(str, values)) or '0'}}};\n"


class _Part:
    """C code of one component."""

    def __init__(self, number: int, assembly: Assembly, name: str) -> None:
        self.slave: Any = assembly.slaves[name]
        self.k, self.name, self.wiring = number, name, assembly.wiring
        self.references = self.slave.description.references
        self.parameters = assembly.parameters[name]

    def groups(self, ports: Sequence[Port]) -> list[tuple[str, list[int]]]:
        """Types that occur, with the positions of their ports."""
        found = [(kind, [i for i, p in enumerate(ports) if p.type == kind]) for kind in _NAMES]
        return [(kind, places) for kind, places in found if places]

    def declare(self) -> str:
        """Functions, value references, buffers, places on the bus."""
        k, text = self.k, f"static fmi2Component c{self.k};\nstatic fmi2DoStepTYPE *step{self.k};\n"
        for way, ports in (("Set", inputs(self.slave.ports)), ("Get", outputs(self.slave.ports))):
            for kind, places in self.groups(ports):
                c_name, c_type = _NAMES[kind]
                text += f"static fmi2{way}{c_name}TYPE *{way}{c_name}{k};\n"
                text += _array("fmi2ValueReference", f"{way}{c_name}{k}_r", [self.references[ports[i].name] for i in places])
                text += f"static {c_type} {way}{c_name}{k}_b[{len(places)}];\n"
                if way == "Set":
                    text += _array("int", f"{way}{c_name}{k}_p", self.wiring.gather[self.name][places])
                    text += _array("int", f"{way}{c_name}{k}_f", self.wiring.gather_first[self.name][places])
                else:
                    text += _array("int", f"{way}{c_name}{k}_p", [self.wiring.output_slice[self.name].start + i for i in places])
        return text

    def load(self) -> str:
        """Load, instantiate, set parameters, enter initialisation."""
        k, d = self.k, self.slave.description
        library = next((d.folder / "binaries").glob(f"linux64/{d.identifier}.so"))
        text = f'{{ void *l = dlopen("{library}", RTLD_NOW | RTLD_LOCAL); if (!l) {{ fprintf(stderr, "%s\\n", dlerror()); return 1; }}\n'
        text += f'step{k} = (fmi2DoStepTYPE *)dlsym(l, "fmi2DoStep");\n'
        for way, ports in (("Set", inputs(self.slave.ports)), ("Get", outputs(self.slave.ports))):
            for kind, _ in self.groups(ports):
                n = _NAMES[kind][0]
                text += f'{way}{n}{k} = (fmi2{way}{n}TYPE *)dlsym(l, "fmi2{way}{n}");\n'
        resources = (d.folder / "resources").as_uri()
        text += f'c{k} = ((fmi2InstantiateTYPE *)dlsym(l, "fmi2Instantiate"))("{self.name}", fmi2CoSimulation, "{d.guid}", '
        text += f'"{resources}", &callbacks, 0, 0);\nif (!c{k}) return 1;\n'
        for name, value in self.parameters.items():
            kind = next(p.type for p in self.slave.ports if p.name == name)
            c_name, c_type = ("String", "fmi2String") if kind == "string" else _NAMES[kind]
            literal = f'"{value}"' if kind == "string" else float(value).hex() if kind == "real" else str(int(value))
            text += f"{{ fmi2ValueReference r = {self.references[name]}; {c_type} v = {literal}; "
            text += f'CHECK(((fmi2Set{c_name}TYPE *)dlsym(l, "fmi2Set{c_name}"))(c{k}, &r, 1, &v)); }}\n'
        text += f'CHECK(((fmi2SetupExperimentTYPE *)dlsym(l, "fmi2SetupExperiment"))(c{k}, 0, 0.0, 0.0, 0, 0.0));\n'
        text += f'CHECK(((fmi2EnterInitializationModeTYPE *)dlsym(l, "fmi2EnterInitializationMode"))(c{k})); }}\n'
        return text

    def leave(self) -> str:
        """Leave initialisation."""
        k, d = self.k, self.slave.description
        library = next((d.folder / "binaries").glob(f"linux64/{d.identifier}.so"))
        return (
            f'{{ void *l = dlopen("{library}", RTLD_NOW); '
            f'CHECK(((fmi2ExitInitializationModeTYPE *)dlsym(l, "fmi2ExitInitializationMode"))(c{k})); }}\n'
        )

    def move(self, way: str, places: str = "p") -> str:
        """Set all inputs from the bus, or get all outputs to it."""
        k, text = self.k, ""
        ports = inputs(self.slave.ports) if way == "Set" else outputs(self.slave.ports)
        for kind, positions in self.groups(ports):
            n = f"{way}{_NAMES[kind][0]}{k}"
            call = f"CHECK({n}(c{k}, {n}_r, {len(positions)}, {n}_b));\n"
            element = f"for (int i = 0; i < {len(positions)}; i++) "
            if way == "Set":
                text += f"{element}{n}_b[i] = bus[{n}_{places}[i]];\n{call}"
            else:
                text += f"{call}{element}bus[{n}_p[i]] = {n}_b[i];\n"
        return text


def generate(assembly: Assembly, record: bool, prefault: bool) -> str:
    """The C program: arguments STEPS; prints ns per step, wall clock and CPU, then all outputs as hexadecimal numbers.

    With `prefault` the memory of the rows is there before the clock starts; without, it is taken as it fills, as everybody else does.
    """
    s, wiring = assembly.system, assembly.wiring
    parts = [_Part(k, assembly, name) for k, name in enumerate(wiring.order)]
    n, h = wiring.n_outputs, float(s.step).hex()
    code = HEAD + _array("double", "bus", [float(v).hex() for v in wiring.start_values]) + "".join(p.declare() for p in parts)
    code += "int main(int argc, char **argv) {\nlong steps = atol(argv[1]); struct timespec a, b, p, q; double *rows = 0;\n"
    code += (
        "".join(p.load() for p in parts) + "".join(p.move("Set", "f") + p.move("Get") for p in parts) + "".join(p.leave() for p in parts)
    )
    if record:
        code += f"rows = calloc(steps * {n + 1}, 8);\n"
        code += f"for (long i = 0; i < steps * {n + 1}; i += 512) rows[i] = 0;\n" if prefault else ""
    code += "clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &p);\nclock_gettime(CLOCK_MONOTONIC, &a);\nfor (long k = 0; k < steps; k++) {\n"
    code += f"double t = (double)(k * {round(s.step * 1e9)}LL) / 1e9;\n"
    if wiring.any_delayed:
        code += f"for (int i = 0; i < {n}; i++) bus[{n} + i] = bus[i];\n"
    steps = [f"CHECK(step{p.k}(c{p.k}, t, {h}, 0));\n" for p in parts]
    if s.algorithm == "jacobi":
        code += "".join(p.move("Set") for p in parts) + "".join(steps) + "".join(p.move("Get") for p in parts)
    else:
        code += "".join(p.move("Set") + step + p.move("Get") for p, step in zip(parts, steps, strict=True))
    if record:
        code += f"rows[k * {n + 1}] = t + {h}; for (int i = 0; i < {n}; i++) rows[k * {n + 1} + 1 + i] = bus[i];\n"
    code += "}\nclock_gettime(CLOCK_MONOTONIC, &b);\nclock_gettime(CLOCK_PROCESS_CPUTIME_ID, &q);\n"
    code += 'printf("%.6f\\n", ((b.tv_sec - a.tv_sec) * 1e9 + (b.tv_nsec - a.tv_nsec)) / steps);\n'
    code += 'printf("%.6f\\n", ((q.tv_sec - p.tv_sec) * 1e9 + (q.tv_nsec - p.tv_nsec)) / steps);\n'
    return code + f'for (int i = 0; i < {n}; i++) printf("%a\\n", bus[i]);\nreturn 0;\n}}\n'


class SystemLoop:
    """The compiled program for an assembly, which must stay open: its FMUs are run where they were unpacked."""

    def __init__(self, assembly: Assembly, folder: Path, record: bool, prefault: bool) -> None:
        source, self.program = folder / f"system{record:d}.c", folder / f"system{record:d}"
        source.write_text(generate(assembly, record, prefault))
        subprocess.run([compiler(), "-O2", "-w", f"-I{HEADERS}", str(source), "-o", str(self.program), "-ldl"], check=True)
        self.final: Any = None

    def run(self, steps: int) -> tuple[float, float]:
        """Seconds of wall clock and of CPU for that many steps from t = 0; `final` are all outputs then."""
        lines = subprocess.run([str(self.program), str(steps)], check=True, capture_output=True, text=True).stdout.split()
        self.final = np.array([float.fromhex(x) for x in lines[2:]])
        return float(lines[0]) * 1e-9 * steps, float(lines[1]) * 1e-9 * steps
