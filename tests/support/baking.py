"""Bakes for tests: one file, with the options of the bake and of the writing in one call."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from skinbake.commands import bake
from skinbake.commands.bake_options import BakeOptions
from skinbake.files.bounds import OWN_FOLDERS, Within
from skinbake.format.baked import AttributeNames
from skinbake.format.encodings import GradientFormat
from skinbake.gltf.writing.output import Writing
from skinbake.gltf.writing.recode import Compression
from skinbake.gradients.baker import BakeSettings
from skinbake.jobs.bake import Bake
from skinbake.report.bake import FileResult

WRITING = {*Writing._fields}


def bake_settings(**changes: Any) -> BakeSettings:
    """Return the settings of a bake without options, with some changed; crease_angle is in radians."""
    return BakeOptions().settings._replace(**changes)


def options_of(
    *,
    settings: BakeSettings | None = None,
    storage: GradientFormat | None = None,
    names: AttributeNames | None = None,
    compression: Compression | None = None,
    **options: Any,
) -> BakeOptions:
    """Return options of a bake; those that the code under test holds together may be given together."""
    if settings is not None:
        options |= {name: getattr(settings, name) for name in ("weighting", "neighbours", "frame")}
        options["crease_angle"] = math.degrees(settings.crease_angle)
    if storage is not None:
        options |= {"encoding": storage.encoding, "layout": storage.layout}
    if names is not None:
        options |= {"alpha_name": names.alpha, "beta_name": names.beta}
    if compression is not None:
        options |= {"compress": compression.scheme, "compress_level": compression.level}
        options |= {
            f"{'texcoord' if name == 'TEXCOORD_0' else name.lower()}_bits": bits
            for name, bits in compression.bits.items()
        }
    return BakeOptions(**options)


def bake_work(**options: Any) -> Bake:
    """Return the work of baking a job so; options are those of ``options_of`` and of ``Writing``."""
    how = {name: options.pop(name) for name in list(options) if name in WRITING}
    return Bake(options_of(**options), Writing(**how))


def bake_file(
    source: str | Path, target: str | Path | None, *, within: Within = OWN_FOLDERS, **options: Any
) -> FileResult:
    """Bake one file; options are those of ``options_of`` and of ``Writing``."""
    work = bake_work(**options)
    goal = None if target is None else str(target)
    return bake.bake_file(str(source), goal, work.options, work.writing, within)
