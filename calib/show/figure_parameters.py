"""Parameters: how far each changed and how sure that is, and which the measurements know together only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from calib.families import unit_of
from calib.identify.findings import ParameterEstimate
from calib.identify.result import Calibration
from calib.identify.statements import errorless
from calib.model.parameters import FRAME, TARGET
from calib.show.figure_base import WIDTH, few_ticks, legend_above, new_figure, short_names
from calib.show.palette import CALIBRATED, INK, NOMINAL, SOFT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

#: The sizes of squares are explained from so many parameters on: fewer leave no room for it.
_FEWEST_FOR_SCALE = 8

#: Height of a parameter's line [in].
_LINE = 0.16


@dataclass(frozen=True, slots=True, eq=False)
class _Unit:
    """The parameters of one unit, and how they are shown."""

    title: str
    unit: str
    scale: float
    parameters: tuple[ParameterEstimate, ...]


def shown_parameters(c: Calibration) -> tuple[ParameterEstimate, ...]:
    """The robot's parameters and targets that were given, the larger model's own behind them.

    Frames, targets' orientations and targets that were not given count from where registration put them, which says
    nothing of the robot. Parameters of a kind of which no errors were found have no interval; see
    `calib.identify.statements.errorless`.
    """
    none = errorless(c)
    own = [
        p
        for p, m in zip(c.parameters, c.model.parameters, strict=True)
        if m.family != FRAME
        and not (m.family == TARGET and (m.unit == "rad" or p.nominal is None))
        and p.name not in none
    ]
    more = (
        [] if c.larger is None else [p for p in c.larger.parameters if p.name not in c.model.names]
    )
    return (*own, *more)


def _by_unit(parameters: tuple[ParameterEstimate, ...]) -> list[_Unit]:
    """Panels: lengths, angles, and what else there is."""
    names = {"m": "Lengths", "rad": "Angles", "1": "Gear ratios and sines", "rad/Nm": "Compliances"}
    result = []
    for unit in dict.fromkeys(p.unit for p in parameters):
        scale, word = unit_of(unit).shown
        if unit == "rad":
            scale, word = float(np.degrees(1.0)), "deg"
        chosen = tuple(p for p in parameters if p.unit == unit)
        result.append(_Unit(names.get(unit, "Others"), word.replace("urad", "µrad"), scale, chosen))
    return result


def changes_figure(c: Calibration) -> Figure:
    """The change of each parameter with its 95 % interval."""
    from matplotlib.lines import Line2D

    units = _by_unit(shown_parameters(c))
    pairs = [units[k : k + 2] for k in range(0, len(units), 2)]
    lines = [max(len(unit.parameters) for unit in pair) for pair in pairs]
    heights = [_LINE * max(count, 3) + 0.75 for count in lines]
    figure = new_figure(sum(heights) + 0.4)
    grid = figure.add_gridspec(len(pairs), min(len(units), 2), height_ratios=heights)
    for row, (pair, count) in enumerate(zip(pairs, lines, strict=True)):
        for column, unit in enumerate(pair):
            _changes(figure.add_subplot(grid[row, column]), unit, count)
    shown = [p for unit in units for p in unit.parameters]
    handles = []
    for wanted, look, label in (
        (any(p.identifiable and not p.at_bound for p in shown), _KNOWN, "change, 95 % interval"),
        (
            any(not p.identifiable and not p.at_bound for p in shown),
            _TOGETHER,
            "known in combination with others only",
        ),
        (any(p.at_bound for p in shown), _BOUND, "stopped by a bound"),
    ):
        if wanted:
            handles.append(Line2D([], [], label=label, **{**look, "linestyle": "-"}))
    legend_above(figure, handles, 3)
    return figure


def _look(marker: str, colour: str, *, filled: bool) -> dict[str, Any]:
    """A dot on its interval."""
    return {
        "linestyle": "none",
        "marker": marker,
        "markersize": 4.6,
        "markerfacecolor": colour if filled else "white",
        "markeredgecolor": colour,
        "markeredgewidth": 1.1,
        "color": colour,
        "linewidth": 1.4,
    }


_KNOWN = _look("o", "#b85c06", filled=True)
_TOGETHER = _look("o", SOFT, filled=False)
_BOUND = _look("s", INK, filled=True)


def _changes(ax: Axes, unit: _Unit, lines: int) -> None:
    """One unit's parameters from above downwards."""
    names = short_names([p.name for p in unit.parameters])
    for y, p in enumerate(unit.parameters):
        look = _BOUND if p.at_bound else _KNOWN if p.identifiable else _TOGETHER
        half = 0.0 if p.at_bound else 0.5 * unit.scale * (p.high - p.low)
        ax.errorbar(
            unit.scale * p.delta, y, xerr=half, capsize=2.0, elinewidth=1.2, zorder=3, **look
        )
    ax.axvline(0.0, color=NOMINAL, lw=1.2, ls="--", zorder=2)
    ax.set_yticks(range(len(names)), names, size=7.5 if lines <= 40 else 6.5)
    ax.set_ylim(len(names) - 0.4, -0.6)
    ax.xaxis.set_major_locator(few_ticks(5))
    ax.grid(visible=False, axis="y")
    for y in range(0, len(names), 2):
        ax.axhspan(y - 0.5, y + 0.5, color="#f3f5f7", lw=0, zorder=0)
    ax.set_xlabel(f"change from nominal [{unit.unit}]")
    ax.set_title(unit.title)


