"""What the page's script is told."""

from __future__ import annotations

import base64
import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from calib.show.arrangement import Arrangement
from calib.show.motion import (
    FACTORS,
    MOST_POSES,
    magnification,
    motion_table,
    pose_message,
    thinned,
)
from calib.show.puppet import packed, puppets
from calib.show.view import Cloud, View, translated
from calib.show.visuals import read_visuals


def floats(text: str, *shape: int) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), dtype="<f4").reshape(shape)


@cache
def visuals_of(robot):
    return read_visuals(robot.urdf)[0]


def table_of(view: View) -> tuple[dict, dict]:
    shown = puppets(view, {who: visuals_of(robot) for who, robot in view.robots.items()})
    table = motion_table(view, shown, Arrangement.of(view, shown), 0.01)
    json.dumps(table, allow_nan=False)  # plain numbers only
    return table, shown


def test_poses_points_and_numbers_are_those_of_the_view(ur3_view):
    gap = np.array(ur3_view.measured)
    gap[3] = np.nan
    errors = np.array(ur3_view.errors)
    errors[:, 3] = np.nan
    view = replace(ur3_view, measured=gap, errors=errors)
    table, shown = table_of(view)
    for who, puppet in shown.items():
        count = puppet.poses.shape[1]
        assert table["robots"][who]["movers"] == count
        np.testing.assert_array_equal(
            floats(table["robots"][who]["poses"], 35, count, 7), packed(puppet.poses)
        )
    np.testing.assert_allclose(floats(table["measured"], 35, 3), gap, atol=1e-7)
    assert table["errors"][0][3] is None
    np.testing.assert_allclose(table["errors"][1][30], errors[1, 30], rtol=1e-8)
    assert table["angles"] == [[None] * 35] * 2
    assert (table["start"], table["labels"][30], table["kinds"][30]) == (30, "row 31", "validation")
    assert table["instruments"] == []
    assert set(table["seenFrom"]) == {-1}
    assert table["cloud"] is None


def test_movers_of_the_same_link_are_paired_whatever_else_moves(ur3_view, ur3):
    """A calibrated robot with a link more, such as the one that carries the target."""
    other = replace(ur3, urdf=ur3.urdf.with_link("calib_target", "tool0", np.eye(4)))
    view = replace(ur3_view, calibrated=other)
    table, shown = table_of(view)
    same = table["robots"]["calibrated"]["same"]
    frames = ["base", "tip", "target"]
    names = {who: [*puppet.links, *frames] for who, puppet in shown.items()}
    for mine, theirs in enumerate(same):
        if theirs >= 0:
            assert names["calibrated"][mine] == names["nominal"][theirs]
        else:
            assert names["calibrated"][mine] not in names["nominal"]
    assert same[-3:] == [len(names["nominal"]) - 3 + k for k in range(3)]


def test_instruments_are_told_once_each(ur3_view):
    far, near = translated([3.0, 1.0, 0.5]), translated([-2.0, 0.0, 1.0])
    poses = np.array([far if n % 2 else near for n in range(35)])
    poses[7] = np.nan
    table, _ = table_of(replace(ur3_view, instruments=poses))
    assert len(table["instruments"]) == 2
    for n, which in enumerate(table["seenFrom"]):
        if n == 7:
            assert which == -1
        else:
            np.testing.assert_allclose(table["instruments"][which][:3], poses[n, :3, 3])


def test_the_cloud_s_colours_go_from_well_to_badly_known(ur3_view):
    cloud = Cloud(np.zeros((50, 3)), np.geomspace(1e-4, 1e-3, 50), np.arange(50) < 10)
    table, _ = table_of(replace(ur3_view, cloud=cloud))
    rgb = floats(table["cloud"]["colours"], 50, 3)
    assert rgb[0].sum() > rgb[25].sum() > rgb[49].sum()  # from pale to dark, in grey print too
    assert floats(table["cloud"]["measured"], 50).sum() == 10
    same = Cloud(np.zeros((50, 3)), np.zeros(50), np.ones(50, dtype=bool))
    assert np.isfinite(
        floats(table_of(replace(ur3_view, cloud=same))[0]["cloud"]["colours"], 50, 3)
    ).all()


@pytest.mark.parametrize("count", [401, 5000])
def test_many_rows_are_thinned_evenly_and_flagged_ones_are_kept(ur3, count):
    rng = np.random.default_rng(5)
    kinds = np.array(["estimation"] * count, dtype=object)
    kinds[rng.permutation(count)[: count // 10]] = "validation"
    kinds[[10, 20, 390]] = "flagged"
    view = View(ur3, ur3, rng.uniform(-1, 1, (count, 6)), kinds=tuple(kinds), start=33)
    few = thinned(view)
    assert len(few.q) == MOST_POSES
    assert few.rows == count
    np.testing.assert_array_equal(few.q[few.start], view.q[33])
    assert few.kinds.count("flagged") == 3
    assert 0.5 * count // 10 / count < few.kinds.count("validation") / MOST_POSES < 1.5 / 10
    numbers = [int(label.removeprefix("pose ")) for label in few.labels]
    assert numbers == sorted(set(numbers))
    assert max(np.diff(numbers)) < 6 * count / MOST_POSES
    assert thinned(few.select(range(len(few.q)))).rows == count


def test_few_rows_are_all_shown(ur3_view):
    assert thinned(ur3_view) is ur3_view


def test_typical_arrows_are_well_visible(ur3_view):
    factor = magnification(ur3_view, 1.0)
    typical = float(np.median(ur3_view.distances[0]))
    assert factor in FACTORS
    assert 0.04 < factor * typical < 0.13
    # A wild row that was flagged changes nothing.
    wild = np.array(ur3_view.measured)
    wild[:15] += 100.0
    kinds = ("flagged",) * 15 + ur3_view.kinds[15:]
    assert magnification(replace(ur3_view, measured=wild, kinds=kinds), 1.0) == pytest.approx(
        factor
    )


def test_arrows_of_robots_that_agree_or_lie_far_apart_are_not_magnified(ur3, ur3_view):
    assert magnification(View(ur3, ur3, np.zeros((2, 6))), 1.0) == 1
    assert magnification(replace(ur3_view, measured=ur3_view.measured + 5.0), 1.0) == 1


def test_a_single_pose_is_told_like_those_of_the_table(ur3, disturb):
    view = View(ur3, disturb(ur3), np.full((1, 6), 0.3))
    shown = puppets(view, dict.fromkeys(view.robots, visuals_of(ur3)))
    pose = json.loads(pose_message(shown, "mine <b>"))["pose"]
    assert pose["label"] == "mine <b>"
    for who, puppet in shown.items():
        np.testing.assert_array_equal(floats(pose["robots"][who], -1, 7), packed(puppet.poses[0]))
