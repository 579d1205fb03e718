/* Counts and means of errors, and the tail of them (twins: by_numpy.count_errors, by_numpy.keep_at_least,
   by_numpy.add_to_bins). */

#pragma once

#include "arguments.h"

enum { ERRORS, WEIGHTS, COUNTED, TAIL, RUN_WEIGHTS, RUN_LENGTHS, COUNT_ARRAYS };

static const Requirement count_arrays[COUNT_ARRAYS] = {
    [ERRORS] = {"errors", "f", "BP", READ},
    [WEIGHTS] = {"weights", "d", "B", READ},
    [COUNTED] = {"valid", "?", "BP", OR_NONE},
    [TAIL] = {"tail", "f", "N", WRITTEN},
    [RUN_WEIGHTS] = {"run_weights", "d", "R", WRITTEN},
    [RUN_LENGTHS] = {"run_lengths", "i", "R", WRITTEN},
};

typedef struct {
    const float *errors;
    const double *weights;
    const char *valid;
    float *tail; /* the kept errors of a row are a run, with one weight */
    double *run_weights;
    int32_t *run_lengths;
    Py_ssize_t block, poses;
    float least; /* smaller errors cannot be in the tail */
} Counting;

typedef struct {
    Py_ssize_t samples, undefined, kept, runs, pose, vertex;
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
    /* Of equal errors the one in the earliest pose counts as the largest. */
    if (value > n->largest || (value == n->largest && pose < n->pose))
        n->largest = value, n->pose = pose, n->vertex = row;
    if (value >= c->least)
        c->tail[n->kept++] = value;
}

/* Copy the values of at least `least` to the front of `kept`, and return their number: without a branch, since
   few or most are. kept may be where the values are. */
static ALWAYS_INLINE Py_ssize_t keep_values(const float *values, Py_ssize_t count, float least, float *kept)
{
    Py_ssize_t number = 0;
    for (Py_ssize_t n = 0; n < count; n++) {
        const float value = values[n];
        kept[number] = value;
        number += value >= least;
    }
    return number;
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

FOR_PROCESSORS
static Counted count_rows(const Counting *c)
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
        Py_ssize_t samples = c->poses, first = n.kept;
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
            if (largest >= c->least)
                n.kept += keep_values(errors, c->poses, c->least, c->tail + first);
            if (c->poses > 0 && largest >= n.largest)
                note_largest(c, &n, errors, largest, row);
        }
        /* What the row has put into the tail is a run with the weight of its vertex. */
        if (n.kept > first) {
            c->run_weights[n.runs] = weight;
            c->run_lengths[n.runs++] = (int32_t)(n.kept - first);
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
    if (!PyArg_ParseTuple(args, "OOOOOOf", &o[ERRORS], &o[WEIGHTS], &o[COUNTED], &o[TAIL], &o[RUN_WEIGHTS],
                          &o[RUN_LENGTHS], &least_kept))
        return NULL;
    if (read_arrays(o, count_arrays, COUNT_ARRAYS, a, sizes) < 0)
        goto done;
    /* All errors may be in the tail. */
    if (SIZE('N') < SIZE('B') * SIZE('P') || SIZE('R') < SIZE('B') || SIZE('P') > INT32_MAX) {
        PyErr_SetString(PyExc_ValueError, "the tail has no room for all errors");
        goto done;
    }
    const Counting work = {DATA(ERRORS),      DATA(WEIGHTS), DATA(COUNTED), DATA(TAIL), DATA(RUN_WEIGHTS),
                           DATA(RUN_LENGTHS), SIZE('B'),     SIZE('P'),     least_kept};
    Counted n;
    Py_BEGIN_ALLOW_THREADS
    n = count_rows(&work);
    Py_END_ALLOW_THREADS
    result = Py_BuildValue("nnnnddfnn", n.samples, n.undefined, n.kept, n.runs, n.weight, n.sum, n.largest, n.pose,
                           n.vertex);
done:
    release_arrays(a, COUNT_ARRAYS);
    return result;
}

enum { VALUES, WEIGHT_OF_RUN, LENGTH_OF_RUN, KEPT, KEPT_WEIGHTS, KEPT_LENGTHS, KEPT_ARRAYS, BINS = KEPT,
       BINNED_ARRAYS };

static const Requirement kept_arrays[KEPT_ARRAYS] = {
    [VALUES] = {"values", "f", "N", READ},
    [WEIGHT_OF_RUN] = {"weights", "d", "R", READ},
    [LENGTH_OF_RUN] = {"lengths", "i", "R", READ},
    [KEPT] = {"kept", "f", "M", WRITTEN},
    [KEPT_WEIGHTS] = {"kept_weights", "d", "S", WRITTEN},
    [KEPT_LENGTHS] = {"kept_lengths", "i", "S", WRITTEN},
};

static const Requirement binned_arrays[BINNED_ARRAYS] = {
    [VALUES] = {"values", "f", "N", READ},
    [WEIGHT_OF_RUN] = {"weights", "d", "R", READ},
    [LENGTH_OF_RUN] = {"lengths", "i", "R", READ},
    [BINS] = {"bins", "d", "M", WRITTEN},
};

/* Values in runs of one weight. */
typedef struct {
    const float *values;
    const double *weights;
    const int32_t *lengths;
    Py_ssize_t count, runs;
} WeightedRuns;

/* Return the length of a run, −1 if there are not so many values from `first` on. */
static ALWAYS_INLINE Py_ssize_t length_of_run(const WeightedRuns *from, Py_ssize_t run, Py_ssize_t first)
{
    const Py_ssize_t length = from->lengths[run];
    return length >= 0 && length <= from->count - first ? length : -1;
}

