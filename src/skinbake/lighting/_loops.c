/* The loops of `skinbake verify` that visit every vertex in every pose, for arrays that numpy owns.

   Each function has a twin in by_numpy.py. The twin is the definition, the oracle of the tests, and the code
   that runs if this module could not be compiled. This file shares neither code nor formulas with
   gradients/_kernel.c, because an error in one must not hide in both.

   Arrays come in through the buffer protocol: contiguous, aligned, of the types that _loops.pyi says. V are
   vertices, P are poses. All values of a vertex lie together, pose by pose, so that the innermost loops run
   over poses, and compilers turn them into vectors. A function works on a range of vertices or classes, and
   writes to that range alone. The GIL is released meanwhile, so several threads can share a mesh. Every index
   is checked just before it is used.

   Only the limited API of Python 3.11 is used. Compile without fast-math and without contraction to fused
   multiply-adds: the same input gives the same bytes on every machine. */

#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030B0000
#include <Python.h>

#include <float.h>
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#if defined(_MSC_VER)
#define ALWAYS_INLINE __forceinline
#else
#define ALWAYS_INLINE inline __attribute__((always_inline))
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

/* ---- Arguments ----------------------------------------------------------------------------------------- */

/* What an argument must be. kinds: f d floats, i int32, q int64, ? bytes. shape: a digit is a size, a letter
   is an axis, which has one size in all arrays of a call. */
typedef struct {
    const char *name, *kinds, *shape;
    int flags;
} Requirement;

enum { READ = 0, WRITTEN = 1, OR_NONE = 2 };

typedef struct {
    Py_buffer buffer;
    int held;
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
    case 'f': case 'd': case '?':
        return format[0];
    case 'i': case 'l': case 'q':
        return buffer->itemsize == 4 ? 'i' : 'q';
    }
    return 0;
}

/* Hold the shape of an array against the sizes of axes that are known so far. */
static int check_shape(const Requirement *required, const Py_buffer *buffer, Py_ssize_t *sizes)
{
    if ((size_t)buffer->ndim != strlen(required->shape)) {
        PyErr_Format(PyExc_ValueError, "%s has %d axes, not %s", required->name, buffer->ndim, required->shape);
        return -1;
    }
    for (int n = 0; n < buffer->ndim; n++) {
        char axis = required->shape[n];
        Py_ssize_t *known = &sizes[axis >= 'A' ? axis - 'A' : 0];
        Py_ssize_t wanted = axis >= 'A' ? *known : axis - '0';
        if (wanted < 0)
            *known = wanted = buffer->shape[n];
        if (buffer->shape[n] != wanted) {
            PyErr_Format(PyExc_ValueError, "axis %d of %s has the size %zd, not %zd", n, required->name,
                         buffer->shape[n], wanted);
            return -1;
        }
    }
    return 0;
}

static int read_array(PyObject *object, const Requirement *required, Array *array, Py_ssize_t *sizes)
{
    if (object == Py_None && required->flags & OR_NONE)
        return 0;
    int flags = PyBUF_C_CONTIGUOUS | PyBUF_FORMAT | (required->flags & WRITTEN ? PyBUF_WRITABLE : 0);
    if (PyObject_GetBuffer(object, &array->buffer, flags) < 0)
        return -1;
    array->held = 1;
    char kind = kind_of(&array->buffer);
    if (kind == 0 || strchr(required->kinds, kind) == NULL) {
        PyErr_Format(PyExc_TypeError, "%s has elements of type %s", required->name, array->buffer.format);
        return -1;
    }
    if ((uintptr_t)array->buffer.buf % (uintptr_t)array->buffer.itemsize) {
        PyErr_Format(PyExc_ValueError, "%s is not aligned", required->name);
        return -1;
    }
    return check_shape(required, &array->buffer, sizes);
}

/* Hold the arguments of a call, and fill in the sizes of the axes by letter. */
static int read_arrays(PyObject *const *objects, const Requirement *required, int count, Array *arrays,
                       Py_ssize_t sizes[26])
{
    for (int n = 0; n < 26; n++)
        sizes[n] = -1;
    for (int n = 0; n < count; n++)
        if (read_array(objects[n], &required[n], &arrays[n], sizes) < 0)
            return -1;
    return 0;
}

#define SIZE(letter) sizes[(letter) - 'A']
#define DATA(n) (a[n].held ? a[n].buffer.buf : NULL)

/* Return None, or raise IndexError if a loop met an index of nothing. Loops run without the GIL and cannot. */
static PyObject *none_unless(int stray)
{
    if (!stray)
        return Py_NewRef(Py_None);
    PyErr_SetString(PyExc_IndexError, "an index names what is not there");
    return NULL;
}

/* ---- Vectors ------------------------------------------------------------------------------------------- */

/* The poses in work at a time. Their temporaries stay in the processor's first cache. */
enum { STRIP = 64 };

typedef double Strip[STRIP];

typedef struct {
    double x, y, z;
} Vector;

