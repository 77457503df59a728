"""One stage of an estimation: noise, prior sizes and weights, and the linearised problem that they are found on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.data.cell import Cell, Priors
from calib.errors import ModelError
from calib.estimate.problem import Linear, Problem
from calib.estimate.robust import Limits, cauchy_weights, median_noise, repeats
from calib.estimate.setup import Setup
from calib.estimate.variance import Known, sizes_by_reml
from calib.model.families import FAMILIES
from calib.model.parameters import FRAME, TARGET, ErrorModel, frame_place, target_place
from calib.robot.robot import rigid_inverse

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Integers = NDArray[np.int_]

#: The noise may be ten times larger or smaller than the one given or assumed, a standard deviation of its logarithm.
NOISE_SPREAD = float(np.log(10.0))

#: With fewer degrees of freedom no row can be told from the others, and all keep their weight.
FEWEST_FREEDOM = 6.0

#: Without priors this holds what no measurement determines: far wider than an arm's errors [m and rad].
_LEASH = 1.0

#: Target and frame stay within this of where registration put them, unless the data say otherwise: far more than
#: registration is off by, and a hold where nothing tells them from each other [m and rad].
_PLACED = 1.0

#: How tightly a parameter is held at its bound, in its unit.
_FIXED = 1e-10

#: Weights that change by less have settled, and noise and sizes that change by less of themselves.
SETTLED, SETTLED_SIZES = 0.02, 0.01

#: Repeats must leave this many degrees of freedom before their scatter is believed.
_TELLING_REPEATS = 6.0


@dataclass(frozen=True, slots=True, eq=False)
class Holds:
    """What holds parameters besides the measurements: families with a size each, single priors, bounds."""

    names: tuple[str, ...]  # The families' names
    families: Mask  # shape (K, p), which parameters belong to each
    start: tuple[float, ...]  # The sizes to begin with
    # shape (p,), of parameters with a prior of their own, and of frames and targets
    precision: Array
    # shape (p,), the priors' means: 0 but for parameters at a bound, and for a target or frame that was said to be
    # elsewhere than where it was registered
    centre: Array
    # shape (p,), frames and targets without a prior of their own: what holds them is none
    flat: Mask
    adapts: bool  # Whether the sizes are found from the data
    off: bool  # Whether there are no priors but the leash
    # shape (p, 2), lowest and highest value of each parameter; None without
    limits: Array | None = None
    fixed: tuple[int, ...] = ()  # Parameters that stand at a bound

    @classmethod
    def of(
        cls,
        model: ErrorModel,
        priors: Priors,
        single: Mapping[str, float] | None = None,
        nominal: Array | None = None,
    ) -> Holds:
        """From the cell's priors."""
        single = single or {}
        placed = model.family(FRAME, TARGET)
        std = np.array([single.get(name, np.nan) for name in model.names])
        alone, off = np.isfinite(std), priors.sizes == "off"
        names = tuple(f for f in model.families if np.any(model.family(f) & ~alone))
        return cls(
            names=names,
            families=np.array([model.family(f) & ~alone for f in names]).reshape(-1, len(model)),
            start=tuple(_LEASH if off else priors.of(f) for f in names),
            precision=np.where(alone, 1.0 / std**2, np.where(placed, 1.0 / _PLACED**2, 0.0)),
            centre=np.where(alone, 0.0 if nominal is None else nominal, 0.0),
            flat=placed & ~alone,
            adapts=priors.sizes == "data",
            off=off,
        )

    @classmethod
    def of_cell(
        cls, cell: Cell, model: ErrorModel, given: Setup, started: Setup, *, lenient: bool
    ) -> Holds:
        """From the cell: priors of families and single parameters, bounds.

        A change counts from the nominal value. That of a target or a frame is where the cell says it is, which is not
        where registration puts it and where the estimation starts.

        Raises:
            ModelError: A bound or a prior for a parameter that the model lacks, or for that of a target or frame that
                was not said to be anywhere.
        """
        asked = (cell.bounds, cell.parameter_priors)
        known = [k for k in {**asked[0], **asked[1]} if k in model.names or not lenient]
        nominal = _nominal(given, started, model, {model.index(name) for name in known})
        holds = cls.of(model, cell.priors, cell.parameter_priors, nominal)
        bounded = {model.index(name): cell.bounds[name] for name in known if name in cell.bounds}
        if not bounded:
            return holds
        limits = np.tile([-np.inf, np.inf], (len(model), 1))
        for k, ends in bounded.items():
            limits[k] = nominal[k] + np.array(ends)
        return replace(holds, limits=limits)

    def at_bounds(self, fixed: Mapping[int, float]) -> Holds:
        """With some parameters, by their numbers, held at these values."""
        if not fixed:
            return self
        at, centre = np.zeros(len(self.precision), dtype=bool), self.centre.copy()
        at[list(fixed)], centre[list(fixed)] = True, list(fixed.values())
        families = self.families & ~at
        kept = np.flatnonzero(families.any(axis=1)).tolist()
        return replace(
            self,
            names=tuple(self.names[k] for k in kept),
            families=families[kept],
            start=tuple(self.start[k] for k in kept),
            precision=np.where(at, 1.0 / _FIXED**2, self.precision),
            centre=centre,
            flat=self.flat & ~at,
            fixed=tuple(sorted(fixed)),
        )

    @property
    def bounds(self) -> tuple[tuple[float, float], ...]:
        """Smallest and largest size of each family."""
        return tuple(FAMILIES[f].bounds for f in self.names)


