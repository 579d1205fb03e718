/* Triangles with an area (twin: triangles.mark_proper). */

#pragma once

#include "vectors.h"

static inline int has_area(Vector p, Vector q, Vector r, double least)
{
    Vector a = minus(q, p), b = minus(r, p), n = cross(a, b);
    double first = dot(a, a), second = dot(b, b), third = first + second - 2.0 * dot(a, b);
    double longest = first > second ? first : second;
    longest = third > longest ? third : longest;
    return sqrt(dot(n, n)) > least * longest;
}

static Status mark_areas(const Array *positions, const Array *triangles, uint8_t *mask, double least)
{
    const void *points = positions->buffer.buf;
    int wide = positions->kind == 'd';
    const uint32_t *index = triangles->buffer.buf;
    size_t vertices = (size_t)positions->rows;
    for (Py_ssize_t t = 0; t < triangles->rows; t++, index += 3) {
        const uint32_t p = index[0], q = index[1], r = index[2];
        if (p >= vertices || q >= vertices || r >= vertices)
            return STRAY_INDEX;
        mask[t] = (uint8_t)has_area(row3(points, wide, p), row3(points, wide, q), row3(points, wide, r), least);
    }
    return DONE;
}

static PyObject *mark_proper(PyObject *Py_UNUSED(module), PyObject *args)
{
    enum { POSITIONS, TRIANGLES, MASK, ARRAYS };
    static const Requirement required[ARRAYS] = {
        [POSITIONS] = {"positions", "fd", AXIS_V, AXIS_3, READ},
        [TRIANGLES] = {"triangles", "iI", AXIS_T, AXIS_3, READ},
        [MASK] = {"mask", "?", AXIS_T, AXIS_1, WRITTEN},
    };
    PyObject *objects[ARRAYS], *result = NULL;
    Array a[ARRAYS] = {{.held = 0}};
    double least;
    if (!PyArg_ParseTuple(args, "OOOd", &objects[POSITIONS], &objects[TRIANGLES], &objects[MASK], &least))
        return NULL;
    if (read_arrays(objects, required, ARRAYS, 0, a) < 0)
        goto done;
    Status status;
    Py_BEGIN_ALLOW_THREADS
    status = mark_areas(&a[POSITIONS], &a[TRIANGLES], a[MASK].buffer.buf, least);
    Py_END_ALLOW_THREADS
    if (status == DONE)
        result = Py_NewRef(Py_None);
    else
        raise_status(status);
done:
    release_arrays(a, ARRAYS);
    return result;
}
