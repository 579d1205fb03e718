"""Command lines: each command with its options, at random, for a model that lies in ``in/``."""

from __future__ import annotations

from collections.abc import Sequence
from random import Random

Group = Sequence[tuple[float, Sequence[Sequence[str]]]]
"""Options with how often one of their forms is given."""

BAKE: Group = (
    (0.25, [["--weighting", way] for way in ("angle", "area", "angle-area", "max")]),
    (0.15, [["--crease-angle", angle] for angle in ("0", "1e-9", "90", "180")]),
    (0.25, [["--weld", "skin"]]),
    (0.25, [["--neighbours", "drop"], ["--neighbours", "extend"]]),
    (
        0.25,
        [
            ["--gradients", "surface"],
            ["--gradients", "fitted"],
            ["--gradients", "fitted", "--fit-poses", "random:2"],
        ],
    ),
    (0.1, [["--pack"]]),
    (0.06, [["--depfile", "out/m.d"]]),
    (0.3, [["--frame", "tangent"], ["--frame", "normal"]]),
    (0.04, [["--limit-influences", "4"], ["--limit-influences", "8"]]),
    (0.3, [["--generate-normals"]]),
    (
        0.1,
        [
            ["--alpha-name", "_A{set}", "--beta-name", "_B{set}"],
            ["--alpha-name", "_COLOR_{set}"],
            ["--beta-name", "_{set}{set}"],
        ],
    ),
    (0.04, [["--encoding", "packed8"], ["--encoding", "snorm16"]]),
    (0.2, [["--layout", "texcoord"], ["--layout", "custom"]]),
    (0.05, [["--require-baked"]]),
    (0.03, [["--no-sync"]]),
    (0.03, [["--max-memory", "60K"], ["--max-memory", "200K"], ["--max-memory", "1G"]]),
    (0.05, [["--warnings-as-errors"]]),
    (0.1, [["--json"], ["--timings"], ["-v"], ["-vv"], ["-q"], ["--color", "always"]]),
)
COMPRESS: Sequence[Sequence[str]] = (
    ["--compress", "none"],
    ["--compress", "draco"],
    ["--compress", "draco", "--compress-level", "0"],
    ["--compress", "draco", "--compress-level", "10"],
    ["--compress", "draco", "--position-bits", "8"],
    ["--compress", "draco", "--normal-bits", "5", "--texcoord-bits", "9"],
    ["--compress", "draco", "--texcoord-bits", "12"],
    ["--compress", "meshopt"],
    ["--compress", "meshopt", "--compress-level", "0"],
    ["--compress", "meshopt", "--compress-level", "3"],
    ["--compress", "keep"],
)
VERIFY: Group = (
    (0.3, [["--method", "lbs"], ["--method", "dqs"]]),
    (0.9, [["--poses", "rest"], ["--poses", "random:1"], ["--poses", "random:2"], ["--samples", "1"]]),
    (0.1, [["--angle", "0"], ["--angle", "180"]]),
    (0.2, [["--baseline", "inverse-transpose"], ["--baseline", "cofactor"]]),
    (0.1, [["--cap", "0.9"], ["--cap", "1e-300"]]),
    (0.1, [["--max-mean-error", "0"], ["--max-p95-error", "3"], ["--min-gain", "2"]]),
    (0.1, [["--require-baked"], ["--warnings-as-errors"]]),
    (0.2, [["--json"], ["-v"], ["-q"]]),
)
SHADER: Group = (
    (0.9, [["--lang", "glsl"], ["--lang", "wgsl"], ["--lang", "hlsl"]]),
    (
        0.5,
        [
            ["--target", target]
            for target in (
                *("plain", "bevy", "godot"),
                *("three", "babylon", "playcanvas", "galacean"),
            )
        ],
    ),
    (0.3, [["--method", "dqs"]]),
    (0.2, [["--frame", "tangent"], ["--frame", "normal"]]),
    (0.2, [["--influences", "8"], ["--influences", "4"]]),
    (0.2, [["--cap"], ["--cap", "0.5"]]),
    (0.2, [["--mirrored-joints"]]),
    (0.2, [["--scaled-joints"]]),
    (0.2, [["--stage", "compute"]]),
    (0.2, [["--morphs", "normal"], ["--morphs", "tangent"]]),
)
RENDER: Group = (
    (0.5, [["--mode", mode] for mode in ("shaded", "reflections", "error", "normals")]),
    (0.3, [["--clip", "0"], ["--clip", "1"], ["--clip", "walk"]]),
    (0.3, [["--time", "0"], ["--time", "0.5"], ["--time", "-1"]]),
    (0.4, [["--split"], ["--lighting", "standard"], ["--lighting", "accurate"]]),
    (0.2, [["--clay"], ["--turntable"], ["--max-memory", "200K"]]),
)
REPORT = ["--html", "out/report.html"]
STATES = (
    b"",
    b"\xff\xfe\0garbage\n",
    b"[" * 3000 + b"\n",
    b'{"skinbake":1}\n{"key":1}\n{"key":"bake out/m.glb","how":[],"from":{},"read":null,"made":3}\n',
    b'{"key":"x","how":"y","from":"../../../etc/passwd","read":{"/etc/passwd":"00"},"made":{"../secret.bin":null}}\n'
    * 9,
)


