"""Bootstrap and profile intervals beside those of the covariance."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from calib.result.calibration import Calibration
    from calib.result.prediction import ParameterEstimate
    from calib.result.uncertainty import Bootstrap, Profile


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
    from calib.model.kinematics import FRAME

    own = [parameter.family != FRAME for parameter in result.model.parameters]
    ends = found.intervals(LEVEL).tolist()
    rows = [(p, *pair) for p, pair, shown in zip(found.parameters, ends, own, strict=True) if shown]
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


def _interval_table(rows: list[tuple[ParameterEstimate, float, float]], what: str) -> list[str]:
    """One line a parameter: its value, the covariance's interval, and another one; in mm, deg and so on."""
    from calib.model.families import unit_of

    width = min(max([len(p.name) for p, *_ in rows] + [len("95 % intervals")]), _LONGEST_NAME) + 2
    pair = 2 * _NUMBER + 4
    lines = [f"{'95 % intervals':<{width}}{'value':>{_NUMBER}}{'covariance':>{pair}}{what:>{pair}}"]
    for p, low, high in rows:
        factor, unit = (math.degrees(1.0), "deg") if p.unit == "rad" else unit_of(p.unit).shown
        name = p.name
        if len(name) > _LONGEST_NAME:
            lines.append(name)
            name = ""
        value, *ends = (
            f"{round(factor * v, 3) + 0.0:.3f}" if math.isfinite(v) else "open"
            for v in (p.value, p.low, p.high, low, high)
        )
        cells = [f"{a:>{_NUMBER}} .. {b:>{_NUMBER}}" for a, b in (ends[:2], ends[2:])]
        if p.at_bound:
            cells[0] = f"{'at bound':>{pair}}"
        lines.append(f"{name:<{width}}{value:>{_NUMBER}}{''.join(cells)} {unit}")
    return lines


def bootstrap_table(found: Bootstrap) -> dict[str, Any]:
    """The bootstrap as nested tables of plain values, for the result file."""
    return {
        "samples": len(found.x),
        "seed": found.seed,
        "stopped": found.stopped,
        "level": LEVEL,
        "parameters": [
            {"name": p.name, "unit": p.unit, "std": std, "low": low, "high": high}
            for p, std, (low, high) in zip(
                found.parameters, found.std, found.intervals(LEVEL), strict=True
            )
        ],
        "expected": {
            "measured_rms_m": found.measured_rms,
            "everywhere_rms_m": found.everywhere_rms,
        },
    }
