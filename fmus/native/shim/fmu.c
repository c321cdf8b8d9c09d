/* The C side of a native FMU: FMI 2.0 and FMI 3.0 co-simulation around one record and two functions.
   Equal for all components; what differs is in component.h. Behaves as fmus/instance.py does. */
#include "component.h"
#include <float.h>
#include <math.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#include <wchar.h>
/* as in windows.h, which has a great many other names */
__declspec(dllimport) int __stdcall MultiByteToWideChar(unsigned, unsigned long, const char *, int, wchar_t *, int);
enum { CP_UTF8 = 65001 };
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

/* In a source-code FMU, names begin with that of the component (prefix.h). */
#ifndef FULL_NAME
#define FULL_NAME(NAME) NAME
#endif

enum { OK, WARNING, DISCARD, ERROR };  /* the same numbers in FMI 2.0 and 3.0 */

typedef void Logger2(void *environment, const char *instance, int status, const char *category, const char *format, ...);
typedef void Logger3(void *environment, int status, const char *category, const char *text);
typedef struct {
    Logger2 *logger;
    void *(*allocate)(size_t, size_t);
    void (*free)(void *);
    void (*step_finished)(void *, int);
    void *environment;
} Callbacks2;

typedef struct {
    char text[4096];
    size_t length;
} Text;

/* The rows of a table. They do not change; a record points to them. */
typedef struct {
    char *path;        /* "" = built in */
    double *owned;     /* NULL = built in */
    const double *rows;
    uint64_t count, hash;
} Rows;

typedef struct {
    Word *record;      /* with one word more, the time */
    char *name;
    Rows *tables;
    char *resources;   /* folder, with a separator at its end */
    char *carried;     /* "+NAME" for each table whose built-in rows stand in the resources instead of here: what follows TOKEN */
    bool stale;        /* init has to run before outputs are read */
    bool running;      /* the first step may come */
    bool failed;       /* a step failed: only a reset or a state helps */
    Text failure;
    Logger2 *logger2;
    Logger3 *logger3;
    void *environment;
} Instance;

/* A state is one block of memory without addresses: this head, the words before the tables, the hashes of the tables, their paths,
   the text of the failure. */
typedef struct {
    char token[64];
    uint64_t size;
    double time;
    uint8_t stale, running, failed, padding[5];
} State;

/* Text */

static void put(Text *t, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    int n = vsnprintf(t->text + t->length, sizeof t->text - t->length, format, arguments);
    va_end(arguments);
    size_t left = sizeof t->text - 1 - t->length;
    t->length += n < 0 ? 0 : (size_t)n < left ? (size_t)n : left;
}

/* A number as Python shows it: the shortest text that reads back as the same number. `digits`: not more than these. */
static void put_number(Text *t, double x, const char *format, int digits) {
    char text[512];
    if (isnan(x) || isinf(x)) {
        put(t, isnan(x) ? "nan" : x > 0 ? "inf" : "-inf");
        return;
    }
    if (*format)
        snprintf(text, sizeof text, format, x);
    else {
        int n = 0;
        do
            snprintf(text, sizeof text, "%.*e", n, x);
        while (strtod(text, NULL) != x && ++n < digits);
        int exponent = atoi(strchr(text, 'e') + 1);
        if (exponent >= -4 && exponent < 16)
            snprintf(text, sizeof text, "%.*f", n > exponent ? n - exponent : 1, x);
    }
    for (char *c = text; *c; c++)  /* the decimal comma of a locale */
        if (*c == ',')
            *c = '.';
    put(t, "%s", text);
}

static void put_word(Text *t, Word w, const Part *p, int digits) {
    if (p->kind == 'i')
        put(t, "%lld", (long long)w.integer);
    else
        put_number(t, p->kind == 'n' ? (double)w.integer : w.real, p->format, digits);
}

/* The model's message for a status, with the values of the record at this moment. */
static void put_message(Text *t, const Instance *I, int64_t status, double time) {
    if (status <= 0 || status >= MESSAGE_COUNT) {
        put(t, "status %lld without a message", (long long)status);
        return;
    }
    for (const Part *p = MESSAGES[status]; p->text; p++) {
        put(t, "%s", p->text);
        if (p->kind == 't')
            put_number(t, time, p->format, 17);
        else if (p->kind && !p->count)
            put_word(t, I->record[p->first], p, 17);
        else if (p->kind) {
            uint32_t count = p->count;
            while (p->kind == 'i' && count && !I->record[p->first + count - 1].integer)
                count--;
            put(t, "[");
            for (uint32_t i = 0; i < count; i++) {
                put(t, i ? " " : "");
                put_word(t, I->record[p->first + i], p, 8);
            }
            put(t, "]");
        }
    }
}

/* `q[1]`, `stiffness[3,1]` */
static void put_name(Text *t, const Variable *V, uint32_t word) {
    uint32_t left = V->count, at = word - V->first;
    put(t, "%s", V->name);
    for (int i = 0; i < 4 && V->shape[i]; i++) {
        left /= V->shape[i];
        put(t, "%s%u", i ? "," : "[", at / left % V->shape[i] + 1);
    }
    put(t, V->shape[0] ? "]" : "");
}

