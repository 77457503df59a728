"""What is printed on a program: which lines were corrected, which are left, and why."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np

from calib.robot.robot import Robot
from calib.verbs.compensate.programs.correction import CorrectedProgram, corrected
from calib.verbs.compensate.programs.program_file import Left, LeftCode
from calib.verbs.compensate.programs.text import _LEFT, not_reached_text, program_text
from tests.places import ROOT
from tests.verbs.compensate.arms import off
from tests.verbs.compensate.programs.plain import line_of, plain

ARM = Robot.load("ur5", base="base", tip="tool0")
Q = np.array([0.3, -1.2, 1.5, -1.0, -1.4, 0.4])
FAR = ARM.poses(Q)[0].copy()
FAR[0, 3] += 3.0


def result(text: str, left: tuple[Left, ...] = (), **options) -> CorrectedProgram:
    return corrected(replace(plain(text, **options), left=left), ARM, off(ARM))


def test_every_code_has_its_words_and_its_row_in_the_page():
    assert set(_LEFT) == set(get_args(LeftCode))
    page = (ROOT / "docs" / "programs.md").read_text(encoding="utf-8")
    assert all(f"| `{code}` |" in page for code in _LEFT)


def test_lines_that_were_corrected_and_those_that_are_left():
    lines = [line_of("J", Q + 0.01 * k) for k in range(4)]
    items = tuple(Left(0, 10 + k, "relative", "LIN_REL") for k in range(12))
    text = program_text(result("".join(lines), items), "true.urdf", [Path("new.txt")])
    said = " ".join(text.split())
    assert "Corrected: 4 targets of 4 motions" in said
    assert "p.txt: lines 1 to 4" in said
    assert "line 10 of p.txt: LIN_REL" in said
    assert "and 4 more: lines 18 to 21" in said
    assert "Written: new.txt" in said
    assert max(map(len, text.splitlines())) <= 100


def test_few_digits_and_motions_that_cannot_be_corrected():
    text = line_of("J", Q, decimals=1) + line_of("L", FAR) + line_of("J", Q, decimals=1)
    made = result(text, most_decimals=1)
    said = " ".join(program_text(made, "true.urdf", []).split())
    assert "so few digits" in said
    assert "line 2 of p.txt: the nominal robot reaches it at no joint values" in said
    assert "1 of 3 motions cannot be corrected" in not_reached_text(made)
