/* The loops of `skinbake bake` that visit every vertex, triangle or corner, for arrays that numpy owns.

   Each function has a twin in numpy (named beside it), which is the definition, the test's oracle, and what
   runs where this module could not be compiled. Here the same mathematics is written for one pass over
   memory: nothing is kept of a corner or a gradient once its vertex is done.

   Arrays come in through the buffer protocol: contiguous, aligned, and of the types that
   _kernel.pyi says. The GIL is released while a function works. Only the limited API of Python
   3.11 is used, so that one binary serves all later versions. Compile without fast-math and without
   contraction to fused multiply-adds: the same input gives the same bytes on every machine. */

#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030B0000
#include <Python.h>

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#if defined(_MSC_VER)
#define ALWAYS_INLINE __forceinline
#define PREFETCH(address) ((void)0)
#else
#define ALWAYS_INLINE inline __attribute__((always_inline))
#define PREFETCH(address) __builtin_prefetch(address)
#endif

/* Compiled twice, for processors with 256-bit vectors and for the others; the results are the same bits. */
#if defined(__x86_64__) && defined(__GLIBC__) && defined(__has_attribute)
#if __has_attribute(target_clones)
#define FOR_PROCESSORS __attribute__((target_clones("avx2", "default")))
#endif
#endif
#ifndef FOR_PROCESSORS
#define FOR_PROCESSORS
#endif

#define NO_JOINT (-1)

enum { MAX_WEIGHTING, ANGLE, AREA, ANGLE_AREA };

/* ---- Arrays ------------------------------------------------------------------------------------------ */

typedef struct {
    Py_buffer buffer;
    int held;
    Py_ssize_t rows, columns;
    char kind; /* f d: floats, i: int32, I: uint32, Q: uint64, ?: bytes */
} Array;

static void release(Array *arrays, int count)
{
    for (int n = 0; n < count; n++)
        if (arrays[n].held)
            PyBuffer_Release(&arrays[n].buffer);
}

static char kind_of(const Py_buffer *buffer)
{
    const char *format = buffer->format ? buffer->format : "B";
    while (*format == '<' || *format == '=' || *format == '@')
        format++;
    if (format[0] == '\0' || format[1] != '\0')
        return 0;
    switch (format[0]) {
    case 'f':
        return 'f';
    case 'd':
        return 'd';
    case '?': case 'b': case 'B':
        return '?';
    case 'i': case 'l': case 'q':
        return buffer->itemsize == 4 ? 'i' : 0;
    case 'I': case 'L': case 'Q':
        return buffer->itemsize == 4 ? 'I' : 'Q';
    }
    return 0;
}

/* Take an array of one or two axes; `kinds` lists the types it may have. `columns` of 0 allows any number. */
static int take(PyObject *object, Array *array, const char *name, const char *kinds, Py_ssize_t columns,
                int writable)
{
    int flags = PyBUF_C_CONTIGUOUS | PyBUF_FORMAT | (writable ? PyBUF_WRITABLE : 0);
    if (PyObject_GetBuffer(object, &array->buffer, flags) < 0)
        return -1;
    array->held = 1;
    const Py_buffer *buffer = &array->buffer;
    array->kind = kind_of(buffer);
    if (array->kind == 0 || strchr(kinds, array->kind) == NULL) {
        PyErr_Format(PyExc_TypeError, "%s has elements of type %s", name, buffer->format);
        return -1;
    }
    if (buffer->ndim < 1 || buffer->ndim > 2 || (uintptr_t)buffer->buf % (uintptr_t)buffer->itemsize) {
        PyErr_Format(PyExc_ValueError, "%s is not an aligned array of one or two axes", name);
        return -1;
    }
    array->rows = buffer->shape[0];
    array->columns = buffer->ndim == 2 ? buffer->shape[1] : 1;
    if (columns && array->columns != columns) {
        PyErr_Format(PyExc_ValueError, "%s has %zd columns, not %zd", name, array->columns, columns);
        return -1;
    }
    return 0;
}

static int same_rows(const Array *array, const char *name, Py_ssize_t rows)
{
    if (array->rows == rows)
        return 0;
    PyErr_Format(PyExc_ValueError, "%s has %zd rows, not %zd", name, array->rows, rows);
    return -1;
}

/* A vertex has `least` slots or more. */
static int least_slots(const Array *joints, Py_ssize_t least)
{
    if (joints->columns >= least)
        return 0;
    PyErr_Format(PyExc_ValueError, "joints has %zd columns; at least %zd are needed", joints->columns, least);
    return -1;
}

typedef struct {
    double x, y, z;
} Vector;

/* Row `row` of an array (n, 3) of floats or doubles. */
static ALWAYS_INLINE Vector row3(const void *base, int wide, size_t row)
{
    if (wide) {
        const double *p = (const double *)base + 3 * row;
        return (Vector){p[0], p[1], p[2]};
    }
    const float *p = (const float *)base + 3 * row;
    return (Vector){p[0], p[1], p[2]};
}

