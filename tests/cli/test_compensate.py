"""``calib compensate`` as a user runs it: on the paper's UR3, on a virtual one, and on what cannot be done."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest

DOC = Path(__file__).parents[2] / "docs" / "compensation.md"
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
HEADER = ",".join(f"{name}_joint [deg]" for name in JOINTS)
FILES = ("robot.urdf", "data.csv", "result.json", "target.urdf", "corrected.urdf")
RESULT = ("--calibration", "result.json")


@pytest.fixture
def folder(examples, tmp_path: Path) -> Path:
    """What a user has: robot, result, corrected URDFs, and a program of two rows of joint values."""
    for name in FILES:
        shutil.copy(examples.folder / name, tmp_path)
    write(tmp_path / "program.csv", HEADER, "-40,-85,75,-120,-45,0", "-20,-75,85,-140,-45,0")
    return tmp_path


def write(path: Path, *lines: str) -> None:
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")


def table(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def said(done) -> str:
    """What was printed to stdout, as one line."""
    return " ".join(done.out.split())


def refused(done) -> str:
    """What was printed to stderr by a call that failed, as one line."""
    assert (done.code, done.out) == (1, "")
    assert done.err.startswith("calib: ")
    return " ".join(done.err.split())


def numbers(text: str) -> list[float]:
    return [float(word) for word in re.findall(r"-?\d+\.\d+", text)]


def test_the_examples_of_the_command_line(examples):
    done = examples.starting("calib compensate robot.urdf data.csv")
    assert done.lines[0].startswith("Verdict: use")
    assert "Written: commands.csv" in done.lines
    rows = table(examples.folder / "commands.csv")
    assert len(rows) == 35
    assert {row["status"].partition(":")[0] for row in rows} == {"ok", "warning"}
    joints = table(examples.folder / "joint_commands.csv")
    assert "x [mm]" not in joints[0]
    assert joints[0]["point"] == "P1"


def test_the_document_s_examples_print_what_it_says(call, examples, tmp_path: Path):
    text = DOC.read_text(encoding="utf-8")
    shutil.copytree(examples.folder / "demo", tmp_path / "demo")  # its first example, run already
    for name, content in re.findall(r"`(\w+\.csv)`:\n\n```\n(.*?)```", text, re.DOTALL):
        (tmp_path / name).write_text(content, encoding="utf-8")
    printed = []
    for block in re.findall(r"```sh\n(.*?)```", text, re.DOTALL):
        for line in block.splitlines():
            program, verb, *words = shlex.split(line)
            assert program == "calib"
            if verb != "demo":
                done = call(tmp_path, verb, *words)
                assert (done.code, done.err) == (0, ""), line
                printed.append(done.out)
    first, second, *_, last = printed
    shown = [block.strip() for block in re.findall(r"^```\w*\n(.*?)^```$", text, re.DOTALL | re.M)]
    for block, output in (
        (next(b for b in shown if b.startswith("Verdict: ")), first),
        (next(b for b in shown if b.startswith("The poses to send")), second),
        (next(b for b in shown if b.startswith("with the joint origins")), last),
    ):
        start = output.index(block.splitlines()[0])
        found = output[start:].rstrip()[: len(block) + 50]
        assert re.sub(r"[\d.-]+", "#", block) in re.sub(r"[\d.-]+", "#", found)
        wanted = numbers(block)
        assert numbers(found)[: len(wanted)] == pytest.approx(wanted, abs=2e-3)
    # The virtual robot, which was measured again at the commands, is where it should be.
    assert numbers(last.split("with the joint origins of virtual.json:")[1])[1] < 0.1
    # The same in Python, of the same result.
    code = re.findall(r"```python\n(.*?)```", text, re.DOTALL)[0]
    with contextlib.redirect_stdout(io.StringIO()):
        exec(code, {})
    same = [
        (tmp_path / name).read_text(encoding="utf-8")
        for name in ("from_python.csv", "commands.csv")
    ]
    rows = [numbers(one) for one in same]
    assert rows[0] == pytest.approx(rows[1], abs=1e-5)
    sent = table(tmp_path / "sent.csv")
    assert list(sent[0])[:8] == ["point", "x [mm]", "y [mm]", "z [mm]", "qx", "qy", "qz", "qw"]
    assert [row["status"] for row in sent] == ["ok"] * 3


def test_both_forms_of_a_command_are_the_same(call, folder: Path, ur3):
    from calib.compensation.program import read_program

    done = call(folder, "compensate", "robot.urdf", "program.csv", *RESULT, "-o", "c.csv")
    assert (done.code, done.err) == (0, "")
    program = read_program(folder / "c.csv", ur3, given="poses")
    assert program.q is not None
    assert program.T_wanted is not None
    assert np.abs(ur3.poses(program.q) - program.T_wanted).max() < 2e-9
    again = call(folder, "compensate", "robot.urdf", "c.csv", *RESULT)
    assert "commands that calib compensate wrote: they are corrected already" in refused(again)


def test_a_corrected_urdf_in_place_of_a_result(call, folder: Path):
    names = ("--corrected", "corrected.urdf", "--base", "base", "--tip", "tool0")
    assert (
        call(
            folder, "compensate", "robot.urdf", "program.csv", *RESULT, "--geometry", "-o", "a.csv"
        ).code
        == 0
    )
    done = call(folder, "compensate", "robot.urdf", "program.csv", *names, "-o", "b.csv")
    assert "The true robot is corrected.urdf. How far it can be relied on is not in a URDF" in said(
        done
    )
    a, b = table(folder / "a.csv"), table(folder / "b.csv")
    for one, other in zip(a, b, strict=True):
        assert numbers(",".join(one.values())) == pytest.approx(
            numbers(",".join(other.values())), abs=1e-6
        )


def test_the_frame_of_the_poses_is_always_said(call, folder: Path):
    words = ("compensate", "robot.urdf", "program.csv", "--corrected", "corrected.urdf")
    # The URDF's root is not the controller's frame: everything is half a turn from where it counts.
    text = said(call(folder, *words, "--tip", "tool0"))
    assert "Poses are in 'world'." in text
    assert "also has a link 'base', at (" in text
    assert text.count("give --base base where it is so.") == 1
    joints = said(call(folder, *words, "--tip", "tool0", "--send", "joints"))
    assert "Poses are in 'world'." in joints
    assert "also has a link" not in joints
    text = said(call(folder, *words, "--base", "base", "--tip", "tool0"))
    assert "Poses are in 'base'." in text
    assert "also has a link" not in text
    text = said(call(folder, "compensate", "robot.urdf", "program.csv", *RESULT))
    assert "Poses are in 'base'." in text
    text = said(call(folder, *words[:3], *RESULT, "--poses-in", "measured"))
    assert "Poses are in the frame that was measured in." in text


def test_the_base_of_a_fit_is_changed_by_another_fit(call, folder: Path):
    words = ("--base", "base_link", "--tip", "tool0", "--no-validate", "--json", "root.json")
    assert call(folder, "fit", "robot.urdf", "data.csv", *words, "--frame", "estimate").code == 0
    root = ("compensate", "robot.urdf", "program.csv", "--calibration", "root.json")
    assert "fit with --base base where it is so." in said(call(folder, *root))


def test_the_target_of_a_corrected_urdf_is_the_tool(call, folder: Path):
    words = (
        "compensate",
        "robot.urdf",
        "program.csv",
        "--base",
        "base",
        "--tip",
        "tool0",
        "--tool",
        "target",
    )
    done = call(folder, *words, "--corrected", "target.urdf")
    assert re.search(
        r"What arrives: the point \(-70\.\d+, 70\.\d+, \d+\.\d+\) mm in 'tool0'", said(done)
    )
    assert "has no link calib_target, which 'calib fit --target-link' adds" in refused(
        call(folder, *words, "--corrected", "corrected.urdf")
    )
    named = (*words[:-1], "target:ball", "--corrected", "target.urdf")
    assert "to be 'ball' of a calibration, but two robots" in refused(call(folder, *named))


def test_robot_may_be_the_corrected_one_but_not_a_third(call, folder: Path):
    done = call(folder, "compensate", "corrected.urdf", "program.csv", *RESULT)
    assert (
        "ROBOT has the corrected joint origins already; what the controller has was taken"
        in said(done)
    )
    nominal = call(folder, "compensate", "robot.urdf", "program.csv", *RESULT)
    assert set(nominal.lines) <= set(done.lines)
    text = (folder / "robot.urdf").read_text(encoding="utf-8")
    origin = re.search(r'<joint name="elbow_joint".*?xyz="([^"]*)"', text, re.DOTALL)
    assert origin
    moved = text[: origin.start(1)] + "0.001 -0.0925 0.24365" + text[origin.end(1) :]
    (folder / "factory.urdf").write_text(moved, encoding="utf-8")
    message = refused(call(folder, "compensate", "factory.urdf", "program.csv", *RESULT))
    assert (
        "factory.urdf: the origin of 'elbow_joint' is neither the one that result.json began with"
        in message
    )
    other = ("--corrected", "corrected.urdf", "--base", "base", "--tip", "tool0")
    assert call(folder, "compensate", "factory.urdf", "program.csv", *other).code == 0


def test_rows_that_cannot_be_reached(call, folder: Path):
    write(folder / "far.csv", f"row,{HEADER},x [mm],y [mm],z [mm]", "a,-40,-85,75,-120,-45,0,-400,0,300",
          "b,-40,-85,75,-120,-45,0,900,900,900")  # fmt: skip
    words = ("compensate", "robot.urdf", "far.csv", *RESULT, "--tool", "target", "-o", "c.csv")
    done = call(folder, *words)
    message = refused(done)
    assert message.startswith(
        "calib: 1 of 2 rows has no command, and nothing was written: row b: the true robot"
    )
    assert message.endswith("--skip leaves these rows empty and writes the others.")
    assert max(map(len, done.err.splitlines())) <= 100
    assert not (folder / "c.csv").exists()
    skipped = call(folder, *words, "--skip")
    assert (skipped.code, skipped.err) == (0, "")
    assert "1 of 2 rows has no command; the table has empty cells: row b: the true" in said(skipped)
    assert [row["status"][:10] for row in table(folder / "c.csv")] == ["ok", "no command"]
    write(
        folder / "far.csv",
        f"{HEADER},x [mm],y [mm],z [mm]",
        *["-40,-85,75,-120,-45,0,900,900,900"] * 60,
    )
    none = refused(call(folder, *words, "--skip", "--force"))
    assert none.startswith("calib: 60 of 60 rows have no command, and nothing was written: row 1: ")
    assert "row 50: the true robot" in none
    assert "and rows 51 to 60" in none
    assert "or measured ones (--given joints)?" in none
    write(folder / "far.csv", "x [mm],y [mm],z [mm]", "900,900,900", "900,900,800")
    assert "Check --tool, --poses-in" in refused(call(folder, *words, "--skip", "--force"))


def test_fewer_joints(call, folder: Path):
    write(
        folder / "five.csv", HEADER.rpartition(",")[0], "-40,-85,75,-120,-45", "-20,-75,85,-140,-45"
    )
    words = (
        "compensate",
        "robot.urdf",
        "five.csv",
        "--corrected",
        "corrected.urdf",
        "--base",
        "base",
    )
    done = call(folder, *words, "-o", "c.csv")
    assert done.code == 0
    assert "Matched: position and orientation, as well as they can be." in said(done)
    assert "wrist_3_joint [deg]" not in table(folder / "c.csv")[0]
    message = refused(call(folder, *words, "--match", "pose"))
    assert "--match position or weighted those that cannot be reached exactly." in message


def test_joint_values_that_do_not_belong_to_the_poses(call, folder: Path):
    done = call(folder, "compensate", "robot.urdf", "data.csv", *RESULT, "--skip")
    assert re.search(
        r"the nominal robot has the tool \d+ mm from the program's positions \(median\)", said(done)
    )
    done = call(
        folder, "compensate", "robot.urdf", "data.csv", *RESULT, "--tool", "target", "--skip"
    )
    assert "from the program's positions" not in said(done)


def test_positions_alone_leave_the_orientation_open(call, folder: Path):
    words = ("compensate", "robot.urdf", "program.csv", *RESULT)
    text = said(call(folder, *words))
    assert "Positions alone were measured for the result: how the tip is turned follows" in text
    assert "known best: --tool target; or --match position." in text
    text = said(call(folder, *words, "--tool", "target"))
    assert "--match position corrects the position alone, and leaves the orientation" in text
    assert "Positions alone were" not in said(call(folder, *words, "--match", "position"))


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A virtual UR3 with compliances and a target that is turned, seen in two frames that were estimated."""
    from calib.calibration import calibrate
    from calib.data.cell import Cell
    from calib.data.measurements import Measurements
    from calib.example import paper_urdf
    from calib.result.calibration_file import write_result
    from calib.robot.robot import Robot, read_only
    from calib.robot.torques import Payload, gravity_load

    folder = tmp_path_factory.mktemp("large")
    shutil.copy(paper_urdf(), folder / "robot.urdf")
    nominal = Robot.load(folder / "robot.urdf", "base", "tool0")
    true = Robot.load(Path(__file__).parents[2] / "urdf" / "ur3_calibrated.urdf", "base", "tool0")
    rng = np.random.default_rng(5)
    q = rng.uniform(-1.5, 1.5, (24, 6))
    T = np.eye(4)
    T[:3, 3], T[:2, :2] = [0.05, 0.05, 0.05], [[0.0, -1.0], [1.0, 0.0]]
    payload = Payload(2.0, read_only([0.0, 0.0, 0.05]))
    poses = true.poses(q + 1e-4 * gravity_load(nominal, q, payload)) @ T
    groups = ("left", "right") * 12
    poses[1::2, 0, 3] += 0.3  # the tracker stood elsewhere
    table = Measurements(
        nominal.joint_names, q, poses[:, :3, 3] + rng.normal(0.0, 2e-5, (24, 3)),
        rotations=poses[:, :3, :3], groups=groups, kinds=("pose",) * 24,
    )  # fmt: skip
    cell = Cell(
        target=T[:3, 3], target_rotation=T[:3, :3], estimate_frame=True, model="dh+compliance",
        payload=payload,
    )  # fmt: skip
    write_result(calibrate(nominal, table, cell=cell, validate=False), folder / "result.json")
    write(folder / "program.csv", HEADER, "-40,-85,75,-120,-45,0", "-20,-75,85,-140,-45,0")
    write(folder / "points.csv", "x [mm],y [mm],z [mm]", "300,-200,300")
    return folder


