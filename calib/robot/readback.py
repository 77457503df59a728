"""Reading back what was written: a corrected URDF must say what the model in memory says.

Two readers that share no code with the writer: Pinocchio, which the model itself stands on, and yourdfpy.
"""

from __future__ import annotations

import io
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from calib.errors import UrdfError
from calib.robot.robot import Robot, read_only, rigid_inverse
from calib.robot.urdf import Urdf, UrdfJoint

#: A pose read back may differ from the model's by this [m and rad].
TOLERANCE = 1e-9

#: Joint values spread over the limits.
SPREAD = 200

#: Sets of joint values compared, and the seed they are drawn with: the same every time.
_POSES, _SEED = 20, 20170401

Array = NDArray[np.float64]


def check_written(robot: Robot, expected: Array, q: Array) -> None:
    """Compare a robot's URDF, read by Pinocchio and by yourdfpy, with poses computed otherwise.

    Args:
        robot: The robot whose ``urdf`` is to be written.
        expected: shape (N, 4, 4), T_base_tip of the model in memory [m].
        q: shape (N, m), joint values [rad or m] in the order of ``robot.joint_names``.

    Raises:
        UrdfError: A reader disagrees by more than `TOLERANCE`, or cannot read the URDF at all.
    """
    again = Urdf.from_bytes(robot.urdf.data, "the corrected URDF")
    _compare("Pinocchio", robot.rebuilt(again).poses(q), expected)
    _compare("yourdfpy", _poses_by_yourdfpy(robot, q), expected)


def random_joint_values(robot: Robot, count: int = _POSES, seed: int = _SEED) -> Array:
    """Joint values inside the limits (within one turn, or one metre, where they are wider or missing), (count, m)."""
    low, high = column_ranges(robot).T
    share: Array = np.random.default_rng(seed).uniform(size=(count, len(low)))
    return np.asarray(low + (high - low) * share)


@lru_cache(maxsize=16)
def spread_poses(robot: Robot, count: int = SPREAD) -> NDArray[np.float64]:
    """Joint values spread evenly over the limits (one turn or one metre where there are none), shape (count, m).

    An unscrambled Sobol sequence: the same for every call.
    """
    return spread_between(column_ranges(robot), count)


def spread_between(ranges: Array, count: int) -> Array:
    """Values spread evenly between bounds, an unscrambled Sobol sequence, shape (count, m).

    Args:
        ranges: shape (m, 2), lowest and highest value of each column.
        count: Number of rows.
    """
    low, high = ranges.T
    from scipy.stats import qmc

    sequence = qmc.Sobol(len(low), scramble=False)
    # The first point of the sequence is the corner where every joint is at its lower limit.
    sequence.fast_forward(1)
    unit = sequence.random(count)
    return read_only(low + unit * (high - low))


def column_ranges(robot: Robot) -> NDArray[np.float64]:
    """Lowest and highest value of each column of q, shape (m, 2), [rad] or [m].

    Those of `joint_range`, narrowed so that joints of the chain that mimic the column's stay inside their limits too,
    where both can be had.
    """
    ranges = np.array([joint_range(joint) for joint in robot.inputs])
    offset = robot.chain_values(np.zeros(len(ranges)))[0]
    for row, joint, at_zero in zip(robot.coupling, robot.joints, offset, strict=True):
        for column in np.flatnonzero(row):
            if joint.name != robot.joint_names[column]:
                ends = (np.array(joint_range(joint)) - at_zero) / row[column]
                low = max(ranges[column, 0], ends.min())
                high = min(ranges[column, 1], ends.max())
                if low < high:
                    ranges[column] = low, high
    return read_only(ranges)


def joint_range(joint: UrdfJoint) -> tuple[float, float]:
    """The part of a joint's limits within one turn or one metre of zero, [rad] or [m]."""
    bound = 1.0 if joint.type == "prismatic" else np.pi
    lower = -np.inf if joint.lower is None else joint.lower
    upper = np.inf if joint.upper is None else joint.upper
    # Limits that leave the turn or metre out altogether: the one that is nearer to zero.
    low, high = min(max(-bound, lower), upper), max(min(bound, upper), lower)
    return low, max(low, high)


def _poses_by_yourdfpy(robot: Robot, q: Array) -> Array:
    """T_base_tip as yourdfpy computes it from the URDF's text, shape (N, 4, 4), [m]."""
    import yourdfpy

    try:
        with _quiet("yourdfpy.urdf"):
            parsed = yourdfpy.URDF.load(
                io.BytesIO(robot.urdf.data),
                build_scene_graph=False,
                load_meshes=False,
                load_collision_meshes=False,
            ).robot
            # Every joint of the chain is given its value, and yourdfpy takes none for one that mimics another.
            for joint in parsed.joints:
                joint.mimic = None
            model = yourdfpy.URDF(parsed, load_meshes=False, load_collision_meshes=False)
    # Whatever a foreign reader raises, the file is not fit to be given out.
    except Exception as error:
        raise UrdfError(
            f"yourdfpy cannot read the corrected URDF of '{robot.name}', so it is not written: {error}"
        ) from error
    names = [joint.name for joint in robot.joints]
    # yourdfpy slides by q times the axis as it is written; the axis is a direction, of any length.
    values = robot.chain_values(q) / [
        np.linalg.norm(model.joint_map[joint.name].axis) if joint.type == "prismatic" else 1.0
        for joint in robot.joints
    ]
    poses = np.empty((len(values), 4, 4))
    for i, row in enumerate(values):
        model.update_cfg(dict(zip(names, row, strict=True)))
        poses[i] = rigid_inverse(model.get_transform(robot.base)) @ model.get_transform(robot.tip)
    return poses


@contextmanager
def _quiet(name: str) -> Iterator[None]:
    """Keep a reader's warnings about the rest of the robot, mimic joints for one, out of the user's terminal."""
    logger = logging.getLogger(name)
    before = logger.disabled
    logger.disabled = True
    try:
        yield
    finally:
        logger.disabled = before


def _compare(reader: str, poses: Array, expected: Array) -> None:
    """Refuse poses that differ in position or in any entry of the rotation."""
    distance = float(np.abs(poses[:, :3, 3] - expected[:, :3, 3]).max())
    turn = float(np.abs(poses[:, :3, :3] - expected[:, :3, :3]).max())
    if not (distance <= TOLERANCE and turn <= TOLERANCE):
        raise UrdfError(
            f"The corrected URDF, read back by {reader}, puts the tip {distance:.2e} m and {turn:.2e} rad away from "
            f"the model in memory; {TOLERANCE:g} is allowed. It is not written. Please report this with the URDF."
        )
