"""Draw docs/sheet.webp: the sheet that ``skinbake view FOLDER -o PAGE`` writes of characters of fixtures/.

Usage: python -m benchmarks.sheet_picture [--output FILE]

The sheet is opened in headless Chromium, as the tests open pages.
"""

from __future__ import annotations

import argparse
import io
import re
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image

from benchmarks.bend_picture import REPOSITORY
from tests.support import browser

CHARACTERS = ("barbarian_walking.glb", "butterfly_wings.glb", "fox.glb")
SIZE, QUALITY = (1120, 900), 80
OPEN = """(async () => {
    while (innerWidth !== WIDTH) await new Promise(requestAnimationFrame);
    await Promise.all([...document.images].map((image) => image.decode()));
    return document.body.scrollHeight;
})""".replace("WIDTH", str(SIZE[0]))


def main() -> None:
    """Draw the picture, and print its bytes."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("--output", type=Path, default=REPOSITORY / "docs" / "sheet.webp")
    arguments = parser.parse_args()
    with TemporaryDirectory() as scratch:
        folder, page = Path(scratch, "art"), Path(scratch, "sheet.html")
        folder.mkdir()
        Path(scratch, "profile").mkdir()
        for name in CHARACTERS:
            shutil.copy(REPOSITORY / "fixtures" / "characters" / name, folder / name)
        skinbake = [sys.executable, "-m", "skinbake"]
        subprocess.run([*skinbake, "example", "-o", "art/hero.glb"], cwd=scratch, check=True)
        subprocess.run([*skinbake, "view", "art", "-o", page.name], cwd=scratch, check=True)
        # Its policy lets no other script run, and the browser of the tests waits for this one.
        text = re.sub("<meta http-equiv=[^>]*>", "", page.read_text(encoding="utf-8"))
        page.write_text(text.replace("</body>", "<script>window.ready = true</script></body>"), "utf-8")
        with browser.opened_file(page, Path(scratch, "profile")) as shown:
            shown.show_as(*SIZE, "light")
            shown.show_as(SIZE[0], shown.call(OPEN), "light")
            shown.call(OPEN)
            picture = Image.open(io.BytesIO(shown.screenshot())).convert("RGB")
    picture.save(arguments.output, quality=QUALITY)
    print(f"{arguments.output}: {picture.size}, {arguments.output.stat().st_size:,} bytes")


if __name__ == "__main__":
    main()
