/* Sums over the ring of a weld class: its gradients, and how turns of joints tilt its tangents (twins:
   weight_gradients.py and ring_turns.RingTurns). */

#pragma once

#include "corners.h"
#include "posed_ring.h"

/* Work out the leverage of both tangents from the derivatives of the positions along them. */
static ALWAYS_INLINE void find_leverage(RingFrame *f, const Vector derivatives[2], double narrow)
{
    Vector a = derivatives[0], b = derivatives[1], c = cross(a, b);
    double area = sqrt(dot(c, c));
    f->sound &= area > narrow;
    if (!f->sound)
        return;
    /* q of ring_turns.ring_turns, for both tangents at once. */
    const Vector unit = times(c, 1.0 / area), lean = minus(f->normal, times(unit, 0.5 * dot(unit, f->normal)));
    const Vectors t = f->along, normal = both_vectors(f->normal);
    const Vectors q = times_each(both_vectors(lean), divide_pairs(dots(t, both_vectors(unit)), both(area)));
    /* u = t_a n + b × q, v = t_b n + q × a. */
    const Parts parts = parts_along(t, a, b, c, area);
    f->leverage[0] = plus_each(times_each(normal, parts.a), crosses(both_vectors(b), q));
    f->leverage[1] = plus_each(times_each(normal, parts.b), crosses(q, both_vectors(a)));
}

/* The sum of the unit normals at the corners of a class, of any length. It depends neither on the order of the
   vertices nor on how often one is stored. */
static ALWAYS_INLINE Vector sum_normals(const Surface *s, Members corners, Members vertices, Latest *latest)
{
    Four sums = all(0.0), unit = all(0.0);
    for (size_t n = 0; n < corners.count; n++) {
        size_t vertex = vertices.first[0];
        if (vertices.count > 1)
            vertex = s->triangles[3 * (size_t)(corners.first[n] >> 2) + (corners.first[n] & 3)];
        if (vertex >= (size_t)s->vertices)
            continue; /* find_ends notes what has changed since the check */
        /* A class of one vertex has one normal for all of its corners. */
        if (n == 0 || vertices.count > 1) {
            Vector found = unit_of(s, vertex, latest);
            unit = latest->directed ? four(found.x, found.y, found.z, 0.0) : all(0.0);
        }
        sums = add(sums, unit);
    }
    double each[AT_ONCE];
    store(each, sums);
    const Vector sum = {each[0], each[1], each[2]};
    /* Normals that cancel out leave no direction. */
    double least = s->fit.flat * (double)corners.count;
    return dot(sum, sum) > least * least ? sum : (Vector){0.0, 0.0, 0.0};
}

/* Write six numbers of four corners by corner. */
static ALWAYS_INLINE void transpose_corners(const Four numbers[ADDED], double by_corner[AT_ONCE][ADDED])
{
#if defined(HAS_SHUFFLES)
    Four low = __builtin_shufflevector(numbers[0], numbers[1], 0, 4, 2, 6);  /* of corners 0 and 2 */
    Four high = __builtin_shufflevector(numbers[0], numbers[1], 1, 5, 3, 7); /* of corners 1 and 3 */
    Four low2 = __builtin_shufflevector(numbers[2], numbers[3], 0, 4, 2, 6);
    Four high2 = __builtin_shufflevector(numbers[2], numbers[3], 1, 5, 3, 7);
    Four low3 = __builtin_shufflevector(numbers[4], numbers[5], 0, 4, 2, 6);
    Four high3 = __builtin_shufflevector(numbers[4], numbers[5], 1, 5, 3, 7);
    store(by_corner[0], __builtin_shufflevector(low, low2, 0, 1, 4, 5));
    store(by_corner[1], __builtin_shufflevector(high, high2, 0, 1, 4, 5));
    store(by_corner[2], __builtin_shufflevector(low, low2, 2, 3, 6, 7));
    store(by_corner[3], __builtin_shufflevector(high, high2, 2, 3, 6, 7));
    store_pair(by_corner[0] + 4, __builtin_shufflevector(low3, low3, 0, 1));
    store_pair(by_corner[1] + 4, __builtin_shufflevector(high3, high3, 0, 1));
    store_pair(by_corner[2] + 4, __builtin_shufflevector(low3, low3, 2, 3));
    store_pair(by_corner[3] + 4, __builtin_shufflevector(high3, high3, 2, 3));
#else
    for (int m = 0; m < 6; m++) {
        double each[AT_ONCE];
        store(each, numbers[m]);
        for (int n = 0; n < AT_ONCE; n++)
            by_corner[n][m] = each[n];
    }
#endif
}

