"""``skinbake shader``: the text for a baked file, or for the requested choices without a file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePath

import numpy as np

from skinbake.choices import Encoding, Frame, Layout, Method, Morphs, Stage
from skinbake.errors import ChoiceError, InputError, Notice, Place
from skinbake.files.bounds import BESIDE, Bounds
from skinbake.format.note import IN_PLANE, UPWARD, corrective_notes
from skinbake.freshness.baked_views import BakedView, baked_views, is_baked, rest_primitive
from skinbake.freshness.staleness import claim_freshness, refuse_stale
from skinbake.geometry.dual_quaternions import RIGID_TOLERANCE
from skinbake.geometry.poses import determinants
from skinbake.gltf.document import Document, read_document
from skinbake.gltf.reading.clips import read_clips
from skinbake.gltf.reading.meshes import parts_not_plain, reason_to_skip, skinned_sources, why_nothing
from skinbake.gltf.writing.output import refuse_own_input
from skinbake.gradients.influences import weight_sum_notices
from skinbake.measure.measured import scaled_joints
from skinbake.measure.morphing import NUMBERS, carrier, noted_of
from skinbake.options import on_command_line
from skinbake.shaders.choices import AT_RUN_TIME, BEST, AttributeText, ShaderChoices, ShaderRequest
from skinbake.shaders.text import shader_made
from skinbake.truth.poses import PoseRequest, PoseSet, pose_set
from skinbake.wording import counted

STORAGE = ("encoding", "layout")
"""The members of a note that say how α and β are stored, and the options that choose it."""
ALIKE = {"frame": "frame", "influences": "limit-influences", "encoding": "encoding", "layout": "layout"}
"""What the primitives of one text have in common, by metadata, and the options of bake that make it so."""


@dataclass(frozen=True, slots=True)
class ShaderResult:
    """The text, the choices that made it, and the assumptions made."""

    text: str
    choices: ShaderChoices
    notices: tuple[Notice, ...] = ()


def shader(
    request: ShaderRequest, source: str | None = None, target: str | None = None, bounds: Bounds = BESIDE
) -> ShaderResult:
    """Return the shader for a baked file, or for the usual attributes if there is no file.

    Raises ChoiceError if choices exclude each other. Raises InputError if the file cannot be read, is not
    baked, or does not fit the request. Raises OutputError if ``target`` is a file of the source document.
    """
    if source is None:
        text, choices = shader_made(request.decided())
        if request.frame is not None or request.target in AT_RUN_TIME:
            return ShaderResult(text, choices)
        message = (
            f"the shader is made for --frame {Frame.NORMAL}, but bake uses the tangent frame if a "
            "mesh has TANGENT. Name the baked file with --for, or give --frame"
        )
        return ShaderResult(text, choices, (Notice("frame-assumed", message, Place("shader")),))
    document = read_document(source, bounds)
    if target is not None:
        refuse_own_input(document, source, target)
    try:
        text, choices = shader_made(_choices_of_file(document, request))
    except ChoiceError as error:
        check_request(request)  # a request may contradict itself, whatever the file is
        message = f"this file does not fit {error.worded(on_command_line)}"
        raise InputError(message, Place(source)) from error
    return ShaderResult(text, choices, tuple(document.notices))


def check_request(request: ShaderRequest) -> None:
    """Raise ChoiceError if a request is refused for the usual kind of file."""
    shader_made(request.decided(scale=1.0))


def _choices_of_file(document: Document, request: ShaderRequest) -> ShaderChoices:
    """Return the choices from a file's metadata; tell of each primitive that they do not serve."""
    views = _views(document)
    serving = [view for view in views if _serves(view, request)]
    if not serving:
        raise InputError(_why_none(views, request), document.place)
    if request.target in AT_RUN_TIME:
        return _choices_at_run_time(document, serving, request)
    if request.influences is not None:
        serving = _in_one_place(_with_enough(serving, request.influences))
    _refuse_several_kinds(document, serving, request)
    choices = request.decided(
        frame=Frame(serving[0].note.frame),
        influences=serving[0].note.influences,
        encoding=Encoding(serving[0].note.encoding),
        layout=Layout(serving[0].note.layout),
    )
    choices = _with_names(document, serving, choices)
    if request.morphs is None:
        # Only the plain text leaves it to its user where the numbers of a differential come from.
        numbers = choices.target == "plain"
        choices = replace(choices, morphs=carrier(document, serving, numbers=numbers))
        _tell_unread_numbers(document, serving, choices)
    choices = _with_joints(document, serving, choices)
    for view in serving:
        document.notices.tell(*weight_sum_notices(view.now, view.source.place))
    for view in serving if request.stage is Stage.COMPUTE else ():
        _tell_not_plain(document, view, choices)
    for view in _others(views, serving):
        _tell_not_for(document, view, request)
    return choices


