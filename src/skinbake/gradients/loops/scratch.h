/* What is known of one weld class while it is baked, and the room for it. */

#pragma once

#include "surface.h"

/* Some members of a group. */
typedef struct {
    const uint32_t *first;
    size_t count;
} Members;

/* What each copy of the loop knows beforehand: whether positions are doubles, whether gradients are fitted to a
   rig, and how many slots there are. */
typedef struct {
    int wide, fits;
    size_t slots;
} Shape;

enum { X1 = 0, Y1, Z1, X2, Y2, Z2, COMPONENTS };

/* What a weight adds to the turn of the two tangents of a class, as in ring_turns.RingTurns: the arms by axis, then
   the spins by axis, each a number for both tangents. */
enum { ARMS = 0, SPINS = 6, TURN = 12 };

/* What a weight of 1 at a neighbour adds: to the sum of gradients by axis, then to the derivatives along the two
   tangents that the fit follows. A zero fills the last place. */
enum { GRADIENT = 0, ALONG = 3, ADDED = 6 };

/* A neighbour of a class: the edge to it, and what it adds. It is alike if vertices have four slots, and if its own
   name the joints of the class in the same order. find_neighbours writes all of it, with zeros in `added`. Then
   add_corners adds to `added`, and sum_ring reads it. */
typedef struct {
    double edge[4]; /* x, y, z, 0 */
    double differences[AT_ONCE]; /* of the weights in the four slots; only of one that is alike */
    double added[ADDED];
    uint32_t vertex;
    int alike;
} Neighbour;

/* Some corners of a class at once, component by component. Edges lead to the two other corners of the triangle,
   the vertices `ends`. The sum multiplies the differences of skin weights along the edges by coefficients. weight is
   that of the corner in the mean (see weight_gradients.py). find_ends writes `ends`, find_neighbours or
   find_edges the edges, and weigh_corners the rest. */
typedef struct {
    uint32_t ends[AT_ONCE][2];
    Neighbour *neighbours[2][AT_ONCE]; /* by end: the ends in the ring, if there is one */
    Four edges[COMPONENTS];
    double coefficients[COMPONENTS][AT_ONCE], weight[AT_ONCE];
} Corners;

/* The triangles of some corners: e1 x e2, its length, and |e1|^2 |e2|^2. */
typedef struct {
    Four normal[3], area, squared_lengths;
} Facets;

/* Neighbours among which the next one is looked for; one that is met again later stands twice. */
enum { LOOKED_BACK = 16 };

/* Entries of the table that says where in the ring a vertex stands. */
enum { PLACES = 64 };

/* Corners of which a class is fitted at most, and joints that turn around one vertex or are fitted there (twins of the
   same names: ring_turns.py and fit.py). */
enum { MOST_CORNERS = 4096, MOST_TURNS = 128, MOST_FITTED = 64 };

/* The vertex whose normal was normalised last, and whether the normal had a direction. */
typedef struct {
    size_t vertex;
    Vector unit;
    int known, directed;
} Latest;

/* A joint matrix: its upper rows, row by row. */
enum { MATRIX = 12 };

/* A class in four poses, see posed_rings.PosedRings: each number four times. pose_four writes it. */
typedef struct {
    double share[AT_ONCE];       /* of each pose in the mean, 0 where it does not count */
    double normal[3 * AT_ONCE];  /* of the mesh in the pose */
    double still[2][3 * AT_ONCE]; /* both tangents without α and β */
    double tilts[2][AT_ONCE];    /* these along the normal */
    double least[AT_ONCE];       /* the squared length of both tangents, at least */
} PosedRing;

/* The squared tilts that a share s of α and β leaves change by −2 s along + s² square. */
typedef struct {
    double along, square;
} Ray;

/* The frame of a class, in which its turns are measured. begin_frame writes the first three, end_frame the others. */
typedef struct {
    Vector normal, tangents[2];
    Vectors along;       /* both tangents, component by component */
    Vectors leverage[2]; /* see ring_turns.ring_turns: by derivative; only of a sound class */
    int sound;           /* find_gradients writes 0, begin_frame whether there is a normal; end_frame may clear it */
} RingFrame;

/* What a neighbour adds to the turns of a joint, times the difference of the joint's weight: the edge times its
   coefficient along each tangent, by axis, then both coefficients. find_turn makes a turn of the sums. */
enum { BY_EDGE = 0, BY_ITSELF = 6, PRODUCTS = 8 };

/* A joint that may turn: which of the fitted slots it carries. */
typedef struct {
    int32_t joint; /* NO_JOINT: above all roots */
    int32_t rank;
    uint64_t carries; /* these slots, each as a bit */
    size_t row;       /* of the turns */
    int done;
} Node;