/* The place of a vertex in a ring: `count`, behind its end, where the vertex does not stand among the last ones. */
static ALWAYS_INLINE size_t place_of(uint32_t vertex, const Neighbour *ring, size_t count, const uint16_t *places)
{
    const size_t place = places[vertex % PLACES];
    if (place >= count)
        return count;
    /* Usually the vertex stood there not long ago: neighbouring corners share their ends. */
    const uint32_t held = ring[place].vertex;
    if (held == vertex && place + LOOKED_BACK >= count)
        return place;
    /* Every vertex of this class has left its place in the table, or a later one with the same last digits has. */
    if (held % PLACES == vertex % PLACES)
        for (size_t n = count; n-- > 0 && n + LOOKED_BACK >= count;)
            if (ring[n].vertex == vertex)
                return n;
    return count;
}

/* Find the ends of some corners of a class in its ring, and add those that are not there. Write the edges. */
static ALWAYS_INLINE void find_neighbours(const Surface *s, Shape shape, size_t vertex, size_t some, Corners *c,
                                          Scratch *w)
{
    const size_t slots = shape.slots;
    const double *here = s->weights + vertex * slots;
    const Four origin = row4(s->positions, shape.wide, vertex);
    Neighbour *const ring = w->ring;
    size_t count = w->neighbours;
    for (int end = 0; end < 2; end++) {
        const double *edges[AT_ONCE];
        for (size_t n = 0; n < some; n++) {
            /* The entry of the end, or the place behind the last one. */
            const uint32_t there = c->ends[n][end];
            const size_t place = place_of(there, ring, count, w->places);
            Neighbour *found = c->neighbours[end][n] = &ring[place];
            w->places[there % PLACES] = (uint16_t)place;
            edges[n] = found->edge;
            if (place < count)
                continue;
            count++;
            /* A new neighbour: its edge, and the differences of weights if its joints are those of the class. */
            const double *weights = s->weights + there * slots;
            found->vertex = there;
            found->alike = slots == 4 && same_joints(s, slots, vertex, there);
            store(found->edge, subtract(row4(s->positions, shape.wide, there), origin));
            memset(found->added, 0, sizeof found->added);
            if (found->alike)
                store(found->differences, subtract(load(weights), load(here)));
            w->varies = w->varies || !found->alike || memcmp(weights, here, slots * sizeof *here) != 0;
        }
        /* The edges of four corners by component. The first one fills what is missing. */
        for (size_t n = some; n < AT_ONCE; n++)
            edges[n] = edges[0];
        transpose_rows(edges, c->edges + 3 * end);
    }
    w->neighbours = count;
}

/* Sums over the corners of a class: the weights of both means, that of the bake and ROOT, the normals and
   doubled areas of the triangles, and the lengths of both edges, multiplied. sum_turns holds them, add_corners adds to
   them, end_frame reads them. */
typedef struct {
    double weight;
    Four root_weight, normal[3], area, lengths;
} CornerSums;

/* Add what some corners say to the neighbours at their ends, and to the sums. The derivatives that the fit follows
   are means with the weights ROOT of weight_gradients.py: 1 / (|e1| |e2|)^1.5 times A2. */
static ALWAYS_INLINE void add_corners(const Surface *s, Corners *c, size_t some, const Vector tangents[2],
                                      CornerSums *sums)
{
    static const double present[AT_ONCE][AT_ONCE] = {{1, 0, 0, 0}, {1, 1, 0, 0}, {1, 1, 1, 0}, {1, 1, 1, 1}};
    Facets facets;
    weigh_corners(c, s->weighting, &facets);
    const Four there = load(present[some < AT_ONCE ? some - 1 : AT_ONCE - 1]);
    const Four lengths = root(facets.squared_lengths), root_lengths = root(lengths);
    const Four weight = load(c->weight), root_weight = divide(facets.area, multiply(lengths, root_lengths));
    /* The weight ROOT over that of the bake. With Max's weights it is the root of |e1| |e2|. */
    const Four factor = s->weighting == BY_MAX ? root_lengths : divide(root_weight, weight);
    /* The sums of the class; corners that only fill up add nothing. */
    sums->root_weight = add(sums->root_weight, multiply(there, multiply(factor, weight)));
    sums->area = add(sums->area, multiply(there, facets.area));
    sums->lengths = add(sums->lengths, multiply(there, lengths));
    for (int axis = 0; axis < 3; axis++)
        sums->normal[axis] = add(sums->normal[axis], multiply(there, facets.normal[axis]));
    for (size_t n = 0; n < some; n++)
        sums->weight += c->weight[n];
    for (int end = 0; end < 2; end++) {
        /* Six numbers for each end: the coefficients, and g and h along both tangents. */
        const double(*component)[AT_ONCE] = c->coefficients + 3 * end;
        Four numbers[ADDED] = {load(component[X1]), load(component[Y1]), load(component[Z1])};
        for (int n = 0; n < 2; n++)
            numbers[ALONG + n] = multiply(factor, add(add(multiply(numbers[0], all(tangents[n].x)),
                                                          multiply(numbers[1], all(tangents[n].y))),
                                                      multiply(numbers[2], all(tangents[n].z))));
        numbers[ADDED - 1] = all(0.0);
        /* They are added to the neighbour at that end. */
        double by_corner[AT_ONCE][ADDED];
        transpose_corners(numbers, by_corner);
        for (size_t n = 0; n < some; n++) {
            double *sum = c->neighbours[end][n]->added;
            store(sum, add(load(sum), load(by_corner[n])));
            store_pair(sum + AT_ONCE, add_pairs(load_pair(sum + AT_ONCE), load_pair(by_corner[n] + AT_ONCE)));
        }
    }
}

