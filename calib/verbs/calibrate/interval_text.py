"""Intervals of parameters by the bootstrap and by profiles of the cost, beside those of the covariance."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from calib.model.families import unit_of
from calib.model.parameters import FRAME
from calib.result.calibration import Calibration
from calib.result.fitted_model import ParameterEstimate
from calib.show.lines import mm, number
from calib.show.tables import Column, name_column, table_lines

if TYPE_CHECKING:
    from calib.verbs.calibrate.uncertainty import Bootstrap, Profile

_DEG = math.degrees(1.0)

#: Probability that an interval holds the true value.
LEVEL = 0.95


def bootstrap_text(result: Calibration, bootstrap: Bootstrap) -> str:
    """Write the bootstrap's intervals beside those of the covariance.

    Those of frames are not shown: their parameters count from where registration put the frame.

    Args:
        result: The result.
        bootstrap: Its bootstrap.

    Returns:
        A table of intervals, and the spread of predicted positions.
    """
    rows = []
    ends = bootstrap.intervals(LEVEL).tolist()
    parameters = zip(bootstrap.parameters, ends, result.model.parameters, strict=True)
    for estimate, (low, high), parameter in parameters:
        if parameter.family != FRAME:
            rows.append((estimate, low, high))
    lines = [
        f"Bootstrap: {len(bootstrap.x)} samples of whole poses, seed {bootstrap.seed}",
        *_interval_table(rows, "bootstrap"),
        f"Predicted positions spread by {mm(bootstrap.measured_rms)} mm rms at the measured poses and "
        f"{mm(bootstrap.everywhere_rms)} mm",
        f"over the joint limits; by the covariance {mm(result.geometry.expected_measured)} mm and "
        f"{mm(result.geometry.expected_everywhere)} mm.",
    ]
    if bootstrap.stopped:
        lines.append(f"The solver did not converge on {bootstrap.stopped} of the samples.")
    return "\n".join(lines)


def profile_text(profiles: list[tuple[ParameterEstimate, Profile]]) -> str:
    """Write intervals by the profile of the cost beside those of the covariance."""
    rows = [(estimate, profile.low, profile.high) for estimate, profile in profiles]
    return "\n".join(["Profile of the cost", *_interval_table(rows, "profile")])


def _interval_table(rows: list[tuple[ParameterEstimate, float, float]], method: str) -> list[str]:
    """Write a table of parameters, each with the covariance's interval and that of another method, in SI units."""
    columns = [
        name_column("95 % intervals"),
        Column("value", 10, gap=2),
        Column("covariance", 23),
        Column(method, 23),
        Column("", left=True),
    ]
    cells = []
    for p, low, high in rows:
        factor, unit = (_DEG, "deg") if p.unit == "rad" else unit_of(p.unit).shown
        covariance = "at bound" if p.at_bound else _interval(factor * p.low, factor * p.high)
        other = _interval(factor * low, factor * high)
        cells.append((p.name, _end(factor * p.value), covariance, other, unit))
    return table_lines(columns, cells)


def _interval(low: float, high: float) -> str:
    """Format an interval."""
    return f"{_end(low):>9} .. {_end(high):>10}"


def _end(value: float) -> str:
    """Format an end of an interval; one that is not finite is open."""
    return number(value) if math.isfinite(value) else "open"


def bootstrap_table(bootstrap: Bootstrap) -> dict[str, Any]:
    """Bootstrap as nested tables of plain values in SI units, for the result file."""
    parameters = []
    ends = bootstrap.intervals(LEVEL)
    for p, std, (low, high) in zip(bootstrap.parameters, bootstrap.std, ends, strict=True):
        parameters.append({"name": p.name, "unit": p.unit, "std": std, "low": low, "high": high})
    return {
        "samples": len(bootstrap.x),
        "seed": bootstrap.seed,
        "stopped": bootstrap.stopped,
        "level": LEVEL,
        "parameters": parameters,
        "expected": {
            "measured_rms_m": bootstrap.measured_rms,
            "everywhere_rms_m": bootstrap.everywhere_rms,
        },
    }
