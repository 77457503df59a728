"""compare: whether two calibrations of one robot differ by more than noise, and how far its target lies elsewhere.

The difference of two results' predictions of one target in the base is delta(q) = J_b x_b - J_a x_a to first order.
Where a fit found the base's place or the target from its own data, the motion of them that explains delta best, by
least squares over the joint values that both data cover, is taken off, there and everywhere. Measured orientations
count as what they do at the end of a lever of 100 mm.

**The test.** Two fits of one robot may be pulled differently by their priors, so both are brought to common priors
first. A result is x with the covariance C = (H + P)^-1, where H is the information of the data and P the priors'
precision, and s is the gradient by which the data push against the priors. Under other priors Q, to first order,

    C_q = (C^-1 + Q - P)^-1,        x_q = x + C_q (s - Q x).

With Q no sharper than either of both, and never so sharp that it would hide a drift, the difference of an unchanged
robot's estimates, the robot drawn from that prior, has the covariance

    V = N_a + N_b + (C_b Q - C_a Q) Q^-1 (C_b Q - C_a Q)^T,        N = C_q - C_q Q C_q.

Tested are the k combinations that the data know better than the prior, C_a + C_b < Q^-1: on them d^T V^-1 d / k has the
F distribution with k and nu degrees of freedom, because the noise was estimated; nu is that of B. L. Welch, Biometrika
34, 1947, by traces.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, eigh
from scipy.spatial.transform import Rotation
from scipy.special import fdtrc, ndtri

from calib.diagnosis.reasons import NO
from calib.errors import ModelError
from calib.model.error_model import DIRECTIONS
from calib.model.kinematics import Kinematics
from calib.model.observability import steps
from calib.model.parameters import FRAME, TARGET
from calib.result.calibration import CalibrationValues
from calib.result.calibration_file import read_result
from calib.robot.ranges import spread_between, spread_poses
from calib.robot.robot import Robot
from calib.units import Array

Outcome = Literal["drift", "no drift shown", "cannot tell"]
#: Why nothing can be told; empty otherwise.
Why = Literal["", "same data", "bad verdict", "nothing known", "other errors"]

#: Joint values over which displacements are averaged; origins and held values that differ by less are the same; what a
#: model lacks shows in its residuals: a displacement this many times as large has another cause.
_POSES, _SAME, _FAR = 200, 1e-9, 3.0

Where = Literal["measured ranges", "joint limits"]

#: A difference is called a drift below this probability: one comparison in a hundred of an unchanged robot says so.
LEVEL = 0.01

#: A combination takes part where the share of its variance that the data leave over, C / (C + S), is below this.
_KNOWN = 0.5

#: In steps of 1 mm and 1 mrad: common priors are no wider than the first, and leave room for a drift of the second.
_WIDEST, _ROOM = 10.0, 0.2

#: What an angle counts for beside a length [m], and the rounding of one coordinate of one pose [m].
_LEVER, _ROUNDING = 0.1, 1e-7

#: Effects below this share of the strongest one's are none; the second where the nominal robots differ.
_NOTHING, _NOTHING_APART = 1e-5, 2e-3

#: A parameter with more than this share of its effect outside of what the other result can do is its own; one of whose
#: effect less than this share is left is not told from frame and target.
_OWN = 0.03


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """A result's own p parameters under the common priors Q."""

    covariance: Array  # (p, p), C
    noise: Array  # (p, p), its part from noise, C - C Q C over all parameters of the fit
    pull: Array  # (p, p), C Q
    prior: Array  # (p,), the variance of each prior
    freedom: float  # Of the noise
    shift: Array  # (p,), x_q - x


@dataclass(frozen=True, slots=True)
class DriftTest:
    """The test of a difference."""

    combinations: int  #: Of parameters that both data know, k
    chi_square: float  #: d^T V^-1 d over them
    freedom: float  #: Of the noise, nu
    p: float  #: The probability of such a difference, or a larger one, where nothing has changed
    sigma: float  #: The same as one-sided standard deviations of a normal distribution; 0 where p > 0.5

    @property
    def drifted(self) -> bool:
        """Whether the difference is more than chance."""
        return self.p < LEVEL


