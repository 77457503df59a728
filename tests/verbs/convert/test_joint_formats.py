"""Factory files of UFACTORY and Flexiv into URDFs and back, with numbers that were made up, in the makers' form."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml

from calib.errors import FileError, ModelError
from calib.robot.arm_models import FLEXIV, UFACTORY, arm_model
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from calib.verbs.convert.convert import convert, read_source, source_kind
from calib.verbs.convert.format import Options, Source
from calib.verbs.convert.joint_arms import arm_robot
from calib.verbs.convert.joint_formats import FORMATS, JointYaml, joint_yaml, read_joint_yaml
from tests.verbs.convert.test_joint_arms import displaced, prefixed

NAMES = ("xArm5", "xArm6", "xArm7", "Lite6", "UF850", "Rizon4s", "Rizon10", "Enlight-L")
RNG = np.random.default_rng(47)


def factory_table(name: str, size: float = 4e-4) -> dict[str, dict[str, object]]:
    """A table in the maker's form: nominal numbers and errors, in single precision as UFACTORY's robots send them."""
    arm = arm_model(name)
    joints = arm.joints if arm.maker is FLEXIV else arm.joints[:-1]
    rng = np.random.default_rng(len(name))
    table: dict[str, dict[str, object]] = {}
    for i, joint in enumerate(joints):
        numbers = np.float32(arm.numbers[i] + size * rng.normal(size=6))
        keys = ("x", "y", "z", "roll", "pitch", "yaw")
        table[joint] = dict(zip(keys, map(float, numbers), strict=True))
        if arm.maker is FLEXIV and i < 7 and arm.axes[i, 1]:
            table[joint]["axis"] = "0 1 0"
    return table


def factory_file(folder: Path, name: str, **other: object) -> Path:
    path = folder / f"{arm_model(name).plain}_kinematics_AB12.yaml"
    content = {"kinematics": factory_table(name), **other}
    path.write_text(yaml.safe_dump(content, sort_keys=False))
    return path


def flange_by_pinocchio(name: str, table: dict, q: np.ndarray) -> np.ndarray:
    """The flange in the base, as the product of the file's origins and turns about the axes."""
    arm = arm_model(name)
    T = pin.SE3.Identity()
    for i, joint in enumerate(arm.joints):
        row = table.get(joint)
        if row is not None:
            R = pin.rpy.rpyToMatrix(row["roll"], row["pitch"], row["yaw"])
            T = T * pin.SE3(R, np.array([row["x"], row["y"], row["z"]]))
        if i < len(q):
            turn = pin.exp3(q[i] * arm.axes[i])
            T = T * pin.SE3(turn, np.zeros(3))
    return T.homogeneous


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("given", ["bare", "arm", "robot"])
def test_a_factory_file_becomes_the_urdf_of_its_arm(name, given, tmp_path):
    path = factory_file(tmp_path, name, calibration_metadata={"robot_sn": "A-1"})
    arm = arm_model(name)
    nominal = prefixed(arm_robot(arm), "left_") if given == "robot" else None
    source = read_joint_yaml(path, robot=nominal, arm=arm if given == "arm" else None)
    assert (source.kind, source.notes) == ("joint-yaml", ())
    assert source.model is arm
    table = factory_table(name)
    for q in RNG.uniform(-3, 3, (20, len(arm.axes))):
        np.testing.assert_allclose(
            source.robot.poses(q)[0], flange_by_pinocchio(name, table, q), rtol=0, atol=1e-12
        )
    prefix = "left_" if given == "robot" else ""
    for joint, row in table.items():
        origin = source.robot.urdf.joint(prefix + joint)
        np.testing.assert_allclose(origin.xyz, [row[k] for k in "xyz"], rtol=0, atol=1e-15)
        R = pin.rpy.rpyToMatrix(row["roll"], row["pitch"], row["yaw"])
        np.testing.assert_allclose(origin.T_parent_joint[:3, :3], R, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("name", "to"), [("xArm6", "ufactory-yaml"), ("Rizon4s", "flexiv-yaml")])
