"""The ladder of geometries and families for one robot, and names that none of its models has."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.errors import ModelError
from calib.fit.selection.ladder import (
    LADDER,
    check_parameter_names,
    determinable_families,
    geometry_parameters,
    model_name,
)
from calib.model.families import joint_families
from tests.fit.selection.models import scene_of, task_of


@pytest.fixture(scope="module")
def task_and_rows(make_scene):
    scene = scene_of(make_scene, 115, "dh")
    return task_of(scene, scene.points(20), Cell())


def test_a_model_is_named_by_its_geometry_and_families():
    assert model_name("dh", ()) == "dh"
    assert model_name("dh", ("gain", "gravity")) == "dh+gain+gravity"


def test_geometries_grow_along_the_ladder(task_and_rows):
    task, _ = task_and_rows
    counts = geometry_parameters(task)
    assert tuple(counts) == LADDER
    assert sorted(counts.values()) == list(counts.values())
    assert counts["frames"] == 3  # the target
    assert counts["placement"] == 39


def test_a_geometry_without_parameters_is_not_listed(task_and_rows):
    task, _ = task_and_rows
    known = task.setup.with_fixed(np.ones(1, dtype=bool), np.ones(1, dtype=bool))
    assert "frames" not in geometry_parameters(replace(task, setup=known))


def test_families_that_move_no_joint_are_not_listed(task_and_rows):
    task, rows = task_and_rows
    assert determinable_families(task, rows) == joint_families()
    no_load = np.zeros_like(rows.samples.load)
    unloaded = replace(rows, samples=replace(rows.samples, load=no_load))
    assert "compliance" not in determinable_families(task, unloaded)
    assert "gain" in determinable_families(task, unloaded)


def test_names_that_no_model_has_are_refused(task_and_rows):
    task, _ = task_and_rows
    cell = Cell(frozen=("a99",), ties={"a2": ("nothing", 1.0)}, parameter_priors={"x": 1.0})
    with pytest.raises(ModelError, match="No model has the parameters 'a99', 'nothing', 'x'"):
        check_parameter_names(replace(task, cell=cell))
    check_parameter_names(replace(task, cell=Cell(frozen=("a2",), bounds={"d1": (-1.0, 1.0)})))
