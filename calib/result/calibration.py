"""Calibration: the result of `calib.calibrate` as immutable values, the same in memory and read from its file.

Its parts are in `calib.result.parts`, fitted models in `calib.result.fitted_model`. Measurements and solved problem,
which no file holds, are its part ``fit``.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

import calib.data.kinds as registry
from calib.basics.arguments import check_path, check_type, finite_numbers
from calib.basics.arrays import Array, rigid_inverse
from calib.basics.frames import Library
from calib.basics.json_files import digest
from calib.basics.values import Value, shown_by
from calib.data.cell import Cell
from calib.data.record import BLANK, Record
from calib.data.stated_uncertainty import NOT_STATED, StatedUncertainty
from calib.diagnosis.coverage import OutsideRow, outside
from calib.diagnosis.frame_drift import FrameDrift
from calib.diagnosis.reasons import Verdict
from calib.errors import ArgumentError, ModelError, choices, did_you_mean
from calib.fit.registration.setup import Setup
from calib.model.error_model import ErrorModel
from calib.model.kinematics import Samples
from calib.numerics.errors import CrossValidation, Errors
from calib.numerics.moves import last_moves
from calib.result.fitted_model import FittedModel, NonGeometric, ParameterEstimate
from calib.result.joint_zeros import JointZeros
from calib.result.parts import FitInMemory, Method, Noise, ResultRows, Source, Trust
from calib.result.result_optics import ResultOptics
from calib.robot.gravity import Payload
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Number of values that stand for all those between the ends of a measured range.
_BETWEEN = 73

#: Origins of one robot differ by rounding [m; rotation matrices: 1].
_SAME = 1e-9

#: Digits of a run's id: by chance two of a million runs share one with a probability of 0.2 %.
_RUN_DIGITS = 12

#: Degrees of freedom from which on the noise is estimated from the rows, not from its prior.
ENOUGH_FREEDOM = 6.0

#: Arguments of a prediction: where it is made, and with which model.
_WHERE = ("target", "group", "non_geometric", "moves")


@dataclass(frozen=True, slots=True, eq=False, repr=False, kw_only=True)
class Calibration(Value):
    """The result of `calib.calibrate`, in parts.

    There are two ways to get one: `calib.calibrate`, and `Calibration.read_json` of a file that `write_json` wrote. It
    can be pickled and copied, with measurements and fit if it has them. Arrays are read-only.

        robot            the calibrated robot; nominal, nominal_setup: robot, frames and targets before
        geometry         the fitted model of the URDF: parameters, covariance, frames and targets, predictions, verdict
        non_geometric    the fitted model with errors of the joints' state, or None
        rows             of each row its names, residuals, score, weight; outliers, joint ranges
        noise            standard deviation of a scalar, scatter of repeats, noise of poses
        trust            cross-validation of the nominal robot, observability, robustness
        method           what the fit was told, candidates, solver
        optics           cameras and boards of images
        zeros            the best joint zeros alone, or None
        drift            what targets that stand still show, or None
        source, record   the table, and who measured it for whom, where and with what
        stated_uncertainty   what is stated of instrument, arm and setup, for the budget
        fit              measurements and solved problem; fit_in_memory: the same, None if read from a file

    At hand without their part: ``verdict``, ``errors``, ``cross_validation``, ``new_point``, ``parameters``,
    ``covariance``, ``model``, ``setup``, ``T_frame_base``, ``target``; ``is_setup_only`` if these were all that was
    sought. ``run`` is the id that all files of the result carry, ``figures`` are the names of those that `plot` draws.
    ``unknown_accuracy`` says why nothing tells how accurate it is; empty if `uncertainty` and `budget` mean something.
    """

    #: The robot as given
    nominal: Robot
    #: The calibrated robot: its URDF corrected by the geometry, with the run, and a verdict ``do not use``, as comments
    robot: Robot
    #: Frames and targets of the nominal robot: as given, or registered
    nominal_setup: Setup
    #: The fitted model of the geometry, which the URDF holds
    geometry: FittedModel
    #: The fitted model with errors of the joints' state, if one was chosen or named
    non_geometric: NonGeometric | None
    #: The rows of the table: names, residuals, scores and weights
    rows: ResultRows
    #: The noise of the measurements
    noise: Noise
    #: How far to trust the result
    trust: Trust
    #: How the fit was made
    method: Method
    #: Cameras and boards of images
    optics: ResultOptics
    #: The best joint zeros alone; None if they cannot be fitted, or if an earlier version wrote the file
    zeros: JointZeros | None = None
    #: What targets that stand still show of the drift of the measurement frames; None without such targets
    drift: FrameDrift | None = None
    #: The measurements' file
    source: Source
    #: Who measured what for whom, where, when and with what, as the cell says
    record: Record = BLANK
    #: What is stated of instrument, arm and setup for the uncertainty budget, as the cell says
    stated_uncertainty: StatedUncertainty = NOT_STATED
    #: Measurements and solved problem; None if the result was read from a file
    fit_in_memory: FitInMemory | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        """State run and verdict in the calibrated robot's URDF, whoever writes it."""
        object.__setattr__(self, "robot", self._described(self.robot))

    @staticmethod
    def read_json(path: str | Path) -> Calibration:
        """Read a result that `write_json` or ``calib calibrate --json`` wrote.

        Args:
            path: The file.

        Returns:
            The result; it does not hold the measurements.

        Raises:
            FileError: The file cannot be read, or is not a result.
        """
        result: Calibration = shown_by("result.calibration_file").read_result(path)
        return result

    def __repr__(self) -> str:
        """One line: the nominal robot, the verdict, rms error before and after on held-out rows, number of rows."""
        return str(shown_by("verbs.calibrate.text").calibration_line(self))

    def _repr_html_(self) -> str:
        """A small table for notebooks: the verdict and its first reason, errors before and after."""
        return str(shown_by("verbs.calibrate.report").calibration_html(self))

    def summary(self) -> str:
        """Return the result as text, without colours."""
        return str(shown_by("verbs.calibrate.report").summary(self))

    def checked_urdf(self, *, target_link: bool = False, frame_link: bool = False) -> Urdf:
        """Return the URDF that `write_urdf` writes, read back with Pinocchio and calib.

        A verdict ``do not use`` stands in it as a comment; it is not obeyed here.

        Args:
            target_link: Whether it has a link ``calib_target`` at the target, fixed to its link; of several targets
                ``calib_target_NAME`` at each.
            frame_link: Whether it has a link ``calib_frame`` at the measurement frame; of several ``calib_frame_NAME``
                at each that has a pose.

        Returns:
            The corrected URDF, the geometry alone.

        Raises:
            UrdfError: A reader disagrees with the model in memory by more than 1e-9 m or rad, or
                the URDF has another link of such a name.
            ModelError: ``frame_link`` if no frame has a pose.
        """
        written = shown_by("verbs.calibrate.write_urdf")
        urdf: Urdf = written.checked_urdf(self, target_link=target_link, frame_link=frame_link)
        return urdf

    def write_urdf(
        self,
        path: str | Path,
        *,
        overwrite: bool = False,
        target_link: bool = False,
        frame_link: bool = False,
        accept: bool = False,
    ) -> Path:
        """Write the corrected URDF, the geometry alone, after reading it back with Pinocchio and calib.

        Args:
            path: The file.
            overwrite: Whether a file that exists is replaced.
            target_link: Whether it has a link ``calib_target`` at the target, fixed to its link; of several targets
                ``calib_target_NAME`` at each.
            frame_link: Whether it has a link ``calib_frame`` at the measurement frame; of several ``calib_frame_NAME``
                at each that has a pose.
            accept: Whether it is written also where the verdict is ``do not use``; the verdict then stands in it as a
                comment before ``<robot>``.

        Returns:
            The path.

        Raises:
            ArgumentError: The path is of another type.
            VerdictError: The verdict is ``do not use``, and ``accept`` is not given.
            UrdfError: A reader disagrees with the model in memory by more than 1e-9 m or rad, or the URDF has another
                link of such a name.
            ModelError: ``frame_link`` if no frame has a pose.
            FileError: The file exists, or cannot be written.
        """
        check_path("path", path)
        written = shown_by("verbs.calibrate.write_urdf")
        return Path(
            written.write_urdf(
                self,
                path,
                overwrite=overwrite,
                target_link=target_link,
                frame_link=frame_link,
                accept=accept,
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
            ArgumentError: The path is of another type.
            FileError: The file exists, or cannot be written.
        """
        check_path("path", path)
        writer = shown_by("result.calibration_file")
        return Path(writer.write_result(self, path, overwrite=overwrite))

    def write_report(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the report, a page with figures that prints on A4.

        Args:
            path: The file, a page (.html) or a PDF (.pdf), which an installed Chromium, Chrome or Edge prints.
            overwrite: Whether a file that exists is replaced.

        Returns:
            The path.

        Raises:
            ArgumentError: The path is of another type.
            ModelError: The result was read from a file, which does not hold the measurements.
            CalibError: Matplotlib is missing, which draws the figures: ``pip install 'robot-calib[report]'``.
            FileError: The file exists, or cannot be written.
        """
        check_path("path", path)
        report = shown_by("verbs.calibrate.report")
        return Path(report.write_report(self, path, overwrite=overwrite))

    def to_frame(
        self,
        content: Literal["rows", "parameters", "covariance"] = "rows",
        library: Library = "pandas",
        *,
        non_geometric: bool = False,
    ) -> Any:  # noqa: ANN401  of any library
        """Return the rows with their errors, the parameters, or their covariance, as a frame.

        Args:
            content: ``"rows"``: names, errors of each robot and residuals [mm], [deg], [px], score and weight of each
                row; ``"parameters"``: the fields of `parameters` in their units; ``"covariance"``: that of the
                parameters, by their names.
            library: ``"pandas"`` or ``"polars"``.
            non_geometric: Whether parameters and covariance are those of the non-geometric model, if there is one.

        Returns:
            A ``pandas.DataFrame`` or a ``polars.DataFrame``. Of pandas the covariance has the parameters' names as its
            index, of polars in the column ``parameter``.

        Raises:
            CalibError: The library is not installed; or another one, or another content, was named.
        """
        frames = shown_by("result.result_frames")
        return frames.result_frame(self, content, library, non_geometric=non_geometric)

    @property
    def figures(self) -> tuple[str, ...]:
        """Names of the figures of the report, which `plot` draws.

        Raises `ModelError` if the result was read from a file, which does not hold the measurements.
        """
        drawings = shown_by("verbs.calibrate.figures").drawings(self)
        return tuple(drawing.name for drawing in drawings)

    def plot(self, name: str) -> Figure:
        """Draw a figure of the report.

        Args:
            name: One of `figures`, such as ``"error-curves"``.

        Returns:
            A ``matplotlib.figure.Figure``, to be shown in a notebook or saved by its ``savefig``.

        Raises:
            CalibError: There is no such figure, or matplotlib is missing: ``pip install 'robot-calib[report]'``.
            ModelError: The result was read from a file, which does not hold the measurements.
        """
        figure: Figure = shown_by("verbs.calibrate.figures").figure_of(self, name)
        return figure

    @property
    def fit(self) -> FitInMemory:
        """Measurements, cell, and the fits of the geometry and of the non-geometric model, if there is one.

        Raises `ModelError` if the result was read from a file, which does not hold them (``fit_in_memory`` is None).
        """
        if self.fit_in_memory is None:
            raise ModelError(
                "This result was read from a file, which holds neither the measurements nor the solved problem. "
                "Calibrate again for what needs them."
            )
        return self.fit_in_memory

    @property
    def run(self) -> str:
        """The id of the run, 12 hexadecimal digits, which its URDF, result file, report and pages carry.

        It is made of the nominal URDF, the chain, the table and the fitted models. So the same run made again has the
        same id if its numbers are the same to the last digit.
        """
        computed: list[Any] = [self.nominal.urdf.sha256, self.nominal.base, self.nominal.tip]
        computed += [link for chain in self.nominal.branches for link in (chain.base, chain.tip)]
        computed.append(self.source.sha256)
        for model in (self.geometry, self.non_geometric):
            if model is not None:
                setup = model.setup
                computed += [model.model.name, model.x, setup.T_frame_base, setup.T_tip_target]
        return digest(computed)[:_RUN_DIGITS]

    @property
    def verdict(self) -> Verdict | None:
        """The verdict on the geometry; None without cross-validation, unless the input is wrong."""
        return self.geometry.verdict

    @property
    def cross_validation(self) -> CrossValidation | None:
        """Errors of the geometry on held-out rows; None without cross-validation."""
        return self.geometry.cross_validation

    @property
    def new_point(self) -> tuple[float, float]:
        """Expected error at a new point by the geometry, rms [m]: at poses like those measured, and over the limits."""
        return self.geometry.new_point

    @property
    def unknown_accuracy(self) -> Literal["", "verdict", "rows", "stops"]:
        """Why nothing tells how accurate predictions are; empty if the expected error and the budget mean something.

        ``"verdict"``: a usual mistake explains the rows, or a frame was not found, so that what was fitted does not
        exist. ``"rows"``: too few rows without cross-validation; prior standard deviations estimated from nothing
        shrink to nothing, and the expected error with them. ``"stops"``: end stops tell nothing of lengths.
        """
        if self.cross_validation is None and self.verdict is not None:
            return "verdict"
        if self.cross_validation is None and self.noise.freedom < ENOUGH_FREEDOM:
            return "rows"
        if all(registry.get(kind).of_joint for kind in self.rows.kinds):
            return "stops"
        return ""

    @property
    def model(self) -> ErrorModel:
        """The error model of the geometry: names, units and places of the p parameters."""
        return self.geometry.model

    @property
    def is_setup_only(self) -> bool:
        """True if frames and targets alone were sought: the user named the model ``frames``."""
        return self.model.name == "frames" and not self.method.candidates

    @property
    def parameters(self) -> tuple[ParameterEstimate, ...]:
        """Nominal and calibrated value, standard deviation and interval of the p parameters of the geometry."""
        return self.geometry.parameters

    @property
    def covariance(self) -> Array:
        """Covariance of the p parameters of the geometry, shape (p, p)."""
        return self.geometry.covariance

    @property
    def setup(self) -> Setup:
        """Frames (T_frame_base) and targets (T_tip_target) as estimated or given, by the geometry [m]."""
        return self.geometry.setup

    @property
    def T_frame_base(self) -> Array:
        """Pose of the base in the (first) measurement frame of ``setup``, estimated or given, shape (4, 4), [m]."""
        return np.asarray(self.setup.T_frame_base[0])

    @property
    def target(self) -> Array:
        """Position of the (first) target of ``setup`` in the tip, estimated or given, shape (3,), [m]."""
        return np.asarray(self.setup.T_tip_target[0, :3, 3])

    @property
    def errors(self) -> dict[str, dict[str, Errors]]:
        """``errors["nominal" | "calibrated" | "non_geometric"]["estimation" | "validation"]``.

        Largest, mean and rms error in each unit that was measured, such as ``["m"].rms``, of the nominal robot, of the
        calibrated one, and of the non-geometric model if there is one, over the rows that were fitted and over those
        that were only predicted.
        """
        rows = self.rows
        residuals = {"nominal": rows.residual_nominal, "calibrated": rows.residual_calibrated}
        if self.non_geometric is not None:
            residuals["non_geometric"] = self.non_geometric.residual
        sets = (("estimation", rows.estimation), ("validation", rows.validation))
        errors = {}
        for robot, residual in residuals.items():
            errors[robot] = {
                name: Errors.of(residual[chosen], rows.channels.select(chosen))
                for name, chosen in sets
            }
        return errors

    def parameter(self, name: str) -> ParameterEstimate:
        """Return one parameter by its exact name: of the geometry, else of the non-geometric model.

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

    def verdict_on(self, *, non_geometric: bool) -> Verdict | None:
        """Return the verdict on the model with which one predicts.

        Args:
            non_geometric: True to use the model of the field ``non_geometric``, if there is one; False: the geometry.

        Returns:
            The verdict on the non-geometric model if that is asked for and has one, else that on the geometry; None if
            there is none, as without cross-validation.
        """
        verdict = self.part(non_geometric=non_geometric).verdict
        return self.verdict if verdict is None else verdict

    def part(self, *, non_geometric: bool) -> FittedModel:
        """Return the model to predict with.

        Args:
            non_geometric: True to take the model of the field ``non_geometric``, whose errors depend on the joints'
                state, if there is one; False: the geometry.

        Returns:
            The non-geometric model, or the geometry, which the URDF holds.
        """
        if non_geometric and self.non_geometric is not None:
            return self.non_geometric
        return self.geometry

    def samples(
        self,
        q: ArrayLike,
        *,
        target: str | None = None,
        group: str | None = None,
        payload: Payload | None = None,
        moves: ArrayLike | None = None,
    ) -> Samples:
        """Return joint values as a prediction takes them, with frame, target, loads and last moves of the joints.

        Names of stations and targets are those of ``setup``.

        Args:
            q: shape (N, m) or (m,), joint values in the robot's order, [rad] or [m].
            target: Name of the target; None: the first.
            group: Name of the station, which has one measurement frame; None: the first.
            payload: Point mass that the tip carries; None: that of the measurements. It counts for a non-geometric
                model only.
            moves: shape (N, m), last move of each joint before each row, [rad] or [m], 0 where it is not known; None:
                the robot goes from each row of ``q`` to the next. It counts for a model with lost motion only.

        Returns:
            N samples: the joint values, shape (N, m); the index of the frame and of the target of each, from 0; the
            loads of gravity on the joints, see `gravity_loads`, None if the result has no non-geometric model; and the
            last moves.

        Raises:
            ArgumentError: ``q`` is not made of numbers, or the payload is of another type.
            ModelError: There is no such target or station, ``q`` has another shape, or a value is not finite.
        """
        values = self.nominal.columns(q)
        check_type("payload", payload, (Payload, type(None)), "a Payload, or None")
        load = None
        if self.non_geometric is not None:
            load = self.non_geometric.load(self.nominal, values, payload)
        if moves is None:
            known_moves = last_moves(values)
        else:
            known_moves = finite_numbers("moves", moves, values.shape, "one number for each of q")
        samples = Samples.at(values, load, known_moves)
        frame = _repeated_index("station", group, self.setup.groups, len(values))
        target_index = _repeated_index("target", target, self.setup.targets, len(values))
        chain = self.setup.chains(self.nominal, frame, target_index)
        return replace(samples, frame=frame, target=target_index, chain=chain)

    def transform(self, from_name: str, to_name: str) -> Any:  # noqa: ANN401  made in a module above
        """Return the constant pose of one thing in another on the same rigid body, with its covariance.

        It is that of the geometry: of two cameras on a wall, two boards on a hand, a tracker and a base, two robots.

        Args:
            from_name: Name of a station, which stands for its measurement frame (``"frame"`` if the table has none), a
                target, a further robot (its root link), or a link; ``"station:left"``, ``"target:left"``,
                ``"robot:left"``, ``"link:left"`` if several things are called left.
            to_name: Name of the one whose pose is wanted.

        Returns:
            A `calib.result.transforms.Transform`: ``pose``, T_from_to (4, 4) [m], and ``covariance`` (6, 6) of the
            displacement [m] and rotation [rad] of ``to`` along and about the axes of ``from``.

        Raises:
            ModelError: There is nothing of that name, two things have it, no row determines its pose, or joints move
                between them.
        """
        transforms = shown_by("result.transforms")
        return transforms.transform(self, from_name, to_name)

    def predict_poses(
        self,
        q: ArrayLike,
        *,
        target: str | None = None,
        group: str | None = None,
        non_geometric: bool = True,
        moves: ArrayLike | None = None,
    ) -> Array:
        """Predict calibrated T_frame_target by the non-geometric model if there is one, else by the geometry.

        T_frame_target is the pose of the target in the measurement frame.

        Args:
            q: shape (N, m) or (m,), joint values in the robot's order, [rad] or [m].
            target: Name of the target; None: the first.
            group: Name of the station whose frame is meant; None: the first, or the base if no row determines where it
                stands.
            non_geometric: Whether to use the non-geometric model, if there is one, with the payload of the
                measurements; else the geometry of the URDF.
            moves: shape (N, m), last move of each joint before each row, [rad] or [m], 0 where it is not known; None:
                the robot goes from each row of ``q`` to the next. It counts for a model with lost motion only.

        Returns:
            shape (N, 4, 4), [m].

        Raises:
            ArgumentError: ``q`` is not made of numbers.
            ModelError: There is no such target or station, ``q`` has another shape, or a value is not finite.
        """
        part = self.part(non_geometric=non_geometric)
        poses = part.kinematics.poses(
            part.x, self.samples(q, target=target, group=group, moves=moves)
        )
        if group is None and not self.rows.tells_place:
            poses = rigid_inverse(part.setup.T_frame_base[0]) @ poses
        return poses

    def predict(self, q: ArrayLike, **where: Any) -> Array:  # noqa: ANN401  as of predict_poses
        """Predict calibrated positions by the non-geometric model if there is one, else by the geometry.

        They are those of the target in the measurement frame.

        Args:
            q: shape (N, m) or (m,), joint values in the robot's order, [rad] or [m].
            **where: Arguments of `predict_poses`: ``target`` and ``group``, names of the target and of the station,
                each the first if it is not given; ``non_geometric``, False to use the geometry of the URDF
                alone; and ``moves``, if the rows are not in the order in which the robot goes through them.

        Returns:
            shape (N, 3), [m]; in the base if no row determines where it stands and no station is named.

        Raises:
            ArgumentError: An argument of another name, or ``q`` is not made of numbers.
            ModelError: There is no such target or station, ``q`` has another shape, or a value is not finite.
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
        moves: ArrayLike | None = None,
    ) -> Array:
        """Return the standard deviation of `predict`, by the non-geometric model if there is one, else the geometry.

        It is sqrt(trace(J C J^T)). C is the ``covariance`` of the p parameters of the chosen model and J, shape (3, p),
        the derivative of the position by them. If only sockets, planes, anchors or pairs were measured, and no group is
        named, it leaves out what moves all positions as one body. Errors that the model lacks are not included.

        Args:
            q: shape (N, m) or (m,), joint values in the robot's order, [rad] or [m].
            target: Name of the target; None: the first.
            group: Name of the station whose frame is meant; None: the first, or the base if no row determines where it
                stands.
            non_geometric: Whether to use the non-geometric model, if there is one; else the geometry of the URDF.
            moves: shape (N, m), last move of each joint before each row, [rad] or [m], 0 where it is not known; None:
                the robot goes from each row of ``q`` to the next. It counts for a model with lost motion only.

        Returns:
            shape (N,), [m], of the three axes together.

        Raises:
            ArgumentError: ``q`` is not made of numbers.
            ModelError: There is no such target or station, ``q`` has another shape, or a value is not finite.
        """
        part = self.part(non_geometric=non_geometric)
        samples = self.samples(q, target=target, group=group, moves=moves)
        in_base = group is None and part.base_motion is not None
        return part.pose_std(samples, in_base=in_base)[:, 0]

    def uncertainty(
        self,
        q: ArrayLike,
        *,
        target: str | None = None,
        group: str | None = None,
        non_geometric: bool = True,
        moves: ArrayLike | None = None,
    ) -> Any:  # noqa: ANN401  made in a module above
        """Return the expanded uncertainty of predicted poses, with what the model lacks, and its sources.

        Args:
            q: shape (N, m) or (m,), joint values in the robot's order, [rad] or [m].
            target: Name of the target; None: the first.
            group: Name of the station whose frame is meant; None: the first, or the base if no row determines where it
                stands.
            non_geometric: Whether the non-geometric model predicts, if there is one; else the geometry.
            moves: shape (N, m), last move of each joint before each row, [rad] or [m], 0 where it is not known; None:
                the robot goes from each row of ``q`` to the next. It counts for a model with lost motion only.

        Returns:
            A `calib.uncertainty.at_poses.PoseUncertainty`: ``position`` [m] and ``orientation`` [rad], shape (N,),
            that the errors stay below with 95.45 %, as k = 2 has it; and ``contributions`` of each source.

        Raises:
            ArgumentError: ``q`` is not made of numbers.
            ModelError: There is no such target or station, ``q`` has another shape, or a value is not finite.
        """
        part = self.part(non_geometric=non_geometric)
        samples = self.samples(q, target=target, group=group, moves=moves)
        return shown_by("uncertainty.at_poses").uncertainty_at(
            self,
            samples,
            non_geometric=non_geometric,
            in_base=group is None and part.base_motion is not None,
        )

    def budget(
        self,
        q: ArrayLike | None = None,
        *,
        everywhere: bool = False,
        target: str | None = None,
        group: str | None = None,
        non_geometric: bool = True,
    ) -> Any:  # noqa: ANN401  made in a module above
        """Return the uncertainty budget: what each source adds, which one dominates, and what would halve the whole.

        Args:
            q: shape (N, m) or (m,), joint values in the robot's order, [rad] or [m]; None: 200, spread evenly over the
                measured ranges of the joints.
            everywhere: Whether they are spread over the joint limits instead.
            target: Name of the target; None: the first.
            group: Name of the station whose frame is meant; None: the first, or the base if no row determines where it
                stands.
            non_geometric: Whether the non-geometric model predicts, if there is one; else the geometry.

        Returns:
            A `calib.uncertainty.budget.Budget`.

        Raises:
            ArgumentError: ``q`` is not made of numbers.
            ModelError: There is no such target or station, ``q`` has another shape, or a value is not finite.
        """
        budgets = shown_by("uncertainty.budget")
        values = budgets.budget_poses(self, everywhere=everywhere) if q is None else q
        uncertainty = self.uncertainty(
            values, target=target, group=group, non_geometric=non_geometric
        )
        return budgets.Budget.of(uncertainty)

    def forecast(
        self,
        rows: float | None = None,
        joints: ArrayLike | None = None,
        *,
        target: str | None = None,
        group: str | None = None,
        non_geometric: bool = True,
    ) -> Any:  # noqa: ANN401  made in a module above
        """Forecast the rms error of fresh rows, which are not fitted, by the errors of held-out rows.

        Args:
            rows: Number of fresh rows, 1 or more; None: as many as were fitted, or as there are joint values.
            joints: shape (k, m) or (m,), joint values at which they are measured, [rad] or [m]: the forecast is larger
                where the uncertainty there is (`uncertainty`); None: at poses like those fitted.
            target: Of ``joints``: the name of the target; None: the first.
            group: Of ``joints``: the name of the station; None: the first.
            non_geometric: Whether the non-geometric model predicts, if there is one; else the geometry.

        Returns:
            A `calib.uncertainty.forecast.FreshError`: ``rms``, the median, and ``low`` and ``high``, between which the
            rms error without outliers is with 90 %, in its ``unit``; ``compared`` compares fresh rows with it. None
            without cross-validation.

        Raises:
            ArgumentError: ``rows`` is below 1, or ``joints`` are not made of numbers.
            ModelError: There is no such target or station, ``joints`` have another shape, or a value is not finite.
        """
        return shown_by("uncertainty.forecast").forecast(
            self, rows, joints, target=target, group=group, non_geometric=non_geometric
        )

    def tip_poses(
        self, q: ArrayLike, *, payload: Payload | None = None, moves: ArrayLike | None = None
    ) -> Array:
        """Predict calibrated T_base_tip by the non-geometric model if there is one, else by the geometry, ``robot``.

        Args:
            q: shape (N, m) or (m,), joint values in the robot's order, [rad] or [m].
            payload: Point mass that the tip carries; None: that of the measurements. It counts for a non-geometric
                model only.
            moves: shape (N, m), last move of each joint before each row, [rad] or [m], 0 where it is not known; None:
                the robot goes from each row of ``q`` to the next. It counts for a model with lost motion only.

        Returns:
            shape (N, 4, 4), pose of the tip in the base, [m].

        Raises:
            ArgumentError: ``q`` is not made of numbers, or the payload is of another type.
            ModelError: ``q`` has another shape, or a value is not finite.
        """
        if self.non_geometric is None:
            check_type("payload", payload, (Payload, type(None)), "a Payload, or None")
            return self.robot.poses(q)
        return self.non_geometric.tips(self.samples(q, payload=payload, moves=moves))

    def complete_cell(self, cell: Cell) -> Cell:
        """Return a cell with the cameras and boards that the fit began with, if it gives none of its own.

        Args:
            cell: As given for other rows of this robot.

        Returns:
            The cell, with `ResultOptics.nominal_cameras` and `ResultOptics.nominal_boards` where it has none.
        """
        return replace(
            cell,
            cameras=cell.cameras or self.optics.nominal_cameras,
            boards=cell.boards or self.optics.nominal_boards,
        )

    def outside_of_measured(self, q: ArrayLike) -> tuple[OutsideRow, ...]:
        """List the joint values that lie outside of the ranges that were fitted.

        These are ``rows.ranges``, of the fitted rows with weight. A margin of 5 % of the range is allowed; a continuous
        joint's range may pass the full turn.

        Args:
            q: shape (N, m) or (m,), joint values in the robot's order, [rad] or [m].

        Returns:
            The rows of ``q`` with a joint outside, each by its index, from 0, with the joints and their distances from
            the range, [rad] or [m]; empty if the fitted ranges are not known.

        Raises:
            ArgumentError: ``q`` is not made of numbers.
            ModelError: ``q`` has another shape, or a value is not finite.
        """
        values = self.nominal.columns(q)
        ranges = self.rows.ranges
        if not np.isfinite(ranges).all():
            return ()
        seen = np.linspace(ranges[:, 0], ranges[:, 1], _BETWEEN)
        types = [joint.type for joint in self.nominal.inputs]
        return outside(seen, values, self.nominal.joint_names, types)

    def corrected(self, robot: Robot) -> Robot:
        """Return a robot with the calibrated joint origins, base and tip of this result, those of its ``robot``.

        Args:
            robot: A URDF of this robot, nominal or corrected, such as one with meshes.

        Returns:
            The same URDF with these origins, base and tip; all else is its own.

        Raises:
            ArgumentError: It is not a `Robot`.
            ModelError: Its joint readings are coupled differently.
            UrdfError: It lacks one of the joints.
        """
        return self._described(_with_origins_of(self.robot, robot))

    def uncorrected(self, robot: Robot) -> Robot:
        """Return a robot with the nominal joint origins of this result, those of its ``nominal``.

        Args:
            robot: A URDF of this robot, nominal or corrected.

        Returns:
            The same URDF with these origins and the base and tip of the nominal robot; all else is its own.

        Raises:
            ArgumentError: It is not a `Robot`.
            ModelError: Its joint readings are coupled differently.
            UrdfError: It lacks one of the joints.
        """
        nominal = _with_origins_of(self.nominal, robot)
        if nominal.urdf.run != self.run:
            return nominal
        return nominal.with_urdf(nominal.urdf.with_comments(run="", verdict=""))

    def _described(self, robot: Robot) -> Robot:
        """Return a robot whose URDF states this run and, if it is ``do not use``, the verdict, as comments."""
        verdict_against = shown_by("show.verdict_text").do_not_use_text(self.verdict)
        urdf = robot.urdf.with_comments(run=self.run, verdict=verdict_against)
        return robot.with_urdf(urdf)


def is_corrected(result: Calibration, robot: Robot) -> bool:
    """Return whether a robot has the joint origins that a result corrected, or those that the calibration began with.

    Args:
        result: The calibration.
        robot: A robot with the same chain.

    Returns:
        True for the corrected origins, to rounding; False for the nominal ones, also if the result corrects none.

    Raises:
        ModelError: It has neither, has another base or tip, or its joint readings are coupled differently.
        UrdfError: It lacks one of the joints.
    """
    chain = result.nominal
    if (robot.base, robot.tip) != (chain.base, chain.tip):
        raise ModelError(
            f"The result is for --base {chain.base} --tip {chain.tip}, not for '{robot.base}' to "
            f"'{robot.tip}'."
        )
    joint = joint_of_another_run(result, robot)
    if joint:
        runs = f" It is of run {robot.urdf.run}, the result of {result.run}." * bool(robot.urdf.run)
        raise ModelError(
            f"{robot.urdf.source}: its joint origins are neither those that the calibration began with nor the "
            f"corrected ones (see '{joint}').{runs} Give the URDF that the result was made with, or the corrected URDF "
            "in place of the result."
        )
    return bool(_other_origins(robot, result.uncorrected(robot)))


def joint_of_another_run(result: Calibration, robot: Robot) -> str:
    """Find a joint of a robot that shows that its URDF is not of a result's run.

    Args:
        result: The calibration.
        robot: A robot with the same chain.

    Returns:
        Name of the first joint whose origin is neither, or else is not nominal; empty if all origins are those that the
        calibration began with, or all are the corrected ones.

    Raises:
        ModelError: Its joint readings are coupled differently.
        UrdfError: It lacks one of the joints.
    """
    not_corrected = _other_origins(robot, result.corrected(robot))
    not_nominal = _other_origins(robot, result.uncorrected(robot))
    if not not_corrected or not not_nominal:
        return ""
    neither = [joint for joint in not_nominal if joint in not_corrected]
    return (neither or not_nominal)[0]


def _other_origins(robot: Robot, reference: Robot) -> list[str]:
    """Return the names of the joints whose origins differ from a reference robot's by more than rounding."""
    origins = reference.origins()
    return [name for name, T in robot.origins().items() if np.abs(T - origins[name]).max() > _SAME]


def _with_origins_of(source: Robot, robot: Robot) -> Robot:
    """Return a robot with the joint origins, base and tip of another one, its source.

    Raises ArgumentError if it is no Robot, ModelError if its readings are coupled differently from the source's, and
    UrdfError if it lacks one of the source's joints.
    """
    check_type("robot", robot, Robot, "a Robot")
    check_same_coupling(robot, source)
    urdf = robot.urdf.with_origins(source.origins())
    ends = [(branch.base, branch.tip) for branch in source.branches]
    return Robot.from_urdf(
        urdf,
        source.base,
        source.tip,
        held=robot.held,
        coupling=robot.reading_coupling,
        branches=ends,
        parts=source.parts,
    )


def _repeated_index(
    what: str, name: str | None, names: tuple[str, ...], count: int
) -> NDArray[np.int_]:
    """Return the index, from 0, of a station or target (``what``) among all names, once for each of ``count`` samples.

    None means the first; a name that is not among them raises ModelError.
    """
    if name is not None and name not in names:
        raise ModelError(f"There is no {what} '{name}'; there is {choices(names)}.")
    index = 0 if name is None else names.index(name)
    return np.full(count, index)


def check_same_coupling(robot: Robot, source: Robot) -> None:
    """Refuse a robot whose joint readings are coupled differently from those of the robot that it belongs to.

    Args:
        robot: As given, with its coupling of readings.
        source: The robot that it belongs to: that of a result, or another model of the same arm.

    Raises:
        ModelError: They differ: the same table would mean other joint angles.
    """
    if robot.reading_coupling != source.reading_coupling:
        raise ModelError(
            f"The joint readings of '{robot.name}' ({robot.urdf.source}) are coupled by {robot.reading_coupling}, "
            f"those of the robot that it belongs to by {source.reading_coupling}. Give its path in place of the Robot, "
            f"or load it so: Robot.load(..., coupling={source.reading_coupling})."
        )


def check_same_joints(robot: Robot, nominal: Robot) -> None:
    """Refuse two robots whose joints differ in name, type or axis, or in coupled readings; raises `ModelError`.

    Args:
        robot: A corrected robot.
        nominal: Its nominal robot.
    """
    joints, nominal_joints = _joints(robot), _joints(nominal)
    if joints != nominal_joints:
        raise ModelError(
            f"The robot '{robot.name}' has the joints {choices(joints)}, its nominal robot "
            f"'{nominal.name}' {choices(nominal_joints)}. Give the nominal URDF that the robot was "
            "corrected from, with the same base and tip."
        )
    check_same_coupling(robot, nominal)


def _joints(robot: Robot) -> list[str]:
    """Return name, type and axis of each joint, as text."""
    return [f"{joint.name} ({joint.type}, axis {joint.axis + 0.0})" for joint in robot.joints]
