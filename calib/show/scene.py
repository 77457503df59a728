"""The picture of a calibration: nominal robot, calibrated robot and both overlaid, in one HTML file.

All lengths are true to scale. Everything is drawn in the base frame, z up, with meshcat; where joints move the base
itself, as they do a camera's, it is turned so that the robot stands upright. The page holds the viewer and the scene,
opens from disk and loads nothing from anywhere.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import meshcat
import numpy as np
from meshcat import geometry as mc
from numpy.typing import ArrayLike, NDArray

from calib.errors import ModelError, choices
from calib.model.robot import Robot, read_only
from calib.show.bodies import Body, bodies, link_poses, rod_pose
from calib.show.camera import Camera, look_at, row_direction
from calib.show.page import COLOURS, SCENE, Spot, html_page, round_length
from calib.show.stage import Page, draw_stage, mesh_geometry, translation, upright_pose
from calib.show.visuals import Cylinder, Visual, read_visuals, same_visuals
from calib.show.window import SceneWindow, without_shadow

Array = NDArray[np.float64]

#: Above this many measured points they are drawn as dots, not as balls.
_MOST_BALLS = 300

#: Radius of a target's ball and of a measured point's, as a part of the scene's size.
_BALL, _SMALL_BALL = 0.009, 0.0038


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """What is shown; values only.

    Attributes:
        nominal: The robot before calibration.
        calibrated: The robot after it; the same chain.
        q: shape (m,), [rad] or [m], the pose shown, in the order of ``nominal.joint_names``.
        nominal_target: shape (3,), [m], the target in the tip of the nominal robot.
        calibrated_target: shape (3,), [m], the target in the tip of the calibrated robot.
        measured: shape (N, 3), [m], measured targets in the base frame; may be empty.
        index: Which of ``measured`` was measured at ``q``; None if none was.
        pose_name: What the pose is called, such as ``"row 31, validation"``.
        title: The page's heading.
        T_base_nominal: shape (4, 4), [m], where the nominal robot stands in the calibrated one's base frame: the two
            find the measurement frame a little differently.

    Raises:
        ModelError: The robots have different joints, or an array has another shape or is not finite.
    """

    nominal: Robot
    calibrated: Robot
    q: Array
    nominal_target: Array = field(default_factory=lambda: np.zeros(3))
    calibrated_target: Array = field(default_factory=lambda: np.zeros(3))
    measured: Array = field(default_factory=lambda: np.zeros((0, 3)))
    index: int | None = None
    pose_name: str = ""
    title: str = ""
    T_base_nominal: Array = field(default_factory=lambda: np.eye(4))

    def __post_init__(self) -> None:
        """Copy the arrays and check that all of it fits together."""
        if self.nominal.joint_names != self.calibrated.joint_names:
            message = (
                f"The nominal robot has the joints {choices(self.nominal.joint_names)}, the calibrated one "
                f"{choices(self.calibrated.joint_names)}. Show two robots with the same chain."
            )
            raise ModelError(message)
        self._store("q", self.q, (len(self.nominal.joint_names),))
        self._store("nominal_target", self.nominal_target, (3,))
        self._store("calibrated_target", self.calibrated_target, (3,))
        self._store("T_base_nominal", self.T_base_nominal, (4, 4))
        measured = np.asarray(self.measured, dtype=np.float64)
        self._store("measured", measured, (len(measured) if measured.ndim else 0, 3))
        if self.index is not None and not 0 <= self.index < len(self.measured):
            message = (
                f"index is {self.index}, and there are {len(self.measured)} measured points; give a number "
                "from 0 to one less, or None."
            )
            raise ModelError(message)

    def _store(self, name: str, values: ArrayLike, shape: tuple[int, ...]) -> None:
        """Set a field to a read-only copy of finite numbers of a shape."""
        array = read_only(values)
        if array.shape != shape or not np.isfinite(array).all():
            message = f"{name} has shape {array.shape}; finite numbers of shape {shape} are wanted."
            raise ModelError(message)
        object.__setattr__(self, name, array)


def write_view(view: View, path: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
    """Write a view as one HTML file that opens from disk without a network.

    Raises:
        FileError: The file exists and ``overwrite`` is False, or it cannot be written.
    """
    return view_page(view).write(path, overwrite=overwrite)


def view_page(view: View) -> Page:
    """Draw a view.

    Raises:
        UrdfError: Pinocchio cannot build a model of a URDF.
    """
    nominal_visuals, warnings = read_visuals(view.nominal.urdf)
    calibrated_visuals = nominal_visuals
    if not same_visuals(view.nominal.urdf, view.calibrated.urdf):
        calibrated_visuals, more = read_visuals(view.calibrated.urdf)
        warnings = tuple(dict.fromkeys(warnings + more))
    layout = _Layout.of(view, nominal_visuals, calibrated_visuals)
    window = SceneWindow()
    root = meshcat.Visualizer.view_into(window, meshcat.path.Path())
    draw_stage(
        root,
        layout.camera,
        size=layout.size,
        floor=layout.foot[2],
        grid=layout.grid,
        through=layout.groups["both"][0],
    )
    scene = root[SCENE]
    for group, (offset, shown) in layout.groups.items():
        scene[group].set_transform(translation(offset - layout.camera.centre))
        for who in shown:
            _draw_robot(scene[group][who], layout, who, over=len(shown) == 2)
    _draw_measured(scene["both"]["measured"], view.index, layout)
    spots = [
        Spot(group, offset + layout.foot - layout.camera.centre)
        for group, (offset, _) in layout.groups.items()
    ]
    html = html_page(
        title=view.title or f"{view.nominal.name or 'Robot'}: nominal and calibrated",
        pose_name=view.pose_name,
        points=layout.points,
        spots=spots,
        grid=layout.grid,
        warnings=warnings,
        scene=window.scene(),
    )
    return Page(html, warnings)


@dataclass(frozen=True, slots=True, eq=False)
class _Layout:
    """Where everything goes, in the base frame of the robot in the middle, turned upright [m]."""

    parts: dict[str, tuple[Body, ...]]
    stalks: dict[str, tuple[Array, Array]]
    points: dict[str, Array]
    measured: Array
    groups: dict[str, tuple[Array, tuple[str, ...]]]
    foot: Array
    size: float
    grid: float
    camera: Camera

    @classmethod
    def of(
        cls, view: View, nominal_visuals: Sequence[Visual], calibrated_visuals: Sequence[Visual]
    ) -> _Layout:
        """Place three groups side by side so that nothing of one reaches into the next."""
        upright = upright_pose(view.nominal, view.q)
        shown = (
            (
                "nominal",
                view.nominal,
                nominal_visuals,
                view.nominal_target,
                upright @ view.T_base_nominal,
            ),
            ("calibrated", view.calibrated, calibrated_visuals, view.calibrated_target, upright),
        )
        stalks, parts = {}, {}
        for who, robot, visuals, target, T_robot in shown:
            T_tip = T_robot @ robot.poses(view.q)[0]
            stalks[who] = (T_tip[:3, 3], T_tip[:3, :3] @ target + T_tip[:3, 3])
            parts[who] = tuple(
                replace(body, T_base_shape=T_robot @ body.T_base_shape)
                for body in bodies(robot, view.q, visuals)
            )
        points = {who: stalk[1] for who, stalk in stalks.items()}
        measured = view.measured @ upright[:3, :3].T
        if view.index is not None:
            points["measured"] = measured[view.index]
        links = link_poses(view.nominal, view.q).values()
        joints = np.array([upright[:3, :3] @ T[:3, 3] for T in links])
        drawn = [body.outline() for who in parts for body in parts[who]]
        outline = np.concatenate([*drawn, joints, *[point[None] for point in points.values()]])
        low, high = outline.min(axis=0), outline.max(axis=0)
        size = max(float(np.linalg.norm(high - low)), 1e-3)
        back = row_direction(joints)
        right = np.array([-back[1], back[0], 0.0])
        along = outline @ right
        step = max(np.ptp(along) + 0.22 * size, 0.5 * size) * right
        groups = {
            "nominal": (-step, ("nominal",)),
            "both": (0.25 * size * back, ("nominal", "calibrated")),
            "calibrated": (step, ("calibrated",)),
        }
        foot = np.array([*(0.5 * (along.min() + along.max()) * right)[:2], low[2]])
        standing = outline[outline[:, 2] < low[2] + 0.2 * size] @ back
        foot += standing.max() * back
        # A wild measurement must not make the robots small.
        near_by = np.linalg.norm(measured - 0.5 * (low + high), axis=1) < size
        everything = np.concatenate(
            [np.vstack([outline, foot]) + offset for offset, _ in groups.values()]
            + [measured[near_by] + groups["both"][0]]
        )
        return cls(
            parts=parts,
            stalks=stalks,
            points=points,
            measured=measured,
            groups=groups,
            foot=foot,
            size=size,
            grid=round_length(size / 7.0),
            camera=look_at(everything, back),
        )


def _draw_robot(scene: meshcat.Visualizer, layout: _Layout, who: str, *, over: bool) -> None:
    """One robot with its target; translucent if it is the calibrated one laid over the nominal."""
    material = _material(who, translucent=over and who == "calibrated")
    for i, body in enumerate(layout.parts[who]):
        node = scene[f"{i:03d}"]
        shape, T_shape_mesh = mesh_geometry(body.shape)
        node.set_object(shape, material)
        node.set_transform(body.T_base_shape @ T_shape_mesh)
    ball = _BALL * layout.size
    tip, target = layout.stalks[who]
    solid = _material(who)
    scene["target"].set_object(mc.Sphere(ball), solid)
    scene["target"].set_transform(translation(target))
    length = float(np.linalg.norm(target - tip))
    if length > ball:
        rod = Body("", Cylinder(0.3 * ball, length), rod_pose(tip, target))
        shape, T_shape_mesh = mesh_geometry(rod.shape)
        scene["stalk"].set_object(shape, solid)
        scene["stalk"].set_transform(rod.T_base_shape @ T_shape_mesh)


def _draw_measured(scene: meshcat.Visualizer, index: int | None, layout: _Layout) -> None:
    """The measured points; the one of the pose shown as large as the targets."""
    if not len(layout.measured):
        return
    colour = int(COLOURS["measured"][1:], 16)
    if len(layout.measured) <= _MOST_BALLS:
        small = mc.Sphere(_SMALL_BALL * layout.size)
        material = mc.MeshPhongMaterial(color=colour, opacity=0.45)
        for i, point in enumerate(layout.measured):
            if i == index:
                continue
            scene[f"{i:03d}"].set_object(small, material)
            without_shadow(scene[f"{i:03d}"])
            scene[f"{i:03d}"].set_transform(translation(point))
    else:
        dots = layout.measured.T.astype(np.float32)
        rgb = [colour >> 16, colour >> 8 & 255, colour & 255]
        shade = np.tile(np.array(rgb, dtype=np.float32)[:, None] / 255, len(layout.measured))
        cloud = mc.PointCloud(dots, shade, size=0.6 * _SMALL_BALL * layout.size)
        scene["dots"].set_object(cloud)
        without_shadow(scene["dots"])
    if index is not None:
        scene["here"].set_object(mc.Sphere(_BALL * layout.size), mc.MeshPhongMaterial(color=colour))
        scene["here"].set_transform(translation(layout.measured[index]))


def _material(who: str, *, translucent: bool = False) -> mc.MeshPhongMaterial:
    """The surface of a robot."""
    kwargs = {"color": int(COLOURS[who][1:], 16), "shininess": 35, "specular": 0x2A2A2A, "side": 2}
    if translucent:
        # A little towards the eye, so that surfaces a fraction of a millimetre apart do not flicker.
        offset = {"polygonOffset": True, "polygonOffsetFactor": -1.0, "polygonOffsetUnits": -4.0}
        return mc.MeshPhongMaterial(opacity=0.5, **kwargs, **offset)
    return mc.MeshPhongMaterial(**kwargs)
