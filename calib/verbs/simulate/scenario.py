"""A virtual cell: a robot with known errors is measured, and everything that disturbs a measurement is known too.

    measured = T_frame_target(q) + drift + robot's repeatability + instrument's noise + outliers

A `Scenario` specifies cells; a seed draws a `VirtualCell` from it, which measures any poses with a tracker or a camera.
See docs/simulation.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

import calib.data.kinds as registry
from calib.basics.arguments import (
    check_mapping,
    check_names,
    check_number,
    check_type,
    check_whole,
    numbers,
)
from calib.basics.arrays import Array, Mask, read_only
from calib.basics.channels import residual_unit
from calib.basics.values import Value, keep_read_only, one_line
from calib.data.cell import Cell, TrackerNoise
from calib.data.cell_chains import cell_of_sight, named_targets
from calib.data.columns import DEFAULT_TARGET, SETS
from calib.data.inputs import ROBOT, RobotInput, cell_of, robot_of
from calib.data.kinds import Kind
from calib.data.measurements import Measurements
from calib.data.references import References
from calib.errors import CalibError, ModelError, choices
from calib.instruments.camera import camera_and_board_places
from calib.instruments.instrument import Sightline
from calib.instruments.tracker import USUAL_NOISE, noise_of_lengths
from calib.model.families import family_of
from calib.numerics.geometry import vector
from calib.numerics.moves import last_moves
from calib.robot.ranges import joint_ranges
from calib.robot.robot import Robot
from calib.verbs.simulate.disturbances import (
    Encoder,
    FrameStep,
    MovedTarget,
    Outliers,
    StandingTargets,
)
from calib.verbs.simulate.equipment import Equipment, draw_equipment
from calib.verbs.simulate.mounting import draw_scene
from calib.verbs.simulate.random_streams import stream
from calib.verbs.simulate.simulated_rows import (
    CameraReader,
    Pictures,
    Reader,
    Stops,
    Tour,
    TrackerReader,
)
from calib.verbs.simulate.truth import TARGET_ERROR, Truth, draw_truth
from calib.verbs.simulate.views import CameraScene, draw_views

#: Position of the tracker in the base if nothing is given [m].
DEFAULT_TRACKER = read_only((3.0, 0.0, 0.0))

#: Distance of a further robot from the first one if its place is not stated: their hands meet [m].
BESIDE = 1.0

#: The set of errors if the cell leaves the model to the data.
DEFAULT_MODEL = "placement"

#: Attributes of a scenario with their types, and the words of messages for these.
_TYPES = (
    ("model", str, "the name of a model"),
    ("errors", Sequence, "pairs of the name and the value of an error"),
    ("noise", (TrackerNoise, type(None)), "a TrackerNoise, or None"),
    ("encoder", Encoder, "an Encoder"),
    ("outliers", (Outliers, type(None)), "Outliers, or None"),
    ("moved", (MovedTarget, type(None)), "a MovedTarget, or None"),
    ("step", (FrameStep, type(None)), "a FrameStep, or None"),
    ("standing", StandingTargets, "StandingTargets"),
    ("true_robot", (Robot, type(None)), "a Robot, or None"),
)


@dataclass(frozen=True, slots=True, eq=False)
class Scenario(Value):
    """Specification of virtual cells, before anything is drawn."""

    #: The nominal robot; may be given as the path of a URDF or xacro, or a name such as ``"ur3"``, with the cell's base
    #: and tip
    robot: Robot
    #: The cell, with limits of single errors; may be given as the path of a file
    cell: Cell = field(default_factory=Cell)
    #: Errors of the robot, see `draw_truth`
    model: str = DEFAULT_MODEL
    #: Standard deviations of the errors that are drawn, by family; None: none are drawn
    sizes: Mapping[str, float] | None = field(default_factory=dict)
    #: Names and values of single errors
    errors: tuple[tuple[str, float], ...] = ()
    #: The true geometry, if it is given
    true_robot: Robot | None = None
    #: Standard deviation of the targets' true positions around their stated ones [m]
    target_error: float = TARGET_ERROR
    #: Noise of a coordinate, which depends on the distance from the tracker, or for the kind ``distance`` from the
    #: anchor; None: none. Its repeatability displaces all targets of one stop alike. Default: the cell's ``sigma["m"]``
    #: everywhere, else its tracker's noise, else the usual one
    noise: TrackerNoise | None = USUAL_NOISE
    #: Standard deviation of one scalar in the other units, by their symbols: ``"rad"`` of an orientation about one axis
    #: [rad], ``"px"`` of an image coordinate [px]; for a unit that is missing the cell's, else 0. Without ``noise`` the
    #: cell's does not count
    sigma: Mapping[str, float] = field(default_factory=dict)
    #: Steps of the joint values
    encoder: Encoder = field(default_factory=Encoder)
    #: Outliers; None: none
    outliers: Outliers | None = None
    #: A target that moves; None: none
    moved: MovedTarget | None = None
    #: shape (3,), drift of the instrument, or of the base, from the first row to the last, along the measurement
    #: frame's axes, linear in the row [m]
    drift: Array = field(default_factory=lambda: np.zeros(3))
    #: A step of the instrument, or of the base; None: none
    step: FrameStep | None = None
    #: Targets that stand still
    standing: StandingTargets = field(default_factory=StandingTargets)
    #: Number of tours of all poses
    visits: int = 1

    def __post_init__(self) -> None:
        """Read robot and cell if paths were given, check the values, fill in the cell's noise, keep read-only copies.

        A value of another type or out of range, or a kind that cannot be simulated, raises `CalibError`.
        """
        object.__setattr__(self, "cell", with_robots_placed(cell_of(self.cell)))
        object.__setattr__(self, "robot", robot_of(self.robot, self.cell))
        for name, types, allowed in _TYPES:
            check_type(name, getattr(self, name), types, allowed)
        check_number("target_error", self.target_error, 0.0)
        check_mapping("sigma", self.sigma)
        if "m" in self.sigma:
            raise CalibError(
                "The argument 'sigma' has 'm'; the noise of lengths is the argument 'noise', such as "
                "TrackerNoise(constant=1e-4, per_length=0.0)."
            )
        for unit, std in self.sigma.items():
            check_number(f"sigma[{residual_unit(unit).symbol!r}]", std, 0.0)
        check_whole("visits", self.visits, 1)
        if self.sizes is not None:
            check_mapping("sizes", self.sizes)
            for family, size in self.sizes.items():
                family_of(family)
                check_number(f"sizes[{family!r}]", size, 0.0)

        if self.kind.measure is None:
            able = [name for name in registry.names() if registry.get(name).measure is not None]
            raise CalibError(
                f"Measurements of the kind '{self.kind.name}' cannot be simulated; choose one of "
                f"{choices(able)}."
            )
        object.__setattr__(self, "drift", vector(self.drift, "drift"))
        check_whole("standing.count", self.standing.count, 0)
        check_whole("standing.every", self.standing.every, 1)
        if self.standing.count and not self.kind.position:
            raise CalibError(
                f"Targets that stand still are measured as positions, and the kind '{self.kind.name}' has none; leave "
                "out 'references' of [simulation]."
            )
        if self.noise is USUAL_NOISE:
            object.__setattr__(self, "noise", noise_of_lengths(self.cell))
        if self.noise is not None:
            of_cell = {unit: std for unit, std in self.cell.sigma.items() if unit != "m"}
            object.__setattr__(self, "sigma", {**of_cell, **self.sigma})
        keep_read_only(self, "sizes", "sigma")

    def __repr__(self) -> str:
        """Return one line: robot, errors, and kind of measurement."""
        robot = self.robot
        chain = f"'{robot.name}', {robot.base} to {robot.tip}"
        return one_line("Scenario", chain, f"errors of '{self.model}'", f"kind '{self.kind.name}'")

    @property
    def kind(self) -> Kind:
        """Kind of measurement: the cell's, or points."""
        return registry.get(self.cell.kind or "point")

    @property
    def tracker(self) -> Array | None:
        """Position of the tracker in the base, shape (3,), [m]; None: at the origin of each measurement frame.

        That is the cell's tracker; or if measurements are in the base frame, `DEFAULT_TRACKER`.
        """
        cell = self.cell
        if cell.tracker is not None:
            return cell.tracker.position
        has_frames = cell.frames or cell.T_frame_base is not None or cell.estimate_frame
        return None if has_frames else DEFAULT_TRACKER

    def draw(self, seed: int) -> VirtualCell:
        """Draw a virtual cell with the errors of a seed.

        In a cell of the kind ``"pixel"`` the camera and the board are drawn around those that the cell states, or
        around usual ones, and so are their places, if the cell does not give them.

        Args:
            seed: Of the random numbers.

        Returns:
            The robot with its true errors, the true places of targets and frames, and with a camera the equipment.

        Raises:
            ModelError: An error that the model does not have, or a true robot with other joints.
            CalibError: An error larger than calib allows. With a camera: disturbances that pictures do not have, or a
                board that is never seen.
        """
        truth = draw_truth(
            self.robot,
            self.model,
            self.sizes,
            seed,
            cell=self.cell,
            errors=dict(self.errors),
            true_robot=self.true_robot,
            target_error=self.target_error,
        )
        if not self.kind.is_image:
            return VirtualCell(self, truth)
        is_given = {
            "visits": self.visits > 1,
            "moved_row": self.moved is not None,
            "drift_mm": bool(self.drift.any()),
            "step_mm": self.step is not None,
        }
        given = [name for name, is_there in is_given.items() if is_there]
        if given:
            raise CalibError(f"Pictures are simulated without {choices(given)} of [simulation].")
        return self._with_scenes(truth, seed)

    def _with_scenes(self, truth: Truth, seed: int) -> VirtualCell:
        """Return a virtual cell with cameras and boards, placed as `draw_scene` does, each once, in the cell's order.

        It raises `CalibError` if a camera never sees a board, or a board is never seen.
        """
        cell, chains = self.cell, truth.nominal.chains
        targets = truth.targets
        equipment = draw_equipment(chains[0], cell, seed, truth.groups, targets)
        rng = stream(seed, "mounts")
        cameras: dict[int, Array] = {}
        boards: dict[int, Array] = {}
        aimed = []
        unseen: CalibError | None = None
        for (f, t), chain in truth.sights.items():
            stated = cell_of_sight(cell, truth.groups[f], targets[t])
            T_camera_base, T_tip_board = camera_and_board_places(stated)
            camera, printed = equipment.cameras[f], equipment.prints[t]
            try:
                sightline = draw_scene(
                    chains[chain],
                    camera,
                    printed,
                    rng,
                    cameras.get(f, T_camera_base),
                    boards.get(t, T_tip_board),
                ).sightline
            except CalibError as error:  # another camera may see it
                unseen = unseen or error
                continue
            cameras[f], boards[t] = sightline.T_instrument_base, sightline.T_tip_target
            aimed.append((f, t))
        if unseen is not None and (len(cameras) < len(truth.groups) or len(boards) < len(targets)):
            raise unseen
        T_tip_target = read_only(np.stack([boards[t] for t in range(len(targets))]))
        if targets == (DEFAULT_TARGET,):
            targets = (equipment.printed.board.name,)
        placed = replace(
            truth,
            T_frame_base=read_only(np.stack([cameras[f] for f in range(len(truth.groups))])),
            targets=targets,
            T_tip_target=T_tip_target,
            stated_T_tip_target=T_tip_target,
        )
        return VirtualCell(self, placed, equipment, tuple(aimed))

    def random_poses(self, count: int, seed: int, *, validation: bool = False) -> Array:
        """Draw readings at joint values that are uniform within the robot's limits, or the cell's ranges.

        Args:
            count: Number of poses.
            seed: Of the random numbers.
            validation: Whether the poses are for validation, which have random numbers of their own.

        Returns:
            shape (count, m), [rad] or [m].
        """
        check_whole("count", count, 0)
        low, high = joint_ranges(self.robot, self.cell.ranges).T
        rng = stream(seed, "validation poses" if validation else "poses")
        values = low + (high - low) * rng.uniform(size=(count, len(low)))
        return self.robot.readings(values)


