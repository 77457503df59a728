"""Write joint zeros in one of their formats: refused where they are no better than none, and read back."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from calib.basics.files import write_atomically
from calib.errors import FileError, choices
from calib.result.joint_zeros import ESTIMATION
from calib.verbs.convert.notes import Note
from calib.verbs.convert.source import Options, Source
from calib.verbs.convert.zeros.offsets import (
    DYNAMIXEL_YAML,
    LEROBOT_JSON,
    TRANSMISSION_YAML,
    OffsetFile,
    offsets_bytes,
)
from calib.verbs.convert.zeros.rms_errors import RmsErrors, check_improvement
from calib.verbs.convert.zeros.rounding import RoundedZeros, calibration_of, stored_number
from calib.verbs.convert.zeros.table import TABLE_ENDINGS, table_bytes

#: The kind of file of each format with offsets; ``zeros``, a table, has none.
_OFFSET_FILES: Mapping[str, OffsetFile] = {
    "dynamixel-hardware": DYNAMIXEL_YAML,
    "ros2-transmission": TRANSMISSION_YAML,
    "lerobot": LEROBOT_JSON,
    "lerobot-dynamixel": LEROBOT_JSON,
}


def write_zeros(name: str, source: Source, path: Path, options: Options) -> tuple[Note, ...]:
    """Write the joint zeros of a result.

    Args:
        name: The format, one of `calib.verbs.convert.zeros.rounding.STORED`.
        source: The result.
        path: The file.
        options: ``update``, the robot's own file of offsets; ``ticks``; ``overwrite`` and ``accept``.

    Returns:
        What there is to say.

    Raises:
        FileError: Another ending, a file that exists or cannot be written, or an offset beyond its limit.
        CalibError: The source has no zeros.
        ModelError: A joint slides, and its zero cannot be stored.
        VerdictError: The zeros are no better than none, which is not accepted.
    """
    kind = _OFFSET_FILES.get(name)
    _check_ending(path, TABLE_ENDINGS if kind is None else kind.endings)
    rounded = RoundedZeros.of(source, stored_number(name, options.ticks))
    rms_errors = RmsErrors.of(calibration_of(source), rounded)
    check_improvement(rms_errors, path, accept=options.accept)
    if kind is None:
        data = table_bytes(source.robot, rounded, rms_errors, path.suffix.lower())
    else:
        data = offsets_bytes(kind, rounded, options.update)
    write_atomically(path, data, overwrite=options.overwrite)
    return (*_notes_on_zeros(rounded, rms_errors), *_notes_on_file(kind, options))


def _check_ending(path: Path, endings: tuple[str, ...]) -> None:
    """Refuse a file whose name ends otherwise."""
    if path.suffix.lower() not in endings:
        raise FileError(f"{path}: this format is written as {choices(endings)}; end the name so.")


def _notes_on_zeros(rounded: RoundedZeros, rms_errors: RmsErrors) -> Iterator[Note]:
    """Yield what there is to say of the zeros."""
    if rounded.undetermined:
        yield Note("zeros not determined", (choices(rounded.undetermined),))
    if rms_errors.is_no_better:
        yield Note("zeros no better", (rms_errors.rows,))
    elif rms_errors.rows == ESTIMATION:
        yield Note("zeros not validated")


def _notes_on_file(kind: OffsetFile | None, options: Options) -> Iterator[Note]:
    """Yield what there is to say of a file with offsets."""
    if kind is None:
        return
    if options.update is None:
        yield Note("changes alone")
    elif kind.comment:
        yield Note("comments not kept", (str(options.update),))
    if options.update is not None and kind.ratio_key:
        yield Note("times gear ratio", (kind.ratio_key,))
    if kind is LEROBOT_JSON:
        yield Note("end positions move")