static int report(const Instance *I, const Text *t) {
    if (I->logger3)
        I->logger3(I->environment, ERROR, "logStatusError", t->text);
    if (I->logger2) {  /* the importer treats the text as a format */
        Text format = {.length = 0};
        for (const char *c = t->text; *c; c++)
            put(&format, *c == '%' ? "%%%%" : "%c", *c);
        I->logger2(I->environment, I->name, ERROR, "logStatusError", format.text);
    }
    return ERROR;
}

static Text begin(const Instance *I) {
    Text t = {.length = 0};
    put(&t, "%s: ", I->name);
    return t;
}

#define FAIL(I, ...) do { Text text_ = begin(I); put(&text_, __VA_ARGS__); return report(I, &text_); } while (0)
#define TRY(CALL) do { int status_ = (CALL); if (status_ > WARNING) return status_; } while (0)

/* Tables */

static FILE *open_file(const char *path) {
#ifdef _WIN32
    wchar_t wide[4096];
    return MultiByteToWideChar(CP_UTF8, 0, path, -1, wide, 4096) ? _wfopen(wide, L"rb") : NULL;
#else
    return fopen(path, "rb");
#endif
}

/* Number of rows and all bits of them, by which a state knows a table. FNV-1a over words, with a fold, as its product only moves bits up. */
static uint64_t hash_rows(const double *rows, uint64_t count, uint32_t columns) {
    uint64_t hash = 14695981039346656037u ^ count;
    for (uint64_t i = 0; i < count * columns; i++) {
        Word w = {.real = rows[i]};
        hash = (hash ^ (uint64_t)w.integer) * 1099511628211u;
        hash ^= hash >> 32;
    }
    return hash;
}

/* Reads a .npy file (NumPy format 1 to 3) of float64 rows in C order. NULL and `why` if it does not fit. */
static double *read_npy(FILE *file, const Table *T, uint64_t *count, Text *why) {
    unsigned char head[12];
    char header[1024];
    if (fread(head, 1, 10, file) != 10 || memcmp(head, "\x93NUMPY", 6) || head[6] < 1 || head[6] > 3)
        return put(why, "is not a .npy file"), NULL;
    size_t length = head[8] | (size_t)head[9] << 8;
    if (head[6] > 1) {
        if (fread(head + 10, 1, 2, file) != 2)
            return put(why, "ends within its header"), NULL;
        length |= (size_t)head[10] << 16 | (size_t)head[11] << 24;
    }
    if (length >= sizeof header || fread(header, 1, length, file) != length)
        return put(why, "has a header that is too long or incomplete"), NULL;
    header[length] = 0;
    if (!strstr(header, "'descr': '<f8'") || !strstr(header, "'fortran_order': False"))
        return put(why, "expected float64 numbers in C order (descr '<f8', fortran_order False), found %s", header), NULL;
    const char *shape = strstr(header, "'shape': (");
    char *end = NULL;
    unsigned long long rows = shape ? strtoull(shape + 10, &end, 10) : 0;
    unsigned long long columns = end && *end == ',' ? strtoull(end + 1, &end, 10) : 0;
    if (!end || *end != ')' || columns != T->columns) {
        int shown = shape && strchr(shape, ')') ? (int)(strchr(shape, ')') - shape) - 8 : 0;
        put(why, "has shape %.*s, expected rows of %u columns", shown, shown ? shape + 9 : "", T->columns);
        return NULL;
    }
    bool possible = rows < SIZE_MAX / sizeof(double) / T->columns;
    size_t n = possible ? (size_t)rows * T->columns : 0;
    double *values = possible ? malloc((n + 1) * sizeof(double)) : NULL;
    if (!values || fread(values, sizeof(double), n, file) != n)
        return put(why, values ? "ends before its last row" : "needs more memory than there is"), free(values), NULL;
    for (size_t i = 0; i < n; i++)
        if (!isfinite(values[i]))
            return put(why, "holds values that are not finite"), free(values), NULL;
    *count = rows;
    return values;
}

static void drop(Rows *rows) {
    free(rows->path);
    free(rows->owned);
    *rows = (Rows){.path = NULL};
}

static bool is_carried(const Instance *I, const Table *T) {
    size_t length = strlen(T->name);
    for (const char *at = I->carried; (at = strchr(at, '+')); )
        if (!strncmp(++at, T->name, length) && (at[length] == '+' || !at[length]))
            return true;
    return false;
}

