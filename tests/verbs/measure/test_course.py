"""The course of a session: what counts, what is taken back, what is tried again, and how the noise is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.data.measurements import Measurements
from calib.verbs.measure.aim import Aim
from calib.verbs.measure.breaks import Break
from calib.verbs.measure.course import Course
from calib.verbs.measure.session import Session
from calib.verbs.measure.stop import Answer, Row
from calib.verbs.plan.forecast import information
from calib.verbs.plan.sensitivity import Sensitivity
from calib.verbs.simulate.scenario import VirtualCell
from tests.verbs.measure.sessions import (
    LENGTH,
    good_readings,
    points_cell,
    readings_at,
    started,
    virtual_cell,
    with_rows,
)

GOOD = 12


@pytest.fixture(scope="module")
def virtual(ur3):
    return virtual_cell(ur3, points_cell())


@pytest.fixture(scope="module")
def tables(virtual) -> list[Measurements]:
    return good_readings(virtual, GOOD + 12)


@pytest.fixture(scope="module")
def empty(virtual, tmp_path_factory) -> Course:
    with started(virtual, tmp_path_factory.mktemp("course") / "s") as session:
        return session._course


@pytest.fixture(scope="module")
def course(empty, tables) -> Course:
    return with_rows(empty, tables[:GOOD])


def row(table: Measurements, offset: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Row:
    return Row(table.joints[0], replace(table, points=table.points + offset))


def seen_of(course: Course) -> str:
    """All that follows from a course, to the last bit."""
    fit = course.fit
    parts: list[object] = [
        course.known.information.tolist(),
        course.known.noise.tolist(),
        course.known.freedom,
        course.aim,
        course.expected,
        course.curve,
        course.planned,
        course.breaks,
        [stop.counts for stop in course.stops],
        None if fit is None else fit.fitted.estimate.x.tolist(),
    ]
    choice = course.choice
    parts += [] if choice is None else [choice.design, choice.expected, choice.after_next]
    return repr(parts)


def virtual_of(course: Course) -> VirtualCell:
    """The same cell as that of the fixture."""
    return virtual_cell(course.robot, points_cell())


def answered(course: Course, *rows: Row) -> tuple[Course, list[Answer]]:
    answers = []
    for each in rows:
        course, answer = course.with_row(each, [])
        answers.append(answer)
    return course, answers


def test_a_stop_that_is_taken_back_was_never_added(course, tables):
    before = seen_of(course)
    for each in (row(tables[GOOD]), row(tables[GOOD], (5e-3, 0.0, 0.0))):
        after, _ = answered(course, each)
        assert seen_of(after) != before
        assert seen_of(after.without_last().refitted()) == before
    far, _ = answered(course, *(row(table) for table in tables[GOOD : GOOD + 6]))
    for _ in range(6):
        far = far.without_last()
    assert seen_of(far.refitted()) == before


def test_a_stop_that_agreed_with_the_one_before_is_taken_back_with_its_consent(course, tables):
    """Two readings of a pose that agree count together; without the second the first does not count again."""
    q = tables[GOOD].joints[0]
    first, second = (
        row(readings_at(virtual_of(course), [q], seed)[0], (5e-3, 0.0, 0.0)) for seed in (5, 6)
    )
    one, (answer,) = answered(course, first)
    assert (answer.outcome, one.stops[-1].counts) == ("again", False)
    two, (answer,) = answered(one, second)
    assert answer.outcome == "unknown"
    assert [stop.counts for stop in two.stops[-2:]] == [True, True]
    back = two.without_last().refitted()
    assert [stop.counts for stop in back.stops[-1:]] == [False]
    assert seen_of(back) == seen_of(one)
    assert back.repeated is back.stops[-1]


def test_a_fit_depends_on_the_stops_alone(empty, tables):
    """Whether they were added one by one, or some were added and taken back on the way."""
    count = 18
    straight = with_rows(empty, tables[:count])
    winding = empty
    for k in range(count):
        winding = with_rows(winding, [tables[k]])
        if k % 8 == 7:
            winding = with_rows(winding, [tables[count]]).without_last().refitted()
    assert straight.fit is not None
    assert winding.fit is not None
    assert (straight.fit.fitted.estimate.x == winding.fit.fitted.estimate.x).all()
    cold = replace(straight, fit=None, starts=()).refitted()
    assert cold.fit is not None
    assert (cold.fit.fitted.estimate.x == straight.fit.fitted.estimate.x).all()


def test_a_skipped_pose_is_not_proposed_again(course):
    choice = course.choice
    assert choice is not None
    q = course.design.joints[choice.design[0]]
    skipped = course.with_skipped(q, choice.design)
    other = skipped.choice
    assert other is not None
    assert choice.design[0] not in other.design
    assert skipped.skipped == (choice.design[0],)
    # It stays skipped when a stop is taken back.
    after, _ = answered(skipped, row(good_readings(virtual_of(course), GOOD + 3)[-1]))
    assert after.without_last().skipped == skipped.skipped
    # What is no candidate takes none with it.
    assert course.with_skipped(q + 0.01, None).skipped == ()


def test_a_pose_that_is_to_be_measured_again_can_be_skipped(course, tables):
    now, _ = answered(course, row(tables[GOOD], (5e-3, 0.0, 0.0)))
    assert now.repeated is now.stops[-1]
    left = now.with_skipped(tables[GOOD].joints[0], None)
    assert left.repeated is None
    # The next stop that is off is to be measured again.
    later, _ = answered(left, row(tables[GOOD + 1], (5e-3, 0.0, 0.0)))
    assert later.repeated is later.stops[-1]


def test_poses_that_are_measured_are_not_proposed_again(empty):
    course, proposed = empty, []
    virtual = virtual_of(empty)
    for seed in range(6):
        choice = course.choice
        assert choice is not None
        proposed.append(choice.design[0])
        q = course.design.joints[choice.design[0]]
        course, _ = course.with_row(row(readings_at(virtual, [q], seed)[0]), [q], choice.design)
        assert course.planned == choice.design
        assert course.choice is not None
        assert not {*course.choice.design} & {*proposed}
    assert len({*proposed}) == 6


def test_a_pose_is_tried_three_times_and_then_left(course, tables):
    # Each time elsewhere, so that no two readings agree.
    offsets = [(5e-3, 0.0, 0.0), (0.0, -7e-3, 0.0), (0.0, 0.0, 9e-3)]
    now = course
    for number, offset in enumerate(offsets, start=1):
        now, (answer,) = answered(now, row(tables[GOOD], offset))
        assert answer.outcome == "again"
        assert (now.repeated is None) == (number == 3)
    assert len(now.counted) == GOOD
    assert now.expected == course.expected or now.expected is not None
    assert now.choice is not None
    assert now.fit is course.fit


def test_after_a_good_try_nothing_is_to_be_repeated(course, tables):
    now, (bad, good) = answered(course, row(tables[GOOD], (5e-3, 0.0, 0.0)), row(tables[GOOD]))
    assert (bad.outcome, good.outcome) == ("again", "good")
    assert now.repeated is None
    assert [stop.counts for stop in now.stops[-2:]] == [False, True]


def test_elsewhere_readings_that_are_off_alike_do_not_agree(course, tables):
    now, answers = answered(
        course, row(tables[GOOD], (5e-3, 0.0, 0.0)), row(tables[GOOD + 1], (5e-3, 0.0, 0.0))
    )
    assert [answer.outcome for answer in answers] == ["again", "again"]
    assert len(now.counted) == GOOD


def test_what_follows_is_said_before_and_after(course, tables):
    after, (answer,) = answered(course, row(tables[GOOD]))
    assert course.expected is not None
    assert after.expected is not None
    assert answer.before == course.expected.high
    assert answer.after == after.expected.high < answer.before
    point = after.curve[-1]
    assert (point.stop, point.stops) == (GOOD + 1, GOOD + 1)
    assert (point.error, point.low, point.high) == (
        after.expected.error,
        after.expected.low,
        after.expected.high,
    )
    off, (answer,) = answered(course, row(tables[GOOD], (5e-3, 0.0, 0.0)))
    assert answer.after == answer.before
    assert (off.curve[-1].stop, off.curve[-1].stops) == (GOOD + 1, GOOD)


def test_what_is_known_is_the_information_of_the_stops_over_the_noise(course):
    q = np.array([stop.row.joints for stop in course.stops])
    A = course.design.sensitivity.measured(q)
    total = information(A) / course.known.noise[0] ** 2
    assert course.known.information == pytest.approx(total, rel=1e-9, abs=1e-12 * total.max())
    assert len(set(course.known.noise.tolist())) == 1


def test_after_a_break_earlier_stops_tell_of_the_robot_alone(course, virtual):
    """The parameters of what has moved have the information of the stops since then."""
    T = virtual.truth.T_tip_target.copy()
    T[0, :3, 3] += [2e-3, 0.0, 1e-3]
    knocked = replace(virtual, truth=replace(virtual.truth, T_tip_target=T))
    since = good_readings(knocked, GOOD + 5, 9)[GOOD:]
    now = course
    for table in since:
        now, _ = answered(now, row(table), row(table))  # off at first, and the same again
        if now.breaks and now.breaks[-1].is_decided:
            break
    assert [broken.code for broken in now.breaks] == ["target_moved"]
    assert now.breaks[0].stop <= GOOD + 2
    sensitivity = now.design.sensitivity
    places = [p.place for p in sensitivity.kinematics.model.parameters]
    of_target = np.array([place == "(target)" for place in places])
    numbers = [stop for stop in now.counted if stop.number >= now.breaks[0].stop]
    q = np.array([stop.row.joints for stop in numbers])
    A = sensitivity.measured(q) / now.known.noise[:, None]
    own = information(A)[np.ix_(of_target, of_target)]
    assert now.known.information[np.ix_(of_target, of_target)] == pytest.approx(own, rel=1e-9)
    # Less than if nothing had moved.
    whole = information(
        sensitivity.measured(np.array([stop.row.joints for stop in now.counted]))
        / now.known.noise[:, None]
    )
    assert np.linalg.eigvalsh(whole - now.known.information).min() > -1e-6 * np.abs(whole).max()
    assert now.cell_now.targets["target (2)"] == pytest.approx(T[0, :3, 3], abs=3e-3)
    names = {name for table in now.tables() for name in table.targets}
    assert names == {"target", "target (2)"}


# The noise


def noise_with(ur3, tmp_path, stated: float | None, true: float, count: int) -> tuple[float, float]:
    """Noise of a session over the stated or assumed one, and its freedom, after so many stops of a true noise."""
    cell = points_cell()
    virtual = virtual_cell(ur3, replace(cell, sigma={"m": true}))
    known = replace(cell, sigma={} if stated is None else {"m": stated})
    with Session.start(tmp_path / "s", ur3, known, Aim(error=1e-4), collisions=False) as session:
        course = session._course
    course = with_rows(course, good_readings(virtual, count, 4))
    return float(course.known.noise[0]), course.known.freedom


def test_a_stated_noise_that_the_stops_do_not_contradict_is_known(ur3, tmp_path):
    noise, freedom = noise_with(ur3, tmp_path, LENGTH, LENGTH, 20)
    assert noise == pytest.approx(1.0, abs=0.15)
    assert freedom == pytest.approx(300.0 + 60.0 - 13.0, abs=1.0)


@pytest.mark.parametrize("times", [4.0, 0.25])
def test_a_stated_noise_that_the_stops_contradict_does_not_count(ur3, tmp_path, times):
    noise, freedom = noise_with(ur3, tmp_path, LENGTH, times * LENGTH, 20)
    assert noise == pytest.approx(times, rel=0.25)
    assert freedom == pytest.approx(60.0 - 13.0, abs=1.0)


def test_an_assumed_noise_soon_does_not_count(ur3, tmp_path):
    noise, freedom = noise_with(ur3, tmp_path, None, LENGTH, 20)
    sensitivity = Sensitivity.of(ur3, points_cell(sigma={}))
    assumed = sensitivity.sigma_by_unit(np.zeros((1, 6)))["m"]
    assert assumed != LENGTH
    # Four numbers of the assumed noise, and 47 of the true one.
    square = (4.0 * assumed**2 + 47.0 * LENGTH**2) / 51.0
    assert noise * assumed == pytest.approx(np.sqrt(square), rel=0.25)
    assert freedom == pytest.approx(51.0, abs=1.0)


def test_an_aim_is_not_reached_before_stops_check_each_other(empty, virtual):
    course = with_rows(empty, good_readings(virtual, 16))
    assert course.expected is not None
    wide = replace(course, error=10.0 * course.expected.high)
    assert wide.reached
    alone = tuple(
        replace(stop, answer=replace(stop.answer, outcome="unknown")) for stop in wide.stops
    )
    assert not replace(wide, stops=alone).reached
    undecided = Break(16, "target", "", np.eye(4), np.eye(4))
    assert not replace(wide, breaks=(undecided,)).reached


def test_no_error_is_expected_before_the_stops_determine_the_robot(empty, virtual):
    tables = good_readings(virtual, 16)
    rank = empty.design.workspace.rank
    fewest = -(-rank // 3)
    assert with_rows(empty, tables[: fewest - 1]).expected is None
    course = with_rows(empty, tables)
    assert course.expected is not None
    assert course.curve[0].stops == fewest
    # Nor while it is not known what has moved.
    undecided = Break(16, "target", "", np.eye(4), np.eye(4))
    assert replace(course, breaks=(undecided,)).expected is None
    # Nor has a stop a residual that cannot be judged yet.
    assert [dict(stop.answer.residual) for stop in course.stops[:4]] == [{}] * 4


def test_a_station_that_its_stops_do_not_place_is_not_calibrated(empty, virtual):
    course = with_rows(empty, good_readings(virtual, 16))
    # A new station has six unknowns: three points that are left when one is held out have nine numbers.
    for first, kept in ((16, 15), (14, 13), (13, 16)):
        moved = replace(course, breaks=(Break(first, None, "", None, np.eye(4)),))
        assert len(moved.tables()) == 16
        assert len(moved.tables_to_calibrate()) == kept