def joints_of(call, folder: Path, tmp_path: Path, *words: str) -> list[float]:
    """The joint values of the first row of commands."""
    path = tmp_path / "c.csv"
    done = call(
        folder, "compensate", "robot.urdf", "program.csv", *RESULT, *words, "-o", path, "--force"
    )
    assert done.code == 0, done.err
    return [float(table(path)[0][f"{name}_joint [deg]"]) for name in JOINTS]


def test_the_larger_model_and_what_the_tip_carries(call, large: Path, tmp_path: Path):
    usual = joints_of(call, large, tmp_path)
    assert joints_of(call, large, tmp_path, "--payload", "2 kg") == usual
    heavy = joints_of(call, large, tmp_path, "--payload", "5 kg")
    geometry = joints_of(call, large, tmp_path, "--geometry")
    assert 1e-6 < np.abs(np.subtract(heavy, usual)).max() < 5.0
    assert 1e-6 < np.abs(np.subtract(geometry, usual)).max() < 5.0
    words = ("compensate", "robot.urdf", "program.csv", *RESULT)
    assert "Verdict: none of result.json, its larger model 'dh+compliance'." in said(
        call(large, *words)
    )
    stronger = "Errors that grow with a joint's value or load, as those of the larger model"
    assert stronger in said(call(large, *words))
    assert stronger not in said(call(large, *words, "--geometry"))
    assert "its joint origins, without the larger model that it has." in said(
        call(large, *words, "--geometry")
    )
    message = refused(call(large, *words, "--geometry", "--payload", "5 kg"))
    assert "A payload is given, but the model in use has no compliances" in message
    assert '--payload was given as "heavy"; it must be a mass' in refused(
        call(large, *words, "--payload", "heavy")
    )


