"""Link the WESL of a Bevy shader with stand-ins for Bevy's modules, so that plain WGSL is left.

The linker is the one in JavaScript of the group that specifies WESL (npm: wesl). Bevy uses another one of the
same group.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterable, Mapping
from pathlib import Path

from tests.support.node import SUPPORT, require_node

MODULES = Path(__file__).parent / "stub" / "wesl"
TIMEOUT_SECONDS = 300


def link(shaders: Mapping[str, tuple[str, Iterable[str]]]) -> dict[str, str]:
    """Return the WGSL of shaders by name, each from its text and the flags that are set.

    Raises ValueError with the linker's words for the first one that it refuses.
    """
    if not shaders:
        return {}
    modules = {f"render/{path.name}": path.read_text() for path in MODULES.glob("*.wesl")}
    jobs = {name: {"text": text, "conditions": [*flags]} for name, (text, flags) in shaders.items()}
    process = subprocess.run(
        [require_node("wesl"), SUPPORT / "link.mjs"],
        input=json.dumps({"modules": modules, "jobs": jobs}),
        capture_output=True,
        text=True,
        timeout=TIMEOUT_SECONDS,
        check=True,
    )
    answers = json.loads(process.stdout)
    for name, answer in answers.items():
        if "error" in answer:
            raise ValueError(f"{name}: {answer['error']}")
    return {name: answer["wgsl"] for name, answer in answers.items()}
