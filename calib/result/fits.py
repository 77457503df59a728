"""The fits of a calibration: of the geometry, which the URDF holds, and of a non-geometric model where the data ask.

The geometry is fitted with the weights of a reference fit where these predict held-out rows better, see
`calib.fit.selection.reference_fit`: with those of the non-geometric model if there is one.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.basics.arrays import Mask
from calib.basics.jobs import one_blas_thread
from calib.data.cell import AUTO, Cell
from calib.data.measurements import Measurements
from calib.diagnosis.frame_not_found import frame_not_found
from calib.diagnosis.reasons import Reason
from calib.diagnosis.usual_mistakes import check_positions, find_usual_mistake
from calib.fit.estimate.fitting import Fitted, fit
from calib.fit.estimate.task import Task
from calib.fit.registration.known_distances import known_distances
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import Setup
from calib.fit.registration.table_rows import joint_loads, rows_and_setup
from calib.fit.selection.candidates import Candidate
from calib.fit.selection.ladder import check_parameter_names
from calib.fit.selection.reference_fit import fit_with_all_families, with_better_weights
from calib.fit.selection.selection import select
from calib.model.error_model import OWN, split_name
from calib.model.parameters import Parameter
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
    #: Models that they were chosen from; empty where the model was named
    candidates: tuple[Candidate, ...]
    #: All N rows of the table
    all_rows: Rows
    #: Those that were fitted, those of sole postures marked
    fitted_rows: Rows
    #: The measurement setup; unknown are the frames and targets that only validation rows see
    unseen: Setup
    #: A usual mistake that would explain the measurements far better, or a frame that was not found
    mistake: Reason | None
    #: Time that choosing a model, registration and estimation took
    seconds: float


@dataclass(frozen=True, slots=True, eq=False)
class _SplitTable:
    """A table as rows to fit and rows to predict, with the frames and targets that each see."""

    #: All N rows, as arrays
    all_rows: Rows
    #: The estimation rows, which are fitted
    rows: Rows
    #: The validation rows, which are only predicted
    validation_rows: Rows
    #: The measurement setup as given; unknown are only frames and targets that estimation rows see
    seen: Setup
    #: Likewise; unknown are only those that no estimation row sees
    unseen: Setup

    @classmethod
    def of(cls, robot: Robot, measurements: Measurements, cell: Cell) -> _SplitTable:
        """Convert a table to the arrays of a fit, and split it by its sets.

        Args:
            robot: The nominal robot, whose measured joints the table's columns are.
            measurements: All N rows, of the sets ``estimate`` and ``validate``.
            cell: Frames, targets and noise as given.

        Returns:
            The rows of both sets as arrays, and the measurement setup twice, not registered: unknown in ``seen`` are
            only frames and targets that estimation rows see, in ``unseen`` only those that none sees.

        Raises:
            MeasurementError: A pair has one row only, or columns that the robot needs are missing.
            ModelError: The cell names a station or target that the table lacks.
        """
        all_rows, setup = rows_and_setup(robot, measurements, cell)
        rows = all_rows.select(measurements.estimation)
        frames_seen, targets_seen = setup.seen_by(rows.samples)
        return cls(
            all_rows=all_rows,
            rows=rows,
            validation_rows=all_rows.select(measurements.validation),
            seen=setup.with_fixed(~frames_seen, ~targets_seen),
            unseen=setup.with_fixed(frames_seen, targets_seen),
        )

    def with_unseen_placed(self, fitted: Fitted) -> Fitted:
        """Return a fit with frames and targets that only validation rows see registered to these rows.

        Args:
            fitted: A fit to ``rows``, the estimation rows.

        Returns:
            The fit with the frames and targets that are unknown in ``unseen``, the measurement setup, placed on the
            calibrated robot by ``validation_rows``; its parameters are the same.

        Raises:
            MeasurementError: Too few rows for such a frame or target.
        """
        return fitted.with_held_out(self.unseen, self.validation_rows)


@one_blas_thread()
def fit_table(
    robot: Robot,
    measurements: Measurements,
    cell: Cell,
    *,
    model: str | Sequence[Parameter] | None = None,
    solver: str | Solver = "lm",
    robust: bool = True,
) -> TableFits:
    """Fit the models of a calibration to the estimation rows of a table.

    Args:
        robot: The nominal robot.
        measurements: Rows of the set ``estimate`` are fitted; the others place frames and targets that only they see.
        cell: What is known of targets, frames, noise and priors.
        model: Name of the parameter set, with families behind it, such as ``"dh+compliance"``; ``"auto"``: the data
            choose; or the robot's parameters themselves; None: the cell's.
        solver: ``"lm"``, ``"scipy"``, ``"paper"`` (the paper's algorithm, without priors and robust weights), or a
            function like those of `calib.numerics.solvers.SOLVERS`.
        robust: Whether outliers lose their weight.

    Returns:
        The fits of the geometry and, if the model has one or the data ask for it, of a non-geometric model; the
        candidates of the choice; and the rows as arrays. A usual mistake in the table, or a frame that was not found,
        is not raised but returned as their ``mistake``; the model ``"auto"`` is then ``"zeros"``, since no larger one
        of such measurements means anything.

    Raises:
        ModelError: An unknown parameter set, parameter or solver, or measurements that the model does not cover.
        MeasurementError: Too few rows, or columns that the robot needs are missing.
        SolverError: No finite result.
    """
    table = _SplitTable.of(robot, measurements, cell)
    check_positions(robot, table.rows, measurements.source)

    began = time.perf_counter()
    model = cell.model if model is None else model
    mistake = find_usual_mistake(robot, cell, measurements.select(measurements.estimation))
    if mistake is None:
        mistake = frame_not_found(robot, table.seen, table.rows)
    distances = known_distances(cell, table.seen)
    task = Task(robot, cell, table.seen, model, distances, solver, robust)
    if mistake and model == AUTO:  # no model of such measurements means anything
        check_parameter_names(task)
        task = replace(task, model="zeros", allow_absent=True)

    geometry, non_geometric, candidates = _fit_models(task, table.rows)
    if isinstance(model, str) and not (mistake or non_geometric or candidates):
        geometry = _with_outliers_confirmed(geometry, measurements)
    geometry = table.with_unseen_placed(geometry)
    if non_geometric is not None:
        non_geometric = table.with_unseen_placed(non_geometric)
    return TableFits(
        geometry=geometry,
        non_geometric=non_geometric,
        candidates=candidates,
        all_rows=table.all_rows,
        fitted_rows=replace(table.rows, sole=geometry.estimate.problem.rows.sole),
        unseen=table.unseen,
        mistake=mistake,
        seconds=time.perf_counter() - began,
    )


def _fit_models(task: Task, rows: Rows) -> tuple[Fitted, Fitted | None, tuple[Candidate, ...]]:
    """Choose models if the task leaves it open, and fit them.

    Args:
        task: The fit: robot, cell, frames and targets as given, and solver. Its ``model`` may be ``"auto"``, a name, or
            the robot's parameters themselves.
        rows: The estimation rows to fit, as arrays.

    Returns:
        The fit of the geometry, with its own row weights or those of the non-geometric fit, whichever predict held-out
        rows better; that of the non-geometric model, None if there is none; and the candidates of the choice, empty
        where the model was named.
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
    rows = replace(rows, sole=reference.estimate.problem.rows.sole)
    geometry = fit(replace(task, model=name, allow_absent=True), rows, registered=reference.setup)
    return with_better_weights(geometry, rows, reference), reference, candidates


def _with_outliers_confirmed(geometry: Fitted, measurements: Measurements) -> Fitted:
    """Fit a named geometry again with the weights of a non-geometric model, if that explains some of its outliers.

    Args:
        geometry: Fit of the geometry to the N estimation rows: its task, its rows, and ``estimate.outliers``, True for
            flagged rows, shape (N,).
        measurements: All rows of the table; they say what loads the joints, which a non-geometric model needs.

    Returns:
        The fit of the geometry with the weights that predict held-out rows better: its own, or those of the fit with
        all non-geometric errors that the rows determine. Unchanged where few rows are outliers, without priors, by the
        paper's solver, and where the non-geometric model calls all of them outliers too.
    """
    task, flagged = geometry.task, geometry.estimate.outliers
    if not task.has_weights_and_priors or task.cell.priors.source == "off":
        return geometry
    if np.mean(flagged) < _FEW_OUTLIERS:
        return geometry
    estimation = measurements.select(measurements.estimation)
    rows = geometry.estimate.problem.rows
    if len(rows) > _MANY_ROWS and _outliers_of_a_part_too(geometry, estimation):
        return geometry
    rows = _with_loads(geometry, estimation, np.ones(len(rows), dtype=bool))
    reference = fit_with_all_families(geometry, rows)
    if np.all(reference.estimate.outliers[flagged]):
        return geometry
    return with_better_weights(geometry, rows, reference)


def _outliers_of_a_part_too(geometry: Fitted, estimation: Measurements) -> bool:
    """Tell if a non-geometric model that is fitted to a part of the rows calls every outlier one too.

    Args:
        geometry: Fit of the geometry to N rows: its rows, and ``estimate.outliers``, True for flagged rows, shape (N,).
        estimation: These N rows of the table, which say what loads the joints.

    Returns:
        True if the scores of all outliers of ``geometry``, as if held out from the fit to the part, are beyond the
        limit from which on that model flags a row.
    """
    rows, flagged = geometry.estimate.problem.rows, geometry.estimate.outliers
    part = _with_loads(geometry, estimation, rows.evenly(_MANY_ROWS))
    reference = fit_with_all_families(geometry, part)
    chosen = rows.with_partners(flagged)
    scores = reference.held_out_scores(_with_loads(geometry, estimation, chosen))
    limit = Limits.of(len(rows), reference.estimate.freedom).flagged
    return bool(np.all(scores[flagged[chosen]] > limit))


def _with_loads(geometry: Fitted, estimation: Measurements, chosen: Mask) -> Rows:
    """Return some rows of a fit with the loads on the joints, of gravity and payload or as the drives measured them.

    Args:
        geometry: Fit to N rows, of which its rows as arrays, its nominal robot, and its cell with payload and gravity
            are used.
        estimation: These N rows of the table; torques of the drives, where it has them, take the place of the loads of
            gravity.
        chosen: True for the rows to return, shape (N,).

    Returns:
        These n rows in their order; ``samples.load`` is of the shape (n, joints, joints + 3), see
        `calib.robot.gravity.gravity_loads`.
    """
    task, rows = geometry.task, geometry.estimate.problem.rows.select(chosen)
    load = joint_loads(task.robot, estimation.select(chosen), task.cell, rows.joints)
    return replace(rows, samples=replace(rows.samples, load=load))
