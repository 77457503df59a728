"""The files that the commands of goldens.py begin with: the paper's, and small ones drawn with a seed."""

from __future__ import annotations

import csv
import re
import shutil
from pathlib import Path

import numpy as np
from goldens_numbers import Step, by_child, forward, steps
from scipy.spatial.transform import Rotation

ROOT = Path(__file__).resolve().parents[1]
CASES = Path(__file__).with_name("goldens_cases.txt")
JOINTS = [
    f"{name}_joint"
    for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
]


def prepare(folder: Path, data: Path | None) -> None:
    """The paper's robot and table and what is made of them; the real data, if they were given."""
    shutil.copy(ROOT / "urdf" / "ur3.urdf", folder / "robot.urdf")
    shutil.copy(ROOT / "calib" / "example" / "ur3_leica.csv", folder / "data.csv")
    blocks = re.split(
        r"(?m)^== (\S+)\n", CASES.read_text(encoding="utf-8").split("\n# Files\n")[1]
    )[1:]
    for name, text in zip(blocks[::2], blocks[1::2], strict=True):
        (folder / name).write_text(text, encoding="utf-8")
    joints = by_child(folder / "robot.urdf")
    chain = steps(joints, "tool0", "base_link")
    turned = np.linalg.inv(forward(steps(joints, "base", "base_link"), {}))
    random = np.random.default_rng(5)
    write_contacts(folder, turned, chain, random)
    write_sweeps(folder, turned, chain, random)
    with (folder / "data.csv").open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    kept = [i for i, name in enumerate(header) if name not in ("x [mm]", "y [mm]", "z [mm]")]
    listed = [
        ["point", *(header[i] for i in kept)],
        *([f"P{n}", *(r[i] for i in kept)] for n, r in enumerate(rows, 1)),
    ]
    write_rows(folder / "joints.csv", listed)
    points = [
        f"A::Main::P{n} {' '.join(r[header.index(f'{a} [mm]')] for a in 'xyz')}"
        for n, r in enumerate(rows, 1)
    ]
    (folder / "tracker.txt").write_text(
        "\n".join(["// Units: mm", *points[::-1], ""]), encoding="utf-8"
    )
    for path in data.rglob("*") if data else ():
        if path.suffix in (".csv", ".urdf", ".conf"):
            shutil.copy(path, folder / f"{path.parent.name}_{path.name}")
    ipa = folder / "ipa_ur10_series_C.csv"
    if ipa.is_file():
        head, *rest = ipa.read_text(encoding="utf-8").splitlines()
        (folder / "ur10_part.csv").write_text("\n".join([head, *rest[::15], ""]), encoding="utf-8")


def write_rows(path: Path, rows: list[list[str]]) -> None:
    """A CSV table."""
    path.write_text("".join(",".join(row) + "\n" for row in rows), encoding="utf-8")


def arm(turned: np.ndarray, chain: list[Step], q: np.ndarray, target: list[float]) -> np.ndarray:
    """A target of the UR3 in its base."""
    pose: np.ndarray = turned @ forward(chain, dict(zip(JOINTS, q, strict=True)))
    return np.asarray(pose[:3] @ [*target, 1.0])


def write_contacts(
    folder: Path, turned: np.ndarray, chain: list[Step], random: np.random.Generator
) -> None:
    """Joint values of a UR3 with errors of its own whose target sits in three sockets, or on two planes."""
    wrong: list[Step] = []
    for name, kind, along, placed in chain:
        off = np.eye(4)
        off[:3, :3] = Rotation.from_rotvec(3e-3 * random.standard_normal(3)).as_matrix()
        off[:3, 3] = 3e-4 * random.standard_normal(3)
        wrong.append((name, kind, along, placed @ off))
    sockets = [[-0.3, -0.1, 0.2], [-0.3, -0.15, 0.2], [-0.15, -0.3, 0.35]]
    for kind, places, axes in (
        ("fixed", sockets, [0, 1, 2]),
        ("plane", [[0, 0, 0.15], [0, 0, 0.3]], [2]),
    ):
        rows = [["group", *(f"{name} [deg]" for name in JOINTS)]]
        for group, place in enumerate(places):
            while len(rows) <= 20 * (group + 1):
                start = random.uniform(
                    [-2, -2.2, 0.3, -2.5, -2.5, -2.5], [1, -0.6, 2.0, 0, 2.5, 2.5]
                )
                where = np.array(place) + 2e-5 * random.standard_normal(3)
                found = root(wrong, turned, start, where, axes)
                rows += (
                    [[f"s{group}", *(f"{v:.6f}" for v in np.degrees(found))]]
                    if found is not None
                    else []
                )
        write_rows(folder / f"{kind}.csv", rows)


def root(
    chain: list[Step], turned: np.ndarray, q: np.ndarray, where: np.ndarray, axes: list[int]
) -> np.ndarray | None:
    """Joint values near others at which the target is at a place along some axes, by Newton's steps of least length."""
    for _ in range(12):
        missing = (where - arm(turned, chain, q, [0.05, 0.05, 0.05]))[axes]
        if np.abs(missing).max() < 1e-10:
            return q
        slopes = np.array(
            [
                arm(turned, chain, q + 1e-6 * e, [0.05, 0.05, 0.05])
                - arm(turned, chain, q - 1e-6 * e, [0.05, 0.05, 0.05])
                for e in np.eye(6)
            ]
        )
        q = q + np.linalg.pinv(slopes.T[axes] / 2e-6, rcond=1e-2) @ missing
    return None


def write_sweeps(
    folder: Path, turned: np.ndarray, chain: list[Step], random: np.random.Generator
) -> None:
    """Points on the mounting plane and sweeps of all joints, in a tracker's frame, with and without joint values."""
    rotation, place = Rotation.from_rotvec([0.1, -0.2, 2.0]).as_matrix(), np.array([2.1, 0.4, -0.5])
    rows = [
        ("plane", np.array([*random.uniform(-0.25, 0.25, 2), 0.0]), np.full(6, np.nan))
        for _ in range(20)
    ]
    for i, name in enumerate(JOINTS):
        for value in np.radians(np.linspace(-180, 0, 40) if i == 1 else np.linspace(-135, 135, 40)):
            q = value * np.eye(6)[i]
            rows.append((name, arm(turned, chain, q, [0.2, 0.1, 0.15]), q))
    plain = [["sweep", "x [mm]", "y [mm]", "z [mm]"]]
    full = [[*plain[0], *(f"{name} [deg]" for name in JOINTS)]]
    for number, (name, point, q) in enumerate(rows):
        seen = rotation @ (point + 3e-5 * random.standard_normal(3)) + place
        seen += [0, 0, 5e-4] if number in (33, 75) else 0  # two gross errors
        cells = [f"{1e3 * v:.6f}" for v in seen]
        if name in ("plane", *JOINTS[:2]):
            plain.append([f"joint {JOINTS.index(name) + 1}" if name in JOINTS else name, *cells])
        full.append([name, *cells, *("" if np.isnan(v) else f"{v:.6f}" for v in np.degrees(q))])
    write_rows(folder / "sweeps.csv", plain)
    write_rows(folder / "sweeps_joints.csv", full)
