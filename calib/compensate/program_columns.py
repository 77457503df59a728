"""Which column of a program's table is what: joint values, positions, orientations, and what goes along unread."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from calib.errors import MeasurementError, choices
from calib.measure.columns import (
    POINT,
    QUATERNION,
    ROTATION_VECTOR,
    Column,
    close_names,
    list_columns,
    name_columns,
    reserved,
    with_unit,
)
from calib.measure.layout import Layout
from calib.measure.table import Table
from calib.model.robot import Robot
from calib.units import Quantity, Unit, split_header

#: Angles about fixed axes, as in a URDF: R = Rz(yaw) Ry(pitch) Rx(roll).
ROLL_PITCH_YAW = ("roll", "pitch", "yaw")

#: The forms of an orientation, and what a message calls them.
FORMS = {
    ROTATION_VECTOR: "a rotation vector",
    QUATERNION: "a quaternion",
    ROLL_PITCH_YAW: "roll, pitch and yaw",
}

#: What stands before the names of columns that say what was changed, in a table of commands.
CORRECTION = "correction "

#: The column of a table of commands that says whether a row has one.
STATUS = "status"

#: What a program may be where a table has both.
GIVEN = ("joints", "poses")

# The numbers of a quaternion have no unit; the reader of columns wants one.
_NO_UNIT = Unit("", "angle", 1.0)
_WITHOUT_UNIT = (None, "", "-", "1")


@dataclass(frozen=True, slots=True)
class ProgramColumns:
    """Which column of a table is what.

    Attributes:
        joints: The robot's joints in its order, or none.
        points: x, y, z, or none.
        orientation: Three or four columns, or none.
        form: Which of `FORMS` they are; empty for none.
        row: The column with the rows' own names, if there is one.
        kept: Where the columns stand that go into the commands, and their headers.
    """

    joints: tuple[Column, ...]
    points: tuple[Column, ...]
    orientation: tuple[Column, ...]
    form: tuple[str, ...]
    row: Column | None
    kept: tuple[tuple[int, str], ...]

    @classmethod
    def of(
        cls, table: Table, robot: Robot, columns: Mapping[str, str], given: str | None
    ) -> ProgramColumns:
        """Find them, and refuse what is not complete.

        Raises:
            MeasurementError: A column is missing, there twice, without a unit, or the table holds commands already.
        """
        names = robot.joint_names
        named = _named(table, robot, columns)
        _refuse_commands(table, named, given, robot)
        empty = _empty_columns(table)
        points = _complete(table, named, POINT, names, "a position")
        if points and all(column.index in empty for column in points):
            points = ()  # a plan of poses: what is to be measured there is not known yet
        forms = [form for form, what in FORMS.items() if _complete(table, named, form, names, what)]
        forms = [form for form in forms if not {named[name].index for name in form} <= empty]
        joints = _joints(table, named, robot)
        _check_wanted(table, joints, points, forms, robot, given)
        _check_forms(table, forms)
        form = forms[0] if forms and points else ()
        used = {c.index for c in joints}
        used |= {named[n].index for n in (*POINT, *_all_forms()) if n in named and n not in names}
        if given == "joints":
            points, form = (), ()
        return cls(
            joints=tuple(_in_unit(table, c, robot) for c in joints),
            points=tuple(with_unit(table, c, "length") for c in points),
            orientation=_orientation(table, [named[name] for name in form], form),
            form=form,
            row=named.get("row"),
            kept=_kept(table, named, used, empty, robot),
        )

    def layout(self) -> Layout:
        """The same as a layout of measurements.

        Quaternions, and angles that are no rotation vector, are read as joint values are.
        """
        vector = self.form == ROTATION_VECTOR
        return Layout(
            words={},
            groups=(),
            blocks={
                "joints": (*self.joints, *(() if vector else self.orientation)),
                "torques": (),
                "points": self.points,
                "orientation": self.orientation if vector else (),
                "distance": (),
                "sigma": (),
                "sigma_angle": (),
            },
            kinds=(("pose" if vector else "point") if self.points else "fixed",),
            ignored=(),
        )


def _all_forms() -> tuple[str, ...]:
    """The names of all columns of orientations."""
    return tuple(name for form in FORMS for name in form)


def _named(table: Table, robot: Robot, columns: Mapping[str, str]) -> dict[str, Column]:
    """The columns by the name calib uses; those of roll, pitch and yaw in small or capital letters too."""
    clash = [name for name in robot.joint_names if name in reserved()]
    if clash:
        raise MeasurementError(
            f"{table.source}: a joint cannot be called {choices(clash)}, which is the name of another column of the "
            "table. Rename the joint in the URDF."
        )
    named, _ = name_columns(table, robot.joint_names, columns)
    result: dict[str, Column] = {}
    for name, column in named.items():
        plain = name.casefold()
        own = plain in (*ROLL_PITCH_YAW, STATUS) and name not in robot.joint_names
        final = plain if own else name
        if final in result:
            raise MeasurementError(
                f"{table.source}: two columns are called '{final}': '{result[final].label}' and '{column.label}'. "
                f'Remove or rename one, or leave one out: --columns "{column.label}=-".'
            )
        result[final] = replace(column, name=final)
    return result


def _refuse_commands(
    table: Table, named: Mapping[str, Column], given: str | None, robot: Robot
) -> None:
    """Refuse a table of commands unless it was said which of its columns is the program: it is corrected already."""
    if given is None and any(_is_correction(name, robot) for name in named):
        raise MeasurementError(
            f"{table.source}: these are commands that calib compensate wrote: they are corrected already. Give the "
            "program that they were made from; or --given joints or --given poses, if these are to be corrected once "
            "more."
        )


def _is_correction(name: str, robot: Robot) -> bool:
    """Whether a column is one that a table of commands has."""
    return name in (
        f"{CORRECTION}position",
        f"{CORRECTION}angle",
        *(CORRECTION + joint for joint in robot.joint_names),
    )


def _empty_columns(table: Table) -> set[int]:
    """Where columns stand that are empty in all rows."""
    filled: set[int] = set()
    for row in table.rows():
        filled |= {i for i, cell in enumerate(row.cells) if cell}
        if len(filled) >= len(table.header):
            break
    return set(range(len(table.header))) - filled if filled else set()


def _complete(
    table: Table,
    named: Mapping[str, Column],
    names: Sequence[str],
    joints: Sequence[str],
    what: str,
) -> tuple[Column, ...]:
    """The columns of these names, all of them or none.

    Raises:
        MeasurementError: Some of them are there. Without the others they would be left out of what is wanted.
    """
    there = [name for name in names if name in named and name not in joints]
    if there and len(there) < len(names):
        missing = [name for name in names if name not in there]
        left_out = " ".join(f'--columns "{split_header(named[n].label)[0]}=-"' for n in there)
        raise MeasurementError(
            f"{table.source}: {what} has the columns {', '.join(names)}; {choices(missing)} "
            f"{'is' if len(missing) == 1 else 'are'} missing. {list_columns(table)} Map another name with --columns "
            f'"name in the table={missing[0]}", or leave out what is there with {left_out}.'
        )
    return tuple(named[name] for name in there)


def _joints(table: Table, named: Mapping[str, Column], robot: Robot) -> tuple[Column, ...]:
    """The columns of the robot's joints, all of them or none."""
    names = robot.joint_names
    missing = [name for name in names if name not in named]
    if len(missing) == len(names):
        return ()
    if missing:
        free = [name for name in named if name not in names]
        close = dict.fromkeys(hit for name in missing for hit in close_names(name, free)[:1])
        hint = f" Close to them: {choices(close)}." if close else ""
        first = f"{missing[0]} [{'mm' if robot.joint_types[missing[0]] == 'prismatic' else 'deg'}]"
        raise MeasurementError(
            f"{table.source}: no column for the joints {choices(missing)}, while there are some for "
            f"{choices(name for name in names if name in named)}. {list_columns(table)}{hint} Another name is mapped "
            f'by --columns "name in the table={first}"; a joint that stands still is given with --hold.'
        )
    return tuple(named[name] for name in names)