static ALWAYS_INLINE Vector minus(Vector a, Vector b) { return (Vector){a.x - b.x, a.y - b.y, a.z - b.z}; }
static ALWAYS_INLINE double dot(Vector a, Vector b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static ALWAYS_INLINE Vector cross(Vector a, Vector b)
{
    return (Vector){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

/* Four doubles at once. Every operation rounds as it does on one of them. */
#if defined(__GNUC__)
typedef double Four __attribute__((vector_size(32)));
static ALWAYS_INLINE Four four(double a, double b, double c, double d) { return (Four){a, b, c, d}; }
static ALWAYS_INLINE Four add(Four a, Four b) { return a + b; }
static ALWAYS_INLINE Four subtract(Four a, Four b) { return a - b; }
static ALWAYS_INLINE Four times(Four a, Four b) { return a * b; }
static ALWAYS_INLINE Four divide(Four a, Four b) { return a / b; }
static ALWAYS_INLINE Four root(Four a) { return four(sqrt(a[0]), sqrt(a[1]), sqrt(a[2]), sqrt(a[3])); }
#else
typedef struct {
    double of[4];
} Four;
#define EACH(expression)                                                                                     \
    Four result;                                                                                             \
    for (int n = 0; n < 4; n++)                                                                              \
        result.of[n] = expression;                                                                           \
    return result
static ALWAYS_INLINE Four four(double a, double b, double c, double d) { return (Four){{a, b, c, d}}; }
static ALWAYS_INLINE Four add(Four a, Four b) { EACH(a.of[n] + b.of[n]); }
static ALWAYS_INLINE Four subtract(Four a, Four b) { EACH(a.of[n] - b.of[n]); }
static ALWAYS_INLINE Four times(Four a, Four b) { EACH(a.of[n] * b.of[n]); }
static ALWAYS_INLINE Four divide(Four a, Four b) { EACH(a.of[n] / b.of[n]); }
static ALWAYS_INLINE Four root(Four a) { EACH(sqrt(a.of[n])); }
#endif
static ALWAYS_INLINE Four get(const double *from)
{
    Four values;
    memcpy(&values, from, sizeof values);
    return values;
}
static ALWAYS_INLINE void put(double *to, Four values) { memcpy(to, &values, sizeof values); }

/* ---- Equal rows (twin: weld.equal_rows) -------------------------------------------------------------- */

static inline uint64_t mixed(uint64_t state, uint64_t word)
{
    state = (state ^ word) * UINT64_C(0xBF58476D1CE4E5B9);
    return state ^ (state >> 29);
}

static inline uint64_t word_at(const void *row, char kind, Py_ssize_t column)
{
    switch (kind) {
    case 'f': {
        uint32_t word = ((const uint32_t *)row)[column];
        return word == UINT32_C(0x80000000) ? 0 : word; /* -0 is +0 */
    }
    case 'd': {
        uint64_t word = ((const uint64_t *)row)[column];
        return word == UINT64_C(0x8000000000000000) ? 0 : word;
    }
    case 'Q':
        return ((const uint64_t *)row)[column];
    default:
        return ((const uint32_t *)row)[column];
    }
}

static inline uint64_t row_hash(const char *row, char kind, Py_ssize_t columns)
{
    uint64_t state = UINT64_C(0x9E3779B97F4A7C15);
    for (Py_ssize_t column = 0; column < columns; column++)
        state = mixed(state, word_at(row, kind, column));
    return state ^ (state >> 32);
}

static inline int equal(const char *a, const char *b, char kind, Py_ssize_t columns)
{
    for (Py_ssize_t column = 0; column < columns; column++)
        if (word_at(a, kind, column) != word_at(b, kind, column))
            return 0;
    return 1;
}

typedef struct {
    uint32_t tag; /* upper half of the hash: most comparisons end here */
    int32_t label;
} Slot;

/* Rows whose hashes are known ahead of their turn, while memory fetches their slots of the table. */
enum { AHEAD = 16 };

enum { NO_MEMORY = -1, TOO_MANY_COLLISIONS = -2, PROBES_A_ROW = 64 };

/* Fill labels; return how many there are, or NO_MEMORY, or TOO_MANY_COLLISIONS: rows that somebody made to have
   like hashes would take time that grows with their square. `first` keeps a row of each label. */
static Py_ssize_t label_rows(const Array *rows, int32_t *labels)
{
    size_t size = 16;
    while (size < 2 * (size_t)rows->rows)
        size *= 2;
    size_t width = (size_t)rows->buffer.itemsize * (size_t)rows->columns;
    Slot *table = malloc(size * sizeof *table);
    int32_t *first = malloc(((size_t)rows->rows + 1) * sizeof *first);
    Py_ssize_t count = table && first ? 0 : NO_MEMORY;
    uint64_t probes_left = (uint64_t)rows->rows * PROBES_A_ROW + 1024;
    if (count == 0)
        memset(table, 0xFF, size * sizeof *table); /* label -1: empty */
    const char *data = rows->buffer.buf;
    uint64_t hashes[AHEAD] = {0};
    for (Py_ssize_t next = 0; count >= 0 && next < rows->rows + AHEAD; next++) {
        Py_ssize_t row = next - AHEAD;
        uint64_t hash = hashes[next % AHEAD];
        if (next < rows->rows) {
            hashes[next % AHEAD] = row_hash(data + (size_t)next * width, rows->kind, rows->columns);
            PREFETCH(&table[(size_t)hashes[next % AHEAD] & (size - 1)]);
        }
        if (row < 0)
            continue;
        const char *here = data + (size_t)row * width;
        uint32_t tag = (uint32_t)(hash >> 32);
        size_t at = (size_t)hash & (size - 1);
        for (;; at = (at + 1) & (size - 1)) {
            if (table[at].label < 0) {
                table[at] = (Slot){tag, (int32_t)count};
                first[count] = (int32_t)row;
                labels[row] = (int32_t)count++;
                break;
            }
            const char *there = data + (size_t)first[table[at].label] * width;
            if (table[at].tag == tag && equal(here, there, rows->kind, rows->columns)) {
                labels[row] = table[at].label;
                break;
            }
            if (probes_left-- == 0) {
                count = TOO_MANY_COLLISIONS;
                break;
            }
        }
    }
    free(table);
    free(first);
    return count;
}

static PyObject *equal_rows(PyObject *module, PyObject *args)
{
    PyObject *rows_object, *labels_object;
    Array a[2] = {{.held = 0}};
    if (!PyArg_ParseTuple(args, "OO", &rows_object, &labels_object))
        return NULL;
    PyObject *result = NULL;
    if (take(rows_object, &a[0], "rows", "fdiIQ", 0, 0) < 0 ||
        take(labels_object, &a[1], "labels", "i", 1, 1) < 0 || same_rows(&a[1], "labels", a[0].rows) < 0)
        goto done;
    if (a[0].rows >= INT32_MAX) {
        PyErr_SetString(PyExc_ValueError, "too many rows");
        goto done;
    }
    Py_ssize_t count;
    Py_BEGIN_ALLOW_THREADS
    count = label_rows(&a[0], a[1].buffer.buf);
    Py_END_ALLOW_THREADS
    if (count == NO_MEMORY)
        PyErr_NoMemory();
    else
        result = count < 0 ? Py_NewRef(Py_None) : PyLong_FromSsize_t(count);
done:
    release(a, 2);
    return result;
}

/* ---- Weight field (twin: influences.weight_field) ---------------------------------------------------- */

typedef struct {
    Py_ssize_t negative, all_zero, not_normalised, repeated;
} Defects;

static void normalise_vertex(int32_t *joints, double *weights, uint8_t *unused, Py_ssize_t slots,
                             double adopting_sum, double tolerance, Defects *defects)
{
    int negative = 0, merged = 0;
    double total = 0.0;
    for (Py_ssize_t k = 0; k < slots; k++) {
        unused[k] = weights[k] == 0.0;
        if (weights[k] < 0.0) {
            negative = 1;
            weights[k] = 0.0;
        }
        total += weights[k];
    }
    if (!(total > adopting_sum))
        memset(unused, 0, (size_t)slots);
    if (total == 0.0) {
        defects->all_zero++;
        weights[0] = total = 1.0;
    }
    for (Py_ssize_t later = 1; later < slots; later++)
        for (Py_ssize_t earlier = 0; earlier < later; earlier++) {
            if (joints[later] != joints[earlier] || joints[later] == NO_JOINT)
                continue;
            merged |= weights[later] > 0.0 && weights[earlier] > 0.0;
            if (weights[earlier] == 0.0 && weights[later] > 0.0) {
                joints[earlier] = NO_JOINT;
            } else {
                weights[earlier] += weights[later];
                weights[later] = 0.0;
                joints[later] = NO_JOINT;
            }
        }
    defects->negative += negative;
    defects->repeated += merged;
    defects->not_normalised += fabs(total - 1.0) > tolerance;
    for (Py_ssize_t k = 0; k < slots; k++)
        weights[k] /= total;
}

static PyObject *normalise(PyObject *module, PyObject *args)
{
    PyObject *objects[3];
    double adopting_sum, tolerance;
    Array a[3] = {{.held = 0}};
    if (!PyArg_ParseTuple(args, "OOOdd", &objects[0], &objects[1], &objects[2], &adopting_sum, &tolerance))
        return NULL;
    PyObject *result = NULL;
    if (take(objects[0], &a[0], "joints", "i", 0, 1) < 0 || least_slots(&a[0], 1) < 0 ||
        take(objects[1], &a[1], "weights", "d", a[0].columns, 1) < 0 ||
        take(objects[2], &a[2], "free", "?", a[0].columns, 1) < 0 ||
        same_rows(&a[1], "weights", a[0].rows) < 0 || same_rows(&a[2], "free", a[0].rows) < 0)
        goto done;
    Defects defects = {0, 0, 0, 0};
    Py_BEGIN_ALLOW_THREADS
    for (Py_ssize_t row = 0, at = 0; row < a[0].rows; row++, at += a[0].columns)
        normalise_vertex((int32_t *)a[0].buffer.buf + at, (double *)a[1].buffer.buf + at,
                         (uint8_t *)a[2].buffer.buf + at, a[0].columns, adopting_sum, tolerance, &defects);
    Py_END_ALLOW_THREADS
    result = Py_BuildValue("nnnn", defects.negative, defects.all_zero, defects.not_normalised,
                           defects.repeated);
done:
    release(a, 3);
    return result;
}

/* ---- Triangles with an area (twin: triangles.proper) ------------------------------------------------- */

static inline int has_area(Vector p, Vector q, Vector r, double least)
{
    Vector a = minus(q, p), b = minus(r, p), n = cross(a, b);
    double first = dot(a, a), second = dot(b, b), third = first + second - 2.0 * dot(a, b);
    double longest = first > second ? first : second;
    longest = third > longest ? third : longest;
    return sqrt(dot(n, n)) > least * longest;
}

/* Return how many triangles have no area, -1 where one names a vertex that is not there. */
static Py_ssize_t mark_proper(const Array *positions, const Array *triangles, uint8_t *mask, double least)
{
    const void *points = positions->buffer.buf;
    int wide = positions->kind == 'd';
    const uint32_t *index = triangles->buffer.buf;
    size_t vertices = (size_t)positions->rows;
    Py_ssize_t degenerate = 0;
    for (Py_ssize_t t = 0; t < triangles->rows; t++, index += 3) {
        const uint32_t p = index[0], q = index[1], r = index[2];
        if (p >= vertices || q >= vertices || r >= vertices)
            return -1;
        mask[t] = (uint8_t)has_area(row3(points, wide, p), row3(points, wide, q), row3(points, wide, r), least);
        degenerate += !mask[t];
    }
    return degenerate;
}

static PyObject *proper(PyObject *module, PyObject *args)
{
    PyObject *objects[3];
    double least;
    Array a[3] = {{.held = 0}};
    if (!PyArg_ParseTuple(args, "OOOd", &objects[0], &objects[1], &objects[2], &least))
        return NULL;
    PyObject *result = NULL;
    if (take(objects[0], &a[0], "positions", "fd", 3, 0) < 0 ||
        take(objects[1], &a[1], "triangles", "iI", 3, 0) < 0 || take(objects[2], &a[2], "mask", "?", 1, 1) < 0 ||
        same_rows(&a[2], "mask", a[1].rows) < 0)
        goto done;
    Py_ssize_t degenerate;
    Py_BEGIN_ALLOW_THREADS
    degenerate = mark_proper(&a[0], &a[1], a[2].buffer.buf, least);
    Py_END_ALLOW_THREADS
    if (degenerate < 0)
        PyErr_SetString(PyExc_IndexError, "a triangle names a vertex that is not there");
    else
        result = PyLong_FromSsize_t(degenerate);
done:
    release(a, 3);
    return result;
}

/* ---- Gradients and slots (twins: gradients.weight_gradients, slots.assign) --------------------------- */

/* What is baked: V vertices with K slots each, T triangles, C weld classes. Rows as in the twins. */
typedef struct {
    const void *positions, *normals, *tangents, *bitangents; /* (V, 3) of floats or doubles */
    int wide_positions, wide_normals, wide_frame;            /* tangents NULL: the frame comes from normals */
    const uint32_t *triangles; /* (T, 3) */
    const int32_t *joints;     /* (V, K), NO_JOINT where a slot has none */
    const double *weights;     /* (V, K) */
    const uint8_t *unused;     /* (V, K): may adopt */
    const int32_t *classes;    /* (V,) */
    Py_ssize_t vertices, slots, triangle_count, class_count, joint_count;
    int weighting, adopts;
    double negligible;
} Surface;

typedef struct {
    float *alpha, *beta; /* (V, K - 1) */
    int32_t *adopted;    /* (V, K) of zeros; 1 + joint is written where a slot adopts one */
    const uint64_t *ends; /* (P,): where the rows of each primitive end */
    size_t primitives;
    double *sums; /* (P, 4): adopting and overflowing vertices, gradient magnitude, its unheld part */
} Baked;

/* Members of every group, in ascending order: those of group g stand at start[g] ... start[g + 1]. */
typedef struct {
    uint32_t *start, *members;
} Groups;

/* While the GIL is released another thread may write to the arrays. So every index is held against what it counts
   in where it is used, on the value that is used, whatever an earlier loop saw; STRAY tells of one. */
enum { STRAY = -2 };

/* The class of a vertex; class_count where the vertex or its class is not there. */
static ALWAYS_INLINE size_t class_of(const Surface *s, size_t vertex)
{
    size_t found = vertex < (size_t)s->vertices ? (size_t)(uint32_t)s->classes[vertex] : (size_t)s->class_count;
    return found < (size_t)s->class_count ? found : (size_t)s->class_count;
}

/* Group the corners 4 t + i by weld class (by counting); -1: no memory, STRAY: an index is out of range. */
static int corners_of_classes(const Surface *s, Groups *groups)
{
    size_t corners = 3 * (size_t)s->triangle_count, classes = (size_t)s->class_count;
    groups->start = calloc(classes + 2, sizeof *groups->start);
    groups->members = malloc((corners + 1) * sizeof *groups->members);
    if (!groups->start || !groups->members)
        return -1;
    uint32_t *next = groups->start + 1; /* one ahead: filling moves every start to its place */
    for (size_t corner = 0; corner < corners; corner++) {
        size_t c = class_of(s, s->triangles[corner]);
        if (c == classes)
            return STRAY;
        next[c + 1]++;
    }
    for (size_t c = 0; c < classes; c++)
        next[c + 1] += next[c];
    for (size_t t = 0; t < (size_t)s->triangle_count; t++)
        for (size_t i = 0; i < 3; i++) {
            size_t c = class_of(s, s->triangles[3 * t + i]);
            if (c == classes || next[c] >= corners)
                return STRAY;
            groups->members[next[c]++] = (uint32_t)(4 * t + i);
        }
    return 0;
}

/* Group the vertices by weld class; members stay NULL where every class has one vertex, its own number. */
static int vertices_of_classes(const Surface *s, Groups *groups)
{
    size_t vertices = (size_t)s->vertices, classes = (size_t)s->class_count;
    size_t v = 0;
    while (v < vertices && s->classes[v] == (int32_t)v)
        v++;
    if (v == vertices && classes == vertices)
        return 0;
    groups->start = calloc(classes + 2, sizeof *groups->start);
    groups->members = malloc((vertices + 1) * sizeof *groups->members);
    if (!groups->start || !groups->members)
        return -1;
    uint32_t *next = groups->start + 1;
    for (v = 0; v < vertices; v++) {
        size_t c = class_of(s, v);
        if (c == classes)
            return STRAY;
        next[c + 1]++;
    }
    for (size_t c = 0; c < classes; c++)
        next[c + 1] += next[c];
    for (v = 0; v < vertices; v++) {
        size_t c = class_of(s, v);
        if (c == classes || next[c] >= vertices)
            return STRAY;
        groups->members[next[c]++] = (uint32_t)v;
    }
    return 0;
}

/* Some corners of a class at once, component by component. Edges lead to the two other corners of the triangle,
   the vertices `ends`; coefficients are what the differences of weights along the edges count for in the sum,
   and share is the corner's weight in the mean (see corner.py). */
enum { AT_ONCE = 4, X1 = 0, Y1, Z1, X2, Y2, Z2, COMPONENTS };

typedef struct {
    uint32_t ends[AT_ONCE][2];
    Four edges[COMPONENTS];
    double coefficients[COMPONENTS][AT_ONCE], share[AT_ONCE];
} Corners;

/* A joint whose weight varies around the class, and its local number. */
typedef struct {
    int32_t joint, local;
    int held;
    Vector gradient;
    double magnitude;
} Entry;

/* Room to work in, enough for any class. Local numbers: slot k of the class has k, further joints follow. */
typedef struct {
    int32_t *local; /* by joint: its local number, -1 elsewhere */
    int32_t *met;   /* by local number: the joint */
    uint64_t *seen; /* by local number: the last neighbour that has the joint */
    uint64_t visit;
    double *own;        /* by slot: the class's weight */
    double *x, *y, *z;  /* by local number: the components of the sum */
    Entry *entries;
    Entry **foreign;
    int32_t *named; /* by slot: the joint whose gradient it carries */
    int stray;      /* an index was out of range where it was to be used */
} Scratch;

static void scratch_free(Scratch *w)
{
    free(w->local), free(w->met), free(w->seen), free(w->own), free(w->x), free(w->y), free(w->z);
    free(w->entries), free(w->foreign), free(w->named);
}

static int scratch_alloc(Scratch *w, const Surface *s)
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
        return -1;
    memset(w->local, 0xFF, (joints + 1) * sizeof *w->local);
    return 0;
}

/* Write ends and edges of some corners, whose class is at `origin`; the first one stands for what is left over. */
static ALWAYS_INLINE void find_edges(const Surface *s, int wide, Vector origin, const uint32_t *corners,
                                     size_t count, Corners *c, Scratch *w)
{
    const size_t vertices = (size_t)s->vertices;
    Vector e1[AT_ONCE], e2[AT_ONCE];
    for (size_t n = 0; n < count; n++) {
        static const uint8_t following[] = {1, 2, 0}, last[] = {2, 0, 1};
        const uint32_t *triangle = s->triangles + 3 * (size_t)(corners[n] >> 2);
        uint32_t one = triangle[following[corners[n] & 3]], other = triangle[last[corners[n] & 3]];
        if (one >= vertices || other >= vertices)
            one = other = 0, w->stray = 1;
        c->ends[n][0] = one, c->ends[n][1] = other;
        e1[n] = minus(row3(s->positions, wide, one), origin);
        e2[n] = minus(row3(s->positions, wide, other), origin);
    }
    for (size_t n = count; n < AT_ONCE; n++)
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
    return add(add(times(a[0], b[0]), times(a[1], b[1])), times(a[2], b[2]));
}

/* Work out share and coefficients from the edges. With n = e1 x e2, corner.py's e2 x n is
   e1 |e2|^2 - e2 (e1 . e2), and n x e1 likewise. */
static ALWAYS_INLINE void weigh_corners(Corners *c, int weighting)
{
    const Four *e1 = c->edges + X1, *e2 = c->edges + X2;
    Four normal[3] = {
        subtract(times(e1[1], e2[2]), times(e1[2], e2[1])),
        subtract(times(e1[2], e2[0]), times(e1[0], e2[2])),
        subtract(times(e1[0], e2[1]), times(e1[1], e2[0])),
    };
    Four squared_area2 = four_dot(normal, normal), dots = four_dot(e1, e2);
    Four squared1 = four_dot(e1, e1), squared2 = four_dot(e2, e2), area2 = root(squared_area2), scale;
    if (weighting == MAX_WEIGHTING) { /* 1 / (|e1|^2 |e2|^2) times |e1 x e2| */
        scale = divide(four(1.0, 1.0, 1.0, 1.0), times(times(area2, squared1), squared2));
        put(c->share, times(squared_area2, scale));
    } else {
        double areas[AT_ONCE], cosines[AT_ONCE];
        put(areas, area2);
        put(cosines, dots);
        for (int n = 0; n < AT_ONCE; n++) {
            c->share[n] = weighting == AREA ? areas[n] : atan2(areas[n], cosines[n]);
            c->share[n] *= weighting == ANGLE_AREA ? areas[n] : 1.0;
        }
        scale = divide(get(c->share), squared_area2);
    }
    Four mixed = times(dots, scale), own1 = times(squared2, scale), own2 = times(squared1, scale);
    for (int axis = 0; axis < 3; axis++) {
        put(c->coefficients[X1 + axis], subtract(times(e1[axis], own1), times(e2[axis], mixed)));
        put(c->coefficients[X2 + axis], subtract(times(e2[axis], own2), times(e1[axis], mixed)));
    }
}

static inline void add_scaled(Scratch *w, int32_t number, Vector v, double by)
{
    w->x[number] += v.x * by;
    w->y[number] += v.y * by;
    w->z[number] += v.z * by;
}

/* Add coefficient x (weight there - weight here) for every joint that either vertex has; return how many local
   numbers are used. All sums run over differences of weights: where a weight is constant, its is 0 exactly. */
static int32_t add_differences(const Surface *s, size_t neighbour, Vector c, int32_t used, Scratch *w)
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
        int32_t number = w->local[joint];
        if (number < 0) {
            number = w->local[joint] = used++;
            w->met[number] = joint;
            w->x[number] = w->y[number] = w->z[number] = 0.0;
        }
        w->seen[number] = w->visit;
        add_scaled(w, number, c, number < slots ? weight[k] - w->own[number] : weight[k]);
    }
    for (int32_t k = 0; k < slots; k++)
        if (w->seen[k] != w->visit && w->own[k] != 0.0)
            add_scaled(w, k, c, -w->own[k]);
    return used;
}

