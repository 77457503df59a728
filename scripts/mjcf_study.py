"""How calib reads and corrects the MJCFs of a folder, by MuJoCo: a row for each arm.

    python scripts/mjcf_study.py FOLDER ...

calib reads each model that has at least three joints with one value on a chain from a fixed base, and MuJoCo does; the
bodies of the chain and its tip are compared at 20 poses. Then each placement of the chain is moved by about 0.5 mm and
0.01 rad, the corrected MJCF is written, MuJoCo reads that, and the tip must be where the moved robot has it. Numbers
are the largest differences of an entry of a pose [m; rotations: 1]. A model whose meshes are missing (*) is read by
MuJoCo without them, and its tip is compared. Models without such a chain, and those that MuJoCo does not compile, are
counted; what calib refuses is listed. The exit status is 1 if a difference is above 1e-9.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array, rigid_inverse
from calib.errors import CalibError
from calib.robot.mjcf import WORLD, Mjcf
from calib.robot.mjcf_files import is_mjcf
from calib.robot.mjcf_readback import poses_by_mujoco
from calib.robot.mjcf_write import write_mjcf
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot

#: Largest difference of an entry of a pose that counts as the same [m; rotations: 1].
SAME = 1e-9

#: Poses at which they are compared.
POSES = 20

#: Fewest joints of an arm.
FEWEST = 3


def main() -> None:
    """Print a row for each arm below the folders."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("folders", nargs="+", type=Path, metavar="FOLDER")
    folders = parser.parse_args().folders
    refused: list[str] = []
    counts = {"arms": 0, "not compiled by MuJoCo": 0, "no arm on a fixed base": 0}
    worst = 0.0
    print(f"{'model':60} {'tip':28} joints bodies+sites    read  corrected")
    for path in sorted(file for folder in folders for file in folder.rglob("*.xml")):
        if not is_mjcf(path.read_bytes()):
            continue
        try:
            compiled = mujoco.MjModel.from_xml_path(str(path))
        except ValueError as error:
            if "Error opening file" not in str(error):
                counts["not compiled by MuJoCo"] += 1
                continue
            compiled = None
        name = "/".join(path.parts[-3:])
        try:
            robot = Robot.load(path)
        except CalibError as error:
            if "no joint moves" in str(error) or "has a joint" in str(error):
                counts["no arm on a fixed base"] += 1
            else:
                refused.append(f"{name}: {error}")
            continue
        if len(robot.joint_names) < FEWEST:
            counts["no arm on a fixed base"] += 1
            continue
        counts["arms"] += 1
        model = Mjcf.read(path)
        if compiled is not None:
            read = largest_difference(compiled, model, robot)
        else:
            name = f"{name} *"
            q = random_joint_values(robot)[:POSES]
            read = float(np.abs(poses_by_mujoco(model, robot, q) - robot.poses(q)).max())
        corrected = difference_of_corrected(model, robot)
        worst = max(worst, read, corrected)
        links = f"{len(model.bodies)}+{len(model.sites)}"
        joints = len(robot.joint_names)
        print(
            f"{name[-60:]:60} {robot.tip[-28:]:28} {joints:6} {links:>12} {read:7.0e}  {corrected:7.0e}"
        )
    print(f"\n{', '.join(f'{count} {what}' for what, count in counts.items())}")
    print("\n".join([f"{len(refused)} refused by calib", *refused]))
    sys.exit(worst > SAME)


def largest_difference(compiled: mujoco.MjModel, model: Mjcf, robot: Robot) -> float:
    """Return how far bodies, sites and tip are off by calib and by MuJoCo, at most."""
    data = mujoco.MjData(compiled)
    names = [joint.name for body in model.bodies for joint in body.joints]
    q = random_joint_values(robot)[:POSES]
    values = robot.urdf_values(q)
    order = [WORLD, *(body.name for body in model.bodies)]
    if (len(names), len(order)) != (compiled.njnt, compiled.nbody):
        return np.inf
    worst = 0.0
    # The links of the chain, each as the tip of a chain of its own.
    above = {body.name: body.parent for body in model.bodies}
    bodies = []
    body = next((site.parent for site in model.sites if site.name == robot.tip), robot.tip)
    while body in above:
        bodies.append(body)
        body = above[body]
    for row in range(len(q)):
        for number, name in enumerate(names):
            if name in values:
                data.qpos[compiled.jnt_qposadr[number]] = values[name][row]
        mujoco.mj_kinematics(compiled, data)
        if row == 0:
            poses = {}
            for link in bodies:
                try:
                    chain = Robot.from_urdf(robot.urdf, robot.base, link)
                except CalibError:  # nothing moves before it
                    continue
                columns = [robot.joint_names.index(name) for name in chain.joint_names]
                poses[link] = chain.poses(q[:, columns])
            tip_poses = robot.poses(q)
        for link, of_link in poses.items():
            number = order.index(link)
            T = pose(data.xpos[number], data.xmat[number])
            worst = max(worst, float(np.abs(T - of_link[row]).max()))
        site = mujoco.mj_name2id(compiled, mujoco.mjtObj.mjOBJ_SITE, robot.tip)
        if site >= 0 and robot.tip not in order:
            T = pose(data.site_xpos[site], data.site_xmat[site])
            worst = max(worst, float(np.abs(T - tip_poses[row]).max()))
    return worst


def pose(position: Array, matrix: Array) -> Array:
    """Return a pose (4, 4) [m] of a position (3,) and the nine numbers of a rotation."""
    T = np.eye(4)
    T[:3, :3] = matrix.reshape(3, 3)
    T[:3, 3] = position
    return T


def difference_of_corrected(model: Mjcf, robot: Robot) -> float:
    """Return how far the tip is off by MuJoCo, at most, in the corrected MJCF of a robot with moved placements."""
    rng = np.random.default_rng(1)
    placements = robot.placements.copy()
    for i, carrier in enumerate(robot.carriers):
        if carrier is not None:
            change = np.eye(4)
            change[:3, :3] = Rotation.from_rotvec(rng.normal(0.0, 0.01, 3)).as_matrix()
            change[:3, 3] = rng.normal(0.0, 0.0005, 3)
            placements[i] = placements[i] @ change
    moved = robot.with_placements(placements)
    q = random_joint_values(moved)[:POSES]
    expected = np.array([product(moved, values) for values in moved.chain_values(q)])
    with tempfile.TemporaryDirectory() as folder:
        written = write_mjcf(model, moved, q, expected, Path(folder) / "c.xml", overwrite=False)
        poses = poses_by_mujoco(Mjcf.read(written.paths[0]), moved, q)
    return float(np.abs(poses - expected).max())


def product(robot: Robot, values: Array) -> Array:
    """Return T_base_tip (4, 4) [m] as the product of placements and motions by n joint values, written out."""
    T = rigid_inverse(robot.T_root_base)
    for joint, placement, value in zip(robot.joints, robot.placements, values, strict=False):
        motion = np.eye(4)
        if joint.type == "prismatic":
            motion[:3, 3] = value * joint.axis
        else:
            motion[:3, :3] = Rotation.from_rotvec(value * joint.axis).as_matrix()
        T = T @ placement @ motion
    return np.asarray(T @ robot.placements[-1])


if __name__ == "__main__":
    main()
