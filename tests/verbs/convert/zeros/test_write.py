"""Each format, read by plain csv, json and yaml and applied as its controller does, moves the arm onto the points.

The Python of docs/zeros.md is run by tests/test_docs_site.py.
"""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from calib.errors import CalibError, FileError, VerdictError
from calib.result.calibration_file import read_result, write_result
from calib.result.joint_zeros import HELD_OUT, SquaredErrors
from calib.verbs.convert.conversion import convert
from calib.verbs.convert.convert import FORMATS, Options
from calib.verbs.convert.zeros.rounding import STORED
from tests.verbs.convert.zeros.arms import (
    SERVO_ZEROS,
    miss,
    servo_arm,
    servo_readings,
    servo_result,
    ur3_result,
    written,
)

NAMES = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
#: Of a tick of 0.088 deg in five joints of an arm of 0.4 m [m]; the zeros move it by 7 mm.
TICKS = 6e-4
#: Of all finer rounding, and of noise of 0.05 mm [m].
FINE = 1e-4
TICK = 2.0 * np.pi / 4096
OLD = {"shoulder_pan": -310, "shoulder_lift": 1204, "elbow_flex": 5, "wrist_flex": 900}


def lerobot_file(folder: Path, **changes: int) -> Path:
    entries = {
        name: {"id": k, "drive_mode": 0, "homing_offset": OLD.get(name, 7), "range_min": 700}
        for k, name in enumerate((*NAMES, "gripper"), start=1)
    }
    for name, value in changes.items():
        entries[name]["homing_offset"] = value
    path = folder / "own.json"
    path.write_text(json.dumps(entries))
    return path


def test_the_simulated_arm_is_off_by_its_zeros():
    q = servo_readings()
    assert miss(q) > 6e-3
    assert miss(q + np.radians(SERVO_ZEROS)) < 1e-12
    assert miss(q - np.radians(SERVO_ZEROS)) > 1.2e-2


def test_a_table_of_degrees_is_added_to_the_readings(tmp_path: Path):
    lines = written(tmp_path / "z.csv", "zeros").read_text().splitlines()
    rows = list(csv.DictReader(line for line in lines if line[0] != "#"))
    assert [row["joint"] for row in rows] == list(NAMES)
    assert {(row["unit"], row["determined"]) for row in rows} == {("deg", "yes")}
    change = np.array([float(row["change"]) for row in rows])
    assert change == pytest.approx(SERVO_ZEROS, abs=0.02)
    assert change == pytest.approx(np.degrees(servo_result().zeros.delta), abs=5.1e-5)
    assert miss(servo_readings() + np.radians(change)) < FINE


def test_the_table_as_json(tmp_path: Path):
    content = json.loads(written(tmp_path / "z.json", "zeros").read_text())
    change = [row["change"] for row in content["joints"]]
    assert miss(servo_readings() + np.radians(change)) < FINE
    fitted = [row["delta_rad"] for row in content["joints"]]
    assert fitted == servo_result().zeros.delta.tolist()
    assert content["rows"] == HELD_OUT
    assert content["rms"]["rounded"]["m"] < FINE < 50 * FINE < content["rms"]["nominal"]["m"]


@pytest.mark.parametrize("gear", [1.0, -2.5])
def test_dynamixel_hardware_subtracts_the_offset_from_the_motor(tmp_path: Path, gear: float):
    old = 0.3
    own = tmp_path / "own.yaml"
    motors = {name: {"id": 1, "offset": old, "gear_ratio": gear} for name in NAMES}
    own.write_text(yaml.safe_dump({"motors": motors, "usb_port": "/dev/ttyUSB0"}))
    path = written(tmp_path / "new.yaml", "dynamixel-hardware", update=own)
    content = yaml.safe_load(path.read_text())
    assert content["usb_port"] == "/dev/ttyUSB0"
    assert content["motors"]["elbow_flex"]["id"] == 1
    new = np.array([content["motors"][name]["offset"] for name in NAMES])
    motor = gear * servo_readings() + old  # state = (position - offset) / gear_ratio
    assert miss((motor - new) / gear) < FINE


def test_a_transmission_adds_the_offset(tmp_path: Path):
    own = tmp_path / "own.yaml"
    own.write_text(yaml.safe_dump({name: {} for name in NAMES}))  # without an offset it is 0
    path = written(tmp_path / "new.yaml", "ros2-transmission", update=own)
    content = yaml.safe_load(path.read_text())
    new = np.array([content[name]["offset"] for name in NAMES])
    assert miss(servo_readings() + new) < FINE


@pytest.mark.parametrize(("to", "sign"), [("lerobot", -1), ("lerobot-dynamixel", 1)])
def test_homing_offsets_move_the_present_position(tmp_path: Path, to: str, sign: int):
    own = lerobot_file(tmp_path)
    path = written(tmp_path / "new.json", to, update=own)
    before, after = json.loads(own.read_text()), json.loads(path.read_text())
    old, new = (np.array([t[name]["homing_offset"] for name in NAMES]) for t in (before, after))
    assert new.dtype == np.int64
    # Feetech: present = actual - offset; Dynamixel: present = actual + offset.
    present = servo_readings() / TICK
    actual = present - sign * old
    assert miss((actual + sign * new) * TICK) < TICKS
    assert before.pop("gripper") == after.pop("gripper")
    for name in NAMES:  # nothing else changes
        assert {**after[name], "homing_offset": before[name]["homing_offset"]} == before[name]


@pytest.mark.parametrize("ticks", [1024, 16384])
def test_ticks_of_other_encoders(tmp_path: Path, ticks: int):
    path = written(tmp_path / "z.json", "lerobot", ticks=ticks)
    content = json.loads(path.read_text())
    change = np.array([content[name]["homing_offset_change"] for name in NAMES])
    assert -change * 360.0 / ticks == pytest.approx(SERVO_ZEROS, abs=180.0 / ticks + 0.02)


