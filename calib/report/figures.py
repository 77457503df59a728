"""The figures of a calibration, for reports and papers: PNG, SVG or PDF, readable in print and with any colour vision.

`FIGURES` is the one list of them. `drawings` gives those that apply to a calibration, `rendered` makes a file of one,
`write_figures` writes all and what they show beside them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calib.errors import FileError
from calib.files import make_folder, write_atomically
from calib.report import (
    figure_errors as figure_errors,
    figure_model as figure_model,
    figure_space as figure_space,
)
from calib.report.figure_base import (
    KINDS,
    WIDTH,
    check_kind,
    has_axes,
    rows_text,
    saved,
    styled,
)
from calib.result.calibration import Calibration
from calib.robot.readback import SPREAD

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["CAPTIONS", "FIGURES", "KINDS", "Drawing", "drawings", "rendered", "write_figures"]

#: The file of the captions, beside the figures.
CAPTIONS = "captions.md"


def _always(_: Calibration) -> bool:
    """For a figure of every calibration."""
    return True


def _lengths(c: Calibration) -> bool:
    """Whether any row measures a length or a position."""
    return bool(np.any(c.used[:, :3]))


def _angles(c: Calibration) -> bool:
    """Whether any row measures an orientation."""
    return bool(np.any(c.used[:, 3:]))


_EDGE = "Outliers beyond the scale stand at its edge."
_BY_ROW = (
    "of all rows, {rows} (shaded: validation), in the order of the table, [{unit}]: before and after calibration "
    f"above, after it alone below. Dashes: rows predicted by fits that have not seen them. {_EDGE}"
)
_BY_AXIS = (
    "the axes of the measurement frame, measured minus predicted, [{unit}], of {rows}. Above, both robots; below, the "
    "calibrated one alone, without outliers. Boxes hold the middle half of the rows and their median; whiskers reach "
    "from 5 to 95 %; dots are single rows, or the least and the largest of many."
)

#: The figures, in a report's order: the stem of the file, where in the report it stands, the title, the caption with
#: the words of `_words`, what draws it, and whether a calibration has what it shows.
FIGURES: tuple[
    tuple[str, str, str, str, Callable[[Calibration], Figure], Callable[[Calibration], bool]], ...
] = (
    (
        "points",
        "errors",
        "Points of the target",
        "Where the target was at the {rows}, in the base frame, [mm]: in space, and seen from three sides, all at one "
        "scale. Rows that measure no position are where the calibrated robot predicts them. Of more than "
        f"{figure_space.MOST_ROWS:,} rows of a kind some are drawn, evenly spread.",
        figure_space.points,
        _always,
    ),
    (
        "error-curves",
        "errors",
        "Errors before and after calibration",
        "Errors along x, y and z and their size, or the error of the length where a row measures one, measured minus "
        "predicted, [mm], on {curve_rows}: by the nominal robot (dashed) and by the calibrated one (solid).",
        figure_errors.curves,
        _lengths,
    ),
    (
        "errors-by-pose",
        "errors",
        "Error by row",
        "Size of the error of the position, or of the length, " + _BY_ROW.replace("{unit}", "mm"),
        figure_errors.by_row,
        _lengths,
    ),
    (
        "orientation-errors-by-pose",
        "errors",
        "Orientation error by row",
        "Angle between measured and predicted orientation " + _BY_ROW.replace("{unit}", "deg"),
        partial(figure_errors.by_row, turned=True),
        _angles,
    ),
    (
        "errors-by-axis",
        "errors",
        "Position error by axis",
        "Errors along " + _BY_AXIS.replace("{unit}", "mm"),
        figure_errors.by_axis,
        has_axes,
    ),
    (
        "orientation-errors-by-axis",
        "errors",
        "Orientation error by axis",
        "Errors about " + _BY_AXIS.replace("{unit}", "deg"),
        partial(figure_errors.by_axis, turned=True),
        _angles,
    ),
    (
        "histograms",
        "errors",
        "How often which error occurs",
        "Left: size of the error of all rows, {rows}, before and after, on a logarithmic scale. Right: each number "
        "that was measured in the estimation rows, less what the calibrated robot predicts, over its estimated noise; "
        "if the model is complete, it follows the normal distribution.",
        figure_errors.histograms,
        _always,
    ),
    (
        "residual-by-joint",
        "errors",
        "What is left over against each joint's value",
        "The part of each row's error after calibration that lies along the joint's motion of the target, [mm], "
        "against the joint's value, [deg] or [mm], of {rows}. Line and band: mean of the estimation rows without "
        f"outliers over runs of neighbouring joint values, ± 2 standard errors. {_EDGE} A slope or a wave is an error "
        "of that joint that the model lacks, such as of its gear.",
        figure_space.joints,
        lambda c: bool(np.any(figure_space.drawn_rows(c))),
    ),
    (
        "convergence",
        "method",
        "Convergence of the solver",
        "Cost, length of the step and, where there is one, damping over the {iterations} iterations of the solver "
        "'{solver}' on the {estimation}, on logarithmic scales. Lines are broken where weights and noise were set "
        "anew.",
        figure_model.convergence,
        lambda c: len(c.solution.history) > 0,
    ),
    (
        "parameter-changes",
        "parameters",
        "Changes of the parameters",
        "Change of each parameter from its nominal value with its 95 % interval, estimated from {estimation}. An "
        "interval that does not reach the dashed line is a change that the data show. Parameters of kinds of which no "
        "errors were found stayed nominal and are not shown.",
        figure_model.changes,
        lambda c: len(figure_model.shown_parameters(c)) > 0,
    ),
    (
        "correlations",
        "parameters",
        "Correlations of the parameters",
        "Correlation of each pair of the parameters that the measurements determine, from the covariance of the fit to "
        "the estimation rows. The area of a square is the size of the correlation. Pairs near ±1 are known together "
        "better than apart.",
        figure_model.correlations,
        lambda c: len(figure_model.correlation_indices(c)) > 1,
    ),
    (
        "singular-values",
        "unknown",
        "What the poses determine",
        "Singular values of the Jacobian at the estimation rows: how far all points together move for a step of 1 mm "
        "and 1 mrad along each of {columns} combinations of parameters, [mm]. Rank {rank}; values too small for the "
        "scale stand at its foot. The dashed line is the smallest that counts.",
        figure_model.singular_values,
        lambda c: c.observability.columns > 0,
    ),
    (
        "candidates",
        "candidates",
        "Models tried",
        "Each model that was tried, with its number of parameters. Left: rms of the error of the {compared} estimation "
        "rows that had a weight when the models were compared, each predicted by a linearised fit without it; errors "
        "elsewhere are those of whole fits. Right: restricted log likelihood, less that of the best; a larger model "
        "must gain {needed} over a smaller one to be chosen.",
        figure_model.candidates,
        lambda c: len(c.candidates) > 0,
    ),
    (
        "workspace-uncertainty",
        "unknown",
        "Uncertainty over the workspace",
        "Standard deviation of the predicted position of the corrected URDF over "
        f"{figure_space.POSES:,} poses spread over the joint limits, from the covariance of the parameters, [mm]: root "
        "mean square of the poses in each cell, in the base frame seen from three sides. The rms over the joint limits "
        f"is that of the first {SPREAD} of these poses. It knows nothing of errors that the model lacks.",
        figure_space.uncertainty,
        _always,
    ),
)


@dataclass(frozen=True, slots=True, eq=False)
class Drawing:
    """A figure of a calibration, drawn where it is needed.

    Attributes:
        name: Its key and the stem of its file, such as ``"errors-by-pose"``.
        section: Where in the report it stands: with the errors, the parameters, what the measurements do not tell, the
            models tried or the method.
        title: Plain text.
        caption: What is shown, on which rows, in which units, and how to read it; plain text.
        draw: Draws it, anew at each call; `rendered` makes a file of it.
    """

    name: str
    section: str
    title: str
    caption: str
    draw: Callable[[], Figure]


def drawings(calibration: Calibration) -> tuple[Drawing, ...]:
    """The figures that apply to a calibration, in a report's order; none is drawn yet."""
    words = _words(calibration)

    def drawn(draw: Callable[[Calibration], Figure]) -> Figure:
        with styled():
            return draw(calibration)

    return tuple(
        Drawing(name, section, title, caption.format(**words), partial(drawn, draw))
        for name, section, title, caption, draw, applies in FIGURES
        if applies(calibration)
    )


