"""Corrected MJCFs: MuJoCo finds the corrected robot in them, and no byte changed but numbers of what moved."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import mujoco
import numpy as np
import pytest

from calib.errors import FileError, UrdfError
from calib.robot.mjcf import Mjcf
from calib.robot.mjcf_readback import check_by_mujoco
from calib.robot.mjcf_write import WrittenMjcf, check_mjcf_output, model_of, write_mjcf
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from tests.robot.mujoco_truth import MODELS, Truth, perturbed, product

TRAPS = sorted(MODELS.glob("*.xml"))

#: Attributes that a correction may change.
_CHANGED = re.compile(
    rb"\s(pos|quat|euler|axisangle|xyaxes|zaxis|axis|fromto|file)=(\"[^\"]*\"|'[^']*')"
)


def corrected(path: Path, output: Path, robot: Robot) -> WrittenMjcf:
    q = random_joint_values(robot)
    return write_mjcf(Mjcf.read(path), robot, q, product(robot, q), output, overwrite=False)


def with_names(path: Path) -> Truth:
    """MuJoCo's reading of a file, its joints without a name called as calib calls them."""
    spec = mujoco.MjSpec.from_file(str(path))
    model = Mjcf.read(path)
    joints = [joint.name for body in model.bodies for joint in body.joints]
    for joint, name in zip(spec.joints, joints, strict=True):
        joint.name = name
    truth = Truth.__new__(Truth)
    truth.model = spec.compile()
    truth.data = mujoco.MjData(truth.model)
    return truth


@pytest.mark.parametrize("path", TRAPS, ids=lambda path: path.stem)
def test_mujoco_finds_the_corrected_robot(path: Path, tmp_path: Path):
    tip = "hand" if path.stem == "beside" else None
    robot = perturbed(Robot.load(path, tip=tip), seed=5)
    written = corrected(path, tmp_path / "corrected.xml", robot)
    assert written.read_by_mujoco
    q = np.random.default_rng(6).uniform(-2.0, 2.0, (30, len(robot.joint_names)))
    truth = with_names(written.paths[0])
    poses = truth.poses(list(robot.joint_names), q, robot.base, robot.tip)
    np.testing.assert_allclose(poses, product(robot, q), rtol=0.0, atol=1e-9)
    # It is another robot than before, by millimetres.
    before = Robot.load(path, tip=tip).poses(q)
    assert np.abs(before - poses)[:, :3, 3].max() > 2e-3


@pytest.mark.parametrize("path", TRAPS, ids=lambda path: path.stem)
def test_only_numbers_of_what_moved_change(path: Path, tmp_path: Path):
    written = corrected(path, tmp_path / "corrected.xml", perturbed(Robot.load(path), seed=7))
    files = Mjcf.read(path).files.files
    assert len(written.paths) == len(files)
    for file, new in zip(files, written.paths, strict=True):
        before, after = file.document.data, new.read_bytes()
        assert _CHANGED.sub(b"", before) == _CHANGED.sub(b"", after)


@pytest.mark.parametrize("path", TRAPS, ids=lambda path: path.stem)
def test_a_robot_that_did_not_change_is_the_same_file(path: Path, tmp_path: Path):
    folder = tmp_path / "mjcf"
    shutil.copytree(MODELS, folder)
    written = corrected(folder / path.name, folder / "same.xml", Robot.load(folder / path.name))
    assert written.paths == (folder / "same.xml",)
    assert written.paths[0].read_bytes() == path.read_bytes()
    assert not written.changed_joints
    assert not written.new_quats


def test_forms_of_orientation_stay_and_two_become_quats(tmp_path: Path):
    path = MODELS / "orientations.xml"
    robot = perturbed(Robot.load(path), seed=8)
    written = corrected(path, tmp_path / "c.xml", robot)
    text = written.paths[0].read_text()
    assert written.new_quats == ("body 'z'", "body 'down'", "site 'ends'")
    for name, form in (("q", "quat"), ("z", "quat"), ("xy", "xyaxes"), ("aa", "axisangle")):
        tag = re.search(f'<body name="{name}"[^>]*>', text)
        assert tag is not None
        assert f" {form}=" in tag[0]
    angle = float(text.split('axisangle="')[1].split('"')[0].split()[3])
    assert angle == pytest.approx(200.0, abs=10.0)


def test_angles_are_those_near_the_old_ones(tmp_path: Path):
    path = MODELS / "eulerseq.xml"
    written = corrected(path, tmp_path / "c.xml", perturbed(Robot.load(path), seed=9))
    angles = [
        [float(word) for word in text.split()]
        for text in re.findall('euler="([^"]*)"', written.paths[0].read_text())
    ]
    np.testing.assert_allclose(angles[0], (30, 40, 50), atol=8.0)
    np.testing.assert_allclose(angles[2], (-20, 0, 0), atol=8.0)


def test_several_joints_in_a_body_change_their_axes_but_the_last_one(tmp_path: Path):
    path = MODELS / "several_joints.xml"
    written = corrected(path, tmp_path / "c.xml", perturbed(Robot.load(path), seed=10))
    assert written.changed_joints == ("s1", "s2", "f1")


