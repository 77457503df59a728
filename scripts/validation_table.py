"""Print the tables of docs/verification.md that set calib beside other programs: what each answers to the same input.

    python scripts/validation_table.py

The inputs, and the functions that ask the other programs, are those of tests/validation/.
"""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from studies import print_table

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

#: Tests are not typed, and are not to be.
ANSWERS: Any = importlib.import_module("tests.validation.comparisons")


def comparison_rows(comparisons: Sequence[Any]) -> list[tuple[str, str, str, str]]:
    """Return what is compared, with which program, the largest difference, and its limit."""
    rows = []
    for one in comparisons:
        figure, limit = (f"{value:.0e} {one.unit}".strip() for value in (one.figure(), one.limit))
        rows.append((one.what, one.program, figure, limit))
    return rows


def nist_rows(programs: Sequence[str]) -> list[tuple[str, int, int, int]]:
    """Return what each program reaches of NIST's 27 sets from both starts."""
    rows = []
    for program in programs:
        score = ANSWERS.nist_score(program)
        rows.append((program, score.values, score.errors, score.wrong))
    return rows


def main() -> None:
    """Print both tables and the programs' versions."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.parse_args()
    print_table(
        ("same input", "program", "largest difference", "limit of the test"),
        comparison_rows(ANSWERS.COMPARISONS),
    )
    print()
    print_table(
        ("of 54", "8 digits of the values", "and 6 of the errors", "wrongly converged"),
        nist_rows(list(ANSWERS.NIST_SOLVERS)),
    )
    print()
    print(", ".join(f"{name} {version}" for name, version in ANSWERS.versions().items()))


if __name__ == "__main__":
    main()
