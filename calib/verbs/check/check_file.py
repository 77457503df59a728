"""Checks as nested tables, in SI units, for JSON files; the keys are in docs/check.md."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from calib.basics.dates import date_text, now
from calib.result.calibration_file import versions, write_table
from calib.verbs.check.check import CheckResult
from calib.verbs.check.poses import CheckPoses

SCHEMA = "check 1"


def check_table(c: CheckResult, more: CheckPoses | None = None) -> dict[str, Any]:
    """Return a check as nested tables, in SI units, as in the file.

    Args:
        c: The check.
        more: Poses that would decide between the causes; None: they were not sought.
    """
    causes = []
    for finding in c.findings:
        entry: dict[str, Any] = {
            "code": finding.code,
            "name": finding.name,
            "probability": finding.probability,
            f"size_{finding.unit}": finding.size,
            f"size_std_{finding.unit}": finding.size_std,
            "turn_rad": finding.turn,
            "change_m": finding.change,
            "change_std_m": finding.change_std,
        }
        if finding.rows:
            entry |= {"rows": list(finding.rows), "image": finding.image}
        causes.append(entry)
    further = None
    if more is not None:
        further = {"needed": more.needed, "decide": list(more.probabilities), "joints": more.joints}
    return {
        "schema": SCHEMA,
        "outcome": c.outcome,
        "p_value": c.p_value,
        "nothing": c.nothing,
        "named": [[finding.code, finding.name] for finding in c.named],
        "causes": causes,
        "stops": c.stops,
        "numbers": c.numbers,
        "ratio": c.ratio,
        "expected_m": c.expected,
        "tolerance_m": c.tolerance,
        "matters": c.matters,
        "noticed": [
            {"code": one.code, "name": one.name, "shift_m": one.shift, "turn_rad": one.turn}
            for one in c.noticed
        ],
        "further": further,
        "run": c.result.run,
        "versions": versions(),
        "time": date_text(now()),
    }


def write_check(
    c: CheckResult, path: str | Path, more: CheckPoses | None = None, *, overwrite: bool = False
) -> Path:
    """Write a check as JSON; a number that is not finite is null.

    Args:
        c: The check.
        path: The file.
        more: As of `check_table`.
        overwrite: Whether an existing file is replaced.

    Returns:
        The path.

    Raises:
        FileError: The file exists, or cannot be written.
    """
    return write_table(check_table(c, more), path, overwrite=overwrite)
