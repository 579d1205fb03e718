"""The cause of each find of the fuzzer, and the test that would see it again.

By the beginning of the names under which finds are kept: ``python -m benchmarks.reliability`` prints both.
"""

from __future__ import annotations

CODECS, FINDS = "tests/gltf/test_compression.py", "tests/gltf/test_finds.py"
HOSTILE = "tests/gltf/test_hostile.py"
BUSY = "no fault: the machine was busy, and the child had no processor. tests/fuzz/test_judges.py"

MENDED = {
    "crash-bake-exit-70": f"a line feed too many in deep texts: {HOSTILE}",
    "crash-bake-signal-11-gltf-draco-stream": f"a range too wide for Draco: {CODECS}",
    "defect-RuntimeWarning-former": f"a signalling not-a-number: {FINDS}",
    "defect-RuntimeWarning-frames": f"a signalling not-a-number: {FINDS}",
    "defect-RuntimeWarning-morph-bake": f"morph targets of numbers that float32 cannot hold: {FINDS}",
    "defect-RuntimeWarning-rigs": f"a pivot beyond float32: {FINDS}",
    "defect-ValueError-components": f"a page of a model that had lost its normals: {FINDS}",
    "hang-bake-gltf-json-text": BUSY,
    "hang-strip-gltf-json-text": BUSY,
    "hang-verify-f87844af": BUSY,
    "hang-verify-gltf-json-text": BUSY,
    "hang-verify-lighting-threads": BUSY,
    "native-kernel-left-shift-of-negative-value": "the bits of a number were shifted with its sign: "
    "tests/fuzz/test_runs.py",
    "over-bounds-or-undocumented": "each pose was morphed twice: tests/measure/test_morphs.py",
    "twice-code-3-over-the-N-KiB": "no fault: the second bake was held to the first one's --max-memory",
    "written-bake-code-4": "no fault: the name of a buffer or an image that no depfile can hold is found "
    "after the bake",
    "twice-other-bytes-in-accessors": f"a sparse accessor over Draco; a view into padding: {FINDS}",
    "twice-other-bytes-in-images": f"the URI of a missing image was reworded: {FINDS}",
    "twice-other-bytes-in-meshes": f"a sparse accessor over a Draco stream: {FINDS}",
}


def mended(name: str) -> str:
    """Return what a find was, empty where that is not known yet."""
    return next((words for start, words in MENDED.items() if name.startswith(start)), "")
