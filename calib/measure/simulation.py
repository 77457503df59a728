"""A virtual cell: a robot whose errors are known is measured, and everything that disturbs a measurement is known too.

    measured = T_frame_target(q) + drift + robot's repeatability + instrument's noise + outliers

`VirtualCell.measure` is a function of poses and a seed: each disturbance has random numbers of its own, so that one
can be changed and the others stay. See docs/simulation.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

import calib.kinds as registry
from calib.errors import CalibError, ModelError, choices
from calib.kinds import Kind
from calib.measure.cell_parts import is_number, vector
from calib.measure.columns import SETS
from calib.measure.disturbances import Encoder, MovedTarget, Outliers, outlier_directions
from calib.measure.measurements import Measurements
from calib.measure.noise import TrackerNoise
from calib.measure.random_streams import stream
from calib.measure.truth import Truth
from calib.model.robot import Robot, read_only

Array = NDArray[np.float64]

#: No target is measured farther away [m].
FARTHEST = 1e4

_TRACKER = TrackerNoise()
_NOWHERE = read_only(np.zeros(3))


@dataclass(frozen=True, slots=True, eq=False)
class Simulated:
    """What a virtual cell measured, and what was true of it.

    Attributes:
        measurements: The table, as `calib fit` reads it.
        truth: The robot, the targets and the frames.
        q: shape (R, m), where the joints really stood in each row, before their own errors [rad] or [m].
        T_frame_target: shape (R, 4, 4), true poses of the targets, the moved one's included [m].
        sigma: shape (R,), standard deviation of the noise of one coordinate or length [m].
        drift: shape (R, 3), how far the instrument had drifted [m].
        outliers: shape (R, 3), how far outliers are displaced [m]; zero in other rows. Of lengths the first
            column says how much longer they are.
        moved: shape (R,), which rows found the target moved.
        seed: Of the random numbers.
    """

    measurements: Measurements
    truth: Truth
    q: Array
    T_frame_target: Array
    sigma: Array
    drift: Array
    outliers: Array
    moved: NDArray[np.bool_]
    seed: int

    @property
    def points(self) -> Array:
        """True positions of the targets in the measurement frame, shape (R, 3), [m]."""
        return self.T_frame_target[:, :3, 3]

    @property
    def outlier_rows(self) -> tuple[int, ...]:
        """The row numbers of the outliers."""
        return self._numbers(np.any(self.outliers != 0.0, axis=1))

    @property
    def moved_rows(self) -> tuple[int, ...]:
        """The row numbers that found the target moved."""
        return self._numbers(self.moved)

    def _numbers(self, mask: NDArray[np.bool_]) -> tuple[int, ...]:
        """Row numbers of a mask."""
        return tuple(
            row for row, chosen in zip(self.measurements.rows, mask, strict=True) if chosen
        )


@dataclass(frozen=True, slots=True, eq=False)
class VirtualCell:
    """A robot with known errors, and an instrument that measures it.

    Attributes:
        truth: The robot, the targets and the frames.
        kind: What is measured, of `calib.kinds` one whose poses are free.
        noise: Of one coordinate, by the distance from the tracker; None: none. The repeatability in it displaces
            all targets of one stop alike; of the kind ``distance`` the distance is that from the anchor.
        tracker: shape (3,), where the tracker stands in the base [m]; None: at the origin of each measurement frame.
        sigma_angle: Standard deviation of a measured orientation about one axis [rad].
        encoder: Steps of the joint values.
        outliers: Rows that are far off; None: none.
        moved: A target that moves; None: none.
        drift: shape (3,), how far the instrument, or the base, drifts from the first row to the last, along the
            measurement frame's axes, evenly [m].
        visits: How often the tour of all poses is made.
    """

    truth: Truth
    kind: str = "point"
    noise: TrackerNoise | None = _TRACKER
    tracker: Array | None = None
    sigma_angle: float = 0.0
    encoder: Encoder = field(default_factory=Encoder)
    outliers: Outliers | None = None
    moved: MovedTarget | None = None
    drift: Array = field(default_factory=lambda: _NOWHERE)
    visits: int = 1

    def __post_init__(self) -> None:
        """Check kind and numbers; keep read-only copies."""
        if registry.get(self.kind).measure is None:
            free = [name for name in registry.names() if registry.get(name).measure is not None]
            message = (
                f"Measurements of the kind '{self.kind}' cannot be simulated: their poses would have to hold the "
                f"target in a socket or on a plane. Choose one of {choices(free)}."
            )
            raise CalibError(message)
        if not is_number(self.sigma_angle) or self.sigma_angle < 0.0:
            message = f"The noise of an angle is {self.sigma_angle!r} rad; it must be a number, not below 0."
            raise CalibError(message)
        whole = isinstance(self.visits, (int, np.integer)) and not isinstance(self.visits, bool)
        if not (whole and self.visits >= 1):
            message = (
                f"Each pose is visited {self.visits!r} times; it must be a whole number, 1 or more."
            )
            raise CalibError(message)
        object.__setattr__(self, "drift", vector(self.drift, "drift"))
        if self.tracker is not None:
            object.__setattr__(self, "tracker", vector(self.tracker, "tracker's position"))

    @property
    def robot(self) -> Robot:
        """The nominal robot."""
        return self.truth.nominal

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
        q = _checked_poses(self.robot, q)
        sets = (SETS[0],) * len(q) if sets is None else tuple(sets)
        plan = _Plan.of(len(q), self.visits, len(self.truth.targets), len(self.truth.groups))
        if len(sets) != len(q):
            message = (
                f"There are {len(q)} poses and {len(sets)} words that say their sets; give one of {choices(SETS)} for "
                "each pose."
            )
            raise CalibError(message)
        words = tuple(sets[i] for i in plan.pose)
        names = tuple(self.truth.targets[t] for t in plan.target)

        sliding = [joint.type == "prismatic" for joint in self.robot.inputs]
        stood = self.encoder.stood(q[plan.tour], sliding, seed)
        placed, moved = self._places(plan, names)
        T = self.truth.T_frame_base[plan.group] @ self.truth.tip_poses(stood)[plan.stop] @ placed
        drift = np.linspace(0.0, 1.0, len(plan.stop))[:, None] * self.drift
        shaken = T[:, :3, 3] + drift + self._robot_noise(plan, seed)
        kind = registry.get(self.kind)
        pairs = plan.pairs(sets) if kind.paired else ()
        sigma = self._sigma(T, plan, pairs)
        outliers = self._outliers(words, pairs, seed)
        instrument = stream(seed, "tracker noise").standard_normal((len(sigma), 3))
        own = sigma if self.noise is None else self._instrument(T, plan, pairs)
        apart = instrument * own[:, None] + outliers
        _check_near(shaken + apart)
        table = Measurements(
            joint_names=self.robot.joint_names,
            joints=self.encoder.read(stood, sliding)[plan.stop],
            sets=words,
            targets=names,
            groups=tuple(self.truth.groups[g] for g in plan.group),
            kinds=(self.kind,) * len(words),
            prismatic=tuple(n for n, s in zip(self.robot.joint_names, sliding, strict=True) if s),
            pairs=_pair_words(len(words), pairs),
            **Measurements.columns_of(kind, self._read(kind, T, shaken, apart, pairs, seed)),
        )
        return Simulated(
            measurements=table,
            truth=self.truth,
            q=read_only(stood[plan.stop]),
            T_frame_target=read_only(T),
            sigma=read_only(sigma),
            drift=read_only(drift),
            outliers=read_only(outliers),
            moved=moved,
            seed=int(seed),
        )

    def _places(self, plan: _Plan, names: Sequence[str]) -> tuple[Array, NDArray[np.bool_]]:
        """T_tip_target of each row, shape (R, 4, 4), and which rows find it moved."""
        placed = self.truth.T_tip_target[plan.target].copy()
        moved = np.zeros(len(names), dtype=bool)
        if self.moved is not None:
            moved = self.moved.rows(names)
            placed[moved, :3, 3] += self.moved.by
        moved.setflags(write=False)
        return placed, moved

    def _robot_noise(self, plan: _Plan, seed: int) -> Array:
        """How far the robot stops from where it should, the same for all targets of one stop, shape (R, 3), [m]."""
        size = 0.0 if self.noise is None else self.noise.repeatability
        stops = stream(seed, "robot noise").standard_normal((len(plan.tour), 3))
        return np.asarray(size * stops[plan.stop])

    def _instrument(self, poses: Array, plan: _Plan, pairs: Sequence[tuple[int, int]]) -> Array:
        """Standard deviation of the instrument alone, shape (R,), [m]."""
        noise = self.noise
        if noise is None:
            return np.zeros(len(poses))
        points = poses[:, :3, 3]
        distance = np.linalg.norm(points, axis=1)
        kind = registry.get(self.kind)
        lengths = [i for i, one in enumerate(kind.readings) if one.quantity == "length"]
        if lengths and not kind.position:  # the instrument is what the length is measured from
            assert kind.measure is not None
            distance = np.abs(kind.measure(_seen(kind, poses, pairs))[:, lengths[0]])
        elif self.tracker is not None:
            T = self.truth.T_frame_base[plan.group]
            tracker = T[:, :3, :3] @ self.tracker + T[:, :3, 3]
            distance = np.linalg.norm(points - tracker, axis=1)
        return np.asarray(noise.constant + noise.per_length * distance)

    def _sigma(self, poses: Array, plan: _Plan, pairs: Sequence[tuple[int, int]]) -> Array:
        """Standard deviation of one coordinate or length with all noise, shape (R,), [m]."""
        size = 0.0 if self.noise is None else self.noise.repeatability
        stops = 2.0 if registry.get(self.kind).paired else 1.0
        return np.asarray(np.hypot(self._instrument(poses, plan, pairs), np.sqrt(stops) * size))

    def _outliers(self, sets: Sequence[str], pairs: Sequence[tuple[int, int]], seed: int) -> Array:
        """How far each row's measurement is displaced, shape (R, 3), [m]; of a pair that of its first row."""
        result = np.zeros((len(sets), 3))
        if self.outliers is None:
            return result
        first = [i for i, _ in pairs] if pairs else range(len(sets))
        chosen = self.outliers.choose([i for i in first if sets[i] == SETS[0]], seed)
        directions = outlier_directions(len(sets), seed)
        if not registry.get(self.kind).position:
            directions = np.sign(directions) * (1.0, 0.0, 0.0)
        result[chosen] = self.outliers.size * directions[chosen]
        return result

    def _read(
        self,
        kind: Kind,
        T: Array,
        shaken: Array,
        apart: Array,
        pairs: Sequence[tuple[int, int]],
        seed: int,
    ) -> Array:
        """What the instrument reads in each row, as `calib.kinds.Kind` says, shape (R, k).

        Args:
            kind: Of the rows.
            T: shape (R, 4, 4), true poses of the targets [m].
            shaken: shape (R, 3), where the targets stand with drift and the robot's own noise [m].
            apart: shape (R, 3), noise and outliers of the instrument [m]; of lengths the first columns count.
            pairs: The two rows of each.
            seed: Of the random numbers.
        """
        assert kind.measure is not None
        seen = T.copy()
        seen[:, :3, 3] = shaken
        result = np.array(kind.measure(_seen(kind, seen, pairs)))
        if kind.position:
            result[:, :3] += apart
        turn = self.sigma_angle * stream(seed, "angle noise").standard_normal((len(T), 3))
        if kind.orientation:
            R = Rotation.from_rotvec(turn).as_matrix() @ T[:, :3, :3]
            result[:, 3:12] = R.reshape(-1, 9)
        apart = apart.copy()
        for i, j in pairs:
            apart[j] = apart[i]
        for k, one in enumerate(kind.readings, start=kind.size - len(kind.readings)):
            result[:, k] += (apart if one.quantity == "length" else turn)[:, k % 3]
            if one.positive:  # what noise would make negative is seen from the other side
                result[:, k] = np.abs(result[:, k])
        return result


