"""Files of Universal Robots into robots and back: what is written reads back, what has no place is noted."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml

from calib.errors import FileError, ModelError
from calib.robot.robot import Robot
from calib.robot.ur_models import chain_of_rows, ur_model
from calib.verbs.convert.convert import convert
from calib.verbs.convert.format import Notes, Options, Source
from calib.verbs.convert.ur_arms import chain_poses, kinematics_hash, the_mount, ur_robot
from calib.verbs.convert.ur_files import KinematicsYaml, kinematics_bytes
from calib.verbs.convert.ur_formats import FORMATS, conf_file, kinematics_file, read_ur
from tests.places import ROOT
from tests.verbs.convert.ur_cases import WITH_DELTAS, rows, write_deltas

Q = np.random.default_rng(12).uniform(-2 * np.pi, 2 * np.pi, (100, 6))


HASH = "calib_4711"


UR3 = next(case for case in WITH_DELTAS if case["robot"] == "UR3")


@pytest.fixture
def conf_of(tmp_path):
    """A function that writes the calibration.conf of a case."""
    return lambda case: write_deltas(tmp_path / f"{case['robot']}.conf", rows(case["delta"]))


def codes(notes) -> list[str]:
    return [note.code for note in notes]


def of(robot: Robot, nominal: Robot) -> Source:
    """A robot and the arm that it was corrected from."""
    return Source("robot", robot, nominal, model=the_mount(nominal).model, hash=HASH)


def write(source: Source, path: Path, **options) -> Notes:
    """The notes on a file that was written in the format that its ending says."""
    name = {".yaml": "ur-yaml", ".conf": "ur-conf"}[path.suffix]
    return FORMATS[name].write(source, path, Options(**options))


def urcontrol_of(table, path: Path) -> Path:
    lines = [
        f"{name} = {values.tolist()}"
        for name, values in zip(("theta", "a", "d", "alpha"), table.T, strict=True)
    ]
    path.write_text("\n".join(["[DH]", *lines]))
    return path


def displaced(robot: Robot, size: float = 1e-3) -> Robot:
    """Every placement displaced by millimetres and milliradians."""
    twists = np.random.default_rng(9).normal(size=(7, 6)) * size
    pairs = zip(robot.placements, twists, strict=True)
    return robot.with_placements(np.array([P @ pin.exp6(t).homogeneous for P, t in pairs]))


@pytest.mark.parametrize(
    ("base", "tip"), [("base", "tool0"), ("base_link", "ee_link"), ("world", "wrist_3_link")]
)
def test_onto_the_user_s_urdf(base, tip, conf_of, ur3):
    nominal = ur3.rebuilt(base=base, tip=tip)
    source = read_ur(conf_of(UR3), robot=nominal)
    assert source.nominal is nominal
    # Seen from the controller's base at its flange, whatever the URDF calls them.
    T = source.robot.rebuilt(base="base").poses(UR3["fk"]["q"])
    at = np.linalg.inv(nominal.poses(np.zeros(6))[0])
    T = T @ at @ nominal.rebuilt(tip="tool0").poses(np.zeros(6))[0]
    np.testing.assert_allclose(T, UR3["fk"]["T"], rtol=0, atol=1e-8)
    moved = source.robot.placements[:, :3, 3] - nominal.placements[:, :3, 3]
    assert np.linalg.norm(moved, axis=1).max() < 0.02


@pytest.mark.parametrize("tip", ["tool0", "ee_link"])
def test_what_a_file_has_no_place_for_is_said(tip, ur3, tmp_path):
    nominal = ur3.rebuilt(base="base_link" if tip == "ee_link" else "base", tip=tip)
    robot = displaced(nominal)
    flange = nominal.rebuilt(tip="tool0").poses(np.zeros(6))[0]
    T_flange_tip = np.linalg.inv(flange) @ nominal.poses(np.zeros(6))[0]
    T_base_arm = np.diag([-1.0, -1.0, 1.0, 1.0]) if tip == "ee_link" else np.eye(4)
    source = of(robot, nominal)
    yaml, conf = tmp_path / "k.yaml", tmp_path / "k.conf"
    _, T_tool_of_yaml = kinematics_file(source, yaml, HASH)
    _, T_base, T_tool_of_conf = conf_file(source, conf)
    assert codes(write(source, yaml)) == ["flange displaced"]
    notes = write(source, conf)
    assert codes(notes) == ["base displaced", "flange displaced"]
    assert notes[0].values[:3] == pytest.approx(T_base[:3, 3], abs=1e-9)
    assert f"by ({1e3 * T_base[0, 3]:.6f}, " in notes[0].text
    for path, T_base_of_file, T_tool in (
        (yaml, np.eye(4), T_tool_of_yaml),
        (conf, T_base, T_tool_of_conf),
    ):
        # T_base_tip = T_base_arm T_base K(q) T_tool T_flange_tip
        again = read_ur(path, robot=nominal).robot.poses(Q)
        kinematics = np.linalg.inv(T_base_arm) @ again @ np.linalg.inv(T_flange_tip)
        made = T_base_arm @ T_base_of_file @ kinematics @ T_tool @ T_flange_tip
        np.testing.assert_allclose(made, robot.poses(Q), rtol=0, atol=2e-9)
        assert abs(T_tool[2, 3]) < 1e-12  # along the axis the sixth joint holds it


def test_a_robot_that_was_calibrated_in_the_factory_is_corrected_further(conf_of, tmp_path):
    factory = read_ur(conf_of(UR3), model="UR3")
    robot = displaced(factory.robot, 1e-4)
    source = of(robot, factory.robot)
    yaml, conf = tmp_path / "k.yaml", tmp_path / "c.conf"
    assert codes(write(source, yaml)) == ["flange displaced"]
    again = read_ur(yaml, robot=factory.nominal).robot
    _, T_tool = kinematics_file(source, yaml, HASH)
    np.testing.assert_allclose(again.poses(Q) @ T_tool, robot.poses(Q), rtol=0, atol=1e-12)
    write(source, conf)
    _, T_base, T_tool = conf_file(source, conf)
    back = T_base @ read_ur(conf, model="UR3").robot.poses(Q) @ T_tool
    np.testing.assert_allclose(back, robot.poses(Q), rtol=0, atol=1e-12)
    # And its URDF takes another file, its own too.
    on_it = read_ur(yaml, robot=factory.robot).robot
    np.testing.assert_allclose(on_it.poses(Q), again.poses(Q), rtol=0, atol=1e-12)
    own = read_ur(conf_of(UR3), robot=factory.robot).robot
    np.testing.assert_allclose(own.poses(Q), factory.robot.poses(Q), rtol=0, atol=1e-12)


def test_one_robot_of_a_dump_of_two(conf_of, tmp_path):
    # As `rosparam dump` writes the parameters of two robots, whose drivers have names of their own.
    own = read_ur(conf_of(UR3), model="UR3")
    dump: dict[str, object] = {}
    for arm, robot in (("alice", own.robot), ("bob", displaced(own.robot, 1e-4))):
        path = tmp_path / f"{arm}.yaml"
        write(of(robot, own.robot), path)
        driver = {"kinematics": yaml.safe_load(path.read_text())["kinematics"], "use_tool": False}
        dump[arm] = {"ur_hardware_interface": driver}
    path = tmp_path / "dump.yaml"
    path.write_text(yaml.safe_dump(dump))
    for arm in ("alice", "bob"):
        alone, of_dump = read_ur(tmp_path / f"{arm}.yaml"), read_ur(path, section=arm)
        assert of_dump.hash == HASH
        np.testing.assert_array_equal(of_dump.robot.poses(Q), alone.robot.poses(Q))
    with pytest.raises(FileError, match="'alice/ur_hardware_interface', 'bob/ur_hard"):
        read_ur(path)
    # The hash of a robot is taken from its part of the dump.
    done = convert(str(path), tmp_path / "k.yaml", options=Options(to="ur-yaml", section="bob"))
    assert done.source.hash == HASH
    again = KinematicsYaml.read(tmp_path / "k.yaml")
    np.testing.assert_array_equal(again.numbers, KinematicsYaml.read(tmp_path / "bob.yaml").numbers)


@pytest.mark.parametrize("angle", [2e-8, 1e-4])
def test_rows_of_axes_that_are_almost_parallel(angle, tmp_path):
    nominal = ur_robot("UR5e")
    placements = np.array(nominal.placements)
    placements[2] = placements[2] @ pin.exp6(np.array([0, 0, 0, 0, angle, 0])).homogeneous
    placements[2, 1, 3] += 0.01
    robot = nominal.with_placements(placements)
    path = tmp_path / "c.conf"
    assert write(of(robot, nominal), path) == ()
    _, T_base, T_tool = conf_file(of(robot, nominal), path)
    back = T_base @ read_ur(path, robot=nominal).robot.poses(Q) @ T_tool
    np.testing.assert_allclose(back, robot.poses(Q), rtol=0, atol=1e-7)


def test_what_a_file_says_of_its_arm_and_hash(conf_of, tmp_path):
    robot = ur_robot("UR10e")
    path = tmp_path / "k.yaml"
    write(of(displaced(robot, 3e-4), robot), path)
    found = read_ur(path)
    assert (found.model.name, found.hash) == ("UR10e", HASH)
    assert read_ur(path, model="UR12e").model.name == "UR12e"
    path.write_text(path.read_text().replace("hash:", "# hash:"))
    assert read_ur(path, robot=robot).hash is None
    default = kinematics_hash(ur_model("UR5e").rows)
    write(replace(of(robot, robot), hash=default), path, overwrite=True)
    assert codes(read_ur(path, robot=robot).notes) == ["nominal hash"]
    conf = conf_of(UR3)
    conf.write_text(f"{conf.read_text()}calibration_status = 1 # 2 == Linearised\n")
    notes = read_ur(conf, model="UR3").notes
    assert codes(notes) == ["arm not certain", "not linearised"]
    assert f"up to {1e3 * notes[0].values[3]:.0f} mm off" in notes[0].text
    # The controller's own rows say which arm it is.
    urcontrol = urcontrol_of(rows(UR3["nominal"]), tmp_path / "urcontrol.conf")
    found = read_ur(conf, urcontrol=urcontrol)
    assert (found.model.name, found.hash) == ("UR3", UR3["driver_hash"])
    assert codes(found.notes) == ["not linearised"]


@pytest.mark.parametrize("model", ["UR5", "UR16e", "UR20"])
def test_a_file_of_an_arm_of_another_size(conf_of, tmp_path, model):
    # Centimetres, no more: nearly parallel axes cancel for the right upper arm only.
    conf = conf_of(UR3)
    with pytest.raises(FileError, match="and that of 'UR3', 'UR3e' by 3"):
        read_ur(conf, model=model)
    robot = ur_robot(model)
    with pytest.raises(FileError, match="moves the flange of a"):
        write(of(robot, robot), tmp_path / "new.conf", update=conf)


def test_names_that_do_not_agree(conf_of, tmp_path, ur3, panda):
    conf = conf_of(UR3)
    urcontrol = urcontrol_of(rows(UR3["nominal"]), tmp_path / "urcontrol.conf")
    for words, said in (
        ({"urcontrol": urcontrol, "model": "UR5"}, "are not those of the UR5"),
        ({"model": "UR5", "robot": ur3}, "is not a UR5"),
        ({"robot": panda}, "is not an arm of Universal Robots"),
        ({}, "Say which arm it is for"),
    ):
        with pytest.raises(ModelError, match=said):
            read_ur(conf, **words)
    yaml, new_conf = tmp_path / "out.yaml", tmp_path / "out.conf"
    with pytest.raises(ModelError, match="The robot 'panda' has the joints"):
        write(of(panda, ur3), yaml)
    with pytest.raises(FileError, match="moves the flange of a UR3 by"):
        write(of(ur_robot("UR5"), ur_robot("UR3")), new_conf)
    with pytest.raises(FileError, match="The hash is 'a b'"):
        write(replace(of(ur3, ur3), hash="a b"), yaml)
    assert not yaml.exists()
    assert not new_conf.exists()


def test_the_python_of_the_page_runs(conf_of, tmp_path, monkeypatch):
    page = ROOT / "docs" / "universal-robots.md"
    (code,) = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    conf_of(UR3).rename(tmp_path / "calibration.conf")
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(compile(code.replace("UR5e", "UR3"), page.name, "exec"), names)
    assert names["done"].notes == ()
    assert read_ur("kinematics.yaml").hash == UR3["driver_hash"]
    assert Robot.load("ur5e.urdf", "base", "tool0").urdf == names["source"].robot.urdf


# Arms that calib does not know


SMALL = 1e-4 * np.transpose(
    [[1, 2, 3, 1, 2, 1], [1, 2, 3, 1, 2, 0], [3, 0, 0, 2, 1, 1], [2, 0, 0, 3, 2, 0]]
)


@pytest.mark.parametrize(
    ("row", "column", "change"), [(0, 2, 0.012), (5, 2, 0.0204), (5, 0, 0.02), (2, 1, -0.01)]
)
def test_the_writers_count_from_the_arm_of_the_source(row, column, change, tmp_path):
    nominal = np.array(ur_model("UR5e").rows)
    nominal[row, column] += change
    conf = write_deltas(tmp_path / "c.conf", SMALL)
    source = read_ur(conf, urcontrol=urcontrol_of(nominal, tmp_path / "u.conf"))
    arm = source.model
    assert not arm.known
    path = tmp_path / "d.conf"
    assert write(source, path) == ()
    assert path.read_bytes() == conf.read_bytes()
    path = tmp_path / "k.yaml"
    write(source, path)
    found = read_ur(path, model=arm).robot.poses(Q)
    wanted = chain_poses(chain_of_rows(nominal + SMALL), Q)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-12)


def test_a_file_that_is_read_and_written_is_the_same(tmp_path):
    chain = chain_of_rows(rows(WITH_DELTAS[1]["full_dh"]))
    written = tmp_path / "kinematics.yaml"
    written.write_bytes(kinematics_bytes(chain, "calib_4455573973530731233"))
    source = read_ur(written, model="UR3")
    again = tmp_path / "again.yaml"
    write(source, again)
    assert again.read_bytes() == written.read_bytes()
    # With the origins of the first joint as they were, its line is that of the robot's own file.
    robot = displaced(source.robot, 1e-4)
    placements = np.array(robot.placements)
    placements[0] = source.robot.placements[0]
    robot = source.robot.with_placements(placements)
    changed = tmp_path / "c.yaml"
    write(of(robot, source.robot), changed, hash_from=written)
    found, numbers = (KinematicsYaml.read(one).numbers for one in (changed, written))
    np.testing.assert_array_equal(found[0], numbers[0])
    assert (found[1:] != numbers[1:]).any(axis=1).all()
