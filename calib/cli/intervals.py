"""What ``calib fit --bootstrap`` and ``--profile`` add: tables to print, and their part of the result file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from calib.identify.findings import ParameterEstimate
    from calib.identify.resampling import Profile
    from calib.identify.result import Calibration
    from calib.identify.uncertainty import Bootstrap

#: Probability that an interval holds the true value.
LEVEL = 0.95

#: A parameter with a longer name gets a line for its name alone.
_LONGEST_NAME = 34

#: An end of an interval takes this many columns.
_NUMBER = 10


def bootstrap_text(result: Calibration, found: Bootstrap) -> str:
    """The bootstrap's intervals beside those of the covariance.

    Those of a frame are left out: its parameters count from where registration put it.
    """
    from calib.model.parameters import FRAME

    own = [parameter.family != FRAME for parameter in result.model.parameters]
    rows = [
        (p, low, high)
        for p, (low, high), shown in zip(found.parameters, found.intervals(LEVEL), own, strict=True)
        if shown
    ]
    lines = [
        f"Bootstrap: {len(found.x)} samples of whole poses, seed {found.seed}",
        *_interval_table(rows, "bootstrap"),
        f"Predicted positions spread by {1e3 * found.measured_rms:.3f} mm rms at the measured poses and "
        f"{1e3 * found.everywhere_rms:.3f} mm",
        f"over the joint limits; by the covariance {1e3 * result.expected_measured:.3f} mm and "
        f"{1e3 * result.expected_everywhere:.3f} mm.",
    ]
    if found.stopped:
        lines.append(f"The solver did not converge on {found.stopped} of the samples.")
    return "\n".join(lines)


def profile_text(profiles: list[tuple[ParameterEstimate, Profile]]) -> str:
    """Intervals by the profile of the cost beside those of the covariance."""
    rows = [(p, found.low, found.high) for p, found in profiles]
    return "\n".join(["Profile of the cost", *_interval_table(rows, "profile")])


def bootstrap_table(found: Bootstrap) -> dict[str, Any]:
    """The bootstrap as nested tables of plain values, for the result file."""
    ends = found.intervals(LEVEL)
    return {
        "samples": len(found.x),
        "seed": found.seed,
        "stopped": found.stopped,
        "level": LEVEL,
        "parameters": [
            {"name": p.name, "unit": p.unit, "std": std, "low": low, "high": high}
            for p, std, (low, high) in zip(found.parameters, found.std, ends, strict=True)
        ],
        "expected": {
            "measured_rms_m": found.measured_rms,
            "everywhere_rms_m": found.everywhere_rms,
        },
    }


def profile_table(profiles: list[tuple[ParameterEstimate, Profile]]) -> list[dict[str, Any]]:
    """The profiles as plain values, for the result file; an open end is missing."""
    return [
        {"name": p.name, "unit": p.unit, "level": found.level, "low": found.low, "high": found.high}
        for p, found in profiles
    ]


def _interval_table(rows: list[tuple[ParameterEstimate, float, float]], what: str) -> list[str]:
    """One line a parameter: its value, the covariance's interval, and another one."""
    width = min(max([len(p.name) for p, *_ in rows] + [len("95 % intervals")]), _LONGEST_NAME) + 2
    pair = 2 * _NUMBER + 4
    lines = [f"{'95 % intervals':<{width}}{'value':>{_NUMBER}}{'covariance':>{pair}}{what:>{pair}}"]
    for p, low, high in rows:
        factor, unit = _shown(p.unit)
        name = p.name
        if len(name) > _LONGEST_NAME:
            lines.append(name)
            name = ""
        ends = [
            f"{_end(factor * a):>{_NUMBER}} .. {_end(factor * b):>{_NUMBER}}"
            for a, b in ((p.low, p.high), (low, high))
        ]
        if p.at_bound:
            ends[0] = f"{'at bound':>{pair}}"
        lines.append(f"{name:<{width}}{_end(factor * p.value):>{_NUMBER}}{''.join(ends)} {unit}")
    return lines


def _end(value: float) -> str:
    """An end of an interval: three digits after the point."""
    return f"{round(value, 3) + 0.0:.3f}" if np.isfinite(value) else "open"


def _shown(unit: str) -> tuple[float, str]:
    """The factor to a unit for a person, as the parameters are shown in, and that unit."""
    from calib.families import unit_of

    return (float(np.degrees(1.0)), "deg") if unit == "rad" else unit_of(unit).shown
