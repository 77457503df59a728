"""Uncertainty of the pose that a calibrated robot reaches, at each of some joint values, by its sources.

The measurand is where the target truly is when the robot has arrived once at the given joint readings q, minus where
the model predicts it, in the measurement frame or in the base. Its error is the sum of independent parts, each with a
covariance of the six displacements [m, rad] along and about the axes of the frame in which the pose is predicted:

    V(q) = sum over sources of V_s(q)

With the derivatives J of the pose by the parameters, their covariance C, and J_q by the joint readings the parts are

    instrument     J (C_r - C_r P C_r) J^T     noise of the rows, through the fit; C_r: frame and target known
    undetermined   J C_r P C_r J^T + ...       what the rows leave to the priors, of precision P, and families of errors
                                               whose sizes the rows do not tell
    target         J (C_f - C_r) J^T           what knowing the target would take off; C_f: frame known
    frame          J (C - C_f) J^T             what knowing the frame would take off
    scale          J g g^T J^T s^2             lengths of the instrument that are off by the share s; g: what the
                                               parameters change by if all lengths grow by 1
    repeatability  r^2 I                       scatter of arrivals at one pose
    model          m^2 I + (f - 1) (...)       what the model lacks, at the measured poses and beyond them
    lost_motion    J_q J_q^T b^2 / 3           as stated
    resolution     J_q J_q^T d^2 / 12          steps of the readings, as stated
    drift          t^2 I                       between series, as stated
    temperature    a^2 E[(T - T_0)^2] p p^T    growth of the arm, p from base to target, as stated

Scatter of the fitted rows about the prediction (`calib.result.row_scatter`) is what r^2 and m^2 are taken from. The
noise of the instrument is in it, and is no error of the robot: what is stated of it is taken off (`variance_beyond`),
and so are the parts that are stated above. If nothing is stated, and repeats tell nothing, all of it counts as the
robot's, and `PoseUncertainty.separated` is False.

Beyond the measured poses errors that the model lacks do not average out: what the covariance adds there to the variance
is multiplied by `FittedModel.extrapolation`, or increased by `FittedModel.undetermined`, whichever is more.

Its expanded uncertainty is the length that the error of the position, or the angle that the error of the orientation,
stays below with the probability that k = 2 stands for (`calib.uncertainty.coverage`). A part u_s^2 that was estimated
with nu_s degrees of freedom is Student's t, of variance u_s^2 nu_s / (nu_s - 2). Their sum is like the t of the same
variance and kurtosis,

    nu = 4 + (sum_s w_s)^2 / sum_s [w_s^2 / (nu_s - 4)],        w_s = u_s^2 nu_s / (nu_s - 2)

which for large nu_s is Welch and Satterthwaite's (JCGM 100, G.4), and for one part is exact.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from calib.basics.arrays import Array, read_only
from calib.basics.values import Value
from calib.model.error_model import FRAME, TARGET
from calib.model.kinematics import Samples
from calib.result.calibration import Calibration
from calib.result.fitted_model import FittedModel
from calib.result.row_scatter import joint_twists
from calib.result.stated_places import StatedPlace, displaced
from calib.uncertainty.beyond import variance_beyond
from calib.uncertainty.coverage import covered_length

#: Fewer degrees of freedom count as so many: Student's t has a variance from 3 on, which is not large from 5 on.
_LEAST_FREEDOM = 5.0

#: Directions of a pose: three of the position, three of the orientation.
_POSITION, _ORIENTATION = slice(0, 3), slice(3, 6)


class Source(Enum):
    """A source of uncertainty, a line of the budget."""

    INSTRUMENT = "instrument"
    SCALE = "scale"
    FRAME = "frame"
    TARGET = "target"
    REPEATABILITY = "repeatability"
    LOST_MOTION = "lost_motion"
    DRIFT = "drift"
    MODEL = "model"
    UNDETERMINED = "undetermined"
    RESOLUTION = "resolution"
    TEMPERATURE = "temperature"


#: Sources that more rows of the same kind reduce, in proportion to their number: the noise of the rows is their cause.
BY_ROWS = (Source.INSTRUMENT, Source.TARGET, Source.FRAME)


class Distribution(Enum):
    """The distribution of a part of the error."""

    NORMAL = "normal"
    STUDENT = "t"
    UNIFORM = "uniform"


@dataclass(frozen=True, slots=True, eq=False)
class Contribution(Value):
    """Share of one source in the uncertainty at each of N poses."""

    source: Source
    #: Shape (N, 6, 6), covariance of displacement [m] and rotation [rad]
    covariance: Array
    distribution: Distribution
    #: Degrees of freedom of its standard uncertainty; infinite if it is known
    freedom: float


@dataclass(frozen=True, slots=True, eq=False)
class PoseUncertainty(Value):
    """Uncertainty of N predicted poses, and of what it is made."""

    #: Shape (N, 4, 4), the predicted poses [m]
    poses: Array
    #: The parts, independent of each other, one a source
    contributions: tuple[Contribution, ...]
    #: False if nothing separates the instrument's noise from the robot's errors: all of it counts as the robot's
    separated: bool = True

    @property
    def covariance(self) -> Array:
        """Sum of the parts, shape (N, 6, 6) [m, rad]."""
        none = np.zeros((len(self.poses), 6, 6))
        return np.asarray(sum((part.covariance for part in self.contributions), none))

    @property
    def position_std(self) -> Array:
        """Combined standard uncertainty of the position, the root of the sum over three axes, shape (N,) [m]."""
        return _std(self.covariance, _POSITION)

    @property
    def orientation_std(self) -> Array:
        """Combined standard uncertainty of the orientation, shape (N,) [rad]."""
        return _std(self.covariance, _ORIENTATION)

    @property
    def position_freedom(self) -> Array:
        """Effective degrees of freedom of the position, shape (N,)."""
        return self._freedom(_POSITION)

    @property
    def orientation_freedom(self) -> Array:
        """Effective degrees of freedom of the orientation, shape (N,)."""
        return self._freedom(_ORIENTATION)

    @property
    def position(self) -> Array:
        """Expanded uncertainty of the position: the distance that its error stays below, shape (N,) [m]."""
        return self._expanded(_POSITION)

    @property
    def orientation(self) -> Array:
        """Expanded uncertainty of the orientation: the angle that its error stays below, shape (N,) [rad]."""
        return self._expanded(_ORIENTATION)

    def without(self, *sources: Source, share: float = 0.0) -> PoseUncertainty:
        """Return the uncertainty if the variance of some sources were a share of what it is.

        Args:
            *sources: The sources.
            share: Between 0 (they are removed) and 1; of four times as many rows a quarter of the instrument's.
        """
        parts = []
        for part in self.contributions:
            if part.source in sources and share > 0.0:
                parts.append(replace(part, covariance=read_only(share * part.covariance)))
            elif part.source not in sources:
                parts.append(part)
        return replace(self, contributions=tuple(parts))

    def _expanded(self, part: slice) -> Array:
        """Return the length that errors of the position, or of the orientation, stay below, (N,)."""
        freedom, factor = self._moments(part)
        return covered_length(factor[:, None, None] * self.covariance[:, part, part], freedom)

    def _freedom(self, part: slice) -> Array:
        """Return the effective degrees of freedom of positions or orientations, (N,)."""
        return self._moments(part)[0]

    def _moments(self, part: slice) -> tuple[Array, Array]:
        """Return the degrees of freedom of the t distribution that the sum of the parts is like, and its scale, (N,).

        It is the factor of the covariance with which variance and kurtosis are those of the sum. The parts that the
        noise of the rows makes through the fit are of one estimate of this noise: they err alike.
        """
        N = len(self.poses)
        of_rows, plain, variance, quartic = (np.zeros(N) for _ in range(4))
        noise_freedom = np.inf
        for one in self.contributions:
            square = _std(one.covariance, part) ** 2
            plain = plain + square
            if one.source in BY_ROWS:
                of_rows = of_rows + square
                noise_freedom = min(noise_freedom, one.freedom)
                continue
            spread, fourth = _t_moments(one.freedom)
            variance = variance + spread * square
            quartic = quartic + fourth * square**2
        spread, fourth = _t_moments(noise_freedom)
        variance, quartic = variance + spread * of_rows, quartic + fourth * of_rows**2
        with np.errstate(divide="ignore", invalid="ignore"):
            freedom = np.where(quartic > 0.0, 4.0 + variance**2 / quartic, np.inf)
            narrower = np.where(np.isfinite(freedom), (freedom - 2.0) / freedom, 1.0)
            factor = np.where(plain > 0.0, variance * narrower / plain, 1.0)
        return read_only(freedom), factor


def _t_moments(freedom: float) -> tuple[float, float]:
    """Return the variance of Student's t, and a sixth of its fourth cumulant; 1 and 0 without limit."""
    if not np.isfinite(freedom):
        return 1.0, 0.0
    nu = max(freedom, _LEAST_FREEDOM)
    return nu / (nu - 2.0), (nu / (nu - 2.0)) ** 2 / (nu - 4.0)


