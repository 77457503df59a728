"""A scene of meshcat: the stage with lights, floor and camera, robots, and marks about them; z is up.

meshcat's own window starts a server in another process, whose web port listens on all addresses. `SceneWindow` opens no
socket: it stores the same commands in meshcat's own tree, and the page carries meshcat's viewer and the commands.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import meshcat
import numpy as np
import umsgpack
from meshcat import geometry as mc
from meshcat.servers.tree import SceneTree, find_node, walk
from numpy.typing import ArrayLike, NDArray

from calib.files import write_atomically
from calib.viewer.shapes import Puppet, rod_between

Array = NDArray[np.float64]

#: The scene's node that holds the robots.
SCENE = "robots"

#: Vertical angle of view [deg]: a long lens, so that robots at the side are not distorted.
FOV_DEG = 28.0

#: How far the camera looks down [rad], and the part of the picture's half width for the scene.
_DOWN, _WIDTH = np.deg2rad(16.0), 0.95

#: More points than this are one cloud of dots.
_MOST_BALLS = 300

#: Radius of the rod to the target, as a part of its ball's.
_STALK = 0.3

#: three.js turns cylinders about y, URDF about z.
_Y_TO_Z = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])


@dataclass(frozen=True, slots=True)
class Page:
    """A complete HTML page, UTF-8, and what could not be drawn as the URDF says, a sentence each."""

    html: bytes = field(repr=False)
    warnings: tuple[str, ...]

    def write(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
        """Write the page, whole or not at all; `FileError` where the file exists or cannot be written."""
        return write_atomically(path, self.html, overwrite=overwrite)


class SceneWindow:
    """The scene tree, for ``meshcat.Visualizer(window=...)``.

    meshcat's identifiers hold the time and this computer's network address; here they follow from the content, so
    that the same scene is the same bytes and a mesh that is drawn four times is stored once.
    """

    def __init__(self) -> None:
        self._tree = SceneTree()
        self._geometries: dict[str, dict[str, Any]] = {}

    def send(self, command: Any) -> None:  # noqa: ANN401  a command of meshcat
        """Take a command, as meshcat's server does."""
        message = command.lower()
        path = [part for part in message["path"].split("/") if part]
        node = find_node(self._tree, path)
        if message["type"] == "set_object":
            self._share(message["object"], message["path"])
            node.object, node.properties = message, []
        elif message["type"] == "set_transform":
            node.transform = message
        else:
            node.properties.append(message)

    def scene(self) -> bytes:
        """The whole scene as one message: the geometries by name, and the commands in order."""
        commands = []
        for node in walk(self._tree):
            found = [node.object, *node.properties, node.transform]
            commands += [command for command in found if command]
        packed: bytes = umsgpack.packb({"geometries": self._geometries, "commands": commands})
        return packed

    def _share(self, lowered: dict[str, Any], path: str) -> None:
        """Name everything by its content or path, and keep the geometries apart."""
        names = []
        for geometry in lowered.get("geometries", []):
            del geometry["uuid"]
            name = hashlib.sha256(umsgpack.packb(geometry)).hexdigest()[:32]
            self._geometries.setdefault(name, {"uuid": name, **geometry})
            names.append(name)
        for material in lowered.get("materials", []):
            material["uuid"] = f"material of {path}"
        lowered["object"]["uuid"] = f"object of {path}"
        if names:
            lowered["geometries"] = names
            lowered["object"]["geometry"] = names[0]
            lowered["object"]["material"] = lowered["materials"][0]["uuid"]


class ShadowMaterial(mc.GenericMaterial):  # type: ignore[misc]
    """A surface that shows the shadows on it and nothing else."""

    _type = "ShadowMaterial"


def new_scene() -> tuple[SceneWindow, meshcat.Visualizer]:
    """An empty scene, and meshcat's visualizer of all of it."""
    window = SceneWindow()
    return window, meshcat.Visualizer.view_into(window, meshcat.path.Path())


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """A camera at a distance of a centre [m], and a radius about the centre that it holds [m].

    The rows of ``axes`` of shape (3, 3) point right, up and towards the camera.
    """

    centre: Array
    axes: Array
    distance: float
    radius: float

    @property
    def position(self) -> list[float]:
        """Where it stands, from the centre, in meshcat's frame of cameras, in which y is up [m]."""
        x, y, z = (float(value) for value in self.distance * self.axes[2])
        return [x, z, -y]


