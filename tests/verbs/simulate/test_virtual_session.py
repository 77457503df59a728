"""Sessions with a virtual operator: what is known beforehand, what is measured again, and the error in truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from calib.data.cell import Cell
from calib.robot.ranges import column_limits
from calib.robot.robot import Robot
from calib.verbs.measure.aim import Aim
from calib.verbs.measure.session import Session
from calib.verbs.measure.stop import Answer, Finding
from calib.verbs.simulate.operator import GROSS, MISTAKES, Mistake, Mistakes, Operator
from calib.verbs.simulate.scenario import Scenario
from calib.verbs.simulate.session_text import heading, legend, result_lines, stop_line
from calib.verbs.simulate.virtual_session import everywhere, known_cell, measure_with, true_error


@pytest.fixture(scope="module")
def virtual(ur3):
    """Only the joints' zeros are wrong, which few stops tell."""
    cell = Cell(estimate_frame=True, model="zeros", sigma={"m": 4e-5})
    return Scenario(ur3, cell, "zeros").draw(3)


@pytest.fixture(scope="module")
def pictures():
    arm = Robot.load("ur5", base="tool0", tip="base_link")
    return Scenario(arm, Cell(kind="pixel")).draw(7)


def session_of(virtual, folder, aim: float = 1e-4) -> Session:
    return Session.start(
        folder,
        virtual.truth.nominal,
        known_cell(virtual, 1),
        Aim(error=aim),
        collisions=False,
        seed=1,
    )


@pytest.mark.slow
def test_a_session_is_measured_until_it_is_enough_and_its_error_is_that(virtual, tmp_path):
    operator = Operator.of(virtual, 1)
    with session_of(virtual, tmp_path / "s") as session:
        stops = [*measure_with(session, operator, 60)]
        state = session.state
        result = session.calibrate()
    assert state.reached
    assert len(stops) == state.measured < 40
    for k, stop in enumerate(stops, start=1):
        assert (stop.measurement.number, stop.answer.stop) == (k, k)
        assert stop.measurement.joints == pytest.approx(stop.proposed.joints, abs=1e-9)
        assert min(stop.seconds) >= 0.0
    assert stops[-1].high == state.high <= 1e-4
    q = everywhere(virtual)
    predicted = result.predict_poses(q, group=result.setup.groups[0])
    assert true_error(virtual, q, predicted) <= 1e-4
    lines = [*result_lines(state, result, 2e-3, 5e-5)]
    assert "0.100 mm" in lines[0]
    assert f"{state.stops} poses" in " ".join(lines)
    assert "2.000 mm" in " ".join(lines)
    assert lines[-1] == f"Verdict: {result.verdict.use}"


@pytest.mark.slow
def test_the_most_stops_are_kept(virtual, tmp_path):
    with session_of(virtual, tmp_path / "s", 1e-6) as session:
        assert len([*measure_with(session, Operator.of(virtual, 1), 5)]) == 5
        assert session.state.measured == 5
        assert len([*measure_with(session, Operator.of(virtual, 2), 7)]) == 2


@pytest.mark.slow
def test_a_pose_that_is_asked_for_again_is_measured_with_care(virtual, tmp_path, ur3):
    mistakes = Mistakes(at={12: GROSS, 13: GROSS}, gross_length=(0.04, 0.05))
    operator = Operator.of(virtual, 1, mistakes)
    with session_of(virtual, tmp_path / "s", 5e-5) as session:
        stops = [*measure_with(session, operator, 60)]
    wrong, again = stops[11], stops[12]
    assert wrong.answer.outcome == "again"
    assert wrong.answer.residual["m"] == pytest.approx(wrong.measurement.mistake.size, rel=0.1)
    assert (again.proposed.joints == wrong.proposed.joints).all()
    assert again.measurement.mistake is None
    assert again.answer.outcome == "good"
    line = stop_line(ur3, wrong)
    assert line.startswith("  12 ")
    degrees = " ".join(f"{value:.1f}" for value in np.degrees(wrong.measurement.joints))
    assert degrees in " ".join(line.split())
    assert f"{1e3 * wrong.measurement.mistake.size:.1f} mm" in line
    assert "again" in line
    assert "in truth" not in stop_line(ur3, again)
    assert len(heading(ur3)) <= 100


@pytest.fixture
def stop(virtual, tmp_path):
    """The first stop of a session."""
    with session_of(virtual, tmp_path / "first", 5e-5) as session:
        return next(measure_with(session, Operator.of(virtual, 1), 1))