@dataclass(frozen=True, slots=True)
class Displacement:
    """How far the predicted target lies elsewhere in b."""

    where: Where
    rms: float  #: [m], noise included
    max: float  #: [m]
    noise: float  #: The rms that the noise of both alone would show [m]
    std: float  #: Standard deviation of ``rms`` [m]
    rms_angle: float  #: [rad]; NaN where orientations were not measured

    @property
    def moved(self) -> float:
        """The rms without the part of the noise [m]."""
        return float(np.sqrt(max(self.rms**2 - self.noise**2, 0.0)))


@dataclass(frozen=True, slots=True, eq=False, repr=False, kw_only=True)
class ComparisonValues:
    """The result of `compare`."""

    a: CalibrationValues  #: The first result
    b: CalibrationValues  #: The second
    names: tuple[str, str]  #: Their files, or ``"a"`` and ``"b"``
    outcome: Outcome  #: ``"drift"``, ``"no drift shown"`` or ``"cannot tell"``
    why: Why  #: Why nothing can be told; empty otherwise
    robot: Robot  #: The robot whose meshes are shown
    test: DriftTest  #: The test of the difference
    #: Displacement of the target: over the joint values that both data cover, then over the limits
    moves: tuple[Displacement, Displacement]
    untold: tuple[str, ...]  #: Parameters that frame and target make up for
    only_a: tuple[str, ...]  #: Parameters whose effects the second's cannot have
    only_b: tuple[str, ...]  #: The same of the second

    def __repr__(self) -> str:
        """In one line."""
        first, second = self.names
        return f"Comparison({first!r}, {second!r}, {self.outcome}, p = {self.test.p:.2g})"


def compare(
    a: CalibrationValues | str | Path,
    b: CalibrationValues | str | Path,
    robot: Robot | str | Path | None = None,
) -> ComparisonValues:
    """Compare two calibrations of one robot: did it drift?

    Args:
        a: The first: a `Calibration`, or the path of a result file.
        b: The second, made of other measurements.
        robot: The robot, or its URDF, nominal or corrected, to show with its meshes; None: that of the first result.

    Raises:
        FileError: A file cannot be read or is no result.
        ModelError: The results are of different chains.
        UrdfError: The URDF cannot be read, or lacks a joint.
    """
    first, second = (
        one if isinstance(one, CalibrationValues) else read_result(one) for one in (a, b)
    )
    names = (
        "a" if isinstance(a, CalibrationValues) else Path(a).name,
        "b" if isinstance(b, CalibrationValues) else Path(b).name,
    )
    chains = [
        (r.base, r.tip, r.joint_names, set(r.origins()), dict(r.held))
        for r in (first.nominal, second.nominal)
    ]
    if chains[0] != chains[1]:
        raise ModelError(
            f"{names[0]} and {names[1]} are not of one chain: {first.nominal!r}, {second.nominal!r}. Calibrate "
            "both with the same --base, --tip and --hold."
        )
    both, own = (first, second), first.nominal
    shown = own
    if isinstance(robot, Robot):
        shown = robot.rebuilt(base=own.base, tip=own.tip)
    elif robot is not None:
        shown = Robot.load(robot, own.base, own.tip, held=own.held)
    origins = first.nominal.origins(), second.nominal.origins()
    same = all(np.abs(T - origins[1][name]).max() < _SAME for name, T in origins[0].items())
    found = _differences(first, second, same_start=same)
    residual = max(one.errors["calibrated"]["estimation"].rms for one in both)
    unlike = any((*found["only_a"], *found["only_b"])) and found["test"].drifted
    why: Why = ""
    if first is second or (first.source.sha256 and first.source.sha256 == second.source.sha256):
        why = "same data"
    elif any(one.verdict is not None and one.verdict.use == NO for one in both):
        why = "bad verdict"
    elif found["test"].combinations == 0:
        why = "nothing known"
    elif unlike and not found["moves"][0].moved > _FAR * residual:
        why = "other errors"
    outcome: Outcome = "drift" if found["test"].drifted else "no drift shown"
    outcome = "cannot tell" if why else outcome
    return ComparisonValues(
        a=first, b=second, names=names, outcome=outcome, why=why, robot=shown, **found
    )


