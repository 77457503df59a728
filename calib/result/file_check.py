"""The check of a result file against itself: what it states twice, or what follows from something else in it, agrees.

The result that was read is stated again as tables. Whatever follows from other entries then stands there as it has to
be, and is compared with the file: the hash of the URDF and its text; corrected origins and parameters; errors and
residuals; counts of rows. Entries that are read as they stand are checked by what holds for every result:

    value = nominal + delta,    std = sqrt(diag(covariance)),    covariance = covariance^T, without negative variance
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pinocchio as pin

from calib.basics.json_files import Json, plain
from calib.data.columns import SETS
from calib.result.calibration import Calibration
from calib.result.fitted_model import FittedModel

#: Numbers are the same if they differ by less, as a share or in SI units: another computer rounds otherwise.
_SAME = 1e-9

#: The least eigenvalue of a covariance over its largest, in standard deviations, that is still rounding.
_ROUNDING = 1e-9

#: Tables that do not follow from the result: the programs that read it, not those that wrote it.
_OF_THE_READER = {"versions", "plugins"}


def check_against_itself(table: Json, again: Json, result: Calibration) -> None:
    """Refuse a result file whose entries contradict each other.

    Args:
        table: The tables of the file.
        again: The tables of the result that was read from them, see `calib.result.calibration_file.result_table`.
            Keys that only one of the two has do not count: files of other versions may have them.
        result: That result.

    Raises:
        ValueError: Two entries contradict each other; the text names them.
    """
    stated = {key: entry for key, entry in table.items() if key not in _OF_THE_READER}
    for path in _differences(stated, plain(again), ""):
        raise ValueError(f"'{path}' is not what follows from the rest of the file")
    for name, model in (("", result.geometry), ("non_geometric.", result.non_geometric)):
        if model is not None:
            _check_model(model, name)
    _check_rows(result)


def _differences(stated: Any, again: Any, path: str) -> Iterator[str]:  # noqa: ANN401  any JSON
    """Yield the paths at which the JSON of a file differs from the same stated again, by more than rounding."""
    if stated == again:
        return
    if isinstance(stated, dict) and isinstance(again, dict):
        for key in again:
            if key not in stated:
                continue
            within = f"{path}.{key}" if path else key
            if key.endswith("rpy_rad"):
                # Equal rotations may have other angles.
                if not _same_rotation(stated[key], again[key]):
                    yield within
            else:
                yield from _differences(stated[key], again[key], within)
    elif isinstance(stated, list) and isinstance(again, list) and len(stated) == len(again):
        for index, (one, other) in enumerate(zip(stated, again, strict=True)):
            yield from _differences(one, other, f"{path}.{index}")
    elif not (_is_number(stated) and _is_number(again)) or not math.isclose(
        stated, again, rel_tol=_SAME, abs_tol=_SAME
    ):
        yield path


def _is_number(entry: object) -> bool:
    """Return whether an entry of JSON is a number; true and false are none."""
    return isinstance(entry, (int, float)) and not isinstance(entry, bool)


def _same_rotation(stated: object, again: object) -> bool:
    """Return whether two lists of roll, pitch, yaw [rad] are one rotation."""
    R_stated, R_again = (
        pin.rpy.rpyToMatrix(np.array(angles, dtype=np.float64)) for angles in (stated, again)
    )
    return bool(np.abs(R_stated - R_again).max() < _SAME)


def _check_model(model: FittedModel, name: str) -> None:
    """Refuse parameters that are not those of their covariance, and errors without a verdict, by `ValueError`.

    The name is that of the model's table, with a dot, or empty.
    """
    covariance = model.covariance
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    in_std = covariance / np.where(std > 0.0, std, 1.0) / np.where(std > 0.0, std, 1.0)[:, None]
    least = np.linalg.eigvalsh(in_std).min(initial=0.0)
    if not np.allclose(in_std, in_std.T, 0.0, _SAME) or least < -_ROUNDING * max(len(std), 1):
        raise ValueError(f"'{name}covariance' is not a covariance")
    for parameter, of_covariance in zip(model.parameters, std, strict=True):
        where = f"'{name}parameters': '{parameter.name}'"
        values = [parameter.value, parameter.delta]
        if not np.isfinite(values).all():
            raise ValueError(f"{where} has no value")
        start = parameter.value - parameter.delta if parameter.nominal is None else parameter.nominal
        if not math.isclose(start + parameter.delta, parameter.value, rel_tol=_SAME, abs_tol=_SAME):
            raise ValueError(f"{where}: value is not nominal + delta")
        if parameter.at_bound:
            continue  # std and interval are NaN
        if not math.isclose(parameter.std, of_covariance, rel_tol=_SAME):
            raise ValueError(f"{where}: std is not that of 'covariance'")
        if parameter.low > parameter.value or parameter.high < parameter.value:
            raise ValueError(f"{where}: value is outside of its interval")
    if model.cross_validation is not None and model.verdict is None:
        raise ValueError(f"'{name}verdict' is missing: the result was cross-validated")


def _check_rows(result: Calibration) -> None:
    """Refuse rows that are not of one number, or whose words and weights no row has, by `ValueError`."""
    rows = result.rows
    count = len(rows)
    by_name: dict[str, Any] = {
        "sets": rows.sets,
        "kinds": rows.kinds,
        "groups": rows.groups,
        "targets": rows.targets,
        "residual_nominal": rows.residual_nominal,
        "residual_calibrated": rows.residual_calibrated,
        "channels.index": rows.channels.index,
        "scores": rows.scores,
        "weights": rows.weights,
    }
    for name, values in by_name.items():
        if len(values) != count:
            raise ValueError(f"'rows.{name}' has {len(values)} entries, the table {count} rows")
    unknown = {*rows.sets} - {*SETS}
    if unknown:
        raise ValueError(f"'rows.sets': {min(unknown)!r} is none of {', '.join(SETS)}")
    if not np.all((rows.weights >= 0.0) & (rows.weights <= 1.0 + _SAME)):
        raise ValueError("'rows.weights': a weight is between 0 and 1")
    flagged = {outlier.row for outlier in (*rows.outliers, *rows.suspects)}
    if flagged - {*rows.numbers}:
        raise ValueError("'outliers' or 'suspects' are rows that 'rows.numbers' does not have")
