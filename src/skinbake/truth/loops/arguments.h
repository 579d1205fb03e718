/* How the loops take numpy's arrays, and how they end. */

#pragma once

#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030B0000
#include <Python.h>

#include <float.h>
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "../../processors.h"

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

/* Tell whether B rows from `first` on are among V rows. If not, raise ValueError. */
static int has_rows(const Py_ssize_t *sizes, Py_ssize_t first)
{
    if (first >= 0 && SIZE('B') <= SIZE('V') && first <= SIZE('V') - SIZE('B'))
        return 1;
    PyErr_SetString(PyExc_ValueError, "out has fewer rows than are asked for");
    return 0;
}
