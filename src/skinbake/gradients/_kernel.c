/* The loops of `skinbake bake` that visit every vertex, triangle or corner, on the memory of numpy's arrays.

   Each function has a twin in numpy (named beside it), which is the definition, the test's oracle, and the
   code that runs if this module could not be compiled. Here the same mathematics makes one pass over memory. When
   a vertex is done, its corners and gradients are forgotten.

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

/* Compiled twice, for processors with 256-bit vectors and for the others. The results are the same bits. */
#if defined(__x86_64__) && defined(__GLIBC__) && defined(__has_attribute)
#if __has_attribute(target_clones)
#define FOR_PROCESSORS __attribute__((target_clones("avx2", "default")))
#endif
#endif
#ifndef FOR_PROCESSORS
#define FOR_PROCESSORS
#endif

#define NO_JOINT (-1)

/* The weights of corners in the mean (see corner.py). The module has constants of these names. */
typedef enum { BY_MAX, BY_ANGLE, BY_AREA, BY_ANGLE_AREA, WEIGHTINGS } Weighting;

/* ---- Status -------------------------------------------------------------------------------------------- */

/* How a loop ended. Loops run without the GIL and cannot raise. raise_status raises after they have ended. */
typedef enum { DONE, NO_MEMORY, STRAY_INDEX, TOO_MANY_COLLISIONS } Status;

static PyObject *collision_error; /* _kernel.CollisionError */

static void raise_status(Status status)
{
    switch (status) {
    case DONE:
        return;
    case NO_MEMORY:
        PyErr_NoMemory();
        return;
    case STRAY_INDEX:
        PyErr_SetString(PyExc_IndexError, "a triangle, a slot or a weld class names what is not there");
        return;
    case TOO_MANY_COLLISIONS:
        PyErr_SetString(collision_error, "the hashes of the rows collide beyond all chance");
        return;
    }
}

/* ---- Arrays -------------------------------------------------------------------------------------------- */

/* The axes of arrays by their letters: V vertices, T triangles, P primitives, K slots. Arrays of one call that
   share an axis have one size there. LATER_K is K without the first slot; FRAMES is V, or 0 for none. */
typedef enum {
    AXIS_ANY,
    AXIS_1,
    AXIS_3,
    AXIS_4,
    AXIS_V,
    AXIS_T,
    AXIS_P,
    AXIS_K,
    AXIS_LATER_K,
    AXIS_FRAMES,
    AXES
} Axis;

typedef enum { READ, WRITTEN } Access;

/* The requirements of an argument. */
typedef struct {
    const char *name, *kinds; /* kinds: the types it may have, see Array */
    Axis rows, columns;       /* an array of one axis has one column */
    Access access;
} Requirement;

typedef struct {
    Py_buffer buffer;
    int held;
    Py_ssize_t rows, columns;
    char kind; /* f d: floats, i: int32, I: uint32, Q: uint64, ?: bytes */
} Array;

static void release_arrays(Array *arrays, int count)
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

/* Compare the size of an axis with the size known so far. The first array that has the axis sets it. */
static int check_size(const char *name, const char *along, Py_ssize_t found, Axis axis, Py_ssize_t *sizes)
{
    if (axis == AXIS_ANY)
        return 0;
    if (sizes[axis] < 0) {
        sizes[axis] = found;
        if (axis == AXIS_K)
            sizes[AXIS_LATER_K] = found - 1;
    }
    if (sizes[axis] == found)
        return 0;
    PyErr_Format(PyExc_ValueError, "%s has %zd %s, not %zd", name, found, along, sizes[axis]);
    return -1;
}

/* Take one argument as an array of one or two axes. */
static int read_array(PyObject *object, const Requirement *required, Array *array, Py_ssize_t *sizes)
{
    int flags = PyBUF_C_CONTIGUOUS | PyBUF_FORMAT | (required->access == WRITTEN ? PyBUF_WRITABLE : 0);
    if (PyObject_GetBuffer(object, &array->buffer, flags) < 0)
        return -1;
    array->held = 1;
    const Py_buffer *buffer = &array->buffer;
    array->kind = kind_of(buffer);
    if (array->kind == 0 || strchr(required->kinds, array->kind) == NULL) {
        PyErr_Format(PyExc_TypeError, "%s has elements of type %s", required->name, buffer->format);
        return -1;
    }
    if (buffer->ndim < 1 || buffer->ndim > 2 || (uintptr_t)buffer->buf % (uintptr_t)buffer->itemsize) {
        PyErr_Format(PyExc_ValueError, "%s is not an aligned array of one or two axes", required->name);
        return -1;
    }
    array->rows = buffer->shape[0];
    array->columns = buffer->ndim == 2 ? buffer->shape[1] : 1;
    if (check_size(required->name, "columns", array->columns, required->columns, sizes) < 0)
        return -1;
    return check_size(required->name, "rows", array->rows, required->rows, sizes);
}

