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

from calib.errors import ModelError, choices
from calib.identify.common_priors import estimated, own_units
from calib.identify.compared import Compared
from calib.identify.drift import Pair
from calib.model.error_model import error_model
from calib.model.kinematics import Kinematics
from calib.model.observability import steps
from calib.model.robot import Robot

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

_DIRECTIONS = ("x", "y", "z", "rx", "ry", "rz")


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
        families: Of each result the family of each of these.
        gauge: shape (N, D, g), what frames and targets would make up for.
    """

    difference: Array
    effects: tuple[Array, Array]
    slopes: tuple[Array, Array]
    families: tuple[tuple[str, ...], tuple[str, ...]]
    gauge: Array

    @classmethod
    def at(cls, a: Compared, b: Compared, robot: Robot, q: Array) -> Seen:
        """Predict.

        Args:
            a: One result.
            b: The other.
            robot: The robot of both, nominal or corrected.
            q: shape (N, m), joint values [rad] or [m].

        Raises:
            UrdfError: The robot lacks a joint.
            ModelError: It has not the parameters that a result has values for.
        """
        turns = a.turns and b.turns
        T_tip_target = next(iter(a.stored.known.targets.values()))
        starts, poses, effects, slopes, families = [], [], [], [], []
        for one in (a, b):
            kinematics, x = _kinematics(one, robot, T_tip_target)
            # At the nominal robot, from which both count: elsewhere they would differ by what is of second order, and
            # that would look like combinations of their own.
            start, twists = kinematics.twists(np.zeros_like(x), q)
            starts.append(start)
            found, at_result = kinematics.twists(x, q)
            poses.append(found)
            slopes.append(_lengths(at_result, turns=turns))
            effects.append(_lengths(twists, turns=turns))
            families.append(tuple(p.family for p in kinematics.model.parameters))
        shift = poses[1][:, :3, 3] - poses[0][:, :3, 3]
        if turns:
            turned = poses[1][:, :3, :3] @ poses[0][:, :3, :3].transpose(0, 2, 1)
            shift = np.hstack([shift, _LEVER * Rotation.from_matrix(turned).as_rotvec()])
        frame = tuple(d for d in _DIRECTIONS if d in {*a.frame, *b.frame})
        target = a.target_estimated or b.target_estimated
        gauge = _gauge(starts[0], frame, target=target, turns=turns)
        return cls(
            difference=shift,
            effects=(effects[0], effects[1]),
            slopes=(slopes[0], slopes[1]),
            families=(families[0], families[1]),
            gauge=_lengths(gauge, turns=turns),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Compensated:
    """What is left of moves after the best motion of frame and target is taken off.

    Attributes:
        seen: At the joint values that say what that motion is.
        solve: shape (g, N D), takes moves there to the motion.
        basis: shape (N D, r), orthonormal, of all that both results' parameters can do.
    """

    seen: Seen
    solve: Array
    basis: Array
    a: Compared
    b: Compared

    @classmethod
    def of(cls, seen: Seen, a: Compared, b: Compared, *, same_start: bool) -> Compensated:
        """From both results at joint values that their data cover.

        Args:
            seen: Both there.
            a: One result.
            b: The other.
            same_start: Whether both count from the same nominal robot.
        """
        rows = seen.difference.size
        G: Array = seen.gauge.reshape(rows, -1)
        solve: Array = np.zeros((G.shape[1], rows))
        if G.shape[1]:
            solve = np.asarray(np.linalg.pinv(G, rcond=1e-9))
        every = [
            _less(effect.reshape(rows, -1), G, solve) * steps(own_units(one))
            for effect, one in zip(seen.effects, (a, b), strict=True)
        ]
        stacked = np.hstack(every)
        U, values, _ = np.linalg.svd(stacked, full_matrices=False)
        strongest = max(float(values[0]) if len(values) else 0.0, 1e-300)
        least = strongest * (_NOTHING if same_start else _NOTHING_APART)
        return cls(seen, solve, U[:, values > least], a, b)

    def left(self, moves: Array, there: Array, seen: Seen) -> Array:
        """Moves at some joint values less the motion that makes up for those at the fitted ones.

        Args:
            moves: shape (N D,) or (N D, k), at the joint values of ``there``'s rows.
            there: The same moves at the joint values of ``self.seen``.
            seen: Both results at the joint values of ``moves``.
        """
        G = seen.gauge.reshape(seen.difference.size, -1)
        return np.asarray(moves - G @ (self.solve @ there))

    def effects(self, which: int) -> Array:
        """What a unit of a result's own parameters does, after compensation, in the basis, shape (r, p)."""
        _, left = self._own_effects(which)
        return np.asarray(self.basis.T @ left)

    def _own_effects(self, which: int) -> tuple[Array, Array]:
        """Effects before and after compensation, shapes (N D, p); nothing is left of those that are not told."""
        flat: Array = self.seen.effects[which].reshape(self.seen.difference.size, -1)
        left = self.left(flat, flat, self.seen)
        told = np.linalg.norm(left, axis=0) >= _UNTOLD * np.linalg.norm(flat, axis=0)
        return flat, np.where(told, left, 0.0)

    def reach(self, which: int) -> Array:
        """How far a unit of each of a result's own parameters moves the target, rms, shape (p,), [m per unit]."""
        shape = self.seen.effects[which].shape
        points = self._own_effects(which)[1].reshape(shape)[:, :3]
        return np.asarray(np.sqrt(np.sum(points**2, axis=(0, 1)) / shape[0]))

    @property
    def floor(self) -> float:
        """What stands for rounding in each coordinate of the basis [m]."""
        return float(_ROUNDING * np.sqrt(len(self.seen.difference)))

    def pair(self, *, alike: bool) -> Pair:
        """Both results in the basis, under common priors.

        Args:
            alike: See `Pair`.
        """
        return Pair(
            estimated(self.a, self.b, self.effects(0)),
            estimated(self.b, self.a, self.effects(1)),
            alike,
        )

    def difference(self, pair: Pair) -> Array:
        """The difference in the basis, under common priors, shape (r,)."""
        flat = self.moved(self.seen, pair).ravel()
        return np.asarray(self.basis.T @ self.left(flat, flat, self.seen))

    @staticmethod
    def moved(seen: Seen, pair: Pair) -> Array:
        """How far the target lies elsewhere at some joint values, under common priors, before compensation, (N, D)."""
        a, b = seen.slopes
        return np.asarray(seen.difference + b @ pair.b.shift - a @ pair.a.shift)

    def untold(self) -> tuple[str, ...]:
        """The parameters that frame and target make up for, of both results."""
        names: dict[str, None] = {}
        for k, one in enumerate((self.a, self.b)):
            left = np.any(self._own_effects(k)[1], axis=0)
            names |= {
                name: None
                for name, any_left in zip(one.own_names, left, strict=True)
                if not any_left
            }
        return tuple(names)

    def alone(self, which: int) -> tuple[str, ...]:
        """The parameters of one result that move the target in ways that the other's cannot."""
        one, own, other = (self.a, self.b)[which], self.effects(which), self.effects(1 - which)
        own_steps, other_steps = (steps(own_units(r)) for r in (one, (self.b, self.a)[which]))
        U, values, _ = np.linalg.svd(other * other_steps, full_matrices=False)
        U = U[:, values > 1e-4 * max(float(values.max(initial=0.0)), 1e-300)]
        scaled = own * own_steps
        beyond = np.linalg.norm(scaled - U @ (U.T @ scaled), axis=0)
        size = np.linalg.norm(scaled, axis=0)
        least = _OWN * np.maximum(size, _UNTOLD * size.max(initial=0.0))
        return tuple(
            name for name, b, s in zip(one.own_names, beyond, least, strict=True) if b > s > 0.0
        )

    def move(self, where: str, seen: Seen, pair: Pair) -> Move:
        """How far the target lies elsewhere.

        Args:
            where: The joint values in words.
            seen: Both results at these joint values.
            pair: Both under common priors.
        """
        there, here, covariance = self.seen, seen, pair.joint
        moves = [self.moved(s, pair).ravel() for s in (here, there)]
        difference = self.left(moves[0], moves[1], here)
        J = [
            np.hstack([-s.effects[0].reshape(s.difference.size, -1),
                       s.effects[1].reshape(s.difference.size, -1)])
            for s in (here, there)
        ]  # fmt: skip
        shape = here.difference.shape
        left = self.left(J[0], J[1], here).reshape(*shape, -1)[:, :3]
        points = difference.reshape(shape)[:, :3]
        square, count = np.sum(points**2, axis=1), len(points)
        slope = np.einsum("nd,ndp->p", points, left)
        rms = float(np.sqrt(np.mean(square)))
        noise = float(np.einsum("ndp,pq,ndq->", left, covariance, left)) / count
        own = float(slope @ covariance @ slope)
        turns = difference.reshape(shape)[:, 3:] / _LEVER
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


