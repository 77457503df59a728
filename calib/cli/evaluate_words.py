"""From the words of ``calib evaluate`` to what is asked of a robot, and which one is judged."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

from calib.cli.words import parse_pair
from calib.errors import CalibError, choices

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from calib.identify.acceptance import Acceptance
    from calib.identify.evaluation import Evaluation


class Judge(str, Enum):
    """Which robot is judged."""

    nominal = "nominal"
    urdf = "urdf"
    calibration = "calibration"
    larger = "larger"


class Criterion(str, Enum):
    """What is held against the tolerance."""

    max = "max"
    mean = "mean"
    single = "single"


@dataclass(frozen=True)
class Wanted:
    """What is asked of a robot, see `calib.identify.acceptance.acceptance`.

    Attributes:
        tolerance: Of lengths [m]; None: they are not judged.
        tolerance_angle: Of angles [rad]; likewise.
        uncertainty: Of a measured length [m].
        uncertainty_angle: Of a measured angle [rad].
        criterion: What must be within.
    """

    tolerance: float | None
    tolerance_angle: float | None
    uncertainty: float
    uncertainty_angle: float
    criterion: str

    def of(self, evaluation: Evaluation, *, seen: NDArray[np.bool_]) -> Acceptance:
        """The robot of an evaluation held against it; ``seen`` are the rows that its calibration was fitted to."""
        from calib.identify.acceptance import acceptance

        return acceptance(
            evaluation,
            self.tolerance,
            self.tolerance_angle,
            uncertainty=self.uncertainty,
            uncertainty_angle=self.uncertainty_angle,
            criterion=self.criterion,
            seen=seen,
        )


def wanted_of(
    tolerance: str | None,
    uncertainty: str | None,
    criterion: Criterion | None,
    *,
    judge: Judge | None,
) -> Wanted | None:
    """What is asked of the robot; None without a tolerance.

    Raises:
        CalibError: A text is none of its kind, or there is nothing that it could count for.
    """
    example = "0.5 mm 0.1 deg"
    if tolerance is None:
        given = {"uncertainty": uncertainty, "criterion": criterion, "judge": judge}
        useless = [f"--{name}" for name, value in given.items() if value is not None]
        if useless:
            message = (
                f"{' and '.join(useless)} without --tolerance: nothing is judged without one. State it, such as "
                f'--tolerance "{example}".'
            )
            raise CalibError(message)
        return None
    limits = parse_pair(tolerance, "--tolerance", example)
    sure: tuple[float | None, float | None] = (None, None)
    if uncertainty is not None:
        sure = parse_pair(uncertainty, "--uncertainty", "0.05 mm 0.01 deg")
    for limit, stated, what in zip(limits, sure, ("length", "angle"), strict=True):
        if limit is None and stated is not None:
            message = (
                f'--uncertainty was given as "{uncertainty}", and --tolerance as "{tolerance}", which has no {what}; '
                "state a tolerance for each uncertainty."
            )
            raise CalibError(message)
    return Wanted(*limits, sure[0] or 0.0, sure[1] or 0.0, (criterion or Criterion.max).value)


def judged_robot(judge: Judge | None, found: Iterable[str], name: str | None) -> str:
    """The key of the robot that is judged.

    Args:
        judge: What was asked for.
        found: The robots that there are.
        name: Name of the result's file.

    Raises:
        CalibError: There is none such.
    """
    who = ("urdf" if name is None else "calibration") if judge is None else judge.value
    if who not in found:
        reason = (
            "takes --calibration"
            if name is None
            else f"is none of {name}, which has no larger model"
        )
        message = f"--judge {who} {reason}; choose one of {choices(found)}."
        raise CalibError(message)
    return who
