"""compare: do two calibrations of one robot differ by more than noise, and by how much is its target displaced?

The difference and its test are those of `calib.verbs.compare.difference`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from calib.basics.arguments import check_path, check_type
from calib.basics.values import Value, one_line, shown_by
from calib.data.inputs import ROBOT, RobotInput, chain_of, robot_of
from calib.diagnosis.reasons import NO
from calib.errors import ModelError
from calib.result.calibration import Calibration
from calib.result.calibration_file import ResultInput, result_of, write_table
from calib.robot.robot import Robot
from calib.verbs.compare.difference import Differences, Displacement, differences_of
from calib.verbs.compare.drift import DriftTest

Outcome = Literal["drift", "no drift shown", "cannot tell"]
#: Reason why nothing can be told; empty otherwise.
Why = Literal["", "same data", "bad verdict", "nothing known", "other errors"]

#: Joint origins and held values that differ by less are the same [m], [rad].
_SAME = 1e-9

#: A displacement this many times as large as the residuals has another cause than what a model lacks.
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
    #: Reason why nothing can be told; empty otherwise
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

    def _repr_html_(self) -> str:
        """A small table for notebooks: the answer, and both results."""
        return str(shown_by("verbs.compare.text").comparison_html(self))

    def summary(self) -> str:
        """Return the comparison as text, without colours, in 100 columns."""
        return str(shown_by("verbs.compare.text").comparison_text(self))

    def table(self) -> dict[str, Any]:
        """Return the comparison as nested tables of plain values; docs/comparison.md has the keys."""
        table: dict[str, Any] = shown_by("verbs.compare.text").comparison_table(self)
        return table

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
        """One line with the ``names`` of both results, the ``outcome``, and the p-value of the ``test``."""
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
        FileError: A file cannot be read or is no result.
        ModelError: The results are of different chains.
        UrdfError: The URDF cannot be read, or lacks a joint.
    """
    first, name_a = _result_and_name(a, "a")
    second, name_b = _result_and_name(b, "b")
    _check_same_chain(first, second, (name_a, name_b))
    shown = _robot_to_show(robot, first.nominal)
    differences = differences_of(first, second, same_start=_same_origins(first, second))
    why = _why_not_told(first, second, differences)
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


def _result_and_name(given: ResultInput, letter: str) -> tuple[Calibration, str]:
    """Return a calibration result and its name.

    Args:
        given: The result, or the path of its file, which is read.
        letter: ``"a"`` or ``"b"``: the name of a result that was not given as a file.

    Returns:
        The result; and the name of its file without the folder, or the letter.

    Raises:
        FileError: The file cannot be read or is no result.
    """
    result = result_of(given, letter)
    return result, letter if isinstance(given, Calibration) else Path(given).name


def _check_same_chain(first: Calibration, second: Calibration, names: tuple[str, str]) -> None:
    """Refuse calibration results of different chains: of other links, joints, held values, or coupled readings.

    Args:
        first: The first result, of whose nominal robot are compared base and tip link, names of the measured joints,
            names of the joints with origins, values of held joints, [rad] or [m], and coupled readings.
        second: The second.
        names: Names of their files, for the error message.

    Raises:
        ModelError: Any of these differ.
    """
    chains = []
    for robot in (first.nominal, second.nominal):
        joints = (robot.joint_names, set(robot.origins()), robot.held, robot.reading_coupling)
        chains.append((robot.base, robot.tip, joints))
    if chains[0] != chains[1]:
        raise ModelError(
            f"{names[0]} and {names[1]} are not of one chain: {first.nominal!r}, {second.nominal!r}. Calibrate "
            "both with the same --base, --tip, --hold and, in the cell file, [coupling]."
        )


def _robot_to_show(given: RobotInput | None, nominal: Robot) -> Robot:
    """Return the robot to show, with base and tip of the results' nominal one.

    Args:
        given: The robot, or the path of its URDF, nominal or corrected, such as one with meshes; None: the nominal
            robot is shown.
        nominal: The nominal robot of the first result, with its base, tip and held joint values.

    Returns:
        The robot with the nominal one's base and tip; its joint origins are its own.

    Raises:
        UrdfError: The URDF cannot be read, or lacks a joint.
    """
    if given is None:
        return nominal
    check_type("robot", given, (Robot, str, Path), f"{ROBOT}, or None")
    if isinstance(given, Robot):
        return given.rebuilt(base=nominal.base, tip=nominal.tip)
    return robot_of(given, chain_of(nominal))


def _same_origins(first: Calibration, second: Calibration) -> bool:
    """Tell if two calibration results count from the same nominal joint origins.

    Args:
        first: The first result, with the ``<origin>`` of each joint of its nominal URDF, shape (4, 4), [m].
        second: The second, of the same chain.

    Returns:
        True if no element of these matrices differs by `_SAME` or more between both nominal robots.
    """
    of_second = second.nominal.origins()
    origins = first.nominal.origins().items()
    return all(np.abs(T - of_second[name]).max() < _SAME for name, T in origins)


def _why_not_told(first: Calibration, second: Calibration, differences: Differences) -> Why:
    """Return the reason why nothing can be told of a drift; empty if there is none.

    Args:
        first: Result a: hash of the file of its measurements, its verdict, and the residuals of its fitted rows.
        second: Result b.
        differences: The difference of their predictions. Of it are used ``test``, ``moves[0]``, the displacement of the
            target over the joint values that both data cover, and ``only_a`` and ``only_b``, parameters whose effects
            only that result can have.

    Returns:
        ``"same data"`` if both are of one file, or one result; ``"bad verdict"`` if either should not be used;
        ``"nothing known"`` if no combination of parameters could be tested; ``"other errors"`` if they differ
        significantly, but either has parameters that the other lacks, and the target's rms displacement without noise
        is no more than `_FAR` times the larger rms residual [m] of fitted rows.
    """
    if first is second:
        return "same data"
    if first.source.sha256 and first.source.sha256 == second.source.sha256:
        return "same data"
    results = (first, second)
    if any(result.verdict is not None and result.verdict.use == NO for result in results):
        return "bad verdict"
    if differences.test.combinations == 0:
        return "nothing known"
    has_other_errors = bool(differences.only_a or differences.only_b)
    residual = max(result.errors["calibrated"]["estimation"]["m"].rms for result in results)
    far = differences.moves[0].moved > _FAR * residual
    if has_other_errors and differences.test.drifted and not far:
        return "other errors"
    return ""
