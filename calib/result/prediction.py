"""Predictions of a fitted model: its parameters with their intervals, poses, and how sure these are.

The standard deviation of a predicted position is that of J dx, sqrt(trace(J C J^T)), with the parameters' covariance C
and the Jacobian J of the prediction. Rows that measure no position in a known frame (sockets, planes, anchors, pairs)
determine neither where the base stands nor how it is turned: what moves all poses as one body is then known by the
priors alone. Predictions in the base leave it out: from J is subtracted the rigid motion of the base that compensates
best what a parameter does at the measured poses (`FittedModel.base_motion`), wherever else a pose is predicted.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

import calib.data.kinds as registry
from calib.basics.arrays import Array, read_only
from calib.basics.values import Value, keep_read_only
from calib.diagnosis.reasons import Verdict
from calib.fit.estimate.fitting import Fitted
from calib.fit.registration.setup import Setup
from calib.model.kinematics import Kinematics, Samples
from calib.model.observability import Observability
from calib.model.parameters import FRAME, TARGET, ErrorModel
from calib.numerics.errors import CrossValidation, interval_factor, rms
from calib.numerics.rigid_motion import best_motion, displacements_by
from calib.robot.gravity import Payload, gravity_loads
from calib.robot.robot import Robot

#: The most poses over which an expected error is averaged.
_MOST_EXPECTED = 1000

#: The most measured poses to which a motion of the base is fitted; more change it no more.
_MOST_MEASURED = 20_000


@dataclass(frozen=True, slots=True)
class ParameterEstimate:
    """One parameter of the result, in its unit."""

    #: Its name
    name: str
    #: ``"m"``, ``"rad"``, ``"1"``, ``"m/m"``, ``"rad/Nm"`` or ``"m/N"``
    unit: str
    #: The value before; None for a target that was not given
    nominal: float | None
    #: The value after
    value: float
    #: The change; for a target that was not given, from where registration put it
    delta: float
    #: Standard deviation of the value
    std: float
    #: Lower end of the value's 95 % interval
    low: float
    #: Upper end
    high: float
    #: Whether the measurements determine it, not in combinations only
    identifiable: bool
    #: Whether a bound stopped it; std and interval are then NaN
    at_bound: bool = False
    #: Of the prior that the fit ended with; NaN where there was none
    prior_std: float = np.nan
    #: Minus the derivative of half the sum of the data's weighted squares by the parameter [1/unit]; positive where the
    #: data ask for a larger value. At the optimum it equals the pull of the prior, (x - mean) / prior_std^2. Where a
    #: prior is next to nothing wide, x is too, and only this still shows what the data ask for.
    data_gradient: float = np.nan


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FittedModel(Value):
    """One fitted error model: its parameters, their covariance, and what it predicts."""

    #: The nominal robot, with frames and targets where ``x`` counts from
    kinematics: Kinematics
    #: Shape (p,), offsets from the registered start [m, rad]
    x: Array
    #: Shape (p, p), of ``x``
    covariance: Array
    #: Standard deviation of the prior of each family's errors, in its unit; empty without priors
    prior_std: Mapping[str, float]
    #: One entry for each element of ``x``
    parameters: tuple[ParameterEstimate, ...]
    #: Frames and targets as estimated or given
    setup: Setup
    #: shape (6, p), the motion of the base, linear part first, that compensates a unit of each parameter best over the
    #: measured poses; None where the rows determine where the base stands
    base_motion: Array | None
    #: On held-out fitted rows; None without
    cross_validation: CrossValidation | None
    #: Standard deviation of the predicted point at the measured poses, rms [m]. From the covariance, so it knows
    #: nothing of errors that the model lacks
    expected_measured: float
    #: The same over joint values spread over the limits [m]
    expected_everywhere: float
    #: Squared error of extrapolated predictions over that by the covariance, 1 or more
    extrapolation: float = 1.0

    def __post_init__(self) -> None:
        """Keep a read-only copy of the mapping."""
        keep_read_only(self, "prior_std")

    @property
    def expected_elsewhere(self) -> float:
        """Standard deviation of the predicted point over the joint limits, rms [m], with what the model lacks.

        Errors that the model lacks do not average out over rows: beyond the measured poses the variance that the
        covariance adds, ``expected_everywhere``^2 - ``expected_measured``^2, is ``extrapolation`` times as large, if it
        is positive. The first two are standard deviations by the covariance, rms over the joint limits and over the
        measured poses [m]; the factor is 1 or more.
        """
        at_measured = self.expected_measured**2
        added = self.expected_everywhere**2 - at_measured
        factor = self.extrapolation if added > 0.0 else 1.0
        return float(np.sqrt(at_measured + added * factor))

    @property
    def new_point(self) -> tuple[float, float]:
        """Expected error at a new point, rms [m]: at poses like those measured, and over the joint limits.

        The first is the rms error of held-out rows of ``cross_validation``, outliers aside, and knows what the model
        lacks. For the second the variance of the prediction at the measured poses, the square of ``expected_measured``,
        is exchanged for that over the limits, the square of ``expected_elsewhere``. Without cross-validation, or where
        no length was measured, these two are returned, by the covariance alone.
        """
        at_measured, elsewhere = self.expected_measured, self.expected_elsewhere
        if (
            self.cross_validation is None
            or not self.cross_validation.errors_without_outliers["m"].n
        ):
            return at_measured, elsewhere
        held_out = self.cross_validation.errors_without_outliers["m"].rms
        beside_prediction = max(held_out**2 - at_measured**2, 0.0)
        return held_out, float(np.sqrt(beside_prediction + elsewhere**2))

    @property
    def model(self) -> ErrorModel:
        """The error model of ``kinematics``: the p parameters, the places where they act, and their directions."""
        return self.kinematics.model

    def pose_std(self, samples: Samples, *, in_base: bool = False) -> Array:
        """Return standard deviations of predicted poses of the target, by the covariance of the parameters.

        They know nothing of errors that the model lacks. With ``kinematics``, the nominal robot with frames and targets
        under the error model, ``x``, its p parameters, shape (p,), and their ``covariance``, shape (p, p).

        Args:
            samples: N joint values, with the frame, the target and the loads of each.
            in_base: True to predict in the base, less ``base_motion``, shape (6, p): the rigid motion of all poses that
                compensates a unit of each parameter, None for none; False to predict in each sample's own measurement
                frame.

        Returns:
            Of the position [m] and of the orientation [rad], shape (N, 2): the root of the sum of the variances along
            three axes.
        """
        return pose_std(
            self.kinematics,
            self.x,
            self.covariance,
            samples,
            base_motion=self.base_motion,
            in_base=in_base,
        )

    def tips(self, samples: Samples) -> Array:
        """Return T_base_tip, the pose of the tip in the base, by the parameters ``x``, the joints' own errors included.

        ``kinematics`` predicts the target in its measurement frame, from which T_frame_base and T_tip_target of
        ``setup``, frames and targets at the solution, are taken off.

        Args:
            samples: N joint values, with frames, targets and loads; which frames and targets does not matter.

        Returns:
            shape (N, 4, 4), [m].
        """
        T_frame_target = self.kinematics.poses(self.x, samples)
        T_base_frame = np.linalg.inv(self.setup.T_frame_base)[samples.frame]
        T_target_tip = np.linalg.inv(self.setup.T_tip_target)[samples.target]
        return np.asarray(T_base_frame @ T_frame_target @ T_target_tip)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class NonGeometric(FittedModel):
    """A fitted model with errors that depend on the joints' state, which no URDF can hold."""

    #: Shape (N, D), measured minus predicted, all rows [m], [rad]
    residual: Array
    #: Carried by the tip; None where none was stated
    payload: Payload | None
    #: Shape (3,), in the URDF's root frame [m/s^2]
    gravity: Array
    #: None without cross-validation
    verdict: Verdict | None = None

    @property
    def name(self) -> str:
        """Name of the model: its geometry and families of non-geometric errors, such as ``"dh+compliance"``."""
        return self.model.name

    def load(self, nominal: Robot, q: Array, payload: Payload | None = None) -> Array:
        """Return the load of gravity on the joints, with the ``gravity`` of the calibration, see `gravity_loads`.

        ``gravity`` is the acceleration in the URDF's root link, shape (3,), [m/s^2].

        Args:
            nominal: The nominal robot, n joints in its chain.
            q: Joint values, shape (N, m), [rad] or [m], in the order of the robot's ``joint_names``.
            payload: Point mass that the tip carries; None: that of the measurements, the field ``payload``.

        Returns:
            shape (N, n, n + 3). Of each joint first its load, [Nm], or [N] where it slides; then the lever arms about
            it, [m], or 1 where it slides, of masses at the origins of the n joints, at the tip and at the base.
            Positive where gravity drives the joint towards larger values.
        """
        return gravity_loads(nominal, q, payload or self.payload, self.gravity)


