"""Bakes of compressed files: α/β inside, all else as it was, and strip undoes it.

What it wrote is read back by the reference decoders. Expected values come from the uncompressed twin.
"""

from __future__ import annotations

import base64
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from fixtures.builder import JsonObject
from skinbake.choices import FrameChoice, Neighbours, PoseKind, Scheme
from skinbake.commands.bake_options import BakeOptions
from skinbake.commands.inspect import inspect_file
from skinbake.commands.strip import strip_file
from skinbake.commands.verify import verify_file
from skinbake.errors import ChoiceError, InputError
from skinbake.gltf.budget import Limit
from skinbake.gltf.document import read_document
from skinbake.gltf.reading.meshes import skinned_sources
from skinbake.gltf.writing.compaction import compacted
from skinbake.gltf.writing.recode import Compression, recoded
from skinbake.measure.options import VerifyOptions
from skinbake.truth.poses import PoseRequest
from tests.support import corpus, khronos
from tests.support.baked_files import Editable
from tests.support.baking import bake_file, bake_settings
from tests.support.compressed import EXT, KHR, content_of, draco_twin, meshopt_twin
from tests.support.decoders import read_plain, read_plain_many
from tests.support.gltf_reading import DRACO, MESHOPT, GltfFile, read
from tests.support.models import (
    FOLDER,
    assert_buffers_kept,
    bake,
    edited,
    note,
    primitives,
    rewritten,
    sheet,
    stripped,
    write_model,
)

ADOPTING = "foreign_joints.glb"
FIXTURES = [ADOPTING, "two_sets.glb", "weights_u8.glb", "bent_tube.glb"]
ALPHA, BETA = "_SKINBAKE_ALPHA_0", "_SKINBAKE_BETA_0"
COMPRESSED = [
    "BathDay/bath_day.glb",
    "barbarian-draco-edgebreaker.glb",
    "hand_l-draco-sequential.glb",
    "barbarian-EXT_meshopt-high.glb",
    "barbarian-EXT_meshopt-medium.glb",
]
SCHEMES = tuple(Scheme)
REST = VerifyOptions(poses=PoseRequest(PoseKind.REST))


def twin(kind: str, name: str, folder: Path) -> Path:
    """Write the compressed twin of a fixture: ``draco``, or meshopt by the extension's name."""
    if kind == "draco":
        return draco_twin(FOLDER / name, folder / f"draco-{name}")
    return meshopt_twin(
        FOLDER / name,
        folder / f"{kind}-{name}",
        name=EXT if kind == "beside" else kind,
        beside=kind == "beside",
    )


KINDS = ["draco", EXT, KHR, "beside"]


def compress(scheme: Scheme, **bits: int) -> dict[str, Any]:
    return {"compression": Compression(scheme, bits=bits)}


def names_of(content: JsonObject) -> set[str]:
    return set(content.get("extensionsUsed", [])) & {DRACO, *MESHOPT}


def assert_same_bake(path: Path, plain: Path) -> None:
    """Compare all attributes and indices of a file, decoded, with those of an uncompressed one, by bits."""
    found, expected = read_plain(path), read(plain)
    count = 0
    for mesh, number, primitive in primitives(expected.content):
        assert found.primitive(mesh, number)["attributes"].keys() == primitive["attributes"].keys()
        for name in primitive["attributes"]:
            ours, theirs = (model.stored_attribute(name, mesh, number) for model in (found, expected))
            assert (ours.dtype, ours.tobytes()) == (theirs.dtype, theirs.tobytes()), name
            count += name == ALPHA
        assert np.array_equal(found.triangles(mesh, number), expected.triangles(mesh, number))
    assert count


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", FIXTURES)
class TestKeep:
    def test_bakes_what_its_plain_twin_bakes(self, name: str, kind: str, tmp_path: Path) -> None:
        bake(FOLDER / name, tmp_path / "plain.glb")
        bake(twin(kind, name, tmp_path), tmp_path / "baked.glb")
        assert_same_bake(tmp_path / "baked.glb", tmp_path / "plain.glb")

    def test_stays_compressed(self, name: str, kind: str, tmp_path: Path) -> None:
        """α and β lie beside a Draco stream. What replaces its influences is in a new one."""
        source = twin(kind, name, tmp_path)
        bake(source, tmp_path / "baked.glb")
        before, after = read(source), read(tmp_path / "baked.glb")
        assert after.content["extensionsUsed"] == before.content["extensionsUsed"]
        assert after.content.get("extensionsRequired") == before.content.get("extensionsRequired")
        for mesh, number, primitive in primitives(after.content):
            former = before.primitive(mesh, number)
            for attribute in (ALPHA, BETA):
                accessor = after.content["accessors"][primitive["attributes"][attribute]]
                view = after.content["bufferViews"][accessor["bufferView"]]
                expected = set() if kind == "draco" else names_of(before.content)
                assert set(view.get("extensions", {})) == expected
            if kind == "draco":
                now, then = (entry["extensions"][DRACO] for entry in (primitive, former))
                replaced = any(
                    primitive["attributes"][key] != former["attributes"][key] for key in then["attributes"]
                )
                assert (now == then) == (not replaced)
                assert now["attributes"].keys() == then["attributes"].keys()

    def test_keeps_every_byte_and_all_json_that_was_there(self, name: str, kind: str, tmp_path: Path) -> None:
        source = twin(kind, name, tmp_path)
        bake(source, tmp_path / "baked.glb")
        before, after = read(source), read(tmp_path / "baked.glb")
        assert_buffers_kept(before, after)
        for array in ("accessors", "bufferViews"):
            kept = after.content[array][: len(before.content[array])]
            assert json.dumps(kept) == json.dumps(before.content[array])

    def test_strip_gives_back_what_was_there(self, name: str, kind: str, tmp_path: Path) -> None:
        source = twin(kind, name, tmp_path)
        bake(source, tmp_path / "baked.glb")
        result = stripped(tmp_path / "baked.glb", tmp_path / "stripped.glb")
        assert json.dumps(result.content) == content_of(source)
        assert result.binary_chunk == read(source).binary_chunk

    @pytest.mark.slow
    def test_twice_is_once_and_the_output_deterministic(self, name: str, kind: str, tmp_path: Path) -> None:
        source = twin(kind, name, tmp_path)
        for target, input_ in (("one", source), ("two", tmp_path / "one.glb"), ("three", source)):
            bake(input_, tmp_path / f"{target}.glb")
        files = {(tmp_path / f"{target}.glb").read_bytes() for target in ("one", "two", "three")}
        assert len(files) == 1

    @pytest.mark.slow
    def test_the_other_commands_read_it(self, name: str, kind: str, tmp_path: Path) -> None:
        bake(twin(kind, name, tmp_path), tmp_path / "baked.glb")
        path = str(tmp_path / "baked.glb")
        verdict = verify_file(path, REST)
        assert (verdict.error, [check.outcome for check in verdict.checks if check.problems]) == (None, [])
        for primitive in inspect_file(path).primitives:
            assert primitive.bake is not None
            assert primitive.bake.changed == ()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["plain", "draco", EXT, "beside"])
