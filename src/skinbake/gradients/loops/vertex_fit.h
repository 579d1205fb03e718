/* The gradients of one vertex fitted to a rig (twin: rig_fit.fitted). */

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
    double reach;            /* the squared levers of all turns that part the slots, added */
} Fitted;

/* Choose the slots to fit, by the presence of their joints: the weight and the share of the gradients, added. Returns 0
   where there are too few or too many. */
static ALWAYS_INLINE int choose_slots(const Surface *s, size_t slots, size_t vertex, const Scratch *w, Fitted *fitted)
{
    const double *weights = s->weights + vertex * slots;
    const int32_t *joints = s->joints + vertex * slots;
    size_t count = 0;
    for (size_t k = 0; k < slots; k++) {
        const int32_t joint = w->named[k];
        if ((size_t)(uint32_t)joint >= (size_t)s->joint_count)
            continue;
        if (!(w->shares[k] + (joints[k] == joint ? weights[k] : 0.0) > s->fit.unfelt))
            continue;
        if (count == MOST_FITTED)
            return 0;
        /* The gradient that the surface has, along both tangents of the class. */
        fitted->given[count] = dots(both_vectors(w->gradients[k]), w->frame.along);
        fitted->joints[count] = joint;
        fitted->slots[count++] = k;
    }
    fitted->unknowns = count - 1;
    fitted->reach = 0.0;
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
   rig_fit._turning_pairs, nodes are made for 2, 3 and 4 beforehand, as they turn, and the climbs are

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

/* The normal equations of some slots. Rows of the matrix are `stride` apart. */
typedef struct {
    double *matrix;
    Pair *right;
    size_t unknowns, stride;
} Equations;

/* Add what the turn of one joint says to the normal equations of the slots, and to its curl. The names are those of
   rig_fit._TurnEffects. */
static ALWAYS_INLINE void add_turn(const Surface *s, Vector position, const Climb *climb, const double turn[TURN],
                                   const RingFrame *frame, Fitted *fitted, Equations e, Curl *curls)
{
    /* The tilt of a tangent along the normal by a turn, and how it should tilt. */
    const Vector lever = minus(position, (Vector){climb->pivot[0], climb->pivot[1], climb->pivot[2]});
    const Vector tilt = cross(lever, frame->normal);
    const double squared_lever = dot(lever, lever), square = dot(tilt, tilt);
    const double pull = s->fit.stiffness * squared_lever;
    const Vectors arms = load_vectors(turn + ARMS), spins = load_vectors(turn + SPINS);
    const Vectors wanted = plus_each(crosses(both_vectors(lever), arms), spins);
    const Pair aims = dots(both_vectors(tilt), wanted);
    /* ∇̄: the surface's gradients of the slots that turn along. */
    Pair carried = both(0.0);
    for (size_t i = 0; i <= e.unknowns; i++)
        carried = add_pairs(carried, scaled(bit_of(climb->carries, i, e.unknowns), fitted->given[i]));
    fitted->reach += squared_lever;
    /* |R|² and the pull of the turn, over the slots that it moves. */
    const Pair right = scaled(climb->sign, add_pairs(aims, scaled(pull, carried)));
    for (size_t i = 0; i < e.unknowns; i++) {
        const double mask = bit_of(climb->moves, i, e.unknowns);
        e.right[i] = add_pairs(e.right[i], scaled(mask, right));
        for (size_t k = 0; k <= i; k++)
            e.matrix[i * e.stride + k] += mask * bit_of(climb->moves, k, e.unknowns) * (square + pull);
    }
    /* Joints of a long chain turn alike, so their tilts add up. */
    if (climb->curl) {
        Curl *curl = &curls[climb->curl - 1];
        curl->wanted = plus_each(curl->wanted, wanted);
        for (size_t i = 0; i < e.unknowns; i++)
            curl->moved[i] = plus(curl->moved[i], times(tilt, climb->sign * bit_of(climb->moves, i, e.unknowns)));
    }
}

/* Add what the curls say to the normal equations of the slots. */
static ALWAYS_INLINE void add_curls(const Surface *s, const Curl *curls, size_t count, Equations e)
{
    for (const Curl *curl = curls; curl < curls + count; curl++)
        for (size_t i = 0; i < e.unknowns; i++) {
            const Vector moved = times(curl->moved[i], s->fit.together);
            e.right[i] = add_pairs(e.right[i], dots(both_vectors(moved), curl->wanted));
            for (size_t k = 0; k <= i; k++)
                e.matrix[i * e.stride + k] += dot(moved, curl->moved[k]);
        }
}

/* Sum up the turns along the way, in place, and what they say to the normal equations of the slots. */
static ALWAYS_INLINE void gather_turns(const Surface *s, Vector position, const Way *way, Fitted *fitted, Equations e,
                                       Scratch *w)
{
    for (size_t i = 0; i < e.unknowns; i++) {
        e.right[i] = both(0.0);
        for (size_t k = 0; k <= i; k++)
            e.matrix[i * e.stride + k] = 0.0;
    }
    memset(w->turns + w->first_spare * TURN, 0, way->spares * TURN * sizeof *w->turns);
    memset(w->curls, 0, way->curls * sizeof *w->curls);
    /* From the lowest joint up: each turn takes along those below it. */
    for (size_t n = 0; n < way->climbs; n++) {
        const Climb *climb = &way->climb[n];
        const double *turn = w->turns + climb->row * TURN;
        double *above = w->turns + climb->row_above * TURN;
        if (climb->parts)
            add_turn(s, position, climb, turn, &w->frame, fitted, e, w->curls);
        for (int m = 0; m < TURN; m += AT_ONCE)
            store(above + m, add(load(above + m), load(turn + m)));
    }
    add_curls(s, w->curls, way->curls, e);
}

/* Add the tilt and the pull in the stored pose to the normal equations of the slots (twin:
   rig_fit._add_stored_pose). */
static void add_stored_pose(const Surface *s, Vector position, const StoredTilt *stored, const Fitted *fitted,
                            Equations e)
{
    Vector over[MOST_FITTED];
    Vectors by_gradients = both_vectors((Vector){0.0, 0.0, 0.0});
    for (size_t i = 0; i <= e.unknowns; i++) {
        /* Where each joint moves the vertex, from the point of the class. */
        over[i] = minus(moved_by(stored_matrix(s, fitted->joints[i]), position), stored->point);
        by_gradients = plus_each(by_gradients, times_each(both_vectors(over[i]), fitted->given[i]));
    }
    const double weight = s->fit.stored * stored->weight, pull = s->fit.stiffness * weight;
    for (size_t i = 0; i < e.unknowns; i++) {
        /* α of the last slot is minus the sum of the others. */
        over[i] = minus(over[i], over[e.unknowns]);
        const double raised = weight * dot(over[i], stored->normal);
        const Pair pulled = scaled(pull, dots(both_vectors(over[i]), by_gradients));
        e.right[i] = add_pairs(e.right[i], subtract_pairs(pulled, scaled(raised, stored->tilts)));
        for (size_t k = 0; k <= i; k++)
            e.matrix[i * e.stride + k] += raised * dot(over[k], stored->normal) + pull * dot(over[i], over[k]);
    }
}

/* Solve the normal equations, by the factors L D Lt in place of the matrix. The right side becomes the solution.
   Returns 0 where it is in doubt: not finite, or elimination takes all of a diagonal entry but `least` of it. */
static ALWAYS_INLINE int solve(Equations e, double least)
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

/* Move the gradients of the fitted slots, in the plane of the class's tangents, towards the solution of the least
   squares. */
static ALWAYS_INLINE void move_gradients(const Surface *s, const Fitted *fitted, Equations e, Scratch *w)
{
    const Vector *tangents = w->frame.tangents;
    const size_t unknowns = e.unknowns;
    const double pull = s->fit.even * fitted->reach;
    for (size_t i = 0; i < unknowns; i++) {
        /* The pull of each slot. That of the last one is on all unknowns. */
        for (size_t k = 0; k <= i; k++)
            e.matrix[i * e.stride + k] += k == i ? 2.0 * pull : pull;
        e.right[i] =
            add_pairs(e.right[i], scaled(pull, subtract_pairs(fitted->given[i], fitted->given[unknowns])));
    }
    if (!solve(e, s->fit.flat * s->fit.flat))
        return;
    e.right[unknowns] = both(0.0);
    for (size_t i = 0; i < unknowns; i++)
        e.right[unknowns] = subtract_pairs(e.right[unknowns], e.right[i]);
    /* The change along both tangents, and the largest one beside the largest gradient, squared. */
    double change = 0.0, given = 0.0;
    for (size_t i = 0; i <= unknowns; i++) {
        e.right[i] = scaled(s->fit.drawn, subtract_pairs(e.right[i], fitted->given[i]));
        const double moved = squared_length(e.right[i]), had = squared_length(fitted->given[i]);
        change = moved > change ? moved : change, given = had > given ? had : given;
    }
    double share = 1.0;
    if (change > s->fit.bounded * s->fit.bounded * given) {
        const double most = s->fit.bounded * fmax(sqrt(given), steepest_slope(s, w));
        share = fmin(1.0, most / sqrt(change));
    }
    for (size_t i = 0; i <= unknowns; i++) {
        /* What is along the normal stays. */
        Vector *gradient = &w->gradients[fitted->slots[i]];
        const Pair by = scaled(share, e.right[i]);
        *gradient = plus(*gradient, plus(times(tangents[0], part(by, 0)), times(tangents[1], part(by, 1))));
    }
}

/* Fit the gradients of some unknowns. */
static ALWAYS_INLINE void fit_unknowns(const Surface *s, size_t unknowns, Vector position, const Way *way,
                                       Fitted *fitted, Scratch *w)
{
    double few[(FEW_FITTED - 1) * (FEW_FITTED - 1)];
    Pair right[MOST_FITTED];
    Equations e = {few, right, unknowns, FEW_FITTED - 1};
    if (unknowns >= FEW_FITTED)
        e.matrix = w->matrix, e.stride = MOST_FITTED;
    gather_turns(s, position, way, fitted, e, w);
    if (s->stored && w->frame.stored.weight > 0.0)
        add_stored_pose(s, position, &w->frame.stored, fitted, e);
    if (fitted->reach > 0.0)
        move_gradients(s, fitted, e, w);
}

/* Fit the gradients by slot of one vertex to the rig. */
FOR_PROCESSORS(void, fit_vertex,
               (const Surface *s, size_t vertex, size_t turnings, const Vector *position, Scratch *w),
               (s, vertex, turnings, position, w))
{
    Fitted fitted;
    int chosen = s->slots == 4 ? choose_slots(s, 4, vertex, w, &fitted)
                               : choose_slots(s, (size_t)s->slots, vertex, w, &fitted);
    if (!chosen)
        return;
    const Way *way = find_way(s, turnings, &fitted, w);
    if (!way->ends)
        return;
    switch (fitted.unknowns) {
    case 1:
        fit_unknowns(s, 1, *position, way, &fitted, w);
        break;
    case 2:
        fit_unknowns(s, 2, *position, way, &fitted, w);
        break;
    case 3:
        fit_unknowns(s, 3, *position, way, &fitted, w);
        break;
    default:
        fit_unknowns(s, fitted.unknowns, *position, way, &fitted, w);
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
        fit_vertex(s, vertex, found->turnings, &position, w);
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
