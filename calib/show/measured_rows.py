"""Where the targets of measured rows were: frame and target of each row, and positions in the base."""

from __future__ import annotations

import numpy as np

from calib.basics.arrays import Array, Integers, rigid_inverse
from calib.data.measurements import Measurements
from calib.fit.registration.setup import Setup
from calib.robot.robot import Robot


def setup_of_rows(setup: Setup, m: Measurements) -> tuple[Array, Array]:
    """Return the poses of frame and target that each row was measured with.

    Args:
        setup: Frames of the stations and targets.
        m: N rows; each names its station (``groups``) and its target.

    Returns:
        T_frame_base and T_tip_target of each row, shapes (N, 4, 4), [m].
    """
    frames = [setup.groups.index(group) for group in m.groups]
    targets = [setup.targets.index(target) for target in m.targets]
    return setup.T_frame_base[frames], setup.T_tip_target[targets]


def chains_of_rows(robot: Robot, setup: Setup, m: Measurements) -> Integers | None:
    """Return the chain that each row was measured through, shape (N,), by its index in `Robot.chains`; None: one chain.

    Args:
        robot: The robot.
        setup: Frames of the stations and targets, with their links.
        m: N rows; each names its station (``groups``) and its target.
    """
    frames = np.array([setup.groups.index(group) for group in m.groups], dtype=np.int_)
    targets = np.array([setup.targets.index(target) for target in m.targets], dtype=np.int_)
    return setup.chains(robot, frames, targets)


def measured_in_base(m: Measurements, T_frame_base: Array) -> Array:
    """Return the measured positions of the target in the base frame.

    A target in a socket was at the origin of its frame. Distances, planes and images measure no position.

    Args:
        m: N rows.
        T_frame_base: shape (N, 4, 4), base in each row's measurement frame [m].

    Returns:
        shape (N, 3), [m]; NaN in rows that measured no position.
    """
    T_base_frame = rigid_inverse(T_frame_base)
    rotation = T_base_frame[:, :3, :3]
    origin = T_base_frame[:, :3, 3]
    points = np.nan_to_num(m.points)
    places = np.einsum("nij,nj->ni", rotation, points) + origin
    is_measured = m.where(lambda kind: kind.coordinates)
    return np.where(is_measured[:, None], places, np.nan)
