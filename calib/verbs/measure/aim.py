"""Aim: how accurate the calibrated robot is to be, and where."""

from __future__ import annotations

from dataclasses import dataclass

from calib.basics.arguments import check_number, check_type, check_whole
from calib.basics.values import Value
from calib.errors import CalibError
from calib.verbs.plan.choice import MOST_POSES
from calib.verbs.workspace.region import Region

#: Probability with which the error of a single calibration shall be within the aim.
CONFIDENCE = 0.95

#: Largest aim [m]: no robot needs a calibration for more, and 0.2 was meant in millimetres.
_LARGEST = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Aim(Value):
    """The accuracy that the calibrated robot is to have, and the region for it.

    The error is that of a predicted position of the target, rms over the region: it shall be within the aim with a
    probability of `CONFIDENCE`.
    """

    #: The error [m]; None: that of a calibration by ``poses`` poses at random
    error: float | None = None
    #: Number of poses at random that would be as good, if no error is given
    poses: int = 40
    #: Where the target is to be accurate; None: over the joint ranges
    region: Region | None = None

    def __post_init__(self) -> None:
        """Refuse values of another type or out of range: `CalibError`."""
        if self.error is not None:
            check_number("error", self.error, 0.0)
            if self.error > _LARGEST:
                raise CalibError(
                    f"The aim is an error of {self.error:g} m, more than {_LARGEST:g} m. Give it in metres: 0.2 mm is "
                    "0.0002."
                )
            if not self.error > 0.0:
                raise CalibError(
                    "The aim is an error above 0; give for example 0.00015, in metres."
                )
        check_whole("poses", self.poses, 3)
        if self.poses > MOST_POSES:
            raise CalibError(f"The aim is that of {self.poses} poses; give {MOST_POSES} or fewer.")
        check_type("region", self.region, (Region, type(None)), "a Region, or None")
