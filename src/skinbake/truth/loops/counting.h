/* Counts and means of errors, and their weights in bins (twin: by_numpy.count_errors). */

#pragma once

#include "arguments.h"

/* Of the bins, the same numbers as in values.py. */
enum { BIN_SHIFT = 16, FIRST_BIN = (127 - 32) << (23 - BIN_SHIFT) };

enum { ERRORS, WEIGHTS, COUNTED, BINS, COUNT_ARRAYS };

static const Requirement count_arrays[COUNT_ARRAYS] = {
    [ERRORS] = {"errors", "f", "BP", READ},
    [WEIGHTS] = {"weights", "d", "B", READ},
    [COUNTED] = {"valid", "?", "BP", OR_NONE},
    [BINS] = {"bins", "d", "N", WRITTEN},
};

typedef struct {
    const float *errors;
    const double *weights;
    const char *valid;
    double *bins;
    Py_ssize_t block, poses, size;
} Counting;

typedef struct {
    Py_ssize_t samples, undefined, pose, vertex;
    double weight, sum;
    float largest;
} Counted;

/* Add a weight to the bin of an error: its upper bits, so that bins of one exponent are of equal width. */
static ALWAYS_INLINE void add_to_bin(const Counting *c, float error, double weight)
{
    uint32_t bits;
    memcpy(&bits, &error, sizeof bits);
    const Py_ssize_t bin = (Py_ssize_t)((bits & INT32_MAX) >> BIN_SHIFT) - FIRST_BIN;
    c->bins[bin < 0 ? 0 : bin < c->size ? bin : c->size - 1] += weight;
}

/* Count one error of a vertex. NaN: the measured normal does not exist, which is as bad as can be. */
static ALWAYS_INLINE void count_one(const Counting *c, Counted *n, float error, Py_ssize_t row, Py_ssize_t pose,
                                    double *sum)
{
    const int undefined = error != error;
    const float value = undefined ? 180.0f : error;
    n->undefined += undefined;
    *sum += value;
    /* Of equal errors the one in the earliest pose counts as the largest. */
    if (value > n->largest || (value == n->largest && pose < n->pose))
        n->largest = value, n->pose = pose, n->vertex = row;
    add_to_bin(c, value, c->weights[row]);
}

/* Note the largest error of a row, if it is the largest of all, or as large at an earlier pose. */
static ALWAYS_INLINE void note_largest(const Counting *c, Counted *n, const float *errors, float largest,
                                       Py_ssize_t row)
{
    Py_ssize_t pose = 0;
    while (pose < c->poses - 1 && errors[pose] != largest)
        pose++;
    if (largest > n->largest || pose < n->pose)
        n->largest = largest, n->pose = pose, n->vertex = row;
}

enum { LANES = 8 };

/* Return the sum of a row, NaN if any error is NaN, and find the largest error: in lanes, as vectors do. */
static ALWAYS_INLINE double sum_row(const float *errors, Py_ssize_t poses, float *largest)
{
    double sums[LANES] = {0};
    float most[LANES];
    Py_ssize_t p = 0;
    for (int lane = 0; lane < LANES; lane++)
        most[lane] = -1.0f;
    /* Whole groups of lanes. */
    for (; p + LANES <= poses; p += LANES)
        for (int lane = 0; lane < LANES; lane++) {
            sums[lane] += errors[p + lane];
            most[lane] = errors[p + lane] > most[lane] ? errors[p + lane] : most[lane];
        }
    /* What is left goes into the first lane. */
    for (; p < poses; p++) {
        sums[0] += errors[p];
        most[0] = errors[p] > most[0] ? errors[p] : most[0];
    }
    /* The lanes are added in a fixed order, which is the same on every processor. */
    double total = 0.0;
    for (int lane = 0; lane < LANES; lane++) {
        total += sums[lane];
        *largest = most[lane] > *largest ? most[lane] : *largest;
    }
    return total;
}

FOR_PROCESSORS(Counted, count_rows, (const Counting *c), (c))
{
    Counted n = {.largest = -1.0f};
    for (Py_ssize_t row = 0; row < c->block; row++) {
        const double weight = c->weights[row];
        if (!(weight > 0.0))
            continue;
        /* The sum and the largest error, as if all errors counted. */
        const float *errors = c->errors + row * c->poses;
        const char *valid = c->valid ? c->valid + row * c->poses : NULL;
        float largest = -1.0f;
        double sum = sum_row(errors, c->poses, &largest);
        Py_ssize_t samples = c->poses;
        if (valid && memchr(valid, 0, (size_t)c->poses)) {
            /* Some errors of the row do not count. */
            samples = 0, sum = 0.0;
            for (Py_ssize_t p = 0; p < c->poses; p++)
                if (valid[p])
                    samples++, count_one(c, &n, errors[p], row, p, &sum);
        } else if (sum != sum) {
            sum = 0.0;
            for (Py_ssize_t p = 0; p < c->poses; p++)
                count_one(c, &n, errors[p], row, p, &sum);
        } else {
            /* The usual row: all errors count and are numbers. */
            for (Py_ssize_t p = 0; p < c->poses; p++)
                add_to_bin(c, errors[p], weight);
            if (c->poses > 0 && largest >= n.largest)
                note_largest(c, &n, errors, largest, row);
        }
        n.samples += samples;
        n.weight += weight * (double)samples;
        n.sum += weight * sum;
    }
    return n;
}

static PyObject *count_errors(PyObject *Py_UNUSED(module), PyObject *args)
{
    PyObject *o[COUNT_ARRAYS], *result = NULL;
    Array a[COUNT_ARRAYS];
    Py_ssize_t sizes[26];
    memset(a, 0, sizeof a);
    if (!PyArg_ParseTuple(args, "OOOO", &o[ERRORS], &o[WEIGHTS], &o[COUNTED], &o[BINS]) ||
        read_arrays(o, count_arrays, COUNT_ARRAYS, a, sizes) < 0)
        goto done;
    if (SIZE('N') < 1) {
        PyErr_SetString(PyExc_ValueError, "there is no bin");
        goto done;
    }
    const Counting work = {DATA(ERRORS), DATA(WEIGHTS), DATA(COUNTED), DATA(BINS),
                           SIZE('B'),    SIZE('P'),     SIZE('N')};
    Counted n;
    Py_BEGIN_ALLOW_THREADS
    n = count_rows(&work);
    Py_END_ALLOW_THREADS
    result = Py_BuildValue("nnddfnn", n.samples, n.undefined, n.weight, n.sum, n.largest, n.pose, n.vertex);
done:
    release_arrays(a, COUNT_ARRAYS);
    return result;
}