@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("name", [ADOPTING, "bent_tube.glb"])
class TestEveryCompressionIntoEvery:
    def source(self, kind: str, name: str, folder: Path) -> Path:
        return FOLDER / name if kind == "plain" else twin(kind, name, folder)

    def test_values_stay(self, name: str, scheme: Scheme, kind: str, tmp_path: Path) -> None:
        bake(FOLDER / name, tmp_path / "plain.glb")
        bake(self.source(kind, name, tmp_path), tmp_path / "baked.glb", **compress(scheme))
        assert_same_bake(tmp_path / "baked.glb", tmp_path / "plain.glb")
        found = read(tmp_path / "baked.glb").content
        expected = {"none": set(), "draco": {DRACO}, "meshopt": {EXT}}
        if scheme != "keep":
            # meshopt's animations and inverse bind matrices stay as they are beside Draco
            others = {EXT} if scheme == "draco" and kind in {EXT, "beside"} else set()
            assert names_of(found) == expected[scheme] | others

    def test_strip_leaves_no_bake_and_a_second_bake_changes_nothing(
        self, name: str, scheme: Scheme, kind: str, tmp_path: Path
    ) -> None:
        bake(self.source(kind, name, tmp_path), tmp_path / "one.glb", **compress(scheme))
        for options in (compress(Scheme.KEEP), compress(scheme)):
            bake(tmp_path / "one.glb", tmp_path / "two.glb", **options)
            assert (tmp_path / "two.glb").read_bytes() == (tmp_path / "one.glb").read_bytes()
        stripped(tmp_path / "one.glb", tmp_path / "bare.glb")
        bare, original = read_plain(tmp_path / "bare.glb"), read(FOLDER / name)
        for array in ("meshes", "accessors", "bufferViews"):
            assert "skinbake" not in json.dumps(bare.content[array]).lower()
        for mesh, number, primitive in primitives(original.content):
            assert bare.primitive(mesh, number)["attributes"].keys() == primitive["attributes"].keys()
            for attribute in primitive["attributes"]:
                ours, theirs = (model.stored_attribute(attribute, mesh, number) for model in (bare, original))
                assert ours.tobytes() == theirs.tobytes()


MATRICES = {"MAT2": (5126, 16), "MAT3": (5121, 12)}
"""The component type and the bytes of an element. Columns are padded to 4 bytes (glTF §3.6.2.4)."""


