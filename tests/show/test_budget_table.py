"""The budget as a table and in words: every source has a name, lines add up, what is not known is left out."""

from __future__ import annotations

import numpy as np
import pytest

from calib.basics.arrays import read_only
from calib.show.blocks import TERMINAL
from calib.show.budget_table import _REMEDIES, SOURCES, budget_sentences, budget_table
from calib.show.tables import format_cells
from calib.uncertainty.at_poses import Contribution, Distribution, PoseUncertainty, Source
from calib.uncertainty.budget import Budget


def made(separated: bool = True, **stds: float) -> Budget:
    """A budget at two poses, of sources with these standard deviations of each coordinate [m] and turn [rad]."""
    parts = [
        Contribution(
            Source(name),
            read_only(np.repeat([std**2 * np.eye(6)], 2, axis=0)),
            Distribution.STUDENT,
            20.0,
        )
        for name, std in stds.items()
    ]
    poses = read_only(np.repeat([np.eye(4)], 2, axis=0))
    return Budget.of(PoseUncertainty(poses, tuple(parts), separated))


def cells(budget: Budget, **given: bool) -> list[list[str] | str]:
    table = budget_table(budget, **given)
    return format_cells(table.columns, table.rows)[1]


def test_every_source_has_a_name_and_a_remedy():
    assert set(SOURCES) == set(Source) == set(_REMEDIES)
    assert len(set(SOURCES.values())) == len(SOURCES)


def test_lines_are_standard_uncertainties_with_their_shares_and_the_whole():
    budget = made(model=3e-4, instrument=4e-4)
    first, second, combined, expanded = cells(budget, angles=False)
    root = np.sqrt(3.0)
    assert first == [SOURCES[Source.INSTRUMENT], f"{0.4 * root:.3f}", "t", "20", "64"]
    assert second == [SOURCES[Source.MODEL], f"{0.3 * root:.3f}", "t", "20", "36"]
    assert combined[1:] == [f"{0.5 * root:.3f}", "", f"{budget.freedom:.0f}", "100"]
    assert expanded[1] == f"{1e3 * budget.position:.3f}"


def test_orientations_have_a_column_if_they_are_known():
    budget = made(model=3e-4)
    assert cells(budget)[0][2] == f"{np.degrees(3e-4 * np.sqrt(3.0)):.4f}"
    assert "deg" not in " ".join(budget_sentences(budget, angles=False))


@pytest.mark.parametrize("separated", [True, False])
def test_what_would_halve_it_is_said_and_whether_the_instrument_is_known(separated):
    budget = made(separated, model=9e-4, instrument=1e-4)
    assert budget.halving == (Source.MODEL,)
    sentences = list(budget_sentences(budget))
    assert f"{1e3 * budget.position:.3f} mm" in sentences[0]
    assert SOURCES[Source.MODEL] in sentences[1]
    assert len(sentences) == 2 + (not separated)


def test_nothing_uncertain_is_an_empty_budget():
    budget = made()
    assert budget.dominant is None
    assert len(list(budget_sentences(budget))) == 1
    assert budget_table(budget, on=TERMINAL).on == TERMINAL