/* Whether a vertex has the same joints as another, slot by slot: then its differences need no look-up. */
static ALWAYS_INLINE int same_joints(const Surface *s, size_t slots, size_t here, size_t there)
{
    return memcmp(s->joints + here * slots, s->joints + there * slots, slots * sizeof *s->joints) == 0;
}

/* Sum over all corners, for every joint met; return how many local numbers are used, and the weight of all
   corners as `total`. */
static ALWAYS_INLINE int32_t sum_corners(const Surface *s, int wide, size_t slots, size_t vertex,
                                         const uint32_t *corners, size_t count, Scratch *w, double *total)
{
    const int32_t *joints = s->joints + vertex * slots;
    int32_t used = (int32_t)slots;
    for (size_t k = 0; k < slots; k++) {
        const int32_t joint = joints[k];
        w->met[k] = (size_t)(uint32_t)joint < (size_t)s->joint_count ? joint : NO_JOINT;
        w->own[k] = s->weights[vertex * slots + k];
        w->x[k] = w->y[k] = w->z[k] = 0.0;
        if (w->met[k] >= 0)
            w->local[w->met[k]] = (int32_t)k;
    }
    Vector origin = row3(s->positions, wide, vertex);
    const double *here = s->weights + vertex * slots;
    Four none = four(0.0, 0.0, 0.0, 0.0), x = none, y = none, z = none; /* sums of the usual four slots */
    Four own = slots == 4 ? get(here) : none;
    *total = 0.0;
    for (size_t from = 0; from < count; from += AT_ONCE) {
        size_t some = count - from < AT_ONCE ? count - from : AT_ONCE;
        Corners c;
        find_edges(s, wide, origin, corners + from, some, &c, w);
        weigh_corners(&c, s->weighting);
        for (size_t n = 0; n < some; n++)
            for (int end = 0; end < 2; end++) {
                size_t there = c.ends[n][end];
                const double(*component)[AT_ONCE] = c.coefficients + 3 * end;
                Vector by = {component[X1][n], component[Y1][n], component[Z1][n]};
                if (slots == 4 && same_joints(s, slots, vertex, there)) {
                    Four difference = subtract(get(s->weights + there * slots), own);
                    x = add(x, times(four(by.x, by.x, by.x, by.x), difference));
                    y = add(y, times(four(by.y, by.y, by.y, by.y), difference));
                    z = add(z, times(four(by.z, by.z, by.z, by.z), difference));
                } else
                    used = add_differences(s, there, by, used, w);
            }
        for (size_t n = 0; n < some; n++)
            *total += c.share[n];
    }
    if (slots == 4) {
        put(w->x, add(get(w->x), x));
        put(w->y, add(get(w->y), y));
        put(w->z, add(get(w->z), z));
    }
    for (int32_t n = 0; n < used; n++)
        if (w->met[n] >= 0)
            w->local[w->met[n]] = -1;
    return used;
}

