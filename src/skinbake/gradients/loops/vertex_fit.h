/* The gradients of one vertex fitted to the poses and turns of a rig (twin: fit.py). */

#pragma once

#include "ring.h"
#include "slots.h"

/* The node of a joint, made with a row where there is none; NO_JOINT stands above all roots. */
static Node *node_of(const Surface *s, int32_t joint, size_t row, Scratch *w)
{
    int32_t *place = &w->node_of[joint == NO_JOINT ? s->joint_count : joint];
    if (*place < 0) {
        *place = (int32_t)w->node_count++;
        w->nodes[*place] = (Node){joint, joint == NO_JOINT ? -1 : s->ranks[joint], 0, row, 0};
    }
    return &w->nodes[*place];
}

/* The node of a joint, made with a spare row where there is none. */
static Node *spare_node_of(const Surface *s, int32_t joint, Scratch *w)
{
    size_t before = w->node_count;
    Node *node = node_of(s, joint, w->first_spare + w->way.spares, w);
    w->way.spares += w->node_count - before;
    return node;
}

static void close_nodes(const Surface *s, Scratch *w)
{
    for (size_t n = 0; n < w->node_count; n++)
        w->node_of[w->nodes[n].joint == NO_JOINT ? s->joint_count : w->nodes[n].joint] = -1;
    w->node_count = 0;
}

/* List the joints around a class that turn. Tell whether the way begins with them. Return their number. */
static ALWAYS_INLINE size_t find_turning(int32_t used, Scratch *w)
{
    const Way *way = &w->way;
    size_t count = 0;
    int known = 1;
    for (int32_t n = 0; n < used; n++)
        if (w->met[n] >= 0 && turns_at_all(w->turns + n * TURN)) {
            known = known && count < way->turnings && way->turning_numbers[count] == n &&
                    way->turning_joints[count] == w->met[n];
            w->turning_numbers[count++] = n;
        }
    w->known_turnings = known && count == way->turnings;
    return count;
}

/* The slots of a vertex that are fitted. The last of them takes what the others, the unknowns, leave. */
typedef struct {
    size_t unknowns;
    size_t slots[MOST_FITTED];
    int32_t joints[MOST_FITTED];
    Pair given[MOST_FITTED]; /* the surface's gradients along the class's tangents */
} Fitted;

/* Choose the slots to fit, by the presence of their joints: the weight and the share of the gradients, added. Returns 0
   where there are too few or too many. */
static ALWAYS_INLINE int choose_slots(const Surface *s, size_t slots, size_t vertex, const Scratch *w, Fitted *fitted)
{
    const double *weights = s->weights + vertex * slots;
    const int32_t *joints = s->joints + vertex * slots;
    size_t count = 0;
    Pair others = both(0.0);
    for (size_t k = slots; k-- > 1;)
        others = add_pairs(others, dots(both_vectors(w->gradients[k]), w->frame.along));
    for (size_t k = 0; k < slots; k++) {
        const int32_t joint = w->named[k];
        if ((size_t)(uint32_t)joint >= (size_t)s->joint_count)
            continue;
        if (!(w->shares[k] + (joints[k] == joint ? weights[k] : 0.0) > s->fit.unfelt))
            continue;
        if (count == MOST_FITTED)
            return 0;
        /* The gradient that the surface has, along both tangents of the class. What no slot holds goes to the first one,
           as in the shader. */
        fitted->given[count] = k == 0 ? scaled(-1.0, others) : dots(both_vectors(w->gradients[k]), w->frame.along);
        fitted->joints[count] = joint;
        fitted->slots[count++] = k;
    }
    fitted->unknowns = count - 1;
    return count >= 2;
}

/* The turn of a node. It parts the slots if it moves some against the last one, about a pivot. */
static Climb climb_from(const Surface *s, const Node *node, size_t unknowns)
{
    const double *pivot = s->pivots + 3 * (size_t)node->joint;
    Climb climb = {.pivot = {pivot[0], pivot[1], pivot[2]}, .carries = node->carries};
    climb.chain = s->chains[node->joint];
    /* Where it carries the last slot it moves the others the other way. */
    int carries_last = node->carries >> unknowns & 1;
    climb.sign = carries_last ? -1.0 : 1.0;
    climb.moves = (carries_last ? ~node->carries : node->carries) & ((UINT64_C(1) << unknowns) - 1);
    climb.parts = climb.moves && isfinite(climb.pivot[0]) && isfinite(climb.pivot[1]) && isfinite(climb.pivot[2]);
    return climb;
}

