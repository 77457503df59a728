"""The verdict: each reason by the figures that cause it."""

from __future__ import annotations

import numpy as np
import pytest

from calib.identify.statistics import Errors
from calib.identify.verdict import verdict


def errors(rms: float, n: int = 30) -> Errors:
    return Errors.of(np.full((n, 3), rms / np.sqrt(3)))


GOOD = {
    "before": errors(2.5e-3),
    "after": errors(0.2e-3),
    "unseen": "leave-one-out",
    "validation_before": errors(2.7e-3, 5),
    "validation_after": errors(0.25e-3, 5),
    "measured": 90,
    "parameters": 27,
    "outliers": 2,
    "rows": 30,
    "noise": 1e-4,
}


def test_a_good_calibration_is_to_be_used_and_says_by_how_much():
    result = verdict(**GOOD)
    assert result.use == "use"
    assert "from 2.500 to 0.200 mm rms" in result.reasons[0]
    assert "5 validation rows it falls from 2.700 to 0.250 mm rms" in result.reasons[1]


@pytest.mark.parametrize(
    ("change", "use", "reason"),
    [
        (
            {"after": errors(2.6e-3)},
            "do not use",
            "no better than the nominal one: 2.600 against 2.500 mm",
        ),
        (
            {"validation_after": errors(3e-3, 5)},
            "do not use",
            "validation rows the error does not fall",
        ),
        ({"noise": 0.05}, "do not use", "50 mm a coordinate"),
        ({"noise": 0.05, "hint": "Try --base base."}, "do not use", "Try --base base."),
        ({"measured": 45}, "use with care", "45 measured coordinates for 27 parameters are few"),
        ({"outliers": 6}, "use with care", "6 of 30 rows are flagged"),
    ],
)
def test_each_doubt_is_said_first(change, use, reason):
    result = verdict(**(GOOD | change))
    assert result.use == use
    assert reason in result.reasons[0]


def test_without_validation_rows_nothing_is_said_of_them():
    result = verdict(
        **(GOOD | {"validation_before": errors(1, 0), "validation_after": errors(1, 0)})
    )
    assert result.use == "use"
    assert not any("validation rows" in reason for reason in result.reasons)
