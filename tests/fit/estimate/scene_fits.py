"""Fits to tables of a scene, and their errors against its truth."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from calib.data.cell import Cell, Priors
from calib.fit.estimate.fitting import fit
from calib.fit.estimate.task import Task
from calib.fit.registration.setup import known_distances
from calib.fit.registration.table_rows import rows_and_setup
from calib.robot.ranges import random_joint_values

OFF = Priors(source="off")


FREE = Cell(estimate_frame=True, priors=OFF)


def task_of(scene, table, cell, model="dh", **options):
    rows, setup = rows_and_setup(scene.robot, table, cell)
    task = Task(scene.robot, cell, setup, model, known_distances(cell, setup), **options)
    return task, rows


def fitted(scene, table, cell, model="dh", **options):
    task, rows = task_of(scene, table, cell, model, **options)
    return fit(task, rows), rows


def errors(scene, found, *, placed=True, target=0):
    """Predicted minus true target on unseen poses; as one body moved onto the truth where nothing tells its place."""
    q = random_joint_values(scene.robot, 60, 77)
    samples = scene.samples(60, q=q)
    number = found.setup.targets.index(f"t{target}")
    mine = found.tip_poses(samples) @ found.estimated_setup().T_tip_target[number]
    true = scene.tip(q) @ scene.kinematics.T_tip_target[target]
    if placed:
        group = int(found.setup.groups[0])
        mine = found.estimated_setup().T_frame_base[0] @ mine
        true = scene.kinematics.T_frame_base[group] @ true
        return mine[:, :3, 3] - true[:, :3, 3]
    a, b = (T[:, :3, 3] - T[:, :3, 3].mean(axis=0) for T in (mine, true))
    return Rotation.align_vectors(b, a)[0].apply(a) - b


def sockets(make_scene, seed, count, **options):
    """Frames that lie in easy reach, turned anyhow."""
    rng = np.random.default_rng(seed)
    frames = [make_scene(100 * seed + k).kinematics.T_frame_base[0].copy() for k in range(count)]
    for T in frames:
        T[:3, 3] = -T[:3, :3] @ (np.array([0.3, 0.0, 0.15]) + rng.uniform(-0.15, 0.15, 3))
    return make_scene(seed, frames=frames, **options)