/* Take the arguments of a call. A vertex must have `least_slots` slots or more. */
static int read_arrays(PyObject *const *objects, const Requirement *required, int count, Py_ssize_t least_slots,
                       Array *arrays)
{
    Py_ssize_t sizes[AXES];
    for (int axis = 0; axis < AXES; axis++)
        sizes[axis] = -1;
    sizes[AXIS_1] = 1, sizes[AXIS_3] = 3, sizes[AXIS_4] = 4;
    for (int n = 0; n < count; n++) {
        if (read_array(objects[n], &required[n], &arrays[n], sizes) < 0)
            return -1;
        if (required[n].columns == AXIS_K && arrays[n].columns < least_slots) {
            PyErr_Format(PyExc_ValueError, "%s has %zd columns; at least %zd are needed", required[n].name,
                         arrays[n].columns, least_slots);
            return -1;
        }
    }
    if (sizes[AXIS_FRAMES] > 0 && sizes[AXIS_FRAMES] != sizes[AXIS_V]) {
        PyErr_Format(PyExc_ValueError, "there are %zd tangents, not %zd", sizes[AXIS_FRAMES], sizes[AXIS_V]);
        return -1;
    }
    return 0;
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
static ALWAYS_INLINE Four multiply(Four a, Four b) { return a * b; }
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
static ALWAYS_INLINE Four multiply(Four a, Four b) { EACH(a.of[n] * b.of[n]); }
static ALWAYS_INLINE Four divide(Four a, Four b) { EACH(a.of[n] / b.of[n]); }
static ALWAYS_INLINE Four root(Four a) { EACH(sqrt(a.of[n])); }
#endif
static ALWAYS_INLINE Four load(const double *from)
{
    Four values;
    memcpy(&values, from, sizeof values);
    return values;
}
static ALWAYS_INLINE void store(double *to, Four values) { memcpy(to, &values, sizeof values); }

/* ---- Equal rows (twin: by_numpy.label_equal_rows) ------------------------------------------------------ */

static inline uint64_t mix(uint64_t state, uint64_t word)
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

static inline uint64_t hash_row(const char *row, char kind, Py_ssize_t columns)
{
    uint64_t state = UINT64_C(0x9E3779B97F4A7C15);
    for (Py_ssize_t column = 0; column < columns; column++)
        state = mix(state, word_at(row, kind, column));
    return state ^ (state >> 32);
}

static inline int equal_words(const char *a, const char *b, char kind, Py_ssize_t columns)
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

/* Rows hashed ahead of their turn, while memory fetches their slots of the table. */
enum { AHEAD = 16 };

enum { PROBES_A_ROW = 64 };

/* Fill labels, and count them. If rows were made to have equal hashes, the time would grow with the square of
   their number. Then the loop ends. `first` keeps a row of each label. */
static Status label_rows(const Array *rows, int32_t *labels, Py_ssize_t *labelled)
{
    size_t size = 16;
    while (size < 2 * (size_t)rows->rows)
        size *= 2;
    size_t width = (size_t)rows->buffer.itemsize * (size_t)rows->columns;
    Slot *table = malloc(size * sizeof *table);
    int32_t *first = malloc(((size_t)rows->rows + 1) * sizeof *first);
    Status status = table && first ? DONE : NO_MEMORY;
    Py_ssize_t count = 0;
    uint64_t probes_left = (uint64_t)rows->rows * PROBES_A_ROW + 1024;
    if (status == DONE)
        memset(table, 0xFF, size * sizeof *table); /* label -1: empty */
    const char *data = rows->buffer.buf;
    uint64_t hashes[AHEAD] = {0};
    for (Py_ssize_t next = 0; status == DONE && next < rows->rows + AHEAD; next++) {
        Py_ssize_t row = next - AHEAD;
        uint64_t hash = hashes[next % AHEAD];
        if (next < rows->rows) {
            hashes[next % AHEAD] = hash_row(data + (size_t)next * width, rows->kind, rows->columns);
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
            if (table[at].tag == tag && equal_words(here, there, rows->kind, rows->columns)) {
                labels[row] = table[at].label;
                break;
            }
            if (probes_left-- == 0) {
                status = TOO_MANY_COLLISIONS;
                break;
            }
        }
    }
    free(table);
    free(first);
    *labelled = count;
    return status;
}

static PyObject *label_equal_rows(PyObject *Py_UNUSED(module), PyObject *args)
{
    enum { ROWS, LABELS, ARRAYS };
    static const Requirement required[ARRAYS] = {
        [ROWS] = {"rows", "fdiIQ", AXIS_V, AXIS_ANY, READ},
        [LABELS] = {"labels", "i", AXIS_V, AXIS_1, WRITTEN},
    };
    PyObject *objects[ARRAYS], *result = NULL;
    Array a[ARRAYS] = {{.held = 0}};
    if (!PyArg_ParseTuple(args, "OO", &objects[ROWS], &objects[LABELS]))
        return NULL;
    if (read_arrays(objects, required, ARRAYS, 0, a) < 0)
        goto done;
    if (a[ROWS].rows >= INT32_MAX) {
        PyErr_SetString(PyExc_ValueError, "too many rows");
        goto done;
    }
    Py_ssize_t count;
    Status status;
    Py_BEGIN_ALLOW_THREADS
    status = label_rows(&a[ROWS], a[LABELS].buffer.buf, &count);
    Py_END_ALLOW_THREADS
    if (status == DONE)
        result = PyLong_FromSsize_t(count);
    else
        raise_status(status);
done:
    release_arrays(a, ARRAYS);
    return result;
}

/* ---- Weight field (twin: by_numpy.normalise_influences) ------------------------------------------------ */

/* The influences of all vertices, to be normalised in place. */
typedef struct {
    int32_t *joints; /* (V, K) */
    double *weights;
    uint8_t *unused;
    Py_ssize_t slots;
    double adopting_sum, tolerance;
} Influences;

/* The numbers of vertices at which something was assumed. */
typedef struct {
    Py_ssize_t negative, all_zero, not_normalised, repeated_joint;
} Defects;

static void normalise_vertex(const Influences *field, Py_ssize_t vertex, Defects *defects)
{
    const Py_ssize_t slots = field->slots;
    int32_t *joints = field->joints + vertex * slots;
    double *weights = field->weights + vertex * slots;
    uint8_t *unused = field->unused + vertex * slots;
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
    if (!(total > field->adopting_sum))
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
    defects->repeated_joint += merged;
    defects->not_normalised += fabs(total - 1.0) > field->tolerance;
    for (Py_ssize_t k = 0; k < slots; k++)
        weights[k] /= total;
}

static PyObject *normalise_influences(PyObject *Py_UNUSED(module), PyObject *args)
{
    enum { JOINTS, WEIGHTS, UNUSED, ARRAYS };
    static const Requirement required[ARRAYS] = {
        [JOINTS] = {"joints", "i", AXIS_V, AXIS_K, WRITTEN},
        [WEIGHTS] = {"weights", "d", AXIS_V, AXIS_K, WRITTEN},
        [UNUSED] = {"free", "?", AXIS_V, AXIS_K, WRITTEN},
    };
    PyObject *objects[ARRAYS], *result = NULL;
    Array a[ARRAYS] = {{.held = 0}};
    Influences field;
    if (!PyArg_ParseTuple(args, "OOOdd", &objects[JOINTS], &objects[WEIGHTS], &objects[UNUSED],
                          &field.adopting_sum, &field.tolerance))
        return NULL;
    if (read_arrays(objects, required, ARRAYS, 1, a) < 0)
        goto done;
    field.joints = a[JOINTS].buffer.buf;
    field.weights = a[WEIGHTS].buffer.buf;
    field.unused = a[UNUSED].buffer.buf;
    field.slots = a[JOINTS].columns;
    Defects defects = {0, 0, 0, 0};
    Py_BEGIN_ALLOW_THREADS
    for (Py_ssize_t vertex = 0; vertex < a[JOINTS].rows; vertex++)
        normalise_vertex(&field, vertex, &defects);
    Py_END_ALLOW_THREADS
    result = Py_BuildValue("{snsnsnsn}", "negative", defects.negative, "all_zero", defects.all_zero,
                           "not_normalised", defects.not_normalised, "repeated_joint", defects.repeated_joint);
done:
    release_arrays(a, ARRAYS);
    return result;
}

/* ---- Triangles with an area (twin: triangles.mark_proper) ---------------------------------------------- */

static inline int has_area(Vector p, Vector q, Vector r, double least)
{
    Vector a = minus(q, p), b = minus(r, p), n = cross(a, b);
    double first = dot(a, a), second = dot(b, b), third = first + second - 2.0 * dot(a, b);
    double longest = first > second ? first : second;
    longest = third > longest ? third : longest;
    return sqrt(dot(n, n)) > least * longest;
}

static Status mark_areas(const Array *positions, const Array *triangles, uint8_t *mask, double least)
{
    const void *points = positions->buffer.buf;
    int wide = positions->kind == 'd';
    const uint32_t *index = triangles->buffer.buf;
    size_t vertices = (size_t)positions->rows;
    for (Py_ssize_t t = 0; t < triangles->rows; t++, index += 3) {
        const uint32_t p = index[0], q = index[1], r = index[2];
        if (p >= vertices || q >= vertices || r >= vertices)
            return STRAY_INDEX;
        mask[t] = (uint8_t)has_area(row3(points, wide, p), row3(points, wide, q), row3(points, wide, r), least);
    }
    return DONE;
}

static PyObject *mark_proper(PyObject *Py_UNUSED(module), PyObject *args)
{
    enum { POSITIONS, TRIANGLES, MASK, ARRAYS };
    static const Requirement required[ARRAYS] = {
        [POSITIONS] = {"positions", "fd", AXIS_V, AXIS_3, READ},
        [TRIANGLES] = {"triangles", "iI", AXIS_T, AXIS_3, READ},
        [MASK] = {"mask", "?", AXIS_T, AXIS_1, WRITTEN},
    };
    PyObject *objects[ARRAYS], *result = NULL;
    Array a[ARRAYS] = {{.held = 0}};
    double least;
    if (!PyArg_ParseTuple(args, "OOOd", &objects[POSITIONS], &objects[TRIANGLES], &objects[MASK], &least))
        return NULL;
    if (read_arrays(objects, required, ARRAYS, 0, a) < 0)
        goto done;
    Status status;
    Py_BEGIN_ALLOW_THREADS
    status = mark_areas(&a[POSITIONS], &a[TRIANGLES], a[MASK].buffer.buf, least);
    Py_END_ALLOW_THREADS
    if (status == DONE)
        result = Py_NewRef(Py_None);
    else
        raise_status(status);
done:
    release_arrays(a, ARRAYS);
    return result;
}

/* ---- Gradients and slots (twin: by_numpy.bake_surface) ------------------------------------------------- */

/* The surface to bake: V vertices with K slots each, T triangles, C weld classes. Rows as in the twins. */
typedef struct {
    const void *positions, *normals, *tangents, *bitangents; /* (V, 3) of floats or doubles */
    int wide_positions, wide_normals, wide_frame;            /* tangents NULL: the frame comes from normals */
    const uint32_t *triangles; /* (T, 3) */
    const int32_t *joints;     /* (V, K), NO_JOINT where a slot has none */
    const double *weights;     /* (V, K) */
    const uint8_t *unused;     /* (V, K): may adopt */
    const int32_t *classes;    /* (V,) */
    Py_ssize_t vertices, slots, triangle_count, class_count, joint_count;
    Weighting weighting;
    int adopts;
    double negligible;
} Surface;

/* The counts of one primitive: a row of float64. */
typedef struct {
    double adopting, overflowing; /* vertices */
    double magnitude, unheld;     /* of all gradients; of the gradients that no slot holds */
} Sums;

typedef struct {
    float *alpha, *beta; /* (V, K - 1) */
    int32_t *adopted;    /* (V, K) of zeros; 1 + joint if a slot adopts one */
    const uint64_t *ends; /* (P,): the end of the rows of each primitive */
    size_t primitives;
    Sums *sums; /* (P,) */
} Baked;

/* Members of every group, in ascending order. Group g has start[g] ... start[g + 1]. */
typedef struct {
    uint32_t *start, *members;
} Groups;

/* While the GIL is released, another thread may write to the arrays. So every index is checked at its use, on the
   value that is used. The checks of earlier loops do not count. STRAY_INDEX means an index out of range. */

/* The class of a vertex; class_count if there is no such vertex or class. */
static ALWAYS_INLINE size_t class_of(const Surface *s, size_t vertex)
{
    size_t found = vertex < (size_t)s->vertices ? (size_t)(uint32_t)s->classes[vertex] : (size_t)s->class_count;
    return found < (size_t)s->class_count ? found : (size_t)s->class_count;
}

/* Group the corners 4 t + i by weld class, by counting. */
static Status group_corners(const Surface *s, Groups *groups)
{
    size_t corners = 3 * (size_t)s->triangle_count, classes = (size_t)s->class_count;
    groups->start = calloc(classes + 2, sizeof *groups->start);
    groups->members = malloc((corners + 1) * sizeof *groups->members);
    if (!groups->start || !groups->members)
        return NO_MEMORY;
    uint32_t *next = groups->start + 1; /* one ahead: filling moves every start to its place */
    for (size_t corner = 0; corner < corners; corner++) {
        size_t c = class_of(s, s->triangles[corner]);
        if (c == classes)
            return STRAY_INDEX;
        next[c + 1]++;
    }
    for (size_t c = 0; c < classes; c++)
        next[c + 1] += next[c];
    for (size_t t = 0; t < (size_t)s->triangle_count; t++)
        for (size_t i = 0; i < 3; i++) {
            size_t c = class_of(s, s->triangles[3 * t + i]);
            if (c == classes || next[c] >= corners)
                return STRAY_INDEX;
            groups->members[next[c]++] = (uint32_t)(4 * t + i);
        }
    return DONE;
}

/* Group the vertices by weld class. If every class is one vertex of the same number, members stay NULL. */
static Status group_vertices(const Surface *s, Groups *groups)
{
    size_t vertices = (size_t)s->vertices, classes = (size_t)s->class_count;
    size_t v = 0;
    while (v < vertices && s->classes[v] == (int32_t)v)
        v++;
    if (v == vertices && classes == vertices)
        return DONE;
    groups->start = calloc(classes + 2, sizeof *groups->start);
    groups->members = malloc((vertices + 1) * sizeof *groups->members);
    if (!groups->start || !groups->members)
        return NO_MEMORY;
    uint32_t *next = groups->start + 1;
    for (v = 0; v < vertices; v++) {
        size_t c = class_of(s, v);
        if (c == classes)
            return STRAY_INDEX;
        next[c + 1]++;
    }
    for (size_t c = 0; c < classes; c++)
        next[c + 1] += next[c];
    for (v = 0; v < vertices; v++) {
        size_t c = class_of(s, v);
        if (c == classes || next[c] >= vertices)
            return STRAY_INDEX;
        groups->members[next[c]++] = (uint32_t)v;
    }
    return DONE;
}

/* Some members of a group. */
typedef struct {
    const uint32_t *first;
    size_t count;
} Members;

/* Facts that each copy of the loop knows beforehand: whether positions are doubles, and the number of slots. */
typedef struct {
    int wide;
    size_t slots;
} Shape;

/* Some corners of a class at once, component by component. Edges lead to the two other corners of the triangle,
   the vertices `ends`. The sum multiplies the differences of weights along the edges by coefficients. share is the
   corner's weight in the mean (see corner.py). */
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
    int stray;      /* an index was out of range at its use */
} Scratch;

