"""A comparison as nested tables for its JSON file; the keys are documented in docs/comparison.md."""

from __future__ import annotations

from typing import Any

from calib.identify.comparison import Comparison, PlaceDifference
from calib.identify.comparison_text import error_sets, notes, sentence
from calib.identify.drift import LEVEL
from calib.identify.result import Calibration
from calib.identify.result_tables import versions

#: The layout of what `comparison_table` gives; a word, so that it is not taken for a result.
COMPARISON_SCHEMA = "comparison 2"


def comparison_table(c: Comparison) -> dict[str, Any]:
    """The comparison as nested tables of plain values; the keys are documented in docs/comparison.md."""
    t = c.test
    return {
        "schema": COMPARISON_SCHEMA,
        "robot": {"name": c.a.nominal.name, "base": c.a.nominal.base, "tip": c.a.nominal.tip},
        "outcome": c.outcome,
        "sentence": sentence(c),
        "test": {
            "combinations": t.combinations,
            "chi_square": t.chi_square,
            "freedom": t.freedom,
            "p": t.p,
            "sigma": t.sigma,
            "level": LEVEL,
        },
        "moves": [
            {
                "where": m.where,
                "rms_m": m.rms,
                "max_m": m.max,
                "noise_rms_m": m.noise,
                "moved_rms_m": m.moved,
                "moved_std_m": m.std,
                "rms_rad": m.rms_angle,
            }
            for m in c.moves
        ],
        "parameters": [
            {
                "name": p.name,
                "unit": p.unit,
                "a": p.a,
                "b": p.b,
                "difference": p.difference,
                "std": p.std,
                "sigmas": p.sigmas,
                "alone": p.alone,
            }
            for p in c.parameters
        ],
        "untold": list(c.untold),
        "only_a": list(c.only_a),
        "only_b": list(c.only_b),
        "frames": [_place(one, "group") for one in c.frames],
        "targets": [_place(one, "target") for one in c.targets],
        "results": [_result(name, one) for name, one in zip(c.names, (c.a, c.b), strict=True)],
        "notes": list(notes(c)),
        "versions": versions(),
    }


def _place(one: PlaceDifference, key: str) -> dict[str, Any]:
    """How one frame or target moved."""
    return {key: one.name, "found": one.found, "shift_m": one.shift, "turn_rad": one.turn}


def _result(name: str, one: Calibration) -> dict[str, Any]:
    """What was compared."""
    urdf = one.nominal.urdf
    return {
        "name": name,
        "set": one.model.name,
        "verdict": None if one.verdict is None else one.verdict.use,
        "sigma_m": one.sigma,
        "errors": [
            {"rows": rows, "n": e.n, "max_m": e.max, "mean_m": e.mean, "rms_m": e.rms}
            for rows, e in error_sets(one)
        ],
        "inputs": {
            "urdf": {"name": urdf.source, "sha256": urdf.sha256},
            "measurements": {
                "name": one.source.name or "memory",
                "sha256": one.source.sha256,
                "rows": len(one.rows),
            },
        },
    }
