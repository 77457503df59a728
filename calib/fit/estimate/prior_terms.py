"""Priors and bounds of the parameters of a fit, as the cell states them.

Parameters of the robot have a normal prior about zero with the standard deviation of their family, unless the cell
gives one of their own. Frames, targets and the bases of further robots are flat: a weak prior only keeps them finite.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array, Mask, rigid_inverse
from calib.errors import ModelError
from calib.fit.estimate.task import Task
from calib.fit.registration.setup import Setup
from calib.model.error_model import FRAME, MOUNT, TARGET, ErrorModel

#: Standard deviation of the weak prior of frames and targets about where they are registered, and of all parameters
#: if priors are off, in the parameter's unit.
_WEAK = 1.0

#: Standard deviation with which a parameter is held at its bound, in its unit.
_FIXED = 1e-10


@dataclass(frozen=True, slots=True, eq=False)
class PriorTerms:
    """Priors and bounds of p parameters: K families with one prior standard deviation each, and single parameters."""

    #: (K,), names of the families
    names: tuple[str, ...]
    #: (K, p), which parameters belong to each
    families: Mask
    #: (K,), prior standard deviations as given or assumed before the fit, in SI units
    start: tuple[float, ...]
    #: (p,), 1 / variance of parameters with a prior of their own, and of frames and targets; else 0
    precision: Array
    #: (p,), means of the priors: 0, except for parameters at a bound, and given targets and frames
    mean: Array
    #: (p,), frames and targets without a prior of their own
    flat: Mask
    #: "data": prior standard deviations are estimated; "given": kept; "off": weak priors alone
    source: str
    #: (p, 2), lowest and highest value of each parameter; infinite without a bound
    limits: Array
    #: Indices of the parameters that are held at a bound, from 0
    fixed: tuple[int, ...] = ()

    @classmethod
    def of(cls, task: Task, model: ErrorModel, registered: Setup) -> PriorTerms:
        """Return the priors and bounds that a cell states; no parameter is held at a bound.

        Internals of instruments have the prior that is known of them, unless the cell gives another standard deviation.

        Args:
            task: The fit; its cell has the priors and bounds, its setup the frames and targets as given.
            model: The p parameters that are estimated.
            registered: Frames and targets at the start of the fit, from where their parameters count.

        Raises:
            ModelError: An unknown parameter has a bound or prior, or the change of a frame or target that was not
                given.
        """
        cell = task.cell
        constrained = [*{**cell.bounds, **cell.parameter_priors}]
        if task.allow_absent:
            constrained = [name for name in constrained if name in model.names]
        numbers = [model.index(name) for name in constrained]
        origin = _origins(task.setup, registered, model, numbers)
        unknowns = {unknown.parameter.name: unknown for unknown in registered.internals}
        std_of_internals = {name: unknown.sigma for name, unknown in unknowns.items()}
        for k, _ in model.internals:
            origin[k] = unknowns[model.names[k]].mean
        known_std = {**std_of_internals, **cell.parameter_priors}
        std = np.array([known_std.get(name, np.nan) for name in model.names])
        has_own = np.isfinite(std)
        of_setup = model.family(FRAME, TARGET, MOUNT)
        weak_precision = np.where(of_setup, 1.0 / _WEAK**2, 0.0)
        bounds = np.array([cell.bounds.get(name, (-np.inf, np.inf)) for name in model.names])

        members = {}
        for family in model.families:
            mask = model.family(family) & ~has_own
            if np.any(mask):
                members[family] = mask
        off = cell.priors.source == "off"
        start = tuple(_WEAK if off else cell.priors.of(family) for family in members)
        return cls(
            names=tuple(members),
            families=np.array([*members.values()], dtype=bool).reshape(-1, len(model)),
            start=start,
            precision=np.where(has_own, 1.0 / std**2, weak_precision),
            mean=np.where(has_own, origin, 0.0),
            flat=of_setup & ~has_own,
            source=cell.priors.source,
            limits=origin[:, None] + bounds,
        )

    def at_bounds(self, fixed: Mapping[int, float]) -> PriorTerms:
        """Return the priors with some parameters held; families without other parameters are dropped.

        A parameter is held by a prior about its value of standard deviation `_FIXED` in place of the one that it has.

        Args:
            fixed: Index of each parameter that is held, from 0, and its value, in its unit [m, rad, ...].
        """
        numbers = list(fixed)
        held = np.zeros(len(self.precision), dtype=bool)
        held[numbers] = True
        mean = self.mean.copy()
        mean[numbers] = list(fixed.values())
        families = self.families & ~held
        kept = np.flatnonzero(families.any(axis=1)).tolist()
        return replace(
            self,
            names=tuple(self.names[k] for k in kept),
            families=families[kept],
            start=tuple(self.start[k] for k in kept),
            precision=np.where(held, 1.0 / _FIXED**2, self.precision),
            mean=mean,
            flat=self.flat & ~held,
            fixed=tuple(sorted(fixed)),
        )


def _origins(given: Setup, registered: Setup, model: ErrorModel, numbers: list[int]) -> Array:
    """Offsets about which bounds and priors of some parameters are centred, (p,): 0, except for frames and targets.

    A parameter of a frame or target counts from the registered pose, its bound and prior from the given one: it is the
    given pose in the registered one (translation and XYZ Euler angles) along the parameter's direction. Raises
    `ModelError` for one of a frame or target that was not given.
    """
    frames = zip(given.frame_given, registered.T_frame_base, given.T_frame_base, strict=True)
    targets = zip(given.target_given, registered.T_tip_target, given.T_tip_target, strict=True)
    by_place = dict(zip(chain(*given.places), chain(frames, targets), strict=True))
    result = np.zeros(len(model))
    for k in numbers:
        parameter = model.parameters[k]
        if parameter.place not in by_place:
            continue
        is_given, T_registered, T_given = by_place[parameter.place]
        if not is_given:
            raise ModelError(
                f"'{parameter.name}' has a bound or a prior on its change, but the cell does not say from where."
            )
        T_registered_given = rigid_inverse(T_registered) @ T_given
        angles = Rotation.from_matrix(T_registered_given[:3, :3]).as_euler("XYZ")
        result[k] = parameter.direction @ np.concatenate([T_registered_given[:3, 3], angles])
    return result
