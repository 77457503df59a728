"""Reasons: their codes are public, since the result file has them; numbers are in SI units."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from calib.diagnosis.reasons import CARE, NO, USE, VERDICTS, Reason, Verdict, Why
from calib.errors import ArgumentError
from calib.numerics.errors import Errors
from tests.residuals import lengths_and_angles


def test_the_code_is_the_name_in_small_letters():
    """Two entries of one code would be one entry with two names."""
    for name, why in Why.__members__.items():
        assert Reason.of(why).code == name.lower()


def test_the_verdicts():
    assert (USE, CARE, NO) == ("use", "use with care", "do not use")
    assert [bool(Verdict(word, ())) for word in VERDICTS] == [True, False, False]


@pytest.mark.parametrize("word", ["do not usd", "Use", "", None])
def test_there_is_no_other_word(word: Any):
    with pytest.raises(
        ArgumentError, match="A verdict is 'use', 'use with care', 'do not use', not"
    ):
        Verdict(word, ())


@pytest.mark.parametrize(
    ("columns", "names"),
    [(3, {"before_m"}), (6, {"before_m", "before_rad"})],
)
def test_of_errors_the_rms_is_stored(columns: int, names: set[str]):
    residual = np.full((4, columns), 1e-3)
    errors = Errors.of(residual, lengths_and_angles(np.ones(residual.shape)))
    values = Reason.of(Why.GAIN, before=errors, method="leave-one-out").values
    assert set(values) == names | {"method"}
    for name in names:
        assert values[name] == pytest.approx(1e-3 * np.sqrt(3.0))
    assert values["method"] == "leave-one-out"


def test_a_mistake_is_completed_from_its_trial_to_the_verdict():
    mistake = Reason.of(Why.JOINT_ZERO, joint="J2", add_rad=0.5)
    found = mistake.with_values(error_m=1e-3)
    assert found.entry == {"code": "joint_zero", "error_m": 1e-3, "joint": "J2", "add_rad": 0.5}
    assert list(found.values) == ["error_m", "joint", "add_rad"]
    assert found.with_values(error_m=2.0, given_m=0.1).values["error_m"] == 1e-3
    other = Reason.of(Why.OTHER_TIP, link="hand").entry
    assert found.with_others([other]).values == {**found.values, "others": [other]}
    assert found.with_others([]) is found


def test_errors_that_were_not_measured_are_not_stored():
    nothing = Errors.of(np.zeros((0, 3)))
    assert Reason.of(Why.GAIN, before=nothing).values == {}
