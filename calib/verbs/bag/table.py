"""Rows of a table of measurements from streams: a row for each stop, or for each point of an arm that does not stop.

At a stop joints and points are averaged after the arm has settled. The row's sigma is that of a coordinate of the mean.
Samples that follow each other may be correlated, and the arm may creep, so it is from the means m_b of B pieces:

    sigma^2 = sum over coordinates and blocks (m_b - mean)^2 / (3 B (B - 1)),    at least the median of all stops,

so that a stop at which the arm or the instrument shook counts less, and none counts more by chance.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array
from calib.basics.files import csv_bytes
from calib.basics.values import Value
from calib.data.columns import DEFAULT_TARGET
from calib.verbs.bag.streams import JointStream, PointStream

#: The end of a stop is not used: the lag is not exact [s].
_MARGIN = 0.1

#: A stop is divided into so many pieces, or as many as it has samples.
_BLOCKS = 8

#: Fewer stops are none: the arm moves, and rests by chance.
FEWEST_STOPS = 5

_MM = 1e3


@dataclass(frozen=True, slots=True)
class Settings(Value):
    """Settings of the search for stops."""

    #: The arm settles for so long after it has stopped [s].
    settle: float = 0.5
    #: What is left of a stop lasts at least so long [s].
    shortest: float = 0.3


@dataclass(frozen=True, slots=True)
class Skipped(Value):
    """A stop that is not used."""

    #: When it began [s].
    begin: float
    #: How long it lasted [s].
    length: float
    #: ``short``: less is left of it than wanted; ``no_point``: nothing was measured; ``no_image``: no picture.
    code: str
    #: The topic of which a point or picture is missing; empty.
    topic: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Row(Value):
    """A row of the table. Numbers of a point are NaN in a row without one, through which the arm only drove."""

    #: When [s].
    time: float
    #: shape (n,), joint values [rad] or [m].
    q: Array
    #: Names of the instrument's place and of the target.
    group: str
    target: str
    #: shape (3,) [m].
    position: Array
    #: shape (4,), scalar last; NaN of a point.
    quaternion: Array
    #: Standard deviations of a coordinate [m] and of an angle [rad]; NaN: not known.
    sigma: float
    sigma_angle: float
    #: Number of points that were averaged.
    samples: int


def used_spans(stops: Array, settings: Settings) -> tuple[Array, list[Skipped]]:
    """Return what is used of the stops, shape (S, 2) [s], and those that are too short.

    Args:
        stops: shape (S, 2), beginning and end of each [s].
        settings: How long the arm settles, and what is short.
    """
    spans, skipped = [], []
    for begin, end in stops:
        start, stop = begin + settings.settle, end - _MARGIN
        if stop - start >= settings.shortest:
            spans.append((start, stop))
        else:
            skipped.append(Skipped(float(begin), float(end - begin), "short"))
    return np.array(spans).reshape(-1, 2), skipped


def stop_rows(
    joints: JointStream,
    points: Sequence[PointStream],
    lags: Mapping[str, float],
    spans: Array,
) -> tuple[list[Row], list[Skipped]]:
    """Average joints and points at each stop.

    Args:
        joints: The joint values.
        points: The points.
        lags: By topic how much later its stamps are than those of the joints [s].
        spans: What is used of each stop, shape (S, 2) [s].

    Returns:
        A row for each stop and topic, in the order of time, and stops at which a topic has no point. A stop without any
        point has a row of joint values alone.
    """
    rows: list[Row] = []
    skipped: list[Skipped] = []
    nothing = np.full(4, np.nan)
    for begin, end in spans:
        at = joints.times
        q = joints.q[(at >= begin) & (at <= end)]
        if not len(q):
            continue
        mean_q = q.mean(axis=0)
        middle = 0.5 * (begin + end)
        found = []
        for stream in points:
            times = stream.times - lags[stream.topic]
            inside = (times >= begin) & (times <= end)
            if not inside.any():
                skipped.append(Skipped(float(begin), float(end - begin), "no_point", stream.topic))
                continue
            p = stream.positions[inside]
            turn, sigma_angle = _mean_rotation(stream.quaternions[inside])
            found.append(
                Row(
                    float(middle),
                    mean_q,
                    stream.group,
                    stream.target,
                    p.mean(axis=0),
                    turn,
                    _sigma_of_mean(p),
                    sigma_angle,
                    len(p),
                )
            )
        if not found:
            found.append(
                Row(float(middle), mean_q, "", "", nothing[:3], nothing, np.nan, np.nan, 0)
            )
        rows += found
    return rows, skipped


def moving_rows(
    joints: JointStream, points: Sequence[PointStream], lags: Mapping[str, float]
) -> list[Row]:
    """Return a row for each point of a moving arm, with the joint values at its time.

    Args:
        joints: The joint values.
        points: The points.
        lags: By topic how much later its stamps are than those of the joints [s].
    """
    rows = []
    widest = 3.0 * joints.interval
    for stream in points:
        times = stream.times - lags[stream.topic]
        after = np.searchsorted(joints.times, times)
        inside = (after > 0) & (after < len(joints.times))
        near = np.clip(after, 1, len(joints.times) - 1)
        inside &= joints.times[near] - joints.times[near - 1] <= widest
        q = joints.at(times[inside])
        for time, values, position, turn in zip(
            times[inside],
            q,
            stream.positions[inside],
            stream.quaternions[inside],
            strict=True,
        ):
            rows.append(
                Row(
                    float(time),
                    values,
                    stream.group,
                    stream.target,
                    position,
                    turn,
                    np.nan,
                    np.nan,
                    1,
                )
            )
    return sorted(rows, key=lambda row: row.time)


def table_bytes(names: Sequence[str], sliding: Collection[str], rows: Sequence[Row]) -> bytes:
    """Write rows as a table of measurements (CSV), angles in deg and lengths in mm.

    Args:
        names: Names of the joints.
        sliding: Those that slide.
        rows: The rows; at least one has a point.
    """
    measured = [row for row in rows if row.samples]
    has_sets = len(measured) < len(rows)
    groups = any(row.group for row in rows)
    targets = any(row.target for row in rows)
    poses = [bool(np.isfinite(row.quaternion).all()) for row in rows]
    some_poses = any(poses)
    kinds = some_poses and sum(poses) < len(measured)
    sigma = _at_least_median([row.sigma for row in rows])
    sigma_angle = _at_least_median([row.sigma_angle for row in rows])
    is_sliding = np.array([name in sliding for name in names])
    header = ["order"]
    header += [
        f"{name} [{'mm' if slides else 'deg'}]"
        for name, slides in zip(names, is_sliding, strict=True)
    ]
    header += ["set"] * has_sets + ["kind"] * kinds + ["group"] * groups + ["target"] * targets
    header += ["x [mm]", "y [mm]", "z [mm]"]
    header += ["qx", "qy", "qz", "qw"] if some_poses else []
    header += ["sigma [mm]"] if sigma is not None else []
    header += ["sigma_angle [deg]"] if sigma_angle is not None else []
    header += ["samples"] if any(row.samples > 1 for row in rows) else []
    lines: list[list[object]] = [list(header)]
    for k, row in enumerate(rows):
        is_measured = row.samples > 0
        line: list[object] = [round(row.time, 6)]
        line += np.where(is_sliding, row.q * _MM, np.degrees(row.q)).tolist()
        line += (["estimate" if is_measured else "via"]) * has_sets
        line += (["pose" if poses[k] else "point"]) * kinds
        target = row.target or (DEFAULT_TARGET if is_measured else "")
        line += [row.group] * groups + [target] * targets
        line += _cells(row.position * _MM)
        line += _cells(row.quaternion) if some_poses else []
        line += _cells(sigma[k : k + 1] * _MM) if sigma is not None else []
        line += _cells(np.degrees(sigma_angle[k : k + 1])) if sigma_angle is not None else []
        line += [row.samples] if "samples" in header else []
        lines.append(line)
    return csv_bytes(lines)


def _cells(values: Array) -> list[object]:
    """Return numbers as cells, empty for NaN."""
    return [value if np.isfinite(value) else "" for value in values.tolist()]


def _at_least_median(values: Sequence[float]) -> Array | None:
    """Return standard deviations that are at least their median; None if none is known, or all are zero."""
    known = np.array(values)
    finite = known[np.isfinite(known)]
    if not len(finite) or np.median(finite) <= 0.0:
        return None
    middle = float(np.median(finite))
    floor = np.maximum(np.nan_to_num(known, nan=middle), middle)
    return np.asarray(floor)


def _sigma_of_mean(values: Array) -> float:
    """Return the standard deviation of the mean of a coordinate of values (n, D) in time order; NaN of one row."""
    blocks = min(_BLOCKS, len(values))
    if blocks < 2:
        return float(np.nan)
    means = np.array([block.mean(axis=0) for block in np.array_split(values, blocks)])
    squares = np.sum((means - means.mean(axis=0)) ** 2)
    return float(np.sqrt(squares / (values.shape[1] * blocks * (blocks - 1))))


def _mean_rotation(quaternions: Array) -> tuple[Array, float]:
    """Return the mean of quaternions (n, 4), and the sigma of an angle of it [rad]; NaN if they are NaN."""
    if not np.isfinite(quaternions).all():
        return np.full(4, np.nan), float(np.nan)
    turns = Rotation.from_quat(quaternions)
    mean = turns.mean()
    off = (mean.inv() * turns).as_rotvec()
    return np.asarray(mean.as_quat()), _sigma_of_mean(off)
