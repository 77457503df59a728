"""Certificates as nested tables, in SI units, for JSON files; the keys are in docs/certificate.md."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from calib.result.calibration_file import versions, write_table
from calib.uncertainty.coverage import PROBABILITY
from calib.verbs.certificate.certificate import Certificate, Decision
from calib.verbs.certificate.points import Deviation, Point

#: The file's schema: a word, so that it is not taken for a result's.
SCHEMA = "certificate 1"


def write_certificate(c: Certificate, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write a certificate as JSON; see `Certificate.write_json`."""
    return write_table(certificate_table(c), path, overwrite=overwrite)


def certificate_table(c: Certificate) -> dict[str, Any]:
    """Return a certificate as nested tables, in SI units, as in the file."""
    result, m = c.calibration, c.measurements
    non_geometric = c.assessment.judged == "non_geometric"
    verdict = result.verdict_on(non_geometric=non_geometric)
    budget = c.budget
    return {
        "schema": SCHEMA,
        "id": c.id,
        "time": c.time,
        "outcome": c.outcome,
        "record": asdict(c.record),
        "item": {
            "robot": result.nominal.name,
            "base": result.nominal.base,
            "tip": result.nominal.tip,
            "model": result.part(non_geometric=non_geometric).model.name,
            "non_geometric": non_geometric,
            "urdf": result.nominal.urdf.source,
            "sha256_nominal": result.nominal.urdf.sha256,
            "sha256_corrected": result.robot.urdf.sha256,
        },
        "inputs": {
            "result": {"name": c.files.result, "sha256": c.files.result_sha256, "run": result.run},
            "calibrated_from": {"name": result.source.name, "sha256": result.source.sha256},
            "measurements": {"name": m.source, "sha256": m.sha256, "fresh": c.is_fresh},
        },
        "coverage_probability": PROBABILITY,
        "stated_uncertainty": dict(c.stated),
        "points": [_point(point) for point in c.points],
        "budget": {
            "lines": [
                {
                    "source": line.source.value,
                    "position_std_m": line.position_std,
                    "orientation_std_rad": line.orientation_std,
                    "distribution": line.distribution.value,
                    "freedom": line.freedom,
                    "share": line.share,
                }
                for line in budget.lines
            ],
            "position_std_m": budget.position_std,
            "orientation_std_rad": budget.orientation_std,
            "position_expanded_m": budget.position,
            "orientation_expanded_rad": budget.orientation,
            "coverage_factor": budget.factor,
            "freedom": budget.freedom,
        },
        "decisions": {unit: _decision(decision) for unit, decision in c.decisions.items()},
        "validity": {
            "joints": [asdict(one) for one in c.box],
            "load": c.record.load,
            "temperature_C": c.record.temperature_C,
            "until": c.record.valid_until,
        },
        "not_tested": [{"code": gap.code.value, **gap.values} for gap in c.gaps],
        "verdict": {
            "use": None if verdict is None else verdict.use,
            "reasons": [] if verdict is None else [reason.code for reason in verdict.reasons],
        },
        "versions": versions(),
        "command": c.files.command,
    }


def _point(point: Point) -> dict[str, Any]:
    """Return a point: rows, station, target, joint values, place, and its deviations by unit."""
    return {
        "rows": point.rows,
        "group": point.group,
        "target": point.target,
        "joints": point.joints,
        "position_m": point.position,
        **{unit: _deviation(one) for unit, one in point.deviations.items()},
    }


def _deviation(one: Deviation) -> dict[str, float]:
    """Return a deviation by the keys of the file."""
    return {
        "as_found": one.found,
        "as_left": one.left,
        "expanded_uncertainty": one.uncertainty,
        "coverage_factor": one.factor,
        "freedom": one.freedom,
        "expanded_uncertainty_of_pose": one.of_pose,
        "conformance_probability": one.conformance,
    }


def _decision(decision: Decision) -> dict[str, Any]:
    """Return a decision by the keys of the file."""
    check, risks = decision.check, decision.risks
    return {
        "outcome": check.outcome,
        "deviation": check.figure,
        "factor": check.factor,
        "guard_band": check.uncertainty,
        "tolerance": check.tolerance,
        "conformance_probability": decision.conformance,
        "specific_risk": decision.specific_risk,
        "prior_mean": None if decision.prior is None else decision.prior[0],
        "prior_std": None if decision.prior is None else decision.prior[1],
        "global_risk_of_acceptance": None if risks is None else risks.consumer,
        "global_risk_of_rejection": None if risks is None else risks.producer,
    }
