"""Shared by the tests here: every URDF of example-robot-data, small ones, and poses by Pinocchio's own model."""

from __future__ import annotations

import importlib.metadata
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from calib.robot.robot import Robot
from calib.robot.urdf import Urdf

LIMIT = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'
FILES = sorted(
    Path(str(file.locate()))
    for file in importlib.metadata.files("example-robot-data") or []
    if file.suffix == ".urdf" and file.name not in ("quadrotor_base.urdf", "ur3.urdf")
)
#: A few in each run, all of them in the slow one; without joints that move a robot has no chain.
SOME_AND_SLOWLY_ALL = [
    pytest.param(
        p, marks=() if i % 12 == 0 else pytest.mark.slow, id=f"{p.parents[1].name}-{p.stem}"
    )
    for i, p in enumerate(FILES)
    if p.name != "iris_simple.urdf"
]


def joint(
    name: str,
    parent: str,
    child: str,
    kind: str = "revolute",
    axis: str = "0 0 1",
    mimic: str = "",
) -> str:
    """A joint with an origin and a skew frame; ``mimic`` are the attributes of its <mimic>."""
    inside = f"<mimic {mimic}/>" if mimic else ""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0.1 0.2 0.3" rpy="0.1 0.3 0.2"/><axis xyz="{axis}"/>{LIMIT}{inside}</joint>'
    )


def urdf_of(links: str, *joints: str) -> Urdf:
    """A URDF of links, named in one text, and joints."""
    text = "".join(f'<link name="{link}"/>' for link in links.split())
    return Urdf.from_bytes(f'<robot name="r">{text}{"".join(joints)}</robot>'.encode(), "r.urdf")


def random_q(robot: Robot, count: int = 4, seed: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1, 1, (count, len(robot.joint_names)))


def by_pinocchio(robot: Robot, q: np.ndarray, *, mimic: bool = False) -> np.ndarray:
    """T_base_tip from the full model of the URDF, nothing locked or merged; ``mimic``: by Pinocchio's own followers."""
    model = pin.buildModelFromXML(robot.urdf.data.decode(robot.urdf.encoding), mimic=mimic)
    data = model.createData()
    ends = [model.getFrameId(link, pin.FrameType.BODY) for link in (robot.base, robot.tip)]
    names = robot.joint_names if mimic else [joint.name for joint in robot.joints]
    poses = []
    for values in q if mimic else robot.chain_values(q):
        v = np.zeros(model.nv)
        for name, value in zip(names, values, strict=True):
            v[model.idx_vs[model.getJointId(name)]] = value
        pin.framesForwardKinematics(model, data, pin.integrate(model, pin.neutral(model), v))
        poses.append((data.oMf[ends[0]].inverse() * data.oMf[ends[1]]).homogeneous)
    return np.array(poses)


def displaced(robot: Robot, places: tuple[int, ...] = (), size: float = 5e-3) -> Robot:
    """The robot with some placements displaced: those named, or all that a URDF joint carries."""
    rng = np.random.default_rng(5)
    placements = robot.placements.copy()
    for i in places or [i for i, carrier in enumerate(robot.carriers) if carrier is not None]:
        placements[i] = placements[i] @ pin.exp6(rng.normal(0, size, 6)).homogeneous
    return robot.with_placements(placements)
