"""How far two results' predictions of one target lie apart, and how sure that is, up to what frames and targets absorb.

    delta(q) = T_b(q) t - T_a(q) t  =  J_b x_b - J_a x_a  to first order

in the base, with the target t of the first result. Where a fit found the base's place in the measurement frame from
its own data, a motion of the whole robot, such as a drift of the first joint's zero, cannot be told from a tracker that
stands elsewhere; where it found the target, a shift that is constant in the tip cannot be told from a target mounted
anew. The part of delta that such motions G make up for best, by least squares over some joint values, is taken off,
there and at any other joint values. Where orientations were measured, they count too, as what they do at the end of
a lever of 100 mm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.identify.drift import Estimated, Pair, own_names, own_parameters, own_steps
from calib.identify.result import Calibration
from calib.model.error_model import DIRECTIONS
from calib.model.kinematics import Kinematics
from calib.model.parameters import FRAME, TARGET

Array = NDArray[np.float64]

#: What an angle counts for beside a length [m].
_LEVER = 0.1

#: A combination whose effect is below this share of the strongest one's has none; the second where the results count
#: from different nominal robots, whose effects differ by what is of second order.
_NOTHING, _NOTHING_APART = 1e-5, 2e-3

#: A parameter with more than this share of its effect outside of what the other result's can do is its own.
_OWN = 0.03

#: A parameter of whose effect less than this share is left is not told from frame and target.
_UNTOLD = 0.03

#: What a difference in one coordinate of one pose must exceed to be more than rounding [m].
_ROUNDING = 1e-7


@dataclass(frozen=True, slots=True, eq=False)
class Move:
    """How far the target lies elsewhere at some joint values.

    Attributes:
        where: The joint values in words.
        rms: Over them, noise included [m].
        max: At most [m].
        noise: What the noise of both results alone would show, rms [m].
        std: Standard deviation of ``rms`` [m].
        rms_angle: The rms of the turns [rad]; NaN where orientations were not measured.
    """

    where: str
    rms: float
    max: float
    noise: float
    std: float
    rms_angle: float

    @property
    def moved(self) -> float:
        """The rms without what the noise adds to it [m]."""
        return float(np.sqrt(max(self.rms**2 - self.noise**2, 0.0)))


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """Both results at N joint values; D = 3, or 6 where orientations count: rows of lengths [m].

    Attributes:
        difference: shape (N, D), b less a.
        effects: Of each result what a unit of its own parameters does, shape (N, D, p).
        slopes: The same at the results, not at the nominal robot: what follows a change of priors.
        gauge: shape (N, D, g), what frames and targets would make up for.
    """

    difference: Array
    effects: tuple[Array, Array]
    slopes: tuple[Array, Array]
    gauge: Array

    @classmethod
    def at(cls, a: Calibration, b: Calibration, q: Array) -> Seen:
        """Predict.

        Args:
            a: One result.
            b: The other.
            q: shape (N, m), joint values [rad] or [m].
        """
        turns = a.setup.rotation and b.setup.rotation
        starts, poses, effects, slopes = [], [], [], []
        for one in (a, b):
            kinematics, x = _own_kinematics(one, a.setup.T_tip_target[0])
            # At the nominal robot, from which both count: elsewhere they would differ by what is of second order, and
            # that would look like combinations of their own.
            start, twists = kinematics.twists(np.zeros_like(x), q)
            found, at_result = kinematics.twists(x, q)
            starts.append(start)
            poses.append(found)
            slopes.append(_lengths(at_result, turns=turns))
            effects.append(_lengths(twists, turns=turns))
        shift = poses[1][:, :3, 3] - poses[0][:, :3, 3]
        if turns:
            turned = poses[1][:, :3, :3] @ poses[0][:, :3, :3].transpose(0, 2, 1)
            shift = np.hstack([shift, _LEVER * Rotation.from_matrix(turned).as_rotvec()])
        unknown = {*unknown_frame(a), *unknown_frame(b)}
        frame = tuple(d for d in DIRECTIONS if d in unknown)
        target = a.setup.estimate_target or b.setup.estimate_target
        gauge = _gauge(starts[0], frame, target=target, turns=turns)
        return cls(
            difference=shift,
            effects=(effects[0], effects[1]),
            slopes=(slopes[0], slopes[1]),
            gauge=_lengths(gauge, turns=turns),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Compensated:
    """What is left of moves after the best motion of frame and target is taken off.

    Attributes:
        results: Both.
        seen: Both at the joint values that say what that motion is.
        solve: shape (g, N D), takes moves there to the motion.
        basis: shape (N D, r), orthonormal, of all that both results' parameters can do.
    """

    results: tuple[Calibration, Calibration]
    seen: Seen
    solve: Array
    basis: Array

    @classmethod
    def of(cls, a: Calibration, b: Calibration, q: Array, *, same_start: bool) -> Compensated:
        """From both results at joint values that their data cover.

        Args:
            a: One result.
            b: The other.
            q: shape (N, m), joint values [rad] or [m].
            same_start: Whether both count from the same nominal robot.
        """
        seen = Seen.at(a, b, q)
        rows = seen.difference.size
        G: Array = seen.gauge.reshape(rows, -1)
        solve: Array = np.zeros((G.shape[1], rows))
        if G.shape[1]:
            solve = np.asarray(np.linalg.pinv(G, rcond=1e-9))
        flat = [effect.reshape(rows, -1) for effect in seen.effects]
        every = [
            (one - G @ (solve @ one)) * own_steps(result)
            for one, result in zip(flat, (a, b), strict=True)
        ]
        U, values, _ = np.linalg.svd(np.hstack(every), full_matrices=False)
        strongest = max(float(values[0]) if len(values) else 0.0, 1e-300)
        least = strongest * (_NOTHING if same_start else _NOTHING_APART)
        return cls((a, b), seen, solve, U[:, values > least])

    @property
    def floor(self) -> float:
        """What stands for rounding in each coordinate of the basis [m]."""
        return float(_ROUNDING * np.sqrt(len(self.seen.difference)))

    def pair(self, *, alike: bool) -> Pair:
        """Both results in the basis, under common priors.

        Args:
            alike: See `Pair`.
        """
        a, b = self.results
        first, second = (self.basis.T @ self._own_effects(k)[1] for k in (0, 1))
        return Pair(Estimated.of(a, b, first), Estimated.of(b, a, second), alike)

    def difference(self, pair: Pair) -> Array:
        """The difference in the basis, under common priors, shape (r,)."""
        flat = _moved(self.seen, pair)
        return np.asarray(self.basis.T @ self._left(flat, flat, self.seen))

    def untold(self) -> tuple[str, ...]:
        """The parameters that frame and target make up for, of both results."""
        names: dict[str, None] = {}
        for k, one in enumerate(self.results):
            told = np.any(self._own_effects(k)[1], axis=0)
            names |= {n: None for n, seen in zip(own_names(one), told, strict=True) if not seen}
        return tuple(names)

    def alone(self, which: int) -> tuple[str, ...]:
        """The parameters of one result that move the target in ways that the other's cannot."""
        own, other = (
            (self.basis.T @ self._own_effects(k)[1]) * own_steps(self.results[k])
            for k in (which, 1 - which)
        )
        U, values, _ = np.linalg.svd(other, full_matrices=False)
        U = U[:, values > 1e-4 * max(float(values.max(initial=0.0)), 1e-300)]
        beyond = np.linalg.norm(own - U @ (U.T @ own), axis=0)
        size = np.linalg.norm(own, axis=0)
        least = _OWN * np.maximum(size, _UNTOLD * size.max(initial=0.0))
        names = own_names(self.results[which])
        return tuple(n for n, b, s in zip(names, beyond, least, strict=True) if b > s > 0.0)

    def move(self, where: str, q: Array | None, pair: Pair) -> Move:
        """How far the target lies elsewhere.

        Args:
            where: The joint values in words.
            q: shape (N, m), these [rad] or [m]; None: those that both data cover.
            pair: Both under common priors.
        """
        there = self.seen
        here = there if q is None else Seen.at(*self.results, q)
        shape, covariance = here.difference.shape, pair.joint
        difference = self._left(_moved(here, pair), _moved(there, pair), here).reshape(shape)
        J = [
            np.hstack([k * e.reshape(s.difference.size, -1) for k, e in zip((-1, 1), s.effects, strict=True)])
            for s in (here, there)
        ]  # fmt: skip
        left = self._left(J[0], J[1], here).reshape(*shape, -1)[:, :3]
        points, turns = difference[:, :3], difference[:, 3:] / _LEVER
        square, count = np.sum(points**2, axis=1), len(points)
        rms = float(np.sqrt(np.mean(square)))
        noise = float(np.einsum("ndp,pq,ndq->", left, covariance, left)) / count
        slope = np.einsum("nd,ndp->p", points, left)
        own = float(slope @ covariance @ slope)
        return Move(
            where=where,
            rms=rms,
            max=float(np.sqrt(square.max())),
            noise=float(np.sqrt(max(noise, 0.0))),
            std=float(np.sqrt(max(own, 0.0))) / (count * rms) if rms > 0.0 else 0.0,
            rms_angle=float(np.sqrt(np.mean(np.sum(turns**2, axis=1))))
            if turns.size
            else float("nan"),
        )

    def _left(self, moves: Array, there: Array, seen: Seen) -> Array:
        """Moves at some joint values less the motion that makes up for those at the fitted ones.

        Args:
            moves: shape (N D,) or (N D, k), at the joint values of ``seen``.
            there: The same moves at the joint values of ``self.seen``.
            seen: Both results at the joint values of ``moves``.
        """
        G = seen.gauge.reshape(seen.difference.size, -1)
        return np.asarray(moves - G @ (self.solve @ there))

    def _own_effects(self, which: int) -> tuple[Array, Array]:
        """Effects before and after compensation, shapes (N D, p); nothing is left of those that are not told."""
        flat: Array = self.seen.effects[which].reshape(self.seen.difference.size, -1)
        left = self._left(flat, flat, self.seen)
        told = np.linalg.norm(left, axis=0) >= _UNTOLD * np.linalg.norm(flat, axis=0)
        return flat, np.where(told, left, 0.0)


