"""Figures by matplotlib: their look, legends, axes, and the files that they are written into.

A figure belongs to no window and leaves no trace in matplotlib's global state. Names from files are plain text, never
read as formulas. Matplotlib is an extra, so it is imported when something is drawn.
"""

from __future__ import annotations

import importlib.util
import io
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from calib.basics.arrays import Array, Mask
from calib.errors import CalibError, FileError, choices
from calib.show.blocks import Drawing
from calib.show.look import INK, SOFT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

#: Kinds of picture files, by the ending of their name.
KINDS = ("png", "svg", "pdf")

#: Width of a figure over both columns of a page [in].
WIDTH = 7.0

#: More markers than this are pixels in SVG and PDF: each shape takes a line of its file.
MOST_SHAPES = 250

#: Rows are numbered in a figure if there are not more than this: more numbers would overlap.
_MOST_NUMBERS = 12

#: Rows are at one place in a figure, such as repeats of a pose, if they are closer than this share of all rows' spread.
_SAME_PLACE = 0.01

#: Fonts with letters that DejaVu Sans lacks; those that are installed are used.
_FALLBACKS = ("Noto Sans", "Noto Sans CJK JP", "Arial Unicode MS", "Microsoft YaHei", "PingFang SC")

#: Metadata that PDF and SVG must not hold, since it would differ between two files of one figure.
_UNDATED: dict[str, dict[str, Any]] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}


def require_matplotlib(what: str) -> None:
    """Refuse work whose result could not be drawn.

    Args:
        what: What is drawn, such as ``"A report"``.

    Raises:
        CalibError: Matplotlib is not installed.
    """
    if importlib.util.find_spec("matplotlib") is None:
        raise CalibError(
            f"{what} needs matplotlib, which is not installed: pip install 'robot-calib[report]'"
        )


@contextmanager
def styled() -> Iterator[None]:
    """Set matplotlib's defaults and the figures' look, whatever a user's matplotlibrc holds, within the context."""
    import matplotlib as mpl
    from matplotlib import style
    from matplotlib.font_manager import get_font_names

    look = Path(__file__).parent / "figures.mplstyle"
    with style.context(["default", look]), warnings.catch_warnings():
        # Letters that no font has are drawn as boxes: do not warn about them in the terminal.
        warnings.filterwarnings("ignore", message=".*Glyph", category=UserWarning)
        installed = set(get_font_names())
        fallbacks = [font for font in _FALLBACKS if font in installed]
        mpl.rc("font", family=["DejaVu Sans", *fallbacks])
        yield


def picture_bytes(
    figure: Figure, kind: str, title: str = "", caption: str = "", dpi: int = 180
) -> bytes:
    """Return the bytes of a figure as a picture file; the same figure gives the same ones. Call it within `styled`.

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
        # With a default layout, None would ask for that one; "none" would keep a placeholder that is drawn for.
        with mpl.rc_context({"figure.constrained_layout.use": False}):
            figure.set_layout_engine(None)
    data = io.BytesIO()
    description = "Subject" if kind == "pdf" else "Description"
    metadata: dict[str, Any] = {"Title": title, description: caption}
    metadata |= _UNDATED.get(kind, {})
    figure.savefig(data, format=kind, dpi=dpi, metadata=metadata)
    return data.getvalue()


def check_kind(kind: str) -> None:
    """Refuse a kind of file that is not one of `KINDS`.

    Raises:
        FileError: It is not.
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
    """Draw one legend of every label above all panels, so that it hides nothing.

    Args:
        figure: The figure; panels that already have a legend are left out.
        columns: Most entries side by side.
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
        count: Most steps between ticks.
        integers: Ticks at integers only.
    """
    from matplotlib.ticker import MaxNLocator

    fewest = 1 if integers else 2
    return MaxNLocator(count, integer=integers, min_n_ticks=fewest, steps=[1, 2, 2.5, 5, 10])


def number_points(ax: Axes, rows: Sequence[int], places: Array, chosen: Mask) -> None:
    """Write row numbers beside points, if not more than a dozen are chosen; rows at one place have one text.

    Args:
        ax: The panel.
        rows: Row numbers of the N points.
        places: shape (N, 2), the points in the panel's units; NaN where there is none.
        chosen: shape (N,), the points that are numbered.
    """
    is_placed = np.isfinite(places).all(axis=1)
    indices = np.flatnonzero(chosen & is_placed).tolist()
    if len(indices) > _MOST_NUMBERS:
        return
    if not indices:
        return
    near = _SAME_PLACE * np.ptp(places[is_placed], axis=0)
    numbers: dict[int, list[str]] = {}  # by the first row at a place
    for k in indices:
        firsts = (first for first in numbers if np.all(np.abs(places[k] - places[first]) <= near))
        numbers.setdefault(next(firsts, k), []).append(str(rows[k]))
    for first, texts in numbers.items():
        write_beside(ax, ", ".join(texts), places[first])


def write_beside(ax: Axes, text: str, at: Array) -> None:
    """Write a short text to the right of and above the point ``at``, shape (2,), in the panel's units."""
    offset: dict[str, Any] = {"xytext": (4.0, 3.0), "textcoords": "offset points", "zorder": 5}
    note = ax.annotate(text, (at[0], at[1]), size=7.5, color=INK, **offset)
    note.set_in_layout(False)


#: Each view: indices of its horizontal and vertical axis of the base frame, and its name.
VIEWS = ((0, 1, "from above"), (0, 2, "from the front"), (1, 2, "from the side"))


def set_view(ax: Axes, limits: Array, pair: tuple[int, int]) -> None:
    """Give a view equal scales and labels, and mark the base if it lies inside.

    Args:
        ax: The panel.
        limits: shape (2, 3), lowest and highest x, y, z [mm]; see `view_limits`.
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


def view_limits(places: Array) -> Array:
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


def render(drawing: Drawing, kind: str = "png") -> bytes:
    """Draw a figure and return its file; the same figure gives the same bytes.

    Args:
        drawing: The figure.
        kind: One of `KINDS`.

    Raises:
        CalibError: Matplotlib is not installed.
        FileError: Another kind.
    """
    check_kind(kind)
    require_matplotlib("A figure")
    with styled():
        return picture_bytes(drawing.draw(), kind, drawing.title, drawing.caption)
