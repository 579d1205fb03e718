/* Angles between normals (twin: by_numpy.angles). */

#pragma once

#include "arctangents.h"
#include "vectors.h"

enum { MEASURED_X, MEASURED_Y, MEASURED_Z, EXPECTED, ANGLES, ANGLE_ARRAYS };

static const Requirement angle_arrays[ANGLE_ARRAYS] = {
    [MEASURED_X] = {"x", "d", "BP", READ},
    [MEASURED_Y] = {"y", "d", "BP", READ},
    [MEASURED_Z] = {"z", "d", "BP", READ},
    [EXPECTED] = {"expected", "d", "U3BP", READ},
    [ANGLES] = {"angles", "f", "UBP", WRITTEN},
};

FOR_WIDE_PROCESSORS(void, find_angles,
                    (Components measured, const double *expected, float *angles, Py_ssize_t truths, Py_ssize_t size),
                    (measured, expected, angles, truths, size))
{
    Strip x, y, z;
    float ratios[STRIP];
    for (Py_ssize_t first = 0; first < size; first += STRIP) {
        const Py_ssize_t count = least(STRIP, size - first);
        /* Unit normals, NaN for those of no finite length. */
        for (Py_ssize_t p = 0; p < count; p++) {
            const Vector vector = vector_at(measured, first + p);
            const double square = dot(vector, vector);
            const Vector unit = scaled(1.0 / sqrt(square <= DBL_MAX ? square : NAN), vector);
            x[p] = unit.x, y[p] = unit.y, z[p] = unit.z;
        }
        for (Py_ssize_t truth = 0; truth < truths; truth++) {
            const Components wanted = components(expected + 3 * truth * size, size, first);
            int large = 0;
            for (Py_ssize_t p = 0; p < count; p++) {
                /* tan²(angle / 2) = chord² / (4 − chord²) of unit vectors. The chord of opposite ones may round to
                   more than 2. */
                const Vector apart = minus((Vector){x[p], y[p], z[p]}, vector_at(wanted, p));
                const double chord = dot(apart, apart);
                ratios[p] = (float)chord / (float)fabs(4.0 - chord);
            }
            for (Py_ssize_t p = 0; p < count; p++)
                large |= ratios[p] > SMALL_RATIO;
            /* Small angles need fewer terms of the arctangent. */
            float *found = angles + truth * size + first;
            if (large)
                for (Py_ssize_t p = 0; p < count; p++)
                    found[p] = degrees_of(ratios[p]);
            else /* as nearly always */
                for (Py_ssize_t p = 0; p < count; p++)
                    found[p] = degrees_of_small(ratios[p]);
        }
    }
}

static PyObject *angles(PyObject *Py_UNUSED(module), PyObject *args)
{
    PyObject *o[ANGLE_ARRAYS], *result = NULL;
    Array a[ANGLE_ARRAYS];
    Py_ssize_t sizes[26];
    memset(a, 0, sizeof a);
    if (!PyArg_ParseTuple(args, "OOOOO", &o[MEASURED_X], &o[MEASURED_Y], &o[MEASURED_Z], &o[EXPECTED], &o[ANGLES]))
        return NULL;
    if (read_arrays(o, angle_arrays, ANGLE_ARRAYS, a, sizes) < 0)
        goto done;
    const Components measured = {DATA(MEASURED_X), DATA(MEASURED_Y), DATA(MEASURED_Z)};
    const double *expected = DATA(EXPECTED);
    float *found = DATA(ANGLES);
    Py_BEGIN_ALLOW_THREADS
    find_angles(measured, expected, found, SIZE('U'), SIZE('B') * SIZE('P'));
    Py_END_ALLOW_THREADS
    result = Py_NewRef(Py_None);
done:
    release_arrays(a, ANGLE_ARRAYS);
    return result;
}
