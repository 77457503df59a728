"""Sessions: what they keep, what they refuse, and what survives whatever ends the program."""

from __future__ import annotations

import json
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import calib
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.data.surroundings import Box, Tracker
from calib.errors import ArgumentError, CalibError, FileError, MeasurementError
from calib.robot.robot import Robot
from calib.verbs.measure.aim import Aim
from calib.verbs.measure.session import Session
from calib.verbs.measure.settings import JOURNAL, SETTINGS, TABLE
from calib.verbs.measure.stop import Row
from calib.verbs.simulate.operator import GROSS, REPEATED, TARGET_MOVED, Mistakes, Operator
from calib.verbs.simulate.scenario import Scenario
from calib.verbs.simulate.virtual_session import known_cell
from tests.verbs.measure.sessions import (
    ANGLE,
    LENGTH,
    good_readings,
    measured,
    points_cell,
    readings_at,
    shown,
    started,
    virtual_cell,
    with_rows,
)

STOPS = 14


@pytest.fixture(scope="module")
def virtual(ur3):
    return virtual_cell(ur3, points_cell())


@pytest.fixture(scope="module")
def kept(virtual, tmp_path_factory) -> Path:
    """The folder of a session of fourteen stops, one gross and one repeated, and a note."""
    folder = tmp_path_factory.mktemp("kept") / "s"
    operator = Operator.of(virtual, 1, Mistakes(at={10: GROSS, 12: REPEATED}))
    with started(virtual, folder) as session:
        measured(session, operator, STOPS)
        session.note("the door was open")
    return folder


