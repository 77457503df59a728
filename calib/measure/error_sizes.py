"""How large the errors of a virtual robot are: a standard deviation for each family, none of which need be there."""

from __future__ import annotations

from dataclasses import dataclass, fields

from calib.errors import CalibError
from calib.measure.cell_parts import Priors, is_number


@dataclass(frozen=True, slots=True)
class ErrorSizes:
    """Standard deviations of a robot's errors, by family; 0 for none. The defaults are those of a typical arm.

    Attributes:
        length: [m].
        angle: [rad].
        zero: Of a joint's zero [rad].
        gain: Of a gear ratio, relative [rad/rad].
        eccentricity: Of an encoder's once-per-turn error [rad].
        compliance: Of a joint [rad/Nm]; a tenth of it in m/N where the joint slides.
    """

    length: float = 0.3e-3
    angle: float = 3e-3
    zero: float = 5e-3
    gain: float = 0.5e-3
    eccentricity: float = 0.5e-3
    compliance: float = 1e-5

    def __post_init__(self) -> None:
        """Refuse what is no standard deviation."""
        for one in fields(self):
            value = getattr(self, one.name)
            if not is_number(value) or value < 0.0:
                message = f"The size of errors in {one.name} is {value!r}; it must be a number, not below 0."
                raise CalibError(message)

    @classmethod
    def of(cls, priors: Priors) -> ErrorSizes:
        """The sizes that a cell expects."""
        return cls(**{one.name: getattr(priors, one.name) for one in fields(cls)})


#: What the errors of real arms have been found to be, see docs/simulation.md.
TYPICAL = ErrorSizes()
