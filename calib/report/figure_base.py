"""What all figures share: their look, how they become files, axes and legends, and how rows are marked.

A figure belongs to no window and leaves no trace in matplotlib's global state. Names from files are plain text: none is
read as a formula.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
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

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.ticker import Locator

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

#: Fonts that draw what DejaVu Sans lacks, where they are installed.
_FALLBACKS = ["Noto Sans", "Noto Sans CJK JP", "Noto Sans Hebrew", "Noto Emoji", "Yu Gothic"]
_FALLBACKS += ["Arial Unicode MS", "Segoe UI Emoji", "Microsoft YaHei", "PingFang SC"]


@contextmanager
def styled() -> Iterator[None]:
    """Matplotlib's defaults and the figures' look, whatever a user's matplotlibrc says, within the context."""
    import matplotlib as mpl
    from matplotlib.font_manager import get_font_names

    installed = set(get_font_names())
    fonts = ["DejaVu Sans", *(name for name in _FALLBACKS if name in installed)]
    with mpl.rc_context(), warnings.catch_warnings():
        # A name in letters that no font has is drawn as boxes; the terminal is no place to say so.
        warnings.filterwarnings("ignore", message=".*Glyph", category=UserWarning)
        mpl.rcdefaults()
        mpl.rc("font", size=8.5, family=fonts)
        mpl.rc("text", color=INK, parse_math=False)
        mpl.rc("axes", axisbelow=True, grid=True, edgecolor="#9aa7b4", linewidth=0.7)
        mpl.rc("axes", labelcolor=INK, labelsize=8.5, titlecolor=INK, titlelocation="left")
        mpl.rc("axes", titlesize=9.0, titleweight="bold")
        mpl.rc("axes.formatter", useoffset=False)
        mpl.rc("axes.spines", right=False, top=False)
        mpl.rc("grid", color=GRID, linewidth=0.6)
        mpl.rc("hatch", linewidth=0.7)
        mpl.rc("legend", fontsize=8.0, frameon=False)
        mpl.rc("xtick", color="#9aa7b4", labelcolor=SOFT, labelsize=8.0)
        mpl.rc("ytick", color="#9aa7b4", labelcolor=SOFT, labelsize=8.0)
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
    """Refuse a kind of file that is not written.

    Raises:
        FileError: It is none of `KINDS`.
    """
    if kind not in KINDS:
        raise FileError(f"Figures cannot be written as '{kind}'; choose one of {choices(KINDS)}.")


def new_figure(height: float, width: float = WIDTH) -> Figure:
    """An empty figure with room for a legend above; sizes in inches."""
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    layout = ConstrainedLayoutEngine(w_pad=0.05, h_pad=0.05, hspace=0.04, wspace=0.04)
    return Figure(figsize=(width, height), layout=layout)


def legend_above(figure: Figure, handles: Sequence[Any], columns: int = 0) -> None:
    """A legend above all panels, where it hides nothing; ``columns`` side by side, 0 for four at most."""
    look = {"handlelength": 1.8, "handletextpad": 0.5, "columnspacing": 1.6, "borderaxespad": 0.2}
    if handles:
        ncols = columns or min(len(handles), 4)
        figure.legend(handles=list(handles), loc="outside upper left", ncols=ncols, **look)


def line(label: str, **look: Any) -> Any:  # noqa: ANN401  an artist of matplotlib
    """A line or a marker for a legend."""
    from matplotlib.lines import Line2D

    return Line2D([], [], label=label, **look)


def area(label: str, **look: Any) -> Any:  # noqa: ANN401  an artist of matplotlib
    """An area for a legend."""
    from matplotlib.patches import Patch

    return Patch(label=label, **look)


