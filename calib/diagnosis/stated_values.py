"""Stated values that the rows contradict: the frame of the base, the instrument's scale, lenses, boards, covariances.

Each is an additional unknown, estimated jointly with the fit (`calib.diagnosis.augmented_fit`). It has no prior itself:
of a focal length or a board it is besides what the fit changes under the stated prior, so that its standard deviation
includes the stated one.

A wrong lens or print can fit well: the arm's lengths and the mounts make up for it. If a board of another size has made
all lengths of the arm grow alike, their priors are wide; with the board's size free they are not.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, stdtr, stdtrit

from calib.basics.arrays import Array, Mask, read_only
from calib.diagnosis.augmented_fit import UNLIKELY, AugmentedFit, estimate_jointly
from calib.diagnosis.patterns import FALSE_ALARM
from calib.diagnosis.reasons import Reason, Why
from calib.fit.estimate.fitting import Fitted
from calib.fit.estimate.special_cases.pose_covariances import covariance_support
from calib.model.dh_table import zero_poses
from calib.model.families import ANGLE, FAMILIES, LENGTH, ZERO
from calib.model.internals import StatedSize
from calib.model.kinematics import Sightings
from calib.numerics.errors import rms

#: A base that has moved is named if its effect on the rows is more than this share of that of the arm's corrections.
_LIKE_THE_ARM = 0.5

#: Few arms are off by more than this share in all their lengths: a larger one is said, with both readings.
_SCALED = 2e-3

#: Relative errors of focal lengths and boards below this are of no consequence.
_LEAST_SHARE = 1e-3

#: With a smaller p-value an estimate contradicts what was stated with a standard deviation, as for a gain: a print that
#: is off by twice its usual 0.3 % along both axes has one of 0.003 to 0.02, and measuring it takes a minute.
_CONTRADICTS = 0.03

#: Degrees of freedom that prior standard deviations have at least.
_LEAST_FREEDOM = 3.0

#: Prior standard deviation of a relative change above which nothing was stated.
_NOT_STATED = 1.0

#: How far a corner is from its place is a guess to this factor.
_GUESSED = 2.0

#: The reason if a stated size of an instrument's internals is wrong, by its name.
_OFF = {"focal_length": Why.FOCAL_LENGTH_OFF, "board_scale": Why.BOARD_SCALE_OFF}

#: Log-likelihood over that of equal covariances up to which stated ones say nothing.
_NOTHING = 2.0

#: That which they have at least if they are right and say something about so many poses.
_TELLING = 10.0

#: Probability of `Scale.bound` on either side. A scale error is one number that displaces all points, and would exceed
#: its root mean square in every third case: the error that is expected at a new point contains this larger one.
_SURE = 0.95

#: A scale error agrees with the instrument's if it is within so many standard deviations.
_NO_SURPRISE = 2.0


def contradicted_values(fitted: Fitted, scale: Scale | None) -> Iterator[Reason]:
    """Find stated values that the rows contradict, and covariances that explain nothing.

    Args:
        fitted: A fit. Unless its prior standard deviations were estimated from the data, only the covariances of poses
            are examined.
        scale: The scale error of the instrument, as `instrument_scale` estimates it.

    Yields:
        A reason for each.
    """
    task = fitted.task
    if task.has_weights_and_priors and task.cell.priors.source == "data":
        base = None if task.cell.frame_aligned else motion_of_base(fitted)
        if (
            base is not None
            and base.p < UNLIKELY
            and base.effect > _LIKE_THE_ARM * base.effect_of_arm
        ):
            yield Reason.of(
                Why.BASE_MOVED,
                moved_m=base.moved,
                turned_rad=base.turned,
                effect_m=base.effect,
                arm_m=base.effect_of_arm,
            )
        if scale is not None and abs(scale.share) > _SCALED and scale.p < FALSE_ALARM:
            yield Reason.of(Why.LENGTHS_SCALED, scale=scale.share, std=scale.std, p=scale.p)
        yield from _wrong_internals(fitted)
        yield from _corners_off(fitted)
    yield from _idle_covariances(fitted)


@dataclass(frozen=True, slots=True)
class BaseMotion:
    """Displacement of the base from where a known measurement frame has it, estimated with the arm's corrections."""

    #: Of the first joint's origin [m]
    moved: float
    #: Of its axis and about it [rad]
    turned: float
    #: The p-value of no motion
    p: float
    #: Displacement of the measured positions by it, rms [m]
    effect: float
    #: Displacement of these positions by the arm's other corrections, rms [m]
    effect_of_arm: float


