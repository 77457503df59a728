"""A cell for the rows that a result is applied to: it may say again what the result contains, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import pytest

from calib.data.cell import Cell
from calib.errors import CalibError
from calib.result.chain_of_result import with_chain_of_result
from calib.robot.robot import Robot
from tests.parts import with_part


@pytest.mark.parametrize("said", [{}, {"base": "base"}, {"tip": "tool0"}])
def test_the_chain_of_a_result_is_that_of_the_cell(tracked, said):
    held = {"wrist_2_joint": 0.2, "wrist_3_joint": 0.3}
    robot = Robot.from_urdf(tracked.nominal.urdf, "base", "tool0", held=held)
    result = replace(tracked, nominal=robot)
    cell = with_chain_of_result(Cell(held={"wrist_2_joint": 0.1}, **said), result, "r.json")
    assert (cell.base, cell.tip) == ("base", "tool0")
    assert cell.held == {"wrist_2_joint": 0.1, "wrist_3_joint": 0.3}


@pytest.mark.parametrize(("option", "link"), [("base", "base"), ("tip", "tool0")])
def test_another_chain_than_that_of_the_result_is_refused(tracked, option, link):
    wrong = Cell(**{option: "flange"})
    with pytest.raises(CalibError, match=f"r.json .* --{option} {link}, but 'flange' was given"):
        with_chain_of_result(wrong, tracked, "r.json")


def test_frames_and_targets_are_on_the_links_of_the_result(tracked):
    """A target that the result lacks may be on a link of one that it has."""
    setup = replace(
        tracked.setup,
        groups=("t1",),
        frame_links=("base",),
        target_links=("tool0",),
        targets=("a",),
    )
    result = with_part(tracked, "geometry", setup=setup)
    same = Cell(bases={"t1": "base"}, tips={"a": "tool0", "b": "tool0"})
    for said, tips in ((Cell(), {"a": "tool0"}), (same, {"a": "tool0", "b": "tool0"})):
        cell = with_chain_of_result(said, result, "r.json")
        assert (cell.bases, cell.tips) == ({"t1": "base"}, tips)
    for wrong, other in (
        (Cell(bases={"t1": "flange"}), "--base 't1=base', but 't1=flange'"),
        (Cell(bases={"t2": "base"}), "--base 't2=another link', but 't2=base'"),
        (Cell(tips={"a": "flange"}), "--tip 'a=tool0', but 'a=flange'"),
        (Cell(tips={"b": "flange"}), "--tip 'b=another link', but 'b=flange'"),
    ):
        with pytest.raises(CalibError, match=other):
            with_chain_of_result(wrong, result, "r.json")


def test_the_coupled_readings_of_a_result_are_those_of_the_cell(tracked):
    nominal = tracked.nominal
    coupling = {"elbow_joint": {"shoulder_lift_joint": 1.0}}
    robot = Robot.from_urdf(nominal.urdf, nominal.base, nominal.tip, coupling=coupling)
    coupled = replace(tracked, nominal=robot)
    assert with_chain_of_result(Cell(), coupled, "r.json").coupling == coupling
    assert with_chain_of_result(Cell(coupling=coupling), coupled, "r.json").coupling == coupling
    assert with_chain_of_result(Cell(), tracked, "r.json").coupling == {}
    with pytest.raises(CalibError, match="coupled readings of no joint, but the cell file couples"):
        with_chain_of_result(Cell(coupling=coupling), tracked, "r.json")
    other = Cell(coupling={"elbow_joint": {"shoulder_lift_joint": -1.0}})
    with pytest.raises(CalibError, match=r"Leave out \[coupling\]"):
        with_chain_of_result(other, coupled, "r.json")
