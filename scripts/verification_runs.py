"""One virtual calibration of each kind of measurement, its errors on unseen poses, and the Cramer-Rao bound of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from verification_truth import Truth, frame, joints_of

from calib.calibration import Calibration
from calib.data.cell import Cell, GroupDistance
from calib.data.measurements import Measurements
from calib.model.error_model import error_model
from calib.model.kinematics import Kinematics, Samples
from calib.model.observability import rank_by_gap, steps
from calib.robot.robot import read_only

Array = NDArray[np.float64]

#: Unseen poses, the same number everywhere.
UNSEEN = 200

#: How well the distances between sockets are known [m].
BAR_SIGMA = 5e-6


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """A table, what is said of it, and what is true.

    Attributes:
        truth: The robot.
        measurements: The table.
        cell: The set-up, as given to calib.
        q: shape (M, m), unseen poses.
        true: shape (M, 4, 4), where the first target is there, in the first frame [m].
        bound: Mean square of the smallest position error on them that an unbiased fit can have [m^2].
        bound_angle: The same of angles [rad^2]; 0 where none is measured.
        free: What the measurements do not tell: "" nothing, "motion" where the base is, "scale" its scale neither.
    """

    truth: Truth
    measurements: Measurements
    cell: Cell
    q: Array
    true: Array
    bound: float
    bound_angle: float
    free: str

    def residuals(self, result: Calibration) -> Array:
        """Predicted minus true positions at the unseen poses, (M, 3) [m], what is free fitted away."""
        return _aligned(result.predict(self.q), self.true[:, :3, 3], self.free)

    def angles(self, result: Calibration) -> Array:
        """Angles between predicted and true orientation there, (M,) [rad]."""
        R = result.predict_poses(self.q)[:, :3, :3]
        turned = R.transpose(0, 2, 1) @ self.true[:, :3, :3]
        return np.array([float(np.linalg.norm(pin.log3(one))) for one in turned])


def points_run(
    truth: Truth,
    rng: np.random.Generator,
    count: int,
    sigma: float,
    *,
    tracker: bool = False,
    setups: int = 1,
    model: str = "dh",
    displaced: float = 0.0,
) -> Run:
    """Positions of one or more targets, in the base's frame or in those of one or more trackers.

    Args:
        truth: The robot.
        rng: Random numbers.
        count: Number of rows.
        sigma: Noise of a coordinate [m].
        tracker: Whether the measurement frame is another than the base, and unknown.
        setups: How many trackers' places there are.
        model: The model that the bound is computed for; the robot's errors belong to it.
        displaced: Share of rows that are displaced by 5 to 50 mm.
    """
    q, q_unseen = joints_of(truth.nominal, count, rng), joints_of(truth.nominal, UNSEEN, rng)
    targets = len(truth.targets)
    of_target, of_frame = np.arange(count) % targets, (np.arange(count) // targets) % setups
    frames = np.array([frame(rng) if tracker else np.eye(4) for _ in range(setups)])
    points = _seen(frames[of_frame], truth.points(q, of_target))
    points = points + sigma * rng.normal(size=points.shape)
    gross = rng.permutation(count)[: round(displaced * count)]
    if len(gross):
        away = rng.normal(size=(len(gross), 3))
        away /= np.linalg.norm(away, axis=1)[:, None]
        points[gross] += away * rng.uniform(5e-3, 50e-3, size=(len(gross), 1))
    names = tuple(f"target_{k}" for k in range(targets))
    groups = tuple(f"setup_{k}" for k in range(setups))
    table = Measurements(
        truth.nominal.joint_names,
        q,
        points,
        targets=tuple(names[k] for k in of_target) if targets > 1 else (),
        groups=tuple(groups[k] for k in of_frame) if setups > 1 else (),
    )
    kinematics = _at_truth(truth, model, frames, tracker=tracker)
    where = Samples(q, of_frame, of_target, _load(truth, q, model))
    _, twists = kinematics.twists(_x(truth, kinematics), where)
    J = twists[:, :3].reshape(-1, twists.shape[2]) / sigma
    cell = Cell(estimate_frame=tracker, payload=None)
    return _run(truth, table, cell, q_unseen, kinematics, J, model=model)


def poses_run(
    truth: Truth, rng: np.random.Generator, count: int, sigma: float, sigma_angle: float
) -> Run:
    """Positions and orientations in a tracker's frame."""
    q, q_unseen = joints_of(truth.nominal, count, rng), joints_of(truth.nominal, UNSEEN, rng)
    frames = frame(rng)[None]
    T = frames[0] @ truth.poses(q)
    turned = [pin.exp3(sigma_angle * rng.normal(size=3)) @ R for R in T[:, :3, :3]]
    table = Measurements(
        truth.nominal.joint_names,
        q,
        T[:, :3, 3] + sigma * rng.normal(size=(count, 3)),
        kinds=("pose",) * count,
        rotations=np.array(turned),
    )
    kinematics = _at_truth(truth, "dh", frames, tracker=True, rotation=True)
    _, twists = kinematics.twists(_x(truth, kinematics), Samples.at(q))
    scale = np.repeat([sigma, sigma_angle], 3)[None, :, None]
    J = (twists / scale).reshape(-1, twists.shape[2])
    return _run(truth, table, Cell(estimate_frame=True), q_unseen, kinematics, J, rotation=True)


