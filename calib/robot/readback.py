"""Reading back what was written: a corrected URDF must say what the model in memory says.

Two readers that share no code with the writer: Pinocchio, which the model itself stands on, and yourdfpy.
"""

from __future__ import annotations

import io
import logging
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from calib.errors import UrdfError
from calib.robot.robot import Robot, read_only, rigid_inverse
from calib.robot.urdf import Urdf, UrdfJoint

TOLERANCE = 1e-9  #: A pose read back may differ from the model's by this [m and rad].
SPREAD = 200  #: Joint values spread over the limits.
_POSES, _SEED = (
    20,
    20170401,
)  #: Sets of joint values compared, and the seed that they are drawn with.

Array = NDArray[np.float64]


def check_written(robot: Robot, expected: Array, q: Array) -> None:
    """Compare a robot's URDF, read by Pinocchio and by yourdfpy, with poses T_base_tip (N, 4, 4) [m] at q (N, m).

    Raises:
        UrdfError: A reader disagrees by more than `TOLERANCE`, or cannot read the URDF at all.
    """
    again = robot.rebuilt(Urdf.from_bytes(robot.urdf.data, "the corrected URDF"))
    for reader, poses in (
        ("Pinocchio", again.poses(q)),
        ("yourdfpy", _poses_by_yourdfpy(robot, q)),
    ):
        off = np.abs(poses - expected)
        if not off.max() <= TOLERANCE:
            raise UrdfError(
                f"The corrected URDF, read back by {reader}, puts the tip {off[:, :3, 3].max():.2e} m and "
                f"{off[:, :3, :3].max():.2e} rad away from the model in memory; {TOLERANCE:g} is allowed. It is not "
                "written. Please report this with the URDF."
            )


def random_joint_values(robot: Robot, count: int = _POSES, seed: int = _SEED) -> Array:
    """Joint values inside the limits (within one turn, or one metre, where they are wider or missing), (count, m)."""
    low, high = column_ranges(robot).T
    share: Array = np.random.default_rng(seed).uniform(size=(count, len(low)))
    return np.asarray(low + (high - low) * share)


@lru_cache(maxsize=16)
def spread_poses(robot: Robot, count: int = SPREAD) -> NDArray[np.float64]:
    """Joint values spread evenly over `column_ranges`, shape (count, m)."""
    return spread_between(column_ranges(robot), count)


def spread_between(ranges: Array, count: int) -> Array:
    """Rows of an unscrambled Sobol sequence between the bounds ``ranges``, shape (m, 2); shape (count, m)."""
    from scipy.stats import qmc

    low, high = ranges.T
    sequence = qmc.Sobol(len(low), scramble=False)
    sequence.fast_forward(
        1
    )  # its first point is the corner where every joint is at its lower limit
    return read_only(low + sequence.random(count) * (high - low))


def column_ranges(robot: Robot) -> NDArray[np.float64]:
    """Lowest and highest value of each column of q, shape (m, 2), [rad] or [m].

    The part of the joint's limits within one turn or metre of zero, narrowed so that joints of the chain that mimic the
    column's stay inside their limits too, where both can be had.
    """
    ranges = np.array([_joint_range(joint) for joint in robot.inputs])
    offset = robot.chain_values(np.zeros(len(ranges)))[0]
    for row, joint, at_zero in zip(robot.coupling, robot.joints, offset, strict=True):
        for column in np.flatnonzero(row):
            if joint.name != robot.joint_names[column]:
                ends = (np.array(_joint_range(joint)) - at_zero) / row[column]
                low = max(ranges[column, 0], ends.min())
                high = min(ranges[column, 1], ends.max())
                if low < high:
                    ranges[column] = low, high
    return read_only(ranges)


def _joint_range(joint: UrdfJoint) -> tuple[float, float]:
    """The part of a joint's limits within one turn or metre of zero, or their end that is nearer to zero."""
    bound = 1.0 if joint.type == "prismatic" else np.pi
    lower = -np.inf if joint.lower is None else joint.lower
    upper = np.inf if joint.upper is None else joint.upper
    low, high = min(max(-bound, lower), upper), max(min(bound, upper), lower)
    return low, max(low, high)


def _poses_by_yourdfpy(robot: Robot, q: Array) -> Array:
    """T_base_tip as yourdfpy computes it from the URDF's text, shape (N, 4, 4), [m]."""
    import yourdfpy

    logger = logging.getLogger("yourdfpy.urdf")
    logger.disabled = True  # its warnings about the rest of the robot, mimic joints for one
    try:
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
    except (
        Exception
    ) as error:  # whatever a foreign reader raises, the file is not fit to be given out
        raise UrdfError(
            f"yourdfpy cannot read the corrected URDF of '{robot.name}', so it is not written: {error}"
        ) from error
    finally:
        logger.disabled = False
    # yourdfpy slides by q times the axis as it is written; the axis is a direction, of any length.
    values = robot.chain_values(q) / [
        np.linalg.norm(model.joint_map[joint.name].axis) if joint.type == "prismatic" else 1.0
        for joint in robot.joints
    ]
    poses = np.empty((len(values), 4, 4))
    for i, row in enumerate(values):
        model.update_cfg(
            {joint.name: value for joint, value in zip(robot.joints, row, strict=True)}
        )
        poses[i] = rigid_inverse(model.get_transform(robot.base)) @ model.get_transform(robot.tip)
    return poses
