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
from calib.model.dh import zero_poses
from calib.model.families import ANGLE, LENGTH, ZERO
from calib.model.parameters import FRAME, TARGET
from calib.numerics.errors import rms
from calib.numerics.likelihood import GaussianPriors
from calib.registration.rows import Rows
from calib.units import Array, Mask

#: A p-value below which a finding is not taken for chance.
UNLIKELY = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class FurtherUnknowns:
    """Further unknowns, estimated together with those of a fit."""

    b: Array  #: shape (k,), the further unknowns
    covariance: Array  #: shape (k, k), of ``b``
    x: Array  #: shape (p,), the parameters of the fit, estimated together with ``b``
    #: shape (p,), to which share the measurements, and not the prior, determine each parameter, 0 to 1
    determined: Array
    prior_std: Mapping[str, float]  #: Prior standard deviation of each family, estimated anew

    def p_value(self, freedom: float, directions: Array | None = None) -> float:
        """The p-value of b where its truth is zero: F(k, freedom) of b^T C^-1 b / k.

        If ``directions``, shape (k', k), are given, only of b along these; ``freedom`` is that of the prior standard
        deviations in C.
        """
        some = np.eye(len(self.b)) if directions is None else directions
        b, C = some @ self.b, some @ self.covariance @ some.T
        square = float(b @ np.linalg.solve(C, b))
        return float(fdtrc(len(b), max(freedom, 1.0), square / len(b)))

    @property
    def std(self) -> Array:
        """Standard deviation of each, shape (k,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


def estimate_jointly(
    fitted: Fitted,
    columns: Array,
    of_distances: Array | None = None,
    held: Mask | None = None,
) -> FurtherUnknowns:
    """Estimate further unknowns beside the parameters of a fit, which stays as it is.

    Args:
        fitted: A fit with priors, not by the paper's solver.
        columns: shape (N, D, k), what a unit of each does to the predicted scalars [m], [rad].
        of_distances: shape (K, k), the same of the predicted known distances between frames [m]; None for nothing.
        held: shape (p,), parameters that b replaces, which are held at zero; None for none.
    """
    estimate, model, task = fitted.estimate, fitted.kinematics.model, fitted.task
    problem, x = estimate.problem, estimate.x
    linear, count = problem.linear(x), columns.shape[2]
    sigma = np.array([known.sigma for known in problem.distances])
    further = np.zeros((len(linear.C), count))
    if of_distances is not None:
        further[: len(sigma)] = of_distances / sigma[:, None]
    wider = _with_columns(linear, columns / problem.rows.scales[:, :, None], further)
    prior = PriorTerms.of(task, model, fitted.setup)
    fixed = {k: float(x[k]) for k in estimate.at_bound}
    if held is not None:
        fixed |= dict.fromkeys(np.flatnonzero(held).tolist(), 0.0)
    prior = prior.at_bounds(fixed)
    prior = replace(
        prior,
        families=np.pad(prior.families, ((0, 0), (0, count))),
        precision=np.pad(prior.precision, (0, count)),
        centre=np.pad(prior.centre, (0, count)),
    )
    weights, noise = problem.weights[None], np.array([estimate.noise])
    prior_std = np.array([[estimate.prior_std.get(name, 1.0) for name in prior.names]])
    alone, rho = np.ones(weights.shape), problem.rho[None]
    stage = Stage(prior, weights > 0.0, weights, alone, noise, prior_std, rho)
    stage = stage.by_likelihood(wider, robust=False)
    values, covariance, _ = (of_all[0] for of_all in stage.fit(wider))
    p = len(x)
    determined = 1.0 - np.diag(covariance)[:p] * stage.priors.precision[0, :p]
    found = dict(zip(prior.names, stage.prior_std[0].tolist(), strict=True))
    return FurtherUnknowns(values[p:], covariance[p:, p:], values[:p], determined, found)


def _with_columns(linear: LinearProblem, columns: Array, of_known: Array) -> LinearProblem:
    """Append columns, (N, D, k) in units of each scalar's sigma, to the linearised problem."""
    count = columns.shape[2]
    before, residual = linear.columns[:-1], linear.columns[-1:]
    return replace(
        linear,
        x=np.pad(linear.x, (0, count)),
        columns=np.concatenate([before, columns.transpose(2, 1, 0), residual]),
        C=np.hstack([linear.C, of_known]),
        held=np.pad(linear.held, (0, count)),
    )


