"""Scenes with several frames and targets."""

from __future__ import annotations

import pytest


@pytest.fixture(scope="module")
def scene(make_scene):
    """A robot, three frames in reach and two targets."""
    return make_scene(0, frames=3, targets=2, reach=1.0)


@pytest.fixture(scope="module")
def four_frames(make_scene):
    """A robot, four frames in reach and two targets."""
    return make_scene(1, frames=4, targets=2, reach=1.0)
