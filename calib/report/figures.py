"""The figures of a calibration, for reports and papers: PNG, SVG or PDF, readable in print and with any colour vision.

`FIGURES` is the one list of them. `drawings` gives those that apply to a calibration, `rendered` makes a file of
one, `write_figures` writes all and what they show beside them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

import calib.report.figure_errors as errors
import calib.report.figure_joints as joints
import calib.report.figure_model as model
import calib.report.figure_space as space
from calib.errors import FileError
from calib.files import make_folder, write_atomically
from calib.report.figure_base import KINDS, check_kind, rows_text, saved, styled
from calib.result.calibration import Calibration

__all__ = ["CAPTIONS", "FIGURES", "KINDS", "Drawing", "drawings", "rendered", "write_figures"]

#: The figures, in a report's order.
FIGURES = (
    space.points,
    errors.curves,
    errors.by_row,
    errors.turned_by_row,
    errors.by_axis,
    errors.turned_by_axis,
    errors.histograms,
    joints.joints,
    model.convergence,
    model.changes,
    model.correlations,
    model.singular_values,
    model.candidates,
    space.uncertainty,
)

#: The file of the captions, beside the figures.
CAPTIONS = "captions.md"


class Drawing(NamedTuple):
    """A figure of a calibration, with its caption; ``draw`` draws it anew at each call."""

    name: str
    section: str
    title: str
    caption: str
    draw: Callable[[], Figure]


def drawings(calibration: Calibration) -> tuple[Drawing, ...]:
    """The figures that apply to a calibration, in a report's order; none is drawn yet."""
    words = _words(calibration)
    return tuple(
        Drawing(*one[:3], one.caption.format(**words), partial(one.draw, calibration))
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
    """Refuse to write over figures."""
    for path in paths:
        if path.exists():
            raise FileError(f"{path} exists already; add --force or choose another folder.")


def _words(c: Calibration) -> dict[str, str]:
    """What captions say of a calibration."""
    m = c.measurements
    estimation = rows_text(m.estimation, "estimation")
    counted = [rows_text(m.validation, "validation")] * bool(np.any(m.validation))
    word, mask, _, _ = errors.curve_rows(c)
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
        left_out = c.candidates[0].cross_validation.errors_without_outliers
        words["compared"] = f"{left_out.n or left_out.n_angle:,}"
        words["needed"] = f"{c.candidates[0].needed:.1f}"
    return words
