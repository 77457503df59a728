"""The look of rows: each is of one kind, every kind is marked in its own way; and names that fit."""

from __future__ import annotations

import numpy as np

from calib.show.look import row_kinds, rows_text, short_names


def test_every_row_is_of_one_kind(calibrations):
    c = calibrations.made("with_outliers")
    kinds = row_kinds(c)
    assert [kind.name for kind in kinds] == ["estimation", "validation", "outlier"]
    assert np.all(np.sum([kind.mask for kind in kinds], axis=0) == 1)
    count = len(c.rows.outliers) + len(c.rows.suspects)
    assert kinds[2].style()["label"] == f"{count} outliers"
    assert len({(kind.colour, kind.marker) for kind in kinds}) == 3
    assert rows_text(np.array([True]), "estimation") == "1 estimation row"


def test_long_names_lose_their_middle():
    assert short_names(["a\tb", "abcdefghij"], 6) == ["a b", "abc…ij"]
