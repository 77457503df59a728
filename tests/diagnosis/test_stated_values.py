"""Stated values that the rows contradict: the base, the instrument's scale, lenses, boards, covariances of poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from calib.data.cell import Cell
from calib.diagnosis.augmented_fit import estimate_jointly
from calib.diagnosis.reasons import Why
from calib.diagnosis.stated_values import (
    Scale,
    _idle_covariances,
    _p_of_offset,
    _wrong_internals,
    contradicted_values,
    instrument_scale,
    motion_of_base,
)
from calib.fit.estimate.fitting import fit
from calib.fit.estimate.task import Task
from calib.fit.registration.setup import known_distances
from calib.fit.registration.table_rows import rows_and_setup
from calib.model.families import ANGLE, FAMILIES, ZERO
from calib.robot.ranges import random_joint_values
from tests.covariances import random_covariances
from tests.fit.estimate.special_cases.test_pose_covariances import table_with
from tests.fits import SOCKETS, TARGETS, gaps, in_each
from tests.images import BOARD, BODY, VALUES, arm as camera_arm, camera, cell, poses, table
from tests.judged import arm, fit_to, moved, table_of


@pytest.fixture(scope="module")
def clean(make_scene):
    """A wrong UR3 and forty points of it in its base frame."""
    scene = arm(make_scene, 7)
    q = random_joint_values(scene.robot, 40, 7)
    return scene, table_of(scene, q, np.random.default_rng(7))


@pytest.mark.parametrize(
    ("by", "about"),
    [((4e-3, 3e-3, 0.0), (0.0, 0.0, 0.0)), ((0.0, 0.0, 0.0), (32e-3, -24e-3, 0.0))],
)
def test_a_base_that_has_moved_across_its_first_axis(clean, by, about):
    scene, table = clean
    motion = motion_of_base(fit_to(scene, moved(table, by, about)))
    height = scene.robot.placements[0][2, 3]
    # The first joint's origin, above that of the base, moves with it.
    origin = np.linalg.norm(np.array(by) + np.cross(about, [0.0, 0.0, height]))
    assert motion.p < 1e-12
    assert motion.moved == pytest.approx(origin, abs=1e-4)
    assert motion.turned == pytest.approx(np.linalg.norm(about), abs=2e-4)
    if not np.any(about):
        assert motion.effect == pytest.approx(np.linalg.norm(by), abs=1e-4)
    # What the arm itself is off by stays.
    still = motion_of_base(fit_to(scene, table))
    assert motion.effect_of_arm == pytest.approx(still.effect_of_arm, rel=0.1)


def test_a_base_that_stands_where_it_should_has_not_moved(clean):
    """The first joint's own offset and zero are its own, where the others' are as large."""
    scene, table = clean
    motion = motion_of_base(fit_to(scene, table))
    assert (motion.p > 0.003, motion.effect) == (True, 0.0)


def test_the_first_joints_axis_may_be_off_like_the_others(clean):
    """Errors of 3 mrad about each axis are usual: a base turned by 5 mrad is not told from them."""
    scene, table = clean
    motion = motion_of_base(fit_to(scene, moved(table, (0.0, 0.0, 0.0), (4e-3, -3e-3, 0.0))))
    assert (motion.p > 0.01, motion.effect) == (True, 0.0)


@pytest.mark.parametrize("frame_aligned", [False, True])
def test_the_frame_may_be_stated_as_aligned(clean, frame_aligned):
    scene, table = clean
    cell = Cell(model="dh", frame_aligned=frame_aligned)
    fitted = fit_to(scene, moved(table, (4e-3, 3e-3, 0.0)), cell)
    found = contradicted_values(fitted, None)
    assert [reason.why for reason in found] == [Why.BASE_MOVED] * (not frame_aligned)


def test_a_base_that_stands_lower_than_any_joints_offset(clean):
    scene, table = clean
    motion = motion_of_base(fit_to(scene, moved(table, (0.0, 0.0, 12e-3))))
    assert motion.moved == pytest.approx(12e-3, abs=1e-3)


def test_offsets_of_joints_that_vanish_by_chance_are_of_usual_size(clean):
    """An offset is no more surprising than for zeros of 5 mrad, however small the others happen to be."""
    fitted = fit_to(*clean)
    columns = np.zeros((*fitted.estimate.problem.rows.used.shape, 1))
    columns[:, 0] = 1.0
    joint = estimate_jointly(fitted, columns)
    zeros = fitted.kinematics.model.family(ZERO)
    of_usual = 2.0 * norm.sf(0.013 / FAMILIES[ZERO].typical)
    for size in (1e-7, FAMILIES[ZERO].typical / 2.0):
        vanished = replace(joint, prior_std={**joint.prior_std, ZERO: size})
        assert _p_of_offset(-0.013, vanished, zeros, (ZERO, ANGLE)) == pytest.approx(of_usual)
    larger = replace(joint, prior_std={**joint.prior_std, ZERO: 0.013})
    assert _p_of_offset(0.013, larger, zeros, (ZERO, ANGLE)) > 0.3
    assert _p_of_offset(0.013, replace(joint, prior_std={}), zeros, (ZERO, ANGLE)) == 1.0


def test_an_unknown_frame_has_no_base_to_be_moved(clean):
    scene, table = clean
    assert motion_of_base(fit_to(scene, table, Cell(model="dh", estimate_frame=True))) is None


@pytest.mark.parametrize("share", [0.004, -0.004])
def test_the_scale_of_an_instrument(clean, share):
    scene, table = clean
    scale = instrument_scale(fit_to(scene, replace(table, points=(1.0 + share) * table.points)))
    assert scale.share == pytest.approx(share, abs=3.0 * scale.std)
    assert scale.std < 1.5e-3
    assert scale.mean == pytest.approx(share, abs=3.0 * scale.std)
    assert scale.size == pytest.approx(np.hypot(scale.mean, np.sqrt(scale.variance)))
    assert scale.p < 0.05


def test_few_determined_lengths_bound_the_scale_less():
    """Student's t: its p-value, and the bound that one in twenty exceeds."""
    given = {"share": 2e-3, "std": 1e-3, "prior": 1e9, "growth": np.ones(1)}
    few, many = Scale(freedom=2.0, **given), Scale(freedom=1e6, **given)
    assert many.p == pytest.approx(0.0455, rel=1e-3)
    assert few.p == pytest.approx(0.1835, rel=1e-3)
    assert many.bound == pytest.approx(3.645e-3, rel=1e-3)
    assert few.bound == pytest.approx(4.920e-3, rel=1e-3)
    named = replace(few, prior=1e-3)
    assert (named.mean, named.variance) == (pytest.approx(1e-3), pytest.approx(5e-7))
    # A share of a hundred times what the instrument has is an error of the few lengths.
    contradicted = Scale(freedom=1.0, **(given | {"share": 1.0, "std": 0.1, "prior": 0.01}))
    assert contradicted.size == pytest.approx(0.01, rel=0.05)
    assert contradicted.bound < 0.02
    assert replace(contradicted, freedom=1e6).mean == pytest.approx(1.0 / 101.0, rel=1e-3)
    certified = replace(few, prior=0.0)
    assert (certified.size, certified.bound) == (0.0, 0.0)


