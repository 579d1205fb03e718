"""``skinbake cost``: the paper's algorithms in multiply-adds and bytes, for N influences or for a file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skinbake.choices import Layout
from skinbake.errors import Notice
from skinbake.files.bounds import BESIDE, Bounds
from skinbake.format.metadata import read_metadata, slot_names
from skinbake.geometry.skinned import SkinnedPrimitive
from skinbake.gltf.accessors import read_accessor
from skinbake.gltf.document import Document, read_document
from skinbake.gltf.json_access import JsonObject, integer
from skinbake.gltf.primitives import (
    PrimitiveSource,
    read_primitive,
    reason_to_skip,
    skinned_sources,
)
from skinbake.report.cost import (
    CostTable,
    FileCosts,
    FrameCost,
    FrameCosts,
    InfluenceCosts,
    PrimitiveCosts,
    VertexCost,
    VertexCosts,
)
from skinbake.skinning.algorithms import Algorithm
from skinbake.skinning.counting import (
    Cost,
    StoredTypes,
    VertexBytes,
    cost_table,
    multiply_adds,
    normal_map_cost,
    vertex_bytes,
)
from skinbake.wording import counted

TABLE = range(1, 9)
"""The numbers of influences in the table: one or two influence sets of glTF."""

ALIGNMENT = 4
"""The size of a vertex attribute's element is a multiple of this number of bytes (glTF 2.0, §3.6.2.4)."""

STEPS_A_PRIMITIVE = 300
"""The steps of counting for a primitive of few vertices: see ``budget.STEPS_FREE``."""


def cost_of_influences(influences: int) -> InfluenceCosts:
    """Return the cost of a vertex with N ≥ 1 influences and data in glTF's commonest types."""
    return InfluenceCosts(influences, _reported(cost_table(influences), influences))


def cost_by_influences() -> CostTable:
    """Return the costs of vertices with 1 … 8 influences."""
    return CostTable(tuple(cost_of_influences(influences) for influences in TABLE))


def cost_of_file(source: str, bounds: Bounds = BESIDE) -> FileCosts:
    """Return the cost of the skinned primitives of one file. Raises SkinbakeError if it cannot be read.

    Primitives without a surface are left out. Primitives without a NORMAL count as if bake had added one.
    Each gives a notice. A file without skinned primitives costs nothing.
    """
    document = read_document(source, bounds)
    sources, notices = skinned_sources(document)
    what = f"counting for {counted(len(sources), 'primitive')}"
    document.budget.claim_steps(STEPS_A_PRIMITIVE * len(sources), what, document.place)
    draws = _draws(document)
    primitives = []
    for entry in sources:
        notice = reason_to_skip(document, entry, generate_normals=True)
        if notice is None:
            with document.budget.passing():
                primitives.append(_costs(document, entry, draws[entry.mesh]))
            notice = _missing_normal(entry)
        if notice is not None:
            notices.append(notice)
    return FileCosts(
        input=source,
        primitives=tuple(primitives),
        vertices=sum(primitive.vertices * primitive.draws for primitive in primitives),
        total=_sum([primitive.per_frame for primitive in primitives]),
        notices=tuple(notices),
    )


def _draws(document: Document) -> Counter[int]:
    """Return how many nodes draw each mesh with a skin. ``skinned_sources`` has checked the indices."""
    return Counter(
        int(node["mesh"]) for node in document.objects("nodes") if "mesh" in node and "skin" in node
    )


def _missing_normal(source: PrimitiveSource) -> Notice | None:
    if "NORMAL" in source.attributes:
        return None
    message = "it has no NORMAL: the cost includes the one that bake --generate-normals adds"
    return Notice("no-normals", message, source.place)


def _costs(document: Document, source: PrimitiveSource, draws: int) -> PrimitiveCosts:
    primitive = read_primitive(document, source)
    layout = _layout(document, source)
    influences, vertices = primitive.joints.shape[1], _vertices_in_use(primitive)
    per_vertex = _reported(_file_costs(influences, layout), influences)
    return PrimitiveCosts(
        place=source.place,
        vertices=vertices,
        draws=draws,
        influences=influences,
        baked=bool(layout.baked),
        stored={**layout.plain, **layout.baked},
        per_vertex=per_vertex,
        per_frame=_times(per_vertex, vertices * draws),
    )


