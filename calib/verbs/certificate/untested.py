"""What a certificate's measurements did not test, found in the data and the record, as codes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import numpy as np

import calib.data.kinds as registry
from calib.basics.arrays import Array
from calib.basics.dates import parse_date
from calib.basics.values import ReadOnlyMapping, Value
from calib.data.record import Record
from calib.diagnosis.reasons import Why
from calib.result.calibration import Calibration
from calib.verbs.certificate.points import Point
from calib.verbs.evaluate.acceptance import Assessment
from calib.verbs.evaluate.accuracy import FEWEST_REPEATS
from calib.verbs.evaluate.characteristics import DRIFT_REPEATS

#: Poses that ISO 9283 asks for.
_ISO_POSES = 5

#: A joint whose values at the points differ by less than this did not move [rad or m].
_STILL = 1e-3


class Untested(Enum):
    """Something that was not tested, or is not stated, so that the certificate does not cover it."""

    AS_FOUND = "as_found"
    POSITIONS = "positions"
    ORIENTATIONS = "orientations"
    FEW_POINTS = "few_points"
    REPEATS = "repeats"
    APPROACHES = "approaches"
    OTHER_SIDES = "other_sides"
    DRIFT = "drift"
    STILL_JOINTS = "still_joints"
    BEYOND = "beyond"
    OUTSIDE = "outside"
    TARGETS = "targets"
    STATIONS = "stations"
    REGISTERED = "registered"
    NON_GEOMETRIC = "non_geometric"
    LOAD = "load"
    OTHER_LOADS = "other_loads"
    SPEED = "speed"
    OTHER_SPEEDS = "other_speeds"
    WARM_UP = "warm_up"
    TEMPERATURE = "temperature"
    OTHER_TEMPERATURES = "other_temperatures"
    TRACEABILITY = "traceability"
    EXPIRED = "expired"
    NOISE = "noise"


@dataclass(frozen=True, slots=True, eq=False)
class Gap(Value):
    """One thing that was not tested."""

    code: Untested
    #: Values that its sentence names, in SI units
    values: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Keep a copy that cannot be changed."""
        object.__setattr__(self, "values", ReadOnlyMapping(self.values))


def gaps(
    e: Assessment,
    calibration: Calibration,
    points: tuple[Point, ...],
    record: Record,
    estimated: Sequence[str] = (),
) -> tuple[Gap, ...]:
    """Return what the measurements of a certificate did not test.

    Args:
        e: The assessment of the robot that is certified.
        calibration: Its calibration.
        points: The certificate's points.
        record: The certificate's record.
        estimated: Symbols of the units of which nothing states the noise of a reading, so that it was estimated.
    """
    found = [
        *_of_rows(e, calibration, points),
        *_of_joints(e, points, calibration.rows.ranges),
        *_of_record(record),
    ]
    if estimated:
        found.append(Gap(Untested.NOISE, {"units": tuple(estimated)}))
    return tuple(found)


def _of_rows(e: Assessment, calibration: Calibration, points: tuple[Point, ...]) -> Iterator[Gap]:
    """Find what the rows of the points do not measure: units, repeats, approaches, targets, stations."""
    judged = e.accuracies[e.judged]
    if "nominal" not in e.evaluations:
        yield Gap(Untested.AS_FOUND)
    if not all(registry.get(pose.kind).coordinates for pose in judged.poses):
        kinds = dict.fromkeys(pose.kind for pose in judged.poses)
        partial = [kind for kind in kinds if not registry.get(kind).coordinates]
        yield Gap(Untested.POSITIONS, {"kinds": tuple(partial)})
    if "rad" not in judged.units:
        yield Gap(Untested.ORIENTATIONS)
    if len(points) < _ISO_POSES:
        yield Gap(Untested.FEW_POINTS, {"points": len(points), "wanted": _ISO_POSES})
    fewest, most = judged.repeats
    if fewest < FEWEST_REPEATS:
        yield Gap(Untested.REPEATS, {"repeats": fewest, "wanted": FEWEST_REPEATS})
    found = {one.symbol: one.count for one in e.characteristics[e.judged]}
    if not found.get("vAP"):
        yield Gap(Untested.APPROACHES)
    if e.hint is not None and e.hint.why is Why.OTHER_SIDES:
        yield Gap(Untested.OTHER_SIDES)
    if not found.get("dAP"):
        yield Gap(Untested.DRIFT, {"repeats": most, "wanted": 2 * DRIFT_REPEATS})
    setup = calibration.setup
    for code, known, seen in (
        (Untested.TARGETS, setup.targets, {point.target for point in points}),
        (Untested.STATIONS, setup.groups, {point.group for point in points}),
    ):
        missing = tuple(name for name in known if name not in seen)
        if len(known) > 1 and missing:
            yield Gap(code, {"names": missing})
    if judged.registered:
        yield Gap(Untested.REGISTERED, {"places": judged.registered})
    if e.judged != "non_geometric" and "non_geometric" in e.evaluations:
        yield Gap(Untested.NON_GEOMETRIC)


def _of_joints(e: Assessment, points: tuple[Point, ...], box: Array) -> Iterator[Gap]:
    """Find joints that stood still at the points, parts of the calibrated ranges without points, and points outside.

    The ranges ``box`` are of the shape (m, 2) [rad] or [m].
    """
    q = np.array([point.joints for point in points])
    names = e.evaluations[e.judged].robot.joint_names
    low, high = q.min(axis=0), q.max(axis=0)
    still = tuple(name for name, span in zip(names, high - low, strict=True) if span < _STILL)
    if still:
        yield Gap(Untested.STILL_JOINTS, {"joints": still})
    width = box[:, 1] - box[:, 0]
    inside = np.minimum(high, box[:, 1]) - np.maximum(low, box[:, 0])
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(width > _STILL, np.maximum(inside, 0.0) / width, 1.0)
    least = int(np.argmin(share))
    if share[least] < 1.0:
        yield Gap(Untested.BEYOND, {"joint": names[least], "share": float(share[least])})
    if e.outside[0]:
        rows = tuple(e.outside[1][row.index] for row in e.outside[0])
        yield Gap(Untested.OUTSIDE, {"rows": rows})


def _of_record(record: Record) -> Iterator[Gap]:
    """Find conditions that the record does not state, and name those that it states as the only ones tested."""
    for text, not_stated, others in (
        (record.load, Untested.LOAD, Untested.OTHER_LOADS),
        (record.speed, Untested.SPEED, Untested.OTHER_SPEEDS),
    ):
        yield Gap(others, {"stated": text}) if text else Gap(not_stated)
    if not record.warm_up:
        yield Gap(Untested.WARM_UP)
    if record.temperature_C:
        ends = (min(record.temperature_C), max(record.temperature_C))
        yield Gap(Untested.OTHER_TEMPERATURES, {"low_C": ends[0], "high_C": ends[1]})
    else:
        yield Gap(Untested.TEMPERATURE)
    if not (record.traceability and record.instrument_certificate):
        yield Gap(Untested.TRACEABILITY)
    due, day = parse_date(record.calibration_due), parse_date(record.date)
    if due is not None and day is not None and due < day:
        yield Gap(Untested.EXPIRED, {"due": record.calibration_due, "date": record.date})
