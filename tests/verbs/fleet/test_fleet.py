"""A fleet: complete folders, interrupted runs continued, robots that fail alone, any executor, inputs of any form."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import pytest

import calib
from calib.errors import ArgumentError, CalibError, ModelError
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from calib.verbs.fleet.fleet import Fleet, run_fleet
from calib.verbs.fleet.fleet_row import ACCEPTED, DONE, FAILED, WITHHELD, WRITTEN
from calib.verbs.fleet.job import FleetOptions, FleetRobot
from calib.verbs.simulate.scenario import Scenario
from tests.places import ROOT
from tests.verbs.fleet.arms import CELL, arm, arms, files

QUICK = FleetOptions(validate=False, reports=False)
MADE = {"corrected.urdf", "made.json", "result.json", "summary.txt"}


@pytest.fixture(scope="module")
def shop(tmp_path_factory, ur3):
    """A folder with four arms, and the results of a serial run in its folder ``serial``."""
    folder = tmp_path_factory.mktemp("fleet")
    run_fleet(arms(folder, ur3, range(4)), folder / "serial", QUICK)
    return folder


def robots_of(shop: Path, count: int = 4) -> list[FleetRobot]:
    """Its first arms."""
    return [arm(shop, f"arm-{k}") for k in range(count)]


def numbers(folder: Path) -> dict[str, object]:
    """The errors of every result in a fleet's folder."""
    return {
        path.parent.name: json.loads(path.read_text())["errors"]
        for path in folder.rglob("result.json")
    }


def test_each_robot_has_a_folder_and_the_fleet_its_tables(shop):
    contents = files(shop / "serial")
    of_robots = {f"arm-{k}/{name}" for k in range(4) for name in MADE}
    assert set(contents) == {"fleet.csv", "fleet.json", *of_robots}
    result = json.loads(contents["arm-2/result.json"])
    table = json.loads(contents["fleet.json"])
    assert [robot["name"] for robot in table["robots"]] == [f"arm-{k}" for k in range(4)]
    robot = table["robots"][2]
    assert robot["status"] == DONE
    assert robot["nominal_rms"]["m"] == result["errors"]["nominal"]["estimation"]["m"]["rms"]
    assert robot["calibrated_rms"]["m"] == result["errors"]["calibrated"]["estimation"]["m"]["rms"]
    assert robot["sigma"] == result["noise"]["sigma"]
    assert robot["unseen_rms"] == {}
    deltas = {p["name"]: p["delta"] for p in result["parameters"]}
    geometry = [p for p in robot["parameters"] if "target" not in p["name"]]
    assert geometry
    assert all(p["change"] == deltas[p["name"]] for p in geometry)


@pytest.mark.slow
def test_processes_make_the_same(shop, tmp_path):
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as executor:
        calibrated = run_fleet(robots_of(shop), tmp_path / "out", QUICK, executor=executor)
    assert not calibrated.failed
    assert numbers(tmp_path / "out") == numbers(shop / "serial")


@pytest.mark.slow
def test_dask_makes_the_same(shop, tmp_path):
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(2, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
        client.get_executor() as executor,
    ):
        calibrated = run_fleet(robots_of(shop), tmp_path / "out", QUICK, executor=executor)
    assert not calibrated.failed
    assert numbers(tmp_path / "out") == numbers(shop / "serial")


def test_only_what_has_changed_is_done_again(tmp_path, ur3):
    out, robots = tmp_path / "out", arms(tmp_path, ur3, range(3))
    assert run_fleet(robots, out, QUICK).kept == 0
    stamps = {path: path.stat().st_mtime_ns for path in out.rglob("result.json")}
    counts = []
    assert run_fleet(robots, out, QUICK, progress=lambda *count: counts.append(count)).kept == 3
    assert counts == [(1, 3), (2, 3), (3, 3)]
    assert {path: path.stat().st_mtime_ns for path in out.rglob("result.json")} == stamps
    assert run_fleet(robots, out, QUICK, force=True).kept == 0
    assert run_fleet(robots, out, replace(QUICK, command="calib fleet")).kept == 3
    data = tmp_path / "arm-1.csv"
    data.write_bytes(data.read_bytes().replace(b"estimate", b"validate", 1))
    assert run_fleet(robots, out, QUICK).kept == 2
    (out / "arm-2" / "summary.txt").unlink()
    assert run_fleet(robots, out, QUICK).kept == 2
    assert run_fleet(robots, out, replace(QUICK, robust=False)).kept == 0


