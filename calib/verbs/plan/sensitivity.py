"""Sensitivity of measurements and predictions to the parameters that a fit will estimate, before anything is measured.

They are the fit's own: its rows, error model, noise and priors, at the nominal robot.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

import calib.data.kinds as registry
from calib.basics.arrays import Array, read_only
from calib.basics.channels import RESIDUAL_UNITS, VECTOR
from calib.data.cell import AUTO, Cell, Tracker
from calib.data.columns import DEFAULT_TARGET
from calib.data.generic import GENERIC_TARGET, table_of_poses
from calib.data.measurements import Measurements
from calib.errors import ModelError, choices
from calib.fit.estimate.task import Task
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import Setup
from calib.fit.registration.table_setup import measurement_setup
from calib.model.families import FAMILIES
from calib.model.kinematics import Kinematics, Samples
from calib.model.observability import Observability, analyse
from calib.model.parameters import ErrorModel
from calib.numerics.rigid_motion import without_rigid_motion
from calib.robot.gravity import gravity_loads
from calib.robot.robot import Robot
from calib.verbs.plan.notes import Note

#: What `auto` is planned for: the largest geometry, so that every smaller one is covered.
PLANNED_FOR_AUTO = "placement"

#: Prior standard deviation of a parameter without a prior [m and rad], as in a fit: it holds directions that no pose
#: determines.
LEASH = 1.0

#: The instrument where the cell names none.
_USUAL = Tracker(np.zeros(3))

#: Its distance from the target [m].
_USUAL_DISTANCE = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Sensitivity:
    """Model of a robot in a cell, as the fit will use it; p is the number of parameters, k that of targets."""

    #: The measurement setup that the fit will use: noise, tracker, payload, priors.
    cell: Cell
    #: Kind of measurement at each pose, by its name.
    kind: str
    #: Frames and targets; a target that was not given is at a general place.
    setup: Setup
    #: Poses and derivatives of the nominal robot, under the error model of the fit.
    kinematics: Kinematics
    #: Shape (p,), 1 / tau^2 of each parameter's prior, its own or its family's, or of the leash.
    precision: Array
    #: What was assumed.
    notes: tuple[Note, ...]

    @classmethod
    def of(cls, robot: Robot, cell: Cell) -> Sensitivity:
        """Make the model of a robot in a cell, as the fit will use it.

        Args:
            robot: The nominal robot.
            cell: The measurement setup that the fit will use: frames, targets, noise, priors, the kind of measurement
                (None: ``"point"``) and the error model, of which ``"auto"`` is taken as ``"placement"``. Known
                distances between groups do not count.

        Returns:
            The model, whose derivatives are taken at the nominal robot. A target that the cell does not give is put at
            (50, 70, 30) mm in the tip, and the angular noise of poses, where it is not given, is 1 mrad; ``notes`` say
            so.

        Raises:
            ModelError: A kind of measurement, or a parameter, that cannot be planned for.
        """
        kind = _checked_kind(cell)
        cell = replace(cell, distances=())
        table = _one_pose(robot, cell, kind)
        setup = measurement_setup(
            cell, table, (registry.get(kind),), np.zeros(len(table), dtype=np.int_)
        )
        notes = []
        if not np.all(setup.target_given):
            setup = _with_generic_targets(setup)
            notes.append(Note("generic_target", tuple(GENERIC_TARGET)))
        if "rad" in registry.get(kind).units and "rad" not in cell.sigma:
            notes.append(Note("orientation_noise", (RESIDUAL_UNITS["rad"].assumed_sigma,)))
        model = planned_model(robot, cell, setup)
        precision = prior_precision(cell, model)
        kinematics = Kinematics(robot, model, setup.T_frame_base, setup.T_tip_target)
        return cls(cell, kind, setup, kinematics, read_only(precision), tuple(notes))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the p parameters, in the order of the columns of all derivatives."""
        return self.kinematics.model.names

    @property
    def units(self) -> tuple[str, ...]:
        """SI unit of each of the p parameters, such as ``"m"`` or ``"rad/Nm"``, in the order of the names."""
        return self.kinematics.model.units

    def expected(self, q: Array) -> Array:
        """Predict where each of the k targets is in the measurement frame, by the nominal robot.

        Uses ``kinematics``: the nominal robot, the pose of its base in the measurement frame (the identity where that
        frame is not known) and the poses of the targets in the tip.

        Args:
            q: Joint values of N poses, shape (N, m), [rad] or for sliding joints [m], columns as ``robot.joint_names``.

        Returns:
            Positions, shape (N, k, 3), [m], targets in the order of the setup.
        """
        T_frame_target = self.kinematics.poses(np.zeros(len(self.names)), self._samples(q))
        return np.asarray(T_frame_target[:, :3, 3].reshape(len(q), -1, 3))

    def _samples(self, q: Array) -> Samples:
        """Return every target at every pose, seen from the only measurement frame.

        Uses ``setup.targets``, the names of the k targets; and, where a parameter of ``kinematics.model`` multiplies
        the load on a joint, the payload and the acceleration of gravity of ``cell``. Loads are not computed otherwise.

        Args:
            q: Joint values of N poses, shape (N, m), [rad] or for sliding joints [m], columns as ``robot.joint_names``.

        Returns:
            N k samples, the k targets at the first pose, then those at the second, ...: joint values, shape (N k, m);
            index of the frame, 0, and of the target, from 0, shape (N k,) each; and the loads by gravity on the joints,
            [Nm] or [N], with lever arms, see `calib.robot.gravity.gravity_loads`, or None.
        """
        targets = len(self.setup.targets)
        load = None
        if _needs_loads(self.kinematics.model):
            robot = self.kinematics.robot
            of_poses = gravity_loads(robot, q, self.cell.payload, self.cell.gravity)
            load = np.repeat(of_poses, targets, axis=0)
        frame = np.zeros(targets * len(q), dtype=np.int_)
        target = np.tile(np.arange(targets), len(q))
        return Samples(np.repeat(q, targets, axis=0), frame, target, load)

    def measured(self, q: Array) -> Array:
        """Differentiate what is measured by the parameters, whitened by the noise.

        With the noise s of a coordinate, see `noise`, the repeatability r of the robot is a part of s that all k
        targets of one stop share. The mean of their coordinates then has the variance s^2 / k (1 + (k - 1) rho), rho =
        r^2 / s^2: the mean over targets of the derivative is scaled accordingly, unless the cell gives the noise.
        Differences between targets are more exact than s; a fit, to which rows are independent, makes no use of that,
        and nor does this.

        Uses ``kind``, the name of the kind of measurement, ``setup.targets``, and of ``cell`` the noise of a
        coordinate, ``sigma``, and the tracker, whose noise has the repeatability [m].

        Args:
            q: Joint values of n poses, shape (n, m), [rad] or for sliding joints [m], columns as ``robot.joint_names``.

        Returns:
            Derivative of the prediction, shape (n, d, p), of the d scalars that are measured of all k targets at a pose
            by the p parameters, in standard deviations of the noise per unit of the parameter. Target by target: x, y,
            z in the measurement frame for points; for poses also a rotation vector; for distances one length.
        """
        noise = self.noise(q)
        slopes = self._whitened_slopes(q, noise)
        p, targets = len(self.names), len(self.setup.targets)
        by_target = slopes.reshape(len(q), targets, -1, p)
        measures_position = registry.get(self.kind).position
        if targets > 1 and measures_position and "m" not in self.cell.sigma:
            repeatability = (self.cell.tracker or _USUAL).noise.repeatability
            rho = (repeatability / noise) ** 2
            loss = 1.0 - 1.0 / np.sqrt(1.0 + (targets - 1) * rho)
            shared = by_target[:, :, :VECTOR].mean(axis=1, keepdims=True)
            by_target[:, :, :VECTOR] -= loss[:, None, None, None] * shared
        return np.asarray(by_target.reshape(len(q), -1, p))

    def _whitened_slopes(self, q: Array, noise: Array) -> Array:
        """Differentiate what is measured of every target at every pose, as if the noise of all were independent.

        Uses ``kinematics`` at zero errors, ``kind``, the name of the kind of measurement, ``setup.targets``, names of
        the k targets, and the noise of the other units, ``cell.sigma``, or that which is assumed, such as 1 mrad.

        Args:
            q: Joint values of n poses, shape (n, m), [rad] or for sliding joints [m], columns as ``robot.joint_names``.
            noise: Standard deviation of a measured coordinate or length at each pose, shape (n,), [m].

        Returns:
            Derivative of the prediction by the p parameters, shape (n k, D, p), in standard deviations of the noise per
            unit of the parameter: D scalars of each of the k targets at the first pose, then at the second, ... D is 3
            for points, 6 for poses (a position, then a rotation vector), 1 for distances.
        """
        samples = self._samples(q)
        T_frame_target, twists = self.kinematics.twists(np.zeros(len(self.names)), samples)
        n = len(samples)
        sigma = {}
        for symbol, unit in RESIDUAL_UNITS.items():
            sigma[symbol] = np.full(n, self.cell.sigma.get(symbol, unit.assumed_sigma))
        rows = Rows(
            samples=samples,
            kinds=(registry.get(self.kind),),
            kind=np.zeros(n, dtype=np.int_),
            measured=np.zeros((n, registry.get(self.kind).size)),
            partner=np.full(n, -1),
            sigma=sigma | {"m": np.repeat(noise, len(self.setup.targets))},
            poses=np.arange(n),
            blocks=np.arange(n),
        ).as_measured_at(T_frame_target)
        slopes = rows.derivative(T_frame_target, twists)
        return rows.standardise(slopes)

    def located(self, q: Array) -> Array:
        """Differentiate the predicted positions of the k targets, in the measurement frame, by the p parameters.

        Where no position is measured, as with distances, the pose of the base cannot be known: of each column the
        displacements that a rigid motion of all n k positions explains best are subtracted. Uses ``kinematics`` at zero
        errors, and ``kind``, the name of the kind of measurement.

        Args:
            q: Joint values of n poses, shape (n, m), [rad] or for sliding joints [m], columns as ``robot.joint_names``.

        Returns:
            Shape (n, 3 k, p), x, y, z of the first target, then of the second, ..., [m per unit of the parameter].
        """
        zero = np.zeros(len(self.names))
        poses, slopes = self.kinematics.twists(zero, self._samples(q), rotation=False)
        if not registry.get(self.kind).position:
            slopes = without_rigid_motion(poses[:, :3, 3], slopes)
        return np.asarray(slopes.reshape(len(q), -1, len(self.names)))

    def noise(self, q: Array) -> Array:
        """Return the standard deviation of a measured coordinate, or of a measured distance, at each pose.

        It is ``cell.sigma["m"]`` where that is given. Else it is the noise of ``cell.tracker``, or of a usual tracker,
        with the robot's repeatability, at some distance to the first target: from the tracker, if it is known, else 3
        m; where distances are measured (by ``kind``), from the origin of the measurement frame, the anchor.

        Args:
            q: Joint values of n poses, shape (n, m), [rad] or for sliding joints [m], columns as ``robot.joint_names``.

        Returns:
            Shape (n,), [m].
        """
        if "m" in self.cell.sigma:
            return np.full(len(q), self.cell.sigma["m"])
        tracker = self.cell.tracker
        if not registry.get(self.kind).position:
            distance = np.linalg.norm(self.expected(q)[:, 0], axis=1)
        elif tracker is None:
            distance = np.full(len(q), _USUAL_DISTANCE)
        else:
            T_base_target = self.kinematics.robot.poses(q) @ self.setup.T_tip_target[0]
            distance = np.linalg.norm(T_base_target[:, :3, 3] - tracker.position, axis=1)
        return np.asarray((tracker or _USUAL).noise.std(distance))

    def sigma_by_unit(self, q: Array) -> dict[str, float]:
        """Return the standard deviation of one scalar, rms over the poses, in each unit that ``kind`` measures.

        Of lengths that of `noise`; of other units ``cell.sigma``, or that which is assumed.

        Args:
            q: Joint values of n poses, shape (n, m), [rad] or for sliding joints [m], columns as ``robot.joint_names``.
        """
        measured_units = registry.get(self.kind).units
        sigma = {}
        for symbol, unit in RESIDUAL_UNITS.items():
            if symbol in measured_units:
                sigma[symbol] = self.cell.sigma.get(symbol, unit.assumed_sigma)
        if "m" in sigma:
            sigma["m"] = float(np.sqrt(np.mean(self.noise(q) ** 2)))
        return sigma

    def analysed(self, q: Array, measured: Array) -> Observability:
        """Analyse which of the p parameters some poses determine.

        The derivative is scaled back from standard deviations to metres, as a fit does. Uses ``names`` and ``units`` of
        the parameters, and `noise`.

        Args:
            q: Joint values of n poses, shape (n, m), [rad] or for sliding joints [m], columns as ``robot.joint_names``.
            measured: What the method `measured` returns for these poses, shape (n, d, p): the derivative of the d
                scalars measured at each pose by the parameters, in standard deviations of the noise per unit.

        Returns:
            ``rank``, the number of parameters or combinations that the poses determine; ``identifiable``, shape (p,),
            whether a parameter is determined by itself; the unobservable combinations; and the observability indices.
        """
        sigma = np.repeat(self.noise(q), measured.shape[1])[:, None]
        jacobian = measured.reshape(len(sigma), -1) * sigma
        return analyse(jacobian, self.names, self.units)


