"""RAPID programs: own ones with what is usual and what is treacherous, read, corrected, run by a simulated arm."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from calib.errors import MeasurementError
from calib.robot.robot import Robot
from calib.verbs.compensate.programs.dialects import DIALECTS
from calib.verbs.compensate.programs.program_file import ProgramFile, Stated
from calib.verbs.compensate.programs.rapid import read
from tests.verbs.compensate.arms import off
from tests.verbs.compensate.programs.abb_arm import NAMES, abb_arm
from tests.verbs.compensate.programs.listing import corrected_in_place, left, motions, values

#: Where the programs begin [rad].
START = np.deg2rad([10, 20, 10, 15, 40, 25])

DATA = Path(__file__).parent / "data" / "rapid"


@pytest.fixture(scope="module")
def nominal(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return abb_arm(tmp_path_factory.mktemp("abb"))


def of(text: str, tmp_path: Path, **stated: object) -> ProgramFile:
    path = tmp_path / "own.mod"
    path.write_bytes(f"MODULE Own\n{text}\nENDMODULE\n".encode())
    return read(path, Stated(NAMES, **stated))


P = "[[400,0,300],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
TOOL = "PERS tooldata t:=[TRUE,[[0,0,100],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];"


# What is read of each program


def test_literals_of_a_post_processor() -> None:
    program = read(DATA / "inline.mod", Stated(NAMES))
    assert motions(program) == [
        (9, "joint", ""),
        (10, "linear", ""),
        (10, "linear", ""),
        (11, "linear", ""),
        (19, "joint", ""),
        (20, "linear", ""),
    ]
    assert left(program) == []
    assert all(target.configuration is None for target in program.targets)
    np.testing.assert_allclose(program.moves[-1].T_tip_tool[:3, 3], [0, 0, 0.12])
    np.testing.assert_allclose(
        np.rad2deg(values(program.targets[0])), [10, 20, 10, 15, 40, 25], atol=1e-9
    )


def test_instructions_of_many_processes() -> None:
    program = read(DATA / "paths.mod", Stated(NAMES))
    assert motions(program) == [
        (22, "joint", "jHome"),
        (23, "joint", "Target_10"),
        (24, "linear", "Target_20"),
        (25, "circular", "pVia"),
        (25, "circular", "Target_30"),
        (26, "linear", "Target_20"),
        (27, "joint", "Target_10"),
        (28, "circular", "pVia"),
        (28, "circular", "Target_30"),
        (29, "linear", "Target_20"),
        (30, "linear", "pWeldStart"),
        (31, "linear", "pWeldEnd"),
        (32, "linear", "pSpot"),
        (33, "linear", "pGlue"),
        (34, "linear", "pPaint"),
    ]
    assert left(program) == [(12, "unused"), (35, "search"), (36, "computed"), (37, "partial")]
    by_line = {move.line: move for move in program.moves}
    np.testing.assert_allclose(by_line[26].T_tip_tool[:3, 3], [0.03179, 0, 0.1295])
    turned = pin.exp6(np.array([0, 0, 0, 0, 0, np.pi / 6])).homogeneous
    turned[:3, 3] = [0.1, -0.05, 0.2]
    table = np.eye(4)
    table[:3, 3] = [0.01, 0.02, 0.03]
    np.testing.assert_allclose(by_line[26].T_base_frame, turned @ table, atol=1e-7)
    np.testing.assert_allclose(by_line[32].T_base_frame, np.eye(4))


def test_arrays_and_records() -> None:
    program = read(DATA / "arrays.mod", Stated(NAMES))
    names = [name for _, _, name in motions(program)]
    assert names == [
        "rest{1}",
        *("pts{1}", "pts{2}", "pts{3}"),
        *("grid{2,1}", "grid{1,1}", "grid{1,2}"),
        *("one.above", "one.at", "more{2}.at", "pAlias", "pts{2}"),
    ]
    codes = [code for _, code in left(program)]
    assert (
        codes == ["computed"] * 5
    )  # pts{4}, numbers in an array, and one of several tools for each of three points


def test_scopes_and_procedures_with_targets() -> None:
    program = read(DATA / "scopes.mod", Stated(NAMES))
    assert motions(program) == [
        (49, "joint", "p10"),
        (14, "joint", "pLocal"),
        (58, "linear", "pA"),
        (58, "linear", "pB"),
        (58, "linear", ""),
        (61, "joint", "pT"),
        (19, "joint", "p10"),
        (22, "linear", "pA"),
        (24, "linear", "pB"),
        (30, "linear", "p10"),
        (43, "joint", "pA"),
        (70, "joint", "pB"),
    ]
    lines = [program.targets[move.target].line for move in program.moves]
    assert (lines[0], lines[6]) == (48, 4)  # the p10 of First, and that of the module
    np.testing.assert_allclose(program.moves[5].T_tip_tool[:3, 3], [-0.02, 0.015, 0.2])
    assert left(program) == [
        (33, "computed"),
        (35, "unread"),
        (37, "other file"),
        (39, "unread"),
        (40, "unread"),
        (54, "computed"),
        (57, "relative"),
        (64, "computed"),
    ]


def test_what_the_program_makes_as_it_runs() -> None:
    program = read(DATA / "computed.mod", Stated(NAMES))
    assert motions(program) == [
        (18, "joint", "p10"),
        (35, "joint", "j10"),
        (38, "joint", "j10"),
        (41, "joint", "p80"),
    ]
    codes = dict(left(program))
    assert codes[19] == codes[20] == "relative"
    assert codes[47] == "force"
    rest = {line: code for line, code in codes.items() if line not in (19, 20, 47)}
    assert set(rest.values()) == {"computed"}
    assert sorted(rest) == [21, 22, 24, 26, 28, 30, 32, 34, 37, 43, 45, 49, 51, 55]


def test_frames_that_move_and_tools_that_do_not() -> None:
    program = read(DATA / "frames.mod", Stated(NAMES))
    assert [name for _, _, name in motions(program)] == ["p10", "jTrack", "pLong"]
    assert left(program) == [
        (16, "not a motion"),
        (18, "external axes"),
        (21, "not a motion"),
        (22, "external tool"),
        (23, "external axes"),
        (24, "conveyor"),
        (25, "external axes"),
        (26, "external axes"),
        (27, "partial"),
    ]


def test_tools_beside_the_file_and_targets_of_another_one(tmp_path: Path) -> None:
    everywhere = {"": np.eye(4)}
    alone = read(DATA / "old.prg", Stated(NAMES, tools=everywhere))
    assert [line for line, _, _ in motions(alone)] == [10, 18]
    assert left(alone) == [(9, "other file"), (11, "other file")]
    np.testing.assert_allclose(alone.moves[0].T_tip_tool[:3, 3], [0.03179, 0, 0.1295])

    data = (DATA / "points" / "points.mod",)
    program = read(DATA / "old.prg", Stated(NAMES, data=data))
    assert [name for _, _, name in motions(program)] == ["pStart", "", "pEnd", ""]
    assert [program.targets[move.target].file for move in program.moves] == [1, 0, 1, 0]
    # Of a tool that is not known joint values need none.
    assert program.moves[-1].T_tip_tool is None

    own = tmp_path / "own.mod"
    own.write_text(
        f"MODULE A\nPROC main()\nMoveJ {P},v1,fine,tGrip\\WObj:=wThere;\nMoveAbsJ j1,v1,fine,tB;\n"
        "ENDPROC\nENDMODULE"
    )
    with pytest.raises(MeasurementError, match="tGrip") as error:
        read(own, Stated(NAMES))
    assert "wThere" in str(error.value)
    assert "tB" not in str(error.value)
    stated = Stated(NAMES, tools={"TGRIP": np.eye(4)}, frames={"": np.eye(4)})
    assert len(read(own, stated).moves) == 1


def test_persistents_whose_value_is_in_another_module(tmp_path: Path) -> None:
    (tmp_path / "tools.sys").write_text(f"MODULE T\n{TOOL}\nENDMODULE")
    program = of(f"PERS tooldata t;\nPROC main()\nMoveL {P},v1,fine,t;\nENDPROC", tmp_path)
    assert program.moves[0].T_tip_tool is not None
    assert program.moves[0].T_tip_tool[2, 3] == 0.1
    # Modules that do not agree are of no use.
    (tmp_path / "more.sys").write_text(f"MODULE U\n{TOOL.replace('100', '200')}\nENDMODULE")
    with pytest.raises(MeasurementError, match="'t'"):
        of(f"PERS tooldata t;\nPROC main()\nMoveL {P},v1,fine,t;\nENDPROC", tmp_path)


def test_backup_of_a_task(tmp_path: Path) -> None:
    for folder in ("PROGMOD", "SYSMOD"):
        (tmp_path / folder).mkdir()
    (tmp_path / "SYSMOD" / "user.sys").write_text(f"MODULE T\n{TOOL}\nENDMODULE")
    path = tmp_path / "PROGMOD" / "main.mod"
    path.write_text(f"MODULE M\nPROC main()\nMoveL {P},v1,fine,t;\nENDPROC\nENDMODULE")
    program = read(path, Stated(NAMES))
    assert program.moves[0].T_tip_tool is not None
    assert program.moves[0].T_tip_tool[2, 3] == 0.1


def test_motions_after_the_end_of_the_module_are_named(tmp_path: Path) -> None:
    path = tmp_path / "pasted.mod"
    path.write_text(
        "MODULE a\n PROC main()\n  MoveAbsJ [[0,0,0,0,30,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v50,fine,tool0;\n ENDPROC\n"
        "ENDMODULE\n! MoveL comment\nMoveL p1,v50,fine,tool0;\n  MoveJ p2,v50,fine,tool0;\n"
    )
    program = read(path, Stated(NAMES))
    assert motions(program) == [(3, "joint", "")]
    assert left(program) == [(7, "unread"), (8, "unread")]


def test_letters_and_text_that_is_not_well_formed() -> None:
    program = read(DATA / "letters.modx", Stated(NAMES))
    assert motions(program) == [
        (9, "joint", "pÄpfel"),
        (10, "linear", "pÄpfel"),
        (11, "joint", "pBirnen"),
        (14, "linear", "pÄpfel"),
        (17, "joint", ""),
    ]
    assert left(program) == []
    pears = program.targets[program.moves[2].target]
    assert [number.value for number in pears.numbers] == [250, 200, 400, 0, 1, 0, 0]
    text = program.texts[0].text
    written = [text[number.start : number.end] for number in pears.numbers]
    assert written == ["2.5E+02", "2.0e2", "+400.", ".0", "1", "0", "-0."]


# The whole way


@pytest.mark.parametrize(
    "name",
    [
        "inline.mod",
        pytest.param("paths.mod", marks=pytest.mark.slow),
        pytest.param("arrays.mod", marks=pytest.mark.slow),
        pytest.param("scopes.mod", marks=pytest.mark.slow),
        "computed.mod",
        "frames.mod",
        "old.prg",
        "letters.modx",
    ],
)
def test_the_true_arm_arrives(name: str, nominal: Robot, tmp_path: Path) -> None:
    shutil.copytree(DATA, tmp_path, dirs_exist_ok=True)
    data = (tmp_path / "points" / "points.mod",) if name == "old.prg" else ()
    stated = Stated(NAMES, data=data, robot=nominal)

    def reader(path: Path) -> ProgramFile:
        return read(path, stated)

    old = (tmp_path / name).read_bytes()
    true = off(nominal, seed=3)
    done, before, after = corrected_in_place(reader, tmp_path / name, nominal, true, START)
    assert before.max() > 1e-3
    assert after.max() < 1e-6
    assert done.is_corrected.all()
    new = (tmp_path / name).read_bytes()
    assert new.count(b"\n") == old.count(b"\n")
    assert new.endswith(old[-9:])


# Configuration data


def test_quadrants_and_postures(nominal: Robot, tmp_path: Path) -> None:
    program = of(
        "PROC main()\nMoveJ [[400,0,300],[0,0,1,0],[-1,0,1,1],[9E9,9E9,9E9,9E9,9E9,9E9]],v1,fine,tool0;\nENDPROC",
        tmp_path,
        robot=nominal,
    )
    allowed = program.targets[0].configuration
    assert allowed is not None
    q = np.deg2rad(
        [
            [-10, 0, 0, 10, -30, 100],
            [10, 0, 0, 10, -30, 100],  # axis 1 in the next quadrant
            [-10, 0, 0, -10, -30, 100],  # axis 4
            [-10, 0, 0, 10, -30, 80],  # axis 6
            [0.5, 0, 0, 10, -30, 89.5],  # within rounding
            [-10, 0, 0, 10, 30, 100],  # axis 5 positive: not of cfx 1
            [-10, -60, -100, 10, -30, 100],  # the wrist behind the lower arm
        ]
    )
    assert allowed(q).tolist() == [True, False, False, False, True, False, False]
    # Alone a solution of the right quadrants counts whatever cfx says: older controllers write 0.
    assert allowed(q[5:6]).tolist() == [True]
    (cf1, of_cf1), _, (cf6, of_cf6) = program.targets[0].dependent
    assert (cf1.value, cf6.value) == (-1, 1)
    assert [of_cf1(row) for row in q[:2]] == [-1, 0]
    assert [of_cf6(np.deg2rad([0] * 5 + [angle])) for angle in (100, 89.5, 80, 181.5)] == [
        *(1, 1, 0, 2)
    ]


def test_configuration_off_for_all_motions_of_a_target(tmp_path: Path) -> None:
    text = f"""CONST robtarget p:={P};
