"""Cameras: what makes one, and numbers that are those of images of another size."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

from calib.camera.camera import UNKNOWN, Camera
from calib.errors import CalibError

VALUES = [634.0, 641.0, 652.0, 349.0, -0.28, 0.11, 1e-3, -2e-3, -0.02]


def camera(**changes):
    return Camera(**({"width": 1280, "height": 720, "values": VALUES} | changes))


def test_numbers_are_kept_as_read_only_copies():
    values = np.array(VALUES)
    made = camera(values=values, sigma=[0.0] * 8 + [UNKNOWN], width=np.int64(1280))
    values[0] = 1.0
    assert made.values.tolist() == VALUES
    assert made.sigma.tolist() == [0.0] * 8 + [np.inf]
    assert type(made.width) is int
    for again in (made, pickle.loads(pickle.dumps(made)), copy.deepcopy(made)):
        with pytest.raises(ValueError, match="read-only"):
            again.values[0] = 1.0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"width": 0}, ("width", "0")),
        ({"height": 720.5}, ("height", "720.5")),
        ({"width": True}, ("width", "True")),
        ({"width": 2_000_000}, ("width", "2000000")),
        ({"lens": "fish-eye"}, ("fish-eye", "did you mean 'fisheye'", "pinhole")),
        ({"lens": None}, ("None", "pinhole")),
        ({"lens": "fisheye"}, ("(9,)", "8 numbers", "k4")),
        ({"values": VALUES[:4]}, ("(4,)", "9 numbers", "p1")),
        ({"values": ["a"] * 9}, ("not numbers",)),
        ({"values": [-1.0, *VALUES[1:]]}, ("fx = -1", "above 0")),
        ({"values": [*VALUES[:8], np.nan]}, ("not finite",)),
        ({"sigma": [1.0] * 8}, ("sigma", "(8,)")),
        ({"sigma": [-1.0] * 9}, ("-1.0",)),
        ({"sigma": [np.nan] * 9}, ("nan",)),
        ({"values": None, "sigma": [1.0] * 9}, ("give both or none",)),
    ],
)
def test_a_mistake_is_said(changes, words):
    with pytest.raises(CalibError) as error:
        camera(name="left", **changes)
    for word in ("'left'", *words):
        assert word in str(error.value)


@pytest.mark.parametrize(
    ("size", "likely"),
    [
        ((1280, 720), None),
        ((1250, 740), None),
        ((640, 360), (1274, 717)),
        ((1920, 1080), (1274, 717)),
        ((1280, 360), None),
    ],
)
def test_numbers_of_another_resolution_are_noticed(size, likely):
    assert camera(width=size[0], height=size[1]).likely_size == likely


def test_of_unknown_numbers_the_size_is_not_doubted():
    assert camera(values=None).likely_size is None
