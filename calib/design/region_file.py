"""A region as a file: JSON in SI units, the unit in each key's suffix, versioned by ``schema``. See docs/workspace.md.

Beside the voxels the file says which robot, base, tip and target it was made for: in another base frame the same
numbers are another place.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.design.region import Region, checked_box
from calib.errors import CalibError, FileError, choices
from calib.model.files import json_bytes, read_json, write_atomically
from calib.model.robot import Robot, read_only
from calib.version import __version__

SCHEMA = "region 1"


#: The most voxels of a file's grid; a region that calib makes has fewer.
_MOST_VOXELS = 20_000_000

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class RegionFile:
    """A region and what it was made from.

    Attributes:
        region: The region, in the base frame.
        robot: The robot's name in the URDF.
        base: Base link.
        tip: Tip link.
        joints: Names of the columns of q.
        ranges: shape (m, 2), between which values each joint was moved [rad] or [m].
        prismatic: Names of those joints whose values are lengths.
        target: shape (3,), the target in the tip [m].
        samples: How many samples the region was made from.
        seed: Their seed.
    """

    region: Region
    robot: str
    base: str
    tip: str
    joints: tuple[str, ...]
    ranges: Array
    prismatic: tuple[str, ...]
    target: Array
    samples: int
    seed: int

    @classmethod
    def of(
        cls,
        region: Region,
        robot: Robot,
        target: Array,
        ranges: Array,
        samples: int,
        seed: int,
    ) -> RegionFile:
        """The file of a robot's region; see the attributes."""
        return cls(
            region=region,
            robot=robot.name,
            base=robot.base,
            tip=robot.tip,
            joints=robot.joint_names,
            ranges=read_only(ranges),
            prismatic=tuple(n for n, kind in robot.joint_types.items() if kind == "prismatic"),
            target=read_only(target),
            samples=int(samples),
            seed=int(seed),
        )

    def write(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the region as JSON, whole or not at all.

        Raises:
            FileError: The file exists and ``overwrite`` is False, or it cannot be written.
        """
        return write_atomically(Path(path), json_bytes(self._table()), overwrite=overwrite)

    def _table(self) -> dict[str, Any]:
        """The nested tables that are written."""
        region = self.region
        joints = []
        for name, (low, high) in zip(self.joints, self.ranges.tolist(), strict=True):
            unit = "m" if name in self.prismatic else "rad"
            joints.append({"name": name, f"low_{unit}": low, f"high_{unit}": high})
        box = region.box.tolist() if np.isfinite(region.box).any() else None
        if box is not None:  # a box may be open at some sides
            box = [[v if math.isfinite(v) else None for v in corner] for corner in box]
        return {
            "schema": SCHEMA,
            "calib": __version__,
            "robot": {
                "name": self.robot,
                "base": self.base,
                "tip": self.tip,
                "joints": joints,
            },
            "target_xyz_m": self.target.tolist(),
            "samples": self.samples,
            "seed": self.seed,
            "share": region.share,
            "held": region.held,
            "volume_m3": region.volume,
            "box_m": box,
            "voxel_m": region.voxel,
            "origin_m": region.origin.tolist(),
            "shape": list(region.cells.shape),
            "runs": _runs(region.cells),
        }

    @classmethod
    def read(cls, path: str | Path) -> RegionFile:
        """Read what `write` wrote.

        Raises:
            FileError: The file cannot be read, is no JSON, no region of calib, of another schema, or damaged.
        """
        expected = (
            f"a region of calib {__version__} has '{SCHEMA}'. Give the file that 'calib workspace -o' wrote, by "
            "the same version."
        )
        table = read_json(path, "region", SCHEMA, expected)
        try:
            return _parsed(table)
        except (CalibError, _DamagedError) as error:
            message = (
                f"{path}: the region is damaged: {error} Write it again with 'calib workspace -o'."
            )
            raise FileError(message) from error

    def check_fits(self, robot: Robot, target: Array | None = None) -> tuple[str, ...]:
        """Whether the region is one of this robot: refuse another base, say what else differs.

        Args:
            robot: The robot that the region is wanted for.
            target: shape (3,), its target in the tip [m]; None where it is not known.

        Returns:
            Sentences on what differs and may well be meant so: the robot's name, or the target by more than a voxel.

        Raises:
            CalibError: The region is in the frame of another base, or of another tip or other joints.
        """
        for what, option, here, there in (
            ("base", "--base", robot.base, self.base),
            ("tip", "--tip", robot.tip, self.tip),
        ):
            if here != there:
                message = (
                    f"The region was made for the {what} '{there}' of '{self.robot}', and the {what} is '{here}' now. "
                    f"Give {option} {there}, or make the region again with 'calib workspace'."
                )
                raise CalibError(message)
        if robot.joint_names != self.joints:
            message = (
                f"The region was made for the joints {choices(self.joints)} of '{self.robot}'; the chain "
                f"'{robot.base}' to '{robot.tip}' of '{robot.name}' has {choices(robot.joint_names)}. Give the "
                "same --hold, or make the region again with 'calib workspace'."
            )
            raise CalibError(message)
        notes = []
        if robot.name != self.robot:
            notes.append(f"The region was made for '{self.robot}', this robot is '{robot.name}'.")
        if target is not None:
            apart = float(np.linalg.norm(np.asarray(target) - self.target))
            if apart > self.region.voxel:
                notes.append(
                    f"The region was made for a target {1e3 * apart:.0f} mm away from this one in the tip; make it "
                    "again with 'calib workspace --target' if that matters."
                )
        return tuple(notes)


class _DamagedError(Exception):
    """Something in the file is missing or of another kind; the text says what."""


def _runs(cells: NDArray[np.bool_]) -> list[int]:
    """Voxels in the order of the last index first, as lengths of runs: outside, inside, outside, ..."""
    flat = cells.ravel()
    ends = np.flatnonzero(np.diff(flat)) + 1
    lengths: list[int] = np.diff([0, *ends.tolist(), flat.size]).tolist()
    return [0, *lengths] if flat[0] else lengths


def _parsed(table: Mapping[str, Any]) -> RegionFile:
    """The region of a file's tables.

    Raises:
        _DamagedError: A key is missing or its value is of another kind.
        CalibError: The values do not make a region.
    """
    robot = _get(table, "robot", dict)
    joints = [_joint(one, i) for i, one in enumerate(_get(robot, "joints", list, "robot."), 1)]
    names = tuple(name for name, *_ in joints)
    if not names or len(set(names)) < len(names):
        message = (
            f"'robot.joints' has the names {choices(names)}; at least one is wanted, and each once."
        )
        raise _DamagedError(message)
    region = Region(
        origin=_numbers(table, "origin_m", 3),
        voxel=_number(table, "voxel_m"),
        cells=_cells(table),
        share=_number(table, "share"),
        held=_number(table, "held"),
        box=_box(table),
    )
    volume = _number(table, "volume_m3")
    if not math.isclose(volume, region.volume, rel_tol=1e-6):
        message = f"'volume_m3' is {volume:g}, and its voxels have {region.volume:g}."
        raise _DamagedError(message)
    samples, seed = (_whole(table, key, least) for key, least in (("samples", 1), ("seed", 0)))
    return RegionFile(
        region=region,
        robot=_get(robot, "name", str, "robot."),
        base=_get(robot, "base", str, "robot."),
        tip=_get(robot, "tip", str, "robot."),
        joints=names,
        ranges=read_only([ends for _, ends, _ in joints]),
        prismatic=tuple(name for name, _, slides in joints if slides),
        target=read_only(_numbers(table, "target_xyz_m", 3)),
        samples=samples,
        seed=seed,
    )


def _get(table: Mapping[str, Any], key: str, kind: type, above: str = "") -> Any:  # noqa: ANN401
    """An entry of a kind."""
    if key not in table:
        message = f"'{above}{key}' is missing."
        raise _DamagedError(message)
    value = table[key]
    if not isinstance(value, kind):
        word = "a table" if kind is dict else "a list" if kind is list else "a text"
        message = f"'{above}{key}' is {_short(value)}; {word} is wanted."
        raise _DamagedError(message)
    return value


def _number(table: Mapping[str, Any], key: str, above: str = "") -> float:
    """A finite number."""
    if key not in table:
        message = f"'{above}{key}' is missing."
        raise _DamagedError(message)
    value = table[key]
    # A whole number beyond 1e300 is no float either.
    known = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not known or not -1e300 < value < 1e300:
        message = f"'{above}{key}' is {_short(value)}; a finite number is wanted."
        raise _DamagedError(message)
    return float(value)


def _whole(table: Mapping[str, Any], key: str, least: int) -> int:
    """A whole number that is not below another."""
    value = _number(table, key)
    if value != int(value) or value < least:
        message = f"'{key}' is {_short(table[key])}; a whole number of at least {least} is wanted."
        raise _DamagedError(message)
    return int(value)


def _numbers(table: Mapping[str, Any], key: str, count: int) -> Array:
    """Some finite numbers."""
    values = _get(table, key, list)
    if len(values) != count:
        message = f"'{key}' has {len(values)} entries; {count} numbers are wanted."
        raise _DamagedError(message)
    return np.array([_number({str(i): v}, str(i), f"{key}.") for i, v in enumerate(values)])


def _joint(entry: Any, number: int) -> tuple[str, tuple[float, float], bool]:  # noqa: ANN401
    """A joint's name, its range and whether it slides."""
    above = f"robot.joints[{number}]."
    if not isinstance(entry, dict):
        message = f"'{above[:-1]}' is {_short(entry)}; a table is wanted."
        raise _DamagedError(message)
    unit = "m" if "low_m" in entry else "rad"
    ends = _number(entry, f"low_{unit}", above), _number(entry, f"high_{unit}", above)
    if not ends[0] <= ends[1]:
        message = f"'{above[:-1]}' goes from {ends[0]:g} to {ends[1]:g}; the lower end comes first."
        raise _DamagedError(message)
    return _get(entry, "name", str, above), ends, unit == "m"


def _box(table: Mapping[str, Any]) -> Array:
    """The box that the region ends at; null is a side without an end."""
    if "box_m" not in table:
        message = "'box_m' is missing."
        raise _DamagedError(message)
    corners = [[None] * 3] * 2 if table["box_m"] is None else _get(table, "box_m", list)
    if len(corners) != 2 or not all(isinstance(c, list) and len(c) == 3 for c in corners):
        message = (
            f"'box_m' is {_short(corners)}; two corners of three numbers, or null, are wanted."
        )
        raise _DamagedError(message)
    filled = [
        [end if v is None else _number({"v": v}, "v", f"box_m[{i}].") for v in corner]
        for i, (corner, end) in enumerate(zip(corners, (-math.inf, math.inf), strict=True))
    ]
    return checked_box(filled)


def _cells(table: Mapping[str, Any]) -> NDArray[np.bool_]:
    """The voxels from the lengths of their runs."""
    sides = _get(table, "shape", list)
    whole = all(isinstance(n, int) and not isinstance(n, bool) and n > 0 for n in sides)
    if len(sides) != 3 or not whole or math.prod(sides) > _MOST_VOXELS:
        message = f"'shape' is {_short(sides)}; three whole numbers greater than 0 are wanted."
        raise _DamagedError(message)
    runs = _get(table, "runs", list)
    if not all(isinstance(n, int) and not isinstance(n, bool) and n >= 0 for n in runs):
        message = "'runs' holds something that is no whole number of at least 0."
        raise _DamagedError(message)
    if sum(runs) != math.prod(sides):
        message = (
            f"'runs' make {sum(runs):,} voxels; the grid of {' x '.join(map(str, sides))} has "
            f"{math.prod(sides):,}."
        )
        raise _DamagedError(message)
    cells: NDArray[np.bool_] = np.repeat(np.arange(len(runs)) % 2 == 1, runs).reshape(sides)
    return cells


def _short(value: object) -> str:
    """A value as text that does not fill the screen."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
