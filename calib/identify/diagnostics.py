"""What shows that residuals are not noise, and that poses cover too little: all the tests, from where each is built."""

from __future__ import annotations

from calib.identify.coverage import (
    Beyond,
    Coverage,
    OutsideRow,
    coverage,
    outside,
    outside_sentence,
)
from calib.identify.patterns import Drift, JointPattern, drift, joint_patterns
from calib.identify.repeats import Repeats, repeats
from calib.identify.residual_test import Explained, explained
from calib.identify.unpredicted import UnpredictedSetup, prediction_square, unpredicted_setup

__all__ = [
    "Beyond",
    "Coverage",
    "Drift",
    "Explained",
    "JointPattern",
    "OutsideRow",
    "Repeats",
    "UnpredictedSetup",
    "coverage",
    "drift",
    "explained",
    "joint_patterns",
    "outside",
    "outside_sentence",
    "prediction_square",
    "repeats",
    "unpredicted_setup",
]