def _covered(a: Array, b: Array) -> Array:
    """The range of each joint that both data cover, or that either does where that is none, shape (m, 2)."""
    low, high = np.fmax(a[:, 0], b[:, 0]), np.fmin(a[:, 1], b[:, 1])
    apart = ~(low < high)
    low = np.where(apart, np.fmin(a[:, 0], b[:, 0]), low)
    high = np.where(apart, np.fmax(a[:, 1], b[:, 1]), high)
    return np.asarray(np.nan_to_num(np.stack([low, high], axis=1), posinf=0.0, neginf=0.0))


def own_names(c: CalibrationValues) -> tuple[str, ...]:
    """The robot's own parameters: those of frames and targets left out."""
    return tuple(c.model.names[k] for k in _own(c))


def _own(c: CalibrationValues) -> NDArray[np.int_]:
    """The places of these, shape (k,)."""
    return np.flatnonzero(~c.model.family(FRAME, TARGET))


def _own_steps(c: CalibrationValues) -> Array:
    """Typical errors of arms in each of their own parameters."""
    return steps([c.model.units[k] for k in _own(c)])


def unknown_frame(c: CalibrationValues) -> tuple[str, ...]:
    """In which directions a result's measurements did not know where the base stands."""
    if not c.tells_place:
        return DIRECTIONS  # sockets, planes, anchors and pairs never do
    every = {d for directions in c.setup.unknown for d in directions if c.frame_estimated}
    return tuple(d for d in DIRECTIONS if d in every)


def _estimate(one: CalibrationValues, other: CalibrationValues) -> Estimate:
    """A result under priors that both share and that leave room for a drift; parameters at a bound stay there."""
    precision, of_other = (
        np.nan_to_num(np.array([p.prior_std for p in c.parameters]) ** -2.0) for c in (one, other)
    )
    named = dict(zip(other.model.names, of_other, strict=True))
    own, step = _own(one), _own_steps(one)
    shared = [min(precision[k], named.get(one.model.names[k], np.inf)) for k in own]
    # Never wider than anything an arm may err by either: with priors off there is none.
    shared = np.clip(shared, 1.0 / (_WIDEST * step) ** 2, 1.0 / (_ROOM * step) ** 2)
    bounded = np.array([p.at_bound for p in one.parameters], dtype=bool)
    common = precision.copy()
    common[own] = shared
    common[bounded] = 0.0
    free = np.flatnonzero(~bounded)
    block = np.ix_(free, free)
    scale = np.sqrt(np.diag(one.covariance)[free])
    scale = np.where(scale > 0.0, scale, 1.0)
    M = np.linalg.pinv(one.covariance[block] / np.outer(scale, scale), rcond=1e-14, hermitian=True)
    M += np.diag((common - precision)[free] * scale**2)
    # Scaled anew, so that what had been held tightly does not drown the rest.
    size = 1.0 / np.sqrt(np.maximum(np.diag(M), 1e-12))
    C = np.zeros_like(one.covariance)
    C[block] = np.linalg.pinv(M * np.outer(size, size), rcond=1e-13, hermitian=True)
    C[block] *= np.outer(size * scale, size * scale)
    of_own = C[np.ix_(own, own)]
    data_gradient = np.array([one.parameters[k].data_gradient for k in own])
    return Estimate(
        covariance=of_own,
        noise=(C - (C * common) @ C)[np.ix_(own, own)],
        pull=of_own * common[own],
        prior=1.0 / shared,
        freedom=one.freedom,
        shift=of_own @ (data_gradient - common[own] * one.x[own]),
    )


def joint_covariance(a: Estimate, b: Estimate, *, alike: bool) -> Array:
    """The covariance of (x_a, x_b) about a common truth, shape (p_a + p_b, p_a + p_b).

    Estimates that are not ``alike``, of the same parameters, are taken to err independently: too much, not too little.
    """
    if not alike:
        return np.asarray(block_diag(a.covariance, b.covariance))
    pull = np.vstack([a.pull, b.pull])
    return np.asarray(block_diag(a.noise, b.noise) + (pull * np.maximum(a.prior, b.prior)) @ pull.T)


