/* Counts and means of errors, and the tail of them (twins: by_numpy.count_errors, by_numpy.keep_at_least,
   by_numpy.add_to_bins). */

#pragma once

#include "arguments.h"

enum { ERRORS, WEIGHTS, COUNTED, TAIL, TAIL_WEIGHTS, COUNT_ARRAYS };

static const Requirement count_arrays[COUNT_ARRAYS] = {
    [ERRORS] = {"errors", "f", "BP", READ},
    [WEIGHTS] = {"weights", "d", "B", READ},
    [COUNTED] = {"valid", "?", "BP", OR_NONE},
    [TAIL] = {"tail", "f", "N", WRITTEN},
    [TAIL_WEIGHTS] = {"tail_weights", "d", "N", WRITTEN},
};

typedef struct {
    const float *errors;
    const double *weights;
    const char *valid;
    float *tail;
    double *tail_weights;
    Py_ssize_t block, poses;
    float least; /* smaller errors cannot be in the tail */
} Counting;

typedef struct {
    Py_ssize_t samples, undefined, kept, pose, vertex;
    double weight, sum;
    float largest;
} Counted;

/* Count one error of a vertex. NaN: the measured normal does not exist, which is as bad as can be. */
static ALWAYS_INLINE void count_one(const Counting *c, Counted *n, float error, Py_ssize_t row, Py_ssize_t pose,
                                    double *sum)
{
    const int undefined = error != error;
    const float value = undefined ? 180.0f : error;
    n->undefined += undefined;
    *sum += value;
    if (value > n->largest || (value == n->largest && pose < n->pose))
        n->largest = value, n->pose = pose, n->vertex = row;
    if (value >= c->least) {
        c->tail[n->kept] = value;
        c->tail_weights[n->kept++] = c->weights[row];
    }
}

/* Keep the errors of a row that may be in the tail: without a branch, since one in twenty is. */
static ALWAYS_INLINE void keep_tail(const Counting *c, Counted *n, const float *errors, Py_ssize_t row)
{
    const double weight = c->weights[row];
    Py_ssize_t kept = n->kept;
    for (Py_ssize_t p = 0; p < c->poses; p++) {
        c->tail[kept] = errors[p];
        c->tail_weights[kept] = weight;
        kept += errors[p] >= c->least;
    }
    n->kept = kept;
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
    for (; p + LANES <= poses; p += LANES)
        for (int lane = 0; lane < LANES; lane++) {
            sums[lane] += errors[p + lane];
            most[lane] = errors[p + lane] > most[lane] ? errors[p + lane] : most[lane];
        }
    for (; p < poses; p++) {
        sums[0] += errors[p];
        most[0] = errors[p] > most[0] ? errors[p] : most[0];
    }
    double total = 0.0;
    for (int lane = 0; lane < LANES; lane++) {
        total += sums[lane];
        *largest = most[lane] > *largest ? most[lane] : *largest;
    }
    return total;
}

