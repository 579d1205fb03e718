"""Branches of the readers that no damaged model and no fault reaches, and why, or what else reaches them."""

from __future__ import annotations

EXPLAINED: dict[tuple[str, str, str], str] = {}
