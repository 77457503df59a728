from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from calib.errors import ModelError
from calib.example import paper_urdf
from calib.model.error_model import FRAME, TARGET, TIP, ErrorModel, Parameter
from calib.model.families import ANGLE, LENGTH, Factor
from calib.model.parameter_sets import DIRECTIONS, error_model
from calib.robot.robot import Robot

COMPLIANCE, ECCENTRICITY, GAIN = "compliance", "eccentricity", "gain"

PLACES = (FRAME, "j1", "j2", TIP, TARGET)


def some(
    name: str, unit: str = "m", place: str = "j1", k: int = 0, factor: Factor | None = None
) -> Parameter:
    """A parameter along or about an axis of a place."""
    return Parameter(name, unit, place, np.eye(6)[k], LENGTH if k < 3 else ANGLE, factor=factor)


@pytest.fixture
def four() -> ErrorModel:
    """Two lengths and two angles on two joints."""
    return ErrorModel(
        "four",
        PLACES,
        (some("a", k=0), some("b", "rad", k=4), some("c", "m", "j2", 1), some("d", "rad", "j1", 5)),
    )


# What a model says of itself


def test_an_unknown_parameter_lists_those_there_are(four):
    with pytest.raises(ModelError, match=r"'four' has no parameter 'e'; it has 'a', 'b', 'c', 'd'"):
        four.index("e")


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ((some("a"), some("b"), some("a", k=1)), "parameters 'a' twice"),
        ((some("a"), some("b", place="j3")), "at unknown places 'j3'"),
    ],
    ids=["a name twice", "an unknown place"],
)
def test_parameters_have_names_of_their_own_and_places_of_the_model(parameters, message):
    with pytest.raises(ModelError, match=message):
        ErrorModel("wrong", PLACES, parameters)


def test_errors_of_frames_and_targets_are_not_the_robots(ur3):
    model = error_model(ur3, "zeros", frame=True)
    named = dict(zip(model.names, model.of_robot, strict=True))
    assert {name for name, is_robots in named.items() if not is_robots} == {
        *(f"frame_{direction}" for direction in DIRECTIONS),
        *(f"target_{direction}" for direction in "xyz"),
    }


@pytest.mark.parametrize(
    ("name", "moves", "loads"),
    [
        ("dh", False, False),
        ("dh+gain", False, False),
        ("dh+lost_motion", True, False),
        ("dh+creep", True, False),
        ("dh+compliance", False, True),
    ],
)
def test_a_model_says_if_it_needs_moves_or_loads(ur3, name, moves, loads):
    model = error_model(ur3, name)
    assert (model.depends_on_moves, model.depends_on_loads) == (moves, loads)


# Ties


def test_a_tied_parameter_keeps_its_term_and_is_no_unknown(four):
    tied = four.tied({"c": ("a", -2.0)})
    assert tied.names == ("a", "b", "d")
    assert [t.name for t in tied.terms] == ["a", "b", "c", "d"]
    np.testing.assert_array_equal(tied.mixing, [[1, 0, 0], [0, 1, 0], [-2, 0, 0], [0, 0, 1]])
    assert not tied.mixing.flags.writeable
    np.testing.assert_array_equal(tied.values(np.array([1.0, 2.0, 3.0])), [1, 2, -2, 3])
    # the free model is as it was
    assert (four.names, four.mixing.shape) == (("a", "b", "c", "d"), (4, 4))


TIES = {
    "no such follower": ({"e": ("a", 1.0)}, "has no parameter 'e'"),
    "no such leader": ({"a": ("e", 1.0)}, "has no parameter 'e'"),
    "itself": ({"a": ("a", 1.0)}, "is free and of the same unit"),
    "in a circle": ({"a": ("c", 1.0), "c": ("a", 1.0)}, "is free and of the same unit"),
    "another unit": ({"a": ("b", 1.0)}, "is free and of the same unit"),
}


@pytest.mark.parametrize(("ties", "message"), TIES.values(), ids=TIES)
def test_ties_that_cannot_be(four, ties, message):
    with pytest.raises(ModelError, match=message):
        four.tied(ties)


