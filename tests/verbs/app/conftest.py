"""The app over a folder, entered by a client that sends what a browser sends."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.verbs.app.served import Client, served


@pytest.fixture
def client(tmp_path: Path) -> Iterator[Client]:
    """A client of a new folder."""
    with served(tmp_path / "desk", "en") as client:
        yield client.enter()
