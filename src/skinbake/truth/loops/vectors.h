/* Vectors, and arrays of vectors by components. */

#pragma once

#include "arguments.h"

/* The poses in work at a time. Their temporaries stay in the processor's first cache. */
enum { STRIP = 64 };

typedef double Strip[STRIP];

typedef struct {
    double x, y, z;
} Vector;

static ALWAYS_INLINE double dot(Vector a, Vector b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static ALWAYS_INLINE Vector minus(Vector a, Vector b) { return (Vector){a.x - b.x, a.y - b.y, a.z - b.z}; }
static ALWAYS_INLINE Vector scaled(double s, Vector a) { return (Vector){s * a.x, s * a.y, s * a.z}; }
static ALWAYS_INLINE Vector cross(Vector a, Vector b)
{
    return (Vector){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

/* An array of vectors by components: x, y and z each with the values of all poses of a vertex. */
typedef struct {
    const double *x, *y, *z;
} Components;

static ALWAYS_INLINE Components components(const double *base, Py_ssize_t stride, Py_ssize_t at)
{
    return (Components){base + at, base + stride + at, base + 2 * stride + at};
}

static ALWAYS_INLINE Vector vector_at(Components from, Py_ssize_t p)
{
    return (Vector){from.x[p], from.y[p], from.z[p]};
}

static ALWAYS_INLINE Vector vertex_at(const double *positions, Py_ssize_t vertex)
{
    return (Vector){positions[3 * vertex], positions[3 * vertex + 1], positions[3 * vertex + 2]};
}

static ALWAYS_INLINE Py_ssize_t least(Py_ssize_t a, Py_ssize_t b) { return a < b ? a : b; }