def row_direction(points: Array) -> Array:
    """A horizontal direction to look from in which an arm with joints at points spreads out, shape (3,)."""
    flat = points[:, :2] - points[:, :2].mean(axis=0)
    _, values, axes = np.linalg.svd(flat, full_matrices=True)
    spread = axes[0] if values[0] > 0 else np.array([0.0, 1.0])
    # The arm reaches to the right of the picture and a little towards the camera.
    outward = points[-1, :2] - points[0, :2]
    x, y = spread if spread @ outward >= 0 else -spread
    angle = np.arctan2(y, x) - np.deg2rad(68.0)
    return np.array([np.cos(angle), np.sin(angle), 0.0])


def look_at(points: Array, back: Array, between: tuple[float, float] = (-0.69, 0.75)) -> Camera:
    """The nearest camera that sees all points of shape (N, 3) where no text stands, on a 16:9 screen.

    ``back`` is a horizontal unit vector from the scene to the camera; text at the foot ends and that of the heading
    begins at ``between``, the picture being from -1 to 1.
    """
    lower, upper = np.array([-_WIDTH, between[0]]), np.array([_WIDTH, between[1]])
    towards = np.cos(_DOWN) * back + np.sin(_DOWN) * np.array([0.0, 0.0, 1.0])
    right = np.array([-back[1], back[0], 0.0])
    axes = np.stack([right, np.cross(towards, right), towards])
    seen = points @ axes.T
    half = np.tan(0.5 * np.deg2rad(FOV_DEG)) * np.array([16.0 / 9.0, 1.0])
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


def draw_stage(
    root: meshcat.Visualizer, camera: Camera, *, size: float, floor: float, grid: float
) -> None:
    """Camera, lights, background, floor and grid; the scene's origin is what the camera looks at.

    ``size`` is that of what is drawn, ``floor`` the height of the floor in the frame of the camera's centre, ``grid``
    the edge of a square of it [m].
    """
    towards, right, radius = camera.axes[2], camera.axes[0], camera.radius
    lens = mc.PerspectiveCamera(fov=FOV_DEG, aspect=16 / 9, near=0.02 * size, far=100 * size)
    root["/Cameras/default/rotated"].set_object(lens)
    fill = (20 * size * (towards + 1.2 * right)).tolist()
    for node, name, value in (
        ("/Background", "top_color", [0.985, 0.99, 1.0]),
        ("/Background", "bottom_color", [0.86, 0.885, 0.915]),
        ("/Grid", "visible", False),
        ("/Axes", "visible", False),
        ("/Lights/PointLightNegativeX/<object>", "visible", False),
        ("/Lights/PointLightPositiveX/<object>", "visible", False),
        ("/Lights/AmbientLight/<object>", "intensity", 0.52),
        ("/Lights/FillLight/<object>", "intensity", 0.22),
        ("/Lights/FillLight/<object>", "position", fill),
        ("/Cameras/default/rotated/<object>", "position", camera.position),
    ):
        root[node].set_property(name, value)
    # A light from far away that casts shadows within a sphere about the scene's origin.
    sun = 1.1 * np.array([0.0, 0.0, 1.0]) + 0.55 * towards - 0.55 * right
    far = translation(3.0 * radius * sun / np.linalg.norm(sun)).T.ravel().tolist()
    box = {"left": -radius, "right": radius, "top": radius, "bottom": -radius}
    ends = {"near": 1.5 * radius, "far": 4.5 * radius, "zoom": 1.0}
    eye = {"uuid": "shadow camera", "type": "OrthographicCamera", **box, **ends}
    shadow = {"bias": -3e-4, "normalBias": 2e-3 * radius, "mapSize": [4096, 4096], "camera": eye}
    light = {"uuid": "", "type": "DirectionalLight", "color": 0xFFFFFF, "intensity": 0.5}
    lowered = {
        "metadata": {"version": 4.5, "type": "Object"},
        "object": {**light, "matrix": far, "shadow": shadow},
    }
    _send(root["/Lights/Key"], {"type": "set_object", "object": lowered})

    floor = floor - camera.centre[2]
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * 30.0 * size
    plane = mc.TriangularMeshGeometry(corners, np.array([[0, 1, 2], [0, 2, 3]]))
    dark = ShadowMaterial(color=0x1B2733, opacity=0.17, transparent=True, side=0, depthWrite=False)
    root["/Floor/shadow"].set_object(mc.Mesh(plane, dark))
    root["/Floor/shadow"].set_transform(translation([0, 0, floor - 0.002 * size]))
    # A square grid cut to a disc.
    at = grid * np.arange(-int(1.15 * radius / grid), int(1.15 * radius / grid) + 1)
    half = np.sqrt((1.15 * radius) ** 2 - at**2)
    across = np.array(
        [[x, side * h, 0.0] for x, h in zip(at, half, strict=True) for side in (-1, 1)]
    )
    draw_lines(root["/Floor/grid"], np.concatenate([across, across[:, [1, 0, 2]]]), "#9aa7b4", 0.42)
    root["/Floor/grid"].set_transform(translation([0, 0, floor - 0.001 * size]))


