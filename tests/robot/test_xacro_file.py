from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from calib.errors import UrdfError
from calib.robot.meshes import find_mesh, link_shapes, mesh_folders
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.robot.urdf import find_urdf, read_urdf
from calib.robot.xacro_file import XacroCall, package_folder
from tests.places import ROOT

URDF = ROOT / "urdf"
EXAMPLE = URDF / "ur3_from_origins.urdf.xacro"
NOMINAL = f"{EXAMPLE} origins:=ur3_nominal_origins.yaml"

HEAD = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">\n'
BODY = """<link name="a"/>
<link name="b"/>
<joint name="j" type="revolute"><parent link="a"/><child link="b"/>
<origin xyz="0 0 ${h}"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
</robot>
"""
HALF = '<xacro:property name="h" value="0.5"/>\n'
ARM = '<xacro:macro name="arm" params="x">\n<link name="${x + zz}"/></xacro:macro>\n'

Written = Callable[..., Path]


@pytest.fixture
def written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Written:
    """A function that writes ``r.urdf.xacro`` out of what stands before the link and joint, and other files."""
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    monkeypatch.delenv("ROS_PACKAGE_PATH", raising=False)

    def write(text: str | bytes, others: dict[str, str] | None = None) -> Path:
        for name, content in (others or {}).items():
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).write_text(content)
        path = tmp_path / "r.urdf.xacro"
        path.write_bytes(text if isinstance(text, bytes) else (HEAD + text + BODY).encode())
        return path

    return write


def height(source: str | Path) -> float:
    return float(read_urdf(source).joint("j").xyz[2])


# What is read


def test_the_example_has_the_origins_of_the_calibrated_urdf():
    calibrated = Robot.load(URDF / "ur3_calibrated.urdf", "base", "tool0")
    q = random_joint_values(calibrated, 100, np.random.default_rng(0))
    robot = Robot.load(EXAMPLE, "base", "tool0")
    np.testing.assert_allclose(robot.poses(q), calibrated.poses(q), rtol=0, atol=1e-9)
    nominal = Robot.load(URDF / "ur3.urdf", "base", "tool0")
    robot = Robot.load(NOMINAL, "base", "tool0")
    np.testing.assert_allclose(robot.poses(q), nominal.poses(q), rtol=0, atol=1e-9)
    assert robot.joint_names == nominal.joint_names


def test_it_is_what_the_xacro_program_writes(tmp_path: Path):
    """But for what stands in the remark at the head, which has no folder in it, wherever it is called from."""
    shutil.copy(EXAMPLE, tmp_path)
    shutil.copy(URDF / "ur3_nominal_origins.yaml", tmp_path)
    words = f"{EXAMPLE.name} origins:=ur3_nominal_origins.yaml"
    code = "import sys, xacro; sys.argv[0] = 'xacro'; xacro.main()"
    done = subprocess.run(
        [sys.executable, "-c", code, *words.split()], cwd=tmp_path, capture_output=True, check=True
    )
    here, there = read_urdf(f"{tmp_path}/{words}"), read_urdf(NOMINAL)
    assert here.data == done.stdout
    assert there.data == here.data
    assert there.sha256 == here.sha256


@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_any_urdf_is_a_xacro_too(name: str, tmp_path: Path):
    """Nothing that calib reads is lost or rounded on the way."""
    path = tmp_path / "r.urdf.xacro"
    shutil.copy(find_urdf(name), path)
    ours, theirs = read_urdf(path), read_urdf(name)
    assert (ours.name, ours.links) == (theirs.name, theirs.links)
    for one, other in zip(ours.joints, theirs.joints, strict=True):
        assert (one.name, one.type, one.mimic) == (other.name, other.type, other.mimic)
        assert (one.lower, one.upper) == (other.lower, other.upper)
        np.testing.assert_array_equal(one.T_parent_joint, other.T_parent_joint)
        np.testing.assert_array_equal(one.axis, other.axis)


