"""Rms errors with joint zeros alone, beside those of the nominal robot and of the whole calibration: the same rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from calib.basics.channels import RESIDUAL_UNITS
from calib.basics.values import Value, keep_read_only
from calib.errors import VerdictError
from calib.numerics.errors import Errors
from calib.result.calibration import Calibration
from calib.result.joint_zeros import HELD_OUT
from calib.verbs.convert.zeros.rounding import RoundedZeros


@dataclass(frozen=True, slots=True, eq=False)
class RmsErrors(Value):
    """Rms errors of the same rows by several robots, by the symbol of each unit that was measured."""

    #: Which rows: `calib.result.joint_zeros.HELD_OUT` (outliers aside), ``VALIDATION`` or ``ESTIMATION``
    rows: str
    #: By the nominal robot
    nominal: Mapping[str, float]
    #: With the zeros as fitted
    zeros: Mapping[str, float]
    #: With the zeros as rounded, target and frame as with those fitted
    rounded: Mapping[str, float]
    #: By the whole calibration that a URDF holds
    calibrated: Mapping[str, float]
    #: By the non-geometric model; None where there is none
    non_geometric: Mapping[str, float] | None

    def __post_init__(self) -> None:
        """Keep read-only copies of the mappings."""
        keep_read_only(self, "nominal", "zeros", "rounded", "calibrated", "non_geometric")

    @classmethod
    def of(cls, calibration: Calibration, rounded: RoundedZeros) -> RmsErrors:
        """Compare the errors of a calibration's robots.

        Args:
            calibration: The calibration.
            rounded: Its zeros, rounded.
        """
        zeros = rounded.zeros
        others = _errors_of_robots(calibration, zeros.rows)
        by_robot = {
            name: {u: errors[u].rms for u in zeros.errors} for name, errors in others.items()
        }
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
        """True if the robot is no better with the rounded zeros than it was, in the first unit that was measured.

        False where no row can tell, ``zeros`` being empty, or where the nominal robot could not be judged.
        """
        unit = next(iter(self.zeros), "")
        return unit in self.zeros and self.rounded[unit] >= self.nominal[unit]


def _errors_of_robots(calibration: Calibration, rows: str) -> dict[str, Errors]:
    """Return the errors of the nominal robot, of the calibrated one, and of the non-geometric model if there is one.

    Args:
        calibration: The calibration.
        rows: Of which rows, see `RmsErrors.rows`.
    """
    if rows != HELD_OUT:
        return {name: errors[rows] for name, errors in calibration.errors.items()}
    validations = {
        "nominal": calibration.trust.nominal_cross_validation,
        "calibrated": calibration.cross_validation,
    }
    if calibration.non_geometric is not None:
        validations["non_geometric"] = calibration.non_geometric.cross_validation
    return {name: v.errors_without_outliers for name, v in validations.items() if v is not None}


def check_improvement(rms_errors: RmsErrors, path: Path, *, accept: bool) -> None:
    """Refuse zeros with which the robot is no better than without, unless that is accepted.

    Args:
        rms_errors: The errors with them and without.
        path: The file to write, for the message.
        accept: Whether to write them all the same.

    Raises:
        VerdictError: They are no better than none, and ``accept`` is False.
    """
    if rms_errors.is_no_better and not accept:
        raise VerdictError(_refusal(rms_errors, path))


def _refusal(rms_errors: RmsErrors, path: Path) -> str:
    """Word that zeros alone are no better than none."""
    symbol = next(iter(rms_errors.zeros))
    unit = RESIDUAL_UNITS[symbol]
    sizes = [
        f"{unit.to_shown * by_robot[symbol]:.{unit.digits}f} {unit.shown}"
        for by_robot in (rms_errors.rounded, rms_errors.nominal, rms_errors.calibrated)
    ]
    return (
        f"{path}: joint zeros alone are no better than the nominal robot: the rms error of {rms_errors.rows} rows is "
        f"{sizes[0]} with them, rounded, {sizes[1]} without, and {sizes[2]} by the whole calibration. So nothing was "
        "written; use the whole calibration (calib convert --to dh, calib compensate). To write them all the same, add "
        "--accept (in Python accept=True)."
    )
