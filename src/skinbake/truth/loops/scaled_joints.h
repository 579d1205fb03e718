/* Dual quaternion skinning where joints scale, shear or mirror (twins: by_numpy.dqs_positions, by_numpy.dqs_normals).

   The formulas and letters are those of skinning/dqs_scaled.py. A motion is 4 rows of 5 columns. The calls at the end
   serve rigid joints, too. */

#pragma once

#include "dual_quaternions.h"

enum { COLUMNS = 5, ROTATION = 4, DUAL = 8, SCALED = 20 };

typedef struct {
    double real;
    Vector vector;
} Quaternion;

/* The numbers of a mix of motions in all poses in work. */
typedef double ScaledMix[SCALED][MIXED];

/* What α (or β) adds: to G and to B for algorithm 6, and the correction of algorithm 5. */
typedef struct {
    double moves[4][MIXED], turns[4][MIXED], correction[3][MIXED];
} ScaledAlong;

/* Return a column of a motion, of numbers that are `apart`. */
static ALWAYS_INLINE Quaternion column_at(const double *motion, Py_ssize_t apart, Py_ssize_t column, Py_ssize_t p)
{
    const double *from = motion + column * apart + p;
    return (Quaternion){from[0], {from[COLUMNS * apart], from[2 * COLUMNS * apart], from[3 * COLUMNS * apart]}};
}

static ALWAYS_INLINE Quaternion plus_quaternion(Quaternion base, double factor, Quaternion q)
{
    return (Quaternion){base.real + factor * q.real, plus_times(base.vector, factor, q.vector)};
}

static ALWAYS_INLINE double quaternion_dot(Quaternion a, Quaternion b) { return a.real * b.real + dot(a.vector, b.vector); }

static ALWAYS_INLINE Quaternion times_quaternion(double factor, Quaternion q)
{
    return (Quaternion){factor * q.real, scaled(factor, q.vector)};
}

/* Return (M v) r of a motion or a mix; with a weight of 1 for the translation, of a point. */
static ALWAYS_INLINE Quaternion applied(const double *motion, Py_ssize_t apart, Py_ssize_t p, Vector v, double translation)
{
    Quaternion found = times_quaternion(translation, column_at(motion, apart, 3, p));
    found = plus_quaternion(found, v.x, column_at(motion, apart, 0, p));
    found = plus_quaternion(found, v.y, column_at(motion, apart, 1, p));
    return plus_quaternion(found, v.z, column_at(motion, apart, 2, p));
}

/* Return vec(a b*). */
static ALWAYS_INLINE Vector over(Quaternion a, Quaternion divisor)
{
    const Vector found = plus_times(scaled(divisor.real, a.vector), -a.real, divisor.vector);
    return plus_cross(found, divisor.vector, a.vector);
}

/* Return c − a b. */
static ALWAYS_INLINE Quaternion minus_product(Quaternion c, Quaternion a, Quaternion b)
{
    Vector vector = plus_times(plus_times(c.vector, -a.real, b.vector), -b.real, a.vector);
    return (Quaternion){c.real - a.real * b.real + dot(a.vector, b.vector), plus_cross(vector, b.vector, a.vector)};
}

/* Return B / |B|²; zero stays zero. */
static ALWAYS_INLINE Quaternion divisor_of(Quaternion mix)
{
    const double square = quaternion_dot(mix, mix);
    return times_quaternion(1.0 / (square == 0.0 ? 1.0 : square), mix);
}

static ALWAYS_INLINE double side_of(const Dqs *s, const double *motion, const double *pivot, Py_ssize_t p)
{
    const Quaternion turn = column_at(motion, s->apart, ROTATION, p), of_pivot = column_at(pivot, s->apart, ROTATION, p);
    return quaternion_dot(turn, of_pivot) < 0.0 ? -1.0 : 1.0;
}

/* Mix the motions of a vertex: Σ w σ. Return 1 for a stray joint. */
static ALWAYS_INLINE int mix_scaled(const Dqs *s, const Posing *at, ScaledMix mix)
{
    if (at->pivots == NULL)
        return 1;
    memset(mix, 0, sizeof(ScaledMix));
    for (Py_ssize_t slot = 0; slot < s->slots; slot++) {
        const double *motion = motions_of(s, at->row, at->first, slot), weight = s->weights[at->row * s->slots + slot];
        if (motion == NULL)
            return 1;
        if (weight == 0.0)
            continue;
        double share[MIXED];
        for (Py_ssize_t p = 0; p < at->poses; p++)
            share[p] = weight * side_of(s, motion, at->pivots, p);
        for (Py_ssize_t n = 0; n < SCALED; n++)
            for (Py_ssize_t p = 0; p < at->poses; p++)
                mix[n][p] += share[p] * motion[n * s->apart + p];
    }
    return 0;
}

static ALWAYS_INLINE void add_to(double sums[4][MIXED], Py_ssize_t p, double factor, Quaternion q)
{
    sums[0][p] += factor * q.real, sums[1][p] += factor * q.vector.x;
    sums[2][p] += factor * q.vector.y, sums[3][p] += factor * q.vector.z;
}