def _needs_loads(model: ErrorModel) -> bool:
    """Test whether a parameter of an error model multiplies a load on a joint, as a compliance does.

    Args:
        model: The error model: ``factor`` of each of its ``parameters`` is the function of the joints' state that
            multiplies it, ``factor.loaded`` whether that takes the load on a joint or the lever arm of a mass; None: a
            constant error.
    """
    factors = [parameter.factor for parameter in model.parameters]
    return any(factor is not None and factor.loaded for factor in factors)


def _checked_kind(cell: Cell) -> str:
    """Return the name of the kind of measurement that is planned for, if its poses can be chosen freely at one station.

    A frame of its own, as the anchor's of distances, must be given.

    Args:
        cell: ``cell.kind``, the name of the kind (None: ``"point"``); ``cell.T_frame_base``, the pose of the base in
            the measurement frame, shape (4, 4), [m], or None; ``cell.frames``, such poses by the names of stations.

    Raises:
        ModelError: Poses cannot be planned for this kind or these frames.
    """
    name = cell.kind or "point"
    kind = registry.get(name)
    if kind.optical:
        raise ModelError(
            f"Rows of the kind '{name}' are planned as images: give the camera and the board (--camera, --board and "
            "--board-at)."
        )
    unplaced = kind.own_frame and cell.T_frame_base is None and not cell.frames
    if unplaced or len(cell.frames) > 1 or not kind.free:
        kinds = [registry.get(known) for known in registry.names()]
        free = [known.name for known in kinds if known.free and not known.optical]
        raise ModelError(
            f"Poses are planned for the kinds {choices(free)}, at one station; of one with a "
            "frame of its own, such as distances, give the base in it (frame_xyz_mm in the cell "
            f"file). Here the kind is '{name}'."
        )
    return name


