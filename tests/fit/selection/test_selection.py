"""auto: the model that made the data is the one that is chosen, and nothing larger."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calib.camera.optics import OFFSET
from calib.data.cell import Cell, Priors
from calib.errors import ModelError
from calib.fit.estimate.fitting import fit
from calib.fit.estimate.task import Task
from calib.fit.registration.table_rows import rows_and_setup
from calib.fit.selection import selection
from calib.fit.selection.candidates import LADDER
from calib.fit.selection.selection import Selection, select, with_known_points
from tests.fit.selection.models import scene_of
from tests.images import BOARD, arm, cell, poses, table


def chosen(scene: Any, count: int = 80, cell: Cell | None = None) -> Selection:
    cell = Cell() if cell is None else cell
    rows, setup = rows_and_setup(scene.robot, scene.points(count), cell)
    return select(Task(scene.robot, cell, setup, "auto"), rows)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    ("truth", "given", "geometry", "non_geometric"),
    [
        ("dh", {"length": 0.0, "angle": 0.0}, "frames", ""),
        ("zeros", {}, "zeros", ""),
        ("dh", {}, "dh", ""),
        ("dh+compliance", {"other": {"compliance": 1e-4}}, "dh", "dh+compliance"),
        ("zeros+gain", {"other": {"gain": 4e-3}}, "zeros", "zeros+gain"),
        ("dh+gravity", {"other": {"gravity": 4e-3}}, "dh", "dh+gravity"),
    ],
)
def test_the_model_that_made_the_data_is_chosen(
    make_scene, truth, given, geometry, non_geometric, seed
):
    found = chosen(scene_of(make_scene, 100 + seed, truth, **given))
    if non_geometric and found.geometry != geometry:
        # Errors of the joints' state may look like a larger geometry; they are found all the same.
        assert LADDER.index(found.geometry) > LADDER.index(geometry)
        assert found.non_geometric.split("+")[1:] == non_geometric.split("+")[1:]
    else:
        assert (found.geometry, found.non_geometric) == (geometry, non_geometric)
    assert found.chosen.task.model == (found.non_geometric or found.geometry)
    assert {c.name: c.chosen for c in found.candidates if c.chosen} == {
        found.geometry: "geometry",
        **({found.non_geometric: "non_geometric"} if found.non_geometric else {}),
    }


def test_the_search_begins_with_the_largest_model_less_what_its_priors_shrink_to_nothing(
    make_scene,
):
    found = chosen(scene_of(make_scene, 100, "dh+compliance", other={"compliance": 1e-4}), 40)
    assert found.candidates[0].name == "placement+compliance"
    assert (found.geometry, found.non_geometric) == ("dh", "dh+compliance")


def test_tilts_that_no_dh_table_has_need_the_placements(make_scene):
    """Axes 2 to 4 of a UR3 are parallel and stay so in its table; the base is known, so its tilt shows too."""
    assert chosen(scene_of(make_scene, 110, "placement")).geometry == "placement"


def test_a_larger_geometry_that_bending_hid_is_found_with_it(make_scene):
    """Residuals of the joints' compliance hide the tilts of parallel axes."""
    scene = scene_of(
        make_scene, 113, "placement+compliance", angle=1e-3, other={"compliance": 2e-3}
    )
    assert chosen(scene, 50).non_geometric == "placement+compliance"


def test_without_priors_held_out_rows_decide_among_models_that_rows_are_enough_for(make_scene):
    scene = scene_of(make_scene, 3, "dh")
    cell = Cell(priors=Priors("off"))
    few = [c.name for c in chosen(scene, 12, cell).candidates]
    assert {"frames", "zeros", "dh"} < set(few)
    assert "placement" not in few  # 39 parameters for 36 numbers
    enough = chosen(scene, 60, cell)
    assert (enough.geometry, enough.non_geometric) == ("dh", "")


def test_names_that_no_model_has_are_refused(make_scene):
    scene = scene_of(make_scene, 115, "dh")
    with pytest.raises(ModelError, match="No model has the parameters 'a99'"):
        chosen(scene, cell=Cell(frozen=("a99",)))


def test_a_part_of_many_rows_chooses_and_all_are_fitted(make_scene, monkeypatch):
    monkeypatch.setattr(selection, "_CHOSEN_BY", 40)
    found = chosen(scene_of(make_scene, 101, "zeros"), 80)
    assert found.geometry == "zeros"
    assert len(found.chosen.estimate.weights) == 80
    assert {len(c.cross_validation.residual) for c in found.candidates} == {40}


def test_corners_are_where_the_fit_has_them():
    robot = arm()
    points = BOARD.corners + 1e-4 * np.random.default_rng(1).normal(size=(20, 3)) * [1, 1, 0]
    rows, setup = rows_and_setup(robot, table(poses(10), noise=0.05, points=points), cell())
    task = Task(robot, cell(), setup, "frames")
    fitted = fit(task, rows)
    fewer, known = with_known_points(task, fitted, rows)
    assert len(fewer.error_model()) == len(task.error_model()) - 2 * len(BOARD.corners)
    offsets = known.samples.internals[:, OFFSET]
    estimated = dict(zip(fitted.kinematics.model.names, fitted.estimate.x, strict=True))
    np.testing.assert_allclose(offsets[3], [estimated["corner_3_x"], estimated["corner_3_y"], 0.0])
    again = fit(fewer, known)
    before, after = (np.sqrt(np.mean(r**2)) for r in (fitted.residual(rows), again.residual(known)))
    assert abs(after / before - 1.0) < 0.05


def test_without_unknown_corners_nothing_changes():
    robot = arm()
    c = cell(boards={"": replace(BOARD, sigma_corner=0.0)})
    rows, setup = rows_and_setup(robot, table(poses(6), noise=0.05), c)
    task = Task(robot, c, setup, "frames")
    same = with_known_points(task, fit(task, rows), rows)
    assert same[0] is task
    assert same[1] is rows
