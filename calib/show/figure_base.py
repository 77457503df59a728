"""What the figures of a calibration share: their look, how they become files, which rows are which, names that fit.

A figure belongs to no window and leaves no trace in matplotlib's global state. Names from files are plain text: none is
read as a formula.
"""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from calib.errors import FileError, choices
from calib.identify.result import Calibration
from calib.model.robot import rigid_inverse
from calib.show.palette import ESTIMATION, GRID, INK, OUTLIER, SOFT, VALIDATION

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Kinds of picture files.
KINDS = ("png", "svg", "pdf")

#: Width of a figure over both columns of a page [in], and dots of a PNG for each of it.
WIDTH, _DPI = 7.0, 180

#: Fonts that draw what DejaVu Sans lacks, where they are installed; viewers of an SVG bring their own.
_FONT = "DejaVu Sans"
_FALLBACKS = (
    "Noto Sans",
    "Noto Sans CJK JP",
    "Noto Sans CJK SC",
    "Noto Sans Hebrew",
    "Noto Sans Arabic",
    "Noto Emoji",
    "Arial Unicode MS",
    "Segoe UI",
    "Segoe UI Emoji",
    "Yu Gothic",
    "Microsoft YaHei",
    "Malgun Gothic",
    "Hiragino Sans",
    "PingFang SC",
    "WenQuanYi Zen Hei",
)
_IN_SVG = f"'{_FONT}', Verdana, sans-serif"

#: Longer names are shortened in the middle.
_LONGEST = 26

#: Letters of numbers above a ten.
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

#: What a figure is drawn with, whatever a user's matplotlibrc says.
_STYLE: dict[str, Any] = {
    "axes.axisbelow": True,
    "axes.edgecolor": "#9aa7b4",
    "axes.formatter.useoffset": False,
    "axes.grid": True,
    "axes.labelcolor": INK,
    "axes.labelsize": 8.5,
    "axes.linewidth": 0.7,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlecolor": INK,
    "axes.titlelocation": "left",
    "axes.titlesize": 9.0,
    "axes.titleweight": "bold",
    "figure.facecolor": "white",
    "font.size": 8.5,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "hatch.linewidth": 0.7,
    "legend.fontsize": 8.0,
    "legend.frameon": False,
    "pdf.fonttype": 42,
    "savefig.facecolor": "white",
    "svg.fonttype": "none",
    "svg.hashsalt": "calib",
    "text.color": INK,
    "text.parse_math": False,
    "xtick.color": "#9aa7b4",
    "xtick.labelcolor": SOFT,
    "xtick.labelsize": 8.0,
    "ytick.color": "#9aa7b4",
    "ytick.labelcolor": SOFT,
    "ytick.labelsize": 8.0,
}

#: Settings that are none of a figure's look.
_NOT_LOOK = (
    "backend",
    "interactive",
    "toolbar",
    "webagg",
    "tk.",
    "keymap",
    "timezone",
    "docstring",
    "macosx",
)


@dataclass(frozen=True, slots=True, eq=False)
class Drawing:
    """A figure that can be drawn.

    Attributes:
        name: Its key and the stem of its file, such as ``"errors-by-pose"``.
        title: Plain text.
        caption: What is shown, on which rows, in which units, and how to read it; plain text.
        draw: Draws it, anew at each call; `rendered` makes a file of it.
    """

    name: str
    title: str
    caption: str
    draw: Callable[[], Figure]


def rendered(drawing: Drawing, kind: str = "png") -> bytes:
    """A figure as a file: the same figure is the same bytes.

    Args:
        drawing: The figure.
        kind: One of `KINDS`.

    Raises:
        FileError: Another kind.
    """
    check_kind(kind)
    metadata: dict[str, dict[str, Any]] = {
        "png": {"Title": drawing.title, "Description": drawing.caption},
        "svg": {"Title": drawing.title, "Description": drawing.caption, "Date": None},
        "pdf": {"Title": drawing.title, "Subject": drawing.caption, "CreationDate": None},
    }
    data = io.BytesIO()
    with styled():
        drawing.draw().savefig(data, format=kind, dpi=_DPI, metadata=metadata[kind])
    if kind != "svg":
        return data.getvalue()
    # The names of fonts stand in style attributes; what a viewer lacks it takes from the next one.
    pattern = (
        rb"(<text\b[^>]*?\bstyle=\"[^\"]*?font: [^\"]*?)'" + _FONT.encode() + rb"'(?:, [^;\"]*)?"
    )
    return re.sub(pattern, rb"\1" + _IN_SVG.encode(), data.getvalue())


def check_kind(kind: str) -> None:
    """Refuse a kind of file that is not written.

    Raises:
        FileError: It is none of `KINDS`.
    """
    if kind not in KINDS:
        message = f"Figures cannot be written as '{kind}'; choose one of {choices(KINDS)}."
        raise FileError(message)


