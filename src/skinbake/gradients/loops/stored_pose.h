/* The tilt of tangents in the stored pose of the rig, against the mesh in that pose (twin: stored_pose.py). */

#pragma once

#include "frames.h"

/* The upper rows of a joint matrix, row by row. */
enum { MATRIX = 12 };

/* Vectors turned and stretched by the linear part of a matrix. */
static ALWAYS_INLINE Vectors turned_by(const double matrix[MATRIX], Vectors v)
{
    Vectors rows[3];
    for (int row = 0; row < 3; row++)
        rows[row] = both_vectors((Vector){matrix[4 * row], matrix[4 * row + 1], matrix[4 * row + 2]});
    return (Vectors){dots(rows[0], v), dots(rows[1], v), dots(rows[2], v)};
}

/* The root of both squared lengths, added. */
static ALWAYS_INLINE double length_of(Vectors v)
{
    const Pair squares = dots(v, v);
    return sqrt(part(squares, 0) + part(squares, 1));
}

/* A position moved by a matrix. */
static ALWAYS_INLINE Vector moved_by(const double matrix[MATRIX], Vector position)
{
    double moved[3];
    for (int row = 0; row < 3; row++)
        moved[row] = dot((Vector){matrix[4 * row], matrix[4 * row + 1], matrix[4 * row + 2]}, position) +
                     matrix[4 * row + 3];
    return (Vector){moved[0], moved[1], moved[2]};
}

/* Whether a turn, or the sums of which it is made, is anything but zeros. Their bits are zeros but for the sign. */
static ALWAYS_INLINE int turns_at_all(const double turn[TURN])
{
#if defined(__GNUC__)
    Words any = (Words)load(turn) | (Words)load(turn + AT_ONCE) | (Words)load(turn + 2 * AT_ONCE);
    return (uint64_t)(any[0] | any[1] | any[2] | any[3]) << 1 != 0;
#else
    int turns = 0;
    for (int m = 0; m < TURN; m++)
        turns |= turn[m] != 0.0;
    return turns;
#endif
}

static ALWAYS_INLINE const double *stored_matrix(const Surface *s, int32_t joint)
{
    return s->stored + MATRIX * (size_t)joint;
}

/* A bound of the numbers of which `moved` is made: rounding of a moved position is a share of it. */
static double terms_of(const double matrix[MATRIX], Vector moved)
{
    const Vector along = {matrix[3], matrix[7], matrix[11]};
    return sqrt(dot(moved, moved)) + sqrt(dot(along, along));
}

/* Blend the matrices of a class. Return what both tangents' squared lengths are if nothing stretches them, added. Find
   the terms of the class's point. */
static double blend_stored(const Surface *s, Vector position, const Scratch *w, double blended[MATRIX], double *terms)
{
    double unstretched = 0.0;
    memset(blended, 0, MATRIX * sizeof *blended);
    for (Py_ssize_t k = 0; k < s->slots; k++) {
        if (!(w->own[k] > 0.0) || w->met[k] < 0)
            continue;
        /* The blended matrix, and the terms whose rounding its point has. */
        const double *matrix = stored_matrix(s, w->met[k]);
        for (int m = 0; m < MATRIX; m++)
            blended[m] += w->own[k] * matrix[m];
        *terms += w->own[k] * terms_of(matrix, moved_by(matrix, position));
        /* What each joint alone would make of the tangents' lengths. */
        const Vectors turned = turned_by(matrix, w->frame.along);
        const Pair squares = dots(turned, turned);
        unstretched += w->own[k] * (part(squares, 0) + part(squares, 1));
    }
    return unstretched;
}

/* Add what changes of weights add to the posed derivatives of a class, whose products are summed up but not yet made
   into turns. Return a bound of what is added, 0 where no weight changes: `terms` are those of the class's point. The
   matrix of a joint whose weight does not change may hold NaN. */
