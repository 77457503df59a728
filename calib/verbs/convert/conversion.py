"""`calib.convert`, which writes a robot in another format, unless the verdict on it is ``do not use``.

The verdict stands in a result, or in a comment of a URDF that was written in spite of it (`Urdf.verdict`). A URDF that
is written states it again; the other formats have no place for it.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from calib.basics.arguments import check_type
from calib.data.inputs import ROBOT, RobotInput
from calib.errors import CalibError, VerdictError, choices
from calib.result.calibration import Calibration
from calib.robot.robot import Robot
from calib.show.verdict import against, refusal
from calib.verbs.convert.camera.options import NOTHING_NAMED
from calib.verbs.convert.convert import FORMATS, Conversion, Options, Source, read_source

__all__ = ["convert"]


def convert(
    source: Calibration | RobotInput,
    path: str | Path,
    *,
    to: str | None = None,
    robot: RobotInput | None = None,
    options: Options | None = None,
    overwrite: bool = False,
    accept: bool = False,
) -> Conversion:
    """Write a calibration or a robot in the format of a controller, of ROS or of another program.

    What is written is read back and compared with the robot before it appears.

    Args:
        source: A calibration; a robot; or the path of a result, a controller's file, an origins file, a URDF or a
            xacro; or the name of a robot.
        path: The file to write.
        to: Name of the format, such as ``"dh"``, one of `FORMATS`; None: by the file's ending.
        robot: The nominal robot, or its URDF, xacro or name; None: that of the calibration.
        options: What else goes with the conversion, such as ``hash_from``; None: nothing. Arguments beside it win.
        overwrite: Whether a file that exists is replaced.
        accept: Whether to write even where the verdict is ``do not use``, which a URDF then states in a comment, or
            where joint zeros alone are no better than the nominal robot.

    Returns:
        What was read and written, and what there is to say about it.

    Raises:
        ArgumentError: An argument of another type.
        VerdictError: The verdict on the source is ``do not use``, or joint zeros alone are no better than the nominal
            robot, and ``accept`` is not given.
        FileError: A file cannot be read or written.
        UrdfError: A URDF cannot be read, or, read back, is not the robot.
        ModelError: The robot has no form in this format, or things do not fit each other.
        CalibError: Something that the format needs was not given.
    """
    check_type(
        "source",
        source,
        (Calibration, Robot, str, Path),
        f"a Calibration; {ROBOT}; or another file",
    )
    check_type("path", path, (str, Path), "the path of the file to write")
    check_type("to", to, (str, type(None)), f"one of {choices(FORMATS)}, or None")
    check_type(
        "options", options, (Options, type(None)), "Options, or None; the format's name is 'to'"
    )
    chosen = _with_arguments(options or Options(), to, robot, overwrite=overwrite, accept=accept)
    path = Path(path)
    content, format_name = read_source(source, path, chosen)
    _check_update(chosen, format_name)
    _check_camera(chosen, format_name)
    verdict_against = _verdict_against(content)
    if verdict_against and not chosen.accept:
        named = f"'{source}'" if isinstance(source, (str, Path)) else "the calibration"
        raise VerdictError(refusal(named, verdict_against))
    urdf = content.robot.urdf.with_verdict(verdict_against)
    if urdf != content.robot.urdf:
        content = replace(content, robot=replace(content.robot, urdf=urdf))
    notes = FORMATS[format_name].write(content, path, chosen)
    return Conversion(content, format_name, path, notes, verdict_against, chosen)


def _check_update(options: Options, format_name: str) -> None:
    """Refuse a file to update where the format is written anew."""
    if options.update is None or FORMATS[format_name].updates:
        return
    able = [name for name, row in FORMATS.items() if row.updates]
    raise CalibError(
        f"--update {options.update}: a file of the format '{format_name}' is written anew; --update is for "
        f"{choices(able)}."
    )


def _check_camera(options: Options, format_name: str) -> None:
    """Refuse names of a camera's frames where the format has none."""
    if options.camera == NOTHING_NAMED or FORMATS[format_name].of_camera:
        return
    able = [name for name, row in FORMATS.items() if row.of_camera]
    raise CalibError(
        f"A camera or board was named, of which the format '{format_name}' has nothing; give --to with {choices(able)}."
    )


def _with_arguments(
    options: Options, to: str | None, robot: RobotInput | None, *, overwrite: bool, accept: bool
) -> Options:
    """Return options with the arguments of `convert` that are among them, where these are given."""
    return replace(
        options,
        to=options.to if to is None else to,
        robot=options.robot if robot is None else robot,
        overwrite=overwrite or options.overwrite,
        accept=accept or options.accept,
    )


def _verdict_against(source: Source) -> str:
    """Return the verdict ``do not use`` on what was read, and its reason; empty for any other.

    A URDF states the verdict on itself. Where another file is applied to a URDF, what that URDF states is the verdict
    on an earlier calibration, and does not count.
    """
    if source.kind == "robot":
        return source.robot.urdf.verdict
    return against(source.verdict)
