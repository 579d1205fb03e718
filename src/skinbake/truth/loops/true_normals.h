/* True normals (twin: by_numpy.true_normals). */

#pragma once

#include "combinations.h"

enum { T_STARTS, T_COLUMNS, T_VALUES, B_STARTS, B_COLUMNS, B_VALUES, DEFORMED, COEFFICIENTS, AREAS, VALID, CARRIED,
       CLASSES, CLASS_SUMS, SIDES, NORMALS, EXIST, TRUE_ARRAYS };

static const Requirement true_arrays[TRUE_ARRAYS] = {
    [T_STARTS] = {"t_starts", "i", "E", READ},
    [T_COLUMNS] = {"t_columns", "i", "M", READ},
    [T_VALUES] = {"t_values", "d", "M", READ},
    [B_STARTS] = {"b_starts", "i", "E", READ},
    [B_COLUMNS] = {"b_columns", "i", "N", READ},
    [B_VALUES] = {"b_values", "d", "N", READ},
    [DEFORMED] = {"positions", "d", "3VP", READ},
    [COEFFICIENTS] = {"coefficients", "d", "3B", READ},
    [AREAS] = {"areas", "d", "B", READ},
    [VALID] = {"valid", "?", "B", READ},
    [CARRIED] = {"carried", "d", "3B", OR_NONE},
    [CLASSES] = {"classes", "i", "B", OR_NONE},
    [CLASS_SUMS] = {"sums", "f", "3CP", OR_NONE},
    [SIDES] = {"sides", "d", "BP", OR_NONE},
    [NORMALS] = {"normals", "d", "U3BP", WRITTEN},
    [EXIST] = {"exist", "?", "UBP", WRITTEN},
};

/* Rows of a sparse matrix. */
typedef struct {
    const int32_t *starts, *columns;
    const double *values;
    Py_ssize_t entries;
} Rows;

typedef struct {
    Table positions;
    Rows along_t, along_b;
    const double *coefficients, *areas, *carried, *sides;
    const float *sums;
    const int32_t *classes;
    const char *valid;
    double *normals;
    char *exist;
    Py_ssize_t poses, block, class_count;
    double flat; /* a frame with a smaller sine is flat */
} TrueNormals;

/* Differentiate positions along one row, in up to STRIP poses. */
static ALWAYS_INLINE int differentiate(const TrueNormals *w, const Rows *rows, Py_ssize_t row, Py_ssize_t first,
                                       Py_ssize_t count, Strips *out)
{
    const int32_t from = rows->starts[row], to = rows->starts[row + 1];
    if (from < 0 || to < from || to > rows->entries)
        return 1;
    return combine_entries(&w->positions, rows->values + from, rows->columns + from, to - from, first, count, out);
}

/* Return cof(F) n0 of unit length, NaN if there is none (normals.tangent_normals). rest: the coordinates of
   n0 in the rest frame; area: of that frame, NaN if it is not usable. */
static ALWAYS_INLINE Vector by_tangents(Vector a, Vector b, Vector rest, double area, double side, double flat)
{
    /* The metric of the deformed frame. */
    const Vector c = cross(a, b);
    const double aa = dot(a, a), ab = dot(a, b), bb = dot(b, b), square = dot(c, c);
    /* cof(F) n0 by the dual basis of a and b, and c for what n0 has along the normal. */
    const double reciprocal = 1.0 / sqrt(sqrt(square) * area);
    const double along_a = (rest.x * bb - rest.y * ab) * reciprocal;
    const double along_b = (rest.y * aa - rest.x * ab) * reciprocal;
    const double along_c = rest.z * side;
    const Vector found = {along_a * a.x + along_b * b.x + along_c * c.x, along_a * a.y + along_b * b.y + along_c * c.y,
                          along_a * a.z + along_b * b.z + along_c * c.z};
    /* A frame whose sine is below `flat` has no normal. */
    const Vector unit = scaled(1.0 / sqrt(dot(found, found)), found);
    const int sound = (square > flat * flat * aa * bb) & (fabs(unit.x) <= DBL_MAX);
    return scaled(sound ? 1.0 : NAN, unit);
}

/* Return the carried normal of unit length, NaN if there is none (normals.triangle_normals). carried: the
   coordinates of n0 on the triangles at rest. */
static ALWAYS_INLINE Vector by_triangles(Vector a, Vector b, Vector sum, Vector carried, double side, double flat)
{
    const Vector n = scaled(1.0 / sqrt(dot(sum, sum)), sum);
    /* The area of the frame, seen along the normal of the triangles. Its sign tells on which side n0 is. */
    const double area = dot(cross(a, b), n);
    const double root = 1.0 / sqrt(fabs(area));
    const double lean_a = carried.x * root, lean_b = carried.y * root, up = copysign(side, side * area) * carried.z;
    /* The cofactors carry what n0 leans from the triangles at rest. */
    const Vector across_a = cross(b, n), across_b = cross(n, a);
    const Vector found = {lean_a * across_a.x + lean_b * across_b.x + up * n.x,
                          lean_a * across_a.y + lean_b * across_b.y + up * n.y,
                          lean_a * across_a.z + lean_b * across_b.z + up * n.z};
    /* A frame that is flat, or seen from its edge, has no normal. */
    const Vector unit = scaled(1.0 / sqrt(dot(found, found)), found);
    const int sound = (area * area > flat * flat * dot(a, a) * dot(b, b)) & (fabs(unit.x) <= DBL_MAX);
    return scaled(sound ? 1.0 : NAN, unit);
}

