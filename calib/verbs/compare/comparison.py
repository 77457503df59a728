"""compare: do two calibrations of one robot differ by more than noise, and by how much is its target displaced?

The difference and its test are those of `calib.verbs.compare.difference`.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from calib.basics.arguments import check_number, check_path, check_type
from calib.basics.values import Value, one_line, shown_by
from calib.data.inputs import ROBOT, RobotInput, chain_of, robot_of
from calib.diagnosis.reasons import NO
from calib.errors import ModelError, choices
from calib.result.calibration import Calibration
from calib.result.calibration_file import ResultInput, result_of, versions, write_table
from calib.robot.robot import Robot
from calib.show.lines import plural
from calib.show.words import chain_name
from calib.verbs.compare.difference import Differences, Displacement, differences_of
from calib.verbs.compare.drift import LEVEL, DriftTest

Outcome = Literal["drift", "no drift shown", "cannot tell"]
#: Why it cannot be said whether the robot drifted; empty if it can.
Why = Literal["", "same data", "bad verdict", "nothing known", "other errors"]

#: Whether a tolerance is kept, from the best to the worst.
Kept = Literal["pass", "undecided", "fail"]

#: Standard deviations that stand for the uncertainty of a displacement: 95 %.
_FACTOR = 2.0

#: The layout of `Comparison.table`; a word, so that it is not taken for a result.
SCHEMA = "comparison 5"

#: Joint origins and held values that differ by less are the same [m], [rad].
_SAME = 1e-9

#: A displacement this many times as large as the residuals is not explained by what a model lacks.
_FAR = 3.0


@dataclass(frozen=True, slots=True, eq=False, repr=False, kw_only=True)
class Comparison(Value):
    """The result of `compare`."""

    #: The first result
    a: Calibration
    #: The second
    b: Calibration
    #: Their files, or ``"a"`` and ``"b"``
    names: tuple[str, str]
    #: ``"drift"``, ``"no drift shown"`` or ``"cannot tell"``
    outcome: Outcome
    #: Why it cannot be said; empty otherwise
    why: Why
    #: The robot whose meshes are shown
    robot: Robot
    #: The test of the difference
    test: DriftTest
    #: Displacement of the target: over the joint values that both data cover, then over the limits
    moves: tuple[Displacement, Displacement]
    #: Parameters that frame and target compensate, so that no drift of them shows
    compensated: tuple[str, ...]
    #: Parameters of a whose effects those of b cannot have
    only_a: tuple[str, ...]
    #: The same of b
    only_b: tuple[str, ...]

    @property
    def results(self) -> tuple[tuple[str, str, Calibration], ...]:
        """Letter, name and value of each result."""
        return ("a", self.names[0], self.a), ("b", self.names[1], self.b)

    def within(self, tolerance: float) -> Kept:
        """Return whether the target moved by no more than a tolerance, over the joint values that both measured.

        Args:
            tolerance: The largest rms displacement that is allowed [m].

        Returns:
            ``"pass"`` or ``"fail"`` if the displacement, twice its standard deviation added or subtracted, is within or
            beyond it; else, and if the comparison cannot tell, ``"undecided"``.
        """
        check_number("tolerance", tolerance, 0.0)
        move = self.moves[0]
        if self.outcome == "cannot tell":
            return "undecided"
        if move.moved + _FACTOR * move.std <= tolerance:
            return "pass"
        return "fail" if move.moved - _FACTOR * move.std > tolerance else "undecided"

    def _repr_html_(self) -> str:
        """A small table for notebooks: the answer, and both results."""
        return str(shown_by("verbs.compare.text").comparison_html(self))

    def summary(self) -> str:
        """Return the comparison as text, without colours, in 100 columns."""
        return str(shown_by("verbs.compare.text").comparison_text(self))

    def table(self) -> dict[str, Any]:
        """Return the comparison as nested tables of plain values in SI units; docs/comparison.md has the keys."""
        robot = self.a.nominal
        moves = [
            {
                "where": move.where,
                "moved_rms_m": move.moved,
                "rms_rad": move.rms_angle,
                "rms_m": move.rms,
                "max_m": move.max,
                "noise_rms_m": move.noise,
                "moved_std_m": move.std,
            }
            for move in self.moves
        ]
        results = [
            {
                "name": name,
                "set": result.model.name,
                "verdict": None if result.verdict is None else result.verdict.use,
                "sigma": result.noise.sigma,
                "urdf_sha256": result.nominal.urdf.sha256,
                "measurements_sha256": result.source.sha256,
            }
            for _, name, result in self.results
        ]
        return {
            "schema": SCHEMA,
            "robot": {"name": robot.name, "base": robot.base, "tip": robot.tip},
            "outcome": self.outcome,
            "why": self.why,
            "test": {**asdict(self.test), "level": LEVEL},
            "moves": moves,
            "compensated": list(self.compensated),
            "only_a": list(self.only_a),
            "only_b": list(self.only_b),
            "results": results,
            "versions": versions(),
        }

    def write_json(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the comparison as JSON.

        Args:
            path: The file.
            overwrite: Whether a file that exists is replaced.

        Returns:
            The path.

        Raises:
            FileError: The file exists, or cannot be written.
        """
        check_path("path", path)
        return write_table(self.table(), path, overwrite=overwrite)

    def __repr__(self) -> str:
        """One line with the names of both results, the outcome, and the p-value of the test that nothing drifted."""
        first, second = self.names
        return one_line(
            "Comparison", repr(first), repr(second), self.outcome, f"p = {self.test.p:.2g}"
        )


