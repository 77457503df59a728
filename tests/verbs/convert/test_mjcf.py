"""A result found on a URDF stands in an MJCF of the same robot, by MuJoCo; or nothing is written."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib.example
from calib.errors import CalibError, FileError, ModelError
from calib.result.calibration import Calibration
from calib.verbs.convert.convert import convert
from calib.verbs.convert.format import Options
from tests.robot.mujoco_truth import Truth
from tests.robot.ur3_mjcf import NAMES, ur3_mjcf

Q = np.random.default_rng(4).uniform(-2, 2, (20, 6))


def test_a_result_of_the_urdf_is_where_mujoco_finds_the_tip(
    default_result: Calibration, tmp_path: Path
):
    scene = ur3_mjcf(tmp_path / "scene.xml")
    options = Options(tip="flange")
    done = convert(default_result, tmp_path / "new.xml", robot=scene, options=options)
    assert done.format == "mjcf"
    assert [note.code for note in done.notes] == ["axes agree", "corrected MJCF"]
    mm, mrad = done.notes[0].values[2:4]
    assert max(float(mm), float(mrad)) < 1e-10

    # From where the nominal robots agree: bases and tips differ by constants.
    names = [f"{name}_joint" for name in NAMES]
    nominal, result = default_result.nominal, default_result.robot
    before = Truth(scene).poses(names, Q, "world", "flange")
    zero = np.zeros((1, 6))
    by_urdf = nominal.poses(Q)
    # T_mjcf = B T_urdf C; the UR3's tool0 is the frame of its last row.
    B = before[0] @ np.linalg.inv(by_urdf[0])
    np.testing.assert_allclose(B @ by_urdf, before, rtol=0.0, atol=1e-10)
    after = Truth(tmp_path / "new.xml").poses(names, Q, "world", "flange")
    np.testing.assert_allclose(after, B @ result.poses(Q), rtol=0.0, atol=1e-9)
    assert np.abs(after - before)[:, :3, 3].max() > 1e-3
    assert nominal.poses(zero).shape == (1, 4, 4)


def test_joints_of_other_names_are_matched_by_order_and_geometry(
    default_result: Calibration, tmp_path: Path
):
    scene = ur3_mjcf(tmp_path / "scene.xml")
    scene.write_text(scene.read_text().replace("_joint", ""))
    done = convert(default_result, tmp_path / "new.xml", robot=scene)
    assert "joints by their order" in [note.code for note in done.notes]
    assert "elbow_joint = elbow" in done.notes[1].text


def test_nothing_is_written_into_another_robot(default_result: Calibration, tmp_path: Path):
    scene = ur3_mjcf(tmp_path / "scene.xml", longer=(0.0, 0.0005))
    with pytest.raises(ModelError, match="wrist_1_joint"):
        convert(default_result, tmp_path / "new.xml", robot=scene)
    assert not (tmp_path / "new.xml").exists()
    with pytest.raises(ModelError, match="--tip"):
        convert(
            default_result,
            tmp_path / "new.xml",
            robot=ur3_mjcf(tmp_path / "other.xml"),
            options=Options(tip="elbow"),
        )


def test_it_wants_a_result_and_an_mjcf(default_result: Calibration, tmp_path: Path):
    with pytest.raises(CalibError, match="made from a calibration"):
        convert(calib.example.paper_urdf(), tmp_path / "new.xml")
    with pytest.raises(CalibError, match="no MuJoCo model"):
        convert(default_result, tmp_path / "new.xml", robot=calib.example.paper_urdf())
    with pytest.raises(FileError, match="--robot"):
        convert(default_result, tmp_path / "new.xml")
    several = replace(default_result.nominal, parts=("any",))  # type: ignore[arg-type]
    with pytest.raises(ModelError, match="several"):
        convert(replace(default_result, nominal=several), tmp_path / "new.xml")


def test_a_urdf_is_not_called_xml(tmp_path: Path):
    with pytest.raises(FileError, match=r"name it \.urdf"):
        convert(calib.example.paper_urdf(), tmp_path / "new.xml", to="urdf")
