"""URScript programs: own ones with what is usual and what is treacherous, read, corrected, run by a simulated arm."""

from __future__ import annotations

import gzip
import shutil
from collections import Counter
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from calib.errors import MeasurementError
from calib.verbs.compensate.programs.dialects import DIALECTS
from calib.verbs.compensate.programs.program_file import ProgramFile, Stated
from calib.verbs.compensate.programs.urscript import read
from calib.verbs.convert.ur_arms import ur_robot
from tests.verbs.compensate.arms import off
from tests.verbs.compensate.programs.listing import corrected_in_place, left, motions, values

DATA = Path(__file__).parent / "data" / "urscript"
NOMINAL = ur_robot("ur5e")
NAMES = NOMINAL.joint_names
START = np.deg2rad([-90, -80, 100, -110, -90, 0])

BENCH = pin.SE3(pin.exp3(np.array([0, 0, 0.3])), np.array([0.2, -0.4, 0.1])).homogeneous
INSTALLED = pin.SE3(np.eye(3), np.array([0, 0, 0.1])).homogeneous
STATED = Stated(NAMES, tools={"TCP": INSTALLED}, frames={"Bench": BENCH})

P, Q = "p[0.3,-0.4,0.2,0,3.1,0]", "[-1.5,-1.4,1.7,-1.9,-1.6,0.1]"


def of(text: str, tmp_path: Path, stated: Stated = STATED) -> ProgramFile:
    path = tmp_path / "own.script"
    path.write_text(text)
    return read(path, stated)


def tools(program: ProgramFile) -> list[float]:
    """The height of each motion's TCP over the flange."""
    return [round(float(move.T_tip_tool[2, 3]), 6) for move in program.moves]


# What is read of each program


def test_program_of_polyscope() -> None:
    program = read(DATA / "polyscope.script", Stated(NAMES))
    assert motions(program) == [
        (26, "joint", "Waypoint_1_p"),
        (28, "linear", "Waypoint_2_p"),
        (30, "linear", ""),
        (31, "circular", "Via_p"),
        (31, "circular", ""),
        (36, "joint", ""),
    ]
    assert left(program) == [(20, "unused"), (21, "unused")]
    assert tools(program) == [0.15] * 6
    near = program.targets[0].configuration
    assert near is not None
    q = np.deg2rad([[-90, -80, 100, -110, -90, 0], [-90, -80, 100, -110, -90, 360]])
    assert near(q).tolist() == [True, False]
    assert near(q[::-1]).tolist() == [False, True]
    assert program.targets[1].configuration is None


def test_lines_without_a_function() -> None:
    program = read(DATA / "lines.script", Stated(NAMES))
    assert [(line, kind) for line, kind, _ in motions(program)] == [
        (3, "joint"),
        (4, "joint"),
        (5, "linear"),
        (6, "linear"),
        (7, "joint"),
        (8, "linear"),
        (9, "circular"),
        (9, "circular"),
    ]
    is_pose = [program.targets[move.target].convention is not None for move in program.moves]
    assert is_pose == [False, True, False, True, False, True, True, True]
    assert left(program) == []


def test_features() -> None:
    program = read(DATA / "frames.script", STATED)
    assert motions(program) == [
        (7, "joint", ""),
        (8, "linear", ""),
        (9, "linear", "inside"),
        (10, "linear", ""),
        (11, "joint", ""),
        (12, "linear", ""),
        (13, "linear", "corner"),
    ]
    assert left(program) == [(14, "relative"), (15, "relative")]
    plane = pin.SE3(pin.exp3(np.array([0, 0, np.pi / 4])), np.array([0.1, -0.5, 0.05]))
    inner = pin.SE3(np.eye(3), np.array([0.02, 0.03, 0]))
    frames = [move.T_base_frame for move in program.moves]
    np.testing.assert_allclose(frames[1], plane.homogeneous)
    np.testing.assert_allclose(frames[3], (plane * inner).homogeneous)
    np.testing.assert_allclose(frames[5], BENCH)
    with pytest.raises(MeasurementError, match="Bench"):
        read(DATA / "frames.script", Stated(NAMES))