def compare(
    a: ResultInput,
    b: ResultInput,
    robot: RobotInput | None = None,
) -> Comparison:
    """Compare two calibrations of one robot: did it drift?

    Args:
        a: The first: a `Calibration`, or the path of a result file.
        b: The second, made of other measurements.
        robot: The robot, or its URDF, nominal or corrected, to show with its meshes; None: that of the first result.

    Returns:
        The outcome, ``"drift"``, ``"no drift shown"`` or ``"cannot tell"``; the test of the difference of the
        predictions; and the displacement of the target from a to b [m], without what frame and target compensate.

    Raises:
        ArgumentError: An argument of another type.
        FileError: A file cannot be read or is not a result.
        ModelError: The results are not of the same chains.
        UrdfError: The URDF cannot be read, or lacks a joint.
    """
    first, second = result_of(a, "a"), result_of(b, "b")
    name_a = "a" if isinstance(a, Calibration) else Path(a).name
    name_b = "b" if isinstance(b, Calibration) else Path(b).name
    if _chain_and_readings(first.nominal) != _chain_and_readings(second.nominal):
        raise ModelError(
            f"{name_a} and {name_b} are not of the same chains: {_chains_text(first.nominal)}, and "
            f"{_chains_text(second.nominal)}. Calibrate both with the same --base, --tip, --hold and, in the cell "
            "file, [coupling]."
        )
    shown = first.nominal
    if robot is not None:
        check_type("robot", robot, (Robot, str, Path), f"{ROBOT}, or None")
        if isinstance(robot, Robot):
            shown = robot.rebuilt(base=shown.base, tip=shown.tip)
        else:
            shown = robot_of(robot, chain_of(shown))

    origins_a, origins_b = first.nominal.origins(), second.nominal.origins()
    same_start = all(np.abs(T - origins_b[name]).max() < _SAME for name, T in origins_a.items())
    differences = differences_of(first, second, same_start=same_start)
    why = _obstacle(first, second, differences)
    outcome: Outcome = "no drift shown"
    if why:
        outcome = "cannot tell"
    elif differences.test.drifted:
        outcome = "drift"
    return Comparison(
        a=first,
        b=second,
        names=(name_a, name_b),
        outcome=outcome,
        why=why,
        robot=shown,
        test=differences.test,
        moves=differences.moves,
        compensated=differences.compensated,
        only_a=differences.only_a,
        only_b=differences.only_b,
    )


def _chain_and_readings(robot: Robot) -> tuple[Any, ...]:
    """Return by what two robots have the same chains: bases and tips, joints, held values and coupled readings."""
    joints = (robot.joint_names, set(robot.origins()), robot.held, robot.reading_coupling)
    return {(chain.base, chain.tip) for chain in robot.chains}, joints


def _chains_text(robot: Robot) -> str:
    """Name a robot, its chains, and what else two results must have in common."""
    text = f"{chain_name(robot)} with {plural(len(robot.joint_names), 'joint')}"
    return f"{text}, {choices(robot.held)} held" if robot.held else text


def _obstacle(first: Calibration, second: Calibration, differences: Differences) -> Why:
    """Return why it cannot be said whether the robot drifted, such as ``"same data"``; empty if it can."""
    if first is second:
        return "same data"
    if first.source.sha256 and first.source.sha256 == second.source.sha256:
        return "same data"
    results = (first, second)
    if any(result.verdict is not None and result.verdict.use == NO for result in results):
        return "bad verdict"
    if differences.test.combinations == 0:
        return "nothing known"
    # A displacement no larger than the residuals may be what either model lacks.
    has_other_errors = bool(differences.only_a or differences.only_b)
    residual = max(result.errors["calibrated"]["estimation"]["m"].rms for result in results)
    far = differences.moves[0].moved > _FAR * residual
    if has_other_errors and differences.test.drifted and not far:
        return "other errors"
    return ""
