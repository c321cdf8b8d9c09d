"""A small FMI 3.0 FMU in C with variables of every type, compiled here from the standard's headers: one that robomill did not make.

It exports only what it needs, and is strict: a call in a wrong state, or with a wrong number of values, is an error.
"""

from __future__ import annotations

import subprocess
from pathlib import Path

import fmpy

from tests.orchestration.c_fmu import SUFFIX, compiler, pack

SOURCE = r"""
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "fmi3Functions.h"

/* y[2,3] += h * gain * u; every other output is its input plus (not) a fixed parameter */
typedef struct {
    fmi3Float64 u[6], y[6], gain[6], limit;
    fmi3Float32 f32; fmi3Int8 i8; fmi3UInt8 u8; fmi3Int16 i16; fmi3UInt16 u16;
    fmi3Int32 i32[2]; fmi3UInt32 u32; fmi3Int64 i64; fmi3UInt64 u64; fmi3Boolean flag[3];
    char label[64]; fmi3Float64 time; int mode;
} Values;
typedef struct { Values v; fmi3InstanceEnvironment env; fmi3LogMessageCallback log; } Model;
enum { NEW, INIT, STEP };

static fmi3Status say(Model *m, fmi3Status s, const char *text) { m->log(m->env, s, s == fmi3Warning ? "logStatusWarning" : "logStatusError", text); return s; }
const char *fmi3GetVersion(void) { return "3.0"; }
fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
    fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference vr[], size_t n, fmi3InstanceEnvironment env, fmi3LogMessageCallback log,
    fmi3IntermediateUpdateCallback update) {
    if (strcmp(token, "c-fmu-3")) { log(env, fmi3Error, "logStatusError", "wrong token"); return NULL; }
    Model *m = calloc(1, sizeof *m);
    m->env = env, m->log = log, m->v.limit = 1e9;
    for (int i = 0; i < 6; i++) m->v.gain[i] = 1;
    return m;
}
void fmi3FreeInstance(fmi3Instance c) { free(c); }
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean td, fmi3Float64 tol, fmi3Float64 t0, fmi3Boolean sd, fmi3Float64 t1) {
    Model *m = c;
    if (m->v.mode != NEW || t0 < 0) return say(m, fmi3Error, "start time is negative");
    m->v.time = t0, m->v.mode = INIT;
    return fmi3OK;
}
fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { ((Model *)c)->v.mode = STEP; return fmi3OK; }
fmi3Status fmi3Terminate(fmi3Instance c) { return fmi3OK; }
fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean no, fmi3Boolean *event, fmi3Boolean *end, fmi3Boolean *early, fmi3Float64 *last) {
    Model *m = c;
    *event = *end = *early = false;
    *last = t + h;
    if (m->v.mode != STEP) return say(m, fmi3Error, "step outside step mode");
    if (m->v.u[0] > 1000) return say(m, fmi3Fatal, "100 % melted");
    if (m->v.u[0] > 100) { char text[99]; snprintf(text, 99, "overload at t = %.3f", t); return say(m, fmi3Error, text); }
    for (int i = 0; i < 6; i++) m->v.y[i] += h * m->v.gain[i] * m->v.u[i];
    m->v.time = t + h;
    *end = m->v.y[0] > m->v.limit;
    *early = m->v.y[0] < -m->v.limit;
    if (*early) *last = t;
    return m->v.u[0] > 50 ? say(m, fmi3Warning, "high load") : fmi3OK;
}
/* References: 1..19 inputs and what is set, 100 + the same for outputs */
#define ONE(R, P, N) if (vr[i] == R) { if (k + N > nv) return say(m, fmi3Error, "too few values"); for (int j = 0; j < N; j++) ACT(x[k++], (P)[j]); continue; }
#define ACCESS(NAME, TYPE, SETS, GETS) \
fmi3Status fmi3Set##NAME(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const TYPE x[], size_t nv) { \
    Model *m = c; size_t k = 0; \
    for (size_t i = 0; i < n; i++) { SETS return say(m, fmi3Error, "no such " #NAME " to set"); } \
    return k == nv ? fmi3OK : say(m, fmi3Error, "too many values"); } \
fmi3Status fmi3Get##NAME(fmi3Instance c, const fmi3ValueReference vr[], size_t n, TYPE x[], size_t nv) { \
    Model *m = c; size_t k = 0; \
    for (size_t i = 0; i < n; i++) { GETS return say(m, fmi3Error, "no such " #NAME " to get"); } \
    return k == nv ? fmi3OK : say(m, fmi3Error, "too many values"); }
#define PUT(R, P, N) if (vr[i] == R) { if (k + N > nv) return say(m, fmi3Error, "too few values"); for (int j = 0; j < N; j++) (P)[j] = x[k++]; continue; }
#define GIVE(R, P, N, PLUS) if (vr[i] == R) { if (k + N > nv) return say(m, fmi3Error, "too few values"); for (int j = 0; j < N; j++) x[k++] = (P)[j] PLUS; continue; }
#define FIXED(R, P, N) if (vr[i] == R && m->v.mode == NEW) { if (k + N > nv) return say(m, fmi3Error, "too few values"); for (int j = 0; j < N; j++) (P)[j] = x[k++]; continue; }
ACCESS(Float64, fmi3Float64, PUT(1, m->v.u, 6) FIXED(2, m->v.gain, 6) FIXED(3, &m->v.limit, 1), GIVE(101, m->v.y, 6,) GIVE(0, &m->v.time, 1,))
ACCESS(Float32, fmi3Float32, PUT(4, &m->v.f32, 1), GIVE(104, &m->v.f32, 1, * 2))
ACCESS(Int8, fmi3Int8, PUT(5, &m->v.i8, 1), GIVE(105, &m->v.i8, 1, + 1))
ACCESS(UInt8, fmi3UInt8, PUT(6, &m->v.u8, 1), GIVE(106, &m->v.u8, 1, + 1))
ACCESS(Int16, fmi3Int16, PUT(7, &m->v.i16, 1), GIVE(107, &m->v.i16, 1, + 1))
ACCESS(UInt16, fmi3UInt16, PUT(8, &m->v.u16, 1), GIVE(108, &m->v.u16, 1, + 1))
ACCESS(Int32, fmi3Int32, PUT(9, m->v.i32, 2), GIVE(109, m->v.i32, 2, + 1))
ACCESS(UInt32, fmi3UInt32, PUT(10, &m->v.u32, 1), GIVE(110, &m->v.u32, 1, + 1))
ACCESS(Int64, fmi3Int64, PUT(11, &m->v.i64, 1), GIVE(111, &m->v.i64, 1, + 1))
ACCESS(UInt64, fmi3UInt64, PUT(12, &m->v.u64, 1), GIVE(112, &m->v.u64, 1, + 1))
ACCESS(Boolean, fmi3Boolean, PUT(13, m->v.flag, 3), GIVE(113, m->v.flag, 3, == false))
fmi3Status fmi3SetString(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3String x[], size_t nv) {
    if (n != 1 || nv != 1 || vr[0] != 14) return say(c, fmi3Error, "no such String");
    strncpy(((Model *)c)->v.label, x[0], 63);
    return strcmp(x[0], "bad") ? fmi3OK : say(c, fmi3Error, "the label is bad");
}
fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *s) {
    if (!*s) *s = malloc(sizeof(Values));
    memcpy(*s, &((Model *)c)->v, sizeof(Values));
    return fmi3OK;
}
fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState s) { memcpy(&((Model *)c)->v, s, sizeof(Values)); return fmi3OK; }
fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *s) { free(*s); *s = NULL; return fmi3OK; }
fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState s, size_t *n) { *n = sizeof(Values); return fmi3OK; }
fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState s, fmi3Byte b[], size_t n) { memcpy(b, s, n); return fmi3OK; }
fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte b[], size_t n, fmi3FMUState *s) {
    if (!*s) *s = malloc(n);
    memcpy(*s, b, n);
    return fmi3OK;
}
"""  # noqa: E501