class TestMatricesOfApplications:
    """Attributes of type MAT2 and MAT3 have only names of applications, and nothing here reads them."""

    @staticmethod
    def source(kind: str, path: Path) -> tuple[Path, bytes]:
        """Write a fixture with such an attribute. Return it, and the bytes of the attribute."""
        model = read(FOLDER / "bent_tube.glb")
        code, size = MATRICES[kind]
        content, data = model.content, model.binary_chunk or b""
        data += bytes(-len(data) % 4)
        count = content["accessors"][model.primitive(0)["attributes"]["POSITION"]]["count"]
        matrices = np.random.default_rng(1).integers(0, 60, count * size).astype(np.uint8).tobytes()
        view = {"buffer": 0, "byteOffset": len(data), "byteLength": len(matrices), "byteStride": size}
        content["bufferViews"].append(view)
        content["buffers"][0]["byteLength"] = len(data + matrices)
        number = len(content["bufferViews"]) - 1
        content["accessors"].append(
            {"bufferView": number, "componentType": code, "count": count, "type": kind}
        )
        model.primitive(0)["attributes"]["_FRAME"] = len(content["accessors"]) - 1
        return rewritten(GltfFile(path, content, data + matrices), path), matrices

    @staticmethod
    def matrices_in(model: GltfFile) -> bytes:
        accessor = model.content["accessors"][model.primitive(0)["attributes"]["_FRAME"]]
        view = model.content["bufferViews"][accessor["bufferView"]]
        assert "extensions" not in view
        return bytes(model.buffer(view["buffer"])[view["byteOffset"] :][: view["byteLength"]])

    @pytest.mark.parametrize("kind", MATRICES)
    def test_meshopt_leaves_them_as_they_are(self, kind: str, tmp_path: Path) -> None:
        path, matrices = self.source(kind, tmp_path / "source.glb")
        result = bake(path, tmp_path / "out.glb", **compress(Scheme.MESHOPT))
        assert result.notices == ()
        after = read(tmp_path / "out.glb")
        assert self.matrices_in(after) == matrices
        views = after.content["bufferViews"]
        for name, number in after.primitive(0)["attributes"].items():
            view = views[after.content["accessors"][number]["bufferView"]]
            assert ("extensions" in view) == (name != "_FRAME"), name
        bake(FOLDER / "bent_tube.glb", tmp_path / "plain.glb")
        found, plain = read_plain(tmp_path / "out.glb"), read(tmp_path / "plain.glb")
        for name in ("POSITION", ALPHA, BETA):
            assert found.stored_attribute(name).tobytes() == plain.stored_attribute(name).tobytes()
        bake(tmp_path / "out.glb", tmp_path / "again.glb", **compress(Scheme.MESHOPT))
        assert (tmp_path / "again.glb").read_bytes() == (tmp_path / "out.glb").read_bytes()

    @pytest.mark.parametrize("kind", MATRICES)
    def test_a_primitive_with_them_is_not_put_into_draco(self, kind: str, tmp_path: Path) -> None:
        path, matrices = self.source(kind, tmp_path / "source.glb")
        result = bake(path, tmp_path / "out.glb", **compress(Scheme.DRACO))
        assert [(notice.code, notice.message) for notice in result.notices] == [
            (
                "not-compressed",
                f"left as it is, not put into Draco: its _FRAME has the type {kind}, which is not stored in "
                "Draco",
            )
        ]
        assert names_of(read(tmp_path / "out.glb").content) == set()
        assert self.matrices_in(read(tmp_path / "out.glb")) == matrices

    @pytest.mark.parametrize("kind", MATRICES)
    def test_bounds_of_compressed_ones_are_left_when_they_are_decoded(
        self, kind: str, tmp_path: Path
    ) -> None:
        path, matrices = self.source(kind, tmp_path / "source.glb")
        components = {"MAT2": 4, "MAT3": 9}[kind]
        bounds = {"min": [0] * components, "max": [99] * components}
        model = read(path)
        accessor = model.content["accessors"][-1]
        declared = accessor | bounds
        accessor |= {"type": f"VEC{MATRICES[kind][1] // 4}", "componentType": 5126}  # as many bytes

        def change(content: JsonObject) -> None:
            content["accessors"][-1] |= declared

        packed = meshopt_twin(rewritten(model, path), tmp_path / "packed.glb", change=change)
        assert "extensions" in read(packed).content["bufferViews"][declared["bufferView"]]
        bake(packed, tmp_path / "out.glb", **compress(Scheme.NONE))
        assert self.matrices_in(read(tmp_path / "out.glb")) == matrices


def test_the_rest_of_the_file_is_left_alone(tmp_path: Path) -> None:
    """A primitive that is not skinned keeps its compressed bytes under every scheme but none."""
    path = corpus.model("barbarian-draco-edgebreaker.glb")
    before = read(path)
    for scheme in (Scheme.KEEP, Scheme.DRACO):
        bake(path, tmp_path / "baked.glb", **compress(scheme))
        after = read(tmp_path / "baked.glb")
        count = 0
        for mesh, number, primitive in primitives(before.content):
            if "JOINTS_0" not in primitive["attributes"]:
                assert after.primitive(mesh, number) == primitive
                view = primitive["extensions"][DRACO]["bufferView"]
                assert after.buffer_view(view) == before.buffer_view(view)
                count += 1
        assert count == 7


def test_a_skipped_primitive_keeps_its_stream(tmp_path: Path) -> None:
    path = write_model(tmp_path / "two.glb", [sheet(), sheet(NORMAL=None)])
    source = draco_twin(path, tmp_path / "draco.glb")
    for scheme in (Scheme.KEEP, Scheme.MESHOPT, Scheme.DRACO):
        bake(source, tmp_path / "baked.glb", **compress(scheme))
        assert read(tmp_path / "baked.glb").primitive(0, 1)["extensions"][DRACO]["attributes"].keys() == {
            "POSITION",
            "JOINTS_0",
            "WEIGHTS_0",
        }
        read_plain(tmp_path / "baked.glb")


def test_a_file_with_nothing_to_bake_is_not_recoded(tmp_path: Path) -> None:
    path = draco_twin(write_model(tmp_path / "bare.glb", [sheet(NORMAL=None)]), tmp_path / "draco.glb")
    for scheme in SCHEMES:
        bake(path, tmp_path / "out.glb", **compress(scheme))
        assert (tmp_path / "out.glb").read_bytes() == path.read_bytes()


