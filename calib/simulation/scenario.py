"""A virtual cell: a robot whose errors are known is measured, and everything that disturbs a measurement is known too.

    measured = T_frame_target(q) + drift + robot's repeatability + instrument's noise + outliers

A `Scenario` says what cells are to be like; a seed draws a `VirtualCell`, with errors of its own, out of it; and
`VirtualCell.measure` is a function of poses and a seed. Each disturbance has random numbers of its own, so that one can
be changed and the others stay. See docs/simulation.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

import calib.data.kinds as registry
from calib.data.cell import Cell, TrackerNoise, vector
from calib.data.kinds import Kind
from calib.data.measurements import Measurements
from calib.data.table import SETS
from calib.errors import CalibError, choices
from calib.robot.readback import joint_ranges
from calib.robot.robot import Robot, read_only
from calib.simulation.truth import (
    TARGET_ERROR,
    Encoder,
    MovedTarget,
    Outliers,
    Truth,
    draw_truth,
    stream,
)

Array = NDArray[np.float64]
Rows = NDArray[np.int_]

#: Where the tracker stands if nothing says so, in the base [m].
DEFAULT_TRACKER = read_only((3.0, 0.0, 0.0))

#: The set of errors where the cell leaves the choice to the data.
DEFAULT_MODEL = "placement"


@dataclass(frozen=True, slots=True, eq=False)
class Scenario:
    """What virtual cells are to be like, before anything is drawn."""

    robot: Robot  #: The nominal robot
    #: Targets, frames, tracker, payload, gravity, kind, and limits of single errors
    cell: Cell = field(default_factory=Cell)
    model: str = DEFAULT_MODEL  #: In which errors the robot is wrong, see `draw_truth`
    #: Standard deviations of the errors that are drawn; None: none is
    sizes: Mapping[str, float] | None = field(default_factory=dict)
    errors: tuple[tuple[str, float], ...] = ()  #: Names and values of single errors
    true_robot: Robot | None = None  #: The true geometry, if it is given
    #: How far targets sit from where they are said to, standard deviation [m]
    target_error: float = TARGET_ERROR
    #: Of one coordinate, by the distance from the tracker; None: none. The repeatability in it displaces all targets
    #: of one stop alike; of the kind ``distance`` the distance is that from the anchor
    noise: TrackerNoise | None = field(default_factory=TrackerNoise)
    sigma_angle: float = 0.0  #: Standard deviation of a measured orientation about one axis [rad]
    encoder: Encoder = field(default_factory=Encoder)  #: Steps of the joint values
    outliers: Outliers | None = None  #: Rows that are far off; None: none
    moved: MovedTarget | None = None  #: A target that moves; None: none
    #: shape (3,), how far the instrument, or the base, drifts from the first row to the last, along the measurement
    #: frame's axes, evenly [m]
    drift: Array = field(default_factory=lambda: np.zeros(3))
    visits: int = 1  #: How often the tour of all poses is made

    def __post_init__(self) -> None:
        """Refuse a kind that cannot be simulated, and numbers that are none."""
        if self.kind.measure is None:
            free = [name for name in registry.names() if registry.get(name).measure is not None]
            raise CalibError(
                f"Measurements of the kind '{self.kind.name}' cannot be simulated: their poses would have to hold the "
                f"target in a socket or on a plane. Choose one of {choices(free)}."
            )
        object.__setattr__(self, "drift", vector(self.drift, "drift"))

    @property
    def kind(self) -> Kind:
        """What is measured: the cell's kind, or points."""
        return registry.get(self.cell.kind or "point")

    @property
    def tracker(self) -> Array | None:
        """Where the tracker stands in the base, shape (3,), [m]; None: at the origin of its frame.

        That is the cell's tracker; or where measurements are in the base frame, 3 m away along its x axis.
        """
        cell = self.cell
        if cell.tracker is not None:
            return cell.tracker.position
        elsewhere = cell.frames or cell.T_frame_base is not None or cell.estimate_frame
        return None if elsewhere else DEFAULT_TRACKER

    def draw(self, seed: int) -> VirtualCell:
        """A virtual cell with the errors of this seed.

        Raises:
            CalibError: What the scenario says does not fit the robot.
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
        return VirtualCell(self, truth)

    def random_poses(self, count: int, seed: int, *, validation: bool = False) -> Array:
        """Joint values anywhere inside the limits, or the cell's ranges, shape (count, m), [rad] or [m].

        More of them are those of fewer and others; those to validate with are others for the same seed. Collisions are
        not looked at.

        Raises:
            CalibError: The cell has a range of no such joint, or outside its limits.
        """
        low, high = joint_ranges(self.robot, self.cell.ranges).T
        rng = stream(seed, "validation poses" if validation else "poses")
        return np.asarray(low + (high - low) * rng.uniform(size=(count, len(low))))

    def poses(
        self,
        seed: int,
        count: int = 30,
        validation: int = 0,
        given: Array | None = None,
        sets: tuple[str, ...] = (),
    ) -> tuple[Array, tuple[str, ...]]:
        """Where the robot is measured, shape (N, m), [rad] or [m], and the set of each pose.

        Args:
            seed: Of random poses.
            count: How many of them, where none are given.
            validation: How many random ones besides, to validate with.
            given: shape (n, m), poses in place of random ones.
            sets: Of these, ``"estimate"`` or ``"validate"``; () for all to estimate from.
        """
        q = self.random_poses(count, seed) if given is None else given
        extra = self.random_poses(validation, seed, validation=True)
        words = (sets or (SETS[0],) * len(q)) + (SETS[1],) * len(extra)
        return np.concatenate([q, extra]), words


@dataclass(frozen=True, slots=True, eq=False)
class Simulated:
    """What a virtual cell measured, and what was true of it."""

    measurements: Measurements  #: The table, as `calib calibrate` reads it
    truth: Truth  #: The robot, the targets and the frames
    #: shape (R, m), where the joints really stood in each row, before their own errors [rad] or [m]
    q: Array
    #: shape (R, 4, 4), true poses of the targets, the moved one's included [m]
    T_frame_target: Array
    sigma: Array  #: shape (R,), standard deviation of the noise of one coordinate or length [m]
    #: shape (R, 3), how far outliers are displaced [m]; zero in other rows. Of lengths the first column says how much
    #: longer they are
    outliers: Array
    moved: NDArray[np.bool_]  #: shape (R,), which rows found the target moved
    seed: int  #: Of the random numbers

    @property
    def points(self) -> Array:
        """True positions of the targets in the measurement frame, shape (R, 3), [m]."""
        return self.T_frame_target[:, :3, 3]

    @property
    def outlier_rows(self) -> tuple[int, ...]:
        """The row numbers of the outliers."""
        return tuple(self.measurements.rows[i] for i in np.flatnonzero(self.outliers.any(axis=1)))


@dataclass(frozen=True, slots=True, eq=False)
class VirtualCell:
    """A robot with known errors, and an instrument that measures it."""

    scenario: Scenario  #: What is measured, and what disturbs it
    truth: Truth  #: The robot, the targets and the frames

    def measure(self, q: ArrayLike, seed: int = 0, sets: Sequence[str] | None = None) -> Simulated:
        """Measure every target at every pose.

        The poses are dealt out among the set-ups in turn; with several visits the whole tour is made again.

        Args:
            q: shape (N, m), joint values that the robot is sent to [rad] or [m], in the order of its ``joint_names``.
            seed: Of the random numbers.
            sets: For each pose ``"estimate"`` or ``"validate"``; default all to estimate from.

        Raises:
            ModelError: q has another number of columns, or a number that is not finite.
            CalibError: No poses, or what does not fit them: a row, a number of outliers, an odd pose of pairs.
        """
        scenario, truth, robot = self.scenario, self.truth, self.truth.nominal
        kind, noise = scenario.kind, scenario.noise
        q = np.atleast_2d(np.asarray(q, dtype=np.float64))
        if not q.size:
            raise CalibError("There are no poses to measure at; give one or more.")
        robot.chain_values(q)  # refuses what are no values of these joints
        sets = (SETS[0],) * len(q) if sets is None else tuple(sets)
        if len(sets) != len(q):
            raise CalibError(
                f"There are {len(q)} poses and {len(sets)} words that say their sets; give one of {choices(SETS)} for "
                "each pose."
            )
        # All targets at each stop, one tour of the poses after the other: what each row is of.
        route, number = np.tile(np.arange(len(q)), scenario.visits), len(truth.targets)
        stop = np.repeat(np.arange(len(route)), number)
        pose, target = route[stop], np.tile(np.arange(number), len(route))
        group = pose % len(truth.groups)
        words, names = tuple(sets[i] for i in pose), tuple(truth.targets[t] for t in target)
        partner = _partners(sets, pose, number) if kind.paired else None

        sliding = [joint.type == "prismatic" for joint in robot.inputs]
        stood, read = scenario.encoder.measure(q[route], sliding, seed)
        placed, moved = truth.T_tip_target[target].copy(), np.zeros(len(names), dtype=np.bool_)
        if scenario.moved is not None:
            moved = scenario.moved.rows(names)
            placed[moved, :3, 3] += scenario.moved.by
        moved.setflags(write=False)
        T = truth.T_frame_base[group] @ truth.tip_poses(stood)[stop] @ placed
        drift = np.linspace(0.0, 1.0, len(stop))[:, None] * scenario.drift
        repeatability = 0.0 if noise is None else noise.repeatability
        stops = repeatability * stream(seed, "robot noise").standard_normal((len(route), 3))
        instrument = self._instrument(T, group, partner)
        outliers = self._outliers(words, partner, seed)
        apart = stream(seed, "tracker noise").standard_normal((len(T), 3)) * instrument[:, None]
        apart = apart + outliers
        seen = T.copy()
        seen[:, :3, 3] += drift + stops[stop]
        pairs = [""] * len(T)
        if partner is not None:
            first = np.flatnonzero(np.arange(len(T)) < partner)
            for k, i in enumerate(first, start=1):
                pairs[i] = pairs[partner[i]] = f"pair {k}"
        table = Measurements(
            joint_names=robot.joint_names,
            joints=read[stop],
            sets=words,
            targets=names,
            groups=tuple(truth.groups[g] for g in group),
            kinds=(kind.name,) * len(words),
            prismatic=tuple(n for n, s in zip(robot.joint_names, sliding, strict=True) if s),
            pairs=tuple(pairs),
            **Measurements.columns_of(kind, self._read(T, seen, apart, partner, seed)),
        )
        return Simulated(
            measurements=table,
            truth=truth,
            q=read_only(stood[stop]),
            T_frame_target=read_only(T),
            sigma=read_only(np.hypot(instrument, np.sqrt(1.0 + kind.paired) * repeatability)),
            outliers=read_only(outliers),
            moved=moved,
            seed=int(seed),
        )

    def _instrument(self, T: Array, group: Rows, partner: Rows | None) -> Array:
        """Standard deviation of the instrument alone, shape (R,), [m]."""
        noise, kind, tracker = self.scenario.noise, self.scenario.kind, self.scenario.tracker
        if noise is None:
            return np.zeros(len(T))
        distance = np.linalg.norm(T[:, :3, 3], axis=1)
        lengths = [i for i, one in enumerate(kind.readings) if one.quantity == "length"]
        if lengths and not kind.position:  # the instrument is what the length is measured from
            assert kind.measure is not None
            distance = np.abs(kind.measure(_seen(T, partner))[:, lengths[0]])
        elif tracker is not None:
            T_frame_base = self.truth.T_frame_base[group]
            place = T_frame_base[:, :3, :3] @ tracker + T_frame_base[:, :3, 3]
            distance = np.linalg.norm(T[:, :3, 3] - place, axis=1)
        return np.asarray(noise.constant + noise.per_length * distance)

    def _outliers(self, sets: Sequence[str], partner: Rows | None, seed: int) -> Array:
        """How far each row's measurement is displaced, shape (R, 3), [m]; of a pair that of its first row."""
        result, outliers = np.zeros((len(sets), 3)), self.scenario.outliers
        if outliers is None:
            return result
        first = [i for i in range(len(sets)) if partner is None or i < partner[i]]
        chosen = outliers.choose([i for i in first if sets[i] == SETS[0]], seed)
        v = stream(seed, "outlier directions").standard_normal(result.shape)
        v /= np.linalg.norm(v, axis=1, keepdims=True)
        if not self.scenario.kind.position:
            v = np.sign(v) * (1.0, 0.0, 0.0)
        result[chosen] = outliers.size * v[chosen]
        return result

    def _read(self, T: Array, seen: Array, apart: Array, partner: Rows | None, seed: int) -> Array:
        """What the instrument reads in each row, as `calib.data.kinds.Kind` says, shape (R, k).

        ``seen`` are the true poses T with drift and the robot's own noise, ``apart`` (R, 3) is the instrument's noise
        with outliers [m]; of lengths its first columns count.
        """
        kind = self.scenario.kind
        assert kind.measure is not None
        result = np.array(kind.measure(_seen(seen, partner)))
        if kind.position:
            result[:, :3] += apart
        turn = stream(seed, "angle noise").standard_normal((len(T), 3)) * self.scenario.sigma_angle
        if kind.orientation:
            R = Rotation.from_rotvec(turn).as_matrix() @ T[:, :3, :3]
            result[:, 3:12] = R.reshape(-1, 9)
        if partner is not None:  # both rows of a pair hold the one reading
            apart = apart[np.minimum(np.arange(len(apart)), partner)]
        for k, one in enumerate(kind.readings, start=kind.size - len(kind.readings)):
            result[:, k] += (apart if one.quantity == "length" else turn)[:, k % 3]
            if one.positive:  # what noise would make negative is seen from the other side
                result[:, k] = np.abs(result[:, k])
        return result