# Freezing


def test_without_a_leader_those_that_follow_it_go_too(four):
    less = four.tied({"c": ("a", -2.0)}).without(["a"])
    assert less.names == ("b", "d")
    assert [t.name for t in less.terms] == ["b", "d"]
    np.testing.assert_array_equal(less.mixing, np.eye(2))
    assert (less.name, less.places) == ("four", PLACES)


# Displacements


def test_displacements_are_exponentials_in_the_order_of_the_terms(four):
    x = np.array([0.1, 0.2, 0.3, 0.4])
    D, S = four.displacements(x)
    factors = [pin.exp6(p.direction * v) for p, v in zip(four.parameters, x, strict=True)]
    expected = factors[0] * factors[1] * factors[3]
    np.testing.assert_allclose(D[1], expected.homogeneous, atol=1e-16)
    np.testing.assert_allclose(D[2], factors[2].homogeneous, atol=1e-16)
    for k in (0, 3, 4):
        np.testing.assert_array_equal(D[k], np.eye(4))
    # a is carried past b and d, which act after it at its place; d past nothing
    past = (factors[1] * factors[3]).toActionMatrixInverse()
    np.testing.assert_allclose(S[6:12, 0], past @ np.eye(6)[0], atol=1e-16)
    np.testing.assert_array_equal(S[6:12, 3], np.eye(6)[5])
    assert not np.any(S[12:18, [0, 1, 3]])


@pytest.fixture(scope="module")
def placements() -> tuple[Robot, ErrorModel]:
    robot = Robot.load(paper_urdf(), base="base", tip="tool0")
    return robot, error_model(robot, "placement+gain", frame=True)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(data=st.data())
def test_any_ties_and_frozen_ones_are_the_free_model_at_mixed_values(placements, data):
    _, free = placements
    unit = dict(zip(free.names, free.units, strict=True))
    followers = data.draw(st.lists(st.sampled_from(free.names), unique=True, max_size=6))
    ties = {}
    for name in followers:
        leaders = [n for n in free.names if unit[n] == unit[name] and n not in followers]
        factor = data.draw(st.floats(-3, 3).filter(lambda f: abs(f) > 0.01))
        ties[name] = (data.draw(st.sampled_from(leaders)), factor)
    rest = [n for n in free.names if n not in ties]
    gone = data.draw(st.lists(st.sampled_from(rest), unique=True, max_size=4))
    model = free.tied(ties).without(gone)
    x = np.random.default_rng(len(gone)).uniform(-0.1, 0.1, len(model))

    value = dict.fromkeys(free.names, 0.0) | dict(zip(model.names, x, strict=True))
    value |= {name: factor * value[leader] for name, (leader, factor) in ties.items()}
    every = np.array([value[name] for name in free.names])
    names = [term.name for term in model.terms]
    np.testing.assert_allclose(model.values(x), [value[n] for n in names], rtol=0, atol=1e-16)
    assert set(free.names) - set(names) == {
        *gone,
        *(name for name, (leader, _) in ties.items() if leader in gone),
    }
    D, S = model.displacements(x)
    D_free, S_free = free.displacements(every)
    np.testing.assert_allclose(D, D_free, rtol=0, atol=1e-15)
    mixing = np.zeros((len(free), len(model)))
    for k, name in enumerate(free.names):
        leader, factor = ties.get(name, (name, 1.0))
        if leader in model.names:
            mixing[k, model.index(leader)] = factor
    np.testing.assert_allclose(S, S_free @ mixing, rtol=0, atol=1e-14)


# Applying


def test_only_origins_that_are_displaced_change(ur3):
    model = error_model(ur3, "dh")
    x = np.zeros(len(model))
    x[model.index("theta3")] = 0.01
    before, after = ur3.origins(), model.apply(ur3, x).origins()
    assert [n for n in before if not np.array_equal(before[n], after[n])] == ["elbow_joint"]
    # a target's error is none of the robot's
    x[:] = 0
    x[model.index("target_x")] = 0.01
    assert model.apply(ur3, x).urdf.data == ur3.urdf.data
