"""What a fit says of its parameters, and its covariance of a pose.

A predicted pose's standard deviations are those of J dx, sqrt(trace(J C J^T)), with the parameters' covariance C and
the derivative J of the predicted pose. Sockets, planes, anchors and pairs tell neither where the base stands nor how it
is turned: what moves all poses as one body is then known by the priors alone, whatever these may be. So predictions in
the base leave it out there: the rigid motion of the base that makes up best for what a parameter does at the measured
poses is taken off J, wherever else it is asked.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

import calib.data.kinds as registry
from calib.diagnosis.reasons import Verdict
from calib.estimate.fitting import Fitted
from calib.model.kinematics import Kinematics, Samples
from calib.model.observability import Observability
from calib.model.parameters import FRAME, TARGET, ErrorModel
from calib.numerics.errors import CrossValidation, rms
from calib.numerics.intervals import interval_factor
from calib.registration.setup import Setup
from calib.robot.gravity import gravity_loads
from calib.robot.payload import Payload
from calib.robot.robot import Robot, read_only
from calib.units import Array

#: Points that lie nearer to a line than this tell nothing of a turn about it [m].
_SHORT_LEVER = 1e-2

#: Poses over which expected errors are averaged, and that say what a motion of the base makes up for: more change none.
_MOST_EXPECTED, _ENOUGH = 1000, 20_000


@dataclass(frozen=True, slots=True)
class ParameterEstimate:
    """One parameter of the result, in its unit."""

    name: str  #: Its name; its unit is ``"m"``, ``"rad"``, ``"1"``, ``"m/m"``, ``"rad/Nm"`` or ``"m/N"``
    unit: str
    nominal: float | None  #: The value before; None for a target that was not given
    value: float  #: The value after, with its standard deviation ``std`` and its 95 % interval from ``low`` to ``high``
    delta: float  #: The change; for a target that was not given, from where registration put it
    std: float
    low: float
    high: float
    identifiable: bool  #: Whether the measurements determine it, not in combinations only
    at_bound: bool = False  #: Whether a bound stopped it; std and interval are then NaN
    prior_std: float = np.nan  #: Of the prior that the fit ended with; NaN where there was none
    #: How hard the data push it against its prior [1/unit]: minus the derivative of half their squares. At the least of
    #: all squares that is the prior's pull, (x - mean) / std^2. Where a prior is next to nothing wide, x is too, and
    #: only this still tells what the data say
    data_gradient: float = np.nan


@dataclass(frozen=True, slots=True)
class Outlier:
    """A row that does not belong to the others."""

    row: int  #: Its number in the table
    residual: float  #: Norm of measured minus predicted length [m]; NaN where none was measured
    score: float  #: How far it lies from what the others predict, in standard deviations


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Solved:
    """What was found of one error model."""

    kinematics: Kinematics  #: The nominal robot, with frames and targets where ``x`` counts from
    x: Array  #: shape (p,), offsets from the registered start [m, rad]
    covariance: Array  #: shape (p, p), of ``x``
    prior_std: Mapping[
        str, float
    ]  #: Size of each family's errors, in its unit; empty without priors
    parameters: tuple[ParameterEstimate, ...]  #: One entry for each element of ``x``
    setup: Setup  #: Frames and targets as estimated or given
    #: shape (6, p), the motion of the base, linear part first, that makes up best for a unit of each parameter over the
    #: measured poses; None where the rows tell where the base stands
    base_motion: Array | None
    cross_validation: CrossValidation | None  #: On held-out fitted rows; None without
    #: Standard deviation of the predicted point at the measured poses, rms [m]. From the covariance, so it knows
    #: nothing of errors that the model lacks
    expected_measured: float
    expected_everywhere: float  #: The same over joint values spread over the limits [m]
    #: How many times as large as by the covariance the squared errors are where it is extrapolated; 1 or more
    extrapolation: float = 1.0

    @property
    def expected_elsewhere(self) -> float:
        """Standard deviation of the predicted point over the joint limits, rms [m], what the model lacks counted too.

        Errors that the model lacks do not average out over rows: beyond the measured poses the variance that the
        covariance adds is ``extrapolation`` times as large.
        """
        here, everywhere = self.expected_measured**2, self.expected_everywhere**2
        beyond = everywhere - here
        return float(np.sqrt(here + beyond * (self.extrapolation if beyond > 0.0 else 1.0)))

    @property
    def new_point(self) -> tuple[float, float]:
        """The error to expect of a new point, rms [m]: at poses like those measured, and over the joint limits.

        The first is that of held-out rows, outliers aside, and knows what the model lacks; to get the second the
        variances of the prediction change. By the covariance alone without cross-validation, or without lengths.
        """
        here, everywhere = self.expected_measured, self.expected_elsewhere
        held_out = self.cross_validation and self.cross_validation.errors_without_outliers
        if not held_out or not held_out.n:
            return here, everywhere
        return held_out.rms, float(np.sqrt(max(held_out.rms**2 - here**2, 0.0) + everywhere**2))

    @property
    def model(self) -> ErrorModel:
        """Its error model."""
        return self.kinematics.model

    def pose_std(self, samples: Samples, *, in_base: bool = False) -> Array:
        """Standard deviations of predicted poses, sqrt(trace(J C J^T)), shape (N, 2): position [m] and angle [rad].

        In the base they are less ``base_motion``; else they are in each sample's own frame.
        """
        if in_base:
            poses, twists = twists_in_base(self.kinematics, self.x, samples)
            if self.base_motion is not None:
                twists[:, :3] -= moved_by(self.base_motion, poses[:, :3, 3])
                twists[:, 3:] -= self.base_motion[3:]
        else:
            twists = self.kinematics.twists(self.x, samples)[1]
        wide = (twists.reshape(-1, len(self.x)) @ self.covariance).reshape(twists.shape)
        variance = np.sum(wide * twists, axis=2).reshape(-1, 2, 3).sum(axis=2)
        return read_only(np.sqrt(np.maximum(variance, 0.0)))

    def expected_error(self, samples: Samples) -> float:
        """Standard deviation of the predicted position over some samples, rms [m]; in the base as `pose_std`."""
        some = samples.select(slice(0, _MOST_EXPECTED))
        return rms(self.pose_std(some, in_base=self.base_motion is not None)[:, 0])

    def tips(self, samples: Samples) -> Array:
        """T_base_tip by the parameters, the joints' own errors included, shape (N, 4, 4), [m]."""
        T = self.kinematics.poses(self.x, samples)
        into_base = np.linalg.inv(self.setup.T_frame_base)[samples.frame]
        return np.asarray(into_base @ T @ np.linalg.inv(self.setup.T_tip_target)[samples.target])


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class NonGeometric(Solved):
    """A model with errors of the joints' state, which no URDF can hold."""

    residual: Array  #: shape (N, D), measured minus predicted, all rows [m], [rad]
    payload: Payload | None  #: What the tip carried; None where nothing was said
    gravity: Array  #: shape (3,), in the URDF's root frame [m/s^2]
    verdict: Verdict | None = None  #: None without cross-validation

    @property
    def name(self) -> str:
        """Its set and families, such as ``"dh+compliance"``."""
        return self.model.name

    def load(self, nominal: Robot, q: Array, payload: Payload | None = None) -> Array:
        """The load of gravity on the joints at q, shape (N, m); see `gravity_loads`; payload None: its own."""
        return gravity_loads(nominal, q, payload or self.payload, self.gravity)


