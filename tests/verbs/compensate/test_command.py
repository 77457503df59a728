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
from scipy.spatial.transform import Rotation

from calib.verbs.compensate.command import parse_pair, parse_tool
from tests.parts import of_an_earlier_version
from tests.places import ROOT

DOC = ROOT / "docs" / "compensation.md"
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
HEADER = ",".join(f"{name}_joint [deg]" for name in JOINTS)
FILES = ("robot.urdf", "data.csv", "result.json", "corrected.urdf")
RESULT = ("--calibration", "result.json")


@pytest.mark.parametrize(
    ("text", "pair"),
    [
        ("10 mm", (0.01, None)),
        ("2deg", (None, np.radians(2.0))),
        ("0.1 deg, 500 um", (5e-4, np.radians(0.1))),
    ],
)
def test_a_length_and_an_angle(text: str, pair: tuple[float | None, float | None]):
    assert parse_pair(text, "--limit", "1 mm") == tuple(
        None if value is None else pytest.approx(value) for value in pair
    )


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
    printed = {}
    for block in re.findall(r"```sh\n(.*?)```", text, re.DOTALL):
        for line in block.splitlines():
            program, verb, *words = shlex.split(line)
            assert program == "calib"
            if verb != "demo":
                done = call(tmp_path, verb, *words)
                assert (done.code, done.err) == (0, ""), line
                printed.setdefault(verb, done.out)
    blocks = re.findall(r"^```\w*\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    shown = next(block for block in blocks if block.startswith("Verdict: "))
    found = printed["compensate"]
    assert re.sub(r"[\d.-]+", "#", shown) == re.sub(r"[\d.-]+", "#", found)
    assert numbers(found) == pytest.approx(numbers(shown), abs=2e-3)
    # The virtual robot, which was measured again at the commands, is where it should be.
    assert "0.064" in printed["evaluate"]
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


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A virtual UR3 with compliances and a target that is turned, seen in two frames that were estimated."""
    from calib.basics.arrays import read_only
    from calib.data.cell import Cell
    from calib.data.measurements import Measurements
    from calib.example import paper_urdf
    from calib.result.calibrate import calibrate
    from calib.result.calibration_file import write_result
    from calib.robot.gravity import Payload, gravity_loads
    from calib.robot.robot import Robot

    folder = tmp_path_factory.mktemp("large")
    shutil.copy(paper_urdf(), folder / "robot.urdf")
    nominal = Robot.load(folder / "robot.urdf", "base", "tool0")
    true = Robot.load(ROOT / "urdf" / "ur3_calibrated.urdf", "base", "tool0")
    rng = np.random.default_rng(5)
    q = rng.uniform(-1.5, 1.5, (24, 6))
    T = np.eye(4)
    T[:3, 3], T[:2, :2] = [0.05, 0.05, 0.05], [[0.0, -1.0], [1.0, 0.0]]
    payload = Payload(2.0, read_only([0.0, 0.0, 0.05]))
    poses = true.poses(q + 1e-4 * gravity_loads(nominal, q, payload)[..., 0]) @ T
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


def test_the_non_geometric_model_and_what_the_tip_carries(call, large: Path, tmp_path: Path):
    usual = joints_of(call, large, tmp_path)
    assert joints_of(call, large, tmp_path, "--payload", "2 kg") == usual
    for words in (("--payload", "5 kg"), ("--geometry",)):
        other = joints_of(call, large, tmp_path, *words)
        assert 1e-6 < np.abs(np.subtract(other, usual)).max() < 5.0


def test_what_is_printed_with_an_estimated_frame(call, large: Path):
    words = ("compensate", "robot.urdf", "program.csv", *RESULT)
    text = said(call(large, *words))
    assert text.startswith("Verdict: none (result.json, non-geometric model 'dh+compliance')")
    assert "the base in the measurement frame" in text
    left = said(call(large, *words, "--poses-in", "left"))
    assert "Poses are in the measured frame of 'left'." in left
    assert "Set the controller's work object to (" in left
    assert "it has 'left', 'right'" in call(large, *words, "--poses-in", "middle").err


def test_coupled_readings_of_the_cell_file(call, folder: Path):
    """The program in readings of a controller that couples them: its commands are the same joint angles."""
    write(
        folder / "cell.toml",
        'base = "base"',
        'tip = "tool0"',
        "[coupling]",
        "elbow_joint = { shoulder_lift_joint = -1.0 }",
    )
    write(folder / "readings.csv", HEADER, "-40,-85,-10,-120,-45,0", "-20,-75,10,-140,-45,0")
    model = ("--corrected", "corrected.urdf", "--accept")
    chain = ("--base", "base", "--tip", "tool0")
    plain = call(folder, "compensate", "robot.urdf", "program.csv", *model, *chain, "-o", "a.csv")
    words = ("--cell", "cell.toml", "-o", "b.csv")
    coupled = call(folder, "compensate", "robot.urdf", "readings.csv", *model, *words)
    assert (plain.code, coupled.code) == (0, 0)
    assert "'elbow_joint' is at its reading minus that of 'shoulder_lift_joint'." in said(coupled)
    for angles, readings in zip(table(folder / "a.csv"), table(folder / "b.csv"), strict=True):
        for name in JOINTS:
            value = float(readings[f"{name}_joint [deg]"])
            if name == "elbow":
                value -= float(readings["shoulder_lift_joint [deg]"])
            assert value == pytest.approx(float(angles[f"{name}_joint [deg]"]), abs=1e-8)
        assert readings["x [mm]"] == angles["x [mm]"]
    # A result knows its own readings, and this one has none that are coupled.
    words = ("--calibration", "result.json", "--cell", "cell.toml", "-o", "c.csv")
    refused = call(folder, "compensate", "robot.urdf", "readings.csv", *words)
    assert refused.code != 0
    assert "coupled readings of no joint" in refused.err


def test_orientations_of_a_program_of_joint_values_are_those_of_its_brand(call, folder: Path):
    write(folder / "kuka.csv", "A1,A2,A3,A4,A5,A6", "-40,-85,75,-120,-45,0")
    words = ("robot.urdf", "kuka.csv", *RESULT, "--columns", "kuka", "-o")
    assert call(folder, "compensate", *words, "brand.csv").code == 0
    (row,) = table(folder / "brand.csv")
    given = ("--orientation", "rpy")
    assert call(folder, "compensate", *words, "given.csv", *given).code == 0
    (other,) = table(folder / "given.csv")
    names = {"A [deg]": "yaw [deg]", "B [deg]": "pitch [deg]", "C [deg]": "roll [deg]"}
    for name, same in names.items():
        assert float(row[name]) == pytest.approx(float(other[same]), abs=1e-9)


def test_a_corrected_urdf_in_place_of_a_result(call, folder: Path):
    names = ("--corrected", "corrected.urdf", "--base", "base", "--tip", "tool0")
    words = ("compensate", "robot.urdf", "program.csv")
    assert call(folder, *words, *RESULT, "--geometry", "-o", "a.csv").code == 0
    done = call(folder, *words, *names, "-o", "b.csv")
    assert said(done).startswith("The true robot is corrected.urdf, a URDF")
    by_result, by_urdf = (table(folder / name) for name in ("a.csv", "b.csv"))
    for row, other in zip(by_result, by_urdf, strict=True):
        # Of a URDF alone no error is known.
        assert float(row.pop("expected error [mm]")) > 0.0
        assert list(row) == list(other)
        a, b = (numbers(",".join(cells.values())) for cells in (row, other))
        assert a == pytest.approx(b, abs=1e-6)
    # The root is not the frame that the controller counts in.
    text = said(call(folder, *words, *names[:2], "--tip", "tool0"))
    assert "Poses are in 'world'." in text


def test_rows_that_cannot_be_reached(call, folder: Path):
    write(folder / "far.csv", f"row,{HEADER},x [mm],y [mm],z [mm]", "a,-40,-85,75,-120,-45,0,-400,0,300",
          "b,-40,-85,75,-120,-45,0,900,900,900")  # fmt: skip
    words = ("compensate", "robot.urdf", "far.csv", *RESULT, "--tool", "target", "-o", "c.csv")
    done = call(folder, *words)
    assert (done.code, done.out) == (1, "")
    assert done.err.startswith(
        "calib: 1 of 2 rows have no command, and nothing was written:\n  row b: the true robot cannot reach it"
    )
    assert not (folder / "c.csv").exists()
    skipped = call(folder, *words, "--skip")
    assert (skipped.code, skipped.err) == (0, "")
    assert [row["status"] for row in table(folder / "c.csv")] == ["ok", "no command: unreachable"]


def test_an_accepted_verdict_is_said_even_when_quiet(call, folder: Path):
    content = of_an_earlier_version(json.loads((folder / "result.json").read_text()))
    content["verdict"]["use"] = "do not use"
    (folder / "bad.json").write_text(json.dumps(content))
    words = ("compensate", "robot.urdf", "program.csv", "--calibration", "bad.json")
    done = call(folder, *words, "--accept", "--quiet")
    assert (done.code, done.out) == (0, "")
    assert "the verdict on 'bad.json' is: do not use (" in done.err
    text = call(folder, *words, "--accept").out
    assert text.startswith("Verdict: do not use (bad.json, joint origins)")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "Give one of --calibration"),
        ((*RESULT, "--payload", "5 kg", "--geometry"), "which --geometry leaves out"),
        ((*RESULT, "--tolerance", "5 kg"), '--tolerance was given as "5 kg"'),
        ((*RESULT, "-o", "data.csv"), "exists already; overwrite it"),
    ],
)
def test_what_is_refused(call, folder: Path, words: tuple[str, ...], message: str):
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    done = call(folder, "compensate", "robot.urdf", "program.csv", *words)
    assert (done.code, done.out) == (1, "")
    assert message in " ".join(done.err.split())
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


@pytest.mark.parametrize(
    ("text", "place", "turn"),
    [
        ("0 0 150 mm", [0, 0, 0.15], [0, 0, 0]),
        ("0, -1.5, 15cm", [0, -0.015, 0.15], [0, 0, 0]),
        ("0 0 0.15 m 0 0 90 deg", [0, 0, 0.15], [0, 0, np.pi / 2]),
    ],
)
def test_a_tool(text: str, place: list[float], turn: list[float]):
    T = np.array(parse_tool(text))
    assert T[:3, 3] == pytest.approx(place)
    assert T[:3, :3] == pytest.approx(Rotation.from_rotvec(turn).as_matrix())
    assert parse_tool("target") == ""
    assert parse_tool(" target:upper ball ") == "upper ball"
