/* Dual quaternion skinning of rigid joints (twins: by_numpy.dqs_positions, by_numpy.dqs_normals).

   The formulas and letters are those of skinning/dqs.py. */

#pragma once

#include "vectors.h"

/* The poses in work at a time: the mix, its two rates and the joints' motions stay in the first cache. */
enum { MIXED = 32 };

typedef struct {
    double real;
    Vector vector;
    double dual;
    Vector dual_vector;
} DualQuaternion;

/* Eight components: each has the values of all poses in work. */
typedef double Mix[8][MIXED];

/* Take the dual quaternion of a pose from components that are `apart`. */
static ALWAYS_INLINE DualQuaternion dual_at(const double *from, Py_ssize_t apart, Py_ssize_t p)
{
    const double *dual = from + 4 * apart + p;
    return (DualQuaternion){
        .real = from[p],
        .vector = {from[apart + p], from[2 * apart + p], from[3 * apart + p]},
        .dual = dual[0],
        .dual_vector = {dual[apart], dual[2 * apart], dual[3 * apart]},
    };
}

static ALWAYS_INLINE DualQuaternion mixed_at(Mix mix, Py_ssize_t p) { return dual_at(mix[0], MIXED, p); }

static ALWAYS_INLINE void put(Mix mix, Py_ssize_t p, DualQuaternion value)
{
    mix[0][p] = value.real, mix[4][p] = value.dual;
    mix[1][p] = value.vector.x, mix[2][p] = value.vector.y, mix[3][p] = value.vector.z;
    mix[5][p] = value.dual_vector.x, mix[6][p] = value.dual_vector.y, mix[7][p] = value.dual_vector.z;
}

static ALWAYS_INLINE Vector plus(Vector a, Vector b) { return (Vector){a.x + b.x, a.y + b.y, a.z + b.z}; }
static ALWAYS_INLINE Vector plus_times(Vector base, double factor, Vector a)
{
    return (Vector){base.x + factor * a.x, base.y + factor * a.y, base.z + factor * a.z};
}

static ALWAYS_INLINE Vector plus_cross(Vector base, Vector a, Vector b)
{
    return (Vector){base.x + a.y * b.z - a.z * b.y, base.y + a.z * b.x - a.x * b.z, base.z + a.x * b.y - a.y * b.x};
}

static ALWAYS_INLINE DualQuaternion plus_share(DualQuaternion base, double factor, DualQuaternion q)
{
    return (DualQuaternion){base.real + factor * q.real, plus_times(base.vector, factor, q.vector),
                            base.dual + factor * q.dual, plus_times(base.dual_vector, factor, q.dual_vector)};
}

/* Return σ Q − Q₀. */
static ALWAYS_INLINE DualQuaternion apart_from(DualQuaternion pivot, double sign, DualQuaternion q)
{
    return (DualQuaternion){sign * q.real - pivot.real, minus(scaled(sign, q.vector), pivot.vector),
                            sign * q.dual - pivot.dual, minus(scaled(sign, q.dual_vector), pivot.dual_vector)};
}

static ALWAYS_INLINE DualQuaternion times(double factor, DualQuaternion q)
{
    return (DualQuaternion){factor * q.real, scaled(factor, q.vector), factor * q.dual, scaled(factor, q.dual_vector)};
}

/* The dot product of two real parts, which are quaternions. */
static ALWAYS_INLINE double real_dot(DualQuaternion a, DualQuaternion b) { return a.real * b.real + dot(a.vector, b.vector); }

/* Return Q / |r|; zero stays zero. */
static ALWAYS_INLINE DualQuaternion normalised(DualQuaternion q)
{
    const double square = real_dot(q, q);
    return times(1.0 / sqrt(square == 0.0 ? 1.0 : square), q);
}

/* Return v + 2 r × (r × v + r₀ v). */
static ALWAYS_INLINE Vector rotated(DualQuaternion unit, Vector v)
{
    return plus_times(v, 2.0, cross(unit.vector, plus_cross(scaled(unit.real, v), unit.vector, v)));
}

/* Return i = r × p + r₀ p + d. */
static ALWAYS_INLINE Vector lever_of(DualQuaternion q, Vector point)
{
    return plus_cross(plus_times(q.dual_vector, q.real, point), q.vector, point);
}

