"""What each kind of row says of a pose: residuals by hand, derivatives against differences, pairs and channels."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.data.cell import Cell
from calib.data.kinds import get
from calib.fit.estimate.fitting import fit
from calib.fit.estimate.task import Task
from calib.fit.registration.rows import NONE, Rows
from calib.fit.registration.table_rows import rows_and_setup
from calib.model.kinematics import Kinematics, Samples
from calib.model.parameter_sets import DIRECTIONS, error_model
from calib.numerics.correlated_noise import PoseNoise
from tests import images
from tests.covariances import random_covariances

#: Numbers of kinds in the registry.
KINDS = tuple(map(get, ("point", "pose", "distance", "pair", "fixed", "plane")))
POINT, POSE, DISTANCE, PAIR, FIXED, PLANE = range(6)


def some_rows(rng, kinds, partner=None) -> Rows:
    n = len(kinds)
    return Rows(
        samples=Samples.at(rng.uniform(-3, 3, (n, 6))),
        kinds=KINDS,
        kind=np.array(kinds),
        measured=_measured(rng, kinds),
        partner=np.full(n, -1) if partner is None else np.array(partner),
        sigma={"m": rng.uniform(1e-4, 2e-4, n), "rad": rng.uniform(1e-3, 2e-3, n)},
        poses=np.arange(n),
        blocks=np.arange(n),
    )


def _measured(rng, kinds):
    turned = Rotation.random(len(kinds), random_state=int(rng.integers(2**31))).as_matrix()
    measured = np.hstack([rng.uniform(1, 2, (len(kinds), 3)), turned.reshape(-1, 9)])
    prior_std = np.array([0 if k == NONE else KINDS[k].size for k in kinds])
    return np.where(np.arange(12) < prior_std[:, None], measured, 0.0)


ALL = [POINT, POSE, DISTANCE, PAIR, FIXED, PLANE, NONE]


def _fields(rows):
    return {f.name: getattr(rows, f.name) for f in fields(rows) if f.init}


@pytest.mark.parametrize(
    ("kinds", "width", "count"),
    [
        ([POINT] * 3, 3, 9),
        ([POSE] * 2, 6, 12),
        ([DISTANCE] * 2, 1, 2),
        ([PLANE, DISTANCE], 1, 2),
        ([FIXED, DISTANCE], 3, 4),
        (ALL, 6, 3 + 6 + 1 + 1 + 3 + 1),
    ],
)
def test_a_residual_is_as_wide_as_the_widest_kind(kinds, width, count):
    rows = some_rows(np.random.default_rng(1), kinds)
    assert rows.width == width
    assert rows.count == count == rows.used.sum()
    assert rows.used.shape == rows.scales.shape == (len(kinds), width)


def test_each_kind_has_a_channel_for_each_of_its_units():
    rows = some_rows(np.random.default_rng(3), [DISTANCE, POSE, NONE, POINT, POSE])
    assert rows.channels.units == ("m", "m", "m", "rad")
    assert [kind.name for kind in rows.channel_kinds] == ["point", "pose", "distance", "pose"]
    np.testing.assert_array_equal(
        rows.channels.index,
        [
            [2, -1, -1, -1, -1, -1],
            [1, 1, 1, 3, 3, 3],
            [-1] * 6,
            [0, 0, 0, -1, -1, -1],
            [1, 1, 1, 3, 3, 3],
        ],
    )
    # What is left out does not keep its number.
    index = rows.select(np.array([True, False, True, False, False])).channels.index
    np.testing.assert_array_equal(index, [[0], [-1]])


def test_the_sigma_of_a_scalar_is_that_of_its_unit():
    rows = some_rows(np.random.default_rng(3), [POSE, DISTANCE])
    np.testing.assert_array_equal(rows.scales[0, 3:], np.full(3, rows.sigma["rad"][0]))
    np.testing.assert_array_equal(rows.scales[0, :3], np.full(3, rows.sigma["m"][0]))
    assert rows.scales[1, 0] == rows.sigma["m"][1]


def test_a_selection_numbers_partners_anew():
    rows = some_rows(np.random.default_rng(8), [PAIR, NONE, POINT, PAIR, NONE], [1, -1, -1, 4, -1])
    chosen = rows.select(np.array([False, False, True, True, True]))
    np.testing.assert_array_equal(chosen.partner, [-1, 2, -1])
    np.testing.assert_array_equal(chosen.kind, [POINT, PAIR, NONE])
    np.testing.assert_array_equal(chosen.sigma["rad"], rows.sigma["rad"][2:])
    np.testing.assert_array_equal(rows.select(slice(0, 2)).partner, [1, -1])


def test_a_perfect_instrument_reads_what_is_there():
    rng = np.random.default_rng(9)
    rows = some_rows(rng, ALL, [-1, -1, -1, 6, -1, -1, -1])
    T = np.tile(np.eye(4), (len(ALL), 1, 1))
    T[:, :3, :3] = Rotation.random(len(ALL), random_state=4).as_matrix()
    T[:, :3, 3] = rng.uniform(-1, 1, (len(ALL), 3))
    expected = np.zeros((len(ALL), 12))
    expected[:2, :3] = T[:2, :3, 3]
    expected[1, 3:] = T[1, :3, :3].ravel()
    expected[2, 0] = np.linalg.norm(T[2, :3, 3])
    expected[3, 0] = np.linalg.norm(T[3, :3, 3] - T[6, :3, 3])
    np.testing.assert_allclose(rows.as_measured_at(T).measured, expected, atol=1e-15)


def test_a_frame_that_loses_more_than_half_of_its_rows_keeps_all():
    """Of frames with four and two rows, the partner of a pair stays with it."""
    partner = [-1, -1, 3, -1, -1, -1]
    rows = some_rows(np.random.default_rng(10), [POINT, POINT, PAIR, NONE, POINT, POINT], partner)
    rows = replace(rows, samples=replace(rows.samples, frame=np.array([0, 0, 0, 0, 1, 1])))

    def kept(*outliers):
        return np.flatnonzero(rows.without(np.isin(np.arange(6), outliers))).tolist()

    assert kept(0, 1, 4) == [2, 3, 5]
    assert kept(3) == [0, 1, 2, 3, 4, 5]
    assert kept(0, 1, 2) == [0, 1, 2, 3, 4, 5]
    assert kept(4, 5) == [0, 1, 2, 3, 4, 5]


MAKERS = {
    "point": lambda s: s.points(6),
    "pose": lambda s: s.poses(6),
    "distance": lambda s: s.distances(6),
    "pair": lambda s: s.pairs(6),
    "fixed": lambda s: s.points(6),
    "plane": lambda s: s.points(6),
    "mixed": None,
}


@pytest.mark.parametrize("kind", MAKERS)
def test_derivatives_against_differences(make_scene, join, kind):
    """Robot, every frame and every target unknown, far from where the rows were measured."""
    scene = make_scene(5, frames=3, targets=2, reach=1.0)
    if kind == "mixed":
        table = join(
            scene.points(4, 0),
            scene.poses(4, 1, 1),
            scene.distances(4, 2),
            scene.pairs(4, 0, 1),
            scene.distances(3, 1),
        )
    else:
        table = MAKERS[kind](scene)
    rows, setup = rows_and_setup(scene.robot, table, Cell())
    of_row = [NONE if k == NONE else KINDS.index(rows.kinds[k]) for k in rows.kind.tolist()]
    # Far from the socket and from the plane: the residual need not be small.
    if kind in ("fixed", "plane"):
        of_row = [{"fixed": FIXED, "plane": PLANE}[kind]] * len(rows)
    if kind == "mixed":
        of_row[-2:] = FIXED, PLANE
    rows = Rows(**{**_fields(rows), "kinds": KINDS, "kind": np.array(of_row)})
    model = error_model(
        scene.robot,
        "placement+gain",
        frame=dict.fromkeys(setup.groups, DIRECTIONS),
        target=setup.targets,
        targets=setup.targets,
        rotation=True,
    )
    frames = scene.kinematics.T_frame_base[[int(g) for g in setup.groups]]
    targets = scene.kinematics.T_tip_target[[int(t[1:]) for t in setup.targets]]
    kinematics = Kinematics(scene.robot, model, frames, targets)
    x = 5e-3 * np.random.default_rng(6).normal(size=len(model))
    derivative = rows.derivative(kinematics.linearised(x, rows.samples))
    assert derivative.shape == (len(rows), rows.width, len(model))

    def at(v):
        return rows.residual(kinematics.poses(v, rows.samples))

    for k in range(len(model)):
        e = np.zeros(len(model))
        e[k] = 1e-3
        near, far = (at(x + e) - at(x - e)) / 2e-3, (at(x + 2 * e) - at(x - 2 * e)) / 4e-3
        np.testing.assert_allclose(-derivative[:, :, k], (4 * near - far) / 3, atol=1e-7)


def test_an_even_sample_has_the_same_share_of_each_target_and_the_fewest_of_small_ones():
    """Of 3000, 900 and 100 rows of three targets a quarter is drawn, but of the last not less than 100."""
    rng = np.random.default_rng(6)
    rows = some_rows(rng, [POINT] * 4000)
    target = rng.permutation(np.repeat([0, 1, 2], [3000, 900, 100]))
    samples = replace(rows.samples, target=target)
    rows = replace(rows, samples=samples)
    drawn = rows.evenly(1000)
    assert np.bincount(target[drawn]).tolist() == [750, 225, 100]
    np.testing.assert_array_equal(drawn, rows.evenly(1000))
    # From the whole table, not from its beginning.
    assert np.mean(np.flatnonzero(drawn)) == pytest.approx(2000, abs=150)


def test_an_even_sample_keeps_pairs_whole():
    partner = np.full(600, -1)
    partner[::2] = np.arange(1, 600, 2)
    rows = some_rows(np.random.default_rng(7), [PAIR, NONE] * 300, partner)
    drawn = rows.evenly(200)
    np.testing.assert_array_equal(drawn[::2], drawn[1::2])
    assert np.sum(drawn) == 200


def test_an_even_sample_has_a_row_of_each_target_though_they_be_more_than_asked_for():
    rows = some_rows(np.random.default_rng(12), [POINT] * 10)
    target = np.arange(10) // 2
    rows = replace(rows, samples=replace(rows.samples, target=target))
    assert np.bincount(target[rows.evenly(3)]).tolist() == [1] * 5


def correlated_rows():
    """Rows of all kinds, of which the poses have covariances, one of them none."""
    rng = np.random.default_rng(20)
    kinds = [POINT, POSE, NONE, POSE, POINT, POSE]
    covariances = random_covariances(rng, len(kinds))
    covariances[3] = np.nan
    J = rng.normal(size=(len(kinds), 6, 4))
    return replace(
        some_rows(rng, kinds),
        covariances=covariances,
        by_joints=J @ J.transpose(0, 2, 1),
        pose_noise=PoseNoise(scale=2.0, position=1e-4, orientation=2e-3, joint=1e-4),
    )


def test_only_poses_are_correlated():
    rows = correlated_rows()
    np.testing.assert_array_equal(np.flatnonzero(rows.correlated), [1, 5])
    as_points = replace(rows, kinds=(get("point"),), kind=np.zeros(6, dtype=int))
    assert not as_points.correlated.any()
    assert as_points.scales.shape == (6, 3)


def test_standardised_values_come_back():
    rows = correlated_rows()
    values = np.random.default_rng(21).normal(size=(6, 6, 3))
    np.testing.assert_allclose(rows.in_units(rows.standardise(values)), values, rtol=1e-9)
    column = values[:, :, 0]
    of_column = rows.standardise(values)[:, :, 0]
    np.testing.assert_allclose(rows.standardise(column), of_column, rtol=1e-12)
    # A row without a covariance is divided by its sigma.
    expected = values[3] / np.repeat([rows.sigma["m"][3], rows.sigma["rad"][3]], 3)[:, None]
    np.testing.assert_allclose(rows.standardise(values)[3], expected)


def test_standardised_errors_are_independent():
    rows = correlated_rows()
    V = rows.pose_noise.covariances(rows.covariances, rows.by_joints)
    W = rows.standardise(np.tile(np.eye(6), (6, 1, 1)))
    for k in (1, 5):
        np.testing.assert_allclose(W[k] @ V[k] @ W[k].T, np.eye(6), atol=1e-9)
        np.testing.assert_allclose(rows.scales[k], np.sqrt(np.diag(V[k])))


def test_scales_at_a_noise_are_those_of_the_scaled_independent_errors():
    rows = correlated_rows()
    names = list(zip([kind.name for kind in rows.channel_kinds], rows.channels.units, strict=True))
    noise = np.arange(1.0, 1.0 + len(names))
    of_lengths, of_angles = (noise[names.index(("pose", unit))] for unit in ("m", "rad"))
    W = rows.standardise(np.tile(np.eye(6), (6, 1, 1)))
    for k in (1, 5):
        root = np.linalg.inv(W[k]) * np.repeat([of_lengths, of_angles], 3)
        np.testing.assert_allclose(rows.scales_at(noise)[k], np.sqrt(np.diag(root @ root.T)))
    np.testing.assert_allclose(rows.scales_at(np.ones(len(names))), rows.scales)
    alone = noise[names.index(("point", "m"))] * rows.sigma["m"][0]
    np.testing.assert_allclose(rows.scales_at(noise)[0, :3], alone)


def test_some_of_the_rows_keep_their_covariances():
    rows = correlated_rows()
    some = rows.select(np.array([False, False, False, True, True, True]))
    np.testing.assert_array_equal(np.flatnonzero(some.correlated), [2])
    values = np.random.default_rng(22).normal(size=(6, 6))
    of_all = rows.standardise(values)
    np.testing.assert_allclose(some.standardise(values[3:])[2], of_all[5], rtol=1e-12)
    assert not rows.select(np.arange(6) < 1).correlated.any()


def test_a_pixel_is_as_long_as_the_corner_is_far():
    robot = images.arm()
    q = images.poses(8)
    rows, setup = rows_and_setup(robot, images.table(q, noise=0.1), images.cell())
    fitted = fit(Task(robot, images.cell(), setup, "frames"), rows)
    T_camera_base, T_tip_board = images.mounts()
    T = T_camera_base @ robot.poses(q) @ T_tip_board
    depth = images.BOARD.corners @ T[:, 2, :3].T + T[:, 2, 3]
    found = rows.lengths_per_unit(fitted.kinematics.sightings(fitted.estimate.x, rows.samples))
    expected = depth.T.ravel() / 702.5
    np.testing.assert_allclose(found, expected, rtol=0.01)
