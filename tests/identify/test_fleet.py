"""A fleet: folders that are whole and the same everywhere, runs that go on, robots that fail alone."""

from __future__ import annotations

import json
import os
import random
import re
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from calib.errors import CalibError, FileError
from calib.identify import fleet_robot
from calib.identify.dask_executor import dask_executor
from calib.identify.fleet import FleetOptions, FleetRobot, fleet
from calib.identify.fleet_folder import kept_row, results_folder, write_folder
from calib.identify.fleet_rows import FleetRow
from calib.identify.fleet_tables import csv_bytes
from calib.identify.processes import process_executor
from calib.identify.result_file import read_result
from tests.cli.test_study import descendants, is_alive, until
from tests.identify.dask_cluster import scheduler
from tests.identify.fleet_arms import CELL, arms, files
from tests.identify.test_executors import Lossy

QUICK = FleetOptions(validate=False, reports=False)
MADE = {"corrected.urdf", "made.json", "result.json", "summary.txt"}


@pytest.fixture(scope="module")
def shop(tmp_path_factory, ur3):
    """A folder with six arms, and what a serial run makes of them."""
    folder = tmp_path_factory.mktemp("fleet")
    robots = arms(folder, ur3, range(6))
    fleet(robots, folder / "serial", QUICK)
    return folder


def robots_of(shop: Path, count: int = 6) -> list[FleetRobot]:
    """Its arms."""
    of = FleetRobot.of_files
    return [of(f"arm-{k}", shop / "robot.urdf", shop / f"arm-{k}.csv", CELL) for k in range(count)]


def test_each_robot_has_a_folder_and_the_fleet_its_tables(shop):
    there = files(shop / "serial")
    assert set(there) == {
        "fleet.csv",
        "fleet.json",
        *(f"arm-{k}/{name}" for k in range(6) for name in MADE),
    }
    result = json.loads(there["arm-2/result.json"])
    assert result["solver"]["seconds"] is None
    assert b" ms. " not in there["arm-2/summary.txt"]
    assert read_result(shop / "serial" / "arm-2" / "result.json").base == "base"
    table = json.loads(there["fleet.json"])
    assert [one["name"] for one in table["robots"]] == [f"arm-{k}" for k in range(6)]
    one = table["robots"][2]
    assert one["status"] == "done"
    assert one["nominal_rms_m"] == result["errors"]["nominal"]["estimation"]["rms_m"]
    assert one["calibrated_rms_m"] == result["errors"]["calibrated"]["estimation"]["rms_m"]
    assert one["sigma_m"] == result["noise"]["sigma_m"]
    assert one["unseen_rms_m"] is None
    deltas = {p["name"]: p["delta"] for p in result["parameters"]}
    assert all(
        p["change"] == deltas[p["name"]] for p in one["parameters"] if "target" not in p["name"]
    )
    assert (
        there["fleet.csv"]
        .decode()
        .splitlines()[0]
        .startswith("name,status,verdict,nominal rms [mm]")
    )


def test_the_same_bytes_in_processes_in_any_order_and_after_a_kill(shop, tmp_path):
    robots = robots_of(shop)
    random.Random(1).shuffle(robots)
    with process_executor(2) as executor:
        found = fleet(robots, tmp_path / "shuffled", QUICK, executor=executor)
        first = next(iter(executor._processes))
        fleet(
            robots, tmp_path / "killed", QUICK, executor=executor, progress=lambda *_: first.kill()
        )
    assert {row.name for row in found.rows} == {f"arm-{k}" for k in range(6)}
    serial = files(shop / "serial")
    for folder in ("shuffled", "killed"):
        there = files(tmp_path / folder)
        assert {k: v for k, v in there.items() if "/" in k} == {
            k: v for k, v in serial.items() if "/" in k
        }


