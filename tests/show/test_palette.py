"""Colours that are told apart by any eyes, and in grey print."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from calib.show import palette

#: Those that stand in one picture for different things.
GROUPS = (
    ("NOMINAL", "CALIBRATED", "MEASURED"),
    ("ESTIMATION", "VALIDATION", "OUTLIER"),
)

#: Full protanopia, deuteranopia and tritanopia, linear RGB: Machado, Oliveira, Fernandes 2009.
EYES = {
    "protanopia": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "tritanopia": [
        [1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
    "all colours": np.eye(3),
}


def linear(colour):
    rgb = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
    return np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)


def lab(rgb):
    XYZ = np.array(
        [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    ) @ np.clip(rgb, 0.0, 1.0)
    t = XYZ / np.array([0.9505, 1.0, 1.089])
    f = np.where(t > 0.008856, np.cbrt(t), 7.787 * t + 16.0 / 116.0)
    return np.array([116.0 * f[1] - 16.0, 500.0 * (f[0] - f[1]), 200.0 * (f[1] - f[2])])


@pytest.mark.parametrize("eyes", EYES)
@pytest.mark.parametrize("group", GROUPS, ids=" ".join)
def test_no_two_colours_of_a_group_look_alike(group, eyes):
    seen = [lab(np.array(EYES[eyes]) @ linear(getattr(palette, name))) for name in group]
    for one, other in itertools.combinations(seen, 2):
        assert np.linalg.norm(one - other) > 18.0  # 2.3 is what one can just see


def test_the_robots_differ_in_grey_print():
    lightness = [lab(linear(getattr(palette, name)))[0] for name in GROUPS[0]]
    for one, other in itertools.combinations(lightness, 2):
        assert abs(one - other) > 18.0


def test_colours_stand_out_from_paper():
    for name in {name for group in GROUPS for name in group} | {"INK", "SOFT"}:
        ratio = 1.05 / (
            0.05 + float(np.array([0.2126, 0.7152, 0.0722]) @ linear(getattr(palette, name)))
        )
        assert ratio > (4.5 if name in ("INK", "SOFT") else 2.4), name