FOR_PROCESSORS
static Counted count_rows(const Counting *c)
{
    Counted n = {.largest = -1.0f};
    for (Py_ssize_t row = 0; row < c->block; row++) {
        const double weight = c->weights[row];
        if (!(weight > 0.0))
            continue;
        const float *errors = c->errors + row * c->poses;
        const char *valid = c->valid ? c->valid + row * c->poses : NULL;
        float largest = -1.0f;
        double sum = sum_row(errors, c->poses, &largest);
        Py_ssize_t samples = c->poses;
        if (valid && memchr(valid, 0, (size_t)c->poses)) {
            samples = 0, sum = 0.0;
            for (Py_ssize_t p = 0; p < c->poses; p++)
                if (valid[p])
                    samples++, count_one(c, &n, errors[p], row, p, &sum);
        } else if (sum != sum) {
            sum = 0.0;
            for (Py_ssize_t p = 0; p < c->poses; p++)
                count_one(c, &n, errors[p], row, p, &sum);
        } else {
            if (largest >= c->least)
                keep_tail(c, &n, errors, row);
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
    float least_kept;
    memset(a, 0, sizeof a);
    if (!PyArg_ParseTuple(args, "OOOOOf", &o[ERRORS], &o[WEIGHTS], &o[COUNTED], &o[TAIL], &o[TAIL_WEIGHTS], &least_kept))
        return NULL;
    if (read_arrays(o, count_arrays, COUNT_ARRAYS, a, sizes) < 0)
        goto done;
    if (SIZE('N') < SIZE('B') * SIZE('P')) {
        PyErr_SetString(PyExc_ValueError, "the tail has no room for all errors");
        goto done;
    }
    const Counting work = {DATA(ERRORS), DATA(WEIGHTS), DATA(COUNTED), DATA(TAIL), DATA(TAIL_WEIGHTS), SIZE('B'),
                           SIZE('P'),    least_kept};
    Counted n;
    Py_BEGIN_ALLOW_THREADS
    n = count_rows(&work);
    Py_END_ALLOW_THREADS
    result = Py_BuildValue("nnnddfnn", n.samples, n.undefined, n.kept, n.weight, n.sum, n.largest, n.pose, n.vertex);
done:
    release_arrays(a, COUNT_ARRAYS);
    return result;
}

enum { VALUES, VALUE_WEIGHTS, KEPT_ARRAYS, BINS = KEPT_ARRAYS, BINNED_ARRAYS };

static const Requirement kept_arrays[KEPT_ARRAYS] = {
    [VALUES] = {"values", "f", "N", WRITTEN},
    [VALUE_WEIGHTS] = {"weights", "d", "N", WRITTEN},
};

static const Requirement binned_arrays[BINNED_ARRAYS] = {
    [VALUES] = {"values", "f", "N", READ},
    [VALUE_WEIGHTS] = {"weights", "d", "N", READ},
    [BINS] = {"bins", "d", "M", WRITTEN},
};

static PyObject *keep_at_least(PyObject *Py_UNUSED(module), PyObject *args)
{
    PyObject *o[KEPT_ARRAYS], *result = NULL;
    Array a[KEPT_ARRAYS];
    Py_ssize_t sizes[26], kept = 0;
    double wanted;
    memset(a, 0, sizeof a);
    if (!PyArg_ParseTuple(args, "OOd", &o[VALUES], &o[VALUE_WEIGHTS], &wanted))
        return NULL;
    if (read_arrays(o, kept_arrays, KEPT_ARRAYS, a, sizes) < 0)
        goto done;
    float *values = DATA(VALUES);
    double *weights = DATA(VALUE_WEIGHTS);
    Py_BEGIN_ALLOW_THREADS
    for (Py_ssize_t n = 0; n < SIZE('N'); n++) {
        const float value = values[n];
        values[kept] = value, weights[kept] = weights[n];
        kept += value >= wanted;
    }
    Py_END_ALLOW_THREADS
    result = PyLong_FromSsize_t(kept);
done:
    release_arrays(a, KEPT_ARRAYS);
    return result;
}

/* Add each weight to the bin of its value. Return 1 for a value beyond the last bin. */
static int fill_bins(const float *values, const double *weights, Py_ssize_t count, double *bins, Py_ssize_t size,
                     int shift)
{
    for (Py_ssize_t n = 0; n < count; n++) {
        uint32_t bits;
        memcpy(&bits, &values[n], sizeof bits);
        const Py_ssize_t bin = (Py_ssize_t)((bits & INT32_MAX) >> shift);
        if (bin >= size)
            return 1;
        bins[bin] += weights[n];
    }
    return 0;
}

static PyObject *add_to_bins(PyObject *Py_UNUSED(module), PyObject *args)
{
    PyObject *o[BINNED_ARRAYS], *result = NULL;
    Array a[BINNED_ARRAYS];
    Py_ssize_t sizes[26];
    int shift;
    memset(a, 0, sizeof a);
    if (!PyArg_ParseTuple(args, "OOOi", &o[VALUES], &o[VALUE_WEIGHTS], &o[BINS], &shift))
        return NULL;
    if (read_arrays(o, binned_arrays, BINNED_ARRAYS, a, sizes) < 0)
        goto done;
    if (shift < 0 || shift > 31) {
        PyErr_SetString(PyExc_ValueError, "a float has 32 bits to shift");
        goto done;
    }
    const float *values = DATA(VALUES);
    const double *weights = DATA(VALUE_WEIGHTS);
    double *bins = DATA(BINS);
    int stray;
    Py_BEGIN_ALLOW_THREADS
    stray = fill_bins(values, weights, SIZE('N'), bins, SIZE('M'), shift);
    Py_END_ALLOW_THREADS
    result = none_unless(stray);
done:
    release_arrays(a, BINNED_ARRAYS);
    return result;
}
