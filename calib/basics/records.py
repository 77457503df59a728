"""Records: dataclasses whose fields say in one place how they are written, checked, given by an option, and explained.

A field says with `key` what its key in a file is called (its unit is in the name), in which `Form` its value stands
there, and what it means; further its default, a check of the value in memory, and the option of the command line that
gives it:

    @dataclass(frozen=True, slots=True)
    class Instrument:
        position: Array = key("xyz_mm", POINT_MM, "Centre of rotation of the beam.")
        farthest: float = key("farthest_mm", MM, "Largest distance that it measures.", default=80.0)

Everything else is made from the fields: `read_values` and `read_record` read tables of TOML and JSON, `toml_lines` and
`given_values` write them, `keep_checked` is the body of ``__post_init__``, `options` and `changes` serve the command
line, and `key_rows` the tables of the documentation. So a new key is a new field, and nothing else.

A field may have several keys, which a registry may name (`keys`: one prior for each family), and two fields may share
a key.

cattrs and msgspec were tried. They rename keys and convert values, which is 40 lines here. They have no keys that a
registry names, no options and no tables, and their messages ("invalid value for type, expected float @ $.nearest") lack
the key as the file has it, what was given, and what is allowed.
"""

from __future__ import annotations

import dataclasses
import json as json_text
import re
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, replace
from functools import cache
from types import UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from calib.basics.arguments import check_mapping, check_type, wrong_type
from calib.basics.value_forms import TABLE, Check, Form, Place, checked, list_of
from calib.basics.values import ReadOnlyMapping
from calib.errors import CalibError, choices, did_you_mean

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

T = TypeVar("T")
Label = TypeVar("Label")

#: Name of the entry in the metadata of a field.
_METADATA = "calib"

#: A key that TOML takes without quotes.
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


# Fields with their keys and options


@dataclass(frozen=True, slots=True)
class Option:
    """An option of the command line that gives a field, over what a file says of it."""

    #: ``"--target"``.
    flag: str
    #: Verbs take options by groups, such as ``"fit"``; empty: every verb that reads the record takes it.
    group: str = ""
    #: Stands for the value in the help: ``'"X Y Z UNIT"'``.
    metavar: str | None = None
    #: Type of the words: a text, a path, a list of texts, a truth value; or the words that are allowed.
    type: Any = str
    #: Least value of a whole number; None: any.
    least: int | None = None
    #: Help; empty: that of the key, with what counts without it.
    help: str = ""
    #: (what was typed, flag) to the value in SI units; None: it is read as the file's value of the key.
    parse: Callable[[Any, str], Any] | None = None
    #: (the value so far, the parsed one) to the new value of the field; None: the parsed one.
    merge: Callable[[Any, Any], Any] | None = None

    @property
    def name(self) -> str:
        """The flag as a name of Python: ``"fix_target"``."""
        return self.flag.lstrip("-").replace("-", "_")


def add_entries(of_file: Any, given: Any) -> Any:  # noqa: ANN401  two mappings, or two tuples
    """Return the entries of a file with those of an option added; the option's count if both have a name."""
    return {**of_file, **given} if isinstance(given, Mapping) else (*of_file, *given)


@dataclass(frozen=True, slots=True)
class Key:
    """A key of a table, which gives a field or a part of it."""

    #: The key in the file, with its unit: ``"target_mm"``.
    name: str
    form: Form
    #: Its meaning, in full sentences; empty: another field that shares the key states it.
    help: str
    #: The value that counts without the key, in words; empty: the default of the field.
    absent: str = ""
    options: tuple[Option, ...] = ()
    #: Of a field with several keys: the argument that it gives.
    part: str = ""
    #: True if a table must have it.
    needed: bool = False
    #: From the record to what the file holds, of a key that gives several fields; None: it gives one.
    of_record: Callable[[Any], Any] | None = None


