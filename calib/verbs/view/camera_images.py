"""Cameras, boards and images on a page: frustums and boards in the scene, and the corners of each image.

The robot carries the camera or the board, at its target; the other one stands still in the base's frame.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import meshcat
import numpy as np
from meshcat import geometry as mc

from calib.basics.arrays import Array, Integers, rigid_inverse
from calib.camera.camera import Camera
from calib.camera.lenses import LENSES
from calib.show.look import INK
from calib.show.measured_rows import setup_of_rows
from calib.show.scene.html_page import COLOURS, LegendEntry, floats
from calib.show.scene.posed_robot import PosedRobot, translation
from calib.show.scene.scene import SCENE, Scene, draw_cloud, draw_lines
from calib.verbs.evaluate.evaluation import Evaluation

#: Depth of a frustum, as a fraction of the typical distance between board and camera.
_DEPTH = 0.5

#: Edges of a camera's body, as fractions of the depth of its frustum; the optical centre is in the middle of its front.
_BODY = np.array([0.26, 0.18, 0.2])

#: Thickness of a board [m].
_THICKNESS = 0.003

#: Parts into which an edge of the image is divided, because distortion bends it.
_PARTS = 8

#: Largest slope of a line of sight that is drawn: a fisheye lens also sees sideways.
_WIDEST = 1.7

#: Focal length of a camera with unknown intrinsics, over the width of its images.
_FOCAL = 0.8

#: Node of what stands still, below that of each robot, and of what it carries, below that of its target.
_STANDING = "standing"
_CARRIED = "sight"

#: Colours of the body of a camera and of a board.
_CAMERA_COLOUR = 0x2B3440
_BOARD_COLOUR = 0xF7F8FA

#: Edge of the dot at a board's corner, as a fraction of the board's longer side.
_DOT = 0.02

#: Displacements of corners are magnified until the nominal robot's typical one is this fraction of the image's width.
_DISPLACEMENT = 0.06


class Shape(NamedTuple):
    """A camera or a board in its own frame: z points from the camera along its line of sight, or into the board."""

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


class ImageCorners(NamedTuple):
    """The n corners of one board in one image."""

    #: Width and height of the image [px]
    size: tuple[int, int]
    #: shape (n, 2), positions at which they were found [px]
    measured: Array
    #: shape (2, n, 2), residuals of both robots, measured minus predicted [px]
    residual: Array


class CameraImages(NamedTuple):
    """The cameras and boards of a page, and the images of its steps."""

    #: The camera or board that the robot carries at its target
    carried: Shape
    #: The cameras or boards that stand still, each with its pose in the base of each robot, as fitted with it, shape
    #: (2, 4, 4) [m]
    standing: tuple[tuple[Shape, Array], ...]
    #: The corners of each step's image
    corners: tuple[ImageCorners, ...]

    @property
    def outline(self) -> Array:
        """Points that enclose what stands still, shape (n, 3), in the base of either robot [m]."""
        points = [np.zeros((0, 3))]
        for shape, T_base_shape in self.standing:
            points += [shape.outline @ T[:3, :3].T + T[:3, 3] for T in T_base_shape]
        return np.concatenate(points)

    def at(self, steps: Integers) -> CameraImages:
        """Return the same with some of the steps, by their indices from 0."""
        return self._replace(corners=tuple(self.corners[k] for k in steps.tolist()))


def camera_images(
    first: Evaluation,
    last: Evaluation,
    rows: Sequence[Integers],
    cameras: Mapping[str, Camera],
    *,
    carries_camera: bool,
) -> CameraImages | None:
    """Return the cameras, boards and images of steps.

    Args:
        first: The first robot's residuals, seen from its root, see `calib.verbs.view.steps.seen_from_root`.
        last: The second robot's, or again the first's.
        rows: Of each step, the indices of its rows in the table, from 0.
        cameras: The cameras by their stations; ``""`` for the only one.
        carries_camera: Whether cameras are the targets, and boards the frames; else the other way round.

    Returns:
        What the robot carries, what stands still with its pose in the base of each robot, and the corners of each
        step's image; None if the cameras are unknown, or if no step is an image.
    """
    m = first.measurements
    begins = np.zeros(len(m), dtype=bool)
    begins[[int(of_step[0]) for of_step in rows]] = True
    one_each = m.select(begins)
    if not cameras or not np.any(one_each.is_image):
        return None
    T_frame_base, T_tip_target = setup_of_rows(last.setup, one_each)
    T_base_tip = last.robot.poses(one_each.joints_for(last.robot.joint_names))
    T_frame_target = T_frame_base @ T_base_tip @ T_tip_target
    distance = float(np.median(np.linalg.norm(T_frame_target[:, :3, 3], axis=1)))

    # The camera of a station is its own, else the one without a name, else any.
    stations = m.targets if carries_camera else m.groups
    camera_of = {}
    for station in dict.fromkeys(stations):
        names = (station, "", *cameras)
        camera_of[station] = next(cameras[name] for name in names if name in cameras)
    frustums = {name: frustum(camera, _DEPTH * distance) for name, camera in camera_of.items()}
    boards = _board_shapes(last, m.groups if carries_camera else m.targets)
    carried, standing = (frustums, boards) if carries_camera else (boards, frustums)

    placed = []
    for name, shape in standing.items():
        poses = [e.setup.T_frame_base[e.setup.groups.index(name)] for e in (first, last)]
        placed.append((shape, rigid_inverse(np.array(poses))))

    pixels = np.column_stack([m.reading("u"), m.reading("v")])
    images = []
    for of_step in rows:
        camera = camera_of[stations[int(of_step[0])]]
        residual = np.array([first.residual[of_step, :2], last.residual[of_step, :2]])
        images.append(ImageCorners((camera.width, camera.height), pixels[of_step], residual))
    return CameraImages(next(iter(carried.values())), tuple(placed), tuple(images))


def frustum(camera: Camera, depth: float) -> Shape:
    """Return a camera with what it sees, from the optical centre to a depth.

    Args:
        camera: The camera; if its intrinsics are unknown, it is drawn with a common lens.
        depth: Depth along the line of sight [m].

    Returns:
        The edges of the frustum and the body, in the camera's frame [m].
    """
    # Pixels around the image, from its upper left corner over the upper right one.
    low, right, lower = -0.5, camera.width - 0.5, camera.height - 0.5
    corners = np.array([[low, low], [right, low], [right, lower], [low, lower]])
    ends = np.roll(corners, -1, axis=0)
    shares = np.arange(_PARTS)[:, None] / _PARTS
    sides = [start + shares * (end - start) for start, end in zip(corners, ends, strict=True)]
    rays = _rays(camera, np.concatenate(sides))

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
    """Return the directions in which a camera sees pixels (n, 2), as points at a depth of 1 in it, shape (n, 3).

    Unknown intrinsics are replaced by a common focal length.
    """
    if camera.values is None:
        focal = np.full(2, _FOCAL * camera.width)
        middle = 0.5 * np.array([camera.width, camera.height]) - 0.5
        return np.column_stack([(pixels - middle) / focal, np.ones(len(pixels))])
    lens = LENSES[camera.lens]
    rays = lens.undistort(pixels, camera.values)
    # Far from the measured corners a distortion may have no inverse; a fisheye lens sees sideways there.
    missing = np.linalg.norm(lens.project(rays, camera.values) - pixels, axis=1) > 1.0
    straight = (pixels - camera.values[2:4]) / camera.values[:2]
    if camera.lens == "fisheye":
        straight *= _WIDEST / np.linalg.norm(straight, axis=1, keepdims=True)
    rays[missing] = np.column_stack([straight, np.ones(len(pixels))])[missing]
    return rays


def _board_shapes(e: Evaluation, boards: Sequence[str]) -> dict[str, Shape]:
    """Return the shape of each board in the images by its name: corners as designed, on a plate with a margin.

    ``boards`` names the board of each row of the evaluation; the margin is the least spacing of its corners along x. A
    body of tags is a box around its corners.
    """
    points = e.measurements.board_points
    assert points is not None
    names = np.array(boards)
    shapes = {}
    for board in dict.fromkeys(boards):
        corners = np.unique(points[names == board], axis=0)
        low, high = corners.min(axis=0), corners.max(axis=0)
        steps = np.diff(np.unique(corners[:, 0].round(6)))
        is_flat = not np.any(corners[:, 2])
        margin = float(steps.min()) if is_flat and len(steps) else 0.0
        size = np.maximum(high - low + 2.0 * margin, _THICKNESS)
        middle = 0.5 * (low + high)
        shapes[board] = Shape(
            lines=np.zeros((0, 2, 3)),
            points=corners,
            edges=np.array([size[0], size[1], _THICKNESS if is_flat else size[2]]),
            # z points into the board, so the plate lies at +z, behind the corners.
            T_shape_body=translation(
                [middle[0], middle[1], 0.6 * _THICKNESS if is_flat else middle[2]]
            ),
        )
    return shapes


# On the page


def draw_cameras(
    scene: Scene, shown: Mapping[str, PosedRobot], images: CameraImages
) -> LegendEntry:
    """Draw cameras and boards with each robot, in the robot's colour.

    Args:
        scene: The scene with the robots.
        shown: The robots by ``"nominal"`` and ``"calibrated"``.
        images: The cameras and boards.

    Returns:
        Their entry of the legend.
    """
    nodes = []
    for which, (name, robot) in enumerate(shown.items()):
        group = scene.root[SCENE][name]
        target = f"robot/links/{robot.poses.shape[1] - 1:03d}/{_CARRIED}"
        _draw_shape(group[target], images.carried, COLOURS[name])
        for k, (shape, T_base_shape) in enumerate(images.standing):
            node = group[_STANDING][f"{k:02d}"]
            node.set_transform(T_base_shape[which])
            _draw_shape(node, shape, COLOURS[name])
        nodes += [f"{name}/{target}", f"{name}/{_STANDING}"]
    return LegendEntry("camera and board, as fitted with each robot", INK, " ".join(nodes))


def _draw_shape(node: meshcat.Visualizer, shape: Shape, colour: str) -> None:
    """Draw a camera or a board below a node, with its lines and the edges of its face of least z in a colour.

    The colour is as ``"#rrggbb"``; the body is that of a board if the shape has points.
    """
    is_board = len(shape.points) > 0
    material = mc.MeshPhongMaterial(color=_BOARD_COLOUR if is_board else _CAMERA_COLOUR)
    node["body"].set_object(mc.Box(shape.edges.tolist()), material)
    node["body"].set_transform(shape.T_shape_body)
    # The face of least z: the front of a board, on which its corners are, and the back of a camera.
    half = 0.5 * shape.edges
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    corners = np.column_stack([signs * half[:2], np.full(4, -half[2])]) + shape.T_shape_body[:3, 3]
    edges = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    draw_lines(node["lines"], np.concatenate([shape.lines, edges]), colour)
    if is_board:
        draw_cloud(node["corners"], shape.points, INK, _DOT * float(shape.edges.max()))


def images_table(images: CameraImages | None, factors: tuple[int, ...]) -> dict[str, Any] | None:
    """Return the corners of the images for the script, as values that JSON can hold; None without images.

    Args:
        images: The images, one for each step.
        factors: Magnifications to choose from, in ascending order.

    Returns:
        The size of each image; the indices at which the corners of each image start, and their number; measured corners
        and residuals of both robots as text (see `calib.show.scene.html_page.floats`); the displacements' factor.
    """
    if images is None:
        return None
    counts = [len(image.measured) for image in images.corners]
    residual = np.concatenate([image.residual for image in images.corners], axis=1)
    return {
        "sizes": [list(image.size) for image in images.corners],
        "starts": np.cumsum([0, *counts]).tolist(),
        "measured": floats(np.concatenate([image.measured for image in images.corners])),
        "nominal": floats(residual[0]),
        "calibrated": floats(residual[1]),
        "factor": displacement_factor(images, factors),
    }


def displacement_factor(images: CameraImages, factors: tuple[int, ...]) -> int:
    """Choose the factor of the corners' displacements: the largest with which the nominal robot's stay short.

    Args:
        images: The images.
        factors: Those to choose from, in ascending order.

    Returns:
        One of the factors: with it the median displacement is at most a fixed fraction of the images' width; 1 if none
        is that small.
    """
    lengths = np.concatenate([np.linalg.norm(i.residual[0], axis=1) for i in images.corners])
    typical = float(np.median(lengths))
    width = max(image.size[0] for image in images.corners)
    short = [factor for factor in factors if factor * typical <= _DISPLACEMENT * width]
    return max(short, default=1)
