"""Ticks of servos and LeRobot's numbers become angles, by its formulas; what they leave open is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from calib.data.forms.column_options import BRANDS, LEROBOT, ColumnOptions
from calib.data.forms.servo_columns import STATE, MotorRange, Motors
from calib.data.measurements import Measurements
from calib.errors import FileError, MeasurementError
from tests.data.tables import refused

MOTORS = [name.removesuffix(".pos") for name in BRANDS[LEROBOT].axes[0]]
#: Joints of a URDF that calls them otherwise.
JOINTS = ["Rotation", "Pitch", "Elbow", "Wrist_Pitch", "Wrist_Roll"]
RANGES = {
    "shoulder_pan": (751, 3460),
    "shoulder_lift": (830, 3201),
    "elbow_flex": (900, 3121),
    "wrist_flex": (811, 3222),
    "wrist_roll": (0, 4095),
    "gripper": (2001, 3499),
}
#: What each servo reports in two rows.
PRESENT = np.array([[2100, 1500, 3000, 2047, 2048], [1000, 3000, 1200, 900, 100]])


def calibration(folder: Path, **changes: int) -> Path:
    """A calibration file as LeRobot writes it."""
    file = {}
    for i, (name, (first, last)) in enumerate(RANGES.items()):
        motor = {"id": i + 1, "drive_mode": 0, "homing_offset": -7 * i}
        file[name] = {**motor, "range_min": first, "range_max": last} | changes
    path = folder / "my_follower.json"
    path.write_text(json.dumps(file, indent=4))
    return path


def lerobot(name: str, ticks: float, unit: str) -> float:
    """The number that LeRobot makes of what a servo reports: MotorsBus._normalize of its motors_bus.py."""
    first, last = RANGES[name]
    if unit == "deg":
        return (ticks - (first + last) / 2) * 360 / 4095
    return (min(last, max(first, ticks)) - first) / (last - first) * 200 - 100


def angles() -> np.ndarray:
    """The true angles of the servos from the middles of their ranges, [rad]: 4096 ticks are a turn."""
    middles = np.array([sum(RANGES[name]) / 2 for name in MOTORS])
    return (PRESENT - middles) * 2 * np.pi / 4096


def table_of(table, unit: str, header_unit: str = "", *, state: bool = False) -> Path:
    """A table of two rows with LeRobot's columns, or with all motors in one."""
    lines = []
    for row in PRESENT:
        pairs = zip(MOTORS, row, strict=True)
        numbers = [
            str(t) if unit == "ticks" else repr(float(lerobot(n, t, unit))) for n, t in pairs
        ]
        cells = [*numbers, "33.25"]
        arm = '"[' + "  ".join(cells) + ']"' if state else ",".join(cells)
        lines.append(f"{arm},500,-200.5,300")
    names = [STATE] if state else [f"{name}.pos" for name in (*MOTORS, "gripper")]
    head = ",".join(name + header_unit for name in names)
    return table(f"{head},x [mm],y [mm],z [mm]", *lines)


@pytest.mark.parametrize("state", [False, True])
@pytest.mark.parametrize("stated", ["header", "option"])
@pytest.mark.parametrize("unit", ["deg", "%", "ticks"])
def test_lerobots_numbers_become_angles(unit, stated, state, table, tmp_path):
    path = table_of(table, unit, f" [{unit}]" if stated == "header" else "", state=state)
    options = ColumnOptions(
        brand=LEROBOT,
        joint_unit=unit if stated == "option" else None,
        motors=calibration(tmp_path),
    )
    m = Measurements.read(path, JOINTS, columns=options)
    assert m.joint_names == tuple(JOINTS)
    np.testing.assert_allclose(m.joints, angles(), rtol=0, atol=1e-12)
    assert m.points[0].tolist() == pytest.approx([0.5, -0.2005, 0.3])
    without_file = ColumnOptions(brand=LEROBOT, joint_unit=options.joint_unit)
    if unit == "deg":  # says all but the ticks in a turn
        again = Measurements.read(path, JOINTS, columns=without_file)
        np.testing.assert_array_equal(again.joints, m.joints)
    else:
        refused(path, ["shoulder_pan", "--motors"], joint_names=JOINTS, columns=without_file)