/* Go through all joints whose turns part the joints around a vertex, from the lowest up. Returns 0 where there are
   too many.

   Each joint hands up what it carries. It ends when one node is left, which carries all. In the example of
   fit._turning_pairs, nodes are made for 2, 3 and 4 beforehand, as they turn, and the climbs are

       node   its slots, as bits   its turn                its node above
       3      01                   of 3                    2
       4      10                   of 4                    1, made with a spare row
       2      01                   of 2, with that of 3    1 */
static int climb_up(const Surface *s, Scratch *w)
{
    Way *way = &w->way;
    size_t left = w->node_count;
    for (int turn = 0; left > 1; turn++) {
        /* The lowest joint that has not handed up yet: nothing below it is left. */
        Node *lowest = NULL;
        for (size_t n = 0; n < w->node_count; n++)
            if (!w->nodes[n].done && w->nodes[n].joint != NO_JOINT &&
                (lowest == NULL || w->nodes[n].rank > lowest->rank))
                lowest = &w->nodes[n];
        if (lowest == NULL || turn == MOST_TURNS)
            return 0;
        /* Its turn, and the joint that carries it. */
        Climb *climb = &way->climb[way->climbs++];
        *climb = climb_from(s, lowest, way->fittings - 1);
        int32_t parent = s->parents[lowest->joint], rank = lowest->rank;
        if (parent < 0 || parent >= s->joint_count || s->ranks[parent] >= rank)
            parent = NO_JOINT;
        /* What it carries goes to the node above. */
        lowest->done = 1;
        size_t before = w->node_count;
        Node *above = spare_node_of(s, parent, w);
        left -= w->node_count == before; /* else the new node is left instead of this one */
        above->carries |= lowest->carries;
        climb->row = lowest->row, climb->row_above = above->row;
    }
    return 1;
}

/* Number the curls: the long chains of which several joints part the slots. */
static void number_curls(Way *way)
{
    way->curls = 0;
    for (size_t n = 0; n < way->climbs; n++) {
        Climb *climb = &way->climb[n];
        if (!climb->parts || climb->chain == NO_CHAIN)
            continue;
        /* The second joint of a chain that parts the slots makes a curl of the first. */
        for (size_t m = 0; m < n && !climb->curl; m++) {
            Climb *lower = &way->climb[m];
            if (!lower->parts || lower->chain != climb->chain)
                continue;
            if (!lower->curl)
                lower->curl = ++way->curls;
            climb->curl = lower->curl;
        }
    }
}

/* Write the way of the turns of a vertex up the rig. */
static void plan_way(const Surface *s, size_t turnings, const Fitted *fitted, Scratch *w)
{
    Way *way = &w->way;
    way->turnings = turnings, way->fittings = fitted->unknowns + 1;
    way->spares = way->climbs = 0;
    w->node_count = 0;
    /* A node for each joint that turns, with the row of its turn. */
    for (size_t n = 0; n < turnings; n++) {
        size_t row = (size_t)(way->turning_numbers[n] = w->turning_numbers[n]);
        way->turning_joints[n] = w->met[row];
        Node *node = node_of(s, way->turning_joints[n], row, w);
        if (node->row != row) /* two slots have the same joint */
            way->climb[way->climbs++] = (Climb){.row = row, .row_above = node->row};
    }
    /* A node for each fitted joint, which carries its own slot. */
    for (size_t i = 0; i < way->fittings; i++) {
        way->fitted_joints[i] = fitted->joints[i];
        spare_node_of(s, fitted->joints[i], w)->carries |= UINT64_C(1) << i;
    }
    /* Up the rig, until one node carries all. */
    w->known_turnings = 1;
    way->ends = climb_up(s, w);
    number_curls(way);
    close_nodes(s, w);
}

/* Find the way of the turns of a vertex up the rig. It was found already if the latest vertex had the same joints. */
static ALWAYS_INLINE const Way *find_way(const Surface *s, size_t turnings, const Fitted *fitted, Scratch *w)
{
    Way *way = &w->way;
    const size_t fittings = fitted->unknowns + 1;
    int same = w->known_turnings && way->fittings == fittings;
    for (size_t i = 0; same && i < fittings; i++)
        same = way->fitted_joints[i] == fitted->joints[i];
    if (!same)
        plan_way(s, turnings, fitted, w);
    return way;
}

