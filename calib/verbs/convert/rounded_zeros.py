"""Joint zeros as a controller stores them, the errors with them, and both in words.

A joint is at reading + delta. The controller stores a number for each joint, with a sign, a unit and a number of
decimals, and makes the reading of a raw value and of that number,

    reading = raw + sign unit number

so that the reading goes up by delta if the number changes by sign delta / unit, rounded.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calib.basics.arrays import Array, Mask, read_only
from calib.basics.channels import RESIDUAL_UNITS
from calib.basics.values import Value, keep_read_only
from calib.errors import CalibError, ModelError, VerdictError, choices
from calib.numerics.errors import Errors
from calib.result.calibration import Calibration
from calib.result.joint_zeros import HELD_OUT, JointZeros
from calib.show.lines import fill, number
from calib.show.tables import Column, name_column, table_lines
from calib.show.words import joint_unit, shown
from calib.verbs.convert.format import Conversion, Source

#: Decimals of zeros and their standard deviations [deg, mm].
_DIGITS = 4

#: Words for the rows of the errors, by `RmsErrors.rows`.
_ROWS = {
    "held-out": "held-out rows, outliers aside",
    "validation": "validation rows",
    "estimation": "fitted rows, which prove nothing",
}


class Unit(NamedTuple):
    """A unit of stored numbers."""

    #: Its name: ``"deg"``
    name: str
    #: Its size [rad] or [m]
    to_si: float
    #: Decimals that are stored
    decimals: int


DEGREE = Unit("deg", np.pi / 180.0, 4)
MILLIMETRE = Unit("mm", 1e-3, 3)
RADIAN = Unit("rad", 1.0, 6)
METRE = Unit("m", 1.0, 6)
TICK = Unit("ticks", 2.0 * np.pi / 4096, 0)
"""A tick of a servo's encoder, here of 4096 per turn."""


@dataclass(frozen=True, slots=True)
class StoredNumber:
    """The number in which a controller stores the zero of a joint: reading = raw + sign unit number."""

    #: Its name in the controller
    key: str
    #: 1 or -1
    sign: int
    #: Unit for turning joints
    angle: Unit
    #: Unit for sliding joints; None: they cannot be stored
    length: Unit | None
    #: Largest number either way; infinite without a limit
    largest: float = np.inf

    def with_ticks(self, ticks: int) -> StoredNumber:
        """Return the same with another number of ticks per turn of a servo's encoder, if it is in ticks.

        Args:
            ticks: Ticks per turn.

        Raises:
            CalibError: There is less than one tick per turn.
        """
        if ticks < 1:
            raise CalibError(f"--ticks {ticks}: a servo has some ticks a turn, most have 4096.")
        if self.angle is not TICK:
            return self
        return replace(self, angle=TICK._replace(to_si=2.0 * np.pi / ticks))

    def unit(self, *, slides: bool) -> Unit:
        """Return the unit in which a joint's zero is stored, by whether the joint slides."""
        return self.length if slides and self.length is not None else self.angle


@dataclass(frozen=True, slots=True, eq=False)
class RoundedZeros(Value):
    """The zeros of m joints as a controller stores them."""

    #: Number, sign and unit in which it stores each
    stored: StoredNumber
    #: As they were fitted
    zeros: JointZeros
    #: Shape (m,), True for joints that slide
    prismatic: Mask
    #: Shape (m,), change of the stored number of each joint, in its unit, rounded; 0 if the zero is not determined
    numbers: Array

    @classmethod
    def of(cls, source: Source, stored: StoredNumber) -> RoundedZeros:
        """Round the joint zeros of a result to what a controller can store.

        Args:
            source: The result.
            stored: Number, sign and unit in which the controller stores a zero.

        Returns:
            The change of the stored number of each joint.

        Raises:
            CalibError: The source is not a result, or has no zeros.
            ModelError: A joint slides, and its zero cannot be stored.
        """
        zeros = source.require_calibration().zeros
        if zeros is None:
            raise CalibError(
                "The result has no joint zeros: an earlier version of calib wrote it, or they could not be fitted to "
                "so few rows. Calibrate again with this version: calib calibrate ROBOT DATA --json result.json."
            )
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
            unit = stored.unit(slides=slides)
            numbers.append(round(stored.sign * delta / unit.to_si, unit.decimals) + 0.0)
        return cls(stored, zeros, prismatic, read_only(numbers))

    @property
    def units(self) -> tuple[Unit, ...]:
        """The unit of each joint's number."""
        return tuple(self.stored.unit(slides=slides) for slides in self.prismatic)

    @property
    def change(self) -> Array:
        """Change of the readings [rad] or [m], shape (m,): the zeros after rounding."""
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
        """Return the change of the stored number by joint, for those whose zero is determined."""
        rows = zip(self.zeros.joints, self.numbers.tolist(), self.zeros.determined, strict=True)
        return {name: number for name, number, determined in rows if determined}


