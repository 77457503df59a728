"""What ``calib compensate`` takes on its line, and what it refuses."""

from __future__ import annotations

import math
from typing import Literal, get_args, get_origin, get_type_hints

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.cli.compensate import compensate
from calib.cli.compensate_setup import (
    ACCEPT,
    UNLIMITED,
    parse_lever,
    parse_sizes,
    parse_start,
    parse_tool,
)
from calib.compensate.commands_file import ORIENTATIONS, SEND, UNITS
from calib.compensate.inverse import MATCHES
from calib.compensate.program_columns import GIVEN
from calib.errors import CalibError
from calib.model.robot import Robot


def refused(function, *words: object) -> str:
    with pytest.raises(CalibError) as caught:
        function(*words)
    return str(caught.value)


@pytest.mark.parametrize(
    ("text", "place", "turn"),
    [
        ("0 0 150 mm", [0, 0, 0.15], [0, 0, 0]),
        ("0, -1.5, 15cm", [0, -0.015, 0.15], [0, 0, 0]),
        ("0 0 0.15 m 0 0 90 deg", [0, 0, 0.15], [0, 0, np.pi / 2]),
        ("1 2 3mm 0.1 0.2 0.3rad", [1e-3, 2e-3, 3e-3], [0.1, 0.2, 0.3]),
    ],
)
def test_a_tool_with_a_rotation_vector(text: str, place: list[float], turn: list[float]):
    T = parse_tool(text)
    assert isinstance(T, np.ndarray)
    assert T[:3, 3] == pytest.approx(place)
    assert T[:3, :3] == pytest.approx(Rotation.from_rotvec(turn).as_matrix())


def test_a_tool_with_roll_pitch_and_yaw():
    T = parse_tool("0 0 100 mm rpy 10 20 30 deg")
    assert isinstance(T, np.ndarray)
    Rx, Ry, Rz = (
        Rotation.from_euler(a, v, degrees=True) for a, v in zip("xyz", (10, 20, 30), strict=True)
    )
    assert T[:3, :3] == pytest.approx((Rz * Ry * Rx).as_matrix())


def test_the_calibrated_target_as_the_tool():
    assert parse_tool("target") == ""
    assert parse_tool(" target:upper ball ") == "upper ball"
    assert "the name of a target is missing" in refused(parse_tool, "target: ")


@pytest.mark.parametrize(
    "text", ["", "0 0", "150 mm", "0 0 150", "0 0 150 mm 1 2 deg", "0 0 150 mm 0 0 x deg", "0 0 150 mm 0 0 90",
             "0 0 150 mm rpy", "0 0 150 mm rpy 1 2 3 4 deg", "0 0 150 mm turned 0 0 90 deg"]
)  # fmt: skip
def test_no_tool(text: str):
    said = refused(parse_tool, text)
    assert said.startswith(f'--tool was given as "{text}"; it must be three numbers and a unit')


def test_a_tool_in_wrong_units():
    assert "'deg' is no unit of length" in refused(parse_tool, "0 0 1 deg")
    assert "'mm' is no unit of angle" in refused(parse_tool, "0 0 1 mm 0 0 90 mm")
    assert "or an angle no finite number" in refused(parse_tool, "0 0 1 mm 0 0 inf deg")
    assert "must be three numbers" in refused(parse_tool, "0 0 inf mm")


def test_limits():
    assert parse_sizes("10 mm 2 deg", "--limit", UNLIMITED) == pytest.approx(
        (0.01, math.radians(2))
    )
    assert parse_sizes("2deg, 10mm", "--limit", UNLIMITED) == pytest.approx((0.01, math.radians(2)))
    assert parse_sizes("500 um", "--limit", UNLIMITED) == pytest.approx((5e-4, math.tau))
    assert parse_sizes("3 mrad", "--limit", UNLIMITED) == pytest.approx((1e6, 3e-3))


def test_what_may_be_left():
    assert parse_sizes(None, "--accept", ACCEPT) == (1e-8, 1e-8)
    assert parse_sizes("0.01 mm", "--accept", ACCEPT) == pytest.approx((1e-5, 1e-8))
    assert parse_sizes("0.01 mm 1e-3 rad", "--accept", ACCEPT) == pytest.approx((1e-5, 1e-3))


@pytest.mark.parametrize(
    "text", ["", "5", "5 mm 2 mm", "-5 mm", "5 kg", "5 mm 2", "fast", "1e999 mm"]
)
def test_no_sizes(text: str):
    said = refused(parse_sizes, text, "--limit", UNLIMITED)
    assert said.startswith(f'--limit was given as "{text}"; ')


def test_lever():
    assert parse_lever("10 mm", None) == pytest.approx(0.01)
    assert parse_lever(None, "pose") is None
    assert "here 'pose' is matched" in refused(parse_lever, "10 mm", "pose")
    for text in ("0 mm", "3 deg", "10 mm 3 deg"):
        said = refused(parse_lever, text, None)
        assert said.startswith(f'--lever was given as "{text}"; it must be a length above 0')


def test_start(ur3: Robot):
    assert parse_start(["elbow_joint=90 deg", "wrist_1_joint = -1 rad"], ur3) == pytest.approx(
        {"elbow_joint": math.pi / 2, "wrist_1_joint": -1.0}
    )
    assert "has no joint 'elbow_jont' (did you mean 'elbow_joint'?)" in refused(
        parse_start, ["elbow_jont=3 deg"], ur3
    )
    assert "the value of 'elbow_joint' is a length, and the joint turns" in refused(
        parse_start, ["elbow_joint=3 mm"], ur3
    )
    for pair in ("elbow_joint", "=3 deg"):
        assert refused(parse_start, [pair], ur3).startswith(
            f"--start was given '{pair}'; it must be"
        )
    assert "--start was given 'elbow_joint=2 deg'" in refused(
        parse_start, ["elbow_joint=1 deg", "elbow_joint=2 deg"], ur3
    )


def test_the_words_are_those_of_the_library():
    hints = get_type_hints(compensate)
    for option, allowed in (
        ("match", MATCHES),
        ("given", GIVEN),
        ("send", SEND),
        ("orientation", ORIENTATIONS),
        ("units", UNITS),
    ):
        hint = hints[option]
        words = [get_args(one) for one in (hint, *get_args(hint)) if get_origin(one) is Literal]
        assert words == [allowed], option
