"""What calib takes from the files of a job by itself: robot, table, units, columns, base, tip, frame, instrument.

Each is a field of the page with its allowed values. A guess that may be wrong has a doubt, whose sentence the page
shows: units that no header names, columns matched by their order, a frame that two readings of the rows allow. What
was chosen on the page counts in place of a guess.

Whether points were measured in a frame of the robot is told by the rows: then the position of the target in the tip is
all that is unknown, and is solved for linearly,

    p_i = R_i t + d_i,    T_base_tip(q_i) = (R_i, d_i),

for each link that is rigidly attached to the root.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

import calib.data.kinds as registry
from calib.basics.arrays import Array
from calib.basics.tables import Column, Table
from calib.basics.units import find_unit, is_unit, split_header, symbols
from calib.basics.workbook import SUFFIXES as WORKBOOKS, sheet_names
from calib.boards.detection.picture import ImageFile, read_image
from calib.data.cell import AUTO, SCALE_SIGMAS, Cell
from calib.data.cell_chains import robot_of_cell, sights_of
from calib.data.columns import POINT, column_names
from calib.data.forms.column_options import BRANDS, ColumnOptions, brands_like
from calib.data.measurements import Measurements
from calib.data.points_file import read_points
from calib.data.whole_turns import brought_back
from calib.errors import CalibError, FileError
from calib.model.parameter_sets import MODELS
from calib.robot.dh_columns import is_dh_table
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf, read_urdf
from calib.robot.xacro_file import is_xacro
from calib.verbs.app.job import Job
from calib.verbs.app.uploads import is_picture
from calib.verbs.inspect.folder import Entry, What, look_into

#: Rows are in a frame of the robot if half of them are as near to the nominal robot as this [m]: an arm is off by less.
_KNOWN = 0.03

#: Nearer than this it is beyond doubt; further than this that they are not [m].
_SURELY_KNOWN, _SURELY_NOT = 0.01, 0.1

#: A second link explains the rows as well if they are at most so many times as far off.
_AS_WELL = 1.5

#: Links in whose frame makers give positions, the usual ones first.
_USUAL_BASES = ("base_link", "base", "link_base", "link0", "root")

#: Angles in radians are below this, apart from those of joints that turn several times.
_MOST_RADIANS = 6.6

#: Coordinates of a cell in metres are below this, and those in millimetres above.
_MOST_METRES = 12.0

#: A coordinate by its header, such as ``X``, ``pos_x``, ``TCP.x (mm)``.
_COORDINATE = re.compile(r"(?:.*[^a-z])?([xyz])(?:[\s_(\[]*([a-zµ]{1,2})[)\]]*)?", re.IGNORECASE)

#: A joint by its header, such as ``J1``, ``joint_2``, ``Axis 3``, ``q4``.
_NUMBERED = re.compile(
    r"(?:.*[^a-z])?(?:j|a|q|joint|axis|achse|gelenk)[\s_.-]*(\d)(?:\D.*)?", re.IGNORECASE
)

#: Words in names of files and headers by the instruments that they tell.
_INSTRUMENTS = {
    "tracker": ("leica", "tracker", "faro", "radian", "t-mac", "tmac", "smr", "spatialanalyzer"),
    "motion_capture": ("vicon", "optitrack", "mocap", "qualisys", "motion_capture"),
}

#: Rows of a table that a page shows.
_PREVIEW = 5


@dataclass(frozen=True, slots=True)
class Field:
    """A field of the page: its value, what it may be, and whether the value is sure."""

    name: str
    value: str
    #: Allowed values with their labels; empty: any text
    options: tuple[tuple[str, str], ...] = ()
    #: Key of the sentence that says why the value may be wrong; empty: it is sure, or was chosen
    doubt: str = ""
    #: Words of that sentence
    words: Mapping[str, str] = field(default_factory=dict)
    #: Whether it was chosen on the page
    is_chosen: bool = False


@dataclass(frozen=True, slots=True)
class InputFile:
    """An input of a job, and what calib takes it for."""

    name: str
    #: A value of `calib.verbs.inspect.folder.What`; empty: calib does not read it
    what: str
    #: Rows, points or pictures; 0 where there are none
    count: int = 0
    #: What is wrong with it
    fault: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Looked:
    """What the files of a job are, and how they are to be read."""

    files: tuple[InputFile, ...]
    fields: Mapping[str, Field]
    #: What keeps the files from being read so, in calib's words; empty: nothing
    fault: str = ""
    #: Key of the sentence on what is missing still; empty: nothing
    missing: str = ""
    #: Number of measured rows
    rows: int = 0
    #: The robot's chain: names of its joints
    joints: tuple[str, ...] = ()
    #: Header and first rows of the table
    header: tuple[str, ...] = ()
    preview: tuple[tuple[str, ...], ...] = ()
    #: Whether the rows are corners of boards in pictures
    images: bool = False
    #: Number of pictures whose corners are sought first; 0: the table has them
    pictures: int = 0

    @property
    def is_ready(self) -> bool:
        """True if it can be calibrated."""
        return not self.fault and not self.missing

    def value(self, name: str) -> str:
        """Return the value of a field; empty if there is none."""
        return self.fields[name].value if name in self.fields else ""


class _Fields:
    """The fields, as they are guessed one after the other; what was chosen goes before."""

    def __init__(self, chosen: Mapping[str, str]) -> None:
        """Begin without any."""
        self._chosen = chosen
        self.made: dict[str, Field] = {}

    def add(
        self,
        name: str,
        guess: str,
        options: Iterable[tuple[str, str]] = (),
        doubt: str = "",
        **words: str,
    ) -> str:
        """Add a field, and return its value: as chosen if that is allowed, else the guess."""
        allowed = tuple(dict.fromkeys(options))
        chosen = self._chosen.get(name)
        if chosen is not None and (not allowed or chosen in [value for value, _ in allowed]):
            self.made[name] = Field(name, chosen, allowed, is_chosen=True)
        else:
            self.made[name] = Field(name, guess, allowed, doubt, words)
        return self.made[name].value

    def has_choice(self, name: str) -> bool:
        """Return True if a field was chosen."""
        return name in self._chosen


def look(job: Job) -> Looked:
    """Look at the files of a job.

    Args:
        job: A job; what was chosen on its page counts in place of guesses.

    Returns:
        What the files are, and the fields with their guesses.
    """
    entries = {_name(job, entry.path): entry for entry in look_into(job.folder).entries}
    files = tuple(_input(job, name, entries.get(name)) for name in job.inputs)
    fields = _Fields(job.choices)
    robot = _robot_field(job, files, fields)
    table_name = _table_field(job, files, fields)
    looked = Looked(files=files, fields=fields.made)
    if not robot:
        return replace(looked, missing="missing_robot")
    if not table_name:
        return replace(looked, missing="missing_table")
    try:
        urdf = read_urdf(
            robot if is_typed(job, robot) else f"{job.folder / robot}{_arguments(fields)}"
        )
        table = Table.read(f"{job.folder}/{table_name}")
    except CalibError as error:
        return replace(looked, fault=_told(job, error))
    looked = replace(
        looked, header=table.header, preview=tuple(tuple(row) for row in table.cells[:_PREVIEW])
    )
    return _look_at_rows(job, looked, fields, urdf, table)


def is_typed(job: Job, robot: str) -> bool:
    """Return True if a robot is meant by its name, not by a file of the job."""
    return robot not in job.inputs


def _told(job: Job, error: CalibError) -> str:
    """Return the message of an error without the folder of the job, which says nothing to the reader."""
    return str(error).replace(f"{job.folder}/", "")


def _name(job: Job, path: Path) -> str:
    """Return the name of a file in the job."""
    return path.relative_to(job.folder).as_posix()


def _arguments(fields: _Fields) -> str:
    """Return what follows the name of a xacro."""
    given = fields.made.get("xacro")
    return f" {given.value}" if given is not None and given.value else ""


# Files


def _input(job: Job, name: str, entry: Entry | None) -> InputFile:
    """Return what an input is taken for."""
    path = job.folder / name
    if is_picture(name):
        return InputFile(name, What.PICTURES.value)
    if path.suffix.lower() in WORKBOOKS:
        return _workbook(path, name)
    if entry is None:
        try:  # a list of points that names no unit
            count = len(read_points(path, "mm").points)
        except CalibError:
            return InputFile(name, "")
        return InputFile(name, What.POINTS.value, count)
    return InputFile(
        name, entry.what.value, entry.count, entry.said if entry.what is What.FAULTY else ""
    )


def _workbook(path: Path, name: str) -> InputFile:
    """Return what an Excel file is taken for: by the first of its sheets that is a table."""
    fault = ""
    try:
        for sheet in sheet_names(path):
            try:
                table = Table.read(f"{path}#{sheet}")
            except CalibError as error:
                fault = fault or str(error)
                continue
            what = What.ROBOT if is_dh_table(table) else What.TABLE
            return InputFile(name, what.value, len(table.cells))
    except CalibError as error:
        fault = str(error)
    return InputFile(name, What.FAULTY.value, fault=fault.replace(f"{path.parent}/", ""))


def _robot_field(job: Job, files: Sequence[InputFile], fields: _Fields) -> str:
    """Add the fields of the robot; return its file in the job or its name, empty if there is none."""
    names = [file.name for file in files if file.what == What.ROBOT.value]
    typed = job.choices.get("robot_name", "")
    fields.add("robot_name", "")
    if typed:
        return typed
    if not names:
        return ""
    doubt = "doubt_several" if len(names) > 1 else ""
    robot = fields.add("robot", names[0], [(name, name) for name in names], doubt)
    if is_xacro(robot):
        fields.add("xacro", "")
    return robot


def _table_field(job: Job, files: Sequence[InputFile], fields: _Fields) -> str:
    """Add the fields of table and list of points; return the table, a sheet of Excel with its name."""
    tables: list[str] = []
    for file in files:
        if file.what != What.TABLE.value:
            continue
        if Path(file.name).suffix.lower() in WORKBOOKS:
            sheets = sheet_names(job.folder / file.name)
            tables += (
                [f"{file.name}#{sheet}" for sheet in sheets] if len(sheets) > 1 else [file.name]
            )
        else:
            tables.append(file.name)
    if not tables:
        return ""
    doubt = "doubt_several" if len(tables) > 1 else ""
    best = next((name for name in tables if _has_rows(job, name)), tables[0])
    table = fields.add("table", best, [(name, name) for name in tables], doubt)
    lists = [file.name for file in files if file.what == What.POINTS.value]
    # A list of points in a sheet of the same workbook.
    lists += [name for name in tables if name != table and "#" in name]
    if lists:
        own = _has_point(job, table)
        guess = "" if own or "#" in lists[0] else lists[0]
        fields.add("points", guess, [("", "-"), *((name, name) for name in lists)])
    return table


def _has_rows(job: Job, name: str) -> bool:
    """Return True if a table can be read and has rows."""
    try:
        return bool(Table.read(f"{job.folder}/{name}").cells)
    except CalibError:
        return False


def _has_point(job: Job, name: str) -> bool:
    """Return True if a table has columns of a position."""
    try:
        names = column_names(Table.read(f"{job.folder}/{name}")) or set()
    except CalibError:
        return False
    return {name.casefold() for name in names} >= set(POINT)


# Rows


def _look_at_rows(job: Job, looked: Looked, fields: _Fields, urdf: Urdf, table: Table) -> Looked:
    """Add the fields of chain, columns, units, frame, target and instrument."""
    names = [split_header(label)[0] for label in table.header]
    pictures = sum(is_picture(name) for name in job.inputs)
    by_image = "image" in names and {*POINT, "u", "v"}.isdisjoint(names)
    images = "u" in names or by_image
    looked = replace(looked, images=images, pictures=pictures if by_image else 0)
    if images:
        fault = _image_fields(job, looked, fields)
        if fault:
            return replace(looked, missing=fault)

    links = [(link, link) for link in urdf.links]
    chain = Cell()  # of a camera the one between root and hand, whichever way it is measured
    if not images:
        chain = Cell(base=job.choices.get("base") or None, tip=job.choices.get("tip") or None)
    try:
        arm = robot_of_cell(urdf, chain)
    except CalibError as error:
        fields.add("base", urdf.root, links)
        fields.add("tip", links[-1][0], links, "doubt_tip")
        return replace(looked, fault=_told(job, error))
    brand = _brand_field(fields, names, arm)
    known = set(names)
    if not brand and not images:
        try:  # the longest chain whose joints all have a column
            arm = robot_of_cell(urdf, chain, known, sights_of(table))
        except CalibError as error:
            fields.add("tip", arm.tip, links, "doubt_tip")
            looked = replace(looked, fault=_told(job, error))
    _column_fields(
        fields, table, arm, brand, has_list=bool(fields.made.get("points", Field("", "")).value)
    )
    _unit_fields(fields, table, arm, job)
    looked = replace(looked, joints=arm.joint_names)
    kinds = [(name, name) for name in registry.names()]
    fields.add("kind", "", [("", ""), *kinds])

    if images:
        fields.add("base", arm.tip, links, "doubt_camera")
        fields.add("tip", _usual(_rigid_links(urdf, urdf.root), urdf.root), links, "doubt_board")
        _further_fields(job, looked, fields)
        return replace(looked, rows=len(table.cells))

    _further_fields(job, looked, fields)
    fields.add("tip", arm.tip, links)
    fields.add("base", arm.base, links)
    try:
        measurements = read_rows(job, replace(looked, fields=fields.made), arm, table)
    except CalibError as error:
        fields.add("frame", "known", _FRAMES)
        return replace(looked, fault=looked.fault or _told(job, error))
    _frame_fields(job, fields, urdf, arm, measurements)
    return replace(looked, rows=len(measurements))


_FRAMES = (("known", "known"), ("estimate", "estimate"))


def read_rows(job: Job, looked: Looked, arm: Robot, table: Table) -> Measurements:
    """Read the rows of a table as the fields say; raises `CalibError`."""
    points = looked.value("points")
    return brought_back(
        arm,
        Measurements.read(
            table,
            arm.joint_names,
            arm.joint_types,
            column_choice(looked, table.header),
            looked.value("kind") or None,
            f"{job.folder}/{points}" if points else None,
            looked.value("points_unit") or None,
        ),
    )


def column_choice(looked: Looked, header: Sequence[str]) -> ColumnOptions:
    """Return what the fields say of a table's columns."""
    return ColumnOptions(
        dict(word.rpartition("=")[::2] for word in column_words(looked, header)),
        looked.value("brand") or None,
        None,
        looked.value("joint_unit") or None,
    )