def _std(covariance: Array, part: slice) -> Array:
    """Return the root of the trace of each covariance's block of positions or of orientations."""
    return np.asarray(np.sqrt(np.trace(covariance[:, part, part], axis1=1, axis2=2)))


def uncertainty_at(
    result: Calibration, samples: Samples, *, non_geometric: bool = True, in_base: bool = False
) -> PoseUncertainty:
    """Return the uncertainty of the poses that a result predicts.

    Args:
        result: The calibration, made here or read from its file.
        samples: N joint values, with the frame, the target, the loads and the last moves of each.
        non_geometric: Whether the non-geometric model predicts, if there is one; else the geometry.
        in_base: Whether the poses are those in the base; else in each sample's measurement frame.

    Returns:
        The uncertainty of each pose.
    """
    model = result.part(non_geometric=non_geometric)
    poses, twists = model.twists(samples, in_base=in_base)
    arrivals = arrivals_of(result, model)
    parts = (
        *_of_parameters(result, model, samples, twists, in_base=in_base),
        *(
            _part(source, left @ left.transpose(0, 2, 1), Distribution.NORMAL, np.inf)
            for source, left in by_stated_places(
                result, model, samples, poses, twists, in_base=in_base
            )
        ),
        *_of_arrivals(arrivals, len(poses)),
        *_of_joints(result, model, samples, in_base=in_base),
        *_of_temperature(result, model, samples, poses, twists, in_base=in_base),
    )
    shown = [part for part in _by_source(parts) if np.any(part.covariance)]
    return PoseUncertainty(read_only(poses), tuple(shown), arrivals.separated)