static int by_joint(const void *a, const void *b)
{
    const Entry *first = a, *second = b;
    return (first->joint > second->joint) - (first->joint < second->joint);
}

/* Entries up to which moving them into place one by one is the fastest way to sort. */
enum { FEW = 32 };

/* Turn sums into entries, joints ascending; return how many, and the sum of their magnitudes. */
static ALWAYS_INLINE size_t make_entries(Scratch *w, int32_t used, double total, double *magnitudes)
{
    size_t count = 0;
    double mean = 1.0 / total;
    for (int32_t n = 0; n < used; n++) {
        Vector g = {w->x[n] * mean, w->y[n] * mean, w->z[n] * mean};
        if (w->met[n] < 0 || (w->x[n] == 0.0 && w->y[n] == 0.0 && w->z[n] == 0.0))
            continue;
        size_t at = count++;
        for (; used <= FEW && at > 0 && w->entries[at - 1].joint > w->met[n]; at--)
            w->entries[at] = w->entries[at - 1];
        w->entries[at] = (Entry){w->met[n], n, 0, g, sqrt(dot(g, g))};
    }
    if (used > FEW)
        qsort(w->entries, count, sizeof *w->entries, by_joint);
    *magnitudes = 0.0;
    for (size_t n = 0; n < count; n++)
        *magnitudes += w->entries[n].magnitude;
    return count;
}

