"""Foresight against the fit that it foresees: derivatives, noise, priors, ranks, and what calibrations leave."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.data.cell import Cell, Priors, Tracker, TrackerNoise
from calib.data.measurements import Measurements
from calib.errors import ModelError
from calib.model.kinematics import Kinematics, Samples
from calib.numerics.rigid_motion import without_rigid_motion
from calib.result.calibrate import calibrate
from calib.robot.gravity import Payload, gravity_loads
from calib.robot.ranges import random_joint_values, spread_poses
from calib.verbs.inspect.inspection import inspect
from calib.verbs.plan.forecast import forecast
from calib.verbs.plan.sensitivity import Sensitivity

TARGET = np.array([0.05, -0.06, 0.04])
SIGMA = 1e-4
FRAME = np.eye(4)
FRAME[:3, :3] = Rotation.from_rotvec([0.2, -0.4, 1.1]).as_matrix()
FRAME[:3, 3] = [2.0, -1.0, 0.4]
PAYLOAD = Payload(2.0, np.array([0.0, 0.02, 0.05]))

CELLS = {
    "a known frame": Cell(target=TARGET, model="dh", sigma={"m": SIGMA}),
    "an estimated frame": Cell(
        target=TARGET, model="dh", sigma={"m": SIGMA}, T_frame_base=FRAME, estimate_frame=True
    ),
    "a frame that is not given": Cell(
        target=TARGET, model="dh", sigma={"m": SIGMA}, estimate_frame=True
    ),
    "poses": Cell(
        target=TARGET,
        model="dh",
        kind="pose",
        sigma={"m": SIGMA},
        T_frame_base=FRAME,
        estimate_frame=True,
    ),
    "poses of a turned target": Cell(
        target=TARGET,
        model="placement",
        kind="pose",
        sigma={"m": SIGMA, "rad": 3e-4},
        target_rotation=Rotation.from_rotvec([0.5, 0.3, -2.0]).as_matrix(),
    ),
    "distances": Cell(
        target=TARGET, model="dh", kind="distance", sigma={"m": SIGMA}, T_frame_base=FRAME
    ),
    "two targets": Cell(
        targets={"one": TARGET, "two": -2.0 * TARGET}, model="placement", sigma={"m": SIGMA}
    ),
    "two targets' distances": Cell(
        targets={"one": TARGET, "two": -2.0 * TARGET},
        model="dh",
        kind="distance",
        sigma={"m": SIGMA},
        frames={"A": FRAME},
    ),
    "bending": Cell(
        target=TARGET, model="dh+gain+eccentricity+compliance", sigma={"m": SIGMA}, payload=PAYLOAD
    ),
    "no target": Cell(model="hayati", sigma={"m": SIGMA}),
    "auto": Cell(target=TARGET, sigma={"m": SIGMA}),
    "frozen and tied": Cell(
        target=TARGET, model="dh", sigma={"m": SIGMA}, frozen=("a2",), ties={"a3": ("d1", 2.0)}
    ),
}


@pytest.fixture(params=CELLS)
def cell(request) -> Cell:
    return CELLS[request.param]


def predicted(cell: Cell, kinematics: Kinematics, x: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Poses of all targets, pose by pose, shape (n, targets, 4, 4)."""
    robot, k = kinematics.robot, len(kinematics.T_tip_target)
    load = gravity_loads(robot, q, cell.payload, cell.gravity)
    stack = []
    for t in range(k):
        n = len(q)
        samples = Samples(q, np.zeros(n, dtype=int), np.full(n, t), load)
        stack.append(kinematics.poses(x, samples))
    return np.stack(stack, axis=1)


def differences(cell, kinematics, q, look, step=1e-6):
    """Central differences of what `look` makes of two stacks of poses, one for each parameter, last."""
    columns = []
    for k in range(len(kinematics.model)):
        e = np.zeros(len(kinematics.model))
        e[k] = step
        plus = predicted(cell, kinematics, e, q)
        minus = predicted(cell, kinematics, -e, q)
        columns.append(look(plus, minus) / (2.0 * step))
    return np.stack(columns, axis=-1)


def in_position(plus, minus):
    return plus[:, :, :3, 3] - minus[:, :, :3, 3]


def in_length(plus, minus):
    lengths = [np.linalg.norm(T[:, :, :3, 3], axis=2, keepdims=True) for T in (plus, minus)]
    return lengths[0] - lengths[1]