def motion_of_base(fitted: Fitted) -> BaseMotion | None:
    """Estimate the displacement of the base in a frame that was taken as known.

    What the base does, an error of the first joint's axis in the base and the joint's offset do as well. So the motion
    must be far larger than such errors are: across the axis, those of lengths and angles of this arm or of usual ones,
    whichever are larger; along and about it, the offsets of the other joints, or usual ones.

    Args:
        fitted: A fit with prior standard deviations from the data.

    Returns:
        The motion along the directions that are significant, zero if none is, with the smallest p-value of the four
        tests; None if no position was measured in a known frame.
    """
    problem, x = fitted.estimate.problem, fitted.estimate.x
    rows, robot, model = problem.rows, fitted.task.robot, fitted.kinematics.model
    known = np.array([not directions for directions in fitted.task.setup.unknown])
    positions = rows.where(lambda kind: kind.position and not kind.own_frame)
    seen = positions & known[rows.samples.frame]
    if not np.any(seen):
        return None

    # The base moves along and about its axes, linear part first; it turns about the first joint's origin.
    T_frame_target = fitted.kinematics.poses(x, rows.samples)
    T_frame_base = fitted.estimated_setup().T_frame_base[rows.samples.frame]
    T_base_first = zero_poses(robot)[0][0]
    arm = T_frame_target[:, :3, 3] - (T_frame_base @ T_base_first)[:, :3, 3]
    R = T_frame_base[:, :3, :3]
    twists = np.zeros((len(R), 6, 6))
    twists[:, :3, :3] = R
    twists[:, 3:, 3:] = R
    twists[:, :3, 3:] = np.cross(R, arm[:, :, None], axis=1)
    columns = rows.derivative(Sightings(T_frame_target, twists))
    columns[~seen] = 0.0

    # It replaces placement and zero of the first joint.
    first = robot.joints[0].name
    of_first = np.array([p.place == first and p.factor is None for p in model.parameters])
    joint = estimate_jointly(fitted, columns, held=of_first)

    # Two shifts and two turns across the first joint's axis, the shift along it, and the turn about it.
    axis = T_base_first[:3, :3] @ np.asarray(robot.joints[0].axis)
    normals = np.linalg.svd(axis[None])[2][1:]
    shifts = np.hstack([normals, np.zeros((2, 3))])
    turns = np.hstack([np.zeros((2, 3)), normals])
    along = np.concatenate([axis, np.zeros(3)])
    about = np.concatenate([np.zeros(3), axis])
    freedom = float(np.sum(joint.determined[model.of_robot & ~of_first]))
    p_values = (
        _p_across(joint, shifts, LENGTH, freedom, fitted.estimate.freedom),
        _p_across(joint, turns, ANGLE, freedom, fitted.estimate.freedom),
        _p_of_offset(float(along @ joint.b), joint, model.family(LENGTH), (LENGTH,)),
        _p_of_offset(float(about @ joint.b), joint, model.family(ANGLE, ZERO), (ZERO, ANGLE)),
    )
    parts = (shifts, turns, along[None], about[None])
    motion = np.zeros(6)
    significant = [part.T @ part for part, p in zip(parts, p_values, strict=True) if p < UNLIKELY]
    if significant:
        motion = np.sum(significant, axis=0) @ joint.b

    by_base = columns[seen][:, :3] @ motion
    by_arm = problem.prediction_jacobian(x)[seen][:, :3, model.of_robot] @ joint.x[model.of_robot]
    return BaseMotion(
        moved=float(np.linalg.norm(motion[:3])),
        turned=float(np.linalg.norm(motion[3:])),
        p=min(p_values),
        effect=rms(np.linalg.norm(by_base, axis=1)),
        effect_of_arm=rms(np.linalg.norm(by_arm, axis=1)),
    )


