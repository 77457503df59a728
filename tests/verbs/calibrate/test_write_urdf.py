"""A calibration of a robot from an MJCF writes a corrected MJCF, which MuJoCo reads; of a URDF it writes none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.errors import FileError, ModelError
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.robot import Robot
from calib.verbs.convert.convert import convert
from tests.robot.mujoco_truth import MODELS, Truth, perturbed


@pytest.fixture(scope="module")
def of_mjcf() -> Calibration:
    """Of 60 points measured without much noise on a robot that differs from its MJCF."""
    nominal = Robot.load(MODELS / "include.xml")
    true = perturbed(nominal, 12)
    rng = np.random.default_rng(12)
    q = rng.uniform(-1.0, 1.0, (60, 3))
    points = (true.poses(q) @ [0.05, 0.02, 0.1, 1.0])[:, :3] + rng.normal(0.0, 2e-5, (60, 3))
    table = Measurements(nominal.joint_names, q, points)
    cell = Cell(target=np.array([0.05, 0.02, 0.1]), model="placement")
    return calibrate(nominal, table, cell=cell, validate=False)


def test_the_corrected_mjcf_predicts_as_the_result_does(of_mjcf: Calibration, tmp_path: Path):
    path = of_mjcf.write_urdf(tmp_path / "corrected.xml")
    q = np.random.default_rng(13).uniform(-1.0, 1.0, (10, 3))
    robot = of_mjcf.robot
    poses = Truth(path).poses(list(robot.joint_names), q, robot.base, robot.tip)
    by_mujoco = (poses @ [*of_mjcf.target, 1.0])[:, :3]
    np.testing.assert_allclose(by_mujoco, of_mjcf.predict(q), rtol=0.0, atol=1e-9)
    with pytest.raises(FileError, match="exists already"):
        of_mjcf.write_urdf(path)
    # The URDF that calib works on can be had too.
    assert Robot.load(of_mjcf.write_urdf(tmp_path / "c.urdf"), tip=robot.tip).urdf == robot.urdf


def test_a_result_from_its_file_finds_the_mjcf_beside_it(of_mjcf: Calibration, tmp_path: Path):
    of_mjcf.write_json(tmp_path / "result.json")
    with pytest.raises(FileError, match="is not there"):
        convert(tmp_path / "result.json", tmp_path / "new.xml", to="mjcf")
    convert(tmp_path / "result.json", tmp_path / "new.xml", robot=MODELS / "include.xml")
    of_mjcf.write_urdf(tmp_path / "same.xml")
    for part in ("arm", "wrist"):
        one, other = (tmp_path / f"{name}_{part}.xml" for name in ("new", "same"))
        text = one.read_text().replace("new_", "same_")
        assert text == other.read_text()


def test_links_are_added_to_urdfs_and_no_urdf_is_called_xml(
    of_mjcf: Calibration, default_result: Calibration, tmp_path: Path
):
    with pytest.raises(ModelError, match=r"name the file \.urdf"):
        of_mjcf.write_urdf(tmp_path / "c.xml", target_link=True)
    with pytest.raises(FileError, match="--to mjcf"):
        default_result.write_urdf(tmp_path / "c.xml")