@dataclass(frozen=True, slots=True)
class _Written:
    """The entry in the metadata of a field: how it is written, and checked in memory."""

    #: Gives the keys; a registry may have grown since the class was made.
    make: Callable[[], Sequence[Key]]
    #: Makes the value of the values of several keys, by their parts; None: there is one key.
    join: Callable[..., Any] | None
    check: Check | None
    each: Check | None = None
    json: str = ""
    #: From the value to the entries of a file by their keys, if there are several; None: it cannot be written.
    write: Callable[[Any], Mapping[str, Any]] | None = None


def key(
    name: str,
    form: Form,
    help: str,
    *,
    default: Any = MISSING,  # noqa: ANN401
    default_factory: Any = MISSING,  # noqa: ANN401
    absent: str = "",
    option: Option | Sequence[Option] = (),
    check: Check | None = None,
    each: Check | None = None,
    json: str = "",
    of_record: Callable[[Any], Any] | None = None,
) -> Any:  # noqa: ANN401  a field
    """Return a field of a record that one key gives.

    Args:
        name: The key, with its unit: ``"target_mm"``.
        form: The form of its value.
        help: What it means, in full sentences; for the documentation, the options, and comments in files.
        default: Its default in memory, in SI units. Without one, and without ``default_factory``, the key is needed.
        default_factory: Makes the default.
        absent: What counts without the key, in words; empty: the default, as a file has it.
        option: The option, or options, that give the field too.
        check: Check of the value in memory, in place of that of its type; None: that of its type.
        each: Check of each entry of a mapping or a tuple in memory; None: that of its type alone.
        json: Key of the value in SI units in result files; empty: the name of the field.
        of_record: Gives what a file holds from the record, if two fields share the key; said at the first of them.
    """
    options = (option,) if isinstance(option, Option) else tuple(option)
    single = Key(name, form, help, absent, options, of_record=of_record)
    metadata = {_METADATA: _Written(lambda: (single,), None, check, each, json)}
    return dataclasses.field(default=default, default_factory=default_factory, metadata=metadata)


def keys(
    make: Callable[[], Sequence[Key]],
    join: Callable[..., Any],
    *,
    default: Any = MISSING,  # noqa: ANN401
    default_factory: Any = MISSING,  # noqa: ANN401
    check: Check | None = None,
    write: Callable[[Any], Mapping[str, Any]] | None = None,
) -> Any:  # noqa: ANN401  a field
    """Return a field of a record that several keys give.

    Args:
        make: Gives the keys.
        join: Makes the value, from the values of the keys that are there, by their parts.
        default: Default in memory, and so on as of `key`.
        default_factory: Makes the default.
        check: Check of the value in memory; None: that of its type.
        write: Gives the entries of a file by their keys from the value, see `written_parts`; None: it is not written.
    """
    metadata = {_METADATA: _Written(make, join, check, write=write)}
    return dataclasses.field(default=default, default_factory=default_factory, metadata=metadata)


def embedded(kind: type, *, default_factory: Any = MISSING) -> Any:  # noqa: ANN401
    """Return a field that is another record, whose keys stand beside those of the record that has the field."""

    def make() -> Sequence[Key]:
        return [replace(row, part=field.name) for field, row in keys_of(kind)]

    return keys(make, kind, default_factory=default_factory, write=given_values)


def keys_of(kind: type) -> list[tuple[Field[Any], Key]]:
    """Return the keys of a record in the order of its fields, each with the field that it gives."""
    result = []
    for field, written in _written_fields(kind):
        has_default = field.default is not MISSING or field.default_factory is not MISSING
        for row in written.make():
            needed = row.needed or not (has_default or written.join)
            result.append((field, replace(row, needed=needed)))
    return result


def _written_fields(kind: Any) -> Iterator[tuple[Field[Any], _Written]]:  # noqa: ANN401  a dataclass
    """Yield the fields of a record that say how they are written."""
    for field in dataclasses.fields(kind):
        if _METADATA in field.metadata:
            yield field, field.metadata[_METADATA]


