"""Commands of a program's rows: what to send, what remains, and what to know about each row."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from calib.basics.arrays import Array, Mask
from calib.basics.values import Value, one_line
from calib.robot.robot import Robot
from calib.verbs.compensate.expected import ExpectedErrors
from calib.verbs.compensate.inverse import POSE, Matching
from calib.verbs.compensate.nominal_actual import Pair
from calib.verbs.compensate.robot_program import Program

Code = Literal[
    "unreachable",
    "beyond limit",
    "other branch",
    "near singularity",
    "large pose correction",
    "large joint correction",
    "jump",
    "ambiguous pose",
    "outside measured range",
]
"""The first three are reasons why a row has no command, the others warnings; docs/compensation.md says what to do."""


class CommandWarning(NamedTuple):
    """Reason why a row has no command, or warning about its command."""

    code: Code
    #: Of "unreachable", "large pose correction", "ambiguous pose": position [m] and angle [rad], NaN if it is not
    #: matched, and none if the nominal robot cannot reach a target of a robot program; "beyond limit": value and limit;
    #: "near singularity": joint motion for 1 mm of the tool; else the motion of the joint, or its distance from the
    #: measured range [rad or m].
    numbers: tuple[float, ...] = ()
    #: The joint that it is about; empty if it is about none.
    joint: str = ""
    #: Label of the other row that it is about; empty if it is about none.
    row: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Commands(Value):
    """Commands that bring the true robot to the poses of a program; rows that cannot be reached are NaN."""

    #: The robot as its controller has it and the actual one, their tools, the frame of the poses.
    pair: Pair
    #: The program.
    program: Program
    #: Part of the poses that is reached, one of `calib.verbs.compensate.inverse.MATCHES`.
    match: str
    #: shape (N, 4, 4), wanted pose of the tool, in the frame of the poses [m]; if only its position was given, oriented
    #: as the nominal robot's is.
    T_wanted: Array
    #: Shape (N, m), joint values that the nominal model has for it [rad] or [m].
    q_nominal: Array
    #: Shape (N, m), joint values to command [rad] or [m].
    q: Array
    #: Shape (N, 4, 4), pose to send to a controller with the nominal model [m].
    T_send: Array
    #: shape (N, 2), how far the true robot would miss at ``q_nominal``, as the calibrated model predicts: position
    #: [m], angle [rad]. The angle is NaN if only the position is matched.
    missed: Array
    #: Shape (N, 2), how far it misses at ``q`` [m], [rad]: what cannot be reached.
    left: Array
    #: shape (N, 2), how far it misses if ``T_send`` is sent to a controller that stays near ``q_nominal``.
    left_by_pose: Array
    #: Expected errors of the rows that have a command, in their order; None of two robots without a result.
    expected: ExpectedErrors | None
    #: Why a row has no command; None if it has one.
    reasons: tuple[CommandWarning | None, ...]
    #: Warnings about each row; none about one without a command.
    warnings: tuple[tuple[CommandWarning, ...], ...]

    def __repr__(self) -> str:
        """Return one line: the robot, how many rows have a command, the largest correction of a position."""
        reached = int(self.reached.sum())
        largest = ""
        if reached:
            largest = f"corrections up to {1e3 * np.nanmax(self.pose_corrections[:, 0]):.3f} mm"
        counts = f"{reached} of {len(self)} rows with a command"
        return one_line("Commands", f"'{self.nominal.name}'", counts, largest)

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.q)

    @property
    def nominal(self) -> Robot:
        """The robot as its controller has it."""
        return self.pair.nominal.robot

    @property
    def reached(self) -> Mask:
        """Rows that have a command, shape (N,)."""
        return np.array([reason is None for reason in self.reasons])

    @property
    def expected_errors(self) -> Array:
        """Expected error of each row, mean distance [m] and angle [rad], shape (N, 2); NaN if it is not known."""
        errors = np.full((len(self), 2), np.nan)
        if self.expected is not None:
            errors[self.reached] = self.expected.errors
        return errors

    @property
    def joint_corrections(self) -> Array:
        """Correction of the joint values, q - q_nominal, shape (N, m), [rad] or [m]."""
        return np.asarray(self.q - self.q_nominal)

    @property
    def pose_corrections(self) -> Array:
        """Distance of the pose to send from the wanted one, shape (N, 2): position [m], angle [rad]."""
        return Matching(POSE, 1.0).misses(self.T_send, self.T_wanted)
