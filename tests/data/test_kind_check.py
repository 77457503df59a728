"""Wrong functions of a kind of measurement are named; right ones pass, wherever they have values."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.data.kind_check import check_functions
from calib.data.kinds import Kind, Reading, get
from calib.errors import CalibError
from tests.sought_frames import KINDS


@pytest.mark.parametrize("name", ["point", "pose", "distance", "pair", "fixed", "plane"])
def test_each_kind_of_calib_passes(name):
    check_functions(get(name))


@pytest.mark.parametrize("name", KINDS)
def test_kinds_from_outside_pass(name):
    check_functions(KINDS[name])


def image(T):
    return 1000.0 * T[:, :2, 3] / T[:, 2:3, 3]


def image_derivative(_measured, T, twists):
    depth = T[:, 2, 3, None, None]
    return (1000.0 * twists[:, :2] - image(T)[:, :, None] * twists[:, 2:3]) / depth


CAMERA = Kind(
    name="camera",
    words="image of the target",
    units=("px", "px"),
    readings=(Reading("u", "pixel"), Reading("v", "pixel")),
    measure=image,
    derivative=image_derivative,
)


def seen(T):
    """The image, without values behind the camera and beside it."""
    visible = T[:, 2:3, 3] > 2.0 * np.abs(T[:, :2, 3]).max(axis=1, keepdims=True)
    return np.where(visible, image(T), np.nan)


@pytest.mark.parametrize(
    "measure",
    [
        image,
        seen,
        lambda T: np.float32(image(T)),
        lambda T: np.full((len(T), 2), np.nan),
        lambda T: np.where(T[:, 2:3, 3] > 0.2, image(T), 0.0),  # constant behind the camera
    ],
    ids=["everywhere", "in sight", "single precision", "nowhere", "limited"],
)
def test_values_need_not_exist_at_every_pose(measure):
    check_functions(replace(CAMERA, measure=measure))


def lever(T):
    """Height of a point that stands off the target's origin."""
    return T[:, 2:3, 3] + 0.1 * T[:, 2:3, 0]


def lever_derivative(_measured, T, twists):
    turned = np.cross(twists[:, 3:], T[:, :3, 0, None], axis=1)[:, 2:3]
    return twists[:, 2:3] + 0.1 * turned


LEVER = Kind(
    name="lever",
    words="height of a point of the tool",
    units=("m",),
    readings=(Reading("height"),),
    measure=lever,
    derivative=lever_derivative,
    turns=True,
)


@pytest.mark.parametrize(
    ("kind", "change", "words"),
    [
        (CAMERA, {"measure": lambda T: image(T)[:, 0]}, ("'measure'", "(64,)", "(64, 2)")),
        (CAMERA, {"measure": lambda T: image(T).tolist()}, ("'measure'", "no array", "(64, 2)")),
        (CAMERA, {"measure": lambda T: T @ np.eye(3)}, ("'measure'", "ValueError")),
        (CAMERA, {"derivative": lambda _m, _T, t: t[:, :3]}, ("'derivative'", "(64, 2, 7)")),
        (CAMERA, {"derivative": lambda m, _T, t: t @ m}, ("'derivative'", "ValueError")),
        (
            CAMERA,
            {"derivative": lambda *given: -image_derivative(*given)},
            ("'derivative'", "differences", "[px]"),
        ),
        (
            CAMERA,
            {"derivative": lambda _m, T, t: 1000.0 * t[:, :2] / T[:, 2, 3, None, None]},
            ("'derivative'", "differences", "along z"),
        ),
        (
            CAMERA,
            {"derivative": lambda _m, T, t: np.full((len(T), 2, t.shape[2]), np.nan)},
            ("'derivative'", "nan"),
        ),
        (
            CAMERA,  # a table with other kinds has twists of six rows
            {"derivative": lambda _m, T, t: np.ones((len(T), 2, 3)) @ t},
            ("'derivative'", "(64, 6, 7)"),
        ),
        (LEVER, {"turns": None}, ("'lever'", "rad", "'turns=True'")),
        (
            LEVER,
            {"derivative": lambda _m, _T, t: t[:, 2:3]},
            ("'derivative'", "scalar 1 [m]", "about "),
        ),
        (
            get("pair"),
            {"derivative": lambda m, T, t: -get("pair").derivative(m, T, t)},
            ("'derivative'", "row)"),
        ),
        (get("plane"), {"residual": lambda _m, T: -T[:, 2, 3]}, ("'residual'", "(64, 1)")),
        (get("plane"), {"residual": lambda _m, T: T[:, 2:3, 3]}, ("'derivative'", "'residual'")),
    ],
)
def test_a_wrong_function_is_named_in_one_line(kind, change, words):
    wrong = replace(kind, **change)
    with pytest.raises(CalibError) as caught:
        check_functions(wrong)
    message = str(caught.value)
    assert f"'{kind.name}'" in message
    for word in words:
        assert word in message
    assert "\n" not in message


def test_what_an_instrument_without_measure_reads_is_not_known():
    kind = replace(CAMERA, measure=None, residual=lambda m, T: m - image(T)[:, :1])
    check_functions(kind)
