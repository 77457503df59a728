"""Priors and bounds of the parameters of a fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from scipy.spatial.transform import Rotation

from calib.data.cell import Cell
from calib.errors import ModelError
from calib.model.parameters import FRAME, TARGET, ErrorModel
from calib.registration.setup import Setup
from calib.robot.robot import rigid_inverse
from calib.units import Array, Mask

#: Standard deviation of the weak prior, where priors are off, and of target and frame about where registration put
#: them [m and rad].
_WEAK = 1.0


#: Standard deviation with which a parameter is held at its bound, in its unit.
_FIXED = 1e-10


@dataclass(frozen=True, slots=True, eq=False)
class PriorTerms:
    """What holds parameters besides the measurements: families with a size each, single priors, bounds."""

    names: tuple[str, ...]  # The families' names
    families: Mask  # (K, p), which parameters belong to each
    start: tuple[float, ...]  # The sizes to begin with
    precision: Array  # (p,), of parameters with a prior of their own, and of frames and targets
    centre: Array  # (p,), the priors' means: 0, but for parameters at a bound, and for given targets and frames
    flat: Mask  # (p,), frames and targets without a prior of their own
    source: str  # Where the prior standard deviations are from: "data", "given", or "off" for weak priors alone
    limits: Array  # (p, 2), lowest and highest value of each parameter
    fixed: tuple[int, ...] = ()  # Parameters that are at a bound

    @classmethod
    def of(
        cls, cell: Cell, model: ErrorModel, given: Setup, started: Setup, *, lenient: bool
    ) -> PriorTerms:
        """The cell's priors and bounds, from a registered start."""
        priors, single = cell.priors, cell.parameter_priors
        named = [k for k in {**cell.bounds, **single} if k in model.names or not lenient]
        nominal = _nominal(given, started, model, [model.index(name) for name in named])
        placed = model.family(FRAME, TARGET)
        std = np.array([single.get(name, np.nan) for name in model.names])
        alone = np.isfinite(std)
        names = tuple(f for f in model.families if np.any(model.family(f) & ~alone))
        bounds = np.array([cell.bounds.get(name, (-np.inf, np.inf)) for name in model.names])
        return cls(
            names=names,
            families=np.array([model.family(f) & ~alone for f in names], dtype=bool).reshape(
                -1, len(model)
            ),
            start=tuple(_WEAK if priors.source == "off" else priors.of(f) for f in names),
            precision=np.where(alone, 1.0 / std**2, np.where(placed, 1.0 / _WEAK**2, 0.0)),
            centre=np.where(alone, nominal, 0.0),
            flat=placed & ~alone,
            source=priors.source,
            limits=nominal[:, None] + bounds,
        )

    def at_bounds(self, fixed: Mapping[int, float]) -> PriorTerms:
        """With some parameters, by their numbers, held at these values."""
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


def _nominal(given: Setup, started: Setup, model: ErrorModel, named: list[int]) -> Array:
    """The origin of each parameter's change, (p,): 0, but for targets and frames the place given in the cell."""
    frames = zip(given.frame_given, started.T_frame_base, given.T_frame_base, strict=True)
    targets = zip(given.target_given, started.T_tip_target, given.T_tip_target, strict=True)
    places = dict(zip(chain(*given.places), chain(frames, targets), strict=True))
    result = np.zeros(len(model))
    for k in named:
        parameter = model.parameters[k]
        if parameter.place not in places:
            continue
        known, start, wanted = places[parameter.place]
        if not known:
            raise ModelError(
                f"'{parameter.name}' has a bound or a prior on its change, but the cell does not say from where."
            )
        moved = rigid_inverse(start) @ wanted
        angles = Rotation.from_matrix(moved[:3, :3]).as_euler("XYZ")
        result[k] = parameter.direction @ np.concatenate([moved[:3, 3], angles])
    return result