/* Add a difference of weights times the products of a neighbour to those of one joint. */
static ALWAYS_INLINE void add_products(double *to, const Four products[PRODUCTS / AT_ONCE], double difference)
{
    for (int m = 0; m < PRODUCTS / AT_ONCE; m++)
        store(to + AT_ONCE * m, add(load(to + AT_ONCE * m), multiply(products[m], all(difference))));
}

/* Add what a neighbour says for every joint that it or the class has; as add_differences does. Return the number of
   local numbers in use. */
static ALWAYS_INLINE int32_t add_neighbour(const Surface *s, const Neighbour *neighbour,
                                           const Four products[PRODUCTS / AT_ONCE], int32_t used, Scratch *w)
{
    /* Gradients first: they number the joints that are new to the class. */
    const double *by = neighbour->added + GRADIENT;
    const int32_t before = used;
    used = add_differences(s, neighbour->vertex, (Vector){by[0], by[1], by[2]}, used, w);
    for (int32_t n = before; n < used; n++)
        memset(w->turns + n * TURN, 0, TURN * sizeof *w->turns);
    /* Products of joints that the neighbour has. */
    const int32_t slots = (int32_t)s->slots;
    const int32_t *there = s->joints + neighbour->vertex * (size_t)slots;
    const double *weight = s->weights + neighbour->vertex * (size_t)slots;
    for (int32_t k = 0; k < slots; k++) {
        const int32_t joint = there[k];
        if (weight[k] == 0.0 || (size_t)(uint32_t)joint >= (size_t)s->joint_count || w->local[joint] < 0)
            continue; /* add_differences has noted a stray joint, and numbered all others */
        int32_t number = w->local[joint];
        double difference = number < slots ? weight[k] - w->own[number] : weight[k];
        add_products(w->turns + number * TURN, products, difference);
    }
    for (int32_t k = 0; k < slots; k++)
        if (w->seen[k] != w->visit && w->own[k] != 0.0)
            add_products(w->turns + k * TURN, products, -w->own[k]);
    return used;
}

/* Turn the sums of products of one joint into its turn of both tangents, in place. */
static ALWAYS_INLINE void find_turn(const RingFrame *f, double shrink, double turn[TURN])
{
    const Vectors edges = load_vectors(turn + BY_EDGE), *u = f->leverage;
    const Pair along = scaled(shrink, load_pair(turn + BY_ITSELF));
    /* Arms: Σ Δw (g u + h v). Spins: Σ Δw g e × u + Σ Δw h e × v. */
    const Vectors by_a = both_vectors(one_of(edges, 0)), by_b = both_vectors(one_of(edges, 1));
    const Vectors arms = plus_each(times_each(u[0], both(part(along, 0))), times_each(u[1], both(part(along, 1))));
    const Vectors spins = times_each(plus_each(crosses(by_a, u[0]), crosses(by_b, u[1])), both(shrink));
    store(turn, join(arms.x, arms.y));
    store(turn + AT_ONCE, join(arms.z, spins.x));
    store(turn + 2 * AT_ONCE, join(spins.y, spins.z));
}

/* The normal of a class and its tangents. */
static ALWAYS_INLINE void begin_frame(const Surface *s, Members corners, Members vertices, Scratch *w)
{
    RingFrame *f = &w->frame;
    Vector given = sum_normals(s, corners, vertices, &w->latest);
    f->sound = unit_normal(given, &f->normal);
    frame_from_unit(f->normal, &f->tangents[0], &f->tangents[1]);
    const Vector *t = f->tangents;
    f->along = (Vectors){pair(t[0].x, t[1].x), pair(t[0].y, t[1].y), pair(t[0].z, t[1].z)};
}