def test_a_known_distance_between_sockets_tells_the_scale(make_scene):
    """Sockets measure nothing: only the distance grows, and the error that it then has is found."""
    scene = make_scene(39, frames=SOCKETS, targets=TARGETS[:1], length=3e-4, angle=3e-3, noise=2e-5)
    table = in_each(scene.fixed, 16)
    (true,) = gaps(SOCKETS)

    def scale_of(*distances):
        cell = Cell(model="dh", distances=distances)
        rows, setup = rows_and_setup(scene.robot, table, cell)
        known = known_distances(cell, setup)
        return instrument_scale(fit(Task(scene.robot, cell, setup, "dh", distances=known), rows))

    right, wrong = scale_of(true), scale_of(replace(true, length=1.01 * true.length))
    assert right.prior == right.size == 0.0
    assert abs(right.share) < 3.0 * right.std
    assert wrong.share - right.share == pytest.approx(0.01, rel=0.05)
    # Without the distance no row knows a length.
    assert scale_of() is None


def test_zeros_of_joints_cannot_take_a_scale(clean):
    """Where no length of the arm is estimated, what all lengths grow by has nothing to hide in."""
    scene, table = clean
    assert instrument_scale(fit_to(scene, table, Cell(model="zeros"))) is None


# Lenses and boards

FOCAL = np.array([1.015, 1.015, 1, 1, 1, 1, 1, 1, 1])
CLOSE = np.array([1.0, 1.0, 2.0, 2.0, 5e-3, 5e-3, 5e-4, 5e-4, 5e-3])


def reasons_of_images(camera, board=BOARD, model="zeros", **made):
    robot = camera_arm()
    c = cell(cameras={"": camera}, boards={"": board})
    rows, setup = rows_and_setup(robot, table(poses(20), noise=0.2, **made), c)
    return list(_wrong_internals(fit(Task(robot, c, setup, model), rows)))


@pytest.mark.parametrize("exact", [True, False])
def test_a_wrong_focal_length_is_named(exact):
    stated = camera(values=VALUES["pinhole"] * FOCAL, sigma=np.zeros(9) if exact else CLOSE)
    (reason,) = reasons_of_images(stated)
    assert reason.why is Why.FOCAL_LENGTH_OFF
    assert reason.values["share"] == pytest.approx(1.0 / 1.015 - 1.0, abs=4e-3)
    assert reason.values["exact"] is exact


def test_a_focal_length_of_another_resolution_is_named_with_its_share_of_the_stated_one():
    half = np.array([2.0, 2.0, 1, 1, 1, 1, 1, 1, 1])
    (reason,) = reasons_of_images(camera(values=VALUES["pinhole"] * half))
    assert reason.why is Why.FOCAL_LENGTH_OFF
    assert reason.values["share"] == pytest.approx(-0.5, abs=0.02)


