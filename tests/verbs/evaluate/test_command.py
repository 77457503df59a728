from __future__ import annotations

import csv
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from tests.show.pages import Page

RESULT = ("--calibration", "result.json")
EVALUATE = ("evaluate", "corrected.urdf", "data.csv", *RESULT)


def load(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


@pytest.fixture
def folder(examples) -> Path:
    return examples.folder


def same_errors(evaluated: Any, fitted: Any) -> None:
    for rows in ("estimation", "validation"):
        assert evaluated[rows].keys() == fitted[rows].keys()
        for unit, figures in fitted[rows].items():
            for key, value in figures.items():
                assert evaluated[rows][unit][key] == pytest.approx(value, abs=1e-9, rel=0)


def test_the_nominal_urdf_with_the_json_is_the_fit(examples, folder: Path):
    done = examples.starting("calib evaluate robot.urdf data.csv --calibration result.json")
    assert (done.code, done.err) == (0, "")
    assert "mm in tool0, as the result has it." in done.lines[0]
    assert "the URDF as it is:" in done.lines
    assert "the robot with the joint origins of result.json:" in done.lines
    assert done.lines[-1] == "Written: errors.json"
    errors = load(folder / "errors.json")["errors"]
    same_errors(errors["calibration"], load(folder / "result.json")["errors"]["calibrated"])
    assert errors["urdf"]["validation"]["m"]["rms"] > 2e-3


def test_the_link_carries_the_target(examples):
    done = examples.starting("calib evaluate target.urdf")
    assert (done.code, done.err) == (0, "")
    assert done.lines[0].endswith("mm in tool0, as the URDF's link 'calib_target' has it.")


def test_a_wrong_base_is_named_and_another_than_the_results_refused(call, folder: Path):
    done = call(folder, "evaluate", "robot.urdf", "data.csv")
    assert (done.code, "frame of 'base': try --base base." in " ".join(done.out.split())) == (
        0,
        True,
    )
    for option, link in (("base", "world"), ("tip", "ee_link")):
        done = call(folder, "evaluate", "robot.urdf", "data.csv", f"--{option}", link, *RESULT)
        assert (done.code, done.out) == (1, "")
        assert done.err.startswith(f"calib: result.json is the result for --{option} ")
        assert f"'{link}' was given" in done.err


def test_a_tolerance_that_is_kept(examples):
    done = examples.starting(
        "calib evaluate corrected.urdf data.csv --calibration result.json --tol"
    )
    assert (done.code, done.err) == (0, "")
    assert done.lines[0] == "Verdict: pass"
    head = "Poses, the worst first, of the robot with the joint origins of result.json:"
    table = done.lines[done.lines.index(head) :]
    assert [line.split()[1] for line in table[2:7]] == ["32", "35", "34", "31", "33"]
    rows = [line.split()[0] for line in done.lines if line.startswith("  ") and "5 " in line[33:40]]
    assert rows[-3:] == ["nominal", "URDF", "calibrated"]


@pytest.mark.parametrize(
    ("words", "outcome"),
    [
        (("--tolerance", "0.3 mm"), "fail"),
        (("--tolerance", "0.3 mm", "--uncertainty", "0.05 mm"), "undecided"),
        (("--tolerance", "0.3 mm", "--criterion", "mean"), "pass"),
        (("--tolerance", "0.35 mm", "--criterion", "single"), "pass"),
        (("--tolerance", "0.5 mm", "--judge", "nominal"), "fail"),
        (("--tolerance", "500 um", "--judge", "urdf"), "pass"),
    ],
)
def test_the_exit_code_says_whether_a_tolerance_is_kept(
    call, folder: Path, tmp_path: Path, words: tuple[str, ...], outcome: str
):
    done = call(folder, *EVALUATE, *words, "--json", tmp_path / "e.json")
    assert (done.code, done.err) == (0 if outcome == "pass" else 3, "")
    assert done.lines[0] == f"Verdict: {outcome}"
    assert done.lines[-1].startswith("Written: ")
    stored = load(tmp_path / "e.json")
    assert stored["acceptance"]["outcome"] == outcome
    assert stored["accuracy"]["nominal"]["poses"][1]["rows"] == [32]
    quiet = call(folder, *EVALUATE, *words, "--quiet")
    assert (quiet.code, quiet.out, quiet.err) == (done.code, "", "")


@pytest.mark.parametrize(("tolerance", "outcome"), [("0.5 mm", "pass"), ("0.3 mm", "fail")])
def test_the_report_has_the_printed_figures_and_the_cells_record(
    call, folder: Path, tmp_path: Path, monkeypatch, tolerance: str, outcome: str
):
    (tmp_path / "cell.toml").write_text("[record]\nrobot_serial = 4711\n", encoding="utf-8")
    report, table = tmp_path / "test.html", tmp_path / "e.json"
    words = ("--tolerance", tolerance, "--uncertainty", "0.02 mm", "--cell", tmp_path / "cell.toml")
    done = call(folder, *EVALUATE, *words, "--report", report, "--json", table)
    assert done.code == (0 if outcome == "pass" else 3)
    assert done.lines[-2:] == [f"Written: {table}", f"Written: {report}"]
    page = Page(report.read_text(encoding="utf-8"))
    assert page.forms["Robot, serial no."] == "4711"
    assert page.text.count(f"Verdict: {outcome}") == 3
    printed = {*re.findall(r"-?\d+\.\d+", done.out)}
    cells = {cell for caption, rows in page.tables if caption for row in rows for cell in row[1:]}
    figures = {cell for cell in cells if re.fullmatch(r"-?\d+\.\d+", cell)}
    assert len(figures) > 40
    assert figures - printed == set()
    assert load(table)["record"]["robot_serial"] == "4711"
    monkeypatch.setattr("calib.show.report_file.find_browser", lambda: None)
    refused = call(folder, *EVALUATE, "--report", tmp_path / "test.pdf")
    assert (refused.code, "let the name end in .html" in refused.err) == (1, True)


def table_of(path: Path) -> list[list[str]]:
    """The rows of a table, its header the first."""
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.reader(file))


