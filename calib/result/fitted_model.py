"""A fitted model: its parameters with their intervals, the poses that it predicts, and how sure these are.

The standard deviation of a predicted position is that of J dx, sqrt(trace(J C J^T)), with the parameters' covariance C
and the Jacobian J of the prediction. Rows that measure no position in a known frame (sockets, planes, anchors, pairs)
determine neither where the base stands nor how it is turned: what moves all poses as one body is then known by the
priors alone. Predictions in the base leave it out: from J is subtracted the rigid motion of the base that compensates
best what a parameter does at the measured poses (`FittedModel.base_motion`), wherever else a pose is predicted.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from calib.basics.arrays import Array, read_only
from calib.basics.values import Value, keep_read_only
from calib.diagnosis.augmented_fit import thin
from calib.diagnosis.coverage import extrapolation
from calib.diagnosis.reasons import Verdict
from calib.diagnosis.stated_values import Scale, instrument_scale
from calib.diagnosis.undetermined import Undetermined, undetermined_error
from calib.fit.estimate.fitting import Fitted
from calib.fit.estimate.special_cases.hands_alone import hands_alone
from calib.fit.registration.setup import Setup
from calib.model.error_model import FRAME, TARGET, ErrorModel
from calib.model.kinematics import Kinematics, Samples
from calib.model.observability import Observability
from calib.numerics.errors import CrossValidation, interval_factor, rms
from calib.numerics.moves import last_moves
from calib.numerics.rigid_motion import best_motion, displacements_by, without_rigid_motion
from calib.result.board_errors import BoardErrors, board_errors
from calib.result.parts import Noise
from calib.result.row_scatter import RowScatter
from calib.result.stated_places import StatedPlace, stated_places
from calib.robot.gravity import Payload, gravity_loads
from calib.robot.ranges import spread_poses
from calib.robot.robot import Robot

#: The geometry, or a model with non-geometric errors.
AnyModel = TypeVar("AnyModel", bound="FittedModel")

#: The most poses over which an expected error is averaged.
_MOST_EXPECTED = 1000

#: The most measured poses to which a motion of the base is fitted; more do not change it.
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
    #: Of the prior that the fit ended with; NaN if there was none
    prior_std: float = np.nan
    #: Minus the derivative of half the sum of the data's weighted squares by the parameter [1/unit]; positive if the
    #: data ask for a larger value. At the optimum it equals the pull of the prior, (x - mean) / prior_std^2. If the
    #: prior is extremely narrow, x hardly leaves its mean, and only this gradient shows which way the data pull.
    data_gradient: float = np.nan


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FittedModel(Value):
    """One fitted error model: its parameters, their covariance, what it predicts, and the verdict on it."""

    #: The nominal robot, with frames and targets at ``x`` = 0
    kinematics: Kinematics
    #: Shape (p,), offsets from the registered start, in the parameters' units
    x: Array
    #: Shape (p, p), of ``x`` if the instrument has no scale error
    covariance: Array
    #: Standard deviation of the prior of each family's errors, in its unit; empty without priors
    prior_std: Mapping[str, float]
    #: One entry for each element of ``x``
    parameters: tuple[ParameterEstimate, ...]
    #: Frames and targets as estimated or given
    setup: Setup
    #: Shape (6, p), the motion of the base, linear part [m] then angular [rad], that compensates a unit of each
    #: parameter best over the measured poses; None if the rows determine where the base stands
    base_motion: Array | None
    #: On held-out fitted rows; None without
    cross_validation: CrossValidation | None
    #: Standard deviation of the predicted point at the measured poses, rms [m]. It is that of the covariance, so it
    #: does not include errors that the model lacks
    expected_measured: float
    #: The same over joint values spread over the limits [m]
    expected_everywhere: float
    #: The part of ``expected_measured`` that the scale error of the instrument adds, rms [m]
    scale_measured: float = 0.0
    #: That of ``expected_everywhere``
    scale_everywhere: float = 0.0
    #: The scale error of the instrument; None if no row and no length of the arm has one
    scale: Scale | None = None
    #: Squared error of extrapolated predictions over that by the covariance, 1 or more
    extrapolation: float = 1.0
    #: Errors of the predicted poses of boards, of held-out views without outliers; None without images or
    #: cross-validation
    board: BoardErrors | None = None
    #: The same of the views of validation rows; None without such images
    validation_board: BoardErrors | None = None
    #: Error over the joint limits that families of errors add whose sizes the rows do not determine [m]
    undetermined: float = 0.0
    #: The covariance of parameters that is due to these families; None without priors, and in files of earlier versions
    undetermined_families: Undetermined | None = None
    #: Scatter of the rows about the prediction; None in files of earlier versions
    scatter: RowScatter | None = None
    #: Frames and targets that were stated, and are known as well as the cell says; empty if it does not
    stated_places: tuple[StatedPlace, ...] = ()
    #: None without cross-validation, unless a usual mistake explains the rows far better, or a frame was not found
    verdict: Verdict | None = None

    def __post_init__(self) -> None:
        """Keep a read-only copy of the mapping."""
        keep_read_only(self, "prior_std")

    @classmethod
    def of(
        cls: type[AnyModel],
        fitted: Fitted,
        observability: Observability,
        cross_validation: CrossValidation | None,
        noise: Noise,
        **attributes: Any,  # noqa: ANN401  of the class
    ) -> AnyModel:
        """Describe a fit.

        Args:
            fitted: The fit of the geometry, or of a non-geometric model.
            observability: Which of its parameters the fitted rows determine.
            cross_validation: Its cross-validation; None if there was none.
            noise: The noise of the table.
            **attributes: Those of `NonGeometric` that a fit does not have.

        Returns:
            The model, without a verdict.
        """
        kinematics, x, rows = fitted.kinematics, fitted.estimate.x, fitted.estimate.problem.rows
        base_motion = None
        alone = hands_alone(rows.present, kinematics.robot)  # the pose of one in the other counts
        if not alone and not any(kind.tells_place for kind in rows.present):
            # The rigid motion nearest, by least squares, to what a unit of each parameter does at the measured poses.
            count = min(len(rows), _MOST_MEASURED)
            spread = np.linspace(0, len(rows) - 1, count).astype(int)
            poses, twists = twists_in_base(kinematics, x, rows.samples.select(spread))
            base_motion = read_only(best_motion(poses[:, :3, 3], twists[:, :3]))
        board = None
        if cross_validation is not None and np.any(rows.is_image):
            sightings = kinematics.sightings(x, rows.samples)
            kept = ~fitted.estimate.outliers
            board = board_errors(rows, sightings, cross_validation.residual, kept)
        scale = instrument_scale(thin(fitted)[0])
        model = cls(
            kinematics=kinematics,
            x=x,
            covariance=fitted.estimate.covariance,
            prior_std=fitted.estimate.prior_std,
            parameters=parameter_estimates(fitted, observability, scale),
            setup=fitted.estimated_setup(),
            base_motion=base_motion,
            cross_validation=cross_validation,
            expected_measured=np.nan,  # below: the model itself predicts
            expected_everywhere=np.nan,
            scale=scale,
            extrapolation=extrapolation(fitted),
            board=board,
            scatter=RowScatter.of(fitted, cross_validation, board, noise),
            stated_places=stated_places(fitted),
            **attributes,
        )

        robot, cell = fitted.task.robot, fitted.task.cell
        q, loads = spread_poses(robot), None
        if any(term.factor and term.factor.loaded for term in kinematics.model.terms):
            loads = gravity_loads(robot, q, cell.payload, cell.gravity)
        of_measured, scale_of_measured = model._expected_error(rows.samples)
        everywhere = Samples.at(q, loads, last_moves(q))
        of_everywhere, scale_everywhere = model._expected_error(everywhere)
        undetermined, families = undetermined_error(
            fitted, everywhere, base_moves=base_motion is not None
        )
        return replace(
            model,
            expected_measured=of_measured,
            expected_everywhere=of_everywhere,
            scale_measured=scale_of_measured,
            scale_everywhere=scale_everywhere,
            undetermined=undetermined,
            undetermined_families=families,
        )

    @property
    def change_by_scale(self) -> Array:
        """Change of the parameters by the scale error of the instrument, rms, shape (p,), in their units."""
        return np.zeros(len(self.x)) if self.scale is None else self.scale.change

    @property
    def noise_measured(self) -> float:
        """``expected_measured`` without the scale error of the instrument [m]."""
        return float(np.sqrt(max(self.expected_measured**2 - self.scale_measured**2, 0.0)))

    @property
    def model(self) -> ErrorModel:
        """The error model of ``kinematics``: the p parameters, the places where they act, and their directions."""
        return self.kinematics.model

    @property
    def expected_elsewhere(self) -> float:
        """Standard deviation of the predicted point over the joint limits, rms [m], with what the model lacks.

        The scale error of the instrument is not in it (``by_scale``). Errors that the model lacks do not average out
        over rows: what the covariance adds to the variance beyond the measured poses is larger (`added_variance`).
        """
        at_measured = self.noise_measured**2
        added = self.expected_everywhere**2 - self.scale_everywhere**2 - at_measured
        return float(np.sqrt(at_measured + self.added_variance(added)))

    def added_variance(self, by_covariance: float) -> float:
        """Return what is added to the variance at the measured poses beyond them, with what the model lacks [m^2].

        The variance v that the covariance adds is f v by rows that were extrapolated (``extrapolation``), and v + u^2
        by errors that the rows do not determine (``undetermined``). Both estimate what is lacking; the larger counts.

        Args:
            by_covariance: v [m^2]; if it is negative, f is 1.
        """
        factor = self.extrapolation if by_covariance > 0.0 else 1.0
        return max(factor * by_covariance, by_covariance + self.undetermined**2)

    @property
    def by_scale(self) -> tuple[float, float]:
        """Errors at a new point, rms [m], by the largest scale error that the instrument may have (`Scale.bound`).

        As in ``new_point`` they are those at poses like those measured, and over the joint limits.
        """
        if self.scale is None or self.scale.size == 0.0:
            return 0.0, 0.0
        factor = self.scale.bound / self.scale.size
        return factor * self.scale_measured, factor * self.scale_everywhere

    @property
    def new_point(self) -> tuple[float, float]:
        """Expected error at a new point, rms [m]: at poses like those measured, and over the joint limits.

        The first is the rms error of held-out rows of ``cross_validation``, outliers aside, which includes what the
        model lacks; it is no less than ``noise_measured``, as an error that all rows share, that of a print's size,
        does not show in them. Of images it is what held-out views show of the board's position in three dimensions,
        beyond their own noise (`BoardErrors.predicted`): residuals in pixels hardly show depth. It is no less than what
        images of validation rows show likewise: those of another day show what changes from day to day. For the second
        the variance of the prediction at the measured poses, the square of ``noise_measured``, is exchanged for that
        over the limits, the square of ``expected_elsewhere``. Without cross-validation, or if no length was measured,
        these two are taken. To either is added what a scale error of the instrument does (``by_scale``).
        """
        near, elsewhere = self.noise_measured, self.expected_elsewhere
        validation = self.cross_validation
        held_out = None if self.board is None else self.board.predicted
        if validation is not None and validation.errors_without_outliers["m"].n:
            held_out = validation.errors_without_outliers["m"].rms
        if held_out is not None and self.validation_board is not None:
            held_out = max(held_out, self.validation_board.predicted)
        if held_out is not None:
            elsewhere = float(np.sqrt(max(held_out**2 - near**2, 0.0) + elsewhere**2))
            near = max(held_out, near)
        by_scale = self.by_scale
        return float(np.hypot(near, by_scale[0])), float(np.hypot(elsewhere, by_scale[1]))

    def twists(self, samples: Samples, *, in_base: bool = False) -> tuple[Array, Array]:
        """Return predicted poses of the target, and their derivatives by the parameters.

        Args:
            samples: N joint values, with the frame, the target and the loads of each.
            in_base: True to predict in the base, without ``base_motion`` if there is one; False to predict in each
                sample's own measurement frame.

        Returns:
            The poses, shape (N, 4, 4) [m], and the target's velocity in a unit of each parameter, shape (N, 6, p),
            linear part first [m, rad].
        """
        if not in_base:
            return self.kinematics.twists(self.x, samples)
        poses, twists = twists_in_base(self.kinematics, self.x, samples)
        if self.base_motion is not None:
            twists[:, :3] -= displacements_by(self.base_motion, poses[:, :3, 3])
            twists[:, 3:] -= self.base_motion[3:]
        return poses, twists

    def pose_std(self, samples: Samples, *, in_base: bool = False) -> Array:
        """Return standard deviations of predicted poses of the target, sqrt(trace(J C J^T) + |J g|^2).

        C is the covariance of the parameters, g their ``change_by_scale``, J the derivative of the position, or of the
        orientation, by them. Errors that the model lacks are not included.

        Args:
            samples: N joint values, with the frame, the target and the loads of each.
            in_base: True to predict in the base, without ``base_motion`` if there is one; False to predict in each
                sample's own measurement frame.

        Returns:
            Of the position [m] and of the orientation [rad], shape (N, 2), read-only: the root of the sum of the
            variances along three axes.
        """
        _, twists = self.twists(samples, in_base=in_base)
        # Twists are of the shape (N, 6, p), linear [m] then angular [rad] a unit of each parameter.
        JC = (twists.reshape(-1, len(self.x)) @ self.covariance).reshape(twists.shape)
        variance_by_axis = np.sum(JC * twists, axis=2) + (twists @ self.change_by_scale) ** 2
        variance = variance_by_axis.reshape(-1, 2, 3).sum(axis=2)
        return read_only(np.sqrt(np.maximum(variance, 0.0)))

    def _expected_error(self, samples: Samples) -> tuple[float, float]:
        """Return the standard deviation of predicted positions, rms over the first samples, and the scale's part [m].

        They are predicted in the base if the model has a ``base_motion``, else in each sample's measurement frame. Of
        the growth of the arm, an estimated frame takes off the rigid motion, which does not displace the robot.
        """
        first = samples.select(slice(0, _MOST_EXPECTED))
        in_base = self.base_motion is not None
        exact = rms(replace(self, scale=None).pose_std(first, in_base=in_base)[:, 0])
        poses, twists = twists_in_base(self.kinematics, self.x, first)
        grown = twists[:, :3] @ self.change_by_scale[:, None]
        if in_base or any(self.setup.unknown):
            grown = without_rigid_motion(poses[:, :3, 3], grown)
        by_scale = rms(np.linalg.norm(grown, axis=(1, 2)))
        return float(np.hypot(exact, by_scale)), by_scale

    def tips(self, samples: Samples) -> Array:
        """Return T_base_tip, the pose of the tip in the base, the joints' own errors included.

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

    #: Shape (N, D), measured minus predicted at all rows of the table, in the units of the rows' channels
    residual: Array
    #: Carried by the tip; None if none was stated
    payload: Payload | None
    #: Shape (3,), in the URDF's root frame [m/s^2]
    gravity: Array

    @property
    def name(self) -> str:
        """Name of the model: its geometry and families of non-geometric errors, such as ``"dh+compliance"``."""
        return self.model.name

    def load(self, nominal: Robot, q: Array, payload: Payload | None = None) -> Array:
        """Return the load of gravity on the joints, with the ``gravity`` of the calibration, see `gravity_loads`.

        Args:
            nominal: The nominal robot, n joints in its chain.
            q: Joint values, shape (N, m), [rad] or [m], in the order of the robot's ``joint_names``.
            payload: Point mass that the tip carries; None: that of the measurements, the field ``payload``.

        Returns:
            shape (N, n, n + 3). Of each joint first its load, [Nm], or [N] if it slides; then the lever arms about
            it, [m], or 1 if it slides, of masses at the origins of the n joints, at the tip and at the base.
            Positive if gravity drives the joint towards larger values.
        """
        return gravity_loads(nominal, q, payload or self.payload, self.gravity)


