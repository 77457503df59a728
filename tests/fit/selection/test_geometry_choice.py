"""The choice of the geometry by evidence and by errors on held-out poses."""

from __future__ import annotations

import numpy as np
import pytest

from calib.fit.selection.geometry_choice import preferred_geometry
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
