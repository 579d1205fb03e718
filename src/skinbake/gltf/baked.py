"""Put what was baked into a document, each primitive's attributes into accessors of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from skinbake import __version__
from skinbake.errors import InputError
from skinbake.geometry.skinned import BakedPrimitive, Float32Array, SkinnedPrimitive
from skinbake.gltf import metadata
from skinbake.gltf.additions import KEY, Additions
from skinbake.gltf.adoption import with_adopted
from skinbake.gltf.attribute_store import AttributeStore, store_for
from skinbake.gltf.document import Document
from skinbake.gltf.json_access import JsonObject
from skinbake.gltf.primitives import PrimitiveSource, read_influences


@dataclass(frozen=True, slots=True)
class AttributeNames:
    """Patterns of the attribute names; ``{set}`` stands for the influence set's number."""

    alpha: str = "_SKINBAKE_ALPHA_{set}"
    beta: str = "_SKINBAKE_BETA_{set}"

    def of(self, influence_set: int) -> tuple[str, str]:
        """Return the names of α and β of one influence set."""
        number = str(influence_set)
        return self.alpha.replace("{set}", number), self.beta.replace("{set}", number)


@dataclass(frozen=True, slots=True)
class Baked:
    """One primitive to be written: where, its arrays as baked from, the result, and how it was made.

    settings is noted in the metadata as it stands.
    """

    source: PrimitiveSource
    primitive: SkinnedPrimitive
    result: BakedPrimitive
    settings: JsonObject


def with_baked(
    document: Document, baked: Sequence[Baked], names: AttributeNames, *, level: int | None = None
) -> tuple[Document, list[int]]:
    """Return the document with α, β, metadata and adopted influences, and the bytes each primitive added.

    The document must not hold an earlier bake. A NORMAL is added where the primitive has none. What a
    primitive gains is stored as the primitive is, compressed at ``level`` (see ``store_for``). Raises
    InputError where an attribute of the chosen name exists already.
    """
    additions = Additions(document)
    meshes = list(document.objects("meshes"))
    lengths = []
    for item in baked:
        before = additions.byte_length
        mesh = meshes[item.source.mesh]
        primitives = list(mesh["primitives"])
        store = store_for(document, additions, item.source, level)
        primitives[item.source.primitive] = store.finished(_written(document, store, item, names))
        meshes[item.source.mesh] = {**mesh, "primitives": primitives}
        lengths.append(additions.byte_length - before)
    return additions.applied({"meshes": meshes}), lengths


def _written(document: Document, store: AttributeStore, item: Baked, names: AttributeNames) -> JsonObject:
    """Return the primitive's JSON with everything that bake adds to it."""
    attributes = dict(item.source.attributes)
    note: JsonObject = {
        "version": metadata.VERSION,
        "generator": f"skinbake {__version__}",
        "frame": item.result.frame,
        "influences": item.primitive.joints.shape[1],
        **item.settings,
    }
    if "NORMAL" not in attributes:
        attributes["NORMAL"] = store.add("NORMAL", item.primitive.normals.astype(np.float32))
        note["generated"] = ["NORMAL"]
    primitive = item.primitive
    if item.result.adopts:
        note["formerDigest"] = metadata.influence_digests(primitive.joints, primitive.weights)
        note["adopted"], primitive = _adopt(document, store, item, attributes)
    note["digest"] = metadata.digests(primitive, item.result.frame)
    alpha, beta = _by_set(item.result.alpha), _by_set(item.result.beta)
    chosen = [names.of(number) for number in range(len(alpha))]
    note["alpha"], note["beta"] = [name for name, _ in chosen], [name for _, name in chosen]
    extras = item.source.json.get("extras")
    # A null is what somebody wrote too, and a member of our name that is no note of ours is somebody's.
    beside = "extras" in item.source.json and (not isinstance(extras, dict) or KEY in extras)
    if extras == {}:
        note["keepExtras"] = True
    for number, (alpha_name, beta_name) in enumerate(chosen):
        own = {KEY: note} if beside and number == 0 else None
        for name, values, accessor_extras in (
            (alpha_name, alpha[number], own),
            (beta_name, beta[number], None),
        ):
            if name in attributes:
                raise InputError(
                    f"it has an attribute {name} already, and no metadata that says that it is skinbake's "
                    "(did a tool drop the extras?): remove it, bake from the source file, or "
                    "choose other names with --alpha-name and --beta-name",
                    item.source.place,
                )
            attributes[name] = store.add(name, values, extras=accessor_extras)
    written = {**item.source.json, "attributes": attributes}
    if not beside:
        written["extras"] = {**(extras or {}), KEY: note}
    return written


def _by_set(slots: Float32Array) -> list[Float32Array]:
    """Split (V, K − 1) into slots 1–3, then fours."""
    return [slots[:, :3], *(slots[:, start : start + 4] for start in range(3, slots.shape[1], 4))]


def _adopt(
    document: Document, store: AttributeStore, item: Baked, attributes: dict[str, Any]
) -> tuple[dict[str, int], SkinnedPrimitive]:
    """Point the attributes at new influences; return the accessors they had, and the arrays as now stored."""
    before = read_influences(document, item.source, len(item.primitive.positions))
    after = with_adopted(before, item.result.adopted_joints)
    former: dict[str, int] = {}
    for number, (old, new) in enumerate(zip(before, after, strict=True)):
        for name, stored, changed in (
            (f"JOINTS_{number}", new.joints, new.joints is not old.joints),
            (f"WEIGHTS_{number}", new.weights, new.weights is not old.weights),
        ):
            if changed:
                former[name] = int(attributes[name])
                attributes[name] = store.add(name, stored.values, normalized=stored.normalized)
    joints = np.concatenate([entry.joints.values.astype(np.int64) for entry in after], axis=1)
    weights = np.concatenate([entry.weights.decoded() for entry in after], axis=1)
    return former, replace(item.primitive, joints=joints, weights=weights)
