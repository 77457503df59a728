"""A result made again from its own record, and what differs: inputs, options, versions, and every number.

A result keeps what its calibration was told (`calib.result.call.Call`): names and hashes of its files, the whole cell,
the method. Files are looked for by their names in the current folder and beside the result; of several the one with
the recorded hash counts. Compared are all values of the two result files except for the time. Hashes, options and
versions that are not as before are listed beside (`Change`).
"""

from __future__ import annotations

import enum
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import zip_longest
from pathlib import Path
from typing import Any

import calib.basics.plugins as plugins
from calib.basics.json_files import Json, json_bytes, plain, read_json
from calib.basics.values import Value, shown_by
from calib.cli.loading import load_with_data
from calib.cli.options import TableOptions
from calib.data.inputs import RobotInput, TableInput
from calib.errors import CalibError, FileError
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.result.calibration_file import (
    EXPECTED,
    SCHEMA,
    call_table,
    file_table,
    read_result,
)
from calib.result.call import Call, file_hashes, plugin_hashes, split_name
from calib.result.fitted_model import ParameterEstimate
from calib.robot.urdf import Urdf
from calib.verbs.calibrate.uncertainty import LEVEL, bootstrap, profile_interval, profile_table

#: Keys at the top of a result that are not compared: what was told and when, names and hashes of files.
_NOT_COMPARED = ("call", "checksums", "inputs", "plugins", "time", "versions")

#: Time that a fit took.
_SECONDS = "solver.seconds"

#: Names of an input that was given in memory, and of standard input.
_NO_FILES = ("", "-")

#: Fields of a call that are no options: the inputs themselves, and processes, on which no number depends.
_NO_OPTIONS = ("robot", "table", "points", "files", "plugins", "workers", "cell")


class What(enum.Enum):
    """A difference from the first run."""

    INPUT = enum.auto()
    PLUGIN = enum.auto()
    OPTION = enum.auto()
    VERSION = enum.auto()


@dataclass(frozen=True, slots=True)
class Change:
    """Something that is not as it was when a result was made."""

    what: What
    #: Name of the file, plugin, option or package
    name: str
    #: SHA-256 of a file or plugin, value of an option as JSON, version; empty: there was none
    before: str
    #: The same now; empty: there is none
    now: str


@dataclass(frozen=True, slots=True)
class Difference:
    """A value of a result that is another one now."""

    #: Its place in the result file, such as ``"parameters[3].value"``
    path: str
    #: As JSON has it; None also if it was missing
    before: Any
    now: Any

    @property
    def relative(self) -> float:
        """Difference of two numbers over the larger one; NaN if they are not both numbers."""
        if not (_is_number(self.before) and _is_number(self.now)):
            return math.nan
        return float(abs(self.now - self.before) / max(abs(self.now), abs(self.before)))


@dataclass(frozen=True, slots=True)
class Moved:
    """A parameter of both results whose value differs."""

    before: ParameterEstimate
    now: ParameterEstimate

    @property
    def in_std(self) -> float:
        """Absolute difference in standard deviations of the first estimate; infinite if that was exact."""
        difference = abs(self.now.value - self.before.value)
        return float(difference / self.before.std) if self.before.std > 0.0 else math.inf


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Again(Value):
    """A result beside the one that its record gave when it was made again."""

    #: The result of the record
    before: Calibration
    #: The result now
    result: Calibration
    #: Inputs, plugins, options and versions that are not as they were
    changes: tuple[Change, ...]
    #: Number of values that were compared
    compared: int
    #: Those that differ, in the order of the file
    differences: tuple[Difference, ...]

    @property
    def is_equal(self) -> bool:
        """True if every value, and every byte of the corrected URDF, is the same."""
        return not self.differences

    @property
    def moved(self) -> tuple[Moved, ...]:
        """Parameters of both results whose values differ, most standard deviations first."""
        now = {parameter.name: parameter for parameter in _parameters(self.result)}
        pairs = [
            Moved(parameter, now[parameter.name])
            for parameter in _parameters(self.before)
            if parameter.name in now and now[parameter.name].value != parameter.value
        ]
        return tuple(sorted(pairs, key=lambda pair: -pair.in_std))

    @property
    def has_same_urdf(self) -> bool:
        """True if the corrected URDF has the same bytes."""
        return self.before.robot.urdf.sha256 == self.result.robot.urdf.sha256

    def summary(self) -> str:
        """Return in words what differs."""
        return str(shown_by("verbs.calibrate.again_text").again_text(self))


