/* The loops of `skinbake verify` that visit every vertex in every pose, for arrays that numpy owns.

   The headers in loops/ hold them. Each function has a twin in by_numpy.py. The twin is the definition, the oracle
   of the tests, and the code that runs if this module could not be compiled. The headers share neither code nor
   formulas with those of gradients/loops/, because an error in one must not hide in both.

   Arrays come in through the buffer protocol: contiguous, aligned, of the types that _loops.pyi says. V are
   vertices, P are poses. All values of a vertex lie together, pose by pose, so that the innermost loops run
   over poses, and compilers turn them into vectors. A function works on a range of vertices or classes, and
   writes to that range alone. The GIL is released meanwhile, so several threads can share a mesh. Every index
   is checked just before it is used.

   Only the limited API of Python 3.11 is used. Compile without fast-math and without contraction to fused
   multiply-adds: the same input gives the same bytes on every machine. */

#include "loops/angles.h"
#include "loops/class_sums.h"
#include "loops/counting.h"
#include "loops/gradient_rows.h"
#include "loops/linear_blend.h"
#include "loops/scaled_joints.h"
#include "loops/true_normals.h"

static PyMethodDef functions[] = {
    {"blend", blend, METH_VARARGS,
     "blend(joints, weights, points, directions, changes, table, out, first_row): fill rows of out."},
    {"blended_normals", blended_normals, METH_VARARGS,
     "blended_normals(joints, weights, points, directions, changes, table, normals, out): fill out."},
    {"dqs_positions", dqs_positions, METH_VARARGS,
     "dqs_positions(motions, scales, joints, weights, positions, out, first, first_row): fill rows of out."},
    {"dqs_normals", dqs_normals, METH_VARARGS, "dqs_normals(...): fill out; see _loops.pyi."},
    {"gradient_rows", gradient_rows, METH_VARARGS, "gradient_rows(...): fill starts, columns and values; see _loops.pyi."},
    {"class_sums", class_sums, METH_VARARGS,
     "class_sums(positions, triangles, met, classes, sums, first_class, class_count, flat): fill part of sums."},
    {"true_normals", true_normals, METH_VARARGS, "true_normals(...): fill normals and exist; see _loops.pyi."},
    {"angles", angles, METH_VARARGS, "angles(x, y, z, expected, angles): fill angles, in degrees."},
    {"count_errors", count_errors, METH_VARARGS,
     "count_errors(errors, weights, valid, bins): fill bins; return counts; see _loops.pyi."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "_loops", "Compiled loops; see _loops.pyi.", -1, functions, NULL, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__loops(void)
{
    PyObject *module = PyModule_Create(&definition);
    vector_bits = find_vector_bits();
    if (module != NULL && PyModule_AddIntConstant(module, "VECTOR_BITS", vector_bits) < 0)
        Py_CLEAR(module);
    return module;
}
