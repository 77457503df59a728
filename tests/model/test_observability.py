from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from calib.example import PAPER_TARGET
from calib.model.error_model import FRAME, TARGET, TIP, ErrorModel, Parameter
from calib.model.families import ANGLE, LENGTH
from calib.model.kinematics import Kinematics, Samples
from calib.model.observability import Observability, analyse, rank_by_gap
from calib.model.parameter_sets import error_model
from calib.robot.gravity import Payload, gravity_loads
from calib.robot.robot import Robot
from calib.show.words import combination_text

ON_AXIS_6 = (0.0, 0.0, 0.05)

PAPER_COMBINATIONS = (
    "d2 and d4 together (+1 mm, -1 mm)",
    "d3 and d4 together (+1 mm, -1 mm)",
    "a6 and target_x together (+1 mm, -1 mm)",
    "alpha6, target_y and target_z together (+1 mrad, +0.0225 mm, -0.0702 mm)",
    "d6 and target_z together (+1 mm, -1 mm)",
    "theta6, target_x and target_y together (+1 mrad, +0.0702 mm, +0.07 mm)",
)


def at_target(robot: Robot, model: ErrorModel, target=PAPER_TARGET) -> Kinematics:
    T_tip_target = np.eye(4)
    T_tip_target[:3, 3] = target
    return Kinematics(robot, model, np.eye(4), T_tip_target)


def jacobian_of(
    robot: Robot, model: ErrorModel, q: np.ndarray, target=PAPER_TARGET, pose: bool = False
) -> np.ndarray:
    _, twists = at_target(robot, model, target).twists(np.zeros(len(model)), q)
    return (twists if pose else twists[:, :3]).reshape(-1, len(model))


def analysed(jacobian: np.ndarray, model: ErrorModel) -> Observability:
    return analyse(jacobian, model.names, [p.unit for p in model.parameters])


def vector(model: ErrorModel, combination) -> np.ndarray:
    x = np.zeros(len(model))
    for name, step in zip(combination.names, combination.steps, strict=True):
        x[model.index(name)] = step
    return x


def random_q(n: int = 6, count: int = 100) -> np.ndarray:
    return np.random.default_rng(0).uniform(-np.pi, np.pi, (count, n))


def all_placements(robot: Robot) -> ErrorModel:
    """Six directions of each joint's placement and of the tip: 42 columns for six joints."""
    tip = tuple(
        Parameter(
            f"tip.{k}", "m" if k < 3 else "rad", TIP, np.eye(6)[k], LENGTH if k < 3 else ANGLE
        )
        for k in range(6)
    )
    placements = error_model(robot, "placement", target=False).parameters
    return ErrorModel("all", (FRAME, *robot.joint_names, TIP, TARGET), placements + tip)


def tilted(robot: Robot, angle: float) -> Robot:
    model = error_model(robot, "placement", target=False)
    x = np.random.default_rng(1).normal(0, angle, len(model))
    return model.apply(robot, x)


# Golden ranks


@pytest.mark.parametrize(
    ("target", "pose", "rank"),
    [(PAPER_TARGET, False, 27), (ON_AXIS_6, False, 25), (PAPER_TARGET, True, 30)],
)
def test_the_ranks_of_42_placement_columns(ur3, target, pose, rank):
    model = all_placements(ur3)
    result = analysed(jacobian_of(ur3, model, random_q(), target, pose), model)
    assert (result.columns, result.rank) == (42, rank)
    assert len(result.unidentifiable) == 42 - rank


@pytest.mark.parametrize(
    ("name", "frame", "columns", "rank"),
    [
        ("paper", False, 27, 21),
        ("dh", True, 33, 25),
        ("hayati", False, 27, 23),
        ("hayati", True, 33, 27),
        ("placement", False, 39, 27),
        ("placement", True, 45, 27),
        ("zeros", False, 9, 8),
        ("zeros", True, 15, 13),
        ("frames", True, 9, 9),
    ],
)
def test_the_ranks_of_the_sets(ur3, name, frame, columns, rank):
    # docs/parameters.md states these.
    model = error_model(ur3, name, frame=frame)
    result = analysed(jacobian_of(ur3, model, random_q()), model)
    assert (result.columns, result.rank) == (columns, rank)


#: Chains by robot, base and tip, and what is held.
CHAINS = {
    "arm": (("ur3", "base", "tool0"), {}),
    "turned round, moved by its joint directly": (("ur3", "wrist_3_link", "base"), {}),
    "continuous joints": (("kinova", None, "j2s6s200_end_effector"), {}),
    "tiago head to arm": (("tiago_no_hand", "xtion_rgb_optical_frame", "wrist_ft_tool_link"), {}),
    "two of them held": (
        ("tiago_no_hand", "xtion_rgb_optical_frame", "wrist_ft_tool_link"),
        {"head_2_joint": -0.3, "arm_4_joint": 0.7},
    ),
}


@pytest.mark.parametrize("name", ["placement", "hayati"])
@pytest.mark.parametrize("which", CHAINS)
def test_the_ranks_of_any_chain(which, name):
    # Four for each joint that turns, two for each that slides, six for the place of base or target; of points three
    # less. A joint that is held is no joint.
    ends, held = CHAINS[which]
    robot = Robot.load(*ends, held=held)
    turning = sum(joint.type != "prismatic" for joint in robot.inputs)
    sliding = len(robot.inputs) - turning
    everything = 4 * turning + 2 * sliding + 6
    q = np.random.default_rng(0).uniform(-1.5, 1.5, (60, len(robot.joint_names)))
    target = (0.05, 0.07, 0.03)
    for families, more in (("", 0), ("+gain+eccentricity", len(robot.inputs) + 2 * turning)):
        for pose in (True, False):
            model = error_model(robot, name + families, frame=True, rotation=pose)
            result = analysed(jacobian_of(robot, model, q, target, pose), model)
            assert result.rank == everything - (0 if pose else 3) + more


