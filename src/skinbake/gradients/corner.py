"""What a triangle's corner adds to the gradient at its vertex (twin: ``loops/corners.h``, in another form).

A corner has the edges e1, e2 to the two other corners. Let n = e1 × e2 and A2 = |n|, twice the area. A
function that is linear on the triangle, with the values w0 at the corner and w1, w2 at the ends of e1, e2,
has the gradient

    ∇w = (w1 − w0) (e2 × n) / A2² + (w2 − w0) (n × e1) / A2²

The two vectors are the gradients of hats. A hat is the linear function that is 1 at one corner and 0 at both
others. The first hat is 1 at the end of e1, the second at the end of e2.

The vertex takes the mean of its corners' ∇w. Four weightings are options of bake. The default is Max's, A2 /
(|e1|² |e2|²): N. Max, *Weights for Computing Vertex Normals from Facet Normals*, Journal of Graphics Tools
4(2), 1999. Only the fit to a rig (ring_turns.py) takes a fifth one, ROOT: A2 / (|e1| |e2|)^1.5. It lies
between Max's weights, which are sin θ / (|e1| |e2|), and the angles θ.
"""

from __future__ import annotations

from typing import Any

import numpy as np

MAX, ANGLE, AREA, ANGLE_AREA, ROOT = range(5)
WEIGHTINGS = {"max": MAX, "angle": ANGLE, "area": AREA, "angle-area": ANGLE_AREA}


def corner_coefficients(e1: Any, e2: Any, weighting: int) -> Any:
    """Return (weight, c1, c2) of a corner: its weight, and the weight times the gradients of both hats.

    e1, e2 are the edges at the corner, each a triple of components: numbers, or arrays (N,) of N corners. c1
    and c2 are such triples too. The corner adds c1 (w1 − w0) + c2 (w2 − w0) to the vertex's sum. The triangle
    must have an area. weighting is MAX, ANGLE, AREA, ANGLE_AREA or ROOT.
    """
    e1x, e1y, e1z = e1
    e2x, e2y, e2z = e2
    nx = e1y * e2z - e1z * e2y
    ny = e1z * e2x - e1x * e2z
    nz = e1x * e2y - e1y * e2x
    squared_area2 = nx * nx + ny * ny + nz * nz
    area2 = np.sqrt(squared_area2)
    squared_lengths = (e1x * e1x + e1y * e1y + e1z * e1z) * (e2x * e2x + e2y * e2y + e2z * e2z)
    if weighting == MAX:
        weight = area2 / squared_lengths
    elif weighting == ROOT:
        weight = area2 / (np.sqrt(squared_lengths) * np.sqrt(np.sqrt(squared_lengths)))
    elif weighting == AREA:
        weight = area2
    else:
        weight = np.arctan2(area2, e1x * e2x + e1y * e2y + e1z * e2z)
        if weighting == ANGLE_AREA:
            weight = weight * area2
    scale = weight / squared_area2
    c1 = ((e2y * nz - e2z * ny) * scale, (e2z * nx - e2x * nz) * scale, (e2x * ny - e2y * nx) * scale)
    c2 = ((ny * e1z - nz * e1y) * scale, (nz * e1x - nx * e1z) * scale, (nx * e1y - ny * e1x) * scale)
    return weight, c1, c2
