from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.errors import MeasurementError
from calib.robot.robot import Robot
from calib.verbs.compensate.programs.correction import corrected
from calib.verbs.compensate.programs.fanuc_ls import read
from calib.verbs.compensate.programs.program_file import ProgramFile, Stated, Target
from tests.verbs.compensate.arms import off
from tests.verbs.compensate.programs.industrial_arm import FROM_HORIZONTAL, NAMES, industrial_arm
from tests.verbs.compensate.programs.makers_files import run

DATA = Path(__file__).parent / "data" / "fanuc"
VARIABLES = DATA / "dumps" / "SYSFRAME.VA"
LIST = DATA / "dumps" / "FRAME.DG"

#: Joint readings of the arm at positions of the programs [deg].
Q = np.array(
    [
        [10, 5, -15, 20, -60, 30],
        [-25, 20, -25, -15, -70, 100],
        [35, -10, -5, 40, -80, -60],
        [5, 30, -35, -30, -45, 10],
        [-40, 12, -20, 60, -75, 150],
        [20, 15, -20, 5, -85, -120],
    ]
)

#: What each program has: lines, positions and motions; lines, reasons and words of what is left.
PROGRAMS: dict[str, tuple[list[tuple[int, str, str]], list[tuple[int, str, str]]]] = {
    "lines": (
        [
            (18, "P[1]", "joint"),
            (19, "P[2]", "linear"),
            (20, "P[3]", "linear"),
            (21, "P[4]", "linear"),
            (24, "P[2]", "linear"),
            (25, "P[5]", "joint"),
        ],
        [],
    ),
    "joints": (
        [
            (14, "P[1]", "joint"),
            (15, "P[2]", "linear"),
            (16, "P[3]", "joint"),
            (17, "P[1]", "joint"),
        ],
        [],
    ),
    "arcs": (
        [
            (14, "P[1]", "linear"),
            (15, "P[2]", "circular"),
            (15, "P[3]", "circular"),
            (17, "P[4]", "circular"),
            (17, "P[5]", "circular"),
            (19, "P[6]", "circular"),
            (20, "P[7]", "circular"),
            (21, "P[8]", "circular"),
            (22, "P[9]", "linear"),
            (23, "P[10]", "linear"),
        ],
        [],
    ),
    "registers": (
        [(17, "P[1]", "linear")],
        [
            (14, "other file", "PR[1]"),
            (15, "computed", "PR[2]"),
            (18, "relative", "P[2]"),
            (19, "relative", "P[2]"),
            (20, "relative", "P[3]"),
            (21, "computed", "P[1]"),
            (22, "search", "P[4]"),
            (23, "computed", "P[R[5]]"),
            (24, "computed", "P[5]"),
            (26, "computed", "L PAL_1[A_1]"),
            (27, "relative", "P[1]"),
            (28, "relative", "P[6]"),
            (29, "relative", "PR[R[1]]"),
            (30, "partial", "P[8]"),
            (71, "unused", "P[7]"),
        ],
    ),
    "frames": (
        [(16, "P[1]", "linear"), (19, "P[3]", "linear"), (22, "P[5]", "joint")],
        [(18, "computed", "P[2]"), (21, "computed", "P[4]")],
    ),
    "groups": (
        [(14, "P[1]", "joint"), (17, "P[4]", "joint"), (18, "P[5]", "joint")],
        [
            (15, "external axes", "P[2]"),
            (16, "external axes", "P[3]"),
            (19, "external axes", "P[6]"),
            (20, "group", "P[7]"),
        ],
    ),
    "german": (
        [(17, "P[1]", "joint"), (22, "P[2]", "linear"), (26, "P[1]", "linear")],
        [(25, "relative", "P[3]"), (27, "search", "P[2]"), (28, "external tool", "P[4]")],
    ),
    "untidy": (
        [(6, "P[1]", "linear"), (10, "P[2]", "linear"), (11, "P[3]", "linear")],
        [
            (14, "partial", "P[4]"),
            (15, "unread", "W P[1] 100mm/sec FINE"),
            (16, "partial", "P[5]"),
            (44, "unused", "P[9]"),
        ],
    ),
    "turns": (
        [
            (14, "P[1]", "joint"),
            (15, "P[2]", "joint"),
            (16, "P[3]", "joint"),
            (17, "P[4]", "joint"),
            (18, "P[1]", "joint"),
        ],
        [],
    ),
    "sensors": (
        [(17, "P[1]", "joint"), (24, "P[3]", "linear")],
        [
            (19, "relative", "P[2]"),
            (22, "search", "P[2]"),
            (26, "force", "P[1]"),
            (28, "search", "P[4]"),
        ],
    ),
    "conveyor": ([], [(19, "conveyor", "P[1]"), (20, "conveyor", "P[2]")]),
}


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return industrial_arm(tmp_path_factory.mktemp("arm"), FROM_HORIZONTAL)


