"""Virtual measurements of each kind for `verification_study.py`, with the Cramer-Rao bound of predictions.

The bound is that of an unbiased fit with known noise and no prior, for the combinations of parameters that the rows
determine. It comes from the derivative of the rows by all unknowns at their true values, whitened by the noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from studies import add_noise
from verification_truth import Truth, draw_frame, draw_joint_values

from calib.basics.arrays import Array
from calib.data.cell import Cell, GroupDistance
from calib.data.measurements import Measurements
from calib.model.kinematics import Kinematics, Samples
from calib.model.observability import rank_by_gap, steps
from calib.model.parameter_sets import error_model
from calib.result.calibration import Calibration

#: Number of other poses at which predictions are compared with the truth.
OTHER = 200

#: Standard deviation of the known distances between sockets [m].
BAR_SIGMA = 5e-6

#: Displacements of displaced rows [m].
DISPLACEMENTS = (5e-3, 50e-3)

#: Directions of a frame that is estimated.
FRAME_DIRECTIONS = ("x", "y", "z", "rx", "ry", "rz")

#: Anchors of distances in the base [m].
ANCHORS = np.array([[0.9, 0.2, 0.1], [-0.4, 0.9, 0.3], [-0.2, -0.8, 0.8]])

#: Sockets in the base [m].
SOCKETS = np.array([[0.3, 0.15, 0.2], [0.3, -0.2, 0.25], [-0.15, 0.3, 0.35], [0.25, 0.1, 0.45]])

#: Normals of planes in the base, to be normalised.
NORMALS = np.array([[0.05, 0.02, 1.0], [1.0, 0.1, 0.05], [0.1, 1.0, 0.0]])

#: Distances of these planes from the origin [m].
HEIGHTS = np.array([0.2, 0.25, 0.25])

#: What measurements leave free of the predictions: nothing, a rigid motion, a rigid motion and the scale.
NOTHING = ""
MOTION = "motion"
SCALE = "scale"


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """A table of measurements, and the truth at other poses."""

    truth: Truth
    measurements: Measurements
    cell: Cell  # As given to calib
    q: Array  # shape (OTHER, m), other poses [rad]
    true: Array  # shape (OTHER, 4, 4), true pose of the first target there, in the first frame [m]
    bound: float  # Least mean square error of positions there of an unbiased fit [m^2]
    bound_angle: float  # The same of angles [rad^2]; 0 where none is measured
    free: str  # One of `NOTHING`, `MOTION`, `SCALE`

    def errors(self, result: Calibration) -> Array:
        """Return predicted minus true positions at the other poses, shape (OTHER, 3), [m], after alignment."""
        return _aligned_errors(result.predict(self.q), self.true[:, :3, 3], self.free)

    def angles(self, result: Calibration) -> Array:
        """Return the angles between predicted and true orientations there, shape (OTHER,), [rad]."""
        R = result.predict_poses(self.q)[:, :3, :3]
        R_error = R.transpose(0, 2, 1) @ self.true[:, :3, :3]
        return np.array([float(np.linalg.norm(pin.log3(matrix))) for matrix in R_error])


def with_known_payload(run: Run) -> Run:
    """Return the run with the payload given to calib."""
    return replace(run, cell=replace(run.cell, payload=run.truth.payload))


# The model that is fitted, at the true values of its parameters


@dataclass(frozen=True, slots=True, eq=False)
class TrueModel:
    """The model that calib fits to a run, at the true values of its parameters."""

    truth: Truth
    kinematics: Kinematics  # With frames and targets at their true places
    x: Array  # shape (p,), true parameters; zeros of frames and targets

    @classmethod
    def of(
        cls,
        truth: Truth,
        model: str = "dh",
        frames: Array | None = None,
        *,
        rotation: bool = False,
    ) -> TrueModel:
        """Return the model.

        Args:
            truth: The robot.
            model: Name of the model, to which the robot's errors belong.
            frames: shape (F, 4, 4), T_frame_base of trackers, which are estimated; None: points are in the base.
            rotation: Orientations of the targets are estimated too.
        """
        directions: tuple[str, ...] = FRAME_DIRECTIONS
        if frames is None:
            directions = ()
            frames = np.eye(4)[None]
        targets = tuple(f"t{k}" for k in range(len(truth.targets)))
        fitted = error_model(
            truth.nominal,
            model,
            frame={f"s{k}": directions for k in range(len(frames))},
            target=targets,
            targets=targets,
            rotation=rotation,
        )
        x = np.zeros(len(fitted))
        x[: len(truth.x)] = truth.x
        for joint, compliance in zip(truth.nominal.joints, truth.state.compliance, strict=True):
            name = f"{joint.name}.compliance"
            if name in fitted.names:
                x[fitted.index(name)] = compliance
        return cls(truth, Kinematics(truth.nominal, fitted, frames, truth.targets), x)

    def twists(
        self,
        q: Array,
        frame: NDArray[np.int_] | None = None,
        target: NDArray[np.int_] | None = None,
    ) -> tuple[Array, Array]:
        """Return poses of targets, and their derivative.

        Args:
            q: shape (N, m), joint values [rad].
            frame: shape (N,), number of each row's frame, from 0; None: the first.
            target: shape (N,), number of each row's target, from 0; None: the first.

        Returns:
            T_frame_target, shape (N, 4, 4), [m], and its derivative by x as twists, shape (N, 6, p).
        """
        first = np.zeros(len(q), dtype=np.int_)
        samples = Samples(
            q,
            first if frame is None else frame,
            first if target is None else target,
            self._load(q),
        )
        return self.kinematics.twists(self.x, samples)

    def position_jacobian(self, q: Array) -> Array:
        """Return the derivative of positions of the first target by x, shape (N, 3, p), [m]."""
        _, twists = self.twists(q)
        return twists[:, :3]

    def run(
        self,
        table: Measurements,
        cell: Cell,
        q: Array,
        J: Array,
        *,
        free: str = NOTHING,
        angles: bool = False,
    ) -> Run:
        """Return the run of a table.

        Args:
            table: The measurements.
            cell: The cell as given to calib.
            q: shape (OTHER, m), other poses [rad].
            J: shape (R, p + s), whitened derivative of the rows by x, then by what else is unknown.
            free: What the rows do not determine: `NOTHING`, `MOTION` or `SCALE`.
            angles: Angles are measured too.
        """
        poses, twists = self.twists(q)
        parameters = len(self.x)
        covariance = _flat_covariance(J, self.kinematics.model.units)[:parameters, :parameters]
        linear = _without_free(twists[:, :3], poses[:, :3, 3], free)
        bound = float(np.einsum("nij,jk,nik->", linear, covariance, linear)) / len(q)
        bound_angle = 0.0
        if angles:
            angular = twists[:, 3:]
            bound_angle = float(np.einsum("nij,jk,nik->", angular, covariance, angular)) / len(q)
        true = self.kinematics.T_frame_base[0] @ self.truth.poses(q)
        certified = replace(cell, scale_certified=True)  # by the simulation
        return Run(self.truth, table, certified, q, true, bound, bound_angle, free)

    def _load(self, q: Array) -> Array | None:
        """Return the load that compliance needs, shape (N, n, n + 3), without lever arms; None if none is fitted."""
        if not any(name.endswith(".compliance") for name in self.kinematics.model.names):
            return None
        load = self.truth.load(self.truth.nominal.urdf_values(q))
        lever_arms = np.zeros((*load.shape, load.shape[1] + 2))
        return np.concatenate([load[:, :, None], lever_arms], axis=2)


# Measurements


def points_run(
    truth: Truth,
    rng: np.random.Generator,
    count: int,
    sigma: float,
    *,
    trackers: int = 0,
    model: str = "dh",
    displaced: float = 0.0,
) -> Run:
    """Measure positions of one or more targets.

    Args:
        truth: The robot.
        rng: Random numbers.
        count: Number of rows.
        sigma: Noise of a coordinate [m].
        trackers: Number of stations of a tracker, whose frames are unknown; 0: points are in the base.
        model: The model that the bound is computed for; the robot's errors belong to it.
        displaced: Share of rows that are displaced by 5 to 50 mm.
    """
    q = draw_joint_values(truth.nominal, count, rng)
    q_other = draw_joint_values(truth.nominal, OTHER, rng)
    targets = len(truth.targets)
    stations = max(trackers, 1)
    target = np.arange(count) % targets
    station = (np.arange(count) // targets) % stations
    frames = np.array([draw_frame(rng) for _ in range(trackers)]) if trackers else None
    points = truth.points(q, target)
    if frames is not None:
        T = frames[station]
        points = np.einsum("nij,nj->ni", T[:, :3, :3], points) + T[:, :3, 3]
    points = add_noise(points, sigma, rng)
    rows = rng.permutation(count)[: round(displaced * count)]
    if len(rows):
        points[rows] += _random_displacements(len(rows), rng)
    table = Measurements(
        truth.nominal.joint_names,
        q,
        points,
        targets=tuple(f"target_{k}" for k in target) if targets > 1 else (),
        groups=tuple(f"station_{k}" for k in station) if stations > 1 else (),
    )
    true_model = TrueModel.of(truth, model, frames)
    _, twists = true_model.twists(q, station, target)
    J = twists[:, :3].reshape(-1, twists.shape[2]) / sigma
    return true_model.run(table, Cell(estimate_frame=trackers > 0), q_other, J)


def poses_run(
    truth: Truth, rng: np.random.Generator, count: int, sigma: float, sigma_angle: float
) -> Run:
    """Measure positions and orientations in the frame of a tracker.

    Args:
        truth: The robot.
        rng: Random numbers.
        count: Number of rows.
        sigma: Noise of a coordinate [m].
        sigma_angle: Noise of a component of the orientation [rad].
    """
    q = draw_joint_values(truth.nominal, count, rng)
    q_other = draw_joint_values(truth.nominal, OTHER, rng)
    T_frame_base = draw_frame(rng)
    T = T_frame_base @ truth.poses(q)
    rotations = [pin.exp3(sigma_angle * rng.normal(size=3)) @ R for R in T[:, :3, :3]]
    table = Measurements(
        truth.nominal.joint_names,
        q,
        add_noise(T[:, :3, 3], sigma, rng),
        kinds=("pose",) * count,
        rotations=np.array(rotations),
    )
    true_model = TrueModel.of(truth, frames=T_frame_base[None], rotation=True)
    _, twists = true_model.twists(q)
    sigmas = np.repeat([sigma, sigma_angle], 3)
    J = (twists / sigmas[None, :, None]).reshape(-1, twists.shape[2])
    return true_model.run(table, Cell(estimate_frame=True), q_other, J, angles=True)


def distances_run(truth: Truth, rng: np.random.Generator, count: int, sigma: float) -> Run:
    """Measure distances of the target from three anchors whose positions are unknown.

    Args:
        truth: The robot.
        rng: Random numbers.
        count: Number of distances.
        sigma: Their noise [m].
    """
    q = draw_joint_values(truth.nominal, count, rng)
    q_other = draw_joint_values(truth.nominal, OTHER, rng)
    anchor = np.arange(count) % len(ANCHORS)
    lengths, units = _lengths_and_units(truth.points(q) - ANCHORS[anchor])
    table = Measurements(
        truth.nominal.joint_names,
        q,
        np.zeros((count, 3)),
        kinds=("distance",) * count,
        distances=lengths + sigma * rng.normal(size=count),
        groups=tuple(f"wire_{k}" for k in anchor),
    )
    true_model = TrueModel.of(truth)
    by_model = np.einsum("ni,nip->np", units, true_model.position_jacobian(q))
    J = np.column_stack([by_model, _group_columns(anchor, -units)]) / sigma
    return true_model.run(table, Cell(), q_other, J, free=MOTION)


def pairs_run(truth: Truth, rng: np.random.Generator, count: int, sigma: float) -> Run:
    """Measure distances between the targets of two rows; arguments as for `distances_run`."""
    q = draw_joint_values(truth.nominal, 2 * count, rng)
    q_other = draw_joint_values(truth.nominal, OTHER, rng)
    points = truth.points(q)
    lengths, units = _lengths_and_units(points[0::2] - points[1::2])
    measured = lengths + sigma * rng.normal(size=count)
    table = Measurements(
        truth.nominal.joint_names,
        q,
        np.zeros((2 * count, 3)),
        kinds=("pair",) * (2 * count),
        distances=np.repeat(measured, 2),
        pairs=tuple(f"bar_{k // 2}" for k in range(2 * count)),
    )
    true_model = TrueModel.of(truth)
    positions = true_model.position_jacobian(q)
    J = np.einsum("ni,nip->np", units, positions[0::2] - positions[1::2]) / sigma
    return true_model.run(table, Cell(), q_other, J, free=MOTION)


def sockets_run(truth: Truth, rng: np.random.Generator, count: int, sigma: float) -> Run:
    """Put the target into four sockets of unknown positions and known distances from each other.

    Args:
        truth: The robot.
        rng: Random numbers.
        count: Number of rows, about.
        sigma: Noise of a coordinate of the target in its socket [m].
    """
    contacts = [(np.eye(3), socket) for socket in SOCKETS]
    q, socket = _reach_contacts(truth, rng, contacts, count, sigma)
    true_model = TrueModel.of(truth)
    positions = true_model.position_jacobian(q)
    minus_identity = np.tile(-np.eye(3), (len(q), 1, 1))
    by_sockets = _group_columns(socket, minus_identity)
    J = np.concatenate([positions, by_sockets], axis=2).reshape(3 * len(q), -1) / sigma
    bars, by_bars = _measure_bars(rng)
    J_bars = np.column_stack([np.zeros((len(bars), positions.shape[2])), by_bars])
    table = _contact_table(truth, q, "fixed", [f"socket_{k}" for k in socket])
    q_other = draw_joint_values(truth.nominal, OTHER, rng)
    J = np.concatenate([J, J_bars])
    return true_model.run(table, Cell(distances=bars), q_other, J, free=MOTION)


def planes_run(truth: Truth, rng: np.random.Generator, count: int, sigma: float) -> Run:
    """Put the target onto three unknown planes.

    Args:
        truth: The robot.
        rng: Random numbers.
        count: Number of rows, about.
        sigma: Noise of the target's distance from its plane [m].
    """
    normals = NORMALS / np.linalg.norm(NORMALS, axis=1)[:, None]
    contacts = [
        (normal[None], np.array([height])) for normal, height in zip(normals, HEIGHTS, strict=True)
    ]
    q, plane = _reach_contacts(truth, rng, contacts, count, sigma)
    true_model = TrueModel.of(truth)
    poses, twists = true_model.twists(q)
    tangents = np.array([np.linalg.svd(normal[None])[2][1:] for normal in normals])
    along = np.einsum("nki,ni->nk", tangents[plane], poses[:, :3, 3])
    by_planes = _group_columns(plane, np.column_stack([along, np.ones(len(q))]))
    by_model = np.einsum("ni,nip->np", normals[plane], twists[:, :3])
    J = np.column_stack([by_model, by_planes]) / sigma
    table = _contact_table(truth, q, "plane", [f"plane_{k}" for k in plane])
    q_other = draw_joint_values(truth.nominal, OTHER, rng)
    return true_model.run(table, Cell(), q_other, J, free=SCALE)


def _random_displacements(count: int, rng: np.random.Generator) -> Array:
    """Draw displacements in random directions, shape (count, 3), [m]."""
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    return directions * rng.uniform(*DISPLACEMENTS, size=(count, 1))


def _reach_contacts(
    truth: Truth,
    rng: np.random.Generator,
    contacts: Sequence[tuple[Array, Array]],
    count: int,
    sigma: float,
) -> tuple[Array, NDArray[np.int_]]:
    """Find joint values at which the target touches sockets or planes, but for noise.

    Args:
        truth: The robot.
        rng: Random numbers.
        contacts: Of each socket or plane: directions along which it holds the target, shape (k, 3), and the target's
            heights along them, shape (k,), [m].
        count: Number of rows, about.
        sigma: Noise along each direction [m].

    Returns:
        Joint values, shape (N, m), [rad], and the number of each row's contact, shape (N,).
    """
    each = -(-count // len(contacts))
    parts, numbers = [], []
    for number, (directions, heights) in enumerate(contacts):
        start = draw_joint_values(truth.nominal, 3 * each, rng)
        noise = sigma * rng.normal(size=(len(start), len(directions)))
        q = truth.reach(directions, heights + noise, start)[:each]
        parts.append(q)
        numbers += [number] * len(q)
    return np.concatenate(parts), np.array(numbers)


def _measure_bars(rng: np.random.Generator) -> tuple[tuple[GroupDistance, ...], Array]:
    """Measure the distances between all sockets.

    Returns:
        The distances, and their whitened derivative by the sockets' positions, shape (distances, 3 sockets).
    """
    bars, rows = [], []
    for i in range(len(SOCKETS)):
        for j in range(i):
            length, unit = _lengths_and_units(SOCKETS[i] - SOCKETS[j])
            row = np.zeros((len(SOCKETS), 3))
            row[i] = unit / BAR_SIGMA
            row[j] = -unit / BAR_SIGMA
            measured = float(length) + BAR_SIGMA * float(rng.normal())
            rows.append(row.ravel())
            bars.append(GroupDistance(f"socket_{i}", f"socket_{j}", measured, BAR_SIGMA))
    return tuple(bars), np.array(rows)


def _contact_table(truth: Truth, q: Array, kind: str, groups: Sequence[str]) -> Measurements:
    """Return the table of joint values at contacts, whose kind and groups are given."""
    return Measurements(
        truth.nominal.joint_names,
        q,
        np.zeros((len(q), 3)),
        kinds=(kind,) * len(q),
        groups=tuple(groups),
    )


def _lengths_and_units(vectors: Array) -> tuple[Array, Array]:
    """Return the lengths of vectors, shape (..., 3), and the unit vectors along them."""
    lengths = np.linalg.norm(vectors, axis=-1)
    return lengths, vectors / lengths[..., None]


def _group_columns(group: NDArray[np.int_], values: Array) -> Array:
    """Return the derivative by the unknowns of groups, of which each row sees one.

    Args:
        group: shape (N,), group of each row, from 0.
        values: shape (N, ..., c), derivative of each row by the c unknowns of its group.

    Returns:
        shape (N, ..., c G), the derivative by the unknowns of all G groups.
    """
    columns = values.shape[-1]
    result = np.zeros((*values.shape[:-1], columns * (int(group.max()) + 1)))
    for k in range(int(group.max()) + 1):
        rows = group == k
        result[rows, ..., k * columns : (k + 1) * columns] = values[rows]
    return result


# Bounds, and what measurements leave free


def _flat_covariance(J: Array, units: Sequence[str]) -> Array:
    """Return (J^T J)^-1 of the combinations that the rows determine, and zero of the others: no prior takes part.

    Args:
        J: shape (R, p + s), whitened derivative.
        units: Units of the p parameters; the other unknowns are lengths.
    """
    step = np.concatenate([steps(units), np.full(J.shape[1] - len(units), 1e-3)])
    _, values, V = np.linalg.svd(J * step, full_matrices=False)
    rank = rank_by_gap(values)
    half = (V[:rank] * step) / values[:rank, None]
    return np.asarray(half.T @ half)


def _without_free(J: Array, points: Array, free: str) -> Array:
    """Return a derivative of points, shape (N, 3, p), without what a motion or scaling of all points would do."""
    if free == NOTHING:
        return J
    motion = np.zeros((len(points), 3, 7))
    motion[:, :, :3] = np.eye(3)
    motion[:, :, 3:6] = np.cross(np.eye(3), points[:, None, :]).transpose(0, 2, 1)
    motion[:, :, 6] = points
    columns = 7 if free == SCALE else 6
    base = np.linalg.qr(motion[:, :, :columns].reshape(3 * len(points), -1))[0]
    flat = J.reshape(len(base), -1)
    return np.asarray((flat - base @ (base.T @ flat)).reshape(J.shape))


def _aligned_errors(predicted: Array, true: Array, free: str) -> Array:
    """Return predicted minus true points after the best motion, or similarity (Kabsch, Umeyama), if that is free."""
    if free == NOTHING:
        return np.asarray(predicted - true)
    a = predicted - predicted.mean(axis=0)
    b = true - true.mean(axis=0)
    U, values, Vt = np.linalg.svd(a.T @ b)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    R = (U * signs) @ Vt
    scale = 1.0
    if free == SCALE:
        scale = float(np.sum(values * signs) / np.sum(a**2))
    return np.asarray(scale * a @ R - b)
