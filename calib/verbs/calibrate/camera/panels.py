"""What the figures of images share: their width, panels in the image, round factors, and arrows with their key."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

import calib.show.figure_base as base
from calib.basics.arrays import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Width of a figure [in]: less than a page's, so that its text can be read on a phone.
WIDTH = 5.2

#: Most height of one panel [in].
_MOST_HEIGHT = 4.4

#: Factors of arrows: these times powers of ten.
_STEPS = (1.0, 2.0, 3.0, 5.0)

#: Colours of arrows from short to long; dark enough for lines on white.
_SHORT_TO_LONG = ("#e0a030", *base.LITTLE_TO_MUCH[2:], "#3a0d33")

#: Part of an image's width that a typical arrow takes at most.
TYPICAL = 0.045


def stacked(heights: list[float], extra: float = 0.5) -> Figure:
    """Make an empty figure for panels one above the other.

    Args:
        heights: Height of each panel over its width.
        extra: Height of a panel's title and labels [in].
    """
    panels = [min(0.86 * WIDTH * height, _MOST_HEIGHT) + extra for height in heights]
    return base.new_figure(sum(panels), WIDTH)


def image_panel(ax: Axes, size: tuple[int, int], title: str) -> None:
    """Make a panel an image: pixels, rows downwards, its edge drawn.

    Args:
        ax: The panel.
        size: Columns and rows of the image [px].
        title: Title of the panel.
    """
    width, height = size
    ax.set(
        xlim=(-0.5, width - 0.5),
        ylim=(height - 0.5, -0.5),
        aspect="equal",
        title=title,
        xlabel="u [px]",
        ylabel="v [px]",
    )
    ax.grid(visible=False)
    for side in ("right", "top"):
        ax.spines[side].set_visible(True)
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(base.few_ticks(6))


def round_factor(lengths: Array, longest: float) -> float:
    """Return a factor of 1, 2, 3 or 5 times a power of ten that makes arrows long enough to be seen.

    Args:
        lengths: shape (n,), lengths of arrows, in the panel's unit.
        longest: What a typical arrow takes at most, in the same unit.
    """
    lengths = lengths[np.isfinite(lengths)]
    typical = float(np.sqrt(np.mean(lengths**2))) if len(lengths) else 0.0
    if not typical > 0.0:
        return 1.0
    wanted = longest / typical
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(power * max(step for step in _STEPS if step * power <= wanted * (1.0 + 1e-9)))


def arrows(
    ax: Axes,
    starts: Array,
    vectors: Array,
    factor: float,
    *,
    sizes: Array | None = None,
    unit: str = "px",
    location: str = "right",
    **look: Any,  # noqa: ANN401  matplotlib's properties
) -> None:
    """Draw arrows, by their size in colours with a scale beside the panel, or in one colour.

    Args:
        ax: The panel.
        starts: shape (n, 2), where they start, in the panel's unit.
        vectors: shape (n, 2), the arrows in that unit.
        factor: What they are drawn larger by.
        sizes: shape (n,), numbers that the colours stand for; None for one colour, ``color`` of the look.
        unit: Unit of the sizes.
        location: Side of the panel where the scale of sizes stands.
        look: Further properties of the arrows.
    """
    from matplotlib.colors import LinearSegmentedColormap

    common: dict[str, Any] = {
        "angles": "xy",
        "scale_units": "xy",
        "scale": 1.0 / factor,
        "width": 0.0032,
        "headwidth": 3.6,
        "headlength": 4.2,
        "headaxislength": 3.8,
        "rasterized": len(starts) > base.MOST_SHAPES,
        **look,
    }
    if sizes is None:
        ax.quiver(*starts.T, *vectors.T, **common)
        return
    colours = LinearSegmentedColormap.from_list("short to long", _SHORT_TO_LONG)
    # A few wild corners must not make all others look alike.
    top = float(np.quantile(sizes, 0.98)) if len(sizes) else 1.0
    drawn = ax.quiver(
        *starts.T, *vectors.T, sizes, cmap=colours, clim=(0.0, max(top, 1e-9)), **common
    )
    bar = ax.figure.colorbar(
        drawn, ax=ax, location=location, shrink=0.85, pad=0.02, aspect=26, extend="max"
    )
    bar.locator = base.few_ticks(4)
    bar.set_label(f"size [{unit}]")
    bar.outline.set_visible(False)


def times(factor: float) -> str:
    """Word a factor of arrows: ``arrows × 200``."""
    return f"arrows × {factor:,g}"
