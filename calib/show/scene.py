"""The picture of a calibration: nominal and calibrated robot side by side or overlaid, at every measured pose.

Drawn with meshcat, z up, in one HTML page that holds the viewer, the scene and the poses, opens from disk and loads
nothing from anywhere. The page's script moves the robots from pose to pose and draws what was measured, with arrows at
a stated magnification; see `calib.show.motion` for what it is told. The stage is the calibrated robot's base; where
joints move the base itself, as they do a camera's, it is the root of the URDF.
"""

from __future__ import annotations

import os
from pathlib import Path

import meshcat
import numpy as np
from meshcat import geometry as mc
from numpy.typing import NDArray

from calib.show.arrangement import Arrangement
from calib.show.marks import number
from calib.show.motion import motion_table, thinned
from calib.show.page import SCENE
from calib.show.palette import CALIBRATED, NOMINAL
from calib.show.puppet import Puppet, puppets, rod_between
from calib.show.robots_page import PageParts, robots_page
from calib.show.stage import Page, draw_stage, mesh_geometry, translation
from calib.show.view import View
from calib.show.visuals import Cylinder, Visual, read_visuals, same_visuals
from calib.show.window import SceneWindow

__all__ = ["View", "view_page", "write_view"]

Array = NDArray[np.float64]

#: The robots' colours.
_COLOURS = {"nominal": NOMINAL, "calibrated": CALIBRATED}

#: Radius of the target's ball, as a part of the scene's size, and of the rod to it, as a part of that.
_BALL, _STALK = 0.009, 0.3


def write_view(view: View, path: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
    """Write a view as one HTML file that opens from disk without a network.

    Raises:
        FileError: The file exists and ``overwrite`` is False, or it cannot be written.
    """
    return view_page(view).write(path, overwrite=overwrite)


def view_page(view: View, *, live: bool = False) -> Page:
    """Draw a view.

    Args:
        view: The view; of many poses some hundred are shown, see `calib.show.motion.thinned`.
        live: Whether the page listens to the server that it came from.

    Raises:
        UrdfError: Pinocchio cannot build a model of a URDF.
    """
    view = thinned(view)
    visuals, warnings = _visuals(view)
    shown = puppets(view, visuals)
    layout = Arrangement.of(view, shown)
    window = SceneWindow()
    root = meshcat.Visualizer.view_into(window, meshcat.path.Path())
    draw_stage(
        root,
        layout.side,
        size=layout.size,
        floor=layout.foot[2],
        grid=layout.grid,
        through=layout.offsets["nominal"],
    )
    for who, puppet in shown.items():
        group = root[SCENE][who]
        group.set_transform(translation(layout.offsets[who] - layout.side.centre))
        draw_puppet(group, puppet, view.start, who, _BALL * layout.size)
    parts = PageParts(
        view=view,
        warnings=warnings,
        grid=layout.grid,
        scene=window.scene(),
        motion=motion_table(view, shown, layout, _BALL * layout.size),
        labels=layout.labels(),
        live=live,
    )
    return Page(robots_page(parts), warnings)


def _visuals(view: View) -> tuple[dict[str, tuple[Visual, ...]], tuple[str, ...]]:
    """What each robot looks like, and what could not be drawn as its URDF says."""
    visuals: dict[str, tuple[Visual, ...]] = {}
    warnings: list[str] = []
    for who, robot in view.robots.items():
        if who == "calibrated" and same_visuals(view.nominal.urdf, robot.urdf):
            visuals[who] = visuals["nominal"]
            continue
        visuals[who], more = read_visuals(robot.urdf)
        warnings += more
    return visuals, tuple(dict.fromkeys(warnings))


def draw_puppet(
    group: meshcat.Visualizer, puppet: Puppet, start: int, who: str, ball: float
) -> None:
    """One robot at a pose, each part below its mover, with its target and the rod that carries it.

    Args:
        group: The node that it goes below.
        puppet: The robot.
        start: The pose's number.
        who: ``"nominal"`` or ``"calibrated"``.
        ball: Radius of the target's ball [m].
    """
    at = puppet.poses[start]
    robot, material = group["robot"], _material(who)
    for mover in sorted({part.mover for part in puppet.parts}):
        robot["links"][f"{mover:03d}"].set_transform(at[mover])
    for i, part in enumerate(puppet.parts):
        node = robot["links"][f"{part.mover:03d}"][f"{i:03d}"]
        shape, T_shape_mesh = mesh_geometry(part.shape)
        node.set_object(shape, material)
        node.set_transform(part.T_mover_shape @ T_shape_mesh)
    target = len(at) - 1
    robot["links"][f"{target:03d}"].set_transform(at[target])
    robot["links"][f"{target:03d}"]["ball"].set_object(mc.Sphere(ball), material)
    rods = [(*rod, puppet.radius) for rod in puppet.rods]
    for k, (one, other, radius) in enumerate([*rods, (target - 1, target, _STALK * ball)]):
        node = robot["rods"][f"{k:03d}"]
        T, length = rod_between(at[one, :3, 3], at[other, :3, 3])
        # A rod of length one, stretched: the page's script does the same at every other pose.
        node.set_transform(T @ np.diag([1.0, 1.0, max(length, 1e-9), 1.0]))
        shape, T_shape_mesh = mesh_geometry(Cylinder(radius, 1.0))
        node["rod"].set_object(shape, material)
        node["rod"].set_transform(T_shape_mesh)


def _material(who: str) -> mc.MeshPhongMaterial:
    """The surface of a robot; that of the calibrated one a little towards the eye.

    Where one robot is laid over the other, surfaces a fraction of a millimetre apart would flicker otherwise.
    """
    kwargs: dict[str, float] = {
        "color": number(_COLOURS[who]),
        "shininess": 35,
        "specular": 0x2A2A2A,
        "side": 2,
    }
    if who == "calibrated":
        kwargs |= {"polygonOffset": 1, "polygonOffsetFactor": -1.0, "polygonOffsetUnits": -4.0}
    return mc.MeshPhongMaterial(**kwargs)
