"""Difference of two calibrations' predictions, without what frame and target compensate.

The difference of two results' predictions of one target in the base is delta(q) = J_b x_b - J_a x_a to first order.
If a fit estimated the base's place or the target from its own data, the motion of them that explains delta best, by
least squares over the joint values that both data cover, is subtracted at all joint values: frame and target are the
gauge of the comparison. Measured orientations count as their effect at the end of a lever of 100 mm. The difference is
tested by `calib.verbs.compare.drift`.

Below, N is a number of joint values, and D the number of coordinates of a prediction at each: 3 of the position, and
with measured orientations 3 of the rotation vector times the lever, all along the base's axes [m].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array, Mask
from calib.model.kinematics import Kinematics
from calib.model.observability import steps
from calib.model.parameter_sets import DIRECTIONS
from calib.result.calibration import Calibration
from calib.robot.ranges import spread_between, spread_poses
from calib.verbs.compare.drift import (
    DriftTest,
    Estimate,
    covariance_under,
    drift_test,
    joint_covariance,
)

#: Joint values over which a displacement is averaged.
Where = Literal["measured ranges", "joint limits"]

#: Number of joint values over which displacements are averaged.
POSES = 200

#: Common priors are no wider than this, in steps of 1 mm and 1 mrad: no arm errs by more.
_WIDEST = 10.0

#: They are no sharper than this, in the same steps, to leave room for a drift.
_ROOM = 0.2

#: Lever at whose end an angle counts [m].
_LEVER = 0.1

#: Rounding of one coordinate of one pose [m].
_ROUNDING = 1e-7

#: Displacements below this share of the largest, as singular values, span no direction of the comparison.
_NEGLIGIBLE = 1e-5

#: The same if the nominal robots differ, so that effects are not quite comparable.
_NEGLIGIBLE_APART = 2e-3

#: A parameter belongs to one result alone if more than this share of its effect is outside of what the other's
#: parameters can do; it is compensated by frame and target if less than this share of its effect remains.
_OWN = 0.03

#: The other result's effects below this share of their largest, as singular values, span no direction.
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
        """The rms displacement without the part that noise alone would show [m], sqrt(rms^2 - noise^2), 0 or more."""
        return float(np.sqrt(max(self.rms**2 - self.noise**2, 0.0)))


@dataclass(frozen=True, slots=True, eq=False)
class Differences:
    """The difference of two results, tested and averaged."""

    #: The test of the difference
    test: DriftTest
    #: Displacement of the target: over the joint values that both data cover, then over the limits
    moves: tuple[Displacement, Displacement]
    #: Parameters that frame and target compensate, so that no drift of them shows
    compensated: tuple[str, ...]
    #: Parameters of a whose effects those of b cannot have
    only_a: tuple[str, ...]
    #: The same of b
    only_b: tuple[str, ...]


def differences_of(first: Calibration, second: Calibration, *, same_start: bool) -> Differences:
    """Test the difference of two results' predictions of a target, and average it over joint values.

    Args:
        first: Result a.
        second: Result b, of the same chain.
        same_start: Whether both have the same nominal joint origins, from which their parameters count.

    Returns:
        The test; the displacement of the target from a to b, over the joint values that both data cover and over the
        limits [m]; the parameters that frame and target compensate, and those whose effects only one result can have.
    """
    compensation = _Compensation.of(first, second, same_start=same_start)
    inside = compensation.inside
    everywhere = _Predictions.of(first, second, spread_poses(first.nominal, POSES))
    own_a = _OwnEffects.of(first, inside.effects[0], compensation)
    own_b = _OwnEffects.of(second, inside.effects[1], compensation)

    # Orthonormal basis of the displacements that typical errors of both robots can make, (N D, r).
    in_steps = np.hstack([own_a.in_steps, own_b.in_steps])
    U, values, _ = np.linalg.svd(in_steps, full_matrices=False)
    negligible = _NEGLIGIBLE if same_start else _NEGLIGIBLE_APART
    basis = np.asarray(U[:, values > max(values.max(initial=0.0), 1e-300) * negligible])

    # In its coordinates, (r, p_a) and (r, p_b), [m] a unit of each parameter.
    effect_a, effect_b = own_a.along(basis), own_b.along(basis)
    test = drift_test(
        basis.T @ compensation.difference(inside),
        (effect_a, effect_b),
        compensation.estimates,
        compensation.joint,
        _ROUNDING * np.sqrt(POSES),
    )
    in_steps_a, in_steps_b = effect_a * own_a.steps, effect_b * own_b.steps
    return Differences(
        test=test,
        moves=(
            compensation.displacement("measured ranges", inside),
            compensation.displacement("joint limits", everywhere),
        ),
        compensated=tuple(dict.fromkeys(own_a.compensated + own_b.compensated)),
        only_a=_not_spanned(in_steps_a, in_steps_b, own_a.names),
        only_b=_not_spanned(in_steps_b, in_steps_a, own_b.names),
    )


# Parameters, frames and joint ranges of a result


def own_names(result: Calibration) -> tuple[str, ...]:
    """Return the names of the robot's own parameters, in the order of x: those of frames and targets are left out."""
    return tuple(result.model.names[k] for k in own_indices(result))