@pytest.fixture
def folder(kept: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    shutil.copytree(kept, tmp_path / "s")
    return tmp_path / "s"


@pytest.fixture(scope="module")
def fresh(virtual, tmp_path_factory) -> Path:
    """The folder of a session without stops."""
    folder = tmp_path_factory.mktemp("fresh") / "s"
    started(virtual, folder).close()
    return folder


@pytest.fixture
def empty(fresh: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    shutil.copytree(fresh, tmp_path / "s")
    return tmp_path / "s"


def reading(virtual, session: Session, seed: int = 9) -> Row:
    """A good reading where the session proposes one."""
    pose = session.next()
    assert pose is not None
    return Row(pose.joints, readings_at(virtual, [pose.joints], seed)[0])


def lines(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / JOURNAL).read_text().splitlines()]


def table_of(path: Path, robot: Robot) -> Measurements:
    """The table of a session's folder."""
    return Measurements.read(path, robot.joint_names, robot.joint_types)


def in_step(session: Session) -> bool:
    """Whether the table in the folder has the stops that count."""
    path = session.folder / TABLE
    if not [stop for stop in session.stops if stop.counts]:
        return not path.exists()
    table, known = table_of(path, session.robot), session.measurements
    return bool(
        len(table) == len(known)
        and np.allclose(table.points, known.points, atol=1e-9)
        and np.allclose(table.joints, known.joints, atol=1e-9)
    )


# Opened again


def test_it_goes_on_as_if_it_had_not_been_closed(virtual, tmp_path):
    operator = Operator.of(virtual, 1, Mistakes(at={8: GROSS}))
    session = started(virtual, tmp_path / "s")
    measured(session, operator, 9)
    session.skip("in the way of the cable")
    measured(session, operator, 1)
    session.next()
    before = shown(session)
    session.close()
    with Session.open(tmp_path / "s") as session:
        assert shown(session) == before
        assert in_step(session)
        assert session.notes == ("in the way of the cable",)
        row = reading(virtual, session)
        session.add(row)
        after = shown(session)
        session.undo()
        assert shown(session) == before
        session.add(row)
        assert shown(session) == after
    with Session.open(tmp_path / "s") as session:
        assert shown(session) == after
        session.undo()
        assert shown(session) == before


def test_a_row_without_an_answer_is_judged_when_it_is_opened(folder):
    with Session.open(folder) as session:
        expected = shown(session)
    whole = (folder / JOURNAL).read_bytes().splitlines(keepends=True)
    answers = [k for k, line in enumerate(whole) if b'"event": "answer"' in line]
    for left_out in ([answers[-1]], answers[8:], answers):
        rest = [line for k, line in enumerate(whole) if k not in left_out]
        (folder / JOURNAL).write_bytes(b"".join(rest))
        (folder / TABLE).unlink(missing_ok=True)
        with Session.open(folder) as session:
            assert shown(session) == expected
            assert in_step(session)


def test_a_torn_line_is_dropped_and_told(folder, virtual):
    with Session.open(folder) as session:
        expected = shown(session)
    with (folder / JOURNAL).open("ab") as file:
        file.write(b'{"event": "row", "columns": {"x [mm')
    with Session.open(folder) as session:
        assert session.torn == '{"event": "row", "columns": {"x [mm'
        assert shown(session) == expected
        session.add(reading(virtual, session))
    with Session.open(folder) as session:
        assert session.torn == ""
        assert len(session.stops) == STOPS + 1


def test_all_that_happened_is_in_the_journal(kept):
    events = [event["event"] for event in lines(kept)]
    assert events.count("row") == events.count("answer") == STOPS
    assert events[-1] == "note"
    with Session.open(kept) as session:
        assert session.notes == ("the door was open",)
        assert [event["event"] for event in session.events] == events


def test_mistakes_do_not_count_and_are_named(kept):
    with Session.open(kept) as session:
        stops = session.stops
        assert [stop.number for stop in stops] == [*range(1, STOPS + 1)]
        off = [stop.number for stop in stops if not stop.counts]
        assert off == [10, 12] or off == [10, 13]
        codes = [f.code for stop in stops for f in stop.answer.findings]
        assert codes == [GROSS, REPEATED]
        state = session.state
        assert (state.stops, state.measured) == (STOPS - 2, STOPS)
        assert len(session.measurements) == STOPS - 2


def test_the_table_and_the_cell_give_the_calibration_of_the_session(kept):
    with Session.open(kept) as session:
        result = session.calibrate()
        cell = session.cell
        robot = session.robot
        other = calib.calibrate(robot, table_of(kept / TABLE, robot), cell=cell)
    found = [(parameter.name, parameter.value) for parameter in result.parameters]
    assert [name for name, _ in found] == [parameter.name for parameter in other.parameters]
    assert len(found) >= 6
    values = [parameter.value for parameter in other.parameters]
    # The table has as many digits as count.
    assert values == pytest.approx([value for _, value in found], rel=1e-6, abs=1e-9)


# What is added


def test_a_row_with_a_key_is_added_once(empty, virtual):
    with Session.open(empty) as session:
        row = reading(virtual, session)
        answer = session.add(row, key="a")
        assert session.add(row, key="a") is answer
        assert session.add(reading(virtual, session), key="a") is answer
        assert len(session.stops) == 1
    with Session.open(empty) as session:
        again = session.add(row, key="a")
        assert (again.stop, again.outcome) == (answer.stop, answer.outcome)
        assert len(session.stops) == 1
        # One that was taken back may be added again.
        assert session.undo() == 1
        session.add(row, key="a")
        assert len(session.stops) == 1
    assert [event["event"] for event in lines(empty)] == ["row", "answer", "undo", "row", "answer"]


def test_columns_have_units_and_the_proposed_pose_if_none_is_given(empty):
    with Session.open(empty) as session:
        pose = session.next()
        assert pose is not None
        answer = session.add({"x [mm]": 812.3, "y [mm]": -20.0, "z [in]": 10.0})
        stop = session.stops[0]
        assert answer.stop == 1
        assert stop.row.joints == pytest.approx(pose.joints, abs=1e-12)
        assert stop.row.readings.points[0] == pytest.approx([0.8123, -0.02, 0.254])


def test_columns_may_have_the_joint_values(empty):
    with Session.open(empty) as session:
        names = session.robot.joint_names
        columns: dict[str, Any] = {f"{name} [deg]": 10.0 * k for k, name in enumerate(names)}
        session.add({**columns, "x [m]": 0.1, "y [m]": 0.2, "z [m]": 0.3})
        q = session.stops[0].row.joints
        assert q == pytest.approx(np.deg2rad(10.0) * np.arange(6))
        backwards = dict(reversed(columns.items()))
        session.add({"x [m]": 0.2, "y [m]": 0.2, "z [m]": 0.3, **backwards})
        assert session.stops[1].row.joints == pytest.approx(q)


@pytest.mark.parametrize(
    "columns",
    [
        {"x [mm]": 1.0, "y [mm]": 2.0},
        {"x": 1.0, "y": 2.0, "z": 3.0},
        {"x [mm]": "far", "y [mm]": 2.0, "z [mm]": 3.0},
        {"d [mm]": 1.0},
        {},
        {"x [mm]": [], "y [mm]": [], "z [mm]": []},
        {"x [mm]": float("nan"), "y [mm]": 2.0, "z [mm]": 3.0},
        {"x [mm]": [1.0, 2.0], "y [mm]": [1.0], "z [mm]": [1.0, 2.0]},
        {"shoulder_pan_joint [deg]": 1.0, "x [mm]": 1.0, "y [mm]": 2.0, "z [mm]": 3.0},
        {"rx [deg]": 1.0, "ry [deg]": 1.0, "rz [deg]": 1.0, "x [mm]": 1, "y [mm]": 2, "z [mm]": 3},
    ],
)
def test_what_is_no_reading_of_the_session_is_refused_and_not_kept(empty, columns):
    before = (empty / JOURNAL).read_bytes()
    with Session.open(empty) as session:
        view = shown(session)
        with pytest.raises(CalibError):
            session.add(columns)
        assert shown(session) == view
        assert session.stops == ()
    assert (empty / JOURNAL).read_bytes() == before


@pytest.mark.parametrize(
    "given", [[1, 2, 3], (1.0, 2.0, 3.0), "812 13 14", np.ones(3), None, {1: 2}, {"x": 1, 2: 3}]
)
def test_other_types_are_refused_and_the_columns_named(empty, given):
    with Session.open(empty) as session:
        with pytest.raises(ArgumentError, match=r"'x \[mm\]', 'y \[mm\]', 'z \[mm\]'"):
            session.add(given)
        assert session.stops == ()


@pytest.mark.parametrize(
    ("unit", "value"), [("", 812.0), (" [kg]", 812.0), (" [mm]", 1.3), (" [m]", 812.0)]
)
def test_a_wrong_unit_is_refused_without_options_of_the_command_line(empty, unit, value):
    row = {f"{axis}{unit}": value for axis in "xyz"}
    with Session.open(empty) as session, pytest.raises(MeasurementError) as raised:
        session.add(row)
    assert "'x [m" in str(raised.value)
    assert "--" not in str(raised.value)
    assert "header" not in str(raised.value)


def test_readings_of_several_poses_are_refused(empty, virtual):
    tables = readings_at(virtual, virtual.poses(2, 1))
    with Session.open(empty) as session, pytest.raises(MeasurementError):
        session.add(Row(tables[0].joints[0], Measurements.joined(tables)))


def test_several_targets_are_a_stop(ur3, tmp_path):
    places = {"a": [0.0, 0.0, 0.1], "b": [0.05, 0.0, 0.08]}
    virtual = virtual_cell(ur3, points_cell(targets=places, estimate_target=True))
    with started(virtual, tmp_path / "s") as session:
        pose = session.next()
        assert pose is not None
        assert pose.targets == ("a", "b")
        assert pose.expected.shape == (2, 3)
        columns = {
            "target": ["a", "b"],
            "x [mm]": [100.0, 150.0],
            "y [mm]": [0.0, 1.0],
            "z [mm]": [10.0, 20.0],
        }
        session.add(columns)
        assert session.stops[0].row.readings.targets == ("a", "b")
        with pytest.raises(MeasurementError, match="'c'"):
            session.add({**columns, "target": ["a", "c"]})
        measured(session, Operator.of(virtual, 1), 1)
        session.undo()
        session.undo()
        measured(session, Operator.of(virtual, 1), 9)
        assert len(session.measurements) == 18
        before = shown(session)
    with Session.open(tmp_path / "s") as session:
        assert shown(session) == before
        assert in_step(session)


def test_joint_values_that_the_robot_reports_are_kept(empty, virtual):
    with Session.open(empty) as session:
        pose = session.next()
        assert pose is not None
        stands = pose.joints + 2e-4
        session.add(Row(stands, readings_at(virtual, [stands])[0]))
        assert (session.stops[0].row.joints == session.stops[0].row.readings.joints[0]).all()
        assert session.stops[0].row.joints == pytest.approx(stands, abs=1e-12)
        following = session.next()
        assert following is not None
        assert following.travel == pytest.approx(np.abs(following.joints - stands).max(), abs=1e-9)


# Undo, skip


def test_undo_of_nothing_is_none(empty):
    with Session.open(empty) as session:
        assert session.undo() is None
        assert lines(empty) == []


def test_all_can_be_taken_back(folder, virtual):
    with Session.open(folder) as session:
        for number in range(STOPS, 0, -1):
            assert session.undo() == number
        assert session.stops == ()
        assert session.state.error is None
        assert not (folder / TABLE).exists()
        with pytest.raises(MeasurementError):
            session.measurements  # noqa: B018
        fresh = shown(session)
    with started(virtual, folder.parent / "other") as session:
        assert shown(session) == fresh


def test_a_skipped_pose_does_not_come_again(empty):
    with Session.open(empty) as session:
        proposed = []
        for _ in range(4):
            pose = session.next()
            assert pose is not None
            proposed.append(tuple(pose.joints.tolist()))
            session.skip()
        assert len({*proposed}) == 4
        pose = session.next()
        assert pose is not None
        last = shown(session)
    with Session.open(empty) as session:
        assert shown(session) == last


def test_a_pose_that_is_to_be_measured_again_is_skipped(folder, virtual):
    with Session.open(folder) as session:
        row = reading(virtual, session)
        off = replace(row.readings, points=row.readings.points + 5e-3)
        assert session.add(replace(row, readings=off)).outcome == "again"
        again = session.next()
        assert again is not None
        assert (again.why, again.stop) == ("again", STOPS + 1)
        assert again.joints == pytest.approx(row.joints)
        session.skip()
        other = session.next()
        assert other is not None
        assert other.why == "information"
        last = shown(session)
    with Session.open(folder) as session:
        assert shown(session) == last


def test_the_pose_is_the_same_until_something_happens(empty):
    with Session.open(empty) as session:
        first = session.next()
        session.note("a note")
        assert session.next() is first
        assert session.state.measured == 0


def test_the_first_pose_is_near_where_the_robot_starts(virtual, tmp_path):
    q = virtual.poses(1, 8)[0]
    with started(virtual, tmp_path / "s", start=tuple(q.tolist())) as session:
        pose = session.next()
        assert pose is not None
        assert pose.travel == pytest.approx(np.abs(pose.joints - q).max())


# Folders


def test_one_at_a_time_has_a_folder(folder):
    with Session.open(folder):
        with pytest.raises(FileError) as raised:
            Session.open(folder)
        assert "\n" not in str(raised.value)
        code = "import sys, calib\ncalib.Session.open(sys.argv[1])"
        other = subprocess.run([sys.executable, "-c", code, folder], capture_output=True, text=True)
        assert other.returncode == 1
        assert "FileError" in other.stderr.splitlines()[-1]
    Session.open(folder).close()


def test_a_folder_with_a_session_or_a_table_is_refused(folder, virtual, tmp_path):
    with pytest.raises(FileError, match=r"calib\.Session\.open"):
        started(virtual, folder)
    (tmp_path / "t").mkdir()
    (tmp_path / "t" / TABLE).write_text("x")
    with pytest.raises(FileError):
        started(virtual, tmp_path / "t")
    assert [path.name for path in (tmp_path / "t").iterdir()] == [TABLE]
    with pytest.raises(FileError):
        Session.open(tmp_path / "nowhere")


def test_a_session_that_cannot_be_started_leaves_no_journal(virtual, tmp_path):
    (tmp_path / "s").mkdir()
    (tmp_path / "s" / SETTINGS).write_text("{}")
    with pytest.raises(FileError):
        started(virtual, tmp_path / "s")
    assert sorted(path.name for path in (tmp_path / "s").iterdir() if path.suffix != ".lock") == [
        SETTINGS
    ]


def test_a_closed_session_takes_no_more_rows(empty, virtual):
    session = Session.open(empty)
    row = reading(virtual, session)
    session.close()
    with pytest.raises(FileError):
        session.add(row)
    assert session.stops == ()


def test_a_full_disk_changes_nothing_and_it_goes_on_when_there_is_room(folder, virtual):
    with Session.open(folder) as session:
        before, row = shown(session), reading(virtual, session)
        size = (folder / JOURNAL).stat().st_size
        soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size + 10, hard))
        try:
            with pytest.raises(FileError):
                session.add(row, key="k")
            with pytest.raises(FileError):
                session.skip()
            with pytest.raises(FileError):
                session.undo()
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        assert shown(session) == before
        session.add(row, key="k")
        assert len(session.stops) == STOPS + 1
        after = shown(session)
    with Session.open(folder) as session:
        assert shown(session) == after


