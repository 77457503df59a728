"""Auto: how much model the data support.

Every candidate is fitted by restricted likelihood, with the same weights of the rows: those of one fit, the *judge*. At
first this is the fit of the largest model, then that of the model which its weights choose. The geometry for the URDF
is the candidate of the highest evidence without families of the joints, unless errors on held-out rows contradict.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calib.errors import MeasurementError, ModelError, choices
from calib.estimate.fitting import Fitted, Task, fit, model_of
from calib.model.families import family_of, joint_families
from calib.model.joint_errors import joint_displacements, joint_parameters
from calib.numerics.errors import CrossValidation
from calib.registration.rows import Rows
from calib.robot.robot import read_only
from calib.selection.cross_validation import chance_of_fall, linear_cross_validation, pose_errors
from calib.units import Array

#: The geometries, from the smallest to the largest.
LADDER = ("frames", "zeros", "dh", "hayati", "placement")

#: What a model pays, in restricted log likelihood. The size of a family's errors is an unknown too, and the likelihood
#: is maximised over it. By Laplace's approximation that costs the logarithm of its prior range, a few powers of ten,
#: over the factor within which the data determine it. Of sets with the same sizes the smaller is a priori likelier.
_SIZE_COSTS, _RUNG_COSTS = 2.5, 1.0

#: Errors on held-out rows are clearly smaller where they are smaller by this share. Without priors this is also by how
#: much each further set or family must lower them.
_CLEARLY = 0.05

#: Strong evidence: odds of 20 to 1.
_STRONG = float(np.log(20.0))

#: Held-out errors contradict the evidence where the p-value of their fall is below this.
_CHANCE = 0.1

#: The same where the evidence is strong.
_CHANCE_IF_STRONG = 0.01

#: With fewer poses evidence alone decides: held-out errors of non-geometric models are too small, because the sizes
#: of the errors are estimated from all poses.
_FEWEST_POSES = 16

#: An error moves no joint if one unit of it moves each by less than this [rad, m].
_NO_MOTION = 1e-6

#: A family whose estimated size is below this share of its prior is left out at once.
_NO_SIZE = 1e-2

#: The most other models that are tried where refits without each fold reject the chosen one: each is another chance for
#: a bad one to pass.
_ALTERNATIVES = 3

#: How often weights are found anew with the model that the last ones chose.
_JUDGED = 2

#: About how many rows choose the model.
_CHOSEN_BY = 2000


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One model that was tried."""

    name: str  # Its set and families
    parameters: int  # Number of parameters
    log_likelihood: float  # Restricted log likelihood
    cross_validation: CrossValidation  # On the linearised problem; outliers: rows without weight
    prior_std: dict[str, float]  # Size of the errors of each family
    evidence: float  # Log likelihood less the costs of the model; without priors the fall of held-out errors, in steps
    chosen: str = ""  # ``"geometry"``, ``"non_geometric"`` or ``""``


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """What `select` chose."""

    geometry: str  # Name of the set that goes into the URDF
    non_geometric: str  # Name of the non-geometric model; "" where the data support none
    candidates: tuple[Candidate, ...]  # All that were fitted, in order
    judge: Fitted  # The fit of the non-geometric model, or of the geometry where there is none, with its own weights


def select(task: Task, rows: Rows) -> Selection:
    """Choose geometry and non-geometric model for some rows; `ModelError` for a name in the cell that no model has.

    The search begins with the largest model, whose priors shrink what the data do not support to nothing, and moves
    to neighbours of higher evidence: one family less or more, another set, or one family for another. Of many rows a
    part is used.
    """
    check_names(task)
    every, rows = rows, rows.select(rows.evenly(_CHOSEN_BY))
    task = replace(task, lenient=True)
    models = {name: model_of(replace(task, model=name)).names for name in LADDER}
    # Those with something to estimate, once each: hayati without near-parallel axes is dh.
    first = {columns: name for name, columns in reversed(models.items()) if columns}
    geometries = tuple(name for name in LADDER if name in first.values())
    families = tuple(f for f in joint_families() if _moves(task, f, rows))
    if task.cell.priors.source == "off":  # then there must be enough rows
        enough = [name for name in geometries if len(models[name]) <= rows.count]
        start = (enough or geometries[:1])[-1]
    else:
        start = "+".join((geometries[-1], *families))
    judge = fit(replace(task, model=start), rows)
    rows = judge.estimate.problem.rows
    start = without_vanished(start, judge.estimate.prior_std)
    chosen = _searched(_Search(task, rows, judge, geometries, families), start)
    search, geometry, best, judge = chosen
    if len(rows) < len(every):
        judge = fit(replace(task, model=best), every, started=judge.setup)
    non_geometric = best if "+" in best else ""
    return Selection(
        geometry, non_geometric, marked(search.tried.values(), geometry, non_geometric), judge
    )


