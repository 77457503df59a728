"""Texts of noise: what it is stated for, where it comes from, and that of poses with covariances."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from calib.basics.channels import channels_of
from calib.data.kinds import get
from calib.fit.registration.rows import USUAL_POSE_NOISE
from calib.numerics.correlated_noise import PoseNoise
from calib.show.errors import measured_lengths
from calib.verbs.calibrate.noise_text import ENOUGH_FREEDOM, noise_text, pose_noise_text
from calib.verbs.calibrate.text import POSE_NOISE, facts
from tests.parts import with_part


@pytest.mark.parametrize(
    ("kinds", "of"),
    [
        (["point", "fixed"], "coordinate"),
        (["distance", "plane"], "length"),
        (["pose", "pair"], "coordinate or length"),
        ([], "coordinate"),
    ],
)
def test_measured_lengths_are_those_of_the_kinds(kinds: list[str], of: str):
    units = [get(kind).units for kind in kinds]
    vector_units = [get(kind).vector_units for kind in kinds]
    assert measured_lengths(channels_of(units, vector_units, np.arange(len(kinds)))) == of


def test_the_noise_has_its_degrees_of_freedom_where_they_are_enough(default_result):
    told = noise_text(default_result)
    assert f"{default_result.noise.freedom:.0f} d.o.f." in told
    few = noise_text(with_part(default_result, "noise", freedom=ENOUGH_FREEDOM - 0.1))
    assert "d.o.f." not in few


def test_the_noise_of_poses_is_told_in_common_units(default_result):
    noise = PoseNoise(
        scale=0.37, position=1.25e-4, orientation=np.deg2rad(0.02), joint=np.deg2rad(0.013)
    )
    numbers = [float(word) for word in re.findall(r"\d+\.\d+", pose_noise_text(noise))]
    assert numbers == pytest.approx([0.37, 0.013, 0.125, 0.02])
    assert "at each joint" not in pose_noise_text(replace(noise, joint=0.0))
    assert "assumed" in pose_noise_text(USUAL_POSE_NOISE)
    assert "assumed" not in pose_noise_text(noise)
    assert POSE_NOISE not in facts(default_result)
    assert facts(with_part(default_result, "noise", pose_noise=noise))[
        POSE_NOISE
    ] == pose_noise_text(noise)
