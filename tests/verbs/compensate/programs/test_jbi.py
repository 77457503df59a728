from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.errors import MeasurementError
from calib.robot.robot import Robot
from calib.verbs.compensate.programs.correction import corrected
from calib.verbs.compensate.programs.jbi import read
from calib.verbs.compensate.programs.program_file import ProgramFile, Stated, Target
from tests.verbs.compensate.arms import off
from tests.verbs.compensate.programs.industrial_arm import NAMES, industrial_arm
from tests.verbs.compensate.programs.makers_files import run

DATA = Path(__file__).parent / "data" / "yaskawa"
FILES = (DATA / "files" / "TOOL.CND", DATA / "files" / "UFRAME.CND")

#: Pulses in a degree of each joint, the second of the other sense.
PULSES = np.array([1400.5, -1500.25, 1300.0, -900.75, 850.0, 600.5])

#: Joint values of the arm at positions of the jobs [deg].
Q = np.array(
    [
        [10, 5, -15, 20, -60, 30],
        [-25, 20, 5, -15, -70, 100],
        [35, -10, 10, 40, -80, -60],
        [5, 30, -5, -30, -45, 10],
        [-40, 12, 8, 60, -75, 150],
    ]
)

#: What each job has: lines, positions and motions; lines, reasons and words of what is left.
JOBS: dict[str, tuple[list[tuple[int, str, str]], list[tuple[int, str, str]]]] = {
    "pulses": (
        [
            (18, "C00000", "joint"),
            (19, "C00001", "linear"),
            (20, "C00002", "circular"),
            (21, "C00003", "circular"),
            (22, "C00004", "circular"),
            (23, "C00000", "joint"),
        ],
        [],
    ),
    "poses": (
        [
            (24, "C00000", "joint"),
            (25, "C00001", "linear"),
            (26, "C00002", "linear"),
            (27, "C00003", "linear"),
            (28, "C00004", "joint"),
        ],
        [],
    ),
    "older": ([(18, "C000", "joint"), (19, "C001", "joint"), (20, "P001", "linear")], []),
    "variables": (
        [(19, "P00001", "joint"), (26, "P00003", "linear")],
        [
            (20, "computed", "MOVL P002"),
            (22, "computed", "MOVL P[B000]"),
            (23, "computed", "MOVL LP003"),
            (25, "computed", "MOVL P004"),
            (28, "other file", "MOVL P050"),
        ],
    ),
    "calls": ([(15, "C00000", "joint")], [(17, "computed", "MOVL P001")]),
    "shifts": (
        [(26, "C00004", "joint")],
        [
            (19, "computed", "MOVL C00000"),
            (21, "relative", "IMOV P011"),
            (22, "search", "MOVL C00001"),
            (23, "search", "MOVL C00002"),
            (24, "conveyor", "MOVL C00003"),
            (25, "relative", "IMOVL P012"),
        ],
    ),
    "groups": (
        [
            (31, "C00000", "joint"),
            (32, "C00001", "linear"),
            (35, "C00005", "linear"),
            (36, "C00002", "linear"),
        ],
        [
            (33, "external axes", "MOVL C00004"),
            (34, "external axes", "MOVL C00004"),
            (36, "group", "MOVL C00003"),
            (37, "external axes", "MOVJ EC00002 VJ=10.00"),
        ],
    ),
    "frames": (
        [(29, "C00000", "joint"), (33, "C00003", "linear"), (39, "C00006", "linear")],
        [
            (30, "not a motion", "MOVL C00001"),
            (31, "not a motion", "REFP C00002"),
            (36, "computed", "MOVL C00004"),
            (38, "computed", "MOVL C00005"),
        ],
    ),
    "comments": (
        [(23, "C00000", "joint"), (24, "C00001", "joint"), (30, "C00002", "joint")],
        [],
    ),
    "angles": (
        [(21, "C00000", "joint"), (22, "C00001", "linear")],
        [(23, "relative", "MOVL C00002"), (24, "group", "MOVL C00003")],
    ),
}


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return industrial_arm(tmp_path_factory.mktemp("arm"))


