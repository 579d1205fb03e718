"""Draw docs/view.webp: a character where a bake shows, as it is lit, and below the errors of its normals.

Usage: python -m benchmarks.character_picture [MODEL] [--output FILE]

Both rows are ``skinbake render MODEL --split --closeup``, with ``--mode error`` for the lower one. Of three
pictures one is kept. Without a model, it is the alien of the corpus (SKINBAKE_CORPUS, or
../shared/corpus), by Quaternius, CC0. Other characters show less at a glance: on the mannequin a joint hides
the place, on the barbarian it is a wrist behind his belt, robot, mantis and fox are coarse, the hand has no
clip, and Cesium's man has a trademark. The files of the dinosaur and the elf state no licence.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image, ImageSequence

from benchmarks.corpus_table import REPOSITORY, corpus_folders
from skinbake.commands.render import RenderOptions, render_file
from skinbake.render.pictures import MILLISECONDS
from skinbake.render.studio import Look

SIZE = 720, 300
KEPT, QUALITY = 3, 80


def frames(model: Path, mode: str) -> tuple[list[Image.Image], str]:
    """Return some pictures of a clip in a mode, and the clip and the errors in words."""
    options = RenderOptions(Look(*SIZE, mode), sides=("standard", None), is_close=True)
    with TemporaryDirectory() as folder:
        target = Path(folder) / "clip.webp"
        result = render_file(str(model), str(target), options)
        with Image.open(target) as image:
            every = [frame.convert("RGB") for frame in ImageSequence.Iterator(image)]
    return every[::KEPT], result.pose


def main() -> None:
    """Draw the picture, and print its place and errors."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("model", nargs="?", type=Path)
    parser.add_argument("--output", type=Path, default=REPOSITORY / "docs" / "view.webp")
    arguments = parser.parse_args()
    model = arguments.model or corpus_folders()[0] / "Alien" / "Alien_Scolitex.gltf"
    (upper, words), (lower, _) = (frames(model, mode) for mode in ("shaded", "error"))
    pictures = []
    for above, below in zip(upper, lower, strict=True):
        picture = Image.new("RGB", (SIZE[0], 2 * SIZE[1]))
        picture.paste(above, (0, 0))
        picture.paste(below, (0, SIZE[1]))
        pictures.append(picture)
    first, *others = pictures
    duration = KEPT * MILLISECONDS
    first.save(
        arguments.output, save_all=True, append_images=others, duration=duration, loop=0, quality=QUALITY
    )
    print(f"{arguments.output}: {words}, {len(pictures)} pictures, {arguments.output.stat().st_size:,} bytes")


if __name__ == "__main__":
    main()
