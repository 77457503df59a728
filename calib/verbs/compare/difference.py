"""Difference of two calibrations' predictions, without what frame and target compensate.

The difference of two results' predictions of one target in the base is delta(q) = J_b x_b - J_a x_a to first order.
Where a fit estimated the base's place or the target from its own data, the motion of them that explains delta best, by
least squares over the joint values that both data cover, is subtracted, there and everywhere: frame and target are the
gauge of the comparison. Measured orientations count as their effect at the end of a lever of 100 mm. The difference is
tested by `calib.verbs.compare.drift`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array, Mask
from calib.model.error_model import DIRECTIONS
from calib.model.kinematics import Kinematics
from calib.model.observability import steps
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
        """The rms displacement without the part that the noise of both results would show [m], 0 or more.

        sqrt(rms^2 - noise^2), with ``rms``, the rms displacement of the predicted target from result a to result b over
        joint values [m], and ``noise``, the rms that the covariance of the parameters of both results alone would show
        [m].
        """
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


def own_names(result: Calibration) -> tuple[str, ...]:
    """Return the names of the robot's own parameters, in the order of the result's vector x.

    Args:
        result: A calibration result. Its ``model`` lists the p parameters of its geometry; those of measurement frames
            and targets are left out.
    """
    return tuple(result.model.names[k] for k in _own_indices(result))


def _own_indices(result: Calibration) -> NDArray[np.int_]:
    """Return the indices of the robot's own parameters in a result's parameter vector x.

    Args:
        result: A calibration result. Its ``model`` lists p parameters: of the robot, of measurement frames and of
            targets; the last two are left out.

    Returns:
        shape (k,), from 0, ascending.
    """
    return np.flatnonzero(result.model.of_robot)


def _own_steps(result: Calibration) -> Array:
    """Return typical errors of arms in each of the robot's own parameters: 1 mm of a length, 1 mrad of an angle.

    Args:
        result: A calibration result, of whose ``model`` the units of the parameters are used.

    Returns:
        shape (k,), for the k parameters that are not of frames and targets, in the order of x, each in its SI unit:
        1e-3 [m], 1e-3 [rad], and those that `calib.model.families` declares for other units.
    """
    return steps([result.model.units[k] for k in _own_indices(result)])


def unknown_frame(result: Calibration) -> tuple[str, ...]:
    """Return the directions in which a result's measurements did not determine the base's pose beforehand.

    Args:
        result: A calibration result. Of it are used the kinds of its rows, ``frame_estimated``, whether the measurement
            frames were left to be estimated, and ``setup.unknown``, the directions of each frame that were.

    Returns:
        Some of ``"x"``, ``"y"``, ``"z"``, ``"rx"``, ``"ry"`` and ``"rz"``, along and about the base's axes, in this
        order: those that were estimated for at least one frame. All six where no row determines where the base stands;
        none where the measurement frames were taken as known.
    """
    if not result.rows.tells_place:
        return DIRECTIONS  # sockets, planes, anchors and pairs never do
    if not result.method.frame_estimated:
        return ()
    estimated = {direction for unknown in result.setup.unknown for direction in unknown}
    return tuple(direction for direction in DIRECTIONS if direction in estimated)


def _common_ranges(a: Array, b: Array) -> Array:
    """Return the range of each joint that both data cover, or from the lowest to the highest value of both if none is.

    Args:
        a: Smallest and largest fitted value of each of m joints in the first result, shape (m, 2), [rad] or [m]; NaN,
            or from infinity down to minus infinity, where no row was fitted: then the other result's range is taken.
        b: Those of the second.

    Returns:
        Lower and upper end, shape (m, 2), [rad] or [m], finite; both 0 where neither has fitted rows.
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
    """Return a result under priors that both results share and that leave room for a drift, to first order.

        C_q = (C^-1 + Q - P)^-1,    x_q = x + C_q (s - Q x)

    with the diagonal precision P of the fit's priors and Q of the shared ones, which have the mean 0. Q differs from P
    for the k parameters of the robot alone. Parameters at a bound are held there.

    Args:
        result: The calibration result: its p parameters ``x``, offsets from the registered start in their units; their
            ``covariance`` C, shape (p, p); of each of ``parameters`` the ``prior_std``, NaN without prior,
            ``at_bound``, and ``data_gradient`` s, minus the derivative of half the data's weighted squares [1/unit];
            and ``freedom``, the degrees of freedom of its noise.
        other: The result with which it is compared, of which only the priors count.

    Returns:
        Of the k parameters of the robot: ``covariance`` C_q and ``noise``, its part from the measurements, C_q - C_q Q
        C_q over all p parameters, both shape (k, k); ``pull`` C_q Q, shape (k, k); ``prior``, the shared priors'
        variances, and ``shift``, x_q - x, both shape (k,); and the degrees of freedom.
    """
    precision, indices = _prior_precision(result), _own_indices(result)
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
    """Return the precision of the priors under which two results are compared, for one result's own parameters.

    It is the lower of both results' precisions, or this result's where the other lacks the parameter; but the prior's
    standard deviation is at least `_ROOM`, to leave room for a drift, and at most `_WIDEST`, both in the typical errors
    of arms, 1 mm or 1 mrad.

    Args:
        result: The calibration result, with the prior standard deviations of its parameters.
        other: The result with which it is compared; its parameters are matched by name.

    Returns:
        1 / variance of the k parameters of the result's robot, those of frames and targets left out, shape (k,),
        [1/unit^2].
    """
    precision, of_other = _prior_precision(result), _prior_precision(other)
    by_name = dict(zip(other.model.names, of_other, strict=True))
    step = _own_steps(result)
    shared = []
    for k in _own_indices(result):
        of_same_name = by_name.get(result.model.names[k], np.inf)
        shared.append(min(precision[k], of_same_name))
    # Never wider than anything an arm may err by either: with priors off there is none.
    lowest, highest = 1.0 / (_WIDEST * step) ** 2, 1.0 / (_ROOM * step) ** 2
    return np.asarray(np.clip(shared, lowest, highest))