def column_words(looked: Looked, header: Sequence[str]) -> list[str]:
    """Return the words of ``--columns`` that map columns, such as ``"J1=joint_1"``."""
    words = []
    unit = looked.value("position_unit")
    for name, one in looked.fields.items():
        if not name.startswith("column:") or not one.value:
            continue
        wanted = name.removeprefix("column:")
        label = next((label for label in header if label == one.value), one.value)
        written, symbol = split_header(label)
        to_unit = unit if wanted in POINT and symbol is None else ""
        if written != wanted or to_unit:
            words.append(f"{written}={wanted}" + (f" [{to_unit}]" if to_unit else ""))
    return words


def _brand_field(fields: _Fields, names: Sequence[str], arm: Robot) -> str:
    """Add the field of the brand whose names the columns have; return the brand, empty for none."""
    if set(arm.joint_names) <= set(names):
        guess, doubt = "", ""
    else:
        alike = brands_like(names)
        guess = alike[0].name if alike else ""
        doubt = "doubt_brand" if alike else ""
        if guess and len(alike[0].axes_in(names)) != len(arm.joint_names):
            guess = doubt = ""
    if not guess and not fields.has_choice("brand"):
        return ""
    options = [("", "-"), *((brand.name, brand.title) for brand in BRANDS.values())]
    return fields.add("brand", guess, options, doubt)


