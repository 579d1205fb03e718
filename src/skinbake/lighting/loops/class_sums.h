/* The sums of angle-weighted normals (twin: by_numpy.class_sums). */

#pragma once

#include "arctangents.h"
#include "vectors.h"

enum { POSITIONS, TRIANGLES, MET, MESH_CLASSES, SUMS, SUM_ARRAYS };

static const Requirement sum_arrays[SUM_ARRAYS] = {
    [POSITIONS] = {"positions", "d", "3VP", READ},
    [TRIANGLES] = {"triangles", "i", "T3", READ},
    [MET] = {"met", "i", "N", READ},
    [MESH_CLASSES] = {"classes", "i", "V", READ},
    [SUMS] = {"sums", "fd", "3CP", WRITTEN},
};

/* The poses in work at a time here: the sums of a block of classes stay in the processor's second cache. */
enum { FACE_STRIP = 32 };

typedef double FaceStrip[FACE_STRIP];

typedef struct {
    const double *positions;
    const int32_t *triangles, *met, *classes;
    double *totals; /* (3, C, width) */
    void *sums;     /* float, or double if it is wide */
    int is_wide;
    Py_ssize_t vertices, poses, width, triangle_count, met_count, class_count, first_class;
    double flat; /* a triangle with a larger cotangent is a line or a point */
} Sums;

/* A triangle in up to FACE_STRIP poses: its unit normal, and its angles. One without an area has a normal of zero,
   and any angles. */
typedef struct {
    FaceStrip x, y, z, angles[3];
} Face;

/* Return the angle of a cotangent. */
static ALWAYS_INLINE double angle_of(double signed_cotangent)
{
    const double cotangent = fabs(signed_cotangent);
    const int steep = cotangent < 1.0;
    const double acute = arctangent(steep ? cotangent : 1.0, steep ? 1.0 : cotangent);
    const double upright = steep ? HALF - acute : acute;
    return signed_cotangent < 0.0 ? 2.0 * HALF - upright : upright;
}

/* Measure a triangle. The third angle is what the other two leave of π, to the same absolute rounding. */
static ALWAYS_INLINE void measure_face(Components origin, Components second, Components third, double flat,
                                       Py_ssize_t count, Face *face)
{
    for (Py_ssize_t p = 0; p < count; p++) {
        const Vector here = vector_at(origin, p);
        const Vector e1 = minus(vector_at(second, p), here), e2 = minus(vector_at(third, p), here);
        const Vector normal = cross(e1, e2);
        const double aa = dot(e1, e1), ab = dot(e1, e2);
        const double reciprocal = 1.0 / sqrt(dot(normal, normal));
        const int sound = (fabs(ab * reciprocal) < flat) & (fabs((aa - ab) * reciprocal) < flat);
        const double at_first = angle_of(sound ? ab * reciprocal : 0.0);
        const double at_second = angle_of(sound ? (aa - ab) * reciprocal : 0.0);
        face->x[p] = sound ? normal.x * reciprocal : 0.0;
        face->y[p] = sound ? normal.y * reciprocal : 0.0;
        face->z[p] = sound ? normal.z * reciprocal : 0.0;
        face->angles[0][p] = at_first;
        face->angles[1][p] = at_second;
        face->angles[2][p] = 2.0 * HALF - at_first - at_second;
    }
}

/* Add angle × unit normal of a triangle at one of its corners. */
static ALWAYS_INLINE void add_corner(const Face *face, const double *angles, Py_ssize_t count, double *restrict x,
                                     double *restrict y, double *restrict z)
{
    for (Py_ssize_t p = 0; p < count; p++) {
        x[p] += angles[p] * face->x[p];
        y[p] += angles[p] * face->y[p];
        z[p] += angles[p] * face->z[p];
    }
}

/* Add one triangle, in some poses, at those of its corners that belong to the classes in work. */
static ALWAYS_INLINE int add_face(const Sums *s, int32_t triangle, Py_ssize_t first, Py_ssize_t count)
{
    Face face;
    Components at[3];
    Py_ssize_t rows[3];
    if (triangle < 0 || triangle >= s->triangle_count)
        return 1;
    for (int corner = 0; corner < 3; corner++) {
        const int32_t vertex = s->triangles[3 * (Py_ssize_t)triangle + corner];
        if (vertex < 0 || vertex >= s->vertices)
            return 1;
        at[corner] = components(s->positions, s->vertices * s->poses, vertex * s->poses + first);
        rows[corner] = s->classes[vertex] - s->first_class;
    }
    measure_face(at[0], at[1], at[2], s->flat, count, &face);
    const Py_ssize_t apart = s->class_count * s->width;
    for (int corner = 0; corner < 3; corner++)
        if (rows[corner] >= 0 && rows[corner] < s->class_count) {
            double *total = s->totals + rows[corner] * s->width;
            add_corner(&face, face.angles[corner], count, total, total + apart, total + 2 * apart);
        }
    return 0;
}

/* Sum up the triangles that the classes in work meet, which are given in ascending order. So each class has its
   terms in the same order, no matter which other classes are in work. */
FOR_PROCESSORS
static int sum_classes(const Sums *s)
{
    const Py_ssize_t rows = 3 * s->class_count;
    for (Py_ssize_t first = 0; first < s->poses; first += s->width) {
        const Py_ssize_t count = least(s->width, s->poses - first);
        memset(s->totals, 0, (size_t)(rows * s->width) * sizeof(double));
        for (Py_ssize_t n = 0; n < s->met_count; n++)
            if (add_face(s, s->met[n], first, count))
                return 1;
        for (Py_ssize_t row = 0; row < rows; row++)
            for (Py_ssize_t p = 0; p < count; p++) {
                const Py_ssize_t at = row * s->poses + first + p;
                const double total = s->totals[row * s->width + p];
                if (s->is_wide)
                    ((double *)s->sums)[at] = total;
                else
                    ((float *)s->sums)[at] = (float)total;
            }
    }
    return 0;
}

static PyObject *class_sums(PyObject *Py_UNUSED(module), PyObject *args)
{
    PyObject *o[SUM_ARRAYS], *result = NULL;
    Array a[SUM_ARRAYS];
    Py_ssize_t sizes[26], first_class;
    double flat, *totals = NULL;
    memset(a, 0, sizeof a);
    if (!PyArg_ParseTuple(args, "OOOOOnd", &o[POSITIONS], &o[TRIANGLES], &o[MET], &o[MESH_CLASSES], &o[SUMS],
                          &first_class, &flat))
        return NULL;
    if (read_arrays(o, sum_arrays, SUM_ARRAYS, a, sizes) < 0)
        goto done;
    if (first_class < 0) {
        PyErr_Format(PyExc_ValueError, "the first class is %zd", first_class);
        goto done;
    }
    const Py_ssize_t width = least(FACE_STRIP, SIZE('P'));
    totals = malloc((size_t)(3 * SIZE('C') * width + 1) * sizeof *totals);
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
        .is_wide = kind_of(&a[SUMS].buffer) == 'd',
        .vertices = SIZE('V'),
        .poses = SIZE('P'),
        .width = width,
        .triangle_count = SIZE('T'),
        .met_count = SIZE('N'),
        .class_count = SIZE('C'),
        .first_class = first_class,
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
