"""Check of a stop as it is measured: does it fit what the stops before it let expect, and if not, why not?

The square of its deviation, y^T S^-1 y / k, follows F(k, nu), where nu numbers of earlier stops tell how large such
squares are in this session. One that does not is compared with what the usual mistakes would have given: the reading of
another pose, a joint that is elsewhere, coordinates or targets in another order.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np
from scipy.special import fdtrc, fdtri

from calib.basics.arrays import Array, Mask
from calib.basics.values import Value
from calib.data.measurements import Measurements
from calib.robot.robot import Robot
from calib.verbs.measure.running_fit import Prediction, RunningFit
from calib.verbs.measure.stop import SAME_POSE, Finding

#: Probability that a good stop is to be measured again.
FALSE_ALARM = 1e-3

#: What is known beforehand of how large squares are, in numbers of earlier stops.
_KNOWN_BEFORE = 6.0

#: Squares that are as large with this probability are so by chance.
_BY_CHANCE = 1e-3

#: Degrees of freedom of the fit's noise from which on its predictions are exact enough for the test.
_ENOUGH_FREEDOM = 6.0

#: Shares of the numbers that determine all parameters from which on a fit predicts something, and most.
_SOME = 0.45
_MOST = 0.7

#: Deviation of a reading from what a fit to a few stops predicts, or the nominal robot, that no calibration explains.
FAR_LENGTH = 25e-3
_ROUGH_ANGLE = np.deg2rad(5.0)

#: Part of it if the fit has most of the numbers that it needs.
_CLOSER = 0.3

#: Readings that differ by no more are the same, if nothing is known of the noise [m].
SAME_PLACE = 1e-3

#: How far a target that is not known may be from the tip [m].
_LEVER = 0.2

#: Numbers more than frames and targets have, from which on a fit places them.
_SPARE = 3

#: Largest change of a single joint that is looked for, and the least that is no noise [rad or m]; how often the search
#: is narrowed to a quarter.
_JOINT_OFF = 0.6
_LEAST_JOINT = 2e-3
_NARROWED = 6

#: Deviations of this many times the limit are no accident if they are the same when the stop is measured again.
_CERTAIN = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class History(Value):
    """Squares of the stops that were found good: how large they are in this session."""

    #: Sum of the squares times the numbers of each
    total: float = 0.0
    #: Sum of the numbers
    numbers: float = 0.0

    @property
    def factor(self) -> float:
        """Mean square of this session's stops if it is more than chance explains, else 1."""
        if not self.numbers:
            return 1.0
        # Early squares are over a noise of which as little was known.
        mean = self.total / self.numbers
        chance = float(fdtrc(self.numbers, self.numbers + _KNOWN_BEFORE, mean))
        return 1.0 if chance > _BY_CHANCE else mean

    def limit(self, numbers: int) -> float:
        """Return the square, over the factor, above which a stop of so many numbers is not as good as the others."""
        return float(fdtri(numbers, self.numbers + _KNOWN_BEFORE, 1.0 - FALSE_ALARM))


@dataclass(frozen=True, slots=True, eq=False)
class RowCheck(Value):
    """A stop compared with what is expected."""

    #: Compared with the fit; None: there is none yet
    prediction: Prediction | None
    #: Its square, see `Prediction.square`; NaN: not known
    square: float
    #: Above this square it is off
    limit: float
    #: Whether it is off; None: too little is known to say
    is_off: bool | None
    #: What may be wrong
    findings: tuple[Finding, ...]


def check_row(
    robot: Robot,
    fit: RunningFit | None,
    table: Measurements,
    number: int,
    before: Sequence[tuple[int, Measurements]],
    proposed: Sequence[Array],
    history: History,
    rank: int,
) -> RowCheck:
    """Compare a stop with what the stops before it let expect.

    Args:
        robot: The nominal robot.
        fit: The fit to the stops before; None: too few.
        table: The readings of the stop.
        number: Its number.
        before: Numbers and readings of the stops before it, also of those that do not count.
        proposed: Joint values of poses that were proposed and not measured, shape (m,) each [rad] or [m].
        history: How large squares are in this session.
        rank: Number of parameters that stops can determine: with fewer numbers a prediction is not exact.
    """
    prediction = None if fit is None else fit.predict(table)
    repeated = _same_reading(table, number, before)
    if prediction is None or fit is None:
        return RowCheck(None, np.nan, np.nan, True if repeated else None, tuple(repeated))
    square = prediction.square
    limit = history.limit(len(prediction.y)) * history.factor
    known = fit.fitted.estimate.freedom >= _ENOUGH_FREEDOM and fit.count * len(prediction.y) >= rank
    is_off = square > limit
    if not known:
        share = fit.count * len(prediction.y) / rank
        is_off = is_off and share >= _SOME and _is_far(fit, prediction, share)
    if repeated:
        return RowCheck(prediction, square, limit, True, tuple(repeated))
    if not is_off:
        return RowCheck(prediction, square, limit, False if known else None, ())
    finding = _explained(robot, fit, table, number, before, proposed, history)
    return RowCheck(prediction, square, limit, True, (finding,))