# Files


class UnknownKeyError(CalibError):
    """A table has a key that its record does not have."""

    def __init__(self, name: str, place: Place, known: Collection[str]) -> None:
        likely = did_you_mean(name, known)
        super().__init__(f"{place}: unknown key{likely}. It may be one of {choices(known, 40)}.")
        self.name = name
        self.place = place


def read_values(
    kind: type, table: Mapping[str, Any], place: Place | None = None, besides: Sequence[Key] = ()
) -> dict[str, Any]:
    """Read the values of a record's fields from a table.

    Args:
        kind: The record.
        table: The table, by its keys.
        place: Where it stands; None: it is the outermost one of a file.
        besides: Keys that the table may have and that are not read here.

    Returns:
        The values in SI units by the names of the fields, without those that the table does not give.

    Raises:
        CalibError: A key is unknown or missing, or a value is of the wrong form.
    """
    rows = [((field.name, row.part), row) for field, row in keys_of(kind)]
    joins = {field.name: written.join for field, written in _written_fields(kind)}
    values: dict[str, Any] = {}
    parts: dict[str, dict[str, Any]] = {}
    for (name, part), value in _read_rows(rows, table, place or Place(), besides).items():
        if joins[name] is None:
            values[name] = value
        else:
            parts.setdefault(name, {})[part] = value
    for name, of_field in parts.items():
        join = joins[name]
        assert join is not None
        values[name] = join(**of_field)
    return values


def read_parts(
    rows: Iterable[Key], table: Mapping[str, Any], place: Place | None = None
) -> dict[str, Any]:
    """Read the values of keys from a table in SI units, by the keys' parts; CalibError as of `read_values`."""
    return _read_rows([(row.part, row) for row in rows], table, place or Place())


def _read_rows(
    rows: Sequence[tuple[Label, Key]],
    table: Mapping[str, Any],
    place: Place,
    besides: Sequence[Key] = (),
) -> dict[Label, Any]:
    """Read a table by its keys: return their values in SI units by the label of each key; CalibError for a fault."""
    by_key: dict[str, list[tuple[Label, Key]]] = {row.name: [] for row in besides}
    for label, row in rows:
        by_key.setdefault(row.name, []).append((label, row))
    unknown = [name for name in table if name not in by_key]
    if unknown:
        raise UnknownKeyError(unknown[0], place.key(unknown[0]), by_key)
    values = {}
    try:
        for name, given in table.items():
            for label, row in by_key[name]:
                values[label] = row.form.read(given, place.key(name))
    except UnknownKeyError as error:
        if place.heading or error.name not in by_key:
            raise
        raise CalibError(
            f"{error.place}: this key is not of that table; write it at the top of the file, before the first table."
        ) from error
    missing = [row.name for _, row in rows if row.needed and row.name not in table]
    if missing:
        raise CalibError(f"{place.heading or 'The file'} lacks {choices(missing)}.")
    return values


def read_record(kind: type[T], table: Mapping[str, Any], place: Place | None = None) -> T:
    """Read a record from a table, see `read_values`."""
    return kind(**read_values(kind, table, place))


def table_of(kind: type) -> Form:
    """Return the form of a table with the keys of a record."""

    def read(value: Any, place: Place) -> Any:  # noqa: ANN401
        return read_record(kind, TABLE.read(value, place), place)

    return Form("a table", read, given_values)


def tables_of(kind: type, heading: str) -> Form:
    """Return the form of tables with the keys of a record, each headed ``[[heading]]``."""
    head = f"[[{heading}]]"
    return list_of(table_of(kind), f"a list of tables, each headed {head}", head)


def parse_toml(text: str) -> dict[str, Any]:
    """Return the tables of a TOML text; ValueError if it is not TOML."""
    try:
        table: dict[str, Any] = tomllib.loads(text)
    except RecursionError as error:
        raise ValueError("its tables are nested too deeply") from error
    return table