/* The turn of one node, and that of the node above it, which is given what it carries: their rows of the turns. */
typedef struct {
    size_t row, row_above;
    int parts; /* whether it parts the slots: if it does not, nothing else happens */
    double sign, pivot[3];
    uint64_t carries, moves; /* the slots that it carries, and those that it moves, each as a bit */
    int32_t chain;
    size_t curl; /* the number of its curl from 1 on, 0 for none */
} Climb;

/* All joints of a long chain that part the slots turn alike. `moved` is how that tilts the tangents for each unit of
   a slot's gradient, and `wanted` how it should tilt them, as in fit._add_turns. */
typedef struct {
    Vector moved[MOST_FITTED];
    Vectors wanted;
} Curl;

/* The way of the turns around a vertex up the rig, as plan_way finds it (there is a sketch of one). It depends on
   joints only, and the next vertex often has the same ones. */
typedef struct {
    int32_t *turning_joints, *turning_numbers; /* joints around the class that turn, and their local numbers */
    size_t turnings;
    int32_t fitted_joints[MOST_FITTED]; /* the joints of the slots that are fitted */
    size_t fittings;
    int ends;                    /* 0: there are too many turns, and no fit */
    size_t spares, climbs;       /* spares: rows of nodes that have no turn of their own */
    size_t curls;
    Climb *climb;                /* from the lowest node up; MOST_TURNS, and one by slot */
} Way;

/* Rows of nodes without a turn of their own: those of fitted slots, and those above all others. */
enum { MOST_SPARES = MOST_FITTED + MOST_TURNS };

/* A curl has at least two turns. */
enum { MOST_CURLS = MOST_TURNS / 2 };

/* A joint whose weight varies around the class, and its local number. */
typedef struct {
    int32_t joint, local;
    int held;
    Vector gradient;
    double magnitude;
} Entry;

/* The numbers, four times each, in which add_poses sums up what so many unknowns do: two matrices and two right sides,
   and in each group of poses what a unit of a slot moves. */
#define LANES(unknowns) ((unknowns) * ((unknowns) + 1) + 8 * (unknowns))

/* Room to work in, enough for any class. Local numbers: slot k of the class has k, further joints follow.

   bake_classes takes one class after the other: find_gradients, with sum_corners in it, then write_vertex for each
   vertex of the class. Fields are ordered by how long they hold. What says *with a rig* is there only if gradients are
   fitted to one. */
typedef struct {
    /* As long as the scratch: */
    uint64_t visit; /* add_differences: the number of its calls so far, over all classes */
    uint64_t *seen; /* add_differences, by local number: the visit of the last neighbour with the joint */
    int stray;      /* an index was out of range at its use; set by whoever meets it, never cleared */
    Latest latest;  /* unit_of: until it is asked for another vertex */
    Way way;        /* plan_way: until a vertex has other joints. With a rig */

    /* Within one function. Before and after it they are as described: */
    int32_t *local;    /* sum_corners, by joint: its local number. -1 everywhere */
    int32_t *node_of;  /* plan_way, by joint: its node. -1 everywhere. With a rig */
    Node *nodes;       /* plan_way. With a rig */
    size_t node_count; /* plan_way: 0. With a rig */

    /* Until sum_corners has summed up the class. find_ring writes them. All with a rig: */
    void *corner_room; /* what corners was cut out of, aligned as vectors must be; as long as the scratch */
    Corners *corners;  /* all corners of the class */
    Neighbour *ring;   /* the ends of these corners */
    size_t neighbours; /* in the ring */
    int varies;        /* whether the weights of the ring do */
    double steepest;   /* steepest_slope: that of the ring, -1 until a fit asks for it */
    uint16_t places[PLACES]; /* by the last digits of a vertex: where it may stand in the ring. Never cleared, because
                                place_of looks into the ring */

    /* Until the next class: */
    int32_t *met;      /* by local number: the joint. sum_corners writes those of slots, add_differences the others */
    double *own;       /* sum_corners, by slot: the class's weight */
    double *x, *y, *z; /* sum_corners, by local number: the components of the sum */
    Entry *entries;    /* make_entries; `held` is of the vertex that was projected last */
    Entry **foreign;   /* find_foreign: into the entries */
    RingFrame frame;   /* see there. With a rig */
    double *turns;     /* sum_turns, by local number: TURN each. A fit adds to them, and project_fitted puts them back
                          unless no vertex follows. From first_spare on they are of one vertex. With a rig */
    PosedRing *posed;   /* pose_ring: the class in each group of poses. With a rig */
    double *ends;       /* pose_ring, by local number and group: where the joint takes the class. With a rig */
    Ray ray, turned;    /* fit_vertex adds those of each vertex, and of its turns alone. With a rig */
    size_t first_spare; /* the first spare row of the turns, of nodes without a turn of their own; always the same */
    int32_t *turning_numbers; /* find_turning: the local numbers of the joints that turn. With a rig */
    int known_turnings;       /* whether the way is of these joints: find_turning tells, plan_way makes it so */

    /* Until the next vertex: */
    int32_t *named;    /* name_slots, by slot: the joint whose gradient it has */
    Vector *gradients; /* project_fitted, by slot; move_gradients changes them. With a rig */
    double *shares;    /* project_fitted, by slot: of the lengths of all gradients. With a rig */
    double *kept;      /* project_fitted: the turns of the class, while a fit adds to them. With a rig */
    double *matrix;    /* fit_unknowns: three of MOST_FITTED squared, for vertices of many slots. With a rig */
    double *lanes;     /* add_poses: sums by pose, four numbers each; see LANES. With a rig */
    Curl *curls;       /* gather_turns: as many as the way has. With a rig */
} Scratch;

