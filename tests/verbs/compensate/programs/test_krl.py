"""Programs of KUKA: what is read of them, what is left, and where the true arm arrives."""

from __future__ import annotations

import shutil
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.errors import CalibError, MeasurementError
from calib.robot.robot import Robot
from calib.verbs.compensate.programs.correction import corrected
from calib.verbs.compensate.programs.krl import read
from calib.verbs.compensate.programs.program_file import ProgramFile, Stated
from tests.verbs.compensate.arms import off
from tests.verbs.compensate.programs.controller import arrival
from tests.verbs.compensate.programs.kuka_arm import kuka_arm

DATA = Path(__file__).with_name("data") / "kuka"
READ = ("inline", "plain", "flow", "kss8", "wrong", "open")
LIMIT = 5e-6


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return kuka_arm(tmp_path_factory.mktemp("kuka"))


def stated(arm: Robot, **options) -> Stated:
    return Stated(arm.joint_names, robot=arm, **options)


def codes(program: ProgramFile) -> Counter[str]:
    return Counter(f"{item.code} {item.what}".strip() for item in program.left)


def lines(program: ProgramFile) -> list[int]:
    return [move.line for move in program.moves]


def pose(x, y, z, a, b, c) -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = np.array([x, y, z]) / 1e3
    T[:3, :3] = Rotation.from_euler("ZYX", [a, b, c], degrees=True).as_matrix()
    return T


TOOL, BASE = pose(120, 5, 210, 0, 25, 10), pose(900, -300, 400, 30, 0, 0)


def test_inline_forms_have_the_tool_and_base_of_their_settings(arm):
    program = read(DATA / "inline.src", stated(arm))
    assert [text.path.name for text in program.texts] == ["inline.src", "inline.dat", "$config.dat"]
    names = [program.targets[move.target].name for move in program.moves]
    assert names == ["XHOME", "XP1", "XP2", "XP7", "XP1", "XP3", "XP4", "XHOME"]
    motions = [move.motion for move in program.moves]
    assert motions[2:5] == ["linear", "circular", "circular"]
    for move in program.moves[1:7]:
        np.testing.assert_allclose(move.T_tip_tool, TOOL, atol=1e-12)
        np.testing.assert_allclose(move.T_base_frame, BASE, atol=1e-12)
    assert codes(program) == {"external tool XP9 $IPO_MODE": 1}
    target = program.targets[program.moves[2].target]
    assert (program.texts[target.file].path.name, target.line) == ("inline.dat", 11)
    text = program.texts[target.file].text
    assert [text[n.start : n.end] for n in target.numbers][:2] == ["619.289", "-532.604"]


def test_turns_as_constants(arm):
    program = read(DATA / "inline.src", stated(arm))
    target = next(target for target in program.targets if target.name == "XP4")
    ((number, turn),) = target.dependent
    assert number.value == 3
    assert turn(np.radians([-20, -85, 110, -0.5, 55, 170])) == 0b1011


def test_aggregates_in_the_program(arm):
    program = read(DATA / "plain.src", stated(arm))
    assert codes(program) == {
        "partial": 2,
        "relative LIN_REL": 1,
        "external axes ASYPTP": 1,
    }
    numbers = [[n.value for n in program.targets[move.target].numbers] for move in program.moves]
    assert numbers[0] == [10, -80, 95, 5, 40, -20]
    assert numbers[3][:3] == [637.887, -416.64, 440.889523]
    frames = [move.T_base_frame for move in program.moves]
    np.testing.assert_allclose(frames[1], BASE, atol=1e-12)
    np.testing.assert_allclose(frames[5], np.eye(4), atol=1e-12)
    np.testing.assert_allclose(frames[8], BASE @ pose(0, 0, 10, 0, 0, 0), atol=1e-12)


def test_ways_through_a_program(arm):
    program = read(DATA / "flow.src", stated(arm))
    assert codes(program) == {
        "computed POINTS[I]": 1,
        "computed MADE": 1,
        "computed P2": 1,
        "relative P1 : {...}": 1,
        "other file ELSEWHERE()": 1,
        "other file MISSING": 1,
        "relative LIN_REL": 1,
        "computed": 1,
        "external axes WITH_TRACK": 1,
    }
    # Both tools of the branches, and the target of an argument.
    assert lines(program).count(31) == 2
    near = [move for move in program.moves if move.line == 53]
    assert {program.targets[move.target].numbers[0].value for move in near} == {659.329227}
    # Two aggregates that one variable has in turn.
    assert [program.targets[m.target].line for m in program.moves if m.line in (23, 25)] == [22, 24]