def test_a_row_that_is_kept_is_added_though_its_answer_does_not_fit_on_the_disk(folder, virtual):
    with Session.open(folder) as session:
        row = reading(virtual, session)
        session.add(row)
        whole = shown(session)
        of_row = len((folder / JOURNAL).read_bytes().splitlines(keepends=True)[-2])
        session.undo()
        size = (folder / JOURNAL).stat().st_size
        soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size + of_row + 50, hard))
        try:
            answer = session.add(row, key="k")
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        assert answer.stop == STOPS + 1
        assert lines(folder)[-1]["event"] == "row"
        assert shown(session) == whole
        second = reading(virtual, session, 11)
        session.add(second)
        after = shown(session)
        assert session.behind == ""
    with Session.open(folder) as session:
        assert shown(session) == after
        assert session.add(row, key="k").stop == STOPS + 1
        assert len(session.stops) == STOPS + 2


def test_a_table_that_cannot_be_written_is_told_and_written_later(empty, virtual):
    with Session.open(empty) as session:
        (empty / TABLE).mkdir()
        answer = session.add(reading(virtual, session))
        assert answer.stop == 1
        assert session.behind
        (empty / TABLE).rmdir()
        session.add(reading(virtual, session))
        assert session.behind == ""
        assert in_step(session)


