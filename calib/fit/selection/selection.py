"""Selection (``auto``): how much model the data support.

Every candidate is fitted by restricted likelihood with the same weights of the rows: those of a reference fit. At first
this is the fit of the largest model, then that of the model which its weights choose. The geometry for the URDF is the
candidate of the highest evidence without families of non-geometric errors, unless errors on held-out rows contradict.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.fit.estimate.fitting import Fitted, fit
from calib.fit.estimate.task import Task
from calib.fit.registration.rows import Rows
from calib.fit.selection.candidates import Candidate, mark_chosen, without_vanished_families
from calib.fit.selection.known_corners import with_known_corners
from calib.fit.selection.ladder import (
    check_parameter_names,
    determinable_families,
    geometry_parameters,
    model_name,
)
from calib.fit.selection.reference_fit import explains_more_rows
from calib.fit.selection.search import Search

#: The most searches: after the first, weights are estimated anew with the model that the last ones chose.
_MOST_SEARCHES = 2

#: About how many rows choose the model; of more a part is drawn.
_CHOSEN_BY = 2000


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """The chosen models."""

    #: Name of the geometry that goes into the URDF
    geometry: str
    #: Name of the non-geometric model; "" where the data support none
    non_geometric: str
    #: All that were fitted, in order
    candidates: tuple[Candidate, ...]
    #: Fit of the non-geometric model, or of the geometry where there is none; with its own weights, or with those of
    #: the search's reference fit if that explains more rows
    chosen: Fitted


def select(task: Task, rows: Rows) -> Selection:
    """Choose a geometry, and a non-geometric model if the data support one.

    The search begins with the largest model, whose priors shrink what the data do not support to nothing, and moves
    to neighbours of higher evidence, see `Search`. Of many rows a part is used, and the chosen model fitted to all.

    Args:
        task: The fit; its model does not count.
        rows: Rows to fit.

    Returns:
        The chosen models, and all that were fitted.

    Raises:
        ModelError: The cell names a parameter that no model has.
        MeasurementError: Too few rows.
    """
    check_parameter_names(task)
    some_rows = rows.select(rows.evenly(_CHOSEN_BY))
    task = replace(task, allow_absent=True)
    geometries = geometry_parameters(task)
    families = determinable_families(task, some_rows)
    if task.cell.priors.source == "off":
        # Without priors there must be a number for each parameter.
        largest = _largest_geometry(geometries, some_rows.count)
    else:
        largest_geometry = tuple(geometries)[-1]
        largest = model_name(largest_geometry, families)
    reference = fit(replace(task, model=largest), some_rows)
    start = without_vanished_families(largest, reference.estimate.prior_std)
    # With the rows of sole postures marked.
    marked_rows = reference.estimate.problem.rows
    search_task, search_rows = with_known_corners(task, reference, marked_rows)
    search = Search(search_task, search_rows, reference, tuple(geometries), families)
    selection = _searched(search, start)
    if len(some_rows) == len(rows) and search_task is task:
        return selection
    chosen = selection.chosen
    whole_task = replace(chosen.task, setup=task.setup)
    of_all_rows = fit(whole_task, rows, registered=reference.setup)
    return replace(selection, chosen=of_all_rows)


def _largest_geometry(geometries: dict[str, int], count: int) -> str:
    """Return the largest geometry with no more parameters than there are scalars, or the smallest of all.

    Args:
        geometries: Number of parameters by the geometry's name, from the smallest to the largest.
        count: Number of measured scalars.

    Returns:
        The geometry's name.
    """
    enough = [name for name, parameters in geometries.items() if parameters <= count]
    if enough:
        return enough[-1]
    return next(iter(geometries))


def _searched(search: Search, start: str) -> Selection:
    """Search until the weights of the chosen model choose it again, or the reference explains more rows than it does.

    Args:
        search: The first search, in which nothing was tried; a second one has the weights of the model that it chose.
        start: Name of the model with which it begins.

    Returns:
        The models that the last search chose.
    """
    for number in range(1, _MOST_SEARCHES + 1):
        highest = search.highest_evidence(start)
        geometry = search.best_geometry()
        best = search.best_non_geometric(highest, geometry)
        task = replace(search.task, model=best)
        fitted = fit(task, search.rows, registered=search.reference.setup)
        if explains_more_rows(search.reference, fitted):
            fitted = fit(task, search.rows, reference=search.reference)
            break
        same_outliers = np.array_equal(fitted.estimate.outliers, search.reference.estimate.outliers)
        if same_outliers or number == _MOST_SEARCHES:
            break
        search = replace(search, reference=fitted, tried={})
        start = best
    non_geometric = best if "+" in best else ""
    candidates = mark_chosen(search.tried.values(), geometry, non_geometric)
    return Selection(geometry, non_geometric, candidates, fitted)