def drift_test(
    difference: Array,
    effects: tuple[Array, Array],
    estimates: tuple[Estimate, Estimate],
    joint: Array,
    floor: float,
) -> DriftTest:
    """Test a difference, b less a, shape (r,).

    Effects (r, p) of both results' parameters on it; joint covariance; rounding of each coordinate, 1 sigma.
    """
    nothing = DriftTest(0, 0.0, np.inf, 1.0, 0.0)
    if not len(difference):
        return nothing
    pairs = list(zip(effects, estimates, strict=True))
    spreads = [effect @ one.covariance @ effect.T for effect, one in pairs]
    rounding = floor**2 * np.eye(len(difference))
    posterior = spreads[0] + spreads[1] + rounding
    prior = np.asarray(sum((effect * one.prior) @ effect.T for effect, one in pairs)) / 2.0
    share, vectors = eigh(posterior, posterior + prior)
    kept = vectors[:, share < _KNOWN]
    k = kept.shape[1]
    if k == 0:
        return nothing
    signed = np.hstack([-effects[0], effects[1]])
    values, axes = eigh(kept.T @ (signed @ joint @ signed.T + rounding) @ kept)
    whitening = ((kept @ axes) / np.sqrt(np.maximum(values, 1e-12 * values[-1]))).T
    chi_square = float(np.sum((whitening @ difference) ** 2))
    shares = [float(np.trace(whitening @ spread @ whitening.T)) for spread in spreads]
    freedoms = [max(one.freedom, 1.0) for one in estimates]
    freedom = sum(shares) ** 2 / sum(s**2 / f for s, f in zip(shares, freedoms, strict=True))
    p = max(float(fdtrc(k, freedom, chi_square / k)), 1e-300)  # below it there are no digits
    return DriftTest(k, chi_square, freedom, p, sigma=max(-float(ndtri(p)), 0.0))


class _Predictions:
    """Both results at N joint values; D = 3, or 6 where orientations count, all as lengths [m].

    ``difference`` (N D,) is b less a; ``effects`` (N D, p) what a unit of each result's own parameters does, ``slopes``
    the same at the results, not at the nominal robot; ``gauge`` (N D, g) what frames and targets would explain.
    """

    def __init__(self, a: CalibrationValues, b: CalibrationValues, q: Array) -> None:
        """Predict at q, shape (N, m), [rad] or [m]."""
        self.turns = a.setup.rotation and b.setup.rotation
        poses, self.effects, self.slopes = [], [], []
        for one in (a, b):
            own = _own(one)
            others = np.delete(np.array(one.model.names), own)
            frames = np.tile(np.eye(4), (len(one.setup.groups), 1, 1))
            targets = np.tile(a.setup.T_tip_target[0], (len(one.setup.targets), 1, 1))
            kinematics = Kinematics(one.nominal, one.model.without(others), frames, targets)
            # At the nominal robot, from which both count: elsewhere they would differ by what is of second order, and
            # that would look like combinations of their own.
            start, effect = kinematics.twists(np.zeros(len(own)), q)
            found, slope = kinematics.twists(one.x[own], q)
            poses.append((start, found))
            self.effects.append(self._lengths(effect))
            self.slopes.append(self._lengths(slope))
        T, (A, B) = poses[0][0], (found for _, found in poses)
        shift = B[:, :3, 3] - A[:, :3, 3]
        if self.turns:
            turned = Rotation.from_matrix(B[:, :3, :3] @ A[:, :3, :3].transpose(0, 2, 1))
            shift = np.hstack([shift, _LEVER * turned.as_rotvec()])
        self.difference = shift.ravel()
        self.signed = np.hstack([-self.effects[0], self.effects[1]])
        columns = np.zeros((len(q), 6, 12))
        columns[:, :, :6] = np.eye(6)
        columns[:, :3, 3:6] = np.cross(np.eye(3), T[:, None, :3, 3]).transpose(0, 2, 1)
        columns[:, :3, 6:9] = columns[:, 3:, 9:] = T[:, :3, :3]
        target = a.setup.estimate_target or b.setup.estimate_target
        used = [d in {*unknown_frame(a), *unknown_frame(b)} for d in DIRECTIONS]
        used += [target] * 3 + [target and self.turns] * 3
        self.gauge = self._lengths(columns[:, :, used])

    def _lengths(self, twists: Array) -> Array:
        """Twists (N, 6, k) as lengths, shape (N D, k)."""
        scaled = twists * np.repeat([1.0, _LEVER], 3)[:, None]
        return np.asarray(scaled[:, : 6 if self.turns else 3].reshape(-1, twists.shape[2]))

    def moved(self, estimates: tuple[Estimate, Estimate]) -> Array:
        """The difference under common priors, shape (N D,)."""
        a, b = self.slopes
        return np.asarray(self.difference + b @ estimates[1].shift - a @ estimates[0].shift)


