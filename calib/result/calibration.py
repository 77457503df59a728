"""Calibration: the result of `calib.calibrate` as immutable values, the same in memory and read from its file.

Measurements and solved problem, which no file holds, are its part ``fit``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.basics.arguments import check_path, check_type
from calib.basics.arrays import Array, Mask, rigid_inverse
from calib.basics.channels import Channels
from calib.basics.values import ReadOnlyMapping, Value, shown_by
from calib.boards.board import Board
from calib.camera.camera import Camera
from calib.data.cell import Cell
from calib.data.columns import SETS
from calib.data.measurements import Measurements
from calib.data.record import BLANK, Record
from calib.diagnosis.coverage import OutsideRow, outside
from calib.diagnosis.reasons import Verdict
from calib.errors import ArgumentError, ModelError, choices, did_you_mean
from calib.fit.estimate.fitting import Fitted
from calib.fit.registration.setup import Setup
from calib.fit.selection.candidates import Candidate
from calib.fit.selection.robustness import Robustness
from calib.model.kinematics import Samples
from calib.model.observability import Observability
from calib.numerics.correlated_noise import PoseNoise
from calib.numerics.errors import CrossValidation, Errors
from calib.numerics.repeats import Repeats
from calib.numerics.solvers import Solution
from calib.result.cameras import calibrated_boards, calibrated_cameras
from calib.result.image_errors import errors_at_board
from calib.result.joint_zeros import JointZeros
from calib.result.prediction import (
    FittedModel,
    NonGeometric,
    Outlier,
    ParameterEstimate,
    tells_place,
)
from calib.robot.gravity import Payload
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf

#: Number of values that stand for all those between the ends of a measured range.
_BETWEEN = 73

#: What says where a prediction is made, and with which model.
_WHERE = ("target", "group", "non_geometric")


@dataclass(frozen=True, slots=True)
class RowNames:
    """Number, set, kind, station, target and image of each of the N rows of a table."""

    #: Number in the table, from 1
    numbers: tuple[int, ...]
    #: ``"estimate"`` or ``"validate"``
    sets: tuple[str, ...]
    #: Name of the kind of measurement
    kinds: tuple[str, ...]
    #: Name of the station
    groups: tuple[str, ...]
    #: Name of the target
    targets: tuple[str, ...]
    #: Name of the image that a row is a corner in, ``""`` for other rows; empty without images
    images: tuple[str, ...] = ()

    @classmethod
    def of(cls, m: Measurements) -> RowNames:
        """Return what the rows of a table are called."""
        images = m.images if any(m.images) else ()
        return cls(m.rows, m.sets, m.kinds, m.groups, m.targets, images)

    def __len__(self) -> int:
        """The number N of rows of the table, estimation and validation rows."""
        return len(self.numbers)

    @property
    def estimation(self) -> Mask:
        """True for the rows that were fitted, those whose entry of ``sets`` is ``"estimate"``, shape (N,)."""
        return np.array([name == SETS[0] for name in self.sets], dtype=bool)

    @property
    def validation(self) -> Mask:
        """True for the rows that were only predicted, whose entry of ``sets`` is not ``"estimate"``, shape (N,)."""
        return ~self.estimation

    def images_of(self, chosen: Mask) -> int:
        """Count the images of which rows are chosen.

        Args:
            chosen: shape (N,), the rows.

        Returns:
            Their number; 0 where some of the rows are no corners in images.
        """
        if not self.images:
            return 0
        names = set(np.array(self.images)[chosen].tolist())
        return 0 if "" in names else len(names)


@dataclass(frozen=True, slots=True)
class Source:
    """The file of the measurements; both empty where there was none."""

    #: Its name
    name: str
    #: SHA-256 of its bytes, in hexadecimal digits
    sha256: str
    #: Convention of its orientations, one of `calib.data.forms.orientations.CONVENTIONS`; empty where it had none
    orientation: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class FitInMemory(Value):
    """Measurements and solved problem of a calibration that was made in this process."""

    #: All rows
    measurements: Measurements
    #: The cell as given
    cell: Cell
    #: Fit of the geometry, which the URDF holds
    geometry: Fitted
    #: Fit of the non-geometric model
    non_geometric: Fitted | None = None


@dataclass(frozen=True, slots=True, eq=False, repr=False, kw_only=True)
class Calibration(FittedModel):
    """The result of `calib.calibrate`; attributes of `FittedModel` are those of the geometry, which the URDF holds.

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

    #: The robot as given
    nominal: Robot
    #: The calibrated robot, its URDF corrected
    robot: Robot
    #: The measurements' file
    source: Source
    #: All N rows of the table
    rows: RowNames
    #: Whether the cell left the measurement frames to be estimated
    frame_estimated: bool
    #: Parameters that were kept at their nominal values
    frozen: tuple[str, ...]
    #: Parameters that follow another one, by a factor
    ties: Mapping[str, tuple[str, float]]
    #: Source of the prior standard deviations: ``"data"``, ``"given"``; ``"off"`` without priors
    prior_std_from: str
    #: Frames and targets of the nominal robot: as given, or registered
    nominal_setup: Setup
    #: Name of the solver
    solver: str
    #: Its solution, with its history
    solution: Solution
    #: Time that choosing a model, registration and estimation took [s]; NaN where unknown
    seconds: float
    #: Degrees of freedom left for the noise
    freedom: float
    #: Estimated standard deviation of one scalar (median over rows), by the units that were measured: ``"m"`` ...
    sigma: Mapping[str, float]
    #: Standard deviation of one scalar as the cell or the table states it (rms over fitted rows), by the units of which
    #: it is stated
    sigma_given: Mapping[str, float]
    #: shape (N, D), measured minus predicted by the nominal robot, all rows; ``channels`` has the unit of each entry.
    #: NaN where a measurement frame was sought and not found, see ``nominal_is_judged``
    residual_nominal: Array
    #: Shape (N, D), by the calibrated robot
    residual_calibrated: Array
    #: Unit of each entry of the residuals, (N, D), and which were measured
    channels: Channels
    #: Shape (N,), of all rows; see `calib.numerics.scores`
    scores: Array
    #: Shape (N,), of all rows in the fit, between 0 and 1; 0 for validation rows
    weights: Array
    #: Shape (m, 2), smallest and largest joint values of fitted rows [rad], [m]
    ranges: Array
    #: The score above which a row is flagged
    flag_limit: float
    #: Fitted rows flagged; without weight if robust
    outliers: tuple[Outlier, ...]
    #: Validation rows flagged; they never have weight
    suspects: tuple[Outlier, ...]
    #: The fit with weights lowered beside the one with every row in full; None without outliers, or by ``"paper"``
    robustness: Robustness | None
    #: Scatter of rows that repeat a pose; None where none does
    repeats: Repeats | None
    #: Validation rows outside of the fitted joint values
    outside: tuple[OutsideRow, ...]
    #: Of the nominal robot, its target (and frame, if estimated) fitted to the other rows
    nominal_cross_validation: CrossValidation | None
    #: Rank and unobservable directions at the measured poses
    observability: Observability
    #: The ladder that ``auto`` chose from, or empty
    candidates: tuple[Candidate, ...]
    #: The non-geometric model, if one was chosen or named
    non_geometric: NonGeometric | None
    #: None without cross-validation, unless a usual mistake explains the rows far better, or a frame was not found
    verdict: Verdict | None
    #: shape (N,), length at the board that a pixel is, of all rows [m/px]; NaN in rows that are no images, None without
    #: images. See `calib.result.image_errors`
    metres_per_pixel: Array | None = None
    #: Cameras of the images by station, as in a cell, with the numbers that the fit began with
    nominal_cameras: Mapping[str, Camera] = field(default_factory=ReadOnlyMapping)
    #: Printed boards of the images by target, as in a cell, as given; those that were not given are missing
    nominal_boards: Mapping[str, Board] = field(default_factory=ReadOnlyMapping)
    #: The best joint zeros alone; None where they cannot be fitted, or where an earlier version wrote the file
    zeros: JointZeros | None = None
    #: Scale of the stated covariances of poses, and what the robot adds to them; None where none was stated
    pose_noise: PoseNoise | None = None
    #: Who measured what for whom, where, when and with what, as the cell says
    record: Record = BLANK
    #: Measurements and solved problem; None where the result was read from a file
    fit: FitInMemory | None = field(default=None, repr=False)

    @staticmethod
    def read_json(path: str | Path) -> Calibration:
        """Read a result that `write_json` or ``calib calibrate --json`` wrote.

        Args:
            path: The file.

        Returns:
            The result; it does not hold the measurements.

        Raises:
            FileError: The file cannot be read, or is no result.
        """
        result: Calibration = shown_by("result.calibration_file").read_result(path)
        return result

    def __repr__(self) -> str:
        """One line: the nominal robot, the verdict, rms error before and after on held-out rows, number of rows."""
        return str(shown_by("verbs.calibrate.text").calibration_line(self))

    def _repr_html_(self) -> str:
        """A small table for notebooks: the verdict and its first reason, errors before and after."""
        return str(shown_by("verbs.calibrate.text").calibration_html(self))

    def summary(self) -> str:
        """Return the result as text, without colours."""
        return str(shown_by("verbs.calibrate.text").summary(self))

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
        written = shown_by("verbs.calibrate.corrected_urdf")
        urdf: Urdf = written.checked_urdf(self, target_link=target_link)
        return urdf

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
        written = shown_by("verbs.calibrate.corrected_urdf")
        return Path(
            written.write_urdf(
                self, path, overwrite=overwrite, target_link=target_link, accept=accept
            )
        )

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
        check_path("path", path)
        writer = shown_by("result.calibration_file")
        return Path(writer.write_result(self, path, overwrite=overwrite))

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
        check_path("path", path)
        report = shown_by("verbs.calibrate.report")
        return Path(report.write_report(self, path, overwrite=overwrite))

    @property
    def measurements(self) -> Measurements:
        """All rows of the table that was calibrated from; `ModelError` where the result was read from a file."""
        return self.fit_in_memory.measurements

    @property
    def cell(self) -> Cell:
        """Targets, frames, noise and priors as given; `ModelError` where the result was read from a file."""
        return self.fit_in_memory.cell

    @property
    def fitted(self) -> Fitted:
        """The fit of the geometry: task, registered frames and targets, kinematics, and estimate.

        `ModelError` where the result was read from a file, which holds no fit.
        """
        return self.fit_in_memory.geometry

    @property
    def fit_in_memory(self) -> FitInMemory:
        """Measurements, cell, and the fits of the geometry and of the non-geometric model, if there is one.

        They are held by ``fit``. Raises `ModelError` where it is None, because the result was read from a file.
        """
        if self.fit is None:
            raise ModelError(
                "This result was read from a file, which holds neither the measurements nor the solved problem. "
                "Calibrate again for what needs them."
            )
        return self.fit

    @property
    def used(self) -> Mask:
        """True for the entries of the residuals that were measured, of ``channels``, shape (N, D)."""
        return self.channels.used

    @property
    def T_frame_base(self) -> Array:
        """Pose of the base in the (first) measurement frame of ``setup``, estimated or given, shape (4, 4), [m]."""
        return np.asarray(self.setup.T_frame_base[0])

    @property
    def target(self) -> Array:
        """Position of the (first) target of ``setup`` in the tip, estimated or given, shape (3,), [m]."""
        return np.asarray(self.setup.T_tip_target[0, :3, 3])

    @property
    def cameras(self) -> Mapping[str, Camera]:
        """Cameras with their numbers as estimated, and the standard deviations of these; by station, as in a cell.

        Their names are those of ``nominal_cameras``; `calib.camera.camera_file` writes them for ROS and OpenCV.
        """
        return calibrated_cameras(self.nominal_cameras, self)

    def with_optics(self, cell: Cell) -> Cell:
        """Return a cell with the cameras and boards that this result began with, where it gives none of its own.

        Args:
            cell: The cell.
        """
        return replace(
            cell,
            cameras=cell.cameras or self.nominal_cameras,
            boards=cell.boards or self.nominal_boards,
        )

    @property
    def boards(self) -> Mapping[str, Board]:
        """Printed boards with their squares as estimated: as given, times 1 plus the mean error of scale; by target."""
        return calibrated_boards(self.nominal_boards, self)

    @property
    def nominal_is_judged(self) -> bool:
        """True unless a measurement frame was sought and not found: then the nominal robot has no known errors."""
        return not np.isnan(self.residual_nominal).any()

    @property
    def errors_at_board(self) -> dict[str, Errors]:
        """Errors of images as lengths at the board [m], by what the error tables call the rows; empty without images.

        Such as ``["estimation rows, calibrated"]["m"].rms``; those of held-out rows are ``["held-out rows*,
        calibrated"]``.
        """
        if self.metres_per_pixel is None:
            return {}
        of_estimation = self.rows.estimation
        scale = self.metres_per_pixel
        every = np.ones(int(np.sum(of_estimation)), dtype=bool)
        held_out_channels = self.channels.select(of_estimation)
        result = {}
        residuals = (("nominal", self.residual_nominal), ("calibrated", self.residual_calibrated))
        sets = (("estimation", of_estimation), ("validation", self.rows.validation))
        for set_name, rows in sets:
            for who, residual in residuals:
                if np.any(rows):
                    errors = errors_at_board(residual, self.channels, scale, rows)
                    result[f"{set_name} rows, {who}"] = errors
        validations = (
            ("nominal", self.nominal_cross_validation),
            ("calibrated", self.cross_validation),
        )
        for who, validation in validations:
            if validation is not None and len(validation.residual) == len(every):
                errors = errors_at_board(
                    validation.residual, held_out_channels, scale[of_estimation], every
                )
                result[f"held-out rows*, {who}"] = errors
        return result

    @property
    def errors(self) -> dict[str, dict[str, Errors]]:
        """``errors["nominal" | "calibrated" | "non_geometric"]["estimation" | "validation"]``.

        Largest, mean and rms error in each unit that was measured, such as ``["m"]``, of the nominal robot
        (``residual_nominal``), of the calibrated one (``residual_calibrated``), and of the non-geometric model if there
        is one, over the rows that were fitted and over those that were only predicted. Residuals are measured minus
        predicted, shape (N, D), of N rows; ``channels`` has their units.
        """
        residuals = {"nominal": self.residual_nominal, "calibrated": self.residual_calibrated}
        if self.non_geometric is not None:
            residuals["non_geometric"] = self.non_geometric.residual
        sets = (("estimation", self.rows.estimation), ("validation", self.rows.validation))
        errors = {}
        for robot, residual in residuals.items():
            errors[robot] = {
                name: Errors.of(residual[rows], self.channels.select(rows)) for name, rows in sets
            }
        return errors

    def parameter(self, name: str) -> ParameterEstimate:
        """Return one parameter by its exact name: of the geometry, else of the non-geometric model.

        ``parameters`` are those of the geometry, in the order of ``model.names``; ``non_geometric`` has its own, or is
        None.

        Args:
            name: Such as ``"d1"`` or ``"elbow_joint.rx"``.

        Returns:
            Its nominal and its calibrated value, standard deviation and interval, in its unit.

        Raises:
            ModelError: Neither has it.
        """
        other = self.non_geometric
        if name not in self.model.names and other is not None and name in other.model.names:
            return other.parameters[other.model.index(name)]
        return self.parameters[self.model.index(name)]

    @property
    def tells_place(self) -> bool:
        """True if some row, by its kind in ``rows.kinds``, determines where the base stands, such as a measured point.

        If none does, as where only sockets, planes, anchors or pairs were measured, predictions are in the base.
        """
        return tells_place(self.rows.kinds)

    def verdict_on(self, *, non_geometric: bool) -> Verdict | None:
        """Return the verdict on the model with which one predicts.

        Args:
            non_geometric: True to use the model of the field ``non_geometric``, if there is one; False: the geometry.

        Returns:
            The verdict on the non-geometric model if it is to be used and has one, else ``verdict``, that on the
            geometry; None where there is none.
        """
        if non_geometric and self.non_geometric is not None and self.non_geometric.verdict:
            return self.non_geometric.verdict
        return self.verdict

    def part(self, *, non_geometric: bool) -> FittedModel:
        """Return the model to predict with.

        Args:
            non_geometric: True to take the model of the field ``non_geometric``, whose errors depend on the joints'
                state, if there is one; False: the geometry.

        Returns:
            The non-geometric model, or this result itself, which is the model of the geometry that the URDF holds.
        """
        if non_geometric and self.non_geometric is not None:
            return self.non_geometric
        return self

    def samples(
        self,
        q: ArrayLike,
        *,
        target: str | None = None,
        group: str | None = None,
        payload: Payload | None = None,
    ) -> Samples:
        """Return joint values as a prediction takes them, with frame, target, and the loads on the joints.

        Names of stations and targets are those of ``setup``. The loads are those by ``non_geometric`` with its gravity.

        Args:
            q: shape (N, m) or (m,), joint values in the robot's order, [rad] or [m].
            target: Name of the target; None: the first.
            group: Name of the station, which has one measurement frame; None: the first.
            payload: Point mass that the tip carries; None: that of the measurements. It counts for a non-geometric
                model only.

        Returns:
            N samples: the joint values, shape (N, m); the index of the frame and of the target of each, from 0; and the
            loads of gravity on the joints, see `gravity_loads`, None where the result has no non-geometric model.

        Raises:
            ModelError: There is no such target or station.
        """
        values = self.nominal.columns(q)
        check_type("payload", payload, (Payload, type(None)), "a Payload, or None")
        load = None
        if self.non_geometric is not None:
            load = self.non_geometric.load(self.nominal, values, payload)
        samples = Samples.at(values, load)
        return replace(
            samples,
            frame=_repeated_index("station", group, self.setup.groups, len(values)),
            target=_repeated_index("target", target, self.setup.targets, len(values)),
        )

    def predict_poses(
        self,
        q: ArrayLike,
        *,
        target: str | None = None,
        group: str | None = None,
        non_geometric: bool = True,
    ) -> Array:
        """Predict calibrated T_frame_target by the non-geometric model if there is one, else by the geometry.

        T_frame_target is the pose of the target in the measurement frame. By ``kinematics`` and parameters ``x`` of the
        chosen model, with the frames and targets that were estimated or given.

        Args:
            q: shape (N, m) or (m,), joint values in the robot's order, [rad] or [m].
            target: Name of the target; None: the first.
            group: Name of the station whose frame is meant; None: the first, or the base where no row determines where
                it stands.
            non_geometric: Whether to use the non-geometric model, if there is one, with the payload of the
                measurements; else the geometry of the URDF.

        Returns:
            shape (N, 4, 4), [m].

        Raises:
            ModelError: There is no such target or station.
        """
        part = self.part(non_geometric=non_geometric)
        poses = part.kinematics.poses(part.x, self.samples(q, target=target, group=group))
        if group is None and not self.tells_place:
            poses = rigid_inverse(part.setup.T_frame_base[0]) @ poses
        return poses

    def predict(self, q: ArrayLike, **where: Any) -> Array:  # noqa: ANN401  as of predict_poses
        """Predict calibrated positions by the non-geometric model if there is one, else by the geometry.

        They are those of the target in the measurement frame.

        Args:
            q: shape (N, m) or (m,), joint values in the robot's order, [rad] or [m].
            **where: Arguments of `predict_poses`: ``target`` and ``group``, names of the target and of the station,
                each the first where it is not given; and ``non_geometric``, False to use the geometry of the URDF
                alone.

        Returns:
            shape (N, 3), [m]; in the base where no row determines where it stands and no station is named.

        Raises:
            ModelError: There is no such target or station.
        """
        unknown = [name for name in where if name not in _WHERE]
        if unknown:
            raise ArgumentError(
                f"A prediction has no argument {choices(unknown)}{did_you_mean(unknown[0], _WHERE)}; there are "
                f"{choices(_WHERE)}."
            )
        return self.predict_poses(q, **where)[:, :3, 3]

    def position_std(
        self,
        q: ArrayLike,
        *,
        target: str | None = None,
        group: str | None = None,
        non_geometric: bool = True,
    ) -> Array:
        """Return the standard deviation of `predict`, by the non-geometric model if there is one, else the geometry.

        It is sqrt(trace(J C J^T)). C is the ``covariance`` of the p parameters of the chosen model and J, shape (3, p),
        the derivative of the position by them. Where only sockets, planes, anchors or pairs were measured, and no group
        is named, it leaves out what moves all positions as one body. It knows nothing of errors that the model lacks.

        Args:
            q: shape (N, m) or (m,), joint values in the robot's order, [rad] or [m].
            target: Name of the target; None: the first.
            group: Name of the station whose frame is meant; None: the first, or the base where no row determines where
                it stands.
            non_geometric: Whether to use the non-geometric model, if there is one; else the geometry of the URDF.

        Returns:
            shape (N,), [m], of the three axes together.

        Raises:
            ModelError: There is no such target or station.
        """
        part = self.part(non_geometric=non_geometric)
        samples = self.samples(q, target=target, group=group)
        in_base = group is None and part.base_motion is not None
        return part.pose_std(samples, in_base=in_base)[:, 0]

    def tip_poses(self, q: ArrayLike, *, payload: Payload | None = None) -> Array:
        """Predict calibrated T_base_tip by the non-geometric model if there is one, else by the geometry, ``robot``.

        Args:
            q: shape (N, m) or (m,), joint values in the robot's order, [rad] or [m].
            payload: Point mass that the tip carries; None: that of the measurements. It counts for a non-geometric
                model only.

        Returns:
            shape (N, 4, 4), pose of the tip in the base, [m].
        """
        if self.non_geometric is None:
            check_type("payload", payload, (Payload, type(None)), "a Payload, or None")
            return self.robot.poses(q)
        return self.non_geometric.tips(self.samples(q, payload=payload))

    def outside_of_measured(self, q: ArrayLike) -> tuple[OutsideRow, ...]:
        """List the joint values that lie outside of the ranges that were fitted.

        With ``ranges``, shape (m, 2), the smallest and largest joint values of fitted rows, [rad] or [m]. A margin of 5
        % of the range is allowed; a continuous joint's range may pass the full turn.

        Args:
            q: shape (N, m) or (m,), joint values in the robot's order, [rad] or [m].

        Returns:
            The rows of ``q`` with a joint outside, each by its index, from 0, with the joints and their distances from
            the range, [rad] or [m]; empty where the fitted ranges are not known.
        """
        values = self.nominal.columns(q)
        if not np.isfinite(self.ranges).all():
            return ()
        seen = np.linspace(self.ranges[:, 0], self.ranges[:, 1], _BETWEEN)
        types = [joint.type for joint in self.nominal.inputs]
        return outside(seen, values, self.nominal.joint_names, types)

    def corrected(self, robot: Robot) -> Robot:
        """Return a robot with the calibrated joint origins, base and tip of this result, those of its ``robot``.

        Args:
            robot: A URDF of this robot, nominal or corrected, such as one with meshes.

        Returns:
            The same URDF with these origins, base and tip; all else is its own.

        Raises:
            UrdfError: It lacks one of the joints.
        """
        return _with_origins_of(self.robot, robot)

    def uncorrected(self, robot: Robot) -> Robot:
        """Return a robot with the nominal joint origins of this result, those of its ``nominal``.

        Args:
            robot: A URDF of this robot, nominal or corrected.

        Returns:
            The same URDF with these origins and the base and tip of the nominal robot; all else is its own.

        Raises:
            UrdfError: It lacks one of the joints.
        """
        return _with_origins_of(self.nominal, robot)