@dataclass(frozen=True, slots=True, eq=False)
class _Plan:
    """Which pose, stop, target and set-up each of R rows is of.

    Attributes:
        tour: shape (S,), the pose of each stop.
        stop, pose, target, group: shape (R,).
        count: Number of poses, N.
    """

    tour: NDArray[np.int_]
    stop: NDArray[np.int_]
    pose: NDArray[np.int_]
    target: NDArray[np.int_]
    group: NDArray[np.int_]
    count: int

    @classmethod
    def of(cls, poses: int, visits: int, targets: int, groups: int) -> _Plan:
        """All targets at each stop, one tour after the other."""
        tour = np.tile(np.arange(poses), visits)
        stop = np.repeat(np.arange(len(tour)), targets)
        pose = tour[stop]
        return cls(tour, stop, pose, np.tile(np.arange(targets), len(tour)), pose % groups, poses)

    def pairs(self, sets: Sequence[str]) -> tuple[tuple[int, int], ...]:
        """The two rows of each pair: consecutive poses of one set, the same target, the same tour.

        Raises:
            CalibError: A set has an odd number of poses.
        """
        targets = len(self.stop) // len(self.tour)
        found = []
        for name in SETS:
            chosen = [i for i, word in enumerate(sets) if word == name]
            if len(chosen) % 2:
                message = (
                    f"Distances between the targets of two poses need an even number of poses; {len(chosen)} are to "
                    f"'{name}'."
                )
                raise CalibError(message)
            for tour in range(len(self.tour) // self.count):
                for a, b in zip(chosen[::2], chosen[1::2], strict=True):
                    first, second = ((tour * self.count + i) * targets for i in (a, b))
                    found += [(first + t, second + t) for t in range(targets)]
        return tuple(found)


def _checked_poses(robot: Robot, q: ArrayLike) -> Array:
    """Joint values, shape (N, m); the robot refuses wrong columns.

    Raises:
        ModelError: Not that.
        CalibError: No poses.
    """
    values = np.atleast_2d(np.asarray(q, dtype=np.float64))
    if not values.size:
        message = "There are no poses to measure at; give one or more."
        raise CalibError(message)
    if values.ndim != 2 or values.shape[1] != len(robot.joint_names):
        message = (
            f"Joint values of shape {values.shape} were given; the robot takes (N, {len(robot.joint_names)}), for "
            f"{choices(robot.joint_names)}."
        )
        raise ModelError(message)
    robot.chain_values(values)
    return values


def _check_near(points: Array) -> None:
    """Refuse places that no instrument reaches: a unit or a power of ten is wrong.

    Raises:
        CalibError: A coordinate that is not finite, or beyond `FARTHEST`.
    """
    if not np.all(np.abs(points) < FARTHEST):
        message = (
            f"The target would be measured more than {FARTHEST:g} m away. Check the sizes of errors and noise, the "
            "target's and the tracker's place, drift and outliers: a unit may be wrong."
        )
        raise CalibError(message)


def _seen(kind: Kind, T: Array, pairs: Sequence[tuple[int, int]]) -> Array:
    """Poses as a kind looks at them, shape (R, 4, 4), of a paired kind (R, 2, 4, 4)."""
    if not kind.paired:
        return T
    other = np.arange(len(T))
    for i, j in pairs:
        other[[i, j]] = j, i
    return np.stack([T, T[other]], axis=1)


def _pair_words(count: int, pairs: Sequence[tuple[int, int]]) -> tuple[str, ...]:
    """The word of each row's pair; "" where there are none."""
    words = [""] * count
    for number, rows in enumerate(pairs, start=1):
        for row in rows:
            words[row] = f"pair {number}"
    return tuple(words)