def toml_values(value: Any) -> dict[str, Any]:  # noqa: ANN401  any record
    """Return the table of a record by its keys, without values that are None; fields of several keys are left out."""
    result = {}
    for field, written in _written_fields(value):
        given = getattr(value, field.name)
        if written.join is None and given is not None:
            (row,) = written.make()
            result[row.name] = row.form.write(given)
    return result


def given_values(value: Any) -> dict[str, Any]:  # noqa: ANN401  any record
    """Return the table of a record by its keys, with all that differs from the defaults: it is read back as the record.

    Fields of several keys are left out if they do not say how they are written.
    """
    rows = [(field, written, written.make()) for field, written in _written_fields(value)]
    changed = {
        row.name
        for field, _, of_field in rows
        if not _is_default(field, getattr(value, field.name))
        for row in of_field
    }
    result: dict[str, Any] = {}
    for field, written, of_field in rows:
        given = getattr(value, field.name)
        if given is None or not changed & {row.name for row in of_field}:
            continue
        if written.join is not None:
            result.update({} if written.write is None else written.write(given))
            continue
        (row,) = of_field
        if row.name not in result:
            write = row.form.write if row.of_record is None else row.of_record
            result[row.name] = write(given if row.of_record is None else value)
    return result


def _is_default(field: Field[Any], given: Any) -> bool:  # noqa: ANN401
    """Return True if a field has its default."""
    default = field.default
    if field.default_factory is not MISSING:
        default = field.default_factory()
    return default is not MISSING and bool(np.array_equal(given, default))


def written_parts(rows: Iterable[Key], parts: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entries of a file by their keys, from values in SI units by the keys' parts, as far as given."""
    return {row.name: row.form.write(parts[row.part]) for row in rows if row.part in parts}


def toml_text(table: Mapping[str, Any], heading: str = "") -> str:
    """Return a table as a text of TOML: its values first, then its tables under their headings.

    Args:
        table: Texts, numbers, truth values, lists of them, tables, and lists of tables, by their keys.
        heading: The keys of the table in the file, joined by points; empty: the outermost one.
    """
    lines, blocks = [], []
    for name, given in table.items():
        path = ".".join(filter(None, [heading, _toml_key(name)]))
        if isinstance(given, Mapping):
            inside = toml_text(given, path)
            # A heading of tables alone says nothing.
            has_own = not inside.startswith("\n")
            blocks.append(f"\n[{path}]\n{inside}" if has_own else inside)
        elif isinstance(given, list | tuple) and given and isinstance(given[0], Mapping):
            blocks += [f"\n[[{path}]]\n{toml_text(entry, path)}" for entry in given]
        else:
            lines.append(f"{_toml_key(name)} = {toml(given)}\n")
    return "".join([*lines, *blocks])


def _toml_key(name: str) -> str:
    """Return a key as TOML has it, in quotes if it has signs."""
    return name if _BARE_KEY.fullmatch(name) else toml(name)


def toml_lines(value: Any, *, without: Collection[str] = ()) -> list[str]:  # noqa: ANN401  any record
    """Return a record as lines of TOML, each key under a comment that explains it, its value in the unit of the file.

    Fields that are None are left out, and so are fields that several keys give.

    Args:
        value: The record.
        without: Keys that are left out too.
    """
    helps = {row.name: row.help for _, row in keys_of(type(value))}
    lines = []
    for name, given in toml_values(value).items():
        if name not in without:
            lines += [f"# {helps[name]}", f"{name} = {toml(given)}"]
    return lines


def toml(value: Any) -> str:  # noqa: ANN401
    """Write a text, a truth value, a number, or a list of such values, as TOML."""
    if isinstance(value, bool | str):
        return json_text.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(toml, value))}]"
    return repr(value)


