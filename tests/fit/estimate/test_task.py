"""Tasks: the parameters that are estimated, and names that are refused."""

from __future__ import annotations

from dataclasses import replace

import pytest

from calib.data.cell import Cell
from calib.errors import ModelError
from calib.fit.estimate.task import Task
from calib.fit.registration.table_rows import rows_and_setup
from calib.numerics.solvers import SOLVERS, levenberg_marquardt


@pytest.fixture(scope="module")
def task(ur3, paper_table) -> Task:
    _, setup = rows_and_setup(ur3, paper_table, Cell())
    return Task(ur3, Cell(), setup, "dh")


def with_cell(task: Task, **given) -> Task:
    return replace(task, cell=Cell(**given))


def test_the_parameters_are_those_of_the_robot_and_its_target(task):
    names = task.error_model().names
    assert names[-3:] == ("target_x", "target_y", "target_z")
    assert {"d1", "a2", "theta6"} <= {*names}


def test_frozen_and_tied_parameters_are_not_estimated(task):
    given = with_cell(task, frozen=("d1",), ties={"a3": ("a2", 0.5)})
    left = {*task.error_model().names} - {*given.error_model().names}
    assert left == {"d1", "a3"}


@pytest.mark.parametrize(
    "given",
    [
        {"frozen": ("target_y",)},
        {"ties": {"a2": ("target_y", 1.0)}},
        {"ties": {"target_y": ("a2", 1.0)}},
    ],
)
def test_a_target_is_neither_frozen_nor_tied(task, given):
    with pytest.raises(ModelError, match="'target_y'"):
        with_cell(task, **given).error_model()


def test_absent_names_are_refused_unless_several_models_are_tried(task):
    ties = {"a2": ("absent", 1.0), "a3": ("d4", 1.0)}
    given = with_cell(task, frozen=("absent", "d1"), ties=ties)
    with pytest.raises(ModelError, match="absent"):
        given.error_model()
    names = replace(given, allow_absent=True).error_model().names
    # A tie to a parameter that is absent does not hold.
    assert "a2" in names
    assert not {"d1", "a3"} & {*names}


def test_a_solver_has_a_name_or_is_a_function(task):
    for solver in ("lm", "scipy", "paper", lambda *_: None):
        replace(task, solver=solver).check_solver()
    with pytest.raises(ModelError, match="'bfgs'"):
        replace(task, solver="bfgs").check_solver()


def test_of_calibs_own_solvers_the_papers_alone_has_neither_weights_nor_priors(task):
    without = [name for name in SOLVERS if not replace(task, solver=name).has_weights_and_priors]
    assert without == ["paper"]
    assert replace(task, solver=levenberg_marquardt).has_weights_and_priors


def test_a_joint_that_is_frozen_takes_its_parameters_along(task):
    joint = task.robot.joint_names[2]
    left = {*task.error_model().names} - {*with_cell(task, frozen=(joint,)).error_model().names}
    assert left == {"a2", "alpha2", "d3", "theta3"}
    with pytest.raises(ModelError, match="'a2'"):
        with_cell(task, frozen=(joint,), ties={"a2": ("a3", 1.0)}).error_model()