@pytest.mark.parametrize("name", ["meshes/m.stl", "package://arm_description/meshes/m.stl"])
def test_a_mesh_beside_the_xacro_is_found(written: Written, tmp_path: Path, name: str):
    """Of a package, too, whose folder has another name than it."""
    mesh = f'<link name="b"><visual><geometry><mesh filename="{name}"/></geometry></visual></link>'
    manifest = "<package><name>arm_description</name></package>"
    written("", {"Arm/package.xml": manifest, "Arm/meshes/m.stl": ""})
    text = (HEAD + HALF + BODY).replace('<link name="b"/>', mesh)
    (tmp_path / "Arm" / "r.xacro").write_text(text)
    urdf = read_urdf(tmp_path / "Arm" / "r.xacro")
    (shape,) = link_shapes(urdf, "visual")
    found = find_mesh(str(shape.geometry.get("filename")), mesh_folders(urdf))
    assert found is not None
    assert found.samefile(tmp_path / "Arm" / "meshes" / "m.stl")


# Arguments


def test_arguments_and_their_defaults(written: Written):
    arg = '<xacro:arg name="h" default="0.5"/><xacro:property name="h" value="$(arg h)"/>'
    path = written(arg)
    assert (height(path), height(f"{path} h:=0.25")) == (0.5, 0.25)
    assert read_urdf(f"{path}   h:='0.25'  ").source == "r.urdf.xacro h:=0.25"


@pytest.mark.parametrize(
    ("text", "arguments"),
    [
        ("r.xacro", {}),
        ("r.xacro a:=1 b:=2", {"a": "1", "b": "2"}),
        ("r.xacro a:='x y' b:=\"x\"", {"a": "x y", "b": "x"}),
        ("r.xacro a:= b:=''", {"a": "", "b": ""}),
        ("r.xacro f:=/a/b.yaml g:=file:///c", {"f": "/a/b.yaml", "g": "file:///c"}),
        ("r.XACRO\n a:=1\t", {"a": "1"}),
    ],
)
def test_the_file_and_what_is_behind_it(text: str, arguments: dict[str, str]):
    call = XacroCall.parse(text)
    assert dict(call.arguments) == arguments
    assert call.path.name.lower() == "r.xacro"
    assert XacroCall.parse(call.name) == call


# What a xacro may use


def test_a_package_that_it_includes_from(written: Written, tmp_path: Path, monkeypatch):
    include = '<xacro:include filename="$(find arm_description)/urdf/h.xacro"/>\n'
    file = {"ros/arm/urdf/h.xacro": f'<robot xmlns:xacro="x">{HALF}</robot>'}
    path = written(include, file)
    (tmp_path / "ros/arm/package.xml").write_text("<package><name>arm_description</name></package>")
    with pytest.raises(UrdfError, match="there is no ROS package 'arm_description'"):
        read_urdf(path)
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "ros"))
    assert height(path) == 0.5


# What is refused

