"""The state of a session: what is still needed, what would help, and what is open."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import least_squares

from calib.data.measurements import Measurements
from calib.verbs.measure.aim import Aim
from calib.verbs.measure.course import Course
from calib.verbs.measure.session import Session
from calib.verbs.measure.state import state_of
from calib.verbs.measure.stop import Row
from calib.verbs.simulate.operator import Operator
from calib.verbs.simulate.scenario import VirtualCell
from calib.verbs.simulate.virtual_session import known_cell
from tests.verbs.measure.sessions import (
    ANGLE,
    LENGTH,
    good_readings,
    measured,
    points_cell,
    readings_at,
    rms_of,
    started,
    virtual_cell,
    with_rows,
)


@pytest.fixture(scope="module")
def virtual(ur3) -> VirtualCell:
    return virtual_cell(ur3, points_cell())


def course_of(virtual: VirtualCell, folder: Any, error: float | None = 1e-4) -> Course:
    with started(virtual, folder, Aim(error=error)) as session:
        return session._course


@pytest.fixture(scope="module")
def empty(virtual, tmp_path_factory) -> Course:
    return course_of(virtual, tmp_path_factory.mktemp("state") / "s")


@pytest.fixture(scope="module")
def course(empty, virtual) -> Course:
    return with_rows(empty, good_readings(virtual, 16))


def test_before_the_first_stop_nothing_is_known_but_the_aim(empty):
    state = state_of(empty)
    assert (state.stops, state.measured) == (0, 0)
    assert (state.error, state.low, state.high, state.nominal) == (None, None, None, None)
    assert state.aim == 1e-4
    assert not state.reached
    assert (state.curve, state.advice, state.findings, dict(state.sigma)) == ((), (), (), {})
    assert state.needed is not None
    least, most = state.needed
    assert 4 <= least <= most <= 20


def test_the_aim_is_reached_when_the_limit_is_within_it(course):
    expected = course.expected
    assert expected is not None
    for error, reached in ((1.001 * expected.high, True), (0.999 * expected.high, False)):
        state = state_of(replace(course, error=error))
        assert (state.reached, state.needed == (0, 0)) == (reached, reached)
        assert (state.error, state.low, state.high) == (expected.error, expected.low, expected.high)


def test_what_is_further_than_a_session_looks_is_not_foretold(course):
    assert state_of(replace(course, error=1e-7)).needed is None


@pytest.mark.slow
def test_the_poses_that_are_needed_are_foretold(ur3, tmp_path):
    """In most sessions the number of further poses is within what is said after a third of them."""
    within = []
    for seed in range(8):
        virtual = virtual_cell(ur3, points_cell(), seed)
        with started(virtual, tmp_path / f"s{seed}", Aim(error=6e-5)) as session:
            operator, said = Operator.of(virtual, seed), []
            while not session.state.reached:
                needed = session.state.needed
                assert needed is not None
                said.append(needed)
                measured(session, operator, 1)
        for number in (len(said) // 3, len(said) // 2, len(said) - 2):
            least, most = said[number]
            assert 1 <= least <= most
            within.append(least <= len(said) - number <= most)
    assert np.mean(within) >= 0.7


def test_the_error_of_the_nominal_robot_is_that_with_the_best_frame_and_target(course, virtual):
    """By least squares over places and twists, with the true and the nominal robot alone."""
    q = course.design.ground.pool.workspace[:400]
    truth = virtual.truth
    true = truth.poses(q)[:, :3, 3]
    tips = truth.nominal.poses(q)

    def off(z: np.ndarray) -> np.ndarray:
        D = pin.exp6(pin.Motion(z[:3], z[3:6])).homogeneous
        frame = truth.T_frame_base[0] @ D
        lever = truth.T_tip_target[0, :3, 3] + z[6:]
        places = tips[:, :3, :3] @ lever + tips[:, :3, 3]
        return np.asarray(places @ frame[:3, :3].T + frame[:3, 3] - true).ravel()

    best = least_squares(off, np.zeros(9)).x
    error = rms_of(np.linalg.norm(off(best).reshape(-1, 3), axis=1))
    assert state_of(course).nominal == pytest.approx(error, rel=0.1)


def codes(state: Any) -> dict[str, Any]:
    return {advice.code: advice for advice in state.advice}


@pytest.mark.parametrize("still", [1, 2, 3, 4])
def test_the_joint_is_named_whose_errors_make_much_of_the_expected_one(empty, virtual, still):
    """By brute force: the expected square with the errors of a joint known is that without these parameters."""
    q = virtual.poses(8, 5)
    q[:, still] = q[0, still] + np.linspace(0.0, 0.05, len(q))
    course = with_rows(empty, readings_at(virtual, [*q]))
    M, B = course.known.total, course.design.workspace.mean_square
    places = [p.place for p in course.design.sensitivity.kinematics.model.parameters]
    shares = {}
    for joint in virtual.truth.nominal.joint_names:
        rest = np.array([place != joint for place in places])
        known = np.trace(np.linalg.inv(M[np.ix_(rest, rest)]) @ B[np.ix_(rest, rest)])
        shares[joint] = 1.0 - known / np.trace(np.linalg.inv(M) @ B)
    most = max(shares, key=lambda joint: shares[joint])
    advice = codes(state_of(course)).get("joint")
    assert (advice is not None) == (shares[most] > 0.4)
    if advice is not None:
        assert advice.name == most
        assert advice.values["share"] == pytest.approx(shares[most], rel=1e-6)


def test_of_many_good_poses_no_joint_is_named(course):
    assert "joint" not in codes(state_of(course))


def test_a_second_target_helps_points_and_not_poses(course, ur3, tmp_path):
    assert "second_target" in codes(state_of(course))
    cell = replace(points_cell(kind="pose"), sigma={"m": LENGTH, "rad": ANGLE})
    poses = virtual_cell(ur3, cell)
    other = with_rows(course_of(poses, tmp_path / "p"), good_readings(poses, 8))
    assert "second_target" not in codes(state_of(other))
    places = {"a": [0.0, 0.0, 0.1], "b": [0.05, 0.0, 0.08]}
    two = virtual_cell(ur3, points_cell(targets=places, estimate_target=True))
    other = with_rows(course_of(two, tmp_path / "t"), good_readings(two, 8))
    assert "second_target" not in codes(state_of(other))


def test_an_instrument_that_is_noisier_than_stated_is_named(ur3, tmp_path):
    noisy = virtual_cell(ur3, points_cell(sigma={"m": 5.0 * LENGTH}))
    with Session.start(tmp_path / "s", ur3, points_cell(), Aim(error=1e-4), collisions=False) as s:
        course = with_rows(s._course, good_readings(noisy, 18))
    advice = codes(state_of(course))
    assert advice["noise"].values["factor"] == pytest.approx(5.0, rel=0.25)
    assert known_cell(noisy, 1).sigma["m"] == 5.0 * LENGTH


def test_a_noise_as_stated_is_not_named(course):
    state = state_of(course)
    assert "noise" not in codes(state)
    assert state.sigma["m"] == pytest.approx(LENGTH, rel=0.3)


def test_a_part_of_space_without_poses_is_named(ur3, tmp_path):
    """All stops are in one part: the middle of the worst part is elsewhere."""
    virtual = virtual_cell(ur3, points_cell("placement"))
    empty = course_of(virtual, tmp_path / "s")
    q = virtual.poses(400, 5)
    places = ur3.poses(q)[:, :3, 3]
    near = q[(places[:, 0] > 0.1) & (places[:, 1] > 0.0) & (places[:, 2] > 0.1)][:22]
    course = with_rows(empty, readings_at(virtual, [*near]))
    advice = codes(state_of(course))
    if "region" in advice:
        assert advice["region"].values["ratio"] > 1.5
    assert advice


def test_lost_motion_that_the_model_lacks_is_named(empty, ur3):
    lost = virtual_cell(ur3, points_cell("zeros+lost_motion"), 1)
    operator = Operator.of(lost, 1)
    course = with_rows(empty, [operator.measure(q).readings for q in lost.poses(30, 1)])
    advice = codes(state_of(course))["lost_motion"]
    names = lost.truth.model.names
    sizes = {
        name.removesuffix(".lost_motion"): abs(x)
        for name, x in zip(names, lost.truth.x, strict=True)
        if name.endswith(".lost_motion")
    }
    assert abs(advice.values["change"]) == pytest.approx(sizes[advice.name], rel=0.4)


def test_a_gross_reading_that_nobody_could_tell_is_found_later(empty, virtual):
    tables: list[Measurements] = good_readings(virtual, 16)
    tables[4] = replace(tables[4], points=tables[4].points + np.array([0.0, 3e-3, 0.0]))
    early = with_rows(empty, tables[:5])
    assert early.stops[4].counts
    late = with_rows(early, tables[5:])
    said = [f for stop in late.stops for f in stop.answer.findings]
    found = [(f.code, f.stops) for f in (*state_of(late).findings, *said)]
    assert ("gross", (5,)) in found
    assert not late.stops[4].counts or late.outliers == (5,)


def test_findings_that_are_open_are_those_of_what_has_moved(empty, virtual):
    T = virtual.truth.T_tip_target.copy()
    T[0, :3, 3] += [2e-3, 0.0, 1e-3]
    knocked = replace(virtual, truth=replace(virtual.truth, T_tip_target=T))
    course = with_rows(empty, good_readings(virtual, 12))
    for table in good_readings(knocked, 18, 9)[12:]:
        for _ in range(2):
            course, _answer = course.with_row(Row(table.joints[0], table), [])
    (finding,) = state_of(course).findings
    assert (finding.code, finding.name) == ("target_moved", "target")
    assert finding.stops[0] == course.breaks[0].stop >= 13
    assert {*finding.stops} == {s.number for s in course.counted if s.number >= finding.stops[0]}
