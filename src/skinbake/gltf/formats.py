"""Component types and shapes of accessors, by number and name in glTF 2.0 (§3.6.2.2)."""

from __future__ import annotations

import numpy as np

from skinbake.gltf.json_access import JsonObject, reference

COMPONENT_TYPES: dict[int, np.dtype[np.generic]] = {
    5120: np.dtype("<i1"),
    5121: np.dtype("<u1"),
    5122: np.dtype("<i2"),
    5123: np.dtype("<u2"),
    5125: np.dtype("<u4"),
    5126: np.dtype("<f4"),
}
COMPONENT_CODES = {dtype: code for code, dtype in COMPONENT_TYPES.items()}
COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
TYPES = {count: name for name, count in COMPONENTS.items()}

COMPONENT_NAMES = {
    5120: "BYTE",
    5121: "UNSIGNED_BYTE",
    5122: "SHORT",
    5123: "UNSIGNED_SHORT",
    5125: "UNSIGNED_INT",
    5126: "FLOAT",
}
MATRIX_ROWS = {"MAT2": 2, "MAT3": 3, "MAT4": 4}


def component_dtype(holder: JsonObject) -> np.dtype[np.generic] | None:
    """Return the dtype of an object's ``componentType``, None if glTF does not define it."""
    code = reference(holder.get("componentType"))
    return None if code is None else COMPONENT_TYPES.get(code)
