"""Call: what a calibration was told, kept in its result so that it can be made again."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import calib.basics.plugins as plugins
from calib.basics.files import read_bytes
from calib.basics.values import ReadOnlyMapping, Value, keep_read_only
from calib.basics.workbook import split_sheet
from calib.data.cell import Cell
from calib.robot.xacro_file import XacroCall, is_xacro


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Call(Value):
    """The input of a calibration: data by their names, how they were read, the cell, and the method."""

    #: The robot as named, with a xacro's arguments; empty: it was given in memory, and the result's nominal robot is it
    robot: str = ""
    #: The table as named; empty: it was given in memory
    table: str = ""
    #: ``--columns``, as typed
    columns: tuple[str, ...] = ()
    #: ``--orientation``
    orientation: str | None = None
    #: ``--joint-unit``
    joint_unit: str | None = None
    #: ``--motors``
    motors: str | None = None
    #: ``--points``, the list of measured points as named
    points: str | None = None
    #: ``--points-unit``
    points_unit: str | None = None
    #: The cell: what its file says, with the options over it
    cell: Cell
    #: Whether the parameters were given as twists, which no file holds
    own_parameters: bool = False
    #: Name of the solver
    solver: str = "lm"
    #: Whether outliers lose their weight
    robust: bool = True
    #: Whether it was cross-validated
    validate: bool = True
    #: Number of samples of the bootstrap; None: there was none
    bootstrap: int | None = None
    #: Seed of these samples
    seed: int | None = None
    #: Parameters whose profile-likelihood intervals were computed
    profile: tuple[str, ...] = ()
    #: Number of processes, on which no number depends; None: not given
    workers: int | None = None
    #: SHA-256 of each file, by its name as given: robot, table, list of points, motors, cell file, further robots
    files: Mapping[str, str] = field(default_factory=ReadOnlyMapping)
    #: SHA-256 of the source of each plugin that was loaded, by its name as given
    plugins: Mapping[str, str] = field(default_factory=ReadOnlyMapping)

    def __post_init__(self) -> None:
        """Keep read-only copies of the mappings."""
        keep_read_only(self, "files", "plugins")


def split_name(name: str) -> tuple[Path, str]:
    """Split the name of an input into the path of its file and what follows it: arguments of a xacro, or a sheet.

    Example:
        >>> split_name("arm.xacro prefix:=left_")[1]
        ' prefix:=left_'
    """
    if is_xacro(name):
        call = XacroCall.parse(name)
        return call.path, call.name.removeprefix(call.path.name)
    file, _ = split_sheet(name)
    return Path(file), name.removeprefix(file)


def file_hashes(names: Iterable[str | Path | None]) -> dict[str, str]:
    """Return the SHA-256 of files by their names as given; other names, such as ``"ur3"``, are left out."""
    hashes = {}
    for name in names:
        if name is None:
            continue
        path, _ = split_name(str(name))
        if path.is_file():
            hashes[str(name)] = hashlib.sha256(read_bytes(path, "The file")).hexdigest()
    return hashes


def plugin_hashes() -> dict[str, str]:
    """Return the SHA-256 of the sources of the plugins that are loaded, by their names as given."""
    return {plugin.name: plugin.sha256 for plugin in plugins.loaded()}
