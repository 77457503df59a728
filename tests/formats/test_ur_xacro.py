"""A small xacro that reads a kinematics.yaml the way that Universal Robots' description for ROS 2 does.

Names of macros, arguments, properties, links and joints are those of the description; bodies and control are left out.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.formats.universal_robots import read_ur, write_ur_yaml
from calib.formats.ur_arms import LINKS
from calib.formats.ur_mount import the_mount
from calib.robot.robot import Robot
from tests.formats.ur_cases import WITH_DELTAS, rows, write_deltas

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
KEYS = ("x", "y", "z", "roll", "pitch", "yaw")
CALLED = '<?xml version="1.0"?>\n<robot xmlns:xacro="http://wiki.ros.org/xacro"{}>\n{}\n</robot>\n'


def _properties() -> str:
    """Each number of the file as a property of the caller."""
    return "\n".join(
        f"""<xacro:property name="{link}_{key}" value="${{sec_kinematics['{link}']['{key}']}}" scope="parent"/>"""
        for link in LINKS
        for key in KEYS
    )


def _joint(name: str, parent: str, child: str, link: str) -> str:
    """A joint whose origin is put together of the properties."""
    xyz, rpy = (" ".join(f"${{{link}_{key}}}" for key in keys) for keys in (KEYS[:3], KEYS[3:]))
    return (
        f'<link name="${{prefix}}{child}"/><joint name="${{prefix}}{name}_joint" type="revolute">'
        f'<parent link="${{prefix}}{parent}"/><child link="${{prefix}}{child}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="0 0 1"/>'
        '<limit lower="${-2 * pi}" upper="${2 * pi}" effort="150" velocity="3"/></joint>'
    )


def _fixed(parent: str, child: str, rpy: str) -> str:
    return (
        f'<link name="${{prefix}}{child}"/><joint name="${{prefix}}{parent}-{child}" type="fixed">'
        f'<parent link="${{prefix}}{parent}"/><child link="${{prefix}}{child}"/>'
        f'<origin xyz="0 0 0" rpy="{rpy}"/></joint>'
    )


COMMON = f"""<xacro:macro name="read_model_data" params="kinematics_parameters_file">
<xacro:property name="config_kinematics_parameters" value="${{xacro.load_yaml(kinematics_parameters_file)}}"/>
<xacro:property name="sec_kinematics" value="${{config_kinematics_parameters['kinematics']}}"/>
{_properties()}
<xacro:property name="kinematics_hash" value="${{sec_kinematics['hash']}}" scope="parent"/>
</xacro:macro>"""

BODIES = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
PARENTS = ("base_link_inertia", *(f"{body}_link" for body in BODIES))
ARM = "\n".join(
    [
        '<xacro:include filename="$(find ur_description)/urdf/inc/ur_common.xacro"/>',
        '<xacro:macro name="ur_robot" params="name prefix parent *origin kinematics_parameters_file">',
        '<xacro:read_model_data kinematics_parameters_file="${kinematics_parameters_file}"/>',
        '<ros2_control name="${name}" type="system"><hardware>',
        '<param name="kinematics/hash">${kinematics_hash}</param></hardware>',
        '<joint name="${prefix}elbow_joint"><state_interface name="position"/></joint></ros2_control>',
        '<link name="${prefix}base_link"/><joint name="${prefix}base_joint" type="fixed">',
        '<xacro:insert_block name="origin"/><parent link="${parent}"/><child link="${prefix}base_link"/></joint>',
        _fixed("base_link", "base_link_inertia", "0 0 ${pi}"),
        *(_joint(JOINTS[i], PARENTS[i], PARENTS[i + 1], LINKS[i]) for i in range(6)),
        _fixed("base_link", "base", "0 0 ${pi}"),
        _fixed("wrist_3_link", "flange", "0 ${-pi/2.0} ${-pi/2.0}"),
        _fixed("flange", "tool0", "${pi/2.0} 0 ${pi/2.0}"),
        "</xacro:macro>",
    ]
)

TOP = """<xacro:arg name="name" default="ur"/>
<xacro:include filename="$(find ur_description)/urdf/ur_macro.xacro"/>
<xacro:arg name="ur_type" default="ur5x"/>
<xacro:arg name="prefix" default=""/>
<xacro:arg name="kinematics_params" default="$(find ur_description)/config/$(arg ur_type)/default_kinematics.yaml"/>
<link name="world"/>
<xacro:ur_robot name="$(arg name)" prefix="$(arg prefix)" parent="world"
 kinematics_parameters_file="$(arg kinematics_params)"><origin xyz="0 0 0" rpy="0 0 0"/></xacro:ur_robot>"""


@pytest.fixture
def description(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The package's top xacro, as a repository that was only downloaded."""
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    monkeypatch.delenv("ROS_PACKAGE_PATH", raising=False)
    package = tmp_path / "Universal_Robots_ROS2_Description"
    (package / "urdf" / "inc").mkdir(parents=True)
    (package / "package.xml").write_text("<package><name>ur_description</name></package>")
    (package / "urdf" / "inc" / "ur_common.xacro").write_text(CALLED.format("", COMMON))
    (package / "urdf" / "ur_macro.xacro").write_text(CALLED.format("", ARM))
    top = package / "urdf" / "ur.urdf.xacro"
    top.write_text(CALLED.format(' name="$(arg name)"', TOP))
    return top


@pytest.mark.parametrize("case", WITH_DELTAS, ids=lambda case: case["name"])
def test_our_yaml_through_their_description_is_the_robot(case, description: Path, tmp_path: Path):
    source = read_ur(write_deltas(tmp_path / "c.conf", rows(case["delta"])), model=case["robot"])
    assert source.hash is not None
    path = tmp_path / "k.yaml"
    write_ur_yaml(source.robot, source.nominal, path, hash=source.hash)
    robot = Robot.load(f"{description} name:=ur kinematics_params:={path}", "base", "tool0")
    np.testing.assert_allclose(robot.poses(case["fk"]["q"]), case["fk"]["T"], rtol=0, atol=1e-9)
    assert source.hash.encode() in robot.urdf.data


def test_calibrated_and_nominal_are_one_xacro_with_two_files(description: Path, tmp_path: Path):
    """What is identified on the nominal xacro goes into a yaml that the same xacro takes: nothing is flattened away."""
    case = WITH_DELTAS[0]
    source = read_ur(write_deltas(tmp_path / "c.conf", rows(case["delta"])), model=case["robot"])
    config = description.parents[1] / "config" / case["robot"].lower()
    config.mkdir(parents=True)
    default = config / "default_kinematics.yaml"
    write_ur_yaml(source.nominal, source.nominal, default, hash=source.model.default_hash)
    words = f"{description} name:=ur prefix:=left_ ur_type:={case['robot'].lower()}"
    nominal = Robot.load(words, "left_base", "left_tool0")
    assert the_mount(nominal, source.model).nominal

    given = tmp_path / "given.yaml"
    write_ur_yaml(source.robot, source.nominal, given, hash=str(source.hash))
    corrected = read_ur(given, robot=nominal).robot
    ours = tmp_path / "ours.yaml"
    write_ur_yaml(corrected, nominal, ours, hash=str(source.hash))
    again = Robot.load(f"{words} kinematics_params:={ours}", "left_base", "left_tool0")
    np.testing.assert_allclose(again.poses(case["fk"]["q"]), case["fk"]["T"], rtol=0, atol=1e-9)