/* Store the normals of a vertex by one truth in up to STRIP poses, and tell which of them exist. */
static ALWAYS_INLINE void store_normals(const TrueNormals *w, Py_ssize_t truth, Py_ssize_t at, Py_ssize_t count,
                                        const Strips *found)
{
    const Py_ssize_t stride = w->block * w->poses;
    store_strips(found, count, w->normals + 3 * truth * stride + at, stride);
    char *exist = w->exist + truth * stride + at;
    for (Py_ssize_t p = 0; p < count; p++)
        exist[p] = fabs(found->x[p]) <= DBL_MAX;
}

static ALWAYS_INLINE int normals_of_strip(const TrueNormals *w, Py_ssize_t row, Py_ssize_t first, Py_ssize_t count)
{
    const Py_ssize_t block = w->block, at = row * w->poses + first;
    Strips a, b, found;
    Strip sides;
    /* The surface's derivatives along t0 and b0. */
    if (differentiate(w, &w->along_t, row, first, count, &a) || differentiate(w, &w->along_b, row, first, count, &b))
        return 1;
    /* The side is −1 where a mirroring joint turns the surface inside out. */
    for (Py_ssize_t p = 0; p < count; p++)
        sides[p] = w->sides ? w->sides[at + p] : 1.0;
    /* By tangents: the last truth. */
    const Vector rest = {w->coefficients[row], w->coefficients[block + row], w->coefficients[2 * block + row]};
    const double area = w->valid[row] ? w->areas[row] : NAN;
    for (Py_ssize_t p = 0; p < count; p++) {
        const Vector normal = by_tangents((Vector){a.x[p], a.y[p], a.z[p]}, (Vector){b.x[p], b.y[p], b.z[p]}, rest,
                                          area, sides[p], w->flat);
        found.x[p] = normal.x, found.y[p] = normal.y, found.z[p] = normal.z;
    }
    store_normals(w, w->carried != NULL, at, count, &found);
    /* By the summed normals of the triangles: the first truth, if it is asked for. */
    if (w->carried == NULL)
        return 0;
    const int32_t class = w->classes[row];
    if (class < 0 || class >= w->class_count)
        return 1;
    const Vector carried = {w->carried[row], w->carried[block + row], w->carried[2 * block + row]};
    const Py_ssize_t apart = w->class_count * w->poses;
    const float *sums = w->sums + class * w->poses + first;
    for (Py_ssize_t p = 0; p < count; p++) {
        const Vector sum = {sums[p], sums[apart + p], sums[2 * apart + p]};
        const Vector normal = by_triangles((Vector){a.x[p], a.y[p], a.z[p]}, (Vector){b.x[p], b.y[p], b.z[p]}, sum,
                                           carried, sides[p], w->flat);
        found.x[p] = normal.x, found.y[p] = normal.y, found.z[p] = normal.z;
    }
    store_normals(w, 0, at, count, &found);
    return 0;
}

FOR_PROCESSORS(int, normals_of_block, (const TrueNormals *w), (w))
{
    for (Py_ssize_t row = 0; row < w->block; row++)
        for (Py_ssize_t first = 0; first < w->poses; first += STRIP)
            if (normals_of_strip(w, row, first, least(STRIP, w->poses - first)))
                return 1;
    return 0;
}

/* Check what the requirements of true_normals cannot say. */
static int check_truths(const Array *a, const Py_ssize_t *sizes)
{
    const int carried = a[CARRIED].held;
    if (SIZE('E') == SIZE('B') + 1 && carried == a[CLASSES].held && carried == a[CLASS_SUMS].held &&
        SIZE('U') == 1 + carried)
        return 0;
    PyErr_SetString(PyExc_ValueError, "the arrays of the true normals do not belong together");
    return -1;
}

static PyObject *true_normals(PyObject *Py_UNUSED(module), PyObject *args)
{
    PyObject *o[TRUE_ARRAYS], *result = NULL;
    Array a[TRUE_ARRAYS];
    Py_ssize_t sizes[26];
    double flat;
    memset(a, 0, sizeof a);
    if (!PyArg_ParseTuple(args, "OOOOOOOOOOOOOOOOd", &o[T_STARTS], &o[T_COLUMNS], &o[T_VALUES], &o[B_STARTS],
                          &o[B_COLUMNS], &o[B_VALUES], &o[DEFORMED], &o[COEFFICIENTS], &o[AREAS], &o[VALID],
                          &o[CARRIED], &o[CLASSES], &o[CLASS_SUMS], &o[SIDES], &o[NORMALS], &o[EXIST], &flat))
        return NULL;
    if (read_arrays(o, true_arrays, TRUE_ARRAYS, a, sizes) < 0 || check_truths(a, sizes) < 0)
        goto done;
    const TrueNormals work = {
        .along_t = {DATA(T_STARTS), DATA(T_COLUMNS), DATA(T_VALUES), SIZE('M')},
        .along_b = {DATA(B_STARTS), DATA(B_COLUMNS), DATA(B_VALUES), SIZE('N')},
        .positions = {DATA(DEFORMED), SIZE('V'), SIZE('P'), SIZE('V') * SIZE('P')},
        .coefficients = DATA(COEFFICIENTS),
        .areas = DATA(AREAS),
        .carried = DATA(CARRIED),
        .sides = DATA(SIDES),
        .sums = DATA(CLASS_SUMS),
        .classes = DATA(CLASSES),
        .valid = DATA(VALID),
        .normals = DATA(NORMALS),
        .exist = DATA(EXIST),
        .poses = SIZE('P'),
        .block = SIZE('B'),
        .class_count = SIZE('C'),
        .flat = flat,
    };
    int stray;
    Py_BEGIN_ALLOW_THREADS
    stray = normals_of_block(&work);
    Py_END_ALLOW_THREADS
    result = none_unless(stray);
done:
    release_arrays(a, TRUE_ARRAYS);
    return result;
}
