/* Rows of the gradient operator (twin: by_numpy.gradient_rows). */

#pragma once

#include "vectors.h"

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
    /* area is twice that of the triangle. A common factor of all weights does not matter. */
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
    /* places may hold what an earlier row has left there. */
    if (place < g->starts[row] || place >= *end || g->columns[place] != column) {
        if (*end >= g->room)
            return 1;
        place = g->places[column] = (*end)++;
        /* A new entry begins at zero, in every direction. */
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
    /* The vertices of the triangle, from the corner on. */
    for (int turn = 0; turn < 3; turn++) {
        at[turn] = g->triangles[3 * (Py_ssize_t)(corner / 3) + (corner + turn) % 3];
        if (at[turn] < 0 || at[turn] >= g->vertices)
            return 1;
    }
    /* Two edges from the corner, and the normal that is twice the area long. */
    const Vector here = vertex_at(g->positions, at[0]);
    const Vector e1 = minus(vertex_at(g->positions, at[1]), here), e2 = minus(vertex_at(g->positions, at[2]), here);
    const Vector normal = cross(e1, e2);
    const double square = dot(normal, normal);
    /* The share of the corner in the mean of its class, and 1 / |n|² of the gradients. */
    const double share = corner_weight(e1, e2, sqrt(square), g->weighting) / total / square;
    /* ∇ of the hat functions: (e2 × n) / |n|² and (n × e1) / |n|². The three sum up to zero. */
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
        /* The corners that meet at the class of the row. */
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