def test_frames_that_were_estimated(call, large: Path):
    words = ("compensate", "robot.urdf", "program.csv", *RESULT)
    text = said(call(large, *words))
    assert (
        "The frame of the measurements was estimated with the robot, so that places in the base"
        in text
    )
    assert "standard deviation of where it arrives (covariance)" in text
    text = said(call(large, *words, "--poses-in", "left"))
    assert re.search(
        r"set the controller's work object to \(.*\) mm, rotation vector \(.*\) deg in 'base'\.",
        text,
    )
    assert "standard deviation of where it arrives (covariance)" in text
    assert "The frame of the measurements was estimated" not in text
    assert "Poses are in the frame of the set-up 'left'." in text
    assert "work object" not in said(call(large, *words, "--poses-in", "left", "--send", "joints"))
    message = refused(call(large, *words, "--poses-in", "middle"))
    assert "The calibration has no set-up 'middle'; it has 'left', 'right'." in message
    message = refused(call(large, *words, "--poses-in", "measured"))
    assert "The calibration has 2 set-ups: 'left', 'right'. Name one of them." in message


def test_a_result_not_to_be_used_says_so_even_when_quiet(call, folder: Path, tmp_path: Path):
    table = json.loads((folder / "result.json").read_text())
    table["verdict"]["use"] = "do not use"
    path = tmp_path / "bad.json"
    path.write_text(json.dumps(table))
    words = ("compensate", "robot.urdf", "program.csv", "--calibration", path)
    done = call(folder, *words, "--quiet")
    assert (done.code, done.out) == (0, "")
    assert "the verdict of bad.json is 'do not use'" in done.err


