"""The words of ``calib simulate``."""

from dataclasses import astuple

import numpy as np
import pytest

import calib.cli.verbs.simulate as words
from calib.data.cell import Cell
from calib.data.surroundings import Tracker, TrackerNoise
from calib.errors import CalibError
from calib.model.error_model import error_model
from calib.simulation.truth import Encoder, Outliers

CELL = Cell()
TRACKER = Tracker(np.array([2.0, 1.0, 0.5]), noise=TrackerNoise(1e-5, 1e-6, 0.0))


def test_sizes():
    said = (
        "length 0.5 mm, angle 2mrad,zero 0, gain 1e-3, eccentricity 0.1 deg, compliance 2e-5 rad/Nm"
    )
    found = words.sizes_of(CELL, said, named=False)
    assert tuple(found.values()) == pytest.approx((0.5e-3, 2e-3, 0.0, 1e-3, np.radians(0.1), 2e-5))
    assert words.sizes_of(CELL, "zero 1 mrad", named=True) == {"zero": 1e-3}
    assert words.sizes_of(CELL, " none ", named=False) is None
    assert words.sizes_of(CELL, None, named=True) is None
    assert words.sizes_of(CELL, None, named=False) == {}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "it must be 'none', or sizes"),
        ("length 1 mm, length 2 mm", "each once of 'length', 'angle'"),
        ("length 1 mrad", 'that is an angle, a length is wanted: "0.5 mm"'),
        ("angle -1 mrad", "must not be below 0"),
    ],
)
def test_what_are_no_sizes(text, said):
    with pytest.raises(CalibError, match=r"--sizes") as caught:
        words.sizes_of(CELL, text, named=False)
    assert said in str(caught.value)


def test_single_errors(ur3):
    known = error_model(ur3, "dh+gain+compliance", target=False).parameters
    pairs = ["a2=0.5 mm", "theta3 = -2 mrad", "elbow_joint.gain=1e-3"]
    pairs += ["elbow_joint.compliance=1e-5 rad/Nm", "d1=0"]
    assert words.parse_errors(pairs, known) == (
        ("a2", 0.5e-3), ("theta3", -2e-3), ("elbow_joint.gain", 1e-3), ("elbow_joint.compliance", 1e-5),
        ("d1", 0.0),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("pairs", "said"),
    [
        (["a2"], "it must be 'name=value' with a unit"),
        (["a2=1 mm", "a2=2 mm"], "each name once"),
        (["teta2=1 mrad"], "no error 'teta2' in this model (did you mean 'theta2' or "),
        (["a2=1 mrad"], "that is an angle, a length is wanted"),
    ],
)
def test_wrong_single_errors(ur3, pairs, said):
    with pytest.raises(CalibError, match="--error") as caught:
        words.parse_errors(pairs, error_model(ur3, "dh", target=False).parameters)
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("text", "repeatability", "noise"),
    [
        ("0.05 mm", None, (5e-5, 0.0, 0.0)),
        ("15 um + 6 um/m", "10 um", (15e-6, 6e-6, 1e-5)),
        ("none", "10 um", (0.0, 0.0, 1e-5)),
        ("0 mm", "10 um", (0.0, 0.0, 1e-5)),
        (None, "10 um", (15e-6, 6e-6, 1e-5)),
    ],
)
def test_noise(text, repeatability, noise):
    assert astuple(words.noise_of(CELL, text, repeatability)) == pytest.approx(noise)


@pytest.mark.parametrize(
    ("cell", "noise"),
    [
        (Cell(), TrackerNoise()),
        (Cell(tracker=TRACKER), TRACKER.noise),
        (Cell(sigma=1e-4), TrackerNoise(1e-4, 0.0, 0.0)),
        (Cell(sigma=1e-4, tracker=TRACKER), TrackerNoise(1e-4, 0.0, 0.0)),
    ],
)
def test_the_noise_that_a_cell_states(cell, noise):
    assert words.noise_of(cell, None, None) == noise


@pytest.mark.parametrize("text", ["none", "0", "0 mm", "0 um + 0 um/m"])
def test_no_noise_at_all(text):
    assert words.noise_of(CELL, text, None) is None


def test_encoder_steps():
    assert words.parse_encoder([]) == Encoder()
    assert astuple(words.parse_encoder(["0.001 deg"])) == pytest.approx((np.radians(1e-3), 0.0))
    assert astuple(words.parse_encoder(["0.01 mm", "1 mrad"])) == pytest.approx((1e-3, 1e-5))


@pytest.mark.parametrize("texts", [["3"], ["-1 deg"], ["1 deg", "2 deg"], ["1e-5 rad/Nm"], ["x"]])
def test_wrong_encoder_steps(texts):
    with pytest.raises(CalibError, match="--encoder"):
        words.parse_encoder(texts)


@pytest.mark.parametrize(
    ("text", "outliers"),
    [
        ("3", Outliers(count=3, size=1e-3)),
        ("5 %", Outliers(share=0.05, size=1e-3)),
        ("2.5%", Outliers(share=0.025, size=1e-3)),
        ("100 %", Outliers(share=1.0, size=1e-3)),
    ],
)
def test_outliers(text, outliers):
    assert words.parse_outliers(text, "1 mm") == outliers


@pytest.mark.parametrize("text", ["", "-1", "1.5", "100.1 %", "many"])
def test_wrong_outliers(text):
    with pytest.raises(CalibError, match="--outliers was given as"):
        words.parse_outliers(text)


def test_a_moved_target():
    moved = words.parse_moved(" 25 : 0 0 0.5 mm")
    assert (moved.row, moved.by.tolist(), moved.target) == (25, [0, 0, 0.5e-3], None)
    assert words.parse_moved("3 upper left: 1, 2, 3 mm").target == "upper left"
    for text, said in (("0 0 0.5 mm", "it must be the first row"), ("3: 0 0 mm", "three numbers")):
        with pytest.raises(CalibError, match=said):
            words.parse_moved(text)