def _one_pose(robot: Robot, cell: Cell, kind: str) -> Measurements:
    """Return a table of one pose, all joints at 0, with a row for each target of the cell.

    Only its words matter, to set up frames and targets; the values measured are arbitrary.

    Args:
        robot: The nominal robot.
        cell: ``cell.targets``, positions by the names of the targets (empty: one target of the usual name);
            ``cell.frames``, poses by the names of stations, of which the first is taken.
        kind: Name of the kind of measurement, such as ``"point"``.
    """
    targets = tuple(cell.targets) or (DEFAULT_TARGET,)
    groups = (next(iter(cell.frames), ""),) * len(targets)
    table = table_of_poses(robot, kind, np.zeros((len(targets), len(robot.inputs))))
    return replace(table, targets=targets, groups=groups)


def _with_generic_targets(setup: Setup) -> Setup:
    """Return the setup with the targets that were not given at (50, 70, 30) mm in the tip, off all its axes.

    Args:
        setup: Frames and targets: ``T_tip_target``, poses of the k targets in the tip, shape (k, 4, 4), [m];
            ``target_given``, which of these were given, shape (k,); ``T_frame_base``, kept as it is.
    """
    T_tip_target = setup.T_tip_target.copy()
    T_tip_target[~setup.target_given, :3, 3] = GENERIC_TARGET
    return setup.with_poses(setup.T_frame_base, T_tip_target)


