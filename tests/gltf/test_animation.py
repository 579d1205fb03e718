"""Joint matrices of skins, against a recursive evaluation of the file by scipy and the tests' own reader."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation, Slerp

from fixtures.make_fixtures import FOLDER
from skinbake.errors import InputError
from skinbake.geometry.skinned import Float64Array
from skinbake.gltf.document import Document, read_document
from skinbake.gltf.reading.clips import clip_poses, clip_weights, read_clips
from skinbake.gltf.reading.skins import random_poses, read_skeleton, rest_pose, rig_of_mesh
from tests.support import corpus, models
from tests.support.baked_files import Editable, verify
from tests.support.command_line import invoke
from tests.support.gltf_reading import GltfFile, JsonObject, read
from tests.support.small_documents import Builder, animate

# Another evaluation: one node, one time, one matrix at a time


def sampled(file: GltfFile, sampler: JsonObject, path: str, at: float) -> Float64Array:
    times = file.values(sampler["input"])[:, 0]
    values = file.values(sampler["output"])
    method = sampler.get("interpolation", "LINEAR")
    at = float(np.clip(at, times[0], times[-1]))
    if method == "STEP" or len(times) == 1:
        key: Float64Array = values[int(np.searchsorted(times, at, side="right")) - 1]
        return key
    left = min(int(np.searchsorted(times, at, side="right")) - 1, len(times) - 2)
    span = times[left : left + 2]
    if method == "CUBICSPLINE":
        keys = values.reshape(len(times), 3, -1)[left : left + 2]
        spline = CubicHermiteSpline(span, keys[:, 1], [keys[0, 2], keys[1, 0]])
        cubic: Float64Array = spline(at)
        return cubic
    if path == "rotation":
        arc: Float64Array = Slerp(span, Rotation.from_quat(values[left : left + 2]))(at).as_quat()
        return arc
    return np.array([np.interp(at, times, column) for column in values.T])


def local_matrix(node: JsonObject, moved: dict[str, Float64Array]) -> Float64Array:
    if "matrix" in node:
        return np.array(node["matrix"], dtype=float).reshape(4, 4).T
    matrix = np.eye(4)
    turn = moved.get("rotation", np.array(node.get("rotation", [0, 0, 0, 1]), dtype=float))
    scale = moved.get("scale", np.array(node.get("scale", [1, 1, 1]), dtype=float))
    matrix[:3, :3] = Rotation.from_quat(turn).as_matrix() @ np.diag(scale)
    matrix[:3, 3] = moved.get("translation", np.array(node.get("translation", [0, 0, 0]), dtype=float))
    return matrix


def global_matrix(file: GltfFile, number: int, moved: dict[int, dict[str, Float64Array]]) -> Float64Array:
    nodes = file.content["nodes"]
    own = local_matrix(nodes[number], moved.get(number, {}))
    above = [place for place, node in enumerate(nodes) if number in node.get("children", [])]
    return global_matrix(file, above[0], moved) @ own if above else own


def expected_matrices(file: GltfFile, skin: int, clip: int | None, at: float) -> Float64Array:
    """Return the joint matrices (J, 4, 4) of one moment."""
    moved: dict[int, dict[str, Float64Array]] = {}
    animation = {"channels": [], "samplers": []} if clip is None else file.content["animations"][clip]
    for channel in animation["channels"]:
        target = channel["target"]
        if "node" in target and target["path"] != "weights":
            sampler = animation["samplers"][channel["sampler"]]
            moved.setdefault(target["node"], {})[target["path"]] = sampled(file, sampler, target["path"], at)
    description = file.content["skins"][skin]
    joints = description["joints"]
    bind = np.tile(np.eye(4), (len(joints), 1, 1))
    if "inverseBindMatrices" in description:
        bind = file.matrices(description["inverseBindMatrices"])
    return np.stack(
        [global_matrix(file, joint, moved) @ inverse for joint, inverse in zip(joints, bind, strict=False)]
    )


def assert_poses_as_expected(path: Path, *, moments: int, clips: int) -> None:
    document, file = read_document(str(path)), read(path)
    found_clips = read_clips(document)
    assert len(found_clips) == len(file.content.get("animations", []))
    for skin in range(len(file.content["skins"])):
        skeleton = read_skeleton(document, skin)
        at_rest = expected_matrices(file, skin, None, 0.0)
        # Products of a dozen matrices with entries up to the size of the model.
        tolerance = 1e-12 * max(1.0, float(np.abs(at_rest).max()))
        assert np.abs(rest_pose(skeleton)[0] - at_rest).max() < tolerance
        for number, clip in list(enumerate(found_clips))[:clips]:
            # Before the first key, in between, after the last.
            rng = np.random.default_rng(number)
            at = np.concatenate([[-1.0], rng.uniform(0.0, clip.duration, moments), [clip.duration + 1.0]])
            found = clip_poses(skeleton, clip, at)
            expected = np.stack([expected_matrices(file, skin, number, moment) for moment in at.tolist()])
            assert np.abs(found - expected).max() < tolerance


@pytest.mark.parametrize("name", ["bent_tube.glb", "shared_accessors.gltf"])
def test_a_fixtures_clips_pose_it_as_a_recursive_evaluation_does(name: str) -> None:
    assert_poses_as_expected(FOLDER / name, moments=5, clips=2)


@pytest.mark.parametrize(
    "name",
    [
        "CesiumMan/CesiumMan.glb",
        "Mannequiny/mannequiny-0.3.0.glb",
        "Alien/Alien_Scolitex.gltf",
        "asset-generator/Animation_Skin/Animation_Skin_06.gltf",
        "asset-generator/Animation_Skin/Animation_Skin_02.gltf",
    ],
)
def test_a_models_clips_pose_it_as_a_recursive_evaluation_does(name: str) -> None:
    assert_poses_as_expected(corpus.character(name), moments=2, clips=2)


# Small documents


def arm(*, inverse_bind: bool = True) -> Builder:
    """Make a root, a shoulder with a matrix, an elbow and, listed first in the skin, a hand."""
    builder = Builder()
    builder.json["nodes"] = [
        {"children": [2], "translation": [0.0, 1.0, 0.0], "scale": [2.0, 2.0, 2.0]},
        {"name": "hand", "translation": [0.0, 0.5, 0.0], "scale": [1.0, 0.5, 1.0]},
        {"children": [3], "matrix": [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 0, 3, 0, 1]},
        {"children": [1], "rotation": [0.0, 0.0, 0.6, 0.8], "translation": [0.0, 1.0, 0.25]},
    ]
    builder.json["skins"] = [{"joints": [1, 2, 3]}]
    if inverse_bind:
        matrices = np.random.default_rng(4).normal(size=(3, 4, 4))
        matrices[:, :, 3] = [0.0, 0.0, 0.0, 1.0]
        builder.json["skins"][0]["inverseBindMatrices"] = builder.accessor(matrices)
    return builder


def check(builder: Builder, tmp_path: Path) -> None:
    path = tmp_path / "small.gltf"
    path.write_bytes(builder.text())
    assert_poses_as_expected(path, moments=8, clips=9)


def test_the_rest_pose_has_matrices_ancestors_and_any_order_of_joints(tmp_path: Path) -> None:
    builder = arm()
    path = tmp_path / "small.gltf"
    path.write_bytes(builder.text())
    found = rest_pose(read_skeleton(builder.document(), 0))
    assert found.shape == (1, 3, 4, 4)
    assert found[0] == pytest.approx(expected_matrices(read(path), 0, None, 0.0), abs=1e-14)


def test_without_inverse_bind_matrices_joint_matrices_are_global_transforms() -> None:
    skeleton = read_skeleton(arm(inverse_bind=False).document(), 0)
    # By hand: the root doubles and lifts by 1, the shoulder turns X to Y and lifts by 3 (so 2 · 3 + 1 = 7).
    shoulder = [[0, -2, 0, 0], [2, 0, 0, 7], [0, 0, 2, 0], [0, 0, 0, 1]]
    assert rest_pose(skeleton)[0, 1] == pytest.approx(np.array(shoulder), abs=1e-15)
    # The elbow's rotation (0, 0, 0.6, 0.8) has cosine 0.28 and sine 0.96.
    turn = np.array([[0.28, -0.96, 0, 0], [0.96, 0.28, 0, 1], [0, 0, 1, 0.25], [0, 0, 0, 1]])
    assert rest_pose(skeleton)[0, 2] == pytest.approx(np.array(shoulder) @ turn, abs=1e-15)


def test_the_more_inverse_bind_matrices_than_joints_the_first_count() -> None:
    builder = arm(inverse_bind=False)
    matrices = np.tile(np.diag([2.0, 3.0, 4.0, 1.0]), (5, 1, 1))
    builder.json["skins"][0]["inverseBindMatrices"] = builder.accessor(matrices)
    plain = rest_pose(read_skeleton(arm(inverse_bind=False).document(), 0))
    assert rest_pose(read_skeleton(builder.document(), 0)) == pytest.approx(plain @ matrices[0], abs=1e-14)


@pytest.mark.parametrize("method", ["STEP", "LINEAR", None])
@pytest.mark.parametrize("path", ["translation", "rotation", "scale"])
def test_every_path_is_animated_by_every_method(method: str | None, path: str, tmp_path: Path) -> None:
    builder = arm()
    rng = np.random.default_rng(2)
    animate(builder, path=path, method=method, values=rng.normal(size=(3, 4 if path == "rotation" else 3)))
    check(builder, tmp_path)


def point(builder: Builder, pointer: object) -> JsonObject:
    """Have the last clip name its target by a pointer."""
    target: JsonObject = {"path": "pointer", "extensions": {"KHR_animation_pointer": {"pointer": pointer}}}
    builder.json["animations"][-1]["channels"][0]["target"] = target
    return target


@pytest.mark.parametrize("path", ["translation", "rotation", "scale"])
def test_a_pointer_to_a_node_moves_it_as_a_channel_with_a_node_does(path: str) -> None:
    values = np.random.default_rng(2).normal(size=(3, 4 if path == "rotation" else 3))
    at = np.linspace(-1.0, 3.0, 9)
    found = []
    for is_pointer in (False, True):
        builder = arm()
        animate(builder, path=path, values=values)
        if is_pointer:
            point(builder, f"/nodes/3/{path}")
        document = builder.document()
        [clip] = read_clips(document)
        found.append(clip_poses(read_skeleton(document, 0), clip, at))
    assert np.array_equal(found[0], found[1])
    assert np.abs(np.diff(found[1], axis=0)).max() > 0.1


@pytest.mark.parametrize(
    "pointer",
    [
        "/materials/0/pbrMetallicRoughness/baseColorFactor",
        "/nodes/3",
        "/nodes/3/rotation/0",
        "/nodes/03/rotation",
        "/nodes/3/matrix",
        "nodes/3/rotation",
        "/nodes/-1/rotation",
        f"/nodes/{'9' * 5000}/rotation",
        "",
        None,
    ],
)
def test_a_pointer_to_something_else_moves_nothing(pointer: object) -> None:
    builder = arm()
    animate(builder)
    point(builder, pointer)
    assert read_clips(builder.document()) == []


@pytest.mark.parametrize("holder", ["nodes", "meshes"])
def test_pointers_to_single_morph_weights_move_them_as_a_channel_of_all_does(
    holder: str, tmp_path: Path
) -> None:
    """The weight of target 1 alone, then those of all targets one by one; others rest."""
    model = Editable(FOLDER / "morphed_sheet.glb")
    content = model.content
    [body] = [number for number, node in enumerate(content["nodes"]) if "skin" in node]
    count = len(content["meshes"][0]["primitives"][0]["targets"])
    content["meshes"][0]["weights"] = [0.25] * count
    content["nodes"][body].pop("weights", None)
    animation = content["animations"][0]
    whole = next(one for one in animation["channels"] if one["target"]["path"] == "weights")
    sampler = animation["samplers"][whole["sampler"]]
    keys = content["accessors"][sampler["input"]]["count"]
    values = np.array(model.stored(sampler["output"])).reshape(keys, -1, count)
    document = read_document(str(model.write(tmp_path / "whole.glb")))
    at = np.linspace(0.0, 2.0, 23)
    resting = np.full(count, 0.25)

    def weights(targets: list[int]) -> Float64Array:
        moving = animation["channels"]
        animation["channels"] = [one for one in moving if one["target"]["path"] not in {"weights", "pointer"}]
        for target in targets:
            output = model.add(np.ascontiguousarray(values[:, :, target].reshape(-1, 1), dtype=np.float32))
            animation["samplers"].append({**sampler, "output": output})
            pointer = f"/{holder}/{body if holder == 'nodes' else 0}/weights/{target}"
            named = {"path": "pointer", "extensions": {"KHR_animation_pointer": {"pointer": pointer}}}
            animation["channels"].append({"sampler": len(animation["samplers"]) - 1, "target": named})
        found = read_document(str(model.write(tmp_path / "single.glb")))
        return clip_weights(body, read_clips(found)[0], at, resting)

    expected = clip_weights(body, read_clips(document)[0], at, resting)
    assert np.ptp(expected, axis=0).max() > 0.1
    assert np.allclose(weights(list(range(count))), expected, atol=1e-6)
    single = weights([1])
    assert np.allclose(single[:, 1], expected[:, 1], atol=1e-6)
    assert (np.delete(single, 1, axis=1) == 0.25).all()
    named = animation["channels"][-1]["target"]["extensions"]["KHR_animation_pointer"]
    named["pointer"] = named["pointer"][:-1] + "99"
    past = read_document(str(model.write(tmp_path / "past.glb")))
    with pytest.raises(InputError, match='"weight" is 99, but'):
        read_clips(past)


def test_a_broken_pointer_is_refused() -> None:
    builder = arm()
    animate(builder)
    point(builder, "/nodes/4/rotation")
    with pytest.raises(
        InputError,
        match='clip "animation 0": the pointer "/nodes/4/rotation": "node" is 4, but the file has 4 nodes',
    ):
        read_clips(builder.document())
    point(builder, 3)
    with pytest.raises(InputError, match='"pointer" must be a string, found 3'):
        read_clips(builder.document())


@pytest.mark.parametrize("path", ["translation", "rotation", "scale"])
def test_every_path_is_animated_by_cubic_splines(path: str, tmp_path: Path) -> None:
    builder = arm()
    values = np.random.default_rng(2).normal(size=(9, 4 if path == "rotation" else 3))
    animate(builder, path=path, method="CUBICSPLINE", values=values)
    check(builder, tmp_path)


def test_normalised_integer_outputs_are_decoded(tmp_path: Path) -> None:
    builder = arm()
    values = np.array([[0, 0, 0, 127], [0, 76, 0, 102], [-76, 0, 0, 102]], dtype=np.int8)
    animate(builder, values=values, normalized=True)
    animate(builder, values=values.astype(np.int16) * 258, normalized=True, method="STEP")
    check(builder, tmp_path)


def test_an_ancestor_outside_the_skin_moves_its_joints(tmp_path: Path) -> None:
    builder = arm()
    animate(builder, node=0, path="translation", values=[[0, 0, 0.0], [5, 0, 0], [0, 0, -3]])
    check(builder, tmp_path)
    document = builder.document()
    clip = read_clips(document)[0]
    found = clip_poses(read_skeleton(document, 0), clip, np.array([0.0, 1.0]))
    assert np.abs(found[1] - found[0]).max() > 1.0


def test_channels_of_one_clip_may_share_their_times_or_have_their_own(tmp_path: Path) -> None:
    builder = arm()
    animate(builder)
    animate(builder, node=1, times=[0.5, 1.0, 2.0])
    animate(builder, node=0, path="translation", values=[[0, 0, 0.0], [5, 0, 0], [0, 0, -3]])
    clip, *others = builder.json["animations"]
    for number, other in enumerate(others, start=1):
        clip["samplers"] += other["samplers"]
        clip["channels"] += [{**other["channels"][0], "sampler": number}]
    clip["samplers"].append({**clip["samplers"][1], "input": clip["samplers"][0]["input"]})
    clip["channels"].append({"sampler": 3, "target": {"node": 2, "path": "rotation"}})
    del builder.json["animations"][1:]
    check(builder, tmp_path)


def test_channels_that_move_no_node_are_left_out_and_so_are_clips_without_others() -> None:
    builder = arm()
    animate(builder, node=None)
    animate(builder, path="weights", values=[0.0, 1.0, 0.0])
    animate(builder, path="pointer")
    animate(builder)
    clips = read_clips(builder.document())
    assert [clip.name for clip in clips] == ["animation 3"]
    assert [channel.node for channel in clips[0].channels] == [3]
    assert clips[0].duration == 2.5


def test_a_clip_lasts_as_long_as_its_longest_channel_and_keeps_its_name() -> None:
    builder = arm()
    animate(builder, times=[0.0, 1.0, 4.0])
    animate(builder)
    first, second = builder.json["animations"]
    second["samplers"] += first["samplers"]
    second["channels"].append({"sampler": 1, "target": {"node": 1, "path": "rotation"}})
    second["name"] = "wave"
    assert [(clip.name, clip.duration) for clip in read_clips(builder.document())] == [
        ("animation 0", 4.0),
        ("wave", 4.0),
    ]


# Random poses


def turns(document: Document, skin: int, matrices: Float64Array) -> Float64Array:
    """Return by how much each joint is turned against its rest, about its own origin: (P, J) radians."""
    skeleton = read_skeleton(document, skin)
    bind = np.linalg.inv(skeleton.inverse_bind)
    found = []
    for pose in [rest_pose(skeleton)[0], *matrices]:
        placed = dict(zip(skeleton.joints.tolist(), pose @ bind, strict=True))
        above = [skeleton.parents[joint] for joint in skeleton.joints.tolist()]
        # A joint whose parent is no joint hangs on something that no pose moves.
        found.append(
            [
                np.linalg.inv(placed.get(parent, np.eye(4))) @ own
                for parent, own in zip(above, placed.values(), strict=True)
            ]
        )
    locals_ = np.array(found)
    extra = np.linalg.inv(locals_[0]) @ locals_[1:]
    poses, joints = extra.shape[:2]
    sizes: Float64Array = Rotation.from_matrix(extra[:, :, :3, :3].reshape(-1, 3, 3)).magnitude()
    assert np.abs(extra[..., :3, 3]).max() < 1e-6
    return sizes.reshape(poses, joints)


def test_random_poses_turn_every_joint_within_the_angle_and_come_from_the_seed() -> None:
    document = read_document(str(FOLDER / "bent_tube.glb"))
    skeleton = read_skeleton(document, 0)
    angle = np.radians(25.0)
    found = random_poses(skeleton, 40, angle=angle, seed=5)
    assert found.shape == (40, 3, 4, 4)
    sizes = turns(document, 0, found)
    # Inverse bind matrices are float32.
    assert sizes.max() <= angle + 1e-6
    assert (sizes.max(axis=0) > 0.9 * angle).all()
    assert np.array_equal(found, random_poses(skeleton, 40, angle=angle, seed=5))
    assert not np.array_equal(found, random_poses(skeleton, 40, angle=angle, seed=6))
    assert random_poses(skeleton, 1, angle=0.0, seed=5) == pytest.approx(rest_pose(skeleton), abs=1e-15)


def test_random_poses_of_a_real_skeleton_stay_within_the_angle() -> None:
    document = read_document(str(corpus.character("CesiumMan/CesiumMan.glb")))
    angle = np.radians(30.0)
    sizes = turns(document, 0, random_poses(read_skeleton(document, 0), 10, angle=angle, seed=1))
    # Inverse bind matrices are float32.
    assert sizes.max() <= angle + 1e-5
    assert sizes.mean() == pytest.approx(angle / 2, rel=0.2)


# Broken files


def skeleton_of(builder: Builder) -> None:
    read_skeleton(builder.document(), 0)


def clips_of(builder: Builder) -> None:
    read_clips(builder.document())


def edited(change: Callable[[JsonObject], object]) -> Builder:
    builder = arm()
    animate(builder)
    change(builder.json)
    return builder


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda json: json["nodes"][1].update(children=[0]), "is its own ancestor"),
        (lambda json: json["nodes"][1].update(children=[1]), "two parents|own ancestor"),
        (lambda json: json["nodes"][0].update(children=[0, 2]), "is its own ancestor"),
        (lambda json: json["nodes"][0].update(children=[2, 3]), "node 3 has two parents"),
        (lambda json: json["nodes"][0].update(children=2), "children that are not an array"),
        (
            lambda json: json["nodes"][0].update(children=[9]),
            'node 0: "child" is 9, but the file has 4 nodes',
        ),
        (lambda json: json["skins"][0].update(joints=[]), "skin 0 has no joints"),
        (lambda json: json["skins"][0].pop("joints"), "skin 0 has no joints"),
        (
            lambda json: json["skins"][0].update(joints=[1, 7]),
            'skin 0: "joint" is 7, but the file has 4 nodes',
        ),
        (lambda json: json["nodes"][2].update(matrix=[1.0] * 15), 'node 2: "matrix" must be 16 numbers'),
        (lambda json: json["nodes"][3].update(rotation="none"), 'node 3: "rotation" must be 4 numbers'),
        (lambda json: json["nodes"][3].update(translation=[1, 2, None]), 'node 3: "translation" must be 3'),
        (lambda json: json["nodes"][3].update(scale=[True, 1, 1]), 'node 3: "scale" must be 3 numbers'),
        (lambda json: json["nodes"][3].update(scale=[10**400, 1, 1]), 'node 3: "scale" must be 3 numbers'),
        (lambda json: json["skins"][0].update(inverseBindMatrices=1), "3 finite 4 × 4 matrices"),
        (
            lambda json: json["skins"][0].update(inverseBindMatrices=99),
            'skin 0: "inverseBindMatrices" is 99, but the file has',
        ),
        (lambda json: json["accessors"][0].update(count=2), "3 finite 4 × 4 matrices"),
    ],
)
def test_a_broken_skeleton_is_refused(change: Callable[[JsonObject], object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        skeleton_of(edited(change))


def test_inverse_bind_matrices_must_be_finite() -> None:
    builder = arm(inverse_bind=False)
    matrices = np.tile(np.eye(4), (3, 1, 1))
    matrices[2, 1, 1] = np.inf
    builder.json["skins"][0]["inverseBindMatrices"] = builder.accessor(matrices)
    with pytest.raises(InputError, match="finite"):
        skeleton_of(builder)


def _sampler(json: JsonObject) -> JsonObject:
    found: JsonObject = json["animations"][0]["samplers"][0]
    return found


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda json: _sampler(json).pop("input"), "lacks its input or output"),
        (
            lambda json: _sampler(json).pop("output"),
            'clip "animation 0", node 3: its sampler lacks its input or output',
        ),
        (
            lambda json: _sampler(json).update(interpolation="BEZIER"),
            "node 3: its sampler has the unknown interpolation 'BEZIER'",
        ),
        (
            lambda json: _sampler(json).update(interpolation="CUBICSPLINE"),
            "needs 9 outputs of 4 components, found 3 of 4",
        ),
        (lambda json: _sampler(json).update(output=0), "needs 3 outputs of 4 components, found"),
        (
            lambda json: _sampler(json).update(output=77),
            'clip "animation 0": "output" is 77, but the file has',
        ),
        (
            lambda json: json["animations"][0]["channels"][0].update(sampler=5),
            'clip "animation 0": "sampler" refers to entry 5',
        ),
        (
            lambda json: json["animations"][0]["channels"][0]["target"].update(node=40),
            'clip "animation 0": "node" is 40, but the file has 4 nodes',
        ),
        (
            lambda json: json["animations"][0]["channels"][0]["target"].update(path="scale"),
            "3 outputs of 3 components, found 3 of 4",
        ),
    ],
)
def test_a_broken_animation_is_refused(change: Callable[[JsonObject], object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        clips_of(edited(change))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize(
    ("path", "components", "words"),
    [
        ("rotation", 4, "a rotation of its keys is not a finite number"),
        ("translation", 3, "a translation of its keys is not a finite number"),
        ("scale", 3, "a scale of its keys is not a finite number"),
    ],
)
def test_outputs_must_be_finite_and_the_clip_and_the_node_are_named(
    path: str, components: int, words: str, value: float
) -> None:
    builder = arm()
    values = np.ones((3, components))
    values[1, 2] = value
    animate(builder, path=path, values=values)
    builder.json["animations"][0]["name"] = "walk"
    builder.json["nodes"][3]["name"] = "hip"
    with pytest.raises(InputError) as raised:
        clips_of(builder)
    assert raised.value.message == f'clip "walk", node "hip": {words}'
    del builder.json["animations"][0]["name"], builder.json["nodes"][3]["name"]
    with pytest.raises(InputError) as raised:
        clips_of(builder)
    assert raised.value.message == f'clip "animation 0", node 3: {words}'


def test_a_sampler_of_the_wrong_size_is_told_with_its_clip_and_node() -> None:
    with pytest.raises(InputError) as raised:
        clips_of(edited(lambda json: json["animations"][0]["channels"][0]["target"].update(path="scale")))
    assert raised.value.message.startswith('clip "animation 0", node ')
    assert raised.value.message.endswith(
        ": its sampler for scale needs 3 outputs of 3 components, found 3 of 4 components"
    )


@pytest.mark.parametrize(
    ("times", "words"),
    [
        ([0.0, np.nan, 2.0], "a time of its keys is not a finite number"),
        ([0.0, 1.0, np.inf], "a time of its keys is not a finite number"),
        ([0.0, 1.5, 0.25], "the times of its keys must ascend, but 0.25 s follows 1.5 s"),
        ([[0.0, 1.0, 2.0]] * 3, "the times of its keys must be scalars, found 3 components"),
    ],
)
def test_broken_times_are_told_with_their_clip_and_node(times: object, words: str) -> None:
    builder = arm()
    animate(builder, times=times)
    builder.json["animations"][0]["name"] = "walk"
    builder.json["nodes"][3]["name"] = "hip"
    with pytest.raises(InputError) as raised:
        clips_of(builder)
    assert raised.value.message == f'clip "walk", node "hip": {words}'


def test_skins_that_say_the_same_share_their_joints(tmp_path: Path) -> None:
    def copy_skins(root: JsonObject) -> None:
        (first,) = root["skins"]
        other = {**first, "joints": first["joints"][::-1]}
        root["skins"] = [first, {**first, "name": "another"}, other]

    document = read_document(str(models.edited("bent_tube.glb", tmp_path, copy_skins)))
    one, same, other = (read_skeleton(document, skin) for skin in range(3))
    assert same is one
    assert other.joints.tolist() != one.joints.tolist()


def test_joints_that_are_written_otherwise_are_the_same(tmp_path: Path) -> None:
    def copy_skin(root: JsonObject) -> None:
        (first,) = root["skins"]
        root["skins"] = [first, {**first, "joints": [float(joint) for joint in first["joints"]]}]

    document = read_document(str(models.edited("bent_tube.glb", tmp_path, copy_skin)))
    assert read_skeleton(document, 0) is read_skeleton(document, 1)


def test_a_broken_skin_is_read_once_and_refused_each_time() -> None:
    document = edited(lambda json: json["skins"][0]["joints"].append("4")).document()
    errors = []
    for _ in range(3):
        with pytest.raises(InputError, match='skin 0: "joint" must be an integer') as caught:
            read_skeleton(document, 0)
        errors.append(caught.value)
    assert errors[0] is errors[1] is errors[2]


def test_a_joint_that_is_nested_deep_is_refused() -> None:
    nested: list[object] = []
    for _ in range(5000):
        nested = [nested]
    document = arm().document()
    document.objects("skins")[0]["joints"].append(nested)
    with pytest.raises(InputError, match=r"must be an integer of at least 0, found (an array nested|\[\[\[)"):
        read_skeleton(document, 0)


def test_the_rig_of_many_meshes_is_made_once(tmp_path: Path) -> None:
    def draw_copies(root: JsonObject) -> None:
        drawing = next(node for node in root["nodes"] if "skin" in node)
        root["meshes"] += [root["meshes"][0]] * 5
        root["nodes"] += [{**drawing, "mesh": mesh} for mesh in range(1, 6)]
        root["skins"].append({**root["skins"][0], "joints": root["skins"][0]["joints"][::-1]})
        root["nodes"].append({**drawing, "mesh": 5, "skin": 1})

    document = read_document(str(models.edited("bent_tube.glb", tmp_path, draw_copies)))
    found = [rig_of_mesh(document, mesh) for mesh in range(6)]
    assert [others for _, others in found] == [0, 0, 0, 0, 0, 1]
    assert len({id(rig) for rig, _ in found}) == 1


@pytest.mark.slow
def test_a_clip_that_points_to_one_morph_weight_moves_it(tmp_path: Path) -> None:
    target = tmp_path / "baked.glb"
    given = corpus.case("turn4/pointer_one_weight.glb")
    assert invoke("bake", given, "-o", target).exit_code == 0
    answer = verify(target, "--method", "lbs")
    assert (answer.exit_code, answer.file["morphs"]["moving"]) == (0, 1)
