"""calibrate, evaluate and compare: results with methods that write them, which import what they need when called."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.errors import ModelError, UrdfError, VerdictError, choices
from calib.model.kinematics import Samples
from calib.result.acceptance import Acceptance, Assessment
from calib.result.calibrate import calibrate as calibrate_values
from calib.result.calibration import CalibrationValues
from calib.result.comparison import ComparisonValues, compare as compare_values
from calib.result.evaluation import EvaluationValues, evaluate as evaluate_values
from calib.robot.ranges import random_joint_values
from calib.robot.readback import check_written
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from calib.text.verdict import against, refusal
from calib.values.arguments import check_path, check_type
from calib.values.with_methods import as_kind, returning

__all__ = [
    "TARGET_LINK",
    "Calibration",
    "Comparison",
    "Evaluation",
    "calibrate",
    "compare",
    "evaluate",
]

#: Name of the link that carries the target in a corrected URDF, when asked for.
TARGET_LINK = "calib_target"


class Calibration(CalibrationValues):
    """The result of `calibrate`: the values of `calib.result.calibration.CalibrationValues`, and what writes them.

    There are two ways to get one: `calib.calibrate`, and `Calibration.read_json` of a file that `write_json` wrote. It
    can be pickled and copied, with measurements and fit if it has them. Arrays are read-only. N rows of the table, p
    parameters of the geometry, m measured joints, D columns of a residual, each in the unit of ``channels``.

    The robot:

        nominal              Robot, as given
        robot                Robot, its URDF corrected: the geometry
        non_geometric        NonGeometric, the model with errors of the joints' state; None if there is none
        setup                Setup, frames (T_frame_base) and targets (T_tip_target) as estimated or given [m]
        nominal_setup        Setup, those of the nominal robot
        T_frame_base         (4, 4) [m], pose of the base in the first measurement frame
        target               (3,) [m], position of the first target in the tip
        frame_estimated      whether the measurement frames were estimated

    Trust:

        verdict              Verdict, its use and its reasons; None without cross-validation
        errors               errors["nominal" | "calibrated" | "non_geometric"]["estimation" | "validation"]["m"].rms
        cross_validation     CrossValidation, errors on held-out rows; None without
        nominal_cross_validation  the same of the nominal robot
        new_point            (near the measured poses, over the joint limits), expected error, rms [m]
        zeros                JointZeros, the best joint zeros alone, with their errors; None where they cannot be fitted
        expected_measured    rms standard deviation of predictions at the measured poses [m]
        expected_everywhere  the same over the joint limits [m]
        expected_elsewhere   the same with what the model lacks [m]
        extrapolation        squared error of extrapolated predictions over that by the covariance, 1 or more
        robustness           Robustness, the fit with and without lowered weights; None without outliers
        outliers, suspects   Outliers among the fitted rows, and among the validation rows
        outside              OutsideRows, validation rows outside of the fitted joint values

    The rows:

        rows                 RowNames: numbers, sets, kinds, stations and targets of the N rows
        source               Source, name and hash of the table
        residual_nominal     (N, D), measured minus predicted by the nominal robot; NaN if it is not judged
        nominal_is_judged    False if a measurement frame was sought and not found
        residual_calibrated  (N, D), by the calibrated robot
        channels             unit of each entry of the residuals: "m", "rad" or "px"
        used                 (N, D), True for the scalars that were measured
        scores, weights      (N,), deleted residual and weight in the fit of each row
        metres_per_pixel     (N,) [m/px], length at the board that a pixel is; None without images
        errors_at_board      errors of images as lengths at the board [m], by set and robot
        cameras, boards      Cameras and Boards of images, as estimated; nominal_cameras, nominal_boards as given
        flag_limit           score above which a row is flagged
        ranges               (m, 2) [rad] or [m], least and greatest joint values of fitted rows
        sigma                noise of one scalar by its unit, such as sigma["m"] [m]; sigma_given as the cell or the
                             table states it
        pose_noise           PoseNoise, scale of stated covariances of poses, what the robot adds; None without any
        repeats              Repeats, scatter of rows that repeat a pose; None where none does
        freedom              degrees of freedom left for the noise

    The parameters of the geometry:

        model                ErrorModel: names, units and places of the p parameters
        parameters           p ParameterEstimates: nominal and calibrated value, standard deviation, interval
        x                    (p,), their offsets from the nominal robot [m], [rad]
        covariance           (p, p), of x
        kinematics           Kinematics, the nominal robot under the model
        base_motion          (6, p), motion of the base that compensates each; None where rows tell where it stands
        prior_std            prior standard deviation of each family, in its unit; prior_std_from, its source
        frozen, ties         parameters that were kept, and those that follow another one
        observability        Observability, rank and unobservable combinations
        candidates           Candidates that "auto" chose from
        solver, solution     name of the solver, and its Solution; seconds, its time [s]

    The record:

        record               Record, who measured what for whom, where, when and with what, as the cell says

    In memory only (ModelError where the result was read from a file, which does not hold them):

        measurements, cell   as given
        fitted               Fitted, the fit of the geometry; fit, FitInMemory with all of these, None from a file
    """

    __slots__ = ()

    @classmethod
    def read_json(cls, path: str | Path) -> Calibration:
        """Read a result that `write_json` or ``calib calibrate --json`` wrote.

        Args:
            path: The file.

        Returns:
            The result; it does not hold the measurements.

        Raises:
            FileError: The file cannot be read, or is no result.
        """
        from calib.result.calibration_file import read_result

        return as_kind(cls, read_result(path))

    def __repr__(self) -> str:
        """One line: the nominal robot, the verdict, rms error before and after on held-out rows, number of rows."""
        from calib.text.shown.short import calibration_line

        return calibration_line(self)

    def _repr_html_(self) -> str:
        """A small table for notebooks: the verdict and its first reason, errors before and after."""
        from calib.text.shown.notebook import calibration_html

        return calibration_html(self)

    def summary(self) -> str:
        """Return the result as text, without colours."""
        from calib.text.summary import summary

        return summary(self)

    def checked_urdf(self, *, target_link: bool = False) -> Urdf:
        """Return the URDF that `write_urdf` writes, read back with Pinocchio and yourdfpy.

        A verdict ``do not use`` stands in it as a comment; it is not obeyed here.

        Args:
            target_link: Whether it has a link ``calib_target`` at the target, fixed to the tip.

        Returns:
            The corrected URDF, the geometry alone.

        Raises:
            UrdfError: A reader disagrees with the model in memory by more than 1e-9 m or rad, or
                the URDF has another link ``calib_target``.
            ModelError: Several targets, which one link cannot stand for.
        """
        robot = self.robot
        if target_link:
            robot = self._robot_with_target_link()
        robot = replace(robot, urdf=robot.urdf.with_verdict(against(self.verdict)))
        q = random_joint_values(robot)
        # Straight from the parameters, by the path that the fit took, not through the corrected robot.
        T_base_tip = self.tips(Samples.at(q))
        check_written(robot, T_base_tip, q)
        return robot.urdf

    def _robot_with_target_link(self) -> Robot:
        """Return the corrected robot with a link at its only target."""
        names = self.setup.targets
        if len(names) > 1:
            raise ModelError(
                f"There are {len(names)} targets, {choices(names)}; a target link can be written "
                "for one."
            )
        T_tip_target = self.setup.T_tip_target[0]
        urdf = _with_target_link(self.robot.urdf, self.robot.tip, T_tip_target)
        return replace(self.robot, urdf=urdf)

    def write_urdf(
        self,
        path: str | Path,
        *,
        overwrite: bool = False,
        target_link: bool = False,
        accept: bool = False,
    ) -> Path:
        """Write the corrected URDF, the geometry alone, after reading it back with Pinocchio and yourdfpy.

        Args:
            path: The file.
            overwrite: Whether a file that exists is replaced.
            target_link: Whether it has a link ``calib_target`` at the target, fixed to the tip.
            accept: Whether it is written also where the verdict is ``do not use``; the verdict then stands in it as a
                comment before ``<robot>``.

        Returns:
            The path.

        Raises:
            VerdictError: The verdict is ``do not use``, and ``accept`` is not given.
            UrdfError: A reader disagrees with the model in memory by more than 1e-9 m or rad.
            ModelError: Several targets, which one link cannot stand for.
            FileError: The file exists, or cannot be written.
        """
        check_path("path", path)
        verdict_against = against(self.verdict)
        if verdict_against and not accept:
            raise VerdictError(refusal(f"'{path}'", verdict_against))
        return self.checked_urdf(target_link=target_link).write(path, overwrite=overwrite)

    def write_json(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the result as JSON, see docs/result-json.md.

        Args:
            path: The file.
            overwrite: Whether a file that exists is replaced.

        Returns:
            The path.

        Raises:
            FileError: The file exists, or cannot be written.
        """
        from calib.result.calibration_file import write_result

        check_path("path", path)
        return write_result(self, path, overwrite=overwrite)

    def write_report(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the report, a page with figures that prints on A4.

        Args:
            path: The HTML file.
            overwrite: Whether a file that exists is replaced.

        Returns:
            The path.

        Raises:
            ModelError: The result was read from a file, which does not hold the measurements.
            FileError: The file exists, or cannot be written.
        """
        from calib.report.report import write_report

        check_path("path", path)
        return write_report(self, path, overwrite=overwrite)


def _with_target_link(urdf: Urdf, tip: str, T_tip_target: NDArray[np.float64]) -> Urdf:
    """Return a URDF with a link at the target; one that an earlier calibration added is moved.

    Args:
        urdf: The URDF.
        tip: Name of the tip link.
        T_tip_target: Pose of the target in the tip, shape (4, 4) [m].

    Returns:
        The URDF with the link `TARGET_LINK`.

    Raises:
        UrdfError: It has a link of this name that is not fixed to the tip.
    """
    if TARGET_LINK not in urdf.links:
        return urdf.with_link(TARGET_LINK, tip, T_tip_target)
    joint = next(joint for joint in urdf.joints if joint.child == TARGET_LINK)
    if joint.parent != tip or joint.type != "fixed":
        raise UrdfError(
            f"The URDF has a link '{TARGET_LINK}' already, not fixed to '{tip}' but a child of "
            f"'{joint.parent}' by a {joint.type} joint. Rename it, or do without the target link."
        )
    return urdf.with_origins({joint.name: T_tip_target})


class Comparison(ComparisonValues):
    """The result of `compare`: the values of `calib.result.comparison.ComparisonValues`, and what writes them."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        """A small table for notebooks: the answer, and both results."""
        from calib.text.shown.notebook import comparison_html

        return comparison_html(self)

    def summary(self) -> str:
        """Return the comparison as text, without colours, in 100 columns."""
        from calib.text.comparison import comparison_text

        return comparison_text(self)

    def table(self) -> dict[str, Any]:
        """Return the comparison as nested tables of plain values; docs/comparison.md has the keys."""
        from calib.text.comparison import comparison_table

        return comparison_table(self)

    def write_json(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the comparison as JSON.

        Args:
            path: The file.
            overwrite: Whether a file that exists is replaced.

        Returns:
            The path.

        Raises:
            FileError: The file exists, or cannot be written.
        """
        from calib.result.calibration_file import write_table

        check_path("path", path)
        return write_table(self.table(), path, overwrite=overwrite)


class Evaluation(EvaluationValues):
    """The result of `evaluate`: the values of `calib.result.evaluation.EvaluationValues`, and what writes them."""

    __slots__ = ()

    def __repr__(self) -> str:
        """One line: the robot, rms errors, number of rows."""
        from calib.text.shown.short import evaluation_line

        return evaluation_line(self)

    def _repr_html_(self) -> str:
        """A small table for notebooks: errors by set."""
        from calib.text.shown.notebook import evaluation_html

        return evaluation_html(self)

    def summary(self) -> str:
        """Return the evaluation as text, without colours, in 100 columns, as ``calib evaluate`` prints it."""
        from calib.text.evaluation import evaluation_text

        return evaluation_text(self)

    def write_report(
        self, path: str | Path, *, accepted: Acceptance | None = None, overwrite: bool = False
    ) -> Path:
        """Write the report, a page that prints on A4, with the figures of ISO 9283 and a first page to sign.

        Args:
            path: The HTML file.
            accepted: What `calib.acceptance` found of this evaluation; None: no tolerance is tested.
            overwrite: Whether a file that exists is replaced.

        Returns:
            The path.

        Raises:
            ArgumentError: An argument of another type.
            MeasurementError: No row measures anything.
            FileError: The file exists, or cannot be written.
        """
        from calib.report.evaluation_report import write_evaluation_report

        check_path("path", path)
        check_type("accepted", accepted, (Acceptance, type(None)), "of calib.acceptance, or None")
        return write_evaluation_report(Assessment.of_one(self, accepted), path, overwrite=overwrite)


calibrate = returning(Calibration, calibrate_values, __name__)
compare = returning(Comparison, compare_values, __name__)
evaluate = returning(Evaluation, evaluate_values, __name__)