def _check_wanted(
    table: Table,
    joints: Sequence[Column],
    points: Sequence[Column],
    forms: Sequence[tuple[str, ...]],
    robot: Robot,
    given: str | None,
) -> None:
    """Refuse a table that does not say what is wanted, or not in the way that was named."""
    first = f"'{robot.joint_names[0]} [deg]'" if robot.joint_names else "the joint's name"
    if forms and not points and (given == "poses" or not joints):
        raise MeasurementError(
            f"{table.source}: there is an orientation but no position: the columns 'x [mm]', 'y [mm]', 'z [mm]' are "
            f"missing or empty. {list_columns(table)}"
        )
    if not joints and not points:
        raise MeasurementError(
            f"{table.source}: there are neither joint values nor positions. {list_columns(table)} A program has a "
            f"column for each joint, such as {first}, or 'x [mm]', 'y [mm]', 'z [mm]' and an orientation; another name "
            'is mapped by --columns "name in the table=x [mm]".'
        )
    if (given == "joints" and not joints) or (given == "poses" and not points):
        wanted = (
            f"joint values, such as {first}"
            if given == "joints"
            else "positions, 'x [mm]', 'y [mm]', 'z [mm]'"
        )
        raise MeasurementError(
            f"{table.source}: --given {given}, and there are no columns of {wanted}, or all their cells are empty. "
            f"{list_columns(table)} Leave out --given, or map the columns with --columns."
        )