def _others(views: Sequence[BakedView], serving: Sequence[BakedView]) -> list[BakedView]:
    served = {view.source.place for view in serving}
    return [view for view in views if view.source.place not in served]


def _choices_at_run_time(
    document: Document, views: Sequence[BakedView], request: ShaderRequest
) -> ShaderChoices:
    """Return the choices for a module that reads everything else from the file when it runs.

    A primitive that needs more influences than were asked for gets a notice.
    """
    influences = request.influences or max(view.note.influences for view in views)
    serving = _with_enough(views, influences)
    choices = request.decided(frame=Frame(views[0].note.frame), influences=influences)
    for view in _others(views, serving):
        message = (
            f"this module does not fit it: its vertices use more than {influences} of its "
            f"{view.note.influences} influences. Bake it with --limit-influences {influences}"
        )
        document.notices.tell(Notice("shader-not-for", message, view.source.place))
    _tell_unread_numbers(document, serving, choices)
    return _with_joints(document, serving, choices)


def _tell_unread_numbers(document: Document, views: Sequence[BakedView], choices: ShaderChoices) -> None:
    """Tell of each primitive whose numbers of ``--morph-frames`` the text does not read, and would miss.

    Engines but three.js and Babylon.js follow NORMAL of the targets. It is there where the numbers are
    four. The plain text reads one kind of them.
    """
    if choices.target in {"three", "babylon"}:
        return
    for view, noted in zip(views, noted_of(document, [view.source for view in views]), strict=True):
        wanted = NUMBERS.get(noted.frames)
        if choices.target == "plain" and wanted not in (None, choices.morphs):
            message = (
                f"this text does not read the {noted.frames} numbers of its morph targets, because other "
                f"primitives have others: write another text for it with --morphs {wanted}"
            )
        elif choices.target != "plain" and wanted is Morphs.FRAMES:
            message = (
                f"{choices.target} reads NORMAL of its morph targets, which some do not have, and not the "
                "numbers of --morph-frames: bake with --morph-normals too"
            )
        else:
            continue
        document.notices.tell(Notice("morph-frames-unread", message, view.source.place))


def _with_names(document: Document, views: Sequence[BakedView], choices: ShaderChoices) -> ShaderChoices:
    """Return the choices with the file's names and scale; tell of each primitive with other names.

    Texture coordinates follow the existing ones of a primitive, so each primitive may have its own numbers.
    Other names are the same for all of a bake. Raises InputError if they are not, or if scales differ.
    """
    sets = choices.influence_sets
    names = {(view.note.alpha[:sets], view.note.beta[:sets]) for view in views}
    if len(names) > 1 and choices.layout != Layout.TEXCOORD:
        found = " and ".join(sorted(", ".join(alpha) for alpha, _ in names))
        raise InputError(
            f"its primitives have different names for alpha ({found}): bake it again", document.place
        )
    scales = {view.note.scale for view in views}
    if len(scales) > 1:
        found = " and ".join(sorted(f"{scale:.9g}" for scale in scales))
        raise InputError(f"its primitives have different scales ({found}): bake it again", document.place)
    first = views[0].note
    blend = first.blend.weights if first.blend and choices.method is Method.BLEND else None
    text = AttributeText(PurePath(document.name).name, first.alpha, first.beta, blend)
    for view in views:
        if choices.layout == Layout.TEXCOORD and view.note.alpha != first.alpha:
            own = view.note.slot_names
            message = f"its α and β are in {own[0]} to {own[-1]}: pass these attributes to the same functions"
            document.notices.tell(Notice("texcoords-differ", message, view.source.place))
    return replace(choices, attributes=text, scale=scales.pop() if choices.decodes else None)


