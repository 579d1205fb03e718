"""Words of messages: counts, the nearest known name, and what to do with files of other formats."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from contextlib import suppress
from itertools import islice
from pathlib import Path

SUFFIXES = (".glb", ".gltf", ".vrm")
"""The suffixes of the files that are read and written."""

MOST_NAMES = 10_000
"""The number of names of a folder that are compared with a mistyped one."""

OTHER_FORMATS = {
    ".fbx": "Blender exports it as glTF (File > Export > glTF 2.0), and FBX2glTF converts it",
    ".obj": "OBJ has no skin: export glTF from the program that rigs the model; obj2gltf converts meshes",
    ".blend": "export it from Blender (File > Export > glTF 2.0)",
    ".usd": "Blender imports USD and exports glTF (File > Export > glTF 2.0)",
    ".stl": "STL has no skin: export glTF from the program that rigs the model, like Blender",
    ".dae": "COLLADA2GLTF converts it",
    ".zip": "unpack it",
}
"""The way to glTF, by the suffix of another format."""

ALIASES = {
    **dict.fromkeys((".usda", ".usdc", ".usdz"), ".usd"),
    **dict.fromkeys((".7z", ".rar", ".gz", ".tgz", ".tar"), ".zip"),
}


def counted(count: int, singular: str, plural: str | None = None) -> str:
    """Return ``1 primitive``, ``2,000 vertices``."""
    return f"{count:,} {singular if count == 1 else plural or singular + 's'}"


def installing(extra: str) -> str:
    """Return the command that installs the packages of an extra, also where skinbake came from no index."""
    from importlib.metadata import PackageNotFoundError, requires  # slow, and only errors need it

    with suppress(PackageNotFoundError):
        named = (re.match(r"([^\s;]+).*extra == .(\w+).", one) for one in requires("skinbake") or ())
        packages = [f"'{found[1]}'" for found in named if found and found[2] == extra]
        return f"pip install {' '.join(packages)}"
    return f"install the packages of its extra {extra!r}"


def percent(share: float, decimals: int) -> str:
    """Return a share of 1 like ``4.89 %``."""
    return f"{100.0 * share:.{decimals}f} %"


def told_apart(value: float, limit: float, decimals: int) -> str:
    """Return a value with some decimals, or with so many more that it is on the right side of a limit."""
    text = f"{value:.{decimals}f}"
    while value != limit and (float(text) == limit or (float(text) > limit) != (value > limit)):
        decimals += 1
        text = f"{value:.{decimals}f}"
    return text


def gain_in_words(gain: float) -> str:
    """Return a gain like ``2.20`` or ``1,234``. A loss has up to four decimals, and is never ``1.00``."""
    if gain < 1.0:
        return told_apart(min(gain, 0.9999), 1.0, 2)
    return f"{gain:.2f}" if gain < 100.0 else f"{gain:,.0f}"


def one_or_many(count: int, one: str, many: str) -> str:
    """Return the words for one thing or for many, the count in the place of ``{}``."""
    return (one if count == 1 else many).format(f"{count:,}")


def nearest(word: str, known: Iterable[str]) -> list[str]:
    """Return the known names that resemble a mistyped one, the likeliest first, at most three."""
    import difflib  # only for a mistake

    by_lower = {name.lower(): name for name in known}
    return [by_lower[found] for found in difflib.get_close_matches(word.lower(), by_lower, n=3, cutoff=0.7)]


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return a question like ``did you mean bake?``, or nothing if no known name is near."""
    return _question(nearest(word, known))


def _question(names: Iterable[str]) -> str:
    listed = " or ".join(map(repr, names))
    return f"did you mean {listed}?" if listed else ""


def models_beside(path: str) -> list[str]:
    """Return the names of the glTF files in the folder of a path, as far as they can be read."""
    with suppress(OSError, ValueError), os.scandir(Path(path).parent) as entries:
        return sorted(
            entry.name for entry in islice(entries, MOST_NAMES) if entry.name.lower().endswith(SUFFIXES)
        )
    return []


def meant_file(path: str) -> str:
    """Return a question for a file that does not exist, or nothing if no file beside it has a near name.

    Suffixes are not compared: they make short names look alike.
    """
    meant = Path(path)
    others = {Path(other).stem: other for other in models_beside(path) if other != meant.name}
    return _question(others[found] for found in nearest(meant.stem, others))


def _folders_beside(path: str) -> list[str]:
    """Return the names of the folders in the folder of a path, as far as they can be read."""
    with suppress(OSError, ValueError), os.scandir(Path(path).parent) as entries:
        return sorted(entry.name for entry in islice(entries, MOST_NAMES) if entry.is_dir())
    return []


def not_gltf(path: str, more: str = ", or - for stdin") -> str:
    """Say that a name is not a glTF file, and how to get one from a known format, or from a near name.

    ``more`` are the words for what else may be named.
    """
    suffix = Path(path).suffix.lower()
    way = OTHER_FORMATS.get(ALIASES.get(suffix, suffix))
    if way is not None:
        return f"{suffix[1:].upper()} is not glTF: {way}"
    told, meant = f"expected a name that ends in {', '.join(SUFFIXES)}{more}", ""
    if path and not os.path.lexists(path):
        meant = meant_file(path)
        if not suffix:
            told = "no such file or folder"
            meant = did_you_mean(Path(path).name, _folders_beside(path)) or meant
    return f"{told}; {meant}" if meant else told
