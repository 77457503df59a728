"""calibrate, and the result with what writes it: above reports and below the command line.

What writes is imported when it is asked for: to calibrate takes none of it.
"""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

from calib.identify import calibration
from calib.identify.crossvalidation import Progress
from calib.identify.result import Calibration as Values
from calib.identify.solvers import Solver
from calib.measure.cell import Cell
from calib.measure.measurements import Measurements
from calib.model.robot import Robot
from calib.model.urdf import Urdf

__all__ = ["Calibration", "calibrate"]


class Calibration(Values):
    """The result of `calibrate`: the values of `calib.identify.result.Calibration`, and what writes them.

    Two ways lead to one: `calib.calibrate`, and `Calibration.read_json` of a file that `write_json` wrote.
    """

    __slots__ = ()

    @classmethod
    def of(cls, values: Values) -> Calibration:
        """The values of a result, with what writes them."""
        return cls(**{one.name: getattr(values, one.name) for one in fields(values)})

    @classmethod
    def read_json(cls, path: str | Path) -> Calibration:
        """Read a result that `write_json` or ``calib fit --json`` wrote; it has no ``fit``.

        Raises:
            FileError: It cannot be read, is no result of this version of calib, or damaged.
        """
        from calib.identify.result_file import read_result

        return cls.of(read_result(path))

    def summary(self) -> str:
        """The result as text, without colours."""
        from calib.identify.summary import summary

        return summary(self)

    def checked_urdf(self, *, target_link: bool = False) -> Urdf:
        """What `write_urdf` writes, read back with Pinocchio and yourdfpy as it does.

        Raises:
            UrdfError: A reader disagrees with the model in memory by more than 1e-9 m or rad.
            ModelError: Several targets, which one link cannot stand for.
        """
        from calib.identify.result_urdf import checked_urdf

        return checked_urdf(self, target_link=target_link)

    def write_urdf(
        self, path: str | Path, *, overwrite: bool = False, target_link: bool = False
    ) -> Path:
        """Write the corrected URDF, the geometry alone, after reading it back with Pinocchio and yourdfpy.

        Args:
            path: Where to.
            overwrite: Whether an existing file may be replaced.
            target_link: Whether to add a link ``calib_target`` at the target, fixed to the tip.

        Raises:
            UrdfError: A reader disagrees with the model in memory by more than 1e-9 m or rad.
            ModelError: Several targets, which one link cannot stand for.
            FileError: The file exists, or cannot be written.
        """
        return self.checked_urdf(target_link=target_link).write(path, overwrite=overwrite)

    def write_json(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the result as JSON; the keys are documented in docs/result-json.md.

        Raises:
            FileError: The file exists, or cannot be written.
        """
        from calib.identify.result_file import write_result

        return write_result(self, path, overwrite=overwrite)

    def write_report(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the report, a page with figures that prints on A4.

        Raises:
            FileError: The name has another ending, the file exists, or it cannot be written.
            ModelError: The result was read from a file, which does not hold the measurements.
        """
        from calib.show.report import write_report

        return write_report(self, path, overwrite=overwrite)


def calibrate(
    robot: Robot,
    measurements: Measurements,
    *,
    cell: Cell | None = None,
    model: str | None = None,
    solver: str | Solver = "lm",
    robust: bool = True,
    validate: bool = True,
    progress: Progress | None = None,
) -> Calibration:
    """See `calib.identify.calibration.calibrate`."""
    found = calibration.calibrate(
        robot,
        measurements,
        cell=cell,
        model=model,
        solver=solver,
        robust=robust,
        validate=validate,
        progress=progress,
    )
    return Calibration.of(found)


calibrate.__doc__ = calibration.calibrate.__doc__