def _tell_not_plain(document: Document, view: BakedView, choices: ShaderChoices) -> None:
    """Tell if a compute pass cannot read the bytes of a primitive as they are in the file."""
    whole = {f"{name}_{n}" for name in ("JOINTS", "WEIGHTS") for n in range(choices.influence_sets)}
    whole |= set(view.note.slot_names) if choices.decodes else set()
    floats = {
        "POSITION",
        "NORMAL",
        IN_PLANE,
        UPWARD,
        *(["TANGENT"] if choices.frame == Frame.TANGENT else []),
    }
    floats |= set() if choices.decodes else set(view.note.slot_names)
    packed = parts_not_plain(document, view.source, whole, floats, moved=choices.morphs is not Morphs.NONE)
    if packed:
        message = (
            f"a compute pass reads plain bytes, and this primitive has others ({', '.join(sorted(packed))}): "
            "give it the arrays that your loader has expanded, with their offsets"
        )
        document.notices.tell(Notice("pass-reads-plain", message, view.source.place))


def _views(document: Document) -> list[BakedView]:
    """Return the baked primitives. Raises InputError if there are none, or one is damaged or stale."""
    sources = skinned_sources(document)
    baked = []
    for source in sources:
        if not is_baked(document, source):
            continue
        reason = reason_to_skip(document, source, generate_normals=False)
        if reason is None:
            baked.append(source)
        elif reason.code != "unlit":
            raise InputError(f"it has lost what α/β are for ({reason.message}): bake it anew", reason.place)
    if not baked:
        # Say what to run, or why nothing can be baked.
        reasons = [reason_to_skip(document, source, generate_normals=False) for source in sources]
        found = [reason for reason in reasons if reason is not None]
        if corrective_notes(document):
            message = "its correctives need no shader: any viewer that plays morph targets shows them"
        elif len(found) < len(sources):
            message = "nothing in it is baked: run skinbake bake first"
        elif any(reason.code == "no-normals" for reason in found):
            message = "nothing in it is baked: run skinbake bake --generate-normals first"
        else:
            told = "; ".join(dict.fromkeys(reason.reason for reason in found))
            message = f"nothing in it can be baked: {told or why_nothing(document)}"
        raise InputError(message, document.place)
    claim_freshness(document, len(baked))
    with document.notices.withheld() as problems:
        views = baked_views(document, baked)
    for problem in problems:
        if problem.code != "tangents-skewed":
            raise InputError(problem.message, problem.place)
    refuse_stale(document, views)
    return views


def _serves(view: BakedView, request: ShaderRequest) -> bool:
    fits = request.frame in (None, view.note.frame) and all(
        getattr(request, member) in (None, getattr(view.note, member)) for member in STORAGE
    )
    fits &= request.method is not Method.BLEND or view.blend is not None
    return fits and (request.influences or 0) <= view.note.influences


def _why_none(views: Sequence[BakedView], request: ShaderRequest) -> str:
    if request.method is Method.BLEND and all(view.blend is None for view in views):
        return "this file does not fit --method blend: it is baked without --blend"
    frames = " and ".join(sorted({str(view.note.frame) for view in views}))
    slots = max(view.note.influences for view in views)
    asked = [f"--frame {request.frame}"] if request.frame else []
    asked += [f"--influences {request.influences}"] if request.influences else []
    asked += [f"--{member} {getattr(request, member)}" for member in STORAGE if getattr(request, member)]
    stored = "".join(
        f", {member} {' and '.join(sorted({str(getattr(view.note, member)) for view in views}))}"
        for member in STORAGE
        if getattr(request, member)
    )
    return (
        f"this file does not fit {' '.join(asked)}: it is baked in the {frames} frame, with {slots} "
        f"influences per vertex{stored}"
    )


def _refuse_several_kinds(document: Document, views: Sequence[BakedView], request: ShaderRequest) -> None:
    """Raise InputError, with a bake that makes them alike, if one text cannot serve all primitives."""
    asked = {"influences"} if request.influences else set()
    kinds = {
        member: {getattr(view.note, member): view.source.place.within_file for view in reversed(views)}
        for member in ALIKE
        if member not in asked
    }
    several = {member: found for member, found in kinds.items() if len(found) > 1}
    if not several:
        return
    listed = " and in ".join(
        f"{member} ({', '.join(f'{value} in {place}' for value, place in found.items())})"
        for member, found in several.items()
    )
    # The value that a bake can give to all of them.
    common = {one: Frame.NORMAL if Frame.NORMAL in found else min(found) for one, found in several.items()}
    options = " ".join(f"--{ALIKE[member]} {value}" for member, value in common.items())
    raise InputError(
        f"its primitives differ in {listed}, and each kind needs its own shader. To have one for all, run "
        f"skinbake bake {options}, with the other options as before. Or write one for each kind with "
        f"{' and '.join(f'--{member}' for member in several)}",
        document.place,
    )