def _with_origins_of(source: Robot, robot: Robot) -> Robot:
    """Return a robot with the joint origins, base and tip of another one.

    Args:
        source: The robot whose joint origins, poses of each joint in the link before it, base link and tip link are
            taken.
        robot: A URDF of the same robot, which gives all else, such as meshes.

    Returns:
        A new robot; both given ones stay as they are.

    Raises:
        UrdfError: It lacks one of the joints.
        ModelError: Its readings are coupled otherwise.
    """
    check_type("robot", robot, Robot, "a Robot")
    check_same_coupling(robot, source)
    urdf = robot.urdf.with_origins(source.origins())
    return robot.rebuilt(urdf, source.base, source.tip)


def _repeated_index(
    what: str,
    name: str | None,
    names: tuple[str, ...],
    count: int,
) -> NDArray[np.int_]:
    """Return the index of a station or target among all, once for each sample.

    Args:
        what: What is named, for the error message: ``"station"`` or ``"target"``.
        name: One of the names; None: the first.
        names: All names.
        count: Number N of samples.

    Returns:
        The index, from 0, in all elements, shape (N,).

    Raises:
        ModelError: It is none of the names.
    """
    if name is not None and name not in names:
        raise ModelError(f"There is no {what} '{name}'; there is {choices(names)}.")
    index = 0 if name is None else names.index(name)
    return np.full(count, index)


def check_same_coupling(robot: Robot, source: Robot) -> None:
    """Refuse a robot whose joint readings are coupled otherwise than those of the robot that it belongs to.

    Args:
        robot: As given.
        source: The robot of a result, or another model of the same arm.

    Raises:
        ModelError: They differ: the same table would mean other joint angles.
    """
    if robot.reading_coupling != source.reading_coupling:
        raise ModelError(
            f"The joint readings of '{robot.name}' ({robot.urdf.source}) are coupled by {robot.reading_coupling}, "
            f"those of the robot that it belongs to by {source.reading_coupling}. Give its path in place of the Robot, "
            f"or load it so: Robot.load(..., coupling={source.reading_coupling})."
        )