def lengths_run(truth: Truth, rng: np.random.Generator, count: int, sigma: float, kind: str) -> Run:
    """Distances to three anchors that no one knows the place of, or between the targets of two rows.

    Args:
        truth: The robot.
        rng: Random numbers.
        count: Number of lengths.
        sigma: Their noise [m].
        kind: ``"distance"`` or ``"pair"``.
    """
    rows = count if kind == "distance" else 2 * count
    q, q_unseen = joints_of(truth.nominal, rows, rng), joints_of(truth.nominal, UNSEEN, rng)
    kinematics = _at_truth(truth, "dh", np.eye(4)[None], tracker=False)
    _, twists = kinematics.twists(_x(truth, kinematics), Samples.at(q))
    p = truth.points(q)
    noise = sigma * rng.normal(size=count)
    if kind == "distance":
        anchors = np.array([[0.9, 0.2, 0.1], [-0.4, 0.9, 0.3], [-0.2, -0.8, 0.8]])
        which = np.arange(rows) % 3
        between = p - anchors[which]
        lengths = np.linalg.norm(between, axis=1)
        u = between / lengths[:, None]
        J = np.einsum("ni,nip->np", u, twists[:, :3])
        moved = np.zeros((rows, 9))
        for k in range(3):
            moved[which == k, 3 * k : 3 * k + 3] = -u[which == k]
        J = np.column_stack([J, moved]) / sigma
        table = Measurements(
            truth.nominal.joint_names,
            q,
            np.zeros((rows, 3)),
            kinds=("distance",) * rows,
            distances=lengths + noise,
            groups=tuple(f"wire_{k}" for k in which),
        )
    else:
        between = p[0::2] - p[1::2]
        lengths = np.linalg.norm(between, axis=1)
        u = between / lengths[:, None]
        J = np.einsum("ni,nip->np", u, twists[0::2, :3] - twists[1::2, :3]) / sigma
        table = Measurements(
            truth.nominal.joint_names,
            q,
            np.zeros((rows, 3)),
            kinds=("pair",) * rows,
            distances=np.repeat(lengths + noise, 2),
            pairs=tuple(f"bar_{k // 2}" for k in range(rows)),
        )
    return _run(truth, table, Cell(), q_unseen, kinematics, J, free="motion")