/* Up to this number of slots, one of them for the last, the fit has copies without loops. */
enum { FEW_FITTED = 4 };

/* Bit i of a mask as a number. Branches here would be guessed wrongly half of the time. */
static ALWAYS_INLINE double bit_of(uint64_t mask, size_t i, size_t unknowns)
{
    static const double few[1 << FEW_FITTED][FEW_FITTED] = {
        {0, 0, 0, 0}, {1, 0, 0, 0}, {0, 1, 0, 0}, {1, 1, 0, 0}, {0, 0, 1, 0}, {1, 0, 1, 0}, {0, 1, 1, 0}, {1, 1, 1, 0},
        {0, 0, 0, 1}, {1, 0, 0, 1}, {0, 1, 0, 1}, {1, 1, 0, 1}, {0, 0, 1, 1}, {1, 0, 1, 1}, {0, 1, 1, 1}, {1, 1, 1, 1},
    };
    return unknowns < FEW_FITTED ? few[mask % (1 << FEW_FITTED)][i] : (double)(mask >> i & 1);
}

/* A quadratic form of α of some slots, or the normal equations of one (twin: fit._Form). Rows of the matrix are `stride`
   apart; only its lower half is there. */
typedef struct {
    double *matrix;
    Pair *right;
    size_t unknowns, stride;
} Form;

/* The forms of a vertex: the squared tilts, and the pulls. */
typedef struct {
    Form tilts, pulls;
} Forms;

/* Add what the turn of one joint says to the forms, and to its curl. The names are those of fit._TurnEffects. */
static ALWAYS_INLINE void add_turn(const Surface *s, Vector position, const Climb *climb, const double turn[TURN],
                                   const RingFrame *frame, const Fitted *fitted, Forms *forms, Curl *curls)
{
    Form *tilts = &forms->tilts, *pulls = &forms->pulls;
    const size_t unknowns = tilts->unknowns;
    /* The tilt of a tangent along the normal by a turn, and how it should tilt. */
    const Vector lever = minus(position, (Vector){climb->pivot[0], climb->pivot[1], climb->pivot[2]});
    const Vector tilt = cross(lever, frame->normal);
    const double pull = s->fit.stiffness * dot(lever, lever), square = dot(tilt, tilt);
    const Vectors arms = load_vectors(turn + ARMS), spins = load_vectors(turn + SPINS);
    const Vectors wanted = plus_each(crosses(both_vectors(lever), arms), spins);
    const Pair aims = scaled(climb->sign, dots(both_vectors(tilt), wanted));
    /* ∇̄: the surface's gradients of the slots that turn along. */
    Pair carried = both(0.0);
    for (size_t i = 0; i <= unknowns; i++)
        carried = add_pairs(carried, scaled(bit_of(climb->carries, i, unknowns), fitted->given[i]));
    carried = scaled(climb->sign * pull, carried);
    /* |R|² and the pull of the turn, over the slots that it moves. */
    for (size_t i = 0; i < unknowns; i++) {
        const double mask = bit_of(climb->moves, i, unknowns);
        tilts->right[i] = add_pairs(tilts->right[i], scaled(mask, aims));
        pulls->right[i] = add_pairs(pulls->right[i], scaled(mask, carried));
        for (size_t k = 0; k <= i; k++) {
            const double moves = mask * bit_of(climb->moves, k, unknowns);
            tilts->matrix[i * tilts->stride + k] += moves * square;
            pulls->matrix[i * pulls->stride + k] += moves * pull;
        }
    }
    /* Joints of a long chain turn alike, so their tilts add up. */
    if (climb->curl) {
        Curl *curl = &curls[climb->curl - 1];
        curl->wanted = plus_each(curl->wanted, wanted);
        for (size_t i = 0; i < unknowns; i++)
            curl->moved[i] = plus(curl->moved[i], times(tilt, climb->sign * bit_of(climb->moves, i, unknowns)));
    }
}

