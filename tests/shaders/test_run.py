"""Every text, run on vertices, gives what the replay gives.

The difference from the float32 replay, and from the float64 replay, is at most 1e-5 of the length of what a
vector is made of: ``term_lengths``. Measured over all that is run here, on four implementations: 1.0e-6 of
positions, 1.3e-6 of normals, 2.3e-6 of tangents. Of the vectors' own lengths it would be more where their
terms cancel: 4e-5 of a normal by algorithms 3, 5 and 6 and 4e-3 of one by algorithm 2, at folds; 2e-5 of a
tangent where joints carry a vertex far between two poses.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from skinbake.choices import Frame, Language, Lighting, Method
from skinbake.shaders.choices import ALGORITHMS, ShaderChoices
from tests.shaders.combinations import every_text, fewer, label
from tests.shaders.judged import (
    assert_like_the_replay,
    irregular_work,
)
from tests.shaders.running import Single, Work, run_glsl, run_wgsl
from tests.shaders.scenes import CHARACTERS, Character, Scene, irregular
from tests.support import opengl, webgpu

SAMPLES = 2
"""Poses of each character."""


def algorithms(language: Language) -> dict[str, ShaderChoices]:
    """All six, without any option."""
    every = [ShaderChoices(language, method, lighting) for method, lighting in ALGORITHMS]
    return {label(choices): choices for choices in every}


def character_work(language: Language, character: Character, folder: Path) -> Work:
    """All six algorithms, as the character was baked."""
    scene = character.scene(folder, SAMPLES)
    every = [
        ShaderChoices(language, method, lighting, character.influences, character.frame)
        for method, lighting in ALGORITHMS
    ]
    return {label(choices): (choices, scene) for choices in every}


@pytest.fixture(params=["es", "desktop"])
def kind(request: pytest.FixtureRequest) -> str:
    found: str = request.param
    return found


@pytest.fixture
def context(kind: str) -> Iterator[opengl.Context]:
    with opengl.context(kind) as made:
        assert ("OpenGL ES" in made.version) == (kind == "es")
        yield made


def versions(kind: str, choices: ShaderChoices) -> tuple[str, ...]:
    """Return the versions to run: of desktop GLSL both at four influences, else one by turns.

    They share a compiler, and running is dear.
    """
    if kind == "es":
        return ("300 es",)
    if choices.influences == 4:
        return ("330", "450")
    return ("450",) if (choices.influences + choices.algorithm) % 2 else ("330",)


@pytest.mark.parametrize("implementation", [webgpu.NAGA, webgpu.TINT], ids=["naga", "tint"])
class TestWgsl:
    @pytest.mark.slow
    def test_every_algorithm(self, implementation: webgpu.Implementation) -> None:
        work = irregular_work(algorithms(Language.WGSL))
        for name, found in run_wgsl(implementation, work).items():
            assert_like_the_replay(*work[name], found)

    @pytest.mark.slow
    def test_every_combination(self, implementation: webgpu.Implementation) -> None:
        every = every_text(Language.WGSL)
        work = irregular_work(every if implementation is webgpu.NAGA else fewer(every))
        for name, found in run_wgsl(implementation, work).items():
            assert_like_the_replay(*work[name], found)

    @pytest.mark.slow
    @pytest.mark.parametrize("character", CHARACTERS, ids=lambda character: Path(character.path).stem)
    def test_characters(
        self, implementation: webgpu.Implementation, character: Character, tmp_path: Path
    ) -> None:
        work = character_work(Language.WGSL, character, tmp_path)
        for name, found in run_wgsl(implementation, work).items():
            assert_like_the_replay(*work[name], found)


class TestGlsl:
    def test_every_algorithm(self, kind: str, context: opengl.Context) -> None:
        for choices, scene in irregular_work(algorithms(Language.GLSL)).values():
            version = versions(kind, choices)[-1]
            assert_like_the_replay(choices, scene, run_glsl(context, version, choices, scene))

    @pytest.mark.slow
    def test_every_combination(self, kind: str, context: opengl.Context) -> None:
        every = every_text(Language.GLSL)
        for choices, scene in irregular_work(every if kind == "es" else fewer(every)).values():
            for version in versions(kind, choices):
                assert_like_the_replay(choices, scene, run_glsl(context, version, choices, scene))

    @pytest.mark.slow
    @pytest.mark.parametrize("character", CHARACTERS, ids=lambda character: Path(character.path).stem)
    def test_characters(
        self, kind: str, context: opengl.Context, character: Character, tmp_path: Path
    ) -> None:
        for choices, scene in character_work(Language.GLSL, character, tmp_path).values():
            version = versions(kind, choices)[-1]
            assert_like_the_replay(choices, scene, run_glsl(context, version, choices, scene))


@pytest.mark.slow
class TestMirroredJoints:
    """A mirrored joint's normal points where J⁻ᵀ n points, outside; without the option, inside."""

    def normals(self, mirrored_joints: bool) -> tuple[Single, Single, Scene]:
        """The normals of WGSL and of GLSL."""
        given = irregular(4, stretches=True)
        # So weak that nothing folds: then the sides are known without a replay of algorithm 3.
        scene = replace(
            given, alpha=0.05 * given.alpha, beta=0.05 * given.beta, matrices=given.matrices[[0, -1]]
        )
        choices = ShaderChoices(Language.WGSL, mirrored_joints=mirrored_joints, frame=Frame.NORMAL)
        first = run_wgsl(webgpu.NAGA, {"": (choices, scene)})[""]
        with opengl.context("es") as context:
            second = run_glsl(context, "300 es", replace(choices, language=Language.GLSL), scene)
        return first[:, 1], second[:, 1], scene

    @pytest.mark.parametrize("mirrored_joints", [False, True])
    def test_normals_point_outside(self, mirrored_joints: bool) -> None:
        *both, scene = self.normals(mirrored_joints)
        direct = ShaderChoices(Language.WGSL, lighting=Lighting.DIRECT, frame=Frame.NORMAL)
        outside = scene.posed(direct, np.float64)[:, 1]
        half = len(outside) // 2
        for normals in both:
            side = np.sign(np.einsum("ri,ri->r", normals, outside))
            assert (side[:half] == 1).all()
            assert (side[half:] == (1 if mirrored_joints else -1)).all()