/* Return h = r × i + r₀ d − d₀ r: half the displacement of the point with the lever i, if Q is of unit length. */
static ALWAYS_INLINE Vector half_turn(DualQuaternion q, Vector lever)
{
    return plus_cross(plus_times(scaled(q.real, q.dual_vector), -q.dual, q.vector), q.vector, lever);
}

/* Return t' of algorithm 6. The factor is k, and the displacement δ. */
static ALWAYS_INLINE Vector derivative(DualQuaternion mix, DualQuaternion rate, Vector tangent, Vector point,
                                       Vector lever, double factor, Vector displacement)
{
    /* The derivative of the lever i, by the product rule over r × p + r₀ p + d. */
    Vector lever_rate = plus_times(rate.dual_vector, mix.real, tangent);
    lever_rate = plus_cross(lever_rate, mix.vector, tangent);
    lever_rate = plus_times(lever_rate, rate.real, point);
    lever_rate = plus_cross(lever_rate, rate.vector, point);
    /* That of h, by the product rule over r × i + r₀ d − d₀ r. */
    Vector turn_rate = plus_cross(scaled(mix.real, rate.dual_vector), mix.vector, lever_rate);
    turn_rate = plus_cross(turn_rate, rate.vector, lever);
    turn_rate = plus_times(turn_rate, rate.real, mix.dual_vector);
    turn_rate = plus_times(turn_rate, -rate.dual, mix.vector);
    turn_rate = plus_times(turn_rate, -mix.dual, rate.vector);
    /* That of k, which divides by |r|²: it takes (r · ṙ) δ away. */
    turn_rate = plus_times(turn_rate, -real_dot(mix, rate), displacement);
    return plus_times(tangent, factor, turn_rate);
}

enum {
    MOTIONS,
    SCALES,
    MOTION_JOINTS,
    MOTION_WEIGHTS,
    REST_POSITIONS,
    MOVED,
    DQS_ARRAYS,
    FRAME = DQS_ARRAYS,
    ALONG_T,
    ALONG_B,
    HANDEDNESS,
    DQS_NORMAL_ARRAYS
};

#define DQS_REQUIREMENTS                                \
    [MOTIONS] = {"motions", "d", "MJQ", READ},          \
    [SCALES] = {"scales", "d", "Q", OR_NONE},           \
    [MOTION_JOINTS] = {"joints", "i", "BK", READ},      \
    [MOTION_WEIGHTS] = {"weights", "d", "BK", READ},    \
    [REST_POSITIONS] = {"positions", "d", "B3", READ}

static const Requirement dqs_arrays[DQS_ARRAYS] = {
    DQS_REQUIREMENTS,
    [MOVED] = {"out", "d", "3VP", WRITTEN},
};

static const Requirement dqs_normal_arrays[DQS_NORMAL_ARRAYS] = {
    DQS_REQUIREMENTS,
    [MOVED] = {"out", "d", "33BP", WRITTEN},
    [FRAME] = {"frame", "d", "33B", READ},
    [ALONG_T] = {"alpha", "d", "BL", READ},
    [ALONG_B] = {"beta", "d", "BL", READ},
    [HANDEDNESS] = {"handedness", "d", "B", READ},
};

typedef struct {
    const double *motions, *scales; /* (M, J, Q): their component is `apart` from the next; scales may be NULL */
    const int32_t *joints;
    const double *weights, *positions, *frame, *alpha, *beta, *handedness;
    double *out;
    Py_ssize_t rows, slots, joint_count, poses, all_poses, first_pose, apart;
    Py_ssize_t all_rows, first_row; /* of positions: out has the row `first_row` first */
} Dqs;

/* Some poses of a vertex, from `first` on. pivots are the motions of its slot 0. */
typedef struct {
    const double *pivots;
    Py_ssize_t row, first, poses;
    double scale[MIXED];
} Posing;

/* Return the motions of a slot's joint, NULL if there is no such joint. */
static ALWAYS_INLINE const double *motions_of(const Dqs *s, Py_ssize_t row, Py_ssize_t first, Py_ssize_t slot)
{
    const int32_t joint = s->joints[row * s->slots + slot];
    return joint < 0 || joint >= s->joint_count ? NULL : s->motions + joint * s->all_poses + s->first_pose + first;
}

