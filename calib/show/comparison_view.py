"""The page of two results of one robot: as the first has it, and as the second has it."""

from __future__ import annotations

from dataclasses import replace

from calib.identify.comparison import Comparison
from calib.identify.comparison_text import sentence
from calib.show.pictures import view_of_robots
from calib.show.view import View, translated


def view_of_comparison(comparison: Comparison) -> View:
    """Both robots with the first one's target, each in the base as its own fit has it: nothing is taken off.

    The poses are not measured ones: they are spread over the joint limits, and their labels say so.
    """
    c = comparison
    first, second = c.robots
    target = translated(c.a.target)
    view = view_of_robots(
        first,
        second,
        names=((f"a: {c.names[0]}", "the first result"), (f"b: {c.names[1]}", "the second result")),
        title=f"{c.a.nominal.name or 'Robot'}: two calibrations",
        note=sentence(c),
    )
    return replace(view, nominal_target=target, calibrated_target=target)