/* Sum up the turns along the way, in place, and what they say to the forms, for turns by one radian. */
static ALWAYS_INLINE void add_turns(const Surface *s, Vector position, const Way *way, const Fitted *fitted,
                                    Forms *forms, Scratch *w)
{
    memset(w->turns + w->first_spare * TURN, 0, way->spares * TURN * sizeof *w->turns);
    memset(w->curls, 0, way->curls * sizeof *w->curls);
    /* From the lowest joint up: each turn takes along those below it. */
    for (size_t n = 0; n < way->climbs; n++) {
        const Climb *climb = &way->climb[n];
        const double *turn = w->turns + climb->row * TURN;
        double *above = w->turns + climb->row_above * TURN;
        if (climb->parts)
            add_turn(s, position, climb, turn, &w->frame, fitted, forms, w->curls);
        for (int m = 0; m < TURN; m += AT_ONCE)
            store(above + m, add(load(above + m), load(turn + m)));
    }
    Form *tilts = &forms->tilts;
    for (const Curl *curl = w->curls; curl < w->curls + way->curls; curl++)
        for (size_t i = 0; i < tilts->unknowns; i++) {
            const Vector moved = times(curl->moved[i], s->fit.together);
            tilts->right[i] = add_pairs(tilts->right[i], dots(both_vectors(moved), curl->wanted));
            for (size_t k = 0; k <= i; k++)
                tilts->matrix[i * tilts->stride + k] += dot(moved, curl->moved[k]);
        }
}

static ALWAYS_INLINE void add_lane(double *lane, Four values) { store(lane, add(load(lane), values)); }

static ALWAYS_INLINE double sum_lane(const double *lane) { return sum_of(load(lane)); }

/* Add what the poses of the class say to the forms (twin: fit._add_poses). The sums are kept by pose until the
   last one. */
static ALWAYS_INLINE void add_poses(const Surface *s, int32_t used, const Fitted *fitted, Forms *forms, Scratch *w)
{
    const size_t unknowns = forms->tilts.unknowns, half = unknowns * (unknowns + 1) / 2;
    double *matrix = w->lanes, *pulling = matrix + AT_ONCE * half, *right = pulling + AT_ONCE * half;
    double *pulled = right + AT_ONCE * 2 * unknowns, *moved = pulled + AT_ONCE * 2 * unknowns;
    memset(w->lanes, 0, AT_ONCE * (2 * half + 4 * unknowns) * sizeof *w->lanes);
    /* The local numbers of the fitted joints, which are all around the class. */
    int32_t numbers[MOST_FITTED];
    for (size_t i = 0; i <= unknowns; i++)
        for (numbers[i] = 0; numbers[i] + 1 < used && w->met[numbers[i]] != fitted->joints[i];)
            numbers[i]++;
    const Four none = all(0.0);
    for (size_t group = 0; group < s->pose_groups; group++) {
        const PosedRing *ring = &w->posed[group];
        const Four share = load(ring->share);
        const Vector4 normal = load4(ring->normal);
        Vector4 shift[2] = {load4(ring->still[0]), load4(ring->still[1])};
        const Mask counts = above(share, none);
        /* What a unit of each slot's α moves: where its joint takes the vertex, from where the last one does. Then the
           tangents by the gradients of the surface, and what they are without. */
        const Vector4 last = load4(ends_of(s, w, numbers[unknowns], group));
        for (size_t i = 0; i < unknowns; i++) {
            const Vector4 over = only4(counts, minus4(load4(ends_of(s, w, numbers[i], group)), last));
            store4(moved + 3 * AT_ONCE * i, over);
            for (int u = 0; u < 2; u++)
                shift[u] = plus4(shift[u], times4(over, all(part(fitted->given[i], u))));
        }
        const Four length = larger(add(dot4(shift[0], shift[0]), dot4(shift[1], shift[1])), load(ring->least));
        const Four v = only(counts, divide(multiply(all(2.0), share), length)), pull = multiply(v, all(s->fit.stiffness));
        for (int u = 0; u < 2; u++)
            shift[u] = minus4(shift[u], load4(ring->still[u]));
        const Four tilts[2] = {load(ring->tilts[0]), load(ring->tilts[1])};
        double *lifts = moved + 3 * AT_ONCE * unknowns;
        for (size_t i = 0, at = 0; i < unknowns; i++) {
            const Vector4 over = load4(moved + 3 * AT_ONCE * i);
            const Four lift = dot4(over, normal), raised = multiply(v, lift);
            const Vector4 weighted = times4(over, pull);
            store(lifts + AT_ONCE * i, lift);
            for (int u = 0; u < 2; u++) {
                add_lane(right + AT_ONCE * (2 * i + (size_t)u), multiply(raised, tilts[u]));
                add_lane(pulled + AT_ONCE * (2 * i + (size_t)u), dot4(weighted, shift[u]));
            }
            for (size_t k = 0; k <= i; k++, at++) {
                add_lane(matrix + AT_ONCE * at, multiply(raised, load(lifts + AT_ONCE * k)));
                add_lane(pulling + AT_ONCE * at, dot4(weighted, load4(moved + 3 * AT_ONCE * k)));
            }
        }
    }
    Form *tilts = &forms->tilts, *pulls = &forms->pulls;
    for (size_t i = 0, at = 0; i < unknowns; i++) {
        const double *own = right + AT_ONCE * 2 * i, *pull = pulled + AT_ONCE * 2 * i;
        tilts->right[i] = subtract_pairs(tilts->right[i], pair(sum_lane(own), sum_lane(own + AT_ONCE)));
        pulls->right[i] = add_pairs(pulls->right[i], pair(sum_lane(pull), sum_lane(pull + AT_ONCE)));
        for (size_t k = 0; k <= i; k++, at++) {
            tilts->matrix[i * tilts->stride + k] += sum_lane(matrix + AT_ONCE * at);
            pulls->matrix[i * pulls->stride + k] += sum_lane(pulling + AT_ONCE * at);
        }
    }
}

