"""The view of two calibrations of one robot."""

from __future__ import annotations

from dataclasses import replace

from calib.show.scene.posed_robot import translation
from calib.verbs.compare.comparison import Comparison
from calib.verbs.compare.text import sentence
from calib.verbs.view.view import View, view_of_robots


def view_of_comparison(comparison: Comparison) -> View:
    """Return the view of two results of one robot, with the first one's target, each in the base of its own fit.

    The poses are not measured ones: they are spread over the joint limits, and their labels say so.
    """
    c = comparison
    names = ((f"a: {c.names[0]}", "the first result"), (f"b: {c.names[1]}", "the second result"))
    title = f"{c.a.nominal.name or 'Robot'}: two calibrations"
    target = translation(c.a.target)
    view = view_of_robots(c.a.corrected(c.robot), c.b.corrected(c.robot), names=names)
    view = replace(view, nominal_target=target, calibrated_target=target)
    return replace(view, title=title, note=sentence(c))
