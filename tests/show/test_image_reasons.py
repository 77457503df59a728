"""Sentences of reasons on images: each takes the values that its reason has."""

from __future__ import annotations

import pytest

from calib.diagnosis.reasons import Reason, Why
from calib.show.image_reasons import OF_IMAGES
from calib.show.verdict import reason_text

VALUES = {
    Why.CAMERA_ON_OTHER_LINK: {"given_m": 0.05, "error_m": 3e-3, "base": "arm", "tip": "hand"},
    Why.SENSE_REVERSED: {"joint": "elbow", "error_m": 2e-3, "given_m": 9e-3},
    Why.SENSE_UNKNOWN: {"joints": "elbow, wrist"},
    Why.FOCAL_LENGTH_OFF: {"share": 0.015, "std": 0.002, "exact": True},
    Why.BOARD_SCALE_OFF: {"share": -0.01, "std": 0.002, "exact": False},
    Why.COVARIANCES_IDLE: {"scale": 0.0213},
    Why.BOARD_HEAD_ON: {"tilt_rad": 0.1},
    Why.FEW_CORNERS: {"images": 7, "all": 20, "corners": 15},
    Why.ONE_AXIS: {"across_rad": 0.05},
    Why.CAMERA_TOO_ROUGH: {},
}

SAID = {
    Why.CAMERA_ON_OTHER_LINK: ("50 mm", "3.0 mm", "'hand' carries the camera and 'arm'"),
    Why.SENSE_REVERSED: ("elbow", "2.0 mm", "9.0 mm"),
    Why.SENSE_UNKNOWN: ("elbow, wrist",),
    Why.FOCAL_LENGTH_OFF: ("+1.50 %", "0.20 %", "exact"),
    Why.BOARD_SCALE_OFF: ("-1.00 %", "square_mm"),
    Why.COVARIANCES_IDLE: ("0.021",),
    Why.BOARD_HEAD_ON: ("6 deg",),
    Why.FEW_CORNERS: ("7 of 20", "15"),
    Why.ONE_AXIS: ("2.9 deg",),
    Why.CAMERA_TOO_ROUGH: ("tracker",),
}


@pytest.mark.parametrize("why", OF_IMAGES)
def test_sentences_have_the_values_of_their_reasons(why):
    text = reason_text(Reason.of(why, **VALUES[why]))
    for words in SAID[why]:
        assert words in text
