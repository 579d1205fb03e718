/* The surface to bake, its results, and its corners and vertices by weld class. */

#pragma once

#include "vectors.h"

#define NO_JOINT (-1)
#define NO_CHAIN (-1)

/* The weights of corners in the mean (see weight_gradients.py). The module has constants of these names. */
typedef enum { BY_MAX, BY_ANGLE, BY_AREA, BY_ANGLE_AREA, WEIGHTINGS } Weighting;

/* How gradients are fitted to a rig: the constants of fit_rules.py. */
typedef struct {
    double stiffness, turn, together, collapsed, ray, even, unfelt, narrow, flat, flat_tilt, bounded, small;
} FitSettings;

/* The surface to bake: V vertices with K slots each, T triangles, C weld classes. Rows as in the twins. */
typedef struct {
    const void *positions, *normals, *tangents, *bitangents; /* (V, 3) of floats or doubles */
    int wide_positions, wide_normals, wide_frame;            /* tangents NULL: the frame comes from normals */
    const uint32_t *triangles; /* (T, 3) */
    const int32_t *joints;     /* (V, K), NO_JOINT where a slot has none */
    const double *weights;     /* (V, K) */
    const uint8_t *free_slots; /* (V, K): whether a slot may adopt a joint */
    const int32_t *classes;    /* (V,) */
    Py_ssize_t vertices, slots, triangle_count, class_count, joint_count;
    Weighting weighting;
    int adopts;
    double negligible;
    const int32_t *parents, *ranks; /* (J,) of the rig to fit to, NULL for none; see rig.py */
    const double *pivots;           /* (J, 3), NaN where a joint does not turn */
    const int32_t *chains;          /* (J,): a long chain's number, the same for all its joints, or NO_CHAIN */
    const double *poses;            /* (J, G, 12, 4): upper rows of joint matrices in G groups of four poses */
    const double *pose_shares;      /* (4 G): 1 over the number of poses, 0 where a group has less than four */
    size_t pose_groups;
    Py_ssize_t rig_joints;
    FitSettings fit;
} Surface;

/* The sums over the vertices of one primitive: a row of float64. */
typedef struct {
    double adopting, overflowing; /* numbers of vertices */
    double magnitude, unheld;     /* of all gradients; of the gradients that no slot holds */
} Sums;

typedef struct {
    float *alpha, *beta; /* (V, K - 1) */
    int32_t *adopted;    /* (V, K) of zeros; 1 + joint if a slot adopts one */
    const uint64_t *ends; /* (P,): the end of the rows of each primitive */
    size_t primitives;
    Sums *sums; /* (P,) */
} Baked;

/* Members of every group, in ascending order. Group g has start[g] ... start[g + 1]. */
typedef struct {
    uint32_t *start, *members;
} Groups;

/* While the GIL is released, another thread may write to the arrays. So every index is checked at its use, on the
   value that is used. The checks of earlier loops do not count. STRAY_INDEX means an index out of range. Members of
   groups are zeros at first: if classes change between counting and filling, a member may never be written. */

/* The class of a vertex; class_count if there is no such vertex or class. */
static ALWAYS_INLINE size_t class_of(const Surface *s, size_t vertex)
{
    size_t found = vertex < (size_t)s->vertices ? (size_t)(uint32_t)s->classes[vertex] : (size_t)s->class_count;
    return found < (size_t)s->class_count ? found : (size_t)s->class_count;
}

/* Group so many vertices or corners by weld class, by counting. vertices[n] is the vertex of corner n, whose member is
   4 t + i for corner i of triangle t. If it is NULL, the members are the vertices themselves. */
static ALWAYS_INLINE Status group(const Surface *s, size_t count, const uint32_t *vertices, Groups *groups)
{
    const size_t classes = (size_t)s->class_count;
    groups->start = allocate_zeros(classes + 2, sizeof *groups->start);
    groups->members = allocate_zeros(count + 1, sizeof *groups->members);
    if (!groups->start || !groups->members)
        return NO_MEMORY;
    uint32_t *next = groups->start + 1; /* one ahead: filling moves every start to its place */
    /* Count the members of each class. */
    for (size_t n = 0; n < count; n++) {
        const size_t c = class_of(s, vertices ? vertices[n] : n);
        if (c == classes)
            return STRAY_INDEX;
        next[c + 1]++;
    }
    /* The sums of the counts are where the classes begin. */
    for (size_t c = 0; c < classes; c++)
        next[c + 1] += next[c];
    for (size_t n = 0; n < count; n++) {
        const size_t c = class_of(s, vertices ? vertices[n] : n);
        if (c == classes || next[c] >= count)
            return STRAY_INDEX;
        groups->members[next[c]++] = (uint32_t)(vertices ? n / 3 * 4 + n % 3 : n);
    }
    return DONE;
}

static Status group_corners(const Surface *s, Groups *groups)
{
    return group(s, 3 * (size_t)s->triangle_count, s->triangles, groups);
}

/* If every class is one vertex of the same number, members stay NULL. */
static Status group_vertices(const Surface *s, Groups *groups)
{
    const size_t vertices = (size_t)s->vertices;
    size_t v = 0;
    while (v < vertices && s->classes[v] == (int32_t)v)
        v++;
    if (v == vertices && (size_t)s->class_count == vertices)
        return DONE;
    return group(s, vertices, NULL, groups);
}

/* The corners and the vertices of a surface by weld class, and the numbers that it was made for. */
typedef struct {
    Groups corners, vertices;
    Py_ssize_t joint_count, vertex_count, slots, triangle_count, class_count;
} Grouped;

static void free_grouped(Grouped *grouped)
{
    free(grouped->corners.start), free(grouped->corners.members);
    free(grouped->vertices.start), free(grouped->vertices.members);
}

static Status group_all(const Surface *s, Grouped *grouped)
{
    *grouped = (Grouped){.joint_count = s->joint_count,
                         .vertex_count = s->vertices,
                         .slots = s->slots,
                         .triangle_count = s->triangle_count,
                         .class_count = s->class_count};
    Status status = group_corners(s, &grouped->corners);
    return status == DONE ? group_vertices(s, &grouped->vertices) : status;
}