static ALWAYS_INLINE double dot(Vector a, Vector b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static ALWAYS_INLINE Vector minus(Vector a, Vector b) { return (Vector){a.x - b.x, a.y - b.y, a.z - b.z}; }
static ALWAYS_INLINE Vector scaled(double s, Vector a) { return (Vector){s * a.x, s * a.y, s * a.z}; }
static ALWAYS_INLINE Vector cross(Vector a, Vector b)
{
    return (Vector){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

/* An array of vectors by components: x, y and z each with the values of all poses of a vertex. */
typedef struct {
    const double *x, *y, *z;
} Components;

static ALWAYS_INLINE Components components(const double *base, Py_ssize_t stride, Py_ssize_t at)
{
    return (Components){base + at, base + stride + at, base + 2 * stride + at};
}

static ALWAYS_INLINE Vector vector_at(Components from, Py_ssize_t p)
{
    return (Vector){from.x[p], from.y[p], from.z[p]};
}

static ALWAYS_INLINE Vector vertex_at(const double *positions, Py_ssize_t vertex)
{
    return (Vector){positions[3 * vertex], positions[3 * vertex + 1], positions[3 * vertex + 2]};
}

static ALWAYS_INLINE Py_ssize_t least(Py_ssize_t a, Py_ssize_t b) { return a < b ? a : b; }

/* ---- Linear combinations of rows ----------------------------------------------------------------------- */

/* Four doubles at once. Every operation rounds as it does on one of them. */
#if defined(__GNUC__)
typedef double Four __attribute__((vector_size(32)));
static ALWAYS_INLINE Four plus_scaled(Four sum, double factor, Four values)
{
    return sum + (Four){factor, factor, factor, factor} * values;
}
#else
typedef struct {
    double of[4];
} Four;
static ALWAYS_INLINE Four plus_scaled(Four sum, double factor, Four values)
{
    for (int n = 0; n < 4; n++)
        sum.of[n] += factor * values.of[n];
    return sum;
}
#endif

static ALWAYS_INLINE Four load(const double *from)
{
    Four values;
    memcpy(&values, from, sizeof values);
    return values;
}

/* Rows of vectors by components: vector `row` of pose `p` has its component at row × stride + p, and the
   next component `apart` further on. */
typedef struct {
    const double *base;
    Py_ssize_t count, stride, apart;
} Table;

typedef struct {
    Strip x, y, z;
} Strips;

/* Write Σ factor × row in some poses, by so many fours, to strips at `p`. The sums stay in registers. */
static ALWAYS_INLINE void combine_fours(const Table *table, const double *factors, const int32_t *rows,
                                        Py_ssize_t count, Py_ssize_t first, Py_ssize_t p, int fours, Strips *out)
{
    Four x[2], y[2], z[2];
    memset(x, 0, sizeof x), memset(y, 0, sizeof y), memset(z, 0, sizeof z);
    for (Py_ssize_t k = 0; k < count; k++) {
        const double *from = table->base + rows[k] * table->stride + first + p;
        for (int n = 0; n < fours; n++) {
            x[n] = plus_scaled(x[n], factors[k], load(from + 4 * n));
            y[n] = plus_scaled(y[n], factors[k], load(from + table->apart + 4 * n));
            z[n] = plus_scaled(z[n], factors[k], load(from + 2 * table->apart + 4 * n));
        }
    }
    const size_t size = (size_t)fours * sizeof(Four);
    memcpy(out->x + p, x, size), memcpy(out->y + p, y, size), memcpy(out->z + p, z, size);
}

/* Write Σ factor × row of a table in up to STRIP poses. All rows are in the table. */
static ALWAYS_INLINE void combine(const Table *table, const double *factors, const int32_t *rows, Py_ssize_t count,
                                  Py_ssize_t first, Py_ssize_t poses, Strips *out)
{
    Py_ssize_t p = 0;
    for (; p + 8 <= poses; p += 8)
        combine_fours(table, factors, rows, count, first, p, 2, out);
    for (; p + 4 <= poses; p += 4)
        combine_fours(table, factors, rows, count, first, p, 1, out);
    for (; p < poses; p++) {
        double x = 0.0, y = 0.0, z = 0.0;
        for (Py_ssize_t k = 0; k < count; k++) {
            const double *from = table->base + rows[k] * table->stride + first + p;
            x += factors[k] * from[0], y += factors[k] * from[table->apart], z += factors[k] * from[2 * table->apart];
        }
        out->x[p] = x, out->y[p] = y, out->z[p] = z;
    }
}

/* The entries of a row that are copied and checked at a time. */
enum { WIDEST = 64 };

/* Take up to WIDEST entries that are not 0, and check them. Return how many were looked at, −1 if a row is not in
   the table. */
static ALWAYS_INLINE Py_ssize_t take_entries(const Table *table, const double *values, const int32_t *columns,
                                             Py_ssize_t count, double *factors, int32_t *rows, Py_ssize_t *taken)
{
    Py_ssize_t looked = 0;
    for (*taken = 0; looked < count && *taken < WIDEST; looked++) {
        const double factor = values[looked];
        const int32_t row = columns[looked];
        if (row < 0 || row >= table->count)
            return -1;
        if (factor != 0.0)
            factors[*taken] = factor, rows[(*taken)++] = row;
    }
    return looked;
}

/* Write Σ value × row of a table in up to STRIP poses, for any number of entries. Return 1 for a stray row. */
static ALWAYS_INLINE int combine_entries(const Table *table, const double *values, const int32_t *columns,
                                         Py_ssize_t count, Py_ssize_t first, Py_ssize_t poses, Strips *out)
{
    double factors[WIDEST];
    int32_t rows[WIDEST];
    Py_ssize_t taken, looked = take_entries(table, values, columns, count, factors, rows, &taken);
    if (looked < 0)
        return 1;
    combine(table, factors, rows, taken, first, poses, out);
    for (Py_ssize_t done = looked; done < count; done += looked) {
        Strips more;
        looked = take_entries(table, values + done, columns + done, count - done, factors, rows, &taken);
        if (looked < 0)
            return 1;
        combine(table, factors, rows, taken, first, poses, &more);
        for (Py_ssize_t p = 0; p < poses; p++)
            out->x[p] += more.x[p], out->y[p] += more.y[p], out->z[p] += more.z[p];
    }
    return 0;
}

static ALWAYS_INLINE void store_strips(const Strips *from, Py_ssize_t count, double *to, Py_ssize_t apart)
{
    memcpy(to, from->x, (size_t)count * sizeof(double));
    memcpy(to + apart, from->y, (size_t)count * sizeof(double));
    memcpy(to + 2 * apart, from->z, (size_t)count * sizeof(double));
}

/* ---- Linear blend skinning (twin: by_numpy.blend) ------------------------------------------------------ */

enum { ENTRIES, COLUMNS, TABLE, BLENDED, BLEND_ARRAYS };

static const Requirement blend_arrays[BLEND_ARRAYS] = {
    [ENTRIES] = {"entries", "d", "FBW", READ},
    [COLUMNS] = {"columns", "i", "BW", READ},
    [TABLE] = {"table", "d", "R3P", READ},
    [BLENDED] = {"out", "d", "F3BP", WRITTEN},
};

typedef struct {
    Table table;
    const double *entries;
    const int32_t *columns;
    double *out;
    Py_ssize_t forms, rows, width, poses;
} Blend;

FOR_PROCESSORS
static int blend_rows(const Blend *b)
{
    Strips found;
    for (Py_ssize_t form = 0; form < b->forms; form++)
        for (Py_ssize_t row = 0; row < b->rows; row++) {
            const double *entries = b->entries + (form * b->rows + row) * b->width;
            double *out = b->out + (3 * form * b->rows + row) * b->poses;
            for (Py_ssize_t first = 0; first < b->poses; first += STRIP) {
                const Py_ssize_t poses = least(STRIP, b->poses - first);
                const int32_t *columns = b->columns + row * b->width;
                if (combine_entries(&b->table, entries, columns, b->width, first, poses, &found))
                    return 1;
                store_strips(&found, poses, out + first, b->rows * b->poses);
            }
        }
    return 0;
}

static PyObject *blend(PyObject *Py_UNUSED(module), PyObject *args)
{
    PyObject *o[BLEND_ARRAYS], *result = NULL;
    Array a[BLEND_ARRAYS];
    Py_ssize_t sizes[26];
    memset(a, 0, sizeof a);
    if (!PyArg_ParseTuple(args, "OOOO", &o[ENTRIES], &o[COLUMNS], &o[TABLE], &o[BLENDED]))
        return NULL;
    if (read_arrays(o, blend_arrays, BLEND_ARRAYS, a, sizes) < 0)
        goto done;
    const Blend work = {
        .table = {DATA(TABLE), SIZE('R'), 3 * SIZE('P'), SIZE('P')},
        .entries = DATA(ENTRIES),
        .columns = DATA(COLUMNS),
        .out = DATA(BLENDED),
        .forms = SIZE('F'),
        .rows = SIZE('B'),
        .width = SIZE('W'),
        .poses = SIZE('P'),
    };
    int stray;
    Py_BEGIN_ALLOW_THREADS
    stray = blend_rows(&work);
    Py_END_ALLOW_THREADS
    result = none_unless(stray);
done:
    release_arrays(a, BLEND_ARRAYS);
    return result;
}

/* ---- Normals by linear blend skinning (twin: by_numpy.blended_normals) ---------------------------------- */

enum { FORM_ENTRIES, FORM_COLUMNS, FORM_TABLE, REST_NORMALS, BLENDED_NORMALS, FORM_ARRAYS };

static const Requirement form_arrays[FORM_ARRAYS] = {
    [FORM_ENTRIES] = {"entries", "d", "FBW", READ},
    [FORM_COLUMNS] = {"columns", "i", "BW", READ},
    [FORM_TABLE] = {"table", "d", "R3P", READ},
    [REST_NORMALS] = {"normals", "d", "B3", OR_NONE},
    [BLENDED_NORMALS] = {"out", "d", "3BP", WRITTEN},
};

typedef struct {
    Table table;
    const double *entries, *normals; /* normals: NULL for the cross product of two forms */
    const int32_t *columns;
    double *out;
    Py_ssize_t rows, width, poses;
} BlendNormals;

/* Return M⁻ᵀ n for a matrix given by its columns, or cof(M) n if det M is 0. */
static ALWAYS_INLINE Vector inverse_transposed(Vector a, Vector b, Vector c, Vector normal)
{
    const Vector first = {a.x, b.x, c.x}, second = {a.y, b.y, c.y}, third = {a.z, b.z, c.z};
    const Vector x = cross(second, third), y = cross(third, first), z = cross(first, second);
    const double determinant = dot(first, x);
    const Vector turned = {dot(x, normal), dot(y, normal), dot(z, normal)};
    return scaled(1.0 / (determinant == 0.0 ? 1.0 : determinant), turned);
}

static ALWAYS_INLINE Vector in_strips(const Strips *from, Py_ssize_t p)
{
    return (Vector){from->x[p], from->y[p], from->z[p]};
}

/* Write the normals of a vertex in up to STRIP poses to the first strips. Return 1 for a stray row. */
static ALWAYS_INLINE int normals_of_forms(const BlendNormals *b, Py_ssize_t row, Py_ssize_t first, Py_ssize_t poses,
                                          Strips *forms)
{
    const int32_t *columns = b->columns + row * b->width;
    for (Py_ssize_t form = 0; form < (b->normals ? 3 : 2); form++) {
        const double *entries = b->entries + (form * b->rows + row) * b->width;
        if (combine_entries(&b->table, entries, columns, b->width, first, poses, &forms[form]))
            return 1;
    }
    const Vector normal = b->normals ? vertex_at(b->normals, row) : (Vector){0.0, 0.0, 0.0};
    for (Py_ssize_t p = 0; p < poses; p++) {
        const Vector one = in_strips(&forms[0], p), other = in_strips(&forms[1], p);
        const Vector found =
            b->normals ? inverse_transposed(one, other, in_strips(&forms[2], p), normal) : cross(one, other);
        forms[0].x[p] = found.x, forms[0].y[p] = found.y, forms[0].z[p] = found.z;
    }
    return 0;
}

FOR_PROCESSORS
static int blend_normals_of_rows(const BlendNormals *b)
{
    Strips forms[3];
    for (Py_ssize_t row = 0; row < b->rows; row++)
        for (Py_ssize_t first = 0; first < b->poses; first += STRIP) {
            const Py_ssize_t poses = least(STRIP, b->poses - first);
            if (normals_of_forms(b, row, first, poses, forms))
                return 1;
            store_strips(&forms[0], poses, b->out + row * b->poses + first, b->rows * b->poses);
        }
    return 0;
}

static PyObject *blended_normals(PyObject *Py_UNUSED(module), PyObject *args)
{
    PyObject *o[FORM_ARRAYS], *result = NULL;
    Array a[FORM_ARRAYS];
    Py_ssize_t sizes[26];
    memset(a, 0, sizeof a);
    if (!PyArg_ParseTuple(args, "OOOOO", &o[FORM_ENTRIES], &o[FORM_COLUMNS], &o[FORM_TABLE], &o[REST_NORMALS],
                          &o[BLENDED_NORMALS]))
        return NULL;
    if (read_arrays(o, form_arrays, FORM_ARRAYS, a, sizes) < 0)
        goto done;
    if (SIZE('F') != (a[REST_NORMALS].held ? 3 : 2)) {
        PyErr_SetString(PyExc_ValueError, "normals take three forms, a cross product takes two");
        goto done;
    }
    const BlendNormals work = {
        .table = {DATA(FORM_TABLE), SIZE('R'), 3 * SIZE('P'), SIZE('P')},
        .entries = DATA(FORM_ENTRIES),
        .normals = DATA(REST_NORMALS),
        .columns = DATA(FORM_COLUMNS),
        .out = DATA(BLENDED_NORMALS),
        .rows = SIZE('B'),
        .width = SIZE('W'),
        .poses = SIZE('P'),
    };
    int stray;
    Py_BEGIN_ALLOW_THREADS
    stray = blend_normals_of_rows(&work);
    Py_END_ALLOW_THREADS
    result = none_unless(stray);
done:
    release_arrays(a, FORM_ARRAYS);
    return result;
}

/* ---- Dual quaternion skinning (twins: by_numpy.dqs_positions, by_numpy.dqs_normals) --------------------- */

/* The formulas and letters are those of skinning/dqs.py. */

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

/* Return t' of algorithm 6. `turned` is k, and `moved` is δ. */
static ALWAYS_INLINE Vector derivative(DualQuaternion mix, DualQuaternion rate, Vector tangent, Vector point,
                                       Vector lever, double turned, Vector moved)
{
    Vector lever_rate = plus_times(rate.dual_vector, mix.real, tangent);
    lever_rate = plus_cross(lever_rate, mix.vector, tangent);
    lever_rate = plus_times(lever_rate, rate.real, point);
    lever_rate = plus_cross(lever_rate, rate.vector, point);
    Vector turn_rate = plus_cross(scaled(mix.real, rate.dual_vector), mix.vector, lever_rate);
    turn_rate = plus_cross(turn_rate, rate.vector, lever);
    turn_rate = plus_times(turn_rate, rate.real, mix.dual_vector);
    turn_rate = plus_times(turn_rate, -rate.dual, mix.vector);
    turn_rate = plus_times(turn_rate, -mix.dual, rate.vector);
    turn_rate = plus_times(turn_rate, -real_dot(mix, rate), moved);
    return plus_times(tangent, turned, turn_rate);
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
    [MOTIONS] = {"motions", "d", "8JQ", READ},          \
    [SCALES] = {"scales", "d", "Q", OR_NONE},           \
    [MOTION_JOINTS] = {"joints", "i", "BK", READ},      \
    [MOTION_WEIGHTS] = {"weights", "d", "BK", READ},    \
    [REST_POSITIONS] = {"positions", "d", "B3", READ}

static const Requirement dqs_arrays[DQS_ARRAYS] = {
    DQS_REQUIREMENTS,
    [MOVED] = {"out", "d", "3BP", WRITTEN},
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
    const double *motions, *scales; /* (8, J, Q): their component is `apart` from the next; scales may be NULL */
    const int32_t *joints;
    const double *weights, *positions, *frame, *alpha, *beta, *handedness;
    double *out;
    Py_ssize_t rows, slots, joint_count, poses, all_poses, first_pose, apart;
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
    for (Py_ssize_t p = 0; p < at->poses; p++)
        put(mix, p, times(weights[0], dual_at(at->pivots, s->apart, p)));
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
        const DualQuaternion pivot = dual_at(at->pivots, s->apart, p), q = dual_at(motions, s->apart, p);
        const DualQuaternion change = apart_from(pivot, hemisphere(q, pivot), q);
        put(t->rate, p, plus_share(mixed_at(t->rate, p), alpha, change));
        put(b->rate, p, plus_share(mixed_at(b->rate, p), beta, change));
        const Vector point = scaled(at->scale[p], rest);
        const Vector moved = scaled(2.0, half_turn(q, lever_of(q, point)));
        const Vector by = minus(moved, scaled(2.0, half_turn(pivot, lever_of(pivot, point))));
        t->x[p] += alpha * by.x, t->y[p] += alpha * by.y, t->z[p] += alpha * by.z;
        b->x[p] += beta * by.x, b->y[p] += beta * by.y, b->z[p] += beta * by.z;
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
    Vector frame[3];
    for (int n = 0; n < 3; n++, components += 3 * s->rows)
        frame[n] = (Vector){components[0], components[s->rows], components[2 * s->rows]};
    const Vector rest = vertex_at(s->positions, row);
    for (Py_ssize_t p = 0; p < at->poses; p++)
        put_normal(s, 0, out + p, rotated(normalised(mixed_at(mixes, p)), frame[0]));
    for (Py_ssize_t p = 0; p < at->poses; p++) {
        const DualQuaternion unit = normalised(mixed_at(mixes, p));
        const Vector t = plus(rotated(unit, scaled(at->scale[p], frame[1])), correction_at(along_t, p));
        const Vector b = plus(rotated(unit, scaled(at->scale[p], frame[2])), correction_at(along_b, p));
        put_normal(s, 1, out + p, scaled(s->handedness[row], cross(t, b)));
    }
    for (Py_ssize_t p = 0; p < at->poses; p++) {
        const DualQuaternion mix = mixed_at(mixes, p);
        const double square = real_dot(mix, mix), turned = 2.0 / (square == 0.0 ? 1.0 : square);
        const Vector point = scaled(at->scale[p], rest), lever = lever_of(mix, point);
        const Vector moved = scaled(turned, half_turn(mix, lever));
        const Vector along = scaled(at->scale[p], frame[1]), across = scaled(at->scale[p], frame[2]);
        const Vector t = derivative(mix, dual_at(along_t->rate[0], MIXED, p), along, point, lever, turned, moved);
        const Vector b = derivative(mix, dual_at(along_b->rate[0], MIXED, p), across, point, lever, turned, moved);
        put_normal(s, 2, out + p, scaled(s->handedness[row], cross(t, b)));
    }
}

FOR_PROCESSORS
static int move_by_dqs(const Dqs *s)
{
    Mix mix;
    for (Py_ssize_t row = 0; row < s->rows; row++) {
        const Vector rest = vertex_at(s->positions, row);
        for (Py_ssize_t first = 0; first < s->poses; first += MIXED) {
            const Posing at = posing_of(s, row, first);
            if (mix_motions(s, &at, mix))
                return 1;
            double *out = s->out + row * s->poses + first;
            const Py_ssize_t apart = s->rows * s->poses;
            for (Py_ssize_t p = 0; p < at.poses; p++) {
                const DualQuaternion unit = normalised(mixed_at(mix, p));
                const Vector point = scaled(at.scale[p], rest);
                const Vector moved = plus_times(point, 2.0, half_turn(unit, lever_of(unit, point)));
                out[p] = moved.x, out[apart + p] = moved.y, out[2 * apart + p] = moved.z;
            }
        }
    }
    return 0;
}

FOR_PROCESSORS
static int turn_by_dqs(const Dqs *s)
{
    Mix mix;
    Along t, b;
    for (Py_ssize_t row = 0; row < s->rows; row++) {
        const double *alpha = s->alpha + row * (s->slots - 1), *beta = s->beta + row * (s->slots - 1);
        for (Py_ssize_t first = 0; first < s->poses; first += MIXED) {
            const Posing at = posing_of(s, row, first);
            if (mix_motions(s, &at, mix))
                return 1;
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

/* Take the arguments of a call, without the arrays of normals. Return −1 with an error set. */
static int read_dqs(const Array *a, const Py_ssize_t *sizes, Py_ssize_t first, Dqs *work)
{
    if (SIZE('K') < 1) {
        PyErr_SetString(PyExc_ValueError, "joints has no columns");
        return -1;
    }
    if (first < 0 || SIZE('P') > SIZE('Q') || first > SIZE('Q') - SIZE('P')) {
        PyErr_SetString(PyExc_ValueError, "the motions have fewer poses than are asked for");
        return -1;
    }
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
    Py_ssize_t sizes[26], first;
    Dqs work;
    memset(a, 0, sizeof a);
    if (!PyArg_ParseTuple(args, "OOOOOOn", &o[MOTIONS], &o[SCALES], &o[MOTION_JOINTS], &o[MOTION_WEIGHTS],
                          &o[REST_POSITIONS], &o[MOVED], &first))
        return NULL;
    if (read_arrays(o, dqs_arrays, DQS_ARRAYS, a, sizes) < 0 || read_dqs(a, sizes, first, &work) < 0)
        goto done;
    int stray;
    Py_BEGIN_ALLOW_THREADS
    stray = move_by_dqs(&work);
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
    if (SIZE('L') != SIZE('K') - 1) {
        PyErr_Format(PyExc_ValueError, "alpha has %zd columns, not %zd", SIZE('L'), SIZE('K') - 1);
        goto done;
    }
    work.frame = DATA(FRAME), work.alpha = DATA(ALONG_T), work.beta = DATA(ALONG_B), work.handedness = DATA(HANDEDNESS);
    int stray;
    Py_BEGIN_ALLOW_THREADS
    stray = turn_by_dqs(&work);
    Py_END_ALLOW_THREADS
    result = none_unless(stray);
done:
    release_arrays(a, DQS_NORMAL_ARRAYS);
    return result;
}

/* ---- Rows of the gradient operator (twin: by_numpy.gradient_rows) --------------------------------------- */

enum { REST, FACES, FACE_CORNERS, CLASS_ENDS, OWN_CLASSES, TOTALS, DIRECTIONS, ROW_STARTS, ROW_COLUMNS, ROW_VALUES,
       ROW_ARRAYS };

static const Requirement row_arrays[ROW_ARRAYS] = {
    [REST] = {"positions", "d", "V3", READ},
    [FACES] = {"triangles", "i", "T3", READ},
    [FACE_CORNERS] = {"corners", "i", "N", READ},
    [CLASS_ENDS] = {"ends", "q", "E", READ},
    [OWN_CLASSES] = {"classes", "i", "B", READ},
    [TOTALS] = {"totals", "d", "C", READ},
    [DIRECTIONS] = {"directions", "d", "DB3", READ},
    [ROW_STARTS] = {"starts", "i", "S", WRITTEN},
    [ROW_COLUMNS] = {"columns", "i", "M", WRITTEN},
    [ROW_VALUES] = {"values", "d", "DM", WRITTEN},
};

enum { BY_MAX, BY_ANGLE, BY_AREA, BY_ANGLE_AREA };

typedef struct {
    const double *positions, *totals, *directions;
    const int32_t *triangles, *corners, *classes;
    const int64_t *ends;
    int32_t *starts, *columns, *places; /* places (V,): where a column is in the row, if it is there */
    double *values;
    Py_ssize_t vertices, triangle_count, corner_count, class_count, direction_count, block, room;
    int weighting;
} GradientRows;

static double corner_weight(Vector e1, Vector e2, double area, int weighting)
{
    switch (weighting) {
    case BY_MAX:
        return area / (dot(e1, e1) * dot(e2, e2));
    case BY_AREA:
        return area;
    case BY_ANGLE:
        return atan2(area, dot(e1, e2));
    default:
        return atan2(area, dot(e1, e2)) * area;
    }
}

/* Add a gradient to an entry of the row, which is made if it is not there. Return 1 if there is no room. */
static int add_entry(const GradientRows *g, Py_ssize_t row, Py_ssize_t column, Vector gradient, int32_t *end)
{
    int32_t place = g->places[column];
    if (place < g->starts[row] || place >= *end || g->columns[place] != column) {
        if (*end >= g->room)
            return 1;
        place = g->places[column] = (*end)++;
        g->columns[place] = (int32_t)column;
        for (Py_ssize_t d = 0; d < g->direction_count; d++)
            g->values[d * g->room + place] = 0.0;
    }
    for (Py_ssize_t d = 0; d < g->direction_count; d++)
        g->values[d * g->room + place] += dot(vertex_at(g->directions + 3 * d * g->block, row), gradient);
    return 0;
}

/* Add the gradients of one triangle's hat functions, by one corner's share, to a row. */
static int add_triangle(const GradientRows *g, Py_ssize_t row, int32_t corner, double total, int32_t *end)
{
    Py_ssize_t at[3];
    if (corner < 0 || corner / 3 >= g->triangle_count)
        return 1;
    for (int turn = 0; turn < 3; turn++) {
        at[turn] = g->triangles[3 * (Py_ssize_t)(corner / 3) + (corner + turn) % 3];
        if (at[turn] < 0 || at[turn] >= g->vertices)
            return 1;
    }
    const Vector here = vertex_at(g->positions, at[0]);
    const Vector e1 = minus(vertex_at(g->positions, at[1]), here), e2 = minus(vertex_at(g->positions, at[2]), here);
    const Vector normal = cross(e1, e2);
    const double square = dot(normal, normal);
    const double share = corner_weight(e1, e2, sqrt(square), g->weighting) / total / square;
    const Vector first = scaled(share, cross(e2, normal)), second = scaled(share, cross(normal, e1));
    const Vector own = {-(first.x + second.x), -(first.y + second.y), -(first.z + second.z)};
    return add_entry(g, row, at[0], own, end) || add_entry(g, row, at[1], first, end) ||
           add_entry(g, row, at[2], second, end);
}

/* Fill the rows of a block. Return 1 for an index that names nothing, or too little room. */
static int make_rows(const GradientRows *g)
{
    int32_t end = 0;
    for (Py_ssize_t row = 0; row < g->block; row++) {
        const int32_t class = g->classes[row];
        g->starts[row] = end;
        if (class < 0 || class >= g->class_count)
            return 1;
        const int64_t from = g->ends[class], to = g->ends[class + 1];
        if (from < 0 || to < from || to > g->corner_count)
            return 1;
        for (int64_t n = from; n < to; n++)
            if (add_triangle(g, row, g->corners[n], g->totals[class], &end))
                return 1;
    }
    g->starts[g->block] = end;
    return 0;
}

static PyObject *gradient_rows(PyObject *Py_UNUSED(module), PyObject *args)
{
    PyObject *o[ROW_ARRAYS], *result = NULL;
    Array a[ROW_ARRAYS];
    Py_ssize_t sizes[26];
    int weighting;
    int32_t *places = NULL;
    memset(a, 0, sizeof a);
    if (!PyArg_ParseTuple(args, "OOOOOOOOOOi", &o[REST], &o[FACES], &o[FACE_CORNERS], &o[CLASS_ENDS], &o[OWN_CLASSES],
                          &o[TOTALS], &o[DIRECTIONS], &o[ROW_STARTS], &o[ROW_COLUMNS], &o[ROW_VALUES], &weighting))
        return NULL;
    if (read_arrays(o, row_arrays, ROW_ARRAYS, a, sizes) < 0)
        goto done;
    if (SIZE('E') != SIZE('C') + 1 || SIZE('S') != SIZE('B') + 1 || SIZE('M') > INT32_MAX) {
        PyErr_SetString(PyExc_ValueError, "the arrays of the rows do not belong together");
        goto done;
    }
    places = calloc((size_t)SIZE('V') + 1, sizeof *places);
    if (places == NULL) {
        PyErr_NoMemory();
        goto done;
    }
    const GradientRows work = {
        .positions = DATA(REST),
        .totals = DATA(TOTALS),
        .directions = DATA(DIRECTIONS),
        .triangles = DATA(FACES),
        .corners = DATA(FACE_CORNERS),
        .classes = DATA(OWN_CLASSES),
        .ends = DATA(CLASS_ENDS),
        .starts = DATA(ROW_STARTS),
        .columns = DATA(ROW_COLUMNS),
        .places = places,
        .values = DATA(ROW_VALUES),
        .vertices = SIZE('V'),
        .triangle_count = SIZE('T'),
        .corner_count = SIZE('N'),
        .class_count = SIZE('C'),
        .direction_count = SIZE('D'),
        .block = SIZE('B'),
        .room = SIZE('M'),
        .weighting = weighting,
    };
    int stray;
    Py_BEGIN_ALLOW_THREADS
    stray = make_rows(&work);
    Py_END_ALLOW_THREADS
    result = none_unless(stray);
done:
    free(places);
    release_arrays(a, ROW_ARRAYS);
    return result;
}

/* ---- The sums of angle-weighted normals (twin: by_numpy.class_sums) -------------------------------------- */

/* tan(π/8), π/4 and π/2. */
#define TAN_EIGHTH 0.41421356237309503
#define QUARTER 0.78539816339744828
#define HALF 1.5707963267948966

/* Return the arctangent of y / x, both at least 0 and y at most x: no term of the series is left out that
   changes a bit. Beyond tan(π/8), arctan t = π/4 + arctan((t − 1) / (t + 1)). */
static ALWAYS_INLINE double arctangent(double y, double x)
{
    const int beyond = y > TAN_EIGHTH * x;
    const double t = (beyond ? y - x : y) / (beyond ? y + x : x), s = t * t;
    double sum = 0.02113551294639468;
    sum = sum * s - 0.043480657562470874;
    sum = sum * s + 0.05688354825090266;
    sum = sum * s - 0.0664023521979754;
    sum = sum * s + 0.07689953677164002;
    sum = sum * s - 0.09090773090639556;
    sum = sum * s + 0.1111110618130427;
    sum = sum * s - 0.14285714181002448;
    sum = sum * s + 0.199999999988555;
    sum = sum * s - 0.3333333333332844;
    sum = sum * s + 1.0;
    return (beyond ? QUARTER : 0.0) + t * sum;
}

enum { POSITIONS, TRIANGLES, MET, MESH_CLASSES, SUMS, SUM_ARRAYS };

static const Requirement sum_arrays[SUM_ARRAYS] = {
    [POSITIONS] = {"positions", "d", "3VP", READ},
    [TRIANGLES] = {"triangles", "i", "T3", READ},
    [MET] = {"met", "i", "N", READ},
    [MESH_CLASSES] = {"classes", "i", "V", READ},
    [SUMS] = {"sums", "fd", "3CP", WRITTEN},
};

/* The poses in work at a time here: the sums of a block of classes stay in the processor's second cache. */
enum { FACE_STRIP = 32 };

typedef double FaceStrip[FACE_STRIP];

typedef struct {
    const double *positions;
    const int32_t *triangles, *met, *classes;
    double *totals; /* (3, C, width) */
    void *sums;     /* float, or double if it is wide */
    int is_wide;
    Py_ssize_t vertices, poses, width, triangle_count, met_count, class_count, first_class;
    double flat; /* a triangle with a larger cotangent is a line or a point */
} Sums;

/* A triangle in up to FACE_STRIP poses: its unit normal, and its angles. One without an area has a normal of zero,
   and any angles. */
typedef struct {
    FaceStrip x, y, z, angles[3];
} Face;

/* Return the angle of a cotangent. */
static ALWAYS_INLINE double angle_of(double signed_cotangent)
{
    const double cotangent = fabs(signed_cotangent);
    const int steep = cotangent < 1.0;
    const double acute = arctangent(steep ? cotangent : 1.0, steep ? 1.0 : cotangent);
    const double upright = steep ? HALF - acute : acute;
    return signed_cotangent < 0.0 ? 2.0 * HALF - upright : upright;
}

/* Measure a triangle. The third angle is what the other two leave of π, to the same absolute rounding. */
static ALWAYS_INLINE void measure_face(Components origin, Components second, Components third, double flat,
                                       Py_ssize_t count, Face *face)
{
    for (Py_ssize_t p = 0; p < count; p++) {
        const Vector here = vector_at(origin, p);
        const Vector e1 = minus(vector_at(second, p), here), e2 = minus(vector_at(third, p), here);
        const Vector normal = cross(e1, e2);
        const double aa = dot(e1, e1), ab = dot(e1, e2);
        const double reciprocal = 1.0 / sqrt(dot(normal, normal));
        const int sound = (fabs(ab * reciprocal) < flat) & (fabs((aa - ab) * reciprocal) < flat);
        const double at_first = angle_of(sound ? ab * reciprocal : 0.0);
        const double at_second = angle_of(sound ? (aa - ab) * reciprocal : 0.0);
        face->x[p] = sound ? normal.x * reciprocal : 0.0;
        face->y[p] = sound ? normal.y * reciprocal : 0.0;
        face->z[p] = sound ? normal.z * reciprocal : 0.0;
        face->angles[0][p] = at_first;
        face->angles[1][p] = at_second;
        face->angles[2][p] = 2.0 * HALF - at_first - at_second;
    }
}

/* Add angle × unit normal of a triangle at one of its corners. */
static ALWAYS_INLINE void add_corner(const Face *face, const double *angles, Py_ssize_t count, double *restrict x,
                                     double *restrict y, double *restrict z)
{
    for (Py_ssize_t p = 0; p < count; p++) {
        x[p] += angles[p] * face->x[p];
        y[p] += angles[p] * face->y[p];
        z[p] += angles[p] * face->z[p];
    }
}

/* Add one triangle, in some poses, at those of its corners that belong to the classes in work. */
static ALWAYS_INLINE int add_face(const Sums *s, int32_t triangle, Py_ssize_t first, Py_ssize_t count)
{
    Face face;
    Components at[3];
    Py_ssize_t rows[3];
    if (triangle < 0 || triangle >= s->triangle_count)
        return 1;
    for (int corner = 0; corner < 3; corner++) {
        const int32_t vertex = s->triangles[3 * (Py_ssize_t)triangle + corner];
        if (vertex < 0 || vertex >= s->vertices)
            return 1;
        at[corner] = components(s->positions, s->vertices * s->poses, vertex * s->poses + first);
        rows[corner] = s->classes[vertex] - s->first_class;
    }
    measure_face(at[0], at[1], at[2], s->flat, count, &face);
    const Py_ssize_t apart = s->class_count * s->width;
    for (int corner = 0; corner < 3; corner++)
        if (rows[corner] >= 0 && rows[corner] < s->class_count) {
            double *total = s->totals + rows[corner] * s->width;
            add_corner(&face, face.angles[corner], count, total, total + apart, total + 2 * apart);
        }
    return 0;
}

/* Sum up the triangles that the classes in work meet, which are given in ascending order. So each class has its
   terms in the same order, no matter which other classes are in work. */
FOR_PROCESSORS
static int sum_classes(const Sums *s)
{
    const Py_ssize_t rows = 3 * s->class_count;
    for (Py_ssize_t first = 0; first < s->poses; first += s->width) {
        const Py_ssize_t count = least(s->width, s->poses - first);
        memset(s->totals, 0, (size_t)(rows * s->width) * sizeof(double));
        for (Py_ssize_t n = 0; n < s->met_count; n++)
            if (add_face(s, s->met[n], first, count))
                return 1;
        for (Py_ssize_t row = 0; row < rows; row++)
            for (Py_ssize_t p = 0; p < count; p++) {
                const Py_ssize_t at = row * s->poses + first + p;
                const double total = s->totals[row * s->width + p];
                if (s->is_wide)
                    ((double *)s->sums)[at] = total;
                else
                    ((float *)s->sums)[at] = (float)total;
            }
    }
    return 0;
}

static PyObject *class_sums(PyObject *Py_UNUSED(module), PyObject *args)
{
    PyObject *o[SUM_ARRAYS], *result = NULL;
    Array a[SUM_ARRAYS];
    Py_ssize_t sizes[26], first_class;
    double flat, *totals = NULL;
    memset(a, 0, sizeof a);
    if (!PyArg_ParseTuple(args, "OOOOOnd", &o[POSITIONS], &o[TRIANGLES], &o[MET], &o[MESH_CLASSES], &o[SUMS],
                          &first_class, &flat))
        return NULL;
    if (read_arrays(o, sum_arrays, SUM_ARRAYS, a, sizes) < 0)
        goto done;
    if (first_class < 0) {
        PyErr_Format(PyExc_ValueError, "the first class is %zd", first_class);
        goto done;
    }
    const Py_ssize_t width = least(FACE_STRIP, SIZE('P'));
    totals = malloc((size_t)(3 * SIZE('C') * width + 1) * sizeof *totals);
    if (totals == NULL) {
        PyErr_NoMemory();
        goto done;
    }
    const Sums work = {
        .positions = DATA(POSITIONS),
        .triangles = DATA(TRIANGLES),
        .met = DATA(MET),
        .classes = DATA(MESH_CLASSES),
        .totals = totals,
        .sums = DATA(SUMS),
        .is_wide = kind_of(&a[SUMS].buffer) == 'd',
        .vertices = SIZE('V'),
        .poses = SIZE('P'),
        .width = width,
        .triangle_count = SIZE('T'),
        .met_count = SIZE('N'),
        .class_count = SIZE('C'),
        .first_class = first_class,
        .flat = flat,
    };
    int stray;
    Py_BEGIN_ALLOW_THREADS
    stray = sum_classes(&work);
    Py_END_ALLOW_THREADS
    result = none_unless(stray);
done:
    free(totals);
    release_arrays(a, SUM_ARRAYS);
    return result;
}

/* ---- True normals (twin: by_numpy.true_normals) -------------------------------------------------------- */

enum { T_STARTS, T_COLUMNS, T_VALUES, B_STARTS, B_COLUMNS, B_VALUES, DEFORMED, COEFFICIENTS, AREAS, VALID, CARRIED,
       CLASSES, CLASS_SUMS, SIDES, NORMALS, EXIST, TRUE_ARRAYS };

static const Requirement true_arrays[TRUE_ARRAYS] = {
    [T_STARTS] = {"t_starts", "i", "E", READ},
    [T_COLUMNS] = {"t_columns", "i", "M", READ},
    [T_VALUES] = {"t_values", "d", "M", READ},
    [B_STARTS] = {"b_starts", "i", "E", READ},
    [B_COLUMNS] = {"b_columns", "i", "N", READ},
    [B_VALUES] = {"b_values", "d", "N", READ},
    [DEFORMED] = {"positions", "d", "3VP", READ},
    [COEFFICIENTS] = {"coefficients", "d", "3B", READ},
    [AREAS] = {"areas", "d", "B", READ},
    [VALID] = {"valid", "?", "B", READ},
    [CARRIED] = {"carried", "d", "3B", OR_NONE},
    [CLASSES] = {"classes", "i", "B", OR_NONE},
    [CLASS_SUMS] = {"sums", "f", "3CP", OR_NONE},
    [SIDES] = {"sides", "d", "BP", OR_NONE},
    [NORMALS] = {"normals", "d", "U3BP", WRITTEN},
    [EXIST] = {"exist", "?", "UBP", WRITTEN},
};

/* Rows of a sparse matrix. */
typedef struct {
    const int32_t *starts, *columns;
    const double *values;
    Py_ssize_t entries;
} Rows;

typedef struct {
    Table positions;
    Rows along_t, along_b;
    const double *coefficients, *areas, *carried, *sides;
    const float *sums;
    const int32_t *classes;
    const char *valid;
    double *normals;
    char *exist;
    Py_ssize_t poses, block, class_count;
    double flat; /* a frame with a smaller sine is flat */
} TrueNormals;

/* Differentiate positions along one row, in up to STRIP poses. */
static ALWAYS_INLINE int differentiate(const TrueNormals *w, const Rows *rows, Py_ssize_t row, Py_ssize_t first,
                                       Py_ssize_t count, Strips *out)
{
    const int32_t from = rows->starts[row], to = rows->starts[row + 1];
    if (from < 0 || to < from || to > rows->entries)
        return 1;
    return combine_entries(&w->positions, rows->values + from, rows->columns + from, to - from, first, count, out);
}

/* Return cof(F) n0 of unit length, NaN if there is none (reference.tangent_normals). rest: the coordinates of
   n0 in the rest frame; area: of that frame, NaN if it is not usable. */
static ALWAYS_INLINE Vector by_tangents(Vector a, Vector b, Vector rest, double area, double side, double flat)
{
    const Vector c = cross(a, b);
    const double aa = dot(a, a), ab = dot(a, b), bb = dot(b, b), square = dot(c, c);
    const double reciprocal = 1.0 / sqrt(sqrt(square) * area);
    const double along_a = (rest.x * bb - rest.y * ab) * reciprocal;
    const double along_b = (rest.y * aa - rest.x * ab) * reciprocal;
    const double along_c = rest.z * side;
    const Vector found = {along_a * a.x + along_b * b.x + along_c * c.x, along_a * a.y + along_b * b.y + along_c * c.y,
                          along_a * a.z + along_b * b.z + along_c * c.z};
    const Vector unit = scaled(1.0 / sqrt(dot(found, found)), found);
    const int sound = (square > flat * flat * aa * bb) & (fabs(unit.x) <= DBL_MAX);
    return scaled(sound ? 1.0 : NAN, unit);
}

/* Return the carried normal in the frame t̂, n̂ × t̂, n̂ (triangle_normals.triangle_normals). */
static ALWAYS_INLINE Vector by_triangles(Vector tangent, Vector sum, Vector carried, double side)
{
    const Vector n = scaled(1.0 / sqrt(dot(sum, sum)), sum);
    const double lean = dot(tangent, n);
    const Vector level = {tangent.x - lean * n.x, tangent.y - lean * n.y, tangent.z - lean * n.z};
    const Vector t = scaled(1.0 / sqrt(dot(level, level)), level), s = cross(n, t);
    const double up = carried.z * side;
    return (Vector){carried.x * t.x + carried.y * s.x + up * n.x, carried.x * t.y + carried.y * s.y + up * n.y,
                    carried.x * t.z + carried.y * s.z + up * n.z};
}

/* Store the normals of a vertex by one truth in up to STRIP poses, and tell which of them exist. */
static ALWAYS_INLINE void store_normals(const TrueNormals *w, Py_ssize_t truth, Py_ssize_t at, Py_ssize_t count,
                                        const Strips *found)
{
    const Py_ssize_t stride = w->block * w->poses;
    store_strips(found, count, w->normals + 3 * truth * stride + at, stride);
    char *exist = w->exist + truth * stride + at;
    for (Py_ssize_t p = 0; p < count; p++)
        exist[p] = fabs(found->x[p]) <= DBL_MAX;
}

static ALWAYS_INLINE int normals_of_strip(const TrueNormals *w, Py_ssize_t row, Py_ssize_t first, Py_ssize_t count)
{
    const Py_ssize_t block = w->block, at = row * w->poses + first;
    Strips a, b, found;
    Strip sides;
    if (differentiate(w, &w->along_t, row, first, count, &a) || differentiate(w, &w->along_b, row, first, count, &b))
        return 1;
    for (Py_ssize_t p = 0; p < count; p++)
        sides[p] = w->sides ? w->sides[at + p] : 1.0;
    const Vector rest = {w->coefficients[row], w->coefficients[block + row], w->coefficients[2 * block + row]};
    const double area = w->valid[row] ? w->areas[row] : NAN;
    for (Py_ssize_t p = 0; p < count; p++) {
        const Vector normal = by_tangents((Vector){a.x[p], a.y[p], a.z[p]}, (Vector){b.x[p], b.y[p], b.z[p]}, rest,
                                          area, sides[p], w->flat);
        found.x[p] = normal.x, found.y[p] = normal.y, found.z[p] = normal.z;
    }
    store_normals(w, 0, at, count, &found);
    if (w->carried == NULL)
        return 0;
    const int32_t class = w->classes[row];
    if (class < 0 || class >= w->class_count)
        return 1;
    const Vector carried = {w->carried[row], w->carried[block + row], w->carried[2 * block + row]};
    const Py_ssize_t apart = w->class_count * w->poses;
    const float *sums = w->sums + class * w->poses + first;
    for (Py_ssize_t p = 0; p < count; p++) {
        const Vector sum = {sums[p], sums[apart + p], sums[2 * apart + p]};
        const Vector normal = by_triangles((Vector){a.x[p], a.y[p], a.z[p]}, sum, carried, sides[p]);
        found.x[p] = normal.x, found.y[p] = normal.y, found.z[p] = normal.z;
    }
    store_normals(w, 1, at, count, &found);
    return 0;
}

FOR_PROCESSORS
static int normals_of_block(const TrueNormals *w)
{
    for (Py_ssize_t row = 0; row < w->block; row++)
        for (Py_ssize_t first = 0; first < w->poses; first += STRIP)
            if (normals_of_strip(w, row, first, least(STRIP, w->poses - first)))
                return 1;
    return 0;
}

/* Check what the requirements of true_normals cannot say. */
static int check_truths(const Array *a, const Py_ssize_t *sizes)
{
    const int carried = a[CARRIED].held;
    if (SIZE('E') == SIZE('B') + 1 && carried == a[CLASSES].held && carried == a[CLASS_SUMS].held &&
        SIZE('U') == 1 + carried)
        return 0;
    PyErr_SetString(PyExc_ValueError, "the arrays of the true normals do not belong together");
    return -1;
}

static PyObject *true_normals(PyObject *Py_UNUSED(module), PyObject *args)
{
    PyObject *o[TRUE_ARRAYS], *result = NULL;
    Array a[TRUE_ARRAYS];
    Py_ssize_t sizes[26];
    double flat;
    memset(a, 0, sizeof a);
    if (!PyArg_ParseTuple(args, "OOOOOOOOOOOOOOOOd", &o[T_STARTS], &o[T_COLUMNS], &o[T_VALUES], &o[B_STARTS],
                          &o[B_COLUMNS], &o[B_VALUES], &o[DEFORMED], &o[COEFFICIENTS], &o[AREAS], &o[VALID],
                          &o[CARRIED], &o[CLASSES], &o[CLASS_SUMS], &o[SIDES], &o[NORMALS], &o[EXIST], &flat))
        return NULL;
    if (read_arrays(o, true_arrays, TRUE_ARRAYS, a, sizes) < 0 || check_truths(a, sizes) < 0)
        goto done;
    const TrueNormals work = {
        .along_t = {DATA(T_STARTS), DATA(T_COLUMNS), DATA(T_VALUES), SIZE('M')},
        .along_b = {DATA(B_STARTS), DATA(B_COLUMNS), DATA(B_VALUES), SIZE('N')},
        .positions = {DATA(DEFORMED), SIZE('V'), SIZE('P'), SIZE('V') * SIZE('P')},
        .coefficients = DATA(COEFFICIENTS),
        .areas = DATA(AREAS),
        .carried = DATA(CARRIED),
        .sides = DATA(SIDES),
        .sums = DATA(CLASS_SUMS),
        .classes = DATA(CLASSES),
        .valid = DATA(VALID),
        .normals = DATA(NORMALS),
        .exist = DATA(EXIST),
        .poses = SIZE('P'),
        .block = SIZE('B'),
        .class_count = SIZE('C'),
        .flat = flat,
    };
    int stray;
    Py_BEGIN_ALLOW_THREADS
    stray = normals_of_block(&work);
    Py_END_ALLOW_THREADS
    result = none_unless(stray);
done:
    release_arrays(a, TRUE_ARRAYS);
    return result;
}

/* ---- Angles (twin: by_numpy.angles) -------------------------------------------------------------------- */

enum { MEASURED_X, MEASURED_Y, MEASURED_Z, EXPECTED, ANGLES, ANGLE_ARRAYS };

static const Requirement angle_arrays[ANGLE_ARRAYS] = {
    [MEASURED_X] = {"x", "d", "BP", READ},
    [MEASURED_Y] = {"y", "d", "BP", READ},
    [MEASURED_Z] = {"z", "d", "BP", READ},
    [EXPECTED] = {"expected", "d", "U3BP", READ},
    [ANGLES] = {"angles", "f", "UBP", WRITTEN},
};

/* Return twice the arctangent of the root of a ratio, in degrees. */
static ALWAYS_INLINE float degrees_of(float ratio)
{
    const float tangent = sqrtf(fabsf(ratio));
    const float y = tangent < 1.0f ? tangent : 1.0f, x = tangent < 1.0f ? 1.0f : tangent;
    const int beyond = y > (float)TAN_EIGHTH * x;
    const float t = (beyond ? y - x : y) / (beyond ? y + x : x), s = t * t;
    float sum = -0.0602630523f;
    sum = sum * s + 0.105698288f;
    sum = sum * s - 0.142395327f;
    sum = sum * s + 0.19998183f;
    sum = sum * s - 0.333333069f;
    sum = sum * s + 0.999999999f;
    const float acute = (beyond ? (float)QUARTER : 0.0f) + t * sum;
    const float angle = tangent > 1.0f ? (float)HALF - acute : acute;
    return angle * (float)(180.0 / HALF);
}

FOR_PROCESSORS
static void find_angles(Components measured, const double *expected, float *angles, Py_ssize_t truths, Py_ssize_t size)
{
    Strip x, y, z;
    float ratios[STRIP];
    for (Py_ssize_t first = 0; first < size; first += STRIP) {
        const Py_ssize_t count = least(STRIP, size - first);
        for (Py_ssize_t p = 0; p < count; p++) {
            const Vector vector = vector_at(measured, first + p);
            const double square = dot(vector, vector);
            const Vector unit = scaled(1.0 / sqrt(square <= DBL_MAX ? square : NAN), vector);
            x[p] = unit.x, y[p] = unit.y, z[p] = unit.z;
        }
        for (Py_ssize_t truth = 0; truth < truths; truth++) {
            const Components wanted = components(expected + 3 * truth * size, size, first);
            for (Py_ssize_t p = 0; p < count; p++) {
                const Vector apart = minus((Vector){x[p], y[p], z[p]}, vector_at(wanted, p));
                const double chord = dot(apart, apart);
                ratios[p] = (float)(chord / (4.0 - chord));
            }
            for (Py_ssize_t p = 0; p < count; p++)
                angles[truth * size + first + p] = degrees_of(ratios[p]);
        }
    }
}

static PyObject *angles(PyObject *Py_UNUSED(module), PyObject *args)
{
    PyObject *o[ANGLE_ARRAYS], *result = NULL;
    Array a[ANGLE_ARRAYS];
    Py_ssize_t sizes[26];
    memset(a, 0, sizeof a);
    if (!PyArg_ParseTuple(args, "OOOOO", &o[MEASURED_X], &o[MEASURED_Y], &o[MEASURED_Z], &o[EXPECTED], &o[ANGLES]))
        return NULL;
    if (read_arrays(o, angle_arrays, ANGLE_ARRAYS, a, sizes) < 0)
        goto done;
    const Components measured = {DATA(MEASURED_X), DATA(MEASURED_Y), DATA(MEASURED_Z)};
    const double *expected = DATA(EXPECTED);
    float *found = DATA(ANGLES);
    Py_BEGIN_ALLOW_THREADS
    find_angles(measured, expected, found, SIZE('U'), SIZE('B') * SIZE('P'));
    Py_END_ALLOW_THREADS
    result = Py_NewRef(Py_None);
done:
    release_arrays(a, ANGLE_ARRAYS);
    return result;
}

/* ---- Counting errors (twin: by_numpy.count_errors) ----------------------------------------------------- */

enum { ERRORS, WEIGHTS, COUNTED, TAIL, TAIL_WEIGHTS, COUNT_ARRAYS };

static const Requirement count_arrays[COUNT_ARRAYS] = {
    [ERRORS] = {"errors", "f", "BP", READ},
    [WEIGHTS] = {"weights", "d", "B", READ},
    [COUNTED] = {"valid", "?", "BP", OR_NONE},
    [TAIL] = {"tail", "f", "N", WRITTEN},
    [TAIL_WEIGHTS] = {"tail_weights", "d", "N", WRITTEN},
};

typedef struct {
    const float *errors;
    const double *weights;
    const char *valid;
    float *tail;
    double *tail_weights;
    Py_ssize_t block, poses;
    float least; /* smaller errors cannot be in the tail */
} Counting;

typedef struct {
    Py_ssize_t samples, undefined, kept, pose, vertex;
    double weight, sum;
    float largest;
} Counted;

/* Count one error of a vertex. NaN: the measured normal does not exist, which is as bad as can be. */
static ALWAYS_INLINE void count_one(const Counting *c, Counted *n, float error, Py_ssize_t row, Py_ssize_t pose,
                                    double *sum)
{
    const int undefined = error != error;
    const float value = undefined ? 180.0f : error;
    n->undefined += undefined;
    *sum += value;
    if (value > n->largest || (value == n->largest && pose < n->pose))
        n->largest = value, n->pose = pose, n->vertex = row;
    if (value >= c->least) {
        c->tail[n->kept] = value;
        c->tail_weights[n->kept++] = c->weights[row];
    }
}

/* Keep the errors of a row that may be in the tail: without a branch, since one in twenty is. */
static ALWAYS_INLINE void keep_tail(const Counting *c, Counted *n, const float *errors, Py_ssize_t row)
{
    const double weight = c->weights[row];
    Py_ssize_t kept = n->kept;
    for (Py_ssize_t p = 0; p < c->poses; p++) {
        c->tail[kept] = errors[p];
        c->tail_weights[kept] = weight;
        kept += errors[p] >= c->least;
    }
    n->kept = kept;
}

/* Note the largest error of a row, if it is the largest of all, or as large at an earlier pose. */
static ALWAYS_INLINE void note_largest(const Counting *c, Counted *n, const float *errors, float largest,
                                       Py_ssize_t row)
{
    Py_ssize_t pose = 0;
    while (pose < c->poses - 1 && errors[pose] != largest)
        pose++;
    if (largest > n->largest || pose < n->pose)
        n->largest = largest, n->pose = pose, n->vertex = row;
}

enum { LANES = 8 };

/* Return the sum of a row, NaN if any error is NaN, and find the largest error: in lanes, as vectors do. */
static ALWAYS_INLINE double sum_row(const float *errors, Py_ssize_t poses, float *largest)
{
    double sums[LANES] = {0};
    float most[LANES];
    Py_ssize_t p = 0;
    for (int lane = 0; lane < LANES; lane++)
        most[lane] = -1.0f;
    for (; p + LANES <= poses; p += LANES)
        for (int lane = 0; lane < LANES; lane++) {
            sums[lane] += errors[p + lane];
            most[lane] = errors[p + lane] > most[lane] ? errors[p + lane] : most[lane];
        }
    for (; p < poses; p++) {
        sums[0] += errors[p];
        most[0] = errors[p] > most[0] ? errors[p] : most[0];
    }
    double total = 0.0;
    for (int lane = 0; lane < LANES; lane++) {
        total += sums[lane];
        *largest = most[lane] > *largest ? most[lane] : *largest;
    }
    return total;
}

FOR_PROCESSORS
static Counted count_rows(const Counting *c)
{
    Counted n = {.largest = -1.0f};
    for (Py_ssize_t row = 0; row < c->block; row++) {
        const double weight = c->weights[row];
        if (!(weight > 0.0))
            continue;
        const float *errors = c->errors + row * c->poses;
        const char *valid = c->valid ? c->valid + row * c->poses : NULL;
        float largest = -1.0f;
        double sum = sum_row(errors, c->poses, &largest);
        Py_ssize_t samples = c->poses;
        if (valid && memchr(valid, 0, (size_t)c->poses)) {
            samples = 0, sum = 0.0;
            for (Py_ssize_t p = 0; p < c->poses; p++)
                if (valid[p])
                    samples++, count_one(c, &n, errors[p], row, p, &sum);
        } else if (sum != sum) {
            sum = 0.0;
            for (Py_ssize_t p = 0; p < c->poses; p++)
                count_one(c, &n, errors[p], row, p, &sum);
        } else {
            if (largest >= c->least)
                keep_tail(c, &n, errors, row);
            if (c->poses > 0 && largest >= n.largest)
                note_largest(c, &n, errors, largest, row);
        }
        n.samples += samples;
        n.weight += weight * (double)samples;
        n.sum += weight * sum;
    }
    return n;
}

static PyObject *count_errors(PyObject *Py_UNUSED(module), PyObject *args)
{
    PyObject *o[COUNT_ARRAYS], *result = NULL;
    Array a[COUNT_ARRAYS];
    Py_ssize_t sizes[26];
    float least_kept;
    memset(a, 0, sizeof a);
    if (!PyArg_ParseTuple(args, "OOOOOf", &o[ERRORS], &o[WEIGHTS], &o[COUNTED], &o[TAIL], &o[TAIL_WEIGHTS], &least_kept))
        return NULL;
    if (read_arrays(o, count_arrays, COUNT_ARRAYS, a, sizes) < 0)
        goto done;
    if (SIZE('N') < SIZE('B') * SIZE('P')) {
        PyErr_SetString(PyExc_ValueError, "the tail has no room for all errors");
        goto done;
    }
    const Counting work = {DATA(ERRORS), DATA(WEIGHTS), DATA(COUNTED), DATA(TAIL), DATA(TAIL_WEIGHTS), SIZE('B'),
                           SIZE('P'),    least_kept};
    Counted n;
    Py_BEGIN_ALLOW_THREADS
    n = count_rows(&work);
    Py_END_ALLOW_THREADS
    result = Py_BuildValue("nnnddfnn", n.samples, n.undefined, n.kept, n.weight, n.sum, n.largest, n.pose, n.vertex);
done:
    release_arrays(a, COUNT_ARRAYS);
    return result;
}

/* ---- The tail of the errors (twins: by_numpy.keep_at_least, by_numpy.add_to_bins) ----------------------- */

enum { VALUES, VALUE_WEIGHTS, KEPT_ARRAYS, BINS = KEPT_ARRAYS, BINNED_ARRAYS };

static const Requirement kept_arrays[KEPT_ARRAYS] = {
    [VALUES] = {"values", "f", "N", WRITTEN},
    [VALUE_WEIGHTS] = {"weights", "d", "N", WRITTEN},
};

static const Requirement binned_arrays[BINNED_ARRAYS] = {
    [VALUES] = {"values", "f", "N", READ},
    [VALUE_WEIGHTS] = {"weights", "d", "N", READ},
    [BINS] = {"bins", "d", "M", WRITTEN},
};

static PyObject *keep_at_least(PyObject *Py_UNUSED(module), PyObject *args)
{
    PyObject *o[KEPT_ARRAYS], *result = NULL;
    Array a[KEPT_ARRAYS];
    Py_ssize_t sizes[26], kept = 0;
    double wanted;
    memset(a, 0, sizeof a);
    if (!PyArg_ParseTuple(args, "OOd", &o[VALUES], &o[VALUE_WEIGHTS], &wanted))
        return NULL;
    if (read_arrays(o, kept_arrays, KEPT_ARRAYS, a, sizes) < 0)
        goto done;
    float *values = DATA(VALUES);
    double *weights = DATA(VALUE_WEIGHTS);
    Py_BEGIN_ALLOW_THREADS
    for (Py_ssize_t n = 0; n < SIZE('N'); n++) {
        const float value = values[n];
        values[kept] = value, weights[kept] = weights[n];
        kept += value >= wanted;
    }
    Py_END_ALLOW_THREADS
    result = PyLong_FromSsize_t(kept);
done:
    release_arrays(a, KEPT_ARRAYS);
    return result;
}

/* Add each weight to the bin of its value. Return 1 for a value beyond the last bin. */
static int fill_bins(const float *values, const double *weights, Py_ssize_t count, double *bins, Py_ssize_t size,
                     int shift)
{
    for (Py_ssize_t n = 0; n < count; n++) {
        uint32_t bits;
        memcpy(&bits, &values[n], sizeof bits);
        const Py_ssize_t bin = (Py_ssize_t)((bits & INT32_MAX) >> shift);
        if (bin >= size)
            return 1;
        bins[bin] += weights[n];
    }
    return 0;
}

static PyObject *add_to_bins(PyObject *Py_UNUSED(module), PyObject *args)
{
    PyObject *o[BINNED_ARRAYS], *result = NULL;
    Array a[BINNED_ARRAYS];
    Py_ssize_t sizes[26];
    int shift;
    memset(a, 0, sizeof a);
    if (!PyArg_ParseTuple(args, "OOOi", &o[VALUES], &o[VALUE_WEIGHTS], &o[BINS], &shift))
        return NULL;
    if (read_arrays(o, binned_arrays, BINNED_ARRAYS, a, sizes) < 0)
        goto done;
    if (shift < 0 || shift > 31) {
        PyErr_SetString(PyExc_ValueError, "a float has 32 bits to shift");
        goto done;
    }
    const float *values = DATA(VALUES);
    const double *weights = DATA(VALUE_WEIGHTS);
    double *bins = DATA(BINS);
    int stray;
    Py_BEGIN_ALLOW_THREADS
    stray = fill_bins(values, weights, SIZE('N'), bins, SIZE('M'), shift);
    Py_END_ALLOW_THREADS
    result = none_unless(stray);
done:
    release_arrays(a, BINNED_ARRAYS);
    return result;
}

/* ---- The module ---------------------------------------------------------------------------------------- */

static PyMethodDef functions[] = {
    {"blend", blend, METH_VARARGS, "blend(entries, columns, table, out): fill out."},
    {"blended_normals", blended_normals, METH_VARARGS,
     "blended_normals(entries, columns, table, normals, out): fill out."},
    {"dqs_positions", dqs_positions, METH_VARARGS,
     "dqs_positions(motions, scales, joints, weights, positions, out, first): fill out."},
    {"dqs_normals", dqs_normals, METH_VARARGS, "dqs_normals(...): fill out; see _loops.pyi."},
    {"gradient_rows", gradient_rows, METH_VARARGS, "gradient_rows(...): fill starts, columns and values; see _loops.pyi."},
    {"class_sums", class_sums, METH_VARARGS,
     "class_sums(positions, triangles, met, classes, sums, first_class, flat): fill sums."},
    {"true_normals", true_normals, METH_VARARGS, "true_normals(...): fill normals and exist; see _loops.pyi."},
    {"angles", angles, METH_VARARGS, "angles(x, y, z, expected, angles): fill angles, in degrees."},
    {"count_errors", count_errors, METH_VARARGS,
     "count_errors(errors, weights, valid, tail, tail_weights, least): fill the tail; return counts and sums."},
    {"keep_at_least", keep_at_least, METH_VARARGS,
     "keep_at_least(values, weights, least): move the values of at least least to the front; return how many."},
    {"add_to_bins", add_to_bins, METH_VARARGS, "add_to_bins(values, weights, bins, shift): add the weights to bins."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "_loops", "Compiled loops; see _loops.pyi.", -1, functions, NULL, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__loops(void) { return PyModule_Create(&definition); }