def in_orientation(plus, minus):
    turn = plus[:, :, :3, :3] @ minus[:, :, :3, :3].swapaxes(2, 3)
    return Rotation.from_matrix(turn.reshape(-1, 3, 3)).as_rotvec().reshape(*turn.shape[:2], 3)


# Derivatives


def test_what_is_measured_moves_as_predictions_do(ur3, cell):
    sensitivity = Sensitivity.of(ur3, cell)
    q = random_joint_values(ur3, 7, 5)
    parts = {
        "point": [(in_position, SIGMA)],
        "pose": [(in_position, SIGMA), (in_orientation, cell.sigma.get("rad", 1e-3))],
        "distance": [(in_length, SIGMA)],
    }[sensitivity.instrument.kind.name]
    expected = np.concatenate(
        [differences(cell, sensitivity.kinematics, q, look) / sigma for look, sigma in parts],
        axis=2,
    )
    found = sensitivity.measured(q)
    assert found.shape == (
        7,
        expected.shape[1] * expected.shape[2],
        len(sensitivity.kinematics.model),
    )
    scale = np.abs(expected).max(axis=(0, 1, 2))
    # A joint that carries no load does not bend.
    scale = np.where(scale > 0.0, scale, 1.0)
    np.testing.assert_allclose(
        found / scale, expected.reshape(found.shape) / scale, rtol=0.0, atol=2e-6
    )


def test_what_is_located_moves_as_predictions_do(ur3, cell):
    sensitivity = Sensitivity.of(ur3, cell)
    q = random_joint_values(ur3, 7, 6)
    expected = differences(cell, sensitivity.kinematics, q, in_position)
    if sensitivity.instrument.kind.name == "distance":
        points = predicted(cell, sensitivity.kinematics, np.zeros(expected.shape[-1]), q)[
            :, :, :3, 3
        ]
        flat = expected.reshape(-1, 3, expected.shape[-1])
        expected = without_rigid_motion(points.reshape(-1, 3), flat).reshape(expected.shape)
    found = sensitivity.located(q)
    assert found.shape == (7, 3 * len(sensitivity.setup.targets), expected.shape[-1])
    np.testing.assert_allclose(found, expected.reshape(found.shape), rtol=0.0, atol=2e-6)


# Noise


def test_the_noise_is_the_cells_or_the_trackers_by_distance_or_a_usual_trackers(ur3):
    q = random_joint_values(ur3, 20, 5)
    given = Sensitivity.of(ur3, Cell(target=TARGET, sigma={"m": SIGMA}))
    np.testing.assert_array_equal(given.noise(q), np.full(20, SIGMA))
    tracker = Tracker(np.array([2.5, 0.3, 0.5]), noise=TrackerNoise(10e-6, 50e-6, 0.0))
    seen = Sensitivity.of(ur3, Cell(target=TARGET, tracker=tracker))
    points = (ur3.poses(q) @ np.append(TARGET, 1.0))[:, :3]
    distance = np.linalg.norm(points - tracker.position, axis=1)
    np.testing.assert_allclose(seen.noise(q), 10e-6 + 50e-6 * distance, rtol=1e-12)
    assert np.ptp(seen.noise(q)) > 1e-5
    both = Sensitivity.of(ur3, Cell(target=TARGET, tracker=tracker, sigma={"m": SIGMA}))
    np.testing.assert_array_equal(both.noise(q), np.full(20, SIGMA))
    usual = Sensitivity.of(ur3, Cell(target=TARGET))
    np.testing.assert_allclose(usual.noise(q), np.hypot(15e-6 + 3 * 6e-6, 20e-6))
    # What is measured is in this noise.
    np.testing.assert_allclose(
        seen.measured(q) * seen.noise(q)[:, None, None],
        usual.measured(q) * usual.noise(q)[:, None, None],
    )


# Priors


# Ranks


@pytest.mark.parametrize("name", [name for name in CELLS if "targets" not in name])
def test_the_rank_over_the_joint_limits_is_that_of_inspect(ur3, name):
    cell = replace(CELLS[name], model="placement") if name == "auto" else CELLS[name]
    found = forecast(ur3, cell, spread_poses(ur3))
    expected = inspect(ur3, cell).observability
    assert (found.rank, found.columns) == (expected.rank, expected.columns)
    assert found.workspace_rank == expected.rank
    for index, value in expected.indices.items():
        assert found.indices[index] == pytest.approx(value, rel=1e-6)


