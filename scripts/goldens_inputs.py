"""Files that the commands of goldens.py begin with: the paper's, and small ones drawn with a seed."""

from __future__ import annotations

import csv
import re
import shutil
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from goldens_chain import Array, Joint, chain_of, forward, read_joints
from scipy.spatial.transform import Rotation

ROOT = Path(__file__).resolve().parents[1]

#: Commands, and after `# Files` the texts of small files.
CASES = Path(__file__).with_name("goldens_cases.txt")

#: Joints of the UR3, in the order of the chain.
JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)

#: Columns of joint values.
JOINT_COLUMNS = tuple(f"{name} [deg]" for name in JOINTS)

#: Columns of points in the paper's table.
POINT_COLUMNS = ("x [mm]", "y [mm]", "z [mm]")

#: Target of the contacts, in the tip [m].
CONTACT_TARGET = np.array([0.05, 0.05, 0.05])

#: Target of the sweeps, in the tip [m].
SWEEP_TARGET = np.array([0.2, 0.1, 0.15])

#: Sockets of the contacts in the base [m]; each holds the target along x, y and z.
SOCKETS = np.array([[-0.3, -0.1, 0.2], [-0.3, -0.15, 0.2], [-0.15, -0.3, 0.35]])

#: Points of horizontal planes in the base [m]; each holds the target along z.
PLANES = np.array([[0.0, 0.0, 0.15], [0.0, 0.0, 0.3]])

#: Joint values between which the search for contacts starts [rad].
CONTACT_STARTS = ([-2, -2.2, 0.3, -2.5, -2.5, -2.5], [1, -0.6, 2.0, 0, 2.5, 2.5])

#: Rows of the sweeps with gross errors.
BAD_ROWS = (33, 75)


@dataclass(frozen=True)
class Arm:
    """The UR3 between `base` and a tip."""

    T_base_first: Array  # shape (4, 4), pose of the chain's first link [m]
    chain: tuple[Joint, ...]

    @classmethod
    def read(cls, path: Path) -> Arm:
        """Return the nominal arm of a URDF."""
        joints = read_joints(path)
        T_first_base = forward(chain_of(joints, "base", "base_link"), {})
        return cls(
            np.asarray(np.linalg.inv(T_first_base)), tuple(chain_of(joints, "tool0", "base_link"))
        )

    def with_errors(self, rng: np.random.Generator) -> Arm:
        """Return the arm with errors of 3 mrad and 0.3 mm in all placements."""
        chain = []
        for joint in self.chain:
            error = np.eye(4)
            error[:3, :3] = Rotation.from_rotvec(3e-3 * rng.standard_normal(3)).as_matrix()
            error[:3, 3] = 3e-4 * rng.standard_normal(3)
            chain.append(replace(joint, origin=joint.origin @ error))
        return replace(self, chain=tuple(chain))

    def point(self, q: Array, target: Array) -> Array:
        """Return the position of a target of the tip in the base, shape (3,), [m]."""
        pose = self.T_base_first @ forward(self.chain, dict(zip(JOINTS, q, strict=True)))
        return np.asarray(pose[:3] @ [*target, 1.0])

    def reach(self, q: Array, place: Array, axes: Sequence[int]) -> Array | None:
        """Find joint values at which the target of the contacts is at a place, by Newton's method.

        Args:
            q: shape (6,), joint values to start from [rad].
            place: shape (3,), in the base [m].
            axes: Axes of the base along which it is there.

        Returns:
            Joint values, shape (6,), [rad]; None if it does not succeed.
        """
        for _ in range(12):
            missing = (place - self.point(q, CONTACT_TARGET))[axes]
            if np.abs(missing).max() < 1e-10:
                return q
            columns = []
            for step in 1e-6 * np.eye(6):
                after = self.point(q + step, CONTACT_TARGET)
                columns.append(after - self.point(q - step, CONTACT_TARGET))
            J = np.transpose(columns)[axes] / 2e-6
            q = q + np.linalg.pinv(J, rcond=1e-2) @ missing
        return None


def write_inputs(folder: Path, data: Path | None) -> None:
    """Write all files.

    Args:
        folder: Folder for the files.
        data: Folder of real data, whose files are copied; None: there are none.
    """
    shutil.copy(ROOT / "urdf" / "ur3.urdf", folder / "robot.urdf")
    shutil.copy(ROOT / "calib" / "example" / "ur3_leica.csv", folder / "data.csv")
    write_small_files(folder)
    arm = Arm.read(folder / "robot.urdf")
    rng = np.random.default_rng(5)
    write_contacts(folder, arm.with_errors(rng), rng)
    write_sweeps(folder, arm, rng)
    write_points_apart(folder)
    if data is not None:
        copy_real_data(folder, data)


