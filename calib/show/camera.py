"""From where a scene is seen: the camera that holds all of it in view on a 16:9 screen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Vertical angle of view [deg]: a long lens, so that robots at the side are not distorted.
_FOV_DEG = 28.0

#: How far the camera looks down [rad].
_DOWN = np.deg2rad(16.0)

#: The part of the picture's half width for the scene.
_WIDTH = 0.95

#: Of more points than this only the outermost are looked at.
_MANY = 200


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """A camera that looks at a point.

    Attributes:
        centre: shape (3,), [m], what it looks at.
        axes: shape (3, 3), rows: right, up, towards the camera.
        distance: From the centre, [m].
        radius: Of a sphere about the centre that holds the scene, [m].
        fov_deg: Vertical angle of view.
    """

    centre: Array
    axes: Array
    distance: float
    radius: float
    fov_deg: float = _FOV_DEG

    @property
    def position(self) -> list[float]:
        """Where it stands, from the centre, in meshcat's frame of cameras, in which y is up [m]."""
        x, y, z = (float(value) for value in self.distance * self.axes[2])
        return [x, z, -y]


def row_direction(points: Array) -> Array:
    """A horizontal direction to look from in which an arm spreads out, shape (3,), a unit vector.

    Args:
        points: shape (N, 3), the origins of its links.
    """
    flat = points[:, :2] - points[:, :2].mean(axis=0)
    _, values, axes = np.linalg.svd(flat, full_matrices=True)
    spread = axes[0] if values[0] > 0 else np.array([0.0, 1.0])
    # The arm reaches to the right of the picture and a little towards the camera.
    outward = points[-1, :2] - points[0, :2]
    x, y = spread if spread @ outward >= 0 else -spread
    angle = np.arctan2(y, x) - np.deg2rad(68.0)
    return np.array([np.cos(angle), np.sin(angle), 0.0])


def look_at(points: Array, back: Array, between: tuple[float, float] = (-0.69, 0.75)) -> Camera:
    """The nearest camera in a direction that sees all points where no text stands.

    Args:
        points: shape (N, 3), [m].
        back: shape (3,), horizontal unit vector from the scene to the camera.
        between: Where text at the foot ends and where that of the heading begins; the picture is from -1 to 1.
    """
    lower, upper = np.array([-_WIDTH, between[0]]), np.array([_WIDTH, between[1]])
    towards = np.cos(_DOWN) * back + np.sin(_DOWN) * np.array([0.0, 0.0, 1.0])
    right = np.array([-back[1], back[0], 0.0])
    axes = np.stack([right, np.cross(towards, right), towards])
    points = _outermost(points)
    seen = points @ axes.T
    half = np.tan(0.5 * np.deg2rad(_FOV_DEG)) * np.array([16.0 / 9.0, 1.0])
    centre = 0.5 * (seen.min(axis=0) + seen.max(axis=0))
    distance = float(np.linalg.norm(np.ptp(seen, axis=0))) / half[1]
    for _ in range(60):
        local = seen - centre
        at = local[:, :2] / (distance - local[:, 2:]) / half
        low, high = at.min(axis=0), at.max(axis=0)
        scale = float(np.max((high - low) / (upper - lower)))
        middle = 0.5 * (low + high) - 0.5 * (lower + upper)
        centre[:2] += middle * half * distance
        nearest = float(local[:, 2].max())
        distance = nearest + (distance - nearest) * (1.0 + 0.7 * (scale - 1.0))
    target = centre @ axes
    radius = float(np.linalg.norm(points - target, axis=1).max())
    return Camera(target, axes, distance, radius)


def _outermost(points: Array) -> Array:
    """The corners of the points' convex hull, which all others lie between, seen from anywhere."""
    from scipy.spatial import ConvexHull, QhullError

    if len(points) < _MANY:
        return points
    try:
        corners: Array = points[ConvexHull(points).vertices]
    except QhullError:  # all in one plane
        return points
    return corners


def round_length(longest: float) -> float:
    """The largest 1, 2 or 5 times a power of ten that is not above a length."""
    power = 10.0 ** np.floor(np.log10(longest))
    return float(power * max(step for step in (1, 2, 5) if step * power <= longest * 1.000001))