def touching_run(
    truth: Truth, rng: np.random.Generator, count: int, sigma: float, kind: str
) -> Run:
    """The target in four sockets whose distances are known, or against three planes, none of which has a known place.

    Args:
        truth: The robot.
        rng: Random numbers.
        count: Number of rows, about.
        sigma: How far the target sits from socket or plane, a coordinate [m].
        kind: ``"fixed"`` or ``"plane"``.
    """
    groups = 4 if kind == "fixed" else 3
    wanted = -(-count // groups)
    sockets = np.array([[0.3, 0.15, 0.2], [0.3, -0.2, 0.25], [-0.15, 0.3, 0.35], [0.25, 0.1, 0.45]])
    normals = np.array([[0.05, 0.02, 1.0], [1.0, 0.1, 0.05], [0.1, 1.0, 0.0]])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    heights = np.array([0.2, 0.25, 0.25])
    q_parts, of_group = [], []
    for k in range(groups):
        start = joints_of(truth.nominal, 3 * wanted, rng)
        along = np.eye(3) if kind == "fixed" else normals[k % 3][None]
        at = sockets[k] if kind == "fixed" else heights[k % 3]
        found = truth.reach(along, at + sigma * rng.normal(size=(len(start), len(along))), start)
        found = found[:wanted]
        q_parts.append(found)
        of_group += [k] * len(found)
    q, which = np.concatenate(q_parts), np.array(of_group)
    kinematics = _at_truth(truth, "dh", np.eye(4)[None], tracker=False)
    poses, twists = kinematics.twists(_x(truth, kinematics), Samples.at(q))
    rows, p = len(q), poses[:, :3, 3]
    distances: tuple[GroupDistance, ...] = ()
    if kind == "fixed":
        scene = np.zeros((rows, 3, 3 * groups))
        for k in range(groups):
            scene[which == k, :, 3 * k : 3 * k + 3] = -np.eye(3)
        J = np.concatenate([twists[:, :3], scene], axis=2).reshape(3 * rows, -1) / sigma
        bars = []
        for i in range(groups):
            for j in range(i):
                between = sockets[i] - sockets[j]
                length = float(np.linalg.norm(between))
                row = np.zeros(J.shape[1])
                first = twists.shape[2]
                row[first + 3 * i : first + 3 * i + 3] = between / length / BAR_SIGMA
                row[first + 3 * j : first + 3 * j + 3] = -between / length / BAR_SIGMA
                bars.append(row)
                measured = length + BAR_SIGMA * float(rng.normal())
                distances += (GroupDistance(f"socket_{i}", f"socket_{j}", measured, BAR_SIGMA),)
        J = np.concatenate([J, bars])
    else:
        scene = np.zeros((rows, 3 * groups))
        for k in range(groups):
            own = which == k
            tangents = np.linalg.svd(normals[k][None])[2][1:]
            scene[own, 3 * k : 3 * k + 2] = p[own] @ tangents.T
            scene[own, 3 * k + 2] = 1.0
        up = np.einsum("ni,nip->np", normals[which], twists[:, :3])
        J = np.column_stack([up, scene]) / sigma
    name = "socket" if kind == "fixed" else "plane"
    table = Measurements(
        truth.nominal.joint_names,
        q,
        np.zeros((rows, 3)),
        kinds=(kind,) * rows,
        groups=tuple(f"{name}_{k}" for k in which),
    )
    q_unseen = joints_of(truth.nominal, UNSEEN, rng)
    free = "motion" if kind == "fixed" else "scale"
    return _run(truth, table, Cell(distances=distances), q_unseen, kinematics, J, free=free)


def _seen(frames: Array, points: Array) -> Array:
    """Points of the base in measurement frames, one for each, shape (N, 3)."""
    return np.asarray(np.einsum("nij,nj->ni", frames[:, :3, :3], points) + frames[:, :3, 3])


def _at_truth(
    truth: Truth, model: str, frames: Array, *, tracker: bool, rotation: bool = False
) -> Kinematics:
    """The model that is fitted, with frames and targets where they really are."""
    directions = ("x", "y", "z", "rx", "ry", "rz") if tracker else ()
    names = tuple(f"s{k}" for k in range(len(frames)))
    targets = tuple(f"t{k}" for k in range(len(truth.targets)))
    fitted = error_model(
        truth.nominal,
        model,
        frame=dict.fromkeys(names, directions),
        target=targets,
        targets=targets,
        rotation=rotation,
    )
    return Kinematics(truth.nominal, fitted, frames, truth.targets)


def _x(truth: Truth, kinematics: Kinematics) -> Array:
    """The true parameters of that model: those that were drawn, then compliances, then zeros for frames and targets."""
    x = np.zeros(len(kinematics.model))
    x[: len(truth.x)] = truth.x
    for i, joint in enumerate(truth.nominal.joints):
        name = f"{joint.name}.compliance"
        if name in kinematics.model.names:
            x[kinematics.model.index(name)] = truth.state.compliance[i]
    return x


def _load(truth: Truth, q: Array, model: str) -> Array | None:
    """The load that a model with compliance needs, and no lever arms."""
    if "compliance" not in model:
        return None
    load = truth.load(truth.nominal.urdf_values(q))
    return np.concatenate([load[:, :, None], np.zeros((*load.shape, load.shape[1] + 2))], axis=2)


def _run(
    truth: Truth,
    table: Measurements,
    cell: Cell,
    q: Array,
    kinematics: Kinematics,
    J: Array,
    *,
    model: str = "dh",
    free: str = "",
    rotation: bool = False,
) -> Run:
    """The run, with the bound for rows of whitened derivative J, shape (R, p + scene)."""
    load = _load(truth, q, model)
    poses, twists = kinematics.twists(_x(truth, kinematics), Samples.at(q, load))
    C = _flat_covariance(J, kinematics.model.units)[: twists.shape[2], : twists.shape[2]]
    linear = _without(twists[:, :3], poses[:, :3, 3], free)
    bound = float(np.einsum("nij,jk,nik->", linear, C, linear)) / len(q)
    angular = twists[:, 3:]
    bound_angle = float(np.einsum("nij,jk,nik->", angular, C, angular)) / len(q)
    true = kinematics.T_frame_base[0] @ truth.poses(q)
    return Run(truth, table, cell, q, true, bound, bound_angle if rotation else 0.0, free)


def _flat_covariance(J: Array, units: Sequence[str]) -> Array:
    """(J^T J)^-1 of the combinations that the rows determine, nothing of the others: no prior takes part."""
    step = np.concatenate([steps(units), np.full(J.shape[1] - len(units), 1e-3)])
    _, values, V = np.linalg.svd(J * step, full_matrices=False)
    rank = rank_by_gap(values)
    half = (V[:rank] * step) / values[:rank, None]
    return np.asarray(half.T @ half)


def _without(jacobian: Array, points: Array, free: str) -> Array:
    """A Jacobian of points, (N, 3, p), less what rigid motions of all of them, and their scale, would do."""
    if not free:
        return jacobian
    motion = np.zeros((len(points), 3, 7))
    motion[:, :, :3] = np.eye(3)
    motion[:, :, 3:6] = np.cross(np.eye(3), points[:, None, :]).transpose(0, 2, 1)
    motion[:, :, 6] = points
    used = motion[:, :, : 7 if free == "scale" else 6].reshape(3 * len(points), -1)
    base = np.linalg.qr(used)[0]
    flat = jacobian.reshape(len(base), -1)
    return np.asarray((flat - base @ (base.T @ flat)).reshape(jacobian.shape))


def _aligned(found: Array, true: Array, free: str) -> Array:
    """Found minus true points after the rigid motion, or similarity, that brings them closest (Kabsch, Umeyama)."""
    if not free:
        return np.asarray(found - true)
    a, b = found - found.mean(axis=0), true - true.mean(axis=0)
    U, values, Vt = np.linalg.svd(a.T @ b)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    R = (U * signs) @ Vt
    scale = float(np.sum(values * signs) / np.sum(a**2)) if free == "scale" else 1.0
    return np.asarray(scale * a @ R - b)


def with_known_payload(run: Run) -> Run:
    """The run with the payload told to calib."""
    from calib.robot.payload import Payload

    payload = Payload(run.truth.payload, read_only(run.truth.com))
    return replace(run, cell=replace(run.cell, payload=payload))