def _p_across(
    joint: AugmentedFit, directions: Array, name: str, freedom: float, of_noise: float
) -> float:
    """Return the p-value of a motion along directions, (2, 6), if it is an error of the first joint's axis.

    Such an error is drawn like the arm's others of the family ``name``, whose size has some degrees of freedom; or has
    the usual size if that is larger, which is known: then the freedom is that of the noise.
    """
    size, usual = joint.prior_std.get(name, 0.0), FAMILIES[name].typical
    if size < usual:
        size, freedom = usual, of_noise
    return joint.p_value(freedom, directions, size**2)


def _p_of_offset(offset: float, joint: AugmentedFit, family: Mask, names: tuple[str, ...]) -> float:
    """Return the two-sided p-value of a joint's offset [m] or [rad] if it is drawn like those of the other joints.

    The test is Student's t. ``family``, shape (p,), marks the parameters that are the other joints' offsets; the first
    of the families ``names`` with a prior standard deviation gives that of the offsets, or the usual size if that is
    larger, which is known: the offsets of few joints may vanish by chance. 1 if none has.
    """
    stds = [(joint.prior_std[name], name) for name in names if name in joint.prior_std]
    if not stds:
        return 1.0
    (size, name), *_ = stds
    freedom = max(float(np.sum(joint.determined[family])), 1.0)
    if size < FAMILIES[name].typical:
        size, freedom = FAMILIES[name].typical, np.inf
    return 2.0 * float(stdtr(freedom, -abs(offset) / size))


@dataclass(frozen=True, slots=True)
class Scale:
    """Scale error s of the instrument, estimated jointly with the lengths of the arm.

    With the prior s ~ N(0, prior^2) that the instrument has, and what the rows say of it, N(share, std^2), it is normal
    with the precision 1 / prior^2 + 1 / std^2; a share that contradicts the prior counts less. A fit that takes s as 0
    is off by ``growth`` s.
    """

    #: Share by which all measured lengths are too long
    share: float
    #: Its standard deviation, mostly from the uncertainty of the arm's lengths
    std: float
    #: Degrees of freedom of ``std``, which is mostly that of the arm's lengths; 1 or more
    freedom: float
    #: Standard deviation of the instrument's scale error before any row is seen; 0 if known distances give the scale
    prior: float
    #: Shape (p,), change of the parameters by a scale error of 1 that the fit takes as 0, in their units
    growth: Array

    @property
    def p(self) -> float:
        """P-value of no scale error, by the rows."""
        return 2.0 * float(stdtr(self.freedom, -abs(self.share) / self.std))

    @property
    def mean(self) -> float:
        """The share to expect, by the prior and the rows."""
        return self.share * self._weight

    @property
    def variance(self) -> float:
        """The variance of the share, by the prior and the rows."""
        return self._spread**2 * self._weight

    @property
    def size(self) -> float:
        """Root mean square of the share, by the prior and the rows."""
        return float(np.sqrt(self.mean**2 + self.variance))

    @property
    def change(self) -> Array:
        """Change of the parameters by the scale error, rms, shape (p,), in their units."""
        return self.size * self.growth

    @property
    def bound(self) -> float:
        """Size of the share that is exceeded by chance in 5 to 10 %, by the prior and the rows.

        Only as far as the rows determine the variance is it as uncertain as their ``freedom`` says.
        """
        if self._weight == 0.0:
            return 0.0
        return abs(self.mean) + float(stdtrit(self.freedom_of_size, _SURE) * np.sqrt(self.variance))

    @property
    def freedom_of_size(self) -> float:
        """Degrees of freedom of the variance by the prior and the rows; infinite if the prior alone determines it."""
        return self.freedom / self._weight**2 if self._weight > 0.0 else np.inf

    @property
    def _weight(self) -> float:
        """The weight of what the rows say, 0 to 1; the rest is the prior's."""
        return self.prior**2 / (self.prior**2 + self._spread**2) if self.prior > 0.0 else 0.0

    @property
    def _spread(self) -> float:
        """The ``std``, or more if the share is far beyond what it and the prior allow, and so tells of a larger one.

        It grows as Student's t distribution, of few degrees of freedom, asks of a value so far out; one within
        `_NO_SURPRISE` leaves it.
        """
        surprise = self.share**2 / (self.prior**2 + self.std**2)
        ratio = (self.freedom + surprise) / (self.freedom + _NO_SURPRISE**2)
        return self.std * float(np.sqrt(max(ratio, 1.0)))


