"""The paper's UR3, its table, and calibrations of virtual cells."""

from __future__ import annotations

import pytest

from tests.fits import (
    calibrated,
    case,
    default_result,
    join,
    make_scene,
    paper_cell,
    table,
    ur3,
    virtual,
)

__all__ = [
    "calibrated",
    "case",
    "default_result",
    "join",
    "make_scene",
    "paper_cell",
    "table",
    "ur3",
    "virtual",
]


@pytest.fixture(scope="module")
def scene(make_scene):
    """A robot, three frames in reach and two targets."""
    return make_scene(0, frames=3, targets=2, reach=1.0)


@pytest.fixture(scope="module")
def four_frames(make_scene):
    """A robot, four frames in reach and two targets."""
    return make_scene(1, frames=4, targets=2, reach=1.0)