def _searched(search: _Search, start: str) -> tuple[_Search, str, str, Fitted]:
    """Search until the weights of the chosen model choose it again, or the judge explains more rows than it does.

    Returns:
        The last search, the names of the geometry and of the chosen model, and the fit of the latter.
    """
    for last in range(_JUDGED - 1, -1, -1):
        best, geometry = search.highest(start), search.geometry()
        best = search.non_geometric(best, geometry) if "+" in best else geometry
        task, judge = replace(search.task, model=best), search.judge
        found = fit(task, search.rows, started=judge.setup)
        if explains_more(judge, found):
            return search, geometry, best, fit(task, search.rows, judge=judge)
        if not last or np.array_equal(found.estimate.outliers, judge.estimate.outliers):
            break
        search, start = replace(search, judge=found, tried={}), best
    return search, geometry, best, found


def explains_more(judge: Fitted, found: Fitted) -> bool:
    """Whether the judge explains rows that a fit calls outliers: a small model may look good because it drops them.

    This is so where the judge's outliers are a proper subset of those of the fit, and, with only these set aside, the
    judge predicts held-out rows better.
    """
    outliers = found.estimate.outliers, judge.estimate.outliers
    aside = outliers[0] & outliers[1]
    if np.array_equal(aside, outliers[0]) or not np.array_equal(aside, outliers[1]):
        return False
    errors = [linear_cross_validation(f, aside).errors_without_outliers for f in (found, judge)]
    of_found, of_judge = (e.rms if e.n else e.rms_angle for e in errors)
    return of_judge < of_found


def marked(
    candidates: Iterable[Candidate], geometry: str, non_geometric: str
) -> tuple[Candidate, ...]:
    """The candidates with what each is chosen for.

    Args:
        candidates: All that were fitted.
        geometry: Name of the one for the URDF.
        non_geometric: Name of the non-geometric model; empty where there is none.
    """
    uses = {geometry: "geometry", non_geometric: "non_geometric"}
    return tuple(replace(c, chosen=uses.get(c.name, "")) for c in candidates)


def alternatives(candidates: Iterable[Candidate]) -> tuple[str, ...]:
    """Non-geometric models to try where refits reject the chosen one, the highest evidence first.

    Each has more evidence than the chosen geometry, and smaller errors on held-out rows of the linearised problem. Of
    models that differ only by families of vanishing size, one is taken.

    Args:
        candidates: All that were fitted, marked with what they are chosen for.
    """
    ordered = sorted(candidates, key=lambda c: c.evidence, reverse=True)
    (geometry,) = (c for c in ordered if c.chosen == "geometry")
    effective = {c.name: without_vanished(c.name, c.prior_std) for c in ordered}
    seen = {effective[c.name] for c in ordered if c.chosen}
    names = []
    for c in ordered:
        better = c.evidence > geometry.evidence and _held_out(c) < _held_out(geometry)
        if better and effective[c.name] not in seen:
            names.append(c.name)
            seen.add(effective[c.name])
    return tuple(names[:_ALTERNATIVES])


def _held_out(candidate: Candidate) -> float:
    """The error of a candidate on held-out rows, [m], or [rad] where no length was measured."""
    errors = candidate.cross_validation.errors_without_outliers
    return errors.rms if errors.n else errors.rms_angle


