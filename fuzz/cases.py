"""One run to be: a command line and the files that it finds; made from a seed, kept in a folder."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any

from fuzz.arguments import command_line
from fuzz.made import made_model
from fuzz.models import EMBEDDED, GLB, GLTF, WRAPPED, Model
from fuzz.mutations import damaged_container, mutate
from fuzz.uris import surroundings

ODD_STEMS = (
    *("a b", "ä", "x#y", "a%20b", "a;b", "\x1b[31mred", "x\u202ey", "con", "m.tar", "*"),
    *(".IGNORE", ".PHONY", "a&b", "~", "%", "a=b", "a:b", " m", "m ", "$m", "@m", "a|b", "!m", "(m)"),
)
STEMS = ("m",) * 3 * len(ODD_STEMS) + ODD_STEMS
MADE = 0.15
"""The share of cases whose model is made from the seed."""


@dataclass(frozen=True)
class Case:
    """One run: arguments, and by path from ``in/`` files and links; ``plain`` says the text is json's own.

    ``source`` names the model on the command line, ``about`` what was done to which model.
    """

    seed: int
    arguments: tuple[str, ...]
    files: dict[str, bytes]
    links: dict[str, str] = field(default_factory=dict)
    stdin: bytes = b""
    plain: bool = False
    about: str = ""

    def save(self, folder: Path, notes: dict[str, Any]) -> None:
        """Write the case into a folder of its own, with notes of what was found."""
        folder.mkdir(parents=True, exist_ok=True)
        content = {
            "seed": self.seed,
            "arguments": self.arguments,
            "links": self.links,
            "stdin": base64.b64encode(self.stdin).decode(),
            "plain": self.plain,
            "about": self.about,
            "files": {name: f"{number}.bin" for number, name in enumerate(self.files)},
            **notes,
        }
        for number, data in enumerate(self.files.values()):
            (folder / f"{number}.bin").write_bytes(data)
        text = json.dumps(content, indent=1)
        (folder / "case.json").write_text(text, encoding="utf-8")


def load(folder: Path) -> Case:
    """Return the case of a folder."""
    content = json.loads((folder / "case.json").read_text(encoding="utf-8"))
    return Case(
        content["seed"],
        tuple(content["arguments"]),
        {name: (folder / file).read_bytes() for name, file in content["files"].items()},
        content["links"],
        base64.b64decode(content["stdin"]),
        content["plain"],
        content["about"],
    )


def make_case(seed: int, models: Sequence[Model]) -> Case:
    """Return the case of a seed: a model of the corpus, damaged, and what is done with it."""
    random = Random(seed)
    is_made = random.random() < MADE
    model = made_model(random) if is_made else random.choice(models).copied()
    done = [] if is_made and random.random() < 0.7 else mutate(model, random)
    stem = random.choice(STEMS)
    suffix, files = model.packed(random.choices((GLB, EMBEDDED, GLTF, WRAPPED), (12, 2, 4, 1))[0], stem)
    main = stem + suffix
    links: dict[str, str] = {}
    is_damaged = random.random() < 0.12
    if is_damaged:
        files[main] = damaged_container(files[main], random)
        done.append("container")
    if "resource" in done or random.random() < 0.02:
        beside, links = surroundings(random)
        files = {**beside, **files}
    if random.random() < 0.02:
        other = stem + random.choice((".vrm", ".glb", ".gltf", ".GLB", ".txt"))
        files[other], main = files.pop(main), other
    stem, _, ending = main.rpartition(".")
    arguments, notes, piped = command_line(random, stem, f".{ending}")
    return Case(
        seed,
        tuple(arguments),
        {**files, **notes},
        links,
        files[main] if piped else b"",
        not is_damaged and not model.raw,
        f"{model.name}: {', '.join(done) or 'nothing'}",
    )
