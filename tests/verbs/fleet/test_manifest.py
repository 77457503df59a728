"""The manifest of a fleet: a row's own options win; what is no manifest is refused."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from calib.cli.options import FitOptions
from calib.verbs.fleet.manifest import options_of_row
from tests.verbs.fleet.test_command import QUICK, arms_shop, manifest

__all__ = ["arms_shop"]


def test_the_options_of_a_row_override_those_of_the_line():
    line = FitOptions(Path("line.toml"), {"base": "base", "hold": ["a=1 m"], "priors": "off"})
    cells = {"hold": "b=2 m; c=1 deg", "camera": "left=640x480;right=800x600", "model": "dh"}
    options = options_of_row(cells, Path("folder"), line)
    assert options.file == Path("line.toml")
    assert options.given == {
        "base": "base",
        "hold": ["b=2 m", "c=1 deg"],
        "priors": "off",
        "camera": ["left=640x480", "right=800x600"],
        "model": "dh",
    }
    cell = FitOptions(None, options.given).cell()
    assert [camera.width for camera in cell.cameras.values()] == [640, 800]
    assert options_of_row({"cell": "c.toml"}, Path("folder"), line).file == Path("folder/c.toml")


@pytest.mark.slow
def test_a_row_s_own_words_win(call, arms_shop: Path):
    (arms_shop / "sub").mkdir()
    (arms_shop / "cell.toml").write_text('model = "dh"\n')
    for name in ("arm-0.csv", "arm-1.csv", "robot.urdf"):
        shutil.copy(arms_shop / name, arms_shop / "sub" / name)
    table = [line.split(",") for line in (arms_shop / "sub" / "arm-1.csv").read_text().splitlines()]
    places = [i for i, head in enumerate(table[0]) if head[0] in "xyz" and head[1] == " "]
    joints = [[c for i, c in enumerate(row) if i not in places] for row in table]
    lines = [["point", *joints[0]], *([f"P{k}", *row] for k, row in enumerate(joints[1:], 1))]
    (arms_shop / "sub" / "joints.csv").write_text("\n".join(",".join(line) for line in lines))
    points = [f"P{k} " + " ".join(row[i] for i in places) for k, row in enumerate(table[1:], 1)]
    (arms_shop / "sub" / "points.txt").write_text("\n".join(points))
    table[0] = [f"J{k}" if "joint [" in head else head for k, head in enumerate(table[0])]
    (arms_shop / "sub" / "renamed.csv").write_text("\n".join(",".join(line) for line in table))
    names = ["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"]
    first = next(k for k, head in enumerate(table[0]) if head.startswith("J"))
    unit = "deg" if "[deg]" in (arms_shop / "arm-1.csv").read_text().splitlines()[0] else "rad"
    columns = ";".join(f"J{first + k}={name}_joint [{unit}]" for k, name in enumerate(names))
    header = "name,robot,data,cell,points,points_unit,base,tip,target,frame,model,kind,payload,hold,columns"
    rows = [
        "plain,robot.urdf,arm-0.csv,,,,,,,,,,,,",
        "celled,robot.urdf,arm-0.csv,../cell.toml,,,,,,,,,,,",
        "own,robot.urdf,arm-0.csv,,,,base_link,wrist_3_link,0 0 50 mm,estimate,zeros+gain,point,1 kg,,",
        "listed,robot.urdf,joints.csv,,points.txt,mm,,,,,,,,,",
        f"renamed,robot.urdf,renamed.csv,,,,,,,,,,,,{columns}",
        f"named,ur3,{arms_shop / 'arm-0.csv'},,,,,,,,,,,,",
        f"absolute,{arms_shop / 'robot.urdf'},arm-0.csv,,,,,,,,,,,,",
    ]
    bare = columns.replace(f" [{unit}]", "")
    rows = [f"{row}," for row in rows]
    rows.append(f"by unit,robot.urdf,renamed.csv,,,,,,,,,,,,{bare},{unit}")
    (arms_shop / "sub" / "m.csv").write_text("\n".join([f"{header},joint_unit", *rows]))
    words = ("--base", "base", "--tip", "tool0", "--no-reports", "--no-validate", "--workers", "1")
    given = ["--target", "-70 70 22.5 mm", "--fix-target", "--freeze", "elbow_joint.zero"]
    given += ["--priors", "given"]
    done = call(arms_shop, "fleet", "sub/m.csv", "--out", "r", *words, *given, "--model", "zeros",
                "--repeats", "average", "--points-unit", "m", "--target-link", "--accept")  # fmt: skip
    assert done.code == 0
    found = {
        name: json.loads((arms_shop / "r" / name / "result.json").read_text())
        for name in ("plain", "celled", "own", "listed", "renamed", "named", "absolute", "by unit")
    }
    plain, own = found["plain"], found["own"]
    assert (plain["robot"]["base"], plain["robot"]["tip"]) == ("base", "tool0")
    assert (own["robot"]["base"], own["robot"]["tip"]) == ("base_link", "wrist_3_link")
    # --model on the line wins over a cell file, a row's model over both.
    assert [found[n]["model"]["set"] for n in ("plain", "celled", "own")] == ["zeros"] * 3
    assert own["non_geometric"]["model"]["set"] == "zeros+gain"
    assert own["non_geometric"]["payload"]["mass_kg"] == 1.0
    assert (plain["frames"]["frame_estimated"], own["frames"]["frame_estimated"]) == (False, True)
    assert plain["frames"]["target_m"] == plain["frames"]["target_given_m"]
    assert own["frames"]["target_given_m"] == [0.0, 0.0, 0.05]
    assert not plain["frames"]["target_estimated"]
    assert plain["model"]["frozen"] == ["elbow_joint.zero"]
    assert "calib_target" in (arms_shop / "r" / "plain" / "corrected.urdf").read_text()
    for name in ("listed", "renamed", "named", "absolute"):
        assert found[name]["solver"]["status"] == "converged"
    assert found["listed"]["parameters"] == found["renamed"]["parameters"]
    assert found["by unit"]["parameters"] == found["renamed"]["parameters"]


@pytest.mark.parametrize(
    ("header", "rows", "said"),
    [
        ("name,robot", ["a,robot.urdf"], "m.csv: of its columns 'data' is missing. A manifest has 'name', 'robot', "),
        ("name,robot,data,color", ["a,b,c,d"], "of its columns 'color' is not known"),
        ("name,robot,data,data", ["a,b,c,d"], "of its columns 'data' is not known, or there twice"),
        ("name,robot,data", [], "m.csv: there are no robots in it, only a header."),
        ("name,robot,data", ["a,robot.urdf"], "the row has 2 cells, the header has 3"),
        ("name,robot,data", ["a,b,c,d"], "the row has 4 cells, the header has 3"),
        ("name,robot,data", ["a,b,c", "A,b,c"], "m.csv, line 3: 'A' cannot be the name of a robot's folder"),
        ("name,robot,data", ["../a,b,c"], "m.csv, line 2: '../a' cannot be the name of a robot's folder"),
    ],
)  # fmt: skip
def test_a_manifest_that_is_none_is_refused(call, tmp_path: Path, header, rows, said):
    manifest(tmp_path, *rows, header=header)
    done = call(tmp_path, "fleet", "m.csv", "--out", "r", *QUICK)
    assert (done.code, done.out) == (1, "")
    assert said in done.err
    assert done.err.count("\n") == 1
    assert not (tmp_path / "r").exists()


def test_serial_number_and_date_of_a_row_are_those_of_its_record(call, arms_shop: Path):
    (arms_shop / "cell.toml").write_text('[record]\nrobot_serial = "cell"\noperator = "Ann"\n')
    manifest(
        arms_shop,
        "first,robot.urdf,arm-0.csv,cell.toml,SN-1,2026-03-10",
        "second,robot.urdf,arm-1.csv,cell.toml,,",
        header="name,robot,data,cell,serial,date",
    )
    assert call(arms_shop, "fleet", "m.csv", "--out", "r", *QUICK).code == 0
    rows = json.loads((arms_shop / "r" / "fleet.json").read_bytes())["robots"]
    assert [row["serial"] for row in rows] == ["SN-1", "cell"]
    assert rows[0]["measured_on"] == "2026-03-10"
    assert rows[1]["measured_on"] == rows[1]["calibrated_on"]
    record = json.loads((arms_shop / "r" / "first" / "result.json").read_bytes())["record"]
    assert (record["robot_serial"], record["operator"]) == ("SN-1", "Ann")
