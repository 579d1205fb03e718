/* The loop over all weld classes of a surface (twin: by_numpy.bake_surface). */

#pragma once

#include "vertex_fit.h"

static size_t shared_capacity(const Surface *s, Members vertices)
{
    size_t least = (size_t)s->slots;
    for (size_t n = 0; n < vertices.count; n++) {
        size_t free_count = 0;
        for (Py_ssize_t k = 0; k < s->slots; k++)
            free_count += s->free_slots[vertices.first[n] * (size_t)s->slots + (size_t)k] != 0;
        least = free_count < least ? free_count : least;
    }
    return least;
}

/* The state of a bake: the surface, its corners and vertices by weld class, the classes to bake, and room to work
   in. */
typedef struct {
    const Surface *surface;
    const Grouped *grouped;
    size_t first, last;
    Scratch scratch;
    const Baked *out;
} Work;

/* Sum up the gradients of a class of some vertices, into the scratch. */
static ALWAYS_INLINE ClassGradients find_gradients(Work *work, Shape shape, Members corners, Members vertices)
{
    const Surface *s = work->surface;
    ClassGradients found = {0, 0, 0, 0, 0, 0.0};
    work->scratch.frame.sound = 0;
    work->scratch.ray = work->scratch.turned = (Ray){0.0, 0.0};
    if (corners.count == 0)
        return found;
    /* The sums over the ring: gradients, and the turns of joints if they are fitted to a rig. */
    double total;
    int32_t used = sum_corners(s, shape, corners, vertices, &work->scratch, &total);
    found.used = used;
    found.turnings = work->scratch.frame.sound ? find_turning(used, &work->scratch) : 0;
    /* The gradients of the joints, and those of joints that the class does not have. */
    found.entries = make_entries(&work->scratch, used, total, &found.magnitude);
    found.foreign = find_foreign(s, found.entries, found.magnitude, &work->scratch);
    found.capacity = found.foreign && s->adopts ? shared_capacity(s, vertices) : 0;
    return found;
}

/* The primitive of a vertex: the first one that ends after it. */
static ALWAYS_INLINE size_t primitive_of(const Baked *out, size_t vertex)
{
    size_t least = 0, most = out->primitives - 1;
    while (least < most) {
        const size_t middle = least + (most - least) / 2;
        if (vertex < out->ends[middle])
            most = middle;
        else
            least = middle + 1;
    }
    return least;
}

/* The part of α and β that a ray leaves, `most` times the best one. */
static ALWAYS_INLINE double share_of(const FitSettings *fit, Ray ray, double most)
{
    const double share = most * ray.along / ray.square;
    return ray.square > fit->flat_tilt && share < 1.0 ? fmax(0.0, share) : 1.0;
}

/* Shrink α and β of the vertices of a class as far as that lights its poses and turns better (twin: fit.fitted). */
static ALWAYS_INLINE void shrink_class(const Work *work, size_t slots, Members vertices)
{
    const FitSettings *fit = &work->surface->fit;
    const double share =
        fmin(share_of(fit, work->scratch.ray, fit->ray), share_of(fit, work->scratch.turned, 2.0 * fit->ray));
    if (share == 1.0)
        return;
    for (size_t n = 0; n < vertices.count; n++)
        for (size_t k = 0; k + 1 < slots; k++) {
            const size_t at = vertices.first[n] * (slots - 1) + k;
            work->out->alpha[at] = stored(share * work->out->alpha[at]);
            work->out->beta[at] = stored(share * work->out->beta[at]);
        }
}

/* Write all results of one vertex of a class. */
static ALWAYS_INLINE void write_vertex(Work *work, Shape shape, size_t vertex, Placing placing, int last,
                                       const ClassGradients *found)
{
    const Surface *s = work->surface;
    const Baked *out = work->out;
    Scratch *w = &work->scratch;
    Sums *sums = out->sums + primitive_of(out, vertex);
    /* Which slot holds the gradient of which joint. */
    if (placing == AS_NAMED)
        sums->adopting += name_slots(s, vertex, found, w, out->adopted + vertex * shape.slots);
    sums->magnitude += found->magnitude;
    sums->unheld += shape.fits ? project_fitted(s, shape, vertex, last, found, out, w)
                               : project(s, shape.slots, vertex, found->entries, placing, out, w);
    /* A vertex overflows if a foreign joint has found no slot. */
    int overflows = 0;
    for (size_t f = 0; f < found->foreign; f++)
        overflows |= !w->foreign[f]->held;
    sums->overflowing += overflows;
}

