"""What cameras see, as a page shows it: cameras with frustums, boards, and the corners in each image. Values only.

The robot carries one of the two, at its target, and the other stands in the base's frame.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from calib.basics.arrays import Array, Integers, rigid_inverse
from calib.camera.camera import Camera
from calib.camera.lenses import LENSES
from calib.show.scene.puppet import translation
from calib.verbs.evaluate.evaluation import Evaluation
from calib.verbs.view.steps import Steps

#: Depth of a frustum, as a part of the usual distance of board and camera.
_DEPTH = 0.5

#: Edges of a camera's body, as parts of the depth of its frustum; the optical centre is in the middle of its front.
_BODY = np.array([0.26, 0.18, 0.2])

#: Thickness of a board [m].
_THICKNESS = 0.003

#: Parts into which an edge of the image is divided: distortion bends it.
_PARTS = 8

#: Widest slope of a line of sight that is drawn: of a fisheye lens some see beside the camera.
_WIDEST = 1.7

#: Focal length of a camera of which nothing is known, over the width of its images.
_FOCAL = 0.8


class Shape(NamedTuple):
    """A camera or a board in its own frame, z from the camera along the line of sight, or into the board."""

    #: shape (L, 2, 3), ends of lines [m]: the edges of a frustum
    lines: Array
    #: shape (K, 3), points on it [m]: the corners of a board
    points: Array
    #: shape (3,), edges of its body, a box [m]
    edges: Array
    #: shape (4, 4), the middle of the box [m]
    T_shape_body: Array

    @property
    def outline(self) -> Array:
        """Points that enclose it, shape (n, 3) [m]."""
        box = self.T_shape_body[:3, 3] + 0.5 * self.edges * [[-1.0], [1.0]]
        return np.concatenate([self.lines.reshape(-1, 3), self.points, box])


class Standing(NamedTuple):
    """A camera or a board that stands."""

    #: What it looks like
    shape: Shape
    #: shape (2, 4, 4), its pose in the base of each robot, as fitted with it [m]
    T_base_shape: Array


class ImageCorners(NamedTuple):
    """The n corners of one board in one image."""

    #: Width and height of the image [px]
    size: tuple[int, int]
    #: shape (n, 2), where they were found [px]
    measured: Array
    #: shape (2, n, 2), residuals of both robots, measured minus predicted [px]
    residual: Array


class Sight(NamedTuple):
    """Cameras, boards and images of a page."""

    #: What the robot carries at its target
    carried: Shape
    #: What stands
    standing: tuple[Standing, ...]
    #: The corners of each step
    images: tuple[ImageCorners, ...]

    @property
    def outline(self) -> Array:
        """Points that enclose what stands, shape (n, 3), in the base of either robot [m]."""
        placed = [
            shape.outline @ T[:3, :3].T + T[:3, 3] for shape, poses in self.standing for T in poses
        ]
        return np.concatenate([np.zeros((0, 3)), *placed])

    def at(self, steps: Integers) -> Sight:
        """Return the same with some of the steps, by their indices from 0."""
        return self._replace(images=tuple(self.images[k] for k in steps.tolist()))


def sight_of(
    first: Evaluation,
    last: Evaluation,
    steps: Steps,
    cameras: Mapping[str, Camera],
    *,
    carries_camera: bool,
) -> Sight | None:
    """Return what the cameras of a table of images see.

    Args:
        first: The first robot's residuals, on its foot, see `calib.verbs.view.standing`.
        last: The second robot's, or again the first's.
        steps: The images.
        cameras: The cameras by their stations; ``""`` for the only one.
        carries_camera: Whether cameras are the targets, and boards the frames; else the other way round.

    Returns:
        The cameras, boards and images; None where nothing is known of the cameras, or no step is an image.
    """
    if not steps.of_images or not cameras:
        return None
    m = first.measurements
    stations = m.targets if carries_camera else m.groups
    boards = m.groups if carries_camera else m.targets
    of_stations = {name: _camera_of(name, cameras) for name in dict.fromkeys(stations)}
    depth = _DEPTH * _usual_distance(last, steps)
    standing = {name: frustum(camera, depth) for name, camera in of_stations.items()}
    carried = _board_shapes(last, boards)
    if carries_camera:
        carried, standing = standing, carried
    images = [
        _corners_of(first, last, rows, of_stations[stations[int(rows[0])]]) for rows in steps.rows
    ]
    return Sight(
        carried=next(iter(carried.values())),
        standing=tuple(_standing(first, last, standing)),
        images=tuple(images),
    )


def _camera_of(station: str, cameras: Mapping[str, Camera]) -> Camera:
    """Return the camera of a station: its own, else the one without a name, else any."""
    return next(cameras[name] for name in (station, "", *cameras) if name in cameras)


def _usual_distance(e: Evaluation, steps: Steps) -> float:
    """Return the median distance of the origins of frame and target at the steps [m]."""
    m = steps.m
    frames = [e.setup.groups.index(group) for group in m.groups]
    targets = [e.setup.targets.index(target) for target in m.targets]
    T_base_tip = e.robot.poses(m.joints_for(e.robot.joint_names))
    T = e.setup.T_frame_base[frames] @ T_base_tip @ e.setup.T_tip_target[targets]
    return float(np.median(np.linalg.norm(T[:, :3, 3], axis=1)))


def frustum(camera: Camera, depth: float) -> Shape:
    """Return a camera with what it sees, from the optical centre to a depth.

    Args:
        camera: The camera; of unknown intrinsics it is drawn with a usual lens.
        depth: Depth along the line of sight [m].
    """
    rays = _rays(camera, _border(camera.width, camera.height))
    slopes = np.linalg.norm(rays[:, :2], axis=1, keepdims=True)
    rays[:, :2] *= np.minimum(1.0, _WIDEST / slopes)
    seen = depth * rays
    around = np.stack([seen, np.roll(seen, -1, axis=0)], axis=1)
    edges = seen[::_PARTS]
    from_centre = np.stack([np.zeros_like(edges), edges], axis=1)
    body = depth * _BODY
    return Shape(
        lines=np.concatenate([from_centre, around]),
        points=np.zeros((0, 3)),
        edges=body,
        T_shape_body=translation([0.0, 0.0, -0.5 * body[2]]),
    )


def _rays(camera: Camera, pixels: Array) -> Array:
    """Return the directions in which a camera sees pixels (n, 2), as points at a depth of 1, shape (n, 3)."""
    if camera.values is None:
        focal = np.full(2, _FOCAL * camera.width)
        middle = 0.5 * np.array([camera.width, camera.height]) - 0.5
        return np.column_stack([(pixels - middle) / focal, np.ones(len(pixels))])
    lens = LENSES[camera.lens]
    rays = lens.undistort(pixels, camera.values)
    # Far from what was measured a distortion may have no inverse; a fisheye lens sees there beside the camera.
    missing = np.linalg.norm(lens.project(rays, camera.values) - pixels, axis=1) > 1.0
    straight = (pixels - camera.values[2:4]) / camera.values[:2]
    if camera.lens == "fisheye":
        straight *= _WIDEST / np.linalg.norm(straight, axis=1, keepdims=True)
    rays[missing] = np.column_stack([straight, np.ones(len(pixels))])[missing]
    return rays


def _border(width: int, height: int) -> Array:
    """Return pixels around an image, from its upper left corner over the upper right one, shape (4 `_PARTS`, 2)."""
    low, right, lower = -0.5, width - 0.5, height - 0.5
    corners = np.array([[low, low], [right, low], [right, lower], [low, lower]])
    ends = np.roll(corners, -1, axis=0)
    shares = np.arange(_PARTS)[:, None] / _PARTS
    sides = [start + shares * (end - start) for start, end in zip(corners, ends, strict=True)]
    return np.concatenate(sides)


def _board_shapes(e: Evaluation, boards: Sequence[str]) -> dict[str, Shape]:
    """Return each board that images show: its corners as designed on a plate that is one square wider all around."""
    points = e.measurements.board_points
    assert points is not None
    names = np.array(boards)
    shapes = {}
    for board in dict.fromkeys(boards):
        corners = np.unique(points[names == board], axis=0)
        low, high = corners.min(axis=0), corners.max(axis=0)
        steps = np.diff(np.unique(corners[:, 0].round(6)))
        margin = float(steps.min()) if len(steps) else 0.0
        size = high - low + 2.0 * margin
        middle = 0.5 * (low + high)
        shapes[board] = Shape(
            lines=np.zeros((0, 2, 3)),
            points=corners,
            edges=np.array([size[0], size[1], _THICKNESS]),
            # z points into the board, which is below its corners.
            T_shape_body=translation([middle[0], middle[1], 0.6 * _THICKNESS]),
        )
    return shapes


def _standing(first: Evaluation, last: Evaluation, shapes: Mapping[str, Shape]) -> list[Standing]:
    """Place what stands in the bases of both robots."""
    result = []
    for name, shape in shapes.items():
        poses = [e.setup.T_frame_base[e.setup.groups.index(name)] for e in (first, last)]
        result.append(Standing(shape, rigid_inverse(np.array(poses))))
    return result


def _corners_of(
    first: Evaluation, last: Evaluation, rows: Integers, camera: Camera
) -> ImageCorners:
    """Return the corners of one image; ``rows`` are their indices in the table, from 0."""
    m = first.measurements
    pixels = np.column_stack([m.reading("u"), m.reading("v")])
    residual = np.array([first.residual[rows, :2], last.residual[rows, :2]])
    return ImageCorners((camera.width, camera.height), pixels[rows], residual)
