"""``calib fleet``: a manifest in, a folder of results and a table out; and what is refused."""

from __future__ import annotations

import csv
import json
import re
import shutil
from pathlib import Path

import pytest

from tests.fleets.arms import arms

DOC = Path(__file__).parents[2] / "docs" / "fleet.md"
ARM = ("--base", "base", "--tip", "tool0", "--model", "zeros", "--workers", "1")
QUICK = (*ARM, "--no-reports", "--no-validate")


@pytest.fixture
def arms_shop(tmp_path: Path, ur3) -> Path:
    """A folder with six arms and their manifest."""
    arms(tmp_path, ur3, range(6))
    manifest(tmp_path, *(f"SN-{k},robot.urdf,arm-{k}.csv" for k in range(6)))
    return tmp_path


def manifest(folder: Path, *rows: str, header: str = "name,robot,data") -> None:
    (folder / "m.csv").write_text("\n".join([header, *rows, ""]), encoding="utf-8")


def test_a_fleet_is_calibrated_compared_and_kept(call, arms_shop: Path):
    done = call(arms_shop, "fleet", "m.csv", "--out", "r", *ARM, "--no-reports")
    assert (done.code, done.err) == (0, "")
    assert done.lines[0] == "Errors and noise, rms [mm]"
    heads = "robot verdict urdf model nominal calibrated held-out noise rows out"
    assert " ".join(done.lines[1].split()) == heads
    assert [line.split()[0] for line in done.lines[2:8]] == [f"SN-{k}" for k in range(6)]
    assert re.fullmatch(
        r"6 of 6 robots calibrated \(.*\); \d fleet outliers?, 0 failed\.", done.lines[-3]
    )
    assert done.lines[-2:] == ["Written: r/fleet.csv", "Written: r/fleet.json"]
    again = call(arms_shop, "fleet", "m.csv", "--out", "r", *ARM, "--no-reports")
    assert "calibrated (" in again.lines[-3]
    assert ", 6 of them by an earlier run; " in again.lines[-3]
    quiet = call(
        arms_shop, "fleet", "m.csv", "--out", "r", *ARM, "--no-reports", "--quiet", "--force"
    )
    assert (quiet.code, quiet.out, quiet.err) == (0, "", "")

    table = json.loads((arms_shop / "r" / "fleet.json").read_text())
    keys = {"schema", "notes", *keys_of("robots", table), *keys_of("odd", table)}
    keys |= {f"robots[].{key}" for key in keys_of("parameters", table["robots"][0])}
    said = set(
        re.findall(
            r"^\| `([a-z_\[\].]+)` \| [a-z]+(?:, null| of texts)? \|", DOC.read_text(), re.MULTILINE
        )
    )
    # Of the odd ones there may be none here.
    assert {k for k in keys if not k.startswith("odd")} - {"robots[].parameters"} == {
        k for k in said if not k.startswith("odd")
    }
    rows = list(csv.DictReader((arms_shop / "r" / "fleet.csv").read_text().splitlines()))
    assert [row["name"] for row in rows] == [f"SN-{k}" for k in range(6)]
    assert {row["unseen"] for row in rows} == {"cross-validation"}
    for row, one in zip(rows, table["robots"], strict=True):
        assert float(row["nominal_rms [mm]"]) == pytest.approx(1e3 * one["nominal_rms_m"], rel=1e-5)
        assert float(row["sigma [mm]"]) == pytest.approx(1e3 * one["sigma_m"], rel=1e-5)


def keys_of(name: str, table: dict[str, list[dict[str, object]]]) -> set[str]:
    return {f"{name}[].{key}" for one in table[name] for key in one}


def test_failed_and_odd_ones_are_told(call, arms_shop: Path):
    shutil.copy(arms_shop / "arm-1.csv", arms_shop / "again.csv")
    rows = [f"SN-{k},robot.urdf,arm-{k}.csv" for k in range(6)]
    manifest(
        arms_shop,
        *rows,
        "SN-6,robot.urdf,again.csv",
        "SN-7,robot.urdf,gone.csv",
        "SN-8,ur99,arm-1.csv",
    )
    done = call(arms_shop, "fleet", "m.csv", "--out", "r", *QUICK)
    assert done.code == 1
    assert done.err == "calib: 2 of 9 robots failed.\n"
    assert done.out.count("line 9") == 1
    place = done.lines.index("Data given twice, which count once in what is usual:")
    assert done.lines[place + 1 : place + 3] == [
        "  SN-1: the same measurements as SN-6 (arm-1.csv)",
        "  SN-6: the same measurements as SN-1 (again.csv)",
    ]
    assert re.search(r"; \d fleet outliers?, 2 with the data of another, 2 failed\.", done.out)
    assert any(
        line.startswith("  SN-8: m.csv, line 10: ") and "ur99" in line for line in done.lines
    )
    assert "7 of 9 robots calibrated (7 no verdict); " in done.lines[-3]
    rows = list(csv.DictReader((arms_shop / "r" / "fleet.csv").read_text().splitlines()))
    assert rows[1]["odd"] == "the same measurements as SN-6 (arm-1.csv)"
    assert rows[7]["status"] == "failed"
    quiet = call(arms_shop, "fleet", "m.csv", "--out", "r", *QUICK, "--quiet")
    assert (quiet.out, quiet.err) == ("", "calib: 2 of 9 robots failed.\n")
    odd = json.loads((arms_shop / "r" / "fleet.json").read_text())["odd"]
    said = set(re.findall(r"^\| `odd\[\]\.([a-z]+)`", DOC.read_text(), re.MULTILINE))
    assert {key for one in odd for key in one} == said


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
    (arms_shop / "sub" / "m.csv").write_text("\n".join([header, *rows]))
    words = ("--base", "base", "--tip", "tool0", "--no-reports", "--no-validate", "--workers", "1")
    given = ["--target", "-70 70 22.5 mm", "--fix-target", "--freeze", "elbow_joint.zero"]
    given += ["--priors", "given"]
    done = call(arms_shop, "fleet", "sub/m.csv", "--out", "r", *words, *given, "--model", "zeros",
                "--repeats", "average", "--points-unit", "m", "--target-link", "--accept")  # fmt: skip
    assert done.code == 0
    found = {
        name: json.loads((arms_shop / "r" / name / "result.json").read_text())
        for name in ("plain", "celled", "own", "listed", "renamed", "named", "absolute")
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
