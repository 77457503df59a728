"""Candidates: the models that may be fitted to a table, and how those compare that were.

A model is named by its geometry, a rung of the ladder from the smallest to the largest, and, after plus signs, its
families of non-geometric errors: ``"dh+compliance"``. All candidates are fitted to the same rows with the same weights.
The evidence of one is its restricted log-likelihood less a penalty for what it has to estimate. Without priors there is
no such likelihood; then it is minus the logarithm of the error on held-out rows, in steps of `CLEARLY`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from calib.basics.arrays import Array
from calib.basics.values import keep_read_only
from calib.errors import ModelError, choices
from calib.fit.estimate.fitting import Fitted
from calib.fit.estimate.task import Task
from calib.fit.registration.rows import Rows
from calib.fit.selection.cross_validation import linear_cross_validation
from calib.model.families import family_of, joint_families
from calib.model.joint_errors import joint_displacements, joint_parameters
from calib.model.parameter_sets import OF_ONE_CHAIN
from calib.numerics.errors import CrossValidation

#: The geometries, from the smallest to the largest.
LADDER = ("frames", "zeros", "dh", "hayati", "placement")

#: A family moves no joint if one unit of its errors moves each by less than this [rad, m].
_NO_MOTION = 1e-6

#: Cosine of the effects of two families above which nothing but their priors tells them apart.
_ALIKE = 0.99

#: Penalty of an estimated prior standard deviation, in log-likelihood, which is maximised over it. By Laplace's
#: approximation it costs the logarithm of its prior range, a few powers of ten, over the factor within which the data
#: determine it.
_PRIOR_STD_COST = 2.5

#: Penalty of each step up the ladder of geometries, in log-likelihood: the smaller geometry is likelier a priori.
_RUNG_COST = 1.0

#: Errors on held-out rows are clearly smaller if they are smaller by this share. Without priors each further geometry
#: or family must lower them by as much.
CLEARLY = 0.05

#: The errors of a family have vanished if their estimated standard deviation is below this share of the prior's.
_VANISHED = 1e-2

#: The most alternatives that are tried if refits without each fold reject the chosen non-geometric model: each is
#: another chance for a bad one to pass.
_MOST_ALTERNATIVES = 3


def model_name(geometry: str, families: tuple[str, ...]) -> str:
    """Return the name of a geometry of the ladder with families: ``"dh+gain"`` of ``"dh"`` and ``("gain",)``."""
    return "+".join((geometry, *families))


def geometry_parameters(task: Task) -> dict[str, int]:
    """List the geometries that differ for a robot and have something to estimate.

    Of geometries with the same parameters the smaller is taken: without near-parallel axes ``"hayati"`` is ``"dh"``.

    Args:
        task: The fit, with any model.

    Returns:
        Number of parameters, frames and targets included, by the geometry's name, in the order of the ladder.
    """
    counts: dict[str, int] = {}
    listed = set()
    for geometry in LADDER:
        if task.robot.is_tree and geometry in OF_ONE_CHAIN:
            continue
        names = replace(task, model=geometry).error_model().names
        if names and names not in listed:
            listed.add(names)
            counts[geometry] = len(names)
    return counts


def determinable_families(task: Task, rows: Rows) -> tuple[str, ...]:
    """List the families of non-geometric errors that the rows can tell from the geometry and from earlier families.

    A family that moves no joint differently from row to row is left out, such as compliances if the URDF states no
    masses, or lost motion if every pose was approached from one side; one that moves each joint as a family before it
    does, such as creep if all last moves were of one length; and one of more errors than the rows have numbers, which
    would fit any residuals: those of gravity grow with the square of the joints.

    Args:
        task: The fit, with any model.
        rows: The rows that are fitted, with the loads on the joints.

    Returns:
        Names of the families, in the order of the registry.
    """
    robot, samples = task.robot, rows.samples
    patterns: dict[str, Array] = {}
    for family in joint_families():
        terms = joint_parameters(robot, family, task.cell.gravity)
        if not 0 < len(terms) <= rows.count:
            continue
        moves_joints = False
        patterns_on_chains = []
        for number, chain in enumerate(robot.chains):
            of_chain = samples.rows_of_chain(number)
            if not len(of_chain):
                continue
            seen = samples.select(of_chain)
            displacements = joint_displacements(
                chain, terms, seen.q, seen.load, seen.moves, loaded=robot
            )
            moves_joints |= bool(np.any(np.ptp(displacements, axis=0) > _NO_MOTION))
            patterns_on_chains.append(displacements.reshape(-1, len(terms)))
        if not moves_joints:
            continue
        pattern = np.concatenate(patterns_on_chains)
        if not any(_are_alike(pattern, earlier) for earlier in patterns.values()):
            patterns[family] = pattern
    return tuple(patterns)


def _are_alike(A: Array, B: Array) -> bool:
    """Return whether each column of a matrix points as that of another one, by a cosine of at least `_ALIKE`."""
    if A.shape != B.shape:
        return False
    products = np.sum(A * B, axis=0)
    return bool(np.all(products >= _ALIKE * np.linalg.norm(A, axis=0) * np.linalg.norm(B, axis=0)))


def check_parameter_names(task: Task) -> None:
    """Refuse names of parameters in the cell that no model of the ladder has.

    Args:
        task: The fit, with any model.

    Raises:
        ModelError: There are such names; it lists them.
    """
    cell = task.cell
    leaders = (leader for leader, _ in cell.ties.values())
    named = {*cell.frozen, *cell.bounds, *cell.parameter_priors, *cell.ties, *leaders}
    if not named:
        return
    without_frozen = replace(task, cell=replace(cell, frozen=(), ties={}))
    largest = model_name("placement", joint_families())
    known = set()
    others = ("zeros",) if task.robot.is_tree else ("zeros", "dh", "hayati")
    for model in (largest, *others):
        known |= {*replace(without_frozen, model=model).error_model().names}
    urdf = task.robot.urdf
    known |= {*cell.frozen} & {*urdf.links, *(joint.name for joint in urdf.joints)}
    unknown = sorted(named - known)
    if unknown:
        raise ModelError(
            f"No model has the parameters {choices(unknown)}; 'calib inspect --model dh' lists those of one."
        )


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A model that was fitted during the search."""

    #: Its geometry and families, such as ``"dh+gain"``
    name: str
    #: Number of parameters
    parameters: int
    #: Restricted log-likelihood
    log_likelihood: float
    #: On the linearised problem; as outliers count the rows to which the reference fit gives no weight
    cross_validation: CrossValidation
    #: Estimated std of the errors of each family, in its unit; empty without priors
    prior_std: Mapping[str, float]
    #: Penalised log-likelihood; without priors the fall of held-out errors, in steps
    evidence: float
    #: ``"geometry"``, ``"non_geometric"`` or ``""``
    chosen: str = ""

    def __post_init__(self) -> None:
        """Keep a read-only copy of the mapping."""
        keep_read_only(self, "prior_std")


