"""Mapped normals of the replay, at every pixel: what engines should draw of a relief of constant tilt."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from fixtures.make_fixtures import FOLDER
from skinbake.skinning.components import PosedVertex
from skinbake.skinning.normal_maps import engine_mapped_normal, in_frame, mapped_normal
from skinbake.skinning.rest import Algorithm
from tests.support.baked_files import Editable
from tests.support.characters import Array, Character, Placement, angles, unit
from tests.support.rasterised import covering, eroded
from tests.support.replay import replay

TILT = 25.0
TEXELS = tuple(
    tuple(
        round(127.5 + 127.5 * part)
        for part in (
            np.sin(np.radians(TILT)) * np.cos(turn),
            np.sin(np.radians(TILT)) * np.sin(turn),
            np.cos(np.radians(TILT)),
        )
    )
    for turn in np.radians([20, 110, 200, 290])
)
"""Bytes of texels that tilt the normal by 25° in four directions."""


def texel_normal(texel: tuple[int, ...]) -> Array:
    """Return the normal that a shader makes of the bytes of a texel."""
    return np.array(texel) / 127.5 - 1.0


@dataclass(frozen=True)
class Columns:
    """What mapped normals are made of at each vertex: the images of TANGENT, its bitangent, and n0, (V, 3).

    They are covectors of the world, of any length: m' = m_x t + m_y b + m_z n.
    """

    t: Array
    b: Array
    n: Array

    def carried(self, inverse: np.ndarray) -> Columns:
        """Return them after a linear map of space, given by its inverse (3, 3)."""
        return Columns(self.t @ inverse, self.b @ inverse, self.n @ inverse)


def columns(character: Character, algorithm: Algorithm, placement: Placement) -> Columns:
    """Return the columns of a character in its pose, in the world. Its file has TANGENT.

    A joint that mirrors turns all three outside, as J⁻ᵀ n is.
    """
    assert character.tangents is not None
    rest, matrices = character.rest, character.matrices(placement)[None]
    at_rest = character.unmorphed
    posed = replay(algorithm, rest, matrices, normal_map=True)
    assert posed.cotangents is not None
    assert posed.cobitangents is not None
    given = (posed.normals, posed.tangents, posed.bitangents, posed.cotangents, posed.cobitangents)
    vertex = PosedVertex((), *(tuple(vectors[0].T) for vectors in given))
    tangent = tuple(character.tangents.T.astype(np.float64))
    frame = [tuple(v.T.astype(np.float64)) for v in (at_rest.tangents, at_rest.bitangents, at_rest.normals)]
    length = np.linalg.norm(at_rest.tangents, axis=1)
    if algorithm.uses_dual_quaternions:
        length = length * np.cbrt(np.linalg.det(matrices[0, 0, :3, :3]))
    found = []
    for axis in np.eye(3):
        # What morph targets turn, TANGENT is not: its parts in the frame at rest stay.
        drawn = engine_mapped_normal(frame[2], tangent[:3], tangent[3], tuple(axis))
        found.append(np.stack(mapped_normal(vertex, length, in_frame(drawn, *frame)), axis=1))
    side = np.sign(np.linalg.det(matrices[0, rest.joints[:, 0], :3, :3]))[:, None]
    return Columns(*(side * vectors for vectors in found)).carried(np.linalg.inv(placement.world[:3, :3]))


def pixels(varying: Columns, texel: tuple[int, ...], corners: np.ndarray, shares: Array) -> Array:
    """Return the mapped normals (H, W, 3) between the vertices, interpolated as three.js does.

    Directions have length 1 at the vertices and again at the pixel. Lengths over the normal's vary beside.
    """
    x, y, z = texel_normal(texel)
    size = np.linalg.norm(varying.n, axis=1)
    total = np.zeros((*shares.shape[:2], 3))
    for part, vectors in ((x, varying.t), (y, varying.b), (z, varying.n)):
        lengths = np.linalg.norm(vectors, axis=1)
        direction = np.einsum("hwk,hwki->hwi", shares, unit(vectors)[corners])
        direction /= np.maximum(np.linalg.norm(direction, axis=-1, keepdims=True), 1e-9)
        total += part * np.einsum("hwk,hwk->hw", shares, (lengths / size)[corners])[..., None] * direction
    return total


def look_at(
    character: Character, placement: Placement, direction: tuple[float, float, float]
) -> tuple[Array, Array]:
    """Return a projection and a view (4, 4) of the whole character, orthographic, from a direction."""
    points = character.positions(placement)
    back = unit(np.array([direction]))[0]
    right = unit(np.cross([0.0, 1.0, 0.0], back)[None])[0]
    view = np.eye(4)
    view[:3, :3] = [right, np.cross(back, right), back]
    seen = points @ view[:3, :3].T
    view[:3, 3] = -0.5 * (seen.max(axis=0) + seen.min(axis=0))
    half = 0.52 * np.ptp(seen, axis=0).max()
    return np.diag([1 / half, 1 / half, -1 / half, 1.0]), view


def relief_seen(
    character: Character,
    algorithm: Algorithm,
    placement: Placement,
    camera: tuple[Array, Array],
    drawn: Array,
    texel: tuple[int, ...],
) -> tuple[Array, Array, Callable[[Array], Array]]:
    """Return normals (P, 3) of the pixels that a page has drawn, in the world, and what they should be.

    drawn (H, W, 4) are normals in view space, row by row from the top, and 1 where there is any. The third
    result interpolates vectors of vertices (V, 3) in these pixels.
    """
    view = camera[1]
    both, corners, shares = covered_by(character, algorithm, placement, camera, drawn[..., 3] == 1)
    expected = pixels(columns(character, algorithm, placement), texel, corners, shares)

    def between(vectors: Array) -> Array:
        return np.asarray(np.einsum("pk,pki->pi", shares[both], vectors[corners[both]]))

    return np.asarray(drawn[both][:, :3] @ view[:3, :3], np.float64), expected[both], between


def covered_by(
    character: Character,
    algorithm: Algorithm,
    placement: Placement,
    camera: tuple[Array, Array],
    seen: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, Array]:
    """Return which of the seen pixels (H, W) are of one triangle, its corners, and their shares (H, W, 3).

    Beside edges of triangles, a pixel may be that of either: they are left out.
    """
    (projection, view), (height, width) = camera, seen.shape
    points = np.insert(character.positions(placement, algorithm), 3, 1, axis=1) @ (projection @ view).T
    places = (points[:, :3] * [1, -1, 1] * 0.5 + 0.5) * [width, height, 1]
    mirrors = bool(np.linalg.det(placement.world[:3, :3]) < 0)
    covered, corners, shares = covering(
        places, points[:, 3], character.triangles, (width, height), clockwise=mirrors
    )
    both = eroded(covered & seen, 1) & (shares.min(axis=-1) > 0.01)
    assert both.mean() > 0.1
    return both, corners, shares


def with_relief(folder: Path, texel: tuple[int, ...]) -> Path:
    """Give the tube TANGENT, and a normal map of one texel."""
    file = Editable(FOLDER / "bent_tube.glb")
    normals = file.array("NORMAL").copy()
    tangents = unit(np.cross(normals, [0.3, 0.2, 0.9]))
    signed = np.column_stack([tangents, np.full(len(normals), -1.0)])
    attributes = file.primitive()["attributes"]
    attributes["TANGENT"] = file.add(signed.astype(np.float32))
    attributes["TEXCOORD_0"] = file.add(np.full((len(normals), 2), 0.5, np.float32))
    image = io.BytesIO()
    Image.new("RGB", (1, 1), texel).save(image, "PNG")
    uri = f"data:image/png;base64,{base64.b64encode(image.getvalue()).decode()}"
    file.content |= {"images": [{"uri": uri}], "textures": [{"source": 0}]}
    file.content["materials"][file.primitive()["material"]]["normalTexture"] = {"index": 0}
    return file.write(folder / "relief.glb")


def unfolded(high: Array) -> Array:
    """Return vectors (H, W, 3) of places (H, W, 2) of directions on the octahedron, from -1 to 1."""
    up = 1 - np.abs(high).sum(axis=-1, keepdims=True)
    folded = (1 - np.abs(high[..., ::-1])) * np.where(high < 0, -1.0, 1.0)
    return np.concatenate([np.where(up >= 0, high, folded), up], axis=-1)


def relief_angles(
    character: Character, algorithm: Algorithm, texel: tuple[int, ...], matrix: Array, drawn: Array
) -> Array:
    """Return the angles in degrees of normals (H, W, 3) that were drawn to those of the replay, (P,).

    matrix (4, 4) leads to the screen. Pixels beside edges are left out: samples of both sides mix there.
    """
    height, width = drawn.shape[:2]
    points = character.positions(Placement(), algorithm)
    clip = np.insert(points, 3, 1, axis=1) @ matrix.T
    places = (clip[:, :3] / clip[:, 3:] * [1, -1, 1] * 0.5 + 0.5) * [width, height, 1]
    covered, corners, shares = covering(places, clip[:, 3], character.triangles, (width, height))
    inside = eroded(covered, 3) & (shares.min(axis=-1) > 0.15)
    wanted = pixels(columns(character, algorithm, Placement()), texel, corners, shares)
    return np.asarray(angles(drawn[inside], wanted[inside]))