/* The rows of a table in a file, or those built in: in the library, or in a file that the FMU carries. */
static int read_rows(const Instance *I, const Table *T, const char *path, Rows *found) {
    Text why = {.length = 0};
    char carried[4096];
    const char *named = path;
    if (!*path && is_carried(I, T)) {
        snprintf(carried, sizeof carried, "%stables/%s.npy", I->resources, T->name);
        path = carried;
    }
    FILE *file = *path ? open_file(path) : NULL;
    *found = (Rows){.path = malloc(strlen(path) + 1), .count = T->count};
    if (!found->path)
        put(&why, "needs more memory than there is");
    else if (*path && !file)
        put(&why, "the file does not exist or cannot be read");
    else if (file)
        found->owned = read_npy(file, T, &found->count, &why);
    if (file)
        fclose(file);
    if (why.length) {
        drop(found);
        FAIL(I, "table %s from '%s': %s", T->name, path, why.text);
    }
    strcpy(found->path, named);
    found->rows = found->owned ? found->owned : T->rows;
    found->hash = hash_rows(found->rows, found->count, T->columns);
    return OK;
}

/* Let the record point to these rows, which are the instance's from now on. */
static void take_rows(Instance *I, uint32_t index, Rows rows) {
    drop(&I->tables[index]);
    I->tables[index] = rows;
    I->record[TABLES[index].reference].integer = (int64_t)rows.count;
    I->record[TABLES[index].address].integer = (int64_t)(intptr_t)rows.rows;
}

static int load_table(Instance *I, uint32_t index, const char *path) {
    Rows rows;
    if (I->running)
        FAIL(I, "table %s is fixed: it can be set before the first step only", TABLES[index].name);
    TRY(read_rows(I, &TABLES[index], path, &rows));
    take_rows(I, index, rows);
    I->stale = true;
    return OK;
}

/* Running */

static double *time_of(const Instance *I) { return &I->record[WORDS].real; }

static int check_outputs(Instance *I, const char *when, double time) {
    const Word *w = &I->record[FIRST_REAL_OUTPUT];
    double sum = 0.0;
    for (uint32_t i = 0; i < REAL_OUTPUTS; i++)
        sum += 0.0 * w[i].real;
    if (sum == 0.0)
        return OK;
    uint32_t i = 0;
    while (isfinite(w[i].real))
        i++;
    I->failure = begin(I);
    put(&I->failure, "output ");
    put_name(&I->failure, &VARIABLES[OWNER[FIRST_REAL_OUTPUT + i]], FIRST_REAL_OUTPUT + i);
    put(&I->failure, " is ");
    put_number(&I->failure, w[i].real, "", 17);
    put(&I->failure, when, time);
    return report(I, &I->failure);
}

/* What follows from the result of a model function: OK, or an error with its text in I->failure. */
static int outcome(Instance *I, int32_t raised, int64_t status, double time, const char *doing, double t, double h) {
    if (!raised && !status)
        return OK;
    I->failure.length = 0;
    if (raised) {
        put(&I->failure, "%s: IndexError %s", I->name, doing[1] == 'd' ? "during initialisation" : "in the step from t = ");
        if (doing[1] != 'd') {
            put_number(&I->failure, t, "%.9g", 17);
            put(&I->failure, " s");
        }
        put(&I->failure, ": index is out of bounds");
        return report(I, &I->failure);
    }
    put(&I->failure, strcmp(I->name, MODEL_NAME) ? "%s (%s): " : "%s: ", I->name, MODEL_NAME);
    put_message(&I->failure, I, status, time);
    put(&I->failure, doing, t, h);
    return report(I, &I->failure);
}

static int initialise(Instance *I) {
    int64_t status = 0;
    void *exception = NULL;
    int32_t raised = model_init(&status, &exception, I->record);
    TRY(outcome(I, raised, status, 0.0, " (during initialisation)", 0.0, 0.0));
    TRY(check_outputs(I, " after initialisation", 0.0));
    I->stale = false;
    return OK;
}

static int exit_initialisation(Instance *I) {
    if (I->stale)
        TRY(initialise(I));
    I->running = true;
    return OK;
}

static int refuse_step(const Instance *I, double t, double h) {
    Text text = begin(I);
    put(&text, "step from t = ");
    put_number(&text, t, "", 17);
    put(&text, " s of h = ");
    put_number(&text, h, "", 17);
    put(&text, " s: expected a finite time and a positive step");
    return report(I, &text);
}

/* How far an importer that adds up steps can be from the time t that it means: see fmus/instance.py. */
static double rounding(double t) {
    double found = fabs(t) / DEFAULT_STEP * fabs(t) * 0.5 * DBL_EPSILON;
    return found < 0.5 * DEFAULT_STEP ? found : 0.5 * DEFAULT_STEP;
}

static int step(Instance *I, double t, double h) {
    if (!I->running)
        FAIL(I, "a step before the end of initialisation");
    if (I->failed)
        FAIL(I, "cannot go on after an error; reset it or restore a state. The error was: %s", I->failure.text);
    if (!(h > 0.0) || !isfinite(h) || !isfinite(t))
        return refuse_step(I, t, h);
    if (h <= rounding(t)) {
        *time_of(I) = t + h;
        return OK;
    }
    int64_t status = 0;
    void *exception = NULL;
    I->failed = true;
    int32_t raised = model_step(&status, &exception, I->record, t, h);
    TRY(outcome(I, raised, status, t, " (step from t = %.9g s, h = %.9g s)", t, h));
    TRY(check_outputs(I, " at t = %.9g s", t + h));
    *time_of(I) = t + h;
    I->failed = false;
    return OK;
}

