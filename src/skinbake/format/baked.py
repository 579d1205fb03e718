"""Put a bake into a document: accessors for the attributes of each primitive, and the metadata."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from skinbake.choices import Frame, Layout
from skinbake.errors import Chosen, InputError, Message
from skinbake.format.attribute_store import AttributeStore, store_for
from skinbake.format.digests import INFLUENCE_TYPES, Digests, array_digest, influence_digests, slots_digest
from skinbake.format.encodings import CUSTOM_NAMES, GradientFormat, encoded, free_texcoords, shortened
from skinbake.format.influences import with_adopted
from skinbake.format.morph_targets import MadeTargets, add_made
from skinbake.format.note import (
    BLEND_GRADIENT,
    GENERATOR,
    KEY,
    NO_METADATA,
    VERSION,
    Blend,
    GradientNote,
    Positions,
    Straightened,
    has_place,
    with_note,
)
from skinbake.format.stored_slots import BlendGradient
from skinbake.geometry.skinned import BakedPrimitive, SkinnedPrimitive, blocks
from skinbake.geometry.triangles import TRIANGLES
from skinbake.gltf.asset import PrimitiveSource
from skinbake.gltf.document import Document
from skinbake.gltf.json_access import JsonObject, is_number
from skinbake.gltf.reading.accessors import read_accessor
from skinbake.gltf.reading.meshes import StoredInfluences, read_influences, side_by_side
from skinbake.gltf.writing.additions import Additions
from skinbake.timing import stage

FLOAT = 5126

SAME_BOUNDS = 1e-3
"""The most that bounds of one mesh may differ, as a part of its diagonal: Draco rounds positions."""

_NamedArray: TypeAlias = tuple[str, npt.NDArray[Any]]
"""The name and the values of an attribute."""


class AttributeNames(NamedTuple):
    """Patterns of the attribute names; ``{set}`` is the number of the influence set."""

    alpha: str = "_SKINBAKE_ALPHA_{set}"
    beta: str = "_SKINBAKE_BETA_{set}"

    def of(self, influence_set: int) -> tuple[str, str]:
        """Return the names of α and β of one influence set."""
        number = str(influence_set)
        return self.alpha.replace("{set}", number), self.beta.replace("{set}", number)


class Baked(NamedTuple):
    """One primitive to write: its place, its input arrays, the result, and the note of its settings.

    digests returns the digests of the arrays in the file, any TANGENT among them. replaced_sets are
    the influence sets that replace those of the file, if the bake has fewer or more of them. The arrays of
    the primitive then belong to them. blend is the gradient of its blend weights, if it has any.
    """

    source: PrimitiveSource
    primitive: SkinnedPrimitive
    result: BakedPrimitive
    digests: Digests
    note: GradientNote
    replaced_sets: Sequence[StoredInfluences] | None = None
    blend: BlendGradient | None = None


def with_baked(
    document: Document,
    baked: Sequence[Baked],
    names: AttributeNames,
    storage: GradientFormat,
    *,
    level: int | None = None,
    made: Sequence[MadeTargets] = (),
) -> tuple[Document, list[int], list[int]]:
    """Return the document with α, β, metadata and adopted influences, and the added bytes by primitive.

    The last value are the bytes of each of ``made``, what is added to morph targets.

    The document must not hold an earlier bake. A NORMAL is added if the primitive has none. The additions are
    stored like the primitive, compressed at ``level`` (see ``store_for``). The scale of the storage is that
    of the file (``bearing_scale``). α and β must be finite. Raises InputError if an attribute of the chosen
    name exists, or if α and β do not fit the storage.
    """
    additions = Additions(document, note_key=KEY)
    meshes = list(document.objects("meshes"))
    lengths = []
    for item in baked:
        before = additions.byte_length
        mesh = meshes[item.source.mesh]
        primitives = list(mesh["primitives"])
        store = store_for(document, additions, item.source, level)
        primitives[item.source.primitive] = store.finished(_written(document, store, item, names, storage))
        meshes[item.source.mesh] = {**mesh, "primitives": primitives}
        lengths.append(additions.byte_length - before)
    made_lengths = add_made(document, additions, meshes, made, level)
    return additions.applied({"meshes": meshes}), lengths, made_lengths


def _written(
    document: Document, store: AttributeStore, item: Baked, names: AttributeNames, storage: GradientFormat
) -> JsonObject:
    """Return the JSON of the primitive with all additions of bake.

    The note goes into the extras of the primitive. If another program's data is there, it goes into those of
    the first accessor of α and β.
    """
    source, attributes = item.source, dict(item.source.attributes)
    # A primitive without a NORMAL gets the generated one.
    generated = () if "NORMAL" in attributes else ("NORMAL",)
    if generated:
        attributes["NORMAL"] = store.add("NORMAL", item.primitive.normals.astype(np.float32))
    # The TANGENT of which the bake straightened some vectors replaces the former one.
    straightened, found, tangents = None, item.primitive.straightened, item.primitive.tangents
    if found and found.vertices and tangents is not None:
        former = int(attributes["TANGENT"])
        before = read_accessor(document, former, source.place.at("TANGENT")).decoded()
        straightened = Straightened(tangent=former, digest=array_digest(before, "<f4"))
        attributes["TANGENT"] = store.add("TANGENT", tangents)
    with stage("digests"):
        digests = dict(item.digests())
    note = item.note._replace(
        version=VERSION,
        generator=GENERATOR,
        frame=item.result.frame,
        influences=item.primitive.joints.shape[1],
        generated=generated,
        straightened=straightened,
    )
    stored = item.primitive
    if item.replaced_sets is not None or item.result.adopts:
        stored, adopted = _replace_influences(document, store, item, attributes)
        note = note._replace(
            former_attributes=None if item.replaced_sets is None else tuple(source.attributes),
            former_digest={name: digests[name] for name in INFLUENCE_TYPES},
            adopted=adopted,
        )
        with stage("digests"):
            digests |= influence_digests(stored.joints, stored.weights)
    if item.result.frame != Frame.TANGENT:
        digests.pop("TANGENT", None)
    alpha, beta, gradients = _stored(item, names, storage)
    slots = slots_digest(dict(gradients)) if note.poses else ""
    note = note._replace(
        poses=note.poses and note.poses._replace(slots=slots),
        digest=digests,
        alpha=tuple(alpha),
        beta=tuple(beta),
        positions=_noted_positions(document, item, stored),
        layout=storage.layout,
        encoding=storage.encoding,
        scale=storage.scale if storage.encoding.is_scaled else None,
        blend=item.blend and Blend(weights=item.blend.weights, gradient=BLEND_GRADIENT),
    )
    # The note stands in the extras, unless another program's data is there.
    is_beside = not has_place(source.json)
    holder = {KEY: note.as_json()} if is_beside else None  # of the first accessor of α and β
    if storage.layout is not Layout.CUSTOM and all(name in attributes for name, _ in gradients):
        raise InputError(NO_METADATA, source.place)
    for name, values in gradients:
        if name in attributes:
            choice = "--layout" if storage.layout is Layout.CUSTOM else "--alpha-name and --beta-name"
            message = f"it already has an attribute {name}: choose other names with {choice}, or remove it"
            raise InputError(message, source.place)
        attributes[name] = store.add(name, values, normalized=storage.encoding.is_scaled, extras=holder)
        holder = None
    if item.blend is not None:
        if BLEND_GRADIENT in attributes:
            message = f"it already has an attribute {BLEND_GRADIENT}: remove it, or bake without --blend"
            raise InputError(message, source.place)
        attributes[BLEND_GRADIENT] = store.add(BLEND_GRADIENT, item.blend.gradient)
    written = {**source.json, "attributes": attributes}
    return written if is_beside else with_note(written, note)


def _noted_positions(document: Document, item: Baked, stored: SkinnedPrimitive) -> Positions:
    """Return what a tool changes that spoils α and β, and what an engine can read at next to no cost.

    That is the type of POSITION, its bounds, how many corners are drawn, and a sum over them of hashes of the
    joints: merging equal vertices changes none of them. Tools that quantise any attribute also sort the
    influences of a vertex or drop tiny weights, but not their α and β. Bounds are left out where those of the
    accessor are not those of the triangles, because primitives share it or a tool has written it wrongly.
    """
    source = item.source
    number = int(source.attributes["POSITION"])
    accessor = document.asset.accessors[number].json
    noted = Positions(component_type=accessor["componentType"])
    if source.json.get("mode", TRIANGLES) == TRIANGLES:
        corners = int(source.json.get("indices", number))
        noted = noted._replace(corners=document.asset.accessors[corners].count(source.place.at("indices")))
    # FNV-1a of each vertex's joints, slot by slot, in uint32: sums and products wrap.
    hashes = np.full(len(stored.joints), 0x811C9DC5, np.uint32)
    for column in stored.joints.T:
        hashes = (hashes ^ column.astype(np.uint32)) * np.uint32(0x01000193)
    used, joints = np.zeros(len(item.primitive.positions), dtype=np.bool_), 0
    indices = item.primitive.triangles.ravel()
    for rows in blocks(len(indices)):
        vertices = indices[rows].astype(np.intp)
        used[vertices] = True
        joints += int(hashes[vertices].sum(dtype=np.uint32))
    if noted.corners is not None:
        noted = noted._replace(joints=joints % 2**32)
    if accessor["componentType"] != FLOAT or not used.any():
        return noted
    positions = item.primitive.positions if used.all() else item.primitive.positions[used]
    # A column at a time: over rows of three, numpy takes 25 times as long.
    columns = positions.T
    bounds = np.array([[one.min() for one in columns], [one.max() for one in columns]], dtype=np.float64)
    told = [accessor.get("min"), accessor.get("max")]
    if all(isinstance(row, list) and len(row) == 3 and all(map(is_number, row)) for row in told):
        allowed = SAME_BOUNDS * float(np.sqrt(np.square(bounds[1] - bounds[0]).sum()))
        if np.abs(np.array(told, dtype=np.float64) - bounds).max() <= allowed:
            noted = noted._replace(min=tuple(bounds[0].tolist()), max=tuple(bounds[1].tolist()))
    return noted


def _stored(
    item: Baked, names: AttributeNames, storage: GradientFormat
) -> tuple[list[str], list[str], list[_NamedArray]]:
    """Return the names of α's and of β's attributes, and every array with its name, in file order."""
    result = item.result
    if storage.layout is Layout.TEXCOORD:
        chosen = free_texcoords(item.source.attributes, result.alpha.shape[1])
        # All numbers of α, then all of β, two in each set: the middle set holds both.
        numbers, half = np.concatenate([result.alpha, result.beta], axis=1), len(chosen) // 2
        sets = [numbers[:, start : start + 2] for start in range(0, numbers.shape[1], 2)]
        return chosen[: half + 1], chosen[half:], list(zip(chosen, sets, strict=True))
    kept = result.alpha, result.beta
    if storage.encoding.is_scaled:
        kept = shortened(*kept, storage.scale)
    alpha, beta = (encoded(slots, storage.encoding, storage.scale) for slots in kept)
    pairs = [names.of(number) for number in range(len(alpha))]
    if storage.layout is Layout.CUSTOM:
        pairs = list(CUSTOM_NAMES[: len(alpha)])
        if len(pairs) < len(alpha):
            raise InputError(
                Message(
                    f"it has {len(alpha)} influence sets, and ",
                    Chosen("layout", Layout.CUSTOM),
                    f" holds {len(CUSTOM_NAMES)}: use ",
                    Chosen("layout", Layout.ATTRIBUTES),
                ),
                item.source.place,
            )
    arrays = [
        entry
        for (alpha_name, beta_name), first, second in zip(pairs, alpha, beta, strict=True)
        for entry in ((alpha_name, first), (beta_name, second))
    ]
    return [name for name, _ in pairs], [name for _, name in pairs], arrays


def _replace_influences(
    document: Document, store: AttributeStore, item: Baked, attributes: dict[str, Any]
) -> tuple[SkinnedPrimitive, dict[str, int]]:
    """Let ``attributes`` name the influences of the bake. Return the stored arrays, and former accessors.

    Attributes of sets that a limit leaves out are removed, and attributes of further sets are added.
    """
    before = read_influences(document, item.source, len(item.primitive.positions))
    after = with_adopted(item.replaced_sets or before, item.result.adopting, item.result.adopted)
    former: dict[str, int] = {}
    for number, old in enumerate(before):
        new = after[number] if number < len(after) else None
        for kind in ("joints", "weights"):
            name, stored = f"{kind.upper()}_{number}", getattr(new, kind, None)
            if stored is getattr(old, kind):
                continue
            former[name] = int(attributes.pop(name) if stored is None else attributes[name])
            if stored is not None:
                attributes[name] = store.add(name, stored.values, normalized=stored.normalized)
    for number, new in enumerate(after[len(before) :], len(before)):
        attributes[f"JOINTS_{number}"] = store.add(f"JOINTS_{number}", new.joints.values)
        attributes[f"WEIGHTS_{number}"] = store.add(
            f"WEIGHTS_{number}", new.weights.values, normalized=new.weights.normalized
        )
    return item.primitive.with_influences(*side_by_side(after)), former
