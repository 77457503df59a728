"""The look that all figures of a calibration share: colours, marks of rows, legends, axes, and the files.

A figure belongs to no window and leaves no trace in matplotlib's global state. Names from files are plain text: none is
read as a formula. Pages in the browser take the colours too, so matplotlib is imported by what draws.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from calib.basics.arrays import Array, Mask
from calib.errors import FileError, choices
from calib.result.calibration import Calibration
from calib.show.row_values import flagged_rows

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

#: Colour of the nominal robot.
NOMINAL = "#45709c"

#: Colour of the calibrated robot.
CALIBRATED = "#ee8420"

#: Colour of the estimation rows.
ESTIMATION = "#16202a"

#: Colour of the validation rows.
VALIDATION = "#009e73"

#: Colour of the flagged rows of either set.
OUTLIER = "#c8323c"

#: Colour of lines of sight and of the instruments that they come from.
BEAM = "#a0569a"

#: Colours from little (pale) to much (dark): density of the target's positions, uncertainty.
LITTLE_TO_MUCH = ("#fbe3b0", "#f5b13a", "#d6602a", "#8c2a4f")

#: Colour of text and axes.
INK = "#16202a"

#: Colour of what stands behind text and axes.
SOFT = "#5a6875"

#: Kinds of picture files, by the ending of their name.
KINDS = ("png", "svg", "pdf")

#: Width of a figure over both columns of a page [in].
WIDTH = 7.0

#: More markers than this are pixels in SVG and PDF: each shape takes a line of its file.
MOST_SHAPES = 250

#: Rows are numbered in a figure if there are not more than this: more numbers would overlap.
_MOST_NUMBERS = 12

#: Fonts that draw letters that DejaVu Sans lacks, where they are installed.
_FALLBACKS = ("Noto Sans", "Noto Sans CJK JP", "Arial Unicode MS", "Microsoft YaHei", "PingFang SC")

#: Metadata that PDF and SVG must not hold, since it would differ between two files of one figure.
_UNDATED: dict[str, dict[str, Any]] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}

#: Markers of more outliers than this are half as large.
_MANY_OUTLIERS = 40

#: Markers of more rows that are no outliers than this are half as large and have no white edge.
_MANY_ROWS = 400


@contextmanager
def styled() -> Iterator[None]:
    """Set matplotlib's defaults and the figures' look, whatever a user's matplotlibrc holds, within the context."""
    import matplotlib as mpl
    from matplotlib import style
    from matplotlib.font_manager import get_font_names

    look = Path(__file__).parent / "figures.mplstyle"
    with style.context(["default", look]), warnings.catch_warnings():
        # A name in letters that no font has is drawn as boxes; the terminal is no place to say so.
        warnings.filterwarnings("ignore", message=".*Glyph", category=UserWarning)
        installed = set(get_font_names())
        fallbacks = [font for font in _FALLBACKS if font in installed]
        mpl.rc("font", family=["DejaVu Sans", *fallbacks])
        yield


def saved(figure: Figure, kind: str, title: str = "", caption: str = "", dpi: int = 180) -> bytes:
    """Return a figure as a picture file; the same figure gives the same bytes. Call it within `styled`.

    Args:
        figure: The figure.
        kind: One of `KINDS`.
        title: Title in the file's metadata.
        caption: Description in the file's metadata.
        dpi: Dots per inch of PNG, and of the parts of SVG and PDF that are pixels.
    """
    import matplotlib as mpl
    from matplotlib.backend_bases import get_registered_canvas_class

    # Laid out here, once: savefig would draw all of it twice, the first time for the layout alone.
    get_registered_canvas_class(kind)(figure)
    layout = figure.get_layout_engine()
    if layout is not None:
        figure.set_dpi(dpi)
        layout.execute(figure)
        # Without a default layout None is none at all; "none" would stand for a layout that is drawn for.
        with mpl.rc_context({"figure.constrained_layout.use": False}):
            figure.set_layout_engine(None)
    data = io.BytesIO()
    description = "Subject" if kind == "pdf" else "Description"
    metadata: dict[str, Any] = {"Title": title, description: caption}
    metadata |= _UNDATED.get(kind, {})
    figure.savefig(data, format=kind, dpi=dpi, metadata=metadata)
    return data.getvalue()


