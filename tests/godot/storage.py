"""What Godot makes of a character when it stores it: weights, normals and tangents in 16 bits.

Normals and tangents are octahedral (Z. Cigolle et al., "A Survey of Efficient Representations for Independent
Unit Vectors", JCGT 3(2), 2014). The sign of a bitangent takes one bit of its tangent's second number.
"""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np

from skinbake.choices import Frame
from tests.support.characters import Array, Character, unit

LARGEST = 65535.0


def as_stored(character: Character) -> Character:
    """Return the character as the add-on reads it: in the normal frame, it keeps normals in float32."""
    found = copy.copy(character)
    found.rest = replace(
        character.rest, weights=weights_as_stored(np.asarray(character.rest.weights, np.float64))
    )
    if character.frame == Frame.TANGENT:
        assert character.tangents is not None
        side = np.asarray(character.tangents[:, 3:], np.float64)
        normals = octahedral(np.asarray(character.rest.normals, np.float64))
        tangents = octahedral_with_sign(np.asarray(character.tangents[:, :3], np.float64), side[:, 0])
        bitangents = np.cross(normals, tangents) * side
        found.rest = replace(found.rest, normals=normals, tangents=tangents, bitangents=bitangents)
    return found


def weights_as_stored(weights: Array) -> Array:
    stored = np.floor(np.clip(weights * LARGEST, 0, LARGEST)) / LARGEST
    return np.asarray(stored / stored.sum(axis=1, keepdims=True))


def octahedral(vectors: Array) -> Array:
    return decoded(np.floor(encoded(vectors) * LARGEST) / LARGEST)


def octahedral_with_sign(vectors: Array, side: Array) -> Array:
    pairs = encoded(vectors)
    above = np.maximum(pairs[:, 1], 1 / 32767.0) * 0.5 + 0.5
    pairs[:, 1] = np.where(side >= 0, above, 1 - above)
    stored = np.floor(pairs * LARGEST) / LARGEST
    stored[:, 1] = np.abs(stored[:, 1] * 2 - 1)
    return decoded(stored)


def encoded(vectors: Array) -> Array:
    """Return the point (V, 2) of the unit square for each unit vector."""
    x, y, z = (vectors / np.abs(vectors).sum(axis=1, keepdims=True)).T
    folded = np.where(
        z >= 0,
        [x, y],
        [(1 - np.abs(y)) * np.where(x >= 0, 1, -1), (1 - np.abs(x)) * np.where(y >= 0, 1, -1)],
    )
    return np.asarray(folded.T * 0.5 + 0.5)


def decoded(pairs: Array) -> Array:
    x, y = (2 * pairs - 1).T
    z = 1 - np.abs(x) - np.abs(y)
    under = np.maximum(-z, 0)
    return unit(np.stack([x - np.copysign(under, x), y - np.copysign(under, y), z], axis=1))
