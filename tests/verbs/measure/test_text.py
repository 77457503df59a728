"""The words of a session: every code has a text that says what to do, and numbers are in the units of people."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from calib.verbs.measure.state import Advice, AdviceCode, NextPose, State
from calib.verbs.measure.stop import Answer, Code, Finding
from calib.verbs.measure.text import (
    BAD,
    COMMANDS,
    GOOD,
    LOOK,
    advice_text,
    answer_lines,
    calibrate_command,
    commands,
    count_text,
    error_text,
    finding_text,
    help_lines,
    joined,
    kept_text,
    late_line,
    opening_lines,
    pose_lines,
    prompt,
    reached_lines,
    state_lines,
    waiting_line,
)
from tests.verbs.measure.rehearsal import Tracker, session_of

STATE = State(
    stops=7,
    measured=8,
    error=2.5e-4,
    low=1.8e-4,
    high=3.2e-4,
    aim=1.5e-4,
    nominal=2.1e-3,
    reached=False,
    needed=(4, 7),
    curve=(),
    advice=(),
    findings=(),
    sigma={"m": 4e-5},
)
REACHED = replace(STATE, high=1.4e-4, reached=True, needed=(0, 0))


@pytest.fixture
def session(ur3, tmp_path):
    with session_of(ur3, tmp_path / "s") as session:
        yield session


def test_a_good_stop_is_one_green_line_with_residual_usual_size_error_and_aim(ur3):
    answer = Answer(7, "good", {"m": 4.1e-5}, {"m": 3.5e-5}, 1.2, 3, (), 4e-4, 3.2e-4)
    ((line, style),) = answer_lines(ur3, answer, STATE)
    assert line == (
        "Stop 7: good | off by 0.041 mm (usual: 0.035 mm) | error at most 0.320 mm, aim 0.150 mm, about 4 to 7 poses "
        "to go"
    )
    assert style == GOOD


def test_an_answer_is_shown_as_its_line():
    answer = Answer(7, "good", {"m": 4.1e-5}, {"m": 3.5e-5}, 1.2, 3, (), 4e-4, 3.2e-4)
    line = "Stop 7: good | off by 0.041 mm (usual: 0.035 mm) | error at most 0.320 mm"
    assert answer.summary() == str(answer) == line
    assert Answer(1, "unknown").summary().endswith("its error is not known yet")
    finding = Finding("not_there", (7,), {"change": 0.1}, "elbow_joint")
    wrong = replace(answer, outcome="again", findings=(finding,)).summary()
    assert wrong.startswith("Stop 7: NOT GOOD, it does not count | off by 0.041 mm")
    assert "'elbow_joint' is off from its value" in wrong


def test_a_stop_that_does_not_count_is_red_and_says_what_to_do(ur3):
    finding = Finding("gross", (7,), {"off_m": 0.0153})
    answer = Answer(7, "again", {"m": 0.0153}, {"m": 3.5e-5}, 900.0, 3, (finding,))
    (line, style), (found, of_finding) = answer_lines(ur3, answer, STATE)
    assert line == "Stop 7: NOT GOOD, it does not count | off by 15.3 mm"
    assert {style, of_finding} == {BAD}
    assert "far off by 15.3 mm" in found
    assert "Measure it again" in " ".join(found.split())
    ((_, _), (advice, _)) = answer_lines(ur3, replace(answer, findings=()), STATE)
    assert "measure it again" in advice


def test_first_stops_are_neither_good_nor_bad(ur3):
    unknown = replace(STATE, error=None, low=None, high=None, needed=None)
    ((line, style),) = answer_lines(ur3, Answer(1, "unknown"), unknown)
    assert line == "Stop 1: taken | too few stops to check it | its error is not known yet"
    assert style == ""


def test_what_has_moved_costs_no_stop(ur3):
    finding = Finding("target_moved", (7,), {"gain": 30.0}, "T1")
    answer = Answer(7, "good", {"m": 4e-5}, {"m": 4e-5}, 1.0, 3, (finding,))
    _, (line, style) = answer_lines(ur3, answer, STATE)
    assert line.strip().startswith(
        "The target 'T1' sits elsewhere since stop 7. That costs no stop"
    )
    assert style == LOOK


@pytest.mark.parametrize("code", get_args(Code))
def test_each_finding_says_what_to_do(ur3, code):
    text = finding_text(ur3, Finding(code, (5, 6), {"stop": 3.0, "off_m": 0.02}))
    assert text.endswith(("again.", "fasten it."))
    assert "stop 5" in text or code in ("swapped", "repeated", "not_there")


def test_a_joint_that_is_elsewhere_is_named_with_its_change(ur3):
    finding = Finding("not_there", (5,), {"change": np.deg2rad(2.0)}, "elbow_joint")
    assert "'elbow_joint' is +2.00 deg from its value" in finding_text(ur3, finding)


@pytest.mark.parametrize("code", get_args(AdviceCode))
def test_each_advice_has_its_numbers(code):
    values = {"share": 0.6, "x_m": 0.1, "y_m": 0.2, "z_m": 0.3, "ratio": 2.0, "factor": 3.0}
    text = advice_text(Advice(code, values, "elbow_joint"))
    for number in {"joint": ["60 %", "elbow_joint"], "region": ["(100, 200, 300) mm", "2.0"]}.get(
        code, []
    ):
        assert number in text


def test_poses_to_go():
    assert error_text(REACHED) == "error at most 0.140 mm, aim 0.150 mm"
    for needed, words in {
        None: "many poses to go",
        (1, 1): "about 1 pose to go",
        (3, 3): "about 3 poses to go",
        (4, 7): "about 4 to 7 poses to go",
        (1, 9): "up to 9 poses to go",
    }.items():
        assert error_text(replace(STATE, needed=needed)).endswith(words)


def test_an_error_below_an_aim_that_is_not_reached_says_why():
    below = replace(STATE, high=1.4e-4, needed=(1, 1))
    moved = replace(below, findings=(Finding("something_moved", (5, 6)),))
    for state, why in ((below, "two stops were found good"), (moved, "undecided what has moved")):
        assert why in error_text(state)
        assert why in " ".join(joined(state_lines(None, state)).split())
        assert "to go" not in error_text(state)
    unknown = replace(moved, error=None, low=None, high=None)
    assert "undecided what has moved" in error_text(unknown)
    assert "undecided what has moved" in joined(state_lines(None, unknown))


def test_an_aim_that_is_reached_is_said():
    assert joined(reached_lines(can_type=False)) == "The aim is reached."
    assert "'done'" in joined(reached_lines(can_type=True))


def test_the_state():
    text = joined(state_lines(None, STATE))  # without findings no robot is needed
    for word in (
        "7 of 8 stops count",
        "0.250 mm, from 0.180 mm to 0.320",
        "2.10 mm",
        "Noise",
        "0.040",
    ):
        assert word in text
    assert joined(state_lines(None, REACHED)).count("reached") == 1
    far_off = replace(STATE, findings=(Finding("gross", (2,)),))
    assert "Stop 2 is far off by now" in joined(state_lines(None, far_off))


def test_a_pose_is_shown_in_degrees_under_its_title(session):
    pose = session.next()
    lines = [*pose_lines(session, pose, session.state)]
    assert lines[1][0].startswith("Stop 1 of up to ")
    shown = [line.split()[-2] for line, _ in lines if line.endswith(" deg")]
    assert [float(value) for value in shown] == pytest.approx(np.degrees(pose.joints), abs=5e-4)
    assert "frame" not in joined(lines)  # nobody knows where the tracker stands
    via = replace(pose, via=pose.joints - 0.1)
    first, then = [line.split()[-3:-1] for line, _ in pose_lines(session, via, session.state)][3]
    assert float(then) - float(first) == pytest.approx(np.degrees(0.1), abs=2e-3)


def test_a_pose_that_is_measured_again_names_its_stop(session):
    pose = session.next()
    again = NextPose(pose.joints, None, pose.expected, pose.targets, None, "again", 4, 0.0)
    assert "Stop 1 repeats stop 4: drive" in joined(pose_lines(session, again, STATE))
    last = replace(again, stop=1)
    assert "Stop 1 once more: drive" in joined(pose_lines(session, last, STATE))


def test_where_the_target_will_be_is_said_once_the_frame_is_known(session):
    pose = replace(session.next(), expected=np.array([[0.8123, 0.0051, -0.4209]]))
    assert "near (812.3, 5.1, -420.9) mm" in joined(pose_lines(session, pose, STATE))
    moved = replace(STATE, findings=(Finding("base_moved", (5, 6)),))
    assert "near" not in joined(pose_lines(session, pose, moved))


def test_a_session_begins_with_its_aim(session):
    text = joined(opening_lines(session, goes_on=False))
    assert "begins" in text
    assert "The aim is 0.100 mm rms over the joint ranges" in text
    assert "goes on with 0 stops" in joined(opening_lines(session, goes_on=True))
    x, y, z = (Tracker(session.robot).points(session.next().joints))[0]
    session.add({"x [mm]": x, "y [mm]": y, "z [mm]": z})
    session.add({"x [mm]": x, "y [mm]": y, "z [mm]": z})  # once more, at another pose
    assert session.state.stops == 1
    assert "goes on with 1 of 2 stops that count" in joined(opening_lines(session, goes_on=True))


def test_prompts_and_what_is_waited_for():
    assert prompt(("x [mm]", "y [mm]", "z [mm]"), "") == "  x y z [mm]> "
    assert prompt(("x [m]", "rx [deg]"), "T1") == "  T1: x [m], rx [deg]> "
    assert "Enter" in waiting_line("webcam:0", (), waits_for_go=True)[0]
    assert "A, B" in waiting_line("tcp:h:1", ("A", "B"), waits_for_go=False)[0]
    assert late_line(1)[0].strip().startswith("A reading came")
    assert late_line(3)[0].strip().startswith("3 readings came")


def test_help_has_every_command():
    text = joined(help_lines(commands(several=True, has_robot=False)))
    assert all(command in text for command in COMMANDS)
    assert {*COMMANDS} - {*commands(several=False, has_robot=False)} == {"enough"}
    assert {*COMMANDS} - {*commands(several=True, has_robot=True)} == {"at J1 J2 ..."}


def test_an_earlier_stop_that_is_far_off_is_not_to_be_measured_again(ur3):
    answer = Answer(7, "good", {"m": 4e-5}, {"m": 4e-5}, findings=(Finding("gross", (2,)),))
    _, (line, style) = answer_lines(ur3, answer, STATE)
    assert line.strip().startswith("Stop 2 is far off by now and no longer counts")
    assert "again" not in line
    assert style == LOOK


@pytest.mark.parametrize(
    ("stops", "measured", "text"),
    [
        (0, 0, "No stop is measured yet."),
        (0, 1, "0 of 1 stop counts."),
        (1, 2, "1 of 2 stops counts."),
        (8, 10, "8 of 10 stops count."),
    ],
)
def test_how_many_stops_count(stops, measured, text):
    assert count_text(stops, measured) == text


def test_how_it_goes_on():
    assert (
        kept_text("s", 1, "calib measure s") == "1 stop is kept in 's'. Go on with: calib measure s"
    )
    assert kept_text("s", 0, "c").startswith("0 stops are kept")
    assert "All 7 stops are kept" in kept_text("s", 7, "c")
    command = calibrate_command("my robot.urdf", "s/t.csv", "s/cell.toml")
    assert command.startswith("calib calibrate 'my robot.urdf' s/t.csv --cell s/cell.toml -o ")