def planned_model(robot: Robot, cell: Cell, setup: Setup) -> ErrorModel:
    """Return the error model of the fit, with parameters for the frames and targets that are estimated.

    Args:
        robot: The nominal robot.
        cell: ``cell.model``, the name of the robot's parameter set, ``"auto"`` for ``"placement"``; and, by the names
            of parameters, ``cell.parameter_priors`` and ``cell.bounds``.
        setup: Frames and targets, and which of these are estimated.

    Returns:
        The error model with its p parameters; with ``"auto"``, names in the cell of parameters that it does not have
        are ignored.

    Raises:
        ModelError: A prior or a bound is given for a parameter that the model does not have, or there is no such model.
    """
    is_auto = cell.model == AUTO
    name = PLANNED_FOR_AUTO if is_auto else cell.model
    model = setup.turn_directions(
        Task(robot, cell, setup, name, allow_absent=is_auto).error_model()
    )
    if not is_auto:
        for parameter in (*cell.parameter_priors, *cell.bounds):
            model.index(parameter)
    return model


def prior_precision(
    cell: Cell, model: ErrorModel, optical: Mapping[str, float] | None = None
) -> Array:
    """Return the precision 1 / tau^2 of each parameter's prior.

    The standard deviation tau is the parameter's own, or else its family's, or else 1 in the parameter's unit, which
    only holds what no pose determines.

    Args:
        cell: ``cell.parameter_priors``, tau of single parameters by name; ``cell.priors``, tau of families of errors,
            which do not count where its ``source`` is ``"off"``. Both in the parameters' units.
        model: The error model with p parameters, each with a ``name`` and the name of its ``family``; those of frames
            and targets have no family of errors.
        optical: tau of numbers of cameras and boards, by the names of their parameters; None: there are none.

    Returns:
        Shape (p,), in the inverse squares of the parameters' units.
    """
    precision = np.zeros(len(model))
    for k, parameter in enumerate(model.parameters):
        prior_std = (optical or {}).get(parameter.name, LEASH)
        if cell.priors.source != "off" and parameter.family in FAMILIES:
            prior_std = cell.priors.of(parameter.family)
        prior_std = cell.parameter_priors.get(parameter.name, prior_std)
        precision[k] = 1.0 / prior_std**2
    return precision
