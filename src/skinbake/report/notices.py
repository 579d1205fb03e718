"""Places, notices and errors as JSON."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from skinbake.errors import Notice, Place, SkinbakeError


def place_fields(place: Place) -> dict[str, Any]:
    """Return a place as the members that are known, without the file."""
    fields = {
        "mesh": place.mesh,
        "mesh_name": place.mesh_name,
        "primitive": place.primitive,
        "attribute": place.attribute,
    }
    return {key: value for key, value in fields.items() if value is not None}


def notice_list(notices: Iterable[Notice]) -> list[dict[str, Any]]:
    """Return notices as JSON objects with a stable ``code``."""
    return [
        {"code": notice.code, "message": notice.message, "count": notice.count, **place_fields(notice.place)}
        for notice in notices
    ]


def error_fields(error: SkinbakeError | None) -> dict[str, Any] | None:
    """Return an error as a JSON object, None if there is none."""
    if error is None:
        return None
    where = place_fields(error.place) if error.place else {}
    return {"kind": type(error).__name__, "message": error.message, **where}