def _prior_precision(result: Calibration) -> Array:
    """Return the precision of each parameter's prior, 1 / variance.

    Args:
        result: A calibration result. Of its ``parameters``, p in the order of x, frames and targets included, the
            ``prior_std`` is used, in the parameter's unit; NaN without prior.

    Returns:
        shape (p,), [1/unit^2]; 0 where there was no prior.
    """
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
        """Derivative of b's prediction less a's by the parameters of both results: minus those of a, then those of b.

        Shape (N D, p_a + p_b), [m] a unit of each parameter. With ``effects``, the derivatives of the predictions of a
        and of b by the p_a and p_b parameters of their robots, shapes (N D, p_a) and (N D, p_b), at the nominal robot:
        D coordinates at each of N joint values.
        """
        effect_a, effect_b = self.effects
        return np.hstack([-effect_a, effect_b])

    @property
    def coordinates(self) -> int:
        """Number D of coordinates of a prediction: 3 of the position, and with ``turns`` 3 of the orientation."""
        return 6 if self.turns else 3

    def moved(self, estimates: tuple[Estimate, Estimate]) -> Array:
        """Return the difference of the predictions, b less a, with both results brought to the same priors.

        To ``difference``, shape (N D,) [m], of the results as they are, is added what the change of each result's
        parameters does, by ``slopes``, shapes (N D, p_a) and (N D, p_b), [m] a unit: derivatives of the predictions of
        a and of b by the parameters of their robots, at the calibrated values.

        Args:
            estimates: Results a and b under common priors, of which ``shift`` is used: the change of their p_a and p_b
                parameters by the change of priors, in their units.

        Returns:
            shape (N D,), [m]: of each of N joint values the position in the base, and with D = 6 the rotation vector
            behind, times a lever of 0.1 m.
        """
        slope_a, slope_b = self.slopes
        a, b = estimates
        return np.asarray(self.difference + slope_b @ b.shift - slope_a @ a.shift)