def rendered(drawing: Drawing, kind: str = "png") -> bytes:
    """A figure as a file of one of `KINDS`: the same figure is the same bytes.

    Raises:
        FileError: Another kind.
    """
    return rendered_with_width(drawing, kind)[0]


def rendered_with_width(drawing: Drawing, kind: str) -> tuple[bytes, float]:
    """A figure as a file, and its width as a part of that of the widest."""
    check_kind(kind)
    with styled():
        figure = drawing.draw()
        data = saved(figure, kind, drawing.title, drawing.caption)
        return data, float(figure.get_figwidth()) / WIDTH


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
    parts = [f"## {one.name}.{kind}\n\n**{one.title}.** {one.caption}" for one in made]
    text = "\n\n".join(["# Captions of the figures", *parts]) + "\n"
    write_atomically(captions, text.encode(), overwrite=overwrite)
    return tuple(paths)


def figure_files(made: Sequence[Drawing], folder: Path, kind: str) -> tuple[Path, ...]:
    """The files of figures, in their order, and that of their captions."""
    return (*(folder / f"{drawing.name}.{kind}" for drawing in made), folder / CAPTIONS)


def check_free(paths: Sequence[Path]) -> None:
    """Refuse to write over figures.

    Raises:
        FileError: One of the files exists.
    """
    for path in paths:
        if path.exists():
            raise FileError(f"{path} exists already; add --force or choose another folder.")


def _words(c: Calibration) -> dict[str, str]:
    """What captions say of a calibration."""
    m = c.measurements
    estimation = rows_text(m.estimation, "estimation")
    counted = [rows_text(m.validation, "validation")] * bool(np.any(m.validation))
    word, mask, _, _ = figure_errors.curve_rows(c)
    kind, seen = {
        "validation": ("validation", "which the fit has not seen"),
        "left-out": ("estimation", "each predicted by fits that have not seen it"),
        "estimation": ("estimation", "which the fit has seen"),
    }[word]
    words = {
        "rows": " and ".join([estimation, *counted]),
        "estimation": estimation,
        "curve_rows": f"the {rows_text(mask, kind)}, {seen}",
        "iterations": str(c.solution.iterations),
        "solver": c.solver,
        "columns": str(c.observability.columns),
        "rank": str(c.observability.rank),
    }
    if c.candidates:
        errors = c.candidates[0].cross_validation.errors_without_outliers
        words["compared"] = f"{errors.n or errors.n_angle:,}"
        words["needed"] = f"{c.candidates[0].needed:.1f}"
    return words
