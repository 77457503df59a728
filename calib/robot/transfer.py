"""A correction found on one description of a robot, put into another whose link frames are elsewhere.

Two descriptions, U and M, are of one robot if the axes of their joints are the same lines at joint values of zero,
with the same directions, seen from bases that may differ:

    T_baseM_i = B T_baseU_i C_i,    C_i a_M = a_U,    C_i moves along the axis only

with a constant C_i for the frame of each joint, so that both move alike at all values. Of the corrected placements of
U, those of M follow:

    P'_Mi = C_(i-1)^-1 P'_Ui C_i,    C_0 = B^-1

B is the least-squares fit of the axes: of their directions and of the shortest way from each line to each other one.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array, Mask, read_only, rigid_inverse
from calib.errors import ModelError, choices
from calib.robot.robot import Robot

#: Axes of the two descriptions may differ by this at most [m and rad]: descriptions round to 0.01 mm, other types of a
#: robot differ by millimetres.
TOLERANCE = 1e-4

#: Lines whose directions differ by less are taken as parallel [rad].
_PARALLEL = 1e-2


@dataclass(frozen=True, slots=True, eq=False)
class Transfer:
    """A corrected robot in another description."""

    #: The other description, corrected.
    robot: Robot
    #: Shape (4, 4), [m]: pose of the first description's base in that of the other one, B.
    T_base_base: Array
    #: Shape (4, 4), [m]: pose of the other one's tip in that of the first one.
    T_tip_tip: Array
    #: Largest distance [m] and angle [rad] between axes of the two nominal descriptions.
    off: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class _Axes:
    """The axes of a chain in its base, at joint values of zero."""

    #: Shape (n, 4, 4), [m], the frames of the joints in the base.
    frames: Array
    #: Shape (n, 3), unit vectors.
    directions: Array
    #: Shape (n, 3), [m], a point of each axis.
    points: Array
    #: Shape (n,), True for joints that slide, whose axes are nowhere.
    slides: Mask

    @classmethod
    def of(cls, robot: Robot) -> _Axes:
        """Return the axes of a chain."""
        T = rigid_inverse(robot.T_root_base)
        frames = []
        for placement in robot.placements[:-1]:
            T = T @ placement
            frames.append(T)
        poses = np.array(frames)
        own = np.array([joint.axis for joint in robot.joints])
        return cls(
            poses,
            np.einsum("nij,nj->ni", poses[:, :3, :3], own),
            poses[:, :3, 3],
            np.array([joint.type == "prismatic" for joint in robot.joints]),
        )

    def first(self, count: int) -> _Axes:
        """Return the first axes."""
        return _Axes(
            self.frames[:count], self.directions[:count], self.points[:count], self.slides[:count]
        )


def transferred(nominal: Robot, corrected: Robot, other: Robot) -> Transfer:
    """Put a correction into another description of the same robot.

    Args:
        nominal: The robot before, one chain of n joints.
        corrected: The same chain with other placements.
        other: The chain of the other description, with its own names; its n joints are those of ``nominal`` in order.

    Returns:
        The other description, corrected, with how its base and tip lie to those of the first one.

    Raises:
        ModelError: The two are not one robot; the text names the first joint that differs, and by how much.
        UrdfError: The tip of the other one has no place for a correction.
    """
    _check_joints(nominal, other)
    axes, other_axes = _Axes.of(nominal), _Axes.of(other)
    off = (0.0, 0.0)
    B = np.eye(4)
    for count in range(1, len(nominal.joints) + 1):
        B = _fit(axes.first(count), other_axes.first(count))
        distances, angles = _offs(B, axes.first(count), other_axes.first(count))
        off = (float(distances.max()), float(angles.max()))
        if max(off) > TOLERANCE:
            one, two = nominal.joints[count - 1].name, other.joints[count - 1].name
            raise ModelError(
                f"'{nominal.urdf.source}' and '{other.urdf.source}' are not the same robot: with the axes of the "
                f"joints up to '{one}' laid on those up to '{two}', they are {1e3 * off[0]:.3g} mm and "
                f"{np.degrees(off[1]):.3g} deg apart at joint values of zero; {1e3 * TOLERANCE:g} mm and "
                f"{np.degrees(TOLERANCE):.2g} deg are allowed. Look for another type or zero of the joint '{two}'."
            )

    # C_0 to C_(n + 1): the last one takes the tips to each other.
    changes = [rigid_inverse(B)]
    for frame, other_frame, joint, other_joint in zip(
        axes.frames, other_axes.frames, nominal.joints, other.joints, strict=True
    ):
        C = rigid_inverse(B @ frame) @ other_frame
        changes.append(_along_axis(C, joint.axis, other_joint.axis, joint.type == "prismatic"))
    tip = axes.frames[-1] @ nominal.placements[-1]
    other_tip = other_axes.frames[-1] @ other.placements[-1]
    changes.append(rigid_inverse(B @ tip) @ other_tip)

    placements = []
    for i, placement in enumerate(corrected.placements):
        P = rigid_inverse(changes[i]) @ _in_base(nominal, i, placement) @ changes[i + 1]
        placements.append(other.T_root_base @ P if i == 0 else P)
    return Transfer(
        other.with_placements(np.array(placements)), read_only(B), read_only(changes[-1]), off
    )


def _in_base(robot: Robot, index: int, placement: Array) -> Array:
    """Return a placement (4, 4), the first one in the robot's base."""
    return rigid_inverse(robot.T_root_base) @ placement if index == 0 else placement


