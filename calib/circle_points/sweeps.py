"""Single-joint sweeps: the points that one turning joint carries round, and points on the base's mounting plane.

They stand in a table whose column ``sweep`` says which sweep a row is of, or in a list of points, as laser trackers
write them, whose names do: ``plane_1``, ``joint1_03``. A sweep is called ``plane``, or by a joint's name, or
``joint 1``, ``1``. See docs/base-frame.md.

With the joint's values q the angle of a point about the axis is

    phi = phi_0 + (1 + gain) q + sin sin(q) + cos cos(q) + noise / radius

where gain and the once-per-turn terms are what `families` calls a joint's gain and eccentricity. A circle whose
centre is not known exactly turns once per turn too: the centre's covariance is part of theirs.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from calib.circle_points.fits import LEVEL, Circle
from calib.data.layout import Layout
from calib.data.points_file import PARTS, Points, read_points
from calib.data.table import ORIENTATION, Table, list_columns, name_columns, reserved
from calib.data.values import read_values
from calib.errors import MeasurementError, choices
from calib.robot.robot import read_only

Array = NDArray[np.float64]

#: What the sweep is called that is none, and its number.
PLANE, _PLANE = "plane", -1

_NUMBERED = re.compile(r"(?:joint|axis|sweep|j|a)?[ _\-.]*0*([1-9][0-9]?)", re.IGNORECASE)
_POINT_NAME = re.compile(r"(.*?)[ _\-.:]*[0-9]+")

#: Beside the joint that turns, no other may by more than the first [rad]; it turns by more than the second.
STILL_RAD, TURNED_RAD = float(np.radians(0.1)), float(np.radians(1.0))

#: Joint values and points may disagree by this much, rms, before they are of different sweeps [rad].
_DISAGREE_RAD = float(np.radians(3.0))

#: Of all turning, how much goes one way in a sweep.
_ONE_WAY = 0.8

#: A once-per-turn term is told from a gain on longer arcs than this [rad].
_LONG_RAD = float(np.radians(150.0))

ORDER = (
    "Without joint values the rows of a sweep stand in the order of increasing joint angle: turn their order round, or "
    "give the joints' values in columns."
)


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """The points of one sweep, in the order in which they were measured."""

    joint: int | None  #: Which joint of the chain turns, from 0; None for the plane
    name: str  #: As the file calls it
    points: Array  #: shape (N, 3) in the tracker's frame [m]
    #: Standard deviation of a coordinate of each point, shape (N,) [m]; None where not given
    sigma: Array | None
    joints: Array | None  #: Values of the chain's joints, shape (N, n) [rad]; None where not given
    rows: tuple[int, ...]  #: Their numbers in the file, for messages
    source: str  #: The file's name, for messages
    counted: str = "row"  #: What ``rows`` are: "row" or "line"

    @property
    def where(self) -> str:
        """The sweep's place, for messages."""
        first, last = min(self.rows), max(self.rows)
        return f"{self.source}, sweep '{self.name}' ({self.counted}s {first} to {last})"


@dataclass(frozen=True, slots=True, eq=False)
class Sweeps:
    """All sweeps of a file."""

    #: The plane first, then the joints in the order of the chain; one of each at most
    sweeps: tuple[Sweep, ...]
    joint_names: tuple[str, ...]  #: The chain's joints, base to tip; empty where nobody named them
    source: str  #: The file's name

    def label(self, joint: int) -> str:
        """What to call a joint, from 0: its name, or its number where it has none."""
        return self.joint_names[joint] if joint < len(self.joint_names) else f"joint {joint + 1}"


@dataclass(frozen=True, slots=True)
class Turning:
    """How a joint turned against its own values, with standard deviations; see the module's text."""

    rms: float  #: Of what gain and once-per-turn terms leave [rad]
    gain: float  #: Relative error of the gear; positive where the joint turns further than it says
    gain_std: float
    gain_found: bool  #: Whether it is no chance
    eccentricity: float  #: Amplitude once per turn; NaN on an arc too short to tell [rad]
    eccentricity_std: float
    eccentricity_found: bool


