"""One fit: frames and targets are registered, then all parameters are estimated from there.

`fit` registers (`calib.fit.registration`), makes the `Problem`, and estimates: within bounds, in stages that alternate
with solves (`solving`, `stages`), or by the paper's algorithm (`paper_estimate`). What some tables need
besides is in `special_cases`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.basics.arrays import Array, read_only
from calib.basics.jobs import one_blas_thread
from calib.basics.values import Value
from calib.errors import MeasurementError, ModelError
from calib.fit.estimate.estimate import Estimate
from calib.fit.estimate.paper_estimate import paper_estimate, paper_start
from calib.fit.estimate.prior_terms import PriorTerms
from calib.fit.estimate.problem import Problem
from calib.fit.estimate.solving import estimate_within_bounds
from calib.fit.estimate.special_cases.pose_covariances import settle_pose_noise, with_joint_errors
from calib.fit.estimate.task import Task
from calib.fit.registration.registration import ENOUGH, register, register_held_out
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import Setup
from calib.model.kinematics import Kinematics, Samples


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

    def estimated_setup(self) -> Setup:
        """Return frames, targets and internals of instruments at the solution: the registered ones, changed by x."""
        x = self.estimate.x
        displacement, _ = self.kinematics.model.displacements(x)
        changes = {parameter.name: float(x[k]) for k, parameter in self.kinematics.model.internals}
        internals = []
        for unknown in self.setup.internals:
            change = changes.get(unknown.parameter.name, 0.0)
            internals.append(replace(unknown, change=change))
        return replace(self.setup.displaced(displacement), internals=tuple(internals))

    def tip_poses(self, samples: Samples) -> Array:
        """T_base_tip of the calibrated robot, non-geometric errors of its joints included.

        Args:
            samples: Joint values of N poses [rad or m]; it does not matter which of the fit's frames and targets they
                have.

        Returns:
            shape (N, 4, 4), pose of the tip in the base [m].
        """
        setup = self.estimated_setup()
        T_frame_target = self.kinematics.poses(self.estimate.x, samples)
        T_base_frame = np.linalg.inv(setup.T_frame_base)[samples.frame]
        T_target_tip = np.linalg.inv(setup.T_tip_target)[samples.target]
        return np.asarray(T_base_frame @ T_frame_target @ T_target_tip)

    @property
    def near(self) -> tuple[Fitted, ...]:
        """The fits where others to the same rows are to begin: this one, of images; none, of rows without views.

        Corners and lenses, most of the parameters of images, hardly change with the robot's model or the weights.
        """
        return (self,) if np.any(self.estimate.problem.rows.has_views) else ()

    def with_held_out(self, held_out: Setup, rows: Rows) -> Fitted:
        """Return the fit with frames and targets that only held-out rows see registered to these rows.

        They are registered on the calibrated robot; its estimated parameters stay.

        Args:
            held_out: The frames and targets of this fit, in the same order; marked as unknown are those that no fitted
                row sees.
            rows: The held-out rows: measurements that this fit did not use.

        Returns:
            The fit with a new `setup` and `kinematics`; itself if no frame or target is unknown.

        Raises:
            MeasurementError: Fewer numbers than unknowns of a frame or target.
        """
        if not held_out.count:
            return self
        T_base_tip = self.tip_poses(rows.samples)
        registered = register_held_out(T_base_tip, self.estimated_setup(), held_out, rows)
        setup = _with_new_poses(self.setup, held_out, registered)
        kinematics = Kinematics(
            self.task.robot, self.kinematics.model, setup.T_frame_base, setup.T_tip_target
        )
        return replace(self, setup=setup, kinematics=kinematics)

    def residual(self, rows: Rows) -> Array:
        """Measured minus predicted at the estimated parameters.

        Args:
            rows: Any N rows of measurements, fitted or not, that refer to frames and targets of this fit.

        Returns:
            shape (N, D), in the units of the rows' channels; vectors along the axes of each row's measurement frame; 0
            where nothing was measured.
        """
        return rows.residual(self.kinematics.sightings(self.estimate.x, rows.samples))

    def held_out_scores(self, rows: Rows) -> Array:
        """Score rows that the fit did not use by their distance from what it predicts; see `calib.numerics.scores`.

        Args:
            rows: N rows of measurements that refer to frames and targets of this fit. Channels that were not fitted
                count with the noise of the fit's first one.

        Returns:
            shape (N,), >= 0, norm of each residual in standard deviations of what noise and estimated parameters make
            expect; rows of other than three scalars are converted to what three of the same probability would have.
        """
        if not len(rows):
            return np.zeros(0)
        estimate = self.estimate
        fitted_rows = estimate.problem.rows
        names = [kind.name for kind in fitted_rows.channel_kinds]
        channels = zip(names, fitted_rows.channels.units, strict=True)
        by_channel = dict(zip(channels, estimate.noise, strict=True))
        noise = []
        for kind, unit in zip(rows.channel_kinds, rows.channels.units, strict=True):
            noise.append(by_channel.get((kind.name, unit), estimate.noise[0]))

        as_fitted = with_joint_errors(rows, self.kinematics)
        as_fitted = replace(as_fitted, pose_noise=fitted_rows.pose_noise)
        linear = Problem.initial(self.kinematics, as_fitted).linear(estimate.x)
        not_fitted = np.zeros((1, len(rows)))
        scores = linear.scores(
            estimate.x[None], estimate.covariance[None], not_fitted, np.array([noise])
        )
        return read_only(scores[0])


def _with_new_poses(fitted: Setup, held_out: Setup, registered: Setup) -> Setup:
    """The frames and targets of a fit, with those unknown in ``held_out``, which it did not see, as registered.

    They are marked as unknown too.
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
        fitted.with_poses(T_frame_base, T_tip_target),
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
    near: Sequence[Fitted] = (),
    only_compared: bool = False,
) -> Fitted:
    """Register frames and targets on the nominal robot, and estimate all parameters from there.

    Args:
        task: What is fitted.
        rows: N rows of measurements to fit.
        registered: Frames and targets as another fit registered them on these rows; None to register. Not used
            if there is a reference.
        reference: Fit of another model to these rows, whose registration, weights, scores and limit are taken over;
            None to estimate the weights.
        near: Fits from the same registered frames and targets, whose parameters are where this one begins, those of
            the first that has one of the name; empty to begin at the means of the priors.
        only_compared: True for a candidate, whose evidence alone counts beside that of others: it is solved only as far
            as that needs. The first fit near has the weights of the reference too.

    Returns:
        The registered frames and targets, and the estimate from there.

    Raises:
        ModelError: An unknown model, parameter or solver, nothing to estimate, or rows that the solver does not take.
        MeasurementError: Fewer numbers than unknowns of frames and targets; or than parameters, if priors are off.
        SolverError: No finite residual at the start.
        ArgumentError: A solver that a user wrote returned something else than a `Solution`.
    """
    if reference is not None:
        of_reference = reference.estimate.problem
        rows = replace(
            rows,
            weights=of_reference.weights,
            pose_noise=of_reference.rows.pose_noise,
        )
        registered = reference.setup
    task.check_solver()
    model = task.error_model()
    if task.cell.priors.source == "off" and rows.count < len(model):
        raise MeasurementError(
            f"{rows.count} numbers for {len(model)} parameters, and priors are off. Measure more poses, or choose a "
            "smaller --model."
        )
    if not len(model):
        raise ModelError(f"The model '{model.name}' leaves nothing to estimate.")

    if registered is None:
        setup = task.setup if task.has_weights_and_priors else paper_start(task.setup)
        # Of many rows some are enough for a start.
        some = rows.select(rows.evenly(ENOUGH))
        registered = register(task.robot.poses(some.joints, some.samples.chain), setup, some)
        registered = replace(registered, target_unknown=task.setup.target_unknown)
    model = registered.turn_directions(model)
    kinematics = Kinematics(task.robot, model, registered.T_frame_base, registered.T_tip_target)
    rows = with_joint_errors(rows, kinematics)
    problem = Problem.initial(kinematics, rows, task.distances).with_size_held()
    if task.has_weights_and_priors:
        prior = PriorTerms.of(task, model, registered)
        start = None
        if near:
            known: dict[str, float] = {}
            for fitted in reversed(near):
                names = fitted.kinematics.model.names
                known.update(zip(names, fitted.estimate.x.tolist(), strict=True))
            means = zip(model.names, prior.mean.tolist(), strict=True)
            start = np.array([known.get(name, mean) for name, mean in means])
        beside = near[0].estimate if only_compared else None
        # What targets of a stop share is a trait of the robot, and much the same under other models.
        alike = next(iter((*filter(None, [reference]), *near)), None)
        shares = None
        if alike is not None and problem.stops is not None:
            shares = alike.estimate.problem.stop_shares
        estimate = estimate_within_bounds(problem, task, prior, start, beside, shares)
        estimate = settle_pose_noise(estimate, problem, task, prior)
    else:
        estimate = paper_estimate(problem, task, registered)

    if reference is not None:
        estimate = replace(
            estimate,
            weights=reference.estimate.weights,
            scores=reference.estimate.scores,
            flag_limit=reference.estimate.flag_limit,
        )
    return Fitted(task, registered, kinematics, estimate)
