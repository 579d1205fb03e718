"""What can go wrong, where it did, and what had to be assumed.

The tree::

    SkinbakeError
    ├── InputError                  the file cannot be read, or is not valid glTF        exit 3
    │   └── UnsupportedFeatureError it is valid, and this version cannot process it      exit 3
    ├── OutputError                 the result cannot be written                         exit 4
    └── VerificationError           the file was read and does not pass                  exit 1
"""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True, slots=True)
class Place:
    """Where in which file: every message about data carries one."""

    file: str
    mesh: int | None = None
    mesh_name: str | None = None
    primitive: int | None = None
    attribute: str | None = None

    def at(self, attribute: str) -> Place:
        """Return this place, narrowed to one attribute (or ``indices``) of the primitive."""
        return replace(self, attribute=attribute)

    def __str__(self) -> str:
        """Read like ``hero.glb: mesh 2 "Body", primitive 0, WEIGHTS_0``."""
        parts = []
        if self.mesh is not None:
            name = f' "{self.mesh_name}"' if self.mesh_name else ""
            parts.append(f"mesh {self.mesh}{name}")
        if self.primitive is not None:
            parts.append(f"primitive {self.primitive}")
        if self.attribute is not None:
            parts.append(self.attribute)
        return f"{self.file}: {', '.join(parts)}" if parts else self.file


@dataclass(frozen=True, slots=True)
class Notice:
    """Something that had to be assumed or was left out, aggregated over one primitive or file.

    ``code`` is a stable identifier for scripts, ``message`` a sentence for people, ``count`` how many
    vertices, triangles or files it concerns.
    """

    code: str
    message: str
    place: Place
    count: int = 1

    def __str__(self) -> str:
        """Read like a compiler's line: place, then message."""
        return f"{self.place}: {self.message}"


class SkinbakeError(Exception):
    """Base of every error that skinbake raises on purpose."""

    def __init__(self, message: str, place: Place | None = None) -> None:
        super().__init__(f"{place}: {message}" if place else message)
        self.message = message
        self.place = place


class InputError(SkinbakeError):
    """The input cannot be read, or is not valid glTF."""


class UnsupportedFeatureError(InputError):
    """The input is valid, and uses something that this version cannot process."""


class OutputError(SkinbakeError):
    """The output cannot be written."""


class VerificationError(SkinbakeError):
    """The input was read and does not pass verification."""
