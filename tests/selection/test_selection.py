"""auto: the model that made the data is the one that is chosen, and nothing larger."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calib.data.cell import Cell, Priors
from calib.errors import ModelError
from calib.estimate.fitting import Fitted, Task, fit
from calib.model.families import FAMILIES, joint_families
from calib.numerics.errors import CrossValidation, Errors
from calib.registration.table_rows import rows_and_setup
from calib.selection.selection import (
    LADDER,
    Candidate,
    Selection,
    _Search,
    alternatives,
    explains_more,
    judged_by,
    marked,
    preferred,
    select,
)


def scene_of(make_scene: Callable[..., Any], seed: int, model: str, **given: Any) -> Any:
    usual = {"frames": [np.eye(4)], "length": 3e-4, "angle": 3e-3, "noise": 3e-5}
    return make_scene(seed, model=model, **(usual | given))


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


def test_tilts_that_no_dh_table_has_need_the_placements(make_scene):
    """Axes 2 to 4 of a UR3 are parallel and stay so in its table; the base is known, so its tilt shows too."""
    assert chosen(scene_of(make_scene, 110, "placement")).geometry == "placement"


def test_a_larger_geometry_that_bending_hid_is_found_with_it(make_scene):
    """What the joints' compliance leaves over covers the tilts of parallel axes."""
    scene = scene_of(
        make_scene, 113, "placement+compliance", angle=1e-3, other={"compliance": 2e-3}
    )
    assert chosen(scene, 50).non_geometric == "placement+compliance"


def test_without_priors_left_out_rows_decide_among_what_rows_are_enough_for(make_scene):
    scene = scene_of(make_scene, 3, "dh")
    cell = Cell(priors=Priors("off"))
    few = [c.name for c in chosen(scene, 12, cell).candidates]
    assert {"frames", "zeros", "dh"} < set(few)
    assert "placement" not in few  # 39 parameters for 36 numbers
    enough = chosen(scene, 60, cell)
    assert (enough.geometry, enough.non_geometric) == ("dh", "")


def test_names_that_no_model_has_are_refused(make_scene):
    scene = scene_of(make_scene, 115, "dh")
    cell = Cell(frozen=("a99",), ties={"a2": ("nothing", 1.0)}, parameter_priors={"x": 1.0})
    with pytest.raises(ModelError, match="No model has the parameters 'a99', 'nothing', 'x'"):
        chosen(scene, cell=cell)


def a_candidate(
    name: str, evidence: float, held_out: float = 1e-4, prior_std: Mapping[str, float] | None = None
) -> Candidate:
    """A candidate with one error at each of three held-out rows [m]; families have their usual sizes."""
    residual = np.full((3, 3), held_out / np.sqrt(3.0))
    errors = Errors.of(residual)
    validation = CrossValidation("leave-one-out", 3, np.arange(3), residual, errors, errors)
    usual = {family: FAMILIES[family].prior for family in name.split("+")[1:]}
    return Candidate(name, 10, evidence, validation, usual | dict(prior_std or {}), evidence)


def searched(calibrated: Callable[..., Any], *candidates: Candidate) -> _Search:
    """A search with all models fitted already: these, and all others with next to no evidence."""
    fitted = calibrated("points")[1].fit.geometry
    families = joint_families()
    subsets = (s for n in range(len(families) + 1) for s in itertools.combinations(families, n))
    names = ["+".join((base, *subset)) for subset in subsets for base in LADDER]
    tried = {name: a_candidate(name, -1e3) for name in names} | {c.name: c for c in candidates}
    rows = fitted.estimate.problem.rows
    return _Search(fitted.task, rows, fitted, LADDER, families, tried)


def test_the_search_climbs_by_families_and_sets(calibrated):
    search = searched(
        calibrated,
        a_candidate("dh", 0.0),
        a_candidate("dh+gain", 2.0),
        a_candidate("dh+gain+gravity", 4.0),
        a_candidate("placement+gain+gravity", 5.0),
    )
    assert search.highest("dh") == "placement+gain+gravity"
    assert search.highest("placement+gain+eccentricity+gravity") == "placement+gain+gravity"


