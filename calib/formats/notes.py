"""What a conversion begins with, and what it has to say: codes with values; `calib.text.convert` has the sentences."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.formats.ur_arms import UrModel
from calib.formats.ur_files import Conf
from calib.robot.readback import spread_poses
from calib.robot.robot import Robot

Array = NDArray[np.float64]

Code = Literal[
    "arm by name",
    "arm by kinematics",
    "arm not certain",
    "no hash",
    "nominal hash",
    "not linearised",
    "base displaced",
    "flange displaced",
    "digits lost",
    "other lines kept",
    "other lines left out",
    "joints without origin",
    "geometry alone",
    "nearly parallel axes",
    "joints without value",
]


class Note(NamedTuple):
    """A code and its values, in SI units."""

    code: Code
    values: tuple[str | float, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """A robot read from a file of some kind, and the same chain with nominal kinematics, if these are known.

    Of Universal Robots' files also the driver's name of the calibration, the arm, and a ``calibration.conf``.
    """

    kind: str
    robot: Robot
    nominal: Robot | None
    hash: str | None = None
    model: UrModel | None = None
    conf: Conf | None = None
    notes: tuple[Note, ...] = ()

    def distances(self) -> tuple[Array, Array] | None:
        """How far the tip lies from the nominal robot's, over the joint limits: shape (N,), [m], and (N,), [rad]."""
        if self.nominal is None:
            return None
        q = spread_poses(self.nominal)
        apart = self.robot.poses(q)[:, :3] - self.nominal.poses(q)[:, :3]
        chord = np.linalg.norm(apart[:, :, :3], axis=(1, 2)) / np.sqrt(8.0)
        turned = 2.0 * np.arcsin(np.clip(chord, 0.0, 1.0))
        return np.linalg.norm(apart[:, :, 3], axis=1), turned


def displaced(code: Code, T: Array) -> tuple[Note, ...]:
    """A displacement T (4, 4) that a file has no place for: three lengths [m] and a rotation vector [rad]."""
    vector = np.round([*T[:3, 3], *pin.log3(T[:3, :3])], 9) + 0.0
    return (Note(code, tuple(vector.tolist())),) if np.any(vector) else ()
