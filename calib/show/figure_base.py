"""What the figures of a calibration share: their look, how they become files, names that fit.

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

from calib.errors import FileError, choices
from calib.show.palette import GRID, INK, SOFT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.ticker import Locator

#: Kinds of picture files.
KINDS = ("png", "svg", "pdf")

#: Width of a figure over both columns of a page [in], and dots of a PNG for each of it.
WIDTH, _DPI = 7.0, 180

#: More markers than this are pixels in SVG and PDF: each shape takes a line of its file.
MOST_SHAPES = 250

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
_IN_SVG = b"'DejaVu Sans', Verdana, sans-serif"
_WIDTH_IN_SVG = re.compile(rb'<svg\b[^>]*?\bwidth="([0-9.]+)pt"')
_FONT_IN_SVG = re.compile(rb"(<text\b[^>]*?\bstyle=\"[^\"]*?)'DejaVu Sans'[^;\"]*")

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


def in_style(draw: Callable[..., Figure], *args: Any, **options: Any) -> Callable[[], Figure]:  # noqa: ANN401
    """What draws a figure in the figures' look, later.

    Args:
        draw: Draws it.
        args: Its arguments.
        options: Its keyword arguments.
    """

    def drawn() -> Figure:
        with styled():
            return draw(*args, **options)

    return drawn


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
    if kind == "png":
        return _of_few_colours(data, metadata["png"])
    if kind == "pdf":
        return data.getvalue()
    # What the first font lacks a viewer takes from the next one.
    return _FONT_IN_SVG.sub(rb"\1" + _IN_SVG, data.getvalue())


def width_of(data: bytes, kind: str) -> float:
    """How wide a rendered figure is [in].

    Args:
        data: What `rendered` made.
        kind: ``"png"`` or ``"svg"``.
    """
    if kind == "png":
        return int.from_bytes(data[16:20], "big") / _DPI
    found = _WIDTH_IN_SVG.search(data)
    return float(found[1]) / 72.0 if found else WIDTH


def _of_few_colours(data: io.BytesIO, words: dict[str, str]) -> bytes:
    """A PNG with a table of 256 colours: a third of the bytes, and no eye sees the difference."""
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    info, smaller = PngInfo(), io.BytesIO()
    for key, text in words.items():
        info.add_itxt(key, text)
    with Image.open(data) as image:
        table = image.convert("RGB").quantize(256, dither=Image.Dither.NONE)
        table.save(smaller, "PNG", optimize=True, pnginfo=info, dpi=(_DPI, _DPI))
    return smaller.getvalue()


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
        # Defaults that a version is about to drop are set all the same.
        warnings.simplefilter("ignore", mpl.MatplotlibDeprecationWarning)
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


def few_ticks(count: int) -> Locator:
    """At most so many steps between round numbers."""
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(count, steps=[1, 2, 2.5, 5, 10])


def power_text(value: float) -> str:
    """A number on a logarithmic axis: plain from 0.001 to 1000, else a power of ten."""
    if value <= 0.0:
        return ""
    exponent = round(float(np.log10(value)))
    if -3 <= exponent <= 3:
        return f"{value:g}"
    return f"10{str(exponent).translate(_RAISED)}"


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
