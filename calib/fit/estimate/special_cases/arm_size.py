"""The size of the arm if nothing measures a length: a gauge, which the fit holds at the nominal size.

A ball in a socket, a plane that is touched, two hands that meet: such rows say where the target does not move, in no
unit. If all lengths of the arm grow by a share s, the same joint values meet the same sockets, further apart; and the
residuals, which are lengths, grow by s too. Least squares would shrink the arm to a point, where all errors are zero.
So the fit holds the size of the arm at the nominal one:

    g(x) = sum_k l_k x_k / sum_k l_k^2 = 0

over the robot's parameters x_k in metres, where l_k is the change of parameter k when all lengths of the arm double (of
DH rows: a_k and d_k themselves). To first order g is the relative change of the root of the sum of squared lengths.

`Problem.with_size_held` finds the `SizeGauge`. It is one more of the problem's constraints, it counts as not determined
in observability, and the size is as uncertain in the estimate as its prior.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array, Mask, read_only
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import KnownDistance
from calib.model.kinematics import Kinematics
from calib.numerics.errors import rms
from calib.robot.ranges import spread_poses

#: Poses over which the growth of an arm is found; a tip is moved by a combination of lengths at any of them.
_POSES = 60

#: The parameters can represent the growth of an arm if they reproduce that of its tip positions to this share.
_CAN_GROW = 0.01

#: Rows cannot see the growth if it changes predictions by no more than so many times the rms residual,
_RESIDUALS = 3.0

#: plus this share of the growth itself, which is below what calibration needs.
_NEGLIGIBLE = 1e-3

#: Singular values below this share of the largest are zero.
_RANK_TOLERANCE = 1e-9

#: Standard deviation with which g is held at zero: far below any instrument's relative error.
_TOLERANCE = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class SizeGauge:
    """The growth of an arm that no row observes, and the combination g of parameters that is held at zero."""

    #: (p,), the change of x when all lengths of arm, frames and targets double
    growth: Array
    #: (p,), the gradient of g: g(x) = held @ x, and held @ growth = 1
    held: Array

    def constraint(self, x: Array) -> tuple[float, Array]:
        """Return 0 - g(x), over its tolerance, and the derivative of g by x, (p,), over the tolerance too."""
        by_x = self.held / _TOLERANCE
        return float(-by_x @ x), by_x

    def without_growth(self, jacobian: Array) -> Array:
        """Project growth out of a Jacobian, (m, p): it changes predictions only by shares of the residuals."""
        along = np.outer(jacobian @ self.growth, self.growth) / (self.growth @ self.growth)
        return np.asarray(jacobian - along)

    def covariance(self, precision: Array) -> Array:
        """Return the covariance of the parameters by the prior variance of the arm's size, along its growth.

        Args:
            precision: shape (p,), 1 / variance of the prior of each parameter; 0 for one without prior, which does not
                count.

        Returns:
            shape (p, p), in the products of the parameters' units.
        """
        used = (self.held != 0.0) & (precision > 0.0)
        variance = float(np.sum(self.held[used] ** 2 / precision[used]))
        return variance * np.outer(self.growth, self.growth)


def measures_length(rows: Rows, distances: tuple[KnownDistance, ...]) -> bool:
    """Return whether any measurement compares the arm with a unit of length; else only its shape can be found.

    Points and distances compare it, and known distances between frames; rows in sockets and on planes do not.
    """
    return bool(distances) or any(kind.measures_length for kind in rows.present)


def find_size_gauge(
    kinematics: Kinematics,
    rows: Rows,
    derivative: Array,
    residual: Array,
) -> SizeGauge | None:
    """Find the growth of the arm that rows without a measured length do not observe.

    If all lengths grow together, such rows (targets in sockets, touched planes) fit as well as before, so that the size
    must be held at the nominal one.

    Args:
        kinematics: The nominal robot under its error model of p parameters, with frames and targets as registered.
        rows: N rows of measurements, none of which measures a length.
        derivative: shape (N, D, p), Jacobian of the prediction at x = 0, in units of each scalar's sigma.
        residual: shape (N, D), measured minus predicted at x = 0, in the same units.

    Returns:
        The growth and what is held; None if the parameters cannot represent growth, or the rows do see it, as with a
        known target or frame.
    """
    model = kinematics.model
    lengths = model.of_robot & (np.array(model.units) == "m")
    chain_growth, reach = _growth_of_chain(kinematics, lengths)
    if chain_growth is None:
        return None
    of_robot = np.zeros(len(model))
    of_robot[lengths] = chain_growth
    used = rows.used
    growth = _with_setup_growth(of_robot, derivative, used, ~model.of_robot)
    observed_change = rms((derivative @ growth)[used])
    negligible = _NEGLIGIBLE * reach / rms(rows.scales[used])
    if observed_change > _RESIDUALS * rms(residual[used]) + negligible:
        return None
    held = np.where(lengths, growth, 0.0) / np.sum(growth[lengths] ** 2)
    return SizeGauge(read_only(growth), read_only(held))


def _with_setup_growth(growth: Array, derivative: Array, used: Mask, of_setup: Mask) -> Array:
    """The growth of an arm, (p,), with frames and targets, True in (p,), that grow so that predictions change least.

    Predictions have the derivative (N, D, p), in units of sigma, and count where they are used, (N, D).
    """
    change = (derivative @ growth)[used]
    of_setup_columns = derivative[used][:, of_setup]
    result: Array = growth.copy()
    result[of_setup] = -np.linalg.lstsq(of_setup_columns, change, rcond=_RANK_TOLERANCE)[0]
    return result


def _growth_of_chain(kinematics: Kinematics, lengths: Mask) -> tuple[Array | None, float]:
    """Solve for the change of the robot's lengths, K of p parameters, that doubles the chain.

    Then p_tip(q), the tip's position in the base, grows by p_tip(q). Translations of the base, and of the tip from the
    last joint, are left to frame and target. The change, (K,) [m], is None if the lengths cannot reproduce this growth;
    besides, the distance of the tip from its mean position, rms over poses spread over the joint ranges [m].
    """
    q = spread_poses(kinematics.robot, _POSES)
    tips = kinematics.robot.poses(q)
    position = tips[:, :3, 3]
    reach = rms(np.linalg.norm(position - position.mean(axis=0), axis=1))

    # The motion of the tip by the lengths alone. With frames and targets at the identity the target in its frame is the
    # tip in the base.
    model = kinematics.model
    others = [name for name, is_length in zip(model.names, lengths, strict=True) if not is_length]
    T_frame_base = np.broadcast_to(np.eye(4), kinematics.T_frame_base.shape)
    T_tip_target = np.broadcast_to(np.eye(4), kinematics.T_tip_target.shape)
    chain = Kinematics(kinematics.robot, model.without(others), T_frame_base, T_tip_target)
    _, motion = chain.twists(np.zeros(len(chain.model)), q, rotation=False)  # (N, 3, K)

    # A translation of the base, and one of the tip along its own axes, are projected out.
    of_base = np.broadcast_to(np.eye(3), (len(tips), 3, 3))
    ends = np.concatenate([of_base, tips[:, :3, :3]], axis=2).reshape(-1, 6)
    between_ends = np.column_stack([position.ravel(), motion.reshape(len(ends), -1)])
    between_ends -= ends @ np.linalg.lstsq(ends, between_ends, rcond=None)[0]
    growth = between_ends[:, 0]
    columns = between_ends[:, 1:]
    solution = np.linalg.lstsq(columns, growth, rcond=_RANK_TOLERANCE)[0]
    missing = (growth - columns @ solution).reshape(-1, 3)
    if rms(np.linalg.norm(missing, axis=1)) > _CAN_GROW * reach:
        return None, reach
    return np.asarray(solution), reach