# What the fit determined


def parameter_covariances(model: FittedModel) -> dict[Source, Array]:
    """Split the covariance of the parameters of a model into parts that add up to it.

    Args:
        model: The fitted model, of p parameters.

    Returns:
        Positive semidefinite parts, shape (p, p), of the instrument, the priors (`Source.UNDETERMINED`), the target and
        the frame; the module's text has the equations.
    """
    C = model.covariance
    parts = {}
    for source, family in ((Source.FRAME, FRAME), (Source.TARGET, TARGET)):
        own = model.model.family(family)
        across = C[:, own]
        known = across @ np.linalg.pinv(C[np.ix_(own, own)], hermitian=True) @ across.T
        parts[source] = known
        C = C - known
    prior_std = np.array([parameter.prior_std for parameter in model.parameters])
    precision = np.where(model.model.of_robot & (prior_std > 0.0), prior_std, np.inf) ** -2.0
    root = C * np.sqrt(precision)
    parts[Source.UNDETERMINED] = root @ root.T
    parts[Source.INSTRUMENT] = C - parts[Source.UNDETERMINED]
    return parts


def _of_parameters(
    result: Calibration, model: FittedModel, samples: Samples, twists: Array, *, in_base: bool
) -> Iterator[Contribution]:
    """Yield the parts that the parameters' uncertainty is of at derivatives of poses, (N, 6, p)."""
    freedom = result.noise.freedom
    total = np.zeros((len(twists), 6, 6))
    for source, C in parameter_covariances(model).items():
        covariance = _symmetric(twists @ C @ twists.transpose(0, 2, 1))
        total = total + covariance
        if source is Source.UNDETERMINED:
            yield _part(source, covariance, Distribution.NORMAL, np.inf)
        else:
            yield _part(source, covariance, Distribution.STUDENT, freedom)

    size = scale_std(model)
    if size > 0.0 and model.scale is not None:
        grown = (twists @ model.scale.growth)[:, :, None] * size
        yield _part(Source.SCALE, grown @ grown.transpose(0, 2, 1), Distribution.NORMAL, np.inf)

    share, factor = beyond_measured(result, model, samples, twists, total, in_base=in_base)
    yield _part(Source.MODEL, share[:, None, None] * total, Distribution.NORMAL, np.inf)
    by_families = factor @ factor.transpose(0, 2, 1)
    yield _part(Source.UNDETERMINED, by_families, Distribution.NORMAL, np.inf)


