"""What stands in a scene: the stage with its lights, floor and camera, robots, and marks about them; z is up."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import meshcat
import numpy as np
from meshcat import geometry as mc
from numpy.typing import ArrayLike, NDArray

from calib.model.files import write_atomically
from calib.show.camera import Camera
from calib.show.puppet import Puppet, rod_between
from calib.show.shapes import Box, Cylinder, Shape, Triangles
from calib.show.window import (
    KeyLight,
    PackedGeometry,
    SceneWindow,
    ShadowMaterial,
    without_shadow,
)

Array = NDArray[np.float64]

#: The scene's node that holds the robots.
SCENE = "robots"

#: More points than this are one cloud of dots.
_MOST_BALLS = 300

#: Radius of the rod to the target, as a part of its ball's.
_STALK = 0.3

#: three.js turns cylinders about y, URDF about z.
_Y_TO_Z = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])


@dataclass(frozen=True, slots=True)
class Page:
    """A complete HTML page.

    Attributes:
        html: The file's bytes, UTF-8.
        warnings: What could not be drawn as the URDF says, a sentence each; the page lists them too.
    """

    html: bytes = field(repr=False)
    warnings: tuple[str, ...]

    def write(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
        """Write the page, whole or not at all; it opens from disk without a network.

        Raises:
            FileError: The file exists and ``overwrite`` is False, or it cannot be written.
        """
        return write_atomically(path, self.html, overwrite=overwrite)


def new_scene() -> tuple[SceneWindow, meshcat.Visualizer]:
    """An empty scene, and meshcat's visualizer of all of it."""
    window = SceneWindow()
    return window, meshcat.Visualizer.view_into(window, meshcat.path.Path())


def draw_stage(
    root: meshcat.Visualizer,
    camera: Camera,
    *,
    size: float,
    floor: float,
    grid: float,
    through: Array,
) -> None:
    """Camera, lights, background, floor and grid; the scene's origin is what the camera looks at.

    Args:
        root: The whole scene.
        camera: From where it is seen.
        size: Of what is drawn [m].
        floor: Height of the floor in the frame of the camera's centre [m].
        grid: Edge of a square of the floor [m].
        through: shape (3,), a point above which a line of the grid passes [m].
    """
    root["/Background"].set_property("top_color", [0.985, 0.99, 1.0])
    root["/Background"].set_property("bottom_color", [0.86, 0.885, 0.915])
    for name in ("/Grid", "/Axes"):
        root[name].set_property("visible", False)
    for light in ("PointLightNegativeX", "PointLightPositiveX"):
        root[f"/Lights/{light}/<object>"].set_property("visible", False)
    towards, right = camera.axes[2], camera.axes[0]
    fill = root["/Lights/FillLight/<object>"]
    root["/Lights/AmbientLight/<object>"].set_property("intensity", 0.52)
    fill.set_property("intensity", 0.22)
    fill.set_property("position", (20 * size * (towards + 1.2 * right)).tolist())
    above = np.array([0.0, 0.0, 1.0])
    key = KeyLight(1.1 * above + 0.55 * towards - 0.55 * right, camera.radius, 0.5)
    root["/Lights/Key"].set_object(key)
    lens = mc.PerspectiveCamera(fov=camera.fov_deg, aspect=16 / 9, near=0.02 * size, far=100 * size)
    root["/Cameras/default/rotated"].set_object(lens)
    root["/Cameras/default/rotated/<object>"].set_property("position", camera.position)

    floor = floor - camera.centre[2]
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * 30.0 * size
    plane = mc.TriangularMeshGeometry(corners, np.array([[0, 1, 2], [0, 2, 3]]))
    root["/Floor/shadow"].set_object(mc.Mesh(plane, ShadowMaterial(0.17)))
    root["/Floor/shadow"].set_transform(translation([0, 0, floor - 0.002 * size]))
    draw_lines(root["/Floor/grid"], _grid_lines(grid, 1.15 * camera.radius), "#9aa7b4", 0.42)
    # A line of the grid passes through the base of the robot in the middle.
    shift = np.remainder(through - camera.centre, grid)
    root["/Floor/grid"].set_transform(translation([shift[0], shift[1], floor - 0.001 * size]))


