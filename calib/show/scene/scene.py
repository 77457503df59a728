"""A scene of meshcat, z up: robots, camera, lights, floor and marks about them.

meshcat's own window starts a server in another process, whose web port listens on all addresses. `SceneWindow` opens no
socket: it stores the same commands in meshcat's own tree, and the page carries meshcat's viewer and the commands.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import meshcat
import numpy as np
import umsgpack
from meshcat import geometry as mc
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array
from calib.robot.robot import Robot
from calib.show.look import NOMINAL
from calib.show.scene.html_page import LegendEntry, Page, fill_page
from calib.show.scene.posed_robot import PosedRobot, read_visuals, translation

#: The scene's node that holds the robots.
SCENE = "robots"

#: Radius of the rod to the target, as a part of its ball's.
_STALK = 0.3

#: More points than this are a cloud of dots instead of balls: the page stays quick.
_MOST_BALLS = 300

#: Vertical angle of view [deg]: a long lens, so that two equal robots side by side look equal.
_FOV_DEG = 10.0

#: Angle by which the camera looks down [rad].
_DOWN = np.deg2rad(16.0)

#: Part of the picture's half width that the scene may fill.
_WIDTH = 0.95

#: Width over height of the picture that cameras are placed for.
_ASPECT = 16.0 / 9.0

#: Angle between the arm and the direction to the camera, seen from above [rad]: it reaches to the right of the picture
#: and a little towards the camera.
_SIDE_VIEW = np.deg2rad(68.0)

#: Squares of the floor across a scene, at least.
_SQUARES = 7.0

#: Lines of the floor on each side of its middle.
_FLOOR_LINES = 8

#: three.js turns cylinders about y, URDF about z.
_Y_TO_Z = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])


class SceneWindow:
    """The commands of a scene, for ``meshcat.Visualizer(window=...)``.

    meshcat's identifiers hold the time and this computer's network address. Here they follow from the content, so that
    the same scene is the same bytes, and a mesh that is drawn four times is stored once.
    """

    def __init__(self) -> None:
        self._scene: dict[str, Any] = {"geometries": {}, "commands": []}

    def send(self, command: Any) -> None:  # noqa: ANN401  a command of meshcat
        """Keep a command of meshcat, with identifiers that follow from its content."""
        message = command.lower()
        if message["type"] == "set_object":
            # Identify the object by its path and its geometry by its content; store each geometry once, by its name.
            lowered, path = message["object"], message["path"]
            lowered["object"]["uuid"] = f"object of {path}"
            if "geometries" in lowered:  # one, with its material
                (geometry,) = lowered["geometries"]
                (material,) = lowered["materials"]
                del geometry["uuid"]
                name = hashlib.sha256(umsgpack.packb(geometry)).hexdigest()[:32]
                self._scene["geometries"].setdefault(name, {"uuid": name, **geometry})
                material["uuid"] = f"material of {path}"
                lowered["geometries"] = [name]
                lowered["object"] |= {"geometry": name, "material": material["uuid"]}
        self._scene["commands"].append(message)

    def scene(self) -> bytes:
        """Return the scene as one message: the geometries by name, and the commands in order."""
        packed: bytes = umsgpack.packb(self._scene)
        return packed


class ViewCamera(NamedTuple):
    """A camera that looks at a point."""

    #: Shape (3,), the point [m]
    centre: Array
    #: Shape (3, 3), unit vectors as rows: right, up, and from the point to the camera
    axes: Array
    #: From the point [m]
    distance: float

    @property
    def position(self) -> list[float]:
        """Its position from the centre, in meshcat's frame of cameras, in which y is up [m]."""
        x, y, z = (float(value) for value in self.distance * self.axes[2])
        return [x, z, -y]


def camera_direction(points: Array, side_view: float = _SIDE_VIEW) -> Array:
    """Choose the side from which an arm is seen: it reaches to the right and a little towards the camera.

    Args:
        points: shape (K, 3), [m], joints of the arm from the base to the tip; only the first and the last count.
        side_view: Angle between the arm and the direction to the camera, seen from above [rad].

    Returns:
        shape (3,), horizontal unit vector from the arm to the camera.
    """
    x, y = points[-1, :2] - points[0, :2]
    angle = np.arctan2(y, x) - side_view
    return np.array([np.cos(angle), np.sin(angle), 0.0])