NARROW = {"Float32": 4, "Int8": 5, "UInt8": 6, "Int16": 7, "UInt16": 8, "UInt32": 10, "UInt64": 12}
"""Types that the compiled loop does not carry, and the value reference of the input of each."""
_NARROW = "".join(
    f"""
  <{kind} name="in_{kind}" valueReference="{reference}" causality="input" start="0"/>
  <{kind} name="out_{kind}" valueReference="{100 + reference}" causality="output"/>"""
    for kind, reference in NARROW.items()
)
_OUTPUTS = "".join(f'<Output valueReference="{100 + reference}"/>' for reference in NARROW.values())
PLAIN = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="Types" instantiationToken="c-fmu-3" generationTool="cc">
 <CoSimulation modelIdentifier="types" canHandleVariableCommunicationStepSize="true" canGetAndSetFMUState="true"
   canSerializeFMUState="true" hasEventMode="true"/>
 <UnitDefinitions><Unit name="N"><BaseUnit kg="1" m="1" s="-2"/></Unit></UnitDefinitions>
 <TypeDefinitions>
  <Float64Type name="Force" unit="N" max="2e6"/>
  <EnumerationType name="Choice"><Item name="a" value="1"/><Item name="b" value="2"/></EnumerationType>
 </TypeDefinitions>
 <LogCategories><Category name="logStatusWarning"/><Category name="logStatusError"/></LogCategories>
 <ModelVariables>
  <Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
  <UInt64 name="rows" valueReference="20" causality="structuralParameter" variability="fixed" start="2"/>
  <Float64 name="u" valueReference="1" causality="input" start="0.5" declaredType="Force" description="what is integrated">
   <Dimension valueReference="20"/><Dimension start="3"/></Float64>
  <Float64 name="y" valueReference="101" causality="output" unit="N"><Dimension valueReference="20"/><Dimension start="3"/></Float64>
  <Float64 name="gain" valueReference="2" causality="parameter" variability="fixed" start="1 1 1 1 1 1" min="0">
   <Dimension start="2"/><Dimension start="3"/></Float64>
  <Float64 name="limit" valueReference="3" causality="parameter" variability="fixed" start="1e9"/>
  <Int32 name="in_Int32" valueReference="9" causality="input" start="1 2"><Dimension start="2"/></Int32>
  <Int32 name="out_Int32" valueReference="109" causality="output"><Dimension start="2"/></Int32>
  <Int64 name="in_Int64" valueReference="11" causality="input" start="0"/>
  <Enumeration name="out_Int64" valueReference="111" causality="output" declaredType="Choice"/>
  <Boolean name="in_Boolean" valueReference="13" causality="input" start="true false true"><Dimension start="3"/></Boolean>
  <Boolean name="out_Boolean" valueReference="113" causality="output"><Dimension start="3"/></Boolean>
  <String name="label" valueReference="14" causality="parameter" variability="fixed"><Start value="none"/></String>
  <Binary name="blob" valueReference="15" causality="input"/>
 </ModelVariables>
 <ModelStructure>
  <Output valueReference="101" dependencies=""/><Output valueReference="109"/><Output valueReference="111"/>
  <Output valueReference="113" dependencies="13 1"/>
 </ModelStructure>
</fmiModelDescription>
"""
"""Types that the compiled loop carries."""
DESCRIPTION = PLAIN.replace(" </ModelVariables>", f"{_NARROW} </ModelVariables>").replace(
    " </ModelStructure>", f"{_OUTPUTS} </ModelStructure>"
)
"""All types."""


def build(folder: Path, description: str = DESCRIPTION, source: str = SOURCE) -> Path:
    """Compile and pack `types.fmu` in `folder`."""
    headers = Path(fmpy.__file__).parent / "c-code"
    (folder / "types.c").write_text(source)
    library = folder / f"types{SUFFIX}"
    subprocess.run(
        [str(compiler()), "-shared", "-fPIC", "-O1", "-w", f"-I{headers}", str(folder / "types.c"), "-o", str(library)], check=True
    )
    return pack(folder / "types.fmu", description, {f"binaries/{fmpy.platform_tuple}/types{SUFFIX}": library.read_bytes()})