static void free_scratch(Scratch *w)
{
    free(w->local), free(w->met), free(w->seen), free(w->own), free(w->x), free(w->y), free(w->z);
    free(w->entries), free(w->foreign), free(w->named);
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
    return DONE;
}

/* Write ends and edges of at most AT_ONCE corners, whose class is at `origin`. The first one fills the rest. */
static ALWAYS_INLINE void find_edges(const Surface *s, Shape shape, Vector origin, Members some, Corners *c,
                                     Scratch *w)
{
    const size_t vertices = (size_t)s->vertices;
    Vector e1[AT_ONCE], e2[AT_ONCE];
    for (size_t n = 0; n < some.count; n++) {
        static const uint8_t following[] = {1, 2, 0}, last[] = {2, 0, 1};
        const uint32_t *triangle = s->triangles + 3 * (size_t)(some.first[n] >> 2);
        uint32_t one = triangle[following[some.first[n] & 3]], other = triangle[last[some.first[n] & 3]];
        if (one >= vertices || other >= vertices)
            one = other = 0, w->stray = 1;
        c->ends[n][0] = one, c->ends[n][1] = other;
        e1[n] = minus(row3(s->positions, shape.wide, one), origin);
        e2[n] = minus(row3(s->positions, shape.wide, other), origin);
    }
    for (size_t n = some.count; n < AT_ONCE; n++)
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
    return add(add(multiply(a[0], b[0]), multiply(a[1], b[1])), multiply(a[2], b[2]));
}