def pose_std(
    kinematics: Kinematics,
    x: Array,
    covariance: Array,
    samples: Samples,
    *,
    base_motion: Array | None,
    in_base: bool,
) -> Array:
    """Return standard deviations of predicted poses of the target, sqrt(trace(J C J^T)).

    C is the covariance of the parameters, and J the derivative of the position, or of the orientation, by them.

    Args:
        kinematics: The nominal robot under its error model of p parameters, with frames and targets at x = 0.
        x: Parameters, shape (p,), in their units, offsets from there.
        covariance: Of the parameters, shape (p, p).
        samples: N joint values, with the frame, the target and the loads of each.
        base_motion: Rigid motion of the base that compensates a unit of each parameter, shape (6, p), linear [m] then
            angular [rad], which is subtracted from its effect; None: no motion. It counts in the base only.
        in_base: True to predict in the base, False in each sample's own measurement frame.

    Returns:
        Of the position [m] and of the orientation [rad], shape (N, 2), read-only: the root of the sum of the variances
        along three axes.
    """
    if in_base:
        poses, twists = twists_in_base(kinematics, x, samples)
        if base_motion is not None:
            twists[:, :3] -= displacements_by(base_motion, poses[:, :3, 3])
            twists[:, 3:] -= base_motion[3:]
    else:
        _, twists = kinematics.twists(x, samples)
    # Twists are of the shape (N, 6, p), linear [m] then angular [rad] a unit of each parameter.
    JC = (twists.reshape(-1, len(x)) @ covariance).reshape(twists.shape)
    variance_by_axis = np.sum(JC * twists, axis=2)
    variance = variance_by_axis.reshape(-1, 2, 3).sum(axis=2)
    return read_only(np.sqrt(np.maximum(variance, 0.0)))