static ALWAYS_INLINE Status bake_classes(Work *work, Shape shape)
{
    const Groups *corners = &work->grouped->corners, *vertices = &work->grouped->vertices;
    for (size_t c = work->first; c < work->last; c++) {
        uint32_t itself = (uint32_t)c;
        if (corners->start[c + 1] < corners->start[c] ||
            (vertices->start && vertices->start[c + 1] < vertices->start[c]))
            return STRAY_INDEX; /* the classes have changed while they were counted */
        /* The vertices of the class. It may be a single one, of its own number. */
        Members own = {&itself, 1};
        if (vertices->start)
            own = (Members){vertices->members + vertices->start[c], vertices->start[c + 1] - vertices->start[c]};
        if (own.count == 0)
            continue;
        /* Gradients are those of the class; each vertex then has its own slots and frame. */
        Members around = {corners->members + corners->start[c], corners->start[c + 1] - corners->start[c]};
        ClassGradients found = find_gradients(work, shape, around, own);
        for (size_t n = 0; n < own.count; n++) {
            int adopts_nothing = found.foreign == 0 || found.capacity == 0;
            Placing placing = n == 0 && adopts_nothing && !shape.fits ? AS_NUMBERED : AS_NAMED;
            write_vertex(work, shape, own.first[n], placing, n + 1 == own.count, &found);
        }
        if (shape.fits && work->scratch.frame.sound)
            shrink_class(work, shape.slots, own);
    }
    return work->scratch.stray ? STRAY_INDEX : DONE;
}

/* Copies of the loop for the usual cases. They need not check types and counts for each vertex. */
FOR_PROCESSORS(Status, bake_all_classes, (Work *work), (work))
{
    const size_t slots = (size_t)work->surface->slots;
    const int wide = work->surface->wide_positions, fits = work->surface->parents != NULL;
    if (!wide && slots == 4)
        return fits ? bake_classes(work, (Shape){0, 1, 4}) : bake_classes(work, (Shape){0, 0, 4});
    return fits ? bake_classes(work, (Shape){wide, 1, slots}) : bake_classes(work, (Shape){wide, 0, slots});
}

/* Bake the weld classes from first up to last. */
static Status bake_grouped(const Surface *s, const Grouped *grouped, size_t first, size_t last, const Baked *out)
{
    /* Each thread has room of its own to work in. */
    Work work;
    memset(&work, 0, sizeof work);
    work.surface = s, work.grouped = grouped, work.first = first, work.last = last, work.out = out;
    Status status = allocate_scratch(&work.scratch, s);
    if (status == DONE)
        status = bake_all_classes(&work);
    free_scratch(&work.scratch);
    return status;
}

/* Check the range of indices, and find the number of joints. Return -1 with an exception if one is wrong. */
static int check_surface(Surface *s)
{
    if (s->class_count < 0 || s->class_count > s->vertices) {
        PyErr_SetString(PyExc_ValueError, "there are more weld classes than vertices, or less than none");
        return -1;
    }
    /* Joints: they may be missing only where the weight is 0. */
    int32_t largest = 0;
    for (Py_ssize_t n = 0; n < s->vertices * s->slots; n++) {
        largest = s->joints[n] > largest ? s->joints[n] : largest;
        if (s->joints[n] < 0 && s->weights[n] != 0.0) {
            PyErr_SetString(PyExc_ValueError, "a slot without a joint has a weight");
            return -1;
        }
    }
    s->joint_count = (Py_ssize_t)largest + 1;
    /* Weld classes and sizes, which the loops then need not check. */
    for (Py_ssize_t v = 0; v < s->vertices; v++)
        if (s->classes[v] < 0 || s->classes[v] >= s->class_count) {
            PyErr_SetString(PyExc_IndexError, "a weld class is out of range");
            return -1;
        }
    if (s->triangle_count > UINT32_MAX / 4 || s->vertices >= INT32_MAX) {
        PyErr_SetString(PyExc_ValueError, "too many triangles or vertices for one surface");
        return -1;
    }
    return 0;
}