def _column_fields(
    fields: _Fields, table: Table, arm: Robot, brand: str, *, has_list: bool
) -> None:
    """Add a field for each column that has another name than calib's: of joints by number or order, of positions."""
    names = [split_header(label)[0] for label in table.header]
    labels = dict(zip(names, table.header, strict=True))
    options = [("", "-"), *((label, label) for label in table.header if label)]
    free = [name for name in names if name and name not in arm.joint_names]
    if not brand:
        missing = [name for name in arm.joint_names if name not in names]
        numbered: dict[int, str] = {}
        for name in free:
            match = _NUMBERED.fullmatch(name)
            if match is not None:
                numbered.setdefault(int(match[1]), name)
        for joint in missing:
            number = arm.joint_names.index(joint) + (0 if 0 in numbered else 1)
            found = labels.get(numbered.get(number, ""), "")
            fields.add(
                f"column:{joint}", found, options, "doubt_order" if found else "doubt_column"
            )
    folded = {name.casefold() for name in names}
    if has_list or brand or folded >= set(POINT):
        if not has_list and not brand:
            _position_unit(fields, table, [labels[n] for n in names if n.casefold() in POINT])
        return
    found_axes: dict[str, str] = {}
    for name in free:
        match = _COORDINATE.fullmatch(name)
        if match is not None:
            found_axes.setdefault(match[1].casefold(), name)
    if len(found_axes) != len(POINT):
        return  # another kind of measurement, or a message says what lacks
    for axis in POINT:
        fields.add(f"column:{axis}", labels[found_axes[axis]], options, "doubt_name")
    _position_unit(fields, table, [labels[found_axes[axis]] for axis in POINT])