def _nominal(given: Setup, started: Setup, model: ErrorModel, asked: set[int]) -> Array:
    """Where the changes of parameters count from, shape (p,): 0, but for targets and frames, which registration moved.

    A displacement by x, y, z, rx, ry, rz in this order has these translations and these angles about moving axes.

    Raises:
        ModelError: One that is asked for is of a target or frame that was not given.
    """
    frames = zip(given.frame_given, started.T_frame_base, given.T_frame_base, strict=True)
    targets = zip(given.target_given, started.T_tip_target, given.T_tip_target, strict=True)
    places = dict(zip(map(frame_place, given.frame_unknowns), frames, strict=True))
    places |= dict(zip(map(target_place, given.target_names), targets, strict=True))
    result = np.zeros(len(model))
    for k in asked:
        parameter = model.parameters[k]
        if parameter.place not in places:
            continue
        known, start, wanted = places[parameter.place]
        if not known:
            what = "target" if parameter.family == TARGET else "frame"
            raise ModelError(
                f"'{parameter.name}' has a bound or a prior on its change, but it is not said from where: give the "
                f"{what} in the cell file, or drop the bound."
            )
        moved = rigid_inverse(start) @ wanted
        angles = Rotation.from_matrix(moved[:3, :3]).as_euler("XYZ")
        result[k] = parameter.direction @ np.concatenate([moved[:3, 3], angles])
    return result


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """Weights, noise and prior sizes at one time of an estimation, or of B at a time that lack some rows each."""

    holds: Holds  # What holds the parameters
    kept: Mask  # shape (B, N), the rows that each has
    weights: Array  # shape (B, N), robust weights; 0 for rows that are not there
    share: Array  # shape (B, N), what a row counts for beside its repeats
    noise: Array  # shape (B, C), of each instrument, in units of the sigma given
    sizes: Array  # shape (B, K), of each family

    @classmethod
    def first(
        cls, holds: Holds, kept: Mask, instruments: int, weights: Array | None = None
    ) -> Stage:
        """The noise as given, the priors as wide as they were given; all rows in full, or with these weights."""
        B, ones = len(kept), np.ones(kept.shape)
        weights = kept.astype(np.float64) if weights is None else kept * weights
        sizes = np.tile(np.array(holds.start, dtype=np.float64), (B, 1))
        return cls(holds, kept, weights, ones, np.ones((B, instruments)), sizes)

    def at(self, which: Integers) -> Stage:
        """Some of the fits."""
        return replace(self, **{name: getattr(self, name)[which] for name in _EACH})

    def put(self, which: Integers, found: Stage) -> Stage:
        """With these fits in the place of some."""
        values = {name: getattr(self, name).copy() for name in _EACH}
        for name, value in values.items():
            value[which] = getattr(found, name)
        return replace(self, **values)

    @property
    def effective(self) -> Array:
        """The weights of the rows, repeats shared out, shape (B, N)."""
        return self.weights * self.share

    @property
    def precision(self) -> Array:
        """1 / tau^2 of each parameter, shape (B, p)."""
        return (1.0 / self.sizes**2) @ self.holds.families + self.holds.precision

    def known(self, linear: Linear) -> Known:
        """All that is known besides the measurements, at these sizes."""
        return linear.known(self.precision, self.holds.centre)

    def fit(self, linear: Linear) -> tuple[Array, Array, Array]:
        """See `calib.estimate.problem.Linear.fit`."""
        return linear.fit(self.effective, self.noise, self.known(linear))

    def problem(self, problem: Problem) -> Problem:
        """The problem in the form of the only fit."""
        instruments, _ = problem.rows.instruments
        scales = np.append(self.noise[0], 1.0)[instruments] * problem.rows.scales
        centre = self.holds.centre
        return problem.reweighted(self.effective[0], scales, self.precision[0], centre)

    def by_median(self, linear: Linear) -> Stage:
        """Robust weights against a scale that outliers cannot move, on the linearised problem."""
        stage = self
        for _ in range(3):
            effective = stage.effective
            x, covariance, _ = stage.fit(linear)
            noise = np.empty_like(stage.noise)
            for c, smallest in enumerate(linear.smallest):
                unit = covariance / stage.noise[:, c, None, None] ** 2
                single = linear.norms(x, unit, effective, c)
                noise[:, c] = median_noise(single, linear.instruments == c, stage.kept)
                noise[:, c] = np.maximum(noise[:, c], smallest)
            stage = replace(stage, noise=noise)
            # Scores in units of the new noise need the covariance that goes with it.
            x, covariance, _ = stage.fit(linear)
            scores = linear.scores(x, covariance, effective, noise)
            stage = replace(stage, weights=cauchy_weights(scores) * stage.kept)
        return stage

    def by_likelihood(self, linear: Linear, *, robust: bool) -> Stage:
        """Noise and prior sizes by restricted likelihood, and the weights that go with them."""
        stage, holds = self, self.holds
        for _ in range(2 if robust else 1):
            if robust:
                stage = replace(stage, weights=stage._row_weights(linear))
            noise, sizes = sizes_by_reml(
                linear.data(stage.effective),
                holds.families if holds.adapts else holds.families[:0],
                stage.noise,
                stage.sizes if holds.adapts else stage.sizes[:, :0],
                smallest_noise=linear.smallest,
                noise_spread=NOISE_SPREAD,
                known=linear.known(
                    holds.precision if holds.adapts else self.precision, holds.centre
                ),
                bounds=holds.bounds if holds.adapts else (),
            )
            stage = replace(stage, noise=noise, sizes=sizes if holds.adapts else stage.sizes)
        return stage

    def _row_weights(self, linear: Linear) -> Array:
        """The weights that the scores of the linear fit ask for."""
        x, covariance, freedom = self.fit(linear)
        count = np.sum(self.kept, axis=1)
        scores = linear.scores(x, covariance, self.effective, self.noise)
        found = Limits.of(count[:, None], freedom[:, None]).weights(scores) * self.kept
        # Half of the rows cannot be outliers of the other half: then it is the noise that is taken too small.
        told = (freedom > FEWEST_FREEDOM) & (np.sum(found, axis=1) > 0.5 * count)
        return np.where(told[:, None], found, self.kept)

    def sharing(self, linear: Linear, poses: Integers, mode: str) -> Stage:
        """What each of n repeats counts for, 1 / (1 + (n - 1) rho), with their correlation rho from what is left over.

        Args:
            linear: The linearised problem.
            poses: shape (N,), the pose of each row.
            mode: ``"independent"``: rho = 0; ``"average"``: 1; ``"weighted"``: found.
        """
        number, alive = int(poses.max()) + 1, self.weights > 0.0
        counts = np.array([np.bincount(poses[own], minlength=number)[poses] for own in alive])
        if mode == "independent" or np.max(counts) < 2:
            return self
        rho = np.ones(len(alive))
        if mode == "weighted":
            x, _, freedom = self.fit(linear)
            residual = linear.residual(x) / linear.noise_of(self.noise)
            paid = np.sum(self.effective @ linear.used, axis=1) - freedom
            for b, weights in enumerate(self.weights):
                fitted = max(float(paid[b]), 0.0)
                found = repeats(residual[b], linear.used, poses, weights, fitted=fitted)
                rho[b] = found.rho if found.freedom >= _TELLING_REPEATS else 1.0
        return replace(self, share=1.0 / (1.0 + (np.maximum(counts, 1) - 1.0) * rho[:, None]))

    def is_like(self, other: Stage) -> Mask:
        """Which fits differ by too little to matter, shape (B,)."""
        own, others = (np.hstack([one.noise, one.sizes]) for one in (self, other))
        return self.weighs_like(other) & np.isclose(own, others, rtol=SETTLED_SIZES).all(axis=1)

    def weighs_like(self, other: Stage) -> Mask:
        """Which fits have about the same weights, shape (B,)."""
        return np.asarray(np.abs(self.effective - other.effective).max(axis=1) < SETTLED)


#: What a stage has one of for each fit.
_EACH = ("kept", "weights", "share", "noise", "sizes")