def expected_error(
    kinematics: Kinematics,
    x: Array,
    covariance: Array,
    samples: Samples,
    base_motion: Array | None,
) -> float:
    """Return the standard deviation of the target's predicted position, rms over samples [m].

    Args:
        kinematics: The nominal robot under its error model of p parameters, with frames and targets at x = 0.
        x: Parameters, shape (p,), in their units.
        covariance: Of the parameters, shape (p, p).
        samples: Joint values with frames, targets and loads, of which the first `_MOST_EXPECTED` count.
        base_motion: Rigid motion of the base that compensates a unit of each parameter, shape (6, p), linear [m] then
            angular [rad]: the position is predicted in the base, less this motion; None: in each sample's measurement
            frame.
    """
    std = pose_std(
        kinematics,
        x,
        covariance,
        samples.select(slice(0, _MOST_EXPECTED)),
        base_motion=base_motion,
        in_base=base_motion is not None,
    )
    return rms(std[:, 0])


def parameter_estimates(
    fitted: Fitted, observability: Observability
) -> tuple[ParameterEstimate, ...]:
    """Return nominal value, value, interval and prior of each parameter of a fit.

    Args:
        fitted: A fit with p parameters: its task, error model and estimate, with the offsets x from the registered
            start, their covariance, and the degrees of freedom of the noise.
        observability: ``identifiable``, shape (p,), is True for parameters that the fitted rows determine, not in
            combinations only.

    Returns:
        One entry for each parameter, in the order of the parameter vector x and in the parameter's unit. The interval
        holds the true value with 95 %; it and ``std`` are NaN at a bound.
    """
    estimate = fitted.estimate
    std = _std(fitted)
    half_width = interval_factor(estimate.freedom) * std
    prior_std = _prior_std(estimate.problem.prior_precision)
    data_gradient = _data_gradient(fitted)
    placed = fitted.estimated_setup()
    result = []
    for k, parameter in enumerate(fitted.kinematics.model.parameters):
        nominal, value, delta = _values(fitted, placed, k)
        result.append(
            ParameterEstimate(
                name=parameter.name,
                unit=parameter.unit,
                nominal=nominal,
                value=float(value),
                delta=float(delta),
                std=float(std[k]),
                low=float(value - half_width[k]),
                high=float(value + half_width[k]),
                identifiable=bool(observability.identifiable[k]),
                at_bound=k in estimate.at_bound,
                prior_std=float(prior_std[k]),
                data_gradient=float(data_gradient[k]),
            )
        )
    return tuple(result)


def _std(fitted: Fitted) -> Array:
    """Return the standard deviation of each parameter of a fit.

    Args:
        fitted: A fit with p parameters, of whose estimate are used ``covariance``, shape (p, p), and ``at_bound``,
            indices of the parameters that are held at a bound.

    Returns:
        shape (p,), in the parameters' units; NaN at a bound.
    """
    estimate = fitted.estimate
    std = np.sqrt(np.diag(estimate.covariance))
    std[list(estimate.at_bound)] = np.nan
    return np.asarray(std)


def _prior_std(precision: Array) -> Array:
    """Return the standard deviation of each parameter's prior, 1 / sqrt(precision).

    Args:
        precision: 1 / variance, shape (p,); 0 for a parameter without prior.

    Returns:
        shape (p,), in the parameters' units; NaN without prior.
    """
    known = np.where(precision > 0.0, precision, np.nan)
    return np.asarray(1.0 / np.sqrt(known))