@pytest.fixture(scope="module")
def stated(robot: Robot) -> Stated:
    return Stated(NAMES, data=(VARIABLES,), robot=robot)


def pose(values: np.ndarray) -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = values[:3]
    T[:3, :3] = Rotation.from_euler("xyz", values[3:]).as_matrix()
    return T


def numbers(target: Target) -> np.ndarray:
    return np.array([number.value for number in target.numbers]) * target.scales


def tips(program: ProgramFile) -> list[np.ndarray]:
    """T_base_tip of each motion to a pose."""
    found = []
    for move in program.moves:
        target = program.targets[move.target]
        if target.convention is not None:
            T_tool_tip = np.linalg.inv(move.T_tip_tool)
            found.append(move.T_base_frame @ pose(numbers(target)) @ T_tool_tip)
    return found


@pytest.mark.parametrize("name", PROGRAMS)
def test_every_motion_is_read_or_named(name: str, stated: Stated) -> None:
    path = DATA / f"{name}.ls"
    program = read(path, stated)
    moves = [(move.line, program.targets[move.target].name, move.motion) for move in program.moves]
    left = [(item.line, item.code, item.what) for item in program.left]
    assert (moves, left) == PROGRAMS[name]
    # Each byte is a character, and each number stands where the target says.
    (text,) = program.texts
    assert text.text.encode("latin-1") == path.read_bytes()
    for target in program.targets:
        assert text.line_at(target.numbers[0].start) == target.line
        for number in [*target.numbers, *(number for number, _ in target.dependent)]:
            assert float(text.text[number.start : number.end]) == number.value


def test_poses_are_in_their_frames_and_of_their_tools(robot: Robot, stated: Stated) -> None:
    reached = robot.poses(np.radians(Q[[0, 1, 2, 3, 1, 4]]))
    found = np.array(tips(read(DATA / "lines.ls", stated)))
    # Three decimals, of a tool at 0.2 m.
    assert np.abs(found - reached).max() < 1e-5
    # Frame and tool in effect, of a position that names none.
    (first, third) = tips(read(DATA / "frames.ls", stated))
    assert np.abs(first - robot.poses(np.radians(Q[0]))[0]).max() < 1e-5
    assert np.abs(third - robot.poses(np.radians(Q[2]))[0]).max() < 1e-5


def test_joint_values_are_those_of_the_first_group(stated: Stated) -> None:
    program = read(DATA / "joints.ls", stated)
    first, _, third = program.targets
    assert first.convention is None
    assert np.degrees(numbers(first)) == pytest.approx(Q[0], abs=1e-12)
    assert np.degrees(numbers(third)) == pytest.approx(Q[2], abs=1e-12)
    # A tool that is not defined does not matter to joint values.
    assert program.moves[0].T_tip_tool is not None
    assert program.moves[2].T_tip_tool is None


def test_a_list_of_frames_has_one_decimal(robot: Robot, stated: Stated) -> None:
    fine = tips(read(DATA / "lines.ls", stated))
    program = read(DATA / "lines.ls", Stated(NAMES, data=(LIST,), robot=robot))
    coarse = tips(program)
    assert 1e-6 < np.abs(np.array(fine) - coarse).max() < 1e-4
    # Of the tools' rows, the second; jog frames are none.
    assert program.moves[0].T_tip_tool[:3, 3] == pytest.approx([0.0355, -0.0122, 0.1821], abs=1e-9)