def look_at(
    points: Array, towards_camera: Array, between: tuple[float, float] = (-0.69, 0.75)
) -> ViewCamera:
    """Place a camera as near as possible so that it sees all points clear of the text, on a 16:9 screen.

    Args:
        points: shape (N, 3), [m], z up.
        towards_camera: shape (3,), horizontal unit vector from the scene to the camera, which looks down a little.
        between: Upper end of the text at the foot and lower end of the heading; the picture is from -1 to 1.
    """
    low, high = between
    back = np.cos(_DOWN) * towards_camera + np.sin(_DOWN) * np.array([0.0, 0.0, 1.0])
    right = np.array([-towards_camera[1], towards_camera[0], 0.0])
    axes = np.stack([right, np.cross(back, right), back])
    tangents = np.tan(0.5 * np.deg2rad(_FOV_DEG)) * np.array([_ASPECT, 1.0])
    half = tangents * [_WIDTH, 0.5 * (high - low)]
    seen = points @ axes.T
    centre = 0.5 * (seen.min(axis=0) + seen.max(axis=0))
    for _ in range(3):  # in perspective the middle of the picture is not that of the box
        local = seen - centre
        distance = float(np.max(local[:, 2:] + np.abs(local[:, :2]) / half))
        at = local[:, :2] / (distance - local[:, 2:])
        centre[:2] += 0.5 * (at.min(axis=0) + at.max(axis=0)) * distance
    centre[1] -= 0.5 * (low + high) * tangents[1] * distance
    return ViewCamera(centre @ axes, axes, distance)


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A scene to draw robots in."""

    #: Its commands, which make the page.
    window: SceneWindow
    #: meshcat's visualizer of all of it; its origin is the camera's centre.
    root: meshcat.Visualizer
    #: Edge of a square of the floor [m].
    square: float


def new_scene(camera: ViewCamera, size: float, floor: float) -> Scene:
    """Make a scene with a camera, lights, background and floor; its origin is the camera's centre.

    Args:
        camera: The camera.
        size: Size of the scene's content [m].
        floor: Height of the floor, z, in the frame in which the camera's centre is given [m].

    Returns:
        The scene, without robots.
    """
    window = SceneWindow()
    root = meshcat.Visualizer.view_into(window, meshcat.path.Path())
    lens = mc.PerspectiveCamera(fov=_FOV_DEG, aspect=16 / 9, near=0.05 * size, far=100 * size)
    root["/Cameras/default/rotated"].set_object(lens)
    light = camera.axes[2] - 0.6 * camera.axes[0] + 1.1 * np.array([0.0, 0.0, 1.0])
    properties = (
        ("/Background", "top_color", [0.985, 0.99, 1.0]),
        ("/Background", "bottom_color", [0.86, 0.885, 0.915]),
        ("/Grid", "visible", False),
        ("/Axes", "visible", False),
        ("/Lights/PointLightNegativeX/<object>", "visible", False),
        ("/Lights/PointLightPositiveX/<object>", "visible", False),
        ("/Lights/AmbientLight/<object>", "intensity", 0.55),
        ("/Lights/FillLight/<object>", "intensity", 0.65),
        ("/Lights/FillLight/<object>", "position", (20.0 * size * light).tolist()),
        ("/Cameras/default/rotated/<object>", "position", camera.position),
    )
    for node, name, value in properties:
        root[node].set_property(name, value)

    # The floor's grid: the edge of a square is 1, 2 or 5 times 10^n.
    power = 10.0 ** np.floor(np.log10(size / _SQUARES))
    step = max(step for step in (1, 2, 5) if step * power <= size / _SQUARES)
    square = float(power * step)
    n = _FLOOR_LINES
    ends = [[[k, -n, 0.0], [k, n, 0.0]] for k in range(-n, n + 1)]
    along = square * np.array(ends)
    across = along[..., [1, 0, 2]]
    grid = root["/Floor/grid"]
    draw_lines(grid, np.concatenate([along, across]), "#9aa7b4", 0.42)
    grid.set_transform(translation([0, 0, floor - camera.centre[2]]))
    return Scene(window, root, square)


def draw_robot(
    group: meshcat.Visualizer,
    robot: PosedRobot,
    pose: int,
    material: mc.MeshPhongMaterial,
    ball: float = 0.0,
) -> None:
    """Draw a robot at one of its poses, each shape below the node of its mover.

    Args:
        group: Node of the robot.
        robot: The robot.
        pose: Index of the pose, from 0.
        material: Surface of all parts.
        ball: Radius of the ball at the target [m], which a rod joins to the tip; 0 for none.
    """
    T_scene_movers = robot.poses[pose]
    links = group["robot"]["links"]
    for i, (mover, mesh, T_mover_shape) in enumerate(robot.parts):
        link = links[f"{mover:03d}"]
        link.set_transform(T_scene_movers[mover])
        shape = link[f"{i:03d}"]
        shape.set_object(mc.TriangularMeshGeometry(*mesh), material)
        shape.set_transform(T_mover_shape)
    rods = [(start, end, robot.radius) for start, end in robot.rods]
    if ball:
        target = len(T_scene_movers) - 1
        tip = target - 1
        node = links[f"{target:03d}"]
        node.set_transform(T_scene_movers[target])
        node["ball"].set_object(mc.Sphere(ball), material)
        rods.append((tip, target, _STALK * ball))
    origins = T_scene_movers[:, :3, 3]
    for k, (start, end, radius) in enumerate(rods):
        node = group["robot"]["rods"][f"{k:03d}"]
        node.set_transform(rod_between(origins[start], origins[end]))
        node["rod"].set_object(mc.Cylinder(1.0, radius), material)
        node["rod"].set_transform(_Y_TO_Z)


def rod_between(start: Array, end: Array) -> Array:
    """Return the transform (4, 4) that stretches a rod of length 1 along z between two points (3,) [m]."""
    length = float(np.linalg.norm(end - start))
    T = translation(0.5 * (start + end))
    if length > 0:
        direction = (end - start) / length
        rotation, _ = Rotation.align_vectors([direction], [[0.0, 0.0, 1.0]])
        T[:3, :3] = rotation.as_matrix()
    T[:3, 2] *= max(length, 1e-9)
    return T


def draw_points(node: meshcat.Visualizer, points: Array, colour: str, radius: float) -> None:
    """Draw points as balls, or as dots if there are many.

    Args:
        node: Node of the points.
        points: shape (N, 3), [m].
        colour: ``"#rrggbb"``.
        radius: Radius of a ball [m].
    """
    if len(points) > _MOST_BALLS:
        draw_cloud(node["dots"], points, colour, 1.2 * radius)
        return
    ball = mc.Sphere(radius)
    material = mc.MeshPhongMaterial(color=_number(colour))
    for i, point in enumerate(points):
        child = node[f"{i:03d}"]
        child.set_object(ball, material)
        child.set_transform(translation(point))


def draw_cloud(node: meshcat.Visualizer, points: ArrayLike, colour: str, edge: float) -> None:
    """Draw points as square dots.

    Args:
        node: Node of the points.
        points: shape (N, 3), [m].
        colour: ``"#rrggbb"``.
        edge: Edge of a dot [m].
    """
    count = len(np.asarray(points))
    draw_coloured(node, points, np.repeat([_levels(colour)], count, axis=0), edge)


def draw_coloured(
    node: meshcat.Visualizer, points: ArrayLike, colours: ArrayLike, edge: float
) -> None:
    """Draw points as square dots, each of its own colour.

    Args:
        node: Node of the points.
        points: shape (N, 3), [m].
        colours: shape (N, 3), red, green and blue from 0 to 1.
        edge: Edge of a dot [m].
    """
    positions = np.asarray(points, dtype=np.float32).T
    # three.js scales sizes as if the angle of view were 90 deg.
    size = edge / np.tan(0.5 * np.deg2rad(_FOV_DEG))
    levels = np.asarray(colours, dtype=np.float32).T
    node.set_object(mc.PointCloud(positions, levels, size=float(size)))


def blended(colours: Sequence[str], shares: Array) -> Array:
    """Blend a scale of colours.

    Args:
        colours: ``"#rrggbb"``, evenly along the scale.
        shares: shape (N,), places on the scale, from 0 to 1.

    Returns:
        shape (N, 3), red, green and blue from 0 to 1.
    """
    levels = np.array([_levels(colour) for colour in colours])
    places = np.linspace(0.0, 1.0, len(colours))
    return np.stack([np.interp(shares, places, of_light) for of_light in levels.T], axis=1)


def _levels(colour: str) -> Array:
    """Return red, green and blue, from 0 to 1, of a colour ``"#rrggbb"``, shape (3,)."""
    return np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0


def draw_lines(node: meshcat.Visualizer, ends: Array, colour: str, opacity: float = 1.0) -> None:
    """Draw straight lines.

    Args:
        node: Node of the lines.
        ends: shape (N, 2, 3) or (2 N, 3), both ends of each line [m].
        colour: ``"#rrggbb"``.
        opacity: From 0 to 1.
    """
    is_transparent = opacity < 1
    material = mc.LineBasicMaterial(
        color=_number(colour), opacity=opacity, transparent=is_transparent
    )
    points = mc.PointsGeometry(ends.reshape(-1, 3).T)
    node.set_object(mc.LineSegments(points, material))


def draw_boxes(
    node: meshcat.Visualizer,
    sizes: Sequence[Array],
    poses: Sequence[Array],
    colour: str,
) -> None:
    """Draw translucent boxes.

    Args:
        node: Node of the boxes.
        sizes: Edges (3,) of each box [m].
        poses: Pose (4, 4) of each box's middle [m].
        colour: ``"#rrggbb"``.
    """
    for i, (size, T) in enumerate(zip(sizes, poses, strict=True)):
        material = mc.MeshPhongMaterial(color=_number(colour), opacity=0.35, transparent=True)
        child = node[f"{i:02d}"]
        child.set_object(mc.Box(size.tolist()), material)
        child.set_transform(T)


def solid(colour: str, *, front: bool = False) -> mc.MeshPhongMaterial:
    """Return the surface of a robot.

    Args:
        colour: ``"#rrggbb"``.
        front: Draw it in front of a surface that is a fraction of a millimetre away, so that neither flickers.
    """
    surface: dict[str, Any] = {
        "color": _number(colour),
        "shininess": 35,
        "specular": 0x2A2A2A,
        "side": 2,
    }
    if front:
        surface |= {"polygonOffset": 1, "polygonOffsetFactor": -1.0, "polygonOffsetUnits": -4.0}
    return mc.MeshPhongMaterial(**surface)


def _number(colour: str) -> int:
    """Return a colour ``"#rrggbb"`` as the number that meshcat takes."""
    return int(colour[1:], 16)


def span(points: Array) -> float:
    """Return the diagonal of the bounding box of points (N, 3) [m]; 1 mm at least."""
    extent = np.ptp(points, axis=0)
    return max(float(np.linalg.norm(extent)), 1e-3)


def single_page(
    robot: Robot,
    q: Array,
    points: Array,
    draw: Callable[[meshcat.Visualizer, float], list[LegendEntry]],
    *,
    title: str,
    text: str,
    legend: str,
) -> Page:
    """Make a page of one robot at one pose, and of things drawn around it.

    Args:
        robot: The robot.
        q: shape (m,), its pose [rad or m].
        points: shape (K, 3), points of these things in the base [m], so that the camera sees them too.
        draw: Function of a node and the scene's size [m]: draws the things below the node, in the base frame, and
            returns their entries of the legend.
        title: The heading.
        text: The sentence below it.
        legend: The robot's entry of the legend.
    """
    visuals, warnings = read_visuals(robot.urdf)
    posed = PosedRobot.of(robot, q[None], visuals, np.eye(4)[None], np.eye(4))
    outline = posed.outline()
    everything = np.concatenate([outline, points])
    size = span(everything)
    camera = look_at(everything, camera_direction(posed.poses[0, :, :3, 3]))
    scene = new_scene(camera, size, floor=float(outline[:, 2].min()))
    base = scene.root[SCENE]
    base.set_transform(translation(-camera.centre))
    draw_robot(base["nominal"], posed, 0, solid(NOMINAL))
    keys = [LegendEntry(legend, NOMINAL, "nominal"), *draw(base, size)]
    html = fill_page(
        "page.html",
        scene.window.scene(),
        keys=keys,
        grid=scene.square,
        title=title,
        text=text,
        warnings=warnings,
    )
    return Page(html, warnings)


class Dots(NamedTuple):
    """Points of one set."""

    #: Name of their node in the scene
    node: str
    #: ``"#rrggbb"``
    colour: str
    #: Their entry of the legend
    text: str
    #: Shape (..., 3), in the base [m]
    points: Array


def draw_dots(scene: meshcat.Visualizer, sets: Sequence[Dots], radius: float) -> list[LegendEntry]:
    """Draw each set that has points, as balls of a radius [m], or dots if many; return their legend entries."""
    keys = []
    for dots in sets:
        if len(dots.points):
            draw_points(scene[dots.node], dots.points.reshape(-1, 3), dots.colour, radius)
            keys.append(LegendEntry(dots.text, dots.colour, dots.node, "dot"))
    return keys
