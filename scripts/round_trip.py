"""Every robot of example-robot-data out and in again: written, read by Pinocchio, by yourdfpy and by check_urdf.

    python scripts/round_trip.py                         all of them, three corrections each
    python scripts/round_trip.py --robot panda --count 20

A URDF that is written without a correction must have the same bytes. Then every placement of the chain is corrected at
random; the file that is written is read by Pinocchio and yourdfpy, whose poses are compared with those of the robot in
memory, and by the program check_urdf. The exit code is 1 if a robot fails.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import logging
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
import yourdfpy
from numpy.typing import NDArray

from calib.errors import UrdfError
from calib.robot.readback import random_joint_values
from calib.robot.robot import Robot, rigid_inverse
from calib.robot.urdf import Urdf

Array = NDArray[np.float64]

#: Sizes of the corrections [m, rad]: those of a calibration, and those of another robot.
SIZES = ((0.5e-3, 3e-3), (0.2, 3.0), (1e-7, 1e-7))

#: Poses may differ by this [m; entries of the rotation].
TOLERANCE = 1e-9

_POSES = 5


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one URDF.

    Attributes:
        same: Whether it was written without a correction byte for byte.
        joints: Moving joints of the chain; 0 where there is none.
        pinocchio: Largest difference of an entry of the poses read by Pinocchio [m; rotation: 1].
        yourdfpy: The same by yourdfpy.
        checked: Whether check_urdf read every file, too; None if the program is not here or cannot read the original.
        remark: Why there is no chain.
    """

    same: bool
    joints: int = 0
    pinocchio: float = 0.0
    yourdfpy: float = 0.0
    checked: bool | None = None
    remark: str = ""

    @property
    def passed(self) -> bool:
        """Whether nothing is wrong."""
        close = max(self.pinocchio, self.yourdfpy) <= TOLERANCE
        return self.same and close and self.checked is not False


def urdf_files() -> Iterator[Path]:
    """The URDFs of example-robot-data."""
    for file in importlib.metadata.files("example-robot-data") or []:
        if file.suffix == ".urdf":
            yield Path(str(file.locate()))


def round_trip(path: Path, count: int, seed: int = 0) -> Outcome:
    """Write and read a URDF with ``count`` random corrections."""
    with tempfile.TemporaryDirectory() as folder:
        written = Path(folder) / "written.urdf"
        try:
            urdf = Urdf.read(path)
        except UrdfError as error:
            return Outcome(same=True, remark=str(error))
        urdf.write(written)
        same = written.read_bytes() == path.read_bytes()
        try:
            robot = Robot.from_urdf(urdf)
        except UrdfError as error:
            return Outcome(same, remark=str(error))
        origins = {joint.name: joint.T_parent_joint for joint in urdf.joints}
        same = same and urdf.with_origins(origins).data == urdf.data
        program = check_urdf()
        checked = None if program is None or not accepts(program, path) else True
        rng = np.random.default_rng(seed)
        off = [(0.0, 0.0)]
        for k in range(count):
            robot_k = corrected(robot, rng, *SIZES[k % len(SIZES)])
            robot_k.urdf.write(written, overwrite=True)
            q = random_joint_values(robot, _POSES, seed + k)
            expected = robot_k.poses(q)
            poses = (by_pinocchio(written, robot_k, q), by_yourdfpy(written, robot_k, q))
            off.append(
                (float(np.abs(poses[0] - expected).max()), float(np.abs(poses[1] - expected).max()))
            )
            if checked and program is not None:
                checked = accepts(program, written)
    first, second = np.max(off, axis=0)
    return Outcome(same, len(robot.joints), float(first), float(second), checked)


