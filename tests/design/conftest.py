"""The paper's UR3, and calibrations of virtual cells."""

from __future__ import annotations

from tests.fits import calibrated, case, make_scene, ur3

__all__ = ["calibrated", "case", "make_scene", "ur3"]
