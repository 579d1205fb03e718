"""Images of textures: which of them a texture names, and their bytes (glTF 2.0, §3.8 and §5.19)."""

from __future__ import annotations

from collections.abc import Container, Sequence

from skinbake.errors import InputError, Notice, Place
from skinbake.files import Bytes
from skinbake.gltf.budget import Work
from skinbake.gltf.codecs.views import view_bytes
from skinbake.gltf.document import Document
from skinbake.gltf.json_access import JsonObject, index, listed, member, object_of, reference, text
from skinbake.gltf.resources import decode_data_uri, is_data_uri, read_resource

WEBP, KTX2 = "EXT_texture_webp", "KHR_texture_basisu"
TRANSFORM = "KHR_texture_transform"


def shown_textures(material: JsonObject) -> dict[str, JsonObject]:
    """Return the texture infos that a page or a picture shows, by use; empty where a use has none.

    Members of other types are as if they were not there.
    """
    pbr = object_of(material.get("pbrMetallicRoughness"))
    return {
        "base": object_of(pbr.get("baseColorTexture")),
        "normal": object_of(material.get("normalTexture")),
        "emissive": object_of(material.get("emissiveTexture")),
    }


def texcoord_set(info: JsonObject) -> int:
    """Return the number of the texture coordinates on which a texture info puts its image."""
    told = object_of(object_of(info.get("extensions")).get(TRANSFORM))
    sets = (reference(holder.get("texCoord")) for holder in (told, info))
    return next((number for number in sets if number is not None and number >= 0), 0)


def tell_images_unplaced(
    document: Document, primitive: JsonObject, has: Container[str], made: str, place: Place
) -> None:
    """Tell if a primitive lacks the texture coordinates of an image that its material shows.

    has are the names of its texture coordinates.
    """
    material = listed(document.json, "materials", primitive.get("material"))
    if material is None:
        return
    infos = shown_textures(material).values()
    named = {f"TEXCOORD_{texcoord_set(info)}" for info in infos if reference(info.get("index")) is not None}
    missing = sorted(name for name in named if name not in has)
    if missing:  # pragma: no branch: tests/render/test_texcoords.py
        message = f"its material puts an image on {' and '.join(missing)}, which the primitive does not have"
        shown = f"{message}. The {made} shows the primitive without it"
        document.notices.tell(Notice("images-unplaced", shown, place))


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

    def claim(size: int) -> None:
        document.budget.claim(Work(bytes=size), f"image {image}", document.place)

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