def beyond_measured(
    result: Calibration,
    model: FittedModel,
    samples: Samples,
    twists: Array,
    total: Array,
    *,
    in_base: bool,
) -> tuple[Array, Array]:
    """Return what is lacking in the covariance of predictions beyond the measured poses, of two estimates the larger.

    Args:
        result: The calibration.
        model: Its model that predicts, of p parameters.
        samples: N samples.
        twists: Derivatives of their poses by the parameters, (N, 6, p).
        total: Their covariances by those of the parameters, (N, 6, 6).
        in_base: Whether the poses are those in the base.

    Returns:
        The share of the covariance that is to be added, (N,), 0 where the other is larger; and the derivatives of the
        poses by normal numbers of variance 1, (N, 6, r), by families of errors whose sizes the rows do not tell. The
        share is told by rows at the ends of the ranges of a few joints, and enlarged for that.
    """
    enlarged = _by_few(float(len(result.nominal.inputs)))
    variance = _std(total, _POSITION) ** 2
    by_model = (model.extrapolation - 1.0) * np.maximum(variance - model.noise_measured**2, 0.0)
    families = model.undetermined_families
    factor = np.zeros((len(twists), 6, 0))
    if families is not None:
        further = families.twists(result.nominal, model.setup, samples, in_base=in_base)
        factor = np.concatenate([twists, further], axis=2) @ families.factor
    by_families = np.sum(factor[:, :3] ** 2, axis=(1, 2))
    of_model = by_model > by_families
    share = enlarged * np.where(of_model, by_model, 0.0) / np.where(of_model, variance, 1.0)
    return share, np.where(of_model[:, None, None], 0.0, factor)


def scale_std(model: FittedModel) -> float:
    """Return the standard uncertainty of the instrument's scale, by its prior and the rows: a share, 0 without."""
    scale = model.scale
    if scale is None or scale.size == 0.0:
        return 0.0
    return float(np.sqrt(scale.mean**2 + scale.variance * _by_few(scale.freedom_of_size)))


def _by_few(freedom: float) -> float:
    """Return the variance of Student's t, which an error has whose variance was estimated with few degrees of freedom.

    Such an error counts as normal with this variance (JCGM 101, 6.4.9): Welch and Satterthwaite's formula fails for it.
    """
    return _t_moments(freedom)[0]


def by_stated_places(
    result: Calibration,
    model: FittedModel,
    samples: Samples,
    poses: Array,
    twists: Array,
    *,
    in_base: bool,
) -> Iterator[tuple[Source, Array]]:
    """Yield what stated frames and targets, which are known as well as the cell says, do to predicted poses.

    Args:
        result: The calibration.
        model: Its model that predicts, of p parameters.
        samples: N samples.
        poses: Their predicted poses, (N, 4, 4) [m].
        twists: The derivatives of these by the parameters, (N, 6, p).
        in_base: Whether the poses are those in the base.

    Yields:
        Frame or target, and the derivatives of the poses by normal numbers of variance 1, shape (N, 6, 6).
    """
    origins = np.zeros((len(poses), 3))
    if not in_base:
        origins = model.setup.T_frame_base[samples.frame][:, :3, 3]
    for place in model.stated_places:
        numbers = samples.frame if place.is_frame else samples.target
        by_place = displaced(poses, origins, is_frame=place.is_frame)
        # In the base a frame is nowhere; other frames and targets see the fit's error alone.
        by_place[(numbers != place.index) | (place.is_frame and in_base)] = 0.0
        left = (by_place - twists @ place.absorbed) * _place_std(result, place)
        yield (Source.FRAME if place.is_frame else Source.TARGET), left


def _place_std(result: Calibration, place: StatedPlace) -> Array:
    """Return the standard deviations of a frame's or target's displacement, along and about its axes, (6,)."""
    stated = result.stated_uncertainty
    sizes = (stated.frame, stated.frame_angle) if place.is_frame else (stated.target, 0.0)
    return np.repeat(sizes, 3)