@pytest.mark.parametrize("kind", ["draco", EXT])
def test_generated_normals_go_inside(kind: str, tmp_path: Path) -> None:
    path = write_model(tmp_path / "bare.glb", [sheet(NORMAL=None)])
    bake(path, tmp_path / "plain.glb", generate_normals=True)
    source = (
        draco_twin(path, tmp_path / "t.glb") if kind == "draco" else meshopt_twin(path, tmp_path / "t.glb")
    )
    bake(source, tmp_path / "baked.glb", generate_normals=True)
    assert_same_bake(tmp_path / "baked.glb", tmp_path / "plain.glb")
    assert json.dumps(stripped(tmp_path / "baked.glb", tmp_path / "s.glb").content) == content_of(source)


@pytest.mark.parametrize("extras", [[], "text", {"skinbake": "mine"}, {}])
@pytest.mark.parametrize("kind", ["draco", EXT])
def test_extras_of_others_stay_theirs(kind: str, extras: Any, tmp_path: Path) -> None:
    """The metadata then stands at the accessor of α; the Draco extension may have extras of its own too."""

    def change(content: JsonObject) -> None:
        primitive = content["meshes"][0]["primitives"][0]
        primitive["extras"] = extras
        if kind == "draco":
            primitive["extensions"][DRACO]["extras"] = extras

    make = draco_twin if kind == "draco" else meshopt_twin
    source = make(FOLDER / ADOPTING, tmp_path / "twin.glb", change=change)
    bake(source, tmp_path / "baked.glb")
    assert [
        check.name for check in verify_file(str(tmp_path / "baked.glb"), REST).checks if check.problems
    ] == []
    assert json.dumps(stripped(tmp_path / "baked.glb", tmp_path / "s.glb").content) == content_of(source)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["draco", EXT, "beside"])
def test_gltf_and_glb_become_each_other(kind: str, tmp_path: Path) -> None:
    bake(FOLDER / ADOPTING, tmp_path / "plain.glb")
    source = twin(kind, ADOPTING, tmp_path)
    for scheme in SCHEMES:
        bake(source, tmp_path / "out.gltf", **compress(scheme))
        assert_same_bake(tmp_path / "out.gltf", tmp_path / "plain.glb")
        bake(tmp_path / "out.gltf", tmp_path / "again" / "out.gltf", **compress(scheme))
        assert (tmp_path / "again" / "out.gltf").read_text() == (tmp_path / "out.gltf").read_text()
        bake(tmp_path / "out.gltf", tmp_path / "back.glb")
        assert_same_bake(tmp_path / "back.glb", tmp_path / "plain.glb")
        strip_file(str(tmp_path / "out.gltf"), str(tmp_path / "bare.gltf"))
        assert read_plain(tmp_path / "bare.gltf").attribute("POSITION").shape == (112, 3)


@pytest.mark.parametrize("where", ["BIN chunk", "data: URI", "file"])
def test_a_buffer_of_any_kind_loses_the_bytes_that_went_into_draco(where: str, tmp_path: Path) -> None:
    model = read(FOLDER / "bent_tube.glb")
    data = model.binary_chunk or b""
    path = tmp_path / ("tube.glb" if where == "BIN chunk" else "tube.gltf")
    if where == "data: URI":
        uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
        model.content["buffers"][0]["uri"] = uri
    elif where == "file":
        model.content["buffers"][0]["uri"] = "tube.bin"
        (tmp_path / "tube.bin").write_bytes(data)
    target = tmp_path / "out" / path.name
    bake(rewritten(model, path), target, **compress(Scheme.DRACO))
    bake(FOLDER / "bent_tube.glb", tmp_path / "plain.glb")
    assert_same_bake(target, tmp_path / "plain.glb")
    found = read(target)
    views = [view for view in found.content["bufferViews"] if view["buffer"] == 0]
    buffer = found.buffer(0)
    assert len(buffer) == found.content["buffers"][0]["byteLength"]
    assert len(buffer) < sum(view["byteLength"] for view in views) + 4 * (len(views) + 1)
    for ours, theirs in zip(values_beside(found), values_beside(read(path)), strict=True):
        assert np.array_equal(ours, theirs)


def values_beside(model: GltfFile) -> list[npt.NDArray[Any]]:
    """Return the arrays of the skins and the animations: no compression of ours takes them."""
    numbers = [skin["inverseBindMatrices"] for skin in model.content["skins"]]
    for animation in model.content["animations"]:
        for sampler in animation["samplers"]:
            numbers += [sampler["input"], sampler["output"]]
    return [model.stored(number) for number in numbers]


def test_the_sources_buffer_beside_a_gltf_is_not_overwritten(tmp_path: Path) -> None:
    bake(twin(EXT, ADOPTING, tmp_path), tmp_path / "model.gltf")
    strip_file(str(tmp_path / "model.gltf"), str(tmp_path / "bare.gltf"))
    kept = {path: path.read_bytes() for path in tmp_path.glob("*.bin")}
    bake(tmp_path / "bare.gltf", tmp_path / "bare.gltf", **compress(Scheme.NONE))
    assert {path: path.read_bytes() for path in kept} == kept
    bake(FOLDER / ADOPTING, tmp_path / "plain.glb")
    assert_same_bake(tmp_path / "bare.gltf", tmp_path / "plain.glb")


def test_vrm_passes_through_but_for_the_additions(tmp_path: Path) -> None:
    """A .vrm is a GLB; its extensions name no buffer views of ours."""
    for path in corpus.valid_models():
        if path.suffix == ".vrm":
            result = bake_file(str(path), str(tmp_path / path.name))
            before, after = read(path), read(tmp_path / path.name)
            for key in ("extensions", "extensionsUsed", "nodes", "materials", "images", "textures"):
                assert json.dumps(after.content.get(key)) == json.dumps(before.content.get(key))
            assert_buffers_kept(before, after)
            assert result.error is None
    source = tmp_path / "draco.vrm"
    shutil.copyfile(twin("draco", ADOPTING, tmp_path), source)
    bake(source, tmp_path / "baked.vrm")
    assert json.dumps(stripped(tmp_path / "baked.vrm", tmp_path / "bare.vrm").content) == content_of(source)