static int by_magnitude(const void *a, const void *b)
{
    const Entry *first = *(Entry *const *)a, *second = *(Entry *const *)b;
    if (first->magnitude != second->magnitude)
        return first->magnitude > second->magnitude ? -1 : 1;
    return (first->joint > second->joint) - (first->joint < second->joint);
}

/* Collect the entries worth a slot whose joints the class does not have; the largest stand first. */
static ALWAYS_INLINE size_t find_foreign(const Surface *s, size_t entries, double magnitudes, Scratch *w)
{
    size_t count = 0;
    for (size_t n = 0; n < entries; n++) {
        Entry *entry = &w->entries[n];
        int own = entry->local < (int32_t)s->slots && w->own[entry->local] > 0.0;
        if (!own && entry->magnitude > s->negligible * magnitudes)
            w->foreign[count++] = entry;
    }
    if (count > 1)
        qsort(w->foreign, count, sizeof *w->foreign, by_magnitude);
    return count;
}

/* Fill `named`, and the adopted joints of one vertex where it adopts any; return whether it does. */
static inline int name_slots(const Surface *s, size_t vertex, size_t foreign, size_t capacity, Scratch *w,
                             int32_t *adopted)
{
    const size_t slots = (size_t)s->slots;
    const int32_t *joints = s->joints + vertex * slots;
    const uint8_t *unused = s->unused + vertex * slots;
    size_t moved = 0, wanted = foreign < capacity ? foreign : capacity;
    memcpy(w->named, joints, slots * sizeof *joints);
    for (size_t k = 0; k < slots && moved < wanted; k++)
        if (unused[k]) {
            w->named[k] = w->foreign[moved++]->joint;
            adopted[k] = w->named[k] + 1;
        }
    for (size_t k = 0; moved && k < slots; k++)
        for (size_t n = 0; adopted[k] == 0 && n < moved; n++)
            if (joints[k] == w->foreign[n]->joint)
                w->named[k] = NO_JOINT; /* its joint has moved into another slot */
    return moved > 0;
}

