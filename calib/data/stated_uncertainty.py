"""What a cell states of uncertainty, ``[uncertainty]`` of a cell file: limits and standard deviations by certificate.

Whatever is stated here is a line of the uncertainty budget (`calib.uncertainty`). Nothing of it changes a fit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.basics.records import keep_checked, key
from calib.basics.units import is_number, noise_text, parse_noise
from calib.basics.value_forms import DEGREES, MM, Check, Form, Place, decimal, form
from calib.data.record import TEMPERATURES_C

#: Linear expansion of aluminium [1/K], of which most arms are cast; steel has half of it.
ALUMINIUM = 2.3e-5

#: A range has two ends.
_ENDS = 2


def _limit_form(part: int) -> Form:
    """Return the form of a limit of error that grows with the distance, of which part 0 [m] or 1 [m/m] is read."""

    def read(value: Any, place: Place) -> float:  # noqa: ANN401
        return parse_noise(str(value), str(place))[part]

    return Form('a length with its unit, "15 um + 6 um/m"', read)


def _range_or_none(value: Any) -> tuple[float, ...] | None:  # noqa: ANN401
    """Return the ends of a range of temperatures [°C] as a tuple, or an empty one; None for anything else."""
    given = tuple(value) if isinstance(value, (tuple, list)) else (value,)
    low, high = TEMPERATURES_C
    if not given:
        return ()
    if len(given) != _ENDS or not all(is_number(end) and low <= end <= high for end in given):
        return None
    return tuple(float(end) for end in given) if given[0] <= given[1] else None


_IS_SIZE = Check(
    "a number, 0 or more",
    lambda value: float(value) if is_number(value) and value >= 0.0 else None,
)


def _size(name: str, unit_form: Form, meaning: str, **more: Any) -> Any:  # noqa: ANN401  a field
    """Return the field of a size, 0 or more; not stated, it adds nothing."""
    arguments = {"default": 0.0, "absent": "none", "check": _IS_SIZE, **more}
    return key(name, unit_form, meaning, **arguments)


@dataclass(frozen=True, slots=True)
class StatedUncertainty:
    """Limits and standard deviations that are stated of instrument, arm and setup; what is 0 is not stated.

    Raises:
        CalibError: A size is below 0, or the temperatures are no range.
    """

    #: Largest error of a coordinate that the instrument measures, at no distance [m]
    instrument_limit: float = _size(
        "instrument_mpe",
        _limit_form(0),
        "Largest error of a coordinate that the instrument measures, by its certificate: a constant, plus a part for "
        "each metre of distance. It says how much of the residuals is the instrument's.",
        json="instrument_limit_m",
        of_record=lambda stated: noise_text(
            stated.instrument_limit, stated.instrument_limit_per_length
        ),
    )
    #: Its increase with the distance [m/m]
    instrument_limit_per_length: float = _size(
        "instrument_mpe", _limit_form(1), "", json="instrument_limit_m_m"
    )
    #: Largest error of an orientation about one axis that the instrument measures [rad]
    instrument_limit_angle: float = _size(
        "instrument_mpe_deg",
        DEGREES,
        "Largest error of a measured orientation about one axis.",
        json="instrument_limit_rad",
    )
    #: Standard deviation of one coordinate of the arm's arrivals at a pose [m]
    repeatability: float = _size(
        "repeatability_mm",
        MM,
        "Repeatability of the arm, as a standard deviation of one coordinate, in place of that of repeats.",
        json="repeatability_m",
    )
    #: Step of the readings of turning joints [rad]
    resolution: float = _size(
        "resolution_deg",
        DEGREES,
        "Step of the readings of joints that turn.",
        json="resolution_rad",
    )
    #: Step of the readings of sliding joints [m]
    resolution_sliding: float = _size(
        "resolution_mm", MM, "Step of the readings of joints that slide.", json="resolution_m"
    )
    #: Largest distance of a turning joint from its reading by lost motion, either way [rad]
    lost_motion: float = _size(
        "lost_motion_deg",
        DEGREES,
        "Largest angle by which a joint stands beside its reading, either way, by lost motion that the model does not "
        "have.",
        json="lost_motion_rad",
    )
    #: Standard deviation of one coordinate between series, such as days [m]
    drift: float = _size(
        "drift_mm",
        MM,
        "Change of positions between series of measurements, such as days, as a standard deviation of one coordinate.",
        json="drift_m",
    )
    #: Standard deviation of a stated frame's position along each axis [m]
    frame: float = _size(
        "frame_mm",
        MM,
        "How well a stated measurement frame is known, as a standard deviation along each axis.",
        json="frame_m",
    )
    #: That of its orientation about each axis [rad]
    frame_angle: float = _size("frame_deg", DEGREES, "The same about each axis.", json="frame_rad")
    #: Standard deviation of a stated target's position along each axis [m]
    target: float = _size(
        "target_mm",
        MM,
        "How well a target that is not estimated is known, as a standard deviation along each axis.",
        json="target_m",
    )
    #: Lowest and highest temperature at which the robot works [°C]; empty: not stated
    temperature: tuple[float, ...] = key(
        "temperature_C",
        form("two temperatures: [18, 26]", lambda value: tuple(value)),
        "Lowest and highest air temperature at which the robot works [°C]. It was measured at that of `[record]`, or "
        "else in the middle.",
        default=(),
        absent="not stated",
        check=Check(
            f"the lowest and the highest temperature, from {TEMPERATURES_C[0]:g} to {TEMPERATURES_C[1]:g} °C",
            _range_or_none,
        ),
        json="temperature_C",
    )
    #: Linear expansion of the arm [1/K]
    arm_expansion: float = _size(
        "arm_expansion_um_per_m_K",
        decimal("um/(m K)", -6, least=0.0),
        "Linear expansion of the arm. It has an effect if `temperature_C` is stated.",
        default=ALUMINIUM,
        absent="23, aluminium",
        json="arm_expansion_1_K",
    )
    #: Linear expansion of the instrument's unit of length [1/K]
    instrument_expansion: float = _size(
        "instrument_expansion_um_per_m_K",
        decimal("um/(m K)", -6, least=0.0),
        "Linear expansion of the instrument's unit of length, such as a frame of cameras or a printed board. It has an "
        "effect over the two temperatures of `[record]`.",
        json="instrument_expansion_1_K",
    )

    def __post_init__(self) -> None:
        """Check the values; raises `CalibError`."""
        keep_checked(self, "uncertainty")

    def instrument_std(self, distance: float) -> float:
        """Return the standard deviation of a coordinate at a distance [m] by the certificate: an even distribution."""
        limit = self.instrument_limit + self.instrument_limit_per_length * distance
        return limit / float(np.sqrt(3.0))


#: Nothing is stated.
NOT_STATED = StatedUncertainty()