static int reset(Instance *I) {
    memset(I->record, 0, (WORDS + 1) * sizeof(Word));
    memcpy(I->record, START, START_WORDS * sizeof(Word));
    I->running = I->failed = false;
    I->stale = true;
    for (uint32_t i = 0; i < TABLE_COUNT; i++)
        TRY(load_table(I, i, ""));
    return OK;
}

static void destroy(Instance *I) {
    if (!I)
        return;
    for (uint32_t i = 0; I->tables && i < TABLE_COUNT; i++)
        drop(&I->tables[i]);
    free(I->tables);
    free(I->resources);
    free(I->carried);
    free(I->record);
    free(I->name);
    free(I);
}

static int hexadecimal(char c) {
    return c >= '0' && c <= '9' ? c - '0' : c >= 'a' && c <= 'f' ? c - 'a' + 10 : c >= 'A' && c <= 'F' ? c - 'A' + 10 : -1;
}

/* The folder of a location: a URI (FMI 2.0: file:///a%20b, file://localhost/a, file:/a) or a path (FMI 3.0). Freed by the caller. */
static char *folder_of(const char *where) {
    bool uri = !strncmp(where, "file:", 5);
    if (uri) {
        where += 5;
        if (!strncmp(where, "//", 2))
            for (where += 2; *where && *where != '/'; where++)  /* a host */
                ;
        if (where[0] == '/' && where[1] && where[2] == ':')  /* /C:/ */
            where++;
    }
    char *folder = malloc(strlen(where) + 2), *to = folder;
    if (!folder)
        return NULL;
    for (; *where; where++) {
        int high = uri && *where == '%' ? hexadecimal(where[1]) : -1, low = high >= 0 ? hexadecimal(where[2]) : -1;
        *to++ = low >= 0 ? (char)(high * 16 + low) : *where;
        where += low >= 0 ? 2 : 0;
    }
    if (to > folder && to[-1] != '/' && to[-1] != '\\')
        *to++ = '/';
    *to = 0;
    return folder;
}

static Instance *create(const char *name, const char *token, const char *where, Logger2 *logger2, Logger3 *logger3, void *environment) {
    Instance nobody = {.name = (char *)(name && *name ? name : MODEL_NAME), .logger2 = logger2, .logger3 = logger3, .environment = environment};
    Text t = begin(&nobody);
    size_t length = strlen(TOKEN);
    if (!token || strncmp(token, TOKEN, length) || (token[length] && token[length] != '+')) {
        put(&t, "the instantiation token (GUID) is '%s', expected '%s': model description and library belong to different FMUs", token ? token : "", TOKEN);
        return report(&nobody, &t), NULL;
    }
    Instance *I = malloc(sizeof *I);
    if (I) {
        *I = nobody;
        I->record = malloc((WORDS + 1) * sizeof(Word));
        I->tables = calloc(TABLE_COUNT + 1, sizeof *I->tables);
        I->name = malloc(strlen(nobody.name) + 1);
        I->carried = malloc(strlen(token + length) + 1);
        I->resources = folder_of(where ? where : "");
        if (I->name)
            strcpy(I->name, nobody.name);
        if (I->carried)
            strcpy(I->carried, token + length);
        bool enough = I->record && I->tables && I->name && I->carried && I->resources;
        if (enough && reset(I) == OK)
            return I;
        destroy(I);
        if (enough)  /* it has said what is wrong */
            return NULL;
    }
    put(&t, "needs %u bytes of memory, which are not there", WORDS * (unsigned)sizeof(Word));
    return report(&nobody, &t), NULL;
}

/* Values */

static const char *const KINDS[] = {"a real", "an integer", "a boolean", "a string"};

static int no_variable(const Instance *I, uint32_t reference, const char *is, int found, int kind) {
    if (found < 0)
        FAIL(I, "value reference %u does not exist; expected %s", reference, KINDS[kind]);
    FAIL(I, "value reference %u is %s, %s; expected %s", reference, is, KINDS[found], KINDS[kind]);
}

/* The variable that a value reference belongs to; NULL after a report. `whole`: only that of its first element counts (FMI 3.0). */
static const Variable *find(const Instance *I, uint32_t reference, int kind, bool whole) {
    static const Variable time = {.name = "time", .unit = " s", .count = 1, .kind = REAL, .causality = OUTPUT};
    const Variable *V = reference < OWNED ? &VARIABLES[OWNER[reference]] : reference == WORDS ? &time : NULL;
    if (V && V->kind == kind && (!whole || V->first == reference || V == &time))
        return V;
    if (V && (V->kind != kind))
        no_variable(I, reference, V->name, V->kind, kind);
    else
        no_variable(I, reference, "", -1, kind);
    return NULL;
}

