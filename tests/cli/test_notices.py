"""Notices: what of a table was not used, and a verdict that was overridden."""

from __future__ import annotations

from dataclasses import replace

import pytest

from calib.boards.board import Board
from calib.camera.camera import Camera
from calib.cli.notices import say_accepted, say_ignored, say_unused_camera
from calib.data.cell import Cell
from tests.images import poses, table


def test_an_accepted_verdict_is_said_on_stderr_alone(capsys: pytest.CaptureFixture[str]):
    say_accepted("'a.json'", "")
    assert capsys.readouterr() == ("", "")
    say_accepted("'a.json'", "do not use.")
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("calib: the verdict on 'a.json' is: do not use.")


def test_a_table_of_which_all_is_used_needs_no_notice(ur3, paper_table, capsys):
    say_ignored(replace(paper_table, ignored=(), unmeasured=()), ur3)
    assert capsys.readouterr().out == ""


def test_rows_and_columns_that_are_not_used_are_named(ur3, paper_table, capsys):
    rows = tuple(range(40, 43))
    say_ignored(replace(paper_table, ignored=("note",), unmeasured=rows), ur3)
    text = capsys.readouterr().out
    assert f"{len(rows)} of {len(paper_table) + len(rows)} rows" in text
    assert "40 to 42" in text
    assert "'note'" in text
    assert "--tip" not in text


def test_a_joint_outside_of_the_chain_hints_at_base_and_tip(ur3, paper_table, capsys):
    shorter = ur3.rebuilt(tip="forearm_link")
    say_ignored(replace(paper_table, ignored=("wrist_1_joint [deg]",)), shorter)
    text = capsys.readouterr().out
    assert "'forearm_link'" in text
    assert "wrist_1_joint" in text.split("--tip")[1]


def test_how_orientations_were_read_is_said_unless_as_quaternions(ur3, paper_table, capsys):
    plain = replace(paper_table, ignored=())
    say_ignored(replace(plain, orientation="kuka"), ur3)
    assert "--orientation kuka" in capsys.readouterr().out
    say_ignored(replace(plain, orientation="quaternion"), ur3)
    assert capsys.readouterr().out == ""


def test_a_camera_without_images_is_said_not_to_be_used(paper_table, capsys):
    boards = {"": Board(pattern="chessboard", columns=6, rows=5, square=0.03)}
    cell = Cell(cameras={"": Camera(width=640, height=480)}, boards=boards)
    say_unused_camera(paper_table, Cell())
    assert capsys.readouterr().out == ""
    say_unused_camera(paper_table, replace(cell, cameras={}))
    said = capsys.readouterr().out
    assert "--board" in said
    assert "--camera" not in said
    say_unused_camera(paper_table, cell)
    assert "--camera and --board" in capsys.readouterr().out
    say_unused_camera(table(poses(2)), cell)
    assert capsys.readouterr().out == ""
