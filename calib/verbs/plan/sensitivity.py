"""Sensitivity of measurements and predictions to the parameters that a fit will estimate, before anything is measured.

Rows, error model, noise and priors are those of the fit, at the nominal robot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

import calib.data.kinds as registry
from calib.basics.arrays import Array, Integers, Mask, read_only
from calib.basics.channels import RESIDUAL_UNITS
from calib.basics.values import Value
from calib.data.cell import AUTO, Cell
from calib.data.cell_chains import (
    Sight,
    cell_of_sight,
    chain_numbers,
    links_of,
    named_stations,
    named_targets,
)
from calib.data.inputs import GENERIC_TARGET
from calib.data.measurements import Measurements
from calib.errors import ModelError, choices
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
    return CameraInstrument.of(cell, limits) if _takes_images(cell) else TrackerInstrument.of(cell)


def _takes_images(cell: Cell) -> bool:
    """Return whether images are planned for a cell: it has a camera, and states no other kind of measurement."""
    return bool(cell.cameras) and (cell.kind is None or registry.get(cell.kind).is_image)


@dataclass(frozen=True, slots=True, eq=False)
class View(Value):
    """The measurement of one instrument at a pose: the targets on one link, seen through one chain."""

    #: The instrument.
    instrument: Instrument
    #: Number of its frame.
    frame: int
    #: Numbers of the targets.
    targets: tuple[int, ...]
    #: Number of the chain in ``Robot.chains``.
    chain: int = 0


def views_of(
    robot: Robot, cell: Cell, limits: SightLimits = USUAL_LIMITS
) -> tuple[tuple[View, ...], tuple[str, ...], tuple[str, ...]]:
    """Return what the instruments of a cell measure at a pose, and the names of stations and targets.

    Every instrument sees the targets that a joint moves against it: of a tracker those on one link are one view; a
    camera has a view of each board.

    Args:
        robot: The robot of the cell, see `calib.data.cell_chains.robot_of_cell`.
        cell: Instruments, targets and links.
        limits: Distances and tilts at which a camera may see a board.

    Raises:
        CalibError: No instrument that poses can be planned for.
    """
    images = _takes_images(cell)
    groups, targets = named_stations(cell, images=images), named_targets(cell, images=images)
    frame_links, target_links = links_of(cell, robot, groups, targets)
    of_one_link = len(set(frame_links)) == 1 and len(set(target_links)) == 1
    if of_one_link and len(cell.cameras) <= 1 and len(cell.boards) <= 1:
        instrument = instrument_of(cell, limits)
        return (View(instrument, 0, tuple(range(len(targets)))),), groups, targets

    in_turn = [
        name for name, link in zip(groups, frame_links, strict=True) if frame_links.count(link) > 1
    ]
    if in_turn and not images:
        raise ModelError(
            f"Poses are planned for one station on a link, and {choices(in_turn)} are on one. Plan for one of them, "
            "and then for the other with --taken."
        )
    # The tracker's place is stated in the base.
    home = cell.base or robot.urdf.root
    found: dict[tuple[int, int, int], View] = {}
    for (f, t), chain in chain_numbers(robot, frame_links, target_links).items():
        of_sight = cell_of_sight(cell, groups[f], targets[t])
        if frame_links[f] != home:
            of_sight = replace(of_sight, tracker=None)
        key = (f, chain, t if images else -1)
        others = found[key].targets if key in found else ()
        found[key] = View(instrument_of(of_sight, limits), f, (*others, t), chain)
    return tuple(found.values()), groups, targets


def _cell_of(
    views: Sequence[View], cell: Cell, groups: Sequence[str], targets: Sequence[str]
) -> Cell:
    """Return a cell as a fit of the rows of all views will use it, with what was assumed of cameras and boards."""
    if len(views) == 1:
        return views[0].instrument.in_cell(cell)
    cameras, boards, kind = dict(cell.cameras), dict(cell.boards), cell.kind
    for view in views:
        assumed = view.instrument.in_cell(cell)
        kind = assumed.kind
        if isinstance(view.instrument, CameraInstrument):
            group, target = groups[view.frame], targets[view.targets[0]]
            cameras[group if group in cameras else ""] = assumed.cameras[""]
            boards[target if target in boards else ""] = assumed.boards[""]
    return replace(cell, kind=kind, cameras=cameras, boards=boards)


def _stop_rows(
    views: Sequence[View], robot: Robot, groups: Sequence[str], targets: Sequence[str]
) -> tuple[Measurements, list[Integers]]:
    """Return the rows of one stop, view by view, with arbitrary measured values, and the numbers of each view's."""
    tables = []
    for view in views:
        names = [targets[t] for t in view.targets]
        tables.append(view.instrument.stop_rows(robot, names, groups[view.frame]))
    of_view = np.repeat(np.arange(len(tables)), [len(table) for table in tables])
    rows = [np.flatnonzero(of_view == v) for v in range(len(tables))]
    return Measurements.joined(tables), rows


