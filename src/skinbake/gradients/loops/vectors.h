/* Vectors of three numbers, pairs of them, and four numbers at once. */

#pragma once

#include "arrays.h"

typedef struct {
    double x, y, z;
} Vector;

/* Row `row` of an array (n, 3) of floats or doubles. */
static ALWAYS_INLINE Vector row3(const void *base, int wide, size_t row)
{
    if (wide) {
        const double *p = (const double *)base + 3 * row;
        return (Vector){p[0], p[1], p[2]};
    }
    const float *p = (const float *)base + 3 * row;
    return (Vector){p[0], p[1], p[2]};
}

static ALWAYS_INLINE Vector minus(Vector a, Vector b) { return (Vector){a.x - b.x, a.y - b.y, a.z - b.z}; }
static ALWAYS_INLINE double dot(Vector a, Vector b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static ALWAYS_INLINE Vector cross(Vector a, Vector b)
{
    return (Vector){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

static ALWAYS_INLINE Vector plus(Vector a, Vector b) { return (Vector){a.x + b.x, a.y + b.y, a.z + b.z}; }
static ALWAYS_INLINE Vector times(Vector a, double by) { return (Vector){a.x * by, a.y * by, a.z * by}; }

/* The numbers of a Four. */
enum { AT_ONCE = 4 };

/* Four doubles at once. Every operation rounds as it does on one of them. */
#if defined(__GNUC__)
typedef double Four __attribute__((vector_size(32)));
static ALWAYS_INLINE Four four(double a, double b, double c, double d) { return (Four){a, b, c, d}; }
static ALWAYS_INLINE Four add(Four a, Four b) { return a + b; }
static ALWAYS_INLINE Four subtract(Four a, Four b) { return a - b; }
static ALWAYS_INLINE Four multiply(Four a, Four b) { return a * b; }
static ALWAYS_INLINE Four divide(Four a, Four b) { return a / b; }
static ALWAYS_INLINE Four root(Four a) { return four(sqrt(a[0]), sqrt(a[1]), sqrt(a[2]), sqrt(a[3])); }
typedef int64_t Words __attribute__((vector_size(32)));
#else
typedef struct {
    double of[4];
} Four;
#define EACH(expression)                                                                                     \
    Four result;                                                                                             \
    for (int n = 0; n < 4; n++)                                                                              \
        result.of[n] = expression;                                                                           \
    return result
static ALWAYS_INLINE Four four(double a, double b, double c, double d) { return (Four){{a, b, c, d}}; }
static ALWAYS_INLINE Four add(Four a, Four b) { EACH(a.of[n] + b.of[n]); }
static ALWAYS_INLINE Four subtract(Four a, Four b) { EACH(a.of[n] - b.of[n]); }
static ALWAYS_INLINE Four multiply(Four a, Four b) { EACH(a.of[n] * b.of[n]); }
static ALWAYS_INLINE Four divide(Four a, Four b) { EACH(a.of[n] / b.of[n]); }
static ALWAYS_INLINE Four root(Four a) { EACH(sqrt(a.of[n])); }
#endif

/* A number for each of the two tangents of a class. */
#if defined(__GNUC__)
typedef double Pair __attribute__((vector_size(16)));
static ALWAYS_INLINE Pair pair(double a, double b) { return (Pair){a, b}; }
static ALWAYS_INLINE Pair add_pairs(Pair a, Pair b) { return a + b; }
static ALWAYS_INLINE Pair subtract_pairs(Pair a, Pair b) { return a - b; }
static ALWAYS_INLINE Pair multiply_pairs(Pair a, Pair b) { return a * b; }
static ALWAYS_INLINE Pair divide_pairs(Pair a, Pair b) { return a / b; }
static ALWAYS_INLINE double part(Pair a, int n) { return a[n]; }
#else
typedef struct {
    double of[2];
} Pair;
static ALWAYS_INLINE Pair pair(double a, double b) { return (Pair){{a, b}}; }
static ALWAYS_INLINE Pair add_pairs(Pair a, Pair b) { return pair(a.of[0] + b.of[0], a.of[1] + b.of[1]); }
static ALWAYS_INLINE Pair subtract_pairs(Pair a, Pair b) { return pair(a.of[0] - b.of[0], a.of[1] - b.of[1]); }
static ALWAYS_INLINE Pair multiply_pairs(Pair a, Pair b) { return pair(a.of[0] * b.of[0], a.of[1] * b.of[1]); }
static ALWAYS_INLINE Pair divide_pairs(Pair a, Pair b) { return pair(a.of[0] / b.of[0], a.of[1] / b.of[1]); }
static ALWAYS_INLINE double part(Pair a, int n) { return a.of[n]; }
#endif
static ALWAYS_INLINE Pair both(double a) { return pair(a, a); }
static ALWAYS_INLINE Pair scaled(double by, Pair a) { return multiply_pairs(both(by), a); }
static ALWAYS_INLINE double squared_length(Pair a) { return part(a, 0) * part(a, 0) + part(a, 1) * part(a, 1); }
static ALWAYS_INLINE Pair load_pair(const double *from)
{
    Pair values;
    memcpy(&values, from, sizeof values);
    return values;
}
static ALWAYS_INLINE void store_pair(double *to, Pair values) { memcpy(to, &values, sizeof values); }

static ALWAYS_INLINE Four load(const double *from)
{
    Four values;
    memcpy(&values, from, sizeof values);
    return values;
}
static ALWAYS_INLINE void store(double *to, Four values) { memcpy(to, &values, sizeof values); }
static ALWAYS_INLINE Four join(Pair a, Pair b) { return four(part(a, 0), part(a, 1), part(b, 0), part(b, 1)); }

/* A vector for each of the two tangents of a class. */
typedef struct {
    Pair x, y, z;
} Vectors;
static ALWAYS_INLINE Vector one_of(Vectors v, int n) { return (Vector){part(v.x, n), part(v.y, n), part(v.z, n)}; }
static ALWAYS_INLINE Vectors both_vectors(Vector v) { return (Vectors){both(v.x), both(v.y), both(v.z)}; }
static ALWAYS_INLINE Vectors load_vectors(const double *from)
{
    return (Vectors){load_pair(from), load_pair(from + 2), load_pair(from + 4)};
}
static ALWAYS_INLINE Vectors plus_each(Vectors a, Vectors b)
{
    return (Vectors){add_pairs(a.x, b.x), add_pairs(a.y, b.y), add_pairs(a.z, b.z)};
}
static ALWAYS_INLINE Vectors times_each(Vectors a, Pair by)
{
    return (Vectors){multiply_pairs(a.x, by), multiply_pairs(a.y, by), multiply_pairs(a.z, by)};
}
static ALWAYS_INLINE Pair dots(Vectors a, Vectors b)
{
    return add_pairs(add_pairs(multiply_pairs(a.x, b.x), multiply_pairs(a.y, b.y)), multiply_pairs(a.z, b.z));
}
static ALWAYS_INLINE Vectors crosses(Vectors a, Vectors b)
{
    return (Vectors){subtract_pairs(multiply_pairs(a.y, b.z), multiply_pairs(a.z, b.y)),
                     subtract_pairs(multiply_pairs(a.z, b.x), multiply_pairs(a.x, b.z)),
                     subtract_pairs(multiply_pairs(a.x, b.y), multiply_pairs(a.y, b.x))};
}

#if defined(__clang__) || (defined(__GNUC__) && __GNUC__ >= 12)
#define HAS_SHUFFLES
#endif

/* Row `row` of an array (n, 3) of floats or doubles, and a zero. */
static ALWAYS_INLINE Four row4(const void *base, int wide, size_t row)
{
#if defined(HAS_SHUFFLES)
    typedef float Floats __attribute__((vector_size(16)));
    const float *p = (const float *)base + 3 * row;
    if (!wide)
        return __builtin_convertvector(((Floats){p[0], p[1], p[2], 0.0f}), Four);
#endif
    Vector v = row3(base, wide, row);
    return four(v.x, v.y, v.z, 0.0);
}

/* The three columns of four rows. */
static ALWAYS_INLINE void transpose_rows(const double *const rows[4], Four columns[3])
{
#if defined(HAS_SHUFFLES)
    Four even = join(load_pair(rows[0]), load_pair(rows[2])), odd = join(load_pair(rows[1]), load_pair(rows[3]));
    columns[0] = __builtin_shufflevector(even, odd, 0, 4, 2, 6);
    columns[1] = __builtin_shufflevector(even, odd, 1, 5, 3, 7);
    even = join(load_pair(rows[0] + 2), load_pair(rows[2] + 2));
    odd = join(load_pair(rows[1] + 2), load_pair(rows[3] + 2));
    columns[2] = __builtin_shufflevector(even, odd, 0, 4, 2, 6);
#else
    for (int m = 0; m < 3; m++)
        columns[m] = four(rows[0][m], rows[1][m], rows[2][m], rows[3][m]);
#endif
}

static ALWAYS_INLINE Four all(double a) { return four(a, a, a, a); }

static ALWAYS_INLINE double sum_of(Four values)
{
    double each[AT_ONCE];
    store(each, values);
    return (each[0] + each[1]) + (each[2] + each[3]);
}

static ALWAYS_INLINE Vector sums_of(const Four *values)
{
    return (Vector){sum_of(values[0]), sum_of(values[1]), sum_of(values[2])};
}

/* ---- Four poses at once -------------------------------------------------------------------------------- */

/* Which of four numbers count. */
#if defined(__GNUC__)
typedef Words Mask;
static ALWAYS_INLINE Mask above(Four a, Four b) { return a > b; }
static ALWAYS_INLINE Mask is_finite(Four a) { return a - a == all(0.0); }
static ALWAYS_INLINE Mask each_of(Mask a, Mask b) { return a & b; }
static ALWAYS_INLINE Four only(Mask counts, Four a) { return (Four)((Words)a & counts); }
static ALWAYS_INLINE Four magnitude(Four a) { return (Four)((Words)a & INT64_MAX); }
static ALWAYS_INLINE Four larger(Four a, Four b) { return (Four)(((Words)a & (a > b)) | ((Words)b & ~(a > b))); }
#else
typedef struct {
    int of[4];
} Mask;
static ALWAYS_INLINE Mask above(Four a, Four b)
{
    Mask found;
    for (int n = 0; n < AT_ONCE; n++)
        found.of[n] = a.of[n] > b.of[n];
    return found;
}
static ALWAYS_INLINE Mask is_finite(Four a)
{
    Mask found;
    for (int n = 0; n < AT_ONCE; n++)
        found.of[n] = isfinite(a.of[n]);
    return found;
}
static ALWAYS_INLINE Mask each_of(Mask a, Mask b)
{
    for (int n = 0; n < AT_ONCE; n++)
        a.of[n] &= b.of[n];
    return a;
}
static ALWAYS_INLINE Four only(Mask counts, Four a) { EACH(counts.of[n] ? a.of[n] : 0.0); }
static ALWAYS_INLINE Four magnitude(Four a) { EACH(fabs(a.of[n])); }
static ALWAYS_INLINE Four larger(Four a, Four b) { EACH(a.of[n] > b.of[n] ? a.of[n] : b.of[n]); }
#endif

/* A vector in each of four poses. */
typedef struct {
    Four x, y, z;
} Vector4;
static ALWAYS_INLINE Vector4 load4(const double *from)
{
    return (Vector4){load(from), load(from + AT_ONCE), load(from + 2 * AT_ONCE)};
}
static ALWAYS_INLINE void store4(double *to, Vector4 v)
{
    store(to, v.x), store(to + AT_ONCE, v.y), store(to + 2 * AT_ONCE, v.z);
}
static ALWAYS_INLINE Vector4 plus4(Vector4 a, Vector4 b)
{
    return (Vector4){add(a.x, b.x), add(a.y, b.y), add(a.z, b.z)};
}
static ALWAYS_INLINE Vector4 minus4(Vector4 a, Vector4 b)
{
    return (Vector4){subtract(a.x, b.x), subtract(a.y, b.y), subtract(a.z, b.z)};
}
static ALWAYS_INLINE Vector4 times4(Vector4 a, Four by)
{
    return (Vector4){multiply(a.x, by), multiply(a.y, by), multiply(a.z, by)};
}
static ALWAYS_INLINE Four dot4(Vector4 a, Vector4 b)
{
    return add(add(multiply(a.x, b.x), multiply(a.y, b.y)), multiply(a.z, b.z));
}
static ALWAYS_INLINE Vector4 cross4(Vector4 a, Vector4 b)
{
    return (Vector4){subtract(multiply(a.y, b.z), multiply(a.z, b.y)),
                     subtract(multiply(a.z, b.x), multiply(a.x, b.z)),
                     subtract(multiply(a.x, b.y), multiply(a.y, b.x))};
}
static ALWAYS_INLINE Vector4 only4(Mask counts, Vector4 a)
{
    return (Vector4){only(counts, a.x), only(counts, a.y), only(counts, a.z)};
}
/* The magnitudes of the components, added: a length or a little more. */
static ALWAYS_INLINE Four extent4(Vector4 a) { return add(add(magnitude(a.x), magnitude(a.y)), magnitude(a.z)); }
/* A vector by four matrices, whose rows are given. */
static ALWAYS_INLINE Vector4 by_rows(const Vector4 rows[3], Vector v)
{
    const Vector4 wide = {all(v.x), all(v.y), all(v.z)};
    return (Vector4){dot4(rows[0], wide), dot4(rows[1], wide), dot4(rows[2], wide)};
}
