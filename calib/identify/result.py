"""Calibration: the result of `calibrate` as immutable values, and what can be asked of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.errors import ModelError, UrdfError, choices
from calib.identify.coverage import OutsideRow, outside
from calib.identify.findings import Outlier, ParameterEstimate
from calib.identify.fitting import Fitted
from calib.identify.repeats import Repeats
from calib.identify.robustness import Robustness
from calib.identify.selection import Candidate
from calib.identify.setup import Setup
from calib.identify.solvers import Solution
from calib.identify.spread import expected_error
from calib.identify.statistics import CrossValidation, Errors
from calib.identify.verdict import Verdict
from calib.measure.cell import Cell
from calib.measure.measurements import Measurements
from calib.model.kinematics import Samples
from calib.model.observability import Observability
from calib.model.parameters import FRAME, ErrorModel
from calib.model.readback import check_written, random_joint_values
from calib.model.robot import Robot, rigid_inverse
from calib.model.torques import gravity_load
from calib.model.urdf import Urdf

Array = NDArray[np.float64]

#: Name of the link that carries the target in a corrected URDF, when asked for.
TARGET_LINK = "calib_target"


@dataclass(frozen=True, slots=True, eq=False)
class Larger:
    """A model with errors of the joints' state, which no URDF can hold: for `Calibration.predict` and the result file.

    Attributes:
        fitted: The fit.
        parameters: One entry for each parameter.
        residual: shape (N, D), measured minus predicted, all rows [m], [rad].
        cross_validation: Errors on left-out rows; None where it was not asked for.
    """

    fitted: Fitted
    parameters: tuple[ParameterEstimate, ...]
    residual: Array
    cross_validation: CrossValidation | None

    @property
    def name(self) -> str:
        """Its set and families, such as ``"dh+compliance"``."""
        return self.fitted.kinematics.model.name


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """The result of `calibrate`.

    Attributes:
        nominal: The robot as it came in.
        robot: The calibrated robot, its URDF corrected.
        measurements: All rows.
        cell: As given.
        nominal_setup: Frames and targets that the nominal robot's errors are computed with: as given, and registered
            where they were not.
        setup: Frames and targets as estimated or given.
        model: The error model of the geometry, which the URDF holds.
        solver: Name of the solver.
        solution: Where it stopped, with its history.
        seconds: Time that choosing a model, registration and estimation took; NaN where it is not to be told.
        x: shape (p,), offsets from the registered start [m, rad].
        covariance: shape (p, p), of ``x``.
        freedom: Degrees of freedom left for the noise.
        sigma: Estimated standard deviation of one measured length of a good row (median over rows) [m]; NaN where no
            length was measured.
        sigma_angle: Of one measured angle [rad]; NaN where none was.
        sizes: Size of the errors of each family that the data showed, in its unit; empty without priors.
        parameters: One entry for each element of ``x``.
        residual_nominal: shape (N, D), measured minus predicted by the nominal robot, all rows: lengths [m] in the
            first columns, angles [rad] in three more where poses were measured.
        residual_calibrated: shape (N, D), by the calibrated robot.
        used: shape (N, D), which scalars were measured.
        scores: shape (N,), of all rows; see `calib.identify.robust`.
        weights: shape (N,), of all rows in the fit, between 0 and 1; 0 for validation rows.
        flag_limit: The score above which a row is flagged.
        outliers: The estimation rows flagged; they have no weight where the fit was robust.
        suspects: The validation rows beyond such a limit, for their number; they never have a weight.
        robustness: What lowering the weights of doubtful rows did, or would do; None where no row is flagged, and with
            the solver ``"paper"``. See also `calib.identify.uncertainty.with_and_without`.
        repeats: Scatter of rows that repeat a pose; None where none does.
        outside: The rows for validation whose joint values lie outside of the range that was fitted.
        cross_validation: Errors on left-out estimation rows; None where it was not asked for.
        nominal_cross_validation: The same of the nominal robot, with target (and frame, if it is estimated) fitted to
            the other rows.
        observability: Rank, and what the measured poses cannot tell apart.
        candidates: The ladder of models that ``auto`` chose from; empty for a model that was named.
        larger: The larger model, if one was chosen or asked for.
        fitted: The fit of the geometry.
        verdict: Whether to use the result; None without cross-validation, unless the set-up is plainly wrong.
    """

    nominal: Robot
    robot: Robot
    measurements: Measurements
    cell: Cell
    nominal_setup: Setup
    setup: Setup
    model: ErrorModel
    solver: str
    solution: Solution
    seconds: float
    x: Array
    covariance: Array
    freedom: float
    sigma: float
    sigma_angle: float
    sizes: Mapping[str, float]
    parameters: tuple[ParameterEstimate, ...]
    residual_nominal: Array
    residual_calibrated: Array
    used: NDArray[np.bool_]
    scores: Array
    weights: Array
    flag_limit: float
    outliers: tuple[Outlier, ...]
    suspects: tuple[Outlier, ...]
    robustness: Robustness | None
    repeats: Repeats | None
    outside: tuple[OutsideRow, ...]
    cross_validation: CrossValidation | None
    nominal_cross_validation: CrossValidation | None
    observability: Observability
    candidates: tuple[Candidate, ...]
    larger: Larger | None
    fitted: Fitted
    verdict: Verdict | None

    @property
    def expected_measured(self) -> float:
        """Standard deviation of the predicted point at the measured poses, rms [m].

        From the covariance, so it knows nothing of errors that the model lacks.
        """
        return expected_error(self.fitted, everywhere=False)

    @property
    def expected_everywhere(self) -> float:
        """The same over joint values spread over the limits [m]."""
        return expected_error(self.fitted, everywhere=True)

    def __repr__(self) -> str:
        """In one line; `summary` has the rest."""
        verdict = "no verdict" if self.verdict is None else self.verdict.use
        return f"Calibration({self.nominal!r}, {len(self.measurements)} rows, {verdict})"

    @property
    def T_frame_base(self) -> Array:
        """Pose of the base in the (first) measurement frame, as estimated or given, shape (4, 4), [m]."""
        return np.asarray(self.setup.T_frame_base[0])

    @property
    def target(self) -> Array:
        """The (first) target in the tip, as estimated or given, shape (3,), [m]."""
        return np.asarray(self.setup.T_tip_target[0, :3, 3])

    @property
    def errors(self) -> dict[str, dict[str, Errors]]:
        """``errors["nominal" | "calibrated" | "larger"]["estimation" | "validation"]``; "larger" if there is one."""
        m = self.measurements
        residuals = {"nominal": self.residual_nominal, "calibrated": self.residual_calibrated}
        if self.larger is not None:
            residuals["larger"] = self.larger.residual
        return {
            who: {
                name: Errors.of(residual[mask], self.used[mask])
                for name, mask in (("estimation", m.estimation), ("validation", m.validation))
            }
            for who, residual in residuals.items()
        }

    def parameter(self, name: str) -> ParameterEstimate:
        """One parameter by its exact name; of the geometry, or of the larger model if only that has it.

        Raises:
            ModelError: No such parameter.
        """
        if self.larger is not None and name not in self.model.names:
            larger = self.larger.fitted.kinematics.model
            if name in larger.names:
                return self.larger.parameters[larger.index(name)]
        return self.parameters[self.model.index(name)]

    def samples(
        self, q: ArrayLike, *, target: str | None = None, group: str | None = None
    ) -> Samples:
        """Joint values as a prediction takes them, with the load that gravity and payload put on the joints.

        Args:
            q: shape (N, m) or (m,), joint values in the robot's order, [rad] or [m].
            target: Name of the target; the first where None.
            group: Name of the set-up whose frame is meant; the first where None.

        Raises:
            ModelError: No such target or set-up.
        """
        values = np.atleast_2d(np.asarray(q, dtype=np.float64))
        load = None
        if self.larger is not None:
            load = gravity_load(self.nominal, values, self.cell.payload, self.cell.gravity)
        return replace(
            Samples.at(values, load),
            frame=np.full(len(values), _number(group, self.setup.groups, "set-up")),
            target=np.full(len(values), _number(target, self.setup.targets, "target")),
        )

    def predict(
        self,
        q: ArrayLike,
        *,
        target: str | None = None,
        group: str | None = None,
        larger: bool = True,
    ) -> Array:
        """Where the calibrated robot puts the target, in the measurement frame, or in the base where there is none.

        Args:
            q: shape (N, m) or (m,), joint values in the robot's order, [rad] or [m].
            target: Name of the target; the first where None.
            group: Name of the set-up whose frame is meant; where None the first, and the base where only sockets,
                planes, anchors or pairs were measured.
            larger: Whether to use the larger model, where there is one; else the geometry that the URDF holds.

        Returns:
            shape (N, 3), [m].
        """
        return self.predict_poses(q, target=target, group=group, larger=larger)[:, :3, 3]

    def predict_poses(
        self,
        q: ArrayLike,
        *,
        target: str | None = None,
        group: str | None = None,
        larger: bool = True,
    ) -> Array:
        """The target's pose in the measurement frame, shape (N, 4, 4), [m]; the arguments are those of `predict`."""
        fitted = self._fit(larger=larger)
        samples = self.samples(q, target=target, group=group)
        poses = fitted.kinematics.poses(fitted.estimate.x, samples)
        if self._in_base(group):
            poses = rigid_inverse(fitted.placed().T_frame_base[0]) @ poses
        return poses

    def position_std(
        self,
        q: ArrayLike,
        *,
        target: str | None = None,
        group: str | None = None,
        larger: bool = True,
    ) -> Array:
        """How sure a predicted position is: sqrt(trace(J C J^T)), from the parameters' covariance C.

        It knows nothing of errors that the model lacks. The arguments are those of `predict`.

        Returns:
            shape (N,), [m].
        """
        fitted = self._fit(larger=larger)
        samples = self.samples(q, target=target, group=group)
        _, jacobian = fitted.kinematics.points_jacobian(fitted.estimate.x, samples)
        if self._in_base(group):  # where sockets stand in it is no part of what is predicted
            jacobian = np.where(fitted.kinematics.model.family(FRAME), 0.0, jacobian)
        covariance = fitted.estimate.covariance
        return np.asarray(np.sqrt(np.einsum("nij,jk,nik->n", jacobian, covariance, jacobian)))

    def outside_of_measured(self, q: ArrayLike) -> tuple[OutsideRow, ...]:
        """Which joint values lie outside of the range that the fit has seen, where errors may be larger than expected.

        Args:
            q: shape (N, m) or (m,), joint values in the robot's order, [rad] or [m].
        """
        seen = self.measurements.joints_for(self.nominal.joint_names)[self.weights > 0.0]
        types = [joint.type for joint in self.nominal.inputs]
        asked = np.atleast_2d(np.asarray(q, dtype=np.float64))
        return outside(seen, asked, self.nominal.joint_names, types)

    def _in_base(self, group: str | None) -> bool:
        """Whether predictions are in the base: no instrument has a frame, sockets, planes and anchors stand there."""
        return group is None and not np.any(self.measurements.of_kind("point", "pose"))

    def _fit(self, *, larger: bool) -> Fitted:
        """The fit to predict with."""
        return self.larger.fitted if larger and self.larger is not None else self.fitted

    def summary(self) -> str:
        """The result as text, without colours."""
        from calib.identify.summary import summary

        return summary(self)

    def write_urdf(
        self, path: str | Path, *, overwrite: bool = False, target_link: bool = False
    ) -> Path:
        """Write the corrected URDF, the geometry alone, after reading it back with Pinocchio and yourdfpy.

        Args:
            path: Where to.
            overwrite: Whether an existing file may be replaced.
            target_link: Whether to add a link ``calib_target`` at the target, fixed to the tip.

        Raises:
            UrdfError: A reader disagrees with the model in memory by more than 1e-9 m or rad.
            ModelError: Several targets, which one link cannot stand for.
            FileError: The file exists, or cannot be written.
        """
        return self.checked_urdf(target_link=target_link).write(path, overwrite=overwrite)

    def checked_urdf(self, *, target_link: bool = False) -> Urdf:
        """What `write_urdf` writes, read back with Pinocchio and yourdfpy as it does.

        Raises:
            UrdfError: A reader disagrees with the model in memory by more than 1e-9 m or rad.
            ModelError: Several targets, which one link cannot stand for.
        """
        robot = self.robot
        if target_link:
            if len(self.setup.targets) > 1:
                message = (
                    f"There are {len(self.setup.targets)} targets, {choices(self.setup.targets)}; a target link can "
                    "be written for one. Do without it."
                )
                raise ModelError(message)
            robot = replace(robot, urdf=_with_target_link(robot, self.setup.T_tip_target[0]))
        q = random_joint_values(robot)
        # Straight from the parameters, by the path that the fit took, not through the corrected robot.
        check_written(robot, self.fitted.tip_poses(Samples.at(q)), q)
        return robot.urdf

    def write_json(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the result as JSON; the keys are documented in docs/result-json.md.

        Raises:
            FileError: The file exists, or cannot be written.
        """
        from calib.identify.result_file import write_result

        return write_result(self, path, overwrite=overwrite)

    def write_report(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the report: a page with figures that prints on A4 (.html).

        Raises:
            FileError: The name has another ending, the file exists, or it cannot be written.
        """
        from calib.show.report import write_report

        return write_report(self, path, overwrite=overwrite)


def _number(name: str | None, names: tuple[str, ...], what: str) -> int:
    """The place of a name among names; 0 where none is given.

    Raises:
        ModelError: There is no such name.
    """
    if name is None:
        return 0
    if name not in names:
        message = f"There is no {what} '{name}'; there is {choices(names)}."
        raise ModelError(message)
    return names.index(name)


def _with_target_link(robot: Robot, T_tip_target: Array) -> Urdf:
    """The robot's URDF with a link at the target; one that an earlier calibration added is moved there."""
    if TARGET_LINK not in robot.urdf.links:
        return robot.urdf.with_link(TARGET_LINK, robot.tip, T_tip_target)
    joint = next(joint for joint in robot.urdf.joints if joint.child == TARGET_LINK)
    if joint.parent != robot.tip or joint.type != "fixed":
        message = (
            f"The URDF has a link '{TARGET_LINK}' already, and it is not fixed to the tip '{robot.tip}' but hangs on "
            f"'{joint.parent}' by a joint of type '{joint.type}'. Rename it, or do without the target link."
        )
        raise UrdfError(message)
    return robot.urdf.with_origins({joint.name: T_tip_target})