class TestTheScenes:
    """The irregular scene has the features that it is made for."""

    def test_weights_of_zero_with_a_derivative(self) -> None:
        scene = irregular(4, stretches=True)
        assert (scene.weights[:, 0] == 0).any()
        assert ((scene.weights[:, 1:] == 0) & (scene.alpha != 0)).any()
        np.testing.assert_allclose(scene.weights.sum(axis=1), 1, atol=1e-6)

    def test_frames_of_either_hand(self) -> None:
        assert set(irregular(4, stretches=True).tangents[:, 3]) == {-1.0, 1.0}

    def test_opposite_quaternions_that_mean_nearly_the_same(self) -> None:
        """Also as the library gives them, before every other one is negated."""
        choices = ShaderChoices(Language.WGSL, Method.DQS)
        turned = irregular(4, stretches=False).rigid(choices).dual_quaternions[1, :, :4]
        cosines = turned @ turned.T
        assert (cosines < -0.7).any()
        assert (cosines > 0.7).any()

    def test_joints_that_mirror_stretch_and_shrink(self) -> None:
        linear = irregular(4, stretches=True).matrices[..., :3, :3].astype(np.float64)
        determinants = np.linalg.det(linear)
        assert (determinants[-1] < 0).all()
        assert (determinants[:-1] > 0).all()
        np.testing.assert_allclose(determinants[2], 1e-6, rtol=1e-4)
        singular = np.linalg.svd(linear[3], compute_uv=False)
        assert (singular[:, 0] > 1.1 * singular[:, 2]).all()

    def test_the_cap_limits_some_and_not_all(self) -> None:
        for method, lighting in ((Method.LBS, Lighting.ACCURATE), (Method.DQS, Lighting.EXACT)):
            choices = ShaderChoices(Language.WGSL, method, lighting)
            scene = irregular(4, stretches=method is Method.LBS)
            free = scene.posed(choices, np.float64)
            capped = scene.posed(replace(choices, cap=0.9), np.float64)
            same = np.isclose(free, capped, rtol=1e-9, atol=0)[:, 2].all(axis=1).mean()
            assert 0.1 < same < 0.9
