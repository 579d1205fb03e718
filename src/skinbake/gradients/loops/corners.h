/* The corners of a weld class: edges, weights in the mean, differences along edges (twin: weight_gradients.py). */

#pragma once

#include "scratch.h"

/* Write the ends of some corners. */
static ALWAYS_INLINE void find_ends(const Surface *s, Members some, Corners *c, Scratch *w)
{
    const size_t vertices = (size_t)s->vertices;
    for (size_t n = 0; n < some.count; n++) {
        /* A corner is 4 t + i: corner i of triangle t. */
        static const uint8_t following[] = {1, 2, 0}, last[] = {2, 0, 1};
        const uint32_t *triangle = s->triangles + 3 * (size_t)(some.first[n] >> 2);
        uint32_t one = triangle[following[some.first[n] & 3]], other = triangle[last[some.first[n] & 3]];
        if (one >= vertices || other >= vertices)
            one = other = 0, w->stray = 1;
        c->ends[n][0] = one, c->ends[n][1] = other;
    }
}

/* Write the edges of at most AT_ONCE corners, whose class is at `origin`. The first one fills the rest. */
static ALWAYS_INLINE void find_edges(const Surface *s, Shape shape, Vector origin, Members some, Corners *c)
{
    Vector e1[AT_ONCE], e2[AT_ONCE];
    for (size_t n = 0; n < some.count; n++) {
        e1[n] = minus(row3(s->positions, shape.wide, c->ends[n][0]), origin);
        e2[n] = minus(row3(s->positions, shape.wide, c->ends[n][1]), origin);
    }
    /* What is missing is filled up, so that four corners go through at once. */
    for (size_t n = some.count; n < AT_ONCE; n++)
        e1[n] = e1[0], e2[n] = e2[0];
    c->edges[X1] = four(e1[0].x, e1[1].x, e1[2].x, e1[3].x);
    c->edges[Y1] = four(e1[0].y, e1[1].y, e1[2].y, e1[3].y);
    c->edges[Z1] = four(e1[0].z, e1[1].z, e1[2].z, e1[3].z);
    c->edges[X2] = four(e2[0].x, e2[1].x, e2[2].x, e2[3].x);
    c->edges[Y2] = four(e2[0].y, e2[1].y, e2[2].y, e2[3].y);
    c->edges[Z2] = four(e2[0].z, e2[1].z, e2[2].z, e2[3].z);
}

static ALWAYS_INLINE Four four_dot(const Four *a, const Four *b)
{
    return add(add(multiply(a[0], b[0]), multiply(a[1], b[1])), multiply(a[2], b[2]));
}

/* Work out weights and coefficients from the edges. With n = e1 x e2, weight_gradients.py's e2 x n is
   e1 |e2|^2 - e2 (e1 . e2), and n x e1 likewise. */
static ALWAYS_INLINE void weigh_corners(Corners *c, Weighting weighting, Facets *facets)
{
    const Four *e1 = c->edges + X1, *e2 = c->edges + X2;
    Four normal[3] = {
        subtract(multiply(e1[1], e2[2]), multiply(e1[2], e2[1])),
        subtract(multiply(e1[2], e2[0]), multiply(e1[0], e2[2])),
        subtract(multiply(e1[0], e2[1]), multiply(e1[1], e2[0])),
    };
    /* The squares that weights and coefficients share. */
    Four squared_area2 = four_dot(normal, normal), dots = four_dot(e1, e2);
    Four squared1 = four_dot(e1, e1), squared2 = four_dot(e2, e2), area2 = root(squared_area2), scale;
    if (facets != NULL)
        *facets = (Facets){{normal[0], normal[1], normal[2]}, area2, multiply(squared1, squared2)};
    if (weighting == BY_MAX) { /* 1 / (|e1|^2 |e2|^2) times |e1 x e2| */
        scale = divide(four(1.0, 1.0, 1.0, 1.0), multiply(multiply(area2, squared1), squared2));
        store(c->weight, multiply(squared_area2, scale));
    } else {
        double areas[AT_ONCE], cosines[AT_ONCE];
        store(areas, area2);
        store(cosines, dots);
        for (int n = 0; n < AT_ONCE; n++) {
            c->weight[n] = weighting == BY_AREA ? areas[n] : atan2(areas[n], cosines[n]);
            c->weight[n] *= weighting == BY_ANGLE_AREA ? areas[n] : 1.0;
        }
        scale = divide(load(c->weight), squared_area2);
    }
    /* The weight times the gradients of both hats. */
    Four mixed = multiply(dots, scale), own1 = multiply(squared2, scale), own2 = multiply(squared1, scale);
    for (int axis = 0; axis < 3; axis++) {
        store(c->coefficients[X1 + axis], subtract(multiply(e1[axis], own1), multiply(e2[axis], mixed)));
        store(c->coefficients[X2 + axis], subtract(multiply(e2[axis], own2), multiply(e1[axis], mixed)));
    }
}

static ALWAYS_INLINE void add_scaled(Scratch *w, int32_t number, Vector v, double by)
{
    w->x[number] += v.x * by;
    w->y[number] += v.y * by;
    w->z[number] += v.z * by;
}

/* Add coefficient x (weight there - weight here) for every joint that either vertex has. Return the number of
   local numbers in use. All sums run over differences of weights, so the sum of a constant weight is 0 exactly. */
static ALWAYS_INLINE int32_t add_differences(const Surface *s, size_t neighbour, Vector c, int32_t used, Scratch *w)
{
    const int32_t slots = (int32_t)s->slots;
    const int32_t *there = s->joints + neighbour * (size_t)slots;
    const double *weight = s->weights + neighbour * (size_t)slots;
    w->visit++;
    for (int32_t k = 0; k < slots; k++) {
        if (weight[k] == 0.0)
            continue;
        const int32_t joint = there[k];
        if ((size_t)(uint32_t)joint >= (size_t)s->joint_count) {
            w->stray = 1;
            continue;
        }
        /* A joint that is new to the class gets the next local number. */
        int32_t number = w->local[joint];
        if (number < 0) {
            number = w->local[joint] = used++;
            w->met[number] = joint;
            w->x[number] = w->y[number] = w->z[number] = 0.0;
        }
        /* w there − w here; a joint without a slot of the class weighs 0 here. */
        w->seen[number] = w->visit;
        add_scaled(w, number, c, number < slots ? weight[k] - w->own[number] : weight[k]);
    }
    for (int32_t k = 0; k < slots; k++)
        if (w->seen[k] != w->visit && w->own[k] != 0.0)
            add_scaled(w, k, c, -w->own[k]);
    return used;
}

/* Whether a vertex has the same joints as another, slot by slot. Then its differences need no look-up. */
static ALWAYS_INLINE int same_joints(const Surface *s, size_t slots, size_t here, size_t there)
{
    return memcmp(s->joints + here * slots, s->joints + there * slots, slots * sizeof *s->joints) == 0;
}
