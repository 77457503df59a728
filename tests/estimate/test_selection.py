"""auto: the model that made the data is the one that is chosen, and nothing larger."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calib.data.cell import Cell, Priors
from calib.diagnosis.reasons import Why
from calib.errors import ModelError
from calib.estimate.fitting import Task
from calib.estimate.selection import LADDER, Selection, select
from calib.estimate.setup import rows_of
from calib.result.calibrate import _validated, calibrate


def scene_of(make_scene: Callable[..., Any], seed: int, model: str, **given: Any) -> Any:
    usual = {"frames": [np.eye(4)], "length": 3e-4, "angle": 3e-3, "noise": 3e-5}
    return make_scene(seed, model=model, **(usual | given))


def chosen(scene: Any, count: int = 80, cell: Cell | None = None) -> Selection:
    cell = Cell() if cell is None else cell
    rows, setup = rows_of(scene.robot, scene.points(count), cell)
    return select(Task(scene.robot, cell, setup, "auto"), rows)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    ("truth", "given", "geometry", "larger"),
    [
        ("dh", {"length": 0.0, "angle": 0.0}, "frames", ""),
        ("zeros", {}, "zeros", ""),
        ("dh", {}, "dh", ""),
        ("dh+compliance", {"other": {"compliance": 1e-4}}, "dh", "dh+compliance"),
        ("zeros+gain", {"other": {"gain": 4e-3}}, "zeros", "zeros+gain"),
        ("dh+gravity", {"other": {"gravity": 4e-3}}, "dh", "dh+gravity"),
    ],
)
def test_the_model_that_made_the_data_is_chosen(make_scene, truth, given, geometry, larger, seed):
    found = chosen(scene_of(make_scene, 100 + seed, truth, **given))
    if larger and found.geometry != geometry:
        # Errors of the joints' state may look like a larger geometry; they are found all the same.
        assert LADDER.index(found.geometry) > LADDER.index(geometry)
        assert found.larger.split("+")[1:] == larger.split("+")[1:]
    else:
        assert (found.geometry, found.larger) == (geometry, larger)


def test_tilts_that_no_dh_table_has_need_the_placements(make_scene):
    """Axes 2 to 4 of a UR3 are parallel and stay so in its table; the base is known, so its tilt shows too."""
    assert chosen(scene_of(make_scene, 110, "placement")).geometry == "placement"


def test_a_larger_geometry_that_bending_hid_is_found_with_it(make_scene):
    """What the joints' compliance leaves over covers the tilts of parallel axes."""
    scene = scene_of(
        make_scene, 113, "placement+compliance", angle=1e-3, other={"compliance": 2e-3}
    )
    assert chosen(scene, 50).larger == "placement+compliance"


def test_without_priors_left_out_rows_decide_among_what_rows_are_enough_for(make_scene):
    scene = scene_of(make_scene, 3, "dh")
    cell = Cell(priors=Priors("off"))
    few = [c.name for c in chosen(scene, 12, cell).candidates]
    assert {"frames", "zeros", "dh"} < set(few)
    assert "placement" not in few  # 39 parameters for 36 numbers
    enough = chosen(scene, 60, cell)
    assert (enough.geometry, enough.larger) == ("dh", "")


def test_names_that_no_model_has_are_refused(make_scene):
    scene = scene_of(make_scene, 115, "dh")
    cell = Cell(frozen=("a99",), ties={"a2": ("nothing", 1.0)}, parameter_priors={"x": 1.0})
    with pytest.raises(ModelError, match="No model has the parameters 'a99', 'nothing', 'x'"):
        chosen(scene, cell=cell)


def test_a_larger_model_that_predicts_worse_when_refitted_is_dropped(calibrated):
    """The ladder's cross-validation is a linear one; the refitted one has the last word."""
    scene, c = calibrated("points")
    # Priors that insist on errors of the encoders let them follow the noise.
    cell = Cell(priors=Priors("given", eccentricity=1e-2), model="dh+eccentricity")
    asked = calibrate(scene.robot, c.measurements, cell=cell, validate=False)
    assert asked.larger is not None
    marked = tuple(
        replace(one, chosen="larger") if one.name == "dh+eccentricity" else one
        for one in c.candidates
    )
    every, _ = rows_of(scene.robot, c.measurements, cell)
    rows = every.select(c.measurements.estimation)
    dropped = _validated(replace(asked, candidates=marked), rows, "", None)
    assert dropped.larger is None
    assert [(one.name, one.chosen) for one in dropped.candidates if one.chosen] == [
        ("dh", "geometry")
    ]
    # A model that was asked for by name stays.
    named = _validated(asked, rows, "", None)
    assert named.larger is not None
    one, other = named.larger.cross_validation, named.cross_validation
    assert one.errors_without_outliers.rms > other.errors_without_outliers.rms
    assert Why.LARGER_NO_CLOSER in {reason.why for reason in named.verdict.reasons}
