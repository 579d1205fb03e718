/* How the ring of a class lies in the poses of the fit, four of them at once (twin: posed_rings.py). */

#pragma once

#include "frames.h"

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

/* The matrices of a joint in four poses: MATRIX numbers, each of them four times. */
static ALWAYS_INLINE const double *matrices_of(const Surface *s, int32_t joint, size_t group)
{
    return s->poses + ((size_t)joint * s->pose_groups + group) * MATRIX * AT_ONCE;
}

static ALWAYS_INLINE Four entry_of(const double *matrices, int row, int column)
{
    return load(matrices + AT_ONCE * (4 * row + column));
}

/* A vector turned and stretched by the linear parts of four matrices. */
static ALWAYS_INLINE Vector4 turned_by(const double *m, Vector v)
{
    Four rows[3];
    for (int row = 0; row < 3; row++)
        rows[row] = add(add(multiply(entry_of(m, row, 0), all(v.x)), multiply(entry_of(m, row, 1), all(v.y))),
                        multiply(entry_of(m, row, 2), all(v.z)));
    return (Vector4){rows[0], rows[1], rows[2]};
}

static ALWAYS_INLINE Vector4 translation_of(const double *m)
{
    return (Vector4){entry_of(m, 0, 3), entry_of(m, 1, 3), entry_of(m, 2, 3)};
}

/* What a class says in all poses, from its rest pose. */
typedef struct {
    Vector position, derivatives[2];
    Parts parts;      /* of both tangents, along both derivatives */
    Pair along_third; /* and across them */
    double area;      /* between the derivatives */
} RestRing;

/* Pose the ring of a class, whose products are summed up but not yet made into turns, in four poses. The matrix of a
   joint that has no weight and none that changes may hold NaN. */
static ALWAYS_INLINE void pose_four(const Surface *s, const RestRing *rest, double shrink, int32_t used, size_t group,
                                    Scratch *w)
{
    const Four none = all(0.0);
    Four blended[3][3] = {{none, none, none}, {none, none, none}, {none, none, none}};
    Four rigid = none, reach = none, bound = none;
    Vector4 point = {none, none, none};
    /* Where each joint takes the class, and the blend of those that have weights. */
    for (int32_t n = 0; n < used; n++) {
        if (w->met[n] < 0)
            continue;
        const double *m = matrices_of(s, w->met[n], group);
        const Vector4 along = translation_of(m), end = plus4(turned_by(m, rest->position), along);
        store4(ends_of(s, w, n, group), end);
        if (n >= s->slots || !(w->own[n] > 0.0))
            continue;
        const Four weight = all(w->own[n]);
        point = plus4(point, times4(end, weight));
        reach = add(reach, multiply(weight, add(extent4(end), extent4(along))));
        for (int row = 0; row < 3; row++)
            for (int column = 0; column < 3; column++) {
                const Four entry = entry_of(m, row, column), part = multiply(weight, entry);
                blended[row][column] = add(blended[row][column], part);
                rigid = add(rigid, multiply(part, entry));
            }
    }
    rigid = divide(rigid, all(3.0));
    /* The posed derivatives: L D + Σ_j (Δw g L_j e + Δw g (M_j p − p')), and a bound of what is added. */
    const Vector4 rows[3] = {{blended[0][0], blended[0][1], blended[0][2]},
                             {blended[1][0], blended[1][1], blended[1][2]},
                             {blended[2][0], blended[2][1], blended[2][2]}};
    Vector4 posed[2] = {by_rows(rows, rest->derivatives[0]), by_rows(rows, rest->derivatives[1])};
    for (int32_t n = 0; n < used; n++) {
        const double *products = w->turns + n * TURN;
        if (w->met[n] < 0 || !turns_at_all(products))
            continue;
        const double *m = matrices_of(s, w->met[n], group);
        const Vectors edges = times_each(load_vectors(products + BY_EDGE), both(shrink));
        const Pair along = scaled(shrink, load_pair(products + BY_ITSELF));
        const Vector4 end = load4(ends_of(s, w, n, group)), over = minus4(end, point);
        for (int u = 0; u < 2; u++) {
            const Vector4 turned = turned_by(m, one_of(edges, u));
            posed[u] = plus4(posed[u], plus4(turned, times4(over, all(part(along, u)))));
            bound = add(bound, extent4(turned));
        }
        const double coefficients = fabs(part(along, 0)) + fabs(part(along, 1));
        const Four terms = add(add(reach, extent4(end)), extent4(translation_of(m)));
        bound = add(bound, multiply(all(coefficients), terms));
    }
    /* F: the third vector goes across the posed surface, by the root of how its area grows, and to the other side where
       joints mirror. */
    const Vector4 across = cross4(posed[0], posed[1]);
    const Four area = root(dot4(across, across)), growth = root(divide(area, all(rest->area)));
    const Four mirrored = only(above(none, dot4(cross4(rows[0], rows[1]), rows[2])), all(2.0));
    const Vector4 third = times4(across, divide(multiply(subtract(all(1.0), mirrored), growth), area));
    Vector4 mapped[2];
    for (int u = 0; u < 2; u++)
        mapped[u] = plus4(plus4(times4(posed[0], all(part(rest->parts.a, u))), times4(posed[1], all(part(rest->parts.b, u)))),
                          times4(third, all(part(rest->along_third, u))));
    Vector4 normal = cross4(mapped[0], mapped[1]);
    normal = times4(normal, divide(all(1.0), root(dot4(normal, normal))));
    /* Where the surface shrinks to a line, or terms cancel, its normal is rounding. */
    const Four length = root(add(dot4(posed[0], posed[0]), dot4(posed[1], posed[1])));
    const Four least = multiply(multiply(all(s->fit.flat * s->fit.flat), add(bound, root(rigid))), length);
    Mask counts = each_of(above(bound, none), above(area, least));
    counts = each_of(counts, is_finite(add(rigid, dot4(normal, normal))));
    PosedRing *ring = &w->posed[group];
    const Four share = only(counts, load(s->pose_shares + group * AT_ONCE));
    normal = only4(counts, normal);
    store(ring->share, share);
    store4(ring->normal, normal);
    store(ring->least, multiply(all(2.0 * s->fit.collapsed), rigid));
    for (int u = 0; u < 2; u++) {
        const Vector4 still = only4(counts, by_rows(rows, w->frame.tangents[u]));
        store4(ring->still[u], still);
        store(ring->tilts[u], dot4(still, normal));
    }
}

/* Pose the ring of a sound class. derivatives are those of the positions, at rest. */
FOR_PROCESSORS(void, pose_ring,
               (const Surface *s, const Vector *position, const Vectors *derivatives, double shrink, int32_t used,
                Scratch *w),
               (s, position, derivatives, shrink, used, w))
{
    const Vector a = one_of(*derivatives, 0), b = one_of(*derivatives, 1), across = cross(a, b);
    const double area = sqrt(dot(across, across));
    const Vectors tangents = w->frame.along;
    const RestRing rest = {*position,
                           {a, b},
                           parts_along(tangents, a, b, across, area),
                           divide_pairs(dots(tangents, both_vectors(across)), both(area)),
                           area};
    for (size_t group = 0; group < s->pose_groups; group++)
        pose_four(s, &rest, shrink, used, group, w);
}
