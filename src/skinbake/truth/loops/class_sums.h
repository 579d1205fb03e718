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
    [SUMS] = {"sums", "fd", "3KP", WRITTEN},
};

/* The poses in work at a time here: as many as a chunk of poses often has. */
enum { FACE_STRIP = 64 };

typedef double FaceStrip[FACE_STRIP];
typedef float FloatStrip[FACE_STRIP];

typedef struct {
    const double *positions;
    const int32_t *triangles, *met, *classes;
    double *totals; /* (3, C, width) of the C classes in work */
    void *sums;     /* (3, K, P) of all classes: float, or double if it is wide */
    int is_wide;
    Py_ssize_t vertices, poses, width, triangle_count, met_count, first_class, class_count, all_classes;
    double flat; /* a triangle with a larger cotangent is a line or a point */
} Sums;

/* The unit normal of a triangle in up to FACE_STRIP poses: zero where it has no area. */
typedef struct {
    FaceStrip x, y, z;
} FaceNormal;

/* The angles of a triangle, and the cotangents of the first two. They are arbitrary where it has no area. */
typedef struct {
    FaceStrip cotangents[2], angles[3];
} Corners;

/* The same as floats, which is enough where sums are stored as floats. */
typedef struct {
    FloatStrip cotangents[2], angles[3];
} FloatCorners;

/* Return the angle of a cotangent. */
static ALWAYS_INLINE double angle_of(double signed_cotangent)
{
    const double cotangent = fabs(signed_cotangent);
    /* The arctangent takes a ratio of at most 1, and the rest is a right angle. */
    const int steep = cotangent < 1.0;
    const double acute = arctangent(steep ? cotangent : 1.0, steep ? 1.0 : cotangent);
    const double upright = steep ? HALF - acute : acute;
    return signed_cotangent < 0.0 ? 2.0 * HALF - upright : upright;
}

/* Return the angle of a cotangent, to a few units of the last place of a float. */
static ALWAYS_INLINE float angle_of_float(float signed_cotangent)
{
    const float cotangent = fabsf(signed_cotangent);
    const int steep = cotangent < 1.0f;
    const float acute = float_arctangent(steep ? cotangent : 1.0f, steep ? 1.0f : cotangent);
    const float upright = steep ? (float)HALF - acute : acute;
    return signed_cotangent < 0.0f ? (float)(2.0 * HALF) - upright : upright;
}

/* Find the normal and two cotangents of a triangle, these as floats if wide is NULL. */
static ALWAYS_INLINE void measure_face(const Components at[3], double flat, Py_ssize_t count, FaceNormal *face,
                                       Corners *wide, FloatCorners *narrow)
{
    for (Py_ssize_t p = 0; p < count; p++) {
        /* Two edges from the first corner; n = e1 × e2 is twice the area long. */
        const Vector here = vector_at(at[0], p);
        const Vector e1 = minus(vector_at(at[1], p), here), e2 = minus(vector_at(at[2], p), here);
        const Vector normal = cross(e1, e2);
        /* The cotangents at the first two corners: e1 · e2 / |n| and e1 · (e1 − e2) / |n|. */
        const double aa = dot(e1, e1), ab = dot(e1, e2);
        const double reciprocal = 1.0 / sqrt(dot(normal, normal));
        const int sound = (fabs(ab * reciprocal) < flat) & (fabs((aa - ab) * reciprocal) < flat);
        const double at_first = sound ? ab * reciprocal : 0.0, at_second = sound ? (aa - ab) * reciprocal : 0.0;
        /* A triangle without area has no normal, and so adds nothing. */
        if (wide)
            wide->cotangents[0][p] = at_first, wide->cotangents[1][p] = at_second;
        else
            narrow->cotangents[0][p] = (float)at_first, narrow->cotangents[1][p] = (float)at_second;
        face->x[p] = sound ? normal.x * reciprocal : 0.0;
        face->y[p] = sound ? normal.y * reciprocal : 0.0;
        face->z[p] = sound ? normal.z * reciprocal : 0.0;
    }
}

/* Find the angles of a triangle. The third is what the other two leave of π, to the same absolute rounding. */
static ALWAYS_INLINE void find_corners(Corners *face, Py_ssize_t count)
{
    for (Py_ssize_t p = 0; p < count; p++) {
        const double at_first = angle_of(face->cotangents[0][p]), at_second = angle_of(face->cotangents[1][p]);
        face->angles[0][p] = at_first;
        face->angles[1][p] = at_second;
        face->angles[2][p] = 2.0 * HALF - at_first - at_second;
    }
}