static int find_table(const Instance *I, uint32_t reference, uint32_t *index) {
    for (*index = 0; *index < TABLE_COUNT; ++*index)
        if (TABLES[*index].reference == reference)
            return OK;
    const Variable *V = reference < OWNED ? &VARIABLES[OWNER[reference]] : NULL;
    return no_variable(I, reference, V ? V->name : "", V ? V->kind : -1, STRING);
}

/* In FMI 3.0: one element of an array, for descriptions in which it is a variable of its own (fmus/native/fmi3.py has the same number). */
#define ELEMENT 0x40000000u

/* Outputs read during initialisation follow the inputs and parameters set so far. */
static int refresh(Instance *I, const uint32_t references[], size_t n) {
    if (I->stale && !I->running)
        for (size_t i = 0; i < n; i++)
            if ((references[i] & ~ELEMENT) < OWNED && VARIABLES[OWNER[references[i] & ~ELEMENT]].causality == OUTPUT)
                return initialise(I);
    return OK;
}

static int refuse(const Instance *I, const Variable *V, uint32_t word, Word value, const char *what, double bound) {
    static const char *const causalities[] = {"input", "output", "parameter"};
    Part shown = {.kind = V->kind == REAL ? 'r' : 'i', .format = ""};
    Text t = begin(I);
    put(&t, "%s ", causalities[V->causality]);
    put_name(&t, V, word);
    put(&t, " = ");
    put_word(&t, value, &shown, 17);
    put(&t, "%s", V->unit);
    put(&t, what, bound, V->unit);
    return report(I, &t);
}

static int set(Instance *I, const Variable *V, uint32_t word, Word value) {
    double number = V->kind == REAL ? value.real : (double)value.integer;
    if (V->causality != INPUT) {
        bool output = V->causality == OUTPUT;
        if (output || (I->running && V->fixed)) {
            Text t = begin(I);
            put(&t, output ? "" : "parameter ");
            put_name(&t, V, word);
            put(&t, output ? " is an output and cannot be set" : " is fixed: it can be set before the first step only");
            return report(I, &t);
        }
    }
    if (!isfinite(number))
        return refuse(I, V, word, value, " is not a finite number", 0.0);
    if (number < V->minimum)
        return refuse(I, V, word, value, " is below its minimum %.9g%s", V->minimum);
    if (number > V->maximum)
        return refuse(I, V, word, value, " is above its maximum %.9g%s", V->maximum);
    I->record[word] = value;
    I->stale = true;
    return OK;
}

static int get_strings(const Instance *I, const uint32_t references[], size_t n, const char *values[]) {
    for (size_t i = 0; i < n; i++) {
        uint32_t index;
        TRY(find_table(I, references[i], &index));
        values[i] = I->tables[index].path;
    }
    return OK;
}
static int set_strings(Instance *I, const uint32_t references[], size_t n, const char *const values[]) {
    for (size_t i = 0; i < n; i++) {
        uint32_t index;
        TRY(find_table(I, references[i], &index));
        TRY(load_table(I, index, values[i] ? values[i] : ""));
    }
    return OK;
}

/* State */

static int get_state(Instance *I, State **state) {
    uint64_t size = sizeof(State) + TABLES_AT * sizeof(Word) + I->failure.length + 1;
    for (uint32_t i = 0; i < TABLE_COUNT; i++)
        size += sizeof(uint64_t) + strlen(I->tables[i].path) + 1;
    if (!*state || (*state)->size != size) {
        State *larger = realloc(*state, size);
        if (!larger)
            FAIL(I, "a state needs %llu bytes of memory, which are not there", (unsigned long long)size);
        *state = larger;
    }
    State *S = *state;
    *S = (State){.size = size, .time = *time_of(I), .stale = I->stale, .running = I->running, .failed = I->failed};
    memcpy(S->token, TOKEN, strlen(TOKEN));
    char *at = memcpy(S + 1, I->record, TABLES_AT * sizeof(Word));
    at += TABLES_AT * sizeof(Word);
    for (uint32_t i = 0; i < TABLE_COUNT; at += sizeof(uint64_t), i++)
        memcpy(at, &I->tables[i].hash, sizeof(uint64_t));
    for (uint32_t i = 0; i < TABLE_COUNT; at += strlen(at) + 1, i++)
        strcpy(at, I->tables[i].path);
    memcpy(at, I->failure.text, I->failure.length + 1);
    return OK;
}

/* The rows that a state means: path NULL if they are those that the instance has. */
static int find_rows(const Instance *I, uint32_t index, uint64_t hash, const char *path, Rows *found) {
    *found = (Rows){.path = NULL};
    if (I->tables[index].hash == hash)
        return OK;
    TRY(read_rows(I, &TABLES[index], path, found));
    if (found->hash == hash)
        return OK;
    drop(found);
    if (*path)
        FAIL(I, "table %s: in '%s' there are other rows than when the state was saved; put those back", TABLES[index].name, path);
    FAIL(I, "table %s: built in are other rows than when the state was saved; put those back", TABLES[index].name);
}