static ALWAYS_INLINE Quaternion sum_at(const double sums[4][MIXED], Py_ssize_t p)
{
    return (Quaternion){sums[0][p], {sums[1][p], sums[2][p], sums[3][p]}};
}

/* Add a slot with the derivatives α and β to the sums. Return 1 for a stray joint. */
static ALWAYS_INLINE int add_scaled_slot(const Dqs *s, const Posing *at, Py_ssize_t slot, const double slopes[2],
                                         ScaledAlong along[2])
{
    const double *motion = motions_of(s, at->row, at->first, slot);
    if (motion == NULL)
        return 1;
    const Vector rest = vertex_at(s->positions, at->row);
    for (Py_ssize_t p = 0; p < at->poses; p++) {
        const double sign = side_of(s, motion, at->pivots, p);
        const Quaternion turn = column_at(motion, s->apart, ROTATION, p), first = column_at(at->pivots, s->apart, ROTATION, p);
        const Quaternion move = applied(motion, s->apart, p, rest, 1.0), from = applied(at->pivots, s->apart, p, rest, 1.0);
        /* The difference from slot 0 on one hemisphere, and that of M p. */
        const Quaternion turned = plus_quaternion(times_quaternion(sign, turn), -1.0, first);
        const Quaternion moved = plus_quaternion(times_quaternion(sign, move), -1.0, from);
        const Vector apart = minus(over(move, turn), over(from, first));
        for (int n = 0; n < 2; n++) {
            add_to(along[n].moves, p, slopes[n], moved);
            add_to(along[n].turns, p, slopes[n], turned);
            along[n].correction[0][p] += slopes[n] * apart.x;
            along[n].correction[1][p] += slopes[n] * apart.y;
            along[n].correction[2][p] += slopes[n] * apart.z;
        }
    }
    return 0;
}

/* Write the normals of algorithms 4, 5 and 6 in the poses in work. */
static ALWAYS_INLINE void put_scaled_normals(const Dqs *s, const Posing *at, ScaledMix mix, const ScaledAlong along[2])
{
    const Py_ssize_t row = at->row, out = row * s->poses + at->first;
    const double *components = s->frame + row;
    /* n0, t0 and b0 of the vertex. */
    Vector frame[3];
    for (int n = 0; n < 3; n++, components += 3 * s->rows)
        frame[n] = (Vector){components[0], components[s->rows], components[2 * s->rows]};
    const Vector rest = vertex_at(s->positions, row);
    for (Py_ssize_t p = 0; p < at->poses; p++) {
        const Quaternion divisor = divisor_of(column_at(mix[0], MIXED, ROTATION, p));
        put_normal(s, 0, out + p, over(applied(mix[0], MIXED, p, frame[0], 0.0), divisor));
        /* P = G B⁻¹. */
        const Quaternion blend = applied(mix[0], MIXED, p, rest, 1.0);
        const Quaternion ratio = {quaternion_dot(blend, divisor), over(blend, divisor)};
        Vector accurate[2], exact[2];
        for (int n = 0; n < 2; n++) {
            const Quaternion base = applied(mix[0], MIXED, p, frame[n + 1], 0.0);
            const Vector added = {along[n].correction[0][p], along[n].correction[1][p], along[n].correction[2][p]};
            accurate[n] = plus(over(base, divisor), added);
            const Quaternion rate = plus_quaternion(base, 1.0, sum_at(along[n].moves, p));
            exact[n] = over(minus_product(rate, ratio, sum_at(along[n].turns, p)), divisor);
        }
        put_normal(s, 1, out + p, scaled(s->handedness[row], cross(accurate[0], accurate[1])));
        put_normal(s, 2, out + p, scaled(s->handedness[row], cross(exact[0], exact[1])));
    }
}

FOR_WIDE_PROCESSORS(int, move_scaled, (const Dqs *s), (s))
{
    ScaledMix mix;
    for (Py_ssize_t row = 0; row < s->rows; row++) {
        const Vector rest = vertex_at(s->positions, row);
        for (Py_ssize_t first = 0; first < s->poses; first += MIXED) {
            const Posing at = posing_of(s, row, first);
            if (mix_scaled(s, &at, mix))
                return 1;
            double *out = s->out + (s->first_row + row) * s->poses + first;
            const Py_ssize_t apart = s->all_rows * s->poses;
            for (Py_ssize_t p = 0; p < at.poses; p++) {
                const Quaternion divisor = divisor_of(column_at(mix[0], MIXED, ROTATION, p));
                const Vector posed = over(applied(mix[0], MIXED, p, rest, 1.0), divisor);
                out[p] = posed.x, out[apart + p] = posed.y, out[2 * apart + p] = posed.z;
            }
        }
    }
    return 0;
}