def own_indices(result: Calibration) -> NDArray[np.int_]:
    """Return the indices of the robot's own parameters in x, ascending."""
    return np.flatnonzero(result.model.of_robot)


def _own_steps(result: Calibration) -> Array:
    """Return a typical error of arms in each of the robot's own parameters: 1 mm, 1 mrad, or as its family declares."""
    return steps([result.model.units[k] for k in own_indices(result)])


def _same_parameters(first: Calibration, second: Calibration) -> bool:
    """Return whether two results have the same model, ties and robot parameters; frames and targets do not count."""
    same_names = own_names(first) == own_names(second)
    same_ties = dict(first.method.ties) == dict(second.method.ties)
    return same_names and same_ties and first.model.name == second.model.name


def unknown_frame(result: Calibration) -> tuple[str, ...]:
    """Return the directions of the base's pose that were not known before the fit.

    Returns:
        Some of ``"x"``, ``"y"``, ``"z"``, ``"rx"``, ``"ry"`` and ``"rz"``, along and about the base's axes, in this
        order: those that were estimated for at least one measurement frame. All six if no row determines where the
        base stands; none if the measurement frames were taken as known.
    """
    if not result.rows.tells_place:
        return DIRECTIONS  # sockets, planes, anchors and pairs never do
    if not result.method.frame_estimated:
        return ()
    estimated = {direction for unknown in result.setup.unknown for direction in unknown}
    return tuple(direction for direction in DIRECTIONS if direction in estimated)


def unknown_places(results: Sequence[Calibration], *, turns: bool) -> list[bool]:
    """Return for each of the 12 columns of `place_twists` whether any result had to estimate that motion.

    A target's orientation is estimated only if orientations were measured for all (``turns``).
    """
    unknown = {direction for result in results for direction in unknown_frame(result)}
    target = any(result.setup.estimate_target for result in results)
    of_base = [direction in unknown for direction in DIRECTIONS]
    return of_base + [target] * 3 + [target and turns] * 3


def common_ranges(a: Array, b: Array) -> Array:
    """Return the range of each joint that both data cover, or the hull of both ranges if they are apart.

    Ranges are (m, 2), [rad] or [m]. A joint without fitted rows has NaN, or a range from infinity to minus infinity:
    then the other result's range is taken, and 0 if neither has one.
    """
    low = np.fmax(a[:, 0], b[:, 0])
    high = np.fmin(a[:, 1], b[:, 1])
    apart = ~(low < high)
    low = np.where(apart, np.fmin(a[:, 0], b[:, 0]), low)
    high = np.where(apart, np.fmax(a[:, 1], b[:, 1]), high)
    ranges = np.stack([low, high], axis=1)
    return np.asarray(np.nan_to_num(ranges, posinf=0.0, neginf=0.0))


# Estimates under common priors