def _vertices_in_use(primitive: SkinnedPrimitive) -> int:
    """Return the number of vertices in the triangles. Primitives often share larger accessors."""
    used = np.zeros(len(primitive.positions), dtype=np.bool_)
    used[primitive.triangles] = True
    return int(np.count_nonzero(used))


@dataclass(frozen=True, slots=True)
class _Layout:
    """Bytes a vertex by attribute: of plain skinning, and of α and β (none: not baked).

    gradient is the number of bytes of one number of α and β, as stored or as bake would store it. scale is
    the number of bytes of a vertex's scale.
    """

    plain: dict[str, int]
    baked: dict[str, int]
    gradient: int
    scale: int


def _layout(document: Document, source: PrimitiveSource) -> _Layout:
    influences = [f"{kind}_{n}" for n in range(source.influence_sets) for kind in ("JOINTS", "WEIGHTS")]
    has_normal = "NORMAL" in source.attributes  # without one, TANGENT is ignored
    surface = [name for name in ("NORMAL", "TANGENT") if has_normal and name in source.attributes]
    plain, _ = _sizes(document, source, ["POSITION", *surface, *influences])
    plain.setdefault("NORMAL", StoredTypes().normal)
    note = read_metadata(document, source.json) or {}
    baked, components = _sizes(document, source, _baked_names(note, source))
    gradient = max(components, default=StoredTypes().gradient)
    return _Layout(plain, baked, gradient, gradient if baked and "encoding" in note else 0)


def _baked_names(note: JsonObject, source: PrimitiveSource) -> list[str]:
    """Return the attributes of α and β that the metadata names, or none if one of them is missing."""
    names = slot_names(note)
    sets = source.influence_sets
    expected = 4 * sets - 1 if note.get("layout") == Layout.TEXCOORD else 2 * sets
    complete = len(names) == expected and all(name in source.attributes for name in names)
    return names if complete else []


def _sizes(
    document: Document, source: PrimitiveSource, names: Sequence[str]
) -> tuple[dict[str, int], list[int]]:
    """Return the bytes of one element of each attribute, aligned, and of one component of each."""
    elements, components = {}, []
    for name in names:
        place = source.place.at(name)
        values = read_accessor(document, integer(source.attributes, name, place), place).values
        size = values.dtype.itemsize * values.shape[1]
        elements[name] = -(-size // ALIGNMENT) * ALIGNMENT
        components.append(values.dtype.itemsize)
    return elements, components


def _file_costs(influences: int, layout: _Layout) -> dict[Algorithm, Cost]:
    """Return the cost of all algorithms at a vertex with this layout.

    No file stores algorithm 2's ∇w. It is counted in the type of α and β.
    """
    plain, stored = (
        sum(layout.plain.values()),
        StoredTypes(gradient=layout.gradient, gradient_scale=layout.scale),
    )
    costs = {}
    for algorithm in Algorithm:
        added = vertex_bytes(algorithm, influences, stored).added
        if added and layout.baked and algorithm is not Algorithm.LBS_DIRECT:
            added = sum(layout.baked.values())
        costs[algorithm] = Cost(multiply_adds(algorithm, influences), VertexBytes(plain, added))
    return costs


def _reported(costs: dict[Algorithm, Cost], influences: int) -> VertexCosts:
    return {
        int(algorithm): VertexCost(
            cost.multiply_adds,
            cost.vertex_bytes.total,
            cost.vertex_bytes.added,
            cost.lines,
            normal_map_cost(algorithm),
            sum(multiply_adds(algorithm, influences, scaled_joints=True).values())
            if algorithm.uses_dual_quaternions
            else None,
            normal_map_cost(algorithm, scaled_joints=True) if algorithm.uses_dual_quaternions else None,
        )
        for algorithm, cost in costs.items()
    }


def _times(costs: VertexCosts, vertices: int) -> FrameCosts:
    return {
        number: FrameCost(cost.multiply_adds * vertices, cost.bytes * vertices, cost.added_bytes * vertices)
        for number, cost in costs.items()
    }


def _sum(frames: Sequence[FrameCosts]) -> FrameCosts:
    return {
        int(algorithm): FrameCost(
            multiply_adds=sum(frame[algorithm].multiply_adds for frame in frames),
            bytes=sum(frame[algorithm].bytes for frame in frames),
            added_bytes=sum(frame[algorithm].added_bytes for frame in frames),
        )
        for algorithm in Algorithm
    }