def _predictions(a: Calibration, b: Calibration, q: Array) -> _Predictions:
    """Predict one target in the base by two calibration results.

    Args:
        a: The first result, whose first target, as it is in the tip, is predicted by both.
        b: The second.
        q: Joint values, shape (N, m), [rad] or [m].

    Returns:
        The difference of the predictions by the calibrated geometries, b less a, shape (N D,) [m]; their derivatives by
        the parameters of either robot; and ``gauge``, shape (N D, g), those by the g directions of base and target that
        either result had to estimate. D is 6, with rotation vectors of R_b R_a^T times a lever of 0.1 m, where both
        results measured orientations; else 3, positions alone. All along the base's axes.
    """
    turns = a.setup.rotation and b.setup.rotation
    by_a, by_b = _prediction(a, a, q), _prediction(b, a, q)
    difference = by_b.calibrated[:, :3, 3] - by_a.calibrated[:, :3, 3]
    if turns:
        R_a, R_b = by_a.calibrated[:, :3, :3], by_b.calibrated[:, :3, :3]
        R_ab = Rotation.from_matrix(R_b @ R_a.transpose(0, 2, 1))
        difference = np.hstack([difference, _LEVER * R_ab.as_rotvec()])
    gauge = _place_twists(by_a.nominal)[:, :, _unknown_places(a, b, turns=turns)]
    effects = [_as_lengths(prediction.effect, turns=turns) for prediction in (by_a, by_b)]
    slopes = [_as_lengths(prediction.slope, turns=turns) for prediction in (by_a, by_b)]
    return _Predictions(
        turns=turns,
        difference=difference.ravel(),
        effects=(effects[0], effects[1]),
        slopes=(slopes[0], slopes[1]),
        gauge=_as_lengths(gauge, turns=turns),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Prediction:
    """Poses of one target in the base at N joint values by one result, with p parameters of its robot."""

    #: Shape (N, 4, 4), T_base_target by the nominal robot [m]
    nominal: Array
    #: Shape (N, 4, 4), T_base_target by the calibrated robot [m]
    calibrated: Array
    #: Shape (N, 6, p), the target's velocity in a unit of each parameter at the nominal robot, linear [m] then angular
    #: [rad], along the base's axes
    effect: Array
    #: The same at the calibrated robot
    slope: Array


def _prediction(result: Calibration, first: Calibration, q: Array) -> _Prediction:
    """Predict a target in the base by the parameters of one result's robot, those of frames and targets left out.

    Args:
        result: The calibration result that predicts, by its nominal robot and the k parameters of its geometry that are
            the robot's own, with their values in ``x``.
        first: The result whose first target is predicted: ``setup.T_tip_target[0]``, as it was estimated or given.
        q: Joint values, shape (N, m), [rad] or [m].

    Returns:
        T_base_target by the nominal and by the calibrated robot, shape (N, 4, 4) [m], and the target's derivatives by
        the k parameters at either, shape (N, 6, k), linear [m] then angular [rad], along the base's axes.
    """
    indices = _own_indices(result)
    others = np.delete(np.array(result.model.names), indices)
    frames = np.tile(np.eye(4), (len(result.setup.groups), 1, 1))
    targets = np.tile(first.setup.T_tip_target[0], (len(result.setup.targets), 1, 1))
    kinematics = Kinematics(result.nominal, result.model.without(others), frames, targets)
    # Effects at the nominal robot, from which both count: elsewhere they would differ by what is of second order, and
    # that would look like combinations of their own.
    # Poses, (N, 4, 4), and their derivatives, (N, 6, k).
    nominal, effect = kinematics.twists(np.zeros(len(indices)), q)
    calibrated, slope = kinematics.twists(result.geometry.x[indices], q)
    return _Prediction(nominal, calibrated, effect, slope)


def _place_twists(T_base_target: Array) -> Array:
    """Return the twists of the target by small motions of the base and of the target itself.

    Args:
        T_base_target: Poses of the target in the base, shape (N, 4, 4), [m].

    Returns:
        shape (N, 6, 12), the target's velocity along the base's axes, linear [m] then angular [rad]. Columns are a
        unit, 1 m or 1 rad, of x, y, z, rx, ry, rz of the base, along its axes and about its origin; then of the target,
        along and about its own axes.
    """
    twists = np.zeros((len(T_base_target), 6, 12))
    points, R = T_base_target[:, None, :3, 3], T_base_target[:, :3, :3]
    twists[:, :, :6] = np.eye(6)
    twists[:, :3, 3:6] = np.cross(np.eye(3), points).transpose(0, 2, 1)
    twists[:, :3, 6:9] = R
    twists[:, 3:, 9:] = R
    return twists


def _unknown_places(a: Calibration, b: Calibration, *, turns: bool) -> list[bool]:
    """Tell of each motion of base and target if either result had to estimate it.

    Args:
        a: The first calibration result: its unknown directions of the base, see `unknown_frame`, and whether it
            estimated a target.
        b: The second.
        turns: Whether orientations were measured for both, so that the target's orientation was estimated too.

    Returns:
        12 values, True where it had to: x, y, z, rx, ry, rz of the base, then of the target, as the columns of
        `_place_twists`.
    """
    unknown = {*unknown_frame(a), *unknown_frame(b)}
    target = a.setup.estimate_target or b.setup.estimate_target
    of_base = [direction in unknown for direction in DIRECTIONS]
    return of_base + [target] * 3 + [target and turns] * 3


def _as_lengths(twists: Array, *, turns: bool) -> Array:
    """Return twists as displacements in length: angles are multiplied by a lever of `_LEVER`, 0.1 m.

    Args:
        twists: shape (N, 6, k), at N joint values, linear [m] then angular [rad], by each of k motions or parameters.
        turns: Whether orientations count; if not, the angular part is left out.

    Returns:
        shape (N D, k), [m], with D = 6 coordinates where orientations count, else 3; those of one joint value follow
        each other.
    """
    scaled = twists * np.repeat([1.0, _LEVER], 3)[:, None]
    coordinates = 6 if turns else 3
    return np.asarray(scaled[:, :coordinates].reshape(-1, twists.shape[2]))


# Differences


@dataclass(frozen=True, slots=True, eq=False)
class _Compensation:
    """The motion of base and target that explains the difference best, over the joint values that both data cover."""

    #: Predictions of both results at the joint values that both data cover
    inside: _Predictions
    #: Results a and b under common priors
    estimates: tuple[Estimate, Estimate]
    #: Shape (p_a + p_b, p_a + p_b), covariance of the parameters of both results together, those of their robots
    joint: Array
    #: Shape (g, N D), takes displacements at the joint values inside to the motion
    to_motion: Array
    #: Shape (g,), the motion for the difference: the directions of base and target that are not known [m], [rad]
    motion: Array

    @classmethod
    def of(
        cls,
        inside: _Predictions,
        estimates: tuple[Estimate, Estimate],
        joint: Array,
    ) -> _Compensation:
        """Fit the motion of base and target to the difference of two results' predictions, by least squares.

        Args:
            inside: Predictions of both results at N joint values that both data cover, D coordinates each. Their
                ``gauge``, shape (N D, g) [m], is what a unit of each of g directions of base and target does, those
                that either result had to estimate; it may have no columns.
            estimates: Results a and b under common priors, of which the change of their parameters is used.
            joint: Covariance of the parameters of both results together, those of the robots, shape
                (p_a + p_b, p_a + p_b), which is only stored.

        Returns:
            The fitted motion, shape (g,), [m] and [rad], with what it was fitted to.
        """
        to_motion = np.asarray(np.linalg.pinv(inside.gauge, rcond=1e-9), dtype=np.float64)
        motion = to_motion @ inside.moved(estimates)
        return cls(inside, estimates, joint, to_motion, motion)

    def remaining(self, effect: Array) -> Array:
        """Return effects of parameters without what a motion of base and target explains of each.

        The motion is fitted by ``to_motion``, shape (g, N D), the least-squares inverse of ``inside.gauge``, shape
        (N D, g), which is what g directions of base and target do.

        Args:
            effect: Displacements of the target by a unit of each of p parameters, shape (N D, p), [m]: D coordinates at
                each of the N joint values of ``inside``.

        Returns:
            Likewise, shape (N D, p), [m].
        """
        return np.asarray(effect - self.inside.gauge @ (self.to_motion @ effect))

    def difference(self, at: _Predictions) -> Array:
        """Return the difference of two results under common priors, without the ``motion`` of base and target.

        With ``estimates``, results a and b under common priors, and ``motion``, shape (g,), which was fitted to the
        difference at other joint values, those that both data cover: g directions of base and target, [m] and [rad].

        Args:
            at: Predictions of both results at any N joint values, D coordinates each, with ``gauge``, shape (N D, g),
                the displacements of the target by a unit of each direction.

        Returns:
            b less a, shape (N D,), [m], along the base's axes: of each joint value the position, then, with D = 6, the
            rotation vector times a lever of 0.1 m.
        """
        return np.asarray(at.moved(self.estimates) - at.gauge @ self.motion)

    def jacobian(self, at: _Predictions) -> Array:
        """Return the derivative of `difference` by the parameters of both results' robots.

        The motion of base and target follows the parameters: ``to_motion``, shape (g, M), takes displacements at the
        joint values of ``inside``, M coordinates together, to the motion in g directions that explains them best.

        Args:
            at: Predictions of both results at any N joint values, D coordinates each: ``signed``, shape
                (N D, p_a + p_b), the derivative of b's prediction less a's by the parameters of both, and ``gauge``,
                shape (N D, g), that by the motion.

        Returns:
            shape (N, D, p_a + p_b), [m] a unit of each parameter of a, then of b.
        """
        J = at.signed - at.gauge @ (self.to_motion @ self.inside.signed)
        return np.asarray(J.reshape(-1, at.coordinates, J.shape[1]))

    def displacement(self, where: Where, at: _Predictions) -> Displacement:
        """Return the displacement of the target from result a to result b, without the motion of base and target.

        With ``joint``, the covariance of the parameters of both results together, shape (p_a + p_b, p_a + p_b).

        Args:
            where: Name of the joint values: ``"measured ranges"`` or ``"joint limits"``.
            at: Predictions of both results at these N joint values.

        Returns:
            ``rms`` and ``max``, of the displacements of the position over the N joint values [m]; ``noise``, the rms
            that ``joint`` alone would make [m]; ``std``, the standard deviation of ``rms`` by it [m]; and ``rms_angle``
            [rad], NaN where orientations do not count.
        """
        moved = self.difference(at).reshape(-1, at.coordinates)
        points, angles = moved[:, :3], moved[:, 3:] / _LEVER  # b less a, (N, 3) [m] and [rad]
        J = self.jacobian(at)[:, :3]  # (N, 3, p_a + p_b)
        count = len(points)
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
            rms_angle=_rms_norm(angles) if at.turns else np.nan,
        )