def _estimate(result: Calibration, other: Calibration) -> Estimate:
    """Return the robot's own parameters under priors that both results share, to first order.

        C_q = (C^-1 + Q - P)^-1,    x_q = x + C_q (s - Q x)

    with the diagonal precision P of the fit's priors and Q of the shared ones, of mean 0. Q differs from P for the
    robot's own parameters alone. Parameters at a bound are held there.
    """
    precision, indices = prior_precision(result), own_indices(result)
    shared = _shared_precision(result, other)
    bounded = np.array([parameter.at_bound for parameter in result.parameters], dtype=bool)
    common = precision.copy()
    common[indices] = shared
    common[bounded] = 0.0

    # Covariance C_q of all p parameters under the common priors, (p, p), zero for those at a bound.
    C = covariance_under(result.covariance, common - precision, ~bounded)
    of_own = C[np.ix_(indices, indices)]
    noise = C - (C * common) @ C
    data_gradient = np.array([result.parameters[k].data_gradient for k in indices])
    pull_to_data = data_gradient - common[indices] * result.geometry.x[indices]
    return Estimate(
        covariance=of_own,
        noise=noise[np.ix_(indices, indices)],
        pull=of_own * common[indices],
        prior=1.0 / shared,
        freedom=result.noise.freedom,
        shift=of_own @ pull_to_data,
    )


def _shared_precision(result: Calibration, other: Calibration) -> Array:
    """Return 1 / variance of the common prior of each of the robot's p own parameters, (p,) [1/unit^2].

    It is the lower precision of both results, or this result's if the other lacks the parameter; but never so high
    that it would leave no room for a drift, nor lower than what any arm errs by.
    """
    precision, of_other = prior_precision(result), prior_precision(other)
    by_name = dict(zip(other.model.names, of_other, strict=True))
    step = _own_steps(result)
    shared = []
    for k in own_indices(result):
        of_same_name = by_name.get(result.model.names[k], np.inf)
        shared.append(min(precision[k], of_same_name))
    lowest, highest = 1.0 / (_WIDEST * step) ** 2, 1.0 / (_ROOM * step) ** 2
    return np.asarray(np.clip(shared, lowest, highest))


def prior_precision(result: Calibration) -> Array:
    """Return 1 / variance of the prior of each parameter in x, [1/unit^2]; 0 without prior."""
    prior_std = np.array([p.prior_std for p in result.parameters])
    return np.nan_to_num(prior_std**-2.0)


# Predictions of both


def own_kinematics(result: Calibration, other: Calibration) -> Kinematics:
    """Return the nominal robot with its own parameters alone, and the first target of another result in the tip."""
    others = np.delete(np.array(result.model.names), own_indices(result))
    frames = np.tile(np.eye(4), (len(result.setup.groups), 1, 1))
    targets = np.tile(other.setup.T_tip_target[0], (len(result.setup.targets), 1, 1))
    return Kinematics(result.nominal, result.model.without(others), frames, targets)


@dataclass(frozen=True, slots=True, eq=False)
class _Predictions:
    """Predictions of one target in the base by both results at N joint values, as lengths [m]."""

    #: Whether orientations count, D = 6
    turns: bool
    #: (N D,), prediction of b less that of a
    difference: Array
    #: (N D, p_a) and (N D, p_b), derivatives by each robot's own parameters, at the nominal robot
    effects: tuple[Array, Array]
    #: The same at the calibrated robot
    slopes: tuple[Array, Array]
    #: (N D, g), derivatives by the motions of base and target that either result had to estimate
    gauge: Array

    @classmethod
    def of(cls, a: Calibration, b: Calibration, q: Array) -> _Predictions:
        """Predict the first target of result a by both results at joint values q, shape (N, m), [rad] or [m]."""
        turns = a.setup.rotation and b.setup.rotation
        poses, effects, slopes = [], [], []
        for result in (a, b):
            x = result.geometry.x[own_indices(result)]
            kinematics = own_kinematics(result, a)
            # Effects at the nominal robot, from which both count: at the calibrated ones they would differ by terms of
            # second order, which would look like combinations that only one result has.
            nominal, effect = kinematics.twists(np.zeros(len(x)), q)
            calibrated, slope = kinematics.twists(x, q)
            poses.append((nominal, calibrated))
            effects.append(as_lengths(effect, turns=turns))
            slopes.append(as_lengths(slope, turns=turns))

        (nominal_a, by_a), (_, by_b) = poses
        difference = by_b[:, :3, 3] - by_a[:, :3, 3]
        if turns:
            R_ab = Rotation.from_matrix(by_b[:, :3, :3] @ by_a[:, :3, :3].transpose(0, 2, 1))
            difference = np.hstack([difference, _LEVER * R_ab.as_rotvec()])
        gauge = place_twists(nominal_a)[:, :, unknown_places((a, b), turns=turns)]
        return cls(
            turns=turns,
            difference=difference.ravel(),
            effects=(effects[0], effects[1]),
            slopes=(slopes[0], slopes[1]),
            gauge=as_lengths(gauge, turns=turns),
        )

    @property
    def signed(self) -> Array:
        """Derivative of b's prediction less a's by the parameters of both: minus a's, then b's, (N D, p_a + p_b)."""
        effect_a, effect_b = self.effects
        return np.hstack([-effect_a, effect_b])

    @property
    def coordinates(self) -> int:
        """Number D of coordinates of a prediction."""
        return 6 if self.turns else 3

    def difference_under(self, estimates: tuple[Estimate, Estimate]) -> Array:
        """Return the prediction of b less that of a, (N D,), both under common priors, which shift the parameters."""
        slope_a, slope_b = self.slopes
        a, b = estimates
        return np.asarray(self.difference + slope_b @ b.shift - slope_a @ a.shift)


