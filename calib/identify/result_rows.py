"""The rows of a result as tables: what each row is, and what the fit and those without it leave over in it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.identify.result import Calibration
from calib.identify.statistics import CrossValidation
from calib.identify.table_fields import Json
from calib.measure.columns import SETS
from calib.model.robot import read_only

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def rows_table(c: Calibration) -> list[dict[str, Any]]:
    """What each row is, and what is left over in it: nominal, calibrated, larger, and left out of the fit."""
    larger = c.larger
    every: list[tuple[str, Array]] = [
        ("nominal", c.residual_nominal),
        ("calibrated", c.residual_calibrated),
    ]
    left: list[tuple[str, CrossValidation | None]] = [
        ("nominal", c.nominal_cross_validation),
        ("calibrated", c.cross_validation),
    ]
    if larger is not None:
        every.append(("larger", larger.residual))
        left.append(("larger", larger.cross_validation))
    seen = np.cumsum(c.rows.estimation) - 1
    names = c.rows
    result = []
    for i, row in enumerate(names.numbers):
        table = {
            "row": row,
            "set": names.sets[i],
            "kind": names.kinds[i],
            "group": names.groups[i],
            "target": names.targets[i],
        }
        for who, residual in every:
            table |= residual_table(who, residual[i], c.used[i])
        if c.cross_validation is not None and names.sets[i] == SETS[0]:
            table["pose"] = c.cross_validation.poses[seen[i]]
            for who, v in left:
                if v is not None:
                    own = v.residual[seen[i]]
                    table |= residual_table(f"left_out_{who}", own, c.used[i])
        result.append({**table, "score": c.scores[i], "weight": c.weights[i]})
    return result


def residual_table(who: str, residual: Array, used: Mask) -> dict[str, Any]:
    """What is left over in one row: lengths, and angles where an orientation was measured."""
    table: dict[str, Any] = {f"residual_{who}_m": residual[:3][used[:3]]}
    if np.any(used[3:]):
        table[f"residual_{who}_rad"] = residual[3:][used[3:]]
    return table


def used_of(rows: Sequence[Json]) -> Mask:
    """Which scalars were measured, shape (N, D): a row's lengths stand in the first columns."""
    lengths = [len(one["residual_nominal_m"]) for one in rows]
    angles = [len(one.get("residual_nominal_rad", ())) for one in rows]
    widths = [
        3 + turned if turned else count for count, turned in zip(lengths, angles, strict=True)
    ]
    used = np.zeros((len(rows), max(widths, default=1)), dtype=bool)
    for i, (count, turned) in enumerate(zip(lengths, angles, strict=True)):
        used[i, :count] = True
        used[i, 3 : 3 + turned] = True
    return used


def residuals_of(rows: Sequence[Json], who: str, used: Mask) -> Array:
    """What is left over, shape (N, D), zero where nothing was measured."""
    result = np.zeros(used.shape)
    for i, one in enumerate(rows):
        result[i, :3][used[i, :3]] = one[f"residual_{who}_m"]
        if np.any(used[i, 3:]):
            result[i, 3:][used[i, 3:]] = one[f"residual_{who}_rad"]
    return read_only(result)
