/* Linear blend skinning (twins: by_numpy.blend, by_numpy.blended_normals). */

#pragma once

#include "combinations.h"

enum { ENTRIES, COLUMNS, TABLE, BLENDED, BLEND_ARRAYS };

static const Requirement blend_arrays[BLEND_ARRAYS] = {
    [ENTRIES] = {"entries", "d", "FBW", READ},
    [COLUMNS] = {"columns", "i", "BW", READ},
    [TABLE] = {"table", "d", "R3P", READ},
    [BLENDED] = {"out", "d", "F3BP", WRITTEN},
};

typedef struct {
    Table table;
    const double *entries;
    const int32_t *columns;
    double *out;
    Py_ssize_t forms, rows, width, poses;
} Blend;

FOR_PROCESSORS
static int blend_rows(const Blend *b)
{
    Strips found;
    for (Py_ssize_t form = 0; form < b->forms; form++)
        for (Py_ssize_t row = 0; row < b->rows; row++) {
            const double *entries = b->entries + (form * b->rows + row) * b->width;
            double *out = b->out + (3 * form * b->rows + row) * b->poses;
            for (Py_ssize_t first = 0; first < b->poses; first += STRIP) {
                const Py_ssize_t poses = least(STRIP, b->poses - first);
                const int32_t *columns = b->columns + row * b->width;
                if (combine_entries(&b->table, entries, columns, b->width, first, poses, &found))
                    return 1;
                store_strips(&found, poses, out + first, b->rows * b->poses);
            }
        }
    return 0;
}

static PyObject *blend(PyObject *Py_UNUSED(module), PyObject *args)
{
    PyObject *o[BLEND_ARRAYS], *result = NULL;
    Array a[BLEND_ARRAYS];
    Py_ssize_t sizes[26];
    memset(a, 0, sizeof a);
    if (!PyArg_ParseTuple(args, "OOOO", &o[ENTRIES], &o[COLUMNS], &o[TABLE], &o[BLENDED]))
        return NULL;
    if (read_arrays(o, blend_arrays, BLEND_ARRAYS, a, sizes) < 0)
        goto done;
    const Blend work = {
        .table = {DATA(TABLE), SIZE('R'), 3 * SIZE('P'), SIZE('P')},
        .entries = DATA(ENTRIES),
        .columns = DATA(COLUMNS),
        .out = DATA(BLENDED),
        .forms = SIZE('F'),
        .rows = SIZE('B'),
        .width = SIZE('W'),
        .poses = SIZE('P'),
    };
    int stray;
    Py_BEGIN_ALLOW_THREADS
    stray = blend_rows(&work);
    Py_END_ALLOW_THREADS
    result = none_unless(stray);
done:
    release_arrays(a, BLEND_ARRAYS);
    return result;
}

enum { FORM_ENTRIES, FORM_COLUMNS, FORM_TABLE, REST_NORMALS, BLENDED_NORMALS, FORM_ARRAYS };

static const Requirement form_arrays[FORM_ARRAYS] = {
    [FORM_ENTRIES] = {"entries", "d", "FBW", READ},
    [FORM_COLUMNS] = {"columns", "i", "BW", READ},
    [FORM_TABLE] = {"table", "d", "R3P", READ},
    [REST_NORMALS] = {"normals", "d", "B3", OR_NONE},
    [BLENDED_NORMALS] = {"out", "d", "3BP", WRITTEN},
};

typedef struct {
    Table table;
    const double *entries, *normals; /* normals: NULL for the cross product of two forms */
    const int32_t *columns;
    double *out;
    Py_ssize_t rows, width, poses;
} BlendNormals;