@pytest.mark.parametrize("code", [code for code in MISTAKES if code != "missed"])
def test_a_mistake_and_the_finding_of_it_have_the_same_words(ur3, stop, code):
    mistake = Mistake(code, 1, 2e-3)
    answer = Answer(1, "again", findings=(Finding(code, (1,)),))
    plain = replace(stop, measurement=replace(stop.measurement, mistakes=()))
    said = stop_line(ur3, replace(plain, answer=answer)).split("again: ")[1]
    wrong = replace(stop, measurement=replace(stop.measurement, mistakes=(mistake,)))
    assert f"(in truth: {said}, 2.0 mm)" in stop_line(ur3, wrong)


@pytest.mark.parametrize(
    ("finding", "words"),
    [
        (Finding("gross", (9,)), "good; far off"),
        (Finding("gross", (1,)), "good; stop 1: far off"),
        (Finding("target_moved", (7, 8, 9)), "good; target moved since stop 7"),
        (Finding("something_moved", (9,)), "good; something moved"),
    ],
)
def test_a_finding_about_an_earlier_stop_names_it(ur3, stop, finding, words):
    answer = Answer(9, "good", findings=(finding,))
    line = stop_line(ur3, replace(stop, answer=answer))
    assert line.endswith(f"  {words}")
    assert max(map(len, line.splitlines())) <= 100


def test_the_legend_says_what_the_columns_are():
    assert "in mm, at most, with 95 %" in " ".join(legend().split())
    assert max(map(len, legend().splitlines())) <= 100


def test_what_is_known_of_a_tracker_s_cell_is_what_is_stated(virtual):
    assert known_cell(virtual, 1) is virtual.scenario.cell


def test_of_a_camera_and_a_board_it_is_known_where_they_are_about(pictures):
    truth = pictures.truth
    known = known_cell(pictures, 1)
    off = []
    for true, position, rotation in (
        (truth.T_frame_base[0], known.T_frame_base[:3, 3], known.T_frame_base[:3, :3]),
        (truth.T_tip_target[0], known.target, known.target_rotation),
    ):
        off.append(np.linalg.norm(true[:3, :3].T @ (position - true[:3, 3])))
        off.append(np.linalg.norm(pin.log3(true[:3, :3].T @ rotation)))
    assert np.all(np.array(off) > [1e-3, 1e-3, 1e-3, 1e-3])
    assert np.all(np.array(off) < [50e-3, 0.09, 50e-3, 0.09])
    assert known.estimate_frame
    assert known.cameras[""] is pictures.equipment.stated
    assert known.boards[""] is pictures.equipment.printed.board
    assert not np.allclose(known_cell(pictures, 2).target, known.target)


def test_what_the_cell_states_of_them_is_known_exactly(pictures):
    truth = pictures.truth
    cell = replace(
        pictures.scenario.cell,
        T_frame_base=truth.T_frame_base[0],
        target=truth.T_tip_target[0][:3, 3],
        target_rotation=truth.T_tip_target[0][:3, :3],
    )
    virtual = replace(pictures, scenario=replace(pictures.scenario, cell=cell))
    known = known_cell(virtual, 1)
    assert (known.T_frame_base == truth.T_frame_base[0]).all()
    assert (known.target == truth.T_tip_target[0][:3, 3]).all()


def test_the_error_in_truth_is_that_of_the_target_or_of_the_middle_of_the_board(virtual, pictures):
    for cell in (virtual, pictures):
        q = everywhere(cell, 50)
        T = cell.truth.poses(q)
        assert true_error(cell, q, T) == 0.0
        moved = T.copy()
        moved[:, :3, 3] += [3e-3, 0.0, 4e-3]
        assert true_error(cell, q, moved) == pytest.approx(5e-3)
    # The board is turned about its middle.
    centre = pictures.equipment.printed.board.centre
    turn = np.eye(4)
    turn[:3, :3] = pin.exp3(np.array([0.1, 0.2, 0.3]))
    turn[:3, 3] = centre - turn[:3, :3] @ centre
    assert true_error(pictures, q, T @ turn) < 1e-12


def test_poses_everywhere_are_within_the_limits(virtual, ur3):
    q = everywhere(virtual, 400)
    low, high = column_limits(ur3).T
    assert q.shape == (400, 6)
    assert (q >= low).all()
    assert (q <= high).all()
    assert np.ptp(q, axis=0).min() > 5.0
