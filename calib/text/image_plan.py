"""Plans of images: camera, board, and what of the image and of distances and tilts is covered."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from calib.design.images.plan_file import coverage, distances_and_tilts

if TYPE_CHECKING:
    from calib.design.plan import PlanValues


def image_head(plan: PlanValues) -> Iterator[str]:
    """Write the robot, camera and board, numbers of images, and what they cover."""
    robot, sight, count = plan.robot, plan.sight, len(plan.estimation)
    assert sight is not None
    taken = f" beside {len(plan.taken)} taken already" if len(plan.taken) else ""
    yield (
        f"Plan for '{robot.name}' ({robot.urdf.source}), camera on {robot.base}, board on {robot.tip}: {count} images "
        f"for calibration{taken}, {len(plan.joints) - count} for validation."
    )
    distances, tilts = distances_and_tilts(plan)
    corners = 100.0 * coverage(plan)
    yield (
        f"  The board is {1e3 * distances.min():.0f} to {1e3 * distances.max():.0f} mm away, tilted "
        f"{_deg(tilts.min())} to {_deg(tilts.max())} deg (half of the images more than {_deg(np.median(tilts))} deg); "
    )
    yield f"  its corners cover {corners:.0f} % of the image."


def _deg(angle: float) -> str:
    """Format an angle [rad] in whole degrees."""
    return f"{math.degrees(angle):.0f}"
