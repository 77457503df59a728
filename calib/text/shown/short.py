"""Results in one line, as Python shows them; what they say of errors, the tables for notebooks say too."""

from __future__ import annotations

from calib.design.plan import PlanValues
from calib.numerics.errors import Errors
from calib.result.calibration import CalibrationValues
from calib.result.evaluation import EvaluationValues
from calib.robot.robot import Robot
from calib.text.layout.lines import listed, mm, plural
from calib.text.layout.sizes import with_unit
from calib.values.short import one_line


def calibration_line(c: CalibrationValues) -> str:
    """Write a calibration in one line: robot, verdict, error before and after, rows."""
    verdict = "no verdict" if c.verdict is None else c.verdict.use
    where, before, after = before_and_after(c)
    errors = f"{where} rms {rms_text(before)} to {rms_text(after)}"
    return one_line("Calibration", _chain(c.nominal), verdict, errors, plural(len(c.rows), "row"))


def evaluation_line(e: EvaluationValues) -> str:
    """Write an evaluation in one line: robot, error, rows."""
    errors = e.errors["all"]
    count = plural(len(e.measurements), "row")
    return one_line("Evaluation", _chain(e.robot), f"rms {rms_text(errors)}", count)


def plan_line(p: PlanValues) -> str:
    """Write a plan in one line: robot, poses, expected error."""
    count = len(p.estimation)
    poses = f"{plural(count, 'pose')} and {len(p.joints) - count} for validation"
    return one_line("Plan", _chain(p.robot), poses, f"expected rms {mm(p.forecast.rms)} mm")


def before_and_after(c: CalibrationValues) -> tuple[str, Errors, Errors]:
    """Return the errors of the nominal and of the calibrated robot that say most.

    Args:
        c: The result.

    Returns:
        Which rows they are of, ``"held-out"``, ``"validation"`` or ``"fitted"``; and the errors of both robots, of the
        geometry alone and without outliers.
    """
    before, after = c.nominal_cross_validation, c.cross_validation
    if before is not None and after is not None:
        return "held-out", before.errors_without_outliers, after.errors_without_outliers
    nominal, calibrated = c.errors["nominal"], c.errors["calibrated"]
    name, rows = "fitted", "estimation"
    if c.rows.validation.any():
        name, rows = "validation", "validation"
    return name, nominal[rows], calibrated[rows]


def rms_text(errors: Errors) -> str:
    """Word the rms error of some rows in each unit that was measured; a dash without any."""
    return listed([with_unit(errors[unit].rms, unit) for unit in errors.units]) or "-"


def _chain(robot: Robot) -> str:
    """Name a robot and its chain."""
    return f"'{robot.name}', {robot.base} to {robot.tip}"