def _with_enough(views: Sequence[BakedView], influences: int) -> list[BakedView]:
    """Return the primitives that use no further slots. Raises InputError, with a remedy, if none does."""
    over = [_vertices_over(view, influences) for view in views]
    enough = [view for view, count in zip(views, over, strict=True) if count == 0]
    if enough:
        return enough
    slots = views[0].note.influences
    raise InputError(
        f"{counted(over[0], 'vertex uses', 'vertices use')} more than {influences} of its {slots} "
        f"influences, adopted joints included: use --influences {slots}",
        views[0].source.place,
    )


def _in_one_place(views: Sequence[BakedView]) -> list[BakedView]:
    """Return the primitives that one text finds α and β of.

    In the texcoord layout the number of stored slots decides where α and β are. There all have the fewest.
    """
    fewest = min(view.note.influences for view in views)
    return [view for view in views if view.note.layout != Layout.TEXCOORD or view.note.influences == fewest]


def _vertices_over(view: BakedView, influences: int) -> int:
    """Return the number of vertices with a weight, α or β in a slot that the shader would leave out."""
    weights = view.now.weights[:, influences:] != 0
    gradients = (view.alpha[:, influences - 1 :] != 0) | (view.beta[:, influences - 1 :] != 0)
    return int(np.count_nonzero((weights | gradients).any(axis=1)))


def _with_joints(document: Document, views: Sequence[BakedView], choices: ShaderChoices) -> ShaderChoices:
    """Return the choices adapted to joints that mirror or scale. Raises InputError where DQS has no code."""
    mirrors, scales = choices.mirrored_joints, choices.scaled_joints
    for view, poses in _posed(document, views):
        primitive = rest_primitive(view)
        used = primitive.joints_in_use(poses.joint_matrices.shape[1])
        if choices.method is not Method.LBS:
            names = scaled_joints([primitive], poses)
            if choices.method is Method.BLEND and not names:
                # Linear blending takes the vertex as it is, so there is no scale to share.
                volumes = np.abs(determinants(poses.joint_matrices[:, used]))
                of_one_size = np.abs(volumes - 1.0).max(initial=0.0) < 3 * RIGID_TOLERANCE
                names = [] if of_one_size else ["the skeleton"]
            rigid_only = choices.target in {"three", "playcanvas"}
            if names and (choices.lighting is not BEST[choices.method] or rigid_only):
                best = f"--lighting {BEST[choices.method]}"
                needs = "--method lbs, or --target babylon, galacean or plain" if rigid_only else best
                what = f"this file does not fit --method {choices.method}"
                raise InputError(f"{what}: {names[0]} scales or shears; use {needs}", view.source.place)
            scales |= bool(names) and choices.target not in AT_RUN_TIME
        mirrors |= bool((determinants(poses.joint_matrices[:, used]) < 0).any())
    choices = replace(choices, scaled_joints=scales)
    return replace(choices, mirrored_joints=mirrors and choices.crosses)


def _posed(document: Document, views: Sequence[BakedView]) -> Iterator[tuple[BakedView, PoseSet]]:
    """Yield each view with the poses of each skin that draws it, the same poses as in verify."""
    clips, sets = read_clips(document), dict[int, PoseSet]()
    for view in views:
        for skin in document.asset.skins_of(view.source.mesh):
            if skin not in sets:
                sets[skin] = pose_set(document, skin, clips, PoseRequest())
            yield view, sets[skin]


def _tell_not_for(document: Document, view: BakedView, request: ShaderRequest) -> None:
    """Tell of a primitive that needs a shader of its own, with the options that write it."""
    if request.method is Method.BLEND and view.blend is None:
        message = "this shader does not fit it: it is baked without --blend. Light it by --method lbs"
        document.notices.tell(Notice("shader-not-for", message, view.source.place))
        return
    storage = {member: str(getattr(view.note, member)) for member in STORAGE}
    others = {
        member: kind for member, kind in storage.items() if getattr(request, member) not in (None, kind)
    }
    frame, influences = view.note.frame, view.note.influences
    stored = "".join(f", {member} {kind}" for member, kind in others.items())
    options = "".join(f" --{member} {kind}" for member, kind in others.items())
    message = (
        f"this shader does not fit it: it is baked in the {frame} frame with {influences} "
        f"influences{stored}. Write another shader with --frame {frame} --influences {influences}{options}"
    )
    document.notices.tell(Notice("shader-not-for", message, view.source.place))