CONFIGS = (
    b'[bake]\nencoding = "snorm16"\n[verify]\nposes = "random:1"\n',
    b'[[overrides]]\nfiles = ["in/**", "**"]\nbake = { layout = "texcoord", limit-influences = 4 }\n',
    b'[bake]\nout-dir = "../../taken"\n',
    b"[bake]\nin-place = true\n",
    b"[bake]\njobs = [[[[{}]]]]\n",
    b'overrides = [{ files = [3] }, "x"]\n',
    b"a = " + b"[" * 5000,
    b"\xff\xfe\0",
    b"",
)


TARGETS = (*["out/m.glb", "out/m.gltf"] * 8, "out/gone/m.glb", "out/m.bin/m.glb", "out/", "out/m.txt")


def chosen(random: Random, group: Group) -> list[str]:
    """Return options of a group, each with its own likelihood."""
    return [word for often, forms in group if random.random() < often for word in random.choice(forms)]


def command_line(random: Random, name: str, suffix: str) -> tuple[list[str], dict[str, bytes], bool]:
    """Return the arguments, files that they need besides the model, and whether the model comes on stdin.

    The model is ``in/`` and the name; outputs go to ``out/``.
    """
    kind = random.random()
    source, files, piped = f"in/{name}{suffix}", dict[str, bytes](), False
    if suffix == ".glb" and random.random() < 0.04:
        source, piped = "-", True
    if kind < 0.56:
        arguments = _bake(random, source, suffix, files)
        arguments += _configured(random, files) if random.random() < 0.08 else []
        return arguments, files, piped
    if kind < 0.66:
        arguments = ["verify", source, *chosen(random, VERIFY)]
        arguments += REPORT if random.random() < 0.25 else []
        arguments += _noted(random, files) if random.random() < 0.1 else []
        arguments += ["--junit", "out/junit.xml"] if random.random() < 0.1 else []
        arguments += ["--dump-normals", "out/normals.jsonl"] if random.random() < 0.2 else []
        return arguments, files, piped
    if kind < 0.70:
        return ["view", source, "-o", random.choice(("out/page.html", "out/page.html", "-"))], files, piped
    if kind < 0.75:
        goal = random.choice(("out/m.png", "out/m.gif", "out/m.webp"))
        return ["render", source, "-o", goal, "--size", "16x16", *chosen(random, RENDER)], files, piped
    if kind < 0.82:
        goal = random.choice(("out/m.glb", "out/m.glb", "out/m.gltf", "-"))
        return ["strip", source, "-o", goal, *(["--json"] if random.random() < 0.1 else [])], files, piped
    if kind < 0.88:
        return ["inspect", source, *(["--json"] if random.random() < 0.4 else [])], files, piped
    if kind < 0.92:
        arguments = ["config", source, *(["--json"] if random.random() < 0.4 else [])]
        return [*arguments, *_configured(random, files)], files, piped
    target = ["-o", "out/s.txt"] if random.random() < 0.5 else []
    return ["shader", "--for", source, *chosen(random, SHADER), *target], files, piped


def _bake(random: Random, source: str, suffix: str, files: dict[str, bytes]) -> list[str]:
    if random.random() < 0.15:
        names = ("m.glb", "m.gltf", "m.bin", "tex.png", "sub/tex.png", "m-1.bin")
        files.update({f"../out/{name}": b"what was there" for name in names if random.random() < 0.4})
    options = chosen(random, BAKE) + (list(random.choice(COMPRESS)) if random.random() < 0.2 else [])
    where = random.random()
    if source == "-":
        target = ["-o", random.choice(("-", "out/m.glb"))]
    elif where < 0.55:
        target = ["-o", random.choice((f"out/m{suffix}", f"out/m{suffix}", *TARGETS))]
    elif where < 0.8:
        target = ["--out-dir", random.choice(("out", "out/new/sub"))]
    elif where < 0.85:
        target = ["--in-place"]
    elif where < 0.9:
        target = ["--dry-run"]
    elif where < 0.95:
        return ["bake", "in", "--out-dir", "out", *options, *_noted(random, files)]
    else:
        target = ["-o", "-"]
        options = [word for word in options if word != "--json"]
    return ["bake", source, *target, *options, *(_noted(random, files) if random.random() < 0.08 else [])]


def _configured(random: Random, files: dict[str, bytes]) -> list[str]:
    """Return the option of a configuration file, and put one of any content in its place."""
    files["skinbake.toml"] = random.choice(CONFIGS)
    return ["--config", "in/skinbake.toml"]


def _noted(random: Random, files: dict[str, bytes]) -> list[str]:
    """Return options that keep notes, and put notes of any content in their place."""
    options = []
    if random.random() < 0.5:
        options += ["--summary", "out/summary.jsonl"]
    if random.random() < 0.7:
        options += ["--skip-unchanged", "--state", "out/state.jsonl"]
        files["../out/state.jsonl"] = random.choice(STATES)
    return options
