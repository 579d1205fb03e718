"""The constants of the fit, with the letters of fit.py. The compiled loops get them, too.

They were chosen on real characters, in clips and in random poses of ±30°, by both truths of the drawn mesh
and, on analytic tubes, by formula. A rule is here if it takes 1 % off a mean, saves a file from harm, or
guards against rounding. What was tried besides, and was no better:

- the normals of the posed mesh itself as the aim, in place of those across the sums over the ring;
- poses that count by the inverse of their error: random poses were 1.5 times as bad;
- clips alone: a character was 1.6 times as bad at ±30°;
- least squares that are weighted again by what they leave, and no pull at all;
- a ray to standard lighting by the clips alone, and one that only some primitives get;
- half of the change alone, for the smooth surface that the triangles stand for;
- poses that do not count where they stretch tangents, and a pull of each slot alone.
"""

STIFFNESS = 0.25
"""λ: the share of a tangent's motion that pulls to the surface's gradients.

0.12 follows the drawn triangles 4 % better, and the surface that they stand for worse, by formula.
"""

TURN = 0.2
"""The angle in radians by which each joint turns beside what the poses show.

A smaller one lights the clips better, and other poses worse.
"""

TOGETHER = 10.0
"""How much more it counts that all joints of a long chain C turn alike than that one joint j turns.

Animators curl tails and tentacles. Single turns alone leave a tentacle with three times the error.
"""

COLLAPSED = 0.1
"""The squared length of tangents, as a share of that under single joints, below which they count no more.

Where a fold collapses, a short tangent may have any direction, and would outweigh all other poses.
"""

RAY = 1.5
"""The part of α and β that is kept, over the best part for the poses and turns of the fit.

At 2 the fit would be as good there as standard lighting. At 1 it costs 7 % by formula.

By the turns alone it is twice as much: what harms most turns must not stay for the clips' sake. Without that,
17 of 176 tubes are lit worse than by standard lighting outside their clips, and with it none, by the drawn
triangles. In their clips twelve characters lose 1.6 % by it in the mean, and one of them 17 %.
"""

EVEN = 1e-9
"""A pull at every slot, as a share of all others. It decides where no pose and no turn parts two slots."""

UNFELT = 1e-4
"""The presence up to which a joint is not fitted.

It is the joint's weight, plus its share of the gradients' lengths. A gradient of 0 may be a little more by
rounding, which must not decide whether the joint helps to follow the triangles.
"""

NARROW = 0.2
"""The area between the two derivatives of the positions up to which a class keeps its gradients.

The fit divides by it. It is 1 where triangles and authored normals agree, and near 0 where these lie in the
plane of those. Of 200,000 random rings of three to six corners, folded ones too, those below get up to 3,000
times the gradient, and those above at most 8 times. At 0.1 it would be 13 times. Whether both normals of the
triangles agree does not tell: there were 600 times the gradient where they differ by less than 30°.
"""

BOUNDED = 3.0
"""The largest change of a vertex's gradients by a fit, over what the surface has there.

That is its largest gradient at the vertex, or the steepest slope of a weight along an edge from it. At the
pivots of its joints a vertex hardly moves, so the least squares finds no number too large: there were 200,000
times the gradient. On a GPU they are noise. Of 75,000 vertices of the corpus 44 reach 3, and nothing is lit
worse by it; with 2 a model loses 0.2 %, with 1 it would lose 2 %.
"""

SMALL = 0.02
"""The change of a vertex's gradients of which half is dropped, over its largest gradient there.

A change far below the gradient is noise of the least squares: the triangles of a fine mesh stand for a smooth
surface, which the gradient knows better. Without it 176 tubes have 21 % more error by formula in their clips
than with ``surface``, with it 6 %; coarse characters lose 0.2 % by triangles. 0.03 gains little more.
"""

FLAT = 1e-6
"""A share that counts as 0.

A class has no normal of its own if its triangles' normals or its vertices' normals cancel out but for this
share, or if its triangles are slivers: twice their areas are this share of their edges' products.

Its square is the share of terms up to which what is left of them is rounding: a pivot of the least squares,
or the area of a class in the stored pose. There compiled loops and numpy would choose differently.
"""

FLAT_TILT = 1e-12
"""The mean squared sine up to which α and β do nothing, and none of them needs to shrink."""
