"""Commands for one chain of a result of several: the calibrated robot then reaches what was programmed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.errors import MeasurementError, ModelError, UrdfError
from calib.result.calibrate import calibrate
from calib.robot.gravity import Payload
from calib.robot.ranges import random_joint_values
from calib.verbs.compensate.command import _check_hand
from calib.verbs.compensate.compensate import compensate
from calib.verbs.compensate.expected import expected_errors
from calib.verbs.compensate.nominal_actual import chain_of_hand, pair_of
from calib.verbs.compensate.robot_program import Program
from calib.verbs.compensate.text import text
from calib.verbs.simulate.scenario import Scenario, simulate
from tests.parts import with_part
from tests.two_handed import JOINTS, fitted


def test_a_hand_is_named_by_its_link_its_target_or_the_tool():
    c = fitted()
    right = ("panda_link0", "right/panda_link8")
    assert chain_of_hand(c, "right/panda_link8", None) == right
    assert chain_of_hand(c, "b", None) == right
    assert chain_of_hand(c, None, "b") == right
    for hand in (None, "c", "panda_link4"):
        with pytest.raises(
            ModelError, match=r"several hands, .*'panda_link8', 'right/panda.*--tip a or --tip b"
        ):
            chain_of_hand(c, hand, None)


def test_the_calibrated_hand_reaches_the_programmed_target():
    c = fitted()
    pair = pair_of(c, tool="b")
    assert pair.nominal.robot.joint_names == tuple(f"right/{name}" for name in JOINTS)
    q = np.array([[0.3, -0.5, 0.2, -1.8, 0.1, 1.5, 0.4]])
    whole = np.concatenate([np.zeros((1, 7)), q], axis=1)
    T_frame_base = c.setup.T_frame_base[0]
    expected = np.linalg.inv(T_frame_base) @ c.predict_poses(whole, target="b")
    np.testing.assert_allclose(pair.actual.poses(q), expected, atol=1e-9)


def test_a_payload_changes_nothing_of_a_geometry_for_several_chains_and_is_refused():
    load = Payload(2.0, np.zeros(3))
    with pytest.raises(ModelError, match="of several chains, and its non-geometric model"):
        pair_of(fitted(), tool="b", non_geometric=load)
    assert pair_of(fitted(), tool="b", non_geometric=True).target == "b"


def test_a_tool_on_the_other_hand_is_refused():
    c = fitted()
    left = c.nominal.rebuilt(None, "panda_link0", "panda_link8")
    with pytest.raises(ModelError, match="'b' is on 'right/panda_link8', but the chain ends at"):
        pair_of(c, left, tool="b")


def test_the_only_target_of_the_named_hand_is_the_tool_without_its_name():
    c = fitted()
    right = c.nominal.rebuilt(None, *chain_of_hand(c, "b", None))
    assert pair_of(c, right, tool="").target == "b"
    with pytest.raises(ModelError, match="it has 'a', 'b'"):
        pair_of(c, tool="")


def test_a_program_of_the_other_hand_is_refused():
    c = fitted()
    right = c.nominal.rebuilt(None, *chain_of_hand(c, "b", None))
    file = Path("program.csv")
    with pytest.raises(MeasurementError, match=r"'a' .*'right/panda_link8' .*--tip a\?"):
        _check_hand(file, {*JOINTS, "x"}, right, c)
    # Joints of both hands, poses alone, and a joint that is missing of the only hand there is are other matters.
    both = {*JOINTS, *right.joint_names}
    for columns in (both, {"x", "y", "z"}, set(right.joint_names[1:]), None):
        _check_hand(file, columns, right, c)


@pytest.fixture(scope="module")
def simulated():
    """Two hands of TIAGo with one torso, simulated and fitted, and the truth."""
    cell = Cell(
        estimate_frame=True,
        tips={"left": "arm_left_7_link", "right": "arm_right_7_link"},
        model="placement",
    )
    made = simulate(Scenario("tiago_dual", cell), 40, 0, seed=4)
    result = calibrate("tiago_dual", made.measurements, cell=cell)
    return result, made.truth


@pytest.mark.slow
@pytest.mark.parametrize("hand", ["left", "right"])
def test_the_expected_error_of_a_hand_is_what_its_commands_leave(simulated, hand):
    result, truth = simulated
    tip = f"arm_{hand}_7_link"
    arm = result.nominal.rebuilt(None, "base_footprint", tip)
    q = random_joint_values(arm, 60, seed=5)
    program = Program.of_joints(q)
    for frame in (None, ""):
        commands = compensate(result, program, nominal=arm, tool=hand, frame=frame)
        assert commands.expected is not None
        done = commands.reached
        whole = np.zeros((int(done.sum()), len(result.nominal.joint_names)))
        columns = [result.nominal.joint_names.index(name) for name in arm.joint_names]
        whole[:, columns] = commands.q[done]
        t = truth.targets.index(hand)
        arrived = truth.tip_poses(whole, chain=t) @ truth.T_tip_target[t]
        if frame is not None:
            arrived = truth.T_frame_base[0] @ arrived
        wanted = commands.T_wanted[done]
        error = np.linalg.norm((arrived - wanted)[:, :3, 3], axis=1)
        low, high = commands.expected.band
        assert 0.4 * low < error.mean() < 2.5 * high
        if frame is not None:  # in the measured frame no base is unknown
            assert commands.expected.mean < 0.15e-3
            assert set(commands.expected.contributions) >= {"parameters", "poses"}
            assert commands.expected.contributions["base"] == 0.0


def test_expected_errors_count_the_commanded_chain_and_no_other():
    """Another covariance of the right hand's own parameters changes what is expected of it, and not of the left.

    So it is of targets, and of tools that each hand holds where the other one's target is.
    """
    c = fitted()
    q = np.array([[0.3, -0.5, 0.2, -1.8, 0.1, 1.5, 0.4], [0.1, 0.4, -0.3, -1.2, 0.6, 1.1, -0.4]])
    part = c.geometry
    right = np.array([name.startswith("right/") for name in part.model.names])
    less = np.where(right, 0.1, 1.0)
    known = replace(part, covariance=part.covariance * np.outer(less, less))
    changed = replace(c, geometry=known)

    def expected(result, hand, tool):
        nominal = result.nominal.rebuilt(None, *chain_of_hand(result, hand, None))
        return expected_errors(pair_of(result, nominal, tool=tool, frame="t1"), q).mean

    for hand, other, is_right in ((0, 1, False), (1, 0, True)):
        name = c.setup.targets[hand]
        for tool in (name, c.setup.T_tip_target[other]):
            ratio = expected(changed, name, tool) / expected(c, name, tool)
            assert (abs(ratio - 1.0) > 0.1) if is_right else (ratio == pytest.approx(1.0, rel=1e-9))


def test_a_known_frame_on_another_link_does_not_tell_where_the_base_is():
    """Nor does it take from the errors to expect in the base; one on the base does both."""
    c = fitted()
    q = np.array([[0.3, -0.5, 0.2, -1.8, 0.1, 1.5, 0.4]])
    unknown = (c.setup.unknown[0], ())

    def by_base(**changes):
        result = with_part(c, "geometry", setup=replace(c.setup, **changes))
        return expected_errors(pair_of(result, tool="b"), q).contributions["base"]

    assert by_base() > 0.0
    assert by_base(unknown=unknown, frame_links=("panda_link0", "panda_link3")) == by_base()
    assert by_base(unknown=unknown) == 0.0


def test_only_joints_of_the_commanded_hand_are_warned_of():
    c = fitted()
    beyond = np.array([[2.8, -0.5, 0.2, -1.8, 0.1, 1.5, 0.4]])
    pair = pair_of(c, tool="b")
    whole = pair.of_all_joints(beyond)
    np.testing.assert_array_equal(whole[:, 7:], beyond)
    commands = compensate(c, Program.of_joints(beyond), tool="b", accept=True)
    joints = {warning.joint for row in commands.warnings for warning in row}
    assert not {name for name in joints if name in JOINTS}


def test_a_base_is_honoured_if_all_joints_from_it_were_calibrated():
    c = fitted()
    right = chain_of_hand(c, "b", None, "right/panda_link0")
    assert right == ("right/panda_link0", "right/panda_link8")
    nominal = c.nominal.rebuilt(None, *right)
    q = np.array([[0.3, -0.5, 0.2, -1.8, 0.1, 1.5, 0.4]])
    tool = pair_of(c, nominal, tool="b").actual.poses(q)
    # The hand in its own base does not know where that stands.
    whole = np.concatenate([np.zeros((1, 7)), q], axis=1)
    T_frame_base = c.setup.T_frame_base[0]
    T_root_tool = np.linalg.inv(T_frame_base) @ c.predict_poses(whole, target="b")
    T_root_base = c.robot.urdf.joint("right/mount").T_parent_joint
    np.testing.assert_allclose(T_root_base @ tool, T_root_tool, atol=1e-9)
    with pytest.raises(ModelError, match=r"no joint 'panda_finger_joint1'"):
        chain_of_hand(c, "b", None, "panda_leftfinger")
    with pytest.raises(UrdfError, match="'nolink'"):
        chain_of_hand(c, "b", None, "nolink")


def test_from_a_base_without_a_frame_the_first_frame_that_sees_the_hand_is_advised():
    c = fitted()
    q = np.array([[0.3, -0.5, 0.2, -1.8, 0.1, 1.5, 0.4], [0.1, 0.4, -0.3, -1.2, 0.6, 1.1, -0.4]])
    for base, said in (("panda_link0", ""), ("right/panda_link0", " --base panda_link0")):
        nominal = c.nominal.rebuilt(None, *chain_of_hand(c, "b", None, base))
        found = compensate(c, Program.of_joints(q), nominal=nominal, tool="b", accept=True)
        assert found.expected is not None
        squares = dict.fromkeys(found.expected.contributions, 1e-8) | {"base": 1e-6}
        expected = replace(found.expected, contributions=squares, in_measured_frame=1.23e-4)
        words = " ".join(text(replace(found, expected=expected), "result.json", None).split())
        assert f'--poses-in "{c.setup.groups[0]}"{said} (0.123 mm)' in words
