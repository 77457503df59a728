"""`calib.convert`, which writes a robot in another format, unless the verdict on it is ``do not use``.

The verdict stands in a result, or in a comment of a URDF that was written in spite of it (`Urdf.verdict`). A URDF that
is written states it again; the other formats have no place for it.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from calib.errors import VerdictError
from calib.formats.convert import FORMATS, Conversion, Options, Source, read_source
from calib.text.verdict import against, refusal

__all__ = ["convert"]


def convert(
    source: str,
    path: str | Path,
    options: Options | None = None,
    *,
    accept: bool = False,
) -> Conversion:
    """Read a file or the name of a robot, and write it in another format.

    What is written is read back and compared with the robot before it appears.

    Args:
        source: A result, a controller's file, an origins file, a URDF or xacro, or the name of a robot.
        path: The file to write.
        options: What goes with the conversion, such as ``to``, the format; None: the file's ending
            says the format, and nothing goes with it.
        accept: Whether to write even where the verdict is ``do not use``; a URDF then states it in a comment.

    Returns:
        What was read and written, and what there is to say about it.

    Raises:
        VerdictError: The verdict on the source is ``do not use``, and ``accept`` is not given.
        FileError: A file cannot be read or written.
        UrdfError: A URDF cannot be read, or, read back, is not the robot.
        ModelError: The robot has no form in this format, or things do not fit each other.
        CalibError: Something that the format needs was not given.
    """
    options = options or Options()
    path = Path(path)
    content, format_name = read_source(source, path, options)
    verdict_against = _verdict_against(content)
    if verdict_against and not accept:
        raise VerdictError(refusal(f"'{source}'", verdict_against))
    urdf = content.robot.urdf.with_verdict(verdict_against)
    if urdf != content.robot.urdf:
        content = replace(content, robot=replace(content.robot, urdf=urdf))
    notes = FORMATS[format_name].write(content, path, options)
    return Conversion(content, format_name, path, notes, verdict_against)


def _verdict_against(source: Source) -> str:
    """Return the verdict ``do not use`` on what was read, and its reason; empty for any other.

    A URDF states the verdict on itself. Where another file is applied to a URDF, what that URDF states is the verdict
    on an earlier calibration, and does not count.
    """
    if source.kind == "robot":
        return source.robot.urdf.verdict
    return against(source.verdict)
