"""What all figures share: their list, their look, how they become files, axes and legends, and how rows are marked.

A figure belongs to no window and leaves no trace in matplotlib's global state. Names from files are plain text: none is
read as a formula.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import get_font_names
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter
from numpy.typing import NDArray

from calib.errors import FileError, choices
from calib.report.label_rows import (
    CALIBRATED,
    ESTIMATION,
    GRID,
    INK,
    NOMINAL,
    OUTLIER,
    SOFT,
    VALIDATION,
    flagged_rows,
)
from calib.result.calibration import Calibration

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Kinds of picture files.
KINDS = ("png", "svg", "pdf")

#: Width of a figure over both columns of a page [in], and dots of a PNG for each of it.
WIDTH, _DPI = 7.0, 180

#: More markers than this are pixels in SVG and PDF: each shape takes a line of its file.
MOST_SHAPES = 250

#: Rows are numbered in a figure if there are not more than this.
MOST_NUMBERS = 12

#: What captions say of clipped markers.
EDGE = "Outliers beyond the scale stand at its edge."

#: Fonts that draw what DejaVu Sans lacks, where they are installed.
_FALLBACKS = ("Noto Sans", "Noto Sans CJK JP", "Arial Unicode MS", "Microsoft YaHei", "PingFang SC")


class FigureKind(NamedTuple):
    """A figure: its key and file's stem, its section of the report, title, caption, and which calibrations have it.

    Words in braces in the caption are those of `calib.report.figures`.
    """

    name: str
    section: str
    title: str
    caption: str
    applies: Callable[[Calibration], bool]
    draw: Callable[[Calibration], Figure]

    def __call__(self, c: Calibration) -> Figure:
        """The figure of a calibration."""
        return self.draw(c)


def figure(
    name: str, section: str, title: str, caption: str, applies: Callable[[Calibration], bool]
) -> Callable[[Callable[[Calibration], Figure]], FigureKind]:
    """A function that draws as a figure with its description."""
    return partial(FigureKind, name, section, title, caption, applies)


def always(_: Calibration) -> bool:
    """For a figure of every calibration."""
    return True


def has_lengths(c: Calibration) -> bool:
    """Whether any row measures a length or a position."""
    return bool(np.any(c.used[:, :3]))


def has_angles(c: Calibration) -> bool:
    """Whether any row measures an orientation."""
    return bool(np.any(c.used[:, 3:]))


def has_axes(c: Calibration, rows: Mask | slice = slice(None)) -> bool:
    """Whether any row has errors along x, y and z."""
    used = c.used[rows]
    return used.shape[1] >= 3 and bool(np.any(np.all(used[:, :3], axis=1)))


@contextmanager
def styled() -> Iterator[None]:
    """Matplotlib's defaults and the figures' look, whatever a user's matplotlibrc says, within the context."""
    installed = set(get_font_names())
    fonts = ["DejaVu Sans", *(name for name in _FALLBACKS if name in installed)]
    pale = "#9aa7b4"
    with mpl.rc_context(), warnings.catch_warnings():
        # A name in letters that no font has is drawn as boxes; the terminal is no place to say so.
        warnings.filterwarnings("ignore", message=".*Glyph", category=UserWarning)
        mpl.rcdefaults()
        mpl.rc("font", size=8.5, family=fonts)
        mpl.rc("text", color=INK, parse_math=False)
        mpl.rc("axes", axisbelow=True, grid=True, edgecolor=pale, linewidth=0.7, labelcolor=INK)
        mpl.rc("axes", titlecolor=INK, titlelocation="left", titlesize=9.0, titleweight="bold")
        mpl.rc("axes.formatter", useoffset=False)
        mpl.rc("axes.spines", right=False, top=False)
        mpl.rc("grid", color=GRID, linewidth=0.6)
        mpl.rc("hatch", linewidth=0.7)
        mpl.rc("legend", fontsize=8.0, frameon=False)
        mpl.rc("xtick", color=pale, labelcolor=SOFT, labelsize=8.0)
        mpl.rc("ytick", color=pale, labelcolor=SOFT, labelsize=8.0)
        mpl.rc("pdf", fonttype=42)
        mpl.rc("svg", fonttype="none", hashsalt="calib")
        yield


def saved(figure: Figure, kind: str, title: str = "", caption: str = "", dpi: int = _DPI) -> bytes:
    """A figure as a file of one of `KINDS`: the same figure is the same bytes. Called within `styled`."""
    metadata: dict[str, dict[str, Any]] = {
        "png": {"Title": title, "Description": caption},
        "svg": {"Title": title, "Description": caption, "Date": None},
        "pdf": {"Title": title, "Subject": caption, "CreationDate": None},
    }
    data = io.BytesIO()
    figure.savefig(data, format=kind, dpi=dpi, metadata=metadata[kind])
    return data.getvalue()


def check_kind(kind: str) -> None:
    """Refuse a kind of file that is none of `KINDS`."""
    if kind not in KINDS:
        raise FileError(f"Figures cannot be written as '{kind}'; choose one of {choices(KINDS)}.")


def new_figure(height: float, width: float = WIDTH) -> Figure:
    """An empty figure with room for a legend above; sizes in inches."""
    layout = ConstrainedLayoutEngine(w_pad=0.05, h_pad=0.05, hspace=0.04, wspace=0.04)
    return Figure(figsize=(width, height), layout=layout)