CONST robtarget pBoth:={P};
PROC main()
  ConfL \\Off;
  MoveL p,v1,fine,tool0;
  MoveL pBoth,v1,fine,tool0;
  ConfL \\On;
  MoveL pBoth,v1,fine,tool0;
ENDPROC"""
    program = of(text, tmp_path)
    assert [target.configuration is None for target in program.targets] == [True, False]


# Traps one by one


@pytest.mark.parametrize(
    ("body", "codes"),
    [
        (f"MoveL {P},v1,fine,t;", []),
        (f"MoveL {P},v1,fine,t", []),
        ("MoveL p,v1,fine,t;", []),
        ("WHILE TRUE DO\nMoveL p,v1,fine,t;\nPDispOn p,t;\nENDWHILE", ["computed"]),
        ("PDispOn p,t;\nPDispOff;\nMoveL p,v1,fine,t;", []),
        ("IF a THEN\nPDispOn p,t;\nELSE\nPDispOff;\nENDIF\nMoveL p,v1,fine,t;", ["computed"]),
        ("GOTO on;\nback: MoveL p,v1,fine,t;\nRETURN;\non: PDispOn p,t;\nGOTO back;", ["computed"]),
        ("MoveL p.x,v1,fine,t;", ["computed"]),
        ("MoveL p,v1,fine,CTool();", ["computed"]),
        ("p:=q;\nMoveL p,v1,fine,t;", ["computed"]),
        ("MoveL q,v1,fine,t;", ["other file", "unused"]),
        ('SetDataVal "p",q;\nMoveL p,v1,fine,t;', ["computed"]),
        ("MoveL p,v1;", ["unread"]),
        ("PathRecMoveBwd;", ["unread", "unused"]),
        ("ownMove p,v1,t;", ["unread"]),
        ("OpenGripper;", ["other file", "unused"]),
        ("GetPart p;", ["unread"]),
        ("Set doGrip;\nConfL\\Off;\nWaitTime 1;", ["unused"]),
        ("TPWrite NumToStr(p.trans.x,1);", ["unused"]),
        ("FCPressL p,v1,10,fine,t;", ["force"]),
        ("TriggIO trigg1,10\\DOp:=do1,1;", ["unused"]),
        ("MoveL RelTool(Offs(p,1,2,3),0,0,1),v1,fine,t;", ["relative"]),
    ],
)
def test_one_by_one(body: str, codes: list[str], tmp_path: Path) -> None:
    program = of(f"{TOOL}\nCONST robtarget p:={P};\nPROC main()\n{body}\nENDPROC", tmp_path)
    if P in body:
        codes = ["unused"]
    assert sorted(code for _, code in left(program)) == codes


def test_a_quadrant_beyond_all_numbers_is_left(tmp_path: Path) -> None:
    target = "[[400,0,500],[0,0,1,0],[1e999,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
    program = of(f"PROC main()\nMoveL {target},v1,fine,tool0;\nENDPROC", tmp_path)
    assert program.targets == ()
    assert [code for _, code in left(program)] == ["computed"]


def test_seven_joints(tmp_path: Path) -> None:
    names = tuple(f"yumi_joint_{j}_l" for j in (1, 2, 7, 3, 4, 5, 6))
    path = tmp_path / "left.mod"
    path.write_text(
        f"MODULE L\nPROC main()\nMoveAbsJ [[1,2,3,4,5,6],[7,9E9,9E9,9E9,9E9,9E9]],v1,fine,tool0;\n"
        f"MoveJ {P},v1,fine,tool0;\nENDPROC\nENDMODULE"
    )
    program = read(path, Stated(names))
    assert [number.value for number in program.targets[0].numbers] == [1, 2, 7, 3, 4, 5, 6]
    assert left(program) == [(4, "external axes")]
    with_track = read(path, Stated(("track", *NAMES)))
    assert left(with_track) == [(3, "external axes"), (4, "external axes")]
    with pytest.raises(MeasurementError, match="4"):
        read(path, Stated(NAMES[:4]))


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"MODULE Terminal;\nIMPORT InOut;\nBEGIN\nEND Terminal.\n",
        b"param n; set S; var x {S} >= 0;\n",
        b"MODULE A\nPROC main()\n",
        bytes(range(256)),
        "MODULE A\nENDMODULE".encode("utf-16"),
    ],
)
def test_other_files_are_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "other.mod"
    path.write_bytes(content)
    with pytest.raises(MeasurementError, match=r"other\.mod"):
        read(path, Stated(NAMES))


def test_endings() -> None:
    assert {DIALECTS[ending].read for ending in (".mod", ".modx", ".sys", ".prg")} == {read}