def unknown_frame(c: Calibration) -> tuple[str, ...]:
    """In which directions a result's measurements did not know where the base stands."""
    if not c.tells_place:
        return DIRECTIONS  # sockets, planes, anchors and pairs never do
    every = {d for directions in c.setup.unknown for d in directions if c.frame_estimated}
    return tuple(d for d in DIRECTIONS if d in every)


def _moved(seen: Seen, pair: Pair) -> Array:
    """How far the target lies elsewhere, under common priors, before compensation, shape (N D,)."""
    a, b = seen.slopes
    return np.asarray(seen.difference + b @ pair.b.shift - a @ pair.a.shift).ravel()


def _own_kinematics(c: Calibration, T_tip_target: Array) -> tuple[Kinematics, Array]:
    """A result's nominal robot under its own parameters, in the base, and their values."""
    placed = c.model.family(FRAME, TARGET)
    model = c.model.without(n for n, other in zip(c.model.names, placed, strict=True) if other)
    frames = np.tile(np.eye(4), (len(c.setup.groups), 1, 1))
    targets = np.tile(T_tip_target, (len(c.setup.targets), 1, 1))
    return Kinematics(c.nominal, model, frames, targets), c.x[own_parameters(c)]


def _lengths(twists: Array, *, turns: bool) -> Array:
    """Twists as lengths, shape (N, D, k): the linear part, and the angular one by the lever if it counts."""
    if not turns:
        return np.asarray(twists[:, :3])
    return np.concatenate([twists[:, :3], _LEVER * twists[:, 3:]], axis=1)


def _gauge(T: Array, frame: tuple[str, ...], *, target: bool, turns: bool) -> Array:
    """Twists of the target by a unit of what was estimated of frame and target, shape (N, 6, g)."""
    n, points, R = len(T), T[:, :3, 3], T[:, :3, :3]
    columns = []
    for direction in frame:
        k = DIRECTIONS.index(direction)
        twist, e = np.zeros((n, 6)), np.eye(3)[k % 3]
        if k < 3:
            twist[:, :3] = e
        else:
            twist[:, :3], twist[:, 3:] = np.cross(e, points), e
        columns.append(twist)
    for k in range((6 if turns else 3) if target else 0):
        twist, part = np.zeros((n, 6)), slice(0, 3) if k < 3 else slice(3, 6)
        twist[:, part] = R[:, :, k % 3]
        columns.append(twist)
    return np.stack(columns, axis=2) if columns else np.zeros((n, 6, 0))
