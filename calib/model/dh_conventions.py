"""DH rows of any chain in the conventions that controllers take: standard, modified, Hayati.

    standard   T_base_tip = T_base_0  A_1 ... A_n  T_n_tip,   A_i = Rz(theta_i + q_i) Tz(d_i) Tx(a_i) Rx(alpha_i)
    hayati     the same with A_i Ry(beta_i), which is 0 but between nearly parallel axes; there d_i = 0
    modified   M_i = Rx(alpha_(i-1)) Tx(a_(i-1)) Rz(theta_i + q_i) Tz(d_i)   (Craig), with a_0 = alpha_0 = 0

(a prismatic joint adds q_i to d_i instead). Standard and modified rows say the same of the same common normals and
are the same product, bracketed otherwise. They are pure: the common normal of nearly parallel axes may lie kilometres
away, and is given there. Axes that are parallel but for rounding are taken as parallel, with d_i = 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.errors import ModelError, choices

Array = NDArray[np.float64]

STANDARD, MODIFIED, HAYATI = CONVENTIONS = ("standard", "modified", "hayati")
"""The conventions; see the module's text."""

EQUATIONS = {
    STANDARD: "A_i = Rz(theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i)",
    MODIFIED: "M_i = Rx(alpha_(i-1)) Tx(a_(i-1)) Rz(theta_i) Tz(d_i)",
    HAYATI: "A_i = Rz(theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i) Ry(beta_i)",
}
"""What a row means, for each convention."""


@dataclass(frozen=True, slots=True)
class Row:
    """One row; lengths [m], angles [rad].

    Attributes:
        joint: The joint whose value is added.
        prismatic: Whether it is added to d instead of theta.
        theta: About z.
        d: Along z.
        a: Along x: a_i, or a_(i-1) in the modified convention.
        alpha: About x, likewise.
        beta: About y, Hayati's; 0 in the others.
    """

    joint: str
    prismatic: bool
    theta: float
    d: float
    a: float
    alpha: float
    beta: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class DHRows:
    """The rows of a chain, with the constant poses before the first and behind the last.

    Attributes:
        convention: One of `CONVENTIONS`.
        rows: One for each moving joint, base to tip.
        T_base_0: shape (4, 4), [m], pose of frame 0 in the base.
        T_n_tip: shape (4, 4), [m], pose of the tip in frame n.
    """

    convention: str
    rows: tuple[Row, ...]
    T_base_0: Array
    T_n_tip: Array

    def poses(self, values: ArrayLike) -> Array:
        """T_base_tip from the rows alone, shape (N, 4, 4), [m].

        Args:
            values: shape (N, n) or (n,), [rad] or [m]: of each row's joint, see `Robot.chain_values`.

        Raises:
            ModelError: There is not one value for each row.
        """
        values = np.atleast_2d(np.asarray(values, dtype=np.float64))
        if values.ndim != 2 or values.shape[1] != len(self.rows):
            message = (
                f"Joint values of shape {values.shape} were given; there are {len(self.rows)} DH rows, of "
                f"{choices(row.joint for row in self.rows)}."
            )
            raise ModelError(message)
        T = np.broadcast_to(self.T_base_0, (len(values), 4, 4))
        for row, q in zip(self.rows, values.T, strict=True):
            T = T @ _matrices(row, q, modified=self.convention == MODIFIED)
        result: Array = T @ self.T_n_tip
        return result

    def __repr__(self) -> str:
        """In one line, such as ``DHRows('standard', 6 rows)``."""
        return f"DHRows('{self.convention}', {len(self.rows)} rows)"


def row_matrix(row: Row) -> Array:
    """A_i at q = 0, shape (4, 4), [m]."""
    result: Array = _matrices(row, np.zeros(1), modified=False)[0]
    return result


def _matrices(row: Row, q: Array, *, modified: bool) -> Array:
    """A_i or M_i at values of the row's joint, shape (N, 4, 4), [m]."""
    theta, d = (row.theta + 0.0 * q, row.d + q) if row.prismatic else (row.theta + q, row.d)
    along_z = np.zeros((len(q), 4, 4))
    along_z[:, 0, 0] = along_z[:, 1, 1] = np.cos(theta)
    along_z[:, 1, 0] = np.sin(theta)
    along_z[:, 0, 1] = -along_z[:, 1, 0]
    along_z[:, 2, 2] = along_z[:, 3, 3] = 1.0
    along_z[:, 2, 3] = d
    along_x = screw(0, row.alpha, row.a)
    result: Array = along_x @ along_z if modified else along_z @ along_x @ screw(1, row.beta, 0.0)
    return result


def screw(axis: int, angle: float, length: float) -> Array:
    """Rotation about and translation along one coordinate axis, shape (4, 4)."""
    c, s = np.cos(angle), np.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    T = np.eye(4)
    T[i, i], T[i, j], T[j, i], T[j, j] = c, -s, s, c
    T[axis, 3] = length
    return T
