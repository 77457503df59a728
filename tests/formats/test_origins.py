from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings, strategies as st

from calib.errors import FileError, UrdfError
from calib.formats.origins import (
    JointOrigin,
    Origins,
    origins_of,
    parse_yaml,
    read_origins,
    write_origins,
)
from calib.robot.readback import random_joint_values
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf

URDF = Path(__file__).parents[2] / "urdf"


@pytest.fixture(scope="module")
def nominal() -> Robot:
    return Robot.load(URDF / "ur3.urdf", base="base", tip="tool0")


@pytest.fixture(scope="module")
def corrected() -> Robot:
    return Robot.load(URDF / "ur3_calibrated.urdf", base="base", tip="tool0")


def test_written_and_read_they_are_the_urdfs_own_numbers(corrected: Robot, tmp_path: Path):
    path = write_origins(corrected, tmp_path / "o.yaml")
    read = read_origins(path)
    assert read.joints == origins_of(corrected).joints
    assert read.source == "o.yaml"
    for name, origin in read.joints:
        joint = corrected.urdf.joint(name)
        assert (origin.xyz, origin.rpy) == (tuple(joint.xyz), tuple(joint.rpy))
        np.testing.assert_array_equal(origin.T_parent_joint, joint.T_parent_joint)
    with pytest.raises(FileError, match="exists already; add --force"):
        write_origins(corrected, path)
    assert write_origins(corrected, path, overwrite=True) == path


@pytest.mark.parametrize(
    ("urdf", "kept"),
    [("ur3.urdf", "ur3_nominal_origins.yaml"), ("ur3_calibrated.urdf", "ur3_origins.yaml")],
)
def test_the_examples_files_are_written_from_the_urdfs(urdf: str, kept: str, tmp_path: Path):
    path = write_origins(Robot.load(URDF / urdf, "base", "tool0"), tmp_path / kept)
    assert path.read_bytes() == (URDF / kept).read_bytes()


def test_only_the_chains_own_joints_base_to_tip(corrected: Robot):
    names = [name for name, _ in origins_of(corrected).joints]
    assert names == [*corrected.joint_names, "wrist_3_link-tool0_fixed_joint"]
    part = corrected.rebuilt(base="upper_arm_link", tip="wrist_1_link")
    assert [name for name, _ in origins_of(part).joints] == ["elbow_joint", "wrist_1_joint"]


def test_the_nominal_robot_with_them_is_the_corrected_one(nominal: Robot, corrected: Robot):
    with_them = origins_of(corrected).applied_to(nominal)
    q = random_joint_values(corrected, 50, np.random.default_rng(1))
    np.testing.assert_allclose(with_them.poses(q), corrected.poses(q), rtol=0, atol=1e-12)
    assert np.abs(nominal.poses(q) - corrected.poses(q)).max() > 1e-3
    assert origins_of(nominal).applied_to(nominal).urdf.data == nominal.urdf.data


def test_what_is_held_stays_held(nominal: Robot):
    arm = Robot.from_urdf(nominal.urdf, "base", "tool0", held={"elbow_joint": 0.5})
    assert origins_of(arm).applied_to(arm).held == {"elbow_joint": 0.5}


def test_other_programs_read_it_as_text(corrected: Robot, tmp_path: Path):
    path = write_origins(corrected, tmp_path / "o.yaml")
    table = yaml.safe_load(path.read_bytes())["origins"]
    assert all(isinstance(table[name][key], str) for name in table for key in ("xyz", "rpy"))
    assert path.read_text().startswith("# Origins of the joints of 'ur3' between 'base' and")
    assert "xacro.load_yaml('o.yaml')['origins']" in path.read_text()


numbers = st.floats(-1e6, 1e6).map(lambda x: x + 0.0)
names = st.text(st.characters(exclude_categories=("C", "Z")), min_size=1, max_size=9)
triples = st.tuples(numbers, numbers, numbers)


@settings(max_examples=60)
@given(st.dictionaries(names, st.builds(JointOrigin, triples, triples), min_size=1, max_size=3))
def test_any_numbers_and_names_read_back(joints: dict[str, JointOrigin]):
    origins = Origins(tuple(joints.items()), "o.yaml")
    assert read_origins("o.yaml", origins.to_yaml()) == origins