/* Solve the normal equations, by the factors L D Lt in place of the matrix. The right side becomes the solution.
   Returns 0 where it is in doubt: not finite, or elimination takes all of a diagonal entry but `least` of it. */
static ALWAYS_INLINE int solve(Form e, double least)
{
    Pair finite = both(0.0);
    for (size_t i = 0; i < e.unknowns; i++) {
        double *row = e.matrix + i * e.stride, diagonal = row[i];
        const double whole = diagonal;
        for (size_t k = 1; k < i; k++) /* row[k] is L[i][k] D[k] until the row is done */
            for (size_t n = 0; n < k; n++)
                row[k] -= row[n] * e.matrix[k * e.stride + n];
        for (size_t k = 0; k < i; k++) {
            double factor = row[k] * e.matrix[k * e.stride + k]; /* the diagonal holds 1 / D */
            diagonal -= factor * row[k];
            row[k] = factor;
            e.right[i] = subtract_pairs(e.right[i], scaled(factor, e.right[k]));
        }
        /* A diagonal entry that elimination takes away is rounding. */
        if (!(diagonal > least * whole))
            return 0;
        row[i] = 1.0 / diagonal;
    }
    /* D⁻¹, then Lᵀ from the last unknown up. */
    for (size_t i = e.unknowns; i-- > 0;) {
        e.right[i] = scaled(e.matrix[i * e.stride + i], e.right[i]);
        for (size_t n = i + 1; n < e.unknowns; n++)
            e.right[i] = subtract_pairs(e.right[i], scaled(e.matrix[n * e.stride + i], e.right[n]));
        finite = add_pairs(finite, scaled(0.0, e.right[i]));
    }
    return part(finite, 0) + part(finite, 1) == 0.0;
}

/* The steepest slope of any weight along an edge of the ring (twin: weight_gradients.steepest_slopes). */
static double steepest_slope(const Surface *s, Scratch *w)
{
    const size_t slots = (size_t)s->slots;
    if (w->steepest >= 0.0)
        return w->steepest;
    w->steepest = 0.0;
    for (size_t n = 0; n < w->neighbours; n++) {
        const int32_t *joints = s->joints + w->ring[n].vertex * slots;
        const double *weights = s->weights + w->ring[n].vertex * slots, *e = w->ring[n].edge;
        double largest = 0.0;
        for (size_t k = 0; k < slots; k++) {
            /* The joint of a slot of the neighbour, and that of a slot of the class. */
            double gained = joints[k] < 0 ? 0.0 : weights[k], lost = w->met[k] < 0 ? 0.0 : w->own[k];
            for (size_t m = 0; m < slots; m++) {
                gained -= w->met[m] == joints[k] ? w->own[m] : 0.0;
                lost -= joints[m] == w->met[k] ? weights[m] : 0.0;
            }
            largest = fmax(largest, fmax(fabs(gained), fabs(lost)));
        }
        w->steepest = fmax(w->steepest, largest / sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2]));
    }
    return w->steepest;
}