def test_gradients_are_in_the_stream_where_a_file_has_plain_data_too(tmp_path: Path) -> None:
    """A loader without Draco reads the plain data, in which vertices may have another order."""

    def keep_positions(content: JsonObject) -> None:
        number = content["meshes"][0]["primitives"][0]["attributes"]["POSITION"]
        content["accessors"][number] |= {"bufferView": 0}

    source = draco_twin(FOLDER / "bent_tube.glb", tmp_path / "source.glb", change=keep_positions)
    for name, change in (("in", keep_positions), ("beside", None)):
        draco_twin(FOLDER / "bent_tube.glb", source, change=change)
        bake(source, tmp_path / "baked.glb")
        primitive = read(tmp_path / "baked.glb").primitive(0)
        assert (ALPHA in primitive["extensions"][DRACO]["attributes"]) == (name == "in")
        stripped(tmp_path / "baked.glb", tmp_path / "bare.glb")
        assert (tmp_path / "bare.glb").read_bytes() == source.read_bytes()


class TestNotices:
    def codes(self, source: Path, target: Path, **options: Any) -> dict[str, int]:
        return {notice.code: notice.count for notice in bake(source, target, **options).notices}

    def test_edgebreaker_is_stored_sequentially(self, tmp_path: Path) -> None:
        source = corpus.model("barbarian-draco-edgebreaker.glb")
        found = self.codes(source, tmp_path / "out.glb")
        streams = [
            [
                primitive["extensions"][DRACO]["bufferView"]
                for _, _, primitive in primitives(read(path).content)
            ]
            for path in (source, tmp_path / "out.glb")
        ]
        assert found["draco-sequential"] == sum(one != other for one, other in zip(*streams, strict=True))
        assert "draco-sequential" not in self.codes(
            tmp_path / "out.glb", tmp_path / "out.glb", **compress(Scheme.NONE)
        )

    def test_sequential_stays_so_without_a_word(self, tmp_path: Path) -> None:
        assert self.codes(twin("draco", ADOPTING, tmp_path), tmp_path / "out.glb") == {}

    def test_a_coarse_mesh_is_doubtful_with_the_gradients_of_its_surface(self, tmp_path: Path) -> None:
        """Over half of its vertices adopt joints. Fitted gradients are made for such meshes."""
        source = twin("draco", ADOPTING, tmp_path)
        found = self.codes(source, tmp_path / "out.glb", gradients="surface")
        assert set(found) == {"lighting-doubtful"}

    def test_influences_go_beside_a_stream_with_signed_normals(self, tmp_path: Path) -> None:
        """KHR_mesh_quantization in Draco: the encoder has no signed integers for another stream."""

        def declare(content: JsonObject) -> None:
            number = content["meshes"][0]["primitives"][0]["attributes"]["NORMAL"]
            content["accessors"][number] |= {"componentType": 5120, "normalized": True}

        floats = Editable(FOLDER / ADOPTING)
        floats.array("NORMAL")[:] = np.rint(floats.array("NORMAL") * 127)
        plain = floats.write(tmp_path / "floats.glb")
        source = draco_twin(plain, tmp_path / "draco.glb", change=declare)
        result = bake(source, tmp_path / "out.glb")
        (notice,) = result.notices
        assert notice.code == "not-compressed"
        assert "its new JOINTS_0 and WEIGHTS_0 are stored beside its Draco stream" in notice.message
        assert "its NORMAL are signed integers" in notice.message
        now, then = (read(path).primitive(0)["extensions"][DRACO] for path in (tmp_path / "out.glb", source))
        assert now["bufferView"] == then["bufferView"]
        assert then["attributes"].keys() - now["attributes"].keys() == {"JOINTS_0", "WEIGHTS_0"}
        verdict = verify_file(str(tmp_path / "out.glb"), REST)
        assert (verdict.error, [check.name for check in verdict.checks if check.problems]) == (None, [])
        stripped(tmp_path / "out.glb", tmp_path / "bare.glb")
        assert (tmp_path / "bare.glb").read_bytes() == source.read_bytes()
        again = self.codes(tmp_path / "out.glb", tmp_path / "out.glb", **compress(Scheme.DRACO))
        assert again == {"not-compressed": 1}

    def test_strips_are_not_put_into_draco(self, tmp_path: Path) -> None:
        path = corpus.model("spider-triangle-strip.glb")
        assert self.codes(path, tmp_path / "out.glb", **compress(Scheme.DRACO))["not-compressed"] == 1
        assert names_of(read(tmp_path / "out.glb").content) == set()


