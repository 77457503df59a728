"""The figures of a calibration, for reports and papers: PNG, SVG or PDF, readable in print and with any colour vision.

`FIGURES` is the one list of them. `drawings` gives those that apply to a calibration, `rendered` makes a file of
one, `write_figures` writes all and what they show beside them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

import calib.report.figure_errors as errors
import calib.report.figure_model as model
import calib.report.figure_space as space
from calib.errors import FileError
from calib.files import make_folder, write_atomically
from calib.report.figure_base import check_kind, rows_text, saved, styled
from calib.result.calibration import Calibration
from calib.robot.readback import SPREAD

#: The file of the captions, beside the figures.
CAPTIONS = "captions.md"


class Drawing(NamedTuple):
    """A figure: its name, which is its file's, its section of the report, what it shows, and what draws it anew."""

    name: str
    section: str
    title: str
    caption: str
    draw: Callable[..., Figure]
    applies: Callable[[Calibration], Any] = lambda _: True


_EDGE = "Outliers beyond the scale stand at its edge."
_BY_ROW = (
    "{rows}, in the order of the table, [%s]: before and after calibration above, after it alone below. Dashes: rows "
    f"predicted by fits that have not seen them. {_EDGE}"
)
_BY_AXIS = (
    "the axes of the measurement frame, measured minus predicted, [%s], of {rows}. Above, both robots; below, the "
    "calibrated one alone, without outliers. Boxes hold the middle half of the rows and their median; whiskers reach "
    "from 5 to 95 %%."
)

#: The figures, in a report's order. Words in braces are those of `_words`, and the calibration.
FIGURES: tuple[Drawing, ...] = (
    Drawing(
        "points",
        "errors",
        "Points of the target",
        "Where the target was at the {rows}, in the base frame, [mm]: in space, and seen from three sides. Rows that "
        "measure no position are where the calibrated robot predicts them.",
        space.points,
    ),
    Drawing(
        "error-curves",
        "errors",
        "Errors before and after calibration",
        "Errors along x, y and z and their size, or the error of the length where a row measures one, measured minus "
        "predicted, [mm], on {curve_rows}: by the nominal robot (dashed) and by the calibrated one (solid).",
        errors.curves,
        lambda c: np.any(c.used[:, :3]),
    ),
    Drawing(
        "errors-by-pose",
        "errors",
        "Error by row",
        "Size of the error of the position, or of the length, of all rows, " + _BY_ROW % "mm",
        errors.by_row,
        lambda c: np.any(c.used[:, :3]),
    ),
    Drawing(
        "orientation-errors-by-pose",
        "errors",
        "Orientation error by row",
        "Angle between measured and predicted orientation of all rows, " + _BY_ROW % "deg",
        partial(errors.by_row, what=errors.ANGLE),
        lambda c: np.any(c.used[:, 3:]),
    ),
    Drawing(
        "errors-by-axis",
        "errors",
        "Position error by axis",
        "Errors along " + _BY_AXIS % "mm",
        errors.by_axis,
        errors.has_axes,
    ),
    Drawing(
        "orientation-errors-by-axis",
        "errors",
        "Orientation error by axis",
        "Errors about " + _BY_AXIS % "deg",
        partial(errors.by_axis, what=errors.ANGLE),
        lambda c: np.any(c.used[:, 3:]),
    ),
    Drawing(
        "histograms",
        "errors",
        "How often which error occurs",
        "Left: size of the error of all rows, {rows}, before and after, on a logarithmic scale. Right: each number "
        "that was measured in the estimation rows, less what the calibrated robot predicts, over its estimated noise; "
        "if the model is complete, it follows the normal distribution.",
        errors.histograms,
    ),
    Drawing(
        "residual-by-joint",
        "errors",
        "Residuals against each joint's value",
        "The part of each row's error after calibration that lies along the joint's motion of the target, [mm], "
        "against the joint's value, [deg] or [mm], of {rows}. Line and band: mean of the estimation rows without "
        f"outliers over runs of neighbouring joint values, ± 2 standard errors. {_EDGE} A slope or a wave is an error "
        "of that joint that the model lacks, such as of its gear.",
        errors.joints,
        lambda c: np.any(errors.tells_of_joints(c)),
    ),
    Drawing(
        "convergence",
        "method",
        "Convergence of the solver",
        "Cost, length of the step and, where there is one, damping over the {c.solution.iterations} iterations of the "
        "solver '{c.solver}' on the {estimation}, on logarithmic scales. The cost jumps where weights and noise are "
        "set anew.",
        model.convergence,
        lambda c: c.solution.history,
    ),
    Drawing(
        "parameter-changes",
        "parameters",
        "Changes of the parameters",
        "Change of each parameter from its nominal value with its 95 % interval, estimated from {estimation}. An "
        "interval that does not reach the dashed line is a change that the data show. Parameters of kinds of which no "
        "errors were found stayed nominal and are not shown.",
        model.changes,
        model.shown_parameters,
    ),
    Drawing(
        "correlations",
        "parameters",
        "Correlations of the parameters",
        "Correlation of each pair of the parameters that the measurements determine, from the covariance of the fit "
        "to the estimation rows. Pairs near ±1 are known together better than apart.",
        model.correlations,
        lambda c: len(model.correlation_indices(c)) > 1,
    ),
    Drawing(
        "singular-values",
        "unknown",
        "What the poses determine",
        "Singular values of the Jacobian at the estimation rows: how far all points together move for a step of 1 mm "
        "and 1 mrad along each of {c.observability.columns} combinations of parameters, [mm]. Rank "
        "{c.observability.rank}; values too small for the scale stand at its foot. The dashed line is the smallest "
        "that counts.",
        model.singular_values,
        lambda c: c.observability.columns,
    ),
    Drawing(
        "candidates",
        "candidates",
        "Models tried",
        "Each model that was tried, with its number of parameters. Left: rms of the error of the {compared} "
        "estimation rows that had a weight when the models were compared, each predicted by a linearised fit without "
        "it; errors elsewhere are those of whole fits. Right: restricted log likelihood, less that of the best; a "
        "larger model must gain {needed} over a smaller one to be chosen.",
        model.candidates,
        lambda c: c.candidates,
    ),
    Drawing(
        "workspace-uncertainty",
        "unknown",
        "Uncertainty over the workspace",
        "Standard deviation of the predicted position of the corrected URDF over "
        f"{space.POSES:,} poses spread over the joint limits, from the covariance of the parameters, [mm]: root mean "
        "square of the poses in each cell, in the base frame seen from three sides. The rms over the joint limits is "
        f"that of the first {SPREAD} of these poses. It knows nothing of errors that the model lacks.",
        space.uncertainty,
    ),
)


