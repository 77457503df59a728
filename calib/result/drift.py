"""Whether two estimates of one robot differ by more than their noise, and how far its target lies elsewhere.

**The difference** of two results' predictions of one target in the base, with the target t of the first result, is

    delta(q) = T_b(q) t - T_a(q) t  =  J_b x_b - J_a x_a  to first order.

Where a fit found the base's place from its own data, a motion of the whole robot cannot be told from a tracker that
stands elsewhere; where it found the target, a shift that is constant in the tip cannot be told from a target mounted
anew. The part of delta that such motions G make up for best, by least squares over some joint values, is taken off,
there and at any other joint values. Measured orientations count as what they do at the end of a lever of 100 mm.

**The test.** Priors pull, and their sizes are found from the data: two fits of one robot may be pulled differently. So
both are brought to common priors first. A result is x with the covariance C = (H + P)^-1, where H is what the data know
and P the priors' precision, and the data push against the priors by s, which is P x where x is the least of all
squares. Under other priors Q that would be, to first order,

    C_q = (C^-1 + Q - P)^-1,        x_q = x + C_q (s - Q x).

With Q no sharper than either of both, and never so sharp that it would hide a drift, the difference of an unchanged
robot's estimates, the robot drawn from that prior, has the covariance

    V = N_a + N_b + (C_b Q - C_a Q) Q^-1 (C_b Q - C_a Q)^T,        N = C_q - C_q Q C_q,

which is less than C_a + C_b, most of all where the data know little and both say what the prior says. Combinations are
tested that the data know better than the prior, C_a + C_b < Q^-1. On the k of them d^T V^-1 d / k has the F
distribution with k and nu degrees of freedom, because the noise was estimated; nu is that of B. L. Welch, The
generalization of Student's problem, Biometrika 34, 1947, by traces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.linalg import eigh
from scipy.spatial.transform import Rotation

from calib.model.error_model import DIRECTIONS
from calib.model.kinematics import Kinematics
from calib.model.observability import steps
from calib.model.parameters import FRAME, TARGET
from calib.result.calibration import Calibration

Array = NDArray[np.float64]

#: A difference is called a drift below this probability: one comparison in a hundred of an unchanged robot says so.
LEVEL = 0.01

#: Smallest probability told; below it distributions have no digits.
_LEAST = 1e-300

#: A combination takes part where the share of its variance that the data leave over, C / (C + S), is below this.
_KNOWN = 0.5

#: Priors are no wider than this many steps of 1 mm and 1 mrad when it comes to what the data know; and how large a
#: drift the common priors leave room for, in the same steps.
_WIDEST, _ROOM = 10.0, 0.2

#: What an angle counts for beside a length [m].
_LEVER = 0.1

#: A combination whose effect is below this share of the strongest one's has none; the second where the results count
#: from different nominal robots, whose effects differ by what is of second order.
_NOTHING, _NOTHING_APART = 1e-5, 2e-3

#: A parameter with more than this share of its effect outside of what the other result's can do is its own; one of
#: whose effect less than this share is left is not told from frame and target.
_OWN, _UNTOLD = 0.03, 0.03

#: What a difference in one coordinate of one pose must exceed to be more than rounding [m].
_ROUNDING = 1e-7


def own_parameters(c: Calibration) -> NDArray[np.int_]:
    """Which parameters are the robot's own: those of frames and targets left out; shape (k,)."""
    return np.flatnonzero(~c.model.family(FRAME, TARGET))


def own_names(c: Calibration) -> tuple[str, ...]:
    """The names of these."""
    return tuple(c.model.names[k] for k in own_parameters(c))


def unknown_frame(c: Calibration) -> tuple[str, ...]:
    """In which directions a result's measurements did not know where the base stands."""
    if not c.tells_place:
        return DIRECTIONS  # sockets, planes, anchors and pairs never do
    every = {d for directions in c.setup.unknown for d in directions if c.frame_estimated}
    return tuple(d for d in DIRECTIONS if d in every)


def _own_steps(c: Calibration) -> Array:
    """What arms are typically wrong by in each of their own parameters."""
    return steps([c.model.units[k] for k in own_parameters(c)])


