"""One fit: frames and targets are registered, then all parameters are estimated from there.

`fit` registers (`calib.registration`), makes the `Problem`, and estimates: within bounds (`bounds`), in stages that
alternate with solves (`solving`, `stages`), or by the paper's algorithm (`paper`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.blas import one_blas_thread
from calib.errors import MeasurementError, ModelError
from calib.estimate.bounds import estimate_within_bounds
from calib.estimate.estimate import Estimate
from calib.estimate.paper import paper_estimate
from calib.estimate.prior_terms import PriorTerms
from calib.estimate.problem import Problem
from calib.estimate.solving import mark_sole_postures
from calib.estimate.task import PAPER, Task
from calib.model.kinematics import Kinematics, Samples
from calib.model.parameters import ErrorModel
from calib.registration.registration import register, register_held_out
from calib.registration.rows import Rows
from calib.registration.setup import Setup
from calib.robot.robot import read_only
from calib.units import Array


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """One fit: the registered start and the estimate from there."""

    #: What was fitted
    task: Task
    #: Frames and targets as registered, where the estimate starts
    setup: Setup
    #: The nominal robot under its error model, with these frames and targets
    kinematics: Kinematics
    #: The parameters from there, with their weights, noise and priors
    estimate: Estimate

    def placed(self) -> Setup:
        """Frames and targets at the solution."""
        displacement, _ = self.kinematics.model.displacements(self.estimate.x)
        return self.setup.displaced(displacement)

    def tip_poses(self, samples: Samples) -> Array:
        """T_base_tip of the calibrated robot, non-geometric errors of its joints included, shape (N, 4, 4), [m].

        Args:
            samples: N joint values; their frames and targets do not matter.
        """
        setup = self.placed()
        T_frame_target = self.kinematics.poses(self.estimate.x, samples)
        T_base_frame = np.linalg.inv(setup.T_frame_base)[samples.frame]
        T_target_tip = np.linalg.inv(setup.T_tip_target)[samples.target]
        return np.asarray(T_base_frame @ T_frame_target @ T_target_tip)

    def with_held_out(self, held_out: Setup, rows: Rows) -> Fitted:
        """Return the fit with frames and targets that only held-out rows see registered to these rows.

        Args:
            held_out: The fit's frames and targets; those are unknown that no fitted row sees.
            rows: The held-out rows.

        Raises:
            MeasurementError: Too few rows for a frame or target.
        """
        if not held_out.count:
            return self
        T_base_tip = self.tip_poses(rows.samples)
        registered = register_held_out(T_base_tip, self.placed(), held_out, rows)
        new_frames = [bool(directions) for directions in held_out.unknown]
        new_targets = held_out.target_unknown
        T_frame_base = self.setup.T_frame_base.copy()
        T_tip_target = self.setup.T_tip_target.copy()
        T_frame_base[new_frames] = registered.T_frame_base[new_frames]
        T_tip_target[new_targets] = registered.T_tip_target[new_targets]
        pairs = zip(self.setup.unknown, held_out.unknown, strict=True)
        setup = replace(
            self.setup.placed(T_frame_base, T_tip_target),
            unknown=tuple(fitted or new for fitted, new in pairs),
            target_unknown=self.setup.target_unknown | new_targets,
        )
        model = self.kinematics.model
        kinematics = Kinematics(self.task.robot, model, T_frame_base, T_tip_target)
        return replace(self, setup=setup, kinematics=kinematics)

    def residual(self, rows: Rows) -> Array:
        """Measured minus predicted of any rows, shape (N, D), [m] and [rad]."""
        return rows.residual(self.kinematics.poses(self.estimate.x, rows.samples))

    def held_out_scores(self, rows: Rows) -> Array:
        """Scores of rows that the fit did not use, shape (N,); see `calib.numerics.scores`."""
        if not len(rows):
            return np.zeros(0)
        linear = Problem.initial(self.kinematics, rows).linear(self.estimate.x)
        scores = linear.scores(
            self.estimate.x[None],
            self.estimate.covariance[None],
            np.zeros((1, len(rows))),
            self._noise_of(rows, len(linear.smallest_noise))[None],
        )
        return read_only(scores[0])

    def _noise_of(self, rows: Rows, instruments: int) -> Array:
        """Noise of each instrument of other rows, shape (C,), in units of the given sigma.

        Of a kind of rows that was not fitted it is the noise of the first instrument.
        """
        fitted_rows = self.estimate.problem.rows
        noise = np.full(instruments, self.estimate.noise[0])
        for kind in np.unique(rows.kinds):
            fitted = fitted_rows.instruments[fitted_rows.kinds == kind]
            if not len(fitted):
                continue
            numbers = rows.instruments[rows.kinds == kind][0]
            # Rows of one kind fill the same columns in both tables.
            for number, fitted_number in zip(numbers.tolist(), fitted[0].tolist(), strict=False):
                if number >= 0:
                    noise[number] = self.estimate.noise[fitted_number]
        return noise


@one_blas_thread()
def fit(
    task: Task, rows: Rows, *, registered: Setup | None = None, reference: Fitted | None = None
) -> Fitted:
    """Register frames and targets on the nominal robot, and estimate all parameters from there.

    Args:
        task: Robot, cell, setup and model.
        rows: N rows to fit.
        registered: Frames and targets as another fit registered them on these rows; None to register.
        reference: Fit of another model to these rows, whose registration, weights, scores and limit are taken over;
            None to estimate the weights.

    Raises:
        ModelError: An unknown model, parameter or solver, or nothing to estimate.
        MeasurementError: Fewer numbers than unknowns.
        SolverError: No finite residual at the start.
    """
    if reference is not None:
        of_reference = reference.estimate.problem
        rows = replace(rows, weights=of_reference.weights, sole=of_reference.rows.sole)
        registered = reference.setup
    task.check_solver()
    model = task.error_model()
    _check_counts(task, model, rows)
    if registered is None:
        registered = _registered(task, rows)
    model = registered.aligned(model)
    kinematics = Kinematics(task.robot, model, registered.T_frame_base, registered.T_tip_target)
    problem = Problem.initial(kinematics, rows, task.distances).with_size_held()
    if task.solver == PAPER:
        estimate = paper_estimate(problem, task, registered)
    else:
        prior = PriorTerms.of(task, model, registered)
        estimate = estimate_within_bounds(mark_sole_postures(problem, prior), task, prior)
    if reference is not None:
        estimate = replace(
            estimate,
            weights=reference.estimate.weights,
            scores=reference.estimate.scores,
            flag_limit=reference.estimate.flag_limit,
        )
    return Fitted(task, registered, kinematics, estimate)


def _check_counts(task: Task, model: ErrorModel, rows: Rows) -> None:
    """Raise an error where there is nothing to estimate, or too little to estimate it from without priors."""
    if task.cell.priors.source == "off" and rows.count < len(model):
        raise MeasurementError(
            f"{rows.count} numbers for {len(model)} parameters, and priors are off. Measure more poses, or choose a "
            "smaller --model."
        )
    if not len(model):
        raise ModelError(f"The model '{model.name}' leaves nothing to estimate.")


def _registered(task: Task, rows: Rows) -> Setup:
    """Frames and targets where registration on the nominal robot puts them.

    The paper's algorithm starts at the given targets, if all are given.
    """
    setup = task.setup
    targets_given = task.solver == PAPER and bool(np.all(setup.target_given))
    frames = np.zeros(len(setup.groups), dtype=bool)
    targets = np.full(len(setup.targets), targets_given)
    to_register = setup.with_fixed(frames, targets)
    registered = register(task.robot.poses(rows.joints), to_register, rows)
    return replace(registered, target_unknown=setup.target_unknown)
