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

from calib.estimate.fitting import Fitted
from calib.estimate.linear import LinearProblem
from calib.estimate.prior_terms import PriorTerms
from calib.estimate.stages import Stage
from calib.estimate.task import PAPER
from calib.model.dh_table import zero_poses
from calib.model.families import ANGLE, LENGTH, ZERO
from calib.model.parameters import FRAME, TARGET
from calib.numerics.errors import rms
from calib.numerics.likelihood import GaussianPriors
from calib.registration.rows import Rows
from calib.units import Array, Mask

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
    #: shape (p,), to which share the measurements, and not the prior, determine each parameter, 0 to 1
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
        directions = np.eye(len(self.b)) if directions is None else directions
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
        fitted: A fit with priors, not by the paper's solver.
        columns: shape (N, D, k), derivative of the predicted scalars [m], [rad] by each unknown.
        of_distances: shape (K, k), derivative of the predicted known distances between frames [m]; None for zero.
        held: shape (p,), parameters that b replaces, which are held at zero; None for none.

    Returns:
        The unknowns, and the parameters estimated with them.
    """
    estimate = fitted.estimate
    wider = _with_unknowns(fitted, columns, of_distances)
    prior = _prior_with_unknowns(fitted, columns.shape[2], held)
    prior_std = [estimate.prior_std.get(name, 1.0) for name in prior.names]
    weights = estimate.problem.weights[None]
    stage = Stage(
        prior,
        weights > 0.0,
        weights,
        np.ones(weights.shape),
        np.array([estimate.noise]),
        np.array([prior_std]),
        estimate.problem.rho[None],
    )
    stage = stage.by_likelihood(wider, robust=False)
    fits = stage.fit(wider)
    values, covariance = fits[0][0], fits[1][0]
    p = len(estimate.x)
    estimated_std = stage.prior_std[0].tolist()
    return FurtherUnknowns(
        b=values[p:],
        covariance=covariance[p:, p:],
        x=values[:p],
        determined=1.0 - np.diag(covariance)[:p] * stage.priors.precision[0, :p],
        prior_std=dict(zip(prior.names, estimated_std, strict=True)),
    )


def _with_unknowns(fitted: Fitted, columns: Array, of_distances: Array | None) -> LinearProblem:
    """Linearise a fit's problem and append the columns of k further unknowns; see `estimate_jointly`."""
    problem = fitted.estimate.problem
    linear = problem.linear(fitted.estimate.x)
    further = np.zeros((len(linear.C), columns.shape[2]))
    if of_distances is not None:
        sigma = np.array([known.sigma for known in problem.distances])
        further[: len(sigma)] = of_distances / sigma[:, None]
    return _with_columns(linear, columns / problem.rows.scales[:, :, None], further)


