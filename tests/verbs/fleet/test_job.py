"""A job of a fleet: the files of one robot, or the reason why there are none."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

from calib.errors import CalibError
from calib.robot.robot import Robot
from calib.robot.urdf import read_urdf
from calib.verbs.fleet.job import FleetJob, FleetOptions, calibrate_job, failed_row
from calib.verbs.fleet.record import DONE, FAILED, WRITTEN
from tests.verbs.fleet.arms import arms

QUICK = FleetOptions(validate=False, reports=False)


def job_of(folder: Path, ur3: Robot) -> FleetJob:
    """The job of one arm."""
    (robot,) = arms(folder, ur3, [0])
    return FleetJob(robot.name, *robot.load(read_urdf))


def test_a_job_returns_the_row_and_the_files(tmp_path, ur3):
    result = calibrate_job(QUICK, job_of(tmp_path, ur3))
    assert (result.row.name, result.row.status) == ("arm-0", DONE)
    assert result.row.urdf == WRITTEN
    assert set(result.files) == {"corrected.urdf", "result.json", "summary.txt"}
    table = json.loads(result.files["result.json"])
    assert table["noise"]["sigma"] == dict(result.row.sigma)


@pytest.mark.slow
def test_a_report_names_the_command_and_the_robot(tmp_path, ur3):
    options = replace(QUICK, reports=True, command="calib fleet m.csv")
    result = calibrate_job(options, job_of(tmp_path, ur3))
    page = result.files["report.html"].decode()
    text = " ".join(re.sub(r"<[^>]+>", "", page).split())
    assert "calib fleet m.csv # arm-0" in text


def test_an_error_becomes_a_failed_row(tmp_path, ur3):
    faulty = replace(QUICK, solver="no such solver")
    result = calibrate_job(faulty, job_of(tmp_path, ur3))
    assert result.row.status == FAILED
    assert "no such solver" in result.row.message
    assert not result.files


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
