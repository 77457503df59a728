"""What all pictures of a calibration share: the rows, their colours, and the look of figures.

A figure belongs to no window and leaves no trace in matplotlib's global state. Names from files are plain text: none is
read as a formula. Pages in the browser take the colours too, so matplotlib is loaded by what draws.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from calib.data.measurements import Measurements
from calib.errors import FileError, choices
from calib.registration.setup import Setup
from calib.result.calibration import CalibrationValues
from calib.robot.robot import rigid_inverse
from calib.units import Array, Mask

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator


#: The robots; the rows that the fit has seen, those that it has not, and those that do not belong to the others.
NOMINAL, CALIBRATED = "#45709c", "#ee8420"
ESTIMATION, VALIDATION, OUTLIER = "#16202a", "#009e73", "#c8323c"

#: Lines of sight, and what they come from.
BEAM = "#a0569a"

#: From little to much, from pale to dark: how often the target is somewhere, how badly a position is known.
LITTLE_TO_MUCH = ("#fbe3b0", "#f5b13a", "#d6602a", "#8c2a4f")

#: Text and axes, and what stands behind them.
INK, SOFT = "#16202a", "#5a6875"

#: Kinds of picture files.
KINDS = ("png", "svg", "pdf")

#: Width of a figure over both columns of a page [in].
WIDTH = 7.0

#: More markers than this are pixels in SVG and PDF: each shape takes a line of its file.
MOST_SHAPES = 250

#: Rows are numbered in a figure if there are not more than this.
_MOST_NUMBERS = 12

#: Fonts that draw what DejaVu Sans lacks, where they are installed.
_FALLBACKS = ("Noto Sans", "Noto Sans CJK JP", "Arial Unicode MS", "Microsoft YaHei", "PingFang SC")


def flagged_rows(c: CalibrationValues) -> Mask:
    """The rows of either set that do not belong to the others, shape (N,)."""
    return np.isin(c.measurements.rows, [one.row for one in (*c.outliers, *c.suspects)])


def lengths_of(residual: Array, used: Mask) -> Array:
    """Size of each row's error of length, shape (N,), [m]; NaN where none was measured."""
    return _norms(residual[:, :3], used[:, :3])


def angles_of(residual: Array, used: Mask) -> Array:
    """Size of each row's error of orientation, shape (N,), [rad]; NaN where none was measured."""
    return _norms(residual[:, 3:], used[:, 3:])


def _norms(values: Array, used: Mask) -> Array:
    """Norms of rows, NaN where nothing is used."""
    size = np.linalg.norm(np.where(used, values, 0.0), axis=1)
    return np.where(np.any(used, axis=1), size, np.nan)


def placed(setup: Setup, m: Measurements) -> tuple[Array, Array]:
    """T_frame_base and T_tip_target of each row, shapes (N, 4, 4), [m]."""
    frames = [setup.groups.index(group) for group in m.groups]
    return setup.T_frame_base[frames], setup.T_tip_target[[*map(setup.targets.index, m.targets)]]


def measured_in_base(m: Measurements, T_frame_base: Array) -> Array:
    """Where the target was seen, in the base, shape (N, 3), [m]; NaN where that is not known.

    A target in a socket was where its set-up's frame stands. Distances and planes tell no place.
    """
    T_base_frame = rigid_inverse(T_frame_base)
    points = np.einsum("nij,nj->ni", T_base_frame[:, :3, :3], np.nan_to_num(m.points))
    known = m.where(lambda kind: kind.coordinates)
    return np.where(known[:, None], points + T_base_frame[:, :3, 3], np.nan)


@contextmanager
def styled() -> Iterator[None]:
    """Matplotlib's defaults and the figures' look, whatever a user's matplotlibrc says, within the context."""
    import matplotlib as mpl
    from matplotlib import style
    from matplotlib.font_manager import get_font_names

    look = Path(__file__).parent / "figures.mplstyle"
    with style.context(["default", look]), warnings.catch_warnings():
        # A name in letters that no font has is drawn as boxes; the terminal is no place to say so.
        warnings.filterwarnings("ignore", message=".*Glyph", category=UserWarning)
        installed = set(get_font_names())
        mpl.rc("font", family=["DejaVu Sans", *(f for f in _FALLBACKS if f in installed)])
        yield


