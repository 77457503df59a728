"""Cameras and boards in the scene of a page of robots, and the corners of its images for the page's script."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import meshcat
import numpy as np
from meshcat import geometry as mc

from calib.basics.arrays import Array
from calib.show.look import INK
from calib.show.scene.html_page import COLOURS, Key, floats
from calib.show.scene.puppet import Puppet
from calib.show.scene.scene import SCENE as ROBOTS, Scene, draw_cloud, draw_lines
from calib.verbs.view.sight import Shape, Sight

#: Node of what stands, below that of each robot, and of what it carries, below that of its target.
_STANDING = "standing"
_CARRIED = "sight"

#: Colours of the body of a camera and of a board.
_CAMERA_COLOUR = 0x2B3440
_BOARD_COLOUR = 0xF7F8FA

#: Edge of the dot at a board's corner, as a part of the board's longer side.
_DOT = 0.02

#: Displacements of corners are magnified until the nominal robot's typical one is this part of the image's width.
_DISPLACEMENT = 0.06


def draw_sight(scene: Scene, shown: Mapping[str, Puppet], sight: Sight) -> Key:
    """Draw cameras and boards with each robot, in the robot's colour; return their entry of the legend.

    Args:
        scene: The scene with the robots.
        shown: The robots by ``"nominal"`` and ``"calibrated"``.
        sight: The cameras and boards.
    """
    nodes = []
    for which, (name, puppet) in enumerate(shown.items()):
        group = scene.root[ROBOTS][name]
        target = f"robot/links/{puppet.poses.shape[1] - 1:03d}/{_CARRIED}"
        _draw_shape(group[target], sight.carried, COLOURS[name])
        for k, (shape, T_base_shape) in enumerate(sight.standing):
            node = group[_STANDING][f"{k:02d}"]
            node.set_transform(T_base_shape[which])
            _draw_shape(node, shape, COLOURS[name])
        nodes += [f"{name}/{target}", f"{name}/{_STANDING}"]
    return Key("camera and board, as fitted with each robot", INK, " ".join(nodes))


def _draw_shape(node: meshcat.Visualizer, shape: Shape, colour: str) -> None:
    """Draw a camera or a board below a node, its lines in a colour, ``"#rrggbb"``."""
    is_board = len(shape.points) > 0
    material = mc.MeshPhongMaterial(color=_BOARD_COLOUR if is_board else _CAMERA_COLOUR)
    node["body"].set_object(mc.Box(shape.edges.tolist()), material)
    node["body"].set_transform(shape.T_shape_body)
    draw_lines(node["lines"], np.concatenate([shape.lines, _face(shape)]), colour)
    if is_board:
        draw_cloud(node["corners"], shape.points, INK, _DOT * float(shape.edges.max()))


def _face(shape: Shape) -> Array:
    """Return the edges of the front of a body, the face of least z, shape (4, 2, 3) [m]."""
    half = 0.5 * shape.edges
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    corners = np.column_stack([signs * half[:2], np.full(4, -half[2])]) + shape.T_shape_body[:3, 3]
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def images_table(sight: Sight | None, factors: tuple[int, ...]) -> dict[str, Any] | None:
    """Return the corners of the images for the script, as values that JSON can hold; None without images.

    Args:
        sight: The images, one for each step.
        factors: What displacements may be magnified by, in ascending order.

    Returns:
        The size of each image, the index of its first corner and that behind its last one, measured corners and
        residuals of both robots as text (see `calib.show.scene.html_page.floats`), and the factor of the displacements.
    """
    if sight is None:
        return None
    counts = [len(image.measured) for image in sight.images]
    residual = np.concatenate([image.residual for image in sight.images], axis=1)
    return {
        "sizes": [list(image.size) for image in sight.images],
        "starts": np.cumsum([0, *counts]).tolist(),
        "measured": floats(np.concatenate([image.measured for image in sight.images])),
        "nominal": floats(residual[0]),
        "calibrated": floats(residual[1]),
        "factor": displacement_factor(sight, factors),
    }


def displacement_factor(sight: Sight, factors: tuple[int, ...]) -> int:
    """Choose the factor of the corners' displacements: the largest with which the nominal robot's stay short.

    Args:
        sight: The images.
        factors: Those to choose from, in ascending order.
    """
    lengths = np.concatenate([np.linalg.norm(i.residual[0], axis=1) for i in sight.images])
    typical = float(np.median(lengths))
    width = max(image.size[0] for image in sight.images)
    short = [factor for factor in factors if factor * typical <= _DISPLACEMENT * width]
    return max(short, default=1)