def read_sweeps(
    path: str | Path | None = None,
    joint_names: Sequence[str] | None = None,
    columns: Mapping[str, str] | None = None,
    points: str | Path | None = None,
    points_unit: str | None = None,
) -> Sweeps:
    """Read sweeps from a table, from a list of points, or from both.

    Args:
        path: A table with the columns ``sweep``, ``x``, ``y``, ``z``, perhaps ``sigma`` and the joints' values; None:
            all stands in the list of points.
        joint_names: Of the chain, base to tip; None: the table's columns in a unit of angle, in their order.
        columns: Names of the table to names of calib, see `Measurements.read`.
        points: A list of points. Beside a table its points are matched by the column ``point``, or in their order;
            without one, their names say which sweep they are of.
        points_unit: The unit of that list, where it names none.

    Raises:
        MeasurementError: Something in the files cannot be used; the text names the file, the row and the remedy.
    """
    listed = None if points is None else read_points(points, points_unit)
    if path is not None:
        return _from_table(Table.read(path), joint_names, columns or {}, listed)
    if listed is None:
        raise MeasurementError("Give a table of sweeps, or a list of points (--points).")
    return _from_points(listed, tuple(joint_names or ()))


def _number(word: str, joint_names: Sequence[str]) -> int | None:
    """The joint that a word names, from 0, by its name or number; -1 for the plane; None for any other word."""
    plain = word.strip()
    if plain.casefold() == PLANE:
        return _PLANE
    if plain in joint_names:
        return joint_names.index(plain)
    match = _NUMBERED.fullmatch(plain)
    if match is None or (joint_names and int(match[1]) > len(joint_names)):
        return None
    return int(match[1]) - 1


def _split(
    words: Sequence[str],
    points: Array,
    rows: Sequence[int],
    source: str,
    joint_names: tuple[str, ...],
    *,
    counted: str = "row",
    sigma: Array | None = None,
    joints: Array | None = None,
) -> Sweeps:
    """All points of a file by the words that name their sweeps, the plane first."""
    by_number: dict[int, list[int]] = {}
    for i, word in enumerate(words):
        number = _number(word, joint_names)
        if number is None:
            named = f"a joint's name ({choices(joint_names)}), or " * bool(joint_names)
            raise MeasurementError(
                f"{source}, {counted} {rows[i]}: '{word}' is not a sweep; allowed are '{PLANE}', {named}a joint's "
                "number, 'joint 1'."
            )
        by_number.setdefault(number, []).append(i)
    sweeps = tuple(
        Sweep(
            None if number == _PLANE else number,
            words[at[0]],
            read_only(points[at]),
            None if sigma is None else read_only(sigma[at]),
            None if joints is None or number == _PLANE else read_only(joints[at]),
            tuple(rows[i] for i in at),
            source,
            counted,
        )
        for number, at in sorted(by_number.items())
    )
    return Sweeps(sweeps, joint_names, source)


def _from_points(points: Points, joint_names: tuple[str, ...]) -> Sweeps:
    """The sweeps of a list of points by their names."""
    if not points.names:
        raise MeasurementError(
            f"{points.source}: the points have no names, which would say what sweep they are of. Name them 'plane_1', "
            "'joint1_01' and so on, or give a table with a column 'sweep'."
        )
    words = []
    for name in points.names:
        parts = [part.strip() for part in name.split(PARTS)]
        match = _POINT_NAME.fullmatch(parts[-1])
        # The point's own name without its number; else the group that it stands in.
        candidates = [match[1] if match else parts[-1], *parts[-2:-1]]
        known = (word for word in candidates if _number(word, joint_names) is not None)
        words.append(next(known, candidates[0]))
    return _split(words, points.points, points.lines, points.source, joint_names, counted="line")


def _from_table(
    table: Table,
    joint_names: Sequence[str] | None,
    columns: Mapping[str, str],
    points: Points | None,
) -> Sweeps:
    """The sweeps of a table, whose points may stand in a list of their own."""
    named, _ = name_columns(table, joint_names or (), columns)
    sweep = next((column for name, column in named.items() if name.casefold() == "sweep"), None)
    if sweep is None:
        raise MeasurementError(
            f"{table.source}: no column 'sweep', which says for each row what was measured: 'plane', or the joint that "
            f'turned. {list_columns(table)} Another name is mapped by --columns "name in the table=sweep".'
        )
    if joint_names is None:
        taken = (*reserved(), *ORIENTATION)
        units = {name: column.unit for name, column in named.items() if name not in taken}
        joint_names = [name for name, unit in units.items() if unit and unit.quantity == "angle"]
    names = tuple(joint_names)
    there = names if any(name in named for name in names) else ()
    types = dict.fromkeys(there, "revolute")
    apart = points is not None
    layout = Layout.find(table, there, types, columns, "point", points_elsewhere=apart)
    at = {column.index for column in layout.blocks["joints"]}
    # Rows of the plane may leave their joint values empty.
    cells = tuple(
        [cell or "0" if k in at else cell for k, cell in enumerate(row)]
        if _number(row[sweep.index], names) == _PLANE
        else row
        for row in table.cells
    )
    layout = replace(layout, groups=(sweep,))
    values = read_values(replace(table, cells=cells), layout, points)
    joints = values.joints if there else None
    return _split(
        values.groups,
        values.points,
        values.rows,
        table.source,
        names,
        sigma=values.sigma,
        joints=joints,
    )