def _position_unit(fields: _Fields, table: Table, labels: Sequence[str]) -> None:
    """Add the field of the unit of positions whose headers name none, by their ending or their size."""
    if all(split_header(label)[1] for label in labels):
        return
    size = _largest(table, labels)
    match = _COORDINATE.fullmatch(split_header(labels[0])[0])
    written = match[2] if match is not None and match[2] and is_unit(match[2]) else ""
    guess = find_unit(written).symbol if written else ("m" if size < _MOST_METRES else "mm")
    doubt = "doubt_unit_name" if written else "doubt_unit_size"
    options = [(symbol, symbol) for symbol in symbols("length")]
    fields.add("position_unit", guess, options, doubt, size=f"{size:.4g}", unit=guess)
    for axis, label in zip(POINT, labels, strict=False):
        if f"column:{axis}" not in fields.made:
            fields.add(f"column:{axis}", label, [(label, label)])


def _unit_fields(fields: _Fields, table: Table, arm: Robot, job: Job) -> None:
    """Add the unit of joints whose headers name none, and that of a list of points that names none."""
    columns = {split_header(label)[0]: label for label in table.header}
    used = []
    for joint in arm.joint_names:
        mapped = fields.made.get(f"column:{joint}")
        label = columns.get(joint, "") if mapped is None else mapped.value
        if label and split_header(label)[1] is None:
            used.append((joint, label))
    if used:
        turning = [label for joint, label in used if arm.joint_types[joint] != "prismatic"]
        sliding = [label for joint, label in used if arm.joint_types[joint] == "prismatic"]
        size = _largest(table, turning) if turning else 0.0
        guess = "rad" if size < _MOST_RADIANS else "deg"
        if sliding:
            length = "m" if _largest(table, sliding) < _MOST_METRES else "mm"
            guess = f"{guess} {length}" if turning else length
        both = [f"{a} {b}" for a in ("deg", "rad") for b in ("mm", "m")]
        units = both if turning and sliding else ["mm", "m"] if sliding else ["deg", "rad"]
        options = [(unit, unit) for unit in units]
        fields.add("joint_unit", guess, options, "doubt_unit_size", size=f"{size:.4g}", unit=guess)
    listed = fields.made.get("points")
    if listed is not None and listed.value and "#" not in listed.value:
        try:
            read_points(job.folder / listed.value)
        except CalibError:
            options = [(symbol, symbol) for symbol in symbols("length")]
            fields.add("points_unit", "mm", options, "doubt_points_unit")


