"""A calibration by images, and corners made by hand, for tests of their figures."""

from __future__ import annotations

import numpy as np

from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.verbs.calibrate.seen_corners import SeenCorners
from tests.images import arm, cell, poses, table
from tests.kept import kept


@kept
def by_images() -> Calibration:
    """Ten images of a board by a camera on the hand, with noise of 0.3 px."""
    m = table(poses(10), noise=0.3)
    return calibrate(arm(), m, cell=cell(model="zeros"))


def corners(residual, *, measured=None, images=None, **changes) -> SeenCorners:
    """N corners of a board that a camera sees head on at 0.5 m, with 1000 px a unit of x / z; residuals (N, 2) [px]."""
    residual = np.asarray(residual, dtype=float)
    n = len(residual)
    places = np.column_stack([np.arange(n) % 3, np.arange(n) // 3, np.zeros(n)]) * 0.03
    T_camera_board = np.tile(np.eye(4), (n, 1, 1))
    T_camera_board[:, 2, 3] = 0.5
    by_point = np.tile([[2000.0, 0.0, 0.0], [0.0, 2000.0, 0.0]], (n, 1, 1))
    values = {
        "camera": "eye",
        "size": (1200, 900),
        "images": tuple(images or ("a.png",) * n),
        "boards": ("sheet",) * n,
        "corners": tuple(map(str, range(n))),
        "rows": np.arange(n),
        "measured": np.zeros((n, 2)) if measured is None else np.asarray(measured, dtype=float),
        "nominal": np.full((n, 2), np.nan),
        "calibrated": residual,
        "held_out": np.full((n, 2), np.nan),
        "validation": np.zeros(n, dtype=bool),
        "flagged": np.zeros(n, dtype=bool),
        "T_camera_board": T_camera_board,
        "designed": places,
        "on_sheet": places[:, :2],
        "R_board_sheet": np.tile(np.eye(3), (n, 1, 1)),
        "printed": places,
        "by_point": by_point,
    }
    return SeenCorners(**(values | changes))
