"""A virtual operator: measures a virtual cell one stop at a time, and makes the mistakes that people make.

A session says which pose is next; the operator drives there and reads the instrument. The number of each reading, from
1, and the seed determine its noise and its mistake, so that a session with the same seed is the same again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from calib.basics.arguments import check_number
from calib.basics.arrays import Array, read_only
from calib.basics.values import Value, keep_read_only, one_line
from calib.boards.detection.board_search import FEWEST_CORNERS
from calib.data.measurements import Measurements
from calib.errors import CalibError, choices
from calib.numerics.moves import last_moves
from calib.robot.ranges import column_limits
from calib.verbs.simulate.random_streams import seed_of_reading, stream
from calib.verbs.simulate.scenario import VirtualCell

#: The reading of a target is far off; of pictures another picture.
GROSS = "gross"

#: Two targets are taken for each other, x for y, or the joint values are those of the pose before.
SWAPPED = "swapped"

#: The instrument gives the reading before once more, or nobody drove.
REPEATED = "repeated"

#: A stop was left out, and all readings come one pose late until somebody notices.
MISSED = "missed"

#: A target was knocked, and stays where it is from here on.
TARGET_MOVED = "target_moved"

#: The robot's base or the instrument was knocked, and stays where it is from here on.
BASE_MOVED = "base_moved"

#: A joint is not where it should be, and the joint values that are noted are those that were proposed.
NOT_THERE = "not_there"

#: All codes of mistakes.
MISTAKES = (GROSS, SWAPPED, REPEATED, MISSED, TARGET_MOVED, BASE_MOVED, NOT_THERE)


#: Those that displace something for good; before the first reading they are no mistakes.
_KNOCKS = (TARGET_MOVED, BASE_MOVED)


@dataclass(frozen=True, slots=True, eq=False)
class Mistakes(Value):
    """Probability and size of each mistake of an operator; sizes are uniform in their logarithm."""

    #: Probability of each mistake at a reading, 0 to 1; a reading has at most one new mistake.
    gross: float = 0.0
    swapped: float = 0.0
    repeated: float = 0.0
    missed: float = 0.0
    target_moved: float = 0.0
    base_moved: float = 0.0
    not_there: float = 0.0
    #: Code of the mistake at a reading, by its number from 1, whatever the probabilities; ``""``: none.
    at: Mapping[int, str] = field(default_factory=dict)
    #: Least and largest displacement of a gross reading [m].
    gross_length: tuple[float, float] = (1e-3, 50e-3)
    #: Least and largest rotation of a gross reading of an orientation [rad].
    gross_angle: tuple[float, float] = (float(np.deg2rad(0.3)), float(np.deg2rad(5.0)))
    #: Least and largest displacement of a knocked target, base or instrument [m].
    moved_length: tuple[float, float] = (0.3e-3, 5e-3)
    #: Largest rotation of a knocked target; smaller ones are as likely [rad].
    target_angle: float = float(np.deg2rad(2.0))
    #: Largest rotation of a knocked base or instrument; smaller ones are as likely [rad].
    base_angle: float = float(np.deg2rad(0.5))
    #: Least and largest error of a joint that is not where it should be [rad].
    joint_angle: tuple[float, float] = (float(np.deg2rad(1.0)), float(np.deg2rad(20.0)))
    #: The same of a joint that slides [m].
    joint_length: tuple[float, float] = (10e-3, 100e-3)

    def __post_init__(self) -> None:
        """Check the probabilities and codes, and keep a read-only copy of ``at``."""
        for code in MISTAKES:
            check_number(code, getattr(self, code), 0.0, 1.0)
        total = sum(getattr(self, code) for code in MISTAKES)
        if total > 1.0 + 1e-12:
            raise CalibError(
                f"The probabilities of mistakes add up to {total:g}; at most 1 is possible."
            )
        for number, code in self.at.items():
            if code not in ("", *MISTAKES):
                raise CalibError(
                    f"The mistake at reading {number} is '{code}'; it must be one of {choices(MISTAKES)}."
                )
        keep_read_only(self, "at")

    def __repr__(self) -> str:
        """Return one line: the probabilities."""
        rates = (f"{code} {getattr(self, code):g}" for code in MISTAKES if getattr(self, code))
        return one_line("Mistakes", *rates)

    def draw(self, number: int, rng: np.random.Generator) -> str:
        """Draw the code of the mistake at a reading; empty: none.

        Args:
            number: Of the reading, from 1.
            rng: Gives one number.
        """
        chance = rng.uniform()
        if number in self.at:
            return self.at[number]
        for code in MISTAKES:
            chance -= getattr(self, code)
            if chance < 0.0:
                return code
        return ""


#: No mistakes.
NO_MISTAKES = Mistakes()

#: Mistakes of an operator who is not especially careful, at one reading in six.
USUAL_MISTAKES = Mistakes(
    gross=0.04,
    swapped=0.02,
    repeated=0.03,
    missed=0.02,
    target_moved=0.015,
    base_moved=0.01,
    not_there=0.03,
)


@dataclass(frozen=True, slots=True)
class Mistake:
    """A mistake in a reading, as it is in truth."""

    #: One of `MISTAKES`.
    code: str
    #: Number of the reading, from 1, at which it began.
    since: int
    #: How far the reading is from what a right one at the joint values noted had been, of the target that is farthest
    #: off, of a picture the board's origin in the camera; of something knocked how far it was moved [m].
    size: float
    #: The same for the orientation, of a picture that of the board; 0 where none is measured [rad].
    turn: float = 0.0
    #: The target or the joint that it is about; empty: all.
    name: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Measurement(Value):
    """One reading of the instrument, with the joint values noted beside it."""

    #: Number of the reading, from 1; readings that were taken again have their own.
    number: int
    #: Joint values as the robot reports them, shape (m,), [rad] or [m].
    joints: Array
    #: What was read: one row a target, or the corners of one picture.
    readings: Measurements
    #: Shape (k, 4, 4), where each target had been in its frame at these joint values with nothing wrong here [m].
    T_frame_target: Array
    #: What is wrong with it: the mistake made here first, then what was knocked before.
    mistakes: tuple[Mistake, ...] = ()

    def __repr__(self) -> str:
        """Return one line: the number, what was read, and what is wrong."""
        wrong = ", ".join(mistake.code for mistake in self.mistakes)
        return one_line("Measurement", f"number {self.number}", f"{len(self.readings)} rows", wrong)

    @property
    def mistake(self) -> Mistake | None:
        """The mistake made here, else the first thing that was knocked before; None: all is right."""
        return self.mistakes[0] if self.mistakes else None


@dataclass(frozen=True, slots=True, eq=False)
class _Reading:
    """A reading of one pose, before it is handed over."""

    rows: Measurements
    #: Joint values that are noted, shape (m,).
    noted: Array
    #: Where the robot stands, shape (m,).
    stands: Array
    #: What went wrong here.
    mistakes: tuple[Mistake, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class _Before:
    """The reading before, and the pose that was proposed for it, shape (m,)."""

    proposed: Array
    reading: _Reading


class Operator:
    """A virtual operator, who remembers what was knocked, where the robot stands, and what was read before.

    This is the one object of a simulation with a state: each reading changes it.
    """

    def __init__(self, virtual: VirtualCell, seed: int, mistakes: Mistakes) -> None:
        """Begin with nothing read; `Operator.of` checks the cell."""
        self._virtual = virtual
        self._seed = seed
        self._mistakes = mistakes
        self._number = 0
        self._now = virtual
        self._knocked: tuple[Mistake, ...] = ()
        # Number of the reading since which readings are one pose late; None: they are not.
        self._late_since: int | None = None
        self._before: _Before | None = None
        # Where the robot has been, in order, for its lost motion.
        self._way: tuple[Array, ...] = ()

    @classmethod
    def of(cls, virtual: VirtualCell, seed: int, mistakes: Mistakes = NO_MISTAKES) -> Operator:
        """Return an operator who has not measured yet.

        Args:
            virtual: The cell, with the noise of its instrument.
            seed: Of noise and mistakes.
            mistakes: What the operator does wrong.

        Raises:
            CalibError: The cell measures neither positions nor pictures, or has disturbances that count rows.
        """
        scenario = virtual.scenario
        if scenario.kind.paired or not (scenario.kind.position or scenario.kind.is_image):
            raise CalibError(
                f"The virtual operator measures points, poses and pictures, and not the kind '{scenario.kind.name}'."
            )
        is_given = {
            "visits": scenario.visits > 1,
            "outliers": scenario.outliers is not None,
            "moved_row": scenario.moved is not None,
            "drift_mm": bool(scenario.drift.any()),
            "step_mm": scenario.step is not None,
            "references": scenario.standing.count > 0,
        }
        given = [name for name, is_there in is_given.items() if is_there]
        if given:
            raise CalibError(
                f"The virtual operator measures stop by stop, and takes no {choices(given)}, which count rows; leave "
                "that out."
            )
        stream(seed, "mistakes")  # refuses what is no seed
        return cls(virtual, int(seed), mistakes)

    def __repr__(self) -> str:
        """Return one line: how often it was read, and the cell."""
        return one_line("Operator", f"{self._number} readings", repr(self._virtual))

    @property
    def virtual(self) -> VirtualCell:
        """The cell as it was at the beginning."""
        return self._virtual

    @property
    def now(self) -> VirtualCell:
        """The cell with what was knocked displaced."""
        return self._now

    @property
    def knocked(self) -> tuple[Mistake, ...]:
        """The knocks so far."""
        return self._knocked

    def measure(
        self, q: ArrayLike, *, again: bool = False, via: ArrayLike | None = None
    ) -> Measurement:
        """Drive to a pose, and read the instrument.

        Args:
            q: The pose that is proposed, shape (m,), [rad] or [m].
            again: Whether the session asked for this pose once more: the operator takes care, so that nothing goes
                wrong and no reading is late; what was knocked stays knocked.
            via: A pose to come from, shape (m,); None: the last one.

        Returns:
            The reading, and what is wrong with it.

        Raises:
            CalibError: Values that do not fit the joints, or the camera does not see the board there. Then nothing has
                changed but the number of the next reading.
        """
        proposed = self._one_pose("q", q)
        way = self._way if via is None else (*self._way, self._one_pose("via", via))
        self._number += 1
        number = self._number
        seed = seed_of_reading(self._seed, number)
        rng = stream(seed, "mistakes")
        code = self._mistakes.draw(number, rng)
        if self._late_since is not None:
            code = MISSED
        before = self._before
        is_there = before is not None and np.array_equal(before.proposed, proposed)
        if again or (code == MISSED and is_there) or (code in _KNOCKS and before is None):
            code = ""

        now, knocked = self._now, self._knocked
        if code in _KNOCKS:
            now, mistake = _knock(now, self._mistakes, code, number, rng)
            knocked = (mistake, *knocked)
        trip = _Trip(now, self._mistakes, proposed, way, number, seed, rng, self._before)
        reading = trip.read_wrongly(code, self._late_since or number) if code else None
        is_late = reading is not None and code == MISSED
        if reading is None:  # nothing is wrong, or the mistake cannot be made here
            reading = trip.read_well()

        T_frame_target = _target_poses(self._now, reading.noted)
        self._now, self._knocked = now, knocked
        self._late_since = (self._late_since or number) if is_late else None
        self._way = (*way, reading.stands)
        self._before = _Before(proposed, reading)
        images = tuple(
            name and name.removesuffix("_01.png") + f"_{number:03d}.png"
            for name in reading.rows.images
        )
        rows = replace(
            reading.rows,
            joints=np.tile(reading.noted, (len(reading.rows), 1)),
            moves=None,
            images=images,
        )
        mistakes = (*reading.mistakes, *knocked)
        return Measurement(number, reading.noted, rows, T_frame_target, mistakes)

    def _one_pose(self, argument: str, q: ArrayLike) -> Array:
        """Return one pose as an array, shape (m,), [rad] or [m]; `CalibError` if it is none."""
        values = self._virtual.truth.nominal.columns(q, argument)
        if len(values) != 1:
            raise CalibError(
                f"The argument '{argument}' has {len(values)} poses; the operator drives to one at a time."
            )
        return read_only(values[0])


@dataclass(frozen=True, slots=True, eq=False)
class _Trip:
    """The way to one pose and what is read there, rightly or wrongly."""

    #: The cell as it is now.
    cell: VirtualCell
    #: Sizes of mistakes.
    mistakes: Mistakes
    #: The pose that is proposed, shape (m,).
    proposed: Array
    #: Where the robot has been.
    way: tuple[Array, ...]
    #: Number of the reading.
    number: int
    #: Of its noise.
    seed: int
    #: Draws the mistake.
    rng: np.random.Generator
    #: The reading before; None: this is the first.
    before: _Before | None

    def read_well(self) -> _Reading:
        """Read at the pose that is proposed; `CalibError` if the camera does not see the board."""
        rows = self._read(self.proposed)
        return _Reading(rows, rows.joints[0], self.proposed)

    def read_wrongly(self, code: str, since: int) -> _Reading | None:
        """Read with a mistake that began at a reading; None if it cannot be made here."""
        try:
            if code == GROSS:
                return self._gross()
            if code == SWAPPED:
                return self._swapped()
            if code == NOT_THERE:
                return self._not_there()
            if code in (REPEATED, MISSED) and self.before is not None:
                return self._late(code, since, self.before)
        except CalibError:  # the camera does not see the board at the other pose
            return None
        return None

    def _gross(self) -> _Reading:
        """Read a target far off where it is, or take another picture."""
        cell, mistakes, rng = self.cell, self.mistakes, self.rng
        if cell.equipment is not None:
            return self._with_reading_at(cell.poses(1, self.seed)[0], GROSS)
        rows = self._read(self.proposed)
        row = int(rng.integers(len(rows)))
        size = turn = 0.0
        if cell.scenario.kind.orientation and rng.uniform() < 0.5:
            turn = _log_uniform(mistakes.gross_angle, rng)
            assert rows.rotations is not None
            rotations = rows.rotations.copy()
            rotations[row] = pin.exp3(turn * _direction(rng)) @ rotations[row]
            rows = replace(rows, rotations=rotations)
        else:
            size = _log_uniform(mistakes.gross_length, rng)
            points = rows.points.copy()
            points[row] += size * _direction(rng)
            rows = replace(rows, points=points)
        mistake = Mistake(GROSS, self.number, size, turn, rows.targets[row])
        return _Reading(rows, self.proposed, self.proposed, (mistake,))

    def _swapped(self) -> _Reading | None:
        """Take two targets for each other, x for y, or note the joint values before; None: there are none."""
        targets = len(self.cell.truth.targets)
        if self.cell.equipment is None and targets > 1:
            return self._swapped_targets()
        if self.cell.equipment is None and (self.before is None or self.rng.uniform() < 0.5):
            return self._swapped_axes()
        if self.before is None:
            return None
        noted = self.before.proposed
        rows = self._read(self.proposed)
        size, turn = self._difference(noted, self.proposed)
        mistake = Mistake(SWAPPED, self.number, size, turn, "joints")
        return _Reading(rows, noted, self.proposed, (mistake,))

    def _swapped_targets(self) -> _Reading:
        """Take two targets for each other."""
        rows = self._read(self.proposed)
        i, k = self.rng.permutation(len(rows))[:2].tolist()
        order = np.arange(len(rows))
        order[[i, k]] = k, i
        rotations = None if rows.rotations is None else rows.rotations[order]
        size = float(np.linalg.norm(rows.points[i] - rows.points[k]))
        turn = 0.0 if rotations is None else _angle(rotations[i].T @ rotations[k])
        mistake = Mistake(SWAPPED, self.number, size, turn, f"{rows.targets[i]}, {rows.targets[k]}")
        swapped = replace(rows, points=rows.points[order], rotations=rotations)
        return _Reading(swapped, self.proposed, self.proposed, (mistake,))

    def _swapped_axes(self) -> _Reading:
        """Take x for y in the reading."""
        rows = self._read(self.proposed)
        points = rows.points[:, [1, 0, 2]]
        size = float(np.linalg.norm(points - rows.points, axis=1).max())
        mistake = Mistake(SWAPPED, self.number, size, 0.0, "x, y")
        return _Reading(replace(rows, points=points), self.proposed, self.proposed, (mistake,))

    def _late(self, code: str, since: int, before: _Before) -> _Reading:
        """Give the reading before once more, or read where the robot was before, as nobody drove."""
        if code == REPEATED and self.rng.uniform() < 0.5:
            size, turn = self._difference(self.proposed, before.reading.stands)
            mistake = Mistake(REPEATED, since, size, turn, "exact")
            return _Reading(before.reading.rows, self.proposed, self.proposed, (mistake,))
        stands = before.reading.stands if code == REPEATED else before.proposed
        return self._with_reading_at(stands, code, since=since, drives=True)

    def _not_there(self) -> _Reading:
        """Read where one joint is not as proposed."""
        robot, mistakes, rng = self.cell.truth.nominal, self.mistakes, self.rng
        joint = int(rng.integers(len(self.proposed)))
        name = robot.joint_names[joint]
        slides = robot.inputs[joint].type == "prismatic"
        error = _log_uniform(mistakes.joint_length if slides else mistakes.joint_angle, rng)
        low, high = column_limits(robot)[joint].tolist()
        sign = 1.0 if rng.uniform() < 0.5 else -1.0
        if not low <= self.proposed[joint] + sign * error <= high:
            sign = -sign
        stands = self.proposed.copy()
        stands[joint] += sign * error
        return self._with_reading_at(read_only(stands), NOT_THERE, name=name, drives=True)

    def _with_reading_at(
        self, q: Array, code: str, *, since: int = 0, name: str = "", drives: bool = False
    ) -> _Reading:
        """Note the proposed joint values with a reading at other ones, where the robot stands if it ``drives`` there.

        ``since`` is the number of the reading at which the mistake began; 0: this one.
        """
        rows = self._read(q)
        size, turn = self._difference(self.proposed, q)
        mistake = Mistake(code, since or self.number, size, turn, name)
        return _Reading(rows, self.proposed, q if drives else self.proposed, (mistake,))

    def _read(self, q: Array) -> Measurements:
        """Read where the robot stands at joint values (m,); `CalibError` if the camera does not see the board."""
        moves = last_moves(np.stack([*self.way, q]))[-1:]
        rows = self.cell.measure(q, self.seed, moves=moves).measurements
        if self.cell.equipment is not None:
            board = self.cell.equipment.printed.board
            fewest = (
                min(FEWEST_CORNERS, len(board.corners)) if board.markers else len(board.corners)
            )
            if len(rows) < fewest:
                raise CalibError(
                    f"The camera sees {len(rows)} of the {len(board.corners)} corners of the board at this pose; "
                    f"{fewest} are needed to find it."
                )
        return rows

    def _difference(self, q: Array, other: Array) -> tuple[float, float]:
        """Return how far a target is away at other joint values (m,), the largest distance [m] and rotation [rad]."""
        kind = self.cell.scenario.kind
        size = turn = 0.0
        here, there = (_target_poses(self.cell, joints) for joints in (q, other))
        for T, T_other in zip(here, there, strict=True):
            size = max(size, float(np.linalg.norm(T_other[:3, 3] - T[:3, 3])))
            turn = max(turn, _angle(T_other[:3, :3] @ T[:3, :3].T))
        return size, turn if kind.orientation or kind.is_image else 0.0


def _target_poses(cell: VirtualCell, q: Array) -> Array:
    """Return the true pose of each target in its frame at joint values (m,), by sight, shape (k, 4, 4), read-only."""
    truth = cell.truth
    poses = [
        truth.T_frame_base[f] @ truth.tip_poses(q, chain=chain)[0] @ truth.T_tip_target[t]
        for (f, t), chain in truth.sights.items()
    ]
    return read_only(np.stack(poses))


def _knock(
    cell: VirtualCell, mistakes: Mistakes, code: str, number: int, rng: np.random.Generator
) -> tuple[VirtualCell, Mistake]:
    """Return a cell of which a target, or the base or the instrument, was knocked at a reading, and what happened."""
    truth, kind = cell.truth, cell.scenario.kind
    size = _log_uniform(mistakes.moved_length, rng)
    shift = size * _direction(rng)
    rotation_vector = rng.uniform() * _direction(rng)
    if code == TARGET_MOVED:
        t = int(rng.integers(len(truth.targets)))
        turn = mistakes.target_angle if kind.orientation or kind.is_image else 0.0
        rotation_vector = turn * rotation_vector
        T_tip_target = truth.T_tip_target.copy()
        T_tip_target[t, :3, 3] += shift
        T_tip_target[t, :3, :3] = pin.exp3(rotation_vector) @ T_tip_target[t, :3, :3]
        truth = replace(truth, T_tip_target=read_only(T_tip_target))
        name = truth.targets[t]
    else:
        # The base turns about itself, the instrument about itself, wherever its frame is.
        rotation_vector = mistakes.base_angle * rotation_vector
        motion = np.eye(4)
        motion[:3, :3] = pin.exp3(rotation_vector)
        is_base = rng.uniform() < 0.5
        name = "base" if is_base else "instrument"
        centre = np.zeros(3)
        if not is_base and cell.scenario.tracker is not None and cell.equipment is None:
            T_frame_base = truth.T_frame_base[0]
            centre = T_frame_base[:3, :3] @ cell.scenario.tracker + T_frame_base[:3, 3]
        motion[:3, 3] = shift + centre - motion[:3, :3] @ centre
        frames = truth.T_frame_base @ motion if is_base else motion @ truth.T_frame_base
        truth = replace(truth, T_frame_base=read_only(frames))
    mistake = Mistake(code, number, size, float(np.linalg.norm(rotation_vector)), name)
    return replace(cell, truth=truth), mistake


def _log_uniform(bounds: tuple[float, float], rng: np.random.Generator) -> float:
    """Draw a number between two positive ones, uniform in its logarithm."""
    return float(np.exp(rng.uniform(*np.log(bounds))))


def _direction(rng: np.random.Generator) -> Array:
    """Draw a direction, shape (3,)."""
    direction = rng.standard_normal(3)
    return np.asarray(direction / np.linalg.norm(direction))


def _angle(R: Array) -> float:
    """Return the angle of a rotation matrix [rad]."""
    return float(np.linalg.norm(pin.log3(R)))
