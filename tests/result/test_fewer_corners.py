"""Corners of very large tables that are fitted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.boards.board import Board
from calib.data.measurements import Measurements
from calib.diagnosis.coverage import FEW_CORNERS
from calib.diagnosis.reasons import Why
from calib.result.fewer_corners import with_fewer_corners

BOARD = Board(pattern="chessboard", columns=10, rows=8, square=0.02)
PICTURES = 40


def table() -> Measurements:
    """Return the corners of a board in pictures, 2520 in all, the last ten of them for validation."""
    corners = BOARD.corners
    count = len(corners) * PICTURES
    picture = np.repeat(np.arange(PICTURES), len(corners))
    return Measurements(
        joint_names=("a",),
        joints=0.1 * picture[:, None],
        points=np.full((count, 3), np.nan),
        kinds=("pixel",) * count,
        sets=tuple("validate" if k >= PICTURES - 10 else "estimate" for k in picture.tolist()),
        images=tuple(str(k) for k in picture.tolist()),
        corners=tuple(str(k) for k in range(len(corners))) * PICTURES,
        board_points=np.tile(corners, (PICTURES, 1)),
        readings={"u": np.arange(count, dtype=float), "v": np.ones(count)},
    )


def test_pictures_and_corners_are_kept_alike() -> None:
    """Each picture keeps 40 of 63 corners, each corner about as many pictures, and validation rows stay."""
    kept, (reason,) = with_fewer_corners(table())
    assert reason.why is Why.CORNERS_THINNED
    assert reason.values == {"corners": 1890, "kept": 1200}
    fitted = np.array(kept.images)[kept.estimation]
    assert {int(np.sum(fitted == name)) for name in set(fitted.tolist())} == {40}
    corners = np.array(kept.corners, dtype=int)[kept.estimation]
    counts = np.bincount(corners, minlength=63)
    assert counts.min() >= 13
    assert counts.max() <= 25
    assert np.sum(kept.validation) == 630


def test_no_picture_comes_to_show_few_corners() -> None:
    """Of 21 corners in each of 120 pictures fifteen are kept: fewer would be doubted as if the board was hidden."""
    whole = table()
    pictures = tuple(str(k // 21) for k in range(len(whole)))
    many = replace(whole, images=pictures, sets=("estimate",) * len(whole))
    kept, (reason,) = with_fewer_corners(many)
    assert reason.values == {"corners": 2520, "kept": 120 * FEW_CORNERS}
    counts = np.unique(np.array(kept.images), return_counts=True)[1]
    assert set(counts.tolist()) == {FEW_CORNERS}


def test_usual_tables_stay() -> None:
    """1,500 corners are not too many."""
    whole = table()
    few = whole.select(np.arange(len(whole)) < 1500)
    few = replace(few, sets=("estimate",) * len(few))
    same, reasons = with_fewer_corners(few)
    assert same is few
    assert reasons == ()