def assess(fitted: Fitted) -> Candidate:
    """Cross-validate a model that was fitted, and weigh the evidence for it.

    With priors the evidence is log L - c_k k - c_g g - c_f, with the restricted log-likelihood log L, for k prior
    standard deviations that are estimated from the data (0 if they are kept as given) and the geometry's rung g on the
    ladder, from 0, with the penalties c_k and c_g of each, and the rarity c_f of its families. Without priors it is
    -log(rms) / `CLEARLY` - g - f, where log(rms) of held-out errors is the mean over the units that were measured, and
    f the number of families.

    Args:
        fitted: A named model, fitted with the weights of the reference fit.

    Returns:
        The candidate, not marked as chosen.

    Raises:
        MeasurementError: All rows are of one pose.
    """
    estimate = fitted.estimate
    priors = fitted.task.cell.priors.source
    # Rows without weight are the same for all candidates, unlike those that each would flag itself.
    validation = linear_cross_validation(fitted, estimate.weights <= 0.0)
    geometry, *families = str(fitted.task.model).split("+")
    rung = LADDER.index(geometry)
    if priors == "off":
        errors = validation.errors_without_outliers
        mean_log_error = float(np.mean([np.log(errors[unit].rms) for unit in errors.units]))
        evidence = -mean_log_error / CLEARLY - rung - len(families)
    else:
        cost = _PRIOR_STD_COST * len(estimate.prior_std) if priors == "data" else 0.0
        cost += sum(family_of(family).rarity for family in families)
        evidence = estimate.log_likelihood - cost - _RUNG_COST * rung
    return Candidate(
        name=str(fitted.task.model),
        parameters=len(fitted.kinematics.model),
        log_likelihood=estimate.log_likelihood,
        cross_validation=validation,
        prior_std=dict(estimate.prior_std),
        evidence=evidence,
    )