def _rms_norm(vectors: Array) -> float:
    """Return the root mean square of the norms of vectors.

    Args:
        vectors: shape (N, d), such as rotation vectors [rad].

    Returns:
        In their unit.
    """
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))


def _compensation(first: Calibration, second: Calibration, *, same_start: bool) -> _Compensation:
    """Bring two results to common priors, and fit a motion of base and target to the difference of their predictions.

    The motion is what frame and target, which each result estimated from its own data, can absorb of the difference.

    Args:
        first: Result a, with its parameters, their covariance and priors, and the joint ranges of its fitted rows.
        second: Result b.
        same_start: Whether both count from the same nominal robot. If so, and if their parameters are the same, they
            share the means of their priors, and their errors are correlated.

    Returns:
        The motion, with the predictions at the 200 joint values, spread over the ranges that both data cover, to which
        it was fitted, both results under common priors, and the covariance of the parameters of both together.
    """
    estimates = (_estimate(first, second), _estimate(second, first))
    alike = same_start and _same_parameters(first, second)
    # Covariance of the parameters of both results together, (p_a + p_b, p_a + p_b).
    joint = joint_covariance(*estimates, alike=alike)
    ranges = _common_ranges(first.rows.ranges, second.rows.ranges)
    inside = _predictions(first, second, spread_between(ranges, _POSES))
    return _Compensation.of(inside, estimates, joint)


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
    def of(
        cls,
        result: Calibration,
        effect: Array,
        compensation: _Compensation,
    ) -> _OwnEffects:
        """Take from the effects of a robot's parameters what a motion of base and target explains.

        Args:
            result: The calibration result, for names and units of the p parameters of its robot, frames and targets
                left out.
            effect: Displacements of the target by a unit of each of these, shape (N D, p), [m]: D coordinates, along
                the base's axes, at each of N joint values that both data cover.
            compensation: The fit of a motion of base and target at these joint values.

        Returns:
            The effects that remain, shape (N D, p), and ``known``, of which parameters enough remains, shape (p,).
        """
        remaining = compensation.remaining(effect)
        return cls(
            names=np.array(own_names(result)),
            steps=_own_steps(result),
            remaining=remaining,
            known=_is_known(remaining, effect),
        )

    @property
    def in_steps(self) -> Array:
        """Displacements of the target by a typical error of each parameter, shape (N D, p), [m].

        ``remaining``, shape (N D, p), the displacements by a unit of each of p parameters in the base frame, D = 3
        coordinates at each of N joint values, or 6 with rotations at the end of a lever, without what a motion of base
        and target explains, times ``steps``, shape (p,), typical errors of arms such as 1 mm or 1 mrad.
        """
        return self.remaining * self.steps

    @property
    def compensated(self) -> list[str]:
        """Names of the parameters that a motion of base and target compensates: of ``names``, those not ``known``."""
        return list(self.names[~self.known].tolist())

    def along(self, basis: Array) -> Array:
        """Return the components of the effects of a unit of each parameter along an orthonormal basis of displacements.

        With ``remaining``, shape (N D, p), [m]: displacements of the target in the base by a unit of each of p
        parameters of the robot, D coordinates (3 of the position, and 3 of the orientation times a lever of 0.1 m if it
        counts) at each of N joint values that both data cover, without what a motion of base and target explains; and
        ``known``, shape (p,), False for parameters of which such a motion explains all but a trace.

        Args:
            basis: Orthonormal displacements as columns, shape (N D, r), [1].

        Returns:
            shape (r, p), [m]; zero for parameters that are not ``known``.
        """
        return np.asarray(basis.T @ np.where(self.known, self.remaining, 0.0))


