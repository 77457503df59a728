"""Cross-validation: how well a fit predicts rows that it did not see.

Whole set-ups or poses are left out in turn; each fold is fitted on the linearised problem where that is the robot, else
from the beginning.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np
from scipy.special import stdtr

from calib.errors import MeasurementError
from calib.estimate.fitting import PAPER, Fitted, Task, fit, given_weights, weighting
from calib.estimate.linear import Linear
from calib.estimate.prior_terms import PriorTerms
from calib.estimate.stages import FEWEST_FREEDOM, Stage, staged
from calib.jobs import Progress
from calib.model.error_model import DIRECTIONS
from calib.numerics.errors import CrossValidation, Errors
from calib.numerics.likelihood import GaussianPriors
from calib.registration.known_distances import joined_stations
from calib.registration.registration import ENOUGH, nominal_setup, register_all_rows
from calib.registration.rows import Rows
from calib.registration.setup import Setup
from calib.robot.robot import read_only
from calib.units import Array, Integers, Mask

#: A fold is fitted from the beginning where the robot differs from the linearised one by this share of the noise, rms,
#: and where a set-up has fewer scalars.
_LINEAR, _FEWEST_SCALARS = 1e-3, 18.0

#: Of so many rows so small a share can be left out without finding weights, noise and sizes anew; and rows of all folds
#: that are fitted at a time.
_MANY, _SMALL_SHARE, _AT_A_TIME = 1500, 0.15, 4096

#: Up to this number of poses each is left out in turn, above it a tenth of them at a time; from this number of set-ups
#: on, whole ones are.
_LEAVE_ONE_OUT, _FOLDS, _FEWEST_SETUPS = 60, 10, 3


@dataclass(frozen=True, slots=True, eq=False)
class Folds:
    """Which rows are left out together."""

    method: str  # What it is called
    masks: tuple[Mask, ...]  # Of the rows left out, each of shape (N,)

    @classmethod
    def of(cls, blocks: Integers, setups: Integers | None = None, told: int | None = None) -> Folds:
        """Whole set-ups, if there are enough; or blocks one by one; or every tenth of them where there are many.

        ``told`` is the number of rows that say something themselves, if not all: of a pair one does.
        """
        if setups is not None and len(names := np.unique(setups)) >= _FEWEST_SETUPS:
            size = -(-len(names) // _LEAVE_ONE_OUT)
            parts = [names[k : k + size] for k in range(0, len(names), size)]
            method = "leave-one-set-up-out" if size == 1 else "leave-set-ups-out"
            return cls(method, tuple(np.isin(setups, some) for some in parts))
        present, blocks = np.unique(blocks, return_inverse=True)
        count = len(present)
        if count <= _LEAVE_ONE_OUT:
            method = "leave-one-out" if count in (len(blocks), told) else "leave-one-pose-out"
            return cls(method, tuple(blocks == i for i in range(count)))
        return cls(f"{_FOLDS}-fold", tuple(blocks % _FOLDS == k for k in range(_FOLDS)))

    @classmethod
    def of_task(cls, task: Task, rows: Rows) -> Folds:
        """Set-ups from three on, else poses with their repeats and pairs.

        A set-up stays with the others where it alone says what they cannot: orientations, or where the base stands.
        """
        setups = joined_stations(rows, task.distances)
        # Each target whose orientation was measured must be so in two set-ups: one alone cannot be predicted.
        turned, targets = rows.where(lambda kind: kind.orientation), rows.samples.target
        seen = [len(np.unique(setups[turned & (targets == t)])) for t in np.unique(targets[turned])]
        # No set-up, or more than one, must be measured in a known frame: one alone tells where the base stands.
        known = np.array([len(unknown) < len(DIRECTIONS) for unknown in task.setup.unknown])
        points = rows.where(lambda kind: kind.position) & known[rows.samples.frame]
        whole = min(seen, default=2) > 1 and len(np.unique(setups[points])) != 1
        told = int(np.sum(np.any(rows.used, axis=1)))
        result = cls.of(rows.blocks, setups if whole else None, told)
        if len(result.masks) < 2:
            raise MeasurementError(
                "These are rows of one pose, which tell nothing of the robot: its errors there cannot be told from the "
                "target's place, and none is left to validate with. Measure more poses; calib plan chooses them."
            )
        return result

    def validated(self, rows: Rows, residuals: Sequence[Array], outliers: Mask) -> CrossValidation:
        """What was left over at the rows of each fold, as one value; nothing predicts sole postures."""
        residual = np.zeros(rows.used.shape)
        for mask, found in zip(self.masks, residuals, strict=True):
            residual[mask, : found.shape[1]] = found  # those left out may lack a kind
        checked = rows.checked
        good = checked & ~outliers
        return CrossValidation(
            method=self.method,
            folds=len(self.masks),
            poses=np.unique(rows.blocks, return_inverse=True)[1].reshape(-1),
            residual=read_only(residual),
            errors=Errors.of(residual[checked], rows.used[checked]),
            errors_without_outliers=Errors.of(residual[good], rows.used[good]),
        )


def cross_validation(
    fitted: Fitted, outliers: Mask, progress: Progress | None = None
) -> CrossValidation:
    """Cross-validation of the calibrated robot, fitted anew without each fold.

    A fold is fitted on the problem linearised at the fit to all rows, where that is the robot, else from the beginning.
    """
    task, rows = fitted.task, fitted.estimate.problem.rows
    folds = Folds.of_task(task, rows)
    found = _on_the_linearised(fitted, folds.masks, outliers)
    for k, mask in enumerate(folds.masks):
        if k not in found:
            found[k] = _unseen(fit(task, rows.select(~mask)), rows, mask, outliers)
        if progress is not None:
            progress(k + 1, len(folds.masks))
    return folds.validated(rows, [found[k] for k in range(len(folds.masks))], outliers)


def _unseen(fitted: Fitted, rows: Rows, mask: Mask, outliers: Mask) -> Array:
    """What a fit leaves over at the rows that it did not see."""
    T_base_tip = fitted.tip_poses(rows.samples.select(mask))
    return _left_over(T_base_tip, fitted.placed(), rows, mask, ~mask, outliers)


def _left_over(
    T_base_tip: Array, placed: Setup, rows: Rows, mask: Mask, seen: Mask, outliers: Mask
) -> Array:
    """Measured minus predicted of held-out rows; frames and targets that only they see are registered to them."""
    left, samples = rows.select(mask), rows.samples
    loose = placed.with_fixed(*placed.seen_by(samples.select(seen)))
    if loose.count:
        kept = left.without(outliers[mask])
        placed = register_all_rows(T_base_tip[kept], loose, left.select(kept))
    return left.residual(placed.target_poses(T_base_tip, left.samples))


def _on_the_linearised(fitted: Fitted, masks: tuple[Mask, ...], outliers: Mask) -> dict[int, Array]:
    """What is left over at the rows of folds, by their numbers, where the linearised problem gives the parameters."""
    task, estimate, problem = fitted.task, fitted.estimate, fitted.estimate.problem
    rows, model = problem.rows, fitted.kinematics.model
    if task.solver == PAPER or estimate.at_bound:
        return {}
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
    linear, some = problem.linear(estimate.x), np.array([masks[k] for k in chosen])
    prior = PriorTerms.of(task.cell, model, task.setup, fitted.setup, lenient=task.lenient)
    if len(rows) >= _MANY and some.mean(axis=1).max() < _SMALL_SHARE:
        x, freedom = fold_means(fitted, linear, some), np.full(len(some), np.inf)
    else:
        size, parts = max(_AT_A_TIME // len(rows), 1), []
        for first in range(0, len(some), size):
            begun = Stage.first(
                prior,
                rows.checked & ~some[first : first + size],
                len(linear.smallest),
                given_weights(rows),
            )
            how = weighting(task, rows)
            stage, freedom = staged(begun, lambda _: linear, rows.poses, **how)
            parts.append((stage.fit(linear)[0], freedom))
        x, freedom = map(np.concatenate, zip(*parts, strict=True))
    low, high = prior.limits.T
    good = (freedom > FEWEST_FREEDOM) & np.all((x >= low) & (x <= high), axis=1)
    found = {}
    for k, one in zip(np.array(chosen)[good].tolist(), x[good], strict=True):
        # The robot itself must be the linearised one at the rows that were kept.
        residual = problem.residual(one)
        apart = (linear.residual(one) * rows.scales - residual) / problem.scales
        kept = rows.used & (rows.checked & ~masks[k] & (estimate.weights > 0.0))[:, None]
        if not np.sqrt(np.mean(apart[kept] ** 2)) < _LINEAR:
            continue
        found[k] = residual[masks[k]]
        if np.any(only_there(fitted, masks[k])):
            without = replace(fitted, estimate=replace(estimate, x=one))
            found[k] = _unseen(without, rows, masks[k], outliers)
    return found


def nominal_cross_validation(task: Task, rows: Rows, outliers: Mask) -> CrossValidation:
    """Cross-validation of the nominal robot: what is estimated for the calibrated one is registered here."""
    folds, unknown = Folds.of_task(task, rows), task.setup.unknown
    given = np.array([not directions for directions in unknown])
    setup = replace(task.setup, frame_given=given, target_given=~task.setup.target_unknown)
    T_base_tip, some = task.robot.poses(rows.joints), rows.evenly(ENOUGH) & rows.without(outliers)
    residuals = []
    for mask in folds.masks:
        kept = ~mask & some
        placed = nominal_setup(T_base_tip[kept], setup, rows.select(kept))
        residuals.append(_left_over(T_base_tip[mask], placed, rows, mask, kept, outliers))
    return folds.validated(rows, residuals, outliers)


def linear_cross_validation(fitted: Fitted, outliers: Mask | None = None) -> CrossValidation:
    """Cross-validation on the linearised problem, with sizes, noise and weights of the fit to all rows: no new fit."""
    problem, estimate = fitted.estimate.problem, fitted.estimate
    rows, linear = problem.rows, problem.linear(estimate.x)
    folds, residuals = Folds.of_task(fitted.task, rows), []
    for mask, x in zip(folds.masks, fold_means(fitted, linear, folds.masks), strict=True):
        loose, part = only_there(fitted, mask), linear.select(mask)
        if np.any(loose):
            # With the rows' weights: one that has none must not move the frame of the others.
            root = np.sqrt(problem.weights[mask])[np.nonzero(part.used)[0]]
            rest = part.residual(np.where(loose, 0.0, x))[part.used] * root
            slopes = part.A[part.used][:, loose] * root[:, None]
            x[loose] = np.linalg.lstsq(slopes, rest, rcond=1e-9)[0]
        residuals.append(part.residual(x) * rows.scales[mask])
    return folds.validated(rows, residuals, estimate.outliers if outliers is None else outliers)


def only_there(fitted: Fitted, mask: Mask) -> Mask:
    """The parameters of frames and targets that only some rows see, shape (p,)."""
    seen = fitted.setup.seen_by(fitted.estimate.problem.rows.samples.select(~mask))
    places = zip(fitted.setup.places, seen, strict=True)
    alone = {name for names, there in places for name in compress(names, ~there)}
    return np.array([p.place in alone for p in fitted.kinematics.model.parameters], dtype=bool)


def fold_means(fitted: Fitted, linear: Linear, masks: Sequence[Mask] | Mask) -> Array:
    """Posterior means without each fold, at weights, noise and priors of the fit to all rows, shape (F, p)."""
    problem = fitted.estimate.problem
    weights = np.where(np.array(masks), 0.0, problem.weights)
    noise = np.tile(fitted.estimate.noise, (len(masks), 1))
    priors = GaussianPriors(problem.precision, problem.centre)
    return linear.fit(weights, problem.rho, noise, priors)[0]


def pose_errors(validation: CrossValidation, scales: Array, kept: Mask) -> Array:
    """Held-out error of each pose, root mean square over its rows, shape (poses,), in units of the scales.

    Args:
        validation: Errors on rows that the fit did not see.
        scales: Standard deviation of each scalar, shape (N, D), [m] and [rad].
        kept: Which rows count, shape (N,).
    """
    squares = np.sum((validation.residual / scales)[kept] ** 2, axis=1)
    _, pose = np.unique(validation.poses[kept], return_inverse=True)
    return np.sqrt(np.bincount(pose, squares) / np.bincount(pose))


def chance_of_fall(falls: Array) -> float:
    """The probability of as large a mean where there is no fall, by Student's t, one-sided.

    Args:
        falls: By how much the error of each pose falls, shape (poses,).
    """
    count, mean = len(falls), float(np.mean(falls))
    if count < 2:
        return 1.0
    std = float(np.std(falls, ddof=1))
    if not std > 0.0:
        return float(mean <= 0.0)
    return float(stdtr(count - 1, -mean / std * np.sqrt(count)))
