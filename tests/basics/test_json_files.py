from __future__ import annotations

import enum
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pytest

from calib.basics.arrays import Array
from calib.basics.json_files import (
    JsonLayout,
    Key,
    damage,
    digest,
    json_bytes,
    nested,
    parse_json,
    parsed_digest,
    plain,
    read_json,
)
from calib.errors import FileError, MeasurementError


def read(path, schema="thing 1"):
    return read_json(path, "thing", schema, "a thing has 'thing 1'. Give a thing.")


def test_a_table_of_the_schema(tmp_path):
    path = tmp_path / "t.json"
    path.write_text('{"schema": "thing 1", "value": 2}')
    assert read(path) == {"schema": "thing 1", "value": 2}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "this is not a JSON file"),
        ("[1]", "its 'schema' is None; a thing has 'thing 1'. Give a thing."),
        ('{"schema": "thing 1", "a": [NaN]}', "it holds NaN; write the number, or null"),
        ('{"schema": "thing 1", "a": -Infinity}', "it holds -Infinity; write the number"),
    ],
)
def test_what_is_none_is_refused(tmp_path, text, said):
    path = tmp_path / "t.json"
    path.write_text(text, encoding="latin-1")
    with pytest.raises(FileError, match=r"t\.json") as raised:
        read(path)
    assert said in str(raised.value)


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (KeyError("rows"), "'rows' is missing"),
        (ValueError("a number is missing."), "a number is missing"),
        (MeasurementError("no column."), "no column"),
        (TypeError("NoneType"), "a value is of another kind: NoneType"),
    ],
)
def test_damage_is_the_fault_of_the_table(error, text):
    assert damage(error) == text


def test_numbers_that_do_not_exist_are_null():
    table = {"a": np.array([1.0, np.nan]), "b": (np.inf, 2), "c": np.float64(3.0), "d": {"e": "x"}}
    assert plain(table) == {"a": [1.0, None], "b": [None, 2], "c": 3.0, "d": {"e": "x"}}
    assert json.loads(json_bytes(table)) == plain(table)


def test_a_long_list_has_one_entry_a_line():
    data = json_bytes({"short": [1, 2], "long": [[k, k] for k in range(501)]})
    assert data.splitlines().count(b"  [7, 7],") == 1
    assert json.loads(data)["long"][500] == [500, 500]


def test_a_digest_is_of_values_whatever_their_form():
    table = {"a": [1.0, 0.1, math.nan, True], "b": {"c": "é", "d": -0.0}}
    again = json.loads(json.dumps({"b": {"d": 0, "c": "\u00e9"}, "a": [1, 1e-1, None, True]}))
    assert digest(table) == digest(again)
    for other in (
        {**table, "a": [1.0, 0.1, math.nan, 1]},
        {**table, "a": [1.0, math.nextafter(0.1, 1.0), math.nan, True]},
        {**table, "a": [0.1, 1.0, math.nan, True]},
        {**table, "c": None},
    ):
        assert digest(other) != digest(table)


def test_paths_make_nested_tables():
    assert nested({"a.b": 1, "a.c.d": 2, "e": 3}) == {"a": {"b": 1, "c": {"d": 2}}, "e": 3}


@dataclass(frozen=True)
class Pair:
    first: Part
    second: Part


def test_a_path_that_ends_in_a_dot_puts_a_part_s_keys_beside_the_others():
    layout = JsonLayout(
        {Part: {"mass": "deep.mass"}, Pair: {"first": "", "second": "deep.too."}}, {}
    )
    pair = Pair(Part(1.0, Colour.RED), Part(2.0, Colour.RED))
    table = layout.table(pair)
    assert table == {
        "deep": {"mass": 1.0, "too": {"deep": {"mass": 2.0}, "colour": "red"}},
        "colour": "red",
    }
    assert layout.read(Pair, table) == pair


# Layouts


class Colour(enum.Enum):
    RED = 1


@dataclass(frozen=True)
class Part:
    mass: float
    colour: Colour


@dataclass(frozen=True)
class Whole(Part):
    name: str
    matrix: Array
    parts: tuple[Part, ...]
    by_name: Mapping[str, float]
    maybe: Part | None
    hidden: int = 3
    late: float = 1.5
    length: float = 0.0


LAYOUT = JsonLayout(
    {
        Part: {"mass": "mass_kg"},
        Whole: {
            "name": "robot.name",
            "hidden": None,
            "length": Key("length_mm", lambda value: 1e3 * value, lambda entry: 1e-3 * entry),
        },
    },
    {},
)
WHOLE = Whole(
    mass=2.0,
    colour=Colour.RED,
    name="r",
    matrix=np.eye(2),
    parts=(Part(float("nan"), Colour.RED),),
    by_name={"a": 1.0},
    maybe=None,
    length=0.25,
)


def test_a_layout_writes_by_types_and_paths():
    table = plain(LAYOUT.table(WHOLE))
    assert table == {
        "mass_kg": 2.0,
        "colour": "red",
        "robot": {"name": "r"},
        "matrix": [[1.0, 0.0], [0.0, 1.0]],
        "parts": [{"mass_kg": None, "colour": "red"}],
        "by_name": {"a": 1.0},
        "maybe": None,
        "late": 1.5,
        "length_mm": 250.0,
    }


def test_a_layout_reads_what_it_wrote():
    table = plain(LAYOUT.table(WHOLE))
    del table["late"]  # which has a default
    back = LAYOUT.read(Whole, table)
    assert (back.mass, back.colour, back.name) == (2.0, Colour.RED, "r")
    assert (back.by_name, back.maybe, back.hidden, back.late) == ({"a": 1.0}, None, 3, 1.5)
    assert back.length == 0.25
    np.testing.assert_array_equal(back.matrix, np.eye(2))
    assert not back.matrix.flags.writeable
    assert np.isnan(back.parts[0].mass)
    assert "mass" not in LAYOUT.values(Whole, table, excluded=("mass",))
    with pytest.raises(KeyError, match="colour"):
        LAYOUT.read(Part, {"mass_kg": 1.0})


def test_functions_of_a_type_come_first():
    layout = JsonLayout({}, {Colour: (lambda value: value.value, Colour)})
    table = layout.table(Part(1.0, Colour.RED))
    assert table["colour"] == 1
    assert layout.read(Part, table) == Part(1.0, Colour.RED)


def test_the_digest_of_parsed_json_is_that_of_the_value():
    value = {"b": [1.0, -0.0, 2.5e-7, 1e22, None, True], "a": {"x": -3.0, "ü": "1.0"}, "n": 12}
    for text in (json_bytes(value), b'{"n": 1.2e1, "a": {"\\u00fc": "1.0", "x": -3}, "b": [1, 0, '
                 b"0.00000025, 1e22, null, true]}"):  # fmt: skip
        assert parsed_digest(parse_json(text, "a.json", whole=True)) == digest(value)