@pytest.fixture(scope="module")
def stated(robot: Robot) -> Stated:
    pulses = tuple((PULSES * 180.0 / np.pi).tolist())
    return Stated(NAMES, data=FILES, pulses=pulses, robot=robot)


def numbers(target: Target) -> np.ndarray:
    return np.array([number.value for number in target.numbers]) * target.scales


def tips(program: ProgramFile) -> list[np.ndarray]:
    """T_base_tip of each motion to a pose."""
    found = []
    for move in program.moves:
        target = program.targets[move.target]
        if target.convention is not None:
            T = np.eye(4)
            values = numbers(target)
            T[:3, 3] = values[:3]
            T[:3, :3] = Rotation.from_euler("xyz", values[3:]).as_matrix()
            found.append(move.T_base_frame @ T @ np.linalg.inv(move.T_tip_tool))
    return found


@pytest.mark.parametrize("name", JOBS)
def test_every_motion_is_read_or_named(name: str, stated: Stated) -> None:
    path = DATA / f"{name}.jbi"
    program = read(path, stated)
    moves = [(move.line, program.targets[move.target].name, move.motion) for move in program.moves]
    left = [(item.line, item.code, item.what) for item in program.left]
    assert (moves, left) == JOBS[name]
    (text,) = program.texts
    assert text.text.encode("latin-1") == path.read_bytes()
    for target in program.targets:
        assert text.line_at(target.numbers[0].start) == target.line
        for number in target.numbers:
            assert float(text.text[number.start : number.end]) == number.value


def test_pulses_are_joint_values_in_steps(stated: Stated) -> None:
    program = read(DATA / "pulses.jbi", stated)
    for target, q in zip(program.targets, Q, strict=True):
        step = np.abs(1.0 / PULSES)
        assert np.all(np.abs(np.degrees(numbers(target)) - q) <= step / 2 + 1e-12)
        assert {number.most_decimals for number in target.numbers} == {0}
    assert program.moves[0].T_tip_tool[2, 3] == pytest.approx(0.15025)


def test_angles_are_joint_values(stated: Stated) -> None:
    first, second = read(DATA / "angles.jbi", stated).targets
    assert np.degrees(numbers(first)) == pytest.approx(Q[0], abs=1e-12)
    assert np.degrees(numbers(second)) == pytest.approx(Q[1], abs=1e-12)
    assert {number.most_decimals for number in first.numbers} == {4}


def test_poses_are_in_their_frames_and_of_their_tools(robot: Robot, stated: Stated) -> None:
    found = np.array(tips(read(DATA / "poses.jbi", stated)))
    assert np.abs(found - robot.poses(np.radians(Q))).max() < 2e-6
    # A frame that is given in another one.
    found = tips(read(DATA / "frames.jbi", stated))
    assert np.abs(found[1] - robot.poses(np.radians(Q[1]))[0]).max() < 2e-6


def test_decimals_are_those_of_the_controller(stated: Stated) -> None:
    newer = read(DATA / "poses.jbi", stated).targets[0]
    older = read(DATA / "older.jbi", stated).targets[0]
    assert [number.most_decimals for number in newer.numbers] == [3, 3, 3, 4, 4, 4]
    assert [number.most_decimals for number in older.numbers] == [3, 3, 3, 2, 2, 2]


def test_rconf_allows_one_solution(robot: Robot, stated: Stated) -> None:
    program = read(DATA / "comments.jbi", stated)
    for target, degrees in zip(program.targets, (Q[0], [-15, 10, 0, 190, -60, 200]), strict=False):
        q = np.radians(degrees)
        half = np.pi if q[3] < np.pi else -np.pi
        flipped = q * [1, 1, 1, 1, -1, 1] + [0, 0, 0, half, 0, half]
        assert np.abs(robot.poses(flipped) - robot.poses(q)).max() < 1e-12
        others = [flipped]
        for joint in (0, 3, 5):
            turn = np.zeros(6)
            turn[joint] = -2 * np.pi * np.sign(q[joint])
            others.append(q + turn)
        assert list(target.configuration(np.array([q, *others]))) == [
            True,
            False,
            False,
            False,
            False,
        ]


