"""What stands in a scene beside robots: balls, dots, clouds of points, lines."""

from __future__ import annotations

from collections.abc import Sequence

import meshcat
import numpy as np
from meshcat import geometry as mc
from numpy.typing import ArrayLike, NDArray

from calib.show.bodies import Body
from calib.show.stage import mesh_geometry, translation
from calib.show.window import without_shadow

Array = NDArray[np.float64]

#: More points than this are one cloud of dots.
_MOST_BALLS = 300


def draw_bodies(scene: meshcat.Visualizer, parts: Sequence[Body], colour: str) -> mc.Material:
    """A robot's shapes in one colour.

    Args:
        scene: The node that they go below.
        parts: The shapes.
        colour: As CSS has it.

    Returns:
        What they are painted with.
    """
    material = mc.MeshPhongMaterial(color=number(colour), shininess=35, specular=0x2A2A2A, side=2)
    for i, body in enumerate(parts):
        shape, T_shape_mesh = mesh_geometry(body.shape)
        scene[f"{i:03d}"].set_object(shape, material)
        scene[f"{i:03d}"].set_transform(body.T_base_shape @ T_shape_mesh)
    return material


def draw_points(node: meshcat.Visualizer, points: Array, colour: str, radius: float) -> None:
    """Points as balls, or as dots where they are many; without shadows.

    Args:
        node: The node that they go below.
        points: shape (N, 3), [m].
        colour: As CSS has it.
        radius: Of a ball [m].
    """
    if len(points) > _MOST_BALLS:
        node["dots"].set_object(cloud(points, colour, 1.2 * radius))
        without_shadow(node["dots"])
        return
    ball, material = mc.Sphere(radius), mc.MeshPhongMaterial(color=number(colour))
    for i, point in enumerate(points):
        node[f"{i:03d}"].set_object(ball, material)
        without_shadow(node[f"{i:03d}"])
        node[f"{i:03d}"].set_transform(translation(point))


def draw_lines(node: meshcat.Visualizer, ends: Array, colour: str, opacity: float = 1.0) -> None:
    """Straight lines, without shadows.

    Args:
        node: Where they go.
        ends: shape (N, 2, 3), [m].
        colour: As CSS has it.
        opacity: From 0 to 1.
    """
    material = mc.LineBasicMaterial(color=number(colour), opacity=opacity, transparent=opacity < 1)
    node.set_object(mc.LineSegments(mc.PointsGeometry(ends.reshape(-1, 3).T), material))
    without_shadow(node)


def cloud(points: ArrayLike, colour: str, edge: float) -> mc.Object:
    """Dots of one colour.

    Args:
        points: shape (N, 3), [m].
        colour: As CSS has it.
        edge: Of a dot [m].
    """
    at = np.asarray(points, dtype=np.float32).T
    rgb = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)], dtype=np.float32) / 255
    return mc.PointCloud(at, np.repeat(rgb[:, None], at.shape[1], axis=1), size=edge)


def number(colour: str) -> int:
    """A colour as meshcat takes it."""
    return int(colour[1:], 16)