def legend_above(figure: Figure, handles: Sequence[Any], columns: int = 4) -> None:
    """A legend above all panels, where it hides nothing; so many columns side by side at most."""
    look = {"handlelength": 1.8, "handletextpad": 0.5, "columnspacing": 1.6, "borderaxespad": 0.2}
    if handles:
        ncols = min(len(handles), columns)
        figure.legend(handles=list(handles), loc="outside upper left", ncols=ncols, **look)


def line(label: str, **look: Any) -> Line2D:  # noqa: ANN401
    """A line or a marker for a legend."""
    return Line2D([], [], label=label, **look)


def area(label: str, **look: Any) -> Patch:  # noqa: ANN401
    """An area for a legend."""
    return Patch(label=label, **look)


def log_axis(ax: Axes, which: str) -> None:
    """A logarithmic scale ``"x"`` or ``"y"`` whose numbers are plain text."""
    axis = ax.xaxis if which == "x" else ax.yaxis
    (ax.set_xscale if which == "x" else ax.set_yscale)("log")
    axis.set_major_locator(LogLocator(numticks=8))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def few_ticks(count: int, *, whole: bool = False) -> MaxNLocator:
    """At most so many steps between round numbers, or between whole ones."""
    if whole:
        return MaxNLocator(count, integer=True, min_n_ticks=1, steps=[1, 2, 5, 10])
    return MaxNLocator(count, steps=[1, 2, 2.5, 5, 10])


def short_names(names: Sequence[str], longest: int = 26) -> list[str]:
    """Names that fit: long ones lose their middle, and get a number where two became the same."""
    head = longest // 2
    texts = [" ".join(name.split()) for name in names]
    texts = [
        t if len(t) <= longest else f"{t[:head]}…{t[len(t) - longest + head + 1 :]}" for t in texts
    ]
    return [f"{text} ({k + 1})" if texts.count(text) > 1 else text for k, text in enumerate(texts)]


class Who(NamedTuple):
    """How a robot's errors are drawn: a colour never stands alone."""

    word: str
    colour: str
    marker: str
    line: str
    hatch: str

    @property
    def area(self) -> dict[str, Any]:
        """How its boxes and bars are drawn, but for their face."""
        return {"alpha": 0.5, "edgecolor": self.colour, "hatch": self.hatch}


BEFORE = Who("before (nominal)", NOMINAL, "s", "--", "////")
AFTER = Who("after (calibrated)", CALIBRATED, "o", "-", "")


class RowKind(NamedTuple):
    """Rows of one kind, shape (N,), and how they are marked everywhere; markers of outliers are not filled."""

    word: str
    mask: Mask
    colour: str
    marker: str
    size: float

    def style(self, factor: float = 1.0) -> dict[str, Any]:
        """Of a line of markers, smaller where many rows are drawn."""
        out, every = self.word == "outlier", int(np.count_nonzero(self.mask))
        size = factor * self.size * (0.5 if every > (40 if out else 400) else 1.0)
        look = {"linestyle": "none", "marker": self.marker, "markersize": size}
        look |= {"markerfacecolor": "none" if out else self.colour}
        edge = self.colour if out or every > 400 else "white"
        return look | {"markeredgecolor": edge, "markeredgewidth": 1.4 if out else 0.4}

    def handle(self) -> Line2D:
        """For a legend, with the number of rows."""
        label = rows_text(self.mask, self.word, "" if self.word == "outlier" else " row")
        return line(label, **self.style() | {"markersize": self.size})


def row_kinds(c: Calibration) -> tuple[RowKind, ...]:
    """Estimation rows, validation rows, and those of either that are flagged; none is empty, none stands in two."""
    m, flagged = c.measurements, flagged_rows(c)
    kinds = (
        RowKind("estimation", m.estimation & ~flagged, ESTIMATION, "o", 4.2),
        RowKind("validation", m.validation & ~flagged, VALIDATION, "D", 5.0),
        RowKind("outlier", flagged, OUTLIER, "x", 6.0),
    )
    return tuple(kind for kind in kinds if np.any(kind.mask))


def rows_text(mask: Mask, word: str, what: str = " row") -> str:
    """A number of rows, such as ``"1 estimation row"``."""
    count = int(np.count_nonzero(mask))
    return f"{count:,} {word}{what}{'s' * (count != 1)}"


def number_points(ax: Axes, rows: Sequence[int], places: Array, chosen: Mask) -> None:
    """Row numbers beside some of the points of shape (N, 2), if they are few."""
    at = np.flatnonzero(chosen & np.isfinite(places).all(axis=1)).tolist()
    for k in at if len(at) <= MOST_NUMBERS else ():
        write_beside(ax, str(rows[k]), places[k])


def write_beside(ax: Axes, text: str, at: Array) -> None:
    """A short text to the right of and above a point."""
    ax.annotate(
        text,
        (float(at[0]), float(at[1])),
        (4.0, 3.0),
        textcoords="offset points",
        size=7.5,
        color=INK,
        zorder=5,
        path_effects=[withStroke(linewidth=2.0, foreground="white")],
    ).set_in_layout(False)
