from __future__ import annotations

from pathlib import Path

import pytest

from calib.model.xacro_file import package_folder, packages_in


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
    assert package_folder("my_cell", file) == file.parents[1]


def test_a_package_beside_it_whatever_its_folder_is_called(file: Path):
    arm = package(file.parents[2] / "Arm_Description", "arm_description")
    assert package_folder("arm_description", file) == arm


def test_a_package_in_another_repository_of_the_workspace(file: Path):
    arm = package(file.parents[2] / "drivers" / "arm", "arm_description")
    assert package_folder("arm_description", file) == arm


def test_a_folder_without_a_manifest_is_the_last_that_counts(file: Path):
    plain = file.parents[3] / "arm_description"
    plain.mkdir()
    assert package_folder("arm_description", file) == plain
    arm = package(file.parents[2] / "drivers" / "arm", "arm_description")
    assert package_folder("arm_description", file) == arm


def test_the_path_of_ros_1_and_its_folders_below(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    package(file.parents[2] / "arm_description", "arm_description")
    other = package(tmp_path / "noetic" / "stacks" / "arms" / "arm", "arm_description")
    package(tmp_path / "noetic" / ".git" / "arm", "arm_description")
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"{tmp_path / 'none'}:{tmp_path / 'noetic'}")
    assert package_folder("arm_description", file) == other
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(other))
    assert package_folder("arm_description", file) == other


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


def test_packages_do_not_lie_in_one_another(tmp_path: Path):
    outer = package(tmp_path / "outer", "outer")
    package(outer / "inner", "inner")
    assert list(packages_in(tmp_path, "outer")) == [outer]
    assert list(packages_in(tmp_path, "inner", 5)) == []


@pytest.mark.parametrize("name", ["", ".", "..", "nothing"])
def test_a_package_that_is_not_there(file: Path, monkeypatch: pytest.MonkeyPatch, name: str):
    monkeypatch.setenv("ROS_PACKAGE_PATH", "/ros/share")
    with pytest.raises(
        LookupError, match=r"'.*' in AMENT_PREFIX_PATH \(not set\), ROS_PACKAGE_PATH \(/ros/share\)"
    ):
        package_folder(name, file)
