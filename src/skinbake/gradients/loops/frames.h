/* The tangent frames of vertices (twin: frames.py). */

#pragma once

#include "scratch.h"

/* A normal as the shader normalises it, in float32 (twin: frames.unit_normals). Returns whether it has a direction. */
static ALWAYS_INLINE int unit_normal(Vector normal, Vector *unit)
{
    const double tiny_square = 1e-280; /* frames.TINY_SQUARE */
    int sound = isfinite(normal.x) && isfinite(normal.y) && isfinite(normal.z) &&
                (normal.x != 0.0 || normal.y != 0.0 || normal.z != 0.0);
    double square = dot(normal, normal);
    /* The square of a very long or short normal loses digits: it is scaled first. */
    if (sound && !(square >= tiny_square && isfinite(square))) {
        double largest = fmax(fmax(fabs(normal.x), fabs(normal.y)), fabs(normal.z));
        normal = (Vector){normal.x / largest, normal.y / largest, normal.z / largest};
        square = dot(normal, normal);
    }
    double length = sqrt(square);
    *unit = sound ? (Vector){(float)(normal.x / length), (float)(normal.y / length), (float)(normal.z / length)}
                  : (Vector){0.0, 0.0, 1.0};
    return sound;
}

/* The parts of two vectors along a and b. With the vector across = a x b, of length `area`, these are a basis. */
typedef struct {
    Pair a, b;
} Parts;
static ALWAYS_INLINE Parts parts_along(Vectors v, Vector a, Vector b, Vector across, double area)
{
    const Vectors normal = both_vectors(across);
    const Pair squared = both(area * area);
    return (Parts){divide_pairs(dots(crosses(v, both_vectors(b)), normal), squared),
                   divide_pairs(dots(crosses(both_vectors(a), v), normal), squared)};
}

/* The normal of a vertex as the shader normalises it. Most vertices are asked for twice in a row. */
static ALWAYS_INLINE Vector unit_of(const Surface *s, size_t vertex, Latest *latest)
{
    if (vertex != latest->vertex || !latest->known) {
        latest->directed = unit_normal(row3(s->normals, s->wide_normals, vertex), &latest->unit);
        latest->vertex = vertex, latest->known = 1;
    }
    return latest->unit;
}

/* The frame of Duff et al. 2017 around a unit normal, in float32 and in this order of operations: shaders get the
   same bits (twin: frames.frame_from_normal). */
static ALWAYS_INLINE void frame_from_unit(Vector normal, Vector *tangent, Vector *bitangent)
{
    float x = (float)normal.x, y = (float)normal.y, z = (float)normal.z;
    float sign = z >= 0.0f ? 1.0f : -1.0f;
    float a = -1.0f / (sign + z);
    float b = (x * y) * a;
    float along = 1.0f + sign * ((x * x) * a), across = sign + (y * y) * a;
    *tangent = (Vector){along, sign * b, -sign * x};
    *bitangent = (Vector){b, across, -y};
}

/* The tangent and the bitangent of a vertex. */
static ALWAYS_INLINE void find_frame(const Surface *s, size_t vertex, Latest *latest, Vector *tangent,
                                     Vector *bitangent)
{
    if (s->tangents) {
        *tangent = row3(s->tangents, s->wide_frame, vertex);
        *bitangent = row3(s->bitangents, s->wide_frame, vertex);
    } else {
        frame_from_unit(unit_of(s, vertex, latest), tangent, bitangent);
    }
}