@pytest.mark.parametrize("to", sorted(set(STORED) - {"zeros"}))
def test_without_the_robot_s_own_file_the_changes_are_named_as_such(tmp_path: Path, to: str):
    path = written(tmp_path / f"z{FORMATS[to].endings[0]}", to)
    key = f"{STORED[to].key}_change"
    content = yaml.safe_load(path.read_text())  # JSON is YAML
    assert list(content) == list(NAMES)
    assert all(list(entry) == [key] for entry in content.values())


def test_a_zero_that_is_not_determined_is_left_out(tmp_path: Path):
    done = convert(ur3_result(), tmp_path / "z.yaml", to="ros2-transmission")
    content = yaml.safe_load((tmp_path / "z.yaml").read_text())
    assert list(content) == list(ur3_result().nominal.joint_names[:5])
    codes = [note.code for note in done.notes]
    assert codes == ["zeros not determined", "changes alone"]
    assert "wrist_3_joint" in done.notes[0].values[0]
    convert(ur3_result(), tmp_path / "z.csv", to="zeros")
    assert (tmp_path / "z.csv").read_text().splitlines()[-1] == "wrist_3_joint,,deg,,no"


@pytest.mark.parametrize("limit", [2047, -2047])
def test_an_offset_beyond_its_limit_is_refused(tmp_path: Path, limit: int):
    joint = "elbow_flex" if limit > 0 else "wrist_flex"  # whose offset grows, falls
    own = lerobot_file(tmp_path, **{joint: limit})
    with pytest.raises(FileError, match=rf"{joint}.*{abs(limit)}"):
        written(tmp_path / "new.json", "lerobot", update=own)
    assert not (tmp_path / "new.json").exists()
    change = abs(round(2 * 2.2 / np.degrees(TICK)))
    own = lerobot_file(tmp_path, **{joint: limit - int(np.sign(limit)) * change})
    written(tmp_path / "new.json", "lerobot", update=own)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("own.json", '{"1": {"homing_offset": 3}}', "shoulder_pan"),
        ("own.json", '{"shoulder_pan": {"homing_offset": 3}}', "shoulder_lift"),
        ("own.json", "{", "JSON"),
        ("own.json", "[1]", "shoulder_pan"),
    ],
)
def test_a_file_that_is_not_the_robot_s_is_refused(tmp_path, name, content, said):
    (tmp_path / name).write_text(content)
    with pytest.raises(FileError, match=said):
        written(tmp_path / "new.json", "lerobot", update=tmp_path / name)
    assert not (tmp_path / "new.json").exists()


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [("drive_mode", 1, "drive_mode is 1"), ("homing_offset", "x", "homing_offset is 'x'")],
)
def test_an_entry_that_is_not_understood_is_refused(tmp_path, key, value, said):
    own = lerobot_file(tmp_path)
    content = json.loads(own.read_text())
    content["wrist_flex"][key] = value
    own.write_text(json.dumps(content))
    with pytest.raises(FileError, match=rf"wrist_flex: its {said}"):
        written(tmp_path / "new.json", "lerobot", update=own)


def test_zeros_that_are_no_better_than_none_are_refused(tmp_path: Path):
    result = ur3_result()
    nominal = result.trust.nominal_cross_validation.errors_without_outliers["m"].rms
    zeros = result.zeros
    m = len(zeros.joints)
    worse = SquaredErrors(28, nominal**2, np.zeros(m), np.zeros((m, m)))
    bad = replace(result, zeros=replace(zeros, errors={"m": worse}))
    with pytest.raises(VerdictError, match=r"2\.350 mm with them"):
        convert(bad, tmp_path / "z.csv", to="zeros")
    assert not (tmp_path / "z.csv").exists()
    done = convert(bad, tmp_path / "z.csv", to="zeros", accept=True)
    assert "zeros no better" in [note.code for note in done.notes]
    better = replace(worse, mean_square=0.99 * nominal**2)
    good = replace(result, zeros=replace(zeros, errors={"m": better}))
    convert(good, tmp_path / "z.csv", to="zeros", overwrite=True)


def test_a_robot_and_a_result_without_zeros_have_none(tmp_path: Path):
    with pytest.raises(CalibError, match="calib calibrate"):
        convert(servo_arm(), tmp_path / "z.csv", to="zeros")
    without = replace(servo_result(), zeros=None)
    write_result(without, tmp_path / "old.json")
    content = json.loads((tmp_path / "old.json").read_text())
    del content["zeros"]  # as an earlier version wrote it
    (tmp_path / "old.json").write_text(json.dumps(content))
    assert read_result(tmp_path / "old.json").zeros is None
    with pytest.raises(CalibError, match="Calibrate again"):
        convert(tmp_path / "old.json", tmp_path / "z.csv", to="zeros")


@pytest.mark.parametrize(("to", "name"), [("zeros", "z.yaml"), ("lerobot", "z.csv")])
def test_other_endings_are_refused(tmp_path: Path, to: str, name: str):
    with pytest.raises(FileError, match=r"\.json"):
        written(tmp_path / name, to)


def test_ticks_are_at_least_one(tmp_path: Path):
    with pytest.raises(CalibError, match="--ticks 0"):
        written(tmp_path / "z.json", "lerobot", ticks=0)


def test_the_file_of_a_result_gives_the_same(tmp_path: Path):
    write_result(servo_result(), tmp_path / "result.json")
    options = Options(to="zeros")
    convert(tmp_path / "result.json", tmp_path / "file.json", options=options)
    assert (tmp_path / "file.json").read_bytes() == written(
        tmp_path / "memory.json", "zeros"
    ).read_bytes()
