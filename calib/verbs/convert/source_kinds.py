"""Kinds of source of a conversion: results, controllers' files, origins files and robots, one row of a registry each.

What can be read is a row of `KINDS`: the files' endings, the key of a YAML file, and the function that reads it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from calib.basics.files import read_bytes
from calib.basics.json_files import parsed_json
from calib.data.inputs import RobotInput, chain_of
from calib.errors import CalibError, FileError, ModelError, choices
from calib.result.calibration import Calibration
from calib.result.calibration_file import read_result
from calib.robot.dh.file import ENDINGS as DH_ENDINGS, TABLES
from calib.robot.dh.rows import EQUATIONS
from calib.robot.generated.universal_robots import UrModel, ur_model
from calib.robot.robot import Robot
from calib.robot.xacro_file import is_xacro
from calib.verbs.compensate.nominal_actual import check_same_joints, is_corrected
from calib.verbs.convert.notes import Note
from calib.verbs.convert.origins import origins_of, parse_yaml, read_origins, with_origins
from calib.verbs.convert.source import Options, Source
from calib.verbs.convert.universal_robots import read_ur
from calib.verbs.convert.ur_arms import ur_robot
from calib.verbs.convert.ur_mount import Mount, the_mount

#: Endings of YAML files.
YAML = (".yaml", ".yml")


class SourceKind(NamedTuple):
    """A kind of source."""

    #: Endings of its files; ``""`` of the name of a robot.
    endings: tuple[str, ...]
    #: The key by which a YAML file is recognised; empty: by its ending alone.
    key: str
    #: Reads a file, or the name of a robot.
    read: Callable[[str, Options], Source]


def source_kind(source: str) -> str:
    """Return the kind of a source, by its ending, and of a YAML file by its keys.

    Args:
        source: A file, or the name of a robot.

    Returns:
        The name of a row of `KINDS`.

    Raises:
        FileError: It is none of them, or a YAML file cannot be read.
    """
    ending = "" if is_xacro(source) else Path(source).suffix.lower()
    keys: tuple[str, ...] = ()
    if ending == ".json":
        keys = _keys_of_json(source)
    elif ending in TABLES:
        keys = ("equation",)
    elif ending in YAML:
        keys = tuple(map(str, parse_yaml(read_bytes(source, "YAML file"), source, "YAML file")))
    for name, kind in KINDS.items():
        if ending in kind.endings and (not kind.key or kind.key in keys):
            return name
    raise FileError(
        f"{source}: neither its ending nor a key says what it is. Give a calibration.conf or a "
        "kinematics.yaml of Universal Robots, a result (.json), an origins file (.yaml), DH rows (.csv, .json), a "
        "URDF, a xacro, or the name of a robot such as 'ur3'."
    )


def _keys_of_json(source: str) -> tuple[str, ...]:
    """Return the keys of a JSON file; none of a file that is none, of which its reader says so."""
    try:
        table = parsed_json(read_bytes(source, "JSON file"), source)
    except FileError:
        return ()
    return tuple(map(str, table)) if isinstance(table, dict) else ()


# Readers


def _universal_robots(source: str, options: Options) -> Source:
    """Read a calibration.conf or a kinematics.yaml, on the given nominal robot or on a bare one."""
    given = None if options.robot is None else options.load(options.robot)
    result = read_ur(source, urcontrol=options.urcontrol, model=options.ur_model, robot=given)
    has_chain = options.base or options.tip or options.held
    if given is not None or not has_chain:
        return result
    robot = _on_chain(result.robot, options)
    nominal = _on_chain(result.nominal or result.robot, options)
    return replace(result, robot=robot, nominal=nominal)


def _on_chain(robot: Robot, options: Options) -> Robot:
    """Return a robot between the links of the options, where they are given."""
    base = options.base or robot.base
    tip = options.tip or robot.tip
    return Robot.from_urdf(robot.urdf, base, tip, held=options.held, coupling=options.coupling)


def _result(source: str, options: Options) -> Source:
    """Read the file of a result, see `result_source`."""
    return result_source(read_result(source), options, source)


def result_source(result: Calibration, options: Options, name: str) -> Source:
    """Return a result as a source, on the given robot, nominal or corrected, or on the URDF that it holds.

    Args:
        result: The result.
        options: What goes with the conversion.
        name: What messages call the result.

    Raises:
        CalibError: The options name another chain.
    """
    nominal = result.nominal
    robot = result.robot
    links = (options.base or nominal.base, options.tip or nominal.tip)
    has_other_links = links != (nominal.base, nominal.tip)
    has_other_held = options.held and options.held != nominal.held
    if has_other_links or has_other_held:
        raise CalibError(
            f"{name} holds base, tip and held joints; leave out --base, --tip and --hold."
        )
    if options.robot is not None:
        chain = chain_of(nominal)
        chain_of_result = replace(
            options, base=chain.base, tip=chain.tip, held=chain.held, coupling=chain.coupling
        )
        arm = chain_of_result.load(options.robot)
        if is_corrected(result, arm):
            nominal, robot = result.uncorrected(arm), arm
        else:
            nominal, robot = arm, result.corrected(arm)
    notes: tuple[Note, ...] = ()
    if result.non_geometric is not None:
        notes = (Note("geometry alone", (result.non_geometric.name,)),)
    model = _arm(nominal, options)
    return Source(
        "result",
        robot,
        nominal,
        model=model,
        notes=notes,
        verdict=result.verdict,
        calibration=result,
    )


def _origins(source: str, options: Options) -> Source:
    """Read an origins file, on the given robot."""
    origins = read_origins(source)
    if options.robot is None:
        raise CalibError(
            f"{source} has the origins of joints alone; give the URDF that they belong to as "
            "--robot."
        )
    nominal = options.load(options.robot)
    robot = with_origins(nominal, origins)
    missing = [name for name in origins_of(robot) if name not in origins]
    notes = (Note("joints without origin", (choices(missing),)),) if missing else ()
    return Source("origins", robot, nominal, model=_arm(nominal, options), notes=notes)


def _rows(source: str, options: Options) -> Source:
    """Read a file of DH rows: the robot is their nominal one, and theirs is the convention that it goes back in."""
    result = robot_source(source, options)
    rows = result.robot.urdf.dh
    if rows is None:
        return result
    convention = rows.table.convention
    note = Note("rows read", (f"{len(rows.table.rows)}", convention, EQUATIONS[convention]))
    return replace(result, kind="rows", notes=(note,))


def _robot(source: str, options: Options) -> Source:
    """Read a URDF, a xacro or the name of a robot, see `robot_source`."""
    return robot_source(source, options)


def robot_source(given: RobotInput, options: Options) -> Source:
    """Return a robot, or what its URDF, xacro or name means, as a source beside the given nominal one.

    Args:
        given: The robot, the path of its file, or its name.
        options: The nominal robot, base and tip, and the arm of Universal Robots, where they are given.
    """
    robot = options.load(given)
    nominal = _nominal_of(robot, options)
    model = None if nominal is None else _arm(nominal, options)
    return Source("robot", robot, nominal, model=model)


def _nominal_of(robot: Robot, options: Options) -> Robot | None:
    """Return the nominal robot of one that was read; None if it is not known."""
    if options.robot is not None:
        nominal = replace(options, base=robot.base, tip=robot.tip).load(options.robot)
        check_same_joints(robot, nominal)
        return nominal
    mount = _mount(robot)
    if mount is not None and mount.nominal:
        return robot  # an arm with the kinematics of the data sheet is its own nominal robot
    if options.ur_model is not None:
        return ur_robot(options.ur_model).rebuilt(base=robot.base, tip=robot.tip)
    return None


def _arm(nominal: Robot, options: Options) -> UrModel | None:
    """Return the arm of Universal Robots that a nominal robot is; None if it is of another maker.

    Raises:
        ModelError: It is not the arm that the options name.
    """
    if options.ur_model is not None:
        return the_mount(nominal, ur_model(options.ur_model)).model
    mount = _mount(nominal)
    return None if mount is None else mount.model


def _mount(robot: Robot) -> Mount | None:
    """Return how a robot is mounted as an arm of Universal Robots; None of another maker."""
    try:
        return the_mount(robot)
    except ModelError:
        return None


KINDS: Mapping[str, SourceKind] = {
    "ur-conf": SourceKind((".conf",), "", _universal_robots),
    "ur-yaml": SourceKind(YAML, "kinematics", _universal_robots),
    "rows": SourceKind(DH_ENDINGS, "equation", _rows),
    "result": SourceKind((".json",), "", _result),
    "origins": SourceKind(YAML, "origins", _origins),
    "robot": SourceKind(("", ".urdf", ".xml"), "", _robot),
}
"""What can be read, by name."""