def test_robots_that_fail_are_named_and_the_others_finished(tmp_path, ur3):
    out, robots = tmp_path / "out", arms(tmp_path, ur3, range(3))
    run_fleet(robots[:2], out, QUICK)
    before = files(out / "arm-0")
    (tmp_path / "arm-0.csv").write_text("what,is,this\n")
    (out / "arm-2").mkdir()
    (out / "arm-2" / "result.json").write_text("somebody's")
    robots += [
        arm(tmp_path, "gone"),
        FleetRobot("faulty", lambda _: 1 / 0),
    ]
    calibrated = run_fleet(robots, out, QUICK)
    assert {row.name: row.status for row in calibrated.rows} == {
        "arm-0": FAILED,
        "arm-1": DONE,
        "arm-2": FAILED,
        "gone": FAILED,
        "faulty": FAILED,
    }
    messages = {row.name: row.message for row in calibrated.failed}
    assert all(row.nominal_rms == row.held_out_rms == row.sigma == {} for row in calibrated.failed)
    assert "gone.csv" in messages["gone"]
    assert "ZeroDivisionError" in messages["faulty"]
    assert calibrated.kept == 1
    assert files(out / "arm-0") == before
    assert (out / "arm-2" / "result.json").read_text() == "somebody's"


@pytest.mark.parametrize(
    "name",
    ["", ".", "..", "../x", "a/b", "a\\b", "/etc", ".hidden", " x", "x ", "x.", "a:b", "a\nb", "a\0",
     "x" * 101, "ü" * 101, "-x", "~"],
)  # fmt: skip
def test_names_that_are_no_folders_are_refused(name, shop, tmp_path):
    robots = [replace(robots_of(shop, 1)[0], name=name)]
    with pytest.raises(CalibError, match=r"Robot 1: .* cannot be the name of a robot's folder"):
        run_fleet(robots, tmp_path / "out", QUICK)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_the_example_of_the_document_runs(shop, tmp_path):
    page = (ROOT / "docs" / "fleet.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    script = tmp_path / "example.py"
    script.write_text(example, encoding="utf-8")
    (tmp_path / "robot.urdf").write_bytes((shop / "robot.urdf").read_bytes())
    for k in range(1, 4):
        (tmp_path / f"{k}.csv").write_bytes((shop / f"arm-{k % 2}.csv").read_bytes())
    done = subprocess.run(
        [sys.executable, script], cwd=tmp_path, capture_output=True, encoding="utf-8", timeout=60
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert [line.split()[0] for line in done.stdout.splitlines()] == [
        *("SN-1", "SN-2", "SN-3"),
        *("SN-1", "SN-3"),
    ]


# A verdict that is obeyed


@pytest.fixture
def right(tmp_path, ur3) -> list[FleetRobot]:
    """A robot with errors, and one that its URDF describes: there is nothing to gain, and it is not to be used."""
    wrong = arms(tmp_path, ur3, [0])
    no_errors = Scenario(ur3, cell=CELL, model="frames")
    poses = no_errors.random_poses(14, 0)
    no_errors.draw(0).measure(poses, 0).measurements.write(tmp_path / "right.csv")
    return [*wrong, arm(tmp_path, "right")]


JUDGED = FleetOptions(reports=False)


def test_a_robot_that_is_not_to_be_used_gets_no_urdf_unless_it_is_accepted(right, tmp_path):
    out = tmp_path / "out"
    calibrated = run_fleet(right, out, JUDGED)
    assert [row.urdf for row in calibrated.rows] == [WRITTEN, WITHHELD]
    for row in calibrated.rows:
        assert row.unseen == "cross-validation"
        assert row.unseen_rms == row.held_out_rms
        assert row.held_out_rms["m"] > 0.0
    assert [row.name for row in calibrated.withheld] == ["right"]
    assert not calibrated.failed
    assert set(files(out / "right")) == MADE - {"corrected.urdf"}
    assert set(files(out / "arm-0")) == MADE
    assert run_fleet(right, out, JUDGED).kept == 2
    # Only the robot that there is something to accept of is made again.
    accepted = run_fleet(right, out, replace(JUDGED, accept=True))
    assert accepted.kept == 1
    assert [row.urdf for row in accepted.rows] == [WRITTEN, ACCEPTED]
    assert Urdf.read(out / "right" / "corrected.urdf").verdict.startswith("do not use (")
    assert Urdf.read(out / "arm-0" / "corrected.urdf").verdict == ""
    assert run_fleet(right, out, replace(JUDGED, accept=True)).kept == 2
    # And without it the URDF is gone again.
    assert run_fleet(right, out, JUDGED).kept == 1
    assert set(files(out / "right")) == MADE - {"corrected.urdf"}


@pytest.mark.slow
def test_a_urdf_of_an_earlier_result_does_not_stay(right, tmp_path):
    out, data = tmp_path / "out", tmp_path / "right.csv"
    good = (tmp_path / "arm-0.csv").read_bytes()
    bad = data.read_bytes()
    data.write_bytes(good)
    run_fleet(right, out, replace(JUDGED, reports=True))
    (out / "right" / "notes.txt").write_text("somebody's own")
    assert set(files(out / "right")) == {*MADE, "report.html", "notes.txt"}
    data.write_bytes(bad)
    run_fleet(right, out, JUDGED)
    assert set(files(out / "right")) == {*MADE - {"corrected.urdf"}, "notes.txt"}


def test_a_list_of_files_that_was_changed_removes_nothing_elsewhere(right, tmp_path):
    out = tmp_path / "out"
    run_fleet(right[1:], out, replace(JUDGED, accept=True))
    made = out / "right" / "made.json"
    table = json.loads(made.read_text())
    (tmp_path / "precious.txt").write_text("keep me")
    table["files"] += ["../../precious.txt", str(tmp_path / "precious.txt"), "made.json", 3]
    made.write_text(json.dumps(table))
    run_fleet(right[1:], out, JUDGED)
    assert (tmp_path / "precious.txt").read_text() == "keep me"
    assert set(files(out / "right")) == MADE - {"corrected.urdf"}


def test_somebody_s_urdf_is_not_left_beside_a_result_that_has_none(right, tmp_path):
    folder = tmp_path / "out" / "right"
    folder.mkdir(parents=True)
    (folder / "corrected.urdf").write_text("somebody's")
    calibrated = run_fleet(right[1:], tmp_path / "out", JUDGED)
    assert "corrected.urdf exists already" in calibrated.failed[0].message
    assert set(files(folder)) == {"corrected.urdf"}


# Robots, tables and cells as users have them

NAMES = ("arm-0", "arm-1")
AS_QUICK = {"validate": False, "reports": False}


@pytest.fixture(scope="module")
def tables(shop: Path) -> dict[str, Path]:
    return {name: shop / f"{name}.csv" for name in NAMES}


@pytest.fixture(scope="module")
def fleet(shop: Path, tables) -> Fleet:
    return calib.fleet(shop / "robot.urdf", tables, shop / "results", cell=CELL, **AS_QUICK)


def test_one_robot_for_all_tables(shop: Path, fleet: Fleet):
    assert [(row.name, row.status) for row in fleet.rows] == [(name, DONE) for name in NAMES]
    assert all((shop / "results" / name / "corrected.urdf").exists() for name in NAMES)


@pytest.mark.parametrize("form", ["robot", "sequence", "mapping"])
@pytest.mark.usefixtures("fleet")
def test_values_and_one_robot_for_each_table_make_the_same_fleet(shop, tables, tmp_path, form):
    path = str(shop / "robot.urdf")
    robot = Robot.load(path, "base", "tool0")
    robots = {"robot": robot, "sequence": [path, robot], "mapping": {"arm-1": path, "arm-0": robot}}
    read = {
        name: calib.Measurements.read(table, robot.joint_names) for name, table in tables.items()
    }
    cells = dict.fromkeys(NAMES, CELL)
    calib.fleet(robots[form], read, tmp_path, cell=cells, **AS_QUICK)
    made, expected = files(tmp_path), files(shop / "results")
    assert made["arm-0/corrected.urdf"] == expected["arm-0/corrected.urdf"]
    assert made["arm-1/corrected.urdf"] == expected["arm-1/corrected.urdf"]


@pytest.mark.usefixtures("fleet")
def test_a_second_run_keeps_what_is_finished(shop: Path, tables):
    again = calib.fleet(shop / "robot.urdf", tables, shop / "results", cell=CELL, **AS_QUICK)
    assert again.kept == 2


def test_a_robot_that_cannot_be_read_fails_alone(shop: Path, tables, tmp_path: Path):
    robots = {"arm-0": "no such robot", "arm-1": shop / "robot.urdf"}
    made = calib.fleet(robots, tables, tmp_path, cell=CELL, **AS_QUICK)
    assert [row.status for row in made.rows] == [FAILED, DONE]


@pytest.mark.parametrize(
    ("changes", "error", "words"),
    [
        ({"robots": 3}, ArgumentError, "'robots'"),
        ({"robots": [3, 4]}, ArgumentError, "robots"),
        ({"solver": "nix"}, ModelError, "'nix'"),
        ({"robots": ["ur3"]}, CalibError, r"robots \(1\) and of tables \(2\)"),
        ({"robots": {"arm-0": "ur3"}}, CalibError, "lacks 'arm-1'"),
        ({"robots": {"arm-0": "ur3", "arm-1": "ur3", "x": "ur3"}}, CalibError, "has 'x'"),
        ({"tables": ["a.csv"]}, ArgumentError, "'tables'"),
        ({"tables": {"a": 3}}, ArgumentError, "tables"),
        ({"folder": 3}, ArgumentError, "'folder'"),
        ({"cell": 3}, ArgumentError, "'cell'"),
        ({"cell": {"arm-0": CELL}}, CalibError, "lacks 'arm-1'"),
        ({"report": True}, ArgumentError, "did you mean 'reports'"),
        ({"reports": "no"}, ArgumentError, "'reports'"),
    ],
)
def test_wrong_arguments_are_named(tables, tmp_path: Path, changes, error, words):
    given = {"robots": "ur3", "tables": tables, "folder": tmp_path / "new", **changes}
    with pytest.raises(error, match=words):
        calib.fleet(**given)
    assert not (tmp_path / "new").exists()


def test_a_fleet_in_one_line(fleet: Fleet):
    assert repr(fleet) == "Fleet(2 robots, 0 failed, 0 withheld, 0 outliers, 0 kept)"