@dataclass(frozen=True, slots=True, eq=False)
class Sensitivity:
    """Model of a robot in a cell, as the fit will use it; p is the number of parameters, k that of targets."""

    #: The cell that the fit will use: noise, tracker, payload, priors.
    cell: Cell
    #: The instruments and the targets that they measure, the first instrument first.
    views: tuple[View, ...]
    #: Frames and targets; a target that was not given is at a general place.
    setup: Setup
    #: Poses and derivatives of the nominal robot, under the error model of the fit.
    kinematics: Kinematics
    #: Shape (p,), 1 / tau^2 of each parameter's prior, its own or its family's, or of the leash.
    precision: Array
    #: Notes on what was assumed.
    notes: tuple[Note, ...]

    @classmethod
    def of(
        cls,
        robot: Robot,
        cell: Cell,
        instrument: Instrument | None = None,
        limits: SightLimits = USUAL_LIMITS,
    ) -> Sensitivity:
        """Make the model of a robot in a cell, as the fit will use it.

        Args:
            robot: The nominal robot, from the links of the instruments to those of the targets.
            cell: Cell that the fit will use; the error model ``"auto"`` is taken as ``"placement"``, and known
                distances between stations do not count. A target that it does not give is put at (50, 70, 30) mm in the
                tip, and the notes say so.
            instrument: The instrument; None: those of the cell.
            limits: Distances and tilts at which the cell's cameras may see a board.

        Raises:
            ModelError: A kind of measurement, or a parameter, that cannot be planned for.
        """
        if instrument is None:
            views, groups, targets = views_of(robot, cell, limits)
        else:
            images = isinstance(instrument, CameraInstrument)
            groups, targets = (
                named_stations(cell, images=images),
                named_targets(cell, images=images),
            )
            views = (View(instrument, 0, tuple(range(len(targets)))),)
        cell = replace(_cell_of(views, cell, groups, targets), distances=())
        table, rows_of_views = _stop_rows(views, robot, groups, targets)
        stop = np.zeros(len(table), dtype=np.int_)
        setup = measurement_setup(
            robot, cell, table, (views[0].instrument.kind,), np.zeros(len(table), dtype=np.int_)
        )
        setup, internals = with_internals(setup, table, cell, stop)
        if internals is not None and len(views) > 1:
            views = tuple(
                replace(view, instrument=view.instrument.with_internals(internals[rows]))
                for view, rows in zip(views, rows_of_views, strict=True)
            )
        # The setup numbers stations and targets by their rows.
        views = tuple(
            replace(
                view,
                frame=setup.groups.index(groups[view.frame]),
                targets=tuple(setup.targets.index(targets[t]) for t in view.targets),
            )
            for view in views
        )
        assumed = dict.fromkeys(entry for view in views for entry in view.instrument.assumed)
        notes = [Note(code, values) for code, values in assumed]
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
        return cls(cell, views, setup, kinematics, read_only(precision), tuple(notes))

    @property
    def instrument(self) -> Instrument:
        """The only instrument, or the first one."""
        return self.views[0].instrument

    @property
    def sights(self) -> tuple[Sight, ...]:
        """The station and the target of each scalar or vector that is measured at a pose, view by view."""
        groups, targets = self.setup.groups, self.setup.targets
        return tuple((groups[view.frame], targets[t]) for view in self.views for t in view.targets)

    def of_sights(self, seen: Mask) -> Mask:
        """Return which sights are seen, (n, k), read-only, by which of the v views are, (n, v)."""
        of_sights = np.repeat(seen, [len(view.targets) for view in self.views], axis=1)
        of_sights.setflags(write=False)
        return of_sights

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
        """The sightlines of the first view, see `sightlines_of`."""
        return self.sightlines_of(self.views[0])

    def sightlines_of(self, view: View) -> tuple[Sightline, ...]:
        """Return an instrument with each of its targets, and the chain between; () if its place is not known."""
        T_instrument_base = view.instrument.T_instrument_base
        if T_instrument_base is None:
            return ()
        chain = self.kinematics.robot.chains[view.chain]
        places = self.setup.T_tip_target[list(view.targets)]
        return tuple(Sightline(chain, T_instrument_base, T) for T in places)

    def expected(self, q: Array) -> Array:
        """Predict where each of the k targets is in the measurement frame, by the nominal robot.

        Args:
            q: Joint values of N poses, shape (N, m), [rad] or for sliding joints [m], columns as ``robot.joint_names``.

        Returns:
            Positions of the targets (of a board, its centre), shape (N, k, 3), [m], in the order of `sights`.
        """
        parts = []
        for view in self.views:
            T = self.kinematics.poses(np.zeros(len(self.names)), self._samples(view, q))
            parts.append(transform(T, view.instrument.points[:1]).reshape(len(q), -1, 3))
        return np.concatenate(parts, axis=1)

    def _samples(self, view: View, q: Array, moves: Array | None = None) -> Samples:
        """Return N k samples at N poses (N, m): all k targets of a view at the first pose, then at the second, ...

        They have loads if an error of the model depends on these. Without the joints' last moves (N, m) the robot goes
        from each pose to the next.
        """
        targets = len(view.targets)
        load = None
        robot = self.kinematics.robot
        factors = [parameter.factor for parameter in self.kinematics.model.parameters]
        if any(factor is not None and factor.loaded for factor in factors):
            of_poses = gravity_loads(robot, q, self.cell.payload, self.cell.gravity)
            load = np.repeat(of_poses, targets, axis=0)
        frame = np.full(targets * len(q), view.frame)
        target = np.tile(np.array(view.targets), len(q))
        moves = np.repeat(last_moves(q) if moves is None else moves, targets, axis=0)
        chain = np.full(len(frame), view.chain) if robot.branches else None
        return Samples(np.repeat(q, targets, axis=0), frame, target, load, moves=moves, chain=chain)

    def measured(self, q: Array, moves: Array | None = None, seen: Mask | None = None) -> Array:
        """Differentiate what is measured by the parameters, whitened by the noise.

        Args:
            q: Joint values of n poses, shape (n, m), [rad] or for sliding joints [m], columns as ``robot.joint_names``.
            moves: Last move of each joint before each pose, shape (n, m); None: from the pose before.
            seen: Which of the v views measure at each pose, shape (n, v); None: all.

        Returns:
            Derivative of the d scalars that stand for all measurements at a pose, shape (n, d, p), in standard
            deviations of the noise per unit of the parameter; see `calib.instruments.instrument.Instrument.whitened`.
            Zero for views that do not measure.
        """
        parts = []
        for v, view in enumerate(self.views):
            samples = self._samples(view, q, moves)
            T, twists = self.kinematics.twists(np.zeros(len(self.names)), samples)
            T = T.reshape(len(q), -1, 4, 4)
            twists = twists.reshape(*T.shape[:2], *twists.shape[1:])
            noise = self._noise(view, q)
            part = view.instrument.whitened(T, twists, noise, self.kinematics.model)
            parts.append(part if seen is None else np.where(seen[:, v, None, None], part, 0.0))
        return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)

    def located(self, q: Array) -> Array:
        """Differentiate the predicted positions of the k targets, in their measurement frames, by the p parameters.

        If no position is measured, as with distances, the pose of the base cannot be known: the rigid motion of all
        n k positions that explains a column best is subtracted from it.

        Args:
            q: Joint values of n poses, shape (n, m), [rad] or for sliding joints [m], columns as ``robot.joint_names``.

        Returns:
            Shape (n, 3 k, p), x, y, z of the first sight's target, then of the second's, ..., [m per unit of the
            parameter].
        """
        parts = []
        for view in self.views:
            zero, point = np.zeros(len(self.names)), view.instrument.points[:1]
            has_lever = bool(point.any())
            T, twists = self.kinematics.twists(zero, self._samples(view, q), rotation=has_lever)
            slopes = twists[:, :3]
            if has_lever:
                lever = transform(T, point)[:, 0] - T[:, :3, 3]
                slopes = slopes + np.cross(twists[:, 3:], lever[:, :, None], axis=1)
            if not view.instrument.locates:
                slopes = without_rigid_motion(T[:, :3, 3], slopes)
            parts.append(slopes.reshape(len(q), -1, len(self.names)))
        return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)

    def noise(self, q: Array) -> Array:
        """Return the standard deviation of a measured scalar at each pose, by the distance to the first target.

        An instrument that does not measure positions, such as an anchor, is the origin of the measurement frame; one
        whose place is not known is taken to be 3 m away. Of several views it is that of the first.

        Args:
            q: Joint values of n poses, shape (n, m), [rad] or for sliding joints [m], columns as ``robot.joint_names``.

        Returns:
            Shape (n,), in the unit of the scalars, [m] or for images [px].
        """
        return self._noise(self.views[0], q)

    def _noise(self, view: View, q: Array) -> Array:
        """Return the standard deviation of a scalar that a view measures at each of n poses, (n,) [m] or [px]."""
        sightlines = self.sightlines_of(view)
        if not view.instrument.kind.position:
            T = self.kinematics.poses(np.zeros(len(self.names)), self._samples(view, q))
            points = transform(T, view.instrument.points[:1]).reshape(len(q), -1, 3)
            distance = np.linalg.norm(points[:, 0], axis=1)
        elif not sightlines:
            distance = np.full(len(q), _USUAL_DISTANCE)
        else:
            distance = sightlines[0].distances(q)
        return view.instrument.noise(distance)

    def sigma_by_unit(self, q: Array) -> dict[str, float]:
        """Return the standard deviation of one scalar in each unit that is measured; of lengths, the rms over poses.

        Args:
            q: Joint values of n poses, shape (n, m), [rad] or for sliding joints [m], columns as ``robot.joint_names``.
        """
        units = self.instrument.kind.units
        sigma = {unit: self.instrument.sigma[unit] for unit in RESIDUAL_UNITS if unit in units}
        if "m" in sigma:
            noise = [self._noise(view, q) for view in self.views]
            sigma["m"] = float(np.sqrt(np.mean(np.square(noise))))
        return sigma

    def analysed(self, q: Array, measured: Array) -> Observability:
        """Analyse which of the p parameters some poses determine.

        The derivative is scaled back from standard deviations to the unit of the noise, [m] or for images [px], as a
        fit does; that of several views by the noise of the first.

        Args:
            q: Joint values of n poses, shape (n, m), [rad] or for sliding joints [m], columns as ``robot.joint_names``.
            measured: Result of the method `measured` for these poses, shape (n, d, p).

        Returns:
            Rank, parameters that are determined by themselves, unobservable combinations, and observability indices.
        """
        sigma = np.repeat(self.noise(q), measured.shape[1])[:, None]
        jacobian = measured.reshape(len(sigma), -1) * sigma
        return analyse(jacobian, self.names, self.units)
