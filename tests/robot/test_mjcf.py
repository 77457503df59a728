"""MJCFs with one trap each are read as MuJoCo reads them; what calib cannot take is refused with its place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from calib.errors import CalibError, FileError, UrdfError
from calib.robot.full_model import full_configurations, full_model, link_frame
from calib.robot.mjcf import Mjcf
from calib.robot.mjcf_urdf import urdf_names
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf, read_urdf
from tests.robot.mujoco_truth import MODELS, Truth, product

TRAPS = sorted(MODELS.glob("*.xml"))
BODY = '<body name="a" pos="0 0 1"><joint name="j" range="-90 90"/><geom size="1"/>{}</body>'


def written(folder: Path, world: str, before: str = "", after: str = "") -> Path:
    path = folder / "m.xml"
    path.write_text(f"<mujoco>\n{before}\n<worldbody>\n{world}\n</worldbody>\n{after}\n</mujoco>\n")
    return path


def test_there_are_ten_traps() -> None:
    assert len(TRAPS) == 10


@pytest.mark.parametrize("path", TRAPS, ids=lambda path: path.stem)
def test_all_bodies_and_sites_are_where_mujoco_has_them(path: Path):
    truth = Truth(path)
    model = Mjcf.read(path)
    urdf = read_urdf(path)
    joints = [joint.name for body in model.bodies for joint in body.joints]
    assert len(joints) == truth.model.njnt
    assert len(model.bodies) == truth.model.nbody - 1
    assert len(model.sites) == truth.model.nsite
    pinocchio = full_model(urdf)
    data = pinocchio.createData()
    _, _, site_links = urdf_names(model)
    named = {body.name: body.name for body in model.bodies if "name" in body.node.attributes}
    named |= {
        site.name: site_links[site.name]
        for site in model.sites
        if "name" in site.node.attributes and site.name not in named
    }
    rng = np.random.default_rng(1)
    for _ in range(20):
        values = {number: rng.uniform(-2.0, 2.0) for number in truth.turning_and_sliding}
        truth.move(values)
        by_name = {joints[number]: np.array([value]) for number, value in values.items()}
        configuration = full_configurations(pinocchio, by_name)[0]
        pin.forwardKinematics(pinocchio, data, configuration)
        pin.updateFramePlacements(pinocchio, data)
        for name, link in named.items():
            T = data.oMf[link_frame(pinocchio, link)].homogeneous
            np.testing.assert_allclose(T, truth.pose(name), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("path", [p for p in TRAPS if p.stem != "beside"], ids=lambda p: p.stem)
def test_the_default_chain_has_mujocos_poses_and_limits(path: Path):
    robot = Robot.load(path)
    truth = Truth(path)
    names = list(robot.joint_names)
    assert len(names) == truth.model.njnt
    q = np.random.default_rng(2).uniform(-2.0, 2.0, (30, len(names)))
    poses = truth.poses(names, q, robot.base, robot.tip)
    np.testing.assert_allclose(robot.poses(q), poses, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(product(robot, q), poses, rtol=0.0, atol=1e-12)
    for joint in robot.joints:
        number = truth.model.joint(joint.name).id
        if truth.model.jnt_limited[number]:
            limits = (joint.lower, joint.upper)
            np.testing.assert_allclose(limits, truth.model.jnt_range[number], rtol=1e-14)
        else:
            assert joint.lower is None
            assert joint.type in ("continuous", "prismatic")


def test_names_are_made_where_there_are_none_and_a_site_gives_way_to_a_body():
    urdf = read_urdf(MODELS / "beside.xml")
    robot = Robot.load(MODELS / "beside.xml")
    assert robot.joint_names == ("joint_3", "wrist")
    assert robot.tip == "hand_site"
    assert "body_1" in urdf.links
    assert urdf.joint("joint_1").type == "floating"
    assert urdf.joint("joint_2").type == "floating"


def test_a_coupled_finger_mimics_by_values_not_by_moves_from_ref():
    right = read_urdf(MODELS / "beside.xml").joint("right")
    assert (right.mimic, right.mimic_multiplier) == ("left", -1.0)
    # q - 0.01 = 0.002 - (q_left - 0)
    assert right.mimic_offset == pytest.approx(0.012, abs=1e-15)


def test_masses_are_those_of_inertial_and_unknown_ones_take_all_with_them(tmp_path: Path):
    world = (
        '<body name="a"><joint name="j"/><inertial pos="0 0 0.1" mass="2" diaginertia="1 1 1"/>{}'
        '<frame pos="0.1 0 0"><body name="b" pos="0.2 0 0"><joint name="k"/>'
        '<inertial pos="0 0.3 0" mass="3" diaginertia="1 1 1"/></body></frame></body>'
    )
    known = read_urdf(written(tmp_path, world.format('<geom size="1"/>')))
    assert known.mjcf is not None
    assert known.mjcf.mass_of_geoms == ()
    inertias = [i for i in full_model(known).inertias if i.mass]
    assert [i.mass for i in inertias] == [2.0, 3.0]
    np.testing.assert_allclose([i.lever for i in inertias], [[0, 0, 0.1], [0, 0.3, 0]], atol=1e-15)

    with_geom = world.format('<body name="c" pos="0 0 1"><geom size="1"/></body>')
    unknown = read_urdf(written(tmp_path, with_geom))
    assert unknown.mjcf is not None
    assert unknown.mjcf.mass_of_geoms == ("c",)
    assert not any(i.mass for i in full_model(unknown).inertias)

    massless = world.format('<body name="c" pos="0 0 1"><geom size="1" mass="0"/></body>')
    seen = read_urdf(written(tmp_path, massless)).mjcf
    assert seen is not None
    assert seen.mass_of_geoms == ()

    of_geoms = written(
        tmp_path, world.format('<geom size="1"/>'), '<compiler inertiafromgeom="true"/>'
    )
    seen = read_urdf(of_geoms).mjcf
    assert seen is not None
    assert seen.mass_of_geoms == ("a",)


REFUSED = {
    "replicate with bodies": (f"<replicate count='2'>{BODY}</replicate>", "", ""),
    "attach": (f'{BODY}<attach model="x" body="y" prefix="z"/>', "", ""),
    "joint in the world": ("<joint name='j'/>", "", ""),
    "type": (BODY.replace('name="j"', 'name="j" type="screw"'), "", ""),
    "two names": (BODY + BODY.replace('"j"', '"k"'), "", ""),
    "two orientations": (
        BODY.replace("<joint", '<frame quat="1 0 0 0" euler="0 0 1"/><joint'),
        "",
        "",
    ),
    "quat zero": (BODY.format('<body quat="0 0 0 0"/>'), "", ""),
    "axis zero": (BODY.replace('name="j"', 'name="j" axis="0 0 0"'), "", ""),
    "two numbers": (BODY.format('<body pos="1 2"/>'), "", ""),
    "commas": (BODY.format('<body pos="1, 2, 3"/>'), "", ""),
    "not a number": (BODY.format('<body pos="1 2 nan"/>'), "", ""),
    "class": (BODY.replace('name="j"', 'name="j" class="nowhere"'), "", ""),
    "autolimits": (BODY, '<compiler autolimits="false"/>', ""),
    "global": (BODY, '<compiler coordinate="global"/>', ""),
    "angle": (BODY, '<compiler angle="grad"/>', ""),
    "eulerseq": (BODY, '<compiler eulerseq="xyw"/>', ""),
    "nested default": (BODY, "<default><default/></default>", ""),
    "coupled to nothing": (BODY, "", '<equality><joint joint1="j" joint2="x"/></equality>'),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_mujoco_or_calib_cannot_take_is_refused_with_file_line_and_element(
    name: str, tmp_path: Path
):
    world, before, after = REFUSED[name]
    path = written(tmp_path, world.replace("{}", ""), before, after)
    line = 4
    if before and name != "autolimits":
        line = 2
    if after:
        line = 6
    with pytest.raises(UrdfError, match=rf"^m\.xml, line {line}: <"):
        read_urdf(path)


def test_what_repeats_no_body_is_read_over(tmp_path: Path):
    lights = '<replicate count="4"><light/><site/><frame><geom size="1"/></frame></replicate>'
    assert Robot.load(written(tmp_path, BODY + lights.replace("{}", ""))).joint_names == ("j",)


def test_a_chain_over_a_ball_or_a_curved_coupling_is_refused_by_name(tmp_path: Path):
    inner = (
        '<body name="b"><joint name="k" type="ball"/><body name="c"><joint name="l"/></body></body>'
    )
    path = written(tmp_path, BODY.format(inner))
    assert Robot.load(path).tip == "a"
    with pytest.raises(UrdfError, match=r"m\.xml, line 4: joint 'k'"):
        Robot.load(path, tip="c")

    inner = '<body name="b"><joint name="k"/></body>'
    curve = '<equality><joint joint1="k" joint2="j" polycoef="0 1 0.5 0 0"{}/></equality>'
    path = written(tmp_path, BODY.format(inner), "", curve.format(""))
    with pytest.raises(UrdfError, match=r"m\.xml, line 6: joint 'k'"):
        Robot.load(path, tip="b")
    path = written(tmp_path, BODY.format(inner), "", curve.format(' active="false"'))
    assert Robot.load(path, tip="b").joint_names == ("j", "k")
    still = '<equality><joint joint1="k"/></equality>'
    path = written(tmp_path, BODY.format(inner), "", still)
    with pytest.raises(UrdfError, match=r"m\.xml, line 6: joint 'k'"):
        Robot.load(path, tip="b")


def test_a_site_that_versions_of_mujoco_turn_differently_is_no_tip(tmp_path: Path):
    inner = '<site name="s" class="c" {}="1 0 0 0"/><site name="t"/>'
    before = '<default><default class="c"><site {}="1 0 0 20"/></default></default>'
    path = written(tmp_path, BODY.format(inner.format("quat")), before.format("axisangle"))
    assert Robot.load(path, tip="t").tip == "t"
    with pytest.raises(UrdfError, match=r"m\.xml, line 4: site 's'"):
        Robot.load(path, tip="s")
    for own, general in (("quat", "quat"), ("axisangle", "axisangle"), ("axisangle", "quat")):
        path = written(tmp_path, BODY.format(inner.format(own)), before.format(general))
        assert Robot.load(path, tip="s").tip == "s"


def test_an_arm_on_a_free_body_wants_a_base(tmp_path: Path):
    inner = BODY.format("")
    path = written(tmp_path, f'<body name="cart"><freejoint/>{inner}</body>')
    with pytest.raises(UrdfError, match="--base"):
        Robot.load(path)
    assert Robot.load(path, base="cart").joint_names == ("j",)


def test_includes_are_found_from_the_main_file_first_and_once_only(tmp_path: Path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub/a.xml").write_text('<mujoco><include file="b.xml"/></mujoco>')
    for folder, height in (("sub", 3), (".", 4)):
        (tmp_path / folder / "b.xml").write_text(
            f'<mujoco><body name="b" pos="0 0 {height}"><joint/><geom size="1"/></body></mujoco>'
        )
    path = written(tmp_path, '<include file="sub/a.xml"/>')
    found = Mjcf.read(path).bodies[0].T_parent_own[2, 3]
    assert found == 4.0
    truth = Truth(path)
    truth.move({})
    assert truth.pose("b")[2, 3] == found
    (tmp_path / "b.xml").unlink()
    assert Mjcf.read(path).bodies[0].T_parent_own[2, 3] == 3.0
    twice = written(tmp_path, '<include file="sub/a.xml"/><include file="sub/a.xml"/>')
    with pytest.raises(UrdfError, match=r"m\.xml, line 4"):
        read_urdf(twice)
    with pytest.raises(FileError, match=r"m\.xml, line 4"):
        read_urdf(written(tmp_path, '<include file="nowhere.xml"/>'))
    with pytest.raises(UrdfError, match=r"m\.xml, line 4"):
        read_urdf(written(tmp_path, "<include/>"))


def test_a_urdf_may_still_be_called_xml_and_sdf_is_refused_in_one_line(tmp_path: Path, ur3: Robot):
    path = tmp_path / "robot.xml"
    path.write_bytes(ur3.urdf.data)
    assert read_urdf(path) == ur3.urdf
    for name in ("world.sdf", "world.xml"):
        (tmp_path / name).write_text('<sdf version="1.9"><model name="m"/></sdf>')
        with pytest.raises(UrdfError, match="sdf2mjcf") as refused:
            read_urdf(tmp_path / name)
        assert "\n" not in str(refused.value)


def test_a_model_without_joints_is_refused(tmp_path: Path):
    with pytest.raises(CalibError, match="no body of it has a joint"):
        read_urdf(written(tmp_path, "<body/>"))


def test_the_urdf_states_its_mjcf_also_in_a_result():
    urdf = read_urdf(MODELS / "ref.xml")
    again = Urdf.from_bytes(urdf.data, "x")
    assert again.mjcf == urdf.mjcf
    assert again.mjcf is not None
    assert again.mjcf.file == "ref.xml"
    spoiled = urdf.data.replace(b'"sha256"', b'"sha"')
    with pytest.raises(UrdfError, match="was changed"):
        _ = Urdf.from_bytes(spoiled, "x").mjcf
