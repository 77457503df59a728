"""Cross-validation of a fit: each row predicted from the others, by new fits or on the linearised problem."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.data.kinds import DIRECTIONS
from calib.errors import MeasurementError
from calib.estimate.fit_stages import staged
from calib.estimate.fitting import (
    Fitted,
    Task,
    fit,
    holds_of,
)
from calib.estimate.problem import Linear
from calib.estimate.registration import ENOUGH, nominal_setup, register_poses
from calib.estimate.rows import Rows, evenly, without_outliers
from calib.estimate.setup import Setup, joined_setups
from calib.estimate.stage import FEWEST_FREEDOM, Holds, Stage
from calib.estimate.statistics import CrossValidation, Errors, Mask
from calib.model.parameters import ErrorModel, frame_place, target_place
from calib.robot.robot import read_only

Array = NDArray[np.float64]

#: The robot may differ from the linearised one by this share of the noise, rms.
_LINEAR = 1e-3

#: Scalars of a set-up below which a fold is fitted from the beginning: its frame may be anywhere.
_FEWEST_SCALARS = 18.0

#: Of so many rows so small a share can be left out without finding weights, noise and sizes anew.
_MANY, _SMALL_SHARE = 1500, 0.15

#: Rows of all folds that are fitted at a time.
_AT_A_TIME = 4096

#: Up to this number of poses each is left out in turn; above it, a tenth of them at a time.
_LEAVE_ONE_OUT = 60
_FOLDS = 10

#: From this number of set-ups on, whole ones are left out.
_FEWEST_SETUPS = 3

#: Called with the number of fits done and of fits in all.
Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True, eq=False)
class Folds:
    """Which rows are left out together."""

    method: str  # What it is called
    masks: tuple[Mask, ...]  # Of the rows left out, each of shape (N,)


def folds(poses: NDArray[np.int_], setups: NDArray[np.int_] | None = None) -> Folds:
    """Which rows are left out together: whole set-ups, or all of one pose, or every tenth pose where there are many."""
    if setups is not None and len(np.unique(setups)) >= _FEWEST_SETUPS:
        names = np.unique(setups)
        size = -(
            -len(names) // _LEAVE_ONE_OUT
        )  # more set-ups than that are left out several at a time
        return Folds(
            "leave-one-set-up-out" if size == 1 else "leave-set-ups-out",
            tuple(np.isin(setups, names[k : k + size]) for k in range(0, len(names), size)),
        )
    present, poses = np.unique(poses, return_inverse=True)
    count = len(present)
    if count <= _LEAVE_ONE_OUT:
        method = "leave-one-out" if count == len(poses) else "leave-one-pose-out"
        return Folds(method, tuple(poses == i for i in range(count)))
    return Folds(f"{_FOLDS}-fold", tuple(poses % _FOLDS == k for k in range(_FOLDS)))


def folds_of(task: Task, rows: Rows) -> Folds:
    """Which rows are left out together: set-ups from three on, else poses with their repeats and pairs.

    A set-up stays whole with the others where it alone says what they cannot: orientations, or where the base stands.

    Raises:
        MeasurementError: Too few rows to leave any out.
    """
    setups = joined_setups(rows, task.distances)
    # Each target whose orientation was measured must be so in two set-ups: one alone cannot be predicted.
    turned, targets = rows.where(lambda kind: kind.orientation), rows.samples.target
    seen = [len(np.unique(setups[turned & (targets == t)])) for t in np.unique(targets[turned])]
    # No set-up, or more than one, must be measured in a known frame: one alone tells where the base stands.
    known = np.array([len(unknown) < len(DIRECTIONS) for unknown in task.setup.unknown])
    points = rows.where(lambda kind: kind.position) & known[rows.samples.frame]
    whole = min(seen, default=2) > 1 and len(np.unique(setups[points])) != 1
    result = folds(_blocks(rows), setups if whole else None)
    if len(result.masks) < 2:
        raise MeasurementError(
            f"{len(rows)} row{'s' * (len(rows) > 1)} of one pose cannot be cross-validated: none is left to fit. "
            "Measure more poses, or name a model and do without (--model zeros --no-validate): auto chooses by rows "
            "that are left out."
        )
    measured = int(np.sum(np.any(rows.used, axis=1)))
    if result.method == "leave-one-pose-out" and measured == len(result.masks):
        return replace(result, method="leave-one-out")  # pairs: two rows of one measurement
    return result


def cross_validation(
    task: Task,
    rows: Rows,
    outliers: Mask,
    progress: Progress | None = None,
    *,
    fitted: Fitted | None = None,
) -> CrossValidation:
    """Cross-validation of the calibrated robot, fitted anew without each fold.

    With the fit to all rows at hand a fold is fitted on the problem linearised there (`fold_fits`): as from the
    beginning, but for registration and kinematics, and the robot itself predicts its rows. Where the robot is not the
    linearised one there, with the paper's solver, at bounds and with few rows, it is fitted from the beginning.

    Raises:
        MeasurementError: Too few rows to leave any out.
    """
    left_out = folds_of(task, rows)
    found = {} if fitted is None else _without_folds(fitted, left_out.masks, outliers)
    residuals = []
    for k, mask in enumerate(left_out.masks):
        residuals.append(found[k] if k in found else _refitted(task, rows, mask, outliers))
        if progress is not None:
            progress(k + 1, len(left_out.masks))
    return _validated(rows, left_out, residuals, outliers)


def _validated(
    rows: Rows, left_out: Folds, residuals: Sequence[Array], outliers: Mask
) -> CrossValidation:
    """What was left over at the rows of each fold, as one value."""
    residual = np.zeros(rows.used.shape)
    for mask, found in zip(left_out.masks, residuals, strict=True):
        residual[mask, : found.shape[1]] = found  # those left out may lack a kind
    return CrossValidation(
        method=left_out.method,
        folds=len(left_out.masks),
        poses=_blocks(rows),
        residual=read_only(residual),
        errors=Errors.of(residual, rows.used),
        errors_without_outliers=Errors.of(residual[~outliers], rows.used[~outliers]),
    )


def _refitted(task: Task, rows: Rows, mask: Mask, outliers: Mask) -> Array:
    """What a fit from the beginning to the other rows leaves over at those left out.

    Raises:
        MeasurementError: The others are too few.
    """
    try:
        return _unseen(fit(task, rows.select(~mask)), rows, mask, outliers)
    except MeasurementError as error:
        raise MeasurementError(
            f"Cross-validation leaves out {mask.sum()} of {len(rows)} rows at a time, and the others are too few: "
            f"{error} Or do without validation (--no-validate)."
        ) from error


def _unseen(fitted: Fitted, rows: Rows, mask: Mask, outliers: Mask) -> Array:
    """What a fit leaves over at the rows that it did not see."""
    T_base_tip = fitted.tip_poses(rows.samples.select(mask))
    return _left_over(T_base_tip, fitted.placed(), rows, mask, ~mask, outliers)


def _left_over(
    T_base_tip: Array, placed: Setup, rows: Rows, mask: Mask, seen: Mask, outliers: Mask
) -> Array:
    """Measured minus predicted of left-out rows; frames and targets that only they see are registered to them."""
    left, samples = rows.select(mask), rows.samples
    frames = np.isin(np.arange(len(placed.groups)), samples.frame[seen])
    targets = np.isin(np.arange(len(placed.targets)), samples.target[seen])
    loose = placed.as_known(frames, targets)
    if loose.count:
        kept = without_outliers(left, outliers[mask])
        placed = register_poses(T_base_tip[kept], loose, left.select(kept))
    return left.residual(placed.seen(T_base_tip, left.samples))


def _without_folds(fitted: Fitted, masks: tuple[Mask, ...], outliers: Mask) -> dict[int, Array]:
    """What is left over at the rows of folds, by their numbers, where the linearised problem gives the parameters."""
    task, estimate = fitted.task, fitted.estimate
    if task.solver == "paper" or estimate.at_bound:
        return {}
    problem, model = estimate.problem, fitted.kinematics.model
    rows, scales = problem.rows, problem.rows.scales
    chosen = []
    for k, mask in enumerate(masks):
        # The rows that are kept must be many for the parameters, in each set-up, and of every kind there is.
        count = np.sum(rows.used & ~mask[:, None], axis=1)
        scalars = np.bincount(rows.samples.frame, count)
        few = np.sum(count) < len(model) + FEWEST_FREEDOM
        few |= bool(np.any((scalars > 0.0) & (scalars < _FEWEST_SCALARS)))
        if not few and len(np.unique(rows.kinds[~mask])) == len(np.unique(rows.kinds)):
            chosen.append(k)
    if not chosen:
        return {}
    holds = holds_of(task, model, fitted.setup)
    linear = problem.linear(estimate.x)
    x, freedom = fold_fits(fitted, holds, linear, [masks[k] for k in chosen])
    good = (freedom > FEWEST_FREEDOM) & np.all(np.isfinite(x), axis=1)
    if holds.limits is not None:
        low, high = holds.limits.T
        good &= np.all((x >= low) & (x <= high), axis=1)
    found = {}
    for k, one in zip(np.array(chosen)[good].tolist(), x[good], strict=True):
        # The robot itself must be the linearised one at the rows that were kept.
        residual = problem.residual(one)
        apart = (linear.residual(one) * scales - residual) / problem.scales
        kept = rows.used & (~masks[k] & (estimate.weights > 0.0))[:, None]
        if not np.sqrt(np.mean(apart[kept] ** 2)) < _LINEAR:
            continue
        found[k] = residual[masks[k]]
        if np.any(only_there(model, fitted.setup, rows, masks[k])):
            without = replace(fitted, estimate=replace(estimate, x=one))
            found[k] = _unseen(without, rows, masks[k], outliers)
    return found


def nominal_cross_validation(task: Task, rows: Rows, outliers: Mask) -> CrossValidation:
    """Cross-validation of the nominal robot, frames and targets registered to the rows that are not left out.

    It differs from the calibrated one by the calibration alone: what is estimated there is registered here.
    """
    left_out = folds_of(task, rows)
    setup = replace(
        task.setup,
        frame_given=np.array([not directions for directions in task.setup.unknown]),
        target_given=~task.setup.target_unknown,
    )

    T_base_tip = task.robot.poses(rows.joints)
    some = evenly(rows, ENOUGH)
    residuals = []
    for mask in left_out.masks:
        kept = ~mask & some
        placed = nominal_setup(T_base_tip[kept], setup, rows.select(kept))
        residuals.append(_left_over(T_base_tip[mask], placed, rows, mask, kept, outliers))
    return _validated(rows, left_out, residuals, outliers)


def _blocks(rows: Rows) -> NDArray[np.int_]:
    """What is left out together, numbered from 0 without gaps: some blocks of the table may have no row here."""
    return np.unique(rows.blocks, return_inverse=True)[1].reshape(-1)


def linear_cross_validation(fitted: Fitted, outliers: Mask | None = None) -> CrossValidation:
    """Cross-validation on the linearised problem, with the sizes, the noise and the weights of the fit to all rows.

    No fit is repeated: without the fold the normal equations lack its rows. For comparing candidates.
    """
    task, problem, estimate = fitted.task, fitted.estimate.problem, fitted.estimate
    rows, model = problem.rows, fitted.kinematics.model
    linear = problem.linear(estimate.x)
    left_out = folds_of(task, rows)
    residuals = []
    for mask, x in zip(left_out.masks, fold_means(fitted, linear, left_out.masks), strict=True):
        loose = only_there(model, fitted.setup, rows, mask)
        part = linear.select(mask)
        if np.any(loose):
            # With the rows' weights: one that has none must not move the frame of the others.
            used = part.used
            root = np.sqrt(problem.weights[mask])[np.nonzero(used)[0]]
            rest = part.residual(np.where(loose, 0.0, x))[used] * root
            x[loose] = np.linalg.lstsq(part.A[used][:, loose] * root[:, None], rest, rcond=1e-9)[0]
        residuals.append(part.residual(x) * rows.scales[mask])
    return _validated(
        rows, left_out, residuals, estimate.outliers if outliers is None else outliers
    )


def only_there(model: ErrorModel, setup: Setup, rows: Rows, mask: Mask) -> NDArray[np.bool_]:
    """The parameters of frames and targets that only left-out rows see, shape (p,)."""
    alone = []
    places = (map(frame_place, setup.frame_unknowns), map(target_place, setup.target_names))
    for labels, names in zip((rows.samples.frame, rows.samples.target), places, strict=True):
        seen = set(labels[~mask].tolist())
        alone += [name for k, name in enumerate(names) if k not in seen]
    return np.array([p.place in alone for p in model.parameters], dtype=bool)


def fold_fits(
    fitted: Fitted, holds: Holds, linear: Linear, masks: Sequence[Mask]
) -> tuple[Array, Array]:
    """Fits without each fold, on the problem linearised at the fit to all rows.

    Each fold goes through the same stages as a fit from the beginning (`calib.estimate.fit_stages.staged`): weights by
    medians, then noise and sizes by restricted likelihood. Registration and kinematics are not repeated.

    Returns:
        The parameters, counted from where those of the fit to all rows are, shape (F, p); and the degrees of freedom of
        the first fit, shape (F,).
    """
    problem, task = fitted.estimate.problem, fitted.task
    if len(linear) >= _MANY and max(float(np.mean(mask)) for mask in masks) < _SMALL_SHARE:
        return fold_means(fitted, linear, masks), np.full(len(masks), np.inf)
    found = []
    size = max(_AT_A_TIME // len(linear), 1)
    for first in range(0, len(masks), size):
        kept = ~np.array(masks[first : first + size])
        stage, freedom = staged(
            Stage.first(holds, kept, len(linear.smallest)),
            lambda _: linear,
            problem.rows.poses,
            task.cell.repeats,
            robust=task.robust,
        )
        found.append((stage.fit(linear)[0], freedom))
    x, freedoms = zip(*found, strict=True)
    return np.concatenate(x), np.concatenate(freedoms)


def fold_means(fitted: Fitted, linear: Linear, masks: Sequence[Mask]) -> Array:
    """Posterior means without each fold, at weights, noise and priors of the fit to all rows, shape (F, p)."""
    problem = fitted.estimate.problem
    weights = np.where(np.array(masks), 0.0, problem.weights)
    noise = np.tile(fitted.estimate.noise, (len(masks), 1))
    return linear.fit(weights, noise, linear.known(problem.precision, problem.centre))[0]