@dataclass(frozen=True, slots=True, eq=False)
class RmsErrors(Value):
    """Rms errors of the same rows by several robots, by the symbol of each unit that was measured."""

    #: The rows: `calib.result.joint_zeros.HELD_OUT` (without outliers), ``VALIDATION`` or ``ESTIMATION``
    rows: str
    #: By the nominal robot
    nominal: Mapping[str, float]
    #: With the zeros as fitted
    zeros: Mapping[str, float]
    #: With the zeros as rounded, target and frame as with those fitted
    rounded: Mapping[str, float]
    #: By the whole calibration that a URDF holds
    calibrated: Mapping[str, float]
    #: By the non-geometric model; None if there is none
    non_geometric: Mapping[str, float] | None

    def __post_init__(self) -> None:
        """Keep read-only copies of the mappings."""
        keep_read_only(self, "nominal", "zeros", "rounded", "calibrated", "non_geometric")

    @classmethod
    def of(cls, calibration: Calibration, rounded: RoundedZeros) -> RmsErrors:
        """Collect the rms errors of nominal robot, joint zeros alone, and whole calibration on the same rows.

        Args:
            calibration: The calibration.
            rounded: Its zeros, rounded, with the rows that their errors are of.
        """
        zeros = rounded.zeros
        others: dict[str, Errors] = {}
        if zeros.rows != HELD_OUT:
            for name, by_rows in calibration.errors.items():
                others[name] = by_rows[zeros.rows]
        else:
            validations = {
                "nominal": calibration.trust.nominal_cross_validation,
                "calibrated": calibration.cross_validation,
            }
            if calibration.non_geometric is not None:
                validations["non_geometric"] = calibration.non_geometric.cross_validation
            for name, validation in validations.items():
                if validation is not None:
                    others[name] = validation.errors_without_outliers
        by_robot = {}
        for name, errors in others.items():
            by_robot[name] = {unit: errors[unit].rms for unit in zeros.errors}
        return cls(
            rows=zeros.rows,
            nominal=by_robot["nominal"],
            zeros={unit: errors.rms() for unit, errors in zeros.errors.items()},
            rounded={unit: errors.rms(rounded.rounding) for unit, errors in zeros.errors.items()},
            calibrated=by_robot["calibrated"],
            non_geometric=by_robot.get("non_geometric"),
        )

    @property
    def is_no_better(self) -> bool:
        """True if the rounded zeros make the robot no better than it was, in the first unit that was measured.

        False if no row shows it, ``zeros`` being empty, or if the nominal robot could not be evaluated.
        """
        unit = next(iter(self.zeros), "")
        return unit in self.zeros and self.rounded[unit] >= self.nominal[unit]


def check_improvement(rms_errors: RmsErrors, path: Path, *, accept: bool) -> None:
    """Refuse zeros that make the robot no better, unless that is accepted.

    Args:
        rms_errors: The errors with them and without.
        path: The file to write, for the message.
        accept: Whether to write them anyway.

    Raises:
        VerdictError: They are no better than none, and ``accept`` is False.
    """
    if accept or not rms_errors.is_no_better:
        return
    symbol = next(iter(rms_errors.zeros))
    unit = RESIDUAL_UNITS[symbol]
    sizes = [
        f"{unit.to_shown * by_robot[symbol]:.{unit.digits}f} {unit.shown}"
        for by_robot in (rms_errors.rounded, rms_errors.nominal, rms_errors.calibrated)
    ]
    raise VerdictError(
        f"{path}: joint zeros alone are no better than the nominal robot: the rms error of {rms_errors.rows} rows is "
        f"{sizes[0]} with them, rounded, {sizes[1]} without, and {sizes[2]} by the whole calibration. So nothing was "
        "written; use the whole calibration (calib convert --to dh, calib compensate). To write them all the same, add "
        "--accept (in Python accept=True)."
    )


# In words


def zeros_text(stored: StoredNumber, conversion: Conversion) -> list[str]:
    """Word the joint zeros of a result as a conversion wrote them, in mm and deg and as the controller stores them.

    Args:
        stored: Number, sign and unit in which the controller stores a zero.
        conversion: The conversion.

    Returns:
        Paragraphs: how the zeros are meant, a table of them, and one of the errors with them.
    """
    rounded = RoundedZeros.of(conversion.source, stored.with_ticks(conversion.options.ticks))
    rms_errors = RmsErrors.of(conversion.source.require_calibration(), rounded)
    meaning = (
        "The best joint zeros if nothing else of the robot is corrected. While the robot stands still, the reading of "
        "each joint must go up by its zero (down if it is negative). After that taught points and the rest of this "
        "result are no longer valid: measure again."
    )

    key = rounded.stored.key
    columns = [
        name_column("Joint"),
        Column("zero", 12, gap=2),
        Column("std", 10),
        Column("", 3, left=True),
        Column("to add" if key == "change" else f"change of {key}", 12, gap=2),
        Column("", 5, left=True),
    ]
    zeros = rounded.zeros
    rows = []
    for k, (name, unit) in enumerate(zip(zeros.joints, rounded.units, strict=True)):
        factor, symbol = joint_unit(prismatic=bool(rounded.prismatic[k]))
        if not zeros.determined[k]:
            rows.append([name, "not determined", "", "", "leave as it is", ""])
            continue
        delta = number(factor * zeros.delta[k], _DIGITS, "+")
        std = number(factor * zeros.std[k], _DIGITS)
        change = number(rounded.numbers[k], unit.decimals, "+")
        rows.append([name, delta, std, symbol, change, unit.name])
    table_of_zeros = table_lines(columns, rows)

    units = list(rms_errors.zeros)
    columns = [name_column(f"Rms error of {_ROWS[rms_errors.rows]}")]
    columns += [Column(f"[{RESIDUAL_UNITS[symbol].shown}]", 10) for symbol in units]
    robots: list[tuple[str, Mapping[str, float] | None]] = [
        ("nominal robot", rms_errors.nominal),
        ("joint zeros alone", rms_errors.zeros),
        ("joint zeros alone, rounded as written", rms_errors.rounded),
        ("whole calibration", rms_errors.calibrated),
        ("with the non-geometric model", rms_errors.non_geometric),
    ]
    rows = []
    for name, errors in robots:
        if errors is not None:
            rows.append([name, *(shown(errors[symbol], symbol) for symbol in units)])
    return [fill(meaning), "\n".join(table_of_zeros), "\n".join(table_lines(columns, rows))]
