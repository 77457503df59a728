"""What has moved: names since then, what the cell says of them, and what earlier stops still tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.model.error_model import FRAME, TARGET
from calib.robot.robot import Robot
from calib.verbs.measure.breaks import Break, cell_after, forgotten, relabelled
from calib.verbs.measure.moved import Moved
from calib.verbs.measure.session import Session
from calib.verbs.plan.forecast import information
from calib.verbs.plan.sensitivity import Sensitivity
from calib.verbs.simulate.virtual_session import known_cell
from tests.verbs.measure.sessions import (
    LENGTH,
    fit_of,
    good_readings,
    points_cell,
    started,
    virtual_cell,
)

T_TARGET = np.block([[np.eye(3), np.array([[0.01], [0.02], [0.1]])], [np.zeros((1, 3)), 1.0]])
T_FRAME = np.block([[np.eye(3), np.array([[1.0], [-2.0], [0.5]])], [np.zeros((1, 3)), 1.0]])


def of_target(stop: int, name: str = "target") -> Break:
    return Break(stop, name, None, T_TARGET, None)


def of_base(stop: int, name: str = "") -> Break:
    return Break(stop, None, name, None, T_FRAME)


def of_both(stop: int, target: str = "target", station: str = "") -> Break:
    return Break(stop, target, station, T_TARGET, T_FRAME)


@pytest.fixture(scope="module")
def table(ur3) -> Measurements:
    places = {"a": [0.0, 0.0, 0.1], "b": [0.05, 0.0, 0.08]}
    virtual = virtual_cell(ur3, points_cell(targets=places, estimate_target=True))
    return good_readings(virtual, 1)[0]


@pytest.fixture(scope="module")
def one(ur3) -> Measurements:
    return good_readings(virtual_cell(ur3, points_cell()), 1)[0]


def names_of(table: Measurements, number: int, *breaks: Break) -> tuple[tuple[str, ...], ...]:
    changed = relabelled(table, number, breaks)
    assert (changed.points == table.points).all()
    assert (changed.joints == table.joints).all()
    return changed.targets, changed.groups


def test_before_a_break_names_are_as_they_were(one: Measurements):
    assert relabelled(one, 4, [of_target(5), of_base(7)]) is one
    assert relabelled(one, 4, []) is one


def test_since_a_break_the_target_has_its_number(one: Measurements):
    assert names_of(one, 5, of_target(5)) == (("target (2)",), ("",))
    assert names_of(one, 50, of_target(5)) == (("target (2)",), ("",))


def test_a_station_without_a_name_gets_one(one: Measurements):
    assert names_of(one, 5, of_base(5)) == (("target",), ("station (2)",))
    named = replace(one, groups=("north",))
    assert names_of(named, 5, of_base(5, "north")) == (("target",), ("north (2)",))
    assert names_of(named, 5, of_base(5, "south")) == (("target",), ("north",))


def test_as_long_as_it_is_not_known_both_are_new(one: Measurements):
    assert names_of(one, 5, of_both(5)) == (("target (2)",), ("station (2)",))


def test_several_breaks_count_on(one: Measurements):
    """The target moved, then the base, then the target again, whose name then is that of the second break."""
    breaks = (of_target(5), of_base(8), of_target(11))
    assert names_of(one, 4, *breaks) == (("target",), ("",))
    assert names_of(one, 5, *breaks) == (("target (2)",), ("",))
    assert names_of(one, 8, *breaks) == (("target (2)",), ("station (3)",))
    assert names_of(one, 11, *breaks) == (("target (4)",), ("station (3)",))
    twice = (of_base(5), of_base(9))
    assert names_of(one, 9, *twice) == (("target",), ("station (3)",))


def test_of_two_targets_one_has_moved(table: Measurements):
    assert names_of(table, 9, of_target(5, "b")) == (("a", "b (2)"), ("", ""))
    breaks = (of_target(5, "b"), of_target(7, "a"), of_target(9, "b"))
    assert names_of(table, 9, *breaks) == (("a (3)", "b (4)"), ("", ""))


def test_a_name_with_a_bracket_of_its_own_is_kept(table: Measurements):
    own = replace(table, targets=("nest (left)", "nest (right)"))
    changed = relabelled(own, 9, [of_target(5, "nest (right)")])
    assert changed.targets == ("nest (left)", "nest (right) (2)")


def test_a_break_says_what_it_is_of():
    assert of_target(5).code == "target_moved"
    assert of_base(5).code == "base_moved"
    assert of_both(5).code == "something_moved"
    assert of_target(5).is_decided
    assert not of_both(5).is_decided
    assert of_both(5).same_as(of_both(5))
    assert not of_both(5).same_as(of_both(6))
    assert not of_both(5).same_as(of_target(5))


def test_it_is_made_of_what_was_found(ur3):
    virtual = virtual_cell(ur3, points_cell())
    fit = fit_of(virtual, good_readings(virtual, 12))
    setup = fit.fitted.estimated_setup()
    numbers = [1, 2, 3, 5, 6, 7, 8, 9, 11, 12, 13, 14]
    target = Moved("target", "target", 8, 100.0, 5.0)
    base = Moved("base", "", 8, 100.0, 5.0)
    both = Break.of((target, base), numbers, setup)
    assert (both.stop, both.target, both.station) == (11, "target", "")
    assert both.T_tip_target == pytest.approx(setup.T_tip_target[0])
    assert both.T_frame_base == pytest.approx(setup.T_frame_base[0])
    again = replace(setup, targets=("target (3)",), groups=("station (2)",))
    moved = tuple(replace(m, name=n) for m, n in ((target, "target (3)"), (base, "station (2)")))
    later = Break.of(moved, numbers, again, (of_base(3), of_target(4)))
    assert (later.target, later.station) == ("target", "")
    alone = Break.of((base,), numbers, setup)
    assert (alone.stop, alone.target, alone.station) == (11, None, "")
    assert alone.T_tip_target is None


# The cell


def test_the_cell_says_of_new_names_what_it_said_of_the_old():
    cell = Cell(model="zeros", targets={"a": [0.0, 0.0, 0.1]}, tips={"a": "tool0"})
    broken = Break(5, "a", None, T_TARGET, None)
    after = cell_after(cell, [broken], {"a", "a (2)", ""}, rotation=False)
    assert set(after.targets) == {"a", "a (2)"}
    assert after.targets["a (2)"] == pytest.approx(T_TARGET[:3, 3])
    assert after.tips["a (2)"] == "tool0"
    assert after.estimate_target
    assert not after.estimate_frame
    priors = after.parameter_priors
    assert priors == {f"target_{d}[a (2)]": pytest.approx(0.02) for d in "xyz"}


def test_they_stand_about_where_they_stood_within_what_a_knock_moves():
    cell = Cell(model="zeros", estimate_frame=True)
    after = cell_after(
        cell, [of_both(5)], {"target", "target (2)", "", "station (2)"}, rotation=True
    )
    values = sorted(after.parameter_priors.values())
    # Six directions each, of target and station.
    assert values == pytest.approx([0.02] * 6 + [np.deg2rad(2.0)] * 6)
    assert after.frames["station (2)"] == pytest.approx(T_FRAME)
    assert after.targets["target (2)"] == pytest.approx(T_TARGET[:3, 3])


def test_what_is_not_measured_since_is_not_in_the_cell():
    cell = Cell(model="zeros", estimate_frame=True)
    after = cell_after(cell, [of_both(5)], {"target", ""}, rotation=False)
    assert after.parameter_priors == {}
    assert after.frames == {}
    assert after.targets == {}


def test_cameras_and_boards_are_those_of_the_old_name():
    arm = Robot.load("ur5", base="tool0", tip="base_link")
    virtual = virtual_cell(arm, Cell(kind="pixel", model="zeros", sigma={"px": 0.3}), 7)
    cell = known_cell(virtual, 1)
    # Those without a name are of all stations and targets.
    names = {"", "target", "station (2)", "target (2)"}
    after = cell_after(cell, [of_both(5)], names, rotation=True)
    assert set(after.cameras) == set(after.boards) == {""}
    named = replace(cell, cameras={"left": cell.cameras[""]}, boards={"plate": cell.boards[""]})
    names = {"left", "plate", "left (2)", "plate (2)"}
    after = cell_after(named, [of_both(5, "plate", "left")], names, rotation=True)
    assert after.cameras["left (2)"] is cell.cameras[""]
    assert after.boards["plate (2)"] is cell.boards[""]


# What earlier stops still tell


@pytest.fixture(scope="module")
def sensitivity(ur3, tmp_path_factory) -> Sensitivity:
    folder = tmp_path_factory.mktemp("breaks") / "s"
    session: Session = started(virtual_cell(ur3, points_cell("placement")), folder)
    with session:
        return session._course.design.sensitivity


@pytest.mark.parametrize("what", ["target", "base", "both"])
def test_of_what_has_moved_nothing_is_known_and_of_the_rest_what_remains(ur3, sensitivity, what):
    """By brute force: the covariance of the rest, with what has moved estimated and forgotten."""
    q = virtual_cell(ur3, points_cell("placement")).poses(40, 4)
    M = information(sensitivity.measured(q))
    broken = {"target": of_target(5), "base": of_base(5), "both": of_both(5)}[what]
    result = forgotten(M, sensitivity, broken)
    parameters = sensitivity.kinematics.model.parameters
    gone = np.zeros(len(parameters), dtype=bool)
    for k, parameter in enumerate(parameters):
        if parameter.place.startswith(TARGET):
            gone[k] = what != "base"
        elif parameter.place.startswith(FRAME):
            gone[k] = what != "target"
    assert gone.sum() == {"target": 3, "base": 6, "both": 9}[what]
    assert not result[gone].any()
    assert not result[:, gone].any()
    assert result == pytest.approx(result.T, rel=1e-12)
    # The covariance of all, with its priors, has the same block as that of the rest alone.
    P = np.diag(sensitivity.precision)
    whole = np.linalg.inv(M + P)[np.ix_(~gone, ~gone)]
    rest = np.linalg.inv((result + P)[np.ix_(~gone, ~gone)])
    assert rest == pytest.approx(whole, rel=1e-6, abs=1e-9 * np.abs(whole).max())


def test_what_is_not_in_the_model_has_moved_without_a_loss(ur3, tmp_path):
    """A frame that is given, and not estimated."""
    cell = Cell(model="zeros", sigma={"m": LENGTH}, T_frame_base=np.eye(4))
    with started(virtual_cell(ur3, cell), tmp_path / "s") as session:
        sensitivity = session._course.design.sensitivity
    M = np.diag(np.arange(1.0, 1.0 + len(sensitivity.names)))
    assert forgotten(M, sensitivity, of_base(5)) is M