def _kinematics(one: Compared, robot: Robot, T_tip_target: Array) -> tuple[Kinematics, Array]:
    """A result's nominal robot under its own parameters, in the base, and their values."""
    nominal = one.stored.nominal(robot)
    model = error_model(nominal, one.model, target=False)
    names = set(model.names)
    ties = {n: t for n, t in one.ties.items() if n in names and t[0] in names}
    model = model.tied(ties)
    kept = set(one.own_names)
    model = model.without([name for name in model.names if name not in kept])
    order = [one.names.index(name) for name in model.names]
    if len(order) != len(kept) or order != one.own.tolist():
        strange = [name for name in one.own_names if name not in names]
        message = (
            f"{one.name} has values for {choices(strange or one.own_names)}, which the model '{one.model}' of this "
            "robot has not, or not in this order. Give the URDF that the result was made with."
        )
        raise ModelError(message)
    return Kinematics(nominal, model, np.eye(4), T_tip_target), one.delta[one.own]


def _lengths(twists: Array, *, turns: bool) -> Array:
    """Twists as lengths, shape (N, D, k): the linear part, and the angular one by the lever if it counts."""
    if not turns:
        return np.asarray(twists[:, :3])
    return np.concatenate([twists[:, :3], _LEVER * twists[:, 3:]], axis=1)


def _gauge(T: Array, frame: tuple[str, ...], *, target: bool, turns: bool) -> Array:
    """Twists of the target by a unit of what was estimated of frame and target, shape (N, 6, g)."""
    n, points, R = len(T), T[:, :3, 3], T[:, :3, :3]
    columns = []
    for k, direction in enumerate(_DIRECTIONS):
        if direction not in frame:
            continue
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


def _less(moves: Array, G: Array, solve: Array) -> Array:
    """Moves without what the gauge makes up for."""
    return np.asarray(moves - G @ (solve @ moves))