def test_a_run_that_is_killed_goes_on_and_dask_does_too(shop, tmp_path):
    """kill -9 of the whole run, then of a Dask worker: the bytes are those of the serial run."""
    out = tmp_path / "out"
    program = (
        "import sys, time\n"
        "from pathlib import Path\n"
        "from calib.identify.fleet import fleet\n"
        "from calib.identify.processes import process_executor\n"
        "from tests.identify.test_fleet import QUICK, robots_of\n"
        "if __name__ == '__main__':\n"
        "    with process_executor(2) as executor:\n"
        "        fleet(robots_of(Path(sys.argv[1])), sys.argv[2], QUICK, executor=executor,\n"
        "              progress=lambda done, _: time.sleep(60.0 * (done == 3)))\n"
    )
    script = tmp_path / "script.py"
    script.write_text(program)
    path = os.pathsep.join(place or "." for place in sys.path)
    run = subprocess.Popen(
        [sys.executable, script, str(shop), str(out)], env={**os.environ, "PYTHONPATH": path}
    )
    try:
        until(lambda: len([*out.glob("arm-*")]) == 3)
        workers = descendants(run.pid)
    finally:
        run.kill()
        run.wait()
    until(lambda: not any(map(is_alive, workers)))
    assert not (out / "fleet.csv").exists()
    stale = out / ".calib-new-0123456789abcdef"
    stale.mkdir()

    with scheduler() as dask:
        first = dask.worker()
        dask.worker()
        with dask_executor(dask.address, timeout=60.0) as executor:
            until(lambda: executor._count() == 2)
            found = fleet(
                robots_of(shop), out, QUICK, executor=executor, progress=lambda done, _: done == 4 and first.kill()
            )  # fmt: skip
    assert found.kept == 3
    assert not stale.exists()
    assert files(out) == files(shop / "serial")


def test_only_what_has_changed_is_done_again(tmp_path, ur3):
    out, robots = tmp_path / "out", arms(tmp_path, ur3, range(3))
    assert fleet(robots, out, QUICK).kept == 0
    first = files(out)
    stamps = {path: path.stat().st_mtime_ns for path in out.rglob("result.json")}
    told = []
    assert fleet(robots, out, QUICK, progress=lambda *count: told.append(count)).kept == 3
    assert told == [(1, 3), (2, 3), (3, 3)]
    assert files(out) == first
    assert {path: path.stat().st_mtime_ns for path in out.rglob("result.json")} == stamps
    assert fleet(robots, out, QUICK, force=True).kept == 0
    assert files(out) == first
    # The command and the date of a report are no part of what it hangs on.
    assert fleet(robots, out, replace(QUICK, command="calib fleet", date="now")).kept == 3

    data = tmp_path / "arm-1.csv"
    data.write_bytes(data.read_bytes().replace(b"estimate", b"validate", 1))
    assert fleet(robots, out, QUICK).kept == 2
    assert fleet(robots, out, replace(QUICK, robust=False)).kept == 0
    assert fleet(robots, out, QUICK).kept == 0
    other = [replace(robots[0], name="arm-9"), *robots[1:]]
    found = fleet(other, out, QUICK)
    assert found.kept == 2
    assert found.notes[-1] == (
        f"{out} also holds the results of robots that are not in this fleet, and that are no part of what is said of "
        "it: arm-0."
    )
    for spoil in (
        lambda folder: (folder / "result.json").write_bytes(b"{}"),
        lambda folder: (folder / "summary.txt").unlink(),
    ):
        spoil(out / "arm-2")
        assert fleet(robots, out, QUICK).kept == 2
        assert files(out / "arm-2") == {
            k[6:]: v for k, v in first.items() if k.startswith("arm-2/")
        }


def test_a_row_that_cannot_be_read_is_made_again(tmp_path):
    folder = tmp_path / "arm"
    write_folder(folder, "told", FleetRow("arm", "done"), {"a": b"b"})
    assert kept_row(folder, ["told"]) is not None
    assert kept_row(folder, ["other"]) is None
    made = json.loads((folder / "made.json").read_bytes())
    del made["row"]["sigma"]
    made["row"]["colour"] = "red"
    (folder / "made.json").write_text(json.dumps(made))
    assert kept_row(folder, ["told"]) is None