@dataclass(frozen=True, slots=True, eq=False)
class ResultFile:
    """A result file: the result, what its calibration was told, and its tables."""

    path: Path
    result: Calibration
    call: Call
    table: Json

    @classmethod
    def read(cls, path: str | Path) -> ResultFile:
        """Read a result, after the plugins that its calibration had.

        Args:
            path: The file.

        Raises:
            FileError: It cannot be read, is not a result, or an earlier version wrote it, which kept no record.
            PluginError: A plugin of the record cannot be loaded.
        """
        table = read_json(path, "calibration result", SCHEMA, EXPECTED)
        folder = Path(path).parent
        call = table.get("call")
        if isinstance(call, Mapping):
            here = {plugin.name for plugin in plugins.loaded()}
            for name in call.get("plugins", ()):
                if name not in here:
                    plugins.load(_found(name, "", folder) if name.endswith(".py") else name)
        result = read_result(path)
        if result.method.call is None:
            raise FileError(
                f"{path}: this result keeps no record of what its calibration was told; an earlier version wrote it. "
                "Calibrate once more with --json: that result can be made again."
            )
        return cls(Path(path), result, result.method.call, table)

    def located(self, told: Call) -> Call:
        """Return a call with the names of its files as they are found now, and with their hashes.

        Args:
            told: The call of this record, perhaps with other inputs and options.

        Raises:
            CalibError: An input, or the parameters, were given in memory.
            FileError: A file was not found.
        """
        if told.own_parameters:
            raise CalibError(
                f"{self.path}: its parameters were given in Python, and no file holds them. Call calib.calibrate with "
                "them again."
            )
        for what, name in (("robot", told.robot), ("table", told.table)):
            if name in _NO_FILES:
                origin = "read from standard input" if name else "given in memory"
                raise CalibError(
                    f"{self.path}: its {what} was {origin} and cannot be found again. Name both: calib calibrate ROBOT "
                    f"DATA --again {self.path}"
                )

        def find(name: str) -> str:
            """Return the name by which a file is found; that of no file, such as ``"ur3"``, is unchanged."""
            sha256 = self.call.files.get(name)
            return name if sha256 is None else _found(name, sha256, self.path.parent)

        robots = {
            name: replace(further, robot=find(further.robot))
            for name, further in told.cell.robots.items()
        }
        found = replace(
            told,
            robot=find(told.robot),
            table=find(told.table),
            points=told.points and find(told.points),
            motors=told.motors and find(told.motors),
            cell=replace(told.cell, robots=robots) if robots else told.cell,
        )
        further = [robot.robot for robot in robots.values()]
        names = (found.robot, found.table, found.points, found.motors, *further)
        return replace(found, files=file_hashes(names))

    def compared(self, result: Calibration, told: Call, tables: Json) -> Again:
        """Compare this result with another one.

        Args:
            result: The result now.
            told: What its calibration was told.
            tables: Further tables of its file, such as that of the bootstrap.

        Returns:
            Both results and what differs.
        """
        now = json.loads(json_bytes(file_table(result) | dict(tables)))
        before = self.table.get("versions", {})
        changes = [
            *_changed_inputs(self.result, result),
            *self._changed_beside(),
            *_changed(What.PLUGIN, _by_file(self.call.plugins), _by_file(plugin_hashes())),
            *_changed(What.OPTION, _options(self.call), _options(told)),
            *_changed(What.VERSION, before, now["versions"]),
        ]
        count, differences = compare_tables(self.table, now)
        return Again(
            before=self.result,
            result=result,
            changes=tuple(changes),
            compared=count,
            differences=tuple(differences),
        )

    def _changed_beside(self) -> Iterator[Change]:
        """Yield the other files that have other bytes now: that of the cell, which is not read, and of motors."""
        call = self.call
        compared = {call.robot, call.table, call.points}
        compared |= {robot.robot for robot in call.cell.robots.values()}
        for name, before in call.files.items():
            places = _places(name, self.path.parent)
            if name not in compared and places:
                now = [next(iter(file_hashes([place]).values())) for place in places]
                if before not in now:
                    yield Change(What.INPUT, name, before, now[0])


def again(
    path: str | Path,
    robot: RobotInput | None = None,
    measurements: TableInput | None = None,
) -> Again:
    """Make a result again from its own record, and compare.

    Args:
        path: The result's file. Its inputs are looked for by their names, in the current folder and beside the file.
        robot: The robot in place of that of the record, together with ``measurements``; needed if either was given in
            memory, which no file holds.
        measurements: The table in place of that of the record.

    Returns:
        Both results and what differs.

    Raises:
        CalibError: The file has no record, an input was given in memory, or only one is given here; else as of
            `calib.calibrate`.
    """
    record = ResultFile.read(path)
    told = record.call
    arm: RobotInput
    table: TableInput
    if robot is not None and measurements is not None:
        arm, table = robot, measurements
    elif robot is None and measurements is None:
        told = record.located(told)
        arm, table = load_with_data(
            told.robot, told.cell, Path(told.table), TableOptions.of_call(told)
        )
    else:
        raise CalibError(
            "Give both 'robot' and 'measurements' in place of those of the record, or neither."
        )
    result = calibrate(
        arm,
        table,
        cell=told.cell,
        solver=told.solver,
        robust=told.robust,
        validate=told.validate,
    )
    tables: dict[str, Any] = {}
    if told.bootstrap is not None:
        tables["bootstrap"] = bootstrap(result, told.bootstrap, told.seed or 0).table()
    if told.profile:
        tables["profiles"] = [
            profile_table(result.parameter(name), profile_interval(result, name, LEVEL))
            for name in told.profile
        ]
    return record.compared(result, told, tables)


