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
import yaml
from matplotlib.figure import Figure

import calib.report.figure_errors as errors
import calib.report.figure_model as model
import calib.report.figure_space as space
from calib.errors import FileError
from calib.files import make_folder, write_atomically
from calib.report.figure_base import check_kind, rows_text, saved, styled
from calib.result.calibration import CalibrationValues
from calib.robot.ranges import SPREAD

#: The file of the captions, beside the figures.
CAPTIONS = "captions.md"


class Drawing(NamedTuple):
    """A figure: its name, which is its file's, its section of the report, what it shows, and what draws it anew."""

    name: str
    section: str
    title: str
    caption: str
    draw: Callable[[], Figure]


#: What draws each figure, in a report's order, and of which calibrations; ``captions.yaml`` says what it shows.
FIGURES: dict[
    str, tuple[Callable[[CalibrationValues], Figure], Callable[[CalibrationValues], Any]]
] = {
    "points": (space.points, lambda _: True),
    "error-curves": (errors.curves, lambda c: np.any(c.used[:, :3])),
    "errors-by-pose": (errors.by_row, lambda c: np.any(c.used[:, :3])),
    "orientation-errors-by-pose": (
        partial(errors.by_row, what=errors.ANGLE),
        lambda c: np.any(c.used[:, 3:]),
    ),
    "errors-by-axis": (errors.by_axis, errors.has_axes),
    "orientation-errors-by-axis": (
        partial(errors.by_axis, what=errors.ANGLE),
        lambda c: np.any(c.used[:, 3:]),
    ),
    "histograms": (errors.histograms, lambda _: True),
    "residual-by-joint": (errors.joints, lambda c: np.any(errors.tells_of_joints(c))),
    "convergence": (model.convergence, lambda c: c.solution.history),
    "parameter-changes": (model.changes, model.shown_parameters),
    "correlations": (model.correlations, lambda c: len(model.correlation_indices(c)) > 1),
    "singular-values": (model.singular_values, lambda c: c.observability.columns),
    "candidates": (model.candidates, lambda c: c.candidates),
    "workspace-uncertainty": (space.uncertainty, lambda _: True),
}


def drawings(calibration: CalibrationValues) -> tuple[Drawing, ...]:
    """The figures that apply to a calibration, in a report's order; none is drawn yet."""
    texts = yaml.safe_load((Path(__file__).parent / "captions.yaml").read_text("utf-8"))
    words = {"c": calibration, **_words(calibration)}
    return tuple(
        Drawing(name, section, title, caption.format(**words), partial(draw, calibration))
        for name, (draw, applies) in FIGURES.items()
        if applies(calibration)
        for section, title, caption in [texts[name].values()]
    )


def rendered(drawing: Drawing, kind: str = "png") -> bytes:
    """A figure as a file of one of `KINDS`: the same figure is the same bytes."""
    check_kind(kind)
    with styled():
        return saved(drawing.draw(), kind, drawing.title, drawing.caption)


def write_figures(
    calibration: CalibrationValues,
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


def _words(c: CalibrationValues) -> dict[str, str]:
    """What captions say of a calibration."""
    m = c.measurements
    estimation = rows_text(m.estimation, "estimation")
    validation = f" and {rows_text(m.validation, 'validation')}" * bool(np.any(m.validation))
    word, mask, _, _ = errors.curve_rows(c)
    kind, seen = {
        "validation": ("validation", "which the fit has not seen"),
        "held-out": ("estimation", "each predicted by fits that have not seen it"),
        "estimation": ("estimation", "which the fit has seen"),
    }[word]
    words = {
        "rows": estimation + validation,
        "estimation": estimation,
        "poses": f"{space.POSES:,}",
        "spread": str(SPREAD),
        "curve_rows": f"the {rows_text(mask, kind)}, {seen}",
    }
    if c.candidates:
        held_out = c.candidates[0].cross_validation.errors_without_outliers
        words["compared"] = f"{held_out.n or held_out.n_angle:,}"
    return words