@pytest.mark.parametrize("name", ["yes", "null", "1.5", "a: b", "#", "it's", 'say "a"', "ü", "~"])
def test_names_that_yaml_would_take_for_something_else(name: str, tmp_path: Path, serial_urdf):
    urdf = serial_urdf([("revolute", (0, 0, 0.1), (0, 0, 0), (0, 0, 1))])
    quoted = name.replace('"', "&quot;").encode()
    robot = Robot.from_urdf(Urdf.from_bytes(urdf.data.replace(b'"j1"', b'"' + quoted + b'"'), "r"))
    read = read_origins(write_origins(robot, tmp_path / "o.yaml"))
    assert read.joints[0][0] == name
    assert read.applied_to(robot) == robot


def test_a_list_of_numbers_does_too(tmp_path: Path):
    (tmp_path / "o.yaml").write_text("origins:\n  j: {xyz: [0, 0.1, 1e-05], rpy: [0.0, 0, -1]}\n")
    ((name, origin),) = read_origins(tmp_path / "o.yaml").joints
    assert (name, origin) == ("j", JointOrigin((0.0, 0.1, 1e-5), (0.0, 0.0, -1.0)))


GOOD = 'rpy: "0 0 0"'
REFUSED = {
    "empty": (
        "",
        "this is no origins file: it has no section 'origins:' with a line for each joint",
    ),
    "number": (
        f'origins:\n  5: {{xyz: "0 0 0", {GOOD}}}\n',
        "joint '5': this is no joint's name",
    ),
    "missing": (
        'origins:\n  j: {xyz: "0 0 0"}\n',
        "the keys 'xyz', 'rpy' are wanted, not 'xyz', as in",
    ),
    "two": (
        f'origins:\n  j: {{xyz: "0 0", {GOOD}}}\n',
        r"xyz is '0 0'; three numbers \[m\] no larger",
    ),
    "angle": (
        'origins:\n  j: {xyz: "0 0 0", rpy: "0 0 90deg"}\n',
        r"rpy is .*three numbers \[rad\]",
    ),
    "nan": (f'origins:\n  j: {{xyz: "0 0 nan", {GOOD}}}\n', "xyz is '0 0 nan'; three numbers"),
    "true": (f"origins:\n  j: {{xyz: [0, 0, true], {GOOD}}}\n", "True.*; three numbers"),
    "far": (f'origins:\n  j: {{xyz: "0 0 1e7", {GOOD}}}\n', r"no larger than 1e\+06 are wanted"),
}


@pytest.mark.parametrize(("text", "message"), REFUSED.values(), ids=REFUSED)
def test_what_is_refused(text: str, message: str, tmp_path: Path):
    path = tmp_path / "o.yaml"
    path.write_text(text)
    with pytest.raises(FileError, match=message) as error:
        read_origins(path)
    assert str(error.value).startswith(str(path))


def test_another_robot(corrected: Robot, panda: Robot):
    with pytest.raises(UrdfError, match=r"is no joint of panda.*Give the robot that the file was"):
        origins_of(corrected).applied_to(panda)
    misspelt = Origins((("elbow_jiont", origins_of(corrected).joints[0][1]),), "o.yaml")
    with pytest.raises(UrdfError, match=r"o.yaml: 'elbow_jiont' .*did you mean 'elbow_joint'"):
        misspelt.applied_to(corrected)


def test_what_yaml_says():
    text = b"a: {x: 1.5, y: [1, two, null], z: !degrees 90, r: !radians 1}\n'b c': 1e-05\n"
    assert parse_yaml(text, "f.yaml", "origins file") == {
        "a": {"x": 1.5, "y": [1, "two", None], "z": math.pi / 2, "r": 1.0},
        "b c": "1e-05",  # YAML 1.1 wants a point in a number
    }
    for other in (b"", b"- 1\n", b"word"):
        assert parse_yaml(other, "f.yaml", "origins file") == {}


BAD_YAML = {
    "twice": (b"a: 1\nb: 2\na: 3\n", "f.yaml, line 3, column 1: .*'a' stands twice, first in li"),
    "alias": (b"a: &n 1\nb: *n\n", r"line 2, column 4: .*an alias \(\*n\) is not read"),
    "tag": (b"a: !mm 90\n", "line 1, column 4: .*could not determine a constructor"),
    "unclosed": (b"a: [1, 2\n", "line 2, column 1: this origins file cannot be read as YAML: exp"),
    "no text": (b"a: \xff\xfe\n", "f.yaml.*: this origins file cannot be read as YAML: "),
    "no angle": (b"a: !degrees x\n", "could not convert"),
}


@pytest.mark.parametrize(("text", "message"), BAD_YAML.values(), ids=BAD_YAML)
def test_yaml_that_is_refused(text: bytes, message: str):
    with pytest.raises(FileError, match=message):
        parse_yaml(text, "f.yaml", "origins file")
