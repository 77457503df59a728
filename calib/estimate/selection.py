"""Auto: how much model the data support.

Every candidate is fitted by restricted likelihood with the same weights of the rows, those of the model that is the
best: it begins with the largest one. The geometry for the URDF is the best of those without other families.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from calib.errors import MeasurementError, ModelError, choices
from calib.estimate.cross_validation import linear_cross_validation
from calib.estimate.fitting import Fitted, Task, fit, model_of
from calib.estimate.setup import Rows
from calib.estimate.statistics import CrossValidation
from calib.model.error_model import joint_parameters
from calib.model.families import family_of, joint_families
from calib.model.kinematics import joint_displacements
from calib.robot.robot import read_only

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
