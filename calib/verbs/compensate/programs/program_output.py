"""The files of a corrected program: beside each other, all of them or none."""

from __future__ import annotations

from pathlib import Path

from calib.basics.files import check_writable, write_atomically
from calib.errors import MeasurementError
from calib.verbs.compensate.programs.correction import CorrectedProgram
from calib.verbs.compensate.programs.program_file import ProgramFile


def output_paths(program: ProgramFile, path: str | Path) -> tuple[Path, ...]:
    """Return where the texts of a program are written.

    Args:
        program: The program.
        path: Where the program itself is written. A file of the same name but its ending gets the name of this one, any
            other keeps its own, both in the folder of this one.

    Returns:
        A path for each text, in their order.

    Raises:
        MeasurementError: The ending is that of another language.
    """
    path = Path(path)
    first = program.texts[0].path
    if path.suffix.lower() != first.suffix.lower():
        raise MeasurementError(
            f"'{path}' cannot be written: the program is in the language of '{first.suffix}', and stays so. Give the "
            "output this ending."
        )
    paths = [path]
    for text in program.texts[1:]:
        is_companion = text.path.stem.lower() == first.stem.lower()
        name = path.stem + text.path.suffix if is_companion else text.path.name
        paths.append(path.parent / name)
    return tuple(paths)


def write_program(
    corrected: CorrectedProgram, path: str | Path, *, overwrite: bool = False
) -> tuple[Path, ...]:
    """Write a corrected program, the files that belong to it, and others whose targets changed.

    Args:
        corrected: The program.
        path: Where the program itself is written, see `output_paths`.
        overwrite: Whether existing files are replaced.

    Returns:
        The files that were written.

    Raises:
        FileError: A file exists and ``overwrite`` is False, or one cannot be written. Nothing is written then.
        MeasurementError: The ending is that of another language.
    """
    program = corrected.program
    outputs = []
    for new, old, place in zip(
        corrected.texts, program.texts, output_paths(program, path), strict=True
    ):
        belongs = old.path.stem.lower() == program.texts[0].path.stem.lower()
        if belongs or new.text != old.text:
            outputs.append((place, new.text.encode("latin-1")))
    for place, _ in outputs:
        check_writable(place, overwrite=overwrite)
    return tuple(write_atomically(place, data, overwrite=overwrite) for place, data in outputs)