@dataclass(frozen=True, slots=True, eq=False)
class Simulated(Value):
    """Measurements of a virtual cell, and the truth of each row."""

    #: The table, as `calib calibrate` reads it
    measurements: Measurements
    #: The robot, the targets and the frames
    truth: Truth
    #: shape (R, m), true joint values in each row, without the joints' errors [rad] or [m]
    q: Array
    #: shape (R, 4, 4), true poses of the targets, the moved one's included [m]
    T_frame_target: Array
    #: Shape (R,), standard deviation of the noise of one coordinate or length [m], or of an image coordinate [px]
    sigma: Array
    #: shape (R, 3) [m], displacement of outliers; zero in other rows. For lengths the first column is the change. For
    #: images shape (R, 2) [px]
    outliers: Array
    #: Shape (R,), whether a row found the target moved
    moved: Mask
    #: Of the random numbers
    seed: int
    #: The pictures whose corners are the rows; None: another instrument
    pictures: Pictures | None = None
    #: Shape (J, 3), true positions of the targets that stand still in the measurement frame [m]
    standing: Array = field(default_factory=lambda: read_only(np.zeros((0, 3))))

    def __repr__(self) -> str:
        """Return one line: the measurements and the seed."""
        return one_line("Simulated", repr(self.measurements), f"seed {self.seed}")

    @property
    def points(self) -> Array:
        """True positions of the targets in the measurement frame, shape (R, 3), [m]."""
        return self.T_frame_target[:, :3, 3]

    @property
    def outlier_rows(self) -> tuple[int, ...]:
        """Row numbers of the outliers."""
        return tuple(self.measurements.rows[i] for i in np.flatnonzero(self.outliers.any(axis=1)))


