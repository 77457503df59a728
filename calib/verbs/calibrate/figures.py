"""The figures of a calibration, for reports and papers: PNG, SVG or PDF, readable in print and with any colour vision.

`FIGURES` is the one list of them. `drawings` gives those that apply to a calibration, `calib.show.plotting.render`
makes a file of one, `write_figures` writes all and their captions beside them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import yaml

import calib.verbs.calibrate.figure_budget as budget
import calib.verbs.calibrate.figure_coverage as coverage
import calib.verbs.calibrate.figure_errors as errors
import calib.verbs.calibrate.figure_images as images
import calib.verbs.calibrate.figure_joints as joints
import calib.verbs.calibrate.figure_model as model
import calib.verbs.calibrate.figure_space as space
from calib.basics.files import make_folder, write_atomically
from calib.errors import CalibError, FileError, choices, did_you_mean
from calib.result.calibration import Calibration
from calib.robot.ranges import SPREAD
from calib.show.blocks import Drawing
from calib.show.look import rows_text
from calib.show.plotting import render, require_matplotlib, styled
from calib.verbs.calibrate.seen_corners import image_rows

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Name of the file of the captions, beside the figures.
CAPTIONS = "captions.md"

#: Kind of the rows of the error curves, and how the fit relates to them; see `calib.verbs.calibrate.figure_errors`.
_CURVE_ROWS = {
    "validation": ("validation", "which took no part in the fit"),
    "held-out": ("estimation", "each predicted by a fit without it"),
    "estimation": ("estimation", "which the fit used"),
}


class FigureKind(NamedTuple):
    """A kind of figure; ``captions.yaml`` has section, title and caption under its name."""

    #: Draws it
    draw: Callable[[Calibration], Figure]
    #: Returns whether a calibration has it
    applies: Callable[[Calibration], bool]


def _measures(unit: str) -> Callable[[Calibration], bool]:
    """Return a test of calibrations: whether any row measures something in a unit, such as ``"m"``."""
    return lambda c: unit in c.rows.channels.present


def _has_vectors(unit: str) -> Callable[[Calibration], bool]:
    """Return a test of calibrations: whether any row measures a position (``"m"``) or an orientation (``"rad"``)."""
    return lambda c: bool(np.any(c.rows.channels.vector_columns(unit)[1]))


def _has_images(c: Calibration) -> bool:
    """Return whether any row of a calibration is the image of a corner."""
    return bool(np.any(image_rows(c)))


def _always(_: Calibration) -> bool:
    """Return True: every calibration has the figure."""
    return True


#: The figures by name, in a report's order.
FIGURES: dict[str, FigureKind] = {
    "points": FigureKind(space.points, _always),
    "error-curves": FigureKind(errors.curves, _measures("m")),
    "errors-by-pose": FigureKind(errors.by_row, _measures("m")),
    "orientation-errors-by-pose": FigureKind(partial(errors.by_row, unit="rad"), _measures("rad")),
    "image-errors-by-pose": FigureKind(partial(errors.by_row, unit="px"), _measures("px")),
    "image-residuals": FigureKind(images.over_image, _has_images),
    "images": FigureKind(images.by_image, _has_images),
    "board-corners": FigureKind(images.board_corners, _has_images),
    "errors-by-axis": FigureKind(errors.by_axis, _has_vectors("m")),
    "orientation-errors-by-axis": FigureKind(
        partial(errors.by_axis, unit="rad"), _has_vectors("rad")
    ),
    "histograms": FigureKind(errors.histograms, _always),
    "residual-by-joint": FigureKind(
        joints.residuals_by_joint, lambda c: bool(np.any(joints.has_joint_parts(c)))
    ),
    "image-coverage": FigureKind(coverage.image_coverage, _has_images),
    "joint-coverage": FigureKind(coverage.joint_coverage, _has_images),
    "convergence": FigureKind(model.convergence, lambda c: bool(c.method.solution.history)),
    "parameter-changes": FigureKind(model.changes, lambda c: bool(model.changed_parameters(c))),
    "correlations": FigureKind(model.correlations, lambda c: len(model.correlation_indices(c)) > 1),
    "singular-values": FigureKind(
        model.singular_values, lambda c: c.trust.observability.columns > 0
    ),
    "candidates": FigureKind(model.candidates, lambda c: bool(c.method.candidates)),
    "uncertainty-budget": FigureKind(budget.shares, lambda c: not c.unknown_accuracy),
    "workspace-uncertainty": FigureKind(space.uncertainty, lambda c: not c.unknown_accuracy),
}


def drawings(calibration: Calibration) -> tuple[Drawing, ...]:
    """Return the figures that apply to a calibration, in a report's order; none is drawn yet."""
    captions = _captions()
    # The texts that captions name in braces.
    m = calibration.fit.measurements
    estimation = rows_text(m.estimation, "estimation")
    rows = estimation
    if np.any(m.validation):
        rows = f"{estimation} and {rows_text(m.validation, 'validation')}"
    curves = errors.curve_rows(calibration)
    rows_kind, relation = _CURVE_ROWS[curves.name]
    words: dict[str, object] = {
        "c": calibration,
        "rows": rows,
        "estimation": estimation,
        "poses": f"{space.POSES:,}",
        "spread": str(SPREAD),
        "curve_rows": f"the {rows_text(curves.mask, rows_kind)}, {relation}",
    }
    tried = calibration.method.candidates
    if tried:
        held_out = tried[0].cross_validation.errors_without_outliers
        words["compared"] = f"{held_out.leading.n:,}"

    made = []
    for name, kind in FIGURES.items():
        if kind.applies(calibration):
            entry = captions[name]
            caption = entry["caption"].format(**words)
            draw = partial(kind.draw, calibration)
            made.append(Drawing(name, entry["section"], entry["title"], caption, draw))
    return tuple(made)


