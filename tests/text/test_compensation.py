"""What ``calib compensate`` takes on its line; columns that were not read are named, orientations asked for."""

from __future__ import annotations

import inspect
import math
import shlex
from pathlib import Path
from typing import Literal, get_args, get_origin

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.cli.setup import parse_columns
from calib.cli.verbs.compensate import compensate, parse_sizes, parse_tool
from calib.compensation.commands import ORIENTATIONS, SEND, UNITS
from calib.compensation.inverse import MATCHES
from calib.compensation.program import GIVEN, Program, read_program
from calib.errors import CalibError
from calib.robot.robot import Robot
from calib.text.compensation import passed_through, unread_orientation


def program(path: Path, robot: Robot, header: str, cells: str, *columns: str) -> Program:
    path.write_text(f"{header}\n{cells}\n", encoding="utf-8")
    return read_program(path, robot, columns=parse_columns(columns))


@pytest.mark.parametrize(
    ("header", "cells", "whose"),
    [
        ("A [deg],B [deg],C [deg]", "10,20,30", "KUKA"),
        ("a,b,c", "10,20,30", "KUKA"),
        ("W [deg],P [deg],R [deg]", "10,20,30", "FANUC"),
        ("q1,q2,q3,q4", "1,0,0,0", "ABB"),
        ("q0,q1,q2,q3", "1,0,0,0", "a quaternion that begins with w"),
    ],
)
def test_an_orientation_under_a_controller_s_names_is_asked_for(
    ur3: Robot, tmp_path: Path, header: str, cells: str, whose: str
):
    path = tmp_path / "p.csv"
    header, cells = f"step,x [mm],y [mm],z [mm],{header}", f"1,300,-200,300,{cells}"
    found = program(path, ur3, header, cells)
    assert not found.oriented
    assert (
        passed_through(found) == f"Passed through unread: step, {', '.join(header.split(',')[4:])}."
    )
    text = unread_orientation(found)
    assert "look like an orientation and were not read: positions alone are matched" in text
    assert f"If they are one ({whose}): --columns" in text
    # What it says to give reads them.
    words = shlex.split(text[text.index("--columns") : text.index(". Otherwise")])
    again = program(path, ur3, header, cells, *words[1::2])
    assert again.oriented
    assert unread_orientation(again) == ""
    assert passed_through(again) == "Passed through unread: step."


@pytest.mark.parametrize(
    "header", ["O [deg],A [deg],T [deg]", "alpha [deg],beta [deg],gamma [deg]"]
)
def test_one_that_cannot_be_mapped_is_to_be_converted(ur3: Robot, tmp_path: Path, header: str):
    found = program(tmp_path / "p.csv", ur3, f"x [mm],y [mm],z [mm],{header}", "300,0,300,1,2,3")
    assert "convert them to quaternions" in unread_orientation(found)


def test_where_nothing_looks_like_one_nothing_is_asked(ur3: Robot, tmp_path: Path):
    path = tmp_path / "p.csv"
    plain = program(path, ur3, "x [mm],y [mm],z [mm],A,speed [mm/s]", "300,0,300,1,250")
    assert unread_orientation(plain) == ""
    assert passed_through(plain) == "Passed through unread: A, speed [mm/s]."
    joints = ",".join(f"{name} [deg]" for name in ur3.joint_names)
    alone = program(path, ur3, f"{joints},A,B,C", "0,-80,70,-60,-90,5,1,2,3")
    assert unread_orientation(alone) == ""
    many = program(path, ur3, f"{joints},{','.join(f'n{i}' for i in range(15))}", "0," * 20 + "0")
    assert passed_through(many).endswith("n10, n11 and 3 more.")
    assert passed_through(Program.of_joints([0.0] * 6)) == ""


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


@pytest.mark.parametrize(
    "text", ["", "0 0", "150 mm", "0 0 150", "0 0 150 mm 1 2 deg", "0 0 150 mm 0 0 x deg", "0 0 150 mm 0 0 90",
             "0 0 150 mm rpy 1 2 3 4 deg", "0 0 150 mm turned 0 0 90 deg", "0 0 inf mm", "0 0 1 mm 0 0 inf deg"]
)  # fmt: skip
def test_no_tool(text: str):
    with pytest.raises(
        CalibError, match=r"--tool was given as .* it must be three numbers and a un"
    ):
        parse_tool(text)


def test_a_tool_in_wrong_units():
    for text, said in (
        ("0 0 1 deg", "'deg' is no unit of length"),
        ("0 0 1 mm 0 0 90 mm", "'mm' is no unit of angle"),
    ):
        with pytest.raises(CalibError, match=said):
            parse_tool(text)


@pytest.mark.parametrize(
    ("text", "sizes"),
    [
        ("10 mm 2 deg", (0.01, math.radians(2))),
        ("2deg, 10mm", (0.01, math.radians(2))),
        ("500 um", (5e-4, 9.0)),
        ("3 mrad", (7.0, 3e-3)),
        ("0.01 mm 1e-3 rad", (1e-5, 1e-3)),
    ],
)
def test_sizes(text: str, sizes: tuple[float, float]):
    assert parse_sizes(text, "--limit", (7.0, 9.0)) == pytest.approx(sizes)


@pytest.mark.parametrize("text", ["", "5", "5 mm 2 mm", "-5 mm", "5 kg", "5 mm 2", "1e999 mm"])
def test_no_sizes(text: str):
    with pytest.raises(CalibError, match="--limit was given as "):
        parse_sizes(text, "--limit", (7.0, 9.0))


def test_the_words_are_those_of_the_library():
    words = inspect.signature(compensate).parameters
    for option, allowed in (
        ("match", MATCHES),
        ("given", GIVEN),
        ("send", SEND),
        ("orientation", ORIENTATIONS),
        ("units", tuple(UNITS)),
    ):
        hint = words[option].annotation
        found = [get_args(one) for one in get_args(get_args(hint)[0]) if get_origin(one) is Literal]
        assert (found or [get_args(get_args(hint)[0])]) == [allowed], option
