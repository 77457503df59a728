"""Results as users give them: a `Calibration`, or the path of its file."""

from __future__ import annotations

from pathlib import Path
from typing import TypeAlias, TypeGuard

from calib.basics.arguments import check_type
from calib.result.calibration import Calibration
from calib.result.calibration_file import read_result

#: A calibration result, or the path of its file.
ResultInput: TypeAlias = Calibration | str | Path


#: What messages call it.
RESULT = "a Calibration, or the path of a result file (.json)"


def result_of(given: ResultInput, argument: str = "calibration") -> Calibration:
    """Return a calibration result: as given, or read from its file.

    Args:
        given: As a user gave it.
        argument: Its name, for messages.

    Raises:
        ArgumentError: It is neither.
        FileError: The file cannot be read or is no result.
    """
    check_type(argument, given, (Calibration, str, Path), RESULT)
    return given if isinstance(given, Calibration) else read_result(given)


def is_result_file(given: object) -> TypeGuard[str | Path]:
    """Test whether a path means a result, by its ending ``.json``; other paths and names mean robots."""
    return isinstance(given, (str, Path)) and Path(given).suffix.lower() == ".json"
