"""Selection (``auto``): how much model the data support.

Every candidate is fitted by restricted likelihood with the same weights of the rows: those of a reference fit. At first
this is the fit of the largest model, then that of the model which its weights choose. The geometry for the URDF is the
candidate of the highest evidence without families of non-geometric errors, unless errors on held-out rows contradict.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.basics.arrays import Mask, read_only
from calib.basics.progress import trying
from calib.fit.estimate.fitting import Fitted, fit
from calib.fit.estimate.task import Task
from calib.fit.registration.rows import Rows
from calib.fit.selection.candidates import (
    Candidate,
    check_parameter_names,
    determinable_families,
    geometry_parameters,
    mark_chosen,
    model_name,
    moved_families,
    without_vanished_families,
)
from calib.fit.selection.row_order import order_matters
from calib.fit.selection.row_weights import explains_more_rows
from calib.fit.selection.search import Search
from calib.model.families import family_of

#: The most searches: after the first, weights are estimated again with the model that the last one chose.
_MOST_SEARCHES = 2

#: About how many rows choose the model; of more a part is drawn.
_CHOSEN_BY = 2000

#: The same of corners in images: those of one view share the robot's error there, and say of it what one pose does.
_CHOSEN_BY_CORNERS = 600

#: The fewest corners of a view: twice those that determine a pose.
_CORNERS_OF_VIEW = 8


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """The chosen models."""

    #: Name of the geometry that goes into the URDF
    geometry: str
    #: Name of the non-geometric model; "" if the data support none
    non_geometric: str
    #: All that were fitted, in order
    candidates: tuple[Candidate, ...]
    #: Fit of the non-geometric model, or of the geometry if there is none; with its own weights, or with those of the
    #: search's reference fit if that explains more rows
    chosen: Fitted


def select(task: Task, rows: Rows, excluded: tuple[str, ...] = ()) -> Selection:
    """Choose a geometry, and a non-geometric model if the data support one.

    The search begins with the largest model of usual families, whose priors shrink what the data do not support to
    nothing, and moves to neighbours of higher evidence, see `Search`. Of many rows a part is used, and the chosen model
    fitted to all. If that depends on the order of the rows, and the order does not matter, it is searched once more
    without such errors.

    Args:
        task: The fit; its model does not count.
        rows: Rows to fit.
        excluded: Names of families that are not offered.

    Returns:
        The chosen models, all candidates, and the fit of the non-geometric model, or of the geometry if there is none.

    Raises:
        ModelError: The cell names a parameter that no model has.
        MeasurementError: Too few rows, or rows of one pose only.
        SolverError: The residual of a fit is not finite at its start.
    """
    check_parameter_names(task)
    few_rows = rows.select(some_rows(rows))
    task = replace(task, allow_absent=True)
    geometries = geometry_parameters(task)
    offered = determinable_families(task, few_rows)
    families = tuple(family for family in offered if family not in excluded)
    if task.cell.priors.source == "off":
        # Without priors there must be a number for each parameter.
        enough = [name for name, size in geometries.items() if size <= few_rows.count]
        largest = enough[-1] if enough else next(iter(geometries))
    else:
        usual = tuple(family for family in families if not family_of(family).rarity)
        largest = model_name(tuple(geometries)[-1], usual)

    trying(largest)
    reference = fit(replace(task, model=largest), few_rows)
    start = without_vanished_families(largest, reference.estimate.prior_std)
    fitted_rows = reference.estimate.problem.rows
    search_task, search_rows = with_known_points(task, reference, fitted_rows)
    search = Search(search_task, search_rows, reference, tuple(geometries), families)

    # Until the chosen model's weights choose it again, or the reference explains more rows than it does.
    for number in range(1, _MOST_SEARCHES + 1):
        highest = search.highest_evidence(start)
        geometry = search.best_geometry()
        best = search.best_non_geometric(highest, geometry)
        best_task = replace(search_task, model=best)
        trying(best)
        chosen = fit(best_task, search_rows, registered=search.reference.setup)
        if explains_more_rows(search.reference, chosen):
            chosen = fit(best_task, search_rows, reference=search.reference)
            break
        same_outliers = np.array_equal(chosen.estimate.outliers, search.reference.estimate.outliers)
        if same_outliers or number == _MOST_SEARCHES:
            break
        search = replace(search, reference=chosen, tried={}, _nearest=[])
        start = best
    non_geometric = best if "+" in best else ""
    of_order = moved_families(best)
    if of_order and not order_matters(chosen, of_order):
        of_moves = tuple(family for family in families if family_of(family).moved)
        return select(task, rows, (*excluded, *of_moves))
    candidates = mark_chosen(search.tried.values(), geometry, non_geometric)

    if len(few_rows) < len(rows) or search_task is not task:
        whole_task = replace(best_task, setup=task.setup)
        # With internals of points, the whole fit is so large that it begins where the search has come to.
        near = () if search_task is task else (chosen, reference)
        trying(best)
        chosen = fit(whole_task, rows, registered=reference.setup, near=near)
    return Selection(geometry, non_geometric, candidates, chosen)


def some_rows(rows: Rows) -> Mask:
    """Return which rows are enough to choose a model by, or to test one.

    Args:
        rows: N rows; of corners in images fewer count, but some of each view.

    Returns:
        shape (N,), drawn evenly.
    """
    if not np.all(rows.is_image):
        return rows.evenly(_CHOSEN_BY)
    views = np.column_stack([rows.blocks, rows.samples.frame, rows.samples.target])
    of_views = _CORNERS_OF_VIEW * len(np.unique(views, axis=0))
    return rows.evenly(min(max(_CHOSEN_BY_CORNERS, of_views), _CHOSEN_BY))


def with_known_points(task: Task, fitted: Fitted, rows: Rows) -> tuple[Task, Rows]:
    """Return a task and its rows with internals of single points of targets known, as a fit estimated them.

    Every corner of a print has two errors of its own, often more than the robot has parameters. They hardly depend on
    the robot's model, so candidates are compared with the corners where a first fit has them; of several cameras with
    the lenses as well.

    Args:
        task: The task of other models.
        fitted: A fit to these rows.
        rows: N rows.

    Returns:
        The task without these internals among the unknowns, and the rows with them as estimated; the same task and rows
        if nothing of single points is estimated.
    """
    estimated = fitted.kinematics.internals(fitted.estimate.x, rows.samples)
    if estimated is None or rows.samples.internals is None:
        return task, rows
    # Of several cameras the lenses have more numbers than the robot, too.
    several = len(np.unique(rows.samples.frame[rows.has_views])) > 1
    of_points = [u for u in task.setup.internals if several or u.parameter.of_one_point]
    if not of_points:
        return task, rows
    kept = [] if several else [u for u in task.setup.internals if not u.parameter.of_one_point]
    columns = sorted({c for u in of_points if (c := u.parameter.internal) is not None})
    values = rows.samples.internals.copy()
    values[:, columns] = estimated.values[:, columns]
    samples = replace(rows.samples, internals=read_only(values))
    setup = replace(task.setup, internals=tuple(kept))
    return replace(task, setup=setup), replace(rows, samples=samples)