def test_rconf_of_older_controllers_counts_joint_r(stated: Stated) -> None:
    flip, no_flip, _ = read(DATA / "older.jbi", stated).targets
    q = np.radians([[10, 5, -15, 20, -60, 30], [10, 5, -15, 165, 70, 30]])
    assert list(flip.configuration(q)) == [True, False]
    assert list(no_flip.configuration(q)) == [False, True]


def test_upper_arm_and_front_are_those_at_zero(tmp_path: Path, stated: Stated) -> None:
    text = (DATA / "older.jbi").read_text()
    lower, rear = tmp_path / "lower.jbi", tmp_path / "rear.jbi"
    lower.write_text(text.replace("///RCONF 0,0,0", "///RCONF 0,1,0"))
    rear.write_text(text.replace("///RCONF 0,0,0", "///RCONF 0,0,1"))
    bent, over = np.radians([[0, 100, 130, 0, -60, 0], [0, -60, 60, 0, -60, 0]])
    for path, allowed in (
        (DATA / "older.jbi", [False] * 2),
        (lower, [True, False]),
        (rear, [False, True]),
    ):
        configuration = read(path, stated).targets[0].configuration
        assert list(configuration(np.array([bent, over]))) == allowed


def test_seven_joints_are_in_the_order_of_the_arm(tmp_path: Path) -> None:
    path = tmp_path / "seven.jbi"
    path.write_text(
        "/JOB\n//NAME SEVEN\n//POS\n///NPOS 2,0,0,0,0,0\n///TOOL 0\n///POSTYPE PULSE\n///PULSE\n"
        "C00000=1,2,3,4,5,6,7\n///POSTYPE ROBOT\n///RECTAN\n///RCONF 1,0,0,0,0,0,0,0\n"
        "C00001=1.000,2.000,3.000,0.00,0.00,0.00,0.00\n//INST\n///GROUP1 RB1\nNOP\n"
        "MOVJ C00000 VJ=1.00\nMOVL C00001 V=1.0\nEND\n"
    )
    program = read(path, Stated(tuple("SLEURBT"), pulses=(1.0,) * 7))
    assert [number.value for number in program.targets[0].numbers] == [1, 2, 7, 3, 4, 5, 6]
    assert [(item.line, item.code) for item in program.left] == [(17, "unread")]


def test_all_that_is_not_defined_is_asked_for_at_once(
    tmp_path: Path, robot: Robot, stated: Stated
) -> None:
    with pytest.raises(MeasurementError) as caught:
        read(DATA / "poses.jbi", Stated(NAMES, robot=robot))
    for part in ("'1', '2'", '--tool "1=', '--frame "1=', "UFRAME.CND"):
        assert part in str(caught.value)
    with pytest.raises(MeasurementError, match="--pulses"):
        read(DATA / "pulses.jbi", Stated(NAMES, data=FILES))
    # A frame in the master tool moves.
    job = tmp_path / "job.jbi"
    job.write_text((DATA / "poses.jbi").read_text().replace("USER 1", "USER 5"))
    with pytest.raises(MeasurementError, match="'5'"):
        read(job, stated)


def test_files_beside_a_job_are_read(tmp_path: Path) -> None:
    for file in FILES:
        (tmp_path / file.name).write_bytes(file.read_bytes())
    (tmp_path / "poses.jbi").write_bytes((DATA / "poses.jbi").read_bytes())
    assert len(read(tmp_path / "poses.jbi", Stated(NAMES)).moves) == 5


HEAD = "/JOB\n//NAME A\n//POS\n///NPOS 1,0,0,0,0,0\n///TOOL 0\n///POSTYPE PULSE\n///PULSE\n"