#: A pattern predicts rows where it lowers the error of held-out blocks by this share.
PREDICTS = 0.1

#: Number of held-out blocks of consecutive rows.
_BLOCKS = 8


def gain_on_blocks(fitted: Fitted, columns: Array, weights: Array) -> float:
    """The share by which the error of held-out blocks of consecutive rows falls with further unknowns.

    Noise, prior sizes and weights stay as they are. Only rows count whose frame and target other blocks see too.

    Args:
        fitted: A fit.
        columns: shape (N, D, k), what a unit of each unknown does to the predicted scalars [m], [rad].
        weights: shape (N,), of the rows.
    """
    problem = fitted.estimate.problem
    linear = problem.linear(fitted.estimate.x)
    nothing = np.zeros((len(linear.C), columns.shape[2]))
    wider = _with_columns(linear, columns / problem.rows.scales[:, :, None], nothing)
    before, after = (_error_of_blocks(fitted, one, weights) for one in (linear, wider))
    return 1.0 - after / before if before > 0.0 else 0.0


def _error_of_blocks(fitted: Fitted, linear: LinearProblem, weights: Array) -> float:
    """The error of blocks of rows, each predicted by a fit to the others, rms in units of the noise."""
    problem, alive = fitted.estimate.problem, weights > 0.0
    rows, further = problem.rows, len(linear.x) - problem.size
    block = np.arange(len(rows)) * _BLOCKS // len(rows)
    masks = block == np.unique(block)[:, None]
    noise = np.tile(fitted.estimate.noise, (len(masks), 1))
    priors = GaussianPriors(
        *(np.pad(one, (0, further)) for one in (problem.precision, problem.centre))
    )
    x = linear.fit(np.where(masks, 0.0, weights), problem.rho, noise, priors)[0]
    residual = linear.residual(x) / linear.noise_by_scalar(noise)
    squares = []
    for mask, of_block in zip(masks, residual, strict=True):
        frames, targets = fitted.setup.seen_by(rows.samples.select(~mask & alive))
        seen = frames[rows.samples.frame] & targets[rows.samples.target]
        chosen = (mask & alive & seen)[:, None] & rows.used
        squares.append(of_block[chosen] ** 2)
    every = np.concatenate(squares)
    return float(np.sqrt(np.mean(every))) if len(every) else 0.0


def priors_from_data(fitted: Fitted) -> bool:
    """Whether the sizes of the errors are found from the data, so that they can be found anew."""
    return fitted.task.solver != PAPER and fitted.task.cell.priors.source == "data"


@dataclass(frozen=True, slots=True)
class Scale:
    """The scale error of the instrument, estimated together with the lengths of the arm."""

    share: float  #: By which share all that was measured is too long
    std: float  #: Its standard deviation, mostly from the uncertainty of the arm's lengths
    p: float  #: The p-value of no scale error
    reach: float  #: How far the target is from the base, rms over the rows [m]
    measured: (
        bool  #: Whether any row measures a length; else known distances alone determine the scale
    )

    @property
    def hidden(self) -> float:
        """The largest share that the rows cannot tell from lengths of the arm, at 95 %."""
        return abs(self.share) + 2.0 * self.std


def instrument_scale(fitted: Fitted) -> Scale | None:
    """Estimate the share by which measured lengths are too long; None where no length of the arm is estimated.

    Only rows that measure a length have the scale error, and the known distances between sockets.
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
    beside = estimate_jointly(fitted, columns, known)
    # The uncertainty is mostly that of the arm's lengths, whose prior is estimated with few degrees of freedom.
    freedom = float(np.sum(beside.determined[lengths])) - 1.0
    reach = rms(np.linalg.norm(from_base, axis=1))
    share, std = float(beside.b[0]), float(beside.std[0])
    return Scale(share, std, beside.p_value(freedom), reach, measured)


@dataclass(frozen=True, slots=True)
class BaseMotion:
    """How far the base stands from where a known measurement frame puts it, estimated with the arm's corrections."""

    moved: float  #: Of the first joint's origin [m]
    turned: float  #: Of its axis and about it [rad]
    p: float  #: The p-value of no motion
    effect: float  #: What it does to the measured positions, rms [m]
    effect_of_arm: float  #: What the arm's other corrections do to them, rms [m]


