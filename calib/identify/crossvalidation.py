"""Cross-validation of a fit: each row predicted from the others, by new fits or on the linearised problem."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.errors import MeasurementError
from calib.identify.estimate import staged
from calib.identify.fitting import (
    Fitted,
    Task,
    fit,
    holds_of,
)
from calib.identify.nominal import ENOUGH, nominal_setup, seen_from, without_outliers
from calib.identify.problem import Linear
from calib.identify.registration import register_poses
from calib.identify.rows import Rows, evenly
from calib.identify.setup import Setup, joined_setups
from calib.identify.stage import FEWEST_FREEDOM, Holds, Stage
from calib.identify.statistics import CrossValidation, Folds, Mask, cross_validate, folds
from calib.kinds import DIRECTIONS
from calib.model.parameters import ErrorModel, frame_place, target_place

Array = NDArray[np.float64]

#: The robot may differ from the linearised one by this share of the noise, rms.
_LINEAR = 1e-3

#: Scalars of a set-up below which a fold is fitted from the beginning: its frame may be anywhere.
_FEWEST_SCALARS = 18.0

#: Called with the number of fits done and of fits in all.
Progress = Callable[[int, int], None]


def folds_of(task: Task, rows: Rows) -> Folds:
    """Which rows are left out together: set-ups from three on, else poses with their repeats and pairs.

    A set-up stays whole with the others where it alone says what they cannot: orientations, or where the base stands.

    Raises:
        MeasurementError: Too few rows to leave any out.
    """
    setups = joined_setups(rows, task.distances)
    whole = _turned_elsewhere(rows, setups) and _base_elsewhere(task.setup, rows, setups)
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

    Args:
        task: What to fit.
        rows: All rows.
        outliers: shape (N,), flagged by the fit to all rows.
        progress: Called after each fit.
        fitted: The fit to all rows; None to fit each fold from the beginning.

    Raises:
        MeasurementError: Too few rows to leave any out.
    """
    left_out = folds_of(task, rows)
    done = 0
    linear = None if fitted is None else _Linearised.of(fitted, left_out.masks)

    def predict_left_out(mask: Mask) -> Array:
        nonlocal done
        found = None if linear is None else linear.unseen(done, mask, outliers)
        if found is None:
            found = _refitted(task, rows, mask, outliers)
        done += 1
        if progress is not None:
            progress(done, len(left_out.masks))
        return found

    return cross_validate(_blocks(rows), left_out, outliers, rows.used, predict_left_out)


def _refitted(task: Task, rows: Rows, mask: Mask, outliers: Mask) -> Array:
    """What a fit from the beginning to the other rows leaves over at those left out.

    Raises:
        MeasurementError: The others are too few.
    """
    kept = rows.select(~mask)
    try:
        fitted = fit(task, kept)
    except MeasurementError as error:
        raise MeasurementError(
            f"Cross-validation leaves out {mask.sum()} of {len(rows)} rows at a time, and the others are too few: "
            f"{error} Or do without validation (--no-validate)."
        ) from error
    return _as_wide(fitted.unseen(rows.select(mask), kept, outliers[mask]), rows)


