from __future__ import annotations

from pathlib import Path

import pytest

from calib.model.ros_packages import find_package, named_so, packages_in, where_packages_are


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


def test_the_package_that_the_file_lies_in(file: Path):
    assert find_package("my_cell", file) == file.parents[1]


def test_a_package_beside_it_whatever_its_folder_is_called(file: Path):
    arm = package(file.parents[2] / "Arm_Description", "arm_description")
    assert find_package("arm_description", file) == arm
    assert find_package("Arm_Description", file) is None


def test_a_package_in_another_repository_of_the_workspace(file: Path):
    arm = package(file.parents[2] / "drivers" / "arm", "arm_description")
    assert find_package("arm_description", file) == arm
    assert find_package("arm_description", file.parents[4] / "robot.urdf.xacro") is None


def test_a_folder_without_a_manifest_is_the_last_that_counts(file: Path):
    plain = file.parents[3] / "arm_description"
    plain.mkdir()
    assert find_package("arm_description", file) == plain
    arm = package(file.parents[2] / "drivers" / "arm", "arm_description")
    assert find_package("arm_description", file) == arm


def test_the_path_of_ros_1_and_its_folders_below(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    package(file.parents[2] / "arm_description", "arm_description")
    other = package(tmp_path / "noetic" / "stacks" / "arms" / "arm", "arm_description")
    package(tmp_path / "noetic" / ".git" / "arm", "arm_description")
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"{tmp_path / 'none'}:{tmp_path / 'noetic'}")
    assert find_package("arm_description", file) == other
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(other))
    assert find_package("arm_description", file) == other


def test_the_index_of_ros_2_comes_first(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    package(file.parents[2] / "arm_description", "arm_description")
    prefix = tmp_path / "humble"
    share = package(prefix / "share" / "arm_description", "arm_description")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path / 'none'}:{prefix}")
    assert find_package("arm_description", file) == file.parents[2] / "arm_description"
    index = prefix / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True)
    (index / "arm_description").touch()
    assert find_package("arm_description", file) == share


@pytest.mark.parametrize("name", ["", ".", "..", "../cell", "/", "a b", "*", "cell/urdf", "~"])
def test_what_is_no_name_is_no_package(file: Path, name: str):
    assert find_package(name, file) is None


def test_what_cannot_be_read_is_no_package(tmp_path: Path):
    assert list(packages_in(tmp_path / "nothing", "p")) == []
    (tmp_path / "package.xml").mkdir()
    assert not named_so(tmp_path, "p")
    assert not named_so(package(tmp_path / "q", ""), "")


def test_packages_do_not_lie_in_one_another(tmp_path: Path):
    outer = package(tmp_path / "outer", "outer")
    package(outer / "inner", "inner")
    assert list(packages_in(tmp_path, "outer")) == [outer]
    assert list(packages_in(tmp_path, "inner", 5)) == []


def test_where_it_looked(file: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("ROS_PACKAGE_PATH", "/ros/share")
    said = where_packages_are(file)
    assert said.startswith("AMENT_PREFIX_PATH (not set), ROS_PACKAGE_PATH (/ros/share), and the")
    assert said.endswith(f"beside '{file}'")
