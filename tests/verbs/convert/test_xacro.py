"""A result becomes a corrected xacro; files that it includes are written beside the output, and named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import calib.example
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.errors import CalibError, FileError, UrdfError
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.robot import Robot
from calib.robot.xacro_file import XacroCall, flatten
from calib.verbs.convert.convert import convert
from tests.robot.mujoco_truth import perturbed
from tests.robot.test_xacro_origins import written


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("xacro")
    written(folder)
    return folder


@pytest.fixture(scope="module")
def of_xacro(folder: Path) -> Calibration:
    nominal = Robot.load(f"{folder / 'arm.urdf.xacro'} prefix:=b_")
    true = perturbed(nominal, 5)
    rng = np.random.default_rng(5)
    q = rng.uniform(-1.0, 1.0, (60, 4))
    points = (true.poses(q) @ [0.05, 0.02, 0.1, 1.0])[:, :3] + rng.normal(0.0, 2e-5, (60, 3))
    cell = Cell(target=np.array([0.05, 0.02, 0.1]), model="placement")
    table = Measurements(nominal.joint_names, q, points)
    return calibrate(nominal, table, cell=cell, validate=False)


@pytest.mark.slow
def test_it_flattens_to_the_corrected_robot(of_xacro: Calibration, folder: Path, tmp_path: Path):
    done = convert(of_xacro, tmp_path / "new.urdf.xacro")
    assert done.format == "xacro"
    new_files = sorted(path.name for path in tmp_path.iterdir())
    assert new_files == ["new.urdf.xacro", "new_link.xacro"]
    named = {str(value) for note in done.notes for value in note.values}
    assert str((folder / "parts/link.xacro").resolve()) in named

    # In their places they are the corrected robot.
    there = tmp_path / "there"
    there.mkdir()
    written(there)
    (there / "arm.urdf.xacro").write_bytes((tmp_path / "new.urdf.xacro").read_bytes())
    (there / "parts/link.xacro").write_bytes((tmp_path / "new_link.xacro").read_bytes())
    call = XacroCall(there / "arm.urdf.xacro", (("prefix", "b_"),))
    (there / "flat.urdf").write_bytes(flatten(call))
    robot = Robot.load(there / "flat.urdf", tip=of_xacro.robot.tip)
    q = np.random.default_rng(6).uniform(-1.0, 1.0, (10, 4))
    np.testing.assert_allclose(robot.poses(q), of_xacro.robot.poses(q), rtol=0.0, atol=1e-12)

    with pytest.raises(FileError, match="exists already"):
        convert(of_xacro, tmp_path / "new.urdf.xacro")
    with pytest.raises(FileError, match="a file of the xacro itself"):
        convert(of_xacro, folder / "arm.urdf.xacro", overwrite=True)


@pytest.mark.slow
def test_a_result_file_finds_its_xacro_or_asks_for_it(
    of_xacro: Calibration, folder: Path, tmp_path: Path
):
    of_xacro.write_json(tmp_path / "result.json")
    with pytest.raises(FileError, match="is not there"):
        convert(tmp_path / "result.json", tmp_path / "new.xacro")
    with pytest.raises(CalibError, match="no xacro"):
        convert(tmp_path / "result.json", tmp_path / "new.xacro", robot=folder / "arm.urdf")
    with pytest.raises(UrdfError, match="b_pan"):
        convert(tmp_path / "result.json", tmp_path / "new.xacro", robot=folder / "arm.urdf.xacro")
    call = f"{folder / 'arm.urdf.xacro'} prefix:=b_"
    convert(tmp_path / "result.json", tmp_path / "new.xacro", robot=call)
    of_xacro.write_json(folder / "result.json")
    convert(folder / "result.json", tmp_path / "same.xacro")
    assert (tmp_path / "new.xacro").read_bytes() == (tmp_path / "same.xacro").read_bytes()


def test_a_urdf_that_was_no_xacro_has_none(default_result: Calibration, tmp_path: Path):
    with pytest.raises(CalibError, match="not flattened"):
        convert(default_result, tmp_path / "new.xacro")
    with pytest.raises(CalibError, match="made from a calibration"):
        convert(calib.example.paper_urdf(), tmp_path / "new.xacro")