static void free_scratch(Scratch *w)
{
    free(w->local), free(w->met), free(w->seen), free(w->own), free(w->x), free(w->y), free(w->z);
    free(w->entries), free(w->foreign), free(w->named);
    free(w->corner_room), free(w->ring), free(w->turns), free(w->gradients), free(w->shares), free(w->nodes);
    free(w->node_of), free(w->turning_numbers), free(w->kept), free(w->matrix), free(w->curls);
    free(w->posed), free(w->ends), free(w->lanes);
    free(w->way.turning_joints), free(w->way.turning_numbers), free(w->way.climb);
}

static Status allocate_fit(Scratch *w, const Surface *s)
{
    size_t joints = (size_t)s->joint_count, room = joints + (size_t)s->slots;
    w->corner_room = malloc((MOST_CORNERS / AT_ONCE + 1) * sizeof *w->corners);
    w->corners = (Corners *)(((uintptr_t)w->corner_room + sizeof(Four) - 1) / sizeof(Four) * sizeof(Four));
    w->ring = malloc(2 * MOST_CORNERS * sizeof *w->ring);
    w->first_spare = room;
    w->turns = malloc((room + MOST_SPARES) * TURN * sizeof *w->turns);
    w->gradients = malloc((size_t)s->slots * sizeof *w->gradients);
    w->shares = malloc((size_t)s->slots * sizeof *w->shares);
    w->nodes = malloc((joints + 1) * sizeof *w->nodes);
    w->node_of = malloc((joints + 1) * sizeof *w->node_of);
    w->matrix = malloc(3 * MOST_FITTED * MOST_FITTED * sizeof *w->matrix);
    w->lanes = malloc(AT_ONCE * LANES(MOST_FITTED) * sizeof *w->lanes);
    w->posed = malloc((s->pose_groups + 1) * sizeof *w->posed);
    w->ends = malloc((room * s->pose_groups * 3 + 1) * AT_ONCE * sizeof *w->ends);
    w->curls = malloc(MOST_CURLS * sizeof *w->curls);
    w->turning_numbers = malloc(room * sizeof *w->turning_numbers);
    w->kept = malloc(room * TURN * sizeof *w->kept);
    w->way.turning_joints = malloc(room * sizeof *w->way.turning_joints);
    w->way.turning_numbers = malloc(room * sizeof *w->way.turning_numbers);
    w->way.climb = malloc((MOST_TURNS + (size_t)s->slots) * sizeof *w->way.climb);
    if (!w->corner_room || !w->ring || !w->turns || !w->gradients || !w->shares || !w->nodes || !w->node_of ||
        !w->turning_numbers || !w->kept || !w->way.turning_joints || !w->way.turning_numbers || !w->way.climb ||
        !w->matrix || !w->curls || !w->lanes || !w->posed || !w->ends)
        return NO_MEMORY;
    memset(w->node_of, 0xFF, (joints + 1) * sizeof *w->node_of);
    return DONE;
}

static Status allocate_scratch(Scratch *w, const Surface *s)
{
    size_t joints = (size_t)s->joint_count, room = joints + (size_t)s->slots;
    w->local = malloc((joints + 1) * sizeof *w->local);
    w->met = malloc(room * sizeof *w->met);
    w->seen = calloc(room, sizeof *w->seen);
    w->own = malloc((size_t)s->slots * sizeof *w->own);
    w->x = malloc(room * sizeof *w->x);
    w->y = malloc(room * sizeof *w->y);
    w->z = malloc(room * sizeof *w->z);
    w->entries = malloc(room * sizeof *w->entries);
    w->foreign = malloc(room * sizeof *w->foreign);
    w->named = malloc((size_t)s->slots * sizeof *w->named);
    if (!w->local || !w->met || !w->seen || !w->own || !w->x || !w->y || !w->z || !w->entries ||
        !w->foreign || !w->named)
        return NO_MEMORY;
    memset(w->local, 0xFF, (joints + 1) * sizeof *w->local);
    return s->parents ? allocate_fit(w, s) : DONE;
}

/* Where the joint of a local number takes the class, in four poses. */
static ALWAYS_INLINE double *ends_of(const Surface *s, const Scratch *w, int32_t number, size_t group)
{
    return w->ends + ((size_t)number * s->pose_groups + group) * 3 * AT_ONCE;
}
