"""Difference of two calibrations' predictions, without what frame and target compensate.

The difference of two results' predictions of one target in the base is delta(q) = J_b x_b - J_a x_a to first order.
Where a fit estimated the base's place or the target from its own data, the motion of them that explains delta best, by
least squares over the joint values that both data cover, is subtracted, there and everywhere: frame and target are the
gauge of the comparison. Measured orientations count as their effect at the end of a lever of 100 mm. The difference is
tested by `calib.numerics.drift`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.model.error_model import DIRECTIONS
from calib.model.kinematics import Kinematics
from calib.model.observability import steps
from calib.model.parameters import FRAME, TARGET
from calib.numerics.drift import (
    DriftTest,
    Estimate,
    covariance_under,
    drift_test,
    joint_covariance,
)
from calib.result.calibration import CalibrationValues
from calib.robot.ranges import spread_between, spread_poses
from calib.units import Array

#: Joint values over which a displacement is averaged.
Where = Literal["measured ranges", "joint limits"]

#: Number of joint values over which displacements are averaged.
_POSES = 200

#: Common priors are no wider than this, in steps of 1 mm and 1 mrad: no arm errs by more.
_WIDEST = 10.0

#: They are no sharper than this, in the same steps, to leave room for a drift.
_ROOM = 0.2

#: Lever at whose end an angle counts [m].
_LEVER = 0.1

#: Rounding of one coordinate of one pose [m].
_ROUNDING = 1e-7

#: Effects below this share of the strongest one's are none.
_NOTHING = 1e-5

#: The same where the nominal robots differ, so that effects are not quite comparable.
_NOTHING_APART = 2e-3

#: A parameter with more than this share of its effect outside of those of the other result is its own; one of whose
#: effect less than this share is left is compensated by frame and target.
_OWN = 0.03

#: Effects below this share of the strongest one's span no direction.
_SPANS_NOTHING = 1e-4


@dataclass(frozen=True, slots=True)
class Displacement:
    """Displacement of the predicted target in b from that in a."""

    #: Joint values over which it is averaged
    where: Where
    #: [m], noise included
    rms: float
    #: [m]
    max: float
    #: The rms that the noise of both alone would show [m]
    noise: float
    #: Standard deviation of ``rms`` [m]
    std: float
    #: [rad]; NaN where orientations were not measured
    rms_angle: float

    @property
    def moved(self) -> float:
        """The rms without the part of the noise [m]."""
        return float(np.sqrt(max(self.rms**2 - self.noise**2, 0.0)))


@dataclass(frozen=True, slots=True, eq=False)
class Differences:
    """The difference of two results, tested and averaged."""

    #: The test of the difference
    test: DriftTest
    #: Displacement of the target: over the joint values that both data cover, then over the limits
    moves: tuple[Displacement, Displacement]
    #: Parameters that frame and target compensate
    compensated: tuple[str, ...]
    #: Parameters of a whose effects those of b cannot have
    only_a: tuple[str, ...]
    #: The same of b
    only_b: tuple[str, ...]


def own_names(result: CalibrationValues) -> tuple[str, ...]:
    """Return the names of the robot's own parameters: those of frames and targets left out."""
    return tuple(result.model.names[k] for k in _own_indices(result))


def _own_indices(result: CalibrationValues) -> NDArray[np.int_]:
    """Return the indices of the robot's own parameters, from 0, shape (k,)."""
    return np.flatnonzero(~result.model.family(FRAME, TARGET))


def _own_steps(result: CalibrationValues) -> Array:
    """Return typical errors of arms in each of their own parameters, shape (k,), in its unit."""
    return steps([result.model.units[k] for k in _own_indices(result)])


def unknown_frame(result: CalibrationValues) -> tuple[str, ...]:
    """Return the directions in which a result's measurements did not know where the base stands."""
    if not result.tells_place:
        return DIRECTIONS  # sockets, planes, anchors and pairs never do
    if not result.frame_estimated:
        return ()
    estimated = {direction for unknown in result.setup.unknown for direction in unknown}
    return tuple(direction for direction in DIRECTIONS if direction in estimated)


def _common_ranges(a: Array, b: Array) -> Array:
    """Return the range of each joint that both data cover, or that either does where there is none.

    Args:
        a: Smallest and largest fitted joint values of the first result, shape (m, 2), [rad], [m].
        b: Those of the second.
    """
    low = np.fmax(a[:, 0], b[:, 0])
    high = np.fmin(a[:, 1], b[:, 1])
    apart = ~(low < high)
    low = np.where(apart, np.fmin(a[:, 0], b[:, 0]), low)
    high = np.where(apart, np.fmax(a[:, 1], b[:, 1]), high)
    ranges = np.stack([low, high], axis=1)
    return np.asarray(np.nan_to_num(ranges, posinf=0.0, neginf=0.0))


