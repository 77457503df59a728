"""Arms by their rows: the poses are the product of the table, and corrected rows go back in the form that came in."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.example import dh_rows
from calib.robot.dh_file import read_dh_robot
from calib.robot.dh_rows import DHRow
from calib.verbs.convert.dh import DHTables
from tests.places import ROOT

#: Three axes that slide and a wrist; the last of the three is parallel to the first of the wrist.
GANTRY = """# robot: gantry
# convention: hayati
joint,type,theta [deg],d [mm],a [mm],alpha [deg],offset [mm],direction,lower,upper,x [mm],y [mm],z [mm],pitch [deg]
base,,,,,,,,,,100,200,2500,90
X,prismatic,90,300,0,90,50,1,0 mm,3000 mm,,,,
Y,prismatic,-90,400,0,90,,-1,-1500 mm,1500 mm,,,,
Z,prismatic,0,200,0,0,,1,0 mm,1000 mm,,,,
A,revolute,0,150,0,-90,,-1,-170 deg,170 deg,,,,
B,revolute,0,0,0,90,,1,-110 deg,110 deg,,,,
C,revolute,0,90,0,0,,1,-350 deg,350 deg,,,,
tool,,,,,,,,,,0,0,20,0
"""

ARMS = (
    "ur10e",
    "franka_panda",
    "kuka_kr6_r900",
    "abb_irb120",
    "fanuc_lrmate200id",
    "epson_gx4_a351s",
    "gantry",
)

#: Rows from 0 whose d and theta are large: the standard convention does not hold the tilt of parallel axes.
TILTED = {
    "ur10e": (1, 2, 3),
    "kuka_kr6_r900": (1, 2),
    "abb_irb120": (1, 2),
    "fanuc_lrmate200id": (1, 2),
}


def rows_file(name: str, folder: Path) -> Path:
    if name != "gantry":
        return dh_rows(name)
    path = folder / "gantry.csv"
    path.write_text(GANTRY)
    return path


# The product of a table, written down anew


def turn(axis: str, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    T = np.eye(4)
    T[:3, :3] = {
        "x": [[1, 0, 0], [0, c, -s], [0, s, c]],
        "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]],
        "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]],
    }[axis]
    return T


def move(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def number(record: dict[str, str], name: str) -> float:
    """The number under a heading, or with its own unit, in m and rad; 0 of an empty cell."""
    for head, cell in record.items():
        if head.split(" [")[0] == name and cell:
            value, unit = cell.split() if " " in cell else (cell, head.split("[")[-1].strip("]"))
            return float(value) * {"mm": 1e-3, "deg": np.pi / 180, "rad": 1.0}[unit]
    return 0.0


def product(path: Path, readings: np.ndarray) -> np.ndarray:
    """The tip's poses by the table of a file, shape (N, 4, 4)."""
    with path.open(newline="") as file:
        records = list(csv.DictReader(line for line in file if not line.startswith("#")))
    joints = [record["joint"] for record in records if record["joint"] not in ("base", "tool")]
    poses = []
    for q in readings:
        shown = dict(zip(joints, q, strict=True))
        T = np.eye(4)
        for record in records:
            if record["joint"] in ("base", "tool"):
                T = T @ move(*(number(record, axis) for axis in "xyz"))
                T = T @ turn("y", number(record, "pitch"))
                continue
            value = shown[record["joint"]]
            if record.get("coupling"):
                factor, other = record["coupling"].split(" * ")
                value += float(factor) * shown[other]
            added = float(record.get("direction") or 1) * value + number(record, "offset")
            slides = record.get("type") == "prismatic"
            theta = number(record, "theta") + (0.0 if slides else added)
            d = number(record, "d") + (added if slides else 0.0)
            along_z = turn("z", theta) @ move(z=d)
            if "a(i-1) [mm]" in record:
                along_x = turn("x", number(record, "alpha(i-1)"))
                T = T @ along_x @ move(number(record, "a(i-1)")) @ along_z
            else:
                T = T @ along_z @ move(number(record, "a")) @ turn("x", number(record, "alpha"))
                T = T @ turn("y", number(record, "beta"))
        poses.append(T)
    return np.array(poses)


def readings_of(robot: calib.Robot, count: int = 40) -> np.ndarray:
    return np.random.default_rng(3).uniform(-3, 3, (count, len(robot.joint_names)))