@dataclass(frozen=True, slots=True, eq=False)
class _Linearised:
    """The fit to all rows, and the parameters without each fold where the linearised problem gives them.

    Attributes:
        fitted: The fit.
        linear: Its problem, linearised at the solution.
        found: The parameters by the fold's number, each of shape (p,).
    """

    fitted: Fitted
    linear: Linear
    found: dict[int, Array]

    @classmethod
    def of(cls, fitted: Fitted, masks: tuple[Mask, ...]) -> _Linearised | None:
        """Fit without each fold; None where that takes fits from the beginning."""
        task, estimate = fitted.task, fitted.estimate
        if task.solver == "paper" or estimate.at_bound:
            return None
        problem, model = estimate.problem, fitted.kinematics.model
        chosen = [k for k, mask in enumerate(masks) if _enough(problem.rows, ~mask, len(model))]
        if not chosen:
            return None
        holds = holds_of(task, model, fitted.setup)
        linear = problem.linear(estimate.x)
        x, freedom = fold_fits(fitted, holds, linear, [masks[k] for k in chosen])
        good = (freedom > FEWEST_FREEDOM) & np.all(np.isfinite(x), axis=1)
        if holds.limits is not None:
            low, high = holds.limits.T
            good &= np.all((x >= low) & (x <= high), axis=1)
        return cls(fitted, linear, {k: x[i] for i, k in enumerate(chosen) if good[i]})

    def unseen(self, fold: int, mask: Mask, outliers: Mask) -> Array | None:
        """What the parameters without a fold leave over at its rows, by the robot itself, not the linearised one.

        None where there are none, or where the robot is not the linearised one at the rows that were kept.
        """
        if fold not in self.found:
            return None
        x, fitted = self.found[fold], self.fitted
        problem = fitted.estimate.problem
        rows, residual = problem.rows, problem.residual(x)
        looked_at = ~mask & (fitted.estimate.weights > 0.0)
        expected = self.linear.residual(x)[looked_at]
        given, found = rows.scales[looked_at], problem.scales[looked_at]
        apart = (expected - residual[looked_at] / given) * (given / found)
        if not np.sqrt(np.mean(apart[rows.used[looked_at]] ** 2)) < _LINEAR:
            return None
        if not np.any(only_there(fitted.kinematics.model, fitted.setup, rows, mask)):
            return np.asarray(residual[mask])
        without = replace(fitted, estimate=replace(fitted.estimate, x=x))
        kept = rows.select(~mask)
        return _as_wide(without.unseen(rows.select(mask), kept, outliers[mask]), rows)


def _enough(rows: Rows, kept: Mask, parameters: int) -> bool:
    """Whether the rows that are kept are many for the parameters, in each set-up, and of every kind there is."""
    count = np.sum(rows.used[kept], axis=1)
    if np.sum(count) < parameters + FEWEST_FREEDOM:
        return False
    scalars = np.bincount(rows.samples.frame[kept], count)
    if np.any((scalars > 0.0) & (scalars < _FEWEST_SCALARS)):
        return False
    kinds = rows.kinds
    return len(np.unique(kinds[kept])) == len(np.unique(kinds))


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
    some = evenly(rows, ENOUGH) if len(rows) > ENOUGH else np.ones(len(rows), dtype=bool)

    def predict_left_out(mask: Mask) -> Array:
        looked_at = ~mask & some
        kept = rows.select(looked_at)
        found = nominal_setup(T_base_tip[looked_at], setup, kept)
        left = _registered(T_base_tip[mask], found, rows.select(mask), kept, outliers[mask])
        return _as_wide(left, rows)

    return cross_validate(_blocks(rows), left_out, outliers, rows.used, predict_left_out)


def _turned_elsewhere(rows: Rows, setups: NDArray[np.int_]) -> bool:
    """Whether each target whose orientation was measured was so in two set-ups: one alone cannot be predicted."""
    turned = rows.where(lambda kind: kind.orientation)
    targets = rows.samples.target
    return all(
        len(np.unique(setups[turned & (targets == t)])) > 1 for t in np.unique(targets[turned])
    )


def _base_elsewhere(setup: Setup, rows: Rows, setups: NDArray[np.int_]) -> bool:
    """Whether no set-up, or more than one, is measured in a known frame: one alone tells where the base stands."""
    known = np.array([len(unknown) < len(DIRECTIONS) for unknown in setup.unknown])
    points = rows.where(lambda kind: kind.position)
    return len(np.unique(setups[points & known[rows.samples.frame]])) != 1


def _blocks(rows: Rows) -> NDArray[np.int_]:
    """What is left out together, numbered from 0 without gaps: some blocks of the table may have no row here."""
    return np.unique(rows.blocks, return_inverse=True)[1].reshape(-1)


