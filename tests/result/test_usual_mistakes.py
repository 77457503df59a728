"""The usual mistakes, made on the paper's data: calib names the one that was made, and no other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.estimate.setup import rows_of as rows_and_setup
from calib.example import PAPER_TARGET, paper_urdf
from calib.result.calibrate import calibrate
from calib.result.evaluation import evaluate, hint
from calib.result.support import better_setup
from calib.robot.robot import Robot, read_only
from calib.robot.urdf import Urdf

TURN = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])


def said_of(robot: Robot, cell: Cell, table: Measurements) -> str:
    """What is said of a robot, a cell and a table."""
    rows, setup = rows_and_setup(robot, table, cell)
    return str(better_setup(robot, cell, setup, rows) or "")


def rows_of(table: Measurements, count: int = 30) -> Measurements:
    return table.select(np.arange(len(table)) < count)


def moved(rows: Measurements, R: np.ndarray, p: tuple[float, float, float]) -> Measurements:
    return replace(rows, points=read_only(rows.points @ R.T + np.array(p)))


def test_nothing_is_said_of_a_set_up_that_fits(ur3: Robot, table: Measurements):
    assert said_of(ur3, Cell(), rows_of(table)) == ""
    assert said_of(ur3, Cell(target=read_only(PAPER_TARGET)), rows_of(table)) == ""


def test_a_wrong_base_is_named_with_both_errors(table: Measurements):
    world = Robot.load(paper_urdf(), tip="tool0")
    said = said_of(world, Cell(), rows_of(table))
    assert said == (
        "The nominal robot is 529 mm rms off, which no uncalibrated arm is, and only 2.3 mm if the points are in the "
        "frame of 'base': try --base base."
    )


def test_a_target_with_the_wrong_sign_is_not_taken_for_a_wrong_base(
    ur3: Robot, table: Measurements
):
    wrong = Cell(target=read_only([0.07, -0.07, 0.02252]))
    assert said_of(ur3, wrong, rows_of(table)) == ""
    fixed = replace(wrong, estimate_target=False)
    said = said_of(ur3, fixed, rows_of(table))
    assert said.endswith(
        "only 2.3 mm if the target is found from the data: leave out --fix-target."
    )


def test_a_trackers_frame_is_recognised(ur3: Robot, table: Measurements):
    rows = moved(rows_of(table), TURN, (2.0, 1.0, -0.5))
    said = said_of(ur3, Cell(), rows)
    assert said.endswith(
        " only 1.4 mm if the points are in a frame of their own: try --frame estimate."
    )
    assert said_of(ur3, Cell(), rows_of(replace_points(table, rows), 3)) == ""


def replace_points(table: Measurements, rows: Measurements) -> Measurements:
    return replace(table, points=read_only([*rows.points, *table.points[len(rows) :]]))


def test_nothing_is_said_where_the_frame_is_estimated_or_given(ur3: Robot, table: Measurements):
    rows = moved(rows_of(table), TURN, (2.0, 1.0, -0.5))
    assert said_of(ur3, Cell(estimate_frame=True), rows) == ""
    assert said_of(ur3, Cell(T_frame_base=read_only(np.eye(4))), rows) == ""


def test_nothing_is_said_where_nothing_fits(ur3: Robot, table: Measurements):
    rng = np.random.default_rng(3)
    rows = replace(rows_of(table), joints=read_only(rng.uniform(-3, 3, (30, 6))))
    assert said_of(ur3, Cell(), rows) == ""


def test_a_link_keeps_the_letters_of_its_name(table: Measurements):
    data = paper_urdf().read_bytes().replace(b'"base"', b'"Robot_BASE"')
    robot = Robot.from_urdf(Urdf.from_bytes(data, "r.urdf"), "base_link", "tool0")
    said = said_of(robot, Cell(), rows_of(table))
    assert "try --base Robot_BASE." in said


def test_links_that_move_are_no_bases(serial_chain: Callable[[], Robot]):
    robot = serial_chain()
    rng = np.random.default_rng(1)
    q = rng.uniform(-2, 2, (20, 3))
    poses = robot.poses(q)
    points = poses[:, :3, :3] @ [0.1, 0.05, 0.02] + poses[:, :3, 3]
    rows = moved(Measurements(robot.joint_names, q, points), np.eye(3), (1.0, 0.0, 0.0))
    said = said_of(robot, Cell(), rows)
    assert said.endswith(
        " only 0.0 mm if the points are in the frame of 'stand': try --base stand."
    )


@pytest.fixture
def serial_chain() -> Callable[[], Robot]:
    def build() -> Robot:
        joints = [
            ("turn", "fixed", "stand", "foot", "1 0 0", "1 0 0"),
            ("j1", "revolute", "foot", "l1", "0 0 0.2", "0 0 1"),
            ("j2", "revolute", "l1", "l2", "0.1 0 0", "0 1 0"),
            ("j3", "revolute", "l2", "l3", "0.4 0.1 0", "1 0 0"),
        ]
        links = "".join(f'<link name="{n}"/>' for n in ("stand", "foot", "l1", "l2", "l3"))
        text = f'<robot name="r">{links}' + "".join(
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{xyz}"/><axis xyz="{axis}"/>'
            '<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
            for name, kind, parent, child, xyz, axis in joints
        )
        urdf = Urdf.from_bytes((text + "</robot>").encode(), "chain.urdf")
        return Robot.from_urdf(urdf, "foot", "l3")

    return build


def test_the_verdict_and_the_evaluation_say_it_too(table: Measurements):
    world = Robot.load(paper_urdf(), tip="tool0")
    table = rows_of(table, 14)
    judged = calibrate(world, table, model="zeros").verdict
    assert judged is not None
    assert judged.use == "do not use"
    assert judged.reasons[0].values["link"] == "base"
    assert str(hint(evaluate(world, table), Cell())) == str(judged.reasons[0])


def spoilt(
    rows: Measurements, joints: Any = 1.0, add: Any = 0.0, points: float = 1.0, **order: Any
):
    """The rows with columns times, plus, and in another order."""
    q, p = rows.joints * joints + np.radians(add), points * rows.points
    return replace(
        rows, joints=q[:, order.get("q", range(6))], points=p[:, order.get("p", range(3))]
    )


ELBOW = {"joints": [1, 1, -1, 1, 1, 1]}
SWAPPED = {"q": [0, 2, 1, 3, 4, 5]}


@pytest.mark.parametrize(
    ("mistake", "words"),
    [
        (ELBOW, "if 'elbow_joint' turned the other way"),
        ({"joints": [1, -1, 1, 1, -1, 1]}, "'shoulder_lift_joint' and 'wrist_2_joint' turned the"),
        ({"joints": [-1, 1, 1, -1, 1, -1]}, "'wrist_1_joint' and 'wrist_3_joint' turned the other"),
        ({"add": [0, 90, 0, 0, 0, 0]}, "if -90 deg are added to 'shoulder_lift_joint': check its"),
        ({"add": [0, 0, 0, -180, 0, 0]}, "if 180 deg are added to 'wrist_1_joint': check its zero"),
        (SWAPPED, "if the columns 'shoulder_lift_joint' and 'elbow_joint' are swapped"),
        ({"p": [1, 0, 2]}, "if the columns x and y are swapped"),
        ({"points": 1 / 25.4}, "if the points are inches under [mm]: check the unit"),
        ({"points": 1e-3}, "if the points are metres under [mm]: check the unit"),
        ({"joints": np.degrees(1.0)}, "if the joint values are degrees under [rad]: check the"),
    ],
)
def test_each_usual_mistake_is_named(ur3: Robot, table: Measurements, mistake, words: str):
    said = said_of(ur3, Cell(), spoilt(rows_of(table), **mistake))
    assert words in said
    assert "only 2." in said


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mistake", "words"),
    [
        (ELBOW, "if 'elbow_joint' turned the other way"),
        (SWAPPED, "if the columns 'shoulder_lift_joint' and 'elbow_joint' are swapped"),
    ],
)
def test_mistakes_are_named_under_an_unknown_frame_too(
    ur3: Robot, table: Measurements, mistake, words: str
):
    rows = spoilt(moved(rows_of(table), TURN, (2.0, 1.0, -0.5)), **mistake)
    assert words in said_of(ur3, Cell(estimate_frame=True), rows)
