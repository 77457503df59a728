"""Evaluations as nested tables, in SI units, for JSON files; the keys are in docs/result-json.md."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from calib.basics.dates import date_text, now
from calib.result.board_errors import board_table
from calib.result.calibration_file import drift_table, error_table, pose_table, versions
from calib.uncertainty.forecast import FreshRows
from calib.verbs.evaluate.acceptance import Acceptance, Assessment
from calib.verbs.evaluate.accuracy import Accuracy
from calib.verbs.evaluate.characteristics import Characteristic


def assessment_table(e: Assessment) -> dict[str, Any]:
    """Return an evaluation as nested tables, in SI units, as in the file; see docs/result-json.md."""
    urdf, acceptance = e.evaluations["urdf"], e.accepted
    m, setup, robot = urdf.measurements, urdf.setup, urdf.robot
    frames = zip(setup.groups, setup.T_frame_base, strict=True)
    targets = zip(setup.targets, setup.T_tip_target, strict=True)
    accepted = None
    if acceptance is not None:
        accepted = {"robot": e.judged, **acceptance_table(acceptance)}
    # By the robot, and by the set of rows: estimation, validation, all.
    errors: dict[str, dict[str, Any]] = {}
    for who, evaluation in e.evaluations.items():
        errors[who] = {name: error_table(of_set) for name, of_set in evaluation.errors.items()}
        figures = evaluation.images
        if figures is not None:
            errors[who]["images"] = {
                "images": figures.images,
                "corners": figures.corners,
                "mean_px": figures.mean,
                "p95_px": figures.p95,
                "max_px": figures.largest,
                "bias_u_px": figures.bias[0],
                "bias_v_px": figures.bias[1],
                "mean_at_board_m": figures.mean_at_board,
                "p95_at_board_m": figures.p95_at_board,
                "max_at_board_m": figures.largest_at_board,
                "board": None if figures.board is None else board_table(figures.board),
            }
    read = {"name": m.source, "sha256": m.sha256, "orientation": m.orientation or None}
    return {
        "schema": "evaluation 4",  # a word, so that it is not taken for a result's
        "robot": {"name": robot.name, "base": robot.base, "tip": robot.tip},
        "frames": {
            **pose_table(setup.T_frame_base[0], "frame_base_"),
            "target_m": setup.T_tip_target[0, :3, 3],
            "registered": list(urdf.registered),
            "set_ups": [{"group": name, **pose_table(T, "frame_base_")} for name, T in frames],
            "targets": [{"target": name, **pose_table(T)} for name, T in targets],
        },
        "errors": errors,
        "inputs": {
            "urdf": {"name": robot.urdf.source, "sha256": robot.urdf.sha256},
            "measurements": {**read, "rows": len(m)},
        },
        "versions": versions(),
        "accuracy": {
            who: accuracy_table(of_who, e.characteristics[who])
            for who, of_who in e.accuracies.items()
        },
        "drift": None if urdf.drift is None else drift_table(urdf.drift),
        "acceptance": accepted,
        "forecast": None if e.fresh is None else fresh_table(e.fresh),
        "record": asdict(urdf.record),
        "time": date_text(now()),
    }


def accuracy_table(
    accuracy: Accuracy, characteristics: Sequence[Characteristic] = ()
) -> dict[str, Any]:
    """Return accuracy, repeatability and further characteristics of one robot, in SI units."""
    low, high = accuracy.repeats
    figures = {unit: accuracy.figures(unit) for unit in accuracy.units}
    poses = []
    for pose in accuracy.poses:
        by_unit = {unit: asdict(of_unit) for unit, of_unit in pose.by_unit.items()}
        names = {"rows": pose.rows, "kind": pose.kind, "group": pose.group, "target": pose.target}
        poses.append(names | by_unit)
    return {
        "rows": accuracy.rows,
        "measured": accuracy.measured,
        "fitted": accuracy.fitted,
        "seen": accuracy.seen,
        "repeats_min": low,
        "repeats_max": high,
        **figures,
        "U": {
            unit: {"rows": known, "within": known - len(beyond), "beyond": beyond}
            for unit, known in accuracy.known.items()
            for beyond in [accuracy.beyond[unit]]
        },
        "characteristics": [asdict(characteristic) for characteristic in characteristics],
        "poses": poses,
    }


def acceptance_table(a: Acceptance) -> dict[str, Any]:
    """Return an acceptance test in SI units: outcome, criterion, and the check in each unit that has a tolerance."""
    table: dict[str, Any] = {
        "outcome": a.outcome,
        "criterion": a.criterion,
        "within": a.within,
        "share": a.share,
    }
    for unit, check in a.checks.items():
        table[unit] = {
            "figure": check.figure,
            "tolerance": check.tolerance,
            "uncertainty": check.uncertainty,
            "held": check.held,
            "factor": check.factor,
            "outcome": check.outcome,
        }
    return table


def fresh_table(fresh: FreshRows) -> dict[str, Any]:
    """Return fresh rows beside their forecast, in SI units."""
    return {
        "rows": int(fresh.forecast.rows),
        "outliers": fresh.outliers,
        "found": fresh.rms,
        "probability": fresh.probability,
        "within": fresh.within,
        "forecast": fresh.forecast.table(),
    }
