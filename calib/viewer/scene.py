"""A scene of meshcat, z up: robots, camera, lights, floor and marks about them; and the HTML page that carries it.

meshcat's own window starts a server in another process, whose web port listens on all addresses. `SceneWindow` opens no
socket: it stores the same commands in meshcat's own tree, and the page carries meshcat's viewer and the commands.
"""

from __future__ import annotations

import base64
import hashlib
import json
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import meshcat
import numpy as np
import umsgpack
from meshcat import geometry as mc
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

import calib.report.figure_base as look
from calib.files import write_atomically
from calib.robot.robot import Robot
from calib.units import Array
from calib.viewer.view import Puppet, read_visuals, translation

#: What a page that came from a server on this computer may talk to.
_LIVE = "; connect-src 'self' ws://127.0.0.1:* ws://localhost:*"

#: The files of the script of a page of robots, in order.
_SCRIPTS = ("robots.js", "marks.js", "words.js", "controls.js")

#: The colours of robots and of what was measured.
COLOURS = {"nominal": look.NOMINAL, "calibrated": look.CALIBRATED, "measured": look.INK}

#: The scene's node that holds the robots.
SCENE = "robots"

#: Radius of the rod to the target, as a part of its ball's; more points than these are a cloud of dots.
_STALK, _MOST_BALLS = 0.3, 300

#: Vertical angle of view [deg]: a long lens, so that robots at the side are not distorted.
_FOV_DEG = 28.0

#: How far the camera looks down [rad], and the part of the picture's half width for the scene.
_DOWN, _WIDTH = np.deg2rad(16.0), 0.95

#: three.js turns cylinders about y, URDF about z.
_Y_TO_Z = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])


class SceneWindow:
    """The commands of a scene, for ``meshcat.Visualizer(window=...)``.

    meshcat's identifiers hold the time and this computer's network address; here they follow from the content, so
    that the same scene is the same bytes and a mesh that is drawn four times is stored once.
    """

    def __init__(self) -> None:
        self._scene: dict[str, Any] = {"geometries": {}, "commands": []}

    def send(self, command: Any) -> None:  # noqa: ANN401  a command of meshcat
        """Take a command, as meshcat's server does."""
        message = command.lower()
        if message["type"] == "set_object":
            self._share(message["object"], message["path"])
        self._scene["commands"].append(message)

    def scene(self) -> bytes:
        """The whole scene as one message: the geometries by name, and the commands in order."""
        packed: bytes = umsgpack.packb(self._scene)
        return packed

    def _share(self, lowered: dict[str, Any], path: str) -> None:
        """Name everything by its content or path, and keep the geometries apart."""
        lowered["object"]["uuid"] = f"object of {path}"
        if "geometries" in lowered:  # one, with its material
            (geometry,), (material,) = lowered["geometries"], lowered["materials"]
            del geometry["uuid"]
            name = hashlib.sha256(umsgpack.packb(geometry)).hexdigest()[:32]
            self._scene["geometries"].setdefault(name, {"uuid": name, **geometry})
            material["uuid"] = f"material of {path}"
            lowered["geometries"] = [name]
            lowered["object"] |= {"geometry": name, "material": material["uuid"]}


class Camera(NamedTuple):
    """A camera at a distance of a centre [m]; the rows of ``axes``, (3, 3), point right, up and towards the camera."""

    centre: Array
    axes: Array
    distance: float

    @property
    def position(self) -> list[float]:
        """Where it stands, from the centre, in meshcat's frame of cameras, in which y is up [m]."""
        x, y, z = (float(value) for value in self.distance * self.axes[2])
        return [x, z, -y]


def row_direction(points: Array) -> Array:
    """A horizontal direction to look from at an arm with joints at points, shape (3,)."""
    # The arm reaches to the right of the picture and a little towards the camera.
    x, y = points[-1, :2] - points[0, :2]
    angle = np.arctan2(y, x) - np.deg2rad(68.0)
    return np.array([np.cos(angle), np.sin(angle), 0.0])


def look_at(points: Array, back: Array, between: tuple[float, float] = (-0.69, 0.75)) -> Camera:
    """A camera near enough that sees all points of shape (N, 3) where no text stands, on a 16:9 screen.

    ``back`` is a horizontal unit vector from the scene to the camera; text at the foot ends and that of the heading
    begins at ``between``, the picture being from -1 to 1.
    """
    low, high = between
    towards = np.cos(_DOWN) * back + np.sin(_DOWN) * np.array([0.0, 0.0, 1.0])
    right = np.array([-back[1], back[0], 0.0])
    axes = np.stack([right, np.cross(towards, right), towards])
    tangents = np.tan(0.5 * np.deg2rad(_FOV_DEG)) * np.array([16.0 / 9.0, 1.0])
    half = tangents * [_WIDTH, 0.5 * (high - low)]
    seen = points @ axes.T
    centre = 0.5 * (seen.min(axis=0) + seen.max(axis=0))
    for _ in range(3):  # in perspective the middle is not that of the box
        local = seen - centre
        distance = float(np.max(local[:, 2:] + np.abs(local[:, :2]) / half))
        at = local[:, :2] / (distance - local[:, 2:])
        centre[:2] += 0.5 * (at.min(axis=0) + at.max(axis=0)) * distance
    centre[1] -= 0.5 * (low + high) * tangents[1] * distance
    return Camera(centre @ axes, axes, distance)