def check_kind(kind: str) -> None:
    """Refuse a kind of file that is none of `KINDS`.

    Raises:
        FileError: It is none.
    """
    if kind not in KINDS:
        raise FileError(f"Figures cannot be written as '{kind}'; choose one of {choices(KINDS)}.")


def new_figure(height: float, width: float = WIDTH) -> Figure:
    """Make an empty figure.

    Args:
        height: Its height [in].
        width: Its width [in].
    """
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height))


def legend_above(figure: Figure, columns: int = 4) -> None:
    """Draw one legend of every label above all panels, where it hides nothing.

    Args:
        figure: The figure; panels that have a legend already are passed over.
        columns: Entries side by side at most.
    """
    handle_of: dict[str, Any] = {}
    for ax in figure.axes:
        if ax.get_legend() is None:
            handles, labels = ax.get_legend_handles_labels()
            for label, handle in zip(labels, handles, strict=True):
                handle_of.setdefault(label, handle)
    if handle_of:
        ncols = min(len(handle_of), columns)
        figure.legend(handle_of.values(), handle_of, loc="outside upper left", ncols=ncols)


def log_axis(ax: Axes, which: str) -> None:
    """Make an axis logarithmic, with plain numbers.

    Args:
        ax: The panel.
        which: ``"x"`` or ``"y"``.
    """
    axis = ax.xaxis if which == "x" else ax.yaxis
    ax.set(**{f"{which}scale": "log"})
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter("")


def few_ticks(count: int, *, integers: bool = False) -> MaxNLocator:
    """Return a locator of ticks at round numbers.

    Args:
        count: Steps between ticks at most.
        integers: Ticks at integers only.
    """
    from matplotlib.ticker import MaxNLocator

    fewest = 1 if integers else 2
    return MaxNLocator(count, integer=integers, min_n_ticks=fewest, steps=[1, 2, 2.5, 5, 10])


def short_names(names: Sequence[str], longest: int = 26) -> list[str]:
    """Shorten names that are too long for an axis: their middle becomes an ellipsis.

    Args:
        names: Names of joints, parameters and the like; line breaks and tabs become blanks.
        longest: Letters of a name at most.
    """
    return [_short_name(" ".join(name.split()), longest) for name in names]


def _short_name(name: str, longest: int) -> str:
    """Shorten one name to ``longest`` letters."""
    if len(name) <= longest:
        return name
    head = longest // 2
    return f"{name[:head]}…{name[head + 1 - longest :]}"


class RobotStyle(NamedTuple):
    """Style in which a robot's errors are drawn; robots differ by more than their colour."""

    #: Text in the legend
    label: str
    #: Colour of lines and areas
    colour: str
    #: Matplotlib's letter of the marker
    marker: str
    #: Matplotlib's line style
    line: str
    #: Matplotlib's pattern of areas
    hatch: str

    @property
    def area(self) -> dict[str, Any]:
        """Properties of the robot's boxes and bars, as matplotlib takes them."""
        return {"alpha": 0.5, "fc": self.colour, "ec": self.colour, "hatch": self.hatch}


BEFORE = RobotStyle("before (nominal)", NOMINAL, "s", "--", "////")
AFTER = RobotStyle("after (calibrated)", CALIBRATED, "o", "-", "")


class RowKind(NamedTuple):
    """A group of rows, and how its rows are marked in every figure."""

    #: ``"estimation"``, ``"validation"`` or ``"outlier"``
    name: str
    #: Shape (N,), its rows among all rows of the table
    mask: Mask
    #: Colour of the markers
    colour: str
    #: Matplotlib's letter of the marker
    marker: str
    #: Size of the markers [pt]
    size: float

    def style(self, factor: float = 1.0) -> dict[str, Any]:
        """Return matplotlib's properties of a line of markers; its label holds the number of rows.

        Args:
            factor: Factor of the markers' size; where many rows are drawn they are half as large.
        """
        is_outlier = self.name == "outlier"
        count = int(np.count_nonzero(self.mask))
        size = factor * self.size
        if count > (_MANY_OUTLIERS if is_outlier else _MANY_ROWS):
            size *= 0.5
        edge = self.colour if is_outlier or count > _MANY_ROWS else "white"
        return {
            "ls": "none",
            "marker": self.marker,
            "ms": size,
            "color": self.colour,
            "mec": edge,
            "mew": 1.4 if is_outlier else 0.4,
            "label": rows_text(self.mask, self.name, "" if is_outlier else " row"),
        }


