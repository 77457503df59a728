"""DH rows out of any chain, the DH offsets' directions for the error model, and placements out of rows again.

Standard (distal) convention, with Hayati's beta where consecutive axes are nearly parallel, because the
common normal of such axes may lie kilometres away (S. Hayati, 1983):

    T_base_n(q) = T_base_0  A_1(q_1) ... A_n(q_n)
    A_i(q_i) = Rz(theta_i + q_i) Tz(d_i) Tx(a_i) Rx(alpha_i) Ry(beta_i)

(a prismatic joint adds q_i to d_i instead). ``beta_i`` is 0 in every row whose axes are not nearly
parallel, and in exactly parallel ones up to rounding; a nearly parallel row has ``d_i = 0``, the last one
apart: its d reaches to the tip. The choices that the
convention leaves open are made so that the rows look as a data sheet prints them: frame 0 is the base
frame where it can be, x_i points as near as possible to x_(i-1) at q = 0, frame n is the tip where it can be.

A row says where the next axis is, not where along and about it the URDF puts the joint's frame. In DH frame i - 1,
whose z is the axis of joint i, that frame is G_i, and so the rows give the placements P:

    G_i = Tz(s_i) Rz(phi_i) R_axis,   P_(i+1) = G_i^-1 A_i(0) G_(i+1)

with any fixed rotation R_axis that turns the joint's axis into z, and the two numbers s_i and phi_i from the URDF.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.errors import ModelError, choices
from calib.model.robot import Robot, read_only, rigid_inverse

#: Axes closer to parallel than this get a Hayati row [rad]; a real arm's parallel axes differ by a few mrad.
NEARLY_PARALLEL_RAD = np.radians(3.0)

_TOLERANCE = 1e-9

#: An offset between nearly parallel axes below this is rounding [m]; what is cut off is missing from the poses.
_COINCIDENT = 1e-13

Vector = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class DHRow:
    """One row: A = Rz(theta + q) Tz(d) Tx(a) Rx(alpha) Ry(beta); lengths [m], angles [rad].

    Attributes:
        joint: Name of the joint that the row's q belongs to.
        prismatic: Whether q adds to d instead of theta.
        near_parallel: Whether the row's two axes are nearly parallel (then Hayati's beta, and, but for the last row,
            d = 0).
    """

    joint: str
    a: float
    alpha: float
    d: float
    theta: float
    beta: float
    prismatic: bool
    near_parallel: bool

    def matrix(self, q: float = 0.0) -> Vector:
        """A_i(q), shape (4, 4), [m]."""
        theta, d = (self.theta, self.d + q) if self.prismatic else (self.theta + q, self.d)
        return _screw(2, theta, d) @ _screw(0, self.alpha, self.a) @ _screw(1, self.beta, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class DHTable:
    """The DH rows of a chain, with the constant poses before the first and after the last.

    Attributes:
        rows: One for each moving joint, base to tip.
        T_base_0: shape (4, 4), [m], pose of DH frame 0.
        T_n_tip: shape (4, 4), [m], pose of the tip in DH frame n.
    """

    rows: tuple[DHRow, ...]
    T_base_0: Vector
    T_n_tip: Vector

    def pose(self, q: ArrayLike) -> Vector:
        """T_base_tip at one set of joint values, from the rows alone, shape (4, 4), [m].

        Args:
            q: shape (n,), [rad] or [m], one for each row, see `Robot.chain_values`.
        """
        T = self.T_base_0
        for row, value in zip(self.rows, np.asarray(q, dtype=np.float64), strict=True):
            T = T @ row.matrix(float(value))
        return T @ self.T_n_tip


def dh_table(robot: Robot) -> DHTable:
    """The DH rows of a robot's chain; `DHTable.pose` then equals ``robot.poses`` up to rounding.

    Example:
        >>> table = dh_table(Robot.load("ur3", base="base", tip="tool0"))
        >>> [round(1000 * row.a, 2) for row in table.rows]
        [0.0, -243.65, -213.25, 0.0, 0.0, 0.0]
    """
    T_base_joint, T_base_tip = zero_poses(robot)
    axes = [T[:3, :3] @ np.asarray(j.axis) for T, j in zip(T_base_joint, robot.joints, strict=True)]
    points = [T[:3, 3] for T in T_base_joint]

    frame = _first_frame(axes[0], points[0])
    T_base_0 = frame
    rows: list[DHRow] = []
    for i, joint in enumerate(robot.joints):
        if i + 1 < len(axes):
            row, frame = _row(frame, axes[i + 1], points[i + 1], joint.name, joint.type)
        else:
            row, frame = _last_row(frame, T_base_tip, joint.name, joint.type)
        rows.append(row)
    T_n_tip = rigid_inverse(frame) @ T_base_tip
    return DHTable(tuple(rows), read_only(T_base_0), read_only(T_n_tip))


def dh_placements(table: DHTable, robot: Robot) -> Vector:
    """The placements of a robot whose geometry is that of the rows: DH offsets back into a URDF.

    The joints' frames stand along and about their axes as the robot's do, which no row says. The result, in
    `Robot.with_placements`, is a robot whose poses are those of `DHTable.pose`.

    Args:
        table: Rows of this robot, `dh_table(robot)`, or the same with other numbers in them.
        robot: The robot; its own table gives its own placements up to rounding.

    Returns:
        shape (n + 1, 4, 4), [m].

    Raises:
        ModelError: The rows are not those of the robot's joints.
    """
    joints = tuple((joint.name, joint.type == "prismatic") for joint in robot.joints)
    rows = tuple((row.joint, row.prismatic) for row in table.rows)
    if rows != joints:
        message = (
            f"The DH rows are of the joints {choices(name for name, _ in rows)}, those of the robot '{robot.name}' "
            f"from '{robot.base}' to '{robot.tip}' are {choices(name for name, _ in joints)}, each turning or "
            "sliding alike. Give rows that dh_table made of the same chain."
        )
        raise ModelError(message)
    own = dh_table(robot)
    placements = []
    T = robot.T_root_base @ table.T_base_0
    F = own.T_base_0
    for own_row, row, joint, T_base_joint in zip(
        own.rows, table.rows, robot.joints, zero_poses(robot)[0], strict=True
    ):
        G = _joint_in_row(rigid_inverse(F) @ T_base_joint, np.asarray(joint.axis))
        placements.append(T @ G)
        T, F = rigid_inverse(G) @ row.matrix(), F @ own_row.matrix()
    placements.append(T @ table.T_n_tip)
    return read_only(placements)


def zero_poses(robot: Robot) -> tuple[list[Vector], Vector]:
    """The joints' frames and the tip's at q = 0: n poses T_base_joint and T_base_tip, (4, 4), [m]."""
    T = rigid_inverse(robot.T_root_base)
    frames = []
    for placement in robot.placements:
        T = T @ placement
        frames.append(T)
    return frames[:-1], frames[-1]


def dh_frames(table: DHTable) -> list[Vector]:
    """The frames F_i before the rotation about beta, at q = 0, in base; n of them, (4, 4), [m].

    The offsets of a_i and alpha_i act along and about x of F_i.
    """
    T = table.T_base_0
    frames = []
    for row in table.rows:
        T = T @ row.matrix()
        frames.append(T @ _screw(1, -row.beta, 0.0))
    return frames


def _joint_in_row(T: Vector, axis: Vector) -> Vector:
    """The pose Tz(s) Rz(phi) R_axis that is nearest to T: a joint's frame in the DH frame on its axis."""
    R_axis = _frame(np.zeros(3), axis, _perpendicular(axis, np.array([1.0, 0.0, 0.0]))).T
    turned = T[:3, :3] @ R_axis[:3, :3].T
    phi = np.arctan2(turned[1, 0] - turned[0, 1], turned[0, 0] + turned[1, 1])
    result: Vector = _screw(2, float(phi), float(T[2, 3])) @ R_axis
    return result


