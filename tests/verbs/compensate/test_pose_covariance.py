"""How well the tool's poses are known: against robots drawn from the covariance, and against what a frame hides."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest

from calib.data.cell import Cell, Priors
from calib.data.measurements import Measurements
from calib.fit.selection.candidates import Candidate
from calib.model.error_model import FRAME
from calib.model.families import FAMILIES
from calib.model.kinematics import Samples
from calib.model.parameter_sets import DIRECTIONS
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.ranges import random_joint_values
from calib.verbs.compensate.pose_covariance import (
    View,
    pose_covariance,
    unknown_base_directions,
    unmodelled_base,
)
from tests.hard_cases import made, ur3
from tests.parts import with_part

KNOWN_BASE = np.zeros((6, 6))
TOOL = np.eye(4)
TOOL[:3, 3] = 0.05, 0.0, 0.1


@cache
def in_a_frame(model: str = "dh", noise: float = 1e-4, **changes) -> Calibration:
    """A UR3 without errors, measured in a frame that is estimated."""
    robot = ur3()
    q = random_joint_values(robot, 25, 4)
    rng = np.random.default_rng(5)
    points = robot.poses(q)[:, :3, 3] + robot.poses(q)[:, :3, :3] @ [0.05, 0.04, 0.03]
    points = points + noise * rng.normal(size=points.shape)
    cell = Cell(
        **{
            "scale_certified": True,
            "estimate_frame": True,
            "model": model,
            "priors": Priors("given"),
            **changes,
        }
    )
    return calibrate(robot, Measurements(robot.joint_names, q, points), cell=cell, validate=False)


def joint_values(found: Calibration, count: int = 7) -> np.ndarray:
    return found.fit.measurements.joints_for(found.nominal.joint_names)[:count]


def std(found: Calibration, q: np.ndarray, view: dict) -> np.ndarray:
    """Standard deviations of positions and angles, shape (N, 2)."""
    given = {"T_tip_tool": None, "in_base": False, "base": KNOWN_BASE, **view}
    covariance = pose_covariance(found.geometry, View(samples=found.samples(q), **given)).covariance
    squares = np.diagonal(covariance, axis1=1, axis2=2).reshape(-1, 2, 3).sum(axis=2)
    return np.sqrt(squares)


@pytest.mark.parametrize("case", ["paper", "poses", "mixed", "prismatic", "two_joints"])
def test_a_target_as_the_tool_is_known_as_well_as_the_target(case: str):
    found = with_part(made(case), "geometry", scale=None)
    q = joint_values(found)
    in_frame = std(found, q, {})[:, 0]
    group = found.setup.groups[0]
    assert in_frame == pytest.approx(
        found.position_std(q, group=group, non_geometric=False), rel=1e-6
    )
    # In the base the robot's place counts, which a frame that was estimated takes away.
    if found.rows.tells_place and np.any(found.model.family(FRAME)):
        assert (std(found, q, {"in_base": True})[:, 0] > in_frame).all()


def test_without_positions_the_motion_of_the_base_is_left_out():
    found = made("distances")
    q = joint_values(found)
    less = std(found, q, {"in_base": True, "base": None})[:, 0]
    assert less == pytest.approx(found.position_std(q, non_geometric=False), rel=1e-6)
    assert (std(found, q, {"in_base": True})[:, 0] > less).all()


@pytest.mark.slow
def test_of_a_tool_it_is_the_scatter_of_robots_drawn_from_the_covariance():
    found = with_part(made("paper"), "geometry", scale=None)
    q = random_joint_values(found.nominal, 3)
    of_arm = [k for k, name in enumerate(found.model.names) if not name.startswith("target")]
    rng = np.random.default_rng(0)
    covariance = found.covariance[np.ix_(of_arm, of_arm)]
    spread = rng.multivariate_normal(np.zeros(len(of_arm)), covariance, 400)
    model = found.model.without([n for n in found.model.names if n.startswith("target")])
    robots = [model.apply(found.nominal, found.geometry.x[of_arm] + d) for d in spread]
    points = np.array([(robot.poses(q) @ TOOL)[:, :3, 3] for robot in robots])
    expected = std(found, q, {"T_tip_tool": TOOL, "in_base": True})
    scatter = np.sqrt(points.var(axis=0).sum(axis=1))
    assert scatter == pytest.approx(expected[:, 0], rel=0.12)
    # One target says little of how the tip is turned: the angle stays as unsure as its priors left it.
    assert expected[:, 1].min() > 2e-3


def test_the_unknowns_that_rows_share_have_the_mean_square():
    found = made("paper")
    q = random_joint_values(found.nominal, 3000)  # more than are held at a time
    view = View(found.samples(q), TOOL, True, np.eye(6) * 1e-8)
    result = pose_covariance(found.geometry, view)
    assert len(result.covariance) == len(q)
    assert result.shared.sum() == pytest.approx(result.mean_square[0], rel=1e-9)
    first = pose_covariance(found.geometry, view._replace(samples=found.samples(q[-2:])))
    assert first.covariance == pytest.approx(result.covariance[-2:], rel=1e-9)


def test_what_the_priors_leave_unknown_is_told_from_noise():
    """With noise a tenth as large only the share of the noise falls."""
    loud, quiet = in_a_frame(), in_a_frame(noise=1e-5)
    q = joint_values(loud)
    for tool in (None, TOOL):
        found = [
            pose_covariance(one.geometry, View(one.samples(q), tool, True, np.eye(6) * 1e-8))
            for one in (loud, quiet)
        ]
        by_noise = [one.mean_square[0] - one.by_priors for one in found]
        assert found[0].by_priors == pytest.approx(found[1].by_priors, rel=0.05)
        assert by_noise[0] > 5.0 * by_noise[1] > 0.0
    # In the frame, at the target itself, hardly anything is left to the priors.
    here = pose_covariance(loud.geometry, View(loud.samples(q), None, False, KNOWN_BASE))
    assert here.by_priors < 0.1 * here.mean_square[0]


def test_a_motion_of_the_base_moves_the_tool_as_one_body():
    found = with_part(made("paper"), "geometry", covariance=np.zeros((27, 27)), scale=None)
    q = joint_values(found, 2)
    motion = np.array([1e-4, -2e-4, 3e-4, 2e-5, 1e-5, -4e-5])
    view = View(found.samples(q), TOOL, True, np.outer(motion, motion))
    covariance = pose_covariance(found.geometry, view).covariance
    poses = found.robot.poses(q) @ TOOL
    moved = pin.exp6(motion).homogeneous @ poses
    for pose, after, found_covariance in zip(poses, moved, covariance, strict=True):
        shift = after[:3, 3] - pose[:3, 3]
        assert found_covariance[:3, :3] == pytest.approx(
            np.outer(shift, shift), rel=1e-3, abs=1e-14
        )
        assert found_covariance[3:, 3:] == pytest.approx(np.outer(motion[3:], motion[3:]))


def test_a_frame_that_was_estimated_hides_where_the_base_is():
    assert unknown_base_directions(in_a_frame()) == DIRECTIONS
    assert unknown_base_directions(in_a_frame(frame_directions=("x", "rz"))) == ("x", "rz")
    assert unknown_base_directions(made("paper")) == ()
    assert unknown_base_directions(made("distances")) == DIRECTIONS


def test_what_the_model_leaves_out_of_the_first_joint_has_its_prior():
    length, angle = FAMILIES["length"].prior, FAMILIES["angle"].prior
    assert in_a_frame().geometry.prior_std["length"] == length
    # The UR3's first joint turns about z of the base, 0.15 m above it: d1 and theta1 are parameters.
    height = float(in_a_frame().nominal.placements[0][2, 3])
    covariance = unmodelled_base(in_a_frame(), in_a_frame().geometry)
    about_the_joint = np.diag([length**2, length**2, 0.0, angle**2, angle**2, 0.0])
    into_base = np.eye(6)
    into_base[0, 4], into_base[1, 3] = -height, height
    assert covariance == pytest.approx(into_base @ about_the_joint @ into_base.T, abs=1e-12)
    # The placements have all six; frames alone have none, and then what is typical counts.
    placement = in_a_frame("placement")
    assert np.abs(unmodelled_base(placement, placement.geometry)).max() < 1e-12
    frames = in_a_frame("frames")
    typical = unmodelled_base(frames, frames.geometry)
    assert typical[2, 2] == pytest.approx(FAMILIES["length"].typical ** 2)
    assert typical[5, 5] == pytest.approx(FAMILIES["zero"].typical ** 2)
    # What is frozen is exact, and what a frame in part tells is measured.
    frozen = in_a_frame(frozen=("d1", "theta1"))
    assert unmodelled_base(frozen, frozen.geometry) == pytest.approx(covariance, abs=1e-12)
    part = in_a_frame(frame_directions=("x", "rz"))
    kept = np.isin(DIRECTIONS, ("x", "rz"))
    assert unmodelled_base(part, part.geometry) == pytest.approx(
        covariance * np.outer(kept, kept), abs=1e-12
    )
    known = made("paper")
    assert not unmodelled_base(known, known.geometry).any()


def test_a_larger_model_leaves_out_of_the_first_joint_what_its_geometry_does():
    """The compliance of a joint places nothing; and what is frozen is exact for both."""
    found = made("non_geometric")
    part = found.non_geometric
    # As if no frame had been known: all of the base is unknown then.
    setup = replace(found.setup, unknown=(DIRECTIONS,))
    free = with_part(found, "geometry", setup=setup)
    same_sizes = replace(part, prior_std=found.geometry.prior_std)
    covariance = unmodelled_base(free, same_sizes)
    assert np.linalg.matrix_rank(covariance, tol=1e-12) == 4
    assert covariance == pytest.approx(unmodelled_base(free, free.geometry), abs=1e-15)
    names = tuple(f"shoulder_pan_joint.{direction}" for direction in DIRECTIONS)
    frozen = with_part(free, "method", frozen=names)
    assert np.abs(unmodelled_base(frozen, same_sizes)).max() < 1e-15


def test_sizes_that_the_model_lacks_are_those_of_the_largest_candidate():
    tried = [
        Candidate("dh", 29, 0.0, made("paper").cross_validation, {"angle": 1e-3}, 0.0),
        Candidate("placement", 39, 0.0, made("paper").cross_validation, {"angle": 2e-3}, 0.0),
        Candidate("zeros", 12, 0.0, made("paper").cross_validation, {"zero": 3e-3}, 0.0),
    ]
    found = with_part(
        with_part(in_a_frame(), "geometry", prior_std={"zero": 1e-3}),
        "method",
        candidates=tuple(tried),
    )
    covariance = unmodelled_base(found, found.geometry)
    assert covariance[3, 3] == pytest.approx(2e-3**2)
    own = with_part(found, "geometry", prior_std={"zero": 1e-3, "angle": 5e-3})
    assert unmodelled_base(own, own.geometry)[3, 3] == pytest.approx(5e-3**2)


def test_without_priors_what_nothing_tells_is_as_large_as_errors_of_arms():
    found = in_a_frame(priors=Priors("off"))
    q = joint_values(found)
    assert found.parameter("d1").std > 0.5
    usual = in_a_frame()
    off = std(found, q, {"in_base": True})[:, 0]
    assert off.max() < 0.02
    # Where the measurements tell all there is hardly a difference.
    assert std(found, q, {})[:, 0] == pytest.approx(std(usual, q, {})[:, 0], rel=0.2)


def test_samples_carry_frames_and_loads():
    found = made("non_geometric")
    part = found.non_geometric
    q = joint_values(found, 4)
    with_load = pose_covariance(part, View(found.samples(q), None, False, KNOWN_BASE))
    expected = part.pose_std(found.samples(q))[:, 0]
    lengths = np.trace(with_load.covariance[:, :3, :3], axis1=1, axis2=2)
    assert np.sqrt(lengths) == pytest.approx(expected, rel=1e-6)
    unloaded = Samples.at(q, np.zeros_like(found.samples(q).load))
    assert np.abs(part.pose_std(unloaded)[:, 0] - expected).max() > 1e-9
