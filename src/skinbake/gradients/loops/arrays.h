/* How the loops take numpy's arrays, and how they end. */

#pragma once

#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030B0000
#include <Python.h>

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#if defined(__linux__)
#include <sys/mman.h>
#endif

#include "../../processors.h"

#if defined(_MSC_VER)
#define PREFETCH(address) ((void)0)
#else
#define PREFETCH(address) __builtin_prefetch(address)
#endif

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

/* ---- Memory -------------------------------------------------------------------------------------------- */

/* Zeros, on large pages where the system has them: first touched page by page, they take as long as all work on
   them. NULL without memory. */
static void *allocate_zeros(size_t count, size_t size)
{
    char *memory = calloc(count, size);
#if defined(MADV_HUGEPAGE)
    const size_t page = 1 << 21, skipped = (page - (uintptr_t)memory % page) % page;
    if (memory && count * size >= skipped + page)
        madvise(memory + skipped, (count * size - skipped) / page * page, MADV_HUGEPAGE);
#endif
    return memory;
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
