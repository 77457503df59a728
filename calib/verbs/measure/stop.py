"""Stops of a session: where the robot stood, what was read there, and what that said."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from calib.basics.arrays import Array, read_only
from calib.basics.values import ReadOnlyMapping, Value, keep_read_only, shown_by
from calib.data.measurements import Measurements
from calib.errors import MeasurementError

#: ``"good"``: it counts; ``"again"``: it does not, and is to be measured again; ``"unknown"``: it counts, and too few
#: stops are known to say more.
Outcome = Literal["good", "again", "unknown"]

#: What may be wrong: a reading far off (``"gross"``); coordinates or targets taken for each other (``"swapped"``); the
#: reading of an earlier stop once more (``"repeated"``); a reading that fits another pose than that of the joint values
#: (``"not_there"``); from a stop on, a target, the base or the instrument, or one of them, stands elsewhere.
Code = Literal[
    "gross", "swapped", "repeated", "not_there", "target_moved", "base_moved", "something_moved"
]

#: Joint values that differ by no more are the same pose [rad or m].
SAME_POSE = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Row(Value):
    """The measurement at one stop."""

    #: Shape (m,), joint values as the robot has them, columns as ``robot.joint_names`` [rad] or [m]
    joints: Array
    #: Rows of a table, all with these joint values: one for each target, or for each corner in a picture
    readings: Measurements
    #: Shape (m,), last move of each joint before it, if the robot drove by a place for that; None: from the pose before
    moves: Array | None = None

    def __post_init__(self) -> None:
        """Keep a read-only copy, and refuse readings of no or of several poses: `MeasurementError`."""
        object.__setattr__(self, "joints", read_only(np.array(self.joints, dtype=np.float64)))
        if not len(self.readings):
            raise MeasurementError(
                "A stop has no reading: give one row for each target that was measured."
            )
        if np.abs(self.readings.joints - self.readings.joints[0]).max() > SAME_POSE:
            raise MeasurementError(
                "The readings are of several poses: a row is one stop of the robot; add one after the other."
            )


@dataclass(frozen=True, slots=True, eq=False)
class Finding(Value):
    """Something that may be wrong."""

    #: What
    code: Code
    #: Numbers of the stops
    stops: tuple[int, ...]
    #: Sizes in SI units by name, such as ``"off_m"``, ``"stop"`` or ``"angle"``
    values: Mapping[str, float] = field(default_factory=ReadOnlyMapping)
    #: Name of the joint or target that is meant; empty without
    name: str = ""

    def __post_init__(self) -> None:
        """Keep a read-only copy of the mapping."""
        keep_read_only(self, "values")


@dataclass(frozen=True, slots=True, eq=False)
class Answer(Value):
    """The answer of a session to a stop, as soon as that is measured."""

    #: Its number, from 1
    stop: int
    #: Whether it counts
    outcome: Outcome
    #: Norm of measured minus expected by unit, rms over its targets or corners [m], [rad], [px]; empty if nothing is
    #: expected yet
    residual: Mapping[str, float] = field(default_factory=ReadOnlyMapping)
    #: Its usual size
    usual: Mapping[str, float] = field(default_factory=ReadOnlyMapping)
    #: y^T S^-1 y over the number of entries, about 1 for a good stop; NaN if nothing is expected yet
    square: float = np.nan
    #: Number of entries
    numbers: int = 0
    #: What may be wrong
    findings: tuple[Finding, ...] = ()
    #: Error below which 95 % of calibrations are, before and after it [m]; None: not known yet
    before: float | None = None
    after: float | None = None

    def __post_init__(self) -> None:
        """Keep read-only copies of the mappings."""
        keep_read_only(self, "residual", "usual")

    def __str__(self) -> str:
        """Return the answer as text, see `summary`."""
        return self.summary()

    def summary(self) -> str:
        """Return the answer as `calib measure` says it: a line, then what may be wrong."""
        return str(shown_by("verbs.measure.text").answer_summary(self))


@dataclass(frozen=True, slots=True, eq=False)
class Stop(Value):
    """A stop that was measured."""

    #: Its number, from 1
    number: int
    #: What was measured
    row: Row
    #: What was said of it
    answer: Answer
    #: Whether it counts
    counts: bool