def test_with_which_target_the_wanted_poses_were_computed(call, examples, folder: Path):
    # Stated before the fit: that is what the controller has, and what the program was made with.
    shutil.copy(examples.folder / "demo" / "calibration.json", folder)
    stated = "a tool at (-69.9700, 70.2000, 22.5200) mm in 'tool0'"
    computed = "The poses wanted were computed from the joint values with"
    before = (
        "It is where the target was stated to be before the calibration, which found it elsewhere."
    )
    asked = ("--calibration", "calibration.json", "--tool", "target")
    words = ("compensate", "robot.urdf", "program.csv", *asked)
    text = said(call(folder, *words))
    assert f"The poses to send are those of {stated}: set the controller's tool to that." in text
    assert f"{before} {computed} the same tool." in text
    text = said(call(folder, *words, "--send", "joints"))
    assert f"{computed} {stated}. {before}" in text
    assert "The poses to send" not in text
    write(folder / "both.csv", f"{HEADER},x [mm],y [mm],z [mm]", "-40,-85,75,-120,-45,0,-400,0,300")
    both = ("compensate", "robot.urdf", "both.csv", *asked)
    assert "The poses wanted" not in said(call(folder, *both))
    assert "a tool at" not in said(call(folder, *both, "--send", "joints"))
    # Never stated: nobody has another place for it than the one that was found.
    words = ("compensate", "robot.urdf", "program.csv", *RESULT, "--tool", "target")
    text = said(call(folder, *words))
    after = "It is where the calibration found the target, whose place was not stated before."
    assert f"set the controller's tool to that. {after} {computed} the same tool." in text
    place = re.search(r"What arrives: the point \((.*?)\) mm", text)
    assert place
    text = said(call(folder, *words, "--send", "joints"))
    used = re.search(rf"{computed} a tool at \((.*?)\) mm in 'tool0'\. {after}", text)
    assert used
    assert numbers(used[1]) == pytest.approx(numbers(place[1]), abs=1e-3)


