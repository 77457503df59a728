"""Where two robots stand: side by side or one over the other, with a camera for each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.model.robot import rigid_inverse
from calib.show.bodies import root_poses
from calib.show.camera import Camera, look_at, row_direction
from calib.show.page import round_length
from calib.show.puppet import Puppet, stage_poses
from calib.show.view import View

Array = NDArray[np.float64]

#: Between slider and legend below and the heading above, as a part of the picture, see `look_at`.
_TEXT = (-0.54, 0.67)


@dataclass(frozen=True, slots=True, eq=False)
class Arrangement:
    """Where everything goes on the stage [m].

    Attributes:
        offsets: Where each robot stands when they stand side by side, shape (3,).
        foot: shape (3,), below the middle of a robot, towards the camera: where its label stands.
        size: Diagonal of one robot and the points that it reaches.
        grid: Edge of a square of the floor.
        side: The camera when they stand side by side; its centre is the scene's origin.
        over: The camera when one is laid over the other.
    """

    offsets: Mapping[str, Array]
    foot: Array
    size: float
    grid: float
    side: Camera
    over: Camera

    @classmethod
    def of(cls, view: View, shown: Mapping[str, Puppet]) -> Arrangement:
        """Place the robots side by side so that nothing of one reaches into the other.

        Args:
            view: The view.
            shown: Its robots.
        """
        drawn = [body.outline() for puppet in shown.values() for body in puppet.bodies(view.start)]
        links = root_poses(view.nominal, view.q[view.start, None])
        T_stage_root = stage_poses(view)[view.start] @ rigid_inverse(links[view.nominal.base][0])
        joints = np.array([(T_stage_root @ T[0])[:3, 3] for T in links.values()])
        start = np.concatenate([joints, *drawn])
        reached = np.concatenate([puppet.reach() for puppet in shown.values()])
        outline = np.concatenate([start, reached])
        low, high = outline.min(axis=0), outline.max(axis=0)
        size = max(float(np.linalg.norm(high - low)), 1e-3)
        back = row_direction(joints)
        right = np.array([-back[1], back[0], 0.0])
        along = outline @ right
        step = 0.5 * max(np.ptp(along) + 0.06 * size, 0.4 * size) * right
        offsets = (
            {"nominal": -step, "calibrated": step} if len(shown) > 1 else {"nominal": 0 * step}
        )
        at_start = start @ right
        foot = np.array([*(0.5 * (at_start.min() + at_start.max()) * right)[:2], start[:, 2].min()])
        foot += (start[start[:, 2] < foot[2] + 0.2 * size] @ back).max() * back
        # A wild measurement must not make the robots small: what was measured far away is not looked at.
        one = np.vstack([outline, foot])
        return cls(
            offsets=offsets,
            foot=foot,
            size=size,
            grid=round_length(size / 7.0),
            side=look_at(np.concatenate([one + at for at in offsets.values()]), back, _TEXT),
            over=look_at(one, back, _TEXT),
        )

    def labels(self) -> dict[str, Array]:
        """Where the robots' labels stand in the scene, shape (3,) each; ``"over"`` where one is laid over the other."""
        result = {
            who: offset + self.foot - self.side.centre for who, offset in self.offsets.items()
        }
        return {**result, "over": self.foot - self.over.centre}
