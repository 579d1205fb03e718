"""What a picture shows of a material: its factors, its images, and where they lie (glTF 2.0, §3.9)."""

from __future__ import annotations

import io
import warnings
from collections.abc import Container, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from skinbake.errors import InputError
from skinbake.files import Bytes
from skinbake.geometry.skinned import FloatArray
from skinbake.gltf.budget import Cost, Work
from skinbake.gltf.document import Document
from skinbake.gltf.reading.materials import Material as StoredMaterial
from skinbake.gltf.reading.materials import (
    Texture,
    image_bytes,
    material_of,
    tell_images_missing,
    texture_image,
)

if TYPE_CHECKING:
    from PIL.Image import Image as Picture

Levels = tuple[npt.NDArray[np.uint8], ...]
"""An image (H, W, 4), then each half as large as the one before, down to one pixel."""

CLAY = (0.60, 0.585, 0.56, 1.0)
WHITE = (1.0, 1.0, 1.0, 1.0)
CLAY_ROUGHNESS = 0.42
ROUGHNESS = (0.3, 0.8)
"""The bounds of the roughness that is drawn: one light makes no highlight outside them."""

LARGEST = 2048
"""Pixels along a side of an image. Larger ones are scaled down; a picture has no more itself."""

FORMATS = ("PNG", "JPEG", "WEBP")
PNG_DEPTH = 24
"""The place of the byte of a PNG that holds the bits of a sample."""

HOLE, SOLID, EVERY = 0.5, 0.99, 1e9
"""Ranges of alpha in which what blends is drawn. From SOLID on nothing behind shows through, to the eye. From
HOLE on it hides what is drawn behind it later, so that triangles in any order cost the picture the smaller
part of a colour only. Without blending, what is under it is a hole."""

Range = tuple[float, float]
"""The least alpha that is drawn, and what alpha must be below: EVERY for what does not blend."""

COPIES = 3
"""The copies of an encoded image that Pillow holds while it decodes."""

BLACK = (0.0, 0.0, 0.0)


WRAPS = {10497: "repeat", 33071: "clamp-to-edge", 33648: "mirror-repeat"}
NEAREST = 9728
"""The numbers of a glTF sampler."""


def placed(texture: Texture, coordinates: FloatArray) -> FloatArray:
    """Return texture coordinates (V, 2) scaled, then turned, then moved."""
    cosine, sine = np.cos(texture.rotation), np.sin(texture.rotation)
    turned = np.array([[cosine, sine], [-sine, cosine]])
    return np.asarray(coordinates * texture.scale @ turned.T + texture.offset)


def sampling(texture: Texture | None) -> tuple[str, str, str]:
    """Return how an image goes on beyond its edges, along u and v, and is magnified: in WebGPU's words."""
    if texture is None:
        return "repeat", "repeat", "linear"
    wrap_u, wrap_v = (WRAPS.get(code or 0, "repeat") for code in texture.wraps)
    return wrap_u, wrap_v, "nearest" if texture.magnified == NEAREST else "linear"


@dataclass(frozen=True, slots=True, eq=False)
class Material:
    """Linear factors, and images by use: ``base``, ``normal``, ``emissive``; where and how they lie.

    Alpha under cutoff is not drawn. is_double: it is seen from behind too. is_unlit: no light reaches it.
    is_plain: colours of vertices are not drawn either.
    """

    base: tuple[float, ...] = CLAY
    emissive: tuple[float, ...] = BLACK
    roughness: float = CLAY_ROUGHNESS
    normal_scale: float = 1.0
    cutoff: float = 0.0
    is_blended: bool = False
    is_double: bool = False
    is_unlit: bool = False
    is_plain: bool = False
    images: Mapping[str, Levels] = field(default_factory=dict)
    textures: Mapping[str, Texture] = field(default_factory=dict)

    @property
    def ranges(self) -> tuple[Range, tuple[Range, ...]]:
        """The range of alpha that is drawn as a solid, and those that are drawn after all solids."""
        if not self.is_blended:
            return (self.cutoff, EVERY), ()
        return (SOLID, EVERY), ((HOLE, SOLID), (0.0, HOLE))

    def with_images(self, uses: Container[str]) -> Material:
        """Return it without the images of other uses, and without the factors that belong to these."""
        lost = {use for use in self.images if use not in uses}
        return replace(
            self,
            base=CLAY if "base" in lost else self.base,
            emissive=BLACK if "emissive" in lost else self.emissive,
            images={use: levels for use, levels in self.images.items() if use not in lost},
        )