def instrument_scale(fitted: Fitted) -> Scale | None:
    """Estimate the share by which measured lengths are too long, jointly with the arm's parameters.

    Rows that measure a length have the scale error, and so have the known distances between sockets; other rows do not.

    Args:
        fitted: A fit; its cell says how well the scale is known. Without priors those of usual arms count.

    Returns:
        The scale error; None if no length of the arm is estimated, nothing measures a length, or the scale of a board
        is estimated, which then is the arm's unit of length.
    """
    model, problem = fitted.kinematics.model, fitted.estimate.problem
    rows = problem.rows
    lengths = model.of_robot & (np.array(model.units) == "m")
    units: set[int] = set()
    for kind in rows.present:
        sizes = kind.internals.stated if kind.internals is not None else ()
        units.update(*(size.columns for size in sizes if size.is_unit_of_length))
    if not np.any(lengths) or any(p.internal in units for _, p in model.internals):
        return None

    T_frame_target = fitted.kinematics.poses(fitted.estimate.x, rows.samples)
    T_frame_base = fitted.estimated_setup().T_frame_base[rows.samples.frame]
    from_base = T_frame_target[:, :3, 3] - T_frame_base[:, :3, 3]
    growth = np.zeros((len(rows), 6, 1))
    growth[:, :3, 0] = from_base
    columns = rows.derivative(Sightings(T_frame_target, growth))
    columns[~rows.where(lambda kind: kind.measures_length)] = 0.0
    known = np.array([[d.length] for d in problem.distances]).reshape(-1, 1)
    measured = bool(np.any(columns))
    if not measured and not np.any(known):
        return None

    joint = estimate_jointly(fitted, columns, known)
    prior = fitted.task.cell.scale_sigma if measured else 0.0
    # The prior of the arm's lengths is estimated with few degrees of freedom.
    freedom = float(np.sum(joint.determined[lengths])) - 1.0
    return Scale(
        share=float(joint.b[0]),
        std=float(joint.std[0]),
        freedom=max(freedom, 1.0),
        prior=prior,
        growth=read_only(joint.absorbed[:, 0]),
    )


