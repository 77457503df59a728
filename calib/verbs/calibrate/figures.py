"""The figures of a calibration, for reports and papers: PNG, SVG or PDF, readable in print and with any colour vision.

`FIGURES` is the one list of them. `drawings` gives those that apply to a calibration, `rendered` makes a file of
one, `write_figures` writes all and their captions beside them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml
from matplotlib.figure import Figure

import calib.verbs.calibrate.camera.board as board
import calib.verbs.calibrate.camera.coverage as coverage
import calib.verbs.calibrate.camera.residuals as images
import calib.verbs.calibrate.figure_errors as errors
import calib.verbs.calibrate.figure_joints as joints
import calib.verbs.calibrate.figure_model as model
import calib.verbs.calibrate.figure_space as space
from calib.basics.files import make_folder, write_atomically
from calib.errors import FileError
from calib.result.calibration import Calibration
from calib.robot.ranges import SPREAD
from calib.show.drawing import Drawing, rendered
from calib.show.figure_base import rows_text
from calib.verbs.calibrate.camera.of_calibration import has_images, joint_spans, seen_corners
from calib.verbs.calibrate.camera.seen_corners import SeenCorners

#: Name of the file of the captions, beside the figures.
CAPTIONS = "captions.md"

#: Kind of the rows of the error curves, and how the fit relates to them; see `curve_rows` of the figures of errors.
_CURVE_ROWS = {
    "validation": ("validation", "which took no part in the fit"),
    "held-out": ("estimation", "each predicted by a fit without it"),
    "estimation": ("estimation", "which the fit used"),
}


class FigureKind(NamedTuple):
    """A kind of figure; ``captions.yaml`` has section, title and caption under its name."""

    #: Draws it
    draw: Callable[[Calibration], Figure]
    #: Tells if a calibration has it
    applies: Callable[[Calibration], bool]


def _always(c: Calibration) -> bool:  # noqa: ARG001
    """Tell that every calibration has a figure."""
    return True


def _has_lengths(c: Calibration) -> bool:
    """Tell if any row measures a length or a position."""
    return "m" in c.rows.channels.present


def _has_angles(c: Calibration) -> bool:
    """Tell if any row measures an orientation or another angle."""
    return "rad" in c.rows.channels.present


def _has_pixels(c: Calibration) -> bool:
    """Tell if any row measures image coordinates."""
    return "px" in c.rows.channels.present


def _has_orientations(c: Calibration) -> bool:
    """Tell if any row measures a whole orientation."""
    _, are_vectors = c.rows.channels.vector_columns("rad")
    return bool(np.any(are_vectors))


def _has_joint_parts(c: Calibration) -> bool:
    """Tell if any residual has a part along joints' motions."""
    return bool(np.any(joints.has_joint_parts(c)))


def _has_iterations(c: Calibration) -> bool:
    """Tell if the solver made any step."""
    return bool(c.method.solution.history)


def _has_changes(c: Calibration) -> bool:
    """Tell if any parameter's change is shown."""
    return bool(model.shown_parameters(c))


def _has_correlations(c: Calibration) -> bool:
    """Tell if there is a pair of identifiable parameters."""
    return len(model.correlation_indices(c)) > 1


def _has_singular_values(c: Calibration) -> bool:
    """Tell if the Jacobian has any column."""
    return c.trust.observability.columns > 0


def _has_candidates(c: Calibration) -> bool:
    """Tell if several models were tried."""
    return bool(c.method.candidates)


def _of_cameras(draw: Callable[[Sequence[SeenCorners]], Figure]) -> FigureKind:
    """Make a figure of the corners that the cameras saw, for calibrations with images."""
    return FigureKind(lambda c: draw(seen_corners(c)), has_images)


def _joints_of_images(c: Calibration) -> Figure:
    """Draw the joints' ranges in the images."""
    return coverage.of_joints(joint_spans(c))


_angles_by_row = partial(errors.by_row, unit="rad")
_pixels_by_row = partial(errors.by_row, unit="px")
_orientations_by_axis = partial(errors.by_axis, unit="rad")

#: The figures by name, in a report's order.
FIGURES: dict[str, FigureKind] = {
    "points": FigureKind(space.points, _always),
    "error-curves": FigureKind(errors.curves, _has_lengths),
    "errors-by-pose": FigureKind(errors.by_row, _has_lengths),
    "orientation-errors-by-pose": FigureKind(_angles_by_row, _has_angles),
    "image-errors-by-pose": FigureKind(_pixels_by_row, _has_pixels),
    "image-residuals": _of_cameras(images.over_image),
    "images": _of_cameras(images.by_image),
    "board-corners": _of_cameras(board.corners),
    "errors-by-axis": FigureKind(errors.by_axis, errors.has_axes),
    "orientation-errors-by-axis": FigureKind(_orientations_by_axis, _has_orientations),
    "histograms": FigureKind(errors.histograms, _always),
    "residual-by-joint": FigureKind(joints.residuals_by_joint, _has_joint_parts),
    "image-coverage": _of_cameras(coverage.of_images),
    "joint-coverage": FigureKind(_joints_of_images, has_images),
    "convergence": FigureKind(model.convergence, _has_iterations),
    "parameter-changes": FigureKind(model.changes, _has_changes),
    "correlations": FigureKind(model.correlations, _has_correlations),
    "singular-values": FigureKind(model.singular_values, _has_singular_values),
    "candidates": FigureKind(model.candidates, _has_candidates),
    "workspace-uncertainty": FigureKind(space.uncertainty, _always),
}


def drawings(calibration: Calibration) -> tuple[Drawing, ...]:
    """Return the figures that apply to a calibration, in a report's order; none is drawn yet."""
    captions = yaml.safe_load((Path(__file__).parent / "captions.yaml").read_text("utf-8"))
    words = {"c": calibration, **_caption_words(calibration)}
    made = []
    for name, kind in FIGURES.items():
        if kind.applies(calibration):
            entry = captions[name]
            caption = entry["caption"].format(**words)
            draw = partial(kind.draw, calibration)
            made.append(Drawing(name, entry["section"], entry["title"], caption, draw))
    return tuple(made)


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
        kind: One of `calib.show.figure_base.KINDS`.
        overwrite: Replace existing files.
        progress: Called after each figure with the number done and that of all.

    Returns:
        The figures' files, in a report's order.

    Raises:
        FileError: Another kind, or a file exists or cannot be written; an existing file is found before anything is
            drawn.
    """
    made = drawings(calibration)
    *paths, captions = figure_files(made, make_folder(folder), kind, overwrite=overwrite)
    for done, (drawing, path) in enumerate(zip(made, paths, strict=True), start=1):
        write_atomically(path, rendered(drawing, kind), overwrite=overwrite)
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


def _caption_words(c: Calibration) -> dict[str, str]:
    """Return the texts that captions name in braces."""
    m = c.fit.measurements
    estimation = rows_text(m.estimation, "estimation")
    rows = estimation
    if np.any(m.validation):
        rows = f"{estimation} and {rows_text(m.validation, 'validation')}"
    shown = errors.curve_rows(c)
    kind, relation = _CURVE_ROWS[shown.name]
    words = {
        "rows": rows,
        "estimation": estimation,
        "poses": f"{space.POSES:,}",
        "spread": str(SPREAD),
        "curve_rows": f"the {rows_text(shown.mask, kind)}, {relation}",
    }
    if c.method.candidates:
        held_out = c.method.candidates[0].cross_validation.errors_without_outliers
        words["compared"] = f"{held_out.leading.n:,}"
    return words