def test_one_family_takes_the_place_of_another(calibrated):
    """Neither without the one nor with both is there more evidence: only the exchange helps."""
    here, beyond = a_candidate("dh+eccentricity", 3.0), a_candidate("dh+gravity", 5.0)
    both = a_candidate("dh+eccentricity+gravity", 2.8)
    assert searched(calibrated, here, beyond, both).highest("dh+eccentricity") == "dh+gravity"
    # Gravity that vanishes beside eccentricity cannot replace it, and is not fitted in its place.
    nothing = a_candidate("dh+eccentricity+gravity", 0.5, prior_std={"gravity": 1e-7})
    search = searched(calibrated, here, nothing)
    del search.tried["dh+gravity"]
    assert search.highest("dh+eccentricity") == "dh+eccentricity"
    assert "dh+gravity" not in search.tried


def test_the_search_goes_on_from_a_geometry_that_exceeds_what_it_found(calibrated):
    search = searched(
        calibrated,
        a_candidate("frames+gain", 1.0),
        a_candidate("zeros", 2.0),
        a_candidate("zeros+compliance", 3.0),
    )
    assert search.highest("frames+gain") == "zeros+compliance"


def test_a_non_geometric_model_predicts_better_than_the_geometry(calibrated):
    """Of those that do, the one with the highest evidence."""
    search = searched(
        calibrated,
        a_candidate("dh", 0.0, 1e-4),
        a_candidate("dh+gain", 3.0, 1.1e-4),
        a_candidate("dh+gravity", 2.0, 0.9e-4),
        a_candidate("dh+compliance", 1.0, 0.8e-4),
    )
    assert search.non_geometric("dh+gain", "dh") == "dh+gravity"
    # With less evidence than the geometry none is chosen.
    search = searched(calibrated, a_candidate("dh", 2.5, 1e-4), a_candidate("dh+gain", 2.0, 0.9e-4))
    assert search.non_geometric("dh+gain", "dh") == "dh"


def with_outliers(fitted: Fitted, *rows: int) -> Fitted:
    """A fit that calls these rows outliers."""
    scores = np.zeros(len(fitted.estimate.scores))
    scores[list(rows)] = 10.0 * fitted.estimate.flag_limit
    return replace(fitted, estimate=replace(fitted.estimate, scores=scores))


def test_a_judge_that_explains_more_rows_keeps_its_weights(make_scene):
    scene = scene_of(make_scene, 115, "dh")
    rows, setup = rows_and_setup(scene.robot, scene.points(40), Cell())
    large, small = (fit(Task(scene.robot, Cell(), setup, m), rows) for m in ("dh", "zeros"))
    assert explains_more(with_outliers(large), with_outliers(small, 3, 5))
    assert explains_more(with_outliers(large, 3), with_outliers(small, 3, 5))
    # Each has an outlier of its own, or they agree, or the judge predicts worse.
    assert not explains_more(with_outliers(large, 7), with_outliers(small, 3, 5))
    assert not explains_more(with_outliers(large, 3, 5), with_outliers(small, 3, 5))
    assert not explains_more(with_outliers(small), with_outliers(large, 3, 5))


@pytest.fixture(scope="module")
def robust_and_plain(make_scene):
    """Fits to 30 points, two of them off by millimetres: with these set aside, and with all rows in full."""
    scene = scene_of(make_scene, 91, "dh")
    table = scene.points(30)
    points = table.points.copy()
    points[[4, 17]] += [[2e-3, 0.0, 1e-3], [0.0, -3e-3, 0.0]]
    rows, setup = rows_and_setup(scene.robot, replace(table, points=points), Cell())
    task = Task(scene.robot, Cell(), setup, "dh")
    robust, plain = fit(task, rows), fit(replace(task, robust=False), rows)
    assert np.flatnonzero(robust.estimate.outliers).tolist() == [4, 17]
    return rows, robust, with_outliers(plain, 4, 17)


def test_weights_of_the_judge_are_taken_where_they_predict_better(robust_and_plain):
    rows, robust, plain = robust_and_plain
    found = judged_by(plain, rows, robust)
    weights = found.estimate.problem.weights
    np.testing.assert_array_equal(weights, robust.estimate.problem.weights)
    assert weights[[4, 17]].tolist() == [0.0, 0.0]
    # The judge's prediction is better, so rows are flagged only where it flags them too.
    np.testing.assert_allclose(found.estimate.scores, robust.estimate.scores, rtol=1e-12)