def is_same_again(
    fit: RunningFit, first: Measurements, second: Measurements, history: History
) -> tuple[bool, bool]:
    """Return whether two readings of one pose agree with each other, and whether their deviation is no accident."""
    one, other = fit.predict(first), fit.predict(second)
    if one is None or other is None or len(one.y) != len(other.y):
        return False, False
    # The prediction is the same for both: their difference has the noise of two readings.
    apart = float(np.sum((one.y - other.y) ** 2)) / (2.0 * len(one.y)) / history.factor
    limit = history.limit(len(one.y))
    return apart <= limit, other.square / history.factor > _CERTAIN * limit


def _is_far(fit: RunningFit, prediction: Prediction, share: float) -> bool:
    """Return whether a deviation is beyond what a fit may be off by to stops with a share of the numbers it needs."""
    if fit.rows.count < fit.fitted.setup.count + _SPARE:
        return False
    residual, usual = prediction.residual, prediction.usual
    rough = 1.0 if share < _MOST else _CLOSER
    return residual.get("m", 0.0) > rough * FAR_LENGTH + 6.0 * usual.get("m", 0.0) or (
        residual.get("rad", 0.0) > rough * _ROUGH_ANGLE + 6.0 * usual.get("rad", 0.0)
    )


def _same_reading(
    table: Measurements, number: int, before: Sequence[tuple[int, Measurements]]
) -> list[Finding]:
    """Return the finding that a reading is that of an earlier stop to the last digit, though the joints have moved."""
    for stop, other in reversed(before):
        if len(other) != len(table) or other.targets != table.targets:
            continue
        if np.abs(other.joints[0] - table.joints[0]).max() <= SAME_POSE:
            continue
        pairs = [
            (getattr(table, name), getattr(other, name))
            for name in ("points", "rotations", "distances")
        ]
        pairs += [(values, other.readings.get(name)) for name, values in table.readings.items()]
        given = [
            (a, b) for a, b in pairs if a is not None and b is not None and np.isfinite(a).any()
        ]
        if given and all(np.array_equal(a, b, equal_nan=True) for a, b in given):
            return [Finding("repeated", (number,), {"stop": float(stop)})]
    return []


def conflicts(robot: Robot, T_tip_target: Array | None, tables: Sequence[Measurements]) -> Mask:
    """Return which stops contradict each other: their targets are farther apart, or closer, than any arm would have it.

    Distances do not depend on where the instrument stands. An arm that is not calibrated is centimetres off at most;
    where the target is on it may not be known.

    Args:
        robot: The nominal robot.
        T_tip_target: Where the target is about, shape (4, 4) [m]; None: not known.
        tables: Readings of n stops.

    Returns:
        Shape (n, n), symmetric; False where no positions of one target are compared.
    """
    n = len(tables)
    if robot.branches or not all(table.positions.all() for table in tables):
        return np.zeros((n, n), dtype=np.bool_)
    names = [(table.groups[0], table.targets[0]) for table in tables]
    T = robot.poses(np.array([table.joints[0] for table in tables]))
    if T_tip_target is not None:
        nominal = (T @ T_tip_target)[:, :3, 3]
        slack = np.zeros((n, n))
    else:
        nominal = T[:, :3, 3]
        traces = np.einsum("aij,bij->ab", T[:, :3, :3], T[:, :3, :3])
        slack = _LEVER * np.arccos(np.clip((traces - 1.0) / 2.0, -1.0, 1.0))
    points = np.array([table.points[0] for table in tables])
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    expected = np.linalg.norm(nominal[:, None] - nominal, axis=2)
    same = np.array([[a == b for b in names] for a in names])
    return np.asarray(same & (np.abs(apart - expected) > FAR_LENGTH + slack))


def contradiction(
    robot: Robot,
    T_tip_target: Array | None,
    counted: Sequence[tuple[int, Measurements]],
    table: Measurements,
    number: int,
) -> Finding | None:
    """Return what is wrong with a stop that contradicts most of those that count; None if it does not.

    Args:
        robot: The nominal robot.
        T_tip_target: Where the target is about, shape (4, 4) [m]; None: not known.
        counted: Numbers and readings of the stops that count.
        table: The readings of the stop.
        number: Its number.
    """
    # Readings of other places than since something has moved cannot be compared.
    name = (table.groups[0], table.targets[0])
    alike = [(n, other) for n, other in counted if (other.groups[0], other.targets[0]) == name]
    against = conflicts(robot, T_tip_target, [*(other for _, other in alike), table])[-1, :-1]
    for k, (stop, other) in reversed([*enumerate(alike)]):
        if against[k] and np.abs(other.points[0] - table.points[0]).max() < SAME_PLACE:
            return Finding("repeated", (number,), {"stop": float(stop)})
    if not len(against) or np.mean(against) <= 0.5:
        return None
    return Finding("gross", (number,))