def simulate(
    scenario: Scenario,
    count: int = 30,
    validation: int = 10,
    seed: int = 0,
    poses: Array | None = None,
    sets: tuple[str, ...] = (),
) -> Simulated:
    """Measurements of a robot whose errors are drawn by the seed, with the truth; arguments as for `Scenario.poses`."""
    q, words = scenario.poses(seed, count, validation, poses, sets)
    return scenario.draw(seed).measure(q, seed, words)


def _partners(sets: Sequence[str], pose: Rows, targets: int) -> Rows:
    """The other row of each row's pair, shape (R,): consecutive poses of one set, the same target, the same tour.

    Raises:
        CalibError: A set has an odd number of poses.
    """
    other = np.arange(len(sets))
    for name in SETS:
        chosen = [i for i, word in enumerate(sets) if word == name]
        if len(chosen) % 2:
            raise CalibError(
                f"Distances between the targets of two poses need an even number of poses; {len(chosen)} are to "
                f"'{name}'."
            )
        other[chosen[::2]], other[chosen[1::2]] = chosen[1::2], chosen[::2]
    return np.asarray(np.arange(len(pose)) + (other[pose] - pose) * targets)


def _seen(T: Array, partner: Rows | None) -> Array:
    """Poses as a kind looks at them, shape (R, 4, 4), of a paired kind (R, 2, 4, 4)."""
    return T if partner is None else np.stack([T, T[partner]], axis=1)
