"""Auto: how much model the data support; how well a fit predicts rows that it did not see; what poses can tell.

Every candidate is fitted by restricted likelihood with the same weights of the rows, those of the model that is the
best: it begins with the largest one. The geometry for the URDF is the best of those without other families.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import compress

import numpy as np

import calib.data.kinds as registry
from calib.data.cell import AUTO, Cell
from calib.data.measurements import Measurements
from calib.errors import MeasurementError, ModelError, choices
from calib.estimate.fitting import (
    PAPER,
    Fitted,
    Task,
    fit,
    given_weights,
    model_of,
    weighting,
)
from calib.estimate.problem import Linear, Priors, Problem
from calib.estimate.registration import ENOUGH, nominal_setup, register, register_poses
from calib.estimate.setup import Rows, Setup, joined_setups, known_distances, rows_of
from calib.estimate.stages import FEWEST_FREEDOM, PriorTerms, Stage, staged
from calib.estimate.statistics import CrossValidation, Errors
from calib.jobs import Progress
from calib.model.error_model import DIRECTIONS, joint_parameters
from calib.model.families import family_of, joint_families
from calib.model.kinematics import ErrorModel, Kinematics, joint_displacements
from calib.model.observability import Observability
from calib.robot.readback import spread_poses
from calib.robot.robot import Robot, read_only
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
        setups = joined_setups(rows, task.distances)
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
        """What was left over at the rows of each fold, as one value."""
        residual = np.zeros(rows.used.shape)
        for mask, found in zip(self.masks, residuals, strict=True):
            residual[mask, : found.shape[1]] = found  # those left out may lack a kind
        return CrossValidation(
            method=self.method,
            folds=len(self.masks),
            poses=np.unique(rows.blocks, return_inverse=True)[1].reshape(-1),
            residual=read_only(residual),
            errors=Errors.of(residual, rows.used),
            errors_without_outliers=Errors.of(residual[~outliers], rows.used[~outliers]),
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
    """Measured minus predicted of left-out rows; frames and targets that only they see are registered to them."""
    left, samples = rows.select(mask), rows.samples
    loose = placed.as_known(*placed.seen_by(samples.select(seen)))
    if loose.count:
        kept = left.without(outliers[mask])
        placed = register_poses(T_base_tip[kept], loose, left.select(kept))
    return left.residual(placed.seen(T_base_tip, left.samples))


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
                prior, ~some[first : first + size], len(linear.smallest), given_weights(rows)
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
        kept = rows.used & (~masks[k] & (estimate.weights > 0.0))[:, None]
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
    return linear.fit(weights, noise, Priors(problem.precision, problem.centre))[0]


#: The share of the rows at each end of a joint's measured range that are predicted by the others, and their fewest.
_OUTER = 0.2
_FEWEST_OUTER = 3


def extrapolation(fitted: Fitted) -> float:
    """By how many times the squared error of extrapolated predictions exceeds what the covariance says; 1 or more.

    Rows at one end of a joint's values are predicted by a linear fit to the others, for both ends of each joint: beyond
    their noise, |r|^2 - sigma^2, they should be off by tr(A C A^T). What the model lacks does not average out over the
    rows as noise does, so of many rows the covariance knows too little of it.
    """
    problem, estimate = fitted.estimate.problem, fitted.estimate
    masks = _outer_rows(problem.rows, estimate.weights > 0.0)
    if not masks:
        return 1.0
    linear = problem.linear(estimate.x)
    noise = np.tile(estimate.noise, (len(masks), 1))
    weights = np.where(np.array(masks), 0.0, problem.weights)
    priors = Priors(problem.precision, problem.centre)
    x, covariance, _ = linear.fit(weights, noise, priors)
    whitened = linear.residual(x) / linear.noise_of(noise)
    A = linear.A / linear.noise_of(noise[:1])[0][:, :, None]
    beyond, expected = 0.0, 0.0
    for mask, r, C in zip(masks, whitened, covariance, strict=True):
        counts = linear.used[mask] * problem.weights[mask][:, None]
        of_parameters = np.einsum("ndp,pq,ndq->nd", A[mask], C, A[mask], optimize=True)
        beyond += float(np.sum(counts * (r[mask] ** 2 - 1.0)))
        expected += float(np.sum(counts * of_parameters))
    return max(beyond / expected, 1.0) if expected > 0.0 else 1.0


def _outer_rows(rows: Rows, alive: Mask) -> list[Mask]:
    """The rows at each end of each joint's values, whole pairs, where there are enough and others beside them."""
    masks = []
    for q in rows.joints.T:
        low, high = np.quantile(q[alive], [_OUTER, 1.0 - _OUTER])
        for outer in (q <= low, q >= high):
            mask = rows.with_partners(outer)
            if low < high and _FEWEST_OUTER <= np.sum(mask) < 0.5 * len(rows):
                masks.append(mask)
    return masks