/* Take the joints of the rig into account. Return -1 with an exception if it has too few, or too many. */
static int check_rig(Surface *s)
{
    if (s->parents && s->rig_joints < s->joint_count) {
        PyErr_SetString(PyExc_ValueError, "the rig has too few joints");
        return -1;
    }
    /* Joints of the rig may turn that no vertex names. */
    s->joint_count = s->parents ? s->rig_joints : s->joint_count;
    if (s->joint_count > INT32_MAX - s->slots) { /* local numbers count both */
        PyErr_SetString(PyExc_ValueError, "too many joints for one surface");
        return -1;
    }
    return 0;
}

enum { POSITIONS, TRIANGLES, JOINTS, WEIGHTS, FREE_SLOTS, CLASSES, NORMALS, TANGENTS, BITANGENTS, ALPHA, BETA, ADOPTED,
       ENDS, SUMS, PARENTS, RANKS, PIVOTS, CHAINS, POSES, SHARES, ARRAYS };

static const Requirement surface_arrays[ARRAYS] = {
    [POSITIONS] = {"positions", "fd", AXIS_V, AXIS_3, READ},
    [TRIANGLES] = {"triangles", "iI", AXIS_T, AXIS_3, READ},
    [JOINTS] = {"joints", "i", AXIS_V, AXIS_K, READ},
    [WEIGHTS] = {"weights", "d", AXIS_V, AXIS_K, READ},
    [FREE_SLOTS] = {"free", "?", AXIS_V, AXIS_K, READ},
    [CLASSES] = {"classes", "i", AXIS_V, AXIS_1, READ},
    [NORMALS] = {"normals", "fd", AXIS_V, AXIS_3, READ},
    [TANGENTS] = {"tangents", "fd", AXIS_FRAMES, AXIS_3, READ},
    [BITANGENTS] = {"bitangents", "fd", AXIS_FRAMES, AXIS_3, READ},
    [ALPHA] = {"alpha", "f", AXIS_V, AXIS_LATER_K, WRITTEN},
    [BETA] = {"beta", "f", AXIS_V, AXIS_LATER_K, WRITTEN},
    [ADOPTED] = {"adopted", "i", AXIS_V, AXIS_K, WRITTEN},
    [ENDS] = {"ends", "Q", AXIS_P, AXIS_1, READ},
    [SUMS] = {"sums", "d", AXIS_P, AXIS_4, WRITTEN},
    [PARENTS] = {"parents", "i", AXIS_J, AXIS_1, READ},
    [RANKS] = {"ranks", "i", AXIS_J, AXIS_1, READ},
    [PIVOTS] = {"pivots", "d", AXIS_J, AXIS_3, READ},
    [CHAINS] = {"chains", "i", AXIS_J, AXIS_1, READ},
    [POSES] = {"poses", "d", AXIS_J, AXIS_ANY, READ},
    [SHARES] = {"shares", "d", AXIS_ANY, AXIS_1, READ},
};

/* The classes to bake: those of `grouped` from first up to last, or all if it is None. */
typedef struct {
    PyObject *grouped;
    Py_ssize_t first, last;
} Part;

