"""Give the decoders of Draco and meshopt damaged streams, as skinbake calls them.

The decoders themselves come compiled: of their reads and writes the sanitizer sees those that go through the
C library, and every allocation; the loops that undo meshopt's filters are numpy's.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from random import Random
from typing import Any


@dataclass(frozen=True)
class Stream:
    """A compressed stream: which codec, its bytes, and what its document declares of it."""

    codec: str
    data: bytes
    declared: Any


@functools.cache
def streams() -> list[Stream]:
    """Return small streams of both codecs, by every mode, filter and method that is to be had."""
    return [*_draco_streams(), *_meshopt_streams()]


def _draco_streams() -> list[Stream]:
    import DracoPy
    import numpy as np

    found = []
    random = np.random.default_rng(3)
    for vertices, ordered, bits in (
        (4, True, 0),
        (24, True, 11),
        (24, False, 11),
        (60, False, 14),
        (200, True, 0),
    ):
        points = random.normal(size=(vertices, 3)).astype("f4")
        base = np.arange(vertices - 2, dtype="u4")
        faces = np.stack([base, base + 1, base + 2], axis=1)
        generic = {
            0: random.integers(0, 9, (vertices, 4)).astype("u2"),
            1: random.random((vertices, 4)).astype("f4"),
        }
        data = bytes(
            DracoPy.encode(
                points, faces, quantization_bits=bits, preserve_order=ordered, generic_attributes=generic
            )
        )
        mesh = DracoPy.decode(data)
        found.append(
            Stream(
                "draco",
                data,
                (len(mesh.points), 3 * len(mesh.faces), 36 * len(mesh.points) + 12 * len(mesh.faces)),
            )
        )
    return found


def _meshopt_streams() -> list[Stream]:
    import meshopt
    import numpy as np

    from skinbake.gltf.codecs.meshopt import STRIDES_OF_FILTERS, Packing

    found = []
    random = np.random.default_rng(4)
    for version in (0, 1):
        for name, strides in STRIDES_OF_FILTERS.items():
            for stride in sorted({strides[0], strides[-1], 12 if 12 in strides else 8}):
                for count in (1, 17, 300):
                    rows = np.cumsum(random.integers(0, 3, (count, stride)), axis=0).astype("u1")
                    data = bytes(meshopt.encode_vertex_buffer_level(rows, 2, version))
                    found.append(Stream("meshopt", data, Packing("ATTRIBUTES", name, count, stride)))
    for size in (2, 4):
        corners = np.arange(90, dtype=f"u{size}") % 31
        found.append(
            Stream(
                "meshopt", bytes(meshopt.encode_index_buffer(corners)), Packing("TRIANGLES", "NONE", 90, size)
            )
        )
        found.append(
            Stream(
                "meshopt", bytes(meshopt.encode_index_sequence(corners)), Packing("INDICES", "NONE", 90, size)
            )
        )
    return found


def executions(seed: int) -> int:
    """Decode one damaged stream; what comes must be an array or an error of ours."""
    from skinbake.errors import Place, SkinbakeError
    from skinbake.gltf.codecs import draco_stream, meshopt

    random = Random(seed)
    stream = random.choice(streams())
    data, declared, place = memoryview(_damaged(random, stream.data)), stream.declared, Place("fuzz")
    try:
        if stream.codec == "draco":
            if random.random() < 0.1:
                declared = tuple(max(number + random.choice((-3, -1, 1, 3)), 1) for number in declared)
            counts = draco_stream.check_counts(data, declared[0], declared[1], place)
            draco_stream.decode(data, counts.method, declared[2], place)
        else:
            meshopt.check_length(data, declared, "fuzz", place)
            meshopt.decoded(data, declared, "fuzz", place)
    except SkinbakeError:
        pass
    return 1


def _damaged(random: Random, data: bytes) -> bytes:
    content = bytearray(data)
    kind = random.randrange(8)
    if kind < 3:
        for _ in range(random.choice((1, 1, 2, 4, 16))):
            content[random.randrange(len(content))] = random.choice(
                (0, 255, 128, 127, 1, random.randrange(256))
            )
    elif kind == 3:
        for _ in range(random.choice((1, 2))):
            content[random.randrange(min(len(content), 64))] ^= 1 << random.randrange(8)
    elif kind == 4:
        del content[random.randrange(1, len(content) + 1) :]
    elif kind == 5:
        at, length = random.randrange(len(content)), random.choice((1, 4, 50))
        content[at : at + length] = random.randbytes(random.choice((0, length)))
    elif kind == 6:
        content += random.randbytes(random.choice((1, 16)))
    return bytes(content) or b"\0"
