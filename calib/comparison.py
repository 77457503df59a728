"""compare, and its result with what writes it."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

from calib.identify import comparison
from calib.identify.comparison import Comparison as Values
from calib.identify.comparison_file import comparison_table
from calib.identify.comparison_text import comparison_text
from calib.identify.result import Calibration
from calib.identify.result_file import write_table
from calib.model.robot import Robot

__all__ = ["Comparison", "compare"]


class Comparison(Values):
    """The result of `compare`: the values of `calib.identify.comparison.Comparison`, and what writes them."""

    __slots__ = ()

    def summary(self) -> str:
        """The comparison as text, without colours, in 100 columns."""
        return comparison_text(self)

    def table(self) -> dict[str, Any]:
        """The comparison as nested tables of plain values; the keys are documented in docs/comparison.md."""
        return comparison_table(self)

    def write_json(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the comparison as JSON.

        Raises:
            FileError: The file exists, or cannot be written.
        """
        return write_table(self.table(), path, overwrite=overwrite)


def compare(
    a: Calibration | str | Path,
    b: Calibration | str | Path,
    robot: Robot | str | Path | None = None,
) -> Comparison:
    """See `calib.identify.comparison.compare`."""
    found = comparison.compare(a, b, robot)
    return Comparison(**{one.name: getattr(found, one.name) for one in fields(found)})


compare.__doc__ = comparison.compare.__doc__