def test_a_configuration_allows_one_solution(robot: Robot, stated: Stated) -> None:
    program = read(DATA / "turns.ls", stated)
    q = np.radians([[170, 10, -20, 15, -60, 179.9], [10, 20, -30, 185, 60, -200]])
    for i in range(2):
        allows = program.targets[i].configuration
        flipped = q[i] * [1, 1, 1, 1, -1, 1] + [0, 0, 0, -np.pi, 0, np.pi]
        assert np.abs(robot.poses(flipped) - robot.poses(q[i])).max() < 1e-12
        others = [flipped, flipped - [0, 0, 0, 0, 0, 2 * np.pi]]
        for joint in (0, 3, 5):
            turn = np.zeros(6)
            turn[joint] = 2 * np.pi
            others += [q[i] + turn, q[i] - turn]
        assert list(allows(np.array([q[i], *others]))) == [True] + [False] * len(others)
    # In the third the wrist is behind axis 1, in the fourth the elbow is down.
    assert not program.targets[2].configuration(q).any()
    assert not program.targets[3].configuration(q).any()


def test_turns_follow_the_joint_values(stated: Stated) -> None:
    target = read(DATA / "turns.ls", stated).targets[1]
    q = np.radians([10, 20, -30, 185, 60, -200])
    assert [number.value for number, _ in target.dependent] == [0, 1, -1]
    assert [function(q) for _, function in target.dependent] == [0, 1, -1]
    q = np.radians([-181, 20, -30, 179.9, 60, 180.1])
    assert [function(q) for _, function in target.dependent] == [-1, 0, 1]
    # The controller wrote a turn for joint 4 at 180 deg, which rounding of the pose puts just below.
    q = np.radians([10, 20, -30, 179.995, 60, -200])
    assert [function(q) for _, function in target.dependent] == [0, 1, -1]
    assert target.configuration(q[None]).all()


def test_what_a_controller_showed(tmp_path: Path) -> None:
    """An LR Mate 200iD/4S: joint readings with two decimals, and the pose of its flange, N U T, 0, 0, 0."""
    arm = industrial_arm(tmp_path, FROM_HORIZONTAL, (0.0, 0.26, 0.02, 0.29, 0.07))
    q = np.radians([-1.15, -4.36, -13.64, 15.21, -42.72, -7.81])
    shown = [305.62, -18.57, 153.63, 167.41, -33.97, 2.99]
    T = pose(np.array(shown) * ([1e-3] * 3 + [np.pi / 180] * 3))
    found = arm.poses(q)[0]
    assert np.abs(found[:3, 3] - T[:3, 3]).max() < 5e-5
    assert np.abs(found[:3, :3] - T[:3, :3]).max() < 1.5e-4

    words = "X = {} mm, Y = {} mm, Z = {} mm, W = {} deg, P = {} deg, R = {} deg".format(*shown)
    path = tmp_path / "shown.ls"
    path.write_text(
        "/PROG SHOWN\n/MN\n1:J P[1] 10% FINE ;\n/POS\nP[1]{\n GP1:\n UF : 0, UT : 0, CONFIG : 'N U T, 0, 0, 0',\n"
        f"{words}\n}};\n/END\n"
    )
    (target,) = read(path, Stated(NAMES, robot=arm)).targets
    assert target.configuration(q[None]).all()
    assert not target.configuration(
        (q * [1, 1, 1, 1, -1, 1] + [0, 0, 0, np.pi, 0, np.pi])[None]
    ).any()


def test_all_that_is_not_defined_is_asked_for_at_once(robot: Robot) -> None:
    with pytest.raises(MeasurementError) as caught:
        read(DATA / "frames.ls", Stated(NAMES, robot=robot))
    assert "'1', '2'" in str(caught.value)
    tool, frame = np.eye(4), np.eye(4)
    tool[2, 3], frame[0, 3] = 0.1, 0.5
    program = read(DATA / "lines.ls", Stated(NAMES, {"": tool}, {"1": frame}))
    assert np.array_equal(program.moves[0].T_tip_tool, tool)
    assert np.array_equal(program.moves[0].T_base_frame, frame)
    # Tool 0 is the flange, frame 0 the world.
    assert np.array_equal(program.moves[-1].T_tip_tool, np.eye(4))
    assert np.array_equal(program.moves[-1].T_base_frame, np.eye(4))


def test_dumps_beside_a_program_are_read(tmp_path: Path) -> None:
    (tmp_path / "sysframe.va").write_bytes(VARIABLES.read_bytes())
    (tmp_path / "lines.ls").write_bytes((DATA / "lines.ls").read_bytes())
    assert len(read(tmp_path / "lines.ls", Stated(NAMES)).moves) == 6