def new_scene(
    camera: Camera, size: float, floor: float
) -> tuple[SceneWindow, meshcat.Visualizer, float]:
    """A scene with a camera, lights, background and floor, whose origin is what the camera looks at.

    ``size`` is that of what is drawn, ``floor`` the height of the floor [m]. It comes with meshcat's visualizer of all
    of it and the edge of a square of the floor [m].
    """
    window = SceneWindow()
    root = meshcat.Visualizer.view_into(window, meshcat.path.Path())
    lens = mc.PerspectiveCamera(fov=_FOV_DEG, aspect=16 / 9, near=0.02 * size, far=100 * size)
    root["/Cameras/default/rotated"].set_object(lens)
    light = camera.axes[2] - 0.6 * camera.axes[0] + 1.1 * np.array([0.0, 0.0, 1.0])
    for node, name, value in (
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
    ):
        root[node].set_property(name, value)
    power = 10.0 ** np.floor(np.log10(size / 7.0))
    grid = float(power * max(step for step in (1, 2, 5) if step * power <= size / 7.0))
    ends = grid * np.array([[[k, s * 8, 0.0] for s in (-1, 1)] for k in range(-8, 9)])
    floor_lines = np.concatenate([ends, ends[..., [1, 0, 2]]])
    draw_lines(root["/Floor/grid"], floor_lines, "#9aa7b4", 0.42)
    root["/Floor/grid"].set_transform(translation([0, 0, floor - camera.centre[2]]))
    return window, root, grid


def draw_puppet(
    group: meshcat.Visualizer,
    puppet: Puppet,
    pose: int,
    material: mc.MeshPhongMaterial,
    ball: float = 0.0,
) -> None:
    """One robot at the pose of a number, each part below its mover; a ball of a radius [m] on a rod is its target."""
    at, robot = puppet.poses[pose], group["robot"]
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
        node.set_transform(rod_between(at[one, :3, 3], at[other, :3, 3]))
        node["rod"].set_object(mc.Cylinder(1.0, radius), material)
        node["rod"].set_transform(_Y_TO_Z)


def rod_between(start: Array, end: Array) -> Array:
    """A rod of length one, z along it, stretched from a point to another, shape (4, 4), [m]."""
    length = float(np.linalg.norm(end - start))
    T = translation(0.5 * (start + end))
    if length > 0:
        turn, _ = Rotation.align_vectors([(end - start) / length], [[0.0, 0.0, 1.0]])
        T[:3, :3] = turn.as_matrix()
    T[:3, 2] *= max(length, 1e-9)
    return T


def draw_points(node: meshcat.Visualizer, points: Array, colour: str, radius: float) -> None:
    """Points of shape (N, 3) as balls of a radius, or as dots where they are many [m]."""
    if len(points) > _MOST_BALLS:
        draw_cloud(node["dots"], points, colour, 1.2 * radius)
        return
    ball, material = mc.Sphere(radius), mc.MeshPhongMaterial(color=_number(colour))
    for i, point in enumerate(points):
        node[f"{i:03d}"].set_object(ball, material)
        node[f"{i:03d}"].set_transform(translation(point))


def draw_cloud(node: meshcat.Visualizer, points: ArrayLike, colour: str, edge: float) -> None:
    """Points of shape (N, 3) as dots of one colour with an edge [m]."""
    at = np.asarray(points, dtype=np.float32).T
    rgb = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)], dtype=np.float32) / 255
    node.set_object(mc.PointCloud(at, np.repeat(rgb[:, None], at.shape[1], axis=1), size=edge))


def draw_lines(node: meshcat.Visualizer, ends: Array, colour: str, opacity: float = 1.0) -> None:
    """Straight lines with ends of shape (N, 2, 3) or (2 N, 3) [m]."""
    material = mc.LineBasicMaterial(color=_number(colour), opacity=opacity, transparent=opacity < 1)
    node.set_object(mc.LineSegments(mc.PointsGeometry(ends.reshape(-1, 3).T), material))


def draw_boxes(
    node: meshcat.Visualizer, sizes: Sequence[Array], poses: Sequence[Array], colour: str
) -> None:
    """Translucent boxes of some sizes at some poses [m]."""
    for i, (size, T) in enumerate(zip(sizes, poses, strict=True)):
        material = mc.MeshPhongMaterial(color=_number(colour), opacity=0.35, transparent=True)
        node[f"{i:02d}"].set_object(mc.Box(size.tolist()), material)
        node[f"{i:02d}"].set_transform(T)