def _as_wide(residual: Array, rows: Rows) -> Array:
    """The residual of some rows with as many columns as all of them have: those left out may lack a kind."""
    return np.pad(residual, ((0, 0), (0, rows.width - residual.shape[1])))


def _registered(T_base_tip: Array, found: Setup, rows: Rows, seen: Rows, outliers: Mask) -> Array:
    """The nominal robot's error on left-out rows, with what only they see registered to them."""
    frames = np.isin(np.arange(len(found.groups)), seen.samples.frame)
    targets = np.isin(np.arange(len(found.targets)), seen.samples.target)
    rest = found.as_known(frames, targets)
    if rest.count:
        chosen = without_outliers(rows, outliers)
        rest = register_poses(T_base_tip[chosen], rest, rows.select(chosen))
    return rows.residual(seen_from(rest, T_base_tip, rows))


def linear_cross_validation(fitted: Fitted, outliers: Mask | None = None) -> CrossValidation:
    """Cross-validation on the linearised problem, with the sizes, the noise and the weights of the fit to all rows.

    No fit is repeated: without the fold the normal equations lack its rows. For comparing candidates.

    Args:
        fitted: The fit to all rows.
        outliers: shape (N,), rows that errors are also told without; None for those that this fit flags.
    """
    task, problem, estimate = fitted.task, fitted.estimate.problem, fitted.estimate
    rows, model = problem.rows, fitted.kinematics.model
    linear = problem.linear(estimate.x)
    left_out = folds_of(task, rows)
    means = iter(fold_means(fitted, linear, left_out.masks))
    scales = rows.scales

    def predict_left_out(mask: Mask) -> Array:
        x = next(means)
        loose = only_there(model, fitted.setup, rows, mask)
        part = linear.select(mask)
        if np.any(loose):
            # With the rows' weights: one that has none must not move the frame of the others.
            used = part.used
            root = np.sqrt(problem.weights[mask])[np.nonzero(used)[0]]
            rest = part.residual(np.where(loose, 0.0, x))[used] * root
            x = x.copy()
            x[loose] = np.linalg.lstsq(part.A[used][:, loose] * root[:, None], rest, rcond=1e-9)[0]
        return np.asarray(part.residual(x) * scales[mask])

    aside = estimate.outliers if outliers is None else outliers
    return cross_validate(_blocks(rows), left_out, aside, rows.used, predict_left_out)


def only_there(model: ErrorModel, setup: Setup, rows: Rows, mask: Mask) -> NDArray[np.bool_]:
    """The parameters of frames and targets that only left-out rows see, shape (p,)."""
    places = []
    many = len(setup.groups) > 1
    for f, group in enumerate(setup.groups):
        if not np.any((rows.samples.frame == f) & ~mask):
            places.append(frame_place(group if many else ""))
    for t, name in enumerate(setup.target_names):
        if not np.any((rows.samples.target == t) & ~mask):
            places.append(target_place(name))
    if not places:
        return np.zeros(len(model), dtype=bool)
    return np.array([p.place in places for p in model.parameters], dtype=bool)


#: Of so many rows so small a share can be left out without finding weights, noise and sizes anew.
_MANY, _SMALL_SHARE = 1500, 0.15

#: Rows of all folds that are fitted at a time.
_AT_A_TIME = 4096


def fold_fits(
    fitted: Fitted, holds: Holds, linear: Linear, masks: Sequence[Mask]
) -> tuple[Array, Array]:
    """Fits without each fold, on the problem linearised at the fit to all rows.

    Each fold goes through the same stages as a fit from the beginning (`calib.identify.estimate.staged`): weights by
    medians, then noise and sizes by restricted likelihood. Registration and kinematics are not repeated.

    Args:
        fitted: The fit to all rows.
        holds: Its priors.
        linear: Its problem, linearised at the solution.
        masks: The rows left out, each of shape (N,).

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