# What each arrival adds


@dataclass(frozen=True, slots=True)
class Arrivals:
    """Variances of a coordinate [m^2] and of a turn about an axis [rad^2] at each arrival of the robot, as pairs."""

    repeatability: tuple[float, float]
    repeatability_freedom: tuple[float, float]
    #: What the model lacks at the measured poses
    model: tuple[float, float]
    model_freedom: tuple[float, float]
    drift: float
    #: Whether the instrument's noise is told from the robot's errors
    separated: bool


def arrivals_of(result: Calibration, model: FittedModel) -> Arrivals:
    """Return what each arrival of the robot adds to the error of a predicted pose.

    Args:
        result: The calibration.
        model: Its model that predicts.
    """
    stated = result.stated_uncertainty
    rows = model.scatter
    repeatability, of_repeatability = [0.0, 0.0], [np.inf, np.inf]
    lacking, of_lacking = [0.0, 0.0], [np.inf, np.inf]
    if rows is None:
        return Arrivals((0.0, 0.0), (np.inf, np.inf), (0.0, 0.0), (np.inf, np.inf), 0.0, True)
    # What is stated, and acted on the rows too.
    on_rows = rows.by_joints @ _joint_variances(result)
    for place in model.stated_places:
        on_rows = on_rows + place.on_rows @ _place_std(result, place) ** 2
    separated = True
    for k in range(2):
        is_known = np.isfinite(rows.instrument[k])
        instrument = float(rows.instrument[k]) if is_known else 0.0
        if k == 0 and stated.repeatability > 0.0:
            repeatability[k] = stated.repeatability**2
        elif np.isfinite(rows.within[k]):
            repeatability[k], of_repeatability[k] = variance_beyond(
                float(rows.within[k]), float(rows.within_freedom[k]), instrument
            )
        if np.isfinite(rows.total[k]):
            other = instrument + repeatability[k] + float(on_rows[k])
            lacking[k], of_lacking[k] = variance_beyond(
                float(rows.total[k]), float(rows.freedom[k]), other
            )
            separated = separated and bool(is_known)
    return Arrivals(
        (repeatability[0], repeatability[1]),
        (of_repeatability[0], of_repeatability[1]),
        (lacking[0], lacking[1]),
        (of_lacking[0], of_lacking[1]),
        stated.drift**2,
        separated,
    )


def _of_arrivals(arrivals: Arrivals, count: int) -> Iterator[Contribution]:
    """Yield the parts that are the same at all of so many poses."""
    for source, variances, freedoms in (
        (Source.REPEATABILITY, arrivals.repeatability, arrivals.repeatability_freedom),
        (Source.MODEL, arrivals.model, arrivals.model_freedom),
        (Source.DRIFT, (arrivals.drift, 0.0), (np.inf, np.inf)),
    ):
        diagonal = np.repeat(variances, 3)
        covariance = np.broadcast_to(np.diag(diagonal), (count, 6, 6))
        freedom = freedoms[0] if variances[0] > 0.0 else freedoms[1]
        is_estimated = np.isfinite(freedom)
        yield _part(
            source,
            covariance,
            Distribution.STUDENT if is_estimated else Distribution.NORMAL,
            freedom,
        )


def _joint_variances(result: Calibration) -> Array:
    """Return the variance of each joint about its reading by what is stated, (m,), of all parts together."""
    resolution, lost_motion = stated_joint_limits(result)
    return np.asarray((resolution**2 + lost_motion**2) / 3.0)


def stated_joint_limits(result: Calibration) -> tuple[Array, Array]:
    """Return half the step of each joint's reading, and its largest lost motion either way, as stated.

    Args:
        result: The calibration.

    Returns:
        Shape (m,) each, [rad] or [m]; 0 where nothing is stated.
    """
    stated = result.stated_uncertainty
    slides = np.array([joint.type == "prismatic" for joint in result.nominal.inputs])
    half_step = np.where(slides, stated.resolution_sliding, stated.resolution) / 2.0
    return half_step, np.where(slides, 0.0, stated.lost_motion)


