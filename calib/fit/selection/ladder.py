"""The ladder of models: geometries from the smallest to the largest, and the families of errors that may be added.

A model is named by its geometry and, after plus signs, its families of non-geometric errors: ``"dh+compliance"``.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.errors import ModelError, choices
from calib.fit.estimate.task import Task
from calib.fit.registration.rows import Rows
from calib.model.families import joint_families
from calib.model.joint_errors import joint_displacements, joint_parameters

#: The geometries, from the smallest to the largest.
LADDER = ("frames", "zeros", "dh", "hayati", "placement")

#: A family moves no joint if one unit of its errors moves each by less than this [rad, m].
_NO_MOTION = 1e-6


def model_name(geometry: str, families: tuple[str, ...]) -> str:
    """Return the name of a geometry with families."""
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
        names = replace(task, model=geometry).error_model().names
        if names and names not in listed:
            listed.add(names)
            counts[geometry] = len(names)
    return counts


def determinable_families(task: Task, rows: Rows) -> tuple[str, ...]:
    """List the families of non-geometric errors that would move at least one joint in at least one row.

    Compliances do not, for example, if the URDF states no masses.

    Args:
        task: The fit, with any model.
        rows: The rows that are fitted.

    Returns:
        Names of the families, in the order of the registry.
    """
    robot, samples = task.robot, rows.samples
    families = []
    for family in joint_families():
        terms = joint_parameters(robot, family, task.cell.gravity)
        moves = joint_displacements(robot, terms, samples.q, samples.load)
        if np.max(np.abs(moves), initial=0.0) > _NO_MOTION:
            families.append(family)
    return tuple(families)


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
    for model in (largest, "zeros", "dh", "hayati"):
        known |= {*replace(without_frozen, model=model).error_model().names}
    unknown = sorted(named - known)
    if unknown:
        raise ModelError(
            f"No model has the parameters {choices(unknown)}; 'calib inspect --model dh' lists those of one."
        )