def parameter_estimates(
    fitted: Fitted, observability: Observability, scale: Scale | None = None
) -> tuple[ParameterEstimate, ...]:
    """Return nominal value, value, interval and prior of each parameter of a fit.

    Of a parameter of the robot the nominal value is that of the DH table, or 0; of a measurement frame, and of a
    target's orientation, it is 0, and value and change are the offset from the registered start. Of a target's position
    it is None if the target was not given; the change is then that from the registered start.

    Args:
        fitted: A fit with p parameters.
        observability: Which of them the fitted rows determine, not in combinations only.
        scale: The scale error of the instrument, which widens the intervals; None: there is none.

    Returns:
        One entry for each parameter, in the order of the parameter vector x and in the parameter's unit. The interval
        holds the true value with 95 %; it and ``std`` are NaN at a bound.
    """
    estimate, model = fitted.estimate, fitted.kinematics.model
    std = np.sqrt(np.diag(estimate.covariance))
    if scale is not None:
        std = np.hypot(std, scale.change)
    std[list(estimate.at_bound)] = np.nan
    half_width = interval_factor(estimate.freedom) * std
    precision = estimate.problem.prior_precision
    prior_std = 1.0 / np.sqrt(np.where(precision > 0.0, precision, np.nan))
    data_gradient = _data_gradient(fitted)
    setup = fitted.estimated_setup()

    result = []
    for k, parameter in enumerate(model.parameters):
        nominal: float | None = parameter.nominal
        delta = estimate.x[k]
        value = parameter.nominal + delta
        if parameter.family == TARGET and parameter.unit == "m":
            nominal, value = _target_position(fitted, setup, k)
            delta = delta if nominal is None else value - nominal
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