static int set_state(Instance *I, const State *S) {
    if (!S)
        FAIL(I, "no state to restore");
    Rows *found = calloc(TABLE_COUNT + 1, sizeof *found);
    if (!found)
        FAIL(I, "out of memory");
    const char *hashes = (const char *)(S + 1) + TABLES_AT * sizeof(Word), *at = hashes + TABLE_COUNT * sizeof(uint64_t);
    int status = OK;
    for (uint32_t i = 0; i < TABLE_COUNT && status == OK; at += strlen(at) + 1, i++) {
        uint64_t hash;
        memcpy(&hash, hashes + i * sizeof hash, sizeof hash);
        status = find_rows(I, i, hash, at, &found[i]);
    }
    for (uint32_t i = 0; i < TABLE_COUNT; i++)
        if (status != OK)
            drop(&found[i]);
        else if (found[i].path)
            take_rows(I, i, found[i]);
    free(found);
    TRY(status);
    memcpy(I->record, S + 1, TABLES_AT * sizeof(Word));
    *time_of(I) = S->time;
    I->stale = S->stale;
    I->running = S->running;
    I->failed = S->failed;
    I->failure.length = 0;
    put(&I->failure, "%s", at);
    return OK;
}

static int free_state(State **state) {
    if (state) {
        free(*state);
        *state = NULL;
    }
    return OK;
}

static int serialise(const Instance *I, const State *S, void *bytes, size_t size) {
    if (!S || size < S->size)
        FAIL(I, "a buffer of %llu bytes is too small for a state", (unsigned long long)size);
    memcpy(bytes, S, S->size);
    return OK;
}

/* Whether the bytes are a state of this FMU, down to the last one. */
static bool sound(const char *bytes, uint64_t size) {
    State head = {.size = 0};
    memcpy(&head, bytes, size < sizeof head ? size : sizeof head);
    if (head.size < sizeof head + TABLES_AT * sizeof(Word) || head.size != size || strncmp(head.token, TOKEN, sizeof head.token))
        return false;
    uint64_t at = sizeof head + TABLES_AT * sizeof(Word) + TABLE_COUNT * sizeof(uint64_t);
    for (uint32_t i = 0; i <= TABLE_COUNT; i++) {
        const char *end = at < head.size ? memchr(bytes + at, 0, head.size - at) : NULL;
        if (!end)
            return false;
        at = (uint64_t)(end - bytes) + 1;
    }
    return at == head.size;
}

static int deserialise(const Instance *I, const void *bytes, size_t size, State **state) {
    if (!sound(bytes, size))
        FAIL(I, "the %llu bytes are not a state of this FMU (%s)", (unsigned long long)size, TOKEN);
    uint64_t used;
    memcpy(&used, (const char *)bytes + offsetof(State, size), sizeof used);
    State *S = malloc(used);
    if (!S)
        FAIL(I, "a state needs %llu bytes of memory, which are not there", (unsigned long long)used);
    *state = memcpy(S, bytes, used);
    return OK;
}

/* The FMI 2.0 face */

EXPORT const char *FULL_NAME(fmi2GetTypesPlatform)(void) { return "default"; }
EXPORT const char *FULL_NAME(fmi2GetVersion)(void) { return "2.0"; }

EXPORT Instance *FULL_NAME(fmi2Instantiate)(const char *name, int type, const char *guid, const char *where, const Callbacks2 *callbacks, int visible, int logging) {
    (void)visible, (void)logging;
    if (type != 1) {
        callbacks->logger(callbacks->environment, name, ERROR, "logStatusError", "%s: this FMU is for co-simulation", name);
        return NULL;
    }
    return create(name, guid, where, callbacks->logger, NULL, callbacks->environment);
}
EXPORT void FULL_NAME(fmi2FreeInstance)(Instance *I) { destroy(I); }
EXPORT int FULL_NAME(fmi2SetDebugLogging)(Instance *I, int on, size_t n, const char *const categories[]) {
    return (void)I, (void)on, (void)n, (void)categories, OK;  /* only errors are logged, and always */
}
EXPORT int FULL_NAME(fmi2SetupExperiment)(Instance *I, int defined, double tolerance, double start, int stop_defined, double stop) {
    (void)defined, (void)tolerance, (void)stop_defined, (void)stop;
    *time_of(I) = start;
    return OK;
}
EXPORT int FULL_NAME(fmi2EnterInitializationMode)(Instance *I) { return (void)I, OK; }
EXPORT int FULL_NAME(fmi2ExitInitializationMode)(Instance *I) { return exit_initialisation(I); }
EXPORT int FULL_NAME(fmi2Terminate)(Instance *I) { return (void)I, OK; }
EXPORT int FULL_NAME(fmi2Reset)(Instance *I) { return reset(I); }
EXPORT int FULL_NAME(fmi2DoStep)(Instance *I, double t, double h, int no_set_state) { return (void)no_set_state, step(I, t, h); }