def held_out_rms(validation: CrossValidation) -> float:
    """Return the rms error on held-out rows, outliers aside, in the first unit measured: [m] if any length was."""
    return validation.errors_without_outliers.leading.rms


def mark_chosen(
    candidates: Iterable[Candidate], geometry: str, non_geometric: str
) -> tuple[Candidate, ...]:
    """Return the candidates with `Candidate.chosen` set.

    Args:
        candidates: All that were fitted.
        geometry: Name of the one for the URDF.
        non_geometric: Name of the non-geometric model; empty if there is none.

    Returns:
        Copies, in the same order; ``""`` marks those of neither name.
    """
    uses = {geometry: "geometry", non_geometric: "non_geometric"}
    return tuple(replace(c, chosen=uses.get(c.name, "")) for c in candidates)


def alternative_models(candidates: Iterable[Candidate]) -> tuple[str, ...]:
    """List non-geometric models to try if refits reject the chosen one, the highest evidence first.

    Each has more evidence than the chosen geometry, and smaller errors on held-out rows of the linearised problem. Of
    models that differ only by vanished families, one is taken. Of families that depend on the order of the rows, only
    those of the chosen model may occur: for no others was the order shown to matter.

    Args:
        candidates: All that were fitted; the chosen ones are marked, see `mark_chosen`.

    Returns:
        Names of at most three models.
    """
    ordered = sorted(candidates, key=lambda c: c.evidence, reverse=True)
    (geometry,) = (c for c in ordered if c.chosen == "geometry")
    effective = {c.name: without_vanished_families(c.name, c.prior_std) for c in ordered}
    listed = {effective[c.name] for c in ordered if c.chosen}
    limit = held_out_rms(geometry.cross_validation)
    of_order = {f for c in ordered if c.chosen for f in moved_families(c.name)}
    names = []
    for candidate in ordered:
        likelier = candidate.evidence > geometry.evidence
        closer = held_out_rms(candidate.cross_validation) < limit
        proven = of_order.issuperset(moved_families(candidate.name))
        if likelier and closer and proven and effective[candidate.name] not in listed:
            names.append(candidate.name)
            listed.add(effective[candidate.name])
    return tuple(names[:_MOST_ALTERNATIVES])


def moved_families(name: str) -> tuple[str, ...]:
    """Return the families of a model, by its name, whose errors depend on the joints' last moves."""
    _, *families = name.split("+")
    return tuple(family for family in families if family_of(family).moved)


def without_vanished_families(name: str, prior_std: Mapping[str, float]) -> str:
    """Return the name of a model without the families whose errors the data shrink to nothing.

    Args:
        name: Of the geometry and its families, such as ``"dh+gain"``.
        prior_std: Estimated standard deviation of each family's errors, in its unit, as of a `Candidate`; a family that
            is missing stays.
    """
    geometry, *families = name.split("+")
    remaining = tuple(family for family in families if not is_vanished(family, prior_std))
    return model_name(geometry, remaining)


def is_vanished(family: str, prior_std: Mapping[str, float]) -> bool:
    """Return whether the estimated standard deviation of a family's errors is next to nothing.

    Args:
        family: Name of the family.
        prior_std: Estimated standard deviation of each family's errors, in its unit, as of a `Candidate`; a family that
            is missing has not vanished.
    """
    limit = _VANISHED * family_of(family).prior
    return prior_std.get(family, np.inf) <= limit