static ALWAYS_INLINE Posing posing_of(const Dqs *s, Py_ssize_t row, Py_ssize_t first)
{
    Posing at = {motions_of(s, row, first, 0), row, first, least(MIXED, s->poses - first), {0.0}};
    /* The scale that all joints of a pose share; it is applied before the motion. */
    for (Py_ssize_t p = 0; p < at.poses; p++)
        at.scale[p] = s->scales ? s->scales[s->first_pose + first + p] : 1.0;
    return at;
}

static ALWAYS_INLINE double hemisphere(DualQuaternion q, DualQuaternion pivot)
{
    return real_dot(q, pivot) < 0.0 ? -1.0 : 1.0;
}

/* Mix the motions of a vertex: b = Σ w σ Q. Return 1 for a stray joint. */
static ALWAYS_INLINE int mix_motions(const Dqs *s, const Posing *at, Mix mix)
{
    const double *weights = s->weights + at->row * s->slots;
    if (at->pivots == NULL)
        return 1;
    /* Slot 0 is the pivot: its sign is +. */
    for (Py_ssize_t p = 0; p < at->poses; p++)
        put(mix, p, times(weights[0], dual_at(at->pivots, s->apart, p)));
    /* Every other slot takes the sign that brings it to the hemisphere of the pivot. */
    for (Py_ssize_t slot = 1; slot < s->slots; slot++) {
        const double *motions = motions_of(s, at->row, at->first, slot);
        if (motions == NULL)
            return 1;
        if (weights[slot] == 0.0)
            continue;
        for (Py_ssize_t p = 0; p < at->poses; p++) {
            const DualQuaternion q = dual_at(motions, s->apart, p);
            const double sign = hemisphere(q, dual_at(at->pivots, s->apart, p));
            put(mix, p, plus_share(mixed_at(mix, p), sign * weights[slot], q));
        }
    }
    return 0;
}

/* The sums over the slots that depend on α (or β): ḃ for algorithm 6, and the correction of algorithm 5. */
typedef struct {
    Mix rate;
    double x[MIXED], y[MIXED], z[MIXED];
} Along;

/* Add a slot with the derivatives α and β to the sums. Return 1 for a stray joint. */
static ALWAYS_INLINE int add_slot(const Dqs *s, const Posing *at, Py_ssize_t slot, double alpha, double beta,
                                  Along *t, Along *b)
{
    const double *motions = motions_of(s, at->row, at->first, slot);
    if (motions == NULL)
        return 1;
    const Vector rest = vertex_at(s->positions, at->row);
    for (Py_ssize_t p = 0; p < at->poses; p++) {
        /* The difference from the pivot, on one hemisphere. */
        const DualQuaternion pivot = dual_at(at->pivots, s->apart, p), q = dual_at(motions, s->apart, p);
        const DualQuaternion change = apart_from(pivot, hemisphere(q, pivot), q);
        /* Algorithm 6: ḃ = Σ α (σ Q − Q₀). */
        put(t->rate, p, plus_share(mixed_at(t->rate, p), alpha, change));
        put(b->rate, p, plus_share(mixed_at(b->rate, p), beta, change));
        /* Algorithm 5: Σ α (Q p − Q₀ p), as the difference of displacements. */
        const Vector point = scaled(at->scale[p], rest);
        const Vector displacement = scaled(2.0, half_turn(q, lever_of(q, point)));
        const Vector difference = minus(displacement, scaled(2.0, half_turn(pivot, lever_of(pivot, point))));
        t->x[p] += alpha * difference.x, t->y[p] += alpha * difference.y, t->z[p] += alpha * difference.z;
        b->x[p] += beta * difference.x, b->y[p] += beta * difference.y, b->z[p] += beta * difference.z;
    }
    return 0;
}

static ALWAYS_INLINE Vector correction_at(const Along *along, Py_ssize_t p)
{
    return (Vector){along->x[p], along->y[p], along->z[p]};
}

static ALWAYS_INLINE void put_normal(const Dqs *s, Py_ssize_t algorithm, Py_ssize_t at, Vector normal)
{
    const Py_ssize_t apart = s->rows * s->poses;
    double *out = s->out + 3 * algorithm * apart + at;
    out[0] = normal.x, out[apart] = normal.y, out[2 * apart] = normal.z;
}

