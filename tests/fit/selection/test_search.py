"""The search among models: its neighbours, and what it chooses."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

from calib.fit.selection.candidates import Candidate
from calib.fit.selection.ladder import LADDER
from calib.fit.selection.search import Search
from calib.model.families import joint_families
from tests.fit.selection.models import a_candidate


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