def json_key(field: Field[Any]) -> str:
    """Return the key of a field in result files: as its record says, or else its name."""
    written: _Written | None = field.metadata.get(_METADATA)
    return written.json if written is not None and written.json else field.name


# Values in memory


def keep_checked(value: Any, name: str) -> None:  # noqa: ANN401  any record
    """Check the fields of a record that is being made, and keep what their checks give; for ``__post_init__``.

    Without a check of its own, a truth value, a text or a record must be of the type of its field; a mapping becomes
    read-only and a sequence a tuple, their entries checked one by one. None is allowed if the type allows it.

    Args:
        value: The record.
        name: What messages call it: ``"cell"``.

    Raises:
        ArgumentError: A value is of another type.
        CalibError: A check refuses it.
    """
    types = _field_types(value.__class__)
    for field, written in _written_fields(value):
        kind, is_optional = types[field.name]
        given = getattr(value, field.name)
        if given is not None or not is_optional:
            what = f"a {name}'s {field.name}"
            kept = _checked_field(
                given, kind, written, field.name, what, ", or None" if is_optional else ""
            )
            object.__setattr__(value, field.name, kept)


@cache
def _field_types(kind: Any) -> Mapping[str, tuple[Any, bool]]:  # noqa: ANN401  a class
    """Return by name the type of each field, without None, and whether it may be None."""
    result = {}
    for name, hint in get_type_hints(kind).items():
        is_optional = get_origin(hint) in (Union, UnionType) and type(None) in get_args(hint)
        result[name] = (get_args(hint)[0] if is_optional else hint, is_optional)
    return result


def _checked_field(
    given: Any,  # noqa: ANN401
    kind: Any,  # noqa: ANN401
    written: _Written,
    argument: str,
    what: str,
    or_none: str,
) -> Any:  # noqa: ANN401
    """Check a field's value: return it as it is kept, a mapping read-only and a sequence as a tuple.

    Raises `ArgumentError` for another type, and CalibError if a check refuses it. ``argument`` and ``what`` name the
    field, and ``or_none`` ends the description of what is allowed, in messages.
    """
    if written.check is not None:
        return _checked(given, what, written.check)
    if get_origin(kind) is Mapping:
        check_mapping(argument, given)
        kept = {}
        for name, entry in given.items():
            _check_class(argument, entry, get_args(kind)[1], written, "a mapping, each value {}")
            kept[name] = _checked(entry, f"'{name}' in {what}", written.each)
        return ReadOnlyMapping(kept)
    if get_origin(kind) is tuple:
        of_entry = get_args(kind)[0]
        if isinstance(given, str) or not isinstance(given, Sequence):
            raise wrong_type(argument, given, f"a sequence, each entry {_words(of_entry, written)}")
        for entry in given:
            _check_class(argument, entry, of_entry, written, "a sequence, each entry {}")
        return tuple(_checked(entry, what, written.each) for entry in given)
    _check_class(argument, given, kind, written, f"{{}}{or_none}")
    return given


def _checked(value: Any, what: str, check: Check | None) -> Any:  # noqa: ANN401
    """Return a value as its check keeps it, or unchanged without one; CalibError if it refuses the value."""
    if check is None:
        return value
    return checked(value, what[0].upper() + what[1:], check.must, check.convert)


def _check_class(
    argument: str,
    given: object,
    kind: Any,  # noqa: ANN401
    written: _Written,
    allowed: str,
) -> None:
    """Refuse a value of another class than ``kind`` by `ArgumentError`, if that is a truth value, a text or a record.

    Values of other types pass. ``allowed`` is the message's text on what is allowed, with {} for the type in words.
    """
    if kind in (bool, str) or dataclasses.is_dataclass(kind):
        classes = (bool, np.bool_) if kind is bool else kind
        check_type(argument, given, classes, allowed.format(_words(kind, written)))


