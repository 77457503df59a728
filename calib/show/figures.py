"""Figures of a calibration, for reports and papers: PNG, SVG or PDF, readable in print and with any colour vision.

`drawings` lists those that apply to a calibration, `rendered` makes a file of one, `write_figures` writes all and what
they show beside them. Captions say what is in the figure of this calibration, and nothing of what is not.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from calib.errors import FileError
from calib.identify.result import Calibration
from calib.identify.statements import errorless
from calib.model.files import make_folder, write_atomically
from calib.model.readback import SPREAD
from calib.show.figure_base import KINDS, Drawing, check_kind, in_style, rendered
from calib.show.figure_captions import (
    box_words,
    edge_words,
    left_out_words,
    numbers_words,
    shading_words,
    thin_words,
)
from calib.show.figure_curves import (
    by_pose_figure,
    curve_rows,
    curves_figure,
)
from calib.show.figure_fit import (
    candidates_figure,
    convergence_figure,
    singular_values_figure,
    stage_starts,
)
from calib.show.figure_joints import MOST_ROWS, has_mean, has_parts, joints_figure
from calib.show.figure_parameters import (
    changes_figure,
    correlation_indices,
    correlations_figure,
    shown_parameters,
)
from calib.show.figure_points import MOST_POINTS, POSES, points_figure, uncertainty_figure
from calib.show.figure_rows import (
    counted,
    has_angles,
    has_axes,
    has_flagged,
    measured_places,
    rows_text,
)
from calib.show.figure_spread import by_axis_figure, histogram_figure
from calib.show.report_markdown import escaped

__all__ = ["CAPTIONS", "KINDS", "Drawing", "drawings", "figure_files", "rendered", "write_figures"]

#: The file of the captions, beside the figures.
CAPTIONS = "captions.md"


def drawings(calibration: Calibration) -> tuple[Drawing, ...]:
    """The figures that apply to a calibration, in a report's order; none is drawn yet.

    Args:
        calibration: The calibration.
    """
    c = calibration
    lengths = bool(np.any(c.used[:, :3]))
    wanted = (
        (True, _points),
        (lengths, _curves),
        (lengths, _by_pose),
        (has_angles(c), _orientation_by_pose),
        (has_axes(c), _by_axis),
        (has_angles(c), _orientation_by_axis),
        (True, _histogram),
        (has_parts(c), _joints),
        (len(c.solution.history) > 0, _convergence),
        (len(shown_parameters(c)) > 0, _changes),
        (len(correlation_indices(c)) > 1, _correlations),
        (c.observability.columns > 0, _singular_values),
        (len(c.candidates) > 0, _candidates),
        (True, _uncertainty),
    )
    return tuple(make(c) for applies, make in wanted if applies)


def write_figures(
    calibration: Calibration,
    folder: str | Path,
    *,
    kind: str = "png",
    overwrite: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Path, ...]:
    """Write every figure into a folder, which is made if it is missing, and their captions as `CAPTIONS`.

    Args:
        calibration: The calibration.
        folder: Where to.
        kind: ``"png"``, ``"svg"`` or ``"pdf"``.
        overwrite: Whether files that exist may be replaced.
        progress: Called after each figure with the number done and that of all.

    Returns:
        The figures' files, in the order of `drawings`.

    Raises:
        FileError: Another kind, or a file exists or cannot be written; what exists is found before anything is drawn.
    """
    check_kind(kind)
    made = drawings(calibration)
    *paths, captions = figure_files(made, make_folder(folder), kind)
    if not overwrite:
        check_free([*paths, captions])
    for done, (drawing, path) in enumerate(zip(made, paths, strict=True), start=1):
        write_atomically(path, rendered(drawing, kind), overwrite=overwrite)
        if progress is not None:
            progress(done, len(made))
    write_atomically(captions, _captions(made, kind).encode(), overwrite=overwrite)
    return tuple(paths)


def figure_files(made: Sequence[Drawing], folder: Path, kind: str) -> tuple[Path, ...]:
    """The files of figures, in their order, and that of their captions.

    Args:
        made: The figures.
        folder: Where they are.
        kind: One of `KINDS`.
    """
    return (*(folder / f"{drawing.name}.{kind}" for drawing in made), folder / CAPTIONS)


def _captions(made: Sequence[Drawing], kind: str) -> str:
    """Markdown: of each figure its file, its title and its caption."""
    parts = ["# Captions of the figures"]
    for drawing in made:
        parts += [
            f"## {escaped(f'{drawing.name}.{kind}')}",
            f"**{escaped(drawing.title)}.** {escaped(drawing.caption)}",
        ]
    return "\n\n".join(parts) + "\n"


def check_free(paths: Sequence[Path]) -> None:
    """Refuse to write over figures.

    Raises:
        FileError: One of the files exists.
    """
    there = [path for path in paths if path.exists()]
    if there:
        message = (
            f"'{there[0]}' exists already; add --force (overwrite=True) or choose another folder"
        )
        raise FileError(message)


def _points(c: Calibration) -> Drawing:
    """Points in space."""
    _, seen = measured_places(c)
    title, what, more = "Measured points", f"The {counted(c)}", ""
    if not np.any(seen):
        title = "Predicted points"
        what = f"Where the calibrated robot predicts the target at the {counted(c)}, which measure no position,"
    elif not np.all(seen):
        title = "Measured and predicted points"
        more = " Rows that measure no position are where the calibrated robot predicts them."
    return Drawing(
        "points",
        title,
        f"{what} in the base frame, [mm]: in space, and seen from three sides, all three at one scale.{more}"
        f"{numbers_words(c)}{thin_words(c, MOST_POINTS)}",
        in_style(points_figure, c),
    )


def _curves(c: Calibration) -> Drawing:
    """Error curves."""
    word, mask, _, _ = curve_rows(c)
    rows = rows_text(mask, "validation" if word == "validation" else "estimation")
    which = {
        "validation": f"the {rows}, which the fit has not seen",
        "left-out": f"the {rows}, each predicted by fits that have not seen it",
        "estimation": f"the {rows}, which the fit has seen",
    }[word]
    axes, lengths = has_axes(c, mask), np.any(np.sum(c.used[mask, :3], axis=1) == 1)
    what = "Errors along x, y and z and their size" if axes else "Errors of the lengths"
    more = " Rows that measure a length have the size alone." if axes and lengths else ""
    return Drawing(
        "error-curves",
        "Errors before and after calibration",
        f"{what}, measured minus predicted, [mm], on {which}: by the nominal robot (dashed) and by the calibrated one "
        f"(solid).{more}",
        in_style(curves_figure, c),
    )


def _by_pose(c: Calibration) -> Drawing:
    """Position errors by pose."""
    what = "Size of the position error" if has_axes(c) else "Size of the error of the length"
    return Drawing(
        "errors-by-pose",
        "Position error by row" if has_axes(c) else "Error of the length by row",
        f"{what} of all rows, {counted(c)}{shading_words(c)}, in the order of the table, [mm]: before and "
        f"after calibration above, after it alone below.{left_out_words(c)}{edge_words(c)}",
        in_style(by_pose_figure, c),
    )


def _orientation_by_pose(c: Calibration) -> Drawing:
    """Orientation errors by pose."""
    return Drawing(
        "orientation-errors-by-pose",
        "Orientation error by row",
        "Angle between measured and predicted orientation of all rows that measure one, of "
        f"{counted(c)}{shading_words(c)}, in the order of the table, [deg]: before and after calibration above, after "
        f"it alone below.{left_out_words(c)}{edge_words(c)}",
        in_style(by_pose_figure, c, angle=True),
    )


def _by_axis(c: Calibration) -> Drawing:
    """Errors by axis."""
    return Drawing(
        "errors-by-axis",
        "Position error by axis",
        f"Errors along the axes of the measurement frame, measured minus predicted, [mm], of {counted(c)}. "
        f"{box_words(c)}",
        in_style(by_axis_figure, c),
    )


def _orientation_by_axis(c: Calibration) -> Drawing:
    """Orientation errors by axis."""
    return Drawing(
        "orientation-errors-by-axis",
        "Orientation error by axis",
        f"Errors about the axes of the measurement frame, measured minus predicted, [deg], of the rows of {counted(c)} "
        f"that measure an orientation. {box_words(c)}",
        in_style(by_axis_figure, c, angle=True),
    )


def _joints(c: Calibration) -> Drawing:
    """Residual by joint."""
    without = " without outliers" if has_flagged(c) else ""
    mean = (
        f" Line and band: mean of the estimation rows{without} over runs of neighbouring joint values, ± 2 standard "
        "errors."
        if has_mean(c)
        else ""
    )
    shape = "A slope or a wave of the mean" if mean else "A slope or a wave"
    return Drawing(
        "residual-by-joint",
        "What is left over against each joint's value",
        "The part of each row's error after calibration that lies along the joint's motion of the target, [mm], "
        f"against the joint's value, [deg] or [mm], of {counted(c)}.{thin_words(c, MOST_ROWS)}{mean}{edge_words(c)} "
        f"{shape} is an error of that joint that the model lacks, such as of its gear.",
        in_style(joints_figure, c),
    )


def _histogram(c: Calibration) -> Drawing:
    """Histograms."""
    return Drawing(
        "histograms",
        "How often which error occurs",
        f"Left: size of the error of all rows, {counted(c)}, before and after, on a logarithmic scale. Right: each "
        "number that was measured in the estimation rows, less what the calibrated robot predicts, over its estimated "
        "noise; if the model is complete, it follows the normal distribution.",
        in_style(histogram_figure, c),
    )


def _convergence(c: Calibration) -> Drawing:
    """Convergence."""
    damped = any(one.mu > 0.0 for one in c.solution.history)
    what = "Cost, length of the step and damping" if damped else "Cost and length of the step"
    broken = " Lines are broken where weights and noise were set anew." if stage_starts(c) else ""
    return Drawing(
        "convergence",
        "Convergence of the solver",
        f"{what} over the {c.solution.iterations} iterations of the solver '{c.solver}' on the "
        f"{rows_text(c.measurements.estimation, 'estimation')}, on logarithmic scales.{broken}",
        in_style(convergence_figure, c),
    )


def _changes(c: Calibration) -> Drawing:
    """Changes of parameters."""
    none = len(errorless(c))
    kept = (
        f" {none} parameter{'s' * (none != 1)} of kinds of which no errors were found stayed nominal, without an "
        "interval, and are not shown."
        if none
        else ""
    )
    return Drawing(
        "parameter-changes",
        "Changes of the parameters",
        f"Change of each parameter from its nominal value with its 95 % interval, estimated from "
        f"{rows_text(c.measurements.estimation, 'estimation')}. An interval that does not reach the dashed line "
        f"is a change that the data show.{kept}",
        in_style(changes_figure, c),
    )


def _correlations(c: Calibration) -> Drawing:
    """Correlations."""
    return Drawing(
        "correlations",
        "Correlations of the parameters",
        "Correlation of each pair of the parameters that the measurements determine, from the covariance of the fit to "
        "the estimation rows. The area of a square is the size of the correlation. Pairs near ±1 are known together "
        "better than apart.",
        in_style(correlations_figure, c),
    )


def _singular_values(c: Calibration) -> Drawing:
    """Singular values."""
    o = c.observability
    return Drawing(
        "singular-values",
        "What the poses determine",
        f"Singular values of the Jacobian at the estimation rows: how far all points together move for a step of 1 mm "
        f"and 1 mrad along each of {o.columns} combinations of parameters, [mm]. Rank {o.rank}; values too small for "
        "the scale stand at its foot. The dashed line is the smallest that counts.",
        in_style(singular_values_figure, c),
    )


def _candidates(c: Calibration) -> Drawing:
    """The ladder of models."""
    errors = c.candidates[0].cross_validation.errors_without_outliers
    return Drawing(
        "candidates",
        "Models tried",
        "Each model that was tried, with its number of parameters. Left: rms of the error of the "
        f"{errors.n or errors.n_angle:,} estimation rows that had a weight when the models were compared, each "
        "predicted by a linearised fit without it; errors elsewhere are those of whole fits. Right: restricted "
        "log likelihood, less that of the best; a larger model must gain "
        f"{c.candidates[0].needed:.1f} over a smaller one to be chosen.",
        in_style(candidates_figure, c),
    )


def _uncertainty(c: Calibration) -> Drawing:
    """Uncertainty over the workspace."""
    whose = "calibrated robot's" if c.larger is None else "corrected URDF's"
    return Drawing(
        "workspace-uncertainty",
        "Uncertainty over the workspace",
        f"Standard deviation of the {whose} predicted position over {POSES:,} poses spread over the joint "
        "limits, from the covariance of the parameters, [mm]: root mean square of the poses in each cell, in the base "
        f"frame seen from three sides. The rms over the joint limits is that of the first {SPREAD} of these poses. "
        "It knows nothing of errors that the model lacks.",
        in_style(uncertainty_figure, c),
    )
