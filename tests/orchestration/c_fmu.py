"""A small FMI 2.0 FMU in C, compiled here from the standard's headers: one that robomill did not make."""

from __future__ import annotations

import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import fmpy

SOURCE = r"""
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "fmi2Functions.h"

/* y' = gain u (explicit Euler), n = steps done + offset, on = (u > 0), twice = 2 u (feedthrough) */
typedef struct { fmi2Real u, y, gain; fmi2Integer n, offset; fmi2Boolean invert, on; } Values;
typedef struct { Values v; fmi2CallbackFunctions cb; char name[64]; int mode; } Model;

static void say(Model *m, fmi2Status s, const char *category, const char *text, double a, double b) {
    m->cb.logger(m->cb.componentEnvironment, m->name, s, category, text, a, b);
}
const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return "2.0"; }
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String names[]) { return fmi2OK; }
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String where,
                              const fmi2CallbackFunctions *cb, fmi2Boolean visible, fmi2Boolean logging) {
    Model *m;
    if (strcmp(guid, "c-fmu") != 0) {
        cb->logger(cb->componentEnvironment, name, fmi2Error, "logStatusError", "wrong guid %s", guid);
        return NULL;
    }
    m = calloc(1, sizeof *m);
    m->cb = *cb;
    strncpy(m->name, name, 63);
    m->v.gain = 1.0;
    return m;
}
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean td, fmi2Real tol, fmi2Real t0, fmi2Boolean sd, fmi2Real t1) {
    if (t0 < 0) { say(c, fmi2Error, "logStatusError", "start time %g is before %g", t0, 0.0); return fmi2Error; }
    return fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { ((Model *)c)->mode = 1; return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { ((Model *)c)->mode = 2; return fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Reset(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real x[]) {
    Model *m = c;
    for (size_t i = 0; i < n; i++) {
        if (vr[i] == 0) x[i] = m->v.u;
        else if (vr[i] == 1) x[i] = m->v.y;
        else if (vr[i] == 2) x[i] = m->v.gain;
        else if (vr[i] == 3) x[i] = 2 * m->v.u;
        else return fmi2Error;
    }
    return fmi2OK;
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real x[]) {
    Model *m = c;
    for (size_t i = 0; i < n; i++) {
        if (vr[i] == 0) m->v.u = x[i];
        else if (vr[i] == 2 && m->mode == 0) m->v.gain = x[i];
        else return fmi2Error;
    }
    return fmi2OK;
}
fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Integer x[]) {
    for (size_t i = 0; i < n; i++) x[i] = ((Model *)c)->v.n;
    return fmi2OK;
}
fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer x[]) {
    for (size_t i = 0; i < n; i++) ((Model *)c)->v.offset = x[i];
    return fmi2OK;
}
fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Boolean x[]) {
    for (size_t i = 0; i < n; i++) x[i] = ((Model *)c)->v.on;
    return fmi2OK;
}
fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Boolean x[]) {
    for (size_t i = 0; i < n; i++) ((Model *)c)->v.invert = x[i];
    return fmi2OK;
}
fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2String x[]) { return fmi2Error; }
fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String x[]) { return fmi2OK; }
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean nsp) {
    Model *m = c;
    if (m->mode != 2) { say(m, fmi2Error, "logStatusError", "step at %g outside step mode %g", t, m->mode); return fmi2Error; }
    if (m->v.u > 1000) { say(m, fmi2Fatal, "logStatusFatal", "melted at %g with u = %g", t, m->v.u); return fmi2Fatal; }
    if (m->v.u > 100) { say(m, fmi2Error, "logStatusError", "overload at t = %.3f: u = %g", t, m->v.u); return fmi2Error; }
    if (m->v.u > 50) say(m, fmi2Warning, "logStatusWarning", "high load at %g: %g", t, m->v.u);
    m->v.y += h * m->v.gain * m->v.u;
    m->v.n = m->v.n ? m->v.n + 1 : m->v.offset + 1;
    m->v.on = (m->v.u > 0) != m->v.invert;
    return m->v.u > 50 ? fmi2Warning : fmi2OK;
}
fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *s) {
    if (!*s) *s = malloc(sizeof(Values));
    memcpy(*s, &((Model *)c)->v, sizeof(Values));
    return fmi2OK;
}
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate s) { memcpy(&((Model *)c)->v, s, sizeof(Values)); return fmi2OK; }
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *s) { free(*s); *s = NULL; return fmi2OK; }
fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate s, size_t *n) { *n = sizeof(Values); return fmi2OK; }
fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate s, fmi2Byte b[], size_t n) { memcpy(b, s, n); return fmi2OK; }
fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte b[], size_t n, fmi2FMUstate *s) {
    if (!*s) *s = malloc(n);
    memcpy(*s, b, n);
    return fmi2OK;
}
fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference a[], size_t na, const fmi2ValueReference b[],
                                        size_t nb, const fmi2Real d[], fmi2Real e[]) { return fmi2Error; }
fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer o[],
                                       const fmi2Real x[]) { return fmi2Error; }
fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer o[],
                                        fmi2Real x[]) { return fmi2Error; }
fmi2Status fmi2CancelStep(fmi2Component c) { return fmi2Error; }
fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind k, fmi2Status *x) { return fmi2Discard; }
fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind k, fmi2Real *x) { return fmi2Discard; }
fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind k, fmi2Integer *x) { return fmi2Discard; }
fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind k, fmi2Boolean *x) { return fmi2Discard; }
fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind k, fmi2String *x) { return fmi2Discard; }
"""

DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="Euler" guid="c-fmu" generationTool="cc">
  <CoSimulation modelIdentifier="euler" canHandleVariableCommunicationStepSize="true"
                canGetAndSetFMUstate="true" canSerializeFMUstate="true"/>
  <UnitDefinitions><Unit name="m"><BaseUnit m="1"/></Unit><Unit name="1"><BaseUnit/></Unit></UnitDefinitions>
  <TypeDefinitions><SimpleType name="Length"><Real unit="m" min="-1e6" max="1e6"/></SimpleType></TypeDefinitions>
  <LogCategories><Category name="logStatusWarning"/><Category name="logStatusError"/><Category name="logStatusFatal"/></LogCategories>
  <ModelVariables>
    <ScalarVariable name="u" valueReference="0" causality="input" description="what is integrated">
      <Real start="0.5" unit="1"/></ScalarVariable>
    <ScalarVariable name="y" valueReference="1" causality="output"><Real declaredType="Length"/></ScalarVariable>
    <ScalarVariable name="n" valueReference="0" causality="output" variability="discrete"><Integer/></ScalarVariable>
    <ScalarVariable name="on" valueReference="0" causality="output" variability="discrete"><Boolean/></ScalarVariable>
    <ScalarVariable name="twice" valueReference="3" causality="output"><Real unit="1"/></ScalarVariable>
    <ScalarVariable name="offset" valueReference="0" causality="input" variability="discrete"><Integer start="0" min="-5"/></ScalarVariable>
    <ScalarVariable name="invert" valueReference="0" causality="input" variability="discrete"><Boolean start="false"/></ScalarVariable>
    <ScalarVariable name="gain" valueReference="2" causality="parameter" variability="fixed"><Real start="1" min="0"/></ScalarVariable>
    <ScalarVariable name="label" valueReference="0" causality="parameter" variability="fixed"><String start="none"/></ScalarVariable>
    <ScalarVariable name="hidden" valueReference="1" causality="local"><Real/></ScalarVariable>
  </ModelVariables>
  <ModelStructure>
    <Outputs>
      <Unknown index="2" dependencies=""/><Unknown index="3"/><Unknown index="4" dependencies="1 7"/><Unknown index="5" dependencies="1"/>
    </Outputs>
    <InitialUnknowns><Unknown index="2"/><Unknown index="3"/><Unknown index="4"/><Unknown index="5"/></InitialUnknowns>
  </ModelStructure>
</fmiModelDescription>
"""

SUFFIX = {"linux": ".so", "darwin": ".dylib"}.get(sys.platform, ".dll")


def compiler() -> str | None:
    """The C compiler of this machine, if there is one."""
    return shutil.which("cc") or shutil.which("gcc")


def build(folder: Path, source: str = SOURCE, description: str = DESCRIPTION) -> Path:
    """Compile and pack `euler.fmu` in `folder`."""
    headers = Path(fmpy.__file__).parent / "c-code"
    (folder / "euler.c").write_text(source)
    library = folder / f"euler{SUFFIX}"
    command = [str(compiler()), "-shared", "-fPIC", "-O1", "-w", f"-I{headers}", str(folder / "euler.c"), "-o", str(library)]
    subprocess.run(command, check=True)
    return pack(folder / "euler.fmu", description, {f"binaries/{fmpy.platform}/euler{SUFFIX}": library.read_bytes()})


def pack(file: Path, description: str | None, files: dict[str, bytes] | None = None) -> Path:
    """Make an archive with a model description and other files."""
    with zipfile.ZipFile(file, "w") as z:
        if description is not None:
            z.writestr("modelDescription.xml", description)
        for name, data in (files or {}).items():
            z.writestr(name, data)
    return file
