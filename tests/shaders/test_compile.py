"""Every text, called as its own header says, gets through the compilers that users have.

WGSL is compiled by two compilers where it is run too: ``test_run``.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

from skinbake.choices import Frame, Language, Layout, Lighting, Method, Morphs
from skinbake.shaders.choices import ShaderChoices
from tests.shaders.combinations import STORED, every_stored_and_morphed, every_text, glsl, together, wgsl
from tests.support import glslang, webgpu

VERSIONS = ("300 es", "330", "450")
BASE = ShaderChoices(Language.GLSL, Method.LBS, Lighting.ACCURATE, 4, Frame.TANGENT)
EXACT = replace(BASE, method=Method.DQS, lighting=Lighting.EXACT, frame=Frame.NORMAL)
CAPPED = replace(EXACT, cap=0.9, influences=5)


@pytest.mark.slow
@pytest.mark.parametrize("version", VERSIONS)
def test_every_glsl_text_compiles(version: str) -> None:
    texts = every_text(Language.GLSL) | every_stored_and_morphed(Language.GLSL)
    shaders = {name: glsl([choices], version) for name, choices in texts.items()}
    assert len(shaders) >= 96 + 68
    assert glslang.complaints(shaders) == {}


@pytest.mark.slow
def test_every_glsl_text_becomes_valid_spirv() -> None:
    """Texts that differ in nothing but the algorithm are included together: the compiler starts slowly."""
    found = {name: glslang.spirv(glsl(group, "450")) for name, group in together(Language.GLSL).items()}
    assert {name: glslang.invalid(module) for name, module in found.items()} == dict.fromkeys(found, "")


@pytest.mark.slow
@pytest.mark.parametrize("implementation", [webgpu.NAGA, webgpu.TINT], ids=["naga", "tint"])
def test_every_wgsl_text_compiles(implementation: webgpu.Implementation) -> None:
    """By Tint those that ``test_run`` does not run."""
    texts = every_stored_and_morphed(Language.WGSL)
    if implementation is webgpu.NAGA:
        texts |= every_text(Language.WGSL)
    jobs = {name: webgpu.Job(wgsl(choices)) for name, choices in texts.items()}
    assert len(jobs) >= 68
    found = webgpu.answers(implementation, jobs)
    assert {name: answer.complaint for name, answer in found.items() if answer.complaint} == {}


@pytest.mark.slow
@pytest.mark.parametrize("version", VERSIONS)
def test_texts_can_be_included_together(version: str) -> None:
    """The same text twice, and texts that differ: influences, methods, frames, caps, storages, morphs."""
    custom_first = sorted(STORED, key=lambda storage: storage.get("layout") != "custom")  # they end at 8
    storages = [replace(BASE, influences=5 + count, **storage) for count, storage in enumerate(custom_first)]
    morphs = [
        replace(EXACT, morphs=Morphs.NORMAL),
        replace(CAPPED, frame=Frame.TANGENT, morphs=Morphs.TANGENT),
    ]
    pairs = {
        "twice": [BASE, BASE],
        "counts": [BASE, replace(BASE, influences=8)],
        "methods-and-frames": [BASE, EXACT],
        "cap": [EXACT, CAPPED],
        "cap-of-two-methods": [CAPPED, replace(CAPPED, method=Method.LBS, lighting=Lighting.ACCURATE)],
        "storages": [BASE, *storages],
        "coordinates": [replace(BASE, layout=Layout.TEXCOORD, influences=count) for count in (3, 4, 8, 12)],
        "morphs": [BASE, *morphs],
        "all": [BASE, EXACT, CAPPED, replace(BASE, lighting=Lighting.DIRECT), replace(BASE, influences=1)],
    }
    assert glslang.complaints({name: glsl(texts, version) for name, texts in pairs.items()}) == {}


@pytest.mark.slow
def test_the_compilers_do_complain() -> None:
    """Each of them, of a shader that is wrong, by its name."""
    good = glsl([BASE], "330")
    bad = good.replace("skinbake_moved(M[0]", "skinbake_lost(M[0]")
    assert list(glslang.complaints({"good": good, "bad": bad})) == ["bad"]
    assert glslang.invalid(glslang.spirv(good.replace("330", "450", 1))[:-4])
    with pytest.raises(ValueError, match="skinbake_lost"):
        glslang.spirv(bad.replace("330", "450", 1))
    code = wgsl(replace(BASE, language=Language.WGSL))
    jobs = {
        "good": webgpu.Job(code),
        "bad": webgpu.Job(code.replace("skinbake_moved(M[0]", "skinbake_lost(M[0]")),
    }
    for implementation in (webgpu.NAGA, webgpu.TINT):
        found = webgpu.answers(implementation, jobs)
        assert found["good"].complaint == ""
        assert "skinbake_lost" in found["bad"].complaint
