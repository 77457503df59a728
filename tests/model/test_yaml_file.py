from __future__ import annotations

import pytest
import yaml

from calib.errors import FileError
from calib.model.yaml_file import parse_yaml, yaml_keys


def test_what_yaml_says():
    text = b"a: {x: 1.5, y: [1, two, null]}\n'b c': 1e-05\n"
    assert parse_yaml(text, "f.yaml", "origins file") == {
        "a": {"x": 1.5, "y": [1, "two", None]},
        "b c": "1e-05",  # YAML 1.1 wants a point in a number
    }
    assert parse_yaml(b"", "f.yaml", "origins file") is None


REFUSED = {
    "twice": (
        b"a: 1\nb: 2\na: 3\n",
        "f.yaml, line 3, column 1: .*'a' stands twice, first in line 1",
    ),
    "twice below": (b"a:\n  x: 1\n  x: 2\n", "line 3, column 3: .*'x' stands twice"),
    "tag": (b"a: !degrees 90\n", "line 1, column 4: .*could not determine a constructor"),
    "python": (b"a: !!python/object/apply:os.getcwd []\n", "could not determine a constructor"),
    "unclosed": (b"a: [1, 2\n", "line 2, column 1: this origins file cannot be read as YAML: exp"),
    "tab": (b"a:\n\tb: 1\n", "line 2, column 1: .*cannot start any token"),
    "no text": (b"a: \xff\xfe\n", "f.yaml: this origins file cannot be read as YAML: .*UTF-8 text"),
    "control": (b"a: \x01\n", "f.yaml: this origins file cannot be read as YAML: "),
    "list as key": (b"? [1]\n: 2\n", "unhashable key"),
    "no time": (b"a: !!timestamp x\n", "f.yaml: this origins file cannot be read as YAML: "),
    "no month": (b"a: 2020-99-99\n", "month must be in 1"),
    "no truth": (b"a: !!bool x\n", "f.yaml: this origins file cannot be read as YAML: "),
    "no number": (b"a: !!int x\n", "f.yaml: this origins file cannot be read as YAML: "),
    "half a character": (b'a: "\\ud800"\nb: [', "line 2"),
    "deep": (b"[" * 20_000, "f.yaml: this origins file cannot be read as YAML: "),
}


@pytest.mark.parametrize(("text", "message"), REFUSED.values(), ids=REFUSED)
def test_what_is_refused(text: bytes, message: str):
    with pytest.raises(FileError, match=message):
        parse_yaml(text, "f.yaml", "origins file")


def test_tags_that_other_programs_add_are_not_ours():
    before = dict(yaml.SafeLoader.yaml_constructors)
    yaml.SafeLoader.add_constructor("!millimeters", lambda _loader, _node: 1.0)
    try:
        with pytest.raises(FileError, match="could not determine a constructor"):
            parse_yaml(b"a: !millimeters 5", "f.yaml", "origins file")
    finally:
        yaml.SafeLoader.yaml_constructors = before


def test_the_keys_of_a_file_whatever_its_tags():
    text = b"kinematics:\n  shoulder: !degrees 90\norigins: &a 1\nb: *a\n1: 2\n"
    assert yaml_keys(text, "f.yaml", "YAML file") == ("kinematics", "origins", "b", "1")
    for other in (b"", b"- 1\n", b"word"):
        assert yaml_keys(other, "f.yaml", "YAML file") == ()
    with pytest.raises(FileError, match=r"f.yaml, line 2, column 1: this YAML file cannot be read"):
        yaml_keys(b"a: [1, 2\n", "f.yaml", "YAML file")
    with pytest.raises(FileError, match="save it as UTF-8 text"):
        yaml_keys(b"a: \xff\xfe\n", "f.yaml", "YAML file")