def without_shadow(node: meshcat.Visualizer) -> None:
    """Let an object of the scene cast no shadow; meshcat's own command would write the name in small letters."""
    _send(node["<object>"], {"type": "set_property", "property": "castShadow", "value": False})


def _send(node: meshcat.Visualizer, message: dict[str, Any]) -> None:
    """A command that meshcat has no class for."""
    told = {**message, "path": node.path.lower()}
    node.window.send(SimpleNamespace(lower=lambda: told))


def draw_puppet(
    group: meshcat.Visualizer, puppet: Puppet, pose: int, colour: str, ball: float, *, front: bool
) -> None:
    """One robot at the pose of a number, each part below its mover, with its target and the rod that carries it.

    The target's ball has the radius ``ball`` [m], 0 for none. ``front`` draws a little towards the eye: where one
    robot is laid over the other, surfaces a fraction of a millimetre apart would flicker otherwise.
    """
    at, robot, material = puppet.poses[pose], group["robot"], solid(colour, front=front)
    for i, (mover, mesh, T_mover_shape) in enumerate(puppet.parts):
        node = robot["links"][f"{mover:03d}"]
        node.set_transform(at[mover])
        node[f"{i:03d}"].set_object(mc.TriangularMeshGeometry(*mesh), material)
        node[f"{i:03d}"].set_transform(T_mover_shape)
    target = len(at) - 1
    rods = [(*rod, puppet.radius) for rod in puppet.rods]
    if ball:
        node = robot["links"][f"{target:03d}"]
        node.set_transform(at[target])
        node["ball"].set_object(mc.Sphere(ball), material)
        rods.append((target - 1, target, _STALK * ball))
    for k, (one, other, radius) in enumerate(rods):
        node = robot["rods"][f"{k:03d}"]
        T, length = rod_between(at[one, :3, 3], at[other, :3, 3])
        # A rod of length one, stretched: the page's script does the same at every other pose.
        node.set_transform(T @ np.diag([1.0, 1.0, max(length, 1e-9), 1.0]))
        node["rod"].set_object(mc.Cylinder(1.0, radius), material)
        node["rod"].set_transform(_Y_TO_Z)


def draw_points(node: meshcat.Visualizer, points: Array, colour: str, radius: float) -> None:
    """Points of shape (N, 3) as balls of a radius, or as dots where they are many [m]; without shadows."""
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


def round_length(longest: float) -> float:
    """The largest 1, 2 or 5 times a power of ten that is not above a length."""
    power = 10.0 ** np.floor(np.log10(longest))
    return float(power * max(step for step in (1, 2, 5) if step * power <= longest * 1.000001))


def span(points: Array) -> float:
    """The diagonal of the points' bounding box; 1 mm at least [m]."""
    return max(float(np.linalg.norm(np.ptp(points, axis=0))), 1e-3)