def test_robots_that_fail_are_told_and_the_others_finished(shop, tmp_path, ur3):
    out, robots = tmp_path / "out", arms(tmp_path, ur3, range(2))
    fleet(robots, out, QUICK)
    before = files(out / "arm-0")
    (tmp_path / "arm-0.csv").write_text("what,is,this\n")

    def faulty(_):
        return 1 / 0

    robots += [
        FleetRobot.of_files("gone", tmp_path / "robot.urdf", tmp_path / "gone.csv", CELL),
        FleetRobot.of_files("few", tmp_path / "robot.urdf", tmp_path / "few.csv", CELL),
        FleetRobot("faulty", faulty),
    ]
    (tmp_path / "few.csv").write_text("\n".join((shop / "arm-1.csv").read_text().splitlines()[:1]))
    (out / "stranger").mkdir()
    robots.append(replace(robots[1], name="stranger"))
    found = fleet(robots, out, QUICK)
    messages = {row.name: row.message for row in found.failed}
    assert set(messages) == {"arm-0", "gone", "few", "faulty", "stranger"}
    assert "no column for the joints" in messages["arm-0"]
    assert "does not exist" in messages["gone"]
    assert messages["few"]
    assert messages["faulty"].startswith(
        "a fault of calib itself: ZeroDivisionError: division by zero"
    )
    assert messages["stranger"].startswith(
        f"{out / 'stranger'} exists already and was not made by 'calib fleet'"
    )
    assert found.kept == 1
    # What was finished stands, and the table says of what it is.
    assert files(out / "arm-0") == before
    assert [*(out / "stranger").iterdir()] == []
    lines = (out / "fleet.csv").read_text().splitlines()
    stale = "failed; the folder holds the result of earlier inputs"
    assert [line.split(",")[1] for line in lines[1:]] == [stale, "done", *["failed"] * 4]


def test_nothing_finished_is_lost_where_all_fail(tmp_path, ur3):
    out, robots = tmp_path / "out", arms(tmp_path, ur3, range(2))
    fleet(robots, out, QUICK)
    before = {k: v for k, v in files(out).items() if "/" in k}
    wrong = [replace(r, load=lambda _, r=r: r.load(lambda _: 1 / 0)) for r in robots]
    for path in (tmp_path / "arm-0.csv", tmp_path / "arm-1.csv"):
        path.rename(path.with_suffix(".away"))
    for these, force in ((robots, False), (wrong, True)):
        found = fleet(these, out, QUICK, force=force)
        assert len(found.failed) == 2
        assert {k: v for k, v in files(out).items() if "/" in k} == before
    for path in (tmp_path / "arm-0.away", tmp_path / "arm-1.away"):
        path.rename(path.with_suffix(".csv"))
    assert fleet(robots, out, QUICK).kept == 2


def test_files_of_other_origin_go_with_the_folder(tmp_path, ur3):
    out, robots = tmp_path / "out", arms(tmp_path, ur3, range(1))
    fleet(robots, out, QUICK)
    (out / "arm-0" / "notes.txt").write_text("mine")
    (out / "arm-0" / "photos").mkdir()
    (out / "arm-0" / "photos" / "1.png").write_bytes(b"1")
    fleet(robots, out, replace(QUICK, robust=False), force=True)
    assert {path.name for path in (out / "arm-0").iterdir()} == MADE | {"notes.txt", "photos"}
    assert (out / "arm-0" / "photos" / "1.png").read_bytes() == b"1"
    assert fleet(robots, out, replace(QUICK, robust=False)).kept == 1
    (out / "arm-0" / "report.html").write_text("mine")
    found = fleet(robots, out, replace(QUICK, reports=True))
    (row,) = found.failed
    assert row.message.startswith(f"{out / 'arm-0' / 'report.html'} is a file of other origin")
    assert (out / "arm-0" / "report.html").read_text() == "mine"


def write(folder: Path, told: str, *names: str) -> tuple[str, ...]:
    """A robot's folder with files of the same bytes."""
    return write_folder(
        folder, told, FleetRow(folder.name, "done"), dict.fromkeys(names, told.encode())
    )