/* Move the gradients of the fitted slots, in the plane of the class's tangents, to the solution of the least squares. The
   right side becomes α of the unknowns. */
static ALWAYS_INLINE void move_gradients(const Surface *s, const Fitted *fitted, Form e, Scratch *w)
{
    const Vector *tangents = w->frame.tangents;
    const size_t unknowns = e.unknowns;
    /* A pull of each unknown alone decides where nothing else does. */
    double trace = 0.0;
    for (size_t i = 0; i < unknowns; i++)
        trace += e.matrix[i * e.stride + i];
    const double pull = s->fit.even * trace;
    for (size_t i = 0; i < unknowns; i++) {
        e.matrix[i * e.stride + i] += pull;
        e.right[i] = add_pairs(e.right[i], scaled(pull, fitted->given[i]));
    }
    if (!solve(e, s->fit.flat * s->fit.flat)) {
        for (size_t i = 0; i < unknowns; i++)
            e.right[i] = fitted->given[i];
        return;
    }
    Pair last = both(0.0);
    for (size_t i = 0; i < unknowns; i++)
        last = subtract_pairs(last, e.right[i]);
    /* The change along both tangents, and the largest one beside the largest gradient, squared. */
    last = subtract_pairs(last, fitted->given[unknowns]);
    double change = squared_length(last), given = squared_length(fitted->given[unknowns]);
    for (size_t i = 0; i < unknowns; i++) {
        e.right[i] = subtract_pairs(e.right[i], fitted->given[i]);
        const double moved = squared_length(e.right[i]), had = squared_length(fitted->given[i]);
        change = moved > change ? moved : change, given = had > given ? had : given;
    }
    /* How far the changes go (twin: fit.shares_of_changes). */
    double share = change > 0.0 ? change / (change + s->fit.small * s->fit.small * given) : 0.0;
    if (change > s->fit.bounded * s->fit.bounded * given) {
        const double most = s->fit.bounded * fmax(sqrt(given), steepest_slope(s, w));
        share = fmin(share, most / sqrt(change));
    }
    for (size_t i = 0; i <= unknowns; i++) {
        /* What is along the normal stays. */
        Vector *gradient = &w->gradients[fitted->slots[i]];
        const Pair by = scaled(share, i < unknowns ? e.right[i] : last);
        *gradient = plus(*gradient, plus(times(tangents[0], part(by, 0)), times(tangents[1], part(by, 1))));
        if (i < unknowns)
            e.right[i] = add_pairs(fitted->given[i], by);
    }
}

/* Add to a ray through α of the unknowns (twin: fit._Form.along). */
static ALWAYS_INLINE void add_ray(Ray *ray, Form tilts, const Pair *own)
{
    for (size_t i = 0; i < tilts.unknowns; i++) {
        const Pair along = multiply_pairs(own[i], tilts.right[i]);
        ray->along += part(along, 0) + part(along, 1);
        for (size_t k = 0; k <= i; k++) {
            const Pair square = multiply_pairs(own[i], own[k]);
            ray->square +=
                (k < i ? 2.0 : 1.0) * tilts.matrix[i * tilts.stride + k] * (part(square, 0) + part(square, 1));
        }
    }
}

