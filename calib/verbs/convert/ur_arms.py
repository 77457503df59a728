"""The Universal Robots arms: the poses of their chains, the hash of their kinematics, and the nominal robot of each.

Universal Robots writes standard (distal) DH without any row for nearly parallel axes,

    T_i(q) = Rz(theta_i + q_i) Tz(d_i) Tx(a_i) Rx(alpha_i),

so that in a calibrated arm d_2 and d_3 are hundreds of metres. *Rows* are theta, a, d, alpha, shape (6, 4), [rad] and
[m]; a file's deltas are added to nominal ones. A *chain* is the same arm as placements of joints that turn about z,
shape (7, 4, 4): joint i in joint i - 1, the first in the controller's base, the seventh its flange in joint 6; with the
nominal rows these are the poses that ``kinematics.yaml`` gives its six links.
"""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import ArrayLike

from calib.basics.arrays import Array, read_only, rigid_inverse
from calib.robot.dh.rows import screw
from calib.robot.generated.universal_robots import UrModel, ur_model, ur_urdf
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf

SPREAD = read_only(np.random.default_rng(20170401).uniform(-np.pi, np.pi, (200, 6)))
"""Joint values within one turn at which arms are compared, shape (200, 6) [rad], the same every time."""

#: MurmurHash64A works with 64 bits.
_MASK = (1 << 64) - 1

#: The multiplier of MurmurHash64A.
_MULTIPLIER = 0xC6A4A7935BD1E995

#: The seed that GNU's standard library hashes texts with.
_SEED = 0xC70F6907


def ur_robot(model: UrModel | str) -> Robot:
    """Return the nominal robot of an arm, from a URDF without its shape.

    Args:
        model: The arm or its name.

    Returns:
        The robot from ``base``, the controller's base, to ``tool0``, its flange.

    Raises:
        ModelError: No arm of this name is known.
    """
    model = ur_model(model)
    urdf = Urdf.from_bytes(ur_urdf(model), f"the nominal {model.name}")
    return Robot.from_urdf(urdf, base="base", tip="tool0")


# Chains


def chain_poses(chain: Array, q: ArrayLike) -> Array:
    """Return the poses of a chain's flange in the controller's base.

    Args:
        chain: Placements, shape (7, 4, 4) [m].
        q: Joint values, shape (N, 6) or (6,) [rad].

    Returns:
        The poses, shape (N, 4, 4) [m].
    """
    joint_values = np.reshape(np.asarray(q, float), (-1, 6))
    T = np.eye(4)[None]
    for placement, column in zip(chain, joint_values.T, strict=False):
        T = T @ placement @ screw(2, column, 0.0)
    return np.asarray(T @ chain[6])


def at_flange(chain: Array) -> Array:
    """Return the same chain with the frame of joint 6 as near to the flange as can be.

    The frame slides along and turns about the joint's axis, which moves no pose.

    Args:
        chain: Placements, shape (7, 4, 4) [m].

    Returns:
        Placements of the same poses, shape (7, 4, 4) [m], read-only.
    """
    result = np.array(chain)
    T_joint_flange = result[6]
    sine = T_joint_flange[1, 0] - T_joint_flange[0, 1]
    cosine = T_joint_flange[0, 0] + T_joint_flange[1, 1]
    G = screw(2, np.arctan2(sine, cosine), T_joint_flange[2, 3])
    result[5] = result[5] @ G
    result[6] = rigid_inverse(G) @ result[6]
    return read_only(result)


# The hash of a controller's kinematics


def kinematics_hash(rows: Array) -> str:
    """Return the name that the ROS driver gives a controller's kinematics.

    The driver prints theta, d, a and alpha of one joint after the other with six digits and takes
    the standard library's hash of that text, which in GNU's library is MurmurHash64A.

    Args:
        rows: theta, a, d, alpha of six joints, shape (6, 4), [rad] and [m].

    Returns:
        ``"calib_"`` and the hash.

    Example:
        >>> kinematics_hash(np.zeros((6, 4)))
        'calib_8811247710799071897'
    """
    in_driver_order = rows[:, [0, 2, 1, 3]]
    text = "".join(f"{value:g}" for value in in_driver_order.flat)
    return f"calib_{_murmur_hash(text.encode())}"


def _murmur_hash(data: bytes) -> int:
    """Return the MurmurHash64A of bytes (A. Appleby), with the seed of GNU's standard library."""
    value = (_SEED ^ (len(data) * _MULTIPLIER)) & _MASK
    end_of_words = len(data) & ~7
    for (word,) in struct.iter_unpack("<Q", data[:end_of_words]):
        mixed = (word * _MULTIPLIER) & _MASK
        mixed = ((mixed ^ (mixed >> 47)) * _MULTIPLIER) & _MASK
        value = ((value ^ mixed) * _MULTIPLIER) & _MASK
    if end_of_words < len(data):
        last_word = int.from_bytes(data[end_of_words:], "little")
        value = ((value ^ last_word) * _MULTIPLIER) & _MASK
    value = ((value ^ (value >> 47)) * _MULTIPLIER) & _MASK
    return value ^ (value >> 47)
