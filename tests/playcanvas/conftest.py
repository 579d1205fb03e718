"""The browser starts slowly."""

from __future__ import annotations

import pytest


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark every test that opens the browser as slow, before the marked ones are left out."""
    for item in items:
        if isinstance(item, pytest.Function) and "opened" in item.fixturenames:
            item.add_marker(pytest.mark.slow)