#: Goes on with a session for ever; prints the number of each row when it is acknowledged.
GOES_ON = """
import sys
import calib
from calib.verbs.measure.stop import Row
from tests.verbs.measure.sessions import points_cell, readings_at, virtual_cell
with calib.Session.open(sys.argv[1]) as session:
    virtual = virtual_cell(session.robot, points_cell())
    print("open", flush=True)
    while True:
        number = len(session.stops) + 1
        q = session.next().joints
        session.add(Row(q, readings_at(virtual, [q], number)[0]), key=str(number))
        print(number, flush=True)
"""


@pytest.mark.slow
def test_nothing_is_lost_or_doubled_when_the_process_is_killed(virtual, tmp_path):
    folder = tmp_path / "s"
    started(virtual, folder, Aim(error=1e-5)).close()
    moments = random.Random(1)
    known = 0
    for moment in range(50):
        process = subprocess.Popen(
            [sys.executable, "-c", GOES_ON, folder], stdout=subprocess.PIPE, cwd=Path.cwd()
        )
        assert process.stdout is not None
        assert process.stdout.readline() == b"open\n"
        time.sleep(moments.uniform(0.0, 0.8))
        process.send_signal(signal.SIGKILL)
        output, _ = process.communicate()
        acknowledged = [int(line) for line in output.split(b"\n")[:-1]]
        known = max([known, *acknowledged])
        if moment % 5 and moment < 45:
            continue
        with Session.open(folder) as session:
            numbers = [stop.number for stop in session.stops]
            # One row more may be on the disk.
            assert numbers == [*range(1, len(numbers) + 1)]
            assert known <= len(numbers) <= known + 5
            assert in_step(session)
            first = shown(session)
            if numbers:  # the last one once more
                session.add(session.stops[-1].row, key=str(numbers[-1]))
                assert len(session.stops) == len(numbers)
        keys = [event["key"] for event in lines(folder) if event["event"] == "row"]
        assert len(keys) == len({*keys}) == len(numbers)
        with Session.open(folder) as session:
            assert shown(session) == first
    assert known > 10


