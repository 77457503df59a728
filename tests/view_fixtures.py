"""A real robot, one that was calibrated to the paper's size of errors, and a view of both."""

import base64
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import umsgpack

from calib import example
from calib.data.measurements import Measurements
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from calib.show.scene.posed_robot import translation
from calib.verbs.view.robots_page import view_page
from calib.verbs.view.view import Measured, View
from tests import hard_cases

#: A gantry with a turning wrist: prismatic and continuous joints, no visuals, its base not at the root.
GANTRY = """<robot name="gantry">
  <link name="floor"/><link name="rail"/><link name="bridge"/><link name="carriage"/><link name="hand"/>
  <link name="tip"/>
  <joint name="mount" type="fixed">
    <parent link="floor"/><child link="rail"/><origin xyz="1 2 3" rpy="0.1 0.2 0.3"/>
  </joint>
  <joint name="x" type="prismatic">
    <parent link="rail"/><child link="bridge"/><origin xyz="0 0 0.5"/><axis xyz="1 0 0"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/>
  </joint>
  <joint name="y" type="prismatic">
    <parent link="bridge"/><child link="carriage"/><origin xyz="0.3 0.1 0"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/>
  </joint>
  <joint name="c" type="continuous">
    <parent link="carriage"/><child link="hand"/><origin xyz="0 0.2 0.4"/><axis xyz="0 0 1"/>
  </joint>
  <joint name="flange" type="fixed">
    <parent link="hand"/><child link="tip"/><origin xyz="0.2 0 0"/>
  </joint>
</robot>
"""


def scene_of(page) -> dict:
    """The scene's message in a page."""
    text = re.search(rb'id="scene">([^<]*)<', page.html).group(1)
    return umsgpack.unpackb(base64.b64decode(text))


def with_points(view: View, points: np.ndarray) -> View:
    """The view with measured points, shape (N, 3)."""
    measured = view.measured or Measured(points)
    return replace(view, measured=replace(measured, points=points))


def registered(view: View, T_base_nominal: np.ndarray) -> View:
    """The view with the nominal robot's base registered at a pose, (4, 4), in the calibrated one's."""
    measured = view.measured or Measured(view.points)
    bases = np.broadcast_to(T_base_nominal, (len(view.q), 4, 4))
    return replace(view, measured=replace(measured, T_base_nominal=bases))


def disturbed(robot: Robot, scale: float = 1.0) -> Robot:
    """The robot with some 2 mm and 4 mrad at each joint."""
    rng = np.random.default_rng(7)
    placements = robot.placements.copy()
    for i, carrier in enumerate(robot.carriers):
        if carrier is not None:
            twist = rng.normal(size=6) * np.repeat([2e-3, 4e-3], 3)
            placements[i] = placements[i] @ pin.exp6(scale * twist).homogeneous
    return robot.with_placements(placements)


@pytest.fixture(scope="session")
def calibrations():
    """The module of hard cases: ``calibrations.made("poses")``."""
    return hard_cases


@pytest.fixture(scope="session")
def paper_calibration(calibrations):
    """The demo's."""
    return calibrations.made("paper")


@pytest.fixture(scope="session")
def panda_with_hand():
    return Robot.load("panda", tip="panda_hand")


@pytest.fixture(scope="session")
def gantry():
    return Robot.from_urdf(Urdf.from_bytes(GANTRY.encode(), "gantry.urdf"), "rail", "tip")


@pytest.fixture(scope="session")
def fingers():
    """From one finger to the other, which mimics it: two joints, one column."""
    return Robot.load("panda", "panda_hand", "panda_rightfinger")


@pytest.fixture(scope="session")
def disturb():
    return disturbed


@pytest.fixture(scope="session")
def ur3_view(ur3):
    m = Measurements.read(example.paper_measurements(), ur3.joint_names, ur3.joint_types)
    target = translation(example.PAPER_TARGET)
    view = View(
        ur3,
        disturbed(ur3, 0.5),
        m.joints_for(ur3.joint_names),
        labels=tuple(f"row {row}" for row in m.rows),
        kinds=("estimation",) * 30 + ("validation",) * 5,
        nominal_target=target,
        calibrated_target=target,
        start=30,
    )
    errors = {"m": np.linalg.norm(m.points - view.predicted, axis=2)}
    return replace(view, measured=Measured(m.points, errors))


@pytest.fixture(scope="session")
def ur3_page(ur3_view):
    return view_page(ur3_view)


@pytest.fixture
def with_mesh(tmp_path: Path):
    """A URDF of one joint whose first link shows a mesh of that name; read from ``tmp_path/robot``."""

    def make(filename: str, visual: str = "") -> Urdf:
        text = f"""<robot name="r">
          <link name="a">
            <visual><geometry><mesh filename="{filename}" scale="2 2 2"/></geometry></visual>{visual}
          </link>
          <link name="b"><visual><geometry><box size="0.1 0.2 0.3"/></geometry></visual></link>
          <joint name="j" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0 0 1"/>
            <axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
        </robot>"""
        folder = tmp_path / "robot"
        folder.mkdir(exist_ok=True)
        (folder / "r.urdf").write_text(text, encoding="utf-8")
        return Urdf.read(folder / "r.urdf")

    return make


def moved(scene: dict, pattern: str) -> np.ndarray:
    """The transforms of some nodes, shape (N, 4, 4)."""
    found = [
        np.array(c["matrix"]).reshape(4, 4).T
        for c in scene["commands"]
        if c["type"] == "set_transform" and re.fullmatch(f"/robots/{pattern}", c["path"])
    ]
    return np.array(found)


def positions(scene: dict, node: str) -> np.ndarray:
    """The points of a cloud or of lines, shape (N, 3)."""
    (command,) = [
        c for c in scene["commands"] if c["type"] == "set_object" and c["path"] == f"/robots/{node}"
    ]
    (name,) = command["object"]["geometries"]
    packed = scene["geometries"][name]["data"]["attributes"]["position"]["array"]
    return np.frombuffer(packed.data, dtype="<f4").reshape(-1, 3).astype(float)
