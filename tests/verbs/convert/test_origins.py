"""Origins files read back, a xacro takes them; corrections for PAL's robots give the corrected robot."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
import yaml

from calib.errors import CalibError, FileError, UrdfError
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from calib.verbs.convert.convert import convert
from calib.verbs.convert.format import Options
from calib.verbs.convert.origins import (
    KINDS,
    JointOrigin,
    origin_change,
    origins_of,
    read_origins,
    with_origins,
    with_pal_corrections,
    write_origins,
)
from tests.places import ROOT

URDF = ROOT / "urdf"


@pytest.fixture(scope="module")
def corrected() -> Robot:
    return Robot.load(URDF / "ur3_calibrated.urdf", base="base", tip="tool0")


def test_written_and_read_they_are_the_urdfs_own_numbers(corrected: Robot, tmp_path: Path):
    path = write_origins(corrected, tmp_path / "o.yaml")
    read = read_origins(path)
    assert read == origins_of(corrected)
    assert list(read) == [*corrected.joint_names, "wrist_3_link-tool0_fixed_joint"]
    for name, origin in read.items():
        joint = corrected.urdf.joint(name)
        assert (origin.xyz, origin.rpy) == (tuple(joint.xyz), tuple(joint.rpy))
        np.testing.assert_array_equal(origin.T_parent_joint, joint.T_parent_joint)
    # Other programs read them as text.
    table = yaml.safe_load(path.read_bytes())["origins"]
    assert all(isinstance(table[name][key], str) for name in table for key in ("xyz", "rpy"))
    assert "xacro.load_yaml('o.yaml')['origins']" in path.read_text()


@pytest.mark.parametrize(
    ("urdf", "kept"),
    [("ur3.urdf", "ur3_nominal_origins.yaml"), ("ur3_calibrated.urdf", "ur3_origins.yaml")],
)
def test_the_examples_files_are_written_from_the_urdfs(urdf: str, kept: str, tmp_path: Path):
    path = write_origins(Robot.load(URDF / urdf, "base", "tool0"), tmp_path / kept)
    assert path.read_bytes() == (URDF / kept).read_bytes()


def test_the_nominal_robot_with_them_is_the_corrected_one(corrected: Robot):
    nominal = Robot.load(URDF / "ur3.urdf", base="base", tip="tool0")
    with_them = with_origins(nominal, origins_of(corrected))
    q = random_joint_values(corrected, 50, np.random.default_rng(1))
    np.testing.assert_allclose(with_them.poses(q), corrected.poses(q), rtol=0, atol=1e-12)
    assert np.abs(nominal.poses(q) - corrected.poses(q)).max() > 1e-3
    assert with_origins(nominal, origins_of(nominal)).urdf.data == nominal.urdf.data
    arm = Robot.from_urdf(nominal.urdf, "base", "tool0", held={"elbow_joint": 0.5})
    assert with_origins(arm, origins_of(arm)).held == {"elbow_joint": 0.5}
    with pytest.raises(UrdfError, match="joint"):
        with_origins(Robot.load("panda"), origins_of(corrected))


@pytest.mark.parametrize("name", ["yes", "null", "1.5", "a: b", "#", "it's", 'say "a"', "ü", "~"])
def test_names_that_yaml_would_take_for_something_else(name: str, tmp_path: Path, serial_urdf):
    urdf = serial_urdf([("revolute", (0, 0, 0.1), (0, 0, 0), (0, 0, 1))])
    quoted = name.replace('"', "&quot;").encode()
    robot = Robot.from_urdf(Urdf.from_bytes(urdf.data.replace(b'"j1"', b'"' + quoted + b'"'), "r"))
    read = read_origins(write_origins(robot, tmp_path / "o.yaml"))
    assert next(iter(read)) == name
    assert with_origins(robot, read) == robot


def test_a_list_of_numbers_does_too(tmp_path: Path):
    (tmp_path / "o.yaml").write_text("origins:\n  j: {xyz: [0, 0.1, 1e-05], rpy: [0.0, 0, -1]}\n")
    read = read_origins(tmp_path / "o.yaml")
    assert read == {"j": ((0.0, 0.1, 1e-5), (0.0, 0.0, -1.0))}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no section 'origins:'"),
        ('origins:\n  j: {xyz: "0 0 0"}\n', "joint 'j': xyz and rpy are wanted"),
        ('origins:\n  j: {xyz: "0 0", rpy: "0 0 0"}\n', r"three numbers \[m\]"),
        ('origins:\n  j: {xyz: "0 0 nan", rpy: "0 0 0"}\n', "three numbers"),
        ("origins: [\n", "cannot be read as YAML"),
    ],
)
def test_files_that_are_refused(text: str, said: str, tmp_path: Path):
    (tmp_path / "o.yaml").write_text(text)
    with pytest.raises(FileError, match=said):
        read_origins(tmp_path / "o.yaml")


def test_origins_of_some_of_the_joints(tmp_path):
    lines = (URDF / "ur3_origins.yaml").read_text().splitlines()
    path = tmp_path / "origins.yaml"
    path.write_text("\n".join(line for line in lines if "elbow_joint:" not in line) + "\n")
    on_ur3 = Options(robot=URDF / "ur3.urdf", base="base", tip="tool0")
    (note,) = KINDS["origins"].read(str(path), on_ur3).notes
    assert (note.code, note.values) == ("joints without origin", ("'elbow_joint'",))


def test_an_independent_reader_makes_the_corrected_robot_of_the_nominal_urdf(tmp_path: Path):
    path = tmp_path / "master_calibration.yaml"
    convert(URDF / "ur3_calibrated.urdf", path, to="pal", robot=URDF / "ur3.urdf")
    section = yaml.safe_load(path.read_text())["robot_state_publisher"]["geometric_calibration"]
    assert "elbow_dx" in section  # without '_joint'
    tree = ElementTree.parse(URDF / "ur3.urdf")
    used = set()
    for joint in tree.getroot().findall("joint"):
        origin = joint.find("origin")
        if origin is None:
            continue
        name = joint.get("name", "").removesuffix("_joint")
        for key, endings in (("xyz", ("dx", "dy", "dz")), ("rpy", ("droll", "dpitch", "dyaw"))):
            written = [float(word) for word in origin.get(key, "0 0 0").split()]
            names = [f"{name}_{ending}" for ending in endings]
            used |= {entry for entry in names if entry in section}
            sums = [
                old + section.get(entry, 0.0) for old, entry in zip(written, names, strict=True)
            ]
            origin.set(key, " ".join(map(repr, sums)))
    assert used == set(section)
    tree.write(tmp_path / "applied.urdf")
    models = [
        pin.buildModelFromUrdf(str(file))
        for file in (tmp_path / "applied.urdf", URDF / "ur3_calibrated.urdf")
    ]
    q = np.random.default_rng(3).uniform(-2, 2, (20, 6))
    poses = []
    for model in models:
        data = model.createData()
        tool = model.getFrameId("tool0")
        poses.append([])
        for values in q:
            pin.framesForwardKinematics(model, data, values)
            poses[-1].append(data.oMf[tool].homogeneous)
    np.testing.assert_allclose(poses[0], poses[1], rtol=0, atol=1e-9)


def test_changes_are_small_whatever_the_angles_are_written_as():
    rng = np.random.default_rng(5)
    for _ in range(200):
        origin = JointOrigin(tuple(rng.uniform(-1, 1, 3)), tuple(rng.uniform(-6, 6, 3)))
        change = rng.uniform(-1e-3, 1e-3, 6)
        moved = JointOrigin(
            tuple(np.add(origin.xyz, change[:3])), tuple(np.add(origin.rpy, change[3:]))
        )
        np.testing.assert_allclose(
            origin_change(origin, moved.T_parent_joint), change, rtol=0, atol=1e-9
        )


def test_a_right_angle_of_pitch_is_exact_though_not_small():
    origin = JointOrigin((0.0, 0.0, 0.0), (0.2, np.pi / 2, 0.1))
    T = origin.T_parent_joint
    T[:3, :3] = T[:3, :3] @ pin.exp3(np.array([1e-3, -2e-3, 3e-3]))
    numbers = dict(
        zip(("dx", "dy", "dz", "droll", "dpitch", "dyaw"), origin_change(origin, T), strict=True)
    )
    content = {"robot_state_publisher": {"geometric_calibration": {}}}
    content["robot_state_publisher"]["geometric_calibration"] = {
        f"a_{key}": float(value) for key, value in numbers.items()
    }
    result = with_pal_corrections({"a_joint": origin}, yaml.safe_dump(content).encode(), "f")
    np.testing.assert_allclose(result["a_joint"].T_parent_joint, T, rtol=0, atol=1e-9)


def test_what_is_missing_is_named(tmp_path: Path):
    with pytest.raises(CalibError, match="--robot"):
        convert(Robot.load("panda"), tmp_path / "m.yaml", to="pal")
    with pytest.raises(FileError, match="geometric_calibration"):
        with_pal_corrections({}, b"other: 1", "f")