@pytest.mark.parametrize(
    "text",
    [
        "",
        "//NAME A\n/JOB\n",
        HEAD + "C00000=0,0,0,0,0,0\n//INST\nNOP\nEND\n/JOB\n//NAME B\n",
        HEAD + "C00000=0,0,0,0,0,0\nC00000=0,0,0,0,0,0\n//INST\nNOP\nEND\n",
        HEAD + "C00000=0,0,0,0,0\n//INST\nNOP\nMOVJ C00000 VJ=1.00\nEND\n",
    ],
)
def test_other_texts_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "some.jbi"
    path.write_text(text)
    with pytest.raises(MeasurementError, match=r"some\.jbi"):
        read(path, Stated(NAMES, pulses=(1.0,) * 6))


def test_a_data_file_that_has_no_frames_is_refused(tmp_path: Path) -> None:
    other = tmp_path / "VAR.DAT"
    other.write_text("/VAR\n//B\n")
    with pytest.raises(MeasurementError, match=r"VAR\.DAT"):
        read(DATA / "calls.jbi", Stated(NAMES, data=(other,), pulses=(1.0,) * 6))


#: The search for all solutions of poses takes its time.
QUICK = ("pulses", "angles", "groups", "frames")
SOME_SLOW = [pytest.param(name, marks=[] if name in QUICK else pytest.mark.slow) for name in JOBS]


@pytest.mark.parametrize("name", SOME_SLOW)
def test_without_errors_no_byte_changes(
    name: str, robot: Robot, stated: Stated, tmp_path: Path
) -> None:
    path = DATA / f"{name}.jbi"
    result, away = run(path, stated, robot, robot, tmp_path)
    assert result.texts[0].text.encode("latin-1") == path.read_bytes()
    assert result.is_corrected.all()
    assert away.max() < 1e-9


@pytest.mark.parametrize("name", SOME_SLOW)
def test_the_true_arm_arrives(name: str, robot: Robot, stated: Stated, tmp_path: Path) -> None:
    path = DATA / f"{name}.jbi"
    result, away = run(path, stated, robot, off(robot, 3), tmp_path)
    assert result.is_corrected.all()
    for move, distance in zip(result.program.moves, away, strict=True):
        target = result.program.targets[move.target]
        in_pulses = target.numbers[0].most_decimals == 0
        # Half a pulse of each joint, at 1.5 m; half a micrometre along each axis.
        limit = 1.5 * np.radians(0.5 / np.abs(PULSES)).sum() if in_pulses else 1e-6
        assert distance < limit
        for number in target.numbers:
            old = path.read_bytes().decode("latin-1")[number.start : number.end]
            assert "." not in old or not in_pulses


@pytest.mark.slow
def test_a_correction_to_another_configuration_is_none(
    robot: Robot, stated: Stated, tmp_path: Path
) -> None:
    """Joint T is close to half a turn: RCONF, which holds for several positions, would have to change."""
    left = []
    for degrees in (179.9, -179.9):
        q = np.radians([10, 5, -15, 20, -60, degrees])
        T = robot.poses(q)[0]
        angles = Rotation.from_matrix(T[:3, :3]).as_euler("xyz", degrees=True)
        values = ",".join(f"{value:.4f}" for value in [*(T[:3, 3] * 1e3), *angles])
        for word in ("MOVJ C00001 VJ=1.00", "MOVL C00001 V=1.0"):
            pulses = ",".join(f"{value:.0f}" for value in np.degrees(q) * PULSES)
            path = tmp_path / "near.jbi"
            path.write_text(
                "/JOB\n//NAME NEAR\n//POS\n///NPOS 2,0,0,0,0,0\n///TOOL 0\n///POSTYPE PULSE\n///PULSE\n"
                f"C00000={pulses}\n///POSTYPE ROBOT\n///RECTAN\n///RCONF {','.join('1' + '0' * 23)}\n"
                f"C00001={values}\n//INST\n///GROUP1 RB1\nNOP\nMOVJ C00000 VJ=1.00\n{word}\nEND\n"
            )
            result = corrected(read(path, stated), robot, off(robot, 3))
            left.append([(item.line, item.code) for item in result.left])
    # Of the two only one goes over half a turn; on a line the controller goes on as it is.
    assert sorted(left) == [[], [], [], [(17, "configuration")]]