/* The rest of the frame, from the sums over the corners and the derivatives of the positions. */
static ALWAYS_INLINE void end_frame(const Surface *s, const CornerSums *sums, Vectors derivatives, RingFrame *f)
{
    const Vector facing = sums_of(sums->normal);
    const double area = sum_of(sums->area), alignment = sqrt(dot(facing, facing)) / area;
    /* A ring whose triangles cancel out, or are slivers, has no plane to fit in. */
    f->sound &= alignment > s->fit.flat && area > s->fit.flat * sum_of(sums->lengths);
    const Vector means[2] = {one_of(derivatives, 0), one_of(derivatives, 1)};
    find_leverage(f, means, s->fit.narrow);
}

/* Add gradients and products over the ring of a class for every joint met. Return the number of local numbers in
   use, and the sums of the derivatives of the positions. */
static ALWAYS_INLINE int32_t sum_ring(const Surface *s, Shape shape, int32_t used, Vectors *derivatives, Scratch *w)
{
    const size_t slots = shape.slots;
    const Four none = all(0.0);
    Four gradients[3] = {none, none, none}, sums[AT_ONCE][PRODUCTS / AT_ONCE]; /* of the usual four slots */
    memset(w->turns, 0, (size_t)used * TURN * sizeof *w->turns);
    *derivatives = both_vectors((Vector){0.0, 0.0, 0.0});
    for (int k = 0; k < AT_ONCE; k++)
        for (int m = 0; m < PRODUCTS / AT_ONCE; m++)
            sums[k][m] = none;
    for (size_t n = 0; n < w->neighbours; n++) {
        const Neighbour *neighbour = &w->ring[n];
        /* g and h of the neighbour, and their products with the edge. */
        const Pair along = load_pair(neighbour->added + ALONG);
        const double *edge = neighbour->edge;
        const Vectors product = {scaled(edge[0], along), scaled(edge[1], along), scaled(edge[2], along)};
        *derivatives = plus_each(*derivatives, product);
        const Four products[PRODUCTS / AT_ONCE] = {join(product.x, product.y), join(product.z, along)};
        /* The usual case: the neighbour has the joints of the class, slot by slot. */
        if (slots == 4 && neighbour->alike) {
            const Four difference = load(neighbour->differences);
            for (int axis = 0; axis < 3; axis++)
                gradients[axis] = add(gradients[axis], multiply(all(neighbour->added[GRADIENT + axis]), difference));
            for (int k = 0; k < AT_ONCE; k++)
                for (int m = 0; m < PRODUCTS / AT_ONCE; m++)
                    sums[k][m] = add(sums[k][m], multiply(products[m], all(neighbour->differences[k])));
        } else
            used = add_neighbour(s, neighbour, products, used, w);
    }
    /* What the usual case has summed up in registers. */
    if (slots == 4) {
        double *to[3] = {w->x, w->y, w->z};
        for (int axis = 0; axis < 3; axis++)
            store(to[axis], add(load(to[axis]), gradients[axis]));
        for (int k = 0; k < AT_ONCE; k++)
            add_products(w->turns + k * TURN, sums[k], 1.0);
    }
    return used;
}

/* Measure the frame of a class, whose ring was found, and sum up gradients and turns for every joint met. Return the
   number of local numbers in use, and the weight of all corners as `total`. */
static ALWAYS_INLINE int32_t sum_turns(const Surface *s, Shape shape, Members corners, Members vertices, int32_t used,
                                       double *total, Scratch *w)
{
    RingFrame *f = &w->frame;
    const Four none = all(0.0);
    CornerSums sums = {0.0, none, {none, none, none}, none, none};
    Vectors derivatives;
    begin_frame(s, corners, vertices, w);
    /* The corners: what each says to its ends, and the sums of the class. */
    for (size_t from = 0; from < corners.count; from += AT_ONCE) {
        size_t some = corners.count - from < AT_ONCE ? corners.count - from : AT_ONCE;
        add_corners(s, w->corners + from / AT_ONCE, some, f->tangents, &sums);
    }
    /* The ring: gradients, products of all joints, and the derivatives of the positions. */
    used = sum_ring(s, shape, used, &derivatives, w);
    const double shrink = 1.0 / sum_of(sums.root_weight);
    derivatives = times_each(derivatives, both(shrink));
    end_frame(s, &sums, derivatives, f);
    /* The poses need the products, so they come before these become turns. */
    const Vector position = row3(s->positions, shape.wide, vertices.first[0]);
    if (f->sound)
        pose_ring(s, &position, &derivatives, shrink, used, w);
    for (int32_t n = 0; f->sound && n < used; n++)
        if (w->met[n] >= 0)
            find_turn(f, shrink, w->turns + n * TURN);
    *total = sums.weight;
    return used;
}

