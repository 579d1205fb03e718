/* The sums of angle-weighted normals (twin: by_numpy.class_sums). */

#pragma once

#include "faces.h"

enum { POSITIONS, TRIANGLES, MET, MESH_CLASSES, SUMS, SUM_ARRAYS };

static const Requirement sum_arrays[SUM_ARRAYS] = {
    [POSITIONS] = {"positions", "d", "3VP", READ},
    [TRIANGLES] = {"triangles", "i", "T3", READ},
    [MET] = {"met", "i", "N", READ},
    [MESH_CLASSES] = {"classes", "i", "V", READ},
    [SUMS] = {"sums", "fd", "3KP", WRITTEN},
};

typedef struct {
    const double *positions;
    const int32_t *triangles, *met, *classes;
    void *totals; /* (3, C, width) of the C classes in work, of the type of the sums */
    void *sums;   /* (3, K, P) of all classes: float, or double if it is wide */
    int is_wide;
    Py_ssize_t vertices, poses, width, triangle_count, met_count, first_class, class_count, all_classes;
    double flat; /* a triangle with a larger cotangent is a line or a point */
} Sums;

/* The bytes of one sum. */
static ALWAYS_INLINE size_t size_of_sum(int is_wide) { return is_wide ? sizeof(double) : sizeof(float); }

/* The corners of a triangle: positions in some poses, and the rows of their classes among the totals, −1 for a class
   that is not in work. */
typedef struct {
    Components at[3];
    Py_ssize_t rows[3];
} FaceCorners;

/* Find the corners of a triangle. Return 1 if it names what is not there. */
static ALWAYS_INLINE int find_face_corners(const Sums *s, int32_t triangle, Py_ssize_t first, FaceCorners *corners)
{
    if (triangle < 0 || triangle >= s->triangle_count)
        return 1;
    for (int corner = 0; corner < 3; corner++) {
        const int32_t vertex = s->triangles[3 * (Py_ssize_t)triangle + corner];
        if (vertex < 0 || vertex >= s->vertices)
            return 1;
        corners->at[corner] = components(s->positions, s->vertices * s->poses, vertex * s->poses + first);
        const Py_ssize_t row = s->classes[vertex] - s->first_class;
        corners->rows[corner] = row >= 0 && row < s->class_count ? row : -1;
    }
    return 0;
}

/* Add angle × unit normal of a triangle at its corners. */
static ALWAYS_INLINE void add_face(const Sums *s, const Face *face, const FaceCorners *corners, Py_ssize_t count)
{
    const Py_ssize_t apart = s->class_count * s->width;
    for (int corner = 0; corner < 3; corner++) {
        if (corners->rows[corner] < 0)
            continue;
        double *x = (double *)s->totals + corners->rows[corner] * s->width, *y = x + apart, *z = y + apart;
        for (Py_ssize_t p = 0; p < count; p++) {
            x[p] += face->angles[corner][p] * face->x[p];
            y[p] += face->angles[corner][p] * face->y[p];
            z[p] += face->angles[corner][p] * face->z[p];
        }
    }
}

static ALWAYS_INLINE void add_float_face(const Sums *s, const FloatFace *face, const FaceCorners *corners,
                                         Py_ssize_t count)
{
    const Py_ssize_t apart = s->class_count * s->width;
    for (int corner = 0; corner < 3; corner++) {
        if (corners->rows[corner] < 0)
            continue;
        float *x = (float *)s->totals + corners->rows[corner] * s->width, *y = x + apart, *z = y + apart;
        for (Py_ssize_t p = 0; p < count; p++) {
            x[p] += face->angles[corner][p] * face->x[p];
            y[p] += face->angles[corner][p] * face->y[p];
            z[p] += face->angles[corner][p] * face->z[p];
        }
    }
}