@contextmanager
def styled() -> Iterator[None]:
    """Matplotlib's defaults and the figures' look, for as long as the context lasts."""
    import matplotlib as mpl
    from matplotlib.font_manager import get_font_names

    installed = set(get_font_names())
    fonts = [_FONT, *(name for name in _FALLBACKS if name in installed)]
    look: dict[Any, Any] = {
        name: value for name, value in mpl.rcParamsDefault.items() if not name.startswith(_NOT_LOOK)
    }
    with mpl.rc_context(), warnings.catch_warnings():
        # A name in letters that no font has is drawn as boxes; the terminal is no place to say so.
        warnings.filterwarnings("ignore", message=".*Glyph", category=UserWarning)
        mpl.rcParams.update(look | _STYLE | {"font.family": fonts})
        yield


def new_figure(height: float, width: float = WIDTH) -> Figure:
    """An empty figure with room for a legend above.

    Args:
        height: [in].
        width: [in].
    """
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    layout = ConstrainedLayoutEngine(w_pad=0.05, h_pad=0.05, hspace=0.04, wspace=0.04)
    return Figure(figsize=(width, height), layout=layout)


def legend_above(figure: Figure, handles: Sequence[Any], columns: int = 0) -> None:
    """A legend above all panels, where it hides nothing.

    Args:
        figure: The figure.
        handles: Its entries, each with a label.
        columns: How many stand side by side; 0 for all, four at most.
    """
    if handles:
        figure.legend(
            handles=list(handles),
            loc="outside upper left",
            ncols=columns or min(len(handles), 4),
            handlelength=1.8,
            handletextpad=0.5,
            columnspacing=1.6,
            borderaxespad=0.2,
        )


def log_axis(ax: Axes, which: str) -> None:
    """A logarithmic scale whose numbers are plain text.

    Args:
        ax: The panel.
        which: ``"x"`` or ``"y"``.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis = ax.xaxis if which == "x" else ax.yaxis
    (ax.set_xscale if which == "x" else ax.set_yscale)("log")
    axis.set_major_locator(LogLocator(numticks=8))
    axis.set_major_formatter(FuncFormatter(lambda value, _: power_text(value)))
    axis.set_minor_formatter(NullFormatter())


def power_text(value: float) -> str:
    """A number on a logarithmic axis: plain from 0.001 to 1000, else a power of ten."""
    if value <= 0.0:
        return ""
    exponent = round(float(np.log10(value)))
    if -3 <= exponent <= 3:
        return f"{value:g}"
    return f"10{str(exponent).translate(_RAISED)}"


def row_axis(ax: Axes, numbers: Sequence[int]) -> None:
    """The x axis as places in the table, labelled with the rows' numbers.

    Args:
        ax: The panel.
        numbers: The row number at 0, 1, ...
    """
    from matplotlib.ticker import FuncFormatter, MaxNLocator

    def text(value: float, _: int) -> str:
        k = round(value)
        return str(numbers[k]) if 0 <= k < len(numbers) and abs(value - k) < 1e-6 else ""

    ax.xaxis.set_major_locator(MaxNLocator(nbins=10, integer=True, min_n_ticks=1))
    ax.xaxis.set_major_formatter(FuncFormatter(text))
    room = max(0.5, 0.01 * len(numbers))
    ax.set_xlim(-room, len(numbers) - 1 + room)


def plain(text: str) -> str:
    """Text on one line, without characters that a file of text cannot hold."""
    kept = "".join(c if c.isprintable() else " " for c in text)
    return " ".join(kept.encode("utf-8", "replace").decode("utf-8").split())


def short_names(names: Sequence[str], longest: int = _LONGEST) -> list[str]:
    """Names that fit: long ones lose their middle, and get a number where two became the same.

    Args:
        names: The names.
        longest: Most letters of one.

    Example:
        >>> short_names(["elbow", "a_very_long_joint_name_1", "a_very_long_joint_name_2"], 12)
        ['elbow', 'a_very…ame_1', 'a_very…ame_2']
    """
    texts = [_shortened(plain(name), longest) for name in names]
    return [f"{text} ({k + 1})" if texts.count(text) > 1 else text for k, text in enumerate(texts)]


def _shortened(text: str, longest: int) -> str:
    """A text without its middle."""
    if len(text) <= longest:
        return text
    head = longest // 2
    return f"{text[:head]}…{text[len(text) - (longest - head - 1) :]}"


@dataclass(frozen=True, slots=True, eq=False)
class RowKind:
    """Rows of one kind, and how they are marked everywhere.

    Attributes:
        word: ``"estimation"``, ``"validation"`` or ``"outlier"``.
        mask: shape (N,), which rows.
        colour: As CSS has it.
        marker: Of matplotlib.
        size: Of the marker [pt].
        filled: Whether the marker is.
    """

    word: str
    mask: Mask
    colour: str
    marker: str
    size: float
    filled: bool

    @property
    def label(self) -> str:
        """For a legend, with the number of rows."""
        count = int(np.count_nonzero(self.mask))
        what = {"outlier": "outlier"}.get(self.word, f"{self.word} row")
        return f"{count:,} {what}{'s' * (count != 1)}"

    def style(self, count: int | None = None) -> dict[str, Any]:
        """Of a line of markers, smaller where there are many.

        Args:
            count: How many are drawn; None for the number of rows.
        """
        many = (int(np.count_nonzero(self.mask)) if count is None else count) > 400
        size = self.size * (0.5 if many and self.word != "outlier" else 1.0)
        return {
            "linestyle": "none",
            "marker": self.marker,
            "markersize": size,
            "markerfacecolor": self.colour if self.filled else "none",
            "markeredgecolor": ("white" if not many else "none") if self.filled else self.colour,
            "markeredgewidth": 0.4 if self.filled else 1.4,
        }


def row_kinds(c: Calibration) -> tuple[RowKind, ...]:
    """Estimation rows, validation rows, and those of either that are flagged; none is empty, none stands in two."""
    m = c.measurements
    doubtful = {one.row for one in (*c.outliers, *c.suspects)}
    flagged = np.array([row in doubtful for row in m.rows], dtype=np.bool_)
    kinds = (
        RowKind("estimation", m.estimation & ~flagged, ESTIMATION, "o", 4.2, filled=True),
        RowKind("validation", m.validation & ~flagged, VALIDATION, "D", 5.0, filled=True),
        RowKind("outlier", flagged, OUTLIER, "x", 6.0, filled=False),
    )
    return tuple(kind for kind in kinds if np.any(kind.mask))


def lengths_of(c: Calibration, residual: Array) -> Array:
    """Size of each row's error of length, shape (N,), [m]; NaN where none was measured."""
    return _norms(residual[:, :3], c.used[:, :3])


