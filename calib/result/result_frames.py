"""The rows, the parameters and the covariance of a result as columns, for frames of pandas and polars."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypeAlias, get_args

import numpy as np

from calib.basics.arrays import Array
from calib.basics.channels import RESIDUAL_UNITS, Channels
from calib.basics.frames import Library, frame_of
from calib.errors import CalibError, choices, did_you_mean
from calib.result.calibration import Calibration

#: What of a result a frame holds.
Content: TypeAlias = Literal["rows", "parameters", "covariance"]

#: Axes of vectors in names of columns, by the symbol of their unit.
_AXES = {"m": ("x", "y", "z"), "rad": ("rx", "ry", "rz")}

#: The column with the names of the parameters, which are those of the other columns of a covariance too.
_NAME = "parameter"

Columns: TypeAlias = dict[str, Sequence[Any]]


def result_frame(
    result: Calibration,
    content: Content = "rows",
    library: Library = "pandas",
    *,
    non_geometric: bool = False,
) -> Any:  # noqa: ANN401  of any library
    """Return a part of a result as a frame, see `Calibration.to_frame`."""
    if content not in get_args(Content):
        raise CalibError(
            f"A result has no frame '{content}'{did_you_mean(content, get_args(Content))}; there are "
            f"{choices(get_args(Content))}."
        )
    if content == "rows":
        return frame_of(_rows(result), library)
    part = result.part(non_geometric=non_geometric)
    if content == "parameters":
        fields = ("name", "unit", "nominal", "value", "delta", "std", "low", "high")
        columns: Columns = {
            name: [getattr(parameter, name) for parameter in part.parameters] for name in fields
        }
        for name in ("identifiable", "at_bound"):
            columns[name] = [bool(getattr(parameter, name)) for parameter in part.parameters]
        return frame_of(columns, library)
    names = part.model.names
    columns = {_NAME: list(names)}
    columns |= {name: part.covariance[:, i].tolist() for i, name in enumerate(names)}
    frame = frame_of(columns, library)
    return frame.set_index(_NAME) if library == "pandas" else frame


def _rows(result: Calibration) -> Columns:
    """Return a column of each name, error, residual, score and weight of the rows."""
    rows = result.rows
    columns: Columns = {
        "row": list(rows.numbers),
        "set": list(rows.sets),
        "kind": list(rows.kinds),
        "group": list(rows.groups),
        "target": list(rows.targets),
    }
    if rows.images:
        columns["image"] = list(rows.images)
    residuals = {"nominal": rows.residual_nominal, "calibrated": rows.residual_calibrated}
    if result.non_geometric is not None:
        residuals["non-geometric"] = result.non_geometric.residual
    columns |= error_columns(residuals, rows.channels)
    columns["score"] = _numbers(rows.scores)
    columns["weight"] = _numbers(rows.weights)
    columns["flagged"] = rows.flagged.tolist()
    return columns


def error_columns(residuals: Mapping[str, Array], channels: Channels) -> Columns:
    """Return columns of errors in the units that texts show, and of the residual vectors along the frame's axes.

    Args:
        residuals: Measured minus predicted by the name of the robot that predicts, shape (N, D) each.
        channels: The units of the N rows.

    Returns:
        ``"nominal error [mm]"``, and so on for each robot and unit; ``"calibrated residual x [mm]"`` where all three
        axes are measured. None in rows that measure nothing of it.
    """
    columns: Columns = {}
    for symbol in channels.present:
        unit = RESIDUAL_UNITS[symbol]
        for robot, residual in residuals.items():
            norms = channels.norms(residual, symbol) * unit.to_shown
            columns[f"{robot} error [{unit.shown}]"] = _numbers(norms)
    for symbol in channels.present:
        unit = RESIDUAL_UNITS[symbol]
        entries, has_vector = channels.vector_columns(symbol)
        for robot, residual in residuals.items():
            for axis, entry in zip(_AXES.get(symbol, ()), entries.tolist(), strict=False):
                along = np.where(has_vector, residual[:, entry], np.nan) * unit.to_shown
                columns[f"{robot} residual {axis} [{unit.shown}]"] = _numbers(along)
    return columns


def _numbers(values: Array) -> list[float | None]:
    """Return numbers, None where there is none."""
    return [None if np.isnan(value) else value for value in values.tolist()]