/* Fit the gradients of some unknowns. */
static ALWAYS_INLINE void fit_unknowns(const Surface *s, size_t unknowns, int32_t used, Vector position, const Way *way,
                                       const Fitted *fitted, Scratch *w)
{
    double few[3 * (FEW_FITTED - 1) * (FEW_FITTED - 1)];
    Pair right[3 * MOST_FITTED];
    const int large = unknowns >= FEW_FITTED;
    const size_t stride = large ? MOST_FITTED : FEW_FITTED - 1;
    double *matrix = large ? w->matrix : few;
    Forms forms = {{matrix, right, unknowns, stride}, {matrix + stride * stride, right + stride, unknowns, stride}};
    Form tilts = forms.tilts, system = forms.pulls;
    Form turned = {matrix + 2 * stride * stride, right + 2 * stride, unknowns, stride};
    for (size_t i = 0; i < unknowns; i++) {
        tilts.right[i] = system.right[i] = both(0.0);
        for (size_t k = 0; k <= i; k++)
            tilts.matrix[i * stride + k] = system.matrix[i * stride + k] = 0.0;
    }
    add_turns(s, position, way, fitted, &forms, w);
    /* Turns by the angle of the fit, in place of those by a radian. */
    const double angle = s->fit.turn * s->fit.turn;
    for (size_t i = 0; i < unknowns; i++) {
        turned.right[i] = tilts.right[i] = scaled(angle, tilts.right[i]);
        system.right[i] = scaled(angle, system.right[i]);
        for (size_t k = 0; k <= i; k++) {
            turned.matrix[i * stride + k] = tilts.matrix[i * stride + k] *= angle;
            system.matrix[i * stride + k] *= angle;
        }
    }
    add_poses(s, used, fitted, &forms, w);
    for (size_t i = 0; i < unknowns; i++) {
        system.right[i] = add_pairs(system.right[i], tilts.right[i]);
        for (size_t k = 0; k <= i; k++)
            system.matrix[i * stride + k] += tilts.matrix[i * stride + k];
    }
    move_gradients(s, fitted, system, w);
    add_ray(&w->ray, tilts, system.right);
    add_ray(&w->turned, turned, system.right);
}

/* Fit the gradients by slot of one vertex to the rig. */
FOR_PROCESSORS(void, fit_vertex,
               (const Surface *s, size_t vertex, const ClassGradients *found, const Vector *position, Scratch *w),
               (s, vertex, found, position, w))
{
    Fitted fitted;
    int chosen = s->slots == 4 ? choose_slots(s, 4, vertex, w, &fitted)
                               : choose_slots(s, (size_t)s->slots, vertex, w, &fitted);
    if (!chosen)
        return;
    const Way *way = find_way(s, found->turnings, &fitted, w);
    if (!way->ends)
        return;
    switch (fitted.unknowns) {
    case 1:
        fit_unknowns(s, 1, found->used, *position, way, &fitted, w);
        break;
    case 2:
        fit_unknowns(s, 2, found->used, *position, way, &fitted, w);
        break;
    case 3:
        fit_unknowns(s, 3, found->used, *position, way, &fitted, w);
        break;
    default:
        fit_unknowns(s, fitted.unknowns, found->used, *position, way, &fitted, w);
    }
}

/* Write alpha and beta of one vertex as project does, with gradients fitted to the rig. The turns are kept unless
   it is the last vertex of its class. */
static ALWAYS_INLINE double project_fitted(const Surface *s, Shape shape, size_t vertex, int last,
                                           const ClassGradients *found, const Baked *out, Scratch *w)
{
    const size_t slots = shape.slots;
    Vector t, b;
    find_frame(s, vertex, &w->latest, &t, &b);
    double unheld = 0.0;
    memset(w->gradients, 0, slots * sizeof *w->gradients);
    memset(w->shares, 0, slots * sizeof *w->shares);
    const double whole = found->magnitude > 0.0 ? 1.0 / found->magnitude : 0.0; /* sums that cancel have no shares */
    for (size_t n = 0; n < found->entries; n++) {
        /* The slot of each joint's gradient, and its share of all of them. */
        Entry *entry = &w->entries[n];
        size_t slot = 0;
        while (slot < slots && w->named[slot] != entry->joint)
            slot++;
        entry->held = slot < slots;
        if (entry->held)
            w->gradients[slot] = entry->gradient, w->shares[slot] = entry->magnitude * whole;
        else
            unheld += entry->magnitude;
    }
    /* The fit. It adds up turns in place, so they are kept for the next vertex. */
    if (w->frame.sound) {
        const Vector position = row3(s->positions, shape.wide, vertex);
        const size_t size = (size_t)found->used * TURN * sizeof *w->turns;
        if (!last)
            memcpy(w->kept, w->turns, size);
        fit_vertex(s, vertex, found, &position, w);
        if (!last)
            memcpy(w->turns, w->kept, size);
    }
    /* α and β in the frame of the vertex. */
    for (size_t k = 1; k < slots; k++) {
        out->alpha[vertex * (slots - 1) + k - 1] = stored(dot(w->gradients[k], t));
        out->beta[vertex * (slots - 1) + k - 1] = stored(dot(w->gradients[k], b));
    }
    return unheld;
}