def write(path: Path, rows: list[list[Any]], ends: str = "\n") -> Path:
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator=ends).writerows(rows)
    return path


@pytest.mark.parametrize(
    ("chosen", "code", "said"),
    [
        (range(30), 3, "they can fail, but not pass. Measure fresh ones."),
        (range(34), 3, "was fitted to 30 of the 34 rows, and the others are of fewer than 5 poses"),
        (range(35), 0, "5 of the 35 rows are evaluated; the others were used for the calibration."),
        (
            range(29, 35),
            0,
            "5 of the 6 rows are evaluated; the other was used for the calibration.",
        ),
        (range(30, 35), 0, "5 of 5 poses are within"),
    ],
)
def test_rows_that_were_fitted_are_known_in_any_file(
    call, folder: Path, tmp_path: Path, chosen: range, code: int, said: str
):
    """Shuffled, renumbered, with other line ends and without the column that says which rows were fitted."""
    header, *rows = table_of(folder / "data.csv")
    rows = [rows[k] for k in np.random.default_rng(1).permutation(chosen)]
    columns = [k for k, label in enumerate(header) if label not in ("row", "set")]
    write(tmp_path / "new.csv", [[one[k] for k in columns] for one in [header, *rows]], "\r\n")
    words = ("evaluate", "corrected.urdf", tmp_path / "new.csv", *RESULT, "--tolerance", "5 mm")
    done = call(folder, *words, "--json", tmp_path / "e.json")
    assert (done.code, done.err) == (code, "")
    assert done.lines[0] == ("Verdict: undecided" if code else "Verdict: pass")
    assert said in " ".join(done.out.split())
    found = load(tmp_path / "e.json")["accuracy"]["calibration"]
    assert (found["measured"], found["fitted"]) == (len(chosen), sum(k < 30 for k in chosen))
    assert found["seen"] == bool(code)
    # Nor does it help to find frame or target anew.
    assert call(folder, *words, "--frame", "estimate").code == code