@dataclass(frozen=True, slots=True, eq=False)
class Estimated:
    """One estimate under the common priors Q, of r coordinates of the test and p parameters.

    Attributes:
        effect: shape (r, p), what a unit of each parameter does to each coordinate.
        covariance: shape (p, p), C; ``noise`` (p, p) is the part of it that is the noise's, C - C Q C over all
            parameters of the fit, and ``pull`` (p, p) is C Q.
        prior: shape (p,), variance of the prior of each parameter.
        freedom: Degrees of freedom that the noise was estimated with.
        shift: shape (p,), x_q - x; not used by the test itself.
    """

    effect: Array
    covariance: Array
    noise: Array
    pull: Array
    prior: Array
    freedom: float
    shift: Array

    @property
    def spread(self) -> Array:
        """The covariance of the coordinates, shape (r, r)."""
        return np.asarray(self.effect @ self.covariance @ self.effect.T)

    @classmethod
    def of(cls, one: Calibration, other: Calibration, effect: Array) -> Estimated:
        """A result's own parameters, of effect (r, p), under priors that both share and that leave room for a drift."""
        own, step, precision = own_parameters(one), _own_steps(one), _precision(one)
        of_other = dict(zip(other.model.names, _precision(other), strict=True))
        shared = [min(precision[k], of_other.get(one.model.names[k], np.inf)) for k in own]
        # Never wider than anything an arm may err by either: with priors off there is none.
        shared = np.clip(shared, 1.0 / (_WIDEST * step) ** 2, 1.0 / (_ROOM * step) ** 2)
        common = precision.copy()
        common[own] = shared
        common[[p.at_bound for p in one.parameters]] = 0.0
        C = _under(one, common - precision)
        noise, of_own = C - (C * common) @ C, C[np.ix_(own, own)]
        push = np.array([one.parameters[k].push for k in own])
        return cls(
            effect=effect,
            covariance=of_own,
            noise=noise[np.ix_(own, own)],
            pull=of_own * common[own],
            prior=1.0 / shared,
            freedom=one.freedom,
            shift=of_own @ (push - common[own] * one.x[own]),
        )


def _precision(c: Calibration) -> Array:
    """One over the variance of each parameter's prior, shape (p,); 0 without one."""
    return np.nan_to_num(np.array([one.prior_std for one in c.parameters]) ** -2.0)


def _under(one: Calibration, more: Array) -> Array:
    """The covariance under other priors, (C^-1 + Q - P)^-1, shape (p, p). Parameters at a bound stay there."""
    free = np.flatnonzero([not p.at_bound for p in one.parameters])
    block = np.ix_(free, free)
    scale = np.sqrt(np.diag(one.covariance)[free])
    scale = np.where(scale > 0.0, scale, 1.0)
    correlation = one.covariance[block] / np.outer(scale, scale)
    M = np.linalg.pinv(correlation, rcond=1e-14, hermitian=True)
    M += np.diag(more[free] * scale**2)
    # Scaled anew, so that what had been held tightly does not drown the rest.
    size = 1.0 / np.sqrt(np.maximum(np.diag(M), 1e-12))
    inverse = np.linalg.pinv(M * np.outer(size, size), rcond=1e-13, hermitian=True)
    C = np.zeros_like(one.covariance)
    C[block] = inverse * np.outer(size * scale, size * scale)
    return C


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """Two estimates of the same coordinates, and what the difference of an unchanged robot's spreads by.

    ``alike`` says whether both have the same parameters under priors with the same mean; otherwise they are taken to
    err independently of each other, which is too much rather than too little.
    """

    a: Estimated
    b: Estimated
    alike: bool

    @property
    def covariance(self) -> Array:
        """V of the module's text, in the coordinates, shape (r, r)."""
        a, b = self.a, self.b
        if not self.alike:
            return a.spread + b.spread
        pull = b.pull - a.pull
        both = a.noise + b.noise + (pull * np.maximum(a.prior, b.prior)) @ pull.T
        return np.asarray(a.effect @ both @ a.effect.T)

    @property
    def joint(self) -> Array:
        """The covariance of (x_a, x_b) about a common truth, shape (p_a + p_b, p_a + p_b)."""
        a, b = self.a, self.b
        if self.alike:
            noise, pull = (a.noise, b.noise), np.vstack([a.pull, b.pull])
            common = (pull * np.maximum(a.prior, b.prior)) @ pull.T
        else:
            noise, common = (a.covariance, b.covariance), 0.0
        p, q = (len(one) for one in noise)
        apart = np.block([[noise[0], np.zeros((p, q))], [np.zeros((q, p)), noise[1]]])
        return np.asarray(apart + common)


@dataclass(frozen=True, slots=True)
class DriftTest:
    """The test of one difference: k combinations that the data of both know, d^T V^-1 d over them, and nu.

    ``p`` is the probability of such a difference, or a larger one, where nothing has changed; ``sigma`` the same as
    standard deviations of a normal distribution, one-sided, 0 where p > 0.5.
    """

    combinations: int
    chi_square: float
    freedom: float
    p: float
    sigma: float

    @property
    def drifted(self) -> bool:
        """Whether the difference is more than chance."""
        return self.p < LEVEL