def place_twists(T_base_target: Array) -> Array:
    """Return the twists of the target, along the base's axes, by small motions of the base and of the target.

    For poses (N, 4, 4) they are (N, 6, 12), linear [m] then angular [rad]. Columns are a unit of x, y, z, rx, ry, rz of
    the base, along its axes and about its origin; then of the target, along and about its own axes.
    """
    twists = np.zeros((len(T_base_target), 6, 12))
    points, R = T_base_target[:, None, :3, 3], T_base_target[:, :3, :3]
    twists[:, :, :6] = np.eye(6)
    twists[:, :3, 3:6] = np.cross(np.eye(3), points).transpose(0, 2, 1)
    twists[:, :3, 6:9] = R
    twists[:, 3:, 9:] = R
    return twists


def as_lengths(twists: Array, *, turns: bool) -> Array:
    """Return twists (N, 6, k), linear then angular, as displacements (N D, k) [m], angles times the lever."""
    scaled = twists * np.repeat([1.0, _LEVER], 3)[:, None]
    coordinates = 6 if turns else 3
    count, _, columns = twists.shape
    # The number of rows in full: a model of frames alone has no columns to count them by.
    return np.asarray(scaled[:, :coordinates].reshape(count * coordinates, columns))


# Differences


@dataclass(frozen=True, slots=True, eq=False)
class _Compensation:
    """The motion of base and target that explains the difference best, over the joint values that both data cover."""

    #: Predictions of both results at the joint values that both data cover
    inside: _Predictions
    #: Results a and b under common priors
    estimates: tuple[Estimate, Estimate]
    #: Shape (p_a + p_b, p_a + p_b), covariance of the robot parameters of both results together
    joint: Array
    #: Shape (g, N D), takes displacements at the joint values inside to the motion
    to_motion: Array
    #: Shape (g,), the motion for the difference: the directions of base and target that are not known [m], [rad]
    motion: Array

    @classmethod
    def of(cls, first: Calibration, second: Calibration, *, same_start: bool) -> _Compensation:
        """Bring two results to common priors, and fit the motion to the difference of their predictions."""
        estimates = (_estimate(first, second), _estimate(second, first))
        # If both count from the same nominal robot, equal parameters share the means of their priors: their errors are
        # correlated.
        alike = same_start and _same_parameters(first, second)
        joint = joint_covariance(*estimates, alike=alike)
        ranges = common_ranges(first.rows.ranges, second.rows.ranges)
        inside = _Predictions.of(first, second, spread_between(ranges, POSES))
        to_motion = np.asarray(np.linalg.pinv(inside.gauge, rcond=1e-9), dtype=np.float64)
        motion = to_motion @ inside.difference_under(estimates)
        return cls(inside, estimates, joint, to_motion, motion)

    def difference(self, at: _Predictions) -> Array:
        """Return the prediction of b less that of a under common priors, without the motion, shape (N D,)."""
        return np.asarray(at.difference_under(self.estimates) - at.gauge @ self.motion)

    def displacement(self, where: Where, at: _Predictions) -> Displacement:
        """Return the target's displacement from a to b, without the motion, over the joint values of predictions."""
        moved = self.difference(at).reshape(-1, at.coordinates)
        points, angles = moved[:, :3], moved[:, 3:] / _LEVER  # b less a, (N, 3) [m] and [rad]
        # Derivative of the points by the parameters of both, (N, 3, p_a + p_b): the motion follows the parameters.
        J = at.signed - at.gauge @ (self.to_motion @ self.inside.signed)
        count = len(points)
        J = J.reshape(count, at.coordinates, J.shape[1])[:, :3]
        noise = float(np.einsum("ndp,pq,ndq->", J, self.joint, J)) / count
        square = np.sum(points**2, axis=1)
        rms = float(np.sqrt(np.mean(square)))
        slope = np.einsum("nd,ndp->p", points, J)  # of half the sum of squares
        std = float(np.sqrt(max(slope @ self.joint @ slope, 0.0)))
        return Displacement(
            where=where,
            rms=rms,
            max=float(np.sqrt(square.max())),
            noise=float(np.sqrt(max(noise, 0.0))),
            std=std / (count * rms) if rms > 0.0 else 0.0,
            rms_angle=float(np.sqrt(np.mean(np.sum(angles**2, axis=1)))) if at.turns else np.nan,
        )