def _beyond(own: Array, other: Array, names: tuple[str, ...]) -> tuple[str, ...]:
    """The parameters whose effects (r, p), in steps, are not in the span of the other result's."""
    U, values, _ = np.linalg.svd(other, full_matrices=False)
    U = U[:, values > 1e-4 * max(float(values.max(initial=0.0)), 1e-300)]
    beyond, size = (np.linalg.norm(one, axis=0) for one in (own - U @ (U.T @ own), own))
    least = _OWN * np.maximum(size, _OWN * size.max(initial=0.0))
    return tuple(n for n, b, s in zip(names, beyond, least, strict=True) if b > s > 0.0)


def _differences(
    first: CalibrationValues, second: CalibrationValues, *, same_start: bool
) -> dict[str, Any]:
    """What a `Comparison` has from its test on; ``same_start``: both count from the same nominal robot."""
    both, own = (first, second), [own_names(one) for one in (first, second)]
    # Whether both have the same parameters under priors with the same mean.
    alike = same_start and own[0] == own[1] and dict(first.ties) == dict(second.ties)
    alike = alike and first.model.name == second.model.name
    estimates = _estimate(first, second), _estimate(second, first)
    joint = joint_covariance(*estimates, alike=alike)

    here = _Predictions(*both, spread_between(_covered(first.ranges, second.ranges), _POSES))
    solve = np.linalg.pinv(here.gauge, rcond=1e-9)  # takes displacements to the motion
    left = [effect - here.gauge @ (solve @ effect) for effect in here.effects]
    sizes = [np.linalg.norm(effect, axis=0) for effect in here.effects]
    told = [np.linalg.norm(e, axis=0) >= _OWN * s for e, s in zip(left, sizes, strict=True)]
    scaled = np.hstack([effect * _own_steps(one) for effect, one in zip(left, both, strict=True)])
    U, values, _ = np.linalg.svd(scaled, full_matrices=False)
    least = max(values.max(initial=0.0), 1e-300) * (_NOTHING if same_start else _NOTHING_APART)
    basis = U[:, values > least]  # of all that both results' parameters can do
    effects = (
        basis.T @ np.where(told[0], left[0], 0.0),
        basis.T @ np.where(told[1], left[1], 0.0),
    )
    motion = solve @ here.moved(estimates)
    difference = basis.T @ (here.moved(estimates) - here.gauge @ motion)

    def displacement(where: Where, at: _Predictions) -> Displacement:
        """Compensated for frame and target."""
        size = 6 if at.turns else 3
        moved = (at.moved(estimates) - at.gauge @ motion).reshape(-1, size)
        J = at.signed - at.gauge @ (solve @ here.signed)
        J = J.reshape(-1, size, J.shape[1])[:, :3]
        points, angles, count = moved[:, :3], moved[:, 3:] / _LEVER, len(moved)
        own = np.einsum("nd,ndp->p", points, J)
        noise = float(np.einsum("ndp,pq,ndq->", J, joint, J)) / count
        std = float(np.sqrt(max(own @ joint @ own, 0.0)))
        square = np.sum(points**2, axis=1)
        rms = float(np.sqrt(np.mean(square)))
        return Displacement(
            where=where,
            rms=rms,
            max=float(np.sqrt(square.max())),
            noise=float(np.sqrt(max(noise, 0.0))),
            std=std / (count * rms) if rms > 0.0 else 0.0,
            rms_angle=float(np.sqrt(np.mean(np.sum(angles**2, axis=1)))) if at.turns else np.nan,
        )

    there = _Predictions(*both, spread_poses(first.nominal, _POSES))
    A, B = (effect * _own_steps(one) for effect, one in zip(effects, both, strict=True))
    untold = [n for names, known in zip(own, told, strict=True) for n in np.array(names)[~known]]
    rounding = _ROUNDING * np.sqrt(_POSES)
    return {
        "test": drift_test(difference, effects, estimates, joint, rounding),
        "moves": (displacement("measured ranges", here), displacement("joint limits", there)),
        "untold": tuple(dict.fromkeys(map(str, untold))),
        "only_a": _beyond(A, B, own[0]),
        "only_b": _beyond(B, A, own[1]),
    }
