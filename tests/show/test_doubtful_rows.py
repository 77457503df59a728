"""Rows in doubt, in words: numbers in the units that they are shown in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.diagnosis.coverage import Beyond, OutsideRow
from calib.fit.selection.robustness import Robustness
from calib.numerics.errors import Errors
from calib.result.parts import Outlier
from calib.show.doubtful_rows import (
    outliers_text,
    outside_text,
    robustness_text,
    row_or_image,
    rows_lie,
)


def test_rows_outside():
    rows = [OutsideRow(i, (Beyond("a", False, 0.1), Beyond("b", True, 0.3))) for i in range(5)]
    assert (
        outside_text(rows[:1], [7]) == "row 7: 'a' 5.73 deg, 'b' 300 mm beyond the measured range"
    )
    assert outside_text(rows, range(5)).endswith("; and 2 more rows")


def test_rows_or_images_lie():
    assert rows_lie({"rows": 1}).startswith("1 ")
    assert rows_lie({"rows": 12, "row": 3}).startswith("12 ")
    assert row_or_image({"row": 3}) == "row 3"
    of_images = {"rows": 80, "row": 3, "images": 2, "image": "b.png"}
    assert rows_lie(of_images).startswith("2 validation images")
    assert row_or_image(of_images) == "'b.png'"


def test_outliers_are_listed_by_row(default_result):
    far = [Outlier(k, {"m": 1e-3 * k}, 4.0 + k) for k in range(1, 15)]
    told = outliers_text(default_result, far).split("; ")
    assert told[1] == "row 2 (2.00 mm, 6.0 sigma)"
    assert told[12] == "and 2 more"


def test_outliers_of_images_are_listed_by_image(default_result):
    count = len(default_result.rows)
    images = tuple(f"{k // 3}.png" for k in range(count))
    named = replace(default_result, rows=replace(default_result.rows, images=images))
    numbers = default_result.rows.numbers
    far = [Outlier(numbers[k], {"px": 0.1 * k}, 4.0 + k) for k in (3, 5, 7)]
    told = outliers_text(named, far).split("; ")
    assert told == [
        "1.png, 2 corners (up to 0.50 px, 9.0 sigma)",
        "2.png, 1 corner (up to 0.70 px, 11.0 sigma)",
    ]


def test_full_weights_beside_lowered_ones():
    lowered, full = (Errors.of(np.full((4, 1), error)) for error in (1e-4, 3e-4))
    robustness = Robustness(True, 2e-4, 5e-4, lowered, full)
    text = robustness_text(robustness)
    assert text.startswith("With full weight these rows would change the prediction by 0.200 mm")
    assert "0.500 mm at most" in text
    assert "from about 0.100 to 0.300 mm rms" in text
    other = robustness_text(replace(robustness, lowered=False))
    assert other.startswith("With lowered weight")
    assert "from about 0.300 to 0.100 mm rms" in other


def test_without_held_out_rows_no_error_is_said():
    nothing = Errors.of(np.zeros((0, 3)))
    assert robustness_text(Robustness(True, 2e-4, 5e-4, nothing, nothing)).endswith("at most.")
