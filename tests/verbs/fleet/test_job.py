"""One robot of a fleet: when its inputs are read, its fingerprint, and its files or the reason why there are none."""

from __future__ import annotations

import hashlib
import json
import pickle
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.data.cell import Cell, Tracker
from calib.errors import CalibError
from calib.robot.robot import Robot
from calib.robot.urdf import read_urdf
from calib.verbs.fleet.fleet_row import DONE, FAILED, WRITTEN
from calib.verbs.fleet.job import (
    FleetJob,
    FleetOptions,
    FleetRobot,
    calibrate_job,
    check_names,
    failed_row,
    fingerprint,
)
from tests.verbs.fleet.arms import CELL, arm, arms

QUICK = FleetOptions(validate=False, reports=False)


def job_of(folder: Path, ur3: Robot) -> FleetJob:
    """The job of one arm."""
    (robot,) = arms(folder, ur3, [0])
    return FleetJob(robot.name, *robot.load(read_urdf))


def test_a_job_returns_the_row_and_the_files(tmp_path, ur3):
    row, written = calibrate_job(QUICK, job_of(tmp_path, ur3))
    assert (row.name, row.status) == ("arm-0", DONE)
    assert row.urdf == WRITTEN
    assert set(written) == {"corrected.urdf", "result.json", "summary.txt"}
    for name, sha256 in (("corrected.urdf", row.urdf_sha256), ("result.json", row.result_sha256)):
        assert hashlib.sha256(written[name]).hexdigest() == sha256
    table = json.loads(written["result.json"])
    assert table["outputs"]["urdf"]["sha256"] == row.urdf_sha256
    assert table["noise"]["sigma"] == dict(row.sigma)


@pytest.mark.slow
def test_a_report_names_the_command_and_the_robot(tmp_path, ur3):
    options = replace(QUICK, reports=True, command="calib fleet m.csv")
    _, written = calibrate_job(options, job_of(tmp_path, ur3))
    page = written["report.html"].decode()
    text = " ".join(re.sub(r"<[^>]+>", "", page).split())
    assert "calib fleet m.csv # arm-0" in text


def test_an_error_becomes_a_failed_row(tmp_path, ur3):
    faulty = replace(QUICK, solver="no such solver")
    row, written = calibrate_job(faulty, job_of(tmp_path, ur3))
    assert row.status == FAILED
    assert "no such solver" in row.message
    assert not written


def test_faults_of_calib_are_called_so():
    assert failed_row("a", CalibError("no rows")).message == "no rows"
    message = failed_row("a", ZeroDivisionError("by zero")).message
    assert message.startswith("internal error: ZeroDivisionError: by zero.")


def test_the_fingerprint_has_all_that_the_files_depend_on(tmp_path, ur3):
    job = job_of(tmp_path, ur3)
    reference = job.fingerprint(QUICK)
    assert job.fingerprint(replace(QUICK, command="x", accept=True)) == reference
    others = [
        replace(job, name="arm-1").fingerprint(QUICK),
        replace(job, cell=replace(job.cell, frozen=("d3",))).fingerprint(QUICK),
        replace(job, measurements=replace(job.measurements, source="b.csv")).fingerprint(QUICK),
        *(job.fingerprint(options) for options in changed_options()),
    ]
    assert reference not in others
    assert len(set(others)) == len(others)


def changed_options() -> list[FleetOptions]:
    """Options that change every robot's files."""
    return [
        replace(QUICK, solver="scipy"),
        replace(QUICK, robust=False),
        replace(QUICK, validate=True),
        replace(QUICK, reports=True),
        replace(QUICK, target_link=True),
    ]


# Fingerprints


def test_a_robot_and_a_cell_by_their_values(ur3):
    cell = Cell(target=(0.0, 0.1, 0.2), tracker=Tracker((3.0, 0.0, 0.0)))
    reference = fingerprint(ur3, cell)
    assert reference == fingerprint(*pickle.loads(pickle.dumps((ur3, cell))))
    others = [
        (ur3.rebuilt(tip="wrist_3_link"), cell),
        (ur3, replace(cell, target=np.nextafter(cell.target, 1.0))),
        (ur3, replace(cell, frozen=("d3",))),
        (ur3, replace(cell, tracker=None)),
    ]
    assert len({reference, *(fingerprint(*other) for other in others)}) == 5


def test_arrays_by_shape_kind_and_every_bit():
    x = np.arange(6.0)
    kinds = [x, x.reshape(2, 3), x.astype(np.float32), -x, 3.0, Path("3.0"), "3.0"]
    assert len({fingerprint(kind) for kind in kinds}) == len(kinds)
    assert fingerprint(x[::2]) == fingerprint(x[::2].copy())


def test_values_without_a_fingerprint_are_refused():
    with pytest.raises(TypeError, match="object"):
        fingerprint(object())


# Inputs and names


def test_a_robot_of_files_is_read_by_load(tmp_path, ur3):
    (robot,) = arms(tmp_path, ur3, [0])
    sources = []

    def read(source: str):
        sources.append(source)
        return read_urdf(source)

    nominal, measurements, cell = robot.load(read)
    assert robot.name == "arm-0"
    assert sources == [str(tmp_path / "robot.urdf")]
    assert (nominal.base, nominal.tip) == ("base", "tool0")
    assert measurements.source == "arm-0.csv"
    assert measurements.joint_names == nominal.joint_names
    assert len(measurements) == 12
    assert cell is CELL


def test_files_are_not_read_before(tmp_path):
    robot = arm(tmp_path, "gone")
    with pytest.raises(CalibError, match=r"gone\.csv"):
        robot.load(read_urdf)


def test_columns_are_renamed(tmp_path, ur3):
    arms(tmp_path, ur3, [0])
    table = tmp_path / "arm-0.csv"
    joint = ur3.joint_names[0]
    table.write_text(table.read_text().replace(joint, "J1"))
    robot = FleetRobot.of_files(
        "arm-0", tmp_path / "robot.urdf", table, CELL, columns={"J1": joint}
    )
    nominal, measurements, _ = robot.load(read_urdf)
    assert measurements.joint_names == nominal.joint_names == ur3.joint_names


@pytest.mark.parametrize(
    "names",
    [("a", "a"), ("Arm 1", "arm 1"), ("straße", "STRASSE")],
)
def test_a_name_twice_is_refused_with_its_place(names):
    places = [(name, f"line {k}") for k, name in enumerate(names, 2)]
    with pytest.raises(CalibError, match=r"line 3: .* is no other robot's"):
        check_names(places)


@pytest.mark.parametrize("name", ["a", "SN-001", "7", "Ünit 3", "a.b+c_d", "x" * 100])
def test_names_that_are_folders_are_allowed(name):
    check_names([(name, "Robot 1")])


@pytest.mark.parametrize("name", ["", ".", "..", "a/b", ".hidden", "x.", "x" * 101, "~"])
def test_names_that_are_no_folders_are_refused(name):
    with pytest.raises(CalibError, match=r"Robot 1: .* cannot be the name"):
        check_names([(name, "Robot 1")])