/* Sum up gradients over all corners, for every joint met. Return the number of local numbers in use, and the weight
   of all corners as `total`. */
static ALWAYS_INLINE int32_t sum_gradients(const Surface *s, Shape shape, Members corners, size_t vertex, int32_t used,
                                           double *total, Scratch *w)
{
    const size_t slots = shape.slots;
    Vector origin = row3(s->positions, shape.wide, vertex);
    Four none = four(0.0, 0.0, 0.0, 0.0), x = none, y = none, z = none; /* sums of the usual four slots */
    Four own = slots == 4 ? load(s->weights + vertex * slots) : none;
    *total = 0.0;
    for (size_t from = 0; from < corners.count; from += AT_ONCE) {
        const Members some = {corners.first + from, corners.count - from < AT_ONCE ? corners.count - from : AT_ONCE};
        /* Edges and coefficients of up to four corners. */
        Corners c;
        find_ends(s, some, &c, w);
        find_edges(s, shape, origin, some, &c);
        weigh_corners(&c, s->weighting, NULL);
        for (size_t n = 0; n < some.count; n++)
            for (int end = 0; end < 2; end++) {
                const size_t there = c.ends[n][end];
                const double(*component)[AT_ONCE] = c.coefficients + 3 * end;
                /* Each end adds the coefficient times its difference of weights. */
                Vector by = {component[X1][n], component[Y1][n], component[Z1][n]};
                if (slots == 4 && same_joints(s, slots, vertex, there)) {
                    Four difference = subtract(load(s->weights + there * slots), own);
                    x = add(x, multiply(four(by.x, by.x, by.x, by.x), difference));
                    y = add(y, multiply(four(by.y, by.y, by.y, by.y), difference));
                    z = add(z, multiply(four(by.z, by.z, by.z, by.z), difference));
                } else
                    used = add_differences(s, there, by, used, w);
            }
        for (size_t n = 0; n < some.count; n++)
            *total += c.weight[n];
    }
    if (slots == 4) {
        store(w->x, add(load(w->x), x));
        store(w->y, add(load(w->y), y));
        store(w->z, add(load(w->z), z));
    }
    return used;
}

/* Find the corners of a class and its ring. Return whether the weights vary there. */
static ALWAYS_INLINE int find_ring(const Surface *s, Shape shape, Members corners, size_t vertex, Scratch *w)
{
    w->neighbours = 0, w->varies = 0, w->steepest = -1.0;
    for (size_t from = 0; from < corners.count; from += AT_ONCE) {
        size_t some = corners.count - from < AT_ONCE ? corners.count - from : AT_ONCE;
        Corners *c = w->corners + from / AT_ONCE;
        find_ends(s, (Members){corners.first + from, some}, c, w);
        find_neighbours(s, shape, vertex, some, c, w);
    }
    return w->varies;
}

/* Sum over all corners, for every joint met. Return the number of local numbers in use, and the weight of all
   corners as `total`. */
static ALWAYS_INLINE int32_t sum_corners(const Surface *s, Shape shape, Members corners, Members vertices, Scratch *w,
                                         double *total)
{
    const size_t vertex = vertices.first[0];
    const size_t slots = shape.slots;
    const int32_t *joints = s->joints + vertex * slots;
    /* The first local numbers are those of the class's own slots. */
    int32_t used = (int32_t)slots;
    for (size_t k = 0; k < slots; k++) {
        const int32_t joint = joints[k];
        w->met[k] = (size_t)(uint32_t)joint < (size_t)s->joint_count ? joint : NO_JOINT;
        w->own[k] = s->weights[vertex * slots + k];
        w->x[k] = w->y[k] = w->z[k] = 0.0;
        if (w->met[k] >= 0)
            w->local[w->met[k]] = (int32_t)k;
    }
    /* Where no weight varies around the class, all sums stay 0. */
    *total = 1.0;
    if (!shape.fits || corners.count > MOST_CORNERS)
        used = sum_gradients(s, shape, corners, vertex, used, total, w);
    else if (find_ring(s, shape, corners, vertex, w))
        used = sum_turns(s, shape, corners, vertices, used, total, w);
    /* Local numbers hold for this class only. */
    for (int32_t n = 0; n < used; n++)
        if (w->met[n] >= 0)
            w->local[w->met[n]] = -1;
    return used;
}
