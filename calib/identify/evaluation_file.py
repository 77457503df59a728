"""What `calib evaluate --json` writes of errors, as nested tables; see docs/result-json.md."""

from __future__ import annotations

from typing import Any

from calib.identify.evaluation import Evaluation
from calib.identify.result_tables import errors_table, pose_table, versions

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
            who: {name: errors_table(errors) for name, errors in result.errors.items()}
            for who, result in results.items()
        },
        "inputs": {
            "urdf": {"name": e.robot.urdf.source, "sha256": e.robot.urdf.sha256},
            "measurements": {"name": m.source, "sha256": m.sha256, "rows": len(m)},
        },
        "versions": versions(),
    }
