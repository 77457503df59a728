"""What is read of a program, as lists to compare; and the whole way to where a simulated arm arrives by it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from calib.robot.robot import Robot
from calib.verbs.compensate.programs.correction import CorrectedProgram, corrected
from calib.verbs.compensate.programs.program_file import ProgramFile, Target
from tests.verbs.compensate.programs.controller import arrival


def motions(program: ProgramFile) -> list[tuple[int, str, str]]:
    """Line, motion and name of the target of each motion."""
    return [(m.line, m.motion, program.targets[m.target].name) for m in program.moves]


def left(program: ProgramFile) -> list[tuple[int, str]]:
    """Line and code of all that is left, by line."""
    return sorted((item.line, item.code) for item in program.left)


def values(target: Target) -> np.ndarray:
    """The numbers of a target in SI units."""
    return np.array([number.value for number in target.numbers]) * target.scales


def corrected_in_place(
    read: Callable[[Path], ProgramFile],
    path: Path,
    nominal: Robot,
    true: Robot,
    start: np.ndarray,
) -> tuple[CorrectedProgram, np.ndarray, np.ndarray]:
    """A program, corrected and written over, and how far the true tool ends before and after, each (N,) [m].

    The program begins at joint values ``start``, (m,). Without errors of the true robot it stays as it is.
    """
    program = read(path)
    by_name = dict(zip(nominal.joint_names, start.tolist(), strict=True))
    same = corrected(program, nominal, nominal, start=by_name)
    assert [text.text for text in same.texts] == [text.text for text in program.texts]

    done = corrected(program, nominal, true, start=by_name)
    for text in done.texts:
        text.path.write_bytes(text.text.encode("latin-1"))
    again = read(path)
    assert motions(again) == motions(program)
    before = arrival(nominal, true, program, program, start=start)
    after = arrival(nominal, true, program, again, start=start)
    return done, before, after