def figure_of(calibration: Calibration, name: str) -> Figure:
    """Draw a figure of a calibration by its name, see `Calibration.plot`."""
    made = {drawing.name: drawing for drawing in drawings(calibration)}
    if name not in made:
        fault = "There is no figure" if name not in FIGURES else "This result has no figure"
        raise CalibError(
            f"{fault} '{name}'{did_you_mean(name, made)}; it has {choices(made, limit=len(made))}."
        )
    require_matplotlib("A figure")
    with styled():
        figure: Figure = made[name].draw()
    return figure


@cache
def _captions() -> Mapping[str, Mapping[str, str]]:
    """Return section, title and caption of each figure, by its name and these words."""
    entries: Mapping[str, Mapping[str, str]] = yaml.safe_load(
        (Path(__file__).parent / "captions.yaml").read_text("utf-8")
    )
    return entries


def write_figures(
    calibration: Calibration,
    folder: str | Path,
    *,
    kind: str = "png",
    overwrite: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Path, ...]:
    """Write every figure of a calibration into a folder, and their captions as `CAPTIONS`.

    Args:
        calibration: The result.
        folder: The folder; made if it is missing.
        kind: One of `calib.show.plotting.KINDS`.
        overwrite: Replace existing files.
        progress: Called after each figure with the number done and that of all.

    Returns:
        The figures' files, in a report's order.

    Raises:
        CalibError: Matplotlib is missing, which draws the figures.
        FileError: Another kind, or a file exists or cannot be written; an existing file is found before anything is
            drawn.
    """
    require_matplotlib("A figure")
    made = drawings(calibration)
    *paths, captions = figure_files(made, make_folder(folder), kind, overwrite=overwrite)
    for done, (drawing, path) in enumerate(zip(made, paths, strict=True), start=1):
        write_atomically(path, render(drawing, kind), overwrite=overwrite)
        if progress is not None:
            progress(done, len(made))
    entries = [
        f"## {drawing.name}.{kind}\n\n**{drawing.title}.** {drawing.caption}" for drawing in made
    ]
    text = "\n\n".join(["# Captions of the figures", *entries]) + "\n"
    write_atomically(captions, text.encode(), overwrite=overwrite)
    return tuple(paths)


def figure_files(
    made: Sequence[Drawing],
    folder: Path,
    kind: str,
    *,
    overwrite: bool = False,
) -> tuple[Path, ...]:
    """Return the files that `write_figures` writes: the figures', in their order, and that of their captions.

    Args:
        made: The figures.
        folder: The folder.
        kind: Kind of the figures' files.
        overwrite: Existing files will be replaced.

    Raises:
        FileError: A file exists and is not to be replaced.
    """
    paths = (*(folder / f"{drawing.name}.{kind}" for drawing in made), folder / CAPTIONS)
    for path in paths:
        if path.exists() and not overwrite:
            raise FileError(f"{path} exists already; add --force or choose another folder.")
    return paths