def _words(kind: Any, written: _Written) -> str:  # noqa: ANN401
    """Return the description of a value of a type for messages: ``"True or False"``."""
    if kind is bool:
        return "True or False"
    if kind is str:
        return next((row.form.meaning for row in written.make() if row.form.meaning), "a text")
    return f"of the class {kind.__name__}"


# The command line, and the documentation


def options(kind: type, groups: Collection[str] = ()) -> Iterator[Option]:
    """Yield the options of a record's fields with their help: those of all verbs, and those of some groups.

    An option that gives two fields is yielded once.
    """
    yielded = set()
    for _, row in keys_of(kind):
        for option in row.options:
            if option.flag in yielded or (option.group and option.group not in groups):
                continue
            yielded.add(option.flag)
            help_text = option.help or row.help
            if row.absent and not option.help:
                help_text += f" Default: {row.absent}."
            if get_origin(option.type) is list:
                help_text += " Can be repeated."
            yield replace(option, help=help_text)


def changes(value: Any, given: Mapping[str, Any]) -> dict[str, Any]:  # noqa: ANN401  any record
    """Return the fields of a record that options change, with their new values.

    Args:
        value: The record, as a file has it; or its class, if no option is merged with a value so far.
        given: What was typed, by the names of the options (`Option.name`).

    Returns:
        The new values of fields by their names.

    Raises:
        CalibError: A text that the option does not take; or two options of one field say different things.
    """
    result: dict[str, Any] = {}
    rows = keys_of(value if isinstance(value, type) else type(value))
    for field, row in rows:
        typed = [option for option in row.options if option.name in given]
        if not typed:
            continue
        parsed: dict[str, Any] = {}
        for option in typed:
            words = given[option.name]
            if option.parse is not None:
                parsed[option.name] = option.parse(words, option.flag)
            else:
                parsed[option.name] = row.form.read(words, Place(option.flag))
                for sharing, shared in rows:  # a key that gives two fields
                    if shared.name == row.name and sharing is not field:
                        result[sharing.name] = shared.form.read(words, Place(option.flag))
        # Options that say nothing of the field, or add entries to it, do not contradict each other.
        stating = [
            option
            for option in typed
            if parsed[option.name] is not None and not isinstance(parsed[option.name], Mapping)
        ]
        for other in stating[1:]:
            first = stating[0]
            if given[other.name] != given[first.name]:
                raise CalibError(
                    f"{first.flag} is {_typed_text(given[first.name])} and {other.flag} is "
                    f"{_typed_text(given[other.name])}: they mean the same. Give one of them."
                )
        for option in typed:
            so_far = result.get(field.name, getattr(value, field.name, None))
            new = parsed[option.name]
            result[field.name] = new if option.merge is None else option.merge(so_far, new)
    return result


def _typed_text(words: Any) -> str:  # noqa: ANN401
    """Return what was typed for an option, a text or a list of texts, in quotes."""
    return choices(words) if isinstance(words, list) else f"'{words}'"


def key_rows(kind: type, besides: Sequence[Key] = ()) -> list[tuple[str, str, str, str]]:
    """Return the rows of the table of keys in the documentation: key, value, default, and what the key means.

    Args:
        kind: The record.
        besides: Further keys, which give no field.
    """
    defaults = {row.name: row.absent for row in besides}
    for field, row in keys_of(kind):
        if row.needed:
            defaults[row.name] = "needed"
        elif row.absent or field.default in (MISSING, None):
            defaults[row.name] = row.absent or "none"
        elif row.help:
            defaults[row.name] = toml(row.form.write(field.default))
    result = []
    for row in (*besides, *(row for _, row in keys_of(kind))):
        flags = ", ".join(f"`{option.flag}`" for option in row.options)
        meaning = f"{row.help} ({flags})" if flags else row.help
        if row.help:
            result.append((row.name, row.form.words, defaults[row.name], meaning))
    return result
