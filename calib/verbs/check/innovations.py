"""Innovations: measured at fresh stops minus predicted by a result, and how that changes if something has moved.

The n scalars of all stops have the error

    y = e + J dx + B b,        S = cov y = N + J C J^T + (J g)(J g)^T + B L B^T

with the noise N of each scalar, the error dx of the result's parameters, which all stops share, with the covariance C
and the change g by the scale of the instrument; and what displaces the target anew at each stop, by the derivative B:
the robot's repeatability and what the model lacks, with the covariance L. If something has moved by x, y grows by D x.

The corners of an image enter as the six numbers that they tell about the displacement of the board: the projection of
the whitened residual on the column space of B. What is left of it tells of the lens and the print alone.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np

from calib.basics.arrays import Array, Integers
from calib.basics.values import Value
from calib.fit.registration.rows import Rows
from calib.model.internals import InternalValues
from calib.model.kinematics import Kinematics, Sightings
from calib.model.parameter_sets import DIRECTIONS, error_model
from calib.result.board_errors import BoardErrors
from calib.result.calibration import Calibration
from calib.result.fitted_model import FittedModel

#: Lever at whose end a turn counts as much as a shift [m].
LEVER = 0.3

#: Least share of a held-out square that is not the parameters' error.
_LEAST_KEPT = 0.5

#: Singular values below this share of the largest are rounding.
_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Stop(Value):
    """The measurement of one target from one frame at one pose: k numbers, in standard deviations of their noise."""

    #: Numbers of its rows in the table
    rows: tuple[int, ...]
    #: Name of the image; empty without
    image: str
    #: Stops of one number are of one pose of the robot
    pose: int
    #: (k,), measured minus predicted
    y: Array
    #: (k, p), derivative of the prediction by the parameters of the result
    by_parameters: Array
    #: (k, c), by a unit of each displacement of `Displacements` [m, rad]
    by_displacements: Array
    #: (k, 6), by a shift of the target [m] and its turn, of 1 m at the end of `LEVER`
    by_target: Array
    #: (k, 6), root of the covariance of what displaces the target anew at each pose
    anew: Array


@dataclass(frozen=True, slots=True, eq=False)
class Stack(Value):
    """All stops together, whitened: n numbers with independent errors of variance 1."""

    #: The stops, not whitened
    stops: tuple[Stop, ...]
    #: (n,), measured minus predicted
    y: Array
    #: (n, c), by a unit of each displacement
    by_displacements: Array
    #: For each stop (n, 6), by a displacement of the target at it alone
    by_target: tuple[Array, ...]


@dataclass(frozen=True, slots=True, eq=False)
class StoredResult(Value):
    """A stored result, against which fresh stops are compared."""

    #: As made or read
    result: Calibration
    #: The model that predicts
    part: FittedModel
    #: The calibrated robot under displacements of each frame, each target and each joint's zero
    displaced: Kinematics
    #: (p, r), root of C, with a column for the scale of the instrument
    parameter_root: Array
    #: Standard deviation of a scalar by its unit, with what the model lacks [m], [rad], [px]
    sigma: dict[str, float]
    #: The part of the noise of lengths that a robot has anew at each pose, 0 to 1
    shared: float
    #: Degrees of freedom of the t distribution of what is measured: those of the noise, or less for heavier tails
    freedom: float

    @classmethod
    def of(cls, result: Calibration) -> StoredResult:
        """Prepare a result: the displacements, and the noise of fresh rows by its own and its held-out rows."""
        part = result.part(non_geometric=True)
        setup = part.setup
        model = error_model(
            result.robot,
            "zeros",
            frame=dict.fromkeys(setup.frame_unknowns, DIRECTIONS),
            target=dict.fromkeys(setup.target_names, DIRECTIONS),
            targets=setup.target_names,
        )
        displaced = Kinematics(result.robot, model, setup.T_frame_base, setup.T_tip_target)
        C = np.nan_to_num(part.covariance)
        scale = np.sqrt(np.maximum(np.diag(C), np.finfo(float).tiny))
        values, vectors = np.linalg.eigh(C / np.outer(scale, scale))
        root = scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
        by_scale = np.nan_to_num(part.change_by_scale)[:, None]

        sigma = dict(result.noise.sigma)
        # Held-out rows show what the model lacks; an image's share of it is displacement of its board.
        validation = part.cross_validation
        if validation is not None:
            for unit in validation.errors_without_outliers.units:
                errors = validation.errors_without_outliers[unit]
                if unit not in sigma or unit == "px" or not errors.n:
                    continue
                scalars = _scalars_of_a_row(result, unit)
                held_out = errors.rms**2 / scalars
                known = part.noise_measured**2 / 3.0 if unit == "m" else 0.0
                sigma[unit] = float(np.sqrt(max(sigma[unit] ** 2, held_out - known)))
        shared = 0.0
        repeats = result.noise.repeats
        if repeats is not None and "m" in sigma and repeats.freedoms.get("m", 0.0) > 0.0:
            shared = max(1.0 - (repeats.within["m"] / sigma["m"]) ** 2, 0.0)
        freedom = min(result.noise.freedom, _tails(result))
        return cls(result, part, displaced, np.hstack([root, by_scale]), sigma, shared, freedom)

    def stops(
        self, rows: Rows, stated: Collection[str], numbers: Sequence[int], images: Sequence[str]
    ) -> tuple[Stop, ...]:
        """Compare rows with the prediction, stop by stop.

        Args:
            rows: N rows, whose frames and targets have the numbers of the result.
            stated: Units whose sigma the table or the cell states: it counts, times the factor by which the result
                found the noise to be larger than stated.
            numbers: Number of each row in its table.
            images: Name of each row's image; empty without images.
        """
        part, noise = self.part, self.result.noise
        if noise.pose_noise is not None:
            rows = replace(rows, pose_noise=noise.pose_noise)
        seen = part.kinematics.linearised(part.x, rows.samples)
        assert seen.twists is not None
        fixed = None if seen.internals is None else InternalValues.fixed(seen.internals.values)
        moved = self.displaced.twists(np.zeros(len(self.displaced.model)), rows.samples)
        motions = np.broadcast_to(np.eye(6), (len(rows), 6, 6))

        factor = self._factors(rows, stated)

        def whitened(values: Array) -> Array:
            """Return residuals (N, D) or derivatives (N, D, q) in standard deviations of their noise."""
            return np.asarray(
                rows.standardise(values) / factor.reshape(*factor.shape, *(1,) * (values.ndim - 2))
            )

        y = whitened(rows.residual(seen))
        J = whitened(rows.derivative(seen))
        D = whitened(rows.derivative(Sightings(moved[0], moved[1], fixed)))
        B = whitened(rows.derivative(replace(seen, twists=motions, internals=fixed)))
        points = rows.points(seen.T_frame_target)
        lacking = self._lacking(rows, seen)

        labels = np.column_stack([rows.blocks, rows.samples.frame, rows.samples.target])
        _, stop_of_row = np.unique(labels, axis=0, return_inverse=True)
        stop_of_row = stop_of_row.reshape(-1)
        # Stops in the order of the table.
        order = dict.fromkeys(stop_of_row.tolist())
        result = []
        for number in order:
            of_stop = np.flatnonzero(stop_of_row == number)
            used = rows.used[of_stop]
            A = B[of_stop].copy()
            arm = points[of_stop].mean(axis=0) - seen.T_frame_target[of_stop[0], :3, 3]
            A[:, :, 3:] += np.cross(A[:, :, :3], arm)  # turns about the middle of what is measured
            A, L = A[used], lacking[of_stop[0]]
            reduce = np.eye(int(used.sum()))
            if rows.is_image[of_stop].all():
                reduce = _column_space(A).T
            elif self.shared == 0.0:
                # As if repeats of a target were one row: how far they are independent is not known.
                reduce = reduce / np.sqrt(len(of_stop))
            of_y, of_J, of_D, of_A = (
                reduce @ values
                for values in (y[of_stop][used], J[of_stop][used], D[of_stop][used], A)
            )
            result.append(
                Stop(
                    rows=tuple(numbers[i] for i in of_stop.tolist()),
                    image=images[of_stop[0]] if len(images) else "",
                    pose=int(rows.blocks[of_stop[0]]),
                    y=of_y,
                    by_parameters=of_J @ self.parameter_root,
                    by_displacements=of_D,
                    by_target=of_A * np.repeat([1.0, 1.0 / LEVER], 3),
                    anew=of_A @ L,
                )
            )
        return tuple(result)

    def _factors(self, rows: Rows, stated: Collection[str]) -> Array:
        """Return the noise of each entry over that which the rows have before a fit, shape (N, D)."""
        noise = self.result.noise
        factor = np.ones(rows.used.shape)
        own = np.sqrt(1.0 - self.shared)
        for unit, sigma in self.sigma.items():
            if unit not in rows.channels.present:
                continue
            before = rows.sigma[unit]
            of_unit = sigma / before
            if unit in stated:
                given = noise.sigma_given.get(unit, np.nan)
                of_unit = np.full(len(rows), sigma / given if given > 0.0 else 1.0)
            of_unit = of_unit * (own if unit == "m" else 1.0)
            factor = np.where(rows.channels.where(unit), of_unit[:, None], factor)
        factor[rows.correlated] = 1.0
        return factor

    def _lacking(self, rows: Rows, seen: Sightings) -> Array:
        """Return a root of the covariance L of what displaces the target anew at each pose, (N, 6, 6) [m, rad]."""
        root = np.zeros((len(rows), 6, 6))
        if self.shared > 0.0:
            root[:, :3, :3] = np.sqrt(self.shared) * self.sigma["m"] * np.eye(3)
        images = np.flatnonzero(rows.is_image)
        if self.part.board is None or not len(images):
            return root
        across, depth, turn = self._lacking_of_boards(self.part.board)
        sight = rows.points(seen.T_frame_target)[images]
        sight = sight / np.linalg.norm(sight, axis=1, keepdims=True)
        along = sight[:, :, None] * sight[:, None, :]
        root[images, :3, :3] = across * (np.eye(3) - along) + depth * along
        root[images, 3:, 3:] = turn * np.eye(3)
        return root

    def _lacking_of_boards(self, board: BoardErrors) -> tuple[float, float, float]:
        """Return what displaces a board anew in each view, as held-out views show: across, depth [m], turn [rad].

        Each is a standard deviation, along or about one axis. A view that was held out also misses by the error of p
        parameters that n numbers of all views determine, which S has by itself: by the mean leverage p / n its square
        is larger. Depth shows so little that it is no less than what shows across.
        """
        placed = sum(parameter.internal is None for parameter in self.part.model.parameters)
        kept = max(1.0 - placed / (6.0 * board.views), _LEAST_KEPT)
        across = max(kept * board.across**2 - board.across_alone**2, 0.0) / 2.0
        depth = max(kept * board.predicted_depth**2, across)
        turn = max(kept * board.turn**2 - board.turn_alone**2, 0.0) / 3.0
        return float(np.sqrt(across)), float(np.sqrt(depth)), float(np.sqrt(turn))


def _tails(result: Calibration) -> float:
    """Return the degrees of freedom of a t with the tails of the fitted residuals; infinite for normal ones.

    With u the squared norm of the d scalars of a row in standard deviations, the ratio of E u^2 / (E u)^2 to that of a
    normal distribution is (nu - 2) / (nu - 4) for a t with nu degrees of freedom (K. V. Mardia, 1970, has the standard
    error 8 / (d (d + 2) N), squared, of N normal rows). Two standard errors less are taken: what chance explains is
    no tail. Images are left out, as the corners of one view are not independent.
    """
    rows, other = result.rows, result.non_geometric
    residual = rows.residual_calibrated if other is None else other.residual
    square, count = np.zeros(len(rows)), np.zeros(len(rows))
    for unit in rows.channels.present:
        sigma = result.noise.sigma.get(unit, 0.0)
        if unit != "px" and sigma > 0.0:
            chosen = rows.channels.where(unit)
            square += np.sum(np.where(chosen, residual, 0.0) ** 2, axis=1) / sigma**2
            count += chosen.sum(axis=1)
    kept = rows.estimation & (rows.weights > 0.0) & (count > 0)
    if not np.any(kept) or not np.any(square[kept]):
        return np.inf
    d, n = float(count[kept].mean()), int(kept.sum())
    ratio = np.mean(square[kept] ** 2) / np.mean(square[kept]) ** 2 * d / (d + 2.0)
    excess = ratio - 2.0 * np.sqrt(8.0 / (d * (d + 2.0) * n)) - 1.0
    return float(4.0 + 2.0 / excess) if excess > 0.0 else np.inf


def _scalars_of_a_row(result: Calibration, unit: str) -> float:
    """Return how many scalars of a unit the rows that have any measure, on average."""
    of_unit = result.rows.channels.where(unit).sum(axis=1)
    return float(of_unit[of_unit > 0].mean()) if of_unit.any() else 1.0


def _column_space(A: Array) -> Array:
    """Return an orthonormal basis of the column space of A, (s, 6), by its left singular vectors, (s, r)."""
    size = np.maximum(np.linalg.norm(A, axis=0), np.finfo(float).tiny)
    U, singular, _ = np.linalg.svd(A / size, full_matrices=False)
    return np.asarray(U[:, singular > _ROUNDING * singular[0]])


def stacked(stops: Sequence[Stop]) -> Stack:
    """Put stops together, and whiten them by the covariance S of all their numbers."""
    sizes = [len(stop.y) for stop in stops]
    ends = np.cumsum(sizes)
    slices = [slice(end - size, end) for end, size in zip(ends.tolist(), sizes, strict=True)]
    n = int(ends[-1])
    J = np.concatenate([stop.by_parameters for stop in stops])
    S = np.eye(n) + J @ J.T
    for a, one in zip(slices, stops, strict=True):
        for b, other in zip(slices, stops, strict=True):
            if one.pose == other.pose:
                S[a, b] += one.anew @ other.anew.T
    root = np.linalg.cholesky(S)
    alone = []
    for a, stop in zip(slices, stops, strict=True):
        of_stop = np.zeros((n, 6))
        of_stop[a] = stop.by_target
        alone.append(of_stop)
    y = np.concatenate([stop.y for stop in stops])
    D = np.concatenate([stop.by_displacements for stop in stops])
    whole = np.linalg.solve(root, np.column_stack([y, D, *alone]))
    c = D.shape[1]
    return Stack(
        stops=tuple(stops),
        y=whole[:, 0],
        by_displacements=whole[:, 1 : 1 + c],
        by_target=tuple(np.split(whole[:, 1 + c :], len(stops), axis=1)),
    )


def numbered_as(names: Sequence[str], known: Sequence[str], index: Integers) -> Integers | None:
    """Return indices into names as indices into the names of a result; None if it lacks one that occurs.

    If both have one name only, these are matched whatever they are.
    """
    if len(names) == len(known) == 1:
        return index
    occurring = list(compress(names, np.bincount(index, minlength=len(names)) > 0))
    if not set(occurring) <= set(known):
        return None
    lookup = np.array([known.index(name) if name in known else -1 for name in names])
    return np.asarray(lookup[index])