@dataclass(frozen=True, slots=True, eq=False)
class VirtualCell(Value):
    """A robot with known errors, and an instrument that measures it."""

    #: The specification that it was drawn from
    scenario: Scenario
    #: The robot, the targets and the frames; with cameras the frames are the cameras, the targets the boards
    truth: Truth
    #: The cameras and the boards as they are; None: another instrument
    equipment: Equipment | None = None
    #: Numbers of the cameras and the boards that they see at the poses that are drawn
    aimed: tuple[tuple[int, int], ...] = ()

    def __repr__(self) -> str:
        """Return one line: the scenario from which it was drawn."""
        return one_line("VirtualCell", repr(self.scenario))

    @property
    def reader(self) -> Reader:
        """The instrument with its noise and outliers: a camera if the cell was drawn with one, else a tracker."""
        scenario = self.scenario
        if self.equipment is not None:
            sigma = scenario.sigma.get("px", 0.0)
            return CameraReader(
                scenario.kind,
                self.equipment,
                self.truth.groups,
                named_targets(scenario.cell, images=True),
                sigma,
                scenario.outliers,
            )
        return TrackerReader(
            kind=scenario.kind,
            truth=self.truth,
            noise=scenario.noise,
            sigma=scenario.sigma,
            # Instruments on several links are each at the origin of their frame.
            position=scenario.tracker if len(set(self.truth.frame_links)) <= 1 else None,
            outliers=scenario.outliers,
        )

    def poses(self, count: int, seed: int, *, validation: bool = False) -> Array:
        """Draw readings at which targets are measured: random ones, or such that a camera sees a whole board.

        Of several cameras and boards each pair has its share of the poses, in turn.

        Args:
            count: Number of poses.
            seed: Of the random numbers.
            validation: Whether the poses are for validation, which have random numbers of their own.

        Returns:
            shape (count, m), [rad] or [m].

        Raises:
            CalibError: A camera sees the board at too few poses.
        """
        if self.equipment is None:
            return self.scenario.random_poses(count, seed, validation=validation)
        truth = self.truth
        random = stream(seed, "validation views" if validation else "views")
        poses = np.empty((count, len(truth.nominal.inputs)))
        for k, (f, t) in enumerate(self.aimed):
            chain = truth.nominal.chains[truth.sights[f, t]]
            sightline = Sightline(chain, truth.T_frame_base[f], truth.T_tip_target[t])
            scene = CameraScene(sightline, self.equipment.cameras[f], self.equipment.prints[t])
            mine = slice(k, count, len(self.aimed))
            poses[mine] = draw_views(scene, len(poses[mine]), random)
        return read_only(poses)

    def measure(
        self,
        q: ArrayLike,
        seed: int = 0,
        sets: Sequence[str] | None = None,
        moves: Array | None = None,
    ) -> Simulated:
        """Measure every target at every pose, or with cameras every corner of a board that is seen.

        The stations on one link take the poses in turn; with several visits the whole tour is repeated.

        Args:
            q: Commanded poses, shape (N, m), [rad] or [m].
            seed: Of the random numbers.
            sets: ``"estimate"`` or ``"validate"`` for each pose; None: all to estimate from.
            moves: Last move of each joint before each pose, shape (N, m), [rad] or [m]; None: from the pose before.

        Returns:
            The measurements, and the truth of each row.

        Raises:
            CalibError: Values that do not fit the joints, or a disturbance that does not fit the rows.
        """
        scenario, truth, robot = self.scenario, self.truth, self.truth.nominal
        commanded = robot.columns(q)
        if sets is not None:
            check_names("sets", sets)
        sets = (SETS[0],) * len(commanded) if sets is None else tuple(sets)
        tour = Tour.of(
            truth,
            sets,
            visits=scenario.visits,
            paired=scenario.kind.paired,
            at_once=self.equipment is not None,
        )
        sliding = [joint.type == "prismatic" for joint in robot.inputs]
        true_q, read_q = scenario.encoder.measure(commanded[tour.route], sliding, seed)

        T_tip_target = truth.T_tip_target[tour.target].copy()
        moved = np.zeros(len(tour), dtype=np.bool_)
        if scenario.moved is not None:
            moved = scenario.moved.rows([truth.targets[t] for t in tour.target])
            T_tip_target[moved, :3, 3] += scenario.moved.by
        moves = None if moves is None else moves[tour.route]
        T_base_tip = np.empty((len(tour), 4, 4))
        for chain in np.unique(tour.chain).tolist():
            views = tour.chain == chain
            T_base_tip[views] = truth.tip_poses(true_q, moves, chain)[tour.stop[views]]
        T = truth.T_frame_base[tour.group] @ T_base_tip @ T_tip_target

        # The robot's repeatability displaces all targets of one stop alike, those of each chain by its own.
        repeatability = 0.0 if scenario.noise is None else scenario.noise.repeatability
        drift = self._drift(np.arange(len(T), dtype=np.float64), len(T))
        shape = (len(robot.chains), len(tour.route), 3)
        unit_normal = stream(seed, "robot noise").standard_normal(shape)
        displaced = T.copy()
        displaced[:, :3, 3] += drift + (repeatability * unit_normal)[tour.chain, tour.stop]

        rows = self.reader.read(Stops(tour, read_q, true_q, T, displaced), seed)
        stop, found_moved = tour.stop[rows.view], moved[rows.view]
        found_moved.setflags(write=False)
        standing, references = self._references(T, tour, seed)
        measurements = Measurements(
            references=references,
            joint_names=robot.joint_names,
            joints=read_q[stop],
            sets=tuple(tour.sets[i] for i in rows.view),
            prismatic=tuple(joint.name for joint in robot.inputs if joint.type == "prismatic"),
            moves=None if moves is None else moves[stop],
            **rows.columns,
        )
        return Simulated(
            measurements=measurements,
            truth=truth,
            q=read_only(true_q[stop]),
            T_frame_target=read_only(T[rows.view]),
            sigma=read_only(rows.sigma),
            outliers=read_only(rows.outliers),
            moved=found_moved,
            seed=int(seed),
            standing=standing,
            pictures=None
            if rows.pictures is None
            else replace(rows.pictures, moves=None if moves is None else moves[tour.stop]),
        )

    def _drift(self, places: Array, rows: int) -> Array:
        """Return the displacement of the frame at places among so many rows, from 0, shape (n, 3) [m].

        A place between two whole numbers is that of a target that stands still, read between two rows.
        """
        scenario = self.scenario
        share = np.clip(places * (1.0 / max(rows - 1, 1)), 0.0, 1.0)
        drift = share[:, None] * scenario.drift
        if scenario.step is not None:
            if not 1 <= scenario.step.row <= rows:
                raise CalibError(
                    f"The frame is to move before row {scenario.step.row}; there are the rows 1 to {rows}."
                )
            drift = drift + (places >= scenario.step.row - 1)[:, None] * scenario.step.by
        return np.asarray(drift)

    def _references(self, T: Array, tour: Tour, seed: int) -> tuple[Array, References | None]:
        """Read the targets that stand still between the stops of a tour; T, (R, 4, 4), are the true poses there [m].

        Returned are their true positions, (J, 3) [m], and the readings; None if there are none. They stand about where
        the robot's targets are, and are numbered after the R rows.
        """
        scenario, count = self.scenario, self.scenario.standing.count
        if not count:
            return np.zeros((0, 3)), None
        if len(self.truth.groups) > 1:
            raise CalibError(
                "Targets that stand still are simulated with one station; leave out 'references' of [simulation]."
            )
        points = T[:, :3, 3]
        spread = stream(seed, "references").uniform(-1.0, 1.0, (count, 3))
        true = points.mean(axis=0) + spread * np.ptp(points, axis=0)
        rows, stops = len(T), len(tour.route)
        visited = [*range(0, stops, scenario.standing.every), stops]
        first = np.searchsorted(tour.stop, visited)  # the row after each visit
        before = np.asarray(np.repeat(first, count) - 0.5, dtype=np.float64)
        readings = np.tile(true, (len(visited), 1))
        if scenario.noise is not None:
            tracker = np.zeros(3)
            if scenario.tracker is not None:
                T_frame_base = self.truth.T_frame_base[0]
                tracker = T_frame_base[:3, :3] @ scenario.tracker + T_frame_base[:3, 3]
            distance = np.linalg.norm(readings - tracker, axis=1)
            std = scenario.noise.constant + scenario.noise.per_length * distance
            normal = stream(seed, "reference noise").standard_normal(readings.shape)
            readings = readings + std[:, None] * normal
        readings = readings + self._drift(before, rows)
        numbers = np.arange(rows + 1, rows + 1 + len(readings))
        # A visit is before the row of its place.
        places = np.concatenate([np.arange(rows, dtype=np.float64), before])
        order = np.argsort(places, kind="stable")
        return true, References(
            points=readings,
            targets=tuple(f"reference {k + 1}" for k in range(count)) * len(visited),
            groups=self.truth.groups * len(readings),
            rows=tuple(numbers.tolist()),
            sequence=tuple(np.concatenate([np.arange(1, rows + 1), numbers])[order].tolist()),
        )


