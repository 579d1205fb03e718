"""Shaders of encodings and layouts: texts that follow the file, compiled, run, and held against the file."""

from __future__ import annotations

import importlib
import re
import shutil
import struct
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from skinbake.choices import Encoding, Language, Layout, Lighting, Method
from skinbake.commands.shader import shader
from skinbake.errors import ChoiceError, InputError
from skinbake.format.encodings import GradientFormat
from skinbake.shaders import text as shader_texts
from skinbake.shaders.choices import AttributeText, ShaderChoices, ShaderRequest
from tests.support.baked_files import Editable
from tests.support.command_line import invoke
from tests.support.gltf_reading import GltfFile, read
from tests.support.models import FOLDER, bake, baked, note, sheet, write_model
from tests.support.strictness import missing_tool
from tests.support.tools import required_program
from tests.support.whole_fields import shader_text

PACKED8, SNORM16 = GradientFormat(Encoding.PACKED8), GradientFormat(Encoding.SNORM16)
TEXCOORD = GradientFormat(layout=Layout.TEXCOORD)
WGSL, GLSL = Language.WGSL, Language.GLSL

DECODING = 9 * 2.0**-24
"""Relative error of scale · w · w · x in float32: three products, and each of w, w and x a multiplication by
1 / 127, itself rounded, which drivers may take for the division."""


def text_for(path: Path, language: Language = WGSL, **request: Any) -> str:
    return shader(ShaderRequest(language, **request), str(path)).text


def usage(text: str) -> list[str]:
    """Return the lines of the example call, without their comment signs."""
    lines = text.partition("// Use:\n")[2].partition("\n\n")[0].splitlines()
    return [line.removeprefix("//").strip() for line in lines]


def stored_words(model: GltfFile, name: str) -> npt.NDArray[np.uint32]:
    """Return an attribute's bytes as 32-bit words, (V, words)."""
    accessor = model.content["accessors"][model.primitive(0, 0)["attributes"][name]]
    data = model.buffer_view(accessor["bufferView"])
    return np.frombuffer(data, "<u4").reshape(accessor["count"], -1)


def by_hand(model: GltfFile, key: str) -> npt.NDArray[np.float64]:
    """Decode α or β of every vertex after docs/reference/file-format.md, float64, (V, K − 1)."""
    found = note(model.content)
    assert found is not None
    form, limit = {"packed8": ("<4b", 127), "snorm16": ("<4h", 32767)}[found["encoding"]]
    sets = [
        [[c / limit for c in struct.unpack(form, row.tobytes())] for row in stored_words(model, name)]
        for name in found[key]
    ]
    return np.array(
        [
            [
                first[3] ** 2 * found["scale"] * number
                for number in (*first[:3], *(n for o in others for n in o))
            ]
            for first, *others in zip(*sets, strict=True)
        ]
    )


def run(source: str, inputs: npt.NDArray[np.uint32], count: int, columns: int) -> npt.NDArray[np.float32]:
    """Run ``main`` for each of ``count`` vertices; it reads words at binding 0, and writes at binding 1."""
    try:
        compute = importlib.import_module("wgpu.utils.compute")
    except (ImportError, OSError) as error:
        missing_tool(f"wgpu is needed to run shaders: {error}")
    try:
        out = compute.compute_with_buffers({0: inputs}, {1: (count * columns, "f")}, source, n=count)
    except RuntimeError as error:
        if "adapter" in str(error).lower():
            missing_tool(f"no graphics adapter runs shaders: {error}")
        raise
    return np.frombuffer(out[1], np.float32).reshape(count, columns)