def test_functions_and_variables() -> None:
    program = read(DATA / "functions.script", Stated(NAMES))
    assert motions(program) == [
        (16, "joint", "q_home"),
        (6, "linear", ""),
        (8, "linear", "above"),
        (6, "linear", ""),
        (6, "linear", "goal"),
        (22, "linear", "goal"),
        (24, "joint", "goal"),
        (6, "linear", "above"),
        (35, "joint", "next"),
        (35, "joint", "next"),
    ]
    lines = [program.targets[move.target].line for move in program.moves]
    assert lines == [3, 17, 2, 18, 19, 21, 21, 2, 31, 33]
    assert left(program) == [(36, "other file"), (39, "computed")]
    assert tools(program) == [0.15] * 10


def test_what_the_program_makes_as_it_runs() -> None:
    program = read(DATA / "computed.script", Stated(NAMES))
    assert motions(program) == [(4, "joint", ""), (5, "joint", ""), (30, "linear", "start")]
    in_degrees = program.targets[1]
    np.testing.assert_allclose(
        np.rad2deg(values(in_degrees)), [-90, -80, 100.5, -110, -90, 0], atol=1e-12
    )
    assert Counter(code for _, code in left(program)) == {
        "relative": 5,
        "computed": 6,
        "unused": 1,
    }
    assert [line for line, _ in left(program)] == [6, 7, 8, 11, 13, 16, 20, 25, 26, 27, 28, 29]


def test_forces_conveyors_and_speeds() -> None:
    program = read(DATA / "forces.script", Stated(NAMES))
    assert [line for line, _, _ in motions(program)] == [3, 7, 11, 12, 24]
    assert left(program) == [
        (5, "force"),
        (9, "conveyor"),
        (13, "relative"),
        (14, "relative"),
        (16, "force"),
        (19, "computed"),
        (21, "unread"),
        (22, "other file"),
    ]


def test_tcp_of_each_motion() -> None:
    program = read(DATA / "tcps.script", STATED)
    lines = [line for line, _, _ in motions(program)]
    assert lines == [3, 4, 6, 8, 10, 13, 15]
    assert tools(program)[:6] == [0.1, 0.1, 0.15, 0.2, 0.2, 0.15]
    assert program.moves[4].target == program.moves[5].target
    assert left(program) == [(16, "other file"), (17, "computed")]
    with pytest.raises(MeasurementError, match=r"line 4 .*--tool \"TCP="):
        read(DATA / "tcps.script", Stated(NAMES))
    # One option for what the program does not say.
    assert tools(read(DATA / "tcps.script", Stated(NAMES, tools={"": INSTALLED})))[1] == 0.1


def test_text_of_another_program() -> None:
    program = read(DATA / "post.urscript", Stated(NAMES))
    assert motions(program) == [
        (5, "joint", "pQ"),
        (5, "linear", ""),
        (6, "joint", ""),
        (10, "linear", ""),
        (12, "linear", ""),
    ]
    assert left(program) == []
    assert tools(program)[1] == 0.15
    text = program.texts[0].text
    last = program.targets[2].numbers[-1]
    assert text[last.start : last.end] == "+.25"


# The whole way


@pytest.mark.parametrize(
    "name",
    [
        "polyscope.script",
        pytest.param("lines.script", marks=pytest.mark.slow),
        "frames.script",
        pytest.param("functions.script", marks=pytest.mark.slow),
        "computed.script",
        "forces.script",
        "tcps.script",
        "post.urscript",
    ],
)
def test_the_true_arm_arrives(name: str, tmp_path: Path) -> None:
    shutil.copy(DATA / name, tmp_path)

    def reader(path: Path) -> ProgramFile:
        return read(path, STATED)

    old = (tmp_path / name).read_bytes()
    true = off(NOMINAL, seed=3)
    done, before, after = corrected_in_place(reader, tmp_path / name, NOMINAL, true, START)
    assert before.max() > 1e-3
    # Two motions of tcps.script go to one target with different tools: the mean is best there.
    alone = np.linalg.norm(done.shared, axis=1) < 1e-9
    assert alone.sum() >= len(alone) - 2
    assert after[alone].max() < 1e-6
    assert (after < 0.5 * before.max()).all()
    assert (tmp_path / name).read_bytes().count(b"\n") == old.count(b"\n")