# Which model

#: The geometries, from the smallest to the largest.
LADDER = ("frames", "zeros", "dh", "hayati", "placement")

#: What a model pays, in restricted log likelihood. The size of a family's errors is an unknown too, and the likelihood
#: is the highest over it: by Laplace's approximation that costs the logarithm of the range it could have been in, a few
#: powers of ten, over the factor within which it is known then. Of sets with the same sizes the smaller is likelier.
_SIZE_COSTS, _RUNG_COSTS = 2.5, 1.0

#: Without priors each of these steps must lower the errors on left-out rows by this share instead.
_CLEARLY = 0.05

#: What a unit of an error moves every joint by less than moves nothing [rad, m].
_NO_MOTION = 1e-6

#: A family whose size vanishes to this share of what is usual is left out at once.
_NO_SIZE = 1e-2

#: The weights are found anew with the model that they chose, so often; and about so many rows choose it.
_JUDGED, _CHOSEN_BY = 2, 2000


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One model that was tried."""

    name: str  # Its set and families
    parameters: int  # Number of parameters
    log_likelihood: float  # Restricted log likelihood
    cross_validation: CrossValidation  # On the linearised problem; outliers: rows without weight
    sizes: dict[str, float]  # Size of the errors of each family
    evidence: float  # Log likelihood less what the model costs; without priors the fall of left-out errors in steps
    chosen: str = ""  # ``"geometry"``, ``"larger"`` or ``""``


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """What `select` chose."""

    geometry: str  # Name of the set that goes into the URDF
    larger: str  # Name of the non-geometric model; "" where the data support none
    candidates: tuple[Candidate, ...]  # All that were fitted, in order
    judge: Fitted  # The fit of the larger model, or of the geometry where there is none, with weights of its own


def select(task: Task, rows: Rows) -> Selection:
    """Choose geometry and larger model for some rows; `ModelError` for a name in the cell that no model has.

    The search begins with the largest model, whose priors shrink what the data do not support to nothing, and goes
    where the evidence is higher: one family less or more, or another set. Of many rows some are enough to choose by.
    """
    check_names(task)
    every, rows = rows, rows.select(rows.evenly(_CHOSEN_BY))
    task = replace(task, lenient=True)
    models = {name: model_of(replace(task, model=name)).names for name in LADDER}
    # Those with something to estimate, once each: hayati without near-parallel axes is dh.
    first = {columns: name for name, columns in reversed(models.items()) if columns}
    geometries = [name for name in LADDER if name in first.values()]
    families = [f for f in joint_families() if _moves(task, f, rows)]
    if task.cell.priors.sizes == "off":  # then there must be enough rows
        enough = [name for name in geometries if len(models[name]) <= rows.count]
        start = (enough or geometries[:1])[-1]
    else:
        start = "+".join((geometries[-1], *families))
    judge = fit(replace(task, model=start), rows)
    base, *has = start.split("+")
    sizes = judge.estimate.sizes
    there = [f for f in has if sizes.get(f, np.inf) > _NO_SIZE * family_of(f).prior]
    start = "+".join((base, *there))
    for _ in range(_JUDGED):
        tried: dict[str, Candidate] = {}
        value = partial(_value, task, rows, judge, tried)
        best = _climbed(start, value, geometries, families)
        geometry = max(geometries, key=value)
        found = fit(replace(task, model=best), rows, started=judge.setup)
        alike = np.array_equal(found.estimate.outliers, judge.estimate.outliers)
        start, judge = best, found
        if alike:
            break
    if len(rows) < len(every):
        judge = fit(replace(task, model=best), every, started=judge.setup)
    larger = best if "+" in best else ""
    marks = {geometry: "geometry", larger: "larger"}
    candidates = tuple(replace(c, chosen=marks.get(c.name, "")) for c in tried.values())
    return Selection(geometry, larger, candidates, judge)


def judged_by(own: Fitted, rows: Rows, judge: Fitted) -> Fitted:
    """The fit, with the weights of its own or of the judge, a larger model: whichever predicts rows better.

    Where a model lacks something, what it leaves over at good rows may be far more than at others. Rows that both call
    outliers are set aside; where the judge predicts rows better, no others are outliers.
    """
    other, told = fit(own.task, rows, judge=judge), judge.estimate
    aside = own.estimate.outliers & told.outliers
    errors = [
        linear_cross_validation(f, aside).errors_without_outliers for f in (own, other, judge)
    ]
    before, after, judged = (e.rms if e.n else e.rms_angle for e in errors)
    found = other if after < before else own
    estimate = found.estimate
    scores = np.minimum(estimate.scores, told.scores * estimate.flag_limit / told.flag_limit)
    scores = read_only(scores if judged < before else estimate.scores)
    return replace(found, estimate=replace(estimate, scores=scores))


def widest(own: Fitted, rows: Rows) -> Fitted:
    """The fit of a geometry with all families of the joints' own errors that rows of a table can tell."""
    task = own.task
    families = [f for f in joint_families() if _moves(task, f, rows)]
    task = replace(task, model="+".join((str(task.model), *families)), lenient=True)
    return fit(task, rows, started=own.setup)