class TestQuantising:
    @pytest.mark.parametrize(
        ("name", "values", "why"),
        [
            ("TEXCOORD_0", np.zeros((20, 2), np.uint16), "it is of integers"),
            ("NORMAL", np.full((20, 3), 3e38, np.float32), None),
            ("TEXCOORD_0", np.full((20, 2), np.nan, np.float32), "it holds a not-a-number"),
            ("TEXCOORD_0", np.eye(20, 2, dtype=np.float32) * np.float32(3e38), "lie too far apart"),
        ],
    )
    def test_values_that_cannot_be_quantised_are_named(
        self, name: str, values: npt.NDArray[Any], why: str | None, tmp_path: Path
    ) -> None:
        path = write_model(tmp_path / "odd.glb", [sheet(**{name: values})])
        compression = Compression(Scheme.DRACO, bits={name: 10})
        document = read_document(str(path))
        recoded(document, skinned_sources(document), compression)
        notices = list(document.notices)
        found = [(notice.code, notice.place.attribute) for notice in notices]
        assert found == ([] if why is None else [("bits-ignored", name)])
        assert why is None or why in notices[0].message

    def test_more_bits_than_a_float_has_are_refused(self) -> None:
        """At 30 Draco's tables took gigabytes and many seconds for any model."""
        with pytest.raises(ChoiceError, match=r"normal_bits=25: expected a whole number from 2 to 24"):
            BakeOptions(compress=Scheme.DRACO, position_bits=12, normal_bits=25)

    def test_the_gradients_fit_the_quantised_mesh(self, tmp_path: Path) -> None:
        """Of 8 bits something is to be seen; digests and verify's own gradients are those of the output."""
        options = compress(Scheme.DRACO, POSITION=8, NORMAL=8)
        bake(FOLDER / "bent_tube.glb", tmp_path / "baked.glb", **options)
        found, original = read_plain(tmp_path / "baked.glb"), read(FOLDER / "bent_tube.glb")
        off = np.abs(found.attribute("POSITION") - original.attribute("POSITION")).max()
        extent = np.ptp(original.attribute("POSITION"), axis=0).max()
        assert extent / 255 / 4 < off <= extent / 255 / 2 * 1.001
        verdict = verify_file(str(tmp_path / "baked.glb"), REST)
        assert [check.name for check in verdict.checks if check.outcome == "failed"] == []
        bounds = found.content["accessors"][found.primitive(0)["attributes"]["POSITION"]]
        np.testing.assert_array_equal(bounds["min"], found.attribute("POSITION").min(axis=0))
        np.testing.assert_array_equal(bounds["max"], found.attribute("POSITION").max(axis=0))
        assert found.stored_attribute("JOINTS_0").tobytes() == original.stored_attribute("JOINTS_0").tobytes()

    def test_the_original_is_quantised_but_once(self, tmp_path: Path) -> None:
        options = compress(Scheme.DRACO, POSITION=9)
        bake(FOLDER / "bent_tube.glb", tmp_path / "one.glb", **options)
        bake(tmp_path / "one.glb", tmp_path / "two.glb", **options)
        assert (tmp_path / "two.glb").read_bytes() == (tmp_path / "one.glb").read_bytes()


def test_level_reaches_the_encoder(tmp_path: Path) -> None:
    sizes = []
    for level in (0, 3):
        options = {"compression": Compression(Scheme.MESHOPT, level)}
        bake(twin(KHR, "bent_tube.glb", tmp_path), tmp_path / f"{level}.glb", **options)
        sizes.append((tmp_path / f"{level}.glb").stat().st_size)
    assert sizes[1] < sizes[0]


def test_shared_accessors_get_copies_of_their_own_in_draco(tmp_path: Path) -> None:
    """Two primitives with other triangles of the same vertices: a stream each."""

    def share(content: JsonObject) -> None:
        first = content["meshes"][0]["primitives"][0]
        half = dict(content["accessors"][first["indices"]])
        half["count"] = 12
        content["accessors"].append(half)
        content["meshes"][0]["primitives"].append({**first, "indices": len(content["accessors"]) - 1})

    path = edited(ADOPTING, tmp_path, share)
    bake(path, tmp_path / "plain.glb")
    bake(path, tmp_path / "draco.glb", **compress(Scheme.DRACO))
    assert_same_bake(tmp_path / "draco.glb", tmp_path / "plain.glb")
    content = read(tmp_path / "draco.glb").content
    views = {primitive["extensions"][DRACO]["bufferView"] for _, _, primitive in primitives(content)}
    assert len(views) == 2


def test_a_plain_primitive_keeps_the_accessors_that_it_shares(tmp_path: Path) -> None:
    """The same mesh without its skin: only the skinned one goes into Draco."""

    def share(content: JsonObject) -> None:
        first = content["meshes"][0]["primitives"][0]
        content["meshes"].append({"primitives": [{**first, "attributes": dict(first["attributes"])}]})
        content["nodes"].append({"mesh": len(content["meshes"]) - 1})

    path = edited(ADOPTING, tmp_path, share)
    bake(path, tmp_path / "draco.glb", **compress(Scheme.DRACO))
    before, after = read(path), read(tmp_path / "draco.glb")
    assert after.primitive(1) == before.primitive(1)
    assert after.stored_attribute("POSITION", 1).tobytes() == before.stored_attribute("POSITION").tobytes()
    assert np.array_equal(after.triangles(1), before.triangles())


