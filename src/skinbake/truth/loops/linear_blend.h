/* Linear blend skinning (twins: by_numpy.blend, by_numpy.blended_normals). */

#pragma once

#include "combinations.h"

/* The forms F(u, c) of some vertices, as in blending.py. */
typedef struct {
    Table table; /* row 4 j + i holds column i of the matrices of joint j */
    const int32_t *joints;
    const double *weights, *points, *directions, *changes; /* directions NULL: u is p̃; changes NULL: c is 0 */
    Py_ssize_t count, rows, slots;
} Forms;

enum { FORM_JOINTS, FORM_WEIGHTS, FORM_POINTS, FORM_DIRECTIONS, FORM_CHANGES, FORM_TABLE, FORM_ARRAYS };

#define FORM_REQUIREMENTS                                       \
    [FORM_JOINTS] = {"joints", "i", "BK", READ},                \
    [FORM_WEIGHTS] = {"weights", "d", "BK", READ},              \
    [FORM_POINTS] = {"points", "d", "B3", READ},                \
    [FORM_DIRECTIONS] = {"directions", "d", "FB3", OR_NONE},    \
    [FORM_CHANGES] = {"changes", "d", "FBK", OR_NONE},          \
    [FORM_TABLE] = {"table", "d", "R3P", READ}

static Forms forms_of(const Array *a, const Py_ssize_t *sizes, Py_ssize_t count)
{
    return (Forms){
        .table = {DATA(FORM_TABLE), SIZE('R'), 3 * SIZE('P'), SIZE('P')},
        .joints = DATA(FORM_JOINTS),
        .weights = DATA(FORM_WEIGHTS),
        .points = DATA(FORM_POINTS),
        .directions = DATA(FORM_DIRECTIONS),
        .changes = DATA(FORM_CHANGES),
        .count = count,
        .rows = SIZE('B'),
        .slots = SIZE('K'),
    };
}

/* What F multiplies the table with, from some slots of a vertex: entries w u + c p̃ that are not 0. */
typedef struct {
    double factors[WIDEST];
    int32_t rows[WIDEST];
    Py_ssize_t count;
} Entries;

/* Take the entries of up to WIDEST / 4 slots. Return 1 for a stray joint. */
static ALWAYS_INLINE int take_slots(const Forms *f, Py_ssize_t form, Py_ssize_t row, Py_ssize_t first, Entries *to)
{
    const Py_ssize_t last = least(f->slots, first + WIDEST / 4);
    const double *weights = f->weights + row * f->slots;
    const double *changes = f->changes ? f->changes + (form * f->rows + row) * f->slots : NULL;
    /* Without directions u is the point itself, and both have the fourth coordinate 1. */
    const Vector p = vertex_at(f->points, row);
    const Vector u = f->directions ? vertex_at(f->directions, form * f->rows + row) : p;
    const double direction[4] = {u.x, u.y, u.z, f->directions ? 0.0 : 1.0}, point[4] = {p.x, p.y, p.z, 1.0};
    to->count = 0;
    for (Py_ssize_t slot = first; slot < last; slot++) {
        const int32_t joint = f->joints[row * f->slots + slot];
        if (joint < 0 || joint >= f->table.count / 4)
            return 1;
        /* Column i of the joint's matrix has the factor w u[i] + c p̃[i]. */
        for (int i = 0; i < 4; i++) {
            const double factor = weights[slot] * direction[i] + (changes ? changes[slot] * point[i] : 0.0);
            if (factor != 0.0)
                to->factors[to->count] = factor, to->rows[to->count++] = 4 * joint + i;
        }
    }
    return 0;
}

/* Write a form of a vertex in up to STRIP poses. Return 1 for a stray joint. */
static ALWAYS_INLINE int blend_form(const Forms *f, Py_ssize_t form, Py_ssize_t row, Py_ssize_t first,
                                    Py_ssize_t poses, Strips *out)
{
    /* The first slots, which are all of them in usual meshes. */
    Entries entries;
    if (take_slots(f, form, row, 0, &entries))
        return 1;
    combine(&f->table, entries.factors, entries.rows, entries.count, first, poses, out);
    /* Further slots are summed up apart and added. */
    for (Py_ssize_t slot = WIDEST / 4; slot < f->slots; slot += WIDEST / 4) {
        Strips more;
        if (take_slots(f, form, row, slot, &entries))
            return 1;
        combine(&f->table, entries.factors, entries.rows, entries.count, first, poses, &more);
        add_strips(out, &more, poses);
    }
    return 0;
}

typedef struct {
    Forms forms;
    double *out; /* (forms, 3, all_rows, poses), from the row `first_row` on */
    Py_ssize_t poses, all_rows, first_row;
} Blend;

FOR_PROCESSORS(int, blend_rows, (const Blend *b), (b))
{
    Strips found;
    for (Py_ssize_t form = 0; form < b->forms.count; form++)
        for (Py_ssize_t row = 0; row < b->forms.rows; row++) {
            double *out = b->out + (3 * form * b->all_rows + b->first_row + row) * b->poses;
            /* A strip of poses at a time, for which the entries are taken once. */
            for (Py_ssize_t first = 0; first < b->poses; first += STRIP) {
                const Py_ssize_t poses = least(STRIP, b->poses - first);
                if (blend_form(&b->forms, form, row, first, poses, &found))
                    return 1;
                store_strips(&found, poses, out + first, b->all_rows * b->poses);
            }
        }
    return 0;
}

enum { BLENDED = FORM_ARRAYS, BLEND_ARRAYS };

static const Requirement blend_arrays[BLEND_ARRAYS] = {
    FORM_REQUIREMENTS,
    [BLENDED] = {"out", "d", "F3VP", WRITTEN},
};