def entry(text: str, prepared: list[str], names: list[str], words: int) -> str:
    """Return WGSL that executes the prepared lines for each vertex and writes the named vectors out."""
    lines = [line for line in usage(text) if re.match(r"(let|const) (scale|alpha_\d|beta_\d) =", line)]
    sizes = [3 if name.endswith("_0") else 4 for name in names]
    writes, at = [], 0
    for name, size in zip(names, sizes, strict=True):
        writes += [f"result[i * {sum(sizes)}u + {at + n}u] = {name}[{n}];" for n in range(size)]
        at += size
    return "\n".join(
        [
            text,
            "@group(0) @binding(0) var<storage, read> words: array<u32>;",
            "@group(0) @binding(1) var<storage, read_write> result: array<f32>;",
            "@compute @workgroup_size(1)",
            "fn main(@builtin(global_invocation_id) id: vec3<u32>) {",
            f"let i = id.x; let at = i * {words}u;",
            *prepared,
            *lines,
            *writes,
            "}",
        ]
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "storage", "influences"),
    [
        ("bent_tube.glb", PACKED8, 4),
        ("bent_tube.glb", SNORM16, 4),
        ("two_sets.glb", PACKED8, 8),
        ("two_sets.glb", SNORM16, 8),
        ("seam.glb", GradientFormat(Encoding.PACKED8, Layout.CUSTOM), 4),
    ],
)
def test_a_shader_decodes_what_the_file_holds(
    name: str, storage: GradientFormat, influences: int, tmp_path: Path
) -> None:
    model = baked(FOLDER / name, tmp_path / name, storage=storage)
    found = note(model.content)
    assert found is not None
    size = {Encoding.PACKED8: 1, Encoding.SNORM16: 2}[storage.encoding]
    names = [f"{key}_{number}" for key in ("alpha", "beta") for number in range(influences // 4)]
    attributes = [attribute for key in ("alpha", "beta") for attribute in found[key]]
    inputs = np.concatenate([stored_words(model, attribute) for attribute in attributes], axis=1)
    prepared = []
    for at, given in enumerate(names):
        word = f"words[at + {size * at}u]"
        # What a vertex buffer of snorm8x4 or snorm16x4 is read as.
        value = (
            f"unpack4x8snorm({word})"
            if size == 1
            else f"vec4<f32>(unpack2x16snorm({word}), unpack2x16snorm(words[at + {size * at + 1}u]))"
        )
        prepared.append(f"let stored_{given} = {value};")
    source = entry(text_for(tmp_path / name), prepared, names, inputs.shape[1])
    result = run(source, np.ascontiguousarray(inputs), len(inputs), 2 * (influences - 1))
    expected = np.concatenate([by_hand(model, "alpha"), by_hand(model, "beta")], axis=1)
    assert np.abs(expected).max() > 0.5
    assert (np.abs(result - expected) <= DECODING * np.abs(expected)).all()


@pytest.mark.slow
@pytest.mark.parametrize(("name", "influences"), [("bent_tube.glb", 4), ("two_sets.glb", 8)])
def test_a_shader_assembles_what_the_texture_coordinates_hold(
    name: str, influences: int, tmp_path: Path
) -> None:
    plain = baked(FOLDER / name, tmp_path / f"plain_{name}")
    model = baked(FOLDER / name, tmp_path / name, storage=TEXCOORD)
    found = note(model.content)
    assert found is not None
    attributes = list(dict.fromkeys([*found["alpha"], *found["beta"]]))
    inputs = np.concatenate([stored_words(model, attribute) for attribute in attributes], axis=1)
    prepared = [
        f"let {attribute.lower()} = vec2<f32>(bitcast<f32>(words[at + {2 * n}u]), "
        f"bitcast<f32>(words[at + {2 * n + 1}u]));"
        for n, attribute in enumerate(attributes)
    ]
    names = [f"{key}_{number}" for key in ("alpha", "beta") for number in range(influences // 4)]
    source = entry(text_for(tmp_path / name), prepared, names, inputs.shape[1])
    result = run(source, np.ascontiguousarray(inputs), len(inputs), 2 * (influences - 1))
    noted = note(plain.content)
    assert noted is not None
    stored = [
        plain.stored(plain.primitive(0, 0)["attributes"][attribute])
        for key in ("alpha", "beta")
        for attribute in noted[key]
    ]
    assert (result == np.concatenate(stored, axis=1)).all()


@pytest.mark.slow
@pytest.mark.parametrize("influences", [1, 2, 4, 5, 8, 12])
@pytest.mark.parametrize("storage", [{"encoding": "packed8"}, {"layout": "texcoord"}])
@pytest.mark.parametrize("light", [(Method.LBS, Lighting.DIRECT), (Method.DQS, Lighting.EXACT)])
def test_glsl_compiles_with_its_own_example(
    light: tuple[Method, Lighting], storage: dict[str, Any], influences: int, tmp_path: Path
) -> None:
    compiler = required_program("glslangValidator", "glslang-tools")
    method, lighting = light
    choices = ShaderChoices(
        GLSL, method, lighting, influences, attributes=None, scale=2.5 if influences == 8 else None, **storage
    )
    text = shader_text(choices)
    joined = "\n".join(usage(text))
    sets = range(-(-influences // 4))
    given = {"position": "vec3", "normal": "vec3"} | {f"weights_{n}": "vec4" for n in sets}
    given |= {f"stored_{kind}_{n}": "vec4" for kind in ("alpha", "beta") for n in sets}
    given |= dict.fromkeys(re.findall(r"texcoord_\d+", joined), "vec2")
    motion = "mat4 M" if method is Method.LBS else "mat2x4 Q"
    declared = "\n".join(f"{kind} {name} = {kind}(1.0);" for name, kind in given.items())
    body = f"{declared}\n{motion}[{influences}];\n{joined}\ngl_Position = vec4(v.normal, 1.0);"
    path = tmp_path / "shader.vert"
    path.write_text(f"#version 300 es\n{text}\nuniform float scale;\nvoid main() {{\n{body}\n}}\n")
    done = subprocess.run([compiler, str(path)], capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0, done.stdout


class TestText:
    @pytest.mark.slow
    def test_the_text_has_the_file_s_scale_as_a_constant(self, tmp_path: Path) -> None:
        model = baked(FOLDER / "bent_tube.glb", tmp_path / "tube.glb", storage=PACKED8)
        scale = (note(model.content) or {})["scale"]
        for language, words in ((WGSL, "const scale = "), (GLSL, "const float scale = ")):
            (line,) = [
                line for line in usage(text_for(tmp_path / "tube.glb", language)) if line.startswith(words)
            ]
            literal = line.removeprefix(words).removesuffix(";")
            assert np.float32(literal) == np.float32(scale) == scale
            text = text_for(tmp_path / "tube.glb", language)
            assert f'"scale" in extras.skinbake of its baked primitives: {literal}.' in text

    def test_without_a_file_the_scale_is_a_parameter(self) -> None:
        text = shader_text(ShaderChoices(GLSL, encoding=Encoding.SNORM16))
        assert "vec3 skinbake_decoded(vec4 stored, float scale)" in text
        assert "skinbake_decoded_further" not in text
        assert "scale =" not in text
        assert "vec3 alpha_0 = skinbake_decoded(stored_alpha_0, scale);" in usage(text)
        assert '"scale" in extras.skinbake of its baked primitives; make it a constant or a uniform.' in text
        assert "max(c / 32767, -1)" in text

    def test_the_table_of_inputs_tells_the_stored_types(self) -> None:
        text = shader_text(ShaderChoices(GLSL, encoding=Encoding.PACKED8))
        assert "_SKINBAKE_ALPHA_0    vec4   alpha = grad w . t0 of slots 1 to 3, as snorm8x4" in text
        text = shader_text(ShaderChoices(WGSL, encoding=Encoding.SNORM16, influences=8))
        assert "_SKINBAKE_ALPHA_1    vec4<f32>  alpha = grad w . t0 of slots 4 to 7, as snorm16x4" in text
        text = shader_text(ShaderChoices(GLSL, layout=Layout.TEXCOORD))
        assert "TEXCOORD_2           vec2   alpha of slot 3, beta of slot 1" in text
        assert "The sets follow the sets that a primitive had before: here one, TEXCOORD_0." in text
        text = shader_text(ShaderChoices(GLSL, layout=Layout.CUSTOM))
        assert "_CUSTOM1             vec3   beta" in text

    def test_a_shader_of_fewer_influences_reads_the_pairs_of_the_file(self) -> None:
        """K is 8 in the file: β begins after seven α, however many of them the shader reads."""
        names = [f"TEXCOORD_{number}" for number in range(7)]
        attributes = AttributeText("hero.glb", tuple(names[:4]), tuple(names[3:]))
        text = shader_text(ShaderChoices(GLSL, influences=4, layout=Layout.TEXCOORD, attributes=attributes))
        assert "vec3 alpha_0 = skinbake_alpha_0(texcoord_0, texcoord_1);" in usage(text)
        assert "vec3 beta_0 = skinbake_beta_0(texcoord_3, texcoord_4);" in usage(text)
        assert "return vec3(pair_4.y, pair_5.x, pair_5.y);" in text
        assert "TEXCOORD_2 " not in text

    def test_float32_attributes_need_nothing_of_it(self) -> None:
        for lighting in (Lighting.ACCURATE, Lighting.STANDARD):
            text = shader_text(ShaderChoices(GLSL, lighting=lighting))
            assert not re.search("scale|decoded|pair|stored_|snorm", text)
        text = shader_text(ShaderChoices(GLSL, lighting=Lighting.STANDARD, encoding=Encoding.PACKED8))
        assert "skinbake_decoded" not in text

    @pytest.mark.parametrize(
        "storage", [{"encoding": "packed8"}, {"layout": "texcoord"}, {"layout": "custom"}]
    )
    def test_the_command_in_the_header_writes_it_again(self, storage: dict[str, Any]) -> None:
        text = shader_text(ShaderChoices(GLSL, influences=8, **storage))
        (line,) = [line for line in text.splitlines() if line.startswith("//     skinbake shader")]
        assert invoke(*line.removeprefix("//").split()[1:]).stdout == text

    def test_texts_of_different_storage_have_different_guards(self) -> None:
        made = [
            ShaderChoices(GLSL),
            ShaderChoices(GLSL, encoding=Encoding.PACKED8),
            ShaderChoices(GLSL, encoding=Encoding.SNORM16),
            ShaderChoices(GLSL, layout=Layout.TEXCOORD),
        ]
        guards = [re.search(r"#ifndef (\w+_GLSL)", shader_text(choices)) for choices in made]
        assert len({guard[1] for guard in guards if guard}) == len(made)

    def test_lines_are_short(self) -> None:
        for storage in ({"encoding": "packed8", "scale": 12.5}, {"layout": "texcoord"}):
            for line in shader_text(ShaderChoices(GLSL, **storage)).splitlines():
                assert len(line) <= 120


class TestRefusals:
    @pytest.mark.parametrize(
        ("changes", "words"),
        [
            ({"encoding": "half"}, "encoding='half': expected one of float32, snorm16, packed8"),
            ({"layout": "uv"}, "layout='uv': expected one of attributes, texcoord, custom"),
            (
                {"layout": "texcoord", "encoding": "packed8"},
                "layout='texcoord' needs encoding='float32', not packed8",
            ),
        ],
    )
    def test_choices_that_do_not_exist(self, changes: dict[str, Any], words: str) -> None:
        with pytest.raises(ChoiceError, match=re.escape(words)):
            ShaderChoices(GLSL, **changes)

    @pytest.mark.parametrize("storage", [{"encoding": "packed8"}, {"layout": "texcoord"}])
    def test_a_target_that_does_not_decode(
        self, storage: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """A new target's file that says nothing of encodings and layouts reads floats, of any names."""
        shutil.copytree(shader_texts.TEMPLATES, tmp_path / "templates")
        (tmp_path / "templates" / "targets" / "bare.glsl").write_text("@{ text_for().snippet }\n")
        monkeypatch.setattr(shader_texts, "TEMPLATES", tmp_path / "templates")
        with pytest.raises(ChoiceError, match="target='bare': it reads alpha and beta as floats"):
            shader_text(ShaderChoices(GLSL, target="bare", **storage))
        standard = ShaderChoices(GLSL, lighting=Lighting.STANDARD, target="bare", **storage)
        assert "skinbake_lbs_standard" in shader_text(standard)
        assert "skinbake_lbs_accurate" in shader_text(
            ShaderChoices(GLSL, target="bare", layout=Layout.CUSTOM)
        )

    @pytest.mark.parametrize(
        ("storage", "asked", "words"),
        [
            (
                PACKED8,
                {"encoding": "snorm16"},
                "this file does not fit --encoding snorm16: .*, encoding packed8",
            ),
            (TEXCOORD, {"layout": "custom"}, "this file does not fit --layout custom: .*, layout texcoord"),
            (
                GradientFormat(),
                {"encoding": "packed8"},
                "this file does not fit --encoding packed8: .*, encoding float32",
            ),
        ],
    )
    def test_a_file_that_is_stored_otherwise(
        self, storage: GradientFormat, asked: dict[str, Any], words: str, tmp_path: Path
    ) -> None:
        bake(FOLDER / "seam.glb", tmp_path / "seam.glb", storage=storage)
        with pytest.raises(InputError, match=words):
            text_for(tmp_path / "seam.glb", **asked)

    def test_primitives_of_different_encodings(self, tmp_path: Path) -> None:
        """As where two baked files were joined."""
        baked(FOLDER / "two_primitives.glb", tmp_path / "two.glb", storage=SNORM16)
        model = Editable(tmp_path / "two.glb")
        second = model.primitive(1)
        note_of_second = second["extras"]["skinbake"]
        note_of_second["scale"] *= 4.0  # and half its root in the fourth component: the same values
        for name in note_of_second["alpha"] + note_of_second["beta"]:
            model.stored(second["attributes"][name])[:, 3] //= 2
        with pytest.raises(
            InputError, match=r"its primitives have different scales \(.* and .*\): bake it again"
        ):
            text_for(model.write(tmp_path / "scales.glb"))


def test_primitives_with_other_texture_coordinates_are_told_of(tmp_path: Path) -> None:
    coordinates = np.zeros((20, 2), np.float32)
    path = write_model(tmp_path / "model.glb", [sheet(), sheet(TEXCOORD_0=coordinates)])
    bake(path, tmp_path / "baked.glb", storage=TEXCOORD)
    result = shader(ShaderRequest(WGSL), str(tmp_path / "baked.glb"))
    (notice,) = result.notices
    assert (notice.code, notice.place.primitive) == ("texcoords-differ", 1)
    assert "its α and β are in TEXCOORD_1 to TEXCOORD_3" in notice.message
    assert "TEXCOORD_0 " in result.text
    assert read(tmp_path / "baked.glb").content["meshes"][0]["primitives"][1]["attributes"]["TEXCOORD_3"]