def _check_joints(nominal: Robot, other: Robot) -> None:
    """Refuse by `ModelError` a chain that has other joints, or that moves them otherwise by the columns of q."""
    kinds = [
        ["slides" if j.type == "prismatic" else "turns" for j in r.joints] for r in (nominal, other)
    ]
    if kinds[0] != kinds[1]:
        names = [choices(joint.name for joint in robot.joints) for robot in (nominal, other)]
        raise ModelError(
            f"'{nominal.urdf.source}' has the joints {names[0]} between base and tip, and '{other.urdf.source}' has "
            f"{names[1]}: their number, or what turns and what slides, differs. Name the other one's links by --base "
            "and --tip."
        )
    zeros = np.zeros((1, len(nominal.joint_names)))
    units = np.eye(len(nominal.joint_names))
    same = len(other.joint_names) == len(nominal.joint_names) and all(
        np.allclose(nominal.chain_values(q), other.chain_values(q), rtol=0.0, atol=TOLERANCE)
        for q in (zeros, units)
    )
    if not same:
        raise ModelError(
            f"'{nominal.urdf.source}' and '{other.urdf.source}' move their joints differently by the same readings: "
            "joints that follow others, or are held, differ between base and tip."
        )


def _fit(axes: _Axes, other: _Axes) -> Array:
    """Return B, shape (4, 4), [m], which lays axes on others as well as it can."""
    pairs = list(zip(axes.directions, other.directions, strict=True))
    for i, j in combinations(np.flatnonzero(~axes.slides).tolist(), 2):
        parallel = [
            np.linalg.norm(np.cross(lines.directions[i], lines.directions[j])) < _PARALLEL
            for lines in (axes, other)
        ]
        if parallel[0] == parallel[1]:
            pairs.append((_way(axes, i, j, parallel[0]), _way(other, i, j, parallel[0])))
    H = sum(np.outer(g, u) for u, g in pairs)
    left, _, right = np.linalg.svd(H)
    B = np.eye(4)
    B[:3, :3] = left @ np.diag([1.0, 1.0, np.linalg.det(left) * np.linalg.det(right)]) @ right
    # The translation, of which what leaves all lines where they are is zero.
    rows, values = [np.zeros((3, 3))], [np.zeros(3)]
    for i in np.flatnonzero(~axes.slides):
        across = np.eye(3) - np.outer(other.directions[i], other.directions[i])
        rows.append(across)
        values.append(across @ (other.points[i] - B[:3, :3] @ axes.points[i]))
    B[:3, 3] = np.linalg.lstsq(np.vstack(rows), np.concatenate(values), rcond=1e-9)[0]
    return B


def _way(axes: _Axes, i: int, j: int, parallel: np.bool_) -> Array:
    """Return the shortest way (3,) [m] from one line to another."""
    between = axes.points[j] - axes.points[i]
    if parallel:
        return np.asarray(between - (between @ axes.directions[i]) * axes.directions[i])
    normal = np.cross(axes.directions[i], axes.directions[j])
    return np.asarray(normal * (between @ normal) / (normal @ normal))


def _offs(B: Array, axes: _Axes, other: _Axes) -> tuple[Array, Array]:
    """Return the distances [m] and angles [rad] of axes, moved by B, from others, (n,) each."""
    directions = axes.directions @ B[:3, :3].T
    across = axes.points @ B[:3, :3].T + B[:3, 3] - other.points
    across -= np.sum(across * other.directions, axis=1)[:, None] * other.directions
    distances: Array = np.where(axes.slides, 0.0, np.linalg.norm(across, axis=1))
    sines = np.linalg.norm(np.cross(directions, other.directions), axis=1)
    angles: Array = np.arctan2(sines, np.sum(directions * other.directions, axis=1))
    return distances, angles


def _along_axis(C: Array, axis: Array, other_axis: Array, slides: bool) -> Array:
    """Return the pose (4, 4) nearest to C that takes one axis to the other exactly, and moves along it only."""
    result: Array = np.array(C)
    turned = C[:3, :3] @ other_axis
    vector = np.cross(turned, axis)
    sine = float(np.linalg.norm(vector))
    if sine > 0.0:
        angle = np.arctan2(sine, float(turned @ axis))
        result[:3, :3] = Rotation.from_rotvec(vector * angle / sine).as_matrix() @ C[:3, :3]
    if not slides:
        result[:3, 3] = (C[:3, 3] @ axis) * axis
    return result
