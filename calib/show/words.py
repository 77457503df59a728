"""Words that several verbs share."""

from __future__ import annotations

from calib.model.families import unit_of
from calib.model.observability import Combination


def combination_text(combination: Combination) -> str:
    """Word a combination of parameters that change together, such as ``d2 and d4 together (+1 mm, -1 mm)``."""
    names = combination.names
    if len(names) == 1:
        return f"{names[0]} at all"
    if len(names) > _MOST_NAMES:
        return f"{', '.join(names[:_MOST_NAMES])} and {len(names) - _MOST_NAMES} more together"
    amounts = []
    for step, si_unit in zip(combination.steps, combination.units, strict=True):
        factor, unit = unit_of(si_unit).shown
        amounts.append(f"{factor * step:+.3g} {unit}")
    return f"{', '.join(names[:-1])} and {names[-1]} together ({', '.join(amounts)})"


#: Parameters of a combination that are named; the others are counted.
_MOST_NAMES = 6