class Materials:
    """The materials of a document, each read once, and the images that it had to leave out."""

    def __init__(self, document: Document) -> None:
        self._document = document
        self._made: dict[int, Material] = {}
        self._images: dict[int, Levels | None] = {}
        self._lost: list[str] = []

    def of(self, number: int | None, in_clay: bool, *, is_lit: bool = True) -> Material:
        """Return a material by its number. A missing or broken one is clay.

        In clay only its sides and its alpha count. Modes that show no light have no blending: there half of
        it counts as a hole.
        """
        stored = material_of(self._document, number)
        if number is None or stored is None:
            return Material(is_plain=in_clay)
        if in_clay and stored.mode not in {"MASK", "BLEND"}:
            return Material(is_double=stored.is_double, is_plain=True)
        if number not in self._made:
            self._made[number] = self._read(stored)
        found = self._made[number]
        if not in_clay:
            return found
        images = {}
        if "base" in found.images:
            levels = tuple(level.copy() for level in found.images["base"])
            for level in levels:
                level[..., :3] = 255
            images["base"] = levels
        return replace(
            found,
            base=(*CLAY[:3], found.base[3]),
            emissive=BLACK,
            roughness=CLAY_ROUGHNESS,
            cutoff=HOLE if found.is_blended else found.cutoff,
            is_blended=found.is_blended and is_lit,
            is_unlit=False,
            is_plain=True,
            images=images,
            textures={use: found.textures[use] for use in images},
        )

    def tell_missing(self) -> None:
        """Return a notice if images were left out."""
        tell_images_missing(self._document, self._lost, "picture")

    def _read(self, stored: StoredMaterial) -> Material:
        named = stored.textures
        images = {use: levels for use, one in named.items() if (levels := self._image(one)) is not None}
        base = stored.base or (WHITE if "base" in images or stored.is_unlit else CLAY)
        return Material(
            # A factor that belongs to an image says little without it.
            base=CLAY if "base" in named and "base" not in images else base,
            emissive=BLACK if "emissive" in named and "emissive" not in images else stored.emissive or BLACK,
            roughness=float(np.clip(stored.roughness, *ROUGHNESS)),
            normal_scale=named["normal"].strength if "normal" in named else 1.0,
            cutoff=stored.cutoff if stored.mode == "MASK" else 0.0,
            is_blended=stored.mode == "BLEND",
            is_double=stored.is_double,
            is_unlit=stored.is_unlit,
            images=images,
            textures={use: named[use] for use in images},
        )

    def _image(self, named: Texture) -> Levels | None:
        """Return the image that a texture names; None without one, or if it cannot be shown."""
        texture = named.number
        if texture is None:
            return None
        if texture not in self._images:
            self._images[texture] = None
            try:
                image = texture_image(self._document, texture)
                if image is not None:
                    self._images[texture] = decoded(image_bytes(self._document, image), self._document)
            except InputError as error:
                self._lost.append(error.message)
        return self._images[texture]


def decoded(data: Bytes, document: Document) -> Levels:
    """Return the levels of a PNG, JPEG or WebP. Raises InputError if it is none, or too large."""
    from PIL import Image, UnidentifiedImageError

    place = document.place
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # Pillow warns of images that are far too large, and of odd ones
            if (canvas := _webp_canvas(data)) is not None:
                with document.budget.passing():
                    _claim_image(document, canvas, Cost.DECODED_PIXEL, COPIES * len(data))
            with Image.open(io.BytesIO(data), formats=FORMATS) as image:
                is_deep = image.format == "PNG" and data[PNG_DEPTH] == 16
                with document.budget.passing():
                    _claim_image(document, image.size, Cost.DECODED_PIXEL, COPIES * len(data))
                    shallow = _shallow(image) if is_deep else image
                    shallow.thumbnail((LARGEST, LARGEST))
                    found = shallow.convert("RGBA")
                _claim_image(document, found.size, Cost.TEXTURE_PIXEL)
    except InputError:
        raise
    except UnidentifiedImageError as error:
        kinds = f"{', '.join(FORMATS[:-1])} or {FORMATS[-1]}"
        message = f"an image cannot be decoded: it is damaged, or no {kinds}"
        raise InputError(message, place) from error
    except Exception as error:  # decoders raise what their formats' readers raise: of any class
        raise InputError(f"an image cannot be decoded ({error})", place) from error
    levels = [found]
    while max(levels[-1].size) > 1:
        width, height = levels[-1].size
        half = max(1, width // 2), max(1, height // 2)
        levels.append(levels[-1].resize(half, Image.Resampling.BOX))
    return tuple(np.asarray(level, np.uint8) for level in levels)


def _claim_image(document: Document, size: tuple[int, int], each: Work, further: int = 0) -> None:
    """Claim what each pixel of an image takes, and some further bytes. Raises InputError."""
    width, height = size
    what = f"an image of {width:,} × {height:,} pixels"
    document.budget.claim(each * (width * height) + Work(bytes=further), what, document.place)


def _webp_canvas(data: Bytes) -> tuple[int, int] | None:
    """Return the size of a WebP by its header (RFC 9649, §2.5–2.7); None for other data.

    Pillow allocates its canvas as soon as it opens it.
    """
    head = bytes(data[:30])
    if head[:4] != b"RIFF" or head[8:12] != b"WEBP" or len(head) < 30:
        return None
    if head[12:16] == b"VP8X":
        return int.from_bytes(head[24:27], "little") + 1, int.from_bytes(head[27:30], "little") + 1
    if head[12:16] == b"VP8L":
        bits = int.from_bytes(head[21:25], "little")
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    return int.from_bytes(head[26:28], "little") & 0x3FFF, int.from_bytes(head[28:30], "little") & 0x3FFF


def _shallow(image: Picture) -> Picture:
    """Return a PNG of 16 bits a sample in RGBA with 8 bits, its transparent colour with alpha 0.

    Pillow gives grey alone with all its bits. Of colours it gives the high bytes: by these they are compared
    with the transparent one.
    """
    from PIL import Image

    key = image.info.get("transparency")
    if not image.mode.startswith("I"):
        if key is not None:
            image.info["transparency"] = tuple(value >> 8 for value in key)
        return image.convert("RGBA")
    samples = np.asarray(image)
    scaled = ((np.arange(2**16) + 128) // 257).astype(np.uint8)
    grey = Image.fromarray(scaled[samples])
    alpha = Image.fromarray(np.where(samples == key, np.uint8(0), np.uint8(255)))
    return Image.merge("RGBA", (grey, grey, grey, alpha))
