/* What fmu.c knows about one component. The definitions are generated (data.c); the two functions come from the model. */
#include <stddef.h>
#include <stdint.h>

/* All data of an instance but the rows of its tables are one record, an array of words. A value reference is the number of a word in it. */
typedef union {
    double real;
    int64_t integer;
} Word;

enum { REAL, INTEGER, BOOLEAN, STRING };
enum { INPUT, OUTPUT, PARAMETER };

typedef struct {
    const char *name, *unit;  /* unit: "" or with a blank before it */
    uint32_t first, count;    /* words */
    uint32_t shape[4];        /* 0 ends it */
    uint8_t kind, causality, fixed;
    double minimum, maximum;  /* of parameters; infinite without a bound */
} Variable;

/* Rows that a file can replace. Its value reference is the word with their number; another word holds their address. */
typedef struct {
    const char *name;
    uint32_t reference, address, columns;
    const double *rows;       /* built in */
    uint32_t count;
} Table;

/* A piece of an error message: text, then a value of the record unless kind is 0. An array of them ends with text NULL. */
typedef struct {
    const char *text;
    char kind;                /* 'r' real, 'i' integer, 'n' integer shown as a real number, 't' time of the step */
    const char *format;       /* for printf; "" = shortest text that reads back as the same number */
    uint32_t first, count;    /* words; count 0 = one value, else an array */
} Part;

extern const char MODEL_NAME[], TOKEN[];
extern const double DEFAULT_STEP;            /* communication step that the model description names [s] */
extern const uint32_t WORDS, TABLES_AT;      /* words of the record, words before the tables */
extern const uint64_t START[];               /* the record at the start; the words after START_WORDS are zero */
extern const uint32_t START_WORDS;
extern const Variable VARIABLES[];
extern const uint16_t OWNER[];               /* word -> index in VARIABLES */
extern const uint32_t OWNED;                 /* words that belong to a variable */
extern const uint32_t FIRST_REAL_OUTPUT, REAL_OUTPUTS;
extern const Table TABLES[];
extern const uint32_t TABLE_COUNT;
extern const Part *const MESSAGES[];         /* status -> message */
extern const int64_t MESSAGE_COUNT;

/* The model, as Numba calls functions: zero, or not zero if an exception was raised; the status goes to the first argument. */
int32_t model_init(int64_t *status, void **exception, Word *record);
int32_t model_step(int64_t *status, void **exception, Word *record, double t, double h);