def without_vanished(name: str, prior_std: Mapping[str, float]) -> str:
    """The name of a model without the families whose errors the data shrink to nothing.

    Args:
        name: Of the set, with families behind it.
        prior_std: Estimated standard deviation of the errors of each family, in its unit; empty without priors.
    """
    base, *families = name.split("+")
    return "+".join((base, *(f for f in families if not _vanished(f, prior_std))))


def _vanished(family: str, prior_std: Mapping[str, float]) -> bool:
    """Whether the estimated size of a family's errors is next to nothing."""
    return prior_std.get(family, np.inf) <= _NO_SIZE * family_of(family).prior


def judged_by(own: Fitted, rows: Rows, judge: Fitted) -> Fitted:
    """The fit, with its own weights or those of the judge, whichever predict held-out rows better.

    Where a model lacks something, its residuals at some good rows may be far larger than at others. Rows that both fits
    call outliers are set aside; if the judge itself predicts rows better, no other rows are outliers.
    """
    other, by_judge = fit(own.task, rows, judge=judge), judge.estimate
    aside = own.estimate.outliers & by_judge.outliers
    errors = [
        linear_cross_validation(f, aside).errors_without_outliers for f in (own, other, judge)
    ]
    before, after, judged = (e.rms if e.n else e.rms_angle for e in errors)
    found = other if after < before else own
    estimate = found.estimate
    scores = np.minimum(
        estimate.scores, by_judge.scores * estimate.flag_limit / by_judge.flag_limit
    )
    scores = read_only(scores if judged < before else estimate.scores)
    return replace(found, estimate=replace(estimate, scores=scores))


def widest(own: Fitted, rows: Rows) -> Fitted:
    """The fit of a geometry with all families of non-geometric errors that the rows can determine."""
    task = own.task
    families = [f for f in joint_families() if _moves(task, f, rows)]
    task = replace(task, model="+".join((str(task.model), *families)), lenient=True)
    return fit(task, rows, started=own.setup)


@dataclass(frozen=True, slots=True, eq=False)
class _Search:
    """The search among models, each fitted once to some rows with the weights of one judge."""

    task: Task  # Whose model is chosen
    rows: Rows  # By which it is chosen
    judge: Fitted  # Whose weights of the rows are used
    geometries: tuple[str, ...]  # The sets, from the smallest to the largest
    families: tuple[str, ...]  # Those that the rows can determine
    tried: dict[str, Candidate] = field(default_factory=dict)  # Those that were fitted, in order

    def highest(self, start: str) -> str:
        """The model that no neighbour and no geometry exceeds in evidence.

        Args:
            start: Name of the model to begin with.
        """
        best = self._climbed(start)
        geometry = max(self.geometries, key=self.evidence)
        return best if self.evidence(best) >= self.evidence(geometry) else self._climbed(geometry)

    def geometry(self) -> str:
        """The set for the URDF. Without priors the evidence already is that of held-out errors."""
        fitted = [self.tried[name] for name in self.geometries if self._fits(name)]
        if self.task.cell.priors.source == "off":
            return max(fitted, key=lambda c: c.evidence).name
        estimate = self.judge.estimate
        scales, kept = estimate.problem.scales, self.rows.checked & (estimate.weights > 0.0)
        return preferred(fitted, [pose_errors(c.cross_validation, scales, kept) for c in fitted])

    def non_geometric(self, best: str, geometry: str) -> str:
        """The model of the highest evidence that predicts held-out rows better than the geometry; else the geometry."""
        if self.task.cell.priors.source == "off":
            return best
        limit = _held_out(self.tried[geometry])
        better = [c for c in self.tried.values() if "+" in c.name and _held_out(c) < limit]
        found = max(better, key=lambda c: c.evidence, default=self.tried[geometry])
        return found.name if found.evidence > self.tried[geometry].evidence else geometry

    def evidence(self, name: str) -> float:
        """The evidence for a model; none where without priors the rows are too few for its parameters."""
        return self.tried[name].evidence if self._fits(name) else -np.inf

    def _climbed(self, start: str) -> str:
        """The model that no neighbour exceeds: one family less or more, another set, or one family for another."""
        best = max((start, *self._steps(start)), key=self.evidence)
        if best == start:
            best = max((start, *self._swaps(start)), key=self.evidence)
        return start if best == start else self._climbed(best)

    def _steps(self, name: str) -> list[str]:
        """The models with one family less or more, and with another set."""
        base, *has = name.split("+")
        near = [self._named(base, {*has} ^ {family}) for family in self.families]
        return near + [self._named(other, has) for other in self.geometries if other != base]

    def _swaps(self, name: str) -> list[str]:
        """The models with one family in place of another, for families whose size does not vanish beside all of them.

        The likelihood is maximised over the sizes, so a family that vanishes beside the others cannot replace one.
        """
        base, *has = name.split("+")
        swaps = []
        for new in self.families:
            more = self._named(base, {*has, new})
            if (
                new not in has
                and self._fits(more)
                and not _vanished(new, self.tried[more].prior_std)
            ):
                swaps += [self._named(base, {*has, new} - {old}) for old in has]
        return swaps

    def _named(self, base: str, families: Iterable[str]) -> str:
        """The name of a set with families, in their fixed order."""
        chosen = set(families)
        return "+".join((base, *(f for f in self.families if f in chosen)))

    def _fits(self, name: str) -> bool:
        """Whether the rows are enough for a model, which is fitted unless it was tried before."""
        if name not in self.tried:
            try:
                fitted = fit(replace(self.task, model=name), self.rows, judge=self.judge)
            except MeasurementError:
                return False
            self.tried[name] = _candidate(fitted)
        return True


