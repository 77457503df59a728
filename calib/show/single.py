"""A page of one robot: where everything goes, and the stage about it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import meshcat
import numpy as np
from numpy.typing import NDArray

from calib.model.robot import Robot
from calib.show.bodies import Body, link_poses
from calib.show.camera import Camera, look_at, row_direction
from calib.show.page import SCENE, escaped, filled_page, grid_text, round_length
from calib.show.stage import Page, draw_stage, translation, upright_pose
from calib.show.window import SceneWindow

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Where everything goes; lengths [m], the floor and the camera in the base frame turned upright.

    Attributes:
        parts: The robot's shapes.
        upright: shape (4, 4), how the base is turned so that up is up.
        size: Diagonal of all that is seen.
        floor: Height of what the robot stands on; other things may reach below.
        grid: Edge of a square of the floor.
        camera: From where all of it is seen.
    """

    parts: tuple[Body, ...]
    upright: Array
    size: float
    floor: float
    grid: float
    camera: Camera

    @classmethod
    def of(cls, robot: Robot, q: Array, parts: tuple[Body, ...], points: Array) -> Layout:
        """See all of a robot and some points.

        Args:
            robot: The robot.
            q: shape (m,), [rad] or [m], how it stands.
            parts: Its shapes there.
            points: shape (K, 3), in the base [m].
        """
        upright = upright_pose(robot, q)
        joints = np.array([T[:3, 3] for T in link_poses(robot, q).values()])
        drawn = np.concatenate([joints, *[body.outline() for body in parts]])
        everything = np.concatenate([drawn, points]) @ upright[:3, :3].T
        size = max(float(np.linalg.norm(np.ptp(everything, axis=0))), 1e-3)
        return cls(
            parts=parts,
            upright=upright,
            size=size,
            floor=float((drawn @ upright[:3, :3].T)[:, 2].min()),
            grid=round_length(size / 7.0),
            camera=look_at(everything, row_direction(joints @ upright[:3, :3].T)),
        )


def single_page(
    layout: Layout,
    draw: Callable[[meshcat.Visualizer], list[str]],
    *,
    title: str,
    text: str,
    warnings: Sequence[str],
) -> Page:
    """A page of one scene.

    Args:
        layout: Where everything goes.
        draw: Draws below the node given, in the base frame, and returns the lines of the legend, HTML.
        title: The heading, plain text.
        text: Sentences below it, plain text.
        warnings: What could not be drawn as the URDF says.
    """
    window = SceneWindow()
    root = meshcat.Visualizer.view_into(window, meshcat.path.Path())
    draw_stage(
        root,
        layout.camera,
        size=layout.size,
        floor=layout.floor,
        grid=layout.grid,
        through=np.zeros(3),
    )
    scene = root[SCENE]
    scene.set_transform(translation(-layout.camera.centre) @ layout.upright)
    keys = draw(scene)
    html = filled_page(
        title=title,
        facts=f"<p>{escaped(text)}</p>" if text else "",
        warnings=warnings,
        legend="".join([*keys, grid_text(layout.grid)]),
        scene=window.scene(),
    )
    return Page(html, tuple(warnings))
