/* Labels of equal rows (twin: by_numpy.label_equal_rows). */

#pragma once

#include "arrays.h"

static inline uint64_t mix(uint64_t state, uint64_t word)
{
    state = (state ^ word) * UINT64_C(0xBF58476D1CE4E5B9);
    return state ^ (state >> 29);
}

static inline uint64_t word_at(const void *row, char kind, Py_ssize_t column)
{
    switch (kind) {
    case 'f': {
        uint32_t word = ((const uint32_t *)row)[column];
        return word == UINT32_C(0x80000000) ? 0 : word; /* -0 is +0 */
    }
    case 'd': {
        uint64_t word = ((const uint64_t *)row)[column];
        return word == UINT64_C(0x8000000000000000) ? 0 : word;
    }
    case 'Q':
        return ((const uint64_t *)row)[column];
    default:
        return ((const uint32_t *)row)[column];
    }
}

static inline uint64_t hash_row(const char *row, char kind, Py_ssize_t columns)
{
    uint64_t state = UINT64_C(0x9E3779B97F4A7C15);
    for (Py_ssize_t column = 0; column < columns; column++)
        state = mix(state, word_at(row, kind, column));
    return state ^ (state >> 32);
}

static inline int equal_words(const char *a, const char *b, char kind, Py_ssize_t columns)
{
    for (Py_ssize_t column = 0; column < columns; column++)
        if (word_at(a, kind, column) != word_at(b, kind, column))
            return 0;
    return 1;
}

typedef struct {
    uint32_t tag; /* upper half of the hash: most comparisons end here */
    int32_t label;
} Slot;

/* Rows hashed ahead of their turn, while memory fetches their slots of the table. */
enum { AHEAD = 16 };

enum { PROBES_A_ROW = 64 };

/* Fill labels, and count them. If rows were made to have equal hashes, the time would grow with the square of
   their number. Then the loop ends. `first` keeps a row of each label. */
static Status label_rows(const Array *rows, int32_t *labels, Py_ssize_t *labelled)
{
    /* The table has at least twice as many places as rows. The hash says where to begin. */
    size_t size = 16;
    while (size < 2 * (size_t)rows->rows)
        size *= 2;
    size_t width = (size_t)rows->buffer.itemsize * (size_t)rows->columns;
    Slot *table = allocate_zeros(size, sizeof *table);
    int32_t *first = allocate_zeros((size_t)rows->rows + 1, sizeof *first);
    Status status = table && first ? DONE : NO_MEMORY;
    Py_ssize_t count = 0;
    uint64_t probes_left = (uint64_t)rows->rows * PROBES_A_ROW + 1024;
    if (status == DONE)
        memset(table, 0xFF, size * sizeof *table); /* label -1: empty */
    const char *data = rows->buffer.buf;
    uint64_t hashes[AHEAD] = {0};
    for (Py_ssize_t next = 0; status == DONE && next < rows->rows + AHEAD; next++) {
        Py_ssize_t row = next - AHEAD;
        uint64_t hash = hashes[next % AHEAD];
        /* Hash the row that comes AHEAD rows later, and fetch its place. */
        if (next < rows->rows) {
            hashes[next % AHEAD] = hash_row(data + (size_t)next * width, rows->kind, rows->columns);
            PREFETCH(&table[(size_t)hashes[next % AHEAD] & (size - 1)]);
        }
        if (row < 0)
            continue;
        /* Look from the row's place on for an equal row, or a free place. */
        const char *here = data + (size_t)row * width;
        uint32_t tag = (uint32_t)(hash >> 32);
        size_t at = (size_t)hash & (size - 1);
        for (;; at = (at + 1) & (size - 1)) {
            if (table[at].label < 0) {
                table[at] = (Slot){tag, (int32_t)count};
                first[count] = (int32_t)row;
                labels[row] = (int32_t)count++;
                break;
            }
            const char *there = data + (size_t)first[table[at].label] * width;
            if (table[at].tag == tag && equal_words(here, there, rows->kind, rows->columns)) {
                labels[row] = table[at].label;
                break;
            }
            if (probes_left-- == 0) {
                status = TOO_MANY_COLLISIONS;
                break;
            }
        }
    }
    free(table);
    free(first);
    *labelled = count;
    return status;
}

static PyObject *label_equal_rows(PyObject *Py_UNUSED(module), PyObject *args)
{
    enum { ROWS, LABELS, ARRAYS };
    static const Requirement required[ARRAYS] = {
        [ROWS] = {"rows", "fdiIQ", AXIS_V, AXIS_ANY, READ},
        [LABELS] = {"labels", "i", AXIS_V, AXIS_1, WRITTEN},
    };
    PyObject *objects[ARRAYS], *result = NULL;
    Array a[ARRAYS] = {{.held = 0}};
    if (!PyArg_ParseTuple(args, "OO", &objects[ROWS], &objects[LABELS]))
        return NULL;
    if (read_arrays(objects, required, ARRAYS, 0, a) < 0)
        goto done;
    if (a[ROWS].rows >= INT32_MAX) {
        PyErr_SetString(PyExc_ValueError, "too many rows");
        goto done;
    }
    Py_ssize_t count;
    Status status;
    Py_BEGIN_ALLOW_THREADS
    status = label_rows(&a[ROWS], a[LABELS].buffer.buf, &count);
    Py_END_ALLOW_THREADS
    if (status == DONE)
        result = PyLong_FromSsize_t(count);
    else
        raise_status(status);
done:
    release_arrays(a, ARRAYS);
    return result;
}
