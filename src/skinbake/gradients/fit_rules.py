"""The constants of the fit to a rig, with the letters of docs/fitted.md. The compiled loops get them, too.

They were chosen on 22 real characters and on tubes that have a formula, in clips and in random poses of ±30°
and ±60°, by one rule: no model may be worse than with the surface's gradients by over 2 %, by either truth.
What was tried besides, and was no better:

- the weights of triangles of either truth, in place of those between both, or the mean of both true normals;
- turns about the stored pose, in place of those about the bind pose;
- a pull of each slot by itself: it depends on the slot that is left out, and an adopted joint changed it;
- a pull to 0, or one that grows with the length of bones: both helped some files and harmed others;
- twists that count less than bends: 0.01 better in clips, and as much worse in random poses.
"""

STIFFNESS = 0.12
"""λ where no joint is missing: the share of a turn's squared lever that pulls to the surface's gradients.

With 0.06 a model breaks the rule; 0.24 leaves more error.
"""

TOGETHER = 10.0
"""How much more it counts that all joints of a long chain C turn alike than that one joint j turns.

Animators curl tails and tentacles. Single turns alone leave a tentacle with three times the error of the
surface's gradients.
"""

MISSING = 15.0
"""How much λ grows with m, the share of a vertex's gradients whose joints have no slot there.

The fit would let another joint stand in for a missing one, because both turn when their parent does. In clips
they turn differently.
"""

DOUBT = 0.01
"""e0 on edged surfaces: the tilt of tangents, for each radian of a turn, of which the fit takes half.

The true normals of a mesh are themselves off a smooth surface. So a fit would spoil gradients whose tangents
follow them this closely. Of a tilt e, the fit takes the share e² / (e² + e0²).
"""

SMOOTH, MOST_DOUBT = 0.2, 4.0
"""The spread of the triangles' normals below which a surface is smooth, and how much the doubt grows there.

The spread s of a class is 1 − |Σ area × normal| / Σ area. There e0 is (SMOOTH / s)³ times DOUBT, but at least
DOUBT, and at most MOST_DOUBT times it. Triangles that lie nearly in one plane stand for a smooth surface, and
the gradient follows that surface better than they do.
"""

STORED = 10.0
"""How much more the stored pose counts than that one joint turns by a radian: as a turn by 18° does."""

STRETCHED = 4.0001
"""The factor by which the stored pose may change the squared lengths of tangents.

It is a little over 4: some poses scale a joint by 2, and rounding must not decide whether they count.

Some exporters store nodes in no pose at all, and leave it to the clips to set them. There surfaces collapse,
or are torn apart.
"""

EVEN = 1e-4
"""A pull at every slot, a share of that of all turns. It decides where no turn parts two slots."""

FAINT = 0.1
"""The presence q below which a joint's gradient is pulled harder, by the inverse square of q.

The presence of a joint at a vertex is its weight there, plus its share of the gradients' lengths. A joint
that is hardly there would make up for errors of others, at the end of a long lever.
"""

UNFELT = 1e-4
"""The presence up to which a joint is not fitted."""

NARROW = 0.2
"""The area between the two derivatives of the positions up to which a class keeps its gradients.

The fit divides by it. It is 1 where triangles and authored normals agree, and near 0 where these lie in the
plane of those. Of 200,000 random rings of three to six corners, folded ones too, those below get up to 3,000
times the gradient, and those above at most 8 times. At 0.1 it would be 13 times. Whether both normals of the
triangles agree does not tell: there were 600 times the gradient where they differ by less than 30°.
"""

FLAT = 1e-6
"""A share that counts as 0.

A class has no normal of its own if its triangles' normals or its vertices' normals cancel out but for this
share, or if its triangles are slivers: twice their areas are this share of their edges' products. The spread
counts as FLAT at least.

Its square is the share of terms up to which what is left of them is rounding: a pivot of the least squares,
or the area of a class in the stored pose. There compiled loops and numpy would choose differently.
"""