#define ACCESS2(NAME, TYPE, KIND, FIELD, STORED) \
    EXPORT int FULL_NAME(fmi2Get##NAME)(Instance *I, const uint32_t references[], size_t n, TYPE values[]) { \
        TRY(refresh(I, references, n)); \
        for (size_t i = 0; i < n; i++) { \
            if (!find(I, references[i], KIND, false)) \
                return ERROR; \
            values[i] = (TYPE)I->record[references[i]].FIELD; \
        } \
        return OK; \
    } \
    EXPORT int FULL_NAME(fmi2Set##NAME)(Instance *I, const uint32_t references[], size_t n, const TYPE values[]) { \
        for (size_t i = 0; i < n; i++) { \
            const Variable *V = find(I, references[i], KIND, false); \
            if (!V) \
                return ERROR; \
            TYPE value = values[i]; \
            TRY(set(I, V, references[i], (Word){.FIELD = STORED})); \
        } \
        return OK; \
    }
ACCESS2(Real, double, REAL, real, value)
ACCESS2(Integer, int, INTEGER, integer, value)
ACCESS2(Boolean, int, BOOLEAN, integer, value != 0)

EXPORT int FULL_NAME(fmi2GetString)(Instance *I, const uint32_t references[], size_t n, const char *values[]) { return get_strings(I, references, n, values); }
EXPORT int FULL_NAME(fmi2SetString)(Instance *I, const uint32_t references[], size_t n, const char *const values[]) {
    return set_strings(I, references, n, values);
}

#define STATES(GET, SET, FREE, SIZE, SERIALISE, DESERIALISE) \
    EXPORT int FULL_NAME(GET)(Instance *I, State **state) { return get_state(I, state); } \
    EXPORT int FULL_NAME(SET)(Instance *I, const State *state) { return set_state(I, state); } \
    EXPORT int FULL_NAME(FREE)(Instance *I, State **state) { return (void)I, free_state(state); } \
    EXPORT int FULL_NAME(SIZE)(Instance *I, const State *state, size_t *size) { return (void)I, *size = (size_t)state->size, OK; } \
    EXPORT int FULL_NAME(SERIALISE)(Instance *I, const State *state, void *bytes, size_t size) { return serialise(I, state, bytes, size); } \
    EXPORT int FULL_NAME(DESERIALISE)(Instance *I, const void *bytes, size_t size, State **state) { return deserialise(I, bytes, size, state); }
STATES(fmi2GetFMUstate, fmi2SetFMUstate, fmi2FreeFMUstate, fmi2SerializedFMUstateSize, fmi2SerializeFMUstate, fmi2DeSerializeFMUstate)
STATES(fmi3GetFMUState, fmi3SetFMUState, fmi3FreeFMUState, fmi3SerializedFMUStateSize, fmi3SerializeFMUState, fmi3DeserializeFMUState)

/* Functions that must be there and that the model description says are not provided. Their further arguments are not looked at. */
#define MISSING(NAME) EXPORT int FULL_NAME(NAME)(Instance *I) { FAIL(I, #NAME " is not provided: no derivatives, events, clocks or asynchronous steps"); }
MISSING(fmi2GetDirectionalDerivative) MISSING(fmi2SetRealInputDerivatives) MISSING(fmi2GetRealOutputDerivatives) MISSING(fmi2CancelStep)
MISSING(fmi2GetStatus) MISSING(fmi2GetRealStatus) MISSING(fmi2GetIntegerStatus) MISSING(fmi2GetBooleanStatus) MISSING(fmi2GetStringStatus)

/* The FMI 3.0 face */

EXPORT const char *FULL_NAME(fmi3GetVersion)(void) { return "3.0"; }

EXPORT Instance *FULL_NAME(fmi3InstantiateCoSimulation)(
    const char *name, const char *token, const char *where, bool visible, bool logging, bool events, bool early_return,
    const uint32_t intermediate[], size_t n, void *environment, Logger3 *logger, void *update) {
    (void)visible, (void)logging, (void)events, (void)early_return, (void)intermediate, (void)n, (void)update;
    return create(name, token, where, NULL, logger, environment);
}
EXPORT Instance *FULL_NAME(fmi3InstantiateModelExchange)(void) { return NULL; }
EXPORT Instance *FULL_NAME(fmi3InstantiateScheduledExecution)(void) { return NULL; }
EXPORT void FULL_NAME(fmi3FreeInstance)(Instance *I) { destroy(I); }
EXPORT int FULL_NAME(fmi3SetDebugLogging)(Instance *I, bool on, size_t n, const char *const categories[]) {
    return (void)I, (void)on, (void)n, (void)categories, OK;
}
EXPORT int FULL_NAME(fmi3EnterInitializationMode)(Instance *I, bool defined, double tolerance, double start, bool stop_defined, double stop) {
    (void)defined, (void)tolerance, (void)stop_defined, (void)stop;
    *time_of(I) = start;
    return OK;
}
EXPORT int FULL_NAME(fmi3ExitInitializationMode)(Instance *I) { return exit_initialisation(I); }
EXPORT int FULL_NAME(fmi3Terminate)(Instance *I) { return (void)I, OK; }
EXPORT int FULL_NAME(fmi3Reset)(Instance *I) { return reset(I); }
EXPORT int FULL_NAME(fmi3DoStep)(Instance *I, double t, double h, bool no_set_state, bool *event, bool *terminate, bool *early, double *reached) {
    (void)no_set_state;
    *event = *terminate = *early = false;
    *reached = t;
    TRY(step(I, t, h));
    *reached = t + h;
    return OK;
}