# Robots and cells of many sorts


def usual(robot: Robot, cell: Cell, folder: Path, count: int, aim: Aim, seed: int = 3, **options):
    """A session of so many stops, opened again: its state and the answers."""
    virtual = Scenario(robot, cell, cell.model if cell.model != "auto" else "placement").draw(seed)
    known = known_cell(virtual, 1)
    given: dict[str, Any] = {"collisions": False, "seed": 1, **options}
    with Session.start(folder, robot, known, aim, **given) as session:
        answers = measured(session, Operator.of(virtual, seed), count)
        before = shown(session)
    with Session.open(folder) as session:
        assert shown(session) == before
        assert in_step(session)
        return session, session.state, answers


@pytest.mark.slow
def test_seven_joints(panda, tmp_path):
    _, state, answers = usual(
        panda, points_cell("placement"), tmp_path / "s", 24, Aim(error=1.2e-4)
    )
    assert [answer.outcome for answer in answers].count("again") <= 1
    assert state.high is not None
    assert state.high < 2e-4


@pytest.mark.slow
def test_poses(ur3, tmp_path):
    cell = replace(points_cell("placement", kind="pose"), sigma={"m": LENGTH, "rad": ANGLE})
    _, state, answers = usual(ur3, cell, tmp_path / "s", 16, Aim(error=1e-4))
    assert [answer.outcome for answer in answers].count("again") <= 1
    assert state.reached
    assert set(state.sigma) == {"m", "rad"}