def test_ticks_of_any_servos(table, tmp_path):
    path = table("one [ticks],two [deg],three,x [mm],y [mm],z [mm]", "512,10,300,100,200,300")
    m = Measurements.read(
        path, ["one", "two", "three"], columns=ColumnOptions(joint_unit="deg", motors="1024@500.5")
    )
    wanted = np.radians([[11.5 * 360 / 1024, 10, 300]])
    np.testing.assert_allclose(m.joints, wanted, rtol=1e-15)
    says = ["column 'one [ticks]'", "--motors 4096@2048"]
    refused(path, says, joint_names=["one"])
    # LeRobot's file serves columns by the motors' names too; the resolution may be another.
    path = table("wrist_roll [ticks],x [mm],y [mm],z [mm]", "1023.75,100,200,300")
    motors = f"2048@{calibration(tmp_path)}"
    m = Measurements.read(path, ["wrist_roll"], columns=ColumnOptions(motors=motors))
    np.testing.assert_allclose(m.joints, [[np.radians(-1023.75 * 360 / 2048)]], rtol=1e-14)
    # Degrees under a joint's own name are degrees.
    path = table("wrist_roll [deg],x [mm],y [mm],z [mm]", "90,100,200,300")
    m = Measurements.read(path, ["wrist_roll"], columns=ColumnOptions(motors=motors))
    assert m.joints[0, 0] == np.radians(90)


def test_decimal_commas_and_empty_cells_stay(table):
    path = table(
        "one [ticks];x [mm];y [mm];z [mm]", "512,5;100;200;300", ";;;", "500,5;100,5;200;300"
    )
    m = Measurements.read(path, ["one"], columns=ColumnOptions(motors="1024@500.5"))
    np.testing.assert_allclose(m.joints[:, 0], np.radians([12 * 360 / 1024, 0.0]), rtol=1e-15)


def test_what_the_table_does_not_say_is_asked_for(table, tmp_path):
    path = table_of(table, "deg")
    says = ["shoulder_pan.pos", "--joint-unit deg", "--motors"]
    refused(path, says, joint_names=JOINTS, columns=ColumnOptions(brand=LEROBOT))
    refused(path, ["--columns lerobot"], joint_names=JOINTS)
    own = calibration(tmp_path, drive_mode=1)
    for unit in ("deg", "ticks"):  # do not depend on it
        options = ColumnOptions(brand=LEROBOT, joint_unit=unit, motors=own)
        Measurements.read(table_of(table, unit), JOINTS, columns=options)
    options = ColumnOptions(brand=LEROBOT, joint_unit="%", motors=own)
    says = ["drive_mode", "'shoulder_pan'", str(own)]
    refused(table_of(table, "%"), says, joint_names=JOINTS, columns=options)


@pytest.mark.parametrize("number", ["100.0", "-100", "103.2"])
def test_the_end_of_the_range_is_refused_where_lerobot_clips(number, table, tmp_path):
    path = table_of(table, "%")
    text = path.read_text().splitlines()
    text[2] = ",".join([number, *text[2].split(",")[1:]])
    path.write_text("\n".join(text))
    options = ColumnOptions(brand=LEROBOT, joint_unit="%", motors=calibration(tmp_path))
    says = ["row 2", "'shoulder_pan.pos'", f"'{number}'", "clips"]
    refused(path, says, joint_names=JOINTS, columns=options)


def test_a_state_of_another_number_of_motors(table):
    path = table(f"{STATE},x [mm],y [mm],z [mm]", '"[1, 2, 3]",1,2,3')
    options = ColumnOptions(brand=LEROBOT, joint_unit="deg")
    refused(path, ["6 numbers", "gripper.pos"], joint_names=JOINTS, columns=options)


def test_what_motors_says(tmp_path):
    motors = Motors.parse(str(calibration(tmp_path)))
    assert motors.ticks == 4096
    assert motors.ranges["gripper"] == MotorRange(2001, 3499, 0)
    assert (Motors.parse("4096@2048").ticks, Motors.parse("4096@2048").zero) == (4096, 2048.0)
    for text, message in (("0@5", "at least 2 ticks"),):
        with pytest.raises(MeasurementError, match=message):
            Motors.parse(text)
    for content, message in (
        ("{}", "it has no motors"),
        ("[1]", "it has no motors"),
        ('{"a": {"drive_mode": 0, "range_min": 1}}', "'a' does not have whole numbers"),
        ('{"a": {"drive_mode": 0, "range_min": 1.5, "range_max": 9}}', "'a' does not have whole"),
        ('{"a": {"drive_mode": 0, "range_min": 9, "range_max": 9}}', "range_min of 'a' is 9"),
        ("no", "not a JSON file"),
    ):
        (tmp_path / "bad.json").write_text(content)
        with pytest.raises(FileError, match=message) as error:
            Motors.parse(tmp_path / "bad.json")
        assert "bad.json" in str(error.value)