def _climbed(
    start: str, value: Callable[[str], float], geometries: list[str], families: list[str]
) -> str:
    """The model that no neighbour is better than: one family less or more, or another set."""
    while True:
        base, *has = start.split("+")
        others = [[f for f in families if (f in has) != (f == one)] for one in families]
        near = ["+".join((base, *some)) for some in others]
        near += ["+".join((one, *has)) for one in geometries if one != base]
        best = max(near, key=value, default=start)
        if not value(best) > value(start):
            return start
        start = best


def _value(task: Task, rows: Rows, judge: Fitted, tried: dict[str, Candidate], name: str) -> float:
    """The evidence for a model with the judge's weights; none where without priors it has too many parameters."""
    if name not in tried:
        try:
            fitted = fit(replace(task, model=name), rows, judge=judge)
        except MeasurementError:
            return -np.inf
        # Rows without weight are the same for all candidates; what each flags by itself is not.
        left_out = linear_cross_validation(fitted, fitted.estimate.weights <= 0.0)
        base, *has = name.split("+")
        steps = LADDER.index(base) + len(has)
        if task.cell.priors.sizes == "off":
            e = left_out.errors_without_outliers
            found = [x for n, x in ((e.n, e.rms), (e.n_angle, e.rms_angle)) if n]
            evidence = -float(np.mean(np.log(found))) / _CLEARLY - steps
        else:
            adapts = task.cell.priors.sizes == "data"
            cost = _SIZE_COSTS * adapts * len(fitted.estimate.sizes)
            evidence = fitted.estimate.log_likelihood - cost - _RUNG_COSTS * LADDER.index(base)
        tried[name] = Candidate(
            name=name,
            parameters=len(fitted.kinematics.model),
            log_likelihood=fitted.estimate.log_likelihood,
            cross_validation=left_out,
            sizes=dict(fitted.estimate.sizes),
            evidence=evidence,
        )
    return tried[name].evidence


def _moves(task: Task, family: str, rows: Rows) -> bool:
    """Whether errors of a family move any joint at the rows: not compliances of a URDF without masses."""
    robot, samples = task.robot, rows.samples
    terms = joint_parameters(robot, family, task.cell.gravity)
    moved = joint_displacements(robot, terms, samples.q, samples.load)
    return bool(np.max(np.abs(moved), initial=0.0) > _NO_MOTION)


