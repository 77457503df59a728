"""Characteristics of ISO 9283 beside the accuracy and repeatability of single poses: of distances, approaches, drift.

With the error e = measured - predicted of a row, the measured distance D_j between repeat j of one pose and repeat j of
another, and the distance Dc_j that the robot's model predicts for their joint values,

    AD  = |mean (D_j - Dc_j)|                   distance accuracy, of two poses
    RD  = 3 S of D_j - Dc_j                     distance repeatability
    vAP = max |mean_h e - mean_k e|             between the approaches h and k of one pose
    dAP = max |AP_t - AP_1|                     between the later tens of repeats t of one pose and the first ten
    dRP = max |RP_t - RP_1|

where S is the standard deviation over n - 1. Rows in the order of the table are taken to be in the order of time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import pdist

from calib.basics.arrays import Array
from calib.verbs.evaluate.accuracy import FEWEST_REPEATS, Accuracy, PoseAccuracy, repeatability
from calib.verbs.evaluate.evaluation import Evaluation

#: Repeats of a pose that each AP and RP of a drift is computed from, as in ISO 9283.
DRIFT_REPEATS = 10

#: Most poses of one target at one station whose distances are compared, the first ones: n have about n^2 / 2 pairs.
MOST_POSES = 2_000

#: The unit of distances.
_LENGTH = "m"


@dataclass(frozen=True, slots=True)
class Characteristic:
    """One characteristic in one unit, over the poses, or pairs of poses, that have it."""

    #: Its symbol: ``"AD"``, ``"RD"``, ``"vAP"``, ``"dAP"`` or ``"dRP"``
    symbol: str
    #: Symbol of the unit, of `calib.basics.channels.RESIDUAL_UNITS`
    unit: str
    #: The largest value, in the unit; NaN where the rows do not have it
    largest: float
    #: The mean; NaN likewise
    mean: float
    #: Number of poses, or of pairs of poses, that have it
    count: int
    #: Number of the first row of the pose, or of each of the two poses, with the largest value; empty if none has it
    rows: tuple[int, ...]


class _Pose(NamedTuple):
    """Errors of the repeats of one pose in one unit, in the order of the table."""

    #: Number of its first row in the table
    row: int
    #: Shape (n, d), measured minus predicted
    errors: Array
    #: Direction that each was approached from; empty where it is not given
    approaches: tuple[str, ...]


class _Pairs(NamedTuple):
    """Errors D_j - Dc_j of the distances of P pairs of poses, over the repeats j that both poses have."""

    #: Shape (P, 2), numbers of the first rows of both poses
    rows: NDArray[np.int_]
    #: Shape (P,), number of repeats
    counts: NDArray[np.int_]
    #: Shape (P,), their mean [m]
    means: Array
    #: Shape (P,), their standard deviation over n - 1 [m]; 0 for one repeat
    deviations: Array


def characteristics(evaluation: Evaluation, judged: Accuracy) -> tuple[Characteristic, ...]:
    """Return the characteristics of an evaluated robot, in the units that were measured.

    Args:
        evaluation: Residuals of the robot at the N rows of a table, measured minus predicted.
        judged: Its pose accuracy, whose ``poses`` name the rows that count.

    Returns:
        AD and RD of positions, if any were measured, then vAP, dAP and dRP in each unit; NaN, with a count of 0, for
        those that the rows do not have.
    """
    result = []
    if _LENGTH in judged.units:
        result += _of_distances(_pairs(evaluation, judged))
    poses = {unit: list(_poses(evaluation, judged, unit)) for unit in judged.units}
    for symbol, figure in _OF_POSES.items():
        for unit, of_unit in poses.items():
            values = [figure(pose, unit) for pose in of_unit]
            rows = [(pose.row,) for pose in of_unit]
            result.append(_summary(symbol, unit, np.array(values), rows))
    return tuple(result)


def _summary(
    symbol: str, unit: str, values: Array, rows: Sequence[tuple[int, ...]]
) -> Characteristic:
    """Return the largest and the mean of a characteristic.

    Args:
        symbol: Its symbol.
        unit: Symbol of its unit.
        values: Its value at each of k poses or pairs, shape (k,); NaN for those that do not have it.
        rows: The first row of each, or of both poses of each.
    """
    has_value = np.isfinite(values)
    if not np.any(has_value):
        return Characteristic(symbol, unit, np.nan, np.nan, 0, ())
    worst = int(np.nanargmax(values))
    return Characteristic(
        symbol=symbol,
        unit=unit,
        largest=float(values[worst]),
        mean=float(np.mean(values[has_value])),
        count=int(np.sum(has_value)),
        rows=rows[worst],
    )


# Distances between two poses


def _of_distances(pairs: _Pairs) -> list[Characteristic]:
    """Return AD and RD of pairs of poses; RD of pairs with at least `FEWEST_REPEATS` repeats."""
    rows = [(first, second) for first, second in pairs.rows.tolist()]
    enough = pairs.counts >= FEWEST_REPEATS
    return [
        _summary("AD", _LENGTH, np.abs(pairs.means), rows),
        _summary("RD", _LENGTH, np.where(enough, 3.0 * pairs.deviations, np.nan), rows),
    ]


def _pairs(evaluation: Evaluation, judged: Accuracy) -> _Pairs:
    """Return the errors of the distances of all pairs of poses of one target at one station.

    Args:
        evaluation: Residuals of the robot, and the measured positions.
        judged: Poses with the rows that repeat them; those whose positions were not measured have no part.
    """
    columns, are_positions = evaluation.channels.vector_columns(_LENGTH)
    has_position = are_positions & evaluation.measurements.positions
    places: dict[tuple[str, str], list[NDArray[np.intp]]] = {}
    for pose, indices in _indices(evaluation, judged):
        if np.all(has_position[indices]):
            places.setdefault((pose.group, pose.target), []).append(indices)
    if not places:
        no_pair = np.zeros(0, dtype=int)
        return _Pairs(no_pair.reshape(0, 2), no_pair, np.zeros(0), np.zeros(0))
    measured = evaluation.measurements.points
    predicted = measured - evaluation.residual[:, columns]
    numbers = np.array(evaluation.measurements.rows)
    of_places = [
        _pairs_of_place(measured, predicted, numbers, poses[:MOST_POSES])
        for poses in places.values()
    ]
    return _Pairs(*(np.concatenate(parts) for parts in zip(*of_places, strict=True)))


def _pairs_of_place(
    measured: Array, predicted: Array, numbers: NDArray[np.int_], poses: list[NDArray[np.intp]]
) -> _Pairs:
    """Return the errors of the distances of all pairs of k poses.

    Args:
        measured: Measured positions of N rows in one frame, shape (N, 3), [m].
        predicted: Those that the robot's model predicts, likewise.
        numbers: Numbers of the rows in the table, shape (N,).
        poses: Of each pose the indices of its repeats, in the order of the table.

    Returns:
        The k (k - 1) / 2 pairs.
    """
    first, second = np.triu_indices(len(poses), 1)
    repeats = np.array(list(map(len, poses)))
    counts = np.minimum(repeats[first], repeats[second])
    errors = _distance_errors(measured, predicted, poses)
    first_rows = numbers[_rows_of_repeat(poses, 0)]
    rows = np.stack([first_rows[first], first_rows[second]], axis=1)
    return _Pairs(rows, counts, *_mean_and_deviation(errors, counts))


def _distance_errors(
    measured: Array, predicted: Array, poses: list[NDArray[np.intp]]
) -> Iterator[Array]:
    """Yield, repeat by repeat, the errors D_j - Dc_j of the distances of all pairs of poses, shape (P,), [m].

    Args:
        measured: Measured positions of N rows in one frame, shape (N, 3), [m].
        predicted: Those that the robot's model predicts, likewise.
        poses: Of each pose the indices of its repeats; errors of a repeat that one of a pair lacks have no meaning.
    """
    for j in range(max(map(len, poses))):
        row = _rows_of_repeat(poses, j)
        yield pdist(measured[row]) - pdist(predicted[row])


def _mean_and_deviation(errors: Iterable[Array], counts: NDArray[np.int_]) -> tuple[Array, Array]:
    """Return mean and standard deviation over n - 1 of P errors, updated repeat by repeat (Welford).

    Args:
        errors: The errors of each repeat, shape (P,).
        counts: Of each error the number of repeats that count, the first ones, shape (P,).
    """
    mean = np.zeros(len(counts))
    square = np.zeros(len(counts))
    for j, error in enumerate(errors):
        change = np.where(j < counts, error - mean, 0.0)
        mean = mean + change / (j + 1)
        square = square + change * (error - mean)
    return mean, np.sqrt(square / np.maximum(counts - 1, 1))


def _rows_of_repeat(poses: list[NDArray[np.intp]], j: int) -> NDArray[np.intp]:
    """Return the index of repeat j, from 0, of each of k poses, shape (k,).

    Of a pose with fewer repeats it is that of the first one, whose distances do not count.
    """
    return np.array([pose[j] if j < len(pose) else pose[0] for pose in poses])


# Approaches and drift of one pose


def _indices(
    evaluation: Evaluation, judged: Accuracy
) -> Iterator[tuple[PoseAccuracy, NDArray[np.intp]]]:
    """Yield each judged pose with the indices of its rows in the table, from 0."""
    index = {number: i for i, number in enumerate(evaluation.measurements.rows)}
    for pose in judged.poses:
        yield pose, np.array([index[number] for number in pose.rows])


def _poses(evaluation: Evaluation, judged: Accuracy, unit: str) -> Iterator[_Pose]:
    """Yield the errors of the repeats of each judged pose that was measured in a unit.

    Args:
        evaluation: Residuals of the robot at N rows along the axes of their measurement frames, on which no norm
            depends.
        judged: Poses with the rows that repeat them.
        unit: Symbol of the unit.
    """
    approaches = evaluation.measurements.approaches
    for pose, indices in _indices(evaluation, judged):
        if unit in pose.by_unit:
            columns = evaluation.channels.select(indices).columns(unit)
            errors = evaluation.residual[np.ix_(indices, columns)]
            yield _Pose(pose.rows[0], errors, tuple(approaches[i] for i in indices))


def _variation(pose: _Pose, unit: str) -> float:  # noqa: ARG001
    """Return vAP, between the approaches that have `FEWEST_REPEATS` repeats; NaN with fewer than two of these."""
    words = np.array(pose.approaches)
    means = []
    for approach in dict.fromkeys(pose.approaches):
        of_approach = pose.errors[words == approach]
        if approach and len(of_approach) >= FEWEST_REPEATS:
            means.append(of_approach.mean(axis=0))
    distances = [float(np.linalg.norm(a - b)) for a, b in combinations(means, 2)]
    return max(distances, default=np.nan)


def _accuracy_drift(pose: _Pose, unit: str) -> float:  # noqa: ARG001
    """Return dAP; NaN with fewer than two tens of repeats."""
    return _largest_change(pose, lambda ten: float(np.linalg.norm(ten.mean(axis=0))))


def _repeatability_drift(pose: _Pose, unit: str) -> float:
    """Return dRP; NaN with fewer than two tens of repeats."""
    return _largest_change(pose, lambda ten: repeatability(ten, unit))


def _largest_change(pose: _Pose, figure: Callable[[Array], float]) -> float:
    """Return the largest change of a figure from the first ten repeats of a pose to any later ten; NaN without these.

    Args:
        pose: The repeats, in the order of time.
        figure: From the errors of ten repeats, shape (10, d), to the figure.
    """
    starts = range(0, len(pose.errors) - DRIFT_REPEATS + 1, DRIFT_REPEATS)
    figures = [figure(pose.errors[start : start + DRIFT_REPEATS]) for start in starts]
    return max((abs(later - figures[0]) for later in figures[1:]), default=np.nan)


#: Characteristics of one pose by their symbols: from its errors and the unit to the value, NaN where it has none.
_OF_POSES: dict[str, Callable[[_Pose, str], float]] = {
    "vAP": _variation,
    "dAP": _accuracy_drift,
    "dRP": _repeatability_drift,
}