@pytest.mark.parametrize("sigma", [0.0, 0.003])
def test_a_board_of_another_size_is_named(sigma):
    stated = replace(BOARD, sigma_scale=sigma)
    (reason,) = reasons_of_images(camera(sigma=CLOSE), stated, points=1.01 * BOARD.corners)
    assert reason.why is Why.BOARD_SCALE_OFF
    assert reason.values["share"] == pytest.approx(0.01, abs=5e-3)
    assert reason.values["exact"] is (sigma == 0.0)


def test_a_print_that_is_off_by_twice_what_prints_are_is_named():
    """Along both axes; half of that is nothing to say."""
    for scale, named in ((0.994, [Why.BOARD_SCALE_OFF]), (0.997, [])):
        stated = replace(BOARD, sigma_scale=0.003)
        found = reasons_of_images(camera(sigma=CLOSE), stated, points=scale * BOARD.corners)
        assert [reason.why for reason in found] == named


@pytest.mark.parametrize("square", [0.96, 0.9])
def test_a_wrong_square_is_named_though_all_lengths_of_the_arm_make_up_for_it(square):
    """Lengths of the arm that have grown alike, by much more than arms are wrong, are no proof of a wide prior."""
    stated = replace(BOARD, sigma_scale=0.003)
    (reason,) = reasons_of_images(
        camera(sigma=CLOSE), stated, model="dh", points=square * BOARD.corners
    )
    assert reason.why is Why.BOARD_SCALE_OFF
    assert reason.values["share"] == pytest.approx(square - 1.0, abs=0.015)


@pytest.mark.parametrize(("stated", "named"), [(1e-4, [Why.CORNERS_OFF]), (3e-4, [])])
def test_corners_that_are_farther_off_than_stated_are_named(stated, named):
    """Those of a body are 0.5 mm off along all axes; a guess to a factor of two is good enough."""
    board = replace(BODY, sigma_scale=0.0, sigma_corner=stated)
    off = 5e-4 * np.random.default_rng(6).standard_normal(BODY.corners.shape)
    c = cell(cameras={"": camera(sigma=np.zeros(9))}, boards={"": board})
    m = table(poses(14), board=board, points=board.corners + off, noise=0.1)
    rows, setup = rows_and_setup(camera_arm(), m, c)
    fitted = fit(Task(camera_arm(), c, setup, "frames"), rows)
    found = [
        reason for reason in contradicted_values(fitted, None) if reason.why is Why.CORNERS_OFF
    ]
    assert [reason.why for reason in found] == named
    for reason in found:
        assert reason.values["stated_m"] == pytest.approx(stated)
        assert 2e-4 < reason.values["off_m"] < 6e-4


@pytest.mark.parametrize("exact", [True, False])
def test_right_statements_are_not_contradicted(exact):
    stated = camera(sigma=np.zeros(9) if exact else CLOSE)
    assert reasons_of_images(stated, replace(BOARD, sigma_scale=0.0 if exact else 0.003)) == []


# Covariances of poses

#: The orientation before the position.
TURNS_FIRST = [3, 4, 5, 0, 1, 2]


def reasons_of_covariances(scene, stated, true, rng):
    cell = Cell(estimate_frame=True)
    table = table_with(scene, len(true), stated, true, rng)
    rows, setup = rows_and_setup(scene.robot, table, cell)
    return list(_idle_covariances(fit(Task(scene.robot, cell, setup, "zeros"), rows)))


@pytest.mark.parametrize("scale", [1.0, 0.1])
def test_covariances_in_another_order_are_named(make_scene, scale):
    rng = np.random.default_rng(1)
    true = random_covariances(rng, 40)
    other = scale**2 * true[:, TURNS_FIRST][:, :, TURNS_FIRST]
    (reason,) = reasons_of_covariances(make_scene(1, model="zeros"), other, true, rng)
    assert reason.why is Why.COVARIANCES_IDLE
    assert reason.values["scale"] < 1.0


@pytest.mark.parametrize("scale", [1.0, 0.01])
def test_right_covariances_are_not(make_scene, scale):
    rng = np.random.default_rng(2)
    true = random_covariances(rng, 40)
    assert reasons_of_covariances(make_scene(2, model="zeros"), scale**2 * true, true, rng) == []


def test_equal_covariances_tell_nothing_and_need_not(make_scene):
    rng = np.random.default_rng(3)
    equal = np.tile(np.diag(np.repeat([1e-4, 1e-3], 3) ** 2), (40, 1, 1))
    assert reasons_of_covariances(make_scene(3, model="zeros"), equal, equal, rng) == []


def test_poses_without_covariances_are_not_judged(make_scene):
    rng = np.random.default_rng(4)
    true = random_covariances(rng, 20)
    assert reasons_of_covariances(make_scene(4, model="zeros"), None, true, rng) == []
