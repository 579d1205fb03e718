/* A triangle in many poses: its unit normal, and its angles. */

#pragma once

#include "arctangents.h"
#include "vectors.h"

/* A triangle in up to STRIP poses: its unit normal, and its angles. One without an area has a normal of zero,
   and any angles. The cotangents are those of the first two angles. */
typedef struct {
    Strip x, y, z, cotangents[2], angles[3];
} Face;

typedef float FloatStrip[STRIP];

/* The same in floats. */
typedef struct {
    FloatStrip x, y, z, cotangents[2], angles[3];
} FloatFace;

/* The range of the squared doubled area in which floats hold it, and all that is made of it. */
#define SMALL_SQUARE 1e-30f
#define LARGE_SQUARE 1e30f

/* Return the angle of a cotangent. */
static ALWAYS_INLINE double angle_of(double signed_cotangent)
{
    const double cotangent = fabs(signed_cotangent);
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

/* Find the normal and two cotangents of a triangle, whose corners are `at`. */
static ALWAYS_INLINE void measure_face(const Components at[3], double flat, Py_ssize_t count, Face *face)
{
    for (Py_ssize_t p = 0; p < count; p++) {
        const Vector here = vector_at(at[0], p);
        const Vector e1 = minus(vector_at(at[1], p), here), e2 = minus(vector_at(at[2], p), here);
        const Vector normal = cross(e1, e2);
        const double aa = dot(e1, e1), ab = dot(e1, e2);
        const double reciprocal = 1.0 / sqrt(dot(normal, normal));
        const int sound = (fabs(ab * reciprocal) < flat) & (fabs((aa - ab) * reciprocal) < flat);
        face->cotangents[0][p] = sound ? ab * reciprocal : 0.0;
        face->cotangents[1][p] = sound ? (aa - ab) * reciprocal : 0.0;
        face->x[p] = sound ? normal.x * reciprocal : 0.0;
        face->y[p] = sound ? normal.y * reciprocal : 0.0;
        face->z[p] = sound ? normal.z * reciprocal : 0.0;
    }
}

/* Find the same in floats, from products of edges in doubles. A narrow angle costs no digits so. Return whether all
   areas are in the range of floats. */
static ALWAYS_INLINE int measure_face_in_floats(const Components at[3], float flat, Py_ssize_t count, FloatFace *face)
{
    int in_range = 1;
    for (Py_ssize_t p = 0; p < count; p++) {
        const Vector here = vector_at(at[0], p);
        const Vector e1 = minus(vector_at(at[1], p), here), e2 = minus(vector_at(at[2], p), here);
        const Vector normal = cross(e1, e2);
        const double aa = dot(e1, e1), ab = dot(e1, e2);
        const float x = (float)normal.x, y = (float)normal.y, z = (float)normal.z;
        const float square = x * x + y * y + z * z, reciprocal = 1.0f / sqrtf(square);
        const float at_first = (float)ab * reciprocal, at_second = (float)(aa - ab) * reciprocal;
        const int sound = (fabsf(at_first) < flat) & (fabsf(at_second) < flat);
        in_range &= (square > SMALL_SQUARE) & (square < LARGE_SQUARE);
        face->cotangents[0][p] = sound ? at_first : 0.0f;
        face->cotangents[1][p] = sound ? at_second : 0.0f;
        face->x[p] = sound ? x * reciprocal : 0.0f;
        face->y[p] = sound ? y * reciprocal : 0.0f;
        face->z[p] = sound ? z * reciprocal : 0.0f;
    }
    return in_range;
}

/* Round the normal and the cotangents of a triangle to floats. */
static ALWAYS_INLINE void round_face(const Face *from, Py_ssize_t count, FloatFace *face)
{
    for (Py_ssize_t p = 0; p < count; p++) {
        face->cotangents[0][p] = (float)from->cotangents[0][p];
        face->cotangents[1][p] = (float)from->cotangents[1][p];
        face->x[p] = (float)from->x[p], face->y[p] = (float)from->y[p], face->z[p] = (float)from->z[p];
    }
}

/* Find the angles of a triangle. The third is what the other two leave of π, to the same absolute rounding. */
static ALWAYS_INLINE void find_angles_of_face(Face *face, Py_ssize_t count)
{
    for (Py_ssize_t p = 0; p < count; p++) {
        const double at_first = angle_of(face->cotangents[0][p]), at_second = angle_of(face->cotangents[1][p]);
        face->angles[0][p] = at_first;
        face->angles[1][p] = at_second;
        face->angles[2][p] = 2.0 * HALF - at_first - at_second;
    }
}

static ALWAYS_INLINE void find_angles_of_float_face(FloatFace *face, Py_ssize_t count)
{
    for (Py_ssize_t p = 0; p < count; p++) {
        const float at_first = angle_of_float(face->cotangents[0][p]);
        const float at_second = angle_of_float(face->cotangents[1][p]);
        face->angles[0][p] = at_first;
        face->angles[1][p] = at_second;
        face->angles[2][p] = (float)(2.0 * HALF) - at_first - at_second;
    }
}