def test_settings_behind_a_motion(arm):
    program = read(DATA / "kss8.src", stated(arm))
    assert [move.motion for move in program.moves] == [
        "joint",
        "joint",
        "linear",
        "circular",
        "circular",
    ]
    for move in program.moves[1:]:
        np.testing.assert_allclose(move.T_tip_tool, TOOL, atol=1e-12)
        np.testing.assert_allclose(move.T_base_frame, BASE, atol=1e-12)
    assert codes(program) == {"relative SLIN_REL": 1}


def test_a_track_or_an_unfinished_file(arm):
    program = read(DATA / "open.src", stated(arm))
    assert codes(program)["external axes"] == 1
    np.testing.assert_allclose(program.moves[-1].T_base_frame, np.eye(4))


def test_what_the_files_do_not_define_is_asked_for(arm, tmp_path):
    with pytest.raises(MeasurementError, match=r"--tool .*active.*--frame") as error:
        read(DATA / "unset.src", stated(arm))
    assert "$active" in str(error.value)
    program = read(DATA / "unset.src", stated(arm, tools={"": TOOL}, frames={"": BASE}))
    np.testing.assert_allclose(program.moves[1].T_tip_tool, TOOL)
    for name in ("inline.src", "inline.dat"):
        shutil.copy(DATA / name, tmp_path)
    with pytest.raises(MeasurementError, match=r"tool .1. and base .1."):
        read(tmp_path / "inline.src", stated(arm))
    program = read(tmp_path / "inline.src", stated(arm, tools={"1": TOOL}, frames={"1": BASE}))
    assert codes(program)["other file XHOME"] == 2
    given = stated(arm, data=(DATA / "$config.dat",))
    assert codes(read(tmp_path / "inline.src", given))["other file XHOME"] == 0


def test_the_root_of_the_robot(arm, tmp_path):
    root = "$ROBROOT={X 100.0,Y 0.0,Z 50.0,A 90.0,B 0.0,C 0.0}\n"
    (tmp_path / "$machine.dat").write_text(f"DEFDAT $MACHINE PUBLIC\nFRAME {root}ENDDAT\n")
    shutil.copy(DATA / "plain.src", tmp_path)
    program = read(tmp_path / "plain.src", stated(arm, frames={"1": BASE}))
    expected = np.linalg.inv(pose(100, 0, 50, 90, 0, 0)) @ BASE
    np.testing.assert_allclose(program.moves[1].T_base_frame, expected, atol=1e-12)


def test_status_and_turn(arm):
    program = read(DATA / "inline.src", stated(arm))
    by_name = {target.name: target for target in program.targets}
    flip = np.radians([-12, -70, 100, -150, -35, 200])
    other_wrist = np.radians([-12, -70, 100, 30, 35, 20])
    whole_turn = flip - np.radians([0, 0, 0, 0, 0, 360])
    allowed = by_name["XP3"].configuration(np.array([flip, other_wrist, whole_turn]))
    assert allowed.tolist() == [True, False, False]


@pytest.mark.parametrize("name", READ)
def test_no_errors_change_no_byte(arm, name):
    options = {"frames": {"1": BASE}} if name == "plain" else {}
    program = read(DATA / f"{name}.src", stated(arm, **options))
    result = corrected(program, arm, arm)
    for new, old in zip(result.texts, program.texts, strict=True):
        assert new.text.encode("latin-1") == old.path.read_bytes()


@pytest.mark.parametrize("name", READ)
def test_the_true_arm_arrives(arm, name, tmp_path):
    true = off(arm)
    program = read(DATA / f"{name}.src", stated(arm))
    result = corrected(program, arm, true)
    for text in [*program.texts, *result.texts]:
        (tmp_path / text.path.name).write_bytes(text.text.encode("latin-1"))
    again = read(tmp_path / f"{name}.src", stated(arm, data=(DATA / "$config.dat",)))
    known = np.flatnonzero(result.is_corrected & ~(result.shared[:, 0] > LIMIT))
    assert len(known) >= 2
    before, after = (
        arrival(arm, true, program, one, rows=known, start=START) for one in (program, again)
    )
    assert before.min() > 2e-4
    assert after.max() < LIMIT


START = np.radians([10, -80, 95, 5, 40, -20])