def row_kinds(c: Calibration) -> tuple[RowKind, ...]:
    """Return estimation rows, validation rows and flagged rows of either set; each row is in one, none is empty."""
    m = c.fit.measurements
    flagged = flagged_rows(c)
    kinds = (
        RowKind("estimation", m.estimation & ~flagged, ESTIMATION, "o", 4.2),
        RowKind("validation", m.validation & ~flagged, VALIDATION, "D", 5.0),
        RowKind("outlier", flagged, OUTLIER, "x", 6.0),
    )
    return tuple(kind for kind in kinds if np.any(kind.mask))


def rows_text(mask: Mask, kind: str, noun: str = " row") -> str:
    """Word the number of rows of a mask, such as ``"1 estimation row"``.

    Args:
        mask: shape (N,), the rows that count.
        kind: The word before the noun.
        noun: The noun in singular, with a blank before it; empty where ``kind`` is the noun.
    """
    count = int(np.count_nonzero(mask))
    plural = "" if count == 1 else "s"
    return f"{count:,} {kind}{noun}{plural}"


def number_points(ax: Axes, rows: Sequence[int], places: Array, chosen: Mask) -> None:
    """Write row numbers beside points, if not more than a dozen are chosen.

    Args:
        ax: The panel.
        rows: Row numbers of the N points.
        places: shape (N, 2), the points in the panel's units; NaN where there is none.
        chosen: shape (N,), the points that are numbered.
    """
    indices = np.flatnonzero(chosen & np.isfinite(places).all(axis=1)).tolist()
    if len(indices) > _MOST_NUMBERS:
        return
    for k in indices:
        write_beside(ax, str(rows[k]), places[k])


def write_beside(ax: Axes, text: str, at: Array) -> None:
    """Write a short text to the right of and above the point ``at``, shape (2,), in the panel's units."""
    offset: dict[str, Any] = {"xytext": (4.0, 3.0), "textcoords": "offset points", "zorder": 5}
    note = ax.annotate(text, (at[0], at[1]), size=7.5, color=INK, **offset)
    note.set_in_layout(False)


#: Each view: indices of its horizontal and vertical axis of the base frame, and its name.
VIEWS = ((0, 1, "from above"), (0, 2, "from the front"), (1, 2, "from the side"))


def flat(ax: Axes, limits: Array, pair: tuple[int, int]) -> None:
    """Give a view equal scales and labels, and mark the base where it lies inside.

    Args:
        ax: The panel.
        limits: shape (2, 3), lowest and highest x, y, z [mm]; see `limits_of`.
        pair: Indices of the horizontal and the vertical axis.
    """
    i, j = pair
    low, high = limits[:, pair]
    ax.set(aspect="equal", xlim=limits[:, i], ylim=limits[:, j])
    ax.set(xlabel=f"{'xyz'[i]} [mm]", ylabel=f"{'xyz'[j]} [mm]")
    ax.xaxis.set_major_locator(few_ticks(4))
    ax.yaxis.set_major_locator(few_ticks(4))
    if np.all(low <= 0.0) and np.all(high >= 0.0):
        ax.plot(0.0, 0.0, "+", ms=8, mew=1.4, color=SOFT, zorder=4, label="base")


def limits_of(places: Array) -> Array:
    """Return the limits of views of points: around all of them, and the base if it is near.

    Args:
        places: shape (N, 3), points in the base frame [mm].

    Returns:
        shape (2, 3), lowest and highest x, y and z [mm]; no side is so short that a view would be a line.
    """
    low = places.min(axis=0)
    high = places.max(axis=0)
    size = max(float(np.max(high - low)), 50.0)
    if np.all((low < size) & (high > -size)):
        low = np.minimum(low, 0.0)
        high = np.maximum(high, 0.0)
    middle = 0.5 * (low + high)
    half = 0.5 * (high - low)
    least = 0.3 * max(float(half.max()), 25.0)
    half = np.maximum(1.1 * half, least)
    return np.array([middle - half, middle + half])
