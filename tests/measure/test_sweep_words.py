"""What sweeps may be called."""

import pytest

from calib.errors import MeasurementError
from calib.measure.sweep_words import PLANE_NUMBER, SweepWords, check_words

NAMES = ("shoulder_pan_joint", "shoulder_lift_joint")


@pytest.mark.parametrize(
    ("word", "number"),
    [
        ("plane", PLANE_NUMBER),
        (" Plane ", PLANE_NUMBER),
        ("shoulder_lift_joint", 1),
        ("joint 1", 0),
        ("Joint2", 1),
        ("joint_02", 1),
        ("axis 1", 0),
        ("J2", 1),
        ("2", 1),
        ("ring_a", 0),
        ("flange", PLANE_NUMBER),
        ("3", None),
        ("0", None),
        ("elbow_joint", None),
        ("", None),
    ],
)
def test_words(word: str, number: int | None):
    words = SweepWords("s.csv", NAMES, {"ring_a": "joint 1", "flange": "plane"})
    assert words.number(word) == number


def test_numbers_are_free_where_nobody_named_the_joints():
    words = SweepWords("s.csv", (), {})
    assert [words.number(w) for w in ("7", "joint 12", "elbow_joint")] == [6, 11, None]
    assert "Joints go by their names where --robot" in words.refusal("s.csv, row 3", "elbow_joint")


def test_a_refusal_names_what_is_allowed_and_what_is_close():
    said = SweepWords("s.csv", NAMES, {}).refusal("s.csv, row 3", "shoulder_lift")
    assert said == (
        "s.csv, row 3: 'shoulder_lift' is not a sweep; allowed are 'plane', a joint's name ('shoulder_pan_joint', "
        "'shoulder_lift_joint'), or a joint's number, 'joint 1' to 'joint 2'. Close to it: 'shoulder_lift_joint', "
        "'shoulder_pan_joint'. Correct it, or map it: --sweep \"shoulder_lift=joint 1\"."
    )


def test_mappings():
    check_words({"ring a": "2", "p": "plane"}, NAMES, "--sweep")
    with pytest.raises(MeasurementError, match=r"^--sweep maps 'a': 'joint 7' is not a sweep"):
        check_words({"a": "joint 7"}, NAMES, "--sweep")
