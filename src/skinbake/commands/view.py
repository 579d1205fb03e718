"""``skinbake view``: a page that shows a file, baked in memory if it was not baked, and its figures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePath
from typing import Any

import numpy as np

from skinbake.choices import Gradients, Scheme
from skinbake.commands.bake import Baker
from skinbake.commands.remedies import noted_baker
from skinbake.commands.verify import verify_document
from skinbake.containment import BESIDE, Bounds
from skinbake.errors import InputError, Notice, Place, SkinbakeError
from skinbake.format.strip import stripped
from skinbake.gltf.codecs.recode import Compression, recoded
from skinbake.gltf.container import for_target
from skinbake.gltf.document import STDIO, Document, read_document
from skinbake.gltf.output import plan_output, refuse_own_input
from skinbake.gltf.primitives import skinned_sources
from skinbake.gltf.resources import is_data_uri, read_resource
from skinbake.gltf.writing import write_file, write_stdout
from skinbake.lighting.baked_views import BakedView, baked_views, is_baked
from skinbake.lighting.expected import noted_kind
from skinbake.lighting.measured import VerifyOptions
from skinbake.report.verify import FileVerdict, file_json
from skinbake.timing import stage
from skinbake.view.page import OtherGradients, Shown, page

PNG, JPEG, WEBP = b"\x89PNG", b"\xff\xd8\xff", b"RIFF"
IMAGES = {PNG: "image/png", JPEG: "image/jpeg", WEBP: "image/webp"}


@dataclass(frozen=True, slots=True)
class ViewResult:
    """The page, whether the file was baked in memory for it, and the assumptions made."""

    page: bytes
    was_baked: bool
    notices: tuple[Notice, ...] = ()


def view_file(source: str, target: str | None = None, bounds: Bounds = BESIDE) -> ViewResult:
    """Return the page that shows one file. Nothing is written.

    Raises InputError if the file cannot be read, or has nothing skinned that can be baked. Raises OutputError
    if ``target`` is a file of the document.
    """
    with stage("read"):
        document = read_document(source, bounds)
    if target is not None:
        refuse_own_input(document, source, target)
    views = _baked_views(document)
    was_baked = bool(views)
    notices: tuple[Notice, ...] = ()
    if not was_baked:
        document, notices = _baked(document)
        views = _baked_views(document)
    with stage("other gradients"):
        others = list(_other_gradients(document, views))
    verdict = verify_document(document, VerifyOptions())
    with stage("page"):
        glb, missing = _self_contained(document)
    found = (*notices, *missing, *verdict.notices)
    name = "stdin" if source == STDIO else PurePath(source).name
    findings = _findings(verdict, found, was_baked=was_baked)
    with stage("page"):
        return ViewResult(page(Shown(name=name, glb=glb, others=others, findings=findings)), was_baked, found)


def write_page(result: ViewResult, target: str, *, sync: bool = True) -> None:
    """Write the page to a file, whole or not at all, or to stdout. Raises OutputError."""
    if target == STDIO:
        write_stdout([result.page])
    else:
        write_file([result.page], target, sync=sync)


def _baked_views(document: Document) -> list[BakedView]:
    """Return the baked primitives of a document whose structure is sound."""
    sources, _ = skinned_sources(document)
    views, _ = baked_views(document, [source for source in sources if is_baked(document, source)])
    return views


def _baked(document: Document) -> tuple[Document, tuple[Notice, ...]]:
    """Bake a document with the defaults. Raises InputError if nothing in it can be baked."""
    plain, _, _ = stripped(document)
    made = Baker(generate_normals=True).bake_document(plain)
    if not made.primitives:
        reasons = "; ".join(notice.message for notice in made.notices)
        raise InputError(
            f"nothing in it can be shown: {reasons or 'nothing in it is skinned'}", document.place
        )
    return made.document, made.notices


def _other_gradients(document: Document, views: Sequence[BakedView]) -> Iterator[OtherGradients]:
    """Yield α and β of the kind that the file does not hold, baked with the same settings otherwise.

    Yields nothing if they cannot be baked: without a rig there is one kind only.
    """
    kind = Gradients.SURFACE if noted_kind(views[0]) is Gradients.RIG else Gradients.RIG
    try:
        plain, _, _ = stripped(document)
        made = replace(noted_baker(views[0]), gradients=kind, generate_normals=True).bake_document(plain)
        others = {view.source.place: view for view in _baked_views(made.document)}
    except SkinbakeError:
        return
    for view in views:
        other = others.get(view.source.place)
        if other is None or noted_kind(other) is not kind or other.alpha.shape != view.alpha.shape:
            continue
        same = np.array_equal(other.now.joints, view.now.joints)
        place = view.source.place
        yield OtherGradients(
            kind=str(kind),
            mesh=place.mesh or 0,
            primitive=place.primitive or 0,
            alpha=other.alpha,
            beta=other.beta,
            joints=None if same else other.now.joints,
            weights=None if same else other.now.weights,
        )


def _self_contained(document: Document) -> tuple[list[bytes | memoryview], list[Notice]]:
    """Return the pieces of a GLB without compression, with all buffers and images in it; and notices."""
    plain, _ = recoded(document, [], Compression(Scheme.NONE))
    packed, _ = for_target(plain, STDIO)
    packed, notices = _with_images(packed)
    return list(plan_output(packed, STDIO).files.popitem()[1]), notices


def _with_images(document: Document) -> tuple[Document, list[Notice]]:
    """Return a GLB with the images that it names in its BIN chunk, and a notice on those that are missing."""
    binary = list(document.binary or ())
    length = sum(map(len, binary))
    views, images = list(document.objects("bufferViews")), list(document.objects("images"))
    lost: list[InputError] = []
    for number, image in enumerate(images):
        uri = image.get("uri")
        if not isinstance(uri, str) or is_data_uri(uri):
            continue
        kept = {key: value for key, value in image.items() if key != "uri"}
        try:
            data = bytes(read_resource(uri, document.folder, document.bounds, document.place))
        except InputError as error:
            lost.append(error)
            images[number] = kept
            continue
        padding = -length % 4
        kind = next((mime for head, mime in IMAGES.items() if data.startswith(head)), "image/png")
        views.append({"buffer": 0, "byteOffset": length + padding, "byteLength": len(data)})
        images[number] = {**kept, "bufferView": len(views) - 1, "mimeType": kind}
        binary += [bytes(padding), data]
        length += padding + len(data)
    if not images:
        return document, []
    buffers = [{**document.objects("buffers")[0], "byteLength": length}, *document.objects("buffers")[1:]]
    root: dict[str, Any] = {**document.json, "images": images, "bufferViews": views, "buffers": buffers}
    return document.edited(json=root, binary=tuple(binary)), _lost_images(lost, document.place)


def _lost_images(lost: Sequence[InputError], place: Place) -> list[Notice]:
    if not lost:
        return []
    message = f"{lost[0].message}: it is shown without this image"
    if len(lost) > 1:
        message = f"{len(lost)} images are left out of the page, the first because it {message}"
    return [Notice("images-missing", message, place, len(lost))]


def _findings(verdict: FileVerdict, notices: Sequence[Notice], *, was_baked: bool) -> dict[str, Any]:
    """Return what the page tells beside the model: the members of verify's JSON, and sentences."""
    told = file_json(verdict)
    notes = [] if was_baked else ["The file was not baked. This page baked it in memory, with the defaults."]
    notes += [f"{notice.message} ({notice.place.within_file})" for notice in notices]
    return {
        "figures": told["normals"],
        "by_triangles": told["normals_by_triangles"],
        "poses": told["poses"],
        "checks": [
            {
                "name": check.name,
                "outcome": check.outcome,
                "remark": check.remark,
                "problems": [problem.message for problem in check.problems],
            }
            for check in verdict.checks
        ],
        "notes": notes,
    }
