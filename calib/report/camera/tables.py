"""The table of image errors: in the image [px], and beside it what they are at the board [mm]."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from calib.report.camera.seen_corners import SeenCorners, rms
from calib.report.table import Table
from calib.text.layout.lines import number
from calib.units import Array, Mask

#: Millimetres per metre.
_MM = 1e3


def image_errors(cameras: Sequence[SeenCorners]) -> Table:
    """Tabulate the errors of each set of corners, in the image and at the board.

    Args:
        cameras: The corners that each camera saw; without any the table has no rows.
    """
    rows = [row for seen in cameras for row in _rows_of(seen, named=len(cameras) > 1)]
    return Table(
        "Errors of corners, in the image [px] and at the board [mm]",
        ("corners, robot", "images", "corners", *2 * ("max", "mean", "rms")),
        rows,
        "l" + "r" * 8,
        "An error in the image is the distance of the measured corner from the predicted one. At the board it is the "
        "shortest displacement of the corner that explains it, across the line of sight.",
        (("", 3), ("in the image [px]", 3), ("at the board [mm]", 3)),
        [k for k, row in enumerate(rows) if row[0].endswith("calibrated")],
    )


def _rows_of(seen: SeenCorners, *, named: bool) -> Iterator[tuple[str, ...]]:
    """Yield the rows of one camera; with its name in front where there are several."""
    known = np.isfinite(seen.held_out).all(axis=1)
    sets: tuple[tuple[str, Mask, Array], ...] = (
        ("estimation, nominal", ~seen.validation, seen.nominal),
        ("estimation, calibrated", ~seen.validation, seen.calibrated),
        ("held-out, calibrated", known, seen.held_out),
        ("validation, nominal", seen.validation, seen.nominal),
        ("validation, calibrated", seen.validation, seen.calibrated),
    )
    for label, chosen, residual in sets:
        if np.any(chosen):
            images = len({seen.images[k] for k in np.flatnonzero(chosen)})
            at_board = _MM * seen.at_board(np.where(chosen[:, None], residual, 0.0))
            yield (
                f"{seen.camera}: {label}" if named else label,
                f"{images:,}",
                f"{int(np.sum(chosen)):,}",
                *_figures(residual[chosen]),
                *_figures(at_board[chosen]),
            )


def _figures(errors: Array) -> list[str]:
    """Write the largest, the mean and the rms length of errors (n, 2) or (n, 3)."""
    lengths = np.linalg.norm(errors, axis=1)
    values = (float(lengths.max()), float(lengths.mean()), rms(errors))
    return [number(value, 3) for value in values]