def differences_of(first: Calibration, second: Calibration, *, same_start: bool) -> Differences:
    """Test the difference of two results' predictions of a target, and average it over joint values.

    Args:
        first: Result a: its nominal robot, the parameters of its geometry with covariance and priors, frames and
            targets, and fitted joint ranges.
        second: Result b, of the same chain.
        same_start: Whether both have the same nominal joint origins, from which their parameters count.

    Returns:
        ``test``, whether the difference is more than noise; ``moves``, the displacement of the target from a to b over
        the joint values that both data cover, and over the joint limits; and names of parameters: ``compensated``,
        whose drift frame and target would hide, and ``only_a`` and ``only_b``, whose effects the other result's
        parameters cannot have.
    """
    compensation = _compensation(first, second, same_start=same_start)
    inside = compensation.inside
    everywhere = _predictions(first, second, spread_poses(first.nominal, _POSES))
    own_a = _OwnEffects.of(first, inside.effects[0], compensation)
    own_b = _OwnEffects.of(second, inside.effects[1], compensation)
    basis = _basis(own_a, own_b, _NOTHING if same_start else _NOTHING_APART)
    # In the r coordinates of the basis, (r, p_a) and (r, p_b), [m] a unit of each parameter.
    effect_a, effect_b = own_a.along(basis), own_b.along(basis)
    test = drift_test(
        basis.T @ compensation.difference(inside),
        (effect_a, effect_b),
        compensation.estimates,
        compensation.joint,
        _ROUNDING * np.sqrt(_POSES),
    )
    compensated = own_a.compensated + own_b.compensated
    in_steps_a, in_steps_b = effect_a * own_a.steps, effect_b * own_b.steps
    return Differences(
        test=test,
        moves=(
            compensation.displacement("measured ranges", inside),
            compensation.displacement("joint limits", everywhere),
        ),
        compensated=tuple(dict.fromkeys(compensated)),
        only_a=_not_spanned(in_steps_a, in_steps_b, own_a.names),
        only_b=_not_spanned(in_steps_b, in_steps_a, own_b.names),
    )


