"""calib: kinematic calibration of robot arms. URDF in, corrected URDF out."""

from __future__ import annotations

__version__ = "0.1.0.dev0"
