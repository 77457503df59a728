"""convert: write a robot in another format, unless the verdict on it is ``do not use``.

What can be read is a row of `KINDS`, what can be written a row of `FORMATS`; a format is a module with its rows, named
here.

The verdict stands in a result, or in a comment of a URDF that was written in spite of it (`Urdf.verdict`). A URDF that
is written states it again; the other formats have no place for it.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import calib.basics.plugins as plugins
import calib.verbs.convert.camera_intrinsics as camera_intrinsics
import calib.verbs.convert.camera_mount as camera_mount
import calib.verbs.convert.dh as dh
import calib.verbs.convert.joint_formats as joint_formats
import calib.verbs.convert.mjcf as mjcf
import calib.verbs.convert.origins as origins
import calib.verbs.convert.static_transform as static_transform
import calib.verbs.convert.ur_formats as ur_formats
import calib.verbs.convert.urdf_formats as urdf_formats
import calib.verbs.convert.xacro as xacro
import calib.verbs.convert.zeros as zeros
from calib.basics.arguments import check_type
from calib.basics.files import read_bytes
from calib.basics.json_files import parse_json
from calib.data.inputs import ROBOT, RobotInput
from calib.errors import CalibError, FileError, ModelError, VerdictError, choices, did_you_mean
from calib.result.calibration import Calibration
from calib.robot.dh_file import TABLES
from calib.robot.robot import Robot
from calib.robot.xacro_file import is_xacro
from calib.show.verdict_text import do_not_use_text, refusal
from calib.verbs.convert.format import (
    YAML,
    CameraOptions as CameraOptions,
    Conversion as Conversion,
    Format as Format,
    Note as Note,
    Options as Options,
    Source as Source,
    SourceKind as SourceKind,
    parse_yaml,
)
from calib.verbs.convert.kinematics_tables import names_in

__all__ = [
    "FORMATS",
    "KINDS",
    "CameraOptions",
    "Conversion",
    "Format",
    "Note",
    "Options",
    "Source",
    "SourceKind",
    "chosen_format",
    "convert",
    "read_source",
    "register",
    "source_kind",
]

FORMATS: dict[str, Format] = {
    **urdf_formats.FORMATS,
    **mjcf.FORMATS,
    **xacro.FORMATS,
    **ur_formats.FORMATS,
    **joint_formats.FORMATS,
    **origins.FORMATS,
    **dh.FORMATS,
    **zeros.FORMATS,
    **camera_mount.FORMATS,
    **static_transform.FORMATS,
    **camera_intrinsics.FORMATS,
}
"""Formats that can be written, by name, as in ``--to``."""

KINDS: dict[str, SourceKind] = {
    **joint_formats.KINDS,
    **ur_formats.KINDS,
    **dh.KINDS,
    **origins.KINDS,
    **urdf_formats.KINDS,
}
"""Kinds of sources that can be read, by name; of kinds with the same ending those with a key come first."""

plugins.watch("formats", FORMATS)


def register(name: str, row: Format) -> None:
    """Add a format that robots can be written in.

    Args:
        name: Its name, as in ``--to``, which no other format has.
        row: Its description, the endings of its files, and the function that writes it.

    Raises:
        CalibError: The name is taken.
    """
    if name in FORMATS:
        raise CalibError(f"The format '{name}' needs a name other than {choices(FORMATS, 60)}.")
    FORMATS[name] = row


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
        options: Further options of the conversion, such as ``hash_from``; None: nothing. The arguments of this
            function take precedence over it.
        overwrite: Whether an existing file is replaced.
        accept: Whether to write even if the verdict is ``do not use``, which a URDF then states in a comment, or if
            joint zeros alone are no better than the nominal robot.

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
    given = options or Options()
    chosen = replace(
        given,
        to=given.to if to is None else to,
        robot=given.robot if robot is None else robot,
        overwrite=overwrite or given.overwrite,
        accept=accept or given.accept,
    )
    path = Path(path)
    content, name = read_source(source, path, chosen)
    row = FORMATS[name]
    if content.robot.branches and name in (
        *dh.FORMATS,
        *ur_formats.FORMATS,
        *joint_formats.FORMATS,
    ):
        tips = choices(chain.tip for chain in content.robot.chains)
        raise ModelError(
            f"The format '{name}' holds one chain, and {content.robot.name} has several, to {tips}. Write the URDF "
            "(--to urdf), and convert that with --base and --tip of one of them."
        )
    if chosen.update is not None and not row.updates:
        able = [other for other, one in FORMATS.items() if one.updates]
        raise CalibError(
            f"--update {chosen.update}: the format '{name}' does not copy an existing file; --update is for "
            f"{choices(able)}."
        )
    if chosen.camera != CameraOptions() and not row.of_camera:
        able = [other for other, one in FORMATS.items() if one.of_camera]
        raise CalibError(
            f"A camera or board was named, but the format '{name}' has neither; give --to with {choices(able)}."
        )

    # If another file is applied to a URDF, run and verdict that this URDF states are of an earlier calibration, and do
    # not count.
    verdict_against = do_not_use_text(content.verdict)
    if content.kind == "robot":
        verdict_against = content.robot.urdf.verdict
    if verdict_against and not chosen.accept:
        named = f"'{source}'" if isinstance(source, (str, Path)) else "the calibration"
        raise VerdictError(refusal(named, verdict_against))
    run = content.robot.urdf.run if content.kind in ("robot", "result") else ""
    urdf = content.robot.urdf.with_comments(run=run, verdict=verdict_against)
    if urdf != content.robot.urdf:
        content = replace(content, robot=replace(content.robot, urdf=urdf))
    notes = row.write(content, path, chosen)
    return Conversion(content, name, path, notes, verdict_against, chosen)


def read_source(
    source: Calibration | RobotInput, path: Path, options: Options
) -> tuple[Source, str]:
    """Read what is to be converted, unless it is there already, and choose the format that it is written in.

    Args:
        source: A result; a robot; a file that `KINDS` has a row for; or the name of a robot.
        path: The file to write, whose ending chooses the format if ``options.to`` is None.
        options: Options of the conversion.

    Returns:
        What was read, and the name of the format, one of `FORMATS`.

    Raises:
        FileError: The file cannot be read.
        UrdfError: A URDF cannot be read.
        ModelError: The robot does not fit the result or the file.
        CalibError: Something that is needed was not given, such as the format.
    """
    kind = "robot"
    if isinstance(source, Calibration):
        kind = "result"
    elif not isinstance(source, Robot):
        kind = source_kind(str(source))
    name = chosen_format(path, options.to, kind)
    of_source = FORMATS[name].options_of_source
    if of_source is not None:
        options = of_source(options)
    if isinstance(source, Calibration):
        return urdf_formats.result_source(source, options, "The calibration"), name
    if isinstance(source, Robot):
        return urdf_formats.robot_source(source, options), name
    return KINDS[kind].read(str(source), options), name


def source_kind(source: str) -> str:
    """Return the kind of a source, by its ending, and of a YAML or JSON file by its keys.

    Args:
        source: A file, or the name of a robot.

    Returns:
        The name of a row of `KINDS`.

    Raises:
        FileError: It is none of them, or a YAML file cannot be read.
    """
    ending = "" if is_xacro(source) else Path(source).suffix.lower()
    keys: tuple[str, ...] = ()
    if ending == ".json":
        try:
            table = parse_json(read_bytes(source, "JSON file"), source)
        except FileError:
            table = None  # its reader reports this
        keys = tuple(map(str, table)) if isinstance(table, dict) else ()
    elif ending in TABLES:
        keys = ("equation",)
    elif ending in YAML:
        content = parse_yaml(read_bytes(source, "YAML file"), source, "YAML file")
        keys = (*map(str, content), *names_in(content))
    for name, kind in KINDS.items():
        if ending in kind.endings and (not kind.key or kind.key in keys):
            return name
    raise FileError(
        f"{source}: neither its ending nor a key says what it is. Give a calibration.conf or a "
        "kinematics.yaml of Universal Robots, UFACTORY or Flexiv, a result (.json), an origins file (.yaml), DH rows "
        "(.csv, .json), a URDF, a xacro, or the name of a robot such as 'ur3'."
    )


def chosen_format(path: Path, given: str | None, kind: str) -> str:
    """Choose the format that a file is written in.

    Args:
        path: The file to write.
        given: Name of the format; None: by the ending of the file.
        kind: Kind of the source, one of `KINDS`: a ``ur-conf`` becomes a ``ur-yaml``.

    Returns:
        The name of the format, one of `FORMATS`.

    Raises:
        CalibError: There is no such format, or several have this ending.
    """
    if given is not None and given in FORMATS:
        return given
    ending = path.suffix.lower()
    fitting = [name for name, row in FORMATS.items() if ending in row.endings]
    if given is None:
        if kind == "ur-conf" and ending in YAML:
            return "ur-yaml"
        if len(fitting) == 1:
            return fitting[0]
    options = ", ".join(f"--to {name} ({FORMATS[name].what})" for name in fitting or FORMATS)
    fault = f"there is no format '{given}'{did_you_mean(given or '', FORMATS)}"
    if given is None:
        fault = f"'{ending}' does not say which format is wanted"
    raise CalibError(f"{path}: {fault}. Give one of: {options}. {plugins.HINT}")
