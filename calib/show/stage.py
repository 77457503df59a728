"""What a scene stands on and is seen with: lights, floor, camera, and the forms that meshcat has of shapes."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

import meshcat
import numpy as np
from meshcat import geometry as mc
from numpy.typing import ArrayLike, NDArray

from calib.model.files import write_atomically
from calib.model.robot import Robot
from calib.show.bodies import link_poses
from calib.show.camera import Camera
from calib.show.triangles import Triangles
from calib.show.visuals import Box, Cylinder, Shape
from calib.show.window import KeyLight, PackedGeometry, ShadowMaterial, without_shadow

Array = NDArray[np.float64]

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
        """Write the page, whole or not at all.

        Raises:
            FileError: The file exists and ``overwrite`` is False, or it cannot be written.
        """
        return write_atomically(path, self.html, overwrite=overwrite)


def upright_pose(robot: Robot, q: Array) -> Array:
    """How the base frame is turned so that the root's z is up, shape (4, 4); not at all where the base stands still."""
    T = np.eye(4)
    if robot.base_moves:
        T[:3, :3] = link_poses(robot, q)[robot.urdf.root][:3, :3].T
    return T


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
    root["/Lights/AmbientLight/<object>"].set_property("intensity", 0.52)
    root["/Lights/FillLight/<object>"].set_property("intensity", 0.22)
    root["/Lights/FillLight/<object>"].set_property(
        "position", (20 * size * (towards + 1.2 * right)).tolist()
    )
    above = np.array([0.0, 0.0, 1.0])
    key = KeyLight(1.1 * above + 0.55 * towards - 0.55 * right, camera.radius, 0.5)
    root["/Lights/Key"].set_object(key)
    lens = mc.PerspectiveCamera(fov=camera.fov_deg, aspect=16 / 9, near=0.02 * size, far=100 * size)
    root["/Cameras/default/rotated"].set_object(lens)
    # The camera lives in a frame with y up; its target is the origin.
    x, y, z = camera.position
    root["/Cameras/default/rotated/<object>"].set_property("position", [x, z, -y])

    floor = floor - camera.centre[2]
    reach = 30.0 * size
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * reach
    plane = mc.TriangularMeshGeometry(corners, np.array([[0, 1, 2], [0, 2, 3]]))
    root["/Floor/shadow"].set_object(mc.Mesh(plane, ShadowMaterial(0.17)))
    root["/Floor/shadow"].set_transform(translation([0, 0, floor - 0.002 * size]))
    lines = _grid_lines(grid, 1.15 * camera.radius)
    material = mc.LineBasicMaterial(color=0x9AA7B4, opacity=0.42)
    root["/Floor/grid"].set_object(mc.LineSegments(mc.PointsGeometry(lines.T), material))
    without_shadow(root["/Floor/grid"])
    # A line of the grid passes through the base of the robot in the middle.
    shift = np.remainder(through - camera.centre, grid)
    root["/Floor/grid"].set_transform(translation([shift[0], shift[1], floor - 0.001 * size]))


def mesh_geometry(shape: Shape) -> tuple[mc.Geometry, Array]:
    """The form that meshcat has of a shape, and its pose in the shape."""
    if isinstance(shape, Triangles):
        return PackedGeometry(shape), np.eye(4)
    if isinstance(shape, Box):
        return mc.Box(list(shape.size)), np.eye(4)
    if isinstance(shape, Cylinder):
        return mc.Cylinder(shape.length, shape.radius), _Y_TO_Z
    return mc.Sphere(shape.radius), np.eye(4)


def translation(offset: ArrayLike) -> Array:
    """A pose without rotation, shape (4, 4)."""
    T = np.eye(4)
    T[:3, 3] = offset
    return T


def _grid_lines(step: float, radius: float) -> Array:
    """Start and end points of a square grid cut to a disc, shape (2 K, 3), [m]."""
    at = step * np.arange(-int(radius / step), int(radius / step) + 1)
    half = np.sqrt(radius**2 - at**2)
    along_y = [[x, side * h, 0.0] for x, h in zip(at, half, strict=True) for side in (-1, 1)]
    along_x = [[side * h, y, 0.0] for y, h in zip(at, half, strict=True) for side in (-1, 1)]
    return np.array(along_y + along_x)