/* Work out share and coefficients from the edges. With n = e1 x e2, corner.py's e2 x n is
   e1 |e2|^2 - e2 (e1 . e2), and n x e1 likewise. */
static ALWAYS_INLINE void weigh_corners(Corners *c, Weighting weighting)
{
    const Four *e1 = c->edges + X1, *e2 = c->edges + X2;
    Four normal[3] = {
        subtract(multiply(e1[1], e2[2]), multiply(e1[2], e2[1])),
        subtract(multiply(e1[2], e2[0]), multiply(e1[0], e2[2])),
        subtract(multiply(e1[0], e2[1]), multiply(e1[1], e2[0])),
    };
    Four squared_area2 = four_dot(normal, normal), dots = four_dot(e1, e2);
    Four squared1 = four_dot(e1, e1), squared2 = four_dot(e2, e2), area2 = root(squared_area2), scale;
    if (weighting == BY_MAX) { /* 1 / (|e1|^2 |e2|^2) times |e1 x e2| */
        scale = divide(four(1.0, 1.0, 1.0, 1.0), multiply(multiply(area2, squared1), squared2));
        store(c->share, multiply(squared_area2, scale));
    } else {
        double areas[AT_ONCE], cosines[AT_ONCE];
        store(areas, area2);
        store(cosines, dots);
        for (int n = 0; n < AT_ONCE; n++) {
            c->share[n] = weighting == BY_AREA ? areas[n] : atan2(areas[n], cosines[n]);
            c->share[n] *= weighting == BY_ANGLE_AREA ? areas[n] : 1.0;
        }
        scale = divide(load(c->share), squared_area2);
    }
    Four mixed = multiply(dots, scale), own1 = multiply(squared2, scale), own2 = multiply(squared1, scale);
    for (int axis = 0; axis < 3; axis++) {
        store(c->coefficients[X1 + axis], subtract(multiply(e1[axis], own1), multiply(e2[axis], mixed)));
        store(c->coefficients[X2 + axis], subtract(multiply(e2[axis], own2), multiply(e1[axis], mixed)));
    }
}