/* Return M⁻ᵀ n for a matrix given by its columns, or cof(M) n if det M is 0. */
static ALWAYS_INLINE Vector inverse_transposed(Vector a, Vector b, Vector c, Vector normal)
{
    const Vector first = {a.x, b.x, c.x}, second = {a.y, b.y, c.y}, third = {a.z, b.z, c.z};
    const Vector x = cross(second, third), y = cross(third, first), z = cross(first, second);
    const double determinant = dot(first, x);
    const Vector turned = {dot(x, normal), dot(y, normal), dot(z, normal)};
    return scaled(1.0 / (determinant == 0.0 ? 1.0 : determinant), turned);
}

static ALWAYS_INLINE Vector in_strips(const Strips *from, Py_ssize_t p)
{
    return (Vector){from->x[p], from->y[p], from->z[p]};
}

/* Write the normals of a vertex in up to STRIP poses to the first strips. Return 1 for a stray row. */
static ALWAYS_INLINE int normals_of_forms(const BlendNormals *b, Py_ssize_t row, Py_ssize_t first, Py_ssize_t poses,
                                          Strips *forms)
{
    const int32_t *columns = b->columns + row * b->width;
    for (Py_ssize_t form = 0; form < (b->normals ? 3 : 2); form++) {
        const double *entries = b->entries + (form * b->rows + row) * b->width;
        if (combine_entries(&b->table, entries, columns, b->width, first, poses, &forms[form]))
            return 1;
    }
    const Vector normal = b->normals ? vertex_at(b->normals, row) : (Vector){0.0, 0.0, 0.0};
    for (Py_ssize_t p = 0; p < poses; p++) {
        const Vector one = in_strips(&forms[0], p), other = in_strips(&forms[1], p);
        const Vector found =
            b->normals ? inverse_transposed(one, other, in_strips(&forms[2], p), normal) : cross(one, other);
        forms[0].x[p] = found.x, forms[0].y[p] = found.y, forms[0].z[p] = found.z;
    }
    return 0;
}

FOR_PROCESSORS
static int blend_normals_of_rows(const BlendNormals *b)
{
    Strips forms[3];
    for (Py_ssize_t row = 0; row < b->rows; row++)
        for (Py_ssize_t first = 0; first < b->poses; first += STRIP) {
            const Py_ssize_t poses = least(STRIP, b->poses - first);
            if (normals_of_forms(b, row, first, poses, forms))
                return 1;
            store_strips(&forms[0], poses, b->out + row * b->poses + first, b->rows * b->poses);
        }
    return 0;
}

static PyObject *blended_normals(PyObject *Py_UNUSED(module), PyObject *args)
{
    PyObject *o[FORM_ARRAYS], *result = NULL;
    Array a[FORM_ARRAYS];
    Py_ssize_t sizes[26];
    memset(a, 0, sizeof a);
    if (!PyArg_ParseTuple(args, "OOOOO", &o[FORM_ENTRIES], &o[FORM_COLUMNS], &o[FORM_TABLE], &o[REST_NORMALS],
                          &o[BLENDED_NORMALS]))
        return NULL;
    if (read_arrays(o, form_arrays, FORM_ARRAYS, a, sizes) < 0)
        goto done;
    if (SIZE('F') != (a[REST_NORMALS].held ? 3 : 2)) {
        PyErr_SetString(PyExc_ValueError, "normals take three forms, a cross product takes two");
        goto done;
    }
    const BlendNormals work = {
        .table = {DATA(FORM_TABLE), SIZE('R'), 3 * SIZE('P'), SIZE('P')},
        .entries = DATA(FORM_ENTRIES),
        .normals = DATA(REST_NORMALS),
        .columns = DATA(FORM_COLUMNS),
        .out = DATA(BLENDED_NORMALS),
        .rows = SIZE('B'),
        .width = SIZE('W'),
        .poses = SIZE('P'),
    };
    int stray;
    Py_BEGIN_ALLOW_THREADS
    stray = blend_normals_of_rows(&work);
    Py_END_ALLOW_THREADS
    result = none_unless(stray);
done:
    release_arrays(a, FORM_ARRAYS);
    return result;
}
