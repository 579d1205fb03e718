/* Linear combinations of rows of a table. */

#pragma once

#include "vectors.h"

/* Four doubles at once. Every operation rounds as it does on one of them. */
#if defined(__GNUC__)
typedef double Four __attribute__((vector_size(32)));
static ALWAYS_INLINE Four plus_scaled(Four sum, double factor, Four values)
{
    return sum + (Four){factor, factor, factor, factor} * values;
}
#else
typedef struct {
    double of[4];
} Four;
static ALWAYS_INLINE Four plus_scaled(Four sum, double factor, Four values)
{
    for (int n = 0; n < 4; n++)
        sum.of[n] += factor * values.of[n];
    return sum;
}
#endif

static ALWAYS_INLINE Four load(const double *from)
{
    Four values;
    memcpy(&values, from, sizeof values);
    return values;
}

/* Rows of vectors by components: vector `row` of pose `p` has its component at row × stride + p, and the
   next component `apart` further on. */
typedef struct {
    const double *base;
    Py_ssize_t count, stride, apart;
} Table;

typedef struct {
    Strip x, y, z;
} Strips;

/* Write Σ factor × row in some poses, by so many fours, to strips at `p`. The sums stay in registers. */
static ALWAYS_INLINE void combine_fours(const Table *table, const double *factors, const int32_t *rows,
                                        Py_ssize_t count, Py_ssize_t first, Py_ssize_t p, int fours, Strips *out)
{
    Four x[2], y[2], z[2];
    memset(x, 0, sizeof x), memset(y, 0, sizeof y), memset(z, 0, sizeof z);
    /* Each row of the table adds factor × its values, component by component. */
    for (Py_ssize_t k = 0; k < count; k++) {
        const double *from = table->base + rows[k] * table->stride + first + p;
        for (int n = 0; n < fours; n++) {
            x[n] = plus_scaled(x[n], factors[k], load(from + 4 * n));
            y[n] = plus_scaled(y[n], factors[k], load(from + table->apart + 4 * n));
            z[n] = plus_scaled(z[n], factors[k], load(from + 2 * table->apart + 4 * n));
        }
    }
    const size_t size = (size_t)fours * sizeof(Four);
    memcpy(out->x + p, x, size), memcpy(out->y + p, y, size), memcpy(out->z + p, z, size);
}

/* Write Σ factor × row of a table in up to STRIP poses. All rows are in the table. */
static ALWAYS_INLINE void combine(const Table *table, const double *factors, const int32_t *rows, Py_ssize_t count,
                                  Py_ssize_t first, Py_ssize_t poses, Strips *out)
{
    /* Eight poses at a time, then four, then single ones: each rounds in the same way. */
    Py_ssize_t p = 0;
    for (; p + 8 <= poses; p += 8)
        combine_fours(table, factors, rows, count, first, p, 2, out);
    for (; p + 4 <= poses; p += 4)
        combine_fours(table, factors, rows, count, first, p, 1, out);
    for (; p < poses; p++) {
        double x = 0.0, y = 0.0, z = 0.0;
        for (Py_ssize_t k = 0; k < count; k++) {
            const double *from = table->base + rows[k] * table->stride + first + p;
            x += factors[k] * from[0], y += factors[k] * from[table->apart], z += factors[k] * from[2 * table->apart];
        }
        out->x[p] = x, out->y[p] = y, out->z[p] = z;
    }
}

/* The entries of a row that are copied and checked at a time. */
enum { WIDEST = 64 };

/* Take up to WIDEST entries that are not 0, and check them. Return how many were looked at, −1 if a row is not in
   the table. */
static ALWAYS_INLINE Py_ssize_t take_entries(const Table *table, const double *values, const int32_t *columns,
                                             Py_ssize_t count, double *factors, int32_t *rows, Py_ssize_t *taken)
{
    Py_ssize_t looked = 0;
    for (*taken = 0; looked < count && *taken < WIDEST; looked++) {
        const double factor = values[looked];
        const int32_t row = columns[looked];
        if (row < 0 || row >= table->count)
            return -1;
        /* An entry of 0 adds nothing. */
        if (factor != 0.0)
            factors[*taken] = factor, rows[(*taken)++] = row;
    }
    return looked;
}

static ALWAYS_INLINE void add_strips(Strips *to, const Strips *more, Py_ssize_t count)
{
    for (Py_ssize_t p = 0; p < count; p++)
        to->x[p] += more->x[p], to->y[p] += more->y[p], to->z[p] += more->z[p];
}

/* Write Σ value × row of a table in up to STRIP poses, for any number of entries. Return 1 for a stray row. */
static ALWAYS_INLINE int combine_entries(const Table *table, const double *values, const int32_t *columns,
                                         Py_ssize_t count, Py_ssize_t first, Py_ssize_t poses, Strips *out)
{
    double factors[WIDEST];
    int32_t rows[WIDEST];
    Py_ssize_t taken, looked = take_entries(table, values, columns, count, factors, rows, &taken);
    if (looked < 0)
        return 1;
    combine(table, factors, rows, taken, first, poses, out);
    /* A longer row is summed up in parts of WIDEST entries. */
    for (Py_ssize_t done = looked; done < count; done += looked) {
        Strips more;
        looked = take_entries(table, values + done, columns + done, count - done, factors, rows, &taken);
        if (looked < 0)
            return 1;
        combine(table, factors, rows, taken, first, poses, &more);
        add_strips(out, &more, poses);
    }
    return 0;
}

static ALWAYS_INLINE void store_strips(const Strips *from, Py_ssize_t count, double *to, Py_ssize_t apart)
{
    memcpy(to, from->x, (size_t)count * sizeof(double));
    memcpy(to + apart, from->y, (size_t)count * sizeof(double));
    memcpy(to + 2 * apart, from->z, (size_t)count * sizeof(double));
}