def test_a_kill_between_two_renames_loses_nothing(tmp_path):
    arm, old = tmp_path / "arm", tmp_path / ".calib-old-0123456789abcdef"
    new = tmp_path / ".calib-new-0123456789abcdef"
    write(arm, "one", "a")
    (arm / "notes.txt").write_text("mine")
    # The old one has no name, and the new one has none yet.
    arm.rename(old)
    new.mkdir()
    with results_folder(tmp_path):
        assert files(arm)["a"] == b"one"
        assert (arm / "notes.txt").read_text() == "mine"
    # The new one has the name, and the old one still has what is not calib's.
    arm.rename(old)
    write(arm, "two", "a")
    with results_folder(tmp_path):
        assert set(files(arm)) == {"a", "made.json", "notes.txt"}
        assert files(arm)["a"] == b"two"
    assert {path.name for path in tmp_path.iterdir()} == {"arm", ".calib-fleet.lock"}
    # What is in the way stays where it is, and so does what says not whose it is.
    arm.rename(old)
    write(arm, "three", "a", "notes.txt")
    strange = tmp_path / ".calib-old-fedcba9876543210"
    strange.mkdir()
    with results_folder(tmp_path):
        assert (old / "notes.txt").read_text() == "mine"
    assert strange.is_dir()


def test_what_has_no_successor_is_told(tmp_path):
    write(tmp_path / "arm", "one", "a", "b")
    assert write(tmp_path / "arm", "two", "a") == ("b",)
    assert set(files(tmp_path / "arm")) == {"a", "made.json"}


def test_a_folder_that_has_more_than_is_asked_for_is_kept(shop, tmp_path):
    out, robots = tmp_path / "out", robots_of(shop, 1)
    all_of_it = replace(QUICK, reports=True, validate=True)
    fleet(robots, out, all_of_it)
    before = files(out / "arm-0")
    for less in (replace(all_of_it, reports=False), replace(all_of_it, validate=False), QUICK):
        assert fleet(robots, out, less).kept == 1
    assert files(out / "arm-0") == before
    found = fleet(robots, out, replace(QUICK, robust=False))
    assert found.kept == 0
    assert "Removed, for the new results have no such file: arm-0/report.html." in found.notes
    assert fleet(robots, out, replace(all_of_it, robust=False)).kept == 0
    assert "report.html" in files(out / "arm-0")


def test_a_robot_whose_process_ends_fails_alone(shop, tmp_path):
    with Lossy(1) as lossy:
        found = fleet(robots_of(shop, 2), tmp_path / "out", QUICK, executor=lossy)
    assert [row.message for row in found.failed] == ["why", "why"]


def test_a_fault_in_a_job_is_told_with_its_robot():
    assert fleet_robot.calibrate_one(QUICK, ("arm", None)).startswith(
        "a fault of calib itself: Attr"
    )


def test_what_stands_in_the_way_is_told(shop, tmp_path):
    robots = robots_of(shop, 1)
    with pytest.raises(CalibError, match="There are no robots to calibrate"):
        fleet([], tmp_path, QUICK)
    (tmp_path / "file").touch()
    with pytest.raises(FileError, match="this folder cannot be made"):
        fleet(robots, tmp_path / "file", QUICK)
    with (
        results_folder(tmp_path / "out"),
        pytest.raises(FileError, match="out is in use by another run of calib"),
    ):
        fleet(robots, tmp_path / "out", QUICK)
    for name, text in (("fleet.csv", "a,b\n"), ("fleet.json", "[]")):
        other = tmp_path / name.replace(".", "-")
        other.mkdir()
        (other / name).write_text(text)
        with pytest.raises(
            FileError, match=f"{name} exists already, and there is no fleet.json with"
        ):
            fleet(robots, other, QUICK)
        assert (other / name).read_text() == text
    folder = tmp_path / "proc"
    folder.symlink_to("/proc")
    with pytest.raises(
        FileError, match=r"proc: nothing can be written there: .*Choose another folder"
    ):
        fleet(robots, folder, QUICK)
    with pytest.raises(FileError, match="this folder cannot be written: "):
        write_folder(folder / "arm", "told", FleetRow("arm", "done"), {})