def _largest(table: Table, labels: Sequence[str]) -> float:
    """Return the largest number of some columns, by size; 0 if they hold none."""
    columns = [
        Column(table.header.index(label), label, label, None)
        for label in labels
        if label in table.header
    ]
    try:
        numbers = np.abs(table.numbers(columns))
    except CalibError:
        return 0.0
    finite = numbers[np.isfinite(numbers)]
    return float(finite.max()) if finite.size else 0.0


# Frame, base, target, instrument


def _frame_fields(
    job: Job, fields: _Fields, urdf: Urdf, arm: Robot, measurements: Measurements
) -> None:
    """Add the field of the frame, and guess the base by the rows, if these are positions in a frame outside."""
    kinds = {registry.get(name).position for name in measurements.kinds}
    points = measurements.points
    if kinds != {True} or not np.isfinite(points).any():
        fields.add("frame", "known", _FRAMES, "doubt_frame")
        return
    bases = [arm.base] if "base" in job.choices else _rigid_links(urdf, arm.base)
    off: dict[str, float] = {}
    for base in bases:
        with contextlib.suppress(CalibError, np.linalg.LinAlgError):
            off[base] = _off(arm.rebuilt(base=base), measurements)
    if not off:
        fields.add("frame", "known", _FRAMES, "doubt_frame")
        return
    best = min(off, key=lambda base: off[base])
    if best != arm.base and off[arm.base] <= _AS_WELL * off[best]:
        best = arm.base  # calib's own choice explains the rows as well
    size = off[best]
    words = {
        "size": f"{1e3 * size:.0f}" if size >= _SURELY_KNOWN else f"{1e3 * size:.1f}",
        "base": best,
    }
    guess = "known" if size < _KNOWN else "estimate"
    doubt = "doubt_frame_size" if _SURELY_KNOWN < size < _SURELY_NOT else ""
    frame = fields.add("frame", guess, _FRAMES, doubt, **words)
    links = [(link, link) for link in urdf.links]
    if frame == "known":
        as_well = [base for base in off if base != best and off[base] <= _AS_WELL * size]
        near = [base for base in as_well if _differs(urdf, best, base)]
        doubt = "doubt_base" if near and size < _KNOWN else ""
        fields.add("base", best, links, doubt, other=", ".join(near), **words)
    else:
        fields.add("base", _usual(bases, arm.base), links)