def _same_parameters(first: Calibration, second: Calibration) -> bool:
    """Tell if two calibration results have the same parameters of the robot, tied alike.

    Args:
        first: The first result: names of its parameters, name of its parameter set, and ``ties``.
        second: The second.

    Returns:
        True if names, in their order, parameter set and ties are equal; parameters of frames and targets do not count.
    """
    same_names = own_names(first) == own_names(second)
    same_ties = dict(first.method.ties) == dict(second.method.ties)
    return same_names and same_ties and first.model.name == second.model.name


def _is_known(remaining: Array, effect: Array) -> Mask:
    """Tell of each parameter if a motion of base and target does not compensate it.

    Args:
        remaining: Displacements of the target by a unit of each of p parameters, without what the motion explains,
            shape (N D, p), [m]: D coordinates at each of N joint values.
        effect: The whole displacements, shape (N D, p), [m].

    Returns:
        shape (p,), True where the norm of what remains, over all N D displacements, is at least `_OWN` times that of
        the effect.
    """
    size = np.linalg.norm(effect, axis=0)
    return np.asarray(np.linalg.norm(remaining, axis=0) >= _OWN * size)


def _basis(a: _OwnEffects, b: _OwnEffects, smallest: float) -> Array:
    """Return an orthonormal basis of all displacements that the parameters of both results' robots can make.

    Args:
        a: Effects of the p_a parameters of result a on the target at N joint values, D coordinates each, without what a
            motion of base and target explains; used by typical errors of arms, such as 1 mm or 1 mrad.
        b: Those of result b, at the same joint values.
        smallest: Singular values up to this share of the largest are none.

    Returns:
        shape (N D, r), its vectors as columns.
    """
    in_steps = np.hstack([a.in_steps, b.in_steps])
    U, values, _ = np.linalg.svd(in_steps, full_matrices=False)
    least = max(values.max(initial=0.0), 1e-300) * smallest
    return np.asarray(U[:, values > least])


def _not_spanned(effect: Array, other: Array, names: NDArray[Any]) -> tuple[str, ...]:
    """List the parameters of one result whose effects those of the other result cannot have.

    Args:
        effect: Displacements of the target by typical errors of the result's p parameters, in r coordinates, shape
            (r, p), [m].
        other: Those by the other result's parameters, in the same coordinates, shape (r, p_other), [m].
        names: Names of the result's parameters, shape (p,).

    Returns:
        Names of parameters of whose effect more than the share `_OWN` lies outside of what the other's effects span;
        effects below `_OWN` times the largest count as that large.
    """
    U, values, _ = np.linalg.svd(other, full_matrices=False)
    largest = max(float(values.max(initial=0.0)), 1e-300)
    span = U[:, values > _SPANS_NOTHING * largest]
    outside = np.linalg.norm(effect - span @ (span.T @ effect), axis=0)
    size = np.linalg.norm(effect, axis=0)
    least = _OWN * np.maximum(size, _OWN * size.max(initial=0.0))
    return tuple(names[(outside > least) & (least > 0.0)].tolist())
