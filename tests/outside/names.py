"""URIs of a grammar that mixes all that has ever led a path astray."""

from __future__ import annotations

import random
from collections.abc import Iterator

PARTS = (
    *("a", "b c", "ä", "x#", "x?", "a%20b", ".hidden", "tex", "a.png", "..", ".", "", "...", ".. ", "%2e%2e"),
    *(
        "%2E.",
        "%252e%252e",
        "..%2f",
        "%5c..",
        "..\\",
        "C:",
        "c%3a",
        "\\\\host",
        "NUL",
        "con.png",
        "LPT1",
        "~",
    ),
    *("file:", "http:", "data", "%00", "\0", "\n", "%0a", "link", "up", "abs", "\u202e", "%ff", "\udcff"),
)
SEPARATORS = ("/", "/", "/", "//", "%2f", "%2F", "\\", "%5C", "?", "#", "")


def uris(count: int, seed: int = 11) -> Iterator[str]:
    """Yield URIs, the same ones for the same seed."""
    source = random.Random(seed)
    for _ in range(count):
        pieces = [source.choice(PARTS) for _ in range(source.randint(1, 7))]
        text = source.choice(("", "", "", "/", "//", "./", "../"))
        yield text + "".join(piece + source.choice(SEPARATORS) for piece in pieces[:-1]) + pieces[-1]


def likely_uris(count: int, seed: int = 12) -> Iterator[str]:
    """Yield URIs of parts that exist in the tests' folders, so that many of them lead somewhere."""
    source = random.Random(seed)
    parts = ("a", "x#", "x%23", "x?", "tex", "up", "abs", "link", "..", "%2e%2e", "a.png", "models", "%2E%2E")
    for _ in range(count):
        pieces = [source.choice(parts) for _ in range(source.randint(1, 5))]
        last = source.choice(("a.png", "a.bin", "link", "secret.bin", "abs/secret.bin", "out/../a.png"))
        yield "/".join((*pieces, last))
