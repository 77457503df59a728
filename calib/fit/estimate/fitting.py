"""One fit: frames and targets are registered, then all parameters are estimated from there.

`fit` registers (`calib.fit.registration`), makes the `Problem`, and estimates: within bounds (`bounds`), in stages that
alternate with solves (`solving`, `stages`), or by the paper's algorithm (`paper`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.basics.arrays import Array, read_only
from calib.basics.jobs import one_blas_thread
from calib.basics.values import Value
from calib.errors import MeasurementError, ModelError
from calib.fit.estimate.estimate import Estimate
from calib.fit.estimate.paper import paper_estimate
from calib.fit.estimate.pose_noise import estimate_with_pose_noise, with_joint_errors
from calib.fit.estimate.prior_terms import PriorTerms
from calib.fit.estimate.problem import Problem
from calib.fit.estimate.solving import mark_sole_postures
from calib.fit.estimate.task import PAPER, Task
from calib.fit.registration.registration import register, register_held_out
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import Setup
from calib.model.kinematics import Kinematics, Samples
from calib.model.parameters import ErrorModel


@dataclass(frozen=True, slots=True, eq=False)
class Fitted(Value):
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
        """Frames and targets at the solution.

        Uses the registered poses (`setup`), and the estimated parameters (``estimate.x``, shape (p,), [m, rad, ...]),
        of which those of frames and targets displace them.

        Returns:
            The setup with ``T_frame_base``, shape (F, 4, 4), pose of the base in each measurement frame, and
            ``T_tip_target``, shape (T, 4, 4), pose of each target in the tip [m]; all else as registered.
        """
        x = self.estimate.x
        displacement, _ = self.kinematics.model.displacements(x)
        changes = {parameter.name: float(x[k]) for k, parameter in self.kinematics.model.optical}
        optics = []
        for unknown in self.setup.optics:
            change = changes.get(unknown.parameter.name, 0.0)
            optics.append(replace(unknown, change=change))
        return replace(self.setup.displaced(displacement), optics=tuple(optics))

    def tip_poses(self, samples: Samples) -> Array:
        """T_base_tip of the calibrated robot, non-geometric errors of its joints included.

        Args:
            samples: Joint values of N poses [rad or m]; it does not matter which of the fit's frames and targets they
                have.

        Returns:
            shape (N, 4, 4), pose of the tip in the base [m].
        """
        setup = self.placed()
        T_frame_target = self.kinematics.poses(self.estimate.x, samples)
        T_base_frame = np.linalg.inv(setup.T_frame_base)[samples.frame]
        T_target_tip = np.linalg.inv(setup.T_tip_target)[samples.target]
        return np.asarray(T_base_frame @ T_frame_target @ T_target_tip)

    def with_held_out(self, held_out: Setup, rows: Rows) -> Fitted:
        """Return the fit with frames and targets that only held-out rows see registered to these rows.

        They are registered on the calibrated robot; its estimated parameters stay.

        Args:
            held_out: The frames and targets of this fit, in the same order; marked as unknown are those that no fitted
                row sees.
            rows: The held-out rows: measurements that this fit did not use.

        Returns:
            The fit with a new `setup` and `kinematics`; itself where no frame or target is unknown.

        Raises:
            MeasurementError: Too few rows for a frame or target.
        """
        if not held_out.count:
            return self
        T_base_tip = self.tip_poses(rows.samples)
        registered = register_held_out(T_base_tip, self.placed(), held_out, rows)
        setup = _with_new_places(self.setup, held_out, registered)
        kinematics = Kinematics(
            self.task.robot, self.kinematics.model, setup.T_frame_base, setup.T_tip_target
        )
        return replace(self, setup=setup, kinematics=kinematics)

    def residual(self, rows: Rows) -> Array:
        """Measured minus predicted at the estimated parameters.

        Args:
            rows: Any N rows of measurements, fitted or not, that refer to frames and targets of this fit.

        Returns:
            shape (N, D), in the units of ``rows.channels``, coordinates and rotation vectors along the axes of each
            row's measurement frame; 0 where nothing was measured.
        """
        T_frame_target = self.kinematics.poses(self.estimate.x, rows.samples)
        optics = self.kinematics.optics(self.estimate.x, rows.samples)
        return rows.residual(T_frame_target, optics)

    def held_out_scores(self, rows: Rows) -> Array:
        """Score rows that the fit did not use by their distance from what it predicts; see `calib.numerics.scores`.

        Uses the estimate: parameters, shape (p,), their covariance, shape (p, p), and the noise of each instrument.

        Args:
            rows: N rows of measurements that refer to frames and targets of this fit.

        Returns:
            shape (N,), >= 0, norm of each residual in standard deviations of what noise and estimated parameters make
            expect; rows of other than three scalars are converted to what three of the same probability would have.
        """
        if not len(rows):
            return np.zeros(0)
        estimate = self.estimate
        as_fitted = with_joint_errors(rows, self.kinematics)
        as_fitted = replace(as_fitted, pose_noise=estimate.problem.rows.pose_noise)
        linear = Problem.initial(self.kinematics, as_fitted).linear(estimate.x)
        not_fitted = np.zeros((1, len(rows)))
        noise = self._noise_of(rows)
        scores = linear.scores(estimate.x[None], estimate.covariance[None], not_fitted, noise[None])
        return read_only(scores[0])

    def _noise_of(self, rows: Rows) -> Array:
        """Noise of each channel of other rows, as the fit estimated it.

        Args:
            rows: Rows of measurements that the fit did not use.

        Returns:
            shape (C,), standard deviation of the C channels of these rows as a multiple of the given sigma. Channels
            that were not fitted have the noise of the fit's first one.
        """
        fitted_rows = self.estimate.problem.rows
        names = [kind.name for kind in fitted_rows.channel_kinds]
        fitted_channels = zip(names, fitted_rows.channels.units, strict=True)
        fitted = dict(zip(fitted_channels, self.estimate.noise, strict=True))
        noise = []
        for kind, unit in zip(rows.channel_kinds, rows.channels.units, strict=True):
            noise.append(fitted.get((kind.name, unit), self.estimate.noise[0]))
        return np.array(noise)


def _with_new_places(fitted: Setup, held_out: Setup, registered: Setup) -> Setup:
    """The frames and targets of a fit, with those that it did not see where held-out rows put them.

    Args:
        fitted: F frames and T targets where the fit started.
        held_out: The same frames and targets; marked as unknown are those that no fitted row sees.
        registered: The same; those that are unknown in ``held_out`` are where they were registered to held-out rows.

    Returns:
        ``fitted`` with the poses of the unknown ones of ``held_out`` taken from ``registered``, and marked as unknown
        too.
    """
    new_frames = [bool(directions) for directions in held_out.unknown]
    new_targets = held_out.target_unknown
    T_frame_base = fitted.T_frame_base.copy()
    T_tip_target = fitted.T_tip_target.copy()
    T_frame_base[new_frames] = registered.T_frame_base[new_frames]
    T_tip_target[new_targets] = registered.T_tip_target[new_targets]
    unknown = []
    for fitted_directions, new_directions in zip(fitted.unknown, held_out.unknown, strict=True):
        unknown.append(fitted_directions or new_directions)
    return replace(
        fitted.placed(T_frame_base, T_tip_target),
        unknown=tuple(unknown),
        target_unknown=fitted.target_unknown | new_targets,
    )


@one_blas_thread()
def fit(
    task: Task,
    rows: Rows,
    *,
    registered: Setup | None = None,
    reference: Fitted | None = None,
) -> Fitted:
    """Register frames and targets on the nominal robot, and estimate all parameters from there.

    Args:
        task: The nominal robot, the cell (priors, bounds, frozen and tied parameters), frames and targets as given, the
            error model, and the options: solver, treatment of repeats and outliers.
        rows: N rows of measurements to fit: joint values, frame and target of each, and the measured scalars.
        registered: Frames and targets as another fit registered them on these rows; None to register. Not used
            where there is a reference.
        reference: Fit of another model to these rows, whose registration, weights, scores and limit are taken over;
            None to estimate the weights.

    Returns:
        The registered setup, the robot under its error model, and the estimated parameters: offsets from the nominal
        robot and this setup, with covariance, noise and scores.

    Raises:
        ModelError: An unknown model, parameter or solver, or nothing to estimate.
        MeasurementError: Fewer numbers than unknowns.
        SolverError: No finite residual at the start.
    """
    if reference is not None:
        of_reference = reference.estimate.problem
        rows = replace(
            rows,
            weights=of_reference.weights,
            sole=of_reference.rows.sole,
            pose_noise=of_reference.rows.pose_noise,
        )
        registered = reference.setup
    task.check_solver()
    model = task.error_model()
    _check_counts(task, model, rows)
    if registered is None:
        registered = _registered(task, rows)
    model = registered.aligned(model)
    kinematics = Kinematics(task.robot, model, registered.T_frame_base, registered.T_tip_target)
    rows = with_joint_errors(rows, kinematics)
    problem = Problem.initial(kinematics, rows, task.distances).with_size_held()
    if task.solver == PAPER:
        estimate = paper_estimate(problem, task, registered)
    else:
        prior = PriorTerms.of(task, model, registered)
        marked = mark_sole_postures(problem, prior)
        estimate = estimate_with_pose_noise(marked, task, prior)
    if reference is not None:
        estimate = replace(
            estimate,
            weights=reference.estimate.weights,
            scores=reference.estimate.scores,
            flag_limit=reference.estimate.flag_limit,
        )
    return Fitted(task, registered, kinematics, estimate)


def _check_counts(task: Task, model: ErrorModel, rows: Rows) -> None:
    """Raise an error where there is nothing to estimate, or too little to estimate it from without priors.

    Args:
        task: The fit's task, of which ``cell.priors.source`` is "off" where there are no priors.
        model: The p parameters to estimate.
        rows: The measurements to fit.

    Raises:
        MeasurementError: Fewer measured scalars than parameters, and priors are off.
        ModelError: No parameter.
    """
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

    Args:
        task: The fit's task: the nominal robot, frames and targets as given (``setup``), and the solver's name.
        rows: N rows of measurements, to which they are registered.

    Returns:
        The task's setup with registered poses; the same directions and targets are to be estimated.

    Raises:
        MeasurementError: Fewer numbers than unknowns.
    """
    setup = task.setup
    targets_given = task.solver == PAPER and bool(np.all(setup.target_given))
    fixed_frames = np.zeros(len(setup.groups), dtype=bool)
    fixed_targets = np.full(len(setup.targets), targets_given)
    to_register = setup.with_fixed(fixed_frames, fixed_targets)
    T_base_tip = task.robot.poses(rows.joints)
    registered = register(T_base_tip, to_register, rows)
    return replace(registered, target_unknown=setup.target_unknown)
