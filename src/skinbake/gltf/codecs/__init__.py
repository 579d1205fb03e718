"""Compressed geometry: Draco, meshopt, and the change of a document from one to the other."""

from __future__ import annotations

import importlib
from typing import Any

from skinbake.errors import Place, UnsupportedFeatureError


def codec(package: str, place: Place | None = None) -> Any:
    """Import the package of a compression. Raises UnsupportedFeatureError where there is none."""
    try:
        return importlib.import_module(package)
    except ModuleNotFoundError as error:
        message = f"the compression needs the package {package}, which is not installed here"
        raise UnsupportedFeatureError(message, place) from error
