"""Every robot of example-robot-data out and in again: written, read by Pinocchio, by yourdfpy and by check_urdf."""

from __future__ import annotations

import importlib.metadata
import logging
import subprocess
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yourdfpy

from calib.basics.arrays import rigid_inverse
from calib.errors import UrdfError
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf

FILES = sorted(
    Path(str(file.locate()))
    for file in importlib.metadata.files("example-robot-data") or []
    if file.suffix == ".urdf"
)

#: In every run: fixed, sliding, mimicking and endlessly turning joints.
FEW = ("panda.urdf", "tiago.urdf", "double_pendulum_continuous.urdf")

#: Corrections [m, rad]: of a calibration, of another robot, and hardly any.
SIZES = ((0.5e-3, 3e-3), (0.2, 3.0), (1e-7, 1e-7))


def corrected(robot: Robot, rng: np.random.Generator, length: float, angle: float) -> Robot:
    """The robot with every placement moved that an <origin> carries."""
    placements = robot.placements.copy()
    for i, carrier in enumerate(robot.carriers):
        if carrier is not None:
            placements[i, :3, 3] += length * rng.normal(size=3)
            placements[i, :3, :3] = placements[i, :3, :3] @ pin.exp3(angle * rng.normal(size=3))
    return robot.with_placements(placements)


def by_pinocchio(path: Path, robot: Robot, q: np.ndarray) -> np.ndarray:
    """T_base_tip of a file as Pinocchio reads it, shape (N, 4, 4)."""
    model = pin.buildModelFromUrdf(str(path))
    data = model.createData()
    base, tip = (model.getFrameId(name, pin.FrameType.BODY) for name in (robot.base, robot.tip))
    poses = np.empty((len(q), 4, 4))
    for n in range(len(q)):
        configuration = pin.neutral(model)
        for name, value in robot.urdf_values(q).items():
            joint = model.joints[model.getJointId(name)]
            configuration[joint.idx_q : joint.idx_q + joint.nq] = (
                (np.cos(value[n]), np.sin(value[n])) if joint.nq == 2 else value[n]
            )
        pin.framesForwardKinematics(model, data, configuration)
        poses[n] = rigid_inverse(data.oMf[base].homogeneous) @ data.oMf[tip].homogeneous
    return poses


def by_yourdfpy(path: Path, robot: Robot, q: np.ndarray) -> np.ndarray:
    """T_base_tip of a file as yourdfpy reads it, shape (N, 4, 4)."""
    logging.getLogger("yourdfpy.urdf").disabled = True
    none = {"load_meshes": False, "load_collision_meshes": False}
    model = yourdfpy.URDF.load(str(path), build_scene_graph=False, **none).robot
    for joint in model.joints:  # each is given its value
        joint.mimic = None
    free = yourdfpy.URDF(model, **none)
    names = [joint.name for joint in robot.joints]
    poses = np.empty((len(q), 4, 4))
    for n, chain in enumerate(robot.chain_values(q)):
        values = dict(zip(names, chain, strict=True))
        for name in names:  # yourdfpy slides by q times the axis as it is written
            if free.joint_map[name].type == "prismatic":
                values[name] /= np.linalg.norm(free.joint_map[name].axis)
        free.update_cfg(values)
        poses[n] = rigid_inverse(free.get_transform(robot.base)) @ free.get_transform(robot.tip)
    return poses


def accepts(path: Path) -> bool:
    """Whether check_urdf, which comes with Pinocchio, reads a file."""
    program = Path(sys.executable).with_name("check_urdf")
    done = subprocess.run([program, path], capture_output=True, timeout=60, check=False)
    return done.returncode == 0 and b"Successfully Parsed" in done.stdout


def test_all_are_there():
    assert len(FILES) > 60
    assert set(FEW) <= {path.name for path in FILES}


@pytest.mark.parametrize(
    "path",
    [pytest.param(path, marks=() if path.name in FEW else pytest.mark.slow) for path in FILES],
    ids=lambda path: f"{path.parents[1].name}/{path.name}",
)
def test_a_robot_out_and_in_again(path, tmp_path):
    written = tmp_path / "written.urdf"
    try:
        urdf = Urdf.read(path)
        urdf.write(written)
        assert written.read_bytes() == path.read_bytes()
        robot = Robot.from_urdf(urdf)
    except UrdfError:  # no chain of moving joints in it
        return
    origins = {joint.name: joint.T_parent_joint for joint in urdf.joints}
    assert urdf.with_origins(origins).data == urdf.data
    q = random_joint_values(robot, 5, seed=0)
    readable = accepts(path)
    for seed, size in enumerate(SIZES):
        moved = corrected(robot, np.random.default_rng(seed), *size)
        moved.urdf.write(written, overwrite=True)
        expected = moved.poses(q)
        np.testing.assert_allclose(by_pinocchio(written, moved, q), expected, atol=1e-9, rtol=0)
        np.testing.assert_allclose(by_yourdfpy(written, moved, q), expected, atol=1e-9, rtol=0)
        assert accepts(written) or not readable