@pytest.mark.parametrize(
    "name",
    ["", ".", "..", "../x", "a/b", "a\\b", "/etc", ".hidden", " x", "x ", "x.", "a:b", "a\nb", "a\0", "CON", "nul.txt",
     "com1", "fleet.csv", "Fleet.JSON", "x" * 101, "ü" * 101, "-x", "~"],
)  # fmt: skip
def test_names_that_are_no_folders_are_refused(name, shop, tmp_path):
    robots = [replace(robots_of(shop, 1)[0], name=name)]
    with pytest.raises(CalibError, match=r"Robot 1: the name .* cannot be that of a folder"):
        fleet(robots, tmp_path / "out", QUICK)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("one", "two"), [("a", "a"), ("SN 1", "sn 1"), ("é", "É"), ("ß", "SS")])
def test_names_of_two_robots_are_refused(one, two, shop, tmp_path):
    robot = robots_of(shop, 1)[0]
    robots = [replace(robot, name=name) for name in ("ok", one, two)]
    with pytest.raises(
        CalibError, match=r"Robot 3: the name '.*' is that of another robot, '.*' \(Robot 2\)"
    ):
        fleet(robots, tmp_path / "out", QUICK)


def test_a_report_bears_the_date_and_the_command_that_were_given(shop, tmp_path):
    options = replace(QUICK, reports=True, command="calib fleet m.csv", date="a Tuesday")
    robots = robots_of(shop, 1)
    fleet(robots, tmp_path / "out", options)
    page = (tmp_path / "out" / "arm-0" / "report.html").read_text()
    assert page.count("a Tuesday") >= 3
    assert re.search(r"calib fleet m\.csv\s+#\s+arm-0", re.sub(r"<[^>]+>", "", page))
    assert fleet(robots, tmp_path / "out", replace(options, date="")).kept == 1


def test_urdfs_that_robots_share_are_read_once_and_the_last_are_kept(shop, tmp_path):
    read = fleet_robot.urdf_reader()
    first = read(str(shop / "robot.urdf"))
    assert read(str(shop / "robot.urdf")) is first
    for k in range(8):
        copy = tmp_path / f"{k}.urdf"
        copy.write_bytes((shop / "robot.urdf").read_bytes())
        read(str(copy))
    assert read(str(shop / "robot.urdf")) is not first


def test_a_table_says_nothing_where_there_is_nothing():
    row = FleetRow("a", "failed", "line one\nline two")
    line = csv_bytes([row], []).decode().splitlines()[1]
    assert line == "a,failed" + "," * 14 + "line one line two"


def test_ctrl_c_leaves_whole_folders_only(shop, tmp_path):
    def stop(done, _):
        if done == 2:
            os.kill(os.getpid(), signal.SIGINT)

    out = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt), process_executor(2) as executor:
        fleet(robots_of(shop), out, QUICK, executor=executor, progress=stop)
    assert all({path.name for path in folder.iterdir()} == MADE for folder in out.glob("arm-*"))
    assert not [*out.glob(".calib-new*")]
    assert fleet(robots_of(shop), out, QUICK).kept >= 2
    assert files(out) == files(shop / "serial")


def test_the_example_of_the_document_runs(shop, tmp_path):
    page = (Path(__file__).parents[2] / "docs" / "fleet.md").read_text(encoding="utf-8")
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
    lines = done.stdout.splitlines()
    assert [line.split()[0] for line in lines[:3]] == ["SN-1", "SN-2", "SN-3"]
    assert lines[3:] == [
        "SN-1 the same measurements as SN-3 (1.csv)",
        "SN-3 the same measurements as SN-1 (3.csv)",
    ]


def test_what_is_no_file_in_a_results_place_is_not_waited_for(tmp_path):
    folder = tmp_path / "arm"
    write_folder(folder, "told", FleetRow("arm", "done"), {"a": b"b"})
    (folder / "a").unlink()
    (folder / "a").symlink_to("/dev/zero")
    assert kept_row(folder, ["told"]) is None
    (folder / "made.json").unlink()
    os.mkfifo(folder / "made.json")
    assert kept_row(folder, ["told"]) is None