def drawings(calibration: Calibration) -> tuple[Drawing, ...]:
    """The figures that apply to a calibration, in a report's order; none is drawn yet."""
    words = {"c": calibration, **_words(calibration)}
    return tuple(
        one._replace(caption=one.caption.format(**words), draw=partial(one.draw, calibration))
        for one in FIGURES
        if one.applies(calibration)
    )


def rendered(drawing: Drawing, kind: str = "png") -> bytes:
    """A figure as a file of one of `KINDS`: the same figure is the same bytes."""
    check_kind(kind)
    with styled():
        return saved(drawing.draw(), kind, drawing.title, drawing.caption)


def write_figures(
    calibration: Calibration,
    folder: str | Path,
    *,
    kind: str = "png",
    overwrite: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Path, ...]:
    """Write every figure into a folder, which is made if it is missing, and their captions as `CAPTIONS`.

    ``progress`` is called after each figure with the number done and that of all.

    Raises:
        FileError: Another kind, or a file exists or cannot be written; what exists is found before anything is drawn.
    """
    check_kind(kind)
    made = drawings(calibration)
    *paths, captions = figure_files(made, make_folder(folder), kind, overwrite=overwrite)
    for done, (drawing, path) in enumerate(zip(made, paths, strict=True), start=1):
        write_atomically(path, rendered(drawing, kind), overwrite=overwrite)
        if progress is not None:
            progress(done, len(made))
    parts = [f"## {one.name}.{kind}\n\n**{one.title}.** {one.caption}" for one in made]
    text = "\n\n".join(["# Captions of the figures", *parts]) + "\n"
    write_atomically(captions, text.encode(), overwrite=overwrite)
    return tuple(paths)


def figure_files(
    made: Sequence[Drawing], folder: Path, kind: str, *, overwrite: bool = False
) -> tuple[Path, ...]:
    """The files of figures, in their order, and that of their captions; `FileError` where one exists."""
    paths = (*(folder / f"{drawing.name}.{kind}" for drawing in made), folder / CAPTIONS)
    for path in paths:
        if path.exists() and not overwrite:
            raise FileError(f"{path} exists already; add --force or choose another folder.")
    return paths


def _words(c: Calibration) -> dict[str, str]:
    """What captions say of a calibration."""
    m = c.measurements
    estimation = rows_text(m.estimation, "estimation")
    validation = f" and {rows_text(m.validation, 'validation')}" * bool(np.any(m.validation))
    word, mask, _, _ = errors.curve_rows(c)
    kind, seen = {
        "validation": ("validation", "which the fit has not seen"),
        "left-out": ("estimation", "each predicted by fits that have not seen it"),
        "estimation": ("estimation", "which the fit has seen"),
    }[word]
    words = {
        "rows": estimation + validation,
        "estimation": estimation,
        "curve_rows": f"the {rows_text(mask, kind)}, {seen}",
    }
    if c.candidates:
        left_out = c.candidates[0].cross_validation.errors_without_outliers
        words["compared"] = f"{left_out.n or left_out.n_angle:,}"
        words["needed"] = f"{c.candidates[0].needed:.1f}"
    return words
