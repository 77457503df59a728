"""Sensitivity of measurements and predictions to the parameters that a fit will estimate, before anything is measured.

Rows, error model, noise and priors are those of the fit, at the nominal robot.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

import calib.data.kinds as registry
from calib.basics.arrays import Array, read_only
from calib.basics.channels import RESIDUAL_UNITS
from calib.data.cell import AUTO, Cell
from calib.data.columns import DEFAULT_TARGET
from calib.data.inputs import GENERIC_TARGET
from calib.fit.estimate.task import Task
from calib.fit.registration.setup import Setup
from calib.fit.registration.table_rows import measurement_setup, with_internals
from calib.instruments.camera import USUAL_LIMITS, CameraInstrument, SightLimits
from calib.instruments.instrument import Instrument, Sightline, transform
from calib.instruments.tracker import TrackerInstrument
from calib.model.families import FAMILIES
from calib.model.kinematics import Kinematics, Samples
from calib.model.observability import Observability, analyse
from calib.numerics.moves import last_moves
from calib.numerics.rigid_motion import without_rigid_motion
from calib.robot.gravity import gravity_loads
from calib.robot.robot import Robot
from calib.verbs.plan.notes import Note

#: Parameter set for which `auto` is planned: the largest geometry, so that every smaller one is covered.
PLANNED_FOR_AUTO = "placement"

#: Standard deviation that holds a parameter without a prior, as in a fit, in directions that no pose determines [m and
#: rad].
LEASH = 1.0

#: Distance from the target of an instrument whose position is not known [m].
_USUAL_DISTANCE = 3.0


def instrument_of(cell: Cell, limits: SightLimits = USUAL_LIMITS) -> Instrument:
    """Return the instrument that a cell plans for: its camera, unless it states another kind of measurement.

    Args:
        cell: Camera and board, or tracker and reflector; kind of measurement, noise.
        limits: Distances and tilts at which a camera may see the board.

    Raises:
        CalibError: No instrument that poses can be planned for.
    """
    if cell.cameras and (cell.kind is None or registry.get(cell.kind).is_image):
        return CameraInstrument.of(cell, limits)
    return TrackerInstrument.of(cell)


@dataclass(frozen=True, slots=True, eq=False)
class Sensitivity:
    """Model of a robot in a cell, as the fit will use it; p is the number of parameters, k that of targets."""

    #: The cell that the fit will use: noise, tracker, payload, priors.
    cell: Cell
    #: The instrument that measures the targets.
    instrument: Instrument
    #: Frames and targets; a target that was not given is at a general place.
    setup: Setup
    #: Poses and derivatives of the nominal robot, under the error model of the fit.
    kinematics: Kinematics
    #: Shape (p,), 1 / tau^2 of each parameter's prior, its own or its family's, or of the leash.
    precision: Array
    #: Notes on what was assumed.
    notes: tuple[Note, ...]

    @classmethod
    def of(cls, robot: Robot, cell: Cell, instrument: Instrument | None = None) -> Sensitivity:
        """Make the model of a robot in a cell, as the fit will use it.

        Args:
            robot: The nominal robot, from the instrument's link to the target's.
            cell: Cell that the fit will use; the error model ``"auto"`` is taken as ``"placement"``, and known
                distances between stations do not count. A target that it does not give is put at (50, 70, 30) mm in the
                tip, and the notes say so.
            instrument: The instrument; None: the cell's.

        Raises:
            ModelError: A kind of measurement, or a parameter, that cannot be planned for.
        """
        instrument = instrument_of(cell) if instrument is None else instrument
        cell = replace(instrument.in_cell(cell), distances=())
        targets = tuple(cell.targets) or (DEFAULT_TARGET,)
        table = instrument.stop_rows(robot, targets, next(iter(cell.frames), ""))
        stop = np.zeros(len(table), dtype=np.int_)
        setup = measurement_setup(robot, cell, table, (instrument.kind,), stop)
        setup, _ = with_internals(setup, table, cell, stop)
        notes = [Note(code, values) for code, values in instrument.assumed]
        if not np.all(setup.target_given):
            T_tip_target = setup.T_tip_target.copy()
            T_tip_target[~setup.target_given, :3, 3] = GENERIC_TARGET
            setup = setup.with_poses(setup.T_frame_base, T_tip_target)
            notes.insert(0, Note("generic_target", tuple(GENERIC_TARGET)))

        is_auto = cell.model == AUTO
        name = PLANNED_FOR_AUTO if is_auto else cell.model
        model = setup.turn_directions(
            Task(robot, cell, setup, name, allow_absent=is_auto).error_model()
        )
        if not is_auto:
            for given in (*cell.parameter_priors, *cell.bounds):
                model.index(given)  # refuses one that the model does not have
        own_std = {unknown.parameter.name: unknown.sigma for unknown in setup.internals}
        precision = np.zeros(len(model))
        for k, parameter in enumerate(model.parameters):
            prior_std = own_std.get(parameter.name, LEASH)
            if cell.priors.source != "off" and parameter.family in FAMILIES:
                prior_std = cell.priors.of(parameter.family)
            precision[k] = 1.0 / cell.parameter_priors.get(parameter.name, prior_std) ** 2
        kinematics = Kinematics(robot, model, setup.T_frame_base, setup.T_tip_target)
        return cls(cell, instrument, setup, kinematics, read_only(precision), tuple(notes))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the p parameters, in the order of the columns of all derivatives."""
        return self.kinematics.model.names

    @property
    def units(self) -> tuple[str, ...]:
        """SI unit of each of the p parameters, such as ``"m"`` or ``"rad/Nm"``, in the order of the names."""
        return self.kinematics.model.units

    @property
    def sightlines(self) -> tuple[Sightline, ...]:
        """The instrument and each target, with the chain between them; () if the instrument's place is not known."""
        T_instrument_base = self.instrument.T_instrument_base
        if T_instrument_base is None:
            return ()
        robot = self.kinematics.robot
        return tuple(Sightline(robot, T_instrument_base, T) for T in self.setup.T_tip_target)

    def expected(self, q: Array) -> Array:
        """Predict where each of the k targets is in the measurement frame, by the nominal robot.

        Args:
            q: Joint values of N poses, shape (N, m), [rad] or for sliding joints [m], columns as ``robot.joint_names``.

        Returns:
            Positions of the targets (of a board, its centre), shape (N, k, 3), [m], in the order of the setup.
        """
        T = self.kinematics.poses(np.zeros(len(self.names)), self._samples(q))
        return transform(T, self.instrument.points[:1]).reshape(len(q), -1, 3)

    def _samples(self, q: Array, moves: Array | None = None) -> Samples:
        """Return N k samples at N poses (N, m): all k targets at the first pose, then at the second, ...

        They have loads if an error of the model depends on these. Without the joints' last moves (N, m) the robot goes
        from each pose to the next.
        """
        targets = len(self.setup.targets)
        load = None
        factors = [parameter.factor for parameter in self.kinematics.model.parameters]
        if any(factor is not None and factor.loaded for factor in factors):
            robot = self.kinematics.robot
            of_poses = gravity_loads(robot, q, self.cell.payload, self.cell.gravity)
            load = np.repeat(of_poses, targets, axis=0)
        frame = np.zeros(targets * len(q), dtype=np.int_)
        target = np.tile(np.arange(targets), len(q))
        moves = np.repeat(last_moves(q) if moves is None else moves, targets, axis=0)
        return Samples(np.repeat(q, targets, axis=0), frame, target, load, moves=moves)

    def measured(self, q: Array, moves: Array | None = None) -> Array:
        """Differentiate what is measured by the parameters, whitened by the noise.

        Args:
            q: Joint values of n poses, shape (n, m), [rad] or for sliding joints [m], columns as ``robot.joint_names``.
            moves: Last move of each joint before each pose, shape (n, m); None: from the pose before.

        Returns:
            Derivative of the d scalars that stand for all measurements at a pose, shape (n, d, p), in standard
            deviations of the noise per unit of the parameter; see `calib.instruments.instrument.Instrument.whitened`.
        """
        samples = self._samples(q, moves)
        T, twists = self.kinematics.twists(np.zeros(len(self.names)), samples)
        T = T.reshape(len(q), -1, 4, 4)
        twists = twists.reshape(*T.shape[:2], *twists.shape[1:])
        return self.instrument.whitened(T, twists, self.noise(q), self.kinematics.model)

    def located(self, q: Array) -> Array:
        """Differentiate the predicted positions of the k targets, in the measurement frame, by the p parameters.

        If no position is measured, as with distances, the pose of the base cannot be known: the rigid motion of all
        n k positions that explains a column best is subtracted from it.

        Args:
            q: Joint values of n poses, shape (n, m), [rad] or for sliding joints [m], columns as ``robot.joint_names``.

        Returns:
            Shape (n, 3 k, p), x, y, z of the first target, then of the second, ..., [m per unit of the parameter].
        """
        zero, point = np.zeros(len(self.names)), self.instrument.points[:1]
        has_lever = bool(point.any())
        T, twists = self.kinematics.twists(zero, self._samples(q), rotation=has_lever)
        slopes = twists[:, :3]
        if has_lever:
            lever = transform(T, point)[:, 0] - T[:, :3, 3]
            slopes = slopes + np.cross(twists[:, 3:], lever[:, :, None], axis=1)
        if not self.instrument.locates:
            slopes = without_rigid_motion(T[:, :3, 3], slopes)
        return np.asarray(slopes.reshape(len(q), -1, len(self.names)))

    def noise(self, q: Array) -> Array:
        """Return the standard deviation of a measured scalar at each pose, by the distance to the first target.

        An instrument that does not measure positions, such as an anchor, is the origin of the measurement frame; one
        whose place is not known is taken to be 3 m away.

        Args:
            q: Joint values of n poses, shape (n, m), [rad] or for sliding joints [m], columns as ``robot.joint_names``.

        Returns:
            Shape (n,), in the unit of the scalars, [m] or for images [px].
        """
        if not self.instrument.kind.position:
            distance = np.linalg.norm(self.expected(q)[:, 0], axis=1)
        elif not self.sightlines:
            distance = np.full(len(q), _USUAL_DISTANCE)
        else:
            distance = self.sightlines[0].distances(q)
        return self.instrument.noise(distance)

    def sigma_by_unit(self, q: Array) -> dict[str, float]:
        """Return the standard deviation of one scalar in each unit that is measured; of lengths, the rms over poses.

        Args:
            q: Joint values of n poses, shape (n, m), [rad] or for sliding joints [m], columns as ``robot.joint_names``.
        """
        units = self.instrument.kind.units
        sigma = {unit: self.instrument.sigma[unit] for unit in RESIDUAL_UNITS if unit in units}
        if "m" in sigma:
            sigma["m"] = float(np.sqrt(np.mean(self.noise(q) ** 2)))
        return sigma

    def analysed(self, q: Array, measured: Array) -> Observability:
        """Analyse which of the p parameters some poses determine.

        The derivative is scaled back from standard deviations to the unit of the noise, [m] or for images [px], as a
        fit does.

        Args:
            q: Joint values of n poses, shape (n, m), [rad] or for sliding joints [m], columns as ``robot.joint_names``.
            measured: Result of the method `measured` for these poses, shape (n, d, p).

        Returns:
            Rank, parameters that are determined by themselves, unobservable combinations, and observability indices.
        """
        sigma = np.repeat(self.noise(q), measured.shape[1])[:, None]
        jacobian = measured.reshape(len(sigma), -1) * sigma
        return analyse(jacobian, self.names, self.units)
