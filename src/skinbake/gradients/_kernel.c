/* The loops of `skinbake bake` that visit every vertex, triangle or corner, on the memory of numpy's arrays.

   The headers in loops/ hold them. Each function has a twin in numpy (named there), which is the definition, the
   test's oracle, and the code that runs if this module could not be compiled. Here the same mathematics makes one
   pass over memory. When a vertex is done, its corners and gradients are forgotten.

   loops/surface.h has the data. bake_surface.h goes through the weld classes: corners.h and ring.h sum up the
   gradients of one class, slots.h says where they go, and vertex_fit.h fits them to the rig.

   Arrays come in through the buffer protocol: contiguous, aligned, and of the types that
   _kernel.pyi says. The GIL is released while a function works. Only the limited API of Python
   3.11 is used, so that one binary serves all later versions. Compile without fast-math and without
   contraction to fused multiply-adds: the same input gives the same bytes on every machine. */

#include "loops/areas.h"
#include "loops/bake_surface.h"
#include "loops/equal_rows.h"
#include "loops/influences.h"

static PyMethodDef functions[] = {
    {"label_equal_rows", label_equal_rows, METH_VARARGS,
     "label_equal_rows(rows, labels): fill labels, return how many there are."},
    {"normalise_influences", normalise_influences, METH_VARARGS,
     "normalise_influences(joints, weights, free, adopting_sum, adopting_weight, tolerance, least): in place; "
     "return the defects by name."},
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
    vector_bits = find_vector_bits();
    collision_error = PyErr_NewException("skinbake.gradients._kernel.CollisionError", PyExc_RuntimeError, NULL);
    if (collision_error == NULL || PyModule_AddObjectRef(module, "CollisionError", collision_error) < 0 ||
        PyModule_AddIntConstant(module, "VECTOR_BITS", vector_bits) < 0 ||
        PyModule_AddIntConstant(module, "BY_MAX", BY_MAX) < 0 ||
        PyModule_AddIntConstant(module, "BY_ANGLE", BY_ANGLE) < 0 ||
        PyModule_AddIntConstant(module, "BY_AREA", BY_AREA) < 0 ||
        PyModule_AddIntConstant(module, "BY_ANGLE_AREA", BY_ANGLE_AREA) < 0) {
        Py_DECREF(module);
        return NULL;
    }
    return module;
}