def correlation_indices(c: Calibration) -> list[int]:
    """The parameters whose correlations are drawn: those that the measurements determine, in the model's order."""
    held = c.fitted.estimate.at_bound
    return [k for k, p in enumerate(c.parameters) if p.identifiable and k not in held]


def correlations_figure(c: Calibration) -> Figure:
    """The correlation of each pair of parameters, as squares whose area is its size."""
    from matplotlib.collections import PolyCollection
    from matplotlib.patches import Patch

    chosen = correlation_indices(c)
    C = c.covariance[np.ix_(chosen, chosen)]
    std = np.sqrt(np.diag(C))
    R = C / np.outer(std, std)
    names = short_names([c.parameters[k].name for k in chosen], 18)
    p = len(chosen)
    longest = max(len(name) for name in names)
    text = 8.0 if p <= 30 else 6.0 if p <= 50 else 4.6
    room = 0.009 * text * longest + 0.25  # for the names [in]
    size = float(np.clip(0.27 * p, 1.8, WIDTH - room))
    figure = new_figure(size + room + 0.35, size + room)
    ax = figure.subplots()
    i, j = np.tril_indices(p, -1)
    value = R[i, j]
    half = 0.47 * np.sqrt(np.abs(value))
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    squares = np.stack([j, i], axis=1)[:, None, :] + half[:, None, None] * corners
    visible = np.abs(value) >= 0.02
    for mask, face, edge in (
        (value > 0, CALIBRATED, CALIBRATED),
        (value < 0, "white", NOMINAL),
    ):
        part = mask & visible
        ax.add_collection(
            PolyCollection(list(squares[part]), facecolors=face, edgecolors=edge, linewidths=1.0)
        )
    ax.set_xlim(-0.6, p - 1.4)
    ax.set_ylim(p - 0.4, 0.4)
    ax.set_aspect("equal")
    if p >= _FEWEST_FOR_SCALE:
        _scale_of_squares(ax, 72.0 * size / p)
    ax.set_xticks(range(p - 1), names[:-1], rotation=90, size=text)
    ax.set_yticks(range(1, p), names[1:], size=text)
    ax.grid(linewidth=0.4)
    legend_above(
        figure,
        [
            Patch(facecolor=CALIBRATED, ec=CALIBRATED, label="positive"),
            Patch(facecolor="white", ec=NOMINAL, label="negative"),
        ],
    )
    return figure


def _scale_of_squares(ax: Axes, cell: float) -> None:
    """What the sizes of squares mean, where no squares are.

    Args:
        ax: The panel.
        cell: Edge of a cell [pt].
    """
    from matplotlib.lines import Line2D

    handles = [
        Line2D(
            [],
            [],
            ls="none",
            marker="s",
            ms=0.94 * cell * np.sqrt(value),
            mfc=CALIBRATED,
            mec=CALIBRATED,
            label=f"{value:g}",
        )
        for value in (1.0, 0.5, 0.1)
    ]
    ax.legend(
        handles=handles,
        loc="upper right",
        title="size of the correlation",
        frameon=True,
        facecolor="white",
        edgecolor="none",
        framealpha=1.0,
        labelspacing=max(cell / 8.0 - 0.4, 0.4),
    )
