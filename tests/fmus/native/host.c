/* A C program without Python that runs one FMU: host LIBRARY 2|3 TOKEN NAME, commands on standard input.

   R first n v...   set reals (bits as hexadecimal numbers)     I first n v...  integers     B first n v...  booleans
   S reference path   E  enter initialisation   X  leave it   D t h  step (bits)   O first n  print reals   N first n  print integers */
#include <inttypes.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#include <windows.h>
#define OPEN(FILE) ((void *)LoadLibraryA(FILE))
#define FIND(L, NAME) ((void *)GetProcAddress((HMODULE)(L), NAME))
#else
#include <dlfcn.h>
#define OPEN(FILE) dlopen(FILE, RTLD_NOW | RTLD_LOCAL)
#define FIND(L, NAME) dlsym(L, NAME)
#endif

static void log2_(void *e, const char *instance, int status, const char *category, const char *format, ...) {
    (void)e;
    va_list arguments;
    va_start(arguments, format);
    fprintf(stderr, "%s %d %s: ", instance, status, category);
    vfprintf(stderr, format, arguments);
    fprintf(stderr, "\n");
    va_end(arguments);
}
static void log3(void *e, int status, const char *category, const char *text) {
    (void)e;
    fprintf(stderr, "%d %s: %s\n", status, category, text);
}

static void *library;
static int version;
static void *find(const char *name) {
    char full[100];
    snprintf(full, sizeof full, "fmi%d%s", version, name);
    void *f = FIND(library, full);
    if (!f) {
        fprintf(stderr, "no %s\n", full);
        exit(2);
    }
    return f;
}
static void check(int status, const char *what) {
    if (status > 1) {
        fprintf(stderr, "%s returned %d\n", what, status);
        exit(1);
    }
}
static double bits(void) {
    uint64_t u = 0;
    double d;
    if (scanf("%" SCNx64, &u) != 1)
        exit(2);
    memcpy(&d, &u, 8);
    return d;
}

typedef int Access2(void *, const uint32_t *, size_t, void *);
typedef int Access3(void *, const uint32_t *, size_t, void *, size_t);

/* FMI 2.0: n references; FMI 3.0: one reference, n values. */
static void pass(void *c, const char *name, uint32_t first, size_t n, void *values) {
    uint32_t references[4096];
    for (size_t i = 0; i < n; i++)
        references[i] = first + (uint32_t)i;
    check(version == 2 ? ((Access2 *)find(name))(c, references, n, values) : ((Access3 *)find(name))(c, references, 1, values, n), name);
}

int main(int argc, char **argv) {
    static double reals[4096];
    static int64_t longs[4096];
    static int ints[4096];
    static bool bools[4096];
    if (argc != 5 || !(library = OPEN(argv[1]))) {
        fprintf(stderr, "cannot load %s\n", argc > 1 ? argv[1] : "");
        return 2;
    }
    version = atoi(argv[2]);
    struct { void *log, *allocate, *free, *finished, *environment; } callbacks = {log2_, calloc, free, NULL, NULL};
    void *c = version == 2
        ? ((void *(*)(const char *, int, const char *, const char *, void *, int, int))find("Instantiate"))(argv[4], 1, argv[3], "", &callbacks, 0, 0)
        : ((void *(*)(const char *, const char *, const char *, bool, bool, bool, bool, void *, size_t, void *, void *, void *))find(
              "InstantiateCoSimulation"))(argv[4], argv[3], "", 0, 0, 0, 0, NULL, 0, NULL, log3, NULL);
    if (!c)
        return 1;
    char command;
    while (scanf(" %c", &command) == 1) {
        uint32_t first = 0;
        size_t n = 0;
        if (strchr("RIBON", command) && scanf("%" SCNu32 " %zu", &first, &n) != 2)
            return 2;
        if (command == 'R') {
            for (size_t i = 0; i < n; i++)
                reals[i] = bits();
            pass(c, version == 2 ? "SetReal" : "SetFloat64", first, n, reals);
        } else if (command == 'I' || command == 'B') {
            for (size_t i = 0; i < n; i++) {
                if (scanf("%" SCNd64, &longs[i]) != 1)
                    return 2;
                ints[i] = (int)longs[i];
                bools[i] = longs[i] != 0;
            }
            if (command == 'I')
                pass(c, version == 2 ? "SetInteger" : "SetInt64", first, n, version == 2 ? (void *)ints : (void *)longs);
            else
                pass(c, "SetBoolean", first, n, version == 2 ? (void *)ints : (void *)bools);
        } else if (command == 'S') {
            char path[4096];
            const char *text = path;
            if (scanf("%" SCNu32 " %4095s", &first, path) != 2)
                return 2;
            pass(c, "SetString", first, 1, &text);
        } else if (command == 'E') {
            if (version == 2)
                check(((int (*)(void *, int, double, double, int, double))find("SetupExperiment"))(c, 0, 0, 0, 0, 0), "SetupExperiment");
            check(version == 2 ? ((int (*)(void *))find("EnterInitializationMode"))(c)
                               : ((int (*)(void *, bool, double, double, bool, double))find("EnterInitializationMode"))(c, 0, 0, 0, 0, 0),
                  "EnterInitializationMode");
        } else if (command == 'X')
            check(((int (*)(void *))find("ExitInitializationMode"))(c), "ExitInitializationMode");
        else if (command == 'D') {
            double t = bits(), h = bits(), reached;
            bool event, terminate, early;
            check(version == 2 ? ((int (*)(void *, double, double, int))find("DoStep"))(c, t, h, 1)
                               : ((int (*)(void *, double, double, bool, bool *, bool *, bool *, double *))find("DoStep"))(
                                     c, t, h, 1, &event, &terminate, &early, &reached),
                  "DoStep");
        } else if (command == 'O') {
            pass(c, version == 2 ? "GetReal" : "GetFloat64", first, n, reals);
            for (size_t i = 0; i < n; i++) {
                uint64_t u;
                memcpy(&u, &reals[i], 8);
                printf("%016" PRIx64 "\n", u);
            }
        } else if (command == 'N') {
            pass(c, version == 2 ? "GetInteger" : "GetInt64", first, n, version == 2 ? (void *)ints : (void *)longs);
            for (size_t i = 0; i < n; i++)
                printf("%" PRId64 "\n", version == 2 ? (int64_t)ints[i] : longs[i]);
        } else
            return 2;
    }
    ((int (*)(void *))find("Terminate"))(c);
    ((void (*)(void *))find("FreeInstance"))(c);
    return 0;
}