FAULTS: dict[str, tuple[str, dict[str, str], str, str]] = {
    "missing package": (
        '<xacro:include filename="$(find nothing)/x.xacro"/>\n' + HALF, {}, "",
        "r.urdf.xacro: there is no ROS package 'nothing' in AMENT_PREFIX_PATH, ROS_PACKAGE_PATH, or the folders",
    ),
    "misspelt argument": (
        '<xacro:arg name="height" default="1"/>\n' + HALF, {}, "heigth:=2",
        "r.urdf.xacro heigth:=2: it has no argument 'heigth' (did you mean 'height'?); its arguments: 'height'",
    ),
    "no argument": (HALF, {}, "h=2", "'h=2' after r.urdf.xacro is not an argument, or repeats one; write NAME:=VALUE"),
    "argument that is not given": (
        '<xacro:arg name="kind" default="$(arg series)"/>\n<xacro:arg name="side" default="l"/>' + HALF
        + '<!-- $(arg old) --><link name="$(arg prefix)l"/>', {}, "kind:='a b' prefx:=left",
        "r.urdf.xacro kind:='a b' prefx:=left: the xacro needs the arguments 'prefix', 'series': write "
        "\"r.urdf.xacro kind:='a b' prefix:=VALUE series:=VALUE\" in one pair of quotes. It has no "
        "argument 'prefx' (did you mean 'prefix'?)",
    ),
    "file that is not there": (
        '<xacro:include filename="h.xacro"/>', {}, "",
        "it uses the file '{folder}/h.xacro', which cannot be read: No such file",
    ),
    "in an included file": (
        '<xacro:include filename="h.xacro"/>', {"h.xacro": '<robot xmlns:xacro="x"><xacro:leg/></robot>'}, "",
        "in {folder}/h.xacro: it calls the macro 'xacro:leg', which no file defines that it includes before",
    ),
    "macro without a parameter": (
        HALF + ARM + "<xacro:arm/>", {}, "", "it calls the macro 'arm' without its parameters x",
    ),
    "macro with another parameter": (
        HALF + ARM + '<xacro:arm x="1" y="2"/>', {}, "",
        "r.urdf.xacro: it calls the macro 'arm' with 'y', which is not one of its parameters",
    ),
    "environment": (HALF + '<link name="$(env NOT_SET)"/>', {}, "",
        "r.urdf.xacro: environment variable 'NOT_SET' is not set."),
    "broken macro": (HALF + ARM + '<xacro:arm x="1"/>\n', {}, "", "name 'zz' is not defined"),
    "text for a number": (
        '<xacro:property name="h" value="high"/>\n', {}, "",
        "joint 'j': xyz of <origin> is '0 0 high', 3 finite numbers wanted. This is about the flattened text",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("text", "others", "arguments", "message"), FAULTS.values(), ids=FAULTS)
def test_faults(written: Written, text: str, others: dict[str, str], arguments: str, message: str):
    path = written(text, others)
    with pytest.raises(UrdfError) as error:
        read_urdf(f"{path} {arguments}")
    assert message.format(path=path, folder=path.parent) in str(error.value)
    assert "\n" not in str(error.value)
    assert "<class" not in str(error.value)


@pytest.mark.slow
def test_a_xacro_that_comes_to_no_end_is_stopped(written: Written, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("calib.robot.xacro_file.TIME_LIMIT", 1.0)
    path = written('<xacro:property name="h" value="${9**9**9}"/>\n')
    with pytest.raises(UrdfError, match=r"r\.urdf\.xacro: xacro took longer than 1 s"):
        read_urdf(path)


@pytest.fixture(autouse=True)
def no_ros(monkeypatch: pytest.MonkeyPatch):
    """No ROS of the computer that the test runs on."""
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    monkeypatch.delenv("ROS_PACKAGE_PATH", raising=False)


def package(folder: Path, name: str) -> Path:
    folder.mkdir(parents=True)
    (folder / "package.xml").write_text(
        f'<?xml version="1.0"?>\n<package format="3">\n<!-- <name>old</name> -->\n<name> {name} </name></package>'
    )
    return folder


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """The xacro of a package in a workspace."""
    cell = package(tmp_path / "ws" / "src" / "cell", "my_cell")
    (cell / "urdf").mkdir()
    return cell / "urdf" / "cell.urdf.xacro"


def test_a_folder_without_a_manifest_is_the_last_that_counts(file: Path):
    plain = file.parents[3] / "arm_description"
    plain.mkdir()
    assert package_folder("arm_description", file) == plain
    arm = package(file.parents[2] / "drivers" / "arm", "arm_description")
    assert package_folder("arm_description", file) == arm


def test_the_index_of_ros_2_comes_first(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    package(file.parents[2] / "arm_description", "arm_description")
    prefix = tmp_path / "humble"
    share = package(prefix / "share" / "arm_description", "arm_description")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path / 'none'}:{prefix}")
    assert package_folder("arm_description", file) == file.parents[2] / "arm_description"
    index = prefix / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True)
    (index / "arm_description").touch()
    assert package_folder("arm_description", file) == share
