"""What calib takes from the files of a job by itself: robot, table, units, columns, base, tip, frame, instrument.

Each is a field of the page with its allowed values. A guess that may be wrong has a doubt, whose sentence the page
shows: units that no header names, columns matched by their order, a frame that the rows do not tell for sure. What was
chosen on the page counts in place of a guess, and so does what a cell file states that was sent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import calib.data.kinds as registry
from calib.basics.tables import Table
from calib.basics.units import split_header
from calib.basics.workbook import SUFFIXES as WORKBOOKS, sheet_names
from calib.boards.detection.picture import ImageFile, read_image
from calib.data.cell import AUTO, SCALE_SIGMAS, Cell
from calib.data.cell_chains import robot_of_cell, sights_of
from calib.data.columns import POINT, column_names
from calib.data.measurements import Measurements
from calib.data.points_file import read_points
from calib.data.whole_turns import brought_back
from calib.errors import CalibError
from calib.model.parameter_sets import MODELS
from calib.robot.dh_columns import is_dh_table
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf, read_urdf
from calib.robot.xacro_file import is_xacro
from calib.verbs.app.column_guesses import add_column_fields, column_choice, is_of_brand
from calib.verbs.app.fields import Fields, InputFile, Looked, plain
from calib.verbs.app.frame_guesses import FRAMES, add_frame_fields, rigid_links, usual_base
from calib.verbs.app.job import Job
from calib.verbs.app.uploads import is_picture
from calib.verbs.inspect.folder import Entry, What, look_into

#: Words in names of files and headers by the instruments that they tell.
_INSTRUMENTS = {
    "tracker": ("leica", "tracker", "faro", "radian", "t-mac", "tmac", "smr", "spatialanalyzer"),
    "motion_capture": ("vicon", "optitrack", "mocap", "qualisys", "motion_capture"),
}

#: Kinds of measurement of sessions on the page.
_KINDS_OF_SESSIONS = ("point", "pose")

#: Rows of a table that a page shows.
_PREVIEW = 5


def look(job: Job) -> Looked:
    """Look at the files of a job.

    Args:
        job: A job; what was chosen on its page counts in place of guesses.

    Returns:
        What the files are, and the fields with their guesses.
    """
    entries = {_name(job, entry.path): entry for entry in look_into(job.folder).entries}
    files = tuple(_input(job, name, entries.get(name)) for name in job.inputs)
    fields = Fields(job.choices)
    robot = _robot_field(job, files, fields)
    table_name = _table_field(job, files, fields)
    looked = Looked(files=files, fields=fields.made)
    if not robot:
        return replace(looked, missing="missing_robot")
    if not table_name:
        return replace(looked, missing="missing_table")
    try:
        urdf = read_urdf(named_robot(job, looked))
        table = Table.read(f"{job.folder}/{table_name}")
    except CalibError as error:
        return replace(looked, fault=_told(job, error))
    looked = replace(
        looked, header=table.header, preview=tuple(tuple(row) for row in table.cells[:_PREVIEW])
    )
    return _look_at_rows(job, looked, fields, urdf, table)


def look_for_session(job: Job) -> Looked:
    """Look at the files of a session: the robot, and a cell file if there is one.

    Args:
        job: As of `look`.

    Returns:
        What the files are, and the fields of the setup.
    """
    entries = {_name(job, entry.path): entry for entry in look_into(job.folder).entries}
    files = tuple(_input(job, name, entries.get(name)) for name in job.inputs)
    fields = Fields(job.choices)
    robot = _robot_field(job, files, fields)
    looked = Looked(files=files, fields=fields.made)
    if not robot:
        return replace(looked, missing="missing_robot")
    try:
        urdf = read_urdf(named_robot(job, looked))
        stated = _cell_field(job, looked, fields)
        base, tip = fields.chosen("base") or stated.base, fields.chosen("tip") or stated.tip
        arm = robot_of_cell(urdf, replace(stated, base=base, tip=tip))
    except CalibError as error:
        return replace(looked, fault=_told(job, error))
    if stated.cameras or stated.kind not in (None, *_KINDS_OF_SESSIONS):
        fault = "The page measures points and poses; sessions of other kinds are measured on the command line."
        return replace(looked, fault=fault)
    links = plain(urdf.links)
    has_cell = bool(fields.value("cell"))
    fields.add(
        "base", arm.base if has_cell else usual_base(rigid_links(urdf, arm.base), arm.base), links
    )
    fields.add("tip", arm.tip, links)
    fields.add("kind", stated.kind or "point", plain(_KINDS_OF_SESSIONS))
    fields.add("frame", _frame(stated) if has_cell else "estimate", FRAMES)
    _further_fields(job, looked, fields, stated, "doubt_instrument_session")
    fields.add("aim", "")
    fields.add("poses", "40")
    fields.add("collisions", "yes", plain(("yes", "no")))
    fields.add("reader", "")
    fields.add("controller", "")
    return replace(looked, joints=arm.joint_names)


def named_robot(job: Job, looked: Looked) -> str:
    """Return a job's robot as `read_urdf` takes it: a path, with the arguments of a xacro, or a name."""
    robot = looked.value("robot_name") or looked.value("robot")
    if is_typed(job, robot):
        return robot
    arguments = looked.value("xacro")
    return f"{job.folder / robot} {arguments}".rstrip()


