"""A result as its page shows it: the verdict with its reasons, and errors before and after in their units."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from calib.basics.channels import RESIDUAL_UNITS
from calib.numerics.errors import Errors
from calib.result.calibration import Calibration
from calib.show.blocks import Verdict as VerdictBlock
from calib.show.lines import mm
from calib.show.verdict_text import reason_text
from calib.show.words import before_and_after, shown

#: Outliers that are listed; the others are counted.
MOST_OUTLIERS = 12


@dataclass(frozen=True, slots=True)
class ErrorLine:
    """Errors of one robot at some rows, in the unit in which they are shown."""

    #: ``"held-out"``, ``"validation"`` or ``"estimation"``
    rows: str
    #: ``"nominal"`` or ``"calibrated"``
    robot: str
    count: int
    rms: str
    mean: str
    largest: str


@dataclass(frozen=True, slots=True)
class Headline:
    """The most telling error in one unit, before and after."""

    #: ``"held-out"``, ``"validation"`` or ``"fitted"``
    rows: str
    #: Such as ``"mm"``
    unit: str
    before: str
    after: str
    #: Share of the larger one, for a bar [%]
    before_share: float
    after_share: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """Content of the page of a result."""

    result: Calibration
    #: ``"use"``, ``"use with care"``, ``"do not use"``; ``"none"`` without a verdict
    use: str
    #: Class of its colour, and its sign
    shade: str
    sign: str
    #: Its reasons, in English
    reasons: tuple[str, ...]
    headlines: tuple[Headline, ...]
    #: Errors by their units as they are shown
    errors: tuple[tuple[str, tuple[ErrorLine, ...]], ...]
    #: Expected error near the measured poses and over the joint limits [mm]; empty: not known
    near: str
    everywhere: str
    #: Rows that look wrong, with their residual in its unit
    outliers: tuple[tuple[int, str], ...]

    @property
    def is_withheld(self) -> bool:
        """True if no URDF is given out."""
        return self.use == "do not use"


def outcome_of(result: Calibration) -> Outcome:
    """Prepare a result for its page."""
    use = "none" if result.verdict is None else result.verdict.use
    reasons = () if result.verdict is None else tuple(map(reason_text, result.verdict.reasons))
    block = VerdictBlock(use, reasons)
    near = everywhere = ""
    if not result.unknown_accuracy:
        near, everywhere = (mm(value) for value in result.new_point)
    outliers = []
    for outlier in result.rows.outliers:
        sizes = [
            f"{shown(size, unit)} {RESIDUAL_UNITS[unit].shown}"
            for unit, size in outlier.residual.items()
        ]
        outliers.append((outlier.row, ", ".join(sizes)))
    return Outcome(
        result=result,
        use=use,
        shade=block.shade,
        sign=block.sign,
        reasons=reasons,
        headlines=tuple(_headlines(result)),
        errors=tuple(_errors(result)),
        near=near,
        everywhere=everywhere,
        outliers=tuple(outliers),
    )


def _headlines(result: Calibration) -> Iterator[Headline]:
    """Yield the most telling error of each unit."""
    rows, before, after = before_and_after(result)
    for unit in after.units:
        sizes = before[unit].rms, after[unit].rms
        largest = max((size for size in sizes if size == size), default=0.0) or 1.0
        shares = [round(100.0 * size / largest, 1) if size == size else 0.0 for size in sizes]
        texts = [shown(size, unit) for size in sizes]
        yield Headline(rows, RESIDUAL_UNITS[unit].shown, texts[0], texts[1], shares[0], shares[1])


def _errors(result: Calibration) -> Iterator[tuple[str, tuple[ErrorLine, ...]]]:
    """Yield the errors in each unit: of held-out rows first, which say most."""
    sets: list[tuple[str, str, Errors]] = []
    held_out = (result.trust.nominal_cross_validation, result.cross_validation)
    for robot, of_robot in zip(("nominal", "calibrated"), held_out, strict=True):
        if of_robot is not None:
            sets.append(("held-out", robot, of_robot.errors_without_outliers))
    for rows in ("validation", "estimation"):
        sets += [(rows, robot, result.errors[robot][rows]) for robot in ("nominal", "calibrated")]
    units = dict.fromkeys(unit for _, _, errors in sets for unit in errors.units)
    for unit in units:
        lines = []
        for rows, robot, errors in sets:
            of_unit = errors[unit]
            if of_unit.n:
                sizes = (shown(value, unit) for value in (of_unit.rms, of_unit.mean, of_unit.max))
                lines.append(ErrorLine(rows, robot, of_unit.n, *sizes))
        yield RESIDUAL_UNITS[unit].shown, tuple(lines)


def read_outcome(path: Path) -> Outcome:
    """Read a result file for its page; FileError if it is none."""
    return outcome_of(Calibration.read_json(path))
