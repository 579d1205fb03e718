"""The bake of α and β: from a document without a bake to one that has them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from skinbake.choices import Encoding, Scheme
from skinbake.commands.bake_options import BakeOptions
from skinbake.commands.surface_bake import PrimitiveBake, bake_surfaces
from skinbake.errors import Chosen, InputError, Message, Notice, Place
from skinbake.format.attribute_store import tell_level_ignored, tell_stored_otherwise
from skinbake.format.baked import with_baked
from skinbake.format.encodings import GradientFormat
from skinbake.geometry.skinned import bincount
from skinbake.gltf.asset import PrimitiveSource
from skinbake.gltf.budget import WELDING, Cost
from skinbake.gltf.document import Document
from skinbake.gradients.normals import lean_notices
from skinbake.report.bake import BakedCounts, CorrectiveCounts, EncodingCost, Left, MorphCounts
from skinbake.timing import stage
from skinbake.wording import counted

if TYPE_CHECKING:
    from skinbake.format.morph_targets import MadeTargets
    from skinbake.report.verify import FileVerdict

MUCH, UNSEEN = 0.1, 0.01
"""The share of the gain that an encoding may lose without a warning, and the degrees of it."""

SUSPECT = 0.02
"""What an encoding turns normals, as a share of what α and β turn them, from which its loss is measured."""


class BakedDocument(NamedTuple):
    """A document with α and β, or with correctives, or as it was given, and what is told of it.

    ``primitives`` are the numbers of each primitive with α and β, ``correctives`` those of each mesh with
    correctives, ``morphs`` those of what morph targets got. ``encoding`` is None without α and β. ``verdict``
    has the lighting with correctives. ``skipped`` is the number of skinned primitives that were left out.
    ``left`` says why a bake has left the document as it was, but for a note.
    """

    document: Document
    primitives: Sequence[tuple[Place, BakedCounts]] = ()
    encoding: EncodingCost | None = None
    morphs: Sequence[tuple[Place, MorphCounts]] = ()
    correctives: Sequence[tuple[Place, CorrectiveCounts]] = ()
    verdict: FileVerdict | None = None
    skipped: int = 0
    left: Left | None = None

    @property
    def is_baked(self) -> bool:
        """Tell whether anything was added."""
        return bool(self.primitives or self.correctives or self.morphs)

    @property
    def lighting(self) -> tuple[tuple[str, float, float], ...]:
        """The mean errors in degrees by truth, without and with correctives; empty without any."""
        by_truth = {} if self.verdict is None else self.verdict.by_truth
        every = [(truth, figures["lbs"]) for truth, figures in by_truth.items() if figures]
        return tuple((truth, one["standard"].mean, one["corrected"].mean) for truth, one in every)


def bake_gradients(
    document: Document, sources: Sequence[PrimitiveSource], options: BakeOptions
) -> BakedDocument:
    """Bake α and β into primitives of a document that holds no bake, and make what targets are to get.

    If nothing can be baked, the document is the given one. Raises InputError if arrays cannot be read, α or β
    cannot be stored, or ``verify`` would refuse the result.
    """
    what = f"baking {counted(len(sources), 'primitive')}"
    document.budget.claim(Cost.BAKED_PRIMITIVE * len(sources), what, document.place)
    given = document
    if options.compress is not Scheme.KEEP:
        from skinbake.gltf.writing.recode import Compression, recoded

        with stage("compress"):
            compression = Compression(options.compress, options.compress_level, options.bits)
            document = recoded(document, [*sources], compression)
    sources = [document.asset.counterpart(source) for source in sources]
    surfaces = bake_surfaces(document, sources, options)
    bakes = [bake for surface in surfaces for bake in surface]
    # What morph targets lack, which most models do not have.
    made: list[tuple[MadeTargets, MorphCounts]] = []
    if options.morph_normals or options.morph_frames or any(bake.source.has_targets for bake in bakes):
        from skinbake.commands.morph_bake import morph_bake

        made = morph_bake(document, bakes, options)
    if not bakes and not made:
        return BakedDocument(given)
    # The scale of an encoding is that of the whole file, so that its shader can hold it as a constant. A
    # separate scale for α and for β would gain at most 0.0015° of mean error, measured on sixty models.
    storage = GradientFormat(options.encoding, options.layout)
    if storage.encoding.is_scaled:
        from skinbake.format.encodings import Spread, bearing_scale
        from skinbake.truth.areas import vertex_areas

        spreads = [
            Spread(
                bake.result.alpha,
                bake.result.beta,
                vertex_areas(bake.primitive.positions, bake.primitive.triangles),
            )
            for bake in bakes
        ]
        storage = storage._replace(scale=bearing_scale(spreads, storage.encoding))
    with stage("store"):
        to_store = [bake.to_store for bake in bakes]
        names, level = options.attribute_names, options.compress_level
        written, lengths, made_lengths = with_baked(
            document, to_store, names, storage, level=level, made=[item for item, _ in made]
        )
        _refuse_unverifiable(document, written, surfaces, sum(lengths))
    notices = document.notices
    notices.tell(*(notice for bake in bakes for notice in bake.notices))
    notices.tell(*lean_notices((bake.primitive, bake.source.place) for bake in bakes))
    tell_stored_otherwise(document, sources, written)
    tell_level_ignored(document, sources, level)
    cost = EncodingCost(str(storage.encoding))
    if storage.encoding.is_scaled:
        with stage("encoding"):
            cost = _encoding_cost(
                document,
                bakes,
                storage,
                written,
                lambda other: with_baked(document, to_store, names, other)[0],
            )
    if options.compress is Scheme.DRACO:
        from skinbake.gltf.writing.recode import tell_draco_growth

        tell_draco_growth(given, written)
    return BakedDocument(
        written,
        [
            (bake.source.place, bake.counts(options.encoding, length))
            for bake, length in zip(bakes, lengths, strict=True)
        ],
        cost,
        [
            (item.source.place, count._replace(added_bytes=length))
            for (item, count), length in zip(made, made_lengths, strict=True)
        ],
    )


def _refuse_unverifiable(
    given: Document, baked: Document, surfaces: Sequence[Sequence[PrimitiveBake]], added: int
) -> None:
    """Raise InputError if verify would refuse a baked document, to which so many bytes of α and β were added.

    Nobody could tell whether such a bake is fresh.
    """
    fresh = given.budget.afresh()
    joints = max((given.asset.skins[one.skin].joint_count for one in given.asset.drawn), default=0)
    steps, copied = (Cost.VERIFIED_JOINT * joints).steps, 0
    for surface in surfaces:
        for bake in surface:
            steps += (Cost.VERIFIED_PRIMITIVE + Cost.VERIFIED_TARGET * len(bake.source.targets)).steps
        # Each copy of a vertex has the corners of all its copies, besides its own.
        classes = [bake.result.classes for bake in surface]
        every = np.concatenate(classes)
        count = int(every.max(initial=-1)) + 1
        if count < len(every):  # else no vertex has a copy
            used = [own[bake.primitive.triangles].ravel() for own, bake in zip(classes, surface, strict=True)]
            corners = bincount(np.concatenate(used), minlength=count)
            copied += int(corners[every].sum() - corners.sum())
    if steps <= fresh.steps_left and Cost.COPIED_CORNER.bytes * copied <= WELDING.ratio * fresh.backed:
        return
    from skinbake.measure.measured import claim_verification  # few files come near

    sizes = [len(one.text) for one in (given, baked)]
    fresh.backed += added + sizes[1] - sizes[0]
    claim_verification(baked.edited(budget=fresh))


def _encoding_cost(
    document: Document,
    bakes: Sequence[PrimitiveBake],
    storage: GradientFormat,
    written: Document,
    stored: Callable[[GradientFormat], Document],
) -> EncodingCost:
    """Return the cost of an encoding. A notice tells if it is much, or if the file cannot be posed.

    ``written`` has α and β in this encoding, ``stored`` gives the document with another one.
    """
    from skinbake.measure.costs import added_error, encoded_primitives  # it replays

    encoding = str(storage.encoding)
    chosen = Chosen("encoding", storage.encoding)
    try:
        added = added_error(encoded_primitives(document, [bake.to_store for bake in bakes], storage))
        if added is not None and added.mean > SUSPECT * added.effect:
            from skinbake.measure.measured import lighting_of  # few encodings lose so much

            with document.budget.passing():
                plain = stored(storage._replace(encoding=Encoding.FLOAT32))
                found = [lighting_of(one).by_truth for one in (written, plain)]
            # Lost and gained degrees, by the truth by which the encoding loses the larger share of the gain.
            losses = [(0.0, 0.0)]
            for truth, by_method in found[1].items():
                if "lbs" in by_method:
                    exact, standard = (by_method["lbs"][one].mean for one in ("accurate", "standard"))
                    losses.append((found[0][truth]["lbs"]["accurate"].mean - exact, standard - exact))
            cost, gain = max(losses, key=lambda loss: loss[0] / loss[1] if loss[1] > 0.0 else 0.0)
            if gain > 0.0 and cost > max(MUCH * gain, UNSEEN):
                message = Message(
                    chosen,
                    f" loses {cost:.2g}° of the {gain:.2g}° by which α and β make its lighting better in its "
                    "poses: take ",
                    Chosen("encoding", Encoding.FLOAT32),
                    ", or merge vertices that nearly coincide",
                )
                document.notices.tell(Notice("encoding-costs", message, document.place))
    except InputError as error:
        message = Message("the error that ", chosen, f" adds could not be measured: {error.message}")
        document.notices.tell(Notice("encoding-unmeasured", message, error.place or document.place))
        return EncodingCost(encoding)
    return EncodingCost(encoding, added.mean if added else None, added.p99 if added else None)