def is_typed(job: Job, robot: str) -> bool:
    """Return True if a robot is meant by its name, not by a file of the job."""
    return robot not in job.inputs


def _told(job: Job, error: CalibError) -> str:
    """Return the message of an error without the folder of the job, which says nothing to the reader."""
    return str(error).replace(f"{job.folder}/", "")


def _name(job: Job, path: Path) -> str:
    """Return the name of a file in the job."""
    return path.relative_to(job.folder).as_posix()


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
    fault = entry.said.replace(f"{job.folder}/", "") if entry.what is What.FAULTY else ""
    return InputFile(name, entry.what.value, entry.count, fault)


def _workbook(path: Path, name: str) -> InputFile:
    """Return what an Excel file is taken for: by the sheet with the most rows that is a table."""
    fault, found = "", []
    try:
        sheets = sheet_names(path)
    except CalibError as error:
        fault, sheets = str(error), ()
    for sheet in sheets:
        table = _read_table(f"{path}#{sheet}")
        if isinstance(table, Table):
            found.append(table)
        else:
            fault = fault or table
    if not found:
        return InputFile(name, What.FAULTY.value, fault=fault.replace(f"{path.parent}/", ""))
    best = max(found, key=lambda table: len(table.cells))
    what = What.ROBOT if is_dh_table(best) else What.TABLE
    return InputFile(name, what.value, len(best.cells))


def _read_table(name: str) -> Table | str:
    """Read a table; if it cannot be read, return why."""
    try:
        return Table.read(name)
    except CalibError as error:
        return str(error)


def _robot_field(job: Job, files: Sequence[InputFile], fields: Fields) -> str:
    """Add the fields of the robot; return its file in the job or its name, empty if there is none."""
    names = [file.name for file in files if file.what == What.ROBOT.value]
    typed = job.choices.get("robot_name", "")
    fields.add("robot_name", "")
    if typed:
        return typed
    if not names:
        return ""
    doubt = "doubt_several" if len(names) > 1 else ""
    robot = fields.add("robot", names[0], plain(names), doubt)
    if is_xacro(robot):
        fields.add("xacro", "")
    return robot


def _table_field(job: Job, files: Sequence[InputFile], fields: Fields) -> str:
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
    best = max(tables, key=lambda name: _rows_of(job, name))
    table = fields.add("table", best, plain(tables), doubt)
    lists = [file.name for file in files if file.what == What.POINTS.value]
    # A list of points in a sheet of the same workbook.
    lists += [name for name in tables if name != table and "#" in name]
    if lists:
        own = _has_point(job, table)
        guess = "" if own or "#" in lists[0] else lists[0]
        fields.add("points", guess, plain(lists, "-"))
    return table


def _rows_of(job: Job, name: str) -> int:
    """Return the number of rows of a table; -1 if it cannot be read."""
    table = _read_table(f"{job.folder}/{name}")
    return len(table.cells) if isinstance(table, Table) else -1


def _has_point(job: Job, name: str) -> bool:
    """Return True if a table has columns of a position."""
    table = _read_table(f"{job.folder}/{name}")
    names = column_names(table) if isinstance(table, Table) else None
    return {name.casefold() for name in names or ()} >= set(POINT)


# Rows


