"""Characteristics of ISO 9283 beside the accuracy and repeatability of single poses: of distances, approaches, drift.

With the error e = measured - predicted of a row, the measured distance D_j between repeat j of one pose and repeat j of
another, and the distance Dc_j that the robot's model predicts for their joint values,

    AD  = |mean (D_j - Dc_j)|                   distance accuracy, of two poses
    RD  = 3 S of D_j - Dc_j                     distance repeatability
    vAP = max |mean_h e - mean_k e|             between the approaches h and k of one pose
    dAP = max |AP_t - AP_1|                     between the later tens of repeats t of one pose and the first ten
    dRP = max |RP_t - RP_1|

where S is the standard deviation over n - 1. Rows are in the order of their measurement.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import pdist

from calib.basics.arrays import Array
from calib.verbs.evaluate.accuracy import (
    FEWEST_REPEATS,
    Accuracy,
    PoseAccuracy,
    pose_accuracy,
    repeatability,
)
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
    approaches = np.array(evaluation.measurements.approaches)
    symbols = ("vAP", "dAP", "dRP")
    values: dict[tuple[str, str], list[float]] = {
        (symbol, unit): [] for symbol in symbols for unit in judged.units
    }
    first_rows: dict[str, list[tuple[int, ...]]] = {unit: [] for unit in judged.units}
    for unit in judged.units:
        for pose, indices in repeats:
            if unit not in pose.by_unit:
                continue
            # Along the axes of their measurement frames, on which no norm depends.
            columns = evaluation.channels.select(indices).columns(unit)
            errors = evaluation.residual[np.ix_(indices, columns)]
            first_rows[unit].append((pose.rows[0],))
            values["vAP", unit].append(_variation(errors, approaches[indices]))
            values["dAP", unit].append(_largest_change(errors, pose_accuracy))
            values["dRP", unit].append(_largest_change(errors, partial(repeatability, unit=unit)))
    for (symbol, unit), of_poses in values.items():
        result.append(_summarise(symbol, unit, np.array(of_poses), first_rows[unit]))
    return tuple(result)


def _summarise(
    symbol: str, unit: str, values: Array, rows: Sequence[tuple[int, ...]]
) -> Characteristic:
    """Summarise a characteristic of k poses or pairs: values (k,), NaN for none, and numbers of their first rows."""
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
    """Return AD and RD [m] over the pairs of poses of one target at one station, of each place's first `MOST_POSES`.

    Poses without measured positions are left out; RD takes pairs with `FEWEST_REPEATS` repeats or more.
    """
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
        mean, deviation = _distance_errors(measured, predicted, poses, counted)
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
    measured: Array, predicted: Array, poses: Sequence[NDArray[np.intp]], counts: NDArray[np.int_]
) -> tuple[Array, Array]:
    """Return mean and standard deviation over n - 1, (P,) [m], of the errors D_j - Dc_j of all P pairs of poses.

    They are over the first ``counts`` repeats, (P,), of each pair, and computed repeat by repeat (Welford); positions
    are (N, 3) [m] in one frame, poses the indices of their repeats.
    """
    mean = np.zeros(len(counts))
    square = np.zeros(len(counts))
    for j in range(max(map(len, poses))):
        # The first repeat stands for one that a pose lacks, which does not count.
        row = np.array([pose[j] if j < len(pose) else pose[0] for pose in poses])
        error = pdist(measured[row]) - pdist(predicted[row])
        change = np.where(j < counts, error - mean, 0.0)
        mean = mean + change / (j + 1)
        square = square + change * (error - mean)
    return mean, np.sqrt(square / np.maximum(counts - 1, 1))


# Approaches and drift of one pose


def _variation(errors: Array, approaches: NDArray[np.str_]) -> float:
    """Return vAP of one pose, the largest distance between the mean errors of two approaches, in the errors' unit.

    The errors are (n, d), the names of their approaches (n,), empty if not given. Approaches with fewer than
    `FEWEST_REPEATS` repeats do not count; NaN if fewer than two remain.
    """
    means = []
    for approach in dict.fromkeys(approaches.tolist()):
        of_approach = errors[approaches == approach]
        if approach and len(of_approach) >= FEWEST_REPEATS:
            means.append(of_approach.mean(axis=0))
    distances = [float(np.linalg.norm(a - b)) for a, b in combinations(means, 2)]
    return max(distances, default=np.nan)


def _largest_change(errors: Array, figure: Callable[[Array], float]) -> float:
    """Return the largest change of a figure of errors (n, d) from the first ten repeats to any later ten; NaN for none.

    The repeats of the pose are in the order of time; an incomplete last ten is left out.
    """
    starts = range(0, len(errors) - DRIFT_REPEATS + 1, DRIFT_REPEATS)
    figures = [figure(errors[start : start + DRIFT_REPEATS]) for start in starts]
    return max((abs(later - figures[0]) for later in figures[1:]), default=np.nan)
