"""The function `plan`, and its result `Plan` with methods that show it."""

from __future__ import annotations

from calib.design.plan import PlanValues, plan as plan_values
from calib.values.with_methods import returning

__all__ = ["Plan", "plan"]


class Plan(PlanValues):
    """Poses to measure, in the order to drive: `calib.design.plan.PlanValues` with methods that show them."""

    __slots__ = ()

    def __repr__(self) -> str:
        """One line: the robot, numbers of poses, expected error."""
        from calib.text.shown.short import plan_line

        return plan_line(self)

    def _repr_html_(self) -> str:
        """A small table for notebooks: numbers of poses, expected errors."""
        from calib.text.shown.notebook import plan_html

        return plan_html(self)

    def summary(self) -> str:
        """Return the plan as text, without colours, as ``calib plan`` prints it."""
        from calib.text.plan import plan_text

        return plan_text(self)


plan = returning(Plan, plan_values, __name__)
