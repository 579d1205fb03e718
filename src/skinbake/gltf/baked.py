"""Put what was baked into a document, each primitive's attributes into accessors of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from skinbake import __version__
from skinbake.errors import InputError
from skinbake.geometry.skinned import BakedPrimitive, Float32Array, FloatArray, SkinnedPrimitive
from skinbake.gltf import metadata
from skinbake.gltf.additions import KEY, Additions
from skinbake.gltf.adoption import with_adopted
from skinbake.gltf.document import Document
from skinbake.gltf.json_access import JsonObject
from skinbake.gltf.primitives import PrimitiveSource, StoredInfluences, read_influences


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

    settings is noted in the metadata as it stands. limited are the primitive's new influence sets where it
    has fewer than the file; its arrays are then theirs.
    """

    source: PrimitiveSource
    primitive: SkinnedPrimitive
    result: BakedPrimitive
    settings: JsonObject
    limited: Sequence[StoredInfluences] | None = None


def with_baked(
    document: Document, baked: Sequence[Baked], names: AttributeNames
) -> tuple[Document, list[int]]:
    """Return the document with α, β, metadata and adopted influences, and the bytes each primitive added.

    The document must not hold an earlier bake. A NORMAL is added where the primitive has none. Raises
    InputError where an attribute of the chosen name exists already.
    """
    additions = Additions(document)
    meshes = list(document.objects("meshes"))
    lengths = []
    for item in baked:
        before = additions.byte_length
        mesh = meshes[item.source.mesh]
        primitives = list(mesh["primitives"])
        primitives[item.source.primitive] = _written(document, additions, item, names)
        meshes[item.source.mesh] = {**mesh, "primitives": primitives}
        lengths.append(additions.byte_length - before)
    return additions.applied({"meshes": meshes}), lengths


def _written(document: Document, additions: Additions, item: Baked, names: AttributeNames) -> JsonObject:
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
        attributes["NORMAL"] = additions.add(item.primitive.normals.astype(np.float32))
        note["generated"] = ["NORMAL"]
    primitive = item.primitive
    if item.limited is not None:
        note[metadata.FORMER_ATTRIBUTES] = list(item.source.attributes)
    if item.result.adopts or item.limited is not None:
        primitive = _replace_influences(document, additions, item, attributes, note)
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
            attributes[name] = additions.add(values, extras=accessor_extras)
    written = {**item.source.json, "attributes": attributes}
    if not beside:
        written["extras"] = {**(extras or {}), KEY: note}
    return written


def _by_set(slots: Float32Array) -> list[Float32Array]:
    """Split (V, K − 1) into slots 1–3, then fours."""
    return [slots[:, :3], *(slots[:, start : start + 4] for start in range(3, slots.shape[1], 4))]


def _replace_influences(
    document: Document, additions: Additions, item: Baked, attributes: dict[str, Any], note: JsonObject
) -> SkinnedPrimitive:
    """Point the attributes at the influences of the bake, note those before, and return the arrays stored.

    Attributes of sets that a limit leaves out are removed.
    """
    before = read_influences(document, item.source, len(item.primitive.positions))
    after = with_adopted(item.limited or before, item.result.adopted_joints)
    former: dict[str, int] = {}
    for number, old in enumerate(before):
        new = after[number] if number < len(after) else None
        for kind in ("joints", "weights"):
            name, stored = f"{kind.upper()}_{number}", getattr(new, kind, None)
            if stored is getattr(old, kind):
                continue
            former[name] = int(attributes.pop(name) if stored is None else attributes[name])
            if stored is not None:
                attributes[name] = additions.add(stored.values, normalized=stored.normalized)
    note["formerDigest"] = metadata.influence_digests(*_side_by_side(before))
    note["adopted"] = former
    return item.primitive.with_influences(*_side_by_side(after))


def _side_by_side(sets: Sequence[StoredInfluences]) -> tuple[npt.NDArray[np.int64], FloatArray]:
    """Return joints and weights of all influence sets, (V, K) each, decoded."""
    joints = np.concatenate([entry.joints.values.astype(np.int64) for entry in sets], axis=1)
    return joints, np.concatenate([entry.weights.decoded() for entry in sets], axis=1)
