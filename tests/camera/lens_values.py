"""Intrinsics of a camera of each lens, for tests: fx, fy, cx, cy [px], then distortion."""

import numpy as np

_LINEAR = (634.0, 641.0, 652.0, 349.0)

_RATIONAL = (*_LINEAR, 0.7, -0.2, 1e-3, -2e-3, 0.03, 0.9, 0.1, -0.02)

VALUES = {
    "pinhole": np.array([*_LINEAR, -0.28, 0.11, 1e-3, -2e-3, -0.02]),
    "fisheye": np.array([410.0, 405.0, 640.0, 360.0, -0.02, 0.01, -4e-3, 6e-4]),
    "rational": np.array(_RATIONAL),
    "tilted": np.array([*_RATIONAL, 3e-3, -1e-3, -2e-3, 2e-3, 0.03, -0.05]),
}

#: Numbers of many and of few digits, as lists.
WRITTEN = {
    "pinhole": [634.123456789012345, 641.25, 652.5, 349.0, -0.28, 0.11, 1e-05, -2e-17, -0.02],
    "fisheye": [410.1, 405.3, 640.0, 360.0, -0.02, 0.01, -4e-3, 6e-07],
    "rational": VALUES["rational"].tolist(),
    "tilted": VALUES["tilted"].tolist(),
}