def write_small_files(folder: Path) -> None:
    """Write the files whose text is among the cases."""
    text = CASES.read_text(encoding="utf-8").split("\n# Files\n")[1]
    _, *parts = re.split(r"(?m)^== (\S+)\n", text)
    for name, content in zip(parts[::2], parts[1::2], strict=True):
        (folder / name).write_text(content, encoding="utf-8")


def write_contacts(folder: Path, arm: Arm, rng: np.random.Generator) -> None:
    """Write joint values at which the target is in one of three sockets, or on one of two planes."""
    for kind, places, axes in (("fixed", SOCKETS, [0, 1, 2]), ("plane", PLANES, [2])):
        rows = [["group", *JOINT_COLUMNS]]
        for group, place in enumerate(places):
            while len(rows) <= 20 * (group + 1):
                start = rng.uniform(*CONTACT_STARTS)
                q = arm.reach(start, place + 2e-5 * rng.standard_normal(3), axes)
                if q is not None:
                    rows.append([f"s{group}", *_degrees(q)])
        write_rows(folder / f"{kind}.csv", rows)


def write_sweeps(folder: Path, arm: Arm, rng: np.random.Generator) -> None:
    """Write points of the mounting plane and of sweeps of all joints in a tracker's frame.

    One table has the plane and two sweeps without joint values, the other all sweeps with them.
    """
    R = Rotation.from_rotvec([0.1, -0.2, 2.0]).as_matrix()
    t = np.array([2.1, 0.4, -0.5])
    plain = [["sweep", *POINT_COLUMNS]]
    full = [["sweep", *POINT_COLUMNS, *JOINT_COLUMNS]]
    for number, (name, point, q) in enumerate(_sweep_rows(arm, rng)):
        seen = R @ (point + 3e-5 * rng.standard_normal(3)) + t
        if number in BAD_ROWS:
            seen += [0.0, 0.0, 5e-4]
        cells = [f"{1e3 * value:.6f}" for value in seen]
        if name == "plane":
            plain.append([name, *cells])
        elif name in JOINTS[:2]:
            plain.append([f"joint {JOINTS.index(name) + 1}", *cells])
        full.append([name, *cells, *(_degrees(q) if q is not None else [""] * 6)])
    write_rows(folder / "sweeps.csv", plain)
    write_rows(folder / "sweeps_joints.csv", full)


def _sweep_rows(arm: Arm, rng: np.random.Generator) -> list[tuple[str, Array, Array | None]]:
    """Return sweep, point in the base [m] and joint values [rad] of each row; the plane has no joint values."""
    plane = [np.array([*rng.uniform(-0.25, 0.25, 2), 0.0]) for _ in range(20)]
    rows: list[tuple[str, Array, Array | None]] = [("plane", point, None) for point in plane]
    for joint, name in enumerate(JOINTS):
        first, last = (-180, 0) if name == "shoulder_lift_joint" else (-135, 135)
        for angle in np.radians(np.linspace(first, last, 40)):
            q = angle * np.eye(6)[joint]
            rows.append((name, arm.point(q, SWEEP_TARGET), q))
    return rows


def write_points_apart(folder: Path) -> None:
    """Write the paper's table as joint values with the names of points, and a tracker's file of these points."""
    with (folder / "data.csv").open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    joints = [i for i, name in enumerate(header) if name not in POINT_COLUMNS]
    listed = [["point", *(header[i] for i in joints)]]
    points = []
    for number, row in enumerate(rows, 1):
        listed.append([f"P{number}", *(row[i] for i in joints)])
        place = " ".join(row[header.index(name)] for name in POINT_COLUMNS)
        points.append(f"A::Main::P{number} {place}")
    write_rows(folder / "joints.csv", listed)
    text = "\n".join(["// Units: mm", *reversed(points), ""])
    (folder / "tracker.txt").write_text(text, encoding="utf-8")


def copy_real_data(folder: Path, data: Path) -> None:
    """Copy the real data, each file with its folder's name before its own, and a part of a long table."""
    for path in data.rglob("*"):
        if path.suffix in (".csv", ".urdf", ".conf"):
            shutil.copy(path, folder / f"{path.parent.name}_{path.name}")
    long = folder / "ipa_ur10_series_C.csv"
    if long.is_file():
        head, *rows = long.read_text(encoding="utf-8").splitlines()
        part = "\n".join([head, *rows[::15], ""])
        (folder / "ur10_part.csv").write_text(part, encoding="utf-8")


def write_rows(path: Path, rows: Iterable[Sequence[str]]) -> None:
    """Write a CSV table."""
    path.write_text("".join(",".join(row) + "\n" for row in rows), encoding="utf-8")


def _degrees(q: Array) -> list[str]:
    """Return angles [rad] as texts in degrees."""
    return [f"{value:.6f}" for value in np.degrees(q)]