def draw_puppet(
    group: meshcat.Visualizer, puppet: Puppet, pose: int, colour: str, ball: float, *, front: bool
) -> None:
    """One robot at a pose, each part below its mover, with its target and the rod that carries it.

    Args:
        group: The node that it goes below.
        puppet: The robot.
        pose: The pose's number.
        colour: As CSS has it.
        ball: Radius of the target's ball [m]; 0 for none.
        front: Whether it is drawn a little towards the eye. Where one robot is laid over the other, surfaces a fraction
            of a millimetre apart would flicker otherwise.
    """
    at, robot, material = puppet.poses[pose], group["robot"], solid(colour, front=front)
    for mover in sorted({part.mover for part in puppet.parts}):
        robot["links"][f"{mover:03d}"].set_transform(at[mover])
    for i, part in enumerate(puppet.parts):
        node = robot["links"][f"{part.mover:03d}"][f"{i:03d}"]
        shape, T_shape_mesh = _geometry(part.shape)
        node.set_object(shape, material)
        node.set_transform(part.T_mover_shape @ T_shape_mesh)
    target = len(at) - 1
    rods = [(*rod, puppet.radius) for rod in puppet.rods]
    if ball:
        robot["links"][f"{target:03d}"].set_transform(at[target])
        robot["links"][f"{target:03d}"]["ball"].set_object(mc.Sphere(ball), material)
        rods.append((target - 1, target, _STALK * ball))
    for k, (one, other, radius) in enumerate(rods):
        node = robot["rods"][f"{k:03d}"]
        T, length = rod_between(at[one, :3, 3], at[other, :3, 3])
        # A rod of length one, stretched: the page's script does the same at every other pose.
        node.set_transform(T @ np.diag([1.0, 1.0, max(length, 1e-9), 1.0]))
        shape, T_shape_mesh = _geometry(Cylinder(radius, 1.0))
        node["rod"].set_object(shape, material)
        node["rod"].set_transform(T_shape_mesh)


def draw_points(node: meshcat.Visualizer, points: Array, colour: str, radius: float) -> None:
    """Points as balls, or as dots where they are many; without shadows.

    Args:
        node: The node that they go below.
        points: shape (N, 3), [m].
        colour: As CSS has it.
        radius: Of a ball [m].
    """
    if len(points) > _MOST_BALLS:
        draw_cloud(node["dots"], points, colour, 1.2 * radius)
        return
    ball, material = mc.Sphere(radius), mc.MeshPhongMaterial(color=number(colour))
    for i, point in enumerate(points):
        node[f"{i:03d}"].set_object(ball, material)
        without_shadow(node[f"{i:03d}"])
        node[f"{i:03d}"].set_transform(translation(point))


def draw_cloud(node: meshcat.Visualizer, points: ArrayLike, colour: str, edge: float) -> None:
    """Points of shape (N, 3) as dots of one colour with an edge [m], without shadows."""
    at = np.asarray(points, dtype=np.float32).T
    rgb = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)], dtype=np.float32) / 255
    node.set_object(mc.PointCloud(at, np.repeat(rgb[:, None], at.shape[1], axis=1), size=edge))
    without_shadow(node)


def draw_lines(node: meshcat.Visualizer, ends: Array, colour: str, opacity: float = 1.0) -> None:
    """Straight lines with ends of shape (N, 2, 3) or (2 N, 3) [m], without shadows."""
    material = mc.LineBasicMaterial(color=number(colour), opacity=opacity, transparent=opacity < 1)
    node.set_object(mc.LineSegments(mc.PointsGeometry(ends.reshape(-1, 3).T), material))
    without_shadow(node)


def draw_boxes(
    node: meshcat.Visualizer, sizes: Sequence[Array], poses: Sequence[Array], colour: str
) -> None:
    """Translucent boxes of some sizes at some poses, without shadows [m]."""
    for i, (size, T) in enumerate(zip(sizes, poses, strict=True)):
        material = mc.MeshPhongMaterial(color=number(colour), opacity=0.35, transparent=True)
        node[f"{i:02d}"].set_object(mc.Box(size.tolist()), material)
        without_shadow(node[f"{i:02d}"])
        node[f"{i:02d}"].set_transform(T)


def solid(colour: str, *, front: bool = False) -> mc.MeshPhongMaterial:
    """The surface of a robot; see `draw_puppet`."""
    more = {"polygonOffset": 1, "polygonOffsetFactor": -1.0, "polygonOffsetUnits": -4.0}
    look = {"color": number(colour), "shininess": 35, "specular": 0x2A2A2A, "side": 2}
    return mc.MeshPhongMaterial(**look, **(more if front else {}))


def number(colour: str) -> int:
    """A colour as meshcat takes it."""
    return int(colour[1:], 16)


def translation(offset: ArrayLike) -> Array:
    """A pose without rotation, shape (4, 4)."""
    T = np.eye(4)
    T[:3, 3] = offset
    return T


def _geometry(shape: Shape) -> tuple[mc.Geometry, Array]:
    """The form that meshcat has of a shape, and its pose in the shape."""
    if isinstance(shape, Triangles):
        return PackedGeometry(shape), np.eye(4)
    if isinstance(shape, Box):
        return mc.Box(list(shape.size)), np.eye(4)
    if isinstance(shape, Cylinder):
        return mc.Cylinder(shape.length, shape.radius), _Y_TO_Z
    return mc.Sphere(shape.radius), np.eye(4)


def _grid_lines(step: float, radius: float) -> Array:
    """Start and end points of a square grid cut to a disc, shape (2 K, 3), [m]."""
    at = step * np.arange(-int(radius / step), int(radius / step) + 1)
    half = np.sqrt(radius**2 - at**2)
    ends = [[x, side * h, 0.0] for x, h in zip(at, half, strict=True) for side in (-1, 1)]
    along_y = np.array(ends)
    return np.concatenate([along_y, along_y[:, [1, 0, 2]]])
