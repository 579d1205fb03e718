"""Files and folders: which names may be used, and how files are opened, compared and written whole."""

from __future__ import annotations

from typing import TypeAlias

Bytes: TypeAlias = bytes | memoryview
"""Bytes of a file, or a piece of them."""
