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
from calib.verbs.convert.convert import convert
from calib.verbs.convert.format import Options, Source
from calib.verbs.convert.rounded_zeros import RmsErrors, RoundedZeros
from calib.verbs.convert.zeros import (
    DYNAMIXEL_YAML,
    FORMATS,
    LEROBOT_JSON,
    TABLE_ENDINGS,
    TRANSMISSION_YAML,
    offsets_bytes,
    read_table,
    table_bytes,
)
from tests.parts import of_an_earlier_version
from tests.verbs.convert.zero_arms import (
    SERVO_ZEROS,
    STORED,
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
    content = of_an_earlier_version(json.loads((tmp_path / "old.json").read_text()))
    del content["zeros"]
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


# Files of offsets: sums without digits of their own, entries at any depth, comments that say the sign


def rounded(name: str) -> RoundedZeros:
    result = servo_result()
    source = Source("result", result.robot, result.nominal, calibration=result)
    return RoundedZeros.of(source, STORED[name].with_ticks(4096))


def test_a_sum_has_no_digits_of_its_own(tmp_path: Path):
    zeros = rounded("ros2-transmission")
    own = tmp_path / "own.yaml"
    own.write_text(
        yaml.safe_dump({"a": {"b": {name: {"offset": 0.1} for name in zeros.by_joint()}}})
    )
    data = offsets_bytes(TRANSMISSION_YAML, zeros, own)
    assert data.startswith(b"# offset of each joint")
    assert b"reading = raw / reduction + offset\n" in data
    for name, entry in yaml.safe_load(data)["a"]["b"].items():
        assert entry["offset"] == round(0.1 + zeros.by_joint()[name], 6)


def test_ticks_are_whole():
    zeros = rounded("lerobot")
    content = json.loads(offsets_bytes(LEROBOT_JSON, zeros, None))
    changes = [entry["homing_offset_change"] for entry in content.values()]
    assert all(type(change) is int for change in changes)
    assert changes == [int(number) for number in zeros.numbers]


@pytest.mark.parametrize("gear", ["0.5 turns", True, float("nan")])
def test_a_gear_ratio_that_is_no_number_is_refused(tmp_path: Path, gear: object):
    zeros = rounded("dynamixel-hardware")
    own = tmp_path / "own.yaml"
    own.write_text(yaml.safe_dump({name: {"gear_ratio": gear} for name in zeros.by_joint()}))
    with pytest.raises(FileError, match="gear_ratio"):
        offsets_bytes(DYNAMIXEL_YAML, zeros, own)


@pytest.mark.parametrize(
    ("kind", "entry", "says"),
    [
        (DYNAMIXEL_YAML, {"gear_ratio": 0}, "gear_ratio"),
        (DYNAMIXEL_YAML, {"homing_offset": 12}, "--to"),
        (LEROBOT_JSON, {"homing_offset": 12.5}, "whole ticks"),
    ],
)
def test_entries_of_another_file_or_servo_are_refused(tmp_path: Path, kind, entry, says: str):
    zeros = rounded("lerobot" if kind is LEROBOT_JSON else "dynamixel-hardware")
    own = tmp_path / "own"
    own.write_text(json.dumps(dict.fromkeys(zeros.by_joint(), entry)))
    with pytest.raises(FileError, match=says):
        offsets_bytes(kind, zeros, own)


def test_a_file_of_two_arms_is_refused_for_one_of_them(tmp_path: Path):
    zeros = rounded("lerobot")
    arm = {name: {"homing_offset": 0} for name in zeros.by_joint()}
    own = tmp_path / "own.json"
    own.write_text(json.dumps({"left": arm, "right": arm}))
    with pytest.raises(FileError, match="2 places"):
        offsets_bytes(LEROBOT_JSON, zeros, own)
    own.write_text(json.dumps({"left": arm, "right": {"camera": {"homing_offset": 0}}}))
    assert json.loads(offsets_bytes(LEROBOT_JSON, zeros, own))["left"] != arm


# The table reads back as it was written, also with names that need quotes


def rounded_and_errors() -> tuple[RoundedZeros, RmsErrors]:
    result = ur3_result()
    source = Source("result", result.robot, result.nominal, calibration=result)
    rounded = RoundedZeros.of(source, STORED["zeros"].with_ticks(4096))
    return rounded, RmsErrors.of(result, rounded)


@pytest.mark.parametrize("ending", TABLE_ENDINGS)
@pytest.mark.parametrize("name", ["arm,left\"'", "#axis", "Ä"])
def test_names(ending: str, name: str):
    rounded, rms_errors = rounded_and_errors()
    zeros = replace(rounded.zeros, joints=(name, *rounded.zeros.joints[1:]))
    data = table_bytes(ur3_result().robot, replace(rounded, zeros=zeros), rms_errors, ending)
    assert read_table(data, ending)[name] == pytest.approx(0.3453)


@pytest.mark.parametrize("name", ["a\nb", "# axis"])
def test_a_name_that_a_table_cannot_hold_is_refused(name: str):
    rounded, rms_errors = rounded_and_errors()
    zeros = replace(rounded.zeros, joints=(name, *rounded.zeros.joints[1:]))
    with pytest.raises(FileError, match="rename"):
        table_bytes(ur3_result().robot, replace(rounded, zeros=zeros), rms_errors, ".csv")


def test_json_has_null_for_what_is_not_determined():
    rounded, rms_errors = rounded_and_errors()
    content = json.loads(table_bytes(ur3_result().robot, rounded, rms_errors, ".json"))
    last = content["joints"][-1]
    assert (last["determined"], last["change"], last["delta_rad"], last["std_rad"]) == (
        False,
        None,
        None,
        None,
    )
    std = [row["std_rad"] for row in content["joints"][:-1]]
    assert np.array(std) == pytest.approx(rounded.zeros.std[:-1])
    assert content["rms"]["nominal"]["m"] == rms_errors.nominal["m"]
