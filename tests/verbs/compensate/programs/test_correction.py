"""Corrected programs: nothing changes without errors, and with errors the true arm arrives."""

from __future__ import annotations

import numpy as np
import pytest

from calib.robot.robot import Robot
from calib.verbs.compensate.programs.correction import corrected
from tests.verbs.compensate.arms import off, turned
from tests.verbs.compensate.programs.controller import arrival
from tests.verbs.compensate.programs.plain import line_of, plain

ARM = Robot.load("ur5", base="base", tip="tool0")
TRUE = off(ARM)
Q = np.array([0.3, -1.2, 1.5, -1.0, -1.4, 0.4])
T = ARM.poses(Q)[0]
LIMIT = 5e-6
HALF = np.array([np.pi, 0.0, 0.0, 0.0, 0.0, 0.0])

TEXT = (
    line_of("J", Q, decimals=2)
    + line_of("L", T, decimals=0)
    + line_of("L", T @ turned(1, 0.05), decimals=1)
    + line_of("P", T @ turned(2, 0.1), decimals=3)
)


@pytest.mark.parametrize("convention", ["kuka", "abb", "fanuc", "rotation-vector"])
def test_no_errors_change_nothing(convention):
    text = line_of("J", Q, decimals=2) + "".join(
        line_of("L", T @ turned(k, 0.1), convention, decimals=2) for k in range(5)
    )
    result = corrected(plain(text, convention=convention), ARM, ARM)
    assert result.texts[0].text == text
    assert result.is_corrected.all()
    assert result.corrections.max() < 1e-12


@pytest.mark.parametrize("convention", ["kuka", "abb", "fanuc", "rotation-vector"])
def test_the_true_arm_arrives(convention):
    text = line_of("J", Q, decimals=1) + "".join(
        line_of("LP"[k % 2], T @ turned(k, 0.1), convention, decimals=1) for k in range(6)
    )
    tools = [turned(9, 0.1)] * 3 + [turned(8, 0.2)] * 4
    frame = turned(7, 0.05)
    old = plain(text, convention=convention, tools=tools, frame=frame)
    result = corrected(old, ARM, TRUE)
    new = plain(result.texts[0].text, convention=convention, tools=tools, frame=frame)
    before = arrival(ARM, TRUE, old, old)
    after = arrival(ARM, TRUE, old, new)
    assert before.min() > 3e-4
    assert after.max() < LIMIT
    assert len(result.commands) == 2
    np.testing.assert_allclose(result.shared, 0.0, atol=1e-12)


def test_what_is_not_a_number_stays():
    result = corrected(plain(TEXT), ARM, TRUE)
    before, after = TEXT.splitlines(), result.texts[0].text.splitlines()
    for old, new in zip(before, after, strict=True):
        assert old[:2] == new[:2]
        assert old.partition("#")[1:] == new.partition("#")[1:]


def test_a_target_in_two_frames_is_left():
    half_turn = np.diag([-1.0, -1.0, 1.0, 1.0])
    text = line_of("J", Q) + line_of("L", T) + line_of("J", Q + HALF) + line_of("L", T)
    frames = [np.eye(4)] * 3 + [half_turn]
    result = corrected(plain(text, frames=frames, same={4: 2}), ARM, TRUE)
    assert [(item.code, item.line) for item in result.left] == [("shared", 2)]
    assert np.isnan(result.corrections[[1, 3]]).all()
    one_frame = corrected(plain(text, same={4: 2}), ARM, TRUE)
    assert not one_frame.left
    assert one_frame.is_corrected.all()


def test_a_target_of_two_tools_has_their_mean_if_that_is_better_for_both():
    text = line_of("J", Q) + line_of("L", T) * 2
    tools = [np.eye(4), np.eye(4), turned(3, 0.3)]
    program = plain(text, tools=tools, same={3: 2})
    result = corrected(program, ARM, TRUE)
    again = plain(result.texts[0].text, tools=tools, same={3: 2})
    before, after = arrival(ARM, TRUE, program, program), arrival(ARM, TRUE, program, again)
    assert (after[1:] < 0.6 * before[1:]).all()
    assert after[1:].min() > LIMIT
    np.testing.assert_allclose(after[1:], result.shared[1:, 0], rtol=0.02)


def test_few_digits_cost_what_is_said():
    program = plain(TEXT, most_decimals=1)
    result = corrected(program, ARM, TRUE)
    again = plain(result.texts[0].text, most_decimals=1)
    after = arrival(ARM, TRUE, program, again)
    assert after.max() > 1e-5
    np.testing.assert_allclose(after, result.rounded[:, 0], atol=5e-6)


def test_what_cannot_be_reached_stays():
    far = T.copy()
    far[0, 3] += 3.0
    text = line_of("J", Q) + line_of("L", far) + line_of("L", T)
    result = corrected(plain(text), ARM, TRUE)
    assert [reason and reason.code for reason in result.reasons] == [None, "unreachable", None]
    old, new = text.splitlines(), result.texts[0].text.splitlines()
    assert [a == b for a, b in zip(old, new, strict=True)] == [False, True, False]