# Estimates under common priors


def _estimate(result: CalibrationValues, other: CalibrationValues) -> Estimate:
    """Return a result under priors that both share and that leave room for a drift.

    Parameters at a bound stay there.

    Args:
        result: The result.
        other: The one with which it is compared.
    """
    precision, of_other = _prior_precision(result), _prior_precision(other)
    by_name = dict(zip(other.model.names, of_other, strict=True))
    indices, step = _own_indices(result), _own_steps(result)
    shared = [min(precision[k], by_name.get(result.model.names[k], np.inf)) for k in indices]
    # Never wider than anything an arm may err by either: with priors off there is none.
    shared = np.clip(shared, 1.0 / (_WIDEST * step) ** 2, 1.0 / (_ROOM * step) ** 2)
    bounded = np.array([p.at_bound for p in result.parameters], dtype=bool)
    common = precision.copy()
    common[indices] = shared
    common[bounded] = 0.0

    C = covariance_under(result.covariance, common - precision, ~bounded)
    of_own = C[np.ix_(indices, indices)]
    noise = C - (C * common) @ C
    data_gradient = np.array([result.parameters[k].data_gradient for k in indices])
    return Estimate(
        covariance=of_own,
        noise=noise[np.ix_(indices, indices)],
        pull=of_own * common[indices],
        prior=1.0 / shared,
        freedom=result.freedom,
        shift=of_own @ (data_gradient - common[indices] * result.x[indices]),
    )


def _prior_precision(result: CalibrationValues) -> Array:
    """Return the precision of each parameter's prior, 0 where there was none, shape (p,)."""
    prior_std = np.array([p.prior_std for p in result.parameters])
    return np.nan_to_num(prior_std**-2.0)


# Predictions of both


@dataclass(frozen=True, slots=True, eq=False)
class _Predictions:
    """Predictions of the target by both results at N joint values, as lengths [m].

    D = 3, or 6 where orientations count.
    """

    #: Whether orientations count
    turns: bool
    #: (N D,), prediction of b less that of a
    difference: Array
    #: (N D, p), derivatives by each result's own parameters, at the nominal robot
    effects: tuple[Array, Array]
    #: (N D, p), the same at the results
    slopes: tuple[Array, Array]
    #: (N D, g), derivatives by the motions of base and target that are not known
    gauge: Array

    @property
    def signed(self) -> Array:
        """Derivative of b's prediction less a's by both results' parameters, shape (N D, p_a + p_b)."""
        return np.hstack([-self.effects[0], self.effects[1]])

    @property
    def coordinates(self) -> int:
        """Number D of coordinates of a joint value."""
        return 6 if self.turns else 3

    def moved(self, estimates: tuple[Estimate, Estimate]) -> Array:
        """Return the difference under common priors, shape (N D,)."""
        slope_a, slope_b = self.slopes
        a, b = estimates
        return np.asarray(self.difference + slope_b @ b.shift - slope_a @ a.shift)


def _predictions(a: CalibrationValues, b: CalibrationValues, q: Array) -> _Predictions:
    """Predict one target in the base by both results.

    Args:
        a: The first result, whose target is predicted.
        b: The second.
        q: Joint values, shape (N, m), [rad] or [m].
    """
    turns = a.setup.rotation and b.setup.rotation
    T_nominal, T_a, effect_a, slope_a = _prediction(a, a, q)
    _, T_b, effect_b, slope_b = _prediction(b, a, q)
    difference = T_b[:, :3, 3] - T_a[:, :3, 3]
    if turns:
        R_ab = Rotation.from_matrix(T_b[:, :3, :3] @ T_a[:, :3, :3].transpose(0, 2, 1))
        difference = np.hstack([difference, _LEVER * R_ab.as_rotvec()])
    gauge = _place_twists(T_nominal)[:, :, _unknown_places(a, b, turns=turns)]
    return _Predictions(
        turns=turns,
        difference=difference.ravel(),
        effects=(_as_lengths(effect_a, turns=turns), _as_lengths(effect_b, turns=turns)),
        slopes=(_as_lengths(slope_a, turns=turns), _as_lengths(slope_b, turns=turns)),
        gauge=_as_lengths(gauge, turns=turns),
    )