/* Measure one triangle in some poses, and add it at those of its corners that belong to the classes in work. */
static ALWAYS_INLINE int take_triangle(const Sums *s, int32_t triangle, Py_ssize_t first, Py_ssize_t count)
{
    FaceCorners corners;
    Face face;
    FloatFace rounded;
    if (find_face_corners(s, triangle, first, &corners))
        return 1;
    if (s->is_wide) {
        measure_face(corners.at, s->flat, count, &face);
        find_angles_of_face(&face, count);
        add_face(s, &face, &corners, count);
        return 0;
    }
    if (!measure_face_in_floats(corners.at, (float)s->flat, count, &rounded)) {
        measure_face(corners.at, s->flat, count, &face);
        round_face(&face, count, &rounded);
    }
    find_angles_of_float_face(&rounded, count);
    add_float_face(s, &rounded, &corners, count);
    return 0;
}

/* Store one component of the sum of one class in work, in some poses. */
static ALWAYS_INLINE void store_totals(const Sums *s, Py_ssize_t row, Py_ssize_t first, Py_ssize_t count)
{
    const Py_ssize_t axis = row / s->class_count, class = s->first_class + row % s->class_count;
    const Py_ssize_t at = (axis * s->all_classes + class) * s->poses + first;
    const Py_ssize_t size = (Py_ssize_t)size_of_sum(s->is_wide);
    memcpy((char *)s->sums + at * size, (const char *)s->totals + row * s->width * size, (size_t)(count * size));
}

/* Sum up the triangles that the classes in work meet, which are given in ascending order. So each class has its
   terms in the same order, no matter which other classes are in work. */
FOR_PROCESSORS
static int sum_classes(const Sums *s)
{
    const Py_ssize_t rows = 3 * s->class_count;
    for (Py_ssize_t first = 0; first < s->poses; first += s->width) {
        const Py_ssize_t count = least(s->width, s->poses - first);
        memset(s->totals, 0, (size_t)(rows * s->width) * size_of_sum(s->is_wide));
        for (Py_ssize_t n = 0; n < s->met_count; n++)
            if (take_triangle(s, s->met[n], first, count))
                return 1;
        for (Py_ssize_t row = 0; row < rows; row++)
            store_totals(s, row, first, count);
    }
    return 0;
}

static PyObject *class_sums(PyObject *Py_UNUSED(module), PyObject *args)
{
    PyObject *o[SUM_ARRAYS], *result = NULL;
    Array a[SUM_ARRAYS];
    Py_ssize_t sizes[26], first_class, class_count;
    double flat;
    void *totals = NULL;
    memset(a, 0, sizeof a);
    if (!PyArg_ParseTuple(args, "OOOOOnnd", &o[POSITIONS], &o[TRIANGLES], &o[MET], &o[MESH_CLASSES], &o[SUMS],
                          &first_class, &class_count, &flat))
        return NULL;
    if (read_arrays(o, sum_arrays, SUM_ARRAYS, a, sizes) < 0)
        goto done;
    if (first_class < 0 || class_count < 0 || class_count > SIZE('K') - first_class) {
        PyErr_Format(PyExc_ValueError, "the sums have no %zd classes from %zd on", class_count, first_class);
        goto done;
    }
    const int is_wide = kind_of(&a[SUMS].buffer) == 'd';
    const Py_ssize_t width = least(STRIP, SIZE('P'));
    totals = malloc((size_t)(3 * class_count * width + 1) * size_of_sum(is_wide));
    if (totals == NULL) {
        PyErr_NoMemory();
        goto done;
    }
    const Sums work = {
        .positions = DATA(POSITIONS),
        .triangles = DATA(TRIANGLES),
        .met = DATA(MET),
        .classes = DATA(MESH_CLASSES),
        .totals = totals,
        .sums = DATA(SUMS),
        .is_wide = is_wide,
        .vertices = SIZE('V'),
        .poses = SIZE('P'),
        .width = width,
        .triangle_count = SIZE('T'),
        .met_count = SIZE('N'),
        .first_class = first_class,
        .class_count = class_count,
        .all_classes = SIZE('K'),
        .flat = flat,
    };
    int stray;
    Py_BEGIN_ALLOW_THREADS
    stray = sum_classes(&work);
    Py_END_ALLOW_THREADS
    result = none_unless(stray);
done:
    free(totals);
    release_arrays(a, SUM_ARRAYS);
    return result;
}
