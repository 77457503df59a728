"""Origins that stand in a xacro in numbers are corrected there; of others it is said who states them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.errors import UrdfError
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from calib.robot.xacro_file import XacroCall, flatten
from calib.robot.xacro_origins import corrected_xacro
from tests.robot.mujoco_truth import perturbed

LIMIT = '<limit lower="-2" upper="2" effort="1" velocity="1"/>'

#: Literal origins in the main file, in a macro of an included one, and in a block that a macro is given.
MAIN = f"""<?xml version="1.0"?>
<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="prefix" default="a_"/>
  <xacro:property name="reach" value="0.25"/>
  <xacro:include filename="parts/link.xacro"/>
  <link name="base"/>
  <joint name="$(arg prefix)pan" type="revolute">  <!-- literal -->
    <origin rpy='0 0 0.5'   xyz='0 0 0.2' />
    <parent link="base"/><child link="l1"/><axis xyz="0 0 1"/>{LIMIT}
  </joint>
  <link name="l1"/>
  <xacro:with_block name="$(arg prefix)lift" parent="l1" child="l2">
    <origin xyz="0.1 0 0.05"/>
  </xacro:with_block>
  <xacro:literal name="$(arg prefix)roll" parent="l2" child="l3"/>
  <joint name="$(arg prefix)bare" type="revolute">
    <parent link="l3"/><child link="l4"/><axis xyz="1 0 0"/>{LIMIT}
  </joint>
  <link name="l4"/>
  SLOT
</robot>
"""

PART = f"""<?xml version="1.0"?>
<robot xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:macro name="with_block" params="name parent child *origin">
    <joint name="${{name}}" type="revolute">
      <xacro:insert_block name="origin"/>
      <parent link="${{parent}}"/><child link="${{child}}"/><axis xyz="0 1 0"/>{LIMIT}
    </joint>
    <link name="${{child}}"/>
  </xacro:macro>
  <xacro:macro name="literal" params="name parent child">
    <joint name="${{name}}" type="revolute">
      <origin xyz="0.3 0 0" rpy="0 1.5707963267948966 0"/>
      <parent link="${{parent}}"/><child link="${{child}}"/><axis xyz="0 0 1"/>{LIMIT}
    </joint>
    <link name="${{child}}"/>
  </xacro:macro>
</robot>
"""


def written(folder: Path, slot: str = "") -> XacroCall:
    (folder / "parts").mkdir(exist_ok=True)
    (folder / "parts/link.xacro").write_text(PART)
    (folder / "arm.urdf.xacro").write_text(MAIN.replace("SLOT", slot))
    return XacroCall.parse(f"{folder / 'arm.urdf.xacro'} prefix:=b_")


def robot_of(call: XacroCall) -> Robot:
    return Robot.from_urdf(Urdf.from_bytes(flatten(call), call.name, call.path))


@pytest.mark.slow
def test_literal_origins_are_corrected_where_they_stand(tmp_path: Path):
    call = written(tmp_path)
    nominal = robot_of(call)
    corrected = perturbed(nominal, 3)
    files = corrected_xacro(call, nominal.urdf, corrected.urdf)
    main, part = tmp_path / "arm.urdf.xacro", tmp_path / "parts/link.xacro"
    assert set(files) == {main.resolve(), part.resolve()}
    before = {path: path.read_text().splitlines() for path in (main, part)}
    changed = []
    for path in (main, part):
        after = files[path.resolve()].decode().splitlines()
        assert len(after) == len(before[path])
        pairs = zip(before[path], after, strict=True)
        changed += [(path.stem, i) for i, (old, new) in enumerate(pairs, 1) if old != new]
        path.write_bytes(files[path.resolve()])
    assert changed == [("arm.urdf", 8), ("arm.urdf", 13), ("arm.urdf", 16), ("link", 12)]
    assert "<origin rpy='" in files[main.resolve()].decode()
    # Xacro itself makes the corrected robot of them, with other arguments too.
    again = robot_of(call)
    q = np.random.default_rng(4).uniform(-2.0, 2.0, (10, 4))
    np.testing.assert_allclose(again.poses(q), corrected.poses(q), rtol=0.0, atol=1e-14)
    assert robot_of(XacroCall(main)).joint_names[0] == "a_pan"


@pytest.mark.slow
def test_who_states_an_origin_is_named_with_the_value_it_needs(tmp_path: Path):
    slot = (
        '<xacro:macro name="far" params="name d:=0.4"><joint name="${name}" type="revolute">\n'
        '<origin xyz="${reach} 0 ${d + 0.1}"/><parent link="l4"/><child link="l5"/>'
        f'<axis xyz="0 1 0"/>{LIMIT}</joint><link name="l5"/></xacro:macro>\n<xacro:far name="far"/>'
    )
    call = written(tmp_path, slot)
    nominal = robot_of(call)
    placements = nominal.placements.copy()
    placements[4, :3, 3] += [0.001, 0.002, 0.003]
    corrected = nominal.with_placements(placements)
    with pytest.raises(UrdfError) as refused:
        corrected_xacro(call, nominal.urdf, corrected.urdf)
    x, y, z = corrected.urdf.joint("far").xyz.tolist()
    text = str(refused.value)
    assert "arm.urdf.xacro, line 21, joint 'far'" in text
    assert f"${{reach}} (property reach: arm.urdf.xacro, line 4) needs to be {x!r}" in text
    assert f"0 needs to be {y!r}" in text
    assert f"${{d + 0.1}} (parameter d of far: arm.urdf.xacro, line 20) needs to be {z!r}" in text

    # Without a change of that joint the others can be written.
    placements = nominal.placements.copy()
    placements[0, :3, 3] += 0.001
    only_first = nominal.with_placements(placements)
    assert len(corrected_xacro(call, nominal.urdf, only_first.urdf)) == 1


def test_a_literal_of_a_macro_that_is_called_twice_has_one_place_for_two(tmp_path: Path):
    call = written(tmp_path, '<xacro:literal name="other" parent="l4" child="l5"/>')
    nominal = robot_of(call)
    with pytest.raises(UrdfError) as refused:
        corrected_xacro(call, nominal.urdf, perturbed(nominal, 3).urdf)
    text = str(refused.value)
    assert text.count("one origin stands for 2 joints") == 2
    assert "link.xacro, line 12, joint 'b_roll'" in text


def test_another_xacro_is_refused(tmp_path: Path):
    call = written(tmp_path)
    nominal = robot_of(call)
    other = XacroCall(call.path, (("prefix", "c_"),))
    with pytest.raises(UrdfError, match="'b_pan'"):
        corrected_xacro(other, nominal.urdf, perturbed(nominal, 3).urdf)


def test_nothing_changes_no_file(tmp_path: Path):
    call = written(tmp_path)
    urdf = robot_of(call).urdf
    assert corrected_xacro(call, urdf, urdf) == {}
