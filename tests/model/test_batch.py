from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from calib.errors import ModelError
from calib.model import batch
from calib.model.batch import MANY, chunks, in_threads, poses_of, robot_poses, twists_of, warm_up
from calib.model.error_model import error_model
from calib.model.kinematics import Kinematics, Samples
from calib.model.robot import Robot
from tests.model.test_kinematics import CHAINS, pose, robots  # noqa: F401

FAMILIES = "+gain+eccentricity+compliance"
NAMES = ("ur3", "panda", "prismatic", "mimic", "tiago_held", *CHAINS)


def seen(robot: Robot, model: str, seed: int, count: int = 150) -> tuple[Kinematics, Samples]:
    """Two frames and two targets, each with an orientation, at random joint values."""
    rng = np.random.default_rng(seed)
    directions = ("x", "y", "z", "rx", "ry", "rz")
    own = error_model(
        robot,
        model,
        frame={"a": directions, "b": directions[1:4]},
        target=("left", "right"),
        targets=("left", "right"),
        rotation=True,
    )
    kinematics = Kinematics(
        robot, own, np.array([pose(1), pose(2)]), np.array([pose(3, 0.2), pose(4, 0.2)])
    )
    samples = Samples(
        rng.uniform(-3.0, 3.0, (count, len(robot.joint_names))),
        rng.integers(0, 2, count),
        rng.integers(0, 2, count),
        rng.normal(0.0, 20.0, (count, len(robot.joints))),
    )
    return kinematics, samples


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("model", ["hayati", "placement"])
def test_the_kernel_says_what_pinocchio_says(robots, name, model):  # noqa: F811
    kinematics, samples = seen(robots[name], model + FAMILIES, len(name))
    x = np.random.default_rng(5).normal(0.0, 1e-3, len(kinematics.model))
    expected_poses, expected_twists = kinematics.twists(x, samples)
    found_poses, found_twists = twists_of(kinematics, x, samples)
    np.testing.assert_allclose(found_poses, expected_poses, atol=2e-14)
    np.testing.assert_allclose(found_twists, expected_twists, rtol=1e-12, atol=2e-12)
    np.testing.assert_array_equal(poses_of(kinematics, x, samples), found_poses)


@pytest.mark.parametrize("name", ["ur3", "tiago_held", "panda_finger_to_base"])
def test_poses_of_the_robot_itself(robots, name):  # noqa: F811
    robot = robots[name]
    q = np.random.default_rng(0).uniform(-2.0, 2.0, (70, len(robot.joint_names)))
    expected = robot.poses(q)
    np.testing.assert_allclose(robot_poses(robot, robot.chain_values(q)), expected, atol=2e-14)
    # Many are computed the same way, in the same rows.
    many = np.tile(q, (MANY // len(q) + 1, 1))
    np.testing.assert_allclose(robot.poses(many)[: len(q)], expected, atol=2e-14)


def test_many_samples_take_the_kernel_and_few_do_not(ur3):
    kinematics, samples = seen(ur3, "dh", 0, MANY)
    x = np.full(len(kinematics.model), 1e-3)
    poses, twists = kinematics.twists(x, samples)
    by_kernel = twists_of(kinematics, x, samples)
    np.testing.assert_array_equal(poses, by_kernel[0])
    np.testing.assert_array_equal(twists, by_kernel[1])
    np.testing.assert_array_equal(kinematics.poses(x, samples), poses)
    few = samples.select(slice(0, 10))
    by_pinocchio = kinematics.twists(x, few)
    np.testing.assert_allclose(by_pinocchio[1], twists[:10], rtol=1e-12, atol=2e-12)


def test_joints_that_have_turned_very_far_round(ur3):
    kinematics, samples = seen(ur3, "zeros+gain", 0, 40)
    x = np.zeros(len(kinematics.model))
    turned = Samples(samples.q + 2e6 * np.pi, samples.frame, samples.target)
    # Adding the turns rounds the joint values by 1e-9.
    np.testing.assert_allclose(
        poses_of(kinematics, x, turned), kinematics.poses(x, turned), atol=1e-13
    )


def test_a_compliance_needs_the_load(ur3):
    kinematics, samples = seen(ur3, "zeros+compliance", 0, 20)
    without = Samples(samples.q, samples.frame, samples.target)
    with pytest.raises(ModelError, match="needs the load on the joints"):
        poses_of(kinematics, np.zeros(len(kinematics.model)), without)


def test_chunks_cover_everything_once():
    assert list(chunks(0)) == []
    parts = list(chunks(2 * batch.CHUNK + 5))
    assert parts[0] == (0, batch.CHUNK)
    assert parts[-1] == (2 * batch.CHUNK, 2 * batch.CHUNK + 5)
    assert [a for a, _ in parts[1:]] == [b for _, b in parts[:-1]]


@pytest.mark.parametrize("threads", ["1", "3", "many"])
def test_threads_give_results_in_the_order_of_the_chunks(monkeypatch, threads):
    monkeypatch.setenv("OMP_NUM_THREADS", threads)
    count = 9 * batch.CHUNK + 1
    found = in_threads(lambda first, last: (first, last), count)
    assert found == list(chunks(count))


def test_work_in_a_thread_may_ask_for_chunks_itself(monkeypatch):
    """It must not wait for threads that all wait for theirs."""
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    count = 5 * batch.CHUNK

    def work(first: int, last: int) -> int:
        return sum(in_threads(lambda a, b: b - a, count)) + last - first

    assert sum(in_threads(work, count)) == count + 5 * count


def test_the_kernel_can_be_compiled_beforehand():
    warm_up()  # does not say anything
    warm_up()


def test_the_same_code_interpreted_says_the_same():
    """What is compiled is Python: run as such it gives the same numbers, and shows that no step is left out."""
    code = """
import numpy as np
from calib.model.batch import twists_of, warm_up
from calib.model.kinematics import Kinematics
from tests.model.test_batch import seen
import calib
robot = calib.Robot.load("ur3", base="base", tip="tool0")
warm_up()
kinematics, samples = seen(robot, "dh+gain", 3, 5)
x = np.full(len(kinematics.model), 1e-3)
poses, twists = twists_of(kinematics, x, samples)
expected_poses, expected_twists = kinematics.twists(x, samples)
np.testing.assert_allclose(poses, expected_poses, atol=1e-13)
np.testing.assert_allclose(twists, expected_twists, rtol=1e-11, atol=1e-11)
print("same")
"""
    ran = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.stdout == "same\n", ran.stderr


def test_a_forked_process_has_threads_of_its_own():
    code = """
import os, warnings
from calib.model import batch
warnings.simplefilter("ignore", DeprecationWarning)  # Python 3.12 warns of the very thing that is looked at
work, count = (lambda first, _: first), 3 * batch.CHUNK
assert len(batch.in_threads(work, count)) == 3
child = os.fork()
if child == 0:
    os._exit(len(batch.in_threads(work, count)))
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
    ran = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"OMP_NUM_THREADS": "2"},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert ran.stdout == "3\n", ran.stderr