def saved(figure: Figure, kind: str, title: str = "", caption: str = "", dpi: int = 180) -> bytes:
    """A figure as a file of one of `KINDS`: the same figure is the same bytes. Called within `styled`."""
    data = io.BytesIO()
    words: dict[str, Any] = {"Title": title, "Subject" if kind == "pdf" else "Description": caption}
    words |= {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind, {})
    figure.savefig(data, format=kind, dpi=dpi, metadata=words)
    return data.getvalue()


def check_kind(kind: str) -> None:
    """Refuse a kind of file that is none of `KINDS`."""
    if kind not in KINDS:
        raise FileError(f"Figures cannot be written as '{kind}'; choose one of {choices(KINDS)}.")


def new_figure(height: float, width: float = WIDTH) -> Figure:
    """An empty figure; sizes in inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height))


def legend_above(figure: Figure, columns: int = 4) -> None:
    """A legend of every label above all panels, where it hides nothing; so many columns side by side at most."""
    found: dict[str, Any] = {}
    for ax in figure.axes:
        if ax.get_legend() is None:
            handles, labels = ax.get_legend_handles_labels()
            for label, handle in zip(labels, handles, strict=True):
                found.setdefault(label, handle)
    if found:
        ncols = min(len(found), columns)
        figure.legend(found.values(), found, loc="outside upper left", ncols=ncols)


def log_axis(ax: Axes, which: str) -> None:
    """A logarithmic scale ``"x"`` or ``"y"`` whose numbers are plain text."""
    axis = ax.xaxis if which == "x" else ax.yaxis
    ax.set(**{f"{which}scale": "log"})
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter("")


def few_ticks(count: int, *, whole: bool = False) -> MaxNLocator:
    """At most so many steps between round numbers, or between whole ones."""
    from matplotlib.ticker import MaxNLocator

    least = 1 if whole else 2
    return MaxNLocator(count, integer=whole, min_n_ticks=least, steps=[1, 2, 2.5, 5, 10])


def short_names(names: Sequence[str], longest: int = 26) -> list[str]:
    """Names that fit: long ones lose their middle."""
    head, texts = longest // 2, [" ".join(name.split()) for name in names]
    return [
        text if len(text) <= longest else f"{text[:head]}…{text[head + 1 - longest :]}"
        for text in texts
    ]


class Who(NamedTuple):
    """How a robot's errors are drawn: a colour never stands alone."""

    word: str
    colour: str
    marker: str
    line: str
    hatch: str

    @property
    def area(self) -> dict[str, Any]:
        """How its boxes and bars are drawn."""
        return {"alpha": 0.5, "fc": self.colour, "ec": self.colour, "hatch": self.hatch}


BEFORE = Who("before (nominal)", NOMINAL, "s", "--", "////")
AFTER = Who("after (calibrated)", CALIBRATED, "o", "-", "")


class RowKind(NamedTuple):
    """Rows of one kind, shape (N,), and how they are marked everywhere."""

    word: str
    mask: Mask
    colour: str
    marker: str
    size: float

    def style(self, factor: float = 1.0) -> dict[str, Any]:
        """Of a line of markers, smaller where many rows are drawn; labelled with their number."""
        out, every = self.word == "outlier", int(np.count_nonzero(self.mask))
        size = factor * self.size * (0.5 if every > (40 if out else 400) else 1.0)
        label = rows_text(self.mask, self.word, "" if out else " row")
        look = {"ls": "none", "marker": self.marker, "ms": size, "color": self.colour}
        edge = self.colour if out or every > 400 else "white"
        return look | {"mec": edge, "mew": 1.4 if out else 0.4, "label": label}


def row_kinds(c: CalibrationValues) -> tuple[RowKind, ...]:
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
    for k in at if len(at) <= _MOST_NUMBERS else ():
        write_beside(ax, str(rows[k]), places[k])


def write_beside(ax: Axes, text: str, at: Array) -> None:
    """A short text to the right of and above a point."""
    where: dict[str, Any] = {"xytext": (4.0, 3.0), "textcoords": "offset points", "zorder": 5}
    ax.annotate(text, (at[0], at[1]), size=7.5, color=INK, **where).set_in_layout(False)
