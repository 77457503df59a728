"""Rows in doubt, in words: numbers in the units that they are shown in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.diagnosis.coverage import Beyond, OutsideRow
from calib.numerics.errors import Errors
from calib.selection.robustness import Robustness
from calib.text.layout.doubtful_rows import outside_text, robustness_text


def test_rows_outside():
    rows = [OutsideRow(i, (Beyond("a", False, 0.1), Beyond("b", True, 0.3))) for i in range(5)]
    assert (
        outside_text(rows[:1], [7]) == "row 7: 'a' 5.73 deg, 'b' 300 mm beyond the measured range"
    )
    assert outside_text(rows, range(5)).endswith("; and 2 more rows")


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