# Errors of the joints' state


def loaded(robot: Robot, model: ErrorModel, q: np.ndarray, payload: Payload | None) -> np.ndarray:
    samples = Samples.at(q, gravity_loads(robot, q, payload))
    _, twists = at_target(robot, model).twists(np.zeros(len(model)), samples)
    return twists[:, :3].reshape(-1, len(model))


#: A payload off every axis of the wrist.
TOOL = Payload(5.0, np.array([0.05, 0.03, 0.1]))


@pytest.mark.parametrize(
    ("families", "payload", "more"),
    [
        ("+gain", None, 6),
        ("+eccentricity", None, 12),
        ("+compliance", None, 3),
        ("+compliance", TOOL, 5),
        ("+gravity", None, 10),
        ("+gain+eccentricity+compliance", TOOL, 23),
    ],
)
@pytest.mark.parametrize("name", ["dh", "hayati", "placement", "zeros"])
def test_the_ranks_with_errors_of_the_joints_state(ur3, name, families, payload, more):
    # docs/parameters.md states these.
    for frame in (False, True):
        model, alone = (error_model(ur3, n, frame=frame) for n in (name + families, name))
        rank = analysed(jacobian_of(ur3, alone, random_q()), alone).rank
        assert analysed(loaded(ur3, model, random_q(), payload), model).rank == rank + more


# The paper's table


def test_the_paper_s_27_columns_on_its_30_rows(ur3, paper_table):
    model = error_model(ur3, "paper")
    q = paper_table.joints[paper_table.estimation]
    assert len(q) == 30
    result = analysed(jacobian_of(ur3, model, q), model)
    assert result.rank == 21
    assert tuple(combination_text(c) for c in result.unidentifiable) == PAPER_COMBINATIONS
    taking_part = {name for c in result.unidentifiable for name in c.names}
    for name, alone in zip(model.names, result.identifiable, strict=True):
        assert alone == (name not in taking_part), name
    assert result.identifiable.sum() == 27 - 10
    np.testing.assert_allclose(
        result.condition, result.singular_values[0] / result.singular_values[20]
    )


# Indices and invariances


def known(values: tuple[float, ...], rows: int = 12) -> np.ndarray:
    """A Jacobian whose scaled singular values are these."""
    rng = np.random.default_rng(7)
    p = len(values)
    U = np.linalg.qr(rng.normal(size=(rows, p)))[0]
    V = np.linalg.qr(rng.normal(size=(p, p)))[0]
    return U @ np.diag(values) @ V.T / 1e-3


def test_the_five_indices():
    result = analyse(known((4.0, 2.0, 1.0)), "abc", ["m", "rad", "m"])
    np.testing.assert_allclose(result.singular_values, (4, 2, 1), rtol=1e-13)
    assert result.indices == pytest.approx(
        {
            "O1": 8 ** (1 / 3) / 12**0.5,
            "O2": 1 / 4,
            "O3": 1,
            "O4": 1 / 4,
            "O5": 1 / (1 / 4 + 1 / 2 + 1),
        }
    )
    assert result.condition == pytest.approx(4)
    assert (result.rank, result.unidentifiable) == (3, ())
    assert result.identifiable.all()


# The rank of a spectrum


@pytest.mark.parametrize(
    ("values", "rank"),
    [
        ([], 0),
        ([0, 0, 0], 0),
        ([3], 1),
        ([1, 0.5, 0.1], 3),
        (np.logspace(0, -10, 31), 31),  # decays without a gap: all of it
        ([1, 0.5, 1e-15], 2),  # rounding
        ([1, 0.1, 1e-5, 1e-16], 2),  # two gaps: the first
        ([1, 0.1, 1e-5, 9e-6, 1e-16, 1e-17], 2),
        ([1, 0.02, 2e-4], 2),  # a hundredfold gap, below what is negligible
        ([1, 0.01, 5e-3], 3),  # as wide, but above
        ([1, 2e-3, 2e-4, 2e-5], 4),  # tenfold steps are no gap
        ([1, 0, 0], 1),
        ([1e-9, 5e-10, 1e-24], 2),  # relative to the largest
    ],
)
def test_rank_by_gap(values, rank):
    assert rank_by_gap(np.asarray(values, dtype=float)) == rank


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.integers(0, 2**32 - 1), st.integers(1, 10), st.integers(1, 10))
def test_combinations_span_what_any_jacobian_cannot_see(seed, p, rank):
    rng = np.random.default_rng(seed)
    rank = min(rank, p)
    jacobian = rng.normal(size=(30, rank)) @ rng.normal(size=(rank, p))
    names = [f"p{k}" for k in range(p)]
    result = analyse(jacobian, names, ["m"] * p)
    if result.rank != rank:  # drawn close to a lower rank
        assert result.condition < 1e13
        return
    assert len(result.unidentifiable) == p - rank
    for combination in result.unidentifiable:
        v = np.zeros(p)
        for name, step in zip(combination.names, combination.steps, strict=True):
            v[names.index(name)] = step
        effects = np.linalg.norm(jacobian * v, axis=0)
        assert np.linalg.norm(jacobian @ v) <= 0.02 * p * effects.max() + 1e-12
        assert 1e-3 in np.abs(v)  # the leading one changes by its step