def angles_of(c: Calibration, residual: Array) -> Array:
    """Size of each row's error of orientation, shape (N,), [rad]; NaN where none was measured."""
    return _norms(residual[:, 3:], c.used[:, 3:])


def _norms(values: Array, used: Mask) -> Array:
    """Norms of rows, NaN where nothing is used."""
    return np.where(
        np.any(used, axis=1), np.linalg.norm(np.where(used, values, 0.0), axis=1), np.nan
    )


def has_axes(c: Calibration) -> bool:
    """Whether any row has errors along x, y and z."""
    return c.used.shape[1] >= 3 and bool(np.any(np.all(c.used[:, :3], axis=1)))


def has_angles(c: Calibration) -> bool:
    """Whether any row has a measured orientation."""
    return bool(np.any(c.used[:, 3:]))


def left_out(c: Calibration) -> Array | None:
    """Measured minus predicted by fits that had not seen the row, shape (N, D), NaN for validation rows; or None."""
    if c.cross_validation is None:
        return None
    residual = np.full(c.residual_calibrated.shape, np.nan)
    residual[c.measurements.estimation] = c.cross_validation.residual
    return residual


def measured_places(c: Calibration) -> tuple[Array, Mask]:
    """Where the target was, in the base, and whether that was measured.

    A target in a socket was where its set-up's frame stands; of distances and planes there is what the calibrated
    robot predicts.

    Returns:
        shape (N, 3), [m], and shape (N,).
    """
    m = c.measurements
    T_base_frame = np.array([rigid_inverse(T) for T in c.setup.T_frame_base])
    into_base = T_base_frame[[c.setup.groups.index(group) for group in m.groups]]
    seen = m.of_kind("point", "pose", "fixed")
    places = (
        np.einsum("nij,nj->ni", into_base[:, :3, :3], np.nan_to_num(m.points)) + into_base[:, :3, 3]
    )
    if not np.all(seen):
        T = c.robot.poses(m.joints_for(c.nominal.joint_names)[~seen])
        names = [
            c.setup.targets.index(name)
            for name, one in zip(m.targets, seen, strict=True)
            if not one
        ]
        places[~seen] = (
            np.einsum("nij,nj->ni", T[:, :3, :3], c.setup.T_tip_target[names, :3, 3]) + T[:, :3, 3]
        )
    return places, seen


def counted(c: Calibration) -> str:
    """How many rows there are of each set, for captions."""
    m = c.measurements
    texts = [
        f"{int(np.sum(mask)):,} {word} row{'s' * (int(np.sum(mask)) != 1)}"
        for word, mask in (("estimation", m.estimation), ("validation", m.validation))
        if np.any(mask)
    ]
    return " and ".join(texts)