def log_axis(ax: Axes, which: str) -> None:
    """A logarithmic scale ``"x"`` or ``"y"`` whose numbers are plain text: 10⁻⁴, 0.001 to 1000, 10⁴."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    raised = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

    def text(value: float, _: object) -> str:
        if value <= 0.0:
            return ""
        exponent = round(float(np.log10(value)))
        return f"{value:g}" if abs(exponent) <= 3 else f"10{str(exponent).translate(raised)}"

    axis = ax.xaxis if which == "x" else ax.yaxis
    (ax.set_xscale if which == "x" else ax.set_yscale)("log")
    axis.set_major_locator(LogLocator(numticks=8))
    axis.set_major_formatter(FuncFormatter(text))
    axis.set_minor_formatter(NullFormatter())


def few_ticks(count: int, *, whole: bool = False) -> Locator:
    """At most so many steps between round numbers, or between whole ones."""
    from matplotlib.ticker import MaxNLocator

    if whole:
        return MaxNLocator(count, integer=True, min_n_ticks=1, steps=[1, 2, 5, 10])
    return MaxNLocator(count, steps=[1, 2, 2.5, 5, 10])


def short_names(names: Sequence[str], longest: int = 26) -> list[str]:
    """Names that fit: long ones lose their middle, and get a number where two became the same.

    Example:
        >>> short_names(["elbow", "a_very_long_joint_name_1", "a_very_long_joint_name_2"], 12)
        ['elbow', 'a_very…ame_1', 'a_very…ame_2']
    """
    head = longest // 2
    texts = [" ".join("".join(c if c.isprintable() else " " for c in n).split()) for n in names]
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


BEFORE = Who("before (nominal)", NOMINAL, "s", "--", "////")
AFTER = Who("after (calibrated)", CALIBRATED, "o", "-", "")


@dataclass(frozen=True, slots=True, eq=False)
class RowKind:
    """Rows of one kind, shape (N,), and how they are marked everywhere; markers of outliers are not filled."""

    word: str
    mask: Mask
    colour: str
    marker: str
    size: float

    @property
    def label(self) -> str:
        """For a legend, with the number of rows."""
        return rows_text(self.mask, self.word, "" if self.word == "outlier" else " row")

    def style(self, count: int | None = None) -> dict[str, Any]:
        """Of a line of markers, smaller where ``count`` of them are drawn, or all the rows, and they are many."""
        every = int(np.count_nonzero(self.mask))
        many = (every if count is None else count) > 400
        if self.word == "outlier":
            size, face, edge, width = (
                self.size * (0.5 if every > 40 else 1.0),
                "none",
                self.colour,
                1.4,
            )
        else:
            size, face, width = self.size * (0.5 if many else 1.0), self.colour, 0.4
            edge = "none" if many else "white"
        look = {"linestyle": "none", "marker": self.marker, "markersize": size}
        return look | {"markerfacecolor": face, "markeredgecolor": edge, "markeredgewidth": width}

    def handle(self) -> Any:  # noqa: ANN401  an artist of matplotlib
        """For a legend."""
        return line(self.label, **self.style(1))


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


def has_axes(c: Calibration, rows: Mask | slice = slice(None)) -> bool:
    """Whether any row has errors along x, y and z."""
    used = c.used[rows]
    return used.shape[1] >= 3 and bool(np.any(np.all(used[:, :3], axis=1)))


def number_points(
    ax: Axes, rows: Sequence[int], places: Array, chosen: Mask, reach: float = 5.0
) -> None:
    """Row numbers beside some of the points of shape (N, 2), if they are few, where most room is; ``reach`` in pt."""
    there = np.isfinite(places).all(axis=1)
    chosen = chosen & there
    if not 0 < np.count_nonzero(chosen) <= MOST_NUMBERS:
        return
    size = np.maximum(np.ptp(places[there], axis=0), 1e-12)
    at = [int(k) for k in np.flatnonzero(chosen)]
    for k, side in zip(at, free_sides(places / size, at), strict=True):
        write_beside(ax, str(rows[k]), places[k], side, reach)


def write_beside(
    ax: Axes, text: str, at: Array, side: tuple[int, int] = (1, 1), reach: float = 5.0
) -> None:
    """A short text beside a point."""
    from matplotlib.patheffects import withStroke

    ax.annotate(
        text,
        (float(at[0]), float(at[1])),
        (reach * side[0], 0.7 * reach * side[1]),
        ha="left" if side[0] > 0 else "right",
        va="bottom" if side[1] > 0 else "top",
        textcoords="offset points",
        size=7.5,
        color=INK,
        zorder=5,
        path_effects=[withStroke(linewidth=2.0, foreground="white")],
    ).set_in_layout(False)


def free_sides(places: Array, rows: Sequence[int]) -> list[tuple[int, int]]:
    """On which side of some points, in parts of the panel, their numbers have most room; right above in doubt."""
    sides = ((1, 1), (-1, 1), (1, -1), (-1, -1))
    taken = places[np.isfinite(places).all(axis=1)]
    low, high = taken.min(axis=0) - 0.02, taken.max(axis=0) + 0.02
    chosen = []
    for k in rows:
        spots = places[k] + np.array(sides) * (0.035, 0.025)
        out = np.any((spots < low) | (spots > high), axis=1)
        room = np.linalg.norm(taken[None] - spots[:, None], axis=2).min(axis=1) - 0.03 * out
        # Rounded, so that the first one wins unless another has clearly more room.
        best = int(np.argmax(np.round(np.minimum(room, 0.06) / 0.015)))
        chosen.append(sides[best])
        taken = np.vstack([taken, spots[best]])
    return chosen
