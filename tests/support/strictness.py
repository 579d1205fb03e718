"""Skip where a tool is missing, or fail where the run promised to have all of them."""

from __future__ import annotations

import os
from typing import NoReturn

import pytest


def is_strict() -> bool:
    """Say whether SKINBAKE_STRICT=1 is set: then a missing tool is a failure, not a skip."""
    return os.environ.get("SKINBAKE_STRICT") == "1"


def missing_tool(reason: str) -> NoReturn:
    """Skip the running test or the module being collected with this reason; fail it in a strict run."""
    if is_strict():
        pytest.fail(f"SKINBAKE_STRICT=1: {reason}", pytrace=False)
    pytest.skip(reason, allow_module_level=True)
