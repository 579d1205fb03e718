"""Models of pygltflib's, in memory, as documents and back."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import TYPE_CHECKING

from skinbake.errors import InputError
from skinbake.format.strip import stripped
from skinbake.gltf.container import for_target
from skinbake.gltf.document import Document, joined, parse_gltf

if TYPE_CHECKING:
    from pygltflib import GLTF2

    from skinbake.commands.bake import Baker

AS_GLB = "model.glb"


def baked_model(model: GLTF2, baker: Baker) -> GLTF2:
    """Return a new model with α and β. The given model stays as it is.

    Buffer 0 of the new model is its binary blob. URIs of other buffers and of images stay as they are, and
    lead from the folder that the model was loaded from. Raises InputError, and TypeError for an object
    that is no model of pygltflib.
    """
    original, _, _ = stripped(document_of(model))
    prepared, _ = for_target(original, AS_GLB)
    made = baker.bake_document(prepared)
    if made.primitives:
        document = made.document
    elif baker.require_baked:
        raise InputError("nothing in it can be baked (require_baked)", prepared.place)
    else:
        return copy.deepcopy(model)
    if baker.warnings_as_errors and made.notices:
        raise InputError("; ".join(map(str, made.notices)) + " (warnings_as_errors)", prepared.place)
    return model_of(document, model)


def document_of(model: GLTF2) -> Document:
    """Return a model as a document that reads its files from the folder that the model was loaded from."""
    if not hasattr(model, "gltf_to_json") or not hasattr(model, "binary_blob"):
        raise TypeError(f"bake() takes a path or a GLTF2 of pygltflib, not {type(model).__name__}")
    name = str(getattr(model, "_name", None) or "GLTF2")
    text = model.gltf_to_json(separators=(",", ":"), indent=None).encode("utf-8")
    document = parse_gltf(text, name, Path(getattr(model, "_path", None) or "."))
    blob = model.binary_blob()
    if blob is None:
        return document.edited()
    return document.edited(is_glb=True, indent=None, binary=(bytes(blob),))


def model_of(document: Document, like: GLTF2) -> GLTF2:
    """Return a document, a GLB, as a model of the same class, with the folder and the name of ``like``."""
    model = type(like).from_json(json.dumps(document.json), infer_missing=True)
    if document.binary is not None:
        model.set_binary_blob(bytes(joined(document.binary)))
    for member in ("_path", "_name"):
        if hasattr(like, member):
            setattr(model, member, getattr(like, member))
    return model