def with_robots_placed(cell: Cell) -> Cell:
    """Return a cell whose further robots all stand somewhere: those without a place around the first, facing it."""
    placed = dict(cell.robots)
    for k, (name, robot) in enumerate(cell.robots.items()):
        if robot.T_root_base is None:
            angle = 2.0 * np.pi * k / len(cell.robots)
            T_root_base = np.eye(4)
            T_root_base[:3, :3] = Rotation.from_euler("z", angle + np.pi).as_matrix()
            T_root_base[:2, 3] = BESIDE * np.cos(angle), BESIDE * np.sin(angle)
            placed[name] = replace(robot, T_root_base=read_only(T_root_base))
    return replace(cell, robots=placed) if cell.robots else cell


def simulate(
    scenario: Scenario | RobotInput,
    count: int = 30,
    validation: int = 10,
    seed: int = 0,
    poses: ArrayLike | None = None,
    sets: tuple[str, ...] = (),
    moves: ArrayLike | None = None,
) -> Simulated:
    """Simulate measurements of a robot whose errors are drawn by the seed.

    Args:
        scenario: The robot, the kind of measurement and its disturbances. A robot alone, the path of a URDF or xacro,
            or a name such as ``"ur3"`` stands for the usual scenario of that robot. For the kind ``"pixel"`` the chain
            leads from the camera's link to the board's.
        count: Number of random poses to estimate from; for pictures, of poses from which the camera sees the board.
        validation: Number of random poses to validate with, in addition.
        seed: The same seed gives the same measurements.
        poses: shape (n, m), poses in place of the random ones [rad] or [m]; None: ``count`` random ones.
        sets: ``"estimate"`` or ``"validate"`` for each of ``poses``; (): all to estimate from.
        moves: Last move of each joint before each of ``poses``, shape (n, m), [rad] or [m]; None: the robot goes from
            each pose to the next.

    Returns:
        The measurements, and the truth.

    Raises:
        ArgumentError: An argument of another type.
        ModelError: Poses that do not fit the robot, or negative numbers.
        CalibError: For pictures: see `Scenario.draw` and `VirtualCell.poses`.
    """
    check_type("scenario", scenario, (Scenario, Robot, str, Path), f"a Scenario, or {ROBOT}")
    check_whole("count", count, 0)
    check_whole("validation", validation, 0)
    check_whole("seed", seed, 0)
    made = scenario if isinstance(scenario, Scenario) else Scenario(robot_of(scenario))
    given = None if poses is None else made.robot.columns(poses, "poses")
    check_names("sets", sets)
    if sets and (given is None or len(sets) != len(given)):
        raise ModelError(
            f"The argument 'sets' has {len(sets)} names; it must be one for each of 'poses'."
        )
    virtual = made.draw(seed)
    q = virtual.poses(count, seed) if given is None else given
    further = virtual.poses(validation, seed, validation=True)
    estimate, validate = SETS
    all_sets = (sets or (estimate,) * len(q)) + (validate,) * len(further)
    driven = np.concatenate([q, further])
    by_moves: Array | None = None
    if moves is not None:
        stated = numbers("moves", moves, "last moves of shape (n, m), [rad] or [m]")
        if given is None or stated.shape != given.shape:
            raise ModelError("The argument 'moves' must have one row for each of 'poses'.")
        by_moves = np.concatenate([stated, last_moves(driven)[len(q) :]])
    return virtual.measure(driven, seed, all_sets, by_moves)