def test_weights_of_the_judge_are_not_taken_where_they_predict_worse(robust_and_plain):
    rows, robust, plain = robust_and_plain
    found = judged_by(robust, rows, plain)
    np.testing.assert_array_equal(found.estimate.x, robust.estimate.x)
    np.testing.assert_array_equal(found.estimate.problem.weights, robust.estimate.problem.weights)
    np.testing.assert_array_equal(found.estimate.scores, robust.estimate.scores)


def errors_of(mean: float, spread: float, count: int = 25) -> np.ndarray:
    """Errors of poses with this mean, whose differences from others of the same spread are exact."""
    return mean + spread * np.linspace(-1.0, 1.0, count)


@pytest.mark.parametrize(
    ("evidence", "errors", "name"),
    [
        # As good on held-out rows: evidence decides.
        ((0.0, -1.0), (errors_of(1.0, 0.0), errors_of(1.0, 0.3)), "zeros"),
        # Smaller by a fifth, far beyond chance.
        ((0.0, -1.0), (errors_of(1.0, 0.0), errors_of(0.8, 0.1)), "dh"),
        # Whatever the evidence says.
        ((0.0, -90.0), (errors_of(1.0, 0.0), errors_of(0.8, 0.1)), "dh"),
        # Smaller beyond chance, but by too little.
        ((0.0, -1.0), (errors_of(1.0, 0.0), errors_of(0.97, 0.01)), "zeros"),
        # Smaller by a fifth; chance does that in 4 of 100 cases, which is too often against evidence of 20 to 1.
        ((0.0, -2.9), (errors_of(1.0, 0.0), errors_of(0.8, 0.91)), "dh"),
        ((0.0, -3.1), (errors_of(1.0, 0.0), errors_of(0.8, 0.91)), "zeros"),
        # In 20 of 100.
        ((0.0, -1.0), (errors_of(1.0, 0.0), errors_of(0.8, 2.0)), "zeros"),
        # A larger geometry does not win against a smaller one either.
        ((-2.0, 0.0), (errors_of(2.7, 0.5), errors_of(4.6, 0.4)), "zeros"),
        # Fewer than 16 poses say nothing against the evidence.
        ((0.0, -1.0), (errors_of(1.0, 0.0, 16), errors_of(0.8, 0.1, 16)), "dh"),
        ((0.0, -1.0), (errors_of(1.0, 0.0, 15), errors_of(0.8, 0.1, 15)), "zeros"),
    ],
)
def test_a_geometry_that_left_out_rows_contradict_does_not_win(evidence, errors, name):
    candidates = [a_candidate(n, e) for n, e in zip(("zeros", "dh"), evidence, strict=True)]
    assert preferred(candidates, errors) == name
    assert preferred(candidates[::-1], errors[::-1]) == name


def test_of_geometries_that_are_clearly_better_the_best_on_left_out_rows_wins():
    candidates = [
        a_candidate("zeros", 0.0),
        a_candidate("dh", -1.0),
        a_candidate("placement", -2.0),
    ]
    errors = [errors_of(1.0, 0.0), errors_of(0.8, 0.1), errors_of(0.75, 0.1)]
    assert preferred(candidates, errors) == "placement"


def test_alternatives_have_more_evidence_and_smaller_errors_than_the_geometry():
    gone = FAMILIES["gain"].prior * 1e-3
    candidates = marked(
        [
            a_candidate("dh", 0.0, 2e-4),
            a_candidate("dh+gravity", 9.0, 1e-4),
            a_candidate("dh+gain+gravity", 6.5, 1e-4, {"gain": gone}),  # the same model
            a_candidate("dh+compliance", 5.0, 1e-4),
            a_candidate("placement+eccentricity", 7.0, 1.9e-4),
            a_candidate("dh+eccentricity", 8.0, 2.1e-4),  # worse than the geometry
            a_candidate("zeros+gain", -1.0, 1e-4),  # less likely
            a_candidate("placement", -2.0, 1e-4),
        ],
        "dh",
        "dh+gravity",
    )
    assert {c.name: c.chosen for c in candidates if c.chosen} == {
        "dh": "geometry",
        "dh+gravity": "non_geometric",
    }
    assert alternatives(candidates) == ("placement+eccentricity", "dh+compliance")
    more = [a_candidate(f"{base}+gravity", 4.0, 1e-4) for base in ("zeros", "hayati", "placement")]
    assert len(alternatives((*candidates, *more))) == 3
