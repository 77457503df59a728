"""The rows of a calibration in its figures: which are which, how large their errors are, where they were measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from calib.identify.result import Calibration
from calib.identify.statistics import CrossValidation
from calib.model.robot import rigid_inverse
from calib.show.palette import ESTIMATION, INK, OUTLIER, VALIDATION

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Rows are numbered in a figure if there are not more than this.
_MOST_NUMBERS = 12


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
        small = many if self.filled else np.count_nonzero(self.mask) > 40
        size = self.size * (0.5 if small else 1.0)
        return {
            "linestyle": "none",
            "marker": self.marker,
            "markersize": size,
            "markerfacecolor": self.colour if self.filled else "none",
            "markeredgecolor": ("white" if not many else "none") if self.filled else self.colour,
            "markeredgewidth": 0.4 if self.filled else 1.4,
        }


def flagged_rows(c: Calibration) -> Mask:
    """The rows of either set that do not belong to the others, shape (N,)."""
    doubtful = {one.row for one in (*c.outliers, *c.suspects)}
    return np.array([row in doubtful for row in c.measurements.rows], dtype=np.bool_)


def row_kinds(c: Calibration) -> tuple[RowKind, ...]:
    """Estimation rows, validation rows, and those of either that are flagged; none is empty, none stands in two."""
    m = c.measurements
    flagged = flagged_rows(c)
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


def has_axes(c: Calibration, rows: Mask | None = None) -> bool:
    """Whether any row has errors along x, y and z.

    Args:
        c: The calibration.
        rows: shape (N,), which rows are asked for; None for all.
    """
    used = c.used if rows is None else c.used[rows]
    return used.shape[1] >= 3 and bool(np.any(np.all(used[:, :3], axis=1)))


def has_flagged(c: Calibration) -> bool:
    """Whether any row is flagged: captions speak of outliers only where there are some."""
    return bool(np.any(flagged_rows(c)))


def has_angles(c: Calibration) -> bool:
    """Whether any row has a measured orientation."""
    return bool(np.any(c.used[:, 3:]))


def left_out(c: Calibration, found: CrossValidation | None) -> Array | None:
    """Measured minus predicted by fits that had not seen the row, shape (N, D), NaN for validation rows; or None.

    Args:
        c: The calibration.
        found: One of its cross-validations; None where there is none.
    """
    if found is None:
        return None
    residual = np.full(c.residual_calibrated.shape, np.nan)
    residual[c.measurements.estimation] = found.residual
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
        rows_text(mask, word)
        for word, mask in (("estimation", m.estimation), ("validation", m.validation))
        if np.any(mask)
    ]
    return " and ".join(texts)


def rows_text(mask: Mask, word: str) -> str:
    """A number of rows, such as ``"1 estimation row"``.

    Args:
        mask: shape (N,), which rows.
        word: What they are called.
    """
    count = int(np.count_nonzero(mask))
    return f"{count:,} {word} row{'s' * (count != 1)}"


def row_axis(ax: Axes, numbers: Sequence[int], ticks: int = 9) -> None:
    """The x axis as places in the table, labelled with the rows' numbers, round ones where they run on.

    Args:
        ax: The panel.
        numbers: The row number at 0, 1, ...
        ticks: Most of them.
    """
    from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator

    last = len(numbers) - 1
    runs_on = numbers[last] - numbers[0] == last
    low = numbers[0] if runs_on else 0
    found = MaxNLocator(nbins=ticks, integer=True, min_n_ticks=1, steps=[1, 2, 5, 10]).tick_values(
        low, low + last
    )
    places = [round(value) - low for value in found if low <= round(value) <= low + last]
    ax.xaxis.set_major_locator(FixedLocator(places))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: str(numbers[round(value)])))
    room = max(0.5, 0.01 * len(numbers))
    ax.set_xlim(-room, last + room)


def number_points(
    ax: Axes, c: Calibration, places: Array, only: Sequence[str] = ("validation", "outlier")
) -> None:
    """Row numbers beside the points of some kinds, if they are few; see `numbered_rows`.

    Args:
        ax: The panel.
        c: The calibration.
        places: shape (N, 2), of all rows, in the panel's units.
        only: The kinds' words.
    """
    from matplotlib.patheffects import withStroke

    chosen = numbered_rows(c, only, np.asarray(np.isfinite(places).all(axis=1)))
    if not np.any(chosen):
        return
    rows = np.flatnonzero(chosen)
    size = np.maximum(np.ptp(places[np.isfinite(places).all(axis=1)], axis=0), 1e-12)
    for k, side in zip(rows, free_sides(places / size, rows), strict=True):
        ax.annotate(
            str(c.measurements.rows[k]),
            (float(places[k, 0]), float(places[k, 1])),
            (5 * side[0], 3 * side[1]),
            ha="left" if side[0] > 0 else "right",
            va="bottom" if side[1] > 0 else "top",
            textcoords="offset points",
            size=7.5,
            color=INK,
            zorder=5,
            path_effects=[withStroke(linewidth=2.0, foreground="white")],
        ).set_in_layout(False)


def numbered_rows(
    c: Calibration,
    only: Sequence[str] = ("validation", "outlier"),
    there: Mask | None = None,
) -> Mask:
    """The rows that carry their numbers, shape (N,); none where they are many.

    Args:
        c: The calibration.
        only: Words of the kinds.
        there: shape (N,), which rows are drawn; None for all.
    """
    chosen = np.zeros(len(c.measurements), dtype=np.bool_)
    for kind in row_kinds(c):
        if kind.word in only:
            chosen |= kind.mask
    if there is not None:
        chosen &= there
    return chosen & (np.count_nonzero(chosen) <= _MOST_NUMBERS)


def free_sides(places: Array, rows: Sequence[int] | NDArray[np.intp]) -> list[tuple[int, int]]:
    """On which side of some points their numbers stand: where the others leave most room, right above in doubt.

    Args:
        places: shape (N, 2), in parts of the panel.
        rows: Which of them have numbers.
    """
    sides = ((1, 1), (-1, 1), (1, -1), (-1, -1))
    taken = places[np.isfinite(places).all(axis=1)]
    low, high = taken.min(axis=0) - 0.02, taken.max(axis=0) + 0.02
    chosen = []
    for k in rows:
        spots = [places[k] + np.array(side) * (0.035, 0.025) for side in sides]
        out = [np.any((spot < low) | (spot > high)) for spot in spots]
        room = [
            np.min(np.linalg.norm(taken - spot, axis=1)) - 0.03 * o
            for spot, o in zip(spots, out, strict=True)
        ]
        # Rounded, so that the first one wins unless another has clearly more room.
        best = int(np.argmax(np.round(np.minimum(room, 0.06) / 0.015)))
        chosen.append(sides[best])
        taken = np.vstack([taken, spots[best]])
    return chosen