@pytest.mark.parametrize("name", ARMS)
def test_poses_are_the_product_of_the_table(name, tmp_path):
    path = rows_file(name, tmp_path)
    robot = calib.Robot.load(path)
    q = readings_of(robot)
    np.testing.assert_allclose(robot.poses(q), product(path, q), rtol=0, atol=1e-12)


def test_angles_are_those_of_the_controllers():
    """Where the makers' manuals put the flange, at poses that tell the signs."""
    half = np.pi / 2
    kuka = calib.Robot.load(dh_rows("kuka_kr6_r900"))
    level, clockwise = kuka.poses([[0, -half, half, 0, 0, 0], [0.5, -half, half, 0, 0, 0]])
    np.testing.assert_allclose(level[:3, 3], [0.525, 0, 0.89], atol=1e-12)
    np.testing.assert_allclose(level[:3, :3], [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], atol=1e-12)
    assert clockwise[1, 3] < -0.2  # seen from above, to -y
    assert kuka.poses([0, -half, half + 0.3, 0, 0, 0])[0, 2, 3] < 0.89  # A3 positive lowers
    assert kuka.poses([0, -half, half, 0, 0.3, 0])[0, 2, 3] < 0.89  # so does A5
    fanuc = calib.Robot.load(dh_rows("fanuc_lrmate200id"))
    zero, forward = fanuc.poses([[0] * 6, [0, 0.4, 0, 0, 0, 0]])
    np.testing.assert_allclose(zero[:3, 3], [0.465, 0, 0.365], atol=1e-12)
    np.testing.assert_allclose(forward[:3, :3], zero[:3, :3], atol=1e-12)  # the forearm stays level
    shift = forward[:3, 3] - zero[:3, 3]
    np.testing.assert_allclose(shift, [0.33 * np.sin(0.4), 0, 0.33 * (np.cos(0.4) - 1)], atol=1e-12)
    assert fanuc.poses([0, 0, 0.3, 0, 0, 0])[0, 2, 3] > 0.365  # J3 positive lifts
    scara = calib.Robot.load(dh_rows("epson_gx4_a351s"))
    np.testing.assert_allclose(scara.poses([0, 0, -0.1, 0])[0, :3, 3], [0.35, 0, -0.1])
    abb = calib.Robot.load(dh_rows("abb_irb120"))
    np.testing.assert_allclose(abb.poses([0] * 6)[0, :3, 3], [0.374, 0, 0.63], atol=1e-12)


def test_the_panda_and_the_ur10e_are_those_of_their_descriptions(panda):
    q = readings_of(panda)
    robot = calib.Robot.load(dh_rows("franka_panda"))
    np.testing.assert_allclose(robot.poses(q), panda.poses(q), rtol=0, atol=1e-9)
    assert robot.joint_names == panda.joint_names


def calibrated(path: Path) -> tuple[calib.Calibration, calib.Robot]:
    """The calibration of an arm of rows from poses with little noise, and the true robot."""
    cell = calib.Cell(kind="pose", model="hayati").with_target((0.02, 0.01, 0.1), estimate=False)
    noise = calib.TrackerNoise(constant=1e-7, per_length=0.0, repeatability=0.0)
    scenario = calib.Scenario(
        path, cell, model="hayati", noise=noise, sigma={"rad": 1e-7}, target_error=0.0
    )
    simulated = calib.simulate(scenario, 40, 5, seed=4)
    result = calib.calibrate(path, simulated.measurements, cell=cell, validate=False)
    return result, simulated.truth.robot


def numbers(row: DHRow) -> np.ndarray:
    return np.array([row.theta, row.d, row.a, row.alpha, row.beta])


