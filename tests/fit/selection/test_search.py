"""The search among models: its neighbours, and the choice of the geometry by evidence and held-out errors."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.stats import ttest_1samp

from calib.fit.selection.candidates import LADDER, Candidate
from calib.fit.selection.search import (
    Search,
    p_value_of_improvement,
    pose_errors,
    preferred_geometry,
)
from calib.model.families import joint_families
from calib.numerics.errors import CrossValidation, Errors
from tests.fit.selection.models import a_candidate


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
def test_a_geometry_that_held_out_rows_contradict_does_not_win(evidence, errors, name):
    candidates = [a_candidate(n, e) for n, e in zip(("zeros", "dh"), evidence, strict=True)]
    assert preferred_geometry(candidates, errors) == name
    assert preferred_geometry(candidates[::-1], errors[::-1]) == name


def test_of_geometries_that_are_clearly_better_the_best_on_held_out_rows_wins():
    candidates = [
        a_candidate("zeros", 0.0),
        a_candidate("dh", -1.0),
        a_candidate("placement", -2.0),
    ]
    errors = [errors_of(1.0, 0.0), errors_of(0.8, 0.1), errors_of(0.75, 0.1)]
    assert preferred_geometry(candidates, errors) == "placement"


def test_the_error_of_a_pose_is_that_of_its_rows_in_units_of_the_noise():
    residual = np.array([[3e-3, 0.0, 4e-3], [0.0, 6e-3, 0.0], [9.0, 9.0, 9.0], [0.0, 0.0, 2e-3]])
    errors = Errors.of(residual)
    validation = CrossValidation("", 3, np.array([5, 5, 5, 2]), residual, errors, errors)
    kept = np.array([True, True, False, True])
    scales = np.full((4, 3), 1e-3)
    expected = [2.0, np.sqrt((25.0 + 36.0) / 2.0)]
    np.testing.assert_allclose(pose_errors(validation, scales, kept), expected)
    scales[:, 2] = 2e-3
    np.testing.assert_allclose(pose_errors(validation, scales, kept)[0], 1.0)


def test_the_p_value_of_an_improvement_is_student_s_one_sided():
    rng = np.random.default_rng(5)
    improvements = 0.3 + rng.normal(size=12)
    expected = ttest_1samp(improvements, 0.0, alternative="greater").pvalue
    assert p_value_of_improvement(improvements) == pytest.approx(expected, rel=1e-9)
    assert p_value_of_improvement(-improvements) == pytest.approx(1.0 - expected, rel=1e-9)
    assert p_value_of_improvement(np.array([1.0])) == 1.0
    assert p_value_of_improvement(np.zeros(4)) == 1.0
    assert p_value_of_improvement(np.ones(4)) == 0.0


def searched(calibrated: Callable[..., Any], *candidates: Candidate) -> Search:
    """A search with all models fitted already: these, and all others with next to no evidence."""
    fitted = calibrated("points")[1].fit.geometry
    families = joint_families()
    subsets = (s for n in range(len(families) + 1) for s in itertools.combinations(families, n))
    names = ["+".join((base, *subset)) for subset in subsets for base in LADDER]
    tried = {name: a_candidate(name, -1e3) for name in names} | {c.name: c for c in candidates}
    rows = fitted.estimate.problem.rows
    return Search(fitted.task, rows, fitted, LADDER, families, tried)


def test_the_search_climbs_by_families_and_geometries(calibrated):
    search = searched(
        calibrated,
        a_candidate("dh", 0.0),
        a_candidate("dh+gain", 2.0),
        a_candidate("dh+gain+gravity", 4.0),
        a_candidate("placement+gain+gravity", 5.0),
    )
    assert search.highest_evidence("dh") == "placement+gain+gravity"
    largest = "placement+gain+eccentricity+gravity"
    assert search.highest_evidence(largest) == "placement+gain+gravity"


def test_one_family_takes_the_place_of_another(calibrated):
    """Neither without the one nor with both is there more evidence: only the exchange helps."""
    start, best = a_candidate("dh+eccentricity", 3.0), a_candidate("dh+gravity", 5.0)
    both = a_candidate("dh+eccentricity+gravity", 2.8)
    search = searched(calibrated, start, best, both)
    assert search.highest_evidence("dh+eccentricity") == "dh+gravity"
    # Gravity that vanishes beside eccentricity cannot replace it, and is not fitted in its place.
    vanished = a_candidate("dh+eccentricity+gravity", 0.5, prior_std={"gravity": 1e-7})
    search = searched(calibrated, start, vanished)
    del search.tried["dh+gravity"]
    assert search.highest_evidence("dh+eccentricity") == "dh+eccentricity"
    assert "dh+gravity" not in search.tried


def test_the_search_goes_on_from_a_geometry_that_exceeds_its_result(calibrated):
    search = searched(
        calibrated,
        a_candidate("frames+gain", 1.0),
        a_candidate("zeros", 2.0),
        a_candidate("zeros+compliance", 3.0),
    )
    assert search.highest_evidence("frames+gain") == "zeros+compliance"


def test_a_non_geometric_model_predicts_better_than_the_geometry(calibrated):
    """Of those that do, the one with the highest evidence."""
    search = searched(
        calibrated,
        a_candidate("dh", 0.0, 1e-4),
        a_candidate("dh+gain", 3.0, 1.1e-4),
        a_candidate("dh+gravity", 2.0, 0.9e-4),
        a_candidate("dh+compliance", 1.0, 0.8e-4),
    )
    assert search.best_non_geometric("dh+gain", "dh") == "dh+gravity"
    # Where no families have the highest evidence none are added.
    assert search.best_non_geometric("placement", "dh") == "dh"
    # With less evidence than the geometry none is chosen.
    search = searched(calibrated, a_candidate("dh", 2.5, 1e-4), a_candidate("dh+gain", 2.0, 0.9e-4))
    assert search.best_non_geometric("dh+gain", "dh") == "dh"
