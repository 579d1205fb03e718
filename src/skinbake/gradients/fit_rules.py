"""The constants of the fit to a rig, with the letters of docs/fitted.md. The compiled loops get them, too.

``python -m benchmarks.fit_aims`` chose them: on the real characters of the test corpus, in clips and in
random poses of ±30° and ±60°, by the largest regret over all three truths, with families of characters left
out. A rule is here if it takes 1 % off a mean, saves a file from harm, or guards against rounding. What was
tried besides, and was no better:

- a pull that grows with the gradients of joints that no slot has, or at joints that are hardly there;
- a part of the change that depends on its size, or on how smooth the triangles are;
- the weights of triangles of either truth, in place of those between both, or the mean of both true normals;
- turns about the stored pose, in place of those about the bind pose;
- a pull of each slot alone, in place of that of turns: 0.01 worse by the smooth surface;
- a pull to 0, or one that grows with the length of bones: both helped some files and harmed others;
- a part of the change that grows with the share of the error that it takes away: 0.005 better;
- twists that count less than bends: 0.01 better in clips, and as much worse in random poses.
"""

DRAWN = 0.5
"""The part of the drawn mesh in the aim. The smooth surface that it stands for has the rest.

For the smooth surface, the gradient of the surface is best. The sum of both squared errors is least at the
mean of the best α of each, so the fit takes this part of the way from the gradient.
"""

STIFFNESS = 0.12
"""λ: the share of a turn's squared lever that pulls to the surface's gradients.

With 0.03 or 0.25, and a part of the drawn mesh to match, the errors are the same within 1 %.
"""

TOGETHER = 10.0
"""How much more it counts that all joints of a long chain C turn alike than that one joint j turns.

Animators curl tails and tentacles. Single turns alone leave a tentacle with twice the error of the surface's
gradients.
"""

STORED = 10.0
"""How much more the stored pose counts than that one joint turns by a radian: as a turn by 18° does."""

STRETCHED = 4.0001
"""The factor by which the stored pose may change the squared lengths of tangents.

It is a little over 4: some poses scale a joint by 2, and rounding must not decide whether they count.

Some exporters store nodes in no pose at all, and leave it to the clips to set them. There surfaces collapse,
or are torn apart.
"""

EVEN = 1e-5
"""A pull at every slot: a share of the squared levers of all turns. It decides if no turn parts two slots."""

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

FLAT = 1e-6
"""A share that counts as 0.

A class has no normal of its own if its triangles' normals or its vertices' normals cancel out but for this
share, or if its triangles are slivers: twice their areas are this share of their edges' products.

Its square is the share of terms up to which what is left of them is rounding: a pivot of the least squares,
or the area of a class in the stored pose. There compiled loops and numpy would choose differently.
"""