/* Find the angles as floats. */
static ALWAYS_INLINE void find_float_corners(FloatCorners *face, Py_ssize_t count)
{
    for (Py_ssize_t p = 0; p < count; p++) {
        const float at_first = angle_of_float(face->cotangents[0][p]);
        const float at_second = angle_of_float(face->cotangents[1][p]);
        face->angles[0][p] = at_first;
        face->angles[1][p] = at_second;
        face->angles[2][p] = (float)(2.0 * HALF) - at_first - at_second;
    }
}

/* Add angle × unit normal of a triangle at one of its corners. The angles are floats if wide is NULL. */
static ALWAYS_INLINE void add_corner(const FaceNormal *face, const double *wide, const float *narrow, Py_ssize_t count,
                                     double *restrict x, double *restrict y, double *restrict z)
{
    for (Py_ssize_t p = 0; p < count; p++) {
        const double angle = wide ? wide[p] : narrow[p];
        x[p] += angle * face->x[p];
        y[p] += angle * face->y[p];
        z[p] += angle * face->z[p];
    }
}

/* Add one triangle, in some poses, at those of its corners that belong to the classes in work. */
static ALWAYS_INLINE int add_face(const Sums *s, int32_t triangle, Py_ssize_t first, Py_ssize_t count, int is_wide)
{
    FaceNormal face;
    Corners wide;
    FloatCorners narrow;
    Components at[3];
    Py_ssize_t rows[3];
    if (triangle < 0 || triangle >= s->triangle_count)
        return 1;
    /* The corners: where their positions are, and the row of each one's class. */
    for (int corner = 0; corner < 3; corner++) {
        const int32_t vertex = s->triangles[3 * (Py_ssize_t)triangle + corner];
        if (vertex < 0 || vertex >= s->vertices)
            return 1;
        at[corner] = components(s->positions, s->vertices * s->poses, vertex * s->poses + first);
        rows[corner] = s->classes[vertex] - s->first_class;
    }
    /* Normal and angles, in all poses of the strip. */
    measure_face(at, s->flat, count, &face, is_wide ? &wide : NULL, &narrow);
    if (is_wide)
        find_corners(&wide, count);
    else
        find_float_corners(&narrow, count);
    /* The share of each corner whose class is in work. */
    const Py_ssize_t apart = s->class_count * s->width;
    for (int corner = 0; corner < 3; corner++)
        if (rows[corner] >= 0 && rows[corner] < s->class_count) {
            double *total = s->totals + rows[corner] * s->width;
            add_corner(&face, is_wide ? wide.angles[corner] : NULL, narrow.angles[corner], count, total,
                       total + apart, total + 2 * apart);
        }
    return 0;
}

/* Store one component of the sum of one class in work, in some poses. */
static ALWAYS_INLINE void store_totals(const Sums *s, Py_ssize_t row, Py_ssize_t first, Py_ssize_t count)
{
    const Py_ssize_t axis = row / s->class_count, class = s->first_class + row % s->class_count;
    const Py_ssize_t at = (axis * s->all_classes + class) * s->poses + first;
    /* Sums are added as doubles and stored as what the array holds. */
    const double *totals = s->totals + row * s->width;
    for (Py_ssize_t p = 0; p < count; p++)
        if (s->is_wide)
            ((double *)s->sums)[at + p] = totals[p];
        else
            ((float *)s->sums)[at + p] = (float)totals[p];
}

/* Sum up the triangles that the classes in work meet, which are given in ascending order. So each class has its
   terms in the same order, no matter which other classes are in work. */
FOR_WIDE_PROCESSORS(int, sum_classes, (const Sums *s), (s))
{
    const Py_ssize_t rows = 3 * s->class_count;
    for (Py_ssize_t first = 0; first < s->poses; first += s->width) {
        const Py_ssize_t count = least(s->width, s->poses - first);
        /* All triangles in some poses, then in the next ones. */
        memset(s->totals, 0, (size_t)(rows * s->width) * sizeof(double));
        for (Py_ssize_t n = 0; n < s->met_count; n++)
            if (s->is_wide ? add_face(s, s->met[n], first, count, 1) : add_face(s, s->met[n], first, count, 0))
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
    double flat, *totals = NULL;
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
    const Py_ssize_t width = least(FACE_STRIP, SIZE('P'));
    totals = malloc((size_t)(3 * class_count * width + 1) * sizeof *totals);
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
