"""The paper's UR3, its table, and calibrations of virtual cells."""

from __future__ import annotations

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