def _check_forms(table: Table, forms: Sequence[tuple[str, ...]]) -> None:
    """Refuse an orientation in two forms: they may differ."""
    if len(forms) > 1:
        said = " and as ".join(f"{FORMS[form]} ({', '.join(form)})" for form in forms)
        raise MeasurementError(
            f"{table.source}: the orientation is there twice, as {said}. Leave one out: --columns "
            f'"{forms[1][0]}=-" and so on.'
        )


def _in_unit(table: Table, column: Column, robot: Robot) -> Column:
    """A joint's column, in a unit that its joint can have."""
    kind = robot.joint_types[column.name]
    quantity: Quantity = "length" if kind == "prismatic" else "angle"
    return with_unit(table, column, quantity, f"{kind} joint '{column.name}'")


def _orientation(
    table: Table, columns: Sequence[Column], form: tuple[str, ...]
) -> tuple[Column, ...]:
    """The columns of an orientation, in a unit of angle, or without one."""
    if form != QUATERNION:
        common = "rad" if form == ROTATION_VECTOR else "deg"
        return tuple(with_unit(table, c, "angle", FORMS[form], common) for c in columns)
    for column in columns:
        unit = column.unit.symbol if column.unit else split_header(column.label)[1]
        if unit not in _WITHOUT_UNIT:
            raise MeasurementError(
                f"{table.source}, column '{column.label}': '{unit}' cannot be; a quaternion has no unit. Correct the "
                f"header to '{column.name}'; for angles, to 'rx [deg]' (a rotation vector) or 'roll [deg]' and so on."
            )
    return tuple(replace(column, unit=_NO_UNIT) for column in columns)


def _kept(
    table: Table, named: Mapping[str, Column], used: set[int], empty: set[int], robot: Robot
) -> tuple[tuple[int, str], ...]:
    """The columns that go along: those of no meaning here, but for what a table of commands holds anew."""
    there = {column.index for column in named.values()}
    old = {c.index for n, c in named.items() if n == STATUS or _is_correction(n, robot)}
    return tuple(
        (i, label)
        for i, label in enumerate(table.header)
        # A column without a name is kept if anything stands in it: separators at the end of each line are none.
        if (i in there - used - old) or (not label and i not in empty)
    )
