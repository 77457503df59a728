from __future__ import annotations

import math

import pytest

from calib.errors import FileError
from calib.formats.yaml_file import parse_yaml


def test_what_yaml_says():
    text = b"a: {x: 1.5, y: [1, two, null], z: !degrees 90, r: !radians 1}\n'b c': 1e-05\n"
    assert parse_yaml(text, "f.yaml", "origins file") == {
        "a": {"x": 1.5, "y": [1, "two", None], "z": math.pi / 2, "r": 1.0},
        "b c": "1e-05",  # YAML 1.1 wants a point in a number
    }
    for other in (b"", b"- 1\n", b"word"):
        assert parse_yaml(other, "f.yaml", "origins file") == {}


REFUSED = {
    "twice": (b"a: 1\nb: 2\na: 3\n", "f.yaml, line 3, column 1: .*'a' stands twice, first in li"),
    "alias": (b"a: &n 1\nb: *n\n", r"line 2, column 4: .*an alias \(\*n\) is not read"),
    "tag": (b"a: !mm 90\n", "line 1, column 4: .*could not determine a constructor"),
    "unclosed": (b"a: [1, 2\n", "line 2, column 1: this origins file cannot be read as YAML: exp"),
    "no text": (b"a: \xff\xfe\n", "f.yaml.*: this origins file cannot be read as YAML: "),
    "no angle": (b"a: !degrees x\n", "could not convert"),
}


@pytest.mark.parametrize(("text", "message"), REFUSED.values(), ids=REFUSED)
def test_what_is_refused(text: bytes, message: str):
    with pytest.raises(FileError, match=message):
        parse_yaml(text, "f.yaml", "origins file")