def _explained(
    robot: Robot,
    fit: RunningFit,
    table: Measurements,
    number: int,
    before: Sequence[tuple[int, Measurements]],
    proposed: Sequence[Array],
    history: History,
) -> Finding:
    """Return the mistake that explains a reading that is off; a gross reading if none does."""

    def fits(other: Measurements, taken: int = 0) -> bool:
        """Return whether a changed reading is as good as others, with so many numbers taken by the change."""
        prediction = fit.predict(other)
        if prediction is None:
            return False
        k = len(prediction.y)
        square = prediction.square * k / max(k - taken, 1) / history.factor
        return square <= history.limit(max(k - taken, 1))

    for stop, q in _nearest(fit, table, [(n, other.joints[0]) for n, other in before]):
        if fits(_at(table, q)):
            return Finding("repeated", (number,), {"stop": float(stop)})
    for _, q in _nearest(fit, table, [(0, q) for q in proposed]):
        if fits(_at(table, q)):
            return Finding("not_there", (number,), {"stop": 0.0})
    for other, name in _swapped(table):
        if fits(other):
            return Finding("swapped", (number,), name=name)
    moved = _joint_that_is_off(fit, table)
    if moved is not None:
        joint, change = moved
        q = table.joints[0].copy()
        q[joint] += change
        if fits(_at(table, q), taken=1):
            name = robot.joint_names[joint]
            return Finding("not_there", (number,), {"change": change}, name)
    prediction = fit.predict(table)
    off = (
        {} if prediction is None else {f"off_{unit}": v for unit, v in prediction.residual.items()}
    )
    return Finding("gross", (number,), off)


def _at(table: Measurements, q: Array) -> Measurements:
    """Return readings as if the robot had stood at other joint values, shape (m,)."""
    return replace(table, joints=np.tile(q, (len(table), 1)), moves=None)


def _nearest(
    fit: RunningFit, table: Measurements, poses: Sequence[tuple[int, Array]], count: int = 3
) -> list[tuple[int, Array]]:
    """Return those of some poses, with their stops, whose predictions are nearest to a reading."""
    here = table.joints[0]
    others = [(stop, q) for stop, q in poses if np.abs(q - here).max() > SAME_POSE]
    if not others:
        return []
    distance = fit.distances(table, np.array([q for _, q in others]))
    return [others[k] for k in np.argsort(distance)[:count]]


def _swapped(table: Measurements) -> Iterator[tuple[Measurements, str]]:
    """Yield readings with coordinates or targets in another order, and what was taken for what."""
    if table.positions.all():
        for order in permutations(range(3)):
            if order != (0, 1, 2):
                yield (
                    replace(table, points=table.points[:, order]),
                    "".join("xyz"[k] for k in order),
                )
    names = list(dict.fromkeys(table.targets))
    for i, first in enumerate(names):
        for second in names[i + 1 :]:
            other = {first: second, second: first}
            targets = tuple(other.get(name, name) for name in table.targets)
            yield replace(table, targets=targets), f"{first}, {second}"


def _joint_that_is_off(fit: RunningFit, table: Measurements) -> tuple[int, float] | None:
    """Return the joint, and by how much it would have to be elsewhere, that explains a reading best; None if none."""
    q = table.joints[0]
    each = np.arange(len(q))

    def squares(changes: Array) -> Array:
        """Return the squares of the distances with each joint changed, both of shape (m, n)."""
        trials = np.tile(q, (*changes.shape, 1))
        trials[each, :, each] += changes
        distances = fit.distances(table, trials.reshape(-1, len(q)))
        return np.asarray(distances.reshape(changes.shape) ** 2)

    grid = np.linspace(-1.0, 1.0, 9)
    best, width = np.zeros(len(q)), _JOINT_OFF
    for _ in range(_NARROWED):
        changes = best[:, None] + width * grid
        best = changes[each, np.argmin(squares(changes), axis=1)]
        width /= 4.0
    # The least of the parabola through three squares.
    below, least, above = squares(best[:, None] + width * np.array([-1.0, 0.0, 1.0])).T
    curvature = below - 2.0 * least + above
    curved = curvature > np.abs(below - above) / 2.0
    best[curved] += width * (0.5 * (below - above)[curved] / curvature[curved])
    joint = int(np.argmin(squares(best[:, None])))
    return None if abs(best[joint]) < _LEAST_JOINT else (joint, float(best[joint]))