def _first_frame(axis: Vector, point: Vector) -> Vector:
    """Frame 0: z along the first axis, origin nearest to the base's origin, x nearest to the base's x."""
    origin = point - axis * (axis @ point)
    return _frame(origin, axis, _perpendicular(axis, np.array([1.0, 0.0, 0.0])))


def _row(frame: Vector, axis: Vector, point: Vector, joint: str, kind: str) -> tuple[DHRow, Vector]:
    """The row from one frame to the axis of the next joint, and the frame there."""
    z, x = frame[:3, 2], frame[:3, 0]
    if _nearly_parallel(z, axis):
        # The next origin is where the next axis meets the plane through this one's origin: d = 0.
        origin = point + axis * ((frame[:3, 3] - point) @ z) / (axis @ z)
        return _hayati_row(frame, axis, origin, x, joint, kind)
    normal = _cross(z, axis)
    normal /= np.linalg.norm(normal)
    along, between = normal @ x, point - frame[:3, 3]
    if along < -_TOLERANCE or (along < _TOLERANCE and between @ normal < 0):
        normal = -normal
    # Feet of the common normal: frame.origin + d z + a normal = point + s axis.
    d, a, s = np.linalg.solve(np.stack([z, normal, -axis], axis=1), between)
    following = _frame(point + s * axis, axis, normal)
    alpha = np.arctan2(_cross(z, axis) @ normal, z @ axis)
    theta = np.arctan2(_cross(x, normal) @ z, x @ normal)
    row = DHRow(
        joint, _tidy(a), _tidy(alpha), _tidy(d), _tidy(theta), 0.0, kind == "prismatic", False
    )
    return row, following