def _prior_with_unknowns(fitted: Fitted, count: int, held: Mask | None) -> PriorTerms:
    """Make the priors of a fit with ``count`` further unknowns without prior.

    Parameters at their bounds stay there; those of the mask ``held``, shape (p,), are held at zero.
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
        centre=np.pad(prior.centre, (0, count)),
    )


def _with_columns(linear: LinearProblem, columns: Array, of_known: Array) -> LinearProblem:
    """Append the columns of k further unknowns, which are zero where it is linearised.

    Args:
        linear: A linearised problem of N rows and K known distances.
        columns: Derivative of the predictions, in units of each scalar's sigma, shape (N, D, k).
        of_known: Derivative of the known distances, in units of their sigma, shape (K, k).
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
        fitted: A fit.
        columns: shape (N, D, k), derivative of the predicted scalars [m], [rad] by each unknown.
        weights: shape (N,), of the rows.

    Returns:
        The share by which the error of held-out blocks falls with the unknowns; negative if it rises.
    """
    problem = fitted.estimate.problem
    linear = problem.linear(fitted.estimate.x)
    nothing = np.zeros((len(linear.C), columns.shape[2]))
    wider = _with_columns(linear, columns / problem.rows.scales[:, :, None], nothing)
    before = _error_of_blocks(fitted, linear, weights)
    after = _error_of_blocks(fitted, wider, weights)
    return 1.0 - after / before if before > 0.0 else 0.0


def _error_of_blocks(fitted: Fitted, linear: LinearProblem, weights: Array) -> float:
    """Root mean square error of blocks of rows, each predicted by a fit to the others, in units of the noise.

    Args:
        fitted: A fit.
        linear: Its problem, linearised, perhaps with further unknowns, which have no prior.
        weights: shape (N,), of the rows.
    """
    problem = fitted.estimate.problem
    rows, further = problem.rows, len(linear.x) - problem.size
    block = np.arange(len(rows)) * _BLOCKS // len(rows)
    masks = block == np.unique(block)[:, None]
    noise = np.tile(fitted.estimate.noise, (len(masks), 1))
    priors = GaussianPriors(
        np.pad(problem.precision, (0, further)), np.pad(problem.centre, (0, further))
    )
    x = linear.fit(np.where(masks, 0.0, weights), problem.rho, noise, priors)[0]
    residual = linear.residual(x) / linear.noise_by_scalar(noise)
    squares = []
    for mask, of_block in zip(masks, residual, strict=True):
        chosen = _predictable(fitted, mask, weights)[:, None] & rows.used
        squares.append(of_block[chosen] ** 2)
    every = np.concatenate(squares)
    return float(np.sqrt(np.mean(every))) if len(every) else 0.0


def _predictable(fitted: Fitted, block: Mask, weights: Array) -> Mask:
    """Rows of a block, (N,), with a weight, and whose frame and target rows of other blocks see too."""
    samples = fitted.estimate.problem.rows.samples
    weighted = weights > 0.0
    frames, targets = fitted.setup.seen_by(samples.select(~block & weighted))
    return np.asarray(block & weighted & frames[samples.frame] & targets[samples.target])


def priors_from_data(fitted: Fitted) -> bool:
    """Tell whether the prior standard deviations are estimated from the data, so that they can be estimated anew."""
    return fitted.task.solver != PAPER and fitted.task.cell.priors.source == "data"


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
    model, rows = fitted.kinematics.model, fitted.estimate.problem.rows
    lengths = ~model.family(FRAME, TARGET) & (np.array(model.units) == "m")
    if not np.any(lengths):
        return None
    T_frame_target = fitted.kinematics.poses(fitted.estimate.x, rows.samples)
    placed = fitted.placed()
    from_base = T_frame_target[:, :3, 3] - placed.T_frame_base[rows.samples.frame, :3, 3]
    growth = np.zeros((len(rows), 6, 1))
    growth[:, :3, 0] = from_base
    columns = rows.derivative(T_frame_target, growth)
    columns[~rows.where(lambda kind: kind.measures_length)] = 0.0
    known = np.array([[d.length] for d in fitted.estimate.problem.distances]).reshape(-1, 1)
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
    rows, model = fitted.estimate.problem.rows, fitted.kinematics.model
    seen = _in_known_frame(fitted, rows)
    if not np.any(seen):
        return None
    T_frame_target = fitted.kinematics.poses(fitted.estimate.x, rows.samples)
    columns = rows.derivative(T_frame_target, _twists_of_base(fitted, T_frame_target))
    columns[~seen] = 0.0
    of_first = _of_first_joint(fitted)
    joint = estimate_jointly(fitted, columns, held=of_first)
    motion, p = _significant_motion(fitted, joint, of_first)
    of_robot = ~model.family(FRAME, TARGET)
    derivative = fitted.estimate.problem.jacobian(fitted.estimate.x)[seen][:, :3, of_robot]
    return BaseMotion(
        moved=float(np.linalg.norm(motion[:3])),
        turned=float(np.linalg.norm(motion[3:])),
        p=p,
        effect=rms(np.linalg.norm(columns[seen][:, :3] @ motion, axis=1)),
        effect_of_arm=rms(np.linalg.norm(derivative @ joint.x[of_robot], axis=1)),
    )


def _of_first_joint(fitted: Fitted) -> Mask:
    """Parameters of the first joint's placement and zero, which a motion of the base replaces, shape (p,)."""
    first = fitted.task.robot.joints[0].name
    parameters = fitted.kinematics.model.parameters
    return np.array([p.place == first and p.factor is None for p in parameters])


