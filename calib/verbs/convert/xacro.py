"""A result as a corrected xacro: the files of the xacro in which the origins stand, with other numbers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from calib.basics.files import check_writable, write_atomically
from calib.errors import CalibError, FileError, ModelError
from calib.robot.ranges import random_joint_values
from calib.robot.readback import check_written
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from calib.robot.xacro_file import XacroCall, is_xacro
from calib.robot.xacro_origins import corrected_xacro
from calib.verbs.convert.format import Format, Note, Notes, Options, Source
from calib.verbs.convert.mjcf import of_source


def _write(source: Source, path: Path, options: Options) -> Notes:
    """Write the files of a xacro that the correction changes; with several, the further ones beside the first."""
    result = source.require_calibration()
    nominal, corrected = result.nominal, result.robot
    if nominal.parts:
        raise ModelError("A xacro is corrected for one robot, and this result has several.")
    call = _call(nominal.urdf, options)
    # Read back by Pinocchio too, as any URDF.
    q = random_joint_values(corrected)
    check_written(corrected, np.concatenate([chain.poses(q) for chain in corrected.chains]), q)
    files = corrected_xacro(call, nominal.urdf, corrected.urdf)
    if not files:
        files = {call.path.resolve(): call.path.read_bytes()}
    main = call.path.resolve()
    order = sorted(files, key=lambda file: file != main)
    outputs = {order[0]: path}
    for file in order[1:]:
        outputs[file] = path.with_name(f"{path.name.split('.')[0]}_{file.name}")
    for output in outputs.values():
        if output.resolve() in files:
            raise FileError(f"'{output}' is a file of the xacro itself; choose another name.")
        check_writable(output, overwrite=options.overwrite)
    for file, output in reversed(outputs.items()):
        write_atomically(output, files[file], overwrite=options.overwrite)
    notes = []
    for file, output in outputs.items():
        if file != main or len(outputs) > 1:
            sentence = "'{0}' is the corrected '{1}', which the xacro includes: put it in the place of that."
            if file == main:
                sentence = "'{0}' is the corrected '{1}'."
            notes.append(Note("included file", sentence, (str(output), str(file))))
    return tuple(notes)


def _call(urdf: Urdf, options: Options) -> XacroCall:
    """Return the xacro and the arguments that a URDF was flattened from: as the options name them, or as it states."""
    if isinstance(options.robot, Robot):
        raise CalibError("--to xacro takes as --robot the xacro with its arguments, as text.")
    if options.robot is not None:
        if not is_xacro(str(options.robot)):
            raise CalibError(
                f"'{options.robot}' is no xacro; --to xacro takes as --robot the xacro with its arguments that is to "
                "be corrected."
            )
        return XacroCall.parse(str(options.robot))
    if urdf.path is None or not is_xacro(urdf.source):
        raise CalibError(
            f"'{urdf.source}' was not flattened from a xacro; give the xacro with its arguments as --robot."
        )
    stated = XacroCall.parse(urdf.source)
    call = replace(stated, path=XacroCall.parse(str(urdf.path)).path)
    if not call.path.is_file():
        raise FileError(
            f"The xacro '{call.path}' that the result was made with is not there; give it with its arguments as "
            "--robot."
        )
    return call


FORMATS = {
    "xacro": Format(
        "the xacro with corrected origins",
        (".xacro",),
        _write,
        options_of_source=of_source,
    )
}