def _wrong_internals(fitted: Fitted) -> Iterator[Reason]:
    """Yield a reason for each stated size, of a focal length or a board, that seems to differ from what was stated.

    It has the share, which is the actual value over the stated one, less 1, its standard deviation, and whether the
    fit took the size as exact. All focal lengths of a camera, or a board's scale along x and y, have the same share.
    Sizes whose prior is so wide that nothing was stated are left out.
    """
    rows, setup = fitted.estimate.problem.rows, fitted.setup
    stated = {unknown.parameter.name: unknown.sigma for unknown in setup.internals}
    for kind in rows.present:
        values = rows.samples.internals
        if kind.internals is None or values is None:
            continue
        of_kind = rows.where(kind.__eq__)
        for size in kind.internals.stated:
            for number in np.unique(values[of_kind, size.owner]).astype(int).tolist():
                prior_shares = []
                for _, parameter in fitted.kinematics.model.internals:
                    of_owner = parameter.samples == ((size.owner, number),)
                    if parameter.internal in size.columns and of_owner:
                        # A focal length changes by pixels, a scale by a share.
                        whole = parameter.nominal if size.relative else 1.0
                        prior_shares.append(stated[parameter.name] / whole)
                if prior_shares and max(prior_shares) >= _NOT_STATED:
                    continue

                concerned = of_kind & (values[:, size.owner] == number)
                derivative = _derivative_by_share(fitted, size, concerned)
                joint = estimate_jointly(fitted, derivative)
                share, std, exact = float(joint.b[0]), float(joint.std[0]), not prior_shares
                freedom = max(float(np.sum(joint.determined)) - 1.0, _LEAST_FREEDOM)
                limit = UNLIKELY if exact else _CONTRADICTS
                if abs(share) > _LEAST_SHARE and joint.p_value(freedom) < limit:
                    yield Reason.of(_OFF[size.name], share=share, std=std, exact=exact)


def _corners_off(fitted: Fitted) -> Iterator[Reason]:
    """Yield a reason for each board whose corners are farther from their places than was stated.

    If the statement is right, the squares of the n estimated errors, over their prior variances, sum up to less than
    chi^2 with n degrees of freedom, as estimates scatter by less than what is estimated.
    """
    x = fitted.estimate.x
    stated = {unknown.parameter.name: unknown.sigma for unknown in fitted.setup.internals}
    by_board: dict[tuple[int, float], list[tuple[float, float]]] = {}
    for k, parameter in fitted.kinematics.model.internals:
        if parameter.of_one_point:
            error = (float(x[k]), stated[parameter.name])
            by_board.setdefault(parameter.samples[0], []).append(error)
    for errors in by_board.values():
        off, sigma = np.array(errors).T
        square = float(np.sum((off / sigma) ** 2))
        if square > _GUESSED**2 * len(off) and chdtrc(len(off), square) < UNLIKELY:
            yield Reason.of(Why.CORNERS_OFF, off_m=rms(off), stated_m=rms(sigma))


def _derivative_by_share(fitted: Fitted, size: StatedSize, concerned: Mask) -> Array:
    """Return the derivative of the predicted scalars by a relative error of a stated size, shape (N, D, 1).

    It is in the units of the rows' channels, and zero outside of the rows that the object of this size concerns, (N,).
    """
    rows, x = fitted.estimate.problem.rows, fitted.estimate.x
    values = rows.samples.internals
    assert values is not None
    by_internals = rows.derivative_by_internals(fitted.kinematics.sightings(x, rows.samples))
    result = np.zeros((len(rows), rows.width))
    for column in size.columns:
        # A focal length grows by a share of the stated one, a scale by the share alone.
        factor = values[:, column] if size.relative else 1.0
        result += by_internals[:, :, column] * np.reshape(factor * concerned, (-1, 1))
    return result[:, :, None]


def _idle_covariances(fitted: Fitted) -> Iterator[Reason]:
    """Say if the stated covariances of poses explain their residuals no better than equal ones, as they should.

    They are then in another order, unit or frame, or of other rows; or the robot misses its stops by far more than they
    say. The fit does not rely on them: their scale is small.
    """
    found = covariance_support(fitted.estimate)
    if found is None:
        return
    support, expected = found
    if support < _NOTHING and expected > _TELLING:
        scale = fitted.estimate.problem.rows.pose_noise.scale
        yield Reason.of(Why.COVARIANCES_IDLE, scale=scale)
