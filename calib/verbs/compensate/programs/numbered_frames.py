"""Tools and frames that a program names by number: those stated by options, then those of the controller's files.

All that are defined nowhere are named in one message, with the options that state them.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from calib.basics.arrays import Array, read_only
from calib.data.forms.orientations import CONVENTIONS
from calib.errors import MeasurementError, choices
from calib.verbs.compensate.programs.program_file import Stated


def pose_of_numbers(numbers: list[float], convention: str) -> Array:
    """Return a pose, shape (4, 4), read-only [m], of x, y, z [mm] and three angles [deg] in a convention's order."""
    T = np.eye(4)
    T[:3, 3] = np.array(numbers[:3]) * 1e-3
    T[:3, :3] = CONVENTIONS[convention].matrices(np.radians([numbers[3:6]]))[0]
    return read_only(T)


class NumberedFrames:
    """The tools and frames of one program; it collects those that are missing while the program is read."""

    def __init__(
        self,
        path: Path,
        stated: Stated,
        tools: Mapping[int, Array],
        frames: Mapping[int, Array],
        *,
        files: str,
    ) -> None:
        """Take what options state and files of the controller define.

        Args:
            path: The program, for messages.
            stated: What options state.
            tools: T_tip_tool, shape (4, 4) [m], by number, of the controller's files.
            frames: T_base_frame, shape (4, 4) [m], by number, likewise.
            files: Names of such files, for messages.
        """
        self._path = path
        self._stated = (stated.tools, stated.frames)
        self._defined = (tools, frames)
        self._missing: tuple[dict[int, None], dict[int, None]] = ({}, {})
        self._files = files

    def tool(self, number: int, *, needed: bool = True) -> Array | None:
        """Return T_tip_tool of a tool, shape (4, 4) [m]; None if it is missing, which counts if it is ``needed``."""
        return self._find(0, number, needed=needed)

    def frame(self, number: int) -> Array | None:
        """Return T_base_frame of a frame, shape (4, 4) [m]; None if it is missing."""
        return self._find(1, number, needed=True)

    def _find(self, kind: int, number: int, *, needed: bool) -> Array | None:
        """Return a tool (kind 0) or a frame (kind 1)."""
        stated = self._stated[kind]
        if str(number) in stated:
            return stated[str(number)]
        if number in self._defined[kind]:
            return self._defined[kind][number]
        if "" in stated:
            return stated[""]
        if needed:
            self._missing[kind][number] = None
        return None

    def check(self) -> None:
        """Name all that is missing, by a `MeasurementError`."""
        tools, frames = (sorted(numbers) for numbers in self._missing)
        if not tools and not frames:
            return
        what, options = [], []
        for numbers, word in ((tools, "tool"), (frames, "frame")):
            if numbers:
                what.append(f"{word} {choices(map(str, numbers))}")
                options.append(f'--{word} "{numbers[0]}=0 0 0 mm 0 0 0 deg"')
        raise MeasurementError(
            f"{self._path}: {' and '.join(what)} of the program must be stated, one option for each, "
            f"{' and '.join(options)} (a rotation vector follows the position), or come from the controller's "
            f"{self._files}, given with --data."
        )