def _prediction(
    result: CalibrationValues, first: CalibrationValues, q: Array
) -> tuple[Array, Array, Array, Array]:
    """Predict the first result's target in the base by one result's own parameters.

    Args:
        result: The result.
        first: The result whose first target is predicted.
        q: Joint values, shape (N, m), [rad] or [m].

    Returns:
        Poses by the nominal and by the calibrated robot, shape (N, 4, 4), [m], and the twists of a unit of each own
        parameter at the nominal and at the calibrated robot, shape (N, 6, p).
    """
    indices = _own_indices(result)
    others = np.delete(np.array(result.model.names), indices)
    frames = np.tile(np.eye(4), (len(result.setup.groups), 1, 1))
    targets = np.tile(first.setup.T_tip_target[0], (len(result.setup.targets), 1, 1))
    kinematics = Kinematics(result.nominal, result.model.without(others), frames, targets)
    # Effects at the nominal robot, from which both count: elsewhere they would differ by what is of second order, and
    # that would look like combinations of their own.
    nominal, effect = kinematics.twists(np.zeros(len(indices)), q)
    calibrated, slope = kinematics.twists(result.x[indices], q)
    return nominal, calibrated, effect, slope


def _place_twists(T_base_target: Array) -> Array:
    """Return the twists of the target by motions of the base and of the target.

    Args:
        T_base_target: Poses of the target, shape (N, 4, 4), [m].

    Returns:
        shape (N, 6, 12): columns are x, y, z, rx, ry, rz of the base, then of the target, in its own axes.
    """
    twists = np.zeros((len(T_base_target), 6, 12))
    points, R = T_base_target[:, None, :3, 3], T_base_target[:, :3, :3]
    twists[:, :, :6] = np.eye(6)
    twists[:, :3, 3:6] = np.cross(np.eye(3), points).transpose(0, 2, 1)
    twists[:, :3, 6:9] = R
    twists[:, 3:, 9:] = R
    return twists


def _unknown_places(a: CalibrationValues, b: CalibrationValues, *, turns: bool) -> list[bool]:
    """Return True for each column of `_place_twists` that either result had to estimate, 12 in all."""
    unknown = {*unknown_frame(a), *unknown_frame(b)}
    target = a.setup.estimate_target or b.setup.estimate_target
    of_base = [direction in unknown for direction in DIRECTIONS]
    return of_base + [target] * 3 + [target and turns] * 3


def _as_lengths(twists: Array, *, turns: bool) -> Array:
    """Return twists (N, 6, k) as lengths [m], shape (N D, k); D is 6 where orientations count, else 3."""
    scaled = twists * np.repeat([1.0, _LEVER], 3)[:, None]
    coordinates = 6 if turns else 3
    return np.asarray(scaled[:, :coordinates].reshape(-1, twists.shape[2]))


# Differences


@dataclass(frozen=True, slots=True, eq=False)
class _Compensation:
    """The motion of base and target that explains the difference best, over the joint values that both data cover."""

    #: There
    inside: _Predictions
    estimates: tuple[Estimate, Estimate]
    #: (p_a + p_b, p_a + p_b), their joint covariance
    joint: Array
    #: (g, N D), takes displacements there to the motion
    to_motion: Array
    #: (g,), that of the difference
    motion: Array

    @classmethod
    def of(
        cls, inside: _Predictions, estimates: tuple[Estimate, Estimate], joint: Array
    ) -> _Compensation:
        """Fit the motion to the difference, by least squares."""
        to_motion = np.asarray(np.linalg.pinv(inside.gauge, rcond=1e-9), dtype=np.float64)
        motion = to_motion @ inside.moved(estimates)
        return cls(inside, estimates, joint, to_motion, motion)

    def remaining(self, effect: Array) -> Array:
        """Return effects (N D, p) there without what a motion explains of each."""
        return np.asarray(effect - self.inside.gauge @ (self.to_motion @ effect))

    def difference(self, at: _Predictions) -> Array:
        """Return the difference under common priors at any joint values without the motion, shape (N D,)."""
        return np.asarray(at.moved(self.estimates) - at.gauge @ self.motion)

    def displacement(self, where: Where, at: _Predictions) -> Displacement:
        """Return the displacement of the target without the motion.

        Args:
            where: Name of the joint values.
            at: Predictions there.
        """
        moved = self.difference(at).reshape(-1, at.coordinates)
        J = at.signed - at.gauge @ (self.to_motion @ self.inside.signed)
        J = J.reshape(-1, at.coordinates, J.shape[1])[:, :3]
        points, angles = moved[:, :3], moved[:, 3:] / _LEVER
        count = len(points)
        noise = float(np.einsum("ndp,pq,ndq->", J, self.joint, J)) / count
        square = np.sum(points**2, axis=1)
        rms = float(np.sqrt(np.mean(square)))
        slope = np.einsum("nd,ndp->p", points, J)  # of half the sum of squares
        std = float(np.sqrt(max(slope @ self.joint @ slope, 0.0)))
        rms_angle = float(np.sqrt(np.mean(np.sum(angles**2, axis=1)))) if at.turns else np.nan
        return Displacement(
            where=where,
            rms=rms,
            max=float(np.sqrt(square.max())),
            noise=float(np.sqrt(max(noise, 0.0))),
            std=std / (count * rms) if rms > 0.0 else 0.0,
            rms_angle=rms_angle,
        )


