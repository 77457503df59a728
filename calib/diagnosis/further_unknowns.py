"""Further unknowns beside those of a fit: the scale error of the instrument, or a base that has moved.

The problem linearised at the fit gets further columns Z; their unknowns b have no prior:

    y = A x + Z b + n,        x_k ~ N(0, tau^2),  n ~ N(0, sigma^2)

The prior standard deviations tau and the noise sigma are estimated anew: corrections of the arm that only made up for b
shrink.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtrc, stdtr

from calib.basics.arrays import Array, Mask
from calib.camera.optics import SCALE
from calib.fit.estimate.fitting import Fitted
from calib.fit.estimate.linear import LinearProblem
from calib.fit.estimate.prior_terms import PriorTerms
from calib.fit.estimate.stages import Stage
from calib.fit.registration.rows import Rows
from calib.model.dh_table import zero_poses
from calib.model.families import ANGLE, LENGTH, ZERO
from calib.numerics.errors import rms
from calib.numerics.likelihood import GaussianPriors

#: A p-value below which a finding is not taken for chance.
UNLIKELY = 1e-3

#: A pattern predicts rows where it lowers the error of held-out blocks by this share.
PREDICTS = 0.1

#: Number of held-out blocks of consecutive rows.
_BLOCKS = 8


@dataclass(frozen=True, slots=True, eq=False)
class FurtherUnknowns:
    """Further unknowns b, estimated jointly with the p parameters of a fit."""

    #: Shape (k,), the further unknowns
    b: Array
    #: Shape (k, k), of ``b``
    covariance: Array
    #: Shape (p,), the parameters of the fit, estimated jointly with ``b``
    x: Array
    #: Shape (p,), to which share the measurements, and not the prior, determine each parameter, 0 to 1
    determined: Array
    #: Prior standard deviation of each family, estimated anew
    prior_std: Mapping[str, float]

    def p_value(self, freedom: float, directions: Array | None = None) -> float:
        """Test b = 0 by F(k, freedom) of b^T C^-1 b / k.

        Args:
            freedom: Degrees of freedom of the prior standard deviations in C.
            directions: Test only b along these directions, shape (k', k); None for all of b.

        Returns:
            The p-value.
        """
        if directions is None:
            directions = np.eye(len(self.b))
        b = directions @ self.b
        C = directions @ self.covariance @ directions.T
        square = float(b @ np.linalg.solve(C, b))
        return float(fdtrc(len(b), max(freedom, 1.0), square / len(b)))

    @property
    def std(self) -> Array:
        """Standard deviation of each further unknown, shape (k,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


def estimate_jointly(
    fitted: Fitted,
    columns: Array,
    of_distances: Array | None = None,
    held: Mask | None = None,
) -> FurtherUnknowns:
    """Estimate further unknowns jointly with the parameters of a fit, whose linearisation and row weights stay.

    Args:
        fitted: A fit with priors of p parameters to N rows of D scalars, not by the paper's solver.
        columns: Derivative of the predicted scalars [m], [rad] by each of k unknowns, shape (N, D, k).
        of_distances: Derivative of the K predicted known distances between frames [m], shape (K, k); None for zero.
        held: True for the parameters that b replaces, which are held at zero, shape (p,); None for none.

    Returns:
        The unknowns, and the parameters estimated with them.
    """
    wider = _with_unknowns(fitted, columns, of_distances)
    prior = _prior_with_unknowns(fitted, columns.shape[2], held)
    stage = _stage_at(fitted, prior).by_likelihood(wider, robust=False)
    fits = stage.fit(wider)
    values, covariance = fits[0][0], fits[1][0]
    p = len(fitted.estimate.x)
    shares_of_prior = np.diag(covariance)[:p] * stage.priors.precision[0, :p]
    estimated_std = stage.prior_std[0].tolist()
    return FurtherUnknowns(
        b=values[p:],
        covariance=covariance[p:, p:],
        x=values[:p],
        determined=1.0 - shares_of_prior,
        prior_std=dict(zip(prior.names, estimated_std, strict=True)),
    )


def _stage_at(fitted: Fitted, prior: PriorTerms) -> Stage:
    """Make the stage of an estimation that begins at the weights, noise and prior standard deviations of a fit.

    Args:
        fitted: A fit to N rows.
        prior: Its priors, perhaps with those of further unknowns.
    """
    estimate = fitted.estimate
    weights = estimate.problem.weights[None]
    prior_std = [estimate.prior_std.get(name, 1.0) for name in prior.names]
    return Stage(
        prior=prior,
        kept=weights > 0.0,
        weights=weights,
        repeat_factor=np.ones(weights.shape),
        noise=np.array([estimate.noise]),
        prior_std=np.array([prior_std]),
        stop_shares=estimate.problem.stop_shares[None],
    )


def _with_unknowns(fitted: Fitted, columns: Array, of_distances: Array | None) -> LinearProblem:
    """Linearise the problem of a fit at its solution and append the columns of k further unknowns.

    Args:
        fitted: A fit to N rows of D scalars.
        columns: Derivative of the predicted scalars [m], [rad] by each unknown, shape (N, D, k).
        of_distances: Derivative of the K predicted known distances between frames [m], shape (K, k); None for zero.
    """
    problem = fitted.estimate.problem
    linear = problem.linear(fitted.estimate.x)
    further = np.zeros((len(linear.C), columns.shape[2]))
    if of_distances is not None:
        sigma = np.array([known.sigma for known in problem.distances])
        further[: len(sigma)] = of_distances / sigma[:, None]
    return _with_columns(linear, problem.rows.standardise(columns), further)


def _prior_with_unknowns(fitted: Fitted, count: int, held: Mask | None) -> PriorTerms:
    """Make the priors of a fit with further unknowns, which have none. Parameters at their bounds stay there.

    Args:
        fitted: A fit of p parameters.
        count: Number of further unknowns.
        held: True for the parameters that are held at zero, shape (p,); None for none.
    """
    estimate = fitted.estimate
    prior = PriorTerms.of(fitted.task, fitted.kinematics.model, fitted.setup)
    fixed = {k: float(estimate.x[k]) for k in estimate.at_bound}
    if held is not None:
        fixed |= dict.fromkeys(np.flatnonzero(held).tolist(), 0.0)
    prior = prior.at_bounds(fixed)
    return replace(
        prior,
        families=np.pad(prior.families, ((0, 0), (0, count))),
        precision=np.pad(prior.precision, (0, count)),
        mean=np.pad(prior.mean, (0, count)),
    )


def _with_columns(linear: LinearProblem, columns: Array, of_known: Array) -> LinearProblem:
    """Append the columns of k further unknowns, which are zero where it is linearised.

    Args:
        linear: A linearised problem of N rows and K known distances.
        columns: Derivative of the predictions, in units of each scalar's sigma, shape (N, D, k).
        of_known: Derivative of the known distances, in units of their sigma, shape (K, k).

    Returns:
        The problem of p + k parameters, the further unknowns last.
    """
    count = columns.shape[2]
    before, residual = linear.columns[:-1], linear.columns[-1:]
    return replace(
        linear,
        x=np.pad(linear.x, (0, count)),
        columns=np.concatenate([before, columns.transpose(2, 1, 0), residual]),
        C=np.hstack([linear.C, of_known]),
        held=np.pad(linear.held, (0, count)),
    )


def gain_on_blocks(fitted: Fitted, columns: Array, weights: Array) -> float:
    """Cross-validate further unknowns on blocks of consecutive rows.

    Noise, prior standard deviations and weights stay as they are. Only rows count whose frame and target other blocks
    see too.

    Args:
        fitted: A fit to N rows of D scalars.
        columns: Derivative of the predicted scalars [m], [rad] by each of k unknowns, shape (N, D, k).
        weights: Weights of the rows, shape (N,).

    Returns:
        The share by which the error of held-out blocks falls with the unknowns; negative if it rises.
    """
    linear = fitted.estimate.problem.linear(fitted.estimate.x)
    wider = _with_unknowns(fitted, columns, None)
    before = _error_of_blocks(fitted, linear, weights)
    after = _error_of_blocks(fitted, wider, weights)
    if not before > 0.0:
        return 0.0
    return 1.0 - after / before


def _error_of_blocks(fitted: Fitted, linear: LinearProblem, weights: Array) -> float:
    """Root mean square error of blocks of rows, each predicted by a fit to the others, in units of the noise.

    Args:
        fitted: A fit to N rows.
        linear: Its problem, linearised at its solution, perhaps with further unknowns, which have no prior.
        weights: Weights of the rows, shape (N,).
    """
    rows = fitted.estimate.problem.rows
    block = np.arange(len(rows)) * _BLOCKS // len(rows)
    masks = block == np.unique(block)[:, None]
    residuals = _residuals_without_blocks(fitted, linear, weights, masks)
    squares = []
    for mask, residual in zip(masks, residuals, strict=True):
        predictable = _predictable(fitted, mask, weights)
        chosen = predictable[:, None] & rows.used
        squares.append(residual[chosen] ** 2)
    every = np.concatenate(squares)
    return float(np.sqrt(np.mean(every))) if len(every) else 0.0


def _residuals_without_blocks(
    fitted: Fitted,
    linear: LinearProblem,
    weights: Array,
    masks: Mask,
) -> Array:
    """Return the residuals of fits without one block of rows each, at noise and priors of the fit to all rows.

    Args:
        fitted: A fit to N rows of D scalars.
        linear: Its problem, linearised at its solution, perhaps with further unknowns, which have no prior.
        weights: Weights of the rows, shape (N,).
        masks: For each of B blocks, True for its rows, shape (B, N).

    Returns:
        Measured minus predicted of all rows, over the noise of each scalar, shape (B, N, D).
    """
    problem = fitted.estimate.problem
    further = len(linear.x) - problem.size
    precision = np.pad(problem.prior_precision, (0, further))
    centre = np.pad(problem.prior_mean, (0, further))
    noise = np.tile(fitted.estimate.noise, (len(masks), 1))
    without_block = np.where(masks, 0.0, weights)
    fits = linear.fit(without_block, problem.stop_shares, noise, GaussianPriors(precision, centre))
    return np.asarray(linear.residual(fits[0]) / linear.noise_by_scalar(noise))


def _predictable(fitted: Fitted, block: Mask, weights: Array) -> Mask:
    """Find the rows of a block with a weight whose frame and target rows of other blocks see too.

    Args:
        fitted: A fit to N rows.
        block: True for the rows of the block, shape (N,).
        weights: Weights of the rows, shape (N,).

    Returns:
        True for these rows, shape (N,).
    """
    samples = fitted.estimate.problem.rows.samples
    weighted = weights > 0.0
    elsewhere = samples.select(~block & weighted)
    frames, targets = fitted.setup.seen_by(elsewhere)
    seen_elsewhere = frames[samples.frame] & targets[samples.target]
    return np.asarray(block & weighted & seen_elsewhere)


def priors_from_data(fitted: Fitted) -> bool:
    """Tell whether the prior standard deviations are estimated from the data, so that they can be estimated anew.

    Args:
        fitted: A fit; the solver of its task and the priors of its cell decide.
    """
    task = fitted.task
    return task.has_weights_and_priors and task.cell.priors.source == "data"


@dataclass(frozen=True, slots=True)
class Scale:
    """Scale error of the instrument, estimated jointly with the lengths of the arm."""

    #: By which share all measured lengths are too long
    share: float
    #: Its standard deviation, mostly from the uncertainty of the arm's lengths
    std: float
    #: The p-value of no scale error
    p: float
    #: Distance of the target from the base, rms over the rows [m]
    reach: float
    #: Whether any row measures a length; else known distances alone determine the scale
    measured: bool

    @property
    def hidden(self) -> float:
        """Largest share that the rows cannot tell from lengths of the arm, at 95 %."""
        return abs(self.share) + 2.0 * self.std


def instrument_scale(fitted: Fitted) -> Scale | None:
    """Estimate the share by which measured lengths are too long.

    Only rows that measure a length have the scale error, and the known distances between sockets.

    Args:
        fitted: A fit with prior standard deviations from the data.

    Returns:
        The scale error; None where no length of the arm is estimated, or nothing measures a length.
    """
    model = fitted.kinematics.model
    problem = fitted.estimate.problem
    rows = problem.rows
    lengths = model.of_robot & (np.array(model.units) == "m")
    if not np.any(lengths) or _has_unknown_board(fitted):
        return None
    T_frame_target = fitted.kinematics.poses(fitted.estimate.x, rows.samples)
    T_frame_base = fitted.estimated_setup().T_frame_base[rows.samples.frame]
    from_base = T_frame_target[:, :3, 3] - T_frame_base[:, :3, 3]
    growth = np.zeros((len(rows), 6, 1))
    growth[:, :3, 0] = from_base
    columns = rows.derivative(T_frame_target, growth)
    columns[~rows.where(lambda kind: kind.measures_length)] = 0.0
    known = np.array([[d.length] for d in problem.distances]).reshape(-1, 1)
    measured = bool(np.any(columns))
    if not measured and not np.any(known):
        return None
    joint = estimate_jointly(fitted, columns, known)
    # The uncertainty is mostly that of the arm's lengths, whose prior is estimated with few degrees of freedom.
    freedom = float(np.sum(joint.determined[lengths])) - 1.0
    return Scale(
        share=float(joint.b[0]),
        std=float(joint.std[0]),
        p=joint.p_value(freedom),
        reach=rms(np.linalg.norm(from_base, axis=1)),
        measured=measured,
    )


def _has_unknown_board(fitted: Fitted) -> bool:
    """Tell whether a fit estimates the scale of a board, which then is the arm's unit of length."""
    scale = range(SCALE.start, SCALE.stop)
    return any(parameter.optic in scale for _, parameter in fitted.kinematics.model.optical)


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

    Across the first joint's axis only an error of this joint's axis in the base does what the base does: there the test
    is against noise alone. Along and about the axis a motion may be the joint's offset: there it must be far larger
    than the offsets of the other joints.

    Args:
        fitted: A fit with prior standard deviations from the data.

    Returns:
        The motion along the directions that are significant; None where no position was measured in a known frame.
    """
    problem, x = fitted.estimate.problem, fitted.estimate.x
    rows = problem.rows
    seen = _in_known_frame(fitted, rows)
    if not np.any(seen):
        return None
    T_frame_target = fitted.kinematics.poses(x, rows.samples)
    twists = _twists_of_base(fitted, T_frame_target)
    columns = rows.derivative(T_frame_target, twists)
    columns[~seen] = 0.0
    of_first = _of_first_joint(fitted)
    joint = estimate_jointly(fitted, columns, held=of_first)
    motion, p = _significant_motion(fitted, joint, of_first)
    by_base = columns[seen][:, :3] @ motion
    of_robot = fitted.kinematics.model.of_robot
    by_arm = problem.jacobian(x)[seen][:, :3, of_robot] @ joint.x[of_robot]
    return BaseMotion(
        moved=float(np.linalg.norm(motion[:3])),
        turned=float(np.linalg.norm(motion[3:])),
        p=p,
        effect=rms(np.linalg.norm(by_base, axis=1)),
        effect_of_arm=rms(np.linalg.norm(by_arm, axis=1)),
    )


def _of_first_joint(fitted: Fitted) -> Mask:
    """Mark the parameters of the first joint's placement and zero, which a motion of the base replaces.

    Args:
        fitted: A fit of p parameters.

    Returns:
        True for these parameters, shape (p,).
    """
    first = fitted.task.robot.joints[0].name
    parameters = fitted.kinematics.model.parameters
    return np.array([p.place == first and p.factor is None for p in parameters])


def _significant_motion(
    fitted: Fitted, joint: FurtherUnknowns, of_first: Mask
) -> tuple[Array, float]:
    """Find the part of the base's estimated motion that is not chance.

    Args:
        fitted: The fit, of p parameters.
        joint: The motion b of the base, shape (6,), linear part first, in the base's frame, estimated jointly with
            the parameters of the fit.
        of_first: True for the parameters of the first joint, shape (p,).

    Returns:
        The motion [m], [rad], shape (6,), along the significant ones of three sets of directions: across the first
        joint's axis, along it, about it; and the smallest p-value of the three.
    """
    directions = _directions_at_first_joint(fitted)
    p_values = _p_values_of_motion(fitted, joint, of_first, directions)
    significant = [
        projection
        for projection, p in zip(directions.projections, p_values, strict=True)
        if p < UNLIKELY
    ]
    motion = np.zeros(6)
    if significant:
        motion = np.sum(significant, axis=0) @ joint.b
    return motion, min(p_values)


def _p_values_of_motion(
    fitted: Fitted,
    joint: FurtherUnknowns,
    of_first: Mask,
    directions: _FirstJointDirections,
) -> tuple[float, float, float]:
    """Test for no motion of the base across the first joint's axis, along it, and about it.

    Args:
        fitted: The fit, of p parameters.
        joint: The motion b of the base, shape (6,), estimated jointly with the parameters of the fit.
        of_first: True for the parameters of the first joint, shape (p,).
        directions: The three sets of directions.

    Returns:
        The three p-values, in this order.
    """
    model = fitted.kinematics.model
    of_robot = model.of_robot
    freedom = float(np.sum(joint.determined[of_robot & ~of_first]))
    shift = float(directions.along @ joint.b)
    turn = float(directions.about @ joint.b)
    return (
        joint.p_value(freedom, directions.across),
        _p_of_offset(shift, joint, model.family(LENGTH), (LENGTH,)),
        _p_of_offset(turn, joint, model.family(ANGLE, ZERO), (ZERO, ANGLE)),
    )


def _p_of_offset(
    offset: float,
    joint: FurtherUnknowns,
    family: Mask,
    names: tuple[str, ...],
) -> float:
    """Test a joint's offset against those of the other joints, by Student's t.

    Args:
        offset: The offset [m] or [rad].
        joint: The motion of the base, with the prior standard deviation of each family estimated beside it.
        family: True for the parameters that are the other joints' offsets, shape (p,).
        names: Families, of which the first with a prior standard deviation gives that of the offsets.

    Returns:
        The p-value of an offset that is drawn like the others; 1 if no family has a prior standard deviation.
    """
    stds = [joint.prior_std[name] for name in names if name in joint.prior_std]
    if not stds or not stds[0]:
        return 1.0
    std = stds[0]
    freedom = max(float(np.sum(joint.determined[family])), 1.0)
    return 2.0 * float(stdtr(freedom, -abs(offset) / std))


@dataclass(frozen=True, slots=True, eq=False)
class _FirstJointDirections:
    """Unit motions of the base along its axes, linear part first, by where they go at the first joint."""

    #: (4, 6), orthonormal rows: two shifts across the joint's axis, and two turns about directions across it
    across: Array
    #: (6,), the shift along the axis
    along: Array
    #: (6,), the turn about the axis
    about: Array

    @property
    def projections(self) -> tuple[Array, Array, Array]:
        """Projections of a motion to ``across``, ``along`` and ``about``, each of shape (6, 6)."""
        return (
            self.across.T @ self.across,
            np.outer(self.along, self.along),
            np.outer(self.about, self.about),
        )


def _directions_at_first_joint(fitted: Fitted) -> _FirstJointDirections:
    """Work out the unit motions of the base at the first joint of a fit's robot, in the base's frame."""
    robot = fitted.task.robot
    T_base_first = zero_poses(robot)[0][0]
    axis = T_base_first[:3, :3] @ np.asarray(robot.joints[0].axis)
    normals = np.linalg.svd(axis[None])[2][1:]
    nothing = np.zeros((2, 3))
    return _FirstJointDirections(
        across=np.block([[normals, nothing], [nothing, normals]]),
        along=np.concatenate([axis, np.zeros(3)]),
        about=np.concatenate([np.zeros(3), axis]),
    )


def _twists_of_base(fitted: Fitted, T_frame_target: Array) -> Array:
    """Differentiate poses of the target by motions of the base along and about its axes.

    The base turns about the first joint's origin.

    Args:
        fitted: A fit to N rows.
        T_frame_target: Predicted pose of each row's target in its frame, shape (N, 4, 4), [m].

    Returns:
        Twists of the target by each of the six motions, linear part first, along the frame's axes, shape (N, 6, 6).
    """
    T_frame_base = fitted.estimated_setup().T_frame_base[fitted.estimate.problem.rows.samples.frame]
    T_base_first = zero_poses(fitted.task.robot)[0][0]
    origin = (T_frame_base @ T_base_first)[:, :3, 3]
    R = T_frame_base[:, :3, :3]
    arm = T_frame_target[:, :3, 3] - origin
    twists = np.zeros((len(R), 6, 6))
    twists[:, :3, :3] = R
    twists[:, 3:, 3:] = R
    twists[:, :3, 3:] = np.cross(R, arm[:, :, None], axis=1)
    return twists


def _in_known_frame(fitted: Fitted, rows: Rows) -> Mask:
    """Find the rows that measure a position in an instrument's frame that was taken as known.

    Args:
        fitted: A fit; frames of which its task estimates no direction are known.
        rows: Its N rows.

    Returns:
        True for these rows, shape (N,).
    """
    known = np.array([not directions for directions in fitted.task.setup.unknown])
    positions = rows.where(lambda kind: kind.position and not kind.own_frame)
    return np.asarray(positions & known[rows.samples.frame])