def drift_test(difference: Array, pair: Pair, floor: float) -> DriftTest:
    """Test a difference, b less a, shape (r,); ``floor`` is what stands for rounding in each coordinate, 1 sigma."""
    nothing = DriftTest(0, 0.0, np.inf, 1.0, 0.0)
    if not len(difference):
        return nothing
    both, rounding = (pair.a, pair.b), floor**2 * np.eye(len(difference))
    posterior = pair.a.spread + pair.b.spread + rounding
    prior = np.asarray(sum((one.effect * one.prior) @ one.effect.T for one in both)) / 2.0
    share, vectors = eigh(posterior, posterior + prior)
    kept = vectors[:, share < _KNOWN]
    k = kept.shape[1]
    if k == 0:
        return nothing
    values, axes = eigh(kept.T @ (pair.covariance + rounding) @ kept)
    whitening = ((kept @ axes) / np.sqrt(np.maximum(values, 1e-12 * values[-1]))).T
    chi_square = float(np.sum((whitening @ difference) ** 2))
    shares = [float(np.trace(whitening @ one.spread @ whitening.T)) for one in both]
    freedoms = [max(one.freedom, 1.0) for one in both]
    freedom = sum(shares) ** 2 / sum(s**2 / f for s, f in zip(shares, freedoms, strict=True))
    p = max(float(stats.f.sf(chi_square / k, k, freedom)), _LEAST)
    return DriftTest(k, chi_square, freedom, p, sigma=max(float(stats.norm.isf(p)), 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class Move:
    """How far the target lies elsewhere at some joint values: rms, noise included, and at most [m].

    ``noise`` is what the noise of both results alone would show, rms [m], ``std`` the standard deviation of ``rms``,
    and ``rms_angle`` the rms of the turns [rad], NaN where orientations were not measured.
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


class Seen:
    """Both results at N joint values q, shape (N, m), [rad] or [m]; D = 3, or 6 where orientations count [m].

    ``difference`` (N, D) is b less a; ``effects`` (N D, p) what a unit of each result's own parameters does, ``slopes``
    the same at the results, not at the nominal robot; ``gauge`` (N D, g) what frames and targets would make up for.
    """

    def __init__(self, a: Calibration, b: Calibration, q: Array) -> None:
        """Predict."""
        turns = a.setup.rotation and b.setup.rotation
        starts, poses, self.effects, self.slopes = [], [], [], []
        for one in (a, b):
            own = own_parameters(one)
            others = np.delete(np.array(one.model.names), own)
            frames = np.tile(np.eye(4), (len(one.setup.groups), 1, 1))
            targets = np.tile(a.setup.T_tip_target[0], (len(one.setup.targets), 1, 1))
            kinematics = Kinematics(one.nominal, one.model.without(others), frames, targets)
            # At the nominal robot, from which both count: elsewhere they would differ by what is of second order, and
            # that would look like combinations of their own.
            start, effect = kinematics.twists(np.zeros(len(own)), q)
            found, slope = kinematics.twists(one.x[own], q)
            starts.append(start)
            poses.append(found)
            self.effects.append(_lengths(effect, turns))
            self.slopes.append(_lengths(slope, turns))
        shift = poses[1][:, :3, 3] - poses[0][:, :3, 3]
        if turns:
            turned = poses[1][:, :3, :3] @ poses[0][:, :3, :3].transpose(0, 2, 1)
            shift = np.hstack([shift, _LEVER * Rotation.from_matrix(turned).as_rotvec()])
        self.difference: Array = shift
        directions = [d in {*unknown_frame(a), *unknown_frame(b)} for d in DIRECTIONS]
        T, columns = starts[0], np.zeros((len(q), 6, 12))
        columns[:, :, :6] = np.eye(6)
        columns[:, :3, 3:6] = np.cross(np.eye(3), T[:, None, :3, 3]).transpose(0, 2, 1)
        columns[:, :3, 6:9] = columns[:, 3:, 9:] = T[:, :3, :3]
        target = a.setup.estimate_target or b.setup.estimate_target
        used = [*directions, *[target] * 3, *[target and turns] * 3]
        self.gauge = _lengths(columns[:, :, used], turns)


class Compensated:
    """What is left of moves after the best motion of frame and target is taken off."""

    def __init__(self, a: Calibration, b: Calibration, q: Array, *, same_start: bool) -> None:
        """From both results at joint values (N, m) that their data cover, and whether they count from one robot."""
        self.results, self.seen = (a, b), Seen(a, b, q)
        self.solve = np.linalg.pinv(self.seen.gauge, rcond=1e-9)  # takes moves to the motion
        left = [self._left(effect, effect, self.seen) for effect in self.seen.effects]
        scaled = [one * _own_steps(c) for one, c in zip(left, self.results, strict=True)]
        U, values, _ = np.linalg.svd(np.hstack(scaled), full_matrices=False)
        least = max(values.max(initial=0.0), 1e-300) * (_NOTHING if same_start else _NOTHING_APART)
        #: Orthonormal, shape (N D, r), of all that both results' parameters can do; rounding in each coordinate [m].
        self.basis = U[:, values > least]
        self.floor = float(_ROUNDING * np.sqrt(len(self.seen.difference)))
        size = [np.linalg.norm(effect, axis=0) for effect in self.seen.effects]
        self.told = [
            np.linalg.norm(e, axis=0) >= _UNTOLD * s for e, s in zip(left, size, strict=True)
        ]
        #: What is left of the parameters that are told, in the basis, shape (r, p).
        self.effects = [
            self.basis.T @ np.where(t, e, 0.0) for t, e in zip(self.told, left, strict=True)
        ]

    def pair(self, *, alike: bool) -> Pair:
        """Both results in the basis, under common priors; ``alike`` is that of `Pair`."""
        (a, b), (first, second) = self.results, self.effects
        return Pair(Estimated.of(a, b, first), Estimated.of(b, a, second), alike)

    def difference(self, pair: Pair) -> Array:
        """The difference in the basis, under common priors, shape (r,)."""
        flat = _moved(self.seen, pair)
        return np.asarray(self.basis.T @ self._left(flat, flat, self.seen))

    def untold(self) -> tuple[str, ...]:
        """The parameters that frame and target make up for, of both results."""
        both = zip(self.results, self.told, strict=True)
        names = [
            n for one, told in both for n, t in zip(own_names(one), told, strict=True) if not t
        ]
        return tuple(dict.fromkeys(names))

    def alone(self, which: int) -> tuple[str, ...]:
        """The parameters of one result that move the target in ways that the other's cannot."""
        own, other = (self.effects[k] * _own_steps(self.results[k]) for k in (which, 1 - which))
        U, values, _ = np.linalg.svd(other, full_matrices=False)
        U = U[:, values > 1e-4 * max(float(values.max(initial=0.0)), 1e-300)]
        beyond, size = (np.linalg.norm(one, axis=0) for one in (own - U @ (U.T @ own), own))
        least = _OWN * np.maximum(size, _UNTOLD * size.max(initial=0.0))
        names = own_names(self.results[which])
        return tuple(n for n, b, s in zip(names, beyond, least, strict=True) if b > s > 0.0)

    def move(self, where: str, q: Array | None, pair: Pair) -> Move:
        """How far the target lies elsewhere at joint values (N, m) [rad] or [m]; None: those that both data cover."""
        there = self.seen
        here = there if q is None else Seen(*self.results, q)
        shape, covariance = here.difference.shape, pair.joint
        difference = self._left(_moved(here, pair), _moved(there, pair), here).reshape(shape)
        J = [np.hstack([-s.effects[0], s.effects[1]]) for s in (here, there)]
        left = self._left(J[0], J[1], here).reshape(*shape, -1)[:, :3]
        points, turns = difference[:, :3], difference[:, 3:] / _LEVER
        square, count = np.sum(points**2, axis=1), len(points)
        rms = float(np.sqrt(np.mean(square)))
        noise = float(np.einsum("ndp,pq,ndq->", left, covariance, left)) / count
        slope = np.einsum("nd,ndp->p", points, left)
        own = float(slope @ covariance @ slope)
        angles = np.sqrt(np.mean(np.sum(turns**2, axis=1))) if turns.size else np.nan
        return Move(
            where=where,
            rms=rms,
            max=float(np.sqrt(square.max())),
            noise=float(np.sqrt(max(noise, 0.0))),
            std=float(np.sqrt(max(own, 0.0))) / (count * rms) if rms > 0.0 else 0.0,
            rms_angle=float(angles),
        )

    def _left(self, moves: Array, there: Array, here: Seen) -> Array:
        """Moves (N D, ...) at some joint values less the motion that makes up for those at ``self.seen``."""
        return np.asarray(moves - here.gauge @ (self.solve @ there))


def _moved(seen: Seen, pair: Pair) -> Array:
    """How far the target lies elsewhere, under common priors, before compensation, shape (N D,)."""
    a, b = seen.slopes
    return np.asarray(seen.difference.ravel() + b @ pair.b.shift - a @ pair.a.shift)


def _lengths(twists: Array, turns: bool) -> Array:
    """Twists (N, 6, k) as lengths, shape (N D, k): the linear part, and the angular one by the lever if it counts."""
    parts = [twists[:, :3], _LEVER * twists[:, 3:]] if turns else [twists[:, :3]]
    return np.concatenate(parts, axis=1).reshape(-1, twists.shape[2])