def motion_of_base(fitted: Fitted) -> BaseMotion | None:
    """Estimate where the base stands in a frame that was taken as known; None where no position was measured in one.

    Across the first joint's axis only an error of this joint's axis in the base does what the base does: there the test
    is against noise alone. Along and about the axis a motion may be the joint's offset: there it must be far larger
    than the offsets of the other joints.
    """
    rows, model = fitted.estimate.problem.rows, fitted.kinematics.model
    seen = _in_known_frame(fitted, rows)
    if not np.any(seen):
        return None
    T_frame_target = fitted.kinematics.poses(fitted.estimate.x, rows.samples)
    columns = rows.derivative(T_frame_target, _twists_of_base(fitted, T_frame_target))
    columns[~seen] = 0.0
    first = fitted.task.robot.joints[0].name
    of_first = np.array([p.place == first and p.factor is None for p in model.parameters])
    beside = estimate_jointly(fitted, columns, held=of_first)
    of_robot = ~model.family(FRAME, TARGET)
    freedom = float(np.sum(beside.determined[of_robot & ~of_first]))
    across, along, about = _directions_at_first_joint(fitted)
    chances = [
        beside.p_value(freedom, across),
        _chance_of_offset(float(along @ beside.b), beside, model.family(LENGTH), (LENGTH,)),
        _chance_of_offset(
            float(about @ beside.b), beside, model.family(ANGLE, ZERO), (ZERO, ANGLE)
        ),
    ]
    parts = (across.T @ across, np.outer(along, along), np.outer(about, about))
    kept = [part for part, p in zip(parts, chances, strict=True) if p < UNLIKELY]
    motion = np.sum(kept, axis=0) @ beside.b if kept else np.zeros(6)
    derivative = fitted.estimate.problem.jacobian(fitted.estimate.x)[seen][:, :3, of_robot]
    return BaseMotion(
        moved=float(np.linalg.norm(motion[:3])),
        turned=float(np.linalg.norm(motion[3:])),
        p=min(chances),
        effect=rms(np.linalg.norm(columns[seen][:, :3] @ motion, axis=1)),
        effect_of_arm=rms(np.linalg.norm(derivative @ beside.x[of_robot], axis=1)),
    )


def _chance_of_offset(
    offset: float, beside: FurtherUnknowns, family: Mask, names: tuple[str, ...]
) -> float:
    """The p-value of a joint's offset, given the standard deviation of the other joints': Student's t."""
    size = next((beside.prior_std[name] for name in names if name in beside.prior_std), 0.0)
    if not size:
        return 1.0
    freedom = max(float(np.sum(beside.determined[family])), 1.0)
    return 2.0 * float(stdtr(freedom, -abs(offset) / size))


def _directions_at_first_joint(fitted: Fitted) -> tuple[Array, Array, Array]:
    """Unit motions of the base, in its frame: across the first joint's axis, (4, 6), along it and about it, (6,)."""
    robot = fitted.task.robot
    axis = zero_poses(robot)[0][0][:3, :3] @ np.asarray(robot.joints[0].axis)
    normals, nothing = np.linalg.svd(axis[None])[2][1:], np.zeros((2, 3))
    across = np.block([[normals, nothing], [nothing, normals]])
    return across, np.concatenate([axis, np.zeros(3)]), np.concatenate([np.zeros(3), axis])


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
    """The rows that measure a position in an instrument's frame that was taken as known, shape (N,)."""
    known = np.array([not directions for directions in fitted.task.setup.unknown])
    positions = rows.where(lambda kind: kind.position and not kind.own_frame)
    return np.asarray(positions & known[rows.samples.frame])