@dataclass(frozen=True, slots=True, eq=False)
class _OwnEffects:
    """Effects of one result's p own parameters on the target, beyond those of a motion of base and target."""

    #: Shape (p,), their names
    names: NDArray[Any]
    #: Shape (p,), typical errors of arms in each, in its unit
    steps: Array
    #: Shape (N D, p), displacements of the target by a unit of each, without what a motion explains of them [m]
    remaining: Array
    #: Shape (p,), False for parameters that a motion of base and target compensates
    known: Mask

    @classmethod
    def of(cls, result: Calibration, effect: Array, compensation: _Compensation) -> _OwnEffects:
        """Subtract from displacements (N D, p) [m] by a unit of each own parameter what a motion explains of each.

        They are of the joint values that both data cover, as the compensation is.
        """
        explained = compensation.inside.gauge @ (compensation.to_motion @ effect)
        remaining = np.asarray(effect - explained)
        size = np.linalg.norm(effect, axis=0)
        known = np.asarray(np.linalg.norm(remaining, axis=0) >= _OWN * size)
        return cls(np.array(own_names(result)), _own_steps(result), remaining, known)

    @property
    def in_steps(self) -> Array:
        """Displacements of the target by a typical error of each parameter, shape (N D, p), [m]."""
        return self.remaining * self.steps

    @property
    def compensated(self) -> list[str]:
        """Names of the parameters that a motion of base and target compensates."""
        return list(self.names[~self.known].tolist())

    def along(self, basis: Array) -> Array:
        """Return the components (r, p) along a basis (N D, r), [m] a unit, zero for compensated parameters."""
        return np.asarray(basis.T @ np.where(self.known, self.remaining, 0.0))


def _not_spanned(effect: Array, other: Array, names: NDArray[Any]) -> tuple[str, ...]:
    """List the parameters of one result whose effects cannot be made by those of the other.

    Effects are (r, p) and (r, p_other), displacements by typical errors in r coordinates [m]; those below `_OWN` times
    the largest count as that large.
    """
    U, values, _ = np.linalg.svd(other, full_matrices=False)
    largest = max(float(values.max(initial=0.0)), 1e-300)
    span = U[:, values > _SPANS_NOTHING * largest]
    outside = np.linalg.norm(effect - span @ (span.T @ effect), axis=0)
    size = np.linalg.norm(effect, axis=0)
    least = _OWN * np.maximum(size, _OWN * size.max(initial=0.0))
    return tuple(names[(outside > least) & (least > 0.0)].tolist())
