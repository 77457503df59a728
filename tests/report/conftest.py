"""Calibrations of virtual cells."""

from __future__ import annotations

from tests.viewer.conftest import calibrations, paper_calibration

__all__ = ["calibrations", "paper_calibration"]
