"""``skinbake bake``: read a document, bake every skinned primitive, write it."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from skinbake.choices import Encoding, FrameChoice, Gradients, Neighbours, Scheme, Weld
from skinbake.commands.bake_options import CheckedOptions
from skinbake.commands.surface_bake import FitTarget, PrimitiveBake, SurfaceBake, unwritten
from skinbake.errors import (
    Chosen,
    InputError,
    Message,
    Notice,
    Place,
    Skipped,
    noticed,
    skipped,
    warnings_in,
)
from skinbake.files.ahead import Ahead
from skinbake.files.bounds import OWN_FOLDERS, Within
from skinbake.files.urls import STDIO
from skinbake.files.versions import version_of
from skinbake.format.attribute_store import tell_level_ignored, tell_stored_otherwise
from skinbake.format.baked import with_baked
from skinbake.format.layouts import GradientFormat
from skinbake.format.metadata import refuse_other_kind, with_left
from skinbake.format.strip import stripped
from skinbake.gltf.beside import files_read
from skinbake.gltf.budget import WELDING, Budget
from skinbake.gltf.container import for_target
from skinbake.gltf.document import Document, read_document
from skinbake.gltf.json_access import JsonObject
from skinbake.gltf.morphs import targets_without_normal
from skinbake.gltf.output import (
    AS_USUAL,
    Writing,
    plan_output,
    refuse_own_input,
    tell_other_names,
    write_ahead,
)
from skinbake.gltf.primitives import (
    PrimitiveSource,
    reason_to_skip,
    skinned_sources,
    tell_half_skinned,
    why_nothing,
)
from skinbake.gradients.baker import BakeSettings
from skinbake.gradients.normals import lean_notices
from skinbake.report.bake import (
    BakedCounts,
    CorrectiveCounts,
    EncodingCost,
    FileResult,
    Left,
    MorphCounts,
)
from skinbake.threads import Threads, thread_count
from skinbake.timing import stage
from skinbake.wording import counted

LARGE = 1 << 17
"""The vertices of a surface from which on the digests of its arrays are made beside the bake."""

STEPS_A_BAKE = 700
"""The steps of baking a primitive of few vertices: see ``budget.STEPS_FREE``."""

JSON_A_PRIMITIVE = 1450
"""About as many bytes of JSON are added for a primitive."""

STEPS_TO_VERIFY, STEPS_A_TARGET, STEPS_A_JOINT, BYTES_A_COPY = 22_000, 60, 30, 192
"""About the steps of verifying a primitive, a target and a joint; the bytes of each corner at copies."""

MUCH, UNSEEN = 0.1, 0.01
"""The share of the gain that an encoding may lose without a warning, and the degrees of it."""

SUSPECT = 0.02
"""What an encoding turns normals, as a share of what α and β turn them, from which its loss is measured."""

if TYPE_CHECKING:
    from skinbake.commands.morph_bake import MorphBake
    from skinbake.format.baked import AttributeNames, Baked
    from skinbake.report.verify import FileVerdict


@dataclass(frozen=True, slots=True, kw_only=True)
class Baker(CheckedOptions):
    """Bake files and documents with these options."""

    def bake_file(
        self, source: str, target: str | None, writing: Writing = AS_USUAL, within: Within = OWN_FOLDERS
    ) -> FileResult:
        """Bake one file and write it to ``target``. With None, or on a dry run, nothing is written.

        Raises SkinbakeError, and then nothing has been written. Its notices are those found before the
        error.
        """
        replaced = version_of(source) if target == source != STDIO else None
        with stage("read"):
            document = read_document(source, within.bounds)
        if target is not None:
            refuse_own_input(document, source, target)
        with Ahead(is_itself=replaced is not None) as ahead:
            begin = None
            if target is not None and writing.sync and not writing.dry_run:
                begin = partial(write_ahead, ahead, target=target, root=within.output)
            made, result, notices = self._rebaked(document, target, pack=writing.pack, begin=begin)
            untouched = result is document and target == source and source != STDIO
            read: tuple[str, ...] = ()
            if writing.lists_read:
                from skinbake.report.depfile import prerequisites  # only --depfile needs it

                with noticed(notices):
                    read = prerequisites(source, files_read(document, target, pack=writing.pack))
            planned = None
            if target is not None and not untouched:
                with noticed(notices), document.notices.withheld() as told, stage("write"):
                    planned = plan_output(
                        result,
                        target,
                        root=within.output,
                        keeps_notes=writing.keeps_notes,
                        grows=made.is_baked,
                    )
                    if target == source:
                        tell_other_names(document, source)
                notices = [*notices, *told]
            with noticed(notices):
                if self.warnings_as_errors and warnings_in(notices):
                    raise InputError("not written: there are warnings (--warnings-as-errors)", document.place)
                if planned is not None and not writing.dry_run:
                    with stage("write"):
                        planned = replace(planned, replaces=replaced).write(sync=writing.sync, ahead=ahead)
        written: dict[str, str] = {}
        if writing.traced and planned:
            from skinbake.files.versions import digests_of

            written = digests_of(planned.files)
        return FileResult(
            source,
            target,
            "baked" if made.is_baked else "left" if made.left else "unchanged",
            made.primitives,
            made.skipped,
            tuple(notices),
            encoding=made.encoding,
            correctives=made.correctives,
            lighting=made.lighting,
            morphs=made.morphs,
            written=written,
            read=read,
            left=made.left,
        )

    def _rebaked(
        self, document: Document, target: str | None, *, pack: bool, begin: Callable[..., None] | None
    ) -> tuple[BakedDocument, Document, list[Notice]]:
        """Bake a document that may hold an earlier bake, for the container of the target.

        ``begin`` gets the document before the bake, and about how much its JSON will grow. Returns the bake,
        the document to write, and notices. If no primitive can be baked, the document is written as it came,
        with any earlier bake.
        """
        refuse_other_kind(document, correctives=self.correctives is not None)
        with document.notices.withheld() as undone, stage("strip"):
            original, _ = stripped(document)
            prepared = original if target is None else for_target(original, target, pack=pack)
        if begin is not None and document.asset.skins and self.compress is Scheme.KEEP:
            count = len(document.asset.primitives) if original is document else 0
            begin(prepared, growth=JSON_A_PRIMITIVE * count)
        made = self.bake_document(prepared)
        if made.is_baked or made.left:
            return made, made.document, [*undone, *made.notices]
        reason = "none of its skinned primitives can be baked" if made.skipped else why_nothing(document)
        if self.correctives is not None and made.notices:
            last = made.notices[-1]
            reason = last.reason if isinstance(last, Skipped) else last.message
        if self.require_baked:
            raise InputError(f"{reason} (--require-baked)", document.place)
        with document.notices.withheld() as moved:
            result = document if target is None else for_target(document, target, pack=pack)
        idle = self.correctives is not None and made.notices and not warnings_in(made.notices)
        code = "nothing-to-correct" if idle else "nothing-baked"
        last = Notice(code, f"passed through unchanged: {reason}", document.place)
        return made, result, [*moved, *made.notices, last]

    def bake_document(self, document: Document) -> BakedDocument:
        """Bake every skinned primitive of a document that holds no earlier bake (``stripped``).

        Raises InputError.
        """
        sources, skipped, reasons = self._bakeable(document)
        if not sources and not self.morph_normals:
            return BakedDocument(document, (), skipped, tuple(reasons))
        what = f"baking {counted(len(sources), 'primitive')}"
        document.budget.claim_steps(STEPS_A_BAKE * len(sources), what, document.place)
        if self.correctives is not None:
            return self._corrected(document, sources, skipped, reasons)
        given = document
        with stage("compress"):
            kept: Collection[Notice] = ()
            if self.compress is not Scheme.KEEP:
                from skinbake.gltf.recode import Compression, recoded

                compression = Compression(self.compress, self.compress_level, self._bits)
                with document.notices.withheld() as kept:
                    document = recoded(document, sources, compression)
        sources = [document.asset.counterpart(source) for source in sources]
        surfaces, remarks = self._bakes(document, sources)
        bakes = [bake for surface in surfaces for bake in surface]
        morphs = self._morphs(document, bakes)
        made_targets = morphs.made if morphs else ()
        remarks += morphs.notices if morphs else ()
        if not bakes and not made_targets:
            return BakedDocument(given, (), skipped, (*reasons, *remarks))
        storage = _storage(GradientFormat(self.encoding, self.layout), bakes)
        with stage("store"):
            to_store = [bake.to_store(self._noted_settings) for bake in bakes]
            names, level = self.attribute_names, self.compress_level
            written, lengths, made_lengths = with_baked(
                document, to_store, names, storage, level=level, made=made_targets
            )
            _refuse_unverifiable(document, written, surfaces, sum(lengths))
        with stage("encoding"):
            cost, unmeasured = _encoding_cost(document, bakes, storage, written, (to_store, names))
        notices = [*kept, *reasons, *remarks, *(notice for bake in bakes for notice in bake.notices)]
        notices += lean_notices((bake.primitive, bake.source.place) for bake in bakes)
        with document.notices.withheld() as told:
            tell_stored_otherwise(document, sources, written)
            tell_level_ignored(document, sources, level)
            document.notices.tell(*unmeasured)
            if self.compress is Scheme.DRACO:
                from skinbake.format.growth import tell_draco_growth

                tell_draco_growth(given, written)
        notices += told
        primitives = tuple(
            (bake.source.place, bake.counts(self.encoding, length))
            for bake, length in zip(bakes, lengths, strict=True)
        )
        if bakes:
            left, unmeasured = self._left(given, partial(self._lighting, written))
            notices += unmeasured
            if left is not None:
                return left._replace(
                    skipped=skipped, notices=(*reasons, *(one for one in notices if one.is_advice))
                )
        morphed = morphs.reported(made_lengths) if morphs else ()
        return BakedDocument(written, primitives, skipped, tuple(notices), cost, morphs=morphed)

    def _corrected(
        self,
        document: Document,
        sources: Sequence[PrimitiveSource],
        skipped: int,
        reasons: Sequence[Notice],
    ) -> BakedDocument:
        """Return the document with correctives. skipped and reasons are those of other primitives.

        They are made for the normals that morph targets have then.
        """
        from skinbake.commands.corrective_bake import corrected_document  # most bakes add α and β

        morphs, given, lengths = None, document, list[int]()
        if self.morph_normals or any(targets_without_normal(document, source) for source in sources):
            surfaces, _ = Baker(gradients=Gradients.SURFACE)._bakes(document, sources)
            morphs = self._morphs(document, [bake for surface in surfaces for bake in surface])
        if morphs is not None and morphs.made:
            with stage("store"):
                storage = GradientFormat(self.encoding, self.layout)
                document, _, lengths = with_baked(
                    document, [], self.attribute_names, storage, made=morphs.made
                )
            sources = [document.asset.counterpart(source) for source in sources]
        found = corrected_document(document, sources, self)
        left, unmeasured = self._left(given, found.lighting, idle=() if found.counts else found.notices)
        if left is not None:
            return left._replace(skipped=skipped, notices=tuple(reasons))
        told = morphs.notices if morphs else ()
        return BakedDocument(
            found.document,
            (),
            skipped,
            (*reasons, *told, *found.notices, *unmeasured),
            correctives=tuple(found.counts),
            lighting=found.means,
            morphs=morphs.reported(lengths) if morphs else (),
        )

    def _morphs(self, document: Document, bakes: Sequence[PrimitiveBake]) -> MorphBake | None:
        """Return what is made for morph targets, or told of them; None for a model that has none."""
        is_asked = self.morph_normals or self.morph_frames
        if not is_asked and not any(bake.source.has_targets for bake in bakes):
            return None
        from skinbake.commands.morph_bake import Wanted, morph_bake  # most models have no targets

        wanted = Wanted(self.morph_normals, self.morph_frames)
        found = morph_bake(document, bakes, self.settings, wanted)
        if found.made or not any(wanted):
            return found
        option = Chosen("morph_frames" if self.morph_frames else "morph_normals")
        lacking = "morph targets" if self.morph_frames else "a morph target without NORMAL"
        message = Message(option, f" adds nothing: nothing here has {lacking} that it can add to")
        return replace(found, notices=[*found.notices, Notice("no-targets", message, document.place)])

    def _lighting(self, baked: Document) -> FileVerdict:
        """Return the lighting of a document with α and β, by linear blend skinning."""
        from skinbake.measure.lighting import lighting_of
        from skinbake.measure.options import VerifyOptions

        return lighting_of(baked, VerifyOptions(methods=("lbs",)))

    def _left(
        self, given: Document, measured: Callable[[], FileVerdict], *, idle: Sequence[Notice] = ()
    ) -> tuple[BakedDocument | None, list[Notice]]:
        """Return the given document with a note, if it is better left unbaked, else None; and notices.

        The gain is measured as verify does. The lower one of both truths counts. ``idle`` are the reasons why
        nothing was baked.
        """
        if self.leave_under is None:
            return None, []
        from skinbake.report.verify import NEGLIGIBLE, by_worse_truth, gain

        try:
            with stage("gain"):
                verdict = measured()
                figures = by_worse_truth(verdict)
            broken = [notice for notice in verdict.notices if notice.code == "animations-broken"]
            if broken:
                raise InputError(broken[0].message, broken[0].place)
        except InputError as error:
            message = f"it is baked, because its gain could not be measured: {error.message}"
            return None, [Notice("gain-unmeasured", message, error.place or given.place)]
        if not figures:
            return None, []
        factor, standard = gain(figures), figures["standard"].mean
        if standard >= NEGLIGIBLE and (factor is None or factor >= self.leave_under):
            return None, []
        still = "no clip moves its joints"
        reason = f"in random poses, because {still}" if "random" in verdict.poses else ""
        if any(notice.code == "no-clips" for notice in idle):
            factor, reason = None, f"{still}, and only clips play correctives"
        left = Left(factor, standard, self.leave_under, reason)
        noted = with_left(given, left.note)
        return None if noted is None else BakedDocument(noted, (), 0, (), left=left), []

    def _bakes(
        self, document: Document, sources: Sequence[PrimitiveSource]
    ) -> tuple[list[list[PrimitiveBake]], list[Notice]]:
        """Bake primitives, surface by surface, and return notices on surfaces that stay apart or unfitted.

        All poses to fit to are read before the first surface is baked.
        """
        surfaces, apart = _surfaces(document, sources, self.weld)
        targets = [FitTarget.of(document, surface, self.gradients, self.fit_poses) for surface in surfaces]
        read = [
            SurfaceBake.of(document, surface, self.settings, target)
            for surface, target in zip(surfaces, targets, strict=True)
        ]
        made = [self._baked(surface) for surface in read]
        notices = [*apart, *(notice for target in targets for notice in target.notices)]
        if self.gradients is Gradients.RIG:
            made, found = _guarded(document, read, made, self.settings)
            notices += found
        if self.blend is not None and made:
            made = [one.with_blend(own, self.blend) for one, own in zip(read, made, strict=True)]
            without = [bake for bakes in made for bake in bakes if bake.blend is None]
            if len(without) == len(sources):
                raise InputError(
                    f"--blend {self.blend}: nothing that is baked has this attribute", document.place
                )
            message = f"it has no attribute {self.blend}, and is left to linear blend skinning"
            notices += [Notice("no-blend", message, bake.source.place) for bake in without]
        return made, notices

    def _bakeable(self, document: Document) -> tuple[list[PrimitiveSource], int, list[Notice]]:
        """Return the primitives to bake, the number of skinned ones left out, and notices on the latter."""
        sources = skinned_sources(document)
        with document.notices.withheld() as half_skinned:
            tell_half_skinned(document)
        notices = list(half_skinned)
        wanted: list[PrimitiveSource] = []
        for source in sources:
            reason = reason_to_skip(document, source, generate_normals=self.generate_normals)
            if reason is None and self.frame is FrameChoice.TANGENT:
                lacking = next(
                    (name for name in ("NORMAL", "TANGENT") if name not in source.attributes), None
                )
                if lacking is not None:
                    auto = Chosen("frame", FrameChoice.AUTO)
                    words = f"it has no {lacking}; ", auto, " takes the frame from NORMAL"
                    reason = skipped("no-tangents", source.place, *words)
            if reason is None:
                wanted.append(source)
            else:
                notices.append(reason)
        return wanted, len(sources) - len(wanted), notices

    def _baked(self, surface: SurfaceBake) -> list[PrimitiveBake]:
        """Bake one surface. Raises InputError if α or β are not finite."""
        # Welding and grouping leave a core idle.
        is_large = sum(len(one.positions) for one in surface.primitives) >= LARGE
        with Threads(thread_count() if is_large else 1) as threads:
            surface = surface._replace(digests=[threads.begun(digests) for digests in surface.digests])
            if self.limit_influences is not None:
                return surface.limited(self.limit_influences)
            if self.neighbours is Neighbours.EXTEND:
                return surface.extended()
            return surface.plain()

    @property
    def settings(self) -> BakeSettings:
        """Return the options of the gradients."""
        return BakeSettings(self.weighting, math.radians(self.crease_angle), self.neighbours, self.frame)

    @property
    def _bits(self) -> dict[str, int]:
        """Return the numbers of bits to which Draco quantises, by attribute."""
        bits = {"POSITION": self.position_bits, "NORMAL": self.normal_bits, "TEXCOORD_0": self.texcoord_bits}
        return {name: count for name, count in bits.items() if count is not None}

    @property
    def _noted_settings(self) -> JsonObject:
        return {
            "weighting": str(self.weighting),
            "creaseAngle": round(float(self.crease_angle), 6),
            "neighbours": str(self.neighbours),
            **({"weld": str(self.weld)} if self.weld is Weld.SKIN else {}),
        }


class BakedDocument(NamedTuple):
    """A document with α and β, the bake of each primitive, and the assumptions made.

    Or one with correctives, the numbers of each mesh, and mean errors by truth without and with them.

    skipped is the number of skinned primitives that were left out. If no primitive can be baked, the document
    is the given one, primitives is empty and encoding is None. left says why a bake has left the document as
    it was, but for a note.
    """

    document: Document
    primitives: tuple[tuple[Place, BakedCounts], ...]
    skipped: int
    notices: tuple[Notice, ...]
    encoding: EncodingCost | None = None
    left: Left | None = None
    correctives: tuple[tuple[Place, CorrectiveCounts], ...] = ()
    lighting: tuple[tuple[str, float, float], ...] = ()
    morphs: tuple[tuple[Place, MorphCounts], ...] = ()

    @property
    def is_baked(self) -> bool:
        """Tell whether anything was added."""
        return bool(self.primitives or self.correctives or self.morphs)


def _surfaces(
    document: Document, sources: Sequence[PrimitiveSource], weld: Weld
) -> tuple[list[list[PrimitiveSource]], list[Notice]]:
    """Return the groups of primitives that are baked as one surface, and notices on the separate ones."""
    by_mesh: dict[int, list[PrimitiveSource]] = defaultdict(list)
    for source in sources:
        by_mesh[source.mesh].append(source)
    if weld is not Weld.SKIN:
        return list(by_mesh.values()), []
    from skinbake.gltf.scenes import meshes_of_one_skin, tell_meshes_apart

    groups = meshes_of_one_skin(document, by_mesh)
    with document.notices.withheld() as apart:
        tell_meshes_apart(document, by_mesh)
    return [[source for mesh in group for source in by_mesh[mesh]] for group in groups], list(apart)


def _guarded(
    document: Document,
    surfaces: Sequence[SurfaceBake],
    made: Sequence[Sequence[PrimitiveBake]],
    settings: BakeSettings,
) -> tuple[list[list[PrimitiveBake]], list[Notice]]:
    """Return the bakes of surfaces, of which those that would be lit worse keep a share, and notices."""
    with stage("guard"):
        from skinbake.measure.guard import Judged, judged_shares  # it poses: most kinds of bakes do not

        judged = [Judged(unwritten(own), one.target.rig) for one, own in zip(surfaces, made, strict=True)]
        shares, notices = judged_shares(document, judged, settings)
        groups = zip(surfaces, made, shares, strict=True)
        kept = [surface.keeping(bakes, own) for surface, bakes, own in groups]
    return kept, notices


def _refuse_unverifiable(
    given: Document, baked: Document, surfaces: Sequence[Sequence[PrimitiveBake]], added: int
) -> None:
    """Raise InputError if verify would refuse a baked document, to which so many bytes of α and β were added.

    Nobody could tell whether such a bake is fresh.
    """
    fresh = Budget(limit=given.budget.limit, backed=given.budget.backed, parts=given.budget.parts)
    joints = max((given.asset.skins[one.skin].joint_count for one in given.asset.drawn), default=0)
    steps = STEPS_A_JOINT * joints
    most = 0
    for surface in surfaces:
        for bake in surface:
            steps += STEPS_TO_VERIFY + STEPS_A_TARGET * len(bake.source.targets)
        # Each copy of a vertex has the corners of all its copies: at most as often as the class with most.
        every = np.concatenate([bake.result.classes for bake in surface])
        if int(every.max(initial=-1)) + 1 < len(every):  # else no vertex has a copy
            corners = sum(bake.primitive.triangles.size for bake in surface)
            most += (int(np.bincount(every).max()) - 1) * corners
    bound = WELDING.ratio * fresh.backed
    if steps <= fresh.steps_left and (
        BYTES_A_COPY * most <= bound or BYTES_A_COPY * sum(map(_copied_corners, surfaces)) <= bound
    ):
        return
    from skinbake.measure.lighting import claim_verification  # few files come near

    sizes = [len(one.text) for one in (given, baked)]
    fresh.backed += added + sizes[1] - sizes[0]
    claim_verification(baked.edited(budget=fresh))


def _storage(storage: GradientFormat, bakes: Sequence[PrimitiveBake]) -> GradientFormat:
    """Return the storage with the scale of the whole file, so that its shader can hold it as a constant.

    A separate scale for α and for β would gain at most 0.0015° of mean error, measured on sixty models.
    """
    if not storage.encoding.is_scaled:
        return storage
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
    return storage._replace(scale=bearing_scale(spreads, storage.encoding))


def _encoding_cost(
    document: Document,
    bakes: Sequence[PrimitiveBake],
    storage: GradientFormat,
    written: Document,
    to_write: tuple[Sequence[Baked], AttributeNames],
) -> tuple[EncodingCost, list[Notice]]:
    """Return the cost of the encoding, and a notice if it is much, or if the file cannot be posed."""
    encoding = storage.encoding
    if not encoding.is_scaled:
        return EncodingCost(str(encoding)), []
    from skinbake.measure.costs import added_by_encoding  # it replays, as limits do

    chosen, notices = Chosen("encoding", encoding), []
    try:
        added = added_by_encoding(document, unwritten(bakes), storage)
        if added is not None and added.mean > SUSPECT * added.effect:
            with document.budget.passing():
                plain = storage._replace(encoding=Encoding.FLOAT32)
                cost, gain = _lost_gain(written, with_baked(document, *to_write, plain)[0])
            if gain > 0.0 and cost > max(MUCH * gain, UNSEEN):
                message = Message(
                    chosen,
                    f" loses {cost:.2g}° of the {gain:.2g}° by which α and β make its lighting better in its "
                    "poses: take ",
                    Chosen("encoding", Encoding.FLOAT32),
                    ", or merge vertices that nearly coincide",
                )
                notices.append(Notice("encoding-costs", message, document.place))
    except InputError as error:
        message = Message("the error that ", chosen, f" adds could not be measured: {error.message}")
        notice = Notice("encoding-unmeasured", message, error.place or document.place)
        return EncodingCost(str(encoding)), [notice]
    return EncodingCost(str(encoding), added.mean if added else None, added.p99 if added else None), notices


def _lost_gain(written: Document, plain: Document) -> tuple[float, float]:
    """Return the mean error that an encoding adds, and the one that α and β take away as float32, in degrees.

    Both are by the truth by which the encoding loses the larger share.
    """
    from skinbake.measure.lighting import lighting_of
    from skinbake.measure.options import VerifyOptions

    options = VerifyOptions(methods=("lbs",))
    found = [lighting_of(one, options).by_truth for one in (written, plain)]
    losses = [(0.0, 0.0)]
    for truth, by_method in found[1].items():
        if "lbs" in by_method:
            exact, standard = (by_method["lbs"][one].mean for one in ("accurate", "standard"))
            losses.append((found[0][truth]["lbs"]["accurate"].mean - exact, standard - exact))
    return max(losses, key=lambda loss: loss[0] / loss[1] if loss[1] > 0.0 else 0.0)


def _copied_corners(surface: Sequence[PrimitiveBake]) -> int:
    """Count the corners that copies of vertices have besides their own."""
    classes = [bake.result.classes for bake in surface]
    every = np.concatenate(classes)
    used = [own[bake.primitive.triangles].ravel() for own, bake in zip(classes, surface, strict=True)]
    corners = np.bincount(np.concatenate(used), minlength=int(every.max(initial=-1)) + 1)
    return int(corners[every].sum() - corners.sum())