def _significant_motion(
    fitted: Fitted, joint: FurtherUnknowns, of_first: Mask
) -> tuple[Array, float]:
    """Find the part of the base's estimated motion that is not chance.

    Args:
        fitted: The fit.
        joint: The motion b of the base, shape (6,), linear part first, estimated jointly with the fit.
        of_first: Parameters of the first joint, shape (p,).

    Returns:
        The motion [m], [rad], shape (6,), along the significant ones of three sets of directions: across the first
        joint's axis, along it, about it; and the smallest p-value of the three.
    """
    model = fitted.kinematics.model
    of_robot = ~model.family(FRAME, TARGET)
    freedom = float(np.sum(joint.determined[of_robot & ~of_first]))
    across, along, about = _directions_at_first_joint(fitted)
    shift, turn = float(along @ joint.b), float(about @ joint.b)
    p_values = [
        joint.p_value(freedom, across),
        _p_of_offset(shift, joint, model.family(LENGTH), (LENGTH,)),
        _p_of_offset(turn, joint, model.family(ANGLE, ZERO), (ZERO, ANGLE)),
    ]
    projections = (across.T @ across, np.outer(along, along), np.outer(about, about))
    significant = [
        projection for projection, p in zip(projections, p_values, strict=True) if p < UNLIKELY
    ]
    motion = np.sum(significant, axis=0) @ joint.b if significant else np.zeros(6)
    return motion, min(p_values)


def _p_of_offset(
    offset: float, joint: FurtherUnknowns, family: Mask, names: tuple[str, ...]
) -> float:
    """Test a joint's offset against those of the other joints, by Student's t.

    Args:
        offset: The offset [m] or [rad].
        joint: The estimate, with the prior standard deviation of each family.
        family: Parameters of the other joints' offsets, shape (p,).
        names: Families, of which the first with a prior standard deviation gives that of the offsets.

    Returns:
        The p-value of an offset that is drawn like the others; 1 if no family has a prior standard deviation.
    """
    std = next((joint.prior_std[name] for name in names if name in joint.prior_std), 0.0)
    if not std:
        return 1.0
    freedom = max(float(np.sum(joint.determined[family])), 1.0)
    return 2.0 * float(stdtr(freedom, -abs(offset) / std))


def _directions_at_first_joint(fitted: Fitted) -> tuple[Array, Array, Array]:
    """Unit motions of the base, in its frame: across the first joint's axis, (4, 6), along it and about it, (6,)."""
    robot = fitted.task.robot
    axis = zero_poses(robot)[0][0][:3, :3] @ np.asarray(robot.joints[0].axis)
    normals = np.linalg.svd(axis[None])[2][1:]
    nothing = np.zeros((2, 3))
    across = np.block([[normals, nothing], [nothing, normals]])
    along = np.concatenate([axis, np.zeros(3)])
    about = np.concatenate([np.zeros(3), axis])
    return across, along, about


def _twists_of_base(fitted: Fitted, T_frame_target: Array) -> Array:
    """Differentiate N poses T_frame_target by motions of the base along and about its axes, shape (N, 6, 6).

    The base turns about the first joint's origin; twists have the linear part first, along the frame's axes.
    """
    T_frame_base = fitted.placed().T_frame_base[fitted.estimate.problem.rows.samples.frame]
    origin = (T_frame_base @ zero_poses(fitted.task.robot)[0][0])[:, :3, 3]
    R, arm = T_frame_base[:, :3, :3], T_frame_target[:, :3, 3] - origin
    twists = np.zeros((len(R), 6, 6))
    twists[:, :3, :3] = R
    twists[:, 3:, 3:] = R
    twists[:, :3, 3:] = np.cross(R, arm[:, :, None], axis=1)
    return twists


def _in_known_frame(fitted: Fitted, rows: Rows) -> Mask:
    """Rows that measure a position in an instrument's frame that was taken as known, shape (N,)."""
    known = np.array([not directions for directions in fitted.task.setup.unknown])
    positions = rows.where(lambda kind: kind.position and not kind.own_frame)
    return np.asarray(positions & known[rows.samples.frame])
