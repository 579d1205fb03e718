"""Models of pygltflib's, in memory, as documents and back."""

from __future__ import annotations

import copy
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from skinbake.commands.bake import rebaked
from skinbake.errors import InputError, Place, warnings_in
from skinbake.gltf.document import Document, joined, parse_gltf

if TYPE_CHECKING:
    from pygltflib import GLTF2

    from skinbake.commands.bake_options import BakeOptions

AS_GLB = "model.glb"


def baked_model(model: GLTF2, options: BakeOptions) -> GLTF2:
    """Return a new model with α and β. The given model stays as it is.

    Buffer 0 of the new model is its binary blob. URIs of other buffers and of images stay as they are, and
    lead from the folder that the model was loaded from. Raises InputError, and TypeError for an object
    that is not a model of pygltflib.
    """
    given = document_of(model)
    made = rebaked(given, AS_GLB, options)
    warnings = list(map(str, warnings_in(given.notices)))
    if options.warnings_as_errors and warnings:
        raise InputError("; ".join(warnings) + " (warnings_as_errors)", given.place)
    if made.is_baked or made.left:
        return model_of(made.document, model)
    with _of_pygltflib("cannot be copied", given.place):
        return copy.deepcopy(model)


def document_of(model: GLTF2) -> Document:
    """Return a model as a document that reads its files from the folder that the model was loaded from.

    Raises InputError if a member holds what glTF cannot, and TypeError for an object that is not a model.
    """
    if not hasattr(model, "gltf_to_json") or not hasattr(model, "binary_blob"):
        raise TypeError(f"bake() takes a path or a GLTF2 of pygltflib, not {type(model).__name__}")
    name = getattr(model, "_name", None)
    name = name if isinstance(name, str) and name else "GLTF2"
    with _of_pygltflib("cannot be written as JSON", Place(name)):
        text = model.gltf_to_json(separators=(",", ":"), indent=None).encode("utf-8")
    given = getattr(model, "_path", None)
    try:
        folder = Path("." if given is None else given)
        is_path = b"\0" not in os.fsencode(folder)
    except (TypeError, ValueError):
        is_path = False
    if not is_path:
        raise InputError(f"its _path is {given!r:.40}: expected the folder of its files", Place(name))
    document = parse_gltf(text, name, folder)
    blob = model.binary_blob()
    if blob is None:
        return document.edited()
    try:
        data = bytes(memoryview(blob))
    except TypeError as error:
        kind = type(blob).__name__
        raise InputError(f"its binary blob is of type {kind}: expected bytes", Place(name)) from error
    return document.edited(is_glb=True, indent=None, binary=(data,))


def model_of(document: Document, like: GLTF2) -> GLTF2:
    """Return a document, a GLB, as a model of the same class, with the folder and the name of ``like``."""
    with _of_pygltflib("holds what pygltflib does not read", document.place):
        model = type(like).from_json(document.text, infer_missing=True)
    if document.binary is not None:
        model.set_binary_blob(bytes(joined(document.binary)))
    for member in ("_path", "_name"):
        if hasattr(like, member):
            setattr(model, member, getattr(like, member))
    return model


@contextmanager
def _of_pygltflib(what: str, place: Place) -> Iterator[None]:
    """Raise InputError for any exception of pygltflib, which takes the types of members as sound."""
    try:
        yield
    except Exception as error:  # members of a model may be any objects
        raise InputError(f"the model {what} ({error})", place) from error
