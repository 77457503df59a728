"""Design: which poses, how many, and which one first."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from calib.basics.arrays import read_only
from calib.verbs.measure.design import Design, Known
from calib.verbs.measure.session import Session
from calib.verbs.plan.forecast import information
from calib.verbs.plan.optimal import Basis, choose
from tests.verbs.measure.sessions import points_cell, started, virtual_cell

FREEDOM = 20.0


@pytest.fixture(scope="module")
def whole(ur3, tmp_path_factory) -> Design:
    """The design of a session that knows nothing but priors."""
    folder = tmp_path_factory.mktemp("design") / "s"
    session: Session = started(virtual_cell(ur3, points_cell()), folder)
    with session:
        return session._course.design


@pytest.fixture(scope="module")
def few(whole: Design) -> Design:
    """Twelve of its candidates."""
    return of_candidates(whole, np.arange(0, 800, 70))


def of_candidates(design: Design, kept: np.ndarray) -> Design:
    return replace(
        design,
        joints=read_only(design.joints[kept]),
        measured=read_only(design.measured[kept]),
        moves=None if design.moves is None else design.moves[kept],
    )


def known_by(design: Design, measured: list[int], noise: float = 1.0) -> Known:
    """What poses that are measured already tell, with some noise over the stated one."""
    scalars = design.measured.shape[1]
    return Known(
        information=information(design.measured[measured] / noise),
        precision=design.sensitivity.precision,
        noise=np.full(scalars, noise),
        freedom=FREEDOM,
    )


def errors_of(design: Design, known: Known, chosen: tuple[int, ...]) -> tuple[float, float]:
    """The expected error and its limit with further poses, by an inverse."""
    A = design.measured[list(chosen)] / known.noise[:, None]
    M = known.total + np.einsum("nip,niq->pq", A, A)
    expected = design.expected(M, known.freedom + 3.0 * len(chosen))
    error = np.sqrt(np.trace(np.linalg.inv(M) @ design.workspace.mean_square))
    assert expected.error == pytest.approx(error, rel=1e-6)
    return float(error), expected.high


@pytest.mark.parametrize("noise", [1.0, 2.5])
@pytest.mark.parametrize("size", [1, 2, 3, 4])
def test_of_few_candidates_it_is_the_best_of_all_designs(few: Design, size: int, noise: float):
    known = known_by(few, [0, 3, 6, 9, 11], noise)
    free = [k for k in range(len(few.joints)) if k not in (0, 3, 6, 9, 11)]
    best = [
        min((errors_of(few, known, chosen), chosen) for chosen in combinations(free, n))
        for n in range(1, size + 1)
    ]
    (_, high), _ = best[-1]
    choice = few.choose(known, high * (1.0 + 1e-9), None, (), (0, 3, 6, 9, 11))
    assert choice is not None
    assert len(choice.design) == size
    assert set(choice.design) == set(best[-1][1])
    assert choice.expected.error == pytest.approx(best[-1][0][0], rel=1e-9)
    assert choice.expected.high == pytest.approx(high, rel=1e-9)


@pytest.mark.parametrize("count", [7, 10, 14])
def test_it_takes_no_more_poses_than_a_plan(whole: Design, count: int):
    known = known_by(whole, [])
    A = whole.measured
    basis = Basis.of(information(A) / len(A), known.total, whole.workspace.mean_square)
    plan = choose(A @ basis.directions, basis, count, 0)
    _, high = errors_of(whole, known, tuple(plan.tolist()))
    # Both are local optima: a hundredth is a third of a pose.
    choice = whole.choose(known, 1.01 * high, None)
    assert choice is not None
    assert len(choice.design) <= count
    assert choice.expected.high <= 1.01 * high


def test_the_error_after_the_next_pose_is_what_its_information_tells(whole: Design):
    known = known_by(whole, [5, 100, 200, 300, 400, 500, 600], 1.7)
    choice = whole.choose(known, 1e-5, whole.joints[0])
    assert choice is not None
    error, high = errors_of(whole, known, choice.design[:1])
    assert choice.after_next.error == pytest.approx(error, rel=1e-9)
    assert choice.after_next.high == pytest.approx(high, rel=1e-9)
    error, high = errors_of(whole, known, choice.design)
    assert choice.expected.error == pytest.approx(error, rel=1e-9)
    assert choice.expected.high == pytest.approx(high, rel=1e-9)


def test_the_next_pose_is_near_among_those_that_tell_much(whole: Design):
    known = known_by(whole, [5, 100, 200, 300, 400, 500, 600])
    C, B = np.linalg.inv(known.total), whole.workspace.mean_square
    last = whole.joints[7]
    choice = whole.choose(known, 3e-5, last)
    assert choice is not None
    assert len(choice.design) > 3
    gain = np.array(
        [
            np.trace(B @ C) - np.trace(B @ np.linalg.inv(known.total + A.T @ A))
            for A in whole.measured[list(choice.design)]
        ]
    )
    away = np.abs(whole.joints[list(choice.design)] - last).max(axis=1)
    telling = gain >= 0.6 * gain.max()
    assert telling[0]
    assert away[0] == away[telling].min()
    without = whole.choose(known, 3e-5, None)
    assert without is not None
    assert set(without.design) == set(choice.design)
    assert without.design[0] == choice.design[int(np.argmax(gain))]


def test_what_is_left_out_is_not_proposed(few: Design):
    known = known_by(few, [])
    everything = few.choose(known, 1e-9, None)
    assert everything is not None
    assert sorted(everything.design) == [*range(12)]
    assert everything.expected.high > 1e-9
    left = few.choose(known, 1e-9, None, everything.design, (2, 3, 4))
    assert left is not None
    assert sorted(left.design) == [0, 1, 5, 6, 7, 8, 9, 10, 11]
    one = few.choose(known, 1e-9, None, (), [k for k in range(12) if k != 8])
    assert one is not None
    assert one.design == (8,)
    assert few.choose(known, 1e-9, None, (), range(12)) is None


def test_a_pose_is_proposed_though_the_aim_is_reached(few: Design):
    choice = few.choose(known_by(few, [*range(12)]), 1.0, None)
    assert choice is not None
    assert len(choice.design) == 1


def test_a_design_is_kept_as_far_as_it_is_good(whole: Design):
    known = known_by(whole, [])
    first = whole.choose(known, 1e-4, None)
    assert first is not None
    again = whole.choose(known, 1e-4, None, first.design)
    assert again is not None
    assert again.design[0] == first.design[0]
    assert {*again.design} == {*first.design}
    # With the first one measured the others are still to be measured.
    after = known_by(whole, [first.design[0]])
    rest = whole.choose(after, 1e-4, None, first.design[1:], first.design[:1])
    assert rest is not None
    assert len(rest.design) <= len(first.design)
    assert first.design[0] not in rest.design


def test_candidates_are_those_on_which_an_optimal_design_relies(whole: Design):
    assert whole.measured.shape[0] == len(whole.joints) == 800
    pool = whole.ground.pool
    assert len(pool.q) == 6000
    there = {tuple(q) for q in pool.q.tolist()}
    assert all(tuple(q) in there for q in whole.joints.tolist())
    some = whole.sensitivity.measured(whole.joints[:5])
    assert np.allclose(some, whole.measured[:5], rtol=1e-12, atol=1e-9)