def test_an_unchanged_file_keeps_every_number_and_entry(name, to, tmp_path):
    path = factory_file(tmp_path, name, calibration_metadata={"robot_sn": "A-1"})
    done = convert(str(path), tmp_path / "again.yaml", to=to)
    assert done.notes == ()
    read = [yaml.safe_load(file.read_text()) for file in (path, tmp_path / "again.yaml")]
    assert read[0] == read[1]
    assert list(read[1]["kinematics"]) == list(read[0]["kinematics"])


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("update", [True, False])
def test_a_calibrated_robot_as_the_makers_file(name, update, tmp_path):
    arm = arm_model(name)
    nominal = prefixed(arm_robot(arm), "r_")
    robot = displaced(nominal, 1e-3)
    own = JointYaml.read(factory_file(tmp_path, name, note="kept")) if update else None
    path = tmp_path / "new.yaml"
    data, T_tool = joint_yaml(arm.maker, Source("robot", robot, nominal), path, own)
    path.write_bytes(data)
    content = yaml.safe_load(data)
    table = content["kinematics"]
    for q in RNG.uniform(-3, 3, (20, len(arm.axes))):
        made = flange_by_pinocchio(name, table, q) @ T_tool
        np.testing.assert_allclose(made, robot.poses(q)[0], rtol=0, atol=1e-10)
    if arm.maker is FLEXIV:
        np.testing.assert_array_equal(T_tool, np.eye(4))  # the flange's joint holds it
        stated = [row.get("axis") for row in table.values()]
        wanted = [None, "0 1 0"] * 3 + [None, None] if name.startswith("Rizon") else [None] * 8
        assert stated == wanted
    else:
        assert list(table) == list(arm.joints[:-1])
        assert abs(T_tool[2, 3]) < 1e-12  # along the axis the last joint holds it
        assert abs(T_tool[1, 0] - T_tool[0, 1]) < 1e-12
        assert np.abs(T_tool - np.eye(4)).max() > 1e-4
    assert content.get("note") == ("kept" if update else None)
    again = read_joint_yaml(path, robot=nominal).robot
    np.testing.assert_allclose(
        again.poses(np.zeros(len(arm.axes))) @ T_tool,
        robot.poses(np.zeros(len(arm.axes))),
        rtol=0,
        atol=1e-10,
    )


def test_what_has_no_place_is_noted_and_how_to_start_with_the_file_is_said(tmp_path):
    nominal = arm_robot(arm_model("xArm6"))
    robot = displaced(nominal, 1e-3)
    robot.urdf.write(tmp_path / "corrected.urdf")
    nominal.urdf.write(tmp_path / "robot.urdf")
    options = Options(to="ufactory-yaml", robot=str(tmp_path / "robot.urdf"))
    done = convert(str(tmp_path / "corrected.urdf"), tmp_path / "k.yaml", options=options)
    (note,) = done.notes
    assert note.code == "flange displaced"
    _, T_tool = joint_yaml(UFACTORY, Source("robot", robot, nominal), "k.yaml")
    assert note.values[:3] == pytest.approx(T_tool[:3, 3], abs=1e-9)
    assert FORMATS["ufactory-yaml"].command is not None
    command = FORMATS["ufactory-yaml"].command(done)
    assert f"cp {tmp_path / 'k.yaml'} " in command
    assert "/xarm6_kinematics_calib.yaml" in command
    assert "xarm6_moveit_realmove.launch.py" in command