/* The frame of Duff et al. 2017 around a normal of any length, in float32 and in this order of operations:
   shaders get the same bits (twins: frames.unit_normals, frames.frame_from_normal). */
static ALWAYS_INLINE void frame_from_normal(Vector normal, Vector *tangent, Vector *bitangent)
{
    double length = sqrt(dot(normal, normal));
    int sound = isfinite(normal.x) && isfinite(normal.y) && isfinite(normal.z) &&
                (normal.x != 0.0 || normal.y != 0.0 || normal.z != 0.0);
    float x = sound ? (float)(normal.x / length) : 0.0f;
    float y = sound ? (float)(normal.y / length) : 0.0f;
    float z = sound ? (float)(normal.z / length) : 1.0f;
    float sign = z >= 0.0f ? 1.0f : -1.0f;
    float a = -1.0f / (sign + z);
    float b = (x * y) * a;
    float along = 1.0f + sign * ((x * x) * a), across = sign + (y * y) * a;
    *tangent = (Vector){along, sign * b, -sign * x};
    *bitangent = (Vector){b, across, -y};
}

/* Write alpha and beta of one vertex; return the magnitude that its slots do not hold. `as_numbered` says that
   its slots are the local numbers: it is the class's first vertex, and adopts nothing. */
static ALWAYS_INLINE double project(const Surface *s, size_t slots, size_t vertex, size_t entries,
                                    int as_numbered, Scratch *w, const Baked *out)
{
    Vector t, b;
    if (s->tangents) {
        t = row3(s->tangents, s->wide_frame, vertex);
        b = row3(s->bitangents, s->wide_frame, vertex);
    } else {
        frame_from_normal(row3(s->normals, s->wide_normals, vertex), &t, &b);
    }
    float *alpha = out->alpha + vertex * (slots - 1), *beta = out->beta + vertex * (slots - 1);
    double unheld = 0.0;
    memset(alpha, 0, (slots - 1) * sizeof *alpha);
    memset(beta, 0, (slots - 1) * sizeof *beta);
    for (size_t n = 0; n < entries; n++) {
        Entry *entry = &w->entries[n];
        size_t slot = (size_t)entry->local;
        if (!as_numbered)
            for (slot = 0; slot < slots && w->named[slot] != entry->joint;)
                slot++;
        entry->held = slot < slots;
        if (!entry->held) {
            unheld += entry->magnitude;
        } else if (slot > 0) {
            alpha[slot - 1] = (float)dot(entry->gradient, t);
            beta[slot - 1] = (float)dot(entry->gradient, b);
        }
    }
    return unheld;
}