# Files


def _places(name: str, folder: Path) -> list[str]:
    """Return the names of files that a name may mean: here and in a folder, with its own folders and without."""
    path, rest = split_name(name)
    places = [path, folder / path, Path(path.name), folder / path.name]
    return [f"{place}{rest}" for place in dict.fromkeys(places) if place.is_file()]


def _found(name: str, sha256: str, folder: Path) -> str:
    """Return the name of the file with this hash, or else of the first one so called; FileError if there is none."""
    places = _places(name, folder)
    if not places:
        raise FileError(
            f"'{name}' of the record is neither in the current folder nor in '{folder}'. Copy it there, or name robot "
            "and table: calib calibrate ROBOT DATA --again RESULT"
        )
    same = [place for place in places if sha256 in file_hashes([place]).values()]
    return (same or places)[0]


# Comparison


def _changed_inputs(before: Calibration, now: Calibration) -> Iterator[Change]:
    """Yield the robots and the table that are not the same: by the text of the URDF that was read, and the bytes."""

    def urdfs(result: Calibration) -> list[Urdf]:
        """List the URDFs of a result's robots."""
        return [part.urdf for part in result.nominal.parts] or [result.nominal.urdf]

    for a, b in zip_longest(urdfs(before), urdfs(now)):
        if a is None or b is None or a.sha256 != b.sha256:
            name = a.source if a is not None else b.source
            yield Change(What.INPUT, name, a.sha256 if a else "", b.sha256 if b else "")
    if before.source.sha256 != now.source.sha256:
        name = before.source.name or now.source.name
        yield Change(What.INPUT, name, before.source.sha256, now.source.sha256)


def _changed(what: What, before: Mapping[str, str], now: Mapping[str, str]) -> Iterator[Change]:
    """Yield the entries of two mappings that differ."""
    for name in dict.fromkeys([*before, *now]):
        pair = before.get(name, ""), now.get(name, "")
        if pair[0] != pair[1]:
            yield Change(what, name, *pair)


def _by_file(hashes: Mapping[str, str]) -> dict[str, str]:
    """Return the hashes of plugins by their names without folders, where they may be others now."""
    return {Path(name).name: sha256 for name, sha256 in hashes.items()}


def _options(told: Call) -> dict[str, str]:
    """Return the options of a call as JSON by their names, those of the cell by the names of its fields."""
    table = call_table(told)
    cell = {f"cell.{name}": entry for name, entry in table["cell"].items() if name != "robots"}
    options = {name: entry for name, entry in table.items() if name not in _NO_OPTIONS}
    return {name: json.dumps(plain(entry)) for name, entry in (options | cell).items()}


def compare_tables(before: Json, now: Json) -> tuple[int, list[Difference]]:
    """Compare the tables of two results, as `read_json` gives them.

    Args:
        before: Tables of the first result.
        now: Tables of the second.

    Returns:
        The number of values that were compared, and those that differ.
    """
    a, b = dict(_values(before)), dict(_values(now))
    paths = list(dict.fromkeys([*a, *b]))
    if before.get("versions", {}).get("calib") != now["versions"]["calib"]:
        # A key that one of the versions does not have is no difference.
        paths = [path for path in paths if path in a and path in b]
    missing = object()
    differences = [
        Difference(path, a.get(path), b.get(path))
        for path in paths
        if a.get(path, missing) != b.get(path, missing)
    ]
    return len(paths), differences


def _values(table: Json) -> Iterator[tuple[str, Any]]:
    """Yield the values of a result's tables that are compared, each with its path."""
    for key, entry in table.items():
        if key not in _NOT_COMPARED:
            yield from _leaves(key, entry)
    yield from _leaves("inputs.urdf.text", table["inputs"]["urdf"]["text"])


def _leaves(path: str, entry: Any) -> Iterator[tuple[str, Any]]:  # noqa: ANN401  any JSON
    """Yield the values of nested tables and lists with their paths, but for the time that a fit took."""
    if isinstance(entry, dict):
        for key, inner in entry.items():
            yield from _leaves(f"{path}.{key}", inner)
    elif isinstance(entry, list):
        for number, inner in enumerate(entry):
            yield from _leaves(f"{path}[{number}]", inner)
    elif path != _SECONDS:
        yield path, entry


def _parameters(result: Calibration) -> Iterator[ParameterEstimate]:
    """Yield the parameters of a result, and those that its non-geometric model alone has."""
    yield from result.parameters
    if result.non_geometric is not None:
        names = {parameter.name for parameter in result.parameters}
        yield from (each for each in result.non_geometric.parameters if each.name not in names)


def _is_number(value: object) -> bool:
    """Return True for a number of JSON."""
    return isinstance(value, (int, float)) and not isinstance(value, bool)