class TestOtherTools:
    @pytest.mark.parametrize("swapped", [False, True])
    def test_a_lost_stream_of_before_keeps_the_one_of_the_bake(self, swapped: bool, tmp_path: Path) -> None:
        """It is another buffer view now, or holds other values of the same kind."""
        bake(twin("draco", ADOPTING, tmp_path), tmp_path / "baked.glb")
        model = read(tmp_path / "baked.glb")
        before = model.primitive(0)["extensions"][DRACO]["extras"]["skinbake"]["before"]
        if swapped:
            ids = before["attributes"]
            ids["POSITION"], ids["NORMAL"] = ids["NORMAL"], ids["POSITION"]
        else:
            before["bufferView"] = 0
        rewritten(model, tmp_path / "baked.glb")
        result = strip_file(str(tmp_path / "baked.glb"), str(tmp_path / "bare.glb"))
        assert {notice.code for notice in result.notices} == {"adopted-kept", "bytes-left"}
        bare, baked = read_plain(tmp_path / "bare.glb"), read_plain(tmp_path / "baked.glb")
        assert baked.primitive(0)["attributes"].keys() - bare.primitive(0)["attributes"].keys() == {
            ALPHA,
            BETA,
        }
        for name in bare.primitive(0)["attributes"]:
            assert np.array_equal(bare.attribute(name), baked.attribute(name))
        assert "skinbake" not in json.dumps(bare.content["meshes"])

    def test_adopted_influences_stay_where_those_of_before_are_lost(self, tmp_path: Path) -> None:
        bake(twin("draco", ADOPTING, tmp_path), tmp_path / "baked.glb")
        model = read(tmp_path / "baked.glb")
        del model.primitive(0)["extensions"][DRACO]["extras"]
        rewritten(model, tmp_path / "baked.glb")
        result = strip_file(str(tmp_path / "baked.glb"), str(tmp_path / "bare.glb"))
        assert {notice.code for notice in result.notices} == {"adopted-kept", "bytes-left"}
        assert ALPHA not in read_plain(tmp_path / "bare.glb").primitive(0)["attributes"]

    def test_views_that_followed_ours_are_not_cut_off(self, tmp_path: Path) -> None:
        bake(twin(EXT, ADOPTING, tmp_path), tmp_path / "baked.glb")
        model = read(tmp_path / "baked.glb")
        fallback = len(model.content["buffers"]) - 1
        model.content["bufferViews"].insert(0, {"buffer": fallback, "byteLength": 4})
        for accessor in model.content["accessors"]:
            if "bufferView" in accessor:
                accessor["bufferView"] += 1
        rewritten(model, tmp_path / "moved.glb")
        result = strip_file(str(tmp_path / "moved.glb"), str(tmp_path / "bare.glb"))
        assert {notice.code for notice in result.notices} == {"bytes-left"}


def matched(found: GltfFile, original: GltfFile, mesh: int, other: int) -> tuple[Any, Any]:
    """Return pairs of vertices, one of each model, by position and normal: the nearest of all."""
    ours, theirs = (
        np.concatenate([model.attribute("POSITION", number), model.attribute("NORMAL", number) * 0.1], axis=1)
        for model, number in ((found, mesh), (original, other))
    )
    distances = np.linalg.norm(ours[:, None] - theirs[None], axis=2)
    return np.arange(len(ours)), distances.argmin(axis=1)


def by_joint(model: GltfFile, mesh: int, joints: int) -> Any:
    """Return α and β of every joint (V, J, 2), slot 0's from the sum rule."""
    slots, _ = model.influences(mesh)
    result = np.zeros((len(slots), joints, 2))
    for column, name in enumerate((ALPHA, BETA)):
        stored = model.attribute(name, mesh)
        full = np.concatenate([-stored.sum(axis=1, keepdims=True), stored], axis=1)
        np.add.at(result[:, :, column], (np.arange(len(slots))[:, None], slots), full)
    return result


# Draco has rounded positions to 14 bits of the mesh's box, 0.3 % of an edge, and weights to 12 bits or fewer;
# the octahedral filter turns normals a little, and the frame with them. 0: nothing was rounded anew.
TWINS = [
    ("barbarian-draco-edgebreaker.glb", "barbarian-plain.glb", 0.005),
    ("hand_l-draco-sequential.glb", "hand_l-weights-u16.glb", 0.005),
    ("BathDay/bath_day.glb", "decoded/bath_day.glb", 0.0),
    ("barbarian-EXT_meshopt-medium.glb", "barbarian-KHR_mesh_quantization.glb", 0.0),
    ("barbarian-EXT_meshopt-high.glb", "barbarian-KHR_mesh_quantization.glb", 0.005),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "original", "tolerance"), TWINS)
def test_real_twins_have_the_same_gradients_within_their_quantisation(
    name: str, original: str, tolerance: float, tmp_path: Path
) -> None:
    """The length of each joint's gradient, √(α² + β²), at the nearest vertex of the same normal.

    Nine of ten vertices agree within the tolerance, relative to the mesh's steep gradients; at the others
    rounding has moved one of several copies, or a sliver of a triangle, past what edges allow.
    """
    for target, path in (("ours", name), ("theirs", original)):
        settings = bake_settings(neighbours=Neighbours.DROP, frame=FrameChoice.NORMAL)
        # α and β of the surface: a fit follows the triangles, which positions that were rounded turn.
        bake(corpus.model(path), tmp_path / f"{target}.glb", settings=settings, gradients="surface")
    models = read_plain_many([tmp_path / "ours.glb", tmp_path / "theirs.glb"])
    found, expected = models.values()
    compared = 0
    for mesh, _, primitive in primitives(found.content):
        if ALPHA not in primitive["attributes"]:
            continue
        joints = int(max(model.influences(mesh)[0].max() for model in (found, expected))) + 1
        ours, theirs = matched(found, expected, mesh, mesh)
        gradients = [by_joint(found, mesh, joints)[ours], by_joint(expected, mesh, joints)[theirs]]
        lengths = [np.linalg.norm(entry, axis=2) for entry in gradients]
        scale = np.percentile(lengths[1].max(axis=1), 90)
        if scale == 0:  # a single joint moves all of it
            continue
        difference = np.abs(lengths[0] - lengths[1]).max(axis=1)
        assert np.percentile(difference, 90) <= tolerance * scale, mesh
        compared += len(ours)
    assert compared > 250


