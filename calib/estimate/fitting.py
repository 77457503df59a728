"""One fit: register, estimate, and what the fit says of rows that it did not see.

This is what cross-validation repeats and what `calibrate` reports on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from calib.data.cell import Cell
from calib.errors import MeasurementError, ModelError, choices
from calib.estimate.fit_stages import Estimate, estimate, plain_estimate
from calib.estimate.problem import Problem, parts_of
from calib.estimate.registration import register
from calib.estimate.robust import scores
from calib.estimate.rows import Rows
from calib.estimate.setup import KnownDistance, Setup, along_own_axes, targets_along_tip
from calib.estimate.solvers import SOLVERS, Solution, Solver, paper_levenberg_marquardt
from calib.estimate.stage import Holds
from calib.model.error_model import error_model
from calib.model.kinematics import Kinematics, Samples
from calib.model.parameters import FRAME, TARGET, ErrorModel, Parameter
from calib.robot.kernel import one_blas_thread
from calib.robot.robot import Robot, read_only

Array = NDArray[np.float64]

#: The paper's algorithm, which is no least-squares solver: it knows no weights and no priors.
PAPER = "paper"


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """What is fitted, but for the rows."""

    robot: Robot  # The nominal robot
    cell: Cell  # What is known, and how to estimate
    setup: Setup  # Frames and targets as given
    # Name of the parameter set and families, or the robot's own parameters themselves
    model: str | Sequence[Parameter]
    distances: tuple[KnownDistance, ...] = ()  # Known distances between set-ups
    # A name of `calib.estimate.solvers.SOLVERS`, `PAPER`, or a solver itself
    solver: str | Solver = "lm"
    robust: bool = True  # Whether outliers lose their weight
    # Whether the cell may name parameters that this model lacks, because it is one of several
    lenient: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """One fit: the registered start and the estimate from there."""

    task: Task  # What was asked
    setup: Setup  # Frames and targets at the start
    kinematics: Kinematics  # Of the nominal robot with these
    estimate: Estimate  # The parameters from there, with their weights and sizes

    def placed(self) -> Setup:
        """Frames and targets at the solution."""
        return self.setup.displaced(self.kinematics.model.displacements(self.estimate.x)[0])

    def tip_poses(self, samples: Samples) -> Array:
        """T_base_tip of the calibrated robot, the joints' own errors included, shape (N, 4, 4), [m]."""
        found = self.placed()
        T = self.kinematics.poses(self.estimate.x, samples)
        into_base = np.linalg.inv(found.T_frame_base)[samples.frame]
        return np.asarray(into_base @ T @ np.linalg.inv(found.T_tip_target)[samples.target])

    def residual(self, rows: Rows) -> Array:
        """Measured minus predicted, shape (N, D), [m] and [rad]."""
        return rows.residual(self.kinematics.poses(self.estimate.x, rows.samples))


@one_blas_thread()
def fit(
    task: Task, rows: Rows, weights: Array | None = None, started: Setup | None = None
) -> Fitted:
    """Register and estimate.

    weights, shape (N,), stay, repeats shared out; None to find them. started is where `registered` puts frames and
    targets, of another fit to these rows; None to register.

    Raises:
        ModelError: Unknown solver, parameter set or parameter.
        MeasurementError: Too few rows.
        SolverError: The residual at the start is not finite.
    """
    if not callable(task.solver) and task.solver not in (*SOLVERS, PAPER):
        raise ModelError(
            f"There is no solver '{task.solver}'. Choose one of {choices((*SOLVERS, PAPER))}."
        )
    model = model_of(task)
    if task.cell.priors.sizes == "off" and rows.count < len(model):
        raise MeasurementError(
            f"{len(rows)} rows give {rows.count} numbers for {len(model)} parameters, and priors are off. Measure more "
            "poses, choose a smaller --model, or leave the priors on."
        )
    if len(model) == 0:
        raise ModelError(
            f"The model '{model.name}' leaves nothing to estimate: every parameter is frozen or known."
        )
    started = registered(task, rows) if started is None else started
    model = targets_along_tip(along_own_axes(model, started), started)
    kinematics = Kinematics(task.robot, model, started.T_frame_base, started.T_tip_target)
    seen = set(np.unique(rows.samples.frame).tolist())
    distances = tuple(d for d in task.distances if {d.first, d.second} <= seen)
    problem = Problem.first(kinematics, rows, distances)
    if task.solver == PAPER:
        estimated = plain_estimate(problem, _solve_as_the_paper(problem, started))
    else:
        solver = task.solver if callable(task.solver) else SOLVERS[task.solver]
        estimated = estimate(
            problem,
            solver,
            holds_of(task, model, started),
            repeats=task.cell.repeats,
            robust=task.robust,
            weights=weights,
        )
    assert np.all(np.isfinite(estimated.x)), (
        "a solver takes no step to where the cost is not finite"
    )
    return Fitted(task, started, kinematics, estimated)