def parameter_estimates(
    fitted: Fitted, observability: Observability
) -> tuple[ParameterEstimate, ...]:
    """Nominal value, value and interval of each parameter; the observability is that of the rows that were fitted."""
    estimate, given, model = fitted.estimate, fitted.task.setup, fitted.kinematics.model
    at_bound = np.isin(np.arange(len(model)), list(estimate.at_bound))
    std = np.where(at_bound, np.nan, np.sqrt(np.diag(estimate.covariance)))
    half = interval_factor(estimate.freedom) * std
    precision, data_gradient, placed = (
        estimate.problem.precision,
        _data_gradients(fitted),
        fitted.placed(),
    )
    prior_std = 1.0 / np.sqrt(np.where(precision > 0.0, precision, np.nan))
    result = []
    for k, (parameter, delta) in enumerate(zip(model.parameters, estimate.x, strict=True)):
        nominal: float | None = parameter.nominal
        value = parameter.nominal + delta
        if parameter.family == TARGET and parameter.unit == "m":
            t = model.places.index(parameter.place) - len(model.places) + len(given.targets)
            start = fitted.kinematics.T_tip_target[t, :3, :3]
            axis = int(np.argmax(np.abs(start @ parameter.direction[:3])))  # of the tip
            value = placed.T_tip_target[t, axis, 3]
            known = bool(given.target_given[t])
            nominal = float(given.T_tip_target[t, axis, 3]) if known else None
            delta = delta if nominal is None else value - nominal
        result.append(
            ParameterEstimate(
                name=parameter.name,
                unit=parameter.unit,
                nominal=nominal,
                value=float(value),
                delta=float(delta),
                std=float(std[k]),
                low=float(value - half[k]),
                high=float(value + half[k]),
                identifiable=bool(observability.identifiable[k]),
                at_bound=bool(at_bound[k]),
                prior_std=float(prior_std[k]),
                data_gradient=float(data_gradient[k]),
            )
        )
    return tuple(result)


