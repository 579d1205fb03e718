"""Quantised POSITION, NORMAL and TANGENT: α and β are those of the decoded values, which the shader reads.

Oracles: the same geometry in floats, and the dequantisation that stands in the inverse bind matrices.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from tests.support import corpus, khronos
from tests.support.baked_files import verify
from tests.support.gltf_reading import GltfFile, read
from tests.support.models import FOLDER, baked, note, rewritten
from tests.support.straightforward import duff

Floats = npt.NDArray[np.float64]

TUBE, WITH_TANGENTS = "bent_tube.glb", "mirrored_tangent.glb"
PLAIN, QUANTISED = "barbarian-plain.glb", "barbarian-KHR_mesh_quantization.glb"

POSITIONS_AS_FLOAT32 = 5e-6
"""Largest difference of an α between two files, relative to the largest α: float32 rounds the tube's ends by
6e-8 of its length, 3e-6 of its edges; both ends of an edge are rounded."""


def stored_as(model: GltfFile, name: str, values: npt.NDArray[Any], *, normalized: bool = False) -> GltfFile:
    """Return the model with an attribute of its first primitive stored like this, padded to 4 bytes."""
    content, data = model.content, bytearray(model.binary_chunk or b"")
    data += bytes(-len(data) % 4)
    size = values.itemsize * values.shape[1]
    padded = np.zeros((len(values), -(-size // 4) * 4 // values.itemsize), values.dtype)
    padded[:, : values.shape[1]] = values
    codes = {"int8": 5120, "uint8": 5121, "int16": 5122, "uint16": 5123, "float32": 5126}
    view = {"buffer": 0, "byteOffset": len(data), "byteLength": padded.nbytes, "target": 34962}
    content["bufferViews"].append({**view, "byteStride": padded.shape[1] * values.itemsize})
    accessor: dict[str, Any] = {
        "bufferView": len(content["bufferViews"]) - 1,
        "componentType": codes[values.dtype.name],
        "count": len(values),
        "type": f"VEC{values.shape[1]}",
        **({"normalized": True} if normalized else {}),
    }
    if name == "POSITION":
        accessor |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
    content["accessors"].append(accessor)
    content["meshes"][0]["primitives"][0]["attributes"][name] = len(content["accessors"]) - 1
    if values.dtype != np.float32:
        for key in ("extensionsUsed", "extensionsRequired"):
            content[key] = ["KHR_mesh_quantization"]
    data += padded.tobytes()
    content["buffers"][0]["byteLength"] = len(data)
    return GltfFile(model.path, content, bytes(data))


def dequantised_by_joints(model: GltfFile, scale: float, offset: Floats) -> GltfFile:
    """Return the model with p = scale · q + offset put into the inverse bind matrices, for positions q."""
    skin = model.content["skins"][0]
    matrices = model.matrices(skin["inverseBindMatrices"]).copy()
    dequantise = np.diag([scale, scale, scale, 1.0])
    dequantise[:3, 3] = offset
    flat = (matrices @ dequantise).transpose(0, 2, 1).reshape(-1, 16).astype("<f4")
    data = bytearray(model.binary_chunk or b"")
    data += bytes(-len(data) % 4)
    view = {"buffer": 0, "byteOffset": len(data), "byteLength": flat.nbytes}
    model.content["bufferViews"].append(view)
    accessor = {"componentType": 5126, "count": len(flat), "type": "MAT4"}
    model.content["accessors"].append({"bufferView": len(model.content["bufferViews"]) - 1, **accessor})
    skin["inverseBindMatrices"] = len(model.content["accessors"]) - 1
    data += flat.tobytes()
    model.content["buffers"][0]["byteLength"] = len(data)
    return GltfFile(model.path, model.content, bytes(data))


def gradients(model: GltfFile, mesh: int = 0) -> Floats:
    """Return α and β side by side, (V, 2 (K − 1))."""
    found = note(model.content, mesh)
    assert found is not None
    return np.concatenate(
        [model.attribute(name, mesh) for key in ("alpha", "beta") for name in found[key]], axis=1
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("dtype", "normalized"),
    [
        (np.int16, True),
        pytest.param(np.uint16, True, marks=pytest.mark.slow),
        pytest.param(np.int16, False, marks=pytest.mark.slow),
        (np.uint16, False),
    ],
    ids=["SHORT normalised", "UNSIGNED_SHORT normalised", "SHORT", "UNSIGNED_SHORT"],
)
def test_alpha_has_the_unit_of_the_decoded_position(dtype: Any, normalized: bool, tmp_path: Path) -> None:
    """Dequantising multiplies by s, so that ∇w, α and β are s times those of the mesh in its own unit."""
    original = read(FOLDER / TUBE)
    positions = original.attribute("POSITION")
    limit = np.iinfo(dtype).max
    low, high = positions.min(), positions.max()
    unit = limit if normalized else 1
    span = limit if np.iinfo(dtype).min == 0 else 2 * limit
    scale = float(high - low) / span * unit
    first = 0 if np.iinfo(dtype).min == 0 else -limit
    stored = np.rint((positions - low) / (high - low) * span + first).astype(dtype)
    offset = np.full(3, low - first * scale / unit)
    quantised = dequantised_by_joints(
        stored_as(read(FOLDER / TUBE), "POSITION", stored, normalized=normalized), scale, offset
    )
    floats = stored_as(original, "POSITION", (scale * (stored / unit) + offset).astype(np.float32))
    baked(rewritten(quantised, tmp_path / "q.glb"), tmp_path / "quantised.glb")
    baked(rewritten(floats, tmp_path / "f.glb"), tmp_path / "floats.glb")
    ours, theirs = gradients(read(tmp_path / "quantised.glb")), gradients(read(tmp_path / "floats.glb"))
    assert np.abs(ours - scale * theirs).max() <= POSITIONS_AS_FLOAT32 * np.abs(scale * theirs).max()
    assert abs(scale - 1.0) > 0.1
    # What all of it is for: the same lighting, and a bake that verifies.
    figures = []
    for name in ("quantised.glb", "floats.glb"):
        answer = verify(tmp_path / name, "--method", "lbs", "--samples", "5")
        assert answer.exit_code == 0, answer.messages
        figures.append(answer.file["normals_by_tangents"]["lbs"])
    for lighting in ("standard", "accurate"):
        # Degrees; the joint matrices are float32, and the strongest bend amplifies their rounding.
        assert figures[0][lighting]["mean"] == pytest.approx(figures[1][lighting]["mean"], abs=1e-3)
    report = khronos.validate(tmp_path / "quantised.glb")
    assert not khronos.new_findings(khronos.validate(tmp_path / "q.glb"), report)


@pytest.mark.parametrize("dtype", [np.int8, np.int16], ids=["BYTE", "SHORT"])
@pytest.mark.parametrize("names", [("NORMAL",), ("NORMAL", "TANGENT")])
def test_t0_and_b0_are_those_of_the_decoded_normal_and_tangent(
    names: tuple[str, ...], dtype: Any, tmp_path: Path
) -> None:
    """Bytes leave a TANGENT with another length than 1, and leaning: both are taken as they are."""
    model, twin = read(FOLDER / WITH_TANGENTS), read(FOLDER / WITH_TANGENTS)
    limit = np.iinfo(dtype).max
    for name in names:
        stored = np.rint(limit * model.attribute(name)).astype(dtype)
        model = stored_as(model, name, stored, normalized=True)
        twin = stored_as(twin, name, (stored / limit).astype(np.float32))
    baked(rewritten(model, tmp_path / "q.glb"), tmp_path / "quantised.glb")
    baked(rewritten(twin, tmp_path / "f.glb"), tmp_path / "floats.glb")
    found, expected = read(tmp_path / "quantised.glb"), read(tmp_path / "floats.glb")
    frames = [(note(entry.content) or {})["frame"] for entry in (found, expected)]
    assert frames[0] == frames[1]
    ours, theirs = gradients(found), gradients(expected)
    # The decoded value is rounded to float32 in the one file, and not in the other.
    assert np.abs(ours - theirs).max() <= 4 * 2.0**-24 * np.abs(theirs).max() + 1e-12
    assert "freshness" not in verify(tmp_path / "quantised.glb", "--poses", "random:2").failed


def by_joint(model: GltfFile, mesh: int, joint_count: int) -> Floats:
    """Return ∇w of every joint at each vertex of a mesh, (V, J, 3), of a bake in the normal frame."""
    normals = model.attribute("NORMAL", mesh)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    tangents, bitangents = duff(normals)
    joints, _ = model.influences(mesh)
    both = gradients(model, mesh)
    alpha, beta = np.split(both, 2, axis=1)
    vectors = alpha[:, :, None] * tangents[:, None] + beta[:, :, None] * bitangents[:, None]
    vectors = np.concatenate([-vectors.sum(axis=1, keepdims=True), vectors], axis=1)
    result = np.zeros((len(normals), joint_count, 3))
    for slot in range(joints.shape[1]):
        np.add.at(result, (np.arange(len(normals)), joints[:, slot]), vectors[:, slot])
    return result


def skin_of(model: GltfFile, mesh: int) -> Floats:
    (node,) = [node for node in model.content["nodes"] if node.get("mesh") == mesh]
    return model.matrices(model.content["skins"][node["skin"]]["inverseBindMatrices"])


@pytest.mark.slow
@pytest.mark.parametrize(("gradients", "off"), [("surface", 6e-4), ("fitted", 2e-3)])
def test_a_real_character_quantised_by_another_tool(gradients: str, off: float, tmp_path: Path) -> None:
    """Each of its six skinned meshes is dequantised by the inverse bind matrices of a skin of its own.

    Weights became bytes, too, and influences were re-sorted: so joints are compared, not slots, and by the
    factor that fits all vertices best, from which a byte's rounding averages out.
    """
    plain = baked(corpus.model(PLAIN), tmp_path / PLAIN, gradients=gradients)
    quantised = baked(corpus.model(QUANTISED), tmp_path / QUANTISED, gradients=gradients)
    assert not khronos.new_findings(
        khronos.validate(corpus.model(QUANTISED)), khronos.validate(tmp_path / QUANTISED)
    )
    scales = []
    for mesh in (0, 8, 9, 10, 11, 12):
        assert quantised.stored_attribute("POSITION", mesh).dtype == np.int16
        dequantise = np.linalg.inv(skin_of(plain, mesh)[0]) @ skin_of(quantised, mesh)[0]
        scale = float(np.cbrt(np.linalg.det(dequantise[:3, :3])))
        moved = quantised.attribute("POSITION", mesh) @ dequantise[:3, :3].T + dequantise[:3, 3]
        # The same vertices in the same order, to a step of the 14 bits that the tool keeps.
        assert np.abs(moved - plain.attribute("POSITION", mesh)).max() < scale * 2.0**-13
        ours, theirs = by_joint(quantised, mesh, 41), by_joint(plain, mesh, 41)
        if not theirs.any():  # each of its vertices has one joint
            continue
        factor = float((ours * theirs).sum() / (theirs * theirs).sum())
        # A weight's rounding of 1/510 is some 1 % of what a weight changes by along an edge; of hundreds of
        # edges a fifth of that is left, and more of fewer: of those that the fit changes most. s differs from
        # mesh to mesh by 4 % and more.
        assert factor == pytest.approx(scale, rel=off)
        scales.append(scale)
    assert len(scales) >= 3
    assert max(scales) < 0.9
    assert max(scales) / min(scales) > 1.2
    assert verify(tmp_path / QUANTISED, "--poses", "random:2").exit_code == 0