static double add_changes(const Surface *s, Vector position, double shrink, int32_t used, double terms,
                          const Scratch *w, Vectors *posed)
{
    double bound = 0.0;
    for (int32_t n = 0; n < used; n++) {
        const double *products = w->turns + n * TURN;
        if (w->met[n] < 0 || !turns_at_all(products))
            continue;
        const double *matrix = stored_matrix(s, w->met[n]);
        /* Σ Δw g e and Σ Δw g of the joint, as means over the corners. */
        const Vectors edges = times_each(load_vectors(products + BY_EDGE), both(shrink));
        const Pair along = scaled(shrink, load_pair(products + BY_ITSELF));
        const Vector moved = moved_by(matrix, position), over = minus(moved, w->frame.stored.point);
        const Vectors turned = turned_by(matrix, edges);
        const Pair squares = multiply_pairs(along, along);
        /* L Σ Δw g e + Σ Δw g (M p − p'). */
        bound += length_of(turned) + sqrt(part(squares, 0) + part(squares, 1)) * (terms + terms_of(matrix, moved));
        *posed = plus_each(*posed, plus_each(turned, times_each(both_vectors(over), along)));
    }
    return bound;
}

/* The tangents that the mesh has in the pose, from its derivatives at rest and there. */
static Vectors mapped_tangents(Vectors tangents, Vectors derivatives, Vectors posed)
{
    const Vector a = one_of(derivatives, 0), b = one_of(derivatives, 1), across = cross(a, b);
    const Vector posed_a = one_of(posed, 0), posed_b = one_of(posed, 1), posed_across = cross(posed_a, posed_b);
    const double area = sqrt(dot(across, across)), posed_area = sqrt(dot(posed_across, posed_across));
    /* The vector across the posed surface, by the root of how its area grows. */
    const Vector third = times(posed_across, sqrt(posed_area / area) / posed_area);
    const Parts parts = parts_along(tangents, a, b, across, area);
    const Pair along_third = divide_pairs(dots(tangents, both_vectors(across)), both(area));
    return plus_each(plus_each(times_each(both_vectors(posed_a), parts.a), times_each(both_vectors(posed_b), parts.b)),
                     times_each(both_vectors(third), along_third));
}

/* Measure the tilt of a sound class in the stored pose. derivatives are those of the positions, at rest. */
static void find_stored_tilt(const Surface *s, Vector position, Vectors derivatives, double shrink, int32_t used,
                             Scratch *w)
{
    StoredTilt *stored = &w->frame.stored;
    double blended[MATRIX], terms = 0.0;
    const double unstretched = blend_stored(s, position, w, blended, &terms);
    /* The class in the pose: its point, and the derivatives of positions. */
    stored->point = moved_by(blended, position);
    Vectors posed = turned_by(blended, derivatives);
    const double bound = add_changes(s, position, shrink, used, terms, w, &posed);
    /* Where the surface shrinks to a line, or terms cancel, its normal is rounding. */
    const Vector across = cross(one_of(posed, 0), one_of(posed, 1));
    const double least = s->fit.flat * s->fit.flat * (bound + sqrt(unstretched));
    const int clear = bound > 0.0 && sqrt(dot(across, across)) > least * length_of(posed);
    /* The tangents that the mesh has there, and the tilt of the blended ones. */
    const Vectors mapped = mapped_tangents(w->frame.along, derivatives, posed);
    const Pair squares = dots(mapped, mapped);
    const double lengths = part(squares, 0) + part(squares, 1), most = s->fit.stretched;
    const Vector normal = cross(one_of(mapped, 0), one_of(mapped, 1));
    stored->normal = times(normal, 1.0 / sqrt(dot(normal, normal)));
    stored->tilts = dots(both_vectors(stored->normal), turned_by(blended, w->frame.along));
    /* A class counts if all is finite, and the pose does not stretch it much. */
    const double sum = part(stored->tilts, 0) + part(stored->tilts, 1) + dot(stored->normal, stored->normal);
    const int counts = clear && lengths <= most * unstretched && unstretched <= most * lengths && isfinite(sum);
    stored->weight = counts ? 2.0 / lengths : 0.0; /* lengths of 0 do not count: the normal is not finite */
}
