"""Sweeps of a virtual robot, and sweeps as a file: to try a set-up before it is measured, and for tests and studies."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.basics.arrays import read_only, rigid_inverse
from calib.robot.robot import Robot
from calib.verbs.base_frame.sweeps import PLANE, Sweep, Sweeps

Array = NDArray[np.float64]


def virtual_sweeps(
    robot: Robot,
    T_tracker_base: Array,
    sigma: float,
    *,
    arcs: Sequence[float] | Array,
    count: int = 40,
    radius: float = 0.3,
    plane_count: int = 20,
    plane_radius: float = 0.25,
    home: Sequence[float] | Array | None = None,
    values: bool = True,
    seed: int = 0,
) -> Sweeps:
    """Sweeps of the joints 1 to len(arcs) of a robot as a tracker would measure them.

    The plane is z = 0 of the base, its points scattered evenly over a disc. Each target is fixed to its joint's
    link, at the joint's frame and ``radius`` off the axis; the joint turns evenly over its arc, half to each side of
    its home (default: zero), where the others stand. Each coordinate has noise of ``sigma``; lengths are in m.
    """
    rng = np.random.default_rng(seed)
    rest = np.zeros(len(robot.joints)) if home is None else np.asarray(home, dtype=np.float64)

    def measured(points: Array) -> Array:
        """Points of the base as the tracker sees them."""
        seen = points @ T_tracker_base[:3, :3].T + T_tracker_base[:3, 3]
        return read_only(seen + sigma * rng.normal(size=seen.shape))

    at = plane_radius * np.sqrt(rng.uniform(size=plane_count))
    turn = rng.uniform(0.0, 2.0 * np.pi, size=plane_count)
    disc = np.column_stack([at * np.cos(turn), at * np.sin(turn), np.zeros(plane_count)])
    rows = iter(range(1, plane_count + count * len(arcs) + 1))

    def numbers(n: int) -> tuple[int, ...]:
        """The numbers of the next rows."""
        return tuple(next(rows) for _ in range(n))

    source = "virtual sweeps"
    sweeps = [Sweep(None, PLANE, measured(disc), None, None, numbers(plane_count), source)]
    for k, arc in enumerate(arcs):
        q = np.tile(rest, (count, 1))
        q[:, k] += np.linspace(-0.5 * arc, 0.5 * arc, count)
        points = np.array([_target(robot, k, row, radius) for row in q])
        sweeps.append(
            Sweep(
                k,
                robot.joint_names[k],
                measured(points),
                None,
                read_only(q) if values else None,
                numbers(count),
                source,
            )
        )
    return Sweeps(tuple(sweeps), robot.joint_names, source)


def _target(robot: Robot, joint: int, q: Array, radius: float) -> Array:
    """The place in the base of a target on a joint's link, shape (3,) [m]."""
    T = rigid_inverse(robot.T_root_base)
    for k in range(joint + 1):
        turned = np.eye(4)
        axis = np.asarray(robot.joints[k].axis)
        turned[:3, :3] = Rotation.from_rotvec(q[k] * axis).as_matrix()
        T = T @ robot.placements[k] @ turned
    axis = np.asarray(robot.joints[joint].axis)
    across = np.eye(3)[int(np.argmin(np.abs(axis)))]
    across = across - axis * (axis @ across)
    return np.asarray(T[:3, :3] @ (radius * across / np.linalg.norm(across)) + T[:3, 3])


def write_sweeps(sweeps: Sweeps, path: Path) -> None:
    """Write sweeps as a table in millimetres and degrees, with all digits."""
    with_joints = any(sweep.joints is not None for sweep in sweeps.sweeps)
    header = ["sweep", "x [mm]", "y [mm]", "z [mm]"]
    header += [f"{name} [deg]" for name in sweeps.joint_names] if with_joints else []
    lines = [",".join(header)]
    for sweep in sweeps.sweeps:
        for i, point in enumerate(sweep.points):
            cells = [sweep.name, *(repr(float(v)) for v in 1e3 * point)]
            if sweep.joints is not None:
                cells += [repr(float(v)) for v in np.degrees(sweep.joints[i])]
            elif with_joints:
                cells += [""] * len(sweeps.joint_names)
            lines.append(",".join(cells))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
