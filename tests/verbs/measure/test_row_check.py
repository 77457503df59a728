"""The check of a stop: each mistake is named, and good stops are not."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import f

from calib.data.measurements import Measurements
from calib.robot.robot import Robot
from calib.verbs.measure.row_check import History, RowCheck, check_row, contradiction, is_same_again
from calib.verbs.measure.stop import Answer, Finding
from calib.verbs.simulate.operator import Operator
from tests.verbs.measure.sessions import (
    ANGLE,
    LENGTH,
    fit_of,
    good_readings,
    measured,
    points_cell,
    readings_at,
    started,
    virtual_cell,
)

#: A usual history: twenty good stops of three numbers.
USUAL = History(60.0, 60.0)

GOOD = 15


class Known:
    """Good stops, the fit to them, and a check of one more."""

    def __init__(self, robot: Robot, cell: Any, rank: int) -> None:
        self.virtual = virtual_cell(robot, cell)
        self.tables = good_readings(self.virtual, GOOD + 10)
        self.fit = fit_of(self.virtual, self.tables[:GOOD])
        self.rank = rank
        self.before = [*enumerate(self.tables[:GOOD], start=1)]

    def check(
        self, table: Measurements, proposed: list[np.ndarray] | None = None, **options: Any
    ) -> RowCheck:
        given = {"fit": self.fit, "history": USUAL, **options}
        return check_row(
            self.virtual.truth.nominal,
            given["fit"],
            table,
            GOOD + 1,
            self.before,
            proposed or [],
            given["history"],
            self.rank,
        )

    def finding(self, table: Measurements, proposed: list[np.ndarray] | None = None) -> Finding:
        check = self.check(table, proposed)
        assert check.is_off
        assert check.square > check.limit or check.findings[0].code == "repeated"
        (finding,) = check.findings
        assert finding.stops == (GOOD + 1,)
        return finding

    def at(self, noted: np.ndarray, stood: np.ndarray, seed: int = 77) -> Measurements:
        """A reading where the robot stood, with the joint values that were noted."""
        (table,) = readings_at(self.virtual, [stood], seed)
        return replace(table, joints=np.tile(noted, (len(table), 1)))


@pytest.fixture(scope="module", params=["ur3", "panda"])
def points(request: pytest.FixtureRequest) -> Known:
    robot = request.getfixturevalue(request.param)
    return Known(robot, points_cell(), len(robot.joint_names) + 7)


@pytest.fixture(scope="module")
def poses(ur3) -> Known:
    cell = points_cell(kind="pose")
    return Known(ur3, replace(cell, sigma={"m": LENGTH, "rad": ANGLE}), 16)


@pytest.fixture(scope="module")
def two_targets(ur3) -> Known:
    places = {"a": [0.0, 0.0, 0.1], "b": [0.05, 0.0, 0.08]}
    return Known(ur3, points_cell(targets=places, estimate_target=True), 16)


@pytest.fixture(scope="module", params=["points", "poses", "two_targets"])
def known(request: pytest.FixtureRequest) -> Known:
    if request.param == "points":
        robot = request.getfixturevalue("ur3")
        return Known(robot, points_cell(), len(robot.joint_names) + 7)
    result: Known = request.getfixturevalue(request.param)
    return result


def moved_by(table: Measurements, offset: list[float], row: int = 0) -> Measurements:
    points = table.points.copy()
    points[row] += offset
    return replace(table, points=points)


def test_good_stops_are_good(known: Known):
    checks = [known.check(table) for table in known.tables[GOOD:]]
    assert [check.is_off for check in checks] == [False] * 10
    assert all(check.square <= check.limit and check.findings == () for check in checks)


@pytest.mark.parametrize("size", [1e-3, 5e-3, 0.3])
def test_a_gross_reading_is_named_with_its_size(known: Known, size: float):
    offset = [0.48 * size, -0.6 * size, 0.64 * size]
    finding = known.finding(moved_by(known.tables[GOOD], offset))
    assert finding.code == "gross"
    count = len(known.tables[GOOD])  # the rms over the targets, of which one is off
    off = size / np.sqrt(count)
    assert finding.values["off_m"] == pytest.approx(off, abs=5e-4)


def test_a_gross_orientation_is_named_with_its_angle(poses: Known):
    table = poses.tables[GOOD]
    angle = np.deg2rad(1.5)
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )
    finding = poses.finding(replace(table, rotations=turn @ table.rotations))
    assert finding.code == "gross"
    assert finding.values["off_rad"] == pytest.approx(angle, abs=3e-3)


@pytest.mark.parametrize("order", ["yxz", "zyx", "yzx"])
def test_swapped_axes_are_named(points: Known, order: str):
    table = points.tables[GOOD]
    columns = ["xyz".index(letter) for letter in order]
    finding = points.finding(replace(table, points=table.points[:, columns]))
    assert finding.code == "swapped"
    # The name tells which column of the reading is x, y and z.
    back = ["xyz".index(letter) for letter in finding.name]
    assert [columns[k] for k in back] == [0, 1, 2]


def test_swapped_targets_are_named(two_targets: Known):
    table = two_targets.tables[GOOD]
    assert table.targets == ("a", "b")
    finding = two_targets.finding(replace(table, targets=("b", "a")))
    assert finding.code == "swapped"
    assert {*finding.name.split(", ")} == {"a", "b"}


def test_a_reading_that_is_given_twice_is_that_of_its_stop(known: Known):
    table = replace(known.tables[4], joints=known.tables[GOOD].joints)
    finding = known.finding(table)
    assert (finding.code, finding.values["stop"]) == ("repeated", 5.0)


def test_a_pose_that_is_measured_twice_is_that_of_its_stop(known: Known):
    table = known.at(known.tables[GOOD].joints[0], known.tables[6].joints[0])
    finding = known.finding(table)
    assert (finding.code, finding.values["stop"]) == ("repeated", 7.0)


def test_the_same_pose_may_be_measured_twice(known: Known):
    assert known.check(known.tables[3]).is_off is False
    again = known.at(known.tables[3].joints[0], known.tables[3].joints[0])
    assert known.check(again).is_off is False


@pytest.mark.parametrize("change", [0.02, -0.11, 0.35])
@pytest.mark.parametrize("joint", [0, 2, 4])
def test_a_joint_that_is_elsewhere_is_named_with_its_change(
    points: Known, joint: int, change: float
):
    q = points.tables[GOOD].joints[0]
    stood = q.copy()
    stood[joint] += change
    finding = points.finding(points.at(q, stood))
    assert finding.code == "not_there"
    assert finding.name == points.virtual.truth.nominal.joint_names[joint]
    assert finding.values["change"] == pytest.approx(change, abs=3e-3)


def test_a_reading_at_the_proposed_pose_with_joint_values_of_another_is_named(known: Known):
    proposed, noted = known.tables[GOOD].joints[0], known.tables[GOOD + 1].joints[0]
    finding = known.finding(known.at(noted, proposed), [proposed])
    assert (finding.code, finding.values["stop"]) == ("not_there", 0.0)


def test_a_target_or_station_that_the_fit_has_not_is_unknown(known: Known):
    table = known.tables[GOOD]
    check = known.check(replace(table, groups=("elsewhere",) * len(table)))
    assert check.prediction is None
    assert check.is_off is None
    assert check.findings == ()


def test_without_a_fit_readings_are_held_against_the_nominal_robot(points: Known):
    good, counted = points.tables[GOOD], [*enumerate(points.tables[:6], start=1)]
    robot = points.virtual.truth.nominal
    assert points.check(good, fit=None).is_off is None
    assert contradiction(robot, None, counted, good, 7) is None
    far = contradiction(robot, None, counted, moved_by(good, [0.0, 5.0, 0.0]), 7)
    assert far is not None
    assert (far.code, far.stops) == ("gross", (7,))
    # The same place though the robot has moved; a mere hundredth of a millimetre is noise.
    turned = points.tables[2].joints.copy()
    turned[:, 1] += 0.6
    copied = replace(good, joints=turned, points=points.tables[2].points + 1e-5)
    finding = contradiction(robot, None, counted, copied, 7)
    assert finding is not None
    assert (finding.code, finding.values["stop"]) == ("repeated", 3.0)


def test_after_few_stops_only_what_is_far_off_is_named(points: Known):
    fit = fit_of(points.virtual, points.tables[:4])
    table = points.tables[GOOD]
    check = points.check(table, fit=fit)
    assert check.is_off is None
    assert check.findings == ()
    far = points.check(moved_by(table, [3.0, 0.0, 0.0]), fit=fit)
    assert far.is_off


def test_a_history_tells_how_large_squares_are():
    assert History().factor == 1.0
    # A mean of forty squares as chance gives it once in a thousand times, over a noise as little known.
    most = float(f.isf(1e-3, 40, 46))
    assert History(0.99 * most * 40.0, 40.0).factor == 1.0
    assert History(1.01 * most * 40.0, 40.0).factor == pytest.approx(1.01 * most)
    assert History(5.0, 40.0).factor == 1.0


@pytest.mark.parametrize("numbers", [1, 3, 6])
def test_the_limit_is_passed_by_one_good_stop_in_a_thousand(numbers: int):
    for known in (0.0, 30.0, 300.0):
        limit = History(known, known).limit(numbers)
        assert f.sf(limit, numbers, known + 6.0) == pytest.approx(1e-3, rel=1e-6)


def test_a_noisier_session_has_a_wider_limit(points: Known):
    table = moved_by(points.tables[GOOD], [0.0, 3e-4, 0.0])
    assert points.check(table).is_off
    assert points.check(table, history=History(60.0 * 25.0, 60.0)).is_off is False


def test_two_readings_of_a_pose_agree_if_their_difference_is_noise(points: Known):
    fit, q = points.fit, points.tables[GOOD].joints[0]
    first, second = (moved_by(points.at(q, q, seed), [5e-3, 0.0, 0.0]) for seed in (5, 6))
    assert is_same_again(fit, first, second, USUAL) == (True, True)
    other = moved_by(second, [0.0, 1e-3, 0.0])
    assert is_same_again(fit, first, other, USUAL)[0] is False
    good = points.at(q, q, 7)
    assert is_same_again(fit, good, points.at(q, q, 8), USUAL) == (True, False)


# Whole sessions


def answers_of(robot: Robot, cell: Any, folder: Any, seed: int, count: int) -> list[Answer]:
    virtual = virtual_cell(robot, cell, seed)
    with started(virtual, folder / f"s{seed}") as session:
        return measured(session, Operator.of(virtual, seed), count)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "model", "kind"),
    [
        ("ur3", "placement", "point"),
        ("panda", "placement", "point"),
        ("ur3", "placement", "pose"),
        ("ur3", "zeros", "point"),
    ],
)
def test_of_several_hundred_good_rows_one_in_a_hundred_at_most_is_to_be_measured_again(
    request: pytest.FixtureRequest, tmp_path, name: str, model: str, kind: str
):
    robot = request.getfixturevalue(name)
    cell = points_cell(model, kind=kind)
    if kind == "pose":
        cell = replace(cell, sigma={"m": LENGTH, "rad": ANGLE})
    outcomes, codes = [], []
    for seed in range(12):
        for answer in answers_of(robot, cell, tmp_path, seed, 30):
            outcomes.append(answer.outcome)
            codes += [finding.code for finding in answer.findings]
    assert len(outcomes) == 360
    wrong = outcomes.count("again") + len([code for code in codes if code.endswith("moved")])
    assert wrong <= 3
    assert outcomes.count("good") > 200