@pytest.mark.slow
@pytest.mark.parametrize(("base", "tip"), [("base_link", "tool0"), ("tool0", "base_link")])
def test_pictures_of_a_camera_beside_the_robot_and_on_its_hand(tmp_path, base, tip):
    arm = Robot.load("ur5", base=base, tip=tip)
    cell = Cell(kind="pixel", model="zeros", sigma={"px": 0.3})
    virtual = Scenario(arm, cell, "zeros").draw(7)
    operator = Operator.of(virtual, 1)
    with started(virtual, tmp_path / "s", Aim(error=2e-3)) as session:
        while len(session.stops) < 9:
            pose = session.next()
            assert pose is not None
            try:
                got = operator.measure(pose.joints, again=pose.why == "again")
            except CalibError:
                session.skip()
                continue
            answer = session.add(Row(got.joints, got.readings))
            assert answer.outcome != "again"
        before = shown(session)
        assert set(session.state.sigma) == {"px"}
        assert session.stops[-1].answer.numbers == 6
        images = {image for table in [session.measurements] for image in table.images}
        assert len(images) == 9
    with Session.open(tmp_path / "s") as session:
        assert shown(session) == before
        session.undo()
        assert len(session.stops) == 8


def test_an_aim_of_random_poses_and_a_region(virtual, tmp_path):
    with started(virtual, tmp_path / "a", Aim(poses=20)) as session:
        whole = session.state.aim
    with started(virtual, tmp_path / "b", Aim(poses=80)) as session:
        assert session.state.aim < whole
    region = calib.Region.box([0.1, 0.1, 0.1], [0.3, 0.3, 0.3])
    with started(virtual, tmp_path / "c", Aim(poses=20, region=region)) as session:
        assert session.state.aim != whole
        first = session.next()
    with Session.open(tmp_path / "c") as session:
        again = session.next()
        assert first is not None
        assert again is not None
        assert (first.joints == again.joints).all()


@pytest.mark.slow
def test_a_model_with_lost_motion_is_approached_from_both_sides(ur3, tmp_path):
    cell = points_cell("zeros+lost_motion")
    session, state, answers = usual(ur3, cell, tmp_path / "s", 20, Aim(error=1.5e-4))
    virtual = Scenario(ur3, cell, "zeros+lost_motion").draw(3)
    with started(virtual, tmp_path / "t") as other:
        pose = other.next()
        assert pose is not None
        assert pose.via is not None
        other.skip()
        following = other.next()
        assert following is not None
        assert np.abs(following.joints - pose.joints).max() > 1e-3
    sides = {tuple(np.sign(stop.row.moves)) for stop in session.stops if stop.row.moves is not None}
    assert len(sides) == 2
    assert all(stop.row.moves is not None for stop in session.stops)
    assert [answer.outcome for answer in answers].count("again") <= 1
    assert state.error is not None


