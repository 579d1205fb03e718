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
#define NO_CHAIN (-1)

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
   share an axis have one size there. LATER_K is K without the first slot; FRAMES is V, or 0 for none; J counts
   the joints of a rig, 0 for none. */
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
    AXIS_J,
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
typedef int64_t Words __attribute__((vector_size(32)));
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

/* A number for each of the two tangents of a class. */
#if defined(__GNUC__)
typedef double Pair __attribute__((vector_size(16)));
static ALWAYS_INLINE Pair pair(double a, double b) { return (Pair){a, b}; }
static ALWAYS_INLINE Pair add_pairs(Pair a, Pair b) { return a + b; }
static ALWAYS_INLINE Pair subtract_pairs(Pair a, Pair b) { return a - b; }
static ALWAYS_INLINE Pair multiply_pairs(Pair a, Pair b) { return a * b; }
static ALWAYS_INLINE Pair divide_pairs(Pair a, Pair b) { return a / b; }
static ALWAYS_INLINE double part(Pair a, int n) { return a[n]; }
#else
typedef struct {
    double of[2];
} Pair;
static ALWAYS_INLINE Pair pair(double a, double b) { return (Pair){{a, b}}; }
static ALWAYS_INLINE Pair add_pairs(Pair a, Pair b) { return pair(a.of[0] + b.of[0], a.of[1] + b.of[1]); }
static ALWAYS_INLINE Pair subtract_pairs(Pair a, Pair b) { return pair(a.of[0] - b.of[0], a.of[1] - b.of[1]); }
static ALWAYS_INLINE Pair multiply_pairs(Pair a, Pair b) { return pair(a.of[0] * b.of[0], a.of[1] * b.of[1]); }
static ALWAYS_INLINE Pair divide_pairs(Pair a, Pair b) { return pair(a.of[0] / b.of[0], a.of[1] / b.of[1]); }
static ALWAYS_INLINE double part(Pair a, int n) { return a.of[n]; }
#endif
static ALWAYS_INLINE Pair both(double a) { return pair(a, a); }
static ALWAYS_INLINE Pair scaled(double by, Pair a) { return multiply_pairs(both(by), a); }
static ALWAYS_INLINE Pair load_pair(const double *from)
{
    Pair values;
    memcpy(&values, from, sizeof values);
    return values;
}
static ALWAYS_INLINE void store_pair(double *to, Pair values) { memcpy(to, &values, sizeof values); }

static ALWAYS_INLINE Four load(const double *from)
{
    Four values;
    memcpy(&values, from, sizeof values);
    return values;
}
static ALWAYS_INLINE void store(double *to, Four values) { memcpy(to, &values, sizeof values); }
static ALWAYS_INLINE Four join(Pair a, Pair b) { return four(part(a, 0), part(a, 1), part(b, 0), part(b, 1)); }

/* A vector for each of the two tangents of a class. */
typedef struct {
    Pair x, y, z;
} Vectors;
static ALWAYS_INLINE Vector one_of(Vectors v, int n) { return (Vector){part(v.x, n), part(v.y, n), part(v.z, n)}; }
static ALWAYS_INLINE Vectors twice(Vector v) { return (Vectors){both(v.x), both(v.y), both(v.z)}; }
static ALWAYS_INLINE Vectors load_vectors(const double *from)
{
    return (Vectors){load_pair(from), load_pair(from + 2), load_pair(from + 4)};
}
static ALWAYS_INLINE Vectors plus_each(Vectors a, Vectors b)
{
    return (Vectors){add_pairs(a.x, b.x), add_pairs(a.y, b.y), add_pairs(a.z, b.z)};
}
static ALWAYS_INLINE Vectors times_each(Vectors a, Pair by)
{
    return (Vectors){multiply_pairs(a.x, by), multiply_pairs(a.y, by), multiply_pairs(a.z, by)};
}
static ALWAYS_INLINE Pair dots(Vectors a, Vectors b)
{
    return add_pairs(add_pairs(multiply_pairs(a.x, b.x), multiply_pairs(a.y, b.y)), multiply_pairs(a.z, b.z));
}
static ALWAYS_INLINE Vectors crosses(Vectors a, Vectors b)
{
    return (Vectors){subtract_pairs(multiply_pairs(a.y, b.z), multiply_pairs(a.z, b.y)),
                     subtract_pairs(multiply_pairs(a.z, b.x), multiply_pairs(a.x, b.z)),
                     subtract_pairs(multiply_pairs(a.x, b.y), multiply_pairs(a.y, b.x))};
}

#if defined(__clang__) || (defined(__GNUC__) && __GNUC__ >= 12)
#define HAS_SHUFFLES
#endif

/* Row `row` of an array (n, 3) of floats or doubles, and a zero. */
static ALWAYS_INLINE Four row4(const void *base, int wide, size_t row)
{
#if defined(HAS_SHUFFLES)
    typedef float Floats __attribute__((vector_size(16)));
    const float *p = (const float *)base + 3 * row;
    if (!wide)
        return __builtin_convertvector(((Floats){p[0], p[1], p[2], 0.0f}), Four);
#endif
    Vector v = row3(base, wide, row);
    return four(v.x, v.y, v.z, 0.0);
}