static int wrong_count(const Instance *I, size_t found, size_t expected) {
    FAIL(I, "expected room for %llu values or more, found %llu", (unsigned long long)expected, (unsigned long long)found);
}

#define ACCESS3(NAME, TYPE, KIND, FIELD) \
    EXPORT int FULL_NAME(fmi3Get##NAME)(Instance *I, const uint32_t references[], size_t n, TYPE values[], size_t room) { \
        size_t at = 0; \
        TRY(refresh(I, references, n)); \
        for (size_t i = 0; i < n; i++) { \
            uint32_t word = references[i] & ~ELEMENT, element = references[i] & ELEMENT; \
            const Variable *V = find(I, word, KIND, !element); \
            if (!V) \
                return ERROR; \
            uint32_t count = element ? 1 : V->count; \
            if (count > room - at) \
                return wrong_count(I, room, at + count); \
            for (uint32_t k = 0; k < count; k++) \
                values[at++] = (TYPE)I->record[word + k].FIELD; \
        } \
        return at == room ? OK : wrong_count(I, room, at); \
    } \
    EXPORT int FULL_NAME(fmi3Set##NAME)(Instance *I, const uint32_t references[], size_t n, const TYPE values[], size_t room) { \
        size_t at = 0; \
        for (size_t i = 0; i < n; i++) { \
            uint32_t word = references[i] & ~ELEMENT, element = references[i] & ELEMENT; \
            const Variable *V = find(I, word, KIND, !element); \
            if (!V) \
                return ERROR; \
            uint32_t count = element ? 1 : V->count; \
            if (count > room - at) \
                return wrong_count(I, room, at + count); \
            for (uint32_t k = 0; k < count; k++) \
                TRY(set(I, V, word + k, (Word){.FIELD = values[at++]})); \
        } \
        return at == room ? OK : wrong_count(I, room, at); \
    }
ACCESS3(Float64, double, REAL, real)
ACCESS3(Int64, int64_t, INTEGER, integer)
ACCESS3(Boolean, bool, BOOLEAN, integer)

EXPORT int FULL_NAME(fmi3GetString)(Instance *I, const uint32_t references[], size_t n, const char *values[], size_t room) {
    return n == room ? get_strings(I, references, n, values) : wrong_count(I, room, n);
}
EXPORT int FULL_NAME(fmi3SetString)(Instance *I, const uint32_t references[], size_t n, const char *const values[], size_t room) {
    return n == room ? set_strings(I, references, n, values) : wrong_count(I, room, n);
}

#define NO_ACCESS(NAME) MISSING(fmi3Get##NAME) MISSING(fmi3Set##NAME)
NO_ACCESS(Float32) NO_ACCESS(Int8) NO_ACCESS(UInt8) NO_ACCESS(Int16) NO_ACCESS(UInt16) NO_ACCESS(Int32) NO_ACCESS(UInt32) NO_ACCESS(UInt64)
NO_ACCESS(Binary) NO_ACCESS(Clock) NO_ACCESS(IntervalDecimal) NO_ACCESS(IntervalFraction) NO_ACCESS(ShiftDecimal) NO_ACCESS(ShiftFraction)
MISSING(fmi3GetNumberOfVariableDependencies) MISSING(fmi3GetVariableDependencies) MISSING(fmi3GetDirectionalDerivative)
MISSING(fmi3GetAdjointDerivative) MISSING(fmi3GetOutputDerivatives) MISSING(fmi3EnterConfigurationMode) MISSING(fmi3ExitConfigurationMode)
MISSING(fmi3EnterEventMode) MISSING(fmi3EnterStepMode) MISSING(fmi3EvaluateDiscreteStates) MISSING(fmi3UpdateDiscreteStates)
MISSING(fmi3EnterContinuousTimeMode) MISSING(fmi3CompletedIntegratorStep) MISSING(fmi3SetTime) MISSING(fmi3SetContinuousStates)
MISSING(fmi3GetContinuousStates) MISSING(fmi3GetContinuousStateDerivatives) MISSING(fmi3GetNominalsOfContinuousStates)
MISSING(fmi3GetEventIndicators) MISSING(fmi3GetNumberOfEventIndicators) MISSING(fmi3GetNumberOfContinuousStates) MISSING(fmi3ActivateModelPartition)
