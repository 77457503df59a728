"""Columns of a program that were not read: they are named, and orientations among them are asked for."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from calib.cli.compensate_notes import passed_through, unread_orientation
from calib.cli.setup import parse_columns
from calib.compensate.program import Program, read_program
from calib.model.robot import Robot


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
