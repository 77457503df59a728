"""What ``calib compensate`` begins with: the robot as its controller has it, the true one, the tool, the frame."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from calib.cli.compensate_words import BASE, MEASURED, TARGET
from calib.errors import CalibError, choices

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from calib.identify.result import Calibration
    from calib.model.robot import Robot
    from calib.model.torques import Payload

#: Origins of one robot differ by rounding [m; rotation matrices: 1].
_SAME = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What is known of the true robot.

    Attributes:
        nominal: The robot as its controller has it.
        true: A result, or a corrected robot.
        name: What the text calls it.
        was_corrected: Whether ROBOT has the result's joint origins already.
    """

    nominal: Robot
    true: Calibration | Robot
    name: str
    was_corrected: bool = False

    @property
    def frame_estimated(self) -> bool:
        """Whether the frame of the result's points was estimated with the robot."""
        return self.result is not None and self.result.frame_estimated

    @property
    def result(self) -> Calibration | None:
        """The result, where there is one."""
        from calib.model.robot import Robot

        return None if isinstance(self.true, Robot) else self.true


def of_result(
    robot: str, path: Path, base: str | None, tip: str | None, hold: list[str] | None
) -> Truth:
    """The robot of a result.

    Raises:
        CalibError: The result cannot be read, is of another chain, or began with another robot.
    """
    from calib.cli.known import check_chain
    from calib.cli.words import parse_held
    from calib.identify.result_file import read_result
    from calib.measure.cell import Cell
    from calib.model.robot import Robot

    result = read_result(path)
    check_chain(Cell(base=base, tip=tip), result, str(path))
    held = {**result.nominal.held, **parse_held(hold or [])}
    nominal = Robot.load(robot, result.nominal.base, result.nominal.tip, held=held)
    was_corrected = _differ(nominal, result.corrected(nominal)) is None
    if not was_corrected:
        _check_nominal(nominal, result, path)
    return Truth(nominal, result, path.name, was_corrected)


def _check_nominal(robot: Robot, result: Calibration, path: Path) -> None:
    """Refuse a robot that is not the one that the result began with: what its controller has is not known then.

    Raises:
        CalibError: It has other joint origins.
    """
    joint = _differ(robot, result.uncorrected(robot))
    if joint is None:
        return
    message = (
        f"{robot.urdf.source}: the origin of '{joint}' is neither the one that {path.name} began with nor its "
        "corrected one. Give the URDF that the result was made with. If the controller has a model of its own, such as "
        "a factory calibration, give that as ROBOT and the corrected URDF with --corrected."
    )
    raise CalibError(message)


def _differ(a: Robot, b: Robot) -> str | None:
    """A joint whose origin is not the same in both; None where there is none."""
    import numpy as np

    others = b.origins()
    for name, T in a.origins().items():
        if np.abs(T - others[name]).max() > _SAME:
            return name
    return None


def of_robots(
    robot: str,
    corrected: str,
    names: set[str],
    base: str | None,
    tip: str | None,
    hold: list[str] | None,
) -> Truth:
    """The robots of two URDFs.

    Args:
        robot: As the controller has it.
        corrected: As it is.
        names: Columns of the program: a tip that is not named is the end of the longest chain with these joints.
        base: Link.
        tip: Link.
        hold: Values of joints.

    Raises:
        CalibError: A URDF cannot be read, or both are the same.
    """
    from calib.cli.words import parse_held
    from calib.model.robot import Robot

    held = parse_held(hold or [])
    nominal = Robot.load(robot, base, tip, measured=names, held=held)
    true = Robot.load(corrected, nominal.base, nominal.tip, held=held)
    if true.joint_names == nominal.joint_names and _differ(nominal, true) is None:
        message = (
            f"{robot} and {corrected} have the same joint origins from '{nominal.base}' to '{nominal.tip}': there is "
            "nothing to correct. ROBOT is the robot as its controller has it, --corrected as it truly is."
        )
        raise CalibError(message)
    return Truth(nominal, true, Path(corrected).name)


def column_names(program: Path, renamed: dict[str, str]) -> set[str]:
    """The names of a program's columns, those that they are mapped to among them."""
    from calib.measure.table import Table
    from calib.units import split_header

    names = {split_header(label)[0] for label in Table.read(program).header}
    return names | {split_header(wanted)[0] for wanted in renamed.values()}


def tool_of(text: str | None, truth: Truth) -> NDArray[np.float64] | str | None:
    """What is to arrive: a pose in the tip, the name of a target, or the tip.

    Raises:
        CalibError: The words mean nothing, or a corrected URDF carries no target.
    """
    from calib.cli.compensate_words import parse_tool
    from calib.cli.known import with_target_link
    from calib.measure.cell import Cell
    from calib.model.robot import Robot

    tool = None if text is None else parse_tool(text)
    if not isinstance(tool, str) or not isinstance(truth.true, Robot):
        return tool
    target = with_target_link(truth.true, Cell()).target
    if tool or target is None:
        message = (
            f"--tool was given as '{text}', and {truth.name} has no link calib_target, which 'calib fit --target-link' "
            'adds. Give the tool\'s place, such as "0 0 150 mm", or --calibration.'
        )
        if tool:
            message = (
                f"--tool was given as '{text}'; a URDF knows one target, without a name. Write --tool {TARGET}, or "
                "give --calibration."
            )
        raise CalibError(message)
    return target


def frame_of(text: str, truth: Truth) -> str | None:
    """The set-up whose frame poses are given in; None for the base.

    Raises:
        CalibError: There is no result that knows set-ups, or none of that name.
    """
    if text == BASE:
        return None
    if truth.result is None:
        message = (
            f"--poses-in was given as '{text}', and two URDFs know no measurement frames. Leave it out, or give the "
            "result with --calibration."
        )
        raise CalibError(message)
    if text != MEASURED and text not in truth.result.setup.groups:
        names = [name for name in truth.result.setup.groups if name]
        message = (
            f"--poses-in was given as '{text}'; choose '{BASE}', '{MEASURED}' (the frame of the result's points)"
            + (
                f", or one of its set-ups {choices(names)}."
                if names
                else ". The result has no named set-ups."
            )
        )
        raise CalibError(message)
    return "" if text == MEASURED else text


def payload_of(text: str, truth: Truth, *, geometry: bool) -> Payload:
    """What the tip carries; its centre of mass is that of the payload in the result.

    Raises:
        CalibError: No mass, or the result has no compliances that it could matter for.
    """
    from calib.cli.words import parse_payload

    larger = None if truth.result is None else truth.result.larger
    if larger is None or geometry or "compliance" not in larger.name:
        message = (
            f'--payload was given as "{text}", and the model in use knows no compliances: a payload changes nothing. '
            "Leave it out"
            + (
                ", or --geometry."
                if geometry and larger is not None
                else "; 'calib fit --model dh+compliance' estimates them."
            )
        )
        raise CalibError(message)
    return parse_payload(text, larger.payload)
