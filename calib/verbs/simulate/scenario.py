"""A virtual cell: a robot whose errors are known is measured, and everything that disturbs a measurement is known too.

    measured = T_frame_target(q) + drift + robot's repeatability + instrument's noise + outliers

A `Scenario` states what cells are to be like; a seed draws a `VirtualCell` out of it, which measures any poses. See
docs/simulation.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

import calib.data.kinds as registry
from calib.basics.arguments import check_names, check_type, check_whole
from calib.basics.arrays import Array, Mask, read_only
from calib.basics.channels import RESIDUAL_UNITS, VECTOR
from calib.basics.values import Value, keep_read_only, one_line
from calib.data.cell import Cell, TrackerNoise
from calib.data.columns import SETS
from calib.data.inputs import ROBOT, RobotInput, cell_of, robot_of
from calib.data.kinds import Kind
from calib.data.measurements import Measurements
from calib.errors import CalibError, ModelError, choices
from calib.numerics.geometry import vector
from calib.robot.ranges import joint_ranges
from calib.robot.robot import Robot
from calib.verbs.simulate.cell_noise import USUAL_NOISE, cell_noise, further_noise
from calib.verbs.simulate.disturbances import Encoder, MovedTarget, Outliers
from calib.verbs.simulate.random_streams import stream
from calib.verbs.simulate.reading_noise import with_pose_noise, with_reading_noise
from calib.verbs.simulate.scenario_checks import check_scenario
from calib.verbs.simulate.tour import Tour
from calib.verbs.simulate.truth import TARGET_ERROR, Truth, draw_truth

#: Position of the tracker in the base if nothing is given [m].
DEFAULT_TRACKER = read_only((3.0, 0.0, 0.0))

#: The set of errors where the cell leaves the choice to the data.
DEFAULT_MODEL = "placement"


@dataclass(frozen=True, slots=True, eq=False)
class Scenario(Value):
    """Specification of virtual cells, before anything is drawn."""

    #: The nominal robot; may be given as the path of a URDF or xacro, or a name such as ``"ur3"``, with the cell's base
    #: and tip
    robot: Robot
    #: Targets, frames, tracker, payload, gravity, kind, and limits of single errors; may be given as the path of a file
    cell: Cell = field(default_factory=Cell)
    #: Errors of the robot, see `draw_truth`
    model: str = DEFAULT_MODEL
    #: Standard deviations of the errors that are drawn, by family; None: none is drawn
    sizes: Mapping[str, float] | None = field(default_factory=dict)
    #: Names and values of single errors
    errors: tuple[tuple[str, float], ...] = ()
    #: The true geometry, if it is given
    true_robot: Robot | None = None
    #: Standard deviation of the targets' true positions about their stated ones [m]
    target_error: float = TARGET_ERROR
    #: Of one coordinate, by the distance from the tracker; None: none. The repeatability in it displaces all targets
    #: of one stop alike; of the kind ``distance`` the distance is that from the anchor. Default: the cell's
    #: ``sigma["m"]`` everywhere, else its tracker's noise, else the usual one
    noise: TrackerNoise | None = USUAL_NOISE
    #: Standard deviation of one scalar in the other units, by their symbols: ``"rad"`` of an orientation about one axis
    #: [rad], ``"px"`` of an image coordinate [px]; of a unit that is missing the cell's, else 0. Without ``noise`` the
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
    #: Number of tours of all poses
    visits: int = 1

    def __post_init__(self) -> None:
        """Read robot and cell where paths were given, refuse other kinds, and keep read-only copies."""
        object.__setattr__(self, "cell", cell_of(self.cell))
        object.__setattr__(self, "robot", robot_of(self.robot, self.cell))
        check_scenario(self)
        if self.kind.measure is None:
            allowed = [name for name in registry.names() if registry.get(name).measure is not None]
            raise CalibError(
                f"Measurements of the kind '{self.kind.name}' cannot be simulated; choose one of "
                f"{choices(allowed)}."
            )
        object.__setattr__(self, "drift", vector(self.drift, "drift"))
        if self.noise is USUAL_NOISE:
            object.__setattr__(self, "noise", cell_noise(self.cell))
        if self.noise is not None:
            object.__setattr__(self, "sigma", {**further_noise(self.cell), **self.sigma})
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
        """Position of the tracker in the base, shape (3,), [m]; None: at the origin of its frame.

        That is the cell's tracker; or where measurements are in the base frame, 3 m away along its x axis.
        """
        cell = self.cell
        if cell.tracker is not None:
            return cell.tracker.position
        has_frames = cell.frames or cell.T_frame_base is not None or cell.estimate_frame
        return None if has_frames else DEFAULT_TRACKER

    def draw(self, seed: int) -> VirtualCell:
        """Draw a virtual cell with the errors of a seed; `CalibError` where a camera measures it."""
        if self.kind.optical:
            raise CalibError(
                f"Rows of the kind '{self.kind.name}' are corners in pictures, which are simulated by "
                "calib.verbs.simulate.camera.simulate.simulate_pictures."
            )
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
        return VirtualCell(self, truth)

    def random_poses(self, count: int, seed: int, *, validation: bool = False) -> Array:
        """Draw readings at joint values inside the limits, or the cell's ranges.

        Args:
            count: Number of poses.
            seed: Of the random numbers.
            validation: Whether they are poses to validate with, which have random numbers of their own.

        Returns:
            shape (count, m), [rad] or [m].
        """
        check_whole("count", count, 0)
        low, high = joint_ranges(self.robot, self.cell.ranges).T
        rng = stream(seed, "validation poses" if validation else "poses")
        values = low + (high - low) * rng.uniform(size=(count, len(low)))
        return self.robot.readings(values)

    def poses(
        self,
        seed: int,
        count: int = 30,
        validation: int = 0,
        given: Array | None = None,
        sets: tuple[str, ...] = (),
    ) -> tuple[Array, tuple[str, ...]]:
        """Return the poses to measure, and the set of each.

        Args:
            seed: Of the random numbers.
            count: Number of random poses to estimate from.
            validation: Number of random poses to validate with.
            given: shape (n, m), poses in place of the random ones [rad] or [m]; None: ``count`` random ones.
            sets: The set of each of them; (): all to estimate from.

        Returns:
            shape (N, m), [rad] or [m], and ``"estimate"`` or ``"validate"`` for each.
        """
        q = self.random_poses(count, seed) if given is None else given
        extra = self.random_poses(validation, seed, validation=True)
        estimate, validate = SETS
        all_sets = (sets or (estimate,) * len(q)) + (validate,) * len(extra)
        return np.concatenate([q, extra]), all_sets


@dataclass(frozen=True, slots=True, eq=False)
class Simulated(Value):
    """Measurements of a virtual cell, and the truth of each row."""

    #: The table, as `calib calibrate` reads it
    measurements: Measurements
    #: The robot, the targets and the frames
    truth: Truth
    #: shape (R, m), true joint values in each row, before the joints' errors [rad] or [m]
    q: Array
    #: shape (R, 4, 4), true poses of the targets, the moved one's included [m]
    T_frame_target: Array
    #: Shape (R,), standard deviation of the noise of one coordinate or length [m]
    sigma: Array
    #: shape (R, 3), displacement of outliers [m]; zero in other rows. Of lengths the first column is the change
    outliers: Array
    #: Shape (R,), whether a row found the target moved
    moved: Mask
    #: Of the random numbers
    seed: int

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

    #: What is measured, and what disturbs it
    scenario: Scenario
    #: The robot, the targets and the frames
    truth: Truth

    def __repr__(self) -> str:
        """Return one line: what it was drawn out of."""
        return one_line("VirtualCell", repr(self.scenario))

    def measure(self, q: ArrayLike, seed: int = 0, sets: Sequence[str] | None = None) -> Simulated:
        """Measure every target at every pose.

        The poses are dealt out among the groups in turn; with several visits the whole tour is made again.

        Args:
            q: Poses that the robot is sent to, shape (N, m), [rad] or [m].
            seed: Of the random numbers.
            sets: ``"estimate"`` or ``"validate"`` for each pose; None: all to estimate from.

        Returns:
            The measurements, and the truth of each row.

        Raises:
            CalibError: Values that are none of these joints, or a disturbance that does not fit.
        """
        scenario, robot = self.scenario, self.truth.nominal
        commanded = robot.columns(q)
        if sets is not None:
            check_names("sets", sets)
        sets = (SETS[0],) * len(commanded) if sets is None else tuple(sets)
        tour = Tour.of(self.truth, sets, visits=scenario.visits, paired=scenario.kind.paired)
        sliding = [joint.type == "prismatic" for joint in robot.inputs]
        true_q, read_q = scenario.encoder.measure(commanded[tour.route], sliding, seed)
        T, moved = self._true_poses(tour, true_q)
        instrument = self._instrument_std(T, tour)
        outliers = self._outliers(tour, seed)
        readings = self._readings(T, tour, instrument, outliers, seed)
        repeatability = scenario.noise.repeatability if scenario.noise else 0.0
        rows_per_reading = 2.0 if scenario.kind.paired else 1.0
        return Simulated(
            measurements=self._table(tour, read_q, readings),
            truth=self.truth,
            q=read_only(true_q[tour.stop]),
            T_frame_target=read_only(T),
            sigma=read_only(np.hypot(instrument, np.sqrt(rows_per_reading) * repeatability)),
            outliers=read_only(outliers),
            moved=moved,
            seed=int(seed),
        )

    def _table(self, tour: Tour, read_q: Array, readings: Array) -> Measurements:
        """Return the table of measurements.

        Args:
            tour: The R rows.
            read_q: Joint values that are read at each stop, shape (stops, m), [rad] or [m].
            readings: What the instrument reads, shape (R, k).
        """
        robot, kind, truth = self.truth.nominal, self.scenario.kind, self.truth
        prismatic = [joint.name for joint in robot.inputs if joint.type == "prismatic"]
        return Measurements(
            joint_names=robot.joint_names,
            joints=read_q[tour.stop],
            sets=tour.sets,
            targets=tuple(truth.targets[t] for t in tour.target),
            groups=tuple(truth.groups[g] for g in tour.group),
            kinds=(kind.name,) * len(tour),
            prismatic=tuple(prismatic),
            pairs=tour.pairs,
            **Measurements.columns_of(kind, readings),
        )

    def _true_poses(self, tour: Tour, true_q: Array) -> tuple[Array, Mask]:
        """Compute the true poses of the targets.

        Args:
            tour: The R rows.
            true_q: True joint values at each stop, shape (stops, m), [rad] or [m].

        Returns:
            T_frame_target, shape (R, 4, 4), [m], and whether a row found its target moved, shape (R,).
        """
        truth, event = self.truth, self.scenario.moved
        T_tip_target = truth.T_tip_target[tour.target].copy()
        moved = np.zeros(len(tour), dtype=np.bool_)
        if event is not None:
            moved = event.rows([truth.targets[t] for t in tour.target])
            T_tip_target[moved, :3, 3] += event.by
        moved.setflags(write=False)
        T_base_tip = truth.tip_poses(true_q)[tour.stop]
        return truth.T_frame_base[tour.group] @ T_base_tip @ T_tip_target, moved

    def _instrument_std(self, T: Array, tour: Tour) -> Array:
        """Return the standard deviation of the instrument alone.

        Args:
            T: True poses of the targets in the frames, shape (R, 4, 4), [m].
            tour: The R rows.

        Returns:
            shape (R,), [m].
        """
        noise, kind, tracker = self.scenario.noise, self.scenario.kind, self.scenario.tracker
        if noise is None:
            return np.zeros(len(T))
        distance = np.linalg.norm(T[:, :3, 3], axis=1)
        lengths = [i for i, one in enumerate(kind.readings) if one.quantity == "length"]
        if lengths and not kind.position:  # the instrument is what the length is measured from
            assert kind.measure is not None
            distance = np.abs(kind.measure(tour.with_partners(T))[:, lengths[0]])
        elif tracker is not None:
            T_frame_base = self.truth.T_frame_base[tour.group]
            position = T_frame_base[:, :3, :3] @ tracker + T_frame_base[:, :3, 3]
            distance = np.linalg.norm(T[:, :3, 3] - position, axis=1)
        return np.asarray(noise.constant + noise.per_length * distance)

    def _outliers(self, tour: Tour, seed: int) -> Array:
        """Draw the displacement of each row's measurement, shape (R, 3), [m]; of a pair that of its first row."""
        displacement = np.zeros((len(tour), 3))
        outliers = self.scenario.outliers
        if outliers is None:
            return displacement
        rows = np.arange(len(tour))
        first = rows if tour.partner is None else rows[rows < tour.partner]
        candidates = [i for i in first.tolist() if tour.sets[i] == SETS[0]]
        chosen = outliers.choose(candidates, seed)
        directions = stream(seed, "outlier directions").standard_normal(displacement.shape)
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        if not self.scenario.kind.position:
            directions = np.sign(directions) * (1.0, 0.0, 0.0)
        displacement[chosen] = outliers.size * directions[chosen]
        return displacement

    def _readings(
        self,
        T: Array,
        tour: Tour,
        instrument: Array,
        outliers: Array,
        seed: int,
    ) -> Array:
        """Draw what the instrument reads in each row, as `calib.data.kinds.Kind` has it.

        Args:
            T: True poses of the targets in the frames, shape (R, 4, 4), [m].
            tour: The R rows.
            instrument: Standard deviation of the instrument, shape (R,), [m].
            outliers: Displacement of outliers, shape (R, 3), [m].
            seed: Of the random numbers.

        Returns:
            shape (R, k).
        """
        kind = self.scenario.kind
        assert kind.measure is not None
        noise = self._noise(len(T), instrument, seed)
        noise["length"][:, :VECTOR] += outliers
        displaced = self._displaced(T, tour, seed)
        exact = kind.measure(tour.with_partners(displaced))
        noisy = with_pose_noise(kind, exact, T[:, :3, :3], noise)
        if tour.partner is not None:  # both rows of a pair hold the one reading
            first_rows = np.minimum(np.arange(len(T)), tour.partner)
            noise = {quantity: added[first_rows] for quantity, added in noise.items()}
        return with_reading_noise(kind, noisy, noise)

    def _noise(self, rows: int, instrument: Array, seed: int) -> dict[str, Array]:
        """Draw the noise of what the kind measures, by quantity.

        Args:
            rows: Number R of rows.
            instrument: Standard deviation of lengths, shape (R,), [m].
            seed: Of the random numbers.

        Returns:
            For each quantity of `RESIDUAL_UNITS` shape (R, k), in its residual unit, with k of at least 3.
        """
        kind = self.scenario.kind
        noise: dict[str, Array] = {}
        for symbol, unit in RESIDUAL_UNITS.items():
            quantity = unit.quantity
            of_quantity = [reading for reading in kind.readings if reading.quantity == quantity]
            name = "tracker noise" if symbol == "m" else f"{quantity} noise"
            random = stream(seed, name)
            first = random.standard_normal((rows, VECTOR))
            further = random.standard_normal((rows, len(of_quantity)))
            std = (
                instrument if symbol == "m" else np.full(rows, self.scenario.sigma.get(symbol, 0.0))
            )
            noise[quantity] = np.hstack([first, further]) * std[:, None]
        return noise

    def _displaced(self, T: Array, tour: Tour, seed: int) -> Array:
        """Return true poses with drift and the robot's repeatability, which all targets of a stop share.

        Args:
            T: True poses of the targets in the frames, shape (R, 4, 4), [m].
            tour: The R rows.
            seed: Of the random numbers.
        """
        noise = self.scenario.noise
        repeatability = 0.0 if noise is None else noise.repeatability
        drift = np.linspace(0.0, 1.0, len(T))[:, None] * self.scenario.drift
        unit_normal = stream(seed, "robot noise").standard_normal((len(tour.route), 3))
        of_stops = repeatability * unit_normal
        displaced: Array = T.copy()
        displaced[:, :3, 3] += drift + of_stops[tour.stop]
        return displaced


def simulate(
    scenario: Scenario | RobotInput,
    count: int = 30,
    validation: int = 10,
    seed: int = 0,
    poses: ArrayLike | None = None,
    sets: tuple[str, ...] = (),
) -> Simulated:
    """Simulate measurements of a robot whose errors are drawn by the seed.

    Args:
        scenario: What is measured, and what disturbs it. A robot, the path of a URDF or xacro, or a name such as
            ``"ur3"`` stands for the usual scenario of that robot.
        count: Number of random poses to estimate from.
        validation: Number of random poses to validate with.
        seed: The same seed gives the same measurements.
        poses: shape (n, m), poses in place of the random ones [rad] or [m]; None: ``count`` random ones.
        sets: The set of each of them; (): all to estimate from.

    Returns:
        The measurements, and the truth.

    Raises:
        ArgumentError: An argument of another type.
        ModelError: Poses that are none of this robot, or negative numbers.
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
    q, all_sets = made.poses(seed, count, validation, given, sets)
    return made.draw(seed).measure(q, seed, all_sets)
