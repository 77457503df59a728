"""Checks of the values that a scenario is made with."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from calib.basics.arguments import check_mapping, check_number, check_type, check_whole
from calib.basics.channels import residual_unit
from calib.data.surroundings import TrackerNoise
from calib.errors import CalibError
from calib.model.families import family_of
from calib.robot.robot import Robot
from calib.verbs.simulate.disturbances import Encoder, MovedTarget, Outliers

#: Attributes of a scenario, their types, and what messages call these.
_TYPES = (
    ("model", str, "the name of a model"),
    ("errors", Sequence, "pairs of the name and the value of an error"),
    ("noise", (TrackerNoise, type(None)), "a TrackerNoise, or None"),
    ("encoder", Encoder, "an Encoder"),
    ("outliers", (Outliers, type(None)), "Outliers, or None"),
    ("moved", (MovedTarget, type(None)), "a MovedTarget, or None"),
    ("true_robot", (Robot, type(None)), "a Robot, or None"),
)


def check_scenario(scenario: object) -> None:
    """Refuse values of another type, and numbers that are none.

    Args:
        scenario: The `calib.verbs.simulate.scenario.Scenario`, as it was given.

    Raises:
        ArgumentError: A value is of another type.
        ModelError: A number is out of range, or there is no such family of errors.
        CalibError: There is no such unit, or it is that of lengths, whose noise is stated by itself.
    """
    value = partial(getattr, scenario)
    for name, types, allowed in _TYPES:
        check_type(name, value(name), types, allowed)
    check_number("target_error", value("target_error"), 0.0)
    check_mapping("sigma", value("sigma"))
    if "m" in value("sigma"):
        raise CalibError(
            "The argument 'sigma' has 'm'; the noise of lengths is the argument 'noise', such as "
            "TrackerNoise(constant=1e-4, per_length=0.0)."
        )
    for unit, std in value("sigma").items():
        check_number(f"sigma[{residual_unit(unit).symbol!r}]", std, 0.0)
    check_whole("visits", value("visits"), 1)
    if value("sizes") is not None:
        check_mapping("sizes", value("sizes"))
        for family, size in value("sizes").items():
            family_of(family)
            check_number(f"sizes[{family!r}]", size, 0.0)
