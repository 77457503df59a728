"""calib beside other programs: each difference is below its limit; and the docs have the same rows."""

from __future__ import annotations

import sys

import pytest

from tests.places import ROOT
from tests.validation.comparisons import COMPARISONS, NIST_SOLVERS, nist_score

sys.path.insert(0, str(ROOT / "scripts"))

from validation_table import comparison_rows, nist_rows

#: A second and a half.
LONG = {"jacobians_by_differences"}


@pytest.mark.parametrize(
    "comparison",
    [
        pytest.param(
            one,
            id=one.figure.__name__,
            marks=[pytest.mark.slow] if one.figure.__name__ in LONG else [],
        )
        for one in COMPARISONS
    ],
)
def test_the_difference_is_below_its_limit(comparison):
    assert comparison.figure() < comparison.limit


@pytest.mark.slow
def test_no_other_program_reaches_more_of_nists_sets():
    scores = {program: nist_score(program) for program in NIST_SOLVERS}
    calib = scores.pop("calib `levenberg_marquardt`")
    assert (calib.values, calib.errors, calib.wrong) == (54, 54, 0)
    assert all(40 <= one.values <= 54 for one in scores.values())


def test_the_docs_have_every_row_with_its_limit():
    """Figures near rounding differ from machine to machine, so that only the rest of a row is compared."""
    page = (ROOT / "docs/verification.md").read_text(encoding="utf-8")
    for one in COMPARISONS:
        row = next(line for line in page.splitlines() if line.startswith(f"| {one.what} |"))
        _, _, program, _, limit, _ = row.split("|")
        assert program.strip() == one.program
        assert limit.split()[0] == f"{one.limit:.0e}"
    for program in NIST_SOLVERS:
        assert f"| {program} |" in page


def test_rows_are_printed():
    one = COMPARISONS[0]
    assert comparison_rows([one])[0][:2] == (one.what, one.program)
    assert nist_rows([]) == []