def solid(colour: str, *, front: bool = False) -> mc.MeshPhongMaterial:
    """The surface of a robot; ``front`` draws it before another a fraction of a millimetre away, without flicker."""
    more = {"polygonOffset": 1, "polygonOffsetFactor": -1.0, "polygonOffsetUnits": -4.0}
    look = {"color": _number(colour), "shininess": 35, "specular": 0x2A2A2A, "side": 2}
    return mc.MeshPhongMaterial(**look, **(more if front else {}))


def _number(colour: str) -> int:
    """A colour as meshcat takes it."""
    return int(colour[1:], 16)


def span(points: Array) -> float:
    """The diagonal of the points' bounding box; 1 mm at least [m]."""
    return max(float(np.linalg.norm(np.ptp(points, axis=0))), 1e-3)


class Page(NamedTuple):
    """A complete HTML page, UTF-8, and what could not be drawn as the URDF says, a sentence each."""

    html: bytes
    warnings: tuple[str, ...]

    def write(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
        """Write the page, whole or not at all; `FileError` where the file exists or cannot be written."""
        return write_atomically(path, self.html, overwrite=overwrite)


class Key(NamedTuple):
    """A line of the legend that shows and hides nodes below `SCENE`, with blanks between them."""

    text: str
    colour: str
    nodes: str
    kind: str = ""
    on: bool = True


def filled_page(
    template: str,
    scene: bytes,
    *,
    table: Mapping[str, Any] | None = None,
    live: bool = False,
    **content: Any,  # noqa: ANN401  what the template names
) -> bytes:
    """The page about a scene's message, UTF-8, by ``"page.html"`` or a template that extends it.

    ``table`` is what the script of a page of robots is told; a ``live`` page listens to the server that it came from.
    """
    import jinja2
    from markupsafe import Markup

    folder, viewer = Path(__file__).parent, Path(meshcat.viewer_assets_path())
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(folder),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )

    def read(path: Path) -> str:
        """A file whose text cannot end the script that it stands in."""
        return path.read_text("utf-8").replace("</script", "<\\/script").replace("<!--", "<\\!--")

    scripts = [read(viewer / "dist/main.min.js"), read(folder / "page.js")]
    if table:
        own = "\n".join(read(folder / name) for name in _SCRIPTS)
        scripts.append(f'"use strict";\n(() => {{\n{own}}})();\n')
    # No other script runs, whatever a name may hold.
    hashes = [_base64(hashlib.sha256(text.encode()).digest()) for text in scripts]
    policy = " ".join(f"'sha256-{one}'" for one in hashes) + _LIVE * live
    # A block of JSON that no name in it can end.
    told = json.dumps(table, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    # The notices that must go with a copy of the viewer: meshcat's own and those of what it contains.
    notices = [viewer / "LICENSE", *sorted((viewer / "dist").glob("main.min.js.*LICENSE*"))]
    page = environment.get_template(template).render(
        hashes=Markup(policy),
        live=live,
        colours=COLOURS,
        licences=Markup("\n\n".join(map(read, notices))),
        scene=_base64(scene),
        table=Markup(told) if table else "",
        scripts=[Markup(text) for text in scripts],
        **content,
    )
    return page.encode("utf-8", "replace")


def _base64(data: bytes) -> str:
    """Bytes as text that needs no escaping."""
    return base64.b64encode(data).decode("ascii")


def floats(values: ArrayLike) -> str:
    """Numbers as base64 of little-endian float32."""
    return _base64(np.ascontiguousarray(values, dtype="<f4").tobytes())


def single_page(
    robot: Robot,
    q: Array,
    points: Array,
    draw: Callable[[meshcat.Visualizer, float], list[Key]],
    *,
    title: str,
    text: str,
    legend: str,
) -> Page:
    """A page of one robot at a pose q of shape (m,), and of what is drawn at points of shape (K, 3) in the base.

    ``draw`` draws below the node given, in the base frame, things about as large as the size given [m], and returns
    their lines of the legend.
    """
    visuals, warnings = read_visuals(robot.urdf)
    puppet = Puppet.of(robot, q[None], visuals, np.eye(4)[None], np.eye(4))
    drawn = puppet.outline()
    everything = np.concatenate([drawn, points])
    camera, size = look_at(everything, row_direction(puppet.poses[0, :, :3, 3])), span(everything)
    window, root, grid = new_scene(camera, size, float(drawn[:, 2].min()))
    scene = root[SCENE]
    scene.set_transform(translation(-camera.centre))
    draw_puppet(scene["nominal"], puppet, 0, solid(look.NOMINAL))
    keys = [Key(legend, look.NOMINAL, "nominal"), *draw(scene, size)]
    words: dict[str, Any] = {"title": title, "text": text, "warnings": warnings}
    return Page(filled_page("page.html", window.scene(), keys=keys, grid=grid, **words), warnings)