/* The three columns of four rows. */
static ALWAYS_INLINE void turn_rows(const double *const rows[4], Four columns[3])
{
#if defined(HAS_SHUFFLES)
    Four even = join(load_pair(rows[0]), load_pair(rows[2])), odd = join(load_pair(rows[1]), load_pair(rows[3]));
    columns[0] = __builtin_shufflevector(even, odd, 0, 4, 2, 6);
    columns[1] = __builtin_shufflevector(even, odd, 1, 5, 3, 7);
    even = join(load_pair(rows[0] + 2), load_pair(rows[2] + 2));
    odd = join(load_pair(rows[1] + 2), load_pair(rows[3] + 2));
    columns[2] = __builtin_shufflevector(even, odd, 0, 4, 2, 6);
#else
    for (int m = 0; m < 3; m++)
        columns[m] = four(rows[0][m], rows[1][m], rows[2][m], rows[3][m]);
#endif
}

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
    double adopting_sum, tolerance, least;
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
    double total = 0.0, largest = 0.0;
    for (Py_ssize_t k = 0; k < slots; k++)
        largest = weights[k] > largest ? weights[k] : largest;
    for (Py_ssize_t k = 0; k < slots; k++) {
        if (weights[k] > 0.0 && weights[k] < field->least * largest)
            weights[k] = 0.0;
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
    if (!PyArg_ParseTuple(args, "OOOddd", &objects[JOINTS], &objects[WEIGHTS], &objects[UNUSED],
                          &field.adopting_sum, &field.tolerance, &field.least))
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

/* How gradients are fitted to a rig (rig_fit.py has the same names). */
typedef struct {
    double missing, stiffness, together, doubt, smooth, most_doubt, even, faint, unfelt, flat; /* as in surface.py */
} FitSettings;

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
    const int32_t *parents, *ranks; /* (J,) of the rig to fit to, NULL for none; see rig.py */
    const double *pivots;           /* (J, 3), NaN where a joint does not turn */
    const int32_t *chains;          /* (J,): a long chain's number, the same for all its joints, or NO_CHAIN */
    Py_ssize_t rig_joints;
    FitSettings fit;
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
   value that is used. The checks of earlier loops do not count. STRAY_INDEX means an index out of range. Members of
   groups are zeros at first: if classes change between counting and filling, a member may never be written. */

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
    groups->members = calloc(corners + 1, sizeof *groups->members);
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
    groups->members = calloc(vertices + 1, sizeof *groups->members);
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

/* The corners and the vertices of a surface by weld class, and the numbers that it was made for. */
typedef struct {
    Groups corners, vertices;
    Py_ssize_t joint_count, vertex_count, slots, triangle_count, class_count;
} Grouped;

static void free_grouped(Grouped *grouped)
{
    free(grouped->corners.start), free(grouped->corners.members);
    free(grouped->vertices.start), free(grouped->vertices.members);
}

static Status group_all(const Surface *s, Grouped *grouped)
{
    *grouped = (Grouped){.joint_count = s->joint_count,
                         .vertex_count = s->vertices,
                         .slots = s->slots,
                         .triangle_count = s->triangle_count,
                         .class_count = s->class_count};
    Status status = group_corners(s, &grouped->corners);
    return status == DONE ? group_vertices(s, &grouped->vertices) : status;
}

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

enum { AT_ONCE = 4, X1 = 0, Y1, Z1, X2, Y2, Z2, COMPONENTS };

/* What a weight adds to the turn of the two tangents of a class, as in rig_fit.RingTurns: the arms by axis, then
   the spins by axis, each a number for both tangents. */
enum { ARMS = 0, SPINS = 6, TURN = 12 };

/* What a weight of 1 at a neighbour adds: to the sum of gradients by axis, then to the derivatives along the two
   tangents that the fit follows. A zero fills the last place. */
enum { GRADIENT = 0, ALONG = 3, ADDED = 6 };

/* A neighbour of a class: the edge to it, and what it adds. If it has the joints of the class it is alike, and has
   the differences of the weights of four slots. */
typedef struct {
    double edge[4]; /* x, y, z, 0 */
    double differences[AT_ONCE], added[ADDED];
    uint32_t vertex;
    int alike;
} Neighbour;

/* Some corners of a class at once, component by component. Edges lead to the two other corners of the triangle,
   the vertices `ends`. The sum multiplies the differences of weights along the edges by coefficients. share is the
   corner's weight in the mean (see corner.py). */
typedef struct {
    uint32_t ends[AT_ONCE][2];
    Neighbour *neighbours[2][AT_ONCE]; /* by end: the ends in the ring, if there is one */
    Four edges[COMPONENTS];
    double coefficients[COMPONENTS][AT_ONCE], share[AT_ONCE];
} Corners;

/* The triangles of some corners: e1 x e2, its length, and |e1|^2 |e2|^2. */
typedef struct {
    Four normal[3], area, lengths;
} Facets;

/* Neighbours among which the next one is looked for; one that is met again later stands twice. */
enum { LOOKED_BACK = 16 };

/* Entries of the table that says where in the ring a vertex stands. */
enum { PLACES = 64 };

/* Corners of which a class is fitted at most, and joints that turn around one vertex or are fitted there. */
enum { MOST_CORNERS = 4096, MOST_TURNS = 128, MOST_FITTED = 64 };

/* The vertex whose normal was normalised last, and whether the normal had a direction. */
typedef struct {
    size_t vertex;
    Vector unit;
    int known, directed;
} Latest;

/* The frame of a class, in which its turns are measured. */
typedef struct {
    Vector normal, tangents[2];
    Vectors along;       /* the tangents */
    Vectors leverage[2]; /* see rig_fit._leverage: by derivative */
    double doubt;        /* the tilt for each radian of a turn of which the fit takes half */
    int sound;
} RingFrame;

/* A joint that may turn: which of the fitted slots it carries. */
typedef struct {
    int32_t joint; /* NO_JOINT: above all roots */
    int32_t rank;
    uint64_t members;
    size_t row; /* of the turns */
    int done;
} Node;

/* The turn of one node, and the node above it, which is given what it carries. Both are rows of the turns. */
typedef struct {
    size_t node, above;
    int parts; /* whether it parts the slots: if it does not, nothing else happens */
    double sign, pivot[3];
    uint64_t members, moved; /* the slots that it carries, and those that it moves, each as a bit */
    int32_t chain;
    size_t curl; /* the number of its curl from 1 on, 0 for none */
} Climb;

/* All joints of a long chain that part the slots turn alike. `moved` is how that tilts the tangents for each unit of
   a slot's gradient, and `wanted` how it should tilt them, as in rig_fit._curls. */
typedef struct {
    Vector moved[MOST_FITTED];
    Vectors wanted;
} Curl;

/* The way of the turns around a vertex up the rig. It depends on joints only, and the next vertex often has the
   same ones. */
typedef struct {
    int32_t *turning, *numbers;  /* the joints around the class that turn, and their local numbers */
    size_t turnings;
    int32_t fitted[MOST_FITTED]; /* the joints of the slots that are fitted */
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
    Latest latest;
    int stray;      /* an index was out of range at its use */
    /* Only with a rig: */
    void *corner_room; /* what corners was cut out of, aligned as vectors must be */
    Corners *corners;  /* all corners of a class */
    Neighbour *ring;   /* the ends of these corners */
    size_t neighbours;
    int varies;        /* whether the weights of the ring do */
    uint16_t places[PLACES]; /* by the last digits of a vertex: where it may stand in the ring */
    double *turns;     /* by local number, then spare rows: TURN each */
    size_t room;       /* the first spare row */
    RingFrame frame;
    Vector *gradients; /* by slot */
    double *shares;    /* by slot: of the gradients' lengths */
    int32_t *turning;  /* the local numbers of the joints that turn */
    int known_turnings; /* whether the way is that of these joints */
    Node *nodes;
    int32_t *node_of;  /* by joint: its node, -1 elsewhere */
    size_t node_count;
    double *kept;      /* the turns of a class while those of one of its vertices are carried up */
    Way way;
    double *matrix;    /* MOST_FITTED squared */
    Curl *curls;
} Scratch;

static void free_scratch(Scratch *w)
{
    free(w->local), free(w->met), free(w->seen), free(w->own), free(w->x), free(w->y), free(w->z);
    free(w->entries), free(w->foreign), free(w->named);
    free(w->corner_room), free(w->ring), free(w->turns), free(w->gradients), free(w->shares), free(w->nodes);
    free(w->node_of), free(w->turning), free(w->kept), free(w->way.turning), free(w->way.numbers), free(w->way.climb);
    free(w->matrix), free(w->curls);
}

static Status allocate_fit(Scratch *w, const Surface *s)
{
    size_t joints = (size_t)s->joint_count, room = joints + (size_t)s->slots;
    w->corner_room = malloc((MOST_CORNERS / AT_ONCE + 1) * sizeof *w->corners);
    w->corners = (Corners *)(((uintptr_t)w->corner_room + sizeof(Four) - 1) / sizeof(Four) * sizeof(Four));
    w->ring = malloc(2 * MOST_CORNERS * sizeof *w->ring);
    w->room = room;
    w->turns = malloc((room + MOST_SPARES) * TURN * sizeof *w->turns);
    w->gradients = malloc((size_t)s->slots * sizeof *w->gradients);
    w->shares = malloc((size_t)s->slots * sizeof *w->shares);
    w->nodes = malloc((joints + 1) * sizeof *w->nodes);
    w->node_of = malloc((joints + 1) * sizeof *w->node_of);
    w->matrix = malloc(MOST_FITTED * MOST_FITTED * sizeof *w->matrix);
    w->curls = malloc(MOST_CURLS * sizeof *w->curls);
    w->turning = malloc(room * sizeof *w->turning);
    w->kept = malloc(room * TURN * sizeof *w->kept);
    w->way.turning = malloc(room * sizeof *w->way.turning);
    w->way.numbers = malloc(room * sizeof *w->way.numbers);
    w->way.climb = malloc((MOST_TURNS + (size_t)s->slots) * sizeof *w->way.climb);
    if (!w->corner_room || !w->ring || !w->turns || !w->gradients || !w->shares || !w->nodes || !w->node_of ||
        !w->turning || !w->kept || !w->way.turning || !w->way.numbers || !w->way.climb || !w->matrix || !w->curls)
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

/* Write the ends of some corners. */
static ALWAYS_INLINE void find_ends(const Surface *s, Members some, Corners *c, Scratch *w)
{
    const size_t vertices = (size_t)s->vertices;
    for (size_t n = 0; n < some.count; n++) {
        static const uint8_t following[] = {1, 2, 0}, last[] = {2, 0, 1};
        const uint32_t *triangle = s->triangles + 3 * (size_t)(some.first[n] >> 2);
        uint32_t one = triangle[following[some.first[n] & 3]], other = triangle[last[some.first[n] & 3]];
        if (one >= vertices || other >= vertices)
            one = other = 0, w->stray = 1;
        c->ends[n][0] = one, c->ends[n][1] = other;
    }
}

/* Write the edges of at most AT_ONCE corners, whose class is at `origin`. The first one fills the rest. */
static ALWAYS_INLINE void find_edges(const Surface *s, Shape shape, Vector origin, Members some, Corners *c)
{
    Vector e1[AT_ONCE], e2[AT_ONCE];
    for (size_t n = 0; n < some.count; n++) {
        e1[n] = minus(row3(s->positions, shape.wide, c->ends[n][0]), origin);
        e2[n] = minus(row3(s->positions, shape.wide, c->ends[n][1]), origin);
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
static ALWAYS_INLINE void weigh_corners(Corners *c, Weighting weighting, Facets *facets)
{
    const Four *e1 = c->edges + X1, *e2 = c->edges + X2;
    Four normal[3] = {
        subtract(multiply(e1[1], e2[2]), multiply(e1[2], e2[1])),
        subtract(multiply(e1[2], e2[0]), multiply(e1[0], e2[2])),
        subtract(multiply(e1[0], e2[1]), multiply(e1[1], e2[0])),
    };
    Four squared_area2 = four_dot(normal, normal), dots = four_dot(e1, e2);
    Four squared1 = four_dot(e1, e1), squared2 = four_dot(e2, e2), area2 = root(squared_area2), scale;
    if (facets != NULL)
        *facets = (Facets){{normal[0], normal[1], normal[2]}, area2, multiply(squared1, squared2)};
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

static ALWAYS_INLINE void add_scaled(Scratch *w, int32_t number, Vector v, double by)
{
    w->x[number] += v.x * by;
    w->y[number] += v.y * by;
    w->z[number] += v.z * by;
}

/* Add coefficient x (weight there - weight here) for every joint that either vertex has. Return the number of
   local numbers in use. All sums run over differences of weights, so the sum of a constant weight is 0 exactly. */
static ALWAYS_INLINE int32_t add_differences(const Surface *s, size_t neighbour, Vector c, int32_t used, Scratch *w)
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

/* ---- Fitting to a rig (twin: rig_fit.py) --------------------------------------------------------------- */

static ALWAYS_INLINE Vector plus(Vector a, Vector b) { return (Vector){a.x + b.x, a.y + b.y, a.z + b.z}; }
static ALWAYS_INLINE Vector times(Vector a, double by) { return (Vector){a.x * by, a.y * by, a.z * by}; }
static ALWAYS_INLINE Four all(double a) { return four(a, a, a, a); }

static ALWAYS_INLINE double sum_of(Four values)
{
    double each[AT_ONCE];
    store(each, values);
    return (each[0] + each[1]) + (each[2] + each[3]);
}

static ALWAYS_INLINE Vector sums_of(const Four *values)
{
    return (Vector){sum_of(values[0]), sum_of(values[1]), sum_of(values[2])};
}

static ALWAYS_INLINE void frame_from_unit(Vector normal, Vector *tangent, Vector *bitangent);

/* A normal as the shader normalises it, in float32 (twin: frames.unit_normals). Returns whether it has a direction. */
static ALWAYS_INLINE int unit_normal(Vector normal, Vector *unit)
{
    const double tiny_square = 1e-280; /* frames.TINY_SQUARE */
    int sound = isfinite(normal.x) && isfinite(normal.y) && isfinite(normal.z) &&
                (normal.x != 0.0 || normal.y != 0.0 || normal.z != 0.0);
    double square = dot(normal, normal);
    if (sound && !(square >= tiny_square && isfinite(square))) {
        double largest = fmax(fmax(fabs(normal.x), fabs(normal.y)), fabs(normal.z));
        normal = (Vector){normal.x / largest, normal.y / largest, normal.z / largest};
        square = dot(normal, normal);
    }
    double length = sqrt(square);
    *unit = sound ? (Vector){(float)(normal.x / length), (float)(normal.y / length), (float)(normal.z / length)}
                  : (Vector){0.0, 0.0, 1.0};
    return sound;
}

/* The normal of a vertex as the shader normalises it. Most vertices are asked for twice in a row. */
static ALWAYS_INLINE Vector unit_of(const Surface *s, size_t vertex, Latest *latest)
{
    if (vertex != latest->vertex || !latest->known) {
        latest->directed = unit_normal(row3(s->normals, s->wide_normals, vertex), &latest->unit);
        latest->vertex = vertex, latest->known = 1;
    }
    return latest->unit;
}

/* Work out the leverage of both tangents from the derivatives of the positions along them. */
static ALWAYS_INLINE void find_leverage(RingFrame *f, const Vector derivatives[2], double flat)
{
    Vector a = derivatives[0], b = derivatives[1], c = cross(a, b);
    double area = sqrt(dot(c, c));
    f->sound &= area > flat * sqrt(dot(a, a)) * sqrt(dot(b, b));
    if (!f->sound)
        return;
    const Vector unit = times(c, 1.0 / area), lean = minus(f->normal, times(unit, 0.5 * dot(unit, f->normal)));
    const Vectors t = f->along, normal = twice(f->normal);
    const Vectors q = times_each(twice(lean), divide_pairs(dots(t, twice(unit)), both(area)));
    const Pair squared = both(area * area);
    const Pair by_a = divide_pairs(dots(crosses(t, twice(b)), twice(c)), squared);
    const Pair by_b = divide_pairs(dots(crosses(twice(a), t), twice(c)), squared);
    f->leverage[0] = plus_each(times_each(normal, by_a), crosses(twice(b), q));
    f->leverage[1] = plus_each(times_each(normal, by_b), crosses(q, twice(a)));
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
        if (n == 0 || vertices.count > 1) {
            Vector found = unit_of(s, vertex, latest);
            unit = latest->directed ? four(found.x, found.y, found.z, 0.0) : all(0.0);
        }
        sums = add(sums, unit);
    }
    double each[AT_ONCE];
    store(each, sums);
    const Vector sum = {each[0], each[1], each[2]};
    double least = s->fit.flat * (double)corners.count;
    return dot(sum, sum) > least * least ? sum : (Vector){0.0, 0.0, 0.0};
}

/* The doubt of a class from the length of its mean normal, 1 where all are alike (twin: rig_fit._doubts). */
static ALWAYS_INLINE double doubt_of(const Surface *s, double alignment)
{
    double spread = 1.0 - alignment > s->fit.flat ? 1.0 - alignment : s->fit.flat;
    double smoothness = s->fit.smooth / spread, cube = smoothness * smoothness * smoothness;
    return s->fit.doubt * (cube < 1.0 ? 1.0 : cube < s->fit.most_doubt ? cube : s->fit.most_doubt);
}

/* Write six numbers of four corners by corner. */
static ALWAYS_INLINE void turn_over(const Four numbers[ADDED], double by_corner[AT_ONCE][ADDED])
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
            const uint32_t there = c->ends[n][end];
            const size_t place = place_of(there, ring, count, w->places);
            Neighbour *found = c->neighbours[end][n] = &ring[place];
            w->places[there % PLACES] = (uint16_t)place;
            edges[n] = found->edge;
            if (place < count)
                continue;
            count++;
            const double *weights = s->weights + there * slots;
            found->vertex = there;
            found->alike = slots == 4 && same_joints(s, slots, vertex, there);
            store(found->edge, subtract(row4(s->positions, shape.wide, there), origin));
            memset(found->added, 0, sizeof found->added);
            if (found->alike)
                store(found->differences, subtract(load(weights), load(here)));
            w->varies = w->varies || !found->alike || memcmp(weights, here, slots * sizeof *here) != 0;
        }
        for (size_t n = some; n < AT_ONCE; n++)
            edges[n] = edges[0];
        turn_rows(edges, c->edges + 3 * end);
    }
    w->neighbours = count;
}

/* Sums over some corners of a class: the weights of both means, and the normals and sizes of the triangles. */
typedef struct {
    double weight;
    Four root_weight, normal[3], area;
} CornerSums;

/* Add what some corners say to the neighbours at their ends, and to the sums. The derivatives that the fit follows
   are means with the weights ROOT of corner.py: 1 / (|e1| |e2|)^1.5 times A2. */
static ALWAYS_INLINE void add_corners(const Surface *s, Corners *c, size_t some, const Vector tangents[2],
                                      CornerSums *sums)
{
    static const double present[AT_ONCE][AT_ONCE] = {{1, 0, 0, 0}, {1, 1, 0, 0}, {1, 1, 1, 0}, {1, 1, 1, 1}};
    Facets facets;
    weigh_corners(c, s->weighting, &facets);
    const Four there = load(present[some < AT_ONCE ? some - 1 : AT_ONCE - 1]);
    const Four length = root(facets.lengths), half_root = root(length);
    /* The weight of the root over that of the bake: with Max's weights, the root of |e1| |e2|. */
    const Four share = load(c->share), rooted = divide(facets.area, multiply(length, half_root));
    const Four factor = s->weighting == BY_MAX ? half_root : divide(rooted, share);
    sums->root_weight = add(sums->root_weight, multiply(there, multiply(factor, share)));
    sums->area = add(sums->area, multiply(there, facets.area));
    for (int axis = 0; axis < 3; axis++)
        sums->normal[axis] = add(sums->normal[axis], multiply(there, facets.normal[axis]));
    for (size_t n = 0; n < some; n++)
        sums->weight += c->share[n];
    for (int end = 0; end < 2; end++) {
        const double(*component)[AT_ONCE] = c->coefficients + 3 * end;
        Four numbers[ADDED] = {load(component[X1]), load(component[Y1]), load(component[Z1])};
        for (int n = 0; n < 2; n++)
            numbers[ALONG + n] = multiply(factor, add(add(multiply(numbers[0], all(tangents[n].x)),
                                                          multiply(numbers[1], all(tangents[n].y))),
                                                      multiply(numbers[2], all(tangents[n].z))));
        numbers[ADDED - 1] = all(0.0);
        double by_corner[AT_ONCE][ADDED];
        turn_over(numbers, by_corner);
        for (size_t n = 0; n < some; n++) {
            double *sum = c->neighbours[end][n]->added;
            store(sum, add(load(sum), load(by_corner[n])));
            store_pair(sum + AT_ONCE, add_pairs(load_pair(sum + AT_ONCE), load_pair(by_corner[n] + AT_ONCE)));
        }
    }
}

/* What a neighbour adds to the turns of a joint, times the difference of the joint's weight: the edge times its
   coefficient along each tangent, by axis, then both coefficients. find_turn makes a turn of the sums. */
enum { BY_EDGE = 0, BY_ITSELF = 6, PRODUCTS = 8 };

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
    const double *by = neighbour->added + GRADIENT;
    const int32_t before = used;
    used = add_differences(s, neighbour->vertex, (Vector){by[0], by[1], by[2]}, used, w);
    for (int32_t n = before; n < used; n++)
        memset(w->turns + n * TURN, 0, TURN * sizeof *w->turns);
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
    const Vectors by_a = twice(one_of(edges, 0)), by_b = twice(one_of(edges, 1));
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

/* The rest of the frame, from the sums over the corners and over the ring. */
static ALWAYS_INLINE void end_frame(const Surface *s, const CornerSums *sums, Vectors derivatives, double shrink,
                                    RingFrame *f)
{
    const Vector facing = sums_of(sums->normal);
    const double alignment = sqrt(dot(facing, facing)) / sum_of(sums->area);
    f->doubt = doubt_of(s, alignment);
    f->sound &= alignment > s->fit.flat;
    const Vector means[2] = {times(one_of(derivatives, 0), shrink), times(one_of(derivatives, 1), shrink)};
    find_leverage(f, means, s->fit.flat);
}

/* Add gradients and products over the ring of a class for every joint met. Return the number of local numbers in
   use, and the sums of the derivatives of the positions. */
static ALWAYS_INLINE int32_t sum_ring(const Surface *s, Shape shape, int32_t used, Vectors *derivatives, Scratch *w)
{
    const size_t slots = shape.slots;
    const Four none = all(0.0);
    Four gradients[3] = {none, none, none}, sums[AT_ONCE][PRODUCTS / AT_ONCE]; /* of the usual four slots */
    memset(w->turns, 0, (size_t)used * TURN * sizeof *w->turns);
    *derivatives = twice((Vector){0.0, 0.0, 0.0});
    for (int k = 0; k < AT_ONCE; k++)
        for (int m = 0; m < PRODUCTS / AT_ONCE; m++)
            sums[k][m] = none;
    for (size_t n = 0; n < w->neighbours; n++) {
        const Neighbour *neighbour = &w->ring[n];
        const Pair along = load_pair(neighbour->added + ALONG);
        const double *edge = neighbour->edge;
        const Vectors product = {scaled(edge[0], along), scaled(edge[1], along), scaled(edge[2], along)};
        *derivatives = plus_each(*derivatives, product);
        const Four products[PRODUCTS / AT_ONCE] = {join(product.x, product.y), join(product.z, along)};
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
    CornerSums sums = {0.0, none, {none, none, none}, none};
    Vectors derivatives;
    begin_frame(s, corners, vertices, w);
    for (size_t from = 0; from < corners.count; from += AT_ONCE) {
        size_t some = corners.count - from < AT_ONCE ? corners.count - from : AT_ONCE;
        add_corners(s, w->corners + from / AT_ONCE, some, f->tangents, &sums);
    }
    used = sum_ring(s, shape, used, &derivatives, w);
    const double shrink = 1.0 / sum_of(sums.root_weight);
    end_frame(s, &sums, derivatives, shrink, f);
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
        Corners c;
        find_ends(s, some, &c, w);
        find_edges(s, shape, origin, some, &c);
        weigh_corners(&c, s->weighting, NULL);
        for (size_t n = 0; n < some.count; n++)
            for (int end = 0; end < 2; end++) {
                const size_t there = c.ends[n][end];
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
        for (size_t n = 0; n < some.count; n++)
            *total += c.share[n];
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
    w->neighbours = 0, w->varies = 0;
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
    int32_t used = (int32_t)slots;
    for (size_t k = 0; k < slots; k++) {
        const int32_t joint = joints[k];
        w->met[k] = (size_t)(uint32_t)joint < (size_t)s->joint_count ? joint : NO_JOINT;
        w->own[k] = s->weights[vertex * slots + k];
        w->x[k] = w->y[k] = w->z[k] = 0.0;
        if (w->met[k] >= 0)
            w->local[w->met[k]] = (int32_t)k;
    }
    *total = 1.0;
    if (!shape.fits || corners.count > MOST_CORNERS)
        used = sum_gradients(s, shape, corners, vertex, used, total, w);
    else if (find_ring(s, shape, corners, vertex, w))
        used = sum_turns(s, shape, corners, vertices, used, total, w);
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
    size_t turnings; /* joints that turn */
    int32_t used;    /* local numbers */
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

/* The frame of Duff et al. 2017 around a unit normal, in float32 and in this order of operations: shaders get the
   same bits (twin: frames.frame_from_normal). */
static ALWAYS_INLINE void frame_from_unit(Vector normal, Vector *tangent, Vector *bitangent)
{
    float x = (float)normal.x, y = (float)normal.y, z = (float)normal.z;
    float sign = z >= 0.0f ? 1.0f : -1.0f;
    float a = -1.0f / (sign + z);
    float b = (x * y) * a;
    float along = 1.0f + sign * ((x * x) * a), across = sign + (y * y) * a;
    *tangent = (Vector){along, sign * b, -sign * x};
    *bitangent = (Vector){b, across, -y};
}

/* The tangent and the bitangent of a vertex. */
static ALWAYS_INLINE void find_frame(const Surface *s, size_t vertex, Latest *latest, Vector *tangent,
                                     Vector *bitangent)
{
    if (s->tangents) {
        *tangent = row3(s->tangents, s->wide_frame, vertex);
        *bitangent = row3(s->bitangents, s->wide_frame, vertex);
    } else {
        frame_from_unit(unit_of(s, vertex, latest), tangent, bitangent);
    }
}

/* A number as it is stored. A zero has no sign, so that arrays of equal numbers have equal bits. */
static ALWAYS_INLINE float stored(double value) { return (float)value + 0.0f; }

/* The slots that a vertex's gradients go to: by `named`, or by the local numbers. The local numbers hold for a
   class's first vertex if it adopts nothing. */
typedef enum { AS_NAMED, AS_NUMBERED } Placing;

/* Write alpha and beta of one vertex. Return the magnitude that its slots do not hold. */
static ALWAYS_INLINE double project(const Surface *s, size_t slots, size_t vertex, size_t entries, Placing placing,
                                    const Baked *out, Scratch *w)
{
    Vector t, b;
    find_frame(s, vertex, &w->latest, &t, &b);
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
            alpha[slot - 1] = stored(dot(entry->gradient, t));
            beta[slot - 1] = stored(dot(entry->gradient, b));
        }
    }
    return unheld;
}

/* ---- Fitting one vertex (twin: rig_fit.fitted) --------------------------------------------------------- */

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
    Node *node = node_of(s, joint, w->room + w->way.spares, w);
    w->way.spares += w->node_count - before;
    return node;
}

static void close_nodes(const Surface *s, Scratch *w)
{
    for (size_t n = 0; n < w->node_count; n++)
        w->node_of[w->nodes[n].joint == NO_JOINT ? s->joint_count : w->nodes[n].joint] = -1;
    w->node_count = 0;
}

/* Whether a turn is anything but zeros. Their bits are zeros but for the sign. */
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

/* List the joints around a class that turn. Tell whether the way begins with them. Return their number. */
static ALWAYS_INLINE size_t find_turning(int32_t used, Scratch *w)
{
    const Way *way = &w->way;
    size_t count = 0;
    int known = 1;
    for (int32_t n = 0; n < used; n++)
        if (w->met[n] >= 0 && turns_at_all(w->turns + n * TURN)) {
            known = known && count < way->turnings && way->numbers[count] == n && way->turning[count] == w->met[n];
            w->turning[count++] = n;
        }
    w->known_turnings = known && count == way->turnings;
    return count;
}

/* The slots of a vertex that are fitted. The last of them takes what the others, the unknowns, leave. */
typedef struct {
    size_t unknowns;
    size_t slots[MOST_FITTED];
    int32_t joints[MOST_FITTED];
    double presence[MOST_FITTED]; /* the weight and the share of the gradient of each slot's joint, added */
    Pair given[MOST_FITTED];      /* the surface's gradients along the class's tangents */
    double stiffness;             /* the share of a turn's squared lever that pulls to the surface's gradients */
    double reach;                 /* the squared levers of all turns that part the slots, added */
    double tilts; /* the squared tilts that these turns by a radian give to both tangents, added */
} Fitted;

/* Choose the slots to fit, by the presence of their joints. Returns 0 where there are too few or too many. */
static ALWAYS_INLINE int choose_slots(const Surface *s, size_t slots, size_t vertex, const Scratch *w, Fitted *fitted)
{
    const double *weights = s->weights + vertex * slots;
    const int32_t *joints = s->joints + vertex * slots;
    size_t count = 0;
    for (size_t k = 0; k < slots; k++) {
        const int32_t joint = w->named[k];
        if ((size_t)(uint32_t)joint >= (size_t)s->joint_count)
            continue;
        double presence = w->shares[k] + (joints[k] == joint ? weights[k] : 0.0);
        if (!(presence > s->fit.unfelt))
            continue;
        if (count == MOST_FITTED)
            return 0;
        fitted->given[count] = dots(twice(w->gradients[k]), w->frame.along);
        fitted->presence[count] = presence;
        fitted->joints[count] = joint;
        fitted->slots[count++] = k;
    }
    fitted->unknowns = count - 1;
    fitted->reach = fitted->tilts = 0.0;
    return count >= 2;
}

/* The turn of a node. It parts the slots if it moves some against the last one, about a pivot. */
static Climb climb_from(const Surface *s, const Node *node, size_t unknowns)
{
    const double *pivot = s->pivots + 3 * (size_t)node->joint;
    Climb climb = {.pivot = {pivot[0], pivot[1], pivot[2]}, .members = node->members};
    climb.chain = s->chains[node->joint];
    /* Where it carries the last slot it moves the others the other way. */
    int carries = node->members >> unknowns & 1;
    climb.sign = carries ? -1.0 : 1.0;
    climb.moved = (carries ? ~node->members : node->members) & ((UINT64_C(1) << unknowns) - 1);
    climb.parts = climb.moved && isfinite(climb.pivot[0]) && isfinite(climb.pivot[1]) && isfinite(climb.pivot[2]);
    return climb;
}

/* Go through all joints whose turns part the joints around a vertex, from the lowest up. Returns 0 where there are
   too many. */
static int climb_up(const Surface *s, Scratch *w)
{
    Way *way = &w->way;
    size_t left = w->node_count;
    for (int turn = 0; left > 1; turn++) {
        Node *lowest = NULL;
        for (size_t n = 0; n < w->node_count; n++)
            if (!w->nodes[n].done && w->nodes[n].joint != NO_JOINT &&
                (lowest == NULL || w->nodes[n].rank > lowest->rank))
                lowest = &w->nodes[n];
        if (lowest == NULL || turn == MOST_TURNS)
            return 0;
        Climb *climb = &way->climb[way->climbs++];
        *climb = climb_from(s, lowest, way->fittings - 1);
        int32_t parent = s->parents[lowest->joint], rank = lowest->rank;
        if (parent < 0 || parent >= s->joint_count || s->ranks[parent] >= rank)
            parent = NO_JOINT;
        lowest->done = 1;
        size_t before = w->node_count;
        Node *above = spare_node_of(s, parent, w);
        left -= w->node_count == before;
        above->members |= lowest->members;
        climb->node = lowest->row, climb->above = above->row;
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
    for (size_t n = 0; n < turnings; n++) {
        size_t row = (size_t)(way->numbers[n] = w->turning[n]);
        way->turning[n] = w->met[row];
        Node *node = node_of(s, way->turning[n], row, w);
        if (node->row != row) /* two slots have the same joint */
            way->climb[way->climbs++] = (Climb){.node = row, .above = node->row};
    }
    for (size_t i = 0; i < way->fittings; i++) {
        way->fitted[i] = fitted->joints[i];
        spare_node_of(s, fitted->joints[i], w)->members |= UINT64_C(1) << i;
    }
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
        same = way->fitted[i] == fitted->joints[i];
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
static ALWAYS_INLINE void add_turn(Vector position, const Climb *climb, const double turn[TURN],
                                   const RingFrame *frame, Fitted *fitted, Equations e, Curl *curls)
{
    const Vector lever = minus(position, (Vector){climb->pivot[0], climb->pivot[1], climb->pivot[2]});
    const Vector tilt = cross(lever, frame->normal);
    const double squared_lever = dot(lever, lever), square = dot(tilt, tilt);
    const double pull = fitted->stiffness * squared_lever;
    const Vectors arms = load_vectors(turn + ARMS), spins = load_vectors(turn + SPINS);
    const Vectors wanted = plus_each(crosses(twice(lever), arms), spins);
    const Pair aims = dots(twice(tilt), wanted);
    Pair carried = both(0.0);
    for (size_t i = 0; i <= e.unknowns; i++)
        carried = add_pairs(carried, scaled(bit_of(climb->members, i, e.unknowns), fitted->given[i]));
    const Pair off = subtract_pairs(scaled(square, carried), aims), squared_off = multiply_pairs(off, off);
    fitted->tilts += square > 0.0 ? (part(squared_off, 0) + part(squared_off, 1)) / square : 0.0;
    fitted->reach += squared_lever;
    const Pair right = scaled(climb->sign, add_pairs(aims, scaled(pull, carried)));
    for (size_t i = 0; i < e.unknowns; i++) {
        const double mask = bit_of(climb->moved, i, e.unknowns);
        e.right[i] = add_pairs(e.right[i], scaled(mask, right));
        for (size_t k = 0; k <= i; k++)
            e.matrix[i * e.stride + k] += mask * bit_of(climb->moved, k, e.unknowns) * (square + pull);
    }
    if (climb->curl) {
        Curl *curl = &curls[climb->curl - 1];
        curl->wanted = plus_each(curl->wanted, wanted);
        for (size_t i = 0; i < e.unknowns; i++)
            curl->moved[i] = plus(curl->moved[i], times(tilt, climb->sign * bit_of(climb->moved, i, e.unknowns)));
    }
}

/* Add what the curls say to the normal equations of the slots. */
static ALWAYS_INLINE void add_curls(const Surface *s, const Curl *curls, size_t count, Equations e)
{
    for (const Curl *curl = curls; curl < curls + count; curl++)
        for (size_t i = 0; i < e.unknowns; i++) {
            const Vector moved = times(curl->moved[i], s->fit.together);
            e.right[i] = add_pairs(e.right[i], dots(twice(moved), curl->wanted));
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
    memset(w->turns + w->room * TURN, 0, way->spares * TURN * sizeof *w->turns);
    memset(w->curls, 0, way->curls * sizeof *w->curls);
    for (size_t n = 0; n < way->climbs; n++) {
        const Climb *climb = &way->climb[n];
        const double *turn = w->turns + climb->node * TURN;
        double *above = w->turns + climb->above * TURN;
        if (climb->parts)
            add_turn(position, climb, turn, &w->frame, fitted, e, w->curls);
        for (int m = 0; m < TURN; m += AT_ONCE)
            store(above + m, add(load(above + m), load(turn + m)));
    }
    add_curls(s, w->curls, way->curls, e);
}

/* Solve the normal equations, by the factors L D Lt in place of the matrix. The right side becomes the solution.
   Returns 0 where it is not finite. */
static ALWAYS_INLINE int solve(Equations e)
{
    Pair finite = both(0.0);
    for (size_t i = 0; i < e.unknowns; i++) {
        double *row = e.matrix + i * e.stride, diagonal = row[i];
        for (size_t k = 1; k < i; k++) /* row[k] is L[i][k] D[k] until the row is done */
            for (size_t n = 0; n < k; n++)
                row[k] -= row[n] * e.matrix[k * e.stride + n];
        for (size_t k = 0; k < i; k++) {
            double factor = row[k] * e.matrix[k * e.stride + k]; /* the diagonal holds 1 / D */
            diagonal -= factor * row[k];
            row[k] = factor;
            e.right[i] = subtract_pairs(e.right[i], scaled(factor, e.right[k]));
        }
        row[i] = 1.0 / diagonal;
    }
    for (size_t i = e.unknowns; i-- > 0;) {
        e.right[i] = scaled(e.matrix[i * e.stride + i], e.right[i]);
        for (size_t n = i + 1; n < e.unknowns; n++)
            e.right[i] = subtract_pairs(e.right[i], scaled(e.matrix[n * e.stride + i], e.right[n]));
        finite = add_pairs(finite, scaled(0.0, e.right[i]));
    }
    return part(finite, 0) + part(finite, 1) == 0.0;
}

/* The pull of one slot to its gradient. It is strong where the joint is hardly there. */
static ALWAYS_INLINE double pull_of(const Surface *s, const Fitted *fitted, size_t slot)
{
    double faint = s->fit.faint / fitted->presence[slot], more = faint > 1.0 ? faint * faint - 1.0 : 0.0;
    return fitted->stiffness * fitted->reach * (s->fit.even + more);
}

/* Move the gradients of the fitted slots, in the plane of the class's tangents, to the solution of the least
   squares. */
static ALWAYS_INLINE void move_gradients(const Surface *s, const Fitted *fitted, Equations e, Scratch *w)
{
    const Vector *tangents = w->frame.tangents;
    const size_t unknowns = e.unknowns;
    double last = pull_of(s, fitted, unknowns);
    for (size_t i = 0; i < unknowns; i++) {
        double pull = pull_of(s, fitted, i);
        for (size_t k = 0; k <= i; k++)
            e.matrix[i * e.stride + k] += k == i ? last + pull : last;
        e.right[i] = add_pairs(
            e.right[i], subtract_pairs(scaled(pull, fitted->given[i]), scaled(last, fitted->given[unknowns])));
    }
    if (!solve(e))
        return;
    double share = fitted->tilts / (fitted->tilts + w->frame.doubt * w->frame.doubt);
    e.right[unknowns] = both(0.0);
    for (size_t i = 0; i < unknowns; i++)
        e.right[unknowns] = subtract_pairs(e.right[unknowns], e.right[i]);
    for (size_t i = 0; i <= unknowns; i++) {
        Vector *gradient = &w->gradients[fitted->slots[i]];
        Pair by = scaled(share, subtract_pairs(e.right[i], fitted->given[i]));
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
    if (fitted->reach > 0.0 && isfinite(fitted->tilts)) /* where levers are very long the tilts overflow */
        move_gradients(s, fitted, e, w);
}

/* Fit the gradients by slot of one vertex to the rig. `missing` is the share of the gradients whose joints have no
   slot. */
FOR_PROCESSORS
static void fit_vertex(const Surface *s, size_t vertex, size_t turnings, double missing, const Vector *position,
                       Scratch *w)
{
    Fitted fitted;
    fitted.stiffness = s->fit.stiffness * (1.0 + s->fit.missing * missing);
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
    if (w->frame.sound) {
        const Vector position = row3(s->positions, shape.wide, vertex);
        const size_t size = (size_t)found->used * TURN * sizeof *w->turns;
        if (!last)
            memcpy(w->kept, w->turns, size);
        fit_vertex(s, vertex, found->turnings, unheld * whole, &position, w);
        if (!last)
            memcpy(w->turns, w->kept, size);
    }
    for (size_t k = 1; k < slots; k++) {
        out->alpha[vertex * (slots - 1) + k - 1] = stored(dot(w->gradients[k], t));
        out->beta[vertex * (slots - 1) + k - 1] = stored(dot(w->gradients[k], b));
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
    if (corners.count == 0)
        return found;
    double total;
    int32_t used = sum_corners(s, shape, corners, vertices, &work->scratch, &total);
    found.used = used;
    found.turnings = work->scratch.frame.sound ? find_turning(used, &work->scratch) : 0;
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

/* Write all results of one vertex of a class. */
static ALWAYS_INLINE void write_vertex(Work *work, Shape shape, size_t vertex, Placing placing, int last,
                                       const ClassGradients *found)
{
    const Surface *s = work->surface;
    const Baked *out = work->out;
    Scratch *w = &work->scratch;
    Sums *sums = out->sums + primitive_of(out, vertex);
    if (placing == AS_NAMED)
        sums->adopting += name_slots(s, vertex, found, w, out->adopted + vertex * shape.slots);
    sums->magnitude += found->magnitude;
    sums->unheld += shape.fits ? project_fitted(s, shape, vertex, last, found, out, w)
                               : project(s, shape.slots, vertex, found->entries, placing, out, w);
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
        Members own = {&itself, 1};
        if (vertices->start)
            own = (Members){vertices->members + vertices->start[c], vertices->start[c + 1] - vertices->start[c]};
        if (own.count == 0)
            continue;
        Members around = {corners->members + corners->start[c], corners->start[c + 1] - corners->start[c]};
        ClassGradients found = find_gradients(work, shape, around, own);
        for (size_t n = 0; n < own.count; n++) {
            int adopts_nothing = found.foreign == 0 || found.capacity == 0;
            Placing placing = n == 0 && adopts_nothing && !shape.fits ? AS_NUMBERED : AS_NAMED;
            write_vertex(work, shape, own.first[n], placing, n + 1 == own.count, &found);
        }
    }
    return work->scratch.stray ? STRAY_INDEX : DONE;
}

/* Copies of the loop for the usual cases. They need not check types and counts for each vertex. */
FOR_PROCESSORS
static Status bake_all_classes(Work *work)
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
    int32_t largest = 0;
    for (Py_ssize_t n = 0; n < s->vertices * s->slots; n++) {
        largest = s->joints[n] > largest ? s->joints[n] : largest;
        if (s->joints[n] < 0 && s->weights[n] != 0.0) {
            PyErr_SetString(PyExc_ValueError, "a slot without a joint has a weight");
            return -1;
        }
    }
    s->joint_count = (Py_ssize_t)largest + 1;
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
    s->joint_count = s->parents ? s->rig_joints : s->joint_count;
    if (s->joint_count > INT32_MAX - s->slots) { /* local numbers count both */
        PyErr_SetString(PyExc_ValueError, "too many joints for one surface");
        return -1;
    }
    return 0;
}

enum { POSITIONS, TRIANGLES, JOINTS, WEIGHTS, UNUSED, CLASSES, NORMALS, TANGENTS, BITANGENTS, ALPHA, BETA, ADOPTED,
       ENDS, SUMS, PARENTS, RANKS, PIVOTS, CHAINS, ARRAYS };

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
    [PARENTS] = {"parents", "i", AXIS_J, AXIS_1, READ},
    [RANKS] = {"ranks", "i", AXIS_J, AXIS_1, READ},
    [PIVOTS] = {"pivots", "d", AXIS_J, AXIS_3, READ},
    [CHAINS] = {"chains", "i", AXIS_J, AXIS_1, READ},
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
                            "chains", "class_count", "weighting", "adopts", "negligible", "missing", "stiffness",
                            "together", "doubt", "smooth", "most_doubt", "even", "faint", "unfelt", "flat",
                            "grouped", "first", "last", NULL};
    PyObject *o[ARRAYS];
    Py_ssize_t class_count;
    int weighting, adopts;
    double negligible;
    FitSettings fit;
    if (!PyArg_ParseTupleAndKeywords(args, keywords, "$OOOOOOOOOOOOOOOOOOnipdddddddddddOnn", names,
                                     &o[POSITIONS], &o[TRIANGLES], &o[JOINTS], &o[WEIGHTS], &o[UNUSED], &o[CLASSES], &o[NORMALS], &o[TANGENTS],
                                     &o[BITANGENTS], &o[ALPHA], &o[BETA], &o[ADOPTED], &o[ENDS], &o[SUMS],
                                     &o[PARENTS], &o[RANKS], &o[PIVOTS], &o[CHAINS], &class_count, &weighting, &adopts,
                                     &negligible, &fit.missing, &fit.stiffness, &fit.together, &fit.doubt,
                                     &fit.smooth, &fit.most_doubt, &fit.even, &fit.faint, &fit.unfelt, &fit.flat,
                                     &part->grouped, &part->first, &part->last))
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
        .parents = a[PARENTS].rows ? a[PARENTS].buffer.buf : NULL,
        .ranks = a[RANKS].buffer.buf,
        .pivots = a[PIVOTS].buffer.buf,
        .chains = a[CHAINS].buffer.buf,
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

/* ---- The module ---------------------------------------------------------------------------------------- */

static PyMethodDef functions[] = {
    {"label_equal_rows", label_equal_rows, METH_VARARGS,
     "label_equal_rows(rows, labels): fill labels, return how many there are."},
    {"normalise_influences", normalise_influences, METH_VARARGS,
     "normalise_influences(joints, weights, free, adopting_sum, tolerance, least): in place; return the defects by name."},
    {"mark_proper", mark_proper, METH_VARARGS, "mark_proper(positions, triangles, mask, least): fill mask."},
    {"group_surface", group_surface, METH_VARARGS,
     "group_surface(triangles, joints, weights, classes, class_count): return the groups, for bake_surface."},
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