def test_a_tracker_that_moved_is_named(call, folder: Path, tmp_path: Path):
    header, *rows = table_of(folder / "data.csv")
    x = header.index("x [mm]")
    moved = [[*row[:x], float(row[x]) + 20.0, *row[x + 1 :]] for row in rows]
    table = write(tmp_path / "moved.csv", [header, *moved])
    words = ("evaluate", "corrected.urdf", table, *RESULT)
    assert "Then add --frame estimate." in " ".join(call(folder, *words).out.split())
    failed = call(folder, *words, "--tolerance", "3 mm", "--json", tmp_path / "e.json")
    assert failed.code == 3
    assert " ".join(failed.out.split()).count("add --frame estimate") == 1
    anew = call(folder, *words, "--frame", "estimate", "--tolerance", "3 mm")
    assert anew.code == 0
    assert "did the tracker" not in anew.out
    named = write(tmp_path / "named.csv", [[*header, "target"], *([*row, "B"] for row in moved)])
    call(
        folder, *EVALUATE[:2], named, *RESULT, "--frame", "estimate", "--json", tmp_path / "b.json"
    )
    assert load(tmp_path / "b.json")["frames"]["registered"] == ["target", "frame"]


def test_a_urdf_of_another_run_is_named(call, folder: Path, tmp_path: Path):
    corrected = Urdf.read(folder / "corrected.urdf")
    T = corrected.joint("elbow_joint").T_parent_joint.copy()
    T[2, 3] += 1e-4
    other = corrected.with_origins({"elbow_joint": T}).with_comments(run="0a1b", verdict="")
    path = other.write(tmp_path / "other.urdf")
    done = call(folder, "evaluate", path, "data.csv", *RESULT, "--report", tmp_path / "e.html")
    run = load(folder / "result.json")["run"]
    printed = " ".join(done.out.split())
    assert f"other.urdf (run 0a1b) is not of the run of result.json (run {run}): " in printed
    assert "(see 'elbow_joint')" in printed
    page = (tmp_path / "e.html").read_text(encoding="utf-8")
    assert "other.urdf (run 0a1b) is not of the run of result.json" in page
    assert f"<td>{run}</td>" in page
    right = call(folder, "evaluate", "corrected.urdf", "data.csv", *RESULT)
    assert "is not of the run" not in " ".join(right.out.split())


def test_commands_are_not_taken_for_measurements(call, folder: Path, tmp_path: Path):
    """What a controller is sent is where the nominal robot predicts it to be: every tolerance would be kept."""
    header, *rows = table_of(folder / "data.csv")
    robot = Robot.load(folder / "robot.urdf", "base", "tool0")
    joints = [f"{name} [deg]" for name in robot.joint_names]
    values = [[row[header.index(label)] for label in joints] for row in rows[:8]]
    sent = 1e3 * (robot.poses(np.radians(np.array(values, float))) @ [0.01, 0.02, 0.15, 1.0])[:, :3]

    def evaluated(points: np.ndarray) -> Any:
        head = [*joints, "x [mm]", "y [mm]", "z [mm]", "correction position [mm]"]
        own = [[*q, *(f"{v:.6f}" for v in p), 3.2] for q, p in zip(values, points, strict=False)]
        table = write(tmp_path / "table.csv", [head, *own])
        return call(folder, "evaluate", "corrected.urdf", table, *RESULT, "--tolerance", "5 mm")

    turned = sent @ Rotation.from_rotvec([0.1, 0.2, 0.3]).as_matrix().T + [100.0, 200.0, 300.0]
    for points in (sent, turned):
        done = evaluated(points)
        assert (done.code, done.out) == (1, "")
        assert "these are commands that 'calib compensate' wrote" in done.err
    # What was measured there is what such a table is for.
    measured = sent + 0.1 * np.random.default_rng(1).normal(size=sent.shape)
    for count in (8, 1):
        assert evaluated(measured[:count]).err == ""
