"""auto: how much model the data support, decided by the data.

Every candidate is fitted with prior sizes and noise by restricted likelihood, with the same weights of the rows, for
outliers and for repeats, so that likelihoods can be compared: a candidate that adds errors the data do not show gains
nothing, whatever its number of parameters. One step up the ladder must gain `_STEP` in log likelihood, and must not be
worse on left-out rows.

The geometry (frames only, zeros, DH, Hayati, full placement) is chosen first: it alone goes into a URDF. The families
that no URDF can hold (`calib.model.families`) are then added to it one by one, as long as one of them passes.
What they left over may have hidden a larger geometry: with one of them found, the sets above are asked again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.errors import MeasurementError, ModelError, choices
from calib.estimate.crossvalidation import linear_cross_validation
from calib.estimate.fitting import Fitted, Task, fit, model_of
from calib.estimate.rows import Rows
from calib.estimate.statistics import CrossValidation
from calib.model.families import FAMILIES, joint_families

Array = NDArray[np.float64]

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
    # Errors on left-out rows, on the linearised problem; of the rows that have a weight, where errors are without
    # outliers
    cross_validation: CrossValidation
    sizes: dict[str, float]  # Size of the errors of each family
    chosen: str = ""  # ``"geometry"``, ``"larger"`` or ``""``
    needed: float = _STEP  # What it had to gain over a smaller one in log likelihood


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """What `select` chose."""

    geometry: str  # Name of the set that goes into the URDF
    larger: str  # Name of the larger model; "" where the data support none
    candidates: tuple[Candidate, ...]  # All that were fitted, in order
    common: Fitted  # The fit that the weights are from, with weights of its own


def select(task: Task, rows: Rows) -> Selection:
    """Choose geometry and larger model for some rows.

    Raises:
        ModelError: The cell names a parameter that no model of the ladder has.
        MeasurementError: Too few rows.
    """
    _check_names(task)
    task = replace(task, lenient=True)
    common = _common(task, rows)
    weights = common.estimate.problem.weights
    tried: dict[str, Candidate] = {}
    # Without priors the likelihood would be that of errors of metres: then left-out rows alone decide.
    step = _STEP * (1.0 + _FEW / max(rows.count - task.setup.count, 1))
    off = task.cell.priors.sizes == "off"

    def better(one: Candidate, than: Candidate) -> bool:
        """Whether the data support a larger candidate in place of a smaller one."""
        # Each row in units of its own scale would let one instrument decide; lengths and angles are asked one by one.
        a, b = (c.cross_validation.errors_without_outliers for c in (one, than))
        share = _CLEARLY if off else 1.0
        lower = a.rms <= share * b.rms or (b.n_angle and a.rms_angle <= share * b.rms_angle)
        return bool(lower and (off or one.log_likelihood >= than.log_likelihood + step))

    def candidate(name: str) -> Candidate | None:
        if name in tried:
            return tried[name]
        try:
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
        )
        return tried[name]

    best: Candidate | None = None
    geometries: list[str] = []
    seen: set[tuple[str, ...]] = set()
    for name in LADDER:
        columns = model_of(replace(task, model=name)).names
        if not columns or columns in seen:
            continue  # nothing to estimate, or the same as before: hayati without near-parallel axes is dh
        seen.add(columns)
        geometries.append(name)
        one = candidate(name)
        if one is not None and (best is None or better(one, best)):
            best = one
    assert best is not None, "the weights are of a model that there are enough rows for"
    geometry = best
    load = rows.samples.load
    loaded = load is not None and bool(np.max(np.abs(load), initial=0.0) > _NO_LOAD)
    families = [f for f in joint_families() if loaded or not FAMILIES[f].loaded]
    while True:
        names = _steps(best.name, geometries, families)
        passed = [c for c in map(candidate, names) if c is not None and better(c, best)]
        if not passed:
            break
        best = max(passed, key=lambda one: one.log_likelihood)
    larger = best.name if best is not geometry else ""
    marks = {geometry.name: "geometry", larger: "larger"}
    return Selection(
        geometry.name,
        larger,
        tuple(replace(c, chosen=marks.get(c.name, ""), needed=step) for c in tried.values()),
        common,
    )


def _steps(name: str, geometries: list[str], families: list[str]) -> list[str]:
    """The models one step up from a model: one family more and, with any family in it, a larger geometry."""
    geometry, *has = name.split("+")
    larger = geometries[geometries.index(geometry) + 1 :] if has else []
    more = [f for f in families if f not in has]
    return [*(f"{name}+{f}" for f in more), *("+".join([g, *has]) for g in larger)]


def _common(task: Task, rows: Rows) -> Fitted:
    """The fit that the weights are from, repeats shared out: of the largest geometry that there are enough rows for.

    What a smaller model leaves over is shared by the repeats of a pose. Weights of its own would thus let it answer for
    fewer numbers than a larger one, and their likelihoods would be those of different data.
    """
    # Rows are enough for any model that its priors hold; without priors for one of as many parameters at most.
    enough = [
        name
        for name in LADDER
        if task.cell.priors.sizes != "off" or len(model_of(replace(task, model=name))) <= rows.count
    ]
    return fit(replace(task, model=enough[-1] if enough else LADDER[0]), rows)


def _check_names(task: Task) -> None:
    """Refuse names in the cell that no model of the ladder has."""
    if not (task.cell.frozen or task.cell.ties or task.cell.bounds or task.cell.parameter_priors):
        return
    cell = replace(task.cell, frozen=(), ties={})
    every = "+".join(("placement", *joint_families()))
    tasks = [replace(task, cell=cell, model=one) for one in (every, "dh", "hayati", "zeros")]
    known = {name for one in tasks for name in model_of(one).names}
    named = {*task.cell.frozen, *task.cell.bounds, *task.cell.parameter_priors, *task.cell.ties}
    strange = sorted(({other for other, _ in task.cell.ties.values()} | named) - known)
    if strange:
        raise ModelError(
            f"No model has the parameters {choices(strange)}. 'calib inspect --model dh' (or another) lists what there "
            "is."
        )