def _of_joints(
    result: Calibration, model: FittedModel, samples: Samples, *, in_base: bool
) -> Iterator[Contribution]:
    """Yield the parts by which joints stand beside their readings."""
    limits = stated_joint_limits(result)
    if not np.any(limits):
        return
    J = joint_twists(model.kinematics, model.x, samples)
    if in_base:
        R = model.setup.T_frame_base[samples.frame][:, :3, :3].transpose(0, 2, 1)
        J = np.concatenate([R @ J[:, :3], R @ J[:, 3:]], axis=1)
    for source, limit in zip((Source.RESOLUTION, Source.LOST_MOTION), limits, strict=True):
        covariance = (J * (limit**2 / 3.0)) @ J.transpose(0, 2, 1)
        yield _part(source, covariance, Distribution.UNIFORM, np.inf)


def _mean_square_temperature(result: Calibration) -> float:
    """Return the mean square of the temperature at work about that of the measurement [K^2], over the stated range."""
    low, high = warmer(result)
    return (high - low) ** 2 / 12.0 + ((low + high) / 2.0) ** 2


def warmer(result: Calibration) -> tuple[float, float]:
    """Return by how much it is warmer at work than when the arm was measured, at least and at most [K]; 0: not stated.

    The arm was measured at the mean temperature of the record, or else in the middle of the stated range.
    """
    stated, measured = result.stated_uncertainty.temperature, result.record.temperature_C
    if not stated:
        return 0.0, 0.0
    at = float(np.mean(measured or stated))
    return stated[0] - at, stated[1] - at


def _of_temperature(
    result: Calibration,
    model: FittedModel,
    samples: Samples,
    poses: Array,
    twists: Array,
    *,
    in_base: bool,
) -> Iterator[Contribution]:
    """Yield the part that the growth of arm and instrument is of."""
    stated = result.stated_uncertainty
    from_base = np.zeros((len(poses), 6, 1))
    origin = np.zeros(3) if in_base else model.setup.T_frame_base[samples.frame][:, :3, 3]
    from_base[:, :3, 0] = poses[:, :3, 3] - origin
    growth = stated.arm_expansion**2 * _mean_square_temperature(result)
    covariance = growth * (from_base @ from_base.transpose(0, 2, 1))
    measured = result.record.temperature_C
    if len(measured) > 1 and model.scale is not None:
        grown = (twists @ model.scale.growth)[:, :, None]
        of_lengths = stated.instrument_expansion**2 * (measured[1] - measured[0]) ** 2 / 12.0
        covariance = covariance + of_lengths * (grown @ grown.transpose(0, 2, 1))
    yield _part(Source.TEMPERATURE, covariance, Distribution.UNIFORM, np.inf)


# Parts


def _part(
    source: Source, covariance: Array, distribution: Distribution, freedom: float
) -> Contribution:
    """Return a part, whose covariance nobody changes."""
    return Contribution(source, read_only(np.array(covariance)), distribution, float(freedom))


def _symmetric(covariance: Array) -> Array:
    """Return covariances, (N, 6, 6), without what rounding makes of their diagonals and of their symmetry."""
    result = (covariance + covariance.transpose(0, 2, 1)) / 2.0
    diagonal = np.einsum("nii->ni", result)
    diagonal[...] = np.maximum(diagonal, 0.0)
    return np.asarray(result)


def _by_source(parts: tuple[Contribution, ...]) -> list[Contribution]:
    """Return the parts with those of one source added up, in the order of `Source`.

    Their distribution is that of the larger one, and their degrees of freedom are by Welch and Satterthwaite.
    """
    result = []
    for source in Source:
        own = [part for part in parts if part.source is source]
        if not own:
            continue
        sizes = np.array([np.mean(_std(part.covariance, _POSITION) ** 2) for part in own])
        if not np.any(sizes):
            sizes = np.array([np.mean(_std(part.covariance, _ORIENTATION) ** 2) for part in own])
        covariance = np.sum([part.covariance for part in own], axis=0)
        leading = own[int(np.argmax(sizes))]
        shares = float(np.sum(sizes**2 / np.array([part.freedom for part in own])))
        freedom = float(np.sum(sizes)) ** 2 / shares if shares > 0.0 else np.inf
        result.append(_part(source, covariance, leading.distribution, freedom))
    return result