static inline void add_scaled(Scratch *w, int32_t number, Vector v, double by)
{
    w->x[number] += v.x * by;
    w->y[number] += v.y * by;
    w->z[number] += v.z * by;
}

/* Add coefficient x (weight there - weight here) for every joint that either vertex has. Return the number of
   local numbers in use. All sums run over differences of weights, so the sum of a constant weight is 0 exactly. */
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

/* Whether a vertex has the same joints as another, slot by slot. Then its differences need no look-up. */
static ALWAYS_INLINE int same_joints(const Surface *s, size_t slots, size_t here, size_t there)
{
    return memcmp(s->joints + here * slots, s->joints + there * slots, slots * sizeof *s->joints) == 0;
}

/* Sum over all corners, for every joint met. Return the number of local numbers in use, and the weight of all
   corners as `total`. */
static ALWAYS_INLINE int32_t sum_corners(const Surface *s, Shape shape, size_t vertex, Members corners, Scratch *w,
                                         double *total)
{
    const size_t slots = shape.slots;
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
    Vector origin = row3(s->positions, shape.wide, vertex);
    const double *here = s->weights + vertex * slots;
    Four none = four(0.0, 0.0, 0.0, 0.0), x = none, y = none, z = none; /* sums of the usual four slots */
    Four own = slots == 4 ? load(here) : none;
    *total = 0.0;
    for (size_t from = 0; from < corners.count; from += AT_ONCE) {
        size_t some = corners.count - from < AT_ONCE ? corners.count - from : AT_ONCE;
        Corners c;
        find_edges(s, shape, origin, (Members){corners.first + from, some}, &c, w);
        weigh_corners(&c, s->weighting);
        for (size_t n = 0; n < some; n++)
            for (int end = 0; end < 2; end++) {
                size_t there = c.ends[n][end];
                const double(*component)[AT_ONCE] = c.coefficients + 3 * end;
                Vector by = {component[X1][n], component[Y1][n], component[Z1][n]};
                if (slots == 4 && same_joints(s, slots, vertex, there)) {
                    Four difference = subtract(load(s->weights + there * slots), own);
                    x = add(x, multiply(four(by.x, by.x, by.x, by.x), difference));
                    y = add(y, multiply(four(by.y, by.y, by.y, by.y), difference));
                    z = add(z, multiply(four(by.z, by.z, by.z, by.z), difference));
                } else
                    used = add_differences(s, there, by, used, w);
            }
        for (size_t n = 0; n < some; n++)
            *total += c.share[n];
    }
    if (slots == 4) {
        store(w->x, add(load(w->x), x));
        store(w->y, add(load(w->y), y));
        store(w->z, add(load(w->z), z));
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

/* Up to this number of entries, insertion is the fastest way to sort. */
enum { FEW = 32 };

/* The numbers of entries and foreign entries of a class in the scratch, and the sum of the entries' magnitudes. */
typedef struct {
    size_t entries, foreign;
    size_t capacity; /* joints that each of the class's vertices may adopt */
    double magnitude;
} ClassGradients;

/* Turn sums into entries, joints ascending. Return their number, and the sum of their magnitudes. */
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

/* Collect the entries that are worth a slot, and whose joints the class does not have. The largest is first. */
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

/* Fill `named`, and the adopted joints of one vertex. Return whether it adopts any. */
static inline int name_slots(const Surface *s, size_t vertex, const ClassGradients *found, Scratch *w,
                             int32_t *adopted)
{
    const size_t slots = (size_t)s->slots;
    const int32_t *joints = s->joints + vertex * slots;
    const uint8_t *unused = s->unused + vertex * slots;
    size_t moved = 0, wanted = found->foreign < found->capacity ? found->foreign : found->capacity;
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

/* The slots that a vertex's gradients go to: by `named`, or by the local numbers. The local numbers hold for a
   class's first vertex if it adopts nothing. */
typedef enum { AS_NAMED, AS_NUMBERED } Placing;

/* Write alpha and beta of one vertex. Return the magnitude that its slots do not hold. */
static ALWAYS_INLINE double project(const Surface *s, size_t slots, size_t vertex, size_t entries, Placing placing,
                                    const Baked *out, Scratch *w)
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
        if (placing == AS_NAMED)
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

static size_t shared_capacity(const Surface *s, Members vertices)
{
    size_t least = (size_t)s->slots;
    for (size_t n = 0; n < vertices.count; n++) {
        size_t unused = 0;
        for (Py_ssize_t k = 0; k < s->slots; k++)
            unused += s->unused[vertices.first[n] * (size_t)s->slots + (size_t)k] != 0;
        least = unused < least ? unused : least;
    }
    return least;
}

/* The state of a bake: the surface, its corners and vertices by weld class, and room to work in. */
typedef struct {
    const Surface *surface;
    Groups corners, vertices;
    Scratch scratch;
    const Baked *out;
} Work;

/* Sum up the gradients of a class of some vertices, into the scratch. */
static ALWAYS_INLINE ClassGradients find_gradients(Work *work, Shape shape, Members corners, Members vertices)
{
    const Surface *s = work->surface;
    ClassGradients found = {0, 0, 0, 0.0};
    if (corners.count == 0)
        return found;
    double total;
    int32_t used = sum_corners(s, shape, vertices.first[0], corners, &work->scratch, &total);
    found.entries = make_entries(&work->scratch, used, total, &found.magnitude);
    found.foreign = find_foreign(s, found.entries, found.magnitude, &work->scratch);
    found.capacity = found.foreign && s->adopts ? shared_capacity(s, vertices) : 0;
    return found;
}

/* Write all results of one vertex of a class. */
static ALWAYS_INLINE void write_vertex(Work *work, Shape shape, size_t vertex, Placing placing,
                                       const ClassGradients *found)
{
    const Surface *s = work->surface;
    const Baked *out = work->out;
    Scratch *w = &work->scratch;
    size_t primitive = 0;
    while (primitive + 1 < out->primitives && vertex >= out->ends[primitive])
        primitive++;
    Sums *sums = out->sums + primitive;
    if (placing == AS_NAMED)
        sums->adopting += name_slots(s, vertex, found, w, out->adopted + vertex * shape.slots);
    sums->magnitude += found->magnitude;
    sums->unheld += project(s, shape.slots, vertex, found->entries, placing, out, w);
    int overflows = 0;
    for (size_t f = 0; f < found->foreign; f++)
        overflows |= !w->foreign[f]->held;
    sums->overflowing += overflows;
}

static ALWAYS_INLINE Status bake_classes(Work *work, Shape shape)
{
    const Groups *corners = &work->corners, *vertices = &work->vertices;
    for (size_t c = 0; c < (size_t)work->surface->class_count; c++) {
        uint32_t itself = (uint32_t)c;
        if (corners->start[c + 1] < corners->start[c] ||
            (vertices->start && vertices->start[c + 1] < vertices->start[c]))
            return STRAY_INDEX; /* the classes have changed while they were counted */
        Members own = {&itself, 1};
        if (vertices->start)
            own = (Members){vertices->members + vertices->start[c], vertices->start[c + 1] - vertices->start[c]};
        if (own.count == 0)
            continue;
        Members around = {corners->members + corners->start[c], corners->start[c + 1] - corners->start[c]};
        ClassGradients found = find_gradients(work, shape, around, own);
        for (size_t n = 0; n < own.count; n++) {
            int adopts_nothing = found.foreign == 0 || found.capacity == 0;
            Placing placing = n == 0 && adopts_nothing ? AS_NUMBERED : AS_NAMED;
            write_vertex(work, shape, own.first[n], placing, &found);
        }
    }
    return work->scratch.stray ? STRAY_INDEX : DONE;
}

/* Copies of the loop for the usual cases. They need not check types and counts for each vertex. */
FOR_PROCESSORS
static Status bake_all_classes(Work *work)
{
    const size_t slots = (size_t)work->surface->slots;
    if (work->surface->wide_positions)
        return bake_classes(work, (Shape){1, slots});
    if (slots == 4)
        return bake_classes(work, (Shape){0, 4});
    return bake_classes(work, (Shape){0, slots});
}

static Status bake_checked_surface(const Surface *s, const Baked *out)
{
    Work work;
    memset(&work, 0, sizeof work);
    work.surface = s, work.out = out;
    Status status = group_corners(s, &work.corners);
    if (status == DONE)
        status = group_vertices(s, &work.vertices);
    if (status == DONE)
        status = allocate_scratch(&work.scratch, s);
    if (status == DONE)
        status = bake_all_classes(&work);
    free_scratch(&work.scratch);
    free(work.corners.start), free(work.corners.members);
    free(work.vertices.start), free(work.vertices.members);
    return status;
}

/* Check the range of indices, and find the number of joints. Return -1 with an exception if one is wrong. */
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

static const Requirement surface_arrays[ARRAYS] = {
    [POSITIONS] = {"positions", "fd", AXIS_V, AXIS_3, READ},
    [TRIANGLES] = {"triangles", "iI", AXIS_T, AXIS_3, READ},
    [JOINTS] = {"joints", "i", AXIS_V, AXIS_K, READ},
    [WEIGHTS] = {"weights", "d", AXIS_V, AXIS_K, READ},
    [UNUSED] = {"free", "?", AXIS_V, AXIS_K, READ},
    [CLASSES] = {"classes", "i", AXIS_V, AXIS_1, READ},
    [NORMALS] = {"normals", "fd", AXIS_V, AXIS_3, READ},
    [TANGENTS] = {"tangents", "fd", AXIS_FRAMES, AXIS_3, READ},
    [BITANGENTS] = {"bitangents", "fd", AXIS_FRAMES, AXIS_3, READ},
    [ALPHA] = {"alpha", "f", AXIS_V, AXIS_LATER_K, WRITTEN},
    [BETA] = {"beta", "f", AXIS_V, AXIS_LATER_K, WRITTEN},
    [ADOPTED] = {"adopted", "i", AXIS_V, AXIS_K, WRITTEN},
    [ENDS] = {"ends", "Q", AXIS_P, AXIS_1, READ},
    [SUMS] = {"sums", "d", AXIS_P, AXIS_4, WRITTEN},
};

/* Take and check the arguments of bake_surface. Return -1 with an exception if one is wrong. */
static int read_surface(PyObject *args, PyObject *keywords, Array *a, Surface *s, Baked *out)
{
    static char *names[] = {"positions", "triangles", "joints", "weights", "free", "classes", "normals", "tangents",
                            "bitangents", "alpha", "beta", "adopted", "ends", "sums", "class_count", "weighting",
                            "adopts", "negligible", NULL};
    PyObject *o[ARRAYS];
    Py_ssize_t class_count;
    int weighting, adopts;
    double negligible;
    if (!PyArg_ParseTupleAndKeywords(args, keywords, "$OOOOOOOOOOOOOOnipd", names, &o[POSITIONS], &o[TRIANGLES],
                                     &o[JOINTS], &o[WEIGHTS], &o[UNUSED], &o[CLASSES], &o[NORMALS], &o[TANGENTS],
                                     &o[BITANGENTS], &o[ALPHA], &o[BETA], &o[ADOPTED], &o[ENDS], &o[SUMS],
                                     &class_count, &weighting, &adopts, &negligible))
        return -1;
    if (read_arrays(o, surface_arrays, ARRAYS, 2, a) < 0)
        return -1;
    const uint64_t *ends = a[ENDS].buffer.buf;
    if (a[ENDS].rows < 1 || ends[a[ENDS].rows - 1] != (uint64_t)a[POSITIONS].rows ||
        a[TANGENTS].kind != a[BITANGENTS].kind) {
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
        .unused = a[UNUSED].buffer.buf,
        .classes = a[CLASSES].buffer.buf,
        .vertices = a[POSITIONS].rows,
        .slots = a[JOINTS].columns,
        .triangle_count = a[TRIANGLES].rows,
        .class_count = class_count,
        .weighting = (Weighting)weighting,
        .adopts = adopts,
        .negligible = negligible,
    };
    *out = (Baked){
        .alpha = a[ALPHA].buffer.buf,
        .beta = a[BETA].buffer.buf,
        .adopted = a[ADOPTED].buffer.buf,
        .ends = ends,
        .primitives = (size_t)a[ENDS].rows,
        .sums = a[SUMS].buffer.buf,
    };
    return check_surface(s);
}

static PyObject *bake_surface(PyObject *Py_UNUSED(module), PyObject *args, PyObject *keywords)
{
    PyObject *result = NULL;
    Array a[ARRAYS];
    memset(a, 0, sizeof a);
    Surface surface;
    Baked out;
    if (read_surface(args, keywords, a, &surface, &out) < 0)
        goto done;
    Status status;
    Py_BEGIN_ALLOW_THREADS
    status = bake_checked_surface(&surface, &out);
    Py_END_ALLOW_THREADS
    if (status == DONE)
        result = Py_NewRef(Py_None);
    else
        raise_status(status);
done:
    release_arrays(a, ARRAYS);
    return result;
}

/* ---- The module ---------------------------------------------------------------------------------------- */

static PyMethodDef functions[] = {
    {"label_equal_rows", label_equal_rows, METH_VARARGS,
     "label_equal_rows(rows, labels): fill labels, return how many there are."},
    {"normalise_influences", normalise_influences, METH_VARARGS,
     "normalise_influences(joints, weights, free, adopting_sum, tolerance): in place; return the defects by name."},
    {"mark_proper", mark_proper, METH_VARARGS, "mark_proper(positions, triangles, mask, least): fill mask."},
    {"bake_surface", (PyCFunction)(void (*)(void))bake_surface, METH_VARARGS | METH_KEYWORDS,
     "bake_surface(*, positions, triangles, ...): fill alpha, beta, adopted and sums; see _kernel.pyi."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "_kernel", "Compiled loops; see _kernel.pyi.", -1, functions,
    NULL, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__kernel(void)
{
    PyObject *module = PyModule_Create(&definition);
    if (module == NULL)
        return NULL;
    collision_error = PyErr_NewException("skinbake.gradients._kernel.CollisionError", PyExc_RuntimeError, NULL);
    if (collision_error == NULL || PyModule_AddObjectRef(module, "CollisionError", collision_error) < 0 ||
        PyModule_AddIntConstant(module, "BY_MAX", BY_MAX) < 0 ||
        PyModule_AddIntConstant(module, "BY_ANGLE", BY_ANGLE) < 0 ||
        PyModule_AddIntConstant(module, "BY_AREA", BY_AREA) < 0 ||
        PyModule_AddIntConstant(module, "BY_ANGLE_AREA", BY_ANGLE_AREA) < 0) {
        Py_DECREF(module);
        return NULL;
    }
    return module;
}
