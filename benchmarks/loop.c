/* The plain C loop that masters are compared with: a ring of FMUs, Jacobi, one set, one step, one get per FMU.
   loop STEPS RECORD LIBRARY...   RECORD 1 keeps every row in memory that is there before the clock starts, RECORD 3 in memory that
   is taken as it fills, RECORD 2 writes them to rows.bin in the working folder, in pieces of 4096. Prints ns per step, wall clock
   and CPU, then all outputs as hexadecimal numbers. */
#include <dlfcn.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>
#include "fmi2Functions.h"

#ifndef N
#define N 12
#endif
#define MAX 256
#define PIECE 4096

static void logger(void *e, fmi2String i, fmi2Status s, fmi2String c, fmi2String m, ...) {}

int main(int argc, char **argv) {
    long steps = atol(argv[1]);
    int record = atoi(argv[2]), n = argc - 3;
    fmi2SetRealTYPE *set[MAX];
    fmi2GetRealTYPE *get[MAX];
    fmi2DoStepTYPE *step[MAX];
    fmi2Component c[MAX];
    fmi2ValueReference in[N], out[N];
    fmi2CallbackFunctions callbacks = {logger, calloc, free, NULL, NULL};
    long held = record == 2 ? PIECE : steps;
    size_t width = n * N + 1;
    double *y = calloc(n * N, sizeof *y), *rows = record ? malloc(sizeof *rows * held * width) : NULL, h = 0.004;
    int file = record == 2 ? open("rows.bin", O_CREAT | O_TRUNC | O_WRONLY, 0600) : -1;
    struct timespec a, b, p, q;
    if (record && record != 3) for (long i = 0; i < held * (long)width; i += 512) rows[i] = 0; /* takes every page */
    for (int i = 0; i < N; i++) in[i] = i, out[i] = N + i;
    for (int k = 0; k < n; k++) {
        void *library = dlopen(argv[3 + k], RTLD_NOW | RTLD_LOCAL);
        if (!library) { fprintf(stderr, "%s\n", dlerror()); return 1; }
        set[k] = (fmi2SetRealTYPE *)dlsym(library, "fmi2SetReal");
        get[k] = (fmi2GetRealTYPE *)dlsym(library, "fmi2GetReal");
        step[k] = (fmi2DoStepTYPE *)dlsym(library, "fmi2DoStep");
        c[k] = ((fmi2InstantiateTYPE *)dlsym(library, "fmi2Instantiate"))("x", fmi2CoSimulation, "ring", "", &callbacks, 0, 0);
        get[k](c[k], out, N, y + k * N);
    }
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &p);
    clock_gettime(CLOCK_MONOTONIC, &a);
    for (long s = 0; s < steps; s++) {
        for (int k = 0; k < n; k++) if (set[k](c[k], in, N, y + (k + n - 1) % n * N) > fmi2Warning) return 2;
        for (int k = 0; k < n; k++) if (step[k](c[k], s * h, h, 0) > fmi2Warning) return 2;
        for (int k = 0; k < n; k++) if (get[k](c[k], out, N, y + k * N) > fmi2Warning) return 2;
        if (record) {
            double *row = rows + s % held * width;
            row[0] = (s + 1) * h;
            for (int i = 0; i < n * N; i++) row[1 + i] = y[i];
            if (record == 2 && (s % PIECE == PIECE - 1 || s == steps - 1)) {
                size_t bytes = (s % PIECE + 1) * width * sizeof *rows;
                if (write(file, rows, bytes) != (ssize_t)bytes) return 3;
            }
        }
    }
    clock_gettime(CLOCK_MONOTONIC, &b);
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &q);
    printf("%.6f\n%.6f\n", ((b.tv_sec - a.tv_sec) * 1e9 + (b.tv_nsec - a.tv_nsec)) / steps,
           ((q.tv_sec - p.tv_sec) * 1e9 + (q.tv_nsec - p.tv_nsec)) / steps);
    for (int i = 0; i < n * N; i++) printf("%a\n", y[i]);
    return 0;
}