def registered(task: Task, rows: Rows) -> Setup:
    """Frames and targets where the nominal robot puts them, which is where an estimation starts.

    Raises:
        MeasurementError: Too few rows.
    """
    # The paper's algorithm starts where it was told to, if it was told.
    as_given = task.solver == PAPER and bool(np.all(task.setup.target_given))
    known = np.full(len(task.setup.targets), as_given)
    no_frame = np.zeros(len(task.setup.groups), dtype=bool)
    started = register(task.robot, task.setup.as_known(no_frame, known), rows)
    return replace(started, target_unknown=task.setup.target_unknown)


def holds_of(task: Task, model: ErrorModel, started: Setup) -> Holds:
    """Priors and bounds of a task from a registered start; see `calib.estimate.stage.Holds.of_cell`."""
    return Holds.of_cell(task.cell, model, task.setup, started, lenient=task.lenient)


def model_of(task: Task) -> ErrorModel:
    """The error model of a task, frozen and tied parameters out.

    Raises:
        ModelError: Unknown parameter set or parameter, or one that cannot be frozen.
    """
    setup = task.setup
    model = error_model(
        task.robot,
        task.model,
        frame=setup.frame_unknowns,
        target=setup.unknown_targets,
        targets=setup.target_names,
        rotation=setup.rotation,
    )
    frozen, ties = task.cell.frozen, task.cell.ties
    of_setup = {p.name for p in model.parameters if p.family in (FRAME, TARGET)}
    tied = (*ties, *(other for other, _ in ties.values()))
    for what, names in (("frozen", frozen), ("tied", tied)):
        placed = [name for name in dict.fromkeys(names) if name in of_setup]
        if placed:
            raise ModelError(
                f"{choices(placed)} cannot be {what} one by one: target and frame are known or estimated as a whole. "
                "Use --fix-target or --frame known, or target and frame in the cell file."
            )
    if task.lenient:
        frozen = tuple(name for name in frozen if name in model.names and name not in ties)
        ties = {n: t for n, t in ties.items() if n in model.names and t[0] in model.names}
    return model.tied(ties).without(frozen)


def _solve_as_the_paper(problem: Problem, setup: Setup) -> Solution:
    """The paper's algorithm in its own units, mm and rad, at absolute parameters; x in m and rad comes back.

    Raises:
        ModelError: Anything but points of one target, which the paper does not have.
    """
    parameters = problem.kinematics.model.parameters
    if any(kind.name != "point" for kind in problem.rows.present) or len(setup.targets) > 1:
        raise ModelError(
            "The solver 'paper' takes positions of one target, as the paper does. Choose --solver lm."
        )
    unit = np.array([1e3 if p.unit == "m" else 1.0 for p in parameters])
    target = setup.T_tip_target[0, :3, 3]
    at_target = dict(zip(("target_x", "target_y", "target_z"), target, strict=True))
    nominal = np.array([at_target.get(p.name, p.nominal) for p in parameters])
    solution = paper_levenberg_marquardt(
        partial(problem.paper_system, nominal, unit), nominal * unit
    )
    return replace(solution, x=solution.x / unit - nominal)


def unseen_scores(fitted: Fitted, rows: Rows) -> Array:
    """The scores of rows that the fit did not use, shape (N,); see `calib.estimate.robust`."""
    result = np.zeros(len(rows))
    for own in parts_of(rows):
        part = rows.select(own)
        poses, twists = fitted.kinematics.twists(fitted.estimate.x, part.samples)
        scale = scale_of(fitted, part)
        result[own] = scores(
            part.residual(poses) / scale,
            part.derivative(poses, twists) / scale[:, :, None],
            fitted.estimate.covariance,
            np.zeros(len(part)),
            part.used,
        )
    return read_only(result)


def scale_of(fitted: Fitted, rows: Rows) -> Array:
    """The noise that a fit found, for each scalar of some rows, shape (N, D), [m] and [rad].

    A kind that was not fitted has the noise of the first instrument.
    """
    seen = fitted.estimate.problem.rows
    index, _ = seen.instruments
    result: Array = rows.scales.copy()
    for kind in np.unique(rows.kinds):
        own = rows.kinds == kind
        for column in range(rows.width):
            inside = (seen.kinds == kind) & (column < seen.width)
            known = index[inside, min(column, seen.width - 1)]
            number = int(known[0]) if len(known) and known[0] >= 0 else 0
            result[own, column] *= fitted.estimate.noise[number]
    return result
