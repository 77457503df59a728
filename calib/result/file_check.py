"""The check of a result file against itself, for files of earlier versions, which have no checksums.

The result that was read is stated again as tables. Whatever follows from other entries then stands there as it has to
be, and is compared with the file: the hash of the URDF and its text; corrected origins and parameters; errors and
residuals; counts of rows.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pinocchio as pin

from calib.basics.json_files import Json, plain
from calib.result.calibration import Calibration

#: Numbers are the same if they differ by less, as a share or in SI units: another computer rounds otherwise.
_SAME = 1e-9

#: Tables that do not follow from the result, but from the program that reads it.
_OF_THE_READER = {"versions", "plugins"}


def check_against_itself(table: Json, again: Json, result: Calibration) -> None:
    """Refuse a result file whose entries contradict each other.

    Args:
        table: The tables of the file.
        again: The tables of the result that was read from them, see `calib.result.calibration_file.result_table`.
            Keys that only one of the two has do not count: files of other versions may have them.
        result: That result.

    Raises:
        ValueError: Two entries contradict each other, or a result that was cross-validated has no verdict; the text
            names them.
    """
    stated = {key: entry for key, entry in table.items() if key not in _OF_THE_READER}
    for path in _differences(stated, plain(again), ""):
        raise ValueError(f"'{path}' is not what follows from the rest of the file")
    for name, model in (("", result.geometry), ("non_geometric.", result.non_geometric)):
        if model is not None and model.cross_validation is not None and model.verdict is None:
            raise ValueError(f"'{name}verdict' is missing, though the result was cross-validated")


def _differences(stated: Any, again: Any, path: str) -> Iterator[str]:  # noqa: ANN401  any JSON
    """Yield the paths at which the JSON of a file differs from the same stated again, by more than rounding."""
    if stated == again:
        return
    if isinstance(stated, dict) and isinstance(again, dict):
        for key in [key for key in again if key in stated]:
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
