"""auto: how much model the data support, decided by the data.

Every candidate is fitted by restricted likelihood with the same weights of the rows. A step up the ladder must gain
`_STEP` in log likelihood, and must not be worse on left-out rows. The geometry is chosen first; then the families that
no URDF can hold are added one by one, and with one of them found, the larger sets are asked again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.errors import MeasurementError, ModelError, choices
from calib.estimate.crossvalidation import linear_cross_validation
from calib.estimate.fitting import Fitted, Task, fit, model_of
from calib.estimate.rows import Rows
from calib.estimate.statistics import CrossValidation
from calib.model.families import FAMILIES, joint_families

#: The geometries, from the smallest to the largest.
LADDER = ("frames", "zeros", "dh", "hayati", "placement")

#: What a step to a larger model must gain in restricted log likelihood. By chance, with no error of the added family
#: there, twice the gain follows half a chi-squared distribution of one degree of freedom: fewer than 1 in 1,000 pass.
#: With few numbers its tail is heavier, and a step must gain more: `_STEP` (1 + `_FEW` / numbers left).
_STEP, _FEW = 5.0, 20.0

#: Without priors a larger candidate must lower errors on left-out rows to this share.
_CLEARLY = 0.95

#: A load below this on every joint moves nothing [Nm, N].
_NO_LOAD = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One model on the ladder."""

    name: str  # Its set and families
    parameters: int  # Number of parameters
    log_likelihood: float  # Restricted log likelihood
    cross_validation: (
        CrossValidation  # On the linearised problem; "outliers" are the rows without weight
    )
    sizes: dict[str, float]  # Size of the errors of each family
    chosen: str = ""  # ``"geometry"``, ``"larger"`` or ``""``
    needed: float = _STEP  # What it had to gain over a smaller one in log likelihood


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """What `select` chose."""

    geometry: str  # Name of the set that goes into the URDF
    larger: str  # Name of the non-geometric model; "" where the data support none
    candidates: tuple[Candidate, ...]  # All that were fitted, in order
    common: Fitted  # The fit that the weights are from, with weights of its own


def select(task: Task, rows: Rows) -> Selection:
    """Choose geometry and larger model for some rows; `ModelError` for a name in the cell that no model has."""
    _check_names(task)
    task, off = replace(task, lenient=True), task.cell.priors.sizes == "off"
    models = {name: model_of(replace(task, model=name)).names for name in LADDER}
    # The weights, repeats shared out, are those of the largest geometry that there are enough rows for: what a smaller
    # one leaves over is shared by the repeats of a pose, and with weights of its own it would answer for fewer numbers.
    enough = [name for name in LADDER if not off or len(models[name]) <= rows.count]
    common = fit(replace(task, model=(enough or LADDER[:1])[-1]), rows)
    step = _STEP * (1.0 + _FEW / max(rows.count - task.setup.count, 1))
    tried: dict[str, Candidate] = {}

    def candidate(name: str) -> Candidate | None:
        if name in tried:
            return tried[name]
        try:
            weights = common.estimate.problem.weights
            fitted = fit(replace(task, model=name), rows, weights, common.setup)
        except MeasurementError:
            return None  # more parameters than numbers, and no priors
        tried[name] = Candidate(
            name=name,
            parameters=len(fitted.kinematics.model),
            log_likelihood=fitted.estimate.log_likelihood,
            # Rows without weight are the same for all candidates; what each flags by itself is not.
            cross_validation=linear_cross_validation(fitted, fitted.estimate.weights <= 0.0),
            sizes=dict(fitted.estimate.sizes),
            needed=step,
        )
        return tried[name]

    def better(one: Candidate, than: Candidate) -> bool:
        """Whether the data support a larger candidate; without priors left-out rows alone decide."""
        # Each row in units of its own scale would let one instrument decide; lengths and angles are asked one by one.
        a, b = (c.cross_validation.errors_without_outliers for c in (one, than))
        share = _CLEARLY if off else 1.0
        lower = a.rms <= share * b.rms or (b.n_angle and a.rms_angle <= share * b.rms_angle)
        return bool(lower and (off or one.log_likelihood >= than.log_likelihood + step))

    best: Candidate | None = None
    # Those with something to estimate, once each: hayati without near-parallel axes is dh.
    first = {columns: name for name, columns in reversed(models.items()) if columns}
    geometries = [name for name in LADDER if name in first.values()]
    for one in map(candidate, geometries):
        if one is not None and (best is None or better(one, best)):
            best = one
    assert best is not None, "the weights are of a model that there are enough rows for"
    geometry, load = best, rows.samples.load
    loaded = load is not None and bool(np.max(np.abs(load), initial=0.0) > _NO_LOAD)
    families = [f for f in joint_families() if loaded or not FAMILIES[f].loaded]
    while True:
        # One family more and, with any family in it, a larger geometry.
        base, *has = best.name.split("+")
        wider = geometries[geometries.index(base) + 1 :] if has else []
        names = [f"{best.name}+{f}" for f in families if f not in has]
        names += ["+".join([one, *has]) for one in wider]
        passed = [c for c in map(candidate, names) if c is not None and better(c, best)]
        if not passed:
            break
        best = max(passed, key=lambda one: one.log_likelihood)
    larger = best.name if best is not geometry else ""
    marks = {geometry.name: "geometry", larger: "larger"}
    candidates = tuple(replace(c, chosen=marks.get(c.name, "")) for c in tried.values())
    return Selection(geometry.name, larger, candidates, common)


def _check_names(task: Task) -> None:
    """Refuse names in the cell that no model of the ladder has."""
    cell = task.cell
    named = {*cell.frozen, *cell.bounds, *cell.parameter_priors, *cell.ties}
    named |= {other for other, _ in cell.ties.values()}
    if not named:
        return
    every = "+".join(("placement", *joint_families()))
    free = replace(task, cell=replace(cell, frozen=(), ties={}))
    known = {n for m in (every, *LADDER[1:4]) for n in model_of(replace(free, model=m)).names}
    strange = sorted(named - known)
    if strange:
        raise ModelError(
            f"No model has the parameters {choices(strange)}. 'calib inspect --model dh' (or another) lists what there "
            "is."
        )
