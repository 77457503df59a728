"""The complete DH rows of a Universal Robots arm, nominal plus deltas, and the hash that the ROS driver makes of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class FullDH:
    """Standard DH rows: T_i(q) = Rz(theta_i + q_i) Tz(d_i) Tx(a_i) Rx(alpha_i).

    Attributes:
        theta: shape (6,), [rad].
        a: shape (6,), [m].
        d: shape (6,), [m].
        alpha: shape (6,), [rad].
    """

    theta: Array
    a: Array
    d: Array
    alpha: Array