def corrected(robot: Robot, rng: np.random.Generator, length: float, angle: float) -> Robot:
    """The robot with every placement moved that an <origin> carries."""
    placements = robot.placements.copy()
    for i, carrier in enumerate(robot.carriers):
        if carrier is not None:
            turn = pin.exp3(angle * rng.normal(size=3))
            placements[i, :3, 3] += length * rng.normal(size=3)
            placements[i, :3, :3] = placements[i, :3, :3] @ turn
    return robot.with_placements(placements)


def by_pinocchio(path: Path, robot: Robot, q: Array) -> Array:
    """T_base_tip of a file as Pinocchio reads it, shape (N, 4, 4)."""
    model = pin.buildModelFromUrdf(str(path))
    data = model.createData()
    base, tip = (model.getFrameId(name, pin.FrameType.BODY) for name in (robot.base, robot.tip))
    poses = np.empty((len(q), 4, 4))
    values = robot.urdf_values(q)
    for n in range(len(q)):
        configuration = pin.neutral(model)
        for name, value in values.items():
            joint = model.getJointId(name)
            first = model.idx_qs[joint]
            two = model.nqs[joint] == 2
            configuration[first : first + model.nqs[joint]] = (
                (np.cos(value[n]), np.sin(value[n])) if two else value[n]
            )
        pin.framesForwardKinematics(model, data, configuration)
        poses[n] = rigid_inverse(data.oMf[base].homogeneous) @ data.oMf[tip].homogeneous
    return poses


def by_yourdfpy(path: Path, robot: Robot, q: Array) -> Array:
    """T_base_tip of a file as yourdfpy reads it, shape (N, 4, 4)."""
    logging.getLogger("yourdfpy.urdf").disabled = True
    model = yourdfpy.URDF.load(
        str(path), build_scene_graph=False, load_meshes=False, load_collision_meshes=False
    ).robot
    for joint in model.joints:  # each is given its value
        joint.mimic = None
    free = yourdfpy.URDF(model, load_meshes=False, load_collision_meshes=False)
    chain = robot.chain_values(q)
    poses = np.empty((len(q), 4, 4))
    for n in range(len(q)):
        values = dict(zip((joint.name for joint in robot.joints), chain[n], strict=True))
        for name in values:  # yourdfpy slides by q times the axis as it is written
            if free.joint_map[name].type == "prismatic":
                values[name] /= np.linalg.norm(free.joint_map[name].axis)
        free.update_cfg(values)
        poses[n] = rigid_inverse(free.get_transform(robot.base)) @ free.get_transform(robot.tip)
    return poses


def check_urdf() -> str | None:
    """The program check_urdf of urdfdom, which comes with Pinocchio; None if it is not here."""
    beside = Path(sys.executable).with_name("check_urdf")
    return str(beside) if beside.is_file() else shutil.which("check_urdf")


def accepts(program: str, path: Path) -> bool:
    """Whether check_urdf reads a file."""
    done = subprocess.run([program, str(path)], capture_output=True, timeout=60, check=False)
    return done.returncode == 0 and b"Successfully Parsed" in done.stdout


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--robot", action="append", help="part of the file's name; default all")
    parser.add_argument("--count", type=int, default=3, help="corrections of each robot")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    print(f"{'file':<44}{'bytes':>7}{'joints':>8}{'Pinocchio':>11}{'yourdfpy':>10}  check_urdf")
    failed = 0
    words = {True: "reads it", False: "FAILS", None: "not the original either"}
    for path in sorted(urdf_files()):
        name = "/".join(path.parts[-3:])
        if asked.robot and not any(part in name for part in asked.robot):
            continue
        found = round_trip(path, asked.count, asked.seed)
        failed += not found.passed
        line = f"{name[-43:]:<44}{'same' if found.same else 'DIFFER':>7}"
        if found.joints:
            line += f"{found.joints:>8}{found.pinocchio:>11.1e}{found.yourdfpy:>10.1e}  {words[found.checked]}"
        else:
            line += f"  no chain: {found.remark[:60]}"
        print(line, flush=True)
    print(f"{failed} failed" if failed else "all passed")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
