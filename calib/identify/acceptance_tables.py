"""Accuracy and acceptance as nested tables: SI units, with the unit in each key; see docs/result-json.md."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from calib.identify.acceptance import Acceptance, Check
from calib.identify.acceptance_text import acceptance_reasons
from calib.identify.accuracy import Accuracy


def accuracy_table(found: Mapping[str, Accuracy]) -> dict[str, Any]:
    """Accuracy and repeatability of several robots as nested tables."""
    return {who: _accuracy_table(one) for who, one in found.items()}


def acceptance_table(
    a: Acceptance, who: str, judged: str, notes: Sequence[str] = ()
) -> dict[str, Any]:
    """An acceptance as nested tables.

    Args:
        a: The acceptance.
        who: The key of the robot that was judged.
        judged: What it is called.
        notes: What else must be minded.
    """
    return {
        "outcome": a.outcome,
        "robot": who,
        "criterion": a.criterion,
        "within": a.within,
        "share": a.share,
        "length": None if a.length is None else _check_table(a.length, "m"),
        "angle": None if a.angle is None else _check_table(a.angle, "rad"),
        "reasons": acceptance_reasons(a, judged, notes),
    }


def _accuracy_table(one: Accuracy) -> dict[str, Any]:
    """Of one robot."""
    low, high = one.repeats
    table: dict[str, Any] = {
        "rows": one.rows,
        "measured": one.measured,
        "fitted": one.fitted,
        "seen": one.seen,
        "repeats_min": low,
        "repeats_max": high,
    }
    for unit, ap, rp, single in (
        ("m", one.ap, one.rp, one.single),
        ("rad", one.ap_angle, one.rp_angle, one.single_angle),
    ):
        table |= {
            f"ap_max_{unit}": ap.max() if len(ap) else np.nan,
            f"ap_mean_{unit}": ap.mean() if len(ap) else np.nan,
            f"rp_max_{unit}": rp.max() if len(rp) else np.nan,
            f"rp_mean_{unit}": rp.mean() if len(rp) else np.nan,
            f"single_max_{unit}": single.max() if len(single) else np.nan,
        }
    table["poses"] = [
        {
            "rows": list(pose.rows),
            "kind": pose.kind,
            "group": pose.group,
            "target": pose.target,
            "ap_m": pose.ap,
            "ap_xyz_m": pose.ap_xyz,
            "rp_m": pose.rp,
            "single_m": pose.single,
            "ap_rad": pose.ap_angle,
            "ap_abc_rad": pose.ap_abc,
            "rp_abc_rad": pose.rp_abc,
            "single_rad": pose.single_angle,
        }
        for pose in one.poses
    ]
    return table


def _check_table(check: Check, unit: str) -> dict[str, Any]:
    """One check."""
    return {
        f"figure_{unit}": check.figure,
        f"tolerance_{unit}": check.tolerance,
        f"uncertainty_{unit}": check.uncertainty,
        f"random_{unit}": check.random,
        f"held_{unit}": check.held,
        "factor": check.factor,
        "outcome": check.outcome,
    }