def _target_position(fitted: Fitted, setup: Setup, k: int) -> tuple[float | None, float]:
    """Return the coordinate of a target along the tip's axis nearest to parameter k: as given, None if not; as fitted.

    Both are in the tip [m], whatever the axes of the parameter.
    """
    model, given = fitted.kinematics.model, fitted.task.setup
    parameter = model.parameters[k]
    target = model.places.index(parameter.place) - len(model.places) + len(given.targets)
    R_tip_target = fitted.kinematics.T_tip_target[target, :3, :3]
    axis = int(np.argmax(np.abs(R_tip_target @ parameter.direction[:3])))
    value = setup.T_tip_target[target, axis, 3]
    if not given.target_given[target]:
        return None, value
    return float(given.T_tip_target[target, axis, 3]), value


def _data_gradient(fitted: Fitted) -> Array:
    """Return minus the derivative of half the data's weighted squares by each parameter, shape (p,), [1/unit].

    At the least of squares with priors it equals their pull, precision (x - mean), which is returned by the formula if
    the solver has no weights and priors.
    """
    x, problem = fitted.estimate.x, fitted.estimate.problem
    if not fitted.task.has_weights_and_priors:  # not at the least of squares, and without priors
        return np.asarray(problem.prior_precision * (x - problem.prior_mean))
    without_priors = replace(problem, prior_precision=np.zeros(len(x)))
    # Measured minus predicted in standard deviations, (m,), and its derivative by the parameters, (m, p).
    residual, jacobian = without_priors.system(x)
    return -residual @ jacobian


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