def test_a_configuration_that_no_solution_has_is_named(arm):
    result = corrected(read(DATA / "wrong.src", stated(arm)), arm, off(arm))
    assert [(item.code, item.line) for item in result.left] == [
        ("configuration", 5),
        ("configuration", 6),
    ]


def test_a_turn_follows_its_axis(arm, tmp_path):
    q = np.radians([-20, -85, 110, -2.5, 55, 170])
    T = np.linalg.inv(BASE) @ arm.poses(q)[0] @ TOOL
    a, b, c = Rotation.from_matrix(T[:3, :3]).as_euler("ZYX", degrees=True)
    x, y, z = 1e3 * T[:3, 3]
    (tmp_path / "t.src").write_text(
        f"DEF t()\n$TOOL={{X 120,Y 5,Z 210,A 0,B 25,C 10}}\n$BASE={{X 900,Y -300,Z 400,A 30,B 0,C 0}}\n"
        f"PTP {{X {x:.6f},Y {y:.6f},Z {z:.6f},A {a:.6f},B {b:.6f},C {c:.6f},S 2,T 'B001011'}}\nEND\n"
    )
    program = read(tmp_path / "t.src", stated(arm))
    zeros = arm.placements.copy()
    turn = np.radians(6.0)
    zeros[3, :3, :3] = zeros[3, :3, :3] @ Rotation.from_rotvec([turn, 0, 0]).as_matrix()
    result = corrected(program, arm, arm.with_placements(zeros))
    assert "T 'B000011'" in result.texts[0].text
    assert result.commands[0].q[0, 3] > np.radians(2.0)


@pytest.mark.parametrize("text", ["", "MODULE x\nENDMODULE\n", "DEFDAT x\nENDDAT\n", "\0\xff{{{"])
def test_what_is_not_a_program_is_refused(arm, tmp_path, text):
    (tmp_path / "p.src").write_text(text, encoding="latin-1")
    with pytest.raises(CalibError):
        read(tmp_path / "p.src", stated(arm))


def test_other_joints_need_the_names_of_axes():
    panda = Robot.load("panda", tip="panda_link8")
    with pytest.raises(MeasurementError, match="joint_a1"):
        read(DATA / "plain.src", Stated(panda.joint_names, robot=panda))


def test_an_interrupt_has_the_tool_of_the_program(arm, tmp_path):
    text = (DATA / "plain.src").read_text().replace("base_data[1]", "$nullframe")
    start = "interrupt decl 3 when $in[1] do aside()\nptp {a1 10,"
    text = (
        text.replace("ptp {a1 10,", start, 1) + "def aside()\nlin {x 1,y 2,z 3,a 4,b 5,c 6}\nend\n"
    )
    (tmp_path / "p.src").write_text(text)
    move = read(tmp_path / "p.src", stated(arm)).moves[-1]
    np.testing.assert_allclose(move.T_tip_tool, TOOL, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("GOTO ON\n$TOOL={B}\nON:\nLIN {P}\n", {9: {1}}),
        ("BACK:\nLIN {P}\n$TOOL={B}\nGOTO BACK\n", {7: {1, 2}}),
        ("GOTO ON\n$TOOL={B}\nLIN {P}\nON: LIN {P}\n", {8: {2}, 9: {1}}),
        ("IF X THEN\n$TOOL={B}\nRETURN\nENDIF\nLIN {P}\n", {10: {1}}),
        ("SUB()\nLIN {P}\nEND\nDEF SUB()\nIF X THEN\n$TOOL={B}\nRETURN\nENDIF\n", {7: {1, 2}}),
    ],
)
def test_jumps_pass_over_settings(arm, tmp_path, text, expected):
    tool = "{{X 0,Y 0,Z {},A 0,B 0,C 0}}".format
    start = f"DEF PROG()\n$TOOL={tool(100)}\n$BASE=$WORLD\nINT X\nPTP {{A1 0,A2 -90,A3 90,A4 0,A5 20,A6 0}}\n"
    body = text.replace("{B}", tool(200)).replace("{P}", "{X 1200,Y 0,Z 900,A 0,B 90,C 0}")
    path = tmp_path / "prog.src"
    path.write_text(start + body + "END\n")
    program = read(path, stated(arm))
    tools: dict[int, set[int]] = {}
    for move in program.moves[1:]:
        tools.setdefault(move.line, set()).add(round(10 * move.T_tip_tool[2, 3]))
    assert tools == expected
    assert program.left == ()
