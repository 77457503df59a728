"""What `calib evaluate --json` writes: errors, accuracy, acceptance as nested tables in SI units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from calib.identify.acceptance import Acceptance, Check
from calib.identify.acceptance_text import acceptance_reasons
from calib.identify.accuracy import Accuracy
from calib.identify.evaluation import Evaluation
from calib.identify.result_fields import ERRORS, pose_table, versions

#: The layout; a word, so that it is not taken for a result's.
EVALUATION_SCHEMA = "evaluation 1"


def evaluation_table(
    as_it_is: Evaluation,
    corrected: Evaluation | None = None,
    larger: Evaluation | None = None,
    nominal: Evaluation | None = None,
) -> dict[str, Any]:
    """What `calib evaluate` found, as nested tables.

    Args:
        as_it_is: Of the robot as its URDF is.
        corrected: Of the robot with a result's joint origins.
        larger: Of the robot with a result's larger model.
        nominal: Of the robot that a result began with.
    """
    e, m = as_it_is, as_it_is.measurements
    every = {"nominal": nominal, "urdf": e, "calibration": corrected, "larger": larger}
    results = {who: result for who, result in every.items() if result is not None}
    return {
        "schema": EVALUATION_SCHEMA,
        "robot": {"name": e.robot.name, "base": e.robot.base, "tip": e.robot.tip},
        "frames": {
            **pose_table(e.T_frame_base, "frame_base_"),
            "target_m": e.target,
            "registered": list(e.registered),
            "set_ups": [
                {"group": group, **pose_table(T, "frame_base_")}
                for group, T in zip(e.setup.groups, e.setup.T_frame_base, strict=True)
            ],
            "targets": [
                {"target": name, **pose_table(T)}
                for name, T in zip(e.setup.targets, e.setup.T_tip_target, strict=True)
            ],
        },
        "errors": {
            who: {name: ERRORS.table(errors) for name, errors in result.errors.items()}
            for who, result in results.items()
        },
        "inputs": {
            "urdf": {"name": e.robot.urdf.source, "sha256": e.robot.urdf.sha256},
            "measurements": {"name": m.source, "sha256": m.sha256, "rows": len(m)},
        },
        "versions": versions(),
    }


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
