"""Corrections for PAL's robots: added to the origins as written they give the corrected robot."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
import yaml

from calib.errors import CalibError, FileError
from calib.robot.robot import Robot
from calib.verbs.convert.convert import convert
from calib.verbs.convert.origins import JointOrigin
from calib.verbs.convert.pal import applied, origin_change
from tests.places import ROOT

URDF = ROOT / "urdf"


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
    result = applied({"a_joint": origin}, yaml.safe_dump(content).encode(), "f")
    np.testing.assert_allclose(result["a_joint"].T_parent_joint, T, rtol=0, atol=1e-9)


def test_what_is_missing_is_named(tmp_path: Path):
    with pytest.raises(CalibError, match="--robot"):
        convert(Robot.load("panda"), tmp_path / "m.yaml", to="pal")
    with pytest.raises(FileError, match="geometric_calibration"):
        applied({}, b"other: 1", "f")
