"""Plans of images: camera, board, and what of the image and of distances and tilts is covered."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from calib.verbs.plan.images.plan_file import coverage, distances_and_tilts

if TYPE_CHECKING:
    from calib.verbs.plan.plan import Plan


def image_head(plan: Plan) -> str:
    """Word the robot, the links of camera and board, and the numbers of images."""
    robot, count = plan.robot, len(plan.estimation)
    taken = f" beside {len(plan.taken)} taken already" if len(plan.taken) else ""
    return (
        f"Plan for '{robot.name}' ({robot.urdf.source}), camera on {robot.base}, board on {robot.tip}: {count} images "
        f"for calibration{taken}, {len(plan.joints) - count} for validation."
    )


def image_facts(plan: Plan) -> Iterator[tuple[str, str]]:
    """Word what the images cover, each fact with its label."""
    distances, tilts = distances_and_tilts(plan)
    yield "distance", f"{1e3 * distances.min():.0f} to {1e3 * distances.max():.0f} mm"
    span = f"{_deg(tilts.min())} to {_deg(tilts.max())} deg"
    yield "tilt", f"{span}, half of the images above {_deg(np.median(tilts))} deg"
    yield "image", f"corners in {100.0 * coverage(plan):.0f} % of its area"


def _deg(angle: float) -> str:
    """Format an angle [rad] in whole degrees."""
    return f"{math.degrees(angle):.0f}"
