"""Joint zeros as a controller stores them: a number for each joint, of a sign, in a unit, with so many decimals.

A joint is at reading + delta. The controller makes the reading of a raw value and of the number that it stores,

    reading = raw + sign unit number

so that the reading goes up by delta where the number changes by sign delta / unit, rounded.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from calib.basics.arrays import Array, Mask, read_only
from calib.basics.values import Value
from calib.errors import CalibError, ModelError, choices
from calib.result.calibration import Calibration
from calib.result.joint_zeros import JointZeros
from calib.verbs.convert.source import Source

#: Largest homing offset of a Feetech servo, which stores 11 bits and a sign [ticks].
_FEETECH_LIMIT = 2047

#: Largest homing offset of a Dynamixel servo [ticks].
_DYNAMIXEL_LIMIT = 1_044_479


class Unit(NamedTuple):
    """A unit of stored numbers."""

    #: What it is called: ``"deg"``
    name: str
    #: One of it [rad] or [m]
    to_si: float
    #: Decimals that are stored
    decimals: int


@dataclass(frozen=True, slots=True)
class StoredNumber:
    """The number in which a controller stores the zero of a joint: reading = raw + sign unit number."""

    #: What the number is called there
    key: str
    #: 1 or -1
    sign: int
    #: Unit of turning joints
    angle: Unit
    #: Unit of sliding joints; None: they cannot be stored
    length: Unit | None
    #: Largest number either way; infinite without a limit
    largest: float = np.inf


_RAD = Unit("rad", 1.0, 6)

_METRE = Unit("m", 1.0, 6)

#: A tick of a servo's encoder, here of 4096 a turn.
_TICK = Unit("ticks", 2.0 * np.pi / 4096, 0)

STORED: Mapping[str, StoredNumber] = {
    # Added to the readings, as one types it into a mastering
    "zeros": StoredNumber("change", 1, Unit("deg", np.pi / 180.0, 4), Unit("mm", 1e-3, 3)),
    # reading = (raw - offset) / gear_ratio
    "dynamixel-hardware": StoredNumber("offset", -1, _RAD, _METRE),
    # reading = raw / reduction + offset
    "ros2-transmission": StoredNumber("offset", 1, _RAD, _METRE),
    # present position = actual position - homing offset
    "lerobot": StoredNumber("homing_offset", -1, _TICK, None, _FEETECH_LIMIT),
    # present position = actual position + homing offset
    "lerobot-dynamixel": StoredNumber("homing_offset", 1, _TICK, None, _DYNAMIXEL_LIMIT),
}
"""How zeros are stored, by the name of the format."""


def stored_number(name: str, ticks: int) -> StoredNumber:
    """Return how a format stores zeros.

    Args:
        name: The format, one of `STORED`.
        ticks: Ticks a turn of a servo's encoder.

    Raises:
        CalibError: There is less than one tick a turn.
    """
    if ticks < 1:
        raise CalibError(f"--ticks {ticks}: a servo has some ticks a turn, most have 4096.")
    stored = STORED[name]
    if stored.angle is not _TICK:
        return stored
    return replace(stored, angle=_TICK._replace(to_si=2.0 * np.pi / ticks))


@dataclass(frozen=True, slots=True, eq=False)
class RoundedZeros(Value):
    """The zeros of m joints as a controller stores them."""

    #: How it stores them
    stored: StoredNumber
    #: As they were fitted
    zeros: JointZeros
    #: Shape (m,), True for joints that slide
    prismatic: Mask
    #: Shape (m,), change of the stored number of each joint, in its unit, rounded; 0 where the zero is not determined
    numbers: Array

    @classmethod
    def of(cls, source: Source, stored: StoredNumber) -> RoundedZeros:
        """Round the zeros of a result.

        Args:
            source: The result.
            stored: How the controller stores them.

        Returns:
            The change of the stored number of each joint.

        Raises:
            CalibError: The source is no result, or has no zeros.
            ModelError: A joint slides, and its zero cannot be stored.
        """
        zeros = _zeros_of(source)
        types = source.robot.joint_types
        prismatic = np.array([types[name] == "prismatic" for name in zeros.joints], dtype=bool)
        prismatic.setflags(write=False)
        sliding = [name for name, slides in zip(zeros.joints, prismatic, strict=True) if slides]
        if sliding and stored.length is None:
            raise ModelError(
                f"{choices(sliding)} slides, and a servo's {stored.key} is an angle. Choose --to zeros, which has mm."
            )
        numbers = []
        for delta, slides in zip(zeros.delta.tolist(), prismatic, strict=True):
            unit = _unit(stored, slides=slides)
            numbers.append(round(stored.sign * delta / unit.to_si, unit.decimals) + 0.0)
        return cls(stored, zeros, prismatic, read_only(numbers))

    @property
    def units(self) -> tuple[Unit, ...]:
        """The unit of each joint's number."""
        return tuple(_unit(self.stored, slides=slides) for slides in self.prismatic)

    @property
    def change(self) -> Array:
        """By how much the readings go up [rad] or [m], shape (m,): the zeros after rounding."""
        to_si = np.array([unit.to_si for unit in self.units])
        return np.asarray(self.stored.sign * self.numbers * to_si)

    @property
    def rounding(self) -> Array:
        """Change of the zeros by rounding: rounded minus fitted [rad] or [m], shape (m,)."""
        return np.asarray(self.change - self.zeros.delta)

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Names of the joints whose zero is not determined."""
        pairs = zip(self.zeros.joints, self.zeros.determined, strict=True)
        return tuple(name for name, determined in pairs if not determined)

    def by_joint(self) -> dict[str, float]:
        """Return the change of the stored number by joint, of those whose zero is determined."""
        rows = zip(self.zeros.joints, self.numbers.tolist(), self.zeros.determined, strict=True)
        return {name: number for name, number, determined in rows if determined}


def _unit(stored: StoredNumber, *, slides: bool) -> Unit:
    """Return the unit of a joint's number."""
    return stored.length if slides and stored.length is not None else stored.angle


def calibration_of(source: Source) -> Calibration:
    """Return the calibration that a source is.

    Raises:
        CalibError: It is none.
    """
    if source.calibration is None:
        raise CalibError(
            "Joint zeros are refitted to the measurements, which a robot alone does not know. Give the result of "
            "calib calibrate ROBOT DATA --json result.json."
        )
    return source.calibration


def _zeros_of(source: Source) -> JointZeros:
    """Return the zeros of a result; `CalibError` if the source has none."""
    zeros = calibration_of(source).zeros
    if zeros is None:
        raise CalibError(
            "The result has no joint zeros: an earlier version of calib wrote it, or they could not be fitted to so "
            "few rows. Calibrate again with this version: calib calibrate ROBOT DATA --json result.json."
        )
    return zeros
