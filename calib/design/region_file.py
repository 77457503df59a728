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

from calib.design.region import Region
from calib.errors import CalibError, FileError, choices
from calib.model.files import json_bytes, read_json, write_atomically
from calib.model.robot import Robot, read_only
from calib.version import __version__

SCHEMA = "region 1"

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
        box = [[v if math.isfinite(v) else None for v in corner] for corner in region.box.tolist()]
        return {
            "schema": SCHEMA,
            "calib": __version__,
            "robot": {"name": self.robot, "base": self.base, "tip": self.tip, "joints": joints},
            "target_xyz_m": self.target.tolist(),
            "samples": self.samples,
            "seed": self.seed,
            "share": region.share,
            "held": region.held,
            "volume_m3": region.volume,
            "box_m": box if np.isfinite(region.box).any() else None,
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
        except (CalibError, KeyError, TypeError, ValueError, OverflowError) as error:
            what = f"{error} is missing." if isinstance(error, KeyError) else f"{error}"
            raise FileError(
                f"{path}: the region is damaged: {what} Write it again with 'calib workspace -o'."
            ) from error

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
                raise CalibError(
                    f"The region was made for the {what} '{there}' of '{self.robot}', and the {what} is '{here}' now. "
                    f"Give {option} {there}, or make the region again with 'calib workspace'."
                )
        if robot.joint_names != self.joints:
            raise CalibError(
                f"The region was made for the joints {choices(self.joints)} of '{self.robot}'; the chain "
                f"'{robot.base}' to '{robot.tip}' of '{robot.name}' has {choices(robot.joint_names)}. Give the "
                "same --hold, or make the region again with 'calib workspace'."
            )
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


def _runs(cells: NDArray[np.bool_]) -> list[int]:
    """Voxels in the order of the last index first, as lengths of runs: outside, inside, outside, ..."""
    flat = cells.ravel()
    ends = np.flatnonzero(np.diff(flat)) + 1
    lengths: list[int] = np.diff([0, *ends.tolist(), flat.size]).tolist()
    return [0, *lengths] if flat[0] else lengths


def _parsed(table: Mapping[str, Any]) -> RegionFile:
    """The region of a file's tables.

    Raises:
        KeyError, TypeError, ValueError: A key is missing or its value is of another kind.
        CalibError: The values do not make a region.
    """
    robot, runs = table["robot"], np.asarray(table["runs"], dtype=np.int64)
    units = ["m" if "low_m" in joint else "rad" for joint in robot["joints"]]
    ends = [
        [joint[f"low_{unit}"], joint[f"high_{unit}"]]
        for joint, unit in zip(robot["joints"], units, strict=True)
    ]
    # null is a side without an end.
    box = np.asarray(table["box_m"] or [[None] * 3] * 2, dtype=np.float64)
    names = tuple(str(joint["name"]) for joint in robot["joints"])
    return RegionFile(
        region=Region(
            origin=np.asarray(table["origin_m"], dtype=np.float64),
            voxel=float(table["voxel_m"]),
            cells=np.repeat(np.arange(len(runs)) % 2 == 1, runs).reshape(table["shape"]),
            share=float(table["share"]),
            held=float(table["held"]),
            box=np.where(np.isnan(box), [[-np.inf], [np.inf]], box),
        ),
        robot=str(robot["name"]),
        base=str(robot["base"]),
        tip=str(robot["tip"]),
        joints=names,
        ranges=read_only(np.asarray(ends, dtype=np.float64).reshape(len(names), 2)),
        prismatic=tuple(name for name, unit in zip(names, units, strict=True) if unit == "m"),
        target=read_only(np.asarray(table["target_xyz_m"], dtype=np.float64).reshape(3)),
        samples=int(table["samples"]),
        seed=int(table["seed"]),
    )