@pytest.mark.parametrize("name", ARMS)
def test_corrected_rows_go_back_in_the_form_that_came_in(name, tmp_path):
    path = rows_file(name, tmp_path)
    sheet = read_dh_robot(path)
    result, true = calibrated(path)
    for ending in (".csv", ".json"):
        out = tmp_path / f"corrected{ending}"
        calib.convert(result, out, to="dh", accept=True)
        again = read_dh_robot(out)
        names = ("name", "base", "tip", "joint_names", "coupling")
        for key in names:
            assert getattr(again, key) == getattr(sheet, key), key
        assert again.table.convention == sheet.table.convention
        robot = calib.Robot.load(out)
        q = readings_of(robot)
        np.testing.assert_allclose(robot.poses(q), result.robot.poses(q), rtol=0, atol=1e-9)
        np.testing.assert_allclose(again.poses(q), result.robot.poses(q), rtol=0, atol=1e-9)
        wanted = DHTables.of(true, result.nominal, sheet.table.convention).after
        for i, (row, of_sheet, of_true) in enumerate(
            zip(again.table.rows, sheet.table.rows, wanted.rows, strict=True)
        ):
            assert (row.direction, row.prismatic) == (of_sheet.direction, of_sheet.prismatic)
            assert row.offset == pytest.approx(of_sheet.offset, abs=1e-12)
            assert (row.lower, row.upper) == pytest.approx((of_sheet.lower, of_sheet.upper))
            tilted = TILTED.get(name, ())
            if i not in tilted:
                np.testing.assert_allclose(numbers(row), numbers(of_true), rtol=0, atol=3e-6)
                np.testing.assert_allclose(numbers(row), numbers(of_sheet), rtol=0, atol=0.03)


def test_rows_in_python():
    rows = [
        calib.DHRow("j1", d=0.3, alpha=np.pi / 2, direction=-1, lower=-1, upper=2),
        calib.DHRow("j2", a=0.4, offset=-np.pi / 2),
        calib.DHRow("j3", a=0.3),
    ]
    tool = move(0.1, 0.2, 0.3)
    robot = calib.Robot.from_dh(rows, name="arm", T_n_tip=tool, coupling={"j3": {"j2": 1.0}})
    assert (robot.name, robot.base, robot.tip) == ("arm", "base", "flange")
    q = readings_of(robot, 5)
    for one, found in zip(q, robot.poses(q), strict=True):
        T = turn("z", -one[0]) @ move(z=0.3) @ turn("x", np.pi / 2)
        T = T @ turn("z", one[1] - np.pi / 2) @ move(0.4) @ turn("z", one[2] + one[1]) @ move(0.3)
        np.testing.assert_allclose(found, T @ tool, rtol=0, atol=1e-12)
    modified = calib.Robot.from_dh([calib.DHRow("j", a=0.4, alpha=1.0, d=0.5)], "modified")
    wanted = turn("x", 1.0) @ move(0.4) @ turn("z", 0.3) @ move(z=0.5)
    np.testing.assert_allclose(modified.poses([0.3])[0], wanted, atol=1e-15)
    with pytest.raises(TypeError, match=r"rows\[0\]"):
        calib.Robot.from_dh([(0, 0, 0, 0)])  # type: ignore[list-item]
    with pytest.raises(calib.CalibError, match="'denavit' is not a convention"):
        calib.Robot.from_dh(rows, "denavit")
    with pytest.raises(calib.CalibError, match="T_n_tip"):
        calib.Robot.from_dh(rows, T_n_tip=np.eye(3))


def test_a_coupling_in_rows_is_that_of_the_robot():
    robot = calib.Robot.load(dh_rows("fanuc_lrmate200id"))
    assert robot.reading_coupling == {"J3": {"J2": 1.0}}
    again = calib.Robot.from_urdf(robot.urdf, coupling={"J3": {"J2": -1.0}})
    assert again.reading_coupling == {"J3": {"J2": -1.0}}  # what is given counts


def test_the_tables_of_the_page_are_rows(tmp_path):
    page = (ROOT / "docs" / "dh-rows.md").read_text(encoding="utf-8")
    tables = re.findall(r"```csv\n(.*?)```", page, re.DOTALL)
    for table, name in zip(
        tables, ("kuka_kr6_r900", "franka_panda", "epson_gx4_a351s"), strict=True
    ):
        (tmp_path / "rows.csv").write_text(table)
        of_page, of_example = read_dh_robot(tmp_path / "rows.csv"), read_dh_robot(dh_rows(name))
        assert of_page.table.convention == of_example.table.convention
        q = np.random.default_rng(1).uniform(-2, 2, (5, len(of_page.joint_names)))
        np.testing.assert_allclose(of_page.poses(q), of_example.poses(q), atol=1e-12)
