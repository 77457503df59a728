"""DH rows as values, in the conventions that controllers take: standard, modified, Hayati.

    standard   T_base_tip = T_base_0  A_1 ... A_n  T_n_tip,   A_i = Rz(theta_i + q_i) Tz(d_i) Tx(a_i) Rx(alpha_i)
    hayati     the same with A_i Ry(beta_i), which is 0 but between nearly parallel axes; there d_i = 0
    modified   M_i = Rx(alpha_(i-1)) Tx(a_(i-1)) Rz(theta_i + q_i) Tz(d_i)   (Craig), with a_0 = alpha_0 = 0

(a prismatic joint adds q_i to d_i instead). `calib.model.dh` finds the rows of a robot.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

STANDARD, MODIFIED, HAYATI = CONVENTIONS = ("standard", "modified", "hayati")
"""The conventions; see the module's text."""

EQUATIONS = {
    STANDARD: "A_i = Rz(theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i)",
    MODIFIED: "M_i = Rx(alpha_(i-1)) Tx(a_(i-1)) Rz(theta_i) Tz(d_i)",
    HAYATI: "A_i = Rz(theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i) Ry(beta_i)",
}
"""What a row means, for each convention."""

NEARLY_PARALLEL_RAD = np.radians(3.0)
"""Axes closer to parallel than this get a Hayati row [rad]; a real arm's parallel axes differ by a few mrad."""


@dataclass(frozen=True, slots=True)
class DHRow:
    """One row; lengths [m], angles [rad]."""

    joint: str  #: The joint whose value is added.
    prismatic: bool  #: Whether it is added to d instead of theta.
    theta: float  #: About z.
    d: float  #: Along z.
    a: float  #: Along x: a_i, or a_(i-1) in the modified convention.
    alpha: float  #: About x, likewise.
    beta: float = 0.0  #: About y, Hayati's; 0 in the others.

    @property
    def near_parallel(self) -> bool:
        """Whether the row's axes are nearly parallel; Hayati's rows then have a beta and, but for the last, d = 0."""
        sine = np.hypot(np.sin(self.alpha), np.cos(self.alpha) * np.sin(self.beta))
        return bool(sine < np.sin(NEARLY_PARALLEL_RAD))

    def matrix(self, q: ArrayLike = 0.0, *, modified: bool = False) -> Array:
        """A_i, or M_i if ``modified``, at one value of the row's joint or N of them; shape (4, 4) or (N, 4, 4), [m]."""
        values = np.asarray(q, dtype=np.float64)
        turn, slide = (0.0, values) if self.prismatic else (values, 0.0)
        along_x, along_z = screw(0, self.alpha, self.a), screw(2, self.theta + turn, self.d + slide)
        if modified:
            return np.asarray(along_x @ along_z)
        return np.asarray(along_z @ along_x @ screw(1, self.beta, 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class DHTable:
    """The rows of a chain, with the constant poses before the first and behind the last."""

    rows: tuple[DHRow, ...]  #: One for each moving joint, base to tip.
    T_base_0: Array  #: shape (4, 4), [m], pose of frame 0 in the base.
    T_n_tip: Array  #: shape (4, 4), [m], pose of the tip in frame n.
    convention: str = HAYATI  #: One of `CONVENTIONS`.

    def __repr__(self) -> str:
        """In one line, such as ``DHTable('standard', 6 rows)``."""
        return f"DHTable('{self.convention}', {len(self.rows)} rows)"

    def poses(self, values: ArrayLike) -> Array:
        """T_base_tip from the rows alone at values (N, n) or (n,), see `Robot.chain_values`; shape (N, 4, 4), [m]."""
        q = np.atleast_2d(np.asarray(values, dtype=np.float64))
        T = np.tile(self.T_base_0, (len(q), 1, 1))
        for row, column in zip(self.rows, q.T, strict=True):
            T = T @ row.matrix(column, modified=self.convention == MODIFIED)
        result: Array = T @ self.T_n_tip
        return result


def dh_frames(table: DHTable) -> list[Array]:
    """The frames F_i of standard or Hayati rows before the rotation about beta, at q = 0 in base; n times (4, 4), [m].

    The offsets of a_i and alpha_i act along and about x of F_i.
    """
    T, frames = table.T_base_0, []
    for row in table.rows:
        frames.append(T @ replace(row, beta=0.0).matrix())
        T = T @ row.matrix()
    return frames


def screw(axis: int, angle: ArrayLike, length: ArrayLike) -> Array:
    """Rotation by angle(s) [rad] about, and translation by length(s) [m] along axis 0, 1 or 2; (4, 4) or (N, 4, 4)."""
    angle, length = np.broadcast_arrays(np.asarray(angle, float), np.asarray(length, float))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    T = np.zeros((*angle.shape, 4, 4))
    T[..., axis, axis] = T[..., 3, 3] = 1.0
    T[..., i, i] = T[..., j, j] = np.cos(angle)
    T[..., j, i] = np.sin(angle)
    T[..., i, j] = -T[..., j, i]
    T[..., axis, 3] = length
    return T
