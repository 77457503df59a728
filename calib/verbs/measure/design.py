"""Design: which pose next, by what is measured so far.

The poses still to measure are a design: the fewest candidates with which the expected error comes within the aim. It is
kept from row to row, exchanged against better candidates as noise and errors become known, and the next pose is one of
it: near the last pose, among those that tell most by themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.basics.arrays import Array, Mask, read_only
from calib.basics.values import Value
from calib.verbs.measure.expectation import Expectation
from calib.verbs.plan.approach import visits
from calib.verbs.plan.forecast import Workspace, information
from calib.verbs.plan.optimal import (
    Basis,
    Indices,
    exchange,
    gains,
    ranking,
    short_list,
    without_least,
)
from calib.verbs.plan.reachable import Ground
from calib.verbs.plan.sensitivity import Sensitivity

#: Candidates among which the design is exchanged at each row: those on which an optimal design relies most.
_SHORT = 800

#: The most poses that a session looks ahead.
_AHEAD = 60

#: A pose of the design is next if it tells this share of what the most telling one does, and is near.
_TELLING = 0.6

#: A design that is not enough grows by this part of its poses at a time, and to twice as many if its expected error is
#: this many times the aim.
_GROWN = 3
_FAR = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Known(Value):
    """Information on the parameters by the rows so far, in standard deviations of the noise as the cell states it."""

    #: Shape (p, p), sum of A^T A over the stops, with the noise as estimated
    information: Array
    #: Shape (p,), 1 / variance of the prior of each parameter
    precision: Array
    #: Shape (d,), estimated noise of the scalars at a stop over the stated one
    noise: Array
    #: Degrees of freedom of the noise
    freedom: float

    @property
    def total(self) -> Array:
        """The information of rows and priors, shape (p, p)."""
        return np.asarray(self.information + np.diag(self.precision))


@dataclass(frozen=True, slots=True, eq=False)
class Choice(Value):
    """The poses that are still to be measured."""

    #: Indices of candidates, the next one first
    design: tuple[int, ...]
    #: Expected error with all of them measured
    expected: Expectation
    #: Expected error with the next one measured
    after_next: Expectation


@dataclass(frozen=True, slots=True, eq=False)
class Design(Value):
    """The candidates of a session, n, and what each of them tells of the p parameters."""

    #: The nominal robot in its cell, under the error model of the fit
    sensitivity: Sensitivity
    #: Where it can be measured
    ground: Ground
    #: Shape (n, m), joint values of the candidates [rad] or [m], once for each side that they are approached from
    joints: Array
    #: Shape (n, m), by which the joints arrive, if the robot drives by a stop before; None: straight
    moves: Array | None
    #: Shape (n, v), which views measure at each; None: all
    seen: Mask | None
    #: Shape (n, d, p), whitened derivative of the d scalars measured there
    measured: Array
    #: Over which accuracy counts
    workspace: Workspace

    @classmethod
    def of(cls, sensitivity: Sensitivity, ground: Ground) -> Design:
        """Differentiate what is measured at all candidates."""
        pool, sides = ground.pool, ground.sides
        joints, moves = visits(pool.q, sides)
        times = max(len(sides), 1)
        seen = None if pool.seen is None else np.repeat(pool.seen, times, axis=0)
        workspace = Workspace.of(sensitivity, pool.workspace, pool.measurable, pool.seen)
        design = cls(
            sensitivity=sensitivity,
            ground=ground,
            joints=read_only(joints),
            moves=read_only(moves) if len(sides) else None,
            seen=seen,
            measured=sensitivity.measured(joints, moves, seen),
            workspace=workspace,
        )
        # Candidates that no optimal design relies on are not looked at again at each row.
        known = np.diag(sensitivity.precision)
        basis = design._basis(known, np.ones(design.measured.shape[1]))
        kept = short_list(ranking(design.measured @ basis.directions, basis), _SHORT)
        return replace(
            design,
            joints=read_only(joints[kept]),
            moves=None if design.moves is None else design.moves[kept],
            seen=None if seen is None else seen[kept],
            measured=design.measured[kept],
        )

    def _basis(self, known: Array, noise: Array) -> Basis:
        """Return the directions that the candidates observe, and the criterion V along them."""
        A = self.measured / noise[:, None]
        return Basis.of(information(A) / len(A), known, self.workspace.mean_square)

    def expected(self, total: Array, freedom: float) -> Expectation:
        """Return the expected error with some information (p, p) of rows and priors."""
        return Expectation.of(
            np.asarray(np.linalg.inv(total), dtype=np.float64), self.workspace.mean_square, freedom
        )

    def choose(
        self,
        known: Known,
        aim: float,
        last: Array | None,
        before: Sequence[int] = (),
        left_out: Sequence[int] = (),
    ) -> Choice | None:
        """Choose the fewest further poses with which the expected error comes within the aim.

        Args:
            known: What the rows so far tell.
            aim: Error within which 95 % of calibrations shall be [m].
            last: Joint values of the last pose, shape (m,), [rad] or [m]; None: there is none.
            before: The design at the row before, which is changed as little as is needed.
            left_out: Candidates that are measured, or cannot be reached.

        Returns:
            The poses, the next one first, one at least; None if no candidate is left.
        """
        free = np.setdiff1d(np.arange(len(self.joints)), left_out)
        if not len(free):
            return None
        A = self.measured[free] / known.noise[:, None]
        basis = Basis.of(information(A) / len(A), known.total, self.workspace.mean_square)
        blocks = A @ basis.directions

        def expected(chosen: Indices) -> Expectation:
            """Return the expected error with some further poses."""
            total = known.total + information(A[chosen])
            return self.expected(total, known.freedom + len(chosen) * float(A.shape[1]))

        design = np.unique(np.searchsorted(free, [k for k in before if k in free])).astype(np.int_)
        most = min(_AHEAD, len(free))
        design, _ = exchange(blocks, basis, design, max(len(design), 1))
        while len(design) < most and expected(design).high > aim:
            more = 1.0 / _GROWN if expected(design).high <= _FAR * aim else 1.0
            count = min(len(design) + max(1, int(more * len(design))), most)
            design, _ = exchange(blocks, basis, design, count)
        is_enough = expected(design).high <= aim
        while is_enough and len(design) > 1:
            fewer = without_least(blocks, basis, design)
            if expected(fewer).high > aim:
                fewer, _ = exchange(blocks, basis, fewer)
            if expected(fewer).high > aim:
                break
            design = fewer
        if is_enough:
            design, _ = exchange(blocks, basis, design)
        first = self._first(gains(blocks[design], basis), self.joints[free[design]], last)
        order = [first, *[k for k in range(len(design)) if k != first]]
        return Choice(
            design=tuple(free[design[order]].tolist()),
            expected=expected(design),
            after_next=expected(design[[first]]),
        )

    @staticmethod
    def _first(gain: Array, joints: Array, last: Array | None) -> int:
        """Return which pose of a design is next: the nearest one of those that tell much by themselves.

        ``gain`` is what each tells by itself, shape (n,), ``joints`` are its joint values, (n, m); ``last`` are those
        of the last pose, None if there is none.
        """
        if last is None:
            return int(np.argmax(gain))
        away = np.abs(joints - last).max(axis=1)
        return int(np.argmin(np.where(gain >= _TELLING * gain.max(), away, np.inf)))