static PyObject *blend(PyObject *Py_UNUSED(module), PyObject *args)
{
    PyObject *o[BLEND_ARRAYS], *result = NULL;
    Array a[BLEND_ARRAYS];
    Py_ssize_t sizes[26], first_row;
    memset(a, 0, sizeof a);
    if (!PyArg_ParseTuple(args, "OOOOOOOn", &o[FORM_JOINTS], &o[FORM_WEIGHTS], &o[FORM_POINTS], &o[FORM_DIRECTIONS],
                          &o[FORM_CHANGES], &o[FORM_TABLE], &o[BLENDED], &first_row))
        return NULL;
    if (read_arrays(o, blend_arrays, BLEND_ARRAYS, a, sizes) < 0 || !has_rows(sizes, first_row))
        goto done;
    const Blend work = {
        .forms = forms_of(a, sizes, SIZE('F')),
        .out = DATA(BLENDED),
        .poses = SIZE('P'),
        .all_rows = SIZE('V'),
        .first_row = first_row,
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

typedef struct {
    Forms forms;
    const double *normals; /* NULL for the cross product of two forms */
    double *out;
    Py_ssize_t poses;
} BlendNormals;

/* Return M⁻ᵀ n for a matrix given by its columns, or cof(M) n if det M is 0. */
static ALWAYS_INLINE Vector inverse_transposed(Vector a, Vector b, Vector c, Vector normal)
{
    /* The rows of M; their cross products are the rows of its cofactors. */
    const Vector first = {a.x, b.x, c.x}, second = {a.y, b.y, c.y}, third = {a.z, b.z, c.z};
    const Vector x = cross(second, third), y = cross(third, first), z = cross(first, second);
    const double determinant = dot(first, x);
    /* M⁻ᵀ = cof(M) / det M. */
    const Vector turned = {dot(x, normal), dot(y, normal), dot(z, normal)};
    return scaled(1.0 / (determinant == 0.0 ? 1.0 : determinant), turned);
}

static ALWAYS_INLINE Vector in_strips(const Strips *from, Py_ssize_t p)
{
    return (Vector){from->x[p], from->y[p], from->z[p]};
}

/* Write the normals of a vertex in up to STRIP poses to the first strips. Return 1 for a stray joint. */
static ALWAYS_INLINE int normals_of_forms(const BlendNormals *b, Py_ssize_t row, Py_ssize_t first, Py_ssize_t poses,
                                          Strips *forms)
{
    /* The columns of M for M⁻ᵀ n, or t' and b' for their cross product. */
    for (Py_ssize_t form = 0; form < (b->normals ? 3 : 2); form++)
        if (blend_form(&b->forms, form, row, first, poses, &forms[form]))
            return 1;
    const Vector normal = b->normals ? vertex_at(b->normals, row) : (Vector){0.0, 0.0, 0.0};
    /* The normal takes the place of the first form. */
    for (Py_ssize_t p = 0; p < poses; p++) {
        const Vector one = in_strips(&forms[0], p), other = in_strips(&forms[1], p);
        const Vector found =
            b->normals ? inverse_transposed(one, other, in_strips(&forms[2], p), normal) : cross(one, other);
        forms[0].x[p] = found.x, forms[0].y[p] = found.y, forms[0].z[p] = found.z;
    }
    return 0;
}

FOR_PROCESSORS(int, blend_normals_of_rows, (const BlendNormals *b), (b))
{
    Strips forms[3];
    const Py_ssize_t rows = b->forms.rows;
    for (Py_ssize_t row = 0; row < rows; row++)
        for (Py_ssize_t first = 0; first < b->poses; first += STRIP) {
            const Py_ssize_t poses = least(STRIP, b->poses - first);
            if (normals_of_forms(b, row, first, poses, forms))
                return 1;
            store_strips(&forms[0], poses, b->out + row * b->poses + first, rows * b->poses);
        }
    return 0;
}

enum { REST_NORMALS = FORM_ARRAYS, BLENDED_NORMALS, NORMAL_ARRAYS };

static const Requirement normal_arrays[NORMAL_ARRAYS] = {
    FORM_REQUIREMENTS,
    [REST_NORMALS] = {"normals", "d", "B3", OR_NONE},
    [BLENDED_NORMALS] = {"out", "d", "3BP", WRITTEN},
};

static PyObject *blended_normals(PyObject *Py_UNUSED(module), PyObject *args)
{
    PyObject *o[NORMAL_ARRAYS], *result = NULL;
    Array a[NORMAL_ARRAYS];
    Py_ssize_t sizes[26];
    memset(a, 0, sizeof a);
    if (!PyArg_ParseTuple(args, "OOOOOOOO", &o[FORM_JOINTS], &o[FORM_WEIGHTS], &o[FORM_POINTS], &o[FORM_DIRECTIONS],
                          &o[FORM_CHANGES], &o[FORM_TABLE], &o[REST_NORMALS], &o[BLENDED_NORMALS]))
        return NULL;
    if (read_arrays(o, normal_arrays, NORMAL_ARRAYS, a, sizes) < 0)
        goto done;
    if (SIZE('F') != (a[REST_NORMALS].held ? 3 : 2)) {
        PyErr_SetString(PyExc_ValueError, "normals take three forms, a cross product takes two");
        goto done;
    }
    const BlendNormals work = {
        .forms = forms_of(a, sizes, SIZE('F')),
        .normals = DATA(REST_NORMALS),
        .out = DATA(BLENDED_NORMALS),
        .poses = SIZE('P'),
    };
    int stray;
    Py_BEGIN_ALLOW_THREADS
    stray = blend_normals_of_rows(&work);
    Py_END_ALLOW_THREADS
    result = none_unless(stray);
done:
    release_arrays(a, NORMAL_ARRAYS);
    return result;
}
