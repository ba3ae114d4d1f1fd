"""What several test files ask for by name."""

from __future__ import annotations

import pytest


@pytest.fixture
def without_pictures(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages without the static pictures beside them, which are half of a small run's time; a test marked ``pictures`` has them."""
    if request.node.get_closest_marker("pictures") is None:
        monkeypatch.setattr("insemu.report.static.save", lambda *_, **__: [])