def check_joint(sweep: Sweep, joint_names: tuple[str, ...]) -> None:
    """Refuse a sweep in which the joint columns show another joint turning."""
    if sweep.joints is None or sweep.joint is None:
        return
    ranges = np.ptp(sweep.joints, axis=0)
    others = np.delete(ranges, sweep.joint)
    if ranges[sweep.joint] < TURNED_RAD or np.any(others > STILL_RAD):
        turns = zip(joint_names, np.degrees(ranges), strict=True)
        told = ", ".join(f"'{name}' {angle:.3g} deg" for name, angle in turns)
        raise MeasurementError(
            f"{sweep.where}: by their columns the joints turn by {told}. In a sweep one joint turns, as far as it can, "
            "and all others stand still; name the joint that turns, or measure it again."
        )


def positive(sweep: Sweep, circle: Circle) -> Circle:
    """The circle with its normal so that the joint's positive sense turns about it."""
    angles = circle.angles[circle.used]
    if sweep.joints is not None and sweep.joint is not None:
        values = sweep.joints[circle.used, sweep.joint]
        rest = [float(_about_mean(angles - sign * values).std()) for sign in (1.0, -1.0)]
        if min(rest) > _DISAGREE_RAD:
            raise MeasurementError(
                f"{sweep.where}: the points turn otherwise than the joint's column says, by {np.degrees(min(rest)):.3g}"
                " deg rms. Check that joint values and points are of the same rows, and the column's unit."
            )
        return circle if rest[0] <= rest[1] else circle.turned()
    steps = np.angle(np.exp(1j * np.diff(angles)))
    turned = float(steps.sum())
    if abs(turned) < _ONE_WAY * float(np.abs(steps).sum()):
        raise MeasurementError(
            f"{sweep.where}: the points go round both ways, and their order must tell the sense of turning. {ORDER}"
        )
    return circle if turned > 0.0 else circle.turned()


def turning(sweep: Sweep, circle: Circle) -> Turning | None:
    """How well the joint turned about its circle; None without joint values or with too few points."""
    if sweep.joints is None or sweep.joint is None:
        return None
    q, angles = sweep.joints[circle.used, sweep.joint], circle.angles[circle.used]
    columns = [np.ones_like(q), q - q.mean()]
    if np.ptp(q) > _LONG_RAD:
        columns += [np.sin(q), np.cos(q)]
    X = np.column_stack(columns)
    freedom = len(q) - X.shape[1]
    if freedom < 1:
        return None
    y = _about_mean(angles - q)
    inverse = np.linalg.inv(X.T @ X)
    x = inverse @ (X.T @ y)
    left = y - X @ x
    # The centre's displacement moves each angle by its part along the tangent.
    moved = np.column_stack([np.sin(angles), -np.cos(angles)]) / circle.radius
    P = inverse @ X.T @ moved
    covariance = inverse * float(left @ left) / freedom + P @ circle.covariance[:2, :2] @ P.T

    def term(part: slice) -> tuple[float, float, bool]:
        """The size of a term, its standard deviation, and whether it is no chance, by an F test."""
        size, C = x[part], covariance[part, part]
        F = float(size @ np.linalg.solve(C, size)) / len(size)
        std = float(np.sqrt(np.trace(C) / len(size)))
        found = fdtrc(len(size), freedom, F) < LEVEL / 2.0
        return float(size[0] if len(size) == 1 else np.hypot(*size)), std, bool(found)

    once = term(slice(2, 4)) if len(x) == 4 else (np.nan, np.nan, False)
    return Turning(float(np.sqrt(np.mean(left**2))), *term(slice(1, 2)), *once)


def _about_mean(angles: Array) -> Array:
    """Angles about their mean direction, in [-pi, pi)."""
    mean = np.angle(np.exp(1j * angles).mean())
    return np.asarray((angles - mean + np.pi) % (2.0 * np.pi) - np.pi)
