"""A station: rows of a session from instruments and robots, one reading of each target at a stop."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.boards.render import USUAL_SCENE, render, write_png
from calib.data.cell import Cell
from calib.data.forms.column_options import ColumnOptions
from calib.errors import CalibError, DeviceError, MeasurementError
from calib.robot.robot import Robot
from calib.verbs.measure.devices.readers import READERS, Reader
from calib.verbs.measure.devices.reading import Reading
from calib.verbs.measure.session import Session
from calib.verbs.measure.station import Station
from calib.verbs.simulate.scenario import Scenario
from calib.verbs.simulate.virtual_session import known_cell
from tests.verbs.measure.devices.rtde_server import Server
from tests.verbs.measure.rehearsal import CELL, Tracker, session_of

TWO = replace(CELL, targets={"A": np.full(3, 0.05), "B": np.array([-0.05, 0.05, 0.05])})


@pytest.fixture
def session(ur3, tmp_path):
    with session_of(ur3, tmp_path / "s") as session:
        yield session


@pytest.fixture
def two(ur3, tmp_path):
    """A session with two targets."""
    with session_of(ur3, tmp_path / "two", TWO) as session:
        yield session


def test_what_is_typed_is_measured_at_the_proposed_pose(session):
    with Station(session) as station:
        pose = station.propose()
        assert station.read(0.0) is None
        station.enter("812,5;-30,5;1200")
        row = station.read(0.0)
        assert row.joints == pytest.approx(pose.joints, abs=1e-12)
        assert row.readings.points == pytest.approx(np.array([[0.8125, -0.0305, 1.2]]))
        assert station.read(0.0) is None


def test_a_header_or_a_unit_says_in_which_unit_it_is(session):
    with Station(session, unit="m") as station:
        station.propose()
        station.enter("0.8125 -0.0305 1.2")
        assert station.read(0.0).readings.points[0] == pytest.approx([0.8125, -0.0305, 1.2])
    with Station(session) as station:
        station.propose()
        station.enter("x [in],y [in],z [in]")
        station.enter("10,20,30")
        assert station.read(0.0).readings.points[0] == pytest.approx([0.254, 0.508, 0.762])
    with pytest.raises(CalibError, match="not one of length"):
        Station(session, unit="deg")


@pytest.mark.parametrize(
    ("unit", "line", "right"), [("mm", "2.6 0.3 0.4", "m"), ("m", "2600 300 400", "mm")]
)
def test_a_place_in_another_unit_is_refused_and_the_option_named(session, unit, line, right):
    with Station(session, unit=unit) as station:
        station.propose()
        station.enter(line)
        with pytest.raises(MeasurementError, match=f"--unit {right};") as refused:
            station.read(0.0)
        assert f"Give it in {unit}" in str(refused.value)
        assert "header" not in str(refused.value)
        assert station.read(0.0) is None


def test_half_a_line_is_refused_and_the_next_one_counts(session):
    with Station(session) as station:
        station.propose()
        with pytest.raises(MeasurementError, match="'812 13' is not a row of the columns"):
            station.enter("812 13")
        station.enter("812 13 14")
        assert station.read(0.0) is not None


def test_joint_values_are_those_of_the_reading_if_it_has_them(session):
    names = session.robot.joint_names
    with Station(session) as station:
        station.propose()
        station.enter(",".join([*(f"{name} [deg]" for name in names), "x [mm],y [mm],z [mm]"]))
        station.enter("10,-90,20,30,40,50,812,13,14")
        row = station.read(0.0)
    assert row.joints == pytest.approx(np.radians([10, -90, 20, 30, 40, 50]))


def test_columns_are_renamed(session):
    columns = ColumnOptions({"east": "x", "north": "y", "up": "z"})
    with Station(session, columns=columns) as station:
        station.propose()
        station.enter("east [mm],north [mm],up [m]")
        station.enter("812,13,1.4")
        assert station.read(0.0).readings.points[0] == pytest.approx([0.812, 0.013, 1.4])


def test_a_list_of_points_with_names_below_a_title_is_read(session, tmp_path):
    path = tmp_path / "export.txt"
    with Station(session, f"file:{path}") as station:
        station.propose()
        path.write_text("Point; X; Y; Z\nP1; 812; 13; 14\n", encoding="utf-8")
        assert station.read(5.0).readings.points[0] == pytest.approx([0.812, 0.013, 0.014])


def test_where_the_robot_stands_can_be_typed(session):
    with Station(session) as station:
        station.propose()
        with pytest.raises(MeasurementError, match="type the values of shoulder_pan_joint"):
            station.stands_at("10 20")
        station.stands_at("10 -90 20 30 40 50")
        station.enter("812 13 14")
        assert station.read(0.0).joints == pytest.approx(np.radians([10, -90, 20, 30, 40, 50]))
        station.added()
        pose = station.propose()  # holds for one pose
        station.enter("812 13 14")
        assert station.read(0.0).joints == pytest.approx(pose.joints)


def test_each_target_is_collected_once_whatever_its_order(two):
    with Station(two) as station:
        station.propose()
        assert station.missing == ("A", "B")
        station.enter("812 13 14")
        assert station.read(0.0) is None
        assert station.missing == ("B",)
        station.enter("x [mm],y [mm],z [mm],target")
        station.enter("815,13,14,A")  # measured again before the other one
        assert station.read(0.0) is None
        station.enter("700,13,14,B")
        row = station.read(0.0)
        assert row.readings.targets == ("A", "B")
        assert row.readings.points[:, 0] == pytest.approx([0.815, 0.7])


def test_a_target_that_cannot_be_seen_is_left_out(two):
    with Station(two) as station:
        station.propose()
        assert station.enough() is None
        station.enter("812 13 14")
        assert station.read(0.0) is None
        row = station.enough()
        assert row.readings.targets == ("A",)
        assert two.add(row).stop == 1
        station.added()
        station.propose()
        station.enter("512 13 14")
        station.enter("700 13 14")
        assert two.add(station.read(0.0)).stop == 2


def test_a_target_that_the_cell_does_not_name_is_refused_and_nothing_is_kept(ur3, tmp_path):
    one = replace(CELL, targets={"A": np.full(3, 0.05)})
    with session_of(ur3, tmp_path / "one", one) as session, Station(session) as station:
        station.propose()
        station.enter("x [mm],y [mm],z [mm],target")
        station.enter("812,13,14,B")
        with pytest.raises(MeasurementError, match="the target 'B'; those of the cell are 'A'"):
            station.read(0.0)
        with pytest.raises(CalibError, match="the cell says where 'A' is"):
            session.add({"x [mm]": 812.0, "y [mm]": 13.0, "z [mm]": 14.0, "target": "B"})
        assert session.events == ()
        station.enter("812,13,14,A")
        session.add(station.read(0.0))
    with Session.open(tmp_path / "one") as session:
        assert len(session.stops) == 1


def test_the_only_target_may_have_any_name(session):
    with Station(session) as station:
        station.propose()
        station.enter("x [mm],y [mm],z [mm],target")
        station.enter("812,13,14,SMR")
        assert session.add(station.read(0.0)).stop == 1


def test_readings_of_earlier_poses_are_left_out(session, tmp_path, ur3):
    path, tracker = tmp_path / "points.txt", Tracker(ur3)
    path.write_text("1 2 3\n", encoding="utf-8")
    with Station(session, f"file:{path}") as station:
        with path.open("a", encoding="utf-8") as file:
            file.write("812 13 14\n813 13 14\n")
        pose = station.propose()
        assert station.late == 2
        with path.open("a", encoding="utf-8") as file:
            file.write(tracker.line(pose.joints) + "\n")
        row = station.read(5.0)
        assert row.readings.points[0] == pytest.approx(
            np.array(tracker.points(pose.joints)[0]) / 1e3, abs=1e-3
        )
        session.add(row)
        station.added()
        station.propose()
        assert station.late == 0


def test_the_controller_says_where_the_robot_stands_once_it_stands_still(session):
    with (
        Server() as server,
        Station(session, controller=f"rtde:127.0.0.1:{server.port}") as station,
    ):
        assert station.has_robot
        station.propose()
        station.enter("812 13 14")
        server.q[1] = -1.0
        row = station.read(1.0)
        assert row.joints == pytest.approx(server.q)
        with pytest.raises(MeasurementError, match="controller says where the robot stands"):
            station.stands_at("0 0 0 0 0 0")


def test_an_instrument_that_is_asked_is_asked_when_the_robot_has_arrived(session, monkeypatch):
    asked = []

    class Trigger:
        def __init__(self, argument, context):
            del argument, context

        def read(self, timeout=None):
            asked.append(timeout)
            return Reading.of({"x [mm]": 812.0, "y [mm]": 13.0, "z [mm]": 14.0})

        def close(self):
            pass

    monkeypatch.setitem(READERS, "trigger", Reader("tells a tracker", Trigger, is_asked=True))
    with Station(session, "trigger") as station:
        station.propose()
        assert station.waits_for_go
        assert station.read(0.05) is None
        station.go()
        assert station.read(0.05) is not None
        assert len(asked) == 1
        assert station.read(0.05) is None  # once
    with (
        Server() as server,
        Station(session, "trigger", f"rtde:127.0.0.1:{server.port}") as station,
    ):
        pose = station.propose()
        assert station.read(0.3) is None
        server.q = pose.joints.tolist()
        assert station.read(3.0).joints == pytest.approx(pose.joints)
        assert len(asked) == 2


def test_the_last_pose_is_measured_again(session, ur3):
    tracker = Tracker(ur3)
    with Station(session) as station:
        assert station.again() is None
        for _ in range(2):
            pose = station.propose()
            station.enter(tracker.line(pose.joints))
            session.add(station.read(0.0))
            station.added()
        assert station.again() == 2
        again = station.propose()
        assert (again.why, again.stop) == ("again", 2)
        assert again.joints == pytest.approx(pose.joints)
        assert again.expected == pytest.approx(session.expected(pose.joints))
        assert again.targets == pose.targets
        station.enter(tracker.line(pose.joints))
        assert session.add(station.read(0.0)).stop == 2
        station.added()
        assert station.propose().joints != pytest.approx(pose.joints)


def test_an_instrument_that_is_told_its_pose_has_no_reading_of_an_earlier_one(session):
    with Station(session, "virtual:1") as station:
        shown = [station.propose()]
        for change in (session.skip, session.skip):
            change()
            shown.append(station.propose())
            assert station.late == 0
        assert np.abs(shown[2].joints - shown[1].joints).max() > 0.01
        row = station.read(1.0)
        assert row.joints == pytest.approx(shown[2].joints)
        # The skipped poses were not measured: it is the first reading.
        with Station(session, "virtual:1") as other:
            other.propose()
            assert other.read(1.0).readings.points == pytest.approx(row.readings.points)


def test_devices_that_there_are_not_are_refused_and_the_session_stays_open(session):
    for words in (("tracker:1",), ("stdin", "abb:1"), ("watch:/nowhere",)):
        with pytest.raises(DeviceError):
            Station(session, *words)
    assert session.next() is not None


@pytest.mark.slow
def test_pictures_of_a_folder_become_rows_of_corners_and_are_kept(tmp_path):
    arm = Robot.load("ur5", base="tool0", tip="base_link")
    virtual = Scenario(arm, Cell(kind="pixel")).draw(7)
    exports = tmp_path / "exports"
    exports.mkdir()

    def take(q, path: Path) -> None:
        image = render(
            virtual.equipment.printed,
            virtual.equipment.camera,
            virtual.truth.poses(q[None])[0],
            scene=USUAL_SCENE,
            blur=0.6,
            noise=1.5,
            seed=np.random.default_rng(1),
        )
        write_png(image, path, overwrite=True)

    with session_of(arm, tmp_path / "s", known_cell(virtual, 1)) as session:
        with Station(session, f"watch:{exports}") as station:
            for k in range(5):
                pose = station.propose()
                take(pose.joints, exports / f"img{k}.png")
                row = station.read(10.0)
                assert row.joints == pytest.approx(pose.joints)
                assert set(row.readings.kinds) == {"pixel"}
                assert len(row.readings) >= 12
                began = time.monotonic()
                answer = session.add(row)
                assert time.monotonic() - began < 2.0
                assert answer.outcome != "again"
                station.added()
            station.propose()
            write_png(np.full((720, 1280), 128, np.uint8), exports / "wall.png")
            with pytest.raises(MeasurementError, match=r"'wall\.png' cannot be used"):
                station.read(10.0)
            assert station.late == 0
        kept = {path.name for path in session.pictures.iterdir()}
        assert kept == {f"img{k}.png" for k in range(5)}
        assert session.measurements.images[0].endswith("img0.png")
        assert answer.after < 0.01