@pytest.mark.parametrize(
    "text",
    [
        "map = (f, xs) --> [f x for x in xs]\n",
        "",
        "/PROG NOTHING\n/ATTR\n/END\n",
        # A number that is none, an index of superscripts and one of many digits: left, and tool 1 is missing.
        "/PROG ODD\n/MN\n1:L P[1] 1mm/sec FINE ;\n2:L P[\xb2] 1mm/sec FINE ;\n3:L P["
        + "9" * 5000
        + "] FINE ;\n"
        "4:PR[GP1]=LPOS ;\n5:L P[2] 1mm/sec FINE ;\n/POS\nP[1]{\n GP1:\n UF : 0, UT : 0,\n X = 1e999 mm, Y = 0 mm, "
        "Z = 0 mm, W = 0 deg, P = 0 deg, R = 0 deg\n};\nP[2]{\n GP1:\n UF : 0, UT : 1,\n X = 1 mm, Y = 0 mm, "
        "Z = 0 mm, W = 0 deg, P = 0 deg, R = 0 deg\n};\n",
        "/PROG TWICE\n/MN\n/POS\nP[1]{\n};\nP[1]{\n};\n/END\n",
        "/PROG SEVEN\n/MN\n1:J P[1] 10% FINE ;\n/POS\nP[1]{\n GP1:\n UF : 0, UT : 0,\n J1 = 0 deg, J2 = 0 deg\n};\n",
    ],
)
def test_other_texts_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "some.ls"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(MeasurementError, match=r"some\.ls"):
        read(path, Stated(NAMES))


def test_a_data_file_that_has_no_frames_is_refused(tmp_path: Path) -> None:
    other = tmp_path / "posreg.va"
    other.write_text("[*POSREG*]$POSREG  Storage: SHADOW\n")
    with pytest.raises(MeasurementError, match=r"posreg\.va"):
        read(DATA / "lines.ls", Stated(NAMES, data=(VARIABLES, other)))


#: Programs with motions that are corrected; the search for all solutions of poses takes its time.
SOME_SLOW = [
    pytest.param(name, marks=[] if name in ("joints", "registers") else pytest.mark.slow)
    for name, (moves, _) in PROGRAMS.items()
    if moves
]


@pytest.mark.parametrize("name", SOME_SLOW)
def test_without_errors_no_byte_changes(
    name: str, robot: Robot, stated: Stated, tmp_path: Path
) -> None:
    path = DATA / f"{name}.ls"
    result, away = run(path, stated, robot, robot, tmp_path)
    assert result.texts[0].text.encode("latin-1") == path.read_bytes()
    assert result.is_corrected.all()
    assert away.max() < 1e-9


@pytest.mark.parametrize("name", SOME_SLOW)
def test_the_true_arm_arrives(name: str, robot: Robot, stated: Stated, tmp_path: Path) -> None:
    path = DATA / f"{name}.ls"
    result, away = run(path, stated, robot, off(robot, 3), tmp_path)
    # Arms are 5 mm off. Lines of other numbers, comments and line ends stay.
    assert away.max() < 2e-7
    assert result.is_corrected.all()
    before = path.read_bytes().decode("latin-1").split("\n")
    after = result.texts[0].text.split("\n")
    assert len(after) == len(before)
    changed = [i for i, (old, new) in enumerate(zip(before, after, strict=True), 1) if old != new]
    lines = {target.line for target in result.program.targets}
    assert {line for line in lines if line in changed} == lines
    assert len(changed) <= 3 * len(lines)


def test_a_program_without_motions_that_can_be_corrected_says_why(
    robot: Robot, stated: Stated
) -> None:
    program = read(DATA / "conveyor.ls", stated)
    with pytest.raises(MeasurementError, match=r"conveyor\.ls.*'conveyor'"):
        corrected(program, robot, robot)


@pytest.mark.slow
def test_a_correction_beyond_half_a_turn_changes_the_turn(
    robot: Robot, stated: Stated, tmp_path: Path
) -> None:
    """Joint 6 at 179.9 deg, of which one of two corrections leads over 180 deg."""
    text = (DATA / "turns.ls").read_text()
    for line in ("J P[3]", "J P[4]"):
        text = text.replace(line, f"!{line}")
    path = tmp_path / "turns.ls"
    path.write_text(text)
    turns = set()
    for seed in range(4):
        result, away = run(path, stated, robot, off(robot, seed), tmp_path.parent)
        assert away.max() < 2e-7
        line = result.texts[0].text.split("P[1]{")[1].split("\n")[2]
        turns.add(line.split("'")[1])
    assert turns == {"N U T, 0, 0, 0", "N U T, 0, 0, 1"}