/* Take and check the arguments of bake_surface. Return -1 with an exception if one is wrong. */
static int read_surface(PyObject *args, PyObject *keywords, Array *a, Surface *s, Baked *out, Part *part)
{
    static char *names[] = {"positions", "triangles", "joints", "weights", "free", "classes", "normals", "tangents",
                            "bitangents", "alpha", "beta", "adopted", "ends", "sums", "parents", "ranks", "pivots",
                            "chains", "poses", "shares", "class_count", "weighting", "adopts",
                            "negligible", "stiffness", "turn", "together", "collapsed", "ray", "even", "unfelt",
                            "narrow", "flat", "flat_tilt", "bounded", "small", "grouped", "first", "last", NULL};
    PyObject *o[ARRAYS];
    Py_ssize_t class_count;
    int weighting, adopts;
    double negligible;
    FitSettings fit;
    if (!PyArg_ParseTupleAndKeywords(args, keywords, "$OOOOOOOOOOOOOOOOOOOOnipdddddddddddddOnn", names,
                                     &o[POSITIONS], &o[TRIANGLES], &o[JOINTS], &o[WEIGHTS], &o[FREE_SLOTS],
                                     &o[CLASSES], &o[NORMALS], &o[TANGENTS], &o[BITANGENTS], &o[ALPHA], &o[BETA],
                                     &o[ADOPTED], &o[ENDS], &o[SUMS],
                                     &o[PARENTS], &o[RANKS], &o[PIVOTS], &o[CHAINS], &o[POSES], &o[SHARES],
                                     &class_count, &weighting, &adopts, &negligible,
                                     &fit.stiffness, &fit.turn, &fit.together, &fit.collapsed, &fit.ray, &fit.even,
                                     &fit.unfelt, &fit.narrow, &fit.flat, &fit.flat_tilt, &fit.bounded, &fit.small,
                                     &part->grouped, &part->first, &part->last))
        return -1;
    if (read_arrays(o, surface_arrays, ARRAYS, 2, a) < 0)
        return -1;
    const uint64_t *ends = a[ENDS].buffer.buf;
    const Py_ssize_t four = MATRIX * AT_ONCE, groups = a[PARENTS].rows ? a[POSES].columns / four : 0;
    if (a[ENDS].rows < 1 || ends[a[ENDS].rows - 1] != (uint64_t)a[POSITIONS].rows ||
        a[TANGENTS].kind != a[BITANGENTS].kind ||
        (a[PARENTS].rows && (a[POSES].columns != groups * four || a[SHARES].rows != groups * AT_ONCE))) {
        PyErr_SetString(PyExc_ValueError, "the arrays of the surface do not belong together");
        return -1;
    }
    if (weighting < 0 || weighting >= WEIGHTINGS) {
        PyErr_Format(PyExc_ValueError, "there is no weighting %d", weighting);
        return -1;
    }
    *s = (Surface){
        .positions = a[POSITIONS].buffer.buf,
        .normals = a[NORMALS].buffer.buf,
        .tangents = a[TANGENTS].rows ? a[TANGENTS].buffer.buf : NULL,
        .bitangents = a[BITANGENTS].buffer.buf,
        .wide_positions = a[POSITIONS].kind == 'd',
        .wide_normals = a[NORMALS].kind == 'd',
        .wide_frame = a[TANGENTS].kind == 'd',
        .triangles = a[TRIANGLES].buffer.buf,
        .joints = a[JOINTS].buffer.buf,
        .weights = a[WEIGHTS].buffer.buf,
        .free_slots = a[FREE_SLOTS].buffer.buf,
        .classes = a[CLASSES].buffer.buf,
        .vertices = a[POSITIONS].rows,
        .slots = a[JOINTS].columns,
        .triangle_count = a[TRIANGLES].rows,
        .class_count = class_count,
        .weighting = (Weighting)weighting,
        .adopts = adopts,
        .negligible = negligible,
        .parents = a[PARENTS].rows ? a[PARENTS].buffer.buf : NULL,
        .ranks = a[RANKS].buffer.buf,
        .pivots = a[PIVOTS].buffer.buf,
        .chains = a[CHAINS].buffer.buf,
        .poses = a[POSES].buffer.buf,
        .pose_shares = a[SHARES].buffer.buf,
        .pose_groups = (size_t)groups,
        .rig_joints = a[PARENTS].rows,
        .fit = fit,
    };
    *out = (Baked){
        .alpha = a[ALPHA].buffer.buf,
        .beta = a[BETA].buffer.buf,
        .adopted = a[ADOPTED].buffer.buf,
        .ends = ends,
        .primitives = (size_t)a[ENDS].rows,
        .sums = a[SUMS].buffer.buf,
    };
    return 0;
}

static const char capsule_name[] = "skinbake.gradients._kernel.grouped";

static void free_capsule(PyObject *capsule)
{
    Grouped *grouped = PyCapsule_GetPointer(capsule, capsule_name);
    if (grouped)
        free_grouped(grouped);
    free(grouped);
}