/* What a loop over runs met: the runs are not those of the values, or a value lies beyond the last bin. */
typedef enum { ALL_WELL, OTHER_RUNS, STRAY_VALUE } Found;

/* Keep the values of at least `least`, and the runs that have any. Count both. */
static Found keep_runs(const WeightedRuns *from, float least, float *kept, double *weights, int32_t *lengths,
                       Py_ssize_t *number, Py_ssize_t *runs)
{
    Py_ssize_t first = 0;
    for (Py_ssize_t run = 0; run < from->runs; run++) {
        const Py_ssize_t length = length_of_run(from, run, first);
        if (length < 0)
            return OTHER_RUNS;
        /* A run without values that large is overwritten by the next one. */
        const double weight = from->weights[run];
        const Py_ssize_t own = keep_values(from->values + first, length, least, kept + *number);
        weights[*runs] = weight, lengths[*runs] = (int32_t)own;
        *runs += own > 0;
        first += length, *number += own;
    }
    return first == from->count ? ALL_WELL : OTHER_RUNS;
}

/* Add the weight of each value to the value's bin. */
static Found fill_bins(const WeightedRuns *from, double *bins, Py_ssize_t size, int shift)
{
    Py_ssize_t first = 0;
    for (Py_ssize_t run = 0; run < from->runs; run++) {
        const Py_ssize_t length = length_of_run(from, run, first);
        if (length < 0)
            return OTHER_RUNS;
        const double weight = from->weights[run];
        for (Py_ssize_t n = first; n < first + length; n++) {
            /* The upper bits of a float are its bin: bins of one exponent are of equal width. */
            uint32_t bits;
            memcpy(&bits, &from->values[n], sizeof bits);
            const Py_ssize_t bin = (Py_ssize_t)((bits & INT32_MAX) >> shift);
            if (bin >= size)
                return STRAY_VALUE;
            bins[bin] += weight;
        }
        first += length;
    }
    return first == from->count ? ALL_WELL : OTHER_RUNS;
}

/* Return 0 if a loop over runs went well, or raise what it met. */
static int raise_unless_well(Found found)
{
    if (found == OTHER_RUNS)
        PyErr_SetString(PyExc_ValueError, "the runs are not those of the values");
    if (found == STRAY_VALUE)
        PyErr_SetString(PyExc_IndexError, "an index names what is not there");
    return found == ALL_WELL ? 0 : -1;
}

static PyObject *keep_at_least(PyObject *Py_UNUSED(module), PyObject *args)
{
    PyObject *o[KEPT_ARRAYS], *result = NULL;
    Array a[KEPT_ARRAYS];
    Py_ssize_t sizes[26], kept = 0, runs = 0;
    float least_kept;
    memset(a, 0, sizeof a);
    if (!PyArg_ParseTuple(args, "OOOOOOf", &o[VALUES], &o[WEIGHT_OF_RUN], &o[LENGTH_OF_RUN], &o[KEPT],
                          &o[KEPT_WEIGHTS], &o[KEPT_LENGTHS], &least_kept))
        return NULL;
    if (read_arrays(o, kept_arrays, KEPT_ARRAYS, a, sizes) < 0)
        goto done;
    /* All values may be kept. */
    if (SIZE('M') < SIZE('N') || SIZE('S') < SIZE('R')) {
        PyErr_SetString(PyExc_ValueError, "there is no room for all values");
        goto done;
    }
    const WeightedRuns from = {DATA(VALUES), DATA(WEIGHT_OF_RUN), DATA(LENGTH_OF_RUN), SIZE('N'), SIZE('R')};
    float *to = DATA(KEPT);
    double *weights_to = DATA(KEPT_WEIGHTS);
    int32_t *lengths_to = DATA(KEPT_LENGTHS);
    Found found;
    Py_BEGIN_ALLOW_THREADS
    found = keep_runs(&from, least_kept, to, weights_to, lengths_to, &kept, &runs);
    Py_END_ALLOW_THREADS
    if (raise_unless_well(found) == 0)
        result = Py_BuildValue("nn", kept, runs);
done:
    release_arrays(a, KEPT_ARRAYS);
    return result;
}

static PyObject *add_to_bins(PyObject *Py_UNUSED(module), PyObject *args)
{
    PyObject *o[BINNED_ARRAYS], *result = NULL;
    Array a[BINNED_ARRAYS];
    Py_ssize_t sizes[26];
    int shift;
    memset(a, 0, sizeof a);
    if (!PyArg_ParseTuple(args, "OOOOi", &o[VALUES], &o[WEIGHT_OF_RUN], &o[LENGTH_OF_RUN], &o[BINS], &shift))
        return NULL;
    if (read_arrays(o, binned_arrays, BINNED_ARRAYS, a, sizes) < 0)
        goto done;
    if (shift < 0 || shift > 31) {
        PyErr_SetString(PyExc_ValueError, "a float has 32 bits to shift");
        goto done;
    }
    const WeightedRuns from = {DATA(VALUES), DATA(WEIGHT_OF_RUN), DATA(LENGTH_OF_RUN), SIZE('N'), SIZE('R')};
    double *bins = DATA(BINS);
    Found found;
    Py_BEGIN_ALLOW_THREADS
    found = fill_bins(&from, bins, SIZE('M'), shift);
    Py_END_ALLOW_THREADS
    if (raise_unless_well(found) == 0)
        result = Py_NewRef(Py_None);
done:
    release_arrays(a, BINNED_ARRAYS);
    return result;
}