def _differs(urdf: Urdf, one: str, other: str) -> bool:
    """Return True if two links that are rigidly attached to each other are at different places."""
    robot = Robot.from_urdf(urdf, base=one, tip=_moving_tip(urdf))
    second = robot.rebuilt(base=other)
    q = np.zeros((1, len(robot.joint_names)))
    return not np.allclose(robot.poses(q), second.poses(q), atol=1e-6)


def _moving_tip(urdf: Urdf) -> str:
    """Return the default tip of a robot."""
    return Robot.from_urdf(urdf).tip


def _off(arm: Robot, measurements: Measurements) -> float:
    """Return the median distance of measured positions from those of the nominal robot, its target solved for [m].

    Only the target and the station with the most rows count.
    """
    pairs = list(zip(measurements.groups, measurements.targets, strict=True))
    most = max(dict.fromkeys(pairs), key=pairs.count)
    used = np.array([pair == most for pair in pairs]) & np.isfinite(measurements.points).all(axis=1)
    T: Array = arm.poses(measurements.joints[used])
    p = measurements.points[used]
    A = T[:, :3, :3].reshape(-1, 3)
    b = (p - T[:, :3, 3]).reshape(-1)
    t, *_ = np.linalg.lstsq(A, b, rcond=None)
    return float(np.median(np.linalg.norm((b - A @ t).reshape(-1, 3), axis=1)))


def _rigid_links(urdf: Urdf, link: str) -> list[str]:
    """Return the links that no moving joint parts from a link, itself first."""
    found = [link]
    for one in found:  # grows
        for joint in urdf.joints:
            if joint.type != "fixed":
                continue
            for here, there in ((joint.parent, joint.child), (joint.child, joint.parent)):
                if here == one and there not in found:
                    found.append(there)
    return found


def _usual(links: Sequence[str], otherwise: str) -> str:
    """Return the first of the links that has a usual name of a base."""
    return next((name for name in _USUAL_BASES if name in links), otherwise)


def _further_fields(job: Job, looked: Looked, fields: _Fields) -> None:
    """Add the fields of target, instrument, model and serial number."""
    fields.add("target", "")
    if not looked.images:
        text = " ".join([*job.inputs, *looked.header]).casefold()
        told = [name for name, words in _INSTRUMENTS.items() if any(word in text for word in words)]
        guess = told[0] if told else "tracker" if looked.value("points") else ""
        doubt = "doubt_instrument_name" if guess else "doubt_instrument"
        fields.add("instrument", guess, [("", ""), *((n, n) for n in SCALE_SIGMAS)], doubt)
    fields.add("model", AUTO, [(AUTO, AUTO), *((name, name) for name in MODELS)])
    fields.add("serial", "")
    cells = [file.name for file in looked.files if file.what == What.CELL.value]
    if cells:
        fields.add("cell", cells[0], [("", "-"), *((name, name) for name in cells)])


def _image_fields(job: Job, looked: Looked, fields: _Fields) -> str:
    """Add the fields of board and camera; return the key of the sentence on what is missing, empty for nothing."""
    boards = [file.name for file in looked.files if file.what == What.BOARD.value]
    if not boards:
        return "missing_board"
    if looked.pictures == 0 and "u" not in {split_header(label)[0] for label in looked.header}:
        return "missing_pictures"
    doubt = "doubt_several" if len(boards) > 1 else ""
    fields.add("board", boards[0], [(name, name) for name in boards], doubt)
    cameras = [(f.name, f.name) for f in looked.files if f.what == What.CAMERA.value]
    size = _picture_size(job)
    if size:
        cameras.append((size, size))
    if not cameras:
        fields.add("camera", "", (), "doubt_camera_size")
        return ""
    fields.add(
        "camera", cameras[0][0], cameras, "" if "x" not in cameras[0][0] else "doubt_intrinsics"
    )
    return ""


def _picture_size(job: Job) -> str:
    """Return the size of the first picture that can be read, ``"1280x720"``; empty if there is none."""
    for name in job.inputs:
        if is_picture(name):
            try:
                image: Any = read_image(ImageFile(job.folder / name, name))
            except (FileError, CalibError):
                continue
            if image is not None:
                height, width = image.shape[:2]
                return f"{width}x{height}"
    return ""