static size_t shared_capacity(const Surface *s, const uint32_t *members, size_t count)
{
    size_t least = (size_t)s->slots;
    for (size_t n = 0; n < count; n++) {
        size_t unused = 0;
        for (Py_ssize_t k = 0; k < s->slots; k++)
            unused += s->unused[members[n] * (size_t)s->slots + (size_t)k] != 0;
        least = unused < least ? unused : least;
    }
    return least;
}

static ALWAYS_INLINE int bake_classes(const Surface *s, int wide, size_t slots, const Groups *corners,
                                      const Groups *members, Scratch *w, const Baked *out)
{
    for (size_t c = 0; c < (size_t)s->class_count; c++) {
        uint32_t itself = (uint32_t)c;
        if (corners->start[c + 1] < corners->start[c] ||
            (members->start && members->start[c + 1] < members->start[c]))
            return STRAY; /* the classes have changed while they were counted */
        const uint32_t *vertices = members->start ? members->members + members->start[c] : &itself;
        size_t count = members->start ? members->start[c + 1] - members->start[c] : 1;
        size_t corner_count = corners->start[c + 1] - corners->start[c];
        if (count == 0)
            continue;
        size_t entries = 0, foreign = 0, capacity = 0;
        double magnitudes = 0.0;
        if (corner_count) {
            const uint32_t *first = corners->members + corners->start[c];
            double total;
            int32_t used = sum_corners(s, wide, slots, vertices[0], first, corner_count, w, &total);
            entries = make_entries(w, used, total, &magnitudes);
            foreign = find_foreign(s, entries, magnitudes, w);
            capacity = foreign && s->adopts ? shared_capacity(s, vertices, count) : 0;
        }
        for (size_t n = 0; n < count; n++) {
            size_t vertex = vertices[n], primitive = 0;
            while (primitive + 1 < out->primitives && vertex >= out->ends[primitive])
                primitive++;
            double *sums = out->sums + 4 * primitive;
            int as_numbered = n == 0 && (foreign == 0 || capacity == 0);
            if (!as_numbered)
                sums[0] += name_slots(s, vertex, foreign, capacity, w, out->adopted + vertex * slots);
            sums[2] += magnitudes;
            sums[3] += project(s, slots, vertex, entries, as_numbered, w, out);
            int overflows = 0;
            for (size_t f = 0; f < foreign; f++)
                overflows |= !w->foreign[f]->held;
            sums[1] += overflows;
        }
    }
    return w->stray ? STRAY : 0;
}

/* Copies of the loop for the usual cases, so that it need not ask for types and counts again and again. */
FOR_PROCESSORS
static int bake_in_classes(const Surface *s, const Groups *corners, const Groups *members, Scratch *w,
                           const Baked *out)
{
    if (s->wide_positions)
        return bake_classes(s, 1, (size_t)s->slots, corners, members, w, out);
    if (s->slots == 4)
        return bake_classes(s, 0, 4, corners, members, w, out);
    return bake_classes(s, 0, (size_t)s->slots, corners, members, w, out);
}

static int bake_surface(const Surface *s, const Baked *out)
{
    Groups corners = {NULL, NULL}, members = {NULL, NULL};
    Scratch scratch;
    memset(&scratch, 0, sizeof scratch);
    int status = corners_of_classes(s, &corners);
    if (status == 0)
        status = vertices_of_classes(s, &members);
    if (status == 0)
        status = scratch_alloc(&scratch, s);
    if (status == 0)
        status = bake_in_classes(s, &corners, &members, &scratch, out);
    scratch_free(&scratch);
    free(corners.start), free(corners.members), free(members.start), free(members.members);
    return status;
}

