"""The fits of a calibration: of the geometry, which the URDF holds, and of a non-geometric model if needed.

The geometry is fitted with the weights of a reference fit if these predict held-out rows better, see
`calib.fit.selection.row_weights`: with those of the non-geometric model if there is one.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.basics.arrays import Mask
from calib.basics.jobs import one_blas_thread
from calib.basics.progress import Stage, begin
from calib.data.cell import AUTO, Cell
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import Reason
from calib.diagnosis.usual_mistakes import (
    check_positions,
    find_usual_mistake,
    frame_not_found,
)
from calib.fit.estimate.fitting import Fitted, fit
from calib.fit.estimate.task import Task
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import Setup, known_distances
from calib.fit.registration.table_rows import joint_loads, rows_and_setup
from calib.fit.selection.candidates import Candidate, check_parameter_names
from calib.fit.selection.row_weights import fit_with_all_families, with_better_weights
from calib.fit.selection.selection import select
from calib.model.error_model import Parameter
from calib.model.parameter_sets import OWN, split_name
from calib.numerics.scores import Limits
from calib.numerics.solvers import Solver
from calib.robot.robot import Robot

#: A smaller share of outliers is not worth the time that a non-geometric model takes.
_FEW_OUTLIERS = 0.01

#: Of more rows a part of this number is fitted first to confirm the outliers: a non-geometric model takes as long as
#: all else.
_MANY_ROWS = 300


@dataclass(frozen=True, slots=True, eq=False)
class TableFits:
    """The fits of one table, from which `calibrate` assembles its result."""

    #: Of the geometry
    geometry: Fitted
    #: Of the non-geometric model
    non_geometric: Fitted | None
    #: Models that they were chosen from; empty if the model was named
    candidates: tuple[Candidate, ...]
    #: All N rows of the table
    all_rows: Rows
    #: Those that were fitted
    fitted_rows: Rows
    #: The measurement setup; unknown are the frames and targets that only validation rows see
    unseen: Setup
    #: A usual mistake that would explain the measurements far better, or a frame that was not found
    mistake: Reason | None
    #: Time that choosing a model, registration and estimation took [s]
    seconds: float

    @property
    def best(self) -> Fitted:
        """The fit that explains the rows best: of the non-geometric model, or of the geometry if there is none."""
        return self.non_geometric or self.geometry


@one_blas_thread()
def fit_table(
    robot: Robot,
    measurements: Measurements,
    cell: Cell,
    *,
    model: str | Sequence[Parameter] | None = None,
    solver: str | Solver = "lm",
    robust: bool = True,
    mistake: Reason | None = None,
) -> TableFits:
    """Fit the models of a calibration to the estimation rows of a table.

    Args:
        robot: The nominal robot.
        measurements: Rows of the set ``estimate`` are fitted; the others place frames and targets that only they see.
        cell: What is known of targets, frames, noise and priors.
        model: Name of the parameter set, with families after it, such as ``"dh+compliance"``; ``"auto"``: the data
            choose; or the robot's parameters themselves; None: the cell's.
        solver: ``"lm"``, ``"scipy"``, ``"paper"`` (the paper's algorithm, without priors and robust weights), or a
            function like those of `calib.numerics.solvers.SOLVERS`.
        robust: Whether outliers lose their weight.
        mistake: A usual mistake that was found already; None: it is looked for.

    Returns:
        The fits of the geometry and, if the model has one or the data ask for it, of a non-geometric model; the
        candidates of the choice; and the rows as arrays. A usual mistake in the table, or a frame that was not found,
        is not raised but returned as their ``mistake``; the model ``"auto"`` is then ``"zeros"``, since no larger one
        of such measurements means anything.

    Raises:
        ModelError: An unknown parameter set, parameter or solver, or measurements that the model does not cover.
        MeasurementError: Too few rows, columns that the robot needs are missing, or all measured positions are the same
            though the tip moves.
        SolverError: No finite result.
    """
    all_rows, setup = rows_and_setup(robot, measurements, cell)
    rows = all_rows.select(measurements.estimation)
    validation_rows = all_rows.select(measurements.validation)
    frames_seen, targets_seen = setup.seen_by(rows.samples)
    seen = setup.with_fixed(~frames_seen, ~targets_seen)
    unseen = setup.with_fixed(frames_seen, targets_seen)
    check_positions(robot, rows, measurements.source)

    began = time.perf_counter()
    model = cell.model if model is None else model
    estimation = measurements.select(measurements.estimation)
    if mistake is None:
        mistake = find_usual_mistake(robot, cell, estimation, measurements)
    if mistake is None:
        mistake = frame_not_found(robot, seen, rows)
    begin(Stage.MODELS)
    task = Task(robot, cell, seen, model, known_distances(cell, seen), solver, robust)
    if mistake and model == AUTO:  # no model of such measurements means anything
        check_parameter_names(task)
        # Nor would a lens: its numbers stay where they begin.
        lens_held = replace(seen, internals=())
        task = replace(task, model="zeros", allow_absent=True, setup=lens_held)

    geometry, non_geometric, candidates = _fit_models(task, rows)
    if isinstance(model, str) and not (mistake or non_geometric or candidates):
        geometry = _confirm_outliers(geometry, measurements)
    geometry = geometry.with_held_out(unseen, validation_rows)
    if non_geometric is not None:
        non_geometric = non_geometric.with_held_out(unseen, validation_rows)
    return TableFits(
        geometry=geometry,
        non_geometric=non_geometric,
        candidates=candidates,
        all_rows=all_rows,
        fitted_rows=rows,
        unseen=unseen,
        mistake=mistake,
        seconds=time.perf_counter() - began,
    )


def _fit_models(task: Task, rows: Rows) -> tuple[Fitted, Fitted | None, tuple[Candidate, ...]]:
    """Choose models if the task leaves it open, and fit them: the geometry, the non-geometric model, the candidates.

    The non-geometric model is None if the task's or the chosen model has no such errors; candidates are empty if the
    model was named or the solver has no priors. The geometry has its own row weights or those of the reference fit,
    whichever predict held-out rows better: of the non-geometric model, or of the search if that chose none.
    """
    if task.model == AUTO and not task.has_weights_and_priors:
        return fit(replace(task, model="dh", allow_absent=True), rows), None, ()
    candidates: tuple[Candidate, ...] = ()
    if task.model == AUTO:
        selection = select(task, rows)
        name, reference = selection.geometry, selection.chosen
        candidates = selection.candidates
    else:
        name = split_name(task.model)[0] if isinstance(task.model, str) else OWN
        reference = fit(task, rows)
    if name == reference.kinematics.model.name:
        return reference, None, candidates
    of_geometry = replace(task, model=name, allow_absent=True)
    geometry = fit(of_geometry, rows, registered=reference.setup, near=reference.near)
    return with_better_weights(geometry, rows, reference), reference, candidates


def _confirm_outliers(geometry: Fitted, measurements: Measurements) -> Fitted:
    """Fit a named geometry again with the weights of a non-geometric model, if that explains some of its outliers.

    Unchanged if few rows are outliers, without priors or robust weights, and if the non-geometric model (with all
    families that the rows determine) calls all of them outliers too, or predicts held-out rows no better.
    """
    task, flagged = geometry.task, geometry.estimate.outliers
    if not task.has_weights_and_priors or task.cell.priors.source == "off":
        return geometry
    if np.mean(flagged) < _FEW_OUTLIERS:
        return geometry

    estimation = measurements.select(measurements.estimation)
    rows = geometry.estimate.problem.rows

    def with_loads(chosen: Mask) -> Rows:
        """Return some of the rows with the loads on the joints, of gravity and payload or as the drives measured."""
        some = rows.select(chosen)
        load = joint_loads(task.robot, estimation.select(chosen), task.cell, some.joints)
        return replace(some, samples=replace(some.samples, load=load))

    if len(rows) > _MANY_ROWS:
        # Fitted to a part, the model may call all outliers outliers as well: their scores, as if held out, are high.
        reference = fit_with_all_families(geometry, with_loads(rows.evenly(_MANY_ROWS)))
        chosen = rows.with_partners(flagged)
        scores = reference.held_out_scores(with_loads(chosen))
        limit = Limits.of(len(rows), reference.estimate.freedom).flagged
        if np.all(scores[flagged[chosen]] > limit):
            return geometry
    loaded = with_loads(np.ones(len(rows), dtype=bool))
    reference = fit_with_all_families(geometry, loaded)
    if np.all(reference.estimate.outliers[flagged]):
        return geometry
    return with_better_weights(geometry, loaded, reference)
