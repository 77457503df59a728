"""What is in a folder, as text: its files, what belongs together, and the next commands."""

from __future__ import annotations

from calib.basics.tables import Table
from calib.data.cell import Cell
from calib.result.calibration import Calibration
from calib.robot.urdf import Urdf
from calib.show.lines import listed, plural
from calib.verbs.inspect.folder import Entry, Folder, What, names_images

#: What entries are that need no more words.
_PLAIN = {
    What.BOARD: "description of a printed board",
    What.CAMERA: "camera",
    What.FACTORY: "factory calibration of a Universal Robots arm: calib convert FILE --arm NAME -o robot.urdf",
    What.RECORDING: "recording (bag)",
    What.PROGRAM: "robot program",
    What.PAGE: "page to open and print",
}


def folder_text(folder: Folder) -> str:
    """Write what is in a folder, and what comes next.

    Args:
        folder: Its content.

    Returns:
        A line for each entry, and the commands, each in one line however long it is, so that it can be pasted.
    """
    if not folder.entries:
        lines = [f"Folder '{folder.path}': nothing that calib reads."]
    else:
        names = [str(entry.path.relative_to(folder.path)) for entry in folder.entries]
        names = ["the folder itself" if name == "." else name for name in names]
        width = max(map(len, names))
        lines = [f"Folder '{folder.path}':"]
        lines += [
            f"  {name:<{width}}  {_words(folder, entry)}"
            for name, entry in zip(names, folder.entries, strict=True)
        ]
    if folder.left_out:
        lines.append(f"  {plural(folder.left_out, 'further file')} not looked at")
    for entry, why in folder.misfits:
        lines += ["", f"{_name(folder, entry)} fits no robot here. {why}"]
    if any(entry.what is What.TABLE for entry in folder.entries) and not any(
        entry.what is What.ROBOT for entry in folder.entries
    ):
        lines += [
            "",
            "There is a table and no robot: put the robot's URDF beside it, or name the robot: calib calibrate ur3 "
            "TABLE.",
        ]
    if folder.commands:
        lines += ["", "Next:", *(f"  {command}" for command in folder.commands)]
    return "\n".join(lines)


def _name(folder: Folder, entry: Entry) -> str:
    """Return the name of an entry below its folder."""
    return str(entry.path.relative_to(folder.path))


def _words(folder: Folder, entry: Entry) -> str:
    """Say what an entry is, and what it belongs to."""
    if entry.what is What.FAULTY:
        return f"not read: {entry.said}"
    if entry.what is What.PICTURES:
        return plural(entry.count, "picture")
    if entry.what is What.POINTS:
        return f"list of {plural(entry.count, 'measured point')}"
    if entry.what is What.MANIFEST:
        return f"manifest of {plural(entry.count, 'robot')}"
    if entry.what is What.SWEEPS:
        return f"sweeps of single joints, {plural(entry.count, 'row')}"
    if entry.what is What.OUTPUT:
        return f"file of calib: {entry.said}"
    if isinstance(entry.content, Urdf):
        return _robot_words(folder, entry, entry.content)
    if isinstance(entry.content, Table):
        return _table_words(folder, entry)
    if isinstance(entry.content, Cell):
        used = [_name(folder, fit.table) for fit in folder.fits if fit.cell is entry]
        return "cell file" + (f", used for {listed(used)}" if used else "")
    if isinstance(entry.content, Calibration):
        return _result_words(folder, entry, entry.content)
    return _PLAIN[entry.what]


def _robot_words(folder: Folder, entry: Entry, urdf: Urdf) -> str:
    """Say which robot a URDF is of, and by which result it was corrected."""
    moving = sum(joint.type != "fixed" for joint in urdf.joints)
    words = f"robot '{urdf.name}', {plural(moving, 'joint')}"
    if not urdf.run:
        return words
    of = [_name(folder, result) for result, parts in folder.of_result if entry in parts]
    by = f" by {listed(of)}" if of else f", run {urdf.run}"
    return f"{words}; corrected{by}"


def _table_words(folder: Folder, entry: Entry) -> str:
    """Say how many rows a table has, and which robot and list of points they fit."""
    if names_images(entry):
        return f"joint values of {plural(entry.count, 'picture')}"
    words = f"table of {plural(entry.count, 'row')}"
    fits = [fit for fit in folder.fits if fit.table is entry]
    if fits:
        words += (
            f", {fits[0].rows} measured; fits {listed([_name(folder, fit.robot) for fit in fits])}"
        )
        if fits[0].points is not None:
            words += f", with the points of {_name(folder, fits[0].points)}"
    return words


def _result_words(folder: Folder, entry: Entry, result: Calibration) -> str:
    """Say what a result was made of, and its verdict."""
    parts = next(parts for found, parts in folder.of_result if found is entry)
    of = [
        _name(folder, part)
        for part in parts
        if not (isinstance(part.content, Urdf) and part.content.run)
    ]
    made = (
        f" of {listed(of)}" if of else f" of {result.nominal.urdf.source} and {result.source.name}"
    )
    verdict = result.verdict
    return f"result{made}" + (f"; verdict: {verdict.use}" if verdict is not None else "")
