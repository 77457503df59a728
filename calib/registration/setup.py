"""Frames and targets of a table as a fit takes them, what of them is unknown, and the table's rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np

from calib.model.kinematics import Samples
from calib.model.parameters import FRAME, TARGET, ErrorModel, Parameter
from calib.robot.robot import read_only
from calib.units import Array, Mask


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """Frames and targets, by the number that rows refer to them with."""

    groups: tuple[str, ...]  # Names of the set-ups; one frame each
    targets: tuple[str, ...]  # Names of the targets
    T_frame_base: Array  # (F, 4, 4), pose of the base in each frame [m]
    T_tip_target: Array  # (T, 4, 4), pose of each target in the tip [m]
    unknown: tuple[tuple[str, ...], ...]  # For each frame the directions that are estimated
    frame_given: Mask  # (F,), whether a frame's pose was given; else it is to be found
    target_unknown: Mask  # (T,), whether a target is estimated
    target_given: Mask  # (T,), whether a target's place was given
    rotation: bool  # Whether targets are frames, because orientations were measured, or points
    own_axes: Mask  # (F,), whether a frame's directions are along its own axes, or the base's
    oriented: bool = False  # Whether the targets' orientations are known, measured or given

    @property
    def frame_unknowns(self) -> Mapping[str, tuple[str, ...]]:
        """The estimated directions of each frame by its set-up's name; "" stands for the only one."""
        names = self.groups if len(self.groups) > 1 else ("",)
        return dict(zip(names, self.unknown, strict=True))

    @property
    def target_names(self) -> tuple[str, ...]:
        """The targets' names for their parameters; "" for the only one."""
        return self.targets if len(self.targets) > 1 else ("",)

    @property
    def places(self) -> tuple[list[str], list[str]]:
        """What an error model calls the places of the frames and of the targets."""
        frames = [FRAME + name for name in self.frame_unknowns]
        return frames, [TARGET + name for name in self.target_names]

    @property
    def estimate_target(self) -> bool:
        """Whether any target is estimated."""
        return bool(np.any(self.target_unknown))

    @property
    def unknown_targets(self) -> tuple[str, ...]:
        """The names of the targets that are estimated, as `target_names` has them."""
        return tuple(compress(self.target_names, self.target_unknown))

    @property
    def count(self) -> int:
        """Number of unknowns."""
        of_targets = (6 if self.rotation else 3) * int(np.sum(self.target_unknown))
        return of_targets + sum(map(len, self.unknown))

    def placed(self, T_frame_base: Array, T_tip_target: Array) -> Setup:
        """The same with frames and targets elsewhere."""
        frames, targets = read_only(T_frame_base), read_only(T_tip_target)
        return replace(self, T_frame_base=frames, T_tip_target=targets)

    def displaced(self, displacement: Array) -> Setup:
        """The same with the displacements of all places of an error model, shape (F + ... + T, 4, 4)."""
        return self.placed(
            self.T_frame_base @ displacement[: len(self.groups)],
            self.T_tip_target @ displacement[-len(self.targets) :],
        )

    def seen(self, T_base_tip: Array, samples: Samples) -> Array:
        """T_frame_target of samples with these poses of the tip, shape (N, 4, 4), [m]."""
        T_frame_tip = self.T_frame_base[samples.frame] @ T_base_tip
        return np.asarray(T_frame_tip @ self.T_tip_target[samples.target])

    def seen_by(self, samples: Samples) -> tuple[Mask, Mask]:
        """Which frames and which targets some samples see, shapes (F,) and (T,)."""
        frames = np.bincount(samples.frame, minlength=len(self.groups)) > 0
        return frames, np.bincount(samples.target, minlength=len(self.targets)) > 0

    def unknown_at(self, samples: Samples) -> Mask:
        """Which samples see an unknown frame or target, shape (N,)."""
        frames = np.array([bool(directions) for directions in self.unknown])
        return np.asarray(frames[samples.frame] | self.target_unknown[samples.target])

    def not_given(self, seen: Samples | None = None) -> Setup:
        """The same with what was given taken for known, and so what some samples see."""
        rest = self.as_known(self.frame_given, self.target_given)
        return rest if seen is None else rest.as_known(*rest.seen_by(seen))

    def as_known(self, frames: Mask, targets: Mask) -> Setup:
        """The same, with some frames and targets taken for known."""
        pairs = zip(frames, self.unknown, strict=True)
        unknown = tuple(() if known else directions for known, directions in pairs)
        return replace(self, unknown=unknown, target_unknown=self.target_unknown & ~targets)

    def aligned(self, model: ErrorModel) -> ErrorModel:
        """The model with a plane's frame moving along the plane's axes, and a target's position along the tip's.

        With the rotation R of T_frame_base the twist of a unit along one of the plane's own axes e is R^T e.
        """
        frames, targets = self.places
        own = zip(compress(frames, self.own_axes), self.T_frame_base[self.own_axes], strict=True)
        turned = {place: T[:3, :3].T for place, T in own}
        positions = dict(zip(targets, self.T_tip_target[:, :3, :3].swapaxes(1, 2), strict=True))

        def turn(one: Parameter) -> Parameter:
            R = turned.get(one.place, positions.get(one.place) if one.unit == "m" else None)
            if R is None or one.unit not in ("m", "rad") or np.array_equal(R, np.eye(3)):
                return one
            return replace(one, direction=read_only((R @ one.direction.reshape(2, 3).T).T.ravel()))

        parameters, terms = (tuple(map(turn, some)) for some in (model.parameters, model.terms))
        if parameters == model.parameters and terms == model.terms:
            return model
        return replace(model, parameters=parameters, terms=terms)