def _look_at_rows(job: Job, looked: Looked, fields: Fields, urdf: Urdf, table: Table) -> Looked:
    """Add the fields of chain, columns, units, frame, target and instrument."""
    names = [split_header(label)[0] for label in table.header]
    pictures = sum(is_picture(name) for name in job.inputs)
    by_image = "image" in names and {*POINT, "u", "v"}.isdisjoint(names)
    images = "u" in names or by_image
    looked = replace(looked, images=images, pictures=pictures if by_image else 0)
    if images:
        missing = _image_fields(job, looked, fields)
        if missing:
            return replace(looked, missing=missing)
    try:
        stated = _cell_field(job, looked, fields)
    except CalibError as error:
        return replace(looked, fault=_told(job, error))

    links = plain(urdf.links)
    chain = stated
    if images and fields.value("cell") == "":
        chain = Cell()  # the one between root and hand, whichever way it is measured
    elif not images:
        base, tip = fields.chosen("base"), fields.chosen("tip")
        chain = replace(stated, base=base or stated.base, tip=tip or stated.tip)
    try:
        arm = robot_of_cell(urdf, chain)
    except CalibError as error:
        fields.add("base", urdf.root, links)
        fields.add("tip", urdf.root, links, "doubt_tip")
        return replace(looked, fault=_told(job, error))
    if not images and not is_of_brand(fields, names):
        try:  # the longest chain whose joints all have a column, unless that is only the beginning of the arm
            measured = robot_of_cell(urdf, chain, set(names), sights_of(table))
            count = len(measured.joint_names)
            is_part = measured.base == arm.base and measured.joint_names == arm.joint_names[:count]
            arm = arm if is_part else measured
        except CalibError as error:
            fields.add("tip", arm.tip, links, "doubt_tip")
            looked = replace(looked, fault=_told(job, error))
    add_column_fields(fields, table, arm, job.folder)
    looked = replace(looked, joints=arm.joint_names)
    fields.add("kind", stated.kind or "", plain(registry.names(), ""))
    _further_fields(job, looked, fields, stated)
    if images:
        root = usual_base(rigid_links(urdf, urdf.root), urdf.root)
        fields.add("base", stated.base or arm.tip, links, "" if stated.base else "doubt_camera")
        fields.add("tip", stated.tip or root, links, "" if stated.tip else "doubt_board")
        return replace(looked, rows=len(table.cells))

    fields.add("tip", arm.tip, links)
    try:
        measurements = read_rows(job, looked, arm, table)
    except CalibError as error:
        fields.add("base", arm.base, links)
        fields.add("frame", _frame(stated), FRAMES)
        return replace(looked, fault=looked.fault or _told(job, error))
    if fields.value("cell"):
        fields.add("base", arm.base, links)
        fields.add("frame", _frame(stated), FRAMES)
    else:
        add_frame_fields(fields, urdf, arm, measurements)
    return replace(looked, rows=len(measurements))


def _frame(cell: Cell) -> str:
    """Return the value of the field of the frame that a cell states."""
    return "estimate" if cell.estimate_frame else "known"


def _cell_field(job: Job, looked: Looked, fields: Fields) -> Cell:
    """Add the field of the cell file, if there is one, and return what it states; raises `CalibError`."""
    cells = [file.name for file in looked.files if file.what == What.CELL.value]
    if not cells:
        return Cell()
    name = fields.add("cell", cells[0], plain(cells, "-"))
    return Cell.read(job.folder / name) if name else Cell()


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


# Target, instrument, camera


def _further_fields(
    job: Job, looked: Looked, fields: Fields, stated: Cell, unknown: str = "doubt_instrument"
) -> None:
    """Add the fields of target, instrument, model and serial number, as a cell states them if there is one.

    ``unknown`` is the doubt about an instrument of which nothing is said.
    """
    fields.add("target", "")
    if not looked.images:
        text = " ".join([*job.inputs, *looked.header]).casefold()
        told = [name for name, words in _INSTRUMENTS.items() if any(word in text for word in words)]
        guess = told[0] if told else "tracker" if fields.value("points") else ""
        doubt = "doubt_instrument_name" if guess else unknown
        if fields.value("cell"):
            guess, doubt = stated.instrument or "", ""
        fields.add("instrument", guess, plain(SCALE_SIGMAS, ""), doubt)
    fields.add("model", stated.model, plain(dict.fromkeys((AUTO, stated.model, *MODELS))))
    if not fields.value("cell"):
        fields.add("noise", "")
        fields.add("serial", "")


def _image_fields(job: Job, looked: Looked, fields: Fields) -> str:
    """Add the fields of board and camera; return the key of the sentence on what is missing, empty for nothing."""
    boards = [file.name for file in looked.files if file.what == What.BOARD.value]
    if not boards:
        return "missing_board"
    if looked.pictures == 0 and "u" not in {split_header(label)[0] for label in looked.header}:
        return "missing_pictures"
    doubt = "doubt_several" if len(boards) > 1 else ""
    fields.add("board", boards[0], plain(boards), doubt)
    cameras = [file.name for file in looked.files if file.what == What.CAMERA.value]
    size = _picture_size(job)
    if cameras:
        fields.add("camera", cameras[0], plain([*cameras, *filter(None, [size])]))
    elif size:
        fields.add("camera", size, plain([size]), "doubt_intrinsics")
    else:
        fields.add("camera", "", (), "doubt_camera_size")
    return ""


def _picture_size(job: Job) -> str:
    """Return the size of the first picture that can be read, ``"1280x720"``; empty if there is none."""
    for name in job.inputs:
        if is_picture(name):
            try:
                image: Any = read_image(ImageFile(job.folder / name, name))
            except CalibError:
                continue
            if image is not None:
                height, width = image.shape[:2]
                return f"{width}x{height}"
    return ""