# Traps one by one


@pytest.mark.parametrize(
    ("text", "codes"),
    [
        (f"movel({P})", []),
        (f"def a():\n  movel({P})\nend", []),
        (
            f"def a():\n  x = {P}\n  thread b():\n    x = {Q}\n  end\n  run b()\n  movel(x)\nend",
            ["computed"],
        ),
        (f"def a():\n  movel({P}\nend", []),
        ("movel()", ["unread"]),
        (f"get_part()\nset_home()\ntool_change(1)\nmovel({P})", ["other file"] * 3),
        (
            f'set_payload(1)\nx = get_tcp_force()\nsocket_open("a", 1)\nset_tool_voltage(0)\nmovel({P})',
            [],
        ),
        (f"movec({P})", ["unread"]),
        (f"x = {P}\nmovel(x)\nx[2] = 0.3\n", []),
        (f"x = {P}\nwhile True:\n  movel(x)\n  x[2] = 0.3\nend", ["computed"]),
        (f"def f(x):\n  movel(x)\nend\nf({P})\nf(get_actual_tcp_pose())", ["relative"]),
        ("movel(somewhere)", ["other file"]),
        ("movel(pose_trans(get_target_tcp_pose(), p[0,0,1,0,0,0]))", ["relative"]),
        ("movel([1,2,3])", ["computed"]),
        (f"movej(get_inverse_kin({Q}))", ["computed"]),
        (f"x = [{P}, {P}]\nmovel(x[0])", ["computed"]),
        (f"def f():\n  return {P}\nend\nmovel(f())", ["computed"]),
        (f"movel(pose_trans({P}, {P}))", []),
        ('mc_load_path("a.nc", False)', ["other file"]),
        (f"def f():\n  f()\n  movel({P})\nend", []),
        (
            f"x = 1\nif x == 1:\n  movel({P})\nelif x == 2:\n  movel({P})\nelse:\n  movel({P})\nend\nhalt",
            [],
        ),
        ('textmsg("movel(", 1)\nsleep(1)\nmovel(p[0,0,0,0,0,0], 1, 2)', []),
    ],
)
def test_one_by_one(text: str, codes: list[str], tmp_path: Path) -> None:
    assert [code for _, code in left(of(text, tmp_path))] == codes


def test_inverse_kinematics_with_a_tcp_of_its_own(tmp_path: Path) -> None:
    text = (
        f"set_tcp(p[0,0,0.3,0,0,0])\nmovej(get_inverse_kin({P}, {Q}, 0.1, 0.1, p[0,0,0.4,0,0,0]))\n"
    )
    assert tools(of(text, tmp_path)) == [0.4]


def test_poses_of_another_script(tmp_path: Path) -> None:
    other = tmp_path / "features.script"
    other.write_text("def x():\n  global Plane = p[0,0,0.5,0,0,0]\nend\n")
    text = "set_tcp(p[0,0,0.3,0,0,0])\nmovel(pose_trans(Plane, p[0.3,-0.4,-0.2,0,3.1,0]))"
    program = of(text, tmp_path, Stated(NAMES, data=(other,)))
    assert program.moves[0].T_base_frame is not None
    assert program.moves[0].T_base_frame[2, 3] == 0.5
    assert len(program.texts) == 1


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.urp", b"<URProgram/>"),
        ("b.script", gzip.compress(b"<URProgram/>", mtime=0)),
        ("c.script", b"function init(self)\n  self.x = 1\nend\n"),
        ("d.script", b""),
        ("e.script", bytes(range(256))),
        ("f.script", "movel(p[0,0,0,0,0,0])".encode("utf-16")),
    ],
)
def test_other_files_are_refused(name: str, content: bytes, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(MeasurementError, match=name):
        read(tmp_path / name, STATED)


def test_arm_of_seven_joints(tmp_path: Path) -> None:
    with pytest.raises(MeasurementError, match="7"):
        of(f"movel({P})", tmp_path, Stated((*NAMES, "more")))


def test_endings() -> None:
    assert {DIALECTS[ending].read for ending in (".script", ".urscript", ".urp")} == {read}