/* Check what indices refer to, and find the number of joints; -1 with an exception where it is wrong. */
static int check_surface(Surface *s)
{
    if (s->class_count < 0 || s->class_count > s->vertices) {
        PyErr_SetString(PyExc_ValueError, "there are more weld classes than vertices, or less than none");
        return -1;
    }
    int32_t largest = 0;
    for (Py_ssize_t n = 0; n < s->vertices * s->slots; n++) {
        largest = s->joints[n] > largest ? s->joints[n] : largest;
        if (s->joints[n] < 0 && s->weights[n] != 0.0) {
            PyErr_SetString(PyExc_ValueError, "a slot without a joint has a weight");
            return -1;
        }
    }
    s->joint_count = (Py_ssize_t)largest + 1;
    if (s->joint_count > INT32_MAX - s->slots) { /* local numbers count both */
        PyErr_SetString(PyExc_ValueError, "too many joints for one surface");
        return -1;
    }
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

enum { POSITIONS, TRIANGLES, JOINTS, WEIGHTS, UNUSED, CLASSES, NORMALS, TANGENTS, BITANGENTS, ALPHA, BETA, ADOPTED,
       ENDS, SUMS, ARRAYS };

static int take_surface(PyObject **o, Array *a)
{
    if (take(o[POSITIONS], &a[POSITIONS], "positions", "fd", 3, 0) < 0 ||
        take(o[TRIANGLES], &a[TRIANGLES], "triangles", "iI", 3, 0) < 0 ||
        take(o[JOINTS], &a[JOINTS], "joints", "i", 0, 0) < 0 || least_slots(&a[JOINTS], 2) < 0 ||
        take(o[WEIGHTS], &a[WEIGHTS], "weights", "d", a[JOINTS].columns, 0) < 0 ||
        take(o[UNUSED], &a[UNUSED], "free", "?", a[JOINTS].columns, 0) < 0 ||
        take(o[CLASSES], &a[CLASSES], "classes", "i", 1, 0) < 0 ||
        take(o[NORMALS], &a[NORMALS], "normals", "fd", 3, 0) < 0 ||
        take(o[TANGENTS], &a[TANGENTS], "tangents", "fd", 3, 0) < 0 ||
        take(o[BITANGENTS], &a[BITANGENTS], "bitangents", "fd", 3, 0) < 0 ||
        take(o[ALPHA], &a[ALPHA], "alpha", "f", a[JOINTS].columns - 1, 1) < 0 ||
        take(o[BETA], &a[BETA], "beta", "f", a[JOINTS].columns - 1, 1) < 0 ||
        take(o[ADOPTED], &a[ADOPTED], "adopted", "i", a[JOINTS].columns, 1) < 0 ||
        take(o[ENDS], &a[ENDS], "ends", "Q", 1, 0) < 0 || take(o[SUMS], &a[SUMS], "sums", "d", 4, 1) < 0)
        return -1;
    for (int n = JOINTS; n <= ADOPTED; n++)
        if (!(n == TANGENTS || n == BITANGENTS) && same_rows(&a[n], "an array of the surface", a[POSITIONS].rows) < 0)
            return -1;
    Py_ssize_t frames = a[TANGENTS].rows ? a[POSITIONS].rows : 0;
    if (same_rows(&a[TANGENTS], "tangents", frames) < 0 || same_rows(&a[BITANGENTS], "bitangents", frames) < 0 ||
        same_rows(&a[SUMS], "sums", a[ENDS].rows) < 0)
        return -1;
    const uint64_t *ends = a[ENDS].buffer.buf;
    if (a[ENDS].rows < 1 || ends[a[ENDS].rows - 1] != (uint64_t)a[POSITIONS].rows ||
        a[TANGENTS].kind != a[BITANGENTS].kind) {
        PyErr_SetString(PyExc_ValueError, "the arrays of the surface do not belong together");
        return -1;
    }
    return 0;
}

static PyObject *bake(PyObject *module, PyObject *args)
{
    PyObject *o[ARRAYS];
    Array a[ARRAYS];
    memset(a, 0, sizeof a);
    Py_ssize_t class_count;
    int weighting, adopts;
    double negligible;
    if (!PyArg_ParseTuple(args, "OOOOOOOOOOOOOOnipd", &o[POSITIONS], &o[TRIANGLES], &o[JOINTS], &o[WEIGHTS],
                          &o[UNUSED], &o[CLASSES], &o[NORMALS], &o[TANGENTS], &o[BITANGENTS], &o[ALPHA],
                          &o[BETA], &o[ADOPTED], &o[ENDS], &o[SUMS], &class_count, &weighting, &adopts,
                          &negligible))
        return NULL;
    PyObject *result = NULL;
    if (take_surface(o, a) < 0)
        goto done;
    Surface surface = {
        .positions = a[POSITIONS].buffer.buf, .normals = a[NORMALS].buffer.buf,
        .tangents = a[TANGENTS].rows ? a[TANGENTS].buffer.buf : NULL,
        .bitangents = a[BITANGENTS].buffer.buf, .wide_normals = a[NORMALS].kind == 'd', .wide_positions = a[POSITIONS].kind == 'd',
        .wide_frame = a[TANGENTS].kind == 'd', .triangles = a[TRIANGLES].buffer.buf,
        .joints = a[JOINTS].buffer.buf, .weights = a[WEIGHTS].buffer.buf, .unused = a[UNUSED].buffer.buf,
        .classes = a[CLASSES].buffer.buf, .vertices = a[POSITIONS].rows, .slots = a[JOINTS].columns,
        .triangle_count = a[TRIANGLES].rows, .class_count = class_count, .weighting = weighting,
        .adopts = adopts, .negligible = negligible,
    };
    Baked out = {
        .alpha = a[ALPHA].buffer.buf, .beta = a[BETA].buffer.buf, .adopted = a[ADOPTED].buffer.buf,
        .ends = a[ENDS].buffer.buf, .primitives = (size_t)a[ENDS].rows, .sums = a[SUMS].buffer.buf,
    };
    if (check_surface(&surface) < 0)
        goto done;
    int status;
    Py_BEGIN_ALLOW_THREADS
    status = bake_surface(&surface, &out);
    Py_END_ALLOW_THREADS
    if (status == -1)
        PyErr_NoMemory();
    else if (status == STRAY)
        PyErr_SetString(PyExc_IndexError, "a triangle or a slot names what is not there");
    else
        result = Py_NewRef(Py_None);
done:
    release(a, ARRAYS);
    return result;
}

/* ---- The module -------------------------------------------------------------------------------------- */

static PyMethodDef functions[] = {
    {"equal_rows", equal_rows, METH_VARARGS, "equal_rows(rows, labels): fill labels, return their number."},
    {"normalise", normalise, METH_VARARGS,
     "normalise(joints, weights, free, adopting_sum, tolerance): in place; return the defects."},
    {"proper", proper, METH_VARARGS,
     "proper(positions, triangles, mask, least): fill mask, return how many have no area."},
    {"bake", bake, METH_VARARGS,
     "bake(positions, triangles, joints, weights, free, classes, normals, tangents, bitangents, alpha, beta, adopted, "
     "ends, sums, class_count, weighting, adopts, negligible): fill alpha, beta, adopted and sums."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "_kernel", "Compiled loops; see _kernel.pyi.", -1, functions,
    NULL, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__kernel(void) { return PyModule_Create(&definition); }
