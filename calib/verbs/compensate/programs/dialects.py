"""The languages of programs that calib corrects: a registry by the ending of the file's name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import MappingProxyType

from calib.errors import MeasurementError, choices
from calib.verbs.compensate.programs.program_file import ProgramFile, Stated

#: Reads a program and the files beside it. It raises `MeasurementError` for what is not a program of its language, and
#: one that names all tools and frames that have to be stated, with the option, if some are missing.
Reader = Callable[[Path, Stated], ProgramFile]


@dataclass(frozen=True, slots=True)
class Dialect:
    """A language of robot programs."""

    #: As messages name it.
    name: str
    #: Endings of its programs' names, in lower case.
    endings: tuple[str, ...]
    #: Module of this folder that has its function ``read``, a `Reader`.
    module: str

    @property
    def read(self) -> Reader:
        """Reader of its programs."""
        reader: Reader = import_module(f"calib.verbs.compensate.programs.{self.module}").read
        return reader


_ROWS = (
    Dialect("KUKA KRL", (".src",), "krl"),
    Dialect("ABB RAPID", (".mod", ".modx", ".sys", ".prg"), "rapid"),
    Dialect("FANUC LS", (".ls",), "fanuc_ls"),
    Dialect("Yaskawa JBI", (".jbi",), "jbi"),
    Dialect("URScript", (".script", ".urscript", ".urp"), "urscript"),
)

#: The languages by the endings of their programs' names.
DIALECTS: Mapping[str, Dialect] = MappingProxyType(
    {ending: row for row in _ROWS for ending in row.endings}
)


def find_dialect(path: str | Path) -> Dialect | None:
    """Return the language of a program by the ending of its file's name; None: it is not a program but a table."""
    return DIALECTS.get(Path(path).suffix.lower())


def read_program_file(path: str | Path, stated: Stated) -> ProgramFile:
    """Read a program in the language that the ending of its name says, and the files beside it.

    Args:
        path: The program.
        stated: What its files do not say.

    Returns:
        The program.

    Raises:
        FileError: It cannot be read.
        MeasurementError: It is not a program of this language, or tools and frames have to be stated.
    """
    dialect = find_dialect(path)
    if dialect is None:
        raise MeasurementError(f"{path}: calib reads programs by the endings {choices(DIALECTS)}.")
    return dialect.read(Path(path), stated)