def _candidate(fitted: Fitted) -> Candidate:
    """The candidate that a fit with the judge's weights makes of its model."""
    name, estimate, prior_std = (
        str(fitted.task.model),
        fitted.estimate,
        fitted.task.cell.priors.source,
    )
    # Rows without weight are the same for all candidates, unlike those that each would flag itself.
    held_out = linear_cross_validation(fitted, estimate.weights <= 0.0)
    base, *has = name.split("+")
    rung = LADDER.index(base)
    if prior_std == "off":
        e = held_out.errors_without_outliers
        found = [x for n, x in ((e.n, e.rms), (e.n_angle, e.rms_angle)) if n]
        evidence = -float(np.mean(np.log(found))) / _CLEARLY - rung - len(has)
    else:
        cost = _SIZE_COSTS * len(estimate.prior_std) if prior_std == "data" else 0.0
        evidence = estimate.log_likelihood - cost - _RUNG_COSTS * rung
    return Candidate(
        name=name,
        parameters=len(fitted.kinematics.model),
        log_likelihood=estimate.log_likelihood,
        cross_validation=held_out,
        prior_std=dict(estimate.prior_std),
        evidence=evidence,
    )


def preferred(candidates: Sequence[Candidate], errors: Sequence[Array]) -> str:
    """The name of the candidate with the highest evidence that held-out poses do not contradict.

    They do where the mean error of another one is smaller by `_CLEARLY`, and that beyond chance: with a probability of
    less than `_CHANCE`, or than `_CHANCE_IF_STRONG` where there is strong evidence against the other one.

    Args:
        candidates: One or more models of the same rows.
        errors: Of each, the held-out error of each pose, shape (poses,), in one unit.
    """
    pairs = list(zip(candidates, errors, strict=True))
    best, of_best = max(pairs, key=lambda pair: pair[0].evidence)
    while len(of_best) >= _FEWEST_POSES:
        clearly_better = []
        for other, of_other in pairs:
            strong = best.evidence - other.evidence > _STRONG
            chance = chance_of_fall(of_best - of_other)
            smaller = np.mean(of_other) < (1.0 - _CLEARLY) * np.mean(of_best)
            if smaller and chance < (_CHANCE_IF_STRONG if strong else _CHANCE):
                clearly_better.append((other, of_other))
        if not clearly_better:
            break
        best, of_best = min(clearly_better, key=lambda pair: float(np.mean(pair[1])))
    return best.name


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
