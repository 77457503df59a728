"""A real robot and calibrations of virtual cells."""

from __future__ import annotations

from tests.viewer.conftest import (
    calibrations,
    disturb,
    fingers,
    gantry,
    head_and_arm,
    panda,
    paper_calibration,
    ur3,
    ur3_page,
    ur3_view,
    with_mesh,
)

__all__ = [
    "calibrations",
    "disturb",
    "fingers",
    "gantry",
    "head_and_arm",
    "panda",
    "paper_calibration",
    "ur3",
    "ur3_page",
    "ur3_view",
    "with_mesh",
]
