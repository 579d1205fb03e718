"""Materials: factors, the textures that they show, and the bytes of images (glTF 2.0, §3.8–3.9, §5.19)."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass

from skinbake.errors import InputError, Notice
from skinbake.files import Bytes
from skinbake.gltf.asset import PrimitiveSource
from skinbake.gltf.codecs.meshopt import view_bytes
from skinbake.gltf.document import Document
from skinbake.gltf.json_access import (
    JsonObject,
    index,
    is_number,
    listed,
    member,
    object_of,
    reference,
    text,
)
from skinbake.gltf.resources import decode_data_uri, is_data_uri, read_resource

WEBP, KTX2 = "EXT_texture_webp", "KHR_texture_basisu"
TRANSFORM = "KHR_texture_transform"
UNLIT, TOON = "KHR_materials_unlit", "VRMC_materials_mtoon"


@dataclass(frozen=True, slots=True)
class Texture:
    """An image on a surface: the number of its texture, and where it lies and how it is read.

    offset and scale are in (u, v), rotation is in radians, from v to u (KHR_texture_transform). strength is
    that of a normal map. wraps and magnified are the codes of a glTF sampler.
    """

    number: int | None
    texcoord: int
    offset: tuple[float, ...]
    rotation: float
    scale: tuple[float, ...]
    strength: float
    wraps: tuple[int | None, int | None]
    magnified: int | None

    @classmethod
    def of(cls, root: JsonObject, info: JsonObject) -> Texture:
        """Return what a texture info says. Members of other types are as if they were not there."""
        told = object_of(object_of(info.get("extensions")).get(TRANSFORM))
        sets = (reference(holder.get("texCoord")) for holder in (told, info))
        sampler = listed(root, "samplers", (listed(root, "textures", info.get("index")) or {}).get("sampler"))
        wrap_u, wrap_v, magnified = (
            reference((sampler or {}).get(key)) for key in ("wrapS", "wrapT", "magFilter")
        )
        return cls(
            reference(info.get("index")),
            next((number for number in sets if number is not None and number >= 0), 0),
            _numbers(told, "offset", 2) or (0.0, 0.0),
            _number(told, "rotation", 0.0),
            _numbers(told, "scale", 2) or (1.0, 1.0),
            _number(info, "scale", 1.0),
            (wrap_u, wrap_v),
            magnified,
        )


@dataclass(frozen=True, slots=True)
class Material:
    """What a material says. A page or a picture shows ``textures`` by use: base, normal, emissive.

    Members of other types are as if they were not there, so that no material is refused. Colours are linear.
    ``mode`` is the alphaMode. ``has_normal_map`` counts one for its clear coat too.
    """

    mode: str
    cutoff: float
    is_double: bool
    is_unlit: bool
    base: tuple[float, ...] | None
    emissive: tuple[float, ...] | None
    roughness: float
    has_normal_map: bool
    textures: Mapping[str, Texture]


def material_of(document: Document, number: int | None) -> Material | None:
    """Return a material, None if the file has none of this number.

    The toon materials of VRM name KHR_materials_unlit for viewers that do not know them, and are lit.
    """
    content = listed(document.json, "materials", number)
    if content is None:
        return None
    pbr, extensions = object_of(content.get("pbrMetallicRoughness")), object_of(content.get("extensions"))
    coat = object_of(extensions.get("KHR_materials_clearcoat"))
    infos = {
        "base": object_of(pbr.get("baseColorTexture")),
        "normal": object_of(content.get("normalTexture")),
        "emissive": object_of(content.get("emissiveTexture")),
    }
    vrm = object_of(object_of(document.json.get("extensions")).get("VRM"))
    is_toon = (listed(vrm, "materialProperties", number) or {}).get("shader") == "VRM/MToon"
    return Material(
        mode=str(content.get("alphaMode")),
        cutoff=_number(content, "alphaCutoff", 0.5),
        is_double=content.get("doubleSided") is True,
        is_unlit=UNLIT in extensions and TOON not in extensions and not is_toon,
        base=_numbers(pbr, "baseColorFactor", 4),
        emissive=_numbers(content, "emissiveFactor", 3),
        roughness=_number(pbr, "roughnessFactor", 1.0),
        has_normal_map="normalTexture" in content or "clearcoatNormalTexture" in coat,
        textures={use: Texture.of(document.json, info) for use, info in infos.items() if info},
    )


def _number(parent: JsonObject, key: str, default: float) -> float:
    value = parent.get(key)
    return float(value) if is_number(value) else default


def _numbers(parent: JsonObject, key: str, count: int) -> tuple[float, ...] | None:
    value = parent.get(key)
    if not isinstance(value, list) or len(value) != count or not all(map(is_number, value)):
        return None
    return tuple(map(float, value))


def tell_images_unplaced(document: Document, source: PrimitiveSource, has: Container[str], made: str) -> None:
    """Tell if a primitive lacks the texture coordinates of an image that its material shows.

    has are the names of its texture coordinates.
    """
    material = material_of(document, source.material)
    shown = material.textures.values() if material else ()
    named = {f"TEXCOORD_{texture.texcoord}" for texture in shown if texture.number is not None}
    missing = sorted(name for name in named if name not in has)
    if missing:  # pragma: no branch: tests/render/test_texcoords.py
        message = f"its material puts an image on {' and '.join(missing)}, which the primitive does not have"
        message = f"{message}. The {made} shows the primitive without it"
        document.notices.tell(Notice("images-unplaced", message, source.place))


def texture_image(document: Document, texture: int) -> int | None:
    """Return the image of a texture that is PNG, JPEG or WebP; None if it names none.

    Raises InputError if the texture does not exist, if it names an image that does not exist, or if its only
    image is in KTX2.
    """
    textures = document.objects("textures")
    if not 0 <= texture < len(textures):
        message = f"a material names texture {texture}, and the file has {len(textures)}"
        raise InputError(message, document.place)
    content = textures[texture]
    extensions = member(content, "extensions", document.place)
    count = len(document.objects("images"))
    for holder in (extensions.get(WEBP), content):
        if isinstance(holder, dict):
            found = index(holder, "source", count, document.place)
            if found is not None:
                return found
    if KTX2 in extensions:
        raise InputError(f"texture {texture} is in KTX2, which is not decoded", document.place)
    return None


def image_bytes(document: Document, image: int) -> Bytes:
    """Return the bytes of an image. Raises InputError if they cannot be had."""
    content: JsonObject = document.objects("images")[image]
    view = index(content, "bufferView", len(document.objects("bufferViews")), document.place)
    if view is not None:
        return view_bytes(document, view, document.place)
    uri = text(content, "uri", document.place)
    if uri is None:
        raise InputError(f"image {image} names neither a buffer view nor a file", document.place)

    claim = document.budget.claiming(f"image {image}", document.place)
    if is_data_uri(uri):
        claim(2 * len(uri))
        return decode_data_uri(uri, document.place)
    return read_resource(uri, document.folder, document.bounds, document.place, claim, of="image")


def tell_images_missing(document: Document, reasons: Sequence[str], made: str) -> None:
    """Tell of images that are left out of a page or a picture, if there are any."""
    if not reasons:
        return
    message = f"{reasons[0]}. The {made} is without this image"
    if len(reasons) > 1:
        message = f"{len(reasons)} images are left out of the {made}. Of the first: {reasons[0]}"
    document.notices.tell(Notice("images-missing", message, document.place, len(reasons)))