/* The groups of a capsule that belong to a surface. Return NULL with an exception if they are of another one. */
static const Grouped *groups_of(const Part *part, Surface *s)
{
    const Grouped *grouped = PyCapsule_GetPointer(part->grouped, capsule_name);
    if (grouped == NULL)
        return NULL;
    if (grouped->vertex_count != s->vertices || grouped->slots != s->slots ||
        grouped->triangle_count != s->triangle_count || grouped->class_count != s->class_count || part->first < 0 ||
        part->first > part->last || part->last > s->class_count) {
        PyErr_SetString(PyExc_ValueError, "the groups belong to another surface, or the classes are out of range");
        return NULL;
    }
    s->joint_count = grouped->joint_count;
    return grouped;
}

static PyObject *bake_surface(PyObject *Py_UNUSED(module), PyObject *args, PyObject *keywords)
{
    PyObject *result = NULL;
    Array a[ARRAYS];
    memset(a, 0, sizeof a);
    Surface surface;
    Baked out;
    Part part = {Py_None, 0, 0};
    const Grouped *given = NULL;
    if (read_surface(args, keywords, a, &surface, &out, &part) < 0)
        goto done;
    if (part.grouped == Py_None ? check_surface(&surface) < 0 : (given = groups_of(&part, &surface)) == NULL)
        goto done;
    if (check_rig(&surface) < 0)
        goto done;
    Status status;
    Py_BEGIN_ALLOW_THREADS
    if (given) {
        status = bake_grouped(&surface, given, (size_t)part.first, (size_t)part.last, &out);
    } else {
        Grouped own;
        status = group_all(&surface, &own);
        if (status == DONE)
            status = bake_grouped(&surface, &own, 0, (size_t)surface.class_count, &out);
        free_grouped(&own);
    }
    Py_END_ALLOW_THREADS
    if (status == DONE)
        result = Py_NewRef(Py_None);
    else
        raise_status(status);
done:
    release_arrays(a, ARRAYS);
    return result;
}

static PyObject *group_surface(PyObject *Py_UNUSED(module), PyObject *args)
{
    enum { GROUPED_TRIANGLES, GROUPED_JOINTS, GROUPED_WEIGHTS, GROUPED_CLASSES, GROUPED_ARRAYS };
    static const Requirement required[GROUPED_ARRAYS] = {
        [GROUPED_TRIANGLES] = {"triangles", "iI", AXIS_T, AXIS_3, READ},
        [GROUPED_JOINTS] = {"joints", "i", AXIS_V, AXIS_K, READ},
        [GROUPED_WEIGHTS] = {"weights", "d", AXIS_V, AXIS_K, READ},
        [GROUPED_CLASSES] = {"classes", "i", AXIS_V, AXIS_1, READ},
    };
    PyObject *o[GROUPED_ARRAYS], *result = NULL;
    Array a[GROUPED_ARRAYS];
    memset(a, 0, sizeof a);
    Py_ssize_t class_count;
    Grouped *grouped = NULL;
    if (!PyArg_ParseTuple(args, "OOOOn", &o[GROUPED_TRIANGLES], &o[GROUPED_JOINTS], &o[GROUPED_WEIGHTS],
                          &o[GROUPED_CLASSES], &class_count))
        return NULL;
    if (read_arrays(o, required, GROUPED_ARRAYS, 2, a) < 0)
        goto done;
    Surface surface = {
        .triangles = a[GROUPED_TRIANGLES].buffer.buf,
        .joints = a[GROUPED_JOINTS].buffer.buf,
        .weights = a[GROUPED_WEIGHTS].buffer.buf,
        .classes = a[GROUPED_CLASSES].buffer.buf,
        .vertices = a[GROUPED_JOINTS].rows,
        .slots = a[GROUPED_JOINTS].columns,
        .triangle_count = a[GROUPED_TRIANGLES].rows,
        .class_count = class_count,
    };
    if (check_surface(&surface) < 0)
        goto done;
    grouped = calloc(1, sizeof *grouped);
    if (grouped == NULL) {
        PyErr_NoMemory();
        goto done;
    }
    Status status;
    Py_BEGIN_ALLOW_THREADS
    status = group_all(&surface, grouped);
    Py_END_ALLOW_THREADS
    if (status == DONE)
        result = PyCapsule_New(grouped, capsule_name, free_capsule);
    else
        raise_status(status);
    if (result == NULL) {
        free_grouped(grouped);
        free(grouped);
    }
done:
    release_arrays(a, GROUPED_ARRAYS);
    return result;
}
