"""Files dropped on the page: every frame, encoding and layout, morph targets, and files that it refuses."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fixtures.make_fixtures import FOLDER
from skinbake.choices import Encoding, Layout
from skinbake.format.encodings import GradientFormat
from skinbake.freshness.baked_views import baked_views, rest_primitive
from skinbake.gltf.document import read_document
from skinbake.gltf.reading.clips import clip_poses, read_clips
from skinbake.gltf.reading.meshes import skinned_sources
from skinbake.gltf.reading.skins import read_skeleton
from skinbake.measure.scene import Scene
from skinbake.skinning.rest import Algorithm
from skinbake.truth.poses import PoseRequest, draws_of, pose_set
from tests.support import browser
from tests.support.baked_files import Editable
from tests.support.baking import bake_file
from tests.support.characters import AS_USUAL, Array, angles, baked, unit
from tests.support.models import copied, edited, with_pointers
from tests.support.morphed_files import morphed
from tests.support.replay import replay
from tests.view.pages import DEGREES, normals, numbers, shown, take

TUBE = FOLDER / "bent_tube.glb"
PACKED, SNORM = GradientFormat(Encoding.PACKED8), GradientFormat(Encoding.SNORM16)
COORDINATES, CUSTOM = GradientFormat(layout=Layout.TEXCOORD), GradientFormat(Encoding.PACKED8, Layout.CUSTOM)
CASES = [
    *(("bent_tube.glb", storage) for storage in (AS_USUAL, PACKED, SNORM, COORDINATES, CUSTOM)),
    *(("mirrored_tangent.glb", storage) for storage in (AS_USUAL, PACKED)),
    *(("two_sets.glb", storage) for storage in (AS_USUAL, SNORM, COORDINATES)),
]
"""Both frames, one and two sets of influences, and every way to store α and β."""

LIGHTINGS = {
    "standard": Algorithm.LBS_STANDARD,
    "fitted": Algorithm.LBS_ACCURATE,
    "dqs": Algorithm.DQS_EXACT,
}


@pytest.fixture(scope="module")
def browsing() -> Iterator[browser.Page]:
    """Open the page of a fixture, on which the tests drop others."""
    with shown(FOLDER / "weights_u8.glb") as page:
        yield page
        assert page.requests() == [page.address]


def matrices(page: browser.Page) -> Array:
    """Return the joint matrices (1, J, 4, 4) of the pose that the page shows.

    It is applied in the same call: between two calls the page measures other poses.
    """
    found = page.call(
        "(() => { application.applyPose(); "
        "return application.scene.posed.skins[0].map((matrix) => Array.from(matrix)); })"
    )
    return np.array(found).reshape(1, -1, 4, 4).swapaxes(2, 3)


@pytest.mark.parametrize(("name", "storage"), CASES, ids=str)
def test_every_frame_and_storage_is_shown(
    browsing: browser.Page, tmp_path: Path, name: str, storage: GradientFormat
) -> None:
    path = baked(FOLDER / name, tmp_path, storage=storage)
    take(browsing, path)
    assert browsing.call("(() => document.title)") == f"{path.name} – skinbake"
    document = read_document(str(path))
    (view,) = baked_views(document, skinned_sources(document))
    for lighting, algorithm in LIGHTINGS.items():
        found = normals(browsing, lighting, clip=0, time=0.6)
        wanted = unit(replay(algorithm, rest_primitive(view), matrices(browsing)).normals[0])
        assert angles(found, wanted).max() < DEGREES, lighting
    assert browsing.messages() == []


SCALES = {
    "sheared": ([1.4, 0.8, 1.0], [0.9, 1.0, 1.3]),
    "mirrored": ([-1.4, 0.8, 1.0], [0.9, 1.0, 1.3]),
    "flattened": ([1.0, 1.0, 1.0], [0.9, 0.0, 1.3]),
    "a line": ([1.0, 1.0, 1.0], [0.9, 0.0, 0.0]),
}
"""Of two joints, of which the first one carries the second one."""


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        *(("bent_tube.glb", kind) for kind in SCALES),
        ("two_sets.glb", "sheared"),
        ("two_sets.glb", "flattened"),
    ],
)
def test_dual_quaternions_take_joints_that_scale(
    browsing: browser.Page, tmp_path: Path, name: str, kind: str
) -> None:
    """Normals of the shader, and positions of the true surface, which the page finds by itself."""
    file = Editable(FOLDER / name)
    for joint, scale in zip(file.content["skins"][0]["joints"], SCALES[kind], strict=False):
        file.content["nodes"][joint]["scale"] = scale
    path = baked(file.write(tmp_path / "source.glb"), tmp_path / "baked")
    take(browsing, path)
    (view,) = baked_views(document := read_document(str(path)), skinned_sources(document))
    found = normals(browsing, "dqs", clip=0, time=0.6)
    wanted = replay(Algorithm.DQS_EXACT, rest_primitive(view), matrices(browsing))
    # Seen along a plane that is left of the surface, a normal is rounding.
    size = np.linalg.norm(wanted.normals[0], axis=1)
    clear = size > 0.05 * size.max()
    assert clear.mean() > 0.4
    side = -1 if kind == "mirrored" else 1
    assert angles(found[clear], side * unit(wanted.normals[0][clear])).max() < DEGREES
    moved, reason = browsing.call(
        """(() => {
            const { scene } = application;
            scene.truths('dqs');
            return [Array.from(scene.allSurfaces()[0].surface.moved), scene.reasonWithout('dqs')];
        })"""
    )
    assert reason == ""
    assert np.abs(np.reshape(moved, (-1, 3)) - wanted.positions[0]).max() < 1e-5
    assert browsing.messages() == []


def test_clips_of_pointers_move_the_model(browsing: browser.Page, tmp_path: Path) -> None:
    source = edited("bent_tube.glb", tmp_path / "in", with_pointers)
    path = baked(source, tmp_path)
    document = read_document(str(FOLDER / "bent_tube.glb"))
    [clip] = read_clips(document)
    take(browsing, path)
    normals(browsing, "standard", clip=0, time=0.6)
    wanted = clip_poses(read_skeleton(document, 0), clip, np.array([0.6]))
    assert np.abs(matrices(browsing) - wanted).max() < 1e-5


@pytest.mark.parametrize("numbers", [0, 4, 6])
@pytest.mark.parametrize("frame", ["normal", "tangent"])
def test_morph_targets_come_before_skinning(
    browsing: browser.Page, tmp_path: Path, frame: str, numbers: int
) -> None:
    if numbers:
        file = Editable(FOLDER / "morphed_sheet.glb")
        for target in file.primitive()["targets"] if numbers == 6 else ():
            del target["NORMAL"]
        source, path = file.write(tmp_path / "source.glb"), tmp_path / "out.glb"
        result = bake_file(source, path, frame=frame, morph_frames=True)
        assert (result.status, result.morphs[0][1].frames) == ("baked", numbers)
    else:
        path = baked(FOLDER / "morphed_sheet.glb", tmp_path, frame)
    document = read_document(str(path))
    views = baked_views(document, skinned_sources(document))
    clips = read_clips(document)
    ((skin, node),) = draws_of(document, 0, clips)
    poses = pose_set(document, skin, clips, PoseRequest(samples=5), node)
    morphing = Scene(document, views).surfaces[0].morphing(poses.morph_weights)
    assert morphing is not None
    take(browsing, path)
    pose = 3
    (surface,) = morphing.primitives([rest_primitive(view) for view in views], pose)
    for lighting, algorithm in LIGHTINGS.items():
        found = normals(browsing, lighting, clip=0, time=float(poses.times[pose] or 0.0))
        wanted = unit(replay(algorithm, surface, poses.joint_matrices[pose : pose + 1]).normals[0])
        assert angles(found, wanted).max() < DEGREES, lighting
    assert browsing.messages() == []


def test_nodes_that_share_a_mesh_keep_their_own_morph_weights(browsing: browser.Page, tmp_path: Path) -> None:
    plain = baked(FOLDER / "bent_tube.glb", tmp_path)
    one = morphed(plain, tmp_path / "one.glb", weights=[0.9, 0.0])
    both = Editable(one)
    both.content["nodes"].append({**both.content["nodes"][0], "weights": [0.0, 0.7]})
    both.content["scenes"][0]["nodes"].append(len(both.content["nodes"]) - 1)
    take(browsing, both.write(tmp_path / "both.glb"))
    found = browsing.call(
        "(() => { application.seek(0.4, true); application.draw(); return application.scene.parts.map("
        "(part) => base64Of(application.renderer.captured(part, 'standard').positions)); })"
    )
    for text, weights in zip(found, ([0.9, 0.0], [0.0, 0.7]), strict=True):
        take(browsing, morphed(plain, tmp_path / "alone.glb", weights=weights))
        alone = browsing.call(
            "(() => { application.seek(0.4, true); application.draw(); "
            "const { scene, renderer } = application; "
            "return base64Of(renderer.captured(scene.parts[0], 'standard').positions); })"
        )
        assert np.abs(numbers(text) - numbers(alone)).max() < 1e-6
    assert browsing.messages() == []


def test_a_gltf_is_shown_with_the_files_dropped_beside_it(browsing: browser.Page, tmp_path: Path) -> None:
    source = copied("shared_accessors.gltf", tmp_path / "source")
    path = tmp_path / "baked.gltf"
    assert bake_file(source, path).status == "baked"
    buffers = [each for each in tmp_path.iterdir() if each.suffix == ".bin"]
    take(browsing, path)
    assert "a buffer of it is missing" in browsing.call("(() => message.textContent)")
    assert browsing.call("(() => document.title)") != "baked.gltf – skinbake"
    take(browsing, path, *buffers)
    assert browsing.call("(() => [document.title, message.hidden])") == ["baked.gltf – skinbake", True]


def triangle(size: float) -> bytes:
    """Return a glTF of one triangle of a size."""
    values = np.full(9, size, "<f4").tobytes()
    content = {
        "buffers": [{"uri": f"data:;base64,{base64.b64encode(values).decode()}", "byteLength": 36}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
    }
    return json.dumps(content).encode()


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("huge.gltf", triangle(1e30), "its positions are too large for a renderer"),
        ("letter.txt", b"Dear reader", "Expected a .glb, .gltf or .vrm file."),
        ("broken.glb", b"glTF\2\0\0\0\xff\0\0\0", "the GLB has no JSON"),
        ("text.gltf", b"no JSON", "it is neither a GLB nor glTF"),
        ("child.gltf", b'{"nodes": [{"children": [7]}]}', "it is damaged, or too large (Cannot"),
        ("chunk.glb", b"glTF\2\0\0\0\x15\0\0\0\1\0\0\0JSON{", "it is damaged, or too large (Expected"),
        ("empty.gltf", b'{"asset": {"version": "2.0"}}', "no mesh of it is made of triangles"),
        (
            "packed.gltf",
            b'{"meshes": [{"primitives": [{"extensions": {"KHR_draco_mesh_compression": {}}}]}]}',
            "it is compressed (KHR_draco_mesh_compression)",
        ),
    ],
)
def test_what_it_cannot_show_is_said_and_the_last_model_stays(
    browsing: browser.Page, tmp_path: Path, name: str, content: bytes, words: str
) -> None:
    shown_first = baked(TUBE, tmp_path)
    take(browsing, shown_first)
    path = tmp_path / name
    path.write_bytes(content)
    take(browsing, path)
    assert words in browsing.call("(() => message.textContent)")
    assert browsing.call("(() => document.title)") == f"{shown_first.name} – skinbake"
    browsing.call("(() => application.draw())")
    assert browsing.messages() == []


def test_a_file_that_is_not_baked_has_standard_lighting_only(browsing: browser.Page) -> None:
    take(browsing, TUBE)
    options = browsing.call("(() => [...right.options].map(({ value, disabled }) => [value, disabled]))")
    assert [value for value, disabled in options if not disabled] == ["standard", "truth"]


def test_random_poses_turn_joints_that_have_a_matrix(browsing: browser.Page, tmp_path: Path) -> None:
    """The same joints, with their transforms in two ways: exporters of COLLADA write matrices."""
    found = []
    for has_matrix in (False, True):
        file = Editable(TUBE)
        for node in file.content["nodes"]:
            if has_matrix and "translation" in node:
                node["matrix"] = [*np.eye(4)[:3].ravel().tolist(), *node.pop("translation"), 1]
        del file.content["animations"]
        take(browsing, file.write(tmp_path / "still.glb"))
        assert browsing.call("(() => application.clip.name)") == "Random poses"
        browsing.call("(() => { application.seek(2.5, true); })")
        found.append(matrices(browsing))
    turned = np.linalg.norm(found[0] - np.eye(4), axis=(2, 3))
    assert (turned > 0.05).all()
    assert np.abs(found[1] - found[0]).max() < 1e-6


def test_a_file_without_skins_is_shown_at_rest(browsing: browser.Page, tmp_path: Path) -> None:
    file = Editable(TUBE)
    for name in ("skins", "animations"):
        del file.content[name]
    for node in file.content["nodes"]:
        node.pop("skin", None)
    take(browsing, file.write(tmp_path / "still.glb"))
    assert browsing.call("(() => application.isShown)")
    assert browsing.call("(() => document.getElementById('message').textContent)") == ""
    assert browsing.call("(() => application.scene.clips.map(({ name }) => name))") == ["Rest pose"]
    found = normals(browsing, "standard", clip=0, time=0.0)
    assert np.isfinite(found).all()
    assert browsing.messages() == []


@pytest.mark.parametrize(
    ("scenes", "drawn"),
    [
        ({"scenes": [{"nodes": [0, 1]}, {"nodes": [1, 5]}], "scene": 1}, [5]),
        ({"scenes": [{}, {"nodes": [4]}, {"nodes": [1, 5]}, {"nodes": [0, 1]}], "scene": 1}, [5]),
        ({"scenes": [{"nodes": [4]}, {"nodes": [0, 1]}]}, [0]),
        ({"scenes": [{"nodes": [4]}]}, [0, 5]),
        ({}, [0, 5]),
    ],
    ids=["the default", "not the default", "no default", "in no scene", "no scenes"],
)
def test_the_scene_with_a_character_is_shown(
    browsing: browser.Page, tmp_path: Path, scenes: dict[str, Any], drawn: list[int]
) -> None:
    """Two nodes draw a character: 0 and 5."""
    file = Editable(TUBE)
    file.content["nodes"] += [{"name": "nothing"}, {"mesh": 0, "skin": 0}]
    for name in ("scene", "scenes"):
        del file.content[name]
    file.content.update(scenes)
    take(browsing, file.write(tmp_path / "scenes.glb"))
    assert browsing.call("(() => document.getElementById('message').textContent)") == ""
    assert browsing.call("(() => application.scene.parts.map(({ node }) => node))") == drawn


def test_errors_far_from_the_origin_are_those_near_it(browsing: browser.Page, tmp_path: Path) -> None:
    means = []
    for distance in (0.0, 1e5):
        file = Editable(TUBE)
        file.content["nodes"].append({"translation": [distance, 0, 0], "children": [0, 1]})
        file.content["scenes"][0]["nodes"] = [4]
        take(browsing, file.write(tmp_path / "far.glb"))
        means.append(
            browsing.call(
                "(() => { const { scene } = application; application.stopMeasuring(); "
                "scene.pose(scene.clips[0], 0.4); return scene.errors('standard').mean; })"
            )
        )
    assert means[1] == pytest.approx(means[0], rel=0.002)


def test_the_file_that_was_dropped_last_is_shown(browsing: browser.Page, tmp_path: Path) -> None:
    """The first one takes longer to read."""
    names = ["slow.glb", "quick.glb"]
    texts = [base64.b64encode(TUBE.read_bytes()).decode() for _ in names]
    title = browsing.call(
        "(async (names, texts) => { "
        "const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)); "
        "const files = texts.map((text, i) => ({ name: names[i], arrayBuffer: () => new Promise((done) => "
        "setTimeout(() => done(bytes(text).buffer), i ? 0 : 400)) })); "
        "await Promise.all(files.map((file) => application.take([file]))); return document.title; })",
        names,
        texts,
    )
    assert title == "quick.glb – skinbake"
    assert browsing.call("(() => document.getElementById('message').textContent)") == ""


def test_the_former_model_comes_back_if_another_one_cannot_be_shown(
    browsing: browser.Page, tmp_path: Path
) -> None:
    take(browsing, baked(TUBE, tmp_path))
    before = browsing.call("(() => document.title)")
    browsing.call(
        "(() => { const { scene } = application; const show = scene.show.bind(scene); "
        "scene.show = (model) => { scene.show = show; show(model); throw new Error('no memory'); }; })"
    )
    take(browsing, copied("seam.glb", tmp_path))
    assert browsing.call("(() => document.getElementById('message').textContent)") == (
        "seam.glb cannot be shown: no memory"
    )
    assert browsing.call("(() => [application.isShown, document.title])") == [True, before]


def test_what_changes_while_it_plays_is_not_read_aloud(browsing: browser.Page) -> None:
    live = browsing.call(
        "(() => [...document.querySelectorAll('output')].map((one) => one.getAttribute('aria-live')))"
    )
    assert live == ["off"] * len(live) and len(live) == 3


INHERITED = ["__proto__", "constructor", "toString", "hasOwnProperty"]


@pytest.mark.parametrize("name", INHERITED)
def test_names_that_every_object_has_are_names_like_any_other(
    browsing: browser.Page, tmp_path: Path, name: str
) -> None:
    """α in an attribute of such a name is read, and so is a file in which everything is named so."""
    before = normals_of_drop(browsing, baked(TUBE, tmp_path))
    model = Editable(baked(TUBE, tmp_path))
    for kind in ("nodes", "meshes", "skins", "animations", "materials", "accessors", "scenes"):
        for entry in model.content.get(kind, []):
            entry |= {"name": name, "extras": {name: {"skinbake": {"version": 7}}, **entry.get("extras", {})}}
    primitive = model.primitive()
    primitive["extras"] |= {name: {"alpha": 1}}
    primitive["extras"]["skinbake"] |= {name: name, "alpha": [name]}
    primitive["attributes"][name] = primitive["attributes"].pop("_SKINBAKE_ALPHA_0")
    path = model.write(tmp_path / "renamed.glb")
    assert name.encode() in path.read_bytes()
    assert np.array_equal(normals_of_drop(browsing, path), before)
    assert browsing.call("(() => application.clip.name)") == name


def normals_of_drop(page: browser.Page, path: Path) -> Array:
    """Return the accurate normals of a file that is dropped on the page."""
    take(page, path)
    assert page.call("(() => document.getElementById('message').textContent)") == ""
    return normals(page, "fitted", clip=0, time=0.4)


@pytest.mark.parametrize("name", INHERITED)
@pytest.mark.parametrize("where", ["alpha", "type", "componentType"])
def test_what_every_object_has_is_not_in_the_file(
    browsing: browser.Page, tmp_path: Path, name: str, where: str
) -> None:
    model = Editable(baked(TUBE, tmp_path))
    if where == "alpha":
        model.content["meshes"][0]["primitives"][0]["extras"]["skinbake"]["alpha"] = [name]
    else:
        model.content["accessors"][0][where] = name
    take(browsing, model.write(tmp_path / "damaged.glb"))
    told = browsing.call("(() => document.getElementById('message').textContent)")
    expected = "has lost attributes of its bake" if where == "alpha" else "its accessor 0 is damaged"
    assert expected in told
