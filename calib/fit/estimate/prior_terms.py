"""Priors and bounds of the parameters of a fit, as the cell states them.

Parameters of the robot have a normal prior about zero with the standard deviation of their family, unless the cell
gives one of their own. Frames and targets are flat: a weak prior only keeps them finite.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array, Mask, rigid_inverse
from calib.data.priors import Priors
from calib.errors import ModelError
from calib.fit.estimate.task import Task
from calib.fit.registration.setup import Setup
from calib.model.parameters import FRAME, TARGET, ErrorModel

#: Standard deviation of the weak prior of frames and targets about where they are registered, and of all parameters
#: where priors are off [m and rad].
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
    #: (p,), means of the priors: 0, but for parameters at a bound, and given targets and frames
    centre: Array
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
        """Return the priors and bounds that a cell states.

        Args:
            task: Robot, cell and options of a fit: its cell has priors by families of parameters, and priors and bounds
                of single ones by their names; its setup has the frames and targets as given.
            model: The p parameters that are estimated: of the robot, frames and targets.
            registered: Frames and targets at the start of the fit, from where their parameters count.

        Returns:
            Prior standard deviations of K families, and precision, mean, lowest and highest value of each of the p
            parameters, in their units. Frames and targets without a prior of their own have one of 1 m or rad about the
            registered start. None is held at a bound.

        Raises:
            ModelError: An unknown parameter has a bound or prior, or the change of a frame or target that was not
                given.
        """
        cell = task.cell
        origin = _origins(task.setup, registered, model, _constrained(task, model))
        of_optics = {unknown.parameter.name: unknown for unknown in registered.optics}
        optical_std = {name: unknown.sigma for name, unknown in of_optics.items()}
        known_std = {**optical_std, **cell.parameter_priors}
        std = np.array([known_std.get(name, np.nan) for name in model.names])
        has_own = np.isfinite(std)
        of_setup = model.family(FRAME, TARGET)
        weak_precision = np.where(of_setup, 1.0 / _WEAK**2, 0.0)
        for k, _ in model.optical:
            origin[k] = of_optics[model.names[k]].mean
        bounds = np.array([cell.bounds.get(name, (-np.inf, np.inf)) for name in model.names])
        members = _members(model, has_own)
        return cls(
            names=tuple(members),
            families=np.array([*members.values()], dtype=bool).reshape(-1, len(model)),
            start=_starts(cell.priors, members),
            precision=np.where(has_own, 1.0 / std**2, weak_precision),
            centre=np.where(has_own, origin, 0.0),
            flat=of_setup & ~has_own,
            source=cell.priors.source,
            limits=origin[:, None] + bounds,
        )

    def at_bounds(self, fixed: Mapping[int, float]) -> PriorTerms:
        """Return the priors with some parameters held; families without other parameters are dropped.

        A parameter is held by a prior about its value of standard deviation 1e-10 (`_FIXED`) in its unit, in place of
        the one that it has.

        Args:
            fixed: Index of each parameter that is held, from 0, and its value, in its unit [m, rad, ...].

        Returns:
            The priors and bounds of all p parameters, with the indices of these in ``fixed``; they are in no family any
            more.
        """
        numbers = list(fixed)
        held = np.zeros(len(self.precision), dtype=bool)
        held[numbers] = True
        centre = self.centre.copy()
        centre[numbers] = list(fixed.values())
        families = self.families & ~held
        kept = np.flatnonzero(families.any(axis=1)).tolist()
        return replace(
            self,
            names=tuple(self.names[k] for k in kept),
            families=families[kept],
            start=tuple(self.start[k] for k in kept),
            precision=np.where(held, 1.0 / _FIXED**2, self.precision),
            centre=centre,
            flat=self.flat & ~held,
            fixed=tuple(sorted(fixed)),
        )


def _constrained(task: Task, model: ErrorModel) -> list[int]:
    """Indices of the parameters for which a cell states a bound or a prior of their own, from 0.

    Args:
        task: Robot, cell and options of a fit; where ``allow_absent`` is True, its cell may name parameters that the
            model lacks, which are left out.
        model: The p parameters that are estimated.

    Returns:
        Indices in the parameter vector x, bounded ones first; one with both a bound and a prior occurs once.

    Raises:
        ModelError: A name that the model lacks, and must not.
    """
    named = [*{**task.cell.bounds, **task.cell.parameter_priors}]
    if task.allow_absent:
        named = [name for name in named if name in model.names]
    return [model.index(name) for name in named]


def _members(model: ErrorModel, has_own: Mask) -> dict[str, Mask]:
    """The parameters whose prior standard deviation is that of their family.

    Args:
        model: The p parameters that are estimated.
        has_own: shape (p,), those with a prior of their own, which belong to no family here.

    Returns:
        Mask of the members, shape (p,), by the family's name; families without members are left out.
    """
    members = {}
    for family in model.families:
        mask = model.family(family) & ~has_own
        if np.any(mask):
            members[family] = mask
    return members


def _starts(priors: Priors, families: Iterable[str]) -> tuple[float, ...]:
    """Prior standard deviations before the fit, in the order of the families, in SI units.

    Args:
        priors: Prior standard deviation of each family as given, or by default; where its source is "off", a weak prior
            of standard deviation 1 stands for each.
        families: Names of the K families.

    Returns:
        K values, in each family's unit, such as [m], [rad] or [rad/Nm].
    """
    if priors.source == "off":
        return tuple(_WEAK for _ in families)
    return tuple(priors.of(family) for family in families)


def _origins(given: Setup, registered: Setup, model: ErrorModel, numbers: list[int]) -> Array:
    """Values from which bounds and priors of parameters count: 0, but for frames and targets as given.

    A parameter of a frame or target counts from the registered pose, its bound and prior from the given one.

    Args:
        given: Frames and targets as the user gave them, or not (``frame_given`` and ``target_given``):
            ``T_frame_base``, shape (F, 4, 4), pose of the base in each frame, ``T_tip_target``, (T, 4, 4), pose of each
            target in the tip.
        registered: The same frames and targets, as registered at the start of the fit.
        model: The p parameters that are estimated, each with its place and direction there (a twist, shape (6,)).
        numbers: Indices, from 0, of those with a bound or prior of their own.

    Returns:
        shape (p,), [m] and [rad]: for these parameters the given pose in the registered one (translation and XYZ Euler
        angles) along the parameter's direction; 0 for those of the robot, and all others.

    Raises:
        ModelError: One of them belongs to a frame or target that was not given.
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