def _data_gradients(fitted: Fitted) -> Array:
    """The data's gradient of each parameter against its prior, shape (p,); see `ParameterEstimate`."""
    x, problem = fitted.estimate.x, fitted.estimate.problem
    if fitted.task.solver == "paper":  # not at the least of squares, and without priors
        return np.asarray(problem.precision * (x - problem.centre))
    residual, derivative = replace(problem, precision=np.zeros(len(x))).system(x)
    return -residual @ derivative


def base_motion(kinematics: Kinematics, x: Array, samples: Samples) -> Array:
    """The motion of the base that makes up best for a unit of each parameter x (p,) over some poses, shape (6, p)."""
    some = samples.select(np.linspace(0, len(samples) - 1, min(len(samples), _ENOUGH)).astype(int))
    poses, twists = twists_in_base(kinematics, x, some)
    return read_only(best_motion(poses[:, :3, 3], twists[:, :3]))


def twists_in_base(kinematics: Kinematics, x: Array, samples: Samples) -> tuple[Array, Array]:
    """Poses of the target in the base, and their derivative: `Kinematics.twists` of a frame that is the base itself.

    Args:
        kinematics: The robot under its error model.
        x: shape (p,), its parameters.
        samples: N samples; their frames do not count.

    Returns:
        T_base_target, shape (N, 4, 4) [m], and the target's velocity in a unit of each parameter along the base's
        axes, shape (N, 6, p), linear part first [m, rad]; zero for the parameters of frames.
    """
    of_frame = kinematics.model.family(FRAME)
    frames = np.broadcast_to(np.eye(4), kinematics.T_frame_base.shape)
    in_base = replace(kinematics, T_frame_base=frames)
    poses, twists = in_base.twists(np.where(of_frame, 0.0, x), samples)
    return poses, np.where(of_frame, 0.0, twists)


def tells_place(kinds: Iterable[str]) -> bool:
    """Whether rows of these kinds tell where the base stands; otherwise predictions are in the base."""
    return any(registry.get(kind).position for kind in kinds)


def without_rigid_motion(
    points: Array, moves: Array, seen: tuple[Array, Array] | None = None
) -> Array:
    """Moves (N, 3, k) of points (N, 3), less the rigid motion that best explains them, or the same of ``seen`` ones."""
    motion = best_motion(*((points, moves) if seen is None else seen))
    return np.asarray(moves - moved_by(motion, points))


def best_motion(points: Array, moves: Array) -> Array:
    """The rigid motions (6, k), of the origin and turns, that best make up for moves (N, 3, k) of points (N, 3)."""
    middle = points.mean(axis=0)
    columns = np.zeros((len(points), 3, 6))
    columns[:, :, :3] = np.eye(3)
    columns[:, :, 3:] = np.cross(np.eye(3), (points - middle)[:, None, :]).transpose(0, 2, 1)
    flat = moves.reshape(-1, moves.shape[2])
    # Two sockets tell nothing of a turn about the line through them: the shortest solution has none.
    motion = np.linalg.lstsq(columns.reshape(-1, 6), flat, rcond=_SHORT_LEVER)[0]
    motion[:3] -= np.cross(motion[3:], middle, axisa=0).T
    return np.asarray(motion)


def moved_by(motion: Array, points: Array) -> Array:
    """What rigid motions (6, k) do to points (N, 3), shape (N, 3, k)."""
    return np.asarray(motion[:3] + np.cross(motion[3:].T, points[:, None]).transpose(0, 2, 1))
