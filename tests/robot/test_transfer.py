"""A correction of one description put into another with frames of its own; robots that differ are told apart."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.errors import ModelError
from calib.robot.robot import Robot
from calib.robot.transfer import transferred
from tests.robot.mujoco_truth import perturbed
from tests.robot.ur3_mjcf import ur3_mjcf

#: Slides between turns, so that a slide's frame may be anywhere.
SLIDING = Path(__file__).parent / "mjcf"


def elsewhere(robot: Robot, seed: int) -> Robot:
    """The same robot with frames moved along their axes and turned about them, in another base, with another tip.

    The joints' frames keep the axis' own vector, so that the axis stays where it is.
    """
    rng = np.random.default_rng(seed)
    changes = []
    for joint in robot.joints:
        C = np.eye(4)
        C[:3, :3] = Rotation.from_rotvec(rng.uniform(-3.0, 3.0) * joint.axis).as_matrix()
        C[:3, 3] = rng.uniform(-0.2, 0.2) * joint.axis
        if joint.type == "prismatic":
            C[:3, 3] = rng.uniform(-0.2, 0.2, 3)
        changes.append(C)
    ends = []
    for _ in range(2):
        T = np.eye(4)
        T[:3, :3] = Rotation.random(random_state=rng).as_matrix()
        T[:3, 3] = rng.uniform(-0.3, 0.3, 3)
        ends.append(T)
    before = [ends[0], *changes]
    after = [*changes, ends[1]]
    placements = [
        np.linalg.inv(B) @ P @ A for B, P, A in zip(before, robot.placements, after, strict=True)
    ]
    return robot.with_placements(np.array(placements))


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("name", ["ur3", "panda", "scara", "ref"])
def test_both_descriptions_move_alike_after_the_correction(
    name: str, seed: int, ur3: Robot, panda: Robot
):
    robots = {"ur3": ur3, "panda": panda, "scara": scara()}
    nominal = robots.get(name) or Robot.load(SLIDING / f"{name}.xml")
    other = elsewhere(nominal, seed)
    corrected = perturbed(nominal, seed)
    transfer = transferred(nominal, corrected, other)
    assert max(transfer.off) < 1e-12
    q = np.random.default_rng(seed).uniform(-2.0, 2.0, (50, len(nominal.joints)))
    by_other = transfer.robot.poses(q)
    expected = transfer.T_base_base @ corrected.poses(q) @ transfer.T_tip_tip
    np.testing.assert_allclose(by_other, expected, rtol=0.0, atol=1e-12)
    # What takes the bases and tips to each other is that of the nominal robots, and no part of the correction.
    before = transfer.T_base_base @ nominal.poses(q) @ transfer.T_tip_tip
    np.testing.assert_allclose(other.poses(q), before, rtol=0.0, atol=1e-12)


def scara() -> Robot:
    from calib import DHRow

    return Robot.from_dh(
        [
            DHRow("J1", d=0.4, a=0.325, lower=-2.3, upper=2.3),
            DHRow("J2", a=0.275, alpha=np.pi, lower=-2.6, upper=2.6),
            DHRow("J3", prismatic=True, lower=0.0, upper=0.2),
            DHRow("J4", lower=-6.28, upper=6.28),
        ]
    )


def test_an_mjcf_of_dh_frames_takes_what_was_found_on_the_urdf(ur3: Robot, tmp_path: Path):
    other = Robot.load(ur3_mjcf(tmp_path / "ur3.xml"), tip="flange")
    assert np.abs(other.placements[1:] - ur3.placements[1:]).max() > 0.1  # frames are elsewhere
    corrected = perturbed(ur3, 4)
    transfer = transferred(ur3, corrected, other)
    assert max(transfer.off) < 1e-10
    q = np.random.default_rng(4).uniform(-2.0, 2.0, (20, 6))
    expected = transfer.T_base_base @ corrected.poses(q) @ transfer.T_tip_tip
    np.testing.assert_allclose(transfer.robot.poses(q), expected, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(("axis", "joint"), [(0, "elbow_joint"), (1, "wrist_1_joint")])
def test_the_first_joint_that_differs_is_named(axis: int, joint: str, ur3: Robot, tmp_path: Path):
    lengths = [0.0, 0.0]
    lengths[axis] = 0.0005
    path = ur3_mjcf(tmp_path / "ur3.xml", longer=tuple(lengths))
    with pytest.raises(ModelError, match=f"up to '{joint}' laid on"):
        transferred(ur3, ur3, Robot.load(path, tip="flange"))


def test_a_zero_that_differs_and_an_axis_turned_round_are_found(ur3: Robot, tmp_path: Path):
    for text in ('ref="0.05"', 'axis="0 0 -1"'):
        path = ur3_mjcf(tmp_path / "ur3.xml")
        changed = path.read_text().replace('name="elbow_joint"', f'name="elbow_joint" {text}')
        path.write_text(changed)
        with pytest.raises(ModelError, match="are not the same robot"):
            transferred(ur3, ur3, Robot.load(path, tip="flange"))


def test_other_joints_are_refused(ur3: Robot, panda: Robot):
    with pytest.raises(ModelError, match="their number"):
        transferred(ur3, ur3, panda)
    held = Robot.from_urdf(ur3.urdf, "base", "tool0", held={"elbow_joint": 0.5})
    with pytest.raises(ModelError, match="the same readings"):
        transferred(ur3, ur3, held)