def _last_row(frame: Vector, T_base_tip: Vector, joint: str, kind: str) -> tuple[DHRow, Vector]:
    """The row from the last joint's axis to the tip's z axis; the frame is the tip's where it can be."""
    z, axis = frame[:3, 2], T_base_tip[:3, 2]
    if not _nearly_parallel(z, axis):
        return _row(frame, axis, T_base_tip[:3, 3], joint, kind)
    along = float((T_base_tip[:3, 3] - frame[:3, 3]) @ z)
    lifted = _frame(frame[:3, 3] + along * z, z, frame[:3, 0])
    row, following = _hayati_row(
        lifted, axis, T_base_tip[:3, 3], T_base_tip[:3, 0], joint, kind, d=along
    )
    return row, following


def _hayati_row(
    frame: Vector,
    axis: Vector,
    origin: Vector,
    x_hint: Vector,
    joint: str,
    kind: str,
    d: float = 0.0,
) -> tuple[DHRow, Vector]:
    """The row to a nearly parallel axis: a along x in the plane across z, then alpha and beta tilt z."""
    z, x = frame[:3, 2], frame[:3, 0]
    offset = origin - frame[:3, 3]
    offset = offset - z * (z @ offset)
    a = float(np.linalg.norm(offset))
    if a > _COINCIDENT:
        # Of a tiny offset only the direction across z is kept exactly, or the frame is no rotation.
        normal = _perpendicular(z, offset / a)
        a = float(offset @ normal)
        if normal @ x < -_TOLERANCE:
            a, normal = -a, -normal
    else:
        a, normal = 0.0, _perpendicular(z, x_hint)
    y = _cross(z, normal)
    beta = float(np.arcsin(np.clip(axis @ normal, -1.0, 1.0)))
    alpha = float(np.arctan2(-(axis @ y), axis @ z))
    theta = np.arctan2(_cross(x, normal) @ z, x @ normal)
    row = DHRow(
        joint,
        _tidy(a),
        _tidy(alpha),
        _tidy(d),
        _tidy(theta),
        _tidy(beta),
        kind == "prismatic",
        True,
    )
    tilted = np.eye(4)
    tilted[:3, :3] = (
        np.stack([normal, y, z], axis=1) @ (_screw(0, alpha, 0.0) @ _screw(1, beta, 0.0))[:3, :3]
    )
    tilted[:3, 3] = frame[:3, 3] + a * normal
    return row, tilted


def _nearly_parallel(z: Vector, axis: Vector) -> bool:
    """Whether two unit vectors lie within `NEARLY_PARALLEL_RAD` of one line."""
    return bool(np.linalg.norm(_cross(z, axis)) < np.sin(NEARLY_PARALLEL_RAD))


def _perpendicular(z: Vector, hint: Vector) -> Vector:
    """The unit vector across z that is nearest to the hint, or to base y where the hint lies along z."""
    across = hint - z * (z @ hint)
    if np.linalg.norm(across) < 1e-6:
        across = np.array([0.0, 1.0, 0.0]) - z * z[1]
    if np.linalg.norm(across) < 1e-6:
        across = np.array([0.0, 0.0, 1.0]) - z * z[2]
    result: Vector = across / np.linalg.norm(across)
    return result


def _frame(origin: Vector, z: Vector, x: Vector) -> Vector:
    """The frame with this origin, z and x; x is made exactly perpendicular."""
    x = x - z * (z @ x)
    x = x / np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3] = np.stack([x, _cross(z, x), z], axis=1)
    T[:3, 3] = origin
    return T


def _screw(axis: int, angle: float, length: float) -> Vector:
    """Rotation about and translation along one coordinate axis, shape (4, 4)."""
    c, s = np.cos(angle), np.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    T = np.eye(4)
    T[i, i], T[i, j], T[j, i], T[j, j] = c, -s, s, c
    T[axis, 3] = length
    return T


def _cross(a: Vector, b: Vector) -> Vector:
    """The product a x b of two vectors of three: `numpy.cross` is made for stacks and takes ten times as long."""
    (a0, a1, a2), (b0, b1, b2) = a, b
    return np.array([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])


def _tidy(value: float | np.floating[Any] | Vector) -> float:
    """A float without the sign of zero."""
    return float(value) + 0.0