@pytest.mark.parametrize(
    ("verdict", "wanted"),
    [
        ({"use": "do not use", "reasons": [{"code": "no_length", "values": []}]},
         "Verdict: do not use of result.json, its joint origins. Nothing that was measured is a length, "),
        ({"use": "use with care", "reasons": [{"code": "may_be_chance", "values": [{"name": "gain", "value": 1}]}]},
         "Verdict: use with care of result.json, its joint origins. The gain on unseen rows is within "),
        (None, "Verdict: none of result.json, its joint origins. The result was not validated"),
    ],
)  # fmt: skip
def test_the_verdict_of_the_result_comes_first(call, folder: Path, verdict: object, wanted: str):
    result = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    result["verdict"], result["larger"] = verdict, None
    (folder / "result.json").write_text(json.dumps(result), encoding="utf-8")
    assert said(call(folder, "compensate", "robot.urdf", "program.csv", *RESULT)).startswith(wanted)


def test_the_rows_with_the_largest_corrections_are_shown(call, folder: Path):
    # Row 7 is near a straight wrist, where corrections are large; 1 to 6 are the same but for rounding.
    plain, near = "-40,-85,75,-120,-45,0", "-40,-85,75,-120,5,0"
    write(folder / "long.csv", HEADER, *[plain] * 6, near)
    lines = call(folder, "compensate", "robot.urdf", "long.csv", *RESULT, "-o", "c.csv").lines
    at = next(i for i, line in enumerate(lines) if line.startswith("Largest corrections [mm,deg]"))
    assert [line.split()[1] for line in lines[at + 1 : at + 6]] == ["7", "1", "2", "3", "4"]
    assert lines[at + 6] == ""
    assert any(re.match(r"  wrist_1_joint .* row 7$", line) for line in lines)
    write(folder / "long.csv", HEADER, *[plain] * 3)
    lines = call(folder, "compensate", "robot.urdf", "long.csv", *RESULT).lines
    at = next(i for i, line in enumerate(lines) if line.startswith("Corrections [mm, deg]"))
    assert [line.split()[1] for line in lines[at + 1 : at + 4]] == ["1", "2", "3"]
    assert sum(line.endswith("row 1") for line in lines[:at]) == 6


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "give one of them."),
        (("--corrected", "robot.urdf"), "robot.urdf and robot.urdf have the same joint origins from '"),
        ((*RESULT, "--base", "base_link"), "is the result for --base base, and 'base_link' was given"),
        ((*RESULT, "--tool", "target:ball"), "has no target 'ball'; it has 'target'"),
        ((*RESULT, "--poses-in", "left"), "has no set-up 'left'; it has 'the one without a name'"),
        (("--corrected", "corrected.urdf", "--poses-in", "left"), "frame is to be 'left' of a calibration, but two"),
        ((*RESULT, "--payload", "5 kg", "--geometry"), "A payload is given, but the model in use has no"),
        ((*RESULT, "--start", "elbow_joint=1 deg"), "a start for the first row has no use"),
        ((*RESULT, "--lever", "5 mm"), "here 'pose' is matched. Leave it out"),
        ((*RESULT, "-o", "program.csv", "--force"), "program.csv is also an input of this command"),
        ((*RESULT, "-o", "data.csv"), "data.csv exists already; add --force"),
    ],
)  # fmt: skip
def test_what_is_refused(call, folder: Path, words: tuple[str, ...], message: str):
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    text = refused(call(folder, "compensate", "robot.urdf", "program.csv", *words))
    assert message in text
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_without_a_file_nothing_is_written(call, folder: Path):
    done = call(folder, "compensate", "robot.urdf", "program.csv", *RESULT)
    assert done.lines[-1] == "Nothing was written; -o commands.csv writes the commands."
    assert all(line == line.rstrip() and len(line) <= 100 for line in done.lines)