def test_a_tip_on_an_offset_axis_moves_by_its_own_element(tmp_path: Path):
    # The tip that a joint with pos moves directly changes that joint's pos; a tool fixed to it does not.
    path = MODELS / "joint_pos.xml"
    assert corrected(
        path, tmp_path / "c.xml", perturbed(Robot.load(path), seed=11)
    ).changed_joints == ("j3",)
    text = path.read_text().replace(
        "</body>\n      </body>", '<site name="tool" pos="0 0 0.1"/></body>\n      </body>', 1
    )
    (tmp_path / "tool.xml").write_text(text)
    robot = Robot.load(tmp_path / "tool.xml", tip="tool")
    written = corrected(tmp_path / "tool.xml", tmp_path / "d.xml", perturbed(robot, seed=11))
    assert written.changed_joints == ()


def test_included_files_get_names_of_their_own_beside_the_output(tmp_path: Path):
    folder = tmp_path / "mjcf"
    shutil.copytree(MODELS, folder)
    robot = Robot.load(folder / "include.xml")
    placements = robot.placements.copy()
    placements[1, 0, 3] += 0.001  # of the body 'lower', in parts/wrist.xml
    changed = robot.with_placements(placements)
    written = corrected(folder / "include.xml", folder / "new.xml", changed)
    names = [path.relative_to(folder).as_posix() for path in written.paths]
    assert names == ["new.xml", "new_arm.xml", "new_wrist.xml"]
    assert '<include file="parts/settings.xml"/>' in (folder / "new.xml").read_text()
    assert (folder / "parts/wrist.xml").read_bytes() == (MODELS / "parts/wrist.xml").read_bytes()
    wrist = (folder / "new_wrist.xml").read_text()
    assert "pos='0.301 0.0 0.0'\n        euler='0 -0.4 0'" in wrist
    with pytest.raises(FileError, match="exists already"):
        corrected(folder / "include.xml", folder / "new.xml", changed)


def test_no_file_of_the_model_is_written_over(tmp_path: Path):
    shutil.copytree(MODELS, tmp_path / "m")
    path = tmp_path / "m/ref.xml"
    robot = Robot.load(path)
    with pytest.raises(FileError, match="a file of the model itself"):
        check_mjcf_output(robot, path)
    q = random_joint_values(robot)
    with pytest.raises(FileError, match="a file of the model itself"):
        write_mjcf(Mjcf.read(path), robot, q, robot.poses(q), path, overwrite=True)


def test_a_urdf_is_no_mjcf_under_another_name(ur3: Robot, tmp_path: Path):
    with pytest.raises(FileError, match="--to mjcf"):
        check_mjcf_output(ur3, tmp_path / "corrected.xml")
    check_mjcf_output(ur3, tmp_path / "corrected.urdf")
    with pytest.raises(FileError, match=r"name it \.urdf"):
        ur3.urdf.write(tmp_path / "corrected.xml")
    # Nor is the URDF that was made of an MJCF, when it is read from a file of its own.
    robot = Robot.load(MODELS / "ref.xml")
    robot.urdf.write(tmp_path / "ref.urdf")
    with pytest.raises(FileError, match="--to mjcf"):
        check_mjcf_output(Robot.load(tmp_path / "ref.urdf"), tmp_path / "corrected.xml")


def test_a_model_that_changed_or_is_gone_is_asked_for(tmp_path: Path):
    shutil.copytree(MODELS, tmp_path / "m")
    path = tmp_path / "m/include.xml"
    urdf = Robot.load(path).urdf
    model_of(urdf, "x.xml")
    part = tmp_path / "m/parts/wrist.xml"
    part.write_text(part.read_text().replace("0.3 0 0", "0.31 0 0"))
    with pytest.raises(UrdfError, match="was changed"):
        model_of(urdf, "x.xml")
    path.unlink()
    with pytest.raises(FileError, match="is not there"):
        model_of(urdf, "x.xml")


def test_a_wrong_file_is_not_written(tmp_path: Path):
    robot = Robot.load(MODELS / "ref.xml")
    q = random_joint_values(robot)
    wrong = robot.poses(q)
    wrong[3, 0, 3] += 2e-9
    model = Mjcf.read(MODELS / "ref.xml")
    with pytest.raises(UrdfError, match="calib"):
        write_mjcf(model, robot, q, wrong, tmp_path / "c.xml", overwrite=False)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(UrdfError, match="MuJoCo"):
        check_by_mujoco(model, robot, q, wrong)


def test_a_verdict_stands_in_a_comment(tmp_path: Path):
    path = MODELS / "ref.xml"
    robot = Robot.load(path)
    q = random_joint_values(robot)
    write_mjcf(
        Mjcf.read(path),
        robot,
        q,
        robot.poses(q),
        tmp_path / "c.xml",
        overwrite=False,
        verdict="do not use: noise",
    )
    data = (tmp_path / "c.xml").read_bytes()
    assert data == b"<!-- calib verdict: do not use: noise -->\n" + path.read_bytes()