FOR_WIDE_PROCESSORS(int, turn_scaled, (const Dqs *s), (s))
{
    ScaledMix mix;
    ScaledAlong along[2];
    for (Py_ssize_t row = 0; row < s->rows; row++) {
        const double *alpha = s->alpha + row * (s->slots - 1), *beta = s->beta + row * (s->slots - 1);
        for (Py_ssize_t first = 0; first < s->poses; first += MIXED) {
            const Posing at = posing_of(s, row, first);
            if (mix_scaled(s, &at, mix))
                return 1;
            /* What α and β add. Most slots have neither. */
            memset(along, 0, sizeof along);
            for (Py_ssize_t slot = 1; slot < s->slots; slot++) {
                const double slopes[2] = {alpha[slot - 1], beta[slot - 1]};
                if ((slopes[0] != 0.0 || slopes[1] != 0.0) && add_scaled_slot(s, &at, slot, slopes, along))
                    return 1;
            }
            put_scaled_normals(s, &at, mix, along);
        }
    }
    return 0;
}

/* Take the arguments of a call, without the arrays of normals. Return −1 with an error set. */
static int read_dqs(const Array *a, const Py_ssize_t *sizes, Py_ssize_t first, Dqs *work)
{
    if (SIZE('K') < 1) {
        PyErr_SetString(PyExc_ValueError, "joints has no columns");
        return -1;
    }
    if (SIZE('M') != DUAL && SIZE('M') != SCALED) {
        PyErr_Format(PyExc_ValueError, "motions has %zd numbers a joint, not 8 or 20", SIZE('M'));
        return -1;
    }
    if (first < 0 || SIZE('P') > SIZE('Q') || first > SIZE('Q') - SIZE('P')) {
        PyErr_SetString(PyExc_ValueError, "the motions have fewer poses than are asked for");
        return -1;
    }
    /* The motions are those of all poses Q, of which P are in work. */
    *work = (Dqs){
        .motions = DATA(MOTIONS),
        .scales = DATA(SCALES),
        .joints = DATA(MOTION_JOINTS),
        .weights = DATA(MOTION_WEIGHTS),
        .positions = DATA(REST_POSITIONS),
        .out = DATA(MOVED),
        .rows = SIZE('B'),
        .slots = SIZE('K'),
        .joint_count = SIZE('J'),
        .poses = SIZE('P'),
        .all_poses = SIZE('Q'),
        .first_pose = first,
        .apart = SIZE('J') * SIZE('Q'),
    };
    return 0;
}

static PyObject *dqs_positions(PyObject *Py_UNUSED(module), PyObject *args)
{
    PyObject *o[DQS_ARRAYS], *result = NULL;
    Array a[DQS_ARRAYS];
    Py_ssize_t sizes[26], first, first_row;
    Dqs work;
    memset(a, 0, sizeof a);
    if (!PyArg_ParseTuple(args, "OOOOOOnn", &o[MOTIONS], &o[SCALES], &o[MOTION_JOINTS], &o[MOTION_WEIGHTS],
                          &o[REST_POSITIONS], &o[MOVED], &first, &first_row))
        return NULL;
    if (read_arrays(o, dqs_arrays, DQS_ARRAYS, a, sizes) < 0 || read_dqs(a, sizes, first, &work) < 0 ||
        !has_rows(sizes, first_row))
        goto done;
    work.all_rows = SIZE('V'), work.first_row = first_row;
    int stray;
    Py_BEGIN_ALLOW_THREADS
    stray = (SIZE('M') == SCALED ? move_scaled : move_by_dqs)(&work);
    Py_END_ALLOW_THREADS
    result = none_unless(stray);
done:
    release_arrays(a, DQS_ARRAYS);
    return result;
}

static PyObject *dqs_normals(PyObject *Py_UNUSED(module), PyObject *args)
{
    PyObject *o[DQS_NORMAL_ARRAYS], *result = NULL;
    Array a[DQS_NORMAL_ARRAYS];
    Py_ssize_t sizes[26], first;
    Dqs work;
    memset(a, 0, sizeof a);
    if (!PyArg_ParseTuple(args, "OOOOOOOOOOn", &o[MOTIONS], &o[SCALES], &o[MOTION_JOINTS], &o[MOTION_WEIGHTS],
                          &o[REST_POSITIONS], &o[MOVED], &o[FRAME], &o[ALONG_T], &o[ALONG_B], &o[HANDEDNESS], &first))
        return NULL;
    if (read_arrays(o, dqs_normal_arrays, DQS_NORMAL_ARRAYS, a, sizes) < 0 || read_dqs(a, sizes, first, &work) < 0)
        goto done;
    /* Slot 0 has neither α nor β. */
    if (SIZE('L') != SIZE('K') - 1) {
        PyErr_Format(PyExc_ValueError, "alpha has %zd columns, not %zd", SIZE('L'), SIZE('K') - 1);
        goto done;
    }
    work.frame = DATA(FRAME), work.alpha = DATA(ALONG_T), work.beta = DATA(ALONG_B), work.handedness = DATA(HANDEDNESS);
    int stray;
    Py_BEGIN_ALLOW_THREADS
    stray = (SIZE('M') == SCALED ? turn_scaled : turn_by_dqs)(&work);
    Py_END_ALLOW_THREADS
    result = none_unless(stray);
done:
    release_arrays(a, DQS_NORMAL_ARRAYS);
    return result;
}
