"""Commands for a robot whose controller keeps its own model, such that the true robot arrives (the paper's fourth stage).

The calibrated model says where the true robot stands, T_true(q), the nominal one what its controller believes,
T_nominal(q). For a wanted pose T of the tool:

    q:       T_true(q) = T               joint values to command, in the branch of the nominal solution
    T_send = T_nominal(q)                the pose to send: the controller's own inverse kinematics makes q of it

Both are the same command in two forms. Source: Z. Roth, B. Mooring, B. Ravani, An overview of robot calibration, 1987
("compensation"); poses sent in place of the wanted ones are known as fake targets.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.compensate.program import Program
from calib.model.robot import Robot

if TYPE_CHECKING:
    from calib.identify.result import Calibration
    from calib.identify.stored import StoredResult
    from calib.model.torques import Payload

Array = NDArray[np.float64]

MATCHES = ("pose", "position", "axis", "weighted")
"""What is matched: position and orientation; the position alone; position and direction of the tool's z axis; both as
well as can be, an angle counting as a length (`commands`, ``lever``)."""


@dataclass(frozen=True, slots=True, eq=False)
class Commands:
    """What to command so that the true robot does what a program wants; rows that cannot be reached are NaN.

    Attributes:
        nominal: The robot as its controller has it.
        program: What was asked for.
        match: One of `MATCHES`.
        T_frame_base: shape (4, 4), the base in the frame that poses are given and sent in [m].
        T_wanted: shape (N, 4, 4), pose of the tool that is wanted, in that frame [m]; where only its position was
            given, oriented as the nominal robot's is.
        q_nominal: shape (N, m), joint values that the nominal model has for it [rad] or [m].
        q: shape (N, m), joint values to command [rad] or [m].
        T_send: shape (N, 4, 4), pose to send to a controller with the nominal model, in that frame [m].
        missed: shape (N, 2), how far the true robot would miss at ``q_nominal``, as the calibrated model predicts:
            position [m], angle [rad]. Of the position alone the angle is NaN.
        left: shape (N, 2), how far it misses at ``q`` [m], [rad]: what cannot be reached.
        reasons: Why a row has no command; empty where it has one.
        warnings: For each row what to know of its command; mostly nothing.
    """

    nominal: Robot
    program: Program
    match: str
    T_frame_base: Array
    T_wanted: Array
    q_nominal: Array
    q: Array
    T_send: Array
    missed: Array
    left: Array
    reasons: tuple[str, ...]
    warnings: tuple[tuple[str, ...], ...]

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.q)

    @property
    def reached(self) -> NDArray[np.bool_]:
        """Which rows have a command, shape (N,)."""
        return np.array([not reason for reason in self.reasons])

    @property
    def joint_corrections(self) -> Array:
        """q - q_nominal, shape (N, m), [rad] or [m]."""
        return np.asarray(self.q - self.q_nominal)

    @property
    def pose_corrections(self) -> Array:
        """How far the pose to send is from the one wanted, shape (N, 2): position [m], angle [rad]."""
        raise NotImplementedError

    def write(
        self,
        path: str | Path,
        *,
        send: str = "both",
        orientation: str = "rotation-vector",
        overwrite: bool = False,
    ) -> Path:
        """Write the commands as a table; see docs/compensation.md.

        Args:
            path: Where to.
            send: ``"joints"``, ``"poses"`` or ``"both"``.
            orientation: ``"rotation-vector"``, ``"quaternion"`` or ``"rpy"``.
            overwrite: Whether an existing file may be replaced.

        Raises:
            FileError: The file exists, or cannot be written.
        """
        from calib.compensate.commands_file import write_commands

        return write_commands(self, path, send=send, orientation=orientation, overwrite=overwrite)


def commands(
    calibration: Calibration | StoredResult | Robot,
    program: Program,
    *,
    nominal: Robot | None = None,
    tool: ArrayLike | str | None = None,
    frame: ArrayLike | str | None = None,
    match: str | None = None,
    lever: float = 0.01,
    start: Mapping[str, float] | None = None,
    limit: tuple[float, float] = (0.01, 0.035),
    accept: tuple[float, float] = (1e-8, 1e-8),
    larger: bool = True,
    payload: Payload | None = None,
) -> Commands:
    """What to command so that the true robot does what a program wants.

    Args:
        calibration: What the true robot is: a result, a result that was read, or a corrected robot.
        program: What is wanted.
        nominal: What its controller believes; may be left out with a `Calibration`.
        tool: What is to arrive: a pose in the tip, shape (4, 4) [m], or a position, shape (3,); or the name of a target
            of the calibration ("" for the only one), where the calibrated model has it; default the tip itself.
        frame: The base in the frame that poses are given and sent in, shape (4, 4) [m], or the name of a set-up of the
            calibration ("" for the only one); default the base.
        match: One of `MATCHES`; default ``"pose"``, for fewer than six joints ``"weighted"``, for a program of points
            ``"position"``.
        lever: With ``"weighted"``, the length that an angle of one radian counts as [m].
        start: Joint values by name [rad] or [m], which the first of a program of poses alone starts near; joints that
            are not named start at the middle of their limits.
        limit: Corrections of the pose larger than this are warned of: position [m], angle [rad].
        accept: What may be left of the error: position [m], angle [rad]. Not for ``"weighted"``.
        larger: Whether to use the larger model, where there is one; else the geometry that the URDF holds.
        payload: What the tip carries; None: what it carried when it was calibrated.

    Raises:
        ModelError: A tool, frame, match or joint that does not exist, a program of another robot, or no nominal robot.
    """
    raise NotImplementedError
