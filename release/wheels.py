"""Wheels as files: a record of digests, and a zip without the time of day."""

from __future__ import annotations

import base64
import hashlib
import zipfile
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path


def with_modules(pure: Path, modules: Mapping[str, bytes], platform: str, folder: Path) -> Path:
    """Add compiled modules, by path in the wheel, to a wheel that has none. Return the new wheel."""
    with zipfile.ZipFile(pure) as archive:
        contents = {name: archive.read(name) for name in archive.namelist() if not name.endswith("/")}
    name, version, *_ = pure.name.split("-")
    info, tag = f"{name}-{version}.dist-info", f"cp311-abi3-{platform}"
    about = f"Wheel-Version: 1.0\nGenerator: skinbake.release\nRoot-Is-Purelib: false\nTag: {tag}\n"
    contents |= {**modules, f"{info}/WHEEL": about.encode()}
    del contents[f"{info}/RECORD"]
    contents[f"{info}/RECORD"] = record(contents, f"{info}/RECORD").encode()
    made = folder / f"{name}-{version}-{tag}.whl"
    made.write_bytes(zipped(contents, zipfile.ZIP_DEFLATED))
    return made


def record(contents: Mapping[str, bytes], itself: str) -> str:
    """Return the RECORD of a wheel: digests and sizes of all other files."""
    lines = []
    for name, data in sorted(contents.items()):
        digest = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()
        lines.append(f"{name},sha256={digest},{len(data)}\n")
    return "".join([*lines, f"{itself},,\n"])


def zipped(contents: Mapping[str, bytes], method: int) -> bytes:
    """Return a zip of files in the order of their names, without the time of day."""
    buffer = BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, data in sorted(contents.items()):
            entry = zipfile.ZipInfo(name)
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, data, method)
    return buffer.getvalue()
