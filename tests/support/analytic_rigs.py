"""Tubes on chains of joints, whose normals are known by formula in every pose."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from skinbake.geometry.skinned import Float64Array
from tests.measure import stiff_models
from tests.measure.stiff_models import FRAMES, Mesh, Motion

SHAPES = ("cylinder", "cone", "bumps", "ellipse")
MOTIONS = ("bend", "twist", "stretch", "all")


@dataclass(frozen=True)
class Tube:
    """A tube along z around up to four joints, which its clip bends, twists, stretches, or all of these.

    The seed chooses how fine it is, how steep its weights are, and how far its joints move. The surface is
    p(θ, z) = (a r cos θ, r sin θ / a, z) with a radius r(θ, z), and the weights are Gaussians along z.
    """

    shape: str
    motion: str
    seed: int
    generator: np.random.Generator = field(init=False, repr=False, compare=False)
    rings: int = field(init=False)
    sides: int = field(init=False)
    joints: int = field(init=False)
    spread: float = field(init=False)
    lobes: int = field(init=False)

    def __post_init__(self) -> None:
        names = SHAPES.index(self.shape), MOTIONS.index(self.motion)
        generator = np.random.default_rng([self.seed, *names])
        chosen = {
            "generator": generator,
            "rings": int(np.exp(generator.uniform(np.log(5), np.log(32)))),
            "sides": int(np.exp(generator.uniform(np.log(5), np.log(24)))),
            "joints": int(generator.integers(2, 5)),
            "spread": float(np.exp(generator.uniform(np.log(0.15), np.log(1.2)))),
            "lobes": int(generator.integers(2, 4)),
        }
        for name, value in chosen.items():
            object.__setattr__(self, name, value)

    @property
    def name(self) -> str:
        return f"{self.shape}, {self.motion}, {self.seed}"

    @property
    def origins(self) -> Float64Array:
        """The origins (J, 3) of the joints: each bone has the length 1."""
        return np.column_stack([np.zeros((self.joints, 2)), np.arange(self.joints)])

    @property
    def parameters(self) -> tuple[Float64Array, Float64Array]:
        """θ and z of the vertices (V,), ring by ring."""
        around = np.arange(self.sides) * 2.0 * np.pi / self.sides
        up = np.linspace(0.0, float(self.joints), self.rings)
        return np.tile(around, self.rings), np.repeat(up, self.sides)

    def surface(
        self, parameters: tuple[Float64Array, Float64Array] | None = None
    ) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Return p, p_θ and p_z, (V, 3) each, at the vertices or at other θ and z."""
        theta, z = parameters or self.parameters
        cos, sin, one, zero = np.cos(theta), np.sin(theta), np.ones_like(theta), np.zeros_like(theta)
        radius, by_theta, by_z, a = 0.4 * one, zero, zero, 1.0
        if self.shape == "cone":
            radius, by_z = 0.5 - 0.35 * z / self.joints, -0.35 / self.joints * one
        elif self.shape == "bumps":
            wave, up = self.lobes * theta, 2.0 * z
            radius = 0.4 * (1.0 + 0.15 * np.cos(wave) * np.sin(up))
            by_theta = -0.06 * self.lobes * np.sin(wave) * np.sin(up)
            by_z = 0.12 * np.cos(wave) * np.cos(up)
        elif self.shape == "ellipse":
            a = 1.3
        return (
            np.stack([a * radius * cos, radius * sin / a, z], axis=1),
            np.stack(
                [a * (by_theta * cos - radius * sin), (by_theta * sin + radius * cos) / a, zero], axis=1
            ),
            np.stack([a * by_z * cos, by_z * sin / a, one], axis=1),
        )

    def weights(self, z: Float64Array | None = None) -> tuple[Float64Array, Float64Array]:
        """Return the weights of the joints (V, J) at the vertices or at other z, and their derivatives."""
        apart = (self.parameters[1] if z is None else z)[:, None] - (np.arange(self.joints) + 0.5)
        powers = -0.5 * np.square(apart / self.spread)
        falling = np.exp(powers - powers.max(axis=1, keepdims=True))
        weights = falling / falling.sum(axis=1, keepdims=True)
        slopes = -apart / self.spread**2
        return weights, weights * (slopes - (weights * slopes).sum(axis=1, keepdims=True))

    def normals(self, matrices: Float64Array) -> Float64Array:
        """Return the normals (P, V, 3) under joint matrices (P, J, 4, 4), of any length."""
        p, by_theta, by_z = self.surface()
        weights, slopes = self.weights()
        turned = np.einsum("vj,pjab->pvab", weights, matrices[..., :3, :3])
        moved = np.einsum("pjab,vb->pvja", matrices[..., :3, :3], p) + matrices[:, None, :, :3, 3]
        along = np.einsum("pvab,vb->pva", turned, by_z) + np.einsum("vj,pvja->pva", slopes, moved)
        return np.cross(np.einsum("pvab,vb->pva", turned, by_theta), along)

    def write(self, folder: Path) -> Path:
        """Write the model with its clip."""
        p, by_theta, by_z = self.surface()
        outward = np.cross(by_theta, by_z)
        ring, side = np.divmod(np.arange((self.rings - 1) * self.sides), self.sides)
        a, b = ring * self.sides + side, ring * self.sides + (side + 1) % self.sides
        triangles = np.concatenate(
            [np.stack([a, b, b + self.sides], 1), np.stack([a, b + self.sides, a + self.sides], 1)]
        )
        padding = (0, 0), (0, 4 - self.joints)
        mesh = Mesh(
            p,
            outward / np.linalg.norm(outward, axis=1, keepdims=True),
            triangles,
            np.pad(np.tile(np.arange(self.joints), (len(p), 1)), padding),
            np.pad(self.weights()[0], padding),
            self.origins,
        )
        return stiff_models.write(folder / f"{self.name}.glb", mesh, list(self.motions()))

    def motions(self) -> Iterator[Motion]:
        """Yield what the clip does to the joints but the first."""
        generator, amount = self.generator, self.generator.uniform(0.3, 1.0)
        for joint in range(1, self.joints):
            wave = np.sin(np.linspace(0, 2 * np.pi, FRAMES) + generator.uniform(0, 6))
            angle = generator.uniform(0, 2 * np.pi)
            half, axis = np.radians(35.0) * amount * wave, [np.cos(angle), np.sin(angle), 0.0]
            if self.motion == "twist":
                axis = [0.0, 0.0, 1.0]
            elif self.motion == "all":
                axis = [*(0.7 * np.array(axis[:2])), 0.7]
            if self.motion != "stretch":
                yield Motion(joint, "rotation", np.column_stack([np.sin(half)[:, None] * axis, np.cos(half)]))
            if self.motion in {"stretch", "all"}:
                longer = 1.0 + 0.4 * amount * wave
                yield Motion(joint, "translation", longer[:, None] * [0.0, 0.0, 1.0])
                yield Motion(joint, "scale", np.tile(1.0 + 0.3 * amount * wave[:, None], (1, 3)))


def tubes(seeds: range) -> Iterator[Tube]:
    """Yield a tube of each shape and motion for each seed."""
    for seed in seeds:
        for shape in SHAPES:
            for motion in MOTIONS:
                yield Tube(shape, motion, seed)