def differences_of(
    first: CalibrationValues, second: CalibrationValues, *, same_start: bool
) -> Differences:
    """Test the difference of two results, and average it.

    Args:
        first: Result a.
        second: Result b.
        same_start: Whether both count from the same nominal robot.
    """
    estimates = (_estimate(first, second), _estimate(second, first))
    alike = same_start and _same_parameters(first, second)
    joint = joint_covariance(*estimates, alike=alike)
    ranges = _common_ranges(first.ranges, second.ranges)
    inside = _predictions(first, second, spread_between(ranges, _POSES))
    everywhere = _predictions(first, second, spread_poses(first.nominal, _POSES))
    compensation = _Compensation.of(inside, estimates, joint)

    remaining = [compensation.remaining(effect) for effect in inside.effects]
    known = [_is_known(*effects) for effects in zip(remaining, inside.effects, strict=True)]
    own_steps = (_own_steps(first), _own_steps(second))
    basis = _basis(remaining, own_steps, _NOTHING if same_start else _NOTHING_APART)
    effect_a = basis.T @ np.where(known[0], remaining[0], 0.0)
    effect_b = basis.T @ np.where(known[1], remaining[1], 0.0)
    test = drift_test(
        basis.T @ compensation.difference(inside),
        (effect_a, effect_b),
        estimates,
        joint,
        _ROUNDING * np.sqrt(_POSES),
    )
    names = (np.array(own_names(first)), np.array(own_names(second)))
    unknown = [*names[0][~known[0]].tolist(), *names[1][~known[1]].tolist()]
    in_steps = (effect_a * own_steps[0], effect_b * own_steps[1])
    return Differences(
        test=test,
        moves=(
            compensation.displacement("measured ranges", inside),
            compensation.displacement("joint limits", everywhere),
        ),
        compensated=tuple(dict.fromkeys(unknown)),
        only_a=_not_spanned(in_steps[0], in_steps[1], names[0]),
        only_b=_not_spanned(in_steps[1], in_steps[0], names[1]),
    )


def _same_parameters(first: CalibrationValues, second: CalibrationValues) -> bool:
    """Tell if both results have the same parameters of the robot, tied alike."""
    same_names = own_names(first) == own_names(second)
    same_ties = dict(first.ties) == dict(second.ties)
    return same_names and same_ties and first.model.name == second.model.name


def _is_known(remaining: Array, effect: Array) -> NDArray[np.bool_]:
    """Tell for each parameter if frame and target do not compensate it, shape (p,).

    Args:
        remaining: Effects (N D, p) without what a motion of frame and target explains.
        effect: The whole effects, shape (N D, p).
    """
    size = np.linalg.norm(effect, axis=0)
    return np.asarray(np.linalg.norm(remaining, axis=0) >= _OWN * size)


def _basis(effects: list[Array], own_steps: tuple[Array, Array], smallest: float) -> Array:
    """Return an orthonormal basis of all displacements that both results' parameters can make, shape (N D, r).

    Args:
        effects: Of a and of b, shapes (N D, p_a) and (N D, p_b).
        own_steps: Typical errors of their parameters, shapes (p_a,) and (p_b,).
        smallest: Singular values below this share of the largest are none.
    """
    in_steps = np.hstack([effect * step for effect, step in zip(effects, own_steps, strict=True)])
    U, values, _ = np.linalg.svd(in_steps, full_matrices=False)
    least = max(values.max(initial=0.0), 1e-300) * smallest
    return np.asarray(U[:, values > least])


def _not_spanned(effect: Array, other: Array, names: NDArray[Any]) -> tuple[str, ...]:
    """List the parameters of one result whose effects those of the other result cannot have.

    Args:
        effect: Effects of the result's parameters, in steps, shape (r, p).
        other: Those of the other result's, shape (r, p_other).
        names: Names of the result's parameters, shape (p,).
    """
    U, values, _ = np.linalg.svd(other, full_matrices=False)
    U = U[:, values > _SPANS_NOTHING * max(float(values.max(initial=0.0)), 1e-300)]
    outside = np.linalg.norm(effect - U @ (U.T @ effect), axis=0)
    size = np.linalg.norm(effect, axis=0)
    least = _OWN * np.maximum(size, _OWN * size.max(initial=0.0))
    return tuple(names[(outside > least) & (least > 0.0)].tolist())
