"""JSON files say what they are."""

import pytest

from calib.errors import FileError
from calib.files import json_bytes, read_json


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
        ("{", "Wanted is a thing with its 'schema'; a thing has 'thing 1'. Give a thing."),
        ("[" * 900, "this is not a JSON file"),
        ("\x00\xff", "this is not a JSON file"),
        ("[1]", "its 'schema' is None; a thing has 'thing 1'. Give a thing."),
        ('{"schema": 2}', "its 'schema' is 2; a thing has 'thing 1'."),
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


def test_a_list_is_none_whatever_schema_is_wanted(tmp_path):
    path = tmp_path / "t.json"
    path.write_text("[1]")
    with pytest.raises(FileError, match="its 'schema' is None"):
        read(path, schema=None)


def test_names_that_utf_8_lacks_are_read_as_they_were(tmp_path):
    table = {
        "schema": "thing 1",
        "name": "data\udcff é 関.csv",
    }  # as Python reads the byte 0xff in a file name
    path = tmp_path / "t.json"
    path.write_bytes(json_bytes(table))
    assert read(path) == table
    assert "é 関" in path.read_text(encoding="utf-8")
