/* The weight field: influences normalised in place (twin: by_numpy.normalise_influences). */

#pragma once

#include "surface.h"

/* The influences of all vertices, to be normalised in place. */
typedef struct {
    int32_t *joints; /* (V, K) */
    double *weights;
    uint8_t *free_slots;
    Py_ssize_t slots;
    double adopting_sum, adopting_weight, tolerance, least;
} Influences;

/* The numbers of vertices at which something was assumed. */
typedef struct {
    Py_ssize_t negative, all_zero, not_normalised, repeated_joint;
} Defects;

static void normalise_vertex(const Influences *field, Py_ssize_t vertex, Defects *defects)
{
    const Py_ssize_t slots = field->slots;
    int32_t *joints = field->joints + vertex * slots;
    double *weights = field->weights + vertex * slots;
    uint8_t *free_slots = field->free_slots + vertex * slots;
    int negative = 0, merged = 0;
    double total = 0.0, largest = 0.0;
    for (Py_ssize_t k = 0; k < slots; k++)
        largest = weights[k] > largest ? weights[k] : largest;
    for (Py_ssize_t k = 0; k < slots; k++) {
        /* Weights far below the largest count as 0. */
        if (weights[k] > 0.0 && weights[k] < field->least * largest)
            weights[k] = 0.0;
        free_slots[k] = weights[k] == 0.0;
        if (weights[k] < 0.0) {
            negative = 1;
            weights[k] = 0.0;
        }
        total += weights[k];
    }
    /* A vertex adopts nothing if a weight is negative, or if all of them are too small. */
    if (negative || !(total > field->adopting_sum) || !(largest > field->adopting_weight))
        memset(free_slots, 0, (size_t)slots);
    /* Without any weight the first joint has all of it. */
    if (total == 0.0) {
        defects->all_zero++;
        weights[0] = total = 1.0;
    }
    /* A joint in several slots stays in one of them, with the sum. */
    for (Py_ssize_t later = 1; later < slots; later++)
        for (Py_ssize_t earlier = 0; earlier < later; earlier++) {
            if (joints[later] != joints[earlier] || joints[later] == NO_JOINT)
                continue;
            merged |= weights[later] > 0.0 && weights[earlier] > 0.0;
            if (weights[earlier] == 0.0 && weights[later] > 0.0) {
                joints[earlier] = NO_JOINT;
            } else {
                weights[earlier] += weights[later];
                weights[later] = 0.0;
                joints[later] = NO_JOINT;
            }
        }
    defects->negative += negative;
    defects->repeated_joint += merged;
    defects->not_normalised += fabs(total - 1.0) > field->tolerance;
    for (Py_ssize_t k = 0; k < slots; k++)
        weights[k] /= total;
}

static PyObject *normalise_influences(PyObject *Py_UNUSED(module), PyObject *args)
{
    enum { JOINTS, WEIGHTS, FREE_SLOTS, ARRAYS };
    static const Requirement required[ARRAYS] = {
        [JOINTS] = {"joints", "i", AXIS_V, AXIS_K, WRITTEN},
        [WEIGHTS] = {"weights", "d", AXIS_V, AXIS_K, WRITTEN},
        [FREE_SLOTS] = {"free", "?", AXIS_V, AXIS_K, WRITTEN},
    };
    PyObject *objects[ARRAYS], *result = NULL;
    Array a[ARRAYS] = {{.held = 0}};
    Influences field;
    if (!PyArg_ParseTuple(args, "OOOdddd", &objects[JOINTS], &objects[WEIGHTS], &objects[FREE_SLOTS],
                          &field.adopting_sum, &field.adopting_weight, &field.tolerance, &field.least))
        return NULL;
    if (read_arrays(objects, required, ARRAYS, 1, a) < 0)
        goto done;
    field.joints = a[JOINTS].buffer.buf;
    field.weights = a[WEIGHTS].buffer.buf;
    field.free_slots = a[FREE_SLOTS].buffer.buf;
    field.slots = a[JOINTS].columns;
    Defects defects = {0, 0, 0, 0};
    Py_BEGIN_ALLOW_THREADS
    for (Py_ssize_t vertex = 0; vertex < a[JOINTS].rows; vertex++)
        normalise_vertex(&field, vertex, &defects);
    Py_END_ALLOW_THREADS
    result = Py_BuildValue("{snsnsnsn}", "negative", defects.negative, "all_zero", defects.all_zero,
                           "not_normalised", defects.not_normalised, "repeated_joint", defects.repeated_joint);
done:
    release_arrays(a, ARRAYS);
    return result;
}