def check_names(task: Task) -> None:
    """Refuse names in the cell that no model of the ladder has."""
    cell, every = task.cell, ("+".join(("placement", *joint_families())), *LADDER[1:4])
    others = (other for other, _ in cell.ties.values())
    named = {*cell.frozen, *cell.bounds, *cell.parameter_priors, *cell.ties, *others}
    free = replace(task, cell=replace(cell, frozen=(), ties={}))
    models = (model_of(replace(free, model=name)) for name in every if named)
    known = {name for model in models for name in model.names}
    strange = sorted(named - known)
    if strange:
        raise ModelError(
            f"No model has the parameters {choices(strange)}; 'calib inspect --model dh' lists those of one."
        )


#: A target where none is given: off every axis of the tip [m].
GENERIC_TARGET = (0.05, 0.07, 0.03)

#: An anchor where none is known: off the first axis, which its distance would not tell of [m].
GENERIC_ANCHOR = (0.7, -0.5, 0.3)


@dataclass(frozen=True, slots=True)
class Inspection:
    """What poses can tell."""

    model: ErrorModel  # The error model
    observability: Observability  # Rank and combinations at the nominal robot
    poses: int  # How many there are
    source: str | None  # The table that they are from; None: spread over the joint limits
    assumed: tuple[str, ...] = ()  # What was put at a generic place, ``"target"`` or ``"anchor"``


def inspect(robot: Robot, cell: Cell, measurements: Measurements | None = None) -> Inspection:
    """Rank of the cell's model at the nominal robot; ``"auto"`` is looked at as ``"dh"``.

    Judged are a table's estimation poses, with the target registered, or else 200 over the joint limits, with a target
    or anchor that is not given at a generic place.
    """
    assumed = []
    if measurements is None:
        table = table_of_poses(robot, cell.kind or "point", spread_poses(robot))
        rows, setup = rows_of(robot, table, cell)
        frames, targets = setup.T_frame_base.copy(), setup.T_tip_target.copy()
        if not np.all(setup.target_given):
            targets[:, :3, 3] = GENERIC_TARGET
            assumed.append("target")
        if any(kind.name == "distance" for kind in rows.present) and not np.all(setup.frame_given):
            frames[:, :3, 3] = np.negative(GENERIC_ANCHOR)
            assumed.append("anchor")
        setup = setup.placed(frames, targets)
        rows = rows.as_measured_at(setup.seen(robot.poses(rows.joints), rows.samples))
    else:
        rows, setup = rows_of(robot, measurements, cell)
        rows = rows.select(measurements.estimation)
        setup = register(robot.poses(rows.joints), setup, rows)
    name = cell.model if cell.model != AUTO else "dh"
    model = setup.aligned(model_of(Task(robot, cell, setup, name)))
    kinematics = Kinematics(robot, model, setup.T_frame_base, setup.T_tip_target)
    problem = Problem.first(kinematics, rows, known_distances(cell, setup))
    seen_by = problem.observability(np.zeros(len(model)))
    source = None if measurements is None else measurements.source
    return Inspection(model, seen_by, len(rows), source, tuple(assumed))


def table_of_poses(robot: Robot, name: str, joints: Array) -> Measurements:
    """A table of a kind of free poses, of which only poses, (N, m), [rad] or [m], and targets count."""
    kind, somewhere = registry.get(name), np.tile(np.eye(4), (len(joints), 1, 1))
    if kind.paired or kind.measure is None:
        raise ModelError(f"Poses alone say nothing of kind '{name}'. Give a table of such rows.")
    somewhere[:, :3, 3] = 1.0
    return Measurements(
        joint_names=robot.joint_names,
        joints=joints,
        kinds=(name,) * len(joints),
        **Measurements.columns_of(kind, kind.measure(somewhere)),
        prismatic=tuple(joint.name for joint in robot.inputs if joint.type == "prismatic"),
    )
