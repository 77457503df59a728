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

#: A judged pose with the indices of its rows in the table.
_Repeats = tuple[PoseAccuracy, NDArray[np.intp]]


@dataclass(frozen=True, slots=True)
class Characteristic:
    """One characteristic in one unit, over the poses, or pairs of poses, that have it."""

    #: Its symbol: ``"AD"``, ``"RD"``, ``"vAP"``, ``"dAP"`` or ``"dRP"``
    symbol: str
    #: Symbol of the unit, of `calib.basics.channels.RESIDUAL_UNITS`
    unit: str
    #: The largest value, in the unit; NaN if the rows do not have it
    largest: float
    #: The mean; NaN if the rows do not have it
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
    #: Direction that each was approached from; empty if it is not given
    approaches: tuple[str, ...]


def characteristics(evaluation: Evaluation, judged: Accuracy) -> tuple[Characteristic, ...]:
    """Return the characteristics of an evaluated robot, in the units that were measured.

    Args:
        evaluation: Errors of the robot at the rows of a table.
        judged: Its pose accuracy, whose poses name the rows that count.

    Returns:
        AD and RD of positions, if any were measured, then vAP, dAP and dRP in each unit; NaN, with a count of 0, for
        those that the rows do not have.
    """
    index = {number: i for i, number in enumerate(evaluation.measurements.rows)}
    # Each judged pose with the indices of its rows in the table.
    repeats = [(pose, np.array([index[number] for number in pose.rows])) for pose in judged.poses]

    result = []
    if _LENGTH in judged.units:
        result += _of_distances(evaluation, repeats)
    approaches = evaluation.measurements.approaches
    poses: dict[str, list[_Pose]] = {unit: [] for unit in judged.units}
    for unit, of_unit in poses.items():
        for pose, indices in repeats:
            if unit in pose.by_unit:
                # Along the axes of their measurement frames, on which no norm depends.
                columns = evaluation.channels.select(indices).columns(unit)
                errors = evaluation.residual[np.ix_(indices, columns)]
                of_unit.append(_Pose(pose.rows[0], errors, tuple(approaches[i] for i in indices)))
    for symbol, figure in _OF_POSES.items():
        for unit, of_unit in poses.items():
            values = [figure(pose, unit) for pose in of_unit]
            rows = [(pose.row,) for pose in of_unit]
            result.append(_summarise(symbol, unit, np.array(values), rows))
    return tuple(result)


def _summarise(
    symbol: str, unit: str, values: Array, rows: Sequence[tuple[int, ...]]
) -> Characteristic:
    """Return the largest and the mean of values (k,), NaN for none, of k poses or pairs with their first rows."""
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


def _of_distances(evaluation: Evaluation, repeats: Sequence[_Repeats]) -> list[Characteristic]:
    """Return AD and RD of all pairs of poses of one target at one station; RD of `FEWEST_REPEATS` repeats or more."""
    columns, are_positions = evaluation.channels.vector_columns(_LENGTH)
    has_position = are_positions & evaluation.measurements.positions
    places: dict[tuple[str, str], list[NDArray[np.intp]]] = {}
    for pose, indices in repeats:
        if np.all(has_position[indices]):
            places.setdefault((pose.group, pose.target), []).append(indices)

    # Of P pairs: the first rows of both poses, the number of repeats that both have, and mean and standard deviation
    # over n - 1 (0 for one repeat) of the errors D_j - Dc_j over these [m].
    rows: list[tuple[int, ...]] = []
    counts: list[NDArray[np.int_]] = [np.zeros(0, dtype=int)]
    means, deviations = [np.zeros(0)], [np.zeros(0)]
    measured = evaluation.measurements.points
    numbers = np.array(evaluation.measurements.rows)
    for of_place in places.values():
        poses = of_place[:MOST_POSES]
        first, second = np.triu_indices(len(poses), 1)
        lengths = np.array(list(map(len, poses)))
        counted = np.minimum(lengths[first], lengths[second])
        predicted = measured - evaluation.residual[:, columns]
        errors = _distance_errors(measured, predicted, poses)
        mean, deviation = _mean_and_deviation(errors, counted)
        first_rows = numbers[[pose[0] for pose in poses]]
        pairs = np.stack([first_rows[first], first_rows[second]], axis=1)
        rows += [(one, other) for one, other in pairs.tolist()]
        counts.append(counted)
        means.append(mean)
        deviations.append(deviation)

    enough = np.concatenate(counts) >= FEWEST_REPEATS
    spread = np.where(enough, 3.0 * np.concatenate(deviations), np.nan)
    return [
        _summarise("AD", _LENGTH, np.abs(np.concatenate(means)), rows),
        _summarise("RD", _LENGTH, spread, rows),
    ]


def _distance_errors(
    measured: Array, predicted: Array, poses: list[NDArray[np.intp]]
) -> Iterator[Array]:
    """Yield, repeat by repeat, the errors D_j - Dc_j [m] of the distances of all P pairs of poses, shape (P,).

    Of positions (N, 3) [m] in one frame; errors of a repeat that one of a pair lacks have no meaning.
    """
    for j in range(max(map(len, poses))):
        # The first repeat stands for one that a pose lacks.
        row = np.array([pose[j] if j < len(pose) else pose[0] for pose in poses])
        yield pdist(measured[row]) - pdist(predicted[row])


def _mean_and_deviation(errors: Iterable[Array], counts: NDArray[np.int_]) -> tuple[Array, Array]:
    """Return mean and standard deviation over n - 1 of P errors over their first ``counts`` repeats (Welford)."""
    mean = np.zeros(len(counts))
    square = np.zeros(len(counts))
    for j, error in enumerate(errors):
        change = np.where(j < counts, error - mean, 0.0)
        mean = mean + change / (j + 1)
        square = square + change * (error - mean)
    return mean, np.sqrt(square / np.maximum(counts - 1, 1))


# Approaches and drift of one pose


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
    """Return the largest change of a figure from the first ten repeats, in the order of time, to any later ten."""
    starts = range(0, len(pose.errors) - DRIFT_REPEATS + 1, DRIFT_REPEATS)
    figures = [figure(pose.errors[start : start + DRIFT_REPEATS]) for start in starts]
    return max((abs(later - figures[0]) for later in figures[1:]), default=np.nan)


#: Characteristics of one pose by their symbols: from its errors and the unit to the value, NaN where it has none.
_OF_POSES: dict[str, Callable[[_Pose, str], float]] = {
    "vAP": _variation,
    "dAP": _accuracy_drift,
    "dRP": _repeatability_drift,
}