def test_one_arm_of_a_file_of_two(tmp_path):
    left, right = factory_table("Enlight-L"), factory_table("Enlight-L", 8e-4)
    path = tmp_path / "pair.yaml"
    path.write_text(yaml.safe_dump({"kinematics": {"ARM_1": left, "ARM_2": right}}))
    with pytest.raises(FileError, match="--section"):
        read_joint_yaml(path)
    source = read_joint_yaml(path, section="ARM_2")
    assert source.robot.urdf.joint("joint3").xyz[1] == right["joint3"]["y"]
    nominal = arm_robot(arm_model("Enlight-L"))
    robot = displaced(nominal, 1e-3)
    own = JointYaml.read(path, section="ARM_2")
    data, _ = joint_yaml(FLEXIV, Source("robot", robot, nominal), path, own)
    content = yaml.safe_load(data)["kinematics"]
    assert content["ARM_1"] == left
    assert content["ARM_2"]["joint3"]["y"] == robot.urdf.joint("joint3").xyz[1]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.pop("joint3"), "there is no 'joint3'"),
        (lambda t: t["joint2"].pop("yaw"), "there is no 'joint2'"),
        (lambda t: t["joint2"].update(x="far"), "x of 'joint2': 'far' is not a number"),
        (lambda t: t["joint2"].update(x=284.5), "x of 'joint2': '284.5' is not a number up to 10"),
        (lambda t: t["joint2"].update(axis="0 1 0"), "axis of 'joint2' is '0 1 0'"),
        (lambda t: t["joint3"].update(y=-0.9), "by up to 6[0-9]{2} mm"),
    ],
)
def test_files_that_are_refused(change, message, tmp_path):
    table = factory_table("xArm6")
    change(table)
    path = tmp_path / "k.yaml"
    path.write_text(yaml.safe_dump({"kinematics": table}))
    with pytest.raises(FileError, match=message) as error:
        read_joint_yaml(path, robot=arm_robot(arm_model("xArm6")))
    assert str(path) in str(error.value)


def test_arms_that_do_not_fit(tmp_path, ur3):
    path = factory_file(tmp_path, "xArm6")
    for robot in (ur3, arm_robot(arm_model("xArm7"))):
        with pytest.raises(ModelError, match="joint1 to joint6"):
            read_joint_yaml(path, robot=robot)
    with pytest.raises(FileError, match="has 6 joints; none of 'xArm7'"):
        read_joint_yaml(path, arm=arm_model("xArm7"))
    with pytest.raises(ModelError, match="joints of UFACTORY or Flexiv"):
        read_source(str(path), tmp_path / "o.urdf", Options(arm="UR5e"))
    with pytest.raises(ModelError, match="arms of UFACTORY"):
        joint_yaml(UFACTORY, Source("robot", ur3, ur3), "k.yaml")
    # The flange of a Rizon 4s lies 43 mm further out than that of a Rizon 4.
    source = read_joint_yaml(
        factory_file(tmp_path, "Rizon4s"), robot=arm_robot(arm_model("Rizon4"))
    )
    assert [note.code for note in source.notes] == ["large correction"]
    assert source.notes[0].values[1] == pytest.approx(0.043, abs=0.006)


def test_names_that_the_urdf_has_not_are_named(tmp_path):
    table = factory_table("Rizon4s")
    text = arm_robot(arm_model("Rizon4s")).urdf.data.replace(b"link7_to_flange", b"to_flange")
    robot = Robot.from_urdf(Urdf.from_bytes(text, "r"), "base_link", "flange")
    path = tmp_path / "k.yaml"
    path.write_text(yaml.safe_dump({"kinematics": table}))
    source = read_joint_yaml(path, robot=robot)
    assert source.notes[0].code == "origins without joint"
    assert source.notes[0].values[1] == "'link7_to_flange'"


def test_kinds_are_told_by_their_keys(tmp_path):
    joint, ur, origins = tmp_path / "j.yaml", tmp_path / "u.yaml", tmp_path / "o.yaml"
    joint.write_text(
        yaml.safe_dump({"/**": {"ros__parameters": {"kinematics": factory_table("xArm5")}}})
    )
    pose = factory_table("xArm5")["joint1"]
    ur.write_text(yaml.safe_dump({"left": {"driver": {"kinematics": {"shoulder": pose}}}}))
    origins.write_text(yaml.safe_dump({"origins": {"joint1": {"xyz": "0 0 1", "rpy": "0 0 0"}}}))
    kinds = [source_kind(str(path)) for path in (joint, ur, origins)]
    assert kinds == ["joint-yaml", "ur-yaml", "origins"]