def _values(fitted: Fitted, placed: Setup, k: int) -> tuple[float | None, float, float]:
    """Return nominal value, value and change of one parameter, in its unit.

    Of a parameter of the robot the nominal value is that of the DH table, or 0; of a measurement frame, and of a
    target's orientation, it is 0, and value and change are the offset from the registered start. The position of a
    target is stated along the tip's axes, in the tip, whatever the axes of its parameter.

    Args:
        fitted: A fit: its error model, its offsets x from the registered start, and frames and targets as given
            (``task.setup``) and as registered (``kinematics``).
        placed: Its frames and targets at the solution.
        k: Index of the parameter in x, from 0.

    Returns:
        The value before the fit, None for the position of a target that was not given; the value after it; and the
        difference, for such a target the offset from where registration put it.
    """
    model, given = fitted.kinematics.model, fitted.task.setup
    parameter = model.parameters[k]
    delta = fitted.estimate.x[k]
    if parameter.family != TARGET or parameter.unit != "m":
        return parameter.nominal, parameter.nominal + delta, delta
    target = model.places.index(parameter.place) - len(model.places) + len(given.targets)
    R_tip_target = fitted.kinematics.T_tip_target[target, :3, :3]
    axis = int(np.argmax(np.abs(R_tip_target @ parameter.direction[:3])))
    value = placed.T_tip_target[target, axis, 3]
    if not given.target_given[target]:
        return None, value, delta
    nominal = float(given.T_tip_target[target, axis, 3])
    return nominal, value, value - nominal


def _data_gradient(fitted: Fitted) -> Array:
    """Return minus the derivative of half the sum of the data's weighted squares by each parameter, at the solution.

    At the least of squares with priors it equals their pull, precision (x - centre), which is returned for the paper's
    solver. It shows what the data ask for where a sharp prior keeps a parameter near its nominal value.

    Args:
        fitted: A fit with p parameters: its problem, with residuals, known distances, and priors of mean ``centre`` and
            ``precision``, 1 / variance, shapes (p,); and its solution x.

    Returns:
        shape (p,), [1/unit]; positive where the data ask for a larger value.
    """
    x, problem = fitted.estimate.x, fitted.estimate.problem
    if not fitted.task.has_weights_and_priors:  # x is not at the least of squares
        return np.asarray(problem.prior_precision * (x - problem.prior_mean))
    without_priors = replace(problem, prior_precision=np.zeros(len(x)))
    # Measured minus predicted in standard deviations, (m,), and its derivative by the parameters, (m, p).
    residual, jacobian = without_priors.system(x)
    return -residual @ jacobian


def compensating_base_motion(kinematics: Kinematics, x: Array, samples: Samples) -> Array:
    """Return the motion of the base that compensates a unit of each parameter best over some poses.

    Where rows do not determine where the base stands, it is subtracted from what a parameter does, wherever a pose is
    predicted.

    Args:
        kinematics: The nominal robot under its error model of p parameters, with frames and targets at x = 0.
        x: Parameters, shape (p,), in their units.
        samples: The measured poses: joint values with targets and loads; of many, `_MOST_MEASURED` spread evenly count.

    Returns:
        shape (6, p), read-only: velocity of the base's origin [m], then turn [rad], along the base's axes, in a unit of
        each parameter. It is the rigid motion nearest, by least squares, to what the parameter does to the target's
        positions in the base.
    """
    count = min(len(samples), _MOST_MEASURED)
    spread = np.linspace(0, len(samples) - 1, count).astype(int)
    poses, twists = twists_in_base(kinematics, x, samples.select(spread))
    return read_only(best_motion(poses[:, :3, 3], twists[:, :3]))


def twists_in_base(kinematics: Kinematics, x: Array, samples: Samples) -> tuple[Array, Array]:
    """Return poses of the target in the base, and their derivatives by the parameters.

    Args:
        kinematics: The nominal robot under its error model of p parameters, with frames and targets at x = 0.
        x: Parameters, shape (p,), in their units; those of measurement frames are taken as 0.
        samples: N joint values, with the target and the loads of each; their frames do not count.

    Returns:
        T_base_target, shape (N, 4, 4) [m], and the target's velocity in a unit of each parameter along the base's axes,
        shape (N, 6, p), linear part first [m, rad]; zero for the parameters of frames.
    """
    of_frame = kinematics.model.family(FRAME)
    frames = np.broadcast_to(np.eye(4), kinematics.T_frame_base.shape)
    in_base = replace(kinematics, T_frame_base=frames)
    poses, twists = in_base.twists(np.where(of_frame, 0.0, x), samples)
    return poses, np.where(of_frame, 0.0, twists)


def tells_place(kinds: Iterable[str]) -> bool:
    """Tell if rows of some kinds determine where the base stands; if not, predictions are in the base.

    Args:
        kinds: Names of registered kinds of measurement, such as ``"point"`` or ``"pair"``.

    Returns:
        True if any of them determines where the base stands in the instrument's frame; False for sockets, planes,
        anchors and pairs.
    """
    return any(registry.get(kind).tells_place for kind in kinds)
