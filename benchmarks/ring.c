/* A generic FMI 2.0 co-simulation FMU with N inputs and N outputs: y[i]' = 2 (u[i + 1] - y[i]), explicit Euler. As fast as an FMU can be. */
#include <stdlib.h>
#include <string.h>
#include "fmi2Functions.h"

#ifndef N
#define N 12
#endif

/* value references: 0 .. N-1 inputs, N .. 2N-1 outputs */
typedef struct { fmi2Real r[2 * N]; } Model;

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return "2.0"; }
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String names[]) { return fmi2OK; }
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String where,
                              const fmi2CallbackFunctions *cb, fmi2Boolean visible, fmi2Boolean logging) {
    Model *m = calloc(1, sizeof *m);
    for (int i = 0; i < N; i++) m->r[N + i] = i + 1;
    return m;
}
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean td, fmi2Real tol, fmi2Real t0, fmi2Boolean sd, fmi2Real t1) { return fmi2OK; }
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Reset(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real x[]) {
    const Model *m = c;
    for (size_t i = 0; i < n; i++) {
        if (vr[i] >= 2 * N) return fmi2Error;
        x[i] = m->r[vr[i]];
    }
    return fmi2OK;
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real x[]) {
    Model *m = c;
    for (size_t i = 0; i < n; i++) {
        if (vr[i] >= N) return fmi2Error;
        m->r[vr[i]] = x[i];
    }
    return fmi2OK;
}
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean nsp) {
    Model *m = c;
    for (int i = 0; i < N; i++) m->r[N + i] += 2.0 * h * (m->r[(i + 1) % N] - m->r[N + i]);
    return fmi2OK;
}
#define REFUSED(name, ...) fmi2Status name(fmi2Component c, __VA_ARGS__) { return fmi2Error; }
#define VRS const fmi2ValueReference vr[], size_t n
REFUSED(fmi2GetInteger, VRS, fmi2Integer x[])
REFUSED(fmi2SetInteger, VRS, const fmi2Integer x[])
REFUSED(fmi2GetBoolean, VRS, fmi2Boolean x[])
REFUSED(fmi2SetBoolean, VRS, const fmi2Boolean x[])
REFUSED(fmi2GetString, VRS, fmi2String x[])
REFUSED(fmi2SetString, VRS, const fmi2String x[])
REFUSED(fmi2GetFMUstate, fmi2FMUstate *s)
REFUSED(fmi2SetFMUstate, fmi2FMUstate s)
REFUSED(fmi2FreeFMUstate, fmi2FMUstate *s)
REFUSED(fmi2SerializedFMUstateSize, fmi2FMUstate s, size_t *n)
REFUSED(fmi2SerializeFMUstate, fmi2FMUstate s, fmi2Byte b[], size_t n)
REFUSED(fmi2DeSerializeFMUstate, const fmi2Byte b[], size_t n, fmi2FMUstate *s)
REFUSED(fmi2GetDirectionalDerivative, const fmi2ValueReference a[], size_t na, const fmi2ValueReference b[], size_t nb,
        const fmi2Real d[], fmi2Real e[])
REFUSED(fmi2SetRealInputDerivatives, VRS, const fmi2Integer o[], const fmi2Real x[])
REFUSED(fmi2GetRealOutputDerivatives, VRS, const fmi2Integer o[], fmi2Real x[])
fmi2Status fmi2CancelStep(fmi2Component c) { return fmi2Error; }
REFUSED(fmi2GetStatus, const fmi2StatusKind k, fmi2Status *x)
REFUSED(fmi2GetRealStatus, const fmi2StatusKind k, fmi2Real *x)
REFUSED(fmi2GetIntegerStatus, const fmi2StatusKind k, fmi2Integer *x)
REFUSED(fmi2GetBooleanStatus, const fmi2StatusKind k, fmi2Boolean *x)
REFUSED(fmi2GetStringStatus, const fmi2StatusKind k, fmi2String *x)