/* Write the normals of algorithms 4, 5 and 6 in the poses in work. */
static ALWAYS_INLINE void put_normals(const Dqs *s, const Posing *at, Mix mixes, const Along *along_t,
                                      const Along *along_b)
{
    const Py_ssize_t row = at->row, out = row * s->poses + at->first;
    const double *components = s->frame + row;
    /* n0, t0 and b0 of the vertex. */
    Vector frame[3];
    for (int n = 0; n < 3; n++, components += 3 * s->rows)
        frame[n] = (Vector){components[0], components[s->rows], components[2 * s->rows]};
    const Vector rest = vertex_at(s->positions, row);
    /* Algorithm 4: the rotation of the mix alone. */
    for (Py_ssize_t p = 0; p < at->poses; p++)
        put_normal(s, 0, out + p, rotated(normalised(mixed_at(mixes, p)), frame[0]));
    /* Algorithm 5: the rotated tangents and their corrections; the normal is their cross product. */
    for (Py_ssize_t p = 0; p < at->poses; p++) {
        const DualQuaternion unit = normalised(mixed_at(mixes, p));
        const Vector t = plus(rotated(unit, scaled(at->scale[p], frame[1])), correction_at(along_t, p));
        const Vector b = plus(rotated(unit, scaled(at->scale[p], frame[2])), correction_at(along_b, p));
        put_normal(s, 1, out + p, scaled(s->handedness[row], cross(t, b)));
    }
    for (Py_ssize_t p = 0; p < at->poses; p++) {
        /* Algorithm 6: the mix is not normalised, so k = 2 / |r|² stands in its place. */
        const DualQuaternion mix = mixed_at(mixes, p);
        const double square = real_dot(mix, mix), factor = 2.0 / (square == 0.0 ? 1.0 : square);
        const Vector point = scaled(at->scale[p], rest), lever = lever_of(mix, point);
        const Vector displacement = scaled(factor, half_turn(mix, lever));
        /* t' and b', and the normal from both. */
        const DualQuaternion rate_t = dual_at(along_t->rate[0], MIXED, p), rate_b = dual_at(along_b->rate[0], MIXED, p);
        const Vector tangent = scaled(at->scale[p], frame[1]), bitangent = scaled(at->scale[p], frame[2]);
        const Vector t = derivative(mix, rate_t, tangent, point, lever, factor, displacement);
        const Vector b = derivative(mix, rate_b, bitangent, point, lever, factor, displacement);
        put_normal(s, 2, out + p, scaled(s->handedness[row], cross(t, b)));
    }
}

FOR_WIDE_PROCESSORS(int, move_by_dqs, (const Dqs *s), (s))
{
    Mix mix;
    for (Py_ssize_t row = 0; row < s->rows; row++) {
        const Vector rest = vertex_at(s->positions, row);
        for (Py_ssize_t first = 0; first < s->poses; first += MIXED) {
            const Posing at = posing_of(s, row, first);
            if (mix_motions(s, &at, mix))
                return 1;
            double *out = s->out + (s->first_row + row) * s->poses + first;
            const Py_ssize_t apart = s->all_rows * s->poses;
            /* p' = s p + 2 h of the normalised mix. */
            for (Py_ssize_t p = 0; p < at.poses; p++) {
                const DualQuaternion unit = normalised(mixed_at(mix, p));
                const Vector point = scaled(at.scale[p], rest);
                const Vector posed = plus_times(point, 2.0, half_turn(unit, lever_of(unit, point)));
                out[p] = posed.x, out[apart + p] = posed.y, out[2 * apart + p] = posed.z;
            }
        }
    }
    return 0;
}

FOR_WIDE_PROCESSORS(int, turn_by_dqs, (const Dqs *s), (s))
{
    Mix mix;
    Along t, b;
    for (Py_ssize_t row = 0; row < s->rows; row++) {
        const double *alpha = s->alpha + row * (s->slots - 1), *beta = s->beta + row * (s->slots - 1);
        for (Py_ssize_t first = 0; first < s->poses; first += MIXED) {
            const Posing at = posing_of(s, row, first);
            if (mix_motions(s, &at, mix))
                return 1;
            /* What α and β add. Most slots have neither. */
            memset(&t, 0, sizeof t), memset(&b, 0, sizeof b);
            for (Py_ssize_t slot = 1; slot < s->slots; slot++)
                if ((alpha[slot - 1] != 0.0 || beta[slot - 1] != 0.0) &&
                    add_slot(s, &at, slot, alpha[slot - 1], beta[slot - 1], &t, &b))
                    return 1;
            put_normals(s, &at, mix, &t, &b);
        }
    }
    return 0;
}
