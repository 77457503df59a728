"""The verdict on frames and targets: each reason by the figures that cause it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.evidence import Evidence
from calib.diagnosis.judge_setup import judge_setup
from calib.diagnosis.reasons import Reason, Verdict, Why
from tests.diagnosis.test_judge import (
    GOOD,
    LACKS,
    LOUD,
    ROWS,
    STILL,
    errors,
    on_validation,
    validated,
)

LOCATED = Reason.of(Why.SETUP_LOCATED, located_m=1e-3)

#: A robot that stays as it is: nothing to gain, by the rules for robots.
SOUND = replace(
    GOOD, nominal=validated(1e-3, 1), calibrated=validated(1e-3, 1), parameters=9, changes=False,
    validation=on_validation(1e-3, 1e-3), outliers=np.zeros(ROWS, dtype=bool),
)  # fmt: skip


def judged(
    evidence: Evidence, fitted: float = 0.9e-3, undetermined: tuple[str, ...] = ()
) -> Verdict:
    return judge_setup(evidence, errors(fitted), undetermined, LOCATED)


def test_what_is_determined_and_predicts_is_used():
    verdict = judged(replace(SOUND, doubts=(LACKS, LOUD, STILL)))
    assert verdict.use == "use"
    # What is left are the robot's errors; how far its joints moved does not matter.
    assert [reason.why for reason in verdict.reasons] == [
        Why.SETUP_LOCATED,
        Why.MODEL_LACKS,
        Why.NOISE_LARGE,
    ]


@pytest.mark.parametrize(
    ("changes", "fitted", "undetermined", "use", "first"),
    [
        ({}, 0.9e-3, ("target_z",), "do not use", Why.SETUP_UNDETERMINED),
        ({"doubts": (Reason.of(Why.POSES_INVERSE),)}, 0.9e-3, (), "do not use", Why.POSES_INVERSE),
        ({"noise": {"m": 0.03}}, 0.9e-3, (), "do not use", Why.NOISE_ABSURD),
        ({"calibrated": validated(0.03)}, 0.03, (), "do not use", Why.STILL_FAR_OFF),
        ({}, 0.65e-3, (), "use with care", Why.SETUP_UNSURE),
        ({"parameters": 50}, 0.9e-3, (), "use with care", Why.FEW_NUMBERS),
        ({"outliers": np.arange(ROWS) < 6}, 0.9e-3, (), "use with care", Why.MANY_OUTLIERS),
        ({"validation": on_validation(1e-3, 2.5e-3)}, 0.9e-3, (), "use with care", Why.VALIDATION_UNLIKE),
        ({"doubts": (Reason.of(Why.ONE_AXIS),)}, 0.9e-3, (), "use with care", Why.ONE_AXIS),
    ],
)  # fmt: skip
def test_each_reason(
    changes: dict, fitted: float, undetermined: tuple[str, ...], use: str, first: Why
):
    verdict = judged(replace(SOUND, **changes), fitted, undetermined)
    assert (verdict.use, verdict.reasons[0].why) == (use, first)
