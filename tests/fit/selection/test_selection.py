"""auto: the model that made the data is the one that is chosen, and nothing larger."""

from __future__ import annotations

from typing import Any

import pytest

from calib.data.cell import Cell, Priors
from calib.errors import ModelError
from calib.fit.estimate.task import Task
from calib.fit.registration.table_rows import rows_and_setup
from calib.fit.selection import selection
from calib.fit.selection.ladder import LADDER
from calib.fit.selection.selection import Selection, select
from tests.fit.selection.models import scene_of


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