def test_lost_motion_is_planned_for_as_if_driven_from_pose_to_pose(ur3):
    """Each joint's is determined, as it comes from both sides; the forecast agrees with that of a table."""
    cell = Cell(target=TARGET, model="zeros+lost_motion", sigma={"m": SIGMA})
    found, without = (
        forecast(ur3, replace(cell, model=model), spread_poses(ur3))
        for model in (cell.model, "zeros")
    )
    assert found.rank == without.rank + 6
    assert found.rank == inspect(ur3, cell).observability.rank


def test_targets_of_one_stop_share_the_robots_repeatability(ur3):
    noise = TrackerNoise(10e-6, 0.0, 40e-6)
    tracker = Tracker(np.array([3.0, 0.0, 0.0]), noise=noise)
    cell = Cell(targets={"one": TARGET, "two": TARGET, "three": TARGET}, model="dh")
    q = random_joint_values(ur3, 4, seed=3)
    shared = Sensitivity.of(ur3, replace(cell, tracker=tracker)).measured(q)
    alone = Sensitivity.of(ur3, replace(cell, sigma={"m": noise.std(3.0)})).measured(q)
    # Three targets at one place say of the robot what one row does whose noise is that of their mean.
    robot = slice(0, 20)
    square = (10e-6**2 / 3.0 + 40e-6**2) / (noise.std(3.0) ** 2 / 3.0)
    assert alone[..., robot] / np.sqrt(square) == pytest.approx(shared[..., robot], rel=1e-9)


# Against calibrations


def simulated(robot, cell, q, rng) -> Measurements:
    """A table of a robot that is a little wrong, as linear as the forecast, measured with the cell's noise."""
    sensitivity = Sensitivity.of(robot, cell)
    model = sensitivity.kinematics.model
    size = np.where(np.array(model.units) == "m", 3e-5, 1e-4)
    x = size * rng.normal(size=len(model))
    T = predicted(cell, sensitivity.kinematics, x, q)[:, 0]
    n, kind = len(q), sensitivity.instrument.kind.name
    points = T[:, :3, 3] + SIGMA * rng.normal(size=(n, 3))
    columns = {}
    if kind == "distance":
        lengths = np.linalg.norm(T[:, :3, 3], axis=1)
        columns["distances"] = lengths + SIGMA * rng.normal(size=n)
        points = np.full((n, 3), np.nan)
    if kind == "pose":
        turn = Rotation.from_rotvec(cell.sigma["rad"] * rng.normal(size=(n, 3))).as_matrix()
        columns["rotations"] = turn @ T[:, :3, :3]
    return Measurements(robot.joint_names, q, points, kinds=(kind,) * n, **columns)


@pytest.mark.parametrize(
    "name",
    ["a known frame", "an estimated frame", "poses of a turned target", "distances", "zeros"],
)
def test_the_forecast_is_what_a_calibration_then_says_of_itself(ur3, name):
    given = Priors(source="given")
    cell = (
        Cell(target=TARGET, model="zeros", sigma={"m": SIGMA}, priors=given)
        if name == "zeros"
        else replace(CELLS[name], priors=given)
    )
    q = random_joint_values(ur3, 90 if name == "distances" else 40, 5)
    f = forecast(ur3, cell, q)
    table = simulated(ur3, cell, q, np.random.default_rng(3))
    c = calibrate(ur3, table, cell=cell, validate=False, robust=False)
    found = c.fit.geometry.estimate
    assert c.model.names == f.names
    # What the poses tell, parameter by parameter, and over the workspace.
    sure = c.trust.observability.identifiable
    assert sure.sum() >= 5
    std = np.sqrt(np.diag(found.covariance))
    np.testing.assert_allclose(f.parameter_std[sure], std[sure], rtol=0.15)
    where = random_joint_values(ur3, 300, 9)
    sensitivity = Sensitivity.of(ur3, cell)
    located = sensitivity.located(where)
    rms = np.sqrt(np.einsum("nij,jk,nik->", located, found.covariance, located) / len(where))
    assert f.rms == pytest.approx(rms, rel=0.15)
    assert f.sigma["m"] == pytest.approx(SIGMA)


@pytest.mark.parametrize(
    "cell",
    [
        Cell(kind="fixed"),
        Cell(frames={"A": FRAME, "B": FRAME}),
        Cell(kind="distance"),
        Cell(model="nonsense"),
        Cell(model="dh", parameter_priors={"nonsense": 1.0}),
    ],
)
def test_cells_that_cannot_be_planned_for_are_refused(ur3, cell):
    with pytest.raises(ModelError):
        forecast(ur3, cell, np.zeros((10, 6)))
