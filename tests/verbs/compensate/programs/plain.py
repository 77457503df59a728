"""Programs of bare numbers, a line for each motion, for tests of what all dialects share.

``P`` a pose by joints, ``L`` on a line, ``J`` joint values; then the numbers, mm and deg, and a comment behind ``#``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from calib.data.forms.orientations import find_convention
from calib.verbs.compensate.programs.program_file import (
    Configuration,
    Move,
    NumberText,
    ProgramFile,
    ProgramText,
    Target,
)

MOTIONS = {"P": "joint", "J": "joint", "L": "linear"}


def plain(
    text: str,
    *,
    convention: str = "kuka",
    tools: Sequence[np.ndarray] = (),
    frame: np.ndarray | None = None,
    frames: Sequence[np.ndarray] = (),
    most_decimals: int | None = None,
    configuration: Callable[[int], Configuration | None] = lambda _: None,
    same: dict[int, int] | None = None,
) -> ProgramFile:
    """The program of a text; ``tools`` and ``frames`` by motion, ``same`` the motion whose target another one has."""
    found = find_convention(convention)
    targets, moves, start = [], [], 0
    for line, words in enumerate(text.splitlines(keepends=True), 1):
        letter = words[0]
        numbers = [
            NumberText(start + m.start(), start + m.end(), float(m[0]), most_decimals)
            for m in re.finditer(r"[-+]?[.\d]+(?:[Ee][-+]?\d+)?", words.partition("#")[0])
        ]
        start += len(words)
        degrees = np.pi / 180.0
        scales = [degrees] * len(numbers)
        if letter != "J":
            scales = [1e-3] * 3 + [1.0 if found.unit == "" else degrees] * (len(numbers) - 3)
            if found.unit == "rad":
                scales[3:] = [1.0] * 3
        targets.append(
            Target(
                f"P{line}",
                0,
                line,
                tuple(numbers),
                tuple(scales),
                None if letter == "J" else found,
                configuration(line),
            )
        )
        tool = tools[line - 1] if tools else np.eye(4)
        of_frame = None if letter == "J" else (np.eye(4) if frame is None else frame)
        if frames and of_frame is not None:
            of_frame = frames[line - 1]
        number = (same or {}).get(line, line) - 1
        moves.append(Move(number, 0, line, MOTIONS[letter], tool, of_frame))
    return ProgramFile((ProgramText(Path("p.txt"), text),), tuple(targets), tuple(moves))


def line_of(letter: str, content: np.ndarray, convention: str = "kuka", decimals: int = 9) -> str:
    """A line of a plain program: joint values (m,) [rad] or a pose (4, 4) [m], in mm and deg."""
    if content.ndim == 1:
        numbers = [f"{x:.{decimals}f}" for x in np.degrees(content)]
    else:
        found = find_convention(convention)
        turn = found.numbers(content[None, :3, :3])[0]
        turn = np.degrees(turn) if found.unit == "deg" else turn
        few = decimals if found.unit == "deg" else decimals + 4
        numbers = [f"{x:.{decimals}f}" for x in 1e3 * content[:3, 3]]
        numbers += [f"{x:.{few}f}" for x in turn]
    return f"{letter} {' '.join(numbers)} # 1.5\n"