@pytest.mark.slow
def test_a_cell_with_a_tracker_and_boxes(ur3, tmp_path):
    tracker = Tracker(position=np.array([1.5, 0.5, 0.4]))
    T_base_box = np.eye(4)
    T_base_box[0, 3] = -0.5
    box = Box("wall", np.array([0.1, 2.0, 2.0]), T_base_box)
    cell = Cell(estimate_frame=True, model="zeros", tracker=tracker, boxes=(box,))
    virtual = Scenario(ur3, cell, "zeros").draw(3)
    with Session.start(tmp_path / "s", ur3, cell, Aim(poses=20), seed=1) as session:
        measured(session, Operator.of(virtual, 1), 8)
        q = np.array([stop.row.joints for stop in session.stops])
        assert ur3.poses(q)[:, 0, 3].min() > -0.5
        before = shown(session)
    with Session.open(tmp_path / "s") as session:
        assert shown(session) == before


@pytest.mark.slow
def test_a_robot_with_a_sliding_axis(serial_urdf, tmp_path):
    joints = [
        ("prismatic", (0, 0, 0.1), (0, 0, 0), (1, 0, 0)),
        ("revolute", (0, 0, 0.2), (0, 0, 0), (0, 0, 1)),
        ("revolute", (0.3, 0, 0.1), (0, 0, 0), (0, 1, 0)),
        ("revolute", (0.3, 0, 0), (0, 0, 0), (0, 1, 0)),
    ]
    robot = Robot.from_urdf(serial_urdf(joints))
    assert robot.joint_types["j1"] == "prismatic"
    _, state, answers = usual(robot, points_cell("zeros"), tmp_path / "s", 12, Aim(error=2e-4))
    assert [answer.outcome for answer in answers].count("again") <= 1
    assert state.error is not None


@pytest.mark.slow
def test_a_knocked_target_is_named_and_no_stop_is_lost(virtual, tmp_path):
    operator = Operator.of(virtual, 2, Mistakes(at={13: TARGET_MOVED}, moved_length=(2e-3, 2e-3)))
    with started(virtual, tmp_path / "s", Aim(error=5e-5)) as session:
        measured(session, operator, 20)
        codes = [f.code for stop in session.stops for f in stop.answer.findings]
        assert "target_moved" in codes
        assert len(session.measurements) >= 18
        assert [f.code for f in session.state.findings] == ["target_moved"]
        assert session.state.findings[0].name == "target"
        before = shown(session)
        result = session.calibrate()
        assert "target (2)" in result.setup.targets
    with Session.open(tmp_path / "s") as session:
        assert shown(session) == before
        assert "target (2)" in session.cell.targets


# Time


def timed(virtual, folder: Path, count: int, seed: int = 1) -> tuple[float, float]:
    """Median time of add, state and next over the last rows, and the longest, without that of other processes [s]."""
    spent = []
    # An aim that is never reached, so that the design is as long as it can be.
    with started(virtual, folder, Aim(error=1e-6)) as session:
        session._course = with_rows(session._course, good_readings(virtual, count - 8, 5))
        for number in range(8):
            pose = session.next()
            assert pose is not None
            row = Row(pose.joints, readings_at(virtual, [pose.joints], number + seed)[0])
            began = time.process_time()
            session.add(row)
            session.state  # noqa: B018
            session.next()
            spent.append(time.process_time() - began)
    return float(np.median(spent)), max(spent)


@pytest.mark.slow
@pytest.mark.parametrize(("count", "bar"), [(60, 0.3), (300, 0.5)])
def test_an_answer_takes_a_part_of_a_second(panda, tmp_path, count, bar):
    median, _ = timed(virtual_cell(panda, points_cell("placement")), tmp_path / "s", count)
    assert median <= bar


@pytest.mark.slow
def test_a_picture_is_answered_within_a_second(tmp_path):
    arm = Robot.load("ur5", base="tool0", tip="base_link")
    cell = Cell(kind="pixel", model="placement", sigma={"px": 0.3})
    virtual = Scenario(arm, cell, "placement").draw(7)
    q = virtual.poses(30, 4)
    spent = []
    with started(virtual, tmp_path / "s", Aim(error=1e-3)) as session:
        session._course = with_rows(session._course, readings_at(virtual, [*q[:25]]))
        for pose in q[25:]:
            row = Row(pose, readings_at(virtual, [pose])[0])
            began = time.process_time()
            session.add(row)
            session.state  # noqa: B018
            session.next()
            spent.append(time.process_time() - began)
    assert np.median(spent) <= 1.0