@pytest.mark.slow
def test_compressed_models_bake_verify_and_validate(tmp_path: Path) -> None:
    """All schemes on all compressed models of the corpus, in one run of the validator.

    It does not look inside compressed data: what was decoded is held against the reference decoders.
    """
    khronos.require_node()
    pairs = []
    for name in COMPRESSED:
        source = corpus.model(name)
        for scheme in SCHEMES:
            target = tmp_path / scheme / source.name
            target.parent.mkdir(exist_ok=True)
            bake(source, target, **compress(scheme))
            verdict = verify_file(str(target), REST)
            assert [check.name for check in verdict.checks if check.outcome == "failed"] == [], target
            pairs.append((_written_plain(source, tmp_path) if scheme == "none" else source, target))
    reports = khronos.validate_many([path for pair in pairs for path in pair])
    new = {str(target): khronos.new_findings(reports[source], reports[target]) for source, target in pairs}
    assert {target: found for target, found in new.items() if found} == {}


def _written_plain(source: Path, folder: Path) -> Path:
    model = read_plain(source)
    return rewritten(model, folder / source.name)


@pytest.mark.slow
@pytest.mark.parametrize("name", COMPRESSED)
def test_what_bake_decoded_is_what_others_decode_of_its_output(name: str, tmp_path: Path) -> None:
    """Every attribute of before, and α/β: the reference decoder on the input and on the output."""
    source = corpus.model(name)
    bake(source, tmp_path / "baked.glb", settings=bake_settings(neighbours=Neighbours.DROP))
    models = read_plain_many([source, tmp_path / "baked.glb"])
    before, after = models[source], models[tmp_path / "baked.glb"]
    count = 0
    for mesh, number, primitive in primitives(before.content):
        for attribute in primitive["attributes"]:
            ours, theirs = (model.stored_attribute(attribute, mesh, number) for model in (after, before))
            assert ours.tobytes() == theirs.tobytes(), (mesh, attribute)
        assert np.array_equal(after.triangles(mesh, number), before.triangles(mesh, number))
        count += note(after.content, mesh, number) is not None
    assert count >= 1


@pytest.mark.parametrize("kind", ["draco", EXT])
def test_what_all_of_a_file_expands_to_is_limited(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = twin(kind, "bent_tube.glb", tmp_path)
    monkeypatch.setattr("skinbake.gltf.budget.UNPACKED", Limit(100, 1000))
    bake(source, tmp_path / "out.glb")
    monkeypatch.setattr("skinbake.gltf.budget.UNPACKED", Limit(1, 1000))
    with pytest.raises(InputError, match="The limit is 1 times as many") as raised:
        bake_file(str(source), str(tmp_path / "not.glb"), gradients="surface")  # reads no clip first
    assert 'mesh 0 "tube", primitive 0' in str(raised.value)


def test_a_broken_primitive_that_none_would_decode_is_an_input_error(tmp_path: Path) -> None:
    """Unskinned, so that only decoding everything looks at it."""

    def append(content: JsonObject) -> None:
        first = content["meshes"][0]["primitives"][0]
        broken = {
            "attributes": {"POSITION": 99},
            "indices": first["indices"],
            "extensions": first["extensions"],
        }
        content["meshes"].append({"primitives": [broken]})

    path = draco_twin(FOLDER / ADOPTING, tmp_path / "twin.glb", change=append)
    with pytest.raises(InputError) as raised:
        bake_file(str(path), str(tmp_path / "out.glb"), **compress(Scheme.NONE))
    assert str(raised.value).startswith(f"{path}: mesh 1, primitive 0")
    assert not (tmp_path / "out.glb").exists()
    bake(path, tmp_path / "out.glb")


def test_views_that_are_compressed_under_both_names_are_decoded_under_both(tmp_path: Path) -> None:
    def name_twice(content: JsonObject) -> None:
        for holder in [*content["bufferViews"], *content["buffers"]]:
            if "extensions" in holder:
                holder["extensions"][KHR] = holder["extensions"][EXT]
        content["extensionsUsed"] = content["extensionsRequired"] = [EXT, KHR]

    path = meshopt_twin(FOLDER / ADOPTING, tmp_path / "twin.glb", change=name_twice)
    assert sum("extensions" in view for view in read(path).content["bufferViews"]) > 2
    bake_file(str(path), str(tmp_path / "out.glb"), **compress(Scheme.NONE))
    content = read(tmp_path / "out.glb").content
    assert "meshopt" not in json.dumps({**content, "extras": None})
    assert verify_file(str(tmp_path / "out.glb"), REST).passed


def test_no_bytes_are_cut_off_by_a_view_without_a_buffer() -> None:
    document = read_document(str(FOLDER / "seam.glb"))
    views = [{"byteLength": 4}, *document.objects("bufferViews")[1:]]
    after = document.edited(json={**document.json, "bufferViews": views})
    with pytest.raises(InputError, match="a buffer view names no buffer"):
        compacted(document, after)
