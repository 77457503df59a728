"""What a URDF states of its joints: missing limits, millimetres and degrees, each with its place and remedy."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest

from calib.errors import UrdfError
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf, robot_data_urdfs

LINE = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'
ARM = f"""<robot name="r">
<link name="a"/><link name="b"/><link name="c"/>
<joint name="j" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0 0 0.3" rpy="0 1.57 0"/>
{LINE}
</joint>
<joint name="k" type="prismatic"><parent link="b"/><child link="c"/><origin xyz="0.2 0 0" rpy="0 0 0"/>
<limit lower="0" upper="0.5" effort="1" velocity="1"/>
</joint>
</robot>
"""


def refused(text: str, *parts: str) -> None:
    """The URDF is refused with all of these parts in its message."""
    with pytest.raises(UrdfError) as caught:
        Urdf.from_bytes(text.encode(), "r.urdf")
    assert all(part in str(caught.value) for part in parts), str(caught.value)


def test_a_joint_without_a_limit_is_named_with_its_line_and_what_to_write():
    refused(
        ARM.replace(LINE, ""), "r.urdf, line 3: joint 'j'", '<limit lower="-3.14"', "continuous"
    )
    sliding = re.sub('<limit lower="0".*/>', "", ARM)
    refused(sliding, "r.urdf, line 6: joint 'k'", "prismatic", "in m")


@pytest.mark.parametrize("key", ["effort", "velocity"])
@pytest.mark.parametrize("value", ["", "-1.0", "fast", "inf"])
def test_efforts_and_velocities_are_read_over(key: str, value: str):
    written = f' {key}="{value}"' if value else ""
    urdf = Urdf.from_bytes(ARM.replace(f' {key}="1"', written).encode(), "r.urdf")
    assert (urdf.joint("j").lower, urdf.joint("j").upper) == (-1.0, 1.0)
    assert Robot.from_urdf(urdf).joint_names == ("j", "k")


def test_a_limit_without_ends_is_a_joint_without_ends():
    text = ARM.replace(LINE, '<limit effort="0" velocity="0"/>')
    joint = Urdf.from_bytes(text.encode(), "r.urdf").joint("j")
    assert (joint.lower, joint.upper) == (None, None)


def scaled(text: str, tag: str, key: str, factor: float) -> str:
    """The numbers of an attribute times a factor, wherever the tag stands."""

    def numbers(found: re.Match[str]) -> str:
        words = [repr(float(word) * factor) for word in found[2].split()]
        return f'{found[1]}{" ".join(words)}"'

    return re.sub(rf'(<{tag}\b[^>]*\b{key}=")([^"]*)"', numbers, text)


def in_millimetres(text: str) -> str:
    return scaled(text, "origin", "xyz", 1e3)


def in_degrees(text: str) -> str:
    turn = 180.0 / np.pi
    return scaled(text, "origin", "rpy", turn)


@pytest.mark.parametrize(
    ("spoil", "said"), [(in_millimetres, "millimetres"), (in_degrees, "degrees")]
)
@pytest.mark.parametrize("name", ["ur3_robot", "panda", "tiago_dual", "so101"])
def test_real_robots_in_other_units_are_refused(name: str, spoil: Callable[[str], str], said: str):
    text = robot_data_urdfs()[f"{name}.urdf"].read_text(encoding="utf-8")
    refused(spoil(re.sub("<!--.*?-->", "", text, flags=re.DOTALL)), said)


def test_limits_in_degrees_are_named_and_placeholders_are_not():
    for ends in ((-170, 170), (0, 360), (-90, 90)):
        text = ARM.replace('lower="-1" upper="1"', f'lower="{ends[0]}" upper="{ends[1]}"')
        refused(text, "line 3: joint 'j'", "these look like degrees")
    for ends in (
        (-100, 100),
        (-1e16, 1e16),
        (-12.566, 12.566),
        (-9.42, 9.42),
        (-10, 10),
        (-31.4, 31.4),
    ):
        text = ARM.replace('lower="-1" upper="1"', f'lower="{ends[0]}" upper="{ends[1]}"')
        assert Urdf.from_bytes(text.encode(), "r.urdf").joint("j").upper == ends[1]


def test_a_robot_far_from_its_origin_is_no_robot_in_millimetres():
    placed = ARM.replace("0 0 0.3", "0 0 0.3", 1).replace("0.2 0 0", "1500 0 0")
    text = placed.replace(
        "</robot>",
        '<link name="d"/><joint name="l" type="fixed"><parent link="c"/><child link="d"/>'
        '<origin xyz="0 0 0.1"/></joint></robot>',
    )
    assert Urdf.from_bytes(text.encode(), "r.urdf").joint("k").xyz[0] == 1500.0


@pytest.mark.slow
def test_no_robot_of_example_robot_data_is_taken_for_one_in_other_units():
    without_joints = {"quadrotor_base.urdf", "ur3.urdf"}
    paths = {name: path for name, path in robot_data_urdfs().items() if name not in without_joints}
    assert len(paths) > 60
    assert all(Urdf.read(path).joints for path in paths.values())
